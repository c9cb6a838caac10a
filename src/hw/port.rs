//! The hardware port: what the servo needs of a bridge to real controllers or of the simulated plant.

use crate::servo::io::{ArmDrive, ArmReading};

/// The bridge to the arms' hardware; one exchange a servo period.
///
/// When the servo is gone or silent the bridge's thread sends [`ArmDrive::OFF`] for all arms, with the next
/// period's number: brakes hold then.
pub trait Port: Send {
    /// Sends the drives of period `period` and fetches the readings at its end, in the order of effectors.
    ///
    /// # Errors
    /// [`PortFault`] when the hardware does not answer.
    fn exchange(
        &mut self,
        period: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault>;

    /// Whether the drives of each period count. Real motors take the newest only: those that were left waiting while the
    /// bridge's thread was kept from running are old.
    fn each_counts(&self) -> bool {
        true
    }

    /// Called once a period from an exchange that failed until the run ends: a controller that could not be switched off
    /// then may hear of it later.
    fn insist(&mut self) {}

    /// By how much the last exchange held up whoever called it, beyond its time; asked by the virtual driver only, to
    /// which nothing else can happen.
    fn held_up(&mut self) -> HeldUp {
        HeldUp::default()
    }
}

/// What came between an exchange and the next period.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct HeldUp {
    /// Grid points that passed meanwhile; the world went on in them under the last drives.
    pub periods: u64,
    /// By how much the clock jumped ahead (s); the world knows nothing of it.
    pub jump: f64,
}

/// The hardware did not answer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("effector {effector}: {reason}")]
pub struct PortFault {
    /// Index of the effector.
    pub effector: usize,
    /// What happened.
    pub reason: String,
}
