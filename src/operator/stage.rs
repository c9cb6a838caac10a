//! The data of a run that do not change; each user interface receives them once.

use super::parameter::Bounds;
use super::{Parameter, Solid};
use crate::motion::AXES;
use crate::spatial::Pose;
use serde::{Deserialize, Serialize};

/// The data of a run that do not change: its origin, arms, cameras, solids and limits.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Stage {
    /// Path of the scenario or of the recording that is shown.
    pub title: String,
    /// Version of the program.
    pub version: String,
    /// Name of the task: "solve", "acquire", "face\_turn", "idle".
    pub task: String,
    /// Seed of the plant's random numbers.
    pub seed: u64,
    /// Source of time: "virtual", "real-time", "replay".
    pub pace: String,
    /// Coordination of the arms: "continuous" or "sporadic".
    pub coordination: String,
    /// Plant under control: "the simulated plant", or the bridge.
    pub plant: String,
    /// Effectors in the scenario's order.
    pub arms: Vec<ArmStage>,
    /// Cameras in the scenario's order.
    pub cameras: Vec<CameraStage>,
    /// Solids with which the cell is drawn.
    pub solids: Vec<Solid>,
    /// Rigid objects beside the cube, in the scenario's order.
    #[serde(default)]
    pub objects: Vec<ObjectStage>,
    /// Edge of the cube (m).
    pub edge: f64,
    /// Pose in the world at which the operator's hand is expected.
    pub hand_zone: Option<Pose>,
    /// Limits that are drawn in the curves.
    pub limits: Limits,
    /// Parameters that the operator may change, in the order of
    /// [`Snapshot::parameters`](super::Snapshot::parameters).
    #[serde(default)]
    pub parameters: Vec<ParameterStage>,
}

/// A parameter that the operator may change while a run goes on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ParameterStage {
    /// The parameter, which is written as its name.
    pub parameter: Parameter,
    /// Unit; empty for a number without one.
    pub unit: String,
    /// Meaning in one sentence.
    pub meaning: String,
    /// Greatest rate at which the value changes, per second.
    pub rate: f64,
    /// Value of the scenario, and the values that may be ordered.
    #[serde(flatten)]
    pub bounds: Bounds,
}

/// An effector.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ArmStage {
    /// Name in the scenario.
    pub name: String,
    /// Whether the arm has a track, which is its axis 0.
    pub has_track: bool,
    /// Joint limits, low and high (m or rad).
    pub joint_limits: [(f64, f64); AXES],
    /// Motor limits (rad).
    pub motor_limits: [(f64, f64); AXES],
    /// Smallest and largest distance between the pads (m).
    pub opening: (f64, f64),
    /// Names of the poses to which the operator may send the arm by hand.
    pub poses: Vec<String>,
}

/// A rigid object beside the cube, as the scenario has it.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ObjectStage {
    /// Name in the scenario.
    pub name: String,
    /// Whether the object never moves. A loose one has its pose in
    /// [`Snapshot::objects`](super::Snapshot::objects).
    pub fixed: bool,
    /// Pose in the world: of a fixed object always, of a loose one at the start.
    pub pose: Pose,
    /// Solids with which the object is drawn; their poses are in its frame.
    pub solids: Vec<Solid>,
}

/// A camera.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct CameraStage {
    /// Name in the scenario.
    pub name: String,
    /// Index of the effector that carries the camera; `None` for a stand-alone camera.
    pub arm: Option<usize>,
    /// Pose in the world, or in the effector's flange.
    pub pose: Pose,
    /// Size of a picture, columns and rows (px).
    pub size: (u32, u32),
}

/// Limits of the behaviours (motions with a goal), and the length of a servo period.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Limits {
    /// Force at which a behaviour is aborted (N).
    pub force: f64,
    /// Torque at which a behaviour is aborted (Nm).
    pub torque: f64,
    /// Length of a servo period (s).
    pub period: f64,
}
