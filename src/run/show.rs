//! Replay of a recording: page and terminal show it as they showed the run, with pause, speed and
//! seek.
//!
//! - in: a recording, inputs of the operator
//! - out: snapshots and pictures at a desk, made by the presenter that a run has; the controller
//!   does not run again

use super::outcome::outcome;
use crate::actors::control::Control;
use crate::actors::latest::{Found, LatestValues, Peaks, Seen, Sight};
use crate::actors::notice::Notice;
use crate::actors::present::{self, Presenter, View};
use crate::cell::Cell;
use crate::desk::{Desk, Pictures, RunEnd};
use crate::hw::driver::{NoRecords, RecordSink, ServoRecord};
use crate::kernel::Picture;
use crate::motion::{AXES, ArmFault, ArmState, JointPositions, PERIOD, Synchronisation};
use crate::operator::{Class, ControlView, History, Input, OutcomeView, Services, Snapshot};
use crate::record::reading::{End, Label, Message, Piece, Reading, Unreadable};
use crate::record::sensed::{self, Sensed};
use crate::record::summary::Summary;
use crate::record::tick::Tick;
use crate::record::{belief, calibration, cdr, standard};
use crate::scenario::Scenario;
use crate::scenario::objects::LINK;
use crate::servo::ServoCommand;
use crate::servo::io::Outside;
use crate::servo::period::Length;
use crate::spatial::Pose;
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::{Read, Seek};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Time between two snapshots.
const REFRESH: Duration = Duration::from_millis(50);
/// Periods of 2 ms between two states of an arm that are kept. The largest values in between are
/// kept with them.
const PERIODS_PER_STATE: u32 = 20;
/// Number of snapshots from which the history of a recording is made.
const HISTORY: u32 = 2000;
/// Speed that means "as fast as possible", in multiples of real time.
const FASTEST: f64 = 200.0;

/// Memory that a shown recording may take, approximately (bytes): enough for three hours of a cell.
/// A small compressed file may hold more.
const MEMORY_LIMIT: usize = 1 << 30;
/// Length at which a text is cut off (bytes).
const TEXT_LIMIT: usize = 4096;

/// A recording in memory, in the order of time.
pub struct Show {
    scenario: Scenario,
    title: String,
    /// Events, each with its time since the first message (s).
    events: Vec<(f64, Event)>,
    /// Memory that the events take, approximately (bytes).
    held: usize,
    /// Time of the last message (s).
    end: f64,
    /// End of the run in words.
    outcome: OutcomeView,
}

/// An event of a recording.
enum Event {
    /// State of an arm, the reason why the arm stopped (empty if it did not), and the largest
    /// values since the state before.
    Arm(Box<ServoRecord>, String, Peaks),
    /// Belief of the task's kernel.
    Belief(Box<Picture>),
    /// Look of a camera: its index, the period in which its sensor was asked, the picture as JPEG,
    /// and the result.
    Sight(usize, u64, Option<Arc<Vec<u8>>>, Found),
    /// Poses in the world of the plant's loose objects, by name.
    Objects(Vec<(String, Pose)>),
    /// Reading of a user's own sensor, with the name of its VSP.
    Reading(String, Value),
    /// Beginning of a phase.
    Phase(String),
    /// Log message: class, actor, text.
    Message(Class, String, String),
    /// Input of the operator, in words.
    Operator(String),
}

impl Show {
    /// Reads a recording of this scenario.
    ///
    /// # Errors
    /// [`Unreadable`] if the file is no recording, or a message is malformed.
    pub fn read<R: Read + Seek>(
        from: R,
        scenario: &Scenario,
        title: &str,
    ) -> Result<Self, Unreadable> {
        Self::read_within(MEMORY_LIMIT, from, scenario, title)
    }

