//! The paper's three classes of errors (Zieliński et al. 2007, p. 370).
//!
//! - non-fatal: a failed computation, or wrong arguments of a command or reply
//! - fatal: malfunction of an effector
//! - system: trouble with messages, or an actor that could not be created
//!
//! A failed step of the task (the cube slipped, a face could not be read) is an outcome, not an
//! error. Every error carries its class as its variant, the actor that detected it and the place.

use crate::motion::{ArmFault, ArmState, MoveRefused};
use serde::{Deserialize, Serialize};
use std::any::Any;
use std::borrow::Cow;
use std::fmt;

/// An error as one actor reports it to another.
///
/// ```
/// use rubik_robot::error::{Error, Fatal, FaultCode};
/// use rubik_robot::motion::ArmFault;
///
/// let error = Error::Fatal {
///     actor: "edp track".to_owned(),
///     place: "execute".into(),
///     cause: Fatal::Arm(ArmFault::OverCurrent { axis: 6, amperes: 9.0 }),
///     last: None,
/// };
/// assert_eq!(error.to_string(), "axis 6: over-current, 9.0 A (fatal, edp track, execute)");
/// assert_eq!((error.gravity(), error.code()), (1, FaultCode::OverCurrent));
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Error {
    /// A failure after which the actor that asked may continue.
    NonFatal {
        /// Name of the actor whose shell detected it.
        actor: String,
        /// Activity of that actor.
        place: Cow<'static, str>,
        /// Cause.
        cause: NonFatal,
    },
    /// A malfunction of an effector, which must not move.
    Fatal {
        /// Name of the actor whose shell detected it.
        actor: String,
        /// Activity of that actor.
        place: Cow<'static, str>,
        /// Cause.
        cause: Fatal,
        /// Last state of the effector that its servo published, if the error is about one.
        last: Option<Box<ArmState>>,
    },
    /// Damage of the system of actors.
    System {
        /// Name of the actor whose shell detected it.
        actor: String,
        /// Activity of that actor.
        place: Cow<'static, str>,
        /// Cause.
        cause: System,
    },
}

impl Error {
    /// Returns the severity of the error's class: 0 non-fatal, 1 fatal, 2 system.
    #[must_use]
    pub fn gravity(&self) -> u8 {
        match self {
            Self::NonFatal { .. } => 0,
            Self::Fatal { .. } => 1,
            Self::System { .. } => 2,
        }
    }

    /// Returns the cause in words for the operator, without the parts of the program.
    #[must_use]
    pub fn cause(&self) -> String {
        match self {
            Self::NonFatal { cause, .. } => cause.to_string(),
            Self::Fatal { cause, .. } => cause.to_string(),
            Self::System { cause, .. } => cause.to_string(),
        }
    }

    /// Returns class, actor and place of the error, with the servo period if the error is about an
    /// effector: `fatal, edp track, execute, period 701`.
    #[must_use]
    pub fn detected_by(&self) -> String {
        match self {
            Self::NonFatal { actor, place, .. } => format!("non-fatal, {actor}, {place}"),
            Self::Fatal { actor, place, last, .. } => {
                let when = last.as_ref().map(|state| format!(", period {}", state.period));
                format!("fatal, {actor}, {place}{}", when.unwrap_or_default())
            }
            Self::System { actor, place, .. } => format!("system, {actor}, {place}"),
        }
    }

    /// Returns the code of the error's cause.
    #[must_use]
    pub fn code(&self) -> FaultCode {
        match self {
            Self::NonFatal { cause, .. } => cause.code(),
            Self::Fatal { cause, .. } => cause.code(),
            Self::System { cause, .. } => cause.code(),
        }
    }
}

impl std::error::Error for Error {}

impl fmt::Display for Error {
    /// Writes the cause, then in parentheses where it was detected.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({})", self.cause(), self.detected_by())
    }
}

