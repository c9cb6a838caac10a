//! Recordings that are damaged at one place, compressed by another program, or whose index is
//! wrong: what is lost, what is reported, what `recover` mends.

use crate::program::program;
use crate::recording::{IDLE, messages, place, recorded, records};
use rubik_robot::record::reading::{End, Message, Reading};
use rubik_robot::record::recover_file::recover_file;
use ruzstd::encoding::{CompressionLevel, compress_to_vec};
use std::io::Cursor;
use std::path::PathBuf;

// Opcodes of the records of an MCAP file; a list is a message index.
const FOOTER: u8 = 0x02;
const CHUNK: u8 = 0x06;
const LIST: u8 = 0x07;
const CHUNK_INDEX: u8 = 0x08;
const STATISTICS: u8 = 0x0b;
const DATA_END: u8 = 0x0f;
/// Size of opcode and length of a record (bytes).
const HEAD: usize = 9;

/// Reads a recording; returns its messages and its end.
fn read(bytes: &[u8]) -> (Vec<Message>, End) {
    let mut reading = Reading::seekable(Cursor::new(bytes));
    let read = messages(reading.by_ref());
    (read, reading.end().unwrap().clone())
}

/// Returns a recording of a second of the idle task, as bytes.
fn idle(name: &str) -> Vec<u8> {
    std::fs::read(recorded(name, "scenarios/idle.toml", &IDLE).0).unwrap()
}

