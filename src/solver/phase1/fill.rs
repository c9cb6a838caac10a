//! Builders and checks of the tables of phase 1.
//!
//! A table is built breadth first from the goal. It is checked by the number of states at each
//! distance, which is known.

use super::super::coordinates::{TWISTS, twist_moves};
use super::super::symmetry::{CLASSES, Classes, SYMMETRIES};
use super::super::table::{Progress, Workers};
use super::faces::CASE_FACES;
use super::frames::Frames;
use super::guide::{FAR, NEAR_ROW, WIDE, near_code};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::{LazyLock, Mutex, PoisonError};

/// Number of states of phase 1 at each distance (pages of H. Kociemba and J. Scherphuis).
const KNOWN: [u64; 13] = [
    1, 4, 50, 592, 7156, 87236, 1043817, 12070278, 124946368, 821605960, 1199128738, 58202444, 476,
];

/// Builds the move tables of phase 1, and with them the table [`NEAR`](super::NEAR).
pub(super) fn build_near(workers: &dyn Workers, progress: Progress<'_>) -> Vec<u8> {
    near(&Frames::build(), workers, progress)
}

/// Builds the table [`NEAR`](super::NEAR) from move tables: distances below [`FAR`] modulo 3, and
/// the code 3 for all states further away.
pub(crate) fn near(frames: &Frames, workers: &dyn Workers, progress: Progress<'_>) -> Vec<u8> {
    levels(frames, FAR - 1, workers, progress)
}

/// Computes the distance of each state of phase 1 from the goal modulo 3, breadth first up to
/// `deepest`. The result has a row of [`NEAR_ROW`] bytes for each class and two bits for each
/// twist; states beyond `deepest` have the code 3.
///
/// Each row is written by one worker only. It reads the newest entries of the 18 neighbours of the
/// class, so no worker waits for another. Classes with symmetries of their own need no special
/// treatment, since each symmetric entry is reached from entries of its own.
fn levels(frames: &Frames, deepest: u8, workers: &dyn Workers, progress: Progress<'_>) -> Vec<u8> {
    let back = Backwards::new(frames);
    let mut table = vec![u8::MAX; CLASSES * NEAR_ROW];
    // The goal is entry 0; all other codes are 3, which means unfilled.
    table[0] = !3;
    // The twists of the last level by class: the next level pulls from these alone.
    let mut newest: Vec<Vec<u16>> = vec![Vec::new(); CLASSES];
    newest[0].push(0);
    for depth in 1..=deepest {
        let level = Level { back: &back, depth, newest: &newest };
        let mut next: Vec<Vec<u16>> = vec![Vec::new(); CLASSES];
        let chunks: Vec<Mutex<Chunk<'_>>> = table
            .chunks_mut(NEAR_ROW * CHUNK)
            .zip(next.chunks_mut(CHUNK))
            .map(|(rows, found)| Mutex::new(Chunk { rows, found }))
            .collect();
        workers.run(chunks.len(), &|number| {
            // Each task has a chunk of its own. The lock is never contended; it proves that to the
            // compiler.
            let mut chunk = chunks[number].lock().unwrap_or_else(PoisonError::into_inner);
            let Chunk { rows, found } = &mut *chunk;
            for (k, row) in rows.chunks_mut(NEAR_ROW).enumerate() {
                level.pull(number * CHUNK + k, row, &mut found[k]);
            }
        });
        drop(chunks);
        newest = next;
        // The known counts give the share exactly, without a count of the entries.
        let done: u64 = KNOWN[..=usize::from(depth)].iter().sum();
        let all: u64 = KNOWN[..=usize::from(deepest)].iter().sum();
        progress(done as f64 / all as f64);
    }
    table
}

/// Number of classes that one task takes.
const CHUNK: usize = 64;

/// Rows of some classes, and the twists found for each.
struct Chunk<'a> {
    rows: &'a mut [u8],
    found: &'a mut [Vec<u16>],
}

/// Inverse tables, which lead from the twist of a neighbour back to that of a state.
struct Backwards<'a> {
    frames: &'a Frames,
    /// Twist before a turn: `[turn * TWISTS + twist]`.
    before: Vec<u16>,
    /// Twist whose image a twist is: `[symmetry * TWISTS + twist]`.
    origin: Vec<u16>,
}

impl<'a> Backwards<'a> {
    /// Inverts the tables of the twists' moves and images.
    fn new(frames: &'a Frames) -> Self {
        let (mut before, mut origin) = (vec![0; 18 * TWISTS], vec![0; SYMMETRIES * TWISTS]);
        for twist in 0..TWISTS {
            for turn in 0..18 {
                let after = usize::from(frames.twist_moves[twist * 18 + turn]);
                before[turn * TWISTS + after] = twist as u16;
            }
            for s in 0..SYMMETRIES {
                let image = usize::from(frames.twist_images[s * TWISTS + twist]);
                origin[s * TWISTS + image] = twist as u16;
            }
        }
        Self { frames, before, origin }
    }
}

