//! What an arm can be told and what it tells: the vocabulary between MP, ECP, EDP and the servo.
//!
//! - a [`MoveCommand`] says what to do for a number of 2 ms servo periods (Zieliński et al. 2007, p. 371:
//!   frame, selector of force and position directions, execution time)
//! - an [`ArmState`] is what the servo knows after a period

use crate::spatial::{Pose, Wrench};
use serde::{Deserialize, Serialize};

/// Seconds in one servo period of the original: the unit in which commands last and in which states and frames are
/// numbered, whatever the length of the servo's own periods.
pub const PERIOD: f64 = 0.002;

/// Axes of an arm without its jaw: index 0 is the prismatic track, 1..=6 the six rotary axes.
/// The postument arm has no axis 0; its entry is 0.
pub const AXES: usize = 7;
/// Index of the tool's roll among the joints, which no other axis takes part in.
pub const ROLL: usize = 6;

/// Joint variables: `[0]` the track d0 (m), `[1..=6]` q1..q6 (rad) (q3, q4 relative, as in the URDF).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct JointPositions(pub [f64; AXES]);

impl JointPositions {
    /// Returns the joint positions after a share of the way to others, all joints evenly.
    #[must_use]
    pub fn towards(&self, to: &Self, share: f64) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + share * (to.0[i] - self.0[i])))
    }
}

/// Motor shaft angles (rad) in the same order.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct MotorPositions(pub [f64; AXES]);

/// The axes in which the directions of a [`Motion::Task`] are expressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Frame {
    /// The robot's base: the paper's absolute mode.
    Base,
    /// The tool: the paper's relative mode.
    Tool,
}

/// What one direction of the task frame does: linear directions in m, N; angular ones in rad, Nm.
///
/// `admittance` is the original's reciprocal damping B (m/(s N) or rad/(s Nm)), `inertia` its M
/// (kg or kg m2); inertia 0 is the paper's plain scaling of the force error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Direction {
    /// Follows a velocity whatever the force.
    Unguarded {
        /// Set velocity (m/s or rad/s).
        velocity: f64,
    },
    /// Follows a velocity and yields to any force.
    Guarded {
        /// Velocity in free motion (m/s or rad/s).
        velocity: f64,
        /// B.
        admittance: f64,
        /// M.
        inertia: f64,
    },
    /// Seeks a force that the tool exerts on its surroundings.
    Contact {
        /// Set force or torque (N or Nm).
        wanted: f64,
        /// B.
        admittance: f64,
        /// M.
        inertia: f64,
    },
}

impl Direction {
    /// Stands still, stiffly.
    pub const HOLD: Self = Self::Unguarded { velocity: 0.0 };
}

/// Where a command takes the arm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Motion {
    /// Keeps the present set values.
    Hold,
    /// Reaches these motor positions at the end, linearly.
    Motors(MotorPositions),
    /// Turns the motors by these angles, linearly: the one motion of an arm that is not synchronised.
    MotorsBy(MotorPositions),
    /// Reaches these joint positions at the end, linearly.
    Joints(JointPositions),
    /// Reaches this `base_from_tool` at the end along a straight line; d0 stays.
    Pose(Pose),
    /// Position-force control in a task frame.
    Task {
        /// Axes of the directions.
        frame: Frame,
        /// x, y, z, then rotations about them.
        directions: [Direction; 6],
    },
}

/// How deep a gripper reaches over the cube: over one layer or over two.
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
    /// Distance between the finger pads that is reached at the end of the command, linearly (m).
    pub opening: f64,
    /// Grip force at which the jaw motor's current is limited (N).
    pub force_limit: f64,
    /// Which position the palm's two-position stops take (a digital output of the parallel interface).
    pub stops: Depth,
}

/// One command of an EDP: a motion, its duration, and the jaw's set values.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MoveCommand {
    /// Where to.
    pub motion: Motion,
    /// Execution time in servo periods, at least 1.
    pub periods: u32,
    /// Jaw; `None` keeps its set values.
    pub jaw: Option<JawCommand>,
}

