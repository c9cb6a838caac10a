//! Writer of a recording's file: MCAP, profile `ros2`, chunks compressed with lz4.
//!
//! - in: messages with topic, type, time; scenario, versions, summary
//! - out: a file in which each finished chunk can be read by itself, so that a crash loses only
//!   the messages after the last finished chunk
//! - source: the MCAP specification, version 0

use super::feed::Feed;
use super::schema::Kind;
use std::collections::BTreeMap;
use std::io::{Seek, Write};

/// Size of a chunk before compression (bytes): about one second of a run with two arms.
const CHUNK: u64 = 768 * 1024;

/// Quality of service of a channel that keeps its latest message for subscribers that join late
/// (`durability: 1` is transient local). The times are the largest that ROS 2 knows: no deadline.
const LATCHED: &str = "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n  \
    deadline: {sec: 9223372036, nsec: 854775807}\n  \
    lifespan: {sec: 9223372036, nsec: 854775807}\n  liveliness: 1\n  \
    liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}\n  \
    avoid_ros_namespace_conventions: false\n";

/// Reason why the file takes no more data.
#[derive(Debug, thiserror::Error)]
#[error("{}", reason(.0))]
pub struct Unwritten(#[from] mcap::McapError);

/// Returns the error of the device (disk, pipe) behind `error` if there is one, otherwise that of
/// the MCAP library.
fn reason(error: &mcap::McapError) -> String {
    let cause = std::error::Error::source(error);
    cause.map_or_else(|| error.to_string(), ToString::to_string)
}

/// MCAP file that is being written, or the feed of a run that is not recorded, or both.
pub struct File<W: Write + Seek> {
    /// Writer of the file; `None` if only the feed gets the messages.
    writer: Option<mcap::Writer<W>>,
    /// Feed that gets the messages as well.
    feed: Option<Feed>,
    /// Number of the schema of each type of messages.
    schemas: BTreeMap<Kind, u16>,
    /// Channels by topic.
    channels: BTreeMap<String, Channel>,
}

/// Channel of a topic.
struct Channel {
    id: u16,
    /// Number of messages so far.
    count: u32,
}

impl<W: Write + Seek> File<W> {
    /// Begins an MCAP file in `to`.
    ///
    /// # Errors
    /// Error of the device.
    pub fn begin(to: W) -> Result<Self, Unwritten> {
        Self::begin_with(Some(to), None)
    }

    /// Begins a file whose messages the `feed` gets as well. Without a device `to` only the feed
    /// gets them.
    ///
    /// # Errors
    /// Error of the device.
    pub(super) fn begin_with(to: Option<W>, feed: Option<Feed>) -> Result<Self, Unwritten> {
        let writer = to.map(Self::writer).transpose()?;
        Ok(Self { writer, feed, schemas: BTreeMap::new(), channels: BTreeMap::new() })
    }

    /// Checks whether anybody reads the messages: a file, or a subscriber of the feed.
    pub(super) fn is_read(&self) -> bool {
        self.writer.is_some() || self.feed.as_ref().is_some_and(Feed::is_read)
    }

    /// Begins the MCAP file in `to`.
    fn writer(to: W) -> Result<mcap::Writer<W>, Unwritten> {
        let writer = mcap::WriteOptions::new()
            .profile("ros2")
            .library(concat!("rubik-robot ", env!("CARGO_PKG_VERSION")))
            .compression(Some(mcap::Compression::Lz4))
            .chunk_size(Some(CHUNK))
            // The library then writes a whole chunk at once, its length first, so that a reader
            // knows where a chunk that was cut off should have ended. With seeking it would write
            // the length last.
            .disable_seeking(true)
            .create(to)?;
        Ok(writer)
    }

    /// Writes a message at `time` (ns). The first message of a topic also creates its channel.
    ///
    /// # Errors
    /// Error of the device.
    pub fn message(
        &mut self,
        topic: &str,
        kind: Kind,
        time: u64,
        data: &[u8],
    ) -> Result<(), Unwritten> {
        if let Some(feed) = &self.feed {
            feed.send(topic, kind, time, data);
        }
        if self.writer.is_none() {
            return Ok(());
        }
        if !self.channels.contains_key(topic) {
            let id = self.channel(topic, kind)?;
            self.channels.insert(topic.to_owned(), Channel { id, count: 0 });
        }
        // The channel was inserted above if it was missing.
        let Some(channel) = self.channels.get_mut(topic) else { return Ok(()) };
        channel.count = channel.count.wrapping_add(1);
        let header = mcap::records::MessageHeader {
            channel_id: channel.id,
            sequence: channel.count,
            log_time: time,
            publish_time: time,
        };
        let Some(writer) = &mut self.writer else { return Ok(()) };
        Ok(writer.write_to_known_channel(&header, data)?)
    }

    /// Writes the channel of a topic whose messages have this type, and returns the channel's
    /// number.
    fn channel(&mut self, topic: &str, kind: Kind) -> Result<u16, Unwritten> {
        let Some(writer) = &mut self.writer else { return Ok(0) };
        // Topics of one type share its schema.
        let schema = if let Some(id) = self.schemas.get(&kind) {
            *id
        } else {
            let text = kind.schema();
            let id = writer.add_schema(kind.name(), "ros2msg", text.as_bytes())?;
            self.schemas.insert(kind, id);
            id
        };
        let mut metadata = BTreeMap::new();
        // These two topics get one message, at the beginning. A player must keep it for subscribers
        // that join later.
        if matches!(topic, "/robot_description" | "/tf_static") {
            metadata.insert("offered_qos_profiles".to_owned(), LATCHED.to_owned());
        }
        Ok(writer.add_channel(schema, topic, "cdr", &metadata)?)
    }

    /// Writes an MCAP metadata record called `name`; `entries` are its texts by key.
    ///
    /// # Errors
    /// Error of the device.
    pub fn metadata(
        &mut self,
        name: &str,
        entries: &BTreeMap<String, String>,
    ) -> Result<(), Unwritten> {
        let metadata = mcap::records::Metadata { name: name.to_owned(), metadata: entries.clone() };
        Ok(self.writer.as_mut().map_or(Ok(()), |writer| writer.write_metadata(&metadata))?)
    }

    /// Attaches a whole file: its name, its media type (MIME) and its bytes.
    ///
    /// # Errors
    /// Error of the device.
    pub fn attach(&mut self, name: &str, media: &str, data: &[u8]) -> Result<(), Unwritten> {
        let attachment = mcap::Attachment {
            // The format requires times; a scenario has none.
            log_time: 0,
            create_time: 0,
            name: name.to_owned(),
            media_type: media.to_owned(),
            data: data.into(),
        };
        Ok(self.writer.as_mut().map_or(Ok(()), |writer| writer.attach(&attachment))?)
    }

    /// Ends the current chunk, so that all messages written so far can be read even after a crash.
    ///
    /// # Errors
    /// Error of the device.
    pub fn flush(&mut self) -> Result<(), Unwritten> {
        Ok(self.writer.as_mut().map_or(Ok(()), mcap::Writer::flush)?)
    }

    /// Writes the index and ends the file.
    ///
    /// # Errors
    /// Error of the device.
    pub fn finish(self) -> Result<(), Unwritten> {
        self.writer.map_or(Ok(()), |mut writer| writer.finish().map(|_| ()))?;
        Ok(())
    }
}

#[cfg(test)]
impl File<std::io::Cursor<Vec<u8>>> {
    /// Ends the file and returns its bytes.
    pub(super) fn into_bytes(self) -> Vec<u8> {
        let mut writer = self.writer.unwrap();
        writer.finish().unwrap();
        writer.into_inner().into_inner()
    }
}
