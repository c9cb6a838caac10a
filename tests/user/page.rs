//! Runs that are operated through the page's WebSocket: commands have their effect and appear in
//! the record of the run, one page commands at a time, and foreign origins are refused.

use crate::program::program;
use futures_util::{SinkExt, StreamExt};
use rubik_robot::desk::{Desk, UiEnd};
use rubik_robot::motion::JointPositions;
use rubik_robot::operator::{
    After, ControlView, Input, OutcomeView, Services, ServoTiming, Snapshot,
};
use rubik_robot::reach::{MeetingTable, ReachSettings};
use rubik_robot::record::summary::{EndedBy, Outcome, Summary};
use rubik_robot::run::{self, RunOptions};
use rubik_robot::scenario::{Override, Scenario};
use rubik_robot::web::Server;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command as Process, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};

/// Longest wait for an event; a busy machine is slow.
const PATIENCE: Duration = Duration::from_secs(90);

/// Returns the shipped scenario of this file name, with the keys of `set` (`KEY=VALUE`) changed.
fn load(name: &str, set: &[&str]) -> Scenario {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios").join(name);
    let set: Vec<Override> = set.iter().map(|text| Override::parse(text).unwrap()).collect();
    rubik_robot::tasks::load(&path, &set).unwrap()
}

/// Starts a server for the page at a free port of this machine.
fn serve(ui: UiEnd) -> Server {
    Server::start(ui, "127.0.0.1:0".parse().unwrap()).unwrap()
}

/// Run with its server, on a thread of its own.
struct Run {
    server: Server,
    ui: UiEnd,
    thread: std::thread::JoinHandle<Summary>,
}

/// Starts a run with its server. The run reads no keys and prints nothing.
fn begin(scenario: Scenario, options: RunOptions) -> Run {
    let (ui, run_end) = Desk::default().ends();
    let server = serve(ui.clone());
    let options = RunOptions { automatic: true, quiet: true, ..options };
    let thread =
        std::thread::spawn(move || run::run_at(&scenario, options, Some(run_end)).unwrap());
    Run { server, ui, thread }
}

/// Connection of a page to its server.
struct Page(WebSocketStream<MaybeTlsStream<tokio::net::TcpStream>>);

impl Page {
    /// Opens the page of a server.
    async fn open(server: &Server) -> Self {
        Self::at(&server.url).await
    }

    /// Opens the page at the address that the program printed.
    async fn at(url: &str) -> Self {
        Self::named(url, None).await
    }

    /// Opens the page and gives it a name, by which the server recognises it after a lost
    /// connection.
    async fn named(url: &str, name: Option<&str>) -> Self {
        let (host, token) = host_and_token(url);
        let (socket, _) = connect_async(format!("ws://{host}/ws")).await.unwrap();
        let mut page = Self(socket);
        page.say(json!({ "token": token, "page": name })).await;
        page
    }

    /// Sends a message to the server.
    async fn say(&mut self, value: Value) {
        self.0.send(Message::text(value.to_string())).await.unwrap();
    }

    /// Waits for the next message of the server that has the key `kind`, and returns its value.
    async fn next(&mut self, kind: &str) -> Value {
        self.until(|message| message.get(kind).cloned()).await
    }

    /// Reads messages of the server until `wanted` returns a value for one, and returns that value.
    /// Fails after [`PATIENCE`].
    async fn until<T>(&mut self, mut wanted: impl FnMut(&Value) -> Option<T>) -> T {
        let (begun, mut alive) = (Instant::now(), Instant::now());
        loop {
            assert!(begun.elapsed() < PATIENCE, "it did not come");
            if alive.elapsed() > Duration::from_secs(3) {
                // The page does the same: a silent page loses the right to command.
                self.say(json!({ "alive": true })).await;
                alive = Instant::now();
            }
            let message = tokio::time::timeout(PATIENCE, self.0.next()).await.unwrap();
            let Message::Text(text) = message.unwrap().unwrap() else { continue };
            if let Some(found) = wanted(&serde_json::from_str(&text).unwrap()) {
                return found;
            }
        }
    }

    /// Reads the snapshots until the run's time is `time` (s). Returns the largest distance between
    /// a tool and its set position in them (m).
    async fn largest_error_until(&mut self, time: f64) -> f64 {
        let mut largest = 0.0_f64;
        let over = |m: &Value| {
            let snapshot = m.get("snapshot")?;
            for arm in snapshot["arms"].as_array().unwrap() {
                largest = largest.max(arm["following"].as_f64().unwrap());
            }
            (snapshot["time"].as_f64().unwrap() > time).then_some(())
        };
        self.until(over).await;
        largest
    }

    /// Waits for a snapshot that meets the condition `what`, and returns it.
    async fn sees(&mut self, what: impl Fn(&Value) -> bool) -> Value {
        self.until(|m| m.get("snapshot").filter(|s| what(s)).cloned()).await
    }
}

/// Returns the parts of the address that the program printed.
fn host_and_token(url: &str) -> (&str, &str) {
    url.strip_prefix("http://").unwrap().split_once("/#token=").unwrap()
}

/// Sends the head of a request, and returns the answer.
fn answer_to(address: impl std::net::ToSocketAddrs, head: &str) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    write!(stream, "{head}Connection: close\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

/// Returns a runtime for the page of a test, on the thread of the test.
fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap()
}

