//! Paths of all joints through joint positions: spline, polyline with rounded corners.
//!
//! - in: joint positions; the set values at the beginning
//! - out: a curve of the seven joints, each within its own limits

use super::super::own::{Place, Site};
use super::along::PathOrder;
use super::curve::{Cell, Curve, Demand};
use super::limits::Limits;
use super::polynomial::Polynomial;
use crate::motion::{AXES, JointPositions};
use serde::{Deserialize, Serialize};

/// Least distance of two points of a path: the time from one to the other at full speed (s).
const LEAST: f64 = 1e-6;

/// Order of a smooth motion through joint positions, without a stop.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JointSpline {
    /// Joint positions, the last of them at the end.
    pub through: Vec<JointPositions>,
    /// Fraction of the full speeds and accelerations, above 0 and at most 1.
    pub speed: f64,
}

/// Order of motions straight in joint space from place to place, without a stop.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JointPolyline {
    /// Joint positions, the last of them at the end.
    pub through: Vec<JointPositions>,
    /// Share of the shorter leg at a corner within which the joints leave the legs, above 0 and at
    /// most 0.5.
    pub blend: f64,
    /// Fraction of the full speeds and accelerations, above 0 and at most 1.
    pub speed: f64,
}

/// Curve of the joints.
struct Joints {
    path: Polynomial<AXES>,
    length: f64,
    to: JointPositions,
    limits: Limits,
}

/// Points of a path, and the times between neighbours at full speed (s).
type Points = (Vec<[f64; AXES]>, Vec<f64>);

/// Returns the points of a path from the set values of the arm.
fn points(through: &[JointPositions], limits: &Limits, site: &Site<'_>) -> Result<Points, String> {
    if through.is_empty() || !through.iter().all(|at| at.0.iter().all(|q| q.is_finite())) {
        return Err("the path has no joint positions, or some that are not finite".to_owned());
    }
    let (mut points, mut lengths) = (vec![site.arm.desired_joints.0], Vec::new());
    for JointPositions(next) in through {
        let last = points[points.len() - 1];
        let seconds = |i: usize| (next[i] - last[i]).abs() / limits.joints[i].speed;
        let length = (0..AXES).map(seconds).fold(0.0, f64::max);
        if length > LEAST {
            points.push(*next);
            lengths.push(length);
        }
    }
    Ok((points, lengths))
}

/// Makes the curve of a polynomial that ends at the last place of `through`.
fn curve(
    path: Polynomial<AXES>,
    lengths: &[f64],
    through: &[JointPositions],
    limits: Limits,
) -> Box<dyn Curve> {
    let to = through.last().copied().unwrap_or_default();
    Box::new(Joints { path, length: lengths.iter().sum(), to, limits })
}

impl PathOrder for JointSpline {
    fn curve(self, site: &Site<'_>) -> Result<Box<dyn Curve>, String> {
        let limits = Limits::of(site, self.speed)?;
        let (points, lengths) = points(&self.through, &limits, site)?;
        Ok(curve(Polynomial::spline(&points, &lengths), &lengths, &self.through, limits))
    }
}

impl PathOrder for JointPolyline {
    fn curve(self, site: &Site<'_>) -> Result<Box<dyn Curve>, String> {
        let limits = Limits::of(site, self.speed)?;
        let (points, lengths) = points(&self.through, &limits, site)?;
        if !(self.blend > 0.0 && self.blend <= 0.5) {
            return Err(format!("a blend of {} of a leg is outside 0..=0.5", self.blend));
        }
        let reach: Vec<f64> =
            lengths.windows(2).map(|pair| self.blend * pair[0].min(pair[1])).collect();
        let path = Polynomial::rounded(&points, &lengths, &reach);
        Ok(curve(path, &lengths, &self.through, limits))
    }
}

impl Curve for Joints {
    fn cells(&self) -> Vec<Cell> {
        let cells = self.path.cells(|d| d.map(f64::abs)).into_iter();
        let cell = |(length, bounds): (f64, [[f64; 3]; AXES])| {
            let demands = bounds.iter().zip(&self.limits.joints);
            let demands = demands.map(|(&derivatives, &limit)| Demand { derivatives, limit });
            Cell { length, demands: demands.collect() }
        };
        cells.map(cell).collect()
    }

    fn at(&self, u: f64) -> Place {
        Place::Joints(if u >= self.length { self.to } else { JointPositions(self.path.at(u)) })
    }
}
