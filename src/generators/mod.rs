//! Motion generators: transition functions from inputs and memory to the next set values.
//!
//! - in: the arm's state, the latest target of the visual sensor, the servo period's number ([`Inputs`])
//! - out: the command of the next macrostep, or an [`Outcome`] ([`Next`]); and, from those that watch, how the
//!   visual sensor should look from now on ([`Sensing`])
//! - source: Zieliński et al. (2007), pp. 370-371 and 374: pure position control, grasping, securing, turning,
//!   and the visual servo
//!
//! An order from above is a [`Behaviour`], plain data; [`Behaviour::generator`] makes the generator. Who runs
//! it is the coordination scheme's business: an ECP (sporadic) or MP itself (continuous).

pub mod comply;
pub mod grasp;
pub mod position;
pub mod secure;
pub mod swing;
pub mod turn;
pub mod visual_servo;

use crate::motion::{
    ArmState, Depth, Direction, Frame, JawCommand, JointPositions, Motion, MoveCommand, MoveRefused,
};
use crate::spatial::{Pose, Wrench};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// What a generator may look at.
#[derive(Debug, Clone, Copy)]
pub struct Inputs<'a> {
    /// State of the arm two periods before the macrostep ends.
    pub arm: &'a ArmState,
    /// Latest pose of the cube from the stand-alone camera, if any.
    pub target: Option<&'a Target>,
    /// Number of the present servo period.
    pub period: u64,
    /// Share of its speed at which the generator may go on, 0..=1: below 1 while a pause brings the arm to rest.
    pub pace: f64,
}

/// The cube as the visual sensor saw it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Target {
    /// `world_from_cube`; its axes are along the edges, up to the cube's own symmetry.
    pub world_from_cube: Pose,
    /// Speed of the centre [m/s].
    pub speed: f64,
    /// Servo period of the exposure.
    pub period: u64,
}

/// How a visual sensor is to look: the configuration that a generator returns to its VSP.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Sensing {
    /// Which part of the picture is searched.
    pub window: Window,
    /// What happens when nothing is found there.
    pub mode: Mode,
    /// Exposure, as a multiple of the camera's nominal one.
    pub exposure: f64,
}

/// Which part of the picture is searched first.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Window {
    /// All of it.
    Whole,
    /// Where the sensor's own track expects the cube, or else around this place.
    Around {
        /// Centre of the cube in the world [m].
        centre: Vector3<f64>,
        /// How far from there it may be [m].
        reach: f64,
    },
}

/// What happens when the window shows nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Mode {
    /// The whole picture is searched as well.
    Seek,
    /// Nothing: a false cube elsewhere would be worse than none.
    Track,
}

impl Sensing {
    /// Everywhere, at the nominal exposure.
    pub const SEEK: Self = Self { window: Window::Whole, mode: Mode::Seek, exposure: 1.0 };
}

/// A generator's answer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Next {
    /// Execute this and ask again.
    Go(MoveCommand),
    /// The behaviour has come to its end.
    Done(Outcome),
}

/// How a behaviour ended. A failed step of the task is an outcome, not an error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Outcome {
    /// The target is reached.
    Reached,
    /// The palm's stops touch the cube, this far along the way [m].
    Touched(f64),
    /// Nothing was touched on the whole way.
    NotTouched,
    /// The jaws hold something of this width [m].
    Grasped(f64),
    /// The jaws closed on nothing.
    Empty(f64),
    /// The cube is seated and clenched.
    Secured,
    /// The face has been turned by this angle [rad].
    Turned(f64),
    /// The hand has turned by this angle [rad] against so little torque [Nm] that no face can have followed: a grip
    /// slips.
    Slipped(f64, f64),
    /// The wrench swings in this direction with this amplitude [N], [Nm] at this frequency [Hz].
    Oscillates(usize, f64, f64),
    /// The turn stopped at this angle [rad] under this torque [Nm].
    Stalled(f64, f64),
    /// A force [N] or torque [Nm] beyond the set limit, in this direction.
    OverForce(usize, f64),
    /// What the jaws hold has forced them apart by this since the behaviour began [m]: it turns between them.
    ForcedApart(f64),
    /// Ended from above.
    Ended,
    /// The operator pulls at the cube.
    Pulled,
    /// The visual sensor has lost the cube for this long [s].
    LostSight(f64),
    /// The cube stayed outside the place of hand-over for this long [s].
    OutOfZone(f64),
    /// The arm cannot get to where the cube is held, for this reason.
    OutOfReach(MoveRefused),
    /// It took longer than allowed [s].
    TimedOut(f64),
}

