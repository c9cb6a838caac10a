//! The two tables of phase 1 at work: which turns lead a walk nearer.
//!
//! - in: a place, its distance, the turns in question
//! - out: by [`Guide`], the neighbours that are near enough; [`Wide`] and [`Near`] lead the same
//!   walk

use super::super::coordinates::TWISTS;
use super::faces::{ALL_TURNS, FaceCases, Small};
use super::frames::{Frames, Place};

/// Bytes of a class's row of twists in [`Near`].
pub(super) const NEAR_ROW: usize = 552;
/// Bytes of a state in [`Wide`].
pub(super) const WIDE: usize = 3;
/// The distance that stands for itself and all above in [`Near`].
pub(crate) const FAR: u8 = 10;

/// A neighbour that is near enough.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Child {
    /// Its symmetry is the step's alone.
    pub(crate) place: Place,
    /// As the walk sees it.
    pub(crate) turn: u8,
    pub(crate) distance: u8,
    /// What the table says of the child's own turns.
    pub(crate) entry: u32,
}

/// A table that leads the walk.
pub(crate) trait Guide: Sync {
    /// What the table says of the turns from a place.
    fn entry(&self, place: Place) -> u32;
    /// The neighbours by `turns` that are at most `left` from the goal, and how many.
    fn children(&self, at: (Place, u32, u8), turns: u32, left: u8, into: &mut [Child]) -> usize;
    /// Those of `turns` that lead from a place one turn away to the goal.
    fn last(&self, at: (Place, u32, u8), turns: u32) -> u32;
    /// The distance of a place.
    fn distance(&self, place: Place) -> u8;
}

/// [`WIDE_TABLE`](super::WIDE_TABLE) at work.
#[derive(Clone, Copy)]
pub(crate) struct Wide<'a> {
    pub(crate) frames: &'a Frames,
    pub(crate) faces: &'a FaceCases,
    pub(crate) table: &'a [u8],
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

/// [`NEAR`](super::NEAR) at work.
#[derive(Clone, Copy)]
pub(crate) struct Near<'a> {
    pub(crate) frames: &'a Frames,
    pub(crate) faces: &'a FaceCases,
    pub(crate) small: &'a Small,
    pub(crate) table: &'a [u8],
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
pub(super) fn near_code(row: &[u8], twist: u16) -> u8 {
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
