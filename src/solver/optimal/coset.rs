//! What a table looks at: a row by the corners, a place in the row by the edges.
//!
//! - in: the corners' twists, which corners are of which tetrad, where the middle layer's edges are, flips
//! - out: numbers; sixteen symmetric states of the corners share a row, to which the edges are carried along
//! - source: Kociemba's phase 1 for twists, flips and the middle layer; H48 (S. Tronto) for the tetrads, T. Rokicki's
//!   nxopt for three axes and two directions in one table
//!
//! A tetrad is four corners no two of which are neighbours. Half turns keep the two tetrads, the middle layer, twists
//! and flips. So two states are one here that differ by a half turn before all others, or by the sense of a quarter:
//! of eighteen turns that may come first, six lead nowhere and twelve lead to six cosets. Splitting the corners into
//! upper and lower ones, as nxopt does, frees the six turns of U and D instead, and no more. With equally large tables
//! (1.3 GB) four cubes of 16 turns took 2.7 million states and 4.9 million bounds with tetrads, 3.6 and 8.5 with layers.

use super::flips::BITS;
use super::geometry::{Symmetry, UPRIGHT, upright};
use crate::cube::{Cube, Turn};

/// Twists of the corners.
const TWISTS: usize = 2187;
/// Places of the middle layer's four edges.
pub(super) const SLICES: usize = 495;

/// What a table knows of the tetrads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Tetrads {
    /// Nothing: with all flips that is Kociemba's phase 1, whose distances are known.
    #[cfg_attr(
        not(test),
        allow(dead_code, reason = "small enough for tests, too weak for solving")
    )]
    Ignored,
    /// Which corners are of one tetrad: 35 splits.
    Unnamed,
    /// And of which: 70.
    Named,
}

/// Which of a cube's features a table tells apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Shape {
    /// Of the corners, besides their twists.
    pub(super) tetrads: Tetrads,
    /// Whether all flips count (2048) or only those of the edges outside the middle layer (256).
    pub(super) full: bool,
}

impl Shape {
    /// 64-bit words with a bit for each state of the flips.
    pub(super) const fn words(self) -> usize {
        if self.full { 32 } else { 4 }
    }

    /// Rows of the table: classes of the corners' states under sixteen symmetries.
    pub(super) const fn rows(self) -> usize {
        match self.tetrads {
            Tetrads::Ignored => 168,
            Tetrads::Unnamed => 5112,
            Tetrads::Named => 9996,
        }
    }
}

/// Corners as a row sees them: twists, and a bit for each place that has a corner of the first tetrad.
pub(super) type Corners = ([u8; 8], u8);
/// Edges as a row sees them: a bit for each place of a middle edge, a bit for each flipped one.
pub(super) type Edges = (u16, u16);

/// Numbers of the states of corners and edges.
#[derive(Debug, Clone)]
pub(super) struct Cosets {
    pub(super) shape: Shape,
    /// Splits into tetrads.
    pub(super) splits: usize,
    /// Number of a split by its bits.
    pub(super) split_of: Vec<u8>,
    /// `[twist * splits + split]`: 16 * row + the symmetry that carries there.
    pub(super) rows: Vec<u32>,
    /// For each row its corners.
    pub(super) representatives: Vec<Corners>,
    /// How many states of the corners share each row.
    pub(super) sizes: Vec<u8>,
    /// The middle edges' places by number, as bits.
    pub(super) slices: Vec<u16>,
    /// And their number by the bits.
    pub(super) slice_of: Vec<u16>,
    pub(super) upright: [Symmetry; UPRIGHT],
}

impl Cosets {
    pub(super) fn new(shape: Shape) -> Self {
        let mut split_of = vec![u8::MAX; 256];
        let mut masks = Vec::new();
        for bits in (0..=u8::MAX).filter(|b| b.count_ones() == 4) {
            if split_of[usize::from(bits)] != u8::MAX {
                continue;
            }
            let number = masks.len() as u8;
            masks.push(bits);
            match shape.tetrads {
                Tetrads::Ignored => split_of.fill(number),
                Tetrads::Unnamed => split_of[usize::from(!bits)] = number,
                Tetrads::Named => {}
            }
            split_of[usize::from(bits)] = number;
        }
        let slices: Vec<u16> = (0..4096_u16).filter(|b| b.count_ones() == 4).collect();
        let mut slice_of = vec![0; 4096];
        slices.iter().enumerate().for_each(|(n, &b)| slice_of[usize::from(b)] = n as u16);
        let mut cosets = Self {
            shape,
            splits: masks.len(),
            split_of,
            rows: Vec::new(),
            representatives: Vec::new(),
            sizes: Vec::new(),
            slices,
            slice_of,
            upright: upright(),
        };
        cosets.classify(&masks);
        cosets
    }

