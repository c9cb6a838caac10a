//! The jaw: opening <-> motor, the set value's straight course, its regulator.
//!
//! A jaw that presses on something never reaches its set value: the pulse width then goes as far as the measured current
//! leaves to the wanted grip. The controller's own limit of the current stands above that and trips; it makes no grip.

use super::io::{ArmDrive, ArmReading};
use super::lateness::Interval;
use super::period::Length;
use super::regulator::{JawGains, ServoGains};
use crate::cell::Gripper;
use crate::motion::{AXES, ArmFault, Depth, JawCommand, MoveRefused};
use std::f64::consts::TAU;

/// Speed of the set value that is still taken [rad/s of the motor]: the original's limit, 20 rad in 2 ms.
const FASTEST: f64 = 1e4;

/// How far beyond the end of its stroke a jaw may be seen that stands there (m). A motion begins
/// where the jaw is seen, and leads it back.
const BEYOND: f64 = 1e-3;
/// How much faster than told a jaw may seem, and by how much time two readings may be further apart
/// (s).
const FASTER: f64 = 1.3;
const LATE: f64 = 0.002;
/// Pulse width under which any jaw opens, and how long its encoder may show nothing of it (s).
const OPENS: f64 = 60.0;
const FROZEN: f64 = 0.05;
/// An error that is left alone: friction would make it swing (rad of the motor).
const PLAY: f64 = 2.0;
/// Share of a period's speed in the smoothed one.
const SMOOTH: f64 = 0.5;

/// The jaw of one gripper.
#[derive(Debug, Clone, PartialEq)]
pub struct Jaw {
    gripper: Gripper,
    gains: JawGains,
    /// Largest pulse width, and its most change in a period.
    limit: f64,
    slew: f64,
    /// Length of a period (s).
    seconds: f64,
    /// Opening at the start and at the end of the course (m), and its first and last period.
    from: f64,
    to: f64,
    begin: u64,
    end: u64,
    /// Set value and its motor position in increments.
    opening: f64,
    set_increments: f64,
    last_count: i64,
    /// Periods since that was read or extrapolated.
    periods: u64,
    /// Time since it was read.
    interval: Interval,
    /// Measured speed, smoothed (rad/s of the motor).
    speed: f64,
    /// Periods in a row in which it should have opened and did not.
    still: u32,
    /// The share of the pulse width that holds against what lasts.
    held: f64,
    /// Pulse width of the last period.
    width: f64,
    grip: f64,
    stops: Depth,
}

impl Jaw {
    /// Stands where it is.
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

    /// Distance between the pads at an encoder count (m).
    #[must_use]
    pub fn opening_at(&self, count: i64) -> f64 {
        let [c0, c1, c2] = self.gripper.opening_of_motor;
        let motor = count as f64 * TAU / self.gripper.increments;
        c0 + motor * (c1 + motor * c2) + self.gripper.opening_offset
    }

    /// Set value of this period (m).
    #[must_use]
    pub fn set_value(&self) -> f64 {
        self.opening
    }

    /// Force that a motor current stands for (N).
    #[must_use]
    pub fn force_at(&self, amperes: f64) -> f64 {
        amperes / self.gripper.amperes_per_newton
    }

    /// Whether a command can be carried out in so many seconds.
    ///
    /// # Errors
    /// [`MoveRefused::JointLimit`] of axis 7 for an opening beyond the stroke; [`MoveRefused::TooFast`] for one too far
    /// away; [`MoveRefused::NotANumber`].
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

    /// Goes to the command's opening in periods `begin..=end`.
    pub fn start(&mut self, command: &JawCommand, begin: u64, end: u64) {
        let (low, high) = self.gripper.opening;
        let to = command.opening.max(low).min(high);
        (self.from, self.to, self.begin, self.end) = (self.opening, to, begin, end);
        self.grip = command.force_limit.max(0.0);
        self.stops = command.stops;
    }

    /// Keeps the present set value.
    pub fn hold(&mut self) {
        (self.from, self.to, self.end) = (self.opening, self.opening, 0);
    }

    /// Turns the set value's motor by a step (rad): homing, when the opening is not known.
    pub fn turn(&mut self, step: f64) {
        self.set_increments += step * self.gripper.increments / TAU;
    }

    /// Takes what is measured for the set value: the counter was set to zero, or begins to mean something.
    pub fn rebase(&mut self, count: i64) {
        self.last_count = count;
        self.set_increments = count as f64;
        self.opening = self.opening_at(count);
        self.hold();
    }

    /// Set value of period `period`.
    pub fn advance(&mut self, period: u64) {
        if period < self.begin || period > self.end {
            return;
        }
        let share = (period + 1 - self.begin) as f64 / (self.end + 1 - self.begin) as f64;
        self.opening = self.from + share * (self.to - self.from);
        self.set_increments = self.increments_of(self.opening);
    }

