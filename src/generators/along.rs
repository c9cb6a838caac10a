//! Guarded straight motion along axes of the base or the tool.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | contact | `CONFIRM` readings in a row | a single one may be noise |
//! | motion that is held back | three times its time and 2 s | it may never cover the distance |
//!
//! - in: the wrench of the tool, the set pose of the tool
//! - out: guarded velocities until the distance is done or something is touched
//! - source: Zieliński et al. (2007), p. 371: motions relative to the base (absolute) or the tool

use super::compliance::{Compliance, Selector};
use super::inputs::Inputs;
use super::outcome::{Next, Outcome};
use crate::motion::{Direction, Frame, Motion, MoveCommand, PERIOD};
use crate::spatial::Pose;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Number of readings in a row that must show contact: a single one may be noise.
const CONFIRM: u32 = 2;

/// Order of the motion, complete in itself.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Order {
    /// Axes of the distances.
    pub frame: Frame,
    /// Distances along x, y, z of the frame (m).
    pub by: [f64; 3],
    /// Speed in free motion (m/s).
    pub speed: f64,
    /// Contact force against the motion that ends it (N).
    pub force: f64,
    /// Directions of the frame that yield besides those of the motion.
    pub selector: Selector,
}

impl Order {
    /// Returns `base_from_tool` at the end of the whole distance, from this one at the beginning.
    #[must_use]
    pub fn end(&self, base_from_tool: &Pose) -> Pose {
        let [x, y, z] = self.by;
        let by = Pose::translation(x, y, z);
        match self.frame {
            Frame::Base => by * base_from_tool,
            Frame::Tool => base_from_tool * by,
        }
    }
}

/// Memory of the motion.
#[derive(Debug, Clone)]
pub struct Along {
    order: Order,
    compliance: Compliance,
    /// Set position of the tool in the base at the beginning (m); `None` before the first call.
    start: Option<Vector3<f64>>,
    /// Number of macrosteps since the beginning.
    steps: u32,
    /// Number of readings in a row that show contact.
    confirmed: u32,
}

impl Along {
    /// Makes the motion of this order.
    #[must_use]
    pub fn new(order: Order, compliance: Compliance) -> Self {
        Self { order, compliance, start: None, steps: 0, confirmed: 0 }
    }

    /// Returns the command of the next macrostep, or how the motion ended (see
    /// [`super::Generator::next`]).
    pub fn next(&mut self, inputs: &Inputs<'_>) -> Next {
        let Order { frame, by, speed, force, selector } = self.order;
        let arm = inputs.arm;
        let start = *self.start.get_or_insert(arm.desired_base_from_tool.translation.vector);
        self.steps += 1;
        if let Some(excess) = self.compliance.unyielding(&selector, arm) {
            return Next::Done(excess);
        }
        let by = Vector3::from(by);
        let distance = by.norm();
        // A command moves the set pose, so the distance is measured between set poses.
        let way = (arm.desired_base_from_tool.translation.vector - start).norm();
        let course = by.try_normalize(1e-9).unwrap_or_else(Vector3::zeros);
        let turn = arm.base_from_tool.rotation;
        let felt = match frame {
            Frame::Base => turn * arm.wrench_in_tool.force,
            Frame::Tool => arm.wrench_in_tool.force,
        };
        // The wrench is that which the tool exerts, so it points along the motion in contact.
        self.confirmed = if felt.dot(&course) > force { self.confirmed + 1 } else { 0 };
        if self.confirmed >= CONFIRM {
            return Next::Done(Outcome::Touched(way));
        }
        let seconds = f64::from(self.steps) * f64::from(self.compliance.macrostep) * PERIOD;
        if way >= distance || seconds > 3.0 * distance / speed + 2.0 {
            return Next::Done(Outcome::NotTouched);
        }
        let mut directions = self.compliance.yielding(&selector);
        for (axis, share) in course.iter().enumerate().filter(|(_, share)| share.abs() > 1e-9) {
            // The tool holds until a second reading confirms the contact.
            directions[axis] = if self.confirmed > 0 {
                Direction::HOLD
            } else {
                self.compliance.guarded(share * speed, force)
            };
        }
        let motion = Motion::Task { frame, directions };
        Next::Go(MoveCommand { motion, periods: self.compliance.macrostep, jaw: None })
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::compliance;
    use super::*;
    use crate::motion::ArmState;
    use nalgebra::UnitQuaternion;

    /// Returns the order to move 30 mm down in the frame, until a contact of 5 N.
    fn down(frame: Frame) -> Order {
        Order { frame, by: [0.0, 0.0, -0.03], speed: 0.02, force: 5.0, selector: [false; 6] }
    }

    /// Returns the state of an arm whose tool lies on its side and exerts this force along the
    /// tool's x (N).
    fn lying(force: f64) -> ArmState {
        let turn =
            UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -std::f64::consts::FRAC_PI_2);
        let pose = Pose::from_parts(Vector3::new(1.0, 0.0, 0.5).into(), turn);
        let mut arm = ArmState { base_from_tool: pose, ..ArmState::default() };
        arm.desired_base_from_tool = pose;
        arm.wrench_in_tool.force.x = force;
        arm
    }

    /// Returns how the motion ends in the second macrostep with this state; `None` if it goes on.
    fn second(frame: Frame, arm: &ArmState) -> Option<Outcome> {
        let mut along = Along::new(down(frame), compliance());
        let inputs = Inputs { arm, target: None, period: 0, pace: 1.0 };
        along.next(&inputs);
        match along.next(&inputs) {
            Next::Done(outcome) => Some(outcome),
            Next::Go(_) => None,
        }
    }

    #[test]
    fn contact_is_judged_along_axes_of_frame() {
        // The tool's x points up, so a tool that presses down exerts a force against its own x.
        assert_eq!(second(Frame::Base, &lying(-6.0)), Some(Outcome::Touched(0.0)));
        assert_eq!(second(Frame::Base, &lying(6.0)), None, "a pull is no contact");
        assert_eq!(second(Frame::Tool, &lying(-6.0)), None, "across the tool's own z");
        assert_eq!(second(Frame::Base, &lying(60.0)), Some(Outcome::OverForce(0, 60.0)));
    }

    #[test]
    fn only_ordered_axes_move_in_ordered_frame() {
        let mut along = Along::new(down(Frame::Base), compliance());
        let arm = lying(0.0);
        let Next::Go(command) =
            along.next(&Inputs { arm: &arm, target: None, period: 0, pace: 1.0 })
        else {
            panic!("the motion has ended")
        };

        let Motion::Task { frame, directions } = command.motion else { panic!("{command:?}") };
        assert_eq!(frame, Frame::Base);
        assert_eq!(directions[..2], [Direction::HOLD; 2]);
        assert_eq!(directions[2], compliance().guarded(-0.02, 5.0));
        assert_eq!(directions[3..], [Direction::HOLD; 3]);
    }

    #[test]
    fn motion_ends_at_its_distance() {
        let (order, mut arm) = (down(Frame::Base), lying(0.0));
        let mut along = Along::new(order, compliance());
        let step = |along: &mut Along, arm: &ArmState| {
            along.next(&Inputs { arm, target: None, period: 0, pace: 1.0 })
        };

        assert!(matches!(step(&mut along, &arm), Next::Go(_)));
        arm.desired_base_from_tool = order.end(&arm.desired_base_from_tool);
        assert_eq!(step(&mut along, &arm), Next::Done(Outcome::NotTouched));
    }
}
