//! Merger of the recordings of all nodes of a run into one, in the time of MP's node.
//!
//! - in: the recordings of a run's nodes, with the names of their actors
//! - out: one recording with the messages of all of them, in the order of time
//!
//! The recording of a node beside that of MP has the course of the difference between its periods
//! and those of MP's node (topic `/offset`). By it the times of its messages become those of MP's
//! node, and so do the periods of its sensors. Its servo ticks keep their own periods: a servo
//! repeats to the bit only with the periods that it has counted.
//!
//! | message | in the merged recording |
//! |---|---|
//! | `/robot_description`, `/tf_static`, `/CAMERA/info` | that of MP's node |
//! | `/CAMERA/image` of a camera of another node | that of the camera's node; it has each picture |
//! | message to the operator of another node's actor | that of its node, with the node's name |
//! | `/offset` | `/NODE/offset` |
//! | metadata `M` of another node | `M of node NODE` |
//! | all others | as they are |
//!
//! The files are read twice, message by message: the course of an offset is known before the first
//! message is written.

use super::cdr::{self, Malformed, Reader, Writer};
use super::file::Unwritten;
use super::reading::{Channel, End, Label, Message, Piece, Reading, Unreadable};
use super::sensed::{Found, Sensed};
use super::sheet::OFFSET;
use super::standard;
use crate::motion::PERIOD;
use crate::operator::Class;
use std::collections::{BTreeMap, BTreeSet};
use std::io::{Read, Seek, Write};

/// Name of the metadata by which the recordings of a run's nodes belong together.
pub(crate) const OF_NODE: &str = "node";
/// Key in that metadata: name of the node, empty for that of MP.
pub(crate) const NODE: &str = "name";
/// Key in that metadata: number of the run.
pub(crate) const RUN: &str = "run";
/// Key in that metadata: checksum of the scenario, as far as all nodes share it.
pub(crate) const SCENARIO: &str = "scenario";

/// Facts that all recordings of a run have in common: metadata, key, and name for people.
const COMMON: [(&str, &str, &str); 9] = [
    (OF_NODE, RUN, "run"),
    (OF_NODE, SCENARIO, "scenario"),
    ("rubik_robot", "program", "program"),
    ("rubik_robot", "program_version", "version of the program"),
    ("rubik_robot", "version", "version"),
    ("rubik_robot", "build", "build"),
    ("rubik_robot", "task", "task"),
    ("rubik_robot", "arms", "list of arms"),
    ("rubik_robot", "period_ns", "servo period"),
];

/// Length of a period (ns).
const PERIOD_NS: i128 = (PERIOD * 1e9) as i128;

/// Largest number of changes of an offset. One of an hour of a run has some hundreds.
const MOST_OFFSETS: usize = 1 << 20;

/// Facts of the recording of one node, from a first reading.
#[derive(Debug)]
pub(crate) struct Part {
    /// Name of the file in messages.
    pub(crate) file: String,
    /// Name of the node; empty for MP's.
    pub(crate) node: String,
    label: Label,
    /// Time of period 0 by the clock of the node's host (ns).
    start: u64,
    /// Times by that clock (ns) from which on an offset counts, each with the offset (periods).
    offsets: Vec<(u64, i64)>,
    /// How the file is cut off or damaged.
    pub(crate) flaw: Option<End>,
}

/// Names of what belongs to one node.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Owned {
    /// Indices of the arms.
    pub(crate) arms: BTreeSet<usize>,
    /// Names of the cameras.
    pub(crate) cameras: BTreeSet<String>,
}

/// Reason why recordings cannot be merged.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Unmerged {
    /// A recording cannot be read, or does not belong to the others.
    #[error("{file}: {why}")]
    Part {
        /// Name of the recording.
        file: String,
        /// Reason.
        why: String,
    },
    /// The merged recording cannot be written.
    #[error(transparent)]
    Unwritten(#[from] Unwritten),
}

impl Unmerged {
    /// Makes the error of a recording.
    fn of(file: &str, why: impl Into<String>) -> Self {
        Self::Part { file: file.to_owned(), why: why.into() }
    }
}

/// Result of a merger.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Merged {
    /// Number of messages in the merged recording.
    pub(crate) messages: u64,
    /// Time from its first message to its last one (ns).
    pub(crate) span: u64,
}

