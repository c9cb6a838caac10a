//! Recorder of a run: a thread that writes the file, and the handles by which the run feeds it.
//!
//! - in: servo records through a ring buffer, everything else through a bounded queue
//! - out: an MCAP file ([`super::sheet`] has its topics), and [`Written`]: the number of messages
//!   that were written and lost
//!
//! On the wall clock no actor waits for the recorder: messages for which ring or queue have no room
//! are left out and counted. On the virtual clock the run waits instead, so that no message is
//! lost; virtual time does not pass meanwhile. If the device fails, the recorder stops writing and
//! counts all further messages as lost, and the run continues. Then the recorder reads the file in
//! order to count the messages in it.

pub use super::entry::Entry;

use super::feed::Feed;
use super::file::File;
use super::place::Place;
use super::sheet::{MessageWriter, RunInfo};
use crate::cell::MOST_ARMS;
use crate::hw::driver::{RecordSink, ServoRecord};
use crate::hw::storage::{Storage, StorageFault};
use std::io::{Seek, SeekFrom, Write};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Capacity of the ring (servo records): four seconds of all arms with a servo period of 2 ms.
const TICKS: usize = 2048 * MOST_ARMS;
/// Capacity of the queue (entries).
const QUEUE: usize = 1024;
/// Largest number of pictures in the queue, which take about 30 MB.
const PICTURES: u64 = 32;
/// Time that the recorder sleeps if there is nothing to write.
const NAP: Duration = Duration::from_millis(2);

/// Result of a recording.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Written {
    /// Number of messages in the file.
    pub messages: u64,
    /// Number of messages that were lost.
    pub lost: u64,
    /// Error of the device, if it failed.
    pub failure: Option<String>,
    /// Path of the recording if it keeps its temporary one: it holds no servo period, or could not
    /// be renamed.
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

/// Behaviour of the run if the recorder does not keep up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Patience {
    /// The run waits until there is room; for the virtual clock.
    Waits,
    /// The run never waits: messages without room are lost; for the wall clock.
    Never,
}

/// Handle by which a run records. All clones write to the same file. [`Recorder::default`] records
/// nothing.
#[derive(Clone, Default)]
pub struct Recorder(Option<Arc<Shared>>);

/// Data that all clones of a [`Recorder`] share.
struct Shared {
    /// Queue of the entries, each with its period of 2 ms.
    queue: SyncSender<(u64, Entry)>,
    /// End of the ring for the servo; `None` once [`Recorder::ticks`] has given it away.
    ticks: Mutex<Option<rtrb::Producer<ServoRecord>>>,
    patience: Patience,
    counts: Arc<Counts>,
    /// Thread of the recorder; `None` once it has been joined.
    thread: Mutex<Option<JoinHandle<Written>>>,
    /// Storage of the file, in which faults can be injected.
    storage: Storage,
}

/// Device of the recording, with the fault that its storage has at present.
struct Device<W> {
    to: W,
    storage: Storage,
}

impl<W: Write + Seek> Write for Device<W> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        match self.storage.fault() {
            None => return self.to.write(bytes),
            // Lost bytes leave a gap in the file: the next ones are written behind it.
            Some(StorageFault::Lost) => {
                self.to.seek(SeekFrom::Current(bytes.len() as i64))?;
            }
            Some(_) => self.storage.write(bytes, |part| self.to.write_all(part))?,
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.to.flush()
    }
}

impl<W: Seek> Seek for Device<W> {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.to.seek(to)
    }
}

/// Counts and flags that the run and the recorder's thread share.
#[derive(Default)]
struct Counts {
    /// Number of lost messages.
    lost: AtomicU64,
    /// Number of pictures in the queue.
    pictures: AtomicU64,
    /// Whether the run is over.
    over: AtomicBool,
    /// Latest period of 2 ms of an entry.
    latest: AtomicU64,
}

/// Handle by which the servo records its periods: one end of a ring buffer.
pub struct Ticks {
    ring: rtrb::Producer<ServoRecord>,
    patience: Patience,
    counts: Arc<Counts>,
}

impl Recorder {
    /// Returns the storage of the recording, in which faults can be injected; `None` if nothing is
    /// recorded.
    #[must_use]
    pub fn storage(&self) -> Option<Storage> {
        self.0.as_ref().map(|shared| shared.storage.clone())
    }

