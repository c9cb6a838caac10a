//! VSP (virtual sensor process): the actor that turns the readings of a hardware sensor into the
//! quantity that the task needs.
//!
//! There are three kinds, after figure 3 of the paper (Zieliński et al. 2007): the stand-alone
//! camera, which tracks the cube at 25 Hz; a camera in a hand, which reads faces on request; and
//! the aggregate of the wrist forces. The figure names `VSP_MPC` and `VSP_MPF` (of MP) and
//! `VSP_GS1`, `VSP_GS2` (of the ECPs). The text explains the cameras only. That MPF aggregates the
//! forces and that GS are the gripper's cameras is our reading.
//!
//! - in: frames of a camera, or the states of the arms; requests and configurations
//! - out: the latest [`Target`], a [`FaceReading`] per request, the latest [`Forces`]
//!
//! | fault of a camera | threshold | reason |
//! |---|---|---|
//! | stale picture | `STALE` | the arm would follow the cube to where it was |
//! | black picture | `BLACK` | no light reached the sensor |
//! | repeated picture | period of the last one | the filter would count one measurement twice |

use super::fault::ActorFault;
use super::latest::Found;
use super::notice::Notice;
use super::services::Services;
use super::trace;
use super::watchdog::{Heartbeat, Supervision, answer_of};
use super::way::{self, Carries, Toward, Way};
use super::work;
use crate::cell::Intrinsics;
use crate::error::{Error, NonFatal, System};
use crate::generators::{Mode, Sensing, Target, Window};
use crate::hw::camera::{Frame, FrameSource};
use crate::kernel::{Effort, Forces, View, WristLoad};
use crate::motion::{ArmState, PERIOD};
use crate::operator::Parameter;
use crate::record::playback::Played;
use crate::record::sensed as kept;
use crate::spatial::Pose;
use crate::vision::sensor::{self, FaceReading};
use crate::vision::watcher::{CubeWatcher, PoseBy, Watched};
use crate::vision::{DetectorSettings, Method};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::{mpsc, oneshot, watch};
use tracing::Instrument as _;

/// Servo periods between two recorded pictures of a tracking camera (0.2 s).
const KEPT_PERIODS: u64 = 100;

/// Largest age of a picture that shows the scene as it is now (s).
const STALE: f64 = 0.1;
/// Mean level at or below which a picture is black, of 255.
const BLACK: f64 = 6.0;
/// Bytes between two samples of that mean. It is prime, so the samples cover all channels and
/// columns.
const SAMPLES: usize = 211;
/// Longest time of an answer to a look. It is longer than the limit of the image worker, so that
/// the error names the worker.
const PATIENCE: Duration = work::IMAGE.saturating_add(Duration::from_millis(500));
/// Name in errors, and time limit, of the worker that processes pictures.
const WORKER: (&str, Duration) = ("the image worker", work::IMAGE);
/// Capacity of the mailbox: the owner asks for one face at a time.
const MAILBOX: usize = 2;

/// A request to read a face, with the channel of its answer.
#[derive(Debug)]
pub(super) struct Look {
    /// Where the face is expected, and the exposure.
    pub(super) view: View,
    /// Channel of the answer.
    pub(super) reply: oneshot::Sender<Result<FaceReading, Error>>,
}

/// The sending end of a camera's VSP. The VSP ends when the last clone is dropped.
#[derive(Debug, Clone)]
pub struct VspHandle {
    name: String,
    mailbox: mpsc::Sender<Look>,
    tracking: std::sync::Arc<watch::Sender<bool>>,
    sensing: std::sync::Arc<watch::Sender<Sensing>>,
    target: watch::Receiver<Option<Target>>,
    /// Way to the VSP; `None` for one on the node of its owner.
    way: Option<Way>,
    /// Additional time of an answer from another node.
    trip: Duration,
}

impl VspHandle {
    /// Returns the handle for an owner on another node.
    #[must_use]
    pub(crate) fn across(self, way: &Way) -> Self {
        Self {
            tracking: way.set(&self.tracking),
            sensing: way.set(&self.sensing),
            target: way.watch(Toward::Home, Carries::Newest, self.target),
            way: Some(way.clone()),
            trip: way.longest_trip(),
            ..self
        }
    }