impl Part {
    /// Reads the facts of a recording. `file` is its name.
    ///
    /// # Errors
    /// If it is not the recording of a node, or a message does not fit its type.
    pub(crate) fn read<R: Read + Seek>(file: &str, from: R) -> Result<Self, Unmerged> {
        let failed = |why: &dyn ToString| Unmerged::of(file, why.to_string());
        let (mut label, mut start, mut offsets) = (Label::default(), None, Vec::new());
        let mut reading = Reading::seekable(from);
        for piece in reading.by_ref() {
            label.take(&piece);
            let Piece::Message(message) = piece else { continue };
            // The first message has the time of period 0.
            start.get_or_insert(message.time);
            if message.channel.topic == OFFSET && offsets.len() < MOST_OFFSETS {
                let offset = read_offset(&message.data);
                let why = |why| Unreadable::Message { topic: OFFSET.to_owned(), why };
                offsets.push((message.time, offset.map_err(|e| failed(&why(e)))?));
            }
        }
        let Some(start) = start.filter(|_| !label.of(OF_NODE, RUN).is_empty()) else {
            return Err(failed(&"it is no recording of a node of a run on several hosts"));
        };
        let node = label.of(OF_NODE, NODE).to_owned();
        if offsets.is_empty() && !node.is_empty() {
            return Err(failed(&"it does not say how its periods differ from those of MP's node"));
        }
        let flaw = reading.end().and_then(End::loss).cloned();
        Ok(Self { file: file.to_owned(), node, label, start, offsets, flaw })
    }

    /// Returns the node in words.
    fn who(&self) -> String {
        if self.node.is_empty() { "MP's node".to_owned() } else { format!("node {}", self.node) }
    }

    /// Returns a time of this recording (ns) in the time of MP's node, whose period 0 begins at
    /// `home` (ns).
    fn at_home(&self, time: u64, home: u64) -> u64 {
        let since = i128::from(time) - i128::from(self.start);
        let at_home = i128::from(home) + since + i128::from(self.offset_at(time)) * PERIOD_NS;
        u64::try_from(at_home.max(0)).unwrap_or(u64::MAX)
    }

    /// Returns the offset at a time of this recording (ns): before the first one that is known, it
    /// is that one.
    fn offset_at(&self, time: u64) -> i64 {
        let later = self.offsets.partition_point(|(from, _)| *from <= time);
        self.offsets.get(later.saturating_sub(1)).map_or(0, |(_, offset)| *offset)
    }
}

/// Decodes the offset in a message of [`OFFSET`].
fn read_offset(message: &[u8]) -> Result<i64, Malformed> {
    let mut from = Reader::new(message)?;
    from.time()?;
    from.u64()?;
    from.i64()
}

/// Checks that recordings, which are in the order of their nodes' names, are of different nodes of
/// one run. So that of MP's node is the first one.
///
/// # Errors
/// The first recording that does not belong to the others, with the reason.
pub(crate) fn check(parts: &[&Part]) -> Result<(), Unmerged> {
    let Some((home, others)) = parts.split_first() else { return Ok(()) };
    if !home.node.is_empty() {
        return Err(Unmerged::of(&home.file, "the recording of MP's node is missing beside it"));
    }
    for part in others {
        for (metadata, key, what) in COMMON {
            let (is, wanted) = (part.label.of(metadata, key), home.label.of(metadata, key));
            if is != wanted {
                let of_home = &home.file;
                let why = format!("its {what} is `{is}`, that of {of_home} is `{wanted}`");
                return Err(Unmerged::of(&part.file, why));
            }
        }
    }
    match parts.windows(2).find(|pair| pair[0].node == pair[1].node) {
        Some(pair) => {
            let why = format!("it is of {}, as {} is", pair[1].who(), pair[0].file);
            Err(Unmerged::of(&pair[1].file, why))
        }
        None => Ok(()),
    }
}

/// Recording that is being merged.
struct Source<'a, R> {
    part: &'a Part,
    owned: &'a Owned,
    reading: Reading<R>,
    /// Next message, and its place in the order.
    next: Option<(u64, Message)>,
}

