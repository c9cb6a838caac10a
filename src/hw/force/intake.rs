//! What is done with a sensor's readings, whatever brings them.
//!
//! - in: the newest reading of a period, or none
//! - out: the wrench that counts in this period
//! - source: the original drops a reading that leaves the range and says so (non-fatal). Here an overload that lasts
//!   is handed on, since the servo must stop for it.

use crate::spatial::Wrench;

/// Periods for which a reading holds when no other comes: the original's 10 ms.
const HOLDS: u32 = 5;
/// Readings beyond the range that are dropped in a row.
const DROPPED: u32 = 2;

/// What became of a reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Taken {
    /// It counts.
    Fresh,
    /// None came; the last one still holds.
    Held,
    /// It left the range and was dropped.
    OverRange {
        /// Direction that left it.
        direction: usize,
        /// What it read (N or Nm).
        reading: f64,
    },
    /// None has come for too long.
    Silent {
        /// It is the first period of silence.
        first: bool,
    },
    /// It is the first after a silence, and counts.
    Back,
}

impl Taken {
    /// Whether a reading counts that did not before.
    #[must_use]
    pub fn is_new(&self) -> bool {
        !matches!(self, Self::Held | Self::OverRange { .. })
    }
}

/// A sensor's recent past.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intake {
    range: [f64; 6],
    last: Wrench,
    age: u32,
    dropped: u32,
}

impl Intake {
    /// `range` as in [`ForceSensor::range`](crate::cell::ForceSensor::range). Silent until the first reading.
    #[must_use]
    pub fn new(range: [f64; 6]) -> Self {
        let silent = Wrench::from_directions([f64::NAN; 6]);
        Self { range, last: silent, age: HOLDS + 2, dropped: 0 }
    }

    /// The wrench of this period.
    pub fn take(&mut self, reading: Option<Wrench>) -> (Wrench, Taken) {
        let Some(wrench) = reading else { return self.none() };
        if let Some((direction, reading)) = self.beyond(&wrench)
            && self.dropped < DROPPED
        {
            self.dropped += 1;
            let (held, taken) = self.none();
            let silent = matches!(taken, Taken::Silent { .. });
            return (held, if silent { taken } else { Taken::OverRange { direction, reading } });
        }
        if self.beyond(&wrench).is_none() {
            self.dropped = 0;
        }
        let was_silent = self.age > HOLDS;
        (self.last, self.age) = (wrench, 0);
        (wrench, if was_silent { Taken::Back } else { Taken::Fresh })
    }

    fn none(&mut self) -> (Wrench, Taken) {
        self.age = self.age.saturating_add(1);
        if self.age <= HOLDS {
            return (self.last, Taken::Held);
        }
        let silent = Wrench::from_directions([f64::NAN; 6]);
        (silent, Taken::Silent { first: self.age == HOLDS + 1 })
    }

    fn beyond(&self, wrench: &Wrench) -> Option<(usize, f64)> {
        let values = wrench.directions();
        // Not within also catches what is not a number.
        (0..6)
            .find(|&i| values[i].is_nan() || values[i].abs() >= self.range[i])
            .map(|i| (i, values[i]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn z(force: f64) -> Wrench {
        Wrench::from_directions([0.0, 0.0, force, 0.0, 0.0, 0.0])
    }

    fn intake() -> Intake {
        Intake::new([65.0, 65.0, 130.0, 5.0, 5.0, 5.0])
    }

    #[test]
    fn a_reading_holds_for_five_periods_and_then_the_sensor_is_silent() {
        let mut intake = intake();
        assert!(matches!(intake.take(None).1, Taken::Silent { first: false }));
        assert_eq!(intake.take(Some(z(3.0))), (z(3.0), Taken::Back));
        assert_eq!(intake.take(Some(z(4.0))), (z(4.0), Taken::Fresh));

        for _ in 0..5 {
            assert_eq!(intake.take(None), (z(4.0), Taken::Held));
        }
        let (wrench, taken) = intake.take(None);
        assert!(!wrench.is_finite());
        assert_eq!(taken, Taken::Silent { first: true });
        assert_eq!(intake.take(None).1, Taken::Silent { first: false });
        assert_eq!(intake.take(Some(z(5.0))), (z(5.0), Taken::Back));
    }

    #[test]
    fn one_overload_is_dropped_and_one_that_lasts_is_handed_on() {
        let mut intake = intake();
        intake.take(Some(z(3.0)));

        let over = Taken::OverRange { direction: 2, reading: -131.0 };
        assert_eq!(intake.take(Some(z(-131.0))), (z(3.0), over));
        assert_eq!(intake.take(Some(z(4.0))), (z(4.0), Taken::Fresh));
        assert_eq!(intake.take(Some(z(-131.0))).1, over);
        assert_eq!(intake.take(Some(z(-131.0))).1, over);
        assert_eq!(intake.take(Some(z(-131.0))), (z(-131.0), Taken::Fresh));
        assert_eq!(intake.take(Some(z(-132.0))), (z(-132.0), Taken::Fresh), "it lasts");
    }
}
