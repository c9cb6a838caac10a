//! Primitive solids of a link: its shape for viewers and for collision checks.

use crate::spatial::Pose;

/// Primitive solid in the frame of its link.
#[derive(Debug, Clone, PartialEq)]
pub struct Solid {
    /// Pose of the solid's centre and axes in the frame of the link.
    pub link_from_solid: Pose,
    /// Shape.
    pub shape: Shape,
    /// Red, green, blue, each 0 to 1.
    pub colour: [f64; 3],
}

/// Primitive shape with its centre in the origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// Box with these edges (m).
    Box([f64; 3]),
    /// Cylinder about the z axis: radius and length (m).
    Cylinder(f64, f64),
}
