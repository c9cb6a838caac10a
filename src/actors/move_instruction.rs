//! The move instruction: fetches a generator's inputs and dispatches its outputs, once a macrostep
//! (Zieliński et al. 2007, p. 370).
//!
//! [`MoveInstruction`] is the instruction of one effector. An ECP runs one; MP under continuous
//! coordination runs one for each effector in the same macrostep. A pause brings the motion to rest
//! along its path, and a resume continues it from there: set values that stop at once trip the
//! power stages.
//!
//! - in: the state of the arm, the latest pose of the cube, the operator's control
//! - out: the next command and the sensor's configuration, or the [`Outcome`] of the behaviour
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | motion meets an obstacle | `force_limit` on the change | a constant offset is no contact |
//! | motion near the operator | [`NearHand::force`] | a person's hand may be the obstacle |
//! | pause or resume | `REST` | a faster change would be a following error of axis 6 |
//! | end by the superior actor | `ENDS` | a fast motor must not stop at once |

use super::control::Control;
use super::tuning::Tuning;
use crate::error::{Error, NonFatal};
use crate::generators::{
    Behaviour, Compliance, Generator, Inputs, Next, Outcome, Sensing, Target, built_in,
    own::{Forecast, Library, Site, Touch},
    position::Speeds,
    profile::Profile,
};
use crate::motion::{ArmState, MoveCommand, PERIOD};
use crate::operator::Parameter;
use crate::operator::parameter::Factors;
use crate::spatial::{Pose, Wrench};
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// A generator under way, with the state that its next call needs.
#[derive(Debug)]
pub struct MoveInstruction {
    generator: Generator,
    /// Macrosteps from full pace to rest.
    ramp: u32,
    /// Macrosteps from the present pace to rest, 0..=`ramp`.
    pace: u32,
    /// Whether the superior actor has ended the motion, which slows down now.
    ending: bool,
    /// Limit of the force near the operator's hand; `None` for behaviours that yield there or let
    /// the cube go.
    hand: Option<NearHand>,
    /// Largest change of the force on a motion through free space (N); `None` for other motions.
    free_limit: Option<f64>,
    /// Present factors of the operator's parameters.
    factors: Factors,
    /// Share of the planned speed, without the operator's factor; `None` for a motion that keeps
    /// its speed.
    free_speed: Option<f64>,
    /// Number of macrosteps in a row at the pace 0.
    stopping: u32,
    /// Reading of the sensor that the generator has named, for its next call.
    reading: Option<Result<Value, String>>,
    /// The behaviour, and the force at its beginning once a reading is finite (N).
    begun: (Behaviour, Option<Vector3<f64>>),
}

/// Time in which a pause brings a motion to rest and a resume to its full pace (s). In 0.4 s from
/// the full speed of axis 6 its regulator lags by 4 rad of the motor, which is a following error.
const REST: f64 = 0.6;

/// Time in which a motion that the superior actor ends comes to rest (s). A fast motor that is
/// stopped at once trips its power stage.
const ENDS: f64 = 0.12;

/// Longest time for which a generator that is not at rest at the pace 0 gets more macrosteps (s).
const STOPS: f64 = 5.0;

/// Parameters of all generators of an effector.
#[derive(Debug, Clone)]
pub struct Manner {
    /// Compliance and macrostep.
    pub compliance: Compliance,
    /// Full speeds.
    pub speeds: Speeds,
    /// Share of the planned speed of motions through free space.
    pub free_speed: f64,
    /// Zone of the operator's hand; `None` for an arm that has none.
    pub hand: Option<NearHand>,
    /// Generators that are registered by name.
    pub library: Library,
}

/// Returns the parameters of an effector's generators (compliance, speeds) for tests and examples.
/// In a run they come from the scenario.
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
        free_speed: 1.0,
        hand: None,
        library: built_in::library(),
    }
}

/// Zone in which the operator's hand may be, as one arm sees it, and the limit of the force there.
#[derive(Debug, Clone, Copy)]
pub struct NearHand {
    /// `base_from_zone`, and half of the edges of the box there (m).
    pub zone: (Pose, Vector3<f64>),
    /// Force above which a motion near the zone is broken off (N).
    pub force: f64,
}

impl NearHand {
    /// Distance from the zone within which fingers, cube or palm of a tool may touch a hand there,
    /// with the braking distance of an arm (m).
    const NEAR: f64 = 0.15;

