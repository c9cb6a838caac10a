//! The visible state of the plant at one servo period, from which cameras render their frames.
//!
//! It is a plain snapshot, so that rendering can run on another thread than the physics, or later.

use crate::cell::PerArm;
use crate::cube::Axis;
use crate::spatial::Pose;

/// Greatest number of objects beside the cube.
pub const MOST_OBJECTS: usize = 8;

/// A snapshot of the visible world. All poses are true poses in the world frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scene {
    /// Servo period of the snapshot.
    pub period: u64,
    /// The cube's body.
    pub cube: SceneCube,
    /// Joint frames and gripper of each effector; only the first `arm_count` entries count.
    pub arms: PerArm<SceneArm>,
    /// Number of effectors that exist.
    pub arm_count: usize,
    /// The operator's hand, with its origin at the cube's far side, which it touches, and the axes
    /// of the world; `None` if it is out of the cell.
    pub hand: Option<Pose>,
    /// Rigid objects beside the cube.
    pub objects: [Option<SceneObject>; MOST_OBJECTS],
}

/// Number of heights that describe the contour of a surface.
pub const HEIGHTS: usize = 33;

/// Rigid object beside the cube.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneObject {
    /// Pose of the object in the world.
    pub world_from_object: Pose,
    /// Shape of the object.
    pub shape: SceneShape,
}

/// Shape of a rigid object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SceneShape {
    /// Box with half its sides (m), around its centre.
    Box([f64; 3]),
    /// Cylinder about z, around its centre.
    Cylinder {
        /// Radius (m).
        radius: f64,
        /// Half the length (m).
        half: f64,
    },
    /// Body on its base with a curved upper side.
    Surface {
        /// Half the length along x and half the width along y (m).
        half: [f64; 2],
        /// Heights of the contour above the base, at equal distances from one end to the other (m).
        heights: [f64; HEIGHTS],
    },
}

/// Place, motion and colours of the cube.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneCube {
    /// `world_from_cube` of the middle layer.
    pub world_from_cube: Pose,
    /// Velocity of the centre (m/s) and of rotation (rad/s) in the world frame, for motion blur.
    pub velocity: crate::spatial::Twist,
    /// Edge (m).
    pub edge: f64,
    /// Colours of the 54 stickers, nine of each face in the order URFDLB. A colour is the number
    /// (0..=5) in that order of the face to which it belongs on a solved cube.
    pub facelets: [u8; 54],
    /// Axis whose layers are turned, and the angles of its negative and positive outer layer
    /// against the middle layer (rad), right-handed about the axis.
    pub turned: (Axis, f64, f64),
}

/// Places of the parts of an arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneArm {
    /// Origins of base (on the floor), shoulder, elbow, wrist pitch centre and flange, in the world
    /// (m).
    pub points: [nalgebra::Point3<f64>; 5],
    /// `world_from_tool`, true.
    pub world_from_tool: Pose,
    /// `world_from_flange`, true. The hand cameras are fixed to it.
    pub world_from_flange: Pose,
    /// Distance between the pads (m).
    pub opening: f64,
}
