//! `rubik-robot benchmark`: measures accuracy and speed in trials, and writes a report, the
//! protocol.
//!
//! - in: a tier M-N (M cubes, N moves of scramble) or a number of missions; a seed
//! - out: the protocol as Markdown, or one line of JSON
//! - source: see [`crate::campaign::benchmark`]

use super::arguments::{ScenarioArgs, not_negative};
use super::campaign::{Campaign, LAST_SEED, Performed, Shape, seedless};
use super::campaign_report::writable;
use super::catalogue;
use super::output::{Output, WRONG, clash, inform, refuse, save, warn};
use super::scenarios;
use super::stop::INTERRUPTED;
use crate::campaign::benchmark::{Kind, Score, clearances, score, scramble, scrambled, tier};
use crate::campaign::protocol::{Setup, protocol};
use crate::campaign::tally::Tally;
use crate::campaign::vary::Drawn;
use crate::cell::{Cell, Mount};
use crate::cube::format_turns;
use crate::scenario::Scenario;
use clap::Args;
use nalgebra::Point3;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot benchmark --tier 5-20 -o protocol.md
  rubik-robot benchmark --mission 20 --json | tail -1

A tier M-N is M consecutive trials with cubes that N seeded moves have scrambled, in the manner of
Yang, Lancaster, Srinivasa and Smith (RA-L 2020). It is passed if all trials are. The cube lies on
the table at the start and at the end, and no person is in the cell. A mission begins and ends in
a person's hand, with a cube that its seed draws. A trial passes if the cube of the simulated cell
is solved, and laid down or back in the hand, within --within-s. The report is a protocol: task,
setup, robot, procedure, scoring, and a row for each trial.

Keys of the object of --json:
  benchmark    name of the benchmark, as Rubiks-5-20
  start        place of the cube at the start, in words
  clearance_m, within_s   the limits --clearance-mm (in m) and --within-s
  clearances   seed and clearance_mm of each trial: distance of the nearest tool from the centre of
               the cube at the start, in the simulated cell
  score        trials, trials_passed, accuracy (their ratio), longest_row (passed trials in a row),
               passed (all trials passed), trial_s and turn_s (simulated time of a passed trial and
               per turn: min, median, p95, p99, max)
  campaign     keys of `campaign --json`
Exit codes: 0 every trial passed, 1 a trial failed, 2 wrong usage or scenario, or the scenario
changed meanwhile, 4 system error, 130 interrupted.")]
#[command(group(clap::ArgGroup::new("kind").required(true).args(["mission", "tier"])))]
pub(super) struct BenchmarkArgs {
    /// Perform K whole missions, each from a person's hand back into it
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    mission: Option<u64>,
    /// Perform M consecutive trials with cubes scrambled by N moves (1 to 1000)
    #[arg(long, value_name = "M-N", value_parser = tier)]
    tier: Option<Kind>,
    /// Scenario file (TOML) with the task solve [default: the built-in
    /// shipped:table with --tier, shipped:solve with --mission]
    #[arg(long, value_name = "FILE", value_parser = scenarios::parser(), verbatim_doc_comment)]
    scenario: Option<PathBuf>,
    /// Override of a key in all trials, as in control.grip_n=30; repeatable
    #[arg(long = "set", value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Seed of the first trial; the next ones have the next seeds
    #[arg(long, value_name = "S", default_value_t = 1,
          value_parser = clap::value_parser!(u64).range(..=LAST_SEED))]
    seed: u64,
    /// Number of processes at a time [default: the number of cores]
    #[arg(long, value_name = "J", value_parser = clap::value_parser!(u16).range(1..))]
    jobs: Option<u16>,
    /// Least distance of a tool at the start from the places where the centre
    /// of the cube may be (mm); a scenario with a nearer tool is refused
    #[arg(long, value_name = "MM", default_value_t = 80.0, value_parser = not_negative,
          verbatim_doc_comment)]
    clearance_mm: f64,
    /// Longest simulated time of a successful trial (s)
    #[arg(long, value_name = "SECONDS", default_value_t = 1800.0, value_parser = not_negative)]
    within_s: f64,
    /// Longest time of a trial by the wall clock (s)
    #[arg(long, value_name = "SECONDS", default_value_t = 900,
          value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    limit_s: u64,
    /// Write the report to FILE (Markdown) instead of stdout
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// End stdout with one line of JSON instead of printing the report
    #[arg(long)]
    json: bool,
}

