//! The cheapest episodes that make the turns of one solution.
//!
//! - in: turns, what is allowed ([`Terms`]), what is within reach and how far apart ([`Reach`])
//! - out: episodes, each a grasp and at most one turn by each hand
//! - method: between two grasps both hands hold the cube, and each may turn the face under its own palm once: an
//!   episode. After it one hand lets go and grasps anew, so what is to be decided is, from one hand's grip to the next,
//!   where the free hand closes, which of the next turns are made, and who lets go: a shortest path, by dynamic
//!   programming over the turns that are done and the grip of the hand that stays.

use super::super::hold::{Grip, Hand, Hold};
use super::terms::{Depths, Rule, Terms, compatible, turnable};
use super::travel::{Reach, Stand};
use crate::cube::{Face, Rotation24, Turn, rotation_index};
use crate::motion::Depth;
use std::f64::consts::FRAC_PI_2;

/// From one grasp to the next.
#[derive(Debug, Clone, Copy)]
pub(super) struct Episode {
    /// Who grasps, and how.
    pub(super) newcomer: (Hand, Grip),
    /// What is turned while both hold, and by whom.
    pub(super) turns: [Option<(Hand, Turn)>; 2],
    /// Who holds alone after it, and how.
    pub(super) stays: (Hand, Grip),
    /// What it takes, from the way to the meeting to the last turn (s).
    pub(super) seconds: f64,
}

/// What both hands hold within an episode, and how far their wrists have rolled.
#[derive(Debug, Clone, Copy)]
struct Now {
    grips: [usize; 2],
    rolled: [i8; 2],
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
pub(super) struct Moves<'a, R: Reach> {
    reach: &'a R,
    terms: Terms,
    start: usize,
    /// Whether a hand may ever reach over two layers.
    deep: bool,
    /// Grip of each number.
    grips: Vec<Grip>,
    /// `after[grip][quarters]`.
    after: Vec<[usize; 4]>,
    /// Pairs of grips of the track and the postument: whether both can hold so.
    pairs: Vec<bool>,
    /// The meeting of two grips: `[track grip * GRIPS + postument grip]`; `None` where the arms do not meet.
    places: Vec<Option<Place>>,
    /// `turnable[turner grip * GRIPS + body grip]`.
    turnable: Vec<bool>,
}

/// A meeting of two grips.
#[derive(Debug, Clone, Copy)]
struct Place {
    meeting: u8,
    /// How each wrist rolls for 1, 2, 3 clockwise quarters; 0 where it has no room.
    rolls: [[i8; 3]; 2],
}

/// The best way to a state.
#[derive(Debug, Clone, Copy)]
struct Best {
    cost: f64,
    /// Where the arms then stand. Of two ways to a state the cheaper one is kept although the other might stand better
    /// for the next meeting: the difference is a second or two, another factor of twenty in states is not worth it.
    stand: Option<Stand>,
    /// Node and state before; itself at the start.
    from: (u16, u16),
    settled: bool,
}

/// Memory that one search leaves to the next: there are thousands of them.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    best: Vec<[Best; STATES]>,
    /// Least seconds from each node to the end, by the palm of the hand that holds alone.
    tail: Vec<[f64; 6]>,
}

impl<'a, R: Reach> Moves<'a, R> {
    pub(super) fn new(terms: &Terms, start: (Hand, Grip), reach: &'a R) -> Self {
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
            let [a, b] = [a, b]
                .map(|g| Rotation24::from_index(g).unwrap_or(Rotation24::IDENTITY).quaternion());
            let limits = reach.grasp(a, b)?;
            let meeting = rotation_index(&(a.inverse() * b)) as u8;
            Some(Place { meeting, rolls: [limits.track, limits.postument].map(rolls_within) })
        };
        let by_rotation: Vec<_> = (0..24 * 24).map(|i| meet(i / 24, i % 24)).collect();
        let places =
            (0..GRIPS * GRIPS).map(|i| by_rotation[i / GRIPS % 24 * 24 + i % GRIPS % 24]).collect();
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

    /// The cheapest episodes that make the turns of a solution, if they cost less than `bound`.
    pub(super) fn shortest(
        &self,
        turns: &[Turn],
        bound: f64,
        Scratch { best, tail }: &mut Scratch,
    ) -> Option<(f64, Vec<Episode>)> {
        let ways = ways(turns, self.terms.rule);
        let last = ways.len() - 1;
        self.tails(&ways, tail);
        let palm = |state: usize| self.grips[state % GRIPS].hold.palm.index();
        if tail[0][palm(self.start)] >= bound {
            return None;
        }
        let none = Best { cost: f64::INFINITY, stand: None, from: (0, 0), settled: false };
        best.clear();
        best.resize(ways.len(), [none; STATES]);
        best[0][self.start].cost = 0.0;
        best[0][self.start].from = (0, self.start as u16);
        for node in 0..ways.len() {
            while let Some(state) = cheapest(&best[node]) {
                best[node][state].settled = true;
                let Best { cost, stand, .. } = best[node][state];
                if cost + tail[node][palm(state)] >= bound {
                    continue;
                }
                self.expand(
                    &ways,
                    (node, state, stand),
                    |next_node, next_state, stand, seconds, _| {
                        let reached = &mut best[next_node][next_state];
                        if cost + seconds < reached.cost - 1e-9 {
                            let from = (node as u16, state as u16);
                            *reached = Best {
                                cost: cost + seconds,
                                stand: Some(stand),
                                from,
                                settled: false,
                            };
                        }
                    },
                );
            }
        }
        let finishers = (0..STATES).filter(|s| {
            self.terms.finish.is_none_or(|hand| hand.index() == s / GRIPS)
                && s % GRIPS < choices(self.terms.finish_depths)
        });
        let end = finishers.min_by(|&a, &b| best[last][a].cost.total_cmp(&best[last][b].cost))?;
        let begun = best[last][end].stand.is_some();
        let cost = best[last][end].cost + if begun { self.terms.costs.leave } else { 0.0 };
        if cost >= bound || cost.is_infinite() {
            return None;
        }
        Some((cost, self.traced(&ways, best, (last, end))))
    }