/// Merges recordings, which [`check`] has put into order, into the recording `to`. Each has its
/// file, and the names of what belongs to its node.
///
/// # Errors
/// If a message does not fit its type or its node, or `to` cannot be written.
pub(crate) fn merge<R: Read + Seek, W: Write + Seek>(
    parts: &[(Part, Owned)],
    files: Vec<R>,
    to: W,
) -> Result<Merged, Unmerged> {
    let mut merger = Merger::new(parts, to)?;
    let sources = parts.iter().zip(files);
    let mut sources: Vec<_> = sources
        .map(|((part, owned), file)| {
            let reading = Reading::seekable(file);
            Source { part, owned, reading, next: None }
        })
        .collect();
    for source in &mut sources {
        merger.advance(source)?;
    }
    // The order of a file is kept, so the messages of one period of all its arms stay together.
    while let Some(source) = sources
        .iter_mut()
        .filter(|source| source.next.is_some())
        .min_by_key(|source| source.next.as_ref().map(|(order, _)| *order))
    {
        if let Some((_, message)) = &source.next {
            merger.write(message).map_err(Unmerged::Unwritten)?;
        }
        merger.advance(source)?;
    }
    merger.finish()
}

/// Merged recording that is being written.
struct Merger<W: Write + Seek> {
    writer: mcap::Writer<W>,
    /// Time of period 0 of MP's node (ns).
    home: u64,
    /// Cameras and names of the other nodes.
    cameras: BTreeSet<String>,
    nodes: Vec<String>,
    /// Number of each channel and of its last message, by topic.
    channels: BTreeMap<String, (u16, u32)>,
    /// Number of each schema, by name.
    schemas: BTreeMap<String, u16>,
    /// Number of messages that the recorders have lost.
    lost: u64,
    /// Times of reading faces of the node that has read the most.
    vision: BTreeMap<String, String>,
    messages: u64,
    /// Times of the first and of the last message (ns).
    span: (u64, u64),
}

impl<W: Write + Seek> Merger<W> {
    /// Begins the merged recording.
    fn new(parts: &[(Part, Owned)], to: W) -> Result<Self, Unwritten> {
        let writer = mcap::WriteOptions::new()
            .profile("ros2")
            .library(concat!("rubik-robot ", env!("CARGO_PKG_VERSION"), " merge"))
            .compression(Some(mcap::Compression::Lz4))
            .create(to)?;
        let others = || parts.iter().skip(1);
        Ok(Self {
            writer,
            home: parts.first().map_or(0, |(part, _)| part.start),
            cameras: others().flat_map(|(_, owned)| owned.cameras.iter().cloned()).collect(),
            nodes: others().map(|(part, _)| part.node.clone()).collect(),
            channels: BTreeMap::new(),
            schemas: BTreeMap::new(),
            lost: 0,
            vision: BTreeMap::new(),
            messages: 0,
            span: (u64::MAX, 0),
        })
    }

    /// Reads on to the next message of a recording that is to be written. Items before it that are
    /// no messages are written at once.
    fn advance<R: Read>(&mut self, source: &mut Source<'_, R>) -> Result<(), Unmerged> {
        let before = source.next.take().map_or(0, |(order, _)| order);
        let part = source.part;
        for piece in source.reading.by_ref() {
            match piece {
                Piece::Message(mut message) => {
                    let failed = |why: Malformed| {
                        let topic = message.channel.topic.clone();
                        Unmerged::of(&part.file, Unreadable::Message { topic, why }.to_string())
                    };
                    let kept = if part.node.is_empty() {
                        self.keeps(&message).map_err(failed)?
                    } else {
                        carries(&message)
                    };
                    if !kept {
                        continue;
                    }
                    check_owner(source.part, source.owned, &message)?;
                    if !part.node.is_empty() {
                        message = self.carried(part, &message).map_err(failed)?;
                    }
                    // A look back in time keeps its place in the file.
                    source.next = Some((before.max(message.time), message));
                    return Ok(());
                }
                Piece::Metadata(name, facts) => self.metadata(part, &name, facts)?,
                Piece::Attachment(name, media_type, data) if part.node.is_empty() => {
                    self.writer
                        .attach(&mcap::Attachment {
                            log_time: 0,
                            create_time: 0,
                            name,
                            media_type,
                            data: data.into(),
                        })
                        .map_err(Unwritten::from)?;
                }
                // All nodes have read the same scenario.
                Piece::Attachment(..) => {}
            }
        }
        Ok(())
    }

