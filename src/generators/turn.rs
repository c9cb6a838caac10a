//! Turning a face about the tool's z.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | turn that stalls | `STALL_ANGLE` in `STALL_SECONDS` | the set torque does not end the turn |
//! | torque beyond the grips | `MOST_TORQUE` for `TOO_LONG` | pads carry 1.1 to 1.8 Nm under 40 N |
//! | jaws that are forced apart | `FORCED_APART` | the cube turns between them |
//! | turn without torque | `least_torque`, angle above `LEAST_SAID` | no face followed the hand |
//! | torque at both ends of a turn | `ENDS`: ignored | backlash, acceleration, the next detent |
//! | layer that lags behind the wrist | `TWIST_STIFFNESS`, `MOST_TWIST` | both grips twist |
//! | layer that resists | `RESISTANCE`, `FOLLOWS` | friction alone must not slow a turn |
//!
//! - in: the roll of the last joint, the wrench
//! - out: an angular velocity about z that yields to torque, so that a jammed face stops at a set
//!   torque instead of breaking; the other directions yield where selected
//! - source: Zieliński et al. (2007), p. 374; the 2008 sources seek a torque of 5 Nm with B = 0.1
//!   rad/(s Nm), which is the same law with velocity = B * torque. They neither detect a stall nor
//!   slow down at the end.

use super::compliance::{Compliance, Selector};
use super::inputs::Inputs;
use super::outcome::{Next, Outcome};
use crate::motion::{ArmState, Direction, PERIOD};
use crate::operator::Parameter;
use crate::operator::parameter::Factors;

/// Smallest progress (rad) in [`STALL_SECONDS`] of a turn that has not stalled.
const STALL_ANGLE: f64 = 0.0175;
const STALL_SECONDS: f64 = 3.0;
/// Largest remaining angle at which the turn is complete (rad).
const TOLERANCE: f64 = 0.003;
/// Speed near the end of a turn (rad/s), divided by the remaining angle (rad) and the acceleration
/// (rad/s2): in s.
const SLOWING: f64 = 4.0;
/// Lowest speed at both ends of a turn (rad/s), unless its ordered speed is lower.
const CREEP: f64 = 0.02;
/// Stiffness of both grips against twist, by which the layer lags behind the wrist (Nm/rad): rubber
/// pads of 120 Nm/rad in series, the cube and the arms. The wrist turns farther by the twist that
/// the measured torque shows, at most by [`MOST_TWIST`] (rad).
const TWIST_STIFFNESS: f64 = 42.0;
const MOST_TWIST: f64 = 0.035;
/// Share of the turn at its beginning, and at its end, whose torque shows nothing about the face:
/// backlash of the grips, acceleration, the detent of the next position.
const ENDS: f64 = 0.2;
/// Smallest angle of a turn whose mean torque shows whether the face followed (rad).
const LEAST_SAID: f64 = 0.5;
/// Torque of a layer (Nm), and time under it (s), after which the turn ends before the grips slip.
/// Rubber pads under 40 N carry 1.8 Nm about the palm's axis and 1.1 Nm about the jaws'.
const MOST_TORQUE: f64 = 1.25;
const TOO_LONG: f64 = 0.2;
/// Deceleration of a turn that is broken off (rad/s2). After an abrupt stop the roll's motor would
/// trip.
const BRAKING: f64 = 4.0;
/// Largest resistance of a layer that a turn compensates, as a share of the torque at which it
/// stops: 0.4 Nm of 2.5 Nm. The compensation follows with a time constant (s). If it followed at
/// once, the turn would not yield at all.
const RESISTANCE: f64 = 0.16;
const FOLLOWS: f64 = 0.1;
/// Time to come to rest at the end (s).
const SETTLE: f64 = 0.15;

/// Order for a turn.
#[derive(Debug, Clone, Copy)]
pub struct Order {
    /// Angle about the tool's z (rad).
    pub angle: f64,
    /// Speed in free motion (rad/s).
    pub speed: f64,
    /// Acceleration at both ends (rad/s2).
    pub acceleration: f64,
    /// Torque at which the turn stops (Nm).
    pub torque: f64,
    /// Least mean torque that a turning face shows (Nm).
    pub least_torque: f64,
    /// Directions that yield besides the turn's own.
    pub selector: Selector,
    /// Whether the rotation follows the velocity at any torque.
    pub stiff: bool,
}

