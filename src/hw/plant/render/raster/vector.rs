//! Vectors of the inner loops, in `f32`.

use nalgebra::Vector3;

/// Vector of three components.
pub(super) type V3 = [f32; 3];

/// Rounds a vector to `f32`.
pub(super) fn v3(v: Vector3<f64>) -> V3 {
    [v.x as f32, v.y as f32, v.z as f32]
}

/// Returns the scalar product of a vector with the ray (x, y, 1).
#[inline(always)]
pub(super) fn dot(a: &V3, x: f32, y: f32) -> f32 {
    a[0] * x + (a[1] * y + a[2])
}