/// Performs the trials and writes their protocol; returns the exit code.
pub(super) fn run(args: &BenchmarkArgs, output: &mut Output) -> anyhow::Result<u8> {
    // Trials take hours, so a file that cannot be written is refused before the first one.
    args.output.as_deref().map_or(Ok(()), writable).map_err(refuse)?;
    seedless(&args.set).map_err(refuse)?;
    let kind = kind(args)?;
    let from = scenario_of(args, kind);
    clash(&[("the scenario", Some(&from.scenario))], &[("-o", args.output.as_ref())])?;
    let scenario = from.load(&[]).map_err(refuse)?;
    if scenario.controller.task.word() != "solve" {
        return Err(refuse("--scenario: a benchmark needs a scenario with the task \"solve\""));
    }
    let setup = setup(args, kind, &from, &scenario);
    check_clearance(args, &setup)?;
    let mut campaign = campaign(args, kind, &from)?;
    let performed = campaign.perform(&kind.name())?;
    // The scenario has changed: a protocol of trials with two scenarios would describe neither.
    if performed == Performed::Changed {
        return Ok(WRONG);
    }
    let tally = Tally::of(&campaign.state);
    let score = score(&tally, args.within_s);
    // The protocol is made even of an interrupted benchmark: it says how many trials are missing.
    let text = protocol(&setup, &tally, &score);
    if let Some(path) = &args.output {
        keep(path, &text, &tally)?;
    }
    if args.json {
        output.line(&object(kind, &setup, &tally, &score).to_string())?;
    } else if args.output.is_none() {
        output.text(&text)?;
    }
    // An interrupted benchmark has not failed, so it has an exit code of its own.
    let interrupted = performed == Performed::Interrupted;
    Ok(if interrupted { INTERRUPTED } else { u8::from(!score.is_whole()) })
}

/// Returns the kind of trial that the options ask for.
fn kind(args: &BenchmarkArgs) -> anyhow::Result<Kind> {
    match (args.mission, args.tier) {
        (Some(trials), None) => Ok(Kind::Mission { trials }),
        (None, Some(kind)) => Ok(kind),
        _ => Err(refuse(
            "give either --mission K (number of missions) or --tier M-N (turns of scramble)",
        )),
    }
}

/// Returns the scenario of all trials: the given one, or the default of the kind of trial.
fn scenario_of(args: &BenchmarkArgs, kind: Kind) -> ScenarioArgs {
    let usual = match kind {
        Kind::Mission { .. } => "shipped:solve",
        Kind::Tier { .. } => "shipped:table",
    };
    let scenario = args.scenario.clone().unwrap_or_else(|| usual.into());
    ScenarioArgs { scenario, set: args.set.clone() }
}

/// Checks that no tool is nearer to the cube at the start than `--clearance-mm`.
fn check_clearance(args: &BenchmarkArgs, setup: &Setup) -> anyhow::Result<()> {
    // A tool that holds the cube already, or nearly so, would make the trial easier.
    let Some((name, _, near)) = setup.effectors.iter().find(|e| e.2 < setup.clearance) else {
        return Ok(());
    };
    let (near, least) = (near * 1e3, args.clearance_mm);
    Err(refuse(format!(
        "the tool of {name} is {near:.0} mm from the cube at the start, less than {least} mm: move \
         its start in the scenario, or change --clearance-mm"
    )))
}

/// Prepares the trials as a campaign with the scenario `from`. Each trial of a tier has a cube of
/// its own, which the trial's seed scrambles.
fn campaign(args: &BenchmarkArgs, kind: Kind, from: &ScenarioArgs) -> anyhow::Result<Campaign> {
    let shape = Shape {
        seed: args.seed,
        runs: kind.trials(),
        shard: <_>::default(),
        limit_s: args.limit_s,
        jobs: args.jobs,
    };
    // The cube of a tier comes from its seeded moves, that of a mission from the plant's seed.
    let draw = |seed| match kind {
        Kind::Mission { .. } => Vec::new(),
        Kind::Tier { moves, .. } => {
            let value = format!("\"{}\"", scrambled(&scramble(moves, seed)));
            vec![Drawn { key: "cube.state".to_owned(), value, from: "--tier".to_owned() }]
        }
    };
    Campaign::prepare(from, &shape, String::new(), draw).map_err(refuse)
}

