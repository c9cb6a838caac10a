//! A recording's file while it is written: MCAP, profile `ros2`, chunks under lz4.
//!
//! - in: messages with topic, type, time; scenario, versions, summary
//! - out: a file whose every finished chunk stands by itself, so that what a crash cuts off is what came after it
//! - source: the MCAP specification, version 0

use super::schema::Kind;
use std::collections::BTreeMap;
use std::io::{Seek, Write};

/// Bytes in a chunk before compression: a second of two arms, about.
const CHUNK: u64 = 768 * 1024;

/// A channel keeps its latest message for whoever comes late.
const LATCHED: &str = "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n  deadline: {sec: 9223372036, nsec: 854775807}\n  lifespan: {sec: 9223372036, nsec: 854775807}\n  liveliness: 1\n  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}\n  avoid_ros_namespace_conventions: false\n";

/// Why nothing can be written any more.
#[derive(Debug, thiserror::Error)]
#[error("{}", reason(.0))]
pub struct Unwritten(#[from] mcap::McapError);

/// What the device said, where it was the device.
fn reason(error: &mcap::McapError) -> String {
    let cause = std::error::Error::source(error);
    cause.map_or_else(|| error.to_string(), ToString::to_string)
}

/// A file being written.
pub struct File<W: Write + Seek> {
    writer: mcap::Writer<W>,
    schemas: BTreeMap<Kind, u16>,
    channels: BTreeMap<String, Channel>,
}

struct Channel {
    id: u16,
    count: u32,
}

impl<W: Write + Seek> File<W> {
    /// Begins a file.
    ///
    /// # Errors
    /// What the device says.
    pub fn begin(to: W) -> Result<Self, Unwritten> {
        let writer = mcap::WriteOptions::new()
            .profile("ros2")
            .library(concat!("rubik-robot ", env!("CARGO_PKG_VERSION")))
            .compression(Some(mcap::Compression::Lz4))
            .chunk_size(Some(CHUNK))
            // A chunk goes out whole, with its length before it: a reader need not guess where a cut one ends.
            .disable_seeking(true)
            .create(to)?;
        Ok(Self { writer, schemas: BTreeMap::new(), channels: BTreeMap::new() })
    }

    /// Writes a message at `time` (ns).
    ///
    /// # Errors
    /// What the device says.
    pub fn message(
        &mut self,
        topic: &str,
        kind: Kind,
        time: u64,
        data: &[u8],
    ) -> Result<(), Unwritten> {
        if !self.channels.contains_key(topic) {
            let id = self.channel(topic, kind)?;
            self.channels.insert(topic.to_owned(), Channel { id, count: 0 });
        }
        let Some(channel) = self.channels.get_mut(topic) else { return Ok(()) };
        channel.count = channel.count.wrapping_add(1);
        let header = mcap::records::MessageHeader {
            channel_id: channel.id,
            sequence: channel.count,
            log_time: time,
            publish_time: time,
        };
        Ok(self.writer.write_to_known_channel(&header, data)?)
    }

    fn channel(&mut self, topic: &str, kind: Kind) -> Result<u16, Unwritten> {
        let schema = if let Some(id) = self.schemas.get(&kind) {
            *id
        } else {
            let text = kind.schema();
            let id = self.writer.add_schema(kind.name(), "ros2msg", text.as_bytes())?;
            self.schemas.insert(kind, id);
            id
        };
        let mut metadata = BTreeMap::new();
        if matches!(topic, "/robot_description" | "/tf_static") {
            metadata.insert("offered_qos_profiles".to_owned(), LATCHED.to_owned());
        }
        Ok(self.writer.add_channel(schema, topic, "cdr", &metadata)?)
    }

    /// Writes named texts.
    ///
    /// # Errors
    /// What the device says.
    pub fn metadata(
        &mut self,
        name: &str,
        entries: &BTreeMap<String, String>,
    ) -> Result<(), Unwritten> {
        let metadata = mcap::records::Metadata { name: name.to_owned(), metadata: entries.clone() };
        Ok(self.writer.write_metadata(&metadata)?)
    }

    /// Puts a whole file into it.
    ///
    /// # Errors
    /// What the device says.
    pub fn attach(&mut self, name: &str, media: &str, data: &[u8]) -> Result<(), Unwritten> {
        let attachment = mcap::Attachment {
            log_time: 0,
            create_time: 0,
            name: name.to_owned(),
            media_type: media.to_owned(),
            data: data.into(),
        };
        Ok(self.writer.attach(&attachment)?)
    }

    /// Ends the chunk, so that what was written can be read whatever comes.
    ///
    /// # Errors
    /// What the device says.
    pub fn flush(&mut self) -> Result<(), Unwritten> {
        Ok(self.writer.flush()?)
    }

    /// Writes the index.
    ///
    /// # Errors
    /// What the device says.
    pub fn finish(mut self) -> Result<(), Unwritten> {
        self.writer.finish()?;
        Ok(())
    }
}
