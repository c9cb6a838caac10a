//! The move instruction: fetches a generator's inputs and dispatches its outputs (Zieliński et al. 2007, p. 370).
//!
//! [`MoveInstruction`] is one effector's instruction under way; an ECP runs one, MP runs one for each effector in the same
//! macrostep. When the operator pauses, the motion comes to rest by itself and goes on from there: set values that
//! stop dead trip the power stages.

use super::control::Control;
use crate::error::{Error, NonFatal};
use crate::generators::{
    Behaviour, Compliance, Generator, Inputs, Next, Outcome, Sensing, Target, position::Speeds,
    profile::Profile,
};
use crate::motion::{ArmState, MoveCommand, PERIOD};
use crate::spatial::{Pose, Wrench};
use nalgebra::{Point3, Vector3};

/// A generator with the state that its next call needs.
#[derive(Debug)]
pub struct MoveInstruction {
    generator: Generator,
    /// Macrosteps from full pace to rest, and how many of them the motion is away from rest.
    ramp: u32,
    pace: u32,
    /// Whether it has been ended from above, and comes to rest.
    ending: bool,
    /// What is heeded near the operator's hand; nothing by what gives way there, or lets go.
    hand: Option<NearHand>,
    /// Largest change of the force on a way through free space (N); `None` for other motions.
    free: Option<f64>,
    /// Where it leads, and the force at first.
    begun: (Behaviour, Option<Vector3<f64>>),
}

/// Time in which a pause brings a motion to rest, and a resume to its full pace (s). From the full
/// speed of axis 6 the regulators lag by 4 rad of the motor in 0.4 s, which is a following error.
const REST: f64 = 0.6;

/// Time in which a motion comes to rest that is ended from above (s): stopped dead, a fast motor
/// trips.
const ENDS: f64 = 0.12;

/// How the generators of an effector behave.
#[derive(Debug, Clone, Copy)]
pub struct Manner {
    /// Compliance and macrostep.
    pub compliance: Compliance,
    /// Full speeds.
    pub speeds: Speeds,
    /// Where an operator's hand may be.
    pub hand: Option<NearHand>,
}

/// For tests and examples; scenarios own the real numbers.
#[doc(hidden)]
#[must_use]
pub fn example_manner() -> Manner {
    Manner {
        compliance: Compliance {
            linear_admittance: 0.001,
            linear_inertia: 20.0,
            angular_admittance: 0.05,
            angular_inertia: 0.5,
            macrostep: 8,
            jaw_reach_speed: 0.012,
            jaw_close_speed: 0.012,
            jaw_open_speed: 0.03,
            force_limit: 20.0,
            torque_limit: 4.5,
        },
        speeds: Speeds {
            joint: [0.15, 0.75, 0.75, 0.75, 0.75, 0.75, 0.75],
            joint_acceleration: [0.3, 1.4, 1.4, 1.4, 1.4, 1.4, 1.4],
            linear: 0.15,
            linear_acceleration: 0.3,
            angular: 0.7,
            angular_acceleration: 1.4,
            profile: Profile { ramp: 5.0 },
        },
        hand: None,
    }
}

/// Where an operator's hand may be, as one arm sees it.
#[derive(Debug, Clone, Copy)]
pub struct NearHand {
    /// `base_from_zone`, and half the size of the box there (m).
    pub zone: (Pose, Vector3<f64>),
    /// Force at which any motion is broken off there (N).
    pub force: f64,
}

impl NearHand {
    /// So near is a tool whose fingers, cube or palm may touch a hand in the zone, and the speed of
    /// a braking arm (m).
    const NEAR: f64 = 0.15;

    /// Whether an arm that is there feels more force than it may (N).
    fn excess(&self, arm: &ArmState, force: &Vector3<f64>) -> Option<Outcome> {
        let (base_from_zone, half) = &self.zone;
        let tool = Point3::from(arm.desired_base_from_tool.translation.vector);
        let beyond = (base_from_zone.inverse() * tool).coords.abs() - half;
        (beyond.map(|x| x.max(0.0)).norm() < Self::NEAR && force.norm() > self.force)
            .then(|| Outcome::OverForce(force.iamax(), force.norm()))
    }
}

impl Manner {
    /// How long a motion along a known way takes (s); 0 of what is no such motion.
    #[must_use]
    pub fn seconds(&self, order: &Behaviour, arm: &ArmState) -> f64 {
        match *order {
            Behaviour::Joints { target, speed, seconds } => {
                self.speeds.joints_seconds(&arm.desired_joints, &target, speed).max(seconds)
            }
            Behaviour::Legs { legs, seconds } => {
                self.speeds.legs_seconds(&arm.desired_joints, &legs).max(seconds)
            }
            Behaviour::Line { target, speed } => {
                let (way, turn) = off(arm, &target);
                self.speeds.line_seconds(way, turn, speed)
            }
            _ => 0.0,
        }
    }

