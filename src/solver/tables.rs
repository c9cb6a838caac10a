//! How far each state of each phase is from its goal.
//!
//! Phase 1 has one exact table, 64430 classes x 2187 twists, two bits an entry: the distance modulo 3, and 3 for
//! "10 or more". The walk knows its own distance, and a neighbour's differs by at most 1, so two bits are enough;
//! leaving the last two levels (three entries of five) unfilled halves the time to build. Phase 2 has three tables
//! of bytes: corners with the middle edges, the eight edges with the middle edges, and the eight edges with the
//! places of the upper corners. Built in memory, about 48 MB; nothing is read or written.

use super::coordinates::{
    CHOICES, FLIPS, PERMUTATIONS, PHASE2_TURNS, QUADS, SLICES, TWISTS, corner_moves, edge_moves,
    flip_moves, quad_moves, twist_moves, upper_corner_moves, upper_corners,
};
use super::symmetry::{CLASSES, Classes, SYMMETRIES, twist_images};

/// Words of 32 entries in a class's row of twists.
const ROW: usize = TWISTS.div_ceil(32);
/// The distance that stands for itself and all above.
pub(super) const FAR: u8 = 10;
const LOW_BITS: u64 = 0x5555_5555_5555_5555;

/// All tables of the solver: build once, share.
#[derive(Debug, Clone)]
pub struct Tables {
    pub(super) twist_moves: Vec<u16>,
    pub(super) flip_moves: Vec<u16>,
    pub(super) slice_moves: Vec<u16>,
    pub(super) quad_moves: Vec<u16>,
    pub(super) corner_moves: Vec<u16>,
    pub(super) edge_moves: Vec<u16>,
    pub(super) middle_moves: Vec<u8>,
    twist_images: Vec<u16>,
    classes: Classes,
    phase1: Vec<u64>,
    pub(super) corners_middle: Vec<u8>,
    pub(super) edges_middle: Vec<u8>,
    upper_corners: Vec<u8>,
    edges_upper: Vec<u8>,
}

impl Tables {
    /// Builds all of them: about 0.6 s on one core of 2020.
    #[must_use]
    pub fn build() -> Self {
        let quad_moves = quad_moves();
        let slice_moves = (0..18 * SLICES)
            .map(|i| quad_moves[i / SLICES * QUADS + i % SLICES * 24] / 24)
            .collect();
        // The middle layer's own set of places is 0, so in phase 2 the number is the order alone.
        let middle_moves = PHASE2_TURNS
            .iter()
            .flat_map(|t| (0..24).map(|n| quad_moves[t * QUADS + n] as u8).collect::<Vec<_>>())
            .collect();
        let mut tables = Self {
            twist_moves: twist_moves(),
            flip_moves: flip_moves(),
            slice_moves,
            quad_moves,
            corner_moves: corner_moves(),
            edge_moves: edge_moves(),
            middle_moves,
            twist_images: twist_images(),
            classes: Classes::build(),
            phase1: vec![u64::MAX; CLASSES * ROW],
            corners_middle: Vec::new(),
            edges_middle: Vec::new(),
            upper_corners: upper_corners(),
            edges_upper: Vec::new(),
        };
        tables.fill_phase1();
        let corners: Vec<&[u16]> =
            PHASE2_TURNS.iter().map(|t| &tables.corner_moves[t * PERMUTATIONS..]).collect();
        let edges: Vec<&[u16]> = (0..10).map(|k| &tables.edge_moves[k * PERMUTATIONS..]).collect();
        let corners_middle = distances(&corners, &tables.middle_moves, 24);
        let edges_middle = distances(&edges, &tables.middle_moves, 24);
        let edges_upper = distances(&edges, &upper_corner_moves(), CHOICES);
        (tables.corners_middle, tables.edges_middle) = (corners_middle, edges_middle);
        tables.edges_upper = edges_upper;
        tables
    }

    /// Memory of all tables [bytes].
    #[must_use]
    pub fn size(&self) -> usize {
        let words = [
            &self.twist_moves,
            &self.flip_moves,
            &self.slice_moves,
            &self.quad_moves,
            &self.corner_moves,
            &self.edge_moves,
            &self.twist_images,
            &self.classes.stabilisers,
        ];
        words.iter().map(|w| w.len() * 2).sum::<usize>()
            + (self.classes.of.len() + self.classes.representatives.len()) * 4
            + self.phase1.len() * 8
            + self.edges_upper.len()
            + self.upper_corners.len()
            + self.middle_moves.len()
            + self.corners_middle.len()
            + self.edges_middle.len()
    }

    /// Where the distance of a state of phase 1 stands.
    #[inline]
    pub(super) fn phase1_entry(&self, (twist, flip, slice): (usize, usize, usize)) -> usize {
        let class = self.classes.of[slice * FLIPS + flip] as usize;
        let image = usize::from(self.twist_images[(class & 15) * TWISTS + twist]);
        (class >> 4) * ROW * 32 + image
    }

