//! Duration of a fault that undoes a turn: the layers slip back while both hands hold them, and in
//! no other turn. A layer that is between two quarter turns when a hand opens ends at the nearest.
//!
//! - in: whether the fault acts, the layers that two closed hands hold, and their angle
//! - out: whether the layers slip back in this period

use super::balance::Split;
use super::fault::TURNING;

/// State of a fault that undoes a turn.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) enum Undoing {
    /// No fault of this kind acts, or nothing turns yet.
    #[default]
    Not,
    /// The fault undoes this turn.
    Turn(Split),
    /// The turn that the fault undid is over; the fault undoes no other.
    Over,
}

impl Undoing {
    /// Returns the state, one period later, of a fault that undoes a turn. `acts` is whether the
    /// fault acts in that period, `turns` the layers that two closed hands hold in it, and `turned`
    /// their angle since both hold (rad).
    pub(super) fn after(self, acts: bool, turns: Option<Split>, turned: f64) -> Self {
        // A fault that lasted a set time ended in the middle of a half turn, or undid the next turn
        // as well. So it lasts as long as its turn.
        match (self, turns) {
            _ if !acts => Self::Not,
            // Two hands that pass the cube on turn nothing. A layer that followed the strain of
            // their grips in each period crept away, until the hand that left pulled it off.
            (Self::Not, Some(split)) if turned.abs() >= TURNING => Self::Turn(split),
            (Self::Turn(split), turns) if turns != Some(split) => Self::Over,
            (same, _) => same,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fault_undoes_one_turn_and_no_other() {
        let split = |axis| Some(Split { axis, layers: [6, 1] });
        let periods = [
            (None, 0.0),
            (split(1), 0.5 * TURNING),
            (split(1), -TURNING),
            (split(1), 0.0),
            (None, 0.0),
            (split(1), 1.0),
        ];
        let mut undoing = Undoing::default();
        let states = periods.map(|(turns, turned)| {
            undoing = undoing.after(true, turns, turned);
            matches!(undoing, Undoing::Turn(_))
        });

        assert_eq!(states, [false, false, true, true, false, false]);
        assert_eq!(Undoing::Turn(split(1).unwrap()).after(true, split(2), 1.0), Undoing::Over);
        assert_eq!(Undoing::Over.after(false, split(1), 1.0), Undoing::Not, "the fault is over");
    }
}