/// One level of the search from the goal.
struct Level<'a> {
    back: &'a Backwards<'a>,
    /// Distance of the level from the goal.
    depth: u8,
    /// Twists of the level before, by class.
    newest: &'a [Vec<u16>],
}

impl Level<'_> {
    /// Writes the distance of this level, modulo 3, into all unfilled entries of a class that have
    /// a neighbour in the level before. Adds their twists to `found`.
    fn pull(&self, class: usize, row: &mut [u8], found: &mut Vec<u16>) {
        let Self { back, depth, newest } = *self;
        // An unfilled code is 0b11; clearing these bits leaves `depth % 3`.
        let filled = 3 ^ (depth % 3);
        // No branch on filled entries: the processor would mispredict a third of them. Instead each
        // twist is stored, and `count` moves on only if the entry was unfilled.
        let (mut marked, mut count) = ([0_u16; TWISTS + 1], 0);
        for turn in 0..18 {
            let entry = back.frames.class_moves[class * 18 + turn] as usize;
            let before: &[u16; TWISTS] = rows(&back.before, turn);
            let origin: &[u16; TWISTS] = rows(&back.origin, entry & 15);
            for &twist in &newest[entry >> 4] {
                // A step is a turn, then a symmetry. So the way back undoes the symmetry first.
                let twist = before[usize::from(origin[usize::from(twist)])];
                let (byte, shift) = (&mut row[usize::from(twist / 4)], twist % 4 * 2);
                let unfilled = u8::from(*byte >> shift & 3 == 3);
                *byte &= !((filled * unfilled) << shift);
                marked[count] = twist;
                count += usize::from(unfilled);
            }
        }
        found.extend_from_slice(&marked[..count]);
    }
}

/// Returns the row `number` of a table of [`TWISTS`] entries a row. The constant length of a row
/// removes bounds checks from inner loops.
fn rows(table: &[u16], number: usize) -> &[u16; TWISTS] {
    table.as_chunks().0.get(number).unwrap_or(&[0; TWISTS])
}

/// Builds the table [`WIDE_TABLE`](super::WIDE_TABLE): first the distances of all states modulo 3,
/// then whether each turn leads each state nearer to the goal or farther.
pub(super) fn build_wide(workers: &dyn Workers, progress: Progress<'_>) -> Vec<u8> {
    let frames = Frames::build();
    // No state of phase 1 is more than 12 turns from the goal, so no entry stays unfilled.
    let distances = levels(&frames, 12, workers, &|done| progress(done * 0.5));
    let packer = Packer::new(&frames, &distances);
    let row = TWISTS * WIDE;
    let mut table = vec![0; CLASSES * row];
    let rows: Vec<Mutex<&mut [u8]>> = table.chunks_mut(row * CHUNK).map(Mutex::new).collect();
    let done = AtomicUsize::new(0);
    workers.run(rows.len(), &|chunk| {
        // As in `levels`, the lock is never contended.
        let mut out = rows[chunk].lock().unwrap_or_else(PoisonError::into_inner);
        for (k, out) in out.chunks_mut(row).enumerate() {
            packer.row(chunk * CHUNK + k, out);
        }
        let done = done.fetch_add(1, Relaxed) + 1;
        progress(0.5 + 0.5 * done as f64 / rows.len() as f64);
    });
    drop(rows);
    table
}

/// Packer of the effects of all turns on the states of a class.
struct Packer<'a> {
    frames: &'a Frames,
    /// Distances of all states modulo 3, in the format of [`levels`].
    distances: &'a [u8],
    /// Twist after a turn: `[turn * TWISTS + twist]`.
    twist_moves: Vec<u16>,
    /// Case of the three turns of a face, by their effects of two bits each (0 neither, 1 farther,
    /// 2 nearer).
    cases: [u8; 64],
}

impl<'a> Packer<'a> {
    /// Makes a packer from the distances of all states modulo 3, and computes its table of cases.
    fn new(frames: &'a Frames, distances: &'a [u8]) -> Self {
        let cases = std::array::from_fn(|changes| {
            let bits = |wanted: usize| {
                (0..3).fold(0, |b, q| b | u8::from(changes >> (2 * q) & 3 == wanted) << q)
            };
            if bits(2) > 0 { 7 + bits(2) } else { bits(1) }
        });
        Self { frames, distances, twist_moves: twist_moves(), cases }
    }

