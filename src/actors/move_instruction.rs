//! The move instruction: fetches a generator's inputs and dispatches its outputs (Zieliński et al. 2007, p. 370).
//!
//! [`Motion`] is one effector's instruction under way; an ECP runs one, MP runs one for each effector in the same
//! macrostep. When the operator pauses, the motion comes to rest by itself and goes on from there: set values that
//! stop dead trip the power stages.

use super::control::Control;
use crate::error::{Error, NonFatal};
use crate::generators::{
    Behaviour, Compliance, Generator, Inputs, Next, Outcome, Sensing, Target, position::Speeds,
};
use crate::motion::{ArmState, MoveCommand, PERIOD};

/// A generator with the state that its next call needs.
#[derive(Debug)]
pub struct Motion {
    generator: Generator,
    /// Macrosteps from full pace to rest, and how many of them the motion is away from rest.
    ramp: u32,
    pace: u32,
}

/// Time in which a pause brings a motion to rest, and a resume to its full pace [s]. From the full speed of axis 6 the
/// regulators lag by 4 rad of the motor in 0.4 s, which is a following error.
const REST: f64 = 0.6;

/// How the generators of an effector behave.
#[derive(Debug, Clone, Copy)]
pub struct Manner {
    /// Compliance and macrostep.
    pub compliance: Compliance,
    /// Full speeds.
    pub speeds: Speeds,
}

impl Motion {
    /// Begins a behaviour.
    #[must_use]
    pub fn begin(behaviour: &Behaviour, manner: &Manner) -> Self {
        let macrostep = f64::from(manner.compliance.macrostep) * PERIOD;
        let ramp = (REST / macrostep).ceil().max(1.0) as u32;
        let generator = behaviour.generator(&manner.compliance, &manner.speeds);
        Self { generator, ramp, pace: ramp }
    }

    /// Whether it stands still because of [`Motion::heed`].
    #[must_use]
    pub fn rests(&self) -> bool {
        self.pace == 0
    }

    /// One macrostep nearer to full pace, or to rest.
    pub fn heed(&mut self, control: Control) {
        self.pace = match control {
            Control::Running => (self.pace + 1).min(self.ramp),
            Control::Waiting | Control::Paused | Control::Terminated => self.pace.saturating_sub(1),
        };
    }

    /// Inputs in; out come the next command and the sensor's new configuration, if there is one.
    ///
    /// # Errors
    /// The [`Outcome`] with which the motion has come to its end.
    pub fn step(
        &mut self,
        arm: &ArmState,
        target: Option<&Target>,
    ) -> Result<(MoveCommand, Option<Sensing>), Outcome> {
        let share = f64::from(self.pace) / f64::from(self.ramp);
        // Without a jump of the acceleration at either end.
        let pace = share * share * (3.0 - 2.0 * share);
        let inputs = Inputs { arm, target, period: arm.period, pace };
        match self.generator.next(&inputs) {
            (Next::Go(command), sensing) => Ok((command, sensing)),
            (Next::Done(outcome), _) => Err(outcome),
        }
    }

    /// Whether this is a refusal of its last command that its generator can go on from.
    #[must_use]
    pub fn bears(&self, error: &Error) -> bool {
        match error {
            Error::NonFatal { cause: NonFatal::Refused(why), .. } => self.generator.bears(why),
            _ => false,
        }
    }
}
