//! Reader of a recording that may be whole, cut off or damaged, message by message from its
//! beginning.
//!
//! - in: an MCAP file
//! - out: its messages in the order of the file, its metadata and attachments; and how it ends
//!
//! The messages of a chunk are delivered once its checksum is verified. There are two exceptions:
//! the last chunk of a file that is cut off has no checksum any more, and a chunk of another
//! program may be longer than `HELD`. Their messages are delivered without a check.
//!
//! The index is not used: after a crash there is none, and the order of the file is the order of
//! the run.
//!
//! The file may come from anywhere, so its numbers are not trusted beyond these limits:
//!
//! | quantity | limit | reason |
//! |---|---|---|
//! | length of a record or chunk | `LONGEST` | the library reserves that much memory |
//! | messages that wait for a check | `HELD` | they are all in memory |
//! | all schemas and channels | `DESCRIBED` | they are kept to the end of the file |
//! | pairs of texts in a record | `PAIRS` | in memory a map takes ten times its size in the file |

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

/// Largest length of a record, and of a chunk before and after compression (bytes).
const LONGEST: usize = 64 << 20;
/// Largest size of the messages that wait for the check of their chunk (bytes). A chunk of this
/// program has a tenth of it.
const HELD: usize = 8 << 20;
/// Largest size of all schemas and channels (bytes). Those of this program have some ten thousand.
const DESCRIBED: usize = 16 << 20;
/// Estimated memory of a message, a schema, a channel or a pair of texts besides its data (bytes).
const COST: usize = 128;
/// Largest number of pairs of texts in a record.
const PAIRS: usize = 1 << 16;

/// Type of messages.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Schema {
    /// Name of the type: `package/msg/Type`.
    pub kind: String,
    /// Language of the definition.
    pub encoding: String,
    /// Definition of the type.
    pub definition: Vec<u8>,
}

/// Channel of messages.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Channel {
    /// Topic.
    pub topic: String,
    /// Type of the messages; channels may share it.
    pub schema: Arc<Schema>,
    /// Encoding of the messages.
    pub message_encoding: String,
    /// Other facts by name.
    pub metadata: BTreeMap<String, String>,
}

/// Message of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// Channel of the message.
    pub channel: Arc<Channel>,
    /// Time (ns).
    pub time: u64,
    /// Encoded fields.
    pub data: Vec<u8>,
}

/// One item of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Piece {
    /// Message.
    Message(Message),
    /// Texts by name, under a common name.
    Metadata(String, BTreeMap<String, String>),
    /// File in the recording: name, media type, bytes.
    Attachment(String, String, Vec<u8>),
}

/// Reason why a recording cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum Unreadable {
    /// Error of the operating system.
    #[error("{0}")]
    File(#[from] std::io::Error),
    /// Content that is no recording.
    #[error("not a recording: {0}")]
    Format(String),
    /// Message that is not of its type.
    #[error("{topic}: {why}")]
    Message {
        /// Topic of the message.
        topic: String,
        /// Error of the decoder.
        why: Malformed,
    },
    /// Description of a required item that is missing.
    #[error("{0}")]
    Missing(String),
}

/// Recording that is being read; an iterator over its items.
pub struct Reading<R> {
    from: R,
    reader: LinearReader,
    schemas: BTreeMap<u16, Arc<Schema>>,
    channels: BTreeMap<u16, Arc<Channel>>,
    /// Size of all schemas and channels that were read (bytes).
    described: usize,
    /// Items that wait for the check of their chunk, and their size (bytes).
    held: (Vec<Piece>, usize),
    /// Items to be delivered.
    ready: VecDeque<Piece>,
    /// Number of bytes that were read.
    at: u64,
    /// Position of the last byte among the records of the file.
    frame: Frame,
    /// End of the file; `None` while it is being read.
    end: Option<End>,
}

/// End of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum End {
    /// Regular end.
    Whole,
    /// End in the middle, with the reason: the file was cut off.
    Cut(String),
    /// First place where the file is damaged or is no recording, with the reason. The rest is left
    /// out.
    Damaged(String),
}

impl End {
    /// Returns this end of a file if the file is cut off or damaged; `None` if it is whole.
    #[must_use]
    pub fn flaw(&self) -> Option<&Self> {
        Some(self).filter(|end| **end != Self::Whole)
    }

    /// Returns this end with the time at which the file ends (s), for a text as "cut off after 1.5
    /// s: unexpected end".
    #[must_use]
    pub fn after(&self, seconds: f64) -> EndAfter<'_> {
        EndAfter { end: self, seconds }
    }

    /// Writes kind, time (`when`) and reason of the end. The alternate form `{:#}` has the reason
    /// in brackets, so that a sentence can continue after it.
    fn describe(&self, f: &mut Formatter<'_>, when: &dyn Display) -> fmt::Result {
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
        self.describe(f, &"")
    }
}

