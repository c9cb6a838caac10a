//! Rotation matrices and rigid transforms for the inner loop of the plant.
//!
//! - in, out: matrices and vectors; `Frame` is a `to_from` transform like [`Pose`]
//! - why not [`Pose`]: the balance of forces composes many frames a substep, and matrices are
//!   cheaper there. Each sine here is from `libm`, so that a run has the same bits on every machine

use crate::spatial::Pose;
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// A rigid transform `to_from`.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Frame {
    /// Rotation.
    pub(super) r: Matrix3<f64>,
    /// Translation (m).
    pub(super) p: Vector3<f64>,
}

impl Frame {
    pub(super) const IDENTITY: Self = Self {
        r: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        p: Vector3::new(0.0, 0.0, 0.0),
    };

    /// Returns a pose as a frame.
    pub(super) fn from_pose(pose: &Pose) -> Self {
        Self { r: *pose.rotation.to_rotation_matrix().matrix(), p: pose.translation.vector }
    }

    /// Returns the frame as a pose.
    pub(super) fn to_pose(self) -> Pose {
        let rotation = Rotation3::from_matrix_unchecked(self.r);
        Pose::from_parts(
            Translation3::from(self.p),
            UnitQuaternion::from_rotation_matrix(&rotation),
        )
    }

    /// Returns the composition `self * other`: `a_from_b` times `b_from_c` is `a_from_c`.
    pub(super) fn times(&self, other: &Self) -> Self {
        Self { r: self.r * other.r, p: self.r * other.p + self.p }
    }

    /// Returns the inverse transform: `from_to` of `to_from`.
    pub(super) fn inverse(&self) -> Self {
        let r = self.r.transpose();
        Self { r, p: -(r * self.p) }
    }

    /// Returns `self.inverse() * other` without forming the inverse.
    pub(super) fn to_local(self, other: &Self) -> Self {
        Self { r: self.r.tr_mul(&other.r), p: self.r.tr_mul(&(other.p - self.p)) }
    }

    /// Returns a point given in `from` in the frame `to` (m).
    pub(super) fn point(&self, p: &Vector3<f64>) -> Vector3<f64> {
        self.r * p + self.p
    }

    /// Returns a frame that is rotated by `r` and not displaced.
    pub(super) fn rotated(r: Matrix3<f64>) -> Self {
        Self { r, p: Vector3::zeros() }
    }

    /// Returns the frame moved by a small displacement, given in the axes of the outer frame (`to`
    /// of `to_from`): the origin by `d` (m), the orientation by the rotation vector `w` (rad).
    pub(super) fn nudged(&self, d: &Vector3<f64>, w: &Vector3<f64>) -> Self {
        // Products of thousands of substeps would drift off the rotations.
        Self { r: orthonormal(&(rotation(w) * self.r)), p: self.p + d }
    }
}

/// Makes an almost orthonormal matrix exactly orthonormal (Gram-Schmidt).
pub(super) fn orthonormal(m: &Matrix3<f64>) -> Matrix3<f64> {
    let x: Vector3<f64> = m.column(0).into_owned();
    let x = x / x.norm();
    let y: Vector3<f64> = m.column(1).into_owned();
    let y = y - x * x.dot(&y);
    let y = y / y.norm();
    Matrix3::from_columns(&[x, y, x.cross(&y)])
}

/// Returns the rotation matrix of a rotation vector (rad), by Rodrigues' formula.
pub(super) fn rotation(w: &Vector3<f64>) -> Matrix3<f64> {
    let angle2 = w.norm_squared();
    // sin(a)/a and (1 - cos a)/a2 by series below 0.01 rad: exact to 1e-17 there.
    let (s, c) = if angle2 < 1e-4 {
        (1.0 - angle2 / 6.0 * (1.0 - angle2 / 20.0), 0.5 - angle2 / 24.0 * (1.0 - angle2 / 30.0))
    } else {
        let angle = angle2.sqrt();
        let (sine, cosine) = libm::sincos(angle);
        (sine / angle, (1.0 - cosine) / angle2)
    };
    let k = skew(w);
    Matrix3::identity() + k * s + k * k * c
}

/// Returns the rotation vector (rad) of a rotation matrix whose angle is below pi.
pub(super) fn rotation_vector(r: &Matrix3<f64>) -> Vector3<f64> {
    // The skew part of the matrix is the axis times sin a.
    let v = Vector3::new(r.m32 - r.m23, r.m13 - r.m31, r.m21 - r.m12) * 0.5;
    let s2 = v.norm_squared();
    let cosine = (r.trace() - 1.0) * 0.5;
    if s2 < 1e-4 && cosine > 0.0 {
        // asin(s)/s by series: cheap, and without a division by 0.
        return v * (1.0 + s2 / 6.0 * (1.0 + s2 * 9.0 / 20.0));
    }
    let s = s2.sqrt();
    if s < 1e-12 { Vector3::zeros() } else { v * (libm::atan2(s, cosine) / s) }
}

