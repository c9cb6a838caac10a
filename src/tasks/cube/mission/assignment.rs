//! The assignment of a mission: its goal, and what it begins with.

use crate::tasks::Entry;
use crate::tasks::cube::hold::{Hand, Hold};

/// What the kernel is to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Goal {
    /// Everything: from the operator's hand, or the table, and back to it, solved.
    Solve,
    /// Take the cube and give it back.
    Acquire,
    /// Both hands hold the cube; turn the face in the track's palm by this angle about its tool's z
    /// (rad).
    FaceTurn(f64),
}

/// What a mission begins with.
#[derive(Debug, Clone)]
pub struct Assignment {
    /// What is to be done.
    pub goal: Goal,
    /// The hand that holds the cube, and how, for `FaceTurn`.
    pub held: Option<(Hand, Hold, bool)>,
    /// Time that the operator has for an answer (s); `None` when nobody can be asked.
    pub patience: Option<f64>,
    /// What an earlier run noted last, if this one goes on from there.
    pub earlier: Option<Entry>,
}

impl Assignment {
    /// Begins with empty hands and nobody to ask.
    #[must_use]
    pub fn new(goal: Goal) -> Self {
        Self { goal, held: None, patience: None, earlier: None }
    }

    /// Goes on where another run was broken off, at whatever moment. `last` is what that run noted
    /// last, if anything.
    #[must_use]
    pub fn resumed(self, last: Option<Entry>) -> Self {
        let nothing = || Entry { doing: "nothing yet".to_owned(), ..Entry::default() };
        Self { earlier: Some(last.unwrap_or_else(nothing)), ..self }
    }
}
