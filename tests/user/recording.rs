//! Recordings of short runs: read, truncated, recovered, verified, changed, replayed, reported, and
//! written to a full disk.

use crate::program::program;
use rubik_robot::motion::ArmFault;
use rubik_robot::record::reading::{End, Label, Message, Piece, Reading, open};
use rubik_robot::record::recover_file::recover_file;
use rubik_robot::record::tick::Tick;
use rubik_robot::servo::io::Outside;
use std::collections::BTreeMap;
use std::io::{BufRead as _, BufReader, Cursor, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

/// Runs the program to its end and returns its exit code and output.
fn perform(arguments: &[&str]) -> Output {
    program().args(arguments).output().unwrap()
}

/// Returns the path of a temporary file with this name.
pub(crate) fn place(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("recording");
    std::fs::create_dir_all(&folder).unwrap();
    folder.join(name)
}

/// Runs a scenario and returns its summary and the text on stderr.
fn run(scenario: &str, more: &[&str]) -> (serde_json::Value, String) {
    let mut arguments = vec!["run", scenario, "--json"];
    arguments.extend(more);
    let output = perform(&arguments);
    let stderr = String::from_utf8(output.stderr).unwrap();
    let stdout = String::from_utf8(output.stdout).unwrap();
    let summary = serde_json::from_str(stdout.lines().last().unwrap()).unwrap();
    (summary, stderr)
}

/// Options that shorten the idle task to a second.
pub(crate) const IDLE: [&str; 2] = ["--set", "idle.time_s=1"];

/// Records a run of a scenario without loss. Returns the path of the recording and the run's
/// summary.
pub(crate) fn recorded(name: &str, scenario: &str, more: &[&str]) -> (PathBuf, serde_json::Value) {
    let path = place(name);
    let mut all = vec!["--record", path.to_str().unwrap()];
    all.extend(more);
    let (summary, stderr) = run(scenario, &all);
    assert!(stderr.contains("nothing lost"), "{stderr}");
    (path, summary)
}

/// Returns the messages among the pieces of a recording.
pub(crate) fn messages(pieces: impl Iterator<Item = Piece>) -> Vec<Message> {
    pieces
        .filter_map(|piece| match piece {
            Piece::Message(message) => Some(message),
            Piece::Metadata(..) | Piece::Attachment(..) => None,
        })
        .collect()
}

/// Verifies a recording by a replay. Returns the exit code, the verdict (null if there is none) and
/// the text on stderr.
fn verify(path: &Path, more: &[&str]) -> (Option<i32>, serde_json::Value, String) {
    let mut arguments = vec!["replay", path.to_str().unwrap(), "--verify", "--json"];
    arguments.extend(more);
    let output = perform(&arguments);
    let json = serde_json::from_slice(&output.stdout).unwrap_or_default();
    (output.status.code(), json, String::from_utf8(output.stderr).unwrap())
}

/// Copies a recording and changes one message of it: the first for which `change` returns `true`.
/// Returns whether there was one.
fn tampered(from: &Path, to: &Path, mut change: impl FnMut(&mut Message) -> bool) -> bool {
    let mut done = false;
    rewritten(from, to, |message| {
        done = done || change(message);
        true
    });
    done
}

/// Copies a recording with only the messages that `keeps` accepts; `keeps` may change them.
fn rewritten(from: &Path, to: &Path, mut keeps: impl FnMut(&mut Message) -> bool) {
    let mut writer = mcap::Writer::new(std::fs::File::create(to).unwrap()).unwrap();
    for piece in open(from).unwrap() {
        match piece {
            Piece::Metadata(name, metadata) => {
                writer.write_metadata(&mcap::records::Metadata { name, metadata }).unwrap();
            }
            Piece::Attachment(name, media_type, data) => {
                let data = data.into();
                let attachment =
                    mcap::Attachment { log_time: 0, create_time: 0, name, media_type, data };
                writer.attach(&attachment).unwrap();
            }
            Piece::Message(mut message) => {
                if !keeps(&mut message) {
                    continue;
                }
                let c = &message.channel;
                let own = &c.schema;
                let schema = writer.add_schema(&own.kind, &own.encoding, &own.definition).unwrap();
                let id = writer.add_channel(schema, &c.topic, "cdr", &c.metadata).unwrap();
                let (log_time, publish_time) = (message.time, message.time);
                let header = mcap::records::MessageHeader {
                    channel_id: id,
                    sequence: 0,
                    log_time,
                    publish_time,
                };
                writer.write_to_known_channel(&header, &message.data).unwrap();
            }
        }
    }
    writer.finish().unwrap();
}

/// A pipe can be read only once, and a file may change after it was read.
#[test]
fn recording_has_the_scenario_that_was_run() {
    let path = place("pipe.mcap");
    let text = "task = \"idle\"  # from a pipe\n[idle]\ntime_s = 0.1\n";
    let mut run = program()
        .args(["run", "/dev/stdin", "--ui", "none", "--record"])
        .arg(&path)
        .stdin(Stdio::piped())
        .spawn()
        .unwrap();
    run.stdin.take().unwrap().write_all(text.as_bytes()).unwrap();
    assert!(run.wait().unwrap().success());

    let mut label = Label::default();
    for piece in open(&path).unwrap() {
        label.take(&piece);
    }
    assert_eq!(label.scenario, text);
}

#[test]
fn recording_holds_every_period_without_changing_the_run() {
    let (path, with) = recorded("idle.mcap", "scenarios/idle.toml", &IDLE);
    let (without, _) = run("scenarios/idle.toml", &IDLE);

    assert_eq!(with["hash"], without["hash"], "a recording changes nothing");
    let mut counts = BTreeMap::new();
    let mut label = Label::default();
    let mut ticks: BTreeMap<u8, Vec<u64>> = BTreeMap::new();
    let mut reading = open(&path).unwrap();
    for piece in reading.by_ref() {
        label.take(&piece);
        let Piece::Message(message) = piece else { continue };
        *counts.entry(message.channel.topic.clone()).or_insert(0) += 1;
        if message.channel.topic.ends_with("/servo") {
            let tick = Tick::read(&message.data).unwrap();
            assert_eq!(message.time, tick.period * 2_000_000);
            ticks.entry(tick.arm).or_default().push(tick.period);
        }
    }
    assert_eq!(reading.end(), Some(&End::Whole));
    assert_eq!(ticks.len(), label.fact("arms").split(' ').count());
    for periods in ticks.values() {
        let wanted = with["sim_time_s"].as_f64().unwrap() / 0.002;
        assert!((periods.len() as f64 - wanted).abs() <= 3.0, "{} of {wanted}", periods.len());
        assert!(periods.iter().zip(1..).all(|(a, b)| *a == b), "no period is missing");
    }
    let periods = ticks[&0].len();
    assert_eq!(counts["/joint_states"], ticks.len() * (periods / 8));
    assert_eq!(counts["/robot_description"], 1);
    assert!(counts["/tf"] >= (ticks.len() + 1) * (periods / 20 - 1), "arms and cube: {counts:?}");
    assert_eq!(label.fact("seed"), "1");
    assert!(label.scenario.contains("task = \"idle\""));
    assert_eq!(label.options().len(), 1);
    let summary: serde_json::Value = serde_json::from_str(label.of("summary", "json")).unwrap();
    assert_eq!(summary["hash"], with["hash"]);
    assert_eq!(label.of("calibration", "cameras"), "", "nothing was calibrated");
    let all: usize = counts.values().sum();
    assert_eq!(label.of("recording", "messages"), all.to_string());
    assert_eq!(label.of("recording", "lost"), "0");
}

/// Device that takes 5 ms for each write.
struct Slow(std::fs::File);

impl std::io::Write for Slow {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        std::thread::sleep(std::time::Duration::from_millis(5));
        self.0.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.0.flush()
    }
}

