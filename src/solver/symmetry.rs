//! The 16 symmetries of a cube that keep the up-down axis, applied to the coordinates of phase 1.
//!
//! A symmetry is a rotation or reflection of the cube onto itself. A state and its image have equal
//! distances from the goal of phase 1, so a table needs one entry for each class of symmetric
//! states: 64430 classes of (slice, flip) instead of 495 x 2048 = 1013760 states. A slice is the
//! set of places of the four middle-layer edges, a flip the state of all flips.
//!
//! Twists and flips are counted relative to up and down, which these symmetries keep. A reflection
//! reverses the twists. A quarter turn about the vertical axis exchanges the pairs of side faces
//! that define the flip of a middle-layer edge.

use super::coordinates::{FLIPS, SLICES, TWISTS, quad, twist, with_flip, with_quad, with_twist};
use crate::cube::{CORNERS, Cube, EDGES, Face};
use std::sync::LazyLock;

/// Number of symmetries that keep the up-down axis.
pub(crate) const SYMMETRIES: usize = 16;
/// Number of classes of (slice, flip); this is the known count (H. Kociemba).
pub(crate) const CLASSES: usize = 64430;

/// One symmetry, as permutations of the places of a cube.
#[derive(Debug, Clone, Copy)]
struct Symmetry {
    /// Image of each face, in the order of [`Face::ALL`].
    faces: [Face; 6],
    /// Image of each corner place.
    corners: [u8; 8],
    /// Image of each edge place.
    edges: [u8; 12],
    /// Whether the symmetry is a reflection.
    mirrors: bool,
    /// Whether the symmetry exchanges the axes R-L and F-B.
    exchanges_sides: bool,
}

impl Symmetry {
    /// Makes the symmetry that carries each face to `faces[face]`.
    fn new(faces: [Face; 6]) -> Self {
        let carry = |f: &Face| faces[f.index()];
        let corners = CORNERS.map(|c| place(&CORNERS, c.each_ref().map(carry)));
        let edges = EDGES.map(|e| place(&EDGES, e.each_ref().map(carry)));
        let [u, r, f] = [Face::U, Face::R, Face::F].map(|f| faces[f.index()].normal());
        Self {
            faces,
            corners,
            edges,
            // U x R = B on a cube that is no mirror image, and B points away from F.
            mirrors: u.cross(&r).dot(&f) > 0.0,
            exchanges_sides: faces[Face::R.index()].axis() != Face::R.axis(),
        }
    }

    /// Returns the index of the twists (0..2187) of the image of a cube whose own twists have the
    /// index `number`.
    fn twist(&self, number: usize) -> usize {
        let mut image = [0; 8];
        for (i, &t) in with_twist(number).twists().iter().enumerate() {
            image[usize::from(self.corners[i])] = if self.mirrors { (3 - t) % 3 } else { t };
        }
        let solved = Cube::SOLVED;
        twist(&Cube::from_pieces(*solved.corners(), image, *solved.edges(), *solved.flips()))
    }

    /// Returns the images of two sets of places, as bits: the places of the middle-layer edges
    /// (`slice`) and those of flipped edges (`flips`).
    fn edges(&self, slice: u16, flips: u16) -> (u16, u16) {
        let (mut image_slice, mut image_flips) = (0, 0);
        for i in 0..12 {
            let to = self.edges[i];
            let (inside, flip) = (slice >> i & 1, flips >> i & 1);
            // A flip compares the marked sticker of a piece with the marked sticker of its place.
            // An exchange of sides moves the marks of middle-layer pieces and of middle-layer
            // places (8..12). The changes cancel unless exactly one of the two is of the middle
            // layer.
            let changes = u16::from(self.exchanges_sides) & (inside ^ u16::from(i >= 8));
            image_slice |= inside << to;
            image_flips |= (flip ^ changes) << to;
        }
        (image_slice, image_flips)
    }
}

/// Returns the index of the corner or edge place that lies on these faces, in any order.
fn place<const N: usize>(pieces: &[[Face; N]], mut faces: [Face; N]) -> u8 {
    faces.sort_unstable();
    let same = |p: &[Face; N]| {
        let mut sorted = *p;
        sorted.sort_unstable();
        sorted == faces
    };
    pieces.iter().position(same).unwrap_or(0) as u8
}

/// Returns the sixteen symmetries that keep the up-down axis: eight rotations, then these rotations
/// followed by a reflection left-right. The first one is the identity.
fn symmetries() -> [Symmetry; SYMMETRIES] {
    use Face::{B, D, F, L, R, U};
    // Images of U, R, F, D, L, B: a quarter about U-D, a half about F-B, a reflection of R and L.
    let quarter = [U, F, L, D, B, R];
    let half_over = [D, L, F, U, R, B];
    let mirror = [U, L, F, D, R, B];
    std::array::from_fn(|s| {
        let mut faces = Face::ALL;
        let steps = std::iter::repeat_n(quarter, s % 4)
            .chain(std::iter::repeat_n(half_over, s / 4 % 2))
            .chain(std::iter::repeat_n(mirror, s / 8));
        for step in steps {
            faces = faces.map(|f| step[f.index()]);
        }
        Symmetry::new(faces)
    })
}

