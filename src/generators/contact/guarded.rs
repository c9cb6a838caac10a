//! Guarded move: the tool moves in a direction until it meets a force.
//!
//! - in: direction, speed, force and greatest distance
//! - out: velocities that yield to a contact; [`Outcome::Touched`] with the distance that the tool
//!   has moved, or [`Outcome::NotTouched`] after the whole distance
//!
//! The moving directions yield as those of an approach do: a motion that went on in contact would
//! settle at twice the force.

use super::super::compliance::{Compliance, guarded_admittance};
use super::super::inputs::Inputs;
use super::super::outcome::{Next, Outcome};
use super::super::own::{MotionGenerator, Site, Touch};
use crate::motion::{ArmState, Direction, Frame, Motion};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Order of a guarded move.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GuardedOrder {
    /// Axes of the direction: those of the tool or of the base.
    pub frame: Frame,
    /// Direction of the motion, of any length above 0.
    pub direction: Vector3<f64>,
    /// Speed in free motion (m/s).
    pub speed: f64,
    /// Force of the tool on its surroundings along the direction that ends the motion (N).
    pub force: f64,
    /// Distance after which the motion ends without a contact (m).
    pub distance: f64,
}

/// A guarded move.
pub struct Guarded {
    order: GuardedOrder,
    /// Direction with the length 1.
    direction: Vector3<f64>,
    /// The direction in base axes at the beginning, and the set position there (m).
    from: (Vector3<f64>, Vector3<f64>),
    acceleration: f64,
    compliance: Compliance,
}

/// Returns a positive finite number, or the reason that names it.
pub(super) fn positive(name: &str, value: f64) -> Result<f64, String> {
    let sound = value.is_finite() && value > 0.0;
    if sound { Ok(value) } else { Err(format!("{name} {value} is not above 0")) }
}

/// Returns a direction with the length 1, or the reason that names it.
pub(super) fn unit(name: &str, direction: &Vector3<f64>) -> Result<Vector3<f64>, String> {
    let sound = direction.iter().all(|c| c.is_finite());
    direction
        .try_normalize(1e-9)
        .filter(|_| sound)
        .ok_or_else(|| format!("{name} has no direction"))
}

/// Returns the force of the tool on its surroundings in base axes (N).
pub(super) fn force_in_base(arm: &ArmState) -> Vector3<f64> {
    arm.base_from_tool.rotation * arm.wrench_in_tool.force
}

impl MotionGenerator for Guarded {
    type Order = GuardedOrder;

    fn begin(order: GuardedOrder, site: &Site<'_>) -> Result<Self, String> {
        let direction = unit("the motion", &order.direction)?;
        positive("the force", order.force)?;
        positive("the distance", order.distance)?;
        let full = site.speeds.linear;
        if positive("the speed", order.speed)? > full {
            return Err(format!("{} m/s is faster than the full speed, {full} m/s", order.speed));
        }
        let pose = site.arm.desired_base_from_tool;
        let in_base = match order.frame {
            Frame::Base => direction,
            Frame::Tool => pose.rotation * direction,
        };
        let from = (in_base, pose.translation.vector);
        let acceleration = site.speeds.linear_acceleration;
        Ok(Self { order, direction, from, acceleration, compliance: site.compliance })
    }

    fn tune(&mut self, compliance: &Compliance) {
        self.compliance = *compliance;
    }

    fn touch(&self) -> Touch {
        Touch::Contact
    }

    fn next(&mut self, inputs: &Inputs<'_>) -> Next {
        let (in_base, start) = self.from;
        let pose = &inputs.arm.desired_base_from_tool;
        let moved = (pose.translation.vector - start).dot(&in_base);
        if force_in_base(inputs.arm).dot(&in_base) >= self.order.force {
            return Next::Done(Outcome::Touched(moved));
        }
        if let Some(excess) = self.compliance.excess(inputs.arm) {
            return Next::Done(excess);
        }
        let left = self.order.distance - moved;
        if left <= 0.0 {
            return Next::Done(Outcome::NotTouched);
        }
        // Slow enough to stop at the distance, but never so slow that the end is not reached.
        let braking = libm::sqrt(2.0 * self.acceleration * left);
        let speed = self.order.speed.min(braking.max(0.1 * self.order.speed));
        let admittance = guarded_admittance(self.order.speed, self.order.force);
        let inertia = self.compliance.linear_inertia;
        let mut directions = [Direction::HOLD; 6];
        for (direction, along) in directions.iter_mut().zip(self.direction.iter()) {
            // A direction at right angles to the motion holds its place.
            if along.abs() > 1e-9 {
                *direction = Direction::Guarded { velocity: speed * along, admittance, inertia };
            }
        }
        Next::go(Motion::Task { frame: self.order.frame, directions })
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::run;
    use super::*;
    use crate::spatial::Pose;
    use nalgebra::UnitQuaternion;

    /// Runs a guarded move along z of the tool, at 20 mm/s over 60 mm, from a tool that is turned
    /// about x by `tilt` (rad), towards a wall of 20 N/mm at this distance (m).
    fn guarded(tilt: f64, wall: f64) -> (Option<Outcome>, Vector3<f64>) {
        let order = GuardedOrder {
            frame: Frame::Tool,
            direction: Vector3::new(0.0, 0.0, 2.0),
            speed: 0.02,
            force: 5.0,
            distance: 0.06,
        };
        let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), tilt);
        let start = Pose::from_parts(Vector3::new(0.3, 0.1, 0.4).into(), turn);
        let normal = turn * Vector3::z();
        let from = start.translation.vector;
        let force = move |at: Vector3<f64>, _, _| {
            normal * (2e4 * ((at - from).dot(&normal) - wall)).max(0.0)
        };
        let (outcome, arm) = run::<Guarded>(order, start, 10.0, force, |_| {}).unwrap();
        (outcome, turn.inverse() * (arm.pose.translation.vector - from))
    }

    #[test]
    fn guarded_move_stops_at_wall_or_distance() {
        for tilt in [0.0, 0.7, 2.5] {
            let (met, at) = guarded(tilt, 0.03);
            let Some(Outcome::Touched(way)) = met else { panic!("{met:?}") };
            assert!((0.03..0.031).contains(&way), "{way}");
            assert!(at.x.abs() < 1e-9 && at.y.abs() < 1e-9, "{at}");

            let (missed, at) = guarded(tilt, 1.0);
            assert_eq!(missed, Some(Outcome::NotTouched));
            assert!((at.z - 0.06).abs() < 5e-4, "{at}");
        }
    }

    #[test]
    fn impossible_guarded_orders_are_refused() {
        let order = GuardedOrder {
            frame: Frame::Base,
            direction: Vector3::z(),
            speed: 0.02,
            force: 5.0,
            distance: 0.06,
        };
        let refusal = |order: GuardedOrder| {
            let done =
                run::<Guarded>(order, Pose::identity(), 0.1, |_, _, _| Vector3::zeros(), |_| {});
            done.err().unwrap_or_default()
        };

        assert_eq!(refusal(order.clone()), "");
        let still = GuardedOrder { direction: Vector3::zeros(), ..order.clone() };
        assert_eq!(refusal(still), "the motion has no direction");
        assert!(refusal(GuardedOrder { speed: 2.0, ..order.clone() }).contains("full speed"));
        assert!(refusal(GuardedOrder { force: f64::NAN, ..order }).contains("the force"));
    }
}