impl std::io::Seek for Slow {
    fn seek(&mut self, to: std::io::SeekFrom) -> std::io::Result<u64> {
        self.0.seek(to)
    }
}

/// A recorder that does not wait for its slow device loses messages.
#[test]
fn recording_and_report_state_number_of_lost_messages() {
    use rubik_robot::operator::Class;
    use rubik_robot::record::recorder::{Entry, Patience, Recorder};
    use rubik_robot::record::sheet::RunInfo;

    let scenario = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/idle.toml");
    let scenario = rubik_robot::tasks::load(&scenario, &[]).unwrap();
    let about = RunInfo {
        cell: scenario.controller.cell.clone(),
        scenario: "task = \"idle\"".to_owned(),
        options: Vec::new(),
        facts: [("version".to_owned(), "0".to_owned())].into(),
        objects: Vec::new(),
        start: 0,
        length: rubik_robot::servo::period::Length::default(),
    };
    let path = place("slow.mcap");
    let device = Slow(std::fs::File::create(&path).unwrap());
    let recorder = Recorder::begin(device, about, Patience::Never).unwrap();
    for period in 0..100_000 {
        recorder.record(period, || Entry::Log(Class::Info, "test".into(), "a word".into()));
    }
    let written = recorder.finish().unwrap();

    assert!(written.lost > 0 && written.failure.is_none(), "{written:?}");
    let mut label = Label::default();
    for piece in open(&path).unwrap() {
        label.take(&piece);
    }
    assert_eq!(label.of("recording", "lost"), written.lost.to_string());
    assert_eq!(label.of("recording", "messages"), written.messages.to_string());
    let html = reported(&path);
    let warning = format!("did not keep up: {} messages", written.lost);
    assert!(html.contains(&warning), "{warning}");
}

/// The verification ends before the periods 100 to 110, which the recording lacks, and reports
/// them; the exit code stays 0.
#[test]
fn verify_ends_at_missing_periods_and_reports_them() {
    let (path, _) = recorded(
        "gap_of.mcap",
        "scenarios/idle.toml",
        &[&IDLE[..], &["--pace", "real-time"]].concat(),
    );
    let (code, verdict, stderr) = verify(&path, &[]);
    assert_eq!(
        (code, &verdict["ended"]),
        (Some(0), &serde_json::Value::Null),
        "{verdict} {stderr}"
    );

    let gap = place("gap.mcap");
    let lost = 100..=110;
    rewritten(&path, &gap, |message| {
        !message.channel.topic.ends_with("/servo")
            || !lost.contains(&Tick::read(&message.data).unwrap().period)
    });
    let (code, verdict, stderr) = verify(&gap, &[]);
    assert_eq!((code, &verdict["same"]), (Some(0), &true.into()), "{verdict} {stderr}");
    let ended = verdict["ended"].as_str().unwrap();
    assert!(
        ended.contains("periods 100 to 110") && ended.contains("not in the recording"),
        "{ended}"
    );
    let arms = open(&path).unwrap().fold(Label::default(), |mut label, piece| {
        label.take(&piece);
        label
    });
    let arms = arms.fact("arms").split(' ').count() as u64;
    assert_eq!(verdict["compared"], 99 * arms);
    assert!(verdict["not_compared"].as_u64().unwrap() > 100 * arms, "{verdict}");
    assert!(reported(&gap).contains("11 of "), "the report names the gap as well");

    // A truncated file of a wall-clock run is no difference either.
    let cut = place("gap_cut.mcap");
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    let (code, verdict, stderr) = verify(&cut, &[]);
    assert_eq!(code, Some(0), "{verdict} {stderr}");
    assert!(verdict["cut"].is_string(), "{verdict}");
}

#[test]
fn verify_of_recording_without_periods_exits_with_2() {
    for (name, pace) in [("none.mcap", "virtual"), ("none_wall.mcap", "real-time")] {
        let (path, _) =
            recorded(name, "scenarios/idle.toml", &[&IDLE[..], &["--pace", pace]].concat());
        let none = place(&format!("cut_{name}"));
        // Cut the file after the scenario and before the first servo period.
        let bytes = std::fs::read(&path).unwrap();
        let cut = (1..bytes.len() / 1024).map(|k| &bytes[..1024 * k]).find(|bytes| {
            let pieces = messages(Reading::new(*bytes));
            pieces.iter().any(|message| message.channel.topic == "/tf_static")
        });
        std::fs::write(&none, cut.unwrap()).unwrap();

        let (code, verdict, stderr) = verify(&none, &[]);

        assert_eq!(code, Some(2), "{verdict} {stderr}");
        assert!(stderr.contains("nothing was compared: the recording is cut off"), "{stderr}");
    }
}