/// End of a file with its time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EndAfter<'a> {
    end: &'a End,
    seconds: f64,
}

impl Display for EndAfter<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        self.end.describe(f, &format_args!(" after {:.1} s", self.seconds))
    }
}

/// Opens a recording.
///
/// # Errors
/// Error of the operating system.
pub fn open(path: &Path) -> Result<Reading<std::fs::File>, Unreadable> {
    Ok(Reading::new(std::fs::File::open(path)?))
}

impl<R: Read> Reading<R> {
    /// Makes a reader of a recording, which may be whole, cut off or damaged.
    pub fn new(from: R) -> Self {
        // The library checks a chunk at its end. Reading the whole chunk first, as the other option
        // does, would lose the last chunk of a file that is cut off.
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

    /// Returns how the file ends: whole, cut off or damaged; `None` before all items have been
    /// delivered.
    pub fn end(&self) -> Option<&End> {
        if self.ready.is_empty() { self.end.as_ref() } else { None }
    }

    /// Ends the reading of a file that is cut off, for the reason `why`. The items that wait for
    /// the check of their chunk are delivered unchecked, since its checksum is missing.
    fn cut(&mut self, why: &dyn Display) {
        self.release();
        self.end = Some(End::Cut(why.to_string()));
    }

    /// Ends the reading of a damaged file, for the reason `why`. Drops the items of the damaged
    /// chunk.
    fn damaged(&mut self, why: &dyn Display) {
        self.held = (Vec::new(), 0);
        self.end = Some(End::Damaged(format!("before byte {}: {why}", self.at)));
    }

    /// Delivers the items that have waited for the check of their chunk.
    fn release(&mut self) {
        self.ready.extend(self.held.0.drain(..));
        self.held.1 = 0;
    }

    /// Handles the next event of the MCAP library's reader: reads bytes that it requests, or takes
    /// a record that it has parsed.
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
                // A request for more at a boundary means that the records up to here are checked.
                if self.frame.is_at_boundary() {
                    self.release();
                }
                // No read passes a boundary, so that the check above sees each of them.
                let count = self.frame.left_to_boundary().min(count as u64) as usize;
                let into = self.reader.insert(count);
                match self.from.read(into) {
                    Ok(read) => {
                        self.frame.pass(&into[..read]);
                        self.at += read as u64;
                        self.reader.notify_read(read);
                        // The limit that the library takes does not apply to chunks.
                        if self.frame.chunk_length().is_some_and(|length| length > LONGEST as u64) {
                            self.damaged(&"a chunk that is too long");
                        }
                    }
                    Err(why) => self.cut(&why),
                }
            }
            // Records that are not used: the index, statistics.
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

    /// Takes a record that the library has parsed. Its item waits for the check of its chunk; a
    /// record that must not be at this position ends the reading as damage.
    fn take(&mut self, record: Record<'static>) {
        let piece = self.record(record);
        if self.described > DESCRIBED {
            return self.damaged(&"too many schemas and channels");
        }
        match piece {
            // This program writes messages in chunks only. A flipped bit can make the index of a
            // chunk look like a message.
            Some(Piece::Message(_)) if self.frame.is_outside_chunks() => {
                self.damaged(&"a message in no chunk");
            }
            Some(Piece::Message(message)) => {
                self.held.1 += message.data.len() + COST;
                self.held.0.push(Piece::Message(message));
                // A longer chunk of another program, or messages outside of chunks: the limit of
                // memory comes before the check.
                if self.held.1 > HELD {
                    self.release();
                }
            }
            // The format allows neither in a chunk. The chunk is damaged, or made to fill the
            // memory: the size of these items is not counted.
            Some(_) if self.frame.is_chunk() => {
                self.damaged(&"metadata or an attachment in a chunk");
            }
            Some(piece) => self.held.0.push(piece),
            None => {}
        }
    }

