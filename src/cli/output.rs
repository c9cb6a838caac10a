//! Output of a command: stdout, stderr and files.
//!
//! - a closed pipe is a success: `rubik-robot keys | head -1` ends without an error
//! - a file is written beside its final path and renamed when it is complete
//! - a command never writes to a file that it reads, nor two outputs to one file

use crate::hw::console::{self, Tone};
use crate::hw::image_file::Unreadable;
use crate::hw::text::{Unread, printable};
use crate::record::place::Place;
use anyhow::Context as _;
use image::{ImageFormat, RgbImage};
use std::fmt;
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};

/// Exit code of a wrong call or scenario.
pub(super) const WRONG: u8 = 2;

/// Error of a wrong call or scenario: `main` prints the reason and exits with [`WRONG`].
#[derive(Debug)]
pub(super) struct Refused(String);

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Refused {}

/// Returns the error line about one of several input files: its name and the reason. The error of a
/// file that cannot be read names the file already.
pub(super) fn line_about(name: &str, reason: &anyhow::Error) -> String {
    if code_of(reason) == WRONG { format!("{reason:#}") } else { format!("{name}: {reason:#}") }
}

/// Returns the exit code for an input without a result: [`WRONG`] if its file cannot be read, 1 if
/// it was read, but gives no result.
pub(super) fn code_of(reason: &anyhow::Error) -> u8 {
    if reason.is::<Unread>() || reason.is::<Unreadable>() { WRONG } else { 1 }
}

/// Makes the error of a wrong call or scenario, see [`Refused`].
pub(super) fn refuse(reason: impl fmt::Display) -> anyhow::Error {
    anyhow::Error::new(Refused(reason.to_string()))
}

/// Prints a line of progress or information to stderr, see [`console::line`].
pub(super) fn inform(text: &str) {
    console::line(Tone::Plain, text);
}

/// Prints a warning to stderr, see [`console::line`].
pub(super) fn warn(text: &str) {
    console::line(Tone::Warning, text);
}

/// Prints an error to stderr, see [`console::line`].
pub(super) fn complain(text: &str) {
    console::line(Tone::Error, text);
}

/// Writes a file. An existing file of that name is replaced only when the new one is complete.
///
/// # Errors
/// Error of the operating system, with the file's name. The existing file stays as it is.
pub(crate) fn save(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let write = || -> io::Result<()> {
        let (mut file, mut place) = Place::create(path)?;
        let written = file.write_all(bytes).and_then(|()| place.sync());
        if let Err(why) = written.and_then(|()| place.rename_to_final()) {
            // An incomplete file is of no use.
            let _ = place.discard();
            return Err(why);
        }
        Ok(())
    };
    write().with_context(|| path.display().to_string())
}

/// Writes a picture as a PNG file, like [`save`].
///
/// # Errors
/// As [`save`]; error of the encoder, with the file's name.
pub(crate) fn save_picture(path: &Path, picture: &RgbImage) -> anyhow::Result<()> {
    let mut png = io::Cursor::new(Vec::new());
    picture.write_to(&mut png, ImageFormat::Png).with_context(|| path.display().to_string())?;
    save(path, png.get_ref())
}

/// File of a command: its role in words, and its path if one is given.
pub(crate) type Named<'a> = (&'a str, Option<&'a PathBuf>);

/// Checks that no output of a command is one of its inputs or another output.
///
/// # Errors
/// [`Refused`] with the two files that clash.
pub(super) fn clash(inputs: &[Named<'_>], outputs: &[Named<'_>]) -> anyhow::Result<()> {
    first_clash(inputs, outputs).map_or(Ok(()), |reason| Err(refuse(reason)))
}

/// Returns an error text for the first output that is an input or another output.
fn first_clash(inputs: &[Named<'_>], outputs: &[Named<'_>]) -> Option<String> {
    for (i, (what, path)) in outputs.iter().enumerate() {
        let Some(path) = path else { continue };
        // An output is written to a temporary path first, see `Place`.
        let part = Place::part_of(path);
        let same = |(_, other): &&Named<'_>| {
            other.is_some_and(|other| is_same(path, other) || is_same(&part, other))
        };
        if let Some((input, _)) = inputs.iter().find(same) {
            let path = path.display();
            return Some(format!(
                "{what}: {path} is {input} and would be overwritten: name another file"
            ));
        }
        if let Some((other, _)) = outputs[..i].iter().find(same) {
            let path = path.display();
            return Some(format!(
                "{what}: {path} is {other} as well: name a file of its own for each"
            ));
        }
    }
    None
}

