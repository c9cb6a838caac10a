//! Phase 1: distances of cubes from the group <U, D, R2, L2, F2, B2>, and the turns that lead
//! nearer.
//!
//! A slice is the set of places of the four middle-layer edges; flip and twist are the states of
//! all flips and twists. Symmetric pairs (slice, flip) form a class. The search always works on the
//! representative of a class. After each turn it applies the symmetry that makes the state a
//! representative again, and remembers that symmetry. A state therefore is (class of slice and
//! flip, twist), 64430 x 2187 states; a turn takes two reads; and the entry of a state describes
//! its turns without a conversion.
//!
//! Two tables hold the same distances, so the search visits the same states with either:
//!
//! - `Near` (36 MB) has two bits a state: the distance modulo 3, or 3 for `FAR` and more. Two bits
//!   suffice because the search knows the distance of its state, and that of a neighbour differs by
//!   at most 1. The last levels, three entries of five, stay unfilled, which halves the time to
//!   build. Two small tables, of slice and flips and of slice and twists, save most reads.
//! - `Wide` (423 MB) has three bytes a state: for each turn nearer, farther or neither. So no
//!   neighbour is read only to be rejected. The four states that turns of one face exchange lie
//!   within one step of each other, so 15 cases (four bits) describe the three turns of a face.

use super::coordinates::TWISTS;
use super::symmetry::CLASSES;
use super::table::TableSpec;
use guide::{NEAR_ROW, WIDE};

mod faces;
mod fill;
mod frames;
mod guide;

pub(super) use faces::ALL_TURNS;
pub(crate) use faces::{FaceCases, Small};
pub(super) use fill::{compare, near};
pub(crate) use frames::Frames;
pub(super) use frames::Place;
pub(super) use guide::{Child, FAR, Guide, Near, Wide};

/// Table of phase 1 with two bits a state.
pub(crate) static NEAR: TableSpec = TableSpec {
    name: "phase1",
    version: 1,
    bytes: CLASSES * NEAR_ROW,
    purpose: "two-phase: distances modulo 3 of the first phase",
    build: fill::build_near,
    verify: fill::verify_near,
};

/// Table of phase 1 with the effect of each turn.
pub(crate) static WIDE_TABLE: TableSpec = TableSpec {
    name: "phase1-large",
    version: 1,
    bytes: CLASSES * TWISTS * WIDE,
    purpose: "two-phase, large set: change of the distance of the first phase by each turn",
    build: fill::build_wide,
    verify: fill::verify_wide,
};