#[test]
fn page_starts_pauses_resumes_and_terminates_a_run() {
    let run = begin(load("solve.toml", &[]), RunOptions { wait: true, ..RunOptions::default() });
    runtime().block_on(async {
        let mut page = Page::open(&run.server).await;
        // An empty stage comes first, while the cell is set up.
        let named = |m: &Value| m.get("stage").filter(|s| s["task"] == "solve").cloned();
        let stage = page.until(named).await;
        assert_eq!(stage["arms"].as_array().unwrap().len(), 2);
        page.sees(|s| s["control"] == "waiting" && s["time"] == 0.0).await;

        page.say(json!({ "command": "speed", "factor": 2.0 })).await;
        page.say(json!({ "command": "start" })).await;
        let before = page.largest_error_until(3.0).await;
        page.sees(|s| s["phase"] == "acquire").await;
        page.say(json!({ "command": "pause" })).await;
        // The arms come to rest within 0.6 s and a macrostep. From then on nothing moves, and the
        // simulated time follows the wall clock.
        let paused = page.sees(|s| s["control"] == "paused").await;
        let begun = paused["time"].as_f64().unwrap();
        let rest = page.sees(|s| s["time"].as_f64().unwrap() > begun + 1.0).await;
        let later = page.sees(|s| s["time"].as_f64().unwrap() > begun + 1.6).await;
        for arm in 0..2 {
            for joint in 0..7 {
                let at = |s: &Value| s["arms"][arm]["joints"][joint].as_f64().unwrap();
                assert!((at(&rest) - at(&later)).abs() < 2e-4, "arm {arm} joint {joint} moves");
            }
        }
        page.say(json!({ "command": "resume" })).await;
        // The motion resumes without a jump: in the next second the tools follow their set values
        // as closely as before.
        let after = page.largest_error_until(later["time"].as_f64().unwrap() + 1.5).await;
        assert!(before > 0.0 && after < 1.5 * before, "{after} m after {before} m");
        page.sees(|s| s["control"] == "running").await;
        page.say(json!({ "command": "terminate" })).await;
        let end = page.sees(|s| s["control"] == "ended").await;
        assert_eq!(end["outcome"]["verdict"], "aborted");
        assert!(end["arms"][0]["fault"].is_null() && end["arms"][1]["fault"].is_null());
    });
    let summary = run.thread.join().unwrap();
    assert_eq!((summary.outcome, summary.ended_by), (Outcome::Aborted, EndedBy::Operator));
    assert!(summary.reason.ends_with("the operator has the cube"), "{}", summary.reason);
    let messages: Vec<String> =
        run.ui.snapshots.borrow().messages.iter().map(|m| m.text.clone()).collect();
    for command in ["speed 2 x", "start", "pause", "resume", "terminate"] {
        assert!(messages.contains(&format!("operator: {command}")), "{command}: {messages:?}");
    }
}

/// Returns the message about the right to command: whether this page has it, whether a page has it,
/// and which page asks for it.
fn seat(own: bool, taken: bool, request: Option<&str>) -> Value {
    json!({ "own": own, "taken": taken, "request": request })
}

/// The second page does not have the right to command, but may press the emergency stop.
#[test]
fn emergency_stop_from_any_page_faults_both_arms() {
    let run = begin(load("solve.toml", &[]), RunOptions { speed: 2.0, ..RunOptions::default() });
    runtime().block_on(async {
        let mut first = Page::open(&run.server).await;
        first.sees(|s| s["time"].as_f64().unwrap() > 1.0).await;
        let mut second = Page::open(&run.server).await;
        assert_eq!(second.next("seat").await, seat(false, true, None));

        second.say(json!({ "command": "emergency_stop" })).await;

        let end = first.sees(|s| s["control"] == "ended").await;
        let edps: Vec<&Value> = end["actors"]
            .as_array()
            .unwrap()
            .iter()
            .filter(|a| a["name"].as_str().unwrap().starts_with("edp"))
            .collect();
        assert_eq!(edps.len(), 2, "{edps:?}");
        assert!(edps.iter().all(|edp| edp["state"] == "fault"), "{edps:?}");
    });
    let summary = run.thread.join().unwrap();
    assert_eq!(summary.ended_by, EndedBy::Fatal);
    assert!(summary.reason.contains("emergency stop"), "{}", summary.reason);
}

/// Orders for a joint, a motor, the jaws, the tool and a named pose move the arm. Impossible orders
/// and orders during a pause are refused with a message.
#[test]
fn manual_orders_from_page_move_idle_arm() {
    let scenario = load("idle.toml", &[]);
    let start = scenario.controller.cell.arms[0].start;
    let run = begin(scenario, RunOptions::default());
    runtime().block_on(async {
        let mut page = Page::open(&run.server).await;
        let ready = page.sees(|s| s["services"]["manual"] == true).await;
        let at = |s: &Value, joint: usize| s["arms"][0]["joints"][joint].as_f64().unwrap();
        let set = |order: Value| json!({ "command": "manual", "effector": 0, "order": order });

        page.say(set(json!({ "order": "joint", "axis": 1, "by": 0.1 }))).await;
        page.sees(|s| (at(s, 1) - at(&ready, 1) - 0.1).abs() < 2e-3).await;
        page.say(set(json!({ "order": "motor", "axis": 4, "by": 5.0 }))).await;
        let motor = |s: &Value| s["arms"][0]["motors"][4].as_f64().unwrap();
        page.sees(|s| (motor(s) - motor(&ready) - 5.0).abs() < 0.1).await;
        let jaws = |s: &Value| s["arms"][0]["opening"].as_f64().unwrap();
        page.say(set(json!({ "order": "jaw", "opening": 0.08 }))).await;
        page.sees(|s| (jaws(s) - 0.08).abs() < 1e-3).await;
        let tool =
            |s: &Value, i: usize| s["arms"][0]["frames"][6]["translation"][i].as_f64().unwrap();
        let before = page.sees(|s| s["services"]["manual"] == true).await;
        page.say(set(json!({ "order": "tool", "axis": 2, "by": -0.02 }))).await;
        let distance =
            |s: &Value| (0..3).map(|i| (tool(s, i) - tool(&before, i)).powi(2)).sum::<f64>().sqrt();
        page.sees(|s| (distance(s) - 0.02).abs() < 1e-3).await;
        page.say(set(json!({ "order": "pose", "name": "start" }))).await;
        page.sees(|s| (1..7).all(|i| (at(s, i) - start.0[i]).abs() < 2e-3)).await;
        // A step of 9 rad is outside the range of the joint: it is refused with a message.
        page.say(set(json!({ "order": "joint", "axis": 1, "by": 9.0 }))).await;
        page.until(|m| m.get("messages").filter(|m| m.to_string().contains("not done")).cloned())
            .await;
        // This arm has no axis 0: the order is refused with a message, and the arm obeys the next
        // one.
        let before = at(&page.sees(|_| true).await, 1);
        page.say(set(json!({ "order": "motor", "axis": 0, "by": 2.0 }))).await;
        page.until(|m| m.get("messages").filter(|m| m.to_string().contains("no axis 0")).cloned())
            .await;
        page.say(set(json!({ "order": "joint", "axis": 1, "by": 0.05 }))).await;
        page.sees(|s| (at(s, 1) - before - 0.05).abs() < 2e-3).await;
        // An order during a pause is refused; it is not executed after the pause.
        page.say(json!({ "command": "pause" })).await;
        let held = page.sees(|s| s["control"] == "paused").await;
        page.say(set(json!({ "order": "joint", "axis": 1, "by": 0.1 }))).await;
        let refusal =
            |m: &Value| m.get("messages").filter(|m| m.to_string().contains("is paused")).cloned();
        page.until(refusal).await;
        page.say(json!({ "command": "resume" })).await;
        let resumed = page.sees(|s| s["control"] == "running").await["time"].as_f64().unwrap();
        let later = page.sees(|s| s["time"].as_f64().unwrap() > resumed + 1.0).await;
        assert!((at(&later, 1) - at(&held, 1)).abs() < 2e-3, "it did not move");
        page.say(json!({ "command": "terminate" })).await;
        let end = page.sees(|s| s["control"] == "ended").await;
        assert_eq!(end["outcome"]["good"], true, "only the operator ends this run");
    });
    let summary = run.thread.join().unwrap();
    assert_eq!((summary.outcome, summary.ended_by), (Outcome::Solved, EndedBy::Operator));
    assert_eq!(summary.exit_code(), 0);
}

