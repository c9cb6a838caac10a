//! Readings of all arms for each period, from readings that come late.
//!
//! A late reading is extrapolated by the mean step of each counter, and marked. Watchdogs do not
//! judge a reading that is marked `extrapolated`. If a bridge is late steadily, or if no reading
//! could be judged for 0.1 s, the late readings are judged: otherwise the watchdogs would never
//! detect a fault behind this bridge.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | lost bridge | `LOST` | a busy processor delays an ordinary user's threads for over 10 ms |
//! | extrapolation | `GOES_ON` | a stop of one period would make the regulator brake fully |
//! | steadily late bridge | `CLOSE` for `GOES_ON` | further extrapolation is off by too much |
//! | readings after missed periods | `UNSURE` | these may show the steps of the missed periods |
//!
//! - in: the number of the period; the latest readings with the number of their period; missed
//!   periods
//! - out: the readings of all arms for this period

use crate::motion::AXES;
use crate::servo::io::ArmReading;

/// Largest number of effectors behind a bridge: all data that cross it have a fixed size.
pub const MOST_ARMS: usize = 4;

/// Readings of all arms of one period.
#[derive(Debug, Clone, Copy, Default)]
pub struct Readings {
    /// The period at the end of which they were read.
    pub period: u64,
    /// One reading per arm; arms that do not exist have the default.
    pub arms: [ArmReading; MOST_ARMS],
}

/// Memory of the latest readings and of the mean step of each counter.
#[derive(Debug, Clone, Copy)]
pub struct Extrapolator {
    /// The latest readings.
    seen: Readings,
    /// Mean step of each counter in a period, the jaw's last (increments).
    steps: [[i64; AXES + 1]; MOST_ARMS],
    /// Length of a period (ns).
    length: u64,
    /// Number of periods in a row without a new reading.
    silent: u64,
    /// Number of new readings in a row that were late by at most [`Extrapolator::CLOSE`].
    steadily_late: u64,
    /// Periods since readings were last judged.
    unjudged: u64,
    /// Number of the next readings that may span missed periods, and the most missed periods that
    /// one of them can span.
    unsure: u32,
    missed: u64,
}

impl Extrapolator {
    /// Time without a new reading after which the bridge counts as lost (ns). The 10 ms of the
    /// original would trip wherever an ordinary user's threads wait for a busy processor.
    const LOST: u64 = 100_000_000;
    /// Number of periods for which a counter continues by its mean step while readings are late. A
    /// counter that stops for a period and then makes a double step would make the regulator brake
    /// fully in between, which trips a power stage at speed.
    const GOES_ON: u64 = 10;
    /// Largest lateness of the readings of a bridge that counts as steadily late (periods). A
    /// longer extrapolation is off by more than the watchdogs allow for.
    const CLOSE: u64 = 3;
    /// Approximate number of steps in their mean. A single step may be too short or too long,
    /// because a reading was early or late.
    const STEPS: i64 = 3;
    /// Number of new readings after missed periods that may show the steps of these periods: one
    /// that was not fetched yet, one of an exchange that had begun, and the one after it.
    const UNSURE: u32 = 3;

    /// Makes an extrapolator that begins with the readings `first`, which were taken before the
    /// servo's first period. A period lasts `length` (ns).
    #[must_use]
    pub fn new(first: Readings, length: u64) -> Self {
        Self {
            seen: first,
            steps: [[0; AXES + 1]; MOST_ARMS],
            length,
            silent: 0,
            steadily_late: 0,
            unjudged: 0,
            unsure: 0,
            missed: 0,
        }
    }

    /// Registers that the servo missed a number of periods just before the next one. Missed periods
    /// have no numbers, so the numbers of the readings do not show them.
    pub fn add_missed_periods(&mut self, missed: u64) {
        self.unjudged += missed;
        self.missed = self.missed.max(missed);
        self.unsure = Self::UNSURE;
        // The first readings may be off, so the bridge must show again that it is steadily late. A
        // few readings are enough for that, or repeated stalls would blind the watchdogs.
        self.steadily_late = self.steadily_late.min(Self::GOES_ON - u64::from(Self::UNSURE));
    }

