//! What leaves a run: the tape (a hash over every servo record and message) and the summary.

pub mod summary;
pub mod tape;