/// Records a second of the idle task under the wall clock, and during that time calls `disturb`
/// with the process. Returns the path of the recording.
fn disturbed(name: &str, disturb: impl FnOnce(&mut Child)) -> PathBuf {
    let path = place(name);
    let mut run = program()
        .args(["run", "scenarios/idle.toml", "--pace", "real-time", "--ui", "none", "--record"])
        .arg(&path)
        .args(IDLE)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stderr = BufReader::new(run.stderr.take().unwrap());
    let mut line = String::new();
    while !line.ends_with("idle\n") {
        line.clear();
        assert!(stderr.read_line(&mut line).unwrap() > 0, "the run ended before it was disturbed");
    }
    std::thread::sleep(Duration::from_millis(200));
    disturb(&mut run);
    run.wait().unwrap();
    path
}

/// Returns, for each servo period in a recording, the inputs that came to the servo from outside
/// (missed periods, stops) and the text of its fault.
fn from_outside(path: &Path) -> (Vec<Outside>, Vec<String>) {
    let ticks = messages(open(path).unwrap()).into_iter();
    let ticks = ticks.filter(|message| message.channel.topic.ends_with("/servo"));
    ticks.map(|m| Tick::read(&m.data).unwrap()).map(|t| (t.outside().unwrap(), t.fault)).unzip()
}

/// Missed periods and emergency stops are recorded with their period, so the verification repeats
/// them.
#[test]
fn verify_repeats_missed_periods_and_emergency_stops() {
    let signal = |run: &Child, which: &str| {
        let id = run.id().to_string();
        assert!(Command::new("kill").args([which, &id]).status().unwrap().success());
    };
    let whole = |path: &Path| {
        let (code, verdict, stderr) = verify(path, &[]);
        assert_eq!(code, Some(0), "{verdict} {stderr}");
        assert_eq!(verdict["ended"], serde_json::Value::Null, "{verdict}");
        assert_eq!(verdict["not_compared"], 0, "{verdict}");
    };

    // Stop the process for 40 ms, which the arms tolerate, then for 250 ms, which stops them.
    for (name, pause, stops) in [("missed.mcap", 40, false), ("stopped.mcap", 250, true)] {
        let path = disturbed(name, |run| {
            signal(run, "-STOP");
            std::thread::sleep(Duration::from_millis(pause));
            signal(run, "-CONT");
        });
        let (outside, faults) = from_outside(&path);
        let missed = outside.iter().map(|o| o.skipped).max().unwrap();
        assert!(missed >= pause / 2 - 2, "{missed}");
        if stops {
            assert!(
                outside.iter().any(|o| o.brake.is_some())
                    && outside.iter().any(|o| o.trip.is_some())
            );
            assert!(faults.last().unwrap().contains("missed"), "{faults:?}");
        }
        whole(&path);
    }

    // The emergency stop, which reaches the servo past all actors.
    let path =
        disturbed("pressed.mcap", |run| run.stdin.as_mut().unwrap().write_all(b"e\n").unwrap());
    let (outside, faults) = from_outside(&path);
    assert!(outside.iter().any(|o| o.trip == Some(ArmFault::EmergencyStop)), "{faults:?}");
    whole(&path);
    let inputs = messages(open(&path).unwrap());
    let inputs: Vec<_> = inputs.iter().filter(|m| m.channel.topic == "/operator").collect();
    assert_eq!(inputs.len(), 1, "recorded once");
    assert!(inputs[0].data.windows(14).any(|text| text == b"emergency_stop"));
}

/// The verification reports a difference if the replayed servo does not find a recorded fault of
/// its arm again. It does not take the fault for a stop from outside.
#[test]
fn verify_reports_recorded_fault_that_replay_lacks() {
    let set = ["--pace", "real-time"];
    let (path, _) = recorded("fault_of.mcap", "scenarios/idle.toml", &[&IDLE[..], &set].concat());
    let marked = |fault: &'static [u8], to: &Path| {
        let found = tampered(&path, to, |message| {
            let is = message.channel.topic.ends_with("/servo");
            if !is || Tick::read(&message.data).unwrap().period != 200 {
                return false;
            }
            // An empty text is its length, 1, and a zero byte. A text of 8 n bytes keeps the
            // following fields aligned.
            assert_eq!(fault.len() % 8, 0);
            let mut text = (fault.len() as u32 + 1).to_le_bytes().to_vec();
            text.extend_from_slice(fault);
            text.push(0);
            let places = message.data.windows(5).enumerate();
            let empty: Vec<_> =
                places.filter(|(_, w)| *w == [1, 0, 0, 0, 0]).map(|(at, _)| at).collect();
            let changed = empty.into_iter().rev().find_map(|at| {
                let mut data = message.data.clone();
                data.splice(at..at + 5, text.iter().copied());
                let tick = Tick::read(&data).ok()?;
                (tick.fault.as_bytes() == fault).then_some(data)
            });
            message.data = changed.unwrap();
            true
        });
        assert!(found);
        verify(to, &[])
    };

    for fault in [&b"emergency stop  "[..], b"axis 1: over-current, 9.0 A     "] {
        let (code, verdict, stderr) = marked(fault, &place("fault_inner.mcap"));
        assert_eq!(code, Some(1), "{verdict} {stderr}");
        assert_eq!(verdict["first_difference"]["period"], 200, "{verdict}");
        assert_eq!(verdict["first_difference"]["field"], "fault", "{verdict}");
    }
}

