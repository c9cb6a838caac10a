//! Parameters of the simulated plant: the true [`Cell`], whose values a workshop would measure, and
//! what is beyond it (dynamics, friction, sensor errors, the operator's hand, faults).
//!
//! All SI. Numbers without another source are assumptions. They give the closed chain of two arms a
//! stiffness of 8-20 kN/m lateral and 20-45 kN/m axial at a held cube.

use super::dynamics::{LINKS, Link};
use super::fault::Fault;
use super::frame::{Frame, rotation};
use super::objects::spec::{LeadConfig, ObjectConfig, Probe};
use crate::cell::{Cell, MOST_ARMS, PerArm};
use crate::motion::AXES;
use crate::servo::period::Length;
use crate::spatial::Pose;
use nalgebra::{Matrix3, Vector3};
use rand::Rng;
use rand_pcg::Pcg64;

/// Configuration of the plant, all but its seed.
#[derive(Debug, Clone, PartialEq)]
pub struct PlantConfig {
    /// True values of the cell: see [`super::truth::draw`].
    pub cell: Cell,
    /// Dynamics of each arm, in the order of the cell.
    pub arms: Vec<ArmDynamics>,
    /// Friction and play of the cube's layers.
    pub cube: CubeMechanics,
    /// Pads of both grippers.
    pub jaws: Jaws,
    /// Force sensors.
    pub noise: SensorNoise,
    /// The operator's hand.
    pub hand: HandScript,
    /// Holder of the cube at first.
    pub start: Start,
    /// Grip of the jaws when the run begins with the cube held (N).
    pub start_grip: f64,
    /// Colours of the 54 stickers at first, URFDLB by position in the cube frame, centres 0..=5 in
    /// order.
    pub facelets: [u8; 54],
    /// Whether the controllers of each arm are synchronised when the run begins.
    pub synchronised: PerArm<bool>,
    /// Faults to inject; indices of arms and axes must fit the cell.
    pub faults: Vec<Fault>,
    /// Rigid objects beside the cube.
    pub objects: Vec<ObjectConfig>,
    /// Probe on the tool of each arm.
    pub probes: PerArm<Option<Probe>>,
    /// Persons who lead a tool by hand.
    pub leads: Vec<LeadConfig>,
    /// Length of a servo period.
    pub period: Length,
    /// Substeps in 2 ms; 4 is the tested figure.
    pub substeps: u32,
}

impl PlantConfig {
    /// Makes the default configuration around a cell's true values, with a solved cube in the
    /// operator's hand.
    #[must_use]
    pub fn new(cell: Cell) -> Self {
        let arms = vec![ArmDynamics::irp6(); cell.arms.len()];
        Self {
            cell,
            arms,
            cube: CubeMechanics::of_2007(),
            jaws: Jaws::rubber(),
            noise: SensorNoise::default(),
            hand: HandScript::default(),
            start: Start::Hand,
            start_grip: 30.0,
            facelets: std::array::from_fn(|i| (i / 9) as u8),
            synchronised: [true; MOST_ARMS],
            faults: Vec::new(),
            objects: Vec::new(),
            probes: [None; MOST_ARMS],
            leads: Vec::new(),
            period: Length::default(),
            substeps: 4,
        }
    }
}

/// Holder of the cube when the run begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Start {
    /// The operator's hand brings the cube.
    Hand,
    /// The cube lies on the table, and no person is in the cell.
    Table(Lying),
    /// The jaws of one arm are closed on the cube; the jaws of the other are open.
    Held {
        /// Index of the arm.
        arm: usize,
        /// The cube in that arm's true tool frame.
        tool_from_cube: Pose,
    },
}

/// Initial pose of the cube on the table, around the place of hand-over.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lying {
    /// Offset of the true middle of the place from the believed one, along the world's x and y (m).
    pub offset: [f64; 2],
    /// Share of the place's half extents over which the place of the cube is drawn uniformly.
    pub spread: f64,
    /// Greatest turn about the vertical, either way (rad).
    pub yaw: f64,
    /// Whether the cube lies on any of its faces; otherwise U is up.
    pub any_face: bool,
}

