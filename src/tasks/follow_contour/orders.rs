//! The orders of both programmes, and the signals between them.
//!
//! - in: places from the door
//! - out: plain data

use crate::generators::contact::ContourOrder;
use crate::motion::JointPositions;
use crate::spatial::Pose;
use serde::{Deserialize, Serialize};

/// Name of the programme that follows the contour.
pub const FOLLOW: &str = "follow_contour";
/// Name of the programme that picks parts and passes one on.
pub const PICK: &str = "pick_and_pass";

/// Signals, in the order in which they are sent.
pub mod signals {
    /// The first arm has followed the contour; its value is [`Followed`].
    ///
    /// [`Followed`]: crate::generators::contact::Followed
    pub const FOLLOWED: &str = "followed";
    /// The second arm has laid down its parts and holds the last one.
    pub const HOLDS: &str = "holds";
    /// MP: the second arm is to hold the part out.
    pub const PRESENT: &str = "present";
    /// The second arm holds it out.
    pub const PRESENTED: &str = "presented";
    /// MP: the first arm is to grip the part.
    pub const TAKE: &str = "take";
    /// The first arm grips it.
    pub const TAKEN: &str = "taken";
    /// MP: the second arm is to let go and withdraw.
    pub const RELEASE: &str = "release";
    /// The second arm has withdrawn.
    pub const RELEASED: &str = "released";
    /// MP: the first arm is to lay the part down.
    pub const LAY: &str = "lay";
}

/// Place that a hand reaches from above.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Spot {
    /// Joint positions above the place.
    pub joints: JointPositions,
    /// `base_from_tool` there.
    pub above: Pose,
    /// Distance down to the place (m).
    pub down: f64,
}

/// Hand that grips parts, and the pace of its arm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Hand {
    /// Distance of the open pads (m).
    pub open: f64,
    /// Least width of a part (m).
    pub least: f64,
    /// Grip force (N).
    pub grip: f64,
    /// Share of the full speed in free motion.
    pub pace: f64,
}

/// Order to follow a contour, and then to take a part and to lay it down.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FollowerOrder {
    /// Place of the tool at the beginning of the contour.
    pub begin: Spot,
    /// The contour.
    pub contour: ContourOrder,
    /// Place of the hand at the part that is handed over.
    pub take: Spot,
    /// Place of the hand when this part lies at its goal.
    pub goal: Spot,
    /// The hand.
    pub hand: Hand,
}

/// Order to pick parts, to lay them down, and to pass the last one on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PickerOrder {
    /// Places of the hand at each part that it lays down, and at the part's goal.
    pub parts: Vec<(Spot, Spot)>,
    /// Place of the hand at the last part.
    pub last: Spot,
    /// Place of the hand that holds this part out.
    pub present: Spot,
    /// The hand.
    pub hand: Hand,
}
