//! The keys of a whole scenario without those of its task: its top level, and one section below
//! each name.

use super::keys::{
    Bridge, CellKeys, Control, Coordination, CubeKeys, HandKeys, Pace, Profile, RealTime, Servo,
    VisionKeys, VisualServo,
};
use super::node_keys::LinkKeys;
use super::plant::PlantKeys;
use super::ros_keys::RosKeys;
use super::section::section;

section! {
    /// Keys of a whole scenario, without its lists.
    pub(crate) Root {
        /// Task of the run.
        task: String = "solve".to_owned();
        /// Process that makes the set values of the arms.
        coordination: Coordination = Coordination::Sporadic;
        /// Seed of everything random in the plant.
        seed: u64 = 1;
        /// Clock that drives the run.
        pace: Pace = Pace::Virtual;
    } with {
        /// Connection behind the hardware port.
        bridge: Bridge,
        /// Cell.
        cell: CellKeys,
        /// Cube.
        cube: CubeKeys,
        /// Hand-over place.
        hand: HandKeys,
        /// Gains, speeds, limits.
        control: Control,
        /// Generator that follows the cube.
        visual_servo: VisualServo,
        /// Vision.
        vision: VisionKeys,
        /// Regulators of the axes.
        servo: Servo,
        /// Thread of the servo.
        real_time: RealTime,
        /// Link between the nodes, if the scenario has several.
        link: LinkKeys,
        /// Topics of ROS 2.
        ros: RosKeys,
        /// Truth, which only the simulated plant may read.
        plant: PlantKeys,
    }
}

impl Root {
    /// Returns the chosen profile of speeds, or the default one of the bridge.
    pub(super) fn profile(&self) -> Profile {
        self.control.profile.unwrap_or(Profile::usual(self.bridge.kind))
    }
}
