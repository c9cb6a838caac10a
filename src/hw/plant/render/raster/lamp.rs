//! The light of a scene, in the camera frame.

use super::vector::{V3, dot};
use crate::hw::plant::render::look::Rgb;
use nalgebra::Vector3;

/// The light in the camera frame.
#[derive(Debug, Clone)]
pub(super) struct Lamp {
    /// Direction of the lamp, and upwards.
    pub(super) towards: Vector3<f64>,
    pub(super) up: Vector3<f64>,
    pub(super) towards_f32: V3,
    pub(super) up_f32: V3,
    pub(super) ambient: f32,
    pub(super) key: f32,
    pub(super) cast: Rgb,
    /// Shadow: plane's normal and offset over the softness, and depth.
    pub(super) shadow: Option<(V3, f32, f32)>,
}

impl Lamp {
    /// Light from all around on a surface whose normal has this upward part.
    pub(super) fn sky(&self, up: f32) -> f32 {
        self.ambient * if self.key > 0.0 { 0.82 + 0.18 * up } else { 1.0 }
    }

    /// Share of the lamp's light that reaches the point t (x, y, 1).
    #[inline(always)]
    pub(super) fn lit(&self, x: f32, y: f32, t: f32) -> f32 {
        match &self.shadow {
            None => 1.0,
            Some((normal, offset, depth)) => {
                1.0 - depth * (0.5 + dot(normal, x, y) * t - offset).clamp(0.0, 1.0)
            }
        }
    }
}
