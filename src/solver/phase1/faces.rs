//! Packed effects of the turns of each face on the distance of a state, and the small tables that
//! hold them.

use super::super::coordinates::{QUADS, SLICES, TWISTS, quad_moves};
use super::super::symmetry::CLASSES;
use super::frames::Frames;

/// Set of all turns, as bits.
pub(crate) const ALL_TURNS: u32 = (1 << 18) - 1;

/// Decoder of packed entries: four bits a face in the order U D, R L, F B.
///
/// A state and its three neighbours by turns of one face lie within one step of each other, so they
/// have at most two distances, `d` and `d + 1`. In the cases 0..8 the state itself is at `d`, and
/// bit `q - 1` is set if `q` quarter turns lead farther. In the case `7 + b`, `b` in 1..8, the
/// state is at `d + 1`, and bit `q - 1` of `b` is set if `q` quarter turns lead nearer.
#[derive(Debug)]
pub(crate) struct FaceCases {
    /// `[pair * 256 + two cases]`: turns that lead nearer in bits 0..18, turns that do not lead
    /// farther in bits 32..50.
    masks: Vec<u64>,
}

/// Faces in the order of the packed cases.
pub(super) const CASE_FACES: [usize; 6] = [0, 3, 1, 4, 2, 5];

impl FaceCases {
    /// Builds the masks of turns for each value of each of an entry's three bytes. A byte has the
    /// cases of two opposite faces.
    pub(crate) fn build() -> Self {
        let mut masks = vec![0; 3 * 256];
        for (at, mask) in masks.iter_mut().enumerate() {
            for half in 0..2 {
                let face = CASE_FACES[at / 256 * 2 + half];
                let case = ((at % 256) >> (half * 4)) & 15;
                let (nearer, not_farther) = if case < 8 { (0, 7 & !case) } else { (case - 7, 7) };
                *mask |= (nearer as u64) << (face * 3) | (not_farther as u64) << (face * 3 + 32);
            }
        }
        Self { masks }
    }

    /// Returns two sets of turns, as bits, for the state of an entry: the turns that lead nearer to
    /// the goal of phase 1, and those that do not lead farther.
    #[inline]
    pub(super) fn masks(&self, entry: u32) -> (u32, u32) {
        let [a, b, c, _] = entry.to_le_bytes().map(usize::from);
        let masks = self.masks[a] | self.masks[256 + b] | self.masks[512 + c];
        (masks as u32, (masks >> 32) as u32)
    }

    /// Returns the turns, as bits, after which a state is at most `left` turns from the goal.
    /// `entry` is the state's entry in [`Small`]: the cases of its turns and, in the uppermost
    /// byte, its distance.
    #[inline]
    pub(super) fn within(&self, entry: u32, left: u8) -> u32 {
        let distance = (entry >> 24) as u8;
        if left > distance {
            return ALL_TURNS;
        }
        let (nearer, not_farther) = self.masks(entry);
        // A turn changes the distance by at most 1.
        match distance - left {
            0 => not_farther,
            1 => nearer,
            _ => 0,
        }
    }

    /// Packs which turns lead a state nearer to the goal or farther, four bits a face. `distance`
    /// is that of the state, `distances[turn]` that after each turn.
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

/// Two small tables, each of two of the three coordinates of phase 1. An entry has the cases of
/// [`FaceCases`] and the distance, which is a lower bound for all three coordinates together.
#[derive(Debug)]
pub(crate) struct Small {
    /// Entry of each class of symmetric (slice, flip).
    pub(super) flips: Vec<u32>,
    /// Entry of each (slice, twist): `[slice * TWISTS + twist]`.
    pub(super) twists: Vec<u32>,
}

impl Small {
    /// Computes both tables: by slice and flips, and by slice and twists.
    pub(crate) fn build(frames: &Frames) -> Self {
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

    /// Returns the size of both tables (bytes).
    pub(crate) fn bytes(&self) -> usize {
        (self.flips.len() + self.twists.len()) * 4
    }
}

/// Computes the entry of each state of a small table: the cases of its turns and its distance from
/// state 0, the goal. `turned(state, turn)` returns the state after a turn.
fn packed(states: usize, turned: impl Fn(usize, usize) -> usize) -> Vec<u32> {
    // Breadth first from the goal, which is state 0.
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
