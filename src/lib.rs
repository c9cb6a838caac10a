//! A robot with two arms that takes, reads, solves and returns a Rubik's cube: its controller, and
//! a simulated plant.
//!
//! A run from its scenario to its verdict: both hands hold a cube in simulation and turn one layer.
//!
//! ```
//! use rubik_robot::record::summary::Outcome;
//! use rubik_robot::run::{RunOptions, run};
//! use rubik_robot::tasks;
//! use std::path::Path;
//!
//! // Keys have the units of the workshop; each key that is missing has its default.
//! let text = "task = \"face_turn\"\n[face_turn]\nangle_deg = 90\n[plant]\njaws = \"stiff\"\n";
//! let scenario = tasks::read(Path::new("turn.toml"), text, &[])?;
//! let options = RunOptions { automatic: true, quiet: true, ..RunOptions::default() };
//!
//! let summary = run(&scenario, options)?;
//!
//! // The verdict is that of the simulated plant: the true angle, the true forces.
//! assert_eq!(summary.outcome, Outcome::Solved);
//! assert!(summary.turned_deg.is_some_and(|angle| (angle - 90.0).abs() < 3.0));
//! assert!(summary.peak_force_n.is_some_and(|force| force < 20.0));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The folder `examples` of the repository has programs of this kind: servo periods, a face in a
//! picture, the places where the arms meet, a recording, a task of one's own.
//!
//! The layers from the top down. A module uses only those below it (`tests/architecture.rs` checks
//! that):
//!
//! | layer | modules | content |
//! |---|---|---|
//! | program | [`app`] | the command line with the tasks of a user |
//! | edge | [`cli`] | words and units of the workshop (mm, degrees, ms), exit codes |
//! | many runs | [`campaign`] | success rate with its interval, variations, processes, reports |
//! | one run | [`run`] | composition from a scenario: world, servos, actors; verdict and summary |
//! | tasks | [`tasks`] | one folder a task: keys, kernel, verdict |
//! | door | [`registry`] | what a task of any crate must implement |
//! | shells | [`actors`] | mailboxes, lifecycles, clocks, errors |
//! | UIs | [`web`], [`tui`] | the operator's page and terminal |
//! | other programs | [`ros`] | topics of ROS 2 |
//! | configuration | [`scenario`] | files in, data to the actors |
//! | results | [`record`] | hash, summary, recordings, journal |
//! | files | [`tables`] | tables of the solver, kept in files |
//! | channels | [`desk`] | snapshots up, inputs down |
//! | hardware | [`hw`] | ports, the drivers that call the servo, cameras, the simulated plant |
//! | links | [`net`] | links between nodes, and the model of one |
//! | stop | [`emergency_stop`] | handles that press, read or release the emergency stop |
//! | kernels | [`kernel`] | what a kernel asks of its shell: event -> next action |
//! | pure | [`generators`], [`vision`], [`solver`] | step(inputs) -> output |
//! | | [`reach`], [`servo`] | |
//! | vocabulary | [`cell`], [`kinematics`], [`arms`], [`motion`] | types of the field |
//! | | [`cube`], [`spatial`], [`operator`], [`error`] | |
//!
//! No module below `hw` and no kernel of a task uses a thread, a clock, a file or a log: time,
//! randomness and configuration are arguments. The emergency stop is the one exception: a flag that
//! threads share.

/// Code of the book, compiled as tests.
#[cfg(doctest)]
mod book {
    #[doc = include_str!("../docs/task.md")]
    struct Task;
    #[doc = include_str!("../docs/generators.md")]
    struct Generators;
}

pub use app::App;
pub use nalgebra;
pub use rubik_robot_solver as solver;
pub use rubik_robot_vision as vision;
pub use rubik_robot_vocabulary::{cell, cube, kinematics, motion, spatial};

pub mod actors;
pub mod app;
pub mod arms;
pub mod campaign;
pub mod cli;
pub mod desk;
pub mod emergency_stop;
pub mod error;
pub mod generators;
pub mod hw;
pub mod kernel;
pub mod net;
pub mod operator;
pub mod reach;
pub mod record;
pub mod registry;
pub mod ros;
pub mod run;
pub mod scenario;
pub mod servo;
pub mod tables;
pub mod tasks;
pub mod tui;
pub mod web;
