//! The supervisor: creates ports, servos and actors from a scenario, runs the task, and sums up.
//!
//! It hands the controller's half of a scenario to the actors, and takes the verdict from the `world`,
//! where that knows one.

use super::disturbance::Troubles;
use super::gate::{Gate, Inner, Outer};
use super::interrupt::{Interrupt, SWITCHES_OFF};
use super::recording;
use super::settings;
use super::witness::Witness;
use super::world::{Cameras, World};
use super::world_file::Kept;
use crate::actors::alarm::{Alarm, Care, Caught, panicked, raised};
use crate::actors::board::{Board, Seen};
use crate::actors::clock::Clock;
use crate::actors::control::{Control, Pacer, Tempo, permission_soon};
use crate::actors::fault::Mishap;
use crate::actors::homing::{self, homed};
use crate::actors::lookout;
use crate::actors::mp::{self, Coordination, Mp, Turning};
use crate::actors::notice;
use crate::actors::present::Presenter;
use crate::actors::ui;
use crate::actors::vsp::{self, VspHandle};
use crate::actors::work::Work;
use crate::actors::{ecp, edp};
use crate::cube::{Facelets, format_turns};
use crate::desk::RunEnd;
use crate::emergency_stop::{EmergencyStop, StopButton, StopSignal};
use crate::error::{Error, Fatal, NonFatal, System};
use crate::generators::Behaviour;
use crate::hw::driver::{self, Core, RecordSink, ServoLink, ServoRecord, Switches, WallEnd};
use crate::hw::note::{self, Note};
use crate::hw::plant::{Plant, Verdict};
use crate::hw::scene::{Scene, SceneArm};
use crate::motion::PERIOD;
use crate::operator::{Input, OutcomeView};
use crate::reach::guard::Guard;
use crate::reach::{MeetingTable, ReachSettings};
use crate::record::calibration;
use crate::record::journal::Journal;
use crate::record::playback::Playback;
use crate::record::recorder::{Entry, Recorder};
use crate::record::run_hash::RunHash;
use crate::record::summary::{Accident, EndedBy, Outcome, Phase, SensorPeak, Summary};
use crate::scenario::keys::{self, Pace};
use crate::scenario::lists::VspKind;
use crate::scenario::{ControllerConfig, Owner, Scenario};
use crate::servo::period::Length;
use crate::servo::{ForceSettings, ServoCommand, ServoConfig};
use crate::tasks::cube::hold::Hand;
use crate::tasks::cube::mission::{Assignment, Goal, Mission, MissionLog};
use crate::tasks::idle::Idle;
use crate::tasks::panel::Panel;
use crate::tasks::{self, Effort, Forces};
use std::borrow::Cow;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::{mpsc, watch};
use tracing::Instrument as _;

/// How a run is started.
#[derive(Debug, Clone, Copy, Default)]
#[allow(
    clippy::struct_excessive_bools,
    reason = "switches of the command line, independent of each other"
)]
pub struct RunOptions {
    /// Asks nothing and listens to no keys; otherwise p, r and t on stdin pause, resume and terminate.
    pub automatic: bool,
    /// Waits for the operator's start; the end of input is one, too.
    pub wait: bool,
    /// Tells nothing on stderr.
    pub quiet: bool,
    /// Under the wall clock: refuses to run unless every real-time right is granted.
    pub require_real_time: bool,
    /// Takes the process's SIGINT and SIGTERM as the operator's terminate.
    pub interruptible: bool,
    /// Under virtual time: how fast time may go at first, in times of real time; 0 for as fast as it computes.
    pub speed: f64,
    /// Is told, from a thread beside the runtime, of an actor that lets no other one get on. Such a run never ends by itself.
    pub stuck: Option<fn(Error)>,
}

/// Time that the operator has for an answer [s].
const PATIENCE: f64 = 120.0;
/// Time after a hand-back in which the operator's hand withdraws [s].
const WITHDRAWAL: f64 = 4.0;
/// Time after an error in which arms come to a stand, before the drives go off [s].
const STAND: f64 = 0.6;
/// A force on the cube above this is excessive [N]: a verdict, not a limit of anything.
const EXCESSIVE: f64 = 20.0;
/// Why a run ended that its operator ended.
const BY_OPERATOR: &str = "terminated by the operator";
/// So often the servo is told that the actors live.
const HEART_BEAT: Duration = Duration::from_millis(10);

/// Performs a scenario and returns what it came to.
///
/// # Errors
/// When it could not be performed at all; an error in mid-run is part of the summary.
pub fn run(scenario: &Scenario, options: RunOptions) -> Result<Summary, Error> {
    run_at(scenario, options, None)
}

/// What is around a run.
#[derive(Default)]
pub struct Around {
    /// The run's end of the desk at which UIs are.
    pub desk: Option<RunEnd>,
    /// What keeps the run; whoever made it finishes it.
    pub recorder: Recorder,
    /// A recording in place of the plant, the sensors and the operator, and whether an operator was there.
    pub playback: Option<(Playback, bool)>,
    /// Files that outlive a run.
    pub keep: Keep,
    /// Sees the plant after each period, under virtual time; whoever judges a run, and nobody in it.
    pub judge: Option<Judge>,
}

/// Files that outlive a run.
#[derive(Debug, Clone, Default)]
pub struct Keep {
    /// Where the simulated plant keeps its state; the controller does not know it.
    pub world: Option<PathBuf>,
    /// What another run must know to go on.
    pub journal: Option<PathBuf>,
    /// Go on where the run that left them was broken off.
    pub resume: bool,
}

/// Somebody who sees the plant after each period, with its number.
pub type Judge = Box<dyn FnMut(u64, &Plant) + Send>;

/// The same with faces at the other end of a desk: they see what the controller believes, and command it. A run of the
/// cube's task comes to the same with them, to the bit, as long as they command nothing; the idle task waits for their
/// orders until it is terminated.
///
/// # Errors
/// As [`run`].
pub fn run_at(
    scenario: &Scenario,
    options: RunOptions,
    desk: Option<RunEnd>,
) -> Result<Summary, Error> {
    run_with(scenario, options, Around { desk, ..Around::default() })
}

