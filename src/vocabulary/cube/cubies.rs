//! The cube as pieces: eight corners and twelve edges, each somewhere and somehow turned.
//!
//! - in: facelets, turns, a seed
//! - out: a [`Cube`], which is always one that can be solved; [`super::legality`] tells why stickers are no such cube
//! - source: Kociemba's cubie level; a state is written as a product, position by position

use super::{Face, Facelets, Turn};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use std::sync::LazyLock;

/// A cube that can be reached from the solved one by face turns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Cube {
    /// Which corner is at each position, in the order of [`CORNERS`].
    pub(super) corners: [u8; 8],
    /// How often the corner there is turned clockwise, 0..3.
    pub(super) twists: [u8; 8],
    /// Which edge is at each position, in the order of [`EDGES`].
    pub(super) edges: [u8; 12],
    /// Whether the edge there is turned over.
    pub(super) flips: [u8; 12],
}

/// The three faces of each corner clockwise, up or down first.
pub const CORNERS: [[Face; 3]; 8] = {
    use Face::{B, D, F, L, R, U};
    [[U, R, F], [U, F, L], [U, L, B], [U, B, R], [D, F, R], [D, L, F], [D, B, L], [D, R, B]]
};

/// The two faces of each edge: up or down first, in the middle layer front or back first.
pub const EDGES: [[Face; 2]; 12] = {
    use Face::{B, D, F, L, R, U};
    [[U, R], [U, F], [U, L], [U, B], [D, R], [D, F], [D, L], [D, B], [F, R], [F, L], [B, L], [B, R]]
};

/// Numbers of the stickers of each corner, in the order of [`CORNERS`].
pub(super) const CORNER_FACELETS: [[usize; 3]; 8] = [
    [8, 9, 20],
    [6, 18, 38],
    [0, 36, 47],
    [2, 45, 11],
    [29, 26, 15],
    [27, 44, 24],
    [33, 53, 42],
    [35, 17, 51],
];

/// Numbers of the stickers of each edge, in the order of [`EDGES`].
pub(super) const EDGE_FACELETS: [[usize; 2]; 12] = [
    [5, 10],
    [7, 19],
    [3, 37],
    [1, 46],
    [32, 16],
    [28, 25],
    [30, 43],
    [34, 52],
    [23, 12],
    [21, 41],
    [50, 39],
    [48, 14],
];

/// The six clockwise quarter turns, in the order of [`Face::ALL`].
static QUARTERS: LazyLock<[Cube; 6]> = LazyLock::new(|| {
    Face::ALL.map(|face| {
        let turned = Facelets::solved().turned(Turn { face, quarters: 1 });
        Cube::try_from(turned).unwrap_or(Cube::SOLVED)
    })
});

impl Cube {
    /// The solved cube.
    pub const SOLVED: Self = Self {
        corners: [0, 1, 2, 3, 4, 5, 6, 7],
        twists: [0; 8],
        edges: [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11],
        flips: [0; 12],
    };

    /// Takes the pieces as they are: for coordinates, which number parts of a cube.
    ///
    /// Nothing is checked: [`Cube::try_from`] is the way to a cube that can be solved. The searches
    /// end without a solution, or panic, on one that cannot.
    #[must_use]
    pub const fn from_pieces(
        corners: [u8; 8],
        twists: [u8; 8],
        edges: [u8; 12],
        flips: [u8; 12],
    ) -> Self {
        Self { corners, twists, edges, flips }
    }

    /// Returns which corner is at each position, in the order of [`CORNERS`].
    #[inline]
    #[must_use]
    pub const fn corners(&self) -> &[u8; 8] {
        &self.corners
    }

    /// Returns how often the corner at each position is turned clockwise, 0..3.
    #[inline]
    #[must_use]
    pub const fn twists(&self) -> &[u8; 8] {
        &self.twists
    }

    /// Returns which edge is at each position, in the order of [`EDGES`].
    #[inline]
    #[must_use]
    pub const fn edges(&self) -> &[u8; 12] {
        &self.edges
    }

    /// Returns whether the edge at each position is turned over, 0 or 1.
    #[inline]
    #[must_use]
    pub const fn flips(&self) -> &[u8; 12] {
        &self.flips
    }

    /// Whether a cube with these stickers (0..=5, order URFDLB, centres in order) can exist.
    #[must_use]
    pub fn is_possible(colours: &[u8; 54]) -> bool {
        Facelets::try_from(*colours).is_ok_and(|facelets| Self::try_from(facelets).is_ok())
    }

    /// Drawn uniformly from all 4.3e19 states.
    #[must_use]
    pub fn scrambled(seed: u64) -> Self {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut cube = Self::SOLVED;
        cube.corners.shuffle(&mut random);
        cube.edges.shuffle(&mut random);
        if odd(&cube.corners) != odd(&cube.edges) {
            cube.edges.swap(0, 1);
        }
        for twist in &mut cube.twists[..7] {
            *twist = random.random_range(0..3);
        }
        for flip in &mut cube.flips[..11] {
            *flip = random.random_range(0..2);
        }
        cube.twists[7] = (3 - cube.twists.iter().sum::<u8>() % 3) % 3;
        cube.flips[11] = cube.flips.iter().sum::<u8>() % 2;
        cube
    }

