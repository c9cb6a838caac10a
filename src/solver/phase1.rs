//! Phase 1: how far a cube is from the group <U, D, R2, L2, F2, B2>, and which turns lead nearer.
//!
//! The walk stands always on the representative of its class: after each turn it looks at the cube through the
//! symmetry that makes it one again, and remembers that symmetry. So a state is (class of slice and flips, twist),
//! 64430 x 2187, a turn is two reads, and what the table says of the turns holds as it stands.
//!
//! Two tables know the same distances, and so lead the same walk:
//! - [`Near`] (36 MB): two bits a state, the distance modulo 3, and 3 for [`FAR`] or more. The walk knows its own
//!   distance, and a neighbour's differs by at most 1, so two bits are enough; leaving the last levels (three
//!   entries of five) unfilled halves the time to build. Two small tables, of slice and flips and of slice and
//!   twists, spare most reads.
//! - [`Wide`] (423 MB): three bytes a state, which say of each turn whether it leads nearer, farther or neither.
//!   The four states that turns of one face carry into each other lie within one step, so 15 cases, four bits, hold
//!   what the three turns of a face do.

use super::coordinates::{
    FLIPS, QUADS, SLICES, TWISTS, flip, flip_moves, quad, quad_moves, twist, twist_moves,
};
use super::symmetry::{CLASSES, Classes, SYMMETRIES, Turned, twist_images};
use super::table::{Progress, TableSpec, Workers};
use crate::cube::Cube;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::{LazyLock, Mutex, PoisonError};

/// Bytes of a class's row of twists in [`Near`].
const NEAR_ROW: usize = 552;
/// Bytes of a state in [`Wide`].
const WIDE: usize = 3;
/// The distance that stands for itself and all above in [`Near`].
pub(super) const FAR: u8 = 10;
/// All turns.
pub(super) const ALL_TURNS: u32 = (1 << 18) - 1;

/// States of phase 1 at each distance (Kociemba's page; Scherphuis).
const KNOWN: [u64; 13] = [
    1, 4, 50, 592, 7156, 87236, 1043817, 12070278, 124946368, 821605960, 1199128738, 58202444, 476,
];

/// The two-bit table of phase 1.
pub static NEAR: TableSpec = TableSpec {
    name: "phase1",
    version: 1,
    bytes: CLASSES * NEAR_ROW,
    purpose: "two-phase: distances modulo 3 of the first phase",
    build: build_near,
    verify: verify_near,
};

/// The table of phase 1 that knows what each turn does.
pub static WIDE_TABLE: TableSpec = TableSpec {
    name: "phase1-large",
    version: 1,
    bytes: CLASSES * TWISTS * WIDE,
    purpose: "two-phase, large set: what each turn does to the distance of the first phase",
    build: build_wide,
    verify: verify_wide,
};

/// Where the walk stands: class, twist, and the symmetry through which it looks at the cube.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Place {
    pub(super) class: u32,
    pub(super) twist: u16,
    pub(super) symmetry: u8,
}

/// What turns do to places.
#[derive(Debug)]
pub struct Frames {
    /// `[class * 18 + turn]`: 16 * class + the symmetry that makes the neighbour its class's representative.
    class_moves: Vec<u32>,
    /// `[twist * 18 + turn]`.
    twist_moves: Vec<u16>,
    /// `[symmetry * TWISTS + twist]`.
    twist_images: Vec<u16>,
    slice_of_class: Vec<u16>,
    pub(super) classes: Classes,
    pub(super) turned: Turned,
}

impl Frames {
    pub(super) fn build() -> Self {
        let mut classes = Classes::build();
        let (flips, quads) = (flip_moves(), quad_moves());
        let mut class_moves = vec![0; CLASSES * 18];
        for (class, &raw) in classes.representatives.iter().enumerate() {
            let (slice, flip) = (raw as usize / FLIPS, raw as usize % FLIPS);
            for turn in 0..18 {
                let slice = usize::from(quads[turn * QUADS + slice * 24]) / 24;
                let flip = usize::from(flips[turn * FLIPS + flip]);
                class_moves[class * 18 + turn] = classes.of[slice * FLIPS + flip];
            }
        }
        // A root is sought among the representatives: 4 MB less to keep.
        classes.of = Vec::new();
        let by_turn = twist_moves();
        let twist_moves = (0..TWISTS * 18).map(|i| by_turn[i % 18 * TWISTS + i / 18]).collect();
        let slice_of_class =
            classes.representatives.iter().map(|&r| (r as usize / FLIPS) as u16).collect();
        Self {
            class_moves,
            twist_moves,
            twist_images: twist_images(),
            slice_of_class,
            classes,
            turned: Turned::build(),
        }
    }

