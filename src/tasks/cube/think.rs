//! The long work of the cube task: colours -> cube -> turns -> steps of two hands.
//!
//! - in: 54 measured colours by position, the hold at hand, where the arms can meet
//! - out: the cube as read, the plan, or why there is none

use super::hold::{Grip, Hand, Step};
use super::plan::explain::Line;
use super::plan::{self, Reachable, Terms};
use crate::cube::{Cube, Facelets, Rotation24, Turn};
use crate::generators::position::Speeds;
use crate::reach::MeetingTable;
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
    /// Rule of the plan, and what motions cost.
    pub terms: Terms,
    /// Full speeds of the arms.
    pub speeds: Speeds,
    /// Nodes that the solver may visit.
    pub nodes: u64,
    /// Declared time of a node [s].
    pub seconds_per_node: f64,
    /// Solutions among which the regrasps choose.
    pub candidates: usize,
    /// Where the arms can meet.
    pub meetings: MeetingTable,
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
        Ok((answer, nodes)) => {
            let effort = Effort(0.2 + nodes as f64 * thought.seconds_per_node);
            (Conclusion(Ok(answer)), effort)
        }
        Err(refusal) => (Conclusion(Err(refusal)), Effort(0.2)),
    }
}

fn reason(thought: &Thought) -> Result<(Answer, u64), String> {
    let decision =
        colours::decide_cube(&thought.rgb, &Cube::is_possible).map_err(|e| e.to_string())?;
    // Named by the colours themselves, so that the words do not depend on how the cube is held.
    let read = Facelets::try_from(decision.colours).map_err(|e| e.to_string())?;
    let (named, rotation) = read.normalised().map_err(|e| e.to_string())?;
    let cube = Cube::try_from(named).map_err(|e| e.to_string())?;

    let (hand, grip) = thought.start;
    let budget = Budget { nodes: thought.nodes, max_length: 0 };
    let candidates = solver::candidates(&cube, &TABLES, &budget, thought.candidates);
    let plan = plan::plan(
        &candidates,
        (hand, grip.renamed(rotation)),
        &thought.terms,
        &Reachable::new(&thought.meetings, &thought.speeds),
    )
    .map_err(|e| e.to_string())?;
    let answer = Answer {
        identified: named.to_string(),
        rotation,
        turns: plan.turns,
        steps: plan.steps,
        lines: plan.lines,
    };
    Ok((answer, thought.nodes))
}
