//! Pure position control: a motion to joint positions or along a straight line.
//!
//! - in: the set values of the arm at the beginning of the motion
//! - out: set values at the end of each macrostep, between which the servo interpolates linearly
//! - The course over time is that of [`Profile`]. The duration is the shortest that keeps the full
//!   speeds and accelerations.

use super::inputs::Inputs;
use super::legs::Legs;
use super::outcome::{Next, Outcome};
use super::profile::Profile;
use crate::motion::{AXES, JointPositions, Motion, MoveCommand, PERIOD};
use crate::spatial::Pose;
use serde::{Deserialize, Serialize};

/// Full speeds of position control.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Speeds {
    /// Speed of each joint (m/s or rad/s).
    pub joint: [f64; AXES],
    /// Acceleration of each joint (m/s2 or rad/s2).
    pub joint_acceleration: [f64; AXES],
    /// Speed of the tool point (m/s).
    pub linear: f64,
    /// Acceleration of the tool point (m/s2).
    pub linear_acceleration: f64,
    /// Angular speed of the tool (rad/s).
    pub angular: f64,
    /// Angular acceleration of the tool (rad/s2).
    pub angular_acceleration: f64,
    /// Course of a motion over its time.
    pub profile: Profile,
}

impl Speeds {
    /// Returns the time of a motion from one set of joint positions to another at a fraction of the
    /// full speeds (s).
    #[must_use]
    pub fn joints_seconds(&self, from: &JointPositions, to: &JointPositions, fraction: f64) -> f64 {
        let seconds = |i: usize| {
            let (speed, acceleration) = (self.joint[i], self.joint_acceleration[i]);
            self.profile.seconds(to.0[i] - from.0[i], speed * fraction, acceleration * fraction)
        };
        // All joints take the time of the slowest one, so that they arrive together.
        (0..AXES).map(seconds).fold(0.0, f64::max)
    }

    /// Returns the time of a motion in legs at the full speeds (s).
    #[must_use]
    pub fn legs_seconds(&self, from: &JointPositions, legs: &Legs) -> f64 {
        legs.seconds(from, &self.joint, &self.joint_acceleration)
    }

    /// Returns the time of a straight motion of the tool by a distance (m) with a rotation (rad),
    /// at a fraction of the full speeds (s).
    #[must_use]
    pub fn line_seconds(&self, distance: f64, turn: f64, fraction: f64) -> f64 {
        let seconds = |(distance, speed, acceleration): (f64, f64, f64)| {
            self.profile.seconds(distance, speed * fraction, acceleration * fraction)
        };
        let [linear, angular] = self.line(distance, turn).map(seconds);
        linear.max(angular)
    }

    /// Returns the fraction of the full speeds, 0..=1, at which a straight motion of the tool by
    /// `distance` (m) with the rotation `turn` (rad) takes `seconds`.
    #[must_use]
    pub fn line_fraction(&self, distance: f64, turn: f64, seconds: f64) -> f64 {
        let fraction = |(distance, speed, acceleration): (f64, f64, f64)| {
            self.profile.fraction(distance, speed, acceleration, seconds)
        };
        let [linear, angular] = self.line(distance, turn).map(fraction);
        linear.max(angular).min(1.0)
    }

    /// Returns the translation and the rotation of a straight motion, each as its length (m, rad),
    /// its full speed and its full acceleration.
    fn line(&self, distance: f64, turn: f64) -> [(f64, f64, f64); 2] {
        [
            (distance, self.linear, self.linear_acceleration),
            (turn, self.angular, self.angular_acceleration),
        ]
    }
}

/// Motion that is made; `start` are the set values at its beginning, `None` before the first call.
#[derive(Debug, Clone, Copy)]
enum Goal {
    Joints { start: Option<JointPositions>, target: JointPositions },
    Line { start: Option<Pose>, target: Pose },
    Legs { start: Option<JointPositions>, legs: Legs },
}

/// Memory of a motion.
#[derive(Debug, Clone)]
pub struct Position {
    goal: Goal,
    speeds: Speeds,
    /// Fraction of the full speeds, 0..=1.
    fraction: f64,
    /// Least duration (s).
    least: f64,
    /// Length of a macrostep (periods).
    macrostep: u32,
    /// Number of macrosteps of the motion at full pace (0 before the first call), and the number
    /// done. A macrostep at a lower pace counts as a part of one.
    steps: f64,
    done: f64,
}

impl Position {
    /// Makes a motion to joint positions at a fraction of the full speeds that takes at least
    /// `least` seconds. `macrostep` is in periods.
    #[must_use]
    pub fn joints(
        target: JointPositions,
        (fraction, least): (f64, f64),
        speeds: &Speeds,
        macrostep: u32,
    ) -> Self {
        let goal = Goal::Joints { start: None, target };
        Self { goal, speeds: *speeds, fraction, least, macrostep, steps: 0.0, done: 0.0 }
    }

