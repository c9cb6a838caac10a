//! A valid scenario in SI: the half of the controller, the half of the plant, and what both share.

use super::catalogue::ChosenTask;
use super::config::{ControllerConfig, PlantSection};
use super::keys::{Bridge, Pace, RealTime};
use super::objects::ObjectKeys;
use super::order_keys::ScriptedOrder;
use crate::cube::{Cube, Facelets};
use crate::hw::devices::{Devices, NoDevice};
use crate::motion::PERIOD;
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
    /// Orders of parameters that the scenario gives in place of the operator, by time.
    pub orders: Vec<ScriptedOrder>,
    /// Task of the run.
    pub task: ChosenTask,
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

    /// Returns the rigid objects beside the cube, for pictures of the cell. The controller does not
    /// know them.
    #[must_use]
    pub fn objects(&self) -> &[ObjectKeys] {
        &self.plant.objects
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
