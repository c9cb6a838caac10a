//! The keys of the cube tasks, in the sections `[planner]` and `[face_turn]` of a scenario.

use crate::scenario::section::{section, words};

words! {
    /// Rule by which regrasps are planned.
    pub Rule {
        /// Palms keep a distance from the cube, so a finger may lie on the face under the other
        /// palm.
        Clearance = "clearance",
        /// Palms press the cube, so no finger may lie on the face under a palm.
        Strict = "strict",
        /// The two operations of the original, face turn and face change.
        Original = "original",
    }
}

words! {
    /// Choice among the solutions of the cube.
    pub Strategy {
        /// The solution that takes two arms the least time, among many of the two-phase search.
        Robot = "robot",
        /// The paper's rule: a shortest solution if it has at most 16 turns, otherwise one of the
        /// two-phase search.
        Paper = "paper",
    }
}

words! {
    /// Search for the shortest solutions of strategy "paper".
    pub Exact {
        /// The table "optimal-small" (317 MB, made within 20 s at the first use): decides each
        /// cube, in about 2 s.
        Table = "table",
        /// Korf's three tables, as in 2007: gives up where `korf_node_budget` ends, mostly at 14
        /// turns.
        Korf = "korf",
    }
}

section! {
    /// Solver and regrasp planner.
    pub Planner {
        /// Rule by which regrasps are planned.
        rule: Rule = Rule::Clearance;
        /// Choice among the solutions of the cube.
        strategy: Strategy = Strategy::Robot;
        /// Search that decides whether 16 turns suffice (strategy "paper").
        exact: Exact = Exact::Table;
        /// Number of nodes that Korf's search may visit before two-phase takes over (`exact`
        /// "korf").
        korf_node_budget: u64 = 20_000_000, 0.0..=1e12;
        /// Number of nodes that the two-phase search may visit.
        node_budget: u64 = 1_000_000, 1000.0..=1e12;
        // Plans of 30 cubes are 3 s shorter in the mean with 10000 than with 1500.
        /// Number of solutions whose regrasps are compared.
        candidates: u32 = 10000, 1.0..=100000.0;
        /// Declared time of one node on the virtual clock.
        node_cost [us]: f64 = 0.1, 0.0..=1000.0;
    }
}

section! {
    /// Task `face_turn`.
    pub FaceTurn {
        /// Angle by which the layer turns; positive is clockwise seen from outside.
        angle [deg]: f64 = 90.0, -180.0..=180.0;
    }
}
