//! `rubik-robot run`: runs a scenario and prints its summary.
//!
//! - in: a scenario and its overrides; files of an interrupted run
//! - out: the summary, as a table or as one line of JSON; a recording; files for a later resume
//! - exit code: that of the summary

mod after;
mod kept;

use super::arguments::{ScenarioArgs, check_devices};
use super::output::{Output, clash, complain, inform, refuse, warn};
use super::record;
use super::ros::RosArgs;
use super::ticker;
use super::ui::{Ui, UiArgs, UiKind};
use crate::actors::control::is_speed;
use crate::desk::Desk;
use crate::error::{Error, NonFatal};
use crate::hw::console::{self, Tone};
use crate::hw::driver::missing_core;
use crate::hw::text::printable;
use crate::record::about::Begun;
use crate::record::feed::Feed;
use crate::record::journal::Journal;
use crate::record::place::Place;
use crate::record::recorder::Recorder;
use crate::record::summary::{EndedBy, Summary};
use crate::run::{self, RunContext, RunOptions, SavedFiles, check_task, numbered};
use crate::scenario::declared::TaskLabel;
use crate::scenario::keys::{BridgeKind, Pace};
use crate::scenario::{Override, Scenario};
use crate::tui;
use after::{AfterRun, Next};
use anyhow::Context;
use clap::{Args, ValueEnum};
use kept::KeptRun;
use rustix::process::{Signal, set_parent_process_death_signal};
use std::path::PathBuf;
use std::sync::Arc;

/// Exit code of a run in which an actor blocks all others: that of a system error.
const STUCK: i32 = 4;

#[derive(Debug, Clone, Args)]
#[command(after_help = "\
Examples:
  rubik-robot run scenarios/solve.toml
  rubik-robot run scenarios/solve.toml --seed 7 --set coordination=continuous
  rubik-robot run shipped:solve --cube UUUUUUUUURRRRRRRRRFFFFFFFFFDDDDDDDDDLLLLLLLLLBBBBBBBBB
  rubik-robot run scenarios/idle.toml --pace real-time --require-rt
  rubik-robot run scenarios/face_turn.toml --set control.force_sign=-1  # wrong sign: it fails
  rubik-robot run scenarios/solve.toml --ui web --wait --speed 5        # watch it in a browser
  rubik-robot run scenarios/solve.toml --json | tail -1                 # the summary for a program
  rubik-robot run scenarios/solve.toml --world cell.json                # kill it at any moment,
  rubik-robot run scenarios/solve.toml --world cell.json --resume       # then continue it
  rubik-robot run scenarios/solve.toml --record run.mcap                # for report and replay
  rubik-robot run scenarios/solve.toml --speed 1 --ros                  # topics of ROS 2

The plant is the simulated cell, an effector an arm with its gripper. Progress goes to stderr, the
summary to stdout: verdict, simulated times, forces, accidents, cube. At a terminal the operator's
page is served at the printed address, which includes a token that the page needs, and stays after
the run. With a UI the task idle waits for commands until its operator ends it: exit code 0.

Keys of the object of --json (null: not known, as figures of the plant on hardware):
  outcome (solved, failed, aborted), reason, ended_by (task, operator, interrupt, fatal, system),
  task, seed, cube_start, cube_end, identified (the cube as read), solution (turns of the first
  plan), expected_s, executed, turns, grasps, recoveries, sim_time_s, wall_time_s, phases (name,
  sim_time_s, wall_time_s), peak_force_n, peak_torque_nm, sensors (effector, force_n, torque_nm,
  felt_force_n, felt_torque_nm: the largest at a tool, true and measured), exertion (current_share,
  heat_share, motor_speed_rad_s, near_person_mm_s, arms_apart_mm), jams, slips, drops,
  drops_noticed, late_drops, pops, crushed, collisions, violations (let_fall, restarts,
  moved_after_stop), accidents (time_s, what), returned, turned_deg, force_limit_n, clearance_mm,
  hash, servo_hash, plant_hash; if there is one: paused_s, fault, detected_by, remedy, untrue,
  last_second, uncalibrated, links (node, time_s, sent_bytes, received_bytes: to nodes on other
  hosts), figures (those of the task, by name)
