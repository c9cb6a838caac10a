//! Circular arc of the tool.
//!
//! - in: a point on the way and the pose at the end; the set pose at the beginning
//! - out: the arc through the three points. The tool turns about one axis, evenly along the arc

use super::super::own::{Place, Site};
use super::along::PathOrder;
use super::curve::{Cell, Curve, Demand};
use super::limits::Limits;
use crate::spatial::{Pose, is_rigid};
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Number of cells of an arc.
const CELLS: u32 = 96;
/// Least sine of the angle between the chords to both points. Below it the points lie on a line.
const LEAST_SINE: f64 = 1e-4;

/// Order of a motion of the tool along a circular arc.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Arc {
    /// Position of the tool point on the way, in the base (m).
    pub via: Vector3<f64>,
    /// `base_from_tool` at the end.
    pub target: Pose,
    /// Fraction of the full speeds and accelerations, above 0 and at most 1.
    pub speed: f64,
}

/// An arc.
struct Circle {
    centre: Vector3<f64>,
    /// From the centre to the beginning, and at right angles to it in the direction of motion (m).
    arms: [Vector3<f64>; 2],
    radius: f64,
    /// Length of the arc (m).
    length: f64,
    from: Pose,
    to: Pose,
    /// Rotation vector of the whole turn of the tool, in base axes (rad).
    turn: Vector3<f64>,
    limits: Limits,
}

impl PathOrder for Arc {
    fn curve(self, site: &Site<'_>) -> Result<Box<dyn Curve>, String> {
        let limits = Limits::of(site, self.speed)?;
        let (from, to) = (site.arm.desired_base_from_tool, self.target);
        if !(is_rigid(&to) && self.via.iter().all(|c| c.is_finite())) {
            return Err("a point of the arc is not finite".to_owned());
        }
        let start = from.translation.vector;
        let (b, c) = (self.via - start, to.translation.vector - start);
        let normal = b.cross(&c);
        let apart = (c - b).norm() > LEAST_SINE * b.norm();
        if !apart || normal.norm() <= LEAST_SINE * b.norm() * c.norm() {
            return Err("the three points of the arc lie on a line".to_owned());
        }
        // Centre of the circle through 0, b and c.
        let out = (normal.cross(&b) * c.norm_squared() + c.cross(&normal) * b.norm_squared())
            / (2.0 * normal.norm_squared());
        let (radius, first) = (out.norm(), -out);
        let second = normal.normalize().cross(&first);
        let end = c - out;
        // The motion about `normal` passes b first, then c.
        let angle = libm::atan2(end.dot(&second), end.dot(&first)).rem_euclid(TAU);
        Ok(Box::new(Circle {
            centre: start + out,
            arms: [first, second],
            radius,
            length: angle * radius,
            from,
            to,
            turn: (to.rotation * from.rotation.inverse()).scaled_axis(),
            limits,
        }))
    }
}

impl Curve for Circle {
    fn cells(&self) -> Vec<Cell> {
        let by = 1.0 / self.radius;
        let linear = Demand { derivatives: [1.0, by, by * by], limit: self.limits.linear };
        let turn = self.turn.norm() / self.length;
        let angular = Demand { derivatives: [turn, 0.0, 0.0], limit: self.limits.angular };
        let cell = Cell { length: self.length / f64::from(CELLS), demands: vec![linear, angular] };
        (0..CELLS).map(|_| cell.clone()).collect()
    }

    fn at(&self, u: f64) -> Place {
        if u >= self.length {
            return Place::Pose(self.to);
        }
        let angle = u / self.radius;
        let [first, second] = self.arms;
        let at = self.centre + first * libm::cos(angle) + second * libm::sin(angle);
        let turned = UnitQuaternion::from_scaled_axis(self.turn * (u / self.length));
        Place::Pose(Pose::from_parts(at.into(), turned * self.from.rotation))
    }
}
