//! Runs on two nodes that are processes of their own, over zenoh and in real time: the emulated
//! cell, the node b, and MP's node.
//!
//! `cargo test --release --features net --test hosts -- --test-threads 1`, on a machine with time
//! to spare: `.ci/long hosts` does it.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop loudly")]

use rubik_robot::record::reading::{Message, Piece};
use serde_json::Value;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::mpsc;
use std::time::{Duration, Instant};

/// Longest time until each part of a run is ready.
const READY: Duration = Duration::from_secs(30);

/// Emulated cell and the keys of a run in it. Its folder is removed at the end of the test.
struct Cell {
    folder: PathBuf,
    emulator: Reaped,
    keys: Vec<String>,
}

/// Process whose stderr is read line by line.
struct Process {
    child: Reaped,
    lines: mpsc::Receiver<String>,
    told: String,
}

/// Process that does not outlive its test.
struct Reaped(Child);

impl Drop for Reaped {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Process {
    /// Starts the program with these arguments.
    fn start(args: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_rubik-robot"))
            .args(args)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let stderr = BufReader::new(child.stderr.take().unwrap());
        let (tell, lines) = mpsc::channel();
        std::thread::spawn(move || {
            for line in stderr.lines().map_while(Result::ok) {
                let _ = tell.send(line);
            }
        });
        Self { child: Reaped(child), lines, told: String::new() }
    }

    /// Waits until a line has these words.
    fn until(&mut self, words: &str) {
        let begun = Instant::now();
        while !self.told.contains(words) {
            let left = READY.saturating_sub(begun.elapsed());
            let line = self.lines.recv_timeout(left);
            assert!(line.is_ok(), "no \"{words}\" in:\n{}", self.told);
            self.told += &(line.unwrap() + "\n");
        }
    }

    /// Waits for the end. Returns the exit code and the object of the last line of stdout.
    fn end(mut self) -> (Option<i32>, Value, String) {
        let Output { stdout, status, .. } = {
            let mut stdout = Vec::new();
            self.child.0.stdout.take().unwrap().read_to_end(&mut stdout).unwrap();
            let status = self.child.0.wait().unwrap();
            Output { stdout, stderr: Vec::new(), status }
        };
        self.told.extend(self.lines.iter().map(|line| line + "\n"));
        let printed = String::from_utf8(stdout).unwrap();
        let object = printed.lines().last().and_then(|line| serde_json::from_str(line).ok());
        (status.code(), object.unwrap_or_default(), self.told)
    }

