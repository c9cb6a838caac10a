//! The 54 stickers of a cube and their places.
//!
//! - in: text (see [`super::listing`]), or colours that were read face by face
//! - out: [`Facelets`], which can be turned but need not form a possible cube; [`super::Cube`]
//!   checks that

use super::{Face, Rotation24, Turn};
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::LazyLock;

/// Colours of the 54 stickers in the order URFDLB, each face in reading order.
///
/// A colour is the number (0..=5 in [`Face::ALL`]) of the face whose centre has it on a solved
/// cube: 0 white, 1 red, 2 green, 3 yellow, 4 orange, 5 blue.
///
/// ```
/// use rubik_robot_vocabulary::cube::{Face, Facelets, Turn};
///
/// let turn: Turn = "F".parse()?;
/// let facelets = Facelets::solved().turned(turn);
/// // The lower row of U now has the colour of L.
/// assert_eq!([6, 7, 8].map(|index| facelets.colour(index)), [Face::L; 3]);
/// assert!(!facelets.is_solved());
/// assert!(facelets.turned(turn.inverse()).is_solved());
/// # Ok::<(), rubik_robot_vocabulary::cube::ParseTurns>(())
/// ```
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Facelets([u8; 54]);

/// Reason why a text does not describe a cube.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ParseFacelets {
    /// The text does not have 54 letters.
    #[error("{0} letters instead of 54, one for each sticker")]
    Length(usize),
    /// A letter is none of URFDLB.
    #[error("letter {letter:?} at position {position} ({place}) is not one of U, R, F, D, L, B")]
    Letter {
        /// Position in the text, counted from 1.
        position: usize,
        /// Place of the sticker that the letter describes.
        place: FaceletPlace,
        /// Letter at that position.
        letter: char,
    },
    /// The text has 54 letters, but its lines form no known layout. The value is the number of
    /// lines.
    #[error(
        "54 letters in {0} lines: expected one line, six lines of 9 or 18 of 3 (the sides in \
         the order URFDLB), or a net (three lines of 3, three of 12 with L F R B, three of 3)"
    )]
    Layout(usize),
    /// The letters are colours, and those of the centres are not arranged as on a usual cube.
    #[error(
        "the letters are colours (w r o y g b), and in the orders URFDLB and ULFRBD their six \
         centres are not those of a cube with white opposite yellow, red opposite orange and green \
         opposite blue: write U, R, F, D, L or B for the side whose centre has the colour"
    )]
    Colours,
}

/// Place of a sticker on the cube.
///
/// ```
/// use rubik_robot_vocabulary::cube::{Face, FaceletPlace};
///
/// let centre = FaceletPlace { face: Face::U, row: 1, col: 1 };
/// assert_eq!((centre.index(), centre.to_string().as_str()), (4, "U5"));
/// // On a cube of 57 mm the sticker lies 28.5 mm above the centre of the cube.
/// assert!((centre.centre(0.057).z - 0.0285).abs() < 1e-12);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FaceletPlace {
    /// Face on which the sticker lies.
    pub face: Face,
    /// Row in reading order, from the top, 0..3.
    pub row: u8,
    /// Column in reading order, from the left, 0..3.
    pub col: u8,
}

/// Returns row, column and face of the facelet with this index, 0..54.
///
/// ```
/// use rubik_robot_vocabulary::cube::facelet_place;
///
/// // The stickers 8, 9 and 20 are on one corner: right, front, up.
/// let places = [8, 9, 20].map(facelet_place);
/// assert_eq!(places.map(|place| place.to_string()), ["U9", "R1", "F3"]);
/// assert!(places.iter().all(|place| place.cell() == [1, -1, 1]));
/// ```
#[must_use]
pub fn facelet_place(index: usize) -> FaceletPlace {
    let within = (index % 9) as u8;
    FaceletPlace { face: Face::ALL[index / 9], row: within / 3, col: within % 3 }
}

/// Returns the index of the facelet on `face` of the cubie at `cell` (components -1, 0, 1 along x,
/// y, z).
#[must_use]
pub fn facelet_at(cell: [i8; 3], face: Face) -> usize {
    let (col_axis, row_axis) = face.reading_axes();
    // Rows and columns count from 0, the components of a cell from -1.
    let along = |axis: Vector3<f64>| {
        let sum: f64 = (0..3).map(|k| axis[k] * f64::from(cell[k])).sum();
        (sum + 1.0) as usize
    };
    face.index() * 9 + along(row_axis) * 3 + along(col_axis)
}

impl FaceletPlace {
    /// Returns the cell of the cubie that carries the sticker: -1, 0 or 1 along x, y, z.
    #[must_use]
    pub fn cell(self) -> [i8; 3] {
        // With an edge of 3 cubies, the sticker lies half a cubie outside the centre of its cubie.
        let cubie = self.centre(3.0).coords - self.face.normal() * 0.5;
        [0, 1, 2].map(|k| cubie[k].round() as i8)
    }

    /// Returns the centre of the sticker in the cube frame (m), for a cube with this edge (m).
    #[must_use]
    pub fn centre(self, edge: f64) -> Point3<f64> {
        let (col_axis, row_axis) = self.face.reading_axes();
        let across =
            col_axis * (f64::from(self.col) - 1.0) + row_axis * (f64::from(self.row) - 1.0);
        Point3::from(self.face.normal() * (edge / 2.0) + across * (edge / 3.0))
    }

    /// Returns the outward normal in the cube frame.
    #[must_use]
    pub fn normal(self) -> Vector3<f64> {
        self.face.normal()
    }

