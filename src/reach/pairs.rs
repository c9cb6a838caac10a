//! Pairs of the arms of a cell: each of them has distances of its own, and its hands may meet at a
//! cube or not.

use crate::cell::MOST_ARMS;

/// Number of pairs of arms in a cell.
pub(super) const PAIRS: usize = MOST_ARMS * (MOST_ARMS - 1) / 2;

/// Arms of each pair, the one that the scenario names first before the other.
pub(super) const PAIR: [(usize, usize); PAIRS] = all();

/// Returns all pairs.
const fn all() -> [(usize, usize); PAIRS] {
    let mut pairs = [(0, 0); PAIRS];
    let (mut at, mut first) = (0, 0);
    while first < MOST_ARMS {
        let mut second = first + 1;
        while second < MOST_ARMS {
            pairs[at] = (first, second);
            (at, second) = (at + 1, second + 1);
        }
        first += 1;
    }
    pairs
}

/// A set of pairs of arms: those whose hands may meet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pairs(u8);

impl Pairs {
    /// No pair.
    pub const NONE: Self = Self(0);
    /// Each pair.
    pub const ALL: Self = Self((1 << PAIRS) - 1);

    /// Makes a set from the number that [`Self::bits`] returned.
    #[must_use]
    pub const fn of_bits(bits: u8) -> Self {
        Self(bits & Self::ALL.0)
    }

    /// Returns the set as a number.
    #[must_use]
    pub const fn bits(self) -> u8 {
        self.0
    }

    /// Returns the set with the pair of this number.
    pub(super) const fn with(self, pair: usize) -> Self {
        Self(self.0 | 1 << pair)
    }

    /// Checks whether the pair of this number is in the set.
    pub(super) const fn has(self, pair: usize) -> bool {
        self.0 & 1 << pair != 0
    }

    /// Checks whether the pair of these two arms is in the set.
    #[must_use]
    pub fn join(self, one: usize, other: usize) -> bool {
        let arms = (one.min(other), one.max(other));
        PAIR.iter().position(|pair| *pair == arms).is_some_and(|pair| self.has(pair))
    }

    /// Returns the set without the pairs of an arm.
    #[must_use]
    pub fn without(self, arm: usize) -> Self {
        let others = (0..PAIRS).filter(|&pair| self.has(pair) && !holds(pair, arm));
        others.fold(Self::NONE, Self::with)
    }

    /// Checks whether an arm is in any pair of the set.
    pub(super) fn names(self, arm: usize) -> bool {
        self.without(arm) != self
    }
}

/// Checks whether an arm belongs to the pair of this number.
fn holds(pair: usize, arm: usize) -> bool {
    PAIR[pair].0 == arm || PAIR[pair].1 == arm
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn set_without_arm_keeps_other_pairs() {
        let left = Pairs::ALL.without(1);

        assert!(left.join(0, 2) && left.join(3, 2) && left.join(0, 3));
        assert!((0..MOST_ARMS).all(|other| !left.join(1, other)));
        assert!(!left.names(1) && left.names(2) && !Pairs::NONE.names(0));
        assert_eq!(Pairs::of_bits(left.bits()), left);
    }
}
