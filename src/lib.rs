//! A two-handed robot that takes, reads, solves and returns a Rubik's cube.
//!
//! The map, from the top down; arrows of `use` point down only (`tests/architecture.rs` enforces it):
//!
//! | layer | modules | what they own |
//! |---|---|---|
//! | edge | [`cli`], [`scenario`] | words, files, units of the workshop (mm, degrees, ms) |
//! | shells | [`actors`], [`record`] | mailboxes, lifecycles, clocks, errors |
//! | hardware | [`hw`] | ports, the servo's drivers of time, cameras, the simulated plant |
//! | task kernels | [`tasks`] | event -> next action; the regrasp plan |
//! | pure | [`generators`], [`vision`], [`solver`], [`reach`], [`servo`] | step(inputs) -> output |
//! | vocabulary | [`cell`], [`kinematics`], [`motion`], [`cube`], [`spatial`], [`error`] | types of the field |
//!
//! Nothing below `hw` knows a thread, a clock, a file or a log: time, randomness and configuration are arguments.

pub mod actors;
pub mod cell;
pub mod cli;
pub mod cube;
pub mod error;
pub mod generators;
pub mod hw;
pub mod kinematics;
pub mod motion;
pub mod reach;
pub mod record;
pub mod scenario;
pub mod servo;
pub mod solver;
pub mod spatial;
pub mod tasks;
pub mod vision;