impl Lying {
    /// Returns the initial frame of the cube on the table, in the world, drawn at random around the
    /// place of hand-over.
    pub(super) fn drawn(&self, cell: &Cell, random: &mut Pcg64) -> Frame {
        let mut within = |most: f64| most * random.random_range(-1.0..=1.0);
        let place = Frame::from_pose(&cell.hand.world_from_cube);
        let half = cell.hand.half_extent * self.spread;
        let (x, y, yaw) = (within(half.x), within(half.y), within(self.yaw));
        let mut at = place.point(&Vector3::new(x, y, 0.0));
        at += Vector3::new(self.offset[0], self.offset[1], 0.0);
        at.z = cell.table_height + 0.5 * cell.cube.edge;
        let turned = |axis: Vector3<f64>, quarters: u8| {
            rotation(&(axis * (f64::from(quarters) * std::f64::consts::FRAC_PI_2)))
        };
        // The face is drawn in any case, so that all other draws are the same with U up.
        let face = match (self.any_face, random.random_range(0..6_u8)) {
            (false, _) => Matrix3::identity(),
            (true, up @ 0..4) => turned(Vector3::x(), up),
            (true, up) => turned(Vector3::y(), if up == 4 { 1 } else { 3 }),
        };
        Frame { r: place.r * rotation(&(Vector3::z() * yaw)) * face, p: at }
    }
}

/// Masses, compliance and drives of an arm; arrays in the order of the axes, track first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmDynamics {
    /// Links.
    pub links: [Link; AXES],
    /// Stiffness between motor and joint (N/m, Nm/rad).
    pub stiffness: [f64; AXES],
    /// Damping between motor and joint (Ns/m, Nms/rad).
    pub damping: [f64; AXES],
    /// Half width of the play in each gear, at the joint (m, rad).
    pub play: [f64; AXES],
    /// Motors.
    pub motors: [MotorDynamics; AXES],
    /// Share of the gravity torque on the motors of axes 2 and 3 that counterbalance springs carry
    /// at the start pose. The torque of the springs is the same everywhere in the workspace. The
    /// masses of `links` do not include the springs.
    pub counterbalance: f64,
    /// Factor of gravity: 1, or 0 in tests.
    pub gravity: f64,
}

/// A motor with its power stage, seen at the motor shaft.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotorDynamics {
    /// Inertia of the rotor and the gear's fast side (kg m2).
    pub inertia: f64,
    /// Torque at standstill and pulse width 255 (Nm).
    pub stall_torque: f64,
    /// Speed without load at pulse width 255 (rad/s).
    pub no_load_speed: f64,
    /// Coulomb friction at the *joint* (N or Nm); the present transmission ratio takes it to the
    /// shaft.
    pub coulomb: f64,
    /// Viscous friction at the shaft (Nms/rad).
    pub viscous: f64,
    /// Current at standstill and full pulse width (A); it falls to 0 at the no-load speed.
    pub stall_current: f64,
    /// Current that trips the power stage (A).
    pub trip_current: f64,
    /// Current that the motor can carry for any time (A). The power stage also trips when the mean
    /// square over [`MotorDynamics::HEATS`] exceeds the square of this current.
    pub rated_current: f64,
}

impl MotorDynamics {
    /// Thermal time constant of a winding (s).
    pub const HEATS: f64 = 30.0;
}

impl ArmDynamics {
    /// Returns the assumed dynamics of an `IRp-6`. The rotors have 1e-3 kg m2 (main axes) and 3e-4
    /// (wrist). The stall torque follows from a mechanical time constant of 40 ms with the
    /// reflected load and a no-load speed of 330 rad/s. The stall current is 1.5 times the trip
    /// current of the controllers of 2007. The rated current is 0.4 of the trip current, as in DC
    /// servo motors whose peak torque is 2.5 times the rated one. The gears have a play of 0.7 arc
    /// minutes (main axes) and 2 (wrist).
    #[must_use]
    pub fn irp6() -> Self {
        let motor = |inertia: f64, load: f64, coulomb: f64, trip_current: f64| MotorDynamics {
            inertia,
            // From standstill the speed rises as w0 (1 - exp(-t / tau)): J w0 / tau at first.
            stall_torque: (inertia + load) * 330.0 / 0.040,
            no_load_speed: 330.0,
            coulomb,
            viscous: 1e-5,
            stall_current: 1.5 * trip_current,
            trip_current,
            rated_current: 0.4 * trip_current,
        };
        Self {
            links: LINKS,
            stiffness: [2e7, 60e3, 60e3, 40e3, 12e3, 8e3, 8e3],
            damping: [6.5e3, 90.0, 90.0, 60.0, 8.0, 3.0, 1.5],
            play: [2e-5, 1e-4, 1e-4, 1e-4, 3e-4, 3e-4, 3e-4],
            motors: [
                motor(1e-3, 8.5e-5, 40.0, 25.0),
                motor(1e-3, 4.8e-4, 3.0, 15.0),
                motor(1e-3, 6.7e-4, 3.0, 18.0),
                motor(1e-3, 3.3e-4, 3.0, 10.0),
                motor(3e-4, 1.2e-5, 3.0, 10.0),
                motor(3e-4, 6.5e-6, 3.0, 10.0),
                motor(3e-4, 0.0, 3.0, 10.0),
            ],
            counterbalance: 1.0,
            gravity: 1.0,
        }
    }
}