    /// So many periods were missed before the next reading.
    pub fn skipped(&mut self, missed: u64) {
        self.periods = self.periods.saturating_add(missed);
        self.interval.pass(missed as f64);
    }

    /// What the encoder shows that no jaw does; before [`Jaw::drive`] of the same period.
    pub fn watch(&mut self, reading: &ArmReading) -> Option<ArmFault> {
        self.interval.pass(1.0);
        if reading.extrapolated >> AXES & 1 == 1 {
            return None;
        }
        let radian = self.gripper.increments / TAU;
        let by = (reading.jaw_count - self.last_count) as f64 / radian;
        // A jaw that squeezes stands still under any width; one that opens has nothing to stand against.
        let still = by == 0.0 && self.width < -OPENS;
        self.still = if still { self.still + 1 } else { 0 };
        let within = |periods: f64| FASTER * FASTEST * (periods * self.seconds + LATE);
        let (possible, plain) = (within(self.interval.longest()), within(1.0));
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

    /// Pulse width of the wanted grip on something that stands still: what the jaws hold when the power comes on must not
    /// slip until the regulator has found out. Empty jaws give way to it by a tenth of a millimetre.
    fn at_rest(&self) -> f64 {
        3.0 * self.gains.current * self.grip * self.gripper.amperes_per_newton
    }

    /// The drive is off, whatever the jaw does.
    pub fn off(&mut self, reading: &ArmReading) {
        (self.last_count, self.periods) = (reading.jaw_count, 1);
        self.interval = Interval::default();
        (self.speed, self.still) = (0.0, 0);
        (self.width, self.held) = (self.at_rest(), self.at_rest());
    }

    /// Writes the jaw's part of the drives.
    pub fn drive(&mut self, reading: &ArmReading, drive: &mut ArmDrive) {
        drive.jaw_pwm = self.pulse_width(reading) as i16;
        drive.stops = self.stops;
    }

    fn pulse_width(&mut self, reading: &ArmReading) -> f64 {
        let radian = self.gripper.increments / TAU;
        let moved = (reading.jaw_count - self.last_count) as f64 / self.periods as f64;
        (self.last_count, self.periods) = (reading.jaw_count, 1);
        // An encoder that was read late shows a wrong speed for a period.
        self.speed += SMOOTH * (moved / radian / self.seconds - self.speed);
        let error = (self.set_increments - reading.jaw_count as f64) / radian;
        let held = self.held;
        if error.abs() > PLAY {
            self.held += self.gains.integral * error * self.seconds;
        }
        let wanted = self.gains.position * error + self.held - self.gains.speed * self.speed;
        let current = reading.currents[AXES];
        let allowed = self.grip * self.gripper.amperes_per_newton;
        // Answers have no checksum: one wrong current must not let go.
        let give = |amperes: f64| (self.gains.current * amperes).max(-self.slew).min(self.slew);
        let (down, up) = (give(allowed + current), give(allowed - current));
        let last = self.width;
        let gentle = wanted.max(last - down).min(last + up);
        // Never a panic here, whatever a profile or a reading says.
        let width = gentle.max(-self.limit).min(self.limit);
        // What is held back must not pile up: it would let go when the set value turns.
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

    /// Position of the palm's stops.
    #[must_use]
    pub fn stops(&self) -> Depth {
        self.stops
    }

    fn increments_of(&self, opening: f64) -> f64 {
        let [c0, c1, c2] = self.gripper.opening_of_motor;
        let rest = opening - self.gripper.opening_offset - c0;
        // The root that continues the straight part of the parabola; stays exact for c2 = 0.
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
    fn opening_and_motor_are_inverse_over_the_stroke() {
        let jaw = jaw(0);

        for step in 0..=38 {
            let opening = 0.053 + f64::from(step) * 0.001;
            let count = jaw.increments_of(opening);

            assert!((jaw.opening_at(count.round() as i64) - opening).abs() < 1e-6, "{opening}");
        }
        assert!(jaw.increments_of(0.060) > jaw.increments_of(0.080), "closing turns forwards");
    }

    #[test]
    fn the_course_is_straight_and_ends_where_it_should() {
        let mut jaw = jaw(0);
        let command = JawCommand { opening: 0.060, force_limit: 30.0, stops: Depth::Two };
        jaw.start(&command, 11, 20);
        let mut openings = Vec::new();

        for period in 10..=22 {
            jaw.advance(period);
            openings.push(jaw.opening);
        }

        assert_eq!(openings[0], 0.074);
        assert!((openings[1] - (0.074 - 0.0014)).abs() < 1e-15);
        assert_eq!(openings[10], 0.060);
        assert_eq!(openings[12], 0.060);
        let mut drive = ArmDrive::OFF;
        jaw.drive(&ArmReading::default(), &mut drive);
        assert_eq!(drive.stops, Depth::Two);
        assert!(drive.jaw_pwm > 0);
    }

    /// A jaw's motor: first order, with the current that a wall at an opening of 57 mm makes it draw.
    struct Motor {
        /// Angle (rad) and speed (rad/s).
        angle: f64,
        speed: f64,
        wall: f64,
        current: f64,
    }

    impl Motor {
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

    /// Closes from 70 mm to 55 mm on a wall at 57 mm in 1.2 s, and is told 56 mm at last; every so many readings come
    /// three periods late. Currents and pulse widths.
    fn gripped(late_every: u64) -> Vec<(f64, i16)> {
        let wall = jaw(0).increments_of(0.057) * TAU / 128.0;
        let mut jaw = jaw(jaw(0).increments_of(0.070) as i64);
        let angle = jaw.last_count as f64 * TAU / 128.0;
        let mut motor = Motor { angle, speed: 0.0, wall, current: 0.0 };
        let mut reading = ArmReading { jaw_count: jaw.last_count, ..ArmReading::default() };
        let told = |opening| JawCommand { opening, force_limit: 40.0, stops: Depth::One };
        let mut seen = Vec::new();
        for period in 1..1500 {
            match period {
                1 => jaw.start(&told(0.055), 1, 600),
                1000 => jaw.start(&told(0.056), 1000, 1010),
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
            if period == 1207 {
                reading.currents[AXES] = 36.0;
            }
        }
        seen
    }

    #[test]
    fn a_grip_is_the_current_that_it_stands_for_whatever_the_set_value_does_below_it() {
        for late_every in [0, 7, 50] {
            let seen = gripped(late_every);

            // 40 N, while the set value goes on, stands, and comes back.
            let off = |(current, _): &(f64, i16)| (current - 0.16).abs() > 0.008;
            let wrong = seen[640..1206].iter().chain(&seen[1230..]).find(|s| off(s));
            assert_eq!(wrong, None, "{late_every}");
            // Not even for a wrong current.
            assert!(seen[640..].iter().all(|(current, _)| *current > 0.09));
            // Above that the controller stops.
            let most = seen.iter().map(|(current, _)| *current).fold(0.0, f64::max);
            assert!(most < 0.2, "{late_every}: {most}");
        }
    }

    #[test]
    fn what_it_held_when_the_power_came_on_it_holds_on_to() {
        let mut jaw = jaw(0);
        // Pads of 300 kN/m that were squeezed by 30 N, at 1.45e-5 m a rad; their force in pulse widths.
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
        // Of 51, and at last the idle grip of 20 N.
        assert!(least > 20.0, "{least}");
        assert!((pads(angle) - 34.0).abs() < 3.0, "{}", pads(angle));
    }

    #[test]
    fn an_encoder_that_jumps_or_shows_nothing_of_the_jaw_is_a_fault() {
        let mut jaw = jaw(0);
        let shows = |jaw_count| ArmReading { jaw_count, ..ArmReading::default() };
        assert_eq!(jaw.watch(&shows(1000)), None, "0.7 mm late");
        assert!(matches!(jaw.watch(&shows(1200)), Some(ArmFault::EncoderJump { axis: 7, .. })));
        jaw.skipped(1);
        assert_eq!(jaw.watch(&shows(1200)), None, "in two periods it may be so");

        jaw.start(&JawCommand { opening: 0.085, force_limit: 40.0, stops: Depth::One }, 1, 100);
        let found = (1..200).find_map(|period| {
            jaw.advance(period);
            let fault = jaw.watch(&shows(0));
            let mut drive = ArmDrive::OFF;
            jaw.drive(&shows(0), &mut drive);
            fault
        });
        assert!(matches!(found, Some(ArmFault::EncoderFrozen { axis: 7, .. })), "{found:?}");
    }

    #[test]
    fn an_opening_beyond_the_stroke_is_refused() {
        let command = |opening| JawCommand { opening, force_limit: 30.0, stops: Depth::One };

        assert_eq!(jaw(0).check(&command(0.0571), 1.0), Ok(()));
        assert_eq!(jaw(0).check(&command(0.0527), 1.0), Ok(()), "as it is seen at its end");
        let mut led = jaw(0);
        led.start(&command(0.0527), 1, 100);
        assert_eq!(led.to, 0.053);
        assert!(matches!(
            jaw(0).check(&command(0.050), 1.0),
            Err(MoveRefused::JointLimit { axis: 7, value: 0.050, .. })
        ));
        assert_eq!(jaw(0).check(&command(f64::NAN), 1.0), Err(MoveRefused::NotANumber));
    }

    #[test]
    fn a_jaw_is_not_told_to_jump() {
        let command = |opening| JawCommand { opening, force_limit: 30.0, stops: Depth::One };
        let way = (jaw(0).increments_of(0.060) * TAU / 128.0).abs();

        assert_eq!(jaw(0).check(&command(0.060), way / 9_900.0), Ok(()));
        assert!(matches!(
            jaw(0).check(&command(0.060), way / 10_100.0),
            Err(MoveRefused::TooFast { axis: 7, .. })
        ));
    }
}