/// Checks whether two paths lead to the same file, which need not exist yet. A device or a pipe is
/// no file: several outputs may go to it.
fn is_same(one: &Path, other: &Path) -> bool {
    use std::os::unix::fs::MetadataExt as _;
    // Hard links have different paths but one inode.
    if let (Ok(one), Ok(other)) = (std::fs::metadata(one), std::fs::metadata(other)) {
        return one.is_file() && (one.dev(), one.ino()) == (other.dev(), other.ino());
    }
    // A file that does not exist yet has no canonical path, but its folder has one.
    let whole = |path: &Path| {
        path.canonicalize().ok().or_else(|| {
            let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
            let folder = folder.unwrap_or(Path::new(".")).canonicalize().ok()?;
            Some(folder.join(path.file_name()?))
        })
    };
    whole(one).is_some_and(|one| whole(other) == Some(one))
}

/// Reads the next line of a stream into `line`, without its line break. Keeps the first `most`
/// bytes of a longer line and skips its other bytes. Returns whether all bytes of the line were
/// kept, or `None` at the end of the stream.
///
/// # Errors
/// Error of reading.
pub(crate) fn next_line(
    from: &mut impl io::BufRead,
    most: usize,
    line: &mut Vec<u8>,
) -> io::Result<Option<bool>> {
    line.clear();
    let (mut begun, mut whole) = (false, true);
    loop {
        let bytes = match from.fill_buf() {
            Err(why) if why.kind() == ErrorKind::Interrupted => continue,
            bytes => bytes?,
        };
        if bytes.is_empty() {
            return Ok(begun.then_some(whole));
        }
        begun = true;
        let end = bytes.iter().position(|byte| *byte == b'\n');
        let part = &bytes[..end.unwrap_or(bytes.len())];
        // The memory for a line is bounded, however long the line is.
        let room = most - line.len();
        whole &= part.len() <= room;
        line.extend_from_slice(&part[..part.len().min(room)]);
        let used = part.len() + usize::from(end.is_some());
        from.consume(used);
        if end.is_some() {
            return Ok(Some(whole));
        }
    }
}

/// Writer of results.
#[derive(Debug)]
pub(crate) struct Output<W: Write = io::Stdout> {
    to: BufWriter<W>,
    /// Whether the reader has closed the pipe.
    closed: bool,
}

impl Output {
    /// Returns a writer to stdout.
    #[must_use]
    pub(crate) fn stdout() -> Self {
        Self::new(io::stdout())
    }
}

impl<W: Write> Output<W> {
    /// Returns a writer to `to`.
    pub(crate) fn new(to: W) -> Self {
        Self { to: BufWriter::new(to), closed: false }
    }

    /// Writes a line. Control characters of other people's texts are spelled out.
    ///
    /// # Errors
    /// Error of the device, except a closed pipe.
    pub(crate) fn line(&mut self, text: &str) -> anyhow::Result<()> {
        let written = writeln!(self.to, "{}", printable(text));
        self.take(written)
    }

    /// Writes text, and adds no line break. Control characters are spelled out, except line breaks
    /// and tabs.
    ///
    /// # Errors
    /// As [`Output::line`].
    pub(crate) fn text(&mut self, text: &str) -> anyhow::Result<()> {
        let written = self.to.write_all(printable(text).as_bytes());
        self.take(written)
    }

    /// Writes text that may have colours, and adds no line break. The caller has spelled out all
    /// other control characters.
    ///
    /// # Errors
    /// As [`Output::line`].
    pub(crate) fn coloured(&mut self, text: &str) -> anyhow::Result<()> {
        let written = self.to.write_all(text.as_bytes());
        self.take(written)
    }

    /// Calls `writer` with the buffered stream, to which it writes bytes as they are.
    ///
    /// # Errors
    /// As [`Output::line`].
    pub(crate) fn write(
        &mut self,
        writer: impl FnOnce(&mut BufWriter<W>) -> io::Result<()>,
    ) -> anyhow::Result<()> {
        let written = writer(&mut self.to);
        self.take(written)
    }

    /// Writes the buffered bytes.
    ///
    /// # Errors
    /// As [`Output::line`].
    pub(crate) fn flush(&mut self) -> anyhow::Result<()> {
        let flushed = if self.closed { Ok(()) } else { self.to.flush() };
        self.take(flushed)
    }

    /// Returns whether the reader has closed the pipe.
    #[must_use]
    pub(crate) fn is_closed(&self) -> bool {
        self.closed
    }

