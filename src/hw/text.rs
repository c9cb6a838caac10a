//! Text files whose paths come from a user, read up to a greatest size.
//!
//! - in: a path and the greatest size
//! - out: the text of the file
//! - [`read`] takes pipes as well, and refuses a file without end when the greatest size is reached
//! - [`open`] takes regular files only, so it never waits

use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;

/// Greatest size of a scenario and of the files beside it (bytes).
pub const SCENARIO: u64 = 1 << 20;
/// Greatest size of a list of pictures or cubes (bytes).
pub const LIST: u64 = 64 << 20;

/// Opens a regular file.
///
/// # Errors
/// The error of the operating system, or that the path is no regular file.
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
/// The error of the operating system; the text is not UTF-8, or larger than `most` (bytes).
pub fn read(path: &Path, most: u64) -> io::Result<String> {
    of(File::open(path)?, most)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endless_or_too_large_file_is_refused() {
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
