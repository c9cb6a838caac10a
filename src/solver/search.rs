//! The two-phase search: six directions, deeper and deeper first phases, a bound that falls with each solution.
//!
//! A solution's first phase may stand in any of three axes, and the inverse cube has as many turns: six searches
//! that take turns, each at one length of phase 1 before any goes to the next.

use super::coordinates::{
    PERMUTATIONS, PHASE2_TURNS, QUADS, edge_order, flip, quad, quad_places, rank, twist,
};
use super::tables::{FAR, Tables};
use crate::cube::{Cube, Facelets, Rotation24, Turn};

/// How long to search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Budget {
    /// States looked at in both phases; the first solution is always found, whatever this says.
    pub nodes: u64,
    /// A solution with no more turns than this is good enough: the search ends there.
    pub max_length: u8,
}

impl Budget {
    /// The first solution.
    pub const FIRST: Self = Self { nodes: 0, max_length: u8::MAX };
}

/// Turns that solve a cube.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Solution {
    /// In order; none for a solved cube.
    pub turns: Vec<Turn>,
    /// States that were looked at.
    pub nodes: u64,
}

/// No first phase is longer than this with no gain.
const LONGEST: usize = 31;
/// A second phase of a first solution is at most this long: longer ones take long to refute.
const FIRST_PHASE2: u8 = 11;
/// Candidates that share a first phase: more of them would differ too little.
const SHARED_PHASE1: usize = 8;

/// The shortest solution that the budget finds.
#[must_use]
pub fn solve(cube: &Cube, tables: &Tables, budget: &Budget) -> Solution {
    let mut search = Search::new(tables, cube, budget.nodes);
    search.enough = Some(budget.max_length);
    search.run();
    Solution { turns: search.found.pop().unwrap_or_default(), nodes: search.nodes }
}

/// Up to `count` distinct solutions, shortest first, none more than three turns longer than the shortest found;
/// solutions that differ in the order of opposite turns only count as one. A tenth of the budget seeks the shortest,
/// the rest gathers. A solved cube has one candidate: no turns.
#[must_use]
pub fn candidates(cube: &Cube, tables: &Tables, budget: &Budget, count: usize) -> Vec<Vec<Turn>> {
    let first = Budget { nodes: budget.nodes / 10, ..*budget };
    let best = solve(cube, tables, &first);
    if best.turns.is_empty() {
        return vec![Vec::new()];
    }
    let mut search = Search::new(tables, cube, budget.nodes - budget.nodes / 10);
    search.bound = best.turns.len() as u8 + 3;
    search.wanted = count;
    search.found.push(canonical(best.turns));
    search.run();
    search.found.sort_by(|a, b| (a.len(), a).cmp(&(b.len(), b)));
    search.found
}

/// The same turns with each pair of opposite ones in the order of their faces.
fn canonical(mut turns: Vec<Turn>) -> Vec<Turn> {
    for i in 1..turns.len() {
        if turns[i].face == turns[i - 1].face.opposite() && turns[i].face < turns[i - 1].face {
            turns.swap(i, i - 1);
        }
    }
    turns
}

/// One of the six ways to look at a cube.
struct View {
    /// From the cube's frame into the view's.
    rotation: Rotation24,
    inverted: bool,
    /// Twist, flip, slice.
    start: (usize, usize, usize),
    distance: u8,
    /// Order of corners, and quads of the edges from 0, 4, 8.
    orders: [usize; 4],
}

impl View {
    fn all(cube: &Cube, tables: &Tables) -> Vec<Self> {
        // A third of a turn about the corner URF: up to right to front.
        let third = Rotation24::all()
            .find(|r| {
                use crate::cube::Face::{F, R, U};
                r.face(U) == R && r.face(R) == F
            })
            .unwrap_or(Rotation24::IDENTITY);
        let mut rotation = Rotation24::IDENTITY;
        let mut views = Vec::with_capacity(6);
        for _ in 0..3 {
            let straight = seen_from(cube, rotation);
            for inverted in [false, true] {
                let cube = if inverted { straight.inverse() } else { straight };
                let start = (twist(&cube), flip(&cube), quad(&cube, 8) / 24);
                views.push(Self {
                    rotation,
                    inverted,
                    start,
                    distance: tables.phase1_distance(start.0, start.1, start.2),
                    orders: [rank(&cube.corners), quad(&cube, 0), quad(&cube, 4), quad(&cube, 8)],
                });
            }
            rotation = third.after(rotation);
        }
        views
    }

