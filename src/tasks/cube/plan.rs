//! The regrasp plan: which hand holds and turns what, for the least time of both arms.
//!
//! - in: several solutions of a cube, who holds it, the rule, the reach of the cell, what motions cost
//! - out: the steps of the cheapest solution, each grasp with its reason
//! - source: the original's rule is that of Zieliński et al. (2007); the model with clearance is ours
//!
//! Between two grasps both hands hold the cube, and each may turn the face under its own palm once: an episode.
//! After it one hand lets go and grasps anew, so what is to be decided is, from one hand's grip to the next, where
//! the free hand closes, which of the next turns are made, and who lets go: a shortest path, by dynamic programming
//! over the turns that are done and the grip of the hand that stays.

use super::hold::{Grip, Hand, Hands, Hold, Step};
use super::replay::{Illegal, replay};
use crate::cube::{Face, Facelets, Rotation24, Turn, format_turns};
use crate::motion::Depth;
use crate::reach::MeetingTable;
use crate::spatial::Pose;
use nalgebra::UnitQuaternion;
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_2, PI};

/// Which pairs of holds and which turns are allowed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Rule {
    /// As in 2007: only the track arm turns; a face change and a face turn for each, two of both for the face
    /// opposite the last one.
    Original,
    /// Palms touch the cube: no finger under the other's palm, layers turn between opposed hands.
    Strict,
    /// Palms stand off: fingers pass under the other's palm, layers turn between hands at right angles, too.
    Clearance,
}

/// How deep the hands may reach.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Depths {
    /// Over one layer only: the palms' stops never move.
    One,
    /// Over one or two.
    Both,
}

/// What motions cost [s].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Costs {
    /// Let go, draw back, come again, close.
    pub grasp: f64,
    /// A quarter turn of a layer.
    pub quarter: f64,
    /// A half turn of a layer.
    pub half: f64,
    /// Open and leave at the end.
    pub leave: f64,
    /// One look at one face.
    pub look: f64,
}

impl Default for Costs {
    fn default() -> Self {
        Self { grasp: 14.0, quarter: 4.0, half: 7.0, leave: 6.0, look: 5.0 }
    }
}

/// What a plan must keep to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Terms {
    /// Which rule.
    pub rule: Rule,
    /// How deep the hands may reach.
    pub depths: Depths,
    /// Who holds the cube in the end, alone; `None`: whoever.
    pub finish: Option<Hand>,
    /// What motions cost.
    pub costs: Costs,
}

impl Terms {
    /// The usual terms of a rule: the track arm hands back; with clearance one layer is enough.
    #[must_use]
    pub fn of(rule: Rule) -> Self {
        let depths = if rule == Rule::Clearance { Depths::One } else { Depths::Both };
        Self { rule, depths, finish: Some(Hand::Track), costs: Costs::default() }
    }
}

/// How far both tools can roll about their own axes where the arms meet, relative [rad]; both contain 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RollLimits {
    /// Of the track arm.
    pub track: (f64, f64),
    /// Of the postument arm.
    pub postument: (f64, f64),
}

/// Where the arms can meet.
pub trait Reach {
    /// How far both can roll when both hold the cube with these rotations `cube_from_tool`; `None` where they
    /// cannot hold it so.
    fn grasp(
        &self,
        track: UnitQuaternion<f64>,
        postument: UnitQuaternion<f64>,
    ) -> Option<RollLimits>;

    /// Whether the camera of the other hand can be brought before a side of a cube that `holder` holds; the side
    /// is the face's outward normal in the holder's tool frame: 0 is +z, 1 is +x, 2 is -x.
    fn view(&self, holder: Hand, side: usize) -> bool;
}

/// Arms that reach everywhere and roll by half a turn either way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Everywhere;

impl Reach for Everywhere {
    fn grasp(&self, _: UnitQuaternion<f64>, _: UnitQuaternion<f64>) -> Option<RollLimits> {
        Some(RollLimits { track: (-PI, PI), postument: (-PI, PI) })
    }

    fn view(&self, _: Hand, _: usize) -> bool {
        true
    }
}

/// The reach of a cell, from its table of meetings.
#[derive(Debug, Clone, Copy)]
pub struct Reachable<'a> {
    /// That table.
    pub table: &'a MeetingTable,
}

