//! Phase 2: how far a cube of the group <U, D, R2, L2, F2, B2> is from solved.
//!
//! A state is the order of the corners, of the eight up and down edges, and of the four middle ones. No table knows
//! all three; each knows two, and the farthest of them is a bound from below: corners with the middle edges, the
//! eight edges with the middle ones, and the eight edges with the places of the upper corners. With the large set,
//! corners and the eight edges in full come to it.

use super::coordinates::{
    CHOICES, PERMUTATIONS, PHASE2_TURNS, QUADS, corner_moves, edge_moves, quad_moves, quad_places,
    rank, upper_corner_moves, upper_corners,
};
use super::table::{Progress, TableSpec, Workers};

/// States of the small tables, one after the other.
const SIZES: [usize; 3] = [PERMUTATIONS * 24, PERMUTATIONS * 24, PERMUTATIONS * CHOICES];

/// The three small tables of phase 2, a byte a state.
pub static SMALL: TableSpec = TableSpec {
    name: "phase2",
    version: 1,
    bytes: SIZES[0] + SIZES[1] + SIZES[2],
    purpose: "two-phase: bounds of the second phase",
    build: |workers, progress| build(&Orders::build(), workers, progress),
    verify,
};

/// Orders of the corners, of four edges each, and of the middle edges: what turns do to them.
#[derive(Debug)]
pub struct Orders {
    /// `[order * 18 + turn]`.
    corner_moves: Vec<u16>,
    /// `[quad * 18 + turn]`.
    quad_moves: Vec<u16>,
    /// `[order * 10 + k]`, k a turn of phase 2.
    edge_moves: Vec<u16>,
    /// `[order * 10 + k]`.
    middle_moves: Vec<u8>,
    upper_corners: Vec<u8>,
    /// Number of the choice of four of the eight upper and lower places, of each choice of twelve, or `u8::MAX`.
    choice_of_set: Vec<u8>,
    /// `[(choice * 24 + order of the first four) * 24 + order of the other four]`: the order of all eight.
    eight: Vec<u16>,
}

/// Order of corners, and quads of the edges from 0, 4, 8.
pub(super) type Quads = [u16; 4];

/// A state of phase 2: corners, eight edges, middle edges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct State {
    pub(super) corners: u16,
    pub(super) edges: u16,
    pub(super) middle: u8,
}

fn transposed<T: Copy + Default>(by_turn: &[T], turns: usize) -> Vec<T> {
    let states = by_turn.len() / turns;
    let mut table = vec![T::default(); by_turn.len()];
    for state in 0..states {
        for turn in 0..turns {
            table[state * turns + turn] = by_turn[turn * states + state];
        }
    }
    table
}

impl Orders {
    pub(super) fn build() -> Self {
        let quad_moves = transposed(&quad_moves(), 18);
        // The middle layer's own set of places is 0, so in phase 2 the number is the order alone.
        let middle = |i: usize| quad_moves[i / 10 * 18 + PHASE2_TURNS[i % 10]] as u8;
        let (choice_of_set, eight) = eights();
        Self {
            middle_moves: (0..240).map(middle).collect(),
            quad_moves,
            corner_moves: transposed(&corner_moves(), 18),
            edge_moves: transposed(&edge_moves(), 10),
            upper_corners: upper_corners(),
            choice_of_set,
            eight,
        }
    }

    pub(super) fn bytes(&self) -> usize {
        (self.corner_moves.len() + self.quad_moves.len() + self.edge_moves.len() + self.eight.len())
            * 2
            + self.middle_moves.len()
            + self.upper_corners.len()
            + self.choice_of_set.len()
    }

    /// Corners and middle edges after a turn.
    #[inline]
    pub(super) fn corners_middle(&self, (corners, middle): (u16, u16), turn: u8) -> (u16, u16) {
        let turn = usize::from(turn);
        (
            self.corner_moves[usize::from(corners) * 18 + turn],
            self.quad_moves[usize::from(middle) * 18 + turn],
        )
    }

    /// The other eight edges after a turn.
    #[inline]
    pub(super) fn up_down(&self, (up, down): (u16, u16), turn: u8) -> (u16, u16) {
        let turn = usize::from(turn);
        (
            self.quad_moves[usize::from(up) * 18 + turn],
            self.quad_moves[usize::from(down) * 18 + turn],
        )
    }

    /// The order of the eight edges of a cube in phase 2.
    #[inline]
    pub(super) fn eight(&self, (up, down): (u16, u16)) -> u16 {
        let choice = usize::from(self.choice_of_set[usize::from(up / 24)]);
        self.eight[(choice * 24 + usize::from(up % 24)) * 24 + usize::from(down % 24)]
    }
}

/// [`Orders::choice_of_set`] and [`Orders::eight`].
fn eights() -> (Vec<u8>, Vec<u16>) {
    let (mut choice_of_set, mut eight) = (vec![u8::MAX; QUADS / 24], Vec::new());
    let sets: Vec<usize> = (0..QUADS / 24)
        .filter(|set| quad_places(set * 24).iter().all(|&place| place < 8))
        .collect();
    for (choice, &set) in sets.iter().enumerate() {
        choice_of_set[set] = choice as u8;
        let taken = quad_places(set * 24);
        let others = |down: &usize| quad_places(down * 24).iter().all(|p| !taken.contains(p));
        let down_set = sets.iter().copied().find(others).unwrap_or(0);
        for up in 0..24 {
            for down in 0..24 {
                let mut edges = [0; 8];
                let places = [quad_places(set * 24 + up), quad_places(down_set * 24 + down)];
                for (edge, &place) in places.iter().flatten().enumerate() {
                    edges[usize::from(place)] = edge as u8;
                }
                eight.push(rank(&edges) as u16);
            }
        }
    }
    (choice_of_set, eight)
}

