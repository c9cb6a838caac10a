//! The two-phase search: six directions, deeper and deeper first phases, a bound that falls with each solution.
//!
//! A solution's first phase may stand in any of three axes, and the inverse cube has as many turns: six searches
//! that take turns, each at one length of phase 1 before any goes to the next. With several workers the first turns
//! are shared out; the bound is common. What is counted as a node (a state of phase 1 that is looked at, or the end
//! of a phase 1) does not depend on which tables lead the walk, so neither does the answer to a number of nodes.

use super::coordinates::PHASE2_TURNS;
use super::phase1::{ALL_TURNS, Child, FAR, Guide, Place};
use super::phase2::{Bounds, Quads, State};
use super::table::{InTurn, Workers};
use super::tables::{Guides, Tables};
use super::views::View;
use crate::cube::{Cube, Turn};
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, AtomicUsize, Ordering::Relaxed};
use std::sync::{Mutex, PoisonError};

/// How long to search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Budget {
    /// States looked at in the first phase, and ends of first phases; the first solution is always found, whatever
    /// this says.
    pub nodes: u64,
    /// A solution with no more turns than this is good enough: the search ends there.
    pub max_length: u8,
}

impl Budget {
    /// The first solution.
    pub const FIRST: Self = Self { nodes: 0, max_length: u8::MAX };
    /// No end but a solution that cannot be shorter.
    pub const UNTIL_PROVEN: Self = Self { nodes: u64::MAX, max_length: 0 };
}

/// Turns that solve a cube.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Solution {
    /// In order; none for a solved cube.
    pub turns: Vec<Turn>,
    /// States that were looked at.
    pub nodes: u64,
    /// Whether the search has seen that there is no shorter one.
    pub proven: bool,
}

/// Who works, and who watches.
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    /// The search is shared out among them. More than one find the same lengths, not always the same turns.
    pub workers: &'a dyn Workers,
    /// Ends the search when it is set, as soon as there is any solution.
    pub stop: &'a AtomicBool,
    /// Is told each better solution when it is found.
    pub improved: &'a (dyn Fn(&[Turn]) + Sync),
    /// Nothing longer is of use, so that the search may end without any solution: it is proven that there is none.
    pub longest: Option<u8>,
}

/// No first phase is longer than this with no gain.
pub(super) const LONGEST: usize = 31;
/// A second phase of a first solution is at most this long: longer ones take long to refute.
const FIRST_PHASE2: u8 = 12;
/// Nothing needs more turns in phase 2.
const LONGEST_PHASE2: u8 = 18;
/// From this first phase on, second phases may be as long as they like.
const UNCAPPED: u8 = 13;

/// A worker looks up whether the search is over when it has searched all that follows so many turns before the end of
/// a phase 1.
const CHECKED: u8 = 4;

/// The shortest solution that the budget finds, alone and unwatched: the same on every machine.
#[must_use]
pub fn solve(cube: &Cube, tables: &Tables, budget: &Budget) -> Solution {
    let watch =
        Watch { workers: &InTurn, stop: &AtomicBool::new(false), improved: &|_| (), longest: None };
    solve_watched(cube, tables, budget, &watch)
}

/// The shortest solution that the budget finds.
#[must_use]
pub fn solve_watched(cube: &Cube, tables: &Tables, budget: &Budget, watch: &Watch<'_>) -> Solution {
    let best = Mutex::new(None::<Vec<Turn>>);
    let longest = watch.longest.map_or(LONGEST as u8 - 1, |n| n.min(LONGEST as u8 - 1));
    let goal = Goal {
        budget,
        watch,
        bound: AtomicU8::new(longest),
        nodes: AtomicU64::new(0),
        over: AtomicBool::new(false),
        missed: AtomicU8::new(u8::MAX),
        found: &|turns, _, goal| {
            let mut best = best.lock().unwrap_or_else(PoisonError::into_inner);
            if best.as_ref().is_none_or(|b| turns.len() < b.len()) {
                let length = turns.len() as u8;
                (watch.improved)(&turns);
                *best = Some(turns);
                // The bound counts the turns of what is still worth finding.
                goal.bound.store(length.saturating_sub(1), Relaxed);
                if length == 0 || length <= budget.max_length {
                    goal.over.store(true, Relaxed);
                }
            }
            false
        },
    };
    let views = View::all(cube);
    run(&views, tables, &goal);
    let (over, missed) = (goal.over.load(Relaxed), goal.missed.load(Relaxed));
    let nodes = goal.nodes.load(Relaxed);
    let turns = best.into_inner().unwrap_or_else(PoisonError::into_inner).unwrap_or_default();
    let proven = cube.is_solved() || !turns.is_empty() && !over && turns.len() as u8 <= missed;
    Solution { turns, nodes, proven }
}