    /// Passes on a request that came over a link. A VSP that has ended drops it, and with it the
    /// channel of its answer.
    pub(super) async fn pass(&self, look: Look) {
        let _ = self.mailbox.send(look).await;
    }

    /// Returns a receiver of the poses of the cube.
    pub(super) fn targets(&self) -> watch::Receiver<Option<Target>> {
        self.target.clone()
    }

    /// Begins or ends the tracking of the cube.
    pub fn track(&self, on: bool) {
        self.tracking.send_replace(on);
    }

    /// Sets how the VSP looks for the cube from the next frame on.
    pub fn configure(&self, sensing: Sensing) {
        self.sensing.send_replace(sensing);
    }

    /// Returns the latest pose of the cube; `None` before one was found.
    #[must_use]
    pub fn target(&self) -> Option<Target> {
        *self.target.borrow()
    }

    /// Reads the face of the cube that the camera sees. `view` says where the face is expected, and
    /// the exposure.
    ///
    /// # Errors
    /// Non-fatal with the reason when the camera finds no face.
    pub async fn look(&self, view: View) -> Result<FaceReading, Error> {
        let closed = || Error::System {
            actor: self.name.clone(),
            place: "look".into(),
            cause: System::Closed(self.name.clone()),
        };
        let (reply, answer) = oneshot::channel();
        let sent = way::send(self.way.as_ref(), &self.mailbox, (Look { view, reply }, answer));
        let answer = sent.await.ok_or_else(closed)?;
        answer_of(&self.name, "look", Some(PATIENCE + self.trip), answer).await
    }
}

/// The parts of a camera's VSP.
pub struct Parts {
    /// Source of the frames.
    pub source: Box<dyn FrameSource>,
    /// Believed optics.
    pub intrinsics: Intrinsics,
    /// Believed pose of a stand-alone camera; `None` for a camera in a hand.
    pub world_from_camera: Option<Pose>,
    /// Edge of the cube (m).
    pub edge: f64,
    /// Method by which a stand-alone camera finds the cube.
    pub method: Method,
    /// Measurement from which a stand-alone camera computes the pose of the cube.
    pub pose_by: PoseBy,
    /// Declared time of one localisation, for the virtual clock.
    pub localisation: Effort,
    /// Declared time of reading one face, for the virtual clock.
    pub face: Effort,
    /// Servo periods between two frames while tracking.
    pub frame_periods: u64,
    /// Index of the camera.
    pub camera: usize,
    /// Multiple of each ordered exposure.
    pub exposure: f64,
    /// The services of the run.
    pub services: Services,
}

/// The actor with its memory.
struct Vsp {
    name: String,
    /// Source of the frames; `None` while a worker has it, and after that worker panicked.
    source: Option<Box<dyn FrameSource>>,
    intrinsics: Intrinsics,
    edge: f64,
    localisation: Effort,
    face: Effort,
    frame_periods: u64,
    camera: usize,
    exposure: f64,
    services: Services,
    fault: Arc<ActorFault>,
    heartbeat: Heartbeat,
    /// Period of the last usable picture.
    seen: u64,
    /// Whether the absence of usable pictures has been reported.
    reported: bool,
    /// Period of the last recorded picture.
    kept: Option<u64>,
    /// Period of the newest picture in which the cube was sought.
    taken: Option<u64>,
    /// Tracker of the cube; `None` in a camera in a hand, which tracks nothing.
    watcher: Option<CubeWatcher>,
    mailbox: mpsc::Receiver<Look>,
    tracking: watch::Receiver<bool>,
    sensing: watch::Receiver<Sensing>,
    target: watch::Sender<Option<Target>>,
}

