//! `rubik-robot run`: perform a scenario, then say what it came to.

use super::arguments::ScenarioArgs;
use super::output::{Output, clash, complain, refuse};
use super::record;
use super::ui::{Ui, UiArgs};
use crate::actors::control::is_speed;
use crate::desk::Desk;
use crate::error::{Error, NonFatal};
use crate::record::place::Place;
use crate::record::recorder::Recorder;
use crate::record::summary::{EndedBy, Summary};
use crate::run::{self, RunContext, RunOptions, SavedFiles};
use crate::scenario::keys::{BridgeKind, Pace, Task};
use crate::scenario::{Override, Scenario};
use crate::tui;
use anyhow::Context;
use clap::{Args, ValueEnum};
use rustix::process::{Signal, set_parent_process_death_signal};
use std::path::PathBuf;

/// Exit code of a system's error.
const STUCK: i32 = 4;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot run scenarios/solve.toml
  rubik-robot run scenarios/solve.toml --seed 7 --set coordination=continuous
  rubik-robot run scenarios/solve.toml --cube UUUUUUUUURRRRRRRRRFFFFFFFFFDDDDDDDDDLLLLLLLLLBBBBBBBBB
  rubik-robot run scenarios/solve.toml --pace real-time
  rubik-robot run scenarios/idle.toml --pace real-time --require-rt
  rubik-robot run scenarios/face_turn.toml --set control.force_sign=-1     a spoilt controller
  rubik-robot run scenarios/solve.toml --ui web --wait --speed 5           watch it in a browser
  rubik-robot run scenarios/idle.toml --ui web        move an arm by hand
  rubik-robot run scenarios/solve.toml --json | tail -1
  rubik-robot run scenarios/solve.toml --world cell.json      cut it off, then the same with --resume
  rubik-robot run scenarios/solve.toml --record run.mcap      then: report run.mcap, replay run.mcap

Progress goes to stderr, the summary to stdout. With --json the last line of stdout is one object.
At a terminal the operator's page is served at http://127.0.0.1:8780/, and stays up when the run is over;
--ui tui shows the run in the terminal instead, --ui none does neither.
With a UI the idle task waits for orders by hand until its operator ends it, which is its good end (exit code 0).")]
#[allow(
    clippy::struct_excessive_bools,
    reason = "switches of the command line, independent of each other"
)]
pub(super) struct RunArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Seed of everything random in the plant: cube, hand, errors, noise
    #[arg(long, value_name = "N")]
    seed: Option<String>,
    /// The cube's state: 54 letters URFDLB, each face in reading order
    #[arg(long, value_name = "FACELETS")]
    cube: Option<String>,
    /// Which clock drives the run
    #[arg(long, value_enum)]
    pace: Option<PaceWord>,
    /// Refuse to run unless every real-time right is granted (with --pace real-time)
    #[arg(long)]
    require_rt: bool,
    /// Keep the run in an MCAP file, which ROS 2 tools, rerun and `rubik-robot replay` read
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    #[command(flatten)]
    keep: KeepArgs,
    /// Wait for the operator's start (the page's button; s, Enter)
    #[arg(long)]
    wait: bool,
    /// Under virtual time: how fast time may go, in times of real time; 0 for as fast as it
    /// computes
    #[arg(long, value_name = "FACTOR", default_value_t = 0.0)]
    speed: f64,
    #[command(flatten)]
    ui: UiArgs,
    /// Start by itself, ask nothing, and end stdout with one line of JSON
    #[arg(long)]
    json: bool,
    /// End when whoever started this does, however that ends: for campaigns
    #[arg(long, hide = true)]
    with_parent: bool,
}

