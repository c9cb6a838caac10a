//! Phase 2: how far a cube of the group <U, D, R2, L2, F2, B2> is from solved.
//!
//! A state is the order of the corners, where the four upper and the four lower edges are among eight places, and
//! the order of the middle ones. No table knows all; the farthest of three is a bound from below: corners with the
//! upper edges, corners with the lower ones (67.7 million states each, folded by 16 symmetries: 2768 classes of
//! corners), and corners with the middle edges.

use super::coordinates::{
    PERMUTATIONS, PHASE2_TURNS, QUADS, corner_moves, quad, quad_moves, quad_places, rank, unrank,
    with_quad,
};
use super::phase1::compare;
use super::symmetry::{SYMMETRIES, places};
use super::table::{Progress, TableSpec, Workers};
use std::sync::atomic::{AtomicU8, AtomicUsize, Ordering::Relaxed};

/// Where four edges are among eight places, in order.
const FOURS: usize = 1680;
/// Classes of corners.
const CORNER_CLASSES: usize = 2768;
/// A class's row: upper edges, then lower ones.
const ROW: usize = 2 * FOURS;
/// Bytes before corners with the middle edges.
const MIDDLE: usize = CORNER_CLASSES * ROW;

/// The tables of phase 2, a byte a state.
pub static BOUNDS: TableSpec = TableSpec {
    name: "phase2",
    version: 2,
    bytes: MIDDLE + PERMUTATIONS * 24,
    purpose: "two-phase: bounds of the second phase",
    build: |workers, progress| build(&Orders::build(), workers, progress),
    verify,
};

/// Orders of the corners, and of four edges each: what turns and symmetries do to them.
#[derive(Debug)]
pub struct Orders {
    /// `[order * 18 + turn]`.
    corner_moves: Vec<u16>,
    /// `[quad * 18 + turn]`.
    quad_moves: Vec<u16>,
    /// `[four * 10 + k]`, k a turn of phase 2.
    four_moves: Vec<u16>,
    /// `[order * 10 + k]`.
    middle_moves: Vec<u8>,
    /// The four of each set of places of a quad, its own order aside; `u16::MAX` where the places are not the eight.
    four_of_set: Vec<u16>,
    /// `[order]`: 16 * class + the symmetry that carries it to the class's representative.
    corner_class: Vec<u16>,
    /// `[(symmetry * 2 + lower) * FOURS + four]`.
    four_images: Vec<u16>,
    /// Which symmetries exchange up and down.
    swaps: [bool; SYMMETRIES],
    /// For each class of corners its representative, and its symmetries as bits.
    representatives: Vec<(u16, u16)>,
}

/// Order of corners, and quads of the edges from 0, 4, 8.
pub(super) type Quads = [u16; 4];

