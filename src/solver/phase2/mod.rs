//! Phase 2: how far a cube of the group <U, D, R2, L2, F2, B2> is from solved.
//!
//! A state is the order of the corners, where the four upper and the four lower edges are among
//! eight places, and the order of the middle ones. No table knows all; the farthest of three is a
//! bound from below: corners with the upper edges, corners with the lower ones (67.7 million states
//! each, folded by 16 symmetries: 2768 classes of corners), and corners with the middle edges. The
//! large set knows corners with all eight edges (1626 million).

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

/// The tables of phase 2, a byte a state.
pub(crate) static BOUNDS: TableSpec = TableSpec {
    name: "phase2",
    version: 2,
    bytes: bounds::BYTES,
    purpose: "two-phase: bounds of the second phase",
    build: |workers, progress| build(&Orders::build(), workers, progress),
    verify: fill::verify,
};

/// Corners with all eight upper and lower edges, four bits a state.
pub(crate) static EIGHT: TableSpec = TableSpec {
    name: "phase2-large",
    version: 1,
    bytes: CORNER_CLASSES * PERMUTATIONS / 2,
    purpose: "two-phase, large set: distances of corners with eight edges in the second phase",
    build: fill::build_eight,
    verify: fill::verify_eight,
};
