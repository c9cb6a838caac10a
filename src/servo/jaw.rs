//! The jaw of a gripper: its opening and motor, its linear set value, its regulator and watchdog.
//!
//! A jaw that presses on an object never reaches its set value. The pulse width then grows only as
//! far as the measured current leaves room to the wanted grip. The controller's own current limit
//! is above that and trips the drive, so it cannot set a grip.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | opening outside the stroke | `BEYOND` | a jaw at the end of its stroke may read so |
//! | fast set value | `FASTEST` | limit of the original: refused before the motion |
//! | encoder jump | `FASTER`, `LATE` | no jaw makes this step between two readings |
//! | frozen encoder | `OPENING_WIDTH` for `FROZEN` | an opening jaw has nothing to press against |
//! | small position error | `DEAD_BAND` | friction would make the jaw swing about it |
//! | wrong current | [`JawGains::slew`] | one wrong reading must not release the grip |

use super::io::{ArmDrive, ArmReading};
use super::lateness::Interval;
use super::period::Length;
use super::regulator::{JawGains, ServoGains};
use crate::cell::Gripper;
use crate::motion::{AXES, ArmFault, Depth, JawCommand, MoveRefused};
use std::f64::consts::TAU;

/// Largest speed of the set value (rad/s of the motor): the limit of the original, 20 rad in 2 ms.
const FASTEST: f64 = 1e4;

/// Distance outside its stroke that a jaw at the end of it may show (m). A motion begins at the
/// reading and leads the jaw back.
const BEYOND: f64 = 1e-3;
/// Factor of [`FASTEST`] that a jaw may seem to reach, and the time by which two readings may be
/// further apart than they seem (s).
const FASTER: f64 = 1.3;
const LATE: f64 = 0.002;
/// Pulse width with which any jaw opens, and the longest time without a step of its encoder (s).
const OPENING_WIDTH: f64 = 60.0;
const FROZEN: f64 = 0.05;
/// Position error that the integral ignores, because friction would make the jaw swing about it
/// (rad of the motor).
const DEAD_BAND: f64 = 2.0;
/// Weight of the speed in the present period in the smoothed speed; the rest is the smoothed speed
/// before.
const SMOOTHING: f64 = 0.5;

/// Jaw of one gripper.
#[derive(Debug, Clone, PartialEq)]
pub struct Jaw {
    gripper: Gripper,
    gains: JawGains,
    /// Largest pulse width, and its largest change in a period.
    limit: f64,
    slew: f64,
    /// Length of a period (s).
    seconds: f64,
    /// Opening at the start and at the end of the motion (m), and its first and last period.
    from: f64,
    to: f64,
    begin: u64,
    end: u64,
    /// Set value (m) and its motor position (increments).
    opening: f64,
    set_increments: f64,
    last_count: i64,
    /// Periods since the last count, read or extrapolated.
    periods: u64,
    /// Time since the last count that was read.
    interval: Interval,
    /// Measured speed, smoothed (rad/s of the motor).
    speed: f64,
    /// Periods in a row in which the jaw should have opened and did not.
    still: u32,
    /// Integral part of the pulse width, which holds against a lasting force.
    held: f64,
    /// Pulse width of the last period.
    width: f64,
    grip: f64,
    stops: Depth,
}

impl Jaw {
    /// Makes a jaw at rest whose encoder shows `count`.
    #[must_use]
    pub fn new(gripper: Gripper, gains: &ServoGains, count: i64, period: Length) -> Self {
        let mut jaw = Self {
            gripper,
            gains: gains.jaw,
            limit: gains.pwm_limit,
            slew: gains.jaw.slew * period.ratio(),
            seconds: period.seconds(),
            from: 0.0,
            to: 0.0,
            begin: 0,
            end: 0,
            opening: 0.0,
            set_increments: count as f64,
            last_count: count,
            periods: 1,
            interval: Interval::default(),
            speed: 0.0,
            still: 0,
            held: 0.0,
            width: 0.0,
            grip: gains.idle_grip,
            stops: Depth::One,
        };
        jaw.opening = jaw.opening_at(count);
        jaw.hold();
        (jaw.width, jaw.held) = (jaw.at_rest(), jaw.at_rest());
        jaw
    }

