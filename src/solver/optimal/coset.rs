//! Cosets: the classes of cubes that a table distinguishes, and their numbers.
//!
//! The corners of a cube select a row of the table, its edges a position in the row.
//!
//! - in: the twists of the corners, the tetrad of each corner, the places of the middle-layer
//!   edges, the flips
//! - out: numbers; up to sixteen symmetric states of the corners share a row, and the edges are
//!   mapped by the symmetry that leads to it
//! - source: H. Kociemba's phase 1 for twists, flips and the middle layer; S. Tronto's H48 for the
//!   tetrads; T. Rokicki's nxopt for three axes and two directions in one table
//!
//! A tetrad is four corners of which no two are neighbours. Half turns keep the two tetrads, the
//! middle layer, the twists and the flips. Two cubes therefore have one coset if they differ by a
//! half turn before all other turns, or by the sense of a quarter turn there. Eighteen turns may
//! come first: six keep the coset, and twelve lead to only six others.
//!
//! The alternative of nxopt splits the corners into upper and lower ones. Then the six turns of U
//! and D keep the coset, but the other twelve lead to up to twelve others. With tables of equal
//! size (1.3 GB), the search for four cubes of 16 turns visited 2.7 million states and read 4.9
//! million bounds with tetrads, but 3.6 and 8.5 million with upper and lower corners.

use super::flips::BITS;
use super::geometry::{Symmetry, UPRIGHT, upright};
use crate::cube::{Cube, Turn};

/// Number of states of the corners' twists.
const TWISTS: usize = 2187;
/// Number of sets of places of the four middle-layer edges.
pub(super) const SLICES: usize = 495;

/// Distinction of the tetrads in a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Tetrads {
    /// No distinction: with all flips this is Kociemba's phase 1, whose distances are known.
    #[cfg_attr(not(test), allow(dead_code, reason = "only tests ignore the tetrads"))]
    Ignored,
    /// Split of the corners into two tetrads without names: 35 splits.
    Unnamed,
    /// Split of the corners into the first and the second tetrad: 70 splits.
    Named,
}

/// Features of a cube that a table distinguishes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Shape {
    /// Distinction of the corners besides their twists.
    pub(super) tetrads: Tetrads,
    /// Whether all flips count (2048) or only those of the edges outside the middle layer (256).
    pub(super) full: bool,
}

impl Shape {
    /// Returns the number of 64-bit words in a set of states of the flips, one bit for each state.
    pub(super) const fn words(self) -> usize {
        if self.full { 32 } else { 4 }
    }

    /// Returns the number of rows of the table: classes of states of the corners under sixteen
    /// symmetries.
    pub(super) const fn rows(self) -> usize {
        match self.tetrads {
            Tetrads::Ignored => 168,
            Tetrads::Unnamed => 5112,
            Tetrads::Named => 9996,
        }
    }
}

/// State of the corners that selects a row: twists, and a bit for each place that has a corner of
/// the first tetrad.
pub(super) type Corners = ([u8; 8], u8);
/// State of the edges that selects a position in a row: a bit for each place of a middle edge, and
/// a bit for each place with a flipped edge.
pub(super) type Edges = (u16, u16);

/// Numbers of the states of corners and edges.
#[derive(Debug, Clone)]
pub(super) struct Cosets {
    /// Features that the cosets distinguish.
    pub(super) shape: Shape,
    /// Number of splits of the corners into tetrads.
    pub(super) splits: usize,
    /// Number of each split by its bits.
    pub(super) split_of: Vec<u8>,
    /// 16 * row + the symmetry that maps the corners to those of the row:
    /// `[twist * splits + split]`.
    pub(super) rows: Vec<u32>,
    /// Corners of each row.
    pub(super) representatives: Vec<Corners>,
    /// Number of states of the corners that share each row.
    pub(super) sizes: Vec<u8>,
    /// Places of the middle edges by number, as bits.
    pub(super) slices: Vec<u16>,
    /// Number of the places of the middle edges by their bits.
    pub(super) slice_of: Vec<u16>,
    /// Symmetries that keep the up-down axis.
    pub(super) upright: [Symmetry; UPRIGHT],
}

