//! Journal of a mission: the state from which another run can continue after a crash.
//!
//! - in: an entry before each motion that changes the cube, its holder, or the place where the next
//!   run would look for the cube
//! - out: one line of JSON per entry, durable before the motion begins; for the next run, the last
//!   entry. The first line names the program and the task; a journal of an older version lacks it
//!
//! | fault | result |
//! |---|---|
//! | a crash cuts off the last line | the entry before it counts: the motion had not begun |
//! | a crash cuts off the first entry, or the line before it | no entry: nothing had begun |
//! | another program, or a task that this one does not have | the journal is refused by name |
//! | the journal can no longer be written | it is marked, so that no run trusts its last entry |
//! | a line longer than `LONGEST` | reading fails with the number of the line |
//! | values that no run can have written | reading fails with the number of the line |

use crate::hw::storage::{Storage, StorageFault};
use crate::hw::{new_file, text};
use crate::kernel::{JournalEntry, Progress};
use crate::scenario::maker::Maker;
use serde::{Deserialize, Serialize};
use std::fmt::Debug;
use std::fs::{File, TryLockError};
use std::io::{self, BufRead as _, BufReader, Read as _, Write as _};
use std::path::{Path, PathBuf};

/// Journal that is being written.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    /// Storage to which the lines go.
    keeps: Box<dyn Durable>,
    /// Storage of the file, in which faults can be injected.
    storage: Storage,
}

/// Storage that keeps lines through a power cut.
pub trait Durable: Debug + Send {
    /// Appends a line and returns once it is durable.
    ///
    /// # Errors
    /// Error of the operating system.
    fn append(&mut self, line: &[u8]) -> io::Result<()>;
}

impl Durable for File {
    fn append(&mut self, line: &[u8]) -> io::Result<()> {
        self.write_all(line)?;
        self.sync_data()
    }
}

/// Reason why a journal cannot be read or begun.
#[derive(Debug, thiserror::Error)]
pub enum Unreadable {
    /// Path of something else than a file: a folder, a device.
    #[error("not a file, but a folder or a device: name another path")]
    NoFile,
    /// Lock of another run on the file.
    #[error("another run is writing this journal: name another file")]
    Taken,
    /// Unfinished run in the journal, which a new journal would overwrite.
    #[error(
        "an earlier run was interrupted while {0}, and its journal is still there: continue that \
         run with --resume, or name another file"
    )]
    Unfinished(String),
    /// Error of the operating system.
    #[error("{0}")]
    File(#[from] io::Error),
    /// Line that is no entry, in a file without any entry.
    #[error("line {line} is no journal entry: {why}")]
    Line {
        /// Number of the line, from 1.
        line: usize,
        /// Error of the parser.
        why: serde_json::Error,
    },
    /// Entry with values that no run can have written.
    #[error("line {line} holds an impossible entry: {why}")]
    Value {
        /// Number of the line, from 1.
        line: usize,
        /// Reason why the value is impossible.
        why: &'static str,
    },
    /// Line longer than any entry.
    #[error("line {0} is longer than any journal entry: this file is no journal")]
    Long(usize),
    /// Program that cannot be continued by this one.
    #[error("{0}")]
    Foreign(String),
    /// Mark of a run that continued after it could no longer write its journal.
    #[error(
        "the journal is incomplete because its run could not write to it; the run cannot be \
         resumed: take the cube out of the grippers, then remove this file"
    )]
    GivenUp,
}

/// Largest length of an entry without the end of its line (bytes).
const LONGEST: u64 = 4096;

/// First bytes of each entry.
const HEAD: &[u8] = b"{\"doing\":\"";

/// First bytes of the line that names the program.
const MADE: &[u8] = b"{\"program\":\"";

/// First line of a journal.
#[derive(Debug, Serialize, Deserialize)]
struct Made {
    #[serde(flatten)]
    maker: Maker,
    task: String,
}

/// Whole content of a journal that could no longer be written.
const GIVEN_UP: &[u8] = b"this journal could not be written to the end of its run\n";

impl Journal {
    /// Makes a journal whose lines go to `storage` instead of the file at `path`, which is marked
    /// or removed if `storage` fails.
    #[must_use]
    pub fn kept_by(path: &Path, storage: Box<dyn Durable>) -> Self {
        Self { path: path.to_owned(), keeps: storage, storage: Storage::default() }
    }

