//! The recorder: a thread that writes what a run brings, and the ends that the run holds.
//!
//! - in: servo records by a ring, everything else by a bounded queue
//! - out: an MCAP file ([`super::sheet`] says which topics), and [`Written`]: how much, and what
//!   was lost
//!
//! Under the wall clock nobody ever waits for the recorder: what does not fit is counted and left
//! out. On the virtual clock, where a run goes as fast as it computes, it waits instead of losing:
//! time that passes there is nobody's. Once the device refuses, nothing more is written, all that
//! comes is counted, and the run goes on; what is really in the file is then counted by reading it.

pub use super::entry::Entry;

use super::file::File;
use super::place::Place;
use super::sheet::{About, Sheet};
use crate::hw::driver::{RecordSink, ServoRecord};
use std::io::{Seek, Write};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Servo records in the ring: four seconds of two arms.
const TICKS: usize = 4096;
/// Other things in the queue.
const QUEUE: usize = 1024;
/// Pictures in the queue: 30 MB of them at most.
const PICTURES: u64 = 32;
/// How long the recorder sleeps when there is nothing to write.
const NAP: Duration = Duration::from_millis(2);

/// What became of a recording.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Written {
    /// Messages in the file.
    pub messages: u64,
    /// Messages that are not.
    pub lost: u64,
    /// Why the device refused.
    pub failure: Option<String>,
    /// Where the recording is when it did not take its name, since no period came to be in it.
    pub aside: Option<PathBuf>,
}

impl std::fmt::Display for Written {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} messages", self.messages)?;
        match self.lost {
            0 => write!(f, ", nothing lost"),
            lost => write!(f, ", {lost} lost"),
        }?;
        match &self.failure {
            Some(why) => write!(f, ": {why}"),
            None => Ok(()),
        }
    }
}

/// Who waits when the recorder does not keep up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Patience {
    /// The run: on the virtual clock.
    Waits,
    /// Nobody: what does not fit is lost.
    Never,
}

/// The run's end of a recorder; clones write to the same file. The default one records nothing.
#[derive(Clone, Default)]
pub struct Recorder(Option<Arc<Shared>>);

struct Shared {
    queue: SyncSender<(u64, Entry)>,
    ticks: Mutex<Option<rtrb::Producer<ServoRecord>>>,
    patience: Patience,
    counts: Arc<Counts>,
    thread: Mutex<Option<JoinHandle<Written>>>,
    full: Arc<AtomicBool>,
}

/// A device that can be made to be full.
struct Device<W> {
    to: W,
    full: Arc<AtomicBool>,
}

impl<W: Write> Write for Device<W> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        if self.full.load(Ordering::Acquire) {
            return Err(std::io::ErrorKind::StorageFull.into());
        }
        self.to.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.to.flush()
    }
}

impl<W: Seek> Seek for Device<W> {
    fn seek(&mut self, to: std::io::SeekFrom) -> std::io::Result<u64> {
        self.to.seek(to)
    }
}

#[derive(Default)]
struct Counts {
    lost: AtomicU64,
    pictures: AtomicU64,
    over: AtomicBool,
    latest: AtomicU64,
}

/// The servo's end: a ring.
pub struct Ticks {
    ring: rtrb::Producer<ServoRecord>,
    patience: Patience,
    counts: Arc<Counts>,
}

impl Recorder {
    /// A switch that makes the device full, for whoever tries what happens then.
    #[must_use]
    pub fn full(&self) -> Option<Arc<AtomicBool>> {
        self.0.as_ref().map(|shared| Arc::clone(&shared.full))
    }