/// Starts the VSP of a camera as a task, and returns the sending end of its mailbox.
#[must_use]
pub(crate) fn spawn(name: &str, parts: Parts) -> VspHandle {
    let Supervision { watchdog, fault, .. } = parts.services.supervision.clone();
    let (mailbox, looks) = mpsc::channel(MAILBOX);
    // The camera rests until its owner orders the tracking or a look.
    let (tracking, tracked) = watch::channel(false);
    let (sensing, configured) = watch::channel(Sensing::SEEK);
    let (target, targets) = watch::channel(None);
    let name = format!("vsp {name}");
    let settings = DetectorSettings { method: parts.method, ..DetectorSettings::default() };
    let watcher = parts.world_from_camera.map(|world_from_camera| {
        CubeWatcher::new(world_from_camera, parts.intrinsics, parts.edge, settings)
            .posing(parts.pose_by)
    });
    let vsp = Vsp {
        name: name.clone(),
        source: Some(parts.source),
        intrinsics: parts.intrinsics,
        edge: parts.edge,
        localisation: parts.localisation,
        face: parts.face,
        frame_periods: parts.frame_periods.max(1),
        camera: parts.camera,
        exposure: parts.exposure,
        services: parts.services,
        fault,
        heartbeat: watchdog.heartbeat(&name),
        seen: 0,
        reported: false,
        kept: None,
        taken: None,
        watcher,
        mailbox: looks,
        tracking: tracked,
        sensing: configured,
        target,
    };
    let span = tracing::info_span!("vsp", name = vsp.name);
    watchdog.spawn(&name, vsp.run().instrument(span));
    VspHandle {
        name,
        mailbox,
        tracking: std::sync::Arc::new(tracking),
        sensing: std::sync::Arc::new(sensing),
        target: targets,
        way: None,
        trip: Duration::ZERO,
    }
}

/// Receiving ends of the requests and settings of a VSP on another node.
pub(super) struct Ends {
    /// Requests to read a face.
    pub(super) looks: mpsc::Receiver<Look>,
    /// Whether the VSP tracks the cube.
    pub(super) tracking: watch::Receiver<bool>,
    /// How the VSP looks for the cube.
    pub(super) sensing: watch::Receiver<Sensing>,
}

/// Makes the handle of a VSP on another node, and the receiving ends of all that it sends. `target`
/// has the poses of the cube; an answer is on its way for `trip` longer than on one node.
pub(super) fn remote(
    name: &str,
    target: watch::Receiver<Option<Target>>,
    trip: Duration,
) -> (VspHandle, Ends) {
    let (mailbox, looks) = mpsc::channel(MAILBOX);
    let (track, tracking) = watch::channel(false);
    let (configure, sensing) = watch::channel(Sensing::SEEK);
    let handle = VspHandle {
        name: format!("vsp {name}"),
        mailbox,
        tracking: Arc::new(track),
        sensing: Arc::new(configure),
        target,
        way: None,
        trip,
    };
    (handle, Ends { looks, tracking, sensing })
}

impl Vsp {
    /// Answers requests to read a face and, while tracking, looks for the cube in one picture every
    /// `frame_periods` servo periods.
    async fn run(mut self) {
        let mut next_frame = 0;
        loop {
            let tracking = *self.tracking.borrow_and_update();
            tokio::select! {
                // In a fixed order: a random one would make virtual runs differ.
                biased;
                look = self.mailbox.recv() => match look {
                    Some(look) => {
                        self.heartbeat.works();
                        self.fault.occur().await;
                        self.answer(look).await;
                    }
                    None => return,
                },
                changed = self.tracking.changed() => {
                    if changed.is_err() {
                        return;
                    }
                    // A pose from before is no pose of the cube that is tracked from now on.
                    self.target.send_replace(None);
                    next_frame = self.services.clock.period() + 1;
                    (self.seen, self.reported, self.taken) = (next_frame, false, None);
                },
                () = self.services.clock.until(next_frame), if tracking => {
                    self.heartbeat.works();
                    self.fault.occur().await;
                    self.localise(next_frame).await;
                    // The next point of the grid: frames that were missed are not made up for,
                    // or a slow localisation would fall behind for good.
                    while next_frame <= self.services.clock.period() {
                        next_frame += self.frame_periods;
                    }
                },
            }
            self.heartbeat.waits();
        }
    }

