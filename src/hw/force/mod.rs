//! Drivers of the force sensors in the wrists, which the bridge reads once a period.
//!
//! - [`NetFt`]: an ATI Net F/T box, which streams datagrams (RDT)
//! - [`FtController`]: the stand-alone controller of the original's sensors, on a serial line, and
//!   [`Pci1751`], the parallel interface that can carry its readings
//! - [`Intake`]: the common part. The last reading holds for a while, a reading that leaves the
//!   range is dropped, and a sensor that stays silent reads as NaN, upon which the servo leaves
//!   force control
//!
//! Bias, the mean of two samples and the tool's weight belong to the servo: see
//! [`crate::servo::wrench`].

mod controller;
mod intake;
mod net_ft;
mod parallel;

pub use controller::{FtController, RECORD as FT_RECORD, Words, decode_record, encode_record};
pub use intake::{Intake, Taken};
pub use net_ft::{NetFt, RDT_RECORD, RDT_REQUEST, RdtRecord, Sequence, request, start_request};
pub use parallel::Pci1751;

use super::note::Notes;
use crate::spatial::Wrench;

/// A force/torque sensor in a wrist.
pub trait ForceSource: Send {
    /// Takes the readings since the last period, without waiting for one.
    ///
    /// Returns the wrench that the surroundings and the tool's weight exert on the sensor, in its
    /// frame; its components are NaN if the sensor is silent. Returns also whether the wrench is
    /// new, because a held one must not count twice in a mean.
    fn read(&mut self, period: u64, effector: usize, notes: &mut Notes) -> (Wrench, bool);
}

/// Source of a wrist without a sensor, which is always silent.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoSensor;

impl ForceSource for NoSensor {
    fn read(&mut self, _: u64, _: usize, _: &mut Notes) -> (Wrench, bool) {
        (Wrench::from_directions([f64::NAN; 6]), true)
    }
}
