//! The mission's entry in the journal.
//!
//! | value | refused if |
//! |---|---|
//! | place of the hand-over, place of the grasp | beyond `FARTHEST` |
//! | missing part of a retraction | below 0 or beyond `MOST_SHORT` |

use crate::kernel::JournalEntry;
use crate::motion::{Depth, JointPositions};
use serde::{Deserialize, Serialize};

/// Largest distance of a joint from its zero (rad or m), and of the cube from an arm's base (m).
const FARTHEST: f64 = 20.0;
/// Largest value of [`Entry::short`], the part of a retraction that the arm could not do (m). A
/// resumed run hung with a value of 1e308.
const MOST_SHORT: f64 = 1.0;

/// State from which a run continues a mission that another run left unfinished. The default is a
/// mission that has not begun.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Entry {
    /// Description of the action that is about to begin.
    pub doing: String,
    /// Believed depth to which each hand reaches over the cube that it holds.
    pub held: [Option<Depth>; 2],
    /// Joint positions of the track arm after it had taken the cube from the operator or the table.
    pub hand_over: Option<JointPositions>,
    /// Position of the track's tool, in the arm's base, when its jaws closed on the cube that was
    /// given (m).
    pub taken_at: Option<[f64; 3]>,
    /// Part of the usual retraction from [`Entry::taken_at`] that the track could not make, because
    /// the arm folds no farther (m).
    #[serde(default)]
    pub short: f64,
    /// Last commanded position of each palm's stops. It gives the depth of a hand whose hold is not
    /// believed yet.
    #[serde(default)]
    pub stops: [Option<Depth>; 2],
    /// Whether the cube was offered to the operator, or is being laid on the table.
    pub handing_back: bool,
    /// Reason why the cube goes back unsolved, if it does.
    #[serde(default)]
    pub undone: Option<String>,
    /// Number of times that the jaws reported a fallen cube. The plant's file counts the falls of
    /// the whole mission as well.
    #[serde(default)]
    pub drops: u32,
    /// Whether the mission is finished.
    pub over: bool,
}

impl JournalEntry for Entry {
    fn doing(&self) -> &str {
        &self.doing
    }

    fn is_over(&self) -> bool {
        self.over
    }

    fn check(&self) -> Result<(), &'static str> {
        // The comparisons are false for NaN, so NaN is refused as well.
        let within = |values: &[f64], most: f64| values.iter().all(|value| value.abs() <= most);
        if !self.hand_over.is_none_or(|joints| within(&joints.0, FARTHEST)) {
            return Err("no arm can reach this place of hand-over");
        }
        if !self.taken_at.is_none_or(|place| within(&place, FARTHEST)) {
            return Err("no arm can reach this place of the grasp");
        }
        if !(0.0..=MOST_SHORT).contains(&self.short) {
            return Err("no retraction can be this much shorter than usual");
        }
        Ok(())
    }
}