    /// Passes on the result of a write. A closed pipe counts as a success, and is remembered for
    /// [`Output::is_closed`].
    fn take(&mut self, result: io::Result<()>) -> anyhow::Result<()> {
        match result {
            Err(error) if error.kind() == ErrorKind::BrokenPipe => {
                self.closed = true;
                Ok(())
            }
            other => Ok(other?),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Writer to a pipe that its reader has closed.
    struct Broken;
    impl Write for Broken {
        fn write(&mut self, _: &[u8]) -> io::Result<usize> {
            Err(ErrorKind::BrokenPipe.into())
        }
        fn flush(&mut self) -> io::Result<()> {
            Err(ErrorKind::BrokenPipe.into())
        }
    }

    #[test]
    fn closed_pipe_is_no_error() {
        let mut output = Output::new(Broken);

        output.line("text").unwrap();
        output.flush().unwrap();

        assert!(output.is_closed());
    }

    #[test]
    fn output_spells_out_terminal_escape_sequences() {
        let mut output = Output::new(Vec::new());

        output.line("name \x1b]0;x\x07").unwrap();
        output.text("a\x1bc\n").unwrap();
        output.flush().unwrap();

        let written = output.to.into_inner().unwrap();
        assert_eq!(String::from_utf8(written).unwrap(), "name \\u001b]0;x\\u0007\na\\u001bc\n");
    }

    #[test]
    fn failed_save_keeps_the_existing_file() {
        let folder = std::env::temp_dir().join(format!("rubik-robot-save-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("report.html");
        save(&path, b"old").unwrap();
        // A folder at the path of the temporary file makes the write fail, as a full disk would.
        std::fs::create_dir(folder.join("report.html.part")).unwrap();

        assert!(format!("{:#}", save(&path, b"new").unwrap_err()).contains("report.html: "));

        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        std::fs::remove_dir(folder.join("report.html.part")).unwrap();
        save(&path, b"new").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        // A device without space.
        assert!(save(Path::new("/dev/full"), b"new").is_err());
        save(Path::new("/dev/null"), b"new").unwrap();
        std::fs::remove_dir_all(folder).unwrap();
    }

    /// Checks two paths to one file, symbolic and hard links, and files that do not exist yet. A
    /// device may take several outputs.
    #[test]
    fn output_path_aliasing_another_file_is_refused() {
        let folder = std::env::temp_dir().join(format!("rubik-robot-clash-{}", std::process::id()));
        std::fs::create_dir_all(folder.join("sub")).unwrap();
        let there = folder.join("s.toml");
        std::fs::write(&there, "").unwrap();
        std::os::unix::fs::symlink(&there, folder.join("link")).unwrap();
        std::fs::hard_link(&there, folder.join("hard")).unwrap();
        let (whole, part) = (folder.join("z.mcap"), folder.join("z.mcap.part"));
        std::fs::write(&part, "").unwrap();
        let why = first_clash(&[("the recording", Some(&part))], &[("-o", Some(&whole))]);
        assert!(why.unwrap().contains("is the recording"));
        for name in ["s.toml", "sub/../s.toml", "link", "hard"] {
            let path = folder.join(name);
            let why = first_clash(&[("the scenario", Some(&there))], &[("-o", Some(&path))]);
            assert!(why.unwrap().contains("is the scenario"), "{name}");
        }
        let (new, again) = (folder.join("new"), folder.join("sub/../new"));
        let why = first_clash(&[], &[("--world", Some(&new)), ("--record", Some(&again))]).unwrap();
        assert!(why.starts_with("--record: ") && why.contains("is --world as well"), "{why}");
        assert_eq!(first_clash(&[("s", Some(&there))], &[("-o", Some(&new)), ("-p", None)]), None);
        let null = PathBuf::from("/dev/null");
        assert_eq!(first_clash(&[], &[("--world", Some(&null)), ("--record", Some(&null))]), None);
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn next_line_skips_the_rest_of_long_lines() {
        let text = b"ab\n\nabcd\nabcde\nx";
        for buffer in [1, 3, 100] {
            let mut from = io::BufReader::with_capacity(buffer, text.as_slice());
            let (mut line, mut found) = (Vec::new(), Vec::new());
            while let Some(whole) = next_line(&mut from, 4, &mut line).unwrap() {
                found.push((String::from_utf8(line.clone()).unwrap(), whole));
            }
            let expected = [("ab", true), ("", true), ("abcd", true), ("abcd", false), ("x", true)];
            assert_eq!(found, expected.map(|(text, whole)| (text.to_owned(), whole)));
        }
    }
}
