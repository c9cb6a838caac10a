//! Which solution of a cube is carried out, and the tables for finding it.

use crate::solver::Tables;
use crate::solver::tables::Bytes;
use std::sync::LazyLock;

/// The tables of two-phase, had from wherever they are kept when a cube first needs them. They are the default set: what
/// a search finds, and how long it is declared to take, must not depend on what else was kept.
pub type TwoPhase = &'static LazyLock<Tables>;

/// Which solution of the cube is carried out.
#[derive(Clone)]
pub enum Strategy {
    /// Of many that two-phase finds, the one that takes two arms the least time.
    Robot {
        /// Of two-phase.
        tables: TwoPhase,
    },
    /// The paper's (p. 374): Korf's search up to 16 turns, and two-phase where that takes too long.
    Paper {
        /// Of two-phase.
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