#[test]
fn truncated_file_is_read_and_recovered() {
    let (path, _) = recorded("cut.mcap", "scenarios/idle.toml", &IDLE);
    let bytes = std::fs::read(&path).unwrap();
    let whole = messages(Reading::new(&bytes[..]));
    assert!(whole.len() > 500, "{}", whole.len());

    // A crash may truncate the file anywhere: try about 37 lengths, an odd step apart.
    let mut most = 0;
    for cut in (0..bytes.len()).step_by((bytes.len() / 37).max(1) | 1) {
        let mut reading = Reading::new(&bytes[..cut]);
        let read = messages(reading.by_ref());
        assert!(matches!(reading.end(), Some(End::Cut(_))), "{cut}");
        assert_eq!(read, whole[..read.len()], "{cut}: the remaining messages are right");
        assert!(read.len() >= most, "{cut}: more bytes, no fewer messages");
        most = read.len();

        let mut recovered = Cursor::new(Vec::new());
        let saved = recover_file(Cursor::new(&bytes[..cut]), &mut recovered).unwrap();
        assert_eq!(saved.messages as usize, read.len());
        let recovered = recovered.into_inner();
        let mut again = Reading::new(&recovered[..]);
        assert_eq!(messages(again.by_ref()).len(), read.len(), "{cut}");
        assert_eq!(again.end(), Some(&End::Whole));
        if read.is_empty() {
            continue;
        }
        let summary = mcap::Summary::read(&recovered).unwrap().unwrap();
        assert_eq!(summary.stats.unwrap().message_count as usize, read.len(), "it has an index");
    }
    // Only the last chunk is lost: the longest cut still has more than half of the messages.
    assert!(most > whole.len() / 2, "{most} of {}", whole.len());
}

/// Returns the ranges of bytes of all MCAP records with the opcode `wanted` in a file, each without
/// its opcode and length.
pub(crate) fn records(bytes: &[u8], wanted: u8) -> Vec<std::ops::Range<usize>> {
    let (mut at, mut found) = (8, Vec::new());
    while at + 9 < bytes.len() {
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
        if bytes[at] == wanted {
            found.push(at + 9..at + 9 + length);
        }
        at += 9 + length;
    }
    found
}

/// The reader reports the damage, and each message that it returns is one of the undamaged file.
#[test]
fn reader_detects_a_flipped_bit_anywhere() {
    let (path, _) = recorded("flipped.mcap", "scenarios/idle.toml", &IDLE);
    let bytes = std::fs::read(&path).unwrap();
    let whole = messages(Reading::new(&bytes[..]));
    // Up to the record DataEnd, which has the checksum of all bytes before it. An opcode and a
    // length of 9 bytes begin each record.
    let end = records(&bytes, 0x0f)[0].start - 9;

    for at in (0..end).step_by((end / 997) | 1) {
        let mut flipped = bytes.clone();
        flipped[at] ^= 1 << (at % 8);

        let mut reading = Reading::new(&flipped[..]);
        let read = messages(reading.by_ref());

        assert!(reading.end().unwrap().flaw().is_some(), "byte {at} of {end}");
        let mut rest = whole.iter();
        assert!(read.iter().all(|message| rest.any(|w| w == message)), "byte {at} of {end}");
    }
}

#[test]
fn every_command_reports_a_damaged_recording() {
    let time = ["--set", "idle.time_s=4"];
    let (path, _) = recorded("whole_before.mcap", "scenarios/idle.toml", &time);
    let mut bytes = std::fs::read(&path).unwrap();
    let whole = messages(Reading::new(&bytes[..]));
    // Damage the last chunk (opcode 6) with servo periods. Smaller chunks may follow it; their
    // number depends on the speed of the run.
    let chunks = records(&bytes, 0x06);
    let chunk = chunks.iter().rfind(|chunk| chunk.len() > 50_000).unwrap();
    bytes[chunk.start.midpoint(chunk.end)] ^= 1;
    let damaged = place("damaged.mcap");
    std::fs::write(&damaged, &bytes).unwrap();
    let name = damaged.to_str().unwrap();

    let (code, verdict, stderr) = verify(&damaged, &[]);
    assert_eq!((code, &verdict["same"]), (Some(0), &true.into()), "{verdict} {stderr}");
    assert!(verdict["cut"].as_str().unwrap().starts_with("damaged (at byte "), "{verdict}");
    assert!(verdict["compared"].as_u64().unwrap() > 100, "{verdict}");

    assert!(reported(&damaged).contains("The recording is damaged (at byte "));

    let shown = perform(&["replay", name, "--ui", "none"]);
    let stderr = String::from_utf8(shown.stderr).unwrap();
    assert!(stderr.contains("the recording is damaged: at byte "), "{stderr}");

    let to = place("recovered.mcap");
    let recovered = perform(&["recover", name, "-o", to.to_str().unwrap()]);
    let stderr = String::from_utf8(recovered.stderr).unwrap();
    assert!(stderr.contains("it was damaged: at byte "), "{stderr}");
    let read = messages(open(&to).unwrap());
    assert!(read.len() > 100 && read.len() < whole.len(), "{} of {}", read.len(), whole.len());
    // The messages of smaller chunks behind the damaged one are saved as well.
    let same = |a: &Message, b: &Message| (a.time, &a.data) == (b.time, &b.data);
    let mut rest = whole.iter();
    let mut saved = read.iter();
    assert!(saved.all(|m| rest.any(|w| same(m, w))), "the saved messages are unchanged");
}

/// Returns the numbers of recorded and of lost messages that the program has written to stderr.
fn counted(stderr: &str) -> (usize, usize) {
    let line = stderr.lines().find(|line| line.starts_with("recorded")).unwrap();
    let before = |word: &str| {
        let words: Vec<_> = line.split([' ', ',', ':']).filter(|w| !w.is_empty()).collect();
        let at = words.iter().position(|w| *w == word);
        at.map_or(0, |at| words[at - 1].parse().unwrap_or(0))
    };
    (before("messages"), before("lost"))
}

/// Records a run with the scenario of this fault. Returns the recording, the numbers of messages
/// that the program reports as written and as lost, and all that it reports.
fn recorded_with(fault: &str) -> (PathBuf, usize, usize, String) {
    let path = place(&format!("with_{fault}.mcap"));
    let scenario = format!("scenarios/faults/{fault}.toml");
    let (_, stderr) = run(&scenario, &["--record", path.to_str().unwrap()]);
    let (written, lost) = counted(&stderr);
    (path, written, lost, stderr)
}

