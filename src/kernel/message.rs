//! The end of a task, and what MP and its ECPs tell each other: orders to begin a programme,
//! signals, ends. All of it is plain data.

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The end of a task, as the controller sees it. The plant decides whether the cube is solved.
#[derive(Debug, Clone, PartialEq)]
pub struct Finish {
    /// Whether the controller believes that the task is achieved.
    pub achieved: bool,
    /// Reason of the end, in words.
    pub reason: String,
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
#[derive(Debug, Clone, PartialEq)]
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