/// The tables at work.
#[derive(Clone, Copy)]
pub(super) struct Bounds<'a> {
    pub(super) orders: &'a Orders,
    pub(super) small: &'a [u8],
}

impl Bounds<'_> {
    /// A bound from the corners and the middle edges.
    #[inline]
    pub(super) fn of_corners(&self, corners: u16, middle: u8) -> u8 {
        self.small[usize::from(corners) * 24 + usize::from(middle)]
    }

    /// A bound from the eight edges and what else there is.
    #[inline]
    pub(super) fn of_edges(&self, state: State) -> u8 {
        let edges = usize::from(state.edges);
        let upper = usize::from(self.orders.upper_corners[usize::from(state.corners)]);
        let with_upper = self.small[SIZES[0] + SIZES[1] + edges * CHOICES + upper];
        with_upper.max(self.small[SIZES[0] + edges * 24 + usize::from(state.middle)])
    }

    /// The state after the `k`-th turn of phase 2, if it may be solved in `left` more.
    #[inline]
    pub(super) fn turned(&self, state: State, k: usize, left: u8) -> Option<State> {
        let orders = self.orders;
        let corners = orders.corner_moves[usize::from(state.corners) * 18 + PHASE2_TURNS[k]];
        let middle = orders.middle_moves[usize::from(state.middle) * 10 + k];
        if self.of_corners(corners, middle) > left {
            return None;
        }
        let edges = orders.edge_moves[usize::from(state.edges) * 10 + k];
        let next = State { corners, edges, middle };
        (self.of_edges(next) <= left).then_some(next)
    }
}

/// Builds [`SMALL`].
pub(super) fn build(orders: &Orders, workers: &dyn Workers, progress: Progress<'_>) -> Vec<u8> {
    let upper = transposed(&upper_corner_moves(), 10);
    let corner = |order: usize, k: usize| orders.corner_moves[order * 18 + PHASE2_TURNS[k]];
    let edge = |order: usize, k: usize| orders.edge_moves[order * 10 + k];
    let mut table = vec![0; SIZES.iter().sum()];
    let (corners_middle, rest) = table.split_at_mut(SIZES[0]);
    let (edges_middle, edges_upper) = rest.split_at_mut(SIZES[1]);
    let parts = [corners_middle, edges_middle, edges_upper].map(std::sync::Mutex::new);
    workers.run(3, &|part| {
        let mut out = parts[part].lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        match part {
            0 => distances(&mut out, &corner, &orders.middle_moves, 24),
            1 => distances(&mut out, &edge, &orders.middle_moves, 24),
            _ => distances(&mut out, &edge, &upper, CHOICES),
        }
        progress((part + 1) as f64 / 3.0);
    });
    drop(parts);
    table
}

/// Distances of (order of eight pieces, something else of `size` states), `[order * size + else]`, by the turns of
/// phase 2: `moved(order, k)` and `other_moves[else * 10 + k]`.
fn distances(
    table: &mut [u8],
    moved: &dyn Fn(usize, usize) -> u16,
    other_moves: &[u8],
    size: usize,
) {
    table.fill(u8::MAX);
    table[0] = 0;
    let (mut frontier, mut next, mut depth) = (vec![0_u32], Vec::new(), 0);
    while !frontier.is_empty() {
        depth += 1;
        for state in frontier.drain(..) {
            let (order, other) = (state as usize / size, state as usize % size);
            for k in 0..10 {
                let neighbour =
                    usize::from(moved(order, k)) * size + usize::from(other_moves[other * 10 + k]);
                if table[neighbour] == u8::MAX {
                    table[neighbour] = depth;
                    next.push(neighbour as u32);
                }
            }
        }
        std::mem::swap(&mut frontier, &mut next);
    }
}

/// No reference is known to us for these. That each state but the first has a neighbour nearer by one, and none by
/// two, says that the numbers are distances; then they are counted.
fn verify(table: &[u8], _: &dyn Workers) -> Result<Vec<u64>, String> {
    let orders = Orders::build();
    let upper = transposed(&upper_corner_moves(), 10);
    let corner = |order: usize, k: usize| orders.corner_moves[order * 18 + PHASE2_TURNS[k]];
    let edge = |order: usize, k: usize| orders.edge_moves[order * 10 + k];
    let check = |part: &[u8], moved: &dyn Fn(usize, usize) -> u16, others: &[u8], size: usize| {
        (0..part.len()).all(|state| {
            let (order, other) = (state / size, state % size);
            let to = |k: usize| {
                usize::from(moved(order, k)) * size + usize::from(others[other * 10 + k])
            };
            let nearest = (0..10).map(|k| part[to(k)]).min();
            if state == 0 { part[0] == 0 } else { nearest.map(|n| n + 1) == Some(part[state]) }
        })
    };
    let (corners_middle, rest) = table.split_at(SIZES[0]);
    let (edges_middle, edges_upper) = rest.split_at(SIZES[1]);
    let right = check(corners_middle, &corner, &orders.middle_moves, 24)
        && check(edges_middle, &edge, &orders.middle_moves, 24)
        && check(edges_upper, &edge, &upper, CHOICES);
    if !right {
        return Err("entries that are no distances".to_owned());
    }
    let mut counts = vec![0; 20];
    table.iter().for_each(|&d| counts[usize::from(d)] += 1);
    counts.truncate(counts.iter().rposition(|&c| c > 0).map_or(0, |last| last + 1));
    Ok(counts)
}