/// The disk is full from the middle of the run on. A reader finds as many messages as the program
/// reports.
#[test]
fn reported_message_count_matches_recording_after_full_disk() {
    let (path, written, lost, stderr) = recorded_with("disk_full");
    assert!(lost > 0, "{stderr}");
    assert_eq!(messages(open(&path).unwrap()).len(), written, "{stderr}");

    // Compare with the run without the fault. A few messages are in neither number, because some
    // entries make two messages.
    let text = std::fs::read_to_string("scenarios/faults/disk_full.toml").unwrap();
    let (before, _) = text.split_once("[[fault]]").unwrap();
    let scenario = place("not_refused.toml");
    std::fs::write(&scenario, before).unwrap();
    let (whole, _) = recorded("not_refused.mcap", scenario.to_str().unwrap(), &[]);
    let all = messages(open(&whole).unwrap()).len();
    assert!(all.abs_diff(written + lost) < all / 50, "{written} and {lost} of {all}");
}

/// The device loses the writes of half a second. A reader finds all other messages and says that
/// the recording is damaged.
#[test]
fn lost_writes_cost_only_their_own_messages() {
    let (path, written, lost, stderr) = recorded_with("lost_write");
    assert_eq!(lost, 0, "the run cannot notice: {stderr}");

    let mended = place("lost_write_mended.mcap");
    let output = perform(&["recover", path.to_str().unwrap(), "-o", mended.to_str().unwrap()]);

    let said = String::from_utf8(output.stdout).unwrap() + &String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("it was damaged"), "{said}");
    let left = messages(open(&mended).unwrap()).len();
    assert!((written * 3 / 4..written).contains(&left), "{left} of {written}: {said}");
}

#[test]
fn failed_commands_keep_an_existing_recording() {
    let (path, _) = recorded("kept.mcap", "scenarios/idle.toml", &IDLE);
    let file = path.to_str().unwrap();
    let before = std::fs::read(&path).unwrap();
    let refused = |arguments: &[&str], code: i32, why: &str| {
        let output = perform(arguments);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {stderr}");
        assert!(stderr.contains(why), "{arguments:?}: {stderr}");
        assert!(std::fs::read(&path).unwrap() == before, "{arguments:?} changed it");
    };

    refused(&["report", file, "-o", file], 2, "is the recording and would be overwritten");
    // This run fails before its first period: its file of devices has none.
    let none = format!("bridge.devices={}", no_devices("kept_none.toml"));
    let mut never = vec!["run", "scenarios/hardware.toml", "--ui", "none", "--json"];
    never.extend(["--set", &none, "--record", file]);
    refused(&never, 4, "is as it was");
    let junk = place("junk.mcap");
    std::fs::write(&junk, "no recording").unwrap();
    refused(&["recover", junk.to_str().unwrap(), "-o", file], 1, "nothing is written");
    // A resumed run must not replace the recording of the run that was killed.
    let world = place("kept_world.json");
    let mut resume = vec!["run", "scenarios/solve.toml", "--json", "--resume", "--record", file];
    resume.extend(["--world", world.to_str().unwrap()]);
    refused(&resume, 2, "name another file");

    // The recording of a run that begins replaces an older one.
    let (_, other) = recorded("kept.mcap", "scenarios/idle.toml", &["--set", "idle.time_s=2"]);
    assert_eq!(other["outcome"], "solved");
    assert!(std::fs::read(&path).unwrap().len() > before.len());
    let folder = std::fs::read_dir(path.parent().unwrap()).unwrap();
    let aside = folder.filter(|f| f.as_ref().unwrap().file_name() == "kept.mcap.part").count();
    assert_eq!(aside, 0);
}

#[test]
fn unwritable_output_path_exits_with_2() {
    let (path, _) = recorded("nowhere.mcap", "scenarios/idle.toml", &IDLE);
    for command in ["report", "recover"] {
        let output = perform(&[command, path.to_str().unwrap(), "-o", "/nowhere/x"]);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{stderr}");
        assert!(stderr.contains("/nowhere/x: "), "{stderr}");
    }
}

/// The table has a row for each arm and time, with the force that the summary calls the largest.
#[test]
fn export_prints_ticks_and_events() {
    let (path, summary) = recorded("export.mcap", "scenarios/face_turn.toml", &[]);
    let path = path.to_str().unwrap();
    let table = |more: &[&str]| -> Vec<Vec<String>> {
        let out = perform(&[&["export", path], more].concat());
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        let text = String::from_utf8(out.stdout).unwrap();
        text.lines().map(|line| line.split(',').map(str::to_owned).collect()).collect()
    };

    let ticks = table(&[]);
    let column = |name: &str| ticks[0].iter().position(|head| head == name).unwrap();
    let [arm, x] = ["arm", "force_x_n"].map(column);
    let force = |row: &Vec<String>| {
        let of = |i: usize| row[x + i].parse::<f64>().unwrap();
        (of(0).powi(2) + of(1).powi(2) + of(2).powi(2)).sqrt()
    };
    let largest =
        ticks[1..].iter().filter(|row| row[arm] == "track").map(force).fold(0.0, f64::max);
    let felt = summary["sensors"][0]["felt_force_n"].as_f64().unwrap();
    assert!((largest - felt).abs() < 0.01, "{largest} N of {felt} N");
    let part = table(&["--every", "100", "--from", "1", "--to", "2"]);
    // Two arms, eleven times each.
    assert_eq!(part.len(), 1 + 2 * 11, "{part:?}");

    let events = table(&["--table", "events"]);
    assert!(events.iter().any(|row| row[1..] == ["phase", "end"]), "{events:?}");
    let refused = perform(&["export", path, "--from", "2", "--to", "1"]);
    assert_eq!(refused.status.code(), Some(2));
}

#[test]
fn verify_refuses_a_resumed_run() {
    // There is no state to resume from, so the mission begins at its start, but its recording is
    // marked as that of a resumed run.
    let (world, path) = (place("resumed_world.json"), place("went_on.mcap"));
    for file in [&world, &path] {
        let _ = std::fs::remove_file(file);
    }
    let mut run = program()
        .args(["run", "scenarios/solve.toml", "--ui", "none", "--json", "--resume", "--world"])
        .arg(&world)
        .args(["--speed", "5", "--record"])
        .arg(&path)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    while !path.exists() {
        assert!(run.try_wait().unwrap().is_none());
        std::thread::sleep(Duration::from_millis(20));
    }
    assert!(Command::new("kill").args(["-INT", &run.id().to_string()]).status().unwrap().success());
    run.wait().unwrap();

    let (code, _, stderr) = verify(&path, &[]);
    assert_eq!(code, Some(2), "{stderr}");
    assert!(stderr.contains("a resumed run cannot be verified"), "{stderr}");
}

