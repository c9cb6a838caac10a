//! The terminal UI on a pseudo-terminal: after a failed start, a signal, a replay or wrong
//! arguments the program ends and the terminal is as it was.

use crate::hardware::hang_up_is_ignored;
use crate::program::program;
use rubik_robot::record::reading::{End, Label, open};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{LocalModes, Termios, Winsize, tcgetattr, tcsetwinsize};
use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Longest wait for an event; a busy machine is slow.
const PATIENCE: Duration = Duration::from_secs(60);

/// Program at a terminal of 80 by 24 characters.
struct Session {
    child: Child,
    /// End of the pseudo-terminal at which a person types.
    keys: File,
    /// End of the pseudo-terminal at which the program is.
    terminal: File,
    /// Modes of the terminal before the program.
    before: Termios,
    /// All that the program has written.
    output: Arc<Mutex<Vec<u8>>>,
    /// Whether a thread still collects the output.
    listening: Arc<AtomicBool>,
}

impl Session {
    /// Starts the program with these arguments at a new terminal.
    fn begin(arguments: &[&str]) -> Self {
        Self::begin_in(arguments, &[("TERM", "xterm")])
    }

    /// Starts the program with these arguments and variables at a new terminal.
    fn begin_in(arguments: &[&str], variables: &[(&str, &str)]) -> Self {
        let master =
            openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let path = ptsname(&master, Vec::new()).unwrap().into_string().unwrap();
        let terminal = OpenOptions::new().read(true).write(true).open(path).unwrap();
        let size = Winsize { ws_row: 24, ws_col: 80, ws_xpixel: 0, ws_ypixel: 0 };
        tcsetwinsize(&terminal, size).unwrap();
        let before = tcgetattr(&terminal).unwrap();
        let end = || Stdio::from(terminal.try_clone().unwrap());
        let mut call = program();
        call.env_remove("NO_COLOR").env_remove("CLICOLOR_FORCE").env_remove("RUST_LOG");
        call.envs(variables.iter().copied()).args(arguments);
        let child = call.stdin(end()).stdout(end()).stderr(end()).spawn().unwrap();
        let keys = File::from(master);
        let output = Arc::new(Mutex::new(Vec::new()));
        let (mut far, sink) = (keys.try_clone().unwrap(), Arc::clone(&output));
        let listening = Arc::new(AtomicBool::new(true));
        let still_listening = Arc::clone(&listening);
        std::thread::spawn(move || {
            let mut bytes = [0; 4096];
            while still_listening.load(Ordering::Acquire)
                && let Ok(count) = far.read(&mut bytes)
            {
                sink.lock().unwrap().extend_from_slice(&bytes[..count]);
            }
        });
        Self { child, keys, terminal, before, output, listening }
    }

    /// Returns all text that the program has written to the terminal until now, without the escape
    /// sequences.
    fn output(&self) -> String {
        let text = String::from_utf8_lossy(&self.output.lock().unwrap()).into_owned();
        let mut pieces = text.split('\u{1b}');
        let mut letters = pieces.next().unwrap_or_default().to_owned();
        for piece in pieces {
            let rest =
                piece.find(|c: char| c.is_ascii_alphabetic()).map_or("", |at| &piece[at + 1..]);
            letters.push_str(rest);
        }
        letters
    }

    /// Returns all that the program has written to the terminal until now.
    fn bytes(&self) -> String {
        String::from_utf8_lossy(&self.output.lock().unwrap()).into_owned()
    }

