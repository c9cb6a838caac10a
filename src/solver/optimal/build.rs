//! Builder of a table, distance by distance, 256 to 2048 states at a time.
//!
//! - in: the numbers of the cosets (see [`super::coset`]), the base: the distance up to which all
//!   cosets have one code
//! - out: the bytes of the table, and the number of cosets at each distance
//! - source: T. Rokicki, nxopt, for two bits an entry relative to a base, with a bound for smaller
//!   distances in the same line
//!
//! A row has all cosets with one state of the corners. It is pulled from the rows of its eighteen
//! neighbours by turns: it takes over the cosets that these have reached, as sets of flips. Rows
//! are read from one set of cosets and written to another, so that workers can build all rows of a
//! distance in parallel.
//!
//! A line of 64 bytes is one cache line. It has the first bits of 256 entries and then their second
//! bits:
//!
//! | first, second bit | distance |
//! |---|---|
//! | 1, 1 | `base` and less |
//! | 0, 1 | `base + 1` |
//! | 1, 0 | `base + 2` |
//! | 0, 0 | `base + 3` and more |
//!
//! The four bits of the first two entries hold the least distance in the line instead.

#![allow(
    clippy::inline_always,
    reason = "the build is compiled once with vector instructions, and only callees that are \
              inlined into it can use them"
)]

use super::coset::{
    Cosets, SLICES, Shape, corners_of, edges_of, turned_corners, turned_edges, turns,
};
use super::flips::{BITS, Carrier};
use super::geometry::UPRIGHT;
use crate::cube::Cube;
use crate::table::{Progress, Workers};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Size of a line: a cache line of the processor (bytes).
pub(super) const LINE: usize = 64;
/// Number of entries of a line.
const ENTRIES: usize = 256;
/// Length of one of the two halves of a line (words).
const HALF: usize = ENTRIES / 64;

/// A table with its counts.
#[derive(Debug)]
pub(super) struct Filled {
    /// Bytes of the table.
    pub(super) table: Vec<u8>,
    /// Number of cosets at each distance up to `base + 2`.
    pub(super) counts: Vec<u64>,
}

/// Builds a table: finds the distance of each coset, breadth first from the solved cube up to
/// `base + 2`, and packs the distances into lines as the head of this module describes.
pub(super) fn fill(
    cosets: &Cosets,
    base: u8,
    workers: &dyn Workers,
    progress: Progress<'_>,
) -> Filled {
    if cosets.shape.full {
        Filler::<32>::new(cosets).fill(base, workers, progress)
    } else {
        Filler::<4>::new(cosets).fill(base, workers, progress)
    }
}

/// Returns the size of a table row for cosets of this shape (bytes).
pub(super) const fn row_bytes(shape: Shape) -> usize {
    SLICES * shape.words() / HALF * LINE
}

/// Map of the edges by a turn and then a symmetry. A slice is a set of places of the four
/// middle-layer edges.
#[derive(Debug, Clone)]
struct Motion {
    /// Maps of sets of flips, each with its matrix.
    carriers: Vec<([u16; BITS], Carrier)>,
    /// For each slice: its image, the index of the carrier for its flips, and the carrier's offset.
    slices: Vec<(u16, u16, u16)>,
}

impl Motion {
    /// Computes how `turn`, followed by the symmetry with the index `symmetry`, maps the states of
    /// the edges.
    fn new(cosets: &Cosets, turn: &Cube, symmetry: usize) -> Self {
        let mut motion = Self { carriers: Vec::new(), slices: Vec::with_capacity(SLICES) };
        let bits = cosets.shape.words().trailing_zeros() as usize + 6;
        for &slice in &cosets.slices {
            let image = |number: u16| {
                let edges = turned_edges(cosets.edges(slice, number), turn);
                cosets.edges_image(edges, symmetry)
            };
            // The map is affine: its matrix has the images of single bits, less the image of 0.
            let zero = image(0);
            let offset = cosets.flip_number(zero);
            let columns = std::array::from_fn(|k| {
                let bit = 1 << k;
                if k < bits { cosets.flip_number(image(bit)) ^ offset } else { bit }
            });
            // Slices with equal matrices share a carrier and differ in the offset only.
            let known = motion.carriers.iter().position(|(c, _)| *c == columns);
            let carrier = known.unwrap_or_else(|| {
                motion.carriers.push((columns, Carrier::new(&columns)));
                motion.carriers.len() - 1
            });
            let to = cosets.slice_of[usize::from(zero.0)];
            motion.slices.push((to, carrier as u16, offset));
        }
        motion
    }
}

/// Builder of one table, with `WORDS` words in a set of flips.
struct Filler<'a, const WORDS: usize> {
    cosets: &'a Cosets,
    /// Map of the edges by each turn and symmetry: `[turn * UPRIGHT + symmetry]`.
    motions: Vec<Motion>,
    /// Row after each turn, and the symmetry that leads to it, for each row.
    neighbours: Vec<[(usize, usize); 18]>,
}

