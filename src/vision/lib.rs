//! Vision: from an image to the faces of a cube, its pose and its colours.
//!
//! The crate is pure: time, randomness and calibration are arguments. It calls one coloured square
//! of a face a tile, and the outcome of finding a face or a cube in an image a sighting.
//!
//! | step | module | in -> out |
//! |---|---|---|
//! | segmentation | `segment` (edges), [`paper`] (colour tables) | image -> tile candidates |
//! | lattice | `lattice` | candidates -> 3x3 lattices |
//! | detection | [`mod@detect`] | image -> [`FaceSighting`]s, or a [`Refusal`] with the reason |
//! | lens | `undistort` | lens with five coefficients: point -> pixel, pixel -> direction |
//! | pose | [`pose`] | sighting, lens -> [`CubeSighting`], [`pose::CubeLocation`] |
//! | refinement | `refine` | image, first pose -> pose on sub-pixel edges, covariance |
//! | calibration | [`calibration`] | views at known arm poses -> optics, place of the camera |
//! | tracking | `tracker` | poses over time -> position, velocity, window, age |
//! | colours | [`colours`] | nine mean colours -> names, with a confidence each |
//! | whole cubes | `whole`, `likeliest`, [`table`] | 54 mean colours -> a legal cube, or why not |
//! | guided reading | [`sensor`] | image, predicted pose -> nine colours, measured pose |
//! | stand-alone camera | [`watcher`] | one image after another -> filtered pose, speed |
//!
//! Pixels: the centre of the first pixel is (0, 0), x to the right, y down.
//!
//! ```
//! use image::{Rgb, RgbImage};
//! use rubik_robot_vision::colours::LETTERS;
//! use rubik_robot_vision::{DetectorSettings, Lens, detect, locate};
//!
//! // Draws a face on a grey wall: nine tiles of 28 px on black, with the noise of a camera.
//! let paints = [[225, 225, 225], [180, 22, 40], [10, 150, 70], [230, 200, 20], [240, 100, 20]];
//! let tiles = [0, 1, 2, 3, 4, 0, 1, 2, 3];
//! let mut noise = 1_u32;
//! let picture = RgbImage::from_fn(320, 240, |x, y| {
//!     let (x, y) = (x.wrapping_sub(111), y.wrapping_sub(71));
//!     let inside = x % 33 > 2 && x % 33 < 31 && y % 33 > 2 && y % 33 < 31;
//!     let colour = match (x < 99 && y < 99, inside) {
//!         (true, true) => paints[tiles[(y / 33 * 3 + x / 33) as usize]],
//!         (true, false) => [18; 3],
//!         (false, _) => [96; 3],
//!     };
//!     Rgb(colour.map(|level: u8| {
//!         noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
//!         level + (noise >> 29) as u8
//!     }))
//! });
//!
//! let faces = detect(&picture, None, &DetectorSettings::default())?;
//! let colours = faces[0].colours.map(|colour| LETTERS[usize::from(colour)]);
//! assert_eq!(colours.iter().collect::<String>(), "WRGYOWRGY");
//!
//! // A cube of 57 mm that is 99 px wide, at a focal length of 600 px, is 345 mm away.
//! let camera = Lens::pinhole((600.0, 600.0), (159.5, 119.5));
//! let face = locate(&faces[0], camera, 0.057).camera_from_face;
//! assert!((face.translation.z - 0.345).abs() < 0.005);
//! # Ok::<(), rubik_robot_vision::Refusal>(())
//! ```

pub use rubik_robot_vocabulary::{cell, cube, spatial};

mod assignment;
pub mod calibration;
mod classes;
pub mod colours;
pub mod detect;
mod doubts;
mod edges;
mod fit;
pub mod homography;
mod lattice;
mod likeliest;
mod names;
pub mod paper;
mod patch;
mod placement;
pub mod pose;
mod refine;
mod segment;
pub mod sensor;
mod sides;
pub mod table;
#[cfg(test)]
pub(crate) mod testing;
mod tracker;
mod undistort;
pub mod watcher;
mod whole;

