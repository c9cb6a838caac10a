//! The library of the generators of this crate that tasks order by name.
//!
//! - in: nothing
//! - out: the [`Library`] to which a program adds its own generators

use super::contact::{Carry, Contour, Guarded, Guide};
use super::follow::Follow;
use super::own::Library;
use super::paths::{Along, Arc, JointPolyline, JointSpline, Line, Polyline, Spline};

/// Returns the library with the generators of this crate.
#[must_use]
pub fn library() -> Library {
    Library::default()
        .with::<Along<Line>>("line")
        .with::<Along<Arc>>("arc")
        .with::<Along<Spline>>("spline")
        .with::<Along<Polyline>>("polyline")
        .with::<Along<JointSpline>>("joint_spline")
        .with::<Along<JointPolyline>>("joint_polyline")
        .with::<Guarded>("guarded")
        .with::<Contour>("contour")
        .with::<Guide>("guide")
        .with::<Follow>("follow")
        .with::<Carry<Line>>("carry_line")
        .with::<Carry<Arc>>("carry_arc")
        .with::<Carry<Spline>>("carry_spline")
        .with::<Carry<Polyline>>("carry_polyline")
}
