//! Orders of MP to an effector, and the generators that carry them out.
//!
//! - in: a [`Behaviour`]: plain data, complete in itself
//! - out: a [`Generator`], which is asked for the set values of each macrostep

use super::compliance::{Compliance, Selector};
use super::inputs::{Inputs, Sensing};
use super::legs::Legs;
use super::outcome::{Next, Outcome};
use super::{along, comply, grasp, position, secure, swing, turn, visual_servo};
use crate::motion::{Depth, Direction, JawCommand, JointPositions, Motion, MoveRefused};
use crate::spatial::{Pose, is_rigid};
use serde::{Deserialize, Serialize};

/// Order from MP to an effector, complete in itself.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Behaviour {
    /// Motion to joint positions, at which all axes arrive together.
    Joints {
        /// Joint positions at the end.
        target: JointPositions,
        /// Fraction of the full speed, 0..=1.
        speed: f64,
        /// Least duration (s): two arms that must move evenly get the same.
        seconds: f64,
    },
    /// Motion through joint positions, in legs that overlap.
    Legs {
        /// The legs.
        legs: Legs,
        /// Least duration (s): two arms that must move evenly get the same.
        seconds: f64,
    },
    /// Motion of the tool to a pose along a straight line. The track does not move.
    Line {
        /// `base_from_tool` at the end.
        target: Pose,
        /// Fraction of the full speed, 0..=1.
        speed: f64,
    },
    /// Motion of the jaws. The arm keeps its place, or yields where selected.
    Jaw {
        /// Set values at the end.
        jaw: JawCommand,
        /// Least duration (s); longer if the speed of the jaws requires it.
        seconds: f64,
        /// Directions that yield meanwhile.
        selector: Selector,
        /// Whether the jaws move on under a wrench beyond the limits, because opening relieves it.
        strained: bool,
    },
    /// Approach along the tool's z until the palm's stops touch.
    Approach {
        /// Speed in free motion (m/s).
        speed: f64,
        /// Distance after which the approach is given up (m).
        distance: f64,
        /// Contact force that ends the approach (N).
        force: f64,
        /// Directions that yield besides z.
        selector: Selector,
    },
    /// Retraction along the tool's z, which ends if another hand holds the cube.
    Withdraw {
        /// Speed in free motion (m/s).
        speed: f64,
        /// Distance (m).
        distance: f64,
        /// Force of a hand that holds the cube, which ends the retraction (N).
        force: f64,
        /// Directions that yield besides z.
        selector: Selector,
    },
    /// Grasp: the jaws close while the arm adapts its position.
    Grasp {
        /// Grip force (N).
        force: f64,
        /// Width below which the jaws hold nothing (m).
        least_width: f64,
        /// Directions that yield.
        selector: Selector,
        /// Position of the palm's stops.
        stops: Depth,
    },
    /// Pressing of the cube against the stops of the palm, then clenching.
    Secure {
        /// Pressing force (N).
        press: f64,
        /// Grip force (N).
        force: f64,
        /// Directions that yield besides z.
        selector: Selector,
        /// Position of the palm's stops.
        stops: Depth,
    },
    /// Turn of the grasped face about the tool's z.
    Turn {
        /// Angle about the tool's z (rad).
        angle: f64,
        /// Speed in free motion (rad/s).
        speed: f64,
        /// Acceleration at both ends (rad/s2).
        acceleration: f64,
        /// Torque at which the turn stops (Nm).
        torque: f64,
        /// Least mean torque that a turning face shows (Nm).
        least_torque: f64,
        /// Directions that yield besides the turn's own.
        selector: Selector,
        /// Whether the rotation follows the velocity at any torque, without compliance.
        stiff: bool,
    },
    /// Yielding in the selected directions until MP ends the behaviour, or a force limit is
    /// exceeded.
    Comply {
        /// Directions that yield.
        selector: Selector,
    },
    /// Holding of the cube until the operator pulls at it.
    Present {
        /// Force of a pull (N).
        pull: f64,
        /// Directions that yield.
        selector: Selector,
        /// Longest time to wait (s).
        seconds: f64,
    },
    /// Guarded straight motion along axes of the base or the tool.
    Along(along::Order),
    /// Motion of the gripper to the cube that the stand-alone camera sees.
    VisualServo(visual_servo::Order),
}

/// Generator of a behaviour, with its memory.
#[derive(Debug, Clone)]
pub struct Generator {
    kind: Kind,
    swing: swing::Swing,
}

/// The generator of one kind of motion.
#[derive(Debug, Clone)]
enum Kind {
    Position(position::Position),
    Grasp(grasp::Grasp),
    Secure(secure::Secure),
    Turn(turn::Turn),
    Comply(comply::Comply),
    Along(along::Along),
    VisualServo(visual_servo::VisualServo),
}

