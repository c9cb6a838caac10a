//! Tests of all readers of outside data with hostile input: none panics, hangs or takes unbounded
//! memory.
//!
//! Each kind of input has hard cases in `tests/corpus/KIND` and a property. The property draws
//! random bytes, files of the corpus with corruptions, and text from an alphabet of the kind. The
//! allocator counts the memory of each input, and a watchdog names an input that hangs.
//!
//! `HOSTILE_CASES=100000 PROPTEST_RNG_SEED=$RANDOM cargo test --release --test hostile` searches
//! longer. `HOSTILE_SECONDS=60` searches each kind for 60 s, with new seeds all the time. The
//! search writes an input that fails into the corpus.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop loudly")]

use proptest::prelude::*;
use rubik_robot::campaign::page;
use rubik_robot::campaign::state::State;
use rubik_robot::campaign::tally::Tally;
use rubik_robot::campaign::vary::Variations;
use rubik_robot::cli::cubes::measured_squares;
use rubik_robot::cli::evaluate::evaluate;
use rubik_robot::cube::{Cube, Facelets, after_moves, parse_moves, parse_turns};
use rubik_robot::desk::Desk;
use rubik_robot::generators::Behaviour;
use rubik_robot::hw::devices::Devices;
use rubik_robot::hw::force::{
    FT_RECORD, RDT_RECORD, RdtRecord, Sequence, decode_record, start_request,
};
use rubik_robot::hw::plant::saved::Saved;
use rubik_robot::hw::plant::{Plant, PlantConfig};
use rubik_robot::hw::port::Port as _;
use rubik_robot::hw::serial::axis::{Axis, AxisDrive, Rules};
use rubik_robot::hw::serial::frame::{ORDER, Order, STATUS, Status};
use rubik_robot::kernel::sensor::SensorReadings;
use rubik_robot::kernel::{Action, Event, Forces, Kernel as _, Readings, Until};
use rubik_robot::motion::{ArmState, JointPositions};
use rubik_robot::operator::{self, Answer, Manual, Step};
use rubik_robot::record::journal::Journal;
use rubik_robot::record::reading::{Piece, Reading};
use rubik_robot::record::{recover_file, report};
use rubik_robot::scenario::Override;
use rubik_robot::servo::io::{ArmDrive, ArmReading};
use rubik_robot::tasks::cube::mission::Entry;
use rubik_robot::tasks::idle::panel::{self, ArmLimits, Panel};
use rubik_robot::vision::colours::decide_cube;
use rubik_robot::web;
use search::Input;
use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::time::Duration;

mod memory;
mod search;

/// Memory that a reader may take beside its input (bytes).
const MEMORY: usize = 256 << 20;
/// Time that a reader may take.
const TIME: Duration = Duration::from_secs(10);

/// Calls the reader `read` with an input from the file `name`. Fails if the reader takes too much
/// memory or hangs.
fn give(name: &str, input: &[u8], read: &dyn Fn(&[u8])) {
    limited(Input::by_name(name), name, input, read);
}

/// Calls the reader `read` with a generated input. Fails if the reader takes too much memory or
/// hangs; an input with which it hangs is written to the corpus of its `kind`.
fn give_found(kind: &'static str, input: &[u8], read: &dyn Fn(&[u8])) {
    let bytes = input.to_vec();
    limited(Input::generated(kind, move || bytes.clone()), kind, input, read);
}

/// Calls the reader `read` with `input`, which the watchdog knows as `told` and messages as `name`.
/// Fails if the reader takes too much memory or hangs.
fn limited(told: Input, name: &str, input: &[u8], read: &dyn Fn(&[u8])) {
    let (taken, _) = search::watched(told, TIME, || read(input));
    assert!(taken < MEMORY, "{name}: {taken} bytes of memory for {} bytes", input.len());
}

/// Returns the files in the corpus of a kind, each with its path and its content.
fn corpus(kind: &str) -> Vec<(String, Vec<u8>)> {
    let folder: PathBuf = [env!("CARGO_MANIFEST_DIR"), "tests/corpus", kind].iter().collect();
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    files.sort();
    assert!(files.len() >= 5, "the corpus of {kind} is small");
    files.into_iter().map(|p| (p.display().to_string(), std::fs::read(&p).unwrap())).collect()
}

