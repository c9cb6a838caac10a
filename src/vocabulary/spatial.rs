//! Poses, twists and wrenches of rigid bodies, in SI units.
//!
//! The name of a transform is `to_from`, so that equal names meet: `base_from_cube =
//! base_from_camera * camera_from_cube`. The name of a vector includes its frame if that is not the
//! vector's own frame.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Rigid transform `to_from`: it converts coordinates in `from` to coordinates in `to` (m).
pub type Pose = Isometry3<f64>;

/// Acceleration of free fall (m/s2).
pub const GRAVITY: f64 = 9.81;

/// Returns whether all numbers of a pose are finite and its rotation has unit length. The callers
/// are `debug_assert!`s where a pose enters another module.
#[must_use]
pub fn is_rigid(pose: &Pose) -> bool {
    pose.translation.vector.iter().all(|c| c.is_finite())
        && (pose.rotation.coords.norm() - 1.0).abs() < 1e-6
}

/// Velocity (m/s, rad/s) or small displacement (m, rad).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Twist {
    /// Linear part along the axes of the frame in which the twist is expressed.
    pub linear: Vector3<f64>,
    /// Angular part about those axes.
    pub angular: Vector3<f64>,
}

impl Twist {
    /// Makes a twist from `[x, y, z, rx, ry, rz]`.
    #[must_use]
    pub fn from_directions(d: [f64; 6]) -> Self {
        Self { linear: Vector3::new(d[0], d[1], d[2]), angular: Vector3::new(d[3], d[4], d[5]) }
    }

    /// Returns `[x, y, z, rx, ry, rz]`.
    #[must_use]
    pub fn directions(&self) -> [f64; 6] {
        let (l, a) = (self.linear, self.angular);
        [l.x, l.y, l.z, a.x, a.y, a.z]
    }

    /// Expresses the two free vectors in another orientation; the reference point does not change.
    #[must_use]
    pub fn rotated(&self, to_from: &UnitQuaternion<f64>) -> Self {
        Self { linear: to_from * self.linear, angular: to_from * self.angular }
    }

    /// Converts the displacement into a pose, with the translation and the rotation vector taken
    /// separately instead of by the screw exponential. The original controller integrates in this
    /// way, and for the increments of 2 ms the difference is of second order: at 1 m/s and 1 rad/s
    /// it is 2e-6 m.
    #[must_use]
    pub fn displacement(&self) -> Pose {
        Pose::from_parts(
            Translation3::from(self.linear),
            UnitQuaternion::from_scaled_axis(self.angular),
        )
    }
}

/// Force (N) and torque (Nm) about the origin of the frame in which they are expressed.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Wrench {
    /// Force along the axes (N).
    pub force: Vector3<f64>,
    /// Torque about the axes through the origin (Nm).
    pub torque: Vector3<f64>,
}

impl Wrench {
    /// Makes a wrench from `[fx, fy, fz, tx, ty, tz]`.
    #[must_use]
    pub fn from_directions(d: [f64; 6]) -> Self {
        Self { force: Vector3::new(d[0], d[1], d[2]), torque: Vector3::new(d[3], d[4], d[5]) }
    }

    /// Returns `[fx, fy, fz, tx, ty, tz]`.
    #[must_use]
    pub fn directions(&self) -> [f64; 6] {
        let (f, t) = (self.force, self.torque);
        [f.x, f.y, f.z, t.x, t.y, t.z]
    }

    /// Expresses the wrench about the origin and in the axes of the frame `to`. Its power with a
    /// twist that is converted likewise stays the same.
    #[must_use]
    pub fn moved(&self, to_from: &Pose) -> Self {
        let force = to_from.rotation * self.force;
        Self {
            force,
            // Force through the old origin: its moment about the new one is p x R f.
            torque: to_from.rotation * self.torque + to_from.translation.vector.cross(&force),
        }
    }

    /// Expresses the two free vectors in another orientation; the reference point does not change.
    #[must_use]
    pub fn rotated(&self, to_from: &UnitQuaternion<f64>) -> Self {
        Self { force: to_from * self.force, torque: to_from * self.torque }
    }

    /// Checks that every component is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.directions().iter().all(|c| c.is_finite())
    }
}

impl std::ops::Add for Wrench {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self { force: self.force + other.force, torque: self.torque + other.torque }
    }
}

impl std::ops::Sub for Wrench {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self { force: self.force - other.force, torque: self.torque - other.torque }
    }
}

impl std::ops::Neg for Wrench {
    type Output = Self;
    fn neg(self) -> Self {
        Self { force: -self.force, torque: -self.torque }
    }
}

/// Makes the pose whose rotation has the given columns and whose origin is `origin` (m). The
/// columns must be orthonormal and right-handed.
#[must_use]
pub fn pose_from_axes(
    x: Vector3<f64>,
    y: Vector3<f64>,
    z: Vector3<f64>,
    origin: Point3<f64>,
) -> Pose {
    let rotation =
        nalgebra::Rotation3::from_matrix_unchecked(nalgebra::Matrix3::from_columns(&[x, y, z]));
    Pose::from_parts(
        Translation3::from(origin.coords),
        UnitQuaternion::from_rotation_matrix(&rotation),
    )
}
