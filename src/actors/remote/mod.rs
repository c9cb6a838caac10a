//! Actors on another node, over a link on the wall clock.
//!
//! MP's node has a [`Home`] for each other node: it gives handles of the actors there, which look
//! like those of actors beside it. The other node has a [`Host`], which passes the requests on to
//! the actors and returns their answers. The servo's period of 2 ms never crosses a link, since an
//! EDP, its servo and its bridge are on one node.
//!
//! A beat counts only if it comes back in time: messages that pile up on their way would delay an
//! order to stop as well.
//!
//! - in: requests to actors, beats, the operator's control; a [`Link`](crate::net::Link)
//! - out: answers, states of arms, poses of the cube; messages to the operator, pictures; a system
//!   error if the other node is silent
//!
//! | fault | threshold | reaction |
//! |---|---|---|
//! | no beat of the node in time | [`SILENT`] and the longest way | system error of MP's node |
//! | no beat of MP's node in time | 0.1 s, then 1 s | the servo brakes, then trips |
//! | | [`GONE`] | the node ends |
//! | a message is missing | - | system error of the node that finds it |
//! | an arm is stopped | one beat | the arms of the other nodes stand by, until it is reset |
//! | the emergency stop is pressed | one beat | the arms of all nodes trip |

mod beats;
mod home;
mod host;
mod line;
mod message;
mod notices;
mod offset;
mod pictures;
#[cfg(test)]
mod tests;

pub(crate) use home::{Home, Joined, Stopped, Watch};
pub(crate) use host::{Host, Left};
pub(crate) use line::{Receiver, Sender};
pub(crate) use message::{Introduction, ToHome, ToNode};
pub(crate) use notices::send_notices;
pub(crate) use offset::Offset;
pub(crate) use pictures::send as send_pictures;

use std::time::Duration;

/// Time without a beat, beyond the longest way of one, after which a node counts as dead.
pub(crate) const SILENT: Duration = Duration::from_millis(150);
/// Time without a beat of MP's node after which a node ends. Its arms have tripped by then.
pub(crate) const GONE: Duration = Duration::from_secs(2);

/// Returns the controller's half of the default scenario.
#[cfg(test)]
fn example_config() -> crate::scenario::ControllerConfig {
    crate::tasks::read(std::path::Path::new("t.toml"), "", &[]).unwrap().controller
}
