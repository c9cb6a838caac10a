//! Files of a run with a page that no option names: recording, saved plant and journal. With them
//! the operator replays the run, writes its report, and goes on after a stop.
//!
//! - in: the user's folder of states
//! - out: a folder of the run's own, with a name for each of these files
//!
//! | folder | how long it stays |
//! |---|---|
//! | of a run without a recording | until its program drops it |
//! | of a run that goes on in a program | until the program ends |
//! | of an interrupted run on hardware | until the user removes it: its journal has the grips |
//! | any other | while it is one of the latest five; a run with a recording removes others |

use crate::cli::output::warn;
use crate::cli::record::states_folder;
use crate::record::journal::Journal;
use std::fs::{DirBuilder, File};
use std::io::{self, ErrorKind};
use std::os::unix::fs::DirBuilderExt as _;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// Number of folders that stay; older ones are removed.
const KEPT: usize = 5;
/// Beginning of the names of the folders; the time (ms, 13 digits) and the number of the process
/// follow.
const NAME: &str = "run-";
/// Name of the file that the program of a run locks, so that no other program removes the folder.
const LOCK: &str = "lock";

/// Folder of a run; no other program removes it before this value is dropped.
#[derive(Debug)]
pub(super) struct KeptRun {
    folder: PathBuf,
    _lock: File,
}

impl KeptRun {
    /// Creates the folder of a new run. If it cannot, it warns the operator and returns `None`: a
    /// run does not need the folder.
    pub(super) fn begin() -> Option<Self> {
        let begun = match states_folder() {
            Some(states) => Self::begin_in(&states),
            None => Err(io::Error::other("neither HOME nor XDG_STATE_HOME is set")),
        };
        begun.map_err(|why| warn(&format!("this run keeps no files for its page: {why}"))).ok()
    }

    /// Creates the folder of a new run among those in `states`.
    fn begin_in(states: &Path) -> io::Result<Self> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_millis();
        let folder = states.join(format!("{NAME}{now:013}-{}", std::process::id()));
        DirBuilder::new().recursive(true).mode(0o700).create(&folder)?;
        let locked = File::create(folder.join(LOCK)).and_then(|lock| {
            lock.try_lock()?;
            Ok(lock)
        });
        match locked {
            Ok(lock) => Ok(Self { folder, _lock: lock }),
            Err(why) => {
                // The folder is still empty.
                let _ = std::fs::remove_dir_all(&folder);
                Err(why)
            }
        }
    }

    /// Returns the path of the recording.
    pub(super) fn recording(&self) -> PathBuf {
        self.folder.join("run.mcap")
    }

    /// Returns the path of the saved plant.
    pub(super) fn world(&self) -> PathBuf {
        self.folder.join("world.json")
    }

    /// Returns the path of the journal of a run on hardware. Elsewhere the journal lies beside the
    /// saved plant.
    pub(super) fn journal(&self) -> PathBuf {
        self.folder.join("journal")
    }

    /// Removes the oldest folders of other runs, if this run has left a recording: a run that could
    /// not begin costs no earlier one its place.
    pub(super) fn remove_older(&self) {
        if let (Some(states), true) = (self.folder.parent(), self.has_recording()) {
            remove_oldest(states, &self.folder);
        }
    }

    fn has_recording(&self) -> bool {
        holds(&self.folder, |name| Path::new(name).extension().is_some_and(|end| end == "mcap"))
    }
}

impl Drop for KeptRun {
    /// Removes the folder of a run that has left neither a recording nor a journal of its work.
    fn drop(&mut self) {
        if !self.has_recording() && !holds(&self.folder, |name| name.ends_with("journal")) {
            let _ = std::fs::remove_dir_all(&self.folder);
        }
    }
}

/// Returns whether a folder has a file whose name passes `test`.
fn holds(folder: &Path, test: impl Fn(&str) -> bool) -> bool {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.map(|entry| entry.file_name()).any(|name| name.to_str().is_some_and(&test))
}

/// Returns whether a name is that of a folder of a run.
fn is_name(name: &str) -> bool {
    let number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let parts = name.strip_prefix(NAME).and_then(|rest| rest.split_once('-'));
    parts.is_some_and(|(time, process)| time.len() == 13 && number(time) && number(process))
}

/// Removes the oldest folders of runs from `states`, except the last [`KEPT`], those whose program
/// still runs, and those of interrupted runs on hardware. A folder that cannot be removed stays.
fn remove_oldest(states: &Path, newest: &Path) {
    let Ok(entries) = std::fs::read_dir(states) else { return };
    let old = |path: &PathBuf| {
        let name = path.file_name().and_then(|name| name.to_str());
        path != newest && path.is_dir() && name.is_some_and(is_name)
    };
    let mut folders: Vec<_> = entries.flatten().map(|entry| entry.path()).filter(old).collect();
    folders.sort();
    for old in folders.iter().rev().skip(KEPT - 1) {
        // The lock is held until the folder is gone. A folder without the file is the rest of one
        // that was removed in part.
        let lock = File::open(old.join(LOCK));
        let free = match &lock {
            Ok(lock) => lock.try_lock().is_ok(),
            Err(why) => why.kind() == ErrorKind::NotFound,
        };
        if !free || Journal::interrupted(&old.join("journal")).is_some() {
            continue;
        }
        match std::fs::remove_dir_all(old) {
            // If the folder is gone, a run that ended at the same time has removed it.
            Err(why) if why.kind() != ErrorKind::NotFound => {
                warn(&format!("{}: this old folder cannot be removed: {why}", old.display()));
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns an empty folder of states with this name.
    fn states(name: &str) -> PathBuf {
        let states = std::env::temp_dir().join(format!("kept-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&states);
        states
    }

    #[test]
    fn oldest_folders_go_except_locked_ones() {
        let states = states("oldest");
        let old: Vec<_> = (0..7).map(|i| states.join(format!("{NAME}{i:013}-1"))).collect();
        // A folder that the user named.
        let demo = states.join("run-2026-demo");
        for folder in old.iter().chain([&demo]) {
            std::fs::create_dir_all(folder).unwrap();
            File::create(folder.join(LOCK)).unwrap();
        }
        std::fs::write(states.join("last-second-1.mcap"), "").unwrap();
        let used = File::open(old[1].join(LOCK)).unwrap();
        used.lock().unwrap();
        let stay = || old.iter().map(|folder| folder.exists()).collect::<Vec<_>>();

        let new = KeptRun::begin_in(&states).unwrap();
        new.remove_older();
        assert_eq!(stay(), [true; 7], "a run without a recording removes none");
        std::fs::write(new.recording(), "").unwrap();
        new.remove_older();

        assert_eq!(stay(), [false, true, false, true, true, true, true]);
        assert!(demo.exists() && states.join("last-second-1.mcap").exists());
        drop((used, new));
        std::fs::remove_dir_all(&states).unwrap();
    }

    #[test]
    fn folder_without_recording_goes_with_its_run() {
        let states = states("empty");

        let [failed, recorded] = ["failed", "recorded"].map(|name| {
            let run = KeptRun::begin_in(&states.join(name)).unwrap();
            if name == "recorded" {
                std::fs::write(run.recording(), "").unwrap();
            }
            run.folder.clone()
        });

        assert!(!failed.exists() && recorded.exists());
        std::fs::remove_dir_all(&states).unwrap();
    }
}
