//! Solvers of Rubik's cube: Kociemba's two-phase algorithm, and searches for shortest solutions.
//!
//! - in: a [`Cube`](crate::cube::Cube), which can always be solved, [`Tables`], a [`Budget`] of
//!   nodes
//! - out: turns; they are equal on every machine because the budget counts nodes, not time
//! - source: H. Kociemba, <http://kociemba.org/cube.htm>; phase 1 leads into the group
//!   <U, D, R2, L2, F2, B2>, phase 2 solves within it
//!
//! ```
//! use rubik_robot_solver::cube::{Cube, format_turns, parse_turns};
//! use rubik_robot_solver::{Budget, Tables, solve};
//!
//! let tables = Tables::build();
//! let cube = Cube::SOLVED.apply_all(&parse_turns("R U F2")?);
//!
//! let solution = solve(&cube, &tables, &Budget { nodes: 100_000, max_length: 0 });
//!
//! assert_eq!(format_turns(&solution.turns), "F2 U' R'");
//! assert!(solution.proven);
//! # Ok::<(), rubik_robot_solver::cube::ParseTurns>(())
//! ```
//!
//! | module | purpose |
//! |---|---|
//! | `coordinates` | numbers of the features of a cube that each phase solves |
//! | `symmetry` | 16 symmetries, which make the table of phase 1 smaller |
//! | `phase1`, `phase2` | distance of each state from the goal of its phase |
//! | [`tables`] | the pruning tables of both phases |
//! | `search`, `views` | the two-phase search, along three axes and of cube and inverse |
//! | [`candidates()`] | many solutions of one cube |
//! | [`optimal`] | shortest solutions with proof |
//! | [`shortest`] | the two-phase and the optimal search together |
//! | [`korf`] | the search that the robot of 2007 used |

pub use rubik_robot_vocabulary::cube;

mod candidates;
mod coordinates;
pub mod korf;
pub mod optimal;
mod phase1;
mod phase2;
mod search;
pub mod shortest;
mod symmetry;
pub mod table;
pub mod tables;
mod views;

pub use candidates::candidates;
pub use search::{Budget, Solution, Watch, solve, solve_watched};
pub use tables::Tables;

/// Returns the descriptions of the tables of all solvers, the quickest to build first.
#[must_use]
pub fn all_tables() -> Vec<&'static table::TableSpec> {
    // Small before large: a user who waits for `tables build` can solve cubes after one second.
    let two_phase = [&phase2::BOUNDS, &phase1::NEAR, &phase2::EIGHT, &phase1::WIDE_TABLE];
    two_phase.into_iter().chain(&korf::TABLES).chain(&optimal::TABLES).collect()
}

/// The examples of the crate's README, which run as tests.
#[cfg(doctest)]
#[doc = include_str!("README.md")]
struct Readme;