impl Behaviour {
    /// Makes the generator that carries out this behaviour on an arm with this `compliance`.
    /// `speeds` are the full speeds of position control.
    #[must_use]
    pub fn generator(&self, compliance: &Compliance, speeds: &position::Speeds) -> Generator {
        let kind = match *self {
            Self::Joints { target, speed, seconds } => Kind::Position(position::Position::joints(
                target,
                (speed, seconds),
                speeds,
                compliance.macrostep,
            )),
            Self::Legs { legs, seconds } => Kind::Position(position::Position::legs(
                legs,
                seconds,
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
            Self::Turn { angle, speed, acceleration, torque, least_torque, selector, stiff } => {
                let order = turn::Order {
                    angle,
                    speed,
                    acceleration,
                    torque,
                    least_torque,
                    selector,
                    stiff,
                };
                Kind::Turn(turn::Turn::new(order, *compliance))
            }
            Self::Comply { selector } => {
                Kind::Comply(comply::Comply::until_ended(selector, *compliance))
            }
            Self::Present { pull, selector, seconds } => {
                Kind::Comply(comply::Comply::until_pulled(pull, selector, seconds, *compliance))
            }
            Self::Along(order) => Kind::Along(along::Along::new(order, *compliance)),
            Self::VisualServo(order) => {
                Kind::VisualServo(visual_servo::VisualServo::new(order, *compliance))
            }
        };
        Generator { kind, swing: swing::Swing::default() }
    }
}

impl Generator {
    /// Returns the command of the next macrostep, or how the behaviour ended; and, from a generator
    /// that uses the visual sensor, where in the picture and at which exposure the sensor must look
    /// from now on.
    pub fn next(&mut self, inputs: &Inputs<'_>) -> (Next, Option<Sensing>) {
        debug_assert!(is_rigid(&inputs.arm.desired_base_from_tool), "not rigid: {:?}", inputs.arm);
        debug_assert!((0.0..=1.0).contains(&inputs.pace), "pace: {}", inputs.pace);
        // An oscillation ends any behaviour, before its own limits name another cause.
        if let Some(oscillates) = self.swing.note(inputs) {
            return (Next::Done(oscillates), None);
        }
        let next = match &mut self.kind {
            // Position control computes its set values by its own clock, which it slows down
            // itself.
            Kind::Position(g) => g.next(inputs),
            Kind::Grasp(g) => slowed(g.next(inputs), inputs),
            Kind::Secure(g) => slowed(g.next(inputs), inputs),
            Kind::Turn(g) => slowed(g.next(inputs), inputs),
            Kind::Comply(g) => slowed(g.next(inputs), inputs),
            Kind::Along(g) => slowed(g.next(inputs), inputs),
            // The only generator that orders the visual sensor.
            Kind::VisualServo(g) => {
                let (next, sensing) = g.next(inputs);
                return (slowed(next, inputs), Some(sensing));
            }
        };
        // The last peak of an oscillation may exceed the limit before the oscillation is detected.
        if let Next::Done(Outcome::OverForce(direction, _)) = next
            && let Some(oscillates) = self.swing.swinging(direction)
        {
            return (Next::Done(oscillates), None);
        }
        (next, None)
    }

    /// Returns whether the generator can continue although its last command was refused for the
    /// reason `why`. Its next call gets this reason in `inputs.arm.refused`.
    #[must_use]
    pub fn tolerates(&self, why: &MoveRefused) -> bool {
        matches!(self.kind, Kind::VisualServo(_)) && visual_servo::VisualServo::tolerates(why)
    }
}

/// Slows a command down by the factor `inputs.pace` (0..=1), which multiplies the velocities of a
/// task motion and the step from the present set pose to the next one. The end of a behaviour stays
/// as it is.
fn slowed(next: Next, inputs: &Inputs<'_>) -> Next {
    let Next::Go(mut command) = next else { return next };
    match &mut command.motion {
        // A direction that only seeks a force is not slowed: the force must not depend on a pause.
        Motion::Task { directions, .. } => {
            for direction in directions {
                if let Direction::Unguarded { velocity } | Direction::Guarded { velocity, .. } =
                    direction
                {
                    *velocity *= inputs.pace;
                }
            }
        }
        // The tool makes only a part of the step from the present set pose.
        Motion::Pose(pose) if inputs.pace < 1.0 => {
            let from = inputs.arm.desired_base_from_tool;
            *pose = Pose::from_parts(
                from.translation.vector.lerp(&pose.translation.vector, inputs.pace).into(),
                from.rotation.slerp(&pose.rotation, inputs.pace),
            );
        }
        // At full pace the pose is kept exactly. The other motions come from position control
        // alone.
        Motion::Pose(_) | Motion::Hold | Motion::MotorsBy(_) | Motion::Joints(_) => {}
    }
    Next::Go(command)
}
