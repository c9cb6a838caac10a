//! Reader of a recording that may be whole, cut off or damaged, message by message from its
//! beginning.
//!
//! - in: an MCAP file
//! - out: its messages in the order of the file, its metadata and attachments; and how it ends
//!
//! The messages of a chunk are delivered once its checksum is verified. If the file is cut off
//! within its last chunk, the checksum cannot be verified, and the messages of that chunk are
//! delivered without it. A damaged chunk is left out, and the reading continues behind it.
//!
//! The index at the end of the file is not used to read the messages: after a crash there is none,
//! and the order of the file is the order of the run. The index is checked all the same, because
//! other programs use it. If the file can be read at any place, the channels in its summary replace
//! those that a damaged chunk described.
//!
//! The file may come from anywhere, so its numbers are not trusted beyond these limits:
//!
//! | quantity | limit | reason |
//! |---|---|---|
//! | length of a record or chunk | `LONGEST` | a whole record or chunk is kept in memory |
//! | all schemas and channels | `DESCRIBED` | they are kept in memory to the end of the file |
//! | pairs of texts in a record | `PAIRS` | in memory a map takes ten times its size in the file |

use super::cdr::Malformed;
use super::chunk::unpack;
use super::closing::Closing;
use super::framing::{self, BLANK, Found, HEAD, Records, extent, head};
use mcap::records::{Record, op};
use std::collections::{BTreeMap, VecDeque};
use std::fmt::{self, Display, Formatter};
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Arc;

/// Largest size of all schemas and channels (bytes). Those of this program take some ten thousand
/// bytes.
const DESCRIBED: usize = 16 << 20;
/// Estimated memory of a schema, a channel or a pair of texts besides its data (bytes).
const COST: usize = 128;

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
    /// Further texts about the channel, by name.
    pub metadata: BTreeMap<String, String>,
}

/// Message of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// Channel of the message.
    pub channel: Arc<Channel>,
    /// Time at which the message was recorded (ns).
    pub time: u64,
    /// Fields of the message, encoded.
    pub data: Vec<u8>,
}

/// One item of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Piece {
    /// Message.
    Message(Message),
    /// Name of a metadata record, and its texts by name.
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
    /// Message whose bytes do not fit its type.
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
///
/// ```
/// use rubik_robot::record::reading::{End, Reading};
///
/// // A file that ends after the magic of MCAP: it has no items, and the reader says why.
/// let mut reading = Reading::new(&b"\x89MCAP0\r\n"[..]);
/// assert_eq!(reading.by_ref().count(), 0);
/// assert!(matches!(reading.end(), Some(End::Cut(_))));
/// ```
pub struct Reading<R> {
    records: Records<R>,
    /// Whether the magic at the beginning has been read.
    begun: bool,
    described: Described,
    /// Schemas and channels of the summary, for those that are not described before their messages.
    spare: Described,
    /// Unpacked records of the current chunk, and the index of the first byte not yet read.
    chunk: (Vec<u8>, usize),
    /// Chunk that fails its check and may be the last one before a part of the file that was never
    /// written.
    doubtful: Option<Doubtful>,
    /// Whether the file had a chunk so far.
    chunked: bool,
    /// Items to be delivered.
    ready: VecDeque<Piece>,
    damage: Damage,
    /// Whether the reading ends at the first damaged place.
    stops: bool,
    closing: Closing,
    /// How the file stops, once all of it has been read. The end follows when the last chunk has
    /// been delivered.
    last: Option<Stop>,
    /// End of the file; `None` while it is being read.
    end: Option<End>,
}

/// How the reading of a file stops.
enum Stop {
    /// The records end, or are not read any further.
    Regular,
    /// The file is cut off, with the reason.
    Cut(String),
}

/// Chunk that fails its check and ends with zeros.
struct Doubtful {
    /// Position of the chunk in the file.
    at: u64,
    /// Reason why the chunk fails its check.
    why: String,
    /// Records before the zeros.
    records: Vec<u8>,
}

/// Schemas and channels that were read.
#[derive(Debug, Default)]
struct Described {
    schemas: BTreeMap<u16, Arc<Schema>>,
    channels: BTreeMap<u16, Arc<Channel>>,
    /// Size of all of them (bytes).
    size: usize,
}

