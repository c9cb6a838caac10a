//! Hostile input: what comes from outside may be anything, and nothing of it panics, hangs or takes unbounded memory.
//!
//! Each kind has a corpus of hard cases in `tests/corpus/KIND`, and a property over random bytes, over its own corpus
//! spoilt in places, and over text of its own alphabet. Every input is limited in memory (counted by the allocator)
//! and in time (a watchdog names the input that hangs).
//!
//! `HOSTILE_CASES=100000 PROPTEST_RNG_SEED=$RANDOM cargo test --release --test hostile` looks longer; what it finds belongs into the corpus.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop loudly")]

use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};
use rubik_robot::campaign::state::State;
use rubik_robot::campaign::vary::Vary;
use rubik_robot::cube::{Cube, Facelets, after_moves, parse_moves, parse_turns};
use rubik_robot::hw::force::{
    FT_RECORD, RDT_RECORD, RdtRecord, Sequence, decode_record, start_request,
};
use rubik_robot::hw::serial::axis::{Axis, AxisDrive, Rules};
use rubik_robot::hw::serial::frame::{ORDER, Order, STATUS, Status};
use rubik_robot::operator::Command;
use rubik_robot::record::journal::Journal;
use rubik_robot::record::reading::Reading;
use rubik_robot::record::{recover, report};
use rubik_robot::scenario::{self, Override};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

mod memory;

/// Memory that an input may take beside itself [bytes].
const MEMORY: usize = 256 << 20;
/// Time that an input may take.
const TIME: Duration = Duration::from_secs(10);

/// When the present input must be done, in milliseconds since the first; 0 while there is none.
static DUE: AtomicU64 = AtomicU64::new(0);
static NOW: Mutex<Option<(String, Vec<u8>)>> = Mutex::new(None);

/// Ends the process with the input's name when it hangs: a test cannot be ended otherwise.
fn watch() -> Instant {
    static BEGUN: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
    *BEGUN.get_or_init(|| {
        std::thread::spawn(|| {
            loop {
                std::thread::sleep(Duration::from_millis(200));
                let (due, now) = (DUE.load(Ordering::SeqCst), watch().elapsed().as_millis() as u64);
                if due > 0 && now > due {
                    let input = NOW.lock().unwrap_or_else(PoisonError::into_inner);
                    eprintln!(
                        "HANGS: {:?}",
                        input.as_ref().map(|(n, b)| (n, String::from_utf8_lossy(b)))
                    );
                    std::process::abort();
                }
            }
        });
        Instant::now()
    })
}

/// Gives an input to a reader under all limits.
fn give(name: &str, input: &[u8], read: &dyn Fn(&[u8])) {
    let _alone = memory::alone();
    let begun = watch();
    *NOW.lock().unwrap_or_else(PoisonError::into_inner) = Some((name.to_owned(), input.to_vec()));
    DUE.store((begun.elapsed() + TIME).as_millis() as u64, Ordering::SeqCst);
    let taken = memory::most_held(|| read(input));
    DUE.store(0, Ordering::SeqCst);
    assert!(taken < MEMORY, "{name}: {taken} bytes of memory for {} bytes", input.len());
}

fn corpus(kind: &str) -> Vec<(String, Vec<u8>)> {
    let folder: PathBuf = [env!("CARGO_MANIFEST_DIR"), "tests/corpus", kind].iter().collect();
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    files.sort();
    assert!(files.len() >= 5, "the corpus of {kind} is small");
    files.into_iter().map(|p| (p.display().to_string(), std::fs::read(&p).unwrap())).collect()
}

/// What a corpus's file becomes when it is spoilt.
#[derive(Debug, Clone)]
enum Spoil {
    Cut(usize),
    Flip(usize, u8),
    Insert(usize, Vec<u8>),
    Remove(usize, usize),
    Double(usize, usize),
}

fn spoils() -> impl Strategy<Value = Vec<Spoil>> {
    let at = 0..100_000usize;
    let one = prop_oneof![
        at.clone().prop_map(Spoil::Cut),
        (at.clone(), any::<u8>()).prop_map(|(at, bit)| Spoil::Flip(at, bit)),
        (at.clone(), proptest::collection::vec(any::<u8>(), 1..20))
            .prop_map(|(at, bytes)| Spoil::Insert(at, bytes)),
        (at.clone(), 1..50usize).prop_map(|(at, n)| Spoil::Remove(at, n)),
        (at, 1..200usize).prop_map(|(at, n)| Spoil::Double(at, n)),
    ];
    proptest::collection::vec(one, 1..4)
}

