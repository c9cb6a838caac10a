//! The regrasp plan: which hand holds and turns what, for the least time of both arms.
//!
//! - in: several solutions of a cube, who holds it, the rule, the reach of the cell, what motions cost
//! - out: the steps of the cheapest solution, each grasp with its reason
//! - source: the original's rule is that of Zieliński et al. (2007); the model with clearance is ours
//!
//! [`terms`] says what is allowed and what it costs, [`travel`] where the arms meet and how long they
//! take; `search` finds the cheapest episodes of one solution, [`explain`] says why. The plan is
//! chosen over many solutions: the shortest one is seldom the one that two hands make in the least
//! time.

pub mod explain;
mod planner;
mod search;
pub mod terms;
pub mod travel;

pub use planner::{Effort, Planner, taken};
pub use terms::{Costs, Depths, Rule, Terms, compatible, turnable};
pub use travel::{Everywhere, Reach, Reachable, RollLimits, Stand};

use super::hold::{Grip, Hand, Hands, Step};
use super::replay::{Illegal, replay};
use crate::cube::{Facelets, Turn};
use explain::Written;
use search::{Episode, Moves, Scratch};

/// Steps that carry out one of the solutions.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// The face turns in the order in which they are made.
    pub turns: Vec<Turn>,
    /// What the hands do.
    pub steps: Vec<Step>,
    /// How often jaws close on the cube.
    pub grasps: usize,
    /// What all steps cost (s).
    pub cost: f64,
    /// For each step who holds what, and why.
    pub lines: Vec<explain::Line>,
}

/// Why there is no plan.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NoPlan {
    /// No sequence of grasps within reach carries out any of the solutions.
    #[error("no sequence of grasps within reach carries out any of {0} solutions")]
    OutOfReach(usize),
    /// Not every face can be shown to a camera.
    #[error("no sequence of grasps within reach shows all six faces to a camera")]
    Unseen,
    /// Our own mistake: the replay found a step that must not be done.
    #[error("the plan does not stand its replay: {0}")]
    Replay(#[from] Illegal),
    /// Our own mistake: the replayed plan does not make the turns of the solution.
    #[error("the replayed plan makes other turns than the solution")]
    Unsolved,
}

/// The cheapest plan that carries out one of `candidates`, replayed and found to be right. `start` is the hand that
/// holds the cube now, alone, in the frame that the turns are named in. An empty candidate is a solved cube: then
/// the plan only brings it into the hand that is to finish.
///
/// # Errors
/// When the reach allows none.
pub fn plan(
    candidates: &[Vec<Turn>],
    start: (Hand, Grip),
    terms: &Terms,
    reach: &impl Reach,
) -> Result<Plan, NoPlan> {
    let moves = Moves::new(terms, start, reach);
    let mut best: Option<(f64, Vec<Episode>)> = None;
    let mut scratch = Scratch::default();
    for turns in candidates {
        let bound = best.as_ref().map_or(f64::INFINITY, |(cost, _)| *cost);
        best = moves.shortest(turns, bound, &mut scratch).or(best);
    }
    let (cost, episodes) = best.ok_or(NoPlan::OutOfReach(candidates.len()))?;
    let Written { turns, steps, lines } = explain::written(start, &episodes, terms, reach);
    let plan = Plan { turns, steps, grasps: episodes.len(), cost, lines };
    check(&plan, start, terms.rule)?;
    Ok(plan)
}

/// Replays a plan on a cube that its turns solve.
fn check(plan: &Plan, start: (Hand, Grip), rule: Rule) -> Result<(), NoPlan> {
    let undo = plan.turns.iter().rev().map(|t| t.inverse());
    let cube = undo.fold(Facelets::solved(), |cube, turn| cube.turned(turn));
    let (end, hands) = replay(cube, hands_at(start), &plan.steps, rule)?;
    let alone = hands.iter().flatten().count() == 1;
    if end == Facelets::solved() && alone { Ok(()) } else { Err(NoPlan::Unsolved) }
}

/// What the hands hold when one holds alone.
fn hands_at((hand, grip): (Hand, Grip)) -> Hands {
    let mut hands = [None; 2];
    hands[hand.index()] = Some(grip);
    hands
}

#[cfg(test)]
mod tests {
    use super::super::hold::Hold;
    use super::*;
    use crate::cube::{Axis, Face, parse_turns};
    use crate::motion::Depth;
    use nalgebra::UnitQuaternion;

