//! The two-phase search, by iterative deepening over the length of phase 1.
//!
//! Phase 1 may lead into the group of any of three axes, and the inverse cube has solutions of
//! equal length. The six views of a cube are therefore searched in turn: all six with first phases
//! of one length, then all six with first phases of one turn more. Each solution lowers the bound
//! on the length of the next ones. Several workers share out the first turns and have one bound in
//! common.
//!
//! A node is a state of phase 1 that the search visits, or the end of a first phase. The number of
//! nodes does not depend on the set of tables, so a budget of nodes gives the same answer with
//! either set.
//!
//! - in: a [`Cube`], [`Tables`], a [`Budget`], a [`Watch`]
//! - out: a [`Solution`]
//! - source: H. Kociemba, <http://kociemba.org/cube.htm>

use super::coordinates::PHASE2_TURNS;
use super::phase1::{ALL_TURNS, Child, FAR, Guide, Place};
use super::phase2::{Bounds, Quads, State};
use super::table::{InTurn, Workers};
use super::tables::{Phase1Table, Tables};
use super::views::View;
use crate::cube::{Cube, Turn};
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, AtomicUsize, Ordering::Relaxed};
use std::sync::{Mutex, PoisonError};

/// Limits of a search.
///
/// ```
/// use rubik_robot_solver::cube::{Cube, parse_turns};
/// use rubik_robot_solver::{Budget, Tables, solve};
///
/// let tables = Tables::build();
/// let cube = Cube::SOLVED.apply_all(&parse_turns("R U F")?);
/// // Without limits, the search goes on until no shorter solution is possible.
/// let solution = solve(&cube, &tables, &Budget::UNTIL_PROVEN);
/// assert!(solution.proven && solution.turns.len() == 3);
/// # Ok::<(), rubik_robot_solver::cube::ParseTurns>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Budget {
    /// Number of nodes after which the search ends. It always finds a first solution, even beyond
    /// this number.
    pub nodes: u64,
    /// Number of turns that is good enough: the search ends at a solution of at most this length.
    pub max_length: u8,
}

impl Budget {
    /// Budget for the first solution.
    pub const FIRST: Self = Self { nodes: 0, max_length: u8::MAX };
    /// Budget without limits: the search ends at a solution that is proven to be shortest.
    pub const UNTIL_PROVEN: Self = Self { nodes: u64::MAX, max_length: 0 };
}

/// Turns that solve a cube.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Solution {
    /// Turns in their order; none for a solved cube, or if the search ended without a solution
    /// because of [`Watch::longest`].
    pub turns: Vec<Turn>,
    /// Number of nodes visited.
    pub nodes: u64,
    /// Whether the search has proven that no solution is shorter.
    pub proven: bool,
}

/// Workers of a search, and its connections to the caller.
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    /// Workers that share the search. Several find a solution of the same length as one does, but
    /// not always the same turns.
    pub workers: &'a dyn Workers,
    /// Flag that ends the search as soon as there is any solution.
    pub stop: &'a AtomicBool,
    /// Listener that gets each better solution when the search finds it.
    pub improved: &'a (dyn Fn(&[Turn]) + Sync),
    /// Listener that gets each number of turns of which a search for the shortest solution has
    /// proven that no solution has it or fewer.
    pub excluded: &'a (dyn Fn(u8) + Sync),
    /// Length of the longest solution that the caller can use (turns). With it, the search may end
    /// without a solution.
    pub longest: Option<u8>,
}

impl Watch<'_> {
    /// Returns the watch of a search with one worker that nobody stops or listens to.
    fn alone() -> Self {
        static NEVER: AtomicBool = AtomicBool::new(false);
        Self { workers: &InTurn, stop: &NEVER, improved: &|_| (), excluded: &|_| (), longest: None }
    }
}

