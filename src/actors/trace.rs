//! The trace of the actors' work: one door to the hash of the run, the recording, the latest
//! values and the operator's notices. An actor writes once and awaits no sink; each sink takes its
//! part.
//!
//! - in: messages, notices, pictures, beliefs, each with its period or time
//! - out: the hash, which covers the messages but not the rest of these inputs; the recording and
//!   the latest values, for people
//!
//! The journal is none of these sinks: MP alone writes it, and waits until an entry is durable.

use super::latest::{Found, LatestValues, Sight};
use super::notice::{Notice, record};
use crate::generators::Behaviour;
use crate::hw::camera::Frame;
use crate::kernel::Picture;
use crate::operator::Question;
use crate::operator::parameter::Courses;
use crate::record::recorder::{Entry, Recorder};
use crate::record::run_hash::RunHash;
use crate::record::sensed::{self as kept, Sensed};
use serde_json::Value;
use std::fmt::Debug;
use tokio::sync::mpsc;

/// Capacity of the mailbox of notices. A full one means that the terminal hangs; further notices
/// are dropped.
const MAILBOX: usize = 1024;

/// The trace of a run. A clone writes to the same sinks.
#[derive(Debug, Clone)]
pub struct Trace {
    hash: RunHash,
    recorder: Recorder,
    latest: Option<LatestValues>,
    notices: mpsc::Sender<Notice>,
}

/// Request to a camera's VSP, with the servo periods of the request and of the exposure.
pub(crate) struct Look<'a> {
    /// Name of the VSP.
    pub(crate) sensor: &'a str,
    /// Period of the request.
    pub(crate) period: u64,
    /// The request.
    pub(crate) asked: &'a str,
    /// Period in which the picture was exposed.
    pub(crate) exposed: u64,
}

impl Trace {
    /// Creates the trace of a run, which writes to `hash`, `recorder` and `latest`, and the
    /// receiver of the notices that it sends to the UI.
    #[must_use]
    pub fn new(
        hash: RunHash,
        recorder: Recorder,
        latest: Option<LatestValues>,
    ) -> (Self, mpsc::Receiver<Notice>) {
        let (notices, arrive) = mpsc::channel(MAILBOX);
        (Self { hash, recorder, latest, notices }, arrive)
    }

    /// Creates a trace without recording and UI, and the receiver of its notices.
    #[must_use]
    pub fn bare(hash: RunHash) -> (Self, mpsc::Receiver<Notice>) {
        Self::new(hash, Recorder::default(), None)
    }

    /// Adds a message from one actor to another to the hash.
    pub fn message(&self, from: &str, to: &str, message: &impl Debug) {
        self.hash.message(from, to, message);
    }

    /// Sends a notice to the operator, and to the recording.
    pub fn tell(&self, notice: Notice) {
        record(&self.recorder, &notice);
        // Not awaited: a terminal that takes nothing must not stop an actor.
        if self.notices.try_send(notice).is_err() {
            tracing::warn!("the operator's terminal does not keep up: a notice was dropped");
        }
    }

    /// Sends the last notice of a run. It waits for room in the mailbox, unless the UI is gone.
    pub(super) fn tell_last(self, notice: Notice) {
        record(&self.recorder, &notice);
        // The outcome must not be dropped. The run is over, so waiting delays no actor.
        let _ = self.notices.blocking_send(notice);
    }

    /// Writes what MP is doing, for the UI, and what the task's kernel believes, for the UI and the
    /// recording. `picture` makes the belief and is called only if either needs it.
    pub(crate) fn believes(
        &self,
        period: u64,
        doing: &'static str,
        picture: impl Fn() -> Option<Picture>,
    ) {
        if let Some(latest) = &self.latest {
            // Made before the lock, which is held for moments only.
            let picture = picture();
            let mut latest = latest.lock();
            (latest.picture, latest.mp) = (picture, doing);
        }
        // Made again only if there is a recording.
        self.recorder
            .record_some(period, || picture().map(|picture| Entry::Belief(Box::new(picture))));
    }