/// Memory of a turn.
#[derive(Debug, Clone)]
pub struct Turn {
    order: Order,
    /// Speed (rad/s) and torque (Nm) as they were ordered, before the operator's parameters.
    ordered_at_first: (f64, f64),
    compliance: Compliance,
    /// Sum and number of the torques in the middle of the turn (Nm).
    torques: (f64, u32),
    /// Roll of the last joint at the beginning (rad).
    start: Option<f64>,
    /// Least distance of the jaws since the turn began (m).
    jaws: Option<f64>,
    /// Number of macrosteps since the turn began.
    steps: u32,
    /// Step of the last progress, and the angle then (rad).
    progress_at: u32,
    progress: f64,
    /// Step in which the angle was reached.
    arrived: Option<u32>,
    /// Estimated speed of the wrist in the last step (rad/s).
    ordered: f64,
    /// Recent mean of the layer's resistance, up to the part that is compensated (Nm).
    resisted: f64,
    /// Number of steps in a row in which the torque was too high.
    strained: u32,
    /// Step in which the turn was broken off, its speed then (rad/s), and the reason.
    broken_off: Option<(u32, f64, Outcome)>,
}

/// Progress of a turn in one step. Angles are positive in the sense of the turn.
struct Progress {
    /// Angle by which the wrist has turned (rad).
    turned: f64,
    /// Angle by which the layer lags behind the wrist (rad).
    twist: f64,
    /// Angle by which the wrist still has to turn (rad).
    left: f64,
    /// Torque about the tool's z, in the tool's sense (Nm).
    torque: f64,
}

impl Turn {
    /// Makes the generator of the turn that `order` describes.
    #[must_use]
    pub fn new(order: Order, compliance: Compliance) -> Self {
        Self {
            order,
            ordered_at_first: (order.speed, order.torque),
            compliance,
            torques: (0.0, 0),
            start: None,
            jaws: None,
            steps: 0,
            progress_at: 0,
            progress: 0.0,
            arrived: None,
            ordered: 0.0,
            resisted: 0.0,
            strained: 0,
            broken_off: None,
        }
    }

    /// Makes the next macrosteps follow another compliance and the operator's speed and torque.
    pub(super) fn tune(&mut self, compliance: Compliance, factors: &Factors) {
        self.compliance = compliance;
        self.order.speed = self.ordered_at_first.0 * factors[Parameter::TurnSpeed];
        self.order.torque = self.ordered_at_first.1 * factors[Parameter::TurnTorque];
    }

    /// Returns the command of the next macrostep, or how the turn ended (see
    /// [`super::Generator::next`]).
    pub fn next(&mut self, inputs: &Inputs<'_>) -> Next {
        self.steps += 1;
        let progress = self.progress(inputs.arm);
        if let Some(why) = self.reason_to_break_off(inputs.arm, &progress)
            && self.broken_off.is_none()
        {
            if self.order.stiff {
                return Next::Done(why);
            }
            self.broken_off = Some((self.steps, self.ordered, why));
        }
        // The outcome is returned once the hand is at rest.
        if let Some(broken_off) = self.broken_off.clone() {
            return self.brake(broken_off);
        }
        self.record(&progress);
        // Only a torque against the turn is resistance. The low-pass filter leaves sudden torques
        // to the compliance.
        let resistance = (progress.torque * self.order.angle.signum())
            .clamp(0.0, RESISTANCE * self.order.torque);
        self.resisted += (resistance - self.resisted) * (self.seconds() / FOLLOWS).min(1.0);
        if let Some(arrived) = self.arrived {
            return self.settle(arrived, &progress);
        }
        // A jammed layer stops at the set torque, which does not end the turn by itself.
        if f64::from(self.steps - self.progress_at) * self.seconds() > STALL_SECONDS {
            return Next::Done(self.stalled(&progress));
        }
        let velocity = self.velocity(&progress);
        self.go(velocity)
    }

    /// Returns the length of a macrostep (s).
    fn seconds(&self) -> f64 {
        f64::from(self.compliance.macrostep) * PERIOD
    }

    /// Computes the progress of the turn from the joints and the wrench.
    fn progress(&mut self, arm: &ArmState) -> Progress {
        // The last joint turns about the tool's z, and its angle has no wrap-around.
        let roll = arm.joints.0[6];
        let start = *self.start.get_or_insert(roll);
        let sense = self.order.angle.signum();
        let turned = (roll - start) * sense;
        let torque = arm.wrench_in_tool.torque.z;
        let twist = (torque * sense / TWIST_STIFFNESS).clamp(0.0, MOST_TWIST);
        Progress { turned, twist, left: self.order.angle.abs() + twist - turned, torque }
    }