/// Damaged places of a file.
#[derive(Debug, Default)]
struct Damage {
    /// First damaged place, and what is wrong there.
    first: Option<String>,
    /// Number of damaged places after the first.
    more: u64,
    /// Number of messages whose channel is not known.
    strays: u64,
}

/// End of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum End {
    /// Regular end.
    Whole,
    /// Regular end of the data, but an index that other programs cannot use, with the reason.
    Index(String),
    /// End in the middle, with the reason: the file was cut off.
    Cut(String),
    /// First damaged place with the reason, and the number of further places. The damaged records
    /// are left out, and those that follow are read.
    Damaged(String),
}

impl End {
    /// Returns this end of a file unless the file is whole.
    #[must_use]
    pub fn flaw(&self) -> Option<&Self> {
        Some(self).filter(|end| **end != Self::Whole)
    }

    /// Returns this end of a file if something of the run may be missing: the file is cut off or
    /// damaged.
    #[must_use]
    pub fn loss(&self) -> Option<&Self> {
        self.flaw().filter(|end| !matches!(end, Self::Index(_)))
    }

    /// Returns this end with the time at which the file ends (s), for a text such as "cut off after
    /// 1.5 s: unexpected end".
    #[must_use]
    pub fn after(&self, seconds: f64) -> EndAfter<'_> {
        EndAfter { end: self, seconds }
    }

    /// Writes kind, time (`when`) and reason of the end. The alternate form `{:#}` puts the reason
    /// in brackets, so that a sentence can continue after it.
    fn describe(&self, f: &mut Formatter<'_>, when: &dyn Display) -> fmt::Result {
        // A damaged place may be anywhere, so it has no time.
        let (how, when, why): (_, &dyn Display, _) = match self {
            Self::Whole => return write!(f, "whole{when}"),
            Self::Index(why) => ("complete except for its index", &"", why),
            Self::Cut(why) => ("cut off", when, why),
            Self::Damaged(why) => ("damaged", &"", why),
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

/// End of a file with the time at which the file ends (s).
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
    Ok(Reading::seekable(std::fs::File::open(path)?))
}

impl<R: Read + Seek> Reading<R> {
    /// Makes a reader of a recording that can be read at any place. Messages behind a damaged chunk
    /// keep their channels although that chunk has described them.
    pub fn seekable(mut from: R) -> Self {
        let spare = described_by_summary(&mut from);
        Self { spare: spare.unwrap_or_default(), ..Self::new(from) }
    }
}

impl<R: Read> Reading<R> {
    /// Makes a reader of a recording, which may be whole, cut off or damaged.
    pub fn new(from: R) -> Self {
        Self {
            records: Records::new(from),
            begun: false,
            described: Described::default(),
            spare: Described::default(),
            chunk: (Vec::new(), 0),
            doubtful: None,
            chunked: false,
            ready: VecDeque::new(),
            damage: Damage::default(),
            stops: false,
            closing: Closing::default(),
            last: None,
            end: None,
        }
    }

    /// Makes the reading end at the first damaged place, for a use to which each message matters.
    #[must_use]
    pub fn up_to_damage(self) -> Self {
        Self { stops: true, ..self }
    }

    /// Returns how the file ends; `None` before all items have been delivered.
    pub fn end(&self) -> Option<&End> {
        if self.ready.is_empty() { self.end.as_ref() } else { None }
    }

    /// Handles the next record of the current chunk; behind the chunk, the next record of the file.
    /// Sets `end` when there are no more records.
    fn advance(&mut self) {
        if self.advance_in_chunk() {
            return;
        }
        if self.stops && self.damage.first.is_some() {
            self.last = Some(Stop::Regular);
        }
        if let Some(stop) = self.last.take() {
            let cut = match stop {
                Stop::Regular => None,
                Stop::Cut(why) => Some(why),
            };
            self.end = Some(self.damage.end(cut, &self.closing));
            return;
        }
        let begin = if self.begun { None } else { self.records.begin() };
        self.begun = true;
        let found = begin.unwrap_or_else(|| self.records.next());
        // A chunk that fails its check and ends with zeros is damaged, except if only zeros follow:
        // then its end was never written, and its first records are delivered.
        if let Some(Doubtful { at, why, records }) = self.doubtful.take() {
            match found {
                Found::Blank(_) => self.chunk = (records, 0),
                _ => self.damage.at(at, &why),
            }
        }
        match found {
            Found::Record { opcode, flaw } => self.take(opcode, flaw),
            Found::Damage(why) if self.closing.has_begun() => self.closing.fails(why),
            Found::Damage(why) => self.damage.before(self.records.at(), why),
            Found::Cut(opcode, why) => {
                // The records that were written before the cut are delivered.
                if opcode == op::CHUNK {
                    self.chunk = (unpack(written(self.records.body())).records, 0);
                }
                self.last = Some(Stop::Cut(why));
            }
            Found::Blank(from) => {
                let why = format!("only zeros from byte {from} to the end of the file");
                self.last = Some(Stop::Cut(why));
            }
            Found::End => self.last = Some(Stop::Cut("the file ends before its index".to_owned())),
            Found::Magic => {
                let behind = self.records.count_rest();
                if behind > 0 {
                    self.closing.fails(format!("{behind} bytes follow the end of the recording"));
                }
                self.last = Some(Stop::Regular);
            }
        }
    }

    /// Handles the next record of the current chunk. Returns `false` if there is none.
    fn advance_in_chunk(&mut self) -> bool {
        let (records, at) = std::mem::take(&mut self.chunk);
        let rest = records.get(at..).unwrap_or_default();
        let Some((opcode, length)) = head(rest) else { return false };
        // The records of a chunk were checked when it was unpacked.
        let Some(body) = rest.get(HEAD..HEAD + length as usize) else { return false };
        self.keep(opcode, body, Some(at as u64));
        let next = at + HEAD + body.len();
        self.chunk = (records, next);
        true
    }

    /// Takes the current record of the file; `flaw` says what is wrong with its head.
    fn take(&mut self, opcode: u8, flaw: Option<&'static str>) {
        if self.closing.has_begun() && opcode != op::CHUNK {
            return self.take_of_summary(opcode);
        }
        let (at, length) = (self.records.at(), self.records.length());
        self.closing.record(opcode, self.records.body(), (at, length as u64));
        match opcode {
            op::CHUNK => self.take_chunk(flaw),
            op::DATA_END => {
                // The record holds the checksum of all bytes before it; 0 means none.
                let said =
                    self.records.body().first_chunk().map_or(0, |sum| u32::from_le_bytes(*sum));
                let sum = self.records.sum(0);
                if said != 0 && said != sum {
                    let why = "the checksum of all data is wrong: bytes between chunks changed";
                    self.damage.only(why);
                }
                self.records.sum_from_next();
                self.closing.begin(self.records.at());
            }
            // This program writes messages in chunks only. A flipped bit can make the index of a
            // chunk look like a message.
            op::MESSAGE if self.chunked => self.damage.at(at, "a message is in no chunk"),
            op::SCHEMA | op::CHANNEL | op::MESSAGE | op::METADATA | op::ATTACHMENT => {
                let body = self.records.body().to_vec();
                if opcode == op::ATTACHMENT && !has_right_sum(&body) {
                    return self.damage.at(at, "the checksum of an attachment is wrong");
                }
                self.keep(opcode, &body, None);
            }
            op::MESSAGE_INDEX => self.closing.list(self.records.body()),
            // Opcodes from 0x80 are private records of other programs.
            op::HEADER | 0x80.. => {}
            _ => self.damage.at(at, "a record of this type does not belong among the data"),
        }
    }

    /// Takes the chunk that is the current record; `flaw` says what is wrong with its head.
    fn take_chunk(&mut self, flaw: Option<&'static str>) {
        self.chunked = true;
        let at = self.records.at();
        if self.closing.has_begun() {
            self.damage.at(at, "a chunk follows the end of the data");
        }
        let body = self.records.body();
        let unpacked = unpack(body);
        match unpacked.flaw {
            None => {
                if let Some(flaw) = flaw {
                    self.damage.at(at, &format!("the data of a chunk are sound, but {flaw}"));
                }
                self.chunk = (unpacked.records, 0);
            }
            Some(why) => {
                let why = format!("a chunk is left out: {why}");
                // Zeros at its end may have been never written: the next item of the file tells.
                let part = without_zeros(body);
                if part.len() < body.len() {
                    self.doubtful = Some(Doubtful { at, why, records: unpack(part).records });
                } else {
                    self.damage.at(at, &why);
                }
            }
        }
    }

    /// Takes the current record of the file, which is one of the summary.
    fn take_of_summary(&mut self, opcode: u8) {
        // The checksum of the footer covers its own first fields.
        let sum = self.records.sum(if opcode == op::FOOTER { HEAD + 8 + 8 } else { 0 });
        match mcap::parse_record(opcode, self.records.body()) {
            Ok(record) => self.closing.take(record, self.records.at(), sum),
            Err(why) => self.closing.fails(format!("one of its records is damaged: {why}")),
        }
    }

    /// Keeps a schema or a channel; makes a message, metadata or an attachment ready for delivery.
    /// `place` is the position of the record in the last chunk (bytes), `None` outside a chunk.
    fn keep(&mut self, opcode: u8, body: &[u8], place: Option<u64>) {
        let record = match mcap::parse_record(opcode, body).map(Record::into_owned) {
            Ok(record) => record,
            Err(why) => return self.damage.at(self.records.at(), &why.to_string()),
        };
        let piece = match record {
            Record::Message { header, data } => {
                self.closing.message(&header, place);
                let known = self.described.channels.get(&header.channel_id);
                // A message without a channel has no type. It is left out.
                let Some(channel) = known.or_else(|| self.spare.channels.get(&header.channel_id))
                else {
                    self.damage.strays += 1;
                    return;
                };
                let channel = Arc::clone(channel);
                Piece::Message(Message { channel, time: header.log_time, data: data.into_owned() })
            }
            Record::Metadata(metadata) => Piece::Metadata(metadata.name, metadata.metadata),
            Record::Attachment { header, data, .. } => {
                Piece::Attachment(header.name, header.media_type, data.into_owned())
            }
            record => {
                self.described.keep(record, &self.spare);
                if self.described.size > DESCRIBED {
                    self.damage.at(self.records.at(), "too many schemas and channels");
                    self.last = Some(Stop::Regular);
                    self.end = Some(self.damage.end(None, &self.closing));
                }
                return;
            }
        };
        self.ready.push_back(piece);
    }
}

impl Described {
    /// Keeps a schema or a channel, whose schema may be in `spare`; ignores any other record.
    fn keep(&mut self, record: Record<'static>, spare: &Self) {
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
                    self.size += texts + schema.definition.len() + COST;
                    self.schemas.insert(header.id, Arc::new(schema));
                }
            }
            Record::Channel(channel) if !self.channels.contains_key(&channel.id) => {
                let pairs =
                    channel.metadata.iter().map(|(name, text)| name.len() + text.len() + COST);
                let texts = channel.topic.len() + channel.message_encoding.len();
                self.size += texts + pairs.sum::<usize>() + COST;
                let schema = self.schemas.get(&channel.schema_id);
                let schema = schema.or_else(|| spare.schemas.get(&channel.schema_id));
                // The schema was in a damaged chunk: the type of the messages is not known.
                if schema.is_none() && channel.schema_id != 0 {
                    return;
                }
                let known = Channel {
                    topic: channel.topic,
                    schema: schema.cloned().unwrap_or_default(),
                    message_encoding: channel.message_encoding,
                    metadata: channel.metadata,
                };
                self.channels.insert(channel.id, Arc::new(known));
            }
            _ => {}
        }
    }
}

