//! Builders and checks of the tables of phase 2.
//!
//! The tables are built breadth first from the solved cube, by marking the neighbours of the last
//! level. Their counts are not published, so a check verifies each entry by its neighbours.

use super::super::coordinates::{PERMUTATIONS, PHASE2_TURNS, QUADS, quad_places};
use super::super::phase1::compare;
use super::super::symmetry::SYMMETRIES;
use super::super::table::{Progress, Workers};
use super::bounds::{BYTES, Bounds, FARTHEST, MIDDLE};
use super::orders::{CORNER_CLASSES, FOURS, Orders, ROW};
use std::sync::atomic::{AtomicU8, AtomicUsize, Ordering::Relaxed};

/// Builds the table [`BOUNDS`](super::BOUNDS): the distances from the solved state by corners and
/// four upper or lower edges, and by corners and middle-layer edges.
pub(crate) fn build(orders: &Orders, workers: &dyn Workers, progress: Progress<'_>) -> Vec<u8> {
    let mut table = Vec::with_capacity(BYTES);
    table.resize_with(BYTES, || AtomicU8::new(u8::MAX));
    let (fours, middle) = table.split_at(MIDDLE);
    let fours = FourTable { orders, table: fours };
    let solved = orders.solved();
    for (lower, four) in [solved.upper, solved.lower].into_iter().enumerate() {
        fours.mark_four(0, lower, four, 0);
    }
    middle[0].store(0, Relaxed);
    for depth in 1.. {
        // Workers write to rows of other classes, so the entries are atomic. Two workers that mark
        // one entry write the same depth. Only the count of marked entries, which ends the loop,
        // may be too high then, but never wrongly zero.
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
                    count += fours.mark_class(class, depth);
                }
            }
            marked.fetch_add(count, Relaxed);
        });
        let more = mark_middles(orders, middle, depth);
        // 14 levels is an estimate; a wrong one would only make the progress uneven.
        progress((f64::from(depth) / 14.0).min(1.0));
        if marked.into_inner() + more == 0 {
            break;
        }
    }
    table.into_iter().map(AtomicU8::into_inner).collect()
}

/// Table of the corners with the upper or the lower four edges, under construction.
struct FourTable<'a> {
    orders: &'a Orders,
    /// Distances, a row for each class of corners; `u8::MAX` means that a distance is not known
    /// yet.
    table: &'a [AtomicU8],
}

impl FourTable<'_> {
    /// Gives the distance `depth` to all states without a distance that are one turn away from a
    /// state of a class of corners at `depth - 1`. Returns how many states it changed.
    fn mark_class(&self, class: usize, depth: u8) -> usize {
        let Self { orders, table } = *self;
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
                    count += self.mark_four(corners, lower, four, depth);
                }
            }
        }
        count
    }

    /// Gives the distance `depth` to a state, unless its distance is known: the order of the
    /// corners with the upper (`lower` is 0) or lower (1) edges on the places `four`. Symmetric
    /// states in the same row get the same distance. Returns 1 if the distance was new, else 0.
    #[inline]
    fn mark_four(&self, corners: u16, lower: usize, four: u16, depth: u8) -> usize {
        let Self { orders, table } = *self;
        let entry = orders.entry(corners, lower, four);
        if table[entry].load(Relaxed) != u8::MAX {
            return 0;
        }
        table[entry].store(depth, Relaxed);
        // A representative with symmetries of its own has several entries for symmetric states. A
        // later look-up uses only one of the symmetries and may read any of them.
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
}