/// Corruption of a file: places are taken modulo its length.
#[derive(Debug, Clone)]
enum Corruption {
    /// Ends the file at a place.
    Cut(usize),
    /// Flips these bits of the byte at a place.
    Flip(usize, u8),
    /// Inserts bytes at a place.
    Insert(usize, Vec<u8>),
    /// Removes a number of bytes from a place on.
    Remove(usize, usize),
    /// Repeats a number of bytes from a place on.
    Double(usize, usize),
    /// Replaces one of the text's numbers by another.
    Number(usize, &'static str),
}

/// Numbers at the ends of their types, and words in place of numbers.
const NUMBERS: [&str; 20] = [
    "0",
    "-0.0",
    "1",
    "-1",
    "9",
    "99",
    "0.5",
    "-1000",
    "1e5",
    "1e20",
    "1e300",
    "-1e308",
    "1e308",
    "1e999",
    "1e-308",
    "4294967295",
    "18446744073709551615",
    "-9223372036854775808",
    "nan",
    "null",
];

/// Returns the ranges of bytes at which the numbers in a text are written.
fn numbers(bytes: &[u8]) -> Vec<std::ops::Range<usize>> {
    let mut found = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        let part = |b: &u8| b.is_ascii_digit() || matches!(b, b'.' | b'-' | b'+' | b'e' | b'E');
        let begins = bytes[at].is_ascii_digit() || bytes[at] == b'-';
        let length = if begins { bytes[at..].iter().take_while(|b| part(b)).count() } else { 0 };
        if length > 0 {
            found.push(at..at + length);
        }
        at += length.max(1);
    }
    found
}

/// Generates one to three corruptions of a file.
fn corruptions() -> impl Strategy<Value = Vec<Corruption>> {
    let at = 0..100_000usize;
    let one = prop_oneof![
        at.clone().prop_map(Corruption::Cut),
        (at.clone(), any::<u8>()).prop_map(|(at, bit)| Corruption::Flip(at, bit)),
        (at.clone(), proptest::collection::vec(any::<u8>(), 1..20))
            .prop_map(|(at, bytes)| Corruption::Insert(at, bytes)),
        (at.clone(), 1..50usize).prop_map(|(at, n)| Corruption::Remove(at, n)),
        (at.clone(), 1..200usize).prop_map(|(at, n)| Corruption::Double(at, n)),
        (at, proptest::sample::select(&NUMBERS[..])).prop_map(|(at, n)| Corruption::Number(at, n)),
    ];
    proptest::collection::vec(one, 1..4)
}

/// Returns the content of a file after these corruptions, one after the other.
fn corrupted(bytes: &[u8], corruptions: &[Corruption]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for corruption in corruptions {
        let place = |at: usize| at % (bytes.len() + 1);
        match corruption {
            Corruption::Cut(at) => bytes.truncate(place(*at)),
            Corruption::Flip(at, bits) => {
                let at = place(*at);
                if let Some(byte) = bytes.get_mut(at) {
                    *byte ^= bits;
                }
            }
            Corruption::Insert(at, more) => {
                let at = place(*at);
                bytes.splice(at..at, more.iter().copied());
            }
            Corruption::Remove(at, n) => {
                let at = place(*at);
                let end = (at + n).min(bytes.len());
                bytes.drain(at..end);
            }
            Corruption::Double(at, n) => {
                let at = place(*at);
                let end = (at + n).min(bytes.len());
                let again = bytes[at..end].to_vec();
                bytes.splice(at..at, again);
            }
            Corruption::Number(at, number) => {
                let all = numbers(&bytes);
                if !all.is_empty() {
                    bytes.splice(all[at % all.len()].clone(), number.bytes());
                }
            }
        }
    }
    bytes
}

