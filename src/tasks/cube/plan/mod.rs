//! The regrasp plan: the grasps and turns of two hands that solve a cube in the least time.
//!
//! - in: several solutions of a cube, the hand that holds it, the rule, the reach of the cell, the
//!   times of motions
//! - out: the steps of the cheapest solution, each grasp with its reason
//! - source: the original's rule is that of Zieliński et al. (2007); the model with clearance is
//!   own work
//!
//! [`terms`] has the allowed holds and turns and their times, [`travel`] the meetings of the arms
//! and the times between them. `search` finds the cheapest episodes of one solution, [`explain`]
//! writes them as steps with reasons, and [`replay`](super::replay) checks the result.
//!
//! The search is exact but for these heuristics and constants:
//!
//! | heuristic | place | reason |
//! |---|---|---|
//! | solutions of up to 3 turns above the least | `solver::candidates` | 13.0 grasps, not 15.6 |
//! | one configuration of the arms a state | `search::Best` | all: 20 times the states, 2 s gain |
//! | candidates are cut off by a bound | `search::Moves::tails` | it is never above the true cost |
//! | half turns roll to the side with more room | `search::rolls_within` | as in the mission |
//! | 0.12 rad of a wrist's range stay free | `travel::ROLL_MARGIN` | cubes are tilted in a hand |
//! | a path from no meeting takes the mean of all | `travel::Reachable` | it is unknown |
//! | 15 s a path where the arms are unknown | `travel::TYPICAL_SECONDS` | plans without a cell |
//! | measured parts of a grasp | [`settings`](super::settings) | speeds do not explain them |
//!
//! The numbers of the first row are means over 120 random cubes with both depths: the best of 480
//! solutions needs 13.0 grasps, the shortest one 15.6.

pub mod explain;
mod planner;
mod search;
pub mod terms;
pub mod travel;

pub use planner::{Effort, Planner, taken};
pub use terms::{Costs, Depths, Rule, Terms, compatible, turnable};
pub use travel::{ArmsAt, Everywhere, Reach, Reachable, RollLimits, Stop, of_rotations};

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
    /// Steps of the hands.
    pub steps: Vec<Step>,
    /// Number of times that jaws close on the cube.
    pub grasps: usize,
    /// Time of all steps (s).
    pub cost: f64,
    /// Description of each step: the holds, and the reason.
    pub lines: Vec<explain::Line>,
}

/// Reason why there is no plan.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NoPlan {
    /// No sequence of grasps within reach carries out any of the solutions.
    #[error("no sequence of grasps within reach carries out any of {0} solutions")]
    OutOfReach(usize),
    /// Not every face can be shown to a camera.
    #[error("no sequence of grasps within reach shows all six faces to a camera")]
    Unseen,
    /// The replay found a step that must not be done, which is a defect of the planner.
    #[error("the replay of the plan failed: {0}")]
    Replay(#[from] Illegal),
    /// The replayed plan does not make the turns of the solution, which is a defect of the planner.
    #[error("the replayed plan makes other turns than the solution")]
    Unsolved,
}

/// Finds the cheapest plan that carries out one of `candidates`, and checks it by a replay. `start`
/// is the hand that holds the cube now, alone, with its grip in the frame in which the turns are
/// named. An empty candidate is a solved cube: its plan only brings the cube into the hand that
/// must hold it at the end.
///
/// # Errors
/// When no sequence of grasps within reach carries out any candidate, or when the replay fails.
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
        // Later candidates are cut off at the cost of the best one before them.
        let bound = best.as_ref().map_or(f64::INFINITY, |(cost, _)| *cost);
        best = moves.shortest(turns, bound, &mut scratch).or(best);
    }
    let (cost, episodes) = best.ok_or(NoPlan::OutOfReach(candidates.len()))?;
    let Written { turns, steps, lines } = explain::written(start, &episodes, terms, reach);
    let plan = Plan { turns, steps, grasps: episodes.len(), cost, lines };
    check(&plan, start, terms.rule)?;
    Ok(plan)
}

/// Checks a plan by a replay on a cube that its turns solve.
fn check(plan: &Plan, start: (Hand, Grip), rule: Rule) -> Result<(), NoPlan> {
    // The cube that the turns solve is the solved one with the turns undone, last one first.
    let undo = plan.turns.iter().rev().map(|t| t.inverse());
    let cube = undo.fold(Facelets::solved(), |cube, turn| cube.turned(turn));
    let (end, hands) = replay(cube, hands_at(start), &plan.steps, rule)?;
    let alone = hands.iter().flatten().count() == 1;
    if end == Facelets::solved() && alone { Ok(()) } else { Err(NoPlan::Unsolved) }
}