    /// The distance modulo 3 that stands there, 3 for [`FAR`] and more.
    #[inline]
    pub(super) fn phase1_code_at(&self, entry: usize) -> u8 {
        (self.phase1[entry / 32] >> (entry % 32 * 2) & 3) as u8
    }

    fn phase1_code(&self, state: (usize, usize, usize)) -> u8 {
        self.phase1_code_at(self.phase1_entry(state))
    }

    /// A bound from below for a state (corners, edges, middle edges) of phase 2.
    pub(super) fn phase2_distance(&self, (corners, edges, middle): (usize, usize, usize)) -> u8 {
        let upper = usize::from(self.upper_corners[corners]);
        self.corners_middle[corners * 24 + middle]
            .max(self.edges_middle[edges * 24 + middle])
            .max(self.edges_upper[edges * CHOICES + upper])
    }

    /// The state after the `k`-th turn of phase 2, if it may be solved in fewer than `left` more.
    #[inline]
    pub(super) fn phase2_turned(
        &self,
        k: usize,
        (corners, edges, middle): (usize, usize, usize),
        left: u8,
    ) -> Option<(usize, usize, usize)> {
        let corners = usize::from(self.corner_moves[PHASE2_TURNS[k] * PERMUTATIONS + corners]);
        let middle = usize::from(self.middle_moves[k * 24 + middle]);
        if self.corners_middle[corners * 24 + middle] >= left {
            return None;
        }
        let edges = usize::from(self.edge_moves[k * PERMUTATIONS + edges]);
        let upper = usize::from(self.upper_corners[corners]);
        let far =
            self.edges_upper[edges * CHOICES + upper].max(self.edges_middle[edges * 24 + middle]);
        (far < left).then_some((corners, edges, middle))
    }

    /// The distance of a state of phase 1 from its goal; [`FAR`] stands for more, too.
    pub(super) fn phase1_distance(&self, twist: usize, flip: usize, slice: usize) -> u8 {
        let (mut state, mut distance) = ((twist, flip, slice), 0);
        if self.phase1_code(state) == 3 {
            return FAR;
        }
        while state != (0, 0, 0) {
            let nearer = (self.phase1_code(state) + 2) % 3;
            let next = (0..18)
                .map(|t| self.phase1_turned(t, state))
                .find(|n| self.phase1_code(*n) == nearer);
            match next {
                Some(next) => state = next,
                None => return FAR,
            }
            distance += 1;
        }
        distance
    }

    /// (twist, flip, slice) after the turn with this number.
    #[inline]
    pub(super) fn phase1_turned(
        &self,
        turn: usize,
        (twist, flip, slice): (usize, usize, usize),
    ) -> (usize, usize, usize) {
        (
            usize::from(self.twist_moves[turn * TWISTS + twist]),
            usize::from(self.flip_moves[turn * FLIPS + flip]),
            usize::from(self.slice_moves[turn * SLICES + slice]),
        )
    }

    /// Breadth first from the goal, one level after the other, up to the last that is told apart.
    fn fill_phase1(&mut self) {
        let mut table = std::mem::take(&mut self.phase1);
        table[0] &= !3;
        let mut frontier: Vec<u16> = Vec::with_capacity(TWISTS);
        for depth in 1..FAR {
            let (from, code) = (u64::from(depth - 1) % 3, u64::from(depth % 3));
            for class in 0..CLASSES {
                // Entries of three levels before come along; all their neighbours are filled already.
                frontier.clear();
                equal_entries(&table[class * ROW..][..ROW], from, &mut frontier);
                if !frontier.is_empty() {
                    self.mark_neighbours(class, &frontier, &mut table, code);
                }
            }
        }
        self.phase1 = table;
    }

    /// Gives `code` to all unfilled neighbours of some twists of a class.
    fn mark_neighbours(&self, class: usize, twists: &[u16], table: &mut [u64], code: u64) {
        let representative = self.classes.representatives[class] as usize;
        let (slice, flip) = (representative / FLIPS, representative % FLIPS);
        for turn in 0..18 {
            let flip = usize::from(self.flip_moves[turn * FLIPS + flip]);
            let slice = usize::from(self.slice_moves[turn * SLICES + slice]);
            let entry = self.classes.of[slice * FLIPS + flip] as usize;
            let (target, symmetry) = (entry >> 4, entry & 15);
            let moves = &self.twist_moves[turn * TWISTS..][..TWISTS];
            let images = &self.twist_images[symmetry * TWISTS..][..TWISTS];
            let row = &mut table[target * ROW..][..ROW];
            let stabiliser = self.classes.stabilisers[target];
            for &twist in twists {
                let image = images[usize::from(moves[usize::from(twist)])];
                if !mark(row, image, code) || stabiliser == 1 {
                    continue;
                }
                for s in (1..SYMMETRIES).filter(|s| stabiliser >> s & 1 == 1) {
                    mark(row, self.twist_images[s * TWISTS + usize::from(image)], code);
                }
            }
        }
    }
}