    pub(super) fn bytes(&self) -> usize {
        self.class_moves.len() * 4
            + (self.twist_moves.len() + self.twist_images.len() + self.slice_of_class.len()) * 2
            + self.classes.representatives.len() * 4
            + self.classes.stabilisers.len() * 2
    }

    /// Where a cube stands.
    pub(super) fn place(&self, cube: &Cube) -> Place {
        let (class, symmetry) = self.classes.find(quad(cube, 8) / 24, flip(cube));
        let twist = self.twist_images[usize::from(symmetry) * TWISTS + twist(cube)];
        Place { class, twist, symmetry }
    }

    /// The place after a turn as the walk sees it; the symmetry is the step's alone.
    #[inline]
    fn step(&self, class: u32, twist: u16, turn: usize) -> Place {
        let entry = self.class_moves[class as usize * 18 + turn];
        let symmetry = (entry & 15) as u8;
        let twist = self.twist_moves[usize::from(twist) * 18 + turn];
        let twist = self.twist_images[usize::from(symmetry) * TWISTS + usize::from(twist)];
        Place { class: entry >> 4, twist, symmetry }
    }
}

/// A neighbour that is near enough.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Child {
    /// Its symmetry is the step's alone.
    pub(super) place: Place,
    /// As the walk sees it.
    pub(super) turn: u8,
    pub(super) distance: u8,
    /// What the table says of the child's own turns.
    pub(super) entry: u32,
}

/// A table that leads the walk.
pub(super) trait Guide: Sync {
    /// What the table says of the turns from a place.
    fn entry(&self, place: Place) -> u32;
    /// The neighbours by `turns` that are at most `left` from the goal, and how many.
    fn children(&self, at: (Place, u32, u8), turns: u32, left: u8, into: &mut [Child; 18])
    -> usize;
    /// The distance of a place.
    fn distance(&self, place: Place) -> u8;
}

/// [`WIDE_TABLE`] at work.
#[derive(Clone, Copy)]
pub(super) struct Wide<'a> {
    pub(super) frames: &'a Frames,
    pub(super) faces: &'a FaceCases,
    pub(super) table: &'a [u8],
}

impl Guide for Wide<'_> {
    #[inline]
    fn entry(&self, place: Place) -> u32 {
        let at = (place.class as usize * TWISTS + usize::from(place.twist)) * WIDE;
        let b = &self.table[at..at + WIDE];
        u32::from(b[0]) | u32::from(b[1]) << 8 | u32::from(b[2]) << 16
    }

    #[inline]
    fn children(
        &self,
        (place, entry, distance): (Place, u32, u8),
        turns: u32,
        left: u8,
        into: &mut [Child; 18],
    ) -> usize {
        let (nearer, not_farther) = self.faces.masks(entry);
        let mut mask = turns
            & match (left + 1).wrapping_sub(distance) {
                0 => nearer,
                1 => not_farther,
                _ => ALL_TURNS,
            };
        let mut count = 0;
        while mask != 0 {
            let turn = mask.trailing_zeros();
            mask &= mask - 1;
            let place = self.frames.step(place.class, place.twist, turn as usize);
            let (a, b) = (nearer >> turn & 1, not_farther >> turn & 1);
            let distance = distance + 1 - (a + b) as u8;
            // Read here, so that all neighbours wait for memory together.
            let entry = if left > 0 { self.entry(place) } else { 0 };
            into[count] = Child { place, turn: turn as u8, distance, entry };
            count += 1;
        }
        count
    }

    fn distance(&self, mut place: Place) -> u8 {
        let mut distance = 0;
        while (place.class, place.twist) != (0, 0) {
            let (nearer, _) = self.faces.masks(self.entry(place));
            place = self.frames.step(place.class, place.twist, nearer.trailing_zeros() as usize);
            distance += 1;
        }
        distance
    }
}

/// [`NEAR`] at work.
#[derive(Clone, Copy)]
pub(super) struct Near<'a> {
    pub(super) frames: &'a Frames,
    pub(super) faces: &'a FaceCases,
    pub(super) small: &'a Small,
    pub(super) table: &'a [u8],
}

impl Near<'_> {
    /// The distance modulo 3, or 3 for [`FAR`] and more.
    #[inline]
    fn code(&self, class: u32, twist: u16) -> u8 {
        near_code(&self.table[class as usize * NEAR_ROW..], twist)
    }
}

