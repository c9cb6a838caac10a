//! The kernel of the stand-alone camera's VSP: one frame after another in, the cube's pose and speed out.
//!
//! - in: an image and its time; believed optics and place of the camera; the cube's edge
//! - out: `world_from_cube`, up to the cube's own symmetry, filtered; its speed; or why there is none
//! - method: with a track, the edges of the tiles where it predicts them; when these do not bear it out, the paper's
//!   colour stage inside the predicted window, then the chosen detector there, then in the whole picture; pose on the
//!   edges of all visible faces; constant-velocity Kalman filter with gating

use super::detect::window_around;
use super::pose::CubeLocation;
use super::refine::{locate_in, refine_in};
use super::tracker::{Prediction, Tracker, TrackerSettings, Update};
use super::{DetectorSettings, FaceSighting, Method, Rect, Refusal, detect};
use crate::cell::Intrinsics;
use crate::spatial::Pose;
use image::RgbImage;
use nalgebra::{Matrix6, Point3, Vector3, Vector6};

/// Where the cube is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Watched {
    /// `world_from_cube`; axes along the edges.
    pub world_from_cube: Pose,
    /// Speed of the centre (m/s).
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

/// Least standard deviation of a measured place along each axis (m): what the residual does not know of
/// (calibration, blur).
const FLOOR: f64 = 0.0005;
/// The same of the orientation about each axis (rad).
const FLOOR_ANGLE: f64 = 0.005;
/// A face whose edge is shorter than this is outside the work-space (Zieliński et al. 2007, p. 373) (px). The
/// paper's figure is 100 px; a face seen at 45 deg has a mean edge of 85 % of its full one.
const LEAST_EDGE: f64 = 60.0;
/// Largest residual of a pose that is believed (px).
const RESIDUAL: f64 = 2.0;
/// The same of a pose that only edges bear out.
const FOLLOWED: f64 = 0.6;
/// A prediction older than this is searched for, not followed (s).
const FRESH: f64 = 0.2;

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

    /// Takes a frame exposed at `time` (s); one that is not newer than the last changes nothing. Searched first is the window that the track predicts, or else the
    /// surroundings of `near` (centre in the world and reach (m)); `elsewhere` says whether the whole picture is
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
        let predicted = self.tracker.predict(time);
        let tracked = predicted.as_ref().and_then(|p| self.follow(image, p));
        let location = if let Some(location) = tracked {
            location
        } else {
            let camera_from_world = self.world_from_camera.inverse();
            let window = self
                .tracker
                .window(time, &camera_from_world, &self.intrinsics, self.edge)
                .or_else(|| near.and_then(|(centre, reach)| self.around(&centre, reach)));
            self.search(image, window, elsewhere, predicted.as_ref())?
        };
        let rotation = self.world_from_camera.rotation.to_rotation_matrix();
        let mut turn = Matrix6::zeros();
        turn.fixed_view_mut::<3, 3>(0, 0).copy_from(rotation.matrix());
        turn.fixed_view_mut::<3, 3>(3, 3).copy_from(rotation.matrix());
        let (place, angle) = (FLOOR * FLOOR, FLOOR_ANGLE * FLOOR_ANGLE);
        let floor = Vector6::new(place, place, place, angle, angle, angle);
        let spread = turn * location.covariance * turn.transpose() + Matrix6::from_diagonal(&floor);
        let measured = self.world_from_camera * location.camera_from_cube;
        if let Update::Gated(_) = self.tracker.update(time, &measured, &spread) {
            return Err(Refusal::NotExpected { matched: 0 });
        }
        let now = self.tracker.predict(time).ok_or(Refusal::NotExpected { matched: 0 })?;
        Ok(Watched { world_from_cube: now.pose, speed: now.speed() })
    }

    /// The cube at its predicted place, by the edges of its tiles alone.
    fn follow(&self, image: &RgbImage, predicted: &Prediction) -> Option<CubeLocation> {
        if predicted.age > FRESH {
            return None;
        }
        let camera_from_cube = self.world_from_camera.inverse() * predicted.pose;
        let location = refine_in(image, &self.intrinsics, self.edge, &camera_from_cube)?;
        let width = self.intrinsics.focal.0 * self.edge / location.camera_from_cube.translation.z;
        (location.residual_px < FOLLOWED && width >= LEAST_EDGE).then_some(location)
    }

    /// The cube by detection: in a window by its colours, or else as the settings say; then everywhere, if wanted.
    fn search(
        &self,
        image: &RgbImage,
        window: Option<Rect>,
        elsewhere: bool,
        predicted: Option<&Prediction>,
    ) -> Result<CubeLocation, Refusal> {
        let by_colour = DetectorSettings { method: Method::Paper2007, ..self.settings };
        // Colours are quick where a track says that there is a cube; they are no judge of whether there is one.
        let quick = window
            .filter(|_| predicted.is_some())
            .and_then(|window| detect(image, Some(window), &by_colour).ok());
        let faces = match quick {
            Some(faces) => faces,
            None => match (detect(image, window, &self.settings), window) {
                (Err(_), Some(_)) if elsewhere => detect(image, None, &self.settings)?,
                (found, _) => found?,
            },
        };
        let widest = faces.iter().map(FaceSighting::width_px).fold(0.0, f64::max);
        if widest < LEAST_EDGE {
            return Err(Refusal::TooSmall { width_px: widest });
        }
        let hint = predicted.map(|p| self.world_from_camera.inverse() * p.pose);
        locate_in(image, &faces, &self.intrinsics, self.edge, hint.as_ref())
            .filter(|l| l.residual_px < RESIDUAL)
            .ok_or(Refusal::NotExpected { matched: 0 })
    }

    /// The part of the picture that shows a cube whose centre is within `reach` of a place (m).
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
