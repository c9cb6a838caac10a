//! A clock that a pause slows down.
//!
//! - in: the pace of each macrostep
//! - out: the time of the motion

use super::super::inputs::Inputs;
use super::traits::Site;

/// Time of a motion that follows a course in time. A pause slows the clock down instead of leaving
/// the course, and a resume continues it. A generator with a clock declares
/// [`Pacing::Clock`](super::Pacing::Clock).
///
/// The pace reaches rest in 0.6 s. A motion of speed v then decelerates by 2.5 v per second, beyond
/// the accelerations of its own course.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clock {
    step: f64,
    time: f64,
}

impl Clock {
    /// Makes a clock that is at 0 s.
    #[must_use]
    pub fn new(site: &Site<'_>) -> Self {
        Self { step: site.step(), time: 0.0 }
    }

    /// Advances the clock by one macrostep at the present pace. Returns the time at the end of the
    /// macrostep (s), at which the set values of this macrostep must be.
    pub fn advance(&mut self, inputs: &Inputs<'_>) -> f64 {
        self.time += inputs.pace * self.step;
        self.time
    }

    /// Returns the time of the motion (s).
    #[must_use]
    pub fn time(&self) -> f64 {
        self.time
    }
}
