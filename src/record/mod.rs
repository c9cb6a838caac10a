//! What leaves a run: the tape (a hash over every servo record and message), the summary, and the recording.

pub mod cdr;
pub mod schema;
pub mod sensed;
pub mod summary;
pub mod tape;
pub mod tick;
pub mod urdf;