/// Tests a reader with all files in the corpus of its `kind`, then with `cases` generated inputs:
/// random bytes, corrupted files of the corpus, and random text of the letters in `alphabet`.
fn hostile(kind: &'static str, alphabet: &str, cases: u32, read: &dyn Fn(&[u8])) {
    hostile_to(kind, alphabet, cases, Vec::new(), |bytes| bytes, read);
}

/// Tests a reader as [`hostile`] does, with the contents of further files, `more`, added to the
/// corpus. `mend` removes or restores the checksums in half of the corrupted files, so that they
/// reach the code behind the check.
fn hostile_to(
    kind: &'static str,
    alphabet: &str,
    cases: u32,
    more: Vec<Vec<u8>>,
    mend: fn(Vec<u8>) -> Vec<u8>,
    read: &dyn Fn(&[u8]),
) {
    let mut files = corpus(kind);
    files.extend(more.into_iter().map(|bytes| (format!("{kind}/more"), bytes)));
    for (name, bytes) in &files {
        give(name, bytes, read);
    }
    let letters: Vec<char> = alphabet.chars().collect();
    let words = proptest::collection::vec(proptest::sample::select(letters), 0..200)
        .prop_map(|letters| letters.into_iter().collect::<String>().into_bytes());
    let random = proptest::collection::vec(any::<u8>(), 0..400);
    let of_corpus =
        (0..files.len(), corruptions(), any::<bool>()).prop_map(move |(at, corruptions, mends)| {
            let bytes = corrupted(&files[at].1, &corruptions);
            if mends { mend(bytes) } else { bytes }
        });
    let inputs = prop_oneof![1 => words, 1 => random, 3 => of_corpus];
    search::search(kind, cases, &inputs, Clone::clone, |input| give_found(kind, &input, read));
}

/// Returns bytes as a text, with a replacement for each part that is not UTF-8.
fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn malformed_scenario_files_do_not_panic() {
    let letters = "[]{}=\"'.,#\n abcetxy0123456789-_+einf";
    hostile("scenario", letters, 300, &|bytes| {
        let text = text(bytes);
        if let Err(faults) = rubik_robot::tasks::read(Path::new("hostile.toml"), &text, &[]) {
            assert!(!faults.to_string().is_empty());
        }
        // An option of the command line may have the same text.
        if let Ok(over) = Override::parse(&text) {
            let _ = rubik_robot::tasks::read(Path::new("t.toml"), "", &[over]);
        }
    });
}

#[test]
fn malformed_variation_files_do_not_panic() {
    let letters = "[]{}=\"., \nuniformwhleabc0123456789-_e";
    hostile("vary", letters, 1000, &|bytes| {
        if let Ok(vary) = Variations::read(Path::new("hostile.toml"), &text(bytes)) {
            for seed in [0, 1, u64::MAX] {
                let drawn = vary.draw(seed);
                assert_eq!(drawn, vary.draw(seed));
                assert!(drawn.iter().all(|d| !d.value.is_empty() && !d.value.contains("NaN")));
            }
        }
    });
}

#[test]
fn malformed_facelets_do_not_panic() {
    hostile("facelets", "URFDLBurfdlb x", 3000, &|bytes| {
        if let Ok(facelets) = text(bytes).parse::<Facelets>() {
            // Facelets that can be read are a cube, or a refusal names the reason.
            if let Err(why) = Cube::try_from(facelets) {
                assert!(!why.to_string().is_empty() && why.places().len() <= 54);
            }
        }
    });
}

#[test]
fn malformed_scrambles_do_not_panic() {
    hostile("scramble", "URFDLBMESxyzw23'\u{2019} ", 2000, &|bytes| {
        let text = text(bytes);
        let _ = parse_turns(&text);
        if let Ok(moves) = parse_moves(&text) {
            let _ = after_moves(&Facelets::solved(), &moves);
        }
    });
}