    /// Writes the readings that the servo is to use in `period` to `readings`: the `latest` ones of
    /// the bridge, extrapolated to this period if they are late.
    pub fn read(&mut self, period: u64, latest: &Readings, readings: &mut [ArmReading]) {
        let new = latest.period > self.seen.period;
        if new {
            self.learn(*latest);
        }
        // A bridge that is always a period behind is late, but not silent.
        let fresh = latest.period + 1 == period;
        self.silent = if new || fresh { 0 } else { self.silent + 1 };
        let late_by = period.saturating_sub(self.seen.period + 1);
        let judged = self.is_judged(late_by, new);
        // After ten periods without a reading the extrapolated counters stop.
        let behind = late_by.min(Self::GOES_ON) as i64;
        let arms = self.seen.arms.iter().zip(&self.steps);
        for (reading, (seen, steps)) in readings.iter_mut().zip(arms) {
            *reading = *seen;
            for (count, step) in reading.counts.iter_mut().zip(steps) {
                *count += behind * step;
            }
            reading.jaw_count += behind * steps[AXES];
            if !judged {
                reading.extrapolated = u8::MAX;
            }
            // A bridge that is always a period behind answers in each period although its readings
            // are extrapolated, so `late_by > 0` is not the condition.
            if !new {
                reading.no_answer = u8::MAX;
                // Each wrench counts once in a mean or a zero.
                reading.wrench_is_old = true;
            }
        }
    }

    /// Returns the number of periods in a row without a new reading.
    #[must_use]
    pub fn silent(&self) -> u64 {
        self.silent
    }

    /// Returns whether the bridge is lost: no new reading has come for 0.1 s.
    #[must_use]
    pub fn is_lost(&self) -> bool {
        self.silent * self.length > Self::LOST
    }

    /// Returns whether the watchdogs judge the readings of this period. The readings are late by
    /// `late_by` periods, and `new` says whether they came in this period.
    ///
    /// The watchdogs judge readings that come in time. They judge late ones only if the bridge is
    /// late in every period, or if they have judged none for 0.1 s. They never judge an estimate
    /// for a period in which no reading came.
    fn is_judged(&mut self, late_by: u64, new: bool) -> bool {
        let late = late_by > 0;
        self.steadily_late =
            if late && late_by <= Self::CLOSE { self.steadily_late + u64::from(new) } else { 0 };
        self.unjudged += 1;
        let waits = self.unjudged * self.length <= Self::LOST;
        // Without a new reading there is no evidence to judge, only the estimate.
        let judged = !late || new && (self.steadily_late > Self::GOES_ON || !waits);
        if judged {
            self.unjudged = 0;
        }
        judged
    }

    /// Stores new readings and updates the mean step of each counter.
    fn learn(&mut self, mut latest: Readings) {
        // A reading has the number of the period in which its exchange began. After a silence it
        // may have been taken later, so its step may span all silent periods.
        let numbers = latest.period - self.seen.period;
        let periods = numbers.max(self.silent + 1) as i64;
        if self.unsure == 0 {
            self.missed = 0;
        }
        self.unsure = self.unsure.saturating_sub(1);
        let most = periods + self.missed as i64;
        let pairs = latest.arms.iter_mut().zip(&self.seen.arms);
        for (steps, (now, before)) in self.steps.iter_mut().zip(pairs) {
            // The bridge marks a wrench as old in the exchange after it came. If that exchange is
            // the one fetched, the wrench is still new here.
            if now.wrench_on_sensor.is_finite() && now.wrench_on_sensor != before.wrench_on_sensor {
                now.wrench_is_old = false;
            }
            let zeroed = now.synchronised & !before.synchronised;
            for (i, mean) in steps.iter_mut().enumerate() {
                if zeroed & (1 << i) != 0 {
                    // The counter was set to zero, and the axis has not moved.
                    *mean = 0;
                    continue;
                }
                let gone = counter(now, i) - counter(before, i);
                *mean += Self::change(*mean, gone, (periods, most));
            }
        }
        self.seen = latest;
    }

    /// Returns by how much the `mean` step of a counter changes when a reading shows that the
    /// counter moved by `gone`. This took at least `periods.0` and at most `periods.1` periods.
    ///
    /// The two numbers differ if the time may contain missed periods. Then a distance that agrees
    /// with the present mean changes nothing.
    fn change(mean: i64, gone: i64, periods: (i64, i64)) -> i64 {
        let (fast, slow) = (gone / periods.0, gone / periods.1);
        let change = mean.clamp(fast.min(slow), fast.max(slow)) - mean;
        // The mean changes by one at least: that of a counter at rest must not stay at one or two.
        if change / Self::STEPS == 0 { change.signum() } else { change / Self::STEPS }
    }
}

/// Returns the counter of an axis; the jaw is the axis after the last one of the arm.
fn counter(reading: &ArmReading, axis: usize) -> i64 {
    reading.counts.get(axis).copied().unwrap_or(reading.jaw_count)
}
