//! The task `teach`: a person leads an arm by hand, the way is recorded as a file of points, and
//! the arm plays it back.
//!
//! - in: the person's force at the wrist; or the file of a way
//! - out: the file of the way in the units of a scenario; motions of the arm through its points
//!
//! The kernel is pure, so it does not touch files. The door reads the file of a way before the run
//! begins. A taught way becomes a text in the kernel, which is read again by the same reader, so
//! playback follows the text alone. The run writes this text at its end
//! ([`Document`](crate::kernel::Document)): never over an existing file, and not in a replay.
//!
//! - `way`: points of a way, and their text
//! - `fit`: choice of points from the recorded way
//! - `lesson`: the kernel
//! - `file_keys`: reader of a file, with line and reason of each fault
//! - `order`: distance of two ways, for the judge

mod door;
mod file_keys;
mod fit;
mod keys;
mod lesson;
mod order;
mod verdict;
mod way;

pub use door::Teach;
pub use keys::{Keys, Mode, Play};
pub use lesson::{Geometry, Lesson, teach};
pub use verdict::PlayedBack;
pub use way::{Point, Way};