docs/operating.md explains the rows of the summary, which the keys follow.
Exit codes: 0 done, 1 the task failed or was aborted, 2 wrong usage or scenario, 3 an effector
failed, 4 system error, 130 interrupted by a signal.")]
#[allow(
    clippy::struct_excessive_bools,
    reason = "switches of the command line, independent of each other"
)]
pub(super) struct RunArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Seed of the plant: cube, person's hand, errors and noise
    /// [default: that of the scenario]
    #[arg(long, value_name = "N", verbatim_doc_comment)]
    seed: Option<String>,
    /// State of the cube at the start: 54 letters, faces in the order U R F D L B,
    /// each in reading order [default: the scenario's, or drawn by the seed]
    #[arg(long, value_name = "FACELETS", verbatim_doc_comment)]
    cube: Option<String>,
    /// Clock of the run: virtual (simulated time, as fast as --speed allows;
    /// repeatable to the bit) or real-time (the clock of the computer)
    /// [default: that of the scenario]
    #[arg(long, value_enum, verbatim_doc_comment, hide_possible_values = true)]
    pace: Option<PaceWord>,
    /// With --pace real-time: refuse to run unless all real-time rights are
    /// granted, which `rubik-robot doctor` checks
    #[arg(long, verbatim_doc_comment)]
    require_rt: bool,
    /// Record the run to FILE (MCAP), for replay, report and ROS 2 tools
    /// [default: with a page, but without --json, run.mcap in the run's folder of
    /// states; none for moves by hand; otherwise none]
    #[arg(long, value_name = "FILE", verbatim_doc_comment)]
    record: Option<PathBuf>,
    #[command(flatten)]
    keep: KeepArgs,
    /// Wait for the operator's start: the page's button, or s and Enter
    #[arg(long)]
    wait: bool,
    /// Highest speed of simulated time as a multiple of real time, 0.01 or more;
    /// 0: no limit
    #[arg(long, value_name = "FACTOR", default_value_t = 0.0, verbatim_doc_comment)]
    speed: f64,
    #[command(flatten)]
    ros: RosArgs,
    #[command(flatten)]
    ui: UiArgs,
    /// Start at once, ask no questions, and end stdout with one line of JSON
    #[arg(long)]
    json: bool,
    /// End when the parent process ends (for campaigns)
    #[arg(long, hide = true)]
    with_parent: bool,
}

/// Files that outlive the run.
#[derive(Debug, Clone, Args)]
struct KeepArgs {
    /// Write to FILE the journal with which --resume can continue the run; that of
    /// an interrupted run is not overwritten
    /// [default: with --world its FILE with .journal appended, otherwise none]
    #[arg(long, value_name = "FILE", verbatim_doc_comment)]
    journal: Option<PathBuf>,
    /// Save the state of the plant to FILE, as a real cell keeps its state;
    /// FILE.lock keeps other runs from using FILE, and is not removed
    /// [default: with a page and task solve, but without --json, world.json in the
    /// run's folder of states; otherwise none]
    #[arg(long, value_name = "FILE", verbatim_doc_comment)]
    world: Option<PathBuf>,
    /// Continue the interrupted run of --world and --journal; task solve only
    #[arg(long)]
    resume: bool,
}

impl KeepArgs {
    /// Names the files of a task that can be resumed, if no option names one of them: world and
    /// journal belong together. A run that resumes another one has named its own. Hardware has no
    /// saved plant: the cell keeps its state.
    fn complete(&mut self, kept: &KeptRun, scenario: &Scenario) {
        let named = self.journal.is_some() || self.world.is_some();
        if self.resume || named || !scenario.controller.task.properties.resumes {
            return;
        }
        if scenario.bridge.kind.is_hardware() {
            self.journal = Some(kept.journal());
        } else {
            self.world = Some(kept.world());
        }
    }
}

/// Clock of a run, as a word of the command line.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum PaceWord {
    /// Simulated time, as fast as the computer allows; repeatable bit for bit
    Virtual,
    /// Real time: the computer's clock
    RealTime,
}

