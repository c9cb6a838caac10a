//! `rubik-robot campaign`: a scenario many times, each in a process of its own, and what they come to together.

use super::arguments::ScenarioArgs;
use super::output::{Output, WRONG, clash, complain, refuse, save};
use super::progress::Bar;
use super::record;
use crate::campaign::page;
use crate::campaign::result::{RunResult, Verdict};
use crate::campaign::runner::{Job, Runner};
use crate::campaign::soak::{Soak, soak};
use crate::campaign::state::{self, Header, MOST_RUNS, Shard, State, Unusable};
use crate::campaign::tally::Tally;
use crate::campaign::vary::{Drawn, Vary};
use crate::hw::text;
use crate::record::journal;
use crate::record::place::Place;
use crate::record::running_program;
use crate::run;
use crate::scenario::{self, CameraSource, Override, Scenario};
use anyhow::Context as _;
use clap::{Args, Subcommand};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Exit code of an interrupted campaign.
const INTERRUPTED: u8 = 130;
/// The last seed that a first run may have: a scenario's seed is an integer of TOML, and so is that of the last run.
pub(super) const LAST_SEED: u64 = i64::MAX as u64 - MOST_RUNS;

#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Args)]
#[command(
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    after_help = "\
Examples:
  rubik-robot campaign scenarios/solve.toml --runs 100 -o report.html
  rubik-robot campaign scenarios/solve.toml --runs 1000 --vary scenarios/vary/cell.toml --at-least 0.995
  rubik-robot campaign scenarios/solve.toml --runs 1000 --state c.jsonl      the same again, or with more runs, goes on
  rubik-robot campaign scenarios/solve.toml --runs 1000 --shard 2/4 --state 2.jsonl
  rubik-robot campaign merge 1.jsonl 2.jsonl 3.jsonl 4.jsonl -o report.html
  rubik-robot campaign scenarios/solve.toml --runs 20 --json | tail -1
  rubik-robot campaign scenarios/solve.toml --soak 8

Run i has the seed S + i: another cube, hand, light, cell and noise. The verdict is the plant's. A run that panics or
takes longer than --limit-s is a failure, and is told with the command that repeats it.
Exit codes: 0 the campaign was performed, whatever came of it; 1 fewer solved than --at-least, a soak that is not steady
or has a mission that was not solved; 2 usage, scenario, state file; 4 system; 130 interrupted."
)]
pub(super) struct CampaignArgs {
    #[command(subcommand)]
    part: Option<Part>,
    /// Scenario file (TOML)
    #[arg(required = true)]
    scenario: Option<PathBuf>,
    /// Overrule a key in all runs, as in control.grip_n=30; repeatable
    #[arg(long = "set", value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Number of runs, of all shards together
    #[arg(long, value_name = "N", required_unless_present = "soak",
          value_parser = clap::value_parser!(u64).range(1..=MOST_RUNS))]
    runs: Option<u64>,
    /// Seed of the first run; the others have those that follow
    #[arg(long, value_name = "S", default_value_t = 1, value_parser = clap::value_parser!(u64).range(..=LAST_SEED))]
    seed: u64,
    /// Processes at a time; as many as there are cores when not given
    #[arg(long, value_name = "J", value_parser = clap::value_parser!(u16).range(1..))]
    jobs: Option<u16>,
    /// What is drawn for each run, beside what its seed draws; see scenarios/vary/
    #[arg(long, value_name = "FILE")]
    vary: Option<PathBuf>,
    /// Perform the K-th of N parts only; `merge` puts their state files together
    #[arg(long, value_name = "K/N", default_value = "1/1")]
    shard: Shard,
    /// Keep results in this file, and go on where it ends when it is there; --runs may have become more
    #[arg(long, visible_alias = "resume", value_name = "FILE")]
    state: Option<PathBuf>,
    /// Time that a run may take by the wall clock (s)
    #[arg(long, value_name = "SECONDS", default_value_t = 900,
          value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    limit_s: u64,
    #[command(flatten)]
    told: ToldArgs,
    /// Instead: missions back to back in this process for so many hours of simulated time; tells memory and drift
    #[arg(long, value_name = "HOURS", conflicts_with_all = ["runs", "jobs", "vary", "shard", "state", "output"])]
    soak: Option<f64>,
    /// Different seeds of a soak: after so many missions the first comes again, and must be the same
    #[arg(long, value_name = "N", default_value_t = 4, requires = "soak",
          value_parser = clap::value_parser!(u64).range(1..=1000))]
    soak_seeds: u64,
}

