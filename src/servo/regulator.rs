//! EDPS: the motor servo of one axis.
//!
//! An incremental regulator on steps, not on positions: what is wanted and what was measured in one period,
//! both in encoder increments, become a change of the pulse width. The steps' error is summed inside, so a
//! lasting position error is worked off by the small difference of k1 and k2.
//!
//! - in: wanted and measured step of one period [encoder increments]
//! - out: pulse width, within the clamp
//! - source: regulator algorithm 0 of the original's servo; its gains are data (`irp6_servo.toml`)

use super::period::Length;
use crate::motion::AXES;
use serde::{Deserialize, Serialize};

/// Gains of one axis: `e = wanted - measured`, `de += k1 e - k2 e_old`,
/// `u = (1 + a) u1 - a u2 + ratio (b0 de - b1 de_old)`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RegulatorGains {
    /// Pole of the smoothing filter.
    pub a: f64,
    /// Weight of the error now [pulse width per increment].
    pub b0: f64,
    /// Weight of the last error [pulse width per increment].
    pub b1: f64,
    /// Factor of both: ratio of the supply voltages for which they were found.
    pub ratio: f64,
    /// Weight of the step error now.
    pub k1: f64,
    /// Weight of the last step error.
    pub k2: f64,
}

impl RegulatorGains {
    /// The same regulator for periods of another length: poles and zeros keep their times (matched transform), and
    /// the gain at low frequencies stays.
    #[must_use]
    pub fn for_period(self, period: Length) -> Self {
        if period == Length::default() {
            return self;
        }
        let ratio = period.ratio();
        let a = libm::pow(self.a, ratio);
        let k2 = self.k1 * libm::pow(self.k2 / self.k1, ratio);
        let zero = libm::pow(self.b1 / self.b0, ratio);
        // Low frequencies: (k1 - k2) (b0 - b1) / (1 - a), summed once a period.
        let low = (self.k1 - self.k2) * (self.b0 - self.b1) / (1.0 - self.a);
        let b0 = low * ratio * (1.0 - a) / ((self.k1 - k2) * (1.0 - zero));
        Self { a, b0, b1: b0 * zero, k2, ..self }
    }
}

/// Gains of the jaw: a regulator of its position whose pulse width keeps the motor's current within the grip.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JawGains {
    /// Weight of the position error [pulse width per rad of the motor].
    pub position: f64,
    /// Weight of the position error's sum over time, while nothing limits the pulse width [per rad s of the motor].
    pub integral: f64,
    /// Weight of the measured speed, which brakes [pulse width per rad/s of the motor].
    pub speed: f64,
    /// By how much the pulse width gives way to a current that is too large [pulse width per A]; a third of the motor's
    /// own figure at rest settles in some periods and bears readings that are three of them late.
    pub current: f64,
    /// Most change of the pulse width in 2 ms: so fast a grip builds up.
    pub slew: f64,
}

/// Regulators and watch-dogs of an arm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServoGains {
    /// Track, then the six rotary axes.
    pub axes: [RegulatorGains; AXES],
    /// Jaw motor.
    pub jaw: JawGains,
    /// Largest pulse width, of 255.
    pub pwm_limit: f64,
    /// Most change of an arm motor's pulse width in 2 ms, of 255.
    pub pwm_slew: f64,
    /// Allowed difference of set and measured motor position at rest [rad].
    pub following_error: f64,
    /// Further allowance per speed of the set value [s].
    pub following_lag: f64,
    /// Grip force that a jaw exerts at most until a command says otherwise [N].
    pub idle_grip: f64,
}

/// Text of the built-in gains of the `IRp-6`.
pub const IRP6: &str = include_str!("../../scenarios/arms/irp6_servo.toml");

impl ServoGains {
    /// Parses a profile such as [`IRP6`].
    ///
    /// # Errors
    /// What the parser says: a missing or unknown key, a wrong type.
    pub fn parse(text: &str) -> Result<Self, toml::de::Error> {
        toml::from_str(text)
    }
}

/// The regulator of one axis with its memory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Regulator {
    gains: RegulatorGains,
    limit: f64,
    slew: f64,
    /// Error of the last step [increments].
    last_error: f64,
    /// Summed error of the last step [increments].
    last_sum: f64,
    /// Pulse widths of the last two steps.
    last_output: f64,
    older_output: f64,
}

impl Regulator {
    /// At rest.
    #[must_use]
    pub fn new(gains: RegulatorGains, pwm_limit: f64) -> Self {
        Self {
            gains,
            limit: pwm_limit,
            slew: f64::INFINITY,
            last_error: 0.0,
            last_sum: 0.0,
            last_output: 0.0,
            older_output: 0.0,
        }
    }

    /// With a limit of how much the pulse width changes in a period: a current that rises slowly is seen before it trips.
    #[must_use]
    pub fn slowed(self, slew: f64) -> Self {
        Self { slew, ..self }
    }

