//! The clock of a run: maps servo periods to the runtime's time and back.
//!
//! Period `p` begins at `origin + p * 2 ms`, plus the time of all periods that the servo has
//! missed, since the servo numbers its periods without gaps. On hardware the servo first waits for
//! controllers that boot late, so [`Clock::begins`] moves period 0 to the beginning of the servo. A
//! clock ahead of the servo would make every picture seem fresher than it is.

use crate::hw::driver::Switches;
use crate::motion::PERIOD;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::time::Instant;

/// The clock of a run, which counts servo periods of 2 ms. All clones show the same time.
#[derive(Debug, Clone)]
pub struct Clock {
    origin: Instant,
    /// Time from the origin to the beginning of the servo (ns).
    late: Arc<AtomicU64>,
    /// Flags of the servo, which count the periods that it has missed.
    switches: Arc<Switches>,
}

impl Clock {
    /// Returns a clock whose period 0 begins at `origin`. `switches` are the flags in which the
    /// servo counts the periods that it has missed.
    #[must_use]
    pub fn new(origin: Instant, switches: Arc<Switches>) -> Self {
        Self { origin, late: Arc::default(), switches }
    }

    /// Sets the beginning of period 0 to now, in all clones of this clock.
    pub fn begins(&self) {
        let late = u64::try_from(self.origin.elapsed().as_nanos()).unwrap_or(u64::MAX);
        self.late.store(late, Ordering::Release);
    }

    /// Returns the time at which the servo period `period` begins or began. Periods that the servo
    /// misses have no number, so each of them delays this time by one period.
    #[must_use]
    pub fn instant(&self, period: u64) -> Instant {
        // `Duration` multiplies by `u32`: 2^32 periods are 99 days.
        let periods = u32::try_from(period).unwrap_or(u32::MAX);
        self.origin + self.behind() + Duration::from_secs_f64(PERIOD).saturating_mul(periods)
    }

    /// Returns the number of the present servo period; 0 before the first one.
    #[must_use]
    pub fn period(&self) -> u64 {
        // In whole microseconds: a quotient of floating-point seconds may fall short of a period.
        let served = self.origin.elapsed().saturating_sub(self.behind());
        (served.as_micros() / Duration::from_secs_f64(PERIOD).as_micros()) as u64
    }

    /// Sleeps until the servo period `period` begins; returns at once if it has begun.
    pub async fn until(&self, period: u64) {
        // The servo may miss more periods during the sleep, which moves the beginning.
        while Instant::now() < self.instant(period) {
            tokio::time::sleep_until(self.instant(period)).await;
        }
    }

    /// Orders all servos to stop their arms and keep them at rest if `holds` is `true`; revokes
    /// that order if it is `false`.
    pub(crate) fn hold(&self, holds: bool) {
        self.switches.hold.store(holds, Ordering::Release);
    }

    /// Returns how much later than `origin + period * 2 ms` a period begins: the late start of the
    /// servo plus the time of all periods that it has missed.
    fn behind(&self) -> Duration {
        let late = self.late.load(Ordering::Acquire);
        Duration::from_nanos(late.saturating_add(self.switches.punctual.missed_nanos()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn clock_counts_periods_from_a_late_servo_start() {
        let clock = Clock::new(Instant::now(), Arc::default());
        let another = clock.clone();
        tokio::time::sleep(Duration::from_millis(300)).await;
        clock.begins();
        assert_eq!(another.period(), 0);
        another.until(10).await;
        assert_eq!((clock.period(), clock.origin.elapsed()), (10, Duration::from_millis(320)));
    }

    #[tokio::test(start_paused = true)]
    async fn missed_periods_are_subtracted_from_clock_period() {
        let switches = Arc::new(Switches::default());
        let clock = Clock::new(Instant::now(), Arc::clone(&switches));
        clock.until(100).await;
        assert_eq!(clock.period(), 100);

        // The servo misses 40 periods of 2 ms (in ns).
        switches.punctual.miss(40, 2_000_000);

        assert_eq!(clock.period(), 60);
        let begun = Instant::now();
        clock.until(110).await;
        assert_eq!(clock.period(), 110);
        assert_eq!(begun.elapsed(), Duration::from_millis(100));
    }
}
