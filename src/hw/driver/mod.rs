//! The two drivers of time, which call the one servo core in each period.
//!
//! - [`Core`]: one period of all arms, with switches, commands, servos, records and the exchange
//!   with the port
//! - [`run_virtual`]: one task on a tokio runtime with paused time; repeatable to the bit
//! - [`spawn_wall`]: a real-time thread with absolute sleeps and a spin; a bridge thread owns the
//!   port
//! - [`ServoLink`] and [`ServoEnd`]: the ends of the wait-free link between an EDP (the actor that
//!   drives one arm) and its servo
//!
//! The servo never waits: a ring brings the commands, a triple buffer takes the states.

mod bridge;
mod core;
mod link;
mod realtime;
mod record;
mod stats;
mod suspend;
mod virtual_time;
mod wall;

pub use self::core::{Core, HEARTBEAT_TIMEOUT, Switches};
pub use bridge::{Bridge, BridgeLost, BridgePort};
pub use link::{ServoEnd, ServoLink, Unsent, link, link_at};
pub use realtime::{Clock, RealTime, missing_core, own_cores, step_back};
pub use record::{NoRecords, RecordSink, ServoRecord};
pub use stats::{Histogram, Timing};
pub use suspend::Time;
pub use virtual_time::run_virtual;
pub(crate) use wall::pass;
pub use wall::{Wall, WallEnd, WallOptions, spawn_wall, spawn_wall_on};

/// Default length of a servo period (ns).
pub const PERIOD_NANOS: u64 = 2_000_000;
