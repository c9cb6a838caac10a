//! The search for the cheapest episodes that make the turns of one solution.
//!
//! - in: turns, the terms of the plan ([`Terms`]), the reach of the arms and the times between
//!   meetings ([`Reach`])
//! - out: episodes, each a grasp and at most one turn by each hand
//! - method: a shortest path. Between two grasps both hands hold the cube, and each may turn the
//!   face under its own palm once: an episode. After it one hand lets go and grasps again. An
//!   episode is the choice of the grip in which the free hand closes, of the next turns that are
//!   made, and of the hand that stays. A state of the path is the number of turns done and the grip
//!   of the hand that stays; dynamic programming goes over the turns, and Dijkstra's algorithm over
//!   the states within one number of turns

use super::super::hold::{Grip, Hand, Hold};
use super::terms::{Depths, Rule, Terms, compatible, turnable};
use super::travel::{ArmsAt, Reach, of_rotations};
use crate::cube::{Face, Turn, rotation_index};
use crate::motion::Depth;
use std::f64::consts::FRAC_PI_2;

/// The actions from one grasp to the next.
#[derive(Debug, Clone, Copy)]
pub(super) struct Episode {
    /// The hand that grasps, and its grip.
    pub(super) newcomer: (Hand, Grip),
    /// Turns that are made while both hands hold, each with its turner.
    pub(super) turns: [Option<(Hand, Turn)>; 2],
    /// The hand that holds alone afterwards, and its grip.
    pub(super) stays: (Hand, Grip),
    /// Time from the path to the meeting to the last turn (s).
    pub(super) seconds: f64,
}

/// Numbers of the grips of both hands within an episode, and the rolls of their wrists since its
/// grasp, in quarter turns.
#[derive(Debug, Clone, Copy)]
struct Now {
    grips: [usize; 2],
    rolled: [i8; 2],
}

/// Number of grips of one hand.
const GRIPS: usize = Grip::COUNT;
/// Number of states in which one hand holds the cube alone: two hands with all their grips.
const STATES: usize = 2 * GRIPS;

/// Returns the index, 0..96, of the state in which this hand alone holds the cube in this grip.
fn state_number((hand, grip): (Hand, Grip)) -> usize {
    hand.index() * GRIPS + grip.number()
}

/// All data of the search that do not depend on the solution.
pub(super) struct Moves<'a, R: Reach> {
    reach: &'a R,
    terms: Terms,
    /// State in which a plan begins.
    start: usize,
    /// Whether a hand may ever reach over two layers.
    deep: bool,
    /// Grips by their numbers.
    grips: Vec<Grip>,
    /// Indices of the grips after a turn: `after[grip][quarters]`.
    after: Vec<[usize; 4]>,
    /// Whether both hands can hold in these grips: `[track grip * GRIPS + postument grip]`.
    pairs: Vec<bool>,
    /// Meeting of two grips, indexed in the same manner; `None` where the arms do not meet.
    places: Vec<Option<Place>>,
    /// Whether the first of two grips can turn its face: `[turner grip * GRIPS + body grip]`.
    turnable: Vec<bool>,
}

/// A meeting of two grips.
#[derive(Debug, Clone, Copy)]
struct Place {
    /// Number of the meeting, as in [`ArmsAt`].
    meeting: u8,
    /// Roll of each wrist for 1, 2, 3 clockwise quarters, in quarters; 0 where it has no room.
    rolls: [[i8; 3]; 2],
}

/// The cheapest path to a state.
#[derive(Debug, Clone, Copy)]
struct Best {
    /// Cost of the path (s).
    cost: f64,
    /// Configuration of the arms at its end. Only that of the cheapest path is kept, although
    /// another one might suit the next meeting better: the difference is a second or two, and
    /// states with configurations would be twenty times as many.
    arms_at: Option<ArmsAt>,
    /// Node and state before this one; itself at the start.
    from: (u16, u16),
    /// Whether all episodes from this state have been tried.
    settled: bool,
}

/// Memory that one search leaves to the next: a plan takes thousands of searches.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    /// Cheapest path to each state of each node.
    best: Vec<[Best; STATES]>,
    /// Least time from each node to the end, by the palm of the hand that holds alone (s).
    tail: Vec<[f64; 6]>,
}

