//! The console: lines for people on stderr, and one live line below them on a terminal.
//!
//! - in: lines with their tone, lines of the log, the text of the live line
//! - out: stderr. The live line is erased before each other line and drawn again below it
//!
//! All threads share one stderr, so the live line is a state of the process. Colours follow the
//! rules of clap's help: a terminal has them unless `NO_COLOR` is set or `TERM` is `dumb`, and
//! `CLICOLOR_FORCE` forces them. Only a terminal that obeys `\r` has a live line.

use super::text::{printable, shortened, with_commands_of};
use anstream::{AutoStream, ColorChoice};
use std::fmt::Write as _;
use std::io::{self, IsTerminal as _, Write as _};
use std::sync::{Mutex, OnceLock, PoisonError};

/// Number of columns of a terminal that does not tell its width.
const COLUMNS: u16 = 80;
/// Moves to the first column and erases the line.
const ERASE: &str = "\r\x1b[K";

/// Tone of a line, which decides its colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tone {
    /// Progress or information.
    Plain,
    /// Success.
    Good,
    /// Warning.
    Warning,
    /// Error.
    Error,
}

impl Tone {
    /// Returns the escape sequence that begins the colour of the tone; empty for plain text.
    fn colour(self) -> &'static str {
        match self {
            Self::Plain => "",
            Self::Good => "\x1b[32m",
            Self::Warning => "\x1b[33m",
            Self::Error => "\x1b[31m",
        }
    }

    /// Returns `text` in the colour of the tone. Indented lines stay plain: they quote a file or
    /// give advice.
    #[must_use]
    pub fn paint(self, text: &str) -> String {
        let colour = self.colour();
        let mut painted = String::with_capacity(text.len() + 16);
        for (number, line) in text.split('\n').enumerate() {
            if number > 0 {
                painted.push('\n');
            }
            if colour.is_empty() || line.is_empty() || line.starts_with(' ') {
                painted.push_str(line);
            } else {
                // Writing to a string cannot fail.
                let _ = write!(painted, "{colour}{line}\x1b[0m");
            }
        }
        painted
    }
}

/// State of the console.
struct Console {
    /// Text of the live line; empty if none is drawn.
    live: String,
    /// Lines that wait until a UI has given the terminal back; `None` if none has it.
    held: Option<Vec<u8>>,
}

/// Greatest size of the lines that wait (bytes).
const HELD: usize = 64 << 10;

/// Console of this process.
static CONSOLE: Mutex<Console> = Mutex::new(Console { live: String::new(), held: None });

/// Name of this process's program, once [`speak_as`] has given it.
static PROGRAM: OnceLock<String> = OnceLock::new();

/// Gives the program its name. From now on the commands that lines quote are those of this program.
pub fn speak_as(program: &str) {
    let _ = PROGRAM.set(program.to_owned());
}

/// Returns a text for the console: with the commands of this program, and without control
/// characters.
fn spoken(text: &str) -> String {
    let text = match PROGRAM.get() {
        Some(program) => with_commands_of(program, text),
        None => text.into(),
    };
    printable(&text).into_owned()
}

/// Writes `text` to stderr between an erased and a newly drawn live line.
fn write(text: &[u8]) -> io::Result<()> {
    // A thread that panicked while it wrote has left the line in a state that can be drawn.
    let mut console = CONSOLE.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(held) = &mut console.held {
        if held.len() + text.len() <= HELD {
            held.extend_from_slice(text);
        }
        return Ok(());
    }
    let mut stderr = io::stderr().lock();
    if console.live.is_empty() {
        return stderr.write_all(text);
    }
    let whole = [ERASE.as_bytes(), text, console.live.as_bytes()].concat();
    stderr.write_all(&whole)
}

/// Prints a line in its tone. Control characters are spelled out. A closed stderr is ignored,
/// because there is no other place to report it.
pub fn line(tone: Tone, text: &str) {
    let text = spoken(text);
    let text = if has_colours() { tone.paint(&text) } else { text };
    let _ = write(format!("{text}\n").as_bytes());
}

/// Prints a notice that begins with its time, see [`line()`]. All of it is in its tone.
pub fn timed(tone: Tone, text: &str) {
    let text = spoken(text);
    let colour = tone.colour();
    let text = if has_colours() && !colour.is_empty() {
        format!("{colour}{text}\x1b[0m\n")
    } else {
        format!("{text}\n")
    };
    let _ = write(text.as_bytes());
}

/// Replaces the live line by `text`, shortened to the width of the terminal. An empty text erases
/// it. Does nothing where [`has_live_line`] is false.
pub fn show(text: &str) {
    if !has_live_line() {
        return;
    }
    // The last column stays free: some terminals break the line there.
    let text = printable(text);
    let text = shortened(&text, usize::from(columns()).saturating_sub(1));
    let mut console = CONSOLE.lock().unwrap_or_else(PoisonError::into_inner);
    if console.live == text || console.held.is_some() {
        return;
    }
    let _ = io::stderr().lock().write_all(format!("{ERASE}{text}").as_bytes());
    console.live = text.into_owned();
}

/// Keeps all lines back while a UI draws on the terminal at stderr.
pub fn hold() {
    if io::stderr().is_terminal() {
        let mut console = CONSOLE.lock().unwrap_or_else(PoisonError::into_inner);
        console.held.get_or_insert_default();
    }
}

/// Prints the lines that were kept back: the UI has given the terminal back.
pub fn release() {
    let held = CONSOLE.lock().unwrap_or_else(PoisonError::into_inner).held.take();
    let _ = held.map(|lines| write(&lines));
}

/// Returns whether stderr is a terminal on which a line can be erased and drawn again.
#[must_use]
pub fn has_live_line() -> bool {
    let dumb = std::env::var_os("TERM").is_none_or(|term| term == "dumb");
    io::stderr().is_terminal() && !dumb
}

/// Returns whether lines on stderr have colours.
#[must_use]
pub fn has_colours() -> bool {
    colours(&io::stderr())
}

/// Returns whether results on stdout have colours.
#[must_use]
pub fn colours_results() -> bool {
    colours(&io::stdout())
}

/// Returns whether lines on this stream have colours: a terminal that cannot erase a line has none,
/// unless they are forced.
fn colours(stream: &impl anstream::stream::RawStream) -> bool {
    let forced = std::env::var_os("CLICOLOR_FORCE").is_some_and(|forced| forced != "0");
    let dumb = std::env::var_os("TERM").is_some_and(|term| term == "dumb");
    AutoStream::choice(stream) != ColorChoice::Never && (forced || !dumb)
}

/// Returns the number of columns of the terminal at stderr.
#[must_use]
pub fn columns() -> u16 {
    let size = rustix::termios::tcgetwinsize(io::stderr());
    size.map(|size| size.ws_col).ok().filter(|columns| *columns > 0).unwrap_or(COLUMNS)
}

/// Writer of the log, whose lines erase the live line as all others do.
#[derive(Debug, Clone, Copy, Default)]
pub struct Log;

impl io::Write for Log {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        write(bytes).map(|()| bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_lines_without_indent_are_painted() {
        let text = "a.toml:2:1: unknown key\n  2 | edge_cm = 57\nb";

        let painted = Tone::Error.paint(text);

        let wanted = "\x1b[31ma.toml:2:1: unknown key\x1b[0m\n  2 | edge_cm = 57\n\x1b[31mb\x1b[0m";
        assert_eq!(painted, wanted);
        assert_eq!(Tone::Plain.paint(text), text);
    }
}
