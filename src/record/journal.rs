//! The journal of a mission: what another run must know to go on after a crash.
//!
//! - in: an entry before each motion that changes the cube, who holds it, or where another run
//!   would look for it
//! - out: a line of JSON each, durable before the motion begins; what was noted last
//! - a last line that a crash cut off is left out; the entry before it was durable, and the motion
//!   had not begun. Where there is none before it, nothing had begun
//! - a journal that cannot be written any more says so itself: its last entry would pass for the
//!   truth

use crate::tasks::Entry;
use std::fmt::Debug;
use std::fs::{File, TryLockError};
use std::io::{self, BufRead as _, BufReader, Read as _, Write as _};
use std::path::{Path, PathBuf};

/// A journal that is being written.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    keeps: Box<dyn Durable>,
}

/// What takes lines and keeps them through a power cut.
pub trait Durable: Debug + Send {
    /// Returns when the line is kept.
    ///
    /// # Errors
    /// What the operating system says.
    fn append(&mut self, line: &[u8]) -> io::Result<()>;
}

impl Durable for File {
    fn append(&mut self, line: &[u8]) -> io::Result<()> {
        self.write_all(line)?;
        self.sync_data()
    }
}

/// Why a journal cannot be read, or begun.
#[derive(Debug, thiserror::Error)]
pub enum Unreadable {
    /// Something else than a file: a folder, a device.
    #[error("not a file")]
    NoFile,
    /// It is locked.
    #[error("another run is writing it")]
    Taken,
    /// Of a run that has not ended: to begin anew would lose it.
    #[error("it tells of a run that was broken off while {0}: go on with --resume, or remove it")]
    Unfinished(String),
    /// The file.
    #[error("{0}")]
    File(#[from] io::Error),
    /// A line that is no entry, and not the last one.
    #[error("line {line}: {why}")]
    Line {
        /// From 1.
        line: usize,
        /// What is wrong with it.
        why: serde_json::Error,
    },
    /// An entry that no run has written.
    #[error("line {line}: {why}")]
    Value {
        /// From 1.
        line: usize,
        /// What is wrong with it.
        why: &'static str,
    },
    /// A line longer than any entry.
    #[error("line {0} is too long for an entry")]
    Long(usize),
    /// The run went on without it.
    #[error(
        "it could not be written to the end of its run, which cannot be resumed: see to the cube, and remove it"
    )]
    GivenUp,
}

/// No entry is longer, its line's end left out (bytes).
const LONGEST: u64 = 4096;

/// No joint is farther from its zero, and no cube from an arm's base (rad, m).
const FARTHEST: f64 = 20.0;
/// No arm draws back by more than this (m).
const MOST_SHORT: f64 = 1.0;

/// How an entry begins.
const HEAD: &[u8] = b"{\"doing\":\"";

/// All that stands in a journal that could not be written any more.
const GIVEN_UP: &[u8] = b"this journal could not be written to the end of its run\n";

impl Journal {
    /// One of which another thing than its file keeps the lines.
    #[must_use]
    pub fn kept_by(path: &Path, keeps: Box<dyn Durable>) -> Self {
        Self { path: path.to_owned(), keeps }
    }

    /// Begins a journal in place of one whose run has ended, or goes on with one.
    ///
    /// # Errors
    /// When it is no journal, another run writes it, or one that is to be begun would lose what
    /// another has left; what the operating system says.
    pub fn open(path: &Path, go_on: bool) -> Result<Self, Unreadable> {
        Self::open_in(path, go_on, keep_name)
    }

    /// The same; `keeps_name` sees to it that the file's name survives a power cut, too.
    fn open_in(
        path: &Path,
        go_on: bool,
        keeps_name: impl FnOnce(&Path) -> io::Result<()>,
    ) -> Result<Self, Unreadable> {
        if std::fs::metadata(path).is_ok_and(|found| !found.is_file()) {
            return Err(Unreadable::NoFile);
        }
        let mut file = File::options().append(true).create(true).open(path)?;
        if !is_ours(&file, path) {
            return Err(Unreadable::Taken);
        }
        let last = match Self::last(path) {
            // Nothing is lost by another run in its place.
            Err(Unreadable::GivenUp) if !go_on => None,
            last => last?,
        };
        match last {
            Some(last) if !go_on && !last.over => return Err(Unreadable::Unfinished(last.doing)),
            Some(_) if go_on => {
                // What a crash cut off stays a line of its own.
                let cut = std::fs::read(path)?.last().is_some_and(|&byte| byte != b'\n');
                if cut {
                    file.write_all(b"\n")?;
                }
            }
            _ => {
                file.set_len(0)?;
                // What has ended must not come back after a power cut, before this run notes
                // anything.
                file.sync_all()?;
            }
        }
        keeps_name(path)?;
        Ok(Self { path: path.to_owned(), keeps: Box::new(file) })
    }