    /// Records into `to`.
    ///
    /// # Errors
    /// What the operating system says of the thread.
    pub fn begin<W: Write + Seek + Send + 'static>(
        to: W,
        about: About,
        patience: Patience,
    ) -> std::io::Result<Self> {
        Self::begin_at(to, None, about, patience)
    }

    /// Records into `to`, a file that takes its name as soon as there is a period in it.
    ///
    /// # Errors
    /// What the operating system says of the thread.
    pub(crate) fn begin_at<W: Write + Seek + Send + 'static>(
        to: W,
        place: Option<Place>,
        about: About,
        patience: Patience,
    ) -> std::io::Result<Self> {
        let (queue, entries) = sync_channel(QUEUE);
        let full = Arc::new(AtomicBool::new(false));
        let to = Device { to, full: Arc::clone(&full) };
        let (ticks, records) = rtrb::RingBuffer::new(TICKS);
        let counts = Arc::new(Counts::default());
        let thread = std::thread::Builder::new().name("recorder".into()).spawn({
            let counts = Arc::clone(&counts);
            move || {
                Clerk { sheet: Sheet::new(about), counts, failure: None, place, begins: true }
                    .work(to, records, &entries)
            }
        })?;
        Ok(Self(Some(Arc::new(Shared {
            queue,
            ticks: Mutex::new(Some(ticks)),
            patience,
            counts,
            thread: Mutex::new(Some(thread)),
            full,
        }))))
    }

    /// The servo's end, which there is once; `None` when nothing is recorded.
    #[must_use]
    pub fn ticks(&self) -> Option<Ticks> {
        let shared = self.0.as_ref()?;
        let ring = shared.ticks.lock().unwrap_or_else(PoisonError::into_inner).take()?;
        Some(Ticks { ring, patience: shared.patience, counts: Arc::clone(&shared.counts) })
    }

    /// Whether anything is recorded.
    #[must_use]
    pub(crate) fn is_on(&self) -> bool {
        self.0.is_some()
    }

    /// The latest period of which anything was noted, beside the servo's records.
    #[must_use]
    pub(crate) fn latest(&self) -> u64 {
        self.0.as_ref().map_or(0, |shared| shared.counts.latest.load(Ordering::Relaxed))
    }

    /// Notes something at the beginning of a period of 2 ms.
    pub fn note(&self, period: u64, entry: impl FnOnce() -> Entry) {
        self.note_some(period, || Some(entry()));
    }

    /// The same, if there is something.
    pub(crate) fn note_some(&self, period: u64, entry: impl FnOnce() -> Option<Entry>) {
        let Some(shared) = &self.0 else { return };
        let Some(entry) = entry() else { return };
        shared.counts.latest.fetch_max(period, Ordering::Relaxed);
        let picture = matches!(entry, Entry::Picture(..));
        if picture {
            let waiting = &shared.counts.pictures;
            while waiting.load(Ordering::Acquire) >= PICTURES {
                if shared.patience == Patience::Never || shared.counts.over.load(Ordering::Acquire)
                {
                    shared.lose();
                    return;
                }
                std::thread::sleep(NAP / 10);
            }
            waiting.fetch_add(1, Ordering::AcqRel);
        }
        let sent = match shared.patience {
            Patience::Waits => shared.queue.send((period, entry)).is_ok(),
            Patience::Never => match shared.queue.try_send((period, entry)) {
                Ok(()) => true,
                Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => false,
            },
        };
        if !sent {
            shared.lose();
            if picture {
                shared.counts.pictures.fetch_sub(1, Ordering::AcqRel);
            }
        }
    }

    /// Ends the file and says what became of it; `None` when nothing was recorded, or another has
    /// asked already.
    #[must_use]
    pub fn finish(&self) -> Option<Written> {
        let shared = self.0.as_ref()?;
        let thread = shared.thread.lock().unwrap_or_else(PoisonError::into_inner).take()?;
        shared.counts.over.store(true, Ordering::Release);
        let mut written = thread.join().unwrap_or_else(|_| Written {
            failure: Some("the recorder died".to_owned()),
            ..Written::default()
        });
        written.lost += shared.counts.lost.load(Ordering::Acquire);
        Some(written)
    }
}

impl Shared {
    fn lose(&self) {
        self.counts.lost.fetch_add(1, Ordering::Relaxed);
    }
}

impl std::fmt::Debug for Recorder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Recorder").field("on", &self.is_on()).finish_non_exhaustive()
    }
}

/// Under the wall clock this is called by the real-time thread: no wait, no lock, no allocation.
impl RecordSink for Ticks {
    fn record(&mut self, record: &ServoRecord) {
        let mut rest = *record;
        while let Err(rtrb::PushError::Full(back)) = self.ring.push(rest) {
            if self.patience == Patience::Never || self.ring.is_abandoned() {
                self.counts.lost.fetch_add(1, Ordering::Relaxed);
                return;
            }
            rest = back;
            std::thread::sleep(NAP / 20);
        }
    }
}

/// Two sinks as one.
pub struct Both(pub Box<dyn RecordSink>, pub Box<dyn RecordSink>);

impl RecordSink for Both {
    fn record(&mut self, record: &ServoRecord) {
        self.0.record(record);
        self.1.record(record);
    }
}

/// The thread's side.
struct Clerk {
    sheet: Sheet,
    counts: Arc<Counts>,
    failure: Option<String>,
    place: Option<Place>,
    /// No period has been written yet.
    begins: bool,
}

/// The next thing that the recorder has to write.
enum Next {
    Entry(u64, Entry),
    Record(ServoRecord),
    Nothing,
}

impl Clerk {
    /// Writes what comes until the run is over, and ends the file.
    fn work<W: Write + Seek>(
        mut self,
        to: W,
        mut records: rtrb::Consumer<ServoRecord>,
        entries: &Receiver<(u64, Entry)>,
    ) -> Written {
        let mut file = self.begin(to);
        let mut waiting: Option<(u64, Entry)> = None;
        loop {
            let last = self.counts.over.load(Ordering::Acquire);
            match self.next(&mut records, entries, &mut waiting) {
                Next::Entry(period, entry) => self.entry(period, &entry, &mut file),
                Next::Record(record) => self.record(&record, &mut file),
                Next::Nothing if last => break,
                Next::Nothing => std::thread::sleep(NAP),
            }
        }
        self.end(file)
    }