    /// Reads a recording of this scenario, and keeps at most about `most` bytes of it in memory.
    fn read_within<R: Read + Seek>(
        most: usize,
        from: R,
        scenario: &Scenario,
        title: &str,
    ) -> Result<Self, Unreadable> {
        let mut show = Self {
            scenario: scenario.clone(),
            title: title.to_owned(),
            events: Vec::new(),
            held: 0,
            end: 0.0,
            outcome: cut_off(""),
        };
        let mut label = Label::default();
        let mut loading = Loading::new(&scenario.controller.cell, scenario.real_time.period);
        let (mut start, mut long) = (None, false);
        let mut reading = Reading::seekable(from);
        for piece in reading.by_ref() {
            label.take(&piece);
            let Piece::Message(message) = piece else { continue };
            if show.held > most {
                // Reading goes on without keeping, because the outcome is at the end of the file.
                long = true;
                continue;
            }
            let start = *start.get_or_insert(message.time);
            let time = message.time.saturating_sub(start) as f64 * 1e-9;
            show.end = show.end.max(time);
            show.take(time, &message, &mut loading)
                .map_err(|why| Unreadable::Message { topic: message.channel.topic.clone(), why })?;
        }
        // The run drew the results of vision in the calibrated cell, which is recorded as facts.
        calibration::apply(&label, &mut show.scenario.controller.cell);
        let summary: Option<Summary> = serde_json::from_str(label.of("summary", "json")).ok();
        let flaw = reading.end().and_then(End::loss);
        let flaw = flaw.map(|flaw| format!("the recording is {}", flaw.after(show.end)));
        show.outcome = match (summary, flaw) {
            // A summary that was read counts, even if the file is damaged after it.
            (Some(summary), flaw) => {
                let told = flaw.map(|text| Event::Message(Class::Warning, "ui".to_owned(), text));
                show.events.extend(told.map(|what| (show.end, what)));
                outcome(&summary)
            }
            (None, Some(flaw)) => cut_off(&flaw),
            (None, None) if long => cut_off("the recording holds more than fits into memory"),
            (None, None) => cut_off("the recording does not say how the run ended"),
        };
        if long {
            let text = format!(
                "the recording holds more than fits into memory: it is shown up to {:.1} s",
                show.end
            );
            show.events.push((show.end, Event::Message(Class::Warning, "ui".to_owned(), text)));
        }
        // A recording that another program has written again may have another order.
        // The sort is stable: simultaneous events keep the order of the file.
        show.events.sort_by(|a, b| a.0.total_cmp(&b.0));
        Ok(show)
    }

    /// Adds a message of the recording to the events if the show uses its topic.
    fn take(
        &mut self,
        time: f64,
        message: &Message,
        loading: &mut Loading,
    ) -> Result<(), cdr::Malformed> {
        let data = &message.data[..];
        match message.channel.topic.as_str() {
            "/belief" => self.take_belief(time, data),
            "/phase" => self.take_phase(time, data),
            "/rosout" => self.take_log(time, data),
            "/operator" => self.take_input(time, data),
            "/sensed" => self.take_sensed(time, data, loading),
            "/tf" => self.take_objects(time, data, loading),
            topic if topic.ends_with("/image") => self.take_picture(time, topic, data, loading),
            topic if topic.ends_with("/servo") => self.take_tick(time, data, loading),
            // A malformed message makes a recording unreadable, shown or not.
            _ => cdr::Reader::new(data).map(drop),
        }
    }

    /// Adds a belief of the task's kernel.
    fn take_belief(&mut self, time: f64, data: &[u8]) -> Result<(), cdr::Malformed> {
        if let Some(picture) = belief::read(cdr::Reader::new(data)?.string()?) {
            self.push(time, data.len(), Event::Belief(Box::new(picture)));
        }
        Ok(())
    }

    /// Adds the beginning of a phase. A phase with an outcome, the second text, is the end of the
    /// run and is left out.
    fn take_phase(&mut self, time: f64, data: &[u8]) -> Result<(), cdr::Malformed> {
        let mut from = cdr::Reader::new(data)?;
        from.time()?;
        let name = short(from.string()?);
        if from.string()?.is_empty() {
            self.push(time, name.len(), Event::Phase(name));
        }
        Ok(())
    }

    /// Adds a log message, unless it announces a phase.
    fn take_log(&mut self, time: f64, data: &[u8]) -> Result<(), cdr::Malformed> {
        let (class, who, text) = standard::read_log(&mut cdr::Reader::new(data)?)?;
        // A phase has a message of its own.
        if !text.starts_with("phase: ") {
            let what = Event::Message(class, short(who), short(text));
            self.push(time, 2 * TEXT_LIMIT.min(data.len()), what);
        }
        Ok(())
    }

    /// Adds an input of the operator.
    fn take_input(&mut self, time: f64, data: &[u8]) -> Result<(), cdr::Malformed> {
        let mut from = cdr::Reader::new(data)?;
        from.time()?;
        from.u64()?;
        let words = short(&Input::describe_recorded(from.string()?));
        self.push(time, words.len(), Event::Operator(words));
        Ok(())
    }