/// The same, kept in a recording, or with one as its world.
///
/// # Errors
/// As [`run`].
pub fn run_with(
    scenario: &Scenario,
    options: RunOptions,
    around: Around,
) -> Result<Summary, Error> {
    let Around { desk, recorder, playback, keep: files, judge } = around;
    let begun = Instant::now();
    let tempo = Tempo::default();
    let initial = if options.wait { Control::Waiting } else { Control::Running };
    let control = Arc::new(watch::channel(initial).0);
    let attended = desk.is_some() || playback.as_ref().is_some_and(|(_, attended)| *attended);
    let playback = playback.map(|(playback, _)| playback);
    let tape = RunHash::default();
    let keep = (recorder.clone(), tape.clone());
    let (to_task, inputs) = mpsc::channel(4);
    let controls =
        ui::OperatorControls { control: Arc::clone(&control), to_task, tempo: tempo.clone() };
    let ui = create_ui(scenario, options, controls, desk, keep)?;
    let interrupt = options
        .interruptible
        .then(|| Interrupt::listen(Arc::clone(&control), ui.stop_button.clone()))
        .transpose()
        .map_err(|e| not_created("interrupt", &e.to_string()))?;
    let channels = OperatorChannels {
        ui: ui.handle.clone(),
        stop_button: ui.stop_button.clone(),
        stop_signal: ui.stop_signal.clone(),
        to_task: attended.then_some(inputs),
        tempo: tempo.clone(),
        recorder: recorder.clone(),
        playback,
        tape,
        journal: Logbook::default(),
        judge,
        troubles: Troubles {
            emergency: ui.stop_button.clone(),
            disk: recorder.full().unwrap_or_default(),
            ..Troubles::new(scenario.controller.cell.cameras.len())
        },
    };
    // Whatever goes wrong from here on, the faces are told.
    let (goal, done) = match carried_out(scenario, options, &control, &files, channels) {
        Ok(done) => done,
        Err(error) => {
            ui.over(broken_off(&error));
            let came = interrupt.is_some_and(|i| i.came());
            let error = if came { interrupted(error) } else { error };
            let (period, summary) = (recorder.latest(), not_begun(scenario, &error));
            recorder.note(period, || Entry::Phase("end".to_owned(), error.to_string()));
            recorder
                .note(period, || Entry::Facts("summary", vec![("json".into(), summary.json())]));
            return Err(error);
        }
    };
    let worked = tempo.worked().saturating_duration_since(begun);
    let mut summary = summary(scenario, goal, &done, worked.as_secs_f64());
    if summary.ended_by == EndedBy::Operator && interrupt.is_some_and(|i| i.came()) {
        summary.ended_by = EndedBy::Interrupt;
        if summary.outcome != Outcome::Solved {
            // Where the cube is stays.
            summary.reason = summary.reason.replacen(BY_OPERATOR, "interrupted", 1);
        }
    }
    ui.over(outcome(&summary));
    let period = (summary.sim_time_s / PERIOD).round() as u64;
    let word = outcome(&summary).verdict;
    recorder.note(period, || Entry::Phase("end".to_owned(), word));
    recorder.note(period, || Entry::Facts("summary", vec![("json".into(), summary.json())]));
    Ok(summary)
}

/// What a run comes to whose task never began.
#[must_use]
pub fn not_begun(scenario: &Scenario, error: &Error) -> Summary {
    let ended_by = match error {
        Error::NonFatal { cause: NonFatal::Terminated, .. } => EndedBy::Operator,
        Error::NonFatal { cause: NonFatal::Interrupted, .. } => EndedBy::Interrupt,
        Error::NonFatal { .. } => EndedBy::Task,
        Error::Fatal { .. } => EndedBy::Fatal,
        Error::System { .. } => EndedBy::System,
    };
    let cube = (!scenario.bridge.kind.is_hardware()).then(|| scenario.cube().to_string());
    let (task, reason) = (scenario.controller.task.word(), error.to_string());
    Summary::not_started(task, scenario.seed, cube.as_deref(), &reason, ended_by)
}

/// Creates the world and the controller, and lets them run to their end.
fn carried_out(
    scenario: &Scenario,
    options: RunOptions,
    control: &Arc<watch::Sender<Control>>,
    files: &Keep,
    mut desk: OperatorChannels,
) -> Result<(Option<Goal>, Done), Error> {
    let plan = Plan::of(scenario)?;
    let goal = settings::goal(&scenario.controller, plan.angle);
    // First of all: what another run has left, or still writes, is not to be lost.
    let claim = |path: &PathBuf| Kept::claim(path, scenario.pace, desk.ui.clone());
    let kept = files.world.as_ref().map(claim).transpose()?;
    desk.journal = Logbook::of(files)?;
    let mut noted = None;
    let (world, cameras) = if let Some(playback) = &desk.playback {
        World::of_recording(scenario, playback.clone(), control)
    } else if scenario.bridge.kind.is_hardware() {
        let (world, cameras, notes) = World::of_hardware(scenario, control)?;
        noted = notes;
        (world, cameras)
    } else {
        let mut plant = plan.plant(scenario)?;
        if let Some(kept) = &kept {
            plant = kept.taken_up(plant, files.resume, desk.journal.last.is_some())?;
        }
        let (world, cameras) = World::of_plant(scenario, plant, control, &desk.troubles)?;
        (world.keeping(kept)?, cameras)
    };
    // From here on the controller: the world has its truth.
    let believed = super::calibrate::believed(scenario);
    if let Cow::Owned(Scenario { controller, .. }) = &believed {
        let facts = || Entry::Facts(calibration::NAME, calibration::facts(&controller.cell));
        desk.recorder.note(0, facts);
        if let Some(board) = desk.ui.board() {
            board.latest().calibrated = Some(Box::new(controller.cell.clone()));
        }
    }
    let scenario = &*believed;
    let mut builder = tokio::runtime::Builder::new_current_thread();
    builder.enable_time().start_paused(scenario.pace == Pace::Virtual);
    if scenario.bridge.kind.is_hardware() {
        // Pictures and plans, not the actors, whose heart beat the servo waits for.
        builder.on_thread_start(driver::step_back);
    }
    let runtime = builder.build().map_err(|e| not_created("runtime", &e.to_string()))?;
    let teller = noted.map(|noted| Teller::start(noted, &scenario.controller));
    let done =
        runtime.block_on(perform(scenario, options, control, (world, cameras), goal, plan, desk));
    drop(teller);
    done.map(|done| (goal, done))
}

