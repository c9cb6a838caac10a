//! The servo's side of the bridge, which never waits.
//!
//! - in: the drive commands of a period
//! - out: the readings for a period; missing ones are extrapolated and marked, see
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
    /// Set when the port has failed.
    broken: Arc<AtomicBool>,
    /// The bridge thread, for its wake-up.
    bridge: Thread,
    extrapolator: Extrapolator,
    /// Number of periods in which no new reading was there.
    late: u64,
}

/// Error of a bridge that does not answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("no reading from the bridge for {periods} periods")]
pub struct BridgeLost {
    /// Length of its silence (periods).
    pub periods: u64,
}

impl BridgePort {
    /// Makes the servo's side of the two channels, `drives` to the bridge and `readings` from it.
    /// The flag `broken` is set when the port has failed; `bridge` is the thread to wake. `first`
    /// are the readings of period 0, `length` is that of a period (ns).
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

    /// Records that `missed` periods passed before the next one without a call of the servo.
    pub fn add_missed_periods(&mut self, missed: u64) {
        self.extrapolator.add_missed_periods(missed);
    }

    /// Fills `readings` with the bridge's readings of the period before `period`. If they have not
    /// arrived, it takes the latest ones and extrapolates their counters by the mean steps.
    ///
    /// # Errors
    /// [`BridgeLost`] when the port has failed or the bridge has been silent for 0.1 s.
    pub fn fetch(&mut self, period: u64, readings: &mut [ArmReading]) -> Result<(), BridgeLost> {
        let latest = self.readings.read();
        debug_assert!(latest.period < period, "readings of a future period");
        // Readings are written even if the bridge is lost: the servo computes its last period, in
        // which it trips the arms, from them.
        self.extrapolator.read(period, latest, readings);
        self.late += u64::from(latest.period + 1 != period);
        if self.broken.load(Ordering::Acquire) || self.extrapolator.is_lost() {
            return Err(BridgeLost { periods: self.extrapolator.silent() });
        }
        Ok(())
    }

    /// Hands the drive commands of `period` to the bridge. They are dropped if the ring has no
    /// room.
    pub fn send(&mut self, period: u64, drives: &[ArmDrive]) {
        let mut all = Drives { period, drives: [ArmDrive::OFF; MOST_ARMS] };
        all.drives[..drives.len()].copy_from_slice(drives);
        // A bridge that leaves the drives of 64 periods in the ring delivers no readings either,
        // so `fetch` reports it.
        let _ = self.drives.push(all);
        self.bridge.unpark();
    }

    /// Returns the number of periods in which no new reading was there.
    #[must_use]
    pub fn late(&self) -> u64 {
        self.late
    }
}