    /// Begins the file; without one everything that comes is counted as lost.
    fn begin<W: Write + Seek>(&mut self, to: W) -> Option<File<W>> {
        let begun = File::begin(to).map_err(|why| why.to_string()).and_then(|mut file| {
            self.sheet.begin(&mut file).map_err(|why| why.to_string())?;
            Ok(file)
        });
        begun.map_err(|why| self.fail(&why)).ok()
    }

    /// Returns the entry or the record that comes next in the order of the run's periods.
    ///
    /// An actor that sends an entry has sent the records of that period before. So, once an entry
    /// is received, every record that belongs before it is in the ring, which is looked at again.
    fn next(
        &self,
        records: &mut rtrb::Consumer<ServoRecord>,
        entries: &Receiver<(u64, Entry)>,
        waiting: &mut Option<(u64, Entry)>,
    ) -> Next {
        let next = |records: &mut rtrb::Consumer<ServoRecord>| {
            records.peek().ok().map(|r| self.sheet.tick_of(r.period))
        };
        let mut record = next(records);
        if waiting.is_none() {
            *waiting = entries.try_recv().ok();
            record = record.or_else(|| next(records));
        }
        if let Some((period, entry)) = waiting.take_if(|w| record.is_none_or(|r| w.0 < r)) {
            return Next::Entry(period, entry);
        }
        // A record that came since the entries were looked at may belong behind an entry that came,
        // too.
        if record.is_none() {
            return Next::Nothing;
        }
        records.pop().map_or(Next::Nothing, Next::Record)
    }

    fn entry<W: Write + Seek>(&mut self, period: u64, entry: &Entry, file: &mut Option<File<W>>) {
        if matches!(entry, Entry::Picture(..)) {
            self.counts.pictures.fetch_sub(1, Ordering::AcqRel);
        }
        let written = file.as_mut().map(|file| self.sheet.entry(period, entry, file));
        self.settle(file, written, 1);
    }

    fn record<W: Write + Seek>(&mut self, record: &ServoRecord, file: &mut Option<File<W>>) {
        let first = std::mem::take(&mut self.begins);
        let written = file.as_mut().map(|file| {
            self.sheet.tick(record, file)?;
            // Only a file that can be read may take the place of another.
            if first { file.flush() } else { Ok(()) }
        });
        if first && matches!(written, Some(Ok(()))) {
            self.named(Place::take);
        }
        let lost = self.sheet.messages_of(record);
        self.settle(file, written, lost);
    }

    /// Writes the counts, so that a reader knows what the file lacks, and ends the file.
    fn end<W: Write + Seek>(mut self, file: Option<File<W>>) -> Written {
        let lost = self.counts.lost.load(Ordering::Acquire).to_string();
        let count = [("messages", self.sheet.messages().to_string()), ("lost", lost)];
        let count = count.map(|(name, value)| (name.to_owned(), value)).into();
        if let Some(mut file) = file
            && let Err(why) = (file.metadata("recording", &count))
                .and_then(|()| file.metadata("vision", &self.sheet.vision()))
                .and_then(|()| file.finish())
        {
            self.fail(&why.to_string());
        }
        self.named(Place::take_if_free);
        // The messages that were in a buffer when the device refused are in no file.
        let put = self.sheet.messages();
        let found = self.failure.as_ref().and(self.place.as_ref()).and_then(Place::messages);
        let messages = found.unwrap_or(put);
        let aside = self.place.filter(Place::waits).map(|place| place.at().to_owned());
        Written { messages, lost: put.saturating_sub(messages), failure: self.failure, aside }
    }

    fn named(&mut self, how: impl FnOnce(&mut Place) -> std::io::Result<()>) {
        if let Some(place) = &mut self.place
            && let Err(why) = how(place)
        {
            tracing::error!("{}: the recording cannot take its name: {why}", place.at().display());
        }
    }

    /// Without a file everything is lost: so many messages; a failure takes the file away.
    fn settle<F>(
        &mut self,
        file: &mut Option<F>,
        written: Option<Result<(), super::file::Unwritten>>,
        messages: u64,
    ) {
        match written {
            Some(Ok(())) => {}
            Some(Err(why)) => {
                self.counts.lost.fetch_add(1, Ordering::Relaxed);
                self.fail(&why.to_string());
                *file = None;
            }
            None => {
                self.counts.lost.fetch_add(messages, Ordering::Relaxed);
            }
        }
    }

    fn fail(&mut self, why: &str) {
        tracing::error!("the recording stops: {why}; the run goes on");
        self.failure.get_or_insert_with(|| why.to_owned());
    }
}