/// Scenario of two arms that are moved by hand.
const BY_HAND: &str = "task = \"idle\"\ncamera = []\nvsp = []\n";

/// The message names the parts that would come too near to each other.
#[test]
fn collision_guard_refuses_motion_into_the_table() {
    let scenario = rubik_robot::tasks::read(Path::new("by_hand.toml"), BY_HAND, &[]).unwrap();
    let run = begin(scenario, RunOptions::default());
    runtime().block_on(async {
        let mut page = Page::open(&run.server).await;
        let at = |s: &Value| s["arms"][1]["joints"][2].as_f64().unwrap();
        let shoulder = |by: f64| {
            let order = json!({ "order": "joint", "axis": 2, "by": by });
            json!({ "command": "manual", "effector": 1, "order": order })
        };
        let first = page.sees(|s| s["services"]["manual"] == true).await;
        page.say(shoulder(0.02)).await;
        let moved = |s: &Value| (at(s) - at(&first) - 0.02).abs() < 5e-3;
        let before = page.sees(|s| moved(s) && s["services"]["manual"] == true).await;

        // The shoulder would bring the hand down to the table: the guard refuses the motion.
        page.say(shoulder(0.6)).await;
        let refused = |m: &Value| {
            let messages = m.get("messages").map(Value::to_string);
            messages.filter(|messages| messages.contains("check a path"))
        };
        let messages = page.until(refused).await;
        assert!(messages.contains("the hand of the postument arm comes within"), "{messages}");
        assert!(messages.contains("of the table"), "{messages}");
        let later = page.sees(|s| s["services"]["manual"] == true).await;
        assert!((at(&later) - at(&before)).abs() < 1e-2, "it did not move");

        page.say(json!({ "command": "terminate" })).await;
        page.sees(|s| s["control"] == "ended").await;
    });
    let summary = run.thread.join().unwrap();
    assert_eq!((summary.exit_code(), summary.collisions), (0, Some(0)), "{}", summary.reason);
}

/// The guard refuses the motion of a joint that would bring the hands too near. Motors are not
/// checked before they turn; there the lookout stops all arms before the hands touch.
#[test]
fn collision_guard_and_proximity_stop_keep_hands_apart() {
    let plain = rubik_robot::tasks::read(Path::new("by_hand.toml"), BY_HAND, &[]).unwrap();
    let cell = &plain.controller.cell;
    let table = MeetingTable::compute(cell, &ReachSettings::default());
    let meeting = table.grasps.iter().flatten().next().unwrap();
    // Start beside a meeting of the hands, on the side on which the track has room.
    let side = if meeting.track.0[0] > 0.4 { -1.0 } else { 1.0 };
    let effector = |name: &str, joints: &JointPositions, d0: f64| {
        let degrees: Vec<f64> = joints.0[1..].iter().map(|joint| joint.to_degrees()).collect();
        format!(
            "[[effector]]\nname = \"{name}\"\nstart_d0_mm = {:?}\nstart_joints_deg = {degrees:?}\n",
            1e3 * d0
        )
    };
    let text = [
        BY_HAND,
        "plant.errors = { base_mm = 0, base_deg = 0 }\n",
        &effector("track", &meeting.track, meeting.track.0[0] + 0.4 * side),
        &effector("postument", &meeting.postument, 0.0),
    ];
    let scenario = rubik_robot::tasks::read(Path::new("beside.toml"), &text.concat(), &[]).unwrap();
    let run = begin(scenario, RunOptions::default());
    runtime().block_on(async {
        let mut page = Page::open(&run.server).await;
        let at = |s: &Value| s["arms"][0]["joints"][0].as_f64().unwrap();
        let along = |order: &str, by: f64| {
            let order = json!({ "order": order, "axis": 0, "by": by });
            json!({ "command": "manual", "effector": 0, "order": order })
        };
        let free = |s: &Value| s["services"]["manual"] == true;
        let mut last = at(&page.sees(free).await);

        // The guard checks each motion of a joint before it starts. The steps are executed until
        // the next one would bring the hands too near.
        let messages = loop {
            page.say(along("joint", -0.1 * side)).await;
            let refused = page
                .until(|m| {
                    let messages = m.get("messages").map(Value::to_string);
                    let messages = messages.filter(|messages| messages.contains("check a path"));
                    let there =
                        m.get("snapshot").is_some_and(|s| (at(s) - last + 0.1 * side).abs() < 2e-3);
                    if there { Some(None) } else { messages.map(Some) }
                })
                .await;
            match refused {
                Some(messages) => break messages,
                None => last = at(&page.sees(free).await),
            }
        };
        // Outside planned meetings the hands count as obstacles, so they limit the motion before
        // the arms would.
        assert!(messages.contains("the hands come within"), "{messages}");
        let later = page.sees(free).await;
        assert!((at(&later) - last).abs() < 1e-2, "it did not move");

        // The guard does not check the motion of a single motor, because the operator watches it.
        // Too near the other hand the lookout stops all arms.
        let over = |s: &Value| s["control"] == "ended";
        let (mut stopped, mut by) = (false, -20.0 * side);
        for _ in 0..100 {
            page.say(along("motor", by)).await;
            let next = page.sees(|s| over(s) || free(s) && (at(s) - last).abs() > 1e-3).await;
            stopped = over(&next);
            if stopped {
                break;
            }
            // The sense of the gear is unknown here, so reverse the motor if the track moved away.
            by *= if (at(&next) - last) * side < 0.0 { 1.0 } else { -1.0 };
            last = at(&next);
        }
        assert!(stopped, "the arm continues at {last} m");
    });
    let summary = run.thread.join().unwrap();
    assert_eq!((summary.exit_code(), summary.collisions), (3, Some(0)), "{}", summary.reason);
    let (near, stop) = ("the hands come within", "of each other: all arms are stopped");
    assert!(summary.reason.contains(near) && summary.reason.contains(stop), "{}", summary.reason);
}

