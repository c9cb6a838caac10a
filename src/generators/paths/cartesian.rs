//! Paths of the tool through poses: line, spline, polyline with rounded corners.
//!
//! - in: poses, each a `base_from_tool`; the set pose at the beginning
//! - out: a curve of position and rotation vector, six numbers
//! - The rotation vector is that of the turn from the beginning, in base axes. A whole turn more or
//!   less is the same orientation: the vector nearest to that of the pose before is taken.

use super::super::own::{Place, Site};
use super::along::PathOrder;
use super::curve::{Cell, Curve, Demand, rotation};
use super::limits::Limits;
use super::polynomial::Polynomial;
use crate::spatial::{Pose, is_rigid};
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Least distance of two poses, in the parameter of a path (m).
const LEAST: f64 = 1e-6;
/// Greatest turn from the beginning of a path (rad). At a whole turn, rotation vectors are
/// singular.
const TURN: f64 = 0.8 * TAU;

/// Order of a straight motion of the tool.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Line {
    /// `base_from_tool` at the end.
    pub target: Pose,
    /// Fraction of the full speeds and accelerations, above 0 and at most 1.
    pub speed: f64,
}

/// Order of a smooth motion of the tool through poses, without a stop.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Spline {
    /// Poses `base_from_tool`, the last of them at the end.
    pub through: Vec<Pose>,
    /// Fraction of the full speeds and accelerations, above 0 and at most 1.
    pub speed: f64,
}

/// Order of straight motions of the tool from pose to pose, without a stop.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Polyline {
    /// Poses `base_from_tool`, the last of them at the end.
    pub through: Vec<Pose>,
    /// Distance from a corner within which the tool leaves the legs (m), at most half of a leg.
    /// A turn counts as the distance that takes as long at full speed.
    pub radius: f64,
    /// Fraction of the full speeds and accelerations, above 0 and at most 1.
    pub speed: f64,
}

/// Curve of a tool.
struct Tool {
    path: Polynomial<6>,
    length: f64,
    from: Pose,
    to: Pose,
    limits: Limits,
    /// Whether the tool turns about one axis only.
    one_axis: bool,
}

/// Points of a path, and the distances between neighbours in its parameter.
struct Points {
    places: Vec<[f64; 6]>,
    lengths: Vec<f64>,
    from: Pose,
    to: Pose,
    limits: Limits,
}

impl Points {
    /// Returns the points of a path from the set pose of the arm through these poses.
    fn of(through: &[Pose], speed: f64, site: &Site<'_>) -> Result<Self, String> {
        let limits = Limits::of(site, speed)?;
        let from = site.arm.desired_base_from_tool;
        let to = *through.last().ok_or("the path has no pose")?;
        if !through.iter().all(is_rigid) {
            return Err("a pose of the path is not finite".to_owned());
        }
        // Turns count as the distance that takes as long.
        let radius = limits.linear.speed / limits.angular.speed;
        let (mut points, mut lengths) = (vec![point(&from, Vector3::zeros())], Vec::new());
        let mut turned = Vector3::zeros();
        for pose in through {
            turned = near(&(pose.rotation * from.rotation.inverse()), &turned);
            if turned.norm() > TURN {
                return Err("the tool turns by more than 288 deg".to_owned());
            }
            let (next, last) = (point(pose, turned), points[points.len() - 1]);
            let by = |d: usize| next[d] - last[d];
            let (moves, turns) = (norm([by(0), by(1), by(2)]), norm([by(3), by(4), by(5)]));
            let length = moves.hypot(radius * turns);
            if length > LEAST {
                points.push(next);
                lengths.push(length);
            }
        }
        Ok(Self { places: points, lengths, from, to, limits })
    }

    /// Makes the curve of these points from its polynomial.
    fn curve(self, path: impl FnOnce(&Self) -> Polynomial<6>) -> Tool {
        let (path, length) = (path(&self), self.lengths.iter().sum());
        let Self { places, from, to, limits, .. } = self;
        Tool { path, length, from, to, limits, one_axis: places.len() == 2 }
    }
}

/// Returns the six numbers of a pose whose turn from the beginning is `turned` (rad).
fn point(pose: &Pose, turned: Vector3<f64>) -> [f64; 6] {
    let at = pose.translation.vector;
    [at.x, at.y, at.z, turned.x, turned.y, turned.z]
}

/// Returns the rotation vector of a turn (rad), of all equivalent ones that nearest to `last`.
fn near(turn: &UnitQuaternion<f64>, last: &Vector3<f64>) -> Vector3<f64> {
    let vector = turn.scaled_axis();
    let axis =
        vector.try_normalize(1e-9).unwrap_or_else(|| last.try_normalize(1e-9).unwrap_or_default());
    let turns = ((last - vector).dot(&axis) / TAU).round();
    vector + axis * (turns * TAU)
}

/// Returns the length of a vector.
fn norm(v: [f64; 3]) -> f64 {
    Vector3::from(v).norm()
}

impl Curve for Tool {
    fn cells(&self) -> Vec<Cell> {
        let norms = |d: &[f64; 6]| [norm([d[0], d[1], d[2]]), norm([d[3], d[4], d[5]])];
        let cells = self.path.cells(norms).into_iter();
        let cell = |(length, [linear, turn]): (f64, [[f64; 3]; 2])| {
            // About one axis, the angle is the rotation vector.
            let turn = if self.one_axis { turn } else { rotation(turn) };
            Cell {
                length,
                demands: vec![
                    Demand { derivatives: linear, limit: self.limits.linear },
                    Demand { derivatives: turn, limit: self.limits.angular },
                ],
            }
        };
        cells.map(cell).collect()
    }

    fn at(&self, u: f64) -> Place {
        // The end is exact, without the rounding of all pieces.
        if u >= self.length {
            return Place::Pose(self.to);
        }
        let [x, y, z, a, b, c] = self.path.at(u);
        let turned = UnitQuaternion::from_scaled_axis(Vector3::new(a, b, c));
        Place::Pose(Pose::from_parts(Vector3::new(x, y, z).into(), turned * self.from.rotation))
    }
}

impl PathOrder for Line {
    fn curve(self, site: &Site<'_>) -> Result<Box<dyn Curve>, String> {
        let points = Points::of(&[self.target], self.speed, site)?;
        Ok(Box::new(points.curve(|of| Polynomial::spline(&of.places, &of.lengths))))
    }
}

impl PathOrder for Spline {
    fn curve(self, site: &Site<'_>) -> Result<Box<dyn Curve>, String> {
        let points = Points::of(&self.through, self.speed, site)?;
        Ok(Box::new(points.curve(|of| Polynomial::spline(&of.places, &of.lengths))))
    }
}

impl PathOrder for Polyline {
    fn curve(self, site: &Site<'_>) -> Result<Box<dyn Curve>, String> {
        let points = Points::of(&self.through, self.speed, site)?;
        if (self.radius.is_nan() || self.radius <= 0.0) && points.places.len() > 2 {
            return Err("corners need a radius above 0".to_owned());
        }
        let reach: Vec<f64> = points
            .lengths
            .windows(2)
            .map(|pair| self.radius.min(0.5 * pair[0]).min(0.5 * pair[1]))
            .collect();
        Ok(Box::new(points.curve(|of| Polynomial::rounded(&of.places, &of.lengths, &reach))))
    }
}
