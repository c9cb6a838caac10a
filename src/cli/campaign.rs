//! `rubik-robot campaign`: runs a scenario many times, each run in its own process, and reports on
//! all results.
//!
//! - in: a scenario, seeds, values to draw; or state files of shards; or hours of a soak
//! - out: a table or one line of JSON, a page, a state file from which a campaign continues
//! - exit code: see the help below

use super::arguments::ScenarioArgs;
use super::campaign_report::ResultArgs;
use super::catalogue;
use super::merge::{MergeArgs, merge};
use super::mix::{Size, mixed};
use super::output::{Output, WRONG, clash, complain, inform, refuse, warn};
use super::progress::Bar;
use super::scenarios;
use super::shards;
use super::status::{StatusArgs, status};
use super::stop::{INTERRUPTED, stop_flag};
use crate::campaign::progress::duration;
use crate::campaign::result::{RunResult, Verdict};
use crate::campaign::runner::{Job, Runner};
use crate::campaign::scheduler::Choice;
use crate::campaign::soak::{Soak, soak};
use crate::campaign::state::{self, Header, MOST_RUNS, Shard, State, Unusable};
use crate::campaign::tally::Tally;
use crate::campaign::vary::{Drawn, Variations};
use crate::hw::{new_file, text};
use crate::record::running_program;
use crate::scenario::{CameraSource, Override, Scenario};
use crate::tables;
use anyhow::Context as _;
use clap::{Args, Subcommand};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Beginning of the message about drawn values that the scenario refuses. It tells these errors,
/// which name the file of `--vary`, from others.
const DRAWN: &str = "the values that seed";
/// Largest seed of a first run, so that the seeds of all runs are integers of TOML (64 bits).
pub(super) const LAST_SEED: u64 = i64::MAX as u64 - MOST_RUNS;

#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Args)]
#[command(
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    after_help = "\
Examples:
  rubik-robot campaign scenarios/solve.toml --runs 100 -o report.html
  rubik-robot campaign scenarios/solve.toml --runs 1000 --at-least 0.995
  rubik-robot campaign scenarios/solve.toml --runs 1000 --vary scenarios/vary/cell.toml
  rubik-robot campaign scenarios/solve.toml --runs 1000 --state c.jsonl  # again: it continues
  rubik-robot campaign scenarios/solve.toml --runs 1000 --shard 2/4 --state shards/
  rubik-robot campaign scenarios/solve.toml --runs 10000 --shard auto --state shards/
  rubik-robot campaign status shards/
  rubik-robot campaign merge shards/ -o report.html
  rubik-robot campaign scenarios/solve.toml --runs 20 --json | tail -1
  rubik-robot campaign scenarios/solve.toml --soak 8
  rubik-robot campaign scenarios/solve.toml --mix --hours 1