#[inline]
fn near_code(row: &[u8], twist: u16) -> u8 {
    row[usize::from(twist >> 2)] >> (twist % 4 * 2) & 3
}

impl Guide for Near<'_> {
    #[inline]
    fn entry(&self, _: Place) -> u32 {
        0
    }

    #[inline]
    fn children(
        &self,
        (place, _, distance): (Place, u32, u8),
        turns: u32,
        left: u8,
        into: &mut [Child; 18],
    ) -> usize {
        let slice = usize::from(self.frames.slice_of_class[place.class as usize]);
        let mut mask = turns
            & self.faces.within(self.small.flips[place.class as usize], left)
            & self.faces.within(self.small.twists[slice * TWISTS + usize::from(place.twist)], left);
        let (mut count, mut read) = (0, [(Place::default(), 0_u8, 0_u8); 18]);
        while mask != 0 {
            let turn = mask.trailing_zeros();
            mask &= mask - 1;
            let place = self.frames.step(place.class, place.twist, turn as usize);
            // All read before any is judged, so that they wait for memory together.
            read[count] = (place, turn as u8, self.code(place.class, place.twist));
            count += 1;
        }
        let mut kept = 0;
        for &(place, turn, code) in &read[..count] {
            let distance = neighbour_distance(distance, code);
            into[kept] = Child { place, turn, distance, entry: 0 };
            kept += usize::from(distance <= left);
        }
        kept
    }

    fn distance(&self, mut place: Place) -> u8 {
        let mut distance = 0;
        if self.code(place.class, place.twist) == 3 {
            return FAR;
        }
        while (place.class, place.twist) != (0, 0) {
            let nearer = (self.code(place.class, place.twist) + 2) % 3;
            let next = (0..18)
                .map(|turn| self.frames.step(place.class, place.twist, turn))
                .find(|p| self.code(p.class, p.twist) == nearer);
            match next {
                Some(next) => place = next,
                None => return FAR,
            }
            distance += 1;
        }
        distance
    }
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

/// What turns do to a distance, packed: four bits a face in the order U D, R L, F B.
///
/// The four states of a face's turns have two neighbouring distances at most. Case 0..8: this state is the nearer,
/// and bit q - 1 says that q quarters lead farther; case 7 + b, b in 1..8: bit q - 1 of b says that q lead nearer.
#[derive(Debug)]
pub struct FaceCases {
    /// `[pair * 256 + two cases]`: turns that lead nearer in bits 0..18, not farther in bits 32..50.
    masks: Vec<u64>,
}

/// Faces in the order of the packed cases.
const CASE_FACES: [usize; 6] = [0, 3, 1, 4, 2, 5];

impl FaceCases {
    pub(super) fn build() -> Self {
        let mut masks = vec![0; 3 * 256];
        for (at, mask) in masks.iter_mut().enumerate() {
            for half in 0..2 {
                let face = CASE_FACES[at / 256 * 2 + half];
                let case = at % 256 >> (half * 4) & 15;
                let (nearer, not_farther) = if case < 8 { (0, 7 & !case) } else { (case - 7, 7) };
                *mask |= (nearer as u64) << (face * 3) | (not_farther as u64) << (face * 3 + 32);
            }
        }
        Self { masks }
    }

    /// Turns that lead nearer, and those that do not lead farther.
    #[inline]
    fn masks(&self, entry: u32) -> (u32, u32) {
        let [a, b, c, _] = entry.to_le_bytes().map(usize::from);
        let masks = self.masks[a] | self.masks[256 + b] | self.masks[512 + c];
        (masks as u32, (masks >> 32) as u32)
    }

    /// Turns after which a state is at most `left` away, from its cases and, in the uppermost byte, its distance.
    #[inline]
    fn within(&self, entry: u32, left: u8) -> u32 {
        let distance = (entry >> 24) as u8;
        if left > distance {
            return ALL_TURNS;
        }
        let (nearer, not_farther) = self.masks(entry);
        match distance - left {
            0 => not_farther,
            1 => nearer,
            _ => 0,
        }
    }

    /// Packs what the turns do: `distances[turn]` beside `distance`.
    fn pack(distance: u8, distances: &[u8; 18]) -> u32 {
        CASE_FACES.iter().enumerate().fold(0, |entry, (i, face)| {
            let of = |q: usize| distances[face * 3 + q];
            let bits = |d: u8| (0..3).fold(0, |b, q| b | u32::from(of(q) == d) << q);
            let nearer = bits(distance.wrapping_sub(1));
            let case = if nearer > 0 { 7 + nearer } else { bits(distance + 1) };
            entry | case << (i * 4)
        })
    }
}

