//! Poses, twists and wrenches: the vocabulary of rigid motion.
//!
//! A transform is named `to_from`, so that equal names meet: `base_from_cube = base_from_camera *
//! camera_from_cube`. A vector says where it is expressed when that is not its own frame. SI units.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// A rigid transform `to_from`: it takes coordinates in `from` to coordinates in `to` (m).
pub type Pose = Isometry3<f64>;

/// Acceleration of free fall (m/s2).
pub const GRAVITY: f64 = 9.81;

/// Returns whether a pose is made of numbers, with a rotation of unit length: for `debug_assert!`
/// where poses cross from one part to another.
#[must_use]
pub fn is_rigid(pose: &Pose) -> bool {
    pose.translation.vector.iter().all(|c| c.is_finite())
        && (pose.rotation.coords.norm() - 1.0).abs() < 1e-6
}

/// A velocity, or a small displacement: linear (m/s or m), angular (rad/s or rad).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Twist {
    /// Along the axes of the frame that the twist is expressed in.
    pub linear: Vector3<f64>,
    /// About the same axes.
    pub angular: Vector3<f64>,
}

impl Twist {
    /// From `[x, y, z, rx, ry, rz]`.
    #[must_use]
    pub fn from_directions(d: [f64; 6]) -> Self {
        Self { linear: Vector3::new(d[0], d[1], d[2]), angular: Vector3::new(d[3], d[4], d[5]) }
    }

    /// As `[x, y, z, rx, ry, rz]`.
    #[must_use]
    pub fn directions(&self) -> [f64; 6] {
        let (l, a) = (self.linear, self.angular);
        [l.x, l.y, l.z, a.x, a.y, a.z]
    }

    /// The same free vectors expressed in another orientation (no change of reference point).
    #[must_use]
    pub fn rotated(&self, to_from: &UnitQuaternion<f64>) -> Self {
        Self { linear: to_from * self.linear, angular: to_from * self.angular }
    }

    /// The displacement as a pose: translation and rotation vector taken apart, not the screw
    /// exponential; at 2 ms increments the difference is of second order (< 1e-9 m at 1 m/s, 1 rad/s
    /// is 2e-6 m) and the original integrates in the same way.
    #[must_use]
    pub fn displacement(&self) -> Pose {
        Pose::from_parts(
            Translation3::from(self.linear),
            UnitQuaternion::from_scaled_axis(self.angular),
        )
    }
}

/// A force (N) and a torque (Nm) about the origin of the frame that they are expressed in.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Wrench {
    /// Force along the axes (N).
    pub force: Vector3<f64>,
    /// Torque about the axes through the origin (Nm).
    pub torque: Vector3<f64>,
}

impl Wrench {
    /// From `[fx, fy, fz, tx, ty, tz]`.
    #[must_use]
    pub fn from_directions(d: [f64; 6]) -> Self {
        Self { force: Vector3::new(d[0], d[1], d[2]), torque: Vector3::new(d[3], d[4], d[5]) }
    }

    /// As `[fx, fy, fz, tx, ty, tz]`.
    #[must_use]
    pub fn directions(&self) -> [f64; 6] {
        let (f, t) = (self.force, self.torque);
        [f.x, f.y, f.z, t.x, t.y, t.z]
    }

    /// The same wrench about another origin and in other axes; keeps power with twists moved likewise.
    #[must_use]
    pub fn moved(&self, to_from: &Pose) -> Self {
        let force = to_from.rotation * self.force;
        Self {
            force,
            torque: to_from.rotation * self.torque + to_from.translation.vector.cross(&force),
        }
    }

    /// The same free vectors in another orientation (no change of reference point).
    #[must_use]
    pub fn rotated(&self, to_from: &UnitQuaternion<f64>) -> Self {
        Self { force: to_from * self.force, torque: to_from * self.torque }
    }

    /// Whether every component is a finite number.
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

/// The pose whose rotation has the given columns (right-handed, orthonormal) and whose origin is `origin`.
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
