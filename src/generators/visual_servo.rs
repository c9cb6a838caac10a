//! The visual servo: it leads the gripper to the cube that the operator holds.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | cube at rest | [`Order::still`], [`Order::still_seconds`] | a hand that sways rests briefly |
//! | moved cube | [`Order::retreat`] | the approach no longer leads to it |
//! | hidden cube | [`Order::frozen`] | the gripper covers it, the last pose is frozen |
//! | hidden cube seen elsewhere | `GONE` pictures, `DRAWN` | it was drawn out of the fingers |
//! | old target | [`Order::stale`] | the arm stops within `RUN_OUT` |
//! | no target, outside the zone, refused | [`Order::patience`] | the behaviour ends |
//! | cube that never rests | `RESTLESS` times the patience | the behaviour ends |
//! | place to wait out of reach | `NEARER` up to `NEAREST` | an arm may not fold far enough |
//! | dark or bright picture | `EXPOSURES`, each for `TRY` | the light of a workshop is unknown |
//!
//! - in: the pose of the cube in the world as the VSP of the stand-alone camera delivers it (25
//!   Hz), the set pose, the wrench
//! - out: a bounded step towards the vicinity of the cube; once the cube is at rest, a guarded
//!   approach along the tool's z until the palm's stops touch
//! - A cube that was drawn out of the fingers is followed only after the gripper has moved straight
//!   back.
//! - source: Zieliński et al. (2007), pp. 371-373: position-based, end-effector open loop,
//!   stand-alone camera. The stages (lead, follow, back off, approach, frozen near the cube) are
//!   from the 2008 sources.

use super::compliance::Compliance;
use super::inputs::{Inputs, Mode, Sensing, Target, Window};
use super::outcome::{Next, Outcome};
use crate::motion::{Direction, Motion, MoveCommand, MoveRefused, PERIOD};
use crate::spatial::{Pose, pose_from_axes};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Order for the visual servo.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Order {
    /// `world_from_base` of the controller's belief.
    pub world_from_base: Pose,
    /// Wanted direction of the tool's z in the world; the nearest axis of the cube is taken.
    pub approach: Vector3<f64>,
    /// Wanted direction of the jaws in the world; the nearest axis of the cube across the approach
    /// is taken.
    pub jaws: Vector3<f64>,
    /// Distance from the cube's centre back to the tool point, along the tool's z, when the cube is
    /// seated (m).
    pub seat: f64,
    /// Distance before the seat at which the gripper waits and follows (m).
    pub vicinity: f64,
    /// Distance before the seat below which the last pose is frozen, because the gripper hides the
    /// cube (m).
    pub frozen: f64,
    /// Distance from the first seen position within which the cube must stay to count as at rest
    /// (m).
    pub still: f64,
    /// Time within this distance after which the cube counts as at rest (s).
    pub still_seconds: f64,
    /// Distance by which the cube must move to break off the approach (m); at least 0.05 m once the
    /// gripper hides the cube.
    pub retreat: f64,
    /// Largest speed of the tool (m/s) and of its rotation (rad/s).
    pub speed: (f64, f64),
    /// Largest acceleration of the tool (m/s2).
    pub acceleration: f64,
    /// Speed of the approach (m/s).
    pub approach_speed: f64,
    /// Contact force that ends the approach (N).
    pub touch: f64,
    /// Virtual mass of the approach (kg).
    pub inertia: f64,
    /// Distance beyond the seat at which the approach is given up (m).
    pub overrun: f64,
    /// Age above which a target is no longer followed (s).
    pub stale: f64,
    /// Time without any target after which the servo gives up (s).
    pub patience: f64,
    /// Place of hand-over: `world_from_zone` and the half extents of a box in its axes (m). A cube
    /// outside is watched from the edge of the zone, because the arm may not reach it.
    pub zone: (Pose, Vector3<f64>),
}

/// Stage of the servo: the motion that it makes now.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Stage {
    /// Motion to the vicinity of the cube, which is followed.
    Follow,
    /// Approach. `began_at` is the position of the goal at its beginning, in the base (m).
    Approach { began_at: Vector3<f64> },
    /// Motion straight back to the pose `wait`, away from anything between the fingers.
    BackOff { wait: Pose },
}

/// A cube at rest: its place in the world, and the period since which it was seen there.
#[derive(Debug, Clone, Copy)]
struct Rest {
    at: Vector3<f64>,
    since: u64,
}

/// Memory of the visual servo.
#[derive(Debug, Clone)]
pub struct VisualServo {
    order: Order,
    compliance: Compliance,
    stage: Stage,
    /// Filtered `base_from_tool` at the seat.
    goal: Option<Pose>,
    /// Period of the last picture that was taken into account.
    seen: u64,
    /// Velocity of the set position (m/s), and angular velocity of the set orientation (rad/s).
    velocity: Led,
    spin: Led,
    /// Place where the cube has stayed, if it was seen inside the zone.
    rest: Option<Rest>,
    /// Number of readings in a row that show contact.
    confirmed: u32,
    /// Period in which the behaviour began.
    first_period: Option<u64>,
    /// Last place of the cube in the world.
    cube: Option<Vector3<f64>>,
    /// Last period in which the cube was seen inside the zone.
    inside: Option<u64>,
    /// Distance before the seat at which the gripper waits (m): [`Order::vicinity`], or less if the
    /// arm does not fold that far.
    vicinity: f64,
    /// Period since which the arm has been refused its path and has not reached the place to wait.
    refused: Option<u64>,
    /// Number of pictures in a row of a frozen approach that show the cube elsewhere, and the
    /// period of the latest one.
    gone: (u32, u64),
    /// Exposure that was ordered last, and the one with which the cube was last seen.
    asked: f64,
    exposure: f64,
}

/// Share of a new measurement in the filtered goal.
const FILTER: f64 = 0.4;
/// Speed per distance to the goal (1/s).
const FOLLOW_GAIN: f64 = 2.5;
/// Largest distance (m) and rotation (rad) from a pose at which the gripper has reached it.
const THERE: (f64, f64) = (0.006, 0.03);

/// Step by which an arm that cannot fold far enough waits nearer after each refusal (m), and the
/// least share of [`Order::vicinity`] that remains: the fingers must not reach the cube yet.
const NEARER: f64 = 0.005;
const NEAREST: f64 = 2.0 / 3.0;

