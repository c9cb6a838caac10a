//! The long work of the cube task: colours -> cube -> turns -> steps of two hands.
//!
//! - in: 54 measured colours by position, the hold of the hand that has the cube, where the arms
//!   can meet
//! - out: the cube as read and the plan, or the reason why there is none

use super::hold::{Grip, Hand, Step};
use super::plan::Planner;
use super::plan::explain::Line;
use super::strategy::{Exact, Strategy};
use crate::cube::{Cube, Facelets, Rotation24, Turn, facelet_place};
use crate::kernel::{self, Effort};
use crate::solver::optimal::Answer as Shortest;
use crate::solver::{self, Budget, Solution, Tables};
use crate::vision::colours::{self, Decision, Undecided};

/// Longest solution that the paper's rule wants as a shortest one (p. 374; turns).
const EXACT_LENGTH: u8 = 16;

/// Input of the long work.
#[derive(Debug, Clone)]
pub struct Thought {
    /// Measured colours, by facelet of the cube frame at acquisition.
    pub rgb: [[f64; 3]; 54],
    /// The cube's colours, if the operator has given them; the measured ones are not used then.
    pub given: Option<Facelets>,
    /// The hand that holds the cube and its grip, in the same frame.
    pub start: (Hand, Grip),
    /// Rule by which the solution is chosen.
    pub strategy: Strategy,
    /// Planner of the two arms: their reach, and what motions cost.
    pub planner: Planner,
    /// Number of nodes that the solver may visit.
    pub nodes: u64,
    /// Declared time of a node (s).
    pub seconds_per_node: f64,
    /// Largest number of solutions among which the planner chooses.
    pub candidates: usize,
}

/// The plan, or the reason why there is none.
#[derive(Debug)]
pub struct Conclusion(pub Result<Answer, NoAnswer>);

/// Reason why there is no plan.
#[derive(Debug, Clone, PartialEq)]
pub enum NoAnswer {
    /// The colours make no cube, or are not certain. Another look may help, or the operator.
    Unread(Box<Doubt>),
    /// The colours are certain, and yet there is no plan.
    Unplanned(String),
}

/// The uncertainty of a reading.
#[derive(Debug, Clone, PartialEq)]
pub struct Doubt {
    /// Description of the uncertainty.
    pub reason: String,
    /// The likeliest colours; `None` when vision has no guess.
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
    /// Confidence of each facelet, 0..=1, in the frame of acquisition.
    pub margins: [f64; 54],
    /// The colours, in the frame of acquisition.
    pub read: Facelets,
    /// Rotation from the cube frame at acquisition to the one named by the centres' colours.
    pub rotation: Rotation24,
    /// Face turns of the solution.
    pub turns: Vec<Turn>,
    /// Steps of the hands.
    pub steps: Vec<Step>,
    /// Description of each step.
    pub lines: Vec<Line>,
    /// Time that the steps are expected to take (s).
    pub expected: f64,
    /// Note on the length of the solution, if the strategy has a rule about it.
    pub remark: Option<String>,
}

impl kernel::Thought for Thought {
    type Conclusion = Conclusion;

    fn think(self) -> (Conclusion, Effort) {
        think(&self)
    }
}

/// Decides the colours, solves the cube and plans the regrasps. It is a pure function: equal
/// thoughts have equal conclusions and equal efforts.
#[must_use]
pub fn think(thought: &Thought) -> (Conclusion, Effort) {
    // Each thought is declared to take 0.2 s, and more only where a solution was searched for.
    match conclude(thought) {
        Ok((answer, seconds)) => (Conclusion(Ok(answer)), Effort(0.2 + seconds)),
        Err(refusal) => (Conclusion(Err(refusal)), Effort(0.2)),
    }
}

/// Declared time of trying one solution (s). `cargo bench --bench planner` measures 164 and 239 us
/// each at 1866 and 975 solutions a cube.
const SECONDS_PER_CANDIDATE: f64 = 2e-4;

