//! Vision: image -> faces, pose, colours. Pure.

use crate::spatial::Pose;

/// A face of a cube found in an image.
#[derive(Debug, Clone, PartialEq)]
pub struct FaceSighting {
    /// Corners of the face's outline [px], in the image: top-left, top-right, bottom-right, bottom-left of
    /// the reading order used for the tiles.
    pub corners: [(f64, f64); 4],
    /// Centres of the nine tiles in reading order [px].
    pub centres: [(f64, f64); 9],
    /// Mean colour of each tile, linear or as in the image (documented by the producer), 0..=255.
    pub rgb: [[f64; 3]; 9],
    /// Decision for each tile on this face alone: 0..=5 = white, red, green, yellow, orange, blue (URFDLB).
    pub colours: [u8; 9],
    /// Confidence of each decision, 0..=1.
    pub confidences: [f64; 9],
    /// Confidence that this is a face of a cube, 0..=1.
    pub confidence: f64,
}

/// The cube localised in 3-D.
#[derive(Debug, Clone, PartialEq)]
pub struct CubeSighting {
    /// Frame of the dominant face: origin in the face's centre, x along increasing column, y along increasing
    /// row of its reading order, z into the cube (away from the camera when frontal).
    pub camera_from_face: Pose,
    /// Edge of the face in the image [px].
    pub width_px: f64,
    /// Root mean square of the reprojection error [px].
    pub residual_px: f64,
    /// The face itself.
    pub face: FaceSighting,
}