    /// Returns the over-force outcome if the tool is near the zone of the operator's hand and
    /// `force` (N) exceeds the limit that holds there; `None` otherwise.
    fn excess(&self, arm: &ArmState, force: &Vector3<f64>) -> Option<Outcome> {
        let (base_from_zone, half) = &self.zone;
        let tool = Point3::from(arm.desired_base_from_tool.translation.vector);
        // Distance from a box: the positive parts of the distances from its faces.
        let beyond = (base_from_zone.inverse() * tool).coords.abs() - half;
        (beyond.map(|x| x.max(0.0)).norm() < Self::NEAR && force.norm() > self.force)
            .then(|| Outcome::OverForce(force.iamax(), force.norm()))
    }
}

impl Manner {
    /// Returns the site at which an effector in the state `arm` begins a motion.
    #[must_use]
    pub fn site<'a>(&self, arm: &'a ArmState) -> Site<'a> {
        Site { compliance: self.compliance, speeds: self.speeds, arm, fraction: 1.0 }
    }

    /// Returns how long a motion along a known path takes from the set position of `arm` (s); 0 for
    /// any other behaviour.
    #[must_use]
    pub fn seconds(&self, order: &Behaviour, arm: &ArmState) -> f64 {
        match *order {
            // An order may ask for more time than its speeds need, never for less.
            Behaviour::Joints { target, speed, seconds } => {
                self.speeds.joints_seconds(&arm.desired_joints, &target, speed).max(seconds)
            }
            Behaviour::Legs { legs, seconds } => {
                self.speeds.legs_seconds(&arm.desired_joints, &legs).max(seconds)
            }
            Behaviour::Line { target, speed } => {
                let (distance, turn) = tool_distance(arm, &target);
                self.speeds.line_seconds(distance, turn, speed)
            }
            // MP knows the time of a registered generator from its forecast. Contacts, forces and
            // the cube's motion decide how long the others take.
            _ => 0.0,
        }
    }

    /// Sets the duration of a motion along a known path to `lasts` (s); leaves any other behaviour
    /// as it is.
    pub fn set_duration(&self, order: &mut Behaviour, arm: &ArmState, lasts: f64) {
        match order {
            Behaviour::Joints { seconds, .. } | Behaviour::Legs { seconds, .. } => *seconds = lasts,
            // A line has no duration of its own, so the time becomes a share of its full speed.
            Behaviour::Line { target, speed } => {
                let (distance, turn) = tool_distance(arm, target);
                *speed = self.speeds.line_fraction(distance, turn, lasts);
            }
            _ => {}
        }
    }
}

/// Returns whether an order is a joint motion to the position at which the arm is set already, so
/// that the arm does not move.
fn stays(order: &Behaviour, arm: &ArmState) -> bool {
    let Behaviour::Joints { target, .. } = order else { return false };
    target.0.iter().zip(arm.desired_joints.0).all(|(to, from)| (to - from).abs() < 1e-4)
}

/// Returns distance (m) and angle (rad) from an arm's tool to `target`, a `base_from_tool`.
fn tool_distance(arm: &ArmState, target: &Pose) -> (f64, f64) {
    let from = &arm.desired_base_from_tool;
    let distance = (target.translation.vector - from.translation.vector).norm();
    (distance, from.rotation.angle_to(&target.rotation))
}

/// Manner in which MP, the superior actor, ends a motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Ending {
    /// A fast motion first slows down: its generator gets a falling pace.
    Slowing,
    /// A motion on a path through free space ends at once, and the servo brakes the motors as it
    /// does for an arm that met an obstacle. Both arms then brake alike, so that neither leaves
    /// their common path: an arm that slowed down more gently would go 15 to 27 mm farther than its
    /// partner. Other motions slow down.
    AtOnce,
}