/// A state of phase 2: corners, upper, lower and middle edges.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct State {
    pub(super) corners: u16,
    pub(super) upper: u16,
    pub(super) lower: u16,
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
        let corner_moves = transposed(&corner_moves(), 18);
        let quad_moves = transposed(&quad_moves(), 18);
        // The middle layer's own set of places is 0, so in phase 2 the number is the order alone.
        let middle = |i: usize| quad_moves[i / 10 * 18 + PHASE2_TURNS[i % 10]] as u8;
        // Numbers of fours follow those of quads, places beyond the eight left out.
        let quads: Vec<usize> =
            (0..QUADS).filter(|&q| quad_places(q).iter().all(|&p| p < 8)).collect();
        let mut four_of_set = vec![u16::MAX; QUADS / 24];
        quads
            .iter()
            .enumerate()
            .step_by(24)
            .for_each(|(four, q)| four_of_set[q / 24] = four as u16);
        let four_of = |q: usize| four_of_set[q / 24] + (q % 24) as u16;
        let four_moves = quads
            .iter()
            .flat_map(|q| PHASE2_TURNS.map(|t| four_of(usize::from(quad_moves[q * 18 + t]))))
            .collect();
        let (corner_places, edge_places) = places();
        let swaps = edge_places.map(|edges| edges[0] >= 4);
        let mut four_images = Vec::with_capacity(SYMMETRIES * ROW);
        for edges in &edge_places {
            for lower in [0, 4] {
                for &q in &quads {
                    // Edges 8..12 of the cube stand for the four; they are renamed as the symmetry says.
                    let cube = with_quad(q);
                    let mut image = [u8::MAX; 12];
                    let swapped = if edges[lower] >= 4 { 4 } else { 0 };
                    for (place, &edge) in cube.edges.iter().enumerate() {
                        if edge >= 8 {
                            let piece = edges[usize::from(edge) - 8 + lower] - swapped;
                            image[usize::from(edges[place])] = piece + 8;
                        }
                    }
                    four_images.push(four_of(quad(&crate::cube::Cube { edges: image, ..cube }, 8)));
                }
            }
        }
        let (corner_class, representatives) = corner_classes(&corner_places);
        Self {
            middle_moves: (0..240).map(middle).collect(),
            corner_moves,
            quad_moves,
            four_moves,
            four_of_set,
            corner_class,
            four_images,
            swaps,
            representatives,
        }
    }

    pub(super) fn bytes(&self) -> usize {
        let words = [
            &self.corner_moves,
            &self.quad_moves,
            &self.four_moves,
            &self.four_of_set,
            &self.corner_class,
            &self.four_images,
        ];
        words.iter().map(|w| w.len() * 2).sum::<usize>()
            + self.middle_moves.len()
            + self.representatives.len() * 4
    }

    /// Corners after a turn.
    #[inline]
    pub(super) fn corners(&self, corners: u16, turn: u8) -> u16 {
        self.corner_moves[usize::from(corners) * 18 + usize::from(turn)]
    }

    /// A quad after a turn.
    #[inline]
    pub(super) fn quad(&self, quad: u16, turn: u8) -> u16 {
        self.quad_moves[usize::from(quad) * 18 + usize::from(turn)]
    }

    /// Where the four edges of a quad are among the eight places of phase 2.
    #[inline]
    pub(super) fn four(&self, quad: u16) -> u16 {
        self.four_of_set[usize::from(quad / 24)] + quad % 24
    }

    /// The number of a state in the table: corners and the four upper (0) or lower (1) edges.
    #[inline]
    fn entry(&self, corners: u16, lower: usize, four: u16) -> usize {
        let class = usize::from(self.corner_class[usize::from(corners)]);
        let symmetry = class & 15;
        let image = self.four_images[(symmetry * 2 + lower) * FOURS + usize::from(four)];
        let lower = lower ^ usize::from(self.swaps[symmetry]);
        (class >> 4) * ROW + lower * FOURS + usize::from(image)
    }

    /// The four of the lower edges of a solved cube; that of the upper ones is 0, too, by its own count.
    pub(super) fn home(&self) -> State {
        let cube = crate::cube::Cube::SOLVED;
        let four = |first: u8| self.four(quad(&cube, first) as u16);
        State { corners: 0, upper: four(0), lower: four(4), middle: 0 }
    }
}

/// [`Orders::corner_class`] and [`Orders::representatives`].
fn corner_classes(corner_places: &[[u8; 8]; SYMMETRIES]) -> (Vec<u16>, Vec<(u16, u16)>) {
    let mut class_of = vec![u16::MAX; PERMUTATIONS];
    let mut representatives = Vec::with_capacity(CORNER_CLASSES);
    let inverse = |s: usize| {
        let undone = |b: &[u8; 8]| (0..8).all(|i| b[usize::from(corner_places[s][i])] == i as u8);
        corner_places.iter().position(undone).unwrap_or(0) as u16
    };
    let inverses: [u16; SYMMETRIES] = std::array::from_fn(inverse);
    for order in 0..PERMUTATIONS {
        if class_of[order] != u16::MAX {
            continue;
        }
        let class = representatives.len() as u16;
        let corners: [u8; 8] = unrank(order);
        let mut own = 0;
        for (s, places) in corner_places.iter().enumerate() {
            let mut image = [0; 8];
            for (place, &corner) in corners.iter().enumerate() {
                image[usize::from(places[place])] = places[usize::from(corner)];
            }
            let image = rank(&image);
            own |= u16::from(image == order) << s;
            if class_of[image] == u16::MAX {
                class_of[image] = class << 4 | inverses[s];
            }
        }
        // By its first symmetry, which changes nothing.
        class_of[order] = class << 4;
        representatives.push((order as u16, own));
    }
    (class_of, representatives)
}