impl std::fmt::Display for Outcome {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        const DIRECTIONS: [&str; 6] =
            ["along x", "along y", "along z", "about x", "about y", "about z"];
        match *self {
            Self::Reached => f.write_str("the target is reached"),
            Self::Touched(way) => write!(f, "touched after {:.1} mm", way * 1e3),
            Self::NotTouched => f.write_str("nothing was touched on the way"),
            Self::Grasped(width) => write!(f, "the jaws hold {:.1} mm", width * 1e3),
            Self::Empty(width) => write!(f, "the jaws closed to {:.1} mm on nothing", width * 1e3),
            Self::Secured => f.write_str("the cube is seated"),
            Self::Turned(angle) => write!(f, "turned by {:.0} deg", angle.to_degrees()),
            Self::Stalled(angle, torque) => {
                write!(f, "stood still after {:.0} deg under {torque:.1} Nm", angle.to_degrees())
            }
            Self::Slipped(angle, torque) => write!(
                f,
                "slip: the hand turned by {:.0} deg against {torque:.2} Nm only, so no face followed it",
                angle.to_degrees()
            ),
            Self::Oscillates(direction, size, hertz) => {
                let unit = if direction < 3 { "N" } else { "Nm" };
                write!(
                    f,
                    "oscillation of {size:.1} {unit} at {hertz:.1} Hz {}",
                    DIRECTIONS[direction.min(5)]
                )
            }
            Self::OverForce(direction, size) => {
                let unit = if direction < 3 { "N" } else { "Nm" };
                write!(
                    f,
                    "over-force of {size:.1} {unit}, most of it {}",
                    DIRECTIONS[direction.min(5)]
                )
            }
            Self::ForcedApart(way) => {
                write!(f, "slip: the cube has forced the jaws apart by {:.1} mm", way * 1e3)
            }
            Self::Ended => f.write_str("ended from above"),
            Self::Pulled => f.write_str("the operator pulls"),
            Self::LostSight(seconds) => write!(f, "the cube was out of sight for {seconds:.1} s"),
            Self::OutOfZone(seconds) => {
                write!(f, "the cube stayed outside the place of hand-over for {seconds:.1} s")
            }
            Self::OutOfReach(why) => write!(f, "the arm does not get there ({why})"),
            Self::TimedOut(seconds) => write!(f, "not done in {seconds:.1} s"),
        }
    }
}

impl Outcome {
    /// Whether it ends the partner's behaviour too.
    #[must_use]
    pub fn alarms(&self) -> bool {
        matches!(self, Self::OverForce(..) | Self::Oscillates(..) | Self::ForcedApart(_))
    }

    /// A behaviour's end in words, for the operator.
    #[must_use]
    pub fn words(outcome: Option<Self>) -> String {
        outcome
            .map_or_else(|| "it did not come to an end".to_owned(), |outcome| outcome.to_string())
    }
}

/// How compliant directions behave, the macrostep, jaws and limits: one set for all generators of an arm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Compliance {
    /// B of the linear directions [m/(s N)].
    pub linear_admittance: f64,
    /// M of the linear directions [kg].
    pub linear_inertia: f64,
    /// B of the angular directions [rad/(s Nm)].
    pub angular_admittance: f64,
    /// M of the angular directions [kg m2].
    pub angular_inertia: f64,
    /// Periods of a macrostep.
    pub macrostep: u32,
    /// Speed of closing jaws, distance of the pads [m/s].
    pub jaw_close_speed: f64,
    /// Largest speed of opening jaws [m/s].
    pub jaw_open_speed: f64,
    /// Force at which a behaviour gives up [N].
    pub force_limit: f64,
    /// Torque at which a behaviour gives up [Nm].
    pub torque_limit: f64,
}