    /// Returns the 24 lines that the terminal shows: a cell keeps its letter until another one is
    /// written there.
    fn screen(&self) -> String {
        let text = String::from_utf8_lossy(&self.output.lock().unwrap()).into_owned();
        let mut cells = vec![vec![' '; 80]; 24];
        let (mut row, mut column) = (0, 0);
        let mut letters = text.chars();
        while let Some(letter) = letters.next() {
            if letter != '\u{1b}' {
                match letter {
                    '\r' => column = 0,
                    '\n' => row += 1,
                    _ => {
                        if let Some(cell) = cells.get_mut(row).and_then(|r| r.get_mut(column)) {
                            *cell = letter;
                        }
                        column += 1;
                    }
                }
                continue;
            }
            let mut numbers = String::new();
            let kind = letters.by_ref().find(|c| {
                numbers.push(*c);
                c.is_ascii_alphabetic()
            });
            let numbers = numbers.trim_matches(|c: char| !c.is_ascii_digit());
            let mut numbers =
                numbers.split(';').map(|n| n.parse::<usize>().unwrap_or(1).saturating_sub(1));
            match kind {
                Some('H') => {
                    row = numbers.next().unwrap_or(0);
                    column = numbers.next().unwrap_or(0);
                }
                Some('J') => cells.iter_mut().for_each(|row| row.fill(' ')),
                _ => {}
            }
        }
        cells.into_iter().map(|row| String::from_iter(row) + "\n").collect()
    }

    /// Waits until the program shows these words or has shown them. With `SHOW` in the environment
    /// the screen is printed.
    fn until(&self, words: &str) {
        let begun = Instant::now();
        while !self.screen().contains(words) && !self.output().contains(words) {
            assert!(begun.elapsed() < PATIENCE, "no `{words}` in {}", self.screen());
            std::thread::sleep(Duration::from_millis(20));
        }
        if std::env::var_os("SHOW").is_some() {
            println!("{}", self.screen());
        }
    }

