//! The kernel of the stand-alone camera's VSP (virtual sensor process): it turns frames into the
//! cube's pose and speed.
//!
//! Once the cube was found, a track predicts its pose in the next frame. The kernel then measures
//! the edges of the tiles at their predicted places. If they do not confirm the prediction, it
//! searches in this order: with the paper's colour tables inside the predicted window, with the
//! chosen detector inside the window, with the chosen detector in the whole picture. The pose is
//! refined on the edges of all visible faces and filtered over time.
//!
//! With [`PoseBy::Corners`] the pose follows from the centroids of the four corner tiles of the
//! largest face alone, as in the paper, and no edges are measured.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | prediction is stale | `FRESH` | edges are found only near their true place |
//! | pose by edges alone | residual `FOLLOWED` | edges do not prove that there is a cube |
//! | pose by detection | residual `RESIDUAL` | tiles and lattice prove that there is one |
//! | face is too small | edge `LEAST_EDGE` | outside the workspace (the paper, p. 373) |
//! | least uncertainty | `FLOOR`, `FLOOR_ANGLE` | residuals do not show calibration and blur |
//! | the same by corners | `CORNERS`, `CORNERS_ANGLE` | eight numbers give six: too few residuals |
//!
//! - in: an image and its time; believed optics and place of the camera; the cube's edge (m)
//! - out: filtered `world_from_cube`, up to the 24 rotations of a cube, and speed, or a [`Refusal`]
//! - source: own work; the stages are those of Zieliński et al. (2007), p. 373

use super::detect::window_around;
use super::homography::GRID;
use super::pose::{CubeLocation, locate_cube};
use super::refine::{locate_in, refine_in};
use super::tracker::{Prediction, Tracker, TrackerSettings, Update};
use super::{DetectorSettings, FaceSighting, Method, Rect, Refusal, detect};
use crate::cell::Intrinsics;
use crate::spatial::Pose;
use image::RgbImage;
use nalgebra::{Matrix6, Point3, Vector3, Vector6};

/// Pose and speed of the cube.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Watched {
    /// Pose of the cube; its axes are along its edges, in any of the 24 ways.
    pub world_from_cube: Pose,
    /// Speed of the centre (m/s).
    pub speed: f64,
}

/// Measurements from which the pose of the cube follows, once its faces are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PoseBy {
    /// Edges of the tiles of all visible faces.
    #[default]
    Edges,
    /// Centroids of the four corner tiles of the largest face, as in the paper (p. 373).
    Corners,
}

/// The watcher of a cube: the kernel of the VSP with its track.
#[derive(Debug, Clone)]
pub struct CubeWatcher {
    pose_by: PoseBy,
    world_from_camera: Pose,
    intrinsics: Intrinsics,
    edge: f64,
    settings: DetectorSettings,
    tracker: Tracker,
}

/// Least standard deviation of a measured place along each axis (m). Errors of the calibration and
/// blur do not show in the residual.
const FLOOR: f64 = 0.0005;
/// Least standard deviation of a measured orientation about each axis (rad), for the same reason.
const FLOOR_ANGLE: f64 = 0.005;
/// Least standard deviation of a place by corner tiles (m): centroids are good to 0.2 px, which is
/// 1 mm of depth 0.34 m in front of a camera of 600 px.
const CORNERS: f64 = 0.0015;
/// Least standard deviation of an orientation by corner tiles (rad): 4 deg for a frontal face.
const CORNERS_ANGLE: f64 = 0.07;
/// Shortest edge of a face inside the workspace of the arms (px). Zieliński et al. (2007, p. 373)
/// give 100 px; a face seen at 45 deg has a mean edge of 85 % of its full one.
const LEAST_EDGE: f64 = 60.0;
/// Largest residual of a pose that is accepted (px).
const RESIDUAL: f64 = 2.0;
/// Largest residual of a pose that only edges confirm (px).
const FOLLOWED: f64 = 0.6;
/// Greatest age of a prediction at which edges are measured (s). If the prediction is older, the
/// kernel searches for faces.
const FRESH: f64 = 0.2;

impl CubeWatcher {
    /// Makes a watcher for a fixed camera. `world_from_camera` and `intrinsics` are those that the
    /// controller believes. `edge` is the edge of the cube (m).
    #[must_use]
    pub fn new(
        world_from_camera: Pose,
        intrinsics: Intrinsics,
        edge: f64,
        settings: DetectorSettings,
    ) -> Self {
        Self {
            pose_by: PoseBy::Edges,
            world_from_camera,
            intrinsics,
            edge,
            settings,
            tracker: Tracker::new(TrackerSettings::default()),
        }
    }

    /// Returns this watcher with another measurement of the pose.
    #[must_use]
    pub fn posing(self, pose_by: PoseBy) -> Self {
        Self { pose_by, ..self }
    }

