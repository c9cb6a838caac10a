//! Patterns, which are all corners or six edges: the numbers of their states, and how turns change
//! these numbers.
//!
//! - in: a cube, or the number of a state of the pieces of a pattern
//! - out: the number; the numbers after each turn
//! - source: R. Korf (1997); all other pieces are ignored, as if they had no stickers
//!
//! A number is row * columns + column. A turn carries each row as a whole to another row and
//! permutes its columns in one of a few ways. The build of a table therefore works on a few
//! thousand bytes at a time.

use crate::coordinates::{PERMUTATIONS, TWISTS, corner_moves, rank, twist, twist_moves};
use crate::cube::{Cube, Turn};

/// Row to which a turn carries a row, and index of the permutation of the columns.
pub(super) type Step = (u32, u16);

/// Some pieces of the cube.
pub(super) trait Pattern: Sync {
    /// Returns the number of rows of the pattern's table. The index of a state is row * columns +
    /// column.
    fn rows(&self) -> usize;
    /// Returns the number of columns of the pattern's table.
    fn columns(&self) -> usize;
    /// Returns, for each of the 18 turns, the row to which the turn carries `row` and the index of
    /// the permutation by which it moves the columns.
    fn steps(&self, row: usize) -> [Step; 18];
    /// Returns the column to which the permutation with this index carries `column`.
    fn column(&self, permutation: u16, column: usize) -> usize;
    /// Returns the index in the table of the state that the pattern's pieces have in `cube`.
    fn number(&self, cube: &Cube) -> usize;
}

/// All corners: a row for each order, a column for each twist.
#[derive(Debug, Clone)]
pub(super) struct Corners {
    /// Order after a turn: `[turn * PERMUTATIONS + order]`.
    orders: Vec<u16>,
    /// Twists after a turn: `[turn * TWISTS + twist]`.
    twists: Vec<u16>,
}

impl Corners {
    /// Number of states of the corners.
    pub(super) const STATES: usize = PERMUTATIONS * TWISTS;

    /// Makes the pattern of all corners, with their move tables.
    pub(super) fn new() -> Self {
        Self { orders: corner_moves(), twists: twist_moves() }
    }
}

impl Pattern for Corners {
    fn rows(&self) -> usize {
        PERMUTATIONS
    }

    fn columns(&self) -> usize {
        TWISTS
    }

    /// Looks the rows up in the move table of the corners' order.
    fn steps(&self, row: usize) -> [Step; 18] {
        // A turn changes the twists independently of the order, so the index of the turn serves as
        // the index of the permutation.
        std::array::from_fn(|turn| (u32::from(self.orders[turn * PERMUTATIONS + row]), turn as u16))
    }

    #[inline]
    fn column(&self, turn: u16, twist: usize) -> usize {
        usize::from(self.twists[usize::from(turn) * TWISTS + twist])
    }

    fn number(&self, cube: &Cube) -> usize {
        rank(cube.corners()) * TWISTS + twist(cube)
    }
}

/// `COUNT` edges from number `first` on: a row for each arrangement of their places, a column for
/// each state of their flips.
#[derive(Debug, Clone)]
pub(super) struct Edges<const COUNT: usize> {
    first: u8,
    moves: EdgeMoves,
}

impl<const COUNT: usize> Edges<COUNT> {
    /// Number of arrangements of these edges: 12 x 11 x ...
    const ROWS: usize = {
        let (mut rows, mut k) = (1, 0);
        while k < COUNT {
            rows *= 12 - k;
            k += 1;
        }
        rows
    };
    /// Number of states of these edges.
    pub(super) const STATES: usize = Self::ROWS << COUNT;

    /// Makes the pattern of `COUNT` edges from the edge `first` on, with their move table.
    pub(super) fn new(first: u8) -> Self {
        Self { first, moves: edge_moves() }
    }
}

impl<const COUNT: usize> Pattern for Edges<COUNT> {
    fn rows(&self) -> usize {
        Self::ROWS
    }

    fn columns(&self) -> usize {
        1 << COUNT
    }

    /// Turns unflipped edges on the places of the row, each by all 18 turns.
    fn steps(&self, row: usize) -> [Step; 18] {
        // After a turn, edges that were not flipped show their new places and which flips the turn
        // inverts.
        let edges: [u8; COUNT] = places::<COUNT>(row).map(|place| place * 2);
        std::array::from_fn(|turn| {
            let number = edges_number(&edges.map(|e| self.moves[turn][usize::from(e)]));
            ((number >> COUNT) as u32, (number & ((1 << COUNT) - 1)) as u16)
        })
    }

