//! The cube as eight corners and twelve edges, each with a position and an orientation.
//!
//! - in: facelets, turns, a seed
//! - out: a [`Cube`], which can always be solved; [`super::legality`] names the reason why stickers
//!   do not form one
//! - source: Kociemba's cubie level; the product of two cubes ([`Cube::then`]) is computed position
//!   by position

use super::{Face, Facelets, Turn};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use std::sync::LazyLock;

/// A cube that can be reached from the solved one by face turns.
///
/// ```
/// use rubik_robot_vocabulary::cube::{Cube, parse_turns};
///
/// // R U R' U' has the order 6, and R U has the order 105.
/// for (text, order) in [("R U R' U'", 6), ("R U", 105)] {
///     let turns = parse_turns(text)?;
///     let mut cube = Cube::SOLVED.apply_all(&turns);
///     let mut times = 1;
///     while !cube.is_solved() {
///         cube = cube.apply_all(&turns);
///         times += 1;
///     }
///     assert_eq!(times, order);
/// }
/// # Ok::<(), rubik_robot_vocabulary::cube::ParseTurns>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Cube {
    /// Index of the corner at each position, in the order of [`CORNERS`].
    pub(super) corners: [u8; 8],
    /// Clockwise thirds of a turn by which the corner at each position is twisted, 0..3.
    pub(super) twists: [u8; 8],
    /// Index of the edge at each position, in the order of [`EDGES`].
    pub(super) edges: [u8; 12],
    /// 1 if the edge at each position is flipped, else 0.
    pub(super) flips: [u8; 12],
}

/// Faces of each corner in clockwise order; up or down comes first.
pub const CORNERS: [[Face; 3]; 8] = {
    use Face::{B, D, F, L, R, U};
    [[U, R, F], [U, F, L], [U, L, B], [U, B, R], [D, F, R], [D, L, F], [D, B, L], [D, R, B]]
};

/// Faces of each edge; up or down comes first, in the middle layer front or back.
pub const EDGES: [[Face; 2]; 12] = {
    use Face::{B, D, F, L, R, U};
    [[U, R], [U, F], [U, L], [U, B], [D, R], [D, F], [D, L], [D, B], [F, R], [F, L], [B, L], [B, R]]
};

/// Indices of the stickers of each corner, in the order of [`CORNERS`] and of their faces.
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

/// Indices of the stickers of each edge, in the order of [`EDGES`] and of their faces.
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

