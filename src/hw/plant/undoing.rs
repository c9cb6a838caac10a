//! Duration of a fault that undoes a turn: the layers slip back while the jaws of both hands are
//! closed, and in no other turn. A layer that is between two quarter turns when a hand opens ends
//! at the nearest.
//!
//! - in: whether the fault acts, the layers between the jaws of two hands, and their angle
//! - out: the turn that the fault undoes

use super::balance::Split;
use super::fault::TURNING;

/// State of a fault that undoes a turn.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) enum Undoing {
    /// No fault of this kind acts, or nothing turns yet.
    #[default]
    Not,
    /// The fault undoes this turn, or has undone a part of it.
    Turn(Split),
    /// The turn that the fault undid is over; the fault undoes no other.
    Over,
}

impl Undoing {
    /// Returns the state, one period later, of a fault that undoes a turn. `acts` is whether the
    /// fault acts in that period, `turns` the layers between the closed jaws of two hands in it,
    /// and `turned` their angle since both hold (rad).
    pub(super) fn after(self, acts: bool, turns: Option<Split>, turned: f64) -> Self {
        // A fault that lasted a set time ended in the middle of a half turn, or undid the next turn
        // as well. So it lasts as long as its turn.
        match (self, turns) {
            // A layer that has slipped back is between two quarter turns also after the fault.
            (Self::Turn(split), Some(turns)) if turns == split => self,
            _ if !acts => Self::Not,
            // Two hands that pass the cube on turn nothing. A layer that followed the strain of
            // their grips in each period crept away, until the hand that left pulled it off.
            (Self::Not, Some(split)) if turned.abs() >= TURNING => Self::Turn(split),
            (Self::Turn(_), _) => Self::Over,
            (same, _) => same,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fault_undoes_one_turn_and_no_other() {
        let split = |axis| Some(Split { axis, layers: [6, 1], hands: [0, 1] });
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
        let slipped = Undoing::Turn(split(1).unwrap());
        assert_eq!(slipped.after(false, split(1), 1.0), slipped, "the layer has slipped");
        assert_eq!(slipped.after(false, None, 1.0), Undoing::Not);
        assert_eq!(Undoing::Over.after(false, split(1), 1.0), Undoing::Not, "the fault is over");
    }
}