/// Writes bytes to a temporary file with this name.
fn saved(name: &str, bytes: &[u8]) -> PathBuf {
    let path = place(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

/// Returns the number of messages in each chunk, by the lists that follow it.
fn messages_of_chunks(bytes: &[u8]) -> Vec<usize> {
    let lists = records(bytes, LIST);
    let chunks = records(bytes, CHUNK);
    let ends = chunks.iter().skip(1).map(|next| next.start).chain([bytes.len()]);
    let count = |(chunk, end): (&std::ops::Range<usize>, usize)| {
        let own = lists.iter().filter(|list| (chunk.start..end).contains(&list.start));
        // Channel and length of the list, then 16 bytes for each message.
        own.map(|list| (list.len() - 6) / 16).sum()
    };
    chunks.iter().zip(ends).map(count).collect()
}

/// Returns a copy of a recording with every chunk compressed by `pack`, without an index.
fn repacked(bytes: &[u8], compression: &str, pack: impl Fn(&[u8]) -> Vec<u8>) -> Vec<u8> {
    let mut copy = mcap::MAGIC.to_vec();
    let mut record = |opcode: u8, body: &[u8]| {
        copy.push(opcode);
        copy.extend((body.len() as u64).to_le_bytes());
        copy.extend(body);
    };
    let mut at = mcap::MAGIC.len();
    while bytes[at] != DATA_END {
        let length = u64::from_le_bytes(bytes[at + 1..at + HEAD].try_into().unwrap()) as usize;
        let body = &bytes[at + HEAD..at + HEAD + length];
        if bytes[at] == CHUNK {
            // Times, length and checksum stay; `lz4` and the length of the data follow.
            let mut plain = Vec::new();
            let mut decoder = lz4::Decoder::new(&body[28 + 4 + 3 + 8..]).unwrap();
            std::io::copy(&mut decoder, &mut plain).unwrap();
            let packed = pack(&plain);
            let name = (compression.len() as u32).to_le_bytes();
            let size = (packed.len() as u64).to_le_bytes();
            let parts = [&body[..28], &name, compression.as_bytes(), &size, &packed];
            record(CHUNK, &parts.concat());
        } else {
            record(bytes[at], body);
        }
        at += HEAD + length;
    }
    record(DATA_END, &[0; 4]);
    record(FOOTER, &[0; 20]);
    copy.extend(mcap::MAGIC);
    copy
}

/// Checks that the damage of a chunk costs no more than `most` messages.
#[track_caller]
fn assert_cost(damaged: &[u8], whole: &[Message], most: usize, what: &str) {
    let (read, end) = read(damaged);
    assert!(read.len() + most >= whole.len(), "{what}: {} of {}, {end}", read.len(), whole.len());
    let mut rest = whole.iter();
    assert!(read.iter().all(|message| rest.any(|w| w == message)), "{what}: another message");
    assert!(matches!(end, End::Damaged(_)), "{what}: {end:?}");
}

/// The reader leaves out the chunk and continues behind it; messages keep the channels that only
/// the damaged chunk has described.
#[test]
fn damaged_chunk_costs_its_own_messages_only() {
    let bytes = idle("one_chunk.mcap");
    let (whole, end) = read(&bytes);
    assert_eq!(end, End::Whole);
    let chunks = records(&bytes, CHUNK);
    assert!(chunks.len() > 2);

    for (chunk, own) in chunks.iter().zip(messages_of_chunks(&bytes)) {
        let mut damaged = bytes.clone();
        damaged[chunk.start.midpoint(chunk.end)] ^= 0x10;
        assert_cost(&damaged, &whole, own, &format!("data at {}", chunk.start));
        // Each bit of opcode and length, of the length before compression, of the name of the
        // compression with its length, and of the length of the data.
        let head = chunk.start - HEAD..chunk.start;
        let sizes = chunk.start + 16..chunk.start + 24;
        let words = chunk.start + 28..chunk.start + 28 + 4 + 3 + 8;
        for at in head.chain(sizes).chain(words) {
            for bit in 0..8 {
                let mut damaged = bytes.clone();
                damaged[at] ^= 1 << bit;
                let (read, end) = read(&damaged);
                let what = format!("byte {at}, bit {bit}: {} of {}", read.len(), whole.len());
                assert!(read.len() + own >= whole.len() && end.flaw().is_some(), "{what}: {end}");
            }
        }
    }
}

#[test]
fn damaged_record_between_chunks_costs_no_message() {
    let bytes = idle("between.mcap");
    let (whole, _) = read(&bytes);
    let end = records(&bytes, DATA_END)[0].start;
    let others = [LIST, 0x0c, 0x09].iter().flat_map(|kind| records(&bytes, *kind));

    for record in others.filter(|record| record.end < end) {
        for at in record.start - HEAD..(record.start + 8).min(record.end) {
            let mut damaged = bytes.clone();
            damaged[at] ^= 1 << (at % 8);
            assert_cost(&damaged, &whole, 0, &format!("byte {at}"));
        }
    }
}

/// The length of a list says that it ends where the record behind the next chunk begins, so that a
/// record follows it as it should. Its fields end before the chunk.
#[test]
fn list_with_wrong_length_costs_no_chunk() {
    let bytes = idle("reaching.mcap");
    let (whole, _) = read(&bytes);
    let mut tried = 0;
    for chunk in records(&bytes, CHUNK) {
        let lists = records(&bytes, LIST);
        let Some(list) = lists.into_iter().find(|list| list.end + HEAD == chunk.start) else {
            continue;
        };
        let mut damaged = bytes.clone();
        let length = (chunk.end - list.start) as u64;
        damaged[list.start - HEAD + 1..list.start].copy_from_slice(&length.to_le_bytes());
        assert_cost(&damaged, &whole, 0, &format!("list at {}", list.start));
        tried += 1;
    }
    assert!(tried > 0);
}

/// After a power cut some file systems give a file its length, and zeros that were never written.
#[test]
fn zero_filled_tail_costs_no_more_than_cut() {
    let bytes = idle("zeros.mcap");
    for place in (64..bytes.len() - 64).step_by(bytes.len() / 41) {
        let (cut, _) = read(&bytes[..place]);
        let mut zeros = bytes.clone();
        zeros[place..].fill(0);

        let (kept, end) = read(&zeros);

        assert_eq!(kept.len(), cut.len(), "byte {place}");
        assert!(matches!(&end, End::Cut(why) if why.contains("zeros")), "byte {place}: {end:?}");
    }
}

#[test]
fn recordings_of_each_compression_are_read_whole() {
    let bytes = idle("packed.mcap");
    let (whole, _) = read(&bytes);
    let zstd = repacked(&bytes, "zstd", |plain| compress_to_vec(plain, CompressionLevel::Fastest));
    let plain = repacked(&bytes, "", <[u8]>::to_vec);
    for file in [&zstd, &plain] {
        assert_eq!(read(file), (whole.clone(), End::Whole));
    }

    // The commands read it as well.
    let path = saved("zstd.mcap", &zstd);
    let page = path.with_extension("html");
    let output = program().arg("report").args([&path, &"-o".into(), &page]).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    assert!(!String::from_utf8_lossy(&output.stderr).contains("damaged"), "{output:?}");
    // A damaged chunk is one chunk here, too.
    for file in [&zstd, &plain] {
        let chunk = records(file, CHUNK).pop().unwrap();
        let mut damaged = file.clone();
        damaged[chunk.start.midpoint(chunk.end)] ^= 1;
        assert_cost(&damaged, &whole, messages_of_chunks(&bytes).pop().unwrap(), "last chunk");
    }
}

/// Other programs find the messages by the index. A wrong one is reported although all messages
/// are read, and the recovered file has a right one.
#[test]
fn wrong_index_is_reported_and_mended() {
    let bytes = idle("index.mcap");
    let (whole, _) = read(&bytes);
    let at = |kind: u8, more: usize| records(&bytes, kind)[0].start + more;
    let flipped = |at: usize| {
        let mut copy = bytes.clone();
        copy[at] ^= 4;
        copy
    };
    let cases = [
        (flipped(at(CHUNK_INDEX, 16)), "at least one of its chunks wrongly"),
        (flipped(at(STATISTICS, 0)), "messages instead of"),
        (flipped(at(FOOTER, 0)), "the footer says byte"),
        (flipped(at(FOOTER, 8)), "for its offsets"),
        (flipped(at(FOOTER, 16)), "its checksum is wrong"),
        ([&bytes[..], b"left over"].concat(), "9 bytes follow the end of the recording"),
    ];

    for (file, why) in cases {
        let (read_whole, end) = read(&file);
        assert_eq!(read_whole, whole, "{why}");
        let End::Index(reason) = &end else { panic!("{why}: {end:?}") };
        assert!(reason.contains(why), "{reason}");
        let mut mended = Cursor::new(Vec::new());
        recover_file(Cursor::new(&file), &mut mended).unwrap();
        assert_eq!(read(mended.get_ref()), (whole.clone(), End::Whole), "{why}");
        let summary = mcap::Summary::read(mended.get_ref()).unwrap().unwrap();
        assert_eq!(summary.stats.unwrap().message_count as usize, whole.len());
    }
    let path = saved("wrong_index.mcap", &flipped(at(STATISTICS, 0)));
    let page = path.with_extension("html");
    let output = program().arg("report").args([&path, &"-o".into(), &page]).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success() && stderr.contains("complete except for its index"),
        "{stderr}"
    );
    assert!(stderr.contains("`rubik-robot recover` writes a new index"), "{stderr}");
}

#[test]
fn report_without_usable_message_exits_with_2() {
    let bytes = idle("unusable.mcap");
    let first = records(&bytes, CHUNK)[0].start - HEAD;
    let foreign = repacked(&bytes, "other", <[u8]>::to_vec);
    for (name, file) in [("cut_early.mcap", &bytes[..first]), ("foreign.mcap", &foreign)] {
        let path = saved(name, file);
        let page = path.with_extension("html");
        let _ = std::fs::remove_file(&page);

        let output = program().arg("report").args([&path, &"-o".into(), &page]).output().unwrap();

        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{name}: {stderr}");
        assert_eq!(stderr.lines().count(), 1, "{stderr}");
        assert!(stderr.contains("no message of a run can be read"), "{stderr}");
        assert!(!page.exists(), "{name}");
    }
}