impl Cosets {
    /// Gives each coset that `shape` distinguishes a row of the table and an index within the row.
    pub(super) fn new(shape: Shape) -> Self {
        // Each split is numbered when the first of its sets of four corner places comes up.
        let mut split_of = vec![u8::MAX; 256];
        let mut masks = Vec::new();
        for bits in (0..=u8::MAX).filter(|b| b.count_ones() == 4) {
            if split_of[usize::from(bits)] != u8::MAX {
                continue;
            }
            let number = masks.len() as u8;
            masks.push(bits);
            // Unnamed tetrads give a set and its complement one number.
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

    /// Assigns a row to each class of symmetric states of the corners; `masks` are the splits into
    /// tetrads, as bits. The first state of a class, in the order of its index, represents it.
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
                    // The inverse leads from the image back to the representative. States with
                    // symmetries of their own meet an image twice, which makes the class smaller.
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

    /// Returns the index of a state of the corners in the table `rows`.
    fn number(&self, corners: &Corners) -> usize {
        let twist = (0..7).rev().fold(0, |n, i| n * 3 + usize::from(corners.0[i]));
        twist * self.splits + usize::from(self.split_of[usize::from(corners.1)])
    }

    /// Returns the row of a state of the corners, and the index of the symmetry that carries the
    /// state to the representative of this row.
    pub(super) fn row(&self, corners: &Corners) -> (usize, usize) {
        let row = self.rows[self.number(corners)] as usize;
        (row / UPRIGHT, row % UPRIGHT)
    }

    /// Returns the image of the corners under the symmetry `upright[s]`, which keeps the up-down
    /// axis.
    fn corners_image(&self, (twists, mask): &Corners, s: usize) -> Corners {
        let symmetry = &self.upright[s];
        // A symmetry may exchange the tetrads. Then the image's first tetrad consists of the
        // corners of the second one.
        let exchanges = of_first_tetrad(symmetry.corners[0]) != of_first_tetrad(0);
        let (mut image, mut bits) = ([0; 8], 0);
        for (i, (&to, twist)) in symmetry.corners.iter().zip(twists).enumerate() {
            image[usize::from(to)] = if symmetry.mirrors { (3 - twist) % 3 } else { *twist };
            bits |= (mask >> i & 1) << to;
        }
        (image, if exchanges { !bits } else { bits })
    }

    /// Returns the image of the edges under the symmetry `upright[s]`, which keeps the up-down
    /// axis.
    pub(super) fn edges_image(&self, (slice, flips): Edges, s: usize) -> Edges {
        let symmetry = &self.upright[s];
        // The flip of the image is turn(place) + flip - turn(piece), modulo 2 (see `geometry`). The
        // turn of a piece depends only on whether it belongs to the middle layer.
        let exchanges = u16::from(symmetry.edge_turns[8]);
        (0..12).fold((0, 0), |image, i| {
            let (to, inside) = (symmetry.edges[i], slice >> i & 1);
            let flip = flips >> i & 1 ^ u16::from(symmetry.edge_turns[i]) ^ inside & exchanges;
            (image.0 | inside << to, image.1 | flip << to)
        })
    }

    /// Returns the index of those flips that the shape distinguishes: all flips, or only those of
    /// the edges outside the middle layer.
    pub(super) fn flip_number(&self, (slice, flips): Edges) -> u16 {
        // All flips: the twelfth follows. Otherwise: those outside the middle layer, moved
        // together.
        if self.shape.full { flips & 0x7ff } else { gathered(flips, !slice & 0xfff) }
    }

    /// Returns the state of the edges with the middle-layer edges on the places `slice` (bits) and
    /// with the flips of index `number`: the inverse of [`Cosets::flip_number`].
    pub(super) fn edges(&self, slice: u16, number: u16) -> Edges {
        if self.shape.full {
            let last = number.count_ones() as u16 & 1;
            return (slice, number | last << BITS);
        }
        let outside = (0..12).filter(|i| slice >> i & 1 == 0);
        (slice, outside.enumerate().fold(0, |flips, (k, i)| flips | (number >> k & 1) << i))
    }
}

/// Collects the bits of `value` where `mask` has ones into the lowest bits, in their order.
pub(super) fn gathered(value: u16, mask: u16) -> u16 {
    let places = (0..16).filter(|i| mask >> i & 1 == 1);
    places.enumerate().fold(0, |bits, (k, i)| bits | (value >> i & 1) << k)
}

/// Returns whether a corner belongs to the first tetrad: URF and the three corners that half turns
/// bring to its place.
pub(super) fn of_first_tetrad(corner: u8) -> bool {
    [0, 2, 5, 7].contains(&corner)
}

/// Returns the eight twists with the index `number`: the first seven are its digits in base 3, the
/// lowest first. The last twist makes the sum a multiple of 3.
fn twists(mut number: usize) -> [u8; 8] {
    let mut twists = [0; 8];
    for twist in &mut twists[..7] {
        *twist = (number % 3) as u8;
        number /= 3;
    }
    twists[7] = (3 - twists.iter().sum::<u8>() % 3) % 3;
    twists
}

/// Returns the solved cube after each of the 18 turns, in the order of [`Turn::index`].
pub(super) fn turns() -> [Cube; 18] {
    std::array::from_fn(|t| Cube::SOLVED.apply(Turn::from_index(t)))
}

/// Returns what a table distinguishes of a cube's corners: their twists, and the places of the
/// first tetrad as bits.
pub(super) fn corners_of(cube: &Cube) -> Corners {
    let first = |i: usize| u8::from(of_first_tetrad(cube.corners()[i]));
    (*cube.twists(), (0..8).fold(0, |bits, i| bits | first(i) << i))
}

/// Returns what a table distinguishes of a cube's edges: the places of the middle-layer edges, and
/// those of flipped edges, as bits.
pub(super) fn edges_of(cube: &Cube) -> Edges {
    (0..12).fold((0, 0), |bits, i| {
        (bits.0 | u16::from(cube.edges()[i] >= 8) << i, bits.1 | u16::from(cube.flips()[i]) << i)
    })
}

/// Returns the state of the corners after a turn, which is given as the solved cube after it.
pub(super) fn turned_corners((twists, mask): &Corners, turn: &Cube) -> Corners {
    let from = turn.corners().map(usize::from);
    let bits = (0..8).fold(0, |bits, i| bits | (mask >> from[i] & 1) << i);
    (std::array::from_fn(|i| (twists[from[i]] + turn.twists()[i]) % 3), bits)
}

/// Returns the state of the edges after a turn, which is given as the solved cube after it.
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

    /// Returns a shape with all flips for each distinction of the tetrads.
    fn shapes() -> [Shape; 3] {
        let all = [Tetrads::Ignored, Tetrads::Unnamed, Tetrads::Named];
        all.map(|tetrads| Shape { tetrads, full: true })
    }

    #[test]
    fn symmetry_classes_cover_all_corner_states() {
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
    fn edge_flips_and_their_indices_convert_both_ways() {
        for full in [false, true] {
            let cosets = Cosets::new(Shape { tetrads: Tetrads::Unnamed, full });
            for number in 0..cosets.shape.words() as u16 * 64 {
                for slice in [cosets.slices[0], cosets.slices[100], 0b1111_0000_0000] {
                    assert_eq!(cosets.flip_number(cosets.edges(slice, number)), number);
                }
            }
        }
    }

    /// Counts the cosets at the distances 0 to 4 by turning whole cubes, without rows, symmetries
    /// and tables.
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
    fn stored_coset_counts_match_search_to_distance_four() {
        for design in [crate::optimal::SMALL, crate::optimal::STANDARD] {
            let known: Vec<usize> = design.distances[..=4].iter().map(|&n| n as usize).collect();
            assert_eq!(reached(design.shape), known);
        }
    }
}
