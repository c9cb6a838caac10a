//! Text files whose paths come from a user, read up to a greatest size.
//!
//! - in: a path and the greatest size
//! - out: the text of the file
//! - [`read`] takes pipes as well, and refuses a file without end when the greatest size is reached
//! - [`open`] takes regular files only, so it never waits
//! - [`deep_line`] and [`printable`] guard against texts of other people: against keys that are
//!   nested so deeply that a parser overflows the stack, and against characters that a terminal
//!   obeys

use std::borrow::Cow;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};
use unicode_width::{UnicodeWidthChar as _, UnicodeWidthStr as _};

/// Greatest size of a scenario and of the files beside it (bytes).
pub const SCENARIO: u64 = 1 << 20;
/// Greatest size of a list of pictures or cubes (bytes).
pub const LIST: u64 = 64 << 20;

/// Most parts of a dotted key of TOML; keys of this program have up to four.
pub const MOST_PARTS: usize = 16;

/// Finds a dotted key of TOML with more than [`MOST_PARTS`] parts; returns the number of its line,
/// from 1. A parser makes a table for each part, and the drop of nested tables is recursive.
#[must_use]
pub fn deep_line(text: &str) -> Option<usize> {
    text.lines().position(is_deep).map(|index| index + 1)
}

/// Returns whether a line may have a dotted key with more than [`MOST_PARTS`] parts. The function
/// does not distinguish values, strings and comments from keys: ordinary ones have no long chain of
/// dots between words.
fn is_deep(line: &str) -> bool {
    // A quoted part may contain any character, so the dots behind quotes count for the whole line.
    let (mut plain, mut quoted, mut last, mut blank) = (0, 0, b' ', false);
    for byte in line.bytes() {
        // Blanks may stand beside a dot, but not between the words of a key.
        if matches!(byte, b' ' | b'\t') {
            blank = true;
            continue;
        }
        if std::mem::take(&mut blank) && byte != b'.' && last != b'.' {
            plain = 0;
        }
        match byte {
            b'.' if matches!(last, b'"' | b'\'') => quoted += 1,
            // Dots without a word between them are no key.
            b'.' if last == b'.' => plain = 0,
            b'.' => plain += 1,
            b'-' | b'_' | b'"' | b'\'' => {}
            _ if byte.is_ascii_alphanumeric() => {}
            _ => plain = 0,
        }
        if plain >= MOST_PARTS || quoted >= MOST_PARTS {
            return true;
        }
        last = byte;
    }
    false
}

/// Returns a text for a screen. Control characters other than a line break and a tab, which a
/// terminal would obey, are spelled out as in JSON (`\u001b`). So are characters that change the
/// direction of the text.
#[must_use]
pub fn printable(text: &str) -> Cow<'_, str> {
    let is_order = |c: char| {
        (c.is_control() && !matches!(c, '\n' | '\t'))
            || matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
    };
    if !text.chars().any(is_order) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len() + 8);
    for c in text.chars() {
        if is_order(c) {
            let _ = write!(shown, "\\u{:04x}", c as u32);
        } else {
            shown.push(c);
        }
    }
    Cow::Owned(shown)
}

/// Returns a text whose quoted commands of this crate's program, such as `rubik-robot keys`, are
/// those of `program`.
#[must_use]
pub fn with_commands_of<'a>(program: &str, text: &'a str) -> Cow<'a, str> {
    const OWN: &str = concat!("`", env!("CARGO_PKG_NAME"), " ");
    if program == env!("CARGO_PKG_NAME") || !text.contains(OWN) {
        return Cow::Borrowed(text);
    }
    Cow::Owned(text.replace(OWN, &format!("`{program} ")))
}

/// Returns `text` if it fits into `columns` of a terminal, otherwise its beginning and an ellipsis.
#[must_use]
pub fn shortened(text: &str, columns: usize) -> Cow<'_, str> {
    if text.width() <= columns {
        return Cow::Borrowed(text);
    }
    // A letter may take no column or two.
    let mut used = 0;
    let end = text.char_indices().find(|(_, letter)| {
        used += letter.width().unwrap_or(0);
        used >= columns
    });
    let kept = text[..end.map_or(text.len(), |(at, _)| at)].trim_end();
    Cow::Owned(if columns == 0 { String::new() } else { format!("{kept}…") })
}

/// Returns a word for a shell, in single quotes if it needs quotes.
#[must_use]
pub fn quoted(word: &str) -> Cow<'_, str> {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=+,:@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        return Cow::Borrowed(word);
    }
    // Between single quotes only a single quote is special. It is replaced by the end of the
    // quotes, an escaped quote, and the beginning of new quotes.
    Cow::Owned(format!("'{}'", word.replace('\'', "'\\''")))
}

/// Error of a file that cannot be read: its message is "cannot read FILE: REASON" in all commands.
#[derive(Debug, thiserror::Error)]
#[error("cannot read {}: {}", path.display(), reason(why))]
pub struct Unread {
    path: PathBuf,
    /// Error of the operating system. It is not the `source` of this error, because the message
    /// contains it already.
    pub why: io::Error,
}