/// All solutions of up to `bound` turns, as they are found, in the order of their first phases' lengths, until `take`
/// has had enough or the nodes are spent. It is told how many came before with the same first phase. Solutions are
/// found more than once.
pub(super) fn each_solution(
    cube: &Cube,
    tables: &Tables,
    bound: u8,
    nodes: u64,
    take: &(dyn Fn(Vec<Turn>, usize) -> Take + Sync),
) {
    let watch =
        Watch { workers: &InTurn, stop: &AtomicBool::new(false), improved: &|_| (), longest: None };
    let goal = Goal {
        budget: &Budget { nodes, max_length: 0 },
        watch: &watch,
        bound: AtomicU8::new(bound),
        nodes: AtomicU64::new(0),
        over: AtomicBool::new(false),
        missed: AtomicU8::new(u8::MAX),
        found: &|turns, siblings, goal| match take(turns, siblings) {
            Take::More => true,
            Take::NextPhase1 => false,
            Take::Enough => {
                goal.over.store(true, Relaxed);
                false
            }
        },
    };
    run(&View::all(cube), tables, &goal);
}

/// What is wanted after a solution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Take {
    /// Whatever comes next.
    More,
    /// None with the same first phase.
    NextPhase1,
    /// Nothing.
    Enough,
}

/// What all workers of a search share.
struct Goal<'a> {
    budget: &'a Budget,
    watch: &'a Watch<'a>,
    /// Longest solution that is of use.
    bound: AtomicU8,
    nodes: AtomicU64,
    over: AtomicBool,
    /// The shortest solution that may have been passed over because its second phase was long.
    missed: AtomicU8,
    /// Takes a solution and how many its first phase had before; tells whether more of it are wanted.
    found: &'a Found<'a>,
}

type Found<'a> = dyn Fn(Vec<Turn>, usize, &Goal<'_>) -> bool + Sync + 'a;

fn run(views: &[View; 6], tables: &Tables, goal: &Goal<'_>) {
    match tables.guides() {
        Guides::Near(guide) => run_with(&guide, views, tables, goal),
        Guides::Wide(guide) => run_with(&guide, views, tables, goal),
    }
}

/// Where the searches of a view begin.
#[derive(Clone, Copy)]
struct Start<'a> {
    view: &'a View,
    place: Place,
    /// Least number of turns of its phase 1.
    distance: u8,
}

/// Shares out the searches: each length of phase 1, each view, and with several workers each first turn.
fn run_with<G: Guide>(guide: &G, views: &[View; 6], tables: &Tables, goal: &Goal<'_>) {
    let starts = views.each_ref().map(|view| {
        let place = tables.frames.place(&view.cube);
        Start { view, place, distance: guide.distance(place) }
    });
    let workers = goal.watch.workers.count().max(1);
    let parts = if workers > 1 { 18 } else { 1 };
    let next = AtomicUsize::new(0);
    goal.watch.workers.run(workers, &|_| {
        let mut walk = Walk {
            guide,
            tables,
            bounds: tables.bounds(),
            goal,
            view: &views[0],
            path: [0; LONGEST + 1],
            first: [(0, 0); LONGEST + 1],
            others: [(0, 0); LONGEST + 1],
            others_known: 0,
            home: tables.orders.home(),
            children: vec![[Child::default(); 18]; LONGEST],
            grandchildren: vec![Child::default(); 18 * 18],
            siblings: 0,
            nodes: 0,
        };
        loop {
            let task = next.fetch_add(1, Relaxed);
            let (length, view, part) = (task / (6 * parts), task / parts % 6, task % parts);
            if length > usize::from(goal.bound.load(Relaxed)) || length >= LONGEST {
                break;
            }
            if usize::from(starts[view].distance) <= length {
                let turns = if parts == 1 { ALL_TURNS } else { 1 << part };
                walk.begin(starts[view], length as u8, turns);
            }
            if goal.over.load(Relaxed) {
                break;
            }
        }
        goal.nodes.fetch_add(walk.nodes, Relaxed);
    });
}