Run i (from 0) has the seed S + i: another cube, hand, light, cell and noise. The plant (the
simulated cell) decides whether a run is solved, not the controller. A run that panics or exceeds
--limit-s is a failure. The report has the share of solved runs with its 95 % interval, the spread
of forces, grasps, turns and times, the mishaps (jams, slips, drops, pops, crushes, collisions), and
for each failure the command that repeats it.
With --shard auto the shard is that of the task: SLURM_ARRAY_TASK_ID of SLURM_ARRAY_TASK_COUNT in a
job array of Slurm, JOB_COMPLETION_INDEX of JOB_COMPLETIONS in an indexed job of Kubernetes, whose
file must set JOB_COMPLETIONS to the number of pods. With GNU parallel write --shard {#}/{##} and
give it --plus. If --state is a folder, the shard has the file shard-K-of-N.jsonl in it: a task that
is started again continues its own file, and a second process with the same shard is refused.
A soak runs missions of --soak-seeds seeds in turn, and reports how much the memory grows and
whether missions of one seed repeat to the bit. Without --at-least all of them must be solved.
A run of --mix may fail, but it must not report an untrue success, crash, miss a fallen cube, open
the last hand that holds it, press with more than 100 N, damage the cube, move an arm after a stop,
or go on for ever (more than 1800 s of simulated time, or --limit-s). For a broken rule the command
prints the smallest mix that still breaks it, as lines for a scenario.

Keys of the object of --json:
  build, scenario, seed, asked and runs (number wanted and performed), solved, success (share of the
  runs), interval (of this share, 95 %), failures (seed, phase, reason, verdict, command), phases
  (failures in each), without_verdict, mishaps (of each kind), runs_with_mishaps,
  solved_with_mishaps, recoveries, drops, runs_with_unnoticed_drops, runs_above_force_limit,
  contact_unknown, plant_hashes; and min, median, p95, p99, max of force_limit_n, peak_force_n,
  peak_contact_n, grasps, turns, sim_time_s, current_share, heat_share, motor_speed_rad_s,
  near_person_mm_s, arms_apart_mm, and of each number that the task gives (in figures)
  --soak: soak_h, runs, solved, failures, tenths (hours, missions, resident_mib, times_real_time,
  mission_s, drift_s), growth_mib, memory_flat, repeated, repeated_differently, drift_s, steady
  --mix: ended (number of runs by verdict), broken (seed, rule, set: the value for --set)
Exit codes: 0 the campaign was performed, with any result; 1 the share of --at-least was not
reached, a soak was not steady or had a failed mission, or a run of --mix broke a rule; 2 wrong
usage, scenario or state file, or the scenario changed meanwhile; 4 system error; 130 interrupted."
)]
pub(super) struct CampaignArgs {
    #[command(subcommand)]
    part: Option<Part>,
    /// Scenario: a file (TOML), or a name, as in solve; shipped:solve and
    /// shipped:table are built into the program
    #[arg(required = true, value_parser = scenarios::parser(), verbatim_doc_comment)]
    scenario: Option<PathBuf>,
    /// Override of a key in all runs, as in control.grip_n=30; repeatable
    #[arg(long = "set", value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Number of runs, over all shards; required without --soak and --mix
    #[arg(long, value_name = "N", required_unless_present_any = ["soak", "mix"],
          value_parser = clap::value_parser!(u64).range(1..=MOST_RUNS))]
    runs: Option<u64>,
    /// Seed of the first run; the next runs have the next seeds
    #[arg(long, value_name = "S", default_value_t = 1,
          value_parser = clap::value_parser!(u64).range(..=LAST_SEED))]
    seed: u64,
    /// Number of processes at a time [default: the number of cores]
    #[arg(long, value_name = "J", value_parser = clap::value_parser!(u16).range(1..))]
    jobs: Option<u16>,
    /// Draw the values of keys at random for each run, from the distributions
    /// in FILE (TOML), as in scenarios/vary/cell.toml
    #[arg(long, value_name = "FILE", verbatim_doc_comment)]
    vary: Option<PathBuf>,
    /// Perform part K of N (a shard) of the runs, or with auto the part of this
    /// task of a scheduler; campaign merge joins the state files of all shards
    #[arg(long, value_name = "K/N", default_value = "1/1", verbatim_doc_comment)]
    shard: Choice,
    /// Save each result to FILE (JSON lines), or to the file of the shard in an
    /// existing folder; continue from it if it exists, also with larger --runs
    /// than before
    #[arg(long, visible_alias = "resume", value_name = "FILE", verbatim_doc_comment)]
    state: Option<PathBuf>,
    /// Longest time of a run by the wall clock (s)
    #[arg(long, value_name = "SECONDS", default_value_t = 900,
          value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    limit_s: u64,
    #[command(flatten)]
    result: ResultArgs,
    /// Soak: run missions one after the other in one process for HOURS of
    /// simulated time
    #[arg(long, value_name = "HOURS", verbatim_doc_comment,
          conflicts_with_all = ["runs", "jobs", "vary", "shard", "state", "output"])]
    soak: Option<f64>,
    /// Inject a random mix of two to four faults into each run, and check
    /// safety rules
    #[arg(long, requires = "hours", verbatim_doc_comment,
          conflicts_with_all = ["soak", "runs", "vary", "shard", "state", "output", "at_least"])]
    mix: bool,
    /// Time by the wall clock (h) after which --mix begins no further batch of
    /// runs, four for each process
    #[arg(long, value_name = "HOURS", requires = "mix", verbatim_doc_comment)]
    hours: Option<f64>,
    /// Number of seeds of a soak, which its missions take in turn
    #[arg(long, value_name = "N", default_value_t = 4, requires = "soak",
          value_parser = clap::value_parser!(u64).range(1..=1000))]
    soak_seeds: u64,
}

