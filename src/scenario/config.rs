//! The two halves of a valid scenario in SI: that of the controller and that of the plant.

use super::declared::{ChosenSensor, TaskLabel, TaskSections};
use super::injected::FaultKeys;
use super::keys::{Control, Coordination, Separation, VisionKeys, VisualServo};
use super::lists::VspKind;
use super::node_keys::Network;
use super::objects::{LeadKeys, ObjectKeys, ProbeKeys};
use super::plant::PlantKeys;
use super::ros_keys::RosKeys;
use crate::cell::Cell;
use crate::cube::Facelets;
use crate::generators::own::Library;
use crate::kernel::Input;
use crate::kernel::programme::Programmes;
use crate::operator::parameter::AllBounds;
use crate::servo::regulator::ServoGains;
use std::path::PathBuf;

/// Half of a scenario that the controller may know: its task, its gains, and its belief of the
/// cell.
#[derive(Debug, Clone, PartialEq)]
pub struct ControllerConfig {
    /// Task of the run.
    pub task: TaskLabel,
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
    /// Nodes beside that of MP, and the link to them.
    pub network: Network,
    /// Router and domain of the topics of ROS 2.
    pub ros: RosKeys,
    /// Gains, speeds, limits.
    pub control: Control,
    /// Bounds of the parameters that the operator may change while a run goes on.
    pub bounds: AllBounds,
    /// Generator that follows the cube.
    pub visual_servo: VisualServo,
    /// Vision.
    pub vision: VisionKeys,
    /// Keys of the tasks.
    pub sections: TaskSections,
    /// Programmes that ECPs can carry out.
    pub programmes: Programmes,
    /// Generators that are registered by name.
    pub generators: Library,
}

impl ControllerConfig {
    /// Returns whether the arms take the shortest free ways between meetings of the hands. Only
    /// some tasks go from one meeting to the next; for others the long search of ways would be
    /// wasted.
    #[must_use]
    pub fn uses_shortest_paths(&self) -> bool {
        self.control.separation == Separation::Least && self.task.properties.walks
    }

    /// Returns the length of a macrostep of an effector (periods): that of the scenario, or more if
    /// its EDP is on another node.
    #[must_use]
    pub fn macrostep(&self, effector: usize) -> u32 {
        self.control.macrostep_periods.max(self.network.least_macrostep(effector))
    }

    /// Returns the binary input with this name; `None` if no effector has one.
    #[must_use]
    pub fn input(&self, name: &str) -> Option<Input> {
        let of = |(effector, settings): (usize, &EffectorConfig)| {
            let bit = settings.inputs.iter().position(|input| input == name)?;
            Some(Input { effector, bit: u32::try_from(bit).ok()? })
        };
        self.effectors.iter().enumerate().find_map(of)
    }
}

/// Settings of an effector other than its geometry.
#[derive(Debug, Clone, PartialEq)]
pub struct EffectorConfig {
    /// Whether the palm keeps a distance from the cube.
    pub palm_clearance: bool,
    /// Regulators and watchdogs of its axes.
    pub gains: ServoGains,
    /// Names of its binary inputs, the lowest bit first.
    pub inputs: Vec<String>,
}

/// Source of the frames of a camera.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CameraSource {
    /// The simulated plant.
    Renderer,
    /// Image files, in the order of their names.
    Folder(PathBuf),
    /// Topic of ROS 2 with this name.
    Ros(String),
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
    /// Declaration of a user's own sensor; `None` for the other kinds.
    pub own: Option<ChosenSensor>,
    /// Index of its camera; `None` without one.
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
    /// Objects of the cell.
    pub objects: Vec<ObjectKeys>,
    /// Probes on the tools.
    pub probes: Vec<ProbeKeys>,
    /// Persons who lead a tool.
    pub leads: Vec<LeadKeys>,
}