/// One worker's way through a view.
struct Walk<'a, G> {
    guide: &'a G,
    tables: &'a Tables,
    bounds: Bounds<'a>,
    goal: &'a Goal<'a>,
    view: &'a View,
    /// Turns of phase 1, then of phase 2.
    path: [u8; LONGEST + 1],
    /// Corners and upper edges after each turn of phase 1.
    first: [(u16, u16); LONGEST + 1],
    /// The same of the lower and the middle edges, which are seldom asked for, for as many turns as are known.
    others: [(u16, u16); LONGEST + 1],
    others_known: usize,
    home: State,
    /// Neighbours of the state at each depth of phase 1.
    children: Vec<[Child; 18]>,
    /// Neighbours of all neighbours of a state three turns before the end of phase 1.
    grandchildren: Vec<Child>,
    /// Solutions with the first phase at hand.
    siblings: usize,
    /// Not yet added to all.
    nodes: u64,
}

impl<'a, G: Guide> Walk<'a, G> {
    /// Walks all first phases of a view that take `length` turns, the first of which is one of
    /// `turns`.
    fn begin(&mut self, start: Start<'a>, length: u8, turns: u32) {
        let Start { view, place, distance } = start;
        self.view = view;
        let [corners, upper, lower, middle]: Quads = view.orders;
        (self.first[0], self.others[0]) = ((corners, upper), (lower, middle));
        self.others_known = 0;
        if length == 0 {
            // With parts, the first one is enough.
            if turns & 1 == 1 {
                self.end_phase1(0);
            }
            return;
        }
        let entry = self.guide.entry(place);
        self.phase1((place, entry, distance), 0, length, turns);
    }

    /// Walks all first phases that take `left` more turns, the next of which is one of `turns`.
    fn phase1(&mut self, at: (Place, u32, u8), depth: usize, left: u8, turns: u32) {
        // Where only FAR is known, some states are looked at in vain: they do not count, so that the count is the same
        // with either table.
        self.nodes += u64::from(left < FAR);
        let guide = self.guide;
        let symmetry = usize::from(at.0.symmetry);
        match left {
            1 => return self.last(at, depth, turns),
            3 => return self.last_three(at, depth, turns),
            _ => {}
        }
        let count = guide.children(at, turns, left - 1, &mut self.children[depth]);
        for i in 0..count {
            let child = self.children[depth][i];
            // A first phase that is over early is walked at its own length.
            if child.distance == 0 {
                continue;
            }
            let (turn, place, turns) = self.seen(symmetry, &child);
            self.step(depth, turn);
            self.phase1((place, child.entry, child.distance), depth + 1, left - 1, turns);
            if self.goal.over.load(Relaxed) {
                return;
            }
        }
        if left > CHECKED {
            self.check();
        }
    }

    /// The ends that are one turn away.
    #[inline]
    fn last(&mut self, at: (Place, u32, u8), depth: usize, turns: u32) {
        let symmetry = usize::from(at.0.symmetry);
        let mut last = self.guide.last(at, turns);
        while last != 0 {
            let turn = last.trailing_zeros() as usize;
            self.step(depth, self.tables.frames.turned.back[symmetry][turn]);
            last &= last - 1;
            self.end_phase1(depth + 1);
        }
    }