    /// Converts a record to an item of the recording. Returns `None` for a schema or a channel,
    /// which is stored for later messages, and for a record that is not used.
    fn record(&mut self, record: Record<'static>) -> Option<Piece> {
        match record {
            Record::Schema { header, data } => {
                let schema = Schema {
                    kind: header.name,
                    encoding: header.encoding,
                    definition: data.into_owned(),
                };
                // Other programs repeat their schemas in each chunk. Only new ones count.
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
                // A message without a channel has no type. It is left out.
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

/// Opcode of a chunk: compressed messages with a checksum.
const CHUNK: u8 = 0x06;
/// Size of opcode and length of a record (bytes).
const PLAIN: usize = 9;

/// Position among the records of a file. A chunk is one record here: the library reports the
/// records in a chunk, but those of a damaged chunk do not show where the chunk ends.
#[derive(Debug)]
struct Frame {
    /// Opcode and length of the next record; of a chunk also its times and its length before
    /// compression. The first `received` bytes are valid.
    head: [u8; 33],
    received: usize,
    /// Bytes of the present record that have not been read yet.
    left: u64,
    /// Whether there was a chunk.
    chunked: bool,
}

impl Frame {
    /// Beginning of a file: eight bytes of magic that are no record.
    const BEGIN: Self = Self { head: [0; 33], received: 0, left: 8, chunked: false };

    /// Checks whether the current record is outside of all chunks although the file has had a
    /// chunk.
    fn is_outside_chunks(&self) -> bool {
        self.chunked && !self.is_chunk()
    }

    fn is_chunk(&self) -> bool {
        self.head[0] == CHUNK
    }

    /// Returns the greater one of a chunk's two lengths, compressed and uncompressed (bytes);
    /// `None` if the current record is no chunk, or its head is not complete.
    fn chunk_length(&self) -> Option<u64> {
        let (_, lengths) = self.head.split_first_chunk::<1>()?;
        let (within, behind) = lengths.split_first_chunk()?;
        let before = behind.last_chunk()?;
        let longer = u64::from_le_bytes(*within).max(u64::from_le_bytes(*before));
        // The head is complete once its counter has been reset.
        (self.is_chunk() && self.received == 0).then_some(longer)
    }

    /// Checks whether the reading is between two records: the last one is complete and the next one
    /// has not begun.
    fn is_at_boundary(&self) -> bool {
        self.left == 0 && self.received == 0
    }

    /// Returns how many bytes of the current record are left to read: of its head until that is
    /// complete, then of its body.
    fn left_to_boundary(&self) -> u64 {
        if self.left > 0 { self.left } else { (self.head_length() - self.received) as u64 }
    }

    /// Returns the length of the current record's head (bytes): opcode and length, and of a chunk
    /// also its times and its uncompressed length.
    fn head_length(&self) -> usize {
        if self.received >= PLAIN && self.is_chunk() { self.head.len() } else { PLAIN }
    }

    /// Moves the reading past `bytes`, of which there are at most [`Self::left_to_boundary`].
    fn pass(&mut self, bytes: &[u8]) {
        if self.left > 0 {
            self.left -= bytes.len() as u64;
            return;
        }
        self.head[self.received..][..bytes.len()].copy_from_slice(bytes);
        self.received += bytes.len();
        if self.received == self.head_length()
            && let Some((length, _)) = self.head[1..].split_first_chunk()
        {
            // The length counts the bytes after itself, and the head of a chunk is part of it.
            let more = (self.received - PLAIN) as u64;
            (self.received, self.left) = (0, u64::from_le_bytes(*length).saturating_sub(more));
            self.chunked |= self.is_chunk();
        }
    }
}

/// Returns the next event of the library's reader. A panic of the library is an error of the file:
/// the reader subtracts each record from the length of its chunk, and with checked arithmetic it
/// panics if a record is longer than its chunk.
fn next(reader: &mut LinearReader) -> Option<mcap::McapResult<LinearReadEvent<'_>>> {
    let reader = AssertUnwindSafe(reader);
    let event = catch_unwind(move || {
        let reader = reader;
        reader.0.next_event()
    });
    event.unwrap_or(Some(Err(McapError::UnexpectedEoc)))
}

/// Opcodes of the records that are used: schema, channel, message, attachment, metadata.
const READ: [u8; 5] = [0x03, 0x04, 0x05, 0x09, 0x0c];

/// Checks that the texts and maps of a record end within it, and that enough bytes follow for its
/// last fields. The library trusts these lengths when it reserves memory, and panics if an
/// attachment ends before its checksum.
fn lengths_fit(opcode: u8, data: &[u8]) -> bool {
    /// Splits a text, or a whole map, off the front of `rest`, by the length that precedes it.
    /// `None` if it does not end within `rest`.
    fn text<'a>(rest: &mut &'a [u8]) -> Option<&'a [u8]> {
        let (length, behind) = rest.split_first_chunk::<4>()?;
        let (text, behind) = behind.split_at_checked(u32::from_le_bytes(*length) as usize)?;
        *rest = behind;
        Some(text)
    }
    /// Splits a map off the front of `rest`. `None` if it has more than [`PAIRS`] pairs or does not
    /// end within `rest`.
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
    // Bytes before the texts, number of texts, whether a map follows them, and the least number of
    // bytes after them. After the texts of an attachment are the length of its data (8 bytes) and
    // a checksum (4 bytes).
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

/// Description of a recording, from its metadata and attachments.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Label {
    /// Metadata by name: "`rubik_robot`", "options", "summary", "timing", "recording", "vision",
    /// "calibration".
    pub metadata: BTreeMap<String, BTreeMap<String, String>>,
    /// Text of the scenario.
    pub scenario: String,
}

impl Label {
    /// Returns a fact about the run that is written at its beginning, such as "seed"; empty if
    /// there is none of this name.
    #[must_use]
    pub fn fact(&self, name: &str) -> &str {
        self.of("rubik_robot", name)
    }

