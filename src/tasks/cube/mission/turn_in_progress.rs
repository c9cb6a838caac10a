//! Record of a turn from its beginning until the layer is in line again.

use crate::tasks::cube::hold::{Grip, Hand};
use std::f64::consts::FRAC_PI_2;

/// Turn that has begun.
#[derive(Debug, Clone)]
pub(super) struct TurnInProgress {
    /// Hand that turns.
    turner: Hand,
    /// Grip of the hand while the layer was in line.
    grip: Grip,
    /// Position of the hand's last joint while the layer was in line (rad).
    roll: f64,
    /// Sense in which the layer lags behind the turning hand, 1 or -1.
    pub(super) sense: f64,
    /// Last measurement of the layer while the turner held it: the grip at the nearest quarter, and
    /// the layer's angle from there (rad).
    pub(super) last_seen: (Grip, f64),
    /// Whether the turner has moved without the layer since then.
    pub(super) layer_left_behind: bool,
    /// Reason for which the turn failed; `None` before that.
    why: Option<String>,
}

impl TurnInProgress {
    /// Makes the record of a turn whose layer is in line when the turner's last joint is at `roll`
    /// (rad) in `grip`. The layer lags behind the hand in the sense `sense`, 1 or -1.
    pub(super) fn new(turner: Hand, grip: Grip, roll: f64, sense: f64) -> Self {
        Self {
            turner,
            grip,
            roll,
            sense,
            last_seen: (grip, 0.0),
            layer_left_behind: false,
            why: None,
        }
    }

    /// Returns whether `turner` is the hand of this turn.
    pub(super) fn is_of(&self, turner: Hand) -> bool {
        self.turner == turner
    }

    /// Stores the reason for which the turn failed.
    pub(super) fn failed(&mut self, why: &str) {
        self.why = Some(why.to_owned());
    }

    /// Returns the reason for which the turn failed.
    pub(super) fn into_why(self) -> Option<String> {
        self.why
    }

    /// Returns the grip that the turner has at the quarter turn nearest to the layer, and the
    /// layer's angle from there (rad), if its last joint is at `roll` (rad). `in_vain` is the part
    /// of the hand's turn that the layer did not follow (rad).
    pub(super) fn nearest(&self, roll: f64, in_vain: f64) -> (Grip, f64) {
        // The layer is behind the hand in the sense of its last turn.
        let off = roll - self.roll - self.sense * in_vain;
        let quarters = (off / FRAC_PI_2).round();
        let clockwise = (quarters as i64).rem_euclid(4);
        (self.grip.after_turn(clockwise as u8), off - quarters * FRAC_PI_2)
    }
}