/// An injected fault of an actor or of the clock is no input of the controller, so the verification
/// ends there.
#[test]
fn verify_ends_at_actor_and_clock_faults() {
    for (fault, word) in [
        ("late_message", "late message, track"),
        ("panic_ecp", "actor panic, track"),
        ("clock_jump", "clock jump"),
    ] {
        let scenario = format!("scenarios/faults/{fault}.toml");
        let (path, _) = recorded(&format!("{fault}.mcap"), &scenario, &[]);
        let (code, verdict, stderr) = verify(&path, &[]);
        assert_eq!(code, Some(0), "{fault}: {verdict} {stderr}");
        assert!(verdict["first_difference"].is_null(), "{fault}: {verdict}");
        assert!(verdict["compared"].as_u64().unwrap() > 1000, "{fault}: {verdict}");
        assert!(verdict["ended"].as_str().unwrap().contains(word), "{fault}: {verdict}");

        // A difference before the fault is still reported.
        if fault == "late_message" {
            let other = place("late_message_other.mcap");
            let found = tampered(&path, &other, |message| {
                if message.channel.topic != "/track/servo" || message.time != 500 * 2_000_000 {
                    return false;
                }
                let counts = Tick::read(&message.data).unwrap().counts_bytes();
                let place = message.data.windows(8).position(|w| w == counts).unwrap();
                message.data[place] ^= 8;
                true
            });
            assert!(found);
            assert_eq!(verify(&other, &[]).0, Some(1));
        }
    }
}

/// The camera looks at the cube all the time, so the cuts come between looks and their answers.
#[test]
fn recording_cut_before_answer_to_look_verifies() {
    let (path, _) = recorded("looks.mcap", "scenarios/acquire.toml", &[]);
    let bytes = std::fs::read(&path).unwrap();
    let cut = place("looks_cut.mcap");
    for percent in [20, 40, 60] {
        std::fs::write(&cut, &bytes[..bytes.len() * percent / 100]).unwrap();

        let (code, verdict, stderr) = verify(&cut, &[]);

        assert_eq!(code, Some(0), "{percent} %: {verdict} {stderr}");
        assert!(verdict["cut"].is_string() && verdict["same"] == true, "{verdict}");
    }
}

#[test]
fn run_continues_when_the_disk_is_full() {
    let (without, _) = run("scenarios/idle.toml", &IDLE);

    let mut more = vec!["--record", "/dev/full"];
    more.extend(IDLE);
    let (summary, stderr) = run("scenarios/idle.toml", &more);

    assert_eq!(summary["outcome"], "solved");
    assert_eq!(summary["hash"], without["hash"]);
    assert!(stderr.contains("No space left") && stderr.contains("the run continues"), "{stderr}");
    let line = stderr.lines().find(|l| l.starts_with("recorded")).unwrap();
    assert!(line.contains(" lost: "), "{line}");
}

#[test]
fn verify_locates_changed_drive_value_or_sensor_reading() {
    let (path, summary) = recorded("turn.mcap", "scenarios/face_turn.toml", &[]);
    assert_eq!(summary["outcome"], "solved");

    let (code, verdict, stderr) = verify(&path, &[]);
    assert_eq!(code, Some(0), "{verdict} {stderr}");
    assert_eq!(verdict["same"], true);
    assert_eq!(verdict["not_compared"], 0);
    let ticks = (summary["sim_time_s"].as_f64().unwrap() * 1000.0) as u64;
    assert!(verdict["compared"].as_u64().unwrap() >= ticks - 2, "{verdict}");

    // A truncated recording verifies up to its end.
    let cut = place("turn_cut.mcap");
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&cut, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let (code, verdict, stderr) = verify(&cut, &[]);
    assert_eq!(code, Some(0), "{verdict} {stderr}");
    assert!((ticks / 3..ticks).contains(&verdict["compared"].as_u64().unwrap()), "{verdict}");
    assert!(verdict["cut"].is_string() && verdict["ended"].is_null(), "{verdict}");

    // A drive that differs from the controller's is reported in its own period.
    let other = place("turn_drive.mcap");
    let found = tampered(&path, &other, |message| {
        let (at, topic) = (message.time, message.channel.topic.as_str());
        if topic != "/postument/servo" || at != 1_000 * 2_000_000 {
            return false;
        }
        let tick = Tick::read(&message.data).unwrap();
        let (from, to) = (tick.drive.pwm[2].to_le_bytes(), (tick.drive.pwm[2] + 1).to_le_bytes());
        let pwm: Vec<u8> = tick.drive.pwm.iter().flat_map(|p| p.to_le_bytes()).collect();
        let place = message.data.windows(14).position(|w| w == pwm).unwrap() + 4;
        assert_eq!(message.data[place..place + 2], from);
        message.data[place..place + 2].copy_from_slice(&to);
        true
    });
    assert!(found);
    let (code, verdict, _) = verify(&other, &[]);
    assert_eq!(code, Some(1));
    let first = &verdict["first_difference"];
    assert_eq!(
        (&first["period"], &first["who"], &first["field"]),
        (&1000.into(), &"postument".into(), &"pwm[2]".into())
    );

    // A changed reading leads to another drive within the next periods.
    let other = place("turn_reading.mcap");
    let found = tampered(&path, &other, |message| {
        let (at, topic) = (message.time, message.channel.topic.as_str());
        if topic != "/track/servo" || at != 1_500 * 2_000_000 {
            return false;
        }
        let counts = Tick::read(&message.data).unwrap().counts_bytes();
        let place = message.data.windows(8).position(|w| w == counts).unwrap();
        message.data[place] ^= 8;
        true
    });
    assert!(found);
    let (code, verdict, _) = verify(&other, &[]);
    assert_eq!(code, Some(1));
    let first = &verdict["first_difference"];
    assert!((1500..1510).contains(&first["period"].as_u64().unwrap()), "{first}");
    assert_eq!(first["who"], "track");
}

