//! A recording as it is read: message by message from its beginning, whole, cut off or damaged.
//!
//! - in: an MCAP file
//! - out: its messages in the order of the file, its metadata and attachments; and whether it ends as it should
//!
//! A chunk's messages are handed on once its checksum fits. Those of the chunk in which a file is cut off, which has none
//! any more, are handed on as they are, and so is what is beyond 8 MiB of a longer chunk: none of our own is so long.
//!
//! The index is not used: what a crash left has none, and the order of the file is the order of the run.

use super::cdr::Malformed;
use mcap::McapError;
use mcap::records::Record;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::{BTreeMap, VecDeque};
use std::fmt::{self, Display, Formatter};
use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Arc;

/// The longest record, and the longest chunk before and after compression (bytes). A length in the
/// file is not believed beyond it, so that no file takes unbounded memory.
const LONGEST: usize = 64 << 20;
/// What waits for the check of its chunk at most (bytes); a chunk of our own has a tenth of it.
const HELD: usize = 8 << 20;
/// The most bytes of all schemas and channels, which are kept to the end; our own files have some ten thousand.
const DESCRIBED: usize = 16 << 20;
/// What a message, a schema, a channel or a pair of texts costs beside its bytes, about.
const COST: usize = 128;
/// The most pairs of texts in a record: each costs ten times what it takes in the file.
const PAIRS: usize = 1 << 16;

/// What messages are like.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Schema {
    /// Type: `package/msg/Type`.
    pub kind: String,
    /// How its definition is written.
    pub encoding: String,
    /// Definition of the type.
    pub definition: Vec<u8>,
}

/// Where a message stands.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Channel {
    /// Topic.
    pub topic: String,
    /// Its type, which it may share with others.
    pub schema: Arc<Schema>,
    /// How messages are written.
    pub message_encoding: String,
    /// Other facts.
    pub metadata: BTreeMap<String, String>,
}

/// A message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// Where it stands.
    pub channel: Arc<Channel>,
    /// Its time (ns).
    pub time: u64,
    /// Its bytes.
    pub data: Vec<u8>,
}

/// What a file holds, piece by piece.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Piece {
    /// A message.
    Message(Message),
    /// Named texts.
    Metadata(String, BTreeMap<String, String>),
    /// A file in the file: name, media type, bytes.
    Attachment(String, String, Vec<u8>),
}

/// Why a recording cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum Unreadable {
    /// The file.
    #[error("{0}")]
    File(#[from] std::io::Error),
    /// Its contents.
    #[error("not a recording: {0}")]
    Format(String),
    /// A message.
    #[error("{topic}: {why}")]
    Message {
        /// Where.
        topic: String,
        /// Why.
        why: Malformed,
    },
    /// Something is missing in it.
    #[error("{0}")]
    Missing(String),
}

/// A file being read.
pub struct Reading<R> {
    from: R,
    reader: LinearReader,
    schemas: BTreeMap<u16, Arc<Schema>>,
    channels: BTreeMap<u16, Arc<Channel>>,
    /// Bytes of all schemas and channels so far.
    described: usize,
    /// Of a chunk whose checksum has not been seen yet, and how many bytes that is.
    held: (Vec<Piece>, usize),
    /// To be handed on.
    ready: VecDeque<Piece>,
    /// Bytes read so far, and where among the file's records they end.
    at: u64,
    frame: Frame,
    /// How the file ends: `None` while it is being read.
    end: Option<End>,
}

/// How a file ends.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum End {
    /// As it should.
    Whole,
    /// In the middle: it was cut off.
    Cut(String),
    /// Where something is not as it was written, or is no recording; what follows it is left out.
    Damaged(String),
}

impl End {
    /// Itself, if anything is wrong with the file.
    #[must_use]
    pub fn flaw(&self) -> Option<&Self> {
        Some(self).filter(|end| **end != Self::Whole)
    }

    /// With the time (s) at which it is: "cut off after 1.5 s: unexpected end".
    #[must_use]
    pub fn after(&self, seconds: f64) -> EndAfter<'_> {
        EndAfter { end: self, seconds }
    }

    /// How, when, and why; the alternate form has why in brackets, for what a sentence goes on behind.
    fn tell(&self, f: &mut Formatter<'_>, when: &dyn Display) -> fmt::Result {
        let (how, why) = match self {
            Self::Whole => return write!(f, "whole{when}"),
            Self::Cut(why) => ("cut off", why),
            Self::Damaged(why) => ("damaged", why),
        };
        if f.alternate() {
            write!(f, "{how}{when} ({why})")
        } else {
            write!(f, "{how}{when}: {why}")
        }
    }
}