/// Runs the scenario and prints its summary. With a page runs it again, or goes on, as often as the
/// operator wants. Returns the exit code of the last run.
pub(super) fn run(args: &RunArgs, output: &mut Output) -> anyhow::Result<u8> {
    // A campaign that is killed must not leave its runs behind.
    if args.with_parent {
        set_parent_process_death_signal(Some(Signal::TERM)).context("--with-parent")?;
    }
    let kind = args.ui.kind(args.json);
    // A program that reads the summary names the files that it wants.
    let keeps = kind == UiKind::Web && !args.json;
    let mut run = args.prepare(keeps)?;

    let desk = Desk::default();
    // From here on a refusal is printed after the UI is closed, on the terminal as it was before.
    let mut ui = args.ui.open(kind, desk.ui_end()).map_err(|error| refuse(format!("{error:#}")))?;
    let mut ended = one(&run, &mut ui, &desk, output)?;
    run.tidy();
    // The page stays for the operator, unless Ctrl-C has ended the run.
    if args.json || ended.interrupted || !ui.has_page() {
        return Ok(ended.code);
    }
    ui.tell_place();
    let mut runs = 1;
    loop {
        let record = run.args.record.as_deref();
        let over = AfterRun { scenario: &run.scenario, files: &run.files, record };
        let Some(next) = over.next(&ui, &desk)? else { return Ok(ended.code) };
        run = match run.followed_by(args, next, runs + 1, keeps) {
            Ok(next) => next,
            Err(why) => {
                after::refused(&desk, &why);
                continue;
            }
        };
        runs += 1;
        desk.prepare_next_run();
        ended = one(&run, &mut ui, &desk, output)?;
        run.tidy();
        if ended.interrupted {
            return Ok(ended.code);
        }
    }
}

/// A run that has passed all checks that come before its start.
struct PreparedRun {
    /// Its options, with the names of all files that it writes.
    args: RunArgs,
    scenario: Scenario,
    /// Files that outlive the run.
    files: SavedFiles,
    /// Folder of the files that no option of the user names.
    kept: Option<Arc<KeptRun>>,
}

impl PreparedRun {
    /// Removes the folders of older runs, and says how this one can go on if it was interrupted.
    fn tidy(&self) {
        let Some(kept) = &self.kept else { return };
        kept.remove_older();
        let unasked = self.files.journal.as_ref().filter(|_| self.files.unasked);
        let Some(journal) = unasked.filter(|path| Journal::interrupted(path).is_some()) else {
            return;
        };
        let scenario = self.args.scenario.scenario.display();
        let file = match &self.files.world {
            Some(world) => format!("--world {}", world.display()),
            None => format!("--journal {}", journal.display()),
        };
        inform(&format!("to go on later: `rubik-robot run {scenario} {file} --resume`"));
    }

    /// Returns whether the program named the recording.
    fn has_unnamed_recording(&self) -> bool {
        let folder = self.args.record.as_ref().and_then(|path| path.parent());
        let kept = self.kept.as_ref().map(|kept| kept.recording());
        kept.is_some_and(|own| own.parent() == folder)
    }

    /// Prepares the run that follows, which is number `number` of the program. `args` are the
    /// options of the user; `keeps` says whether the run keeps files that no option names.
    fn followed_by(
        &self,
        args: &RunArgs,
        next: Next,
        number: u32,
        keeps: bool,
    ) -> anyhow::Result<Self> {
        let resumes = next == Next::GoOn;
        let mut wanted = if resumes { self.args.clone() } else { args.clone() };
        // Each run has a recording of its own, also in the folder of a run that goes on.
        let unnamed = self.kept.as_ref().filter(|_| resumes).map(|kept| kept.recording());
        wanted.record = args.record.clone().or(unnamed).map(|path| numbered(&path, number));
        wanted.keep.resume = resumes;
        if let Next::Again(seed) = next {
            wanted.seed = Some(seed.to_string());
        }
        // Real arms move only after a start of their operator, also when he has chosen another run.
        wanted.wait |= self.scenario.bridge.kind.is_hardware();
        let mut run = wanted.prepare(keeps && !resumes)?;
        if resumes {
            // The run has the files of the one before.
            run.kept.clone_from(&self.kept);
            run.files.unasked = self.files.unasked;
        }
        Ok(run)
    }
}

/// End of one run.
struct Ended {
    /// Exit code of the summary.
    code: u8,
    /// Whether a signal ended the run, which ends the program as well.
    interrupted: bool,
}

