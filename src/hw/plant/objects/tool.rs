//! A tool as the objects meet it in one substep, and the load that they put on it.

use super::super::config::Jaws;
use super::super::frame::{Frame, skew};
use crate::cell::Gripper;
use crate::motion::Depth;
use nalgebra::{Matrix3, Matrix6, Vector3};

/// Tool with its gripper, in one substep.
pub(in crate::hw::plant) struct Tool<'a> {
    /// `world_from_tool`.
    pub(in crate::hw::plant) frame: Frame,
    /// Velocity of the tool point (m/s).
    pub(in crate::hw::plant) velocity: Vector3<f64>,
    /// Angular velocity (rad/s).
    pub(in crate::hw::plant) spin: Vector3<f64>,
    /// Sizes of the gripper.
    pub(in crate::hw::plant) gripper: &'a Gripper,
    /// Pads of the gripper.
    pub(in crate::hw::plant) jaws: &'a Jaws,
    /// Distance between the pads (m).
    pub(in crate::hw::plant) opening: f64,
    /// Whether the motor is opening the jaws.
    pub(in crate::hw::plant) opens: bool,
    /// Position of the palm's stops.
    pub(in crate::hw::plant) stops: Depth,
    /// Share of the pads' friction that a fault leaves.
    pub(in crate::hw::plant) friction: f64,
    /// Whether a fault makes the gripper hold nothing.
    pub(in crate::hw::plant) loses: bool,
    /// Whether the gripper holds the cube.
    pub(in crate::hw::plant) busy: bool,
}

impl Tool<'_> {
    /// Returns the velocity of a point of the tool, given in the world (m/s).
    pub(super) fn velocity_at(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.velocity + self.spin.cross(&(point - self.frame.p))
    }
}

/// Load of all objects on a tool.
#[derive(Debug, Clone, Copy)]
pub(in crate::hw::plant) struct Load {
    /// Force at the tool point, in the world (N).
    pub(in crate::hw::plant) force: Vector3<f64>,
    /// Torque about the tool point, in the world (Nm).
    pub(in crate::hw::plant) torque: Vector3<f64>,
    /// Negated derivative of the wrench by displacement and rotation of the tool, in tool axes.
    pub(in crate::hw::plant) stiffness: Matrix6<f64>,
    /// Force of the pads at +y and -y (N).
    pub(in crate::hw::plant) pads: [f64; 2],
}

impl Load {
    pub(super) const NONE: Self = Self {
        force: Vector3::new(0.0, 0.0, 0.0),
        torque: Vector3::new(0.0, 0.0, 0.0),
        stiffness: super::super::grasp::Touch::NONE.stiffness,
        pads: [0.0; 2],
    };

    /// Checks whether any object or person acts on the tool.
    pub(in crate::hw::plant) fn any(&self) -> bool {
        self.force != Vector3::zeros() || self.torque != Vector3::zeros() || self.pads != [0.0; 2]
    }

    /// Adds a force (N) at a point, both in the world. `stiffness` is its negated derivative by the
    /// displacement of that point of the tool (N/m), in the world.
    pub(super) fn push(
        &mut self,
        tool: &Frame,
        at: &Vector3<f64>,
        force: &Vector3<f64>,
        stiffness: &Matrix3<f64>,
    ) {
        let lever = at - tool.p;
        self.force += force;
        self.torque += lever.cross(force);
        // The point moves by d + w x lever.
        let k = tool.r.tr_mul(stiffness) * tool.r;
        let s = skew(&tool.r.tr_mul(&lever));
        let ks = k * s;
        let mut add = |row: usize, column: usize, block: Matrix3<f64>| {
            let mut view = self.stiffness.fixed_view_mut::<3, 3>(row, column);
            view += block;
        };
        add(0, 0, k);
        add(0, 3, -ks);
        add(3, 0, -ks.transpose());
        add(3, 3, s.transpose() * ks);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A point 0.1 m beyond the tool point, pressed along x: the wrench falls by the stiffness
    /// times the displacement of that point.
    #[test]
    fn point_stiffness_equals_derivative_of_wrench() {
        let tool = Frame::IDENTITY;
        let (at, k) = (Vector3::new(0.0, 0.02, 0.1), 1e4);
        let along = Matrix3::from_diagonal(&Vector3::new(k, 0.0, 0.0));
        let mut load = Load::NONE;
        load.push(&tool, &at, &Vector3::zeros(), &along);

        // A rotation about y by 1 mrad moves the point by 0.1 mm along x, about z by -0.02 mm.
        for (turn, moved) in [(4, 1e-4), (5, -2e-5)] {
            let force = -k * moved;
            let torque = at.cross(&(Vector3::x() * force));
            let column = load.stiffness.column(turn) * -1e-3;
            assert!((column[0] - force).abs() < 1e-12, "{column}");
            assert!((column.fixed_rows::<3>(3) - torque).norm() < 1e-12, "{column} {torque}");
        }
    }
}