    /// Updates the track with a frame that was exposed at `time` (s) and returns the filtered pose
    /// and speed of the cube. A frame that is not newer than the last one changes nothing.
    ///
    /// The search begins in the window that the track predicts. Without a track it begins around
    /// `near`: the believed centre of the cube in the world and the greatest error of this belief
    /// (m). If the cube is not there and `elsewhere` is true, the whole picture is searched.
    ///
    /// # Errors
    /// [`Refusal`] with the reason why no cube was found, or why the found cube is not accepted.
    pub fn observe(
        &mut self,
        image: &RgbImage,
        time: f64,
        near: Option<(Vector3<f64>, f64)>,
        elsewhere: bool,
    ) -> Result<Watched, Refusal> {
        let predicted = self.tracker.predict(time);
        let followed = predicted.as_ref().filter(|_| self.pose_by == PoseBy::Edges);
        let tracked = followed.and_then(|p| self.follow(image, p));
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
        // The covariance is in the axes of the camera, the track in those of the world. A change of
        // axes turns both the error of the centre and the rotation vector of the orientation.
        let rotation = self.world_from_camera.rotation.to_rotation_matrix();
        let mut turn = Matrix6::zeros();
        turn.fixed_view_mut::<3, 3>(0, 0).copy_from(rotation.matrix());
        turn.fixed_view_mut::<3, 3>(3, 3).copy_from(rotation.matrix());
        let (place, angle) = match self.pose_by {
            PoseBy::Edges => (FLOOR * FLOOR, FLOOR_ANGLE * FLOOR_ANGLE),
            PoseBy::Corners => (CORNERS * CORNERS, CORNERS_ANGLE * CORNERS_ANGLE),
        };
        let floor = Vector6::new(place, place, place, angle, angle, angle);
        let spread = turn * location.covariance * turn.transpose() + Matrix6::from_diagonal(&floor);
        let measured = self.world_from_camera * location.camera_from_cube;
        // A measurement that the tracker gates out is often the second pose that fits a single
        // face. It must not reach the arm.
        if let Update::Gated(_) = self.tracker.update(time, &measured, &spread) {
            return Err(Refusal::NotExpected { matched: 0 });
        }
        let now = self.tracker.predict(time).ok_or(Refusal::NotExpected { matched: 0 })?;
        Ok(Watched { world_from_cube: now.pose, speed: now.speed() })
    }

    /// Measures the pose of the cube at its predicted place by the edges of its tiles alone.
    /// Returns `None` if the prediction is too old, if the edges do not confirm it, or if the cube
    /// is too far away.
    fn follow(&self, image: &RgbImage, predicted: &Prediction) -> Option<CubeLocation> {
        if predicted.age > FRESH {
            return None;
        }
        let camera_from_cube = self.world_from_camera.inverse() * predicted.pose;
        let location = refine_in(image, &self.intrinsics, self.edge, &camera_from_cube)?;
        // No face is detected here, so its width is computed from the depth, as of a frontal face.
        let width = self.intrinsics.focal.0 * self.edge / location.camera_from_cube.translation.z;
        (location.residual_px < FOLLOWED && width >= LEAST_EDGE).then_some(location)
    }

    /// Finds the cube by detection of its faces. If the cube was `predicted`, the colour tables are
    /// tried first, inside the window. Then follows the chosen method inside the window and, if
    /// `elsewhere` is true, in the whole picture. Without a window the chosen method searches the
    /// whole picture at once.
    ///
    /// # Errors
    /// [`Refusal`] with the reason why no cube was found.
    fn search(
        &self,
        image: &RgbImage,
        window: Option<Rect>,
        elsewhere: bool,
        predicted: Option<&Prediction>,
    ) -> Result<CubeLocation, Refusal> {
        let by_colour = DetectorSettings { method: Method::Paper2007, ..self.settings };
        // The colour tables are quick, but they do not prove that there is a cube. They are used
        // only where a track says that there is one.
        let quick = window
            .filter(|_| predicted.is_some() && self.settings.method != Method::Square2007)
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
        // Two poses fit a single face, and the track decides between them.
        let hint = predicted.map(|p| self.world_from_camera.inverse() * p.pose);
        let location = match self.pose_by {
            PoseBy::Edges => locate_in(image, &faces, &self.intrinsics, self.edge, hint.as_ref()),
            PoseBy::Corners => {
                let face = largest(&faces).map(by_corners);
                locate_cube(face.as_slice(), &self.intrinsics, self.edge, hint.as_ref())
            }
        };
        location.filter(|l| l.residual_px < RESIDUAL).ok_or(Refusal::NotExpected { matched: 0 })
    }

    /// Returns the part of the picture in which a cube can be whose centre is within `reach` (m) of
    /// `centre` (m, in the world); `None` if that is outside the picture or too near the lens.
    fn around(&self, centre: &Vector3<f64>, reach: f64) -> Option<Rect> {
        let seen = self.world_from_camera.inverse() * Point3::from(*centre);
        // Behind the lens or less than 10 cm from it, the projection means nothing.
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

/// Returns the face with the longest side in the picture; `None` without a face.
fn largest(faces: &[FaceSighting]) -> Option<&FaceSighting> {
    faces.iter().max_by(|a, b| a.width_px().total_cmp(&b.width_px()))
}

/// Returns a face of which only the corner tiles count as seen.
fn by_corners(face: &FaceSighting) -> FaceSighting {
    FaceSighting { seen: GRID.map(|(x, y)| x * y != 0.0), ..face.clone() }
}
