//! Length of the servo's own periods, and conversions to the controller's grid of 2 ms.
//!
//! All actors count in the 2 ms periods of the original ([`PERIOD`]); a servo may run faster or
//! slower. The numbers that cross between them are converted here and nowhere else. At 2 ms every
//! conversion is the identity.
//!
//! - in: period numbers of one side
//! - out: period numbers of the other side

use crate::motion::PERIOD;

/// Nanoseconds of [`PERIOD`].
const TICK: u64 = 2_000_000;

/// Length of a servo period.
///
/// ```
/// use rubik_robot::servo::period::Length;
///
/// // A servo of 1 kHz: a macrostep of 8 periods of 2 ms has 16 of its own.
/// let fast = Length::of_seconds(0.001);
/// assert_eq!((fast.count(8), fast.first_after(100), fast.tick(201)), (16, 200, 100));
/// // The usual period is 2 ms, at which every conversion is the identity.
/// assert_eq!(Length::default().seconds(), 0.002);
/// assert_eq!(Length::default().first_after(100), 100);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Length {
    nanos: u64,
}

impl Default for Length {
    fn default() -> Self {
        Self { nanos: TICK }
    }
}

impl Length {
    /// Makes a length from `seconds`, bounded to 0.5 to 20 ms.
    #[must_use]
    pub fn of_seconds(seconds: f64) -> Self {
        Self { nanos: ((seconds * 1e9).round() as u64).clamp(500_000, 20_000_000) }
    }

    /// Returns the length of the servo period (s).
    #[must_use]
    pub fn seconds(self) -> f64 {
        // At 2 ms the literal counts, so that the default results do not depend on rounding.
        if self.nanos == TICK { PERIOD } else { self.nanos as f64 * 1e-9 }
    }

    /// Returns the length of the servo period (ns).
    #[must_use]
    pub fn nanos(self) -> u64 {
        self.nanos
    }

    /// Returns the length of the servo period as a multiple of 2 ms.
    #[must_use]
    pub fn ratio(self) -> f64 {
        self.nanos as f64 / TICK as f64
    }

    /// Returns the number of servo periods that last as long as `ticks` periods of 2 ms, rounded,
    /// at least one.
    #[must_use]
    pub fn count(self, ticks: u32) -> u32 {
        let nanos = u64::from(ticks) * TICK;
        u32::try_from((nanos + self.nanos / 2) / self.nanos).unwrap_or(u32::MAX).max(1)
    }

    /// Returns the first servo period that does not begin before the 2 ms period `tick`.
    #[must_use]
    pub fn first_after(self, tick: u64) -> u64 {
        tick.saturating_mul(TICK).div_ceil(self.nanos)
    }

    /// Returns the 2 ms period in which a servo period begins.
    #[must_use]
    pub fn tick(self, period: u64) -> u64 {
        period.saturating_mul(self.nanos) / TICK
    }

    /// Returns the first 2 ms period that does not begin before a servo period.
    #[must_use]
    pub fn tick_after(self, period: u64) -> u64 {
        period.saturating_mul(self.nanos).div_ceil(TICK)
    }

    /// Returns how many servo periods before its end a macrostep is answered, so that the next
    /// macrostep follows without a gap: two, or as many as last two periods of 2 ms.
    #[must_use]
    pub fn early(self) -> u64 {
        (2 * TICK).div_ceil(self.nanos).max(2)
    }

    /// Returns [`Length::early`] in periods of 2 ms.
    #[must_use]
    pub fn early_ticks(self) -> u64 {
        self.tick_after(self.early())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn period_and_tick_numbers_agree_at_two_milliseconds() {
        let length = Length::default();
        assert_eq!(length, Length::of_seconds(0.002));
        for n in [0, 1, 7, 1000] {
            assert_eq!([length.first_after(n), length.tick(n), length.tick_after(n)], [n; 3]);
            assert_eq!(length.count(n as u32).max(1), (n as u32).max(1));
        }
        assert_eq!((length.early(), length.early_ticks()), (2, 2));
        assert_eq!(length.seconds().to_bits(), PERIOD.to_bits());
    }

    #[test]
    fn other_period_lengths_keep_durations_of_commands() {
        let fast = Length::of_seconds(0.0005);
        assert_eq!((fast.count(8), fast.first_after(3), fast.tick(13)), (32, 12, 3));
        assert_eq!((fast.early(), fast.early_ticks()), (8, 2));

        let slow = Length::of_seconds(0.008);
        assert_eq!((slow.count(8), slow.first_after(3), slow.tick(2)), (2, 1, 8));
        assert_eq!((slow.early(), slow.early_ticks()), (2, 8));
        assert_eq!(Length::of_seconds(1.0).nanos(), 20_000_000);
    }
}
