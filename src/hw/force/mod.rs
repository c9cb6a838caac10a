//! Force sensors in the wrists, as the bridge reads them once a period.
//!
//! - [`NetFt`]: an ATI Net F/T box, which streams datagrams (RDT)
//! - [`FtController`]: the stand-alone controller of the original's sensors, on a serial line, and [`Pci1751`], the
//!   parallel interface by which it can tell its readings
//! - [`Intake`]: what all have in common: the last reading holds for a while, one that leaves the range is dropped, and
//!   a sensor that stays silent reads as no number, upon which the servo leaves force control
//!
//! Bias, the mean of two and the tool's weight belong to the servo: [`crate::servo::wrench`].

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

/// A wrist sensor.
pub trait ForceSource: Send {
    /// Takes what has come since the last period, and never waits. What the surroundings and the tool's weight exert
    /// on the sensor, in its frame; components are NaN when it is silent. And whether it is new: what is held counts once
    /// in a mean.
    fn read(&mut self, period: u64, effector: usize, notes: &mut Notes) -> (Wrench, bool);
}

/// There is no sensor: always silent.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoSensor;

impl ForceSource for NoSensor {
    fn read(&mut self, _: u64, _: usize, _: &mut Notes) -> (Wrench, bool) {
        (Wrench::from_directions([f64::NAN; 6]), true)
    }
}