    /// Opens the journal at `path` and locks it. With `go_on` the run continues the journal that is
    /// there; otherwise it begins an empty one.
    ///
    /// # Errors
    /// If the file is no journal, if another run writes it, or if a new journal would overwrite
    /// that of an unfinished run; error of the operating system.
    pub fn open<E: JournalEntry>(path: &Path, go_on: bool) -> Result<Self, Unreadable> {
        Self::open_in::<E>(path, go_on, new_file::keep_name)
    }

    /// Opens a journal as [`Journal::open`] does. `keeps_name` syncs the folder of the file, so
    /// that a power cut does not remove the name of a new file.
    fn open_in<E: JournalEntry>(
        path: &Path,
        go_on: bool,
        keeps_name: impl FnOnce(&Path) -> io::Result<()>,
    ) -> Result<Self, Unreadable> {
        if std::fs::metadata(path).is_ok_and(|found| !found.is_file()) {
            return Err(Unreadable::NoFile);
        }
        let path = &new_file::resolve(path)?;
        let mut file = new_file::open_or_create(path)?;
        if !new_file::lock_for_writing(&file, path) {
            return Err(Unreadable::Taken);
        }
        // The file is locked before it is read, so no other run can add an entry in between.
        let last = match Self::last::<E>(path) {
            // A journal that was given up holds no state that a new one could destroy.
            Err(Unreadable::GivenUp) if !go_on => None,
            last => last?,
        };
        match last {
            Some(last) if !go_on && !last.is_over() => {
                return Err(Unreadable::Unfinished(last.doing().to_owned()));
            }
            Some(_) if go_on => {
                // A line that a crash cut off gets its end, or the next entry would be part of it.
                let cut = std::fs::read(path)?.last().is_some_and(|&byte| byte != b'\n');
                if cut {
                    file.write_all(b"\n")?;
                }
            }
            _ => {
                file.set_len(0)?;
                // Without the sync a power cut before the first entry could bring back the entries
                // of the run that has ended.
                file.sync_all()?;
            }
        }
        keeps_name(path)?;
        Ok(Self::kept_by(path, Box::new(file)))
    }

    /// Checks that `program` can continue or replace the journal at `path`. A file without the name
    /// of a program passes.
    ///
    /// # Errors
    /// [`Unreadable::Foreign`] with the names; an error of the operating system.
    pub fn check_maker(path: &Path, program: &Maker) -> Result<(), Unreadable> {
        let mut line = Vec::new();
        match text::open(path) {
            Ok(file) => BufReader::new(file).take(LONGEST + 1).read_until(b'\n', &mut line)?,
            Err(why) if why.kind() == io::ErrorKind::NotFound => return Ok(()),
            Err(why) => return Err(why.into()),
        };
        // A line that a crash cut off names no program: no motion had begun.
        match serde_json::from_slice::<Made>(&line) {
            Ok(made) => program.accepts(Some(&made.maker), &made.task).map_err(Unreadable::Foreign),
            Err(_) => Ok(()),
        }
    }

    /// Names the program and the task in the first line of a new journal, and returns once it is
    /// durable.
    ///
    /// # Errors
    /// Error of the operating system; also if the program has too many tasks for a line.
    pub fn sign(&mut self, program: &Maker, task: &str) -> io::Result<()> {
        let made = Made { maker: program.clone(), task: task.to_owned() };
        self.append(serde_json::to_vec(&made)?, MADE)
    }

    /// Writes an entry and returns once it is durable.
    ///
    /// # Errors
    /// Error of the operating system; also if the entry is too long to be read back, or does not
    /// begin with `doing`.
    pub fn write(&mut self, entry: &impl JournalEntry) -> io::Result<()> {
        self.append(serde_json::to_vec(entry)?, HEAD)
    }

