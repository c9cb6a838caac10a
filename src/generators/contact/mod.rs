//! Motions in contact: guarded move, contour, guidance by hand, and carrying with another arm.
//!
//! - in: the order of a motion; the wrench and the pose of the tool at each macrostep
//! - out: velocities and forces of a task motion, until contact, a length, rest or MP ends it
//!
//! | generator | name | ends |
//! |---|---|---|
//! | [`Guarded`] | `guarded` | at a force, or after a distance |
//! | [`Contour`] | `contour` | after a length, or when the contact is lost |
//! | [`Guide`] | `guide` | after a rest, or by MP |
//! | [`Carry`] | `carry_line`, `_arc`, `_spline`, `_polyline` | at the end of its path |

mod carry;
mod contour;
mod guarded;
mod guide;
#[cfg(test)]
mod testing;

pub use carry::{Carry, CarryOrder};
pub use contour::{Contour, ContourOrder, Followed};
pub use guarded::{Guarded, GuardedOrder};
pub use guide::{Guide, GuideOrder, Guided};
