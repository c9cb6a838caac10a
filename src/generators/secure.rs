//! Contact along the tool's z: the last approach of a grasp, and securing the cube in the palm.
//!
//! - in: the wrench along the tool's z
//! - out: a guarded velocity along z until the palm's stops touch (approach), or a pressing force and then the
//!   clenched jaws (secure); or the same backwards, to feel whether somebody else still holds the cube (withdraw)
//! - source: Zieliński et al. (2007), p. 374: the cube is slightly forced into the palm, finally the jaws clench

use super::compliance::{Compliance, Selector};
use super::inputs::Inputs;
use super::outcome::{Next, Outcome};
use crate::motion::{Depth, JawCommand, PERIOD};
use nalgebra::Vector3;

/// Readings in a row that must show contact: a single noisy sample is none.
const CONFIRM: u32 = 2;
/// Time to press (s), and to clench (s).
const PRESS: f64 = 0.5;
const CLENCH: f64 = 0.5;

#[derive(Debug, Clone, Copy)]
enum Mode {
    Approach { speed: f64, distance: f64, force: f64 },
    Withdraw { speed: f64, distance: f64, force: f64 },
    Press { press: f64, force: f64, stops: Depth },
}

/// Memory of a contact along z.
#[derive(Debug, Clone)]
pub struct Secure {
    mode: Mode,
    selector: Selector,
    compliance: Compliance,
    start: Option<Vector3<f64>>,
    opening: f64,
    steps: u32,
    confirmed: u32,
}

impl Secure {
    /// Approaches until `force` is felt or `distance` is covered.
    #[must_use]
    pub fn approach(
        speed: f64,
        distance: f64,
        force: f64,
        selector: Selector,
        compliance: Compliance,
    ) -> Self {
        Self::with(Mode::Approach { speed, distance, force }, selector, compliance)
    }

    /// Draws back along z until `distance` is covered, or until something holds on to it with `force`.
    #[must_use]
    pub fn withdraw(
        speed: f64,
        distance: f64,
        force: f64,
        selector: Selector,
        compliance: Compliance,
    ) -> Self {
        Self::with(Mode::Withdraw { speed, distance, force }, selector, compliance)
    }

    /// Presses, then clenches.
    #[must_use]
    pub fn press(
        press: f64,
        force: f64,
        selector: Selector,
        stops: Depth,
        compliance: Compliance,
    ) -> Self {
        Self::with(Mode::Press { press, force, stops }, selector, compliance)
    }

    fn with(mode: Mode, selector: Selector, compliance: Compliance) -> Self {
        Self { mode, selector, compliance, start: None, opening: 0.0, steps: 0, confirmed: 0 }
    }

    /// See [`super::Generator::next`].
    pub fn next(&mut self, inputs: &Inputs<'_>) -> Next {
        let arm = inputs.arm;
        let start = *self.start.get_or_insert(arm.desired_base_from_tool.translation.vector);
        if self.steps == 0 {
            self.opening = arm.jaw_opening;
        }
        self.steps += 1;
        if let Some(excess) = self.compliance.excess(arm) {
            return Next::Done(excess);
        }
        let seconds = f64::from(self.steps) * f64::from(self.compliance.macrostep) * PERIOD;
        let mut directions = self.compliance.yielding(&self.selector);
        match self.mode {
            Mode::Approach { speed, distance, force }
            | Mode::Withdraw { speed, distance, force } => {
                let sense = if matches!(self.mode, Mode::Approach { .. }) { 1.0 } else { -1.0 };
                let way = (arm.desired_base_from_tool.translation.vector - start).norm();
                let felt = sense * arm.wrench_in_tool.force.z;
                self.confirmed = if felt > force { self.confirmed + 1 } else { 0 };
                if self.confirmed >= CONFIRM {
                    return Next::Done(Outcome::Touched(way));
                }
                if way >= distance || seconds > 3.0 * distance / speed + 2.0 {
                    return Next::Done(Outcome::NotTouched);
                }
                directions[2] = self.compliance.guarded(sense * speed, force);
                Next::Go(self.compliance.task(directions, None))
            }
            Mode::Press { press, force, stops } => {
                if seconds > PRESS + CLENCH {
                    return Next::Done(Outcome::Secured);
                }
                let wanted = if seconds > PRESS { 0.0 } else { press };
                if self.selector[2] {
                    directions[2] = self.compliance.contact(2, wanted);
                }
                let jaw = (seconds > PRESS).then_some(JawCommand {
                    opening: self.opening - super::grasp::SQUEEZE,
                    force_limit: force,
                    stops,
                });
                Next::Go(self.compliance.task(directions, jaw))
            }
        }
    }
}
