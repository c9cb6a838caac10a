//! Moves in the usual notation of scrambles: face turns, slices (M E S), wide turns (`Rw`, `r`) and
//! rotations of the whole cube (x y z), each followed by nothing, `2` or `'`.
//!
//! - in: text
//! - out: [`Move`]s and the stickers after them, or the word that is not a move, with its position
//! - source: World Cube Association, Regulations, article 12; M follows L, E follows D, S follows F

use super::{Axis, Face, Facelets, Rotation24, Turn};
use std::fmt;

/// Layers that a move turns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layers {
    /// The outer layer of a face.
    Face(Face),
    /// The outer layer of a face and the middle layer beside it.
    Wide(Face),
    /// The middle layer alone, in the sense of this face.
    Slice(Face),
    /// All three layers, in the sense of this face.
    All(Face),
}

/// Turn of one or more layers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Move {
    /// Layers that turn.
    pub layers: Layers,
    /// Clockwise quarters, seen from outside of the face that gives the sense: 1, 2 or 3 (= -1).
    pub quarters: u8,
}

/// Reason why a text cannot be read as moves.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{token}` at position {position} is not a move: \
     expected U, R, F, D, L or B, a wide turn as Rw or r, a slice M, E or S, \
     or a rotation x, y or z, then nothing, 2 or '"
)]
pub struct ParseMoves {
    /// Position of the word in the text, in characters from 1.
    pub position: usize,
    /// Word that is not a move.
    pub token: String,
}

impl Move {
    /// Returns the stickers after the move, in a frame that is fixed in space: slices and rotations
    /// move the centres.
    #[must_use]
    pub fn of(self, facelets: &Facelets) -> Facelets {
        let turned = |f: Facelets, face, quarters| match Turn::new(face, quarters) {
            Some(turn) => f.turned(turn),
            None => f,
        };
        let rotated = |f: Facelets, face: Face, quarters: u8| {
            (0..quarters).fold(f, |f, _| f.rotated(Rotation24::quarter(face)))
        };
        let (forth, back) = (self.quarters, 4 - self.quarters);
        match self.layers {
            Layers::Face(face) => turned(*facelets, face, forth),
            // A wide turn is a rotation of all three layers in which the third one stays in place.
            // It is turned back first, and back is clockwise as seen from its own side.
            Layers::Wide(face) => rotated(turned(*facelets, face.opposite(), forth), face, forth),
            Layers::Slice(face) => {
                // A slice is a rotation of all three layers in which both outer ones stay in place.
                let outer = turned(turned(*facelets, face, back), face.opposite(), forth);
                rotated(outer, face, forth)
            }
            Layers::All(face) => rotated(*facelets, face, forth),
        }
    }
}

impl fmt::Display for Move {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let suffix = ["", "2", "'"][usize::from(self.quarters) - 1];
        match self.layers {
            Layers::Face(face) => write!(f, "{}{suffix}", face.letter()),
            Layers::Wide(face) => write!(f, "{}w{suffix}", face.letter()),
            Layers::Slice(face) => {
                // The letter follows from the axis: a parsed slice always has the sense of L, F or
                // D.
                // A parsed rotation always has the sense of R, F or U.
                let letter = match face.axis() {
                    Axis::X => 'M',
                    Axis::Y => 'S',
                    Axis::Z => 'E',
                };
                write!(f, "{letter}{suffix}")
            }
            Layers::All(face) => {
                let letter = match face.axis() {
                    Axis::X => 'x',
                    Axis::Y => 'z',
                    Axis::Z => 'y',
                };
                write!(f, "{letter}{suffix}")
            }
        }
    }
}

/// Returns the stickers after all moves.
#[must_use]
pub fn after_moves(facelets: &Facelets, moves: &[Move]) -> Facelets {
    moves.iter().fold(*facelets, |f, m| m.of(&f))
}

/// Reads moves, with or without spaces between them: `R U2 F'`, `Rw M' x2`, `RU2F'`.
///
/// # Errors
/// The first word that is not a move, and its position.
pub fn parse_moves(text: &str) -> Result<Vec<Move>, ParseMoves> {
    let letters: Vec<char> = text.chars().collect();
    let mut moves = Vec::new();
    let mut at = 0;
    while at < letters.len() {
        if letters[at].is_whitespace() {
            at += 1;
            continue;
        }
        let start = at;
        let Some(mut layers) = layers(letters[at]) else {
            return Err(unreadable(&letters, start));
        };
        at += 1;
        // Only an outer layer can become wide: `rw` and `Mw` are refused below.
        if let (Some('w'), Layers::Face(face)) = (letters.get(at), layers) {
            layers = Layers::Wide(face);
            at += 1;
        }
        let quarters = match letters.get(at) {
            Some('2') => 2,
            Some('3') => 3,
            Some(c) if is_prime(*c) => 3,
            _ => 1,
        };
        at += usize::from(quarters != 1);
        // A half turn anticlockwise is sometimes written as 2'.
        at += usize::from(quarters == 2 && letters.get(at).is_some_and(|c| is_prime(*c)));
        // A second suffix is a mistake and not a move of its own: `R22`, `Mw`.
        let doubled = |c: &char| matches!(c, 'w' | '0'..='9') || is_prime(*c);
        if letters.get(at).is_some_and(doubled) {
            return Err(unreadable(&letters, start));
        }
        moves.push(Move { layers, quarters });
    }
    Ok(moves)
}

