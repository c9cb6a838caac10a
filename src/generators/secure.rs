//! Contact along the tool's z: the last approach of a grasp, and securing the cube in the palm.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | contact | `CONFIRM` readings in a row | a single one may be noise |
//! | force that has settled | within `NEAR` for `SETTLED` | three periods of the arms' 31 Hz |
//! | force that never settles | `PRESS`, then `CLENCH` | a seat that cannot yield ends as well |
//! | grip | `GRIP` | the jaws need this time |
//!
//! - in: the wrench along the tool's z
//! - out: a guarded velocity along z until the palm's stops touch (approach); the same backwards,
//!   to detect whether another hand still holds the cube (withdraw); a pressing force and then the
//!   clenched jaws (secure)
//! - source: Zieliński et al. (2007), p. 374: the cube is slightly forced into the palm, and
//!   finally the jaws clench

use super::compliance::{Compliance, Selector};
use super::inputs::Inputs;
use super::outcome::{Next, Outcome};
use crate::motion::{Depth, Direction, JawCommand, PERIOD};
use crate::operator::Parameter;
use crate::operator::parameter::Factors;
use nalgebra::Vector3;

/// Number of readings in a row that must show contact: a single one may be noise.
const CONFIRM: u32 = 2;
/// Longest times to press and to clench (s).
const PRESS: f64 = 0.5;
const CLENCH: f64 = 0.5;
/// Time near the wanted force after which pressing or clenching ends early (s). The arms vibrate at
/// 31 Hz, and three of these periods do not look like rest by chance.
const SETTLED: f64 = 0.1;
/// Largest distance from the wanted force that counts as settled (N). The noise of the sensor is
/// 0.1 N.
const NEAR: f64 = 1.0;
/// Time that the jaws need for their grip (s).
const GRIP: f64 = 0.15;

/// Kind of motion along z, with its speed (m/s), longest distance (m) and contact force (N), or
/// with its seat.
#[derive(Debug, Clone, Copy)]
enum Mode {
    Approach { speed: f64, distance: f64, force: f64 },
    Withdraw { speed: f64, distance: f64, force: f64 },
    Press(Seat),
}

/// Forces that seat a cube in the palm.
#[derive(Debug, Clone, Copy)]
struct Seat {
    /// Pressing force (N).
    press: f64,
    /// Grip force (N).
    force: f64,
    stops: Depth,
}

/// Memory of a contact along z.
#[derive(Debug, Clone)]
pub struct Secure {
    mode: Mode,
    selector: Selector,
    compliance: Compliance,
    /// Factor of the ordered contact and pressing forces.
    firmness: f64,
    /// Set position of the tool in the base at the beginning (m); `None` before the first call.
    start: Option<Vector3<f64>>,
    /// Distance between the pads at the beginning (m).
    opening: f64,
    /// Number of macrosteps since the beginning.
    steps: u32,
    /// Number of readings in a row that show contact.
    confirmed: u32,
    /// Step in which the jaws began to clench.
    clenching: Option<u32>,
    /// Number of steps in a row in which the force was near the wanted one.
    settled: u32,
}

impl Secure {
    /// Makes an approach along z at `speed` (m/s) until a contact of `force` (N), at most over
    /// `distance` (m). The directions of `selector` yield as well.
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

    /// Makes a retraction along z over `distance` (m) at `speed` (m/s), which ends early if the
    /// cube is held back with `force` (N). The directions of `selector` yield as well.
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

    /// Makes the behaviour that presses the cube into the palm with `press` (N), then clenches the
    /// jaws with the grip force `force` (N). The directions of `selector` yield, and the stops of
    /// the palm are at `stops`.
    #[must_use]
    pub fn press(
        press: f64,
        force: f64,
        selector: Selector,
        stops: Depth,
        compliance: Compliance,
    ) -> Self {
        Self::with(Mode::Press(Seat { press, force, stops }), selector, compliance)
    }

    /// Makes a generator that has not begun its motion.
    fn with(mode: Mode, selector: Selector, compliance: Compliance) -> Self {
        Self {
            mode,
            selector,
            compliance,
            firmness: 1.0,
            start: None,
            opening: 0.0,
            steps: 0,
            confirmed: 0,
            clenching: None,
            settled: 0,
        }
    }

    /// Makes the next macrosteps follow another compliance and the operator's contact force.
    pub(super) fn tune(&mut self, compliance: Compliance, factors: &Factors) {
        (self.compliance, self.firmness) = (compliance, factors[Parameter::ApproachForce]);
    }

