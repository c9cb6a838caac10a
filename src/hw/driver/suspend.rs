//! Detection of a suspend of the computer.
//!
//! The grid of the servo's periods is on the monotonic clock, which stands still while the computer
//! is suspended: no grid point passes, so no period counts as missed, but the arms' controllers
//! keep running. The clock of the time since boot counts the suspend as well.
//!
//! - in: the times of both clocks, once a period
//! - out: the time for which the computer was suspended

use super::realtime::Clock;

/// The clocks of the wall driver; a test injects its own.
pub trait Time {
    /// Returns the monotonic time (ns).
    fn now(&self) -> u64;

    /// Returns the time since boot, which includes suspends (ns).
    fn boot_time(&self) -> u64;

    /// Sleeps until `spin` (ns) before the monotonic clock shows `nanos` (ns), then spins.
    fn wait_until(&self, nanos: u64, spin: u64);
}

impl Time for Clock {
    fn now(&self) -> u64 {
        Clock::now(*self)
    }

    fn boot_time(&self) -> u64 {
        Clock::boot_time(*self)
    }

    fn wait_until(&self, nanos: u64, spin: u64) {
        Clock::wait_until(*self, nanos, spin);
    }
}

/// Least gain of the time since boot on the monotonic time that counts as a suspend (ns). A suspend
/// takes far longer. Adjustments of the clocks cause no gain, because they affect both clocks.
const LEAST: u64 = 1_000_000;

/// Detector of suspends.
#[derive(Debug, Default)]
pub(super) struct Suspends {
    /// Upper bound, from earlier readings, of the lead of the time since boot over the monotonic
    /// time (ns); `None` before the first reading.
    lead: Option<u64>,
}

impl Suspends {
    /// Reads the clocks; returns the time for which the computer was suspended since the last call
    /// (ns), 0 if it was not.
    pub(super) fn asleep(&mut self, clocks: &impl Time) -> u64 {
        // The thread may be paused between two readings of the clocks. Monotonic readings before
        // and after the other one bound the lead, so that a pause is never taken for a suspend.
        let before = clocks.now();
        let boot = clocks.boot_time();
        let after = clocks.now();
        let (least, most) = (boot.saturating_sub(after), boot.saturating_sub(before));
        let lead = *self.lead.get_or_insert(most);
        let asleep = least.saturating_sub(lead);
        if asleep < LEAST {
            self.lead = Some(lead.min(most));
            return 0;
        }
        self.lead = Some(most);
        asleep
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;

    /// Clocks that show given times in turn: monotonic, boot, monotonic.
    struct Script(RefCell<std::array::IntoIter<u64, 3>>);

    impl Script {
        fn of(times: [u64; 3]) -> Self {
            Self(RefCell::new(times.into_iter()))
        }
    }

    impl Time for Script {
        fn now(&self) -> u64 {
            self.0.borrow_mut().next().unwrap()
        }

        fn boot_time(&self) -> u64 {
            self.now()
        }

        fn wait_until(&self, _: u64, _: u64) {}
    }

    #[test]
    fn suspend_is_measured_once() {
        let (mut suspends, second) = (Suspends::default(), 1_000_000_000);
        let mut at = |times| suspends.asleep(&Script::of(times));

        assert_eq!(at([0, 7 * second, 100]), 0, "an older suspend");
        assert_eq!(at([second, 8 * second, second + 100]), 0);
        assert_eq!(at([2 * second, 3609 * second, 2 * second + 100]), 3600 * second - 100);
        assert_eq!(at([3 * second, 3610 * second, 3 * second + 100]), 0, "counted before");
    }

    /// A pause of the thread between two readings makes the clocks look apart.
    #[test]
    fn pause_between_clock_readings_is_no_suspend() {
        let (mut suspends, ms) = (Suspends::default(), 1_000_000);
        let mut at = |times| suspends.asleep(&Script::of(times));

        // Paused for 300 ms before and after the reading of the time since boot.
        assert_eq!(at([0, 300 * ms, 600 * ms]), 0);
        assert_eq!(at([1000 * ms, 1000 * ms, 1000 * ms]), 0);
        assert_eq!(at([2000 * ms, 2300 * ms, 2300 * ms]), 0);
        assert_eq!(at([3000 * ms, 3000 * ms, 3300 * ms]), 0);
        // A short suspend is still found.
        assert_eq!(at([4000 * ms, 4500 * ms, 4000 * ms]), 500 * ms);
    }
}
