//! Text files that a task has made, written at the end of its run.
//!
//! - in: the documents in the kernel's account
//! - out: new files; their paths as the figure `files` of the summary
//!
//! | fault | reaction |
//! |---|---|
//! | a file has the name | it stays, and the text goes to a free name: `way.toml`, `way-2.toml` |
//! | a file cannot be written | a success becomes a failure with this reason |
//! | a full disk or a kill | no file has the name; a former file stays as it is |

use crate::hw::new_file;
use crate::kernel::Document;
use crate::record::summary::{Outcome, Summary};
use std::io::{self, ErrorKind, Write as _};
use std::path::{Path, PathBuf};

/// Most names that are tried.
const NAMES: u32 = 999;
/// Ending of a file until all of its content is on the disk.
const PART: &str = ".part";

/// Writes the documents, and puts their paths into the summary. A file that cannot be written
/// makes a solved task a failed one.
pub(super) fn write(documents: &[Document], summary: &mut Summary) {
    let mut files = Vec::new();
    for document in documents {
        match write_new(document) {
            Ok(path) => {
                tracing::info!("written: {}", path.display());
                files.push(path.display().to_string());
            }
            Err(why) => {
                let reason = format!("{} could not be written: {why}", document.path.display());
                tracing::warn!("{reason}");
                if summary.outcome == Outcome::Solved {
                    (summary.outcome, summary.reason) = (Outcome::Failed, reason);
                }
            }
        }
    }
    if !files.is_empty() {
        summary.figures.insert("files".to_owned(), files.into());
    }
}

/// Writes a document to the first free name, and returns this name.
fn write_new(document: &Document) -> io::Result<PathBuf> {
    for number in 1..=NAMES {
        let path = numbered(&document.path, number);
        match new_file::write_new(&path, PART, |file| file.write_all(document.text.as_bytes())) {
            Ok(()) => return Ok(path),
            // The name is taken, or another run is writing it.
            Err(why)
                if matches!(why.kind(), ErrorKind::AlreadyExists | ErrorKind::ResourceBusy) => {}
            Err(why) => return Err(why),
        }
    }
    Err(io::Error::new(ErrorKind::AlreadyExists, "too many files have this name"))
}

/// Returns the path with a number behind the stem of its name; number 1 is the path itself.
pub(crate) fn numbered(path: &Path, number: u32) -> PathBuf {
    if number == 1 {
        return path.to_owned();
    }
    let mut name = path.file_stem().unwrap_or_default().to_os_string();
    name.push(format!("-{number}"));
    if let Some(ending) = path.extension() {
        name.push(".");
        name.push(ending);
    }
    path.with_file_name(name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tables::testing::Folder;
    use std::fs;

    #[test]
    fn number_stands_before_the_extension() {
        for (path, next) in [
            ("run.mcap", "run-2.mcap"),
            ("a.b/run", "a.b/run-2"),
            ("/x/cell.run.mcap", "/x/cell.run-2.mcap"),
        ] {
            assert_eq!(numbered(Path::new(path), 2), Path::new(next));
        }
    }

    #[test]
    fn existing_file_stays_and_number_is_added() {
        let folder = Folder::new("documents");
        let path = folder.write("way.toml", "mine");
        let document = Document { path: path.clone(), text: "new".to_owned() };

        let written = [1, 2].map(|_| write_new(&document).unwrap());

        assert_eq!(written, ["way-2.toml", "way-3.toml"].map(|name| folder.0.join(name)));
        assert_eq!(fs::read_to_string(&path).unwrap(), "mine");
        assert_eq!(fs::read_to_string(&written[1]).unwrap(), "new");
    }

    /// Another run has its file open under the temporary name.
    #[test]
    fn name_that_another_run_writes_is_passed_over() {
        let folder = Folder::new("documents-busy");
        let path = folder.0.join("way.toml");
        let other = new_file::create(&new_file::beside(&path, PART)).unwrap();
        let document = Document { path: path.clone(), text: "new".to_owned() };

        assert_eq!(write_new(&document).unwrap(), folder.0.join("way-2.toml"));
        assert!(!path.exists());
        // A killed run leaves its temporary file without a lock.
        drop(other);
        assert_eq!(write_new(&document).unwrap(), path);
        assert_eq!(fs::read_dir(&folder.0).unwrap().count(), 2);
    }
}
