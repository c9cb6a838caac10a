//! Builder of a pattern database, breadth first from the solved state.
//!
//! - in: a pattern
//! - out: the distances of its states, two in a byte, the first in the lower half
//!
//! A level is the set of all states at one distance. It is built in the cheaper of two directions.
//! While the level before has fewer states than are still unknown, that level *pushes*: each of its
//! states marks its neighbours. Later, each unknown state *pulls*: it looks for a neighbour in the
//! level before.

use super::pattern::Pattern;
use crate::table::{Progress, Workers};
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};

/// Mark of a state whose distance is not known yet.
const UNKNOWN: u8 = 15;

/// Computes the distance (turns) of each state of a pattern from the solved state: four bits a
/// state, by its index. States further away than `deepest` get `deepest + 1`.
pub(super) fn fill(
    pattern: &impl Pattern,
    deepest: u8,
    workers: &dyn Workers,
    progress: Progress<'_>,
) -> Vec<u8> {
    let (rows, columns) = (pattern.rows(), pattern.columns());
    let states = rows * columns;
    // A byte a state during the build: two workers may write the two halves of one byte at once.
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
    // An incomplete table stays admissible: `deepest + 1` is a lower bound for the rest.
    let far = deepest.min(UNKNOWN - 1) + 1;
    let half = |d: &AtomicU8| d.load(Ordering::Relaxed).min(far);
    distances.chunks(2).map(|pair| half(&pair[0]) | pair.get(1).map_or(0, half) << 4).collect()
}

/// Gives `distance` to all states of unknown distance that are one turn away from a state of `row`
/// at `distance - 1`. Returns how many states it changed.
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
            // Several workers may reach a state; the exchange lets exactly one count it. The load
            // before it avoids an exchange for each state that is known.
            if state.load(Ordering::Relaxed) == UNKNOWN
                && state.swap(distance, Ordering::Relaxed) == UNKNOWN
            {
                marked += 1;
            }
        }
    }
    marked
}

/// Gives `distance` to all states of `row` of unknown distance that are one turn away from any
/// state at `distance - 1`. Returns how many states it changed.
fn pull(pattern: &impl Pattern, distances: &[AtomicU8], row: usize, distance: u8) -> u64 {
    let columns = pattern.columns();
    let own = &distances[row * columns..][..columns];
    let mut steps = None;
    let mut marked = 0;
    for (column, state) in own.iter().enumerate() {
        if state.load(Ordering::Relaxed) != UNKNOWN {
            continue;
        }
        // Turns have inverses, so the neighbours by turns are also those that lead here.
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

/// Counts the states of a table at each distance, 0..16 turns.
pub(super) fn count(table: &[u8], workers: &dyn Workers) -> [u64; 16] {
    const PART: usize = 1 << 16;
    let counts = [const { AtomicU64::new(0) }; 16];
    workers.run(table.len().div_ceil(PART), &|part| {
        // Whole bytes first: one addition for two states.
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

/// Reads the distance of the state with the index `state` from a table of four bits a state.
#[inline]
pub(super) fn distance(table: &[u8], state: usize) -> u8 {
    table[state / 2] >> (state % 2 * 4) & 15
}