/// Jaws that hold the cube and are forced apart by more do not lie flat on it any more [m]: a cube that turns between
/// fingers of 12 mm about the palm's axis stands askew by 6 deg then.
pub const FORCED_APART: f64 = 0.001;

/// Which directions of the tool frame yield: x, y, z, then rotations about them.
pub type Selector = [bool; 6];

impl Compliance {
    /// The directions of a task in which the selected ones seek zero force and the others stand still.
    #[must_use]
    pub fn yielding(&self, selector: &Selector) -> [Direction; 6] {
        std::array::from_fn(|i| if selector[i] { self.contact(i, 0.0) } else { Direction::HOLD })
    }

    /// A direction that seeks a force [N] or torque [Nm].
    #[must_use]
    pub fn contact(&self, direction: usize, wanted: f64) -> Direction {
        let (admittance, inertia) = if direction < 3 {
            (self.linear_admittance, self.linear_inertia)
        } else {
            (self.angular_admittance, self.angular_inertia)
        };
        Direction::Contact { wanted, admittance, inertia }
    }

    /// A task motion in the tool frame for one macrostep.
    #[must_use]
    pub fn task(&self, directions: [Direction; 6], jaw: Option<JawCommand>) -> MoveCommand {
        MoveCommand {
            motion: Motion::Task { frame: Frame::Tool, directions },
            periods: self.macrostep,
            jaw,
        }
    }

    /// Whether jaws that were no farther apart [m] since a turn began are forced apart by what they hold. What stood askew
    /// between them when it began comes through the upright before it forces them apart the other way.
    fn forced_apart(jaws: &mut Option<f64>, arm: &ArmState) -> Option<Outcome> {
        let least = jaws.map_or(arm.jaw_opening, |least| least.min(arm.jaw_opening));
        *jaws = Some(least);
        let apart = arm.jaw_opening - least;
        (apart > FORCED_APART).then_some(Outcome::ForcedApart(apart))
    }

    /// The first direction in which the arm's wrench is beyond the limits.
    #[must_use]
    pub fn excess(&self, arm: &ArmState) -> Option<Outcome> {
        self.unyielding(&[false; 6], arm)
    }

    /// The first that is beyond the limits and does not yield: of the force, then of the torque, the direction that has
    /// most of it, and all of it.
    #[must_use]
    pub fn unyielding(&self, selector: &Selector, arm: &ArmState) -> Option<Outcome> {
        let Wrench { force, torque } = arm.wrench_in_tool;
        [(0, force, self.force_limit), (3, torque, self.torque_limit)]
            .into_iter()
            .map(|(first, vector, limit)| (first + vector.iamax(), vector.norm(), limit))
            .find(|(direction, much, limit)| much > limit && !selector[*direction])
            .map(|(direction, much, _)| Outcome::OverForce(direction, much))
    }
}