/// One more than the number of turns that every cube can be solved in: 12 in phase 1, 18 in phase
/// 2.
pub(super) const LONGEST: usize = 31;
/// Length of the longest second phase after a short first phase (turns). Longer second phases take
/// long to refute, and a slightly longer first phase often has a shorter one.
const FIRST_PHASE2: u8 = 12;
/// Number of turns that suffice for every state of phase 2.
const LONGEST_PHASE2: u8 = 18;
/// Length of the first phases from which on second phases are not capped, so that each cube gets a
/// solution (turns). No state needs more than 12 turns of phase 1.
const UNCAPPED: u8 = 13;

/// Number of remaining turns of phase 1 above which a worker checks for the end of the search,
/// after it has searched that subtree.
const CHECKED: u8 = 4;

/// Searches for ever shorter solutions until the budget is spent, with one worker, and returns the
/// shortest one found. The result is the same on every machine.
///
/// ```
/// use rubik_robot_solver::cube::Cube;
/// use rubik_robot_solver::{Budget, Tables, solve};
///
/// let (cube, tables) = (Cube::scrambled(2007), Tables::build());
/// let first = solve(&cube, &tables, &Budget::FIRST);
/// let better = solve(&cube, &tables, &Budget { nodes: 200_000, max_length: 0 });
/// assert!(better.turns.len() <= first.turns.len());
/// assert!(cube.apply_all(&better.turns).is_solved());
/// ```
#[must_use]
pub fn solve(cube: &Cube, tables: &Tables, budget: &Budget) -> Solution {
    let watch = Watch::alone();
    solve_watched(cube, tables, budget, &watch)
}

/// Searches for ever shorter solutions until the budget is spent or `watch` stops the search, with
/// the workers of `watch`. Returns the shortest one found.
///
/// ```
/// use rubik_robot_solver::cube::{Cube, parse_turns};
/// use rubik_robot_solver::table::InTurn;
/// use rubik_robot_solver::{Budget, Tables, Watch, solve_watched};
/// use std::sync::Mutex;
/// use std::sync::atomic::AtomicBool;
///
/// let tables = Tables::build();
/// let cube = Cube::SOLVED.apply_all(&parse_turns("R U F")?);
/// let lengths = Mutex::new(Vec::new());
/// let improved = |turns: &[_]| lengths.lock().unwrap().push(turns.len());
/// let stop = AtomicBool::new(false);
/// let watch = Watch {
///     workers: &InTurn,
///     stop: &stop,
///     improved: &improved,
///     excluded: &|_| (),
///     longest: None,
/// };
///
/// let solution = solve_watched(&cube, &tables, &Budget::UNTIL_PROVEN, &watch);
/// assert_eq!(lengths.lock().unwrap().last(), Some(&solution.turns.len()));
/// // A caller that can only use two turns gets none.
/// let watch = Watch { longest: Some(2), ..watch };
/// assert!(solve_watched(&cube, &tables, &Budget::UNTIL_PROVEN, &watch).turns.is_empty());
/// # Ok::<(), rubik_robot_solver::cube::ParseTurns>(())
/// ```
#[must_use]
pub fn solve_watched(cube: &Cube, tables: &Tables, budget: &Budget, watch: &Watch<'_>) -> Solution {
    let best = Mutex::new(None::<Vec<Turn>>);
    // 30 turns always suffice. If the caller can use only shorter solutions, `Walk::check` may end
    // the search without a solution.
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
                // From here on only a shorter solution is of use.
                goal.bound.store(length.saturating_sub(1), Relaxed);
                if length == 0 || length <= budget.max_length {
                    goal.over.store(true, Relaxed);
                }
            }
            // Longer second phases of the same first phase are of no use.
            false
        },
    };
    let views = View::all(cube);
    run(&views, tables, &goal);
    let (over, missed) = (goal.over.load(Relaxed), goal.missed.load(Relaxed));
    let nodes = goal.nodes.load(Relaxed);
    let turns = best.into_inner().unwrap_or_else(PoisonError::into_inner).unwrap_or_default();
    // A search that ran to its end has refuted all shorter solutions, except those with a second
    // phase that was capped.
    let proven = cube.is_solved() || !turns.is_empty() && !over && turns.len() as u8 <= missed;
    Solution { turns, nodes, proven }
}