/// Clockwise quarter turns as cubes, in the order of [`Face::ALL`].
static QUARTERS: LazyLock<[Cube; 6]> = LazyLock::new(|| {
    // The turns of stickers, which follow from geometry, define those of the pieces. A turned
    // solved cube is always possible, so the default is never used.
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

    /// Makes a cube from its pieces without a check.
    ///
    /// The solver needs this to make cubes that differ from the solved one in a single coordinate.
    /// If the cube cannot be solved, a search for its solution ends without one, or panics. The
    /// conversion from [`Facelets`] refuses such a cube.
    #[must_use]
    pub const fn from_pieces(
        corners: [u8; 8],
        twists: [u8; 8],
        edges: [u8; 12],
        flips: [u8; 12],
    ) -> Self {
        Self { corners, twists, edges, flips }
    }

    /// Returns the index of the corner at each position, in the order of [`CORNERS`].
    #[inline]
    #[must_use]
    pub const fn corners(&self) -> &[u8; 8] {
        &self.corners
    }

    /// Returns the clockwise thirds by which the corner at each position is twisted, 0..3.
    #[inline]
    #[must_use]
    pub const fn twists(&self) -> &[u8; 8] {
        &self.twists
    }

    /// Returns the index of the edge at each position, in the order of [`EDGES`].
    #[inline]
    #[must_use]
    pub const fn edges(&self) -> &[u8; 12] {
        &self.edges
    }

    /// Returns 1 for each position whose edge is flipped, else 0.
    #[inline]
    #[must_use]
    pub const fn flips(&self) -> &[u8; 12] {
        &self.flips
    }

    /// Checks whether a cube with these stickers can exist. Colours are 0..=5 in the order URFDLB,
    /// and each centre must have the colour of its own face.
    #[must_use]
    pub fn is_possible(colours: &[u8; 54]) -> bool {
        Facelets::try_from(*colours).is_ok_and(|facelets| Self::try_from(facelets).is_ok())
    }

    /// Draws a cube uniformly from all 4.3e19 states. Equal seeds give equal cubes.
    ///
    /// ```
    /// use rubik_robot_vocabulary::cube::{Cube, Facelets};
    ///
    /// let cube = Cube::scrambled(2007);
    /// assert_eq!(cube, Cube::scrambled(2007));
    /// assert!(Cube::is_possible(Facelets::from(&cube).colours()));
    /// ```
    #[must_use]
    pub fn scrambled(seed: u64) -> Self {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut cube = Self::SOLVED;
        cube.corners.shuffle(&mut random);
        cube.edges.shuffle(&mut random);
        // Turns change the parities of corners and edges together. The swap pairs each impossible
        // draw with one possible cube, so all states stay equally likely.
        if odd(&cube.corners) != odd(&cube.edges) {
            cube.edges.swap(0, 1);
        }
        for twist in &mut cube.twists[..7] {
            *twist = random.random_range(0..3);
        }
        for flip in &mut cube.flips[..11] {
            *flip = random.random_range(0..2);
        }
        // Turns keep the sum of twists a multiple of 3 and the sum of flips even, so the last twist
        // and the last flip follow from the others.
        cube.twists[7] = (3 - cube.twists.iter().sum::<u8>() % 3) % 3;
        cube.flips[11] = cube.flips.iter().sum::<u8>() % 2;
        cube
    }

    /// Returns the cube after a turn.
    #[must_use]
    pub fn apply(&self, turn: Turn) -> Self {
        let quarter = &QUARTERS[turn.face.index()];
        (0..turn.quarters).fold(*self, |cube, _| cube.then(quarter))
    }

    /// Returns the cube after several turns.
    #[must_use]
    pub fn apply_all(&self, turns: &[Turn]) -> Self {
        turns.iter().fold(*self, |cube, &turn| cube.apply(turn))
    }

    /// Returns the product: the state of this cube after the turns that lead from the solved cube
    /// to `other`.
    ///
    /// ```
    /// use rubik_robot_vocabulary::cube::{Cube, parse_turns};
    ///
    /// let first = Cube::SOLVED.apply_all(&parse_turns("R U2")?);
    /// let second = Cube::SOLVED.apply_all(&parse_turns("F' L")?);
    /// let both = Cube::SOLVED.apply_all(&parse_turns("R U2 F' L")?);
    /// assert_eq!(first.then(&second), both);
    /// # Ok::<(), rubik_robot_vocabulary::cube::ParseTurns>(())
    /// ```
    #[must_use]
    pub fn then(&self, other: &Self) -> Self {
        let mut product = Self::SOLVED;
        for i in 0..8 {
            // `other` moves the corner from position `from` to position i and adds its own twist.
            let from = usize::from(other.corners[i]);
            product.corners[i] = self.corners[from];
            product.twists[i] = (self.twists[from] + other.twists[i]) % 3;
        }
        for i in 0..12 {
            // Flips are added modulo 2.
            let from = usize::from(other.edges[i]);
            product.edges[i] = self.edges[from];
            product.flips[i] = self.flips[from] ^ other.flips[i];
        }
        product
    }

    /// Returns the inverse state: turns that lead from the solved cube to this state, followed by
    /// turns that lead from the solved cube to the inverse, have no effect.
    ///
    /// ```
    /// use rubik_robot_vocabulary::cube::Cube;
    ///
    /// let cube = Cube::scrambled(1);
    /// assert!(cube.then(&cube.inverse()).is_solved());
    /// ```
    #[must_use]
    pub fn inverse(&self) -> Self {
        let mut inverse = Self::SOLVED;
        for i in 0..8 {
            // The inverse takes the corner back to its home and undoes its twist modulo 3.
            let to = usize::from(self.corners[i]);
            inverse.corners[to] = i as u8;
            inverse.twists[to] = (3 - self.twists[i]) % 3;
        }
        for i in 0..12 {
            let to = usize::from(self.edges[i]);
            inverse.edges[to] = i as u8;
            // A flip is its own inverse.
            inverse.flips[to] = self.flips[i];
        }
        inverse
    }

    /// Checks whether the cube is solved.
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

/// Checks whether a permutation, given as the numbers 0..n in their new order, is odd.
pub(super) fn odd(permutation: &[u8]) -> bool {
    let inversions = (0..permutation.len())
        .map(|i| permutation[i + 1..].iter().filter(|&&p| p < permutation[i]).count())
        .sum::<usize>();
    inversions % 2 == 1
}

impl From<&Cube> for Facelets {
    /// Returns the stickers of a cube.
    fn from(cube: &Cube) -> Self {
        // Only the centres keep these colours; the pieces set all others.
        let mut faces: [Face; 54] = std::array::from_fn(|i| Face::ALL[i / 9]);
        for (i, places) in CORNER_FACELETS.iter().enumerate() {
            // Both lists run clockwise, so a twist shifts the colours along the stickers.
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

    /// Returns the cell (components -1, 0, 1 along x, y, z) of the piece on these faces.
    fn cell(faces: &[Face]) -> [i8; 3] {
        let sum: nalgebra::Vector3<f64> = faces.iter().map(|f| f.normal()).sum();
        [sum.x as i8, sum.y as i8, sum.z as i8]
    }

    #[test]
    fn corner_and_edge_tables_match_cube_geometry() {
        for (faces, places) in CORNERS.iter().zip(CORNER_FACELETS) {
            assert_eq!(places, faces.map(|f| facelet_at(cell(faces), f)));
            // The faces are clockwise seen from outside if the triple product of their normals is
            // negative.
            let [a, b, c] = faces.map(Face::normal);
            assert!(a.cross(&b).dot(&c) < 0.0);
        }
        for (faces, places) in EDGES.iter().zip(EDGE_FACELETS) {
            assert_eq!(places, faces.map(|f| facelet_at(cell(faces), f)));
        }
    }

    /// In the superflip every piece is in its place and all twelve edges are flipped.
    #[test]
    fn known_twenty_turns_lead_to_superflip() {
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
        fn piece_turns_agree_with_sticker_turns(
            seed: u64, turns in prop::collection::vec(0..18usize, 0..30)
        ) {
            let start = Cube::scrambled(seed);
            let turns: Vec<Turn> = turns.into_iter().map(Turn::from_index).collect();

            let by_stickers = turns.iter().fold(Facelets::from(&start), |f, &t| f.turned(t));

            prop_assert_eq!(Facelets::from(&start.apply_all(&turns)), by_stickers);
        }

        #[test]
        fn cube_times_its_inverse_is_solved(seed: u64) {
            let cube = Cube::scrambled(seed);

            prop_assert!(cube.then(&cube.inverse()).is_solved());
            prop_assert!(cube.inverse().then(&cube).is_solved());
        }
    }
}
