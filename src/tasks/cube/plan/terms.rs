//! The terms of a plan: the holds and turns that are allowed, and what motions cost.
//!
//! Palms are never on one face, nor jaws along their own palm's axis. Further rules for two holds:
//!
//! | palms | jaws | both can hold if |
//! |---|---|---|
//! | opposed | across each other | always |
//! | opposed | on one axis | at most three layers in sum |
//! | adjacent | both on the third axis | at most three layers in sum |
//! | adjacent | one hand's finger under the other's palm | palms have clearance, one layer each |
//! | adjacent | each hand's finger under the other's palm | never: two fingers cross |
//!
//! A layer turns between opposed hands if the body hand reaches over two layers. With clearance it
//! also turns between adjacent hands, if the body hand's jaws are on the third axis: its fingers
//! then hold the middle layer. `replay` states these rules a second time by cells of a grid, and a
//! test compares both.

use crate::motion::Depth;
use crate::tasks::cube::hold::{Grip, Hand, Hold};
use serde::{Deserialize, Serialize};

/// Rule by which pairs of holds and turns are allowed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Rule {
    /// The rule of 2007: only the track arm turns. A turn needs two grasps: the track takes a face
    /// beside the postument's palm, then the postument grasps opposite the track. A turn of the
    /// face opposite the last one needs four grasps.
    Original,
    /// Palms that touch the cube: no finger under the other's palm; layers turn between opposed
    /// hands.
    Strict,
    /// Palms with clearance: fingers pass under the other's palm, and layers turn between hands at
    /// right angles as well.
    Clearance,
}

/// Depths to which the hands may reach.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Depths {
    /// One layer only: the palms' stops never move.
    One,
    /// One layer or two.
    Both,
}

impl Depths {
    /// Returns the number of grips of these depths. These grips have the lowest numbers.
    #[must_use]
    pub fn grips(self) -> usize {
        if self == Self::One { Grip::OF_DEPTH } else { Grip::COUNT }
    }
}

/// Times that motions cost (s).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Costs {
    /// A new grasp: letting go, retracting, approaching and closing (s), without the path to the
    /// meeting.
    pub grasp: f64,
    /// A quarter turn of a layer (s).
    pub quarter: f64,
    /// A half turn of a layer (s).
    pub half: f64,
    /// Opening and leaving at the end (s).
    pub leave: f64,
}

impl Default for Costs {
    // Round values for slow arms, with which rules are compared without a cell.
    fn default() -> Self {
        Self { grasp: 14.0, quarter: 4.0, half: 7.0, leave: 6.0 }
    }
}

/// Conditions that a plan must meet.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Terms {
    /// Rule of holds and turns.
    pub rule: Rule,
    /// Depths to which the hands may reach.
    pub depths: Depths,
    /// Hand that holds the cube in the end, alone; `None` for either.
    pub finish: Option<Hand>,
    /// Depths to which that hand may reach in the end: fingers over two layers reach too far down
    /// to lay the cube on a table.
    pub finish_depths: Depths,
    /// Times that motions cost.
    pub costs: Costs,
}

impl Terms {
    /// Returns the usual terms of a rule: the track arm gives the cube back, and with clearance one
    /// layer is enough.
    #[must_use]
    pub fn of(rule: Rule) -> Self {
        let depths = if rule == Rule::Clearance { Depths::One } else { Depths::Both };
        Self {
            rule,
            depths,
            finish: Some(Hand::Track),
            finish_depths: Depths::Both,
            costs: Costs::default(),
        }
    }
}

/// Returns whether two hands can have these holds at the same time.
#[must_use]
pub fn compatible(a: Hold, b: Hold, rule: Rule) -> bool {
    if a.palm == b.palm || a.palm.axis() == a.jaws || b.palm.axis() == b.jaws {
        return false;
    }
    let both_one = a.depth == Depth::One && b.depth == Depth::One;
    let both_two = a.depth == Depth::Two && b.depth == Depth::Two;
    if a.palm == b.palm.opposite() {
        // Opposed fingers on one pair of faces reach towards each other over three layers.
        return a.jaws != b.jaws || !both_two;
    }
    match (a.jaws == b.palm.axis(), b.jaws == a.palm.axis()) {
        // Each hand has a finger under the other's palm; these two cross beside the edge between
        // the palms.
        (true, true) => false,
        // Both pairs of fingers are on the third axis, side by side from two adjacent palms.
        (false, false) => !both_two,
        // One finger passes under the other's palm.
        _ => rule == Rule::Clearance && both_one,
    }
}

/// Returns whether the first of two compatible holds can turn its face while the second holds the
/// body.
#[must_use]
pub fn turnable(turner: Hold, body: Hold, rule: Rule) -> bool {
    if turner.depth == Depth::Two {
        return false;
    }
    if turner.palm == body.palm.opposite() {
        // Over one layer the body hand would leave the middle layer free to turn along.
        return body.depth == Depth::Two;
    }
    // The body's fingers on the third axis hold the middle layer; on the turning axis they would
    // hold the layer that turns.
    rule == Rule::Clearance && body.depth == Depth::One && body.jaws != turner.palm.axis()
}