    /// Pulse width for a period, from the wanted and the measured step [increments].
    pub fn step(&mut self, wanted: f64, measured: f64) -> i16 {
        let RegulatorGains { a, b0, b1, ratio, k1, k2 } = self.gains;
        let error = wanted - measured;
        let sum = self.last_sum + k1 * error - k2 * self.last_error;
        let output = (1.0 + a) * self.last_output - a * self.older_output
            + ratio * (b0 * sum - b1 * self.last_sum);
        if !output.is_finite() {
            self.reset();
            return 0;
        }
        // The clamps on the remembered output are what keeps the incremental form from winding up.
        // Never a panic here, whatever a profile says.
        let slow = output.max(self.last_output - self.slew).min(self.last_output + self.slew);
        let output = slow.max(-self.limit).min(self.limit);
        self.older_output = self.last_output;
        self.last_output = output;
        self.last_sum = sum;
        self.last_error = error;
        output as i16
    }

    /// Pulse width of the last step, as a share of 255.
    #[must_use]
    pub fn drive(&self) -> f64 {
        self.last_output / 255.0
    }

    /// Forgets the past: the axis stands where it should.
    pub fn reset(&mut self) {
        *self = Self::new(self.gains, self.limit).slowed(self.slew);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// A motor that is sure not to share anything with the plant: first order, 40 ms, 330 rad/s at 255,
    /// Coulomb friction as a share of the pulse width that must be overcome.
    struct Motor {
        position: f64,
        speed: f64,
        friction: f64,
    }

    impl Motor {
        fn turn(&mut self, pwm: f64) {
            for _ in 0..4 {
                let seconds = 0.0005;
                let drive = pwm * 330.0 / 255.0;
                let friction = self.friction * 330.0 / 255.0;
                let free = self.speed + (drive - self.speed) * seconds / 0.040;
                let brake = friction * seconds / 0.040;
                self.speed = if free.abs() <= brake { 0.0 } else { free - brake.copysign(free) };
                self.position += self.speed * seconds;
            }
        }
    }

    fn gains() -> ServoGains {
        ServoGains::parse(IRP6).unwrap()
    }

    /// Runs a set value through an axis; returns the largest error on the way and the error at its end [rad].
    fn follow(
        gains: RegulatorGains,
        increments: f64,
        friction: f64,
        set: impl Fn(f64) -> f64,
        seconds: f64,
    ) -> (f64, f64) {
        let mut regulator = Regulator::new(gains, 190.0).slowed(25.0);
        let mut motor = Motor { position: 0.0, speed: 0.0, friction };
        let (mut last_set, mut last_count, mut worst) = (0.0, 0, 0.0f64);
        for period in 1..=(seconds / 0.002) as u32 {
            let wanted = set(f64::from(period) * 0.002) * increments / TAU;
            let count = (motor.position * increments / TAU).floor() as i64;
            let pwm = regulator.step(wanted - last_set, (count - last_count) as f64);
            (last_set, last_count) = (wanted, count);
            motor.turn(f64::from(pwm));
            worst = worst.max((wanted * TAU / increments - motor.position).abs());
        }
        (worst, (last_set * TAU / increments - motor.position).abs())
    }

    #[test]
    fn every_axis_follows_a_ramp_and_stops_where_it_should() {
        let gains = gains();
        for (axis, increments) in
            [4000.0, 4000.0, 4000.0, 4000.0, 4000.0, 4000.0, 2000.0].into_iter().enumerate()
        {
            // Up to 100 rad/s in half a second, half a second on, down again.
            let set = |t: f64| {
                let ramp = |t: f64| 100.0 * t.max(0.0) * t.max(0.0);
                ramp(t) - ramp(t - 0.5) - ramp(t - 1.0) + ramp(t - 1.5)
            };

            let (worst, rest) = follow(gains.axes[axis], increments, 15.0, set, 4.0);

            assert!(worst < 3.0, "axis {axis}: {worst} rad behind");
            assert!(rest < 0.25, "axis {axis}: {rest} rad at rest");
        }
    }

    #[test]
    fn the_output_is_clamped_and_comes_back_at_once() {
        let mut regulator = Regulator::new(gains().axes[1], 190.0);
        for _ in 0..100 {
            assert!(regulator.step(400.0, 0.0) <= 190);
        }
        assert_eq!(regulator.step(400.0, 0.0), 190);

        let outputs: Vec<i16> = (0..30).map(|_| regulator.step(0.0, 1600.0)).collect();

        assert!(outputs.contains(&-190), "{outputs:?}");
    }

    #[test]
    fn the_output_changes_by_no_more_than_its_slew() {
        let mut regulator = Regulator::new(gains().axes[1], 190.0).slowed(25.0);
        let wanted = |k: i32| if k % 40 < 20 { 400.0 } else { -400.0 };

        let outputs: Vec<i16> = (0..200).map(|k| regulator.step(wanted(k), 0.0)).collect();

        let steps = outputs.windows(2).map(|w| (w[1] - w[0]).abs());
        assert_eq!(steps.max(), Some(25), "{outputs:?}");
        assert!(outputs.contains(&190) && outputs.contains(&-190));
    }

    #[test]
    fn what_is_no_number_stops_the_axis() {
        let mut regulator = Regulator::new(gains().axes[1], 190.0);
        regulator.step(5.0, 0.0);

        assert_eq!(regulator.step(f64::NAN, 0.0), 0);
        assert_eq!(regulator, Regulator::new(gains().axes[1], 190.0));
    }
}