    /// Starts a recorder that writes to `to`. `about` describes the run; `patience` tells whether
    /// the run waits if the recorder does not keep up.
    ///
    /// # Errors
    /// Error of the operating system if it cannot start the thread.
    pub fn begin<W: Write + Seek + Send + 'static>(
        to: W,
        about: RunInfo,
        patience: Patience,
    ) -> std::io::Result<Self> {
        Self::begin_at(Some((to, None)), None, about, patience)
    }

    /// Starts a recorder without a file, whose messages only the `feed` gets.
    ///
    /// # Errors
    /// Error of the operating system if it cannot start the thread.
    pub(crate) fn begin_feed(feed: Feed, about: RunInfo) -> std::io::Result<Self> {
        // A feed may miss messages, but a run must not wait for it.
        Self::begin_at(None::<(std::io::Cursor<Vec<u8>>, _)>, Some(feed), about, Patience::Never)
    }

    /// Starts a recorder as [`Self::begin`] does, to a file if there is one, and to a `feed`. The
    /// place of the file has its final and its temporary path: it is renamed to the final one as
    /// soon as it holds a servo period.
    ///
    /// # Errors
    /// Error of the operating system if it cannot start the thread.
    pub(crate) fn begin_at<W: Write + Seek + Send + 'static>(
        to: Option<(W, Option<Place>)>,
        feed: Option<Feed>,
        about: RunInfo,
        patience: Patience,
    ) -> std::io::Result<Self> {
        let (queue, entries) = sync_channel(QUEUE);
        let storage = Storage::default();
        let (to, place) = to.map_or((None, None), |(to, place)| (Some(to), place));
        let to = to.map(|to| Device { to, storage: storage.clone() });
        let (ticks, records) = rtrb::RingBuffer::new(TICKS);
        let counts = Arc::new(Counts::default());
        let thread = std::thread::Builder::new().name("recorder".into()).spawn({
            let counts = Arc::clone(&counts);
            move || {
                Clerk {
                    writer: MessageWriter::new(about),
                    counts,
                    failure: None,
                    place,
                    feed,
                    begins: true,
                }
                .work(to, records, &entries)
            }
        })?;
        Ok(Self(Some(Arc::new(Shared {
            queue,
            ticks: Mutex::new(Some(ticks)),
            patience,
            counts,
            thread: Mutex::new(Some(thread)),
            storage,
        }))))
    }

    /// Returns the handle by which the servo records its periods. `None` if nothing is recorded, or
    /// at a second call.
    #[must_use]
    pub fn ticks(&self) -> Option<Ticks> {
        let shared = self.0.as_ref()?;
        let ring = shared.ticks.lock().unwrap_or_else(PoisonError::into_inner).take()?;
        Some(Ticks { ring, patience: shared.patience, counts: Arc::clone(&shared.counts) })
    }

    /// Checks whether anything is recorded.
    #[must_use]
    pub(crate) fn is_on(&self) -> bool {
        self.0.is_some()
    }

    /// Returns the number of the latest period of 2 ms in which anything but a servo record was
    /// recorded; 0 if there was none.
    #[must_use]
    pub(crate) fn latest(&self) -> u64 {
        self.0.as_ref().map_or(0, |shared| shared.counts.latest.load(Ordering::Relaxed))
    }

    /// Records the entry that `entry` returns. Its time is the beginning of the period of 2 ms with
    /// the number `period`. `entry` is not called if nothing is recorded.
    pub fn record(&self, period: u64, entry: impl FnOnce() -> Entry) {
        self.record_some(period, || Some(entry()));
    }

    /// Records the entry that `entry` returns, if any, as [`Self::record`] does.
    pub(crate) fn record_some(&self, period: u64, entry: impl FnOnce() -> Option<Entry>) {
        let Some(shared) = &self.0 else { return };
        let Some(entry) = entry() else { return };
        shared.counts.latest.fetch_max(period, Ordering::Relaxed);
        let picture = matches!(entry, Entry::Picture(..));
        // Pictures have a limit of their own: 1024 of them would take 1 GB.
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
            // The recorder counts down only the pictures that it receives.
            if picture {
                shared.counts.pictures.fetch_sub(1, Ordering::AcqRel);
            }
        }
    }

    /// Ends the file and returns the result. `None` if nothing was recorded, or at a second call.
    #[must_use]
    pub fn finish(&self) -> Option<Written> {
        let shared = self.0.as_ref()?;
        let thread = shared.thread.lock().unwrap_or_else(PoisonError::into_inner).take()?;
        shared.counts.over.store(true, Ordering::Release);
        // A panic of the recorder's thread must not end the run.
        let mut written = thread.join().unwrap_or_else(|_| Written {
            failure: Some("the thread of the recorder panicked".to_owned()),
            ..Written::default()
        });
        written.lost += shared.counts.lost.load(Ordering::Acquire);
        Some(written)
    }
}

