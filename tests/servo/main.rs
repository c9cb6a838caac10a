//! Tests of the servo: single periods, both drivers of time, servo and plant together, homing.

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