/// Deceleration after the cube was lost (m/s2, rad/s2). Set values then change their speed by 13
/// mm/s in each macrostep, which the wrist measures as 3 N; from 120 mm/s the arm stops within 9
/// mm.
const RUN_OUT: (f64, f64) = (0.8, 4.0);
/// Exposures that are tried in turn while no cube is seen, and the time of each (s). The nominal
/// exposure was not chosen for the light of each workshop.
const EXPOSURES: [f64; 4] = [1.0, 1.0, 1.8, 0.55];
const TRY: f64 = 0.4;
/// Radius of the search around the last place of the cube (m). It covers the way of a hand at 0.25
/// m/s between two pictures, and the lag of the filter.
const REACH: f64 = 0.05;
/// Multiple of [`Order::patience`] for which a cube that never comes to rest is followed.
const RESTLESS: f64 = 5.0;
/// Number of pictures in a row that must show a hidden cube elsewhere. A single pose of a hidden
/// cube may be wrong.
const GONE: u32 = 3;
/// Least distance of a hidden cube that is seen elsewhere, unless [`Order::retreat`] is more, and
/// the farthest that the operator draws it back (m). A cube that is farther off is another one.
const DRAWN: (f64, f64) = (0.05, 0.3);

impl VisualServo {
    /// Makes the generator of the visual servo that `order` describes.
    #[must_use]
    pub fn new(order: Order, compliance: Compliance) -> Self {
        Self {
            order,
            // The approach is faster than that of a grasp, so the order has a virtual mass of its
            // own, which is checked separately.
            compliance: Compliance { linear_inertia: order.inertia, ..compliance },
            stage: Stage::Follow,
            goal: None,
            seen: 0,
            velocity: Led::default(),
            rest: None,
            confirmed: 0,
            first_period: None,
            cube: None,
            inside: None,
            vicinity: order.vicinity,
            refused: None,
            gone: (0, 0),
            spin: Led::default(),
            asked: 1.0,
            exposure: 1.0,
        }
    }

    /// Makes the next macrosteps follow another compliance, with the virtual mass of the order.
    pub(super) fn tune(&mut self, compliance: Compliance) {
        self.compliance = Compliance { linear_inertia: self.order.inertia, ..compliance };
    }

    /// Returns whether the servo goes on after this refusal: a limit of reach, joint, motor or
    /// speed on the path that follows the cube, since a moving cube may come back into reach.
    #[must_use]
    pub fn tolerates(why: &MoveRefused) -> bool {
        matches!(
            why,
            MoveRefused::OutOfReach(_)
                | MoveRefused::JointLimit { .. }
                | MoveRefused::MotorLimit { .. }
                | MoveRefused::TooFast { .. }
        )
    }

    /// Returns the command of the next macrostep, or how the behaviour ended, and how the visual
    /// sensor must look (see [`super::Generator::next`]).
    pub fn next(&mut self, inputs: &Inputs<'_>) -> (Next, Sensing) {
        let next = self.step(inputs);
        (next, self.sensing(inputs))
    }

    /// Returns how the visual sensor must look: in the whole picture and at changing exposures
    /// while the cube is not seen, around its last place while it is.
    fn sensing(&mut self, inputs: &Inputs<'_>) -> Sensing {
        let last_seen =
            if self.goal.is_some() { self.seen } else { self.first_period.unwrap_or(0) };
        let age = inputs.period.saturating_sub(last_seen) as f64 * PERIOD;
        let sensing = match self.cube {
            Some(centre) if age <= self.order.stale => {
                let window = Window::Around { centre, reach: REACH };
                Sensing { window, mode: Mode::Track, exposure: self.exposure }
            }
            _ => {
                // The first turn of each round is the exposure of the last success.
                let turn = (age / TRY) as usize % EXPOSURES.len();
                let exposure = if turn == 0 { self.exposure } else { EXPOSURES[turn] };
                Sensing { exposure, ..Sensing::SEEK }
            }
        };
        self.asked = sensing.exposure;
        sensing
    }

    /// Computes the command of a macrostep, or the end of the behaviour: checks the limits, takes
    /// in the latest pose of the cube, then moves as the present stage requires.
    fn step(&mut self, inputs: &Inputs<'_>) -> Next {
        let first = *self.first_period.get_or_insert(inputs.period);
        if let Some(excess) = self.compliance.excess(inputs.arm) {
            return Next::Done(excess);
        }
        let pose = inputs.arm.desired_base_from_tool;
        // Nearer than `order.frozen` the gripper hides the cube.
        let close = matches!(self.stage, Stage::Approach { .. })
            && self.distance(&pose).is_some_and(|d| d < self.order.frozen);
        let gone = close && self.is_gone(inputs.target);
        // The cube has left the fingers: the gripper backs off before it follows.
        if gone && let Some(goal) = self.goal {
            self.break_off(Stage::BackOff { wait: self.waiting(&goal) });
        }
        let frozen = close && !gone;
        // Before the pose is frozen, the cube must still be at rest: a hand that sways by 2 cm
        // rests at its turns, and an approach that began there ended up to 5 cm beside it.
        if frozen && !self.cube_rests() {
            self.break_off(Stage::Follow);
            return Next::Go(self.hold());
        }
        if !frozen {
            self.look(inputs.target, &pose);
        }
        if let Stage::BackOff { wait } = self.stage {
            // Backing off needs no picture. If the arm folds no farther, it has moved far enough.
            if is_at(&pose, &wait) || inputs.arm.refused.is_some_and(|why| Self::tolerates(&why)) {
                self.break_off(Stage::Follow);
                return Next::Go(self.hold());
            }
            return self.lead(&pose, &wait);
        }
        let last_seen = if self.goal.is_some() { self.seen } else { first };
        let age = inputs.period.saturating_sub(last_seen) as f64 * PERIOD;
        // A frozen approach does not look, so missing pictures do not end it.
        if !frozen && age > self.order.patience {
            return Next::Done(Outcome::LostSight(age));
        }
        // A cube outside the zone is watched, but not for ever.
        let outside = inputs.period.saturating_sub(self.inside.unwrap_or(first)) as f64 * PERIOD;
        if !frozen && self.goal.is_some() && outside > self.order.patience {
            return Next::Done(Outcome::OutOfZone(outside));
        }
        // A cube that is seen well but never at rest is not followed for ever either.
        let total = inputs.period.saturating_sub(first) as f64 * PERIOD;
        if !frozen && total > RESTLESS * self.order.patience {
            return Next::Done(Outcome::TimedOut(total));
        }
        if let Some(why) = inputs.arm.refused.filter(Self::tolerates) {
            return self.handle_refusal(inputs.period, why);
        }
        let Some(goal) = self.goal else { return Next::Go(self.hold()) };
        // The cube may have moved since the last picture, so it must be seen at rest again.
        if !frozen && age > self.order.stale {
            self.rest = None;
            return self.run_out(&pose);
        }
        if let Stage::Approach { began_at } = self.stage {
            self.approach(inputs, &goal, began_at, frozen)
        } else {
            self.follow(inputs, &goal)
        }
    }