    /// Appends a line that begins with `head`, and returns once it is durable.
    fn append(&mut self, mut line: Vec<u8>, head: &[u8]) -> io::Result<()> {
        let why = match line.len() as u64 {
            too_long if too_long > LONGEST => Some("the entry is too long"),
            _ if !line.starts_with(head) => Some("the entry does not begin with `doing`"),
            _ => None,
        };
        if let Some(why) = why {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, why));
        }
        line.push(b'\n');
        let Self { keeps, storage, .. } = self;
        storage.write(&line, |bytes| keeps.append(bytes))
    }

    /// Returns the storage of the journal, in which faults can be injected.
    #[must_use]
    pub fn storage(&self) -> Storage {
        self.storage.clone()
    }

    /// Marks a journal that can no longer be written, so that no run continues from its last entry.
    /// If it cannot be marked, it is removed. `why` is the error of the write that failed. Returns
    /// the message for the operator.
    #[must_use]
    pub(crate) fn given_up(self, why: &io::Error) -> String {
        let place = self.path.display();
        let mark = |bytes: &[u8]| {
            let mut file = new_file::overwrite(&self.path)?;
            file.write_all(bytes)?;
            file.set_len(bytes.len() as u64)?;
            file.sync_all()
        };
        // Overwriting in place needs no space, so it works on a full disk.
        let marked = match self.storage.fault() {
            Some(StorageFault::Full) => mark(GIVEN_UP),
            _ => self.storage.write(GIVEN_UP, mark),
        };
        let rest = match marked.or_else(|_| std::fs::remove_file(&self.path)) {
            Ok(()) => "the run continues and cannot be resumed".to_owned(),
            Err(left) => format!(
                "the run continues and must not be resumed: the journal is out of date and cannot \
                 be removed ({left})"
            ),
        };
        format!("{place}: the journal cannot be written: {why}; {rest}")
    }

    /// Returns what a run was doing when it was interrupted, if the journal at `path` is that of a
    /// run that is neither over nor still going on. The file stays as it is.
    #[must_use]
    pub fn interrupted(path: &Path) -> Option<String> {
        let file = text::open(path).ok()?;
        // A run holds an exclusive lock on its journal as long as it lives.
        if matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)) {
            return None;
        }
        let last = Self::last::<Progress>(path).ok().flatten();
        last.filter(|last| !last.over).map(|last| last.doing)
    }

    /// Returns the last entry of a journal; `None` if there is no file or no entry in it.
    ///
    /// # Errors
    /// If the file cannot be read, or is no journal.
    pub fn last<E: JournalEntry>(path: &Path) -> Result<Option<E>, Unreadable> {
        let mut reader = match text::open(path) {
            Ok(file) => BufReader::new(file),
            Err(why) if why.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(why) => return Err(why.into()),
        };
        let (mut last, mut torn, mut first) = (None, None, 1);
        for line in 1.. {
            let mut bytes = Vec::new();
            // The bound keeps a file without line ends from filling the memory. One more byte than
            // `LONGEST` leaves room for the end of the line.
            let count = (&mut reader).take(LONGEST + 1).read_until(b'\n', &mut bytes)?;
            if count == 0 {
                break;
            }
            if line == 1 && bytes == GIVEN_UP {
                return Err(Unreadable::GivenUp);
            }
            // The end of the line does not count, since a crash may have cut it off.
            if bytes.strip_suffix(b"\n").unwrap_or(&bytes).len() as u64 > LONGEST {
                return Err(Unreadable::Long(line));
            }
            // A crash may cut off the end of the first line: nothing had begun.
            if line == 1 && bytes.starts_with(MADE) {
                first = 2;
                continue;
            }
            match serde_json::from_slice::<E>(&bytes) {
                Ok(entry) => {
                    entry.check().map_err(|why| Unreadable::Value { line, why })?;
                    last = Some(entry);
                }
                // A crash cut off the very first entry: nothing had begun.
                Err(why) if line == first && why.is_eof() && may_begin(&bytes) => {}
                // A run that continued after a crash has left the torn line among whole ones. So a
                // bad line is an error only in a journal without any entry.
                Err(why) => torn = torn.or(Some(Unreadable::Line { line, why })),
            }
        }
        match (last, torn) {
            (None, Some(why)) => Err(why),
            (last, _) => Ok(last),
        }
    }
}