impl Display for End {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        self.tell(f, &"")
    }
}

/// How a file ends, and when.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EndAfter<'a> {
    end: &'a End,
    seconds: f64,
}

impl Display for EndAfter<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        self.end.tell(f, &format_args!(" after {:.1} s", self.seconds))
    }
}

/// Opens a file.
///
/// # Errors
/// What the operating system says.
pub fn open(path: &Path) -> Result<Reading<std::fs::File>, Unreadable> {
    Ok(Reading::new(std::fs::File::open(path)?))
}

impl<R: Read> Reading<R> {
    /// Reads from anything.
    pub fn new(from: R) -> Self {
        // A chunk is read as far as it goes, and checked where it ends: a cut file has nothing there.
        let options = LinearReaderOptions::default()
            .with_validate_chunk_crcs(true)
            .with_validate_data_section_crc(true)
            .with_record_length_limit(LONGEST);
        Self {
            from,
            reader: LinearReader::new_with_options(options),
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            described: 0,
            held: (Vec::new(), 0),
            ready: VecDeque::new(),
            at: 0,
            frame: Frame::BEGIN,
            end: None,
        }
    }

    /// How the file ends; `None` before its end.
    pub fn end(&self) -> Option<&End> {
        if self.ready.is_empty() { self.end.as_ref() } else { None }
    }

    /// The file ends here: the check of what is held will not come.
    fn cut(&mut self, why: &dyn Display) {
        self.release();
        self.end = Some(End::Cut(why.to_string()));
    }

    /// Something is not as it was written: nothing of its chunk is believed.
    fn damaged(&mut self, why: &dyn Display) {
        self.held = (Vec::new(), 0);
        self.end = Some(End::Damaged(format!("before byte {}: {why}", self.at)));
    }

    fn release(&mut self) {
        self.ready.extend(self.held.0.drain(..));
        self.held.1 = 0;
    }

    /// One event further.
    fn advance(&mut self) {
        let event = match next(&mut self.reader) {
            None => {
                self.release();
                self.end = Some(End::Whole);
                return;
            }
            Some(Err(why @ McapError::UnexpectedEof)) => return self.cut(&why),
            Some(Err(why)) => return self.damaged(&why),
            Some(Ok(event)) => event,
        };
        match event {
            LinearReadEvent::ReadRequest(count) => {
                // More is wanted than the records up to here: their check is done.
                if self.frame.is_between() {
                    self.release();
                }
                let count = self.frame.room().min(count as u64) as usize;
                let into = self.reader.insert(count);
                match self.from.read(into) {
                    Ok(read) => {
                        self.frame.pass(&into[..read]);
                        self.at += read as u64;
                        self.reader.notify_read(read);
                        if self.frame.chunk_length().is_some_and(|length| length > LONGEST as u64) {
                            self.damaged(&"a chunk that is too long");
                        }
                    }
                    Err(why) => self.cut(&why),
                }
            }
            LinearReadEvent::Record { opcode, .. } if !READ.contains(&opcode) => {}
            LinearReadEvent::Record { opcode, data } => {
                if !lengths_fit(opcode, data) {
                    return self.damaged(&"a record whose lengths do not fit");
                }
                match mcap::parse_record(opcode, data).map(Record::into_owned) {
                    Ok(record) => self.take(record),
                    Err(why) => self.damaged(&why),
                }
            }
        }
    }

    fn take(&mut self, record: Record<'static>) {
        let piece = self.record(record);
        if self.described > DESCRIBED {
            return self.damaged(&"too many schemas and channels");
        }
        match piece {
            Some(Piece::Message(_)) if self.frame.is_stray() => {
                self.damaged(&"a message in no chunk");
            }
            Some(Piece::Message(message)) => {
                self.held.1 += message.data.len() + COST;
                self.held.0.push(Piece::Message(message));
                // Another program's chunk, or messages in none: memory comes before the check.
                if self.held.1 > HELD {
                    self.release();
                }
            }
            // The format has none there: a damaged chunk seems to hold it, or one that is made to fill the memory.
            Some(_) if self.frame.is_chunk() => {
                self.damaged(&"metadata or an attachment in a chunk");
            }
            Some(piece) => self.held.0.push(piece),
            None => {}
        }
    }

