//! One servo period of an arm as a pure function: readings and a command in, drives and state out.
//!
//! The parts have the names of the paper: EDPT follows velocities and seeks forces in the task
//! frame ([`tff`]), EDPS drives the motors ([`regulator`]). The readings of the bridge contain the
//! wrist force ([`wrench`]), for which the paper has a part of its own, EDPF.
//!
//! - in: the number of the period, an [`io::ArmReading`], an [`io::Outside`], at most one
//!   [`ServoCommand`]
//! - out: an [`io::ArmDrive`] and an [`ArmState`](crate::motion::ArmState); the [`ArmServo`] keeps
//!   the memory
//! - source: Zieliński et al. (2007), p. 371; the axis regulators and the force law are from the
//!   sources of the original controller
//!
//! This code allocates no memory, takes no lock, writes no log and reads no clock, because the
//! real-time thread calls it every 2 ms.

pub mod ahead;
mod arm;
pub mod homing;
pub mod io;
pub mod jaw;
pub mod lateness;
pub mod path;
pub mod period;
pub mod regulator;
pub mod tff;
pub mod watch;
pub mod weigh;
pub mod wrench;

pub use arm::ArmServo;

use crate::cell::{Arm, ForceSensor, Gripper};
use crate::kinematics::ArmModel;
use crate::motion::MoveCommand;
use crate::spatial::Pose;
use nalgebra::Point3;
use regulator::ServoGains;
use serde::{Deserialize, Serialize};

/// Data of an arm as its servo believes them.
#[derive(Debug, Clone, PartialEq)]
pub struct ServoConfig {
    /// Geometry, transmissions and limits of the arm.
    pub model: ArmModel,
    /// Tool point at the start; [`ServoCommand::SetTool`] changes it.
    pub flange_from_tool: Pose,
    /// Gripper of the arm.
    pub gripper: Gripper,
    /// Force sensor of the wrist.
    pub sensor: ForceSensor,
    /// Gains of the regulators and thresholds of the watchdogs, for periods of 2 ms.
    pub gains: ServoGains,
    /// Length of a period.
    pub period: period::Length,
}

impl ServoConfig {
    /// Makes the configuration for an arm of the cell.
    #[must_use]
    pub fn new(arm: &Arm, gains: ServoGains) -> Self {
        Self {
            model: arm.model.clone(),
            flange_from_tool: arm.flange_from_tool,
            gripper: arm.gripper,
            sensor: arm.sensor,
            gains,
            period: period::Length::default(),
        }
    }
}

/// Command to a servo; at most one per period.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum ServoCommand {
    /// A macrostep.
    ///
    /// It begins in period `start`, or at once if that has passed. If the running macrostep has at
    /// most two periods left, the new one follows it without a gap; otherwise it replaces the
    /// running one. One macrostep can wait, and a later one replaces it.
    Move {
        /// Motion of the arm and the jaw.
        command: MoveCommand,
        /// First period in which it may apply; 0 means at once.
        start: u64,
    },
    /// New `flange_from_tool`. The arm does not move.
    SetTool(Pose),
    /// New zero of the wrist force: the mean of the next ten readings, less the weight.
    Bias,
    /// Load in the gripper, in addition to the tool in the configuration of the sensor. A weight of
    /// 0 removes it.
    Payload {
        /// Weight (N).
        weight: f64,
        /// Centre of mass in the flange frame (m).
        centre: Point3<f64>,
    },
    /// Faulty settings of the force law, for demonstration. The reported wrench stays right.
    ForceSettings(ForceSettings),
    /// End of a fault: the set values become the measured ones.
    Reset,
    /// Search for the synchronisation position of every axis that has none: see [`homing`].
    Synchronise,
}

/// Errors in the wrench that the force law gets, for demonstration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ForceSettings {
    /// Factor of the wrench: 1 is right, -1 is the classic mistake.
    pub sign: f64,
    /// Delay of the wrench (periods), at most [`ForceSettings::LONGEST_DELAY`].
    pub delay_periods: u32,
}

impl ForceSettings {
    /// Longest delay that a command can set (periods).
    pub const LONGEST_DELAY: u32 = 63;
}

impl Default for ForceSettings {
    fn default() -> Self {
        Self { sign: 1.0, delay_periods: 0 }
    }
}
