//! How compliant directions behave: one set of admittances and limits for all generators of an arm.

use super::outcome::Outcome;
use crate::motion::{ArmState, Direction, Frame, JawCommand, Motion, MoveCommand};
use crate::spatial::Wrench;
use serde::{Deserialize, Serialize};

/// How compliant directions behave, the macrostep, jaws and limits: one set for all generators of
/// an arm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Compliance {
    /// B of the linear directions (m/(s N)).
    pub linear_admittance: f64,
    /// M of the linear directions (kg).
    pub linear_inertia: f64,
    /// B of the angular directions (rad/(s Nm)).
    pub angular_admittance: f64,
    /// M of the angular directions (kg m2).
    pub angular_inertia: f64,
    /// Periods of a macrostep.
    pub macrostep: u32,
    /// Speed of jaws that close on a cube, distance of the pads (m/s).
    pub jaw_close_speed: f64,
    /// Speed of closing jaws that are still well open (m/s).
    pub jaw_reach_speed: f64,
    /// Largest speed of opening jaws (m/s).
    pub jaw_open_speed: f64,
    /// Force at which a behaviour gives up (N).
    pub force_limit: f64,
    /// Torque at which a behaviour gives up (Nm).
    pub torque_limit: f64,
}

/// Jaws that hold the cube and are forced apart by more do not lie flat on it any more (m): a cube
/// that turns between fingers of 12 mm about the palm's axis stands askew by 6 deg then.
pub const FORCED_APART: f64 = 0.001;

/// Returns the admittance of a direction that goes at a speed (m/s) until it feels a force (N): in
/// contact it would settle at speed over admittance, twice that force (m/(s N)).
#[must_use]
pub fn guarded_admittance(speed: f64, force: f64) -> f64 {
    speed / (2.0 * force)
}

/// Which directions of the tool frame yield: x, y, z, then rotations about them.
pub type Selector = [bool; 6];

impl Compliance {
    /// The directions of a task in which the selected ones seek zero force and the others stand
    /// still.
    #[must_use]
    pub fn yielding(&self, selector: &Selector) -> [Direction; 6] {
        std::array::from_fn(|i| if selector[i] { self.contact(i, 0.0) } else { Direction::HOLD })
    }

    /// A direction that seeks a force (N) or torque (Nm).
    #[must_use]
    pub fn contact(&self, direction: usize, wanted: f64) -> Direction {
        let (admittance, inertia) = if direction < 3 {
            (self.linear_admittance, self.linear_inertia)
        } else {
            (self.angular_admittance, self.angular_inertia)
        };
        Direction::Contact { wanted, admittance, inertia }
    }

    /// Returns a linear direction that goes at a velocity (m/s) and stops at contact: see
    /// [`guarded_admittance`].
    #[must_use]
    pub fn guarded(&self, velocity: f64, force: f64) -> Direction {
        Direction::Guarded {
            velocity,
            admittance: guarded_admittance(velocity.abs(), force),
            inertia: self.linear_inertia,
        }
    }

    /// A task motion in the tool frame for one macrostep.
    #[must_use]
    pub fn task(&self, directions: [Direction; 6], jaw: Option<JawCommand>) -> MoveCommand {
        MoveCommand {
            motion: Motion::Task { frame: Frame::Tool, directions },
            periods: self.macrostep,
            jaw,
        }
    }

    /// Returns whether jaws that were no farther apart (m) since a turn began are forced apart by
    /// the cube that they hold. A cube that stood askew between them when the turn began comes
    /// upright before it forces them apart the other way.
    pub(super) fn forced_apart(jaws: &mut Option<f64>, arm: &ArmState) -> Option<Outcome> {
        let least = jaws.map_or(arm.jaw_opening, |least| least.min(arm.jaw_opening));
        *jaws = Some(least);
        let apart = arm.jaw_opening - least;
        (apart > FORCED_APART).then_some(Outcome::ForcedApart(apart))
    }

    /// The first direction in which the arm's wrench is beyond the limits.
    #[must_use]
    pub fn excess(&self, arm: &ArmState) -> Option<Outcome> {
        self.unyielding(&[false; 6], arm)
    }

    /// The first that is beyond the limits and does not yield: of the force, then of the torque,
    /// the direction that has most of it, and all of it.
    #[must_use]
    pub fn unyielding(&self, selector: &Selector, arm: &ArmState) -> Option<Outcome> {
        let Wrench { force, torque } = arm.wrench_in_tool;
        [(0, force, self.force_limit), (3, torque, self.torque_limit)]
            .into_iter()
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
    fn guarded_direction_settles_at_twice_the_force() {
        let compliance = compliance();
        for velocity in [0.02, -0.01] {
            let Direction::Guarded { velocity: v, admittance, inertia } =
                compliance.guarded(velocity, 4.0)
            else {
                panic!("it yields to a force alone")
            };
            assert_eq!((v, inertia), (velocity, compliance.linear_inertia));
            assert!((velocity.abs() / admittance - 8.0).abs() < 1e-12);
        }
    }
}
