//! The command line.

pub mod vision;