/// The operator's side of a run.
struct OperatorChannels {
    ui: notice::UiHandle,
    stop_button: StopButton,
    stop_signal: StopSignal,
    /// Answers and orders to MP; `None` when no operator can be asked.
    to_task: Option<mpsc::Receiver<Input>>,
    tempo: Tempo,
    recorder: Recorder,
    playback: Option<Playback>,
    tape: RunHash,
    journal: Logbook,
    judge: Option<Judge>,
    troubles: Troubles,
}

/// A run's journal, and what another run noted last.
#[derive(Default)]
struct Logbook {
    journal: Option<Journal>,
    /// Whether this run goes on where another was broken off.
    resumes: bool,
    last: Option<tasks::Entry>,
}

impl Logbook {
    fn of(files: &Keep) -> Result<Self, Error> {
        let Some(path) = &files.journal else { return Ok(Self::default()) };
        let failed = |why: String| not_created("journal", &format!("{}: {why}", path.display()));
        let last = if files.resume {
            Journal::last(path).map_err(|why| failed(why.to_string()))?
        } else {
            None
        };
        let journal = Journal::open(path, files.resume).map_err(|why| failed(why.to_string()))?;
        Ok(Self { journal: Some(journal), resumes: files.resume, last })
    }
}

fn create_ui(
    scenario: &Scenario,
    options: RunOptions,
    controls: ui::OperatorControls,
    desk: Option<RunEnd>,
    (recorder, tape): (Recorder, RunHash),
) -> Result<ui::Ui, Error> {
    controls.tempo.set(options.speed);
    let board = desk.as_ref().map(|_| Board::default());
    let presenter = desk.as_ref().zip(board.clone()).map(|(desk, board)| {
        let (presenter, stage) = Presenter::new(scenario, board);
        desk.stage.send_replace(Arc::new(stage));
        presenter
    });
    let parts = ui::Parts {
        quiet: options.quiet,
        keys: !options.automatic,
        controls,
        desk,
        presenter,
        board,
        recorder,
        tape,
    };
    ui::Ui::spawn(parts).map_err(|e| not_created("ui", &e.to_string()))
}

/// An early end that a signal asked for.
fn interrupted(error: Error) -> Error {
    match error {
        Error::NonFatal { actor, place, cause: NonFatal::Terminated } => {
            Error::NonFatal { actor, place, cause: NonFatal::Interrupted }
        }
        other => other,
    }
}

/// What the operator is shown at the end.
pub(super) fn outcome(summary: &Summary) -> OutcomeView {
    let verdict = match (summary.outcome, summary.task.as_str()) {
        (Outcome::Solved, "solve") => "solved",
        (Outcome::Solved, _) => "done",
        (Outcome::Failed, _) => "failed",
        (Outcome::Aborted, _) => "aborted",
    };
    let mut figures = vec![
        ("simulated time".to_owned(), format!("{:.1} s", summary.sim_time_s)),
        ("times real time".to_owned(), format!("{:.1}", summary.real_time_factor())),
        ("turns".to_owned(), summary.turns.to_string()),
        ("grasps".to_owned(), summary.grasps.to_string()),
        ("begun anew".to_owned(), summary.recoveries.to_string()),
        ("executed".to_owned(), summary.executed.clone()),
    ];
    for sensor in &summary.sensors {
        figures.push((
            format!("{} felt at most", sensor.effector),
            format!("{:.1} N, {:.2} Nm", sensor.felt_force_n, sensor.felt_torque_nm),
        ));
    }
    figures.push(("hash".to_owned(), summary.hash.clone()));
    figures.push(("servo hash".to_owned(), summary.servo_hash.clone()));
    OutcomeView {
        verdict: verdict.to_owned(),
        good: summary.outcome == Outcome::Solved,
        reason: summary.reason.clone(),
        time: Some(summary.sim_time_s),
        figures,
    }
}

fn broken_off(error: &Error) -> OutcomeView {
    OutcomeView {
        verdict: "aborted".to_owned(),
        good: false,
        reason: error.to_string(),
        time: None,
        figures: Vec::new(),
    }
}

/// Where the arms can meet, and how a face turn begins: from the belief alone.
pub(super) struct Plan {
    meetings: Option<MeetingTable>,
    face_turn: Option<settings::FaceTurnStart>,
    angle: f64,
}

impl Plan {
    pub(super) fn of(scenario: &Scenario) -> Result<Self, Error> {
        let config = &scenario.controller;
        let meetings = (config.cell.arms.len() == 2)
            .then(|| super::meeting_cache::of(&config.cell, &ReachSettings::default()));
        let face_turn = (config.task == keys::Task::FaceTurn)
            .then(|| {
                let meetings = meetings.as_ref().ok_or("both arms are needed".to_owned())?;
                settings::face_turn_start(meetings, config.face_turn.angle)
            })
            .transpose()
            .map_err(|why| not_created("task", &why))?;
        let (face_turn, angle) =
            face_turn.map_or((None, 0.0), |(start, angle)| (Some(start), angle));
        Ok(Self { meetings, face_turn, angle })
    }

    /// The plant that such a run begins in.
    pub(super) fn plant(&self, scenario: &Scenario) -> Result<Plant, Error> {
        super::simulation::create(scenario, self.meetings.as_ref(), self.face_turn.as_ref())
            .map_err(|why| not_created("plant", &why))
    }
}

/// Puts into the log what a bridge notices, once a second.
struct Teller {
    stop: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Teller {
    fn start(mut noted: rtrb::Consumer<Note>, config: &ControllerConfig) -> Self {
        let names: Vec<_> = config.cell.arms.iter().map(|arm| arm.name.clone()).collect();
        let stop = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let mut digest = note::Digest::new(names);
            let mut last = false;
            while !last {
                last = ends.load(Ordering::Acquire);
                for sentence in digest.sentences(&mut noted, last) {
                    tracing::warn!("{sentence}");
                }
                std::thread::park_timeout(Duration::from_secs(u64::from(!last)));
            }
        });
        Self { stop, thread: Some(thread) }
    }
}

