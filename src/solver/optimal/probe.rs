//! A cube as two vectors of bytes: how it is turned, and where its entry in a table is.
//!
//! - in: a cube, a turn after or before all others, an axis that is made upright
//! - out: the turned cube; the line and the bit of its entry
//! - source: A. Skalski, vcube, for a cube in two vectors, each turned by one look-up

#![allow(
    clippy::inline_always,
    reason = "the search is compiled once with vector instructions, and only callees that are \
              inlined into it can use them"
)]

use super::build::{LINE, row_bytes};
use super::coset::{Cosets, turns};
use super::geometry::{UPRIGHT, tilts};
use super::lanes::Lanes;
use crate::cube::Cube;

/// A cube: for each place its piece + 16 * twist or flip. The bytes after the last place hold their
/// own numbers, which turns keep.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(C, align(32))]
pub(super) struct Bytes {
    edges: [u8; 16],
    corners: [u8; 16],
}

impl Bytes {
    /// Packs a cube into two vectors of bytes, one for the edges and one for the corners.
    pub(super) fn new(cube: &Cube) -> Self {
        let mut bytes = Self { edges: NONE, corners: NONE };
        for i in 0..12 {
            bytes.edges[i] = cube.edges()[i] | cube.flips()[i] << 4;
        }
        for i in 0..8 {
            bytes.corners[i] = cube.corners()[i] | cube.twists()[i] << 4;
        }
        bytes
    }
}

/// Identity: each place has the piece of its own number.
const NONE: [u8; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];
/// Mask of the piece in a byte.
const PIECE: u8 = 0x0f;
/// Mask of the bit of a flip in each byte.
const FLIP: [u8; 16] = [0x10; 16];
/// Mask of the bits of a twist; also the modulus of twists, 3 * 16.
const TWIST: [u8; 16] = [0x30; 16];

/// A turn in the forms that [`Prober::turned`] and [`Prober::preceded_by`] need.
#[derive(Debug, Clone, Copy)]
struct TurnBytes {
    /// Place from which each place gets its piece.
    from: Bytes,
    /// Twist or flip that is added at each place.
    add: Bytes,
    /// Place, and twist or flip, in one byte.
    whole: Bytes,
}

/// A symmetry in the form of look-up tables.
#[derive(Debug, Clone, Copy)]
struct Image {
    /// Image of each piece, with the twist or flip that its change of name adds.
    pieces: [u8; 16],
    /// Place from which each place gets its piece.
    from: [u8; 16],
    /// Twist or flip that is added at each place.
    add: [u8; 16],
}

/// Position of the entry of a cube in the table.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Entry {
    /// First byte of the line.
    pub(super) line: u32,
    /// Number of the entry in the line.
    pub(super) bit: u8,
}

/// Tables that turn cubes and find their entries.
#[derive(Debug, Clone)]
pub(super) struct Prober {
    /// Whether the table distinguishes all flips.
    full: bool,
    turns: [TurnBytes; 18],
    /// Rotation that makes each axis upright, for the corners.
    tilted_corners: [Image; 3],
    /// Rotation that makes each axis upright, followed by a symmetry, for the edges:
    /// `[axis * 16 + symmetry]`.
    edges: [Image; 3 * UPRIGHT],
    /// First byte of the row + the symmetry that leads to it: `[twist * splits + split]`.
    rows: Vec<u32>,
    /// Number of splits of the corners into tetrads.
    splits: u32,
    /// Number of the split by the places of the first tetrad as bits.
    split_of: [u8; 256],
    /// First byte within a row, by the places of the middle edges as bits.
    slices: Box<[u32; 4096]>,
}