    /// Adds the result of a camera's sensor, or the reading of a user's own one.
    fn take_sensed(
        &mut self,
        time: f64,
        data: &[u8],
        loading: &mut Loading,
    ) -> Result<(), cdr::Malformed> {
        let sensed = Sensed::read(data)?;
        let Some(camera) = self.camera(&sensed.sensor) else {
            let shown = match sensed.found {
                Ok(sensed::Found::Own(reading)) => reading,
                Ok(_) => return Ok(()),
                Err(why) => Value::String(why),
            };
            self.push(time, data.len(), Event::Reading(sensed.sensor, shown));
            return Ok(());
        };
        loading.looked.insert(camera, self.events.len());
        let what = Event::Sight(camera, sensed.period, None, found(sensed.found));
        self.push(time, data.len(), what);
        Ok(())
    }

    /// Adds the poses of the loose objects, if they have changed.
    fn take_objects(
        &mut self,
        time: f64,
        data: &[u8],
        loading: &mut Loading,
    ) -> Result<(), cdr::Malformed> {
        let found = standard::read_transforms(&mut cdr::Reader::new(data)?, LINK)?;
        if !found.is_empty() && found != loading.objects {
            loading.objects.clone_from(&found);
            self.push(time, data.len(), Event::Objects(found));
        }
        Ok(())
    }

    /// Adds a picture to the look of its camera before it, which holds the result that vision found
    /// in this picture. A camera on another node has pictures without looks.
    fn take_picture(
        &mut self,
        time: f64,
        topic: &str,
        data: &[u8],
        loading: &mut Loading,
    ) -> Result<(), cdr::Malformed> {
        let mut from = cdr::Reader::new(data)?;
        from.header()?;
        from.string()?;
        let jpeg = Arc::new(from.u8_sequence()?.to_vec());
        let is_of = |name: &str| topic.strip_prefix('/') == Some(&format!("{name}/image"));
        let mut cameras = loading.cell.cameras.iter();
        let Some(camera) = cameras.position(|camera| is_of(&camera.name)) else { return Ok(()) };
        if let Some(at) = loading.looked.remove(&camera) {
            if let Some((_, Event::Sight(_, _, picture, _))) = self.events.get_mut(at) {
                self.held += jpeg.len();
                *picture = Some(jpeg);
            }
        } else {
            let (size, period) = (jpeg.len(), (time / PERIOD).round() as u64);
            let found = Found::Nothing(String::new());
            self.push(time, size, Event::Sight(camera, period, Some(jpeg), found));
        }
        Ok(())
    }

    /// Takes a servo tick into account, and adds the state of its arm every [`PERIODS_PER_STATE`]
    /// periods.
    fn take_tick(
        &mut self,
        time: f64,
        data: &[u8],
        loading: &mut Loading,
    ) -> Result<(), cdr::Malformed> {
        // Every tick goes into the peaks, and one in `PERIODS_PER_STATE` becomes an event.
        let tick = Tick::read(data)?;
        if let Some((record, peaks)) = loading.tick(&tick) {
            let fault = short(&tick.fault);
            let size = size_of::<ServoRecord>() + fault.len();
            self.push(time, size, Event::Arm(Box::new(record), fault, peaks));
        }
        Ok(())
    }

    /// Adds an event of a time (s) that takes about `size` bytes of memory besides its entry.
    fn push(&mut self, time: f64, size: usize, what: Event) {
        self.held += size + size_of::<(f64, Event)>();
        self.events.push((time, what));
    }

    /// Returns in words how the recorded run ended.
    #[must_use]
    pub fn ending(&self) -> String {
        format!("{}: {}", self.outcome.verdict, self.outcome.reason)
    }

    /// Returns the index of a sensor's camera; `None` if the scenario has no such sensor, or it has
    /// no camera.
    fn camera(&self, sensor: &str) -> Option<usize> {
        let vsps = &self.scenario.controller.vsps;
        let name = sensor.strip_prefix("vsp ")?;
        vsps.iter().find(|vsp| vsp.name == name)?.camera
    }

