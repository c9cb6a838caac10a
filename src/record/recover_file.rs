//! Recovers a recording file that was cut off or damaged: writes everything that can still be read
//! into a whole file with an index.
//!
//! - in: a recording that a crash, a full disk or a copy has cut off or damaged anywhere
//! - out: a recording that any tool opens, and a count of what was saved

use super::file::Unwritten;
use super::reading::{Channel, End, Message, Piece, Reading};
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::io::{Read, Seek, Write};
use std::sync::Arc;

/// A count of what was saved.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Saved {
    /// Messages.
    pub messages: u64,
    /// From the first message's time to the last one's (ns).
    pub span: u64,
    /// How the original ended.
    pub end: End,
}

/// Copies what can be read of `from` to `to`.
///
/// # Errors
/// What the device of `to` says.
pub fn recover_file<R: Read, W: Write + Seek>(from: R, to: W) -> Result<Saved, Unwritten> {
    let writer = mcap::WriteOptions::new()
        .profile("ros2")
        .library(concat!("rubik-robot ", env!("CARGO_PKG_VERSION"), " recover"))
        .compression(Some(mcap::Compression::Lz4))
        .create(to)?;
    let mut whole = WholeFile { writer, channels: BTreeMap::new(), schemas: BTreeMap::new() };
    let mut reading = Reading::new(from);
    let (mut messages, mut first, mut last) = (0, u64::MAX, 0);
    for piece in reading.by_ref() {
        match piece {
            Piece::Metadata(name, metadata) => {
                whole.writer.write_metadata(&mcap::records::Metadata { name, metadata })?;
            }
            Piece::Attachment(name, media_type, data) => {
                whole.writer.attach(&mcap::Attachment {
                    log_time: 0,
                    create_time: 0,
                    name,
                    media_type,
                    data: data.into(),
                })?;
            }
            Piece::Message(message) => {
                whole.write(&message)?;
                messages += 1;
                first = first.min(message.time);
                last = last.max(message.time);
            }
        }
    }
    whole.writer.finish()?;
    let end = reading.end().cloned().unwrap_or(End::Whole);
    Ok(Saved { messages, span: last.saturating_sub(first), end })
}

/// The file that is written, and the ids that its writer gave to channels and schemas of the
/// original.
///
/// Both maps go by the address of what they name: comparing texts instead, as the writer does, is
/// slow with many channels whose texts are long. Channels are kept, so that no address is used
/// twice.
struct WholeFile<W: Write + Seek> {
    writer: mcap::Writer<W>,
    channels: BTreeMap<usize, WrittenChannel>,
    schemas: BTreeMap<usize, u16>,
}

/// A channel that has been written.
struct WrittenChannel {
    id: u16,
    /// Number of its last message.
    sequence: u32,
    _kept: Arc<Channel>,
}

impl<W: Write + Seek> WholeFile<W> {
    /// Writes a message, and before the first one of a channel that channel.
    fn write(&mut self, message: &Message) -> Result<(), Unwritten> {
        let channel = self.channel(&message.channel)?;
        channel.sequence += 1;
        let header = mcap::records::MessageHeader {
            channel_id: channel.id,
            sequence: channel.sequence,
            log_time: message.time,
            publish_time: message.time,
        };
        self.writer.write_to_known_channel(&header, &message.data)?;
        Ok(())
    }

    /// Returns the written channel of an original one, after writing it if it is new.
    fn channel(&mut self, original: &Arc<Channel>) -> Result<&mut WrittenChannel, Unwritten> {
        let Self { writer, channels, schemas } = self;
        let place = match channels.entry(Arc::as_ptr(original) as usize) {
            Entry::Occupied(known) => return Ok(known.into_mut()),
            Entry::Vacant(place) => place,
        };
        let Channel { topic, schema, message_encoding, metadata } = &**original;
        let schema = match schemas.entry(Arc::as_ptr(schema) as usize) {
            Entry::Occupied(known) => *known.get(),
            Entry::Vacant(place) => *place.insert(writer.add_schema(
                &schema.kind,
                &schema.encoding,
                &schema.definition,
            )?),
        };
        let id = writer.add_channel(schema, topic, message_encoding, metadata)?;
        Ok(place.insert(WrittenChannel { id, sequence: 0, _kept: Arc::clone(original) }))
    }
}
