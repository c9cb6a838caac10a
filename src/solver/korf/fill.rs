//! Fills a pattern database, breadth first.
//!
//! - in: a pattern
//! - out: its states' distances from the solved one, two in a byte, the first in the lower half
//!
//! While the last states found are fewer than those not found yet, their neighbours are marked; afterwards, those not
//! found look among their neighbours for one of the last.

use super::pattern::Pattern;
use crate::table::{Progress, Workers};
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};

/// Not found yet.
const UNKNOWN: u8 = 15;

/// Distances of all states of a pattern; those further away than `deepest` stay at `deepest + 1`.
pub(super) fn fill(
    pattern: &impl Pattern,
    deepest: u8,
    workers: &dyn Workers,
    progress: Progress<'_>,
) -> Vec<u8> {
    let (rows, columns) = (pattern.rows(), pattern.columns());
    let states = rows * columns;
    let distances: Vec<AtomicU8> =
        std::iter::repeat_with(|| AtomicU8::new(UNKNOWN)).take(states).collect();
    distances[pattern.number(&crate::cube::Cube::SOLVED)].store(0, Ordering::Relaxed);
    let (mut found, mut last) = (1, 1);
    for distance in 1..=deepest.min(UNKNOWN - 1) {
        let count = AtomicU64::new(0);
        let pushes = last < states as u64 - found;
        workers.run(rows, &|row| {
            let new = if pushes {
                push(pattern, &distances, row, distance)
            } else {
                pull(pattern, &distances, row, distance)
            };
            count.fetch_add(new, Ordering::Relaxed);
        });
        last = count.into_inner();
        found += last;
        progress(found as f64 / states as f64);
        if last == 0 {
            break;
        }
    }
    let far = deepest.min(UNKNOWN - 1) + 1;
    let half = |d: &AtomicU8| d.load(Ordering::Relaxed).min(far);
    distances.chunks(2).map(|pair| half(&pair[0]) | pair.get(1).map_or(0, half) << 4).collect()
}

/// Marks the neighbours of a row's states at the distance before; returns how many were marked.
fn push(pattern: &impl Pattern, distances: &[AtomicU8], row: usize, distance: u8) -> u64 {
    let columns = pattern.columns();
    let own = &distances[row * columns..][..columns];
    let mut steps = None;
    let mut marked = 0;
    for (column, from) in own.iter().enumerate() {
        if from.load(Ordering::Relaxed) != distance - 1 {
            continue;
        }
        for &(to, permutation) in steps.get_or_insert_with(|| pattern.steps(row)).iter() {
            let column = pattern.column(permutation, column);
            let state = &distances[to as usize * columns + column];
            if state.load(Ordering::Relaxed) == UNKNOWN
                && state.swap(distance, Ordering::Relaxed) == UNKNOWN
            {
                marked += 1;
            }
        }
    }
    marked
}

/// Marks a row's unknown states that have a neighbour at the distance before; returns how many.
fn pull(pattern: &impl Pattern, distances: &[AtomicU8], row: usize, distance: u8) -> u64 {
    let columns = pattern.columns();
    let own = &distances[row * columns..][..columns];
    let mut steps = None;
    let mut marked = 0;
    for (column, state) in own.iter().enumerate() {
        if state.load(Ordering::Relaxed) != UNKNOWN {
            continue;
        }
        let near = steps.get_or_insert_with(|| pattern.steps(row)).iter().any(|&(to, p)| {
            let neighbour = to as usize * columns + pattern.column(p, column);
            distances[neighbour].load(Ordering::Relaxed) == distance - 1
        });
        if near {
            state.store(distance, Ordering::Relaxed);
            marked += 1;
        }
    }
    marked
}

/// How many states are at each distance.
pub(super) fn count(table: &[u8], workers: &dyn Workers) -> [u64; 16] {
    const PART: usize = 1 << 16;
    let counts = [const { AtomicU64::new(0) }; 16];
    workers.run(table.len().div_ceil(PART), &|part| {
        let mut bytes = [0_u64; 256];
        let part = &table[part * PART..table.len().min((part + 1) * PART)];
        for &byte in part {
            bytes[usize::from(byte)] += 1;
        }
        for (byte, n) in bytes.into_iter().enumerate() {
            counts[byte & 15].fetch_add(n, Ordering::Relaxed);
            counts[byte >> 4].fetch_add(n, Ordering::Relaxed);
        }
    });
    counts.map(AtomicU64::into_inner)
}

/// The distance of a state.
#[inline]
pub(super) fn distance(table: &[u8], state: usize) -> u8 {
    table[state / 2] >> (state % 2 * 4) & 15
}