impl<'a, R: Reach> Moves<'a, R> {
    /// Tabulates the terms and the reach over all pairs of grips, once for all solutions.
    pub(super) fn new(terms: &Terms, start: (Hand, Grip), reach: &'a R) -> Self {
        let grips: Vec<Grip> = Grip::every().collect();
        let after = grips.iter().map(|g| [0, 1, 2, 3].map(|q| g.after_turn(q).number())).collect();
        let table = |value: &dyn Fn(Hold, Hold) -> bool| {
            let all = grips.iter().flat_map(|a| grips.iter().map(move |b| (a.hold, b.hold)));
            all.map(|(a, b)| value(a, b)).collect::<Vec<_>>()
        };
        let (pairs, turnable) = (
            table(&|a, b| compatible(a, b, terms.rule)),
            table(&|a, b| turnable(a, b, terms.rule)),
        );
        let places = of_rotations(|track, postument| {
            let limits = reach.grasp(*track, *postument)?;
            let meeting = rotation_index(&(track.inverse() * postument)) as u8;
            Some(Place { meeting, rolls: [limits.track, limits.postument].map(rolls_within) })
        });
        Self {
            reach,
            terms: *terms,
            start: state_number(start),
            deep: terms.depths == Depths::Both || start.1.hold.depth == Depth::Two,
            grips,
            after,
            pairs,
            places,
            turnable,
        }
    }

    /// Returns the cost (s) and the episodes of the cheapest way to make the turns of a solution,
    /// if it costs less than `bound` (s).
    pub(super) fn shortest(
        &self,
        turns: &[Turn],
        bound: f64,
        Scratch { best, tail }: &mut Scratch,
    ) -> Option<(f64, Vec<Episode>)> {
        let graph = turn_graph(turns, self.terms.rule);
        let last = graph.len() - 1;
        self.tails(&graph, tail);
        // The search of a candidate ends here if it cannot undercut the best plan.
        let palm = |state: usize| self.grips[state % GRIPS].hold.palm.index();
        if tail[0][palm(self.start)] >= bound {
            return None;
        }
        let none = Best { cost: f64::INFINITY, arms_at: None, from: (0, 0), settled: false };
        best.clear();
        best.resize(graph.len(), [none; STATES]);
        best[0][self.start].cost = 0.0;
        best[0][self.start].from = (0, self.start as u16);
        // A turn leads to a later node, a grasp without a turn to another state of this one. So
        // nodes are taken in order, and within a node the states by their cost.
        for node in 0..graph.len() {
            while let Some(state) = cheapest(&best[node]) {
                best[node][state].settled = true;
                let Best { cost, arms_at, .. } = best[node][state];
                if cost + tail[node][palm(state)] >= bound {
                    continue;
                }
                self.expand(
                    &graph,
                    (node, state, arms_at),
                    |next_node, next_state, arms_at, seconds, _| {
                        let reached = &mut best[next_node][next_state];
                        // Costs that differ by rounding alone keep the earlier path.
                        if cost + seconds < reached.cost - 1e-9 {
                            let from = (node as u16, state as u16);
                            *reached = Best {
                                cost: cost + seconds,
                                arms_at: Some(arms_at),
                                from,
                                settled: false,
                            };
                        }
                    },
                );
            }
        }
        // The hand that gives the cube back, over the depth that its receiver allows.
        let finishers = (0..STATES).filter(|s| {
            self.terms.finish.is_none_or(|hand| hand.index() == s / GRIPS)
                && s % GRIPS < self.terms.finish_depths.grips()
        });
        let end = finishers.min_by(|&a, &b| best[last][a].cost.total_cmp(&best[last][b].cost))?;
        // No episode at all: the cube is solved and in the right hand, so no hand has to leave.
        let begun = best[last][end].arms_at.is_some();
        let cost = best[last][end].cost + if begun { self.terms.costs.leave } else { 0.0 };
        if cost >= bound || cost.is_infinite() {
            return None;
        }
        Some((cost, self.traced(&graph, best, (last, end))))
    }

    /// Returns the episodes on the cheapest path to the node and state `at`. The table `best` keeps
    /// no episodes, so each is found again among those of the state before.
    fn traced(
        &self,
        graph: &[Vec<(Turn, usize)>],
        best: &[[Best; STATES]],
        mut at: (usize, usize),
    ) -> Vec<Episode> {
        let mut episodes = Vec::new();
        while best[at.0][at.1].arms_at.is_some() {
            let reached = best[at.0][at.1];
            let from = (usize::from(reached.from.0), usize::from(reached.from.1));
            let before = best[from.0][from.1];
            let mut found = None;
            self.expand(
                graph,
                (from.0, from.1, before.arms_at),
                |node, state, arms_at, seconds, how| {
                    // The sums are made of the same numbers in the same order, so equality is
                    // exact.
                    let same = (node, state) == at
                        && reached.arms_at == Some(arms_at)
                        && before.cost + seconds == reached.cost;
                    if same && found.is_none() {
                        found = Some(how());
                    }
                },
            );
            episodes.extend(found);
            at = from;
        }
        episodes.reverse();
        episodes
    }