/// Subcommand of `campaign`.
#[derive(Debug, Subcommand)]
enum Part {
    /// Merge the state files of shards and report on the whole campaign
    Merge(MergeArgs),
    /// Report the progress of a campaign from the state files of its shards
    Status(StatusArgs),
}

/// Performs a campaign, merges shards, or performs a soak; returns the exit code.
pub(super) fn run(args: &CampaignArgs, output: &mut Output) -> anyhow::Result<u8> {
    match &args.part {
        Some(Part::Merge(args)) => return merge(args, output),
        Some(Part::Status(args)) => return status(args, output),
        None => {}
    }
    let scenario =
        ScenarioArgs { scenario: args.scenario.clone().unwrap_or_default(), set: args.set.clone() };
    seedless(&args.set).map_err(refuse)?;
    // A soak runs in this process, so that the growth of its memory can be measured.
    if let Some(hours) = args.soak {
        return soaked(&scenario, args, hours, output);
    }
    if let Some(hours) = args.hours {
        let hours = positive_hours("--hours", hours)?;
        let limit = Duration::from_secs(args.limit_s);
        let size = Size { seed: args.seed, hours, jobs: args.jobs, limit };
        return mixed(&scenario, &size, args.result.json, output);
    }
    args.result.check().map_err(refuse)?;
    let vary = args.vary.as_deref().map(read_vary).transpose().map_err(refuse)?;
    let variable = |name: &str| std::env::var_os(name).map(|v| v.to_string_lossy().into_owned());
    let shard = args.shard.shard(&variable).map_err(refuse)?;
    let kept = args.state.as_ref().map(|path| shards::place(path, shard)).transpose();
    let kept = kept.map_err(refuse)?;
    let inputs = [("the scenario", args.scenario.as_ref()), ("--vary", args.vary.as_ref())];
    let outputs = [("--state", kept.as_ref()), ("-o", args.result.output.as_ref())];
    clash(&inputs, &outputs)?;
    // A call without `--runs` is a soak or a mix, and has returned above.
    let shape = Shape {
        seed: args.seed,
        runs: args.runs.unwrap_or(1),
        shard,
        limit_s: args.limit_s,
        jobs: args.jobs,
    };
    let (text, vary) = vary.unzip();
    let draw = |seed: u64| vary.as_ref().map_or_else(Vec::new, |vary: &Variations| vary.draw(seed));
    // An error of a drawn value comes from the file of --vary, which the message then names.
    let refused = |faults: String| {
        let drawn = args.vary.as_ref().filter(|_| faults.starts_with(DRAWN));
        let from = drawn.map_or_else(String::new, |path| format!("--vary: {}: ", path.display()));
        refuse(format!("{from}{faults}"))
    };
    let mut campaign =
        Campaign::prepare(&scenario, &shape, text.unwrap_or_default(), draw).map_err(refused)?;
    if let Some(path) = &kept {
        campaign.keep_in(path).map_err(|why| refuse(format!("{}: {why}", path.display())))?;
    }
    let performed = campaign.perform("campaign")?;
    let interrupted = performed == Performed::Interrupted;
    if interrupted && args.state.is_none() {
        inform("interrupted: with --state FILE a campaign can be continued");
    }
    // A campaign that ended early reports the results that it has.
    let code = args.result.report(&Tally::of(&campaign.state), output)?;
    Ok(match performed {
        Performed::Interrupted => INTERRUPTED,
        Performed::Changed => WRONG,
        Performed::Whole => code,
    })
}