    /// Returns the distance between the pads at an encoder count (m).
    #[must_use]
    pub fn opening_at(&self, count: i64) -> f64 {
        let [c0, c1, c2] = self.gripper.opening_of_motor;
        let motor = count as f64 * TAU / self.gripper.increments;
        c0 + motor * (c1 + motor * c2) + self.gripper.opening_offset
    }

    /// Returns the set value of this period, a distance between the pads (m).
    #[must_use]
    pub fn set_value(&self) -> f64 {
        self.opening
    }

    /// Returns the grip force that a current of the jaw's motor causes (N).
    #[must_use]
    pub fn force_at(&self, amperes: f64) -> f64 {
        amperes / self.gripper.amperes_per_newton
    }

    /// Checks whether the jaw can carry out a command within `seconds`.
    ///
    /// # Errors
    /// [`MoveRefused::JointLimit`] of axis 7 for an opening outside the stroke;
    /// [`MoveRefused::TooFast`] for an opening too far away; [`MoveRefused::NotANumber`].
    pub fn check(&self, command: &JawCommand, seconds: f64) -> Result<(), MoveRefused> {
        let (low, high) = self.gripper.opening;
        let value = command.opening;
        if !(value.is_finite() && command.force_limit.is_finite()) {
            return Err(MoveRefused::NotANumber);
        }
        if !(low - BEYOND..=high + BEYOND).contains(&value) {
            return Err(MoveRefused::JointLimit { axis: AXES, value, low, high });
        }
        let increments = (self.increments_of(value) - self.set_increments).abs();
        let rate = increments * TAU / self.gripper.increments / seconds;
        if rate > FASTEST {
            return Err(MoveRefused::TooFast { axis: AXES, rate, limit: FASTEST });
        }
        Ok(())
    }

    /// Starts the motion to the opening of the command in the periods `begin..=end`.
    pub fn start(&mut self, command: &JawCommand, begin: u64, end: u64) {
        let (low, high) = self.gripper.opening;
        // A command may be `BEYOND` outside the stroke; the jaw then moves to its end.
        let to = command.opening.max(low).min(high);
        (self.from, self.to, self.begin, self.end) = (self.opening, to, begin, end);
        self.grip = command.force_limit.max(0.0);
        self.stops = command.stops;
    }

    /// Ends the motion of the jaw: the present set value stays.
    pub fn hold(&mut self) {
        (self.from, self.to, self.end) = (self.opening, self.opening, 0);
    }

    /// Advances the set position of the motor by a step (rad), for homing: the opening is not known
    /// yet.
    pub fn turn(&mut self, step: f64) {
        self.set_increments += step * self.gripper.increments / TAU;
    }

    /// Makes the measured position the set value, because the counter was set to zero or the arm is
    /// now synchronised.
    pub fn rebase(&mut self, count: i64) {
        self.last_count = count;
        self.set_increments = count as f64;
        self.opening = self.opening_at(count);
        self.hold();
    }

    /// Advances the set value to that of `period`. Outside the periods of the motion it stays.
    pub fn advance(&mut self, period: u64) {
        if period < self.begin || period > self.end {
            return;
        }
        let share = (period + 1 - self.begin) as f64 / (self.end + 1 - self.begin) as f64;
        self.opening = self.from + share * (self.to - self.from);
        self.set_increments = self.increments_of(self.opening);
    }

    /// Registers that the servo missed a number of periods before the next reading.
    pub fn add_missed_periods(&mut self, missed: u64) {
        self.periods = self.periods.saturating_add(missed);
        self.interval.pass(missed as f64);
    }

