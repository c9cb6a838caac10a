//! The simulated plant, behind the same port and frame source as real hardware.

pub mod render;
