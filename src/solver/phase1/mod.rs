//! Phase 1: how far a cube is from the group <U, D, R2, L2, F2, B2>, and which turns lead nearer.
//!
//! The walk stands always on the representative of its class: after each turn it looks at the cube
//! through the symmetry that makes it one again, and remembers that symmetry. So a state is (class
//! of slice and flips, twist), 64430 x 2187, a turn is two reads, and what the table says of the
//! turns holds as it stands.
//!
//! Two tables know the same distances, and so lead the same walk:
//! - `Near` (36 MB): two bits a state, the distance modulo 3, and 3 for `FAR` or more. The walk
//!   knows its own distance, and a neighbour's differs by at most 1, so two bits are enough;
//!   leaving the last levels (three entries of five) unfilled halves the time to build. Two small
//!   tables, of slice and flips and of slice and twists, spare most reads.
//! - `Wide` (423 MB): three bytes a state, which say of each turn whether it leads nearer, farther
//!   or neither. The four states that turns of one face carry into each other lie within one step,
//!   so 15 cases, four bits, hold what the three turns of a face do.

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

/// The two-bit table of phase 1.
pub(crate) static NEAR: TableSpec = TableSpec {
    name: "phase1",
    version: 1,
    bytes: CLASSES * NEAR_ROW,
    purpose: "two-phase: distances modulo 3 of the first phase",
    build: fill::build_near,
    verify: fill::verify_near,
};

/// The table of phase 1 that knows what each turn does.
pub(crate) static WIDE_TABLE: TableSpec = TableSpec {
    name: "phase1-large",
    version: 1,
    bytes: CLASSES * TWISTS * WIDE,
    purpose: "two-phase, large set: what each turn does to the distance of the first phase",
    build: fill::build_wide,
    verify: fill::verify_wide,
};