    fn record(&mut self, record: Record<'static>) -> Option<Piece> {
        match record {
            Record::Schema { header, data } => {
                let schema = Schema {
                    kind: header.name,
                    encoding: header.encoding,
                    definition: data.into_owned(),
                };
                // Other programs repeat them in each chunk.
                if self.schemas.get(&header.id).is_none_or(|known| **known != schema) {
                    let texts = schema.kind.len() + schema.encoding.len();
                    self.described += texts + schema.definition.len() + COST;
                    self.schemas.insert(header.id, Arc::new(schema));
                }
            }
            Record::Channel(channel) if !self.channels.contains_key(&channel.id) => {
                let pairs =
                    channel.metadata.iter().map(|(name, text)| name.len() + text.len() + COST);
                let texts = channel.topic.len() + channel.message_encoding.len();
                self.described += texts + pairs.sum::<usize>() + COST;
                let known = Channel {
                    topic: channel.topic,
                    schema: self.schemas.get(&channel.schema_id).cloned().unwrap_or_default(),
                    message_encoding: channel.message_encoding,
                    metadata: channel.metadata,
                };
                self.channels.insert(channel.id, Arc::new(known));
            }
            Record::Message { header, data } => {
                let channel = Arc::clone(self.channels.get(&header.channel_id)?);
                let message = Message { channel, time: header.log_time, data: data.into_owned() };
                return Some(Piece::Message(message));
            }
            Record::Metadata(metadata) => {
                return Some(Piece::Metadata(metadata.name, metadata.metadata));
            }
            Record::Attachment { header, data, .. } => {
                return Some(Piece::Attachment(header.name, header.media_type, data.into_owned()));
            }
            _ => {}
        }
        None
    }
}

/// What holds messages, compressed, with a check.
const CHUNK: u8 = 0x06;
/// Opcode and length of a record (bytes).
const PLAIN: usize = 9;

/// Where in a file its records begin and end, chunks as a whole: what a damaged chunk seems to hold says nothing of that.
#[derive(Debug)]
struct Frame {
    /// Opcode and length of the next one, and of a chunk its times and its length before compression; as far as they have
    /// come.
    head: [u8; 33],
    come: usize,
    /// Bytes of this one that are still to come.
    left: u64,
    /// There was a chunk.
    chunked: bool,
}

impl Frame {
    /// A file begins with eight bytes that are no record.
    const BEGIN: Self = Self { head: [0; 33], come: 0, left: 8, chunked: false };

    /// Whether this is no chunk in a file that has its messages in chunks.
    fn is_stray(&self) -> bool {
        self.chunked && !self.is_chunk()
    }

    fn is_chunk(&self) -> bool {
        self.head[0] == CHUNK
    }

    /// The longer one of a chunk's lengths, in the file and before compression; `None` of what is none, or has not begun.
    fn chunk_length(&self) -> Option<u64> {
        let (_, lengths) = self.head.split_first_chunk::<1>()?;
        let (within, behind) = lengths.split_first_chunk()?;
        let before = behind.last_chunk()?;
        let longer = u64::from_le_bytes(*within).max(u64::from_le_bytes(*before));
        (self.is_chunk() && self.come == 0).then_some(longer)
    }

    fn is_between(&self) -> bool {
        self.left == 0 && self.come == 0
    }

    /// How many bytes there are at most up to its next boundary.
    fn room(&self) -> u64 {
        if self.left > 0 { self.left } else { (self.wanted() - self.come) as u64 }
    }

    /// How much of a head is looked at.
    fn wanted(&self) -> usize {
        if self.come >= PLAIN && self.is_chunk() { self.head.len() } else { PLAIN }
    }

    /// These have come, no more than there was room for.
    fn pass(&mut self, bytes: &[u8]) {
        if self.left > 0 {
            self.left -= bytes.len() as u64;
            return;
        }
        self.head[self.come..][..bytes.len()].copy_from_slice(bytes);
        self.come += bytes.len();
        if self.come == self.wanted()
            && let Some((length, _)) = self.head[1..].split_first_chunk()
        {
            let more = (self.come - PLAIN) as u64;
            (self.come, self.left) = (0, u64::from_le_bytes(*length).saturating_sub(more));
            self.chunked |= self.is_chunk();
        }
    }
}

/// The reader's next event. The library counts a chunk's length down, below zero where a record in it is longer than the
/// chunk: with checked arithmetic a panic, which is the file's fault.
fn next(reader: &mut LinearReader) -> Option<mcap::McapResult<LinearReadEvent<'_>>> {
    let reader = AssertUnwindSafe(reader);
    let event = catch_unwind(move || {
        let reader = reader;
        reader.0.next_event()
    });
    event.unwrap_or(Some(Err(McapError::UnexpectedEoc)))
}

