//! The trace of an actor's work: one door to the hash of the run, the recording, the latest
//! values and the operator's notices.
//!
//! - in: messages, notices, pictures, beliefs, each with its period or time
//! - out: the hash covers messages alone; the recording and the UI get what people look at. An
//!   actor writes once and never waits; each sink takes what concerns it
//!
//! The journal is none of these sinks: MP alone writes it, and waits until it is durable.

use super::latest::{Found, LatestValues, Sight};
use super::notice::{Notice, record};
use crate::generators::Behaviour;
use crate::hw::camera::Frame;
use crate::operator::Question;
use crate::record::recorder::{Entry, Recorder};
use crate::record::run_hash::RunHash;
use crate::record::sensed::{self as kept, Sensed};
use crate::tasks::Picture;
use std::fmt::Debug;
use tokio::sync::mpsc;

/// Notices that may wait; more would mean that the terminal hangs, and then they are dropped.
const MAILBOX: usize = 1024;

/// The traces of a run; a clone writes to the same ones.
#[derive(Debug, Clone)]
pub struct Trace {
    hash: RunHash,
    recorder: Recorder,
    latest: Option<LatestValues>,
    notices: mpsc::Sender<Notice>,
}

/// A look of a camera's VSP.
pub(crate) struct Look<'a> {
    /// Name of the VSP.
    pub(crate) sensor: &'a str,
    /// Period of the request.
    pub(crate) period: u64,
    /// The request.
    pub(crate) asked: &'a str,
    /// Period of the light.
    pub(crate) exposed: u64,
}

impl Trace {
    /// Creates the traces of a run, and the end at which its notices arrive.
    #[must_use]
    pub fn new(
        hash: RunHash,
        recorder: Recorder,
        latest: Option<LatestValues>,
    ) -> (Self, mpsc::Receiver<Notice>) {
        let (notices, arrive) = mpsc::channel(MAILBOX);
        (Self { hash, recorder, latest, notices }, arrive)
    }

    /// Creates traces without recording and faces; notices arrive at the receiver.
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
        if self.notices.try_send(notice).is_err() {
            tracing::warn!("the operator's terminal does not keep up: a notice was dropped");
        }
    }

    /// Sends the last notice of a run. With a full mailbox the terminal hangs, and the end comes with
    /// the last clone of this.
    pub(super) fn tell_last(self, notice: Notice) {
        record(&self.recorder, &notice);
        let _ = self.notices.blocking_send(notice);
    }

    /// Writes what MP is doing, and what its kernel believes.
    pub(crate) fn believes(
        &self,
        period: u64,
        doing: &'static str,
        picture: impl Fn() -> Option<Picture>,
    ) {
        if let Some(latest) = &self.latest {
            let picture = picture();
            let mut latest = latest.lock();
            (latest.picture, latest.mp) = (picture, doing);
        }
        self.recorder
            .note_some(period, || picture().map(|picture| Entry::Belief(Box::new(picture))));
    }

    /// Writes what the effectors are ordered.
    pub(crate) fn ordered(&self, orders: &[Option<Behaviour>; 2]) {
        if let Some(latest) = &self.latest {
            latest.ordered(orders);
        }
    }

    /// Writes the question that the operator is asked; `None` when it is closed.
    pub(crate) fn asks(&self, question: Option<Question>) {
        if let Some(latest) = &self.latest {
            latest.lock().question = question;
        }
    }

    /// Writes that arms may be moved by hand now.
    pub(crate) fn takes_orders(&self) {
        if let Some(latest) = &self.latest {
            latest.lock().manual = true;
        }
    }

    /// Writes the time that it took to read a face (s): for the report alone, since in a run it
    /// takes as long as the scenario declares.
    pub(crate) fn face_took(&self, period: u64, seconds: f64) {
        self.recorder.note(period, || Entry::FaceTook(seconds));
    }

    /// Writes what a look came to, at period `now`.
    pub(crate) fn sensed(&self, now: u64, look: &Look<'_>, found: &dyn Fn() -> Found) {
        self.recorder.note(now, || {
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

    /// Writes the picture of a look: to the recording if `keeps`, and to the UI with what was
    /// found in it.
    pub(crate) fn saw(&self, camera: usize, frame: Frame, keeps: bool, found: &dyn Fn() -> Found) {
        if keeps {
            self.recorder.note(frame.period, || Entry::Picture(camera, frame.image.clone()));
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

    /// Returns the hash.
    pub(crate) fn hash(&self) -> &RunHash {
        &self.hash
    }

    /// Returns the recording.
    pub(crate) fn recorder(&self) -> &Recorder {
        &self.recorder
    }

    /// Returns the latest values; `None` without a UI.
    pub(crate) fn latest(&self) -> Option<&LatestValues> {
        self.latest.as_ref()
    }
}
