//! Links between nodes, which share the actors of one controller.
//!
//! [`LinkModel`] is the model of a link. It stands in the place of a network on the virtual clock,
//! where a run repeats to the bit.

mod model;

pub use model::{Direction, LinkModel};