/// Sets all checksums of a recording to 0, which means none. Otherwise the reader would stop at the
/// first checksum after a corruption.
fn without_checksums(mut bytes: Vec<u8>) -> Vec<u8> {
    let mut at = 8_usize;
    while let Some(head) = bytes.get(at..at.saturating_add(9)) {
        let kind = head[0];
        let length = u64::from_le_bytes(head[1..].try_into().unwrap());
        let begin = at + 9;
        let Some(end) = usize::try_from(length).ok().and_then(|n| begin.checked_add(n)) else {
            break;
        };
        // Checksums of a chunk, of the end of the data, of the footer, and at the end of an
        // attachment.
        let sum = match kind {
            0x06 => begin + 24,
            0x0F => begin,
            0x02 => begin + 16,
            0x09 => end.saturating_sub(4),
            _ => bytes.len(),
        };
        if let Some(sum) = bytes.get_mut(sum..sum.saturating_add(4)) {
            sum.fill(0);
        }
        at = end;
    }
    bytes
}

/// Returns an uncompressed recording of the first 400 messages, metadata and attachments of another
/// recording.
fn plain(recording: &[u8]) -> Vec<u8> {
    let options = mcap::WriteOptions::new().compression(None).chunk_size(Some(4000));
    let mut writer = options.create(std::io::Cursor::new(Vec::new())).unwrap();
    let mut channels = std::collections::BTreeMap::new();
    for piece in Reading::new(recording).take(400) {
        match piece {
            Piece::Message(message) => {
                let c = &message.channel;
                let id = *channels.entry(c.topic.clone()).or_insert_with(|| {
                    let own = &c.schema;
                    let schema =
                        writer.add_schema(&own.kind, &own.encoding, &own.definition).unwrap();
                    writer.add_channel(schema, &c.topic, &c.message_encoding, &c.metadata).unwrap()
                });
                let head = mcap::records::MessageHeader {
                    channel_id: id,
                    sequence: 0,
                    log_time: message.time,
                    publish_time: message.time,
                };
                writer.write_to_known_channel(&head, &message.data).unwrap();
            }
            Piece::Metadata(name, metadata) => {
                writer.write_metadata(&mcap::records::Metadata { name, metadata }).unwrap();
            }
            Piece::Attachment(name, media_type, data) => {
                let data = std::borrow::Cow::Owned(data);
                let (log_time, create_time) = (0, 0);
                let attachment = mcap::Attachment { log_time, create_time, name, media_type, data };
                writer.attach(&attachment).unwrap();
            }
        }
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

#[test]
fn malformed_recordings_do_not_panic() {
    let idle =
        [env!("CARGO_MANIFEST_DIR"), "tests/corpus/mcap/idle.mcap"].iter().collect::<PathBuf>();
    let whole = std::fs::read(idle).unwrap();
    let plain = plain(&whole);
    let (pieces, all) =
        (Reading::new(plain.as_slice()).count(), Reading::new(whole.as_slice()).count());
    assert!(pieces == all.min(400) && pieces > 3, "{pieces} of {all}");
    assert_eq!(
        Reading::new(without_checksums(plain.clone()).as_slice()).count(),
        Reading::new(plain.as_slice()).count(),
        "a repaired file is read whole"
    );
    let alphabet = "\u{89}MCAP0\r\n\u{1}\u{2}\u{6}";
    hostile_to("mcap", alphabet, 400, vec![plain], without_checksums, &|bytes| {
        let mut reading = Reading::new(bytes);
        // Each piece takes at least a byte, so the reader ends.
        assert!(reading.by_ref().take(bytes.len() + 10).count() < bytes.len() + 10);
        assert!(reading.end().is_some());
        if let Ok(story) = report::gather(std::io::Cursor::new(bytes)) {
            assert!(!report::page(&story).contains("<script"));
        }
        let _ = recover_file::recover_file(
            std::io::Cursor::new(bytes),
            std::io::Cursor::new(Vec::new()),
        );
    });
}

/// Each head leads to the same map, which has many pairs and is no map at its end.
#[test]
fn heads_of_long_map_do_not_hang_reader() {
    const HEAD: usize = 9 + 4;
    const HEADS: usize = 400_000;
    let map = [vec![0; 8 * 60_000], vec![0xff; 8]].concat();
    let begin = mcap::MAGIC.len() + HEADS * HEAD;
    let mut file = mcap::MAGIC.to_vec();
    for index in 0..HEADS {
        // A metadata record whose name reaches up to the map.
        let name = (HEADS - 1 - index) * HEAD;
        file.push(0x0c);
        file.extend(((4 + name + 4 + map.len()) as u64).to_le_bytes());
        file.extend((name as u32).to_le_bytes());
    }
    assert_eq!(file.len(), begin);
    file.extend((map.len() as u32).to_le_bytes());
    file.extend(&map);
    // No record begins behind the map.
    file.extend([0xff; 32]);

    give("mcap/maps", &file, &|bytes| assert_eq!(Reading::new(bytes).count(), 0));
}

#[test]
fn recording_reader_stores_schema_shared_by_channels_once() {
    let text = |bytes: &[u8]| [&(bytes.len() as u32).to_le_bytes(), bytes].concat();
    let record = |opcode: u8, parts: &[&[u8]]| {
        let body = parts.concat();
        [&[opcode][..], &(body.len() as u64).to_le_bytes(), &body].concat()
    };
    let definition = vec![b' '; 4 << 20];
    let mut file = mcap::MAGIC.to_vec();
    file.extend(record(0x03, &[&[1, 0], &text(b"Type"), &text(b"ros2msg"), &text(&definition)]));
    for id in 0..200_u16 {
        let texts = [text(b"/topic"), text(b"cdr"), text(b"")].concat();
        file.extend(record(0x04, &[&id.to_le_bytes(), &[1, 0], &texts]));
        file.extend(record(0x05, &[&id.to_le_bytes(), &[0; 20]]));
    }
    give("mcap/channels", &file, &|bytes| {
        assert_eq!(Reading::new(bytes).count(), 200);
        let saved = recover_file::recover_file(
            std::io::Cursor::new(bytes),
            std::io::Cursor::new(Vec::new()),
        )
        .unwrap();
        assert_eq!(saved.messages, 200);
    });
}

#[test]
fn malformed_campaign_states_do_not_panic() {
    hostile("state", "{}[]\":,\n seedvrictphaonu0123456789.", 1500, &|bytes| {
        if let Ok(state) = State::read(bytes) {
            assert!(state.whole as usize <= bytes.len());
            assert!(state.results.keys().all(|seed| state.header.holds(*seed)));
            // The part without faults gives the same results by itself.
            let again = State::read(&bytes[..state.whole as usize]).unwrap();
            assert_eq!(again.results.len(), state.results.len());
            // The command `merge` makes these reports of it.
            let (mut whole, shards) = (state.clone(), [state.header.shard]);
            let missing = whole.missing_shards(&shards);
            for tally in [Tally::of(&state), Tally::of(&whole)] {
                assert!(tally.is_complete() || tally.runs() < tally.asked);
                assert!(tally.json().is_object() && !tally.table().is_empty());
                assert!(!page::page(&tally, Some(0.9)).contains("<script"));
            }
            assert!(missing.to_string().len() < 2000);
        }
    });
}

#[test]
fn malformed_journals_do_not_panic() {
    let path = std::env::temp_dir().join(format!("rubik-hostile-{}", std::process::id()));
    hostile("journal", "{}[]\":,\n doinghelOT0123456789.", 500, &|bytes| {
        std::fs::write(&path, bytes).unwrap();
        if let Ok(Some(entry)) = Journal::last::<Entry>(&path) {
            // The last entry can be written behind the remains of a crash, and is the last one
            // again. An entry that would become too long is refused and stays the last.
            match Journal::open::<Entry>(&path, true).unwrap().write(&entry) {
                Ok(()) => {}
                Err(why) => assert_eq!(why.kind(), std::io::ErrorKind::InvalidInput),
            }
            assert_eq!(Journal::last::<Entry>(&path).unwrap(), Some(entry));
        }
    });
    std::fs::remove_file(path).unwrap();
}

#[test]
fn malformed_serial_frames_do_not_panic() {
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
fn malformed_datagrams_do_not_panic() {
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
fn malformed_page_messages_do_not_panic() {
    let page = "{}[]\":,commandseatxirsuwgphy0123456789.-e";
    let (ui, run) = Desk::default().ends();
    let inputs = RefCell::new(run.take_inputs().unwrap());
    let panel = RefCell::new(panel());
    hostile("websocket", page, 3000, &|bytes| {
        // The socket passes a command of the page on to the desk.
        let text = text(bytes);
        let refused = web::obey(&text, &ui);
        assert!(refused.as_ref().is_none_or(|why| why.len() < 200));
        // The run receives the input that the text describes. Emptying the queue makes room for the
        // next text.
        let mut said = input_of(&text);
        while let Ok(input) = inputs.borrow_mut().try_recv() {
            assert_eq!(said.take().as_ref(), Some(&input), "{text}");
            ordered(&mut panel.borrow_mut(), &input);
        }
        // A text with two commands counts as no command.
        let lost = said.is_some() && refused.is_none() && text.matches("command").count() == 1;
        assert!(!lost, "the run has not received it: {text}");
    });
}

/// Returns the operator's input that the message of a page describes, read by other code than the
/// server's: `{"command": NAME, ...}` becomes `{NAME: {...}}`, as in a recording.
fn input_of(text: &str) -> Option<operator::Input> {
    let mut message: serde_json::Map<String, serde_json::Value> =
        serde_json::from_str(text).ok()?;
    let serde_json::Value::String(name) = message.remove("command")? else { return None };
    let with_arguments = serde_json::json!({ name.as_str(): message });
    serde_json::from_value(with_arguments).or_else(|_| serde_json::from_value(name.into())).ok()
}

/// Returns a kernel for orders by hand, which waits for an order to one of two arms. Only the first
/// arm has an axis 0.
fn panel() -> Panel {
    let limits = |has_track| ArmLimits {
        world_from_base: rubik_robot::spatial::Pose::identity(),
        has_track,
        poses: vec![("front".to_owned(), JointPositions([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6]))],
        opening: (0.04, 0.09),
        grip: 40.0,
    };
    let mut panel = panel::panel(vec![limits(true), limits(false)]);
    assert!(matches!(answered(&mut panel, Event::Start), Action::Phase(_)));
    assert_eq!(answered(&mut panel, Event::Done), Action::Await);
    panel
}

/// Gives the kernel for orders by hand an event and returns its next action.
fn answered(panel: &mut Panel, event: Event<()>) -> Action<()> {
    let arms = [ArmState::default(); 2];
    panel.next(
        event,
        &Readings { arms: &arms, forces: &Forces::default(), sensors: &SensorReadings::default() },
    )
}

/// Gives an order to the waiting kernel for orders by hand and checks its action: only an existing
/// arm moves, to an existing pose and at most by the limit of one order, and a refusal has a
/// reason. Afterwards the kernel waits again.
fn ordered(panel: &mut Panel, input: &operator::Input) {
    assert!(!input.describe().is_empty());
    let operator::Input::Manual { effector, order } = input else { return };
    let action = answered(panel, Event::Ordered(*effector, order.clone()));
    let notes = panel.notes();
    if action == Action::Await {
        assert_eq!(notes.len(), 1, "{notes:?}");
        return;
    }
    assert!(*effector < 2 && notes.is_empty(), "{notes:?}");
    assert_eq!(answered(panel, Event::Done), Action::Await);
    match action {
        Action::Behave { orders, until } => {
            assert_eq!(until, Until::Effector(*effector));
            assert!(orders[1 - *effector].is_none());
            match orders[*effector].as_ref().unwrap() {
                Behaviour::Joints { target, .. } => {
                    assert!(target.0.iter().all(|joint| joint.abs() <= 0.6), "{target:?}");
                }
                Behaviour::Line { target, .. } => {
                    let (way, angle) = (target.translation.vector.norm(), target.rotation.angle());
                    assert!(way <= 0.2 + 1e-9 && angle <= 0.6 + 1e-9, "{target:?}");
                }
                Behaviour::Jaw { jaw, .. } => assert!((0.04..=0.09).contains(&jaw.opening)),
                other => panic!("{other:?}"),
            }
        }
        Action::Bias(of) => assert_eq!(of, [*effector == 0, *effector == 1]),
        Action::Manual { order: Manual::Motor(step), .. } => {
            assert!(step.axis < 7 && step.by.abs() <= 60.0, "{step:?}");
        }
        Action::Manual { order: Manual::Synchronise, .. } => {}
        other => panic!("{other:?}"),
    }
}

#[test]
fn malformed_manual_orders_do_not_panic() {
    let number = || prop_oneof![-1.0..1.0, -100.0..100.0, proptest::num::f64::ANY];
    let index = || prop_oneof![4 => 0..8usize, 1 => any::<usize>()];
    let step = move || (index(), number()).prop_map(|(axis, by)| Step { axis, by });
    let name = proptest::sample::select(&["front", "", "moon", "front\0"][..]);
    let order = prop_oneof![
        Just(Manual::Synchronise),
        step().prop_map(Manual::Motor),
        step().prop_map(Manual::Joint),
        step().prop_map(Manual::Tool),
        step().prop_map(Manual::Base),
        step().prop_map(Manual::World),
        prop_oneof![0.0..0.2, number()].prop_map(|opening| Manual::Jaw { opening }),
        name.prop_map(|name| Manual::Pose { name: name.to_owned() }),
        Just(Manual::Bias),
    ];
    let effector = prop_oneof![4 => 0..3usize, 1 => any::<usize>()];
    let choice = index().prop_map(|option| Answer::Choice { option });
    let answer = (any::<u64>(), prop_oneof![choice, Just(Answer::Declined)]);
    let inputs = prop_oneof![
        6 => (effector, order)
            .prop_map(|(effector, order)| operator::Input::Manual { effector, order }),
        1 => number().prop_map(|factor| operator::Input::Speed { factor }),
        1 => number().prop_map(|time| operator::Input::Seek { time }),
        1 => answer.prop_map(|(question, answer)| operator::Input::Answer { question, answer }),
    ];
    let (ui, run) = Desk::default().ends();
    let taken = RefCell::new(run.take_inputs().unwrap());
    let panel = RefCell::new(panel());
    // JSON has no NaN: the corpus keeps an input with NaN as one with `null`.
    search::search("websocket", 3000, &inputs, page_message, |input| {
        give_found("websocket", &page_message(&input), &|bytes| {
            ordered(&mut panel.borrow_mut(), &input);
            let refused = web::obey(&text(bytes), &ui);
            let heard = taken.borrow_mut().try_recv().ok();
            assert!(refused.is_some() || heard.is_some_and(|heard| heard == input));
        });
    });
}

/// Returns the message `{"command": NAME, ...}` by which a page sends an input with arguments.
fn page_message(input: &operator::Input) -> Vec<u8> {
    let serde_json::Value::Object(named) = serde_json::to_value(input).unwrap() else {
        panic!("{input:?} has no arguments")
    };
    let (name, mut message) = named.into_iter().next().unwrap();
    message["command"] = if name == "order" { "manual".into() } else { name.into() };
    serde_json::to_vec(&message).unwrap()
}

/// Temporary folder of one test, removed at its end.
struct Folder(PathBuf);

impl Folder {
    /// Makes a folder for this process, whose name ends with `name`.
    fn new(name: &str) -> Self {
        let name = format!("rubik-hostile-{}-{name}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&folder).unwrap();
        Self(folder)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

#[test]
fn malformed_plant_states_do_not_panic() {
    let folder = [env!("CARGO_MANIFEST_DIR"), "scenarios/solve.toml"].iter().collect::<PathBuf>();
    let cell = rubik_robot::tasks::load(&folder, &[]).unwrap().controller.cell;
    let plant = Plant::new(PlantConfig::new(cell.clone()), 1).unwrap();
    let own = serde_json::to_value(plant.saved()).unwrap();
    // The corpus has states of other plants. A new identity makes each a state of this plant.
    let identity = own["identity"].clone();
    let read = |bytes: &[u8]| {
        let owned = serde_json::from_slice::<serde_json::Value>(bytes).ok().map(|mut state| {
            if let Some(known) = state.get_mut("identity") {
                *known = identity.clone();
            }
            state.to_string().into_bytes()
        });
        let Ok(saved) = Saved::parse(owned.as_deref().unwrap_or(bytes)) else { return };
        let Ok(mut plant) = plant.clone().restored(saved) else { return };
        let drives = [ArmDrive { enabled: true, pwm: [40; 7], ..ArmDrive::OFF }; 2];
        let mut readings = [ArmReading::default(); 2];
        for period in 0..30 {
            if plant.exchange(period, &drives, &mut readings).is_err() {
                break;
            }
            let _ = (plant.scene(), plant.verdict());
        }
        // The state after these periods can be saved; reading it may succeed or be refused.
        let _ = Saved::parse(&serde_json::to_vec(&plant.saved()).unwrap());
    };
    let own = own.to_string().into_bytes();
    assert!(plant.clone().restored(Saved::parse(&own).unwrap()).is_ok());
    let more = vec![own];
    hostile_to("world", "{}[]\":,joints0123456789.-e", 1500, more, |bytes| bytes, &read);
}

#[test]
fn malformed_device_files_do_not_panic() {
    let folder = Folder::new("devices");
    let path = folder.0.join("devices.toml");
    hostile("devices", "[]{}=\"., \neffectornamsdvi0123456789-_", 1000, &|bytes| {
        std::fs::write(&path, bytes).unwrap();
        match Devices::load(&path) {
            Ok(devices) => {
                // A file that can be read is unchanged after it is written and read again.
                let text = devices.text().unwrap();
                std::fs::write(&path, &text).unwrap();
                assert_eq!(Devices::load(&path).unwrap().text().unwrap(), text);
                for name in ["track", "postument"] {
                    if let Ok(effector) = devices.of_effector(name) {
                        let _ = (effector.paths(true).count(), effector.force_device().is_ok());
                    }
                }
            }
            Err(why) => assert!(!why.to_string().is_empty()),
        }
    });
}

#[test]
fn malformed_servo_profiles_do_not_panic() {
    let folder = Folder::new("servo");
    let text = "task = \"idle\"\n[[effector]]\nname = \"track\"\nservo_profile = \"own.toml\"\n";
    hostile("servo", "[]{}=\"., \naxisgnjwmtrp_0123456789-einf", 500, &|bytes| {
        std::fs::write(folder.0.join("own.toml"), bytes).unwrap();
        if let Err(faults) = rubik_robot::tasks::read(&folder.0.join("t.toml"), text, &[]) {
            assert!(!faults.to_string().is_empty());
        }
    });
}

#[test]
fn malformed_measured_colours_do_not_panic() {
    hostile("colours", "{}[]\":, 0123456789.-e", 1000, &|bytes| {
        if let Ok(squares) = measured_squares(&text(bytes))
            && let Ok(decision) = decide_cube(&squares)
        {
            assert!(decision.facelets.iter().all(|&facelet| facelet < 6));
            assert!(decision.margins.iter().all(|margin| margin.is_finite()));
        }
    });
}

#[test]
fn malformed_picture_manifests_do_not_panic() {
    let folder = Folder::new("manifest");
    let grey = image::RgbImage::from_pixel(24, 24, image::Rgb([90, 90, 90]));
    grey.save(folder.0.join("grey.png")).unwrap();
    let path = folder.0.join("manifest.jsonl");
    hostile("manifest", "{}[]\":, imagefctors.pn0123456789-e", 300, &|bytes| {
        std::fs::write(&path, bytes).unwrap();
        match (evaluate(&path, true, true, None), evaluate(&path, false, true, None)) {
            (Ok(json), Ok(_)) => {
                serde_json::from_str::<serde_json::Value>(&json).unwrap();
            }
            (Err(why), Err(_)) => assert!(!why.to_string().is_empty()),
            (one, other) => panic!("{one:?}, {other:?}"),
        }
    });
}
