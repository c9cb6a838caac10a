//! Composes a run from its scenario: the world, the servos and their driver, the actors; performs
//! the task and sums up. No actor imports anything from here.

pub mod calibrate;
mod calibration_poses;
mod disturbance;
pub mod emulate;
mod gate;
mod interrupt;
pub mod meeting_cache;
mod recording;
mod settings;
pub mod show;
mod simulation;
mod supervisor;
pub mod verify;
pub mod weigh;
mod witness;
mod world;
mod world_file;

pub use interrupt::{SIGNALS, heard};
pub use settings::planner;
pub use supervisor::{Around, Judge, Keep, RunOptions, not_begun, run, run_at, run_with};
