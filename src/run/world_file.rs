//! State of the simulated plant in a file, from which another run can resume.
//!
//! - in: the file's name; the plant after each period
//! - out: a plant that continues where another run's plant ended; a file that is always whole and
//!   at most a tenth of a second old
//!
//! A state that can no longer be updated is removed, because a resumed run would take it for the
//! truth.
//!
//! One run alone writes the file. The lock is on a second file, `.lock`, since the state itself is
//! replaced at each write. The lock file is never removed: another run may have locked it
//! meanwhile. The system releases the lock however a run ends.

use super::failure::not_created;
use crate::actors::notice::Notice;
use crate::actors::trace::Trace;
use crate::error::Error;
use crate::hw::new_file::{self, Sync};
use crate::hw::plant::Plant;
use crate::hw::plant::saved::{Saved, Unfit};
use crate::hw::storage::Storage;
use crate::motion::PERIOD;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// Interval between two written states (servo periods).
///
/// If the process is killed, no written state is lost. A real power cut of the machine that
/// simulates, which is not the simulated power cut of the robot, may lose some:
///
/// - Under virtual time each state is synced to the disk before it takes the file's name. A mission
///   with 6600 states took 12.9 s, and 11.9 s without syncs. The name of the first state is durable
///   before the run begins, the name of each later one when the next state is written. So a power
///   cut may lose the last two tenths of a second of simulated time. On a slow disk the syncs take
///   longer than the mission, so a state that no option asked for is not synced.
/// - Under the wall clock nothing is synced: the servo's thread cannot wait for a disk, which may
///   take several periods. A power cut may lose the seconds that the system has not written yet,
///   and leave an old state, or a truncated one that is refused.
const KEPT_EVERY: u64 = 50;

/// File in which a plant keeps its state.
pub(super) struct Kept {
    path: PathBuf,
    /// Whether each state is synced to the disk.
    synced: bool,
    /// Trace to which the loss of the file is reported.
    trace: Trace,
    /// Whether a write has failed. No further one is tried then.
    lost: bool,
    /// Storage of the file, in which faults can be injected.
    storage: Storage,
    /// Lock file, which stays locked as long as this lives.
    _lock: File,
}

impl Kept {
    /// Locks a file of the plant's state for this run alone, whether the file exists yet or not.
    /// `synced` says whether each state is synced to the disk.
    ///
    /// # Errors
    /// If it is not a regular file, or another run has claimed it.
    pub(super) fn claim(path: &Path, synced: bool, trace: Trace) -> Result<Self, Error> {
        let path = &new_file::resolve(path).map_err(|why| refused(path, &why.into()))?;
        let beside = new_file::beside(path, ".lock");
        let check_kind = |file: &Path| {
            // Opening a device or a pipe may have side effects, or block.
            if std::fs::metadata(file).is_ok_and(|found| !found.is_file()) {
                return Err(refused(file, &Unfit::NoFile));
            }
            Ok(())
        };
        check_kind(path)?;
        check_kind(&beside)?;
        // The lock file is not truncated, because it may belong to another run.
        let lock = new_file::open_or_create(&beside);
        let lock = lock.map_err(|why| refused(&beside, &why.into()))?;
        if !new_file::lock_for_writing(&lock, &beside) {
            return Err(refused(path, &Unfit::Taken));
        }
        let storage = Storage::default();
        Ok(Self { path: path.to_owned(), synced, trace, lost: false, storage, _lock: lock })
    }

    /// Returns `plant` as it is, or if `resume` in the state that the interrupted run left in the
    /// file. `begun` is whether the journal has entries of that run.
    ///
    /// # Errors
    /// If the file is not a state of this plant, or is missing although the other run had begun.
    pub(super) fn resume(&self, plant: Plant, resume: bool, begun: bool) -> Result<Plant, Error> {
        let path = &self.path;
        match Saved::read(path) {
            // A new run replaces a state of any version. It refuses to replace any other file.
            Ok(_) | Err(Unfit::Version(_)) if !resume => Ok(plant),
            Ok(Some(saved)) => plant.restored(saved).map_err(|why| refused(path, &why)),
            Ok(None) if begun => {
                let why = "missing, but the journal records an interrupted run";
                Err(not_created("plant", &format!("{}: {why}", path.display())))
            }
            Ok(None) => {
                tracing::warn!(
                    "{}: no such file: no run had begun, so the plant starts in its first state",
                    path.display()
                );
                Ok(plant)
            }
            Err(why) => Err(refused(path, &why)),
        }
    }