    /// Returns whether a message of MP's node is kept. Those that the recording of another node has
    /// as well are left out.
    fn keeps(&self, message: &Message) -> Result<bool, Malformed> {
        let topic = message.channel.topic.as_str();
        if let Some(camera) = camera_of(topic) {
            return Ok(!self.cameras.contains(camera));
        }
        if topic != "/rosout" {
            return Ok(true);
        }
        let (_, who, _) = standard::read_log(&mut Reader::new(&message.data)?)?;
        Ok(!self.nodes.iter().any(|node| told_by(node, who)))
    }

    /// Returns a message of another node with the time of MP's node.
    fn carried(&self, part: &Part, message: &Message) -> Result<Message, Malformed> {
        let time = part.at_home(message.time, self.home);
        let Message { mut channel, mut data, .. } = message.clone();
        match (channel.topic.as_str(), channel.schema.kind.as_str()) {
            (OFFSET, _) => {
                let topic = format!("/{}{OFFSET}", part.node);
                channel = std::sync::Arc::new(Channel { topic, ..(*channel).clone() });
                cdr::restamp(&mut data, cdr::FIRST, time)?;
            }
            ("/rosout", _) => {
                let (class, who, text) = standard::read_log(&mut Reader::new(&data)?)?;
                data = log_of(&part.node, (class, who, text), time);
            }
            ("/sensed", _) => {
                let offset = part.offset_at(message.time);
                let mut writer = Writer::default();
                shifted(Sensed::read(&data)?, offset).write(time, &mut writer);
                data = writer.bytes();
            }
            // A text has no stamp.
            (_, "std_msgs/msg/String") => {}
            (_, "tf2_msgs/msg/TFMessage") => standard::restamp_transforms(&mut data, time)?,
            _ => cdr::restamp(&mut data, cdr::FIRST, time)?,
        }
        Ok(Message { channel, time, data })
    }

    /// Writes a metadata record, or keeps it for the end.
    fn metadata(
        &mut self,
        part: &Part,
        name: &str,
        facts: BTreeMap<String, String>,
    ) -> Result<(), Unwritten> {
        let number = |facts: &BTreeMap<String, String>, key: &str| {
            facts.get(key).and_then(|text| text.parse().ok()).unwrap_or(0_u64)
        };
        match name {
            "recording" => self.lost += number(&facts, "lost"),
            "vision" if number(&facts, "faces") > number(&self.vision, "faces") => {
                self.vision = facts;
            }
            "vision" => {}
            // The merged recording is of no single node.
            OF_NODE => self.put(&format!("{OF_NODE} of {}", part.who()), &facts)?,
            _ if part.node.is_empty() => self.put(name, &facts)?,
            _ => self.put(&format!("{name} of {}", part.who()), &facts)?,
        }
        Ok(())
    }

    /// Writes a metadata record.
    fn put(&mut self, name: &str, facts: &BTreeMap<String, String>) -> Result<(), Unwritten> {
        let metadata = mcap::records::Metadata { name: name.to_owned(), metadata: facts.clone() };
        Ok(self.writer.write_metadata(&metadata)?)
    }

    /// Writes a message. Topics of the same name share one channel, from whichever node they are.
    fn write(&mut self, message: &Message) -> Result<(), Unwritten> {
        let Channel { topic, schema, message_encoding, metadata } = &*message.channel;
        if !self.channels.contains_key(topic) {
            let kind = &schema.kind;
            let id = if let Some(id) = self.schemas.get(kind) {
                *id
            } else {
                let id = self.writer.add_schema(kind, &schema.encoding, &schema.definition)?;
                self.schemas.insert(kind.clone(), id);
                id
            };
            let id = self.writer.add_channel(id, topic, message_encoding, metadata)?;
            self.channels.insert(topic.clone(), (id, 0));
        }
        let Some((channel_id, sequence)) = self.channels.get_mut(topic) else { return Ok(()) };
        *sequence = sequence.wrapping_add(1);
        let (time, sequence) = (message.time, *sequence);
        self.writer.write_to_known_channel(
            &mcap::records::MessageHeader {
                channel_id: *channel_id,
                sequence,
                log_time: time,
                publish_time: time,
            },
            &message.data,
        )?;
        self.messages += 1;
        self.span = (self.span.0.min(time), self.span.1.max(time));
        Ok(())
    }

