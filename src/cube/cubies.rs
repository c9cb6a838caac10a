//! The cube as pieces: eight corners and twelve edges, each somewhere and somehow turned.
//!
//! - in: facelets, turns, a seed
//! - out: a [`Cube`], which is always one that can be solved; or the reason why stickers are no such cube
//! - source: Kociemba's cubie level; a state is written as a product, position by position

use super::{Face, Facelets, Turn};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use std::fmt;
use std::sync::LazyLock;

/// A cube that can be reached from the solved one by face turns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Cube {
    /// Which corner is at each position, in the order of [`CORNERS`].
    pub(crate) corners: [u8; 8],
    /// How often the corner there is turned clockwise, 0..3.
    pub(crate) twists: [u8; 8],
    /// Which edge is at each position, in the order of [`EDGES`].
    pub(crate) edges: [u8; 12],
    /// Whether the edge there is turned over.
    pub(crate) flips: [u8; 12],
}

/// The three faces of each corner clockwise, up or down first.
pub(crate) const CORNERS: [[Face; 3]; 8] = {
    use Face::{B, D, F, L, R, U};
    [[U, R, F], [U, F, L], [U, L, B], [U, B, R], [D, F, R], [D, L, F], [D, B, L], [D, R, B]]
};

/// The two faces of each edge: up or down first, in the middle layer front or back first.
pub(crate) const EDGES: [[Face; 2]; 12] = {
    use Face::{B, D, F, L, R, U};
    [[U, R], [U, F], [U, L], [U, B], [D, R], [D, F], [D, L], [D, B], [F, R], [F, L], [B, L], [B, R]]
};

/// Numbers of the stickers of each corner, in the order of [`CORNERS`].
const CORNER_FACELETS: [[usize; 3]; 8] = [
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
const EDGE_FACELETS: [[usize; 2]; 12] = [
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

/// Some stickers, named by their faces' letters: a position or a piece.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Piece {
    faces: [Option<Face>; 3],
}

impl Piece {
    fn of(faces: &[Face]) -> Self {
        Self { faces: std::array::from_fn(|i| faces.get(i).copied()) }
    }
}

impl fmt::Display for Piece {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.faces.iter().flatten().try_for_each(|face| write!(f, "{}", face.letter()))
    }
}

impl fmt::Debug for Piece {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self}")
    }
}

/// Why stickers are no cube that can be solved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ImpossibleCube {
    /// A colour is there more or less than nine times.
    #[error("{count} stickers of colour {} instead of 9", colour.letter())]
    ColourCount {
        /// The face whose centre has this colour on a solved cube.
        colour: Face,
        /// How many there are.
        count: usize,
    },
    /// Two centres have one colour.
    #[error("the centres of {} and {} both have colour {}", first.letter(), second.letter(), colour.letter())]
    CentreTwice {
        /// That colour.
        colour: Face,
        /// On this face
        first: Face,
        /// and on this.
        second: Face,
    },
    /// Six centres, but not as on any cube, however it is turned: opposite colours stand side by side, or mirrored.
    #[error("the centres stand to each other as on no cube")]
    CentresMisplaced,
    /// The centres are those of a cube that lies in another orientation: see [`Facelets::normalised`].
    #[error("the centre of {} has colour {}: the cube is named in another orientation", face.letter(), colour.letter())]
    CentreElsewhere {
        /// On this face
        face: Face,
        /// there is this colour.
        colour: Face,
    },
    /// Colours side by side that no piece has.
    #[error("position {position} has colours {colours}: no piece has these, in this order")]
    NoSuchPiece {
        /// Where.
        position: Piece,
        /// What was found there, in the order of the position's letters.
        colours: Piece,
    },
    /// One piece in two places.
    #[error("piece {piece} is in two places: {first} and {second}")]
    PieceTwice {
        /// Which.
        piece: Piece,
        /// Here
        first: Piece,
        /// and here.
        second: Piece,
    },
    /// An odd number of edges is turned over.
    #[error("one edge is flipped in its place")]
    EdgeFlipped,
    /// The corners' twists do not cancel.
    #[error("one corner is twisted {} in its place", if *clockwise { "clockwise" } else { "anticlockwise" })]
    CornerTwisted {
        /// Seen from outside.
        clockwise: bool,
    },
    /// An odd permutation of the pieces.
    #[error("two pieces are swapped")]
    Swapped,
}

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

impl TryFrom<Facelets> for Cube {
    type Error = ImpossibleCube;

