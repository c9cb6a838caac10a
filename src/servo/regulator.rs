//! The motor regulator of one axis (EDPS in the paper).
//!
//! The regulator is incremental: it works on steps, not on positions. The wanted and the measured
//! step of a period, both in encoder increments, give a change of the pulse width. The regulator
//! sums the errors of the steps, so the small difference of k1 and k2 removes a lasting position
//! error.
//!
//! Five rules limit the pulse width:
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | large output | [`ServoGains::pwm_limit`] | clamp of the original; it also prevents windup |
//! | fast change | [`ServoGains::pwm_slew`] | answers to late readings would trip a power stage |
//! | large current | `MOST_CURRENT` | the width grows ever more slowly up to this current |
//! | no current reading | - | the stage may still apply an older width, so the width stays |
//! | output is not a number | - | the motor stops, and the memory is cleared |
//!
//! - in: wanted and measured step of one period (encoder increments); current of the motor (A)
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
    /// Weight of the present summed error (pulse width per increment).
    pub b0: f64,
    /// Weight of the last summed error (pulse width per increment).
    pub b1: f64,
    /// Factor of b0 and b1: ratio of the supply voltages for which they were found.
    pub ratio: f64,
    /// Weight of the present step error.
    pub k1: f64,
    /// Weight of the last step error.
    pub k2: f64,
    /// Motor current at which the power stage trips (A); the regulator keeps below it. Infinite if
    /// the sign of the current is not known.
    pub trip_current: f64,
}

impl RegulatorGains {
    /// Converts gains for periods of 2 ms into those for another length of a period. Poles and
    /// zeros keep their times (matched transform), and the gain at low frequencies stays.
    #[must_use]
    pub fn for_period(self, period: Length) -> Self {
        // At a ratio of 1 the arithmetic below would return the same gains only up to rounding.
        if period == Length::default() {
            return self;
        }
        let ratio = period.ratio();
        let a = libm::pow(self.a, ratio);
        let k2 = self.k1 * libm::pow(self.k2 / self.k1, ratio);
        let zero = libm::pow(self.b1 / self.b0, ratio);
        // For a lasting position error of one increment the pulse width grows by
        // (k1 - k2) (b0 - b1) / (1 - a) in each period, so a longer period takes more of it.
        let low = (self.k1 - self.k2) * (self.b0 - self.b1) / (1.0 - self.a);
        let b0 = low * ratio * (1.0 - a) / ((self.k1 - k2) * (1.0 - zero));
        Self { a, b0, b1: b0 * zero, k2, ..self }
    }
}

/// Gains of the jaw: a regulator of its position whose pulse width keeps the current of the motor
/// within the wanted grip.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JawGains {
    /// Weight of the position error (pulse width per rad of the motor).
    pub position: f64,
    /// Weight of the position error's integral over time (pulse width per rad s of the motor). The
    /// integral stops while a limit acts on the pulse width.
    pub integral: f64,
    /// Weight of the measured speed, which brakes (pulse width per rad/s of the motor).
    pub speed: f64,
    /// Change of the pulse width in a period per difference of wanted and measured current (pulse
    /// width per A). A third of the motor's own ratio at standstill settles within some periods and
    /// stays stable with readings that are three periods late.
    pub current: f64,
    /// Largest change of the pulse width in 2 ms, which sets how fast a grip builds up.
    pub slew: f64,
}

/// Gains of the regulators and thresholds of the watchdogs of an arm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServoGains {
    /// Gains of the track, then of the six rotary axes.
    pub axes: [RegulatorGains; AXES],
    /// Gains of the jaw motor.
    pub jaw: JawGains,
    /// Largest pulse width, of 255.
    pub pwm_limit: f64,
    /// Largest change of an arm motor's pulse width in 2 ms, of 255.
    pub pwm_slew: f64,
    /// Allowed difference of set and measured motor position at rest (rad).
    pub following_error: f64,
    /// Further allowance per speed of the set value (s).
    pub following_lag: f64,
    /// Largest grip force of a jaw before its first command (N).
    pub idle_grip: f64,
}

/// Text of the built-in gains of the `IRp-6`.
pub const IRP6: &str = include_str!("../../scenarios/arms/irp6_servo.toml");