    /// Writes what is known at the end only, and the index.
    fn finish(mut self) -> Result<Merged, Unmerged> {
        let count = [("messages", self.messages.to_string()), ("lost", self.lost.to_string())];
        let count = count.map(|(name, value)| (name.to_owned(), value)).into();
        self.put("recording", &count)?;
        let vision = std::mem::take(&mut self.vision);
        self.put("vision", &vision)?;
        self.writer.finish().map_err(Unwritten::from)?;
        let (first, last) = self.span;
        Ok(Merged { messages: self.messages, span: last.saturating_sub(first) })
    }
}

/// Checks that a message is of an arm or a camera of its node.
///
/// # Errors
/// If it is of one of another node.
fn check_owner(part: &Part, owned: &Owned, message: &Message) -> Result<(), Unmerged> {
    let topic = message.channel.topic.as_str();
    if topic.ends_with("/servo") {
        let arm = arm_of(&message.data)
            .map_err(|why| Unmerged::of(&part.file, format!("{topic}: {why}")))?;
        if !owned.arms.contains(&arm) {
            let why = format!("{topic}: this arm does not belong to {}", part.who());
            return Err(Unmerged::of(&part.file, why));
        }
    }
    match camera_of(topic).filter(|camera| !owned.cameras.contains(*camera)) {
        Some(_) if !part.node.is_empty() => {
            let why = format!("{topic}: this camera does not belong to {}", part.who());
            Err(Unmerged::of(&part.file, why))
        }
        _ => Ok(()),
    }
}

/// Returns whether a message of another node is kept. Those that are written once are in the
/// recording of MP's node.
fn carries(message: &Message) -> bool {
    let topic = message.channel.topic.as_str();
    !matches!(topic, "/robot_description" | "/tf_static") && !topic.ends_with("/info")
}

/// Returns the index of the arm of a servo tick.
fn arm_of(tick: &[u8]) -> Result<usize, Malformed> {
    let mut from = Reader::new(tick)?;
    from.time()?;
    from.u64()?;
    from.u8().map(usize::from)
}

/// Returns the name of the camera of a topic of pictures.
fn camera_of(topic: &str) -> Option<&str> {
    topic.strip_prefix('/')?.strip_suffix("/image")
}

/// Returns the answer of a sensor with its periods later by `offset`.
fn shifted(sensed: Sensed, offset: i64) -> Sensed {
    let later = |period: u64| period.saturating_add_signed(offset);
    let found = sensed.found.map(|found| match found {
        Found::Cube { world_from_cube, speed, exposed } => {
            Found::Cube { world_from_cube, speed, exposed: later(exposed) }
        }
        found => found,
    });
    Sensed { period: later(sensed.period), found, ..sensed }
}

/// Returns the name of the actor `who` of another node for the operator at MP's node. Notes are of
/// no actor: they have the name of MP.
pub(crate) fn name_of(node: &str, who: &str) -> String {
    if who == "mp" { format!("on node {node}") } else { format!("{who} on node {node}") }
}

/// Returns whether a message to the operator under the name `who` is one of an actor of a node.
fn told_by(node: &str, who: &str) -> bool {
    who.strip_suffix(node).is_some_and(|who| who.ends_with("on node "))
}