/// Reads the file of `--vary`; returns its text as well, which the state file keeps.
fn read_vary(path: &Path) -> Result<(String, Variations), String> {
    let text = text::read(path, text::SCENARIO).map_err(|why| format!("--vary: {why}"))?;
    let vary = Variations::read(path, &text).map_err(|faults| faults.to_string())?;
    Ok((text, vary))
}

/// Checks that no override of `--set` sets the seed, which would be the same in all runs.
pub(super) fn seedless(set: &[String]) -> Result<(), String> {
    let is_seed = |text: &String| Override::parse(text).is_ok_and(|over| over.key == "seed");
    if set.iter().any(is_seed) {
        return Err(
            "--set seed: each run has a seed of its own: give the first one with --seed".to_owned()
        );
    }
    Ok(())
}

/// Size of a campaign.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shape {
    /// Seed of the first run.
    pub seed: u64,
    /// Number of runs, over all shards.
    pub runs: u64,
    /// Part of the runs that is performed.
    pub shard: Shard,
    /// Longest time of a run by the wall clock (s).
    pub limit_s: u64,
    /// Number of processes at a time; `None` for the number of cores.
    pub jobs: Option<u16>,
}

/// End of a campaign.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Performed {
    /// All runs have a result.
    Whole,
    /// A signal ended the campaign.
    Interrupted,
    /// The scenario changed during the campaign; the change has been reported.
    Changed,
}

/// Error of a scenario that has changed during the campaign.
#[derive(Debug, thiserror::Error)]
#[error(
    "{0}, or a file that it names, has changed since the campaign began: the campaign ends, since \
     runs of two scenarios are no measurement"
)]
struct Changed(String);

/// Scenario as it was when the campaign began. Each run reads the file again, so a change of the
/// file would go unnoticed without this check.
struct Given {
    from: ScenarioArgs,
    /// Checksum of the scenario at the beginning, see [`sum`].
    sum: String,
}

impl Given {
    /// Checks that the scenario and the files that it names are as they were when the campaign
    /// began.
    fn still(&self) -> std::io::Result<()> {
        // A file that cannot be read any more has changed as well.
        let now = self.from.load(&[]).ok().and_then(|now| sum(&now).ok());
        if now.as_ref() == Some(&self.sum) {
            return Ok(());
        }
        Err(std::io::Error::other(Changed(self.from.scenario.display().to_string())))
    }
}

/// Returns the checksum of a scenario: of its text, its values and the files that it names. It does
/// not depend on the folder of the scenario.
fn sum(read: &Scenario) -> std::io::Result<String> {
    let mut sum = crc32fast::Hasher::new();
    // Shards on several machines may have the scenario in different folders.
    let mut read = Scenario { path: PathBuf::new(), ..read.clone() };
    for camera in &mut read.controller.cameras {
        // The pictures of a folder are part of the scenario: their names and contents count.
        let CameraSource::Folder(folder) = camera else { continue };
        let files: std::io::Result<Vec<_>> = folder.read_dir()?.map(|e| Ok(e?.path())).collect();
        let mut files: Vec<_> = files?.into_iter().filter(|path| path.is_file()).collect();
        // The order of a folder's entries differs between file systems.
        files.sort();
        for file in files {
            sum.update(file.file_name().unwrap_or_default().as_encoded_bytes());
            sum.update(&std::fs::read(&file)?);
        }
        *folder = PathBuf::new();
    }
    sum.update(format!("{read:?}").as_bytes());
    Ok(format!("{:08x}", sum.finalize()))
}

/// Campaign whose scenarios have been checked.
pub(super) struct Campaign {
    /// Description of the campaign, and the results so far.
    pub state: State,
    given: Given,
    runner: Runner,
    /// Runs that have no result yet.
    jobs: Vec<Job>,
    /// State file to which each result is appended, if `--state` names one.
    kept: Option<File>,
}