    /// Looks for the cube in the picture that the camera delivers in `period`, and publishes the
    /// pose of the cube if it is found.
    async fn localise(&mut self, period: u64) {
        let (Some(mut source), Some(mut watcher)) = (self.source.take(), self.watcher.take())
        else {
            return;
        };
        let effort = self.localisation;
        let sensing = *self.sensing.borrow_and_update();
        let near = match sensing.window {
            Window::Whole => None,
            Window::Around { centre, reach } => Some((centre, reach)),
        };
        // A search for a cube at an unknown place continues in the whole picture.
        let elsewhere = sensing.mode == Mode::Seek;
        // The text identifies the request in a recording, so that a replay detects a different one.
        let asked = format!("{sensing:?}");
        let played = self.services.playback.as_ref().map(|p| p.sensed(&self.name, period, &asked));
        let unrecorded = matches!(played, Some(Played::Nothing));
        let (taken, exposure) = (self.taken, self.exposed(sensing.exposure, period));
        let work = self.services.work.run(WORKER, move || {
            let (found, frame) = match source.grab(period, exposure) {
                // Under verification the recorded answer replaces that of the camera.
                _ if played.is_some() => (played.map_or_else(not_recorded, recorded_cube), None),
                // A repeated picture is neither searched nor shown again.
                Ok(frame) if repeated(&frame, taken).is_some() => {
                    (Err(repeated(&frame, taken).unwrap_or_default()), None)
                }
                // A stale or black one is shown, so that the operator sees the reason.
                Ok(frame) if unusable(&frame, period).is_some() => {
                    (Err(unusable(&frame, period).unwrap_or_default()), Some(frame))
                }
                Ok(frame) => {
                    // The tracker's time is that of the exposure: a late picture is an old one.
                    let seconds = frame.period as f64 * PERIOD;
                    let found = watcher
                        .observe(&frame.image, seconds, near, elsewhere)
                        .map(|seen| (seen, frame.period))
                        .map_err(|refusal| refusal.to_string());
                    (found, Some(frame))
                }
                Err(missing) => (Err(missing.to_string()), None),
            };
            ((source, watcher, found, frame), effort)
        });
        let (source, watcher, found, frame) = match self.heartbeat.away(work).await {
            Ok(result) => result,
            Err(cause) => return drop(self.worker_failed("localise", cause)),
        };
        self.source = Some(source);
        self.watcher = Some(watcher);
        self.report_unrecorded(unrecorded, period, &asked);
        // A playback has no pictures, so their absence is no fault.
        if self.services.playback.is_none() {
            self.report_absence(period, frame.as_ref(), found.as_ref().err());
        }
        self.taken = self.taken.max(frame.as_ref().map(|frame| frame.period));
        // The pose is as old as the light of the picture, not as the request for it.
        let exposed = found.as_ref().map_or(period, |(_, exposed)| *exposed);
        self.record_and_show((period, &asked, exposed), frame, KEPT_PERIODS, &|| match &found {
            Ok((seen, _)) => Found::Cube(seen.world_from_cube, seen.speed),
            Err(reason) => Found::Nothing(reason.clone()),
        });
        match found {
            Ok((seen, _)) => self.publish(&sensing, &seen, exposed),
            Err(reason) => tracing::debug!(actor = %self.name, %reason, "no cube"),
        }
    }

    /// Returns the exposure of a picture for which a task orders `exposure`: the scenario and the
    /// operator may choose a multiple of it.
    fn exposed(&mut self, exposure: f64, period: u64) -> f64 {
        let factors = self.services.tuning.factors(period);
        exposure * self.exposure * factors[Parameter::Exposure]
    }

    /// Publishes the pose and speed of the cube; `period` is that of the picture's exposure.
    fn publish(&self, sensing: &Sensing, seen: &Watched, period: u64) {
        self.services.trace.message(&self.name, "look", sensing);
        let target = Target { world_from_cube: seen.world_from_cube, speed: seen.speed, period };
        self.services.trace.message(&self.name, "watch", &target);
        self.target.send_replace(Some(target));
    }

    /// Raises and returns the error for image processing that panicked or hangs; `place` names the
    /// request. The worker took the camera and the track with it. Without the alarm a generator
    /// would wait for a cube that no camera looks for.
    fn worker_failed(&self, place: &'static str, cause: System) -> Error {
        let error = Error::System { actor: self.name.clone(), place: place.into(), cause };
        self.services.supervision.watchdog.raise(error.clone());
        error
    }

