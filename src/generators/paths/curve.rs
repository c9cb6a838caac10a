//! A path without its course in time: places by a parameter, and the cost of moving along it.
//!
//! - in: a parameter u, from 0 to the length of the curve
//! - out: the place there; for each cell of the parameter the bounds of the derivatives

use super::super::own::Place;
use super::limits::Limit;

/// Largest derivatives of one moving thing with respect to the parameter within a cell, and its
/// limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Demand {
    /// Bounds of the norms of the first, second and third derivative (m or rad per u, u2, u3).
    pub derivatives: [f64; 3],
    /// Limits of its speed, acceleration and jerk.
    pub limit: Limit,
}

/// Part of the parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Cell {
    /// Length of the part, above 0.
    pub length: f64,
    /// All things that move: tool point and rotation, or joints.
    pub demands: Vec<Demand>,
}

/// A curve, twice continuously differentiable, with a bounded third derivative.
pub trait Curve: Send + Sync + 'static {
    /// Returns the cells of the parameter in their order; none for a curve without a length.
    fn cells(&self) -> Vec<Cell>;

    /// Returns the place at the parameter `u`. From the end of the last cell on this is exactly
    /// the end of the curve.
    fn at(&self, u: f64) -> Place;
}

/// Returns bounds of the derivatives of a tool's rotation `exp(phi(u))`, from bounds of those of
/// its rotation vector phi.
///
/// With the left Jacobian `J = int_0^1 exp(s [phi]) ds`, the angular velocity is `J phi'`. The norm
/// of J is at most 1, that of its derivative `|phi'| / 2`, and that of its second derivative
/// `|phi''| / 2 + |phi'|^2 / 2`, so the product rule gives these bounds.
pub(super) fn rotation([first, second, third]: [f64; 3]) -> [f64; 3] {
    [first, second + 0.5 * first * first, third + 1.5 * first * second + 0.5 * first.powi(3)]
}
