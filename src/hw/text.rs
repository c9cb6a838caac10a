//! Files that somebody names: text, no larger than anything that could be meant.
//!
//! - in: a path, and how much may be in it
//! - out: its text, of a pipe, too; what has no end is refused when that much has come. Where a program names the file and nobody
//!   waits, only a regular one is opened

use std::fs::File;
use std::io::{self, ErrorKind, Read as _};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;

/// No scenario, nor what stands beside one, is larger (bytes).
pub const SCENARIO: u64 = 1 << 20;
/// No list of many pictures or cubes is larger (bytes).
pub const LIST: u64 = 64 << 20;

/// Opens a regular file.
///
/// # Errors
/// What the operating system says; it is something else than a file.
pub fn open(path: &Path) -> io::Result<File> {
    // Opened as others are, a pipe without a writer waits for one.
    let flags = libc::O_NONBLOCK | libc::O_NOCTTY;
    let file = File::options().read(true).custom_flags(flags).open(path)?;
    let found = file.metadata()?;
    if !found.is_file() {
        let kind = if found.is_dir() { ErrorKind::IsADirectory } else { ErrorKind::Other };
        return Err(io::Error::new(kind, "not a regular file"));
    }
    Ok(file)
}

/// A file that is open, and its text.
///
/// # Errors
/// As [`open`]; it is no text in UTF-8, or larger than `most` bytes.
pub fn open_text(path: &Path, most: u64) -> io::Result<(File, String)> {
    let file = open(path)?;
    let text = text_of(&file, most)?;
    Ok((file, text))
}

fn text_of(file: &File, most: u64) -> io::Result<String> {
    let mut bytes = Vec::new();
    if file.take(most + 1).read_to_end(&mut bytes)? as u64 > most {
        let mib = most >> 20;
        return Err(io::Error::new(ErrorKind::FileTooLarge, format!("larger than {mib} MiB")));
    }
    String::from_utf8(bytes)
        .map_err(|_| io::Error::new(ErrorKind::InvalidData, "not text in UTF-8"))
}

/// The text of a file or a pipe.
///
/// # Errors
/// What the operating system says; it is no text in UTF-8, or larger than `most` bytes.
pub fn read(path: &Path, most: u64) -> io::Result<String> {
    text_of(&File::open(path)?, most)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_no_end_or_is_too_large_is_refused_at_once() {
        let folder = std::env::temp_dir().join(format!("rubik-robot-text-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (file, pipe) = (folder.join("file"), folder.join("pipe"));
        let told = |path: &Path| read(path, SCENARIO).unwrap_err().to_string();
        let made = std::process::Command::new("mkfifo").arg(&pipe).status().unwrap();
        assert!(made.success());

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
        assert_eq!(read(&folder, SCENARIO).unwrap_err().kind(), ErrorKind::IsADirectory);
        std::fs::write(&file, vec![b' '; SCENARIO as usize]).unwrap();
        assert_eq!(read(&file, SCENARIO).unwrap().len() as u64, SCENARIO);
        std::fs::write(&file, vec![b' '; SCENARIO as usize + 1]).unwrap();
        assert_eq!(told(&file), "larger than 1 MiB");
        std::fs::write(&file, b"\xff").unwrap();
        assert_eq!(told(&file), "not text in UTF-8");
        std::fs::remove_dir_all(folder).unwrap();
    }
}