impl Drop for Teller {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // Its own message has told of a panic.
            let _ = thread.join();
        }
    }
}

pub(super) fn not_created(who: &str, why: &str) -> Error {
    let cause = System::NotCreated { who: who.into(), why: why.into() };
    Error::System { actor: "supervisor".into(), place: "create", cause }
}

/// All that is known at the end.
struct Done {
    ending: mp::Ending,
    task: MissionLog,
    /// Of a plant: the cube at the beginning, what happened to it, jams. Nobody knows them of hardware.
    truth: Option<Truth>,
    /// When MP's work ended, by [`Tempo::worked`].
    ended: Instant,
    /// Where the cube is, as the controller believes.
    whereabouts: String,
    /// The operator moved the arms by hand: only the operator ends that.
    by_hand: bool,
    hash: String,
    servo_hash: String,
}

/// What a plant knows at the end.
struct Truth {
    start: Facelets,
    /// Distance of the nearest tool from the cube's centre at the beginning [m].
    clearance: f64,
    verdict: Verdict,
    jams: u32,
}

/// Whichever task MP performs.
enum Kernel {
    Cube(Box<Mission>),
    Idle(Idle),
    Panel(Panel),
}

fn cube_kernel(
    config: &ControllerConfig,
    meetings: Option<MeetingTable>,
    assignment: Assignment,
) -> Result<Mission, Error> {
    let settings = meetings
        .and_then(|meetings| {
            settings::cube_settings(config, meetings, ReachSettings::default().back)
        })
        .ok_or_else(|| not_created("task", "the cube task needs two effectors"))?;
    Ok(Mission::new(settings, assignment))
}

/// Whichever driver of time runs the servos.
enum Driver {
    Virtual(tokio::task::JoinHandle<(World, Result<u64, crate::hw::port::PortFault>)>),
    Wall(driver::Wall<World>, std::thread::JoinHandle<()>),
}

