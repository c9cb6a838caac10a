//! The servo: period by period, with its two drivers of time, on the plant, and when it was just switched on.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop loudly"
)]

mod closed_loop;
mod drivers;
mod homing;
mod period;
#[path = "../servo_rig/mod.rs"]
mod servo_rig;
