//! What a person does about an arm that has stopped.

use crate::motion::ArmFault;

/// What is to be done before the next run. A fault stays until the arm is reset, which the start of a run does.
#[must_use]
pub fn remedy(fault: &ArmFault) -> &'static str {
    match fault {
        ArmFault::OverCurrent { .. } => {
            "Something blocks the axis, or its load is too heavy: clear its way, then start a new run."
        }
        ArmFault::LimitSwitch { .. } => {
            "Move the axis off its switch by its motor (run scenarios/idle.toml), then start a new run."
        }
        ArmFault::Following { .. } => {
            "Something holds the arm back: look at its way, its brakes and its power, then start a new run."
        }
        ArmFault::ForceSensor { .. } => {
            "Look at the wrist's force sensor, its cable and its supply, then start a new run."
        }
        ArmFault::PowerStage { .. } => {
            "Look at the power stage and its supply, clear its fault there, then start a new run."
        }
        ArmFault::SwitchExpected { .. }
        | ArmFault::SwitchHeld { .. }
        | ArmFault::ZeroExpected { .. } => {
            "Look at the axis's synchronisation switch and its encoder; if it stands at its lower limit, move its motor \
             upwards by hand; then synchronise once more."
        }
        ArmFault::SynchronisationLost { .. } => {
            "The counters mean nothing any more: start a new run, which synchronises the arm first."
        }
        ArmFault::HeartBeat { .. } => {
            "An actor hung: the console has what came before. Start a new run."
        }
        ArmFault::Missed { .. } => {
            "This machine does not keep time: `rubik-robot doctor` says what helps. Then start a new run."
        }
        ArmFault::BridgeSilent { .. } => {
            "Look at the bridge, its line and its supply, then start a new run."
        }
        ArmFault::EmergencyStop => {
            "See that nobody and nothing is in danger and why it was pressed, then start a new run."
        }
        ArmFault::EncoderFrozen { .. } | ArmFault::EncoderJump { .. } => {
            "Look at the axis's encoder and its cable, and synchronise the arm before the next run."
        }
    }
}
