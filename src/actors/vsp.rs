//! VSP: aggregates a hardware sensor's readings into what the task needs.
//!
//! Three kinds, after figure 3 of the paper: the stand-alone camera (tracks the cube at 25 Hz), a camera in a
//! hand (reads faces on request), and the aggregate of the wrist forces. The figure names `VSP_MPC` and `VSP_MPF`
//! (of MP) and `VSP_GS1`, `VSP_GS2` (of the ECPs) and the text explains the cameras only: that MPF aggregates the
//! forces and that GS are the gripper's cameras is our reading.

use super::board::{Board, Found, Sight};
use super::clock::Clock;
use super::work::Work;
use crate::cell::Intrinsics;
use crate::error::{Error, NonFatal, System};
use crate::generators::{Mode, Sensing, Target, Window};
use crate::hw::camera::{Frame, FrameSource};
use crate::motion::{ArmState, PERIOD};
use crate::record::tape::Tape;
use crate::spatial::Pose;
use crate::tasks::{Effort, Forces, View};
use crate::vision::sensor::{self, FaceReading};
use crate::vision::watcher::CubeWatcher;
use crate::vision::{DetectorSettings, Method};
use tokio::sync::{mpsc, oneshot, watch};
use tracing::Instrument as _;

/// Requests that may wait: one face at a time is asked for.
const MAILBOX: usize = 2;

#[derive(Debug)]
struct Look {
    view: View,
    reply: oneshot::Sender<Result<FaceReading, Error>>,
}

/// The far end of a VSP.
#[derive(Debug, Clone)]
pub struct VspHandle {
    name: String,
    mailbox: mpsc::Sender<Look>,
    tracking: std::sync::Arc<watch::Sender<bool>>,
    sensing: std::sync::Arc<watch::Sender<Sensing>>,
    target: watch::Receiver<Option<Target>>,
}

impl VspHandle {
    /// Begins or ends the tracking of the cube.
    pub fn track(&self, on: bool) {
        self.tracking.send_replace(on);
    }

    /// Looks as a generator wants it from the next frame on.
    pub fn configure(&self, sensing: Sensing) {
        self.sensing.send_replace(sensing);
    }

    /// The latest pose of the cube.
    #[must_use]
    pub fn target(&self) -> Option<Target> {
        *self.target.borrow()
    }

    /// Reads a face.
    ///
    /// # Errors
    /// Non-fatal with the reason when the face is not found.
    pub async fn look(&self, view: View) -> Result<FaceReading, Error> {
        let closed = || Error::System {
            actor: self.name.clone(),
            place: "look",
            cause: System::Closed(self.name.clone()),
        };
        let (reply, answer) = oneshot::channel();
        self.mailbox.send(Look { view, reply }).await.map_err(|_| closed())?;
        answer.await.map_err(|_| closed())?
    }
}

/// What a camera's VSP is made of.
pub struct Parts {
    /// Where frames come from.
    pub source: Box<dyn FrameSource>,
    /// Believed optics.
    pub intrinsics: Intrinsics,
    /// Believed place of a stand-alone camera; `None` for a camera in a hand.
    pub world_from_camera: Option<Pose>,
    /// Edge of the cube [m].
    pub edge: f64,
    /// How the cube is found by the stand-alone camera.
    pub method: Method,
    /// Declared time of one localisation, for the virtual clock.
    pub localisation: Effort,
    /// Declared time of reading one face, for the virtual clock.
    pub face: Effort,
    /// Servo periods between two frames while tracking.
    pub frame_periods: u64,
    /// Servo periods and time.
    pub clock: Clock,
    /// The door for image processing.
    pub work: Work,
    /// Where messages are noted.
    pub tape: Tape,
    /// Where what was seen is shown, and the camera's index; `None` when nobody looks.
    pub show: Option<(Board, usize)>,
}

struct Vsp {
    name: String,
    source: Option<Box<dyn FrameSource>>,
    intrinsics: Intrinsics,
    edge: f64,
    localisation: Effort,
    face: Effort,
    frame_periods: u64,
    clock: Clock,
    work: Work,
    tape: Tape,
    show: Option<(Board, usize)>,
    watcher: Option<CubeWatcher>,
    mailbox: mpsc::Receiver<Look>,
    tracking: watch::Receiver<bool>,
    sensing: watch::Receiver<Sensing>,
    target: watch::Sender<Option<Target>>,
}

/// Creates the VSP of a camera.
#[must_use]
pub fn spawn(name: &str, parts: Parts) -> VspHandle {
    let (mailbox, looks) = mpsc::channel(MAILBOX);
    let (tracking, tracked) = watch::channel(false);
    let (sensing, configured) = watch::channel(Sensing::SEEK);
    let (target, targets) = watch::channel(None);
    let name = format!("vsp {name}");
    let settings = DetectorSettings { method: parts.method, ..DetectorSettings::default() };
    let watcher = parts.world_from_camera.map(|world_from_camera| {
        CubeWatcher::new(world_from_camera, parts.intrinsics, parts.edge, settings)
    });
    let vsp = Vsp {
        name: name.clone(),
        source: Some(parts.source),
        intrinsics: parts.intrinsics,
        edge: parts.edge,
        localisation: parts.localisation,
        face: parts.face,
        frame_periods: parts.frame_periods.max(1),
        clock: parts.clock,
        work: parts.work,
        tape: parts.tape,
        show: parts.show,
        watcher,
        mailbox: looks,
        tracking: tracked,
        sensing: configured,
        target,
    };
    let span = tracing::info_span!("vsp", name = vsp.name);
    tokio::spawn(vsp.run().instrument(span));
    VspHandle {
        name,
        mailbox,
        tracking: std::sync::Arc::new(tracking),
        sensing: std::sync::Arc::new(sensing),
        target: targets,
    }
}

