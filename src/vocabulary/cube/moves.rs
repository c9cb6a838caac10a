//! Moves in the usual notation of scrambles: face turns, slices (M E S), wide turns (`Rw`, `r`) and
//! rotations of the whole cube (x y z), each followed by nothing, `1`, `2`, `3` or `'`; moves in
//! parentheses may be repeated: `(R U)2`.
//!
//! - in: text
//! - out: [`Move`]s and the stickers after them, or the word that is not a move, with its position
//! - source: World Cube Association, Regulations, article 12; M follows L, E follows D, S follows
//!   F; the numbers of quarters are those of Kociemba's solvers (`R1 U3`)
//!
//! | text | rule | reason |
//! |---|---|---|
//! | `y3Rw`, `R2u` | refused, a blank is asked for | a large cube's `3Rw` turns three layers |
//! | `R5`, `Mw`, `2R` | refused | this cube has no such move |
//! | `(R U)3` | at most [`REPEATED`] times | more is a mistake |
//! | `(R U)'`, `(R U)x2` | refused | `'` has two meanings, `x2` may be a rotation or a repetition |
//! | groups in groups | [`DEPTH`] deep, [`MOST`] moves | a short text must not fill the memory |

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
#[error("`{token}` at position {position} {fault}")]
pub struct ParseMoves {
    /// Position of the word in the text, in characters from 1.
    pub position: usize,
    /// Word that cannot be read.
    pub token: String,
    /// Fault of the word.
    pub fault: MoveFault,
}

/// Fault of a word that cannot be read as a move or a group of moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum MoveFault {
    /// The word is not a move.
    #[error(
        "is not a move: expected U, R, F, D, L or B, a wide turn as Rw or r, a slice M, E or S, \
         or a rotation x, y or z, then nothing, 1, 2, 3 or ' (3 is the same as '); \
         moves in parentheses may be repeated: (R U)2"
    )]
    NotAMove,
    /// The number may belong to the move before it or to the wide turn after it.
    #[error(
        "may mean two things: put a blank after the number if it counts the quarters of the move \
         before it; a 3x3 cube has no wide turns with a number before them"
    )]
    Ambiguous,
    /// A group has no closing parenthesis.
    #[error("opens a group that is not closed: add a closing parenthesis")]
    Unclosed,
    /// A closing parenthesis has no group.
    #[error("closes a group that is not open: add an opening parenthesis or remove this one")]
    Unopened,
    /// Something other than a number of repetitions is at the end of a group.
    #[error(
        "ends a group with something other than a number from 1 to {REPEATED}: \
         put a blank after the parenthesis, or repeat the group as (R U)2"
    )]
    Repetition,
    /// Groups within groups are nested too deep.
    #[error("opens a group inside of {DEPTH} others, which is the limit: write the moves out")]
    TooDeep,
    /// The repetitions make too many moves.
    #[error("makes more than {MOST} moves: repeat less")]
    TooMany,
}

/// Largest number of repetitions of a group.
const REPEATED: usize = 99;
/// Largest number of groups around a move.
const DEPTH: usize = 16;
/// Largest number of moves of a text.
const MOST: usize = 100_000;

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
            // A wide turn is a rotation of the whole cube in which the opposite outer layer stays
            // in place. So this layer is turned back first, which is clockwise as seen from its
            // side.
            Layers::Wide(face) => rotated(turned(*facelets, face.opposite(), forth), face, forth),
            Layers::Slice(face) => {
                // A slice is a rotation of the whole cube in which both outer layers stay in place,
                // so both are turned back first.
                let outer = turned(turned(*facelets, face, back), face.opposite(), forth);
                rotated(outer, face, forth)
            }
            Layers::All(face) => rotated(*facelets, face, forth),
        }
    }
}

