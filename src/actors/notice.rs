//! Notices of the other actors to the operator.

use crate::error::Error;
use crate::kernel::Remark;
use crate::motion::PERIOD;
use crate::operator::{Class, OutcomeView};
use crate::record::recorder::{Entry, Recorder};

/// A message of an actor to the operator.
#[derive(Debug, Clone, PartialEq)]
pub enum Notice {
    /// A phase of the task begins at this simulated or real time (s).
    Phase(f64, String),
    /// Something worth knowing.
    Note(f64, String),
    /// A deviation: a step that is retried, given up, or started over.
    Warning(f64, String),
    /// An error, with its class, actor and place.
    Error(f64, Error),
    /// Message of an actor on another node: time (s), class, name of the actor, text.
    Elsewhere(f64, Class, String, String),
    /// The run is over; nothing comes after it.
    Over(OutcomeView),
}

impl Notice {
    /// Makes a notice of what the kernel of an actor remarks at `time` (s). The text begins with
    /// `who`, if that is not empty.
    pub(super) fn remark(time: f64, who: &str, remark: Remark) -> Self {
        let named = |text| if who.is_empty() { text } else { format!("{who}: {text}") };
        match remark {
            Remark::Note(text) => Self::Note(time, named(text)),
            Remark::Deviation(text) => Self::Warning(time, named(text)),
        }
    }
}

/// Writes a notice into the recording.
pub(super) fn record(recorder: &Recorder, notice: &Notice) {
    // A recording counts in periods of 2 ms; a notice has the time of the run.
    let at = |seconds: f64| (seconds / PERIOD).round() as u64;
    let log = |seconds: f64, class: Class, who: &str, text: &str| {
        recorder.record(at(seconds), || Entry::Log(class, who.to_owned(), text.to_owned()));
    };
    match notice {
        // Twice: as an entry of its own for the timeline, and as a line of the log.
        Notice::Phase(time, name) => {
            recorder.record(at(*time), || Entry::Phase(name.clone(), String::new()));
            log(*time, Class::Info, "mp", &format!("phase: {name}"));
        }
        Notice::Note(time, text) => log(*time, Class::Info, "mp", text),
        Notice::Warning(time, text) => log(*time, Class::Warning, "mp", text),
        Notice::Error(time, error) => {
            let (class, actor) = class(error);
            log(*time, class, actor, &error.to_string());
        }
        Notice::Elsewhere(time, class, who, text) => log(*time, *class, who, text),
        // The run writes its end itself, as the phase "end".
        Notice::Over(_) => {}
    }
}

/// Returns a notice as a message to the operator at another node: class, actor, text; `None` for
/// the end of a run.
pub(super) fn message(notice: &Notice) -> Option<(Class, String, String)> {
    let (class, who, text) = match notice {
        Notice::Phase(_, name) => (Class::Info, "mp", format!("phase: {name}")),
        Notice::Note(_, text) => (Class::Info, "mp", text.clone()),
        Notice::Warning(_, text) => (Class::Warning, "mp", text.clone()),
        Notice::Error(_, error) => {
            let (class, actor) = class(error);
            (class, actor, error.to_string())
        }
        Notice::Elsewhere(_, class, who, text) => (*class, who.as_str(), text.clone()),
        Notice::Over(_) => return None,
    };
    Some((class, who.to_owned(), text))
}

/// Returns the class of an error and its actor.
pub(crate) fn class(error: &Error) -> (Class, &str) {
    match error {
        Error::NonFatal { actor, .. } => (Class::NonFatal, actor),
        Error::Fatal { actor, .. } => (Class::Fatal, actor),
        Error::System { actor, .. } => (Class::System, actor),
    }
}