    /// Shows the recording to the UIs at `desk` until the operator quits or `stop` is set. Returns
    /// at the end of the recording unless `stays`. `speed` is in multiples of real time, 0 for as
    /// fast as possible.
    pub fn run(&self, desk: &RunEnd, speed: f64, stays: bool, stop: &AtomicBool) {
        let mut inputs = desk.take_inputs();
        desk.replace_history(self.history());
        let mut playhead = Playhead::new(self, desk);
        let (mut time, mut speed, mut paused) = (0.0, speed, false);
        let mut last = Instant::now();
        while !stop.load(Ordering::Acquire) {
            let mut sought = false;
            while let Some(input) = inputs.as_mut().and_then(|i| i.try_recv().ok()) {
                match input {
                    Input::Start | Input::Resume => paused = false,
                    Input::Pause => paused = true,
                    Input::Speed { factor } if factor.is_finite() => speed = factor.max(0.0),
                    Input::Seek { time: to } if to.is_finite() => {
                        time = to.clamp(0.0, self.end);
                        sought = true;
                    }
                    Input::Quit | Input::Terminate => return,
                    _ => {}
                }
            }
            // The last of several seeks counts. Presenter and latest values cannot go backwards, so
            // they start again from the first event.
            if sought {
                playhead = Playhead { number: playhead.number, ..Playhead::new(self, desk) };
                playhead.skip(time);
            }
            // Measured time, not the number of loops: a slow snapshot does not slow the show down.
            let factor = if speed == 0.0 { FASTEST } else { speed };
            let passed = last.elapsed().as_secs_f64();
            last = Instant::now();
            if !paused {
                time = (time + factor * passed).min(self.end);
            }
            playhead.show(time, paused, speed);
            if time >= self.end && !stays {
                return;
            }
            std::thread::sleep(REFRESH);
        }
    }
}

/// Returns the beginning of a text, at most [`TEXT_LIMIT`] bytes. No text that this program records
/// is longer.
fn short(words: &str) -> String {
    if words.len() <= TEXT_LIMIT {
        return words.to_owned();
    }
    let end = (0..=TEXT_LIMIT).rev().find(|&at| words.is_char_boundary(at)).unwrap_or(0);
    format!("{}...", &words[..end])
}

/// Returns the outcome of a run whose end is not in the recording. `reason` says why it is not,
/// in words for the operator.
fn cut_off(reason: &str) -> OutcomeView {
    OutcomeView {
        verdict: "cut off".to_owned(),
        good: false,
        reason: reason.to_owned(),
        time: None,
        figures: Vec::new(),
    }
}

/// State that is carried from message to message while a recording is read.
struct Loading {
    cell: Cell,
    /// Servo periods between two states that are kept.
    states: u64,
    /// Last state of each arm, and the largest values since the last state that was kept.
    arms: Vec<(ArmState, Peaks)>,
    /// Index of the event of each camera's last look. The message with its picture may follow.
    looked: BTreeMap<usize, usize>,
    /// Last poses of the loose objects.
    objects: Vec<(String, Pose)>,
}

impl Loading {
    /// Creates the state of reading before the first message, for a cell whose servo periods have
    /// the length `period` (s).
    fn new(cell: &Cell, period: f64) -> Self {
        let arms = cell.arms.iter().map(|_| (ArmState::default(), Peaks::default())).collect();
        let states = Length::of_seconds(period).count(PERIODS_PER_STATE).into();
        Self { cell: cell.clone(), states, arms, looked: BTreeMap::new(), objects: Vec::new() }
    }

    /// Takes a servo tick into the state and the peaks of its arm. Once every `states` periods
    /// returns both; the peaks are the largest values since the last time.
    fn tick(&mut self, tick: &Tick) -> Option<(ServoRecord, Peaks)> {
        let index = usize::from(tick.arm);
        let (arm, (state, peaks)) = (self.cell.arms.get(index)?, self.arms.get_mut(index)?);
        if let Ok(Some(ServoCommand::Move { command, start })) = tick.order() {
            state.command_end = start.max(tick.period) + u64::from(command.periods);
        }
        // A tick has joints alone: poses are computed again with the believed model.
        let tool =
            |joints: &JointPositions| arm.model.base_from_flange(joints) * arm.flange_from_tool;
        state.period = tick.period;
        state.joints = JointPositions(tick.joints);
        state.desired_joints = JointPositions(tick.desired_joints);
        state.base_from_tool = tool(&state.joints);
        state.desired_base_from_tool = tool(&state.desired_joints);
        state.wrench_in_tool = tick.wrench_in_tool;
        peaks.take(state);
        // Periods count from 1: the first one is kept, so that the show has a state from its
        // beginning.
        if tick.period % self.states != 1 % self.states {
            return None;
        }
        state.motors = arm.model.motors(&state.joints);
        state.jaw_opening = tick.jaw_opening;
        state.jaw_force = tick.jaw_force;
        // A tick has the fault in words only. Any fault marks the arm as stopped; the recorded
        // words replace it where it is shown.
        state.fault = (!tick.fault.is_empty()).then_some(ArmFault::EmergencyStop);
        // An arm without a track has no axis 0. The jaw, axis `AXES`, counts as well.
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
        Some((record, std::mem::take(peaks)))
    }
}

