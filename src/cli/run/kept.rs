//! Files of a run with a page that no option names: recording, saved plant and journal. With them
//! the operator replays the run, writes its report, and goes on after a stop.
//!
//! - in: the user's folder of states
//! - out: a folder of the run's own, with a name for each of these files
//!
//! The folders lie in the user's folder of states. Only the latest few stay.

use crate::cli::output::warn;
use crate::cli::record::states_folder;
use std::fs::{DirBuilder, File};
use std::io;
use std::os::unix::fs::DirBuilderExt as _;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// Number of folders that stay; older ones are removed.
const KEPT: usize = 5;
/// Beginning of the names of the folders.
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
    /// Creates the folder of a new run and removes the oldest ones. If it cannot, it says so and
    /// returns `None`: a run needs no such files.
    pub(super) fn begin() -> Option<Self> {
        Self::begin_in(&states_folder()?)
            .map_err(|why| warn(&format!("this run keeps no files for its page: {why}")))
            .ok()
    }

    /// Creates the folder of a new run among those in `states`.
    fn begin_in(states: &Path) -> io::Result<Self> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_millis();
        let folder = states.join(format!("{NAME}{now:013}-{}", std::process::id()));
        DirBuilder::new().recursive(true).mode(0o700).create(&folder)?;
        let lock = File::create(folder.join(LOCK))?;
        lock.try_lock()?;
        remove_oldest(states, &folder);
        Ok(Self { folder, _lock: lock })
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
}

/// Removes the oldest folders of runs from `states`, except the last [`KEPT`] and those whose
/// program still runs. A folder that cannot be removed stays.
fn remove_oldest(states: &Path, newest: &Path) {
    let Ok(entries) = std::fs::read_dir(states) else { return };
    let own = |path: &PathBuf| {
        let name = path.file_name().and_then(|name| name.to_str());
        path != newest && path.is_dir() && name.is_some_and(|name| name.starts_with(NAME))
    };
    let mut folders: Vec<_> = entries.flatten().map(|entry| entry.path()).filter(own).collect();
    folders.sort();
    for old in folders.iter().rev().skip(KEPT - 1) {
        // A folder without a lock is one whose creation was cut short.
        let free = File::open(old.join(LOCK)).map_or(true, |lock| lock.try_lock().is_ok());
        if let Err(why) = if free { std::fs::remove_dir_all(old) } else { Ok(()) } {
            warn(&format!("{}: this old folder cannot be removed: {why}", old.display()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn oldest_folders_go_except_locked_ones() {
        let states = std::env::temp_dir().join(format!("kept-runs-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&states);
        let old: Vec<_> = (0..7).map(|i| states.join(format!("{NAME}{i:013}-1"))).collect();
        for folder in &old {
            std::fs::create_dir_all(folder).unwrap();
            File::create(folder.join(LOCK)).unwrap();
        }
        std::fs::write(states.join("last-second-1.mcap"), "").unwrap();
        let used = File::open(old[1].join(LOCK)).unwrap();
        used.lock().unwrap();

        let new = KeptRun::begin_in(&states).unwrap();

        let stay = old.iter().map(|folder| folder.exists()).collect::<Vec<_>>();
        assert_eq!(stay, [false, true, false, true, true, true, true]);
        assert!(new.folder.is_dir() && states.join("last-second-1.mcap").exists());
        drop(used);
        std::fs::remove_dir_all(&states).unwrap();
    }
}