impl Campaign {
    /// Prepares a campaign: checks the scenario of each run before the first run starts. `vary` is
    /// the text of the `--vary` file; `draw` returns the values that are drawn for a seed.
    pub(super) fn prepare(
        args: &ScenarioArgs,
        shape: &Shape,
        vary: String,
        draw: impl Fn(u64) -> Vec<Drawn>,
    ) -> Result<Self, String> {
        let scenario = args.load(&[])?;
        if scenario.bridge.kind.is_hardware() {
            return Err(
                "a campaign needs the simulated plant, which knows the verdict: take a scenario \
                 without hardware"
                    .to_owned(),
            );
        }
        let path = &args.scenario;
        let unread = |e| format!("{}: {e}", path.display());
        let sum = sum(&scenario).map_err(unread)?;
        let header = Header {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            build: crate::record::build(),
            program: Some(scenario.task.program().clone()),
            task: scenario.controller.task.word().to_owned(),
            scenario: path.display().to_string(),
            scenario_sum: sum.clone(),
            set: args.set.clone(),
            vary,
            seed: shape.seed,
            runs: shape.runs,
            shard: shape.shard,
            limit_s: shape.limit_s,
        };
        let mut jobs = Vec::new();
        // A drawn value that the scenario refuses ends the campaign before its first run.
        for seed in header.seeds() {
            let drawn = draw(seed);
            if !drawn.is_empty() {
                check(path, &scenario.text, &args.overrides(), &drawn)
                    .map_err(|faults| format!("{DRAWN} {seed} draws are refused:\n{faults}"))?;
            }
            jobs.push(Job { seed, set: drawn.iter().map(Drawn::option).collect(), kept: None });
        }
        let cores = tables::cores();
        let runner = Runner {
            program: running_program().map_err(|e| format!("this program: {e}"))?,
            scenario: path.clone(),
            set: args.set.clone(),
            jobs: shape.jobs.map_or(cores, usize::from),
            limit: Duration::from_secs(shape.limit_s),
        };
        let state = State { header, results: BTreeMap::new(), whole: 0, damaged: 0, torn: false };
        let from = ScenarioArgs { scenario: path.clone(), set: args.set.clone() };
        Ok(Self { state, given: Given { from, sum }, runner, jobs, kept: None })
    }

    /// Takes over the results in the state file at `path`, or creates the file. New results will be
    /// appended to it.
    fn keep_in(&mut self, path: &Path) -> Result<(), String> {
        let own = new_file::resolve(path).and_then(|path| new_file::open_or_create(&path));
        let mut file = own.map_err(|e| e.to_string())?;
        // The file is locked; the lock is released when this process ends, even if it is killed.
        if !new_file::lock_for_writing(&file, path) {
            return Err(
                "another campaign is writing it: wait for its end, or name another file".to_owned()
            );
        }
        match State::read(BufReader::new(&file)) {
            // A campaign that was killed while it wrote the first line leaves no complete line.
            Err(Unusable::Empty) => {
                let first = state::first_line(&self.state.header);
                let written = file
                    .set_len(0)
                    .and_then(|()| file.seek(SeekFrom::Start(0)))
                    .and_then(|_| file.write_all(first.as_bytes()))
                    // A host that takes over the shard sees the header, and the name in the folder.
                    .and_then(|()| file.sync_data())
                    .and_then(|()| new_file::keep_name(path));
                written.map_err(|e| e.to_string())?;
            }
            Err(why) => return Err(why.to_string()),
            Ok(found) => {
                shards::check_program(&found.header)?;
                self.continue_from(found, &mut file, path)?;
            }
        }
        self.kept = Some(file);
        Ok(())
    }

    /// Takes over the results `found` in a state file, if the file is of this campaign. Cuts off an
    /// incomplete last line, so that new results can be appended.
    fn continue_from(
        &mut self,
        mut found: State,
        file: &mut File,
        path: &Path,
    ) -> Result<(), String> {
        let own = &self.state.header;
        // A campaign may get more runs: then a second header is appended, which counts.
        let longer = found.header.is_extended_by(own) && found.header.runs < own.runs;
        if longer {
            found.header.runs = own.runs;
        }
        is_same_campaign(&found.header, own)?;
        let cut =
            if found.torn { "; its last line was cut off, so that run is repeated" } else { "" };
        let damaged = match found.damaged {
            0 => String::new(),
            lines => format!("; {lines} damaged lines are left out and their runs are repeated"),
        };
        inform(&format!(
            "{}: has {} of {} runs, the campaign continues{damaged}{cut}",
            path.display(),
            found.results.len(),
            self.jobs.len()
        ));
        // An incomplete last line is removed, so that the next result begins a line.
        file.set_len(found.whole)
            .and_then(|()| file.seek(SeekFrom::End(0)))
            .map_err(|e| e.to_string())?;
        if longer {
            file.write_all(state::first_line(own).as_bytes()).map_err(|e| e.to_string())?;
        }
        // Only the seeds without a result are performed.
        self.jobs.retain(|job| !found.results.contains_key(&job.seed));
        self.state.results = found.results;
        Ok(())
    }

