//! `rubik-robot run`: perform a scenario, then say what it came to.

use super::output::Output;
use super::{ScenarioArgs, WRONG, complain, record};
use crate::actors::{self, Around, RunOptions};
use crate::error::Error;
use crate::record::recorder::Recorder;
use crate::record::summary::{EndedBy, Summary};
use crate::scenario::Override;
use crate::scenario::keys::Pace;
use clap::{Args, ValueEnum};
use std::io::IsTerminal;
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot run scenarios/solve.toml
  rubik-robot run scenarios/solve.toml --seed 7 --set coordination=continuous
  rubik-robot run scenarios/solve.toml --cube UUUUUUUUURRRRRRRRRFFFFFFFFFDDDDDDDDDLLLLLLLLLBBBBBBBBB
  rubik-robot run scenarios/solve.toml --pace real-time
  rubik-robot run scenarios/idle.toml --pace real-time --require-rt
  rubik-robot run scenarios/face_turn.toml --set control.force_sign=-1     a spoilt controller
  rubik-robot run scenarios/solve.toml --json | tail -1
  rubik-robot run scenarios/solve.toml --record run.mcap      then: report run.mcap, replay run.mcap

Progress goes to stderr, the summary to stdout. With --json the last line of stdout is one object.")]
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
    /// Wait for the operator's start (s, Enter)
    #[arg(long)]
    wait: bool,
    /// Start by itself, ask nothing, and end stdout with one line of JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum PaceWord {
    /// As fast as it computes, repeatable to the bit
    Virtual,
    /// The wall clock
    RealTime,
}

/// Returns the exit code.
pub(super) fn run(args: &RunArgs, output: &mut Output) -> anyhow::Result<u8> {
    let mut more = Vec::new();
    if let Some(seed) = &args.seed {
        more.push(Override::option("--seed", "seed", seed));
    }
    if let Some(cube) = &args.cube {
        more.push(Override::option("--cube", "cube.state", cube));
    }
    if let Some(pace) = args.pace {
        let word = match pace {
            PaceWord::Virtual => "virtual",
            PaceWord::RealTime => "real-time",
        };
        more.push(Override::option("--pace", "pace", word));
    }
    let scenario = match args.scenario.load(&more) {
        Ok(scenario) => scenario,
        Err(faults) => {
            complain(&faults);
            return Ok(WRONG);
        }
    };
    if args.require_rt && scenario.pace != Pace::RealTime {
        complain("--require-rt: the pace is virtual; add --pace real-time");
        return Ok(WRONG);
    }
    let options = RunOptions {
        require_real_time: args.require_rt,
        automatic: args.json || !(args.wait || std::io::stdin().is_terminal()),
        wait: args.wait && !args.json,
        quiet: false,
        interruptible: true,
        speed: 0.0,
    };
    let recorder = match &args.record {
        None => Recorder::default(),
        Some(path) => {
            let overrides: Vec<_> = args.scenario.overrides().into_iter().chain(more).collect();
            match record::begin(path, &scenario, &overrides, false) {
                Ok(recorder) => recorder,
                Err(error) => {
                    complain(&format!("--record: {}: {error}", path.display()));
                    return Ok(WRONG);
                }
            }
        }
    };
    let around = Around { recorder: recorder.clone(), ..Around::default() };
    let done = actors::run_with(&scenario, options, around);
    if let (Some(written), Some(path)) = (recorder.finish(), &args.record) {
        complain(&record::told(path, &written));
    }
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
            let ended_by = match error {
                Error::NonFatal { .. } => EndedBy::Task,
                Error::Fatal { .. } => EndedBy::Fatal,
                Error::System { .. } => EndedBy::System,
            };
            let truth = (!scenario.bridge.kind.is_hardware()).then(|| scenario.cube().to_string());
            let summary = Summary::not_started(
                scenario.controller.task.word(),
                scenario.seed,
                truth.as_deref(),
                &error.to_string(),
                ended_by,
            );
            if args.json {
                output.line(&summary.json())?;
            }
            Ok(summary.exit_code())
        }
    }
}