/// Distances that look at two of the three coordinates only: [`FaceCases`] and the distance, for each class of slice
/// and flips, and for each slice and twist.
#[derive(Debug)]
pub struct Small {
    flips: Vec<u32>,
    twists: Vec<u32>,
}

impl Small {
    pub(super) fn build(frames: &Frames) -> Self {
        let slices: Vec<u16> = {
            let quads = quad_moves();
            (0..SLICES * 18).map(|i| quads[i % 18 * QUADS + i / 18 * 24] / 24).collect()
        };
        let flips =
            |class: usize, turn: usize| (frames.class_moves[class * 18 + turn] >> 4) as usize;
        let twists = |state: usize, turn: usize| {
            let (slice, twist) = (state / TWISTS, state % TWISTS);
            usize::from(slices[slice * 18 + turn]) * TWISTS
                + usize::from(frames.twist_moves[twist * 18 + turn])
        };
        Self { flips: packed(CLASSES, flips), twists: packed(SLICES * TWISTS, twists) }
    }

    pub(super) fn bytes(&self) -> usize {
        (self.flips.len() + self.twists.len()) * 4
    }
}

/// Cases and distances of all states, by what each turn does to them.
fn packed(states: usize, turned: impl Fn(usize, usize) -> usize) -> Vec<u32> {
    let mut distances = vec![u8::MAX; states];
    distances[0] = 0;
    let (mut frontier, mut next, mut depth) = (vec![0], Vec::new(), 0);
    while !frontier.is_empty() {
        depth += 1;
        for state in frontier.drain(..) {
            for turn in 0..18 {
                let neighbour = turned(state, turn);
                if distances[neighbour] == u8::MAX {
                    distances[neighbour] = depth;
                    next.push(neighbour);
                }
            }
        }
        std::mem::swap(&mut frontier, &mut next);
    }
    (0..states)
        .map(|state| {
            let around = std::array::from_fn(|turn| distances[turned(state, turn)]);
            FaceCases::pack(distances[state], &around) | u32::from(distances[state]) << 24
        })
        .collect()
}

fn build_near(workers: &dyn Workers, progress: Progress<'_>) -> Vec<u8> {
    near(&Frames::build(), workers, progress)
}

/// Builds [`NEAR`]: breadth first from the goal, up to the last level that is told apart.
pub(super) fn near(frames: &Frames, workers: &dyn Workers, progress: Progress<'_>) -> Vec<u8> {
    levels(frames, FAR - 1, workers, progress)
}

/// Distances modulo 3 up to a deepest one, [`NEAR_ROW`] bytes a class, breadth first from the goal.
///
/// Each row is written by one worker, which looks at the newest entries of its class's 18 neighbours: so no worker
/// waits for another, and classes with symmetries of their own need no care.
fn levels(frames: &Frames, deepest: u8, workers: &dyn Workers, progress: Progress<'_>) -> Vec<u8> {
    let back = Backwards::new(frames);
    let mut table = vec![u8::MAX; CLASSES * NEAR_ROW];
    table[0] = !3;
    // For each class the twists of the last level.
    let mut newest: Vec<Vec<u16>> = vec![Vec::new(); CLASSES];
    newest[0].push(0);
    for depth in 1..=deepest {
        let mut next: Vec<Vec<u16>> = vec![Vec::new(); CLASSES];
        let chunks: Vec<Mutex<Chunk<'_>>> = table
            .chunks_mut(NEAR_ROW * CHUNK)
            .zip(next.chunks_mut(CHUNK))
            .map(|(rows, found)| Mutex::new(Chunk { rows, found }))
            .collect();
        workers.run(chunks.len(), &|number| {
            // Each task has a chunk of its own; the lock only says so.
            let mut chunk = chunks[number].lock().unwrap_or_else(PoisonError::into_inner);
            let Chunk { rows, found } = &mut *chunk;
            for (k, row) in rows.chunks_mut(NEAR_ROW).enumerate() {
                pull(&back, number * CHUNK + k, depth, &newest, row, &mut found[k]);
            }
        });
        drop(chunks);
        newest = next;
        let done: u64 = KNOWN[..=usize::from(depth)].iter().sum();
        let all: u64 = KNOWN[..=usize::from(deepest)].iter().sum();
        progress(done as f64 / all as f64);
    }
    table
}

/// Classes that one task takes.
const CHUNK: usize = 64;

/// Rows of some classes, and the twists that are found for each.
struct Chunk<'a> {
    rows: &'a mut [u8],
    found: &'a mut [Vec<u16>],
}