    /// Performs the runs that have no result yet. `title` names them in the progress bar.
    pub(super) fn perform(&mut self, title: &str) -> anyhow::Result<Performed> {
        let stop = stop_flag()?;
        let (bar, begun) = (Bar::new(title), Instant::now());
        let all = self.jobs.len() + self.state.results.len();
        let (mut done, mut failed) = (0, 0);
        let (state, kept) = (&mut self.state, &mut self.kept);
        let given = &self.given;
        // Each result is saved at once: a campaign that is killed loses only the runs in progress.
        let performed = self.runner.perform(&self.jobs, &stop, &|| given.still(), |result| {
            if let Some(file) = kept.as_mut() {
                // Waiting for the disk costs little, since a run takes seconds.
                file.write_all(state::line(&result).as_bytes())?;
                file.sync_data()?;
            }
            done += 1;
            if result.verdict != Verdict::Solved {
                failed += 1;
                inform(&sentence(&result));
            }
            state.results.insert(result.seed, result);
            // The mean time of the runs of this call predicts the time that is left.
            let left = begun.elapsed().as_secs_f64() / f64::from(done)
                * (all - state.results.len()) as f64;
            let words = format!(
                "  {} of {all}, {failed} failed, about {} left",
                state.results.len(),
                duration(left)
            );
            bar.show_with(state.results.len() as f64 / all.max(1) as f64, &words);
            Ok(())
        });
        match performed {
            Err(why) if why.get_ref().and_then(|why| why.downcast_ref::<Changed>()).is_some() => {
                bar.end(&format!("{done} runs, ended early,"));
                warn(&why.to_string());
                return Ok(Performed::Changed);
            }
            performed => performed.context("the campaign's results")?,
        }
        let interrupted = stop.load(Ordering::SeqCst);
        bar.end(&format!("{done} runs{}", if interrupted { ", interrupted," } else { "" }));
        Ok(if interrupted { Performed::Interrupted } else { Performed::Whole })
    }
}

/// Checks that the header `found` in a state file is that of this campaign, `own`; otherwise
/// returns the difference and what to do.
fn is_same_campaign(found: &Header, own: &Header) -> Result<(), String> {
    if own.is_extended_by(found) && own.runs < found.runs {
        let runs = found.runs;
        return Err(format!("it has {runs} runs already: give --runs {runs} or more"));
    }
    if let Some(difference) = found.differs(own) {
        return Err(format!(
            "it is of another campaign: name another file; they differ in {difference}"
        ));
    }
    if found.shard != own.shard {
        let (theirs, ours) = (found.shard, own.shard);
        return Err(format!("it is of shard {theirs}, not {ours}: name another file"));
    }
    if found.build != own.build {
        return Err("it is of another build of this program, and results of two programs are no \
             measurement: name another file"
            .to_owned());
    }
    Ok(())
}

/// Returns the line about a run that failed.
fn sentence(run: &RunResult) -> String {
    let phase = if run.phase.is_empty() { String::new() } else { format!(" in {}", run.phase) };
    format!("seed {} {}{phase}: {}", run.seed, run.verdict.word(), run.reason)
}

/// Reads the text of a scenario with the overrides `set` and the drawn values; returns all errors
/// as text.
fn check(path: &Path, text: &str, set: &[Override], drawn: &[Drawn]) -> Result<Scenario, String> {
    let drawn = drawn.iter().map(|d| Override {
        option: d.from.clone(),
        key: d.key.clone(),
        value: d.value.clone(),
    });
    let overrides: Vec<_> = set.iter().cloned().chain(drawn).collect();
    catalogue::read(path, text, &overrides).map_err(|faults| faults.to_string())
}