/// Why an arm stopped by itself. Units and numbers are in the text of the error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum ArmFault {
    /// The power stage's current limit, or half of the servo profile's `trip_current` for 0.3 s.
    #[error("axis {axis}: over-current, {amperes:.1} A")]
    OverCurrent {
        /// 0 the track, 1..=6 the rotary axes, 7 the jaw.
        axis: usize,
        /// Measured.
        amperes: f64,
    },
    /// A limit switch was hit.
    #[error("axis {axis}: limit switch hit at motor position {motor:.2} rad")]
    LimitSwitch {
        /// As above.
        axis: usize,
        /// Where.
        motor: f64,
    },
    /// Set value and reading are too far apart.
    #[error("axis {axis}: following error {error:.3} rad of motor angle")]
    Following {
        /// As above.
        axis: usize,
        /// Set minus measured.
        error: f64,
    },
    /// The force sensor is silent while the arm moves, or saturated while a force is being controlled.
    #[error("force sensor: {}", felt(*direction, *reading))]
    ForceSensor {
        /// 0..=5 in the sensor's frame.
        direction: usize,
        /// Measured.
        reading: f64,
    },
    /// A power stage's own fault, or no power.
    #[error("axis {axis}: the power stage reports a fault")]
    PowerStage {
        /// As above.
        axis: usize,
    },
    /// Homing ended at a limit, or went round, without the synchronisation switch.
    #[error("axis {axis}: no synchronisation switch within {travelled:.0} rad of motor angle")]
    SwitchExpected {
        /// As above.
        axis: usize,
        /// How far it went (rad).
        travelled: f64,
    },
    /// Homing did not come off the synchronisation switch: it hangs, or the axis does not move.
    #[error(
        "axis {axis}: the synchronisation switch is still pressed after {travelled:.0} rad of motor angle"
    )]
    SwitchHeld {
        /// As above.
        axis: usize,
        /// How far it went (rad).
        travelled: f64,
    },
    /// Homing left the switch and no encoder zero came.
    #[error("axis {axis}: no encoder zero within {travelled:.1} rad of motor angle off the switch")]
    ZeroExpected {
        /// As above.
        axis: usize,
        /// How far it went (rad).
        travelled: f64,
    },
    /// A controller forgot where it is: it was reset.
    #[error("axis {axis}: the controller has lost its synchronisation")]
    SynchronisationLost {
        /// As above.
        axis: usize,
    },
    /// The actors have been silent.
    #[error("no heart beat of the actors for {seconds:.2} s")]
    HeartBeat {
        /// For how long.
        seconds: f64,
    },
    /// The servo's thread did not run.
    #[error("the servo missed {periods} periods in a row")]
    Missed {
        /// How many.
        periods: u64,
    },
    /// The bridge's thread does not answer.
    #[error("no reading from the bridge for {periods} periods")]
    BridgeSilent {
        /// How many.
        periods: u64,
    },
    /// Emergency stop.
    #[error("emergency stop")]
    EmergencyStop,
    /// A counter stands still while its axis is to move.
    #[error(
        "axis {axis}: the encoder stands still, {wanted:.2} rad of motor angle were wanted meanwhile"
    )]
    EncoderFrozen {
        /// As above.
        axis: usize,
        /// How far the set value has gone since the counter last changed (rad).
        wanted: f64,
    },
    /// A counter went further in a period than any motor can.
    #[error("axis {axis}: the encoder jumped by {by:.2} rad of motor angle")]
    EncoderJump {
        /// As above.
        axis: usize,
        /// By how much (rad).
        by: f64,
    },
}

/// What a force sensor tells that is not to be believed.
fn felt(direction: usize, reading: f64) -> String {
    let (unit, way) = if direction < 3 { ("N", "along") } else { ("Nm", "about") };
    let axis = ["x", "y", "z"][direction % 3];
    if reading.is_finite() {
        format!("{reading:.1} {unit} {way} {axis} is the end of its range")
    } else {
        format!("no reading {way} {axis}")
    }
}

