//! The kernel of the stand-alone camera's VSP: one frame after another in, the cube's pose and speed out.
//!
//! - in: an image and its time; believed optics and place of the camera; the cube's edge
//! - out: `world_from_cube`, up to the cube's own symmetry, filtered; its speed; or why there is none
//! - method: the face detector, inside the window that the track predicts when there is one; pose from all visible
//!   faces; constant-velocity Kalman filter with gating

use super::detect::window_around;
use super::pose::locate_cube;
use super::tracker::{Tracker, TrackerSettings, Update};
use super::{DetectorSettings, Rect, Refusal, detect};
use crate::cell::Intrinsics;
use crate::spatial::Pose;
use image::RgbImage;
use nalgebra::{Matrix3, Point3, Vector3};

/// Where the cube is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Watched {
    /// `world_from_cube`; axes along the edges.
    pub world_from_cube: Pose,
    /// Speed of the centre [m/s].
    pub speed: f64,
}

/// The kernel with its memory.
#[derive(Debug, Clone)]
pub struct CubeWatcher {
    world_from_camera: Pose,
    intrinsics: Intrinsics,
    edge: f64,
    settings: DetectorSettings,
    tracker: Tracker,
}

/// Least standard deviation of a measured place along each axis [m]: what the residual does not know of
/// (calibration, blur).
const FLOOR: f64 = 0.0005;
/// A face whose edge is shorter than this is outside the work-space (Zieliński et al. 2007, p. 373) [px]. The
/// paper's figure is 100 px; a face seen at 45 deg has a mean edge of 85 % of its full one.
const LEAST_EDGE: f64 = 60.0;
/// Largest residual of a pose that is believed [px].
const RESIDUAL: f64 = 2.0;

impl CubeWatcher {
    /// A camera at a believed place.
    #[must_use]
    pub fn new(
        world_from_camera: Pose,
        intrinsics: Intrinsics,
        edge: f64,
        settings: DetectorSettings,
    ) -> Self {
        Self {
            world_from_camera,
            intrinsics,
            edge,
            settings,
            tracker: Tracker::new(TrackerSettings::default()),
        }
    }

    /// Takes a frame exposed at `time` [s]. Searched first is the window that the track predicts, or else the
    /// surroundings of `near` (centre in the world and reach [m]); `elsewhere` says whether the whole picture is
    /// searched when nothing is there.
    ///
    /// # Errors
    /// Why no cube was found, or why what was found is not believed.
    pub fn observe(
        &mut self,
        image: &RgbImage,
        time: f64,
        near: Option<(Vector3<f64>, f64)>,
        elsewhere: bool,
    ) -> Result<Watched, Refusal> {
        let camera_from_world = self.world_from_camera.inverse();
        let window = self
            .tracker
            .window(time, &camera_from_world, &self.intrinsics, self.edge)
            .or_else(|| near.and_then(|(centre, reach)| self.around(&centre, reach)));
        let found = detect(image, window, &self.settings);
        let faces = match (found, window) {
            (Err(_), Some(_)) if elsewhere => detect(image, None, &self.settings)?,
            (found, _) => found?,
        };
        let hint = self.tracker.predict(time).map(|p| camera_from_world * p.pose);
        let widest = faces.iter().map(super::FaceSighting::width_px).fold(0.0, f64::max);
        if widest < LEAST_EDGE {
            return Err(Refusal::TooSmall { width_px: widest });
        }
        let location = locate_cube(&faces, &self.intrinsics, self.edge, hint.as_ref())
            .filter(|l| l.residual_px < RESIDUAL)
            .ok_or(Refusal::NotExpected { matched: 0 })?;
        let rotation = self.world_from_camera.rotation.to_rotation_matrix();
        let spread: Matrix3<f64> = location.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let spread = rotation * spread * rotation.inverse() + Matrix3::identity() * FLOOR * FLOOR;
        let measured = self.world_from_camera * location.camera_from_cube;
        if let Update::Gated(_) = self.tracker.update(time, &measured, &spread) {
            return Err(Refusal::NotExpected { matched: 0 });
        }
        let now = self.tracker.predict(time).ok_or(Refusal::NotExpected { matched: 0 })?;
        Ok(Watched { world_from_cube: now.pose, speed: now.speed() })
    }

    /// The part of the picture that shows a cube whose centre is within `reach` of a place [m].
    fn around(&self, centre: &Vector3<f64>, reach: f64) -> Option<Rect> {
        let seen = self.world_from_camera.inverse() * Point3::from(*centre);
        if seen.z < 0.1 {
            return None;
        }
        let half_diagonal = 0.5 * 3.0_f64.sqrt() * self.edge;
        let radius =
            (half_diagonal + reach) * self.intrinsics.focal.0.max(self.intrinsics.focal.1) / seen.z;
        let (x, y) = self.intrinsics.project(&seen);
        let corners = [(x - radius, y - radius), (x + radius, y + radius)];
        window_around(&corners, 0.0)?.inside(self.intrinsics.width, self.intrinsics.height)
    }
}