impl Vsp {
    async fn run(mut self) {
        let mut next_frame = 0;
        loop {
            let tracking = *self.tracking.borrow_and_update();
            tokio::select! {
                biased;
                look = self.mailbox.recv() => match look {
                    Some(look) => self.answer(look).await,
                    None => return,
                },
                changed = self.tracking.changed() => {
                    if changed.is_err() {
                        return;
                    }
                    self.target.send_replace(None);
                    next_frame = self.clock.period() + 1;
                },
                () = self.clock.until(next_frame), if tracking => {
                    self.localise(next_frame).await;
                    // On the grid of frames; a frame that was missed is not made up for.
                    while next_frame <= self.clock.period() {
                        next_frame += self.frame_periods;
                    }
                },
            }
        }
    }

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
        let elsewhere = sensing.mode == Mode::Seek;
        let result = self
            .work
            .run(move || {
                let (found, frame) = match source.grab(period, sensing.exposure) {
                    Ok(frame) => {
                        let seconds = frame.period as f64 * PERIOD;
                        let found = watcher
                            .observe(&frame.image, seconds, near, elsewhere)
                            .map_err(|refusal| refusal.to_string());
                        (found, Some(frame))
                    }
                    Err(missing) => (Err(missing.to_string()), None),
                };
                ((source, watcher, found, frame), effort)
            })
            .await;
        let Some((source, watcher, found, frame)) = result else {
            tracing::error!(actor = %self.name, "the image worker died");
            return;
        };
        self.source = Some(source);
        self.watcher = Some(watcher);
        self.shown(frame, || match &found {
            Ok(seen) => Found::Cube(seen.world_from_cube, seen.speed),
            Err(reason) => Found::Nothing(reason.clone()),
        });
        match found {
            Ok(seen) => {
                self.tape.message(&self.name, "look", &sensing);
                let target =
                    Target { world_from_cube: seen.world_from_cube, speed: seen.speed, period };
                self.tape.message(&self.name, "watch", &target);
                self.target.send_replace(Some(target));
            }
            Err(reason) => tracing::debug!(actor = %self.name, %reason, "no cube"),
        }
    }

    async fn answer(&mut self, look: Look) {
        let Some(mut source) = self.source.take() else { return };
        let (intrinsics, edge, period) = (self.intrinsics, self.edge, self.clock.period());
        let (view, effort) = (look.view, self.face);
        let result = self
            .work
            .run(move || {
                let (reading, frame) = match source.grab(period, view.exposure) {
                    Ok(frame) => {
                        let place = &view.camera_from_face;
                        let reading = sensor::read_face(&frame.image, &intrinsics, edge, place)
                            .map_err(|refusal| refusal.to_string());
                        (reading, Some(frame))
                    }
                    Err(missing) => (Err(missing.to_string()), None),
                };
                ((source, reading, frame), effort)
            })
            .await;
        if let Some((_, reading, _)) = &result {
            tracing::debug!(confidence = ?reading.as_ref().map(|r| r.confidence), "a face was looked at");
        }
        let answer = match result {
            Some((source, reading, frame)) => {
                self.source = Some(source);
                self.shown(frame, || match &reading {
                    Ok(reading) => Found::Face(Box::new(reading.clone())),
                    Err(reason) => Found::Nothing(reason.clone()),
                });
                reading.map_err(|reason| Error::NonFatal {
                    actor: self.name.clone(),
                    place: "look",
                    cause: NonFatal::NoReading(reason),
                })
            }
            None => Err(Error::System {
                actor: self.name.clone(),
                place: "look",
                cause: System::Closed("the image worker".into()),
            }),
        };
        let _ = look.reply.send(answer);
    }
}

impl Vsp {
    /// Shows a picture and what was found in it.
    fn shown(&self, frame: Option<Frame>, found: impl FnOnce() -> Found) {
        if let (Some((board, camera)), Some(frame)) = (&self.show, frame) {
            let Frame { period, image } = frame;
            board.saw(*camera, Sight { period, image: Some(image), found: found() });
        }
    }
}

/// Creates the VSP that aggregates the wrist forces.
#[must_use]
pub fn spawn_forces(
    mut states: Vec<watch::Receiver<ArmState>>,
    clock: Clock,
    periods: u64,
) -> watch::Receiver<Forces> {
    let (publish, forces) = watch::channel(Forces::default());
    let aggregating = async move {
        let mut aggregate = Forces::default();
        let mut period = clock.period();
        while !publish.is_closed() {
            period += periods.max(1);
            clock.until(period).await;
            for (felt, state) in aggregate.arms.iter_mut().zip(&mut states) {
                let wrench = state.borrow_and_update().wrench_in_tool;
                (felt.force, felt.torque) = (wrench.force.norm(), wrench.torque.norm());
                felt.peak_force = felt.peak_force.max(felt.force);
                felt.peak_torque = felt.peak_torque.max(felt.torque);
            }
            publish.send_replace(aggregate);
        }
    };
    tokio::spawn(aggregating.instrument(tracing::info_span!("vsp", name = "vsp forces")));
    forces
}
