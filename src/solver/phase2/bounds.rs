//! Look-up in the tables of phase 2: lower bounds on the distance of a state.

use super::super::coordinates::{PERMUTATIONS, PHASE2_TURNS};
use super::orders::{CORNER_CLASSES, Orders, ROW, State};

/// First byte of the corners with the middle edges in [`BOUNDS`](super::BOUNDS).
pub(super) const MIDDLE: usize = CORNER_CLASSES * ROW;
/// Size of [`BOUNDS`](super::BOUNDS) (bytes).
pub(super) const BYTES: usize = MIDDLE + PERMUTATIONS * 24;
/// Distance from which on [`EIGHT`](super::EIGHT) has one code for all (turns): the greatest number
/// of four bits.
pub(super) const FARTHEST: u8 = 15;

/// The tables of phase 2 with the moves of its states.
#[derive(Clone, Copy)]
pub(crate) struct Bounds<'a> {
    pub(crate) orders: &'a Orders,
    /// [`BOUNDS`](super::BOUNDS).
    pub(crate) table: &'a [u8],
    /// [`EIGHT`](super::EIGHT), if the set has it.
    pub(crate) eight: Option<&'a [u8]>,
}

impl Bounds<'_> {
    /// Returns a lower bound on the turns of phase 2 that a state needs, from the order of its
    /// corners and the places of its upper and lower edges, `fours`.
    #[inline]
    pub(crate) fn of_eight(&self, corners: u16, fours: (u16, u16)) -> u8 {
        let ([upper, lower], entry) = self.orders.entries(corners, fours);
        match self.eight {
            Some(eight) => eight[entry / 2] >> (entry % 2 * 4) & 15,
            None => self.table[upper].max(self.table[lower]),
        }
    }

    /// Returns a lower bound on the turns of phase 2 that a state needs, from the order of its
    /// corners and the places `four` of its upper edges (`lower` is 0) or lower edges (1).
    #[inline]
    pub(crate) fn of_four(&self, corners: u16, lower: usize, four: u16) -> u8 {
        self.table[self.orders.entry(corners, lower, four)]
    }

    /// Returns a lower bound on the turns of phase 2 that a state needs, from the orders of its
    /// corners and of its middle-layer edges.
    #[inline]
    pub(crate) fn of_middle(&self, corners: u16, middle: u8) -> u8 {
        self.table[MIDDLE + usize::from(corners) * 24 + usize::from(middle)]
    }

    /// Returns the state after the turn `PHASE2_TURNS[k]`, or `None` if a lower bound says that it
    /// is more than `left` turns from solved.
    #[inline]
    pub(crate) fn turned(&self, state: State, k: usize, left: u8) -> Option<State> {
        // Each coordinate is computed only after the bounds of the ones before have accepted the
        // state. The table of eight edges, if present, makes those of four superfluous.
        let orders = self.orders;
        let corners = orders.corner_moves[usize::from(state.corners) * 18 + PHASE2_TURNS[k]];
        let upper = orders.four_moves[usize::from(state.upper) * 10 + k];
        if self.eight.is_none() && self.of_four(corners, 0, upper) > left {
            return None;
        }
        let lower = orders.four_moves[usize::from(state.lower) * 10 + k];
        let far = match self.eight {
            Some(_) => self.of_eight(corners, (upper, lower)),
            None => self.of_four(corners, 1, lower),
        };
        if far > left {
            return None;
        }
        let middle = orders.middle_moves[usize::from(state.middle) * 10 + k];
        let next = State { corners, upper, lower, middle };
        (self.of_middle(corners, middle) <= left).then_some(next)
    }
}