/// Returns the hours of an option, or refuses a number that is not above 0.
fn positive_hours(option: &str, hours: f64) -> anyhow::Result<f64> {
    if hours.is_finite() && hours > 0.0 {
        return Ok(hours);
    }
    Err(refuse(format!("{option} {hours}: must be a number of hours above 0, as in 8")))
}

/// Performs a soak of `hours` of simulated time; returns the exit code.
fn soaked(
    scenario: &ScenarioArgs,
    args: &CampaignArgs,
    hours: f64,
    output: &mut Output,
) -> anyhow::Result<u8> {
    args.result.check().map_err(refuse)?;
    let hours = positive_hours("--soak", hours)?;
    let scenarios = soak_scenarios(scenario, args)?;
    let stop = stop_flag()?;
    inform("     hours  missions  memory [MiB]  times real time  mission [s]  drift [s]");
    let soak = soak(&scenarios, hours, &stop, |t| {
        let memory = t.resident_mib.map_or_else(|| "-".to_owned(), |m| format!("{m:.1}"));
        inform(&format!(
            "{:>10.3} {:>9} {memory:>13} {:>16.1} {:>12.1} {:>10.3}",
            t.hours, t.missions, t.times_real_time, t.mission_s, t.drift_s
        ));
    });
    if args.result.json {
        output.line(&soak.json().to_string())?;
    } else {
        output.text(&soak_text(&soak))?;
    }
    // A soak that was stopped is not judged.
    if stop.load(Ordering::SeqCst) || soak.tenths.len() < 10 {
        return Ok(INTERRUPTED);
    }
    let reasons = soak_failures(&soak, args.result.at_least.unwrap_or(1.0));
    for reason in &reasons {
        complain(reason);
    }
    Ok(u8::from(!reasons.is_empty()))
}

/// Loads the scenario once for each seed of a soak.
fn soak_scenarios(scenario: &ScenarioArgs, args: &CampaignArgs) -> anyhow::Result<Vec<Scenario>> {
    let mut scenarios = Vec::new();
    for seed in args.seed..args.seed.saturating_add(args.soak_seeds) {
        let seed = Override::option("--seed", "seed", &seed.to_string());
        let loaded = scenario.load(&[seed]).map_err(refuse)?;
        if loaded.bridge.kind.is_hardware() {
            return Err(refuse(
                "a soak needs the simulated plant: take a scenario without hardware",
            ));
        }
        scenarios.push(loaded);
    }
    Ok(scenarios)
}

/// Returns the result of a soak as a table.
fn soak_text(soak: &Soak) -> String {
    let (repeated, differently) = soak.repeated;
    let growth = match (soak.growth_mib(), soak.is_flat()) {
        (Some(growth), Some(flat)) => {
            let word = if flat { "flat" } else { "GROWING" };
            format!("{growth:+.1} MiB after the second tenth: {word}")
        }
        _ => "not known".to_owned(),
    };
    // Only failed missions have a line of their own.
    let failed = soak.results.iter().filter(|r| r.verdict != Verdict::Solved);
    format!(
        "missions      {}, {} solved\nmemory        {growth}\n\
         repeated      {repeated}, {differently} of them with a difference\n{}",
        soak.results.len(),
        soak.solved(),
        failed.map(|r| sentence(r) + "\n").collect::<String>()
    )
}

/// Returns the reasons why a soak failed: too few missions were solved, or memory or times drift.
fn soak_failures(soak: &Soak, least: f64) -> Vec<String> {
    let short = (soak.success() < least).then(|| {
        let (all, solved) = (soak.results.len() as u64, soak.solved());
        format!("{} of {all} missions were not solved; --at-least {least}", all - solved)
    });
    let unsteady = soak.unsteady_reason().map(|why| format!("not steady: {why}"));
    short.into_iter().chain(unsteady).collect()
}