/// Returns a message to the operator with the name of its node.
fn log_of(node: &str, (class, who, text): (Class, &str, &str), time: u64) -> Vec<u8> {
    let mut writer = Writer::default();
    standard::log(&mut writer, time, class, &name_of(node, who), text);
    writer.bytes()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::Cell;
    use crate::hw::driver::ServoRecord;
    use crate::motion::ArmState;
    use crate::record::entry::Entry;
    use crate::record::file::File;
    use crate::record::sheet::{MessageWriter, RunInfo};
    use crate::record::tick::Tick;
    use crate::servo::io::{ArmDrive, ArmReading, Outside};
    use crate::servo::period::Length;
    use crate::spatial::Pose;
    use std::io::Cursor;
    use std::path::Path;
    use std::sync::OnceLock;

    /// Time of period 0 of MP's node, and of the node b, whose clock is years ahead (ns).
    const STARTS: [u64; 2] = [1_000_000_000_000, 99_000_000_000_000_000];
    /// Periods of MP's node are so many ahead of those of node b, at first and from period 100 on.
    const OFFSETS: [i64; 2] = [500, 499];

    /// Recording of a node that is being made.
    struct Making {
        writer: MessageWriter,
        file: File<Cursor<Vec<u8>>>,
    }

    impl Making {
        /// Begins the recording of MP's node (0) or of node b (1), with changed facts.
        fn new(node: usize, changes: &[(&str, &str)]) -> Self {
            let mut facts: BTreeMap<String, String> =
                COMMON[2..].iter().map(|(_, key, _)| ((*key).to_owned(), "x".to_owned())).collect();
            let mut of_node = BTreeMap::from(
                [(NODE, ["", "b"][node]), (RUN, "r"), (SCENARIO, "s")]
                    .map(|(key, fact)| (key.to_owned(), fact.to_owned())),
            );
            for (key, fact) in changes {
                let map = if of_node.contains_key(*key) { &mut of_node } else { &mut facts };
                map.insert((*key).to_owned(), (*fact).to_owned());
            }
            let about = RunInfo {
                cell: cell().clone(),
                scenario: "task = \"idle\"\n".to_owned(),
                options: Vec::new(),
                facts,
                objects: Vec::new(),
                start: STARTS[node],
                length: Length::default(),
            };
            let mut file = File::begin(Cursor::new(Vec::new())).unwrap();
            let mut writer = MessageWriter::new(about);
            writer.begin(&mut file).unwrap();
            let of_node = of_node.into_iter().collect();
            writer.entry(0, &Entry::Facts(OF_NODE, of_node), &mut file).unwrap();
            Self { writer, file }
        }

        fn entry(&mut self, period: u64, entry: &Entry) {
            self.writer.entry(period, entry, &mut self.file).unwrap();
        }

        fn tick(&mut self, arm: u8, period: u64) {
            self.writer.tick(&record(arm, period), &mut self.file).unwrap();
        }

        fn log(&mut self, period: u64, who: &str, text: &str) {
            self.entry(period, &Entry::Log(Class::Warning, who.to_owned(), text.to_owned()));
        }

        /// Ends the recording and returns its bytes.
        fn end(self) -> Vec<u8> {
            self.file.into_bytes()
        }
    }

    fn record(arm: u8, period: u64) -> ServoRecord {
        ServoRecord {
            period,
            arm,
            reading: ArmReading { jaw_count: period as i64, ..ArmReading::default() },
            outside: Outside::default(),
            command: None,
            drive: ArmDrive::OFF,
            state: ArmState { period, ..ArmState::default() },
        }
    }

    fn picture() -> Entry {
        Entry::Picture(0, image::RgbImage::new(8, 8))
    }

    /// Returns the recording of MP's node, whose arm is the first one.
    fn home(changes: &[(&str, &str)]) -> Vec<u8> {
        let mut home = Making::new(0, changes);
        for period in 1..=900 {
            home.tick(0, period);
            if period == 600 {
                home.log(period, "mp", "an own warning");
                home.log(period, "node b", "it is silent");
                home.log(period, "vsp mpc on node b", "as in the recording of b");
                home.entry(period, &picture());
            }
        }
        home.end()
    }

    /// Returns the recording of node b, whose arm is the second one, and the first camera.
    fn node(changes: &[(&str, &str)]) -> Vec<u8> {
        let mut node = Making::new(1, changes);
        for period in 1..=200 {
            match period {
                20 => node.entry(period, &Entry::Offset(OFFSETS[0])),
                100 => node.entry(period, &Entry::Offset(OFFSETS[1])),
                _ => {}
            }
            node.tick(1, period);
            if period == 50 {
                let found = Found::Cube {
                    world_from_cube: Pose::identity(),
                    speed: 0.0,
                    exposed: period - 9,
                };
                let (sensor, asked) = ("vsp mpc".to_owned(), "x".to_owned());
                let sensed = Sensed { period, sensor, asked, found: Ok(found) };
                node.entry(period, &Entry::Sensed(sensed));
                node.entry(period, &picture());
                node.log(period, "mp", "a warning of b");
                node.log(period, "vsp mpc", "an error of b");
            }
        }
        node.end()
    }

    fn owned(arm: usize, cameras: &[&str]) -> Owned {
        let cameras = cameras.iter().map(|camera| (*camera).to_owned()).collect();
        Owned { arms: [arm].into(), cameras }
    }

    /// Merges recordings of MP's node and node b, in whichever order.
    fn merged(files: &[Vec<u8>], owners: [Owned; 2]) -> Result<Vec<u8>, String> {
        let name = |i: usize| format!("{i}.mcap");
        let read = |(i, file): (usize, &Vec<u8>)| Part::read(&name(i), Cursor::new(file.clone()));
        let parts = files.iter().enumerate().map(read).collect::<Result<Vec<_>, _>>();
        let mut parts = parts.map_err(|why| why.to_string())?;
        parts.sort_by(|a, b| a.node.cmp(&b.node));
        check(&parts.iter().collect::<Vec<_>>()).map_err(|why| why.to_string())?;
        let at = |part: &Part| files.iter().enumerate().position(|(i, _)| name(i) == part.file);
        let files =
            parts.iter().map(|part| Cursor::new(files[at(part).unwrap()].clone())).collect();
        let parts: Vec<_> = parts.into_iter().zip(owners).collect();
        let mut to = Vec::new();
        merge(&parts, files, Cursor::new(&mut to)).map_err(|why| why.to_string())?;
        Ok(to)
    }

    /// Returns the recordings of both nodes, merged.
    fn both(home: Vec<u8>, node: Vec<u8>) -> Result<Vec<u8>, String> {
        merged(&[node, home], [owned(0, &[]), owned(1, &[&camera()])])
    }

    /// Returns the cell of the default scenario.
    fn cell() -> &'static Cell {
        static CELL: OnceLock<Cell> = OnceLock::new();
        let read = || crate::tasks::read(Path::new("t.toml"), "", &[]).unwrap();
        CELL.get_or_init(|| read().controller.cell)
    }

    /// Returns the name of the first camera.
    fn camera() -> String {
        cell().cameras[0].name.clone()
    }

    fn messages(file: Vec<u8>) -> Vec<Message> {
        let mut reading = Reading::seekable(Cursor::new(file));
        let messages = reading.by_ref().filter_map(|piece| match piece {
            Piece::Message(message) => Some(message),
            _ => None,
        });
        let messages = messages.collect();
        assert_eq!(reading.end(), Some(&End::Whole));
        messages
    }

    /// Each tick is there to the bit, in the order of its arm, at the time of MP's node.
    #[test]
    fn ticks_of_both_arms_are_kept() {
        let file = both(home(&[]), node(&[])).unwrap();

        let mut next = [1, 1];
        let (mut last, mut stamps) = (0, 0);
        for message in messages(file) {
            if !message.channel.topic.ends_with("/servo") {
                continue;
            }
            let tick = Tick::read(&message.data).unwrap();
            let arm = usize::from(tick.arm);
            assert_eq!(tick, Tick::of(&record(tick.arm, next[arm])));
            let offset = if tick.period < 100 { OFFSETS[0] } else { OFFSETS[1] };
            let period = tick.period + if arm == 1 { offset as u64 } else { 0 };
            assert_eq!(message.time, STARTS[0] + 2_000_000 * period);
            let mut from = Reader::new(&message.data).unwrap();
            stamps += usize::from(from.time().unwrap() == message.time);
            assert!(message.time >= last, "{arm} {}", tick.period);
            (last, next[arm]) = (message.time, next[arm] + 1);
        }
        assert_eq!((next, stamps), ([901, 201], 1100));
    }

    #[test]
    fn messages_of_node_get_periods_of_home() {
        let messages = messages(both(home(&[]), node(&[])).unwrap());

        let of = |topic: &str| messages.iter().filter(|m| m.channel.topic == topic).collect();
        let sensed: Vec<_> = of("/sensed");
        let Sensed { period, found, .. } = Sensed::read(&sensed[0].data).unwrap();
        assert!(matches!(found, Ok(Found::Cube { exposed: 541, .. })), "{found:?}");
        assert_eq!((period, sensed.len()), (550, 1));
        let transforms: Vec<&Message> = of("/tf");
        for message in &transforms {
            let mut from = Reader::new(&message.data).unwrap();
            assert!(from.u32().unwrap() > 0);
            assert_eq!(from.header().unwrap().0, message.time);
        }
        assert_eq!(transforms.len(), 45 + 10);
        let offsets: Vec<&Message> = of("/b/offset");
        let offsets: Vec<_> = offsets.iter().map(|m| read_offset(&m.data).unwrap()).collect();
        assert_eq!(offsets, OFFSETS);
    }

    /// The recording of MP's node has some pictures and messages of node b as well.
    #[test]
    fn doubled_messages_are_left_out() {
        let messages = messages(both(home(&[]), node(&[])).unwrap());

        let image = format!("/{}/image", camera());
        let count = |topic: &str| messages.iter().filter(|m| m.channel.topic == topic).count();
        let info = format!("/{}/info", camera());
        let counts = [&image, &info, "/robot_description", "/tf_static"].map(count);
        assert_eq!(counts, [1; 4]);
        let pictured = messages.iter().find(|m| m.channel.topic == image).unwrap();
        assert_eq!(pictured.time, STARTS[0] + 2_000_000 * 550);
        let told = messages.iter().filter(|m| m.channel.topic == "/rosout").map(|m| {
            let (_, who, text) = standard::read_log(&mut Reader::new(&m.data).unwrap()).unwrap();
            (who.to_owned(), text.to_owned())
        });
        let told: Vec<_> = told.collect();
        let expected = [
            ("on node b", "a warning of b"),
            ("vsp mpc on node b", "an error of b"),
            ("mp", "an own warning"),
            ("node b", "it is silent"),
        ];
        assert_eq!(told, expected.map(|(who, text)| (who.to_owned(), text.to_owned())));
    }

    #[test]
    fn foreign_recordings_are_refused_by_name() {
        let refused = |home: &[(&str, &str)], node: &[(&str, &str)]| {
            both(self::home(home), self::node(node)).unwrap_err()
        };

        let cases = [("run", "q"), ("scenario", "q"), ("build", "q"), ("version", "q")];
        for (key, other) in cases {
            let why = refused(&[], &[(key, other)]);
            assert!(why.starts_with(&format!("0.mcap: its {key} is `q`, that of 1.mcap")), "{why}");
        }
        assert_eq!(refused(&[], &[("name", "")]), "1.mcap: it is of MP's node, as 0.mcap is");
        let nodes = [node(&[]), node(&[("name", "c")])];
        let why = merged(&nodes, [Owned::default(), Owned::default()]).unwrap_err();
        assert_eq!(why, "0.mcap: the recording of MP's node is missing beside it");
        let why = refused(&[("run", "")], &[("run", "")]);
        assert!(why.contains("no recording of a node of a run on several hosts"), "{why}");
    }

    #[test]
    fn actors_of_other_nodes_are_refused() {
        let files = [home(&[]), node(&[])];

        let why = merged(&files, [owned(1, &[]), owned(1, &[&camera()])]).unwrap_err();
        assert!(why.starts_with("0.mcap: /track/servo: this arm does not belong to MP"), "{why}");
        let why = merged(&files, [owned(0, &[]), owned(0, &[&camera()])]).unwrap_err();
        assert!(why.contains("/postument/servo: this arm does not belong to node b"), "{why}");
        let why = merged(&files, [owned(0, &[]), owned(1, &[])]).unwrap_err();
        assert!(why.contains("this camera does not belong to node b"), "{why}");
    }

    /// The host of node b has lost its power: what is in its recording is merged.
    #[test]
    fn cut_recording_is_merged_to_its_end() {
        let mut cut = node(&[]);
        cut.truncate(cut.len() / 2);
        let part = Part::read("b.mcap", Cursor::new(cut.clone())).unwrap();
        assert!(matches!(part.flaw, Some(End::Cut(_))), "{:?}", part.flaw);

        let messages = messages(both(home(&[]), cut).unwrap());

        let servo = |arm: &str| format!("/{arm}/servo");
        let count = |topic: String| messages.iter().filter(|m| m.channel.topic == topic).count();
        assert_eq!(count(servo("track")), 900);
        assert!((1..200).contains(&count(servo("postument"))));
    }
}