/// Returns the grips of both hands when one hand alone holds the cube in this grip.
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

    /// All rules of grasping.
    const RULES: [Rule; 3] = [Rule::Original, Rule::Strict, Rule::Clearance];

    /// Returns the track hand with its palm on face D, over two layers.
    fn start() -> (Hand, Grip) {
        let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::Two };
        (Hand::Track, Grip { hold, half_roll: false })
    }

    /// Returns the plan of these turns from [`start`], for arms that reach everywhere.
    fn planned(text: &str, rule: Rule) -> Plan {
        plan(&[parse_turns(text).unwrap()], start(), &Terms::of(rule), &Everywhere).unwrap()
    }

    #[test]
    fn solved_cube_in_final_hand_needs_no_steps() {
        for rule in RULES {
            let plan = planned("", rule);

            assert!(plan.steps.is_empty() && plan.turns.is_empty());
            assert_eq!((plan.grasps, plan.cost), (0, 0.0));
        }
    }

    #[test]
    fn solved_cube_is_handed_to_final_hand() {
        let terms = Terms { finish: Some(Hand::Postument), ..Terms::of(Rule::Clearance) };

        let plan = plan(&[Vec::new()], start(), &terms, &Everywhere).unwrap();

        assert_eq!(plan.grasps, 1);
        assert_eq!(plan.steps.last(), Some(&Step::Leave { hand: Hand::Track }));
    }

    /// A hand that lays the cube down reaches over one layer only.
    #[test]
    fn final_grasp_for_table_covers_only_one_layer() {
        let ends = |depths| {
            let terms = Terms { finish_depths: depths, ..Terms::of(Rule::Strict) };
            let plan = plan(&[parse_turns("U").unwrap()], start(), &terms, &Everywhere).unwrap();
            let last = plan.steps.iter().rev().find_map(|step| match step {
                Step::Grasp { hand: Hand::Track, hold, .. } => Some(hold.depth),
                _ => None,
            });
            // The cube begins in a hand that reaches over two layers.
            (plan.grasps, last.unwrap_or(Depth::Two))
        };

        assert_eq!(ends(Depths::Both), (1, Depth::Two));
        let (grasps, depth) = ends(Depths::One);
        assert!(grasps > 1 && depth == Depth::One, "{grasps}, {depth:?}");
    }

    /// By the original rule a turn of a face beside the last one costs two grasps, and one of the
    /// opposite face four. The grasps at both ends of the plan are added to these.
    #[test]
    fn original_rule_needs_four_grasps_for_opposite_face() {
        let beside = planned("R U F", Rule::Original).grasps;
        let opposite = planned("R L F", Rule::Original).grasps;

        assert_eq!(opposite, beside + 2);
        assert_eq!(planned("R U F R", Rule::Original).grasps, beside + 2);
    }

    #[test]
    fn clearance_rule_needs_fewest_grasps_original_rule_most() {
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

    /// The plan of many candidates is the cheapest plan of any one of them, in whatever order they
    /// are listed.
    #[test]
    fn planner_picks_cheapest_of_many_candidate_solutions() {
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
    fn plan_keeps_turns_in_wrist_range() {
        /// Arms whose wrists have too little range for some turns.
        struct Short;
        impl Reach for Short {
            fn grasp(&self, _: UnitQuaternion<f64>, _: UnitQuaternion<f64>) -> Option<RollLimits> {
                Some(RollLimits { track: (-0.1, 1.6), postument: (-1.0, 1.0) })
            }
            fn view(&self, _: Hand, _: usize) -> bool {
                true
            }
            fn travel(&self, from: Option<ArmsAt>, newcomer: Hand, meeting: u8) -> f64 {
                Everywhere.travel(from, newcomer, meeting)
            }
            fn path(&self, from: Option<Stop>, to: Stop, newcomer: Hand) -> f64 {
                Everywhere.path(from, to, newcomer)
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
    fn clearance_rule_plans_only_one_layer_grasps() {
        let plan = planned("F' U2 R B' L2 D", Rule::Clearance);

        assert!(plan.steps.iter().all(|s| match s {
            Step::Grasp { hold, .. } => hold.depth == Depth::One,
            _ => true,
        }));
    }

    /// Prints the mean number of grasps by each rule: `cargo test --release --lib over_random_cubes
    /// -- --ignored --nocapture`.
    #[test]
    #[ignore = "takes minutes: figures for the README"]
    fn clearance_rule_saves_grasps_over_random_cubes() {
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