/// Records that say something: schema, channel, message, attachment, metadata.
const READ: [u8; 5] = [0x03, 0x04, 0x05, 0x09, 0x0c];

/// Whether what a record says of the lengths of its texts is true, and there is what must follow them: the library reserves
/// memory on its word, and panics where an attachment ends before its checksum.
fn lengths_fit(opcode: u8, data: &[u8]) -> bool {
    /// Takes a text, or all of a map, off the front.
    fn text<'a>(rest: &mut &'a [u8]) -> Option<&'a [u8]> {
        let (length, behind) = rest.split_first_chunk::<4>()?;
        let (text, behind) = behind.split_at_checked(u32::from_le_bytes(*length) as usize)?;
        *rest = behind;
        Some(text)
    }
    fn map(rest: &mut &[u8]) -> Option<()> {
        let mut pairs = text(rest)?;
        for _ in 0..=2 * PAIRS {
            if pairs.is_empty() {
                return Some(());
            }
            text(&mut pairs)?;
        }
        None
    }
    // What stands before the texts, how many follow, and what stands behind them at least: behind those of an attachment its
    // data's length and a checksum, behind those of a channel and of metadata a map.
    let (before, texts, has_map, behind) = match opcode {
        0x03 => (2, 3, false, 0),
        0x04 => (4, 2, true, 0),
        0x09 => (16, 2, false, 8 + 4),
        0x0c => (0, 1, true, 0),
        _ => return true,
    };
    let walk = || {
        let mut rest = data.get(before..)?;
        for _ in 0..texts {
            text(&mut rest)?;
        }
        if has_map {
            map(&mut rest)?;
        }
        (rest.len() >= behind).then_some(())
    };
    walk().is_some()
}

impl<R: Read> Iterator for Reading<R> {
    type Item = Piece;

    fn next(&mut self) -> Option<Piece> {
        while self.ready.is_empty() && self.end.is_none() {
            self.advance();
        }
        self.ready.pop_front()
    }
}

/// What a recording says of itself.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Label {
    /// Metadata by name: "`rubik_robot`", "options", "summary", "timing", "recording", "vision", "calibration".
    pub metadata: BTreeMap<String, BTreeMap<String, String>>,
    /// Text of the scenario.
    pub scenario: String,
}

impl Label {
    /// A fact of the run's beginning; empty when it is not there.
    #[must_use]
    pub fn fact(&self, name: &str) -> &str {
        self.of("rubik_robot", name)
    }

    /// A fact under a name; empty when it is not there.
    #[must_use]
    pub fn of(&self, metadata: &str, name: &str) -> &str {
        self.metadata.get(metadata).and_then(|m| m.get(name)).map_or("", String::as_str)
    }

    /// What overruled the scenario: option, key, value.
    #[must_use]
    pub fn options(&self) -> Vec<(String, String, String)> {
        let options = self.metadata.get("options").into_iter().flat_map(BTreeMap::values);
        options.filter_map(|text| serde_json::from_str(text).ok()).collect()
    }

