//! Duration of a fault that undoes a turn: the layers slip back until that turn is over, and in no
//! other turn.
//!
//! - in: whether the fault acts, and which turn is under way
//! - out: whether the layers slip back in this period

use super::balance::Split;

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
    /// fault acts in that period, `turns` the turn that is under way in it.
    pub(super) fn after(self, acts: bool, turns: Option<Split>) -> Self {
        // A fault that lasted a set time ended in the middle of a half turn, or undid the next turn
        // as well. So it lasts as long as its turn.
        match (self, turns) {
            _ if !acts => Self::Not,
            (Self::Not, Some(split)) => Self::Turn(split),
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
        let acts =
            [(true, None), (true, split(1)), (true, split(1)), (true, None), (true, split(1))];
        let mut undoing = Undoing::default();
        let states = acts.map(|(acts, turns)| {
            undoing = undoing.after(acts, turns);
            matches!(undoing, Undoing::Turn(_))
        });

        assert_eq!(states, [false, true, true, false, false]);
        assert_eq!(Undoing::Turn(split(1).unwrap()).after(true, split(2)), Undoing::Over);
        assert_eq!(Undoing::Over.after(false, split(1)), Undoing::Not, "the fault is over");
    }
}
