//! The trait of a motion generator, and the site where it begins.
//!
//! - in: the order of a task; the state of the arm at the beginning and at each macrostep
//! - out: the set values of each macrostep, or the outcome; the course, if it is known beforehand

use super::super::behaviour::Behaviour;
use super::super::compliance::Compliance;
use super::super::inputs::{Inputs, Sensing};
use super::super::outcome::Next;
use super::super::position::Speeds;
use super::forecast::Forecast;
use super::order::OwnOrder;
use crate::motion::{ArmState, Motion, MoveRefused, PERIOD};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// The arm and its settings, as a generator finds them at its beginning.
#[derive(Debug, Clone, Copy)]
pub struct Site<'a> {
    /// Compliance, macrostep and limits of the arm.
    pub compliance: Compliance,
    /// Full speeds of the arm.
    pub speeds: Speeds,
    /// State of the arm, which is at rest.
    pub arm: &'a ArmState,
    /// Fraction of its own speed at which the generator is to move, above 0 and at most 1. The
    /// pace of [`Inputs`] contains it, so most generators need not use it.
    pub fraction: f64,
}

impl Site<'_> {
    /// Returns the length of a macrostep (s).
    #[must_use]
    pub fn step(&self) -> f64 {
        f64::from(self.compliance.macrostep) * PERIOD
    }
}

/// Way in which a pause slows a generator down.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pacing {
    /// Each command is slowed down by the pace of [`Inputs`]: the velocities of a task motion, and
    /// the step from the present set pose to the next. This suits generators that compute each
    /// command from the present state.
    Commands,
    /// The generator follows a clock of its own that the pace slows down, so its commands are kept
    /// as they are: see [`super::Clock`].
    Clock,
}

/// Contact that a generator expects, which decides the force that ends it from outside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Touch {
    /// None: the motion leads through free space. A force that changes by more than the limit of
    /// the arm is an obstacle and ends the motion.
    Free,
    /// The tool touches something. The generator itself judges forces; only the limit near the
    /// operator's hand ends it from outside.
    Contact,
    /// The arm yields to any push, so no force ends it from outside.
    Yields,
}

/// A motion generator: a transition function from inputs and memory to the next set values.
///
/// It runs once a macrostep. It must not wait, and needs neither clock nor log: time is in
/// [`Inputs`].
pub trait MotionGenerator: Send + Sync + Sized + 'static {
    /// Order: plain data, complete in itself.
    type Order: Serialize + DeserializeOwned;

    /// Makes the generator for an arm that is at rest.
    ///
    /// # Errors
    /// Reason why the order cannot be carried out. The task gets it as the trouble of its motion.
    fn begin(order: Self::Order, site: &Site<'_>) -> Result<Self, String>;

    /// Returns the command of the next macrostep, or how the motion has ended. The command always
    /// lasts a macrostep, whatever its `periods` say.
    fn next(&mut self, inputs: &Inputs<'_>) -> Next;

    /// Returns the course of the motion, if it is known before it begins. MP then refuses a course
    /// that comes too near an obstacle or that the arm cannot follow to its end, and slows one down
    /// that is too fast. Without a forecast
    /// only the watch over the moving arms stops the motion.
    fn forecast(&self) -> Option<Forecast> {
        None
    }

    /// Returns what the tool may touch on the way: by default nothing, so that an obstacle ends the
    /// motion.
    fn touch(&self) -> Touch {
        Touch::Free
    }

    /// Returns how a pause slows the generator down.
    fn pacing(&self) -> Pacing {
        Pacing::Commands
    }

    /// Returns whether the motion is at rest. It is asked once the pace is 0. A generator that
    /// needs longer to stop gets further macrosteps at the pace 0 until then, for 5 s at most.
    fn rests(&self) -> bool {
        true
    }

    /// Returns whether the generator can continue although its last command was refused for the
    /// reason `why`. Its next call gets this reason in `inputs.arm.refused`.
    fn tolerates(&self, why: &MoveRefused) -> bool {
        let _ = why;
        false
    }

    /// Makes the next macrosteps follow another compliance: the operator changes a parameter while
    /// the motion goes on. It is called before each macrostep. By default the motion keeps the
    /// compliance of its beginning.
    fn tune(&mut self, compliance: &Compliance) {
        let _ = compliance;
    }

    /// Returns how the visual sensor must look from now on; `None` leaves it as it is.
    fn sensing(&self) -> Option<Sensing> {
        None
    }

    /// Returns the name of the sensor whose reading each macrostep needs; `None` for no sensor. It
    /// must belong to the ECP of the arm.
    fn sensor(&self) -> Option<&str> {
        None
    }

    /// Returns the course from the set values of the last command to rest, for a generator whose
    /// course is not known beforehand, and `None` while the arm rests. The ECP checks it as it does
    /// a forecast before it gives the command.
    fn onward(&self) -> Option<Forecast> {
        None
    }

    /// Takes the last command back, because the course of [`MotionGenerator::onward`] is not free,
    /// and returns the one that brings the arm to rest on the course that was checked before.
    /// `None`: the generator declares no such course.
    fn retreat(&mut self) -> Option<Motion> {
        None
    }

    /// Makes the order of a task for this generator, which is registered as `name`.
    ///
    /// # Errors
    /// If the order has no form in JSON.
    fn behaviour(name: &str, order: &Self::Order) -> Result<Behaviour, String> {
        let order = serde_json::to_value(order).map_err(|why| why.to_string())?;
        Ok(Behaviour::Own(OwnOrder { generator: name.to_owned(), order, fraction: 1.0 }))
    }
}