/// How the result is told.
#[derive(Debug, Args)]
pub(super) struct ToldArgs {
    /// Exit with 1 when a smaller share than this is solved, as in 0.995; of a soak all must be when not given
    #[arg(long, value_name = "SHARE")]
    at_least: Option<f64>,
    /// Write the report as a page
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// End stdout with one line of JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum Part {
    /// Put the state files of shards together and tell what they come to
    Merge {
        /// State files
        #[arg(required = true)]
        files: Vec<PathBuf>,
        #[command(flatten)]
        told: ToldArgs,
    },
}

pub(super) fn run(args: &CampaignArgs, output: &mut Output) -> anyhow::Result<u8> {
    if let Some(Part::Merge { files, told }) = &args.part {
        return merge(files, told, output);
    }
    let scenario =
        ScenarioArgs { scenario: args.scenario.clone().unwrap_or_default(), set: args.set.clone() };
    seedless(&args.set).map_err(refuse)?;
    if let Some(hours) = args.soak {
        return soaked(&scenario, args, hours, output);
    }
    args.told.check().map_err(refuse)?;
    let vary = args.vary.as_deref().map(read_vary).transpose().map_err(refuse)?;
    let inputs = [("the scenario", args.scenario.as_ref()), ("--vary", args.vary.as_ref())];
    let outputs = [("--state", args.state.as_ref()), ("-o", args.told.output.as_ref())];
    clash(&inputs, &outputs)?;
    let shape = Shape {
        seed: args.seed,
        runs: args.runs.unwrap_or(1),
        shard: args.shard,
        limit_s: args.limit_s,
        jobs: args.jobs,
    };
    let (text, vary) = vary.unzip();
    let draw = |seed: u64| vary.as_ref().map_or_else(Vec::new, |vary: &Vary| vary.draw(seed));
    let refused = |faults: String| {
        let drawn = args.vary.as_ref().filter(|_| faults.starts_with("what seed"));
        let from = drawn.map_or_else(String::new, |path| format!("--vary: {}: ", path.display()));
        refuse(format!("{from}{faults}"))
    };
    let mut campaign =
        Campaign::prepare(&scenario, &shape, text.unwrap_or_default(), draw).map_err(refused)?;
    if let Some(path) = &args.state {
        campaign.keep_in(path).map_err(|why| refuse(format!("{}: {why}", path.display())))?;
    }
    let performed = campaign.perform("campaign")?;
    let interrupted = performed == Performed::Interrupted;
    if interrupted && args.state.is_none() {
        complain("interrupted; with --state FILE a campaign can go on where it was");
    }
    let code = args.told.tell(&Tally::of(&campaign.state), output)?;
    // What was done until then is told all the same.
    Ok(match performed {
        Performed::Interrupted => INTERRUPTED,
        Performed::Changed => WRONG,
        Performed::Whole => code,
    })
}

fn read_vary(path: &Path) -> Result<(String, Vary), String> {
    let text =
        text::read(path, text::SCENARIO).map_err(|e| format!("--vary: {}: {e}", path.display()))?;
    let vary = Vary::read(path, &text).map_err(|faults| faults.to_string())?;
    Ok((text, vary))
}

