//! Instructions for a person at an arm, or a run, that has stopped.

use crate::error::{Error, Fatal, System};
use crate::motion::ArmFault;

/// Returns the instruction for a person after an error that ended a run; `None` if the text of the
/// error itself says what to do, or if nothing is broken.
#[must_use]
pub fn run_remedy(error: &Error) -> Option<&'static str> {
    match error {
        Error::Fatal { cause, .. } => Some(match cause {
            Fatal::Arm(fault) => remedy(fault),
            Fatal::Bridge(_) => {
                "Check the robot's lines, cards and supply (`rubik-robot doctor SCENARIO` checks \
                 its devices), then start a new run."
            }
            Fatal::TooNear(_) => {
                "Check what is in the path of the arms and whether the cell is as the scenario \
                 describes it, then start a new run."
            }
            Fatal::Kernel(_) => DEFECT,
        }),
        Error::System { cause, .. } => match cause {
            System::Silent { .. } => Some(
                "Check that the machine is not overloaded (`rubik-robot doctor`) and start a new \
                 run; if it happens again, report it with a recording (--record).",
            ),
            System::Link { .. } => Some(
                "Check the network between the nodes and start all of them again; if it happens \
                 again, compare the figures of docs/nodes.md.",
            ),
            System::Panicked { .. } | System::Closed(_) => Some(DEFECT),
            // The text of the error names the part and what is wrong with it.
            System::NotCreated { .. } => None,
        },
        // A command was refused, or the operator ended the run: nothing is broken.
        Error::NonFatal { .. } => None,
    }
}

/// Instruction for a run that a defect ended, of this program or of a user's own task.
const DEFECT: &str = "This is a defect of the task or of the program: start a new run with \
                      --record FILE; if it happens again, report it with the recording.";

/// Returns the instruction for a person after a fault of an arm, to be followed before the next
/// run. A fault lasts until the arm is reset, which happens at the start of a run.
#[must_use]
pub fn remedy(fault: &ArmFault) -> &'static str {
    match fault {
        ArmFault::OverCurrent { .. } => {
            "Something blocks the axis, or its load is too heavy: clear its path, then start a new \
             run."
        }
        ArmFault::LimitSwitch { .. } => {
            "Move the axis off its switch by its motor (run scenarios/idle.toml), then start a new \
             run."
        }
        ArmFault::Following { .. } => {
            "Something holds the arm back: check its path, its brakes and its power, then start a \
             new run."
        }
        ArmFault::ForceSensor { .. } => {
            "Check the wrist's force sensor, its cable and its supply, then start a new run."
        }
        ArmFault::PowerStage { .. } => {
            "Check the power stage and its supply, clear its fault there, then start a new run."
        }
        // All three faults of a synchronisation come from the switch or from the encoder.
        ArmFault::SwitchExpected { .. }
        | ArmFault::SwitchHeld { .. }
        | ArmFault::ZeroExpected { .. } => {
            "Check the axis's synchronisation switch and its encoder; if the axis is at its lower \
             limit, move its motor upwards by hand; then synchronise again."
        }
        ArmFault::SynchronisationLost { .. } => {
            "The counters are no longer valid: start a new run, which synchronises the arm first."
        }
        ArmFault::Heartbeat { .. } => {
            "An actor hung: the console shows the messages before it. Start a new run."
        }
        ArmFault::Missed { .. } => {
            "This machine does not keep time, or it was suspended: `rubik-robot doctor` shows the \
             remedies. Then start a new run."
        }
        ArmFault::BridgeSilent { .. } => {
            "Check the bridge, its line and its supply, then start a new run."
        }
        ArmFault::EmergencyStop => {
            "Check that there is no danger and why the stop was pressed, then start a new run."
        }
        ArmFault::EncoderFrozen { .. } | ArmFault::EncoderJump { .. } => {
            "Check the axis's encoder and its cable, and synchronise the arm before the next run."
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fatal and system errors have an instruction, except if the text of the error has it already.
    #[test]
    fn every_fatal_error_has_a_remedy() {
        let fatal =
            |cause| Error::Fatal { actor: "edp".into(), place: "servo".into(), cause, last: None };
        let system = |cause| Error::System { actor: "mp".into(), place: "execute".into(), cause };

        for cause in [
            Fatal::Arm(ArmFault::EmergencyStop),
            Fatal::Bridge("gone".into()),
            Fatal::Kernel("waits".into()),
            Fatal::TooNear("the table".into()),
        ] {
            assert!(run_remedy(&fatal(cause)).is_some_and(|words| words.contains("new run")));
        }
        let stop = fatal(ArmFault::EmergencyStop.into());
        assert_eq!(run_remedy(&stop), Some(remedy(&ArmFault::EmergencyStop)));
        let silent = System::Silent { who: "mp".into(), seconds: 10.0 };
        let panicked = System::Panicked { who: "mp".into(), why: "a defect".into() };
        for cause in [silent, panicked, System::Closed("mp".into())] {
            assert!(run_remedy(&system(cause)).is_some());
        }
        let told = System::NotCreated { who: "bridge".into(), why: "no file".into() };
        assert_eq!(run_remedy(&system(told)), None);
    }
}