/// Returns the plan and the declared time of finding it (s), or the reason why there is none:
/// doubtful colours, or no plan for certain ones.
fn conclude(thought: &Thought) -> Result<(Answer, f64), NoAnswer> {
    if let Some(given) = thought.given {
        // The operator's colours need no margins, but they may still make an impossible cube.
        let possible = given.normalised().and_then(|(named, _)| Cube::try_from(named));
        if let Err(reason) = possible {
            let reason = format!("this cube cannot exist: {reason}");
            let read = Some(given);
            let doubt = Doubt { reason, read, doubtful: Vec::new(), possible: false };
            return Err(NoAnswer::Unread(Box::new(doubt)));
        }
        return plan_for(thought, *given.colours(), [1.0; 54]).map_err(NoAnswer::Unplanned);
    }
    let decision = colours::decide_cube(&thought.rgb).map_err(undecided)?;
    if let Some(doubt) = doubt(&decision) {
        return Err(NoAnswer::Unread(Box::new(doubt)));
    }
    plan_for(thought, decision.colours, decision.margins).map_err(NoAnswer::Unplanned)
}

/// Makes a doubt from the reason why vision could not decide the colours. Another look or the
/// operator resolves it.
fn undecided(why: Undecided) -> NoAnswer {
    let reason = why.to_string();
    let (read, doubtful) = match why {
        // Each reason comes with the facelets that a second look should read again.
        Undecided::Impossible { facelets, doubtful, .. } => {
            (Facelets::try_from(*facelets).ok(), doubtful)
        }
        Undecided::SameCentres { first, second, .. } => {
            // Two centres of one colour: at least one of them is misread. Without centres no other
            // facelet has a name.
            (None, vec![9 * first.index() + 4, 9 * second.index() + 4])
        }
        // A defect of one reading: that facelet alone.
        Undecided::NotANumber(facelet) => (None, vec![facelet]),
        // Pictures in black and white, or in other places than the camera's: every facelet is
        // equally unknown.
        Undecided::NoColour | Undecided::Misplaced { .. } | Undecided::Misfit { .. } => {
            (None, Vec::new())
        }
    };
    NoAnswer::Unread(Box::new(Doubt { reason, read, doubtful, possible: false }))
}

/// Returns a doubt about the facelets whose colours vision calls uncertain, if there are any.
fn doubt(decision: &Decision) -> Option<Doubt> {
    let mut doubtful = decision.doubtful.clone();
    if doubtful.is_empty() {
        return None;
    }
    // By position, so that the message reads in the order of the faces.
    doubtful.sort_unstable();
    let names: Vec<String> = doubtful.iter().map(|&i| facelet_place(i).to_string()).collect();
    let reason = format!("stickers {} are not certain", names.join(", "));
    let read = Facelets::try_from(decision.colours).ok();
    Some(Doubt { reason, read, doubtful, possible: true })
}

/// Returns the plan for a cube of these colours, and the declared time of finding it (s).
fn plan_for(
    thought: &Thought,
    colours: [u8; 54],
    margins: [f64; 54],
) -> Result<(Answer, f64), String> {
    // Faces are named by their centres' colours, so that the words do not depend on how the cube is
    // held.
    let read = Facelets::try_from(colours).map_err(|e| e.to_string())?;
    let (named, rotation) = read.normalised().map_err(|e| e.to_string())?;
    let cube = Cube::try_from(named).map_err(|e| e.to_string())?;

    let (hand, grip) = thought.start;
    let (candidates, nodes, remark) = match &thought.strategy {
        Strategy::Robot { tables } => {
            // `candidates` reports no count of nodes, so the whole budget is declared as searched.
            let budget = Budget { nodes: thought.nodes, max_length: 0 };
            (solver::candidates(&cube, tables, &budget, thought.candidates), thought.nodes, None)
        }
        Strategy::Paper { tables, exact } => {
            // One solution only: the paper chooses by its length, not by what the hands do with it.
            let Ruled { turns, nodes, remark } = papers_rule(&cube, tables, exact, thought.nodes)?;
            (vec![turns], nodes, Some(remark))
        }
    };
    // The solver's turns are in the frame of the colours' names, and so must the grip be.
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
        remark,
    };
    // A declared time, not a measured one: the virtual clock must not depend on the machine.
    let seconds =
        nodes as f64 * thought.seconds_per_node + candidates.len() as f64 * SECONDS_PER_CANDIDATE;
    Ok((answer, seconds))
}

/// Solution by the paper's rule.
#[derive(Debug, PartialEq)]
struct Ruled {
    turns: Vec<Turn>,
    /// Number of nodes that both searches visited.
    nodes: u64,
    /// Branch of the rule that was taken, in words.
    remark: String,
}

