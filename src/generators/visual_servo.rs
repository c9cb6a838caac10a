//! The visual servo: leads the gripper to the cube that the operator holds.
//!
//! - in: the cube's pose in the world as the stand-alone camera's VSP delivers it (25 Hz), the set pose, the wrench
//! - out: a bounded step towards the vicinity of the cube; then, when the cube is virtually at a stand-still, a
//!   guarded approach along the tool's z until the palm's stops touch
//! - close to the cube the gripper hides it, and the last pose is frozen; a cube that is seen beyond the fingers all the
//!   same has been drawn out of them: the gripper goes straight back before it follows
//! - source: Zieliński et al. (2007), pp. 371-373: position-based, end-effector open loop, stand-alone camera; the
//!   stages (lead, follow, back off, approach, frozen close to the cube) after the 2008 sources

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
    /// `world_from_base` as the controller believes it.
    pub world_from_base: Pose,
    /// Wanted direction of the tool's z in the world; the cube's nearest axis is taken.
    pub approach: Vector3<f64>,
    /// Wanted direction of the jaws in the world; the cube's nearest axis across the approach is taken.
    pub jaws: Vector3<f64>,
    /// From the cube's centre back to the tool point, along the tool's z, when the cube is seated
    /// (m).
    pub seat: f64,
    /// Distance short of the seat at which the gripper waits and follows (m).
    pub vicinity: f64,
    /// Distance short of the seat below which the last pose is frozen: the gripper hides the cube
    /// (m).
    pub frozen: f64,
    /// A cube that is seen within this distance of one place counts as standing (m) ...
    pub still: f64,
    /// ... for this long (s).
    pub still_seconds: f64,
    /// A move of the cube that breaks off the approach (m); close to it, where it is hidden, 0.05 m
    /// at least.
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
    /// Way beyond the seat at which the approach is given up (m).
    pub overrun: f64,
    /// Age beyond which a target is not followed (s).
    pub stale: f64,
    /// Time without any target after which the servo gives up (s).
    pub patience: f64,
    /// Where cubes are handed over: `world_from_zone` and the half extents of a box in its axes
    /// (m). A cube outside is watched from the zone's edge, since the arm may not reach it.
    pub zone: (Pose, Vector3<f64>),
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Stage {
    /// Goes to the vicinity of the cube and follows it.
    Follow,
    /// Approaches; the goal was here when the approach began.
    Approach { began_at: Vector3<f64> },
    /// Goes straight back to where it is to wait, out of what may be between its fingers.
    BackOff { wait: Pose },
}

/// A cube that has not left a place: from where, in the world, and since which period.
#[derive(Debug, Clone, Copy)]
struct Standing {
    at: Vector3<f64>,
    since: u64,
}

/// Memory of the visual servo.
#[derive(Debug, Clone)]
pub struct VisualServo {
    order: Order,
    compliance: Compliance,
    stage: Stage,
    /// `base_from_tool` at the seat, filtered.
    goal: Option<Pose>,
    seen: u64,
    velocity: Vector3<f64>,
    spin: Vector3<f64>,
    standing: Option<Standing>,
    confirmed: u32,
    first_period: Option<u64>,
    /// Where the cube was seen last, in the world.
    cube: Option<Vector3<f64>>,
    /// Last period in which it was seen inside the zone.
    inside: Option<u64>,
    /// Where it waits short of the seat: [`Order::vicinity`], or as far as the arm folds (m).
    vicinity: f64,
    /// Since when the arm has been refused its way, and never come to where it is to wait.
    refused: Option<u64>,
    /// Pictures in a row of a frozen approach in which the cube was seen somewhere else, and the latest one's period.
    gone: (u32, u64),
    /// Exposure that was asked for last, and the one with which the cube was seen.
    asked: f64,
    exposure: f64,
}

/// Share of a new goal in the filtered one.
const FILTER: f64 = 0.4;
/// Follow: speed per distance (1/s).
const FOLLOW_GAIN: f64 = 2.5;
/// The gripper is in the vicinity when it is this close to the waiting pose (m), (rad).
const THERE: (f64, f64) = (0.006, 0.03);

/// An arm that does not fold far enough to wait in the vicinity waits nearer by this at each
/// refusal (m), at most so near as this part of the vicinity: the fingers must not reach the cube
/// yet.
const NEARER: f64 = 0.005;
const NEAREST: f64 = 2.0 / 3.0;