async fn perform(
    scenario: &Scenario,
    options: RunOptions,
    outer: &Arc<watch::Sender<Control>>,
    (mut world, mut cameras): (World, Cameras),
    goal: Option<Goal>,
    plan: Plan,
    desk: OperatorChannels,
) -> Result<Done, Error> {
    let config = &scenario.controller;
    let start = world
        .verdict()
        .map(|verdict| Facelets::try_from(verdict.facelets))
        .transpose()
        .map_err(|e| not_created("plant", &e.to_string()))?;
    let clearance = world.scene().map(|scene| clearance(&scene));
    let OperatorChannels {
        ui,
        mut stop_button,
        mut stop_signal,
        mut to_task,
        tempo,
        recorder,
        playback,
        tape,
        journal,
        ..
    } = desk;
    let (mut judge, troubles) = (desk.judge, desk.troubles);
    let by_hand = goal.is_none() && to_task.is_some();
    // Before the start there is no time: a run does not depend on when it was started.
    let (mut start_of, waits) = (outer.subscribe(), Instant::now());
    if start_of.wait_for(|will| *will != Control::Waiting).await.is_err() {
        return Err(not_created("control", "nobody is left to start the run"));
    }
    tempo.held_back(waits.elapsed());
    // Whoever is quick, or has a slow machine, has started it before it came here.
    if options.wait && *outer.borrow() == Control::Running {
        recording::started(&recorder);
    }
    let mut control = Arc::clone(outer);
    let mut gate = None;
    if scenario.pace == Pace::Virtual {
        control = Arc::new(watch::channel(Control::Running).0);
        let stop = EmergencyStop::default();
        stop_button = stop.button();
        let outer_stop = std::mem::replace(&mut stop_signal, stop.signal());
        let outer_inputs = to_task.take();
        let (to_mp, inner_inputs) = mpsc::channel(4);
        to_task = outer_inputs.is_some().then_some(inner_inputs);
        let inner = Inner { control: Arc::clone(&control), stop, to_task: to_mp };
        let outer = Outer { control: outer.subscribe(), stop: outer_stop, to_task: outer_inputs };
        let (recorder, playback) = (recorder.clone(), playback.clone());
        gate = Some(Gate { outer, inner, recorder, playback });
    }
    let will = control.subscribe();
    let switches = Arc::new(Switches::new(stop_signal.clone()));

    // Servos and their driver.
    let length = Length::of_seconds(scenario.real_time.period);
    let configs: Vec<_> = config
        .cell
        .arms
        .iter()
        .zip(&config.effectors)
        .map(|(arm, effector)| ServoConfig {
            period: length,
            ..ServoConfig::new(arm, effector.gains.clone())
        })
        .collect();
    let (mut links, ends): (Vec<ServoLink>, Vec<_>) =
        configs.iter().map(|_| driver::link_at(length)).unzip();
    let spoilt = ForceSettings {
        sign: f64::from(config.control.force_sign),
        delay_periods: config.control.force_delay_periods,
    };
    for link in &mut links {
        if spoilt != ForceSettings::default() {
            link.send(ServoCommand::ForceSettings(spoilt))
                .map_err(|e| not_created("servo", &e.to_string()))?;
        }
    }
    // A verification waits for nobody.
    let mut pacer = playback.is_none().then(|| Pacer::new(tempo.clone(), control.subscribe()));
    let turning = Turning::default();
    let witness = Arc::new(Mutex::new(Witness::new(turning.clone(), control.subscribe())));
    let seeing = Arc::clone(&witness);
    let scenes = recorder.clone();
    let mut tattler = super::simulation::Tattler::new(scenario, recorder.clone());
    let mut observe = move |period: u64, world: &mut World| {
        let Some(turned) = world.show() else { return };
        // Nobody else takes the lock before the end.
        let tick = length.tick(period);
        if tick.is_multiple_of(recording::SCENES) {
            scenes.note_some(tick, || world.scene().map(|scene| Entry::Scene(Box::new(scene))));
            tattler.look(tick, world.plant());
        }
        seeing.lock().unwrap_or_else(PoisonError::into_inner).look(tick, turned);
    };
    let clock = Clock::new(tokio::time::Instant::now(), Arc::clone(&switches));
    if scenario.pace == Pace::RealTime && recorder.is_on() {
        let outer = Outer { control: outer.subscribe(), stop: stop_signal, to_task };
        to_task = recording::follow(outer, clock.clone(), recorder.clone());
    }
    let limit = scenario.missed_limit();
    let synchronised: Vec<bool>;
    let driver = match scenario.pace {
        Pace::Virtual => {
            let seen = Box::new(Seen { to: tape.clone(), board: ui.board().cloned() });
            let seen = recording::with_playback(recording::kept(seen, &recorder), playback.clone());
            let mut core = Core::new(configs, ends, Arc::clone(&switches), seen, &mut world)
                .map_err(|e| not_created("servo", &e.to_string()))?;
            synchronised = core.synchronised().collect();
            Driver::Virtual(tokio::spawn(async move {
                let result = driver::run_virtual(&mut core, &mut world, limit, |period, world| {
                    if period % 50 == 0
                        && tracing::enabled!(target: "rubik_robot::truth", tracing::Level::TRACE)
                    {
                        world.trace(period);
                    }
                    observe(period, world);
                    if let (Some(judge), Some(plant)) = (&mut judge, world.plant()) {
                        judge(period, plant);
                    }
                    if let Some(gate) = &mut gate {
                        gate.pass(length.tick(period));
                    }
                    // While the operator pauses, the cell goes on in real time, not as fast as it computes.
                    if let Some(pacer) = &mut pacer {
                        pacer.hold(length.tick(period) as f64 * PERIOD);
                    }
                })
                .await;
                (world, result)
            }))
        }
        Pace::RealTime => {
            // Half a second of records: the writer may be late, the servo never waits for it.
            let (records, mut written) =
                rtrb::RingBuffer::<ServoRecord>::new(512 * configs.len().max(1));
            let records = recording::kept(Box::new(records), &recorder);
            let core = Core::new(configs, ends, Arc::clone(&switches), records, &mut world)
                .map_err(|e| not_created("servo", &e.to_string()))?;
            synchronised = core.synchronised().collect();
            if let Some(board) = ui.board() {
                board.latest().punctual = Some((Arc::clone(&switches), scenario.real_time.period));
            }
            let mut sink = Seen { to: tape.clone(), board: ui.board().cloned() };
            let writer = std::thread::spawn(move || {
                while !written.is_abandoned() || !written.is_empty() {
                    while let Ok(record) = written.pop() {
                        sink.record(&record);
                    }
                    std::thread::sleep(Duration::from_millis(20));
                }
            });
            let wall = driver::spawn_wall(core, world, observe, settings::wall(scenario, options))
                .map_err(|e| not_created("servo thread", &e.to_string()))?;
            clock.begins();
            for warning in &wall.warnings {
                tracing::warn!("not real time: {warning}; `rubik-robot doctor` says what helps");
            }
            Driver::Wall(wall, writer)
        }
    };

    let beats = Arc::clone(&switches);
    let heart = Arc::clone(&troubles.heart);
    tokio::spawn(async move {
        loop {
            if !heart.load(Ordering::Acquire) {
                beats.beats.fetch_add(1, Ordering::Relaxed);
            }
            tokio::time::sleep(HEART_BEAT).await;
        }
    });

    // An actor that panics makes the arms hold at once; MP hears of it, too, and ends the run.
    let alarm = Alarm::default();
    let (mut listens, holds) = (alarm.listen(), Arc::clone(&switches));
    tokio::spawn(async move {
        raised(&mut listens).await;
        holds.hold.store(true, Ordering::Release);
    });
    // Who is stuck holds the runtime, and with it the run: whoever began it must end it. The servo's thread, which misses the
    // heart beat, still switches the drives off; the controllers keep the last drive of a process that is no more.
    let button = stop_button.clone();
    let outside = options.stuck.map(|stuck| {
        alarm.watched_from_outside(patience_outside(scenario.pace), move |error| {
            button.press();
            std::thread::sleep(SWITCHES_OFF);
            stuck(error);
        })
    });
    let patience = if scenario.pace == Pace::Virtual { Care::VIRTUAL } else { Care::PATIENCE };
    let care = |mishap: Option<&Arc<Mishap>>| Care {
        alarm: alarm.clone(),
        mishap: mishap.cloned().unwrap_or_default(),
        patience,
    };

    // Actors, from the bottom up.
    let work = Work(scenario.pace);
    let edps: Vec<_> = config
        .cell
        .arms
        .iter()
        .zip(links)
        .enumerate()
        .map(|(i, (arm, link))| {
            let care = care(troubles.edps.get(i));
            edp::spawn_under(&arm.name, link, clock.clone(), tape.clone(), &care)
        })
        .collect();
    let guard = Guard::of(&config.cell, config.control.hand_speed);
    let guard = if by_hand { guard.by_hand() } else { guard };
    let states = edps.iter().map(edp::EdpHandle::watch).collect();
    let apart = lookout::Apart::default();
    let watching = lookout::watch_over(
        guard.clone(),
        states,
        stop_button,
        ui.clone(),
        clock.clone(),
        (apart.clone(), alarm.clone()),
    );
    alarm.spawn("guard", watching);
    // By hand, the operator decides when an arm is synchronised.
    let blind: Vec<usize> = (0..edps.len()).filter(|&i| !synchronised[i] && !by_hand).collect();
    let goes_on = journal.last.as_ref().is_some_and(|last| !last.over);
    if let Some(&i) = blind.first().filter(|_| goes_on) {
        // Homing drives axes to their switches, and jaws open, with whatever they hold; and nobody has looked yet.
        switches.stop.store(true, Ordering::Release);
        let (actor, effector) = ("supervisor".to_owned(), config.cell.arms[i].name.clone());
        let cause = NonFatal::Lost { effector };
        return Err(Error::NonFatal { actor, place: "resume", cause });
    }
    for &i in &blind {
        let (edp, arm) = (&edps[i], &config.cell.arms[i]);
        let now = clock.period() as f64 * PERIOD;
        ui.tell(notice::Notice::Phase(now, format!("synchronise {}", arm.name)));
        let synchronised = tokio::select! {
            biased;
            error = alarm.raised() => Err(error),
            done = home(edp, control.subscribe(), &clock, &ui) => done,
        };
        if let Err(error) = synchronised {
            switches.stop.store(true, Ordering::Release);
            return Err(error);
        }
    }
    let mut sensors = Sensors::default();
    for (index, wanted) in config.vsps.iter().enumerate() {
        // Under continuous coordination the ECPs only transmit: all readings go to MP.
        let owner = if config.coordination == keys::Coordination::Continuous {
            Owner::Mp
        } else {
            wanted.owner
        };
        match (wanted.kind, wanted.camera) {
            (VspKind::Force, _) => {
                let states = edps.iter().map(edp::EdpHandle::watch).collect();
                sensors.forces =
                    Some(vsp::spawn_forces(&alarm, states, clock.clone(), periods(wanted.period)));
            }
            (kind, Some(camera)) => {
                let source = cameras[camera].take().ok_or_else(|| {
                    not_created(&config.vsps[index].name, "its camera belongs to another VSP")
                })?;
                let parts = vsp::Parts {
                    source,
                    intrinsics: config.cell.cameras[camera].intrinsics,
                    world_from_camera: match config.cell.cameras[camera].mount {
                        crate::cell::Mount::World { world_from_camera } => Some(world_from_camera),
                        crate::cell::Mount::Flange { .. } => None,
                    },
                    edge: config.cell.cube.edge,
                    method: settings::method(config),
                    localisation: Effort(config.vision.localisation),
                    face: Effort(config.vision.face),
                    frame_periods: periods(wanted.period),
                    clock: clock.clone(),
                    work,
                    tape: tape.clone(),
                    show: ui.board().map(|board| (board.clone(), camera)),
                    recorder: (recorder.clone(), camera),
                    playback: playback.clone(),
                    ui: ui.clone(),
                };
                let carrier = match config.cell.cameras[camera].mount {
                    crate::cell::Mount::Flange { arm, .. } => Some(arm),
                    crate::cell::Mount::World { .. } => None,
                };
                let handle = vsp::spawn(&wanted.name, parts, &care(troubles.vsps.get(camera)));
                sensors.add(kind, owner, carrier, handle);
            }
            (_, None) => return Err(not_created(&wanted.name, "it has no camera")),
        }
    }
    let manners: Vec<_> =
        (0..config.cell.arms.len()).map(|effector| settings::manner(config, effector)).collect();
    let ecps: Vec<_> = config
        .cell
        .arms
        .iter()
        .zip(&edps)
        .enumerate()
        .map(|(index, (arm, edp))| {
            let parts = ecp::Parts {
                edp: edp.clone(),
                tracker: sensors.tracker_of(Owner::Ecp(index)),
                hand_camera: sensors.hand_camera_of(Owner::Ecp(index), index),
                manner: manners[index],
                control: will.clone(),
                tape: tape.clone(),
            };
            ecp::spawn_under(&arm.name, parts, &care(troubles.ecps.get(index)))
        })
        .collect();

    // Homing leaves an axis at its switch; a task begins where the scenario says.
    for &i in &blind {
        let target = config.cell.arms[i].start;
        let home = Behaviour::Joints { target, speed: 0.5, seconds: 0.0 };
        let begins = tokio::select! {
            biased;
            error = alarm.raised() => Err(error),
            done = ecps[i].behave(home) => done,
        };
        if let Err(error) = begins {
            switches.stop.store(true, Ordering::Release);
            return Err(error);
        }
    }
    let mut kernel = match goal {
        None if by_hand => Kernel::Panel(settings::panel(config)),
        None => Kernel::Idle(Idle::new(config.idle.time)),
        Some(goal) => {
            let held = plan.face_turn.map(|f| (Hand::Postument, f.body, f.half_roll));
            let patience = to_task.is_some().then_some(PATIENCE);
            let mut assignment = Assignment { held, patience, ..Assignment::new(goal) };
            if journal.resumes {
                assignment = assignment.resumed(journal.last);
            }
            Kernel::Cube(Box::new(cube_kernel(config, plan.meetings, assignment)?))
        }
    };
    let mp = Mp::new(mp::Parts {
        turning,
        forces: sensors.forces.take(),
        ecps,
        tracker: sensors.tracker_of(Owner::Mp),
        hand_cameras: std::array::from_fn(|arm| sensors.hand_camera_of(Owner::Mp, arm)),
        coordination: match config.coordination {
            keys::Coordination::Continuous => Coordination::Continuous,
            keys::Coordination::Sporadic => Coordination::Sporadic,
        },
        manners,
        control: will,
        ui: ui.clone(),
        operator: to_task,
        tempo: tempo.clone(),
        clock: clock.clone(),
        work,
        tape: tape.clone(),
        journal: journal.journal,
        guard: Some(guard),
        apart,
    })
    .heeding(&care(Some(&troubles.mp)));
    let span = tracing::info_span!("mp");
    let mut whereabouts = String::new();
    let (ending, log) = match &mut kernel {
        Kernel::Idle(idle) => {
            (survived(mp.run(idle).instrument(span), &clock, &ui).await, MissionLog::default())
        }
        Kernel::Panel(panel) => {
            (survived(mp.run(panel).instrument(span), &clock, &ui).await, MissionLog::default())
        }
        Kernel::Cube(mission) => {
            let ending = survived(mp.run(mission.as_mut()).instrument(span), &clock, &ui).await;
            whereabouts = mission.whereabouts();
            (ending, mission.log())
        }
    };
    // Who panicked at work stays at it.
    drop(outside);
    let ended = tempo.worked();
    if matches!(ending.error, Some(Error::System { .. })) {
        // Nobody moves the arms any more, whatever the actors that are left would have them do.
        switches.hold.store(true, Ordering::Release);
    }
    if ending.error.is_some() {
        // Power off under a moving arm is no safe end: what was broken off comes to a stand first.
        tokio::time::sleep(Duration::from_secs_f64(STAND)).await;
    }
    if ending.finish.as_ref().is_some_and(|f| f.achieved) && goal == Some(Goal::Solve) {
        tokio::time::sleep(Duration::from_secs_f64(WITHDRAWAL)).await;
    }
    switches.stop.store(true, Ordering::Release);
    let (world, fault) = match driver {
        Driver::Virtual(servo) => {
            let (world, result) = servo.await.map_err(|e| not_created("servo", &e.to_string()))?;
            (world, result.err())
        }
        Driver::Wall(wall, writer) => {
            let WallEnd { port, fault, timing } = wall.stop();
            recorder.note((ending.end / PERIOD) as u64, || recording::timing(&timing));
            for line in timing.to_string().lines() {
                ui.tell(notice::Notice::Note(ending.end, format!("servo: {line}")));
            }
            tokio::task::yield_now().await;
            let _ = writer.join();
            (port.ok_or_else(|| not_created("bridge", "its thread died"))?, fault)
        }
    };
    let verdict = world.verdict();
    tracing::debug!(?verdict, "world at the end");
    let mut ending = ending;
    let (_, _, missed) = switches.punctual.take();
    if missed > 0 && scenario.pace == Pace::Virtual {
        let text = format!("servo: {missed} periods missed; the last set values held meanwhile");
        ui.tell(notice::Notice::Warning(ending.end, text));
    }
    if let Some(fault) = fault {
        let cause = Fatal::Bridge(fault.to_string());
        ending.error =
            Some(Error::Fatal { actor: "supervisor".into(), place: "servo", cause, last: None });
    }
    let jams = witness.lock().unwrap_or_else(PoisonError::into_inner).jams;
    let clearance = clearance.unwrap_or(f64::INFINITY);
    let truth =
        start.zip(verdict).map(|(start, verdict)| Truth { start, clearance, verdict, jams });
    Ok(Done {
        ending,
        task: log,
        truth,
        ended,
        whereabouts,
        by_hand,
        hash: tape.hash(),
        servo_hash: tape.servo_hash(),
    })
}