/// One step: from the cosets up to a distance to those one further away.
struct Step<'a> {
    /// Distance of the new cosets (turns).
    distance: u8,
    /// Whether the step adds the new cosets to the target set. Otherwise the target becomes all
    /// cosets that are reached.
    only_new: bool,
    /// Cosets nearer than `distance`, one bit each.
    from: &'a [u64],
    /// Whether each row of `from` has any cosets.
    filled: &'a [bool],
}

impl<'a, const WORDS: usize> Filler<'a, WORDS> {
    /// Length of a row (words).
    const ROW: usize = SLICES * WORDS;
    /// Number of lines of a row.
    const LINES: usize = Self::ROW / HALF;

    /// Computes how each turn and symmetry maps the edges, and which row each turn leads to from
    /// each row.
    fn new(cosets: &'a Cosets) -> Self {
        let turns = turns();
        let motions = (0..18 * UPRIGHT)
            .map(|i| Motion::new(cosets, &turns[i / UPRIGHT], i % UPRIGHT))
            .collect();
        let neighbours = cosets
            .representatives
            .iter()
            .map(|corners| turns.each_ref().map(|turn| cosets.row(&turned_corners(corners, turn))))
            .collect();
        Self { cosets, motions, neighbours }
    }

    /// Builds the table, one distance after the other, up to `base + 2`.
    fn fill(&self, base: u8, workers: &dyn Workers, progress: Progress<'_>) -> Filled {
        let rows = self.neighbours.len();
        let (mut near, mut next) = (vec![0_u64; rows * Self::ROW], vec![0_u64; rows * Self::ROW]);
        let mut least = vec![base + 3; rows * Self::LINES];
        let start = self.start();
        near[start] = 1;
        least[start / HALF] = 0;
        let mut filled = vec![false; rows];
        filled[start / Self::ROW] = true;
        let mut counts = vec![1];
        let done = AtomicUsize::new(0);
        for distance in 1..=base + 2 {
            // Up to the base, both sets are exchanged after each step. Then `near` has the cosets
            // up to the base, and `next` gets those up to base + 1. The last step reads `next` and
            // adds those at base + 2 to `near`. The two sets are then the two bits of all entries.
            let last = distance == base + 2;
            let (from, into) = if last { (&next, &mut near) } else { (&near, &mut next) };
            let step = Step { distance, only_new: last, from, filled: &filled };
            let touched: Vec<AtomicBool> = filled.iter().map(|&f| AtomicBool::new(f)).collect();
            let count = AtomicU64::new(0);
            let parts: Vec<_> = into
                .chunks_mut(Self::ROW)
                .zip(least.chunks_mut(Self::LINES))
                .map(Mutex::new)
                .collect();
            workers.run(rows, &|row| {
                let mut part = parts[row].lock().unwrap_or_else(PoisonError::into_inner);
                let (into, least) = &mut *part;
                let new = self.pull(&step, row, into, least);
                count.fetch_add(new * u64::from(self.cosets.sizes[row]), Ordering::Relaxed);
                touched[row].fetch_or(new > 0, Ordering::Relaxed);
                let rows_done = done.fetch_add(1, Ordering::Relaxed) + 1;
                if rows_done.is_multiple_of(64) {
                    progress(rows_done as f64 / (rows * usize::from(base + 2)) as f64);
                }
            });
            drop(parts);
            filled = touched.into_iter().map(AtomicBool::into_inner).collect();
            counts.push(count.into_inner());
            if distance <= base {
                std::mem::swap(&mut near, &mut next);
            }
        }
        progress(1.0);
        Filled { table: lines(&near, &next, &least), counts }
    }

    /// Returns the index of the 64-bit word whose lowest bit stands for the solved cube.
    fn start(&self) -> usize {
        let (row, symmetry) = self.cosets.row(&corners_of(&Cube::SOLVED));
        let (slice, _) = self.cosets.edges_image(edges_of(&Cube::SOLVED), symmetry);
        row * Self::ROW + usize::from(self.cosets.slice_of[usize::from(slice)]) * WORDS
    }