/// Deceleration where the cube is seen no more (m/s2, rad/s2). Set values change their speed once a
/// macrostep, by 13 mm/s then, which the wrist feels as 3 N; from 120 mm/s it is 9 mm of way.
const RUN_OUT: (f64, f64) = (0.8, 4.0);
/// While nothing is seen, exposures are tried in turn, each for this long (s): a workshop's light
/// is not the one that the nominal exposure was chosen for.
const EXPOSURES: [f64; 4] = [1.0, 1.0, 1.8, 0.55];
const TRY: f64 = 0.4;
/// How far from its last place the cube is searched for (m): a hand at 0.25 m/s within a frame, and
/// the filter's lag.
const REACH: f64 = 0.05;
/// A cube that is seen and never stands still is followed for this many times the patience.
const RESTLESS: f64 = 5.0;
/// A cube that the gripper hides may be seen askew, but not in so many pictures in a row somewhere else altogether ...
const GONE: u32 = 3;
/// ... at least so far off, or [`Order::retreat`] where that is more, and at most as far as somebody draws it back who holds
/// it (m): what is seen farther off is another one.
const DRAWN: (f64, f64) = (0.05, 0.3);

impl VisualServo {
    /// Carries out an order.
    #[must_use]
    pub fn new(order: Order, compliance: Compliance) -> Self {
        Self {
            order,
            compliance: Compliance { linear_inertia: order.inertia, ..compliance },
            stage: Stage::Follow,
            goal: None,
            seen: 0,
            velocity: Vector3::zeros(),
            standing: None,
            confirmed: 0,
            first_period: None,
            cube: None,
            inside: None,
            vicinity: order.vicinity,
            refused: None,
            gone: (0, 0),
            spin: Vector3::zeros(),
            asked: 1.0,
            exposure: 1.0,
        }
    }

    /// A limit of the arm on the way after a cube that somebody moves: it may come back into reach.
    #[must_use]
    pub fn bears(why: &MoveRefused) -> bool {
        matches!(
            why,
            MoveRefused::OutOfReach(_)
                | MoveRefused::JointLimit { .. }
                | MoveRefused::MotorLimit { .. }
                | MoveRefused::TooFast { .. }
        )
    }

    /// See [`super::Generator::next`].
    pub fn next(&mut self, inputs: &Inputs<'_>) -> (Next, Sensing) {
        let next = self.step(inputs);
        (next, self.sensing(inputs))
    }

