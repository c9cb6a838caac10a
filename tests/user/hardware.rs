//! Runs over the serial lines of the robot. The emulator takes the place of the robot, in a process
//! of its own.

use crate::program::program;
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Scenario in which the postument idles for 2 s over serial lines.
const IDLE: &str = "\
task = \"idle\"
pace = \"real-time\"
camera = []
vsp = []
[bridge]
kind = \"serial\"
# These tests share the processor with others.
missed_answers = 40
[idle]
time_s = 2
[[effector]]
name = \"postument\"
";

/// Emulator with its scenario and its devices, which are removed when the test ends.
struct Robot {
    emulator: Child,
    folder: PathBuf,
}

impl Robot {
    /// Starts the emulator with these options, and waits until it is ready for a run.
    fn new(name: &str, options: &[&str]) -> Self {
        let folder =
            std::env::temp_dir().join(format!("rubik-robot-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("idle.toml"), IDLE).unwrap();
        let mut emulator = program()
            .arg("emulate")
            .arg(folder.join("idle.toml"))
            .arg("--set")
            .arg(format!("bridge.devices={}", folder.join("devices.toml").display()))
            .arg("--json")
            .args(options)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut stderr = BufReader::new(emulator.stderr.take().unwrap());
        let mut line = String::new();
        while !line.contains("rubik-robot run") {
            line.clear();
            assert!(stderr.read_line(&mut line).unwrap() > 0, "the emulator gave up");
        }
        // Drain the pipe: a full one would block the emulator.
        std::thread::spawn(move || std::io::copy(&mut stderr, &mut std::io::sink()));
        Self { emulator, folder }
    }

    /// Starts a run on the emulated devices with these options.
    fn start(&self, options: &[&str]) -> Child {
        program()
            .arg("run")
            .arg(self.folder.join("idle.toml"))
            .arg("--set")
            .arg(format!("bridge.devices={}", self.folder.join("devices.toml").display()))
            .arg("--json")
            .args(options)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap()
    }

    /// Waits until the emulator ends and returns its verdict, the last line of its stdout.
    fn verdict(mut self) -> Value {
        let mut stdout = self.emulator.stdout.take().unwrap();
        let mut printed = String::new();
        std::io::Read::read_to_string(&mut stdout, &mut printed).unwrap();
        assert!(self.emulator.wait().unwrap().success());
        assert!(!self.folder.join("devices.toml").exists(), "its devices went away with it");
        serde_json::from_str(printed.lines().last().unwrap()).unwrap()
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        let _ = self.emulator.kill();
        let _ = self.emulator.wait();
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// Returns the summary of a run, the last line of its stdout.
fn summary(out: &Output) -> Value {
    let printed = std::str::from_utf8(&out.stdout).unwrap();
    serde_json::from_str(printed.lines().last().unwrap()).unwrap()
}

/// Returns what the program has written to stderr.
fn stderr(out: &Output) -> String {
    String::from_utf8_lossy(&out.stderr).into_owned()
}

/// A controller on hardware cannot know the plant's true quantities, so its summary leaves them
/// out. The emulator's verdict has them.
#[test]
#[ignore = "real time over pseudo-terminals: run by name on a machine with time to spare"]
fn summary_of_serial_run_omits_true_plant_values() {
    let robot = Robot::new("held", &[]);

    let out = robot.start(&[]).wait_with_output().unwrap();

    assert_eq!(out.status.code(), Some(0), "{}", stderr(&out));
    let run = summary(&out);
    assert_eq!(run["outcome"], "solved");
    assert!(run["reason"].as_str().unwrap().contains("as the controller reports"), "{run}");
    for unknown in ["cube_start", "cube_end", "peak_force_n", "jams", "slips", "collisions"] {
        assert_eq!(run[unknown], Value::Null, "{unknown}");
    }
    let truth = robot.verdict();
    assert_eq!(truth["cube_start"], truth["cube_end"]);
    assert_eq!(truth["cube_start"].as_str().unwrap().len(), 54);
    // Seven lines with 1000 periods in 2 s have 7000 orders; a busy machine may miss periods.
    assert!(truth["orders"].as_u64().unwrap() > 3000, "{truth}");
}

/// The reason in the summary names the arm, its serial lines and the period.
#[test]
#[ignore = "real time over pseudo-terminals: run by name on a machine with time to spare"]
fn killed_emulator_ends_the_run_with_exit_3() {
    let mut robot = Robot::new("killed", &[]);
    let run = robot.start(&["--set", "idle.time_s=60"]);
    std::thread::sleep(Duration::from_millis(2500));

    robot.emulator.kill().unwrap();
    let begun = Instant::now();
    let out = run.wait_with_output().unwrap();

    assert!(begun.elapsed() < Duration::from_secs(5), "{:?}", begun.elapsed());
    assert_eq!(out.status.code(), Some(3), "{}", stderr(&out));
    let run = summary(&out);
    assert_eq!(run["ended_by"], "fatal");
    let reason = run["reason"].as_str().unwrap();
    for wanted in ["postument", "/dev/pts/", "no answer for 3 periods", "period"] {
        assert!(reason.contains(wanted), "{reason}");
    }
    // The loss is also reported at once, not only in the summary.
    assert!(stderr(&out).contains("bridge lost"), "{}", stderr(&out));
}

/// The reason in the summary names the serial line of axis 4.
#[test]
#[ignore = "real time over pseudo-terminals: run by name on a machine with time to spare"]
fn unplugged_serial_line_ends_run_with_exit_3() {
    let robot = Robot::new("unplugged", &["--unplug", "postument.4@1"]);

    let out = robot.start(&["--set", "idle.time_s=60"]).wait_with_output().unwrap();

    assert_eq!(out.status.code(), Some(3), "{}", stderr(&out));
    let reason = summary(&out)["reason"].as_str().unwrap().to_owned();
    assert!(reason.contains("postument, axis 4 (/dev/pts/"), "{reason}");
}

/// Returns whether these tests and their child processes ignore SIGHUP, as under nohup.
pub(crate) fn hang_up_is_ignored() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:")).unwrap();
    u64::from_str_radix(mask.trim(), 16).unwrap() & 1 == 1
}

#[test]
fn hangup_signal_ends_run_during_homing() {
    let folder = std::env::temp_dir().join(format!("rubik-robot-{}-homing", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let home = folder.join("home.toml");
    let text = IDLE.replace("real-time", "virtual").replace("serial", "plant");
    std::fs::write(&home, format!("{text}start_synchronised = false\n")).unwrap();
    let mut run = program()
        .args(["run", "--json", "--speed", "2"])
        .arg(&home)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stderr = BufReader::new(run.stderr.take().unwrap());
    let mut line = String::new();
    while !line.contains("synchronise") {
        line.clear();
        assert!(stderr.read_line(&mut line).unwrap() > 0, "it ended by itself");
    }
    std::thread::sleep(Duration::from_millis(300));

    // A closing terminal sends SIGHUP, which must not kill the program before its last orders to
    // the drives. Programs under nohup ignore SIGHUP, so the test sends SIGTERM there.
    let begun = Instant::now();
    let id = run.id().to_string();
    let signal = if hang_up_is_ignored() { "-TERM" } else { "-HUP" };
    assert!(Command::new("kill").args([signal, &id]).status().unwrap().success());
    let out = run.wait_with_output().unwrap();
    std::fs::remove_dir_all(&folder).unwrap();

    assert!(begun.elapsed() < Duration::from_secs(5), "homing takes a minute and a half");
    let run = summary(&out);
    assert_eq!(run["ended_by"], "interrupt", "{run}");
    assert!(run["reason"].as_str().unwrap().contains("interrupted before"), "{run}");
}

/// Answers over the wire protocol are missed, corrupt and lost, and serial lines stall; the layer
/// still turns by 90 deg.
#[test]
fn layer_turns_despite_faults_of_serial_lines() {
    let turn = |faults: &[&str]| {
        let out = program()
            .args(["run", "scenarios/face_turn.toml", "--json", "--set", "bridge.kind=wire"])
            .args(faults.iter().flat_map(|fault| ["--set", fault]))
            .output()
            .unwrap();
        assert_eq!(out.status.code(), Some(0), "{}", stderr(&out));
        let run = summary(&out);
        assert_eq!(run["outcome"], "solved", "{run}");
        let turned = run["turned_deg"].as_f64().unwrap();
        assert!((turned - 90.0).abs() < 3.0, "{run}");
        run["servo_hash"].clone()
    };
    let faults = [
        "plant.lines.missed=0.002",
        "plant.lines.corrupt=0.002",
        "plant.lines.lost=0.01",
        "plant.lines.stalled=0.001",
    ];

    let clean = turn(&[]);

    assert_ne!(turn(&faults), clean, "the servos notice the faults");
}

#[test]
fn missing_devices_file_exits_2_with_advice() {
    let robot = Robot::new("absent", &[]);
    let nowhere = format!("bridge.devices={}", robot.folder.join("nosuch.toml").display());

    let out = robot.start(&["--set", &nowhere]).wait_with_output().unwrap();

    assert_eq!(out.status.code(), Some(2));
    for wanted in ["cannot read ", "nosuch.toml: there is no such file", "rubik-robot emulate"] {
        assert!(stderr(&out).contains(wanted), "{}", stderr(&out));
    }
    let virtual_pace = robot.start(&["--pace", "virtual"]).wait_with_output().unwrap();
    assert_eq!(virtual_pace.status.code(), Some(2));
    assert!(stderr(&virtual_pace).contains("real time only"), "{}", stderr(&virtual_pace));
}

#[test]
fn devices_file_of_killed_emulator_is_refused() {
    let mut robot = Robot::new("left", &[]);
    robot.emulator.kill().unwrap();
    robot.emulator.wait().unwrap();
    assert!(robot.folder.join("devices.toml").exists());

    let out = robot.start(&[]).wait_with_output().unwrap();

    assert_eq!(out.status.code(), Some(4), "{}", stderr(&out));
    assert!(stderr(&out).contains("the emulator that wrote it has ended"), "{}", stderr(&out));
    let empty = robot.start(&["--set", "bridge.devices=\"\""]).wait_with_output().unwrap();
    assert_eq!(empty.status.code(), Some(2), "{}", stderr(&empty));
}

#[test]
fn emulator_refuses_invalid_unplug_times() {
    for time in ["-1", "nan", "inf"] {
        let fault = format!("track.3@{time}");
        let out = program()
            .args(["emulate", "scenarios/hardware.toml", "--unplug", &fault])
            .output()
            .unwrap();

        assert_eq!(out.status.code(), Some(2), "{fault}: {}", stderr(&out));
        assert!(stderr(&out).contains("0 or more"), "{}", stderr(&out));
    }
}