/// Causes of errors, for programs. The names, in kebab case, never change; the texts of the errors
/// may. `docs/faults.md` lists them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FaultCode {
    /// The servo refused a command.
    CommandRefused,
    /// The operator terminated the run before the arms were ready.
    Terminated,
    /// A signal ended the run before the arms were ready.
    Interrupted,
    /// An arm of a resumed mission is not synchronised.
    ResumedArmNotSynchronised,
    /// A sensor has no reading.
    NoReading,
    /// The zero of a force sensor has moved.
    ForceZeroMoved,
    /// The arguments of a command are invalid.
    InvalidArguments,
    /// A motor takes too much current.
    OverCurrent,
    /// An axis reached its limit switch.
    LimitSwitch,
    /// Set value and reading of an axis are too far apart.
    FollowingError,
    /// A force sensor is silent or saturated.
    ForceSensor,
    /// A power stage reports a fault.
    PowerStage,
    /// Homing did not find the synchronisation switch.
    HomingSwitchMissing,
    /// Homing did not leave the synchronisation switch.
    HomingSwitchHeld,
    /// Homing found no encoder zero.
    HomingZeroMissing,
    /// An axis controller lost its synchronisation.
    SynchronisationLost,
    /// The actors sent no heartbeat.
    HeartbeatLost,
    /// The servo missed periods.
    MissedPeriods,
    /// The bridge gave no reading.
    BridgeSilent,
    /// The emergency stop was pressed.
    EmergencyStop,
    /// An encoder does not move with its axis.
    EncoderFrozen,
    /// An encoder jumped.
    EncoderJump,
    /// The bridge lost an effector.
    BridgeFault,
    /// The task's kernel is defective.
    KernelFault,
    /// An arm is too near an obstacle, or too fast near the operator's hand.
    TooNear,
    /// The mailbox of an actor is closed.
    MailboxClosed,
    /// An actor or a thread does not answer.
    NoAnswer,
    /// An actor panicked.
    Panic,
    /// An actor or a thread could not be created.
    NotCreated,
    /// The link to another node has failed.
    LinkFailed,
}

impl fmt::Display for FaultCode {
    /// Writes the name in kebab case.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // A fieldless variant serialises as its name alone.
        self.serialize(f)
    }
}

/// Returns the code of a fault of an arm.
fn arm_code(fault: &ArmFault) -> FaultCode {
    match fault {
        ArmFault::OverCurrent { .. } => FaultCode::OverCurrent,
        ArmFault::LimitSwitch { .. } => FaultCode::LimitSwitch,
        ArmFault::Following { .. } => FaultCode::FollowingError,
        ArmFault::ForceSensor { .. } => FaultCode::ForceSensor,
        ArmFault::PowerStage { .. } => FaultCode::PowerStage,
        ArmFault::SwitchExpected { .. } => FaultCode::HomingSwitchMissing,
        ArmFault::SwitchHeld { .. } => FaultCode::HomingSwitchHeld,
        ArmFault::ZeroExpected { .. } => FaultCode::HomingZeroMissing,
        ArmFault::SynchronisationLost { .. } => FaultCode::SynchronisationLost,
        ArmFault::Heartbeat { .. } => FaultCode::HeartbeatLost,
        ArmFault::Missed { .. } => FaultCode::MissedPeriods,
        ArmFault::BridgeSilent { .. } => FaultCode::BridgeSilent,
        ArmFault::EmergencyStop => FaultCode::EmergencyStop,
        ArmFault::EncoderFrozen { .. } => FaultCode::EncoderFrozen,
        ArmFault::EncoderJump { .. } => FaultCode::EncoderJump,
    }
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, thiserror::Error)]
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
        /// Difference of the two zeros in `direction` (N or Nm).
        by: f64,
        /// Direction: 0..=2 along x, y, z of the tool, 3..=5 about them.
        direction: usize,
    },
    /// Invalid arguments of a command.
    #[error("{0}")]
    Arguments(String),
}

impl NonFatal {
    /// Returns the code of the cause.
    fn code(&self) -> FaultCode {
        match self {
            Self::Refused(_) => FaultCode::CommandRefused,
            Self::Terminated => FaultCode::Terminated,
            Self::Interrupted => FaultCode::Interrupted,
            Self::Lost { .. } => FaultCode::ResumedArmNotSynchronised,
            Self::NoReading(_) => FaultCode::NoReading,
            Self::ZeroMoved { .. } => FaultCode::ForceZeroMoved,
            Self::Arguments(_) => FaultCode::InvalidArguments,
        }
    }
}