/// Returns the solution that the paper would take: a shortest one of at most [`EXACT_LENGTH`] turns
/// if the cube has one, or else that of the two-phase search within `nodes`.
fn papers_rule(cube: &Cube, tables: &Tables, exact: &Exact, nodes: u64) -> Result<Ruled, String> {
    let shortest = exact.solve(cube, EXACT_LENGTH)?;
    let two_phase = || solver::solve(cube, tables, &Budget { nodes, max_length: 0 });
    Ok(or_two_phase(shortest, two_phase))
}

/// Returns the solution of `shortest`, or that of the two-phase search if there is none.
fn or_two_phase(shortest: Shortest, two_phase: impl FnOnce() -> Solution) -> Ruled {
    if let Some(turns) = shortest.turns {
        let remark = format!("the solution of {} turns is a shortest one", turns.len());
        return Ruled { turns, nodes: shortest.nodes, remark };
    }
    let found = two_phase();
    let length = found.turns.len();
    let remark = if shortest.at_least > EXACT_LENGTH {
        format!("no solution of {EXACT_LENGTH} turns exists: two-phase found one of {length}")
    } else {
        // A search that gave up has excluded the lengths below its bound only.
        format!(
            "the search for a shortest solution gave up within its budget at {} turns, not at \
             {EXACT_LENGTH}: two-phase found one of {length}; planner.exact = \"table\" decides it",
            shortest.at_least
        )
    };
    Ruled { turns: found.turns, nodes: shortest.nodes + found.nodes, remark }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::parse_turns;
    use crate::solver::optimal::TABLES;
    use crate::tables::Threads;
    use std::sync::Arc;

    #[test]
    fn remark_tells_proof_from_exhausted_budget() {
        let (short, long) = (parse_turns("F' U2 R'").unwrap(), parse_turns("F U R B L D").unwrap());
        let shortest = Shortest { turns: Some(short.clone()), at_least: 3, nodes: 50 };
        let excluded = Shortest { turns: None, at_least: 17, nodes: 100 };
        let given_up = Shortest { turns: None, at_least: 14, nodes: 100 };
        let two_phase = || Solution { turns: long.clone(), nodes: 7, proven: false };

        let ruled = or_two_phase(shortest, || unreachable!());
        assert_eq!((ruled.turns, ruled.nodes), (short, 50));
        let ruled = or_two_phase(excluded, two_phase);
        assert_eq!((ruled.turns, ruled.nodes), (long.clone(), 107));
        assert!(ruled.remark.starts_with("no solution of 16 turns exists"), "{}", ruled.remark);
        let ruled = or_two_phase(given_up, two_phase);
        assert_eq!((ruled.turns, ruled.nodes), (long, 107));
        assert!(ruled.remark.contains("gave up within its budget at 14"), "{}", ruled.remark);
    }

    /// Takes 20 s on two cores and 1 GB: `cargo test --lib think -- --ignored`. The lengths of the
    /// cubes are those of the tests of `solver::optimal`.
    #[test]
    #[ignore = "makes the table for shortest solutions"]
    fn papers_rule_is_exact_to_sixteen_turns() {
        let table = Exact::Table(Arc::new((TABLES[0].build)(&Threads::all(), &|_| ())));
        let tables = Tables::build();
        let ruled = |text: &str| {
            let cube = Cube::SOLVED.apply_all(&parse_turns(text).unwrap());
            let ruled = papers_rule(&cube, &tables, &table, 100_000).unwrap();
            assert!(cube.apply_all(&ruled.turns).is_solved());
            ruled
        };

        // Sixteen turns suffice: the solution is as short as possible, in this case sixteen.
        let sixteen = ruled("U' D F2 U2 R F' R' U' D2 F' U B R D F R'");
        assert_eq!(sixteen.turns.len(), 16);
        assert!(sixteen.remark.ends_with("is a shortest one"), "{}", sixteen.remark);
        assert_eq!(ruled("R U R' U R U2 R' L2 D2 L2").turns.len(), 10);
        // Sixteen do not: the two-phase search takes over.
        let seventeen = ruled("B' D' R' D F' R' F2 R2 D2 B2 D' B L U R D' B2");
        assert!(seventeen.turns.len() >= 17);
        assert!(seventeen.remark.starts_with("no solution of 16"), "{}", seventeen.remark);
    }

    #[test]
    fn doubt_reason_names_uncertain_stickers_in_face_order() {
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