/// The tables at work.
#[derive(Clone, Copy)]
pub(super) struct Bounds<'a> {
    pub(super) orders: &'a Orders,
    pub(super) table: &'a [u8],
}

impl Bounds<'_> {
    /// A bound from the corners and the upper (0) or lower (1) edges.
    #[inline]
    pub(super) fn of_four(&self, corners: u16, lower: usize, four: u16) -> u8 {
        self.table[self.orders.entry(corners, lower, four)]
    }

    /// A bound from the corners and the middle edges.
    #[inline]
    pub(super) fn of_middle(&self, corners: u16, middle: u8) -> u8 {
        self.table[MIDDLE + usize::from(corners) * 24 + usize::from(middle)]
    }

    /// The state after the `k`-th turn of phase 2, if it may be solved in `left` more.
    #[inline]
    pub(super) fn turned(&self, state: State, k: usize, left: u8) -> Option<State> {
        let orders = self.orders;
        let corners = orders.corner_moves[usize::from(state.corners) * 18 + PHASE2_TURNS[k]];
        let upper = orders.four_moves[usize::from(state.upper) * 10 + k];
        if self.of_four(corners, 0, upper) > left {
            return None;
        }
        let lower = orders.four_moves[usize::from(state.lower) * 10 + k];
        if self.of_four(corners, 1, lower) > left {
            return None;
        }
        let middle = orders.middle_moves[usize::from(state.middle) * 10 + k];
        let next = State { corners, upper, lower, middle };
        (self.of_middle(corners, middle) <= left).then_some(next)
    }
}

/// Builds [`BOUNDS`].
pub(super) fn build(orders: &Orders, workers: &dyn Workers, progress: Progress<'_>) -> Vec<u8> {
    let mut table = Vec::with_capacity(BOUNDS.bytes);
    table.resize_with(BOUNDS.bytes, || AtomicU8::new(u8::MAX));
    let (fours, middle) = table.split_at(MIDDLE);
    let home = orders.home();
    for (lower, four) in [home.upper, home.lower].into_iter().enumerate() {
        mark_four(orders, fours, 0, lower, four, 0);
    }
    middle[0].store(0, Relaxed);
    for depth in 1.. {
        let next = AtomicUsize::new(0);
        let marked = AtomicUsize::new(0);
        workers.run(workers.count(), &|_| {
            let mut count = 0;
            loop {
                let first = next.fetch_add(32, Relaxed);
                if first >= CORNER_CLASSES {
                    break;
                }
                for class in first..CORNER_CLASSES.min(first + 32) {
                    count += mark_class(orders, fours, class, depth);
                }
            }
            marked.fetch_add(count, Relaxed);
        });
        let more = mark_middles(orders, middle, depth);
        progress((f64::from(depth) / 14.0).min(1.0));
        if marked.into_inner() + more == 0 {
            break;
        }
    }
    table.into_iter().map(AtomicU8::into_inner).collect()
}

/// Marks the neighbours of the states of a class that are one nearer; tells how many.
fn mark_class(orders: &Orders, table: &[AtomicU8], class: usize, depth: u8) -> usize {
    let corners = usize::from(orders.representatives[class].0);
    let mut count = 0;
    for lower in 0..2 {
        let row = &table[class * ROW + lower * FOURS..][..FOURS];
        for (four, distance) in row.iter().enumerate() {
            if distance.load(Relaxed) != depth - 1 {
                continue;
            }
            for (k, turn) in PHASE2_TURNS.into_iter().enumerate() {
                let corners = orders.corner_moves[corners * 18 + turn];
                let four = orders.four_moves[four * 10 + k];
                count += mark_four(orders, table, corners, lower, four, depth);
            }
        }
    }
    count
}

