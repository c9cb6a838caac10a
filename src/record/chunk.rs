//! Chunk of an MCAP file: records that are compressed together and have a checksum.
//!
//! - in: the body of the chunk's record, which may be damaged or cut off
//! - out: its records, and why they are not the ones that were written
//!
//! The compressions are those of the specification: none, `lz4` and `zstd`. `zstd` is decoded by
//! `ruzstd`, a decoder without C: other programs compile the library of C for half a minute, and
//! only foreign recordings need it.

use super::framing::{self, LONGEST, extent, head, text};
use mcap::records::op;
use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Size of the fields before the data, with the longest name of a compression (bytes).
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
    /// Length of the records (bytes) and their checksum; 0 for none.
    size: u64,
    sum: u32,
    compression: &'a [u8],
    /// Length of the data that the chunk gives (bytes), and the data that are there.
    length: u64,
    data: &'a [u8],
}

/// Splits the body of a chunk. `None` if it ends before its data.
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

/// Returns the length that the fields of a chunk give to its body (bytes), whose first bytes are
/// `body`. `None` if they are not those of a chunk.
pub(super) fn length(body: &[u8]) -> Option<usize> {
    let Fields { compression, length, .. } = fields(body)?;
    // A chunk of a later version may have another compression: a short word.
    let is_word = compression.len() <= NAME && compression.iter().all(u8::is_ascii_alphanumeric);
    let before = BEFORE + 4 + compression.len() + 8;
    let length = usize::try_from(length).ok()?.checked_add(before)?;
    is_word.then_some(length)
}

/// Returns the fields of a chunk that its index repeats: times of the first and the last message
/// (ns), length of the data and of the records (bytes).
pub(super) fn summary(body: &[u8]) -> Option<([u64; 2], [u64; 2])> {
    let Fields { times, size, length, .. } = fields(body)?;
    Some((times, [length, size]))
}

/// Records of a chunk.
pub(super) struct Unpacked {
    /// Records, whole ones only.
    pub(super) records: Vec<u8>,
    /// Reason why they must not be trusted.
    pub(super) flaw: Option<String>,
}

/// Unpacks a chunk and compares it with its checksum.
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
    let (whole, why) = whole(&records);
    records.truncate(whole);
    Unpacked { records, flaw: flaw.or(why.map(str::to_owned)) }
}

/// Returns all that a decoder delivers, at most [`LONGEST`] bytes, and the reason if it does not
/// reach the end. A panic of the decoder is an error of the file.
fn drained<D: Read, E: std::fmt::Display>(
    decoder: impl FnOnce() -> Result<D, E>,
) -> (Vec<u8>, Option<String>) {
    let mut records = Vec::new();
    let drain = || {
        let mut decoder = decoder().map_err(|why| why.to_string())?;
        loop {
            let there = records.len();
            if there + STEP > records.capacity() {
                // Growth by a quarter: the usual one would take up to twice the memory.
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

/// Returns the length of the records at the front of `bytes` that are whole (bytes), and the reason
/// if there is more that is no record of a chunk.
fn whole(bytes: &[u8]) -> (usize, Option<&'static str>) {
    let mut at = 0;
    while let Some(rest) = bytes.get(at..).filter(|rest| !rest.is_empty()) {
        let length = head(rest).and_then(|(_, length)| usize::try_from(length).ok());
        let end = length.and_then(|length| length.checked_add(framing::HEAD));
        let record = end.and_then(|end| rest.get(..end));
        let Some(record) = record else { return (at, Some("a record is longer than its chunk")) };
        match record[0] {
            // The format allows neither in a chunk. The chunk is damaged, or made to fill the
            // memory: the size of these items is not counted.
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
