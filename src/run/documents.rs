//! Text files that a task has made, written at the end of its run.
//!
//! - in: the documents in the kernel's account
//! - out: new files; their paths as the figure `files` of the summary
//!
//! | fault | reaction |
//! |---|---|
//! | a file has the name | it stays, and the text goes to a free name: `way.toml`, `way-2.toml` |
//! | a file cannot be written | a success becomes a failure with this reason |

use crate::kernel::Document;
use crate::record::summary::{Outcome, Summary};
use std::fs::File;
use std::io::{self, ErrorKind, Write as _};
use std::path::{Path, PathBuf};

/// Most names that are tried.
const NAMES: u32 = 999;

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
        // The exclusive creation neither follows links nor races with other runs.
        match File::options().write(true).create_new(true).open(&path) {
            Ok(mut file) => return file.write_all(document.text.as_bytes()).map(|()| path),
            Err(why) if why.kind() == ErrorKind::AlreadyExists => {}
            Err(why) => return Err(why),
        }
    }
    Err(io::Error::new(ErrorKind::AlreadyExists, "too many files have this name"))
}

/// Returns the path with a number behind the stem of its name; number 1 is the path itself.
fn numbered(path: &Path, number: u32) -> PathBuf {
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
    fn existing_file_stays_and_number_is_added() {
        let folder = Folder::new("documents");
        let path = folder.write("way.toml", "mine");
        let document = Document { path: path.clone(), text: "new".to_owned() };

        let written = [1, 2].map(|_| write_new(&document).unwrap());

        assert_eq!(written, ["way-2.toml", "way-3.toml"].map(|name| folder.0.join(name)));
        assert_eq!(fs::read_to_string(&path).unwrap(), "mine");
        assert_eq!(fs::read_to_string(&written[1]).unwrap(), "new");
    }
}
