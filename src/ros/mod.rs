//! Topics of ROS 2 without ROS, as nodes under `rmw_zenoh` expect them: the messages of a
//! recording, published while the run goes on, and the topics that the program takes.
//!
//! - in: the feed of a run; the endpoint of a zenoh router, the number of the domain; pictures and
//!   commands of other programs
//! - out: a node `rubik_robot` with a publisher for each topic, which `ros2 topic list` shows;
//!   frames of a camera ([`RosCamera`]), the latest message of a topic ([`Listener`])
//! - source: the design document of `rmw_zenoh`; REP 2011 and `rosidl` for the hashes of types
//!
//! | rule | reason |
//! |---|---|
//! | the session is a client of a router | it joins no network by itself |
//! | topics that hold for the whole run are sent again each second | a late reader needs them |
//! | a reader that is slow misses messages | no run waits for it |
//! | a message is checked before anything is allocated | it comes from another program |

mod camera;
mod joints;
mod listener;
pub mod messages;
mod names;
mod publisher;
mod type_hash;

pub use camera::RosCamera;
pub use listener::{Arrived, Listener};
pub use names::Names;
pub use publisher::Publisher;
pub use type_hash::type_hash;
