//! The generator `nod`: one joint swings to one side and back by a cosine, so that it begins and
//! ends at rest.
//!
//! - in: joint, angle and time of the swing
//! - out: joint positions, one set a macrostep

use rubik_robot::generators::own::{Clock, MotionGenerator, Pacing, Site};
use rubik_robot::generators::{Inputs, Next, Outcome};
use rubik_robot::motion::{JointPositions, Motion};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Order to nod.
#[derive(Serialize, Deserialize)]
pub struct NodOrder {
    /// Number of the joint.
    pub joint: usize,
    /// Angle of the swing (rad).
    pub angle: f64,
    /// Time of the swing (s).
    pub seconds: f64,
}

/// Generator of a swing.
pub struct Nod {
    order: NodOrder,
    start: JointPositions,
    clock: Clock,
}

impl MotionGenerator for Nod {
    type Order = NodOrder;

    fn begin(order: NodOrder, site: &Site<'_>) -> Result<Self, String> {
        let start = site.arm.desired_joints;
        if order.joint >= start.0.len() {
            return Err(format!("there is no joint {}", order.joint));
        }
        // The greatest speed of the cosine must not exceed that of the joint.
        let fastest = order.angle.abs() * PI / order.seconds;
        let full = site.speeds.joint[order.joint];
        if !(order.seconds > 0.0 && fastest <= full) {
            return Err(format!("{fastest:.2} rad/s are faster than joint {}", order.joint));
        }
        Ok(Self { order, start, clock: Clock::new(site) })
    }

    fn next(&mut self, inputs: &Inputs<'_>) -> Next {
        if self.clock.time() >= self.order.seconds {
            return Next::Done(Outcome::Reached);
        }
        let part = (self.clock.advance(inputs) / self.order.seconds).min(1.0);
        let mut at = self.start;
        at.0[self.order.joint] += 0.5 * self.order.angle * (1.0 - (2.0 * PI * part).cos());
        Next::go(Motion::Joints(at))
    }

    fn pacing(&self) -> Pacing {
        Pacing::Clock
    }
}