/// Bytes of the counter of the first rotary axis, as in a message.
trait CountsBytes {
    fn counts_bytes(&self) -> [u8; 8];
}

impl CountsBytes for Tick {
    fn counts_bytes(&self) -> [u8; 8] {
        self.reading.counts[1].to_le_bytes()
    }
}

/// With the option `--force` the recording is verified nevertheless.
#[test]
fn verify_refuses_a_recording_of_another_version() {
    let (path, _) = recorded("version.mcap", "scenarios/idle.toml", &IDLE);
    let other = place("version_other.mcap");
    let mut bytes = Vec::new();
    // The facts are before the first chunk and not compressed.
    let (from, to) = (env!("CARGO_PKG_VERSION").as_bytes(), b"9.9.9");
    assert_eq!(from.len(), to.len());
    bytes.extend(std::fs::read(&path).unwrap());
    let key = b"version";
    let at = bytes.windows(key.len()).position(|w| w == key).unwrap() + key.len() + 4;
    bytes[at..at + to.len()].copy_from_slice(to);
    std::fs::write(&other, bytes).unwrap();

    let (code, _, stderr) = verify(&other, &[]);
    assert_eq!(code, Some(2));
    assert!(stderr.contains("of version 9.9.9"), "{stderr}");
    let (code, verdict, stderr) = verify(&other, &["--force"]);
    assert_eq!((code, &verdict["same"]), (Some(0), &true.into()), "{stderr}");
}

#[test]
fn replay_obeys_pause_and_seek() {
    use rubik_robot::desk::Desk;
    use rubik_robot::operator::{ControlView, Input, State};
    use rubik_robot::run::show::Show;
    use std::sync::Arc;
    use std::sync::atomic::AtomicBool;
    use std::time::{Duration, Instant};

    let (path, summary) = recorded("show.mcap", "scenarios/face_turn.toml", &[]);
    let scenario = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/face_turn.toml");
    let scenario = rubik_robot::tasks::load(&scenario, &[]).unwrap();
    let show = Show::read(std::fs::File::open(&path).unwrap(), &scenario, "show.mcap").unwrap();
    let (ui, run_end) = Desk::default().ends();
    let stop = Arc::new(AtomicBool::new(false));
    let thread = std::thread::spawn({
        let stop = Arc::clone(&stop);
        move || show.run(&run_end, 1.0, true, &stop)
    });
    let snapshot = || Arc::clone(&ui.snapshots.borrow());
    let until = |wanted: &dyn Fn() -> bool| {
        let begun = Instant::now();
        while !wanted() {
            assert!(begun.elapsed() < Duration::from_secs(20), "{:?}", snapshot());
            std::thread::sleep(Duration::from_millis(10));
        }
    };

    until(&|| snapshot().time > 0.1);
    assert!(ui.send(Input::Seek { time: 5.0 }));
    until(&|| snapshot().time > 4.9);
    assert_eq!(snapshot().phase, "turn");
    assert_eq!(ui.stage.borrow().pace, "replay");
    // The orders of the ECPs are not recorded. Their status says so, instead of idle, while the
    // arms move.
    let actor = |name: &str| snapshot().actors.iter().find(|a| a.name == name).cloned().unwrap();
    until(&|| actor("edp track").words.contains("moves"));
    for arm in ["track", "postument"] {
        assert_eq!(actor(&format!("ecp {arm}")).words, "not recorded");
    }
    let states = || ["ecp track", "edp track"].map(|name| actor(name).state);
    until(&|| states() == [State::Running; 2]);

    assert!(ui.send(Input::Pause));
    until(&|| snapshot().control == ControlView::Paused);
    let held = snapshot().time;
    std::thread::sleep(Duration::from_millis(200));
    assert_eq!(snapshot().time, held);
    let arm = snapshot().arms[0].joints;

    assert!(ui.send(Input::Seek { time: 1.0 }));
    until(&|| snapshot().time < 1.1);
    assert_eq!(snapshot().phase, "grasp", "later phases are not shown yet");
    assert!(arm != snapshot().arms[0].joints);

    assert!(ui.send(Input::Resume));
    assert!(ui.send(Input::Speed { factor: 0.0 }));
    until(&|| snapshot().control == ControlView::Ended);
    let outcome = snapshot().outcome.clone().unwrap();
    assert_eq!(
        (outcome.good, outcome.reason.as_str()),
        (true, summary["reason"].as_str().unwrap())
    );

    assert!(ui.send(Input::Quit));
    thread.join().unwrap();
}

