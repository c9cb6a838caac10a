//! Assignment of a mission: its goal, and its state at the beginning.

use super::entry::Entry;
use crate::tasks::cube::hold::{Hand, Hold};

/// Goal of the kernel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Goal {
    /// Whole mission: takes the cube from the operator's hand or the table, solves and returns it.
    Solve,
    /// Acquisition alone: takes the cube and gives it back.
    Acquire,
    /// Turn of the face in the track's palm by this angle about its tool's z (rad), while the
    /// postument's hand holds the cube.
    FaceTurn(f64),
}

/// Goal of a mission, and its state at the beginning.
#[derive(Debug, Clone)]
pub struct Assignment {
    /// Goal of the mission.
    pub goal: Goal,
    /// Hand that holds the cube at the beginning, its hold, and whether its tool frame is the
    /// second one of that hold ([`Hold::cube_from_tool`]); for [`Goal::FaceTurn`].
    pub held: Option<(Hand, Hold, bool)>,
    /// Time that the operator has for an answer (s); `None` without an operator.
    pub patience: Option<f64>,
    /// Last journal entry of the run that this one resumes.
    pub earlier: Option<Entry>,
}

impl Assignment {
    /// Makes an assignment with empty hands and without an operator.
    #[must_use]
    pub fn new(goal: Goal) -> Self {
        Self { goal, held: None, patience: None, earlier: None }
    }

    /// Returns the assignment to resume a run that was broken off at any moment. `last` is the last
    /// entry of that run's journal, if it has one.
    #[must_use]
    pub fn resumed(self, last: Option<Entry>) -> Self {
        // Also without an entry the mission takes stock: the hands may hold a cube.
        let nothing = || Entry { doing: "none".to_owned(), ..Entry::default() };
        Self { earlier: Some(last.unwrap_or_else(nothing)), ..self }
    }
}
