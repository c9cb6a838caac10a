//! Everything under `scenarios/faults/`, over the seeds that `FAULT_SEEDS` says.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop loudly")]

mod missions;
#[path = "../program/mod.rs"]
mod program;
mod scenarios;
mod seeds;
