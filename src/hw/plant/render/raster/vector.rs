//! Vectors of the inner loops.

use nalgebra::Vector3;

pub(super) type V3 = [f32; 3];

/// Rounds a vector.
pub(super) fn v3(v: Vector3<f64>) -> V3 {
    [v.x as f32, v.y as f32, v.z as f32]
}

/// Returns the product with the ray (x, y, 1).
#[inline(always)]
pub(super) fn dot(a: &V3, x: f32, y: f32) -> f32 {
    a[0] * x + (a[1] * y + a[2])
}