/// Files that outlive the run.
#[derive(Debug, Args)]
struct KeepArgs {
    /// Note in this file what a run that goes on after a crash must know [with --world: beside
    /// that]; refused without --resume while it tells of a run that was broken off
    #[arg(long, value_name = "FILE")]
    journal: Option<PathBuf>,
    /// The simulated plant keeps its state in this file, as a real cell stays where it is;
    /// FILE.lock beside it, which stays, lets no other run do so meanwhile
    #[arg(long, value_name = "FILE")]
    world: Option<PathBuf>,
    /// Go on where the run that left --journal (and --world) was broken off
    #[arg(long)]
    resume: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum PaceWord {
    /// As fast as it computes, repeatable to the bit
    Virtual,
    /// The wall clock
    RealTime,
}

/// Performs the run and prints its summary; returns the exit code.
pub(super) fn run(args: &RunArgs, output: &mut Output) -> anyhow::Result<u8> {
    if args.with_parent {
        set_parent_process_death_signal(Some(Signal::TERM)).context("--with-parent")?;
    }
    let more = args.overrides();
    let scenario = args.scenario.load(&more).map_err(refuse)?;
    args.check(&scenario)?;
    let keep = keep(&args.keep, scenario.bridge.kind, scenario.controller.task).map_err(refuse)?;
    overwritten(args, &keep)?;

    let desk = Desk::default();
    let kind = args.ui.kind(args.json);
    // A refusal from here on is printed when the UI is closed: in the terminal as it was.
    let ui = args.ui.open(kind, desk.ui_end()).map_err(|error| refuse(format!("{error:#}")))?;
    let has_ui = !matches!(ui, Ui::None);
    let recorder = args.recorder(&scenario, more, has_ui)?;
    let context = RunContext {
        desk: has_ui.then(|| desk.run_end()),
        recorder: recorder.clone(),
        saved: keep,
        ..RunContext::default()
    };
    let done = run::run_with(&scenario, args.options(&ui), context);
    let written = recorder.finish();

    // A terminal is put back as it was before anything is printed on it.
    let (ui, shown) =
        if ui.has_terminal() { (Ui::None, ui.linger(&desk.run_end())) } else { (ui, Ok(())) };
    if let (Some(written), Some(path)) = (written, &args.record) {
        complain(&record::told(path, &written));
    }
    let leaves = is_interrupted(&done);
    let code = told(done, &scenario, args, output)?;
    output.flush()?;
    if let Err(error) = shown {
        // A UI that failed changes neither the summary nor the exit code.
        complain(&format!("{error:#}"));
    }
    if !args.json && !leaves {
        ui.linger(&desk.run_end())?;
    }
    Ok(code)
}

impl RunArgs {
    /// Returns the overrides of the options that stand for a key.
    fn overrides(&self) -> Vec<Override> {
        let pace = self.pace.map(|pace| match pace {
            PaceWord::Virtual => "virtual",
            PaceWord::RealTime => "real-time",
        });
        [
            ("--seed", "seed", self.seed.as_deref()),
            ("--cube", "cube.state", self.cube.as_deref()),
            ("--pace", "pace", pace),
        ]
        .into_iter()
        .filter_map(|(option, key, value)| Some(Override::option(option, key, value?)))
        .collect()
    }

    /// Checks that the options agree with the scenario and with each other.
    fn check(&self, scenario: &Scenario) -> anyhow::Result<()> {
        if self.require_rt && scenario.pace != Pace::RealTime {
            return Err(refuse("--require-rt: the pace is virtual; add --pace real-time"));
        }
        if !is_speed(self.speed) {
            let reason = "a factor of 0.01 or more such as 5, or 0 for as fast as it computes";
            return Err(refuse(format!("--speed: {reason}")));
        }
        match self.record.as_ref().filter(|path| self.keep.resume && path.is_file()) {
            Some(path) => Err(refuse(format!(
                "--record: {} is there already, perhaps of the run that was broken off, and is \
                 kept: name another file",
                path.display()
            ))),
            None => Ok(()),
        }
    }

    /// Begins the recording, if one is wanted.
    fn recorder(
        &self,
        scenario: &Scenario,
        more: Vec<Override>,
        attended: bool,
    ) -> anyhow::Result<Recorder> {
        let Some(path) = &self.record else { return Ok(Recorder::default()) };
        let file = Place::create(path)
            .map_err(|error| refuse(format!("--record: {}: {error}", path.display())))?;
        let overrides: Vec<_> = self.scenario.overrides().into_iter().chain(more).collect();
        let begun = record::Begun { attended, resumed: self.keep.resume };
        record::begin(file, scenario, &overrides, begun).context("--record")
    }

