//! Common parts of the benches: arms that do not move, options, histograms and output.
#![allow(dead_code, unreachable_pub, reason = "not every bench needs all of it")]

#[path = "../../tests/servo_rig/mod.rs"]
mod servo_rig;

pub use servo_rig::START;

use hdrhistogram::Histogram;
use rubik_robot::arms::builtin;
use rubik_robot::hw::port::{Port, PortFault};
use rubik_robot::kinematics::ArmModel;
use rubik_robot::motion::{Direction, Frame, Motion, MoveCommand};
use rubik_robot::servo::io::{ArmDrive, ArmReading};
use rubik_robot::servo::{ServoCommand, ServoConfig};
use std::f64::consts::TAU;

/// Direction of a position-force motion that yields to a force and stands still without one.
pub const COMPLIANT: Direction =
    Direction::Guarded { velocity: 0.0, admittance: 0.001, inertia: 20.0 };

/// Returns the kinematic model of the built-in arm profile `name`.
pub fn model(name: &str) -> ArmModel {
    builtin(name).unwrap_or_else(|| unreachable!("a built-in profile"))
}

/// Returns the servo configurations of the two arms of the cell: track arm, postument.
pub fn configs() -> Vec<ServoConfig> {
    ["irp6_track", "irp6_postument"].map(config).into()
}

/// Returns the servo configuration that the servo's tests use, but with the kinematic model of the
/// built-in arm profile `name`.
fn config(name: &str) -> ServoConfig {
    ServoConfig { model: model(name), ..servo_rig::config() }
}

/// Returns a position-force command that never ends: five directions of the tool frame are
/// compliant, and the rotation about y is position-controlled.
pub fn yielding() -> ServoCommand {
    let mut directions = [COMPLIANT; 6];
    directions[4] = Direction::HOLD;
    let motion = Motion::Task { frame: Frame::Tool, directions };
    ServoCommand::Move { command: MoveCommand { motion, periods: u32::MAX, jaw: None }, start: 0 }
}

/// Port of arms that do not move, under an alternating force. The force law therefore has work to
/// do, and moves the set value by less than a tenth of a millimetre.
pub struct Still(Vec<ArmReading>);

impl Still {
    /// Makes a port whose encoder counts always are those of both arms at [`START`].
    pub fn new() -> Self {
        let readings = configs().into_iter().map(|config| {
            let motors = config.model.motors(&START);
            ArmReading {
                counts: std::array::from_fn(|i| {
                    (motors.0[i] * config.model.increments[i] / TAU).round() as i64
                }),
                ..ArmReading::default()
            }
        });
        Self(readings.collect())
    }
}

impl Port for Still {
    /// Returns the same encoder counts in each period, with a force that alternates between 2 N and
    /// -2 N along x and z of the sensor, with a cycle of 64 periods.
    fn exchange(
        &mut self,
        period: u64,
        _: &[ArmDrive],
        readings: &mut [ArmReading],
    ) -> Result<(), PortFault> {
        // Alternating, because a constant force would move the set value further in each period.
        let swing = if period % 64 < 32 { 2.0 } else { -2.0 };
        for (reading, still) in readings.iter_mut().zip(&self.0) {
            *reading = *still;
            reading.wrench_on_sensor.force.x = swing;
            reading.wrench_on_sensor.force.z = swing;
        }
        Ok(())
    }
}

/// Returns whether the command line selects the bench `name`. The arguments that do not begin with
/// `-` are filters, as `plant` in `cargo bench -- plant`: a bench is selected if its name contains
/// a filter, or if there are no filters.
pub fn is_selected(name: &str) -> bool {
    let filters: Vec<String> =
        std::env::args().skip(1).filter(|arg| !arg.starts_with('-')).collect();
    filters.is_empty() || filters.iter().any(|f| name.contains(f.as_str()))
}

/// Returns whether the command line has the option `--json`, with which a bench prints one line of
/// JSON.
pub fn json() -> bool {
    std::env::args().any(|arg| arg == "--json")
}

/// Makes an empty histogram for times in ns. It counts times up to 1 s with a relative error of at
/// most 0.001.
pub fn histogram() -> Histogram<u64> {
    Histogram::new_with_bounds(1, 1_000_000_000, 3).unwrap_or_else(|_| unreachable!("fixed bounds"))
}

/// Returns a quantile, in us, of times that were recorded in ns. `share` is 0.5 for the median.
pub fn us(times: &Histogram<u64>, share: f64) -> f64 {
    times.value_at_quantile(share) as f64 / 1000.0
}

/// Formats the names and values in `fields` as a JSON object, with values rounded to three
/// decimals and `null` for `None`.
pub fn object(fields: &[(&str, Option<f64>)]) -> String {
    let mut map = serde_json::Map::new();
    for (name, value) in fields {
        let value = value.map(|v| (v * 1000.0).round() / 1000.0);
        map.insert((*name).to_owned(), serde_json::json!(value));
    }
    serde_json::Value::Object(map).to_string()
}