/// Returns the layers that the letter of a move turns; `None` for any other character.
fn layers(letter: char) -> Option<Layers> {
    Some(match letter {
        'M' => Layers::Slice(Face::L),
        'E' => Layers::Slice(Face::D),
        'S' => Layers::Slice(Face::F),
        'x' => Layers::All(Face::R),
        'y' => Layers::All(Face::U),
        'z' => Layers::All(Face::F),
        _ => match Face::from_letter(letter) {
            // A lower-case face letter is the short form of a wide turn: `r` is `Rw`.
            Some(face) => Layers::Face(face),
            None => Layers::Wide(Face::from_letter(letter.to_ascii_uppercase())?),
        },
    })
}

/// Checks for an apostrophe, or one of the characters that keyboards and typesetting make of it.
fn is_prime(letter: char) -> bool {
    matches!(letter, '\'' | '’' | '‘' | '′' | '`' | '´')
}

/// Returns the error for the word at `start`, which ends at the next blank and is cut after 12
/// letters.
fn unreadable(letters: &[char], start: usize) -> ParseMoves {
    let token = letters[start..].iter().take_while(|c| !c.is_whitespace()).take(12).collect();
    ParseMoves { position: start + 1, token }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::parse_turns;
    use proptest::prelude::*;

    fn after(text: &str) -> Facelets {
        after_moves(&Facelets::solved(), &parse_moves(text).unwrap())
    }

    #[test]
    fn face_turns_match_turns_of_facelets() {
        let text = "R U2 F' D L2 B'";
        let turned =
            parse_turns(text).unwrap().iter().fold(Facelets::solved(), |f, &t| f.turned(t));

        assert_eq!(after(text), turned);
        assert_eq!(after("RU2F'DL2B’"), turned);
    }

    #[test]
    fn slice_moves_turn_like_their_reference_faces() {
        // M moves the middle of the front down, as L does with its own column.
        assert_eq!(after("M").colours()[28], Face::F.index() as u8);
        assert_eq!(after("L").colours()[27], Face::F.index() as u8);
        // E moves the middle row of the front to the right, as D does with its own row. S moves the
        // middle row of the top to the right, as F does with its own row.
        assert_eq!(after("E").colours()[12], Face::F.index() as u8);
        assert_eq!(after("D").colours()[15], Face::F.index() as u8);
        assert_eq!(after("S").colours()[10], Face::U.index() as u8);
        assert_eq!(after("F").colours()[9], Face::U.index() as u8);
    }

    #[test]
    fn layers_add_up_to_rotations_and_wide_turns() {
        for (whole, layers) in [("x", "R M' L'"), ("y", "U E' D'"), ("z", "F S B'")] {
            assert_eq!(after(whole), after(layers));
        }
        for (wide, layers) in [
            ("Rw", "R M'"),
            ("l2", "L2 M2"),
            ("Uw'", "U' E"),
            ("d", "D E"),
            ("f", "F S"),
            ("Bw", "B S'"),
        ] {
            assert_eq!(after(wide), after(layers), "{wide}");
        }
    }

    #[test]
    fn wrong_move_is_reported_with_its_position() {
        for (text, position, token) in [
            ("R U Q2 F", 5, "Q2"),
            ("R22", 1, "R22"),
            ("Mw", 1, "Mw"),
            ("2R", 1, "2R"),
            ("R (U)", 3, "(U)"),
            ("No solution", 1, "No"),
            ("RUFQ2", 4, "Q2"),
        ] {
            assert_eq!(parse_moves(text), Err(ParseMoves { position, token: token.to_owned() }));
        }
    }

    proptest! {
        #[test]
        fn parsed_moves_survive_text_round_trip(text in "[URFDLBurfdlbMESxyzw23' ’Q]{0,20}") {
            if let Ok(moves) = parse_moves(&text) {
                let written: Vec<String> = moves.iter().map(Move::to_string).collect();
                prop_assert_eq!(parse_moves(&written.join(" ")).unwrap(), moves);
            }
        }
    }
}
