//! Text of a cube as people and programs write it: `Facelets::from_str`.
//!
//! - in: 54 letters, of sides or of colours, in one of the layouts below; blanks and a byte-order
//!   mark are ignored
//! - out: [`Facelets`], which need not form a possible cube; or the letter or layout that is wrong
//!
//! | layout | lines and their letters | order of the sides |
//! |---|---|---|
//! | one line | 54 | URFDLB |
//! | a line for each side | six of 9 | URFDLB |
//! | a line for each row of a side | 18 of 3 | URFDLB |
//! | net | three of 3, three of 12, three of 3 | U; L F R B; D |
//!
//! Colours (w r o y g b) are named by the centres. They may also be in the order ULFRBD: opposite
//! centres of a cube are white and yellow, red and orange, green and blue, which is true of one of
//! the two orders at most. Any other arrangement of colours is refused, because more than one cube
//! may be meant.

use super::{Face, Facelets, ParseFacelets, facelet_place};
use std::str::FromStr;

/// Lengths of the lines of each layout, except the single line.
const LAYOUTS: [&[usize]; 3] = [&[9; 6], &[3; 18], &NET];
/// Lengths of the lines of a net.
const NET: [usize; 9] = [3, 3, 3, 12, 12, 12, 3, 3, 3];
/// Letters of the colours, in the order of the faces that have them on a solved cube.
const COLOURS: [char; 6] = ['W', 'R', 'G', 'Y', 'O', 'B'];
/// Positions of the sides of a list in the order ULFRBD within the order URFDLB.
const ULFRBD: [usize; 6] = [0, 3, 2, 5, 1, 4];

/// Progress of lines towards the text of a cube.
///
/// ```
/// use rubik_robot_vocabulary::cube::Listing;
///
/// // Three letters begin a net or a list of rows; 54 letters in a line are a cube.
/// assert_eq!(Listing::of(&["UUU"]), Listing::Begun);
/// assert_eq!(Listing::of(&["U".repeat(54)]), Listing::Complete);
/// assert_eq!(Listing::of(&["UUU", "UUUU"]), Listing::Broken);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Listing {
    /// The lines are the text of a cube, or no layout begins in this way.
    Complete,
    /// The lines are the beginning of a layout.
    Begun,
    /// The first lines are the beginning of a layout, and the last one does not continue it.
    Broken,
}

impl Listing {
    /// Returns the progress of `lines`, of which there must be at least one.
    #[must_use]
    pub fn of<T: AsRef<str>>(lines: &[T]) -> Self {
        let lengths: Vec<usize> = lines.iter().map(|line| letters(line.as_ref()).count()).collect();
        // A line with a character that names neither a side nor a colour begins no cube, even if it
        // has the right length.
        let known = |line: &T| letters(line.as_ref()).all(|c| face(c).or(colour(c)).is_some());
        let begins = LAYOUTS.iter().any(|layout| layout.starts_with(&lengths));
        if !begins || !lines.iter().all(known) {
            return if lines.len() == 1 { Self::Complete } else { Self::Broken };
        }
        if LAYOUTS.contains(&&*lengths) { Self::Complete } else { Self::Begun }
    }
}

impl FromStr for Facelets {
    type Err = ParseFacelets;