    /// Reacts to a refused command: the arm stops, and tries again in the next macrostep. If the
    /// cube is at rest, the arm then waits nearer to it. The behaviour ends after
    /// [`Order::patience`] of refusals.
    ///
    /// During an approach the behaviour ends at once, because a retry would come back to the same
    /// place.
    fn handle_refusal(&mut self, period: u64, why: MoveRefused) -> Next {
        let since = *self.refused.get_or_insert(period);
        let long = period.saturating_sub(since) as f64 * PERIOD > self.order.patience;
        if long || matches!(self.stage, Stage::Approach { .. }) {
            return Next::Done(Outcome::OutOfReach(why));
        }
        // The refused step was not made, so its speed is not continued.
        self.stop();
        if self.cube_rests() {
            self.vicinity = (self.vicinity - NEARER).max(NEAREST * self.order.vicinity);
        }
        Next::Go(self.hold())
    }

    /// Returns whether several pictures in a row show the cube away from the goal, which is no
    /// longer updated in the last part of an approach.
    fn is_gone(&mut self, target: Option<&Target>) -> bool {
        let (Some(target), Some(goal)) = (target, self.goal) else { return false };
        // Place of the cube by the frozen goal, to which the gripper moves.
        let hidden = self.order.world_from_base * goal * Point3::new(0.0, 0.0, self.order.seat);
        let (times, last) = self.gone;
        if target.period > last.max(self.seen) {
            // Pictures that are far apart in time do not confirm each other.
            let in_a_row = (target.period - last) as f64 * PERIOD <= self.order.stale;
            let moved = (target.world_from_cube.translation.vector - hidden.coords).norm();
            let is_off = moved > self.order.retreat.max(DRAWN.0) && moved < DRAWN.1;
            let before = if in_a_row { times } else { 0 };
            self.gone = (if is_off { before + 1 } else { 0 }, target.period);
        }
        self.gone.0 >= GONE
    }

    /// Stops and changes to `stage`. Before the next approach the cube must be seen at rest again.
    fn break_off(&mut self, stage: Stage) {
        self.stage = stage;
        self.stop();
        (self.rest, self.gone) = (None, (0, 0));
    }

    /// Returns the `base_from_tool` in which the gripper waits before an approach to `goal`.
    fn waiting(&self, goal: &Pose) -> Pose {
        goal * Pose::translation(0.0, 0.0, -self.vicinity)
    }

    /// Sets both velocities to zero.
    fn stop(&mut self) {
        (self.velocity, self.spin) = (Led::default(), Led::default());
    }

    /// Returns the command that holds the tool for a macrostep.
    fn hold(&self) -> MoveCommand {
        MoveCommand { motion: Motion::Hold, periods: self.compliance.macrostep, jaw: None }
    }

    /// Returns the length of a macrostep (s).
    fn step_seconds(&self) -> f64 {
        f64::from(self.compliance.macrostep) * PERIOD
    }

    /// Returns the distance along the tool's z from `pose` to the goal (m), if there is a goal.
    fn distance(&self, pose: &Pose) -> Option<f64> {
        self.goal.map(|goal| (pose.inverse() * goal).translation.z)
    }

    /// Takes in the latest measured pose of the cube: filters the goal and updates whether the cube
    /// is at rest. `pose` is the present set pose of the tool.
    fn look(&mut self, target: Option<&Target>, pose: &Pose) {
        let Some(target) = target else { return };
        if target.period == self.seen {
            return;
        }
        if (target.period.saturating_sub(self.seen)) as f64 * PERIOD > self.order.stale {
            // The cube may have moved and come back in the meantime.
            self.rest = None;
        }
        self.seen = target.period;
        // The sensor has found the cube with this exposure.
        self.exposure = self.asked;
        let base_from_world = self.order.world_from_base.inverse();
        let seen = target.world_from_cube.translation.vector;
        self.cube = Some(seen);
        let (world_from_zone, half) = self.order.zone;
        let local = world_from_zone.inverse_transform_point(&Point3::from(seen));
        // The goal stays inside the zone, at the place nearest to the cube.
        let nearest = Point3::from(local.coords.zip_map(&half, |x, h| x.clamp(-h, h)));
        let is_inside = nearest == local;
        if is_inside {
            self.inside = Some(target.period);
        }
        let within =
            Pose::from_parts((world_from_zone * nearest).into(), target.world_from_cube.rotation);
        let cube = base_from_world * within;
        let approach = base_from_world.rotation * self.order.approach;
        let jaws = base_from_world.rotation * self.order.jaws;
        let rotation = grasp_rotation(&cube.rotation, &approach, &jaws);
        let wanted = Pose::from_parts(
            (cube.translation.vector - rotation * Vector3::z() * self.order.seat).into(),
            rotation,
        );
        // A filter reduces the noise of the pose. The goal takes the nearer one of the two
        // orientations in which a gripper looks the same.
        let goal = match self.goal {
            Some(old) => Pose::from_parts(
                old.translation.vector.lerp(&wanted.translation.vector, FILTER).into(),
                old.rotation.slerp(&half_turn_nearest(&wanted.rotation, &old.rotation), FILTER),
            ),
            None => Pose::from_parts(
                wanted.translation,
                half_turn_nearest(&wanted.rotation, &pose.rotation),
            ),
        };
        self.goal = Some(goal);
        // Rest is judged by the place and not by the speed: a pose that jitters by a millimetre
        // seems to move for ever. A cube that was held still was once followed for 300 s and never
        // approached.
        let stays = |s: &Rest| (seen - s.at).norm() <= self.order.still;
        if !is_inside || !self.rest.as_ref().is_some_and(stays) {
            self.rest = is_inside.then_some(Rest { at: seen, since: target.period });
            self.vicinity = self.order.vicinity;
        }
    }

    /// Returns whether the cube has been seen at rest for [`Order::still_seconds`].
    fn cube_rests(&self) -> bool {
        let seconds = |s: Rest| self.seen.saturating_sub(s.since) as f64 * PERIOD;
        self.rest.is_some_and(|s| seconds(s) > self.order.still_seconds)
    }

    /// Returns the command towards the pose in which the gripper waits. If the gripper is there and
    /// the cube is at rest, begins the approach and returns its first command.
    fn follow(&mut self, inputs: &Inputs<'_>, goal: &Pose) -> Next {
        let pose = inputs.arm.desired_base_from_tool;
        let wait = self.waiting(goal);
        let is_there = is_at(&pose, &wait);
        if is_there {
            self.refused = None;
        }
        if is_there && self.cube_rests() {
            self.stage = Stage::Approach { began_at: goal.translation.vector };
            // Pictures from before the approach do not count.
            self.gone.0 = 0;
            return self.approach(inputs, goal, goal.translation.vector, false);
        }
        self.lead(&pose, &wait)
    }