/// Friction and play between the layers of a cube, per interface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CubeMechanics {
    /// Torque that turns an unloaded layer (Nm).
    pub turning_torque: f64,
    /// Detent (Nm): `|sin 2 phi|` times this is added to the turning torque of a layer that is
    /// turned by the angle phi.
    pub detent: f64,
    /// Coefficient of the friction that grows with load.
    pub friction: f64,
    /// Half width of the play across the axis (m).
    pub play: f64,
    /// Half width of the play in tilt (rad).
    pub tilt_play: f64,
    /// Stiffness across the axis, beyond the play (N/m).
    pub stiffness: f64,
    /// Stiffness in tilt, beyond the play (Nm/rad).
    pub tilt_stiffness: f64,
    /// Misalignment of another layer from which on it blocks the turn (rad).
    pub corner_cut: f64,
    /// Relative spread of `turning_torque` between the six interfaces.
    pub spread: f64,
}

impl CubeMechanics {
    /// Returns the mechanics of a usual cube of 2007, the year of the robot that the cell is like.
    #[must_use]
    pub fn of_2007() -> Self {
        Self {
            turning_torque: 0.30,
            detent: 0.1,
            friction: 0.30,
            play: 0.2e-3,
            tilt_play: 0.4_f64.to_radians(),
            stiffness: 2e5,
            tilt_stiffness: 150.0,
            corner_cut: 8.0_f64.to_radians(),
            spread: 0.1,
        }
    }

    /// Returns the mechanics of a light and loose cube of today.
    #[must_use]
    pub fn modern() -> Self {
        Self {
            turning_torque: 0.06,
            friction: 0.15,
            play: 0.4e-3,
            tilt_play: 1.0_f64.to_radians(),
            corner_cut: 40.0_f64.to_radians(),
            ..Self::of_2007()
        }
    }

    /// Returns the mechanics of a cube that was never oiled.
    #[must_use]
    pub fn dry() -> Self {
        Self {
            turning_torque: 0.60,
            friction: 0.45,
            play: 0.1e-3,
            tilt_play: 0.2_f64.to_radians(),
            corner_cut: 5.0_f64.to_radians(),
            ..Self::of_2007()
        }
    }
}

/// Pads and palm stops of a gripper, in tool axes (jaws along y, approach along z).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jaws {
    /// Stiffness along x, y, z (N/m); y is both pads together.
    pub stiffness: [f64; 3],
    /// Stiffness about x, y, z (Nm/rad).
    pub rotation: [f64; 3],
    /// Coefficient of friction on stickers.
    pub friction: f64,
    /// Stiffness of the palm's stops (N/m).
    pub palm: f64,
    /// Greatest grip: the jaw's clutch slips there (N).
    pub greatest_grip: f64,
    /// Mass at the pads that equals the jaw motor's inertia (kg): 1e-8 kg m2 behind 69,000 rad/m.
    pub mass: f64,
    /// Speed of the jaw motor without load at pulse width 255 (rad/s).
    pub no_load_speed: f64,
    /// Force at standstill and pulse width 255 without a current limit (N).
    pub stall_force: f64,
    /// Friction of the jaw's drive at the pads (N).
    pub coulomb: f64,
    /// Current of the jaw's motor above which its controller trips after a while (A).
    pub trip_current: f64,
}

impl Jaws {
    /// Returns a gripper's jaws with rubber pads.
    #[must_use]
    pub fn rubber() -> Self {
        Self {
            stiffness: [6e4, 3e5, 6e4],
            rotation: [80.0, 100.0, 120.0],
            friction: 0.8,
            palm: 5e5,
            greatest_grip: 60.0,
            mass: 41.0,
            no_load_speed: 1e4,
            stall_force: 150.0,
            coulomb: 2.0,
            trip_current: 0.2,
        }
    }

    /// Returns a gripper's jaws with pads of bare, ground metal.
    #[must_use]
    pub fn stiff() -> Self {
        Self {
            stiffness: [3e5, 1e6, 3e5],
            rotation: [400.0, 600.0, 600.0],
            friction: 0.35,
            ..Self::rubber()
        }
    }
}