fn merge(files: &[PathBuf], how: &ToldArgs, output: &mut Output) -> anyhow::Result<u8> {
    how.check().map_err(refuse)?;
    let inputs: Vec<_> = files.iter().map(|path| ("a campaign's state", Some(path))).collect();
    clash(&inputs, &[("-o", how.output.as_ref())])?;
    let (mut whole, mut shards): (Option<State>, _) = (None, Vec::new());
    for path in files {
        let read =
            File::open(path).map_err(Unusable::from).map(BufReader::new).and_then(State::read);
        let unusable = |why: &dyn std::fmt::Display| refuse(format!("{}: {why}", path.display()));
        let state = read.map_err(|why| unusable(&why))?;
        if state.torn {
            complain(&format!("{}: its last line is cut off, and left out", path.display()));
        }
        shards.push(state.header.shard);
        match &mut whole {
            None => whole = Some(state),
            Some(whole) => whole.merge(state).map_err(|why| unusable(&why))?,
        }
    }
    let Some(mut whole) = whole else { return Ok(WRONG) };
    let lacking = whole.whole_of(&shards);
    if lacking.count > 0 {
        complain(&format!("missing of the campaign: shards {lacking}"));
    }
    let tally = Tally::of(&whole);
    if !tally.is_of_one_build() {
        complain("the shards were performed by different builds of one version");
    }
    how.tell(&tally, output)
}

impl ToldArgs {
    pub(super) fn check(&self) -> Result<(), String> {
        match self.at_least {
            Some(share) if !(0.0..=1.0).contains(&share) => {
                Err(format!("--at-least: {share} is no share; write 0.995 for 99.5 %"))
            }
            _ => Ok(()),
        }?;
        self.output.as_deref().map_or(Ok(()), writable)
    }

    /// Tells a tally in all the ways that are wanted; returns the exit code.
    fn tell(&self, tally: &Tally, output: &mut Output) -> anyhow::Result<u8> {
        if !tally.is_complete() {
            complain(&format!("{} of {} runs are there", tally.runs(), tally.asked));
        }
        if self.json {
            output.line(&tally.json().to_string())?;
        } else {
            output.text(&tally.table())?;
        }
        // Last, since what can fail must not take the results with it.
        if let Some(path) = &self.output {
            if tally.runs() > 0 {
                save(path, page::page(tally, self.at_least).as_bytes())?;
                complain(&format!("report: {}", path.display()));
            } else {
                complain(&format!("no run was done: {} stays as it is", path.display()));
            }
        }
        let Some(share) = self.at_least else { return Ok(0) };
        let (runs, solved) = (tally.runs(), tally.solved);
        let reason = if !tally.is_complete() || runs == 0 {
            format!("{runs} of {} runs are no campaign to judge by", tally.asked)
        } else if !tally.is_of_one_build() {
            "the runs of different builds are no measurement of one".to_owned()
        } else if tally.success() < share {
            format!("{solved} of {runs} solved")
        } else {
            return Ok(0);
        };
        complain(&format!("--at-least {share} is not reached: {reason}"));
        Ok(1)
    }
}

/// Whether a file can be written when the runs are over, which take hours.
pub(super) fn writable(path: &Path) -> Result<(), String> {
    let shown = path.display();
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    if let Some(missing) = folder.filter(|folder| !folder.is_dir()) {
        return Err(format!("-o: there is no folder {}", missing.display()));
    }
    if path.is_dir() {
        return Err(format!("-o: {shown} is a folder; name a file in it"));
    }
    // A pipe or a terminal: to open it may mean to wait for somebody.
    if path.exists() && !path.is_file() {
        return Ok(());
    }
    if path.symlink_metadata().is_ok() && !path.exists() {
        // A link to what is not there yet.
        return Ok(());
    }
    let tried = Place::create(path).and_then(|(_, place)| place.discard());
    tried.map_err(|why| format!("-o: {shown}: {why}"))
}