    /// Returns the index of the sticker, 0..54.
    #[must_use]
    pub fn index(self) -> usize {
        self.face.index() * 9 + usize::from(self.row) * 3 + usize::from(self.col)
    }
}

impl fmt::Display for FaceletPlace {
    /// Writes the letter of the face and the number of the sticker on it in reading order, 1..=9.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.face.letter(), self.row * 3 + self.col + 1)
    }
}

/// Index of the place from which the sticker comes, for each turn ([`Turn::index`]) and each
/// place.
static TURNED_FROM: LazyLock<[[u8; 54]; 18]> = LazyLock::new(|| {
    std::array::from_fn(|turn| {
        let (face, quarters) = (Face::ALL[turn / 3], turn % 3 + 1);
        let clockwise = Rotation24::quarter(face);
        let mut from: [u8; 54] = std::array::from_fn(|i| i as u8);
        for (index, source) in from.iter_mut().enumerate() {
            let place = facelet_place(index);
            // A turn moves only the outer layer on its face.
            if (Vector3::from(place.cell().map(f64::from))).dot(&face.normal()) < 0.5 {
                continue;
            }
            // The sticker comes from where the inverse turn leads, and 4 - `quarters` clockwise
            // quarters are the inverse.
            let (mut cell, mut side) = (place.cell(), place.face);
            for _ in 0..(4 - quarters) {
                (cell, side) = (clockwise.cell(cell), clockwise.face(side));
            }
            *source = facelet_at(cell, side) as u8;
        }
        from
    })
});

impl Facelets {
    /// Returns the solved cube: each face in its own colour.
    #[must_use]
    pub fn solved() -> Self {
        Self(std::array::from_fn(|i| (i / 9) as u8))
    }

    /// Makes facelets from the colours, face by face in the order URFDLB.
    #[must_use]
    pub fn from_faces(colours: [Face; 54]) -> Self {
        Self(colours.map(|c| c.index() as u8))
    }

    /// Returns the colour of the facelet with this index, 0..54, named by the face whose centre has
    /// it on a solved cube.
    #[must_use]
    pub fn colour(&self, index: usize) -> Face {
        Face::ALL[usize::from(self.0[index])]
    }

    /// Returns the colours of all facelets as numbers 0..=5 (see [`Facelets`]).
    #[must_use]
    pub fn colours(&self) -> &[u8; 54] {
        &self.0
    }

    /// Returns the stickers after a turn of one face.
    #[must_use]
    pub fn turned(&self, turn: Turn) -> Self {
        let from = &TURNED_FROM[turn.index()];
        Self(std::array::from_fn(|i| self.0[usize::from(from[i])]))
    }

    /// Returns the stickers after a rotation of the whole cube: the colours move, the frame stays.
    #[must_use]
    pub fn rotated(&self, rotation: Rotation24) -> Self {
        let mut moved = [0; 54];
        for (index, colour) in self.0.iter().enumerate() {
            let place = facelet_place(index);
            moved[facelet_at(rotation.cell(place.cell()), rotation.face(place.face))] = *colour;
        }
        Self(moved)
    }

    /// Checks whether each face shows a single colour. The cube may be in any orientation.
    #[must_use]
    pub fn is_solved(&self) -> bool {
        self.0.chunks(9).all(|face| face.iter().all(|c| *c == face[4]))
    }
}

impl TryFrom<[u8; 54]> for Facelets {
    type Error = ParseFacelets;

    /// Takes colours as numbers 0..=5.
    ///
    /// # Errors
    /// [`ParseFacelets::Letter`] for the first number above 5.
    fn try_from(colours: [u8; 54]) -> Result<Self, ParseFacelets> {
        match colours.iter().position(|&c| c > 5) {
            None => Ok(Self(colours)),
            Some(at) => Err(ParseFacelets::Letter {
                position: at + 1,
                place: facelet_place(at),
                // The error shows one character: a digit, or for numbers from 10 a letter.
                letter: char::from_digit(u32::from(colours[at]), 36).unwrap_or('?'),
            }),
        }
    }
}

impl TryFrom<String> for Facelets {
    type Error = ParseFacelets;

    fn try_from(text: String) -> Result<Self, ParseFacelets> {
        text.parse()
    }
}

impl From<Facelets> for String {
    fn from(facelets: Facelets) -> Self {
        facelets.to_string()
    }
}

impl fmt::Display for Facelets {
    /// Writes the 54 letters in the order URFDLB.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|&c| write!(f, "{}", Face::ALL[usize::from(c)].letter()))
    }
}

impl fmt::Debug for Facelets {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Facelets({self})")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::parse_turns;

    #[test]
    fn sticker_places_and_indices_convert_both_ways() {
        for index in 0..54 {
            let place = facelet_place(index);

            assert_eq!(place.index(), index);
            assert_eq!(facelet_at(place.cell(), place.face), index);
            // Half of the edge from the centre of the cube.
            assert!((place.centre(0.057).coords.dot(&place.normal()) - 0.0285).abs() < 1e-15);
        }
        // The top left sticker of the front is on the corner at left, front, up.
        assert_eq!(facelet_place(18).cell(), [-1, -1, 1]);
        assert!((facelet_place(18).centre(0.06) - Point3::new(-0.02, -0.03, 0.02)).norm() < 1e-15);
    }

    #[test]
    fn right_turn_carries_front_stickers_up() {
        let turned = parse_turns("R").unwrap().iter().fold(Facelets::solved(), |f, &t| f.turned(t));

        assert_eq!(turned.to_string(), "UUFUUFUUFRRRRRRRRRFFDFFDFFDDDBDDBDDBLLLLLLLLLUBBUBBUBB");
    }
}
