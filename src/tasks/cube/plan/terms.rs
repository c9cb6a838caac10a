//! The terms of a plan: which holds and turns are allowed, and what motions cost.

use crate::motion::Depth;
use crate::tasks::cube::hold::{Hand, Hold};
use serde::{Deserialize, Serialize};

/// Which pairs of holds and which turns are allowed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Rule {
    /// As in 2007: only the track arm turns; a face change and a face turn for each, two of both for the face
    /// opposite the last one.
    Original,
    /// Palms touch the cube: no finger under the other's palm, layers turn between opposed hands.
    Strict,
    /// Palms stand off: fingers pass under the other's palm, layers turn between hands at right angles, too.
    Clearance,
}

/// How deep the hands may reach.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Depths {
    /// Over one layer only: the palms' stops never move.
    One,
    /// Over one or two.
    Both,
}

/// What motions cost (s).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Costs {
    /// Let go, draw back, come again, close.
    pub grasp: f64,
    /// A quarter turn of a layer.
    pub quarter: f64,
    /// A half turn of a layer.
    pub half: f64,
    /// Open and leave at the end.
    pub leave: f64,
    /// One look at one face.
    pub look: f64,
}

impl Default for Costs {
    fn default() -> Self {
        Self { grasp: 14.0, quarter: 4.0, half: 7.0, leave: 6.0, look: 5.0 }
    }
}

/// What a plan must keep to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Terms {
    /// Which rule.
    pub rule: Rule,
    /// How deep the hands may reach.
    pub depths: Depths,
    /// Who holds the cube in the end, alone; `None`: whoever.
    pub finish: Option<Hand>,
    /// How deep that hand may reach then: fingers over two layers are too near a table to lay the cube down.
    pub finish_depths: Depths,
    /// What motions cost.
    pub costs: Costs,
}

impl Terms {
    /// The usual terms of a rule: the track arm hands back; with clearance one layer is enough.
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

/// Whether two hands can hold the cube like this at the same time.
#[must_use]
pub fn compatible(a: Hold, b: Hold, rule: Rule) -> bool {
    if a.palm == b.palm || a.palm.axis() == a.jaws || b.palm.axis() == b.jaws {
        return false;
    }
    let both_one = a.depth == Depth::One && b.depth == Depth::One;
    let both_two = a.depth == Depth::Two && b.depth == Depth::Two;
    if a.palm == b.palm.opposite() {
        return a.jaws != b.jaws || !both_two;
    }
    match (a.jaws == b.palm.axis(), b.jaws == a.palm.axis()) {
        // The fingers of both would cross beside the edge between the palms.
        (true, true) => false,
        (false, false) => !both_two,
        _ => rule == Rule::Clearance && both_one,
    }
}

/// Whether of two compatible holds the first can turn its face while the second holds the body.
#[must_use]
pub fn turnable(turner: Hold, body: Hold, rule: Rule) -> bool {
    if turner.depth == Depth::Two {
        return false;
    }
    if turner.palm == body.palm.opposite() {
        return body.depth == Depth::Two;
    }
    rule == Rule::Clearance && body.depth == Depth::One && body.jaws != turner.palm.axis()
}
