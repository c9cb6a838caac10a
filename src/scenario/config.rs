//! A scenario that was found right, in SI: the controller's half and the plant's half.

use super::injected::FaultKeys;
use super::keys::{
    Bridge, Control, Coordination, FaceTurn, Idle, Pace, Planner, RealTime, Task, VisionKeys,
    VisualServo,
};
use super::lists::VspKind;
use super::plant::PlantKeys;
use crate::cell::Cell;
use crate::cube::{Cube, Facelets};
use crate::servo::regulator::ServoGains;
use std::path::PathBuf;

/// A scenario that was found right.
#[derive(Debug, Clone, PartialEq)]
pub struct Scenario {
    /// Where it was read from, as the user wrote it.
    pub path: PathBuf,
    /// Seed of everything random in the plant.
    pub seed: u64,
    /// Which clock drives the run.
    pub pace: Pace,
    /// How the servo's thread runs under the wall clock.
    pub real_time: RealTime,
    /// What is behind the hardware port.
    pub bridge: Bridge,
    /// What the controller may know.
    pub controller: ControllerConfig,
    /// What only the simulated plant may read.
    pub plant: PlantSection,
}

impl Scenario {
    /// Returns the number of periods missed in a row after which the arms are brought to a stand
    /// and stop.
    #[must_use]
    pub fn missed_limit(&self) -> u64 {
        let usual = if self.bridge.kind.is_hardware() { 20 } else { 50 };
        u64::from(self.real_time.missed_limit.unwrap_or(usual))
    }

    /// Returns the cube that the plant starts from: the given one, or the seed's.
    #[must_use]
    pub fn cube(&self) -> Facelets {
        match &self.plant.cube_state {
            Some(facelets) => *facelets,
            None => Facelets::from(&Cube::scrambled(self.seed)),
        }
    }
}

/// What the controller may know: its task, its gains, and its belief of the cell.
#[derive(Debug, Clone, PartialEq)]
pub struct ControllerConfig {
    /// What to do.
    pub task: Task,
    /// Who makes the set values.
    pub coordination: Coordination,
    /// Belief: arms, cameras, cube, table, hand-over place.
    pub cell: Cell,
    /// Per effector of `cell.arms`: what the cell's geometry does not hold.
    pub effectors: Vec<EffectorConfig>,
    /// Per camera of `cell.cameras`: where its frames come from.
    pub cameras: Vec<CameraSource>,
    /// Per camera of `cell.cameras`: views of the calibration before a simulated hand-over; 0 for
    /// none.
    pub calibrate_views: Vec<u32>,
    /// Virtual sensors.
    pub vsps: Vec<VspConfig>,
    /// Gains, speeds, limits.
    pub control: Control,
    /// Generator that follows the cube.
    pub visual_servo: VisualServo,
    /// Vision.
    pub vision: VisionKeys,
    /// Solver and regrasp planner; `rule` agrees with the grippers.
    pub planner: Planner,
    /// What `task = "face_turn"` does.
    pub face_turn: FaceTurn,
    /// What `task = "idle"` does.
    pub idle: Idle,
}

/// What an effector has beside its geometry.
#[derive(Debug, Clone, PartialEq)]
pub struct EffectorConfig {
    /// Whether the palm stands off the cube.
    pub palm_clearance: bool,
    /// Regulators and watch-dogs of its axes.
    pub gains: ServoGains,
}

/// Where a camera's frames come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CameraSource {
    /// The simulated plant.
    Renderer,
    /// Image files, in the order of their names.
    Folder(PathBuf),
}

/// Who gets a VSP's readings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Owner {
    /// MP.
    Mp,
    /// The ECP of the effector with this index.
    Ecp(usize),
}

/// A virtual sensor process.
#[derive(Debug, Clone, PartialEq)]
pub struct VspConfig {
    /// Name.
    pub name: String,
    /// What it makes of its sensor.
    pub kind: VspKind,
    /// Index of its camera; `None` for forces.
    pub camera: Option<usize>,
    /// Who gets its readings.
    pub owner: Owner,
    /// Time between two readings (s).
    pub period: f64,
}

/// What only the simulated plant may read.
#[derive(Debug, Clone, PartialEq)]
pub struct PlantSection {
    /// The cube's state, a possible one; `None` is drawn from the seed.
    pub cube_state: Option<Facelets>,
    /// Per effector: whether its controllers are synchronised when the run begins.
    pub synchronised: Vec<bool>,
    /// Keys under `plant`.
    pub keys: PlantKeys,
    /// What is made to go wrong.
    pub faults: Vec<FaultKeys>,
}
