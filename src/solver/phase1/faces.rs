//! What the turns of each face do to a distance, packed; and the small tables made of it.

use super::super::coordinates::{QUADS, SLICES, TWISTS, quad_moves};
use super::super::symmetry::CLASSES;
use super::frames::Frames;

/// All turns.
pub(crate) const ALL_TURNS: u32 = (1 << 18) - 1;

/// What turns do to a distance, packed: four bits a face in the order U D, R L, F B.
///
/// The four states of a face's turns have two neighbouring distances at most. Case 0..8: this state
/// is the nearer, and bit q - 1 says that q quarters lead farther; case 7 + b, b in 1..8: bit q - 1
/// of b says that q lead nearer.
#[derive(Debug)]
pub(crate) struct FaceCases {
    /// `[pair * 256 + two cases]`: turns that lead nearer in bits 0..18, not farther in bits
    /// 32..50.
    masks: Vec<u64>,
}

/// Faces in the order of the packed cases.
pub(super) const CASE_FACES: [usize; 6] = [0, 3, 1, 4, 2, 5];

impl FaceCases {
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

    /// Turns that lead nearer, and those that do not lead farther.
    #[inline]
    pub(super) fn masks(&self, entry: u32) -> (u32, u32) {
        let [a, b, c, _] = entry.to_le_bytes().map(usize::from);
        let masks = self.masks[a] | self.masks[256 + b] | self.masks[512 + c];
        (masks as u32, (masks >> 32) as u32)
    }

    /// Turns after which a state is at most `left` away, from its cases and, in the uppermost byte,
    /// its distance.
    #[inline]
    pub(super) fn within(&self, entry: u32, left: u8) -> u32 {
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

/// Distances that look at two of the three coordinates only: [`FaceCases`] and the distance, for
/// each class of slice and flips, and for each slice and twist.
#[derive(Debug)]
pub(crate) struct Small {
    pub(super) flips: Vec<u32>,
    pub(super) twists: Vec<u32>,
}

impl Small {
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

    pub(crate) fn bytes(&self) -> usize {
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
