//! Statistics of the punctuality of the servo thread.

/// A histogram of times (ns) with 32 classes for each doubling, so a class is 3 % wide.
///
/// It reaches up to 2.1 s; the last class holds all longer times. Recording takes constant time and
/// does not allocate, so the real-time thread keeps the histogram itself.
#[derive(Debug, Clone)]
pub struct Histogram {
    counts: Vec<u64>,
    total: u64,
    max: u64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { counts: vec![0; Self::CLASSES], total: 0, max: 0 }
    }
}

impl Histogram {
    /// Number of classes for each doubling of the time.
    const FINE: u64 = 32;
    /// Number of all classes: up to 2^31 ns, which is 2.1 s.
    const CLASSES: usize = 27 * Self::FINE as usize;

    /// Adds one duration to the histogram (ns).
    pub fn record(&mut self, nanos: u64) {
        let class = Self::class(nanos).min(Self::CLASSES - 1);
        self.counts[class] += 1;
        self.total += 1;
        self.max = self.max.max(nanos);
    }

    /// Returns how many durations were recorded.
    #[must_use]
    pub fn len(&self) -> u64 {
        self.total
    }

    /// Returns whether no duration was recorded.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.total == 0
    }

    /// Returns the classes (bins) of the histogram that are not empty: the largest duration of each
    /// (ns), and how many durations lie in it.
    pub fn classes(&self) -> impl Iterator<Item = (u64, u64)> {
        let classes = self.counts.iter().enumerate().filter(|(_, count)| **count > 0);
        classes.map(|(class, count)| (Self::upper(class).min(self.max), *count))
    }

    /// Returns the longest duration that was recorded (ns).
    #[must_use]
    pub fn max(&self) -> u64 {
        self.max
    }

    /// Returns the duration that a share `q` of all recorded durations does not exceed (ns), at
    /// most 3 % too large; 0 if the histogram is empty.
    #[must_use]
    pub fn quantile(&self, q: f64) -> u64 {
        let rank = ((q * self.total as f64).ceil() as u64).clamp(1, self.total.max(1));
        let mut seen = 0;
        for (class, count) in self.counts.iter().enumerate() {
            seen += count;
            if seen >= rank {
                return Self::upper(class).min(self.max);
            }
        }
        0
    }

    /// Returns the index of the class of a duration (ns), also beyond the last class.
    fn class(nanos: u64) -> usize {
        // Below 64 ns a class is 1 ns wide, as fine as the numbers are.
        if nanos < 2 * Self::FINE {
            return nanos as usize;
        }
        // The shift leaves the six leading bits, 32..=63: the upper one selects the doubling, the
        // other five the class in it.
        let shift = nanos.ilog2() - Self::FINE.ilog2();
        (u64::from(shift) * Self::FINE + (nanos >> shift)) as usize
    }

    /// Returns the largest duration that belongs to the class with this index (ns).
    fn upper(class: usize) -> u64 {
        let class = class as u64;
        if class < 2 * Self::FINE {
            return class;
        }
        let shift = class / Self::FINE - 1;
        ((class % Self::FINE + Self::FINE + 1) << shift) - 1
    }
}

/// Measurements of a wall driver about itself.
#[derive(Debug, Clone, Default)]
pub struct Timing {
    /// Delay from the grid point to the beginning of its period (ns).
    pub wake_up: Histogram,
    /// Time between the beginnings of two successive periods, as its distance from the length of a
    /// period (ns). Pairs with missed periods between them are left out.
    pub jitter: Histogram,
    /// Duration of the work of a period (ns).
    pub work: Histogram,
    /// Number of grid points that passed without a period.
    pub missed: u64,
    /// Largest number of missed grid points in a row.
    pub missed_in_a_row: u64,
    /// Number of periods in which the bridge had no new reading.
    pub late_readings: u64,
}

impl Timing {
    /// Adds `points` grid points that passed in a row without a servo period.
    pub fn miss(&mut self, points: u64) {
        self.missed += points;
        self.missed_in_a_row = self.missed_in_a_row.max(points);
    }
}

impl std::fmt::Display for Timing {
    /// Writes one line for each histogram, with its quantiles in us, and one line with the counts.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let line = |f: &mut std::fmt::Formatter<'_>, name: &str, h: &Histogram| {
            let us = |nanos: u64| nanos as f64 / 1000.0;
            writeln!(
                f,
                "{name}: p50 {:.1} us, p99 {:.1} us, p99.9 {:.1} us, max {:.1} us, {} periods",
                us(h.quantile(0.5)),
                us(h.quantile(0.99)),
                us(h.quantile(0.999)),
                us(h.max()),
                h.len()
            )
        };
        line(f, "wake-up", &self.wake_up)?;
        line(f, "jitter", &self.jitter)?;
        line(f, "work", &self.work)?;
        write!(
            f,
            "missed: {} periods, {} in a row; late readings: {}",
            self.missed, self.missed_in_a_row, self.late_readings
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_right_to_three_percent() {
        let mut histogram = Histogram::default();

        for nanos in 1..=100_000 {
            histogram.record(nanos);
        }

        // A class is 1/32 of its duration wide.
        for (q, wanted) in [(0.1, 10_000.0), (0.5, 50_000.0), (0.99, 99_000.0), (1.0, 100_000.0)] {
            let found = histogram.quantile(q) as f64;
            assert!(found >= wanted && found < 1.032 * wanted, "{q}: {found}");
        }
        assert_eq!(histogram.max(), 100_000);
    }

    #[test]
    fn every_duration_lies_within_its_class() {
        for nanos in
            (0..200).chain((1..30).map(|e| (1u64 << e) - 1)).chain((1..30).map(|e| 1u64 << e))
        {
            let class = Histogram::class(nanos);

            assert!(nanos <= Histogram::upper(class), "{nanos}");
            assert!(class == 0 || nanos > Histogram::upper(class - 1), "{nanos}");
        }
    }

    #[test]
    fn huge_duration_counts_in_last_class() {
        let mut histogram = Histogram::default();

        histogram.record(u64::MAX / 2);

        assert_eq!(histogram.len(), 1);
        assert_eq!(histogram.max(), u64::MAX / 2);
        assert!(histogram.quantile(0.5) > 1_000_000_000);
    }
}
