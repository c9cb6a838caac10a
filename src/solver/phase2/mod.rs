//! Phase 2: lower bounds on the distance of a cube of the group <U, D, R2, L2, F2, B2> from the
//! solved cube.
//!
//! A state is the order of the corners, the places of the four upper and of the four lower edges
//! among eight places, and the order of the middle edges. No table has all of these. The greatest
//! of the distances in several tables is a lower bound:
//!
//! | table | states | entry |
//! |---|---|---|
//! | corners and upper edges; corners and lower edges | 67.7 million each | a byte |
//! | corners and middle edges | 0.97 million | a byte |
//! | large set: corners and all eight edges | 1626 million | four bits |
//!
//! Symmetries reduce the 40320 orders of the corners to 2768 classes in all tables but the second.

use super::coordinates::PERMUTATIONS;
use super::table::TableSpec;
use orders::CORNER_CLASSES;

mod bounds;
mod fill;
mod orders;

pub(super) use bounds::Bounds;
pub(super) use fill::build;
pub(crate) use orders::Orders;
pub(super) use orders::{Quads, State};

/// Bounds from the corners and four edges, a byte a state.
pub(crate) static BOUNDS: TableSpec = TableSpec {
    name: "phase2",
    version: 2,
    bytes: bounds::BYTES,
    purpose: "two-phase: bounds of the second phase",
    build: |workers, progress| build(&Orders::build(), workers, progress),
    verify: fill::verify,
};

/// Distances of the corners with all eight upper and lower edges, four bits a state.
pub(crate) static EIGHT: TableSpec = TableSpec {
    name: "phase2-large",
    version: 1,
    bytes: CORNER_CLASSES * PERMUTATIONS / 2,
    purpose: "two-phase, large set: distances of corners with eight edges in the second phase",
    build: fill::build_eight,
    verify: fill::verify_eight,
};
