//! Commands to an arm and the states that it reports, shared by MP, ECP, EDP and the servo.
//!
//! - a [`MoveCommand`] orders a motion for a number of 2 ms servo periods (Zieliński et al. 2007,
//!   p. 371: frame, selector of force and position directions, execution time)
//! - an [`ArmState`] is the state of an arm after a servo period

use crate::spatial::{Pose, Wrench};
use serde::{Deserialize, Serialize};

/// Length of a servo period of the original controller (s). Durations of commands and the numbers
/// of states and pictures count such periods, even if those of the servo have another length.
pub const PERIOD: f64 = 0.002;

/// Number of axes of an arm without its jaw. Index 0 is the prismatic track, 1..=6 are the six
/// rotary axes. The postument arm has no axis 0; its entry is 0.
pub const AXES: usize = 7;
/// Index of the tool's roll among the joints. This joint is coupled with no other axis.
pub const ROLL: usize = 6;

/// Joint variables: `[0]` is the track d0 (m), `[1..=6]` are q1..q6 (rad); q3 and q4 are relative,
/// as in the URDF.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct JointPositions(pub [f64; AXES]);

impl JointPositions {
    /// Returns the joint positions on the straight line in joint space from these (`share` 0) to
    /// `to` (`share` 1).
    ///
    /// ```
    /// use rubik_robot_vocabulary::motion::JointPositions;
    ///
    /// let to = JointPositions([0.8, 0.4, 0.0, 0.0, 0.0, 0.0, 2.0]);
    /// let part = JointPositions::default().towards(&to, 0.25);
    /// assert_eq!(part.0, [0.2, 0.1, 0.0, 0.0, 0.0, 0.0, 0.5]);
    /// ```
    #[must_use]
    pub fn towards(&self, to: &Self, share: f64) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + share * (to.0[i] - self.0[i])))
    }
}

/// Motor shaft angles in the order of the joints (rad).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct MotorPositions(pub [f64; AXES]);

/// Axes in which the directions of a [`Motion::Task`] are expressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Frame {
    /// Axes of the base: the absolute mode of the paper.
    Base,
    /// Axes of the tool: the relative mode of the paper.
    Tool,
}

/// Law of one direction of the task frame: linear directions in m and N, angular ones in rad and
/// Nm.
///
/// `admittance` is the original's reciprocal damping B (m/(s N) or rad/(s Nm)), `inertia` its M (kg
/// or kg m2). Inertia 0 is the plain scaling of the force error in the paper.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Direction {
    /// Follows a velocity and ignores the force.
    Unguarded {
        /// Set velocity (m/s or rad/s).
        velocity: f64,
    },
    /// Follows a velocity and yields to any force.
    Guarded {
        /// Velocity in free motion (m/s or rad/s).
        velocity: f64,
        /// Admittance B (m/(s N) or rad/(s Nm)).
        admittance: f64,
        /// Inertia M (kg or kg m2).
        inertia: f64,
    },
    /// Seeks a force that the tool exerts on its surroundings.
    Contact {
        /// Set force or torque (N or Nm).
        wanted: f64,
        /// Admittance B (m/(s N) or rad/(s Nm)).
        admittance: f64,
        /// Inertia M (kg or kg m2).
        inertia: f64,
    },
}

impl Direction {
    /// Law that keeps the position and ignores the force.
    pub const HOLD: Self = Self::Unguarded { velocity: 0.0 };
}

/// Motion that a command orders.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Motion {
    /// Keeps the present set values.
    Hold,
    /// Turns the motors by these angles, along a line in motor space. An arm that is not
    /// synchronised accepts no other motion.
    MotorsBy(MotorPositions),
    /// Reaches these joint positions at the end, along a line in joint space.
    Joints(JointPositions),
    /// Reaches this `base_from_tool` at the end along a straight line; d0 stays.
    Pose(Pose),
    /// Follows velocities and seeks forces in a task frame.
    Task {
        /// Axes of the directions.
        frame: Frame,
        /// Law of each direction: x, y, z, then the rotations about them.
        directions: [Direction; 6],
    },
}