    /// Everywhere and at other exposures while the cube is not seen, around its place while it is.
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
                let turn = (age / TRY) as usize % EXPOSURES.len();
                let exposure = if turn == 0 { self.exposure } else { EXPOSURES[turn] };
                Sensing { exposure, ..Sensing::SEEK }
            }
        };
        self.asked = sensing.exposure;
        sensing
    }

    fn step(&mut self, inputs: &Inputs<'_>) -> Next {
        let first = *self.first_period.get_or_insert(inputs.period);
        if let Some(excess) = self.compliance.excess(inputs.arm) {
            return Next::Done(excess);
        }
        let pose = inputs.arm.desired_base_from_tool;
        let close = matches!(self.stage, Stage::Approach { .. })
            && self.distance(&pose).is_some_and(|d| d < self.order.frozen);
        let gone = close && self.is_gone(inputs.target);
        if gone && let Some(goal) = self.goal {
            self.break_off(Stage::BackOff { wait: self.waiting(&goal) });
        }
        let frozen = close && !gone;
        // What is not looked at any more must have stood there at last: a hand that sways stands only at its turns.
        if frozen && !self.stands() {
            self.break_off(Stage::Follow);
            return Next::Go(self.hold());
        }
        if !frozen {
            self.look(inputs.target, &pose);
        }
        if let Stage::BackOff { wait } = self.stage {
            // It needs no picture for that. An arm that folds no farther has gone far enough.
            if is_at(&pose, &wait) || inputs.arm.refused.is_some_and(|why| Self::bears(&why)) {
                self.break_off(Stage::Follow);
                return Next::Go(self.hold());
            }
            return self.lead(&pose, &wait);
        }
        let last_seen = if self.goal.is_some() { self.seen } else { first };
        let age = inputs.period.saturating_sub(last_seen) as f64 * PERIOD;
        if !frozen && age > self.order.patience {
            return Next::Done(Outcome::LostSight(age));
        }
        let outside = inputs.period.saturating_sub(self.inside.unwrap_or(first)) as f64 * PERIOD;
        if !frozen && self.goal.is_some() && outside > self.order.patience {
            return Next::Done(Outcome::OutOfZone(outside));
        }
        let total = inputs.period.saturating_sub(first) as f64 * PERIOD;
        if !frozen && total > RESTLESS * self.order.patience {
            return Next::Done(Outcome::TimedOut(total));
        }
        if let Some(why) = inputs.arm.refused.filter(Self::bears) {
            return self.give_way(inputs.period, why);
        }
        let Some(goal) = self.goal else { return Next::Go(self.hold()) };
        if !frozen && age > self.order.stale {
            self.standing = None;
            return self.run_out(&pose);
        }
        if let Stage::Approach { began_at } = self.stage {
            self.approach(inputs, &goal, began_at, frozen)
        } else {
            self.follow(inputs, &goal)
        }
    }

    /// After a refusal: the arm stands, and tries again from there, nearer to a cube that stands still. So close to the
    /// cube as in an approach it would only come back to the same place.
    fn give_way(&mut self, period: u64, why: MoveRefused) -> Next {
        let since = *self.refused.get_or_insert(period);
        let long = period.saturating_sub(since) as f64 * PERIOD > self.order.patience;
        if long || matches!(self.stage, Stage::Approach { .. }) {
            return Next::Done(Outcome::OutOfReach(why));
        }
        self.stand();
        if self.stands() {
            self.vicinity = (self.vicinity - NEARER).max(NEAREST * self.order.vicinity);
        }
        Next::Go(self.hold())
    }

    /// Whether the cube of a frozen approach is being seen elsewhere than where the gripper goes.
    fn is_gone(&mut self, target: Option<&Target>) -> bool {
        let (Some(target), Some(goal)) = (target, self.goal) else { return false };
        let hidden = self.order.world_from_base * goal * Point3::new(0.0, 0.0, self.order.seat);
        let (times, last) = self.gone;
        if target.period > last.max(self.seen) {
            let in_a_row = (target.period - last) as f64 * PERIOD <= self.order.stale;
            let moved = (target.world_from_cube.translation.vector - hidden.coords).norm();
            let is_off = moved > self.order.retreat.max(DRAWN.0) && moved < DRAWN.1;
            let before = if in_a_row { times } else { 0 };
            self.gone = (if is_off { before + 1 } else { 0 }, target.period);
        }
        self.gone.0 >= GONE
    }

    /// Ends the approach.
    fn break_off(&mut self, stage: Stage) {
        self.stage = stage;
        self.stand();
        (self.standing, self.gone) = (None, (0, 0));
    }

    /// Where it waits for a cube with this goal.
    fn waiting(&self, goal: &Pose) -> Pose {
        goal * Pose::translation(0.0, 0.0, -self.vicinity)
    }

    fn stand(&mut self) {
        (self.velocity, self.spin) = (Vector3::zeros(), Vector3::zeros());
    }

    fn hold(&self) -> MoveCommand {
        MoveCommand { motion: Motion::Hold, periods: self.compliance.macrostep, jaw: None }
    }

    fn step_seconds(&self) -> f64 {
        f64::from(self.compliance.macrostep) * PERIOD
    }

    /// Way left along the tool's z.
    fn distance(&self, pose: &Pose) -> Option<f64> {
        self.goal.map(|goal| (pose.inverse() * goal).translation.z)
    }

    fn look(&mut self, target: Option<&Target>, pose: &Pose) {
        let Some(target) = target else { return };
        if target.period == self.seen {
            return;
        }
        if (target.period.saturating_sub(self.seen)) as f64 * PERIOD > self.order.stale {
            // Nobody knows where it was meanwhile.
            self.standing = None;
        }
        self.seen = target.period;
        self.exposure = self.asked;
        let base_from_world = self.order.world_from_base.inverse();
        let seen = target.world_from_cube.translation.vector;
        self.cube = Some(seen);
        let (world_from_zone, half) = self.order.zone;
        let local = world_from_zone.inverse_transform_point(&Point3::from(seen));
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
        // By the way it goes, not by its speed: a pose that jitters by a millimetre seems to have one, the same for ever.
        let stays = |s: &Standing| (seen - s.at).norm() <= self.order.still;
        if !is_inside || !self.standing.as_ref().is_some_and(stays) {
            self.standing = is_inside.then_some(Standing { at: seen, since: target.period });
            self.vicinity = self.order.vicinity;
        }
    }

    /// Whether the cube has been seen to stand for long enough.
    fn stands(&self) -> bool {
        let seconds = |s: Standing| self.seen.saturating_sub(s.since) as f64 * PERIOD;
        self.standing.is_some_and(|s| seconds(s) > self.order.still_seconds)
    }

    /// Goes to the pose where the gripper waits for a cube that stands, and begins the approach
    /// from there.
    fn follow(&mut self, inputs: &Inputs<'_>, goal: &Pose) -> Next {
        let pose = inputs.arm.desired_base_from_tool;
        let wait = self.waiting(goal);
        let is_there = is_at(&pose, &wait);
        if is_there {
            self.refused = None;
        }
        if is_there && self.stands() {
            self.stage = Stage::Approach { began_at: goal.translation.vector };
            self.gone.0 = 0;
            return self.approach(inputs, goal, goal.translation.vector, false);
        }
        self.lead(&pose, &wait)
    }

    /// A step on the way to a pose.
    fn lead(&mut self, pose: &Pose, to: &Pose) -> Next {
        let step = self.step_seconds();
        let (way, turn) = way_and_turn(pose, to);
        let (linear, angular) = self.order.speed;
        let acceleration = self.order.acceleration;
        self.velocity = led(self.velocity, way, linear, acceleration, step);
        // Its full speed is reached as soon as the linear one. A cube that turns past 45 deg is grasped by other sides,
        // and then all of it is turned back: at once, axis 6 would be left behind.
        self.spin = led(self.spin, turn, angular, acceleration * angular / linear, step);
        self.go_on(pose)
    }

    /// Comes to a stand within some hundredths of a second: a dead stop is felt as a blow, and five
    /// of them as an oscillation.
    fn run_out(&mut self, pose: &Pose) -> Next {
        let step = self.step_seconds();
        self.velocity = shortened(&self.velocity, RUN_OUT.0 * step);
        self.spin = shortened(&self.spin, RUN_OUT.1 * step);
        if self.velocity == Vector3::zeros() && self.spin == Vector3::zeros() {
            return Next::Go(self.hold());
        }
        self.go_on(pose)
    }

    /// Goes on for a macrostep at the present speeds.
    fn go_on(&self, pose: &Pose) -> Next {
        let step = self.step_seconds();
        let next = Pose::from_parts(
            (pose.translation.vector + self.velocity * step).into(),
            UnitQuaternion::from_scaled_axis(self.spin * step) * pose.rotation,
        );
        Next::Go(MoveCommand {
            motion: Motion::Pose(next),
            periods: self.compliance.macrostep,
            jaw: None,
        })
    }

    /// Moves compliantly towards the goal until the gripper touches the cube; breaks off if the
    /// goal has left `began_at`.
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
        if self.confirmed >= 2 {
            return Next::Done(Outcome::Touched(left.translation.z));
        }
        if left.translation.z < -order.overrun {
            return Next::Done(Outcome::NotTouched);
        }
        let limit = order.approach_speed;
        let c = &self.compliance;
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
        // Slower for the last 3 cm, where contact is expected.
        let forward = if left.translation.z < 0.03 { limit * 0.5 } else { limit };
        let directions = [
            linear(left.translation.x),
            linear(left.translation.y),
            if self.confirmed > 0 {
                // The hand stands until a second reading confirms the contact.
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

/// Returns the way (m) and the turn (rad) that are left to a pose.
fn way_and_turn(from: &Pose, to: &Pose) -> (Vector3<f64>, Vector3<f64>) {
    let way = to.translation.vector - from.translation.vector;
    (way, from.rotation.rotation_to(&to.rotation).scaled_axis())
}

fn is_at(pose: &Pose, wanted: &Pose) -> bool {
    let (way, turn) = way_and_turn(pose, wanted);
    way.norm() < THERE.0 && turn.norm() < THERE.1
}

/// Returns a vector made shorter by a length, at most to nothing.
fn shortened(vector: &Vector3<f64>, by: f64) -> Vector3<f64> {
    let length = vector.norm();
    if length > by { vector * ((length - by) / length) } else { Vector3::zeros() }
}

/// A velocity after one more step on the way that is left: within a speed and an acceleration, and so that it can still
/// brake on that way.
fn led(
    velocity: Vector3<f64>,
    way: Vector3<f64>,
    most: f64,
    acceleration: f64,
    step: f64,
) -> Vector3<f64> {
    let left = way.norm();
    let speed = (FOLLOW_GAIN * left).min(most).min((2.0 * acceleration * left).sqrt());
    let wanted = if left > 1e-9 { way * (speed / left) } else { Vector3::zeros() };
    velocity + (wanted - velocity).cap_magnitude(acceleration * step)
}

/// Orientation of the tool whose z is the cube's axis nearest to `approach` and whose y the one nearest to `jaws`.
#[must_use]
pub fn grasp_rotation(
    cube: &UnitQuaternion<f64>,
    approach: &Vector3<f64>,
    jaws: &Vector3<f64>,
) -> UnitQuaternion<f64> {
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()].map(|a| cube * a);
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

/// The orientation or its half roll about z, whichever is nearer: a gripper looks the same after half a roll.
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

    fn order() -> Order {
        Order {
            world_from_base: Pose::identity(),
            approach: Vector3::x(),
            jaws: Vector3::z(),
            seat: 0.019,
            vicinity: 0.1,
            frozen: 0.08,
            still: 0.005,
            still_seconds: 0.5,
            retreat: 0.05,
            speed: (0.25, 0.5),
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
    fn a_cube_that_never_stands_still_is_not_followed_for_ever() {
        let (_, outcome) = run(|period| {
            let y = 0.1 * (period as f64 * 0.002).sin();
            let world_from_cube = Pose::translation(1.0, y, 1.2);
            Some(Target { world_from_cube, speed: 0.1, period })
        });

        assert!(matches!(outcome, Outcome::TimedOut(seconds) if seconds > 24.0), "{outcome:?}");
    }

    /// Runs the generator against an arm that follows perfectly; returns the final pose and outcome.
    fn run(cube: impl Fn(u64) -> Option<Target>) -> (Pose, Outcome) {
        run_watched(cube, |_, _| ())
    }

    /// The same; `watch` is told each period and where the tool is.
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
            let inputs = Inputs { arm: &arm, target: latest.as_ref(), period, pace: 1.0 };
            match generator.next(&inputs).0 {
                Next::Done(outcome) => return (arm.desired_base_from_tool, outcome),
                Next::Go(MoveCommand { motion: Motion::Pose(pose), .. }) => {
                    let way =
                        pose.translation.vector - arm.desired_base_from_tool.translation.vector;
                    assert!(way.norm() <= 0.25 * 0.016 + 1e-9, "bounded step");
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
                        crate::spatial::Twist::from_directions(v.map(|c| c * 0.016)).displacement();
                }
                Next::Go(_) => {}
            }
        }
        panic!("never ends");
    }

    #[test]
    fn the_sensor_is_told_where_to_look_and_how_bright() {
        let arm = ArmState::default();
        let mut generator = VisualServo::new(order(), compliance());
        let mut ask = |period: u64, target: Option<&Target>| {
            generator.next(&Inputs { arm: &arm, target, period, pace: 1.0 }).1
        };
        let tried: Vec<_> = (0..110).map(|step| ask(step * 8, None)).collect();

        assert!(tried.iter().all(|s| s.window == Window::Whole && s.mode == Mode::Seek));
        assert!(tried.iter().any(|s| s.exposure > 1.5) && tried.iter().any(|s| s.exposure < 0.6));

        // Seen at last, in the bright try: it goes on with that exposure, and looks there only.
        let bright = tried.iter().rposition(|s| s.exposure > 1.5).unwrap() as u64 * 8;
        let pose = Pose::translation(1.0, 0.1, 1.2);
        let target = Target { world_from_cube: pose, speed: 0.0, period: bright };
        let mut generator = VisualServo::new(order(), compliance());
        for step in 0..=bright / 8 {
            generator.next(&Inputs { arm: &arm, target: None, period: step * 8, pace: 1.0 });
        }
        let seen = generator
            .next(&Inputs { arm: &arm, target: Some(&target), period: bright + 8, pace: 1.0 })
            .1;

        assert_eq!((seen.mode, seen.exposure), (Mode::Track, 1.8));
        let Window::Around { centre, .. } = seen.window else { panic!("{seen:?}") };
        assert!((centre - pose.translation.vector).norm() < 1e-9, "{centre}");
    }

    #[test]
    fn a_cube_at_rest_is_reached_to_its_seat() {
        let target = |period| {
            Some(Target { world_from_cube: Pose::translation(1.0, 0.0, 1.2), speed: 0.0, period })
        };
        let (pose, outcome) = run(target);

        // Nothing pushes back here, so the approach overruns the seat and says so.
        assert_eq!(outcome, Outcome::NotTouched);
        let tip = pose * Point3::new(0.0, 0.0, 0.019);
        assert!((tip.y, tip.z - 1.2) < (1e-3, 1e-3) && (tip.x - 1.015).abs() < 2e-3, "{tip}");
    }

    #[test]
    fn a_cube_at_rest_whose_pose_jitters_is_approached_all_the_same() {
        let (_, outcome) = run(|period| {
            let y = if period % 40 < 20 { 1e-3 } else { -1e-3 };
            let world_from_cube = Pose::translation(1.0, y, 1.2);
            Some(Target { world_from_cube, speed: 0.05, period })
        });

        assert_eq!(outcome, Outcome::NotTouched);
    }

    #[test]
    fn a_cube_that_sways_is_not_gone_to_blindly_from_its_turn() {
        let (_, outcome) = run(|period| {
            let y = 0.02 * (std::f64::consts::FRAC_PI_2 * period as f64 * PERIOD).cos();
            let world_from_cube = Pose::translation(1.0, y, 1.2);
            Some(Target { world_from_cube, speed: 0.0, period })
        });

        assert!(matches!(outcome, Outcome::TimedOut(_)), "{outcome:?}");
    }

    #[test]
    fn a_cube_outside_the_zone_is_watched_from_its_edge_and_taken_when_it_comes() {
        let at = |x: f64, period| {
            Some(Target { world_from_cube: Pose::translation(x, 0.0, 1.2), speed: 0.0, period })
        };

        let (pose, outcome) = run(|period| at(1.5, period));
        assert!(matches!(outcome, Outcome::OutOfZone(seconds) if seconds > 5.0), "{outcome:?}");
        // The vicinity of a cube at the edge, 1.2 m.
        assert!((pose.translation.x - (1.2 - 0.019 - 0.1)).abs() < 0.01, "{pose}");

        let (_, outcome) = run(|period| at(if period < 2000 { 1.5 } else { 1.1 }, period));
        assert_eq!(outcome, Outcome::NotTouched);
    }

    #[test]
    fn a_moving_cube_is_followed_but_not_approached() {
        let target = |period: u64| {
            let y = 0.1 * (period as f64 * 0.002).sin();
            let pose = Pose::translation(1.0, y, 1.2);
            (period < 8_000).then_some(Target { world_from_cube: pose, speed: 0.1, period })
        };
        let (pose, outcome) = run(target);

        assert!(matches!(outcome, Outcome::LostSight(_)));
        assert!(pose.translation.x < 1.0 - 0.019 - 0.08, "kept its distance: {pose}");
    }

    /// Runs the generator against an arm that goes nowhere nearer to its base than `least` nor farther than `most`, and
    /// says so; returns the outcome and the place at the end.
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
            let inputs = Inputs { arm: &arm, target: Some(&target), period, pace: 1.0 };
            let next = match generator.next(&inputs).0 {
                Next::Done(outcome) => {
                    return (outcome, arm.desired_base_from_tool.translation.vector);
                }
                Next::Go(MoveCommand { motion: Motion::Pose(pose), .. }) => pose,
                Next::Go(MoveCommand { motion: Motion::Task { directions, .. }, .. }) => {
                    let Direction::Guarded { velocity, .. } = directions[2] else { panic!() };
                    arm.desired_base_from_tool * Pose::translation(0.0, 0.0, velocity * 0.016)
                }
                Next::Go(_) => arm.desired_base_from_tool,
            };
            let x = next.translation.x;
            arm.refused = (!(least..=most).contains(&x)).then_some(MoveRefused::OutOfReach(x));
            if arm.refused.is_none() {
                arm.desired_base_from_tool = next;
            }
        }
        panic!("no end");
    }

    #[test]
    fn approach_stands_while_contact_is_confirmed() {
        let mut generator = VisualServo::new(order(), compliance());
        let (mut arm, goal) = (ArmState::default(), Pose::translation(0.0, 0.0, 0.05));
        let mut goes = |force: f64| {
            arm.wrench_in_tool.force.z = force;
            let inputs = Inputs { arm: &arm, target: None, period: 0, pace: 1.0 };
            match generator.approach(&inputs, &goal, goal.translation.vector, false) {
                Next::Go(MoveCommand { motion: Motion::Task { directions, .. }, .. }) => {
                    directions[2] != Direction::HOLD
                }
                other => panic!("{other:?}"),
            }
        };

        assert_eq!([0.0, 5.0, 0.0].map(&mut goes), [true, false, true]);
    }

    #[test]
    fn an_arm_at_its_limit_waits_until_the_cube_comes_back_into_its_reach() {
        let at = |x: f64, period| {
            let world_from_cube = Pose::translation(x, 0.0, 1.2);
            Target { world_from_cube, speed: 0.0, period }
        };
        let span = (0.5, 1.02);

        // Its waiting place would be at 1.06 m.
        let (outcome, _) =
            run_within(span, |period| at(if period < 1500 { 1.18 } else { 1.0 }, period));
        assert_eq!(outcome, Outcome::NotTouched, "there, and nothing pushes back");

        let (outcome, place) = run_within(span, |period| at(1.18, period));
        assert!(matches!(outcome, Outcome::OutOfReach(MoveRefused::OutOfReach(_))), "{outcome:?}");
        assert!(place.x > 1.0, "as far as it goes: {place}");
    }

    #[test]
    fn an_arm_that_does_not_fold_so_far_waits_nearer_to_a_cube_at_rest_but_never_at_it() {
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
        // The usual place is at 0.731 m, and two thirds of the way at 0.764 m.
        let from = |least: f64| run_within((least, 2.0), cube(0.0)).0;

        assert_eq!(from(0.755), Outcome::NotTouched);
        assert!(matches!(from(0.775), Outcome::OutOfReach(_)));
        let (outcome, place) = run_within((0.755, 2.0), cube(0.1));
        assert!(matches!(outcome, Outcome::OutOfReach(_)), "it does not stand still: {outcome:?}");
        assert!(place.x < 0.765, "it keeps its distance: {place}");
    }

    #[test]
    fn a_limit_met_in_the_approach_ends_it() {
        let last = std::cell::Cell::new(0);
        let cube = |period| {
            last.set(period);
            Target { world_from_cube: Pose::translation(1.0, 0.0, 1.2), speed: 0.0, period }
        };

        let (outcome, place) = run_within((0.5, 0.95), cube);

        assert!(matches!(outcome, Outcome::OutOfReach(_)), "{outcome:?}");
        // It is there after 5 s, and would be patient for 5 s more.
        assert!(last.get() < 3500, "at once: {last:?}");
        assert!(place.x > 0.94 && place.x <= 0.95, "{place}");
    }

    /// The lateral place at which an approach to a cube ends, and how far back the tool goes in front of one at 0 after 4.8 s: from
    /// then on the gripper is too near to look, and would be at the seat at 9 s. Pictures come each 40 ms.
    fn reached(seen_at: impl Fn(u64) -> Option<f64>) -> (f64, f64) {
        let least = std::cell::Cell::new(f64::INFINITY);
        let (pose, outcome) = run_watched(
            |period| {
                let world_from_cube = Pose::translation(1.0, seen_at(period)?, 1.2);
                Some(Target { world_from_cube, speed: 0.0, period })
            },
            |period, place| {
                if period > 3000 {
                    // Once it has gone back it may go wherever it likes.
                    let beside = if place.y.abs() < 5e-3 { place.x } else { f64::INFINITY };
                    least.set(least.get().min(beside));
                }
            },
        );
        assert_eq!(outcome, Outcome::NotTouched);
        (pose.translation.y, least.get())
    }

    #[test]
    fn a_cube_that_is_drawn_out_of_blind_fingers_is_followed_after_the_hand_has_gone_straight_back()
    {
        // Whenever that is: as long as it looks, at the very end of that, and later.
        let from = [1500, 1900, 1940, 1980, 2020, 2060, 2100, 2140, 2180, 2220, 2400, 3000];
        for from in from {
            let (y, _) = reached(|period| Some(if period < from { 0.0 } else { 0.12 }));
            assert!((y - 0.12).abs() < 2e-3, "from {from}: {y}");
        }
        let (_, x) = reached(|period| Some(if period < 3000 { 0.0 } else { 0.12 }));
        // From where it waits on it may go sideways, no sooner.
        assert!(x < 1.0 - 0.019 - 0.1 + 2.0 * THERE.0, "{x}");

        let stays: [fn(u64) -> Option<f64>; 4] = [
            // Two pictures of another place, and a third one long after, with good ones or nothing in between.
            |p| Some(if (2400..2440).contains(&p) || p == 2700 { 0.12 } else { 0.0 }),
            |p| match p {
                0..2400 => Some(0.0),
                2400..2440 | 2700 => Some(0.12),
                _ => None,
            },
            // As far as a hidden cube may seem to be off, and farther than anybody draws it: another cube.
            |p| Some(if p < 2400 { 0.0 } else { 0.04 }),
            |p| Some(if p < 2400 { 0.0 } else { 0.6 }),
        ];
        for seen in stays {
            let (y, x) = reached(seen);
            assert!(y.abs() < 2e-3 && x > 0.9, "{y} {x}");
        }
    }

    #[test]
    fn a_hand_that_goes_back_from_a_cube_that_is_gone_needs_no_pictures_for_it() {
        let (pose, outcome) = run(|period| {
            let world_from_cube =
                Pose::translation(1.0, if period < 2400 { 0.0 } else { 0.12 }, 1.2);
            (period < 2480).then_some(Target { world_from_cube, speed: 0.0, period })
        });

        assert!(matches!(outcome, Outcome::LostSight(_)), "{outcome:?}");
        let off = pose.translation.vector - Vector3::new(1.0 - 0.019 - 0.1, 0.0, 1.2);
        assert!(off.norm() < 2.0 * THERE.0, "{off}");
    }

    #[test]
    fn an_arm_that_is_refused_its_way_back_follows_from_there() {
        let mut generator = VisualServo::new(order(), compliance());
        generator.stage = Stage::BackOff { wait: Pose::translation(0.5, 0.0, 1.2) };
        let mut arm = ArmState::default();
        let mut next = |arm: &ArmState, period| {
            let (next, _) = generator.next(&Inputs { arm, target: None, period, pace: 1.0 });
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

    #[test]
    fn the_tool_is_turned_back_no_faster_than_its_axes_can_follow() {
        let rotation = grasp_rotation(&UnitQuaternion::identity(), &Vector3::x(), &Vector3::z());
        let mut arm = ArmState {
            desired_base_from_tool: Pose::from_parts(Vector3::new(0.85, 0.0, 1.2).into(), rotation),
            ..ArmState::default()
        };
        let mut generator = VisualServo::new(order(), compliance());
        let (mut spin, mut fastest, mut turned_back) = (Vector3::zeros(), 0.0_f64, false);
        for step in 1..500_u64 {
            let period = step * 8;
            // To and fro past 45 deg, where another of its sides is the nearest one.
            let angle = 0.9 * (period as f64 * 0.002).sin();
            let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), angle);
            // It goes up and down, so nothing is approached.
            let z = 1.2 + 0.01 * (period as f64 * 0.01).sin();
            let world_from_cube = Pose::from_parts(Vector3::new(1.0, 0.0, z).into(), turn);
            let target = Target { world_from_cube, speed: 0.1, period };
            let inputs = Inputs { arm: &arm, target: Some(&target), period, pace: 1.0 };
            let Next::Go(MoveCommand { motion: Motion::Pose(pose), .. }) =
                generator.next(&inputs).0
            else {
                panic!("it follows");
            };
            let before = arm.desired_base_from_tool.rotation;
            let next = before.rotation_to(&pose.rotation).scaled_axis() / 0.016;
            assert!((next - spin).norm() <= 1.0 * 0.016 + 1e-6, "{spin} {next}");
            assert!(next.norm() <= 0.5 + 1e-6);
            turned_back |= next.dot(&spin) < 0.0 || (spin.x > 0.0) != (next.x > 0.0);
            fastest = fastest.max(next.norm());
            spin = next;
            arm.desired_base_from_tool = pose;
        }
        assert!(fastest > 0.3 && turned_back, "{fastest}");
    }

    #[test]
    fn arm_that_sees_nothing_more_runs_out() {
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
            let inputs = Inputs { arm: &arm, target, period, pace: 1.0 };
            match generator.next(&inputs).0 {
                Next::Go(MoveCommand { motion: Motion::Pose(pose), .. }) => {
                    arm.desired_base_from_tool = pose;
                }
                Next::Go(_) => held |= step > 60,
                Next::Done(outcome) => panic!("{outcome:?}"),
            }
            let after = arm.desired_base_from_tool.translation.vector;
            speeds.push((after - before).norm() / 0.016);
        }

        let fastest = speeds.iter().fold(0.0_f64, |most, speed| most.max(*speed));
        let steepest = speeds.windows(2).map(|w| (w[1] - w[0]).abs() / 0.016).fold(0.0, f64::max);
        assert!(fastest > 0.05, "it was on its way: {fastest}");
        assert!(held && speeds[100] == 0.0, "and stands soon after: {:?}", &speeds[60..110]);
        assert!(steepest < 1.01 * RUN_OUT.0, "{steepest} m/s2");
    }

    #[test]
    fn the_grasp_takes_the_nearest_axes_of_a_cube_in_any_orientation() {
        for k in 0..24 {
            let quarter = std::f64::consts::FRAC_PI_2;
            let cube = UnitQuaternion::from_euler_angles(
                quarter * f64::from(k % 4),
                quarter * f64::from(k / 4 % 3),
                quarter * f64::from(k / 12) + 0.1,
            );
            let tool = grasp_rotation(&cube, &Vector3::x(), &Vector3::z());
            assert!((tool * Vector3::z()).x > 0.9);
            assert!((tool * Vector3::y()).z.abs() > 0.9);
        }
    }
}
