//! Truth of a cell, drawn around the controller's belief: the errors of a workshop's measurements.
//!
//! - in: the cell as believed, spreads, a seed
//! - out: the true cell
//! - each spread is a standard deviation per component; errors are clipped at three times it
//!
//! The second arm's base is displaced *about a pivot* in the common workspace. A workshop
//! calibrates two arms where their hands meet, so the error of orientation is a turn about that
//! place, and the error of position is the one that remains there. A rotation of 0.5 deg about the
//! base itself would be 15 mm at the hands, which a workshop would notice.

use crate::cell::{Cell, Mount};
use crate::spatial::Pose;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use std::f64::consts::TAU;

/// Standard deviations of the errors; SI.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ErrorSpreads {
    /// Place of the second arm's base relative to the first, each axis, at the pivot (m).
    pub base: f64,
    /// Orientation of the second arm's base relative to the first, each axis (rad).
    pub base_tilt: f64,
    /// Place in the world where the workshop brought the hands of both arms together (m).
    pub pivot: Point3<f64>,
    /// Focal lengths of a camera, as a share; both get the same error.
    pub focal: f64,
    /// Principal point, each axis (px).
    pub centre: f64,
    /// Cameras' places, each axis (m).
    pub camera: f64,
    /// Cameras' orientation, each axis (rad).
    pub camera_tilt: f64,
    /// Zero of the jaws (m).
    pub jaw: f64,
    /// Edge of the cube (m).
    pub cube: f64,
    /// Weight beyond the sensors (N).
    pub weight: f64,
    /// Centre of that weight, each axis (m).
    pub weight_centre: f64,
    /// Deliberate error of the second arm's grasp.
    pub grasp: GraspError,
}

impl Default for ErrorSpreads {
    fn default() -> Self {
        Self {
            base: 1e-3,
            base_tilt: 0.5_f64.to_radians(),
            pivot: Point3::new(0.05, 1.12, 1.36),
            focal: 0.003,
            centre: 1.0,
            camera: 1e-3,
            camera_tilt: 0.1_f64.to_radians(),
            jaw: 0.3e-3,
            cube: 0.2e-3,
            weight: 0.2,
            weight_centre: 2e-3,
            grasp: GraspError::default(),
        }
    }
}

impl ErrorSpreads {
    /// Returns spreads of 0, for a cell without errors.
    #[must_use]
    pub fn none() -> Self {
        Self {
            base: 0.0,
            base_tilt: 0.0,
            focal: 0.0,
            centre: 0.0,
            camera: 0.0,
            camera_tilt: 0.0,
            jaw: 0.0,
            cube: 0.0,
            weight: 0.0,
            weight_centre: 0.0,
            ..Self::default()
        }
    }
}

/// Exact error of the second arm's tool at a given meeting pose: sizes are exact, directions
/// seeded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GraspError {
    /// Sideways, in a seeded direction across the tool's z (m).
    pub lateral: f64,
    /// Along the tool's z (m): positive is deeper. A run that *starts* at the meeting should start
    /// short of it (negative): a hand that is too deep would begin with its palm's stops inside the
    /// cube, a load that no approach could have reached.
    pub axial: f64,
    /// Tilt about a seeded axis across the tool's z (rad).
    pub tilt: f64,
    /// Pose of the second arm's tool at the meeting, as believed.
    pub world_from_tool: Pose,
}

impl Default for GraspError {
    fn default() -> Self {
        Self { lateral: 0.0, axial: 0.0, tilt: 0.0, world_from_tool: Pose::identity() }
    }
}

/// Returns the true cell: `belief` with random errors of these spreads. The biases of the force
/// sensors are not part of a cell, see [`super::SensorNoise`].
#[must_use]
pub fn draw(belief: &Cell, errors: &ErrorSpreads, seed: u64) -> Cell {
    let mut truth = belief.clone();
    let mut chance = Chance(Pcg64::new(u128::from(seed), 0x0074_7275_7468));
    // The order of the draws is part of a seed's meaning: a new one belongs at the end.
    let (base, base_tilt) = (chance.vector(errors.base), chance.vector(errors.base_tilt));
    if let Some(arm) = truth.arms.get_mut(1) {
        // The error is applied in axes of the world at the pivot.
        let at = Pose::from_parts(errors.pivot.coords.into(), UnitQuaternion::identity());
        arm.world_from_base = at * small(base, base_tilt) * at.inverse() * arm.world_from_base;
    }
    // Both focal lengths share one error, that of the lens.
    for camera in &mut truth.cameras {
        let scale = 1.0 + chance.normal(errors.focal);
        let optics = &mut camera.intrinsics;
        optics.focal = (optics.focal.0 * scale, optics.focal.1 * scale);
        optics.centre.0 += chance.normal(errors.centre);
        optics.centre.1 += chance.normal(errors.centre);
        let moved = small(chance.vector(errors.camera), chance.vector(errors.camera_tilt));
        match &mut camera.mount {
            Mount::World { world_from_camera } => *world_from_camera *= moved,
            Mount::Flange { flange_from_camera, .. } => *flange_from_camera *= moved,
        }
    }
    for arm in &mut truth.arms {
        arm.gripper.opening_offset += chance.normal(errors.jaw);
        arm.sensor.weight += chance.normal(errors.weight);
        arm.sensor.centre_in_flange += chance.vector(errors.weight_centre);
    }
    truth.cube.edge += chance.normal(errors.cube);
    let grasp = &errors.grasp;
    // Drawn last and in any case, so that a deliberate error changes no other one.
    let (sideways, tilted) = (chance.across(), chance.across());
    if let Some(arm) = truth.arms.get_mut(1) {
        let linear = sideways * grasp.lateral + Vector3::z() * grasp.axial;
        let off = small(linear, tilted * grasp.tilt);
        // The error is applied in axes of the tool at the meeting: its size is exact there.
        let tool = grasp.world_from_tool;
        arm.world_from_base = tool * off * tool.inverse() * arm.world_from_base;
    }
    for arm in truth.arms.iter_mut().skip(2) {
        let moved = small(chance.vector(errors.base), chance.vector(errors.base_tilt));
        let at = Pose::from_parts(errors.pivot.coords.into(), UnitQuaternion::identity());
        arm.world_from_base = at * moved * at.inverse() * arm.world_from_base;
    }
    truth
}

/// Returns the pose of a small displacement: `linear` (m), and the rotation vector `angular` (rad).
fn small(linear: Vector3<f64>, angular: Vector3<f64>) -> Pose {
    Pose::from_parts(Translation3::from(linear), UnitQuaternion::from_scaled_axis(angular))
}

/// Random generator of the errors.
struct Chance(Pcg64);

impl Chance {
    /// Returns a random number of this standard deviation, clipped at three times it.
    fn normal(&mut self, spread: f64) -> f64 {
        let x: f64 = StandardNormal.sample(&mut self.0);
        x.clamp(-3.0, 3.0) * spread
    }

    /// Returns a random vector, each component as [`Chance::normal`].
    fn vector(&mut self, spread: f64) -> Vector3<f64> {
        Vector3::new(self.normal(spread), self.normal(spread), self.normal(spread))
    }

    /// Returns a random unit vector at right angles to z.
    fn across(&mut self) -> Vector3<f64> {
        let (s, c) = libm::sincos(self.0.random_range(0.0..TAU));
        Vector3::new(c, s, 0.0)
    }
}