    #[inline]
    fn column(&self, inverted: u16, flips: usize) -> usize {
        flips ^ usize::from(inverted)
    }

    fn number(&self, cube: &Cube) -> usize {
        let all = edge_states(cube);
        edges_number::<COUNT>(&std::array::from_fn(|k| all[usize::from(self.first) + k]))
    }
}

/// State 2 * place + flip of an edge after a turn: `[turn][2 * place + flip]`.
pub(super) type EdgeMoves = [[u8; 24]; 18];

/// Computes the move table of a single edge: `[turn][2 * place + flip]` is the edge's 2 * place +
/// flip after the turn.
pub(super) fn edge_moves() -> EdgeMoves {
    std::array::from_fn(|turn| {
        let turned = Cube::SOLVED.apply(Turn::from_index(turn));
        let mut moves = [0; 24];
        for to in 0..12 {
            let (from, flip) = (turned.edges()[to], turned.flips()[to]);
            for before in 0..2 {
                moves[usize::from(from * 2 + before)] = to as u8 * 2 + (before ^ flip);
            }
        }
        moves
    })
}

/// Returns, for each edge, 2 * (place where the edge is) + (1 if it is flipped there).
pub(super) fn edge_states(cube: &Cube) -> [u8; 12] {
    let mut states = [0; 12];
    for (place, (&edge, &flip)) in cube.edges().iter().zip(cube.flips()).enumerate() {
        states[usize::from(edge)] = place as u8 * 2 + flip;
    }
    states
}

/// Returns the index in the table of the state of `COUNT` edges, each given as 2 * place + flip:
/// the places as a mixed-radix number, each counted among the places still free, then a bit for
/// each flip.
#[inline]
pub(super) fn edges_number<const COUNT: usize>(states: &[u8; COUNT]) -> usize {
    let (mut row, mut flips, mut taken) = (0, 0, 0_u32);
    for (k, &state) in states.iter().enumerate() {
        let place = u32::from(state >> 1);
        let before = (taken & ((1 << place) - 1)).count_ones();
        row = row * (12 - k) + (place - before) as usize;
        flips = flips << 1 | usize::from(state & 1);
        taken |= 1 << place;
    }
    row << COUNT | flips
}

/// Returns the places of the `COUNT` edges in all states of a table row: `places[k]` is that of the
/// pattern's k-th edge.
fn places<const COUNT: usize>(mut row: usize) -> [u8; COUNT] {
    // The inverse of `edges_number`: first the digits, then from each digit, counted among the free
    // places, the place itself.
    let mut places = [0; COUNT];
    for k in (0..COUNT).rev() {
        places[k] = (row % (12 - k)) as u8;
        row /= 12 - k;
    }
    for k in 1..COUNT {
        // In ascending order, each earlier place at or below this one pushes it up by one.
        let mut earlier = [u8::MAX; COUNT];
        earlier[..k].copy_from_slice(&places[..k]);
        earlier.sort_unstable();
        for &place in &earlier[..k] {
            places[k] += u8::from(places[k] >= place);
        }
    }
    places
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks on scrambled cubes that `steps` and `column` of a pattern lead to the number of the
    /// turned cube.
    fn check_steps(pattern: &impl Pattern) {
        for seed in 0..50 {
            let cube = Cube::scrambled(seed);
            let number = pattern.number(&cube);
            let (row, column) = (number / pattern.columns(), number % pattern.columns());
            assert!(row < pattern.rows());
            for (turn, (to, permutation)) in Turn::all().zip(pattern.steps(row)) {
                let expected = pattern.number(&cube.apply(turn));
                let column = pattern.column(permutation, column);
                assert_eq!(to as usize * pattern.columns() + column, expected);
            }
        }
    }

    #[test]
    fn pattern_numbers_after_turns_match_turned_cubes() {
        check_steps(&Corners::new());
        check_steps(&Edges::<6>::new(0));
        check_steps(&Edges::<6>::new(6));
        check_steps(&Edges::<3>::new(5));
    }

    #[test]
    fn patterns_have_published_numbers_of_states() {
        assert_eq!(Corners::STATES, 88_179_840);
        assert_eq!(Edges::<6>::STATES, 42_577_920);
    }
}