use crate::spatial::Pose;

pub use detect::{DetectorSettings, Method, detect};
pub use pose::{CubeLocation, locate, locate_cube};
pub use refine::{locate_in, refine_in};
pub use sensor::{FaceReading, read_face};
pub use tracker::{Prediction, Tracker, TrackerSettings, Update};
pub use undistort::Lens;

/// A rectangle of pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rect {
    /// First column.
    pub x: u32,
    /// First row.
    pub y: u32,
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
}

impl Rect {
    /// Returns the part of the rectangle that lies inside an image of `width` x `height` pixels, or
    /// `None` if the rectangle is wholly outside.
    ///
    /// ```
    /// use rubik_robot_vision::Rect;
    ///
    /// // A window that reaches beyond the left part of a picture of 640 x 480 px.
    /// let window = Rect { x: 600, y: 100, width: 80, height: 60 };
    /// assert_eq!(window.inside(640, 480), Some(Rect { width: 40, ..window }));
    /// assert_eq!(Rect { x: 700, ..window }.inside(640, 480), None);
    /// ```
    #[must_use]
    pub fn inside(self, width: u32, height: u32) -> Option<Self> {
        // A predicted window may reach beyond the image, and its end beyond the largest u32.
        let (x, y) = (self.x.min(width), self.y.min(height));
        let (right, bottom) = (
            self.x.saturating_add(self.width).min(width),
            self.y.saturating_add(self.height).min(height),
        );
        (right > x && bottom > y).then(|| Self { x, y, width: right - x, height: bottom - y })
    }
}

/// Reason why no face is reported.
///
/// ```
/// use image::RgbImage;
/// use rubik_robot_vision::{DetectorSettings, Refusal, detect};
///
/// let search = |picture| detect(&picture, None, &DetectorSettings::default()).unwrap_err();
/// assert_eq!(search(RgbImage::new(8, 8)), Refusal::TooFewPixels { width: 8, height: 8 });
/// // A black picture: the cap is on the lens.
/// assert_eq!(search(RgbImage::new(64, 64)), Refusal::TooDark { brightest: 0 });
/// ```
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// The picture has too few pixels for nine tiles.
    #[error("the picture has only {width}x{height} px: too few for nine tiles")]
    TooFewPixels {
        /// Number of columns that were searched.
        width: u32,
        /// Number of rows that were searched.
        height: u32,
    },
    /// Even the brightest candidates for tiles are dark.
    #[error("too dark: the brightest candidate for a tile has level {brightest} of 255")]
    TooDark {
        /// Level of the brightest tenth of the candidates, 0..=255. With fewer than nine candidates
        /// it is the level of the brightest hundredth of the pixels.
        brightest: u8,
    },
    /// Many of the candidates for tiles are clipped.
    #[error("overexposed: {:.0} % of the candidates for tiles are clipped", share * 100.0)]
    Overexposed {
        /// Share of the candidates that clip, 0..=1. With fewer than nine candidates it is the
        /// share of the pixels.
        share: f64,
    },
    /// The tiles were painted by a program, without the noise of a camera.
    #[error("not a photograph: the squares were painted by a program, without a camera's noise")]
    Painted,
    /// No region looks like a tile.
    #[error("no region looks like a tile")]
    NoTiles,
    /// There are candidates for tiles, but no nine of them form a lattice of 3x3.
    #[error("{tiles} regions look like tiles, but no nine of them form a lattice of 3x3")]
    NoLattice {
        /// Number of candidates.
        tiles: usize,
    },
    /// The tiles form a lattice of more than 3x3.
    #[error("not a face of a cube: the lattice has {beyond} more tiles around 3x3")]
    LargerLattice {
        /// Number of the 16 places around the nine that have a tile of the same size and pitch.
        beyond: usize,
    },
    /// The confidence of the best lattice is too low to report it as a face.
    #[error("a 3x3 lattice was found, but it may be no face: confidence {confidence:.2}")]
    Doubtful {
        /// Confidence of the best lattice, 0..=1.
        confidence: f64,
    },
    /// The face is so small that the cube may be outside the workspace of the arms.
    #[error("the face is only {width_px:.0} px wide, too small: it may be outside the workspace")]
    TooSmall {
        /// Length of the face's longest side (px).
        width_px: f64,
    },
    /// The face is not where a prediction expected it.
    #[error("the face is not where it was expected: {matched} of 9 tiles fit the prediction")]
    NotExpected {
        /// Number of tiles that fit the prediction, 0..=9.
        matched: usize,
    },
}