#[test]
fn calibration_results_appear_in_recording_and_replay() {
    use rubik_robot::cell::Mount;
    use rubik_robot::desk::Desk;
    use rubik_robot::operator::Input;
    use rubik_robot::run::show::Show;
    use rubik_robot::spatial::Pose;
    use std::sync::atomic::AtomicBool;

    // The task gives up before the hand appears, so the run is short; the calibration is over by
    // then.
    let keys = [
        "camera.standalone.calibrate_views=12",
        "visual_servo.patience_s=1",
        "plant.hand.appears_s=60",
    ];
    let more: Vec<&str> = keys.iter().flat_map(|key| ["--set", key]).collect();
    let (path, _) = recorded("calibrated.mcap", "scenarios/acquire.toml", &more);
    let scenario = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/acquire.toml");
    let scenario = rubik_robot::tasks::load(&scenario, &[]).unwrap();
    let cell = &scenario.controller.cell;

    let mut label = Label::default();
    for piece in open(&path).unwrap() {
        label.take(&piece);
    }
    let cameras: serde_json::Value =
        serde_json::from_str(label.of("calibration", "cameras")).unwrap();
    let names: Vec<&str> =
        cameras.as_array().unwrap().iter().map(|c| c["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["standalone", "track_hand", "postument_hand"]);
    let place = |camera: usize| -> Pose {
        serde_json::from_value(cameras[camera]["place"].clone()).unwrap()
    };
    let Mount::World { world_from_camera } = cell.cameras[0].mount else { panic!() };
    let found = place(0);
    // The true camera is some millimetres away from its place in the scenario, and the arm sags.
    let miss = (found.translation.vector - world_from_camera.translation.vector).norm();
    assert!((1e-3..0.05).contains(&miss), "{miss}");
    let Mount::Flange { flange_from_camera, .. } = cell.cameras[1].mount else { panic!() };
    assert_eq!(place(1), flange_from_camera, "the other camera was not calibrated");
    let edge: f64 = label.of("calibration", "edge_m").parse().unwrap();
    assert!(edge != cell.cube.edge && (edge - cell.cube.edge).abs() < 2e-3, "{edge}");

    let show = Show::read(std::fs::File::open(&path).unwrap(), &scenario, "").unwrap();
    let (ui, run_end) = Desk::default().ends();
    assert!(ui.send(Input::Speed { factor: 0.0 }));
    show.run(&run_end, 0.0, false, &AtomicBool::new(false));
    let stage = ui.stage.borrow();
    assert_eq!((stage.cameras[0].pose, stage.edge), (found, edge));
}

#[test]
fn replay_of_truncated_recording_ends_with_reason() {
    use rubik_robot::desk::Desk;
    use rubik_robot::operator::{ControlView, Input};
    use rubik_robot::run::show::Show;
    use std::sync::atomic::AtomicBool;

    let (path, _) = recorded("show_cut.mcap", "scenarios/idle.toml", &IDLE);
    let scenario = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/idle.toml");
    let scenario = rubik_robot::tasks::load(&scenario, &[]).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let show = Show::read(Cursor::new(&bytes[..bytes.len() / 2]), &scenario, "cut.mcap").unwrap();
    let (ui, run_end) = Desk::default().ends();
    assert!(ui.send(Input::Speed { factor: 0.0 }));

    show.run(&run_end, 0.0, false, &AtomicBool::new(false));

    let last = ui.snapshots.borrow();
    assert_eq!(last.control, ControlView::Ended);
    let outcome = last.outcome.as_ref().unwrap();
    assert_eq!((outcome.verdict.as_str(), outcome.good), ("cut off", false));
    assert!(outcome.reason.contains("the recording is cut off after 0."), "{}", outcome.reason);
}

#[test]
fn replay_shows_right_time_for_1_ms_period() {
    use rubik_robot::desk::Desk;
    use rubik_robot::run::show::Show;
    use rubik_robot::scenario::Override;
    use std::sync::atomic::AtomicBool;

    let period = "real_time.period_ms=1";
    let more = [&IDLE[..], &["--set", period]].concat();
    let (path, _) = recorded("millisecond.mcap", "scenarios/idle.toml", &more);
    let scenario = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/idle.toml");
    let scenario = rubik_robot::tasks::load(&scenario, &[Override::parse(period).unwrap()]);
    let show = Show::read(std::fs::File::open(&path).unwrap(), &scenario.unwrap(), "").unwrap();
    let (ui, run_end) = Desk::default().ends();

    show.run(&run_end, 0.0, false, &AtomicBool::new(false));

    let time = ui.snapshots.borrow().time;
    assert!((0.9..1.1).contains(&time), "{time}");
}

/// Writes the report of a recording and returns its text.
fn reported(recording: &Path) -> String {
    let to = recording.with_extension("html");
    let output = perform(&["report", recording.to_str().unwrap(), "-o", to.to_str().unwrap()]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    std::fs::read_to_string(to).unwrap()
}

#[test]
fn report_of_real_time_run_has_timing_histograms() {
    let (path, _) = recorded(
        "real_time.mcap",
        "scenarios/idle.toml",
        &["--set", "idle.time_s=1", "--pace", "real-time"],
    );

    let html = reported(&path);

    for words in
        ["from the set time to the beginning of a period: median", "work of a period: median"]
    {
        assert!(html.contains(words), "no `{words}`");
    }
    assert!(html.matches("<rect class=bar").count() > 6, "bars");
    let mut label = Label::default();
    for piece in open(&path).unwrap() {
        label.take(&piece);
    }
    let counted: u64 = label
        .of("timing", "wake_up_ns")
        .split_whitespace()
        .map(|class| class.split_once(':').unwrap().1.parse::<u64>().unwrap())
        .sum();
    assert!((400..600).contains(&counted), "{counted} periods in a second of 2 ms each");
    assert!(html.contains(&format!("{counted} periods")), "the histogram counts every one of them");
}

#[test]
fn report_shows_injected_fault_and_controllers_reaction() {
    let (path, summary) = recorded("jam.mcap", "scenarios/faults/jam.toml", &[]);
    assert_eq!(summary["outcome"], "failed");

    let html = reported(&path);

    let (_, timeline) = html.split_once("What happened when").unwrap();
    let (timeline, _) = timeline.split_once("</section>").unwrap();
    assert!(timeline.contains("plant: injected fault: jam"), "{timeline}");
    assert!(timeline.contains(">warnings<") && timeline.contains("eased back"), "{timeline}");
}

/// Writes a file of devices without any, which no run on hardware can use.
fn no_devices(name: &str) -> String {
    let path = place(name);
    std::fs::write(&path, "").unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn recording_of_failed_start_holds_the_reason() {
    let path = place("never.mcap");
    let _ = std::fs::remove_file(&path);
    let output = perform(&[
        "run",
        "scenarios/hardware.toml",
        "--ui",
        "none",
        "--json",
        "--set",
        &format!("bridge.devices={}", no_devices("never_none.toml")),
        "--record",
        path.to_str().unwrap(),
    ]);
    assert_ne!(output.status.code(), Some(0));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();

    let mut label = Label::default();
    for piece in open(&path).unwrap() {
        label.take(&piece);
    }
    let kept: serde_json::Value = serde_json::from_str(label.of("summary", "json")).unwrap();
    assert_eq!(kept, summary);
    assert!(kept["reason"].as_str().unwrap().contains("bridge"), "{kept}");
    let shown = perform(&["replay", path.to_str().unwrap(), "--ui", "none"]);
    let shown = String::from_utf8(shown.stderr).unwrap();
    assert!(shown.contains("aborted: ") && shown.contains("bridge"), "{shown}");
}
