//! What does not change in a run: sent to a UI once.

use super::Solid;
use crate::motion::AXES;
use crate::spatial::Pose;
use serde::{Deserialize, Serialize};

/// The scene and its names.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Stage {
    /// What is shown: the scenario's path, or the recording's.
    pub title: String,
    /// Version of the program.
    pub version: String,
    /// The task: "solve", "acquire", "face\_turn", "idle".
    pub task: String,
    /// Seed of everything random in the plant.
    pub seed: u64,
    /// "virtual", "real-time", "replay".
    pub pace: String,
    /// "continuous" or "sporadic".
    pub coordination: String,
    /// What is controlled: "the simulated plant", or the bridge.
    pub plant: String,
    /// Effectors in the scenario's order.
    pub arms: Vec<ArmStage>,
    /// Cameras in the scenario's order.
    pub cameras: Vec<CameraStage>,
    /// What the arms are drawn with.
    pub solids: Vec<Solid>,
    /// Edge of the cube (m).
    pub edge: f64,
    /// Where the hand is expected.
    pub hand_zone: Option<Pose>,
    /// Limits that curves are drawn against.
    pub limits: Limits,
}

/// An effector.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ArmStage {
    /// Name in the scenario.
    pub name: String,
    /// Whether it has an axis 0.
    pub has_track: bool,
    /// Joint limits, low and high (m or rad).
    pub joint_limits: [(f64, f64); AXES],
    /// Motor limits (rad).
    pub motor_limits: [(f64, f64); AXES],
    /// Smallest and largest distance between the pads (m).
    pub opening: (f64, f64),
    /// Names of poses that it can be sent to by hand.
    pub poses: Vec<String>,
}

/// A camera.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct CameraStage {
    /// Name in the scenario.
    pub name: String,
    /// Effector that carries it.
    pub arm: Option<usize>,
    /// Where it stands, or where it sits in the effector's flange.
    pub pose: Pose,
    /// Columns and rows.
    pub size: (u32, u32),
}

/// Limits of the behaviours.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Limits {
    /// Force at which a behaviour gives up (N).
    pub force: f64,
    /// Torque at which a behaviour gives up (Nm).
    pub torque: f64,
    /// Length of a servo period (s).
    pub period: f64,
}