/// Gives a state its distance if it has none, and the states that are the same by symmetry.
#[inline]
fn mark_four(
    orders: &Orders,
    table: &[AtomicU8],
    corners: u16,
    lower: usize,
    four: u16,
    depth: u8,
) -> usize {
    let entry = orders.entry(corners, lower, four);
    if table[entry].load(Relaxed) != u8::MAX {
        return 0;
    }
    table[entry].store(depth, Relaxed);
    let class = entry / ROW;
    let (_, own) = orders.representatives[class];
    if own != 1 {
        let (lower, four) = (entry % ROW / FOURS, entry % FOURS);
        for s in (1..SYMMETRIES).filter(|s| own >> s & 1 == 1) {
            let image = usize::from(orders.four_images[(s * 2 + lower) * FOURS + four]);
            let lower = lower ^ usize::from(orders.swaps[s]);
            table[class * ROW + lower * FOURS + image].store(depth, Relaxed);
        }
    }
    1
}

fn mark_middles(orders: &Orders, table: &[AtomicU8], depth: u8) -> usize {
    let mut count = 0;
    for (state, distance) in table.iter().enumerate() {
        if distance.load(Relaxed) != depth - 1 {
            continue;
        }
        let (corners, middle) = (state / 24, state % 24);
        for (k, turn) in PHASE2_TURNS.into_iter().enumerate() {
            let corners = usize::from(orders.corner_moves[corners * 18 + turn]);
            let next = &table[corners * 24 + usize::from(orders.middle_moves[middle * 10 + k])];
            if next.load(Relaxed) == u8::MAX {
                next.store(depth, Relaxed);
                count += 1;
            }
        }
    }
    count
}

/// No reference is known to us for these. That each state but the first has a neighbour nearer by one, and none by
/// two, says that the numbers are distances; then the states, symmetric ones each for itself, are counted.
fn verify(table: &[u8], workers: &dyn Workers) -> Result<Vec<u64>, String> {
    let orders = Orders::build();
    let bounds = Bounds { orders: &orders, table };
    let wrong = AtomicUsize::new(0);
    let home = orders.home();
    workers.run(CORNER_CLASSES, &|class| {
        let corners = orders.representatives[class].0;
        for state in 0..ROW {
            let (lower, four) = (state / FOURS, state % FOURS);
            let solved = class == 0 && four == usize::from([home.upper, home.lower][lower]);
            let nearest = PHASE2_TURNS.into_iter().enumerate().map(|(k, turn)| {
                let four = orders.four_moves[four * 10 + k];
                bounds.of_four(orders.corners(corners, turn as u8), lower, four)
            });
            let (own, nearest) = (table[class * ROW + state], nearest.min().unwrap_or(0));
            let right = if solved { own == 0 } else { own == nearest + 1 };
            wrong.fetch_add(usize::from(!right), Relaxed);
        }
        for order in (class..PERMUTATIONS).step_by(CORNER_CLASSES) {
            for middle in 0..24 {
                let nearest = PHASE2_TURNS.into_iter().enumerate().map(|(k, turn)| {
                    let middle = orders.middle_moves[middle * 10 + k];
                    bounds.of_middle(orders.corners(order as u16, turn as u8), middle)
                });
                let own = bounds.of_middle(order as u16, middle as u8);
                let nearest = nearest.min().unwrap_or(0);
                let right = if order + middle == 0 { own == 0 } else { own == nearest + 1 };
                wrong.fetch_add(usize::from(!right), Relaxed);
            }
        }
    });
    let wrong = wrong.into_inner();
    if wrong > 0 {
        return Err(format!("{wrong} entries are no distances"));
    }
    let mut counts = [0_u64; 32];
    for (class, (_, own)) in orders.representatives.iter().enumerate() {
        let size = 16 / u64::from(own.count_ones());
        table[class * ROW..][..ROW].iter().for_each(|&d| counts[usize::from(d)] += size);
    }
    // Both kinds of four come to all orders of corners with all fours.
    compare(&[counts.iter().sum()], &[(2 * PERMUTATIONS * FOURS) as u64])?;
    Ok(counts.into_iter().take_while(|&c| c > 0).collect())
}
