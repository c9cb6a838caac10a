//! The sensor `gap`: a range finder in the first hand measures the distance to the second one.
//!
//! - in: single distances of the device, which may be disturbed
//! - out: the median of the last three (m)

use rubik_robot::hw::scene::Scene;
use rubik_robot::motion::ArmState;
use rubik_robot::registry::{Device, DeviceModel, Sensor};
use rubik_robot::section;

section! {
    /// Keys of the sensor.
    pub Keys {
        /// Largest distance that the device measures.
        range [mm]: f64 = 3000.0, 100.0..=10000.0;
        /// Step between two distances that the device can tell apart.
        step [mm]: f64 = 1.0, 0.0..=100.0;
    }
}

/// Kernel of the VSP.
pub struct Gap {
    /// Last distances, the oldest first (m).
    last: Vec<f64>,
}

impl Sensor for Gap {
    type Keys = Keys;
    type Measurement = f64;
    type Reading = f64;

    fn new(_: &Keys) -> Result<Self, String> {
        Ok(Self { last: Vec::new() })
    }

    fn device(_: &Keys) -> Result<Box<dyn Device<f64>>, String> {
        Err("this example has no driver of a real range finder".to_owned())
    }

    fn reading(&mut self, distance: f64, _: &[ArmState]) -> Result<f64, String> {
        if self.last.len() == 3 {
            self.last.remove(0);
        }
        self.last.push(distance);
        let mut sorted = self.last.clone();
        sorted.sort_by(f64::total_cmp);
        Ok(sorted[sorted.len() / 2])
    }
}

/// Model of the device in the simulated plant.
pub struct GapModel {
    keys: Keys,
}

impl DeviceModel for GapModel {
    type Sensor = Gap;

    fn new(keys: &Keys, _: u64) -> Self {
        Self { keys: keys.clone() }
    }

    fn measure(&mut self, scene: &Scene) -> Result<f64, String> {
        let hands = scene.arms.iter().take(scene.arm_count);
        let places: Vec<_> = hands.map(|arm| arm.world_from_tool.translation.vector).collect();
        let [first, second] = places[..] else { return Err("there is no second hand".to_owned()) };
        let distance = (second - first).norm();
        if distance > self.keys.range {
            return Err(format!("{:.0} mm are out of range", distance * 1e3));
        }
        let step = self.keys.step.max(f64::EPSILON);
        Ok((distance / step).round() * step)
    }
}