    /// Finds the cosets of a row that are `step.distance` turns from the solved cube. Writes them
    /// to the row `into` of the target set and the distance to `least`, the least distance in each
    /// line. Returns the number of new cosets.
    fn pull(&self, step: &Step<'_>, row: usize, into: &mut [u64], least: &mut [u8]) -> u64 {
        // Compiled twice: with AVX2, each operation on words handles four of them.
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") {
            #[allow(
                unsafe_code,
                reason = "vector instructions are unsafe; the condition above checks for them"
            )]
            // SAFETY: the condition above checks that the processor has AVX2.
            return unsafe { self.pull_with_avx2(step, row, into, least) };
        }
        self.pull_anywhere(step, row, into, least)
    }

    /// Runs [`Filler::pull_anywhere`], compiled for processors with AVX2.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn pull_with_avx2(
        &self,
        step: &Step<'_>,
        row: usize,
        into: &mut [u64],
        least: &mut [u8],
    ) -> u64 {
        self.pull_anywhere(step, row, into, least)
    }

    /// Does the work of [`Filler::pull`] on any processor.
    #[inline(always)]
    fn pull_anywhere(
        &self,
        step: &Step<'_>,
        row: usize,
        into: &mut [u64],
        least: &mut [u8],
    ) -> u64 {
        let mut count = 0;
        let own = sets::<WORDS>(&step.from[row * Self::ROW..][..Self::ROW]);
        let (into, _) = into.as_chunks_mut::<WORDS>();
        let mut sources: Vec<(&[[u64; WORDS]], &Motion)> = Vec::with_capacity(18);
        // Rows without any coset so far have nothing to give.
        for (turn, &(neighbour, symmetry)) in self.neighbours[row].iter().enumerate() {
            if step.filled[neighbour] {
                let from = sets(&step.from[neighbour * Self::ROW..][..Self::ROW]);
                sources.push((from, &self.motions[turn * UPRIGHT + symmetry]));
            }
        }
        // Turns have inverses, so the neighbours by turns are also those that lead to this row. The
        // motion from this row to a neighbour gives the index at which the neighbour's set is read.
        for slice in 0..SLICES {
            let mut set = own[slice];
            for (from, motion) in &sources {
                let (at, carrier, offset) = motion.slices[slice];
                let source = &from[usize::from(at)];
                // At small distances most sets are empty.
                if source.iter().fold(0, |any, word| any | word) == 0 {
                    continue;
                }
                let image = motion.carriers[usize::from(carrier)].1.carry(source, offset);
                let mut all = u64::MAX;
                for (word, more) in set.iter_mut().zip(&image) {
                    *word |= more;
                    all &= *word;
                }
                // At great distances a set is full before all neighbours are read.
                if all == u64::MAX {
                    break;
                }
            }
            for (word, before) in own[slice].iter().enumerate() {
                let new = set[word] & !before;
                if new != 0 {
                    count += u64::from(new.count_ones());
                    let least = &mut least[(slice * WORDS + word) / HALF];
                    *least = step.distance.min(*least);
                }
                if step.only_new {
                    into[slice][word] |= new;
                } else {
                    into[slice][word] = set[word];
                }
            }
        }
        count
    }
}

/// Splits a row into its sets of flips, one for each set of places of the middle-layer edges.
fn sets<const WORDS: usize>(row: &[u64]) -> &[[u64; WORDS]] {
    row.as_chunks().0
}

/// Packs a table into lines: `first` and `second` have the two bits of each entry, `least` has the
/// least distance in each line.
fn lines(first: &[u64], second: &[u64], least: &[u8]) -> Vec<u8> {
    let mut table = Vec::with_capacity(first.len() * 16);
    for (line, least) in least.iter().enumerate() {
        for (half, bits) in [(first, least & 3), (second, least >> 2)] {
            let words = &half[line * HALF..][..HALF];
            table.extend((words[0] & !3 | u64::from(bits)).to_le_bytes());
            words[1..].iter().for_each(|word| table.extend(word.to_le_bytes()));
        }
    }
    table
}

/// Counts the cosets of a table in four groups: at most `base` turns away, `base + 1`, `base + 2`,
/// and further. Cosets whose entries hold the least distance of a line do not count.
pub(super) fn count(cosets: &Cosets, table: &[u8], workers: &dyn Workers) -> [u64; 4] {
    let counts = [const { AtomicU64::new(0) }; 4];
    let row_bytes = row_bytes(cosets.shape);
    workers.run(cosets.sizes.len(), &|row| {
        let mut found = [0; 4];
        for line in table[row * row_bytes..][..row_bytes].chunks_exact(LINE) {
            let (halves, _) = line.as_chunks::<8>();
            // The first two bits of each half belong to the least distance.
            for (k, mask) in [!3, u64::MAX, u64::MAX, u64::MAX].into_iter().enumerate() {
                let (a, b) = (u64::from_le_bytes(halves[k]), u64::from_le_bytes(halves[k + HALF]));
                for (n, set) in [a & b, !a & b, a & !b, !a & !b].into_iter().enumerate() {
                    found[n] += u64::from((set & mask).count_ones());
                }
            }
        }
        for (count, found) in counts.iter().zip(found) {
            count.fetch_add(found * u64::from(cosets.sizes[row]), Ordering::Relaxed);
        }
    });
    counts.map(AtomicU64::into_inner)
}