    fn try_from(facelets: Facelets) -> Result<Self, ImpossibleCube> {
        check_colours(&facelets)?;
        let mut cube = Self::SOLVED;
        let mut corner_at = [None; 8];
        for (i, places) in CORNER_FACELETS.iter().enumerate() {
            let position = Piece::of(&CORNERS[i]);
            let colours = places.map(|p| facelets.colour(p));
            let (piece, twist) = find(&CORNERS, colours)
                .ok_or(ImpossibleCube::NoSuchPiece { position, colours: Piece::of(&colours) })?;
            if let Some(first) = corner_at[piece].replace(position) {
                let piece = Piece::of(&CORNERS[piece]);
                return Err(ImpossibleCube::PieceTwice { piece, first, second: position });
            }
            (cube.corners[i], cube.twists[i]) = (piece as u8, twist as u8);
        }
        let mut edge_at = [None; 12];
        for (i, places) in EDGE_FACELETS.iter().enumerate() {
            let position = Piece::of(&EDGES[i]);
            let colours = places.map(|p| facelets.colour(p));
            let (piece, flip) = find(&EDGES, colours)
                .ok_or(ImpossibleCube::NoSuchPiece { position, colours: Piece::of(&colours) })?;
            if let Some(first) = edge_at[piece].replace(position) {
                let piece = Piece::of(&EDGES[piece]);
                return Err(ImpossibleCube::PieceTwice { piece, first, second: position });
            }
            (cube.edges[i], cube.flips[i]) = (piece as u8, flip as u8);
        }
        check_sums(&cube)?;
        Ok(cube)
    }
}

fn check_colours(facelets: &Facelets) -> Result<(), ImpossibleCube> {
    facelets.normalised()?;
    for face in Face::ALL {
        let colour = facelets.colour(face.index() * 9 + 4);
        if colour != face {
            return Err(ImpossibleCube::CentreElsewhere { face, colour });
        }
        let count = (0..54).filter(|&i| facelets.colour(i) == face).count();
        if count != 9 {
            return Err(ImpossibleCube::ColourCount { colour: face, count });
        }
    }
    Ok(())
}

fn check_sums(cube: &Cube) -> Result<(), ImpossibleCube> {
    if cube.flips.iter().sum::<u8>() % 2 == 1 {
        return Err(ImpossibleCube::EdgeFlipped);
    }
    match cube.twists.iter().sum::<u8>() % 3 {
        0 => {}
        excess => return Err(ImpossibleCube::CornerTwisted { clockwise: excess == 1 }),
    }
    if odd(&cube.corners) != odd(&cube.edges) {
        return Err(ImpossibleCube::Swapped);
    }
    Ok(())
}

/// The piece with these colours in this cyclic order, and by how many places it is turned.
fn find<const N: usize>(pieces: &[[Face; N]], colours: [Face; N]) -> Option<(usize, usize)> {
    (0..N).find_map(|turn| {
        let mut straight = colours;
        straight.rotate_left(turn);
        pieces.iter().position(|p| *p == straight).map(|piece| (piece, turn))
    })
}

/// Whether a permutation is odd.
fn odd(permutation: &[u8]) -> bool {
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

    fn swapped(pairs: &[(usize, usize)]) -> Facelets {
        let mut colours = *Facelets::solved().colours();
        for &(a, b) in pairs {
            colours.swap(a, b);
        }
        Facelets::try_from(colours).unwrap()
    }

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
    fn each_impossible_cube_is_told_its_own_reason() {
        let reason = |facelets: Facelets| Cube::try_from(facelets).unwrap_err().to_string();

        let mut nine = *Facelets::solved().colours();
        nine[0] = 1;
        assert_eq!(
            reason(Facelets::try_from(nine).unwrap()),
            "8 stickers of colour U instead of 9"
        );
        nine[4] = 1;
        assert_eq!(
            reason(Facelets::try_from(nine).unwrap()),
            "the centres of U and R both have colour R"
        );
        assert_eq!(
            reason(swapped(&[(8, 20)])),
            "position URF has colours FRU: no piece has these, in this order"
        );
        // The front sticker of UF and the right one of UR exchanged with their upper ones' help: UF twice.
        assert_eq!(reason(swapped(&[(10, 19), (10, 12)])).split(' ').next(), Some("piece"));
        assert_eq!(reason(swapped(&[(7, 19)])), "one edge is flipped in its place");
        assert_eq!(
            reason(swapped(&[(8, 9), (9, 20)])),
            "one corner is twisted anticlockwise in its place"
        );
        assert_eq!(
            reason(swapped(&[(8, 20), (9, 20)])),
            "one corner is twisted clockwise in its place"
        );
        assert_eq!(reason(swapped(&[(10, 19)])), "two pieces are swapped");
    }

    #[test]
    fn a_cube_named_in_another_orientation_is_refused_with_its_centre() {
        let turned = Facelets::solved().rotated(crate::cube::Rotation24::quarter(Face::U));

        assert_eq!(
            Cube::try_from(turned),
            Err(ImpossibleCube::CentreElsewhere { face: Face::R, colour: Face::B })
        );
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