/// Checks whether `bytes` and the beginning of an entry or of the first line agree as far as the
/// shorter one goes. So the beginning of a line that a crash cut off passes.
fn may_begin(bytes: &[u8]) -> bool {
    [HEAD, MADE].iter().any(|head| bytes.iter().zip(*head).all(|(byte, of_head)| byte == of_head))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{Depth, JointPositions};
    use crate::tasks::cube::mission::Entry;

    /// Returns the path of a temporary file for one test.
    fn place(name: &str) -> std::path::PathBuf {
        std::env::temp_dir().join(format!("rubik-robot-journal-{}-{name}", std::process::id()))
    }

    /// Opens the journal of a mission.
    fn open(path: &Path, go_on: bool) -> Result<Journal, Unreadable> {
        Journal::open::<Entry>(path, go_on)
    }

    /// Returns the last entry of a mission's journal.
    fn last(path: &Path) -> Result<Option<Entry>, Unreadable> {
        Journal::last(path)
    }

    /// Returns an entry of a run that was doing this while its first hand held one layer.
    fn entry(doing: &str) -> Entry {
        Entry { doing: doing.to_owned(), held: [Some(Depth::One), None], ..Entry::default() }
    }

    /// A crash may cut off the last line at any byte: the entry before it counts, and a run that
    /// continues can write after it.
    #[test]
    fn last_complete_entry_is_read_after_a_crash() {
        let path = place("whole");
        let mut journal = open(&path, false).unwrap();
        journal.write(&entry("closing")).unwrap();
        journal.write(&entry("turning")).unwrap();
        drop(journal);
        let whole = std::fs::read(&path).unwrap();
        let first = whole.iter().position(|&b| b == b'\n').unwrap() + 1;

        for cut in first..whole.len() - 1 {
            std::fs::write(&path, &whole[..cut]).unwrap();

            assert_eq!(last(&path).unwrap(), Some(entry("closing")), "cut at {cut}");

            let mut journal = open(&path, true).unwrap();
            journal.write(&entry("letting go")).unwrap();

            assert_eq!(last(&path).unwrap(), Some(entry("letting go")), "cut at {cut}");
        }
        std::fs::remove_file(path).unwrap();
    }

    /// The first line may be cut off as well: nothing had begun. An entry that is cut off behind it
    /// is the first one.
    #[test]
    fn signed_journal_is_read_after_a_crash() {
        let path = place("signed");
        let maker = Maker { tasks: vec!["solve".to_owned()], ..Maker::default() };
        let mut journal = open(&path, false).unwrap();
        journal.sign(&maker, "solve").unwrap();
        assert_eq!(last(&path).unwrap(), None);
        journal.write(&entry("closing")).unwrap();
        drop(journal);
        assert_eq!(last(&path).unwrap(), Some(entry("closing")));
        assert_eq!(Journal::interrupted(&path).as_deref(), Some("closing"));

        let whole = std::fs::read(&path).unwrap();
        for cut in 1..whole.len() - 1 {
            std::fs::write(&path, &whole[..cut]).unwrap();
            assert_eq!(last(&path).unwrap(), None, "cut at {cut}");
            Journal::check_maker(&path, &maker).unwrap();
        }
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn journal_of_other_program_is_refused() {
        let path = place("other-program");
        let own = Maker { tasks: vec!["solve".to_owned()], ..Maker::default() };
        let tasks = vec!["wave".to_owned()];
        let other = Maker { program: "own_cell".to_owned(), version: "0.1.0".to_owned(), tasks };
        open(&path, false).unwrap().sign(&other, "wave").unwrap();

        Journal::check_maker(&path, &other).unwrap();
        let why = Journal::check_maker(&path, &own).unwrap_err().to_string();
        assert!(why.contains("by own_cell 0.1.0 with task `wave`, which this program"), "{why}");
        // An old journal begins with an entry.
        let mut journal = open(&path, false).unwrap();
        journal.write(&entry("closing")).unwrap();
        Journal::check_maker(&path, &own).unwrap();
        assert_eq!(last(&path).unwrap(), Some(entry("closing")));
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn journal_with_only_a_torn_entry_is_empty() {
        let path = place("first");
        let mut journal = open(&path, false).unwrap();
        journal.write(&entry("wending – slowly")).unwrap();
        drop(journal);
        let whole = std::fs::read(&path).unwrap();

        for cut in 0..whole.len() - 2 {
            for go_on in [true, false] {
                std::fs::write(&path, &whole[..cut]).unwrap();

                assert_eq!(last(&path).unwrap(), None, "cut at {cut}");

                let mut journal = open(&path, go_on).unwrap();
                // If another crash comes before the next entry, there is still no entry.
                assert_eq!(last(&path).unwrap(), None, "cut at {cut}");
                journal.write(&entry("turning")).unwrap();
                assert_eq!(last(&path).unwrap(), Some(entry("turning")), "cut at {cut}");
            }
        }
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn non_journal_file_is_refused_and_kept_unchanged() {
        let path = place("foreign");
        let whole = serde_json::to_string(&entry("closing")).unwrap();
        let foreign = [
            "a thesis",
            "{\"kind\": ",
            "{\"doing\":\"x\",\"held\":7",
            "{ \"doing\":\"",
            // A part of an entry that ends with an end of line. No crash leaves this.
            &format!("{}\n", &whole[..40]),
        ];
        for text in foreign {
            std::fs::write(&path, text).unwrap();

            assert!(matches!(last(&path), Err(Unreadable::Line { line: 1, .. })), "{text}");
            for go_on in [true, false] {
                assert!(open(&path, go_on).is_err(), "{text}");
                assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
            }
        }
        std::fs::remove_file(path).unwrap();
    }

    /// The folder of the file is synced when the journal is opened. If that fails, so does the
    /// opening; a second journal on the same file is refused before.
    #[test]
    fn journal_file_name_is_durable_before_first_entry() {
        for go_on in [true, false] {
            let path = place("name");
            let mut named = Vec::new();

            let there = |path: &Path| {
                assert!(path.exists());
                named.push(path.to_owned());
                Ok(())
            };
            let opened = Journal::open_in::<Entry>(&path, go_on, there);

            assert!(opened.is_ok());
            assert_eq!(named, std::slice::from_ref(&path));
            let lost =
                Journal::open_in::<Entry>(&path, go_on, |_| Err(io::Error::other("no disk")));
            assert!(matches!(lost, Err(Unreadable::Taken)), "{lost:?}");
            drop(opened);
            let lost =
                Journal::open_in::<Entry>(&path, go_on, |_| Err(io::Error::other("no disk")));
            assert!(matches!(lost, Err(Unreadable::File(_))), "{lost:?}");
            std::fs::remove_file(path).unwrap();
        }
    }

    #[test]
    fn no_run_resumes_from_an_abandoned_journal() {
        let path = place("given-up");
        let mut journal = open(&path, false).unwrap();
        journal.write(&entry("closing")).unwrap();

        let told = journal.given_up(&io::Error::other("disk full"));

        assert!(told.starts_with(&format!("{}: ", path.display())), "{told}");
        assert!(told.contains("disk full; the run continues and cannot be resumed"), "{told}");
        assert!(matches!(last(&path), Err(Unreadable::GivenUp)));
        assert!(matches!(open(&path, true), Err(Unreadable::GivenUp)));
        assert!(path.exists());
        // A new run may begin its journal there.
        open(&path, false).unwrap().write(&entry("turning")).unwrap();
        assert_eq!(last(&path).unwrap(), Some(entry("turning")));

        // If the file can be neither marked nor removed, the operator is warned.
        let journal = Journal::kept_by(&path.join("nowhere"), Box::new(File::open(&path).unwrap()));
        let told = journal.given_up(&io::Error::other("disk full"));
        assert!(
            told.contains("must not be resumed") && told.contains("cannot be removed ("),
            "{told}"
        );
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn append_fails_if_the_line_is_not_durable() {
        // A pipe takes the line but cannot make it durable.
        let (_reader, writer) = io::pipe().unwrap();
        let mut file = File::from(std::os::fd::OwnedFd::from(writer));

        let kept = Durable::append(&mut file, b"{}\n");

        assert_eq!(kept.unwrap_err().kind(), io::ErrorKind::InvalidInput);
    }

    #[test]
    fn abandoned_journal_that_cannot_be_marked_is_removed() {
        // A link without a target has no file to be marked, but the link can be removed.
        let path = place("removed");
        std::os::unix::fs::symlink(path.with_extension("nowhere"), &path).unwrap();
        let (_reader, writer) = io::pipe().unwrap();
        let file = File::from(std::os::fd::OwnedFd::from(writer));

        let told = Journal::kept_by(&path, Box::new(file)).given_up(&io::Error::other("disk full"));

        assert!(told.contains("disk full; the run continues and cannot be resumed"), "{told}");
        assert!(!path.is_symlink(), "a stale journal would count as true");
    }

    /// The end of line that a continuing run adds to a torn line does not make the line too long.
    #[test]
    fn torn_line_of_largest_length_is_readable() {
        let path = place("longest");
        for (long, refused) in [(LONGEST, false), (LONGEST + 1, true)] {
            open(&path, false).unwrap().write(&entry("closing")).unwrap();
            let whole = std::fs::read(&path).unwrap();
            std::fs::write(&path, [whole, vec![b'x'; long as usize]].concat()).unwrap();
            assert_eq!(last(&path).is_err(), refused, "{long}");

            let opened = open(&path, true);

            assert_eq!(opened.is_err(), refused, "{long}");
            if let Ok(mut journal) = opened {
                journal.write(&entry("turning")).unwrap();
            }
            assert_eq!(last(&path).is_err(), refused, "{long}");
            std::fs::remove_file(&path).unwrap();
        }
    }

    #[test]
    fn journal_refuses_to_write_too_long_entries() {
        let path = place("unreadable");
        let mut journal = open(&path, false).unwrap();
        journal.write(&entry("closing")).unwrap();

        let refused = journal.write(&entry(&"x".repeat(LONGEST as usize))).unwrap_err();

        assert_eq!(refused.kind(), io::ErrorKind::InvalidInput);
        assert_eq!(last(&path).unwrap(), Some(entry("closing")));
        std::fs::remove_file(path).unwrap();
    }

    /// Entry whose JSON does not begin with `doing`.
    #[derive(Debug, serde::Serialize, serde::Deserialize)]
    struct Headless {
        over: bool,
        doing: String,
    }

    impl JournalEntry for Headless {
        fn doing(&self) -> &str {
            &self.doing
        }

        fn is_over(&self) -> bool {
            self.over
        }
    }

    #[test]
    fn entry_must_begin_with_what_it_does() {
        let path = place("headless");
        let mut journal = Journal::open::<Headless>(&path, false).unwrap();

        let refused = journal.write(&Headless { over: false, doing: "closing".to_owned() });

        assert_eq!(refused.unwrap_err().kind(), io::ErrorKind::InvalidInput);
        assert_eq!(std::fs::read(&path).unwrap(), b"");
        std::fs::remove_file(path).unwrap();
    }

    /// A reader without the type of the task still knows what an interrupted run was doing.
    #[test]
    fn interrupted_run_is_known_without_its_task() {
        let path = place("interrupted");
        let mut journal = open(&path, false).unwrap();
        journal.write(&entry("closing")).unwrap();
        assert_eq!(Journal::interrupted(&path), None, "the run goes on");
        drop(journal);

        assert_eq!(Journal::interrupted(&path).as_deref(), Some("closing"));

        let over = Entry { over: true, ..entry("none") };
        open(&path, true).unwrap().write(&over).unwrap();
        assert_eq!(Journal::interrupted(&path), None);
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn impossible_entry_is_refused_with_line_number() {
        let path = place("values");
        let last_joint = |value| Some(JointPositions([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, value]));
        let with =
            |short, taken_at, hand_over| Entry { hand_over, taken_at, short, ..entry("turning") };
        let impossible = [
            with(1e308, None, None),
            with(1.01, None, None),
            with(-0.01, None, None),
            with(0.0, Some([0.0, -20.1, 0.0]), None),
            with(0.0, Some([0.0, 0.0, 1e20]), None),
            with(0.0, None, last_joint(20.1)),
            with(0.0, None, last_joint(-1e300)),
        ];
        for wrong in impossible {
            let mut journal = open(&path, false).unwrap();
            journal.write(&entry("closing")).unwrap();
            journal.write(&wrong).unwrap();

            let error = last(&path).unwrap_err();

            assert!(matches!(error, Unreadable::Value { line: 2, .. }), "{error}");
            std::fs::remove_file(&path).unwrap();
        }
        let possible = with(1.0, Some([20.0, 0.0, -20.0]), last_joint(-20.0));
        open(&path, false).unwrap().write(&possible).unwrap();
        assert_eq!(last(&path).unwrap(), Some(possible));
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn non_journal_text_is_refused_with_line_number() {
        let path = place("refused");
        std::fs::write(&path, "a poem\nof two lines\n").unwrap();

        let error = last(&path).unwrap_err().to_string();

        assert!(error.starts_with("line 1 is no journal entry: "), "{error}");
        std::fs::write(&path, vec![b'x'; 100_000]).unwrap();
        assert!(matches!(last(&path), Err(Unreadable::Long(1))));
        std::fs::write(&path, "").unwrap();
        assert_eq!(last(&path).unwrap(), None);
        std::fs::remove_file(path).unwrap();
    }
}
