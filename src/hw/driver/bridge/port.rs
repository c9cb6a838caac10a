//! The servo's side of the bridge: it never waits.
//!
//! - in: the drives of a period
//! - out: the readings for a period, late ones carried on and marked: see
//!   [`crate::servo::lateness`]

use super::drives::Drives;
use crate::servo::io::{ArmDrive, ArmReading};
use crate::servo::lateness::{Extrapolator, MOST_ARMS, Readings};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::Thread;

/// The servo's side of the bridge.
#[derive(Debug)]
pub struct BridgePort {
    drives: rtrb::Producer<Drives>,
    readings: triple_buffer::Output<Readings>,
    /// The port has failed.
    broken: Arc<AtomicBool>,
    bridge: Thread,
    extrapolator: Extrapolator,
    /// Periods in which no new reading was there.
    late: u64,
}

/// The bridge does not answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("no reading from the bridge for {periods} periods")]
pub struct BridgeLost {
    /// How long.
    pub periods: u64,
}

impl BridgePort {
    /// Makes the servo's side of both channels; `first` are the readings of the period before the
    /// first one, a period lasts `length` (ns).
    pub(super) fn new(
        drives: rtrb::Producer<Drives>,
        readings: triple_buffer::Output<Readings>,
        (broken, bridge): (Arc<AtomicBool>, Thread),
        first: Readings,
        length: u64,
    ) -> Self {
        let extrapolator = Extrapolator::new(first, length);
        Self { drives, readings, broken, bridge, extrapolator, late: 0 }
    }

    /// Notes that periods were missed before the next one.
    pub fn skipped(&mut self, missed: u64) {
        self.extrapolator.skipped(missed);
    }

    /// Copies the readings for `period`, at its beginning: those of the period before, or late ones
    /// carried on by the counters' mean steps.
    ///
    /// # Errors
    /// The bridge has failed or been silent for 0.1 s.
    pub fn fetch(&mut self, period: u64, readings: &mut [ArmReading]) -> Result<(), BridgeLost> {
        let latest = self.readings.read();
        debug_assert!(latest.period < period, "readings of a period that is still to come");
        self.extrapolator.read(period, latest, readings);
        self.late += u64::from(latest.period + 1 != period);
        if self.broken.load(Ordering::Acquire) || self.extrapolator.is_lost() {
            return Err(BridgeLost { periods: self.extrapolator.silent() });
        }
        Ok(())
    }

    /// Hands over the drives of `period`; drives for which the ring has no room are left out.
    pub fn send(&mut self, period: u64, drives: &[ArmDrive]) {
        let mut all = Drives { period, drives: [ArmDrive::OFF; MOST_ARMS] };
        all.drives[..drives.len()].copy_from_slice(drives);
        let _ = self.drives.push(all);
        self.bridge.unpark();
    }

    /// Returns the number of periods in which no new reading was there.
    #[must_use]
    pub fn late(&self) -> u64 {
        self.late
    }
}