    /// Gives such a motion so much time (s).
    pub fn last(&self, order: &mut Behaviour, arm: &ArmState, lasts: f64) {
        match order {
            Behaviour::Joints { seconds, .. } | Behaviour::Legs { seconds, .. } => *seconds = lasts,
            Behaviour::Line { target, speed } => {
                let (way, turn) = off(arm, target);
                *speed = self.speeds.line_fraction(way, turn, lasts);
            }
            _ => {}
        }
    }
}

/// Whether an arm that stands so is only to stay there, whatever pushes.
fn stays(order: &Behaviour, arm: &ArmState) -> bool {
    let Behaviour::Joints { target, .. } = order else { return false };
    target.0.iter().zip(arm.desired_joints.0).all(|(to, from)| (to - from).abs() < 1e-4)
}

/// Distance (m) and angle (rad) from an arm's tool to `base_from_tool`.
fn off(arm: &ArmState, target: &Pose) -> (f64, f64) {
    let from = &arm.desired_base_from_tool;
    let way = (target.translation.vector - from.translation.vector).norm();
    (way, from.rotation.angle_to(&target.rotation))
}

impl MoveInstruction {
    /// Begins a behaviour.
    #[must_use]
    pub fn begin(behaviour: &Behaviour, manner: &Manner) -> Self {
        let macrostep = f64::from(manner.compliance.macrostep) * PERIOD;
        let ramp = (REST / macrostep).ceil().max(1.0) as u32;
        let generator = behaviour.generator(&manner.compliance, &manner.speeds);
        let yields = matches!(
            behaviour,
            Behaviour::Comply { .. } | Behaviour::Present { .. } | Behaviour::Jaw { .. }
        );
        let hand = manner.hand.filter(|_| !yields);
        // What is there from the beginning is a sensor that lies, or a strain that the motion is to relieve.
        let free = matches!(
            behaviour,
            Behaviour::Joints { .. } | Behaviour::Legs { .. } | Behaviour::Line { .. }
        )
        .then_some(manner.compliance.force_limit);
        let begun = (*behaviour, None);
        Self { generator, ramp, pace: ramp, ending: false, hand, free, begun }
    }

    /// Whether it stands still because of [`MoveInstruction::heed`].
    #[must_use]
    pub fn rests(&self) -> bool {
        self.pace == 0
    }

    /// Ends it; `true` if it is over at once, since it does not move by itself.
    pub fn end(&mut self) -> bool {
        self.ending = matches!(
            self.begun.0,
            Behaviour::Turn { .. }
                | Behaviour::Joints { .. }
                | Behaviour::Legs { .. }
                | Behaviour::Line { .. }
                | Behaviour::VisualServo(_)
        );
        !self.ending || self.pace == 0
    }

