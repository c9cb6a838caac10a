//! Poses, twists and wrenches of rigid bodies, in SI units.
//!
//! The name of a transform is `to_from`, so that equal names meet: `base_from_cube =
//! base_from_camera * camera_from_cube`. The name of a vector includes its frame if that is not the
//! vector's own frame.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Rigid transform `to_from`: it converts coordinates in `from` to coordinates in `to` (m).
///
/// ```
/// use nalgebra::Point3;
/// use rubik_robot_vocabulary::spatial::Pose;
///
/// // The camera is 0.5 m above the table and looks down: its z points downwards.
/// let table_from_camera = Pose::translation(0.0, 0.0, 0.5)
///     * nalgebra::UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0);
/// let in_camera = Point3::new(0.1, 0.0, 0.4);
/// let on_table = table_from_camera * in_camera;
/// assert!((on_table - Point3::new(0.1, 0.0, 0.1)).norm() < 1e-12);
/// ```
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
///
/// ```
/// use rubik_robot_vocabulary::spatial::Twist;
///
/// // The displacement of a tool in 2 ms at 0.1 m/s along x and 1 rad/s about z.
/// let moved = Twist::from_directions([0.0002, 0.0, 0.0, 0.0, 0.0, 0.002]).displacement();
/// assert_eq!(moved.translation.x, 0.0002);
/// assert!((moved.rotation.angle() - 0.002).abs() < 1e-12);
/// ```
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
///
/// ```
/// use rubik_robot_vocabulary::spatial::{Pose, Wrench};
///
/// // 10 N along x at a tool point that is 0.25 m in front of the sensor: a torque of 2.5 Nm.
/// let at_tool = Wrench::from_directions([10.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
/// let sensor_from_tool = Pose::translation(0.0, 0.0, 0.25);
/// let at_sensor = at_tool.moved(&sensor_from_tool);
/// assert_eq!(at_sensor.directions(), [10.0, 0.0, 0.0, 0.0, 2.5, 0.0]);
/// ```
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
///
/// ```
/// use nalgebra::{Point3, Vector3};
/// use rubik_robot_vocabulary::spatial::{is_rigid, pose_from_axes};
///
/// // A camera that looks along +x of the world: its x is to the right, its y downwards.
/// let (x, y, z) = (-Vector3::y(), -Vector3::z(), Vector3::x());
/// let world_from_camera = pose_from_axes(x, y, z, Point3::new(0.0, 0.0, 1.2));
/// assert!(is_rigid(&world_from_camera));
/// let ahead = world_from_camera * Point3::new(0.0, 0.0, 2.0);
/// assert!((ahead - Point3::new(2.0, 0.0, 1.2)).norm() < 1e-12);
/// ```
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