    /// Returns the command that moves the tool for one macrostep from `pose` towards the pose `to`.
    fn lead(&mut self, pose: &Pose, to: &Pose) -> Next {
        let step = self.step_seconds();
        let (way, turn) = way_and_turn(pose, to);
        let (linear, angular) = self.order.speed;
        let acceleration = self.order.acceleration;
        self.velocity = self.velocity.towards(way, linear, acceleration, step);
        // The angular speed is reached as soon as the linear one. If a cube turns past 45 deg,
        // other sides are grasped and the tool turns all the way back. Without a limit of the
        // acceleration, axis 6 would not follow.
        let angular_acceleration = acceleration * angular / linear;
        self.spin = self.spin.towards(turn, angular, angular_acceleration, step);
        self.go_on(pose)
    }

    /// Decelerates to rest within some tenths of a second. The force sensor would measure an abrupt
    /// stop as a blow, and five blows in a row as an oscillation.
    fn run_out(&mut self, pose: &Pose) -> Next {
        let step = self.step_seconds();
        self.velocity = self.velocity.running_out(RUN_OUT.0 * step);
        self.spin = self.spin.running_out(RUN_OUT.1 * step);
        if self.velocity.rests() && self.spin.rests() {
            return Next::Go(self.hold());
        }
        self.go_on(pose)
    }

    /// Returns the command that moves the tool on from `pose` for a macrostep at the present
    /// velocities.
    fn go_on(&self, pose: &Pose) -> Next {
        let step = self.step_seconds();
        let next = Pose::from_parts(
            (pose.translation.vector + self.velocity.velocity * step).into(),
            UnitQuaternion::from_scaled_axis(self.spin.velocity * step) * pose.rotation,
        );
        Next::Go(MoveCommand {
            motion: Motion::Pose(next),
            periods: self.compliance.macrostep,
            jaw: None,
        })
    }

    /// Moves compliantly towards the goal until the gripper touches the cube. Goes back to
    /// following if the goal has moved away from `began_at`, its place at the beginning of the
    /// approach. `frozen` means that the goal is no longer updated, because the gripper hides the
    /// cube.
    fn approach(
        &mut self,
        inputs: &Inputs<'_>,
        goal: &Pose,
        began_at: Vector3<f64>,
        frozen: bool,
    ) -> Next {
        let order = self.order;
        if !frozen && (goal.translation.vector - began_at).norm() > order.retreat {
            self.break_off(Stage::Follow);
            return Next::Go(self.hold());
        }
        self.confirmed =
            if inputs.arm.wrench_in_tool.force.z > order.touch { self.confirmed + 1 } else { 0 };
        let left = inputs.arm.desired_base_from_tool.inverse() * goal;
        // Contact needs two readings in a row, since a single one may be noise.
        if self.confirmed >= 2 {
            return Next::Done(Outcome::Touched(left.translation.z));
        }
        if left.translation.z < -order.overrun {
            return Next::Done(Outcome::NotTouched);
        }
        let limit = order.approach_speed;
        let c = &self.compliance;
        // Sideways and in rotation the gripper follows the goal and yields to the cube.
        let linear = |error: f64| Direction::Guarded {
            velocity: (FOLLOW_GAIN * error).clamp(-limit, limit),
            admittance: c.linear_admittance,
            inertia: c.linear_inertia,
        };
        let angular = |error: f64| Direction::Guarded {
            velocity: (FOLLOW_GAIN * error).clamp(-0.2, 0.2),
            admittance: c.angular_admittance,
            inertia: c.angular_inertia,
        };
        let rotation = left.rotation.scaled_axis();
        // The gripper is slower for the last 3 cm, where contact is expected.
        let forward = if left.translation.z < 0.03 { limit * 0.5 } else { limit };
        let directions = [
            linear(left.translation.x),
            linear(left.translation.y),
            if self.confirmed > 0 {
                // The hand holds until a second reading confirms the contact.
                Direction::HOLD
            } else {
                c.guarded(forward, order.touch)
            },
            angular(rotation.x),
            angular(rotation.y),
            angular(rotation.z),
        ];
        Next::Go(self.compliance.task(directions, None))
    }
}

/// Returns the distance vector (m) and the rotation vector (rad) that lead from one pose to
/// another.
fn way_and_turn(from: &Pose, to: &Pose) -> (Vector3<f64>, Vector3<f64>) {
    let way = to.translation.vector - from.translation.vector;
    (way, from.rotation.rotation_to(&to.rotation).scaled_axis())
}

/// Returns whether a gripper at `pose` has reached the pose `wanted`: see [`THERE`].
fn is_at(pose: &Pose, wanted: &Pose) -> bool {
    let (way, turn) = way_and_turn(pose, wanted);
    way.norm() < THERE.0 && turn.norm() < THERE.1
}

/// Velocity of a set value that is led to a goal, and its acceleration: m/s and m/s2, or rad/s and
/// rad/s2.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Led {
    velocity: Vector3<f64>,
    acceleration: Vector3<f64>,
}

impl Led {
    /// Time in which the acceleration rises from 0 to its limit (s).
    const RISES: f64 = 0.1;
    /// Share of the acceleration with which the speed before the goal is planned. The rest makes up
    /// for the time in which the acceleration changes.
    const BRAKES: f64 = 0.7;

    /// Returns the velocity after one more step of `step` seconds on the remaining distance vector
    /// `way` (m, rad). It stays within the speed `most` and the acceleration, the acceleration
    /// changes by its limit in [`Led::RISES`] at most, and the speed is low enough to stop within
    /// the remaining distance.
    fn towards(self, way: Vector3<f64>, most: f64, acceleration: f64, step: f64) -> Self {
        let left = way.norm();
        // The speed is proportional to the distance near the goal, at most `most`, and low enough
        // to stop on the remaining distance.
        let stops = (2.0 * Self::BRAKES * acceleration * left).sqrt();
        let speed = (FOLLOW_GAIN * left).min(most).min(stops);
        let wanted = if left > 1e-9 { way * (speed / left) } else { Vector3::zeros() };
        let missing = wanted - self.velocity;
        let jerk = acceleration / Self::RISES;
        // With this acceleration the missing velocity is reached just when the acceleration is back
        // at 0; a higher one would overshoot.
        let reaches = (2.0 * jerk * missing.norm()).sqrt();
        let aim = (missing / step).cap_magnitude(acceleration.min(reaches));
        let change = (aim - self.acceleration).cap_magnitude(jerk * step);
        let acceleration = self.acceleration + change;
        // A sum of steps may exceed the speed by the rounding of one step.
        let velocity = (self.velocity + acceleration * step).cap_magnitude(most);
        Self { velocity, acceleration }
    }

