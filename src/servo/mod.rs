//! One servo period of an arm as a pure function: readings and a command in, drives and a state out.
//!
//! The parts carry the paper's names: EDPT chooses force and position directions ([`tff`]), EDPS drives the
//! motors ([`regulator`]). The wrist force ([`wrench`]) comes from the bridge, where the paper has EDPF.
//!
//! - in: the period's number, an [`io::ArmReading`], at most one [`ServoCommand`]
//! - out: an [`io::ArmDrive`] and an [`ArmState`](crate::motion::ArmState); memory stays in the [`ArmServo`]
//! - source: Zieliński et al. (2007), p. 371; axis regulators and the force law of the original's sources
//!
//! No allocation, lock, log or clock in here: the real-time thread calls it every 2 ms.

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

/// All that a servo knows of its arm: the controller's belief.
#[derive(Debug, Clone, PartialEq)]
pub struct ServoConfig {
    /// Geometry, transmissions and limits.
    pub model: ArmModel,
    /// Tool point at the start; [`ServoCommand::SetTool`] changes it.
    pub flange_from_tool: Pose,
    /// Gripper.
    pub gripper: Gripper,
    /// Wrist sensor.
    pub sensor: ForceSensor,
    /// Axis regulators and watch-dogs, as found for periods of 2 ms.
    pub gains: ServoGains,
    /// Length of a period.
    pub period: period::Length,
}

impl ServoConfig {
    /// Of an arm of the cell.
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

/// What a servo can be told; at most one a period.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum ServoCommand {
    /// A macrostep.
    ///
    /// It begins in period `start`, or at once when that has passed; if the present macrostep has at most
    /// two periods left, it follows that one without a gap. Otherwise it takes over from whatever is going
    /// on. One macrostep can wait; a later one replaces it.
    Move {
        /// What to do.
        command: MoveCommand,
        /// First period in which it may apply; 0 means as soon as it can.
        start: u64,
    },
    /// New `flange_from_tool`. The arm does not move.
    SetTool(Pose),
    /// Takes the mean of the next ten readings of the wrist force, less weight, as the new zero.
    Bias,
    /// A load in the gripper, besides what the sensor's own configuration knows; weight 0 takes it away.
    Payload {
        /// (N).
        weight: f64,
        /// Centre of mass in the flange frame (m).
        centre: Point3<f64>,
    },
    /// Spoils the force law, to show what happens then; the reported wrench stays right.
    ForceSettings(ForceSettings),
    /// Clears a fault: set values become what is measured.
    Reset,
    /// Finds the synchronisation position of every axis that has none: see [`homing`].
    Synchronise,
}

/// How the force law sees the wrench: spoilt controllers, for demonstration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ForceSettings {
    /// Factor of the wrench: 1; -1 is the classic mistake.
    pub sign: f64,
    /// How many periods the wrench is late, at most [`ForceSettings::LONGEST_DELAY`].
    pub delay_periods: u32,
}

impl ForceSettings {
    /// The longest delay that can be asked for (periods).
    pub const LONGEST_DELAY: u32 = 63;
}

impl Default for ForceSettings {
    fn default() -> Self {
        Self { sign: 1.0, delay_periods: 0 }
    }
}
