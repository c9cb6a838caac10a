//! Cubes in a stream of lines, as `solve -` reads them.
//!
//! - in: text in UTF-8 or, with a byte-order mark, in UTF-16
//! - out: the text of each cube as soon as its last line is there: one line, or the lines of a
//!   layout ([`Listing`]); empty lines are skipped
//!
//! Lines that begin a layout and do not complete it are cubes of their own, each of which is
//! refused. So the cubes after them are still found.

use super::output::next_line;
use crate::cube::Listing;
use crate::hw::text;
use std::collections::VecDeque;
use std::io::{self, BufRead};

/// Largest length of a line with a cube (bytes). A scramble has hundreds.
const LONGEST: usize = 1 << 16;

/// Returns the texts of the cubes. An error of reading ends the iteration.
pub(super) fn cubes(from: impl BufRead) -> impl Iterator<Item = io::Result<String>> {
    let mut cubes = Cubes { lines: lines(from), begun: VecDeque::new(), ready: VecDeque::new() };
    let mut failed = false;
    std::iter::from_fn(move || {
        let next = if failed { None } else { cubes.advance().transpose() };
        failed |= next.as_ref().is_some_and(Result::is_err);
        next
    })
}

/// Parser that makes cubes of lines.
struct Cubes<L> {
    lines: L,
    /// Lines of a layout that is not complete.
    begun: VecDeque<String>,
    /// Cubes that are not returned yet.
    ready: VecDeque<String>,
}

impl<L: Iterator<Item = io::Result<String>>> Cubes<L> {
    /// Returns the next cube, or `None` at the end of the lines.
    fn advance(&mut self) -> io::Result<Option<String>> {
        while self.ready.is_empty() {
            let Some(line) = self.lines.next().transpose()? else {
                // The layout has no end, so its lines are cubes of their own.
                self.ready.extend(self.begun.drain(..));
                break;
            };
            self.begun.push_back(line);
            match Listing::of(self.begun.make_contiguous()) {
                Listing::Begun => {}
                Listing::Complete => self.complete(),
                Listing::Broken => {
                    let last = self.begun.pop_back();
                    self.ready.extend(self.begun.drain(..));
                    // The last line may begin a cube of its own.
                    self.begun.extend(last);
                    if Listing::of(self.begun.make_contiguous()) == Listing::Complete {
                        self.complete();
                    }
                }
            }
        }
        Ok(self.ready.pop_front())
    }

    /// Makes one cube of the lines in `begun`, which complete a layout.
    fn complete(&mut self) {
        let lines: Vec<String> = self.begun.drain(..).collect();
        self.ready.push_back(lines.join("\n"));
    }
}

/// Returns the lines of a stream that are not empty.
fn lines(mut from: impl BufRead) -> impl Iterator<Item = io::Result<String>> {
    // Text in UTF-16 has no line ends of one byte, so it is read whole. A file of cubes has an end.
    let mut whole = VecDeque::new();
    // The first bytes show the byte-order mark. An error here occurs again when a line is read.
    if matches!(from.fill_buf(), Ok([0xFF, 0xFE, ..] | [0xFE, 0xFF, ..])) {
        match text::of(&mut from, text::LIST) {
            Ok(text) => whole.extend(text.lines().map(|line| Ok(line.to_owned()))),
            Err(error) => whole.push_back(Err(error)),
        }
    }
    let mut line = Vec::new();
    let streamed = std::iter::from_fn(move || {
        let read = next_line(&mut from, LONGEST, &mut line).transpose()?;
        // A line that is no text is refused as any wrong line; the next lines are answered.
        let cube = || String::from_utf8_lossy(&line).into_owned();
        // A line that is too long is refused, even if it begins like a cube.
        let long = || format!("a line of more than {LONGEST} bytes");
        Some(read.map(|complete| if complete { cube() } else { long() }))
    });
    let lines = whole.into_iter().chain(streamed);
    lines.filter(|l| l.as_ref().is_ok_and(|l| !l.trim().is_empty()) || l.is_err())
}

#[cfg(test)]
mod tests {
    use super::*;

    const CUBE: &str = "UUUUUUUUURRRRRRRRRFFFFFFFFFDDDDDDDDDLLLLLLLLLBBBBBBBBB";

    /// Returns the texts of the cubes in a stream.
    fn texts(bytes: &[u8]) -> Vec<String> {
        cubes(bytes).map(Result::unwrap).collect()
    }

    /// The lines of a complete layout make one cube; each line of a broken layout is a cube of its
    /// own, which will be refused.
    #[test]
    fn layouts_are_joined_and_broken_ones_split() {
        let sides = "UUUUUUUUU\nRRRRRRRRR\nFFFFFFFFF\nDDDDDDDDD\nLLLLLLLLL\nBBBBBBBBB";
        let stream = format!("{CUBE}\n\n{sides}\nUUU\nURF\n{CUBE}\nUUUUUUUUU\n{sides}\nUUU");

        let found = texts(stream.as_bytes());

        // After the single side there are seven lines of nine: six of them make a cube.
        let joined = "UUUUUUUUU\nUUUUUUUUU\nRRRRRRRRR\nFFFFFFFFF\nDDDDDDDDD\nLLLLLLLLL";
        assert_eq!(found, [CUBE, sides, "UUU", "URF", CUBE, joined, "BBBBBBBBB", "UUU"]);
    }

    /// A cube is returned as soon as its last line is there, without a look at the next line: a
    /// program that writes cubes one by one waits for each answer.
    #[test]
    fn cube_is_complete_with_its_last_line() {
        /// Reader that panics when it is read after its end.
        struct Ends<'a>(&'a [u8]);
        impl io::Read for Ends<'_> {
            fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
                // A read after the last byte would block.
                assert!(!self.0.is_empty());
                io::Read::read(&mut self.0, into)
            }
        }
        let sides = "UUUUUUUUU\nRRRRRRRRR\nFFFFFFFFF\nDDDDDDDDD\nLLLLLLLLL\nBBBBBBBBB\n";
        for stream in [format!("{CUBE}\n"), sides.to_owned()] {
            let mut found = cubes(io::BufReader::new(Ends(stream.as_bytes())));

            assert_eq!(found.next().unwrap().unwrap(), stream.trim());
        }
    }

    #[test]
    fn utf16_is_decoded_by_its_byte_order_mark() {
        let text = format!("\u{feff}{CUBE}\r\n{CUBE}\r\n");
        let little: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
        let big: Vec<u8> = text.encode_utf16().flat_map(u16::to_be_bytes).collect();

        assert_eq!(texts(&little), [CUBE, CUBE]);
        assert_eq!(texts(&big), [CUBE, CUBE]);
        assert_eq!(texts(b"\n\xff\xfe\n"), ["\u{fffd}\u{fffd}"]);
    }
}