impl Unread {
    /// Makes the error of the file at `path`.
    #[must_use]
    pub fn new(path: &Path, why: io::Error) -> Self {
        Self { path: path.to_owned(), why }
    }
}

impl From<Unread> for io::Error {
    fn from(unread: Unread) -> Self {
        Self::new(unread.why.kind(), unread)
    }
}

/// Returns the reason why a file cannot be read, in words.
#[must_use]
pub fn reason(why: &io::Error) -> Cow<'static, str> {
    match why.kind() {
        ErrorKind::NotFound => "there is no such file".into(),
        ErrorKind::IsADirectory => "it is a folder".into(),
        ErrorKind::PermissionDenied => "this user may not read it".into(),
        _ => why.to_string().into(),
    }
}

/// Opens a file, or anything else that can be read to its end: a pipe, but no folder.
///
/// # Errors
/// [`Unread`].
pub fn open_any(path: &Path) -> Result<File, Unread> {
    let open = || {
        let file = File::open(path)?;
        // A folder can be opened; only the first read from it fails.
        if file.metadata()?.is_dir() {
            return Err(ErrorKind::IsADirectory.into());
        }
        Ok(file)
    };
    open().map_err(|why| Unread::new(path, why))
}

/// Opens a regular file.
///
/// # Errors
/// The error of the operating system, or an error that the path leads to no regular file.
pub fn open(path: &Path) -> io::Result<File> {
    // Without O_NONBLOCK the open of a pipe waits for a writer. Without O_NOCTTY a terminal could
    // become the one that controls this process.
    let flags = libc::O_NONBLOCK | libc::O_NOCTTY;
    let file = File::options().read(true).custom_flags(flags).open(path)?;
    let found = file.metadata()?;
    if !found.is_file() {
        let kind = if found.is_dir() { ErrorKind::IsADirectory } else { ErrorKind::Other };
        return Err(io::Error::new(kind, "not a regular file"));
    }
    Ok(file)
}

/// Opens a regular file and returns it with its text.
///
/// # Errors
/// The errors of [`open`]; the file is not UTF-8, or larger than `most` (bytes).
pub fn open_text(path: &Path, most: u64) -> io::Result<(File, String)> {
    let file = open(path)?;
    let text = of(&file, most)?;
    Ok((file, text))
}

/// Reads a text to its end. Without a byte-order mark it is UTF-8; with one, which is not part of
/// the text, it may be UTF-16 as well.
///
/// # Errors
/// The error of the operating system; the text is in another encoding, or larger than `most`
/// (bytes).
pub fn of(from: impl Read, most: u64) -> io::Result<String> {
    let mut bytes = Vec::new();
    // One byte more than allowed distinguishes a file that is too large from one of the greatest
    // size. The size in the metadata would not do: pipes and devices have none.
    if from.take(most + 1).read_to_end(&mut bytes)? as u64 > most {
        let mib = most >> 20;
        return Err(io::Error::new(ErrorKind::FileTooLarge, format!("larger than {mib} MiB")));
    }
    let utf16 = |unit: fn([u8; 2]) -> u16| {
        let (units, rest) = bytes[2..].as_chunks::<2>();
        let text = String::from_utf16(&units.iter().map(|two| unit(*two)).collect::<Vec<_>>());
        let damaged = "damaged text in UTF-16: save it as UTF-8";
        text.ok().filter(|_| rest.is_empty()).ok_or(io::Error::new(ErrorKind::InvalidData, damaged))
    };
    match &bytes[..] {
        [0xFF, 0xFE, ..] => return utf16(u16::from_le_bytes),
        [0xFE, 0xFF, ..] => return utf16(u16::from_be_bytes),
        [0xEF, 0xBB, 0xBF, ..] => drop(bytes.drain(..3)),
        _ => {}
    }
    String::from_utf8(bytes)
        .map_err(|_| io::Error::new(ErrorKind::InvalidData, "not text in UTF-8: save it as UTF-8"))
}

