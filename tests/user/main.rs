//! Tests of the program as its user runs it: in processes of its own. They are one test binary, so
//! that the slow tests run in parallel.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop loudly")]

mod campaign;
mod cli;
mod cluster;
mod contour;
mod damage;
mod feed;
mod folder;
mod hardware;
mod last_second;
mod missions;
mod nodes;
mod page;
mod parameters;
#[path = "../program/mod.rs"]
mod program;
mod recording;
mod resume;
mod robust;
mod ros;
mod solve;
mod tasks;
mod teach;
mod terminal;
mod urdf;