/// Synchronises an arm: the operator may pause it, and terminate the run before it is done.
async fn home(
    edp: &edp::EdpHandle,
    mut control: watch::Receiver<Control>,
    clock: &Clock,
    ui: &notice::UiHandle,
) -> Result<(), Error> {
    loop {
        match permission_soon(&mut control).await {
            Some(Ok(())) => {}
            Some(Err(_)) => {
                let cause = NonFatal::Terminated;
                let actor = "supervisor".into();
                return Err(Error::NonFatal { actor, place: "synchronise", cause });
            }
            // A fault must not wait for the operator.
            None => {
                edp.state().await?;
                continue;
            }
        }
        if homed(edp.synchronise(), &mut control, clock).await? {
            return Ok(());
        }
        ui.tell(notice::Notice::Note(clock.period() as f64 * PERIOD, homing::STANDS.to_owned()));
    }
}

/// How MP's work ended, even when it ended in a panic.
async fn survived(
    work: impl Future<Output = mp::Ending>,
    clock: &Clock,
    ui: &notice::UiHandle,
) -> mp::Ending {
    match Caught(Box::pin(work)).await {
        Ok(ending) => ending,
        Err(why) => {
            let (end, error) = (clock.period() as f64 * PERIOD, panicked("mp", &*why));
            ui.tell(notice::Notice::Error(end, error.clone()));
            mp::Ending::broken(end, error)
        }
    }
}