    /// Fills `tail` with lower bounds of the time from each node to the end (s):
    /// `tail[node][face]`, where `face` is under the palm of the hand that holds alone. The bound
    /// keeps only one of the rules, that a hand turns the face under its palm, and gives each path
    /// the least time of all paths.
    fn tails(&self, graph: &[Vec<(Turn, usize)>], tail: &mut Vec<[f64; 6]>) {
        let grasp = self.terms.costs.grasp + self.reach.least_travel();
        // A solved cube may need no grasp at all, so its bound is 0.
        let leave = if graph.len() > 1 { self.terms.costs.leave } else { 0.0 };
        tail.clear();
        tail.resize(graph.len(), [leave; 6]);
        for (node, next_turns) in graph.iter().enumerate().rev().skip(1) {
            let mut least = [f64::INFINITY; 6];
            // Every pair of palms that an episode could have, and the turns that either could make.
            for stays in Face::ALL {
                for comes in Face::ALL.into_iter().filter(|&f| f != stays) {
                    let palms = [stays, comes];
                    let end = |node: usize| {
                        let [a, b] = palms.map(|palm| tail[node][palm.index()]);
                        a.min(b)
                    };
                    let mut of_pair = f64::INFINITY;
                    for &(first, next) in next_turns {
                        if !self.may_turn(first, palms) {
                            continue;
                        }
                        let seconds = self.turn_cost(first);
                        of_pair = of_pair.min(seconds + end(next));
                        // Two turns in one grasp: one by each hand, which only the rule with
                        // clearance allows.
                        for &(second, after) in &graph[next] {
                            let both =
                                self.terms.rule == Rule::Clearance && second.face != first.face;
                            if both && self.may_turn(second, palms) {
                                of_pair =
                                    of_pair.min(seconds + self.turn_cost(second) + end(after));
                            }
                        }
                    }
                    let least = &mut least[stays.index()];
                    *least = least.min(grasp + of_pair);
                }
            }
            // A grasp without a turn brings the palm anywhere else.
            let elsewhere = grasp + least.iter().copied().fold(f64::INFINITY, f64::min);
            tail[node] = least.map(|seconds| seconds.min(elsewhere));
        }
    }

    /// Returns whether one of two hands with these palm faces could make a turn, whatever the axes
    /// of their jaws.
    fn may_turn(&self, turn: Turn, palms: [Face; 2]) -> bool {
        let opposite = palms[0] == palms[1].opposite();
        palms.contains(&turn.face)
            && (opposite || self.terms.rule == Rule::Clearance)
            && (self.deep || !opposite)
    }

    /// Calls `reached` for each episode that can begin in a state: with the node and the state
    /// after it, the configuration of the arms, the time (s), and a function that makes the
    /// episode.
    fn expand(
        &self,
        graph: &[Vec<(Turn, usize)>],
        (node, state, arms_at): (usize, usize, Option<ArmsAt>),
        mut reached: impl FnMut(usize, usize, ArmsAt, f64, &dyn Fn() -> Episode),
    ) {
        let (holder, held) = (hand_of(state), state % GRIPS);
        let hand = holder.other();
        let count = self.terms.depths.grips();
        for grip in 0..count {
            let both = if holder == Hand::Track { [held, grip] } else { [grip, held] };
            let pair = both[0] * GRIPS + both[1];
            let Some(place) = self.places[pair].filter(|_| self.pairs[pair]) else { continue };
            if !self.original_meets(hand, both) {
                continue;
            }
            let newcomer = (hand, self.grips[grip]);
            let mut found = |node: usize, seconds: f64, now: Now, turns| {
                for stays in [Hand::Track, Hand::Postument] {
                    if self.original_stays(hand, stays) {
                        let grip = now.grips[stays.index()];
                        let arms_at = ArmsAt { meeting: place.meeting, rolled: now.rolled };
                        let how = || Episode {
                            newcomer,
                            turns,
                            stays: (stays, self.grips[grip]),
                            seconds,
                        };
                        reached(node, stays.index() * GRIPS + grip, arms_at, seconds, &how);
                    }
                }
            };
            let start = Now { grips: both, rolled: [0; 2] };
            let seconds = self.terms.costs.grasp + self.reach.travel(arms_at, hand, place.meeting);
            // A grasp without a turn: a hand-over, or a step towards a grip that can turn.
            found(node, seconds, start, [None; 2]);
            // The original's track arm only takes the cube over; its turns follow the postument's
            // grasp.
            if self.terms.rule == Rule::Original && hand == Hand::Track {
                continue;
            }
            for &(first, after_first) in &graph[node] {
                let Some((turner, now)) = self.turned(start, place, first, None) else { continue };
                let seconds = seconds + self.turn_cost(first);
                found(after_first, seconds, now, [Some((turner, first)), None]);
                if self.terms.rule == Rule::Original {
                    continue;
                }
                // The second turn is by the other hand: a wrist has room for one turn from a
                // meeting.
                for &(second, after_second) in &graph[after_first] {
                    let again = self.turned(now, place, second, Some(turner));
                    let Some((other, now)) = again else { continue };
                    let seconds = seconds + self.turn_cost(second);
                    found(
                        after_second,
                        seconds,
                        now,
                        [Some((turner, first)), Some((other, second))],
                    );
                }
            }
        }
    }