/// Distances of (order of eight pieces, something else of `size` states), `[order * size + else]`, by the turns of
/// phase 2: `moves[k][order]` and `other_moves[k * size + else]`.
fn distances(moves: &[&[u16]], other_moves: &[u8], size: usize) -> Vec<u8> {
    let mut table = vec![u8::MAX; PERMUTATIONS * size];
    table[0] = 0;
    let (mut frontier, mut next, mut depth) = (vec![0_u32], Vec::new(), 0);
    while !frontier.is_empty() {
        depth += 1;
        for state in frontier.drain(..) {
            let (order, other) = (state as usize / size, state as usize % size);
            for (k, moves) in moves.iter().enumerate() {
                let neighbour =
                    usize::from(moves[order]) * size + usize::from(other_moves[k * size + other]);
                if table[neighbour] == u8::MAX {
                    table[neighbour] = depth;
                    next.push(neighbour as u32);
                }
            }
        }
        std::mem::swap(&mut frontier, &mut next);
    }
    table
}

/// The numbers of the entries of a row that are `code`.
fn equal_entries(row: &[u64], code: u64, found: &mut Vec<u16>) {
    for (w, word) in row.iter().enumerate() {
        let differences = word ^ (code * LOW_BITS);
        let mut equal = !(differences | differences >> 1) & LOW_BITS;
        while equal != 0 {
            let bit = equal.trailing_zeros();
            found.push((w * 32) as u16 + (bit / 2) as u16);
            equal &= equal - 1;
        }
    }
}

/// Writes an entry that is still 3; tells whether it was.
#[inline]
fn mark(row: &mut [u64], entry: u16, code: u64) -> bool {
    let (word, shift) = (&mut row[usize::from(entry / 32)], entry % 32 * 2);
    let unfilled = *word >> shift & 3 == 3;
    if unfilled {
        *word &= !((3 ^ code) << shift);
    }
    unfilled
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use std::sync::LazyLock;

    /// Built once for all tests.
    pub(in crate::solver) static TABLES: LazyLock<Tables> = LazyLock::new(Tables::build);

    /// States of phase 1 at each distance (Kociemba's page; Scherphuis), found again from the classes' sizes.
    #[test]
    fn phase_1_has_its_known_distances() {
        let known = [1, 4, 50, 592, 7156, 87236, 1043817, 12070278, 124946368, 821605960];
        let mut by_code = [0_u64; 4];
        for class in 0..CLASSES {
            let size = 16 / u64::from(TABLES.classes.stabilisers[class].count_ones());
            for twist in 0..TWISTS {
                let word = TABLES.phase1[class * ROW + twist / 32];
                by_code[(word >> (twist % 32 * 2) & 3) as usize] += size;
            }
        }

        let sum = |r: usize| known.iter().skip(r).step_by(3).sum::<u64>();
        let all = (SLICES * FLIPS * TWISTS) as u64;
        assert_eq!(by_code[..3], [sum(0), sum(1), sum(2)]);
        assert_eq!(by_code[3], all - known.iter().sum::<u64>());
    }

    /// No reference is known to us for these: that each state has a neighbour nearer by one, and none by two, says
    /// that the numbers are distances.
    #[test]
    fn phase_2_tables_hold_distances() {
        let rows = |moves: &[u16], k: usize| moves[k * PERMUTATIONS..][..PERMUTATIONS].to_vec();
        let corners: Vec<_> = PHASE2_TURNS.map(|t| rows(&TABLES.corner_moves, t)).to_vec();
        let edges: Vec<_> = (0..10).map(|k| rows(&TABLES.edge_moves, k)).collect();
        let upper = upper_corner_moves();
        for (table, moves, others, size) in [
            (&TABLES.corners_middle, &corners, &TABLES.middle_moves, 24),
            (&TABLES.edges_middle, &edges, &TABLES.middle_moves, 24),
            (&TABLES.edges_upper, &edges, &upper, CHOICES),
        ] {
            assert_eq!(table.iter().position(|&d| d == 0), Some(0));
            assert!(!table[1..].contains(&0));
            for (state, &distance) in table.iter().enumerate().skip(1) {
                let (order, other) = (state / size, state % size);
                let to = |k: usize| {
                    usize::from(moves[k][order]) * size + usize::from(others[k * size + other])
                };
                let nearest = (0..10).map(|k| table[to(k)]).min();
                assert_eq!(nearest, Some(distance - 1));
            }
        }
    }

    #[test]
    fn all_tables_fit_into_64_mib() {
        assert!(TABLES.size() < 64 << 20, "{} bytes", TABLES.size());
    }
}
