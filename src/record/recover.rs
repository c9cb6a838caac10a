//! Makes a whole file of one that was cut off or damaged: everything that can still be read, with an index.
//!
//! - in: a recording that a crash, a full disk or a copy has cut off or damaged anywhere
//! - out: a recording that any tool opens, and what was saved

use super::file::Unwritten;
use super::reading::{End, Piece, Reading};
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::io::{Read, Seek, Write};
use std::sync::Arc;

/// What was saved.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Saved {
    /// Messages.
    pub messages: u64,
    /// From the first message's time to the last one's [ns].
    pub span: u64,
    /// How the original ended.
    pub end: End,
}

/// Copies what can be read of `from` to `to`.
///
/// # Errors
/// What the device of `to` says.
pub fn recover<R: Read, W: Write + Seek>(from: R, to: W) -> Result<Saved, Unwritten> {
    let mut writer = mcap::WriteOptions::new()
        .profile("ros2")
        .library(concat!("rubik-robot ", env!("CARGO_PKG_VERSION"), " recover"))
        .compression(Some(mcap::Compression::Lz4))
        .create(to)?;
    let mut reading = Reading::new(from);
    let (mut channels, mut schemas) = (BTreeMap::new(), BTreeMap::new());
    let (mut messages, mut first, mut last) = (0, u64::MAX, 0);
    for piece in reading.by_ref() {
        match piece {
            Piece::Metadata(name, metadata) => {
                writer.write_metadata(&mcap::records::Metadata { name, metadata })?;
            }
            Piece::Attachment(name, media_type, data) => {
                writer.attach(&mcap::Attachment {
                    log_time: 0,
                    create_time: 0,
                    name,
                    media_type,
                    data: data.into(),
                })?;
            }
            Piece::Message(message) => {
                let channel = &message.channel;
                let key = Arc::as_ptr(channel) as usize;
                let known = match channels.entry(key) {
                    Entry::Occupied(known) => known.into_mut(),
                    Entry::Vacant(place) => {
                        // The writer compares texts, of which a file may have long ones for many channels.
                        let own = &channel.schema;
                        let schema = match schemas.entry(Arc::as_ptr(own) as usize) {
                            Entry::Occupied(known) => *known.get(),
                            Entry::Vacant(place) => *place.insert(writer.add_schema(
                                &own.kind,
                                &own.encoding,
                                &own.definition,
                            )?),
                        };
                        let id = writer.add_channel(
                            schema,
                            &channel.topic,
                            &channel.message_encoding,
                            &channel.metadata,
                        )?;
                        // The channel is kept, so that no other one comes to stand where it stood.
                        place.insert((id, 0_u32, Arc::clone(channel)))
                    }
                };
                known.1 += 1;
                let header = mcap::records::MessageHeader {
                    channel_id: known.0,
                    sequence: known.1,
                    log_time: message.time,
                    publish_time: message.time,
                };
                writer.write_to_known_channel(&header, &message.data)?;
                messages += 1;
                first = first.min(message.time);
                last = last.max(message.time);
            }
        }
    }
    writer.finish()?;
    let end = reading.end().cloned().unwrap_or(End::Whole);
    Ok(Saved { messages, span: last.saturating_sub(first), end })
}