    /// Returns a fault if the encoder shows a jump that no jaw makes, or stands still while the jaw
    /// is driven to open. The call comes before [`Jaw::drive`] of the same period.
    pub fn watch(&mut self, reading: &ArmReading) -> Option<ArmFault> {
        self.interval.pass(1.0);
        // An extrapolated count is an estimate and says nothing about the encoder.
        if reading.extrapolated >> AXES & 1 == 1 {
            return None;
        }
        let radian = self.gripper.increments / TAU;
        let by = (reading.jaw_count - self.last_count) as f64 / radian;
        // A jaw that squeezes an object is at rest under any width, so only an opening jaw counts.
        let still = by == 0.0 && self.width < -OPENING_WIDTH;
        self.still = if still { self.still + 1 } else { 0 };
        let within = |periods: f64| FASTER * FASTEST * (periods * self.seconds + LATE);
        let (possible, plain) = (within(self.interval.longest()), within(1.0));
        // A step too large for one period is the one that a gap hid.
        self.interval.read(by.abs() > plain);
        if by.abs() > possible {
            Some(ArmFault::EncoderJump { axis: AXES, by })
        } else if f64::from(self.still) * self.seconds > FROZEN {
            let wanted = (self.set_increments - reading.jaw_count as f64) / radian;
            Some(ArmFault::EncoderFrozen { axis: AXES, wanted })
        } else {
            None
        }
    }

    /// Returns the pulse width at which the motor, at rest on an object, exerts the wanted grip
    /// force. The regulator starts from this width at power-on, so that an object in the jaws does
    /// not slip until the regulator has found its grip. At this width empty jaws move by a tenth of
    /// a millimetre.
    fn at_rest(&self) -> f64 {
        // The gain is a third of the motor's pulse width per ampere at standstill.
        3.0 * self.gains.current * self.grip * self.gripper.amperes_per_newton
    }

    /// Resets the regulator while the drive is off, so that it is ready for power-on.
    pub fn off(&mut self, reading: &ArmReading) {
        (self.last_count, self.periods) = (reading.jaw_count, 1);
        self.interval = Interval::default();
        (self.speed, self.still) = (0.0, 0);
        (self.width, self.held) = (self.at_rest(), self.at_rest());
    }

    /// Writes the pulse width of the jaw's motor and the position of the palm's stops into the
    /// drive commands.
    pub fn drive(&mut self, reading: &ArmReading, drive: &mut ArmDrive) {
        drive.jaw_pwm = self.pulse_width(reading) as i16;
        drive.stops = self.stops;
    }

    /// Returns the pulse width of the jaw's motor for this period.
    fn pulse_width(&mut self, reading: &ArmReading) -> f64 {
        let radian = self.gripper.increments / TAU;
        let moved = (reading.jaw_count - self.last_count) as f64 / self.periods as f64;
        (self.last_count, self.periods) = (reading.jaw_count, 1);
        // An encoder that was read late shows a wrong speed for a period, so the speed is smoothed.
        self.speed += SMOOTHING * (moved / radian / self.seconds - self.speed);
        let error = (self.set_increments - reading.jaw_count as f64) / radian;
        let held = self.held;
        if error.abs() > DEAD_BAND {
            self.held += self.gains.integral * error * self.seconds;
        }
        let wanted = self.gains.position * error + self.held - self.gains.speed * self.speed;
        let current = reading.currents[AXES];
        let allowed = self.grip * self.gripper.amperes_per_newton;
        // The width may change in each direction by the distance of the current to the wanted grip.
        // Readings have no checksum, and the slew keeps one wrong current from releasing the grip.
        let give = |amperes: f64| (self.gains.current * amperes).max(-self.slew).min(self.slew);
        let (down, up) = (give(allowed + current), give(allowed - current));
        let last = self.width;
        let gentle = wanted.max(last - down).min(last + up);
        // `clamp` would panic if a wrong profile gives bounds that are negative or NaN.
        let width = gentle.max(-self.limit).min(self.limit);
        // The integral must not grow under a limit: it would release the grip when the set value
        // turns back.
        if width != wanted {
            self.held = held;
        }
        if !(width.is_finite() && self.held.is_finite()) {
            (self.width, self.held) = (0.0, 0.0);
            return 0.0;
        }
        self.width = width;
        width
    }

