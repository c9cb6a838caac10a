//! Recovery of a recording that was cut off or damaged: everything that can still be read is
//! written to a new, whole file with an index.
//!
//! - in: a recording that a crash, a full disk or a failed copy has cut off or damaged
//! - out: a recording that any tool opens, and a count of the saved messages

use super::file::Unwritten;
use super::reading::{Channel, End, Message, Piece, Reading};
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::io::{Read, Seek, Write};
use std::sync::Arc;

/// Result of a recovery.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Saved {
    /// Number of messages that were saved.
    pub messages: u64,
    /// Time from the first message to the last one (ns).
    pub span: u64,
    /// End of the original file.
    pub end: End,
}

/// Copies everything that can be read of the recording `from`, which may be cut off or damaged, to
/// a whole recording `to`. Returns the number of saved messages, their span and how `from` ends.
///
/// # Errors
/// Error of the device of `to`.
pub fn recover_file<R: Read + Seek, W: Write + Seek>(from: R, to: W) -> Result<Saved, Unwritten> {
    let writer = mcap::WriteOptions::new()
        .profile("ros2")
        .library(concat!("rubik-robot ", env!("CARGO_PKG_VERSION"), " recover"))
        .compression(Some(mcap::Compression::Lz4))
        .create(to)?;
    let mut whole = WholeFile { writer, channels: BTreeMap::new(), schemas: BTreeMap::new() };
    let mut reading = Reading::seekable(from);
    // The span is taken over all messages: damage may have changed their order.
    let (mut messages, mut first, mut last) = (0, u64::MAX, 0);
    for piece in reading.by_ref() {
        match piece {
            Piece::Metadata(name, metadata) => {
                whole.writer.write_metadata(&mcap::records::Metadata { name, metadata })?;
            }
            Piece::Attachment(name, media_type, data) => {
                // The attachments of this program's recordings have no times either.
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
    // The loop above has read to the end, so the end is known.
    let end = reading.end().cloned().unwrap_or(End::Whole);
    Ok(Saved { messages, span: last.saturating_sub(first), end })
}

/// The new file, and the ids that its writer gave to the channels and schemas of the original.
///
/// The keys of both maps are the memory addresses of the original's channels and schemas. The
/// writer of the MCAP library compares their texts instead, which is slow for many channels with
/// long texts. Each channel is kept alive, so that no other channel gets its address.
struct WholeFile<W: Write + Seek> {
    writer: mcap::Writer<W>,
    channels: BTreeMap<usize, WrittenChannel>,
    schemas: BTreeMap<usize, u16>,
}

/// Channel of the new file.
struct WrittenChannel {
    id: u16,
    /// Number of its last message.
    sequence: u32,
    /// Keeps the channel of the original alive, whose address is the key.
    _kept: Arc<Channel>,
}

impl<W: Write + Seek> WholeFile<W> {
    /// Writes a message. Writes its channel first if the new file does not have it yet.
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

    /// Returns the channel of the new file that stands for `original`, a channel of the old one;
    /// creates it if there is none yet.
    fn channel(&mut self, original: &Arc<Channel>) -> Result<&mut WrittenChannel, Unwritten> {
        let Self { writer, channels, schemas } = self;
        let place = match channels.entry(Arc::as_ptr(original) as usize) {
            Entry::Occupied(known) => return Ok(known.into_mut()),
            Entry::Vacant(place) => place,
        };
        let Channel { topic, schema, message_encoding, metadata } = &**original;
        // Channels that share a schema in the original share it here, too: a schema of 4 MiB must
        // not be written once for each of 200 channels.
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