fn spoilt(bytes: &[u8], spoils: &[Spoil]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for spoil in spoils {
        let place = |at: usize| at % (bytes.len() + 1);
        match spoil {
            Spoil::Cut(at) => bytes.truncate(place(*at)),
            Spoil::Flip(at, bits) => {
                let at = place(*at);
                if let Some(byte) = bytes.get_mut(at) {
                    *byte ^= bits;
                }
            }
            Spoil::Insert(at, more) => {
                let at = place(*at);
                bytes.splice(at..at, more.iter().copied());
            }
            Spoil::Remove(at, n) => {
                let at = place(*at);
                let end = (at + n).min(bytes.len());
                bytes.drain(at..end);
            }
            Spoil::Double(at, n) => {
                let at = place(*at);
                let end = (at + n).min(bytes.len());
                let again = bytes[at..end].to_vec();
                bytes.splice(at..at, again);
            }
        }
    }
    bytes
}

/// The corpus, then random bytes, spoilt files and text of an alphabet.
fn hostile(kind: &str, alphabet: &str, cases: u32, read: &dyn Fn(&[u8])) {
    let files = corpus(kind);
    for (name, bytes) in &files {
        give(name, bytes, read);
    }
    let cases = std::env::var("HOSTILE_CASES").ok().and_then(|n| n.parse().ok()).unwrap_or(cases);
    let mut runner = TestRunner::new(Config {
        cases,
        failure_persistence: None,
        max_shrink_iters: 2000,
        ..Config::default()
    });
    let letters: Vec<char> = alphabet.chars().collect();
    let words = proptest::collection::vec(proptest::sample::select(letters), 0..200)
        .prop_map(|letters| letters.into_iter().collect::<String>().into_bytes());
    let random = proptest::collection::vec(any::<u8>(), 0..400);
    let of_corpus =
        (0..files.len(), spoils()).prop_map(move |(at, spoils)| spoilt(&files[at].1, &spoils));
    let inputs = prop_oneof![1 => words, 1 => random, 3 => of_corpus];
    let kind = kind.to_owned();
    runner
        .run(&inputs, |input| {
            give(&kind, &input, read);
            Ok(())
        })
        .unwrap();
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn scenario_files() {
    let letters = "[]{}=\"'.,#\n abcetxy0123456789-_+einf";
    hostile("scenario", letters, 300, &|bytes| {
        let text = text(bytes);
        if let Err(faults) = scenario::read(Path::new("hostile.toml"), &text, &[]) {
            assert!(!faults.to_string().is_empty());
        }
        // The same bytes as an option of the command line.
        if let Ok(over) = Override::parse(&text) {
            let _ = scenario::read(Path::new("t.toml"), "", &[over]);
        }
    });
}

#[test]
fn files_of_what_is_drawn() {
    let letters = "[]{}=\"., \nuniformwhleabc0123456789-_e";
    hostile("vary", letters, 1000, &|bytes| {
        if let Ok(vary) = Vary::read(Path::new("hostile.toml"), &text(bytes)) {
            for seed in [0, 1, u64::MAX] {
                let drawn = vary.draw(seed);
                assert_eq!(drawn, vary.draw(seed));
                assert!(drawn.iter().all(|d| !d.value.is_empty() && !d.value.contains("NaN")));
            }
        }
    });
}

#[test]
fn facelets() {
    hostile("facelets", "URFDLBurfdlb x", 3000, &|bytes| {
        if let Ok(facelets) = text(bytes).parse::<Facelets>() {
            // Whatever can be read is either a cube or is refused with a reason.
            if let Err(why) = Cube::try_from(facelets) {
                assert!(!why.to_string().is_empty() && why.places().len() <= 54);
            }
        }
    });
}

#[test]
fn scrambles() {
    hostile("scramble", "URFDLBMESxyzw23'\u{2019} ", 2000, &|bytes| {
        let text = text(bytes);
        let _ = parse_turns(&text);
        if let Ok(moves) = parse_moves(&text) {
            let _ = after_moves(&Facelets::solved(), &moves);
        }
    });
}

#[test]
fn recordings() {
    hostile("mcap", "\u{89}MCAP0\r\n\u{1}\u{2}\u{6}", 400, &|bytes| {
        let mut reading = Reading::new(bytes);
        // A piece costs at least a byte.
        assert!(reading.by_ref().take(bytes.len() + 10).count() < bytes.len() + 10);
        assert!(reading.end().is_some());
        if let Ok(story) = report::gather(bytes) {
            assert!(!report::page(&story).contains("<script"));
        }
        let _ = recover::recover(bytes, std::io::Cursor::new(Vec::new()));
    });
}

#[test]
fn state_files_of_campaigns() {
    hostile("state", "{}[]\":,\n seedvrictphaonu0123456789.", 1500, &|bytes| {
        if let Ok(state) = State::read(bytes) {
            assert!(state.whole as usize <= bytes.len());
            assert!(state.results.keys().all(|seed| state.header.holds(*seed)));
            // What was read whole is read again the same.
            let again = State::read(&bytes[..state.whole as usize]).unwrap();
            assert_eq!(again.results.len(), state.results.len());
        }
    });
}

#[test]
fn journals() {
    let path = std::env::temp_dir().join(format!("rubik-hostile-{}", std::process::id()));
    hostile("journal", "{}[]\":,\n doinghelOT0123456789.", 500, &|bytes| {
        std::fs::write(&path, bytes).unwrap();
        if let Ok(Some(entry)) = Journal::last(&path) {
            // Whatever was noted last is noted last again behind what a crash left, or stays so where it grows too long with
            // what it leaves out.
            match Journal::open(&path, true).unwrap().write(&entry) {
                Ok(()) => {}
                Err(why) => assert_eq!(why.kind(), std::io::ErrorKind::InvalidInput),
            }
            assert_eq!(Journal::last(&path).unwrap(), Some(entry));
        }
    });
    std::fs::remove_file(path).unwrap();
}

#[test]
fn frames_on_serial_lines() {
    let drive = AxisDrive {
        enabled: true,
        width: 30,
        outputs: 0,
        max_current: Some(9000),
        synchronise: false,
    };
    hostile("serial", "#\0\u{1}\u{2}\u{f}", 3000, &|bytes| {
        let mut axis = Axis::new(Rules::default());
        for chunk in bytes.chunks(STATUS) {
            axis.order(&drive);
            let answer = <&[u8; STATUS]>::try_from(chunk).ok();
            if let Some(answer) = answer {
                let _ = axis.is_late(answer);
                assert_eq!(Status::decode(answer).encode()[1..], answer[1..]);
            }
            if axis.take(answer).is_err() {
                break;
            }
            assert!(axis.current().is_finite());
        }
        for order in bytes.chunks(ORDER) {
            if let Ok(order) = <&[u8; ORDER]>::try_from(order)
                && let Some(read) = Order::decode(order)
            {
                assert_eq!(Order::decode(&read.encode()), Some(read));
            }
        }
        for record in bytes.chunks(FT_RECORD) {
            if let Ok(record) = <&[u8; FT_RECORD]>::try_from(record) {
                assert!(decode_record(record).1.is_finite());
            }
        }
    });
}

#[test]
fn datagrams() {
    hostile("udp", "\0\u{1}\u{7f}", 3000, &|bytes| {
        let _ = start_request(bytes);
        let mut sequence = Sequence::default();
        for datagram in bytes.chunks(RDT_RECORD) {
            if let Some(record) = RdtRecord::decode(datagram) {
                sequence.place(record.sequence);
                assert_eq!(record.encode(), datagram);
                assert!(record.wrench(1e6, 1e6).is_finite());
            }
        }
    });
}

#[test]
fn messages_of_pages() {
    hostile("websocket", "{}[]\":,commandseatxirsuwgphy0123456789.-e", 3000, &|bytes| {
        if let Ok(command) = serde_json::from_slice::<Command>(bytes) {
            assert!(!command.words().is_empty());
        }
    });
}