    fn classify(&mut self, masks: &[u8]) {
        let inverses = self.upright.each_ref().map(|a| {
            let undoes =
                |b: &Symmetry| (0..8).all(|i| b.corners[usize::from(a.corners[i])] == i as u8);
            self.upright.iter().position(undoes).unwrap_or(0)
        });
        self.rows = vec![u32::MAX; TWISTS * self.splits];
        for twist in 0..TWISTS {
            for &mask in masks {
                let corners = (twists(twist), mask);
                if self.rows[self.number(&corners)] != u32::MAX {
                    continue;
                }
                let row = self.representatives.len() as u32;
                let mut size = 0;
                for (s, &back) in inverses.iter().enumerate() {
                    let image = self.number(&self.corners_image(&corners, s));
                    if self.rows[image] == u32::MAX {
                        self.rows[image] = row * UPRIGHT as u32 + back as u32;
                        size += 1;
                    }
                }
                self.representatives.push(corners);
                self.sizes.push(size);
            }
        }
    }

    /// Position of a state of the corners in `rows`.
    fn number(&self, corners: &Corners) -> usize {
        let twist = (0..7).rev().fold(0, |n, i| n * 3 + usize::from(corners.0[i]));
        twist * self.splits + usize::from(self.split_of[usize::from(corners.1)])
    }

    /// The row of a state of the corners, and the symmetry that carries there.
    pub(super) fn row(&self, corners: &Corners) -> (usize, usize) {
        let row = self.rows[self.number(corners)] as usize;
        (row / UPRIGHT, row % UPRIGHT)
    }

    fn corners_image(&self, (twists, mask): &Corners, s: usize) -> Corners {
        let symmetry = &self.upright[s];
        let exchanges = of_first_tetrad(symmetry.corners[0]) != of_first_tetrad(0);
        let (mut image, mut bits) = ([0; 8], 0);
        for (i, (&to, twist)) in symmetry.corners.iter().zip(twists).enumerate() {
            image[usize::from(to)] = if symmetry.mirrors { (3 - twist) % 3 } else { *twist };
            bits |= (mask >> i & 1) << to;
        }
        (image, if exchanges { !bits } else { bits })
    }

    pub(super) fn edges_image(&self, (slice, flips): Edges, s: usize) -> Edges {
        let symmetry = &self.upright[s];
        // A piece's turn depends only on whether it is of the middle layer.
        let exchanges = u16::from(symmetry.edge_turns[8]);
        (0..12).fold((0, 0), |image, i| {
            let (to, inside) = (symmetry.edges[i], slice >> i & 1);
            let flip = flips >> i & 1 ^ u16::from(symmetry.edge_turns[i]) ^ inside & exchanges;
            (image.0 | inside << to, image.1 | flip << to)
        })
    }

    /// Number of the flips of some edges.
    pub(super) fn flip_number(&self, (slice, flips): Edges) -> u16 {
        if self.shape.full { flips & 0x7ff } else { gathered(flips, !slice & 0xfff) }
    }

    /// The edges with the middle ones at `slice` and the flips of a number.
    pub(super) fn edges(&self, slice: u16, number: u16) -> Edges {
        if self.shape.full {
            let last = number.count_ones() as u16 & 1;
            return (slice, number | last << BITS);
        }
        let outside = (0..12).filter(|i| slice >> i & 1 == 0);
        (slice, outside.enumerate().fold(0, |flips, (k, i)| flips | (number >> k & 1) << i))
    }
}

/// The bits of `value` where `mask` has ones, moved together.
pub(super) fn gathered(value: u16, mask: u16) -> u16 {
    let places = (0..16).filter(|i| mask >> i & 1 == 1);
    places.enumerate().fold(0, |bits, (k, i)| bits | (value >> i & 1) << k)
}

/// URF and the three corners that half turns bring to its place.
pub(super) fn of_first_tetrad(corner: u8) -> bool {
    [0, 2, 5, 7].contains(&corner)
}

/// The twists with a number.
fn twists(mut number: usize) -> [u8; 8] {
    let mut twists = [0; 8];
    for twist in &mut twists[..7] {
        *twist = (number % 3) as u8;
        number /= 3;
    }
    twists[7] = (3 - twists.iter().sum::<u8>() % 3) % 3;
    twists
}

