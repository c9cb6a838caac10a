//! The device of a user's own sensor, and the faults that a simulated run injects into it.
//!
//! - in: measurements of a device or of its model; the flags of its faults
//! - out: the measurements that the faulty device delivers
//!
//! | fault | measurement |
//! |---|---|
//! | silent | none, with the reason |
//! | frozen | the last one before the fault, again and again |
//! | late | the newest one that is older than the delay, or none before the first of them |
//!
//! A device gives its measurements no time. So a VSP takes a late or a frozen one for a new one, as
//! it would on hardware. Its kernel must detect that, if it can be detected.

use crate::motion::PERIOD;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Device of a sensor.
pub trait Device<M>: Send {
    /// Measures once. `period` is the present one of 2 ms. The call may take as long as the device
    /// needs, at most a second.
    ///
    /// # Errors
    /// The reason why there is no measurement.
    fn measure(&mut self, period: u64) -> Result<M, String>;
}

/// Device of a sensor that needs the states of the arms alone.
#[derive(Debug, Clone, Copy)]
pub struct NoDevice;

impl Device<()> for NoDevice {
    fn measure(&mut self, _: u64) -> Result<(), String> {
        Ok(())
    }
}

/// Fault of a device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DeviceFault {
    /// The device delivers no measurement.
    Silent,
    /// The device repeats its last measurement.
    Frozen,
    /// Measurements come late by this time (s).
    Late(f64),
}

/// Flags of the faults of a device.
#[derive(Debug, Default)]
pub struct DeviceFaults {
    silent: AtomicBool,
    frozen: AtomicBool,
    /// Delay of the measurements (periods of 2 ms).
    late: AtomicU64,
}

impl DeviceFaults {
    /// Sets whether the device has a fault.
    pub fn set(&self, fault: DeviceFault, present: bool) {
        match fault {
            DeviceFault::Silent => self.silent.store(present, Ordering::Release),
            DeviceFault::Frozen => self.frozen.store(present, Ordering::Release),
            DeviceFault::Late(by) => {
                let periods = if present { (by / PERIOD).round() as u64 } else { 0 };
                self.late.store(periods, Ordering::Release);
            }
        }
    }
}

/// Device with injected faults.
pub(super) struct FaultyDevice<M> {
    device: Box<dyn Device<M>>,
    faults: Arc<DeviceFaults>,
    /// Last measurement that was delivered.
    last: Option<M>,
    /// Delayed measurements with their periods, the oldest first. The first one may have arrived.
    under_way: VecDeque<(u64, M)>,
}

impl<M> FaultyDevice<M> {
    /// Makes the device that has the faults of these flags.
    pub(super) fn new(device: Box<dyn Device<M>>, faults: Arc<DeviceFaults>) -> Self {
        Self { device, faults, last: None, under_way: VecDeque::new() }
    }
}

impl<M: Clone + Send> Device<M> for FaultyDevice<M> {
    fn measure(&mut self, period: u64) -> Result<M, String> {
        if self.faults.silent.load(Ordering::Acquire) {
            return Err("no measurement comes".to_owned());
        }
        if let Some(last) =
            self.last.as_ref().filter(|_| self.faults.frozen.load(Ordering::Acquire))
        {
            return Ok(last.clone());
        }
        let mut measured = self.device.measure(period)?;
        let late = self.faults.late.load(Ordering::Acquire);
        if late == 0 {
            self.under_way.clear();
        } else {
            self.under_way.push_back((period, measured));
            // The newest measurement whose delay has passed is delivered until the next one comes.
            while self.under_way.get(1).is_some_and(|(next, _)| next + late <= period) {
                self.under_way.pop_front();
            }
            let first = self.under_way.front().filter(|(taken, _)| taken + late <= period);
            measured = first.ok_or("its measurement has not arrived yet")?.1.clone();
        }
        self.last = Some(measured.clone());
        Ok(measured)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Device that measures the number of the period.
    struct Counts;

    impl Device<u64> for Counts {
        fn measure(&mut self, period: u64) -> Result<u64, String> {
            Ok(period)
        }
    }

    #[test]
    fn faulty_device_is_silent_frozen_or_late() {
        let faults = Arc::new(DeviceFaults::default());
        let mut device = FaultyDevice::new(Box::new(Counts), Arc::clone(&faults));
        let mut measured = |fault: Option<DeviceFault>, periods: [u64; 3]| {
            if let Some(fault) = fault {
                faults.set(fault, true);
            }
            let found = periods.map(|period| device.measure(period).ok());
            if let Some(fault) = fault {
                faults.set(fault, false);
            }
            found
        };

        assert_eq!(measured(None, [1, 2, 3]), [Some(1), Some(2), Some(3)]);
        assert_eq!(measured(Some(DeviceFault::Silent), [4, 5, 6]), [None; 3]);
        assert_eq!(measured(None, [7, 8, 9]), [Some(7), Some(8), Some(9)]);
        assert_eq!(measured(Some(DeviceFault::Frozen), [10, 11, 12]), [Some(9); 3]);
        // A delay of 5 periods.
        let late = Some(DeviceFault::Late(0.01));
        assert_eq!(measured(late, [20, 25, 32]), [None, Some(20), Some(25)]);
        assert_eq!(measured(None, [33, 34, 35]), [Some(33), Some(34), Some(35)]);
    }
}