/// What an effector is asked to do: an order from MP, complete in itself.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Behaviour {
    /// Goes to joint positions, all axes arriving together.
    Joints {
        /// Where to.
        target: JointPositions,
        /// Fraction of the full speed, 0..=1.
        speed: f64,
        /// Least duration [s]: two arms that must keep pace get the same.
        seconds: f64,
    },
    /// Goes to a pose of the tool along a straight line; d0 stays.
    Line {
        /// `base_from_tool` at the end.
        target: Pose,
        /// Fraction of the full speed, 0..=1.
        speed: f64,
    },
    /// Moves the jaws; the arm keeps its place, or yields where selected.
    Jaw {
        /// Set values at the end.
        jaw: JawCommand,
        /// Least duration [s]; longer where the jaws' speed asks for it.
        seconds: f64,
        /// Directions that yield meanwhile.
        selector: Selector,
        /// Whether they go on under a wrench beyond the limits, since to open is what relieves it.
        strained: bool,
    },
    /// Approaches along the tool's z until the palm's stops touch.
    Approach {
        /// Speed in free motion [m/s].
        speed: f64,
        /// Give up after this way [m].
        distance: f64,
        /// Contact force that ends the approach [N].
        force: f64,
        /// Directions that yield besides z.
        selector: Selector,
    },
    /// Draws back along the tool's z, unless somebody holds on.
    Withdraw {
        /// Speed in free motion [m/s].
        speed: f64,
        /// How far [m].
        distance: f64,
        /// Force at which it gives up [N].
        force: f64,
        /// Directions that yield besides z.
        selector: Selector,
    },
    /// Closes the jaws while the arm accommodates.
    Grasp {
        /// Grip force [N].
        force: f64,
        /// Width below which the jaws hold nothing [m].
        least_width: f64,
        /// Directions that yield.
        selector: Selector,
        /// Position of the palm's stops.
        stops: Depth,
    },
    /// Presses the cube against the stops of the palm, then clenches.
    Secure {
        /// Pressing force [N].
        press: f64,
        /// Grip force [N].
        force: f64,
        /// Directions that yield besides z.
        selector: Selector,
        /// Position of the palm's stops.
        stops: Depth,
    },
    /// Turns the grasped face about the tool's z.
    Turn {
        /// How far, about the tool's z [rad].
        angle: f64,
        /// Speed in free motion [rad/s].
        speed: f64,
        /// Torque at which the turn stands still [Nm].
        torque: f64,
        /// Least mean torque that a turning face must show [Nm].
        least_torque: f64,
        /// Directions that yield besides the turn's own.
        selector: Selector,
        /// Whether the rotation itself follows the velocity whatever the torque (no compliance at all).
        stiff: bool,
    },
    /// Yields in the selected directions until it is ended from above, or a force limit is passed.
    Comply {
        /// Directions that yield.
        selector: Selector,
    },
    /// Holds the cube out until the operator pulls at it.
    Present {
        /// Force that counts as a pull [N].
        pull: f64,
        /// Directions that yield.
        selector: Selector,
        /// Patience [s].
        seconds: f64,
    },
    /// Leads the gripper to the cube that the stand-alone camera sees.
    VisualServo(visual_servo::Order),
}

/// The generator of a behaviour with its memory.
#[derive(Debug, Clone)]
pub struct Generator {
    kind: Kind,
    swing: swing::Swing,
}

#[derive(Debug, Clone)]
enum Kind {
    Position(position::Position),
    Grasp(grasp::Grasp),
    Secure(secure::Secure),
    Turn(turn::Turn),
    Comply(comply::Comply),
    VisualServo(visual_servo::VisualServo),
}

impl Behaviour {
    /// Makes the generator; `speeds` are the full speeds of position control.
    #[must_use]
    pub fn generator(&self, compliance: &Compliance, speeds: &position::Speeds) -> Generator {
        let kind = match *self {
            Self::Joints { target, speed, seconds } => Kind::Position(position::Position::joints(
                target,
                (speed, seconds),
                speeds,
                compliance.macrostep,
            )),
            Self::Line { target, speed } => Kind::Position(position::Position::line(
                target,
                speed,
                speeds,
                compliance.macrostep,
            )),
            Self::Jaw { jaw, seconds, selector, strained } => {
                Kind::Grasp(grasp::Grasp::jaw_only(jaw, seconds, selector, strained, *compliance))
            }
            Self::Approach { speed, distance, force, selector } => Kind::Secure(
                secure::Secure::approach(speed, distance, force, selector, *compliance),
            ),
            Self::Withdraw { speed, distance, force, selector } => Kind::Secure(
                secure::Secure::withdraw(speed, distance, force, selector, *compliance),
            ),
            Self::Grasp { force, least_width, selector, stops } => {
                Kind::Grasp(grasp::Grasp::new(force, least_width, selector, stops, *compliance))
            }
            Self::Secure { press, force, selector, stops } => {
                Kind::Secure(secure::Secure::press(press, force, selector, stops, *compliance))
            }
            Self::Turn { angle, speed, torque, least_torque, selector, stiff } => {
                let torques = (least_torque, torque);
                Kind::Turn(turn::Turn::new(angle, speed, torques, selector, stiff, *compliance))
            }
            Self::Comply { selector } => {
                Kind::Comply(comply::Comply::until_ended(selector, *compliance))
            }
            Self::Present { pull, selector, seconds } => {
                Kind::Comply(comply::Comply::until_pulled(pull, selector, seconds, *compliance))
            }
            Self::VisualServo(order) => {
                Kind::VisualServo(visual_servo::VisualServo::new(order, *compliance))
            }
        };
        Generator { kind, swing: swing::Swing::default() }
    }
}

