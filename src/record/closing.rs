//! Check of the index at the end of an MCAP file. Other programs need it to read the file.
//!
//! - in: the records of the data as they were found, then those of the summary
//! - out: the reason why a reader that trusts the index cannot use the file
//! - source: the MCAP specification, version 0: summary section, footer
//!
//! The index must list each record at the place where it was found. The two sets of places are
//! compared by a sum over the hashes of the places, so that the memory does not grow with the file.

use super::chunk;
use mcap::records::{MessageHeader, Record, Statistics, op};
use std::hash::{DefaultHasher, Hash, Hasher};

/// Set of places in the file, kept as its size and the sum of the hashes of its places.
#[derive(Debug, Default, PartialEq, Eq)]
struct Places {
    count: u64,
    sum: u64,
}

impl Places {
    /// Adds a place to the set.
    fn add(&mut self, place: impl Hash) {
        let mut hash = DefaultHasher::new();
        place.hash(&mut hash);
        self.count += 1;
        self.sum = self.sum.wrapping_add(hash.finish());
    }
}

/// Places of messages in their chunks, and of chunks, attachments and metadata.
#[derive(Debug, Default)]
struct Table {
    messages: Places,
    chunks: Places,
    attachments: Places,
    metadata: Places,
}

/// Index of a file that is being read.
#[derive(Debug, Default)]
pub(super) struct Closing {
    /// Places where records were found.
    there: Table,
    /// Places that the index lists.
    listed: Table,
    /// Number of messages found.
    messages: u64,
    /// Position of the last chunk found.
    chunk: u64,
    statistics: Option<Statistics>,
    /// Position behind the data; `None` before they end.
    begin: Option<u64>,
    /// Position of the first summary offset, a record that locates a group of the summary.
    offsets: Option<u64>,
    /// Whether the summary has a record before its footer.
    has_records: bool,
    /// First reason why the index cannot be used.
    flaw: Option<String>,
}

impl Closing {
    /// Counts a message, and notes its position `at` in the last chunk (bytes); `None` if it is in
    /// no chunk.
    pub(super) fn message(&mut self, header: &MessageHeader, at: Option<u64>) {
        self.messages += 1;
        if let Some(at) = at {
            self.there.messages.add((self.chunk, header.channel_id, header.log_time, at));
        }
    }

    /// Notes the places in the body of a message index, which lists messages of the last chunk.
    pub(super) fn list(&mut self, body: &[u8]) {
        if let Ok(Record::MessageIndex(list)) = mcap::parse_record(op::MESSAGE_INDEX, body) {
            for entry in list.records {
                let place = (self.chunk, list.channel_id, entry.log_time, entry.offset);
                self.listed.messages.add(place);
            }
        }
    }

    /// Notes a record of the data with its place: position and length with the head (bytes).
    pub(super) fn record(&mut self, opcode: u8, body: &[u8], place: (u64, u64)) {
        match opcode {
            op::CHUNK => {
                self.chunk = place.0;
                self.there.chunks.add((place, chunk::summary(body)));
            }
            op::ATTACHMENT => self.there.attachments.add(place),
            op::METADATA => self.there.metadata.add(place),
            _ => {}
        }
    }

    /// Notes that the data end, and that the summary begins at the position `at`.
    pub(super) fn begin(&mut self, at: u64) {
        self.begin = Some(at);
    }

    /// Checks whether the data have ended.
    pub(super) fn has_begun(&self) -> bool {
        self.begin.is_some()
    }

    /// Keeps a reason why the index cannot be used unless there is one already.
    pub(super) fn fails(&mut self, why: impl Into<String>) {
        self.flaw.get_or_insert_with(|| why.into());
    }

    /// Returns the reason why the index cannot be used.
    pub(super) fn flaw(&self) -> Option<&str> {
        self.flaw.as_deref()
    }

    /// Takes a record of the summary at the position `at`; the footer, which ends the summary,
    /// starts the comparison. `sum` is the checksum of the summary up to this record; for the
    /// footer, it includes the fields before the footer's own checksum.
    pub(super) fn take(&mut self, record: Record<'_>, at: u64, sum: u32) {
        match record {
            Record::Footer(footer) => {
                self.places(footer.summary_start, footer.summary_offset_start, at);
                self.compare(footer.summary_start != 0);
                // The reasons found above say more, so they have precedence.
                if footer.summary_crc != 0 && footer.summary_crc != sum {
                    self.fails("its checksum is wrong");
                }
                return;
            }
            Record::ChunkIndex(index) => {
                let place = (index.chunk_start_offset, index.chunk_length);
                let times = [index.message_start_time, index.message_end_time];
                let sizes = [index.compressed_size, index.uncompressed_size];
                self.listed.chunks.add((place, Some((times, sizes))));
            }
            Record::AttachmentIndex(index) => {
                self.listed.attachments.add((index.offset, index.length));
            }
            Record::MetadataIndex(index) => self.listed.metadata.add((index.offset, index.length)),
            Record::Statistics(statistics) => self.statistics = Some(statistics),
            Record::SummaryOffset(_) => {
                self.offsets.get_or_insert(at);
            }
            Record::Schema { .. } | Record::Channel(_) => {}
            other if other.opcode() >= 0x80 => {}
            _ => self.fails(format!("a record at byte {at} does not belong there")),
        }
        self.has_records = true;
    }

    /// Compares the positions of the summary (`start`) and of its offsets (`offsets`) according to
    /// the footer with those found. The footer itself is at the position `footer`.
    fn places(&mut self, start: u64, offsets: u64, footer: u64) {
        // For an empty summary the footer says 0 or, in some files, the end of the data.
        let begin = if self.has_records { self.begin.unwrap_or(0) } else { 0 };
        let none = !self.has_records && Some(start) == self.begin;
        if start != begin && !none {
            self.fails(format!("the footer says byte {start}, but the index begins at {begin}"));
        }
        let found = self.offsets.unwrap_or(0);
        let none = self.offsets.is_none() && offsets == footer;
        if offsets != found && !none {
            self.fails(format!("the footer says byte {offsets} for its offsets, not {found}"));
        }
    }

    /// Compares the lists and counts of the index with the records of the data. A list may be
    /// absent.
    fn compare(&mut self, has_summary: bool) {
        let (there, listed) = (&self.there, &self.listed);
        if listed.messages.count > 0 && there.messages != listed.messages {
            return self.fails("the lists of messages behind the chunks are wrong");
        }
        if !has_summary {
            return;
        }
        let lists = [
            ("chunks", &there.chunks, &listed.chunks),
            ("attachments", &there.attachments, &listed.attachments),
            ("metadata records", &there.metadata, &listed.metadata),
        ];
        let wrong =
            lists.into_iter().find(|(_, there, listed)| listed.count > 0 && there != listed);
        let mut why = wrong.map(|(what, there, listed)| {
            if there.count == listed.count {
                format!("it describes at least one of its {what} wrongly")
            } else {
                format!("it lists {} of {} {what}", listed.count, there.count)
            }
        });
        if let (None, Some(statistics)) = (&why, &self.statistics) {
            let chunks = u64::from(statistics.chunk_count);
            for (what, said, found) in [
                ("messages", statistics.message_count, self.messages),
                ("chunks", chunks, there.chunks.count),
                ("attachments", u64::from(statistics.attachment_count), there.attachments.count),
                ("metadata records", u64::from(statistics.metadata_count), there.metadata.count),
            ] {
                if said != found {
                    why.get_or_insert_with(|| {
                        format!("it counts {said} {what} instead of {found}")
                    });
                }
            }
        }
        if let Some(why) = why {
            self.fails(why);
        }
    }
}