    /// Returns the velocity after a step in which it falls by `by` (m/s, rad/s), at most to rest.
    fn running_out(self, by: f64) -> Self {
        let speed = self.velocity.norm();
        let velocity =
            if speed > by { self.velocity * ((speed - by) / speed) } else { Vector3::zeros() };
        Self { velocity, acceleration: Vector3::zeros() }
    }

    /// Returns whether the velocity is zero.
    fn rests(&self) -> bool {
        self.velocity == Vector3::zeros()
    }
}

/// Returns the orientation of the tool whose z is the axis of the cube nearest to `approach`, and
/// whose y is the one nearest to `jaws`.
#[must_use]
pub fn grasp_rotation(
    cube: &UnitQuaternion<f64>,
    approach: &Vector3<f64>,
    jaws: &Vector3<f64>,
) -> UnitQuaternion<f64> {
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()].map(|a| cube * a);
    // Each axis counts in both senses, and the sense along the wanted direction is taken.
    let nearest = |wanted: &Vector3<f64>, not: Option<usize>| {
        let mut best = (0, 0.0_f64);
        for (i, axis) in axes.iter().enumerate() {
            let along = axis.dot(wanted);
            if Some(i) != not && along.abs() > best.1.abs() {
                best = (i, along);
            }
        }
        (best.0, axes[best.0] * best.1.signum())
    };
    let (used, z) = nearest(approach, None);
    let (_, y) = nearest(jaws, Some(used));
    pose_from_axes(y.cross(&z), y, z, Point3::origin()).rotation
}

/// Returns `wanted`, or `wanted` rolled by half a turn about its z, whichever is nearer to the
/// orientation `to`: a gripper looks the same after half a roll.
fn half_turn_nearest(
    wanted: &UnitQuaternion<f64>,
    to: &UnitQuaternion<f64>,
) -> UnitQuaternion<f64> {
    let rolled = wanted * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI);
    if wanted.angle_to(to) <= rolled.angle_to(to) { *wanted } else { rolled }
}

#[cfg(test)]
mod tests {
    use super::super::testing::compliance;
    use super::*;
    use crate::motion::ArmState;

    /// Speed limit of [`order`] (m/s).
    const SPEED: f64 = 0.25;
    /// Length of a macrostep (s).
    const STEP: f64 = 0.016;
    /// Distance from the tool point to the centre of a cube at the palm, in [`order`] (m).
    const SEAT: f64 = 0.019;
    /// Distance from the seat at which the gripper waits, in [`order`] (m).
    const VICINITY: f64 = 0.1;

    /// Returns an order to take a cube along x, whose zone is a box with edges of 0.4 m around x =
    /// 1 m, z = 1.2 m.
    fn order() -> Order {
        Order {
            world_from_base: Pose::identity(),
            approach: Vector3::x(),
            jaws: Vector3::z(),
            seat: SEAT,
            vicinity: VICINITY,
            frozen: 0.08,
            still: 0.005,
            still_seconds: 0.5,
            retreat: 0.05,
            speed: (SPEED, 0.5),
            acceleration: 0.5,
            approach_speed: 0.02,
            touch: 3.0,
            inertia: 20.0,
            overrun: 0.015,
            stale: 0.1,
            patience: 5.0,
            zone: (Pose::translation(1.0, 0.0, 1.2), Vector3::new(0.2, 0.2, 0.2)),
        }
    }

    #[test]
    fn led_velocity_keeps_limits_and_stops_at_goal() {
        let (most, acceleration, step) = (SPEED, 0.6, STEP);
        let (mut at, mut led) = (Vector3::zeros(), Led::default());
        let goal = Vector3::new(0.3, -0.4, 0.2);
        let mut fastest = 0.0_f64;
        for _ in 0..400 {
            let before = led;
            led = led.towards(goal - at, most, acceleration, step);
            at += led.velocity * step;
            fastest = fastest.max(led.velocity.norm());
            assert!(led.velocity.norm() < 1.01 * most, "{led:?}");
            assert!(led.acceleration.norm() < 1.001 * acceleration, "{led:?}");
            let jerk = (led.acceleration - before.acceleration).norm() / step;
            assert!(jerk < 1.001 * acceleration / Led::RISES, "{jerk}");
            // It never passes the goal.
            assert!((goal - at).dot(&goal) > -1e-4, "{at}");
        }
        assert!(fastest > 0.99 * most && (goal - at).norm() < 1e-4, "{fastest} {at}");
    }

    /// The cube moves all the time, so the servo gives up in the end.
    #[test]
    fn following_a_restless_cube_times_out() {
        let (_, outcome) = run(|period| {
            let y = 0.1 * (period as f64 * 0.002).sin();
            let world_from_cube = Pose::translation(1.0, y, 1.2);
            Some(Target { world_from_cube, speed: 0.1, period })
        });

        assert!(matches!(outcome, Outcome::TimedOut(seconds) if seconds > 24.0), "{outcome:?}");
    }

    /// Runs the generator against an arm that follows perfectly. Returns the final pose and
    /// outcome.
    fn run(cube: impl Fn(u64) -> Option<Target>) -> (Pose, Outcome) {
        run_watched(cube, |_, _| ())
    }

    /// Runs the generator like [`run`], and calls `watch` with each period and the position of the
    /// tool.
    fn run_watched(
        cube: impl Fn(u64) -> Option<Target>,
        watch: impl Fn(u64, Vector3<f64>),
    ) -> (Pose, Outcome) {
        let rotation = grasp_rotation(&UnitQuaternion::identity(), &Vector3::x(), &Vector3::z());
        let mut arm = ArmState {
            desired_base_from_tool: Pose::from_parts(Vector3::new(0.5, 0.1, 1.0).into(), rotation),
            ..ArmState::default()
        };
        let mut generator = VisualServo::new(order(), compliance());
        let mut latest = None;
        for step in 0..5000_u64 {
            let period = step * 8;
            watch(period, arm.desired_base_from_tool.translation.vector);
            if period % 20 < 8 {
                latest = cube(period / 20 * 20).or(latest);
            }
            let inputs =
                Inputs { arm: &arm, target: latest.as_ref(), reading: None, period, pace: 1.0 };
            match generator.next(&inputs).0 {
                Next::Done(outcome) => return (arm.desired_base_from_tool, outcome),
                Next::Go(MoveCommand { motion: Motion::Pose(pose), .. }) => {
                    let way =
                        pose.translation.vector - arm.desired_base_from_tool.translation.vector;
                    assert!(way.norm() <= SPEED * STEP + 1e-9, "bounded step");
                    arm.desired_base_from_tool = pose;
                }
                Next::Go(MoveCommand { motion: Motion::Task { directions, .. }, .. }) => {
                    let v = directions.map(|d| match d {
                        Direction::Guarded { velocity, .. } | Direction::Unguarded { velocity } => {
                            velocity
                        }
                        Direction::Contact { .. } => 0.0,
                    });
                    arm.desired_base_from_tool *=
                        crate::spatial::Twist::from_directions(v.map(|c| c * STEP)).displacement();
                }
                Next::Go(_) => {}
            }
        }
        panic!("the servo never ends");
    }