    /// Writes the plant's state at the beginning of a run.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(super) fn begin(&self, plant: &Plant) -> Result<(), Error> {
        self.begin_in(plant, new_file::keep_name)
    }

    /// Writes the first state like [`Self::begin`]. `keeps_name` syncs the file's folder, so that
    /// the new file is not lost in a power cut.
    fn begin_in(
        &self,
        plant: &Plant,
        keeps_name: impl FnOnce(&Path) -> io::Result<()>,
    ) -> Result<(), Error> {
        let failed =
            |why| format!("{}: the plant cannot save its state: {why}", self.path.display());
        let written = self.write(plant, true);
        written
            .and_then(|()| Ok(keeps_name(&self.path)?))
            .map_err(|why| not_created("plant", &failed(why)))
    }

    /// Writes the plant's state as its storage does. With `synced` the content survives a power cut
    /// of the simulating machine.
    fn write(&self, plant: &Plant, synced: bool) -> Result<(), Unfit> {
        let sync = if synced { Sync::Content } else { Sync::No };
        let bytes = plant.saved().to_bytes()?;
        self.storage.write(&bytes, |part| Ok(new_file::replace(&self.path, ".new", part, sync)?))
    }

    /// Returns the storage of the file, in which faults can be injected.
    pub(super) fn storage(&self) -> Storage {
        self.storage.clone()
    }

    /// Writes the plant's state after every [`KEPT_EVERY`]th period. If that fails, removes the
    /// file and warns the operator.
    pub(super) fn after(&mut self, period: u64, plant: &Plant) {
        if self.lost || !period.is_multiple_of(KEPT_EVERY) {
            return;
        }
        if let Err(why) = self.write(plant, self.synced) {
            // Once: a full disk would fail again a tenth of a second later.
            self.lost = true;
            let place = self.path.display();
            let rest = match remove_or_empty(&self.path) {
                Ok(()) => "it is removed, and this run cannot be resumed".to_owned(),
                Err(left) => format!(
                    "it is out of date and cannot be removed ({left}): this run must not be resumed"
                ),
            };
            let text = format!("{place}: the plant's state can no longer be saved: {why}; {rest}");
            let now = plant.scene().period as f64 * PERIOD;
            self.trace.tell(Notice::Warning(now, text));
        }
    }
}

/// Removes the file of an old state, or empties it, so that no run resumes from it.
///
/// # Errors
/// If the file can neither be removed nor emptied.
fn remove_or_empty(path: &Path) -> io::Result<()> {
    match std::fs::remove_file(path) {
        Err(why) if why.kind() == io::ErrorKind::NotFound => Ok(()),
        // In a read-only folder a file can still be emptied, and an empty state is refused.
        Err(why) if std::fs::metadata(path).is_ok_and(|found| found.is_file()) => {
            let file = new_file::overwrite(path);
            file.and_then(|file| file.set_len(0)).map_err(|_| why)
        }
        done => done,
    }
}

/// Returns the error of a state file that cannot be used, with the reason.
fn refused(path: &Path, why: &Unfit) -> Error {
    not_created("plant", &format!("{}: {why}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::run_hash::RunHash;

    /// The warning names the file, the reason of the failed write and that of the failed removal.
    #[test]
    fn failed_removal_of_plant_state_file_warns_once() {
        let name = format!("rubik-robot-kept-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        let text = "task = \"idle\"\nseed = 5\n";
        let scenario = crate::tasks::read(Path::new("kept.toml"), text, &[]).unwrap();
        let plant = super::super::simulation::create(&scenario, None, None).unwrap();
        let (trace, mut notices) = Trace::bare(RunHash::default());
        let mut kept = Kept::claim(&path, true, trace).unwrap();
        // The name of the first state is made durable after the state exists.
        let lost = kept.begin_in(&plant, |path| {
            assert!(path.exists());
            Err(io::Error::other("no disk"))
        });
        assert!(lost.unwrap_err().to_string().contains("cannot save its state: no disk"));
        kept.begin(&plant).unwrap();
        // A folder can be neither replaced nor removed like a file.
        std::fs::remove_file(&path).unwrap();
        std::fs::create_dir(&path).unwrap();

        kept.after(KEPT_EVERY, &plant);
        kept.after(2 * KEPT_EVERY, &plant);

        let Ok(Notice::Warning(_, text)) = notices.try_recv() else { panic!("no notice was sent") };
        assert!(text.starts_with(&format!("{}: ", path.display())), "{text}");
        assert!(text.contains("cannot be removed (") && text.contains("not be resumed"), "{text}");
        assert!(notices.try_recv().is_err(), "reported once");
        std::fs::remove_dir(&path).unwrap();
        std::fs::remove_file(format!("{}.lock", path.display())).unwrap();
    }
}