    /// Whether it has been ended and has come to rest.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.ending && self.pace == 0
    }

    /// One macrostep nearer to full pace, or to rest.
    pub fn heed(&mut self, control: Control) {
        if self.ending {
            self.pace = self.pace.saturating_sub((REST / ENDS).ceil() as u32);
            return;
        }
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
        let Wrench { force, .. } = arm.wrench_in_tool;
        if self.begun.1.is_none() && stays(&self.begun.0, arm) {
            self.free = None;
        }
        // What the servo stops an arm for is no force to begin from: nothing would be beyond it any more.
        if self.begun.1.is_none() && force.iter().all(|newtons| newtons.is_finite()) {
            self.begun.1 = Some(force);
        }
        let change = force - self.begun.1.unwrap_or(force);
        // What seeks a contact begins without one.
        let felt = if self.free.is_some() { &change } else { &force };
        if let Some(excess) = self.hand.and_then(|hand| hand.excess(arm, felt)) {
            return Err(excess);
        }
        if self.free.is_some_and(|limit| change.norm() > limit) {
            return Err(Outcome::OverForce(change.iamax(), change.norm()));
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{AXES, Depth, JawCommand, JointPositions, Motion};

    fn manner() -> Manner {
        let speeds = Speeds {
            joint: [0.5; AXES],
            joint_acceleration: [1.0; AXES],
            linear: 0.2,
            linear_acceleration: 0.5,
            angular: 1.0,
            angular_acceleration: 2.0,
            profile: Profile { ramp: 5.0 },
        };
        let zone = (Pose::translation(1.0, 0.0, 1.0), Vector3::repeat(0.1));
        let hand = Some(NearHand { zone, force: 10.0 });
        Manner { speeds, hand, ..example_manner() }
    }

    /// The outcome of the last step of a behaviour that felt these forces (N), at x (m).
    fn ends<const N: usize>(behaviour: &Behaviour, x: f64, forces: [f64; N]) -> Option<Outcome> {
        let mut motion = MoveInstruction::begin(behaviour, &manner());
        let mut ended = None;
        for force in forces {
            let wrench = Wrench::from_directions([0.0, force, 0.0, 0.0, 0.0, 0.0]);
            let arm = ArmState {
                desired_base_from_tool: Pose::translation(x, 0.0, 1.0),
                wrench_in_tool: wrench,
                jaw_opening: 0.07,
                desired_jaw_opening: 0.07,
                ..ArmState::default()
            };
            ended = motion.step(&arm, None).err();
        }
        ended
    }

    #[test]
    fn a_way_through_free_space_ends_where_something_is_met_and_a_sensor_that_lies_stops_nothing() {
        let target = JointPositions([0.5; AXES]);
        let joints = Behaviour::Joints { target, speed: 1.0, seconds: 5.0 };
        let line = Behaviour::Line { target: Pose::translation(0.3, 0.2, 1.0), speed: 1.0 };

        for behaviour in [joints, line] {
            assert_eq!(ends(&behaviour, 0.3, [0.0, 19.0]), None);
            assert_eq!(ends(&behaviour, 0.3, [0.0, 21.0]), Some(Outcome::OverForce(1, 21.0)));
            assert_eq!(ends(&behaviour, 0.3, [30.0, 30.0]), None, "nothing has changed");
            assert_eq!(ends(&behaviour, 0.3, [30.0, 5.0]), Some(Outcome::OverForce(1, 25.0)));
            // A sample that is missing at first blinds nothing that comes later.
            assert_eq!(ends(&behaviour, 0.3, [f64::NAN, 0.0, 19.0]), None);
            let after = ends(&behaviour, 0.3, [f64::NAN, 0.0, 21.0]);
            assert_eq!(after, Some(Outcome::OverForce(1, 21.0)));
        }
        let target = JointPositions::default();
        let stays = Behaviour::Joints { target, speed: 1.0, seconds: 5.0 };
        assert_eq!(ends(&stays, 0.3, [0.0, 50.0]), None, "what only holds its place does");
    }

    #[test]
    fn near_the_operator_less_is_borne_but_by_what_gives_way_or_lets_go() {
        let target = JointPositions([0.5; AXES]);
        let joints = Behaviour::Joints { target, speed: 1.0, seconds: 5.0 };
        let present = Behaviour::Present { pull: 50.0, selector: [true; 6], seconds: 5.0 };
        let jaw = JawCommand { opening: 0.08, force_limit: 40.0, stops: Depth::One };
        let selector = [false; 6];
        let opens = Behaviour::Jaw { jaw, seconds: 1.0, selector, strained: false };

        // Within 0.15 m of the zone, and beyond.
        for (x, ended) in [(0.8, true), (1.2, true), (0.7, false)] {
            assert_eq!(ends(&joints, x, [0.0, 11.0]).is_some(), ended, "{x}");
            assert_eq!(ends(&joints, x, [0.0, 9.0]), None);
            assert_eq!(ends(&present, x, [0.0, 11.0]), None);
            assert_eq!(ends(&opens, x, [0.0, 11.0]), None);
        }
        // What a free motion feels from its beginning is a sensor that lies; what seeks a contact begins without one.
        let seeks =
            Behaviour::Approach { speed: 0.02, distance: 0.05, force: 30.0, selector: [false; 6] };
        assert_eq!(ends(&joints, 0.8, [11.0, 11.0]), None);
        assert_eq!(ends(&seeks, 0.8, [11.0, 11.0]), Some(Outcome::OverForce(1, 11.0)));
    }

    #[test]
    fn motion_that_is_ended_comes_to_rest_first() {
        let target = JointPositions([0.5; AXES]);
        let joints = Behaviour::Joints { target, speed: 1.0, seconds: 0.0 };
        let mut motion = MoveInstruction::begin(&joints, &manner());
        let mut arm = ArmState::default();
        let mut step = |motion: &mut MoveInstruction| {
            motion.heed(Control::Running);
            let Ok((MoveCommand { motion: Motion::Joints(to), .. }, _)) = motion.step(&arm, None)
            else {
                panic!()
            };
            let way = to.0[1] - arm.desired_joints.0[1];
            arm.desired_joints = to;
            way
        };
        for _ in 0..40 {
            step(&mut motion);
        }

        assert!(!motion.end());
        let mut ways = vec![step(&mut motion)];
        while !motion.has_ended() {
            ways.push(step(&mut motion));
        }

        assert!(ways.is_sorted_by(|a, b| a >= b), "{ways:?}");
        assert!(ways[0] > 1e-3 && ways.last().is_some_and(|way| *way < 0.1 * ways[0]), "{ways:?}");
        assert!(ways.len() as f64 * 0.016 < ENDS + 0.03, "{ways:?}");
        let mut yields =
            MoveInstruction::begin(&Behaviour::Comply { selector: [true; 6] }, &manner());
        assert!(yields.end(), "what does not move by itself is over at once");
    }
}