    /// Returns the command of the next macrostep, or how the contact ended (see
    /// [`super::Generator::next`]).
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
                let force = force * self.firmness;
                // A retraction is an approach with the opposite sense: its force is a pull.
                let sense = if matches!(self.mode, Mode::Approach { .. }) { 1.0 } else { -1.0 };
                // A command moves the set pose, so the distance is measured between set poses.
                let way = (arm.desired_base_from_tool.translation.vector - start).norm();
                let contact = sense * arm.wrench_in_tool.force.z;
                self.confirmed = if contact > force { self.confirmed + 1 } else { 0 };
                if self.confirmed >= CONFIRM {
                    return Next::Done(Outcome::Touched(way));
                }
                // An arm whose motion is resisted may never cover the distance, so the time is
                // limited as well.
                if way >= distance || seconds > 3.0 * distance / speed + 2.0 {
                    return Next::Done(Outcome::NotTouched);
                }
                // The hand holds until a second reading confirms the contact: moving on for 16 ms
                // would add 4 N at the palm.
                directions[2] = if self.confirmed > 0 {
                    Direction::HOLD
                } else {
                    self.compliance.guarded(sense * speed, force)
                };
                Next::Go(self.compliance.task(directions, None))
            }
            Mode::Press(seat) => self.seat(&seat, directions, arm.wrench_in_tool.force.z),
        }
    }

    /// Presses the cube into the palm until the measured force `contact` (N) has settled, then
    /// clenches the jaws until `contact` has fallen to zero. Each stage also ends after its longest
    /// time.
    fn seat(&mut self, seat: &Seat, mut directions: [Direction; 6], contact: f64) -> Next {
        let step = f64::from(self.compliance.macrostep) * PERIOD;
        let wanted = if self.clenching.is_some() { 0.0 } else { seat.press * self.firmness };
        // A direction that does not yield cannot seek a force, so only the time ends it.
        let near = self.selector[2] && (contact - wanted).abs() < NEAR;
        self.settled = if near { self.settled + 1 } else { 0 };
        let rests = f64::from(self.settled) * step >= SETTLED;
        // The jaws clench only after pressing. Each stage ends by the settled force or by its time.
        match self.clenching {
            None if rests || f64::from(self.steps) * step > PRESS => {
                (self.clenching, self.settled) = (Some(self.steps), 0);
            }
            Some(since) => {
                let seconds = f64::from(self.steps - since) * step;
                if rests && seconds >= GRIP || seconds > CLENCH {
                    return Next::Done(Outcome::Secured);
                }
            }
            None => {}
        }
        if self.selector[2] {
            directions[2] = self.compliance.contact(2, wanted);
        }
        // The set value lies below the width of the cube, so that the force limit determines the
        // grip.
        let jaw = self.clenching.map(|_| JawCommand {
            opening: self.opening - super::grasp::SQUEEZE,
            force_limit: seat.force,
            stops: seat.stops,
        });
        Next::Go(self.compliance.task(directions, jaw))
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::compliance;
    use super::*;
    use crate::motion::{ArmState, Motion};

    /// Presses a cube into a palm, where the measured force follows the wanted one after `lag` (s).
    /// With `yields` all directions yield, else none. Returns the outcome, and the time (s) at
    /// which it came.
    fn seats(lag: f64, yields: bool) -> (Outcome, f64) {
        let mut secure = Secure::press(8.0, 40.0, [yields; 6], Depth::One, compliance());
        let step = 8.0 * PERIOD;
        let (mut arm, mut wanted_for, mut last) = (ArmState::default(), 0.0, f64::NAN);
        for steps in 1..1000 {
            let inputs =
                Inputs { arm: &arm, target: None, reading: None, period: 8 * steps, pace: 1.0 };
            let command = match secure.next(&inputs) {
                Next::Done(outcome) => return (outcome, steps as f64 * step),
                Next::Go(command) => command,
            };
            let Motion::Task { directions, .. } = command.motion else { panic!("{command:?}") };
            let wanted = match directions[2] {
                Direction::Contact { wanted, .. } => wanted,
                _ => 0.0,
            };
            wanted_for = if wanted == last { wanted_for + step } else { 0.0 };
            last = wanted;
            if wanted_for >= lag {
                arm.wrench_in_tool.force.z = wanted;
            }
        }
        panic!("the securing never ends")
    }

    #[test]
    fn approach_stops_at_first_contact_and_confirms_it() {
        let goes = |forces: &[f64]| {
            let mut approach = Secure::approach(0.01, 0.05, 4.0, [false; 6], compliance());
            let mut arm = ArmState::default();
            let mut ways = Vec::new();
            for (&force, steps) in forces.iter().zip(0..) {
                arm.wrench_in_tool.force.z = force;
                let inputs =
                    Inputs { arm: &arm, target: None, reading: None, period: 8 * steps, pace: 1.0 };
                match approach.next(&inputs) {
                    Next::Done(Outcome::Touched(_)) => ways.push("touched"),
                    Next::Done(other) => panic!("{other:?}"),
                    Next::Go(command) => match command.motion {
                        Motion::Task { directions, .. } if directions[2] == Direction::HOLD => {
                            ways.push("stands");
                        }
                        _ => ways.push("goes"),
                    },
                }
            }
            ways
        };

        assert_eq!(goes(&[0.0, 5.0, 5.0]), ["goes", "stands", "touched"]);
        assert_eq!(goes(&[0.0, 5.0, 0.0, 0.0]), ["goes", "stands", "goes", "goes"], "one spike");
    }

    #[test]
    fn securing_ends_early_once_the_force_settles() {
        let (soon, late, never) = (seats(0.05, true), seats(0.2, true), seats(9.0, true));

        assert!([&soon, &late, &never].iter().all(|end| end.0 == Outcome::Secured));
        // Pressing and clenching each last for the lag and `SETTLED`, and at most `PRESS` or
        // `CLENCH`; the jaws need `GRIP` at least.
        assert!(soon.1 > 0.25 && soon.1 < 0.4, "{soon:?}");
        assert!(late.1 > soon.1 + 0.2 && late.1 < 0.8, "{late:?}");
        assert!(never.1 > PRESS && never.1 < PRESS + CLENCH + 0.1, "{never:?}");
    }

    #[test]
    fn securing_without_compliance_lasts_the_full_time() {
        let (outcome, seconds) = seats(0.0, false);

        assert_eq!(outcome, Outcome::Secured);
        assert!(seconds > PRESS + CLENCH && seconds < PRESS + CLENCH + 0.1, "{seconds}");
    }
}
