//! The two drivers of time around the one servo core.
//!
//! - [`Core`]: a period of all arms: switches, commands, servos, records, and the exchange with the port
//! - [`run_virtual`]: one task on a tokio runtime with paused time; repeatable to the bit
//! - [`spawn_wall`]: a real-time thread, absolute sleeps and a spin; a bridge thread owns the port
//! - [`ServoLink`] and [`ServoEnd`]: the two ends of the wait-free way between an EDP and its servo
//!
//! The servo never waits for anyone: commands come in by a ring, states go out by a triple buffer.

mod bridge;
mod core;
mod link;
mod realtime;
mod record;
mod stats;
mod virtual_time;
mod wall;

pub use self::core::{Core, HEART, Switches};
pub use bridge::{Bridge, BridgeLost, BridgePort};
pub use link::{ServoEnd, ServoLink, Unsent, link, link_at};
pub use realtime::{Clock, RealTime, step_back};
pub use record::{NoRecords, RecordSink, ServoRecord};
pub use stats::{Histogram, Timing};
pub use virtual_time::run_virtual;
pub(crate) use wall::pass;
pub use wall::{Wall, WallEnd, WallOptions, spawn_wall};

/// Length of a servo period (ns), unless another is asked for.
pub const PERIOD_NANOS: u64 = 2_000_000;
