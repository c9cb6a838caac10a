//! Tests of all scenarios under `scenarios/faults/`, with the seeds of `FAULT_SEEDS`, and under
//! `scenarios/mixes/`.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop loudly")]

mod missions;
mod mixes;
#[path = "../program/mod.rs"]
mod program;
mod scenarios;
mod seeds;