impl Damage {
    /// Notes that the record at this byte is damaged.
    fn at(&mut self, byte: u64, why: &str) {
        self.add(format!("at byte {byte}: {why}"));
    }

    /// Notes that a place before this byte is no record.
    fn before(&mut self, byte: u64, why: &str) {
        self.add(format!("before byte {byte}: {why}"));
    }

    /// Notes damage at an unknown place, unless a damaged place is known already.
    fn only(&mut self, why: &str) {
        self.first.get_or_insert_with(|| why.to_owned());
    }

    /// Keeps the text about the first damaged place, and counts the further ones.
    fn add(&mut self, what: String) {
        if self.first.is_some() {
            self.more += 1;
        } else {
            self.first = Some(what);
        }
    }

    /// Returns the end of a file with this damage. `cut` is the reason why the file is cut off, if
    /// it is.
    fn end(&self, cut: Option<String>, closing: &Closing) -> End {
        let strays = match self.strays {
            0 => None,
            count => Some(format!("{count} messages have no channel and are left out")),
        };
        let Some(first) = self.first.clone().or_else(|| strays.clone()) else {
            return match (cut, closing.flaw()) {
                (Some(why), _) => End::Cut(why),
                (None, Some(why)) => End::Index(why.to_owned()),
                (None, None) => End::Whole,
            };
        };
        let more = match self.more {
            0 => None,
            1 => Some("one more place is damaged".to_owned()),
            count => Some(format!("{count} more places are damaged")),
        };
        let strays = strays.filter(|strays| *strays != first);
        let parts = [Some(first), more, strays, cut];
        End::Damaged(parts.into_iter().flatten().collect::<Vec<_>>().join("; "))
    }
}