impl Prober {
    /// Computes the look-up tables that turn packed cubes and find their entries in a table over
    /// `cosets`.
    pub(super) fn new(cosets: &Cosets) -> Self {
        let tilts = tilts();
        let row = row_bytes(cosets.shape) as u32;
        let slice = (cosets.shape.words() / 4 * LINE) as u32;
        let upright = UPRIGHT as u32;
        Self {
            full: cosets.shape.full,
            turns: turns().each_ref().map(turn_bytes),
            tilted_corners: tilts.each_ref().map(|tilt| {
                let mut image = Image { pieces: [0; 16], from: NONE, add: [0; 16] };
                for i in 0..8 {
                    let (to, turn) = (tilt.corners[i], tilt.corner_turns[i]);
                    image.pieces[i] = to | ((3 - turn) % 3) << 4;
                    image.from[usize::from(to)] = i as u8;
                    image.add[usize::from(to)] = turn << 4;
                }
                image
            }),
            edges: std::array::from_fn(|q| {
                let symmetry = tilts[q / UPRIGHT].then(&cosets.upright[q % UPRIGHT]);
                let mut image = Image { pieces: [0; 16], from: NONE, add: [0; 16] };
                // The table only distinguishes middle edges from others: bit 7 marks them.
                for i in 0..12 {
                    let (to, turn) = (symmetry.edges[i], symmetry.edge_turns[i]);
                    image.pieces[i] = turn << 4 | u8::from(to >= 8) << 7;
                    image.from[usize::from(to)] = i as u8;
                    image.add[usize::from(to)] = turn << 4;
                }
                image
            }),
            // Rows are multiples of 64 bytes, so the lowest four bits are free for the symmetry.
            rows: cosets.rows.iter().map(|r| r / upright * row + r % upright).collect(),
            splits: cosets.splits as u32,
            split_of: std::array::from_fn(|bits| cosets.split_of[bits]),
            slices: Box::new(std::array::from_fn(|b| u32::from(cosets.slice_of[b]) * slice)),
        }
    }

    /// Returns the cube after the turn with the index `turn`.
    #[inline(always)]
    pub(super) fn turned<L: Lanes>(&self, cube: &Bytes, turn: usize) -> Bytes {
        let TurnBytes { from, add, .. } = &self.turns[turn];
        let edges = L::load(&cube.edges).look_up(L::load(&from.edges)).xor(L::load(&add.edges));
        let corners = L::load(&cube.corners)
            .look_up(L::load(&from.corners))
            .add(L::load(&add.corners))
            .wrap(L::load(&TWIST));
        Bytes { edges: edges.store(), corners: corners.store() }
    }

    /// Returns the cube that results if `turn` is made on the solved cube before the turns that
    /// lead to `cube`.
    #[inline(always)]
    pub(super) fn preceded_by<L: Lanes>(&self, cube: &Bytes, turn: usize) -> Bytes {
        // An earlier turn renames the pieces: each piece of the cube becomes the one that the turn
        // has brought to its place, and their twists add up.
        let whole = &self.turns[turn].whole;
        let (edges, corners) = (L::load(&cube.edges), L::load(&cube.corners));
        let turned_edges = L::load(&whole.edges).look_up(edges).xor(edges.and(L::load(&FLIP)));
        let turned_corners = L::load(&whole.corners)
            .look_up(corners)
            .add(corners.and(L::load(&TWIST)))
            .wrap(L::load(&TWIST));
        Bytes { edges: turned_edges.store(), corners: turned_corners.store() }
    }

    /// Computes where a table has the entry of a cube that is rotated to bring an axis upright: 0
    /// U-D, 1 R-L, 2 F-B.
    #[inline(always)]
    pub(super) fn entry<L: Lanes>(&self, cube: &Bytes, axis: usize) -> Entry {
        // The corners come first, because their row decides which symmetry maps the edges. They
        // need only the rotation: `rows` includes the effect of the symmetry on them.
        let mut corners = L::load(&cube.corners);
        if axis != 0 {
            let image = &self.tilted_corners[axis];
            corners = L::load(&image.pieces)
                .look_up(corners)
                .add(corners.and(L::load(&TWIST)))
                .wrap(L::load(&TWIST))
                .look_up(L::load(&image.from))
                .add(L::load(&image.add))
                .wrap(L::load(&TWIST));
        }
        // Corners 0, 2, 5, 7, the first tetrad, are those whose lowest and third bit are equal.
        let split = self.split_of[(!(corners.bits::<5>() ^ corners.bits::<7>()) & 255) as usize];
        let row = self.rows[(corners.ternary() * self.splits + u32::from(split)) as usize];
        let image = &self.edges[axis * UPRIGHT + row as usize % UPRIGHT];
        let edges = L::load(&cube.edges);
        let edges = L::load(&image.pieces)
            .look_up(edges)
            .xor(edges.and(L::load(&FLIP)))
            .look_up(L::load(&image.from))
            .xor(L::load(&image.add));
        let slice = edges.bits::<0>() & 0xfff;
        let flips = edges.bits::<3>();
        let line = row / UPRIGHT as u32 * UPRIGHT as u32 + self.slices[slice as usize];
        // A line has 256 entries: 8 lines for the 2048 states of all flips, one for 256.
        if self.full {
            Entry { line: line + (flips >> 8 & 7) * LINE as u32, bit: flips as u8 }
        } else {
            Entry { line, bit: L::gathered(flips, !slice & 0xfff) as u8 }
        }
    }
}