    /// Makes a motion in legs at the full speeds that takes at least `least` seconds. `macrostep`
    /// is in periods.
    #[must_use]
    pub fn legs(legs: Legs, least: f64, speeds: &Speeds, macrostep: u32) -> Self {
        let goal = Goal::Legs { start: None, legs };
        Self { goal, speeds: *speeds, fraction: 1.0, least, macrostep, steps: 0.0, done: 0.0 }
    }

    /// Makes a motion of the tool along a straight line to the `base_from_tool` of `target`, at a
    /// fraction of the full speeds. `macrostep` is in periods.
    #[must_use]
    pub fn line(target: Pose, fraction: f64, speeds: &Speeds, macrostep: u32) -> Self {
        let goal = Goal::Line { start: None, target };
        Self { goal, speeds: *speeds, fraction, least: 0.0, macrostep, steps: 0.0, done: 0.0 }
    }

    /// Returns the command of the next macrostep, or the outcome at the end (see
    /// [`super::Generator::next`]).
    pub fn next(&mut self, inputs: &Inputs<'_>) -> Next {
        if self.steps == 0.0 {
            self.begin(inputs);
        }
        if self.done >= self.steps {
            return Next::Done(Outcome::Reached);
        }
        // A pause slows down the time of the motion, so its path stays the same.
        self.done = (self.done + inputs.pace).min(self.steps);
        let part = self.done / self.steps;
        let s = self.speeds.profile.share(part, self.steps * self.step());
        let motion = match self.goal {
            Goal::Joints { start: Some(start), target } => {
                Motion::Joints(start.towards(&target, s))
            }
            Goal::Line { start: Some(start), target } => Motion::Pose(Pose::from_parts(
                start.translation.vector.lerp(&target.translation.vector, s).into(),
                start.rotation.slerp(&target.rotation, s),
            )),
            // Each leg has its own profile, in its own window, so it gets the share of the time.
            Goal::Legs { start: Some(start), legs } => Motion::Joints(legs.at(&start, part)),
            Goal::Joints { .. } | Goal::Line { .. } | Goal::Legs { .. } => Motion::Hold,
        };
        Next::Go(MoveCommand { motion, periods: self.macrostep, jaw: None })
    }

    /// Stores the set values at the beginning, and computes the number of macrosteps of the motion.
    fn begin(&mut self, inputs: &Inputs<'_>) {
        let seconds = match &mut self.goal {
            Goal::Joints { start, target } => {
                let from = inputs.arm.desired_joints;
                *start = Some(from);
                self.speeds.joints_seconds(&from, target, self.fraction)
            }
            Goal::Legs { start, legs } => {
                let from = inputs.arm.desired_joints;
                *start = Some(from);
                self.speeds.legs_seconds(&from, legs)
            }
            Goal::Line { start, target } => {
                let from = inputs.arm.desired_base_from_tool;
                *start = Some(from);
                let distance = (target.translation.vector - from.translation.vector).norm();
                let turn = from.rotation.angle_to(&target.rotation);
                self.speeds.line_seconds(distance, turn, self.fraction)
            }
        };
        // Whole macrosteps: the last set value is exactly the target.
        self.steps = (seconds.max(self.least) / self.step()).ceil().max(1.0);
    }