/// Passes all solutions of up to `bound` turns to `take`, in the order of the lengths of their
/// first phases, until `take` returns [`Continuation::Enough`] or the search has visited `nodes`
/// nodes.
///
/// `take` also gets the number of earlier solutions with the same first phase. The search finds
/// some solutions more than once.
pub(super) fn each_solution(
    cube: &Cube,
    tables: &Tables,
    bound: u8,
    nodes: u64,
    take: &(dyn Fn(Vec<Turn>, usize) -> Continuation + Sync),
) {
    let watch = Watch::alone();
    let goal = Goal {
        budget: &Budget { nodes, max_length: 0 },
        watch: &watch,
        bound: AtomicU8::new(bound),
        nodes: AtomicU64::new(0),
        over: AtomicBool::new(false),
        missed: AtomicU8::new(u8::MAX),
        found: &|turns, siblings, goal| match take(turns, siblings) {
            Continuation::More => true,
            Continuation::NextPhase1 => false,
            Continuation::Enough => {
                goal.over.store(true, Relaxed);
                false
            }
        },
    };
    run(&View::all(cube), tables, &goal);
}

/// Continuation of the search after a solution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Continuation {
    /// Search for the next solution.
    More,
    /// Skip further solutions with the same first phase.
    NextPhase1,
    /// End the search.
    Enough,
}

/// State that all workers of a search share.
struct Goal<'a> {
    budget: &'a Budget,
    watch: &'a Watch<'a>,
    /// Length of the longest solution that is of use (turns).
    bound: AtomicU8,
    /// Number of nodes that all workers have visited.
    nodes: AtomicU64,
    /// Whether the search is to end.
    over: AtomicBool,
    /// Length of the shortest solution that the search may have missed because it capped second
    /// phases (turns).
    missed: AtomicU8,
    /// Function that takes a solution and the number of earlier ones with the same first phase. It
    /// returns whether further solutions with that first phase are wanted.
    found: &'a Found<'a>,
}

/// Type of [`Goal::found`].
type Found<'a> = dyn Fn(Vec<Turn>, usize, &Goal<'_>) -> bool + Sync + 'a;

/// Searches all views of a cube with the small or the large table of phase 1, whichever `tables`
/// has. The search is compiled once for each kind of table, so that its inner loops need not ask
/// which one it is.
fn run(views: &[View; 6], tables: &Tables, goal: &Goal<'_>) {
    match tables.phase1_table() {
        Phase1Table::Near(guide) => run_with(&guide, views, tables, goal),
        Phase1Table::Wide(guide) => run_with(&guide, views, tables, goal),
    }
}

/// Root of the searches of a view.
#[derive(Clone, Copy)]
struct Start<'a> {
    view: &'a View,
    place: Place,
    /// Lower bound on the number of turns of its phase 1.
    distance: u8,
}

/// Searches all views of a cube with the workers of `goal`, which share out the tasks: one task for
/// each length of phase 1 and each view, and with several workers for each first turn as well.
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
            solved: tables.orders.solved(),
            children: vec![[Child::default(); 18]; LONGEST],
            grandchildren: vec![Child::default(); 18 * 18],
            siblings: 0,
            nodes: 0,
        };
        loop {
            let task = next.fetch_add(1, Relaxed);
            // The length is the slowest digit: short first phases of all views come first.
            let (length, view, part) = (task / (6 * parts), task / parts % 6, task % parts);
            // The first phase alone would be longer than a useful solution, here and in all later
            // tasks.
            if length > usize::from(goal.bound.load(Relaxed)) || length >= LONGEST {
                break;
            }
            // With a lower bound above the length, the task has no solution.
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

/// Depth-first walk of one worker through a view.
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
    /// Lower and middle edges after each turn of phase 1, valid up to `others_known`. Most ends of
    /// a first phase are rejected before these edges are needed.
    others: [(u16, u16); LONGEST + 1],
    /// Number of turns up to which `others` is valid.
    others_known: usize,
    solved: State,
    /// Neighbours of the state at each depth of phase 1.
    children: Vec<[Child; 18]>,
    /// Neighbours of all neighbours of a state three turns before the end of phase 1.
    grandchildren: Vec<Child>,
    /// Number of solutions with the current first phase.
    siblings: usize,
    /// Number of nodes that are not yet added to the total.
    nodes: u64,
}