    #[test]
    fn search_varies_exposure_and_tracking_keeps_it() {
        let arm = ArmState::default();
        let mut generator = VisualServo::new(order(), compliance());
        let mut ask = |period: u64, target: Option<&Target>| {
            generator.next(&Inputs { arm: &arm, target, reading: None, period, pace: 1.0 }).1
        };
        let tried: Vec<_> = (0..110).map(|step| ask(step * 8, None)).collect();

        assert!(tried.iter().all(|s| s.window == Window::Whole && s.mode == Mode::Seek));
        assert!(tried.iter().any(|s| s.exposure > 1.5) && tried.iter().any(|s| s.exposure < 0.6));

        // The cube is seen with the bright exposure, which is then kept, at this place only.
        let bright = tried.iter().rposition(|s| s.exposure > 1.5).unwrap() as u64 * 8;
        let pose = Pose::translation(1.0, 0.1, 1.2);
        let target = Target { world_from_cube: pose, speed: 0.0, period: bright };
        let mut generator = VisualServo::new(order(), compliance());
        for step in 0..=bright / 8 {
            generator.next(&Inputs {
                arm: &arm,
                target: None,
                reading: None,
                period: step * 8,
                pace: 1.0,
            });
        }
        let seen = generator
            .next(&Inputs {
                arm: &arm,
                target: Some(&target),
                reading: None,
                period: bright + 8,
                pace: 1.0,
            })
            .1;

        assert_eq!((seen.mode, seen.exposure), (Mode::Track, 1.8));
        let Window::Around { centre, .. } = seen.window else { panic!("{seen:?}") };
        assert!((centre - pose.translation.vector).norm() < 1e-9, "{centre}");
    }

    #[test]
    fn cube_at_rest_is_reached() {
        let target = |period| {
            Some(Target { world_from_cube: Pose::translation(1.0, 0.0, 1.2), speed: 0.0, period })
        };
        let (pose, outcome) = run(target);

        // No contact ends the approach here: the gripper overruns the seat, and the servo reports
        // that nothing was touched.
        assert_eq!(outcome, Outcome::NotTouched);
        let tip = pose * Point3::new(0.0, 0.0, SEAT);
        assert!(tip.y.abs() < 1e-3 && (tip.z - 1.2).abs() < 1e-3, "{tip}");
        assert!((tip.x - (1.0 + order().overrun)).abs() < 2e-3, "{tip}");
    }

    /// The pose jitters by 1 mm, which looks like a speed of 50 mm/s.
    #[test]
    fn cube_with_jittering_pose_is_approached() {
        let (_, outcome) = run(|period| {
            let y = if period % 40 < 20 { 1e-3 } else { -1e-3 };
            let world_from_cube = Pose::translation(1.0, y, 1.2);
            Some(Target { world_from_cube, speed: 0.05, period })
        });

        assert_eq!(outcome, Outcome::NotTouched);
    }

    /// The hand sways by 20 mm, so the cube almost rests at its turns.
    #[test]
    fn swaying_cube_is_not_approached() {
        let (_, outcome) = run(|period| {
            let y = 0.02 * (std::f64::consts::FRAC_PI_2 * period as f64 * PERIOD).cos();
            let world_from_cube = Pose::translation(1.0, y, 1.2);
            Some(Target { world_from_cube, speed: 0.0, period })
        });

        assert!(matches!(outcome, Outcome::TimedOut(_)), "{outcome:?}");
    }

    /// The gripper waits for a cube outside as if the cube were at the nearest place inside the
    /// zone.
    #[test]
    fn arm_waits_at_zone_edge_for_cube_outside() {
        let at = |x: f64, period| {
            Some(Target { world_from_cube: Pose::translation(x, 0.0, 1.2), speed: 0.0, period })
        };

        let (pose, outcome) = run(|period| at(1.5, period));
        assert!(matches!(outcome, Outcome::OutOfZone(seconds) if seconds > 5.0), "{outcome:?}");
        // The vicinity of a cube at the edge, 1.2 m.
        assert!((pose.translation.x - (1.2 - SEAT - VICINITY)).abs() < 0.01, "{pose}");

        let (_, outcome) = run(|period| at(if period < 2000 { 1.5 } else { 1.1 }, period));
        assert_eq!(outcome, Outcome::NotTouched);
    }

    #[test]
    fn moving_cube_is_followed_but_not_approached() {
        let y = |period: u64| 0.1 * (period as f64 * 0.002).sin();
        let target = |period: u64| {
            let pose = Pose::translation(1.0, y(period), 1.2);
            (period < 8_000).then_some(Target { world_from_cube: pose, speed: 0.1, period })
        };
        let off = std::cell::Cell::new(0.0_f64);
        let (pose, outcome) = run_watched(target, |period, place| {
            // The tool has reached the cube's vicinity, and follows half a second behind the cube.
            if (2_000..8_000).contains(&period) {
                let wait = Vector3::new(1.0 - SEAT - VICINITY, y(period), 1.2);
                off.set(off.get().max((place - wait).norm()));
            }
        });

        assert!(matches!(outcome, Outcome::LostSight(_)));
        assert!(off.get() < 0.06, "{} m behind", off.get());
        assert!(pose.translation.x < 1.0 - SEAT - order().frozen, "kept its distance: {pose}");
    }

    /// Runs the generator against an arm that refuses places nearer to its base than `least` or
    /// farther than `most` (m). Returns the outcome and the place at the end.
    fn run_within(
        (least, most): (f64, f64),
        cube: impl Fn(u64) -> Target,
    ) -> (Outcome, Vector3<f64>) {
        let rotation = grasp_rotation(&UnitQuaternion::identity(), &Vector3::x(), &Vector3::z());
        let mut arm = ArmState {
            desired_base_from_tool: Pose::from_parts(Vector3::new(0.85, 0.0, 1.2).into(), rotation),
            ..ArmState::default()
        };
        let mut generator = VisualServo::new(order(), compliance());
        for step in 0..5000_u64 {
            let period = step * 8;
            let target = cube(period);
            let inputs =
                Inputs { arm: &arm, target: Some(&target), reading: None, period, pace: 1.0 };
            let next = match generator.next(&inputs).0 {
                Next::Done(outcome) => {
                    return (outcome, arm.desired_base_from_tool.translation.vector);
                }
                Next::Go(MoveCommand { motion: Motion::Pose(pose), .. }) => pose,
                Next::Go(MoveCommand { motion: Motion::Task { directions, .. }, .. }) => {
                    let Direction::Guarded { velocity, .. } = directions[2] else { panic!() };
                    arm.desired_base_from_tool * Pose::translation(0.0, 0.0, velocity * STEP)
                }
                Next::Go(_) => arm.desired_base_from_tool,
            };
            let x = next.translation.x;
            arm.refused = (!(least..=most).contains(&x)).then_some(MoveRefused::OutOfReach(x));
            if arm.refused.is_none() {
                arm.desired_base_from_tool = next;
            }
        }
        panic!("the servo never ends");
    }