/// Number of the cube's layers over which a gripper reaches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Depth {
    /// One layer: the tool point lies in the outer layer's centre plane.
    One,
    /// Two layers: the tool point lies in the middle layer's centre plane.
    Two,
}

/// Set values of a gripper's jaw.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct JawCommand {
    /// Distance between the finger pads at the end of the command (m). The set value moves there
    /// linearly.
    pub opening: f64,
    /// Grip force at which the current of the jaw motor is limited (N).
    pub force_limit: f64,
    /// Position of the palm's two-position stops (a digital output of the parallel interface).
    pub stops: Depth,
}

/// Command to an EDP: a motion, its duration and the set values of the jaw.
///
/// ```
/// use rubik_robot_vocabulary::motion::{Direction, Frame, Motion, MoveCommand, PERIOD};
///
/// // Presses with 5 N along z of the tool, and keeps its place in all other directions.
/// let mut directions = [Direction::HOLD; 6];
/// directions[2] = Direction::Contact { wanted: 5.0, admittance: 0.002, inertia: 0.0 };
/// let motion = Motion::Task { frame: Frame::Tool, directions };
/// let macrostep = MoveCommand { motion, periods: 8, jaw: None };
/// assert_eq!(f64::from(macrostep.periods) * PERIOD, 0.016);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MoveCommand {
    /// Motion of the arm.
    pub motion: Motion,
    /// Execution time in servo periods, at least 1.
    pub periods: u32,
    /// Set values of the jaw; `None` keeps the present ones.
    pub jaw: Option<JawCommand>,
}

/// Reason for which an arm stopped by itself. The text of the error gives numbers and units.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum ArmFault {
    /// The power stage tripped at its current limit, or the current was above half of the servo
    /// profile's `trip_current` for 0.3 s.
    #[error("axis {axis}: over-current, {amperes:.1} A")]
    OverCurrent {
        /// Axis: 0 the track, 1..=6 the rotary axes, 7 the jaw.
        axis: usize,
        /// Measured current (A).
        amperes: f64,
    },
    /// An axis reached its limit switch.
    #[error("axis {axis}: limit switch hit at motor position {motor:.2} rad")]
    LimitSwitch {
        /// Axis, numbered as in [`ArmFault::OverCurrent`].
        axis: usize,
        /// Motor position at the switch (rad).
        motor: f64,
    },
    /// Set value and reading are too far apart.
    #[error("axis {axis}: following error {error:.3} rad of motor angle")]
    Following {
        /// Axis, numbered as in [`ArmFault::OverCurrent`].
        axis: usize,
        /// Set value minus reading (rad of motor angle).
        error: f64,
    },
    /// The force sensor is silent while the arm moves, or saturated while a force is controlled.
    #[error("force sensor: {}", unusable(*direction, *reading))]
    ForceSensor {
        /// Direction in the frame of the sensor: 0..=2 forces along, 3..=5 torques about x, y, z.
        direction: usize,
        /// Measured force or torque (N or Nm).
        reading: f64,
    },
    /// A power stage reports a fault of its own, or has no power.
    #[error("axis {axis}: the power stage reports a fault")]
    PowerStage {
        /// Axis, numbered as in [`ArmFault::OverCurrent`].
        axis: usize,
    },
    /// Homing did not find the synchronisation switch: it reached the lower limit switch, moved
    /// further than any axis can, or ran over the switch.
    #[error("axis {axis}: no synchronisation switch within {travelled:.0} rad of motor angle")]
    SwitchExpected {
        /// Axis, numbered as in [`ArmFault::OverCurrent`].
        axis: usize,
        /// Travel of the motor (rad).
        travelled: f64,
    },
    /// Homing did not leave the synchronisation switch: the switch is stuck, or the axis does not
    /// move.
    #[error(
        "axis {axis}: the synchronisation switch is still pressed after {travelled:.0} rad of \
         motor angle"
    )]
    SwitchHeld {
        /// Axis, numbered as in [`ArmFault::OverCurrent`].
        axis: usize,
        /// Travel of the motor (rad).
        travelled: f64,
    },
    /// Homing left the switch, but no encoder zero followed.
    #[error("axis {axis}: no encoder zero within {travelled:.1} rad of motor angle off the switch")]
    ZeroExpected {
        /// Axis, numbered as in [`ArmFault::OverCurrent`].
        axis: usize,
        /// Travel of the motor (rad).
        travelled: f64,
    },
    /// A controller of an axis was reset and lost its position.
    #[error("axis {axis}: the controller has lost its synchronisation")]
    SynchronisationLost {
        /// Axis, numbered as in [`ArmFault::OverCurrent`].
        axis: usize,
    },
    /// The actors sent no heartbeat.
    #[error("no heartbeat from the actors for {seconds:.2} s")]
    #[serde(rename = "HeartBeat")]
    Heartbeat {
        /// Time since the last heartbeat (s).
        seconds: f64,
    },
    /// The thread of the servo did not run.
    #[error("the servo missed {periods} periods in a row")]
    Missed {
        /// Number of missed periods in a row.
        periods: u64,
    },
    /// The thread of the bridge does not answer.
    #[error("no reading from the bridge for {periods} periods")]
    BridgeSilent {
        /// Number of periods without a reading.
        periods: u64,
    },
    /// Emergency stop of all arms.
    #[error("emergency stop")]
    EmergencyStop,
    /// A counter stands still while its axis is commanded to move.
    #[error(
        "axis {axis}: the encoder does not move, while the set value moved by {wanted:.2} rad of \
         motor angle"
    )]
    EncoderFrozen {
        /// Axis, numbered as in [`ArmFault::OverCurrent`].
        axis: usize,
        /// Travel of the set value since the counter last changed (rad).
        wanted: f64,
    },
    /// A counter changed in one period by more than any motor can turn.
    #[error("axis {axis}: the encoder jumped by {by:.2} rad of motor angle")]
    EncoderJump {
        /// Axis, numbered as in [`ArmFault::OverCurrent`].
        axis: usize,
        /// Change of the counter (rad of motor angle).
        by: f64,
    },
}