/// Converts the recorded result of a sensor to the type in which a run shows it.
fn found(sensed: Result<sensed::Found, String>) -> Found {
    match sensed {
        Ok(sensed::Found::Cube { world_from_cube, speed, .. }) => {
            Found::Cube(world_from_cube, speed)
        }
        Ok(sensed::Found::Face(face)) => Found::Face(Box::new(face)),
        // No camera has such a reading.
        Ok(sensed::Found::Own(_)) => Found::Nothing(String::new()),
        Err(why) => Found::Nothing(why),
    }
}

/// Position in a recording, with the presenter and the latest values at that time.
struct Playhead<'a> {
    show: &'a Show,
    /// Run's end of the desk to which the playback is shown.
    to: &'a RunEnd,
    latest: LatestValues,
    presenter: Presenter,
    /// Index of the next event.
    next: usize,
    /// Recorded fault of each arm; empty if it has none.
    faults: Vec<String>,
    /// Number of the last snapshot.
    number: u64,
    /// Whether the outcome was shown.
    over: bool,
    /// Whether no picture is decoded, because nobody looks at them.
    blind: bool,
}

impl<'a> Playhead<'a> {
    /// Creates a playhead before the first event, and shows the recording's stage at the desk `to`.
    fn new(show: &'a Show, to: &'a RunEnd) -> Self {
        let latest = LatestValues::default();
        let mut stage = present::stage(&show.scenario);
        // A replay takes no orders; it shows those of the run as messages.
        stage.parameters.clear();
        let presenter = Presenter::new(stage.clone(), &show.scenario.controller, latest.clone());
        stage.title.clone_from(&show.title);
        "replay".clone_into(&mut stage.pace);
        to.stage.send_replace(Arc::new(stage));
        to.pictures.send_replace(Pictures::new());
        let faults = vec![String::new(); show.scenario.controller.cell.arms.len()];
        // A recording has beliefs and phases, but not the actions of MP, so none are shown.
        let mut values = latest.lock();
        (values.mp, values.replayed) = ("as recorded", true);
        drop(values);
        Self { show, to, latest, presenter, next: 0, faults, number: 0, over: false, blind: false }
    }

    /// Moves the playback to a time (s) at once: applies all events up to it. Clears the largest
    /// force of each arm, because it belongs to an earlier time.
    fn skip(&mut self, time: f64) {
        self.events(time);
        for arm in &mut self.latest.lock().arms {
            std::mem::take(&mut arm.peaks);
        }
    }

    /// Applies the events up to a time. Only the last belief and the last picture of each camera
    /// are used, since copying and decoding all of them made a seek too slow.
    fn events(&mut self, time: f64) {
        let show = self.show;
        let mut sink = Seen { to: NoRecords, latest: Some(self.latest.clone()) };
        let (mut belief, mut looks) = (None, BTreeMap::new());
        while let Some((at, what)) = show.events.get(self.next).filter(|(at, _)| *at <= time) {
            match what {
                Event::Arm(record, fault, peaks) => {
                    let arm = usize::from(record.arm);
                    if let Some(now) = self.faults.get_mut(arm) {
                        now.clone_from(fault);
                    }
                    sink.record(record);
                    self.latest.peaked(arm, peaks);
                }
                Event::Belief(picture) => belief = Some(picture),
                Event::Sight(camera, period, jpeg, found) => {
                    // The presenter draws the cube at the place that any look found; a picture
                    // replaces the camera's last one.
                    self.presenter.take_sight(*period, found);
                    if let Some(jpeg) = jpeg {
                        looks.insert(*camera, (*period, jpeg, found));
                    }
                }
                Event::Reading(sensor, reading) => {
                    self.latest.lock().sensors.insert(sensor.clone(), reading.clone());
                }
                Event::Objects(objects) => {
                    self.latest.lock().objects.extend(objects.iter().cloned());
                }
                Event::Phase(name) => self.presenter.notice(&Notice::Phase(*at, name.clone())),
                Event::Message(class, who, text) => {
                    self.presenter.recorded(*at, *class, who, text);
                }
                Event::Operator(words) => {
                    let text = format!("operator: {words}");
                    self.presenter.recorded(*at, Class::Info, "ui", &text);
                }
            }
            self.next += 1;
        }
        // The last belief and the last picture of each camera in the interval are shown.
        if let Some(picture) = belief {
            self.latest.lock().picture = Some(picture.as_ref().clone());
        }
        for (camera, (period, jpeg, found)) in looks {
            if self.blind {
                continue;
            }
            let image = image::load_from_memory_with_format(jpeg, image::ImageFormat::Jpeg).ok();
            let image = image.map(image::DynamicImage::into_rgb8);
            self.latest.saw(camera, Sight { period, image, found: found.clone() });
        }
    }