    /// Takes a piece in, if it says anything about the whole.
    pub fn take(&mut self, piece: &Piece) {
        match piece {
            Piece::Metadata(name, facts) => {
                self.metadata.insert(name.clone(), facts.clone());
            }
            Piece::Attachment(name, _, data) if name == "scenario.toml" => {
                self.scenario = String::from_utf8_lossy(data).into_owned();
            }
            Piece::Attachment(..) | Piece::Message(_) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A record as it stands in a file.
    fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
        [&[opcode][..], &(body.len() as u64).to_le_bytes(), body].concat()
    }

    fn text(text: &[u8]) -> Vec<u8> {
        [&(text.len() as u32).to_le_bytes(), text].concat()
    }

    /// What a file of these records comes to: its pieces, and how it ends.
    fn read(records: &[Vec<u8>]) -> (Vec<Piece>, End) {
        let file = [mcap::MAGIC, &records.concat()[..]].concat();
        let mut reading = Reading::new(file.as_slice());
        (reading.by_ref().collect(), reading.end().unwrap().clone())
    }

    /// A chunk without compression that says of itself that it has `length` bytes.
    fn chunk(length: u64, records: &[u8]) -> Vec<u8> {
        let (times, no_sum) = ([0; 16], [0; 4]);
        let own = (records.len() as u64).to_le_bytes();
        let parts = [&times[..], &length.to_le_bytes(), &no_sum, &text(b""), &own, records];
        record(CHUNK, &parts.concat())
    }

    fn metadata(bytes: usize) -> Vec<u8> {
        let map = [text(b"name"), text(&vec![b'x'; bytes])].concat();
        record(0x0c, &[text(b"note"), text(&map)].concat())
    }

    fn schema(id: u16, bytes: usize) -> Vec<u8> {
        let texts = [text(b"p/msg/Type"), text(b"ros2msg"), text(&vec![b' '; bytes])].concat();
        record(0x03, &[&id.to_le_bytes()[..], &texts].concat())
    }

    fn channel(id: u16, schema: u16) -> Vec<u8> {
        let texts = [text(b"/topic"), text(b"cdr"), text(b"")].concat();
        record(0x04, &[&id.to_le_bytes()[..], &schema.to_le_bytes(), &texts].concat())
    }

    fn message(channel: u16) -> Vec<u8> {
        record(0x05, &[&channel.to_le_bytes()[..], &[0; 20], b"data"].concat())
    }

    #[test]
    fn an_attachment_that_ends_before_its_checksum_is_damage() {
        // Times, two empty texts, and no bytes of data: then up to four of a checksum.
        for behind in 0..4 {
            let (pieces, end) = read(&[record(0x09, &vec![0; 32 + behind])]);
            assert!(pieces.is_empty() && matches!(end, End::Damaged(_)), "{behind}: {end:?}");
        }
        let (pieces, _) = read(&[record(0x09, &[0; 36])]);
        assert_eq!(pieces, [Piece::Attachment(String::new(), String::new(), Vec::new())]);
    }

    #[test]
    fn channels_share_a_schema_and_none_beyond_a_limit_is_taken() {
        let records = [schema(1, 1000), channel(1, 1), channel(2, 1), message(1), message(2)];
        let (pieces, _) = read(&records);
        let [Piece::Message(one), Piece::Message(other)] = pieces.as_slice() else {
            panic!("{pieces:?}")
        };
        assert!(Arc::ptr_eq(&one.channel.schema, &other.channel.schema));
        assert_eq!(one.channel.schema.definition.len(), 1000);

        let many = |different| -> Vec<_> {
            (0..40).map(|id: u16| schema(if different { id } else { 1 }, DESCRIBED / 20)).collect()
        };
        let (_, end) = read(&many(true));
        assert!(matches!(&end, End::Damaged(why) if why.contains("too many schemas")), "{end:?}");
        // What is repeated costs nothing.
        assert!(matches!(read(&many(false)).1, End::Cut(_)));
    }

    #[test]
    fn a_chunk_that_is_longer_than_any_of_ours_is_refused_at_its_head() {
        let long = LONGEST as u64 + 1;
        let (_, end) = read(&[chunk(long, b"")]);
        assert!(matches!(&end, End::Damaged(why) if why.contains("too long")), "{end:?}");
        // By its length in the file, which is not there.
        let mut head = chunk(0, b"");
        head[1..9].copy_from_slice(&long.to_le_bytes());
        let (_, end) = read(&[head]);
        assert!(matches!(&end, End::Damaged(why) if why.contains("too long")), "{end:?}");
        let held = [schema(1, 9), channel(1, 1), message(1)].concat();
        let (pieces, end) = read(&[chunk(held.len() as u64, &held)]);
        assert!(pieces.len() == 1 && matches!(end, End::Cut(_)), "{pieces:?}, {end:?}");
    }

    #[test]
    fn metadata_stand_between_chunks_and_in_none() {
        let (pieces, end) = read(&[metadata(9), metadata(9)]);
        assert!(pieces.len() == 2 && matches!(end, End::Cut(_)), "{pieces:?}, {end:?}");

        let inside = metadata(9);
        let (pieces, end) = read(&[chunk(inside.len() as u64, &inside)]);
        assert!(pieces.is_empty() && matches!(end, End::Damaged(_)), "{pieces:?}, {end:?}");
    }

    #[test]
    fn a_record_has_no_endless_list_of_texts() {
        let list = |pairs: usize| {
            let pair = |i: usize| [text(i.to_string().as_bytes()), text(b"")].concat();
            let map = (0..pairs).flat_map(pair).collect::<Vec<u8>>();
            read(&[record(0x0c, &[text(b"note"), text(&map)].concat())])
        };
        assert_eq!(list(PAIRS).0.len(), 1);
        let (pieces, end) = list(PAIRS + 1);
        assert!(pieces.is_empty() && matches!(end, End::Damaged(_)), "{end:?}");
    }
}