/// Writes the protocol `text` to a file, unless no trial has a result.
fn keep(path: &Path, text: &str, tally: &Tally) -> anyhow::Result<()> {
    if tally.runs() > 0 {
        save(path, text.as_bytes())?;
        inform(&format!("protocol: {}", path.display()));
    } else {
        warn(&format!("no trial has a result: the file {} is not written", path.display()));
    }
    Ok(())
}

/// Returns the result as JSON.
fn object(kind: Kind, setup: &Setup, tally: &Tally, score: &Score) -> Value {
    let clearances: Vec<_> = clearances(tally)
        .map(|(seed, clearance)| json!({ "seed": seed, "clearance_mm": clearance }))
        .collect();
    json!({
        "benchmark": kind.name(), "start": setup.start(), "clearances": clearances,
        "clearance_m": setup.clearance, "within_s": setup.limit,
        "score": score.json(), "campaign": tally.json(),
    })
}

/// Returns the conditions of the trials, which the protocol describes.
fn setup(args: &BenchmarkArgs, kind: Kind, from: &ScenarioArgs, scenario: &Scenario) -> Setup {
    let cell = &scenario.controller.cell;
    let scrambles = match kind {
        Kind::Mission { .. } => Vec::new(),
        Kind::Tier { trials, moves } => (0..trials)
            .map(|i| args.seed.saturating_add(i))
            .map(|seed| (seed, format_turns(&scramble(moves, seed))))
            .collect(),
    };
    // The option that asked for these trials is part of the command that repeats them.
    let what = match kind {
        Kind::Mission { trials } => format!("--mission {trials}"),
        Kind::Tier { trials, moves } => format!("--tier {trials}-{moves}"),
    };
    let set = args.set.iter().fold(String::new(), |set, s| set + " --set '" + s + "'");
    Setup {
        kind,
        effectors: effectors(cell),
        clearance: args.clearance_mm * 1e-3,
        cameras: cell.cameras.iter().map(|c| (c.name.clone(), mounted(cell, &c.mount))).collect(),
        cube: (cell.cube.edge, cell.cube.mass),
        keeper: cell.keeper,
        place: [cell.hand.world_from_cube.translation.vector, cell.hand.half_extent]
            .map(Into::into),
        table: cell.table_height,
        limit: args.within_s,
        // The protocol names the command that repeats it.
        command: format!(
            "{} benchmark {what} --scenario {} --seed {} --clearance-mm {} \
             --within-s {}{set}",
            catalogue::program().program,
            from.scenario.display(),
            args.seed,
            args.clearance_mm,
            args.within_s
        ),
        scrambles,
        state: scenario.plant.cube_state,
    }
}

/// Returns for each arm its name, its description, and the distance (m) of its tool at the start
/// from the nearest point where the centre of the cube may be.
fn effectors(cell: &Cell) -> Vec<(String, String, f64)> {
    let zone = &cell.hand;
    let of = |arm: &crate::cell::Arm| {
        let tool =
            arm.world_from_base * arm.model.base_from_flange(&arm.start) * arm.flange_from_tool;
        let (least, most) = arm.gripper.opening;
        let kind = format!(
            "IRp-6 with a two-finger gripper (jaws {:.0} to {:.0} mm), a wrist force sensor",
            least * 1e3,
            most * 1e3
        );
        // The zone is a box around the cube: outside it the nearest point is on its surface.
        let at = zone.world_from_cube.inverse() * Point3::from(tool.translation.vector);
        let nearest = at.coords.zip_map(&zone.half_extent, |x, h| x.clamp(-h, h));
        (arm.name.clone(), kind, (at.coords - nearest).norm())
    };
    cell.arms.iter().map(of).collect()
}

/// Describes where a camera is mounted: fixed in the world, or in the gripper of an arm.
fn mounted(cell: &Cell, mount: &Mount) -> String {
    match mount {
        Mount::World { world_from_camera } => {
            let [x, y, z] = [0, 1, 2].map(|i| 1e3 * world_from_camera.translation.vector[i]);
            format!("fixed at ({x:.0}, {y:.0}, {z:.0}) mm")
        }
        Mount::Flange { arm, .. } => {
            let name = cell.arms.get(*arm).map_or("an arm", |arm| arm.name.as_str());
            format!("in the gripper of {name}")
        }
    }
}
