//! Motions along a given path: line, circular arc, splines, and polylines with rounded corners.
//!
//! - in: the order of a path; the pace of each macrostep
//! - out: set values along the path, within bounds of speed, acceleration and jerk
//!
//! A path is a [`Curve`]: places as a function of a parameter, and bounds of its derivatives. The
//! [`Law`] moves the parameter, and [`Along`] is the generator of both. A curve of a user's own
//! needs a type that implements [`PathOrder`].
//!
//! | order | name | path |
//! |---|---|---|
//! | [`Line`] | `line` | straight, tool turns about one axis |
//! | [`Arc`] | `arc` | circle through a point, tool turns about one axis |
//! | [`Spline`] | `spline` | through poses, twice continuously differentiable |
//! | [`Polyline`] | `polyline` | straight between poses, corners rounded within a radius |
//! | [`JointSpline`] | `joint_spline` | as the spline, of joint positions |
//! | [`JointPolyline`] | `joint_polyline` | as the polyline, of joint positions |

mod along;
mod arc;
mod cartesian;
mod curve;
mod joints;
mod law;
mod limits;
mod polynomial;
#[cfg(test)]
mod tests;

pub use along::{Along, PathOrder};
pub(super) use along::{advance, pauses, places};
pub use arc::Arc;
pub use cartesian::{Line, Polyline, Spline};
pub use curve::{Cell, Curve, Demand};
pub use joints::{JointPolyline, JointSpline};
pub use law::Law;
pub use limits::{Limit, Limits};
pub use polynomial::Polynomial;
