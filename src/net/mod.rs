//! Links between nodes, which share the actors of one controller.
//!
//! - [`LinkModel`]: the model of a link. It stands in the place of a network on the virtual clock,
//!   where a run repeats to the bit.
//! - [`Link`]: a link that carries bytes on the wall clock, over a network (`zenoh`, feature
//!   `net`) or within a process ([`pair`])
//! - [`Session`], [`Subscription`]: topics over the same network, for programs of ROS 2

mod link;
mod model;
mod place;
#[cfg_attr(not(feature = "net"), path = "without.rs")]
mod zenoh;

pub use link::{End, Lane, Link, Message, Parcels, Traffic, pair};
pub use model::{Direction, LinkModel};
pub use place::{RosPlace, domain_of_environment, refuses_topic};
pub use zenoh::{Session, Subscription, Token, Topic, open, open_client};