    /// Waits until the screen of a replay shows a time (s) that is `wanted`, and returns it.
    fn until_time(&self, wanted: impl Fn(f64) -> bool) -> f64 {
        let begun = Instant::now();
        loop {
            let screen = self.screen();
            // The progress reads `12.5 of 90.0 s`, after the blocks of a bar.
            let before = screen.split_once(" of 90.0 s").map(|(before, _)| before);
            let digits = before.and_then(|text| text.rsplit(|c| !"0123456789.".contains(c)).next());
            let time = digits.and_then(|digits| digits.parse::<f64>().ok());
            if let Some(time) = time.filter(|time| wanted(*time)) {
                return time;
            }
            assert!(begun.elapsed() < PATIENCE, "{time:?} s in {screen}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Types these bytes.
    fn press(&mut self, keys: &[u8]) {
        self.keys.write_all(keys).unwrap();
    }

    /// Waits until the program ends and checks that the terminal is as it was. Returns the exit
    /// code.
    fn ends(&mut self) -> Option<i32> {
        let begun = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                break status;
            }
            assert!(begun.elapsed() < PATIENCE, "it does not end: {}", self.output());
            std::thread::sleep(Duration::from_millis(20));
        };
        let after = tcgetattr(&self.terminal).unwrap();
        assert_eq!(after.local_modes, self.before.local_modes, "not raw any more");
        assert!(after.local_modes.contains(LocalModes::ICANON | LocalModes::ECHO));
        // The thread that reads the output may be behind the end of the program.
        let of = |sequence: &[u8]| {
            let output = self.output.lock().unwrap();
            output.windows(sequence.len()).filter(|w| *w == sequence).count()
        };
        let is_back = || of(b"\x1b[?1049h") == of(b"\x1b[?1049l");
        while !is_back() && begun.elapsed() < PATIENCE {
            std::thread::sleep(Duration::from_millis(20));
        }
        assert!(is_back(), "back from the alternate screen");
        status.code()
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        // The program still runs only if the test has failed.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Returns the path of a temporary file with this name.
fn place(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("terminal");
    std::fs::create_dir_all(&folder).unwrap();
    folder.join(name)
}

/// Records this many seconds of the idle task and returns the path of the recording.
fn recording(name: &str, seconds: u32) -> PathBuf {
    let (path, time) = (place(name), format!("idle.time_s={seconds}"));
    let done = program()
        .args(["run", "scenarios/idle.toml", "--json", "--set", &time, "--record"])
        .arg(&path)
        .output()
        .unwrap();
    assert!(done.status.success());
    path
}

#[test]
fn run_that_cannot_start_shows_the_reason() {
    let arguments = ["run", "scenarios/idle.toml", "--ui", "tui", "--journal", "/nowhere/journal"];
    let mut session = Session::begin(&arguments);

    session.until("/nowhere/journal");
    session.until("q leave");
    session.press(b"q");

    assert_eq!(session.ends(), Some(4), "{}", session.output());
}

/// Run of the idle task for two seconds in real time, without another UI.
const SLOW: [&str; 8] =
    ["run", "scenarios/idle.toml", "--ui", "none", "--speed", "1", "--set", "idle.time_s=2"];

#[test]
fn live_line_is_drawn_and_erased_on_terminal() {
    let mut session = Session::begin(&SLOW);

    assert_eq!(session.ends(), Some(0), "{}", session.output());
    session.until("DONE");
    let bytes = session.bytes();
    let drawings: Vec<&str> = bytes.split("\r\u{1b}[K").skip(1).collect();
    let times = drawings.iter().filter(|text| text.contains(" s  idle") && text.contains(" N"));
    let count = times.count();
    assert!((3..=20).contains(&count), "{count} drawings in {bytes:?}");
    // The line is erased before the summary, and is not a line of its own.
    let summary = drawings.iter().position(|text| text.contains("phase")).unwrap();
    assert_eq!(summary, drawings.len() - 1, "{bytes:?}");
    assert!(drawings[summary].contains("\u{1b}[32mDONE"), "{bytes:?}");
    assert!(drawings[..summary].iter().all(|text| text.chars().count() < 80), "{bytes:?}");
}

#[test]
fn dumb_terminal_has_no_live_line() {
    let mut session = Session::begin_in(&SLOW, &[("TERM", "dumb")]);

    assert_eq!(session.ends(), Some(0), "{}", session.output());
    session.until("DONE");
    assert!(!session.bytes().contains('\u{1b}'), "{:?}", session.bytes());
}

#[test]
fn live_line_without_colours_is_drawn() {
    let mut session = Session::begin_in(&SLOW, &[("TERM", "xterm"), ("NO_COLOR", "1")]);

    assert_eq!(session.ends(), Some(0), "{}", session.output());
    session.until("DONE");
    let bytes = session.bytes();
    assert!(bytes.contains("\r\u{1b}[K") && bytes.contains(" s  idle"), "{bytes:?}");
    assert!(!bytes.contains("\u{1b}[3"), "{bytes:?}");
}

#[test]
fn keys_start_pause_and_terminate_a_run() {
    let arguments = ["run", "scenarios/idle.toml", "--ui", "tui", "--wait"];
    let mut session = Session::begin(&arguments);

    session.until("waits for start");
    session.press(b"s");
    session.until("by hand");
    session.press(b"p");
    session.until("paused");
    session.press(b"r");
    session.press(b"t");
    session.until("hold what they hold?");
    session.press(b"y");
    session.until("the end");
    session.press(b"q");

    assert_eq!(session.ends(), Some(0), "{}", session.output());
}

#[test]
fn signal_ends_the_run_and_restores_the_terminal() {
    let mut session = Session::begin(&["run", "scenarios/idle.toml", "--ui", "tui"]);
    session.until("by hand");

    let pid = session.child.id().to_string();
    assert!(Command::new("kill").args(["-TERM", &pid]).status().unwrap().success());

    assert_eq!(session.ends(), Some(0), "{}", session.output());
    session.until("the arms were moved by hand until the operator ended the run");
}

/// The signal ends the run as an operator does: its recording is whole.
#[test]
fn hangup_signal_ends_run_after_terminal_is_closed() {
    let record = place("hangup.mcap");
    let run = ["run", "scenarios/idle.toml", "--ui", "tui", "--record"];
    let mut session = Session::begin(&[&run[..], &[record.to_str().unwrap()]].concat());
    session.until("by hand");
    // Close both ends, as when a connection breaks. The program keeps its own handles.
    let null = || OpenOptions::new().read(true).write(true).open("/dev/null").unwrap();
    session.listening.store(false, Ordering::Release);
    (session.keys, session.terminal) = (null(), null());
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!(session.child.try_wait().unwrap(), None, "it ends before the signal");

    let pid = session.child.id().to_string();
    // Programs under nohup ignore SIGHUP.
    let signal = if hang_up_is_ignored() { "-TERM" } else { "-HUP" };
    assert!(Command::new("kill").args([signal, &pid]).status().unwrap().success());

    let begun = Instant::now();
    let status = loop {
        if let Some(status) = session.child.try_wait().unwrap() {
            break status;
        }
        assert!(begun.elapsed() < PATIENCE, "it does not end");
        std::thread::sleep(Duration::from_millis(20));
    };
    // It ends by itself, but its results cannot be written.
    assert_eq!(status.code(), Some(4), "{status}");
    let mut reading = open(&record).unwrap();
    let mut label = Label::default();
    reading.by_ref().for_each(|piece| label.take(&piece));
    assert_eq!(reading.end(), Some(&End::Whole));
    let summary: serde_json::Value = serde_json::from_str(label.of("summary", "json")).unwrap();
    assert_eq!(summary["ended_by"], "interrupt", "{summary}");
}

#[test]
fn emergency_stop_works_during_a_terminate_prompt() {
    let mut session = Session::begin(&["run", "scenarios/idle.toml", "--ui", "tui"]);
    session.until("by hand");
    session.press(b"t");
    session.until("hold what they hold?");

    session.press(b"e");

    session.until("postument stopped: emergency");
    session.until("q leave");
    session.press(b"q");
    assert_eq!(session.ends(), Some(3), "{}", session.output());
}

#[test]
fn unwritable_recording_exits_with_2_and_unchanged_terminal() {
    let mut session = Session::begin(&[
        "run",
        "scenarios/idle.toml",
        "--ui",
        "tui",
        "--record",
        "/nowhere/run.mcap",
    ]);

    assert_eq!(session.ends(), Some(2));
    session.until("--record: /nowhere/run.mcap");
}

#[test]
fn tui_without_a_terminal_is_refused() {
    let (path, before) = (recording("no_terminal.mcap", 2), place("no_terminal_run.mcap"));
    let _ = std::fs::remove_file(&before);
    let (replay, record) = (path.to_str().unwrap(), before.to_str().unwrap());
    for arguments in [
        vec!["run", "scenarios/idle.toml", "--ui", "tui", "--json", "--record", record],
        vec!["replay", replay, "--ui", "tui"],
    ] {
        let mut child = program()
            .args(&arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let begun = Instant::now();
        while child.try_wait().unwrap().is_none() {
            if begun.elapsed() > PATIENCE {
                child.kill().unwrap();
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        let output = child.wait_with_output().unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {stderr}");
        assert!(stderr.contains("--ui tui"), "{arguments:?}: {stderr}");
    }
    assert!(!before.exists(), "no run was begun");
}

/// The replay would take longer than the patience to reach its end by itself.
#[test]
fn replay_accepts_seek_quit_and_ctrl_c() {
    let path = recording("replay.mcap", 90);
    let replay = ["replay", path.to_str().unwrap(), "--ui", "tui"];

    let mut at_end = Session::begin(&replay);
    at_end.until("Left Right");
    // End seeks the end.
    at_end.press(b"\x1b[F");
    at_end.until("done");
    // Home seeks the beginning, and the replay continues from there.
    at_end.press(b"\x1b[H");
    at_end.until_time(|time| (0.1..60.0).contains(&time));
    at_end.press(b"p");
    at_end.until("paused");
    // An arrow key seeks by 10 s, also in a pause.
    let held = at_end.until_time(|_| true);
    at_end.press(b"\x1b[C");
    at_end.until_time(|time| (time - held - 10.0).abs() < 0.5);
    at_end.press(b"q");
    assert_eq!(at_end.ends(), Some(0), "{}", at_end.output());

    let mut before = Session::begin(&replay);
    before.until("Left Right");
    // Ctrl-C.
    before.press(b"\x03");
    assert_eq!(before.ends(), Some(0), "{}", before.output());
}