/// Returns the table of the twists' images: `[symmetry * TWISTS + twist]` is the index of the
/// twists after the symmetry.
#[must_use]
pub(crate) fn twist_images() -> Vec<u16> {
    let all = symmetries();
    all.iter().flat_map(|s| (0..TWISTS).map(|n| s.twist(n) as u16)).collect()
}

/// Classes of symmetric states (slice, flip) = slice * FLIPS + flip.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Classes {
    /// For each (slice, flip): 16 * class + the symmetry that carries the state to the
    /// representative of its class.
    pub of: Vec<u32>,
    /// Representative of each class: its least state, so they ascend.
    pub representatives: Vec<u32>,
    /// Symmetries that map the representative of each class to itself, as bits.
    pub stabilisers: Vec<u16>,
}

impl Classes {
    /// Divides all states (slice, flip) into classes of symmetric ones.
    #[must_use]
    pub(crate) fn build() -> Self {
        let all = symmetries();
        let inverse = inverses(&all);
        let (number_of, bits_of) = edge_bits();
        let mut classes = Self {
            of: vec![u32::MAX; SLICES * FLIPS],
            representatives: Vec::with_capacity(CLASSES),
            stabilisers: Vec::with_capacity(CLASSES),
        };
        // The first state of a class that this loop meets is its least one, its representative.
        for raw in 0..SLICES * FLIPS {
            if classes.of[raw] != u32::MAX {
                continue;
            }
            let class = classes.representatives.len() as u32;
            let (slice, flips) = (bits_of.0[raw / FLIPS], bits_of.1[raw % FLIPS]);
            let mut stabiliser = 0;
            for (s, symmetry) in all.iter().enumerate() {
                let (image_slice, image_flips) = symmetry.edges(slice, flips);
                let image = usize::from(number_of.0[usize::from(image_slice)]) * FLIPS
                    + usize::from(number_of.1[usize::from(image_flips)]);
                // The symmetry s leads from the representative to the image, its inverse back. If
                // several do, the first is kept.
                if classes.of[image] == u32::MAX {
                    classes.of[image] = class * 16 + inverse[s] as u32;
                }
                stabiliser |= u16::from(image == raw) << s;
            }
            classes.representatives.push(raw as u32);
            classes.stabilisers.push(stabiliser);
        }
        classes
    }
}

impl Classes {
    /// Returns the class of a state (slice, flip) and a symmetry that carries the state to the
    /// representative of the class, without the table [`Classes::of`] of 4 MB.
    #[must_use]
    pub(crate) fn find(&self, slice: usize, flip: usize) -> (u32, u8) {
        let (number_of, bits_of) = &*EDGE_BITS;
        let (slice, flips) = (bits_of.0[slice], bits_of.1[flip]);
        let image = |symmetry: &Symmetry| {
            let (slice, flips) = symmetry.edges(slice, flips);
            u32::from(number_of.0[usize::from(slice)]) * FLIPS as u32
                + u32::from(number_of.1[usize::from(flips)])
        };
        // A representative is the least of its class.
        let images = ALL.each_ref().map(image);
        let least = (0..SYMMETRIES).min_by_key(|&s| images[s]).unwrap_or(0);
        let class = self.representatives.partition_point(|&r| r < images[least]);
        (class as u32, least as u8)
    }
}

/// Symmetries of [`symmetries`], computed once.
static ALL: LazyLock<[Symmetry; SYMMETRIES]> = LazyLock::new(symmetries);
/// Tables of [`edge_bits`], computed once.
static EDGE_BITS: LazyLock<EdgeBits> = LazyLock::new(edge_bits);

/// Images of turns under the symmetries, and products of symmetries.
#[derive(Debug, Clone)]
pub(crate) struct Turned {
    /// Turn of the cube for each turn of its image: `[symmetry][turn of the image]`.
    pub back: [[u8; 18]; SYMMETRIES],
    /// Product of two symmetries, first b, then a: `[a][b]`.
    pub after: [[u8; SYMMETRIES]; SYMMETRIES],
    /// Turns of the image that may follow a turn of the cube, as bits:
    /// `[symmetry][turn of the cube, or 18 for none]`.
    pub may_follow: [[u32; 19]; SYMMETRIES],
}