    /// Notes an entry; returns when it is durable.
    ///
    /// # Errors
    /// What the operating system says; an entry that would be too long to be read.
    pub fn write(&mut self, entry: &Entry) -> io::Result<()> {
        let mut line = serde_json::to_vec(entry)?;
        if line.len() as u64 > LONGEST {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "the entry is too long"));
        }
        line.push(b'\n');
        self.keeps.append(&line)
    }

    /// Sees to it that nobody goes on from its last entry, since what follows cannot be noted; what
    /// the operator is to know.
    #[must_use]
    pub(crate) fn given_up(self, why: &io::Error) -> String {
        let place = self.path.display();
        // In place: that takes no room on a disk that is full.
        let marked = File::options().write(true).open(&self.path).and_then(|mut file| {
            file.write_all(GIVEN_UP)?;
            file.set_len(GIVEN_UP.len() as u64)?;
            file.sync_all()
        });
        let rest = match marked.or_else(|_| std::fs::remove_file(&self.path)) {
            Ok(()) => "the run goes on, and cannot be resumed".to_owned(),
            Err(left) => format!(
                "the run goes on, and must not be resumed: what the journal tells is no longer so, and it cannot be removed ({left})"
            ),
        };
        format!("{place}: the journal cannot be written: {why}; {rest}")
    }

    /// The last entry of a journal; `None` when there is none.
    ///
    /// # Errors
    /// When the file cannot be read, or is no journal.
    pub fn last(path: &Path) -> Result<Option<Entry>, Unreadable> {
        let mut reader = match File::open(path) {
            Ok(file) => BufReader::new(file),
            Err(why) if why.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(why) => return Err(why.into()),
        };
        let (mut last, mut torn) = (None, None);
        for line in 1.. {
            let mut bytes = Vec::new();
            let count = (&mut reader).take(LONGEST + 1).read_until(b'\n', &mut bytes)?;
            if count == 0 {
                break;
            }
            if line == 1 && bytes == GIVEN_UP {
                return Err(Unreadable::GivenUp);
            }
            // Whether its line ends or was cut off, an entry is as long as it is.
            if bytes.strip_suffix(b"\n").unwrap_or(&bytes).len() as u64 > LONGEST {
                return Err(Unreadable::Long(line));
            }
            match serde_json::from_slice(&bytes) {
                Ok(entry) => {
                    plausible(&entry).map_err(|why| Unreadable::Value { line, why })?;
                    last = Some(entry);
                }
                // The first of all, which a crash cut off.
                Err(why) if line == 1 && why.is_eof() && begins_an_entry(&bytes) => {}
                // A run that went on after a crash has left the torn line among whole ones.
                Err(why) => torn = torn.or(Some(Unreadable::Line { line, why })),
            }
        }
        match (last, torn) {
            (None, Some(why)) => Err(why),
            (last, _) => Ok(last),
        }
    }
}

/// Whether a cell's arms can have been where an entry tells: another run would go there.
fn plausible(entry: &Entry) -> Result<(), &'static str> {
    // Written so that NaN is refused, too.
    let within = |values: &[f64], most: f64| values.iter().all(|value| value.abs() <= most);
    if !entry.hand_over.is_none_or(|joints| within(&joints.0, FARTHEST)) {
        return Err("no arm can stand at this place of the hand-over");
    }
    if !entry.taken_at.is_none_or(|place| within(&place, FARTHEST)) {
        return Err("no arm can have taken the cube there");
    }
    if !(0.0..=MOST_SHORT).contains(&entry.short) {
        return Err("no arm draws back so much less than usual");
    }
    Ok(())
}

/// Whether these may be the first bytes of an entry.
fn begins_an_entry(bytes: &[u8]) -> bool {
    bytes.iter().zip(HEAD).all(|(byte, of_an_entry)| byte == of_an_entry)
}

/// Sees to it that a file's name is there after a power cut: what is in the file is durable without
/// it.
///
/// # Errors
/// What the operating system says.
pub(crate) fn keep_name(path: &Path) -> io::Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    match File::open(folder).and_then(|folder| folder.sync_all()) {
        Err(why) if why.kind() != io::ErrorKind::NotFound => {
            // A file system, or a folder, that allows no such thing: a run is no worse than
            // without.
            tracing::warn!("{}: {why}: a power cut may lose a new file there", folder.display());
            Ok(())
        }
        kept => kept,
    }
}