    fn options(&self, ui: &Ui) -> RunOptions {
        let has_ui = !matches!(ui, Ui::None);
        RunOptions {
            require_real_time: self.require_rt,
            // Words on stdin are read from a pipe, too; under --json no person is there to say any.
            automatic: self.json || ui.has_terminal(),
            wait: self.wait && (has_ui || !self.json),
            quiet: ui.has_terminal(),
            interruptible: true,
            speed: self.speed,
            stuck: Some(if ui.has_terminal() { ends_on_a_terminal } else { ends }),
        }
    }
}

/// Checks whether an interrupt ended the run: the operator wants to leave the program.
fn is_interrupted(done: &Result<Summary, Error>) -> bool {
    match done {
        Ok(summary) => summary.ended_by == EndedBy::Interrupt,
        Err(error) => matches!(error, Error::NonFatal { cause: NonFatal::Interrupted, .. }),
    }
}

/// Ends the program when an actor lets no other one get on: nobody else can.
#[allow(clippy::needless_pass_by_value, reason = "whoever tells has no use for it any more")]
fn ends(error: Error) {
    complain(&format!(
        "{error}; the drives were told to switch off, and the program is ended as it is"
    ));
    std::process::exit(STUCK);
}

fn ends_on_a_terminal(error: Error) {
    tui::put_back();
    ends(error);
}

/// Returns the files that outlive the run, or why they cannot be.
fn keep(args: &KeepArgs, bridge: BridgeKind, task: Task) -> Result<SavedFiles, &'static str> {
    if args.world.is_some() && bridge.is_hardware() {
        return Err(
            "--world: hardware keeps its state itself; only a simulated plant needs a file",
        );
    }
    let beside = |world: &PathBuf| {
        let mut path = world.clone().into_os_string();
        path.push(".journal");
        PathBuf::from(path)
    };
    let journal = args.journal.clone().or_else(|| args.world.as_ref().map(beside));
    if args.resume && journal.is_none() {
        return Err("--resume: name the --journal of the run that was broken off");
    }
    if args.resume && args.world.is_none() && !bridge.is_hardware() {
        return Err("--resume: name the --world of the run that was broken off, too");
    }
    if args.resume && task != Task::Solve {
        return Err("--resume: only the task solve can go on");
    }
    Ok(SavedFiles { world: args.world.clone(), journal, resume: args.resume })
}

/// Checks that the run would write over neither its scenario nor one of its own files, nor over the
/// files beside these.
fn overwritten(args: &RunArgs, keep: &SavedFiles) -> anyhow::Result<()> {
    let beside = |path: &Option<PathBuf>, end: &str| {
        path.as_ref().map(|path| {
            let mut path = path.clone().into_os_string();
            path.push(end);
            PathBuf::from(path)
        })
    };
    let (lock, new) = (beside(&keep.world, ".lock"), beside(&keep.world, ".new"));
    let part = beside(&args.record, ".part");
    clash(
        &[("the scenario", Some(&args.scenario.scenario))],
        &[
            ("--record", args.record.as_ref()),
            ("--record's beginning", part.as_ref()),
            ("--journal", keep.journal.as_ref()),
            ("--world", keep.world.as_ref()),
            ("--world's lock", lock.as_ref()),
            ("--world's next state", new.as_ref()),
        ],
    )
}

/// Says what a run came to; returns the exit code.
fn told(
    done: Result<Summary, Error>,
    scenario: &Scenario,
    args: &RunArgs,
    output: &mut Output,
) -> anyhow::Result<u8> {
    match done {
        Ok(summary) => {
            if args.json {
                output.line(&summary.json())?;
            } else {
                output.text(&summary.table())?;
            }
            Ok(summary.exit_code())
        }
        Err(error) => {
            complain(&error.to_string());
            let summary = run::not_begun(scenario, &error);
            if args.json {
                output.line(&summary.json())?;
            }
            Ok(summary.exit_code())
        }
    }
}