/// Returns the bytes before the zeros at the end of `bytes`, which the file system may have added;
/// all of them if there are only a few zeros.
fn written(bytes: &[u8]) -> &[u8] {
    let written = without_zeros(bytes);
    if bytes.len() - written.len() < BLANK { bytes } else { written }
}

/// Returns the bytes before the zeros at the end of `bytes`.
fn without_zeros(bytes: &[u8]) -> &[u8] {
    let zeros = bytes.iter().rev().take_while(|byte| **byte == 0).count();
    &bytes[..bytes.len() - zeros]
}

/// Checks the checksum at the end of an attachment's record; 0 means none.
fn has_right_sum(body: &[u8]) -> bool {
    let Some((before, sum)) = body.split_last_chunk() else { return false };
    let sum = u32::from_le_bytes(*sum);
    sum == 0 || sum == crc32fast::hash(before)
}

/// Reads schemas and channels in the summary of a file, and goes back to the beginning of the file.
/// Returns `None` if the file has no sound summary.
fn described_by_summary<R: Read + Seek>(from: &mut R) -> Option<Described> {
    /// Size of the footer's body (bytes): positions of the summary and its offsets, checksum.
    const FOOTER: u64 = 20;
    /// Size of the part of the footer that its checksum covers (bytes): all before the checksum.
    const COVERED: usize = HEAD + 8 + 8;
    let last = HEAD as u64 + FOOTER + mcap::MAGIC.len() as u64;
    let read = |from: &mut R| {
        let size = from.seek(SeekFrom::End(0)).ok()?;
        from.seek(SeekFrom::Start(size.checked_sub(last)?)).ok()?;
        let mut footer = Vec::new();
        from.take(last).read_to_end(&mut footer).ok()?;
        let (begin, rest) = footer.get(HEAD..)?.split_first_chunk()?;
        let (_, rest) = rest.split_at_checked(8)?;
        let (sum, magic) = rest.split_first_chunk()?;
        let begin = u64::from_le_bytes(*begin);
        // The summary lies between its position in the footer and the footer. Position 0: none.
        let length =
            (size - last).checked_sub(begin).filter(|length| *length <= DESCRIBED as u64)?;
        if head(&footer) != Some((op::FOOTER, FOOTER)) || magic != mcap::MAGIC || begin == 0 {
            return None;
        }
        from.seek(SeekFrom::Start(begin)).ok()?;
        let mut summary = Vec::new();
        from.take(length).read_to_end(&mut summary).ok()?;
        let mut check = crc32fast::Hasher::new();
        check.update(&summary);
        check.update(&footer[..COVERED]);
        let sum = u32::from_le_bytes(*sum);
        (sum == 0 || sum == check.finalize()).then_some(summary)
    };
    let summary = read(from);
    // In a pipe no seek works, so it is still at its beginning.
    let _ = from.seek(SeekFrom::Start(0));
    let summary = summary?;
    let (mut described, mut rest) = (Described::default(), &summary[..]);
    while let Some((opcode, length)) = head(rest) {
        let (body, behind) =
            rest[framing::HEAD..].split_at_checked(usize::try_from(length).ok()?)?;
        rest = behind;
        if matches!(opcode, op::SCHEMA | op::CHANNEL) && extent(opcode, body).is_some() {
            let record = mcap::parse_record(opcode, body).ok()?.into_owned();
            described.keep(record, &Described::default());
        }
    }
    Some(described)
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
    /// Returns the version of the program that made the recording.
    #[must_use]
    pub fn program_version(&self) -> &str {
        match self.fact("program_version") {
            "" => self.fact("version"),
            version => version,
        }
    }

    /// Returns the name of the program that made the recording.
    #[must_use]
    pub fn program(&self) -> &str {
        match self.fact("program") {
            "" => env!("CARGO_PKG_NAME"),
            name => name,
        }
    }

    /// Returns a fact about the run that is recorded at its beginning, such as "seed"; an empty
    /// text if there is none of this name.
    #[must_use]
    pub fn fact(&self, name: &str) -> &str {
        self.of("rubik_robot", name)
    }

    /// Returns the text `name` of the metadata record `metadata`; an empty text if there is none.
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
    use super::super::framing::{LONGEST, PAIRS};
    use super::*;

    /// Encodes a record as in an MCAP file: opcode, length, body.
    fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
        [&[opcode][..], &(body.len() as u64).to_le_bytes(), body].concat()
    }

    /// Encodes a text: length, bytes.
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
        record(op::CHUNK, &parts.concat())
    }

    /// Returns a metadata record with one text of `bytes` bytes.
    fn metadata(bytes: usize) -> Vec<u8> {
        let map = [text(b"name"), text(&vec![b'x'; bytes])].concat();
        record(0x0c, &[text(b"note"), text(&map)].concat())
    }

    /// Returns a schema with a definition of `bytes` bytes.
    fn schema(id: u16, bytes: usize) -> Vec<u8> {
        let texts = [text(b"p/msg/Type"), text(b"ros2msg"), text(&vec![b' '; bytes])].concat();
        record(0x03, &[&id.to_le_bytes()[..], &texts].concat())
    }

    /// Returns a channel with the schema of the number `schema`.
    fn channel(id: u16, schema: u16) -> Vec<u8> {
        let texts = [text(b"/topic"), text(b"cdr"), text(b"")].concat();
        record(0x04, &[&id.to_le_bytes()[..], &schema.to_le_bytes(), &texts].concat())
    }

    /// Returns a message on the channel of this number.
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

    /// Channels share a schema in memory. The size of all schemas together is limited; a repeated
    /// schema counts once.
    #[test]
    fn channels_share_schemas_of_limited_total_size() {
        let records = [schema(1, 1000), channel(1, 1), channel(2, 1), message(1), message(2)];
        let (pieces, _) = read(&records);
        let [Piece::Message(one), Piece::Message(other)] = pieces.as_slice() else {
            panic!("{pieces:?}")
        };
        assert!(Arc::ptr_eq(&one.channel.schema, &other.channel.schema));
        assert_eq!(one.channel.schema.definition.len(), 1000);

        let many = |count, different| {
            let id = |id: u16| if different { id } else { 1 };
            let schemas: Vec<_> = (0..count).map(|i| schema(id(i), DESCRIBED / 20)).collect();
            read(&schemas).1
        };
        let end = many(20, true);
        assert!(matches!(&end, End::Damaged(why) if why.contains("too many schemas")), "{end:?}");
        assert!(matches!(many(19, true), End::Cut(_)));
        // A repeated schema is not counted again.
        assert!(matches!(many(40, false), End::Cut(_)));
    }

    #[test]
    fn too_long_chunk_is_refused_at_its_head() {
        // Here its length before compression is too long.
        let long = LONGEST as u64 + 1;
        let (_, end) = read(&[chunk(long, b"")]);
        assert!(matches!(&end, End::Damaged(why) if why.contains("too long")), "{end:?}");
        // Here its length in the file is too long, although the file ends after the head.
        let mut head = chunk(0, b"x");
        head[1..9].copy_from_slice(&long.to_le_bytes());
        let (_, end) = read(&[head]);
        assert!(matches!(&end, End::Damaged(why) if why.contains("too long")), "{end:?}");
        let held = [schema(1, 9), channel(1, 1), message(1)].concat();
        let (pieces, end) = read(&[chunk(held.len() as u64, &held)]);
        assert!(pieces.len() == 1 && matches!(end, End::Cut(_)), "{pieces:?}, {end:?}");
    }

    /// Metadata is read between chunks, but counts as damage within a chunk.
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
