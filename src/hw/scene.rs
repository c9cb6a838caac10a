//! What there is to be seen in the plant at one servo period: the plant's side of the cameras.
//!
//! A plain snapshot, so that rendering can run beside the physics, on another thread or later.

use crate::cube::Axis;
use crate::spatial::Pose;

/// A snapshot of the visible world. All poses are true poses in the world frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scene {
    /// Servo period of the snapshot.
    pub period: u64,
    /// The cube's body.
    pub cube: SceneCube,
    /// Per effector: joint frames and gripper.
    pub arms: [SceneArm; 2],
    /// Number of effectors that are there.
    pub arm_count: usize,
    /// The operator's hand: origin where it touches the cube's far side, axes as the world's; `None` when it is
    /// out of the cell.
    pub hand: Option<Pose>,
}

/// The cube as seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneCube {
    /// `world_from_cube` of the middle layer.
    pub world_from_cube: Pose,
    /// Velocity of the centre (m/s) and of rotation (rad/s), in the world: motion blur.
    pub velocity: crate::spatial::Twist,
    /// Edge (m).
    pub edge: f64,
    /// Colours of the 54 stickers in the order URFDLB (0..=5 in the same order of colours).
    pub facelets: [u8; 54],
    /// Axis whose layers are turned, with the angles of its negative and positive outer layer against the
    /// middle layer (rad), right-handed about the axis.
    pub turned: (Axis, f64, f64),
}

/// An arm as seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneArm {
    /// Origins in the world of base (floor), shoulder, elbow, wrist pitch centre, flange.
    pub points: [nalgebra::Point3<f64>; 5],
    /// `world_from_tool`, true.
    pub world_from_tool: Pose,
    /// `world_from_flange`, true: cameras in hand hang on it.
    pub world_from_flange: Pose,
    /// Distance between the pads (m).
    pub opening: f64,
}