impl MoveInstruction {
    /// Creates the move instruction that carries out a behaviour with an arm that is at rest in the
    /// state `arm`. The motion begins at full pace.
    ///
    /// # Errors
    /// If the behaviour is one of a registered generator, and there is none of its name or it
    /// refuses the order.
    pub fn begin(behaviour: &Behaviour, manner: &Manner, arm: &ArmState) -> Result<Self, NonFatal> {
        let macrostep = f64::from(manner.compliance.macrostep) * PERIOD;
        let ramp = (REST / macrostep).ceil().max(1.0) as u32;
        let generator = Generator::begin(behaviour, &manner.site(arm), &manner.library)
            .map_err(NonFatal::Arguments)?;
        // These yield to a push by themselves or move the jaws only: breaking them off would not
        // lower the force on the operator's hand.
        let yields = matches!(
            behaviour,
            Behaviour::Comply { .. } | Behaviour::Present { .. } | Behaviour::Jaw { .. }
        ) || generator.touch() == Some(Touch::Yields);
        let hand = manner.hand.filter(|_| !yields);
        // The change of the force counts, not the force: one that is there at the beginning is an
        // offset of the sensor, or a strain that the motion is to relieve.
        let free = matches!(
            behaviour,
            Behaviour::Joints { .. } | Behaviour::Legs { .. } | Behaviour::Line { .. }
        ) || generator.touch() == Some(Touch::Free);
        let free_limit = free.then_some(manner.compliance.force_limit);
        // Both arms slow down in the same ratio, and so stay on their common path. A registered
        // generator takes a falling pace for a pause, so it keeps its speed.
        let paced = matches!(
            behaviour,
            Behaviour::Joints { .. } | Behaviour::Legs { .. } | Behaviour::Line { .. }
        );
        let free_speed = paced.then_some(manner.free_speed);
        let begun = (behaviour.clone(), None);
        let (pace, ending, stopping, factors) = (ramp, false, 0, Factors::default());
        Ok(Self {
            generator,
            ramp,
            pace,
            ending,
            hand,
            free_limit,
            factors,
            free_speed,
            stopping,
            reading: None,
            begun,
        })
    }

    /// Returns the name of the sensor whose reading the generator needs.
    #[must_use]
    pub fn sensor(&self) -> Option<&str> {
        self.generator.sensor()
    }

    /// Sets the reading of that sensor for the next macrostep.
    pub fn set_reading(&mut self, reading: Result<Value, String>) {
        self.reading = Some(reading);
    }

    /// Returns the course from the set values of the last command to rest, if the generator
    /// declares one.
    #[must_use]
    pub fn onward(&self) -> Option<Forecast> {
        self.generator.onward()
    }

    /// Takes the last command back, since its course is not free. Returns the command that leads to
    /// rest instead; `command` if the generator has none.
    pub fn retreat(&mut self, command: MoveCommand) -> MoveCommand {
        match self.generator.retreat() {
            Some(motion) => MoveCommand { motion, ..command },
            None => command,
        }
    }

    /// Returns whether [`MoveInstruction::set_pace`] has brought the motion to rest.
    #[must_use]
    pub fn rests(&self) -> bool {
        let limit = (STOPS / REST * f64::from(self.ramp)) as u32;
        self.pace == 0 && (self.generator.rests() || self.stopping > limit)
    }

    /// Ends the motion at the request of the superior actor. Returns `true` if the motion is over
    /// at once, `false` if it is fast and first slows down.
    pub fn end(&mut self, ending: Ending) -> bool {
        // A turn and a visual servo share no path with the partner, and the motor of a turning
        // wrist cannot stop so fast against the layer.
        if ending == Ending::AtOnce && self.free_limit.is_some() {
            return true;
        }
        // Behaviours that are not in this list are slow or yield to forces, so they end at once.
        // The servo smooths the remainder of their speed.
        self.ending = matches!(
            self.begun.0,
            Behaviour::Turn { .. }
                | Behaviour::Joints { .. }
                | Behaviour::Legs { .. }
                | Behaviour::Line { .. }
                | Behaviour::VisualServo(_)
        ) || self.generator.touch().is_some_and(|touch| touch != Touch::Yields);
        !self.ending || self.rests()
    }

