//! The step of an axis as its regulator is told it: what no motor can do is no step, but news that came late.
//!
//! - in: how far the counter went since the last period, whatever lies between: missed periods, answers that were late,
//!   an order that was read a little early or late
//! - out: a step that a motor can have made; what is left over follows little by little, so that nothing is lost
//!
//! A regulator of steps takes an axis that shows nothing for a period for one that was stopped dead, and one that shows
//! two steps at once for one that runs away; at speed its answer to either trips a power stage.

use super::period::Length;

/// Steps of one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stride {
    last: f64,
    owed: f64,
    /// Periods in a row in which the counter showed what no motor can do.
    strange: u32,
    /// The most by which a step differs from the one before under full drive, a step at full speed, and the most of what is
    /// owed that follows in a period.
    change: f64,
    fastest: f64,
    pay: f64,
    share: f64,
}

impl Stride {
    /// Most change of a motor's step from one period of 2 ms to the next [rad]: the fastest of them reach their speed of
    /// 330 rad/s in 40 ms, 0.033 rad; what stops them is softer still.
    const CHANGE: f64 = 0.06;
    /// A motor's step of 2 ms at full speed [rad].
    const FASTEST: f64 = 0.66;
    /// Share of that change which is believed of a motor at rest without drive: what it drives may move it.
    const REST: f64 = 0.15;
    /// Steps of the encoder itself.
    const ENCODER: f64 = 3.0;
    /// Periods for which an axis is taken to go on as before: after these the counter is believed, as fast as a motor
    /// could change.
    const GOES_ON: u32 = 3;
    /// Share of what is owed that follows in 2 ms, and the most of it [rad]: a tenth of what trips a power stage.
    const SHARE: f64 = 0.04;
    pub(super) const PAY: f64 = 0.015;

    /// At rest; a revolution of the motor has so many increments.
    #[must_use]
    pub fn new(increments: f64, period: Length) -> Self {
        let (ratio, radian) = (period.ratio(), increments / std::f64::consts::TAU);
        Self {
            last: 0.0,
            owed: 0.0,
            strange: 0,
            change: Self::CHANGE * ratio * ratio * radian,
            fastest: Self::FASTEST * ratio * radian,
            pay: Self::PAY * ratio * radian,
            share: (Self::SHARE * ratio).min(1.0),
        }
    }

    /// The step to reckon with, of the counter's step [increments]; the motor was driven by this share of the full pulse
    /// width. What drives it and what brakes it, its speed, bound by how much its step changes.
    pub fn of(&mut self, step: f64, drive: f64) -> f64 {
        let share = (Self::REST + drive.abs() + (self.last / self.fastest).abs()).min(1.0);
        let change = self.change * share + Self::ENCODER;
        let (low, high) = (self.last - change, self.last + change);
        let strange = !(low..=high).contains(&step);
        self.strange = if strange { self.strange.saturating_add(1) } else { 0 };
        let goes_on = strange && self.strange <= Self::GOES_ON;
        let likely = if goes_on { self.last } else { step.clamp(low, high) };
        self.last = likely;
        self.owed += step - likely;
        // The last of it at once: rounding leaves no debt.
        let paid = if self.owed.abs() < 1.0 {
            self.owed
        } else {
            (self.share * self.owed).clamp(-self.pay, self.pay)
        };
        self.owed -= paid;
        likely + paid
    }

    /// How far the motor is ahead of the steps that were told, or behind [increments].
    #[must_use]
    pub fn owed(&self) -> f64 {
        self.owed
    }

    /// What is owed is of no interest any more: set values begin anew from what is measured.
    pub fn forgive(&mut self) {
        self.owed = 0.0;
    }

    /// The axis stands, and nothing is owed.
    pub fn reset(&mut self) {
        (self.last, self.owed, self.strange) = (0.0, 0.0, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPEED: f64 = 300.0;

    fn running() -> Stride {
        let mut stride = Stride::new(4000.0, Length::default());
        for step in [30.0, 60.0, 90.0, 120.0, 150.0, 180.0, 210.0, 240.0, 270.0, SPEED] {
            assert!(
                (stride.of(step, 1.0) - step).abs() < 1e-12,
                "what a motor can do passes as it is"
            );
        }
        stride
    }

    #[test]
    fn an_axis_that_shows_nothing_for_a_period_is_taken_to_go_on() {
        let mut stride = running();

        let told = [0.0, 2.0 * SPEED, SPEED, SPEED].map(|step| stride.of(step, 0.7));

        for step in told {
            assert!((step - SPEED).abs() < 0.05 * SPEED, "{told:?}");
        }
    }

    #[test]
    fn an_axis_at_rest_without_drive_does_not_leap_there_and_back() {
        let mut stride = Stride::new(4000.0, Length::default());

        // A wrong bit of a counter.
        let told = [0.0, 16.0, -16.0, 0.0, 0.0].map(|step| stride.of(step, 0.02));
        assert!(told.iter().all(|step| step.abs() < 1.0), "{told:?}");

        let told = [16.0, -16.0].map(|step| stride.of(step, 1.0));
        assert_eq!(told, [16.0, -16.0], "driven, it may");
    }

    #[test]
    fn what_it_went_in_a_gap_follows_little_by_little_and_whole() {
        let mut stride = running();

        let told: Vec<f64> = [6.0 * SPEED]
            .into_iter()
            .chain([SPEED; 600])
            .map(|step| stride.of(step, 0.7))
            .collect();

        assert!(told.iter().all(|step| (step - SPEED).abs() < 0.05 * SPEED), "{told:?}");
        assert!((told.iter().sum::<f64>() - 606.0 * SPEED).abs() < 1.0);
    }

    #[test]
    fn an_axis_that_is_stopped_dead_is_seen_to_stop_within_a_few_periods() {
        let mut stride = running();

        let told: Vec<f64> = [0.0; 600].map(|step| stride.of(step, 0.7)).to_vec();

        assert!(told[12].abs() < 0.25 * SPEED && told[599].abs() < 1.0, "{told:?}");
    }
}