/// A face of a cube found in an image.
#[derive(Debug, Clone, PartialEq)]
pub struct FaceSighting {
    /// Corners of the face's outline in the image (px): top left, top right, bottom right and
    /// bottom left, as in the reading order of the tiles (row by row).
    pub corners: [(f64, f64); 4],
    /// Centres of the nine tiles in reading order (px): measured centroids where `seen` is true,
    /// else the places in the fitted lattice.
    pub centres: [(f64, f64); 9],
    /// Whether each tile was found as a region of its own. The others follow from the lattice.
    pub seen: [bool; 9],
    /// Side of a tile's coloured part as a share of the pitch, 0..=1, estimated from the regions.
    pub sticker: f64,
    /// Mean colour of each tile as in the image, 0..=255: the trimmed mean of samples of its
    /// interior.
    pub rgb: [[f64; 3]; 9],
    /// Colour of each tile, decided from this face alone: 0..=5 = white, red, green, yellow,
    /// orange, blue (URFDLB).
    pub colours: [u8; 9],
    /// Confidence of each tile's colour, 0..=1.
    pub confidences: [f64; 9],
    /// Confidence that this is a face of a cube, 0..=1.
    pub confidence: f64,
}

impl FaceSighting {
    /// Returns the length of the longest side of the outline (px).
    #[must_use]
    pub fn width_px(&self) -> f64 {
        (0..4)
            .map(|i| {
                let (a, b) = (self.corners[i], self.corners[(i + 1) % 4]);
                (a.0 - b.0).hypot(a.1 - b.1)
            })
            .fold(0.0, f64::max)
    }

    /// Returns the same face in the reading order that follows after `quarters` clockwise quarter
    /// turns of the picture. A quarter turn brings the tile at the bottom left to the top left.
    #[must_use]
    pub fn turned(&self, quarters: usize) -> Self {
        let mut face = self.clone();
        for _ in 0..quarters % 4 {
            let old = face.clone();
            for row in 0..3 {
                for column in 0..3 {
                    let (to, from) = (3 * row + column, 3 * (2 - column) + row);
                    face.centres[to] = old.centres[from];
                    face.seen[to] = old.seen[from];
                    face.rgb[to] = old.rgb[from];
                    face.colours[to] = old.colours[from];
                    face.confidences[to] = old.confidences[from];
                }
            }
            // The corners are listed around the outline, so a quarter turn shifts them by one.
            for i in 0..4 {
                face.corners[i] = old.corners[(i + 3) % 4];
            }
        }
        face
    }
}

/// A face of a cube located in space.
#[derive(Debug, Clone, PartialEq)]
pub struct CubeSighting {
    /// Pose of the face: origin in its centre, x towards the next column and y towards the next row
    /// in reading order, z into the cube (away from the camera if the face is frontal).
    pub camera_from_face: Pose,
    /// Other pose at which a plane looks almost the same, and its root mean square error (px).
    pub other: (Pose, f64),
    /// Length of the face's longest side in the image (px).
    pub width_px: f64,
    /// Root mean square of the reprojection error of `camera_from_face` (px).
    pub residual_px: f64,
    /// The face itself.
    pub face: FaceSighting,
}
