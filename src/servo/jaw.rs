//! The jaw: opening <-> motor, the set value's straight course, its regulator and its current limit.
//!
//! A jaw that presses on something never reaches its set value: the current limit then makes the grip force.

use super::io::{ArmDrive, ArmReading};
use super::regulator::{Regulator, ServoGains};
use crate::cell::Gripper;
use crate::motion::{AXES, Depth, JawCommand, MoveRefused};
use std::f64::consts::TAU;

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
    pub fn new(gripper: Gripper, gains: &ServoGains, count: i64) -> Self {
        let mut jaw = Self {
            gripper,
            regulator: Regulator::new(gains.jaw, gains.pwm_limit),
            from: 0.0,
            to: 0.0,
            begin: 0,
            end: 0,
            opening: 0.0,
            set_increments: 0.0,
            step: 0.0,
            last_count: count,
            grip: gains.idle_grip,
            stops: Depth::One,
        };
        jaw.reset(count);
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

    /// Whether a command can be carried out.
    ///
    /// # Errors
    /// [`MoveRefused::JointLimit`] of axis 7 for an opening beyond the stroke; [`MoveRefused::NotANumber`].
    pub fn check(&self, command: &JawCommand) -> Result<(), MoveRefused> {
        let (low, high) = self.gripper.opening;
        let value = command.opening;
        if !(value.is_finite() && command.force_limit.is_finite()) {
            return Err(MoveRefused::NotANumber);
        }
        if !(low..=high).contains(&value) {
            return Err(MoveRefused::JointLimit { axis: AXES, value, low, high });
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

    /// Takes what is measured as set value.
    pub fn reset(&mut self, count: i64) {
        self.opening = self.opening_at(count);
        self.set_increments = count as f64;
        self.last_count = count;
        self.step = 0.0;
        self.regulator.reset();
        self.hold();
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
