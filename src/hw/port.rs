//! The hardware port: the trait by which the servo reaches the arms, whether they are real ones or
//! simulated.

use crate::servo::io::{ArmDrive, ArmReading};

/// The bridge to the arms' hardware, with one exchange in each servo period.
///
/// If the servo is gone or silent, the bridge thread sends [`ArmDrive::OFF`] for all arms with the
/// number of the next period. The brakes then hold the arms.
pub trait Port: Send {
    /// Sends the drive commands of period `period` and fetches the readings at its end, in the
    /// order of effectors.
    ///
    /// # Errors
    /// [`PortFault`] if the hardware does not answer.
    fn exchange(
        &mut self,
        period: u64,
        drives: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault>;

    /// Returns whether the drive commands of each period must be exchanged. The simulated plant
    /// needs all of them. Real motors need the newest only: drives that waited while the bridge
    /// thread could not run are old.
    fn needs_each_period(&self) -> bool {
        true
    }

    /// Sends the stop again after an exchange has failed. The bridge thread calls this in each
    /// period until the run ends, so that a controller that missed the stop may receive it later.
    fn repeat_stop(&mut self) {}

    /// Returns the delay that the last exchange caused beyond its period. Only the virtual driver
    /// calls this: in virtual time nothing but a port causes a delay.
    fn delay(&mut self) -> Delay {
        Delay::default()
    }
}

/// Delay between an exchange and the next period.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Delay {
    /// Number of servo periods that were skipped. The world moved on in them under the last drive
    /// commands.
    pub periods: u64,
    /// Time by which the clock jumped ahead (s). The world did not move in it.
    pub jump: f64,
}

/// Error of hardware that does not answer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("effector {effector}: {reason}")]
pub struct PortFault {
    /// Index of the effector.
    pub effector: usize,
    /// Description of the fault.
    pub reason: String,
}
