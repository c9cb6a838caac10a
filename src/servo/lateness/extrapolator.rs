//! Readings of all arms for each period, from readings that come late.
//!
//! - in: the number of the period, and the latest readings with the period of theirs; missed
//!   periods
//! - out: the readings for this period: late ones carried on by the mean step of each counter, and
//!   marked
//! - a reading that is `extrapolated` is not judged by watchdogs until the counter is read again.
//!   If a bridge is late steadily, or nothing could be judged for 0.1 s, its late readings are all
//!   that there is and are judged: otherwise the watchdogs would look away for ever

use crate::motion::AXES;
use crate::servo::io::ArmReading;

/// The most effectors that cross a bridge: all that crosses it has a fixed size.
pub const MOST_ARMS: usize = 4;

/// Readings of all arms of one period.
#[derive(Debug, Clone, Copy, Default)]
pub struct Readings {
    /// The period at the end of which they were read.
    pub period: u64,
    /// One reading an arm; arms that do not exist have the default.
    pub arms: [ArmReading; MOST_ARMS],
}

/// Late readings and the mean steps by which counters are carried on.
#[derive(Debug, Clone, Copy)]
pub struct Extrapolator {
    /// The latest readings.
    seen: Readings,
    /// How far each counter goes in a period, the jaw's last.
    steps: [[i64; AXES + 1]; MOST_ARMS],
    /// Length of a period (ns).
    length: u64,
    /// Number of periods in a row in which nothing new came.
    silent: u64,
    /// Number of new readings in a row that all were late, by a few periods only.
    steadily_late: u64,
    /// Periods since readings were last judged.
    unjudged: u64,
    /// How many of the next readings may span missed periods, and the most missed periods that one
    /// of them can span.
    unsure: u32,
    missed: u64,
}

impl Extrapolator {
    /// Time without a new reading after which the bridge counts as lost (ns). The original's 10 ms
    /// would trip wherever an ordinary user's threads wait for a busy processor.
    const LOST: u64 = 100_000_000;
    /// Periods for which a counter is taken to go on as before while readings are late. An axis
    /// that stands still for a period and then goes twice as far would make its regulator brake
    /// fully in between, which trips a power stage at speed.
    const GOES_ON: u64 = 10;
    /// Periods by which readings may be late if a bridge is to count as steadily late. A counter
    /// that is carried on farther is off by more than watchdogs allow for.
    const CLOSE: u64 = 3;
    /// Number of steps over which their mean is taken, about: a step that was read late and then
    /// early says nothing about the speed.
    const STEPS: i64 = 3;
    /// New readings after missed periods that may show the steps of these periods: one that was not
    /// fetched yet, one of an exchange that had begun, and the one after it.
    const UNSURE: u32 = 3;

    /// Begins with the readings of the period before the first one. A period lasts `length` (ns).
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

    /// Notes that periods were missed before the next one. Missed periods have no numbers, and
    /// readings are numbered by periods.
    pub fn skipped(&mut self, missed: u64) {
        self.unjudged += missed;
        self.missed = self.missed.max(missed);
        self.unsure = Self::UNSURE;
        // The first readings may be off. They are judged again soon, because periods may be missed
        // again and again.
        self.steadily_late = self.steadily_late.min(Self::GOES_ON - u64::from(Self::UNSURE));
    }

    /// Writes the readings that the servo is to use in `period`, from the `latest` ones.
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
            // A bridge that is always a period behind brings news in each period, and its readings
            // are carried on.
            if !new {
                reading.no_answer = u8::MAX;
                // A wrench counts once: no mean and no zero is made of one that was read before.
                reading.wrench_is_old = true;
            }
        }
    }

    /// Returns the number of periods in a row in which nothing new came.
    #[must_use]
    pub fn silent(&self) -> u64 {
        self.silent
    }

    /// Returns whether nothing new has come for 0.1 s.
    #[must_use]
    pub fn is_lost(&self) -> bool {
        self.silent * self.length > Self::LOST
    }

    /// Returns whether watchdogs judge the readings of this period, which are `late_by` so many
    /// periods; `new` ones have come in it.
    ///
    /// After readings that came in time, counters are carried on for a while and judged when they
    /// are read again. Where all readings are late, or have been late for long, they are what there
    /// is to judge.
    fn is_judged(&mut self, late_by: u64, new: bool) -> bool {
        let late = late_by > 0;
        self.steadily_late =
            if late && late_by <= Self::CLOSE { self.steadily_late + u64::from(new) } else { 0 };
        self.unjudged += 1;
        let waits = self.unjudged * self.length <= Self::LOST;
        let judged = !late || new && (self.steadily_late > Self::GOES_ON || !waits);
        if judged {
            self.unjudged = 0;
        }
        judged
    }

    /// Takes new readings, and the speed of each counter from them.
    fn learn(&mut self, mut latest: Readings) {
        // A reading that was not fetched in time may have begun when nothing came.
        let numbers = latest.period - self.seen.period;
        let periods = numbers.max(self.silent + 1) as i64;
        if self.unsure == 0 {
            self.missed = 0;
        }
        self.unsure = self.unsure.saturating_sub(1);
        let most = periods + self.missed as i64;
        let pairs = latest.arms.iter_mut().zip(&self.seen.arms);
        for (steps, (now, before)) in self.steps.iter_mut().zip(pairs) {
            // A wrench that came between two fetches is not lost.
            if now.wrench_on_sensor.is_finite() && now.wrench_on_sensor != before.wrench_on_sensor {
                now.wrench_is_old = false;
            }
            let zeroed = now.synchronised & !before.synchronised;
            for (i, mean) in steps.iter_mut().enumerate() {
                if zeroed & (1 << i) != 0 {
                    // The counter was set, the axis has not moved.
                    *mean = 0;
                    continue;
                }
                let gone = counter(now, i) - counter(before, i);
                *mean += Self::change(*mean, gone, (periods, most));
            }
        }
        self.seen = latest;
    }

    /// Returns by how much the mean of a counter's step changes with a reading that shows that it
    /// has `gone` so far in the least and the most `periods`.
    ///
    /// If missed periods may be among them, a step that agrees with the mean so far changes
    /// nothing.
    fn change(mean: i64, gone: i64, periods: (i64, i64)) -> i64 {
        let (fast, slow) = (gone / periods.0, gone / periods.1);
        let change = mean.clamp(fast.min(slow), fast.max(slow)) - mean;
        // By one at least: a counter that stands must not keep a mean of one or two.
        if change / Self::STEPS == 0 { change.signum() } else { change / Self::STEPS }
    }
}

/// Returns the counter of an axis, the jaw's last.
fn counter(reading: &ArmReading, axis: usize) -> i64 {
    reading.counts.get(axis).copied().unwrap_or(reading.jaw_count)
}
