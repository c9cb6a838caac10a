//! What leaves the process: the summary of a run.

pub mod summary;
