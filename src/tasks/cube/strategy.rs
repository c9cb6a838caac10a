//! The choice of the solution that the arms carry out, and the tables for finding it.

use crate::cube::Cube;
use crate::solver::Tables;
use crate::solver::korf::Korf;
use crate::solver::optimal::{Answer, Limits, Optimal};
use crate::solver::table::InTurn;
use crate::solver::tables::Bytes;
use std::fmt;
use std::sync::LazyLock;
use std::sync::atomic::AtomicBool;

/// The tables of two-phase, loaded or built when a cube first needs them. They are the default set:
/// the solutions that a search finds, and its declared time, must not depend on which other tables
/// are on the disk.
pub type TwoPhase = &'static LazyLock<Tables>;

/// Rule by which one of the cube's solutions is chosen.
#[derive(Clone)]
pub enum Strategy {
    /// The one of many two-phase solutions that takes the two arms the least time.
    Robot {
        /// Tables of two-phase.
        tables: TwoPhase,
    },
    /// The paper's rule (p. 374): a shortest solution of at most 16 turns, and otherwise two-phase.
    Paper {
        /// Tables of two-phase.
        tables: TwoPhase,
        /// Search that decides whether 16 turns suffice.
        exact: Exact,
    },
}

/// Search for shortest solutions by which the paper's rule decides.
#[derive(Clone)]
pub enum Exact {
    /// The search with one large table, which decides each cube.
    Table(Bytes),
    /// Korf's search, as in 2007, within a budget that most cubes exceed.
    Korf {
        /// Korf's tables, in the order of [`korf::TABLES`](crate::solver::korf::TABLES).
        tables: [Bytes; 3],
        /// Nodes that the search may visit.
        nodes: u64,
    },
}

impl Exact {
    /// Searches for a shortest solution of at most `max_length` turns. The answer is a function of
    /// the inputs: one thread searches, and nothing stops it from outside.
    ///
    /// # Errors
    /// If a table has the wrong size.
    pub fn solve(&self, cube: &Cube, max_length: u8) -> Result<Answer, String> {
        let run = AtomicBool::new(false);
        match self {
            Self::Table(table) => {
                let search = Optimal::new((**table).as_ref()).map_err(|why| why.to_string())?;
                let limits = Limits { max_length, max_nodes: u64::MAX };
                Ok(search.solve(cube, limits, &InTurn, &run))
            }
            Self::Korf { tables, nodes } => {
                let tables = tables.each_ref().map(|table| (**table).as_ref());
                let search = Korf::new(tables).map_err(|why| why.to_string())?;
                let limits = Limits { max_length, max_nodes: *nodes };
                Ok(search.solve(cube, limits, &InTurn, &run))
            }
        }
    }
}

impl fmt::Debug for Strategy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Robot { .. } => f.write_str("Robot"),
            Self::Paper { exact, .. } => write!(f, "Paper {{ exact: {exact:?} }}"),
        }
    }
}

impl fmt::Debug for Exact {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Table(_) => f.write_str("Table"),
            Self::Korf { nodes, .. } => write!(f, "Korf {{ nodes: {nodes} }}"),
        }
    }
}