impl Shared {
    /// Counts a lost message.
    fn lose(&self) {
        self.counts.lost.fetch_add(1, Ordering::Relaxed);
    }
}

impl std::fmt::Debug for Recorder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Recorder").field("on", &self.is_on()).finish_non_exhaustive()
    }
}

/// The servo's drivers of both clocks record through this sink. On the wall clock the real-time
/// thread calls it, so it must not wait, lock or allocate.
impl RecordSink for Ticks {
    fn record(&mut self, record: &ServoRecord) {
        let mut rest = *record;
        while let Err(rtrb::PushError::Full(back)) = self.ring.push(rest) {
            // If the recorder's thread has ended, a run that waits would wait for ever.
            if self.patience == Patience::Never || self.ring.is_abandoned() {
                self.counts.lost.fetch_add(1, Ordering::Relaxed);
                return;
            }
            rest = back;
            std::thread::sleep(NAP / 20);
        }
    }
}

/// Sink that passes each record to two sinks.
pub struct Both(pub Box<dyn RecordSink>, pub Box<dyn RecordSink>);

impl RecordSink for Both {
    fn record(&mut self, record: &ServoRecord) {
        self.0.record(record);
        self.1.record(record);
    }
}

/// State of the recorder's thread.
struct Clerk {
    writer: MessageWriter,
    counts: Arc<Counts>,
    /// First failure, which ended the writing.
    failure: Option<String>,
    /// Paths of the file; `None` if the file is not to be renamed.
    place: Option<Place>,
    /// Feed that gets the messages as well.
    feed: Option<Feed>,
    /// Whether no servo record has been written yet.
    begins: bool,
}

/// Next item that the recorder has to write.
enum Next {
    Entry(u64, Entry),
    Record(ServoRecord),
    Nothing,
}

