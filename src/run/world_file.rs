//! The plant's state in a file, which one run alone keeps.
//!
//! - in: the file's name; the plant as it is, after each period
//! - out: a plant that goes on where another run's was; a file that is whole, and a tenth of a second old at most
//! - what cannot be kept any more is taken away: an old state would pass for the truth
//! - the lock is on a file beside it, since the state's own is replaced all the time. It stays there: whoever removed it
//!   might remove what another run has locked meanwhile. The system lets go of it however a run ends

use super::failure::not_created;
use crate::actors::notice::Notice;
use crate::actors::trace::Trace;
use crate::error::Error;
use crate::hw::plant::Plant;
use crate::hw::plant::saved::{Saved, Unfit};
use crate::motion::PERIOD;
use crate::record::journal;
use crate::scenario::keys::Pace;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// A plant keeps its state so often (servo periods).
///
/// A kill of the process loses nothing of what was kept. Under virtual time a state is on the disk before it takes the
/// file's name: a mission of 6600 of them took 12.9 s, unsynced 11.9 s. The name of the first one is durable before the
/// run begins, a later one's with the next state that is, so a power cut of the machine that simulates, which is not the robot's, may lose the last two tenths of a
/// second of simulated time.
///
/// Under the wall clock nothing is synced, since the servo's thread cannot wait for a disk, which may take as long as
/// several periods: a power cut may lose what the system writes by itself within seconds, and leave a state that is old,
/// or one that is cut off and refused.
const KEPT_EVERY: u64 = 50;

/// A file in which a plant keeps its state.
pub(super) struct Kept {
    path: PathBuf,
    pace: Pace,
    /// Hears when the state cannot be kept any more.
    trace: Trace,
    /// It cannot.
    lost: bool,
    /// Locked as long as this lives.
    _lock: File,
}

impl Kept {
    /// Takes a file for this run alone, whether it is there yet or not.
    ///
    /// # Errors
    /// When it is no file, or another run has it.
    pub(super) fn claim(path: &Path, pace: Pace, trace: Trace) -> Result<Self, Error> {
        let mut beside = path.as_os_str().to_owned();
        beside.push(".lock");
        let beside = PathBuf::from(beside);
        let looked_at = |file: &Path| {
            // A device may do anything when it is opened.
            if std::fs::metadata(file).is_ok_and(|found| !found.is_file()) {
                return Err(refused(file, &Unfit::NoFile));
            }
            Ok(())
        };
        looked_at(path)?;
        looked_at(&beside)?;
        let lock = File::options().append(true).create(true).open(&beside);
        let lock = lock.map_err(|why| refused(&beside, &why.into()))?;
        if !journal::is_ours(&lock, &beside) {
            return Err(refused(path, &Unfit::Taken));
        }
        Ok(Self { path: path.to_owned(), pace, trace, lost: false, _lock: lock })
    }

    /// The plant as another run left it, when this one is to go on; `begun`: a journal tells of one.
    ///
    /// # Errors
    /// When the file is no state of this plant, or is missing though another run had begun.
    pub(super) fn taken_up(&self, plant: Plant, resume: bool, begun: bool) -> Result<Plant, Error> {
        let path = &self.path;
        match Saved::read(path) {
            // Another run has ended with it.
            Ok(_) | Err(Unfit::Version(_)) if !resume => Ok(plant),
            Ok(Some(saved)) => plant.restored(saved).map_err(|why| refused(path, &why)),
            Ok(None) if begun => {
                let why = "not there, but the journal tells of a run that was broken off";
                Err(not_created("plant", &format!("{}: {why}", path.display())))
            }
            Ok(None) => {
                tracing::warn!("{}: not there, so nothing had begun", path.display());
                Ok(plant)
            }
            Err(why) => Err(refused(path, &why)),
        }
    }