impl Turned {
    /// Computes the images of all turns under all symmetries, and the products of all symmetries.
    #[must_use]
    pub(crate) fn build() -> Self {
        let all = &*ALL;
        // A reflection reverses the sense of a turn: quarters 1, 2, 3 become 3, 2, 1.
        let forth = |s: usize, turn: usize| {
            let quarters = if all[s].mirrors { 2 - turn % 3 } else { turn % 3 };
            all[s].faces[turn / 3].index() * 3 + quarters
        };
        let mut built = Self {
            back: [[0; 18]; SYMMETRIES],
            after: [[0; SYMMETRIES]; SYMMETRIES],
            may_follow: [[0; 19]; SYMMETRIES],
        };
        for s in 0..SYMMETRIES {
            for turn in 0..18 {
                built.back[s][forth(s, turn)] = turn as u8;
            }
            for last in 0..19 {
                // No second turn of one face. Turns of opposite faces commute, so of both orders
                // only U D, R L, F B is searched. Face 6 means that there was no turn.
                let follows = |turn: &usize| {
                    let (face, last) = (turn / 3, last / 3);
                    last == 6 || face != last && face + 3 != last
                };
                let turns = (0..18).filter(follows);
                built.may_follow[s][last] = turns.fold(0, |mask, t| mask | 1 << forth(s, t));
            }
            // The images of the corners identify a symmetry.
            for b in 0..SYMMETRIES {
                let both = all[b].corners.map(|c| all[s].corners[usize::from(c)]);
                let same = all.iter().position(|c| c.corners == both);
                built.after[s][b] = same.unwrap_or(0) as u8;
            }
        }
        built
    }
}

/// Returns two tables, `[symmetry][place]`: the image of each corner place and of each edge place.
#[must_use]
pub(crate) fn places() -> ([[u8; 8]; SYMMETRIES], [[u8; 12]; SYMMETRIES]) {
    (ALL.each_ref().map(|s| s.corners), ALL.each_ref().map(|s| s.edges))
}

/// Slices and flips as bits by place: (number of bits, bits of number), each for (slice, flip).
type EdgeBits = ((Vec<u16>, Vec<u16>), (Vec<u16>, Vec<u16>));

/// Computes the tables that convert the indices of slice and flips into sets of places as bits, and
/// back.
fn edge_bits() -> EdgeBits {
    let slices: Vec<u16> = (0..SLICES)
        .map(|n| {
            let cube = with_quad(n * 24);
            debug_assert_eq!(quad(&cube, 8) / 24, n);
            (0..12).filter(|&i| cube.edges()[i] >= 8).fold(0, |bits, i| bits | 1 << i)
        })
        .collect();
    let flips: Vec<u16> = (0..FLIPS)
        .map(|n| (0..12).fold(0, |bits, i| bits | u16::from(with_flip(n).flips()[i]) << i))
        .collect();
    let back = |bits: &[u16]| {
        let mut number = vec![0; 4096];
        bits.iter().enumerate().for_each(|(n, &b)| number[usize::from(b)] = n as u16);
        number
    };
    ((back(&slices), back(&flips)), (slices, flips))
}

/// Returns the index of the inverse of each symmetry.
fn inverses(all: &[Symmetry; SYMMETRIES]) -> [usize; SYMMETRIES] {
    all.each_ref().map(|a| {
        let undoes = |b: &Symmetry| (0..8).all(|i| b.corners[usize::from(a.corners[i])] == i as u8);
        all.iter().position(undoes).unwrap_or(0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coordinates::{flip, flip_moves, quad_moves, twist_moves};
    use crate::cube::Turn;

    #[test]
    fn symmetry_classes_have_their_known_number() {
        let classes = Classes::build();

        assert_eq!(classes.representatives.len(), CLASSES);
        assert!(classes.of.iter().all(|&c| c != u32::MAX));
    }

    #[test]
    fn symmetries_are_distinct_and_begin_with_identity() {
        let mut images: Vec<[u8; 8]> = symmetries().iter().map(|s| s.corners).collect();
        assert_eq!(images[0], *Cube::SOLVED.corners());
        images.sort_unstable();
        images.dedup();
        assert_eq!(images.len(), SYMMETRIES);
    }

    /// The images of the neighbours of a cube are the neighbours of its image, in all coordinates.
    #[test]
    fn symmetries_map_adjacent_states_to_adjacent_states() {
        let (number_of, bits_of) = edge_bits();
        let (twists, flips, quads) = (twist_moves(), flip_moves(), quad_moves());
        let quads = &quads;
        let cube = Cube::scrambled(3);
        let state = (quad(&cube, 8) / 24, flip(&cube), twist(&cube));
        let turned = |(slice, flip, twist): (usize, usize, usize)| {
            Turn::all().map(Turn::index).map(move |t| {
                (usize::from(quads[t * SLICES * 24 + slice * 24]) / 24, flip, twist, t)
            })
        };
        for symmetry in symmetries() {
            let image = |(slice, flip, twist): (usize, usize, usize)| {
                let (s, f) = symmetry.edges(bits_of.0[slice], bits_of.1[flip]);
                let slice = usize::from(number_of.0[usize::from(s)]);
                (slice, usize::from(number_of.1[usize::from(f)]), symmetry.twist(twist))
            };
            let neighbours = |state| {
                turned(state)
                    .map(|(slice, flip, twist, t)| {
                        let flip = usize::from(flips[t * FLIPS + flip]);
                        (slice, flip, usize::from(twists[t * TWISTS + twist]))
                    })
                    .collect::<Vec<_>>()
            };
            let mut of_image = neighbours(image(state));
            let mut images: Vec<_> = neighbours(state).into_iter().map(image).collect();

            of_image.sort_unstable();
            images.sort_unstable();
            assert_eq!(of_image, images);
        }
    }
}