    /// Returns the reason why the turn must not continue: a force beyond its limit, jaws that are
    /// forced apart, or a torque at which the grips would slip.
    fn reason_to_break_off(&mut self, arm: &ArmState, progress: &Progress) -> Option<Outcome> {
        self.strained = if progress.torque.abs() > MOST_TORQUE { self.strained + 1 } else { 0 };
        let too_long = f64::from(self.strained) * self.seconds() > TOO_LONG;
        let apart = Compliance::forced_apart(&mut self.jaws, arm);
        let strained = too_long.then(|| self.stalled(progress));
        self.compliance.excess(arm).or(apart).or(strained)
    }

    /// Records progress, arrival, and the torque in the middle of the turn.
    fn record(&mut self, progress: &Progress) {
        if progress.turned > self.progress + STALL_ANGLE {
            self.progress = progress.turned;
            self.progress_at = self.steps;
        }
        if progress.left < TOLERANCE && self.arrived.is_none() {
            self.arrived = Some(self.steps);
        }
        let share = progress.turned / self.order.angle.abs();
        if (ENDS..=1.0 - ENDS).contains(&share) {
            self.torques.0 += progress.torque * self.order.angle.signum();
            self.torques.1 += 1;
        }
    }

    /// Decelerates a turn that was broken off in macrostep `since` at `speed` (rad/s), and returns
    /// the outcome `why` once the hand is at rest.
    fn brake(&self, (since, speed, why): (u32, f64, Outcome)) -> Next {
        let left = speed - BRAKING * f64::from(self.steps - since) * self.seconds();
        if left <= 0.0 {
            return Next::Done(why);
        }
        // The command has no compliance, so that the deceleration is the same under any torque.
        self.go(Direction::Unguarded { velocity: left * self.order.angle.signum() })
    }

    /// Holds for a moment after macrostep `arrived`, in which the angle was reached, then returns
    /// the outcome: how far the layer has turned, or that the grip has slipped.
    fn settle(&self, arrived: u32, progress: &Progress) -> Next {
        if f64::from(self.steps - arrived) * self.seconds() < SETTLE {
            return self.go(Direction::HOLD);
        }
        let Order { angle, least_torque, .. } = self.order;
        let mean = self.torques.0 / f64::from(self.torques.1.max(1));
        // A grip that slips on the face turns without the friction of the layer.
        if mean < least_torque && angle.abs() > LEAST_SAID {
            return Next::Done(Outcome::Slipped(progress.turned * angle.signum(), mean));
        }
        // The layer lags behind the wrist by the twist.
        Next::Done(Outcome::Turned((progress.turned - progress.twist) * angle.signum()))
    }

    /// Returns the law of the direction about z: the ordered velocity, slow at both ends of the
    /// turn, and its admittance.
    fn velocity(&mut self, progress: &Progress) -> Direction {
        let Order { angle, speed, acceleration, torque, stiff, .. } = self.order;
        let ramp = acceleration * f64::from(self.steps) * self.seconds();
        let left = progress.left;
        // The speed is proportional to the remaining angle near the end of the turn. Before that
        // the acceleration limits it.
        let slowing =
            (SLOWING * acceleration * left).min((2.0 * acceleration * left.max(0.0)).sqrt());
        // The ordered speed of a turn may be lower than the creep speed at its ends.
        let speed = slowing.min(ramp).clamp(CREEP.min(speed), speed);
        let velocity = speed * angle.signum();
        if stiff {
            self.ordered = speed;
            Direction::Unguarded { velocity }
        } else {
            // With the admittance of the highest ordered speed a turn at any speed stops at the set
            // torque.
            let most = most_ordered(speed);
            let admittance = most / torque;
            let ordered = (speed + admittance * self.resisted).min(most);
            // The speed at which the law moves the wrist under this torque, from which it may have
            // to brake.
            self.ordered = (ordered - admittance * progress.torque.abs()).clamp(0.0, speed);
            Direction::Guarded { velocity: ordered * angle.signum(), admittance, inertia: 0.0 }
        }
    }

    /// Returns the command for a macrostep with this law of the direction about z. The selected
    /// directions yield.
    fn go(&self, about_z: Direction) -> Next {
        let mut directions = self.compliance.yielding(&self.order.selector);
        directions[5] = about_z;
        Next::Go(self.compliance.task(directions, None))
    }

    /// Returns the outcome of a turn that stalls here, with its angle (rad) and torque (Nm).
    fn stalled(&self, progress: &Progress) -> Outcome {
        Outcome::Stalled(progress.turned * self.order.angle.signum(), progress.torque)
    }
}

