//! The shells: UI, MP, an ECP and an EDP per effector, VSPs, and the supervisor that creates them.
//!
//! Actors are tokio tasks with bounded mailboxes. Requests go down a tree (MP, ECP, EDP), answers come back by
//! `oneshot`, states go up by `watch`; so there is no cycle of waiting.

mod alarm;
pub mod board;
mod build;
pub mod calibrate;
mod calibration_poses;
pub mod clock;
pub mod control;
mod disturbance;
pub mod ecp;
pub mod edp;
pub mod emulate;
mod gate;
mod homing;
mod interrupt;
mod kept;
pub mod lookout;
pub mod meetings;
pub mod move_instruction;
pub mod mp;
mod plant;
mod present;
mod recording;
pub mod show;
pub mod supervisor;
pub mod ui;
pub mod verify;
pub mod vsp;
pub mod weigh;
pub mod witness;
pub mod work;
mod world;

pub use build::planner;
pub use interrupt::{SIGNALS, heard};
pub use supervisor::{Around, Judge, Keep, RunOptions, not_begun, run, run_at, run_with};
