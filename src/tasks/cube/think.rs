//! The long work of the cube task: colours -> cube -> turns -> steps of two hands.
//!
//! - in: 54 measured colours by position, the hold at hand, where the arms can meet
//! - out: the cube as read, the plan, or why there is none

use super::hold::{Grip, Hand, Step};
use super::plan::Planner;
use super::plan::explain::Line;
use crate::cube::{Cube, Facelets, Rotation24, Turn};
use crate::solver::{self, Budget, Tables};
use crate::tasks::Effort;
use crate::vision::colours;
use std::sync::LazyLock;

/// Built once in a process: the same for every cube.
static TABLES: LazyLock<Tables> = LazyLock::new(Tables::build);

/// What to think about.
#[derive(Debug, Clone)]
pub struct Thought {
    /// Measured colours, by facelet of the cube frame at acquisition.
    pub rgb: [[f64; 3]; 54],
    /// Who holds the cube, and how, in the same frame.
    pub start: (Hand, Grip),
    /// What the arms may do, and what it costs them.
    pub planner: Planner,
    /// Nodes that the solver may visit.
    pub nodes: u64,
    /// Declared time of a node [s].
    pub seconds_per_node: f64,
    /// Solutions among which the regrasps choose.
    pub candidates: usize,
}

/// The result, or the reason why there is none.
#[derive(Debug)]
pub struct Conclusion(pub Result<Answer, String>);

/// A plan.
#[derive(Debug, Clone)]
pub struct Answer {
    /// 54 letters, named by the centres' colours.
    pub identified: String,
    /// Rotation from the cube frame at acquisition to the one named by the centres' colours.
    pub rotation: Rotation24,
    /// Face turns.
    pub turns: Vec<Turn>,
    /// What the hands do.
    pub steps: Vec<Step>,
    /// The same in words.
    pub lines: Vec<Line>,
}

/// Does it. A pure function: the same thought has the same conclusion and the same effort.
#[must_use]
pub fn think(thought: &Thought) -> (Conclusion, Effort) {
    match reason(thought) {
        Ok((answer, seconds)) => (Conclusion(Ok(answer)), Effort(0.2 + seconds)),
        Err(refusal) => (Conclusion(Err(refusal)), Effort(0.2)),
    }
}

/// Declared time in which the grasps of one solution are tried [s].
const SECONDS_PER_CANDIDATE: f64 = 4e-4;

/// The plan and the declared time of finding it [s].
fn reason(thought: &Thought) -> Result<(Answer, f64), String> {
    let decision =
        colours::decide_cube(&thought.rgb, &Cube::is_possible).map_err(|e| e.to_string())?;
    // Named by the colours themselves, so that the words do not depend on how the cube is held.
    let read = Facelets::try_from(decision.colours).map_err(|e| e.to_string())?;
    let (named, rotation) = read.normalised().map_err(|e| e.to_string())?;
    let cube = Cube::try_from(named).map_err(|e| e.to_string())?;

    let (hand, grip) = thought.start;
    let budget = Budget { nodes: thought.nodes, max_length: 0 };
    let candidates = solver::candidates(&cube, &TABLES, &budget, thought.candidates);
    let plan = thought
        .planner
        .of(&candidates, (hand, grip.renamed(rotation)))
        .map_err(|e| e.to_string())?;
    let answer = Answer {
        identified: named.to_string(),
        rotation,
        turns: plan.turns,
        steps: plan.steps,
        lines: plan.lines,
    };
    let seconds = thought.nodes as f64 * thought.seconds_per_node
        + candidates.len() as f64 * SECONDS_PER_CANDIDATE;
    Ok((answer, seconds))
}
