//! Effect of an operator's page and of a recorder on the lateness of the servo in a real-time run.
//!
//! The bench runs the program itself, with both arms at 500 Hz while the stand-alone camera
//! searches for the cube 25 times a second: alone, with a page, with a recorder, and with both.
//!
//! The kinds of run alternate, so that a passing disturbance of the machine affects all of them,
//! and each round begins with another kind. Figures are values of the servo's own histograms, as
//! medians over the rounds. The page is a client that reads each snapshot, as a browser on
//! another machine does; a browser on the same cores is a load of its own.
//!
//! - `-- --rounds=N` (8), `-- --seconds=S` (4), `-- --json`: one line for a program
//! - `-- --scenario=FILE` (`scenarios/acquire.toml`); `scenarios/endless.toml` has no cameras

use futures_util::StreamExt;
use rustix::process::{Pid, Signal, kill_process};
use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::time::Duration;
use tokio_tungstenite::connect_async;
use tokio_tungstenite::tungstenite::Message;

mod rig;

/// Kind of run, with the results of its rounds.
struct Kind {
    name: &'static str,
    page: bool,
    recorder: bool,
    /// Results in the order of the rounds; `None` if one failed.
    rounds: Vec<Option<Round>>,
}

impl Kind {
    /// Returns the results of the rounds that did not fail.
    fn completed(&self) -> impl Iterator<Item = &Round> {
        self.rounds.iter().flatten()
    }
}

/// Figures that the servo reports at the end of a round (us).
#[derive(Clone, Copy, Default)]
struct Round {
    wake_up: Quantiles,
    jitter: Quantiles,
    work: Quantiles,
    missed: f64,
    /// Rate of the snapshots that the page got (1/s).
    snapshots: f64,
}

/// Quantiles of a histogram of times (us).
#[derive(Clone, Copy, Default)]
struct Quantiles {
    p50: f64,
    p99: f64,
    max: f64,
}

/// Returns the number of the option `--name=NUMBER`, or `otherwise` if the option is not given.
fn option(name: &str, otherwise: f64) -> f64 {
    let found =
        std::env::args().find_map(|arg| arg.strip_prefix(&format!("--{name}="))?.parse().ok());
    found.unwrap_or(otherwise)
}

/// Runs all rounds of all kinds and prints the report.
fn main() {
    if !rig::is_selected("watched") {
        return;
    }
    let (rounds, seconds) = (option("rounds", 8.0) as usize, option("seconds", 4.0));
    let kind = |name, page, recorder| Kind { name, page, recorder, rounds: Vec::new() };
    let mut kinds = [
        kind("alone", false, false),
        kind("with a page", true, false),
        kind("with a recorder", false, true),
        kind("with both", true, true),
    ];
    let file =
        std::env::temp_dir().join(format!("rubik-robot-watched-{}.mcap", std::process::id()));
    for round in 0..rounds {
        for i in 0..kinds.len() {
            let kind = &mut kinds[(round + i) % 4];
            let result = run(kind, seconds, &file);
            if let Err(why) = &result {
                eprintln!("{}: round {} is left out: {why}", kind.name, round + 1);
            }
            kind.rounds.push(result.ok());
        }
    }
    // The file belongs to this bench alone; it is absent if all rounds with a recorder failed.
    let _ = std::fs::remove_file(&file);
    report(&kinds, seconds);
}

/// Returns the path of the scenario that all rounds run: the option `--scenario`, or the default.
fn scenario() -> String {
    let named = std::env::args().find_map(|arg| Some(arg.strip_prefix("--scenario=")?.to_owned()));
    named.unwrap_or_else(|| "scenarios/acquire.toml".to_owned())
}

/// Runs the program with a page, a recorder, both or neither, as `kind` says. Interrupts it after
/// `seconds` and returns the timing figures that its servo has printed. `file` is the path of the
/// recording.
fn run(kind: &Kind, seconds: f64, file: &std::path::Path) -> Result<Round, String> {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rubik-robot"));
    command.args(["run", &scenario(), "--json", "--pace", "real-time"]);
    command.args(if kind.page {
        ["--ui", "web", "--listen", "127.0.0.1:0"].as_slice()
    } else {
        &["--ui", "none"]
    });
    if kind.recorder {
        command.arg("--record").arg(file);
    }
    let message = |e: std::io::Error| e.to_string();
    let mut child = command
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(message)?;
    let pid = Pid::from_child(&child);
    let mut lines = BufReader::new(child.stderr.take().ok_or("no stderr")?).lines();
    let mut round = Round::default();
    let (mut watched, mut begun) = (None, false);
    for line in lines.by_ref().map_while(Result::ok) {
        if let Some((_, url)) = line.split_once("the operator's page: ") {
            let address = url.replace("http://", "ws://") + "ws";
            watched = Some(std::thread::spawn(move || watch(&address)));
        }
        // The servo starts with the first phase, which prints "     0.00 s  acquire".
        let is_phase = line.trim_start().starts_with(|c: char| c.is_ascii_digit());
        if !begun && is_phase && line.contains(" s  ") {
            begun = true;
            std::thread::spawn(move || {
                std::thread::sleep(Duration::from_secs_f64(seconds));
                // The call fails if the run has ended by itself, which is no error.
                let _ = kill_process(pid, Signal::INT);
            });
        }
        let Some((_, words)) = line.split_once("servo: ") else { continue };
        match words.split_once(": ") {
            Some(("wake-up", rest)) => round.wake_up = quantiles(rest),
            Some(("jitter", rest)) => round.jitter = quantiles(rest),
            Some(("work", rest)) => round.work = quantiles(rest),
            Some(("missed", rest)) => round.missed = number(rest),
            _ => {}
        }
    }
    child.wait().map_err(message)?;
    if let Some(watched) = watched {
        round.snapshots = watched.join().map_err(|_| "the page's thread panicked")?? / seconds;
    }
    if round.wake_up.p99 > 0.0 { Ok(round) } else { Err("the servo printed no times".to_owned()) }
}

