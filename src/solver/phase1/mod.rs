//! Phase 1: how far a cube is from the group <U, D, R2, L2, F2, B2>, and which turns lead nearer.
//!
//! The walk stands always on the representative of its class: after each turn it looks at the cube through the
//! symmetry that makes it one again, and remembers that symmetry. So a state is (class of slice and flips, twist),
//! 64430 x 2187, a turn is two reads, and what the table says of the turns holds as it stands.
//!
//! Two tables know the same distances, and so lead the same walk:
//! - `Near` (36 MB): two bits a state, the distance modulo 3, and 3 for `FAR` or more. The walk knows its own
//!   distance, and a neighbour's differs by at most 1, so two bits are enough; leaving the last levels (three
//!   entries of five) unfilled halves the time to build. Two small tables, of slice and flips and of slice and
//!   twists, spare most reads.
//! - `Wide` (423 MB): three bytes a state, which say of each turn whether it leads nearer, farther or neither.
//!   The four states that turns of one face carry into each other lie within one step, so 15 cases, four bits, hold
//!   what the three turns of a face do.

use super::coordinates::{
    FLIPS, QUADS, TWISTS, flip, flip_moves, quad, quad_moves, twist, twist_moves,
};
use super::symmetry::{CLASSES, Classes, Turned, twist_images};
use super::table::{TableSpec, prefetch};
use crate::cube::Cube;

mod faces;
mod fill;

pub(crate) use faces::{FaceCases, Small};
pub(super) use fill::{compare, near};

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
pub(crate) static NEAR: TableSpec = TableSpec {
    name: "phase1",
    version: 1,
    bytes: CLASSES * NEAR_ROW,
    purpose: "two-phase: distances modulo 3 of the first phase",
    build: fill::build_near,
    verify: fill::verify_near,
};

/// The table of phase 1 that knows what each turn does.
pub(crate) static WIDE_TABLE: TableSpec = TableSpec {
    name: "phase1-large",
    version: 1,
    bytes: CLASSES * TWISTS * WIDE,
    purpose: "two-phase, large set: what each turn does to the distance of the first phase",
    build: fill::build_wide,
    verify: fill::verify_wide,
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
pub(crate) struct Frames {
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

    /// Fetches what [`Frames::step`] needs of a class, before it is asked for.
    #[inline]
    fn expect(&self, class: u32) {
        let row = class as usize * 18;
        prefetch(&self.class_moves, row);
        prefetch(&self.class_moves, row + 17);
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
    fn children(&self, at: (Place, u32, u8), turns: u32, left: u8, into: &mut [Child]) -> usize;
    /// Those of `turns` that lead from a place one turn away to the goal.
    fn last(&self, at: (Place, u32, u8), turns: u32) -> u32;
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
        into: &mut [Child],
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
            if left > 1 {
                self.frames.expect(place.class);
            }
            into[count] = Child { place, turn: turn as u8, distance, entry };
            count += 1;
        }
        count
    }

    #[inline]
    fn last(&self, (_, entry, _): (Place, u32, u8), turns: u32) -> u32 {
        turns & self.faces.masks(entry).0
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
    /// Turns after which a place may be at most `left` away, for all that the small tables know.
    #[inline]
    fn near_enough(&self, place: Place, left: u8) -> u32 {
        // So far away, they know nothing: neither has a distance above 9, and few of 8.
        if left > 7 {
            return ALL_TURNS;
        }
        let slice = usize::from(self.frames.slice_of_class[place.class as usize]);
        self.faces.within(self.small.flips[place.class as usize], left)
            & self.faces.within(self.small.twists[slice * TWISTS + usize::from(place.twist)], left)
    }

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
        into: &mut [Child],
    ) -> usize {
        let mut mask = turns & self.near_enough(place, left);
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

    #[inline]
    fn last(&self, (place, _, _): (Place, u32, u8), turns: u32) -> u32 {
        // No flips and no twists, and the slice in its place: that is the goal.
        turns & self.near_enough(place, 0)
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
