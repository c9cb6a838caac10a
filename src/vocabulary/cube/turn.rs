//! Face turns in the usual notation: a letter, then nothing, `1`, `2`, `3` or `'`.

use super::moves::{is_prime, quarters};
use super::{Face, Turn};
use std::fmt;
use std::str::FromStr;

/// Reason why a text cannot be read as face turns.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{found:?} at position {position} is not a face turn: \
     expected U, R, F, D, L or B, then nothing, 1, 2, 3 or '"
)]
pub struct ParseTurns {
    /// Position of the character in the text, counted from 1.
    pub position: usize,
    /// Character at that position.
    pub found: char,
}

impl Turn {
    /// Returns all 18 turns, three of each face.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..18).map(Self::from_index)
    }

    /// Makes a turn of a face by `quarters` clockwise quarters, counted modulo 4; `None` if the
    /// face does not move.
    #[must_use]
    pub fn new(face: Face, quarters: u8) -> Option<Self> {
        (!quarters.is_multiple_of(4)).then_some(Self { face, quarters: quarters % 4 })
    }

    /// Returns the index of the turn, 0..18: three times the index of the face + quarters - 1.
    #[must_use]
    pub fn index(self) -> usize {
        self.face.index() * 3 + usize::from(self.quarters) - 1
    }

    /// Returns the turn with this index, 0..18.
    #[must_use]
    pub fn from_index(index: usize) -> Self {
        Self { face: Face::ALL[index / 3], quarters: (index % 3) as u8 + 1 }
    }

    /// Returns the turn that undoes this one.
    #[must_use]
    pub fn inverse(self) -> Self {
        Self { face: self.face, quarters: 4 - self.quarters }
    }
}

impl fmt::Display for Turn {
    /// Writes the turn in the notation that [`parse_turns`] reads.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let suffix = ["", "2", "'"][usize::from(self.quarters) - 1];
        write!(f, "{}{suffix}", self.face.letter())
    }
}

impl FromStr for Turn {
    type Err = ParseTurns;

    /// Reads exactly one face turn.
    ///
    /// # Errors
    /// The first character that is not part of a face turn; position 1 if the text has no turn or
    /// several.
    fn from_str(text: &str) -> Result<Self, ParseTurns> {
        match parse_turns(text)?.as_slice() {
            [turn] => Ok(*turn),
            _ => Err(ParseTurns { position: 1, found: text.chars().next().unwrap_or(' ') }),
        }
    }
}

/// Reads face turns, with or without spaces between them: `R U2 F'`, `RU2F'`.
///
/// ```
/// use rubik_robot_vocabulary::cube::{format_turns, parse_turns};
///
/// assert_eq!(format_turns(&parse_turns("RU2F'")?), "R U2 F'");
/// let wrong = parse_turns("R U X").unwrap_err();
/// assert_eq!((wrong.position, wrong.found), (5, 'X'));
/// # Ok::<(), rubik_robot_vocabulary::cube::ParseTurns>(())
/// ```
///
/// # Errors
/// The position of the first character that is not part of a face turn.
pub fn parse_turns(text: &str) -> Result<Vec<Turn>, ParseTurns> {
    let mut turns = Vec::new();
    let mut letters = text.chars().enumerate().peekable();
    while let Some((at, letter)) = letters.next() {
        if letter.is_whitespace() {
            continue;
        }
        let face =
            Face::from_letter(letter).ok_or(ParseTurns { position: at + 1, found: letter })?;
        let suffix = letters.peek().and_then(|(_, c)| quarters(*c));
        let quarters = suffix.unwrap_or(1);
        if suffix.is_some() {
            letters.next();
        }
        // A half turn anticlockwise is sometimes written as 2'.
        if quarters == 2 && letters.peek().is_some_and(|(_, c)| is_prime(*c)) {
            letters.next();
        }
        turns.push(Turn { face, quarters });
    }
    Ok(turns)
}

/// Formats turns with spaces between them.
#[must_use]
pub fn format_turns(turns: &[Turn]) -> String {
    turns.iter().map(Turn::to_string).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formatted_turns_are_parsed_back() {
        let turns: Vec<Turn> = Turn::all().collect();

        assert_eq!(parse_turns(&format_turns(&turns)).unwrap(), turns);
        assert_eq!(parse_turns("RU2F'").unwrap(), parse_turns(" R1  U2 F3").unwrap());
        assert!(parse_turns("").unwrap().is_empty());
    }

    #[test]
    fn wrong_turn_is_reported_with_its_position() {
        assert_eq!(parse_turns("R x"), Err(ParseTurns { position: 3, found: 'x' }));
        assert_eq!(parse_turns("2R"), Err(ParseTurns { position: 1, found: '2' }));
    }

    #[test]
    fn quarters_of_turn_and_inverse_sum_to_four() {
        for turn in Turn::all() {
            assert_eq!(turn.inverse().inverse(), turn);
            assert_eq!(turn.quarters + turn.inverse().quarters, 4);
            assert_eq!(Turn::from_index(turn.index()), turn);
        }
    }
}
