//! Light of a scene in the camera frame: a distant lamp with a shadow edge, and the sky.

use super::vector::{V3, dot};
use crate::hw::plant::render::look::Rgb;
use nalgebra::Vector3;

/// Light in the camera frame.
#[derive(Debug, Clone)]
pub(super) struct Lamp {
    /// Unit vector towards the lamp.
    pub(super) towards: Vector3<f64>,
    /// Unit vector upwards in the world.
    pub(super) up: Vector3<f64>,
    pub(super) towards_f32: V3,
    pub(super) up_f32: V3,
    /// Irradiance from all around, as in [`Light`](crate::hw::plant::render::Light).
    pub(super) ambient: f32,
    /// Irradiance of the lamp on a surface that faces it.
    pub(super) key: f32,
    /// Factors of red, green and blue by which the light and the white balance colour the picture.
    pub(super) cast: Rgb,
    /// Shadow: normal of the edge's plane and offset of the plane, both divided by the softness;
    /// share of the lamp's light that is lost.
    pub(super) shadow: Option<(V3, f32, f32)>,
}

impl Lamp {
    /// Returns the irradiance from all around on a surface whose normal has the upward component
    /// `up`.
    pub(super) fn sky(&self, up: f32) -> f32 {
        // Surfaces that face the floor get less light. Without a lamp the light is even, so that
        // `Look::studio` shows geometry alone.
        self.ambient * if self.key > 0.0 { 0.82 + 0.18 * up } else { 1.0 }
    }

    /// Returns the share of the lamp's light that reaches the point t (x, y, 1) in the camera
    /// frame; 1 where there is no shadow.
    #[inline(always)]
    pub(super) fn lit(&self, x: f32, y: f32, t: f32) -> f32 {
        match &self.shadow {
            None => 1.0,
            Some((normal, offset, depth)) => {
                // Linear over the softness, with half of the depth on the edge's plane.
                1.0 - depth * (0.5 + dot(normal, x, y) * t - offset).clamp(0.0, 1.0)
            }
        }
    }
}
