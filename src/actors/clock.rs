//! Servo periods and the runtime's time: period `p` begins at `origin + p * 2 ms`, and later by what the servo missed:
//! it numbers its periods without gaps. On hardware the origin is when its thread began: controllers that boot late are waited
//! for before, and a clock ahead of the servo would make every picture seem fresher than it is.

use crate::hw::driver::Switches;
use crate::motion::PERIOD;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::time::Instant;

/// The clock of a run.
#[derive(Debug, Clone)]
pub struct Clock {
    origin: Instant,
    /// By so much later the servo began (ns).
    late: Arc<AtomicU64>,
    switches: Arc<Switches>,
}

impl Clock {
    /// Period 0 begins at `origin`; the servo tells by its switches what it missed.
    #[must_use]
    pub fn new(origin: Instant, switches: Arc<Switches>) -> Self {
        Self { origin, late: Arc::default(), switches }
    }

    /// Period 0 begins now, for everybody who has this clock.
    pub fn begins(&self) {
        let late = u64::try_from(self.origin.elapsed().as_nanos()).unwrap_or(u64::MAX);
        self.late.store(late, Ordering::Release);
    }

    /// When a period begins, as far as is known now.
    #[must_use]
    pub fn instant(&self, period: u64) -> Instant {
        let periods = u32::try_from(period).unwrap_or(u32::MAX);
        self.origin + self.behind() + Duration::from_secs_f64(PERIOD).saturating_mul(periods)
    }

    /// The period that it is now.
    #[must_use]
    pub fn period(&self) -> u64 {
        let served = self.origin.elapsed().saturating_sub(self.behind());
        (served.as_micros() / Duration::from_secs_f64(PERIOD).as_micros()) as u64
    }

    /// Sleeps until a period begins.
    pub async fn until(&self, period: u64) {
        // More may be missed meanwhile.
        while Instant::now() < self.instant(period) {
            tokio::time::sleep_until(self.instant(period)).await;
        }
    }

    /// Tells all servos to bring their arms to a stand and to hold, or that they need not any more.
    pub(crate) fn hold(&self, holds: bool) {
        self.switches.hold.store(holds, Ordering::Release);
    }

    /// By how much later than from the origin the periods lie.
    fn behind(&self) -> Duration {
        let late = self.late.load(Ordering::Acquire);
        Duration::from_nanos(late.saturating_add(self.switches.punctual.missed_nanos()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_servo_that_begins_late_begins_with_its_first_period() {
        let clock = Clock::new(Instant::now(), Arc::default());
        let another = clock.clone();
        tokio::time::sleep(Duration::from_millis(300)).await;
        clock.begins();
        assert_eq!(another.period(), 0);
        another.until(10).await;
        assert_eq!((clock.period(), clock.origin.elapsed()), (10, Duration::from_millis(320)));
    }

    #[tokio::test(start_paused = true)]
    async fn what_the_servo_missed_is_no_period() {
        let switches = Arc::new(Switches::default());
        let clock = Clock::new(Instant::now(), Arc::clone(&switches));
        clock.until(100).await;
        assert_eq!(clock.period(), 100);

        switches.punctual.miss(40, 2_000_000);

        assert_eq!(clock.period(), 60);
        let begun = Instant::now();
        clock.until(110).await;
        assert_eq!(clock.period(), 110);
        assert_eq!(begun.elapsed(), Duration::from_millis(100));
    }
}