/// Describes a reading of the force sensor, in one of its six directions, that must not be used:
/// missing, or at the limit of its range.
fn unusable(direction: usize, reading: f64) -> String {
    let (unit, way) = if direction < 3 { ("N", "along") } else { ("Nm", "about") };
    let axis = ["x", "y", "z"][direction % 3];
    if reading.is_finite() {
        format!("{reading:.1} {unit} {way} {axis} is the limit of its range")
    } else {
        format!("no reading {way} {axis}")
    }
}

/// Whether the counters of an arm give its position (the states of the original's EDP).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Synchronisation {
    /// The counters started at arbitrary values. Only [`Motion::MotorsBy`] and synchronising are
    /// possible.
    No,
    /// Homing moves an axis to its switch and the next encoder zero.
    Under {
        /// Axis: 0 the track, 1..=6 the rotary axes, 7 the jaw.
        axis: u8,
    },
    /// Every counter is zero at the synchronisation position.
    #[default]
    Yes,
}

/// Returns the unit of a joint: the track (0) and the jaw (7) slide, the others turn.
const fn unit(axis: usize) -> &'static str {
    if axis == 0 || axis == AXES { "m" } else { "rad" }
}

/// Reason for which the arm refuses a command or aborts it. The arm holds; the error is non-fatal.
///
/// ```
/// use rubik_robot_vocabulary::motion::MoveRefused;
///
/// // Errors are facts with numbers and units; joint 0 is the track and slides.
/// let refused = MoveRefused::TooFast { axis: 1, rate: 260.0, limit: 250.0 };
/// assert_eq!(refused.to_string(), "motor 1: 260.0 rad/s is faster than 250.0 rad/s");
/// let limit = MoveRefused::JointLimit { axis: 0, value: 1.3, low: 0.0, high: 1.21 };
/// assert!(limit.to_string().starts_with("joint 0: 1.3000 m is outside"));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum MoveRefused {
    /// No joint positions reach the pose.
    #[error("pose out of reach by {0:.4} m")]
    OutOfReach(f64),
    /// A joint would leave its limits.
    #[error("joint {axis}: {value:.4} {unit} is outside {low:.4}..{high:.4}", unit = unit(*axis))]
    JointLimit {
        /// Joint: 0 the track, 1..=6 the rotary ones.
        axis: usize,
        /// Commanded value (m or rad).
        value: f64,
        /// Lower limit (m or rad).
        low: f64,
        /// Upper limit (m or rad).
        high: f64,
    },
    /// A motor would leave its limits.
    #[error("motor {axis}: {value:.2} rad is outside {low:.2}..{high:.2}")]
    MotorLimit {
        /// Motor: 0 of the track, 1..=6 of the rotary axes.
        axis: usize,
        /// Commanded value (rad).
        value: f64,
        /// Lower limit (rad).
        low: f64,
        /// Upper limit (rad).
        high: f64,
    },
    /// A motor would exceed its speed limit.
    #[error("motor {axis}: {rate:.1} rad/s is faster than {limit:.1} rad/s")]
    TooFast {
        /// Motor: 0 of the track, 1..=6 of the rotary axes.
        axis: usize,
        /// Commanded speed (rad/s).
        rate: f64,
        /// Speed limit (rad/s).
        limit: f64,
    },
    /// The arm does not know its position.
    #[error("the arm is not synchronised: only relative motor moves are possible")]
    NotSynchronised,
    /// The servo braked the arm to rest: the operator interrupted the motion, or the actors sent no
    /// heartbeat.
    #[error("the motion was aborted: the operator interrupted it, or the actors sent no heartbeat")]
    #[serde(rename = "BrokenOff")]
    Aborted,
    /// The arm holds until the fault of its partner is reset, or the missing actor is back.
    #[error("the arm is on hold: another arm has a fault, or an actor is missing")]
    #[serde(rename = "HeldBack")]
    PartnerStopped,
    /// The servo stops all arms.
    #[error("all arms are stopping: the servo missed {periods} periods")]
    Stopping {
        /// Number of periods that the servo missed.
        periods: u64,
    },
    /// A command or its result is not a finite number.
    #[error("the command or its result is not a finite number")]
    NotANumber,
}