    /// Returns the text `name` of the metadata record `metadata`; empty if there is none.
    #[must_use]
    pub fn of(&self, metadata: &str, name: &str) -> &str {
        self.metadata.get(metadata).and_then(|m| m.get(name)).map_or("", String::as_str)
    }

    /// Returns the command line options with which the run overrode its scenario: option, key,
    /// value.
    #[must_use]
    pub fn options(&self) -> Vec<(String, String, String)> {
        let options = self.metadata.get("options").into_iter().flat_map(BTreeMap::values);
        options.filter_map(|text| serde_json::from_str(text).ok()).collect()
    }

    /// Stores an item of the recording if it is metadata or the scenario's file, which describe the
    /// whole recording; ignores any other.
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

    /// Encodes a record as in an MCAP file: opcode, length, body.
    fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
        [&[opcode][..], &(body.len() as u64).to_le_bytes(), body].concat()
    }

    fn text(text: &[u8]) -> Vec<u8> {
        [&(text.len() as u32).to_le_bytes(), text].concat()
    }

    /// Reads an MCAP file made of `records`. Returns its items and how the file ends.
    fn read(records: &[Vec<u8>]) -> (Vec<Piece>, End) {
        let file = [mcap::MAGIC, &records.concat()[..]].concat();
        let mut reading = Reading::new(file.as_slice());
        (reading.by_ref().collect(), reading.end().unwrap().clone())
    }

    /// Returns an uncompressed chunk whose head claims `length` bytes.
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
    fn attachment_without_its_checksum_is_damage() {
        // Times, two empty texts, no data, and fewer than the four bytes of a checksum.
        for behind in 0..4 {
            let (pieces, end) = read(&[record(0x09, &vec![0; 32 + behind])]);
            assert!(pieces.is_empty() && matches!(end, End::Damaged(_)), "{behind}: {end:?}");
        }
        let (pieces, _) = read(&[record(0x09, &[0; 36])]);
        assert_eq!(pieces, [Piece::Attachment(String::new(), String::new(), Vec::new())]);
    }

    /// Channels share a schema. All schemas together have a limit, for which a repeated schema
    /// counts once.
    #[test]
    fn channels_share_schemas_of_limited_total_size() {
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
        // A repeated schema is not counted again.
        assert!(matches!(read(&many(false)).1, End::Cut(_)));
    }

    #[test]
    fn too_long_chunk_is_refused_at_its_head() {
        // By its length before compression.
        let long = LONGEST as u64 + 1;
        let (_, end) = read(&[chunk(long, b"")]);
        assert!(matches!(&end, End::Damaged(why) if why.contains("too long")), "{end:?}");
        // By its length in the file, although the file has no more than the head.
        let mut head = chunk(0, b"");
        head[1..9].copy_from_slice(&long.to_le_bytes());
        let (_, end) = read(&[head]);
        assert!(matches!(&end, End::Damaged(why) if why.contains("too long")), "{end:?}");
        let held = [schema(1, 9), channel(1, 1), message(1)].concat();
        let (pieces, end) = read(&[chunk(held.len() as u64, &held)]);
        assert!(pieces.len() == 1 && matches!(end, End::Cut(_)), "{pieces:?}, {end:?}");
    }

    /// Metadata is read between chunks, and is damage in one.
    #[test]
    fn metadata_in_a_chunk_is_damage() {
        let (pieces, end) = read(&[metadata(9), metadata(9)]);
        assert!(pieces.len() == 2 && matches!(end, End::Cut(_)), "{pieces:?}, {end:?}");

        let inside = metadata(9);
        let (pieces, end) = read(&[chunk(inside.len() as u64, &inside)]);
        assert!(pieces.is_empty() && matches!(end, End::Damaged(_)), "{pieces:?}, {end:?}");
    }

    #[test]
    fn metadata_with_too_many_pairs_is_damage() {
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
