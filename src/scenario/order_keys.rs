//! The keys of the list `[[order]]`: orders of parameters that the scenario gives in place of the
//! operator.

use super::section::section;
use crate::operator::Parameter;

section! {
    /// Order of a parameter at a time of the run, as the operator could give it.
    pub(crate) OrderKeys {
        /// Name of the order.
        name: String = String::new();
        /// Time since the beginning of the run.
        at [s]: f64 = 0.0, 0.0..=86400.0;
        /// Name of the parameter, from `rubik-robot parameters`.
        parameter: String = String::new();
        /// Value toward which the parameter moves, in its unit.
        value: f64 = 0.0;
    }
}

/// Order of a parameter that a scenario gives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScriptedOrder {
    /// Period of 2 ms after which the order counts.
    pub period: u64,
    /// The parameter.
    pub parameter: Parameter,
    /// Ordered value, in the unit of the parameter.
    pub value: f64,
}