/// Performs a run and prints its summary.
fn one(run: &PreparedRun, ui: &mut Ui, desk: &Desk, output: &mut Output) -> anyhow::Result<Ended> {
    let PreparedRun { args, scenario, files, .. } = run;
    let has_ui = !matches!(ui, Ui::None);
    // A replay needs all overrides: those of --set and those of the options.
    let overrides: Vec<_> = args.scenario.overrides().into_iter().chain(args.overrides()).collect();
    let begun = Begun { attended: has_ui, resumed: args.keep.resume };
    // Other programs read the feed from the server of the page, or as topics of ROS 2.
    let feed = (ui.has_page() || args.ros.ros.is_some()).then(|| desk.run_end().feed);
    let ros = &scenario.controller.ros;
    let topics = feed.clone().and_then(|feed| args.ros.publish(ros, feed)).transpose()?;
    let recorder = match args.recorder(scenario, &overrides, begun, feed.clone()) {
        // A run does not end because of a file that no user asked for.
        Err(why) if run.has_unnamed_recording() => {
            warn(&format!("this run is not recorded: {why:#}"));
            RunArgs { record: None, ..args.clone() }.recorder(scenario, &overrides, begun, feed)?
        }
        recorder => recorder?,
    };
    // A run of a campaign keeps no last second: if it fails, it can be repeated.
    let last_second = (!args.with_parent).then(|| record::last_second(scenario, &overrides, begun));
    // A UI in the terminal shows more than a line, and a program reads no line.
    let ticks = !args.json && !ui.has_terminal() && console::has_live_line();
    let context = RunContext {
        desk: (has_ui || ticks).then(|| desk.run_end()),
        watched: !has_ui,
        recorder: recorder.clone(),
        last_second: last_second.flatten(),
        saved: files.clone(),
        ..RunContext::default()
    };
    let ticker = ticks.then(|| ticker::start(desk.ui_end()));
    let done = run::run_with(scenario, args.options(ui), context);
    drop(ticker);
    let written = recorder.finish();
    drop(topics);

    // A UI in the terminal ends first, so that the lines below are not part of its screen.
    let shown = if ui.has_terminal() {
        std::mem::replace(ui, Ui::None).linger(&desk.run_end())
    } else {
        Ok(())
    };
    if let (Some(written), Some(path)) = (written, &args.record) {
        inform(&record::result_message(path, &written));
    }
    // Printing the summary consumes the result, so it is examined before.
    let interrupted = is_interrupted(&done);
    let code = print_summary(done, scenario, args, output)?;
    output.flush()?;
    if let Err(error) = shown {
        // A UI that failed changes neither the summary nor the exit code.
        complain(&format!("{error:#}"));
    }
    Ok(Ended { code, interrupted })
}

impl RunArgs {
    /// Reads the scenario, and checks everything that can be refused before a run begins. A run
    /// that `keeps` files gets names for those that no option names.
    fn prepare(&self, keeps: bool) -> anyhow::Result<PreparedRun> {
        let run = self.prepare_as_given()?;
        // Only once: meetings that the cell needs take seconds the first time.
        check_task(&run.scenario).map_err(refuse)?;
        let Some(kept) = keeps.then(KeptRun::begin).flatten() else { return Ok(run) };
        let mut args = run.args;
        // A run in which the operator moves arms by hand ends when he wants, perhaps never.
        if !run.scenario.controller.task.properties.by_hand {
            args.record = args.record.or_else(|| Some(kept.recording()));
        }
        args.keep.complete(&kept, &run.scenario);
        let mut prepared = args.prepare_as_given()?;
        // Options that name none of these files leave all of them to the program.
        prepared.files.unasked = run.files.world.is_none() && run.files.journal.is_none();
        Ok(PreparedRun { kept: Some(Arc::new(kept)), ..prepared })
    }

    /// Reads the scenario, and checks it with the options and files.
    fn prepare_as_given(&self) -> anyhow::Result<PreparedRun> {
        let mut scenario = self.scenario.load(&self.overrides()).map_err(refuse)?;
        self.ros.set(&mut scenario.controller.ros)?;
        self.check(&scenario)?;
        let files = saved_files(&self.keep, scenario.bridge.kind, scenario.controller.task)
            .map_err(refuse)?;
        check_outputs(self, &files)?;
        check_journal(&files, scenario.bridge.kind)?;
        check_devices(&scenario)?;
        Ok(PreparedRun { args: self.clone(), scenario, files, kept: None })
    }

