//! Servo periods and the runtime's time: period `p` begins at `origin + p * 2 ms`.

use crate::motion::PERIOD;
use std::time::Duration;
use tokio::time::Instant;

/// The clock of a run.
#[derive(Debug, Clone, Copy)]
pub struct Clock {
    origin: Instant,
}

impl Clock {
    /// Period 0 begins at `origin`.
    #[must_use]
    pub fn new(origin: Instant) -> Self {
        Self { origin }
    }

    /// When a period begins.
    #[must_use]
    pub fn instant(&self, period: u64) -> Instant {
        self.origin
            + Duration::from_secs_f64(PERIOD)
                .saturating_mul(u32::try_from(period).unwrap_or(u32::MAX))
    }

    /// The period that it is now.
    #[must_use]
    pub fn period(&self) -> u64 {
        (self.origin.elapsed().as_micros() / Duration::from_secs_f64(PERIOD).as_micros()) as u64
    }

    /// Sleeps until a period begins.
    pub async fn until(&self, period: u64) {
        tokio::time::sleep_until(self.instant(period)).await;
    }
}
