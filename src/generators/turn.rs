//! Turning a face about the tool's z.
//!
//! - in: the roll of the last joint, the wrench
//! - out: an angular velocity about z that yields to torque, so that a jammed face stands still at a set torque
//!   instead of breaking; the other directions yield where selected
//! - source: Zieliński et al. (2007), p. 374; the 2008 sources use a wanted torque of 5 Nm with B = 0.1 rad/(s Nm),
//!   which is the same law with velocity = B * torque. They have no stall detection and do not slow down at the
//!   end; both are added here.

use super::{Compliance, Inputs, Next, Outcome, Selector};
use crate::motion::{Direction, PERIOD};

/// A stall: less than this [rad] in [`STALL_SECONDS`].
const STALL_ANGLE: f64 = 0.0175;
const STALL_SECONDS: f64 = 3.0;
/// The turn ends this close [rad].
const TOLERANCE: f64 = 0.003;
/// Slowing down: speed per remaining angle [1/s].
const SLOWING: f64 = 4.0;
/// Slowest speed [rad/s].
const CREEP: f64 = 0.02;
/// Acceleration at the beginning [rad/s2]: the roll's gear of 289 makes 0.5 rad/s 144 rad/s of its motor.
const ACCELERATION: f64 = 1.0;
/// The layer lags behind the wrist by the twist of both grips: rubber pads of 120 Nm/rad in series, the cube and the
/// arms; the wrist goes on by what the measured torque says [Nm/rad], at most by [`MOST_TWIST`] [rad].
const TWIST_STIFFNESS: f64 = 42.0;
const MOST_TWIST: f64 = 0.035;
/// Share of the turn, at its beginning and at its end, whose torque tells nothing of the face: backlash of the grips,
/// speeding up, the neighbour's detent.
const ENDS: f64 = 0.2;
/// A turn shorter than this says too little of the torque [rad].
const LEAST_SAID: f64 = 0.5;
/// A layer that wants more torque than this for so long stands still, before the grips give way: pads of rubber under
/// 40 N carry 1.8 Nm about the palm's axis, 1.1 Nm about the jaws' [Nm, s].
const MOST_TORQUE: f64 = 1.25;
const TOO_LONG: f64 = 0.2;
/// How a turn that must not go on comes to rest: stopped dead, the roll's motor would trip [rad/s2].
const BRAKING: f64 = 4.0;
/// Time to come to rest at the end [s].
const SETTLE: f64 = 0.15;

/// Memory of a turn.
#[derive(Debug, Clone)]
pub struct Turn {
    angle: f64,
    speed: f64,
    torque: f64,
    least_torque: f64,
    /// Sum and number of the torques felt in the middle of the turn [Nm].
    felt: (f64, u32),
    selector: Selector,
    stiff: bool,
    compliance: Compliance,
    start: Option<f64>,
    /// How far apart the jaws were at least [m].
    jaws: Option<f64>,
    steps: u32,
    progress_at: u32,
    progress: f64,
    arrived: Option<u32>,
    /// Speed that was ordered last [rad/s].
    ordered: f64,
    /// For how many steps the torque has been too high.
    strained: u32,
    /// When and at which speed the turn was broken off, and why.
    broken_off: Option<(u32, f64, Outcome)>,
}

impl Turn {
    /// By `angle` [rad] about the tool's z; `torques` are the least mean one of a turning face and the one at which
    /// the turn stands still [Nm].
    #[must_use]
    pub fn new(
        angle: f64,
        speed: f64,
        (least_torque, torque): (f64, f64),
        selector: Selector,
        stiff: bool,
        compliance: Compliance,
    ) -> Self {
        Self {
            angle,
            speed,
            torque,
            least_torque,
            felt: (0.0, 0),
            selector,
            stiff,
            compliance,
            start: None,
            jaws: None,
            steps: 0,
            progress_at: 0,
            progress: 0.0,
            arrived: None,
            ordered: 0.0,
            strained: 0,
            broken_off: None,
        }
    }

