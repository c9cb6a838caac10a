//! The cube as a puzzle: faces, facelets, turns, legal states.
//!
//! Cube frame: the origin is in the centre; R is +x, B is +y, U is +z (L -x, F -y, D -z). With F
//! towards the viewer, x points right, y away and z up. Facelet strings have 54 letters in the
//! order URFDLB, each face in reading order as in the usual net. A letter names the face whose
//! centre has that colour.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

mod cubies;
mod facelets;
mod legality;
mod listing;
mod moves;
mod repair;
mod rotation;
mod turn;

pub use cubies::{CORNERS, Cube, EDGES};
pub use facelets::{FaceletPlace, Facelets, ParseFacelets, facelet_at, facelet_place};
pub use legality::{ImpossibleCube, Piece};
pub use listing::Listing;
pub use moves::{Layers, Move, MoveFault, ParseMoves, after_moves, parse_moves};
pub use repair::{Repair, StickerChange};
pub use rotation::{Rotation24, rotation_index, rotations};
pub use turn::{ParseTurns, format_turns, parse_turns};

/// Keeper of the cube before the robot takes it and after the robot gives it back.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Keeper {
    /// Hand of a person.
    Person,
    /// Table on which the cube lies.
    Table,
}

/// A face of the cube, named by its position in the cube frame.
///
/// ```
/// use rubik_robot_vocabulary::cube::{Axis, Face};
///
/// assert_eq!(Face::from_letter('F'), Some(Face::F));
/// assert_eq!(Face::F.opposite(), Face::B);
/// // The front looks along -y of the cube frame.
/// assert_eq!((Face::F.axis(), Face::F.normal().y), (Axis::Y, -1.0));
/// let letters: String = Face::ALL.map(Face::letter).iter().collect();
/// assert_eq!(letters, "URFDLB");
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Face {
    /// Up, +z, white.
    U,
    /// Right, +x, red.
    R,
    /// Front, -y, green.
    F,
    /// Down, -z, yellow.
    D,
    /// Left, -x, orange.
    L,
    /// Back, +y, blue.
    B,
}

impl Face {
    /// All faces in the order of facelet strings.
    pub const ALL: [Self; 6] = [Self::U, Self::R, Self::F, Self::D, Self::L, Self::B];

    /// Returns the outward normal in the cube frame.
    #[must_use]
    pub fn normal(self) -> Vector3<f64> {
        match self {
            Self::U => Vector3::z(),
            Self::R => Vector3::x(),
            Self::F => -Vector3::y(),
            Self::D => -Vector3::z(),
            Self::L => -Vector3::x(),
            Self::B => Vector3::y(),
        }
    }

    /// Returns the face on the other side.
    #[must_use]
    pub fn opposite(self) -> Self {
        match self {
            Self::U => Self::D,
            Self::R => Self::L,
            Self::F => Self::B,
            Self::D => Self::U,
            Self::L => Self::R,
            Self::B => Self::F,
        }
    }

    /// Returns the position in [`Face::ALL`].
    #[must_use]
    pub fn index(self) -> usize {
        self as usize
    }

    /// Finds the face with this upper-case letter; `None` for any other character.
    #[must_use]
    pub fn from_letter(letter: char) -> Option<Self> {
        Self::ALL.into_iter().find(|f| f.letter() == letter)
    }

    /// Returns the axis along which the normal points.
    #[must_use]
    pub fn axis(self) -> Axis {
        match self {
            Self::R | Self::L => Axis::X,
            Self::F | Self::B => Axis::Y,
            Self::U | Self::D => Axis::Z,
        }
    }

    /// Returns the directions, in the cube frame, in which the column and the row of a face's
    /// stickers increase in reading order.
    ///
    /// ```
    /// use rubik_robot_vocabulary::cube::Face;
    ///
    /// // Columns of the front increase to the right (+x), rows downwards (-z).
    /// let (columns, rows) = Face::F.reading_axes();
    /// assert_eq!((columns.x, rows.z), (1.0, -1.0));
    /// // On each face the third axis of a right-handed frame points into the cube.
    /// assert!(Face::ALL.iter().all(|face| {
    ///     let (columns, rows) = face.reading_axes();
    ///     columns.cross(&rows) == -face.normal()
    /// }));
    /// ```
    #[must_use]
    pub fn reading_axes(self) -> (Vector3<f64>, Vector3<f64>) {
        // In the net the faces L, F, R, B lie in a row with U above F and D below it, so every side
        // face has its top row at U, and the top row of U meets B, that of D meets F.
        let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
        match self {
            Self::U => (x, -y),
            Self::R => (y, -z),
            Self::F => (x, -z),
            Self::D => (x, y),
            Self::L => (-y, -z),
            Self::B => (-x, -z),
        }
    }

    /// Returns the letter of the face.
    #[must_use]
    pub fn letter(self) -> char {
        match self {
            Self::U => 'U',
            Self::R => 'R',
            Self::F => 'F',
            Self::D => 'D',
            Self::L => 'L',
            Self::B => 'B',
        }
    }
}

/// An axis of the cube frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Axis {
    /// From L to R.
    X,
    /// From F to B.
    Y,
    /// From D to U.
    Z,
}

impl Axis {
    /// All three axes.
    pub const ALL: [Self; 3] = [Self::X, Self::Y, Self::Z];

    /// Returns the face at the positive end of the axis.
    #[must_use]
    pub fn positive_face(self) -> Face {
        match self {
            Self::X => Face::R,
            Self::Y => Face::B,
            Self::Z => Face::U,
        }
    }

    /// Returns the unit vector along the axis, in the cube frame.
    #[must_use]
    pub fn unit(self) -> Vector3<f64> {
        match self {
            Self::X => Vector3::x(),
            Self::Y => Vector3::y(),
            Self::Z => Vector3::z(),
        }
    }
}

/// Turn of one face.
///
/// ```
/// use rubik_robot_vocabulary::cube::{Face, Turn};
///
/// let turn: Turn = "R'".parse()?;
/// assert_eq!((turn.face, turn.quarters), (Face::R, 3));
/// assert_eq!(turn.inverse().to_string(), "R");
/// // There are three turns of each face; four quarters are no turn.
/// assert_eq!(Turn::all().count(), 18);
/// assert_eq!(Turn::new(Face::R, 4), None);
/// # Ok::<(), rubik_robot_vocabulary::cube::ParseTurns>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Turn {
    /// Face that turns.
    pub face: Face,
    /// Clockwise quarter turns seen from outside: 1, 2 or 3 (= -1).
    pub quarters: u8,
}