    /// Turns of the view as turns of the cube.
    fn turns_of_cube(&self, path: &[u8]) -> Vec<Turn> {
        let back = self.rotation.inverse();
        let of_cube = |&t: &u8| {
            let turn = Turn::from_index(usize::from(t));
            Turn { face: back.face(turn.face), ..turn }
        };
        if self.inverted {
            path.iter().rev().map(|t| of_cube(t).inverse()).collect()
        } else {
            path.iter().map(of_cube).collect()
        }
    }
}

/// The cube as it is named by one who sees it turned over: stickers and colours renamed alike.
fn seen_from(cube: &Cube, rotation: Rotation24) -> Cube {
    let moved = Facelets::from(cube).rotated(rotation);
    let renamed = std::array::from_fn(|i| rotation.face(moved.colour(i)));
    Cube::try_from(Facelets::from_faces(renamed)).unwrap_or(*cube)
}

struct Search<'a> {
    tables: &'a Tables,
    views: Vec<View>,
    view: usize,
    /// Turns of phase 1, then of phase 2.
    path: [u8; LONGEST + 1],
    /// `orders` after each turn of phase 1, for as many turns as `known`.
    orders: [[usize; 4]; LONGEST + 1],
    known: usize,
    /// Longest solution that is of use.
    bound: u8,
    enough: Option<u8>,
    /// Gather this many instead of the best one; 0 for the best one.
    wanted: usize,
    found: Vec<Vec<Turn>>,
    nodes: u64,
    limit: u64,
    longest_phase2: u8,
    /// Candidates with the first phase that is walked now.
    shared: usize,
    over: bool,
}

impl<'a> Search<'a> {
    fn new(tables: &'a Tables, cube: &Cube, limit: u64) -> Self {
        Self {
            tables,
            views: View::all(cube, tables),
            view: 0,
            path: [0; LONGEST + 1],
            orders: [[0; 4]; LONGEST + 1],
            known: 0,
            bound: LONGEST as u8 - 1,
            enough: None,
            wanted: 0,
            found: Vec::new(),
            nodes: 0,
            limit,
            longest_phase2: FIRST_PHASE2,
            shared: 0,
            over: false,
        }
    }

    fn run(&mut self) {
        for length in 0..LONGEST as u8 {
            // Nothing needs more than 12 turns in phase 1 and 18 in phase 2.
            if length > 12 {
                self.longest_phase2 = 18;
            }
            for view in 0..self.views.len() {
                if length > self.bound || self.over {
                    return;
                }
                if self.views[view].distance > length {
                    continue;
                }
                self.view = view;
                self.orders[0] = self.views[view].orders;
                self.known = 0;
                let (start, distance) = (self.views[view].start, self.views[view].distance);
                self.phase1(start, distance, 0, length);
            }
        }
    }

    /// Walks all first phases that take `left` more turns from `state`.
    fn phase1(&mut self, state: (usize, usize, usize), distance: u8, depth: usize, left: u8) {
        if left == 0 {
            self.end_phase1(depth);
            return;
        }
        // All table reads of the 18 neighbours first, so that they wait for memory together.
        let mut neighbours = [((0, 0, 0), 0, 0); 18];
        let mut count = 0;
        for turn in 0..18_u8 {
            if depth == 0 || !repeats(self.path[depth - 1], turn) {
                let next = self.tables.phase1_turned(usize::from(turn), state);
                neighbours[count] = (next, turn, self.tables.phase1_entry(next));
                count += 1;
            }
        }
        let codes = neighbours.map(|(_, _, entry)| self.tables.phase1_code_at(entry));
        self.nodes += count as u64;
        for (&(next, turn, _), code) in neighbours[..count].iter().zip(codes) {
            let next_distance = neighbour_distance(distance, code);
            // A first phase that is over early is walked at its own length.
            if next_distance >= left || (next_distance == 0 && left > 1) {
                continue;
            }
            self.path[depth] = turn;
            self.known = self.known.min(depth);
            self.phase1(next, next_distance, depth + 1, left - 1);
            if self.over {
                return;
            }
        }
        self.over |= self.nodes > self.limit && !self.found.is_empty();
    }

    fn end_phase1(&mut self, depth: usize) {
        let Some(left) = self.bound.checked_sub(depth as u8) else { return };
        let left = left.min(self.longest_phase2);
        while self.known < depth {
            let turn = usize::from(self.path[self.known]);
            let [corners, rest @ ..] = self.orders[self.known];
            let [a, b, c] = rest.map(|q| usize::from(self.tables.quad_moves[turn * QUADS + q]));
            let corners = usize::from(self.tables.corner_moves[turn * PERMUTATIONS + corners]);
            self.known += 1;
            self.orders[self.known] = [corners, a, b, c];
        }
        let [corners, up, down, middle] = self.orders[depth];
        if self.tables.corners_middle[corners * 24 + middle] > left {
            return;
        }
        let state = (corners, eight_edges(up, down), middle);
        self.shared = 0;
        for length in self.tables.phase2_distance(state)..=left {
            if self.phase2(state, depth, length) {
                return;
            }
        }
    }

