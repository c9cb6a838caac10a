//! Jaw of a gripper: a small motor behind a fine screw, which moves both pads together or apart.
//!
//! - in: pulse width, force with which the cube pushes each pad
//! - out: distance between the pads, encoder, current
//! - a clutch slips at the greatest grip; the controller reports a current that is above its limit
//!   for too long

use super::config::Jaws;
use super::encoder::{Encoder, Report};
use super::plausible::Wrong;
use crate::cell::Gripper;
use crate::servo::io::ArmDrive;

/// Opening speed below which a jaw yields but does not open (m/s).
const OPENS: f64 = 1e-3;
/// Time for which a current may be above its limit (s).
const TRIPS: f64 = 0.1;
/// Speed over which the jaw's friction builds up (m/s).
const CREEP: f64 = 1e-4;

/// Greatest distance beyond its stroke at which a saved jaw is accepted (m).
const BEYOND: f64 = 5e-3;

/// State and constants of a jaw.
#[derive(Debug, Clone)]
pub(super) struct PlantJaw {
    gripper: Gripper,
    jaws: Jaws,
    /// Angle of the motor (rad).
    motor: f64,
    /// Speed of the opening (m/s).
    speed: f64,
    /// Force of the drive on the opening, positive opens (N).
    force: f64,
    /// Time for which the current has been above its limit (s).
    above: f64,
    encoder: Encoder,
}

impl PlantJaw {
    /// Makes a jaw at rest whose pads are truly `opening` (m) apart. With `synchronised` its
    /// counter is homed already.
    pub(super) fn new(gripper: &Gripper, jaws: &Jaws, opening: f64, synchronised: bool) -> Self {
        let [c0, c1, c2] = gripper.opening_of_motor;
        let wanted = opening - gripper.opening_offset;
        // Newton on a nearly straight line: exact after a few rounds.
        let mut motor = (wanted - c0) / c1;
        for _ in 0..8 {
            motor -= (c0 + motor * (c1 + c2 * motor) - wanted) / (c1 + 2.0 * c2 * motor);
        }
        let encoder = Encoder::new(gripper.increments, motor, synchronised);
        Self { gripper: *gripper, jaws: *jaws, motor, speed: 0.0, force: 0.0, above: 0.0, encoder }
    }

    /// Returns the true distance between the pads (m).
    pub(super) fn opening(&self) -> f64 {
        let [c0, c1, c2] = self.gripper.opening_of_motor;
        c0 + self.motor * (c1 + c2 * self.motor) + self.gripper.opening_offset
    }

    /// Performs one substep of `dt` seconds; `push` is the mean force of the cube on the pads (N),
    /// `stiffness` its slope over the opening (N/m).
    pub(super) fn step(&mut self, drive: &ArmDrive, push: f64, stiffness: f64, dt: f64) {
        if !drive.enabled {
            // Assumption: the fine screw locks itself, so a jaw without power keeps its grip.
            (self.speed, self.force, self.above) = (0.0, 0.0, 0.0);
            return;
        }
        let [_, c1, c2] = self.gripper.opening_of_motor;
        // The step counts in the opening: the screw's slope (m/rad) takes motor speeds there.
        let slope = c1 + 2.0 * c2 * self.motor;
        let j = &self.jaws;
        let u = f64::from(drive.jaw_pwm.clamp(-255, 255)) / 255.0;
        // A positive pulse width turns the motor forwards, which closes: the slope is negative.
        let back_emf = j.stall_force / (j.no_load_speed * slope.abs());
        let limit = j.greatest_grip;
        let free = j.stall_force * u * slope.signum() - back_emf * self.speed;
        // Coulomb friction as a damper that weakens with speed, and the contact's spring: both
        // count at the end of the step.
        let friction = j.coulomb / (self.speed.abs() + CREEP);
        let base = j.mass + dt * friction + dt * dt * stiffness;
        let momentum = j.mass * self.speed + dt * push;
        let implicit =
            (momentum + dt * j.stall_force * u * slope.signum()) / (base + dt * back_emf);
        let force = j.stall_force * u * slope.signum() - back_emf * implicit;
        // The clutch slips where the force exceeds its limit now or at the end of the step. Its
        // force is then constant, without back-EMF.
        self.force = if free.abs() <= limit && force.abs() <= limit {
            self.speed = implicit;
            force
        } else {
            let force = free.clamp(-limit, limit);
            self.speed = (momentum + dt * force) / base;
            force
        };
        let trips = self.current().abs() > self.jaws.trip_current;
        self.above = if trips { self.above + dt } else { 0.0 };
        self.motor += dt * self.speed / slope;
        let (low, high) = self.gripper.opening;
        let offset = self.gripper.opening_offset;
        let opening = self.opening();
        // The stops are 1 mm beyond the stroke, and take up all momentum.
        let stopped = opening.clamp(low + offset - 1e-3, high + offset + 1e-3);
        if stopped != opening {
            self.motor += (stopped - opening) / slope;
            self.speed = 0.0;
        }
    }

    /// Checks whether the motor is opening the jaw. The pads then let go of the cube, and a motion
    /// between them does not count as slip.
    pub(super) fn opens(&self) -> bool {
        self.speed > OPENS && self.force > 0.0
    }

    /// Returns what the controller reports of the jaw's encoder and switch; called once a period.
    pub(super) fn read(&mut self, synchronise: bool) -> Report {
        self.encoder.read(self.motor, synchronise)
    }

    /// Returns the angle of the motor (rad) and the encoder, for the plant's file.
    pub(super) fn saved(&self) -> (f64, Encoder) {
        (self.motor, self.encoder.clone())
    }

    /// Checks that a jaw can be in the saved state: between its stops, with an encoder that fits
    /// its motor. The error names the wrong entry and the reason.
    pub(super) fn check_saved(&self, (motor, encoder): &(f64, Encoder)) -> Result<(), Wrong> {
        let there = Self { motor: *motor, ..self.clone() };
        let [_, c1, c2] = self.gripper.opening_of_motor;
        let (low, high) = self.gripper.opening;
        let opening = there.opening() - self.gripper.opening_offset;
        // A wider cube may have forced the jaw beyond its stop. The second branch of the parabola
        // is not part of the screw.
        let between = opening > low - BEYOND && opening < high + BEYOND;
        if !between || (c1 + 2.0 * c2 * motor) * c1 <= 0.0 {
            return Err(("[0]".to_owned(), "beyond the jaws' stops".to_owned()));
        }
        if !encoder.fits(&self.encoder, *motor) {
            return Err(("[1]".to_owned(), "not this motor's encoder".to_owned()));
        }
        Ok(())
    }

    /// Sets the jaw to a saved state, at rest.
    pub(super) fn restore(&mut self, (motor, encoder): (f64, Encoder)) {
        (self.motor, self.encoder, self.speed, self.force) = (motor, encoder, 0.0, 0.0);
    }

    /// Checks whether the controller reports over-current.
    pub(super) fn over_current(&self) -> bool {
        self.above > TRIPS
    }

    /// Returns the motor current, positive when the motor closes the jaw (A).
    pub(super) fn current(&self) -> f64 {
        -self.force * self.gripper.amperes_per_newton
    }
}
