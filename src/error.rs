//! The paper's three classes of errors (Zieliński et al. 2007, p. 370).
//!
//! - non-fatal: a failed computation, or wrong arguments of a command or reply
//! - fatal: malfunction of an effector
//! - system: trouble with messages, or an actor that could not be created
//!
//! A failed step of the task (the cube slipped, a face could not be read) is an outcome, not an error.
//! Every error carries its class as its type, the actor that detected it and the place.

use crate::motion::{ArmFault, ArmState, MoveRefused};

/// An error that crosses a mailbox.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// The asker may go on.
    #[error("non-fatal, {actor}, {place}: {cause}")]
    NonFatal {
        /// Name of the actor whose shell detected it.
        actor: String,
        /// What it was doing.
        place: &'static str,
        /// Why.
        cause: NonFatal,
    },
    /// An effector must not move.
    #[error("fatal, {actor}, {place}{when}: {cause}", when = when(last.as_deref()))]
    Fatal {
        /// Name of the actor whose shell detected it.
        actor: String,
        /// What it was doing.
        place: &'static str,
        /// Why.
        cause: Fatal,
        /// What the servo last told of the effector, where there is one.
        last: Option<Box<ArmState>>,
    },
    /// The system of actors is damaged.
    #[error("system, {actor}, {place}: {cause}")]
    System {
        /// Name of the actor whose shell detected it.
        actor: String,
        /// What it was doing.
        place: &'static str,
        /// Why.
        cause: System,
    },
}

impl Error {
    /// How grave its class is: 0 non-fatal, 1 fatal, 2 system.
    #[must_use]
    pub fn gravity(&self) -> u8 {
        match self {
            Self::NonFatal { .. } => 0,
            Self::Fatal { .. } => 1,
            Self::System { .. } => 2,
        }
    }
}

/// When a state was: for the text of an error that carries one.
fn when(last: Option<&ArmState>) -> String {
    last.map_or_else(String::new, |state| format!(", period {}", state.period))
}

/// Causes that leave the system usable.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NonFatal {
    /// A command was not carried out.
    #[error(transparent)]
    Refused(#[from] MoveRefused),
    /// The operator ended it.
    #[error("the run was terminated before the arms were ready")]
    Terminated,
    /// A signal ended it.
    #[error("the run was interrupted before the arms were ready")]
    Interrupted,
    /// An arm of a mission that was broken off does not know any more where it is, and may hold the cube.
    #[error(
        "{effector} does not know where it is, and its jaws may hold the cube: nothing moves. Take the cube out, \
         synchronise the arm by hand (this scenario with --set task=idle and a face), then resume, or start a new run"
    )]
    Lost {
        /// Name of the effector.
        effector: String,
    },
    /// A sensor has nothing to say.
    #[error("no reading: {0}")]
    NoReading(String),
    /// A force sensor's new zero is far from the one before: what it said since then was wrong by so much.
    #[error("force sensor of {effector}: zero has moved by {by:.1} {unit}", unit = along(*direction))]
    ZeroMoved {
        /// Name of the effector.
        effector: String,
        /// By how much (N, Nm).
        by: f64,
        /// Along x, y, z of the tool, or about them.
        direction: usize,
    },
    /// Arguments that make no sense.
    #[error("{0}")]
    Arguments(String),
}

/// Unit and direction of a component of a wrench.
fn along(direction: usize) -> &'static str {
    ["N along x", "N along y", "N along z", "Nm about x", "Nm about y", "Nm about z"][direction % 6]
}

/// Causes that stop an effector.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Fatal {
    /// The effector's own report.
    #[error(transparent)]
    Arm(#[from] ArmFault),
    /// The bridge lost the effector.
    #[error("bridge: {0}")]
    Bridge(String),
    /// The task's kernel waits for something that it never asked for.
    #[error("kernel: {0}")]
    Kernel(String),
    /// An arm came too near to something, or was too fast there.
    #[error("{0}: all arms are stopped")]
    TooNear(String),
}

/// Causes that break the system of actors.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum System {
    /// The far end of a mailbox is gone.
    #[error("the mailbox of {0} is closed")]
    Closed(String),
    /// No answer in time.
    #[error("no answer from {who} in {seconds:.1} s")]
    Silent {
        /// Who should have answered.
        who: String,
        /// How long it was waited for.
        seconds: f64,
    },
    /// An actor panicked.
    #[error("{who} panicked: {why}")]
    Panicked {
        /// Which.
        who: String,
        /// What it said.
        why: String,
    },
    /// An actor could not be created.
    #[error("{who} could not be created: {why}")]
    NotCreated {
        /// Which.
        who: String,
        /// Reason.
        why: String,
    },
}