    /// Sends the snapshot and the pictures of a time to the desk. `paused` and `speed` are shown in
    /// the snapshot.
    fn show(&mut self, time: f64, paused: bool, speed: f64) {
        self.events(time);
        if time >= self.show.end && !self.over {
            self.over = true;
            self.presenter.notice(&Notice::Over(self.show.outcome.clone()));
        }
        let control = if paused { Control::Paused } else { Control::Running };
        let View { pictures, mut snapshot, .. } = self.presenter.view(control, speed);
        if let Some(pictures) = pictures {
            self.to.pictures.send_replace(pictures);
        }
        // Numbers of snapshots rise over a seek as well, although it makes a new presenter.
        self.number += 1;
        snapshot.number = self.number;
        let seek_ms = Some((self.show.end * 1e3).round() as u64);
        snapshot.services = Services { speed: true, seek_ms, ..Services::default() };
        if paused && snapshot.control != ControlView::Ended {
            snapshot.control = ControlView::Paused;
        }
        // The presenter has only the placeholder of `Loading::tick`. The recorded words replace it,
        // and its remedy would be wrong.
        for (arm, fault) in snapshot.arms.iter_mut().zip(&self.faults) {
            arm.fault = arm.fault.take().map(|_| fault.clone());
            arm.remedy = None;
        }
        self.to.publish(snapshot);
    }
}

impl Show {
    /// Returns at most `most` moments, each in the middle of a step of the plan, spread from the
    /// first step to the last: time (s), the step in words, and the snapshot that the operator saw.
    #[must_use]
    pub fn moments(&self, most: usize) -> Vec<(f64, String, Arc<Snapshot>)> {
        let steps = self.steps();
        let count = most.min(steps.len());
        // The first and the last step are among the moments; `max(1)` is for a single moment.
        let moments: Vec<_> =
            (0..count).map(|i| &steps[i * (steps.len() - 1) / (count - 1).max(1)]).collect();
        let times: Vec<f64> = moments.iter().map(|(time, _)| *time).collect();
        let snapshots = self.snapshots(&times);
        let moments = moments.into_iter().zip(snapshots);
        moments.map(|((time, words), snapshot)| (*time, words.clone(), snapshot)).collect()
    }

    /// Returns the history of the whole recording.
    fn history(&self) -> History {
        let desk = Desk::default();
        let (ui, run) = desk.ends();
        let mut playhead = Playhead { blind: true, ..Playhead::new(self, &run) };
        for i in 0..=HISTORY {
            playhead.show(self.end * f64::from(i) / f64::from(HISTORY), false, 1.0);
        }
        ui.history(|history| history.clone().finished())
    }

    /// Returns the time of the last message that is shown (s).
    #[must_use]
    pub fn end(&self) -> f64 {
        self.end
    }

    /// Returns the snapshot that the operator saw at each of `times` (s), which ascend.
    #[must_use]
    pub fn snapshots(&self, times: &[f64]) -> Vec<Arc<Snapshot>> {
        let desk = Desk::default().run_end();
        let mut playhead = Playhead::new(self, &desk);
        let at = |time: &f64| {
            playhead.skip(*time);
            playhead.show(*time, true, 1.0);
            desk.latest()
        };
        times.iter().map(at).collect()
    }

    /// Returns for each step of the plans the middle of its time (s), and the step in words.
    fn steps(&self) -> Vec<(f64, String)> {
        let (mut steps, mut now, mut begun) = (Vec::new(), None, None);
        let mut ends = |begun: &mut Option<(f64, String)>, time: f64| {
            steps.extend(begun.take().map(|(from, words)| (f64::midpoint(from, time), words)));
        };
        for (time, what) in &self.events {
            match what {
                // A phase ends a step as well: the belief keeps the last step until the run ends.
                Event::Phase(_) => ends(&mut begun, *time),
                Event::Belief(picture) => {
                    // A new plan may have another step at the same number: the words are compared
                    // too.
                    let line = |step: usize| Some((step, picture.plan.get(step)?.what.clone()));
                    let step = picture.step.and_then(line);
                    if step != now {
                        ends(&mut begun, *time);
                        begun = step.clone().map(|(_, words)| (*time, words));
                        now = step;
                    }
                }
                _ => {}
            }
        }
        ends(&mut begun, self.end);
        steps
    }

