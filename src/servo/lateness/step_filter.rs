//! The step of an axis as its regulator gets it: a step that no motor can make is late news, not a
//! motion.
//!
//! - in: how far the counter went since the last period, whatever lies between: missed periods,
//!   late answers, an order that the controller read a little early or late
//! - out: a step that a motor can have made; the rest is the backlog, which drains into the
//!   following steps, so that nothing is lost

use crate::servo::period::Length;

/// Steps of one axis, and the backlog of its regulator (increments).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepFilter {
    last: f64,
    backlog: f64,
    /// Number of periods in a row in which the counter showed a step that no motor can make.
    implausible: u32,
    /// The most by which a step differs from the one before under full drive.
    change: f64,
    /// A step at full speed.
    fastest: f64,
    /// The most of the backlog that drains in a period, and the share of it.
    drain: f64,
    share: f64,
}

impl StepFilter {
    /// Most change of a motor's step from one period of 2 ms to the next (rad): the fastest motors
    /// reach their speed of 330 rad/s in 40 ms, 0.033 rad; they stop more softly than that.
    const CHANGE: f64 = 0.06;
    /// A motor's step of 2 ms at full speed (rad).
    const FASTEST: f64 = 0.66;
    /// Share of that change which is believed of a motor at rest without drive: the load may move
    /// it.
    const REST: f64 = 0.15;
    /// Resolution of the encoder, with a margin (increments).
    const ENCODER: f64 = 3.0;
    /// Periods for which an axis is taken to go on as before. After these the counter is believed,
    /// as fast as a motor could change its speed.
    const GOES_ON: u32 = 3;
    /// Share of the backlog that drains in 2 ms.
    const SHARE: f64 = 0.04;
    /// Most of the backlog that drains in 2 ms (rad): a tenth of what trips a power stage.
    pub(super) const DRAIN: f64 = 0.015;

    /// Makes the filter of an axis at rest. A revolution of its motor has this many `increments`.
    #[must_use]
    pub fn new(increments: f64, period: Length) -> Self {
        let (ratio, radian) = (period.ratio(), increments / std::f64::consts::TAU);
        Self {
            last: 0.0,
            backlog: 0.0,
            implausible: 0,
            change: Self::CHANGE * ratio * ratio * radian,
            fastest: Self::FASTEST * ratio * radian,
            drain: Self::DRAIN * ratio * radian,
            share: (Self::SHARE * ratio).min(1.0),
        }
    }

    /// Returns the step for the regulator, from the counter's `step` (increments). The motor was
    /// driven by `drive`, a share of the full pulse width: drive, speed and friction together bound
    /// by how much a step can change.
    pub fn filter(&mut self, step: f64, drive: f64) -> f64 {
        let share = (Self::REST + drive.abs() + (self.last / self.fastest).abs()).min(1.0);
        let change = self.change * share + Self::ENCODER;
        let (low, high) = (self.last - change, self.last + change);
        let implausible = !(low..=high).contains(&step);
        self.implausible = if implausible { self.implausible.saturating_add(1) } else { 0 };
        let goes_on = implausible && self.implausible <= Self::GOES_ON;
        let likely = if goes_on { self.last } else { step.clamp(low, high) };
        self.last = likely;
        self.backlog += step - likely;
        // The last increment drains at once, so that rounding leaves no backlog.
        let drained = if self.backlog.abs() < 1.0 {
            self.backlog
        } else {
            (self.share * self.backlog).clamp(-self.drain, self.drain)
        };
        self.backlog -= drained;
        likely + drained
    }

    /// Returns how far the motor is ahead of the steps that the regulator was given, or behind them
    /// (increments).
    #[must_use]
    pub fn backlog(&self) -> f64 {
        self.backlog
    }

    /// Drops the backlog: set values begin anew from what is measured.
    pub fn clear(&mut self) {
        self.backlog = 0.0;
    }

    /// Forgets the past: the axis stands, without a backlog.
    pub fn reset(&mut self) {
        (self.last, self.backlog, self.implausible) = (0.0, 0.0, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPEED: f64 = 300.0;

    fn running() -> StepFilter {
        let mut filter = StepFilter::new(4000.0, Length::default());
        for step in [30.0, 60.0, 90.0, 120.0, 150.0, 180.0, 210.0, 240.0, 270.0, SPEED] {
            assert!(
                (filter.filter(step, 1.0) - step).abs() < 1e-12,
                "a step that a motor can make passes unchanged"
            );
        }
        filter
    }

    /// A counter shows nothing for a period, then two periods' steps at once.
    #[test]
    fn filter_bridges_a_missed_reading() {
        let mut filter = running();

        let steps = [0.0, 2.0 * SPEED, SPEED, SPEED].map(|step| filter.filter(step, 0.7));

        for step in steps {
            assert!((step - SPEED).abs() < 0.05 * SPEED, "{steps:?}");
        }
    }

    #[test]
    fn filter_ignores_a_leap_at_rest() {
        let mut filter = StepFilter::new(4000.0, Length::default());

        // A wrong bit of a counter.
        let steps = [0.0, 16.0, -16.0, 0.0, 0.0].map(|step| filter.filter(step, 0.02));
        assert!(steps.iter().all(|step| step.abs() < 1.0), "{steps:?}");

        let steps = [16.0, -16.0].map(|step| filter.filter(step, 1.0));
        assert_eq!(steps, [16.0, -16.0], "a driven motor can make them");
    }

    #[test]
    fn backlog_of_a_gap_drains_completely() {
        let mut filter = running();

        let steps: Vec<f64> = [6.0 * SPEED]
            .into_iter()
            .chain([SPEED; 600])
            .map(|step| filter.filter(step, 0.7))
            .collect();

        assert!(steps.iter().all(|step| (step - SPEED).abs() < 0.05 * SPEED), "{steps:?}");
        assert!((steps.iter().sum::<f64>() - 606.0 * SPEED).abs() < 1.0);
    }

    #[test]
    fn filter_follows_a_sudden_stop() {
        let mut filter = running();

        let steps: Vec<f64> = [0.0; 600].map(|step| filter.filter(step, 0.7)).to_vec();

        assert!(steps[12].abs() < 0.25 * SPEED && steps[599].abs() < 1.0, "{steps:?}");
    }
}
