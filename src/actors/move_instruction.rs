//! The move instruction: fetches a generator's inputs and dispatches its outputs (Zieliński et al. 2007, p. 370).
//!
//! [`Motion`] is one effector's instruction under way; an ECP runs one, MP runs one for each effector in the same
//! macrostep.

use crate::generators::{
    Behaviour, Compliance, Generator, Inputs, Next, Outcome, Target, position::Speeds,
};
use crate::motion::{ArmState, MoveCommand};

/// A generator with the state that its next call needs.
#[derive(Debug)]
pub struct Motion {
    generator: Generator,
}

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
        Self { generator: behaviour.generator(&manner.compliance, &manner.speeds) }
    }

    /// Inputs in, the next command or the outcome out.
    pub fn step(
        &mut self,
        arm: &ArmState,
        target: Option<&Target>,
    ) -> Result<MoveCommand, Outcome> {
        match self.generator.next(&Inputs { arm, target, period: arm.period }) {
            Next::Go(command) => Ok(command),
            Next::Done(outcome) => Err(outcome),
        }
    }
}
