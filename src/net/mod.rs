//! Links between nodes, which share the actors of one controller.
//!
//! - [`LinkModel`]: the model of a link. It stands in the place of a network on the virtual clock,
//!   where a run repeats to the bit.
//! - [`Link`]: a link that carries bytes on the wall clock, over a network (`zenoh`, feature
//!   `net`) or within a process ([`pair`])

mod link;
mod model;
#[cfg_attr(not(feature = "net"), path = "without.rs")]
mod zenoh;

pub use link::{End, Lane, Link, Parcels, Traffic, pair};
pub use model::{Direction, LinkModel};
pub use zenoh::{Session, Token, Topic, open, open_client};
