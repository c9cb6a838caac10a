//! The program as its user meets it: in processes of its own. One binary, so that what takes long runs side by side.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop loudly")]

mod campaign;
mod cli;
mod hardware;
mod missions;
mod page;
#[path = "../program/mod.rs"]
mod program;
mod recording;
mod resume;
mod solve;
mod terminal;
mod urdf;
