//! True state and history of the objects, for verdicts on tasks and for tests.
//!
//! - in: contact forces once a servo period
//! - out: greatest and typical internal force of a body in two hands, forces on a surface, and the
//!   part of its contour that was touched

use crate::cell::PerArm;
use crate::spatial::Pose;
use nalgebra::Vector3;
use std::sync::Arc;

/// Width of a step of the history of forces (N).
const STEP: f64 = 0.1;
/// Number of steps; greater forces count in the last one.
const STEPS: usize = 1500;

/// True state and history of an object.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectTruth {
    /// Name in the scenario.
    pub name: Arc<str>,
    /// Sizes along its axes (m), as in the scenario.
    pub size: Vector3<f64>,
    /// Pose of its centre in the world.
    pub world_from_object: Pose,
    /// State of the object now.
    pub state: ObjectState,
    /// Whether the gripper of each arm holds it.
    pub held_by: PerArm<bool>,
    /// Force of each arm's gripper on it, without the squeeze of the pads (N).
    pub force: PerArm<f64>,
    /// Greatest of these forces in the run (N).
    pub most_force: f64,
    /// Internal load while two hands hold it.
    pub internal: Internal,
    /// Number of times that jaws closed on it, per arm.
    pub grasps: PerArm<u32>,
    /// Number of its falls out of a hand.
    pub drops: u32,
    /// Number of grips in which it slipped by more than 1 mm or 3 deg while the jaws did not open.
    pub slips: u32,
    /// Forces of finger tips and probes on it, for a fixed object.
    pub touch: TouchTruth,
}

/// State of an object.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum ObjectState {
    /// Fixed to the cell.
    Fixed,
    /// At rest on the table or on a support.
    Resting,
    /// In one hand or in two.
    Held,
    /// In the air.
    Falling,
}

/// Internal load of an object between two hands: the part of the hands' forces that cancels.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Internal {
    /// Half the difference of the two forces on the object, now (N).
    pub force: f64,
    /// Its part along the line between the tool points (N): positive pulls the hands' grips apart,
    /// negative compresses the object.
    pub pull: f64,
    /// Half the difference of the two torques on the object about the tool points, now (Nm).
    pub torque: f64,
    /// Greatest `force` of the run (N).
    pub most_force: f64,
    /// Greatest `torque` of the run (Nm).
    pub most_torque: f64,
    /// Force below which `force` was in 99 % of the servo periods (N), in steps of 0.1 N.
    pub p99_force: f64,
    /// Number of servo periods in which two hands held the object.
    pub periods: u64,
}

/// Forces of finger tips and probes on a fixed object.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TouchTruth {
    /// Normal force of each arm now (N).
    pub force: PerArm<f64>,
    /// Friction of each arm now (N).
    pub friction: PerArm<f64>,
    /// Greatest normal force of an arm in the run (N).
    pub most_force: f64,
    /// Number of servo periods with contact.
    pub periods: u64,
    /// Number of times that a contact began.
    pub contacts: u32,
    /// Sum of the normal forces over the periods with contact (N).
    pub sum: f64,
    /// Sum of their squares (N2).
    pub sum_of_squares: f64,
    /// Length of the contour that was touched (m); 0 for an object without a contour.
    pub covered: f64,
    /// Length of the whole contour (m).
    pub length: f64,
}

impl TouchTruth {
    /// Returns the root mean square of the normal force's deviation from `wanted` (N), over the
    /// periods with contact; 0 without any.
    #[must_use]
    pub fn force_error(&self, wanted: f64) -> f64 {
        if self.periods == 0 {
            return 0.0;
        }
        let n = self.periods as f64;
        let squares = self.sum_of_squares - 2.0 * wanted * self.sum + n * wanted * wanted;
        (squares / n).max(0.0).sqrt()
    }

    /// Adds a servo period with the normal force and the friction of each arm (N).
    pub(super) fn add(&mut self, force: PerArm<f64>, friction: PerArm<f64>) {
        let (before, now) = (self.force.iter().sum::<f64>(), force.iter().sum::<f64>());
        self.contacts += u32::from(before == 0.0 && now > 0.0);
        (self.force, self.friction) = (force, friction);
        self.most_force = force.into_iter().fold(self.most_force, f64::max);
        if now > 0.0 {
            self.periods += 1;
            self.sum += now;
            self.sum_of_squares += now * now;
        }
    }
}

/// History of a force, from which its percentiles follow.
#[derive(Debug, Clone)]
pub(super) struct History {
    /// Number of periods in each step of force.
    steps: Vec<u64>,
}

impl History {
    /// Makes an empty history.
    pub(super) fn new() -> Self {
        Self { steps: vec![0; STEPS] }
    }

    /// Adds a force (N).
    pub(super) fn add(&mut self, force: f64) {
        self.steps[((force / STEP) as usize).min(STEPS - 1)] += 1;
    }

    /// Returns the force below which this `share` of the history lies (N), rounded up to a step; 0
    /// without a history.
    pub(super) fn percentile(&self, share: f64) -> f64 {
        let wanted = self.steps.iter().sum::<u64>() as f64 * share;
        let mut sum = 0.0;
        for (i, count) in self.steps.iter().enumerate() {
            sum += *count as f64;
            if sum > 0.0 && sum >= wanted {
                return STEP * (i + 1) as f64;
            }
        }
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::MOST_ARMS;

    #[test]
    fn percentile_leaves_out_rare_peak() {
        let mut history = History::new();
        assert_eq!(history.percentile(0.99), 0.0);
        for i in 0..200 {
            history.add(if i == 7 { 90.0 } else { 5.03 });
        }

        assert!((history.percentile(0.99) - 5.1).abs() < 1e-9);
        assert!((history.percentile(1.0) - 90.1).abs() < 1e-9);
    }

    #[test]
    fn force_error_is_deviation_from_wanted_force() {
        let mut touch = TouchTruth::default();
        for force in [0.0, 9.0, 11.0, 0.0, 13.0] {
            touch.add([force, 0.0, 0.0, 0.0], [0.0; MOST_ARMS]);
        }

        assert!((touch.force_error(10.0) - (11.0_f64 / 3.0).sqrt()).abs() < 1e-9);
        assert_eq!((touch.periods, touch.contacts), (3, 2));
        assert_eq!(touch.most_force, 13.0);
    }
}
