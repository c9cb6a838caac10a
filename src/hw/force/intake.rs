//! Common judgement of the readings of all force sensors: which wrench counts in a period.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | no reading | held for [`HOLDS`] periods, then NaN | the original's timeout of 10 ms |
//! | reading beyond the range | [`DROPPED`] in a row are dropped | a single one is a disturbance |
//! | more of them in a row | - | an overload that lasts passes, since the servo must stop for it |
//!
//! - in: the newest reading of a period, or none
//! - out: the wrench that counts in this period, and the case
//! - source: the original, which drops each reading beyond the range and reports it as non-fatal

use crate::spatial::Wrench;

/// Periods for which a reading is held if no other comes: 10 ms, as in the original.
const HOLDS: u32 = 5;
/// Largest number of readings beyond the range that are dropped in a row.
const DROPPED: u32 = 2;

/// Result of a period's reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Taken {
    /// New reading that counts.
    Fresh,
    /// Last reading, which is held because no new one came.
    Held,
    /// Last reading, which is held because the new one left the range and was dropped.
    OverRange {
        /// Index of the direction that left the range.
        direction: usize,
        /// Value in that direction (N or Nm).
        reading: f64,
    },
    /// No reading for too long.
    Silent {
        /// Whether this is the first period of the silence.
        first: bool,
    },
    /// First reading after a silence, which counts.
    Back,
}

impl Taken {
    /// Returns whether the wrench of the period is a new reading or the NaN of a silence, not the
    /// last reading held.
    #[must_use]
    pub fn is_new(&self) -> bool {
        !matches!(self, Self::Held | Self::OverRange { .. })
    }
}

/// Recent readings of a sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intake {
    /// Range of each direction (N, Nm).
    range: [f64; 6],
    /// Last reading that counted.
    last: Wrench,
    /// Periods since the last reading that counted.
    age: u32,
    /// Number of readings in a row that were dropped.
    dropped: u32,
}

impl Intake {
    /// Makes an intake that is silent until the first reading. `range` is
    /// [`ForceSensor::range`](crate::cell::ForceSensor::range) (N, Nm).
    #[must_use]
    pub fn new(range: [f64; 6]) -> Self {
        let silent = Wrench::from_directions([f64::NAN; 6]);
        Self { range, last: silent, age: HOLDS + 2, dropped: 0 }
    }

    /// Processes the reading of a period, `None` if none came. Returns the wrench that counts in
    /// this period, and whether it is new, held, or missing.
    pub fn take(&mut self, reading: Option<Wrench>) -> (Wrench, Taken) {
        let Some(wrench) = reading else { return self.none() };
        if let Some((direction, reading)) = self.beyond(&wrench)
            && self.dropped < DROPPED
        {
            self.dropped += 1;
            // A dropped reading is a missing one: it must not prolong the last reading.
            let (held, taken) = self.none();
            let silent = matches!(taken, Taken::Silent { .. });
            return (held, if silent { taken } else { Taken::OverRange { direction, reading } });
        }
        // During an overload the count stays at its limit, so each further reading passes.
        if self.beyond(&wrench).is_none() {
            self.dropped = 0;
        }
        let was_silent = self.age > HOLDS;
        (self.last, self.age) = (wrench, 0);
        (wrench, if was_silent { Taken::Back } else { Taken::Fresh })
    }

    /// Processes a period without a usable reading: the last one is held, or the sensor is silent.
    fn none(&mut self) -> (Wrench, Taken) {
        self.age = self.age.saturating_add(1);
        if self.age <= HOLDS {
            return (self.last, Taken::Held);
        }
        let silent = Wrench::from_directions([f64::NAN; 6]);
        (silent, Taken::Silent { first: self.age == HOLDS + 1 })
    }

    /// Returns the first direction in which a wrench leaves the range or is NaN, with its value (N
    /// or Nm).
    fn beyond(&self, wrench: &Wrench) -> Option<(usize, f64)> {
        let values = wrench.directions();
        // NaN is no force either. It fails every comparison, so it has a test of its own.
        (0..6)
            .find(|&i| values[i].is_nan() || values[i].abs() >= self.range[i])
            .map(|i| (i, values[i]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a wrench that is this force along z (N).
    fn z(force: f64) -> Wrench {
        Wrench::from_directions([0.0, 0.0, force, 0.0, 0.0, 0.0])
    }

    /// Returns an intake without readings, for a sensor with a range of 130 N along z.
    fn intake() -> Intake {
        Intake::new([65.0, 65.0, 130.0, 5.0, 5.0, 5.0])
    }

    #[test]
    fn last_force_reading_holds_for_five_silent_periods() {
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
    fn only_first_two_consecutive_overload_readings_are_dropped() {
        let mut intake = intake();
        intake.take(Some(z(3.0)));

        let over = Taken::OverRange { direction: 2, reading: -131.0 };
        assert_eq!(intake.take(Some(z(-131.0))), (z(3.0), over));
        assert_eq!(intake.take(Some(z(4.0))), (z(4.0), Taken::Fresh));
        assert_eq!(intake.take(Some(z(-131.0))).1, over);
        assert_eq!(intake.take(Some(z(-131.0))).1, over);
        assert_eq!(intake.take(Some(z(-131.0))), (z(-131.0), Taken::Fresh));
        assert_eq!(
            intake.take(Some(z(-132.0))),
            (z(-132.0), Taken::Fresh),
            "a lasting overload is passed on"
        );
    }
}
