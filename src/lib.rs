//! A two-handed robot that takes, reads, solves and returns a Rubik's cube.
//!
//! The map, from the top down; arrows of `use` point down only (`tests/architecture.rs` enforces it):
//!
//! | layer | modules | what they own |
//! |---|---|---|
//! | edge | [`cli`] | words and units of the workshop (mm, degrees, ms), exit codes |
//! | many runs | [`campaign`] | success with its interval, what is drawn for each run, processes, reports |
//! | one run | [`run`] | composition from a scenario: world, servos, actors; verdict and summary |
//! | shells | [`actors`] | mailboxes, lifecycles, clocks, errors |
//! | UIs | [`web`], [`tui`] | the operator's page and terminal |
//! | configuration, results | [`scenario`], [`record`], [`tables`], [`desk`] | files in, data to the actors; hash and summary out; the solver's tables kept; snapshots up, inputs down |
//! | hardware | [`hw`] | ports, the servo's drivers of time, cameras, the simulated plant |
//! | stop | [`emergency_stop`] | who may stop the arms |
//! | task kernels | [`tasks`] | event -> next action; the regrasp plan |
//! | pure | [`generators`], [`vision`], [`solver`], [`reach`], [`servo`] | step(inputs) -> output |
//! | vocabulary | [`cell`], [`kinematics`], [`arms`], [`motion`], [`cube`], [`spatial`], [`operator`], [`error`] | types of the field |
//!
//! Nothing below `hw` knows a thread, a clock, a file or a log: time, randomness and configuration are arguments.

pub use rubik_robot_solver as solver;
pub use rubik_robot_vision as vision;
pub use rubik_robot_vocabulary::{cell, cube, kinematics, motion, spatial};

pub mod actors;
pub mod arms;
pub mod campaign;
pub mod cli;
pub mod desk;
pub mod emergency_stop;
pub mod error;
pub mod generators;
pub mod hw;
pub mod operator;
pub mod reach;
pub mod record;
pub mod run;
pub mod scenario;
pub mod servo;
pub mod tables;
pub mod tasks;
pub mod tui;
pub mod web;