    /// The cube after a turn.
    #[must_use]
    pub fn apply(&self, turn: Turn) -> Self {
        let quarter = &QUARTERS[turn.face.index()];
        (0..turn.quarters).fold(*self, |cube, _| cube.then(quarter))
    }

    /// The cube after several turns.
    #[must_use]
    pub fn apply_all(&self, turns: &[Turn]) -> Self {
        turns.iter().fold(*self, |cube, &turn| cube.apply(turn))
    }

    /// The state that the turns leading to `other` from the solved cube make of this one.
    #[must_use]
    pub fn then(&self, other: &Self) -> Self {
        let mut product = Self::SOLVED;
        for i in 0..8 {
            let from = usize::from(other.corners[i]);
            product.corners[i] = self.corners[from];
            product.twists[i] = (self.twists[from] + other.twists[i]) % 3;
        }
        for i in 0..12 {
            let from = usize::from(other.edges[i]);
            product.edges[i] = self.edges[from];
            product.flips[i] = self.flips[from] ^ other.flips[i];
        }
        product
    }

    /// The state whose turns undo this one's.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let mut inverse = Self::SOLVED;
        for i in 0..8 {
            let to = usize::from(self.corners[i]);
            inverse.corners[to] = i as u8;
            inverse.twists[to] = (3 - self.twists[i]) % 3;
        }
        for i in 0..12 {
            let to = usize::from(self.edges[i]);
            inverse.edges[to] = i as u8;
            inverse.flips[to] = self.flips[i];
        }
        inverse
    }

    /// Whether nothing is left to do.
    #[must_use]
    pub fn is_solved(&self) -> bool {
        *self == Self::SOLVED
    }
}

impl Default for Cube {
    fn default() -> Self {
        Self::SOLVED
    }
}

/// Whether a permutation is odd.
pub(super) fn odd(permutation: &[u8]) -> bool {
    let inversions = (0..permutation.len())
        .map(|i| permutation[i + 1..].iter().filter(|&&p| p < permutation[i]).count())
        .sum::<usize>();
    inversions % 2 == 1
}

impl From<&Cube> for Facelets {
    fn from(cube: &Cube) -> Self {
        let mut faces: [Face; 54] = std::array::from_fn(|i| Face::ALL[i / 9]);
        for (i, places) in CORNER_FACELETS.iter().enumerate() {
            for (k, colour) in CORNERS[usize::from(cube.corners[i])].into_iter().enumerate() {
                faces[places[(k + usize::from(cube.twists[i])) % 3]] = colour;
            }
        }
        for (i, places) in EDGE_FACELETS.iter().enumerate() {
            for (k, colour) in EDGES[usize::from(cube.edges[i])].into_iter().enumerate() {
                faces[places[(k + usize::from(cube.flips[i])) % 2]] = colour;
            }
        }
        Self::from_faces(faces)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::{facelet_at, parse_turns};
    use proptest::prelude::*;

    fn cell(faces: &[Face]) -> [i8; 3] {
        let sum: nalgebra::Vector3<f64> = faces.iter().map(|f| f.normal()).sum();
        [sum.x as i8, sum.y as i8, sum.z as i8]
    }

    #[test]
    fn the_stickers_of_each_piece_follow_from_geometry() {
        for (faces, places) in CORNERS.iter().zip(CORNER_FACELETS) {
            assert_eq!(places, faces.map(|f| facelet_at(cell(faces), f)));
            // Clockwise seen from outside: the triple product of the normals is negative.
            let [a, b, c] = faces.map(Face::normal);
            assert!(a.cross(&b).dot(&c) < 0.0);
        }
        for (faces, places) in EDGES.iter().zip(EDGE_FACELETS) {
            assert_eq!(places, faces.map(|f| facelet_at(cell(faces), f)));
        }
    }

    #[test]
    fn the_superflip_takes_its_known_twenty_turns() {
        let turns = parse_turns("U R2 F B R B2 R U2 L B2 R U' D' R2 F R' L B2 U2 F2").unwrap();

        let cube = Cube::SOLVED.apply_all(&turns);

        assert_eq!(cube, Cube { flips: [1; 12], ..Cube::SOLVED });
    }

    #[test]
    fn scrambles_depend_on_the_seed_and_are_legal() {
        for seed in 0..200 {
            let cube = Cube::scrambled(seed);

            assert_eq!(Cube::try_from(Facelets::from(&cube)), Ok(cube));
            assert_eq!(cube, Cube::scrambled(seed));
            assert_ne!(cube, Cube::scrambled(seed + 1));
        }
    }

    proptest! {
        #[test]
        fn turning_pieces_is_turning_stickers(seed: u64, turns in prop::collection::vec(0..18usize, 0..30)) {
            let start = Cube::scrambled(seed);
            let turns: Vec<Turn> = turns.into_iter().map(Turn::from_index).collect();

            let by_stickers = turns.iter().fold(Facelets::from(&start), |f, &t| f.turned(t));

            prop_assert_eq!(Facelets::from(&start.apply_all(&turns)), by_stickers);
        }

        #[test]
        fn a_cube_then_its_inverse_is_solved(seed: u64) {
            let cube = Cube::scrambled(seed);

            prop_assert!(cube.then(&cube.inverse()).is_solved());
            prop_assert!(cube.inverse().then(&cube).is_solved());
        }
    }
}
