//! Guidance by hand: the arm yields in all directions and records where it is led.
//!
//! - in: the interval of the records, the time of rest that ends the guidance
//! - out: directions that seek zero force; [`Guided`] with the way at the end
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | rest | below [`STILL`] for the ordered time | a person stops to think before he has done |
//! | overload | a limit of the arm for [`STRAIN`] | yielding may relieve it |
//! | record | [`MOST`] at most, then every second one is dropped | the result is one message |

use super::super::compliance::Compliance;
use super::super::inputs::Inputs;
use super::super::outcome::{Next, Outcome};
use super::super::own::{MotionGenerator, Pacing, Site, Touch};
use super::guarded::positive;
use crate::motion::{Frame, JointPositions, Motion};
use crate::spatial::Pose;
use serde::{Deserialize, Serialize};

/// Speeds of the tool below which it is at rest (m/s, rad/s).
const STILL: (f64, f64) = (1e-3, 5e-3);
/// Time of a force beyond the limits that yielding may still relieve (s).
const STRAIN: f64 = 0.5;
/// Most records of a way.
const MOST: usize = 4096;

/// Order of guidance by hand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GuideOrder {
    /// Time of rest that ends the guidance (s); `None` if MP ends it, which gets no way then.
    pub still: Option<f64>,
    /// Time between two records of the way (s).
    pub interval: f64,
}

/// Result of guidance by hand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Guided {
    /// Time between two records (s).
    pub interval: f64,
    /// Joint positions at each record (m or rad).
    pub joints: Vec<JointPositions>,
    /// `base_from_tool` at each record.
    pub poses: Vec<Pose>,
}

/// Guidance by hand.
pub struct Guide {
    order: GuideOrder,
    compliance: Compliance,
    step: f64,
    way: Guided,
    /// Time since the last record, of the rest and of the overload (s).
    since: f64,
    rested: f64,
    strained: f64,
    last: Pose,
}

impl MotionGenerator for Guide {
    type Order = GuideOrder;

    fn begin(order: GuideOrder, site: &Site<'_>) -> Result<Self, String> {
        if let Some(still) = order.still {
            positive("the time of rest", still)?;
        }
        let interval = positive("the interval", order.interval)?.max(site.step());
        Ok(Self {
            order,
            compliance: site.compliance,
            step: site.step(),
            way: Guided { interval, joints: Vec::new(), poses: Vec::new() },
            since: interval,
            rested: 0.0,
            strained: 0.0,
            last: site.arm.desired_base_from_tool,
        })
    }

    fn next(&mut self, inputs: &Inputs<'_>) -> Next {
        let arm = inputs.arm;
        let excess = self.compliance.excess(arm);
        self.strained = if excess.is_some() { self.strained + self.step } else { 0.0 };
        if let Some(excess) = excess.filter(|_| self.strained > STRAIN) {
            return Next::Done(excess);
        }
        self.record(arm.desired_joints, arm.desired_base_from_tool);
        let now = arm.desired_base_from_tool;
        let moved = (now.translation.vector - self.last.translation.vector).norm();
        let turned = self.last.rotation.angle_to(&now.rotation);
        self.last = now;
        let rests = moved < STILL.0 * self.step && turned < STILL.1 * self.step;
        self.rested = if rests { self.rested + self.step } else { 0.0 };
        if self.order.still.is_some_and(|still| self.rested >= still) {
            return Next::Done(Outcome::own(&self.way));
        }
        let directions = self.compliance.yielding(&[true; 6]);
        Next::go(Motion::Task { frame: Frame::Tool, directions })
    }

    fn tune(&mut self, compliance: &Compliance) {
        self.compliance = *compliance;
    }

    fn touch(&self) -> Touch {
        Touch::Yields
    }

    fn pacing(&self) -> Pacing {
        // A pause ends the calls, and so the motion; the directions have no speed to slow down.
        Pacing::Clock
    }
}

impl Guide {
    /// Records a place if the last record is an interval old.
    fn record(&mut self, joints: JointPositions, pose: Pose) {
        self.since += self.step;
        if self.since + 1e-9 < self.way.interval {
            return;
        }
        self.since -= self.way.interval;
        self.way.joints.push(joints);
        self.way.poses.push(pose);
        if self.way.joints.len() >= MOST {
            // A long way is kept as a whole, at twice the interval.
            self.way.joints = self.way.joints.iter().step_by(2).copied().collect();
            self.way.poses = self.way.poses.iter().step_by(2).copied().collect();
            self.way.interval *= 2.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::run;
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn guided_arm_follows_push_and_ends_at_rest() {
        let order = GuideOrder { still: Some(1.0), interval: 0.1 };
        // A hand pushes along y with 20 N for 3 s: the tool exerts the opposite force on it.
        let push = |_, _, now: f64| if now < 3.0 { -20.0 * Vector3::y() } else { Vector3::zeros() };

        let (outcome, arm) = run::<Guide>(order, Pose::identity(), 20.0, push, |_| {}).unwrap();

        let way: Guided = outcome.and_then(|outcome| outcome.result()).unwrap();
        // 20 N times the admittance of 1 mm/s per N, for 3 s.
        let to = arm.pose.translation.vector;
        assert!((to.y - 0.06).abs() < 0.002 && to.x.abs() < 1e-9, "{to}");
        assert_eq!(way.joints.len(), way.poses.len());
        assert!((40..48).contains(&way.poses.len()), "{} records", way.poses.len());
        assert!(way.poses.is_sorted_by(|a, b| a.translation.y <= b.translation.y));
    }

    #[test]
    fn overload_ends_guidance_after_half_second() {
        let order = GuideOrder { still: None, interval: 0.1 };
        // The limit of the tests is 40 N.
        let push = |_, _, now: f64| if now < 1.0 { Vector3::x() } else { 50.0 * Vector3::x() };

        let (outcome, _) = run::<Guide>(order, Pose::identity(), 1.4, push, |_| {}).unwrap();
        assert_eq!(outcome, None);
        let order = GuideOrder { still: None, interval: 0.1 };
        let (outcome, _) = run::<Guide>(order, Pose::identity(), 1.7, push, |_| {}).unwrap();
        assert!(matches!(outcome, Some(Outcome::OverForce(0, _))), "{outcome:?}");
    }

    #[test]
    fn long_way_doubles_its_interval() {
        let order = GuideOrder { still: Some(100.0), interval: 0.016 };
        let none = |_, _, _| Vector3::zeros();

        let (outcome, _) = run::<Guide>(order, Pose::identity(), 200.0, none, |_| {}).unwrap();

        let way: Guided = outcome.and_then(|outcome| outcome.result()).unwrap();
        assert_eq!(way.interval, 0.032);
        assert!((3000..MOST).contains(&way.poses.len()) && way.poses.len() == way.joints.len());
    }
}
