//! A recording shown again: page and terminal see it as they saw the run, with pause, speed and seek.
//!
//! - in: a recording, commands of the operator
//! - out: snapshots and pictures at a desk, by the presenter that a run has; nothing is computed anew

use super::board::{Board, Found, Seen, Sight};
use super::control::Control;
use super::present::Presenter;
use super::supervisor::outcome;
use super::ui::Notice;
use crate::cell::Cell;
use crate::desk::{Behind, desk};
use crate::hw::driver::{NoRecords, RecordSink, ServoRecord};
use crate::motion::{AXES, ArmFault, ArmState, JointPositions, Synchronisation};
use crate::operator::{Class, Command, ControlView, OutcomeView, Said, Services, Snapshot};
use crate::record::reading::{End, Label, Message, Piece, Reading, Unreadable};
use crate::record::sensed::{self, Sensed};
use crate::record::summary::Summary;
use crate::record::tick::Tick;
use crate::record::{belief, cdr};
use crate::scenario::Scenario;
use crate::servo::ServoCommand;
use crate::servo::io::Outside;
use crate::servo::period::Length;
use crate::tasks::Picture;
use std::io::Read;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Time between two snapshots.
const REFRESH: Duration = Duration::from_millis(50);
/// Periods of 2 ms between two states of an arm that are kept; what is largest in between is kept with them.
const STATES: u32 = 20;
/// As fast as it goes, in times of real time.
const FASTEST: f64 = 200.0;

/// A recording in memory, in the order of time.
pub struct Show {
    scenario: Scenario,
    title: String,
    events: Vec<(f64, What)>,
    end: f64,
    /// How it ended.
    outcome: OutcomeView,
}

/// What happens.
enum What {
    Arm(Box<ServoRecord>, String),
    Belief(Box<Picture>),
    Sight(usize, u64, Option<Arc<Vec<u8>>>, Found),
    Phase(String),
    Message(Class, String, String),
    Operator(String),
}

impl Show {
    /// Reads a recording of this scenario.
    ///
    /// # Errors
    /// [`Unreadable`].
    pub fn read<R: Read>(from: R, scenario: &Scenario, title: &str) -> Result<Self, Unreadable> {
        let mut show = Self {
            scenario: scenario.clone(),
            title: title.to_owned(),
            events: Vec::new(),
            end: 0.0,
            outcome: cut_off(""),
        };
        let mut label = Label::default();
        let mut loading = Loading::new(scenario);
        let mut start = None;
        let mut reading = Reading::new(from);
        for piece in reading.by_ref() {
            label.take(&piece);
            let Piece::Message(message) = piece else { continue };
            let start = *start.get_or_insert(message.time);
            let time = message.time.saturating_sub(start) as f64 * 1e-9;
            show.end = show.end.max(time);
            show.take(time, &message, &mut loading)
                .map_err(|why| Unreadable::Message { topic: message.channel.topic.clone(), why })?;
        }
        let summary: Option<Summary> = serde_json::from_str(label.of("summary", "json")).ok();
        let flaw = reading.end().and_then(End::flaw);
        let flaw = flaw.map(|(how, why)| {
            format!("the recording is {how} after {:.1} s: {why}", show.end)
        });
        show.outcome = match (summary, flaw) {
            (Some(summary), flaw) => {
                let told = flaw.map(|text| What::Message(Class::Warning, "ui".to_owned(), text));
                show.events.extend(told.map(|what| (show.end, what)));
                outcome(&summary)
            }
            (None, Some(flaw)) => cut_off(&flaw),
            (None, None) => cut_off("the recording does not say how the run ended"),
        };
        show.events.sort_by(|a, b| a.0.total_cmp(&b.0));
        Ok(show)
    }

