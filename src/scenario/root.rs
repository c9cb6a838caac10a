//! The keys of a whole scenario: its top level, and a section below each name.

use super::keys::{
    Bridge, CellKeys, Control, Coordination, CubeKeys, FaceTurn, HandKeys, Idle, Pace, Planner,
    Profile, RealTime, Servo, Task, VisionKeys, VisualServo,
};
use super::plant::PlantKeys;
use super::section::section;

section! {
    /// The keys of a whole scenario, without its lists.
    pub(crate) Root {
        /// What to do.
        task: Task = Task::Solve;
        /// Who makes the set values of the arms.
        coordination: Coordination = Coordination::Sporadic;
        /// Seed of everything random in the plant.
        seed: u64 = 1;
        /// Which clock drives the run.
        pace: Pace = Pace::Virtual;
    } with {
        /// What is behind the hardware port.
        bridge: Bridge,
        /// The cell.
        cell: CellKeys,
        /// The cube.
        cube: CubeKeys,
        /// Hand-over place.
        hand: HandKeys,
        /// Gains, speeds, limits.
        control: Control,
        /// Following the cube.
        visual_servo: VisualServo,
        /// Vision.
        vision: VisionKeys,
        /// Solver and planner.
        planner: Planner,
        /// Turning one layer.
        face_turn: FaceTurn,
        /// An idle run.
        idle: Idle,
        /// Regulators of the axes.
        servo: Servo,
        /// The servo's thread.
        real_time: RealTime,
        /// What only the simulated plant may read.
        plant: PlantKeys,
    }
}

impl Root {
    /// Returns the profile of speeds that is chosen, or the usual one of the bridge.
    pub(super) fn profile(&self) -> Profile {
        self.control.profile.unwrap_or(Profile::usual(self.bridge.kind))
    }
}