/// Whether the counters of an arm mean positions (the states of the original's EDP).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Synchronisation {
    /// Counters start anywhere: only [`Motion::MotorsBy`] and synchronising are possible.
    No,
    /// On the way to the switch and the encoder zero of an axis.
    Under {
        /// 0 the track, 1..=6 the rotary axes, 7 the jaw.
        axis: u8,
    },
    /// Every counter is zero at the synchronisation position.
    #[default]
    Yes,
}

/// Unit of a joint: the track (0) and the jaw (7) slide.
const fn unit(axis: usize) -> &'static str {
    if axis == 0 || axis == AXES { "m" } else { "rad" }
}

/// Why a command could not be carried out (the arm holds; non-fatal).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum MoveRefused {
    /// No joint positions reach the pose.
    #[error("pose out of reach: {0:.4} m short")]
    OutOfReach(f64),
    /// A joint limit.
    #[error("joint {axis}: {value:.4} {unit} is outside {low:.4}..{high:.4}", unit = unit(*axis))]
    JointLimit {
        /// 0 the track, 1..=6.
        axis: usize,
        /// Wanted (m or rad).
        value: f64,
        /// Limit.
        low: f64,
        /// Limit.
        high: f64,
    },
    /// A motor limit.
    #[error("motor {axis}: {value:.2} rad is outside {low:.2}..{high:.2}")]
    MotorLimit {
        /// 0 the track, 1..=6.
        axis: usize,
        /// Wanted (rad).
        value: f64,
        /// Limit.
        low: f64,
        /// Limit.
        high: f64,
    },
    /// Faster than the drive may be asked to go.
    #[error("motor {axis}: {rate:.1} rad/s is faster than {limit:.1} rad/s")]
    TooFast {
        /// 0 the track, 1..=6.
        axis: usize,
        /// Asked (rad/s).
        rate: f64,
        /// Allowed (rad/s).
        limit: f64,
    },
    /// The arm does not know where it is.
    #[error("the arm is not synchronised: only relative motor moves are possible")]
    NotSynchronised,
    /// Broken off from outside; the arm was brought to a stand.
    #[error("the motion was broken off: the actors were silent")]
    BrokenOff,
    /// This arm holds until the trouble is over.
    #[error("the arm is held back: the other one is stopped by a fault, or an actor is gone")]
    HeldBack,
    /// A stop of all arms is under way.
    #[error("the arms are being stopped: {periods} periods were missed")]
    Stopping {
        /// How many periods the servo missed.
        periods: u64,
    },
    /// A number that is none.
    #[error("the command or its result is not a finite number")]
    NotANumber,
}

/// What the servo knows of an arm after a period.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ArmState {
    /// Number of the period that this is the state of.
    pub period: u64,
    /// Measured.
    pub motors: MotorPositions,
    /// From the measured motors.
    pub joints: JointPositions,
    /// From the measured joints.
    pub base_from_tool: Pose,
    /// Set value of this period.
    pub desired_joints: JointPositions,
    /// Set value of this period.
    pub desired_base_from_tool: Pose,
    /// What the tool exerts on its surroundings, at the tool point, in tool axes; weight and bias removed.
    pub wrench_in_tool: Wrench,
    /// Measured distance between the pads (m), by the controller's belief of the jaw.
    pub jaw_opening: f64,
    /// Its set value of this period (m).
    pub desired_jaw_opening: f64,
    /// Force that the jaw's motor current stands for (N).
    pub jaw_force: f64,
    /// Last period of the command being executed; not after `period` when idle.
    pub command_end: u64,
    /// Set when the last command was refused or broken off in the middle.
    pub refused: Option<MoveRefused>,
    /// Set until reset: the arm is stopped.
    pub fault: Option<ArmFault>,
    /// Whether joints and poses can be believed.
    pub synchronisation: Synchronisation,
}

impl Default for ArmState {
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
        }
    }
}