    /// As [`Walk::phase1`] does, but looks up all that is two turns away before it goes there, so that these reads wait
    /// for memory together.
    fn last_three(&mut self, at: (Place, u32, u8), depth: usize, turns: u32) {
        let guide = self.guide;
        let symmetry = usize::from(at.0.symmetry);
        let count = guide.children(at, turns, 2, &mut self.children[depth]);
        let (mut ends, mut known) = ([0; 18], 0);
        for (i, end) in ends.iter_mut().enumerate().take(count) {
            let child = self.children[depth][i];
            if child.distance != 0 {
                let (_, place, turns) = self.seen(symmetry, &child);
                let at = (place, child.entry, child.distance);
                known += guide.children(at, turns, 1, &mut self.grandchildren[known..]);
            }
            *end = known;
        }
        let mut next = 0;
        for (i, &end) in ends.iter().enumerate().take(count) {
            let child = self.children[depth][i];
            if child.distance == 0 {
                continue;
            }
            self.nodes += 1;
            let (turn, place, _) = self.seen(symmetry, &child);
            self.step(depth, turn);
            for grandchild in next..end {
                let grandchild = self.grandchildren[grandchild];
                if grandchild.distance == 0 {
                    continue;
                }
                self.nodes += 1;
                let (turn, place, turns) = self.seen(usize::from(place.symmetry), &grandchild);
                self.step(depth + 1, turn);
                self.last((place, grandchild.entry, grandchild.distance), depth + 2, turns);
                if self.goal.over.load(Relaxed) {
                    return;
                }
            }
            next = end;
        }
    }

    /// A neighbour's turn and its place as the cube has them, and the turns that may follow.
    #[inline]
    fn seen(&self, symmetry: usize, child: &Child) -> (u8, Place, u32) {
        let turned = &self.tables.frames.turned;
        let turn = turned.back[symmetry][usize::from(child.turn)];
        let symmetry = turned.after[usize::from(child.place.symmetry)][symmetry];
        let turns = turned.may_follow[usize::from(symmetry)][usize::from(turn)];
        (turn, Place { symmetry, ..child.place }, turns)
    }

    /// Takes a turn of phase 1.
    #[inline]
    fn step(&mut self, depth: usize, turn: u8) {
        self.path[depth] = turn;
        // Nearly every way comes to an end, and until then there is time to read.
        let orders = self.bounds.orders;
        let (corners, upper) = self.first[depth];
        self.first[depth + 1] = (orders.corners(corners, turn), orders.quad(upper, turn));
        self.others_known = self.others_known.min(depth);
    }

    /// Whether the search is over.
    fn check(&mut self) {
        let goal = self.goal;
        let nodes = goal.nodes.fetch_add(self.nodes, Relaxed) + self.nodes;
        self.nodes = 0;
        let found = goal.bound.load(Relaxed) < LONGEST as u8 - 1;
        if found && (nodes > goal.budget.nodes || goal.watch.stop.load(Relaxed)) {
            goal.over.store(true, Relaxed);
        }
    }

    fn end_phase1(&mut self, depth: usize) {
        self.nodes += 1;
        let Some(mut left) = self.goal.bound.load(Relaxed).checked_sub(depth as u8) else { return };
        if left > FIRST_PHASE2 && depth < usize::from(UNCAPPED) {
            let shortest = depth as u8 + FIRST_PHASE2 + 1;
            self.goal.missed.fetch_min(shortest, Relaxed);
            left = FIRST_PHASE2;
        }
        left = left.min(LONGEST_PHASE2);
        let orders = self.bounds.orders;
        let (corners, upper) = self.first[depth];
        let upper = orders.four(upper);
        let least = self.bounds.of_four(corners, 0, upper);
        if least > left {
            return;
        }
        while self.others_known < depth {
            let (k, turn) = (self.others_known, self.path[self.others_known]);
            self.others[k + 1] = {
                let (lower, middle) = self.others[k];
                (orders.quad(lower, turn), orders.quad(middle, turn))
            };
            self.others_known += 1;
        }
        let (lower, middle) = self.others[depth];
        let state = State { corners, upper, lower: orders.four(lower), middle: middle as u8 };
        let least = least
            .max(self.bounds.of_eight(corners, (state.upper, state.lower)))
            .max(self.bounds.of_middle(corners, state.middle));
        self.siblings = 0;
        for length in least..=left {
            if !self.phase2(state, depth, length) {
                return;
            }
        }
    }

