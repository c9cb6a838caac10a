//! A turn of a layer from its beginning, until the layer is in line again.

use crate::tasks::cube::hold::{Grip, Hand};
use std::f64::consts::FRAC_PI_2;

/// A turn that has begun.
#[derive(Debug, Clone)]
pub(super) struct TurnInProgress {
    /// The hand that turns.
    turner: Hand,
    /// Its grip while the layer was in line.
    grip: Grip,
    /// Where its last joint stood then (rad).
    roll: f64,
    /// The sense in which what the jaws hold lags behind the turning hand, 1 or -1.
    pub(super) sense: f64,
    /// The grip at the quarter that was nearest to the layer when the turner last had it, and how
    /// far off it the layer stood (rad).
    pub(super) stood: (Grip, f64),
    /// The turner has gone on since without the layer.
    pub(super) alone: bool,
    /// Why it is being turned back.
    why: Option<String>,
}

impl TurnInProgress {
    /// Makes a turn whose layer is in line when the turner's last joint is at `roll` (rad).
    pub(super) fn new(turner: Hand, grip: Grip, roll: f64, sense: f64) -> Self {
        Self { turner, grip, roll, sense, stood: (grip, 0.0), alone: false, why: None }
    }

    /// Whether this hand turns.
    pub(super) fn is_of(&self, turner: Hand) -> bool {
        self.turner == turner
    }

    /// Keeps why the turn failed.
    pub(super) fn failed(&mut self, why: &str) {
        self.why = Some(why.to_owned());
    }

    /// Returns why the turn failed.
    pub(super) fn into_why(self) -> Option<String> {
        self.why
    }

    /// Returns the grip at the quarter that is nearest to a roll, and how far the roll is off it
    /// (rad). `in_vain`: the angle by which the hand turned while what it or its partner holds
    /// stayed behind (rad).
    pub(super) fn nearest(&self, roll: f64, in_vain: f64) -> (Grip, f64) {
        let off = roll - self.roll - self.sense * in_vain;
        let quarters = (off / FRAC_PI_2).round();
        let clockwise = (quarters as i64).rem_euclid(4);
        (self.grip.after_turn(clockwise as u8), off - quarters * FRAC_PI_2)
    }
}