impl Generator {
    /// The next macrostep's set values, or the end; and how the visual sensor should look from now on, from a
    /// generator that uses it.
    pub fn next(&mut self, inputs: &Inputs<'_>) -> (Next, Option<Sensing>) {
        if let Some(oscillates) = self.swing.note(inputs) {
            return (Next::Done(oscillates), None);
        }
        let next = match &mut self.kind {
            // Its set values are a function of time, so its time goes slower.
            Kind::Position(g) => g.next(inputs),
            Kind::Grasp(g) => slowed(g.next(inputs), inputs),
            Kind::Secure(g) => slowed(g.next(inputs), inputs),
            Kind::Turn(g) => slowed(g.next(inputs), inputs),
            Kind::Comply(g) => slowed(g.next(inputs), inputs),
            Kind::VisualServo(g) => {
                let (next, sensing) = g.next(inputs);
                return (slowed(next, inputs), Some(sensing));
            }
        };
        if let Next::Done(Outcome::OverForce(direction, _)) = next
            && let Some(oscillates) = self.swing.swinging(direction)
        {
            return (Next::Done(oscillates), None);
        }
        (next, None)
    }

    /// Whether it can go on although its last command was refused for this reason; `inputs.arm.refused` tells it.
    #[must_use]
    pub fn bears(&self, why: &MoveRefused) -> bool {
        matches!(self.kind, Kind::VisualServo(_)) && visual_servo::VisualServo::bears(why)
    }
}

/// The same command at the pace of the inputs: velocities, and steps from the present set value.
fn slowed(next: Next, inputs: &Inputs<'_>) -> Next {
    let Next::Go(mut command) = next else { return next };
    match &mut command.motion {
        Motion::Task { directions, .. } => {
            for direction in directions {
                if let Direction::Unguarded { velocity } | Direction::Guarded { velocity, .. } =
                    direction
                {
                    *velocity *= inputs.pace;
                }
            }
        }
        Motion::Pose(pose) if inputs.pace < 1.0 => {
            let from = inputs.arm.desired_base_from_tool;
            *pose = Pose::from_parts(
                from.translation.vector.lerp(&pose.translation.vector, inputs.pace).into(),
                from.rotation.slerp(&pose.rotation, inputs.pace),
            );
        }
        Motion::Pose(_)
        | Motion::Hold
        | Motion::Motors(_)
        | Motion::MotorsBy(_)
        | Motion::Joints(_) => {}
    }
    Next::Go(command)
}

#[cfg(test)]
mod testing {
    use super::Compliance;

    /// What tests of generators yield with.
    pub(super) fn compliance() -> Compliance {
        Compliance {
            jaw_close_speed: 0.012,
            jaw_open_speed: 0.03,
            linear_admittance: 0.001,
            linear_inertia: 20.0,
            angular_admittance: 0.05,
            angular_inertia: 0.5,
            macrostep: 8,
            force_limit: 40.0,
            torque_limit: 5.0,
        }
    }
}
