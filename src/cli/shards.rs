//! State files of the shards of a campaign: their names in a folder, and their contents.
//!
//! - in: paths of files and folders, as the user gives them
//! - out: the path at which a shard keeps its results; the [`Found`] state files
//!
//! The name of a file has the number of its shard and the number of all shards, so two shards never
//! have the same file, and a task that is started again finds its own.

use super::catalogue;
use super::output::{refuse, warn};
use crate::campaign::state::{Header, Shard, State, Unusable};
use crate::hw::text::{self, Unread};
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Contents of a state file.
pub(super) struct Found {
    /// Path of the file.
    pub path: PathBuf,
    /// Contents of the file.
    pub state: State,
    /// Moment of the last result, or of the last change of a file without results (s since 1970).
    pub changed_unix_s: Option<f64>,
}

/// Returns the file of a shard: the one that `path` names, or that of the shard in the folder that
/// `path` names.
///
/// # Errors
/// `path` names a folder that does not exist.
pub(super) fn place(path: &Path, shard: Shard) -> Result<PathBuf, String> {
    if path.is_dir() {
        return Ok(path.join(name(shard)));
    }
    if path.as_os_str().as_encoded_bytes().ends_with(b"/") {
        return Err(format!("--state: there is no folder {}: make it first", path.display()));
    }
    Ok(path.to_owned())
}

/// Returns the name of a shard's file. All numbers of a campaign have the same width, so that the
/// order of the names is that of the shards.
fn name(shard: Shard) -> String {
    let (number, of) = shard.into();
    let width = of.to_string().len();
    format!("shard-{number:0width$}-of-{of}.jsonl")
}

/// Returns whether a file has the name of a shard.
fn is_shard(name: &str) -> bool {
    let inner = name.strip_prefix("shard-").and_then(|name| name.strip_suffix(".jsonl"));
    let numbers = inner.and_then(|inner| inner.split_once("-of-"));
    numbers.is_some_and(|(number, of)| format!("{number}/{of}").parse::<Shard>().is_ok())
}

/// Returns the files that `paths` name: each folder stands for the files of shards in it, in the
/// order of their names. Each file has a mark: whether it is from a folder.
///
/// # Errors
/// A folder cannot be read, or has no file of a shard.
pub(super) fn files(paths: &[PathBuf]) -> anyhow::Result<Vec<(PathBuf, bool)>> {
    let mut files = Vec::new();
    for path in paths {
        if !path.is_dir() {
            files.push((path.clone(), false));
            continue;
        }
        let unread = |why| refuse(Unread::new(path, why));
        let mut inside = Vec::new();
        for entry in path.read_dir().map_err(unread)? {
            let entry = entry.map_err(unread)?;
            if entry.file_name().to_str().is_some_and(is_shard) {
                inside.push((entry.path(), true));
            }
        }
        if inside.is_empty() {
            let path = path.display();
            return Err(refuse(format!(
                "cannot read {path}: it is a folder without a file shard-K-of-N.jsonl"
            )));
        }
        inside.sort();
        files.extend(inside);
    }
    Ok(files)
}

/// Checks that a campaign is of this program and of one of its tasks.
pub(super) fn check_program(header: &Header) -> Result<(), String> {
    catalogue::program().accepts(header.program.as_ref(), &header.task)
}

/// Reads state files, and reports damaged lines. A file without a header, which a task leaves that
/// is killed at its start, is left out if it is from a folder.
///
/// # Errors
/// A file cannot be used, or no file has a header.
pub(super) fn read(files: &[(PathBuf, bool)]) -> anyhow::Result<Vec<Found>> {
    let mut all = Vec::new();
    for (path, from_folder) in files {
        let shown = path.display();
        let file = text::open_any(path).map_err(refuse)?;
        let changed = file.metadata().ok().and_then(|found| found.modified().ok());
        let state = match State::read(BufReader::new(file)) {
            Err(Unusable::Empty) if *from_folder => {
                warn(&format!("{shown}: is empty and is left out"));
                continue;
            }
            read => read.map_err(|why| refuse(format!("{shown}: {why}")))?,
        };
        check_program(&state.header).map_err(|why| refuse(format!("{shown}: {why}")))?;
        if state.damaged > 0 {
            let lines = state.damaged;
            warn(&format!("{shown}: {lines} damaged lines are left out, their runs are missing"));
        }
        let since = |time: SystemTime| time.duration_since(SystemTime::UNIX_EPOCH).ok();
        let changed = changed.and_then(since).map(|time| time.as_secs_f64());
        let last = state.results.values().filter_map(|run| run.ended_unix_s).reduce(f64::max);
        all.push(Found { path: path.clone(), state, changed_unix_s: last.or(changed) });
    }
    if all.is_empty() {
        return Err(refuse("no file has the results of a campaign"));
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_shards_are_sorted_and_recognised() {
        let shard = |text: &str| text.parse::<Shard>().unwrap();
        assert_eq!(name(shard("2/8")), "shard-2-of-8.jsonl");
        let names: Vec<_> = (1..=100).map(|k| name(shard(&format!("{k}/100")))).collect();
        assert_eq!(names[1], "shard-002-of-100.jsonl");
        assert!(names.is_sorted() && names.iter().all(|name| is_shard(name)));
        for other in ["shard-9-of-8.jsonl", "shard-1-of-8.jsonl.part", "report.jsonl", "shard-of-"]
        {
            assert!(!is_shard(other), "{other}");
        }
    }

    #[test]
    fn place_is_file_or_shard_in_folder() {
        let shard = "2/8".parse().unwrap();
        let folder = std::env::temp_dir();
        assert_eq!(place(&folder, shard).unwrap(), folder.join("shard-2-of-8.jsonl"));
        assert_eq!(place(Path::new("new.jsonl"), shard).unwrap(), Path::new("new.jsonl"));
        let why = place(Path::new("no/such/"), shard).unwrap_err();
        assert!(why.contains("there is no folder no/such/: make it first"), "{why}");
    }
}