/// Refuses a seed for all runs: each has its own.
pub(super) fn seedless(set: &[String]) -> Result<(), String> {
    let is_seed = |text: &String| Override::parse(text).is_ok_and(|over| over.key == "seed");
    if set.iter().any(is_seed) {
        return Err("--set seed: each run has a seed of its own, from --seed S on".to_owned());
    }
    Ok(())
}

/// How many runs, with which seeds, how.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shape {
    pub seed: u64,
    pub runs: u64,
    pub shard: Shard,
    pub limit_s: u64,
    pub jobs: Option<u16>,
}

/// How the performance of a campaign ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Performed {
    /// All runs have a result.
    Whole,
    /// A signal ended it.
    Interrupted,
    /// The scenario is no longer what it was, and that was told.
    Changed,
}

/// What was to be performed is no longer what it was.
#[derive(Debug, thiserror::Error)]
#[error(
    "{0}, or a file that it names, has changed since the campaign began: runs of two scenarios are no measurement"
)]
struct Changed(String);

/// The scenario of all runs as it was when the campaign began. Each run reads it anew.
struct Given {
    from: ScenarioArgs,
    sum: String,
}

impl Given {
    fn still(&self) -> std::io::Result<()> {
        // What cannot be read any more has changed as well.
        let now = self.from.load(&[]).ok().and_then(|now| sum(&self.from.scenario, &now).ok());
        if now.as_ref() == Some(&self.sum) {
            return Ok(());
        }
        Err(std::io::Error::other(Changed(self.from.scenario.display().to_string())))
    }
}