    /// The episodes that led to a state: each is found again among those of the state before it.
    fn traced(
        &self,
        ways: &[Vec<(Turn, usize)>],
        best: &[[Best; STATES]],
        mut at: (usize, usize),
    ) -> Vec<Episode> {
        let mut episodes = Vec::new();
        while best[at.0][at.1].stand.is_some() {
            let reached = best[at.0][at.1];
            let from = (usize::from(reached.from.0), usize::from(reached.from.1));
            let before = best[from.0][from.1];
            let mut found = None;
            self.expand(
                ways,
                (from.0, from.1, before.stand),
                |node, state, stand, seconds, how| {
                    let same = (node, state) == at
                        && reached.stand == Some(stand)
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

    /// Least seconds from each node to the end, by the palm of the hand that holds alone: of the rules only that a
    /// hand turns the face under its palm, and of the ways only the shortest.
    fn tails(&self, ways: &[Vec<(Turn, usize)>], tail: &mut Vec<[f64; 6]>) {
        let grasp = self.terms.costs.grasp + self.reach.least_travel();
        let leave = if ways.len() > 1 { self.terms.costs.leave } else { 0.0 };
        tail.clear();
        tail.resize(ways.len(), [leave; 6]);
        for (node, ways_on) in ways.iter().enumerate().rev().skip(1) {
            let mut least = [f64::INFINITY; 6];
            for stays in Face::ALL {
                for comes in Face::ALL.into_iter().filter(|&f| f != stays) {
                    let palms = [stays, comes];
                    let end = |node: usize| {
                        let [a, b] = palms.map(|palm| tail[node][palm.index()]);
                        a.min(b)
                    };
                    let mut of_pair = f64::INFINITY;
                    for &(first, next) in ways_on {
                        if !self.may_turn(first, palms) {
                            continue;
                        }
                        let seconds = self.turn_cost(first);
                        of_pair = of_pair.min(seconds + end(next));
                        for &(second, after) in &ways[next] {
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

    /// Whether the rule lets one of two hands make a turn, as far as the palms say.
    fn may_turn(&self, turn: Turn, palms: [Face; 2]) -> bool {
        let opposite = palms[0] == palms[1].opposite();
        palms.contains(&turn.face)
            && (opposite || self.terms.rule == Rule::Clearance)
            && (self.deep || !opposite)
    }

    /// All episodes from a state: to where, how the arms then stand, how.
    fn expand(
        &self,
        ways: &[Vec<(Turn, usize)>],
        (node, state, stand): (usize, usize, Option<Stand>),
        mut reached: impl FnMut(usize, usize, Stand, f64, &dyn Fn() -> Episode),
    ) {
        let (holder, held) = (hand_of(state), state % GRIPS);
        let hand = holder.other();
        let choices = choices(self.terms.depths);
        for grip in 0..choices {
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
                        let stand = Stand { meeting: place.meeting, rolled: now.rolled };
                        let how = || Episode {
                            newcomer,
                            turns,
                            stays: (stays, self.grips[grip]),
                            seconds,
                        };
                        reached(node, stays.index() * GRIPS + grip, stand, seconds, &how);
                    }
                }
            };
            let start = Now { grips: both, rolled: [0; 2] };
            let seconds = self.terms.costs.grasp + self.reach.travel(stand, hand, place.meeting);
            found(node, seconds, start, [None; 2]);
            if self.terms.rule == Rule::Original && hand == Hand::Track {
                continue;
            }
            for &(first, after_first) in &ways[node] {
                let Some((turner, now)) = self.turned(start, place, first, None) else { continue };
                let seconds = seconds + self.turn_cost(first);
                found(after_first, seconds, now, [Some((turner, first)), None]);
                if self.terms.rule == Rule::Original {
                    continue;
                }
                for &(second, after_second) in &ways[after_first] {
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

    /// Who can make a turn now, and how both hold after it.
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
        self.pairs[after.grips[0] * GRIPS + after.grips[1]].then_some((turner, after))
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

/// The grips of these depths are the first so many.
fn choices(depths: Depths) -> usize {
    if depths == Depths::One { 24 } else { GRIPS }
}

/// The unsettled state of least cost.
fn cheapest(states: &[Best; STATES]) -> Option<usize> {
    let open = (0..STATES).filter(|&s| !states[s].settled && states[s].cost.is_finite());
    open.min_by(|&a, &b| states[a].cost.total_cmp(&states[b].cost))
}

/// How a wrist rolls for 1, 2, 3 clockwise quarters within its interval; 0 where it cannot. A half turn goes where
/// there is more room, as in the mission.
fn rolls_within((low, high): (f64, f64)) -> [i8; 3] {
    let within = |quarters: i8| {
        let angle = f64::from(quarters) * FRAC_PI_2;
        if low - 1e-9 <= angle && angle <= high + 1e-9 { quarters } else { 0 }
    };
    [within(1), within(if high > -low { 2 } else { -2 }), within(-1)]
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