/// Starts the program with a page. Returns the process, the printed address and the lines on
/// stderr.
fn with_a_page(arguments: &[&str]) -> (Child, String, Receiver<String>) {
    let mut child = program()
        .args(["run", "--json", "--ui", "web", "--listen", "127.0.0.1:0"])
        .args(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let (to, stderr) = channel();
    let lines = BufReader::new(child.stderr.take().unwrap()).lines();
    std::thread::spawn(move || {
        for line in lines.map_while(Result::ok) {
            let _ = to.send(line);
        }
    });
    let page = loop {
        let line = stderr.recv_timeout(PATIENCE).unwrap();
        if let Some((_, url)) = line.split_once("page: ") {
            break url.to_owned();
        }
    };
    (child, page, stderr)
}

/// Waits until the program ends. Returns its exit code and the summary in the last line of its
/// stdout.
fn ended(mut child: Child) -> (Option<i32>, Summary) {
    let mut printed = String::new();
    child.stdout.take().unwrap().read_to_string(&mut printed).unwrap();
    let summary = serde_json::from_str(printed.lines().last().unwrap()).unwrap();
    (child.wait().unwrap().code(), summary)
}

#[test]
fn ctrl_c_ends_the_idle_task_as_done() {
    let (child, address, _stderr) = with_a_page(&["scenarios/idle.toml"]);
    runtime().block_on(async {
        Page::at(&address).await.sees(|s| s["services"]["manual"] == true).await;
    });

    let killed = Process::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(killed.success());

    let (code, summary) = ended(child);
    assert_eq!((summary.outcome, summary.ended_by), (Outcome::Solved, EndedBy::Interrupt));
    assert_eq!(code, Some(0), "{}", summary.reason);
}

/// Orders of the page that commands change a parameter step by step; those of a watcher and
/// impossible ones are refused. The recording has the order, and its verification repeats the run.
#[test]
fn parameter_order_from_page_moves_at_its_rate() {
    let file = crate::recording::place("page_parameter.mcap");
    let recording = ["--record", file.to_str().unwrap()];
    let (child, address, _stderr) =
        with_a_page(&[&["scenarios/idle.toml", "--speed", "1"], &recording[..]].concat());
    let speed = 8;
    runtime().block_on(async {
        let mut page = Page::at(&address).await;
        let stage = page.until(|m| m.get("stage").filter(|s| s["task"] == "idle").cloned()).await;
        assert_eq!(stage["parameters"][speed]["parameter"], "free_speed_percent");
        page.sees(|s| s["services"]["manual"] == true && s["services"]["parameters"] == true).await;
        let order = |value: f64| {
            let parameter = "free_speed_percent";
            json!({ "command": "parameter", "parameter": parameter, "value": value })
        };
        let mut watcher = Page::at(&address).await;
        watcher.next("seat").await;
        watcher.say(order(40.0)).await;
        let refused = watcher.next("refused").await;
        assert_eq!(refused, "parameter: another page commands; take over first");
        page.say(order(10.0)).await;
        assert_eq!(
            page.next("refused").await,
            "parameter free_speed_percent: 10 is outside 20..100"
        );

        page.say(order(40.0)).await;

        let value = |s: &Value| s["parameters"][speed]["value"].as_f64().unwrap();
        let notice = "parameter free_speed_percent: from 100 to 40 %, by the operator";
        page.until(|m| m.get("messages").filter(|m| m.to_string().contains(notice)).cloned()).await;
        let first = page.sees(|s| s["parameters"][speed]["ordered"] == 40.0).await;
        // 60 % at 25 % per second take 2.4 s.
        let half = page.sees(|s| value(s) < 80.0).await;
        let (from, to) = (first["time"].as_f64().unwrap(), half["time"].as_f64().unwrap());
        assert!((value(&first) - value(&half)) / (to - from) < 25.1, "{first} {half}");
        page.sees(|s| value(s) == 40.0).await;
        page.say(json!({ "command": "manual", "effector": 0, "order":
            { "order": "pose", "name": "front" } }))
            .await;
        let at = |s: &Value| s["arms"][0]["joints"][2].as_f64().unwrap();
        page.sees(|s| (at(s) + 1.57).abs() < 2e-3).await;
        page.say(json!({ "command": "terminate" })).await;
        // The program ends with its run, and closes the connection.
        while let Some(Ok(_)) = page.0.next().await {}
    });
    let (code, summary) = ended(child);
    assert_eq!(code, Some(0), "{}", summary.reason);

    let verified = program().args(["replay", "--verify"]).arg(&file).output().unwrap();

    let told = String::from_utf8_lossy(&verified.stdout);
    assert!(told.contains("the same: the whole controller"), "{told}");
    std::fs::remove_file(file).unwrap();
}

/// Returns the rotation between two snapshots of that motor of an arm that has turned most (rad).
fn turned(arm: usize, from: &Value, to: &Value) -> f64 {
    let at = |s: &Value, motor: usize| s["arms"][arm]["motors"][motor].as_f64().unwrap();
    (0..7).map(|motor| (at(to, motor) - at(from, motor)).abs()).fold(0.0, f64::max)
}

/// Returns the text that a snapshot shows as the activity of an arm's EDP.
fn edp(s: &Value, arm: &str) -> String {
    let name = format!("edp {arm}");
    let actors = s["actors"].as_array();
    let actor = actors.and_then(|all| all.iter().find(|a| a["name"] == name.as_str()));
    actor.map_or_else(String::new, |a| a["words"].as_str().unwrap().to_owned())
}

/// Pauses and resumes while an arm homes. Checks that the arm stops within 0.3 s, that its EDP
/// reports it, and that the homing continues after the pause.
async fn pause_while_homing(page: &mut Page, index: usize, arm: &str) {
    page.sees(|s| edp(s, arm).starts_with("synchronises axis")).await;
    page.say(json!({ "command": "pause" })).await;
    let paused = page.sees(|s| s["control"] == "paused").await["time"].as_f64().unwrap();
    let rest = page.sees(|s| s["time"].as_f64().unwrap() > paused + 0.3).await;
    let later = page.sees(|s| s["time"].as_f64().unwrap() > paused + 1.3).await;
    assert!(turned(index, &rest, &later) < 0.02, "{} rad", turned(index, &rest, &later));
    assert_eq!(edp(&later, arm), "not synchronised");
    page.say(json!({ "command": "resume" })).await;
    let going = page.sees(|s| edp(s, arm).starts_with("synchronises axis")).await;
    page.sees(|s| turned(index, &going, s) > 1.0).await;
}

#[test]
fn manual_homing_obeys_pause_and_ctrl_c() {
    let unknown = "effector.postument.start_synchronised=false";
    let (child, address, _stderr) = with_a_page(&["scenarios/idle.toml", "--set", unknown]);
    let pressed = runtime().block_on(async {
        let mut page = Page::at(&address).await;
        let stage = page.until(|m| m.get("stage").filter(|s| s["task"] == "idle").cloned()).await;
        let names = stage["arms"].as_array().unwrap().iter().map(|a| a["name"].as_str().unwrap());
        let index = names.into_iter().position(|name| name == "postument").unwrap();
        page.sees(|s| s["services"]["manual"] == true).await;
        let order = json!({ "order": "synchronise" });
        page.say(json!({ "command": "manual", "effector": index, "order": order })).await;
        pause_while_homing(&mut page, index, "postument").await;

        let signal = ["-INT", &child.id().to_string()].map(str::to_owned);
        assert!(Process::new("kill").args(signal).status().unwrap().success());
        Instant::now()
    });

    let (code, summary) = ended(child);
    // Homing takes 79 s.
    assert!(pressed.elapsed() < Duration::from_secs(20), "{:?}", pressed.elapsed());
    assert_eq!((summary.ended_by, code), (EndedBy::Interrupt, Some(0)), "{}", summary.reason);
}

#[test]
fn homing_at_start_obeys_pause_and_terminate() {
    let unknown = "effector.postument.start_synchronised=false";
    let scenario = load("solve.toml", &[unknown]);
    let arms = &scenario.controller.cell.arms;
    let index = arms.iter().position(|arm| arm.name == "postument").unwrap();
    let (ui, run_end) = Desk::default().ends();
    let server = serve(ui);
    let options = RunOptions { automatic: true, quiet: true, speed: 1.0, ..RunOptions::default() };
    let run = std::thread::spawn(move || run::run_at(&scenario, options, Some(run_end)));
    runtime().block_on(async {
        let mut page = Page::open(&server).await;
        pause_while_homing(&mut page, index, "postument").await;
        page.say(json!({ "command": "terminate" })).await;
        page.sees(|s| s["control"] == "ended").await;
    });
    let error = run.join().unwrap().unwrap_err();
    assert!(error.to_string().contains("terminated"), "{error}");
}

#[test]
fn interrupt_reports_where_the_cube_is() {
    let (child, address, _stderr) = with_a_page(&["scenarios/face_turn.toml", "--speed", "1"]);
    runtime().block_on(async {
        Page::at(&address).await.sees(|s| s["time"].as_f64().unwrap() > 1.0).await;
    });

    let killed = Process::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(killed.success());

    let (code, summary) = ended(child);
    assert_eq!((summary.ended_by, code), (EndedBy::Interrupt, Some(130)));
    let place = summary.reason.strip_prefix("interrupted; ").unwrap_or_default();
    assert!(place.contains("hold"), "{}", summary.reason);
}

/// The page shows the fault of the arm.
#[test]
fn emergency_stop_before_the_start_ends_the_run() {
    let run = begin(load("solve.toml", &[]), RunOptions { wait: true, ..RunOptions::default() });
    runtime().block_on(async {
        let mut page = Page::open(&run.server).await;
        page.sees(|s| s["control"] == "waiting").await;
        page.say(json!({ "command": "emergency_stop" })).await;
        let end = page.sees(|s| s["control"] == "ended").await;
        assert!(end["arms"][0]["fault"].as_str().unwrap().contains("emergency"), "{end}");
    });
    let summary = run.thread.join().unwrap();
    assert_eq!(summary.ended_by, EndedBy::Fatal);
    assert!(summary.reason.contains("emergency stop"), "{}", summary.reason);
}

/// The run waits 3 s for its start and is paced to real time for 2 s. Neither counts as wall time
/// of the run.
#[test]
fn wall_time_excludes_start_wait_and_pacing_delays() {
    let scenario = load("idle.toml", &["idle.time_s=2"]);
    let (ui, run_end) = Desk::default().ends();
    let options = RunOptions {
        automatic: true,
        quiet: true,
        wait: true,
        speed: 1.0,
        ..RunOptions::default()
    };
    let run = std::thread::spawn(move || run::run_at(&scenario, options, Some(run_end)).unwrap());
    let begun = Instant::now();
    let sees = |what: &dyn Fn(&Snapshot) -> bool| {
        while !what(&ui.snapshots.borrow()) {
            assert!(begun.elapsed() < PATIENCE);
            std::thread::sleep(Duration::from_millis(20));
        }
    };
    std::thread::sleep(Duration::from_secs(3));
    assert!(ui.send(Input::Start));
    sees(&|s| s.time > 2.0);
    assert!(ui.send(Input::Terminate));
    let summary = run.join().unwrap();
    let took = begun.elapsed().as_secs_f64();
    assert!(summary.wall_time_s < took - 4.0, "{} s of {took} s", summary.wall_time_s);
}

/// The pause and the answer of the operator are inputs in the recording, so `replay --verify`
/// repeats the run to the bit.
#[test]
fn replay_verifies_run_with_pause_and_operators_answer() {
    let recording = Path::new(env!("CARGO_TARGET_TMPDIR")).join("answered.mcap");
    let file = recording.to_str().unwrap();
    let (child, address, _stderr) = with_a_page(&["tests/page/question.toml", "--record", file]);
    let stickers = runtime().block_on(async {
        let mut page = Page::at(&address).await;
        page.sees(|s| s["time"].as_f64().unwrap() > 3.0).await;
        page.say(json!({ "command": "pause" })).await;
        let paused = page.sees(|s| s["control"] == "paused").await["time"].as_f64().unwrap();
        page.sees(|s| s["time"].as_f64().unwrap() > paused + 0.8).await;
        page.say(json!({ "command": "resume" })).await;

        let asked = page.sees(|s| s["question"]["number"] == 1).await;
        let question = asked["question"].clone();
        let [until, now] = [&question["until"], &asked["time"]].map(|t| t.as_f64().unwrap());
        let seconds = question["seconds"].as_f64().unwrap();
        assert!((until - now - seconds).abs() < 2.0, "{now}: {question}");
        let mut read: Vec<char> = question["subject"]["read"].as_str().unwrap().chars().collect();
        let count = |read: &[char], letter| read.iter().filter(|&&l| l == letter).count();
        let of = |n| "URFDLB".chars().find(|&l| count(&read, l) == n).unwrap();
        let (many, few) = (of(10), of(8));
        let doubtful: Vec<usize> =
            serde_json::from_value(question["subject"]["doubtful"].clone()).unwrap();
        let wrong: Vec<usize> = doubtful.into_iter().filter(|&i| read[i] == many).collect();
        assert_eq!(wrong.len(), 1, "{question}");
        read[wrong[0]] = few;
        let stickers = String::from_iter(read);
        let answer = json!({ "answer": "stickers", "stickers": stickers });
        page.say(json!({ "command": "answer", "question": 1, "answer": answer })).await;
        page.sees(|s| s["question"].is_null() && s["net"]["decided"] == true).await;
        stickers
    });

    let (code, summary) = ended(child);
    assert_eq!((code, summary.outcome), (Some(0), Outcome::Solved), "{}", summary.reason);
    assert!(summary.identified.is_some_and(|cube| Some(cube) == summary.cube_start));

    let replay = |more: &[&str]| {
        let mut replay = program();
        replay.args(["replay", file, "--ui", "none"]).args(more).output().unwrap()
    };
    let stderr = String::from_utf8(replay(&[]).stderr).unwrap();
    for words in ["operator: pause", "operator: resume", &format!("the stickers are {stickers}")] {
        assert!(stderr.contains(words), "{words}: {stderr}");
    }
    let verified = replay(&["--verify", "--json"]);
    let verdict: Value = serde_json::from_slice(&verified.stdout).unwrap();
    assert_eq!(
        (&verdict["same"], &verdict["not_compared"]),
        (&true.into(), &0.into()),
        "{verdict}"
    );
    let ticks = (summary.sim_time_s * 1000.0) as u64;
    assert!(verdict["compared"].as_u64().unwrap() >= ticks - 2, "{verdict}");
}

/// Another user of this machine, or another machine, sees and commands nothing.
#[test]
fn pages_at_every_address_require_the_token() {
    for address in ["127.0.0.1:0", "0.0.0.0:0"] {
        let (ui, run_end) = Desk::default().ends();
        let server = Server::start(ui, address.parse().unwrap()).unwrap();
        let (host, token) = host_and_token(&server.url);
        let ask = |path: &str, more: &str| {
            answer_to(host, &format!("GET /{path} HTTP/1.1\r\nHost: {host}\r\n{more}"))
        };

        // The files of the page are those of the program's source, the same for everybody.
        for asset in ["", "main.js", "style.css", "icon.svg"] {
            let answer = ask(asset, "");
            assert!(answer.starts_with("HTTP/1.1 200"), "{asset}: {answer}");
            assert!(!answer.contains("set-cookie") && !answer.contains(token), "{asset}");
        }
        let wrong = format!("X-Token: {}\r\n", &token[1..]);
        let kept = format!("Cookie: token={token}; x-token={token}\r\n");
        for more in ["", &wrong, &kept] {
            let answer = ask(&format!("camera/0?token={token}"), more);
            assert!(answer.starts_with("HTTP/1.1 403"), "{answer}");
            assert!(answer.contains("open the address that the program printed"), "{answer}");
        }
        let right = ask("camera/0", &format!("X-Token: {token}\r\n"));
        assert!(right.starts_with("HTTP/1.1 404"), "there is no picture: {right}");

        runtime().block_on(async {
            let mut operator = Page::open(&server).await;
            assert_eq!(operator.next("seat").await, seat(true, true, None));
            for first in [
                json!({ "command": "emergency_stop" }),
                json!({ "command": "terminate" }),
                json!({ "seat": "take" }),
                json!({ "token": "" }),
                json!({ "token": &token[1..], "page": "x" }),
            ] {
                let (socket, _) = connect_async(format!("ws://{host}/ws")).await.unwrap();
                let mut stranger = Page(socket);
                stranger.say(first).await;
                let _ = stranger.0.send(Message::text(r#"{"command":"emergency_stop"}"#)).await;
                let all = tokio::time::timeout(PATIENCE, stranger.0.collect::<Vec<_>>());
                let all: Vec<_> = all.await.unwrap().into_iter().map_while(Result::ok).collect();
                let texts = all.iter().filter_map(|m| m.to_text().ok()).filter(|t| !t.is_empty());
                let texts: Vec<&str> = texts.collect();
                assert!(texts.len() == 1 && texts[0].contains("denied"), "{texts:?}");
            }
            operator.say(json!({ "command": "pause" })).await;
            let mut commands = run_end.take_inputs().unwrap();
            assert_eq!(commands.recv().await.map(|given| given.input), Some(Input::Pause));
            assert!(commands.try_recv().is_err());
        });
        assert!(!run_end.stop_signal().is_pressed());
    }
}

/// A stranger opens as many sockets as it can, and they stay silent; a page then opens, and the one
/// of the operator commands and stops. First without the token, then by somebody who has it.
#[test]
fn silent_sockets_keep_no_operator_out() {
    let (ui, run_end) = Desk::default().ends();
    let server = serve(ui);
    let mut commands = run_end.take_inputs().unwrap();
    runtime().block_on(async {
        let mut operator = Page::open(&server).await;
        assert_eq!(operator.next("seat").await, seat(true, true, None));
        let mut silent = Vec::new();
        for _ in 0..80 {
            let (socket, _) = connect_async(format!("ws://{}/ws", server.address)).await.unwrap();
            silent.push(socket);
        }
        let mut second = Page::open(&server).await;
        assert_eq!(second.next("seat").await, seat(false, true, None));

        let mut pages = Vec::new();
        for _ in 0..80 {
            let mut page = Page::open(&server).await;
            page.next("seat").await;
            pages.push(page);
            // On a busy machine the operator's page would count as silent.
            operator.say(json!({ "alive": true })).await;
        }
        operator.say(json!({ "command": "pause" })).await;
        assert_eq!(commands.recv().await.map(|given| given.input), Some(Input::Pause));
        let mut third = Page::open(&server).await;
        third.next("seat").await;
        third.say(json!({ "command": "emergency_stop" })).await;
        assert_eq!(commands.recv().await.map(|given| given.input), Some(Input::EmergencyStop));
        operator.say(json!({ "command": "resume" })).await;
        assert_eq!(commands.recv().await.map(|given| given.input), Some(Input::Resume));
    });
    assert!(run_end.stop_signal().is_pressed());
}

/// The operator reloads the page, and a stranger's opens meanwhile.
#[test]
fn reloaded_page_keeps_the_command() {
    let server = serve(Desk::default().ui_end());
    runtime().block_on(async {
        let mut operator = Page::named(&server.url, Some("operator")).await;
        assert_eq!(operator.next("seat").await, seat(true, true, None));
        drop(operator);
        let mut other = Page::named(&server.url, Some("other")).await;
        assert_eq!(other.next("seat").await, seat(false, true, None));

        let mut operator = Page::named(&server.url, Some("operator")).await;

        assert_eq!(operator.next("seat").await, seat(true, true, None));
    });
}

/// The browser's side of a tunnel or of a proxy for TLS has another port, name and scheme.
#[test]
fn pages_behind_tunnel_and_proxy_open() {
    let (ui, address) = (Desk::default().ui_end(), "127.0.0.1:0".parse().unwrap());
    let names = vec!["robot.example".parse().unwrap()];
    let server = Server::start_behind(ui, address, names).unwrap();
    let own = server.address.to_string();
    let token = host_and_token(&server.url).1;
    assert_eq!(server.proxy_urls, [format!("https://robot.example/#token={token}")]);
    runtime().block_on(async {
        for (host, origin) in [
            ("localhost:9000", "http://localhost:9000"),
            ("localhost", "http://localhost"),
            ("localhost:9000", "https://localhost:9000"),
            ("robot.example", "https://robot.example"),
            (own.as_str(), "https://robot.example"),
        ] {
            let mut request = format!("ws://{own}/ws").into_client_request().unwrap();
            request.headers_mut().insert("Host", host.parse().unwrap());
            request.headers_mut().insert("Origin", origin.parse().unwrap());
            let mut page = Page(connect_async(request).await.unwrap().0);
            page.say(json!({ "token": token })).await;
            page.next("seat").await;
        }
    });
}

/// A run with a page that only watches repeats a run without a page to the bit.
#[test]
fn watching_page_leaves_run_hash_unchanged() {
    let options = RunOptions { automatic: true, quiet: true, ..RunOptions::default() };
    let alone = run::run(&load("face_turn.toml", &[]), options).unwrap();

    let run = begin(load("face_turn.toml", &[]), RunOptions { wait: false, ..options });
    let snapshots = runtime().block_on(async {
        let mut page = Page::open(&run.server).await;
        let mut seen = 0;
        page.until(|m| {
            seen += u32::from(m.get("snapshot").is_some());
            m.get("snapshot").filter(|s| s["control"] == "ended").map(|_| ())
        })
        .await;
        seen
    });
    let watched = run.thread.join().unwrap();

    assert!(snapshots > 0);
    assert_eq!(watched.hash, alone.hash);
}

/// The server and the desk outlive the runs: the page shows one run after the other, and an
/// emergency stop of the first run does not stop the second.
#[test]
fn page_outlives_a_run_and_shows_the_next() {
    let desk = Desk::default();
    let server = serve(desk.ui_end());
    let run = |seed: &str| {
        let (scenario, run_end) = (load("idle.toml", &[seed]), desk.run_end());
        let options = RunOptions { automatic: true, quiet: true, ..RunOptions::default() };
        std::thread::spawn(move || run::run_at(&scenario, options, Some(run_end)).unwrap())
    };
    runtime().block_on(async {
        let mut page = Page::open(&server).await;
        let first = run("seed=11");
        page.until(|m| m.get("stage").filter(|s| s["seed"] == 11).cloned()).await;
        page.sees(|s| s["services"]["manual"] == true).await;
        page.say(json!({ "command": "emergency_stop" })).await;
        page.sees(|s| s["control"] == "ended").await;
        assert_eq!(first.join().unwrap().ended_by, EndedBy::Fatal);

        // Between two runs the page and its socket answer.
        let mut late = Page::open(&server).await;
        late.sees(|s| s["control"] == "ended").await;
        drop(late);
        desk.prepare_next_run();

        let second = run("seed=12");
        page.until(|m| m.get("stage").filter(|s| s["seed"] == 12).cloned()).await;
        let first_message = |m: &Value| m.get("messages")?.get(0)?.get("number")?.as_u64();
        assert_eq!(page.until(first_message).await, 1);
        page.sees(|s| s["services"]["manual"] == true && s["arms"][0]["fault"].is_null()).await;
        page.say(json!({ "command": "terminate" })).await;
        page.sees(|s| s["control"] == "ended").await;
        assert_eq!(second.join().unwrap().ended_by, EndedBy::Operator);
    });
}

#[test]
fn only_one_page_commands_until_another_takes_over() {
    let (ui, run_end) = Desk::default().ends();
    let server = serve(ui);
    let mut commands = run_end.take_inputs().unwrap();
    runtime().block_on(async {
        let mut first = Page::open(&server).await;
        assert_eq!(first.next("seat").await, seat(true, true, None));
        let mut second = Page::open(&server).await;
        assert_eq!(second.next("seat").await, seat(false, true, None));

        second.say(json!({ "command": "pause" })).await;
        let refused = second.next("refused").await;
        assert!(refused.as_str().unwrap().contains("another page commands"), "{refused}");
        assert!(commands.try_recv().is_err(), "no command passed");

        second.say(json!({ "seat": "take" })).await;
        assert_eq!(second.next("seat").await, seat(false, true, Some("own")));
        assert_eq!(first.next("seat").await, seat(true, true, Some("other")));
        second.say(json!({ "command": "pause" })).await;
        second.next("refused").await;
        first.say(json!({ "seat": "keep" })).await;
        assert_eq!(second.next("seat").await, seat(false, true, None));
        assert_eq!(first.next("seat").await, seat(true, true, None));

        second.say(json!({ "seat": "take" })).await;
        assert_eq!(first.next("seat").await, seat(true, true, Some("other")));
        assert_eq!(second.next("seat").await, seat(false, true, Some("own")));
        first.say(json!({ "seat": "give" })).await;
        assert_eq!(second.next("seat").await, seat(true, true, None));
        assert_eq!(first.next("seat").await, seat(false, true, None));
        assert!(commands.try_recv().is_err(), "no command passed");
        second.say(json!({ "command": "pause" })).await;
        assert_eq!(commands.recv().await.map(|given| given.input), Some(Input::Pause));

        second.say(json!({ "nonsense": 1 })).await;
        assert_eq!(second.next("refused").await, json!("the message is not a command"));
        drop(second);
        assert_eq!(first.next("seat").await, seat(false, false, None));
        // The emergency stop does not need the right to command.
        first.say(json!({ "command": "emergency_stop" })).await;
        assert_eq!(commands.recv().await.map(|given| given.input), Some(Input::EmergencyStop));
        assert!(run_end.stop_signal().is_pressed());
    });
}

/// The server closes the connection of a page that sends a message of more than 4096 bytes.
#[test]
fn overlong_message_closes_its_page_without_effect() {
    let (ui, run_end) = Desk::default().ends();
    let server = serve(ui);
    let mut commands = run_end.take_inputs().unwrap();
    let padded = |length: usize| Message::text(format!("{:<length$}", r#"{"command":"pause"}"#));
    runtime().block_on(async {
        let mut page = Page::open(&server).await;
        page.0.send(padded(4096)).await.unwrap();
        assert_eq!(commands.recv().await.map(|given| given.input), Some(Input::Pause));

        page.0.send(padded(4097)).await.unwrap();

        let ends = async {
            loop {
                tokio::select! {
                    biased;
                    word = commands.recv() => panic!("{word:?} is obeyed"),
                    message = page.0.next() => match message {
                        None | Some(Err(_) | Ok(Message::Close(_))) => break,
                        Some(Ok(_)) => {}
                    },
                }
            }
        };
        assert!(tokio::time::timeout(Duration::from_secs(60), ends).await.is_ok(), "it stays");
        assert!(commands.try_recv().is_err());
    });
}

/// With 400 idle connections a new page still opens, and an older page can still press the
/// emergency stop.
#[test]
fn idle_connections_do_not_block_the_page() {
    let (ui, run_end) = Desk::default().ends();
    let server = serve(ui);
    // A page that was open before the idle connections stays open.
    let runtime = runtime();
    let mut page = runtime.block_on(Page::open(&server));
    runtime.block_on(page.next("seat"));

    let mut idle: Vec<TcpStream> = Vec::new();
    for number in 0..400 {
        let mut stream = TcpStream::connect(server.address).unwrap();
        // Every second connection sends a part of a request.
        if number % 2 == 0 {
            let _ = stream.write_all(b"GET / HTTP/1.1\r\nHost: ");
        }
        idle.push(stream);
    }
    let begun = Instant::now();
    let mut stream = TcpStream::connect(server.address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let ask = format!("GET / HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n\r\n", server.address);
    stream.write_all(ask.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    assert!(begun.elapsed() < Duration::from_secs(30), "{:?}", begun.elapsed());

    // The server closes all of them, at once or after some time without a request.
    for mut stream in idle {
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let read = stream.read(&mut [0; 1]);
        let waits = |why: &std::io::Error| why.kind() == std::io::ErrorKind::WouldBlock;
        assert!(
            !read.as_ref().is_err_and(waits) && !read.as_ref().is_ok_and(|n| *n > 0),
            "{read:?}"
        );
    }
    runtime.block_on(page.say(json!({ "command": "emergency_stop" })));
    let begun = Instant::now();
    while !run_end.stop_signal().is_pressed() {
        assert!(begun.elapsed() < PATIENCE, "the stop did not come");
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn foreign_origins_get_neither_page_nor_socket() {
    let server = serve(Desk::default().ui_end());
    let ask = |head: &str| answer_to(server.address, head);
    let own = server.address.to_string();
    let page = ask(&format!("GET / HTTP/1.1\r\nHost: {own}\r\n"));
    assert!(page.starts_with("HTTP/1.1 200"), "{page}");
    assert!(page.contains("content-security-policy: default-src 'none'"), "{page}");
    assert!(page.contains("x-frame-options: DENY"));
    assert!(page.contains("cross-origin-resource-policy: same-origin"), "{page}");
    assert!(page.contains("cross-origin-opener-policy: same-origin"), "{page}");
    for head in [
        "GET / HTTP/1.1\r\nHost: evil.example:80\r\n".to_owned(),
        format!("GET / HTTP/1.1\r\nHost: {own}\r\nHost: evil.example\r\n"),
        format!("GET http://evil.example/ HTTP/1.1\r\nHost: {own}\r\n"),
        format!("GET /main.js HTTP/1.1\r\nHost: {own}\r\nSec-Fetch-Site: same-site\r\n"),
        format!("GET / HTTP/1.1\r\nHost: {own}\r\nOrigin: http://{own}\r\nOrigin: null\r\n"),
    ] {
        let answer = ask(&head);
        assert!(answer.starts_with("HTTP/1.1 403"), "{head}{answer}");
        assert!(answer.contains("open the address that the program printed"), "{answer}");
    }
    let token = host_and_token(&server.url).1;
    let missing = ask(&format!("GET /camera/7 HTTP/1.1\r\nHost: {own}\r\nX-Token: {token}\r\n"));
    assert!(missing.starts_with("HTTP/1.1 404"), "{missing}");
    runtime().block_on(async {
        for (origin, passes) in [
            (format!("http://{own}"), true),
            ("http://evil.example".to_owned(), false),
            ("null".to_owned(), false),
        ] {
            let mut request = format!("ws://{own}/ws").into_client_request().unwrap();
            request.headers_mut().insert("Origin", origin.parse().unwrap());
            match connect_async(request).await {
                Ok(_) => assert!(passes, "{origin}"),
                Err(Error::Http(answer)) => {
                    assert!(!passes && answer.status() == 403, "{origin}: {answer:?}");
                }
                Err(other) => panic!("{other}"),
            }
        }
    });
}

#[test]
fn web_assets_refer_to_no_other_host() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/web/assets");
    let mut files = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let text = std::fs::read_to_string(&path).unwrap();
        let text = text.replace("http://www.w3.org/2000/svg", "");
        assert!(!text.contains("http://") && !text.contains("https://"), "{}", path.display());
        files += 1;
    }
    assert!(files >= 10);
}

#[test]
fn page_receives_a_snapshot_unchanged() {
    let (ui, run_end) = Desk::default().ends();
    let server = serve(ui);
    let outcome = OutcomeView {
        verdict: "done".to_owned(),
        good: true,
        reason: "the \"cube\" is solved".to_owned(),
        time: Some(0.1),
        figures: vec![("turns".to_owned(), "19".to_owned())],
    };
    let sent = Snapshot {
        number: 7,
        time: 1.25,
        factor: 3.5,
        speed: 2.0,
        control: ControlView::Paused,
        phase: "turn".to_owned(),
        phases: vec![("acquire".to_owned(), 0.5)],
        step: Some(4),
        servo: Some(ServoTiming { period: 0.002, late: 1e-5, work: 2e-4, missed: 3 }),
        services: Services {
            manual: true,
            speed: true,
            parameters: true,
            seek_ms: Some(9),
            after: Some(After { seed: 3, resumes: true, recorded: true }),
        },
        outcome: Some(outcome),
        ..Snapshot::default()
    };
    run_end.publish(sent.clone());
    let text = runtime().block_on(async { Page::open(&server).await.next("snapshot").await });
    let back: Snapshot = serde_json::from_value(text).unwrap();
    assert_eq!(back, sent);
}