    /// Returns the position of the palm's two-position stops.
    #[must_use]
    pub fn stops(&self) -> Depth {
        self.stops
    }

    /// Returns the motor position of an opening (increments), the inverse of [`Jaw::opening_at`].
    fn increments_of(&self, opening: f64) -> f64 {
        let [c0, c1, c2] = self.gripper.opening_of_motor;
        let rest = opening - self.gripper.opening_offset - c0;
        // The parabola has two roots; this one continues its linear part and is exact for c2 = 0.
        let root = (c1 * c1 + 4.0 * c2 * rest).max(0.0).sqrt();
        let motor = 2.0 * rest / (c1 + root.copysign(c1));
        motor * self.gripper.increments / TAU
    }
}

#[cfg(test)]
mod tests {
    use super::super::regulator::IRP6;
    use super::*;
    use crate::motion::PERIOD;

    /// Returns a jaw at rest with the built-in gains whose encoder, of 128 increments per
    /// revolution, shows `count`.
    fn jaw(count: i64) -> Jaw {
        let gripper = Gripper {
            finger_width: 0.02,
            finger_thickness: 0.01,
            finger_tip: 0.01,
            palm: 0.04,
            palm_half_width: 0.03,
            opening: (0.053, 0.091),
            opening_of_motor: [0.074, -1.451910074e-5, -2.8313e-9],
            opening_offset: 0.0,
            increments: 128.0,
            amperes_per_newton: 0.004,
        };
        Jaw::new(gripper, &ServoGains::parse(IRP6).unwrap(), count, Length::default())
    }

    #[test]
    fn jaw_opening_and_motor_position_convert_both_ways() {
        let jaw = jaw(0);

        for step in 0..=38 {
            let opening = 0.053 + f64::from(step) * 0.001;
            let count = jaw.increments_of(opening);

            assert!((jaw.opening_at(count.round() as i64) - opening).abs() < 1e-6, "{opening}");
        }
        assert!(jaw.increments_of(0.060) > jaw.increments_of(0.080), "closing turns forwards");
    }

    #[test]
    fn jaw_set_value_moves_linearly_to_its_goal() {
        let mut jaw = jaw(0);
        let command = JawCommand { opening: 0.060, force_limit: 30.0, stops: Depth::Two };
        jaw.start(&command, 11, 20);
        let mut openings = Vec::new();

        for period in 10..=22 {
            jaw.advance(period);
            openings.push(jaw.opening);
        }

        assert_eq!(openings[0], 0.074);
        // 14 mm in 10 periods.
        assert!((openings[1] - (0.074 - 0.0014)).abs() < 1e-15);
        assert_eq!(openings[10], 0.060);
        assert_eq!(openings[12], 0.060);
        let mut drive = ArmDrive::OFF;
        jaw.drive(&ArmReading::default(), &mut drive);
        assert_eq!(drive.stops, Depth::Two);
        assert!(drive.jaw_pwm > 0);
    }

    /// Motor of a jaw: first order, with the current that it draws at a wall.
    struct Motor {
        /// Angle (rad), speed (rad/s), angle of the wall (rad), current (A).
        angle: f64,
        speed: f64,
        wall: f64,
        current: f64,
    }