    /// Reads a face as the request `look` asks, and answers the request.
    async fn answer(&mut self, look: Look) {
        // Without a camera the request is dropped, and its sender sees a closed channel.
        let Some(mut source) = self.source.take() else { return };
        let (intrinsics, edge, period) = (self.intrinsics, self.edge, self.services.clock.period());
        let (view, effort) = (look.view, self.face);
        let asked = format!("{view:?}");
        let played = self.services.playback.as_ref().map(|p| p.sensed(&self.name, period, &asked));
        let unrecorded = matches!(played, Some(Played::Nothing));
        let exposure = self.exposed(view.exposure, period);
        let work = self.services.work.run(WORKER, move || {
            let mut took = None;
            let (reading, frame) = match source.grab(period, exposure) {
                _ if played.is_some() => (played.map_or_else(not_recorded, recorded_face), None),
                // A repeated picture is no fault here: a look has no filter that counts twice.
                Ok(frame) if unusable(&frame, period).is_some() => {
                    (Err(unusable(&frame, period).unwrap_or_default()), Some(frame))
                }
                Ok(frame) => {
                    // Measured for the report alone: a virtual run takes the declared time.
                    let (place, begun) = (&view.camera_from_face, Instant::now());
                    let reading = sensor::read_face(&frame.image, &intrinsics, edge, place)
                        .map_err(|refusal| refusal.to_string());
                    took = Some(begun.elapsed().as_secs_f64());
                    (reading, Some(frame))
                }
                Err(missing) => (Err(missing.to_string()), None),
            };
            ((source, reading, frame, took), effort)
        });
        let result = self.heartbeat.away(work).await;
        if let Ok((_, Ok(_), _, Some(took))) = &result {
            self.services.trace.face_took(period, *took);
        }
        if let Ok((_, reading, ..)) = &result {
            tracing::debug!(
                confidence = ?reading.as_ref().map(|r| r.confidence),
                "a face was looked at"
            );
        }
        let answer = match result {
            Ok((source, reading, frame, _)) => {
                self.source = Some(source);
                self.report_unrecorded(unrecorded, period, &asked);
                // Each look is recorded, however soon after the one before.
                self.record_and_show((period, &asked, period), frame, 0, &|| match &reading {
                    Ok(reading) => Found::Face(Box::new(reading.clone())),
                    Err(reason) => Found::Nothing(reason.clone()),
                });
                reading.map_err(|reason| Error::NonFatal {
                    actor: self.name.clone(),
                    place: "look".into(),
                    cause: NonFatal::NoReading(reason),
                })
            }
            Err(cause) => Err(self.worker_failed("look", cause)),
        };
        // The owner may have given up waiting.
        let _ = look.reply.send(answer);
    }
}

/// Returns the reason why a picture cannot be used: it was taken long before `period`, or it is
/// black.
fn unusable(frame: &Frame, period: u64) -> Option<String> {
    let age = period.saturating_sub(frame.period) as f64 * PERIOD;
    if age > STALE {
        return Some(format!("the picture is {age:.2} s old"));
    }
    let samples = frame.image.as_raw().iter().step_by(SAMPLES);
    let (sum, count) = samples.fold((0_u64, 0_u64), |(s, n), b| (s + u64::from(*b), n + 1));
    (sum as f64 <= BLACK * count as f64).then(|| "the picture is black".to_owned())
}

impl Vsp {
    /// Tells the operator once when the camera has delivered no usable picture for [`STALE`], and
    /// once when pictures arrive again. `frame` is the picture of `period`, if one came; `reason`
    /// says why the cube was not found in it.
    fn report_absence(&mut self, period: u64, frame: Option<&Frame>, reason: Option<&String>) {
        let seconds = period as f64 * PERIOD;
        if frame.is_some_and(|frame| unusable(frame, period).is_none()) {
            self.seen = period;
            if std::mem::take(&mut self.reported) {
                self.services
                    .trace
                    .tell(Notice::Note(seconds, format!("{}: pictures arrive again", self.name)));
            }
        } else if !self.reported && period.saturating_sub(self.seen) as f64 * PERIOD > STALE {
            // At 25 Hz up to two bad pictures in a row are no report.
            self.reported = true;
            let reason = reason.cloned().unwrap_or_default();
            let cause = NonFatal::NoReading(format!("{reason}, period {period}"));
            let actor = self.name.clone();
            self.services.trace.tell(Notice::Error(
                seconds,
                Error::NonFatal { actor, place: "watch".into(), cause },
            ));
        }
    }

