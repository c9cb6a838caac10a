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
    /// Makes the allowance of an axis that has had no gap yet: it is zero.
    #[must_use]
    pub fn new(period: Length) -> Self {
        Self { distance: 0.0, drain: StepFilter::DRAIN * period.ratio() }
    }

    /// Registers a reading of the counter: in the gap before it the motor can have moved by
    /// `hidden` (rad), which is 0 without a gap. Returns the distance that this gap and the earlier
    /// ones can still explain (rad).
    pub fn read(&mut self, hidden: f64) -> f64 {
        // The backlog drains at this rate, and the allowance must not outlast it.
        self.distance = (self.distance - self.drain).max(0.0) + hidden;
        self.distance
    }

    /// Returns the part of a regulator's backlog that gaps explain (rad).
    #[must_use]
    pub fn of(&self, backlog: f64) -> f64 {
        // `clamp` would panic on a bound that is NaN.
        backlog.max(-self.distance).min(self.distance)
    }

    /// Sets the allowance to zero, so that earlier gaps explain nothing.
    pub fn reset(&mut self) {
        self.distance = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn allowance_limits_excused_backlog_and_drains_to_zero() {
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