impl ServoGains {
    /// Parses gains and thresholds from TOML text in the format of [`IRP6`].
    ///
    /// # Errors
    /// The parser's error: a missing or unknown key, or a wrong type.
    pub fn parse(text: &str) -> Result<Self, toml::de::Error> {
        toml::from_str(text)
    }
}

/// Share of the trip current at which the pulse width stops growing. A mission needs 0.4 at most.
const MOST_CURRENT: f64 = 0.6;
/// Growth of the pulse width in a period per headroom. The headroom is the part of the trip current
/// that is left below [`MOST_CURRENT`]. A reading is some periods old, and the current follows the
/// pulse width at once, so the growth must slow down before the limit. With this gain a motor that
/// draws 1.5 times the trip current at full voltage and standstill does not trip its stage, even
/// with readings that are three periods of 2 ms old. The whole headroom allows a growth of 43,
/// which is below [`ServoGains::pwm_slew`] only in periods longer than 3.4 ms.
const HEADROOM_GAIN: f64 = 71.0;
/// Largest decrease of the pulse width in a period because of a current above [`MOST_CURRENT`].
/// Readings have no checksum, and one with a wrong bit must not shake an axis.
const MOST_BACK: f64 = 5.0;

/// Regulator of one axis with its memory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Regulator {
    gains: RegulatorGains,
    limit: f64,
    slew: f64,
    /// Error of the last step (increments).
    last_error: f64,
    /// Summed error of the last step (increments).
    last_sum: f64,
    /// Pulse widths of the last two steps.
    last_output: f64,
    older_output: f64,
}

impl Regulator {
    /// Makes the regulator of an axis at rest, without a slew limit.
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

    /// Returns the regulator with a limit on the change of its pulse width in a period. A current
    /// that rises slowly appears in the readings before it trips a stage.
    #[must_use]
    pub fn slowed(self, slew: f64) -> Self {
        Self { slew, ..self }
    }

    /// Returns by how much the pulse width may grow in one direction, negative above
    /// [`MOST_CURRENT`]. `current` is the motor's, positive if it flows in that direction (A).
    fn room(&self, current: f64) -> f64 {
        // ISA cards report no sign of the current, so it cannot limit one direction.
        if self.gains.trip_current.is_infinite() {
            return self.slew;
        }
        let left = MOST_CURRENT - current / self.gains.trip_current;
        (HEADROOM_GAIN * left).max(-MOST_BACK).min(self.slew)
    }

    /// Returns the pulse width for a period, from the wanted and the measured step (increments) and
    /// the current of the motor (A). Without a new reading the current is `None` and the pulse
    /// width stays: the stage may still apply an older width, and the next must not reverse it.
    pub fn step(&mut self, wanted: f64, measured: f64, current: Option<f64>) -> i16 {
        let RegulatorGains { a, b0, b1, ratio, k1, k2, .. } = self.gains;
        let error = wanted - measured;
        let sum = self.last_sum + k1 * error - k2 * self.last_error;
        // The remembered outputs are clamped, which keeps the incremental form from winding up.
        let output = (1.0 + a) * self.last_output - a * self.older_output
            + ratio * (b0 * sum - b1 * self.last_sum);
        // One NaN in the memory would make every later output NaN.
        if !output.is_finite() {
            self.reset();
            return 0;
        }
        // The current limits the growth in its own direction only: a strained motor may always
        // reduce its drive. A current that is not a number counts as no reading.
        let (down, up) = current
            .filter(|now| now.is_finite())
            .map_or((0.0, 0.0), |now| (self.room(-now), self.room(now)));
        // `clamp` would panic if a profile gives a negative slew or limit, and this is the
        // real-time thread.
        let slow = output.max(self.last_output - down).min(self.last_output + up);
        let output = slow.max(-self.limit).min(self.limit);
        self.older_output = self.last_output;
        self.last_output = output;
        self.last_sum = sum;
        self.last_error = error;
        // The cast truncates, as the original does; the memory keeps the fraction.
        output as i16
    }

    /// Returns the pulse width that the last step gave, as a share of 255.
    #[must_use]
    pub fn drive(&self) -> f64 {
        self.last_output / 255.0
    }