/// Locks a file that one run alone may write; whether nobody else does.
#[must_use]
pub(crate) fn is_ours(file: &File, path: &Path) -> bool {
    match file.try_lock() {
        Ok(()) => true,
        Err(TryLockError::WouldBlock) => false,
        Err(TryLockError::Error(why)) => {
            // A file system without locks.
            tracing::warn!("{}: {why}", path.display());
            true
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{Depth, JointPositions};

    fn place(name: &str) -> std::path::PathBuf {
        std::env::temp_dir().join(format!("rubik-robot-journal-{}-{name}", std::process::id()))
    }

    fn entry(doing: &str) -> Entry {
        Entry { doing: doing.to_owned(), held: [Some(Depth::One), None], ..Entry::default() }
    }

    #[test]
    fn the_last_whole_entry_counts_whatever_a_crash_left_behind_it() {
        let path = place("whole");
        let mut journal = Journal::open(&path, false).unwrap();
        journal.write(&entry("closing")).unwrap();
        journal.write(&entry("turning")).unwrap();
        drop(journal);
        let whole = std::fs::read(&path).unwrap();
        let first = whole.iter().position(|&b| b == b'\n').unwrap() + 1;

        for cut in first..whole.len() - 1 {
            std::fs::write(&path, &whole[..cut]).unwrap();

            assert_eq!(Journal::last(&path).unwrap(), Some(entry("closing")), "cut at {cut}");

            let mut journal = Journal::open(&path, true).unwrap();
            journal.write(&entry("letting go")).unwrap();

            assert_eq!(Journal::last(&path).unwrap(), Some(entry("letting go")), "cut at {cut}");
        }
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn a_first_entry_that_a_crash_cut_off_tells_that_nothing_had_begun() {
        let path = place("first");
        let mut journal = Journal::open(&path, false).unwrap();
        journal.write(&entry("wending – slowly")).unwrap();
        drop(journal);
        let whole = std::fs::read(&path).unwrap();

        for cut in 0..whole.len() - 2 {
            for go_on in [true, false] {
                std::fs::write(&path, &whole[..cut]).unwrap();

                assert_eq!(Journal::last(&path).unwrap(), None, "cut at {cut}");

                let mut journal = Journal::open(&path, go_on).unwrap();
                // Nor does it after another crash.
                assert_eq!(Journal::last(&path).unwrap(), None, "cut at {cut}");
                journal.write(&entry("turning")).unwrap();
                assert_eq!(Journal::last(&path).unwrap(), Some(entry("turning")), "cut at {cut}");
            }
        }
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn what_never_was_an_entry_is_refused_and_left_as_it_is() {
        let path = place("foreign");
        let whole = serde_json::to_string(&entry("closing")).unwrap();
        let foreign = [
            "a thesis",
            "{\"kind\": ",
            "{\"doing\":\"x\",\"held\":7",
            "{ \"doing\":\"",
            // Its line has ended: no crash did that.
            &format!("{}\n", &whole[..40]),
        ];
        for text in foreign {
            std::fs::write(&path, text).unwrap();

            assert!(
                matches!(Journal::last(&path), Err(Unreadable::Line { line: 1, .. })),
                "{text}"
            );
            for go_on in [true, false] {
                assert!(Journal::open(&path, go_on).is_err(), "{text}");
                assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
            }
        }
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn the_name_of_a_journal_is_kept_before_anything_is_noted_in_it() {
        for go_on in [true, false] {
            let path = place("name");
            let mut named = Vec::new();

            let there = |path: &Path| {
                assert!(path.exists());
                named.push(path.to_owned());
                Ok(())
            };
            let opened = Journal::open_in(&path, go_on, there);

            assert!(opened.is_ok());
            assert_eq!(named, std::slice::from_ref(&path));
            let lost = Journal::open_in(&path, go_on, |_| Err(io::Error::other("no disk")));
            assert!(matches!(lost, Err(Unreadable::Taken)), "{lost:?}");
            drop(opened);
            let lost = Journal::open_in(&path, go_on, |_| Err(io::Error::other("no disk")));
            assert!(matches!(lost, Err(Unreadable::File(_))), "{lost:?}");
            std::fs::remove_file(path).unwrap();
        }
        // In a folder that is there, and in none.
        keep_name(&place("name")).unwrap();
        keep_name(Path::new("journal")).unwrap();
        assert!(keep_name(&place("none").join("journal")).is_err());
    }

    #[test]
    fn a_journal_that_was_given_up_is_believed_by_nobody() {
        let path = place("given-up");
        let mut journal = Journal::open(&path, false).unwrap();
        journal.write(&entry("closing")).unwrap();

        let told = journal.given_up(&io::Error::other("disk full"));

        assert!(told.starts_with(&format!("{}: ", path.display())), "{told}");
        assert!(told.contains("disk full; the run goes on, and cannot be resumed"), "{told}");
        assert!(matches!(Journal::last(&path), Err(Unreadable::GivenUp)));
        assert!(matches!(Journal::open(&path, true), Err(Unreadable::GivenUp)));
        assert!(path.exists());
        // Another run may begin there.
        Journal::open(&path, false).unwrap().write(&entry("turning")).unwrap();
        assert_eq!(Journal::last(&path).unwrap(), Some(entry("turning")));

        // Where nothing can be done about it, the operator must know.
        let journal = Journal::kept_by(&path.join("nowhere"), Box::new(File::open(&path).unwrap()));
        let told = journal.given_up(&io::Error::other("disk full"));
        assert!(
            told.contains("must not be resumed") && told.contains("cannot be removed ("),
            "{told}"
        );
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn a_line_counts_as_kept_only_when_the_disk_has_it() {
        // A pipe takes the line, but nothing makes it durable there.
        let (_reader, writer) = io::pipe().unwrap();
        let mut file = File::from(std::os::fd::OwnedFd::from(writer));

        let kept = Durable::append(&mut file, b"{}\n");

        assert_eq!(kept.unwrap_err().kind(), io::ErrorKind::InvalidInput);
    }

    #[test]
    fn a_journal_that_can_be_marked_no_more_is_removed() {
        // Behind a link to nothing there is no file to be marked; the link can be taken away.
        let path = place("removed");
        std::os::unix::fs::symlink(path.with_extension("nowhere"), &path).unwrap();
        let (_reader, writer) = io::pipe().unwrap();
        let file = File::from(std::os::fd::OwnedFd::from(writer));

        let told = Journal::kept_by(&path, Box::new(file)).given_up(&io::Error::other("disk full"));

        assert!(told.contains("disk full; the run goes on, and cannot be resumed"), "{told}");
        assert!(!path.is_symlink(), "what it told would pass for the truth");
    }

    #[test]
    fn what_a_crash_left_is_no_longer_for_the_line_that_ends_it() {
        let path = place("longest");
        for (long, refused) in [(LONGEST, false), (LONGEST + 1, true)] {
            Journal::open(&path, false).unwrap().write(&entry("closing")).unwrap();
            let whole = std::fs::read(&path).unwrap();
            std::fs::write(&path, [whole, vec![b'x'; long as usize]].concat()).unwrap();
            assert_eq!(Journal::last(&path).is_err(), refused, "{long}");

            let opened = Journal::open(&path, true);

            assert_eq!(opened.is_err(), refused, "{long}");
            if let Ok(mut journal) = opened {
                journal.write(&entry("turning")).unwrap();
            }
            assert_eq!(Journal::last(&path).is_err(), refused, "{long}");
            std::fs::remove_file(&path).unwrap();
        }
    }

    #[test]
    fn no_entry_is_written_that_could_not_be_read() {
        let path = place("unreadable");
        let mut journal = Journal::open(&path, false).unwrap();
        journal.write(&entry("closing")).unwrap();

        let refused = journal.write(&entry(&"x".repeat(LONGEST as usize))).unwrap_err();

        assert_eq!(refused.kind(), io::ErrorKind::InvalidInput);
        assert_eq!(Journal::last(&path).unwrap(), Some(entry("closing")));
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn an_entry_of_what_no_arm_can_do_is_refused_with_its_line() {
        let path = place("values");
        let wrong: [fn(&mut Entry); 4] = [
            |entry| entry.short = 1e308,
            |entry| entry.short = -0.1,
            |entry| entry.taken_at = Some([0.0, 1e20, 0.0]),
            |entry| entry.hand_over = Some(JointPositions([1e300; 7])),
        ];
        for change in wrong {
            let mut journal = Journal::open(&path, false).unwrap();
            journal.write(&entry("closing")).unwrap();
            let mut last = entry("turning");
            change(&mut last);
            journal.write(&last).unwrap();

            let error = Journal::last(&path).unwrap_err();

            assert!(matches!(error, Unreadable::Value { line: 2, .. }), "{error}");
            std::fs::remove_file(&path).unwrap();
        }
    }

    #[test]
    fn what_is_no_journal_is_refused_with_its_line() {
        let path = place("refused");
        std::fs::write(&path, "a poem\nof two lines\n").unwrap();

        let error = Journal::last(&path).unwrap_err().to_string();

        assert!(error.starts_with("line 1: "), "{error}");
        std::fs::write(&path, vec![b'x'; 100_000]).unwrap();
        assert!(matches!(Journal::last(&path), Err(Unreadable::Long(1))));
        std::fs::write(&path, "").unwrap();
        assert_eq!(Journal::last(&path).unwrap(), None);
        std::fs::remove_file(path).unwrap();
    }
}