impl Clerk {
    /// Writes all servo records and entries until the run is over, and ends the file.
    fn work<W: Write + Seek>(
        mut self,
        to: Option<W>,
        mut records: rtrb::Consumer<ServoRecord>,
        entries: &Receiver<(u64, Entry)>,
    ) -> Written {
        let mut file = self.begin(to);
        let mut waiting: Option<(u64, Entry)> = None;
        loop {
            // The flag is read first: an item that comes between the two reads is still written.
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

    /// Begins the file. Returns `None` if that fails; all messages are then counted as lost.
    fn begin<W: Write + Seek>(&mut self, to: Option<W>) -> Option<File<W>> {
        let begun = File::begin_with(to, self.feed.take()).map_err(|why| why.to_string()).and_then(
            |mut file| {
                self.writer.begin(&mut file).map_err(|why| why.to_string())?;
                Ok(file)
            },
        );
        begun.map_err(|why| self.fail(&why)).ok()
    }

    /// Returns the next entry or servo record in the order of the run's periods. `waiting` keeps an
    /// entry that was received but comes after the next record.
    ///
    /// The records of a period are in the ring before any actor sends an entry of that period. So,
    /// once an entry is received, all records that belong before it are in the ring, and the ring
    /// is checked again.
    fn next(
        &self,
        records: &mut rtrb::Consumer<ServoRecord>,
        entries: &Receiver<(u64, Entry)>,
        waiting: &mut Option<(u64, Entry)>,
    ) -> Next {
        // Period of 2 ms of the next record in the ring.
        let next = |records: &mut rtrb::Consumer<ServoRecord>| {
            records.peek().ok().map(|r| self.writer.tick_of(r.period))
        };
        let mut record = next(records);
        if waiting.is_none() {
            *waiting = entries.try_recv().ok();
            record = record.or_else(|| next(records));
        }
        if let Some((period, entry)) = waiting.take_if(|w| record.is_none_or(|r| w.0 < r)) {
            return Next::Entry(period, entry);
        }
        // A record that arrived after the ring was checked may follow an entry that is still in the
        // queue. So such a record waits for the next call.
        if record.is_none() {
            return Next::Nothing;
        }
        records.pop().map_or(Next::Nothing, Next::Record)
    }

    /// Writes an entry, or counts it as lost.
    fn entry<W: Write + Seek>(&mut self, period: u64, entry: &Entry, file: &mut Option<File<W>>) {
        if matches!(entry, Entry::Picture(..)) {
            self.counts.pictures.fetch_sub(1, Ordering::AcqRel);
        }
        let written = file.as_mut().map(|file| self.writer.entry(period, entry, file));
        self.settle(file, written, 1);
    }

    /// Writes a servo record, or counts its messages as lost. After the first servo record the file
    /// takes its final path.
    fn record<W: Write + Seek>(&mut self, record: &ServoRecord, file: &mut Option<File<W>>) {
        let first = std::mem::take(&mut self.begins);
        let written = file.as_mut().map(|file| {
            self.writer.tick(record, file)?;
            // The file may replace an older one only if it can be read, so its chunk is ended
            // first.
            if first { file.flush() } else { Ok(()) }
        });
        if first && matches!(written, Some(Ok(()))) {
            self.rename(Place::rename_to_final);
        }
        let lost = self.writer.messages_of(record);
        self.settle(file, written, lost);
    }

    /// Writes the numbers of written and lost messages and the times of reading faces, ends the
    /// file and gives it its final path. Returns the result of the recording.
    fn end<W: Write + Seek>(mut self, file: Option<File<W>>) -> Written {
        let lost = self.counts.lost.load(Ordering::Acquire).to_string();
        let count = [("messages", self.writer.messages().to_string()), ("lost", lost)];
        let count = count.map(|(name, value)| (name.to_owned(), value)).into();
        if let Some(mut file) = file
            && let Err(why) = (file.metadata("recording", &count))
                .and_then(|()| file.metadata("vision", &self.writer.vision()))
                .and_then(|()| file.finish())
        {
            self.fail(&why.to_string());
        }
        if let Some(Err(why)) = self.place.as_ref().map(Place::sync) {
            self.fail(&why.to_string());
        }
        // A recording without a servo period takes its final path only if that replaces no other
        // recording.
        self.rename(Place::rename_if_free);
        // Messages that were in a buffer when the device failed are not in the file.
        let put = self.writer.messages();
        let found = self.failure.as_ref().and(self.place.as_ref()).and_then(Place::messages);
        let messages = found.unwrap_or(put);
        let aside = self.place.filter(Place::is_temporary).map(|place| place.at().to_owned());
        Written { messages, lost: put.saturating_sub(messages), failure: self.failure, aside }
    }

    /// Renames the file to its final path by calling `how`. If that fails, the file keeps its
    /// temporary path; the failure is logged and kept for the result.
    fn rename(&mut self, how: impl FnOnce(&mut Place) -> std::io::Result<()>) {
        if let Some(place) = &mut self.place
            && let Err(why) = how(place)
        {
            let at = place.at().display();
            let why = format!("{at}: the recording cannot be renamed to its final path: {why}");
            tracing::error!("{why}");
            self.failure.get_or_insert(why);
        }
    }

    /// Handles the result of writing an item that consists of `messages` messages. `written` is
    /// `None` if an earlier failure ended the writing; all messages of the item are then lost. A
    /// failure ends the writing to the file.
    fn settle<F>(
        &mut self,
        file: &mut Option<F>,
        written: Option<Result<(), super::file::Unwritten>>,
        messages: u64,
    ) {
        match written {
            Some(Ok(())) => {}
            // Counts the message that failed. The number of messages that would have followed it
            // in its item is not known here.
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

    /// Logs a failure, and keeps it for the result if it is the first one.
    fn fail(&mut self, why: &str) {
        tracing::error!("the recording stops: {why}; the run continues");
        self.failure.get_or_insert_with(|| why.to_owned());
    }
}