/// Packs a turn, given as the solved cube after it, into bytes that turn a packed cube.
fn turn_bytes(turn: &Cube) -> TurnBytes {
    let whole = Bytes::new(turn);
    let part = |mask: u8| Bytes {
        edges: whole.edges.map(|b| b & mask),
        corners: whole.corners.map(|b| b & mask),
    };
    TurnBytes { from: part(PIECE), add: part(!PIECE), whole }
}

/// Returns a lower bound on the number of turns that solve the cube of `entry`. `base` is the
/// number of turns up to which all cosets of the table have one code ([`super::build`]).
#[inline(always)]
pub(super) fn bound(table: &[u8], base: u8, entry: Entry) -> u8 {
    let line = &table[entry.line as usize..][..LINE];
    let (byte, shift) = (usize::from(entry.bit >> 3), entry.bit & 7);
    let first = line[byte] >> shift & 1;
    let second = line[byte + LINE / 2] >> shift & 1;
    // At the base and below, the least distance in the line is the best bound at hand; its four
    // bits lie in the room of the first two entries.
    if first & second == 1 || entry.bit < 2 {
        line[0] & 3 | (line[LINE / 2] & 3) << 2
    } else {
        // (0, 1): one above the base, (1, 0): two, (0, 0): three and more.
        base + 3 - first - 2 * second
    }
}

#[cfg(test)]
mod tests {
    use super::super::coset::{Shape, Tetrads};
    use super::super::lanes::Plain;
    use super::*;
    use crate::cube::Turn;

    /// Returns a prober for the flips of eight edges and one for all flips.
    fn probers() -> [Prober; 2] {
        [false, true]
            .map(|full| Prober::new(&Cosets::new(Shape { tetrads: Tetrads::Unnamed, full })))
    }

    /// A turn after or before all other turns changes the packed cube as it changes the cube.
    #[test]
    fn packed_cubes_turn_like_cubes() {
        let prober = &probers()[0];
        for seed in 0..20 {
            let cube = Cube::scrambled(seed);
            for (number, turn) in Turn::all().enumerate() {
                let turned = prober.turned::<Plain>(&Bytes::new(&cube), number);
                assert_eq!(turned, Bytes::new(&cube.apply(turn)));

                let begun = prober.preceded_by::<Plain>(&Bytes::new(&cube), number);
                assert_eq!(begun, Bytes::new(&Cube::SOLVED.apply(turn).then(&cube)));
            }
        }
    }

    /// A half turn before all other turns, and the sense of a quarter turn there, change no entry.
    #[test]
    fn leading_half_turns_do_not_change_table_entry() {
        for prober in probers() {
            for seed in 0..20 {
                let cube = Bytes::new(&Cube::scrambled(seed));
                for axis in 0..3 {
                    let entry = |cube: &Bytes| {
                        let entry = prober.entry::<Plain>(cube, axis);
                        (entry.line, entry.bit)
                    };
                    for face in 0..6 {
                        let after = |turn: usize| {
                            entry(&prober.preceded_by::<Plain>(&cube, face * 3 + turn))
                        };
                        assert_eq!(after(1), entry(&cube));
                        assert_eq!(after(0), after(2));
                    }
                }
            }
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn vector_instructions_find_same_entries_as_plain_code() {
        use super::super::lanes::Vector;
        if !is_x86_feature_detected!("avx2") || !is_x86_feature_detected!("bmi2") {
            return;
        }
        for prober in probers() {
            for seed in 0..100 {
                let cube = Bytes::new(&Cube::scrambled(seed));
                for turn in 0..18 {
                    let turned = prober.turned::<Vector>(&cube, turn);
                    assert_eq!(turned, prober.turned::<Plain>(&cube, turn));
                    let begun = prober.preceded_by::<Vector>(&cube, turn);
                    assert_eq!(begun, prober.preceded_by::<Plain>(&cube, turn));
                }
                for axis in 0..3 {
                    let fast = prober.entry::<Vector>(&cube, axis);
                    let plain = prober.entry::<Plain>(&cube, axis);
                    assert_eq!((fast.line, fast.bit), (plain.line, plain.bit));
                }
            }
        }
    }
}
