//! EDPT: the position-force law of one servo period.
//!
//! Each direction of the task frame follows a velocity, or seeks a force, or does the first and yields to the
//! second. A force error is scaled into a velocity, an inertia smooths it, and the displacements are
//! integrated on the commanded pose: the arm is a damper in each force direction.
//!
//! - in: the six [`Direction`]s, the frame they are expressed in, the wrench that the tool exerts on its
//!   surroundings, the commanded pose
//! - out: the commanded pose of the next period
//! - source: Bruyninckx and De Schutter (1996); Zieliński et al. (2007), p. 371; the inertia term and the
//!   integration on the commanded pose are from the original's sources

use crate::motion::{Direction, Frame, PERIOD};
use crate::spatial::{Pose, Twist, Wrench};

/// The law's memory: the displacement of the last period, in base orientation.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ForceLaw {
    last: Twist,
    last_period: u64,
}

impl ForceLaw {
    /// Periods without a task motion after which the momentum is forgotten.
    const MEMORY: u64 = 10;

    /// The commanded `base_from_tool` after this period; `wrench` is what the tool exerts on its
    /// surroundings, about the tool point, in tool axes.
    pub fn step(
        &mut self,
        period: u64,
        frame: Frame,
        directions: &[Direction; 6],
        wrench: &Wrench,
        base_from_tool: &Pose,
    ) -> Pose {
        if period.saturating_sub(self.last_period) > Self::MEMORY {
            self.last = Twist::default();
        }
        let base_from_axes = match frame {
            Frame::Base => Pose::identity().rotation,
            Frame::Tool => base_from_tool.rotation,
        };
        let tool_from_axes = base_from_tool.rotation.inverse() * base_from_axes;
        let force = wrench.rotated(&tool_from_axes.inverse());
        let last = self.last.rotated(&base_from_axes.inverse());

        let moved = displacement(directions, &force, &last);

        self.last = moved.rotated(&base_from_axes);
        self.last_period = period;
        base_from_tool * moved.rotated(&tool_from_axes).displacement()
    }
}

/// Displacement in one period; all in the axes of the task frame:
/// `d = ((B (wanted - F) + v) T^2 + B M d_last) / (T + B M)`.
#[must_use]
pub fn displacement(directions: &[Direction; 6], wrench: &Wrench, last: &Twist) -> Twist {
    let (forces, lasts) = (wrench.directions(), last.directions());
    Twist::from_directions(std::array::from_fn(|i| {
        let (velocity, wanted, admittance, inertia) = match directions[i] {
            // Not by way of B = M = 0: a silent sensor (not a number) must not reach a position direction.
            Direction::Unguarded { velocity } => return velocity * PERIOD,
            Direction::Guarded { velocity, admittance, inertia } => {
                (velocity, 0.0, admittance, inertia)
            }
            Direction::Contact { wanted, admittance, inertia } => {
                (0.0, wanted, admittance, inertia)
            }
        };
        let pushed = admittance * (wanted - forces[i]) + velocity;
        let lag = admittance * inertia;
        (pushed * PERIOD * PERIOD + lag * lasts[i]) / (PERIOD + lag)
    }))
}

/// Whether any direction heeds the force.
#[must_use]
pub fn heeds_force(directions: &[Direction; 6]) -> bool {
    directions.iter().any(|d| !matches!(d, Direction::Unguarded { .. }))
}