    /// Writes the behaviours that the effectors are carrying out, for the UI.
    pub(crate) fn ordered(&self, orders: &[Option<Behaviour>]) {
        if let Some(latest) = &self.latest {
            latest.ordered(orders);
        }
    }

    /// Writes the question that the operator is asked, for the UI; `None` when it is closed.
    pub(crate) fn asks(&self, question: Option<Question>) {
        if let Some(latest) = &self.latest {
            latest.lock().question = question;
        }
    }

    /// Writes the courses of the operator's parameters, for the UI.
    pub(crate) fn tuned(&self, courses: Courses) {
        if let Some(latest) = &self.latest {
            latest.lock().courses = Some(courses);
        }
    }

    /// Writes, for the UI, that the operator may move arms by hand from now on.
    pub(crate) fn takes_orders(&self) {
        if let Some(latest) = &self.latest {
            latest.lock().manual = true;
        }
    }

    /// Records how long it took to read a face, by the wall clock (s). Only the report uses it: in
    /// a virtual run the time that the scenario declares counts.
    pub(crate) fn face_took(&self, period: u64, seconds: f64) {
        self.recorder.record(period, || Entry::FaceTook(seconds));
    }

    /// Records the result of vision for the request `look`, which is delivered in period `now`.
    pub(crate) fn sensed(&self, now: u64, look: &Look<'_>, found: &dyn Fn() -> Found) {
        // Request and period are kept beside the result: a verification compares them.
        self.recorder.record(now, || {
            let found = match found() {
                Found::Cube(world_from_cube, speed) => {
                    let exposed = look.exposed;
                    Ok(kept::Found::Cube { world_from_cube, speed, exposed })
                }
                Found::Face(reading) => Ok(kept::Found::Face(*reading)),
                Found::Nothing(reason) => Err(reason),
            };
            let (sensor, asked) = (look.sensor.to_owned(), look.asked.to_owned());
            Entry::Sensed(Sensed { period: look.period, sensor, asked, found })
        });
    }

    /// Writes the reading of a user's own sensor: to the recording and to the UI.
    pub(crate) fn measured(&self, now: u64, look: &Look<'_>, reading: &Result<Value, String>) {
        self.recorder.record(now, || {
            let (sensor, asked) = (look.sensor.to_owned(), look.asked.to_owned());
            let found = reading.clone().map(kept::Found::Own);
            Entry::Sensed(Sensed { period: look.period, sensor, asked, found })
        });
        if let Some(latest) = &self.latest {
            let shown = reading.clone().unwrap_or_else(Value::String);
            latest.lock().sensors.insert(look.sensor.to_owned(), shown);
        }
    }

    /// Writes a picture of a camera: to the recording if `keeps` is `true`, and to the UI together
    /// with the result of vision in it.
    pub(crate) fn saw(&self, camera: usize, frame: Frame, keeps: bool, found: &dyn Fn() -> Found) {
        // The recording gets a copy, the UI the pixels themselves.
        if keeps {
            self.recorder.record(frame.period, || Entry::Picture(camera, frame.image.clone()));
        }
        if let Some(latest) = &self.latest {
            let Frame { period, image } = frame;
            latest.saw(camera, Sight { period, image: Some(image), found: found() });
        }
    }

    /// Returns whether a recording is written.
    pub(crate) fn is_recorded(&self) -> bool {
        self.recorder.is_on()
    }

    /// Returns the hash over all messages and servo records of the run.
    pub(crate) fn hash(&self) -> &RunHash {
        &self.hash
    }

    /// Returns the recorder of the run.
    pub(crate) fn recorder(&self) -> &Recorder {
        &self.recorder
    }

    /// Returns the latest values; `None` without a UI.
    pub(crate) fn latest(&self) -> Option<&LatestValues> {
        self.latest.as_ref()
    }
}
