//! The step of an axis as its regulator gets it. A step that no motor can make is a late reading
//! and not a motion.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | implausible step | `CHANGE`, `REST` | drive, speed and load explain no larger change |
//! | implausible steps in a row | `GOES_ON` | a lasting change is a motion of the axis |
//! | backlog | `SHARE`, `DRAIN` | it drains without tripping a power stage |
//!
//! - in: the change of the counter since the last period, with all causes: missed periods, late
//!   answers, an order that the controller read a little early or late
//! - out: a step that a motor can have made; the rest is the backlog, which drains into the
//!   following steps, so that nothing is lost

use crate::servo::period::Length;

/// Steps of one axis, and the backlog of its regulator (increments).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepFilter {
    /// Step of the last period, as the regulator got it without the drained part of the backlog.
    last: f64,
    backlog: f64,
    /// Number of periods in a row in which the counter showed a step that no motor can make.
    implausible: u32,
    /// Largest change of the step from period to period under full drive.
    change: f64,
    /// Step at full speed.
    fastest: f64,
    /// Largest part of the backlog that drains in a period, and the usual share of it.
    drain: f64,
    share: f64,
}

impl StepFilter {
    /// Largest change of a motor's step from one period of 2 ms to the next (rad). The fastest
    /// motors reach their speed of 330 rad/s in 40 ms, a change of 0.033 rad in each period, and
    /// they stop more softly.
    const CHANGE: f64 = 0.06;
    /// Step of a motor in 2 ms at full speed (rad).
    const FASTEST: f64 = 0.66;
    /// Share of [`StepFilter::CHANGE`] that is plausible for a motor at rest without drive, which
    /// the load may move.
    const REST: f64 = 0.15;
    /// Resolution of the encoder, with a margin (increments).
    const ENCODER: f64 = 3.0;
    /// Periods for which an axis is assumed to continue its last step. After these the filter
    /// follows the counter, at the largest change of speed that a motor can make.
    const GOES_ON: u32 = 3;
    /// Share of the backlog that drains in 2 ms.
    const SHARE: f64 = 0.04;
    /// Largest part of the backlog that drains in 2 ms (rad): a tenth of the step that trips a
    /// power stage.
    pub(super) const DRAIN: f64 = 0.015;

    /// Makes the filter of an axis at rest. `increments` is the number of encoder increments per
    /// revolution of its motor.
    #[must_use]
    pub fn new(increments: f64, period: Length) -> Self {
        let (ratio, radian) = (period.ratio(), increments / std::f64::consts::TAU);
        // A step grows with the length of the period, and its change with the square of it.
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

    /// Returns the step for the regulator in this period, from the step that the counter made
    /// (increments). `drive` is the pulse width of the last period as a share of 255. Drive, speed
    /// and friction together bound the change of a step.
    pub fn filter(&mut self, step: f64, drive: f64) -> f64 {
        let share = (Self::REST + drive.abs() + (self.last / self.fastest).abs()).min(1.0);
        let change = self.change * share + Self::ENCODER;
        let (low, high) = (self.last - change, self.last + change);
        // A single implausible step is a late reading: the axis keeps its speed. After some in a
        // row the counter does move like this, and the step follows it within the bounds.
        let implausible = !(low..=high).contains(&step);
        self.implausible = if implausible { self.implausible.saturating_add(1) } else { 0 };
        let goes_on = implausible && self.implausible <= Self::GOES_ON;
        let likely = if goes_on { self.last } else { step.clamp(low, high) };
        // The counter has moved by `step` in any case, so the rest must reach the regulator later.
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

    /// Returns the distance by which the motor is ahead of the sum of all steps that the regulator
    /// was given, negative if it is behind (increments).
    #[must_use]
    pub fn backlog(&self) -> f64 {
        self.backlog
    }

    /// Drops the backlog, because the set values restart from the measured ones.
    pub fn clear(&mut self) {
        self.backlog = 0.0;
    }

    /// Clears the memory, as for an axis at rest.
    pub fn reset(&mut self) {
        (self.last, self.backlog, self.implausible) = (0.0, 0.0, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Speed of an axis (increments per period).
    const SPEED: f64 = 300.0;

    /// Returns the filter of an axis that has accelerated to [`SPEED`].
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
    fn filter_removes_counter_jump_of_motor_at_rest() {
        let mut filter = StepFilter::new(4000.0, Length::default());

        // One wrong bit of a counter changes it for a period.
        let steps = [0.0, 16.0, -16.0, 0.0, 0.0].map(|step| filter.filter(step, 0.02));
        assert!(steps.iter().all(|step| step.abs() < 1.0), "{steps:?}");

        let steps = [16.0, -16.0].map(|step| filter.filter(step, 1.0));
        assert_eq!(steps, [16.0, -16.0], "a driven motor can make them");
    }

    #[test]
    fn filter_spreads_step_after_gap_without_losing_counts() {
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