    /// Returns phases, log messages and the operator's inputs as lines of text, each with its time
    /// (s), for an operator without a UI.
    pub fn log_lines(&self) -> impl Iterator<Item = (f64, String)> {
        self.events.iter().filter_map(|(time, what)| match what {
            Event::Phase(name) => Some((*time, name.clone())),
            Event::Message(Class::Info, _, text) => Some((*time, format!("note: {text}"))),
            Event::Message(_, who, text) => Some((*time, format!("! {who}: {text}"))),
            Event::Operator(words) => Some((*time, format!("operator: {words}"))),
            Event::Arm(..)
            | Event::Belief(_)
            | Event::Sight(..)
            | Event::Reading(..)
            | Event::Objects(_) => None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::operator::PlanLine;
    use nalgebra::Vector3;

    /// Returns the built-in scenario.
    fn scenario() -> Scenario {
        crate::tasks::read(std::path::Path::new("t.toml"), "", &[]).unwrap()
    }

    /// Makes a recording of these events that ends at the time `end` (s).
    fn show(events: Vec<(f64, Event)>, end: f64) -> Show {
        let title = String::new();
        Show { scenario: scenario(), title, events, held: 0, end, outcome: cut_off("") }
    }

    /// Returns the record of the first arm in a period: the arm rests at its start.
    fn record(period: u64) -> ServoRecord {
        let joints = scenario().controller.cell.arms[0].start;
        ServoRecord {
            period,
            arm: 0,
            reading: crate::servo::io::ArmReading::default(),
            outside: Outside::default(),
            command: None,
            drive: crate::servo::io::ArmDrive::OFF,
            state: ArmState { joints, desired_joints: joints, ..ArmState::default() },
        }
    }

    #[test]
    fn replay_tells_if_recording_exceeds_memory_limit() {
        let mut writer = mcap::Writer::new(std::io::Cursor::new(Vec::new())).unwrap();
        let schema = writer.add_schema("p/msg/Phase", "ros2msg", b"").unwrap();
        let channel = writer.add_channel(schema, "/phase", "cdr", &<_>::default()).unwrap();
        // A time, a name of 100000 letters, and an empty note.
        let mut data = vec![0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        data.extend(100_004_u32.to_le_bytes());
        data.extend(vec![b'x'; 100_003]);
        data.extend([0, 1, 0, 0, 0, 0]);
        for second in 0..100 {
            let time = second * 1_000_000_000;
            let head = mcap::records::MessageHeader {
                channel_id: channel,
                sequence: 0,
                log_time: time,
                publish_time: time,
            };
            writer.write_to_known_channel(&head, &data).unwrap();
        }
        writer.finish().unwrap();
        let file = writer.into_inner().into_inner();

        let read = |most| {
            let file = std::io::Cursor::new(&file);
            Show::read_within(most, file, &scenario(), "").unwrap()
        };

        let whole = read(MEMORY_LIMIT);
        assert_eq!((whole.events.len(), whole.end), (100, 99.0));
        assert!(whole.held < 100 * (TEXT_LIMIT + 500), "{}", whole.held);
        let part = read(50 * TEXT_LIMIT);
        assert!((40..=52).contains(&part.events.len()), "{}", part.events.len());
        assert!(part.ending().contains("more than fits into memory"), "{}", part.ending());
    }

    #[test]
    fn kept_state_carries_peaks_of_skipped_states() {
        let mut loading = Loading::new(&scenario().controller.cell, 0.002);
        let mut kept = Vec::new();
        for period in 2..=21 {
            let mut record = record(period);
            match period {
                5 => record.state.wrench_in_tool.torque = Vector3::new(0.0, 3.0, 0.0),
                9 => record.state.wrench_in_tool.force = Vector3::new(12.0, 0.0, 0.0),
                12 => record.state.joints.0[0] += 0.004,
                _ => {}
            }
            kept.extend(loading.tick(&Tick::of(&record)));
        }

        let [(state, peaks)] = kept.as_slice() else { panic!("{} states", kept.len()) };
        assert_eq!((state.period, peaks.force, peaks.torque), (21, 12.0, 3.0));
        assert!((peaks.following - 0.004).abs() < 1e-9, "{peaks:?}");
        assert_eq!(state.state.wrench_in_tool.force.norm(), 0.0, "the state is of its own period");
    }

    /// A seek shows the last picture before its time, with the words of that picture's own look,
    /// and no peak of the interval that it skipped.
    #[test]
    fn seek_shows_last_picture_and_no_skipped_peaks() {
        let jpeg = |shade: u8| {
            let image = image::RgbImage::from_pixel(8, 8, image::Rgb([shade; 3]));
            let mut file = Vec::new();
            let encoder = image::codecs::jpeg::JpegEncoder::new(&mut file);
            image.write_with_encoder(encoder).unwrap();
            Arc::new(file)
        };
        let look = |period: u64, jpeg: Option<Arc<Vec<u8>>>| {
            Event::Sight(0, period, jpeg, Found::Nothing(format!("look {period}")))
        };
        let peaks = Peaks { force: 40.0, torque: 4.0, following: 0.001 };
        let events = vec![
            (0.1, Event::Arm(Box::new(record(50)), String::new(), peaks)),
            (0.2, look(100, Some(jpeg(0)))),
            (0.4, look(200, Some(jpeg(200)))),
            (0.5, look(250, None)),
            (0.9, look(450, Some(jpeg(100)))),
        ];
        let show = show(events, 1.0);
        let desk = Desk::default().run_end();
        let mut playhead = Playhead::new(&show, &desk);

        playhead.skip(0.6);
        playhead.show(0.6, true, 1.0);

        let snapshot = desk.latest();
        assert_eq!(snapshot.cameras[0].words, "look 200", "what was found in that picture");
        assert_eq!((snapshot.arms[0].peak, snapshot.arms[0].following), ((0.0, 0.0), 0.0));
        let pictures = desk.pictures.borrow();
        let Some(crate::desk::Pixels::Raw(image)) = pictures[0].as_ref().map(|p| &p.pixels) else {
            panic!("no picture")
        };
        assert!(image.get_pixel(4, 4)[0].abs_diff(200) < 10);
    }

    /// The transforms of arms and cube are no objects.
    #[test]
    fn replay_shows_recorded_objects() {
        let mut show = show(Vec::new(), 1.0);
        let mut loading = Loading::new(&scenario().controller.cell, 0.002);
        for (time, x) in [(0.1, 0.5), (0.2, 0.5), (0.3, 0.7)] {
            for child in ["cube", "object_bar"] {
                let mut writer = cdr::Writer::new(Vec::new());
                let place = Pose::translation(x, 0.0, 0.0);
                standard::transforms(&mut writer, 0, [("world", child, place)].into_iter());
                show.take_objects(time, &writer.bytes(), &mut loading).unwrap();
            }
        }
        assert_eq!(show.events.len(), 2, "a pose that stays is kept once");
        show.events.push((0.4, Event::Arm(Box::new(record(200)), String::new(), Peaks::default())));
        let desk = Desk::default().run_end();
        let mut playhead = Playhead::new(&show, &desk);

        playhead.skip(0.6);
        playhead.show(0.6, true, 1.0);

        let objects = desk.latest().objects.clone();
        assert_eq!(objects.keys().collect::<Vec<_>>(), ["bar"]);
        assert_eq!(objects["bar"], Pose::translation(0.7, 0.0, 0.0));
    }

    #[test]
    fn chosen_moments_span_first_to_last_plan_step() {
        let line =
            |n: usize| PlanLine { what: format!("turn {n}"), why: String::new(), seconds: 1.0 };
        let plan: Arc<Vec<PlanLine>> = Arc::new((0..20).map(line).collect());
        let belief = |step: usize| {
            let plan = Arc::clone(&plan);
            Event::Belief(Box::new(Picture { plan, step: Some(step), ..Picture::default() }))
        };
        let mut events: Vec<_> =
            (0..20).map(|step| (10.0 + 2.0 * step as f64, belief(step))).collect();
        events.push((52.0, Event::Phase("release".to_owned())));
        let show = show(events, 100.0);

        let moments = show.moments(9);

        let told: Vec<_> = moments.iter().map(|(time, words, _)| (*time, words.as_str())).collect();
        assert_eq!(told.len(), 9);
        assert_eq!((told[0], told[8]), ((11.0, "turn 0"), (50.0, "turn 19")));
        assert_eq!(moments[8].2.step, Some(19));
        assert!(show.moments(40).len() == 20 && self::show(vec![], 1.0).moments(9).is_empty());
    }
}
