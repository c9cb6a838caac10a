//! The part of a following error that gaps explain.
//!
//! A motor that kept moving during a gap is not at fault, and the regulator works off the distance.
//! While the position of the motor is in doubt, the watchdog allows for this distance in both
//! directions; afterwards only for the part that is in the regulator's backlog. Gaps that follow
//! each other allow for the backlog of all of them, but beyond the backlog only for the distance of
//! the last gap.
//!
//! - in: the distance that a motor can have moved in a gap; the backlog of its regulator
//! - out: the part of the backlog that is no error

use super::StepFilter;
use crate::servo::period::Length;

/// Distance that a motor can have moved in gaps and that its regulator's backlog may still contain
/// (rad of the motor).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Allowance {
    distance: f64,
    /// Part of it that drains between two readings.
    drain: f64,
}

impl Allowance {
    /// Makes an allowance of zero.
    #[must_use]
    pub fn new(period: Length) -> Self {
        Self { distance: 0.0, drain: StepFilter::DRAIN * period.ratio() }
    }

    /// Adds a reading: the motor can have moved by `hidden` in the gap before it. Returns the whole
    /// allowance (rad).
    pub fn read(&mut self, hidden: f64) -> f64 {
        // The backlog drains at this rate, and the allowance must not outlast it.
        self.distance = (self.distance - self.drain).max(0.0) + hidden;
        self.distance
    }

    /// Returns the part of the `backlog` that the gaps explain.
    #[must_use]
    pub fn of(&self, backlog: f64) -> f64 {
        // `clamp` would panic on a bound that is NaN.
        backlog.max(-self.distance).min(self.distance)
    }

    /// Drops the allowance of all gaps.
    pub fn reset(&mut self) {
        self.distance = 0.0;
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