    /// Reads the text of a cube in one of the layouts of this module.
    ///
    /// ```
    /// use rubik_robot_vocabulary::cube::Facelets;
    ///
    /// let net = "
    ///     UUU
    ///     UUU
    ///     UUU
    ///  LLL FFF RRR BBB
    ///  LLL FFF RRR BBB
    ///  LLL FFF RRR BBB
    ///     DDD
    ///     DDD
    ///     DDD";
    /// assert_eq!(net.parse::<Facelets>()?, Facelets::solved());
    /// // White, red, green, yellow, orange, blue: the usual colours in the order URFDLB.
    /// let colours = ["w", "r", "g", "y", "o", "b"].map(|colour| colour.repeat(9)).concat();
    /// assert_eq!(colours.parse::<Facelets>()?, Facelets::solved());
    /// # Ok::<(), rubik_robot_vocabulary::cube::ParseFacelets>(())
    /// ```
    ///
    /// # Errors
    /// The first wrong letter, a wrong number of letters, an unknown layout, or colours whose
    /// centres are not those of a usual cube.
    fn from_str(text: &str) -> Result<Self, ParseFacelets> {
        let text = text.trim().trim_start_matches('\u{feff}').trim_start();
        // Each letter keeps its position in the text for the message.
        let mut letters: Vec<(usize, char)> =
            text.chars().enumerate().filter(|(_, c)| !c.is_whitespace()).collect();
        let lengths: Vec<usize> =
            text.lines().map(|line| self::letters(line).count()).filter(|n| *n > 0).collect();
        if lengths == NET {
            letters = unfolded(&letters);
        }
        // A letter that names no side shows that the letters are colours. A wrong letter is
        // reported before a wrong length, because it says more about the mistake.
        let foreign = letters.iter().take(54).position(|(_, c)| face(*c).is_none());
        let are_colours = letters.iter().all(|(_, c)| colour(*c).is_some());
        if let (Some(at), false) = (foreign, are_colours) {
            let (position, letter) = letters[at];
            let place = facelet_place(at);
            return Err(ParseFacelets::Letter { position: position + 1, place, letter });
        }
        let named = if foreign.is_some() { colour } else { face };
        let faces: Vec<Face> = letters.iter().filter_map(|(_, c)| named(*c)).collect();
        let faces =
            <[Face; 54]>::try_from(faces).map_err(|_| ParseFacelets::Length(letters.len()))?;
        // The lengths of the lines tell the known layouts apart. In any other layout the order of
        // the sides is unknown.
        if lengths.len() > 1 && !LAYOUTS.contains(&&*lengths) {
            return Err(ParseFacelets::Layout(lengths.len()));
        }
        match foreign {
            None => Ok(Self::from_faces(faces)),
            Some(_) => by_centres(faces, lengths != NET),
        }
    }
}

/// Returns the characters of a line without blanks and byte-order marks.
fn letters(line: &str) -> impl Iterator<Item = char> {
    line.chars().filter(|c| !c.is_whitespace() && *c != '\u{feff}')
}

/// Returns the side that a letter names, in upper or lower case; `None` for any other letter.
fn face(letter: char) -> Option<Face> {
    Face::from_letter(letter.to_ascii_uppercase())
}

/// Returns the side that has the colour of a letter on a solved cube; `None` if the letter, in
/// upper or lower case, is no colour.
fn colour(letter: char) -> Option<Face> {
    let index = COLOURS.iter().position(|c| *c == letter.to_ascii_uppercase())?;
    Some(Face::ALL[index])
}

/// Returns the letters of a net in the order URFDLB.
fn unfolded<T: Copy>(net: &[T]) -> Vec<T> {
    // U comes first and D last. Between them are three lines with a row each of L, F, R and B.
    let belt = |side: usize| (0..9).map(move |i| 9 + 12 * (i / 3) + 3 * side + i % 3);
    let order = (0..9).chain(belt(2)).chain(belt(1)).chain(45..54).chain(belt(0)).chain(belt(3));
    order.map(|i| net[i]).collect()
}