/// Sum over a scenario's text, and over what came of it: with the files that it names, wherever it stands.
fn sum(path: &Path, read: &Scenario) -> std::io::Result<String> {
    let mut sum = crc32fast::Hasher::new();
    sum.update(scenario::text(path)?.as_bytes());
    let mut read = Scenario { path: PathBuf::new(), ..read.clone() };
    for camera in &mut read.controller.cameras {
        let CameraSource::Folder(folder) = camera else { continue };
        let files: std::io::Result<Vec<_>> = folder.read_dir()?.map(|e| Ok(e?.path())).collect();
        let mut files: Vec<_> = files?.into_iter().filter(|path| path.is_file()).collect();
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

/// A campaign that can be performed.
pub(super) struct Campaign {
    pub state: State,
    given: Given,
    runner: Runner,
    jobs: Vec<Job>,
    kept: Option<File>,
}

impl Campaign {
    /// Checks the scenario of each run, before the first one begins. `draw` says what a seed's run has of its own.
    pub(super) fn prepare(
        args: &ScenarioArgs,
        shape: &Shape,
        vary: String,
        draw: impl Fn(u64) -> Vec<Drawn>,
    ) -> Result<Self, String> {
        let scenario = args.load(&[])?;
        if scenario.bridge.kind.is_hardware() {
            return Err(
                "a campaign needs the simulated plant: it alone knows the verdict".to_owned()
            );
        }
        let path = &args.scenario;
        let unread = |e| format!("{}: {e}", path.display());
        let text = scenario::text(path).map_err(unread)?;
        let sum = sum(path, &scenario).map_err(unread)?;
        let header = Header {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            build: record::build(),
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
        for seed in header.seeds() {
            let drawn = draw(seed);
            if !drawn.is_empty() {
                check(path, &text, &args.overrides(), &drawn)
                    .map_err(|faults| format!("what seed {seed} draws is refused:\n{faults}"))?;
            }
            jobs.push(Job { seed, set: drawn.iter().map(Drawn::option).collect() });
        }
        let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let runner = Runner {
            program: running_program().map_err(|e| format!("this program: {e}"))?,
            scenario: path.clone(),
            set: args.set.clone(),
            jobs: shape.jobs.map_or(cores, usize::from),
            limit: Duration::from_secs(shape.limit_s),
        };
        let state = State { header, results: BTreeMap::new(), whole: 0, torn: false };
        let from = ScenarioArgs { scenario: path.clone(), set: args.set.clone() };
        Ok(Self { state, given: Given { from, sum }, runner, jobs, kept: None })
    }

    /// Takes up what a file holds already, and appends to it from here on.
    fn keep_in(&mut self, path: &Path) -> Result<(), String> {
        let mut file = File::options()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)
            .map_err(|e| e.to_string())?;
        if !journal::is_ours(&file, path) {
            return Err("another campaign is writing it".to_owned());
        }
        match State::read(BufReader::new(&file)) {
            Err(Unusable::Empty) => {
                let first = state::first_line(&self.state.header);
                let written = file
                    .set_len(0)
                    .and_then(|()| file.seek(SeekFrom::Start(0)))
                    .and_then(|_| file.write_all(first.as_bytes()));
                written.map_err(|e| e.to_string())?;
            }
            Err(why) => return Err(why.to_string()),
            Ok(found) => self.continue_from(found, &mut file, path)?,
        }
        self.kept = Some(file);
        Ok(())
    }

    /// Takes up the results that were found in the file, if they are of this campaign.
    fn continue_from(
        &mut self,
        mut found: State,
        file: &mut File,
        path: &Path,
    ) -> Result<(), String> {
        let own = &self.state.header;
        let longer = found.header.begins(own) && found.header.runs < own.runs;
        if longer {
            found.header.runs = own.runs;
        }
        is_same_campaign(&found.header, own)?;
        let cut = if found.torn { "; its last line was cut off, and is left out" } else { "" };
        complain(&format!(
            "{}: going on behind {} of {} runs{cut}",
            path.display(),
            found.results.len(),
            self.jobs.len()
        ));
        // A cut line must not begin the next one.
        file.set_len(found.whole)
            .and_then(|()| file.seek(SeekFrom::End(0)))
            .map_err(|e| e.to_string())?;
        if longer {
            file.write_all(state::first_line(own).as_bytes()).map_err(|e| e.to_string())?;
        }
        self.jobs.retain(|job| !found.results.contains_key(&job.seed));
        self.state.results = found.results;
        Ok(())
    }

    /// Performs what is not done yet.
    pub(super) fn perform(&mut self, title: &str) -> anyhow::Result<Performed> {
        let stop = stop_flag()?;
        let (bar, begun) = (Bar::new(title), Instant::now());
        let all = self.jobs.len() + self.state.results.len();
        let (mut done, mut failed) = (0, 0);
        let (state, kept) = (&mut self.state, &mut self.kept);
        let given = &self.given;
        let performed = self.runner.perform(&self.jobs, &stop, &|| given.still(), |result| {
            if let Some(file) = kept.as_mut() {
                // One write and one wait for the disk: a run takes seconds.
                file.write_all(state::line(&result).as_bytes())?;
                file.sync_data()?;
            }
            done += 1;
            if result.verdict != Verdict::Solved {
                failed += 1;
                bar.say(&sentence(&result));
            }
            state.results.insert(result.seed, result);
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
                bar.end(&format!("{done} runs, broken off,"));
                complain(&why.to_string());
                return Ok(Performed::Changed);
            }
            performed => performed.context("the campaign's results")?,
        }
        let interrupted = stop.load(Ordering::SeqCst);
        bar.end(&format!("{done} runs{}", if interrupted { ", interrupted," } else { "" }));
        Ok(if interrupted { Performed::Interrupted } else { Performed::Whole })
    }
}

/// Checks that a file's header is that of this campaign; returns the difference.
fn is_same_campaign(found: &Header, own: &Header) -> Result<(), String> {
    if own.begins(found) && own.runs < found.runs {
        let runs = found.runs;
        return Err(format!("it is of {runs} runs already; --runs {runs} or more"));
    }
    if let Some(difference) = found.differs(own) {
        return Err(format!("of another campaign: they differ in {difference}"));
    }
    if found.shard != own.shard {
        return Err(format!("of shard {}, not {}", found.shard, own.shard));
    }
    if found.build != own.build {
        return Err(
            "of another build of this program; results of two programs are no measurement: take \
             another file"
                .to_owned(),
        );
    }
    Ok(())
}

fn sentence(run: &RunResult) -> String {
    let phase = if run.phase.is_empty() { String::new() } else { format!(" in {}", run.phase) };
    format!("seed {} {}{phase}: {}", run.seed, run.verdict.word(), run.reason)
}

fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 90.0 => format!("{s:.0} s"),
        s if s < 5400.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

/// A flag that a signal sets; the second one ends the process.
fn stop_flag() -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in run::heard() {
        let again = Arc::clone(&stop);
        signal_hook::flag::register_conditional_shutdown(signal, i32::from(INTERRUPTED), again)?;
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }
    Ok(stop)
}

fn check(path: &Path, text: &str, set: &[Override], drawn: &[Drawn]) -> Result<Scenario, String> {
    let drawn = drawn.iter().map(|d| Override {
        option: d.from.clone(),
        key: d.key.clone(),
        value: d.value.clone(),
    });
    let overrides: Vec<_> = set.iter().cloned().chain(drawn).collect();
    scenario::read(path, text, &overrides).map_err(|faults| faults.to_string())
}

/// Performs a soak of `hours` of simulated time; returns the exit code.
fn soaked(
    scenario: &ScenarioArgs,
    args: &CampaignArgs,
    hours: f64,
    output: &mut Output,
) -> anyhow::Result<u8> {
    args.told.check().map_err(refuse)?;
    if !(hours.is_finite() && hours > 0.0) {
        return Err(refuse("--soak: hours of simulated time, as in 8"));
    }
    let scenarios = soak_scenarios(scenario, args)?;
    let stop = stop_flag()?;
    complain("     hours  missions  memory [MiB]  times real time  mission [s]  drift [s]");
    let soak = soak(&scenarios, hours, &stop, |t| {
        let memory = t.resident_mib.map_or_else(|| "-".to_owned(), |m| format!("{m:.1}"));
        complain(&format!(
            "{:>10.3} {:>9} {memory:>13} {:>16.1} {:>12.1} {:>10.3}",
            t.hours, t.missions, t.times_real_time, t.mission_s, t.drift_s
        ));
    });
    if args.told.json {
        output.line(&soak.json().to_string())?;
    } else {
        output.text(&soak_text(&soak))?;
    }
    if stop.load(Ordering::SeqCst) || soak.tenths.len() < 10 {
        return Ok(INTERRUPTED);
    }
    let reasons = soak_failures(&soak, args.told.at_least.unwrap_or(1.0));
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
            return Err(refuse("a soak needs the simulated plant"));
        }
        scenarios.push(loaded);
    }
    Ok(scenarios)
}

/// Returns the result of a soak in words.
fn soak_text(soak: &Soak) -> String {
    let (repeated, differently) = soak.repeated;
    let growth = match (soak.growth_mib(), soak.is_flat()) {
        (Some(growth), Some(flat)) => {
            let word = if flat { "flat" } else { "GROWING" };
            format!("{growth:+.1} MiB after the second tenth: {word}")
        }
        _ => "not known".to_owned(),
    };
    let failed = soak.results.iter().filter(|r| r.verdict != Verdict::Solved);
    format!(
        "missions      {}, {} solved\nmemory        {growth}\n\
         repeated      {repeated}, {differently} of them differently\n{}",
        soak.results.len(),
        soak.solved(),
        failed.map(|r| sentence(r) + "\n").collect::<String>()
    )
}

/// Returns why a soak has failed: too few missions solved, or memory or times that drift.
fn soak_failures(soak: &Soak, least: f64) -> Vec<String> {
    let short = (soak.success() < least).then(|| {
        let (all, solved) = (soak.results.len() as u64, soak.solved());
        format!("{} of {all} missions were not solved; --at-least {least}", all - solved)
    });
    let unsteady = soak.unsteady().map(|why| format!("not steady: {why}"));
    short.into_iter().chain(unsteady).collect()
}
