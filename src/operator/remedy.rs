//! Instructions for a person at an arm that has stopped.

use crate::motion::ArmFault;

/// Returns the instruction for a fault: the person follows it before the next run. A fault stays
/// until the arm is reset, which the start of a run does.
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
        // The three faults of a synchronisation have the same two suspects.
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
