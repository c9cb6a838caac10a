//! The long work of the cube task: colours -> cube -> turns -> steps of two hands.
//!
//! - in: 54 measured colours by position, the hold at hand, where the arms can meet
//! - out: the cube as read, the plan, or why there is none

use super::hold::{Grip, Hand, Step};
use super::plan::Planner;
use super::plan::explain::Line;
use super::strategy::{Strategy, TwoPhase};
use crate::cube::{Cube, Facelets, Rotation24, Turn, facelet_place};
use crate::solver::korf::Korf;
use crate::solver::optimal::{Answer as Exact, Limits};
use crate::solver::table::InTurn;
use crate::solver::tables::Bytes;
use crate::solver::{self, Budget, Solution};
use crate::tasks::Effort;
use crate::vision::colours::{self, Decision, Undecided};
use std::sync::atomic::AtomicBool;

/// The longest solution that Korf's search is asked for.
const KORF_LENGTH: u8 = 16;

/// What to think about.
#[derive(Debug, Clone)]
pub struct Thought {
    /// Measured colours, by facelet of the cube frame at acquisition.
    pub rgb: [[f64; 3]; 54],
    /// The cube's colours as the operator gave them: nothing is left to decide.
    pub given: Option<Facelets>,
    /// Who holds the cube, and how, in the same frame.
    pub start: (Hand, Grip),
    /// Which solution is carried out.
    pub strategy: Strategy,
    /// What the arms may do, and what it costs them.
    pub planner: Planner,
    /// Nodes that the solver may visit.
    pub nodes: u64,
    /// Declared time of a node (s).
    pub seconds_per_node: f64,
    /// Solutions among which the regrasps choose.
    pub candidates: usize,
}

/// The result, or the reason why there is none.
#[derive(Debug)]
pub struct Conclusion(pub Result<Answer, NoAnswer>);

/// Why there is no plan.
#[derive(Debug, Clone, PartialEq)]
pub enum NoAnswer {
    /// What was seen is no cube, or not for certain: another look may help, or the operator.
    Unread(Box<Doubt>),
    /// The cube is clear, and yet there is no plan.
    Unplanned(String),
}

/// What is not certain of a cube.
#[derive(Debug, Clone, PartialEq)]
pub struct Doubt {
    /// In words.
    pub reason: String,
    /// The likeliest colours; `None` when there is not even a guess.
    pub read: Option<Facelets>,
    /// Facelets that may have another colour.
    pub doubtful: Vec<usize>,
    /// Whether the likeliest colours make a cube that can exist.
    pub possible: bool,
}

/// A plan.
#[derive(Debug, Clone)]
pub struct Answer {
    /// 54 letters, named by the centres' colours.
    pub identified: String,
    /// How sure each facelet is, 0..=1, in the frame of acquisition.
    pub margins: [f64; 54],
    /// The colours, in the frame of acquisition.
    pub read: Facelets,
    /// Rotation from the cube frame at acquisition to the one named by the centres' colours.
    pub rotation: Rotation24,
    /// Face turns.
    pub turns: Vec<Turn>,
    /// What the hands do.
    pub steps: Vec<Step>,
    /// The same in words.
    pub lines: Vec<Line>,
    /// Time that the steps are expected to take (s).
    pub expected: f64,
}

/// Does it. A pure function: the same thought has the same conclusion and the same effort.
#[must_use]
pub fn think(thought: &Thought) -> (Conclusion, Effort) {
    match reason(thought) {
        Ok((answer, seconds)) => (Conclusion(Ok(answer)), Effort(0.2 + seconds)),
        Err(refusal) => (Conclusion(Err(refusal)), Effort(0.2)),
    }
}

/// Declared time in which the grasps of one solution are tried (s), as
/// `cargo bench --bench planner` tells it: 164 and 239 us each at 1866 and 975 solutions a cube.
const SECONDS_PER_CANDIDATE: f64 = 2e-4;

/// The plan, if what was seen is certain enough.
fn reason(thought: &Thought) -> Result<(Answer, f64), NoAnswer> {
    if let Some(given) = thought.given {
        let possible = given.normalised().and_then(|(named, _)| Cube::try_from(named));
        if let Err(reason) = possible {
            let reason = format!("this cube cannot exist: {reason}");
            let read = Some(given);
            let doubt = Doubt { reason, read, doubtful: Vec::new(), possible: false };
            return Err(NoAnswer::Unread(Box::new(doubt)));
        }
        return named(thought, *given.colours(), [1.0; 54]).map_err(NoAnswer::Unplanned);
    }
    let decision = colours::decide_cube(&thought.rgb).map_err(undecided)?;
    if let Some(doubt) = doubt(&decision) {
        return Err(NoAnswer::Unread(Box::new(doubt)));
    }
    named(thought, decision.colours, decision.margins).map_err(NoAnswer::Unplanned)
}