    /// Returns whether the motion has been ended and has come to rest.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.ending && self.rests()
    }

    /// Changes the pace by the share of one macrostep: towards full pace while the operator lets
    /// the run proceed, towards rest during a pause, and faster to rest after an end.
    pub fn set_pace(&mut self, control: Control) {
        // A resume does not revive a motion that has been ended.
        if self.ending {
            self.pace = self.pace.saturating_sub((REST / ENDS).ceil() as u32);
            return;
        }
        self.pace = match control {
            Control::Running => (self.pace + 1).min(self.ramp),
            Control::Waiting | Control::Paused | Control::Terminated => self.pace.saturating_sub(1),
        };
    }

    /// Makes the next macrostep follow the operator's parameters.
    fn tune(&mut self, factors: &Factors) {
        self.factors = *factors;
        self.generator.tune(factors);
    }

    /// Calls the generator once. Returns the command for the next macrostep, and a configuration
    /// for the stand-alone camera if the generator wants another one. `target` is the latest pose
    /// of the cube that this camera has seen.
    ///
    /// # Errors
    /// The [`Outcome`] of a motion that has ended.
    pub fn step(
        &mut self,
        arm: &ArmState,
        target: Option<&Target>,
    ) -> Result<(MoveCommand, Option<Sensing>), Outcome> {
        let Wrench { force, .. } = arm.wrench_in_tool;
        // An arm that only keeps its place has no path to an obstacle: a push does not end it.
        if self.begun.1.is_none() && stays(&self.begun.0, arm) {
            self.free_limit = None;
        }
        // The first finite force is the reference: against NaN every change would compare as
        // small, and the limit would never act.
        if self.begun.1.is_none() && force.iter().all(|newtons| newtons.is_finite()) {
            self.begun.1 = Some(force);
        }
        let change = force - self.begun.1.unwrap_or(force);
        // A behaviour that seeks a contact begins without one, so its whole force counts.
        let judged = if self.free_limit.is_some() { &change } else { &force };
        if let Some(excess) = self.hand.and_then(|hand| hand.excess(arm, judged)) {
            return Err(excess);
        }
        let limit = self.free_limit.map(|limit| limit * self.factors[Parameter::ForceLimit]);
        if limit.is_some_and(|limit| change.norm() > limit) {
            return Err(Outcome::OverForce(change.iamax(), change.norm()));
        }
        self.stopping = if self.pace == 0 { self.stopping + 1 } else { 0 };
        let share = f64::from(self.pace) / f64::from(self.ramp);
        // A smoothstep, 3 s^2 - 2 s^3: a linear pace would make the acceleration jump at both ends.
        let mut pace = share * share * (3.0 - 2.0 * share);
        if let Some(speed) = self.free_speed {
            // The motion was checked at its planned speed, so it must not become faster.
            pace *= (speed * self.factors[Parameter::FreeSpeed]).min(1.0);
        }
        let reading = self.reading.as_ref().map(|found| found.as_ref().map_err(String::as_str));
        let inputs = Inputs { arm, target, reading, period: arm.period, pace };
        match self.generator.next(&inputs) {
            (Next::Go(command), sensing) => Ok((command, sensing)),
            (Next::Done(outcome), _) => Err(outcome),
        }
    }

    /// Calls the generator once, as [`MoveInstruction::step`] does, under the operator's parameters
    /// as `tuning` follows them.
    ///
    /// # Errors
    /// The [`Outcome`] of a motion that has ended.
    pub fn step_under(
        &mut self,
        tuning: &mut Tuning,
        arm: &ArmState,
        target: Option<&Target>,
    ) -> Result<(MoveCommand, Option<Sensing>), Outcome> {
        self.tune(&tuning.factors(arm.period));
        let (mut command, sensing) = self.step(arm, target)?;
        tuning.grip(&mut command, arm);
        Ok((command, sensing))
    }

    /// Returns whether `error` is a refusal of the last command by the servo that the generator can
    /// handle, so that the motion continues with the next macrostep.
    #[must_use]
    pub fn tolerates(&self, error: &Error) -> bool {
        match error {
            Error::NonFatal { cause: NonFatal::Refused(why), .. } => self.generator.tolerates(why),
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{AXES, Depth, JawCommand, JointPositions, Motion};

    /// Returns parameters of generators with a zone of the operator's hand: a box with edges of
    /// 0.2 m around x = z = 1 m, near which the force limit is 10 N.
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

    /// Begins a behaviour.
    fn begin(behaviour: &Behaviour) -> MoveInstruction {
        MoveInstruction::begin(behaviour, &manner(), &ArmState::default()).unwrap()
    }

    /// Runs one macrostep of a behaviour for each of the `forces` on the tool along y (N), with the
    /// tool at `x` (m). Returns the outcome if the last macrostep ends the behaviour.
    fn ends<const N: usize>(behaviour: &Behaviour, x: f64, forces: [f64; N]) -> Option<Outcome> {
        let mut motion = begin(behaviour);
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

    /// A change of the force ends a motion through free space. A constant offset of the sensor does
    /// not, nor does a push against an arm that only keeps its place.
    #[test]
    fn force_change_above_limit_ends_free_space_motion() {
        let target = JointPositions([0.5; AXES]);
        let joints = Behaviour::Joints { target, speed: 1.0, seconds: 5.0 };
        let line = Behaviour::Line { target: Pose::translation(0.3, 0.2, 1.0), speed: 1.0 };

        // The limit of `example_manner` is 20 N.
        for behaviour in [joints, line] {
            assert_eq!(ends(&behaviour, 0.3, [0.0, 19.0]), None);
            assert_eq!(ends(&behaviour, 0.3, [0.0, 21.0]), Some(Outcome::OverForce(1, 21.0)));
            assert_eq!(ends(&behaviour, 0.3, [30.0, 30.0]), None, "the force is constant");
            assert_eq!(ends(&behaviour, 0.3, [30.0, 5.0]), Some(Outcome::OverForce(1, 25.0)));
            // A missing first sample does not disable the limit for the later ones.
            assert_eq!(ends(&behaviour, 0.3, [f64::NAN, 0.0, 19.0]), None);
            let after = ends(&behaviour, 0.3, [f64::NAN, 0.0, 21.0]);
            assert_eq!(after, Some(Outcome::OverForce(1, 21.0)));
        }
        let target = JointPositions::default();
        let stays = Behaviour::Joints { target, speed: 1.0, seconds: 5.0 };
        assert_eq!(
            ends(&stays, 0.3, [0.0, 50.0]),
            None,
            "a behaviour that only holds its place has no limit"
        );
    }

    /// Steps a behaviour with the operator's factor of a parameter; returns the last command.
    fn tuned(behaviour: &Behaviour, parameter: Parameter, factor: f64) -> MoveCommand {
        let mut motion = begin(behaviour);
        let arm = ArmState { jaw_opening: 0.057, ..ArmState::default() };
        let mut step = || {
            motion.tune(&Factors::default().with(parameter, factor));
            motion.step(&arm, None).unwrap().0
        };
        // After these macrosteps a turn has its full speed.
        for _ in 0..20 {
            step();
        }
        step()
    }

    /// Returns the laws of the six directions of a task motion.
    fn laws(command: &MoveCommand) -> [crate::motion::Direction; 6] {
        let Motion::Task { directions, .. } = command.motion else { panic!("{command:?}") };
        directions
    }

    #[test]
    fn motion_under_way_follows_operator_parameters() {
        use crate::motion::Direction::{Contact, Guarded};
        let selector = [true; 6];
        let press = Behaviour::Secure { press: 8.0, force: 40.0, selector, stops: Depth::One };
        let turn = Behaviour::Turn {
            angle: 1.5,
            speed: 0.7,
            acceleration: 30.0,
            torque: 2.0,
            least_torque: 0.0,
            selector,
            stiff: false,
        };

        for (factor, force) in [(1.0, 8.0), (1.5, 12.0)] {
            let command = tuned(&press, Parameter::ApproachForce, factor);
            assert!(matches!(laws(&command)[2], Contact { wanted, .. } if wanted == force));
        }
        let admittance = |parameter, axis: usize| match laws(&tuned(&press, parameter, 0.5))[axis] {
            Contact { admittance, .. } => admittance,
            other => panic!("{other:?}"),
        };
        assert_eq!(admittance(Parameter::LinearAdmittance, 0), 0.0005);
        assert_eq!(admittance(Parameter::AngularAdmittance, 4), 0.025);
        // The speed over the admittance is the torque at which the turn stops.
        let law = |parameter, factor| match laws(&tuned(&turn, parameter, factor))[5] {
            Guarded { velocity, admittance, .. } => (velocity, velocity / admittance),
            other => panic!("{other:?}"),
        };
        let (speed, torque) = law(Parameter::TurnSpeed, 1.0);
        assert!(law(Parameter::TurnSpeed, 0.5).0 < 0.51 * speed);
        assert!((law(Parameter::TurnTorque, 0.6).1 - 0.6 * torque).abs() < 1e-9);
    }

    #[test]
    fn free_motion_follows_operator_speed_and_limit() {
        let target = JointPositions([0.5; AXES]);
        let joints = Behaviour::Joints { target, speed: 1.0, seconds: 1.0 };
        let at = |factor| match tuned(&joints, Parameter::FreeSpeed, factor).motion {
            Motion::Joints(joints) => joints.0[1],
            other => panic!("{other:?}"),
        };
        // A macrostep at half of the speed counts as half of one.
        assert!(at(0.5) < 0.5 * at(1.0) && at(0.5) > 0.0);
        assert_eq!(at(3.0), at(1.0), "a motion is never faster than it was planned");

        let pushed = |factor: f64| {
            let mut motion = begin(&joints);
            motion.tune(&Factors::default().with(Parameter::ForceLimit, factor));
            let push = Wrench::from_directions([0.0, 19.0, 0.0, 0.0, 0.0, 0.0]);
            let arm = ArmState { wrench_in_tool: push, ..ArmState::default() };
            motion.step(&ArmState::default(), None).unwrap();
            motion.step(&arm, None).err()
        };
        assert_eq!(pushed(1.0), None, "the limit is 20 N");
        assert_eq!(pushed(0.9), Some(Outcome::OverForce(1, 19.0)));
    }

    /// Near the operator a lower limit ends a motion, except one that yields or opens the jaws.
    #[test]
    fn force_limit_is_lower_near_the_operator() {
        let target = JointPositions([0.5; AXES]);
        let joints = Behaviour::Joints { target, speed: 1.0, seconds: 5.0 };
        let present = Behaviour::Present { pull: 50.0, selector: [true; 6], seconds: 5.0 };
        let jaw = JawCommand { opening: 0.08, force_limit: 40.0, stops: Depth::One };
        let selector = [false; 6];
        let opens = Behaviour::Jaw { jaw, seconds: 1.0, selector, strained: false };

        // Within 0.15 m of the zone, which spans x from 0.9 to 1.1 m, and beyond.
        for (x, ended) in [(0.8, true), (1.2, true), (0.7, false)] {
            assert_eq!(ends(&joints, x, [0.0, 11.0]).is_some(), ended, "{x}");
            assert_eq!(ends(&joints, x, [0.0, 9.0]), None);
            assert_eq!(ends(&present, x, [0.0, 11.0]), None);
            assert_eq!(ends(&opens, x, [0.0, 11.0]), None);
        }
        // A force at the beginning is an offset in a free motion, but a contact in an approach.
        let seeks =
            Behaviour::Approach { speed: 0.02, distance: 0.05, force: 30.0, selector: [false; 6] };
        assert_eq!(ends(&joints, 0.8, [11.0, 11.0]), None);
        assert_eq!(ends(&seeks, 0.8, [11.0, 11.0]), Some(Outcome::OverForce(1, 11.0)));
    }

    #[test]
    fn cancelled_motion_slows_to_rest_before_it_ends() {
        let target = JointPositions([0.5; AXES]);
        let joints = Behaviour::Joints { target, speed: 1.0, seconds: 0.0 };
        let mut motion = begin(&joints);
        let mut arm = ArmState::default();
        // Performs a macrostep (0.016 s); returns by how much joint 1 moves in it (rad).
        let mut step = |motion: &mut MoveInstruction| {
            motion.set_pace(Control::Running);
            let Ok((MoveCommand { motion: Motion::Joints(to), .. }, _)) = motion.step(&arm, None)
            else {
                panic!()
            };
            let step = to.0[1] - arm.desired_joints.0[1];
            arm.desired_joints = to;
            step
        };
        for _ in 0..40 {
            step(&mut motion);
        }

        assert!(!motion.end(Ending::Slowing));
        let mut ways = vec![step(&mut motion)];
        while !motion.has_ended() {
            ways.push(step(&mut motion));
        }

        assert!(ways.is_sorted_by(|a, b| a >= b), "{ways:?}");
        assert!(ways[0] > 1e-3 && ways.last().is_some_and(|way| *way < 0.1 * ways[0]), "{ways:?}");
        let seconds = ways.len() as f64 * 0.016;
        assert!((0.11..0.15).contains(&seconds), "{seconds} s instead of 0.12 s: {ways:?}");
        let mut yields = begin(&Behaviour::Comply { selector: [true; 6] });
        assert!(yields.end(Ending::Slowing), "a compliant behaviour is at rest at once");
        let mut fast = begin(&joints);
        assert!(fast.end(Ending::AtOnce), "the servo brakes a motion whose partner has stopped");
        let turn = Behaviour::Turn {
            angle: 1.0,
            speed: 0.7,
            acceleration: 3.0,
            torque: 2.0,
            least_torque: 0.0,
            selector: [false; 6],
            stiff: false,
        };
        let mut turns = begin(&turn);
        assert!(!turns.end(Ending::AtOnce), "a turning wrist slows down");
    }
}