impl<'a, G: Guide> Walk<'a, G> {
    /// Searches all first phases of a view that take `length` turns and begin with one of `turns`
    /// (bits), and the second phases after them.
    fn begin(&mut self, start: Start<'a>, length: u8, turns: u32) {
        let Start { view, place, distance } = start;
        self.view = view;
        let [corners, upper, lower, middle]: Quads = view.orders;
        (self.first[0], self.others[0]) = ((corners, upper), (lower, middle));
        self.others_known = 0;
        if length == 0 {
            // Without a first turn there is nothing to share out: the first part does it alone.
            if turns & 1 == 1 {
                self.end_phase1(0);
            }
            return;
        }
        let entry = self.guide.entry(place);
        self.phase1((place, entry, distance), 0, length, turns);
    }

    /// Searches all continuations of phase 1 that take `left` more turns, the next of which is one
    /// of `turns` (bits), and the second phases after them. `at` is the state after `depth` turns,
    /// its entry and its distance.
    fn phase1(&mut self, at: (Place, u32, u8), depth: usize, left: u8, turns: u32) {
        // The small table does not distinguish distances of FAR and more, so it visits states in
        // vain that the large one rejects. These do not count: the count is equal with either.
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
            // The goal of phase 1 is reached early: the task of that shorter length finds it.
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

    /// Makes each of `turns` (bits) that ends phase 1 from the state `at`, and searches the second
    /// phases after it.
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

    /// Searches the last three turns of phase 1 as [`Walk::phase1`] does, but reads all states that
    /// are two turns away before it visits the first of them. A read of the table misses the cache
    /// and waits for memory; these reads wait together.
    fn last_three(&mut self, at: (Place, u32, u8), depth: usize, turns: u32) {
        let guide = self.guide;
        let symmetry = usize::from(at.0.symmetry);
        let count = guide.children(at, turns, 2, &mut self.children[depth]);
        // The grandchildren of all children lie in one list; `ends[i]` is the end of child i's
        // part.
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
                // Here too, the goal of phase 1 is reached early.
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

    /// Converts a child, which the tables describe on the representative of a class, into the frame
    /// of the view. `symmetry` leads from the view to the representative before the child's turn.
    /// Returns the turn and the state after it in that frame, and the turns that may follow (bits).
    #[inline]
    fn seen(&self, symmetry: usize, child: &Child) -> (u8, Place, u32) {
        let turned = &self.tables.frames.turned;
        let turn = turned.back[symmetry][usize::from(child.turn)];
        let symmetry = turned.after[usize::from(child.place.symmetry)][symmetry];
        let turns = turned.may_follow[usize::from(symmetry)][usize::from(turn)];
        (turn, Place { symmetry, ..child.place }, turns)
    }

    /// Makes `turn` in phase 1 after `depth` turns: adds it to the path and computes the corners
    /// and upper edges after it.
    #[inline]
    fn step(&mut self, depth: usize, turn: u8) {
        self.path[depth] = turn;
        // Nearly every path reaches an end of phase 1, which needs corners and upper edges. Read
        // here, they arrive while phase 1 still waits for its own reads.
        let orders = self.bounds.orders;
        let (corners, upper) = self.first[depth];
        self.first[depth + 1] = (orders.corners(corners, turn), orders.quad(upper, turn));
        self.others_known = self.others_known.min(depth);
    }

    /// Adds the nodes that this worker has visited to the total. Ends the search if the budget is
    /// spent or the caller wants to stop, unless the caller still needs a first solution.
    fn check(&mut self) {
        let goal = self.goal;
        let nodes = goal.nodes.fetch_add(self.nodes, Relaxed) + self.nodes;
        self.nodes = 0;
        // The bound is below its start value if there is a solution, or if the caller can use only
        // short ones and accepts that there is none.
        let found = goal.bound.load(Relaxed) < LONGEST as u8 - 1;
        if found && (nodes > goal.budget.nodes || goal.watch.stop.load(Relaxed)) {
            goal.over.store(true, Relaxed);
        }
    }

    /// Searches all second phases after the first `depth` turns, the shortest first.
    fn end_phase1(&mut self, depth: usize) {
        self.nodes += 1;
        let Some(mut left) = self.goal.bound.load(Relaxed).checked_sub(depth as u8) else { return };
        // The cap makes the first solution fast; `missed` keeps record of what it may cost.
        if left > FIRST_PHASE2 && depth < usize::from(UNCAPPED) {
            let shortest = depth as u8 + FIRST_PHASE2 + 1;
            self.goal.missed.fetch_min(shortest, Relaxed);
            left = FIRST_PHASE2;
        }
        left = left.min(LONGEST_PHASE2);
        // The bound of the corners and upper edges, which are known already, rejects most ends.
        let orders = self.bounds.orders;
        let (corners, upper) = self.first[depth];
        let upper = orders.four(upper);
        let least = self.bounds.of_four(corners, 0, upper);
        if least > left {
            return;
        }
        // Only here are the other edges worth their reads. They are known already up to the turns
        // that this path shares with the last one.
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

    /// Finds the solutions of the state with exactly `left` turns of phase 2. Returns whether
    /// further solutions with this first phase are wanted.
    fn phase2(&mut self, state: State, depth: usize, left: u8) -> bool {
        if left == 0 {
            if state != self.solved {
                return true;
            }
            self.siblings += 1;
            let turns = self.view.turns_of_cube(&self.path[..depth]);
            return (self.goal.found)(turns, self.siblings - 1, self.goal);
        }
        for (k, &turn) in PHASE2_TURNS.iter().enumerate() {
            // At the first turn of phase 2 this compares with the last turn of phase 1.
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

/// Returns whether a turn is superfluous after `last`: it is of the same face, or of the opposite
/// one in the order that is not searched. Turns of opposite faces commute, so one order suffices.
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
    fn larger_budget_never_lengthens_solution() {
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
    fn short_scramble_gets_proven_solution_of_its_length() {
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
    fn search_that_ends_early_marks_solution_as_unproven() {
        let solution = solve(&Cube::scrambled(1), &TABLES, &Budget::FIRST);

        assert!(!solution.proven);
    }

    #[test]
    fn search_reports_improvements_until_stopped() {
        let reported = Mutex::new(Vec::new());
        let stop = AtomicBool::new(false);
        let improved = |turns: &[Turn]| {
            reported.lock().unwrap().push(turns.len());
            stop.store(reported.lock().unwrap().len() == 2, Relaxed);
        };
        let watch = Watch {
            workers: &InTurn,
            stop: &stop,
            improved: &improved,
            excluded: &|_| (),
            longest: None,
        };

        let solution = solve_watched(&Cube::scrambled(1), &TABLES, &Budget::UNTIL_PROVEN, &watch);

        let reported = reported.into_inner().unwrap();
        assert_eq!(reported.last(), Some(&solution.turns.len()));
        assert!(reported.len() >= 2 && reported.is_sorted_by(|a, b| a > b));
    }
}
