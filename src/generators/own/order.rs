//! The order for a generator that is registered by name.
//!
//! - in: name and data
//! - out: plain data that is recorded and replayed

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Order for a registered generator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OwnOrder {
    /// Name under which the generator is registered.
    pub generator: String,
    /// The generator's order, as its type `Order` is written in JSON.
    pub order: Value,
    /// Fraction of its own speed at which it moves, above 0 and at most 1. MP lowers it for a
    /// motion that would be too fast near the operator's hand, or for a motor.
    pub fraction: f64,
}