    /// Returns the overrides of the options that set a key.
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
        self.ui.check().map_err(refuse)?;
        // Real-time rights matter on the wall clock only.
        if self.require_rt && scenario.pace != Pace::RealTime {
            return Err(refuse("--require-rt: the pace is virtual: add --pace real-time"));
        }
        // A servo that runs on any core instead is late at times, which the key was set to prevent.
        let core = scenario.real_time.core.filter(|_| scenario.pace == Pace::RealTime);
        if let Some(why) = core.and_then(|core| missing_core(core as usize)) {
            return Err(refuse(format!(
                "real_time.core: {why}: set the key to one of these, or leave it out"
            )));
        }
        if !is_speed(self.speed) {
            let reason = "must be a factor of 0.01 or more, or 0 for as fast as possible";
            return Err(refuse(format!("--speed: {reason}")));
        }
        // The file may be the recording of the run that is resumed now.
        match self.record.as_ref().filter(|path| self.keep.resume && path.is_file()) {
            Some(path) => Err(refuse(format!(
                "--record: {} exists and may be the recording of the interrupted run: name \
                 another file",
                path.display()
            ))),
            None => Ok(()),
        }
    }

    /// Starts the recording of a run with these overrides, and its `feed`. Without `--record` and a
    /// feed returns a recorder that records nothing.
    fn recorder(
        &self,
        scenario: &Scenario,
        overrides: &[Override],
        begun: Begun,
        feed: Option<Feed>,
    ) -> anyhow::Result<Recorder> {
        let Some(path) = &self.record else {
            return match feed {
                None => Ok(Recorder::default()),
                Some(feed) => {
                    record::begin_feed(feed, scenario, overrides, begun).context("feed of the page")
                }
            };
        };
        let file = Place::create(path)
            .map_err(|error| refuse(format!("--record: {}: {error}", path.display())))?;
        record::begin(file, feed, scenario, overrides, begun).context("--record")
    }

    /// Returns the options of the run for a UI.
    fn options(&self, ui: &Ui) -> RunOptions {
        let has_ui = !matches!(ui, Ui::None);
        RunOptions {
            require_real_time: self.require_rt,
            // Otherwise commands are read from stdin, also from a pipe. With --json no person gives
            // any, and a terminal UI reads the keys itself.
            automatic: self.json || ui.has_terminal(),
            wait: self.wait && (has_ui || !self.json),
            quiet: ui.has_terminal(),
            interruptible: true,
            speed: self.speed,
            stuck: Some(match (ui.has_terminal(), self.json) {
                (false, false) => end_stuck::<false, false>,
                (false, true) => end_stuck::<false, true>,
                (true, false) => end_stuck::<true, false>,
                (true, true) => end_stuck::<true, true>,
            }),
        }
    }
}

/// Returns whether a signal ended the run. Then the program ends at once, also with a page open.
fn is_interrupted(done: &Result<Summary, Error>) -> bool {
    match done {
        Ok(summary) => summary.ended_by == EndedBy::Interrupt,
        Err(error) => matches!(error, Error::NonFatal { cause: NonFatal::Interrupted, .. }),
    }
}

/// Ends the program when an actor blocks all others, since the run cannot end by itself then. With
/// `TERMINAL` the terminal UI is closed first; with `JSON` the last line of stdout is the summary.
#[allow(clippy::needless_pass_by_value, reason = "the signature is that of `RunOptions::stuck`")]
fn end_stuck<const TERMINAL: bool, const JSON: bool>(error: Error, summary: Summary) {
    if TERMINAL {
        tui::restore_terminal();
    }
    console::show("");
    complain(&format!(
        "{error}: the drives were commanded to switch off, and the program ends at once"
    ));
    if JSON {
        let mut output = Output::stdout();
        // If stdout cannot be written, the exit code still tells of the error.
        let _ = output.line(&summary.json()).and_then(|()| output.flush());
    } else if let Some(remedy) = &summary.remedy {
        inform(&format!("what to do: {remedy}"));
    }
    std::process::exit(STUCK);
}

