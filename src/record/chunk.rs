//! Chunk of an MCAP file: records that are compressed together and have a checksum.
//!
//! - in: the body of the chunk's record, which may be damaged or cut off
//! - out: its records, and the reason if they are not those that were written
//!
//! The compressions are those of the specification: none, `lz4` and `zstd`. `zstd` is decoded by
//! `ruzstd`, a decoder in Rust: the usual library in C takes half a minute to compile, and only
//! recordings of other programs need it.

use super::framing::{self, LONGEST, extent, head, text};
use mcap::records::op;
use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Size of the fields before the data if the compression has the longest name (bytes).
pub(super) const HEAD: usize = BEFORE + 4 + NAME + 8;
/// Size of times, length and checksum (bytes).
const BEFORE: usize = 8 + 8 + 8 + 4;
/// Longest name of a compression (bytes).
const NAME: usize = 16;
/// Number of bytes that are unpacked at once.
const STEP: usize = 1 << 16;

/// Fields of a chunk.
struct Fields<'a> {
    /// Times of the first and the last message (ns).
    times: [u64; 2],
    /// Length of the unpacked records (bytes).
    size: u64,
    /// Checksum of the unpacked records; 0 means none.
    sum: u32,
    /// Name of the compression.
    compression: &'a [u8],
    /// Length of the compressed data according to the chunk (bytes).
    length: u64,
    /// Compressed data that are there; a damaged or cut chunk may have more or fewer.
    data: &'a [u8],
}

/// Splits the body of a chunk into its fields. Returns `None` if it ends before its data.
fn fields(body: &[u8]) -> Option<Fields<'_>> {
    let (first, rest) = body.split_first_chunk()?;
    let (last, rest) = rest.split_first_chunk()?;
    let (size, rest) = rest.split_first_chunk()?;
    let (sum, mut rest) = rest.split_first_chunk()?;
    let compression = text(&mut rest)?;
    let (length, data) = rest.split_first_chunk()?;
    Some(Fields {
        times: [*first, *last].map(u64::from_le_bytes),
        size: u64::from_le_bytes(*size),
        sum: u32::from_le_bytes(*sum),
        compression,
        length: u64::from_le_bytes(*length),
        data,
    })
}

/// Returns the length of a chunk's body according to its fields (bytes). `body` may hold only the
/// first bytes of it, at least up to the data. Returns `None` if these are not the fields of a
/// chunk.
pub(super) fn length(body: &[u8]) -> Option<usize> {
    let Fields { compression, length, .. } = fields(body)?;
    // A chunk of a later version may have another compression: a short word.
    let is_word = compression.len() <= NAME && compression.iter().all(u8::is_ascii_alphanumeric);
    let before = BEFORE + 4 + compression.len() + 8;
    let length = usize::try_from(length).ok()?.checked_add(before)?;
    is_word.then_some(length)
}

/// Returns the fields of a chunk that its index repeats: times of the first and the last message
/// (ns), lengths of the compressed data and of the unpacked records (bytes).
pub(super) fn summary(body: &[u8]) -> Option<([u64; 2], [u64; 2])> {
    let Fields { times, size, length, .. } = fields(body)?;
    Some((times, [length, size]))
}

/// Unpacked records of a chunk.
pub(super) struct Unpacked {
    /// Encoded records one after the other, without a last one that is incomplete.
    pub(super) records: Vec<u8>,
    /// Reason why the records must not be trusted; `None` if they are sound.
    pub(super) flaw: Option<String>,
}

/// Unpacks the body of a chunk, and compares the records with their checksum or, if it has none,
/// with their length.
pub(super) fn unpack(body: &[u8]) -> Unpacked {
    let Some(fields) = fields(body) else {
        return Unpacked { records: Vec::new(), flaw: Some("it has no data".to_owned()) };
    };
    if fields.size > LONGEST as u64 {
        let flaw = Some("it is too long".to_owned());
        return Unpacked { records: Vec::new(), flaw };
    }
    let length = fields.data.len().min(usize::try_from(fields.length).unwrap_or(usize::MAX));
    let data = &fields.data[..length];
    let (mut records, mut flaw) = match fields.compression {
        b"" => (data.to_vec(), None),
        b"lz4" => drained(|| lz4::Decoder::new(data)),
        b"zstd" => drained(|| {
            let window = LONGEST as u64;
            ruzstd::decoding::StreamingDecoder::new_with_max_window_size(data, window)
        }),
        other => {
            let other = other.escape_ascii();
            (Vec::new(), Some(format!("it is compressed with `{other}`, which is not supported")))
        }
    };
    let sum = if flaw.is_none() { crc32fast::hash(&records) } else { 0 };
    if flaw.is_none() && fields.sum != 0 && sum != fields.sum {
        flaw = Some(format!("its checksum is {sum:08X} instead of {:08X}", fields.sum));
    }
    if flaw.is_none() && fields.sum == 0 && records.len() as u64 != fields.size {
        flaw = Some(format!("it has {} bytes instead of {}", records.len(), fields.size));
    }
    // A damaged chunk may end in the middle of a record.
    let (whole, why) = whole(&records);
    records.truncate(whole);
    Unpacked { records, flaw: flaw.or(why.map(str::to_owned)) }
}

/// Returns the bytes that a decoder delivers, and the reason if it fails before the end or delivers
/// more than [`LONGEST`] bytes. If the decoder panics, the file counts as damaged.
fn drained<D: Read, E: std::fmt::Display>(
    decoder: impl FnOnce() -> Result<D, E>,
) -> (Vec<u8>, Option<String>) {
    let mut records = Vec::new();
    let drain = || {
        let mut decoder = decoder().map_err(|why| why.to_string())?;
        loop {
            let there = records.len();
            if there + STEP > records.capacity() {
                // The memory grows by a quarter. `Vec` itself would double it.
                records.reserve_exact(STEP.max(there / 4));
            }
            records.resize(there + STEP, 0);
            let read = decoder.read(&mut records[there..]);
            records.truncate(there + read.as_ref().map_or(0, |read| *read));
            match read {
                Ok(0) => return Ok(()),
                Ok(_) if records.len() > LONGEST => return Err("it is too long".to_owned()),
                Ok(_) => {}
                Err(why) => return Err(format!("its compressed data are damaged: {why}")),
            }
        }
    };
    let drained = catch_unwind(AssertUnwindSafe(drain));
    let flaw = drained.unwrap_or_else(|_| Err("its compressed data are damaged".to_owned())).err();
    (records, flaw)
}

/// Returns the length of the complete records at the front of `bytes` (bytes), and the reason if
/// other bytes follow, which are no record that a chunk may hold.
fn whole(bytes: &[u8]) -> (usize, Option<&'static str>) {
    let mut at = 0;
    while let Some(rest) = bytes.get(at..).filter(|rest| !rest.is_empty()) {
        let length = head(rest).and_then(|(_, length)| usize::try_from(length).ok());
        let end = length.and_then(|length| length.checked_add(framing::HEAD));
        let record = end.and_then(|end| rest.get(..end));
        let Some(record) = record else { return (at, Some("a record is longer than its chunk")) };
        match record[0] {
            // The format allows none of these in a chunk. The chunk is damaged, or made to fill the
            // memory, since nothing limits the total size of metadata and attachments.
            0 | op::CHUNK | op::ATTACHMENT | op::METADATA => {
                return (at, Some("metadata or an attachment in a chunk"));
            }
            opcode if extent(opcode, &record[framing::HEAD..]).is_none() => {
                return (at, Some("a record whose lengths do not fit"));
            }
            _ => at += record.len(),
        }
    }
    (at, None)
}
