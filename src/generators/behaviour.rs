//! Orders from above, and the generators that carry them out.
//!
//! - in: a [`Behaviour`]: plain data, complete in itself
//! - out: a [`Generator`], which is asked for each macrostep

use super::compliance::{Compliance, Selector};
use super::inputs::{Inputs, Sensing};
use super::legs::Legs;
use super::outcome::{Next, Outcome};
use super::{comply, grasp, position, secure, swing, turn, visual_servo};
use crate::motion::{Depth, Direction, JawCommand, JointPositions, Motion, MoveRefused};
use crate::spatial::{Pose, is_rigid};
use serde::{Deserialize, Serialize};

/// What an effector is asked to do: an order from MP, complete in itself.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Behaviour {
    /// Goes to joint positions, all axes arriving together.
    Joints {
        /// Where to.
        target: JointPositions,
        /// Fraction of the full speed, 0..=1.
        speed: f64,
        /// Least duration (s): two arms that must keep pace get the same.
        seconds: f64,
    },
    /// Goes through joint positions, in legs that overlap.
    Legs {
        /// The legs.
        legs: Legs,
        /// Least duration (s): two arms that must keep pace get the same.
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
        /// Least duration (s); longer where the jaws' speed asks for it.
        seconds: f64,
        /// Directions that yield meanwhile.
        selector: Selector,
        /// Whether they go on under a wrench beyond the limits, since to open is what relieves it.
        strained: bool,
    },
    /// Approaches along the tool's z until the palm's stops touch.
    Approach {
        /// Speed in free motion (m/s).
        speed: f64,
        /// Give up after this way (m).
        distance: f64,
        /// Contact force that ends the approach (N).
        force: f64,
        /// Directions that yield besides z.
        selector: Selector,
    },
    /// Draws back along the tool's z, unless somebody holds on.
    Withdraw {
        /// Speed in free motion (m/s).
        speed: f64,
        /// How far (m).
        distance: f64,
        /// Force at which it gives up (N).
        force: f64,
        /// Directions that yield besides z.
        selector: Selector,
    },
    /// Closes the jaws while the arm accommodates.
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
    /// Presses the cube against the stops of the palm, then clenches.
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
    /// Turns the grasped face about the tool's z.
    Turn {
        /// How far, about the tool's z (rad).
        angle: f64,
        /// Speed in free motion (rad/s).
        speed: f64,
        /// Acceleration at both ends (rad/s2).
        acceleration: f64,
        /// Torque at which the turn stands still (Nm).
        torque: f64,
        /// Least mean torque that a turning face must show (Nm).
        least_torque: f64,
        /// Directions that yield besides the turn's own.
        selector: Selector,
        /// Whether the rotation itself follows the velocity whatever the torque (no compliance at
        /// all).
        stiff: bool,
    },
    /// Yields in the selected directions until it is ended from above, or a force limit is passed.
    Comply {
        /// Directions that yield.
        selector: Selector,
    },
    /// Holds the cube out until the operator pulls at it.
    Present {
        /// Force that counts as a pull (N).
        pull: f64,
        /// Directions that yield.
        selector: Selector,
        /// Patience (s).
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
            Self::VisualServo(order) => {
                Kind::VisualServo(visual_servo::VisualServo::new(order, *compliance))
            }
        };
        Generator { kind, swing: swing::Swing::default() }
    }
}

impl Generator {
    /// The next macrostep's set values, or the end; and how the visual sensor should look from now
    /// on, from a generator that uses it.
    pub fn next(&mut self, inputs: &Inputs<'_>) -> (Next, Option<Sensing>) {
        debug_assert!(is_rigid(&inputs.arm.desired_base_from_tool), "{:?}", inputs.arm);
        debug_assert!((0.0..=1.0).contains(&inputs.pace), "pace: {}", inputs.pace);
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

    /// Whether it can go on although its last command was refused for this reason;
    /// `inputs.arm.refused` tells it.
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