    /// Keeps what solves the state in exactly `left` turns of phase 2; tells whether that is enough.
    fn phase2(&mut self, state: (usize, usize, usize), depth: usize, left: u8) -> bool {
        if left == 0 {
            return state == (0, 0, 0) && self.keep(depth);
        }
        for (k, &turn) in PHASE2_TURNS.iter().enumerate() {
            if depth > 0 && repeats(self.path[depth - 1], turn as u8) {
                continue;
            }
            self.nodes += 1;
            let Some(next) = self.tables.phase2_turned(k, state, left) else { continue };
            self.path[depth] = turn as u8;
            if self.phase2(next, depth + 1, left - 1) {
                return true;
            }
        }
        false
    }

    /// Takes the path so far as a solution; tells whether no more of its first phase are wanted.
    fn keep(&mut self, length: usize) -> bool {
        let turns = self.views[self.view].turns_of_cube(&self.path[..length]);
        if self.wanted == 0 {
            self.over = self.enough.is_some_and(|e| length <= usize::from(e)) || length == 0;
            self.over |= self.nodes > self.limit;
            self.bound = (length as u8).saturating_sub(1);
            self.found = vec![turns];
            return true;
        }
        let turns = canonical(turns);
        if !self.found.contains(&turns) {
            self.found.push(turns);
            self.shared += 1;
        }
        self.over = self.found.len() >= self.wanted;
        self.over || self.shared >= SHARED_PHASE1
    }
}

/// Whether a turn after `last` is of the same face, or of the opposite one in the order that is not walked.
#[inline]
fn repeats(last: u8, turn: u8) -> bool {
    let (last, face) = (last / 3, turn / 3);
    last == face || last == face + 3
}

/// The distance of a neighbour of a state at `distance`, from its code.
#[inline]
fn neighbour_distance(distance: u8, code: u8) -> u8 {
    if code == 3 {
        return FAR;
    }
    if distance == FAR {
        return FAR - 1;
    }
    match (code + 3 - distance % 3) % 3 {
        0 => distance,
        1 => distance + 1,
        _ => distance - 1,
    }
}

/// The order of the eight up and down edges from where each four of them are.
fn eight_edges(up: usize, down: usize) -> usize {
    let mut cube = Cube::SOLVED;
    for (edge, place) in quad_places(up).into_iter().chain(quad_places(down)).enumerate() {
        cube.edges[usize::from(place)] = edge as u8;
    }
    edge_order(&cube)
}

#[cfg(test)]
mod tests {
    use super::super::tables::tests::TABLES;
    use super::*;
    use crate::cube::parse_turns;

    #[test]
    fn solutions_solve_and_a_larger_budget_never_makes_them_longer() {
        for seed in 0..100 {
            let cube = Cube::scrambled(seed);

            let first = solve(&cube, &TABLES, &Budget::FIRST);
            let better = solve(&cube, &TABLES, &Budget { nodes: 200_000, max_length: 0 });

            assert!(cube.apply_all(&first.turns).is_solved());
            assert!(cube.apply_all(&better.turns).is_solved());
            assert!(better.turns.len() <= first.turns.len());
            assert_eq!(better, solve(&cube, &TABLES, &Budget { nodes: 200_000, max_length: 0 }));
        }
    }

    #[test]
    fn short_scrambles_are_undone_in_no_more_turns() {
        for text in ["", "R", "U2 D'", "R U R' U'", "F B2 L' D R2 U"] {
            let turns = parse_turns(text).unwrap();
            let cube = Cube::SOLVED.apply_all(&turns);

            let solution = solve(&cube, &TABLES, &Budget { nodes: 100_000, max_length: 0 });

            assert_eq!(solution.turns.len(), turns.len(), "{text}");
            assert!(cube.apply_all(&solution.turns).is_solved());
        }
    }

    #[test]
    fn candidates_are_distinct_and_each_solves() {
        let cube = Cube::scrambled(5);

        let list = candidates(&cube, &TABLES, &Budget { nodes: 1_000_000, max_length: 20 }, 10);

        assert_eq!(list.len(), 10);
        assert!(list.is_sorted_by_key(Vec::len));
        for (i, turns) in list.iter().enumerate() {
            assert!(cube.apply_all(turns).is_solved());
            assert!(!list[..i].contains(turns));
            assert!(turns.len() <= list[0].len() + 3);
        }
    }
}
