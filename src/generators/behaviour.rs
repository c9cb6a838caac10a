//! Orders of MP to an effector: plain data, each complete in itself.
//!
//! - in: the decision of a task
//! - out: a [`Behaviour`], from which [`super::Generator::begin`] makes the generator

use super::compliance::Selector;
use super::legs::Legs;
use super::own::OwnOrder;
use super::visual_servo;
use crate::motion::{Depth, JawCommand, JointPositions};
use crate::spatial::Pose;
use serde::{Deserialize, Serialize};

/// Order from MP to an effector, complete in itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
    /// Motion of the gripper to the cube that the stand-alone camera sees.
    VisualServo(visual_servo::Order),
    /// Motion of a generator that is registered by name: see
    /// [`MotionGenerator`](super::own::MotionGenerator).
    Own(OwnOrder),
}