/// Returns the files that outlive the run, or the error of the options that name them.
fn saved_files(
    args: &KeepArgs,
    bridge: BridgeKind,
    task: TaskLabel,
) -> Result<SavedFiles, &'static str> {
    // A saved state of the plant could contradict the real cell.
    if args.world.is_some() && bridge.is_hardware() {
        return Err(
            "--world: hardware keeps its state itself: leave the option out, or simulate the plant",
        );
    }
    let beside = |world: &PathBuf| {
        let mut path = world.clone().into_os_string();
        path.push(".journal");
        PathBuf::from(path)
    };
    // World and journal belong to one cell, so they are side by side by default.
    let journal = args.journal.clone().or_else(|| args.world.as_ref().map(beside));
    if args.resume && journal.is_none() {
        return Err("--resume: name the file of the interrupted run with --journal");
    }
    // Without the saved plant a simulated cell would begin with another cube than the journal's.
    if args.resume && args.world.is_none() && !bridge.is_hardware() {
        return Err("--resume: name the saved plant of the interrupted run with --world");
    }
    // Only some tasks write a journal from which another run can continue.
    if args.resume && !task.properties.resumes {
        return Err("--resume: a run of this task cannot be resumed");
    }
    Ok(SavedFiles { world: args.world.clone(), journal, resume: args.resume, unasked: false })
}

/// Checks that each file that the run writes is neither its scenario nor another of its files. The
/// temporary files and locks beside them count as well.
fn check_outputs(args: &RunArgs, keep: &SavedFiles) -> anyhow::Result<()> {
    let beside = |path: &Option<PathBuf>, end: &str| {
        path.as_ref().map(|path| {
            let mut path = path.clone().into_os_string();
            path.push(end);
            PathBuf::from(path)
        })
    };
    // Names of the other files that are written beside the world and the recording.
    let (lock, new) = (beside(&keep.world, ".lock"), beside(&keep.world, ".new"));
    let part = beside(&args.record, ".part");
    clash(
        &[("the scenario", Some(&args.scenario.scenario))],
        &[
            ("--record", args.record.as_ref()),
            ("--record's temporary file", part.as_ref()),
            ("--journal", keep.journal.as_ref()),
            ("--world", keep.world.as_ref()),
            ("--world's lock", lock.as_ref()),
            ("--world's next state", new.as_ref()),
        ],
    )
}

/// Refuses to overwrite the journal of an interrupted run, unless this run resumes it: the journal
/// may be the only way to find out what the hands hold.
fn check_journal(keep: &SavedFiles, bridge: BridgeKind) -> anyhow::Result<()> {
    let Some(path) = keep.journal.as_ref().filter(|_| !keep.resume) else { return Ok(()) };
    // A journal that cannot be read, or that another run writes, is refused when the run opens it.
    let Some(doing) = Journal::interrupted(path) else { return Ok(()) };
    let world = match &keep.world {
        Some(world) => format!(", and the new run replaces the saved plant {}", world.display()),
        None => String::new(),
    };
    let resumes = if keep.world.is_none() && !bridge.is_hardware() {
        "--resume and the --world of that run"
    } else {
        "--resume"
    };
    Err(refuse(format!(
        "--journal: an earlier run was interrupted while {doing}, and its journal {} is still \
         there: resume that run with {resumes}. To start a new run, name other files; or remove \
         the journal: then the earlier run cannot be resumed any more{world}",
        path.display()
    )))
}

/// Returns the table of a summary with its verdict in colour, if stdout has colours.
fn painted(table: &str) -> String {
    let table = printable(table);
    if !console::colours_results() {
        return table.into_owned();
    }
    // Only the row of the verdict begins with one of these words.
    let tones = [
        ("SOLVED", Tone::Good),
        ("DONE", Tone::Good),
        ("FAILED", Tone::Error),
        ("ABORTED", Tone::Error),
    ];
    let lines = table.split_inclusive('\n').map(|line| {
        let tone = tones.iter().find(|(word, _)| line.starts_with(word));
        tone.map_or_else(|| line.to_owned(), |(_, tone)| tone.paint(line))
    });
    lines.collect()
}

/// Prints the summary of a run, or its error; returns the exit code.
fn print_summary(
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
                output.coloured(&painted(&summary.table()))?;
            }
            Ok(summary.exit_code())
        }
        Err(error) => {
            complain(&error.to_string());
            // A program that reads JSON gets a summary even of a run that did not start.
            let summary = run::not_begun(scenario, &error);
            if args.json {
                output.line(&summary.json())?;
            } else if let Some(remedy) = &summary.remedy {
                inform(&format!("what to do: {remedy}"));
            }
            Ok(summary.exit_code())
        }
    }
}
