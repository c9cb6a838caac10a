//! Yielding: the partner of a turn or of a grasp, and the hand-back to the operator.
//!
//! - in: the wrench
//! - out: directions that seek zero force, until ended from above or until the operator pulls

use super::{Compliance, Inputs, Next, Outcome, Selector};
use crate::motion::PERIOD;

/// Time that a pull must last [s].
const PULL_SECONDS: f64 = 0.3;

/// Memory of a yielding arm.
#[derive(Debug, Clone)]
pub struct Comply {
    pull: Option<(f64, f64)>,
    selector: Selector,
    compliance: Compliance,
    steps: u32,
    pulled: u32,
}

impl Comply {
    /// Until it is ended from above.
    #[must_use]
    pub fn until_ended(selector: Selector, compliance: Compliance) -> Self {
        Self { pull: None, selector, compliance, steps: 0, pulled: 0 }
    }

    /// Until a force above `pull` [N] has lasted, at most `seconds`.
    #[must_use]
    pub fn until_pulled(
        pull: f64,
        selector: Selector,
        seconds: f64,
        compliance: Compliance,
    ) -> Self {
        Self { pull: Some((pull, seconds)), selector, compliance, steps: 0, pulled: 0 }
    }

    /// See [`super::Generator::next`].
    pub fn next(&mut self, inputs: &Inputs<'_>) -> Next {
        self.steps += 1;
        if let Some(excess) = self.compliance.excess(inputs.arm) {
            return Next::Done(excess);
        }
        let step = f64::from(self.compliance.macrostep) * PERIOD;
        if let Some((pull, patience)) = self.pull {
            let force = inputs.arm.wrench_in_tool.force.norm();
            self.pulled = if force > pull { self.pulled + 1 } else { 0 };
            if f64::from(self.pulled) * step >= PULL_SECONDS {
                return Next::Done(Outcome::Pulled);
            }
            if f64::from(self.steps) * step > patience {
                return Next::Done(Outcome::TimedOut(patience));
            }
        }
        Next::Go(self.compliance.task(self.compliance.yielding(&self.selector), None))
    }
}