    impl Motor {
        /// Moves the motor for one period of 2 ms with the pulse width `width`.
        fn step(&mut self, width: i16) {
            let force = f64::from(width) / 255.0;
            self.speed += (1e4 * force - self.speed) * PERIOD / 0.04;
            self.angle += self.speed * PERIOD;
            self.current = 0.6 * (force - self.speed / 1e4);
            if self.angle > self.wall {
                (self.angle, self.speed, self.current) = (self.wall, 0.0, 0.6 * force);
            }
        }
    }

    /// Simulates a jaw that closes from 70 mm to 55 mm on a wall at 57 mm in 1.2 s, and whose set
    /// value then moves to 56 mm. Three of every `late_every` readings are missing, none if it is
    /// 0. Returns the current (A) and the pulse width of each period.
    fn gripped(late_every: u64) -> Vec<(f64, i16)> {
        let wall = jaw(0).increments_of(0.057) * TAU / 128.0;
        let mut jaw = jaw(jaw(0).increments_of(0.070) as i64);
        let angle = jaw.last_count as f64 * TAU / 128.0;
        let mut motor = Motor { angle, speed: 0.0, wall, current: 0.0 };
        let mut reading = ArmReading { jaw_count: jaw.last_count, ..ArmReading::default() };
        let command = |opening| JawCommand { opening, force_limit: 40.0, stops: Depth::One };
        let mut seen = Vec::new();
        for period in 1..1500 {
            match period {
                1 => jaw.start(&command(0.055), 1, 600),
                1000 => jaw.start(&command(0.056), 1000, 1010),
                _ => {}
            }
            let mut drive = ArmDrive::OFF;
            jaw.advance(period);
            jaw.drive(&reading, &mut drive);
            motor.step(drive.jaw_pwm);
            seen.push((motor.current, drive.jaw_pwm));
            if late_every == 0 || period % late_every >= 3 {
                reading.jaw_count = (motor.angle * 128.0 / TAU) as i64;
                reading.currents[AXES] = motor.current;
            }
            // This current is wrong.
            if period == 1207 {
                reading.currents[AXES] = 36.0;
            }
        }
        seen
    }

    /// The jaw's motor has the current of the wanted grip force whenever the set value is narrower
    /// than the object.
    #[test]
    fn grip_current_does_not_depend_on_set_value() {
        for late_every in [0, 7, 50] {
            let seen = gripped(late_every);

            // 40 N at 0.004 A/N, while the set value moves on, rests, and comes back.
            let off = |(current, _): &(f64, i16)| (current - 0.16).abs() > 0.008;
            let wrong = seen[640..1206].iter().chain(&seen[1230..]).find(|s| off(s));
            assert_eq!(wrong, None, "{late_every}");
            // Even a wrong current does not release the grip.
            assert!(seen[640..].iter().all(|(current, _)| *current > 0.09));
            // The controller trips above this current.
            let most = seen.iter().map(|(current, _)| *current).fold(0.0, f64::max);
            assert!(most < 0.2, "{late_every}: {most}");
        }
    }

    /// Jaws that hold an object at power-on do not drop it.
    #[test]
    fn jaw_keeps_its_object_at_power_on() {
        let mut jaw = jaw(0);
        // Pads of 300 kN/m, squeezed by 30 N, at 1.45e-5 m per rad; their force as a pulse width.
        let pads = |angle: f64| 51.0 + 3e5 * 1.45e-5 * angle * 255.0 / 150.0;
        let (mut angle, mut speed, mut least) = (0.0, 0.0, f64::INFINITY);
        for _ in 0..1000 {
            let current = 0.6 * f64::from(jaw.width as i16) / 255.0;
            let mut reading =
                ArmReading { jaw_count: (angle * 128.0 / TAU) as i64, ..ArmReading::default() };
            reading.currents[AXES] = current;
            let mut drive = ArmDrive::OFF;
            jaw.drive(&reading, &mut drive);
            // Forwards is closing: the pads push backwards.
            let push = f64::from(drive.jaw_pwm) - pads(angle);
            speed += (1e4 * push / 255.0 - speed) * PERIOD / 0.04;
            angle += speed * PERIOD;
            least = f64::min(least, pads(angle));
        }
        // The force begins at a pulse width of 51 and ends at the idle grip of 20 N, which is 34.
        assert!(least > 20.0, "{least}");
        assert!((pads(angle) - 34.0).abs() < 3.0, "{}", pads(angle));
    }

