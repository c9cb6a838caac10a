//! A valid scenario in SI: the half of the controller and the half of the plant.

use super::injected::FaultKeys;
use super::keys::{
    Bridge, Control, Coordination, FaceTurn, Idle, Pace, Planner, RealTime, Task, VisionKeys,
    VisualServo,
};
use super::lists::VspKind;
use super::plant::PlantKeys;
use crate::cell::Cell;
use crate::cube::{Cube, Facelets};
use crate::hw::devices::{Devices, NoDevice};
use crate::motion::PERIOD;
use crate::servo::regulator::ServoGains;
use std::path::PathBuf;

/// Valid scenario.
#[derive(Debug, Clone, PartialEq)]
pub struct Scenario {
    /// Path from which it was read, as the user wrote it.
    pub path: PathBuf,
    /// Text from which it was read, for recordings: the file may have changed since.
    pub text: String,
    /// Seed of everything random in the plant.
    pub seed: u64,
    /// Clock that drives the run.
    pub pace: Pace,
    /// Settings of the servo's thread under the wall clock.
    pub real_time: RealTime,
    /// Connection behind the hardware port.
    pub bridge: Bridge,
    /// Whether the command line names `bridge.devices`. Such a file is trusted even if other users
    /// may write it.
    pub devices_named: bool,
    /// Half that the controller may know.
    pub controller: ControllerConfig,
    /// Half that only the simulated plant may read.
    pub plant: PlantSection,
}

impl Scenario {
    /// Returns the scenario with servo periods of 2 ms. Weighing and calibration have servos of
    /// their own with this period, and the simulated plant must have the same one.
    #[must_use]
    pub fn at_usual_period(&self) -> Self {
        let real_time = RealTime { period: PERIOD, ..self.real_time.clone() };
        Self { real_time, ..self.clone() }
    }

    /// Returns the number of periods missed in a row after which the arms brake and stop.
    #[must_use]
    pub fn missed_limit(&self) -> u64 {
        // Controllers of hardware stop by themselves 50 ms after the last order. With the simulated
        // plant, gaps of up to 45 ms come from below virtual machines and are no reason to stop.
        let usual = if self.bridge.kind.is_hardware() { 20 } else { 50 };
        u64::from(self.real_time.missed_limit.unwrap_or(usual))
    }

    /// Reads the file that names the devices of real controllers. Returns its path and its content.
    pub fn load_devices(&self) -> (PathBuf, Result<Devices, NoDevice>) {
        let path = self.bridge.devices_at(&self.path);
        let load = if self.devices_named { Devices::load_named } else { Devices::load };
        let devices = load(&path);
        (path, devices)
    }

    /// Returns the cube at the start of a simulated run: the given state, or one scrambled from the
    /// seed.
    #[must_use]
    pub fn cube(&self) -> Facelets {
        match &self.plant.cube_state {
            Some(facelets) => *facelets,
            None => Facelets::from(&Cube::scrambled(self.seed)),
        }
    }
}

/// Half of a scenario that the controller may know: its task, its gains, and its belief of the
/// cell.
#[derive(Debug, Clone, PartialEq)]
pub struct ControllerConfig {
    /// Task of the run.
    pub task: Task,
    /// Process that makes the set values.
    pub coordination: Coordination,
    /// Belief of arms, cameras, cube, table and hand-over place.
    pub cell: Cell,
    /// Settings of each effector of `cell.arms` other than its geometry.
    pub effectors: Vec<EffectorConfig>,
    /// Source of the frames of each camera of `cell.cameras`.
    pub cameras: Vec<CameraSource>,
    /// Number of views for the calibration of each camera of `cell.cameras` before a simulated
    /// hand-over; 0 for none.
    pub calibrate_views: Vec<u32>,
    /// Virtual sensors.
    pub vsps: Vec<VspConfig>,
    /// Gains, speeds, limits.
    pub control: Control,
    /// Generator that follows the cube.
    pub visual_servo: VisualServo,
    /// Vision.
    pub vision: VisionKeys,
    /// Settings of solver and regrasp planner; `rule` agrees with the grippers.
    pub planner: Planner,
    /// Settings of `task = "face_turn"`.
    pub face_turn: FaceTurn,
    /// Settings of `task = "idle"`.
    pub idle: Idle,
}

/// Settings of an effector other than its geometry.
#[derive(Debug, Clone, PartialEq)]
pub struct EffectorConfig {
    /// Whether the palm keeps a distance from the cube.
    pub palm_clearance: bool,
    /// Regulators and watchdogs of its axes.
    pub gains: ServoGains,
}

/// Source of the frames of a camera.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CameraSource {
    /// The simulated plant.
    Renderer,
    /// Image files, in the order of their names.
    Folder(PathBuf),
}

/// Receiver of the readings of a VSP.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Owner {
    /// MP.
    Mp,
    /// The ECP of the effector with this index.
    Ecp(usize),
}

/// Virtual sensor process.
#[derive(Debug, Clone, PartialEq)]
pub struct VspConfig {
    /// Name of the VSP.
    pub name: String,
    /// Result that it makes of its sensor.
    pub kind: VspKind,
    /// Index of its camera; `None` for forces.
    pub camera: Option<usize>,
    /// Receiver of its readings.
    pub owner: Owner,
    /// Time between two readings (s).
    pub period: f64,
}

/// Half of a scenario that only the simulated plant may read.
#[derive(Debug, Clone, PartialEq)]
pub struct PlantSection {
    /// State of the cube, a possible one; `None` if the seed draws it.
    pub cube_state: Option<Facelets>,
    /// Whether the controllers of each effector are synchronised at the start of the run.
    pub synchronised: Vec<bool>,
    /// Keys under `plant`.
    pub keys: PlantKeys,
    /// Faults to inject.
    pub faults: Vec<FaultKeys>,
}