/// Errors of a wrist sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SensorNoise {
    /// Noise of each reading, r.m.s. (N).
    pub force: f64,
    /// Noise of each reading, r.m.s. (Nm).
    pub torque: f64,
    /// Step of a reading (N).
    pub force_quantum: f64,
    /// Step of a reading (Nm).
    pub torque_quantum: f64,
    /// Standard deviation of the bias of each component at the start (N).
    pub force_bias: f64,
    /// Standard deviation of the bias of each component at the start (Nm).
    pub torque_bias: f64,
    /// Standard deviation of the drift of the bias in 10 minutes, each component (N); torques drift
    /// by a twentieth of this (Nm).
    pub force_drift: f64,
    /// Delay of a reading (servo periods).
    pub delay_periods: usize,
}

impl Default for SensorNoise {
    fn default() -> Self {
        Self {
            force: 0.05,
            torque: 0.003,
            force_quantum: 1.0 / 40.0,
            torque_quantum: 1.0 / 800.0,
            force_bias: 1.0,
            torque_bias: 0.05,
            force_drift: 0.2,
            delay_periods: 1,
        }
    }
}

impl SensorNoise {
    /// Returns the errors of an ideal sensor, all 0, for tests.
    #[must_use]
    pub fn none() -> Self {
        Self {
            force: 0.0,
            torque: 0.0,
            force_quantum: 0.0,
            torque_quantum: 0.0,
            force_bias: 0.0,
            torque_bias: 0.0,
            force_drift: 0.0,
            delay_periods: 0,
        }
    }
}

/// Behaviour of the operator's hand. The hand is at the side of the cube towards the +x of the
/// hand-over zone, away from the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandScript {
    /// Time at which the hand starts to bring the cube (s).
    pub appears: f64,
    /// Duration of the hand's way to the place of hand-over (s).
    pub arrival: f64,
    /// Place from which the hand comes and to which it leaves, relative to the place of hand-over,
    /// in world axes (m).
    pub start_offset: Vector3<f64>,
    /// Slow sway on the way and after the arrival, r.m.s. per axis (m).
    pub sway: f64,
    /// Typical period of the sway's change (s).
    pub sway_time: f64,
    /// Tremor of 8-10 Hz, amplitude per axis (m).
    pub tremor: f64,
    /// Time in which the hand calms down after its arrival (s): sway and tremor fall to a tenth.
    pub stills: f64,
    /// Standard deviation of the place where the hand holds the cube, per axis, clipped to the zone
    /// (m).
    pub place_spread: f64,
    /// Standard deviation of the cube's tilt in the hand, per axis (rad).
    pub tilt_spread: f64,
    /// Whether the cube comes in any of its 24 orientations, drawn from the seed; otherwise in that
    /// of the zone's pose.
    pub any_orientation: bool,
    /// Number of times that the hand withdraws the cube before it holds the cube out for good.
    pub withdrawals: u32,
    /// Distance by which the hand withdraws the cube (m), towards `start_offset`.
    pub withdrawal: f64,
    /// Stiffness of the hand's hold (N/m); a hundredth of it is the stiffness in rotation (Nm/rad).
    pub stiffness: f64,
    /// Damping of the hand's hold (Ns/m); a hundredth of it is the damping in rotation (Nms/rad).
    pub damping: f64,
    /// Load of a gripper on the cube at which the hand lets go after 0.3 s (N).
    pub release_load: f64,
    /// Longest time from the jaws' closing to the hand's release of the cube (s).
    pub release_time: f64,
    /// Time after its release of the cube from which on the hand may come back for the cube (s).
    /// One gripper must then hold the cube nearly still in the zone: for 1 s if the cube had left
    /// the zone meanwhile, else for another 5 s.
    pub return_after: f64,
    /// Time after which the hand picks up a cube that fell, to hold it out again (s).
    pub picks_up_after: f64,
    /// Whether the hand comes back for a solved cube only (a person sees that).
    pub return_solved_only: bool,
    /// Pull on the cube towards the operator when the hand takes the cube back (N).
    pub pull: f64,
}

impl Default for HandScript {
    fn default() -> Self {
        Self {
            appears: 1.0,
            arrival: 4.0,
            start_offset: Vector3::new(0.25, 0.12, -0.06),
            sway: 3e-3,
            sway_time: 0.7,
            tremor: 0.2e-3,
            stills: 3.0,
            place_spread: 0.02,
            tilt_spread: 4.0_f64.to_radians(),
            any_orientation: true,
            withdrawals: 0,
            withdrawal: 0.15,
            stiffness: 300.0,
            damping: 10.0,
            release_load: 8.0,
            release_time: 2.0,
            return_after: 20.0,
            picks_up_after: 5.0,
            return_solved_only: false,
            pull: 6.0,
        }
    }
}