/// Roll that is kept free at both ends: a wrist goes on by the twist of the grips, and stands otherwise than at the
/// nominal meeting where the cube lies askew in a hand [rad].
const ROLL_MARGIN: f64 = 0.12;

impl Reach for Reachable<'_> {
    fn grasp(
        &self,
        track: UnitQuaternion<f64>,
        postument: UnitQuaternion<f64>,
    ) -> Option<RollLimits> {
        let track_from_postument = track.inverse() * postument;
        // By what each meeting says of itself, not by its place in the table.
        let meets = |pose: &Pose| pose.rotation.angle_to(&track_from_postument) < 0.5;
        let found = self.table.grasps.iter().flatten().find(|m| meets(&m.track_from_postument));
        let inside = |(low, high): (f64, f64)| (low + ROLL_MARGIN, high - ROLL_MARGIN);
        found.map(|m| RollLimits {
            track: inside(m.track_roll),
            postument: inside(m.postument_roll),
        })
    }

    fn view(&self, holder: Hand, side: usize) -> bool {
        self.table.views[holder.index()].get(side).is_some_and(Option::is_some)
    }
}

/// Steps that carry out one of the solutions.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// The face turns in the order in which they are made.
    pub turns: Vec<Turn>,
    /// What the hands do.
    pub steps: Vec<Step>,
    /// How often jaws close on the cube.
    pub grasps: usize,
    /// What all steps cost [s].
    pub cost: f64,
    /// For each grasp who holds what, and why.
    pub explanation: Vec<String>,
}

/// Why there is no plan.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NoPlan {
    /// No sequence of grasps within reach carries out any of the solutions.
    #[error("no sequence of grasps within reach carries out any of {0} solutions")]
    OutOfReach(usize),
    /// Our own mistake: the replay found a step that must not be done.
    #[error("the plan does not stand its replay: {0}")]
    Replay(#[from] Illegal),
    /// Our own mistake: the replayed plan does not make the turns of the solution.
    #[error("the replayed plan makes other turns than the solution")]
    Unsolved,
}

/// Whether two hands can hold the cube like this at the same time.
#[must_use]
pub fn compatible(a: Hold, b: Hold, rule: Rule) -> bool {
    if a.palm == b.palm || a.palm.axis() == a.jaws || b.palm.axis() == b.jaws {
        return false;
    }
    let both_one = a.depth == Depth::One && b.depth == Depth::One;
    let both_two = a.depth == Depth::Two && b.depth == Depth::Two;
    if a.palm == b.palm.opposite() {
        return a.jaws != b.jaws || !both_two;
    }
    match (a.jaws == b.palm.axis(), b.jaws == a.palm.axis()) {
        // The fingers of both would cross beside the edge between the palms.
        (true, true) => false,
        (false, false) => !both_two,
        _ => rule == Rule::Clearance && both_one,
    }
}

