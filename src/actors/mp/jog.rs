//! A generator that turns one motor by an angle, from rest to rest.
//!
//! - in: axis and angle; at each macrostep whether the run is paused
//! - out: a command for the next macrostep; a pause brings the motor to rest in between
//! - course: `angle(s) = by (1 - cos(pi s)) / 2` for s from 0 to 1

use crate::motion::{AXES, Motion, MotorPositions, MoveCommand, PERIOD};

/// Largest speed of the motor (rad/s).
const FASTEST: f64 = 25.0;
/// Shortest time of a turn (s).
const LEAST: f64 = 0.4;
/// Time in which a pause brings the motor from full pace to rest (s).
const REST: f64 = 0.4;

/// The turn of one motor.
pub(super) struct Jog {
    axis: usize,
    /// Angle of the whole turn (rad).
    by: f64,
    /// Length of a macrostep (periods).
    macrostep: u32,
    /// Parameter of the course: 0 at its beginning, 1 at its end.
    at: f64,
    /// Pace: 1 at full pace, 0 at rest.
    pace: f64,
}

impl Jog {
    /// Creates the motion that turns the motor of `axis` by the angle `by` (rad), with macrosteps
    /// of the length `macrostep` (periods).
    pub(super) fn new(axis: usize, by: f64, macrostep: u32) -> Self {
        Self { axis: axis.min(AXES - 1), by, macrostep, at: 0.0, pace: 1.0 }
    }

    /// Returns whether the turn is done.
    pub(super) fn is_over(&self) -> bool {
        self.at >= 1.0
    }

    /// Returns whether a pause has brought the motor to rest.
    pub(super) fn rests(&self) -> bool {
        self.pace <= 0.0
    }

    /// Returns the command of the next macrostep; `runs` is false during a pause.
    pub(super) fn next(&mut self, runs: bool) -> MoveCommand {
        let step = f64::from(self.macrostep) * PERIOD;
        // The cosine is fastest in its middle, at pi / 2 times the mean speed.
        let lasts = (self.by.abs() * std::f64::consts::FRAC_PI_2 / FASTEST).max(LEAST);
        // A pause slows the course down instead of leaving it, so the turn continues from there.
        self.pace = (self.pace + if runs { step / REST } else { -step / REST }).clamp(0.0, 1.0);
        let next = self.at + self.pace * step / lasts;
        // Relative motions only: an arm that is not synchronised accepts no others.
        let mut motors = MotorPositions([0.0; AXES]);
        motors.0[self.axis] = self.angle(next) - self.angle(self.at);
        self.at = next;
        MoveCommand { motion: Motion::MotorsBy(motors), periods: self.macrostep, jaw: None }
    }

    /// Returns the angle by which the motor has turned (rad) after the share `share` of the
    /// motion's time, 0 to 1. The course is half a period of a cosine, from rest to rest.
    fn angle(&self, share: f64) -> f64 {
        0.5 * self.by * (1.0 - libm::cos(std::f64::consts::PI * share.min(1.0)))
    }
}