/// There is no decision: what is left for somebody who sees better.
fn undecided(why: Undecided) -> NoAnswer {
    let reason = why.to_string();
    let (read, doubtful) = match why {
        Undecided::Impossible { facelets, doubtful, .. } => {
            (Facelets::try_from(*facelets).ok(), doubtful)
        }
        Undecided::SameCentres { first, second, .. } => {
            (None, vec![9 * first.index() + 4, 9 * second.index() + 4])
        }
        Undecided::NotANumber(facelet) => (None, vec![facelet]),
        Undecided::NoColour => (None, Vec::new()),
    };
    NoAnswer::Unread(Box::new(Doubt { reason, read, doubtful, possible: false }))
}

/// The facelets that might have another colour.
fn doubt(decision: &Decision) -> Option<Doubt> {
    let mut doubtful = decision.doubtful.clone();
    if doubtful.is_empty() {
        return None;
    }
    doubtful.sort_unstable();
    let names: Vec<String> = doubtful.iter().map(|&i| facelet_place(i).to_string()).collect();
    let reason = format!("stickers {} are not certain", names.join(", "));
    let read = Facelets::try_from(decision.colours).ok();
    Some(Doubt { reason, read, doubtful, possible: true })
}

/// The plan for a cube of these colours, and the declared time of finding it (s).
fn named(
    thought: &Thought,
    colours: [u8; 54],
    margins: [f64; 54],
) -> Result<(Answer, f64), String> {
    // Named by the colours themselves, so that the words do not depend on how the cube is held.
    let read = Facelets::try_from(colours).map_err(|e| e.to_string())?;
    let (named, rotation) = read.normalised().map_err(|e| e.to_string())?;
    let cube = Cube::try_from(named).map_err(|e| e.to_string())?;

    let (hand, grip) = thought.start;
    let (candidates, nodes) = match &thought.strategy {
        Strategy::Robot { tables } => {
            let budget = Budget { nodes: thought.nodes, max_length: 0 };
            (solver::candidates(&cube, tables, &budget, thought.candidates), thought.nodes)
        }
        Strategy::Paper { tables, korf, nodes } => {
            let (turns, nodes) = papers_rule(&cube, tables, korf, *nodes, thought.nodes)?;
            (vec![turns], nodes)
        }
    };
    let plan = thought
        .planner
        .of(&candidates, (hand, grip.renamed(rotation)))
        .map_err(|e| e.to_string())?;
    let answer = Answer {
        identified: named.to_string(),
        margins,
        read,
        rotation,
        turns: plan.turns,
        steps: plan.steps,
        lines: plan.lines,
        expected: plan.cost,
    };
    let seconds =
        nodes as f64 * thought.seconds_per_node + candidates.len() as f64 * SECONDS_PER_CANDIDATE;
    Ok((answer, seconds))
}

/// The paper's choice of turns, and the nodes that it took.
fn papers_rule(
    cube: &Cube,
    two_phase: TwoPhase,
    korf: &[Bytes; 3],
    korf_nodes: u64,
    nodes: u64,
) -> Result<(Vec<Turn>, u64), String> {
    let korf = [0, 1, 2].map(|i| (*korf[i]).as_ref());
    let korf = Korf::new(korf).map_err(|e| e.to_string())?;
    let limits = Limits { max_length: KORF_LENGTH, max_nodes: korf_nodes };
    let exact = korf.solve(cube, limits, &InTurn, &AtomicBool::new(false));
    let two_phase = || solver::solve(cube, two_phase, &Budget { nodes, max_length: 0 });
    Ok(or_two_phase(exact, two_phase))
}

/// Korf's solution, or that of two-phase where Korf's search was given up; and the nodes of both.
fn or_two_phase(exact: Exact, two_phase: impl FnOnce() -> Solution) -> (Vec<Turn>, u64) {
    if let Some(turns) = exact.turns {
        return (turns, exact.nodes);
    }
    let found = two_phase();
    (found.turns, exact.nodes + found.nodes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::parse_turns;

    #[test]
    fn two_phase_works_only_where_korf_was_given_up() {
        let (short, long) = (parse_turns("F' U2 R'").unwrap(), parse_turns("F U R B L D").unwrap());
        let exact = Exact { turns: Some(short.clone()), at_least: 3, nodes: 50 };
        let given_up = Exact { turns: None, at_least: 14, nodes: 100 };
        let two_phase = || Solution { turns: long.clone(), nodes: 7, proven: false };

        assert_eq!(or_two_phase(exact, || unreachable!()), (short, 50));
        assert_eq!(or_two_phase(given_up, two_phase), (long, 107));
    }

    #[test]
    fn what_vision_calls_doubtful_is_doubted_by_its_name() {
        let colours = *Facelets::solved().colours();
        let mut decision =
            Decision { colours, facelets: colours, margins: [1.0; 54], doubtful: Vec::new() };
        assert_eq!(doubt(&decision), None);

        decision.doubtful = vec![12, 7];

        let doubt = doubt(&decision).unwrap();
        assert_eq!(doubt.doubtful, [7, 12]);
        assert!(doubt.reason.contains("U8, R4"), "{}", doubt.reason);
    }
}
