//! The jaw: opening <-> motor, the set value's straight course, its regulator and its current limit.
//!
//! A jaw that presses on something never reaches its set value: the current limit then makes the grip force.

use super::io::{ArmDrive, ArmReading};
use super::period::Length;
use super::regulator::{Regulator, ServoGains};
use crate::cell::Gripper;
use crate::motion::{AXES, Depth, JawCommand, MoveRefused};
use std::f64::consts::TAU;

/// Speed of the set value that is still taken [rad/s of the motor]: the original's limit, 20 rad in 2 ms.
const FASTEST: f64 = 1e4;

/// The jaw of one gripper.
#[derive(Debug, Clone, PartialEq)]
pub struct Jaw {
    gripper: Gripper,
    regulator: Regulator,
    /// Opening at the start and at the end of the course [m], and its first and last period.
    from: f64,
    to: f64,
    begin: u64,
    end: u64,
    /// Set value and its motor position in increments.
    opening: f64,
    set_increments: f64,
    /// Set value's step of the present period [increments].
    step: f64,
    last_count: i64,
    grip: f64,
    stops: Depth,
}

impl Jaw {
    /// Stands where it is.
    #[must_use]
    pub fn new(gripper: Gripper, gains: &ServoGains, count: i64, period: Length) -> Self {
        let mut jaw = Self {
            gripper,
            regulator: Regulator::new(gains.jaw.for_period(period), gains.pwm_limit),
            from: 0.0,
            to: 0.0,
            begin: 0,
            end: 0,
            opening: 0.0,
            set_increments: count as f64,
            step: 0.0,
            last_count: count,
            grip: gains.idle_grip,
            stops: Depth::One,
        };
        jaw.opening = jaw.opening_at(count);
        jaw.hold();
        jaw
    }

    /// Distance between the pads at an encoder count [m].
    #[must_use]
    pub fn opening_at(&self, count: i64) -> f64 {
        let [c0, c1, c2] = self.gripper.opening_of_motor;
        let motor = count as f64 * TAU / self.gripper.increments;
        c0 + motor * (c1 + motor * c2) + self.gripper.opening_offset
    }

    /// Force that a motor current stands for [N].
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
        if !(low..=high).contains(&value) {
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
        (self.from, self.to, self.begin, self.end) = (self.opening, command.opening, begin, end);
        self.grip = command.force_limit.max(0.0);
        self.stops = command.stops;
    }

    /// Keeps the present set value.
    pub fn hold(&mut self) {
        (self.from, self.to, self.end) = (self.opening, self.opening, 0);
    }

    /// Turns the set value's motor by a step [rad]: homing, when the opening is not known.
    pub fn turn(&mut self, step: f64) {
        let increments = step * self.gripper.increments / TAU;
        self.step += increments;
        self.set_increments += increments;
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
        let increments = self.increments_of(self.opening);
        self.step += increments - self.set_increments;
        self.set_increments = increments;
    }

    /// Writes the jaw's part of the drives.
    pub fn drive(&mut self, reading: &ArmReading, drive: &mut ArmDrive) {
        let measured = reading.jaw_count - self.last_count;
        self.last_count = reading.jaw_count;
        drive.jaw_pwm = self.regulator.step(self.step, measured as f64);
        drive.jaw_current_limit = self.grip * self.gripper.amperes_per_newton;
        drive.stops = self.stops;
        self.step = 0.0;
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
        assert!((drive.jaw_current_limit - 0.12).abs() < 1e-15);
        assert!(drive.jaw_pwm > 0);
    }

    #[test]
    fn an_opening_beyond_the_stroke_is_refused() {
        let command = |opening| JawCommand { opening, force_limit: 30.0, stops: Depth::One };

        assert_eq!(jaw(0).check(&command(0.0571), 1.0), Ok(()));
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
