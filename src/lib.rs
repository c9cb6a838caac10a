//! A robot with two arms that takes, reads, solves and returns a Rubik's cube: its controller, and
//! a simulated plant.
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

pub use app::App;
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