    /// Clears the memory, as for an axis at rest at its set value.
    pub fn reset(&mut self) {
        *self = Self::new(self.gains, self.limit).slowed(self.slew);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// A motor model that shares nothing with the plant: first order, 40 ms, 330 rad/s at 255, and
    /// Coulomb friction as the pulse width that overcomes it.
    struct Motor {
        position: f64,
        speed: f64,
        friction: f64,
    }

    impl Motor {
        /// Turns the motor for one period of 2 ms.
        fn turn(&mut self, pwm: f64) {
            self.turn_for(pwm, 4);
        }

        /// Turns the motor for a number of quarter periods (0.5 ms).
        fn turn_for(&mut self, pwm: f64, quarters: u32) {
            for _ in 0..quarters {
                let seconds = 0.0005;
                let drive = pwm * 330.0 / 255.0;
                let friction = self.friction * 330.0 / 255.0;
                let free = self.speed + (drive - self.speed) * seconds / 0.040;
                let brake = friction * seconds / 0.040;
                self.speed = if free.abs() <= brake { 0.0 } else { free - brake.copysign(free) };
                self.position += self.speed * seconds;
            }
        }

        /// Returns the current as a share of the trip current: 1.5 at full voltage and standstill.
        fn current(&self, pwm: f64) -> f64 {
            1.5 * (pwm / 255.0 - self.speed / 330.0)
        }
    }

    /// Largest pulse width.
    const LIMIT: f64 = 190.0;
    /// Largest change of the pulse width in a period.
    const SLEW: f64 = 25.0;

    /// Returns the built-in gains.
    fn gains() -> ServoGains {
        ServoGains::parse(IRP6).unwrap()
    }

    /// Lets a simulated axis follow the set value `set(time)` (rad) for `seconds`. Returns the
    /// largest error and the error at the end (rad).
    fn follow(
        gains: RegulatorGains,
        increments: f64,
        friction: f64,
        set: impl Fn(f64) -> f64,
        seconds: f64,
    ) -> (f64, f64) {
        let mut regulator = Regulator::new(gains, LIMIT).slowed(SLEW);
        let mut motor = Motor { position: 0.0, speed: 0.0, friction };
        let (mut last_set, mut last_count, mut worst) = (0.0, 0, 0.0f64);
        for period in 1..=(seconds / 0.002) as u32 {
            let wanted = set(f64::from(period) * 0.002) * increments / TAU;
            let count = (motor.position * increments / TAU).floor() as i64;
            let pwm = regulator.step(wanted - last_set, (count - last_count) as f64, Some(0.0));
            (last_set, last_count) = (wanted, count);
            motor.turn(f64::from(pwm));
            worst = worst.max((wanted * TAU / increments - motor.position).abs());
        }
        (worst, (last_set * TAU / increments - motor.position).abs())
    }

    #[test]
    fn every_axis_follows_a_ramp_and_stops() {
        let gains = gains();
        for (axis, increments) in
            [4000.0, 4000.0, 4000.0, 4000.0, 4000.0, 4000.0, 2000.0].into_iter().enumerate()
        {
            // Up to 100 rad/s in half a second, constant for half a second, then down again.
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
    fn clamped_output_reverses_without_windup() {
        let mut regulator = Regulator::new(gains().axes[1], LIMIT);
        for _ in 0..100 {
            assert!(regulator.step(400.0, 0.0, Some(0.0)) <= 190);
        }
        assert_eq!(regulator.step(400.0, 0.0, Some(0.0)), 190);

        let outputs: Vec<i16> = (0..30).map(|_| regulator.step(0.0, 1600.0, Some(0.0))).collect();

        assert!(outputs.contains(&-190), "{outputs:?}");
    }

    #[test]
    fn output_change_obeys_slew_limit() {
        let mut regulator = Regulator::new(gains().axes[1], LIMIT).slowed(SLEW);
        let wanted = |k: i32| if k % 40 < 20 { 400.0 } else { -400.0 };

        let outputs: Vec<i16> =
            (0..200).map(|k| regulator.step(wanted(k), 0.0, Some(0.0))).collect();

        let steps = outputs.windows(2).map(|w| (w[1] - w[0]).abs());
        assert_eq!(steps.max(), Some(25), "{outputs:?}");
        assert!(outputs.contains(&190) && outputs.contains(&-190));
    }

    /// Demands the reverse speed from a simulated motor at 200 rad/s for some periods of `ratio`
    /// times 2 ms. Returns its largest current, as a share of the trip current, and its last pulse
    /// width. The current that the regulator reads is `late` periods old; it limits the pulse width
    /// only if `limited`.
    fn reversed(limited: bool, periods: i32, late: usize, ratio: f64) -> (f64, i16) {
        let mut gains = gains().axes[0];
        if !limited {
            gains.trip_current = f64::INFINITY;
        }
        let length = Length::of_seconds(0.002 * ratio);
        let mut regulator = Regulator::new(gains.for_period(length), LIMIT).slowed(SLEW * ratio);
        let mut motor = Motor { position: 0.0, speed: 0.0, friction: 15.0 };
        let step = 200.0 * 0.002 * ratio * 4000.0 / TAU;
        let (mut last, mut currents, mut largest, mut pwm) = (0.0, vec![0.0; late + 1], 0.0f64, 0);
        let begins = (800.0 / ratio) as i32;
        for period in 0..2 * begins {
            let way = 1.0 - 0.99f64.powf(f64::from(period) * ratio);
            let back = (begins..begins + periods).contains(&period);
            let position = motor.position * 4000.0 / TAU;
            let read = 25.0 * currents[currents.len() - 1 - late];
            let asked = if back { -step } else { way * step };
            pwm = regulator.step(asked, position - last, Some(read));
            last = position;
            // The peak is here, before the motor follows the new width.
            largest = largest.max(motor.current(f64::from(pwm)).abs());
            motor.turn_for(f64::from(pwm), (4.0 * ratio) as u32);
            currents.push(motor.current(f64::from(pwm)));
        }
        (largest, pwm)
    }

    #[test]
    fn reversal_of_set_value_trips_no_power_stage() {
        for (ratio, latest) in [(0.5, 3), (1.0, 3), (2.0, 2), (4.0, 1)] {
            for late in 0..=latest {
                for periods in [1, 5, 10, 30, 100] {
                    let (largest, _) = reversed(true, periods, late, ratio);
                    assert!(largest < 0.95, "{ratio}: {periods} periods, {late} late: {largest}");
                }
            }
            let free = reversed(false, 30, 0, ratio).0;
            assert!(
                ratio > 2.0 || free > 1.0,
                "{ratio}: the case without the limit must trip: {free}"
            );
        }
        let (limited, free) = (reversed(true, 0, 1, 1.0), reversed(false, 0, 1, 1.0));
        assert_eq!(limited, free, "a normal motion is not limited");
    }

    #[test]
    fn pulse_width_stays_without_a_current_reading() {
        let mut regulator = Regulator::new(gains().axes[0], LIMIT).slowed(SLEW);
        let mut outputs = [0; 30];
        for (k, output) in outputs.iter_mut().enumerate() {
            let heard = !(10..20).contains(&k);
            *output = regulator.step(if k < 10 { 20.0 } else { -400.0 }, 0.0, heard.then_some(0.0));
        }
        assert!(
            outputs[9] > 50 && outputs[10..20].iter().all(|now| *now == outputs[9]),
            "{outputs:?}"
        );
        assert_eq!(outputs[20], outputs[9] - 25);
    }

    #[test]
    fn single_corrupt_current_reading_barely_changes_pulse_width() {
        let mut regulator = Regulator::new(gains().axes[0], LIMIT).slowed(SLEW);
        let outputs: Vec<i16> = (0..40)
            .map(|k| {
                let current = if k == 30 { -32.7 } else { 2.0 };
                regulator.step(20.0, 20.0 - f64::from(k) / 40.0, Some(current))
            })
            .collect();
        assert!(outputs.windows(2).all(|w| (w[1] - w[0]).abs() <= 5), "{outputs:?}");
    }

    #[test]
    fn nan_wanted_step_zeroes_output_and_resets_regulator() {
        let mut regulator = Regulator::new(gains().axes[1], LIMIT);
        regulator.step(5.0, 0.0, Some(0.0));

        let last = regulator.step(5.0, 0.0, Some(0.0));
        assert_eq!(
            regulator.step(5.0, 0.0, Some(f64::NAN)),
            last,
            "a current of NaN counts as no reading"
        );
        assert_eq!(regulator.step(f64::NAN, 0.0, Some(0.0)), 0);
        assert_eq!(regulator, Regulator::new(gains().axes[1], LIMIT));
    }
}