/// Reads the text of a file or a pipe.
///
/// # Errors
/// [`Unread`]: the error of the operating system; the text is not UTF-8, or larger than `most`
/// (bytes).
pub fn read(path: &Path, most: u64) -> Result<String, Unread> {
    of(open_any(path)?, most).map_err(|why| Unread::new(path, why))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tables::testing::make_pipe;

    #[test]
    fn shortened_text_fits_into_its_columns() {
        for (text, columns, wanted) in [
            ("turn R'", 7, "turn R'"),
            ("turn R'", 6, "turn…"),
            ("turn R'", 4, "tur…"),
            ("turn R'", 1, "…"),
            ("turn R'", 0, ""),
            // Each of these letters takes two columns.
            ("魔方", 4, "魔方"),
            ("魔方", 3, "魔…"),
            ("魔方", 2, "…"),
        ] {
            assert_eq!(shortened(text, columns), wanted, "{text} in {columns}");
        }
    }

    #[test]
    fn deep_keys_are_found_in_every_spelling() {
        let many = |part: &str| vec![part; 30_000].join(".");
        for key in ["a", " a ", "\"a\"", "'='", "\"],\" ", "a.\"=\""] {
            for line in [format!("{} = 1", many(key)), format!("[{}]", many(key))] {
                assert_eq!(deep_line(&format!("x = 1\n{line}\n")), Some(2), "{key}");
            }
        }
        // Evasion by a mixture is bounded by the square of the limit.
        let mixed = format!("{} = 1", many("a.b.c.\"=\""));
        assert!(deep_line(&mixed).is_some());
        let numbers = vec!["1.5"; 1000].join(", ");
        for harmless in [
            "effector.track.gripper.palm_mm = 1.5",
            "# and so on .................................... see 1.2.3.4 and a.b.c",
            &format!("x = [{numbers}]"),
            &format!("# {}", "A sentence of four words. ".repeat(30)),
            "s = \"one. two. three. four. five. six. seven. eight. nine. ten. eleven.\"",
        ] {
            assert_eq!(deep_line(harmless), None, "{harmless}");
        }
    }

    #[test]
    fn printable_spells_out_orders_to_the_terminal() {
        assert_eq!(printable("a\tb\nüß"), "a\tb\nüß");
        assert_eq!(printable("\x1b[2J\r\x07\u{9b}x"), "\\u001b[2J\\u000d\\u0007\\u009bx");
        assert_eq!(printable("\u{202e}x"), "\\u202ex");
        // A line of JSON stays one.
        let line = printable("{\"a\":\"\u{9b}\u{7f}\"}").into_owned();
        let read: serde_json::Value = serde_json::from_str(&line).unwrap();
        assert_eq!(read["a"], "\u{9b}\u{7f}");
    }

    #[test]
    fn quoted_commands_are_those_of_the_program() {
        let text = "`rubik-robot keys` lists them; rubik-robot is a name";
        assert_eq!(with_commands_of("rubik-robot", text), text);
        let other = with_commands_of("own_cell", text);
        assert_eq!(other, "`own_cell keys` lists them; rubik-robot is a name");
    }

    #[test]
    fn words_for_a_shell_are_quoted() {
        assert_eq!(quoted("control.grip_n=26.5"), "control.grip_n=26.5");
        assert_eq!(quoted("plant.cube_kind=\"dry\""), "'plant.cube_kind=\"dry\"'");
        assert_eq!((quoted("it's"), quoted("")), ("'it'\\''s'".into(), "''".into()));
    }

    #[test]
    fn endless_or_too_large_file_is_refused() {
        let folder = std::env::temp_dir().join(format!("rubik-robot-text-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (file, pipe) = (folder.join("file"), folder.join("pipe"));
        let told = |path: &Path| {
            let error = read(path, SCENARIO).unwrap_err().to_string();
            let why = error.strip_prefix(&format!("cannot read {}: ", path.display()));
            why.unwrap_or_else(|| panic!("{error}")).to_owned()
        };
        make_pipe(&pipe);

        for path in [Path::new("/dev/zero"), &pipe] {
            assert_eq!(open(path).unwrap_err().to_string(), "not a regular file");
        }
        assert_eq!(told(Path::new("/dev/zero")), "larger than 1 MiB");
        let writer = std::thread::spawn({
            let pipe = pipe.clone();
            move || std::fs::write(pipe, "text").unwrap()
        });
        assert_eq!(read(&pipe, SCENARIO).unwrap(), "text");
        writer.join().unwrap();
        assert_eq!(told(&folder), "it is a folder");
        assert_eq!(told(Path::new("/nowhere")), "there is no such file");
        std::fs::write(&file, vec![b' '; SCENARIO as usize]).unwrap();
        assert_eq!(read(&file, SCENARIO).unwrap().len() as u64, SCENARIO);
        std::fs::write(&file, vec![b' '; SCENARIO as usize + 1]).unwrap();
        assert_eq!(told(&file), "larger than 1 MiB");
        std::fs::write(&file, b"\xff").unwrap();
        assert_eq!(told(&file), "not text in UTF-8: save it as UTF-8");
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn byte_order_mark_tells_the_encoding() {
        let marked = "\u{feff}edge = 57\n";
        let little: Vec<u8> = marked.encode_utf16().flat_map(u16::to_le_bytes).collect();
        let big: Vec<u8> = marked.encode_utf16().flat_map(u16::to_be_bytes).collect();

        for bytes in [marked.as_bytes(), &marked.as_bytes()[3..], &little, &big] {
            assert_eq!(of(bytes, LIST).unwrap(), "edge = 57\n");
        }
        let odd = of(&little[..little.len() - 1], LIST).unwrap_err().to_string();
        assert_eq!(odd, "damaged text in UTF-16: save it as UTF-8");
    }
}