/// After how long, by the wall clock, an actor counts as stuck that lets no other one get on. Arms hold after 0.1 s without a
/// heart beat, and stop after 1 s; no arm waits for virtual time, and a busy machine takes its own.
fn patience_outside(pace: Pace) -> Duration {
    Duration::from_secs(if pace == Pace::Virtual { 10 } else { 1 })
}

fn periods(seconds: f64) -> u64 {
    (seconds / PERIOD).round().max(1.0) as u64
}

/// The VSPs by owner.
#[derive(Default)]
struct Sensors {
    trackers: Vec<(Owner, VspHandle)>,
    hand_cameras: Vec<(Owner, usize, VspHandle)>,
    forces: Option<watch::Receiver<Forces>>,
}

impl Sensors {
    fn add(&mut self, kind: VspKind, owner: Owner, carrier: Option<usize>, handle: VspHandle) {
        match (kind, carrier) {
            (VspKind::Cube, _) => self.trackers.push((owner, handle)),
            (VspKind::Face, Some(arm)) => self.hand_cameras.push((owner, arm, handle)),
            (VspKind::Face | VspKind::Force, _) => {}
        }
    }

    fn tracker_of(&self, owner: Owner) -> Option<VspHandle> {
        self.trackers.iter().find(|(o, _)| *o == owner).map(|(_, handle)| handle.clone())
    }

    fn hand_camera_of(&self, owner: Owner, arm: usize) -> Option<VspHandle> {
        self.hand_cameras
            .iter()
            .find(|(o, a, _)| *o == owner && *a == arm)
            .map(|(_, _, handle)| handle.clone())
    }
}