/// What leads from a neighbour's twist back to one's own.
struct Backwards<'a> {
    frames: &'a Frames,
    /// `[turn * TWISTS + twist]`: the twist before that turn.
    before: Vec<u16>,
    /// `[symmetry * TWISTS + twist]`: the twist whose image it is.
    origin: Vec<u16>,
}

impl<'a> Backwards<'a> {
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

/// Gives `depth` to all unfilled entries of a class with a neighbour that is one nearer.
fn pull(
    back: &Backwards<'_>,
    class: usize,
    depth: u8,
    newest: &[Vec<u16>],
    row: &mut [u8],
    found: &mut Vec<u16>,
) {
    let filled = 3 ^ depth % 3;
    // No branch on what is filled already: it would be guessed wrongly every third time.
    let (mut marked, mut count) = ([0_u16; TWISTS + 1], 0);
    for turn in 0..18 {
        let entry = back.frames.class_moves[class * 18 + turn] as usize;
        let before: &[u16; TWISTS] = rows(&back.before, turn);
        let origin: &[u16; TWISTS] = rows(&back.origin, entry & 15);
        for &twist in &newest[entry >> 4] {
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

/// The row with this number.
fn rows(table: &[u16], number: usize) -> &[u16; TWISTS] {
    table.as_chunks().0.get(number).unwrap_or(&[0; TWISTS])
}

/// Builds [`WIDE_TABLE`]: all distances modulo 3 first, then what each turn does to each.
fn build_wide(workers: &dyn Workers, progress: Progress<'_>) -> Vec<u8> {
    let frames = Frames::build();
    let distances = levels(&frames, 12, workers, &|done| progress(done * 0.5));
    let packer = Packer::new(&frames, &distances);
    let row = TWISTS * WIDE;
    let mut table = vec![0; CLASSES * row];
    let rows: Vec<Mutex<&mut [u8]>> = table.chunks_mut(row * CHUNK).map(Mutex::new).collect();
    let done = AtomicUsize::new(0);
    workers.run(rows.len(), &|chunk| {
        // Each task has a chunk of its own; the lock only says so.
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

/// What turns do to the states of one class.
struct Packer<'a> {
    frames: &'a Frames,
    distances: &'a [u8],
    /// `[turn * TWISTS + twist]`.
    twist_moves: Vec<u16>,
    /// What three turns of a face do, two bits each (0 nothing, 1 farther, 2 nearer), as its case.
    cases: [u8; 64],
}

impl<'a> Packer<'a> {
    fn new(frames: &'a Frames, distances: &'a [u8]) -> Self {
        let cases = std::array::from_fn(|changes| {
            let bits = |wanted: usize| {
                (0..3).fold(0, |b, q| b | u8::from(changes >> (2 * q) & 3 == wanted) << q)
            };
            if bits(2) > 0 { 7 + bits(2) } else { bits(1) }
        });
        Self { frames, distances, twist_moves: twist_moves(), cases }
    }

    fn row(&self, class: usize, out: &mut [u8]) {
        let own = &self.distances[class * NEAR_ROW..][..NEAR_ROW];
        // Two bits a turn; modulo 3 is enough, as neighbours differ by one at most.
        let mut changes = [0_u64; TWISTS];
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

/// Three codes of two bits, each less a fourth, modulo 3: `[the fourth][three]`.
static LESS: LazyLock<[[usize; 64]; 3]> = LazyLock::new(|| {
    std::array::from_fn(|own| {
        std::array::from_fn(|three| {
            (0..3).fold(0, |all, q| {
                let code = three >> (2 * q) & 3;
                all | (code % 3 + 3 - own) % 3 << (2 * q)
            })
        })
    })
});

/// How many raw states an entry of a class stands for.
fn class_size(classes: &Classes, class: usize) -> u64 {
    16 / u64::from(classes.stabilisers[class].count_ones())
}

/// Counts by distance modulo 3, and 3 for far: four numbers.
fn verify_near(table: &[u8], _: &dyn Workers) -> Result<Vec<u64>, String> {
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

/// Finds the distances again, counts them by what they are modulo 3, and compares what each turn does.
fn verify_wide(table: &[u8], workers: &dyn Workers) -> Result<Vec<u64>, String> {
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

/// The counts, if they are as known.
pub(super) fn compare(found: &[u64], known: &[u64]) -> Result<Vec<u64>, String> {
    if found == known {
        return Ok(found.to_vec());
    }
    Err(format!("counts by distance are {found:?} instead of {known:?}"))
}
