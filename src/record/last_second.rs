//! The last second of a run: the servo records that are written after a fatal or a system error,
//! even if the run is not recorded.
//!
//! - in: the servo records of a run, of which those of the last 2 s are kept (the arms take up to
//!   0.6 s to come to rest after an error); at the end the summary of the run
//! - out: a small recording, which `report` and other readers of MCAP open
//!
//! Only the newest `KEPT` files stay in the folder. A run on hardware fails seldom, and a person
//! asks for its last second first. A simulated run may fail often, but can be repeated.

use super::build;
use super::entry::Entry;
use super::file::{File, Unwritten};
use super::sheet::{MessageWriter, RunInfo};
use super::summary::Summary;
use crate::hw::driver::{RecordSink, ServoRecord};
use crate::hw::new_file::{self, Sync};
use std::collections::VecDeque;
use std::fs::DirBuilder;
use std::io::{self, Cursor};
use std::os::unix::fs::DirBuilderExt as _;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Time that the kept records cover (s): a second before an error, and the standstill after it.
const COVERED: f64 = 2.0;
/// Number of files that stay in the folder; older ones are removed.
const KEPT: usize = 20;
/// Beginning and ending of the names of the files.
const NAME: (&str, &str) = ("last-second-", ".mcap");
/// Ending behind the name of a file that is not complete yet.
const PART: &str = ".part";

/// Keeper of the last second of a run. A clone keeps the same records.
#[derive(Clone)]
pub struct LastSecond(Arc<Inner>);

struct Inner {
    records: Mutex<VecDeque<ServoRecord>>,
    /// Largest number of records that are kept, over all arms.
    most: usize,
    /// Folder of the files.
    folder: PathBuf,
    /// Description of the run; `None` after the file was written.
    about: Mutex<Option<RunInfo>>,
}

impl LastSecond {
    /// Makes the keeper of the run that `about` describes. Its file will be in `folder`, which need
    /// not exist.
    #[must_use]
    pub fn new(folder: PathBuf, about: RunInfo) -> Self {
        let periods = (COVERED / about.length.seconds()).ceil() as usize;
        let most = about.cell.arms.len() * periods;
        let records = Mutex::new(VecDeque::with_capacity(most));
        Self(Arc::new(Inner { records, most, folder, about: Mutex::new(Some(about)) }))
    }

    /// Writes the kept records to a new file, with the verdict on the run (`word`) and its summary,
    /// and removes the oldest files of the folder. Returns the path of the new file; `None` if the
    /// run had no servo period, or at a second call.
    ///
    /// # Errors
    /// Error of the operating system.
    pub(crate) fn write(&self, word: &str, summary: &Summary) -> io::Result<Option<PathBuf>> {
        let Inner { records, folder, about, .. } = &*self.0;
        let records = records.lock().unwrap_or_else(PoisonError::into_inner);
        let about = about.lock().unwrap_or_else(PoisonError::into_inner).take();
        let (Some(mut about), false) = (about, records.is_empty()) else { return Ok(None) };
        // The checksum reads the whole program, so it is made only for a file that is written.
        about.facts.insert("build".into(), build());
        let bytes = recording(about, &records, word, summary).map_err(io::Error::other)?;
        // A new folder is for its user alone, as the files in it are.
        DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
        let path = unused(folder);
        new_file::replace(&path, PART, &bytes, Sync::Content)?;
        remove_oldest(folder, &path);
        Ok(Some(path))
    }
}

impl RecordSink for LastSecond {
    fn record(&mut self, record: &ServoRecord) {
        let mut records = self.0.records.lock().unwrap_or_else(PoisonError::into_inner);
        if records.len() >= self.0.most {
            records.pop_front();
        }
        records.push_back(*record);
    }
}

/// Returns the bytes of a recording with these servo records, followed by the verdict `word` and
/// the summary of the run.
fn recording(
    about: RunInfo,
    records: &VecDeque<ServoRecord>,
    word: &str,
    summary: &Summary,
) -> Result<Vec<u8>, Unwritten> {
    let mut bytes = Cursor::new(Vec::new());
    let mut file = File::begin(&mut bytes)?;
    let mut writer = MessageWriter::new(about);
    writer.begin(&mut file)?;
    for record in records {
        writer.tick(record, &mut file)?;
    }
    let end = writer.tick_of(records.back().map_or(0, |last| last.period));
    for entry in Entry::end(word, summary) {
        writer.entry(end, &entry, &mut file)?;
    }
    file.finish()?;
    Ok(bytes.into_inner())
}

/// Returns an unused path in `folder`. The name has the time (ms), so that names sort by age, and
/// the number of the process, since two runs may end in one millisecond.
fn unused(folder: &Path) -> PathBuf {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    let millis = now.unwrap_or_default().as_millis();
    folder.join(format!("{}{millis:013}-{}{}", NAME.0, std::process::id(), NAME.1))
}

/// Removes the oldest files of last seconds from `folder`, except the last [`KEPT`], and the parts
/// that killed processes have left. It never removes `newest`, whose name may be too early because
/// the clock was set back. A file that cannot be removed stays.
fn remove_oldest(folder: &Path, newest: &Path) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    let mut files = Vec::new();
    for path in entries.flatten().map(|entry| entry.path()).filter(|path| path != newest) {
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        let whole = name.strip_suffix(PART).unwrap_or(name);
        if !(whole.starts_with(NAME.0) && whole.ends_with(NAME.1)) {
            continue;
        }
        if name == whole {
            files.push(path);
        // The process that writes a part holds its lock.
        } else if std::fs::File::open(&path).is_ok_and(|part| part.try_lock().is_ok()) {
            let _ = std::fs::remove_file(&path);
        }
    }
    files.sort();
    for old in files.iter().rev().skip(KEPT - 1) {
        match std::fs::remove_file(old) {
            // If the file is gone, a run that ended at the same time has removed it.
            Err(why) if why.kind() != io::ErrorKind::NotFound => {
                tracing::warn!("{}: this old file cannot be removed: {why}", old.display());
            }
            _ => {}
        }
    }
}
