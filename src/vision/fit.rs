//! Least squares of a few unknowns: Levenberg-Marquardt with a numerical Jacobian.
//!
//! - in: start values, a step of the numerical derivative for each unknown, a function that
//!   computes the residuals
//! - out: the minimum, the normal matrix and the residuals there
//! - source: Marquardt, "An algorithm for least-squares estimation of nonlinear parameters" (1963)

use crate::spatial::Pose;
use nalgebra::{SMatrix, SVector, Translation3, UnitQuaternion, Vector3};

/// Minimum at which the descent ended.
#[derive(Debug, Clone)]
pub(super) struct Minimum<const N: usize> {
    /// Unknowns.
    pub(super) at: SVector<f64, N>,
    /// Sum of the squared residuals.
    pub(super) cost: f64,
    /// Residuals at the minimum.
    pub(super) residuals: Vec<f64>,
    /// Transposed Jacobian times Jacobian of the residuals, at the last linearisation.
    pub(super) normal: SMatrix<f64, N, N>,
}

/// Greatest number of linearisations.
const ROUNDS: usize = 25;

/// Minimises the sum of the squared residuals over N unknowns, starting from `start`. `steps` are
/// the steps of the numerical derivatives. `residuals` appends the residuals at given unknowns to
/// its second argument; their number must not change.
pub(super) fn minimise<const N: usize>(
    start: SVector<f64, N>,
    steps: [f64; N],
    residuals: impl Fn(&SVector<f64, N>, &mut Vec<f64>),
) -> Minimum<N> {
    let evaluate = |at: &SVector<f64, N>, out: &mut Vec<f64>| {
        out.clear();
        residuals(at, out);
        out.iter().map(|r| r * r).sum::<f64>()
    };
    let (mut at, mut error, mut next) = (start, Vec::new(), Vec::new());
    let mut cost = evaluate(&at, &mut error);
    let mut jacobian = vec![SVector::<f64, N>::zeros(); error.len()];
    let mut normal = SMatrix::<f64, N, N>::zeros();
    let mut damping = 1e-3;
    for _ in 0..ROUNDS {
        // Forward differences cost one evaluation per unknown. Central ones would cost two, and the
        // steps of the callers are small enough.
        for k in 0..N {
            let mut ahead = at;
            ahead[k] += steps[k];
            evaluate(&ahead, &mut next);
            for ((row, a), b) in jacobian.iter_mut().zip(&next).zip(&error) {
                row[k] = (a - b) / steps[k];
            }
        }
        normal.fill(0.0);
        let mut gradient = SVector::<f64, N>::zeros();
        for (row, e) in jacobian.iter().zip(&error) {
            normal.syger(1.0, row, row, 1.0);
            gradient += row * *e;
        }
        normal.fill_upper_triangle_with_lower_triangle();
        // Each failed step raises the damping tenfold, which turns the next step towards the
        // steepest descent. After eight failures in a row this is the numerical minimum.
        let mut moved_on = false;
        for _ in 0..8 {
            let mut damped = normal;
            for k in 0..N {
                // The damping is relative to each unknown (Marquardt), so that metres and radians
                // need no common scale.
                damped[(k, k)] *= 1.0 + damping;
            }
            let Some(factor) = damped.cholesky() else { break };
            let candidate = at - factor.solve(&gradient);
            let next_cost = evaluate(&candidate, &mut next);
            if next_cost < cost {
                // A step with a relative gain below 1e-7 is accepted, but it ends the descent.
                moved_on = cost - next_cost > 1e-7 * cost;
                std::mem::swap(&mut error, &mut next);
                (at, cost) = (candidate, next_cost);
                damping = (damping * 0.1).max(1e-9);
                break;
            }
            damping *= 10.0;
        }
        if !moved_on {
            break;
        }
    }
    Minimum { at, cost, residuals: error, normal }
}

/// Returns a pose after a small motion `delta` in the axes of its parent frame: translation (m) in
/// the first three elements, rotation vector (rad) about the pose's own origin in the others.
#[must_use]
pub(super) fn moved(pose: &Pose, delta: [f64; 6]) -> Pose {
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(delta[3], delta[4], delta[5]));
    Pose::from_parts(
        Translation3::from(pose.translation.vector + Vector3::new(delta[0], delta[1], delta[2])),
        rotation * pose.rotation,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    #[test]
    fn minimise_fits_curve_to_points() {
        let points: Vec<(f64, f64)> =
            (0..9).map(|i| 0.5 * f64::from(i)).map(|t| (t, 3.0 * (-0.7 * t).exp())).collect();

        let found = minimise(Vector2::new(1.0, 0.1), [1e-6; 2], |x, out| {
            out.extend(points.iter().map(|(t, y)| y - x[0] * (-x[1] * t).exp()));
        });

        assert!((found.at - Vector2::new(3.0, 0.7)).norm() < 1e-6, "{}", found.at);
        assert!(found.cost < 1e-12 && found.residuals.len() == 9);
        assert!(found.normal[(0, 1)] == found.normal[(1, 0)]);
    }
}