fn summary(scenario: &Scenario, goal: Option<Goal>, done: &Done, wall_time_s: f64) -> Summary {
    let truth = done.truth.as_ref();
    let verdict = truth.map(|truth| &truth.verdict);
    let ending = &done.ending;
    let end = truth.map(|t| Facelets::try_from(t.verdict.facelets).unwrap_or(t.start));
    let turned_deg = match goal {
        // The turner holds the upper layer: clockwise seen from outside is negative about +z, and `turned` is the
        // body's part against the turner's. Positive is the asked sense.
        Some(Goal::FaceTurn(angle)) => verdict.map(|v| v.turned.to_degrees() * angle.signum()),
        Some(Goal::Solve | Goal::Acquire) | None => None,
    };
    let (outcome, reason, ended_by) = verdict_of(goal, done, end.as_ref(), turned_deg);
    let ends = ending.phases.iter().skip(1).map(|p| (p.1, p.2)).chain([(ending.end, done.ended)]);
    let phases = ending
        .phases
        .iter()
        .zip(ends)
        .map(|((name, begin, began), (end, ended))| Phase {
            name: (*name).into(),
            sim_time_s: end - begin,
            wall_time_s: ended.saturating_duration_since(*began).as_secs_f64(),
        })
        .collect();
    let counts = verdict.map(|v| v.counts);
    Summary {
        outcome,
        reason,
        ended_by,
        task: scenario.controller.task.word().to_owned(),
        seed: scenario.seed,
        cube_start: truth.map(|t| t.start.to_string()),
        cube_end: end.map(|end| end.to_string()),
        identified: done.task.identified.clone(),
        solution: done.task.identified.as_ref().map(|_| format_turns(&done.task.solution)),
        executed: format_turns(&done.task.executed),
        turns: done.task.executed.len() as u32,
        grasps: done.task.grasps,
        recoveries: done.task.recoveries,
        sim_time_s: ending.end,
        wall_time_s,
        peak_force_n: verdict.map(|v| v.peak_force),
        peak_torque_nm: verdict.map(|v| v.peak_torque),
        sensors: (0..scenario.controller.cell.arms.len().min(2))
            .map(|i| SensorPeak {
                effector: scenario.controller.cell.arms[i].name.clone(),
                force_n: verdict.map(|v| v.arm_peak_force[i]),
                torque_nm: verdict.map(|v| v.arm_peak_torque[i]),
                felt_force_n: ending.felt.arms[i].peak_force,
                felt_torque_nm: ending.felt.arms[i].peak_torque,
            })
            .collect(),
        jams: truth.map(|t| t.jams),
        slips: counts.map(|c| c.slips),
        drops: counts.map(|c| c.drops),
        drops_noticed: Some(done.task.drops),
        returned: verdict.map(Verdict::is_back),
        force_limit_n: Some(scenario.controller.control.force_limit),
        clearance_mm: truth.map(|t| t.clearance * 1e3).filter(|mm| mm.is_finite()),
        pops: counts.map(|c| c.pops),
        crushed: counts.map(|c| c.crushed),
        collisions: counts.map(|c| c.collisions),
        accidents: verdict.map(|v| accidents(v, scenario)),
        turned_deg,
        phases,
        hash: done.hash.clone(),
        servo_hash: done.servo_hash.clone(),
    }
}

/// Distance of the nearest tool from the cube's centre [m].
fn clearance(scene: &Scene) -> f64 {
    let cube = scene.cube.world_from_cube.translation.vector;
    let arms = scene.arms.iter().take(scene.arm_count);
    let distance = |arm: &SceneArm| (arm.world_from_tool.translation.vector - cube).norm();
    arms.map(distance).fold(f64::INFINITY, f64::min)
}

fn accidents(verdict: &Verdict, scenario: &Scenario) -> Vec<Accident> {
    let arms = &scenario.controller.cell.arms;
    let names: Vec<&str> = arms.iter().map(|arm| arm.name.as_str()).collect();
    let period = Length::of_seconds(scenario.real_time.period).seconds();
    let told = verdict.told(&names, period).filter(|(_, is_accident, _)| *is_accident);
    told.map(|(time_s, _, what)| Accident { time_s, what }).collect()
}

/// Where the cube is, to be put after a reason.
fn placed(whereabouts: &str) -> String {
    if whereabouts.is_empty() { String::new() } else { format!("; {whereabouts}") }
}

/// The verdict: what was asked must be so in the plant, whatever the controller believes. Of hardware there is only
/// the controller's word.
fn verdict_of(
    goal: Option<Goal>,
    done: &Done,
    end: Option<&Facelets>,
    turned_deg: Option<f64>,
) -> (Outcome, String, EndedBy) {
    let ending = &done.ending;
    if let Some(error) = &ending.error {
        let ended_by =
            if matches!(error, Error::System { .. }) { EndedBy::System } else { EndedBy::Fatal };
        return (Outcome::Aborted, format!("{error}{}", placed(&done.whereabouts)), ended_by);
    }
    if ending.finish.is_none() && done.by_hand {
        let reason = "the arms were moved by hand until the operator ended it".to_owned();
        return (Outcome::Solved, reason, EndedBy::Operator);
    }
    let Some(finish) = &ending.finish else {
        let reason = format!("{BY_OPERATOR}{}", placed(&done.whereabouts));
        return (Outcome::Aborted, reason, EndedBy::Operator);
    };
    let (Some(Truth { verdict, jams, .. }), Some(end)) = (&done.truth, end) else {
        let outcome = if finish.achieved { Outcome::Solved } else { Outcome::Failed };
        let reason = format!("{}, by the controller's own account", finish.reason);
        return (outcome, reason, EndedBy::Task);
    };
    let (right, truth) = match goal {
        None => (true, finish.reason.clone()),
        Some(Goal::Solve) => {
            (end.is_solved() && verdict.is_back(), verdict_words(end.is_solved(), verdict))
        }
        Some(Goal::Acquire) => (verdict.is_back(), verdict_words(true, verdict)),
        Some(Goal::FaceTurn(angle)) => {
            let turned = turned_deg.unwrap_or(0.0);
            let gentle = verdict.peak_force < EXCESSIVE;
            let right = (turned - angle.abs().to_degrees()).abs() < 5.0 && *jams == 0 && gentle;
            let force = if gentle { "" } else { ", with excessive force" };
            let slip = if verdict.counts.slips > 0 { ", and a grip slipped" } else { "" };
            (
                right,
                format!(
                    "the layer was turned by {turned:.1} deg of {:.0}{force}{slip}",
                    angle.abs().to_degrees()
                ),
            )
        }
    };
    match (finish.achieved, right) {
        (true, true) => (Outcome::Solved, truth, EndedBy::Task),
        (true, false) => (
            Outcome::Failed,
            format!("the controller believes it is done, but {truth}"),
            EndedBy::Task,
        ),
        (false, _) => (Outcome::Failed, finish.reason.clone(), EndedBy::Task),
    }
}

fn verdict_words(solved: bool, verdict: &Verdict) -> String {
    let state = if solved { "the cube is as wanted" } else { "the cube is not solved" };
    format!("{state} and {}", verdict.place())
}