/// Connects to the WebSocket `address` as an operator's page does and reads all messages until the
/// run ends. Returns the number of snapshots received after the start of the run.
fn watch(address: &str) -> Result<f64, String> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    runtime.map_err(|e| e.to_string())?.block_on(async {
        let (mut page, _) = connect_async(address).await.map_err(|e| e.to_string())?;
        let mut count = 0.0;
        while let Some(Ok(message)) = page.next().await {
            let Message::Text(text) = message else { continue };
            // The text is parsed as in a browser: a client that only reads would be faster.
            let value: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
            count += f64::from(value["snapshot"]["time"].as_f64().is_some_and(|time| time > 0.0));
            if value["snapshot"]["control"] == "ended" {
                break;
            }
        }
        Ok(count)
    })
}

/// Returns the quantiles that a line of the form
/// `p50 1.0 us, p99 2.0 us, ..., max 9.0 us, 500 periods` contains (us); NaN for a missing one.
fn quantiles(text: &str) -> Quantiles {
    let of = |name: &str| {
        let found = text.split(", ").find_map(|part| part.strip_prefix(name));
        found.map_or(f64::NAN, |rest| number(rest.trim()))
    };
    Quantiles { p50: of("p50 "), p99: of("p99 "), max: of("max ") }
}

/// Returns the number at the beginning of a text; NaN if there is none.
fn number(text: &str) -> f64 {
    text.split_whitespace().next().and_then(|n| n.parse().ok()).unwrap_or(f64::NAN)
}

/// Returns the median of the values; NaN if there are none.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Returns by what factor a page or recorder raises a figure of the servo: the median, over the
/// rounds, of `of` in the run of `kind` divided by `of` in the run `alone` of the same round.
fn ratio(kind: &Kind, alone: &Kind, of: impl Fn(&Round) -> f64) -> f64 {
    let pairs = kind.rounds.iter().zip(&alone.rounds);
    median(pairs.filter_map(|(with, without)| Some(of(with.as_ref()?) / of(without.as_ref()?))))
}

/// Prints a table with a row for each kind of run, or one line of JSON. The first kind is the run
/// without page and recorder, `seconds` is the length of a round.
fn report(kinds: &[Kind; 4], seconds: f64) {
    let alone = &kinds[0];
    if rig::json() {
        let fields: Vec<(String, Option<f64>)> = kinds
            .iter()
            .flat_map(|kind| {
                let name = kind.name.replace(' ', "_");
                let of = |f: fn(&Round) -> f64| Some(median(kind.completed().map(f)));
                [
                    (format!("{name}_wake_up_p99_us"), of(|r| r.wake_up.p99)),
                    (format!("{name}_jitter_p99_us"), of(|r| r.jitter.p99)),
                    (format!("{name}_work_p99_us"), of(|r| r.work.p99)),
                    (format!("{name}_missed"), Some(kind.completed().map(|r| r.missed).sum())),
                    (
                        format!("{name}_wake_up_p99_ratio"),
                        Some(ratio(kind, alone, |r| r.wake_up.p99)),
                    ),
                ]
            })
            .collect();
        let fields: Vec<(&str, Option<f64>)> =
            fields.iter().map(|(n, v)| (n.as_str(), *v)).collect();
        println!("{}", rig::object(&fields));
        return;
    }
    println!(
        "watched: {}, both arms at 500 Hz, {} rounds of {seconds} s each, medians over the rounds, \
         us",
        scenario(),
        alone.completed().count()
    );
    println!(
        "{:18} {:>9} {:>9} {:>10} {:>11} {:>9} {:>9} {:>7} {:>9} {:>9}",
        "",
        "late p50",
        "late p99",
        "late max",
        "jitter p99",
        "work p50",
        "work p99",
        "missed",
        "p99 ratio",
        "snap./s"
    );
    for kind in kinds {
        let of = |f: fn(&Round) -> f64| median(kind.completed().map(f));
        println!(
            "{:18} {:9.1} {:9.1} {:10.1} {:11.1} {:9.1} {:9.1} {:7.0} {:9.2} {:9.1}",
            kind.name,
            of(|r| r.wake_up.p50),
            of(|r| r.wake_up.p99),
            of(|r| r.wake_up.max),
            of(|r| r.jitter.p99),
            of(|r| r.work.p50),
            of(|r| r.work.p99),
            kind.completed().map(|r| r.missed).sum::<f64>(),
            ratio(kind, alone, |r| r.wake_up.p99),
            of(|r| r.snapshots),
        );
    }
    println!("p99 ratio: to the run alone of the same round, median");
}