/// Gives the distance `depth` to all states of corners and middle-layer edges that have none and
/// are one turn away from a state at `depth - 1`. Returns how many states it changed.
fn mark_middles(orders: &Orders, table: &[AtomicU8], depth: u8) -> usize {
    // With fewer than a million states this table needs neither symmetries nor workers.
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

/// Checks that each entry of [`BOUNDS`](super::BOUNDS) is a distance, and counts the states at each
/// distance.
///
/// No reference for the counts is known. Entries are distances if the solved state has 0 and the
/// nearest neighbour of each other state is nearer by exactly one. Symmetric states count
/// separately.
///
/// # Errors
/// A message with the number of entries that are no distances, or with a wrong number of states.
pub(super) fn verify(table: &[u8], workers: &dyn Workers) -> Result<Vec<u64>, String> {
    let orders = Orders::build();
    let bounds = Bounds { orders: &orders, table, eight: None };
    let wrong = AtomicUsize::new(0);
    let solved = orders.solved();
    workers.run(CORNER_CLASSES, &|class| {
        let corners = orders.representatives[class].0;
        for state in 0..ROW {
            let (lower, four) = (state / FOURS, state % FOURS);
            let is_solved = class == 0 && four == usize::from([solved.upper, solved.lower][lower]);
            let nearest = PHASE2_TURNS.into_iter().enumerate().map(|(k, turn)| {
                let four = orders.four_moves[four * 10 + k];
                bounds.of_four(orders.corners(corners, turn as u8), lower, four)
            });
            let (own, nearest) = (table[class * ROW + state], nearest.min().unwrap_or(0));
            let right = if is_solved { own == 0 } else { own == nearest + 1 };
            wrong.fetch_add(usize::from(!right), Relaxed);
        }
        // The orders of the table with the middle edges, shared out among the same tasks.
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
        return Err(format!("{wrong} entries are not distances"));
    }
    let mut counts = [0_u64; 32];
    for (class, (_, own)) in orders.representatives.iter().enumerate() {
        let size = 16 / u64::from(own.count_ones());
        table[class * ROW..][..ROW].iter().for_each(|&d| counts[usize::from(d)] += size);
    }
    // Each of the two halves of the rows must have all orders of corners with all places of four
    // edges: a wrong class size would change the sum.
    compare(&[counts.iter().sum()], &[(2 * PERMUTATIONS * FOURS) as u64])?;
    Ok(counts.into_iter().take_while(|&c| c > 0).collect())
}

/// Computes two tables for the index of the eight upper and lower edges in [`EIGHT`](super::EIGHT):
/// the index after the k-th turn of phase 2, `[number * 10 + k]`, and the index of the image under
/// a symmetry, `[symmetry * PERMUTATIONS + number]`.
///
/// The index of eight edges is 24 x (index of the four upper ones) + order of the lower ones.
fn eight_tables(orders: &Orders) -> (Vec<u16>, Vec<u16>) {
    // A four is 24 x (number of its set of places) + order.
    let choice = |four: usize| four / 24;
    // The set of places of the lower edges follows from that of the upper ones: its complement.
    let quads: Vec<usize> =
        (0..QUADS).filter(|&q| orders.four_of_set[q / 24] != u16::MAX).collect();
    let places = |four: usize| quad_places(quads[four]);
    let other: Vec<usize> = (0..FOURS / 24)
        .map(|c| {
            let apart = |d: &usize| places(d * 24).iter().all(|p| !places(c * 24).contains(p));
            (0..FOURS / 24).find(apart).unwrap_or(0)
        })
        .collect();
    // Splits the index of eight edges into the fours of the upper and the lower ones.
    let fours = |number: usize| {
        let upper = number / 24;
        (upper as u16, (other[choice(upper)] * 24 + number % 24) as u16)
    };
    let mut moves = Vec::with_capacity(PERMUTATIONS * 10);
    for number in 0..PERMUTATIONS {
        let (upper, lower) = fours(number);
        for k in 0..10 {
            let upper = orders.four_moves[usize::from(upper) * 10 + k];
            let lower = orders.four_moves[usize::from(lower) * 10 + k];
            moves.push(upper * 24 + lower % 24);
        }
    }
    let mut images = Vec::with_capacity(PERMUTATIONS * SYMMETRIES);
    for s in 0..SYMMETRIES {
        for number in 0..PERMUTATIONS {
            let (upper, lower) = fours(number);
            let upper = orders.four_images[s * ROW + usize::from(upper)];
            let lower = orders.four_images[s * ROW + FOURS + usize::from(lower)];
            let (upper, lower) = if orders.swaps[s] { (lower, upper) } else { (upper, lower) };
            images.push(upper * 24 + lower % 24);
        }
    }
    (moves, images)
}

/// Builds the table [`EIGHT`](super::EIGHT): the distances from the solved state by corners and all
/// eight upper and lower edges.
pub(super) fn build_eight(workers: &dyn Workers, progress: Progress<'_>) -> Vec<u8> {
    let orders = Orders::build();
    let (moves, images) = eight_tables(&orders);
    let solved = orders.solved();
    // A byte a state during the build: two workers may write the two halves of one byte at once.
    let mut table = Vec::with_capacity(CORNER_CLASSES * PERMUTATIONS);
    table.resize_with(CORNER_CLASSES * PERMUTATIONS, || AtomicU8::new(u8::MAX));
    table[usize::from(solved.upper * 24 + solved.lower % 24)].store(0, Relaxed);
    for depth in 1.. {
        let marked = AtomicUsize::new(0);
        workers.run(CORNER_CLASSES, &|class| {
            let mut count = 0;
            let row = &table[class * PERMUTATIONS..][..PERMUTATIONS];
            // Collected first, because the loop below goes turn by turn: all its writes for one
            // turn lie in the row of one class.
            let near: Vec<usize> =
                (0..PERMUTATIONS).filter(|&e| row[e].load(Relaxed) == depth - 1).collect();
            if near.is_empty() {
                return;
            }
            let corners = usize::from(orders.representatives[class].0);
            for (k, turn) in PHASE2_TURNS.into_iter().enumerate() {
                let corners = usize::from(orders.corner_moves[corners * 18 + turn]);
                let (class, symmetry) = (
                    usize::from(orders.corner_class[corners] >> 4),
                    usize::from(orders.corner_class[corners] & 15),
                );
                let row = &table[class * PERMUTATIONS..][..PERMUTATIONS];
                let own = orders.representatives[class].1;
                let images_here = &images[symmetry * PERMUTATIONS..][..PERMUTATIONS];
                for &edges in &near {
                    let image = usize::from(images_here[usize::from(moves[edges * 10 + k])]);
                    if row[image].load(Relaxed) != u8::MAX {
                        continue;
                    }
                    row[image].store(depth, Relaxed);
                    count += 1;
                    // As in `mark_four`, the entries of symmetric states get the same distance.
                    for s in (1..SYMMETRIES).filter(|s| own >> s & 1 == 1) {
                        row[usize::from(images[s * PERMUTATIONS + image])].store(depth, Relaxed);
                    }
                }
            }
            marked.fetch_add(count, Relaxed);
        });
        // As in `build`, the number of levels is an estimate.
        progress((f64::from(depth) / 16.0).min(1.0));
        if marked.into_inner() == 0 {
            break;
        }
    }
    let four_bits = |distance: &AtomicU8| distance.load(Relaxed).min(FARTHEST);
    table.chunks(2).map(|two| four_bits(&two[0]) | four_bits(&two[1]) << 4).collect()
}

/// Checks that each entry of [`EIGHT`](super::EIGHT) is a distance, by the entries of its
/// neighbours as [`verify`] does, and counts the states at each distance.
///
/// # Errors
/// A message with the number of entries that are no distances, or with a wrong number of states.
pub(super) fn verify_eight(table: &[u8], workers: &dyn Workers) -> Result<Vec<u64>, String> {
    let orders = Orders::build();
    let (moves, images) = eight_tables(&orders);
    let solved = orders.solved();
    let solved = usize::from(solved.upper * 24 + solved.lower % 24);
    let at = |entry: usize| table[entry / 2] >> (entry % 2 * 4) & 15;
    let wrong = AtomicUsize::new(0);
    let counts: Vec<AtomicUsize> = (0..16).map(|_| AtomicUsize::new(0)).collect();
    workers.run(CORNER_CLASSES, &|class| {
        let (corners, own) = orders.representatives[class];
        let around = PHASE2_TURNS
            .map(|t| orders.corner_class[usize::from(orders.corners(corners, t as u8))]);
        let mut here = [0; 16];
        for edges in 0..PERMUTATIONS {
            let nearest = around.iter().enumerate().map(|(k, &next)| {
                let (class, symmetry) = (usize::from(next >> 4), usize::from(next & 15));
                let edges = usize::from(moves[edges * 10 + k]);
                at(class * PERMUTATIONS + usize::from(images[symmetry * PERMUTATIONS + edges]))
            });
            let (distance, nearest) =
                (at(class * PERMUTATIONS + edges), nearest.min().unwrap_or(0));
            // The code of `FARTHEST` has all distances from there on, so its states may have
            // neighbours of the same code only.
            let right = if class == 0 && edges == solved {
                distance == 0
            } else {
                distance == (nearest + 1).min(FARTHEST)
            };
            wrong.fetch_add(usize::from(!right), Relaxed);
            here[usize::from(distance)] += 16 / own.count_ones() as usize;
        }
        here.iter().zip(&counts).for_each(|(n, count)| {
            count.fetch_add(*n, Relaxed);
        });
    });
    let wrong = wrong.into_inner();
    if wrong > 0 {
        return Err(format!("{wrong} entries are not distances"));
    }
    let counts: Vec<u64> = counts.into_iter().map(|c| c.into_inner() as u64).collect();
    compare(&[counts.iter().sum()], &[(PERMUTATIONS * PERMUTATIONS) as u64])?;
    Ok(counts.into_iter().take_while(|&c| c > 0).collect())
}
