//! Yielding: the partner of a turn or of a grasp, and the hand-back to the operator.
//!
//! - in: the wrench
//! - out: directions that seek zero force, until ended from above or until the operator pulls

use super::compliance::{Compliance, Selector};
use super::inputs::Inputs;
use super::outcome::{Next, Outcome};
use crate::motion::PERIOD;

/// Time that a pull must last (s).
const PULL_SECONDS: f64 = 0.3;
/// An arm that yields relieves what strains it: only a force beyond the limits for so long is one
/// it cannot yield to (s). More than a pull lasts: a hard one is a pull, too.
const STRAIN_SECONDS: f64 = 0.5;

/// Memory of a yielding arm.
#[derive(Debug, Clone)]
pub struct Comply {
    pull: Option<(f64, f64)>,
    selector: Selector,
    compliance: Compliance,
    steps: u32,
    pulled: u32,
    strained: u32,
    /// How far apart the jaws were at least (m).
    jaws: Option<f64>,
}

impl Comply {
    /// Until it is ended from above, or strained at all: its partner drives it.
    #[must_use]
    pub fn until_ended(selector: Selector, compliance: Compliance) -> Self {
        Self { pull: None, selector, compliance, steps: 0, pulled: 0, strained: 0, jaws: None }
    }

    /// Until a force above `pull` (N) has lasted, at most `seconds`.
    #[must_use]
    pub fn until_pulled(
        pull: f64,
        selector: Selector,
        seconds: f64,
        compliance: Compliance,
    ) -> Self {
        let pull = Some((pull, seconds));
        Self { pull, ..Self::until_ended(selector, compliance) }
    }

    /// See [`super::Generator::next`].
    pub fn next(&mut self, inputs: &Inputs<'_>) -> Next {
        self.steps += 1;
        let step = f64::from(self.compliance.macrostep) * PERIOD;
        let excess = self.compliance.excess(inputs.arm);
        self.strained = if excess.is_some() { self.strained + 1 } else { 0 };
        let borne = if self.pull.is_some() { STRAIN_SECONDS } else { 0.0 };
        let too_long = f64::from(self.strained) * step > borne;
        // What does not yield relieves nothing: behind the limit comes the end of the sensor's range.
        let unborne = self.compliance.unyielding(&self.selector, inputs.arm);
        if let Some(excess) = excess.filter(|_| too_long).or(unborne) {
            return Next::Done(excess);
        }
        // Only what a partner turns is not to turn in the hand.
        let apart = Compliance::forced_apart(&mut self.jaws, inputs.arm);
        if let Some(apart) = apart.filter(|_| self.pull.is_none()) {
            return Next::Done(apart);
        }
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

#[cfg(test)]
mod tests {
    use super::super::testing::compliance;
    use super::*;
    use crate::motion::ArmState;
    use crate::spatial::Wrench;

    /// Feels the forces along z (N), each for so long (s), and tells when and how it ended.
    fn felt(mut comply: Comply, forces: &[(f64, f64)]) -> Option<(f64, Outcome)> {
        let step = f64::from(compliance().macrostep) * PERIOD;
        let mut now = 0.0;
        for (force, seconds) in forces {
            for _ in 0..(seconds / step).round() as u32 {
                let wrench_in_tool = Wrench::from_directions([0.0, 0.0, *force, 0.0, 0.0, 0.0]);
                let arm = ArmState { wrench_in_tool, ..ArmState::default() };
                now += step;
                let inputs = Inputs { arm: &arm, target: None, period: 0, pace: 1.0 };
                if let Next::Done(outcome) = comply.next(&inputs) {
                    return Some((now, outcome));
                }
            }
        }
        None
    }

    fn presented() -> Comply {
        Comply::until_pulled(5.0, [true; 6], 10.0, compliance())
    }

    #[test]
    fn a_pull_harder_than_the_limit_is_a_pull() {
        let (at, outcome) = felt(presented(), &[(0.0, 0.5), (60.0, 1.0)]).unwrap();

        assert_eq!(outcome, Outcome::Pulled);
        assert!((0.78..0.84).contains(&at), "{at}");
    }

    #[test]
    fn who_waits_lives_with_a_strain_that_passes_and_ends_at_one_that_stays() {
        let waits = || Comply::until_pulled(f64::INFINITY, [true; 6], 10.0, compliance());

        assert_eq!(felt(waits(), &[(60.0, 0.4), (1.0, 0.1), (60.0, 0.4), (1.0, 5.0)]), None);
        let (at, outcome) = felt(waits(), &[(60.0, 5.0)]).unwrap();
        assert_eq!(outcome, Outcome::OverForce(2, 60.0));
        assert!((0.5..0.56).contains(&at), "{at}");
    }

    #[test]
    fn what_strains_a_direction_that_does_not_yield_ends_it_at_once() {
        let (mut selector, tff) = ([true; 6], [true, true, true, false, false, false]);
        let waits = |selector| Comply::until_pulled(5.0, selector, 10.0, compliance());

        selector[2] = false;
        assert_eq!(
            felt(waits(selector), &[(60.0, 1.0)]),
            Some((0.016, Outcome::OverForce(2, 60.0)))
        );
        // A force that it yields to, at a lever that it does not.
        let force_and_torque = Wrench::from_directions([30.0, 0.0, 0.0, 0.0, 60.0, 0.0]);
        let arm = ArmState { wrench_in_tool: force_and_torque, ..ArmState::default() };
        let inputs = Inputs { arm: &arm, target: None, period: 0, pace: 1.0 };
        let next = waits(tff).next(&inputs);
        assert!(matches!(next, Next::Done(Outcome::OverForce(4, _))), "{next:?}");
    }

    #[test]
    fn a_cube_that_turns_in_the_hand_ends_who_yields_to_a_partner_and_nobody_else() {
        let ends = |mut comply: Comply, apart: f64| {
            [0.0568, 0.0568 + apart].into_iter().find_map(|jaw_opening| {
                let arm = ArmState { jaw_opening, ..ArmState::default() };
                let inputs = Inputs { arm: &arm, target: None, period: 0, pace: 1.0 };
                match comply.next(&inputs) {
                    Next::Done(outcome) => Some(outcome),
                    Next::Go(_) => None,
                }
            })
        };
        let yields = || Comply::until_ended([true; 6], compliance());

        assert!(matches!(ends(yields(), 0.0011), Some(Outcome::ForcedApart(_))));
        assert_eq!(ends(yields(), 0.0009), None);
        // Who pulls at it may turn it.
        assert_eq!(ends(presented(), 0.0011), None);
    }

    #[test]
    fn who_yields_to_a_partner_ends_at_once() {
        let ended = felt(Comply::until_ended([true; 6], compliance()), &[(60.0, 1.0)]);

        assert_eq!(ended, Some((0.016, Outcome::OverForce(2, 60.0))));
    }
}