    const RULES: [Rule; 3] = [Rule::Original, Rule::Strict, Rule::Clearance];

    fn start() -> (Hand, Grip) {
        let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::Two };
        (Hand::Track, Grip { hold, half_roll: false })
    }

    fn planned(text: &str, rule: Rule) -> Plan {
        plan(&[parse_turns(text).unwrap()], start(), &Terms::of(rule), &Everywhere).unwrap()
    }

    #[test]
    fn a_solved_cube_in_the_right_hand_needs_nothing() {
        for rule in RULES {
            let plan = planned("", rule);

            assert!(plan.steps.is_empty() && plan.turns.is_empty());
            assert_eq!((plan.grasps, plan.cost), (0, 0.0));
        }
    }

    #[test]
    fn a_solved_cube_in_the_other_hand_is_handed_over_once() {
        let terms = Terms { finish: Some(Hand::Postument), ..Terms::of(Rule::Clearance) };

        let plan = plan(&[Vec::new()], start(), &terms, &Everywhere).unwrap();

        assert_eq!(plan.grasps, 1);
        assert_eq!(plan.steps.last(), Some(&Step::Leave { hand: Hand::Track }));
    }

    #[test]
    fn who_lays_the_cube_down_reaches_over_one_layer_only() {
        let ends = |depths| {
            let terms = Terms { finish_depths: depths, ..Terms::of(Rule::Strict) };
            let plan = plan(&[parse_turns("U").unwrap()], start(), &terms, &Everywhere).unwrap();
            let last = plan.steps.iter().rev().find_map(|step| match step {
                Step::Grasp { hand: Hand::Track, hold, .. } => Some(hold.depth),
                _ => None,
            });
            // It begins over two layers.
            (plan.grasps, last.unwrap_or(Depth::Two))
        };

        assert_eq!(ends(Depths::Both), (1, Depth::Two));
        let (grasps, depth) = ends(Depths::One);
        assert!(grasps > 1 && depth == Depth::One, "{grasps}, {depth:?}");
    }

    /// Two grasps for a face beside the last one, four for the opposite one, and the changes at both ends.
    #[test]
    fn the_original_pays_twice_for_the_opposite_face() {
        let beside = planned("R U F", Rule::Original).grasps;
        let opposite = planned("R L F", Rule::Original).grasps;

        assert_eq!(opposite, beside + 2);
        assert_eq!(planned("R U F R", Rule::Original).grasps, beside + 2);
    }

    #[test]
    fn clearance_needs_fewest_grasps_and_the_original_most() {
        let text = "F' U2 R B' L2 D F2 R' U B2 L D' R2 F U' L B";
        let [original, strict, clearance] = RULES.map(|rule| planned(text, rule));

        assert!(original.grasps > strict.grasps && strict.grasps > 2 * clearance.grasps);
        for plan in [original, strict, clearance] {
            assert_eq!(plan.turns, parse_turns(text).unwrap());
            assert_eq!(plan.lines.len(), plan.steps.len());
            let seconds: f64 = plan.lines.iter().map(|l| l.seconds).sum();
            assert!((seconds - plan.cost).abs() < 1e-6, "{seconds} {}", plan.cost);
            assert!(!plan.lines.iter().any(|l| l.why.contains("as they are")), "{:#?}", plan.lines);
        }
    }

    /// What is cut off for costing too much must never be the best.
    #[test]
    fn the_best_of_many_is_the_best_of_each() {
        use crate::cube::Cube;
        use crate::solver::{Budget, Tables, candidates};
        let tables = Tables::build();
        for (seed, rule) in RULES.into_iter().cycle().take(9).enumerate() {
            let budget = Budget { nodes: 20_000, max_length: 0 };
            let list = candidates(&Cube::scrambled(seed as u64), &tables, &budget, 12);
            let terms = Terms::of(rule);
            let each = list.iter().rev().map(|turns| {
                plan(std::slice::from_ref(turns), start(), &terms, &Everywhere).unwrap().cost
            });
            let best = each.fold(f64::INFINITY, f64::min);

            for list in [list.clone(), list.into_iter().rev().collect()] {
                let together = plan(&list, start(), &terms, &Everywhere).unwrap().cost;

                assert!((together - best).abs() < 1e-9, "{rule:?} {seed}: {together} {best}");
            }
        }
    }

    #[test]
    fn turns_outside_a_wrists_range_are_not_planned() {
        struct Short;
        impl Reach for Short {
            fn grasp(&self, _: UnitQuaternion<f64>, _: UnitQuaternion<f64>) -> Option<RollLimits> {
                Some(RollLimits { track: (-0.1, 1.6), postument: (-1.0, 1.0) })
            }
            fn view(&self, _: Hand, _: usize) -> bool {
                true
            }
            fn travel(&self, from: Option<Stand>, newcomer: Hand, meeting: u8) -> f64 {
                Everywhere.travel(from, newcomer, meeting)
            }
        }
        let terms = Terms::of(Rule::Clearance);
        let plan_of =
            |text| plan(&[parse_turns(text).unwrap()], start(), &terms, &Short).map(|p| p.steps);

        let clockwise = plan_of("R U").unwrap();

        let turners: Vec<Hand> = clockwise
            .iter()
            .filter_map(|s| if let Step::Turn { turner, .. } = s { Some(*turner) } else { None })
            .collect();
        assert_eq!(turners, [Hand::Track, Hand::Track]);
        assert_eq!(plan_of("R' U"), Err(NoPlan::OutOfReach(1)));
        assert_eq!(plan_of("R2 U"), Err(NoPlan::OutOfReach(1)));
    }

    #[test]
    fn with_one_layer_only_no_new_grasp_reaches_over_two() {
        let plan = planned("F' U2 R B' L2 D", Rule::Clearance);

        assert!(plan.steps.iter().all(|s| match s {
            Step::Grasp { hold, .. } => hold.depth == Depth::One,
            _ => true,
        }));
    }

    /// Mean grasps of the rules: `cargo test --release --lib counts -- --ignored --nocapture`.
    #[test]
    #[ignore = "takes minutes: figures for the README"]
    fn counts_of_grasps_over_random_cubes() {
        use crate::cube::Cube;
        use crate::solver::{Budget, Tables, candidates};
        let tables = Tables::build();
        let best = Budget { nodes: 5_000_000, max_length: 0 };
        let lists: Vec<_> =
            (0..120).map(|seed| candidates(&Cube::scrambled(seed), &tables, &best, 480)).collect();
        let anyone = |rule| Terms { finish: None, ..Terms::of(rule) };
        let deep = Terms { depths: Depths::Both, ..anyone(Rule::Clearance) };
        let mut means = Vec::new();
        for (name, terms, count) in [
            ("original, shortest", anyone(Rule::Original), 1),
            ("original, shortest, ends in the track hand", Terms::of(Rule::Original), 1),
            ("strict, shortest", anyone(Rule::Strict), 1),
            ("strict, of 24", anyone(Rule::Strict), 24),
            ("clearance, shortest, both depths", deep, 1),
            ("clearance, of 24, both depths", deep, 24),
            ("clearance, of 480, both depths", deep, 480),
            ("clearance, shortest, one layer", anyone(Rule::Clearance), 1),
            ("clearance, of 24, one layer", anyone(Rule::Clearance), 24),
            ("clearance, of 480, one layer", anyone(Rule::Clearance), 480),
            (
                "clearance, of 480, one layer, ends in the track hand",
                Terms::of(Rule::Clearance),
                480,
            ),
        ] {
            let begin = std::time::Instant::now();
            let plans: Vec<Plan> = lists
                .iter()
                .map(|l| plan(&l[..count.min(l.len())], start(), &terms, &Everywhere).unwrap())
                .collect();
            let mean = |of: fn(&Plan) -> f64| plans.iter().map(of).sum::<f64>() / 120.0;
            let most = plans.iter().map(|p| p.grasps).max().unwrap();
            println!(
                "{name}: {:.1} turns, {:.1} grasps (most {most}), {:.0} s, planned in {:.1} ms",
                mean(|p| p.turns.len() as f64),
                mean(|p| p.grasps as f64),
                mean(|p| p.cost),
                begin.elapsed().as_secs_f64() / 0.12,
            );
            means.push(mean(|p| p.grasps as f64));
        }
        println!("candidates: {}", lists.iter().map(Vec::len).sum::<usize>() / 120);
        assert!(means[9] < 0.4 * means[0], "{means:?}");
    }
}
