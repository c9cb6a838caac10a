//! Whether a page and a recorder at a real-time run change how punctual the servo is: the program itself, both arms at
//! 500 Hz while the stand-alone camera looks for the cube 25 times a second, alone and with each of them.
//!
//! Rounds take turns, so that what passes on the machine hits all kinds alike; a round begins with another kind than the one
//! before. Figures are medians over the rounds of what the servo's own histograms tell. The page is a client that reads
//! every snapshot, as a browser does that runs elsewhere; a browser on the same cores is a load of its own.
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

/// What is attached to a run, and what its rounds came to.
struct Kind {
    name: &'static str,
    page: bool,
    recorder: bool,
    /// In their order; `None` where one failed.
    rounds: Vec<Option<Round>>,
}

impl Kind {
    fn told(&self) -> impl Iterator<Item = &Round> {
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
    /// Snapshots that the page got, a second.
    snapshots: f64,
}

#[derive(Clone, Copy, Default)]
struct Quantiles {
    p50: f64,
    p99: f64,
    max: f64,
}

fn option(name: &str, otherwise: f64) -> f64 {
    let found =
        std::env::args().find_map(|arg| arg.strip_prefix(&format!("--{name}="))?.parse().ok());
    found.unwrap_or(otherwise)
}

fn main() {
    if !rig::is_meant("watched") {
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
            let told = run(kind, seconds, &file);
            if let Err(why) = &told {
                eprintln!("{}: a round is left out: {why}", kind.name);
            }
            kind.rounds.push(told.ok());
        }
    }
    // It was a file of this bench alone; perhaps no round made it.
    let _ = std::fs::remove_file(&file);
    report(&kinds, seconds);
}

/// The scenario of all rounds.
fn scenario() -> String {
    let named = std::env::args().find_map(|arg| Some(arg.strip_prefix("--scenario=")?.to_owned()));
    named.unwrap_or_else(|| "scenarios/acquire.toml".to_owned())
}

/// One run, interrupted after so many seconds, and what its servo told of itself.
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
    let told = |e: std::io::Error| e.to_string();
    let mut child = command
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(told)?;
    let pid = Pid::from_child(&child);
    let mut lines = BufReader::new(child.stderr.take().ok_or("no stderr")?).lines();
    let mut round = Round::default();
    let (mut watched, mut begun) = (None, false);
    for line in lines.by_ref().map_while(Result::ok) {
        if let Some((_, url)) = line.split_once("the operator's page: ") {
            let address = url.replace("http://", "ws://") + "ws";
            watched = Some(std::thread::spawn(move || watch(&address)));
        }
        // The first phase begins with the servo: "     0.00 s  acquire".
        let is_phase = line.trim_start().starts_with(|c: char| c.is_ascii_digit());
        if !begun && is_phase && line.contains(" s  ") {
            begun = true;
            std::thread::spawn(move || {
                std::thread::sleep(Duration::from_secs_f64(seconds));
                // A run that has ended by itself hears nothing.
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
    child.wait().map_err(told)?;
    if let Some(watched) = watched {
        round.snapshots = watched.join().map_err(|_| "the page's thread died")?? / seconds;
    }
    if round.wake_up.p99 > 0.0 { Ok(round) } else { Err("the servo told nothing".to_owned()) }
}

/// Reads all that a page gets until the run ends; how many snapshots came.
fn watch(address: &str) -> Result<f64, String> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    runtime.map_err(|e| e.to_string())?.block_on(async {
        let (mut page, _) = connect_async(address).await.map_err(|e| e.to_string())?;
        let mut count = 0.0;
        while let Some(Ok(message)) = page.next().await {
            let Message::Text(text) = message else { continue };
            // A browser parses them.
            let value: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
            count += f64::from(value["snapshot"]["time"].as_f64().is_some_and(|time| time > 0.0));
            if value["snapshot"]["control"] == "ended" {
                break;
            }
        }
        Ok(count)
    })
}

/// `p50 1.0 us, p99 2.0 us, ..., max 9.0 us, 500 periods`.
fn quantiles(text: &str) -> Quantiles {
    let of = |name: &str| {
        let found = text.split(", ").find_map(|part| part.strip_prefix(name));
        found.map_or(f64::NAN, |rest| number(rest.trim()))
    };
    Quantiles { p50: of("p50 "), p99: of("p99 "), max: of("max ") }
}

fn number(text: &str) -> f64 {
    text.split_whitespace().next().and_then(|n| n.parse().ok()).unwrap_or(f64::NAN)
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Median over the rounds of one value against that of the run alone in the same round.
fn ratio(kind: &Kind, alone: &Kind, of: impl Fn(&Round) -> f64) -> f64 {
    let pairs = kind.rounds.iter().zip(&alone.rounds);
    median(pairs.filter_map(|(with, without)| Some(of(with.as_ref()?) / of(without.as_ref()?))))
}

fn report(kinds: &[Kind; 4], seconds: f64) {
    let alone = &kinds[0];
    if rig::json() {
        let fields: Vec<(String, Option<f64>)> = kinds
            .iter()
            .flat_map(|kind| {
                let name = kind.name.replace(' ', "_");
                let of = |f: fn(&Round) -> f64| Some(median(kind.told().map(f)));
                [
                    (format!("{name}_wake_up_p99_us"), of(|r| r.wake_up.p99)),
                    (format!("{name}_jitter_p99_us"), of(|r| r.jitter.p99)),
                    (format!("{name}_work_p99_us"), of(|r| r.work.p99)),
                    (format!("{name}_missed"), Some(kind.told().map(|r| r.missed).sum())),
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
        "watched: {}, both arms at 500 Hz, {} rounds of {seconds} s each, medians over the rounds, us",
        scenario(),
        alone.told().count()
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
        let of = |f: fn(&Round) -> f64| median(kind.told().map(f));
        println!(
            "{:18} {:9.1} {:9.1} {:10.1} {:11.1} {:9.1} {:9.1} {:7.0} {:9.2} {:9.1}",
            kind.name,
            of(|r| r.wake_up.p50),
            of(|r| r.wake_up.p99),
            of(|r| r.wake_up.max),
            of(|r| r.jitter.p99),
            of(|r| r.work.p50),
            of(|r| r.work.p99),
            kind.told().map(|r| r.missed).sum::<f64>(),
            ratio(kind, alone, |r| r.wake_up.p99),
            of(|r| r.snapshots),
        );
    }
    println!("p99 ratio: to the run alone of the same round, median");
}