    /// Returns the hand that can make `turn`, and the grips and rolls of both hands after it; `now`
    /// has those before. `turned_before` is the hand that has turned already in this episode.
    fn turned(
        &self,
        now: Now,
        place: Place,
        turn: Turn,
        turned_before: Option<Hand>,
    ) -> Option<(Hand, Now)> {
        let palms = now.grips.map(|g| self.grips[g].hold.palm);
        let turner =
            [Hand::Track, Hand::Postument].into_iter().find(|h| palms[h.index()] == turn.face)?;
        let (t, b) = (turner.index(), turner.other().index());
        let roll = place.rolls[t][usize::from(turn.quarters) - 1];
        let allowed = Some(turner) != turned_before
            && !(self.terms.rule == Rule::Original && turner == Hand::Postument)
            && roll != 0
            && self.turnable[now.grips[t] * GRIPS + now.grips[b]];
        if !allowed {
            return None;
        }
        let mut after = now;
        after.grips[t] = self.after[now.grips[t]][usize::from(turn.quarters)];
        after.rolled[t] = roll;
        // The turner's fingers have moved with its layer and may now be in the body's way.
        self.pairs[after.grips[0] * GRIPS + after.grips[1]].then_some((turner, after))
    }

    /// Returns the planned time of a turn (s).
    fn turn_cost(&self, turn: Turn) -> f64 {
        if turn.quarters == 2 { self.terms.costs.half } else { self.terms.costs.quarter }
    }

    /// Returns whether the grips `both` may meet by [`Rule::Original`]: the track arm takes a face
    /// beside the postument's palm, and the postument arm grasps opposite the track's. Other rules
    /// allow every meeting.
    fn original_meets(&self, newcomer: Hand, both: [usize; 2]) -> bool {
        let [a, b] = both.map(|g| self.grips[g].hold.palm);
        self.terms.rule != Rule::Original || (a == b.opposite()) == (newcomer == Hand::Postument)
    }

    /// Returns whether the hand `stays` may keep the cube after an episode. By [`Rule::Original`]
    /// it is always the newcomer: the track arm after it has taken a new face, the postument arm
    /// after the turn.
    fn original_stays(&self, newcomer: Hand, stays: Hand) -> bool {
        self.terms.rule != Rule::Original || newcomer == stays
    }
}

/// Returns the hand that holds alone in a state.
fn hand_of(state: usize) -> Hand {
    if state < GRIPS { Hand::Track } else { Hand::Postument }
}

/// Returns the index of the cheapest state that is reached but not settled.
fn cheapest(states: &[Best; STATES]) -> Option<usize> {
    let open = (0..STATES).filter(|&s| !states[s].settled && states[s].cost.is_finite());
    open.min_by(|&a, &b| states[a].cost.total_cmp(&states[b].cost))
}

/// Returns the rolls by which a wrist makes 1, 2 and 3 clockwise quarter turns within its range
/// (rad), in quarter turns; 0 where it has no room. A half turn rolls to the side with more room,
/// as in the mission.
fn rolls_within((low, high): (f64, f64)) -> [i8; 3] {
    let within = |quarters: i8| {
        let angle = f64::from(quarters) * FRAC_PI_2;
        if low - 1e-9 <= angle && angle <= high + 1e-9 { quarters } else { 0 }
    };
    [within(1), within(if high > -low { 2 } else { -2 }), within(-1)]
}

/// Returns the orders in which the turns can be made, as a graph: for each node the turns that may
/// come next, each with the node after it. Node 0 is the start, the last node the end.
fn turn_graph(turns: &[Turn], rule: Rule) -> Vec<Vec<(Turn, usize)>> {
    let mut graph: Vec<Vec<(Turn, usize)>> = Vec::with_capacity(turns.len() * 2 + 1);
    let mut at = 0;
    while at < turns.len() {
        let node = graph.len();
        match turns.get(at + 1) {
            Some(&next) if next.face == turns[at].face.opposite() && rule != Rule::Original => {
                // Opposite layers turn independently, so either may be first: a diamond of four
                // nodes. The original keeps the solver's order.
                graph.push(vec![(turns[at], node + 1), (next, node + 2)]);
                graph.push(vec![(next, node + 3)]);
                graph.push(vec![(turns[at], node + 3)]);
                at += 2;
            }
            _ => {
                graph.push(vec![(turns[at], node + 1)]);
                at += 1;
            }
        }
    }
    graph.push(Vec::new());
    graph
}
