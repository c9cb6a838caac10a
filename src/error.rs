//! The paper's three classes of errors (Zieliński et al. 2007, p. 370).
//!
//! - non-fatal: a failed computation, or wrong arguments of a command or reply
//! - fatal: malfunction of an effector
//! - system: trouble with messages, or an actor that could not be created
//!
//! A failed step of the task (the cube slipped, a face could not be read) is an outcome, not an
//! error. Every error carries its class as its type, the actor that detected it and the place.

use crate::motion::{ArmFault, ArmState, MoveRefused};
use std::any::Any;

/// An error that crosses a mailbox.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// A failure after which the actor that asked may continue.
    #[error("non-fatal, {actor}, {place}: {cause}")]
    NonFatal {
        /// Name of the actor whose shell detected it.
        actor: String,
        /// Activity of that actor.
        place: &'static str,
        /// Cause.
        cause: NonFatal,
    },
    /// A malfunction of an effector, which must not move.
    #[error("fatal, {actor}, {place}{when}: {cause}", when = when(last.as_deref()))]
    Fatal {
        /// Name of the actor whose shell detected it.
        actor: String,
        /// Activity of that actor.
        place: &'static str,
        /// Cause.
        cause: Fatal,
        /// Last state of the effector that its servo published, if the error is about one.
        last: Option<Box<ArmState>>,
    },
    /// Damage of the system of actors.
    #[error("system, {actor}, {place}: {cause}")]
    System {
        /// Name of the actor whose shell detected it.
        actor: String,
        /// Activity of that actor.
        place: &'static str,
        /// Cause.
        cause: System,
    },
}

impl Error {
    /// Returns the severity of its class: 0 non-fatal, 1 fatal, 2 system.
    #[must_use]
    pub fn gravity(&self) -> u8 {
        match self {
            Self::NonFatal { .. } => 0,
            Self::Fatal { .. } => 1,
            Self::System { .. } => 2,
        }
    }
}

/// Returns the servo period of an arm's last state, for the text of an error; empty without a
/// state.
fn when(last: Option<&ArmState>) -> String {
    last.map_or_else(String::new, |state| format!(", period {}", state.period))
}

/// Returns the text of a panic, as `catch_unwind` and the join of a thread return it.
#[must_use]
pub fn panic_text(why: &(dyn Any + Send)) -> String {
    // `panic!` carries a `&str` without arguments and a `String` with some.
    why.downcast_ref::<&str>()
        .map(|s| (*s).to_owned())
        .or_else(|| why.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "no reason given".to_owned())
}

/// Causes that leave the system usable.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NonFatal {
    /// A refusal of a command by the servo.
    #[error(transparent)]
    Refused(#[from] MoveRefused),
    /// A terminate by the operator before the arms were ready.
    #[error("the run was terminated before the arms were ready")]
    Terminated,
    /// A signal to the process before the arms were ready.
    #[error("the run was interrupted before the arms were ready")]
    Interrupted,
    /// The loss of an arm's synchronisation in a mission that is resumed: its jaws may hold the
    /// cube.
    #[error(
        "{effector} is not synchronised, and its jaws may hold the cube: nothing moves. Take the \
         cube out, synchronise the arm by hand (run this scenario with --set task=idle and a UI), \
         then resume, or start a new run"
    )]
    Lost {
        /// Name of the effector.
        effector: String,
    },
    /// A sensor without a reading, with the reason.
    #[error("no reading: {0}")]
    NoReading(String),
    /// A new zero of a force sensor that is far from the one before. The readings since then may
    /// have been wrong by the difference.
    #[error(
        "force sensor of {effector}: zero has moved by {by:.1} {unit}",
        unit = along(*direction)
    )]
    ZeroMoved {
        /// Name of the effector.
        effector: String,
        /// Difference of the two zeros in that direction (N, Nm).
        by: f64,
        /// Direction: 0..=2 along x, y, z of the tool, 3..=5 about them.
        direction: usize,
    },
    /// Invalid arguments of a command.
    #[error("{0}")]
    Arguments(String),
}

/// Returns unit and axis of a component of a wrench (0 to 2 forces, 3 to 5 torques), for the text
/// of an error.
fn along(direction: usize) -> &'static str {
    // The remainder keeps any index within the table: the text of an error must not panic.
    ["N along x", "N along y", "N along z", "Nm about x", "Nm about y", "Nm about z"][direction % 6]
}

/// Causes that stop an effector.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Fatal {
    /// A fault that the arm's servo reports.
    #[error(transparent)]
    Arm(#[from] ArmFault),
    /// A loss of the effector by its bridge.
    #[error("bridge: {0}")]
    Bridge(String),
    /// A defect of the task's kernel: it waits for an event that it has not asked for.
    #[error("kernel: {0}")]
    Kernel(String),
    /// An arm too near an obstacle, or too fast near the operator's hand.
    #[error("{0}: all arms are stopped")]
    TooNear(String),
}

/// Causes that break the system of actors.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum System {
    /// A mailbox whose actor is gone.
    #[error("the mailbox of {0} is closed")]
    Closed(String),
    /// An answer that did not come in time.
    #[error("no answer from {who} in {seconds:.1} s")]
    Silent {
        /// Name of the actor or thread that should have answered.
        who: String,
        /// Time of the wait (s).
        seconds: f64,
    },
    /// A panic of an actor.
    #[error("{who} panicked: {why}")]
    Panicked {
        /// Name of the actor.
        who: String,
        /// Text of the panic.
        why: String,
    },
    /// An actor that could not be created.
    #[error("{who} could not be created: {why}")]
    NotCreated {
        /// Name of the actor.
        who: String,
        /// Reason.
        why: String,
    },
}
