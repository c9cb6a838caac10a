//! The end of a task, and what MP and its ECPs tell each other: orders to begin a programme,
//! signals, ends; and what a task changes or reads at an effector besides its motions. All of it is
//! plain data.

use crate::motion::ArmState;
use crate::spatial::Pose;
use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The end of a task, as the controller sees it. The plant decides whether the cube is solved.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Finish {
    /// Whether the controller believes that the task is achieved.
    pub achieved: bool,
    /// Reason of the end, in words.
    pub reason: String,
}

/// Change of an effector that moves nothing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Adjustment {
    /// New tool frame, as `flange_from_tool`: poses, motions and forces refer to it from now on.
    Tool(Pose),
    /// Load in the gripper, whose weight the measured forces lose; a weight of 0 removes it.
    Load {
        /// Weight (N).
        weight: f64,
        /// Centre of mass in the flange frame (m).
        centre: Point3<f64>,
    },
    /// End of a fault that has stopped the arm. Its measured position becomes the set one.
    Reset,
}

/// Place of a binary input of the parallel interface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Input {
    /// Effector whose interface has it.
    pub effector: usize,
    /// Number of the input, 0..=15.
    pub bit: u32,
}

impl Input {
    /// Returns this input as a programme sees it, whose own effector is number 0.
    #[must_use]
    pub fn own(self) -> Self {
        Self { effector: 0, ..self }
    }

    /// Returns whether the input is set in the states of these effectors; `None` if there is no
    /// such effector or input.
    #[must_use]
    pub fn of(self, arms: &[ArmState]) -> Option<bool> {
        let bit = 1_u16.checked_shl(self.bit)?;
        Some(arms.get(self.effector)?.inputs & bit != 0)
    }
}

/// Order to begin a programme, as plain data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Programme {
    /// Name under which the programme is registered.
    pub name: String,
    /// Its order, as JSON.
    pub order: Value,
}

/// Signal between MP and a programme.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Signal {
    /// Name, by which the receiver tells signals apart.
    pub name: String,
    /// Data of the signal, as JSON; null for nothing.
    pub value: Value,
}

impl Signal {
    /// Makes a signal that carries nothing.
    #[must_use]
    pub fn new(name: &str) -> Self {
        Self { name: name.to_owned(), value: Value::Null }
    }
}

/// Message between MP and its ECPs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Message {
    /// A signal.
    Signal {
        /// Effector whose programme sent it; 0 for a signal of MP.
        effector: usize,
        /// The signal.
        signal: Signal,
    },
    /// The end of a programme.
    Ended {
        /// Its effector.
        effector: usize,
        /// Its end, as the programme sees it.
        finish: Finish,
    },
}
