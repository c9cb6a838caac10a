//! How the tables of phase 2 are made and checked.

use super::super::coordinates::{PERMUTATIONS, PHASE2_TURNS, QUADS, quad_places};
use super::super::phase1::compare;
use super::super::symmetry::SYMMETRIES;
use super::super::table::{Progress, Workers};
use super::bounds::{BYTES, Bounds, FARTHEST, MIDDLE};
use super::orders::{CORNER_CLASSES, FOURS, Orders, ROW};
use std::sync::atomic::{AtomicU8, AtomicUsize, Ordering::Relaxed};

/// Builds [`BOUNDS`](super::BOUNDS).
pub(crate) fn build(orders: &Orders, workers: &dyn Workers, progress: Progress<'_>) -> Vec<u8> {
    let mut table = Vec::with_capacity(BYTES);
    table.resize_with(BYTES, || AtomicU8::new(u8::MAX));
    let (fours, middle) = table.split_at(MIDDLE);
    let fours = FourTable { orders, table: fours };
    let home = orders.home();
    for (lower, four) in [home.upper, home.lower].into_iter().enumerate() {
        fours.mark_four(0, lower, four, 0);
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
                    count += fours.mark_class(class, depth);
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

/// The distances of corners with the upper or the lower four edges, while they are being filled.
struct FourTable<'a> {
    orders: &'a Orders,
    /// A row for each class of corners; `u8::MAX` stands for a distance that is not known yet.
    table: &'a [AtomicU8],
}

impl FourTable<'_> {
    /// Marks the neighbours of the states of a class that are one nearer; returns the number of
    /// marked states.
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

    /// Gives a state its distance if it has none, and the states that are the same by symmetry;
    /// returns 1 if it had none.
    #[inline]
    fn mark_four(&self, corners: u16, lower: usize, four: u16, depth: u8) -> usize {
        let Self { orders, table } = *self;
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

/// No reference is known to us for these. That each state but the first has a neighbour nearer by
/// one, and none by two, says that the numbers are distances; then the states, symmetric ones each
/// for itself, are counted.
pub(super) fn verify(table: &[u8], workers: &dyn Workers) -> Result<Vec<u64>, String> {
    let orders = Orders::build();
    let bounds = Bounds { orders: &orders, table, eight: None };
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

/// What turns do to the eight edges as numbered in [`EIGHT`](super::EIGHT): `[number * 10 + k]`,
/// and symmetries: `[symmetry * PERMUTATIONS + number]`.
fn eight_tables(orders: &Orders) -> (Vec<u16>, Vec<u16>) {
    let choice = |four: usize| four / 24;
    // The choice that the lower edges are at when the upper ones are at this one.
    let quads: Vec<usize> =
        (0..QUADS).filter(|&q| orders.four_of_set[q / 24] != u16::MAX).collect();
    let places = |four: usize| quad_places(quads[four]);
    let other: Vec<usize> = (0..FOURS / 24)
        .map(|c| {
            let apart = |d: &usize| places(d * 24).iter().all(|p| !places(c * 24).contains(p));
            (0..FOURS / 24).find(apart).unwrap_or(0)
        })
        .collect();
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

pub(super) fn build_eight(workers: &dyn Workers, progress: Progress<'_>) -> Vec<u8> {
    let orders = Orders::build();
    let (moves, images) = eight_tables(&orders);
    let home = orders.home();
    let mut table = Vec::with_capacity(CORNER_CLASSES * PERMUTATIONS);
    table.resize_with(CORNER_CLASSES * PERMUTATIONS, || AtomicU8::new(u8::MAX));
    table[usize::from(home.upper * 24 + home.lower % 24)].store(0, Relaxed);
    for depth in 1.. {
        let marked = AtomicUsize::new(0);
        workers.run(CORNER_CLASSES, &|class| {
            let mut count = 0;
            let row = &table[class * PERMUTATIONS..][..PERMUTATIONS];
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
                    for s in (1..SYMMETRIES).filter(|s| own >> s & 1 == 1) {
                        row[usize::from(images[s * PERMUTATIONS + image])].store(depth, Relaxed);
                    }
                }
            }
            marked.fetch_add(count, Relaxed);
        });
        progress((f64::from(depth) / 16.0).min(1.0));
        if marked.into_inner() == 0 {
            break;
        }
    }
    let four_bits = |distance: &AtomicU8| distance.load(Relaxed).min(FARTHEST);
    table.chunks(2).map(|two| four_bits(&two[0]) | four_bits(&two[1]) << 4).collect()
}

/// As [`verify`]: each state has a neighbour nearer by one and none by two. Then they are counted.
pub(super) fn verify_eight(table: &[u8], workers: &dyn Workers) -> Result<Vec<u64>, String> {
    let orders = Orders::build();
    let (moves, images) = eight_tables(&orders);
    let home = orders.home();
    let home = usize::from(home.upper * 24 + home.lower % 24);
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
            let right = if class == 0 && edges == home {
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
        return Err(format!("{wrong} entries are no distances"));
    }
    let counts: Vec<u64> = counts.into_iter().map(|c| c.into_inner() as u64).collect();
    compare(&[counts.iter().sum()], &[(PERMUTATIONS * PERMUTATIONS) as u64])?;
    Ok(counts.into_iter().take_while(|&c| c > 0).collect())
}