    /// Reports, if `unrecorded` is `true`, that the recording under verification has no answer to
    /// the request `asked` in `period`.
    fn report_unrecorded(&self, unrecorded: bool, period: u64, asked: &str) {
        if let (true, Some(playback)) = (unrecorded, &self.services.playback) {
            playback.report_unrecorded_look(&self.name, period, asked);
        }
    }

    /// Records and shows a picture and the result of vision in it. The first parameter has the
    /// period of the request, the request itself and the period of the exposure. The picture is
    /// recorded only if the last recorded one is at least `apart` periods old.
    fn record_and_show(
        &mut self,
        (period, asked, exposed): (u64, &str, u64),
        frame: Option<Frame>,
        apart: u64,
        found: &dyn Fn() -> Found,
    ) {
        let Services { trace, clock, .. } = &self.services;
        let look = trace::Look { sensor: &self.name, period, asked, exposed };
        // The result is recorded even without a picture: a verification plays it back.
        trace.sensed(clock.period(), &look, found);
        let Some(frame) = frame else { return };
        let keeps =
            trace.is_recorded() && self.kept.is_none_or(|last| last + apart <= frame.period);
        if keeps {
            self.kept = Some(frame.period);
        }
        trace.saw(self.camera, frame, keeps, found);
    }
}

/// Returns the reason why a picture must not be searched again: a picture that was exposed in the
/// same or a later period, `taken`, has been searched already. Returns `None` for a new picture.
fn repeated(frame: &Frame, taken: Option<u64>) -> Option<String> {
    let taken = taken.filter(|taken| frame.period <= *taken)?;
    Some(format!("the picture of period {} arrived again after that of {taken}", frame.period))
}

/// Returns the cube that a recording holds in place of the camera's result, with the period of the
/// exposure; or the recorded reason why no cube was found.
fn recorded_cube(played: Played) -> Result<(Watched, u64), String> {
    match played {
        Played::Answer(Ok(kept::Found::Cube { world_from_cube, speed, exposed })) => {
            Ok((Watched { world_from_cube, speed }, exposed))
        }
        Played::Answer(Err(reason)) => Err(reason),
        Played::Answer(Ok(_)) | Played::Nothing => not_recorded(),
    }
}

/// Returns the face that a recording holds in place of the camera's result, or the recorded reason
/// why no face was found.
fn recorded_face(played: Played) -> Result<FaceReading, String> {
    match played {
        Played::Answer(Ok(kept::Found::Face(reading))) => Ok(reading),
        Played::Answer(Err(reason)) => Err(reason),
        Played::Answer(Ok(_)) | Played::Nothing => not_recorded(),
    }
}

/// Returns the error text for a request to vision that the recording does not contain.
fn not_recorded<T>() -> Result<T, String> {
    Err("the recording does not contain this look".to_owned())
}

/// Starts the VSP that aggregates the wrist forces each `periods` servo periods. Returns a receiver
/// of its results: the norms of forces and torques now, and their peaks since the start.
#[must_use]
pub(crate) fn spawn_forces(
    services: &Services,
    mut states: Vec<watch::Receiver<ArmState>>,
    periods: u64,
) -> watch::Receiver<Forces> {
    let mut aggregate = Forces { arms: vec![WristLoad::default(); states.len()] };
    let (publish, forces) = watch::channel(aggregate.clone());
    let clock = services.clock.clone();
    let aggregating = async move {
        let mut period = clock.period();
        // The actor has no mailbox: it ends when no receiver of its forces is left.
        while !publish.is_closed() {
            period += periods.max(1);
            clock.until(period).await;
            for (felt, state) in aggregate.arms.iter_mut().zip(&mut states) {
                let wrench = state.borrow_and_update().wrench_in_tool;
                (felt.force, felt.torque) = (wrench.force.norm(), wrench.torque.norm());
                felt.peak_force = felt.peak_force.max(felt.force);
                felt.peak_torque = felt.peak_torque.max(felt.torque);
            }
            publish.send_replace(aggregate.clone());
        }
    };
    let name = "vsp forces";
    services
        .supervision
        .watchdog
        .spawn(name, aggregating.instrument(tracing::info_span!("vsp", name)));
    forces
}