    fn take(
        &mut self,
        time: f64,
        message: &Message,
        loading: &mut Loading,
    ) -> Result<(), cdr::Malformed> {
        let topic = message.channel.topic.as_str();
        let mut from = cdr::Reader::new(&message.data)?;
        match topic {
            "/belief" => {
                if let Some(picture) = belief::read(from.string()?) {
                    self.events.push((time, What::Belief(Box::new(picture))));
                }
            }
            "/phase" => {
                from.time()?;
                let name = from.string()?.to_owned();
                if from.string()?.is_empty() {
                    self.events.push((time, What::Phase(name)));
                }
            }
            "/rosout" => {
                from.time()?;
                let level = from.u8()?;
                let (who, text) = (from.string()?, from.string()?);
                let class = match level {
                    0..=20 => Class::Info,
                    21..=30 => Class::Warning,
                    31..=40 => Class::System,
                    _ => Class::Fatal,
                };
                // Phases tell of themselves.
                if !text.starts_with("phase: ") {
                    let what = What::Message(class, who.to_owned(), text.to_owned());
                    self.events.push((time, what));
                }
            }
            "/operator" => {
                from.time()?;
                from.u64()?;
                let words = Said::told(from.string()?);
                self.events.push((time, What::Operator(words)));
            }
            "/sensed" => {
                let sensed = Sensed::read(&message.data)?;
                if let Some(camera) = self.camera(&sensed.sensor) {
                    let found = match sensed.found {
                        Ok(sensed::Found::Cube { world_from_cube, speed, .. }) => {
                            Found::Cube(world_from_cube, speed)
                        }
                        Ok(sensed::Found::Face(face)) => Found::Face(Box::new(face)),
                        Err(why) => Found::Nothing(why),
                    };
                    loading.looked = Some((camera, self.events.len()));
                    self.events.push((time, What::Sight(camera, sensed.period, None, found)));
                }
            }
            _ if topic.ends_with("/image") => {
                from.header()?;
                from.string()?;
                let jpeg = Arc::new(from.u8_sequence()?.to_vec());
                // A picture follows what was found in it.
                if let Some((_, at)) = loading.looked.take()
                    && let Some((_, What::Sight(_, _, picture, _))) = self.events.get_mut(at)
                {
                    *picture = Some(jpeg);
                }
            }
            _ if topic.ends_with("/servo") => {
                let tick = Tick::read(&message.data)?;
                if let Some((record, fault)) = loading.tick(&tick) {
                    self.events.push((time, What::Arm(Box::new(record), fault)));
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// How it ended, in words.
    #[must_use]
    pub fn ending(&self) -> String {
        format!("{}: {}", self.outcome.verdict, self.outcome.reason)
    }

    fn camera(&self, sensor: &str) -> Option<usize> {
        let vsps = &self.scenario.controller.vsps;
        let name = sensor.strip_prefix("vsp ")?;
        vsps.iter().find(|vsp| vsp.name == name)?.camera
    }

    /// Shows it at a desk until somebody leaves, or `stop` is set; to its end only, unless `stays`.
    pub fn run(&self, behind: &Behind, speed: f64, stays: bool, stop: &AtomicBool) {
        let mut commands = behind.take_commands();
        let mut stand = Stand::new(self, behind);
        let (mut time, mut speed, mut paused) = (0.0, speed, false);
        let mut last = Instant::now();
        while !stop.load(Ordering::Acquire) {
            while let Some(command) = commands.as_mut().and_then(|c| c.try_recv().ok()) {
                match command {
                    Command::Start | Command::Resume => paused = false,
                    Command::Pause => paused = true,
                    Command::Speed { factor } if factor.is_finite() => speed = factor.max(0.0),
                    Command::Seek { time: to } if to.is_finite() => {
                        time = to.clamp(0.0, self.end);
                        stand = Stand { number: stand.number, ..Stand::new(self, behind) };
                    }
                    Command::Quit | Command::Terminate => return,
                    _ => {}
                }
            }
            let factor = if speed == 0.0 { FASTEST } else { speed };
            let passed = last.elapsed().as_secs_f64();
            last = Instant::now();
            if !paused {
                time = (time + factor * passed).min(self.end);
            }
            stand.show(time, paused, speed);
            if time >= self.end && !stays {
                return;
            }
            std::thread::sleep(REFRESH);
        }
    }
}

/// A run whose end nobody knows.
fn cut_off(reason: &str) -> OutcomeView {
    OutcomeView {
        verdict: "cut off".to_owned(),
        good: false,
        reason: reason.to_owned(),
        figures: Vec::new(),
    }
}

/// What is carried from tick to tick while a recording is read.
struct Loading {
    cell: Cell,
    /// Servo periods between two states.
    states: u64,
    arms: Vec<(ArmState, f64)>,
    /// The camera that looked last, and where its sight stands.
    looked: Option<(usize, usize)>,
}

impl Loading {
    fn new(scenario: &Scenario) -> Self {
        let cell = scenario.controller.cell.clone();
        let arms = cell.arms.iter().map(|_| (ArmState::default(), 0.0)).collect();
        let states = Length::of_seconds(scenario.real_time.period).count(STATES).into();
        Self { cell, states, arms, looked: None }
    }

    /// A state now and then, with the largest force in between.
    fn tick(&mut self, tick: &Tick) -> Option<(ServoRecord, String)> {
        let index = usize::from(tick.arm);
        let (arm, (state, most)) = (self.cell.arms.get(index)?, self.arms.get_mut(index)?);
        if let Ok(Some(ServoCommand::Move { command, start })) = tick.order() {
            state.command_end = start.max(tick.period) + u64::from(command.periods);
        }
        let force = tick.wrench_in_tool.force.norm();
        if force >= *most {
            (*most, state.wrench_in_tool) = (force, tick.wrench_in_tool);
        }
        if tick.period % self.states != 1 % self.states {
            return None;
        }
        *most = 0.0;
        let tool =
            |joints: &JointPositions| arm.model.base_from_flange(joints) * arm.flange_from_tool;
        state.period = tick.period;
        state.joints = JointPositions(tick.joints);
        state.desired_joints = JointPositions(tick.desired_joints);
        state.motors = arm.model.motors(&state.joints);
        state.base_from_tool = tool(&state.joints);
        state.desired_base_from_tool = tool(&state.desired_joints);
        state.jaw_opening = tick.jaw_opening;
        state.jaw_force = tick.jaw_force;
        // What it was is in the words; that it was one is enough here.
        state.fault = (!tick.fault.is_empty()).then_some(ArmFault::EmergencyStop);
        let first = usize::from(!arm.model.has_track);
        let all = (first..=AXES).all(|axis| tick.reading.synchronised & 1 << axis != 0);
        state.synchronisation = if all { Synchronisation::Yes } else { Synchronisation::No };
        let record = ServoRecord {
            period: tick.period,
            arm: tick.arm,
            reading: tick.reading,
            outside: Outside::default(),
            command: None,
            drive: tick.drive,
            state: *state,
        };
        Some((record, tick.fault.clone()))
    }
}

/// The show at one moment.
struct Stand<'a> {
    show: &'a Show,
    to: &'a Behind,
    board: Board,
    presenter: Presenter,
    /// Where the presenter speaks, before this adds what is different in a replay.
    inner: Behind,
    next: usize,
    faults: Vec<String>,
    number: u64,
    over: bool,
}

impl<'a> Stand<'a> {
    fn new(show: &'a Show, to: &'a Behind) -> Self {
        let board = Board::default();
        let (presenter, mut stage) = Presenter::new(&show.scenario, board.clone());
        stage.title.clone_from(&show.title);
        "replay".clone_into(&mut stage.pace);
        to.stage.send_replace(Arc::new(stage));
        let faults = vec![String::new(); show.scenario.controller.cell.arms.len()];
        let inner = desk().1;
        let mut latest = board.latest();
        (latest.mp, latest.replayed) = ("as recorded", true);
        drop(latest);
        Self { show, to, board, presenter, inner, next: 0, faults, number: 0, over: false }
    }

    fn show(&mut self, time: f64, paused: bool, speed: f64) {
        let mut sink = Seen { to: NoRecords, board: Some(self.board.clone()) };
        while let Some((at, what)) = self.show.events.get(self.next).filter(|(at, _)| *at <= time) {
            match what {
                What::Arm(record, fault) => {
                    if let Some(now) = self.faults.get_mut(usize::from(record.arm)) {
                        now.clone_from(fault);
                    }
                    sink.record(record);
                }
                What::Belief(picture) => {
                    self.board.latest().picture = Some(picture.as_ref().clone());
                }
                What::Sight(camera, period, jpeg, found) => {
                    self.sight(*camera, *period, jpeg.as_deref(), found);
                }
                What::Phase(name) => self.presenter.notice(&Notice::Phase(*at, name.clone())),
                What::Message(class, who, text) => {
                    self.presenter.recorded(*at, *class, who, text);
                }
                What::Operator(words) => {
                    let text = format!("operator: {words}");
                    self.presenter.recorded(*at, Class::Info, "ui", &text);
                }
            }
            self.next += 1;
        }
        if time >= self.show.end && !self.over {
            self.over = true;
            self.presenter.notice(&Notice::Over(self.show.outcome.clone()));
        }
        let control = if paused { Control::Paused } else { Control::Running };
        self.presenter.publish(&self.inner, control, speed);
        self.forward(paused);
    }

    /// A picture that nobody has taken yet is not lost to a look without one.
    fn sight(&self, camera: usize, period: u64, jpeg: Option<&Vec<u8>>, found: &Found) {
        let decode = |jpeg: &Vec<u8>| {
            image::load_from_memory_with_format(jpeg, image::ImageFormat::Jpeg).ok()
        };
        let waiting = || {
            let mut latest = self.board.latest();
            latest.sights.get_mut(camera)?.as_mut()?.image.take()
        };
        let image = jpeg.and_then(decode).map(image::DynamicImage::into_rgb8).or_else(waiting);
        self.board.saw(camera, Sight { period, image, found: found.clone() });
    }

    fn forward(&mut self, paused: bool) {
        self.number += 1;
        let mut snapshot: Snapshot = self.inner.snapshots.borrow().as_ref().clone();
        snapshot.number = self.number;
        let seek_ms = Some((self.show.end * 1e3).round() as u64);
        snapshot.services = Services { manual: false, speed: true, seek_ms };
        if paused && snapshot.control != ControlView::Ended {
            snapshot.control = ControlView::Paused;
        }
        for (arm, fault) in snapshot.arms.iter_mut().zip(&self.faults) {
            arm.fault = arm.fault.take().map(|_| fault.clone());
            arm.remedy = None;
        }
        self.to.pictures.send_replace(self.inner.pictures.borrow().clone());
        self.to.snapshots.send_replace(Arc::new(snapshot));
    }
}

impl Show {
    /// Phases and messages, each with its time [s], for whoever has no face.
    pub fn told(&self) -> impl Iterator<Item = (f64, String)> {
        self.events.iter().filter_map(|(time, what)| match what {
            What::Phase(name) => Some((*time, name.clone())),
            What::Message(Class::Info, _, text) => Some((*time, format!("note: {text}"))),
            What::Message(_, who, text) => Some((*time, format!("! {who}: {text}"))),
            What::Operator(words) => Some((*time, format!("operator: {words}"))),
            What::Arm(..) | What::Belief(_) | What::Sight(..) => None,
        })
    }
}