    /// See [`super::Generator::next`].
    pub fn next(&mut self, inputs: &Inputs<'_>) -> Next {
        let arm = inputs.arm;
        // The last joint turns about the tool's z: its angle is the turn's, free of wrap-around.
        let roll = arm.joints.0[6];
        let start = *self.start.get_or_insert(roll);
        self.steps += 1;
        let step = f64::from(self.compliance.macrostep) * PERIOD;
        let turned = (roll - start) * self.angle.signum();
        let torque = arm.wrench_in_tool.torque.z;
        self.strained = if torque.abs() > MOST_TORQUE { self.strained + 1 } else { 0 };
        let strained = (f64::from(self.strained) * step > TOO_LONG)
            .then_some(Outcome::Stalled(turned * self.angle.signum(), torque));
        let apart = Compliance::forced_apart(&mut self.jaws, arm);
        if let Some(why) = self.compliance.excess(arm).or(apart).or(strained)
            && self.broken_off.is_none()
        {
            if self.stiff {
                return Next::Done(why);
            }
            self.broken_off = Some((self.steps, self.ordered, why));
        }
        if let Some((since, speed, why)) = self.broken_off {
            let left = speed - BRAKING * f64::from(self.steps - since) * step;
            if left <= 0.0 {
                return Next::Done(why);
            }
            let mut directions = self.compliance.yielding(&self.selector);
            directions[5] = Direction::Unguarded { velocity: left * self.angle.signum() };
            return Next::Go(self.compliance.task(directions, None));
        }
        let twist = (arm.wrench_in_tool.torque.z * self.angle.signum() / TWIST_STIFFNESS)
            .clamp(0.0, MOST_TWIST);
        let left = self.angle.abs() + twist - turned;
        if turned > self.progress + STALL_ANGLE {
            self.progress = turned;
            self.progress_at = self.steps;
        }
        if left < TOLERANCE && self.arrived.is_none() {
            self.arrived = Some(self.steps);
        }
        let share = turned / self.angle.abs();
        if (ENDS..=1.0 - ENDS).contains(&share) {
            self.felt.0 += arm.wrench_in_tool.torque.z * self.angle.signum();
            self.felt.1 += 1;
        }
        let mut directions = self.compliance.yielding(&self.selector);
        directions[5] = Direction::HOLD;
        if let Some(arrived) = self.arrived {
            if f64::from(self.steps - arrived) * step >= SETTLE {
                let felt = self.felt.0 / f64::from(self.felt.1.max(1));
                if felt < self.least_torque && self.angle.abs() > LEAST_SAID {
                    return Next::Done(Outcome::Slipped(turned * self.angle.signum(), felt));
                }
                // What the layer did, as far as the wrist and the torque tell.
                return Next::Done(Outcome::Turned((turned - twist) * self.angle.signum()));
            }
        } else if f64::from(self.steps - self.progress_at) * step > STALL_SECONDS {
            return Next::Done(Outcome::Stalled(turned * self.angle.signum(), torque));
        } else {
            let ramp = ACCELERATION * f64::from(self.steps) * step;
            // A turn may be wanted slower than it creeps at its ends.
            let speed = (SLOWING * left).min(ramp).clamp(CREEP.min(self.speed), self.speed);
            let velocity = speed * self.angle.signum();
            self.ordered = speed;
            directions[5] = if self.stiff {
                Direction::Unguarded { velocity }
            } else {
                // Stands still at the set torque whatever the speed.
                Direction::Guarded { velocity, admittance: speed / self.torque, inertia: 0.0 }
            };
        }
        Next::Go(self.compliance.task(directions, None))
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::compliance;
    use super::*;
    use crate::motion::{ArmState, Motion};
    use std::f64::consts::FRAC_PI_2;

    /// Turns a layer that follows without resistance; the outcome and the greatest speed ordered [rad/s].
    fn turned(angle: f64, speed: f64, stiff: bool) -> (Outcome, f64) {
        let mut turn = Turn::new(angle, speed, (0.0, 2.5), [true; 6], stiff, compliance());
        let (mut arm, mut fastest) = (ArmState::default(), 0.0_f64);
        for period in (0..100_000).step_by(8) {
            let command = match turn.next(&Inputs { arm: &arm, target: None, period, pace: 1.0 }) {
                Next::Done(outcome) => return (outcome, fastest),
                Next::Go(command) => command,
            };
            let Motion::Task { directions, .. } = command.motion else { panic!("{command:?}") };
            let velocity = match directions[5] {
                Direction::Unguarded { velocity } | Direction::Guarded { velocity, .. } => velocity,
                Direction::Contact { .. } => 0.0,
            };
            fastest = fastest.max(velocity.abs());
            arm.joints.0[6] += velocity * 8.0 * PERIOD;
        }
        panic!("it never ends")
    }

    #[test]
    fn a_layer_is_turned_at_the_least_and_the_greatest_speed_that_may_be_wanted() {
        // The ends of `control.turn_speed_deg_s`, and what a calibration and a heavy layer leave of them.
        for degrees in [0.1_f64, 1.0, 1.2, 25.0, 180.0] {
            let speed = degrees.to_radians();
            for stiff in [false, true] {
                let angle = if degrees < 1.0 { 0.1 } else { -FRAC_PI_2 };
                let (outcome, fastest) = turned(angle, speed, stiff);

                if degrees < 1.0 {
                    // Slower than what counts as standing still.
                    assert!(matches!(outcome, Outcome::Stalled(..)), "{outcome:?}");
                } else {
                    assert!(
                        matches!(outcome, Outcome::Turned(a) if (a - angle).abs() < 0.01),
                        "{outcome:?}"
                    );
                }
                assert!(fastest <= speed + 1e-12, "{fastest} at {degrees} deg/s");
            }
        }
    }
}