#[cfg(test)]
mod tests {
    use super::super::clock::Clock;
    use super::super::control::Control;
    use super::super::trace::Trace;
    use super::super::watchdog::Watchdog;
    use super::super::work::Work;
    use super::*;
    use crate::hw::camera::NoFrame;
    use crate::record::run_hash::RunHash;
    use crate::scenario::keys::Pace;
    use image::RgbImage;

    /// Camera whose driver panics.
    struct Broken;

    impl FrameSource for Broken {
        fn grab(&mut self, _: u64, _: f64) -> Result<Frame, NoFrame> {
            panic!("on purpose");
        }
    }

    /// Starts the VSP of a camera whose driver panics; returns it with the run's watchdog.
    fn broken(pace: Pace) -> (VspHandle, Watchdog) {
        let (_will, control) = watch::channel(Control::Running);
        let (trace, _notices) = Trace::bare(RunHash::default());
        let clock = Clock::new(tokio::time::Instant::now(), Arc::default());
        let mut services = Services::bare(clock, control, trace);
        let watchdog = services.supervision.watchdog.clone();
        services.work = Work::new(pace, &watchdog);
        let intrinsics = Intrinsics {
            width: 4,
            height: 4,
            focal: (4.0, 4.0),
            centre: (2.0, 2.0),
            distortion: (0.0, 0.0),
        };
        let parts = Parts {
            source: Box::new(Broken),
            intrinsics,
            world_from_camera: Some(Pose::identity()),
            edge: 0.057,
            method: Method::Edges,
            pose_by: PoseBy::Edges,
            localisation: Effort(0.0),
            face: Effort(0.0),
            frame_periods: 20,
            camera: 0,
            exposure: 1.0,
            services,
        };
        (spawn("mpc", parts), watchdog)
    }

    #[tokio::test]
    async fn dead_image_worker_ends_the_run() {
        for pace in [Pace::RealTime, Pace::Virtual] {
            let (camera, watchdog) = broken(pace);
            camera.track(true);
            let raised = tokio::time::timeout(Duration::from_secs(10), watchdog.raised());
            let text = raised.await.unwrap().to_string();
            let expected = "the image worker panicked: on purpose (system, vsp mpc, localise)";
            assert_eq!(text, expected);
        }
    }

    #[tokio::test]
    async fn dead_image_worker_fails_a_look() {
        for pace in [Pace::RealTime, Pace::Virtual] {
            let (camera, watchdog) = broken(pace);
            let view = View { camera_from_face: Pose::identity(), exposure: 1.0 };
            let told = camera.look(view).await.unwrap_err();
            let expected = "the image worker panicked: on purpose (system, vsp mpc, look)";
            assert_eq!(told.to_string(), expected);
            assert_eq!(watchdog.raised().await, told);
        }
    }

    #[test]
    fn repeated_picture_is_refused() {
        let frame = |period| Frame { period, image: RgbImage::new(2, 2) };

        assert_eq!(repeated(&frame(40), None), None);
        assert_eq!(repeated(&frame(40), Some(20)), None);
        for taken in [40, 60] {
            let reason = repeated(&frame(40), Some(taken)).unwrap();
            assert!(reason.contains("period 40"), "{reason}");
        }
    }

    #[test]
    fn replayed_cube_sighting_keeps_its_exposure_period() {
        let found = kept::Found::Cube { world_from_cube: Pose::identity(), speed: 0.1, exposed: 7 };

        let (seen, exposed) = recorded_cube(Played::Answer(Ok(found))).unwrap();

        assert_eq!((seen.speed, exposed), (0.1, 7));
    }
}