    #[test]
    fn approach_holds_while_contact_is_confirmed() {
        let mut generator = VisualServo::new(order(), compliance());
        let (mut arm, goal) = (ArmState::default(), Pose::translation(0.0, 0.0, 0.05));
        let mut goes = |force: f64| {
            arm.wrench_in_tool.force.z = force;
            let inputs = Inputs { arm: &arm, target: None, reading: None, period: 0, pace: 1.0 };
            match generator.approach(&inputs, &goal, goal.translation.vector, false) {
                Next::Go(MoveCommand { motion: Motion::Task { directions, .. }, .. }) => {
                    directions[2] != Direction::HOLD
                }
                other => panic!("{other:?}"),
            }
        };

        assert_eq!([0.0, 5.0, 0.0].map(&mut goes), [true, false, true]);
    }

    /// The arm waits at its limit until the cube comes back, or until its patience ends.
    #[test]
    fn arm_at_its_limit_waits_for_the_cube() {
        let at = |x: f64, period| {
            let world_from_cube = Pose::translation(x, 0.0, 1.2);
            Target { world_from_cube, speed: 0.0, period }
        };
        let span = (0.5, 1.02);

        // For a cube at 1.18 m the place to wait would be at 1.06 m.
        let (outcome, _) =
            run_within(span, |period| at(if period < 1500 { 1.18 } else { 1.0 }, period));
        assert_eq!(outcome, Outcome::NotTouched, "there, and nothing pushes back");

        let (outcome, place) = run_within(span, |period| at(1.18, period));
        assert!(matches!(outcome, Outcome::OutOfReach(MoveRefused::OutOfReach(_))), "{outcome:?}");
        assert!(place.x > 1.0, "as far as it goes: {place}");
    }

    /// An arm that cannot fold back to the usual waiting distance waits nearer to a cube at rest,
    /// but not nearer than two thirds of that distance.
    #[test]
    fn arm_near_its_limit_waits_closer_to_cube() {
        let cube = |speed: f64| {
            move |period| Target {
                world_from_cube: Pose::translation(
                    0.85,
                    speed * (period as f64 * PERIOD).sin(),
                    1.2,
                ),
                speed,
                period,
            }
        };
        // The usual place to wait is at 0.731 m, the nearest one at 0.764 m.
        let from = |least: f64| run_within((least, 2.0), cube(0.0)).0;

        assert_eq!(from(0.755), Outcome::NotTouched);
        assert!(matches!(from(0.775), Outcome::OutOfReach(_)));
        let (outcome, place) = run_within((0.755, 2.0), cube(0.1));
        assert!(matches!(outcome, Outcome::OutOfReach(_)), "it does not stand still: {outcome:?}");
        assert!(place.x < 0.765, "it keeps its distance: {place}");
    }

    #[test]
    fn reach_limit_ends_approach_at_once() {
        let last = std::cell::Cell::new(0);
        let cube = |period| {
            last.set(period);
            Target { world_from_cube: Pose::translation(1.0, 0.0, 1.2), speed: 0.0, period }
        };

        let (outcome, place) = run_within((0.5, 0.95), cube);

        assert!(matches!(outcome, Outcome::OutOfReach(_)), "{outcome:?}");
        // The arm is at the limit after 5 s, and its patience would last for 5 s more.
        assert!(last.get() < 3500, "at once: {last:?}");
        assert!(place.x > 0.94 && place.x <= 0.95, "{place}");
    }

    /// Approaches a cube whose lateral position is what `seen_at` returns for a period (m), `None`
    /// without a picture. Returns the lateral position of the tool at the end (m), and the smallest
    /// x to which the tool moves back after 6 s while it is in front of lateral position 0 (m).
    /// From 4.8 s on the gripper is too near to look, and at 9 s it would reach the seat. Pictures
    /// come every 40 ms.
    fn reached(seen_at: impl Fn(u64) -> Option<f64>) -> (f64, f64) {
        let least = std::cell::Cell::new(f64::INFINITY);
        let (pose, outcome) = run_watched(
            |period| {
                let world_from_cube = Pose::translation(1.0, seen_at(period)?, 1.2);
                Some(Target { world_from_cube, speed: 0.0, period })
            },
            |period, place| {
                if period > 3000 {
                    // A tool that has moved sideways is no longer in front of the cube's first
                    // place.
                    let beside = if place.y.abs() < 5e-3 { place.x } else { f64::INFINITY };
                    least.set(least.get().min(beside));
                }
            },
        );
        assert_eq!(outcome, Outcome::NotTouched);
        (pose.translation.y, least.get())
    }

    /// The person pulls the cube out from between the fingers. The hand first moves straight back.
    /// Single pictures of the cube at another place do not count.
    #[test]
    fn arm_follows_cube_pulled_from_between_fingers() {
        // Periods from which on the cube is elsewhere: while the servo looks, at the end of that
        // time, and later.
        let from = [1500, 1900, 1940, 1980, 2020, 2060, 2100, 2140, 2180, 2220, 2400, 3000];
        for from in from {
            let (y, _) = reached(|period| Some(if period < from { 0.0 } else { 0.12 }));
            assert!((y - 0.12).abs() < 2e-3, "from {from}: {y}");
        }
        let (_, x) = reached(|period| Some(if period < 3000 { 0.0 } else { 0.12 }));
        // It may move sideways only from the place where it waits.
        assert!(x < 1.0 - SEAT - VICINITY + 2.0 * THERE.0, "{x}");

        let stays: [fn(u64) -> Option<f64>; 4] = [
            // Two pictures of another place and a third one long after, with good pictures or none
            // in between.
            |p| Some(if (2400..2440).contains(&p) || p == 2700 { 0.12 } else { 0.0 }),
            |p| match p {
                0..2400 => Some(0.0),
                2400..2440 | 2700 => Some(0.12),
                _ => None,
            },
            // A cube as far off as a hidden one may seem, and one farther off than an operator
            // draws it.
            |p| Some(if p < 2400 { 0.0 } else { 0.04 }),
            |p| Some(if p < 2400 { 0.0 } else { 0.6 }),
        ];
        for seen in stays {
            let (y, x) = reached(seen);
            assert!(y.abs() < 2e-3 && x > 0.9, "{y} {x}");
        }
    }