    /// Finds what solves the state in exactly `left` turns of phase 2; tells whether more is wanted.
    fn phase2(&mut self, state: State, depth: usize, left: u8) -> bool {
        if left == 0 {
            if state != self.home {
                return true;
            }
            self.siblings += 1;
            let turns = self.view.turns_of_cube(&self.path[..depth]);
            return (self.goal.found)(turns, self.siblings - 1, self.goal);
        }
        for (k, &turn) in PHASE2_TURNS.iter().enumerate() {
            if depth > 0 && repeats(self.path[depth - 1], turn as u8) {
                continue;
            }
            let Some(next) = self.bounds.turned(state, k, left - 1) else { continue };
            self.path[depth] = turn as u8;
            if !self.phase2(next, depth + 1, left - 1) {
                return false;
            }
        }
        true
    }
}

/// Whether a turn after `last` is of the same face, or of the opposite one in the order that is not walked.
#[inline]
fn repeats(last: u8, turn: u8) -> bool {
    let (last, face) = (last / 3, turn / 3);
    last == face || last == face + 3
}

#[cfg(test)]
mod tests {
    use super::super::tables::tests::TABLES;
    use super::*;
    use crate::cube::parse_turns;

    #[test]
    fn solutions_solve_and_a_larger_budget_never_makes_them_longer() {
        let budget = Budget { nodes: 20_000, max_length: 0 };
        for seed in 0..100 {
            let cube = Cube::scrambled(seed);

            let first = solve(&cube, &TABLES, &Budget::FIRST);
            let better = solve(&cube, &TABLES, &budget);

            assert!(cube.apply_all(&first.turns).is_solved());
            assert!(cube.apply_all(&better.turns).is_solved());
            assert!(better.turns.len() <= first.turns.len());
            assert_eq!(better, solve(&cube, &TABLES, &budget));
        }
    }

    #[test]
    fn short_scrambles_are_undone_in_no_more_turns_and_it_is_proven() {
        for text in ["", "R", "U2 D'", "R U R' U'", "F B2 L' D R2 U"] {
            let turns = parse_turns(text).unwrap();
            let cube = Cube::SOLVED.apply_all(&turns);

            let solution = solve(&cube, &TABLES, &Budget::UNTIL_PROVEN);

            assert_eq!(solution.turns.len(), turns.len(), "{text}");
            assert!(cube.apply_all(&solution.turns).is_solved());
            assert!(solution.proven);
        }
    }

    #[test]
    fn a_search_that_is_cut_short_proves_nothing() {
        let solution = solve(&Cube::scrambled(1), &TABLES, &Budget::FIRST);

        assert!(!solution.proven);
    }

    #[test]
    fn a_search_is_stopped_from_outside_and_tells_what_it_finds() {
        let told = Mutex::new(Vec::new());
        let stop = AtomicBool::new(false);
        let improved = |turns: &[Turn]| {
            told.lock().unwrap().push(turns.len());
            stop.store(told.lock().unwrap().len() == 2, Relaxed);
        };
        let watch = Watch { workers: &InTurn, stop: &stop, improved: &improved, longest: None };

        let solution = solve_watched(&Cube::scrambled(1), &TABLES, &Budget::UNTIL_PROVEN, &watch);

        let told = told.into_inner().unwrap();
        assert_eq!(told.last(), Some(&solution.turns.len()));
        assert!(told.len() >= 2 && told.is_sorted_by(|a, b| a > b));
    }
}