/// Whether of two compatible holds the first can turn its face while the second holds the body.
#[must_use]
pub fn turnable(turner: Hold, body: Hold, rule: Rule) -> bool {
    if turner.depth == Depth::Two {
        return false;
    }
    if turner.palm == body.palm.opposite() {
        return body.depth == Depth::Two;
    }
    rule == Rule::Clearance && body.depth == Depth::One && body.jaws != turner.palm.axis()
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
    for turns in candidates {
        let bound = best.as_ref().map_or(f64::INFINITY, |(cost, _)| *cost);
        best = moves.shortest(turns, bound).or(best);
    }
    let (cost, episodes) = best.ok_or(NoPlan::OutOfReach(candidates.len()))?;
    let plan = written(start, &episodes, cost);
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

/// From one grasp to the next.
#[derive(Debug, Clone, Copy)]
struct Episode {
    /// Who grasps, and how.
    newcomer: (Hand, Grip),
    /// What is turned while both hold, and by whom.
    turns: [Option<(Hand, Turn)>; 2],
    /// Who holds alone after it, and how.
    stays: (Hand, Grip),
}

/// Number of grips of one hand: two depths of 24 rotations.
const GRIPS: usize = 48;
/// Number of states with one hand: two hands.
const STATES: usize = 2 * GRIPS;

fn grip_number(grip: Grip) -> usize {
    grip.rotation().index() + if grip.hold.depth == Depth::Two { 24 } else { 0 }
}

fn state_number((hand, grip): (Hand, Grip)) -> usize {
    hand.index() * GRIPS + grip_number(grip)
}

/// All that does not depend on the solution.
struct Moves {
    terms: Terms,
    start: usize,
    /// Grip of each number.
    grips: Vec<Grip>,
    /// `after[grip][quarters]`.
    after: Vec<[usize; 4]>,
    /// Pairs of grips of the track and the postument: whether both can hold so.
    pairs: Vec<bool>,
    /// Which quarters each hand can turn where it meets, as bits: `[track grip * GRIPS + postument grip][hand]`;
    /// `None` where the arms do not meet.
    rolls: Vec<Option<[u8; 2]>>,
    /// `turnable[turner grip * GRIPS + body grip]`.
    turnable: Vec<bool>,
}

/// The best way to a state.
#[derive(Debug, Clone, Copy)]
struct Best {
    cost: f64,
    from: Option<(usize, usize, Episode)>,
    settled: bool,
}

impl Moves {
    fn new(terms: &Terms, start: (Hand, Grip), reach: &impl Reach) -> Self {
        let grips: Vec<Grip> = Grip::all(Depth::One).chain(Grip::all(Depth::Two)).collect();
        let after =
            grips.iter().map(|g| [0, 1, 2, 3].map(|q| grip_number(g.after_turn(q)))).collect();
        let table = |value: &dyn Fn(Hold, Hold) -> bool| {
            let all = grips.iter().flat_map(|a| grips.iter().map(move |b| (a.hold, b.hold)));
            all.map(|(a, b)| value(a, b)).collect::<Vec<_>>()
        };
        let (pairs, turnable) = (
            table(&|a, b| compatible(a, b, terms.rule)),
            table(&|a, b| turnable(a, b, terms.rule)),
        );
        let meet = |a: usize, b: usize| {
            let [a, b] =
                [a, b].map(|g| Rotation24::from_index(g % 24).unwrap_or(Rotation24::IDENTITY));
            let limits = reach.grasp(a.quaternion(), b.quaternion())?;
            Some([limits.track, limits.postument].map(quarters_within))
        };
        let by_rotation: Vec<_> = (0..24 * 24).map(|i| meet(i / 24, i % 24)).collect();
        let rolls =
            (0..GRIPS * GRIPS).map(|i| by_rotation[i / GRIPS % 24 * 24 + i % GRIPS % 24]).collect();
        Self { terms: *terms, start: state_number(start), grips, after, pairs, rolls, turnable }
    }

    /// The cheapest episodes that make the turns of a solution, if they cost less than `bound`.
    fn shortest(&self, turns: &[Turn], bound: f64) -> Option<(f64, Vec<Episode>)> {
        let ways = ways(turns, self.terms.rule);
        let last = ways.len() - 1;
        let mut best =
            vec![[Best { cost: f64::INFINITY, from: None, settled: false }; STATES]; ways.len()];
        best[0][self.start].cost = 0.0;
        for node in 0..ways.len() {
            while let Some(state) = cheapest(&best[node]) {
                best[node][state].settled = true;
                let cost = best[node][state].cost;
                if cost >= bound {
                    break;
                }
                self.expand(&ways, node, state, |next_node, next_state, added, episode| {
                    let reached = &mut best[next_node][next_state];
                    if cost + added < reached.cost - 1e-9 {
                        reached.cost = cost + added;
                        reached.from = Some((node, state, episode));
                    }
                });
            }
        }
        let finishers =
            (0..STATES).filter(|s| self.terms.finish.is_none_or(|hand| hand.index() == s / GRIPS));
        let end = finishers.min_by(|&a, &b| best[last][a].cost.total_cmp(&best[last][b].cost))?;
        let leave = if best[last][end].from.is_some() { self.terms.costs.leave } else { 0.0 };
        let cost = best[last][end].cost + leave;
        if cost >= bound || cost.is_infinite() {
            return None;
        }
        let (mut episodes, mut at) = (Vec::new(), (last, end));
        while let Some((node, state, episode)) = best[at.0][at.1].from {
            episodes.push(episode);
            at = (node, state);
        }
        episodes.reverse();
        Some((cost, episodes))
    }

    /// All episodes from a state: to where, at what cost, how.
    fn expand(
        &self,
        ways: &[Vec<(Turn, usize)>],
        node: usize,
        state: usize,
        mut reached: impl FnMut(usize, usize, f64, Episode),
    ) {
        let (holder, held) = (hand_of(state), state % GRIPS);
        let newcomer = holder.other();
        let choices = if self.terms.depths == Depths::One { 24 } else { GRIPS };
        for grip in 0..choices {
            let both = if holder == Hand::Track { [held, grip] } else { [grip, held] };
            let pair = both[0] * GRIPS + both[1];
            let Some(rolls) = self.rolls[pair].filter(|_| self.pairs[pair]) else { continue };
            if !self.original_meets(newcomer, both) {
                continue;
            }
            let mut found = |node: usize, cost: f64, both: [usize; 2], turns| {
                for stays in [Hand::Track, Hand::Postument] {
                    if self.original_stays(newcomer, stays) {
                        let grip = both[stays.index()];
                        let episode = Episode {
                            newcomer: (
                                newcomer,
                                self.grips[if holder == Hand::Track {
                                    pair % GRIPS
                                } else {
                                    pair / GRIPS
                                }],
                            ),
                            turns,
                            stays: (stays, self.grips[grip]),
                        };
                        reached(node, stays.index() * GRIPS + grip, cost, episode);
                    }
                }
            };
            let cost = self.terms.costs.grasp;
            found(node, cost, both, [None; 2]);
            if self.terms.rule == Rule::Original && newcomer == Hand::Track {
                continue;
            }
            for &(first, after_first) in &ways[node] {
                let Some((turner, both)) = self.turned(both, rolls, first, None) else { continue };
                let cost = cost + self.turn_cost(first);
                found(after_first, cost, both, [Some((turner, first)), None]);
                if self.terms.rule == Rule::Original {
                    continue;
                }
                for &(second, after_second) in &ways[after_first] {
                    let again = self.turned(both, rolls, second, Some(turner));
                    let Some((other, both)) = again else { continue };
                    let cost = cost + self.turn_cost(second);
                    found(after_second, cost, both, [Some((turner, first)), Some((other, second))]);
                }
            }
        }
    }

    /// Who can make a turn now, and both grips after it.
    fn turned(
        &self,
        both: [usize; 2],
        rolls: [u8; 2],
        turn: Turn,
        turned_before: Option<Hand>,
    ) -> Option<(Hand, [usize; 2])> {
        let palms = both.map(|g| self.grips[g].hold.palm);
        let turner =
            [Hand::Track, Hand::Postument].into_iter().find(|h| palms[h.index()] == turn.face)?;
        let (t, b) = (turner.index(), turner.other().index());
        let allowed = Some(turner) != turned_before
            && !(self.terms.rule == Rule::Original && turner == Hand::Postument)
            && rolls[t] >> turn.quarters & 1 == 1
            && self.turnable[both[t] * GRIPS + both[b]];
        if !allowed {
            return None;
        }
        let mut after = both;
        after[t] = self.after[both[t]][usize::from(turn.quarters)];
        self.pairs[after[0] * GRIPS + after[1]].then_some((turner, after))
    }

    fn turn_cost(&self, turn: Turn) -> f64 {
        if turn.quarters == 2 { self.terms.costs.half } else { self.terms.costs.quarter }
    }

    /// The original's track arm changes faces at right angles, its postument arm grasps opposite.
    fn original_meets(&self, newcomer: Hand, both: [usize; 2]) -> bool {
        let [a, b] = both.map(|g| self.grips[g].hold.palm);
        self.terms.rule != Rule::Original || (a == b.opposite()) == (newcomer == Hand::Postument)
    }

    /// In the original the newcomer always keeps the cube: the track arm after a change, the other after a turn.
    fn original_stays(&self, newcomer: Hand, stays: Hand) -> bool {
        self.terms.rule != Rule::Original || newcomer == stays
    }
}

fn hand_of(state: usize) -> Hand {
    if state < GRIPS { Hand::Track } else { Hand::Postument }
}

/// The unsettled state of least cost.
fn cheapest(states: &[Best; STATES]) -> Option<usize> {
    let open = (0..STATES).filter(|&s| !states[s].settled && states[s].cost.is_finite());
    open.min_by(|&a, &b| states[a].cost.total_cmp(&states[b].cost))
}

/// Bit `q` is set when a turn by `q` clockwise quarters stays within the interval of rolls; 2 may go either way.
fn quarters_within((low, high): (f64, f64)) -> u8 {
    let within = |angle: f64| low - 1e-9 <= angle && angle <= high + 1e-9;
    u8::from(within(FRAC_PI_2)) << 1
        | u8::from(within(PI) || within(-PI)) << 2
        | u8::from(within(-FRAC_PI_2)) << 3
}

/// The orders in which the turns can be made: from each node the turns that may come next, and where they lead.
/// Node 0 is the start, the last node the end. Opposite neighbours may change places, but not by the original.
fn ways(turns: &[Turn], rule: Rule) -> Vec<Vec<(Turn, usize)>> {
    let mut ways: Vec<Vec<(Turn, usize)>> = Vec::with_capacity(turns.len() * 2 + 1);
    let mut at = 0;
    while at < turns.len() {
        let node = ways.len();
        match turns.get(at + 1) {
            Some(&next) if next.face == turns[at].face.opposite() && rule != Rule::Original => {
                ways.push(vec![(turns[at], node + 1), (next, node + 2)]);
                ways.push(vec![(next, node + 3)]);
                ways.push(vec![(turns[at], node + 3)]);
                at += 2;
            }
            _ => {
                ways.push(vec![(turns[at], node + 1)]);
                at += 1;
            }
        }
    }
    ways.push(Vec::new());
    ways
}

/// The episodes as steps, with their reasons.
fn written(start: (Hand, Grip), episodes: &[Episode], cost: f64) -> Plan {
    let (mut steps, mut turns, mut explanation) = (Vec::new(), Vec::new(), Vec::new());
    let mut holder = start;
    for (i, episode) in episodes.iter().enumerate() {
        let (hand, Grip { hold, half_roll }) = episode.newcomer;
        steps.push(Step::Grasp { hand, hold, half_roll });
        for (turner, turn) in episode.turns.iter().flatten() {
            steps.push(Step::Turn { turner: *turner, turn: *turn });
            turns.push(*turn);
        }
        explanation.push(reason(i, holder, episode, episodes.get(i + 1)));
        holder = episode.stays;
    }
    if episodes.is_empty() {
        explanation.push(format!("{} holds the cube, nothing to do", name(start.0)));
    } else {
        steps.push(Step::Leave { hand: holder.0.other() });
        explanation.push(format!(
            "{} leaves; {} keeps {}",
            name(holder.0.other()),
            name(holder.0),
            described(holder.1.hold)
        ));
    }
    Plan { turns, steps, grasps: episodes.len(), cost, explanation }
}

/// One line on a grasp: who, how, what it is for, and what the partner does meanwhile.
fn reason(
    number: usize,
    (holder, held): (Hand, Grip),
    episode: &Episode,
    next: Option<&Episode>,
) -> String {
    let (hand, grip) = episode.newcomer;
    let made: Vec<String> = episode
        .turns
        .iter()
        .flatten()
        .map(|(turner, turn)| format!("{} turns {}", name(*turner), format_turns(&[*turn])))
        .collect();
    let purpose = match (made.is_empty(), next) {
        (false, _) => format!("so that {}", made.join(", then ")),
        (true, Some(next)) => format!(
            "a hand-over: {} must let go of {} to grasp {} next",
            name(next.newcomer.0),
            face_name(if next.newcomer.0 == holder { held } else { grip }.hold.palm),
            face_name(next.newcomer.1.hold.palm)
        ),
        (true, None) => format!("{} is to hold the cube in the end", name(episode.stays.0)),
    };
    format!(
        "grasp {}: {} takes {} while {} holds {}: {purpose}",
        number + 1,
        name(hand),
        described(grip.hold),
        name(holder),
        described(held.hold)
    )
}

fn name(hand: Hand) -> &'static str {
    match hand {
        Hand::Track => "track",
        Hand::Postument => "postument",
    }
}

fn face_name(face: Face) -> char {
    face.letter()
}

fn described(hold: Hold) -> String {
    let positive = hold.jaws.positive_face();
    let layers = if hold.depth == Depth::One { "one layer" } else { "two layers" };
    format!(
        "{} with jaws {}-{}, {layers}",
        hold.palm.letter(),
        positive.opposite().letter(),
        positive.letter()
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::{Axis, parse_turns};

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
            assert_eq!(plan.explanation.len(), plan.grasps + 1);
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
