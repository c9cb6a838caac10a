//! From a cube to the turns that solve it: Kociemba's two-phase algorithm.
//!
//! - in: a [`Cube`](crate::cube::Cube), which can always be solved, [`Tables`], a [`Budget`] in nodes
//! - out: turns, the same on every machine: the budget counts nodes, not time
//! - source: H. Kociemba, <http://kociemba.org/cube.htm>; phase 1 leads into the group <U, D, R2, L2, F2, B2>,
//!   phase 2 solves within it
//!
//! [`coordinates`] numbers what each phase looks at, [`symmetry`] folds it by 16, [`tables`] knows how far each
//! state is from its goal, [`search`] walks.

pub mod coordinates;
pub mod optimal;
pub mod search;
pub mod symmetry;
pub mod table;
pub mod tables;

pub use search::{Budget, Solution, candidates, solve};
pub use tables::Tables;