/// Returns the cube whose stickers have these colours, each named by the side on whose centre it
/// is. The sides are in the order URFDLB. If `either` is true, the order ULFRBD is tried as well.
///
/// # Errors
/// [`ParseFacelets::Colours`] if in no tried order the centres are those of a usual cube.
fn by_centres(colours: [Face; 54], either: bool) -> Result<Facelets, ParseFacelets> {
    let usual = Facelets::from_faces(colours).named_by_position();
    let other = || {
        let moved = std::array::from_fn(|i| colours[9 * ULFRBD[i / 9] + i % 9]);
        Facelets::from_faces(moved).named_by_position().ok().filter(|_| either)
    };
    usual.ok().or_else(other).ok_or(ParseFacelets::Colours)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::Cube;

    /// Returns a scrambled cube, and its 54 letters in the order URFDLB.
    fn cube() -> (Facelets, String) {
        let facelets = Facelets::from(&Cube::scrambled(7));
        (facelets, facelets.to_string())
    }

    /// Returns a text with `separator` after each `length` letters.
    fn parted(text: &str, length: usize, separator: &str) -> String {
        let letters: Vec<char> = text.chars().collect();
        let parts: Vec<String> = letters.chunks(length).map(|part| part.iter().collect()).collect();
        parts.join(separator)
    }

    /// Returns the text with the letter of each side replaced by that of its colour.
    fn coloured(text: &str) -> String {
        let letter = |c| COLOURS[Face::from_letter(c).unwrap().index()].to_ascii_lowercase();
        text.chars().map(letter).collect()
    }

    /// Returns the letters of a text in the order URFDLB as a net.
    fn net(text: &str) -> String {
        let row = |face: usize, row: usize| &text[9 * face + 3 * row..][..3];
        let mut lines: Vec<String> = (0..3).map(|r| format!("    {}", row(0, r))).collect();
        lines.extend((0..3).map(|r| [4, 2, 1, 5].map(|face| row(face, r)).join(" ")));
        lines.extend((0..3).map(|r| format!("    {}", row(3, r))));
        lines.join("\n")
    }

    #[test]
    fn layouts_and_encodings_of_one_cube_agree() {
        let (cube, text) = cube();
        for written in [
            format!("\u{feff}{text}\r\n"),
            text.to_lowercase(),
            parted(&text, 9, " "),
            parted(&text, 3, "\t"),
            parted(&text, 9, "\n"),
            parted(&text, 9, "\r\n\r\n"),
            parted(&text, 3, "\n"),
            net(&text),
            coloured(&text),
            coloured(&text).to_uppercase(),
            parted(&coloured(&text), 9, "\n"),
            net(&coloured(&text)),
        ] {
            assert_eq!(written.parse(), Ok(cube), "{written}");
        }
    }

    #[test]
    fn colours_are_read_in_either_order_of_sides() {
        let (cube, text) = cube();
        let colours = coloured(&text);
        let side = |face: usize| &colours[9 * face..][..9];

        let other = [0, 4, 2, 1, 5, 3].map(side).concat();
        // With two sides exchanged the centres are those of no cube.
        let wrong = [0, 2, 1, 3, 4, 5].map(side).concat();

        assert_eq!(other.parse(), Ok(cube));
        assert_eq!(wrong.parse::<Facelets>(), Err(ParseFacelets::Colours));
    }

    /// A cube is held in another orientation: each colour is named by the side that its centre is
    /// on.
    #[test]
    fn colours_are_named_by_their_centres() {
        let (cube, _) = cube();
        let held = cube.rotated(crate::cube::Rotation24::quarter(Face::R));

        let read: Facelets = coloured(&held.to_string()).parse().unwrap();

        assert_eq!(read, held.named_by_position().unwrap());
        assert!(Cube::try_from(read).is_ok());
    }

    #[test]
    fn wrong_letter_is_reported_with_its_place() {
        let text = Facelets::solved().to_string().replacen('R', "X", 1);
        let message = |text: &str| text.parse::<Facelets>().unwrap_err().to_string();

        let wanted = |position| {
            format!("letter 'X' at position {position} (R1) is not one of U, R, F, D, L, B")
        };

        assert_eq!(message(&text), wanted(10));
        // Blanks count in the position, and not in the place.
        assert_eq!(message(&parted(&text, 9, " ")), wanted(11));
        assert_eq!("UUU".parse::<Facelets>(), Err(ParseFacelets::Length(3)));
        let quoted = format!("\"{}\"", Facelets::solved());
        assert!(message(&quoted).starts_with("letter '\"' at position 1 (U1)"));
    }

    #[test]
    fn unknown_layout_is_refused() {
        let (_, text) = cube();

        assert_eq!(parted(&text, 6, "\n").parse::<Facelets>(), Err(ParseFacelets::Layout(9)));
    }

    #[test]
    fn listing_tells_complete_from_begun_and_broken_lines() {
        let (_, text) = cube();
        let sides = parted(&text, 9, "\n");
        let net = net(&text);
        for (written, wanted) in [(&text, 1), (&sides, 6), (&net, 9)] {
            let lines: Vec<&str> = written.lines().collect();

            for given in 1..lines.len() {
                assert_eq!(Listing::of(&lines[..given]), Listing::Begun, "{given}");
            }
            assert_eq!((Listing::of(&lines), lines.len()), (Listing::Complete, wanted));
        }
        assert_eq!(Listing::of(&["a cube of"]), Listing::Complete);
        assert_eq!(Listing::of(&["UUU", &text]), Listing::Broken);
        assert_eq!(Listing::of(&["UUU", "UUU", "UUU", "UUU", "UUUUUUUUUUUU"]), Listing::Broken);
    }
}