impl fmt::Display for Move {
    /// Writes the move in the notation that [`parse_moves`] reads.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let suffix = ["", "2", "'"][usize::from(self.quarters) - 1];
        match self.layers {
            Layers::Face(face) => write!(f, "{}{suffix}", face.letter()),
            Layers::Wide(face) => write!(f, "{}w{suffix}", face.letter()),
            Layers::Slice(face) => {
                // The letter follows from the axis: a parsed slice always has the sense of L, F or
                // D.
                let letter = match face.axis() {
                    Axis::X => 'M',
                    Axis::Y => 'S',
                    Axis::Z => 'E',
                };
                write!(f, "{letter}{suffix}")
            }
            Layers::All(face) => {
                // A parsed rotation always has the sense of R, F or U.
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
///
/// ```
/// use rubik_robot_vocabulary::cube::{Facelets, after_moves, parse_moves};
///
/// // Half turns of all three slices make a chessboard of opposite colours.
/// let pattern = after_moves(&Facelets::solved(), &parse_moves("M2 E2 S2")?);
/// assert_eq!(&pattern.to_string()[..9], "UDUDUDUDU");
/// // A rotation of the whole cube leaves it solved.
/// assert!(after_moves(&Facelets::solved(), &parse_moves("x y' z2")?).is_solved());
/// # Ok::<(), rubik_robot_vocabulary::cube::ParseMoves>(())
/// ```
#[must_use]
pub fn after_moves(facelets: &Facelets, moves: &[Move]) -> Facelets {
    moves.iter().fold(*facelets, |f, m| m.of(&f))
}

/// Reads moves, with or without spaces between them: `R U2 F'`, `Rw M' x2`, `RU2F'`, `(R U)3`.
///
/// ```
/// use rubik_robot_vocabulary::cube::{MoveFault, parse_moves};
///
/// assert_eq!(parse_moves("(R U R' U')6")?.len(), 24);
/// // `r` is the short form of the wide turn `Rw`.
/// assert_eq!(parse_moves("r2")?, parse_moves("Rw2")?);
/// let wrong = parse_moves("R U5").unwrap_err();
/// assert_eq!((wrong.position, wrong.fault), (3, MoveFault::NotAMove));
/// # Ok::<(), rubik_robot_vocabulary::cube::ParseMoves>(())
/// ```
///
/// # Errors
/// The first word that is not a move, and its position.
pub fn parse_moves(text: &str) -> Result<Vec<Move>, ParseMoves> {
    let letters: Vec<char> = text.chars().collect();
    let mut moves = Vec::new();
    // Each open group: the position of its parenthesis, and the number of moves before it.
    let mut groups: Vec<(usize, usize)> = Vec::new();
    let mut at = 0;
    while let Some(&letter) = letters.get(at) {
        let start = at;
        match letter {
            _ if letter.is_whitespace() => at += 1,
            '(' if groups.len() == DEPTH => {
                return Err(unreadable(&letters, start, MoveFault::TooDeep));
            }
            '(' => {
                groups.push((start, moves.len()));
                at += 1;
            }
            ')' => {
                let group = groups.pop();
                let (_, begin) =
                    group.ok_or_else(|| unreadable(&letters, start, MoveFault::Unopened))?;
                let (times, next) = repetitions(&letters, start)?;
                let group = moves[begin..].to_vec();
                if group.len() * (times - 1) + moves.len() > MOST {
                    return Err(unreadable(&letters, start, MoveFault::TooMany));
                }
                (1..times).for_each(|_| moves.extend_from_slice(&group));
                at = next;
            }
            _ => {
                let (one, next) = parse_move(&letters, start)?;
                moves.push(one);
                at = next;
            }
        }
    }
    match groups.first() {
        Some(&(open, _)) => Err(unreadable(&letters, open, MoveFault::Unclosed)),
        None => Ok(moves),
    }
}

/// Reads the move that begins at `start`. Returns the move and the position of the first character
/// after it.
fn parse_move(letters: &[char], start: usize) -> Result<(Move, usize), ParseMoves> {
    let mut layers =
        layers(letters[start]).ok_or_else(|| unreadable(letters, start, MoveFault::NotAMove))?;
    let mut at = start + 1;
    // Only an outer layer can become wide: `rw` and `Mw` are refused below.
    if let (Some('w'), Layers::Face(face)) = (letters.get(at), layers) {
        layers = Layers::Wide(face);
        at += 1;
    }
    let suffix = letters.get(at).and_then(|c| quarters(*c));
    let quarters = suffix.unwrap_or(1);
    at += usize::from(suffix.is_some());
    let number = suffix.is_some() && letters[at - 1].is_ascii_digit();
    // A half turn anticlockwise is sometimes written as 2'.
    at += usize::from(quarters == 2 && letters.get(at).is_some_and(|c| is_prime(*c)));
    // A second suffix is a mistake and not a move of its own: `R22`, `Mw`.
    let doubled = |c: &char| matches!(c, 'w' | '0'..='9') || is_prime(*c);
    if letters.get(at).is_some_and(doubled) {
        return Err(unreadable(letters, start, MoveFault::NotAMove));
    }
    // `3Rw` turns three layers of a large cube, so `y3Rw` could be y and 3Rw as well as y3 and Rw.
    if number && is_wide(letters, at) {
        return Err(unreadable(letters, start, MoveFault::Ambiguous));
    }
    Ok((Move { layers, quarters }, at))
}

/// Returns whether a wide turn (`Rw` or `r`) begins at position `at`.
fn is_wide(letters: &[char], at: usize) -> bool {
    let layers = letters.get(at).and_then(|c| layers(*c));
    match layers {
        Some(Layers::Wide(_)) => true,
        Some(Layers::Face(_)) => letters.get(at + 1) == Some(&'w'),
        _ => false,
    }
}

/// Returns the number of repetitions after the closing parenthesis at `close` (1 if none is given),
/// and the position after that number.
fn repetitions(letters: &[char], close: usize) -> Result<(usize, usize), ParseMoves> {
    let at = close + 1;
    let digits: String = letters[at..].iter().take_while(|c| c.is_ascii_digit()).collect();
    let next = at + digits.len();
    let times = if digits.is_empty() { Some(1) } else { digits.parse().ok() };
    // A letter right after the group is refused: as in `(R U)x2`, it may mean repetition or a move.
    let ends = letters.get(next).is_none_or(|c| c.is_whitespace() || matches!(c, '(' | ')'));
    match times.filter(|times| ends && (1..=REPEATED).contains(times)) {
        Some(times) => Ok((times, next)),
        None => Err(unreadable(letters, close, MoveFault::Repetition)),
    }
}

/// Returns the number of clockwise quarters that a suffix stands for; `None` for any other
/// character.
pub(super) fn quarters(suffix: char) -> Option<u8> {
    match suffix {
        '1' => Some(1),
        '2' => Some(2),
        '3' => Some(3),
        _ => is_prime(suffix).then_some(3),
    }
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

/// Checks whether a character is an apostrophe, or one of those that keyboards and typesetting put
/// in its place.
pub(super) fn is_prime(letter: char) -> bool {
    matches!(letter, '\'' | '’' | '‘' | '′' | '`' | '´')
}

/// Returns the error for the word at `start`, which ends at the next blank and is cut after 12
/// letters.
fn unreadable(letters: &[char], start: usize, fault: MoveFault) -> ParseMoves {
    let token = letters[start..].iter().take_while(|c| !c.is_whitespace()).take(12).collect();
    ParseMoves { position: start + 1, token, fault }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::parse_turns;
    use proptest::prelude::*;

    /// Returns the solved cube after these moves.
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
        use MoveFault::{Ambiguous, NotAMove, Repetition, TooDeep, TooMany, Unclosed, Unopened};
        let deep = "(".repeat(17);
        for (text, position, token, fault) in [
            ("R U Q2 F", 5, "Q2", NotAMove),
            ("R22", 1, "R22", NotAMove),
            ("R5", 1, "R5", NotAMove),
            ("R0", 1, "R0", NotAMove),
            ("Mw", 1, "Mw", NotAMove),
            ("2R", 1, "2R", NotAMove),
            ("R (2U)", 4, "2U)", NotAMove),
            ("[R, U]", 1, "[R,", NotAMove),
            ("R U // first block", 5, "//", NotAMove),
            ("No solution", 1, "No", NotAMove),
            ("RUFQ2", 4, "Q2", NotAMove),
            ("U y3Rw", 3, "y3Rw", Ambiguous),
            ("Fw3Rw", 1, "Fw3Rw", Ambiguous),
            ("u3Lw", 1, "u3Lw", Ambiguous),
            ("R2u F", 1, "R2u", Ambiguous),
            ("R (U F", 3, "(U", Unclosed),
            ("R) U", 2, ")", Unopened),
            ("(R U)x2", 5, ")x2", Repetition),
            ("(R U)' F", 5, ")'", Repetition),
            ("(R)0", 3, ")0", Repetition),
            ("(R)100", 3, ")100", Repetition),
            (&*deep, 17, "(", TooDeep),
            ("(((R)99)99)99", 11, ")99", TooMany),
        ] {
            let wanted = ParseMoves { position, token: token.to_owned(), fault };
            assert_eq!(parse_moves(text), Err(wanted), "{text}");
        }
    }

    #[test]
    fn suffixes_1_and_3_count_quarters() {
        for (text, same) in
            [("R1 U1 F3", "R U F'"), ("R1U1F3", "R U F'"), ("Rw3 M1 y3", "Rw' M y'"), ("R2'", "R2")]
        {
            assert_eq!(parse_moves(text), parse_moves(same), "{text}");
        }
    }

    #[test]
    fn number_after_group_repeats_its_moves() {
        for (text, same) in [
            ("(R U)3", "R U R U R U"),
            ("(R U R' U')2 F", "R U R' U' R U R' U' F"),
            ("F (R U) B", "F R U B"),
            ("((R)2 U)2(F)1", "R R U R R U F"),
            ("( R U' )2", "R U' R U'"),
            ("()9", ""),
        ] {
            assert_eq!(parse_moves(text), parse_moves(same), "{text}");
        }
    }

    proptest! {
        #[test]
        fn parsed_moves_survive_text_round_trip(
            any in "[URFDLBurfdlbMESxyzw123()' ’Q]{0,20}",
            valid in "(([URFDLB]w?|[urfdlbMESxyz])['1-3]? ){1,12}",
        ) {
            let expected = valid.split_whitespace().count();
            prop_assert_eq!(parse_moves(&valid).unwrap().len(), expected);
            for moves in [any, valid].iter().filter_map(|text| parse_moves(text).ok()) {
                let written: Vec<String> = moves.iter().map(Move::to_string).collect();
                prop_assert_eq!(parse_moves(&written.join(" ")).unwrap(), moves);
            }
        }
    }
}
