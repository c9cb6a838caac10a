//! The choice of the solution that the arms carry out, and the tables for finding it.

use crate::solver::Tables;
use crate::solver::tables::Bytes;
use std::sync::LazyLock;

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
    /// The paper's rule (p. 374): Korf's search up to 16 turns, and two-phase where that takes too
    /// long.
    Paper {
        /// Tables of two-phase.
        tables: TwoPhase,
        /// Korf's tables, in the order of [`korf::TABLES`](crate::solver::korf::TABLES).
        korf: [Bytes; 3],
        /// Nodes that Korf's search may visit.
        nodes: u64,
    },
}

impl std::fmt::Debug for Strategy {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Robot { .. } => f.write_str("Robot"),
            Self::Paper { nodes, .. } => write!(f, "Paper {{ nodes: {nodes} }}"),
        }
    }
}
