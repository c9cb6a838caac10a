//! The backlog that the watchdog of the following error allows for after a gap.
//!
//! - in: the way that a motor can have gone in a gap; the backlog of its regulator
//! - out: the part of the backlog that is no error
//! - a motor that went on during a gap is not at fault, and the servo works the way off: as much as
//!   the motor can have gone while its place is not known, and on the side on which it is as soon
//!   as that is known. Gaps that follow each other allow for the backlog of all of them, but beyond
//!   it no more than the last of them hides

use super::StepFilter;
use crate::servo::period::Length;

/// Way that a motor can have gone in gaps and that may still be in its regulator's backlog (rad of
/// the motor).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Allowance {
    way: f64,
    /// How much of it drains between two readings.
    drain: f64,
}

impl Allowance {
    /// Allows for nothing yet.
    #[must_use]
    pub fn new(period: Length) -> Self {
        Self { way: 0.0, drain: StepFilter::DRAIN * period.ratio() }
    }

    /// Notes a reading: the motor can have gone `hidden` in the gap before it. Returns the whole
    /// allowance.
    pub fn read(&mut self, hidden: f64) -> f64 {
        self.way = (self.way - self.drain).max(0.0) + hidden;
        self.way
    }

    /// Returns the part of the `backlog` that the gaps explain.
    #[must_use]
    pub fn of(&self, backlog: f64) -> f64 {
        backlog.max(-self.way).min(self.way)
    }

    /// Forgets all gaps.
    pub fn reset(&mut self) {
        self.way = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn allowance_covers_the_backlog_of_gaps_and_drains() {
        let mut allowance = Allowance::new(Length::default());
        assert_eq!(allowance.of(3.0), 0.0);

        assert_eq!(allowance.read(2.0), 2.0);
        assert_eq!([3.0, -3.0, 1.5].map(|backlog| allowance.of(backlog)), [2.0, -2.0, 1.5]);

        for _ in 0..200 {
            allowance.read(0.0);
        }
        assert_eq!(allowance.of(3.0), 0.0);
    }
}