    /// Keeps how a run begins.
    ///
    /// # Errors
    /// When that cannot be.
    pub(super) fn begin(&self, plant: &Plant) -> Result<(), Error> {
        self.begin_in(plant, journal::keep_name)
    }

    /// The same; `keeps_name` sees to it that the file's name survives a power cut, too.
    fn begin_in(
        &self,
        plant: &Plant,
        keeps_name: impl FnOnce(&Path) -> io::Result<()>,
    ) -> Result<(), Error> {
        let failed =
            |why| format!("{}: the plant cannot keep its state: {why}", self.path.display());
        let written = plant.saved().write(&self.path, true);
        written
            .and_then(|()| Ok(keeps_name(&self.path)?))
            .map_err(|why| not_created("plant", &failed(why)))
    }

    /// After a period: keeps the state when it is time to.
    pub(super) fn after(&mut self, period: u64, plant: &Plant) {
        if self.lost || !period.is_multiple_of(KEPT_EVERY) {
            return;
        }
        if let Err(why) = plant.saved().write(&self.path, self.pace == Pace::Virtual) {
            self.lost = true;
            let place = self.path.display();
            let rest = match taken_away(&self.path) {
                Ok(()) => "it is removed, and this run cannot be resumed".to_owned(),
                Err(left) => format!(
                    "what it tells is no longer so, and it cannot be removed ({left}): this run must not be resumed"
                ),
            };
            let text = format!("{place}: the plant's state cannot be kept any more: {why}; {rest}");
            let now = plant.scene().period as f64 * PERIOD;
            self.trace.tell(Notice::Warning(now, text));
        }
    }
}

/// Sees to it that nobody goes on from an old state.
fn taken_away(path: &Path) -> io::Result<()> {
    match std::fs::remove_file(path) {
        Err(why) if why.kind() == io::ErrorKind::NotFound => Ok(()),
        // In a folder that may not be changed a file can be emptied; an empty one is refused.
        Err(why) if std::fs::metadata(path).is_ok_and(|found| found.is_file()) => {
            let file = File::options().write(true).open(path);
            file.and_then(|file| file.set_len(0)).map_err(|_| why)
        }
        done => done,
    }
}

fn refused(path: &Path, why: &Unfit) -> Error {
    not_created("plant", &format!("{}: {why}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::run_hash::RunHash;
    use crate::scenario;

    #[test]
    fn an_old_state_that_cannot_even_be_removed_is_told_once_with_place_and_reasons() {
        let name = format!("rubik-robot-kept-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        let text = "task = \"idle\"\nseed = 5\n";
        let scenario = scenario::read(Path::new("kept.toml"), text, &[]).unwrap();
        let plant = super::super::simulation::create(&scenario, None, None).unwrap();
        let (trace, mut told) = Trace::bare(RunHash::default());
        let mut kept = Kept::claim(&path, Pace::Virtual, trace).unwrap();
        // The first state is there by name, whatever becomes of the machine.
        let lost = kept.begin_in(&plant, |path| {
            assert!(path.exists());
            Err(io::Error::other("no disk"))
        });
        assert!(lost.unwrap_err().to_string().contains("cannot keep its state: no disk"));
        kept.begin(&plant).unwrap();
        // Neither replaced nor removed as a file is.
        std::fs::remove_file(&path).unwrap();
        std::fs::create_dir(&path).unwrap();

        kept.after(KEPT_EVERY, &plant);
        kept.after(2 * KEPT_EVERY, &plant);

        let Ok(Notice::Warning(_, text)) = told.try_recv() else { panic!("nothing was told") };
        assert!(text.starts_with(&format!("{}: ", path.display())), "{text}");
        assert!(text.contains("cannot be removed (") && text.contains("not be resumed"), "{text}");
        assert!(told.try_recv().is_err(), "told once");
        std::fs::remove_dir(&path).unwrap();
        std::fs::remove_file(format!("{}.lock", path.display())).unwrap();
    }
}