    /// Writes the row of a class in the table `Wide` to `out`: [`WIDE`] bytes for each twist, which
    /// say whether each turn leads nearer to the goal or farther.
    fn row(&self, class: usize, out: &mut [u8]) {
        let own = &self.distances[class * NEAR_ROW..][..NEAR_ROW];
        // Two bits a turn. Distances modulo 3 suffice because neighbours differ by at most 1. The
        // loop goes turn by turn, so that all reads of one pass lie in two rows.
        let mut changes = vec![0_u64; TWISTS];
        for turn in 0..18 {
            let entry = self.frames.class_moves[class * 18 + turn] as usize;
            let other = &self.distances[(entry >> 4) * NEAR_ROW..][..NEAR_ROW];
            let moves: &[u16; TWISTS] = rows(&self.twist_moves, turn);
            let images: &[u16; TWISTS] = rows(&self.frames.twist_images, entry & 15);
            for (twist, changes) in changes.iter_mut().enumerate() {
                let code = near_code(other, images[usize::from(moves[twist])]);
                *changes |= u64::from(code) << (turn * 2);
            }
        }
        for (twist, (changes, out)) in changes.iter().zip(out.chunks_mut(WIDE)).enumerate() {
            let code = near_code(own, twist as u16);
            let entry = CASE_FACES.iter().enumerate().fold(0, |entry, (i, face)| {
                let three = (changes >> (face * 6) & 63) as usize;
                entry | u32::from(self.cases[LESS[usize::from(code)][three]]) << (i * 4)
            });
            out.copy_from_slice(&entry.to_le_bytes()[..WIDE]);
        }
    }
}

/// Effects of three turns on a distance, two bits each (0 neither, 1 farther, 2 nearer):
/// `[code of the state][codes after the turns]`. They are the differences of the codes modulo 3.
static LESS: LazyLock<[[usize; 64]; 3]> = LazyLock::new(|| {
    std::array::from_fn(|own| {
        std::array::from_fn(|three| {
            (0..3).fold(0, |all, q| {
                let code = three >> (2 * q) & 3;
                all | ((code % 3 + 3 - own) % 3) << (2 * q)
            })
        })
    })
});

/// Returns the number of states (slice, flip) in a class: 16 over the order of its stabiliser.
fn class_size(classes: &Classes, class: usize) -> u64 {
    16 / u64::from(classes.stabilisers[class].count_ones())
}

/// Checks a table [`NEAR`](super::NEAR): counts the states with each of the four codes (distance
/// modulo 3, or far) and compares the counts with the known ones. Returns the counts.
///
/// # Errors
/// A message with the found and the known counts.
pub(super) fn verify_near(table: &[u8], _: &dyn Workers) -> Result<Vec<u64>, String> {
    let classes = Classes::build();
    let mut found = [0_u64; 4];
    for class in 0..CLASSES {
        let row = &table[class * NEAR_ROW..];
        let size = class_size(&classes, class);
        (0..TWISTS as u16).for_each(|twist| found[usize::from(near_code(row, twist))] += size);
    }
    let sum = |r: usize| KNOWN[..usize::from(FAR)].iter().skip(r).step_by(3).sum::<u64>();
    let known = [sum(0), sum(1), sum(2), KNOWN[usize::from(FAR)..].iter().sum()];
    compare(&found, &known)
}

/// Checks a table [`WIDE_TABLE`](super::WIDE_TABLE): computes the distances of all states again,
/// compares the counts of distances modulo 3 with the known ones, and compares the effect of each
/// turn with the table. Returns the counts.
///
/// # Errors
/// A message with the number of wrong rows, or with the found and the known counts.
pub(super) fn verify_wide(table: &[u8], workers: &dyn Workers) -> Result<Vec<u64>, String> {
    let frames = Frames::build();
    let distances = levels(&frames, 12, workers, &|_| ());
    let mut sizes = [0_u64; 4];
    for class in 0..CLASSES {
        let size = class_size(&frames.classes, class);
        let row = &distances[class * NEAR_ROW..];
        (0..TWISTS as u16).for_each(|t| sizes[usize::from(near_code(row, t))] += size);
    }
    let packer = Packer::new(&frames, &distances);
    let wrong = AtomicUsize::new(0);
    workers.run(CLASSES.div_ceil(64), &|chunk| {
        let mut out = vec![0; TWISTS * WIDE];
        for class in chunk * 64..CLASSES.min(chunk * 64 + 64) {
            packer.row(class, &mut out);
            let same = out == table[class * TWISTS * WIDE..][..TWISTS * WIDE];
            wrong.fetch_add(usize::from(!same), Relaxed);
        }
    });
    let wrong = wrong.into_inner();
    if wrong > 0 {
        return Err(format!("{wrong} of {CLASSES} rows differ from the distances"));
    }
    let sum = |r: usize| KNOWN.iter().skip(r).step_by(3).sum::<u64>();
    compare(&sizes[..3], &[sum(0), sum(1), sum(2)])
}

/// Returns the counts `found` if they are equal to those in `known`.
///
/// # Errors
/// A message with both lists of counts.
pub(crate) fn compare(found: &[u64], known: &[u64]) -> Result<Vec<u64>, String> {
    if found == known {
        return Ok(found.to_vec());
    }
    Err(format!("counts by distance are {found:?} instead of {known:?}"))
}