/// Returns the time that a turn by `angle` (rad) takes (s). It includes the time lost at both ends
/// of a turn, which was measured in the simulated plant. `speed` is in rad/s, `acceleration` in
/// rad/s2.
#[must_use]
pub fn seconds(angle: f64, speed: f64, acceleration: f64) -> f64 {
    /// Time lost at both ends, at 1 rad/s2 (s).
    const LOST: f64 = 0.4;
    angle / speed + LOST / acceleration.sqrt() + SETTLE
}

/// Returns the highest speed that a turn may command to the wrist (rad/s) so that its layer moves
/// at `speed` (rad/s). Against a layer that resists the command exceeds `speed`, which compensates
/// a resistance of at most 16 % of the torque limit.
#[must_use]
pub fn most_ordered(speed: f64) -> f64 {
    speed / (1.0 - RESISTANCE)
}

#[cfg(test)]
mod tests {
    use super::super::testing::compliance;
    use super::*;
    use crate::motion::Motion;
    use std::f64::consts::FRAC_PI_2;

    /// Returns the inputs of a period without readings of a sensor, at full pace.
    fn at_full_pace(arm: &ArmState, period: u64) -> Inputs<'_> {
        Inputs { arm, target: None, reading: None, period, pace: 1.0 }
    }

    /// Turns a layer that follows without resistance. With `stiff` the turn does not yield to
    /// torque. Returns the outcome and the greatest speed ordered (rad/s).
    fn turned(angle: f64, speed: f64, stiff: bool) -> (Outcome, f64) {
        let selector = [true; 6];
        let acceleration = 1.0;
        let order =
            Order { angle, speed, acceleration, torque: 2.5, least_torque: 0.0, selector, stiff };
        let mut turn = Turn::new(order, compliance());
        let (mut arm, mut fastest) = (ArmState::default(), 0.0_f64);
        for period in (0..100_000).step_by(8) {
            let command = match turn.next(&at_full_pace(&arm, period)) {
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
        panic!("the turn never ends")
    }

    /// The speeds span the range of `control.turn_speed_deg_s` (1 to 180 deg/s). A turn at 0.1
    /// deg/s is too slow to be told from a stall.
    #[test]
    fn layer_turns_at_every_permitted_speed() {
        for degrees in [0.1_f64, 1.0, 1.2, 25.0, 180.0] {
            let speed = degrees.to_radians();
            for stiff in [false, true] {
                let angle = if degrees < 1.0 { 0.1 } else { -FRAC_PI_2 };
                let (outcome, fastest) = turned(angle, speed, stiff);

                if degrees < 1.0 {
                    // In 3 s this layer turns by less than `STALL_ANGLE`.
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

    /// Turns a layer that resists with `torque` (Nm). Returns the greatest speed of the wrist
    /// (rad/s) and the outcome.
    fn against(torque: f64) -> (f64, Outcome) {
        let (speed, selector) = (0.7, [false; 6]);
        let order = Order {
            angle: 3.0,
            speed,
            acceleration: 3.0,
            torque: 2.5,
            least_torque: 0.0,
            selector,
            stiff: false,
        };
        let mut turn = Turn::new(order, compliance());
        let (mut arm, mut fastest) = (ArmState::default(), 0.0_f64);
        arm.wrench_in_tool.torque.z = torque;
        for period in (0..20_000).step_by(8) {
            let command = match turn.next(&at_full_pace(&arm, period)) {
                Next::Done(outcome) => return (fastest, outcome),
                Next::Go(command) => command,
            };
            let Motion::Task { directions, .. } = command.motion else { panic!("{command:?}") };
            let velocity = match directions[5] {
                Direction::Guarded { velocity, admittance, .. } => velocity - admittance * torque,
                Direction::Unguarded { velocity } => velocity,
                Direction::Contact { .. } => 0.0,
            };
            fastest = fastest.max(velocity);
            arm.joints.0[6] += velocity * 8.0 * PERIOD;
        }
        panic!("the turn never ends")
    }

    #[test]
    fn moderate_layer_resistance_does_not_slow_the_turn() {
        for torque in [0.0, 0.2, 0.4] {
            let (fastest, outcome) = against(torque);
            assert!(matches!(outcome, Outcome::Turned(_)), "{torque}: {outcome:?}");
            assert!((fastest - 0.7).abs() < 0.01, "{torque}: {fastest}");
        }
        let (fastest, outcome) = against(1.2);
        assert!(fastest < 0.6 && fastest > 0.3, "it yields: {fastest}");
        assert!(matches!(outcome, Outcome::Turned(_)), "{outcome:?}");
    }
}
