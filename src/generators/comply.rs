//! Yielding: the partner of a turn or of a grasp, and the hand-back to the operator.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | pull | above `pull` for `PULL_SECONDS` | a knock is no pull |
//! | overload of an arm that waits for a pull | `STRAIN_SECONDS` | yielding may relieve it |
//! | overload of a partner arm | at once | the other arm drives it |
//! | overload in a direction that does not yield | at once | nothing relieves it |
//! | jaws of a partner that are forced apart | `FORCED_APART` | the cube turns in the hand |
//!
//! - in: the wrench, the distance of the jaws
//! - out: directions that seek zero force, until MP ends the behaviour or the operator pulls
//!
//! An overload is a force or torque beyond the limits of [`Compliance`].

use super::compliance::{Compliance, Selector};
use super::inputs::Inputs;
use super::outcome::{Next, Outcome};
use crate::motion::PERIOD;

/// Shortest time of a pull (s).
const PULL_SECONDS: f64 = 0.3;
/// Longest time of a force beyond the limits that yielding may still relieve (s). It is longer than
/// a pull lasts, because a pull may be that hard.
const STRAIN_SECONDS: f64 = 0.5;

/// Memory of a yielding arm.
#[derive(Debug, Clone)]
pub struct Comply {
    /// Force of a pull (N) and the longest wait for it (s); `None` for a partner arm.
    pull: Option<(f64, f64)>,
    selector: Selector,
    compliance: Compliance,
    /// Number of macrosteps since the behaviour began.
    steps: u32,
    /// Number of macrosteps in a row with the force of a pull.
    pulled: u32,
    /// Number of macrosteps in a row with an overload.
    strained: u32,
    /// Least distance of the jaws since the behaviour began (m).
    jaws: Option<f64>,
}

impl Comply {
    /// Makes the behaviour of a hand that yields while the partner arm drives it, until MP ends the
    /// behaviour. A force beyond the limits, or jaws that are forced apart, end it at once.
    #[must_use]
    pub fn until_ended(selector: Selector, compliance: Compliance) -> Self {
        Self { pull: None, selector, compliance, steps: 0, pulled: 0, strained: 0, jaws: None }
    }

    /// Makes the behaviour of an arm that yields until a force above `pull` (N) has lasted 0.3 s,
    /// at most for `seconds`.
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

    /// Makes the next macrosteps follow another compliance.
    pub(super) fn tune(&mut self, compliance: Compliance) {
        self.compliance = compliance;
    }

