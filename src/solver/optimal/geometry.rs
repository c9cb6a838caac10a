//! The 48 symmetries of a cube as permutations of its places, with the turns of the stickers.
//!
//! - in: the images of the six faces under a symmetry
//! - out: permutations of places, and for each place the turn of its stickers
//! - source: the conventions of H. Kociemba for twists and flips, which [`crate::cube::Cube`] uses
//!
//! A piece `p` with twist `o` on place `i` has its first sticker on the `o`-th facelet of `i`. A
//! symmetry carries that facelet to number `turn(i) + sense * o` of the image of `i`; `sense` is -1
//! for a reflection, else 1. The image therefore has the piece `image(p)` with the twist
//! `turn(i) + sense * o - turn(p)`.

use crate::cube::{CORNERS, EDGES, Face};

/// A rotation or reflection of the cube onto itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Symmetry {
    /// Image of each face, in the order of [`Face::ALL`].
    faces: [Face; 6],
    /// Image of each corner place.
    pub(super) corners: [u8; 8],
    /// Facelet of the image on which the first facelet of each corner place lies.
    pub(super) corner_turns: [u8; 8],
    /// Image of each edge place.
    pub(super) edges: [u8; 12],
    /// Facelet of the image on which the first facelet of each edge place lies.
    pub(super) edge_turns: [u8; 12],
    /// Whether the symmetry is a reflection, which reverses the twists.
    pub(super) mirrors: bool,
}

impl Symmetry {
    /// Makes the symmetry that carries each face to `faces[face]`.
    fn new(faces: [Face; 6]) -> Self {
        let carry = |f: Face| faces[f.index()];
        let corners = CORNERS.map(|c| place(&CORNERS, c.map(carry), carry(c[0])));
        let edges = EDGES.map(|e| place(&EDGES, e.map(carry), carry(e[0])));
        let [u, r, f] = [Face::U, Face::R, Face::F].map(|f| carry(f).normal());
        Self {
            faces,
            corners: corners.map(|(place, _)| place),
            corner_turns: corners.map(|(_, turn)| turn),
            edges: edges.map(|(place, _)| place),
            edge_turns: edges.map(|(_, turn)| turn),
            // U x R = B on a cube that is no mirror image, and B points away from F.
            mirrors: u.cross(&r).dot(&f) > 0.0,
        }
    }

    /// Returns the product of two symmetries: first this one, then `other`.
    pub(super) fn then(&self, other: &Self) -> Self {
        Self::new(self.faces.map(|f| other.faces[f.index()]))
    }
}

/// Returns the index of the corner or edge place that lies on these faces, in any order, and which
/// of its facelets (0, 1, 2) lies on the face `first`.
fn place<const N: usize>(places: &[[Face; N]], faces: [Face; N], first: Face) -> (u8, u8) {
    let found = places.iter().position(|p| faces.iter().all(|f| p.contains(f))).unwrap_or(0);
    let turn = places[found].iter().position(|&f| f == first).unwrap_or(0);
    (found as u8, turn as u8)
}

/// Number of symmetries that keep the up-down axis.
pub(super) const UPRIGHT: usize = 16;

/// Returns the sixteen symmetries that keep the up-down axis; the first one is the identity.
pub(super) fn upright() -> [Symmetry; UPRIGHT] {
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

/// Returns three rotations about the corner URF: the k-th makes axis `k` (0: U-D, 1: R-L, 2: F-B)
/// the up-down axis.
pub(super) fn tilts() -> [Symmetry; 3] {
    use Face::{B, D, F, L, R, U};
    // R to U, F to R, U to F.
    let once = Symmetry::new([F, U, R, B, D, L]);
    [Symmetry::new(Face::ALL), once, once.then(&once)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::{Cube, Turn};

    /// Returns the image of a cube under a symmetry, by the formula in the head of the module.
    fn image(symmetry: &Symmetry, cube: &Cube) -> Cube {
        let (mut corners, mut twists, mut edges, mut flips) = ([0; 8], [0; 8], [0; 12], [0; 12]);
        for i in 0..8 {
            let (to, piece) = (usize::from(symmetry.corners[i]), usize::from(cube.corners()[i]));
            let turned = if symmetry.mirrors { 3 - cube.twists()[i] } else { cube.twists()[i] };
            let (at, of) = (symmetry.corner_turns[i], symmetry.corner_turns[piece]);
            corners[to] = symmetry.corners[piece];
            twists[to] = (turned + at + 3 - of) % 3;
        }
        for i in 0..12 {
            let (to, piece) = (usize::from(symmetry.edges[i]), usize::from(cube.edges()[i]));
            edges[to] = symmetry.edges[piece];
            flips[to] = cube.flips()[i] ^ symmetry.edge_turns[i] ^ symmetry.edge_turns[piece];
        }
        Cube::from_pieces(corners, twists, edges, flips)
    }

    #[test]
    fn symmetries_map_turns_to_turns() {
        let turns: Vec<Cube> = Turn::all().map(|t| Cube::SOLVED.apply(t)).collect();
        for upright in upright() {
            for tilt in tilts() {
                let symmetry = tilt.then(&upright);
                for (turn, cube) in Turn::all().zip(&turns) {
                    let quarters = if symmetry.mirrors { 4 - turn.quarters } else { turn.quarters };
                    let face = symmetry.faces[turn.face.index()];
                    let expected = Cube::SOLVED.apply(Turn { face, quarters });
                    assert_eq!(image(&symmetry, cube), expected);
                }
            }
        }
    }

    #[test]
    fn tilts_rotate_each_cube_axis_to_vertical() {
        for (tilt, face) in tilts().iter().zip([Face::U, Face::R, Face::F]) {
            assert_eq!(tilt.faces[face.index()].axis(), Face::U.axis());
        }
    }
}