/// The turns as cubes, in the order of [`Turn::index`].
pub(super) fn turns() -> [Cube; 18] {
    std::array::from_fn(|t| Cube::SOLVED.apply(Turn::from_index(t)))
}

/// The corners of a cube as a row sees them.
pub(super) fn corners_of(cube: &Cube) -> Corners {
    let first = |i: usize| u8::from(of_first_tetrad(cube.corners()[i]));
    (*cube.twists(), (0..8).fold(0, |bits, i| bits | first(i) << i))
}

/// The edges of a cube as a row sees them.
pub(super) fn edges_of(cube: &Cube) -> Edges {
    (0..12).fold((0, 0), |bits, i| {
        (bits.0 | u16::from(cube.edges()[i] >= 8) << i, bits.1 | u16::from(cube.flips()[i]) << i)
    })
}

/// The corners after a turn.
pub(super) fn turned_corners((twists, mask): &Corners, turn: &Cube) -> Corners {
    let from = turn.corners().map(usize::from);
    let bits = (0..8).fold(0, |bits, i| bits | (mask >> from[i] & 1) << i);
    (std::array::from_fn(|i| (twists[from[i]] + turn.twists()[i]) % 3), bits)
}

/// The edges after a turn.
pub(super) fn turned_edges((slice, flips): Edges, turn: &Cube) -> Edges {
    (0..12).fold((0, 0), |bits, i| {
        let from = turn.edges()[i];
        let flip = flips >> from & 1 ^ u16::from(turn.flips()[i]);
        (bits.0 | (slice >> from & 1) << i, bits.1 | flip << i)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    fn shapes() -> [Shape; 3] {
        let all = [Tetrads::Ignored, Tetrads::Unnamed, Tetrads::Named];
        all.map(|tetrads| Shape { tetrads, full: true })
    }

    #[test]
    fn classes_share_out_all_states_of_the_corners() {
        for shape in shapes() {
            let cosets = Cosets::new(shape);

            assert_eq!(cosets.representatives.len(), shape.rows());
            assert_eq!(
                cosets.sizes.iter().map(|&n| usize::from(n)).sum::<usize>(),
                cosets.rows.len()
            );
        }
    }

    #[test]
    fn symmetric_states_of_the_corners_share_a_row() {
        for shape in shapes() {
            let cosets = Cosets::new(shape);
            for seed in 0..20 {
                let corners = corners_of(&Cube::scrambled(seed));
                let (row, symmetry) = cosets.row(&corners);
                let image = cosets.corners_image(&corners, symmetry);
                assert_eq!(cosets.number(&image), cosets.number(&cosets.representatives[row]));
                for s in 0..UPRIGHT {
                    assert_eq!(cosets.row(&cosets.corners_image(&corners, s)).0, row);
                }
            }
        }
    }

    #[test]
    fn flips_are_read_back_from_their_number() {
        for full in [false, true] {
            let cosets = Cosets::new(Shape { tetrads: Tetrads::Unnamed, full });
            for number in 0..cosets.shape.words() as u16 * 64 {
                for slice in [cosets.slices[0], cosets.slices[100], 0b1111_0000_0000] {
                    assert_eq!(cosets.flip_number(cosets.edges(slice, number)), number);
                }
            }
        }
    }

    /// The cosets reached by so many turns, counted without rows, symmetries and tables.
    fn reached(shape: Shape) -> Vec<usize> {
        let cosets = Cosets::new(shape);
        let key = |cube: &Cube| {
            let edges = edges_of(cube);
            (cosets.number(&corners_of(cube)), edges.0, cosets.flip_number(edges))
        };
        let mut last = HashSet::from([Cube::SOLVED]);
        let mut seen = HashSet::from([key(&Cube::SOLVED)]);
        let mut counts = vec![1];
        for _ in 1..=4 {
            last = last.iter().flat_map(|c| Turn::all().map(|t| c.apply(t))).collect();
            let before = seen.len();
            seen.extend(last.iter().map(key));
            counts.push(seen.len() - before);
        }
        counts
    }

    #[test]
    fn distances_begin_as_turns_of_whole_cubes_give_them() {
        for design in [crate::optimal::SMALL, crate::optimal::STANDARD] {
            let known: Vec<usize> = design.distances[..=4].iter().map(|&n| n as usize).collect();
            assert_eq!(reached(design.shape), known);
        }
    }
}
