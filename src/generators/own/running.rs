//! A registered generator under way, whatever its type.
//!
//! - in: the inputs of a macrostep
//! - out: the command of the macrostep, slowed down as the generator has declared

use super::super::compliance::Compliance;
use super::super::inputs::{Inputs, Sensing};
use super::super::outcome::Next;
use super::super::pace::slowed;
use super::forecast::Forecast;
use super::traits::{MotionGenerator, Pacing, Site, Touch};
use crate::motion::{Motion, MoveRefused};
use std::fmt;

/// A generator without the type of its order.
trait Erased: Send + Sync {
    fn next(&mut self, inputs: &Inputs<'_>) -> Next;
    fn forecast(&self) -> Option<Forecast>;
    fn touch(&self) -> Touch;
    fn pacing(&self) -> Pacing;
    fn rests(&self) -> bool;
    fn tolerates(&self, why: &MoveRefused) -> bool;
    fn sensing(&self) -> Option<Sensing>;
    fn sensor(&self) -> Option<&str>;
    fn onward(&self) -> Option<Forecast>;
    fn retreat(&mut self) -> Option<Motion>;
    fn tune(&mut self, compliance: &Compliance);
}

impl<G: MotionGenerator> Erased for G {
    fn next(&mut self, inputs: &Inputs<'_>) -> Next {
        MotionGenerator::next(self, inputs)
    }

    fn forecast(&self) -> Option<Forecast> {
        MotionGenerator::forecast(self)
    }

    fn touch(&self) -> Touch {
        MotionGenerator::touch(self)
    }

    fn pacing(&self) -> Pacing {
        MotionGenerator::pacing(self)
    }

    fn rests(&self) -> bool {
        MotionGenerator::rests(self)
    }

    fn tolerates(&self, why: &MoveRefused) -> bool {
        MotionGenerator::tolerates(self, why)
    }

    fn sensing(&self) -> Option<Sensing> {
        MotionGenerator::sensing(self)
    }

    fn sensor(&self) -> Option<&str> {
        MotionGenerator::sensor(self)
    }

    fn onward(&self) -> Option<Forecast> {
        MotionGenerator::onward(self)
    }

    fn retreat(&mut self) -> Option<Motion> {
        MotionGenerator::retreat(self)
    }

    fn tune(&mut self, compliance: &Compliance) {
        MotionGenerator::tune(self, compliance);
    }
}

/// A registered generator under way.
pub struct Running {
    generator: Box<dyn Erased>,
    /// Fraction of its own speed.
    fraction: f64,
    /// Length of a macrostep (periods).
    macrostep: u32,
}

impl fmt::Debug for Running {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Running").field("fraction", &self.fraction).finish_non_exhaustive()
    }
}

impl Running {
    /// Makes the running form of a generator that has begun at this site.
    #[must_use]
    pub fn new(generator: impl MotionGenerator, site: &Site<'_>) -> Self {
        let macrostep = site.compliance.macrostep;
        Self { generator: Box::new(generator), fraction: site.fraction, macrostep }
    }

    /// Returns the command of the next macrostep or the outcome, and how the visual sensor must
    /// look from now on.
    pub fn next(&mut self, inputs: &Inputs<'_>) -> (Next, Option<Sensing>) {
        let inputs = Inputs { pace: inputs.pace * self.fraction, ..*inputs };
        let mut next = self.generator.next(&inputs);
        if self.generator.pacing() == Pacing::Commands {
            next = slowed(next, &inputs);
        }
        if let Next::Go(command) = &mut next {
            // Both arms must be asked again at the same time.
            command.periods = self.macrostep;
        }
        (next, self.generator.sensing())
    }

    /// Makes the next macrosteps follow another compliance.
    pub fn tune(&mut self, compliance: &Compliance) {
        self.generator.tune(compliance);
    }

    /// Returns the course of the motion, if it is known beforehand.
    ///
    /// # Errors
    /// If the generator has declared a course that cannot be used.
    pub fn forecast(&self) -> Result<Option<Forecast>, String> {
        let Some(forecast) = self.generator.forecast() else { return Ok(None) };
        if let Some(defect) = forecast.defect() {
            return Err(defect);
        }
        Ok(Some(Forecast { seconds: forecast.seconds / self.fraction, ..forecast }))
    }

    /// Returns the name of the sensor whose reading each macrostep needs.
    #[must_use]
    pub fn sensor(&self) -> Option<&str> {
        self.generator.sensor()
    }

    /// Returns the course from the set values of the last command to rest, if the generator
    /// declares one.
    #[must_use]
    pub fn onward(&self) -> Option<Forecast> {
        self.generator.onward()
    }

    /// Takes the last command back and returns the one that leads to rest.
    pub fn retreat(&mut self) -> Option<Motion> {
        self.generator.retreat()
    }

    /// Returns what the tool may touch on the way.
    #[must_use]
    pub fn touch(&self) -> Touch {
        self.generator.touch()
    }

    /// Returns whether the motion is at rest, once the pace is 0.
    #[must_use]
    pub fn rests(&self) -> bool {
        self.generator.rests()
    }

    /// Returns whether the generator can continue although its last command was refused.
    #[must_use]
    pub fn tolerates(&self, why: &MoveRefused) -> bool {
        self.generator.tolerates(why)
    }
}