    /// Returns the command of the next macrostep, or how the behaviour ended (see
    /// [`super::Generator::next`]).
    pub fn next(&mut self, inputs: &Inputs<'_>) -> Next {
        self.steps += 1;
        let step = f64::from(self.compliance.macrostep) * PERIOD;
        let excess = self.compliance.excess(inputs.arm);
        self.strained = if excess.is_some() { self.strained + 1 } else { 0 };
        let tolerated = if self.pull.is_some() { STRAIN_SECONDS } else { 0.0 };
        let too_long = f64::from(self.strained) * step > tolerated;
        // A direction that does not yield relieves no force, and beyond the limit lies the end of
        // the sensor's range.
        let unyielding = self.compliance.unyielding(&self.selector, inputs.arm);
        if let Some(excess) = excess.filter(|_| too_long).or(unyielding) {
            return Next::Done(excess);
        }
        // The operator may turn the cube in the hand, a partner may not.
        let apart = Compliance::forced_apart(&mut self.jaws, inputs.arm);
        if let Some(apart) = apart.filter(|_| self.pull.is_none()) {
            return Next::Done(apart);
        }
        // A pull may have any direction.
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

    /// Length of a macrostep (s).
    const STEP: f64 = 0.016;

    /// Applies forces along z (N), each for a time (s). Returns the time (s) and the outcome with
    /// which the behaviour ended, or `None` if it goes on.
    fn end(mut comply: Comply, forces: &[(f64, f64)]) -> Option<(f64, Outcome)> {
        let step = f64::from(compliance().macrostep) * PERIOD;
        assert_eq!(step, STEP);
        let mut now = 0.0;
        for (force, seconds) in forces {
            for _ in 0..(seconds / step).round() as u32 {
                let wrench_in_tool = Wrench::from_directions([0.0, 0.0, *force, 0.0, 0.0, 0.0]);
                let arm = ArmState { wrench_in_tool, ..ArmState::default() };
                now += step;
                let inputs =
                    Inputs { arm: &arm, target: None, reading: None, period: 0, pace: 1.0 };
                if let Next::Done(outcome) = comply.next(&inputs) {
                    return Some((now, outcome));
                }
            }
        }
        None
    }

    /// Makes the behaviour of an arm that waits up to 10 s for a pull of 5 N.
    fn presented() -> Comply {
        Comply::until_pulled(5.0, [true; 6], 10.0, compliance())
    }

    /// A force above that of a pull must last for 0.3 s.
    #[test]
    fn sustained_force_counts_as_pull() {
        let (at, outcome) = end(presented(), &[(0.0, 0.5), (60.0, 1.0)]).unwrap();

        // The pull begins at 0.5 s.
        assert_eq!(outcome, Outcome::Pulled);
        assert!((0.78..0.84).contains(&at), "{at}");
    }

    /// Two overloads of 0.4 s are tolerated, and one that lasts ends the wait after 0.5 s.
    #[test]
    fn lasting_excess_force_ends_wait_for_pull() {
        let waits = || Comply::until_pulled(f64::INFINITY, [true; 6], 10.0, compliance());

        assert_eq!(end(waits(), &[(60.0, 0.4), (1.0, 0.1), (60.0, 0.4), (1.0, 5.0)]), None);
        let (at, outcome) = end(waits(), &[(60.0, 5.0)]).unwrap();
        assert_eq!(outcome, Outcome::OverForce(2, 60.0));
        assert!((0.5..0.56).contains(&at), "{at}");
    }

    /// The overload is either a force against which the hand cannot yield, or a torque that a force
    /// causes by its lever.
    #[test]
    fn excess_force_in_rigid_direction_ends_pull_wait() {
        let (mut selector, tff) = ([true; 6], [true, true, true, false, false, false]);
        let waits = |selector| Comply::until_pulled(5.0, selector, 10.0, compliance());

        selector[2] = false;
        assert_eq!(end(waits(selector), &[(60.0, 1.0)]), Some((STEP, Outcome::OverForce(2, 60.0))));
        // The force yields, but the torque by its lever does not.
        let force_and_torque = Wrench::from_directions([30.0, 0.0, 0.0, 0.0, 60.0, 0.0]);
        let arm = ArmState { wrench_in_tool: force_and_torque, ..ArmState::default() };
        let inputs = Inputs { arm: &arm, target: None, reading: None, period: 0, pace: 1.0 };
        let next = waits(tff).next(&inputs);
        assert!(matches!(next, Next::Done(Outcome::OverForce(4, _))), "{next:?}");
    }

    /// Forces jaws that hold a cube of 56.8 mm apart by 1.1 mm, which ends the yielding of a
    /// partner but not that of an arm that waits for a pull, and by 0.9 mm, which ends neither.
    #[test]
    fn jaws_forced_apart_end_compliance_not_pull_wait() {
        let ends = |mut comply: Comply, apart: f64| {
            [0.0568, 0.0568 + apart].into_iter().find_map(|jaw_opening| {
                let arm = ArmState { jaw_opening, ..ArmState::default() };
                let inputs =
                    Inputs { arm: &arm, target: None, reading: None, period: 0, pace: 1.0 };
                match comply.next(&inputs) {
                    Next::Done(outcome) => Some(outcome),
                    Next::Go(_) => None,
                }
            })
        };
        let yields = || Comply::until_ended([true; 6], compliance());

        assert!(matches!(ends(yields(), 0.0011), Some(Outcome::ForcedApart(_))));
        assert_eq!(ends(yields(), 0.0009), None);
        // The operator who pulls at the cube may turn it.
        assert_eq!(ends(presented(), 0.0011), None);
    }

    #[test]
    fn excess_force_ends_compliant_motion_at_once() {
        let ended = end(Comply::until_ended([true; 6], compliance()), &[(60.0, 1.0)]);

        assert_eq!(ended, Some((STEP, Outcome::OverForce(2, 60.0))));
    }
}
