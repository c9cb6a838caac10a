//! Topics of ROS 2 without ROS: the messages of a recording, published while the run goes on, as
//! nodes under `rmw_zenoh` expect them.
//!
//! - in: the feed of a run; the endpoint of a zenoh router, the number of the domain
//! - out: a node `rubik_robot` with a publisher for each topic, which `ros2 topic list` shows
//! - source: the design document of `rmw_zenoh`; REP 2011 and `rosidl` for the hashes of types
//!
//! | rule | reason |
//! |---|---|
//! | the session is a client of a router | it joins no network by itself |
//! | topics that hold for the whole run are sent again each second | a late reader needs them |
//! | a reader that is slow misses messages | no run waits for it |

mod names;
mod publisher;
mod type_hash;

pub use names::Names;
pub use publisher::Publisher;
pub use type_hash::type_hash;
