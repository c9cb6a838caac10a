//! Compliant directions: one set of admittances and limits for all generators of an arm.
//!
//! - in: the wanted force or velocity of a direction; the state of the arm
//! - out: directions of a task motion; an [`Outcome`] if a force exceeds its limit

use super::outcome::Outcome;
use crate::motion::{ArmState, Direction, Frame, JawCommand, Motion, MoveCommand};
use crate::operator::Parameter;
use crate::operator::parameter::Factors;
use crate::spatial::Wrench;
use serde::{Deserialize, Serialize};

/// Compliance, macrostep, jaws and limits of an arm, for all of its generators.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Compliance {
    /// Admittance B of the linear directions (m/(s N)).
    pub linear_admittance: f64,
    /// Virtual mass M of the linear directions (kg).
    pub linear_inertia: f64,
    /// Admittance B of the angular directions (rad/(s Nm)).
    pub angular_admittance: f64,
    /// Virtual moment of inertia M of the angular directions (kg m2).
    pub angular_inertia: f64,
    /// Length of a macrostep (periods).
    pub macrostep: u32,
    /// Speed of jaws that close near a cube: change of the distance of the pads (m/s).
    pub jaw_close_speed: f64,
    /// Speed of closing jaws that are still wide open (m/s).
    pub jaw_reach_speed: f64,
    /// Largest speed of opening jaws (m/s).
    pub jaw_open_speed: f64,
    /// Force at which a behaviour gives up (N).
    pub force_limit: f64,
    /// Torque at which a behaviour gives up (Nm).
    pub torque_limit: f64,
}

/// Largest distance by which jaws may be forced apart while they hold the cube flat (m). A cube
/// that turns about the palm's axis between fingers 12 mm wide is then tilted by 6 deg.
pub const FORCED_APART: f64 = 0.001;

/// Returns the admittance (m/(s N)) of a direction that moves at `speed` (m/s) until it meets a
/// contact of `force` (N). If the motion went on in contact, its force would settle at speed over
/// admittance, which is twice `force`.
#[must_use]
pub fn guarded_admittance(speed: f64, force: f64) -> f64 {
    speed / (2.0 * force)
}

/// Directions of the tool frame that yield: x, y, z, then the rotations about them.
pub type Selector = [bool; 6];

impl Compliance {
    /// Returns the compliance under the factors of the operator's parameters.
    #[must_use]
    pub fn tuned(&self, factors: &Factors) -> Self {
        Self {
            linear_admittance: self.linear_admittance * factors[Parameter::LinearAdmittance],
            angular_admittance: self.angular_admittance * factors[Parameter::AngularAdmittance],
            force_limit: self.force_limit * factors[Parameter::ForceLimit],
            jaw_close_speed: self.jaw_close_speed * factors[Parameter::JawCloseSpeed],
            ..*self
        }
    }

    /// Returns the six directions of a task motion: the selected ones seek zero force, the others
    /// hold.
    #[must_use]
    pub fn yielding(&self, selector: &Selector) -> [Direction; 6] {
        std::array::from_fn(|i| if selector[i] { self.contact(i, 0.0) } else { Direction::HOLD })
    }

    /// Returns the law of a direction (0 to 2 linear, 3 to 5 angular) that seeks the `wanted` force
    /// (N) or torque (Nm).
    #[must_use]
    pub fn contact(&self, direction: usize, wanted: f64) -> Direction {
        let (admittance, inertia) = if direction < 3 {
            (self.linear_admittance, self.linear_inertia)
        } else {
            (self.angular_admittance, self.angular_inertia)
        };
        Direction::Contact { wanted, admittance, inertia }
    }

    /// Returns the law of a linear direction that moves at `velocity` (m/s) and yields to a
    /// contact, whose expected force is `force` (N): see [`guarded_admittance`].
    #[must_use]
    pub fn guarded(&self, velocity: f64, force: f64) -> Direction {
        Direction::Guarded {
            velocity,
            admittance: guarded_admittance(velocity.abs(), force),
            inertia: self.linear_inertia,
        }
    }

    /// Returns the command for one macrostep of a task motion in the tool frame, with set values
    /// for the jaws if they are to move.
    #[must_use]
    pub fn task(&self, directions: [Direction; 6], jaw: Option<JawCommand>) -> MoveCommand {
        MoveCommand {
            motion: Motion::Task { frame: Frame::Tool, directions },
            periods: self.macrostep,
            jaw,
        }
    }

    /// Returns [`Outcome::ForcedApart`] if the jaws are more than 1 mm wider than their least
    /// distance since the behaviour began, which `jaws` keeps (m): the cube then turns between
    /// them. The least distance counts, because a cube that was tilted at first lets the jaws close
    /// before it forces them apart.
    pub(super) fn forced_apart(jaws: &mut Option<f64>, arm: &ArmState) -> Option<Outcome> {
        let least = jaws.map_or(arm.jaw_opening, |least| least.min(arm.jaw_opening));
        *jaws = Some(least);
        let apart = arm.jaw_opening - least;
        (apart > FORCED_APART).then_some(Outcome::ForcedApart(apart))
    }

    /// Returns [`Outcome::OverForce`] if the measured force or torque exceeds its limit.
    #[must_use]
    pub fn excess(&self, arm: &ArmState) -> Option<Outcome> {
        self.unyielding(&[false; 6], arm)
    }

    /// Returns [`Outcome::OverForce`] if the measured force or torque exceeds its limit and its
    /// largest component lies in a direction that does not yield by `selector`. The force is
    /// checked before the torque.
    #[must_use]
    pub fn unyielding(&self, selector: &Selector, arm: &ArmState) -> Option<Outcome> {
        let Wrench { force, torque } = arm.wrench_in_tool;
        [(0, force, self.force_limit), (3, torque, self.torque_limit)]
            .into_iter()
            // The limit applies to the whole vector, and its largest component names the direction.
            .map(|(first, vector, limit)| (first + vector.iamax(), vector.norm(), limit))
            .find(|(direction, much, limit)| much > limit && !selector[*direction])
            .map(|(direction, much, _)| Outcome::OverForce(direction, much))
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::compliance;
    use super::*;

    #[test]
    fn guarded_move_settles_at_twice_contact_threshold() {
        let compliance = compliance();
        for velocity in [0.02, -0.01] {
            let Direction::Guarded { velocity: v, admittance, inertia } =
                compliance.guarded(velocity, 4.0)
            else {
                panic!("the direction is not guarded")
            };
            assert_eq!((v, inertia), (velocity, compliance.linear_inertia));
            let settles_at = velocity.abs() / admittance;
            assert!((settles_at - 2.0 * 4.0).abs() < 1e-12, "{settles_at} N");
        }
    }
}