    /// The hand moves all the way back, although the pictures stop when it begins to move.
    #[test]
    fn hand_finishes_backing_off_without_new_pictures() {
        let (pose, outcome) = run(|period| {
            let world_from_cube =
                Pose::translation(1.0, if period < 2400 { 0.0 } else { 0.12 }, 1.2);
            (period < 2480).then_some(Target { world_from_cube, speed: 0.0, period })
        });

        assert!(matches!(outcome, Outcome::LostSight(_)), "{outcome:?}");
        let off = pose.translation.vector - Vector3::new(1.0 - SEAT - VICINITY, 0.0, 1.2);
        assert!(off.norm() < 2.0 * THERE.0, "{off}");
    }

    /// An arm that cannot move back any farther follows the cube again from where it is.
    #[test]
    fn refused_back_off_resumes_following() {
        let mut generator = VisualServo::new(order(), compliance());
        generator.stage = Stage::BackOff { wait: Pose::translation(0.5, 0.0, 1.2) };
        let mut arm = ArmState::default();
        let mut next = |arm: &ArmState, period| {
            let (next, _) =
                generator.next(&Inputs { arm, target: None, reading: None, period, pace: 1.0 });
            (next, generator.stage)
        };

        let (goes, stage) = next(&arm, 8);
        assert!(matches!(goes, Next::Go(MoveCommand { motion: Motion::Pose(_), .. })), "{goes:?}");
        assert!(matches!(stage, Stage::BackOff { .. }));
        arm.refused = Some(MoveRefused::OutOfReach(0.5));
        let (goes, stage) = next(&arm, 16);
        assert!(matches!(goes, Next::Go(MoveCommand { motion: Motion::Hold, .. })), "{goes:?}");
        assert_eq!(stage, Stage::Follow);
    }

    /// When the cube turns past 45 deg, its other sides become the nearest ones, so the tool turns
    /// all the way back to grasp them.
    #[test]
    fn tool_rotation_keeps_speed_and_acceleration_limits() {
        let rotation = grasp_rotation(&UnitQuaternion::identity(), &Vector3::x(), &Vector3::z());
        let mut arm = ArmState {
            desired_base_from_tool: Pose::from_parts(Vector3::new(0.85, 0.0, 1.2).into(), rotation),
            ..ArmState::default()
        };
        let mut generator = VisualServo::new(order(), compliance());
        let (mut spin, mut fastest, mut turned_back) = (Vector3::zeros(), 0.0_f64, false);
        for step in 1..500_u64 {
            let period = step * 8;
            // The cube turns to and fro past 45 deg, where another of its sides is the nearest.
            let angle = 0.9 * (period as f64 * 0.002).sin();
            let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), angle);
            // The cube moves up and down, so that it is not approached.
            let z = 1.2 + 0.01 * (period as f64 * 0.01).sin();
            let world_from_cube = Pose::from_parts(Vector3::new(1.0, 0.0, z).into(), turn);
            let target = Target { world_from_cube, speed: 0.1, period };
            let inputs =
                Inputs { arm: &arm, target: Some(&target), reading: None, period, pace: 1.0 };
            let Next::Go(MoveCommand { motion: Motion::Pose(pose), .. }) =
                generator.next(&inputs).0
            else {
                panic!("the arm does not follow");
            };
            let before = arm.desired_base_from_tool.rotation;
            let next = before.rotation_to(&pose.rotation).scaled_axis() / STEP;
            // The limits of the rotation are 0.5 rad/s and, in proportion to the linear one, 1
            // rad/s2.
            assert!((next - spin).norm() <= 1.0 * STEP + 1e-6, "{spin} {next}");
            assert!(next.norm() <= 0.5 + 1e-6);
            turned_back |= next.dot(&spin) < 0.0 || (spin.x > 0.0) != (next.x > 0.0);
            fastest = fastest.max(next.norm());
            spin = next;
            arm.desired_base_from_tool = pose;
        }
        assert!(fastest > 0.3 && turned_back, "{fastest}");
    }

    #[test]
    fn arm_stops_smoothly_when_pictures_end() {
        let mut arm = ArmState {
            desired_base_from_tool: Pose::from_parts(
                Vector3::new(0.3, 0.0, 1.2).into(),
                grasp_rotation(&UnitQuaternion::identity(), &Vector3::x(), &Vector3::z()),
            ),
            ..ArmState::default()
        };
        let mut generator = VisualServo::new(order(), compliance());
        let (mut speeds, mut held) = (vec![0.0], false);
        for step in 1..200_u64 {
            let (period, before) = (step * 8, arm.desired_base_from_tool.translation.vector);
            let world_from_cube = Pose::translation(1.0, 0.0, 1.2);
            let target = Target { world_from_cube, speed: 0.0, period };
            // The last picture is of the 60th macrostep.
            let target = (step <= 60).then_some(&target);
            let inputs = Inputs { arm: &arm, target, reading: None, period, pace: 1.0 };
            match generator.next(&inputs).0 {
                Next::Go(MoveCommand { motion: Motion::Pose(pose), .. }) => {
                    arm.desired_base_from_tool = pose;
                }
                Next::Go(_) => held |= step > 60,
                Next::Done(outcome) => panic!("{outcome:?}"),
            }
            let after = arm.desired_base_from_tool.translation.vector;
            speeds.push((after - before).norm() / STEP);
        }

        let fastest = speeds.iter().fold(0.0_f64, |most, speed| most.max(*speed));
        let steepest = speeds.windows(2).map(|w| (w[1] - w[0]).abs() / STEP).fold(0.0, f64::max);
        assert!(fastest > 0.05, "it was on its way: {fastest}");
        assert!(held && speeds[100] == 0.0, "and stands soon after: {:?}", &speeds[60..110]);
        assert!(steepest < 1.01 * RUN_OUT.0, "{steepest} m/s2");
    }

    #[test]
    fn grasp_uses_nearest_axes_of_cube() {
        for k in 0..24 {
            let quarter = std::f64::consts::FRAC_PI_2;
            let cube = UnitQuaternion::from_euler_angles(
                quarter * f64::from(k % 4),
                quarter * f64::from(k / 4 % 3),
                quarter * f64::from(k / 12) + 0.1,
            );
            let tool = grasp_rotation(&cube, &Vector3::x(), &Vector3::z());
            assert!((tool * Vector3::z()).x > 0.9);
            assert!((tool * Vector3::y()).z > 0.9);
            // All axes of the tool are axes of the cube.
            let cube_from_tool = (cube.inverse() * tool).to_rotation_matrix();
            let off = |c: &f64| (c - c.round()).abs() < 1e-9;
            assert!(cube_from_tool.matrix().iter().all(off), "{cube_from_tool}");
        }
    }
}