/// Returns the right-handed rotation by `angle` (rad) about a unit axis.
pub(super) fn about(axis: &Vector3<f64>, angle: f64) -> Matrix3<f64> {
    rotation(&(axis * angle))
}

/// Returns the matrix with `skew(w) * v == w x v`.
pub(super) fn skew(w: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -w.z, w.y, w.z, 0.0, -w.x, -w.y, w.x, 0.0)
}

/// Returns the rotation of a cube onto itself (one of 24, entries 0 and +-1) that is nearest to
/// `r`.
pub(super) fn nearest_alignment(r: &Matrix3<f64>) -> Matrix3<f64> {
    // The greatest entry of the rotation belongs to the alignment; the greatest one outside of its
    // row and column is the second.
    let greatest = |skip: Option<(usize, usize)>| {
        let mut best = (0, 0, -1.0);
        for row in 0..3 {
            for column in 0..3 {
                if skip.is_some_and(|(i, j)| i == row || j == column) {
                    continue;
                }
                let size = r[(row, column)].abs();
                if size > best.2 {
                    best = (row, column, size);
                }
            }
        }
        (best.0, best.1)
    };
    let first = greatest(None);
    let second = greatest(Some(first));
    let mut columns = [Vector3::zeros(); 3];
    for (row, column) in [first, second] {
        columns[column][row] = if r[(row, column)] < 0.0 { -1.0 } else { 1.0 };
    }
    // The third column follows: the alignment is right-handed.
    let (a, b) = (first.1, second.1);
    let third = 3 - a - b;
    columns[third] = columns[(third + 1) % 3].cross(&columns[(third + 2) % 3]);
    Matrix3::from_columns(&columns)
}

/// Solves `a x = b` by Cholesky for a symmetric positive definite `a`; `a` is consumed, `b` becomes
/// the solution. A pivot that is not positive is replaced by a tiny one, so that the solution stays
/// finite.
#[allow(
    clippy::needless_range_loop,
    reason = "the recurrences of a factorisation are clearer by index"
)]
pub(super) fn solve<const N: usize>(a: &mut [[f64; N]; N], b: &mut [f64; N]) {
    for j in 0..N {
        let mut d = a[j][j];
        for k in 0..j {
            d -= a[j][k] * a[j][k];
        }
        let l = if d > 1e-12 { d.sqrt() } else { 1e-6 };
        a[j][j] = l;
        let inverse = 1.0 / l;
        for i in j + 1..N {
            let mut s = a[i][j];
            for k in 0..j {
                s -= a[i][k] * a[j][k];
            }
            a[i][j] = s * inverse;
        }
    }
    // Forward with L, then backward with its transpose.
    for i in 0..N {
        let mut s = b[i];
        for k in 0..i {
            s -= a[i][k] * b[k];
        }
        b[i] = s / a[i][i];
    }
    for i in (0..N).rev() {
        let mut s = b[i];
        for k in i + 1..N {
            s -= a[k][i] * b[k];
        }
        b[i] = s / a[i][i];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotation_vector_survives_round_trip_through_matrix() {
        for w in [
            Vector3::new(1e-9, -2e-9, 3e-9),
            Vector3::new(0.004, 0.003, -0.002),
            Vector3::new(0.3, -0.2, 0.1),
            Vector3::new(-1.5, 1.9, 0.6),
        ] {
            assert!((rotation_vector(&rotation(&w)) - w).norm() < 1e-12 + 1e-9 * w.norm());
        }
    }

    #[test]
    fn nearest_aligned_rotation_ignores_small_tilt() {
        let quarter = std::f64::consts::FRAC_PI_2;
        let mut seen = Vec::new();
        for i in 0..4 {
            for j in 0..4 {
                for k in 0..4 {
                    let aligned = about(&Vector3::x(), quarter * f64::from(i))
                        * about(&Vector3::y(), quarter * f64::from(j))
                        * about(&Vector3::z(), quarter * f64::from(k));
                    let exact = aligned.map(|c| c.round() + 0.0);
                    let tilted = aligned * rotation(&Vector3::new(0.2, -0.3, 0.15));

                    assert_eq!(nearest_alignment(&tilted), exact);
                    if !seen.contains(&exact) {
                        seen.push(exact);
                    }
                }
            }
        }
        assert_eq!(seen.len(), 24);
    }
}