    #[test]
    fn jaw_watchdog_detects_encoder_jump() {
        let mut jaw = jaw(0);
        let shows = |jaw_count| ArmReading { jaw_count, ..ArmReading::default() };
        assert_eq!(jaw.watch(&shows(1000)), None, "0.7 mm late");
        assert!(matches!(jaw.watch(&shows(1200)), Some(ArmFault::EncoderJump { axis: 7, .. })));
        jaw.add_missed_periods(1);
        assert_eq!(jaw.watch(&shows(1200)), None, "plausible after two periods");
    }

    /// Returns the fault of a jaw whose counter stands still while it moves to `opening` (m), and
    /// the number of periods for which its pulse width was below -60 by then.
    fn with_still_counter(opening: f64) -> Option<(ArmFault, u32)> {
        let (mut jaw, mut opens) = (jaw(0), 0);
        jaw.start(&JawCommand { opening, force_limit: 40.0, stops: Depth::One }, 1, 100);
        (1..500).find_map(|period| {
            jaw.advance(period);
            let fault = jaw.watch(&ArmReading::default());
            let mut drive = ArmDrive::OFF;
            jaw.drive(&ArmReading::default(), &mut drive);
            opens += u32::from(drive.jaw_pwm <= -60);
            fault.map(|fault| (fault, opens - 1))
        })
    }

    /// A jaw that closes may rest on an object.
    #[test]
    fn only_opening_jaw_can_have_frozen_encoder() {
        let found = with_still_counter(0.085);

        // 0.05 s are 25 periods.
        let Some((ArmFault::EncoderFrozen { axis: 7, .. }, periods)) = found else {
            panic!("{found:?}")
        };
        assert!((25..=27).contains(&periods), "{periods}");
        assert_eq!(with_still_counter(0.055), None);
    }

    #[test]
    fn jaw_opening_beyond_the_stroke_is_refused() {
        let command = |opening| JawCommand { opening, force_limit: 30.0, stops: Depth::One };

        assert_eq!(jaw(0).check(&command(0.0571), 1.0), Ok(()));
        for (beside, end) in [(0.0521, 0.053), (0.0919, 0.091)] {
            assert_eq!(jaw(0).check(&command(beside), 1.0), Ok(()));
            let mut led = jaw(0);
            led.start(&command(beside), 1, 100);
            assert_eq!(led.to, end);
        }
        for value in [0.0519, 0.0921] {
            let beyond = MoveRefused::JointLimit { axis: 7, value, low: 0.053, high: 0.091 };
            assert_eq!(jaw(0).check(&command(value), 1.0), Err(beyond));
        }
        assert_eq!(jaw(0).check(&command(f64::NAN), 1.0), Err(MoveRefused::NotANumber));
        let forceless = JawCommand { force_limit: f64::NAN, ..command(0.06) };
        assert_eq!(jaw(0).check(&forceless, 1.0), Err(MoveRefused::NotANumber));
    }

    #[test]
    fn too_fast_jaw_command_is_refused() {
        let command = |opening| JawCommand { opening, force_limit: 30.0, stops: Depth::One };
        // The limit is 10 000 rad/s.
        let way = (jaw(0).increments_of(0.060) * TAU / 128.0).abs();

        assert_eq!(jaw(0).check(&command(0.060), way / 9_900.0), Ok(()));
        assert!(matches!(
            jaw(0).check(&command(0.060), way / 10_100.0),
            Err(MoveRefused::TooFast { axis: 7, .. })
        ));
    }
}