    /// Returns the length of a macrostep (s).
    fn step(&self) -> f64 {
        f64::from(self.macrostep) * PERIOD
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::ArmState;
    use nalgebra::{Translation3, UnitQuaternion};

    /// Length of a macrostep of 8 periods (s).
    const STEP: f64 = 0.016;

    /// Returns speed limits of 0.1 m/s for the track and 1 rad/s for the other axes.
    fn speeds() -> Speeds {
        Speeds {
            joint: [0.1, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0],
            joint_acceleration: [0.3; AXES],
            linear: 0.2,
            linear_acceleration: 0.5,
            angular: 1.0,
            angular_acceleration: 2.0,
            profile: Profile { ramp: 5.0 },
        }
    }

    #[test]
    fn all_joints_arrive_together_within_their_limits() {
        // The speed of the track limits the long motion, the acceleration of joint 1 the other one.
        for (track, limited) in [(-0.2, 0), (-0.1, 1)] {
            let mut target = JointPositions::default();
            (target.0[0], target.0[1]) = (track, 1.0);
            let course = course(target);
            assert_eq!(course.last(), Some(&target));
            let mut shares = [0.0_f64; 4];
            for at in course.windows(3) {
                let part = at[1].0[1];
                assert!((at[1].0[0] - part * track).abs() < 1e-12, "{:?}", at[1]);
                // Half of the limits were ordered: 0.05 m/s, 0.5 rad/s, 0.15 m/s2, 0.15 rad/s2.
                for (axis, speed) in [0.05, 0.5].into_iter().enumerate() {
                    let [a, b, c] = [0, 1, 2].map(|i: usize| at[i].0[axis]);
                    let (fast, steep) = ((c - b).abs(), (c - 2.0 * b + a).abs());
                    shares[axis] = shares[axis].max(fast / STEP / speed);
                    shares[2 + axis] = shares[2 + axis].max(steep / (STEP * STEP) / 0.15);
                }
            }
            assert!(shares.iter().all(|share| *share < 1.0 + 1e-3), "{shares:?}");
            assert!(shares[if limited == 0 { 0 } else { 3 }] > 0.99, "{shares:?}");
        }
    }

    /// Returns the set values of a motion of the joints from zero to `target`, at half of the full
    /// speeds.
    fn course(target: JointPositions) -> Vec<JointPositions> {
        let mut generator = Position::joints(target, (0.5, 0.0), &speeds(), 8);
        let arm = ArmState::default();
        let mut course = vec![JointPositions::default()];
        loop {
            match generator.next(&Inputs {
                arm: &arm,
                target: None,
                reading: None,
                period: 0,
                pace: 1.0,
            }) {
                Next::Go(MoveCommand { motion: Motion::Joints(q), .. }) => course.push(q),
                Next::Go(other) => panic!("not a joint motion: {other:?}"),
                Next::Done(outcome) => {
                    assert_eq!(outcome, Outcome::Reached);
                    return course;
                }
            }
        }
    }

    #[test]
    fn line_at_computed_speed_fraction_takes_wanted_time() {
        for (distance, turn) in [(0.3, 0.0), (0.01, 0.0), (0.1, 1.5), (0.0, 0.2)] {
            let least = speeds().line_seconds(distance, turn, 1.0);
            for longer in [1.0, 1.3, 7.0] {
                let fraction = speeds().line_fraction(distance, turn, longer * least);
                let lasts = speeds().line_seconds(distance, turn, fraction);
                assert!(
                    (lasts - longer * least).abs() < 1e-9,
                    "{distance} {turn}: {lasts} {least}"
                );
            }
        }
    }

    #[test]
    fn zero_speed_scale_freezes_joint_set_values() {
        let mut target = JointPositions::default();
        target.0[1] = 1.0;
        let mut generator = Position::joints(target, (0.5, 0.0), &speeds(), 8);
        let arm = ArmState::default();
        let mut at = |pace: f64| match generator.next(&Inputs {
            arm: &arm,
            target: None,
            reading: None,
            period: 0,
            pace,
        }) {
            Next::Go(MoveCommand { motion: Motion::Joints(q), .. }) => Some(q.0[1]),
            _ => None,
        };
        for _ in 0..60 {
            at(1.0);
        }

        let (slow, stopped, still) = (at(0.5).unwrap(), at(0.0).unwrap(), at(0.0).unwrap());

        assert!(slow > 0.0 && slow < 1.0);
        assert_eq!((stopped, still), (slow, slow));
        let mut last = slow;
        while let Some(q) = at(1.0) {
            last = q;
        }
        assert_eq!(last, 1.0);
    }

    #[test]
    fn line_motion_keeps_tool_on_straight_line() {
        let turn = UnitQuaternion::from_euler_angles(0.0, 0.0, 0.6);
        let target = Pose::from_parts(Translation3::new(0.3, 0.0, 0.4), turn);
        let mut generator = Position::line(target, 1.0, &speeds(), 8);
        let arm = ArmState::default();
        let mut next = || {
            generator.next(&Inputs { arm: &arm, target: None, reading: None, period: 0, pace: 1.0 })
        };

        let (mut last, mut farthest) = (Pose::identity(), 0.0_f64);
        let end = loop {
            let pose = match next() {
                Next::Go(MoveCommand { motion: Motion::Pose(pose), .. }) => pose,
                end => break end,
            };
            let v = pose.translation.vector;
            assert!((v.x * 4.0 - v.z * 3.0).abs() < 1e-12 && v.y == 0.0);
            // The tool turns by the same share of its angle.
            assert!((pose.rotation.angle() - 0.6 * v.norm() / 0.5).abs() < 1e-7, "{pose}");
            farthest = farthest.max((v - last.translation.vector).norm());
            last = pose;
        };
        assert!(matches!(end, Next::Done(Outcome::Reached)), "{end:?}");
        assert!((last.to_homogeneous() - target.to_homogeneous()).amax() < 1e-12, "{last}");
        assert!(farthest < 0.2 * STEP + 1e-9, "no step is faster than the full speed: {farthest}");
    }
}
