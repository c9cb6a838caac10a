//! What the other actors tell the operator: notices by a bounded mailbox, and the board beside it.

use super::board::Board;
use crate::error::Error;
use crate::motion::PERIOD;
use crate::operator::{Class, OutcomeView};
use crate::record::recorder::{Entry, Recorder};
use tokio::sync::mpsc;

/// Notices that may wait; more would mean that the terminal hangs, and then they are dropped.
const MAILBOX: usize = 1024;
/// A message of an actor to the operator.
#[derive(Debug, Clone, PartialEq)]
pub enum Notice {
    /// A phase of the task begins at this simulated or real time [s].
    Phase(f64, String),
    /// Something worth knowing.
    Note(f64, String),
    /// A deviation: a step that is retried, given up, or started over.
    Warning(f64, String),
    /// An error, with its class, actor and place.
    Error(f64, Error),
    /// The run is over; nothing comes after it.
    Over(OutcomeView),
}

/// The far end of the UI's mailbox, and the board beside it.
#[derive(Debug, Clone)]
pub struct UiHandle {
    pub(super) mailbox: mpsc::Sender<Notice>,
    pub(super) board: Option<Board>,
    pub(super) recorder: Recorder,
}

impl UiHandle {
    /// Sends a notice to the operator; never waits.
    pub fn tell(&self, notice: Notice) {
        note(&self.recorder, &notice);
        if self.mailbox.try_send(notice).is_err() {
            tracing::warn!("the operator's terminal does not keep up: a notice was dropped");
        }
    }

    /// Returns the recorder of the run.
    #[must_use]
    pub fn recorder(&self) -> &Recorder {
        &self.recorder
    }

    /// Returns the board of the latest values; `None` without faces.
    #[must_use]
    pub fn board(&self) -> Option<&Board> {
        self.board.as_ref()
    }
}

/// Creates the mailbox alone: the caller takes the receiver in place of a UI.
#[must_use]
pub fn mailbox() -> (UiHandle, mpsc::Receiver<Notice>) {
    let (mailbox, notices) = mpsc::channel(MAILBOX);
    (UiHandle { mailbox, board: None, recorder: Recorder::default() }, notices)
}

/// Writes a notice into the recording.
pub(crate) fn note(recorder: &Recorder, notice: &Notice) {
    let at = |seconds: f64| (seconds / PERIOD).round() as u64;
    let log = |seconds: f64, class: Class, who: &str, text: &str| {
        recorder.note(at(seconds), || Entry::Log(class, who.to_owned(), text.to_owned()));
    };
    match notice {
        Notice::Phase(time, name) => {
            recorder.note(at(*time), || Entry::Phase(name.clone(), String::new()));
            log(*time, Class::Info, "mp", &format!("phase: {name}"));
        }
        Notice::Note(time, text) => log(*time, Class::Info, "mp", text),
        Notice::Warning(time, text) => log(*time, Class::Warning, "mp", text),
        Notice::Error(time, error) => {
            let (class, actor) = class(error);
            log(*time, class, actor, &error.to_string());
        }
        Notice::Over(_) => {}
    }
}

/// Returns the class of an error and its actor.
pub(crate) fn class(error: &Error) -> (Class, &str) {
    match error {
        Error::NonFatal { actor, .. } => (Class::NonFatal, actor),
        Error::Fatal { actor, .. } => (Class::Fatal, actor),
        Error::System { actor, .. } => (Class::System, actor),
    }
}