    /// Sends a signal, by the name that `kill` takes.
    fn signal(&self, name: &str) {
        let id = self.child.0.id().to_string();
        assert!(Command::new("kill").args(["-s", name, &id]).status().unwrap().success());
    }
}

impl Cell {
    /// Starts the emulator of `scenarios/two_hosts.toml` for a task. Node b listens at `port`.
    fn new(task: &str, port: u16) -> Self {
        let folder =
            std::env::temp_dir().join(format!("rubik-robot-hosts-{}-{port}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let keys = vec![
            format!("task={task}"),
            format!("bridge.devices={}", folder.join("devices.toml").display()),
            // These tests share the processor with others.
            "bridge.missed_answers=40".to_owned(),
            format!("node.b.endpoint=tcp/127.0.0.1:{port}"),
        ];
        let mut args = vec!["emulate", "scenarios/two_hosts.toml", "--json"];
        args.extend(keys.iter().flat_map(|key| ["--set", key.as_str()]));
        let mut emulator = Process::start(&args);
        emulator.until("rubik-robot run");
        let Process { child, lines, .. } = emulator;
        // Drained: a full pipe would block the emulator.
        std::thread::spawn(move || lines.iter().for_each(drop));
        Self { folder, emulator: child, keys }
    }

    /// Starts a command over the cell.
    fn command(&self, words: &[&str], more: &[&str]) -> Process {
        let keys = self.keys.iter().map(String::as_str).chain(more.iter().copied());
        let sets: Vec<_> = keys.flat_map(|key| ["--set", key]).collect();
        Process::start(&[words, &sets].concat())
    }

    /// Starts node b.
    fn node(&self, more: &[&str]) -> Process {
        let words = ["node", "b", "--scenario", "scenarios/two_hosts.toml", "--json"];
        let mut node = self.command(&words, more);
        node.until("waits for MP's node");
        node
    }

    /// Starts the run.
    fn run(&self, more: &[&str]) -> Process {
        self.command(&["run", "scenarios/two_hosts.toml", "--ui", "none", "--json"], more)
    }

    /// Waits for the end of the emulator and returns the plant's verdict.
    fn verdict(mut self) -> Value {
        let mut printed = String::new();
        self.emulator.0.stdout.take().unwrap().read_to_string(&mut printed).unwrap();
        serde_json::from_str(printed.lines().last().unwrap()).unwrap()
    }
}

impl Drop for Cell {
    fn drop(&mut self) {
        // The emulator ends before its folder is removed.
        let _ = self.emulator.0.kill();
        let _ = self.emulator.0.wait();
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// Starts a face turn in a new cell, whose node listens at `port`, and waits until both hands are
/// at work. Returns the cell, the node and the run.
fn under_way(port: u16) -> (Cell, Process, Process) {
    let cell = Cell::new("face_turn", port);
    let (node, run) = begun(&cell);
    (cell, node, run)
}

/// Starts a run with its node, and waits until both hands are at work.
fn begun(cell: &Cell) -> (Process, Process) {
    let node = cell.node(&[]);
    let mut run = cell.run(&[]);
    run.until("grasp");
    std::thread::sleep(Duration::from_secs(3));
    (node, run)
}

/// Waits for the end of a process, which must come in 6 s: the arms come to rest before the drives
/// go off, and MP waits for the end of a dead node. Returns what [`Process::end`] does.
fn end_soon(process: Process) -> (Option<i32>, Value, String) {
    let begun = Instant::now();
    let ended = process.end();
    assert!(begun.elapsed() < Duration::from_secs(6), "{:?}", begun.elapsed());
    ended
}

/// Checks by the plant that no arm has moved after the end of a run, and none has done harm.
fn assert_arms_rest(cell: Cell) {
    let verdict = cell.verdict();
    let counts = ["drops", "collisions", "moved_after_stop"].map(|key| &verdict[key]);
    assert_eq!(counts, [0; 3], "{verdict}");
}

/// Ends a node that waits for a run, by Ctrl-C.
fn assert_joined_no_run(node: Process) {
    node.signal("INT");
    let (code, end, told) = node.end();
    assert_eq!(code, Some(130), "it has joined a run: {end} {told}");
}

#[test]
fn face_turns_on_two_hosts() {
    let cell = Cell::new("face_turn", 17101);
    let mut node = cell.node(&[]);

    let (code, summary, told) = cell.run(&[]).end();
    node.until("MP's node ended the run");
    let (node_code, end, node_told) = node.end();

    assert_eq!(code, Some(0), "{told}");
    assert_eq!(summary["outcome"], "solved");
    assert_eq!(node_code, Some(0), "{node_told}");
    assert!(end["time_s"].as_f64().unwrap() > 5.0);
    // Each end has sent what the other one has received, but for the last messages.
    let link = &summary["links"][0];
    let bytes = |end: &Value, key: &str| end[key].as_f64().unwrap();
    for (sent, received) in [(link, &end), (&end, link)] {
        let (sent, received) = (bytes(sent, "sent_bytes"), bytes(received, "received_bytes"));
        assert!(sent > 1e5 && (received / sent - 1.0).abs() < 0.02, "{summary} {end}");
    }
    let verdict = cell.verdict();
    let turned = verdict["turned_deg"].as_f64().unwrap();
    assert!((turned - 90.0).abs() < 2.0, "{verdict}");
    assert_eq!((&verdict["slips"], &verdict["collisions"]), (&0.into(), &0.into()));
}

/// Performs a task with recordings of both nodes, and merges them. Returns the cell, and the paths
/// of the recordings of MP's node and of node b, and of the merged one.
fn recorded(task: &str, port: u16) -> (Cell, [String; 3]) {
    let cell = Cell::new(task, port);
    let paths = ["mp.mcap", "b.mcap", "run.mcap"]
        .map(|name| cell.folder.join(name).to_str().unwrap().to_owned());
    let [of_mp, of_b, merged] = &paths;
    let words = ["node", "b", "--scenario", "scenarios/two_hosts.toml", "--record", of_b];
    let mut node = cell.command(&words, &[]);
    node.until("waits for MP's node");

    let words = ["run", "scenarios/two_hosts.toml", "--ui", "none", "--record", of_mp];
    let (code, _, told) = cell.command(&words, &[]).end();
    assert_eq!(code, Some(0), "{told}");
    assert_eq!(node.end().0, Some(0));

    let (code, _, told) = Process::start(&["merge", of_b, of_mp, "-o", merged]).end();
    assert_eq!(code, Some(0), "{told}");
    (cell, paths)
}

/// The recordings of both nodes have the servos of their own arms, and the merged one has those of
/// both. Each is verified.
#[test]
fn recordings_of_both_hosts_are_verified() {
    let (cell, paths) = recorded("face_turn", 17102);

    let compared = paths.clone().map(|path| {
        let (code, result, told) = Process::start(&["replay", "--verify", "--json", &path]).end();
        assert_eq!(code, Some(0), "{path}: {told}");
        assert_eq!(result["not_compared"], 0, "{path}: {result}");
        result["compared"].as_u64().unwrap()
    });

    let [of_mp, of_b, merged] = compared;
    assert!(of_mp > 2000 && of_b > 2000, "{compared:?}");
    assert_eq!(merged, of_mp + of_b);
    let page = cell.folder.join("report.html");
    let report = ["report", &paths[2], "-o", page.to_str().unwrap()];
    assert_eq!(Process::start(&report).end().0, Some(0));
    let page = std::fs::read_to_string(page).unwrap();
    assert!(page.contains("track") && page.contains("postument"), "an arm is missing");
    // A second run's recording is of another run.
    let (_other, others) = recorded("face_turn", 17113);
    let mixed = ["merge", &paths[0], &others[1], "-o", &paths[2]];
    let before = std::fs::read(&paths[2]).unwrap();
    let (code, _, told) = Process::start(&mixed).end();
    assert_eq!(code, Some(2), "{told}");
    assert!(told.contains("b.mcap: its run is"), "{told}");
    assert_eq!(std::fs::read(&paths[2]).unwrap(), before);
}

/// Number of pictures of the cameras in a recording, and the greatest number of pictures of one
/// camera in a second.
fn pictures(path: &str) -> (usize, usize) {
    let mut times = std::collections::BTreeMap::<String, Vec<u64>>::new();
    for piece in rubik_robot::record::reading::open(Path::new(path)).unwrap() {
        let Piece::Message(Message { channel, time, .. }) = piece else { continue };
        if channel.topic.ends_with("/image") {
            times.entry(channel.topic.clone()).or_default().push(time);
        }
    }
    let within = |times: &[u64], from: u64| {
        times.iter().filter(|time| (from..from + 1_000_000_000).contains(*time)).count()
    };
    let most = times.values().flat_map(|all| all.iter().map(|from| within(all, *from))).max();
    (times.values().map(Vec::len).sum(), most.unwrap_or_default())
}

/// All cameras are on node b: MP's recording has at most five pictures a second of each, and one
/// more where the network delayed one.
#[test]
fn pictures_of_node_reach_mp() {
    let (_cell, paths) = recorded("acquire", 17114);

    let [of_mp, of_b, merged] = paths.each_ref().map(|path| pictures(path));

    assert!(of_mp.0 > 5, "{of_mp:?} of {of_b:?}");
    assert!(of_mp.1 <= 6, "{of_mp:?} of {of_b:?}");
    assert_eq!(merged.0, of_b.0);
    let (code, _, told) = Process::start(&["replay", "--verify", &paths[2]]).end();
    assert_eq!(code, Some(0), "{told}");
}

/// A killed node: its arm stops by its controllers' watchdogs, and that of MP's node holds.
#[test]
fn killed_node_ends_the_run() {
    let (cell, node, run) = under_way(17103);

    node.signal("KILL");
    let (code, summary, told) = end_soon(run);

    assert_eq!(code, Some(4), "{told}");
    assert_eq!(summary["fault"], "no-answer", "{summary}");
    assert!(summary["reason"].as_str().unwrap().contains("node b"), "{summary}");
    assert_arms_rest(cell);
}

/// A frozen node is as good as dead. When it goes on, its servo has tripped.
#[test]
fn frozen_node_ends_the_run() {
    let (_cell, node, run) = under_way(17104);

    node.signal("STOP");
    let (code, summary, told) = run.end();
    node.signal("CONT");

    assert_eq!(code, Some(4), "{told}");
    assert_eq!(summary["fault"], "no-answer", "{summary}");
    let (code, end, _) = node.end();
    assert!(matches!(code, Some(3 | 4)), "{code:?} {end}");
}

/// Without MP's node the servo of the other node brakes and trips, and its process ends.
#[test]
fn killed_mp_ends_the_node() {
    let (cell, node, run) = under_way(17105);

    run.signal("KILL");
    let (code, end, told) = end_soon(node);

    assert_eq!(code, Some(4), "{told}");
    assert_eq!(end["fault"], "link-failed", "{end}");
    assert_arms_rest(cell);
}

/// Ctrl-C at a node ends the run on all nodes.
#[test]
fn interrupted_node_ends_the_run() {
    let (_cell, node, run) = under_way(17106);

    node.signal("INT");
    let (code, summary, told) = run.end();

    assert_eq!(code, Some(4), "{told}");
    assert!(summary["reason"].as_str().unwrap().contains("it was interrupted"), "{summary}");
    assert_eq!(node.end().0, Some(4));
}

#[test]
fn node_with_other_scenario_is_refused() {
    let cell = Cell::new("face_turn", 17107);
    let node = cell.node(&["control.grip_n=30"]);

    let (code, _, told) = cell.run(&[]).end();

    assert_eq!(code, Some(4), "{told}");
    assert!(told.contains("has read another scenario"), "{told}");
    assert_joined_no_run(node);
}

/// A node that died before the run is taken back; one that returns during it stays out.
#[test]
fn returning_node_joins_only_the_next_run() {
    let cell = Cell::new("face_turn", 17108);
    cell.node(&[]).signal("KILL");
    let (node, run) = begun(&cell);

    node.signal("KILL");
    let back = cell.node(&[]);
    let (code, _, told) = run.end();

    assert_eq!(code, Some(4), "{told}");
    std::thread::sleep(Duration::from_secs(1));
    assert_joined_no_run(back);
}

#[test]
fn absent_node_is_named_with_its_command() {
    let cell = Cell::new("face_turn", 17109);

    let (code, _, told) = cell.run(&[]).end();

    assert_eq!(code, Some(4), "{told}");
    assert!(told.contains("no answer in 30 s"), "{told}");
    assert!(told.contains("rubik-robot node b --scenario scenarios/two_hosts.toml"), "{told}");
}

/// Passes bytes on, each `delay` later.
fn pass(mut from: TcpStream, mut to: TcpStream, delay: Duration) {
    let (later, due) = mpsc::channel::<(Instant, Vec<u8>)>();
    std::thread::spawn(move || {
        while let Ok((at, bytes)) = due.recv() {
            std::thread::sleep(at.saturating_duration_since(Instant::now()));
            if to.write_all(&bytes).is_err() {
                return;
            }
        }
    });
    std::thread::spawn(move || {
        let mut bytes = vec![0; 65536];
        while let Ok(count @ 1..) = from.read(&mut bytes) {
            if later.send((Instant::now() + delay, bytes[..count].to_vec())).is_err() {
                return;
            }
        }
    });
}

/// Between the nodes a proxy delays each byte by 30 ms.
#[test]
fn face_turns_over_a_slow_network() {
    let cell = Cell::new("face_turn", 17110);
    let proxy = TcpListener::bind("127.0.0.1:17111").unwrap();
    std::thread::spawn(move || {
        for near in proxy.incoming().flatten() {
            let far = TcpStream::connect("127.0.0.1:17110").unwrap();
            near.set_nodelay(true).and_then(|()| far.set_nodelay(true)).unwrap();
            let delay = Duration::from_millis(30);
            pass(near.try_clone().unwrap(), far.try_clone().unwrap(), delay);
            pass(far, near, delay);
        }
    });
    let bound = "link.delay_ms=35";
    let node = cell.node(&[bound]);

    let (code, summary, told) = cell.run(&[bound, "node.b.endpoint=tcp/127.0.0.1:17111"]).end();

    assert_eq!(code, Some(0), "{told}");
    assert_eq!(summary["outcome"], "solved");
    assert_eq!(node.end().0, Some(0));
    let verdict = cell.verdict();
    let turned = verdict["turned_deg"].as_f64().unwrap();
    assert!((turned - 90.0).abs() < 2.0, "{verdict}");
}

/// Starts the emulator of a face turn, and makes certificates in its folder. Returns the cell, the
/// key of the endpoint of node b over TLS, and node b.
fn secured(port: u16) -> (Cell, String, Process) {
    let cell = Cell::new("face_turn", port);
    let mut make = Command::new("packaging/network/certificates");
    let made = make.arg(&cell.folder).args(["b=localhost", "c=localhost"]).status().unwrap();
    assert!(made.success());
    let endpoint = format!("node.b.endpoint=tls/localhost:{port}");
    let node = cell.node(&[&settings(&cell, "b.json5"), &endpoint]);
    (cell, endpoint, node)
}

/// Returns the key that names a file of settings in the folder of the cell.
fn settings(cell: &Cell, name: &str) -> String {
    format!("link.settings={}", cell.folder.join(name).display())
}

#[test]
fn nodes_with_certificates_turn_a_face() {
    let (cell, endpoint, node) = secured(17115);

    let (code, summary, told) = cell.run(&[&settings(&cell, "mp.json5"), &endpoint]).end();

    assert_eq!(code, Some(0), "{told}");
    assert_eq!(summary["outcome"], "solved");
    assert_eq!(node.end().0, Some(0));
}

/// A peer without a certificate gets no answer, and neither does one with the certificate of
/// another node.
#[test]
fn tls_needs_a_certificate_on_both_sides() {
    let (cell, endpoint, node) = secured(17112);
    // A stranger that trusts the authority, but has no certificate of it, and a node that presents
    // its own certificate in the place of MP's.
    let own = std::fs::read_to_string(cell.folder.join("mp.json5")).unwrap();
    let stranger: Vec<_> =
        own.lines().filter(|line| !line.contains("connect_certificate")).collect();
    std::fs::write(cell.folder.join("stranger.json5"), stranger.join("\n")).unwrap();
    let other = own.replace("/mp.pem", "/c.pem").replace("/mp.key", "/c.key");
    std::fs::write(cell.folder.join("other.json5"), other).unwrap();

    for wrong in ["stranger.json5", "other.json5"] {
        let (code, _, told) = cell.run(&[&endpoint, &settings(&cell, wrong)]).end();
        assert_eq!(code, Some(4), "{wrong}: {told}");
        assert!(told.contains("no answer in 30 s"), "{wrong}: {told}");
    }
    assert_joined_no_run(node);
}