/// Returns unit and axis of a component of a wrench, such as `N along x`, for the text of an error.
/// The components 0 to 2 are forces, 3 to 5 torques.
fn along(direction: usize) -> &'static str {
    // The remainder keeps any index within the table: the text of an error must not panic.
    ["N along x", "N along y", "N along z", "Nm about x", "Nm about y", "Nm about z"][direction % 6]
}

/// Causes that stop an effector.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, thiserror::Error)]
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

impl Fatal {
    /// Returns the code of the cause.
    fn code(&self) -> FaultCode {
        match self {
            Self::Arm(fault) => arm_code(fault),
            Self::Bridge(_) => FaultCode::BridgeFault,
            Self::Kernel(_) => FaultCode::KernelFault,
            Self::TooNear(_) => FaultCode::TooNear,
        }
    }
}

/// Causes that break the system of actors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, thiserror::Error)]
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
    /// A link to another node that has failed.
    #[error("the link to {who} has failed: {why}")]
    Link {
        /// Name of the node.
        who: String,
        /// Reason.
        why: String,
    },
}

impl System {
    /// Returns the code of the cause.
    fn code(&self) -> FaultCode {
        match self {
            Self::Closed(_) => FaultCode::MailboxClosed,
            Self::Silent { .. } => FaultCode::NoAnswer,
            Self::Panicked { .. } => FaultCode::Panic,
            Self::NotCreated { .. } => FaultCode::NotCreated,
            Self::Link { .. } => FaultCode::LinkFailed,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All codes in their order.
    const ALL: [FaultCode; 30] = [
        FaultCode::CommandRefused,
        FaultCode::Terminated,
        FaultCode::Interrupted,
        FaultCode::ResumedArmNotSynchronised,
        FaultCode::NoReading,
        FaultCode::ForceZeroMoved,
        FaultCode::InvalidArguments,
        FaultCode::OverCurrent,
        FaultCode::LimitSwitch,
        FaultCode::FollowingError,
        FaultCode::ForceSensor,
        FaultCode::PowerStage,
        FaultCode::HomingSwitchMissing,
        FaultCode::HomingSwitchHeld,
        FaultCode::HomingZeroMissing,
        FaultCode::SynchronisationLost,
        FaultCode::HeartbeatLost,
        FaultCode::MissedPeriods,
        FaultCode::BridgeSilent,
        FaultCode::EmergencyStop,
        FaultCode::EncoderFrozen,
        FaultCode::EncoderJump,
        FaultCode::BridgeFault,
        FaultCode::KernelFault,
        FaultCode::TooNear,
        FaultCode::MailboxClosed,
        FaultCode::NoAnswer,
        FaultCode::Panic,
        FaultCode::NotCreated,
        FaultCode::LinkFailed,
    ];

    #[test]
    fn codes_are_the_names_that_docs_list() {
        let docs = include_str!("../docs/faults.md");
        let codes = ALL.map(|code| code.to_string());

        assert!(ALL.iter().enumerate().all(|(number, code)| *code as usize == number));
        assert_eq!(ALL.len(), FaultCode::LinkFailed as usize + 1, "the last code");
        for (code, variant) in codes.iter().zip(ALL) {
            assert!(docs.contains(&format!("| `{code}` |")), "docs/faults.md lacks {code}");
            assert_eq!(serde_json::to_value(variant).unwrap(), *code.as_str());
            assert_eq!(codes.iter().filter(|other| *other == code).count(), 1);
        }
    }

    #[test]
    fn code_names_the_cause_of_the_error() {
        let error = Error::Fatal {
            actor: "edp track".into(),
            place: "servo".into(),
            cause: ArmFault::EncoderJump { axis: 3, by: 3.0 }.into(),
            last: None,
        };

        assert_eq!(error.code(), FaultCode::EncoderJump);
        assert_eq!(error.code().to_string(), "encoder-jump");
    }
}
