//! The time in which a motor can have made the step between two readings of its counter.
//!
//! After a gap it is not known at which end of the gap the first reading was taken: a device, or
//! the answer of a line, may have stopped together with this machine. This reading shows next to no
//! step, and the one after it shows the whole step of the gap.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | pause between readings | `GAP` | in shorter pauses single answers were missed |
//! | readings after a gap | `DOUBTFUL_READINGS` | each of them may be as old as the gap is long |
//!
//! - in: periods that pass, including missed ones; readings, when they come
//! - out: the longest time for the next step; the time by which the last reading may be older than
//!   it seems

/// Number of readings after a gap that may still be as old as the gap.
const DOUBTFUL_READINGS: u32 = 4;
/// Smallest excess of a gap over the one period between two usual readings (periods). In shorter
/// pauses single answers were missed: this machine kept running, so the step is a true one.
const GAP: f64 = 2.5;

/// Time between two readings of one counter (periods).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Interval {
    /// Time since the last reading came.
    since: f64,
    /// Time by which the last reading may have been taken before it came.
    older: f64,
    /// Number of the next readings that may still be as old as the last gap.
    doubtful: u32,
}

impl Interval {
    /// Adds periods that have passed since the last reading of the counter.
    pub fn pass(&mut self, periods: f64) {
        debug_assert!(periods.is_finite() && periods >= 0.0, "not a time: {periods} periods");
        self.since += periods;
    }

    /// Returns the time since the last reading of the counter, assuming that this reading was taken
    /// when it came (periods).
    #[must_use]
    pub fn since(&self) -> f64 {
        self.since
    }

    /// Returns the time by which the last reading of the counter may have been taken earlier than
    /// it came, because of a gap (periods).
    #[must_use]
    pub fn older(&self) -> f64 {
        self.older
    }

    /// Returns the longest time that may lie between the last reading of the counter and one of
    /// now, at least one period. The motor can have moved for this time (periods).
    #[must_use]
    pub fn longest(&self) -> f64 {
        self.since.max(1.0) + self.older
    }

    /// Registers a reading of the counter. `shows_gap` says whether the reading contains the motion
    /// during the last gap: if so, later readings are as new as they seem.
    pub fn read(&mut self, shows_gap: bool) {
        let gap = self.since - 1.0;
        if shows_gap {
            // The step has appeared, so no later reading can show it again.
            (self.older, self.doubtful) = (0.0, 0);
        } else if gap > GAP {
            // A shorter gap must not replace a longer one whose step has not appeared yet.
            (self.older, self.doubtful) = (self.older.max(gap), DOUBTFUL_READINGS);
        } else {
            self.doubtful = self.doubtful.saturating_sub(1);
            if self.doubtful == 0 {
                self.older = 0.0;
            }
        }
        self.since = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn consecutive_readings_are_one_period_apart() {
        let mut interval = Interval::default();
        for _ in 0..3 {
            interval.pass(1.0);
            assert_eq!((interval.since(), interval.longest(), interval.older()), (1.0, 1.0, 0.0));
            interval.read(false);
        }
    }

    /// The motion during a gap may show in any of the next four readings.
    #[test]
    fn longest_interval_remains_for_four_readings_after_gap() {
        let mut interval = Interval::default();
        interval.pass(8.0);
        assert_eq!(interval.longest(), 8.0);
        interval.read(false);

        let times: Vec<_> = (0..6)
            .map(|_| {
                interval.pass(1.0);
                let longest = interval.longest();
                interval.read(false);
                longest
            })
            .collect();

        assert_eq!(times, [8.0, 8.0, 8.0, 8.0, 1.0, 1.0]);
    }

    #[test]
    fn reading_that_shows_gap_motion_resets_longest_interval() {
        let mut interval = Interval::default();
        interval.pass(8.0);
        interval.read(true);
        interval.pass(1.0);

        assert_eq!((interval.longest(), interval.older()), (1.0, 0.0));
    }

    #[test]
    fn shorter_gap_does_not_replace_longer_gap() {
        let mut interval = Interval::default();
        interval.pass(8.0);
        interval.read(false);
        interval.pass(5.0);
        interval.read(false);

        assert_eq!(interval.older(), 7.0);
    }
}