/// State of an arm after a servo period.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ArmState {
    /// Number of the period after which this state was measured.
    pub period: u64,
    /// Measured motor positions (rad).
    pub motors: MotorPositions,
    /// Joint positions computed from the measured motor positions (m or rad).
    pub joints: JointPositions,
    /// Pose of the tool computed from those joint positions.
    pub base_from_tool: Pose,
    /// Joint positions commanded in this period (m or rad).
    pub desired_joints: JointPositions,
    /// Pose of the tool commanded in this period.
    pub desired_base_from_tool: Pose,
    /// Wrench that the tool exerts on its surroundings, about the tool point, in tool axes (N, Nm);
    /// without weight and bias.
    pub wrench_in_tool: Wrench,
    /// Measured distance between the pads, according to the controller's belief of the jaw (m).
    pub jaw_opening: f64,
    /// Distance between the pads commanded in this period (m).
    pub desired_jaw_opening: f64,
    /// Grip force computed from the current of the jaw motor (N).
    pub jaw_force: f64,
    /// Last period of the running command; at most `period` if the arm is idle.
    pub command_end: u64,
    /// Reason for which the last command was refused or aborted.
    pub refused: Option<MoveRefused>,
    /// Fault that stopped the arm; it stays until a reset.
    pub fault: Option<ArmFault>,
    /// Whether the counters give the joint positions and poses.
    pub synchronisation: Synchronisation,
    /// Binary inputs of the parallel interface; 0 if the bridge has none.
    #[serde(default)]
    pub inputs: u16,
}

impl Default for ArmState {
    /// Returns the state of a synchronised arm before its first period: all values are zero.
    fn default() -> Self {
        Self {
            period: 0,
            motors: MotorPositions::default(),
            joints: JointPositions::default(),
            base_from_tool: Pose::identity(),
            desired_joints: JointPositions::default(),
            desired_base_from_tool: Pose::identity(),
            wrench_in_tool: Wrench::default(),
            jaw_opening: 0.0,
            desired_jaw_opening: 0.0,
            jaw_force: 0.0,
            command_end: 0,
            refused: None,
            fault: None,
            synchronisation: Synchronisation::Yes,
            inputs: 0,
        }
    }
}
