//! Look-up in the two tables of phase 1: the turns after which the goal of phase 1 is within reach.
//!
//! - in: a state, its distance, the turns in question, the number of turns left after them
//! - out: the neighbours from which the turns left suffice, by [`Guide`]; [`Wide`] and [`Near`]
//!   give equal ones where less than [`FAR`] turns are left

use super::super::coordinates::TWISTS;
use super::faces::{ALL_TURNS, FaceCases, Small};
use super::frames::{Frames, Place};

/// Size of a class in [`Near`]: two bits for each of 2187 twists, rounded up to 8 bytes (bytes).
pub(super) const NEAR_ROW: usize = 552;
/// Size of a state in [`Wide`] (bytes).
pub(super) const WIDE: usize = 3;
/// Distance from which on [`Near`] has one code for all (turns).
pub(crate) const FAR: u8 = 10;

/// A neighbour from which the turns left can lead to the goal.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Child {
    /// State after the turn; its symmetry is that of the step alone.
    pub(crate) place: Place,
    /// Turn of the representative.
    pub(crate) turn: u8,
    /// Distance of the state after the turn from the goal (turns).
    pub(crate) distance: u8,
    /// Entry of the child, which describes its turns.
    pub(crate) entry: u32,
}

/// A table of phase 1.
pub(crate) trait Guide: Sync {
    /// Reads the entry of a state: for each turn, whether it leads nearer to the goal. Returns 0
    /// for a table without such entries, as in [`Near`].
    fn entry(&self, place: Place) -> u32;
    /// Writes to `into` the states after each of `turns` (bits) that are at most `left` turns from
    /// the goal, and returns how many there are. `at` is the state before the turn, its entry and
    /// its distance.
    fn children(&self, at: (Place, u32, u8), turns: u32, left: u8, into: &mut [Child]) -> usize;
    /// Returns those of `turns` (bits) that lead to the goal from a state one turn away from it.
    /// `at` is this state, its entry and its distance.
    fn last(&self, at: (Place, u32, u8), turns: u32) -> u32;
    /// Computes the distance of a state from the goal of phase 1 (turns). [`Near`] returns [`FAR`]
    /// for all greater distances as well.
    fn distance(&self, place: Place) -> u8;
}

/// Look-up in [`WIDE_TABLE`](super::WIDE_TABLE).
#[derive(Clone, Copy)]
pub(crate) struct Wide<'a> {
    pub(crate) frames: &'a Frames,
    pub(crate) faces: &'a FaceCases,
    pub(crate) table: &'a [u8],
}

impl Guide for Wide<'_> {
    /// Reads the three bytes of the state.
    #[inline]
    fn entry(&self, place: Place) -> u32 {
        let at = (place.class as usize * TWISTS + usize::from(place.twist)) * WIDE;
        let b = &self.table[at..at + WIDE];
        u32::from(b[0]) | u32::from(b[1]) << 8 | u32::from(b[2]) << 16
    }

    /// Finds the children by the entry of the state alone, which tells how each turn changes the
    /// distance. Reads the entries of the children for the next step.
    #[inline]
    fn children(
        &self,
        (place, entry, distance): (Place, u32, u8),
        turns: u32,
        left: u8,
        into: &mut [Child],
    ) -> usize {
        let (nearer, not_farther) = self.faces.masks(entry);
        // The search visits a state only if it is at most `left + 1` from the goal.
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
            // A turn that leads nearer has both bits: the distance changes by +1, 0 or -1.
            let (a, b) = (nearer >> turn & 1, not_farther >> turn & 1);
            let distance = distance + 1 - (a + b) as u8;
            // The entries of all neighbours are read here, so that they wait for memory together.
            let entry = if left > 0 { self.entry(place) } else { 0 };
            if left > 1 {
                self.frames.prefetch_moves(place.class);
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

    /// Follows turns that lead nearer until the goal is reached, and counts them.
    fn distance(&self, mut place: Place) -> u8 {
        // The entries hold no distances.
        let mut distance = 0;
        while (place.class, place.twist) != (0, 0) {
            let (nearer, _) = self.faces.masks(self.entry(place));
            place = self.frames.step(place.class, place.twist, nearer.trailing_zeros() as usize);
            distance += 1;
        }
        distance
    }
}

/// Look-up in [`NEAR`](super::NEAR).
#[derive(Clone, Copy)]
pub(crate) struct Near<'a> {
    pub(crate) frames: &'a Frames,
    pub(crate) faces: &'a FaceCases,
    pub(crate) small: &'a Small,
    pub(crate) table: &'a [u8],
}

impl Near<'_> {
    /// Returns the turns, as bits, after which a state can be at most `left` turns from the goal
    /// according to the small tables.
    #[inline]
    fn near_enough(&self, place: Place, left: u8) -> u32 {
        // Neither small table has a distance above 9, and few of 8, so they would reject nothing.
        if left > 7 {
            return ALL_TURNS;
        }
        let slice = usize::from(self.frames.slice_of_class[place.class as usize]);
        self.faces.within(self.small.flips[place.class as usize], left)
            & self.faces.within(self.small.twists[slice * TWISTS + usize::from(place.twist)], left)
    }

    /// Returns the distance of a state from the goal modulo 3, or 3 for [`FAR`] and more.
    #[inline]
    fn code(&self, class: u32, twist: u16) -> u8 {
        near_code(&self.table[class as usize * NEAR_ROW..], twist)
    }
}

/// Reads the two-bit code of a twist from the row of a class in [`Near`].
#[inline]
pub(super) fn near_code(row: &[u8], twist: u16) -> u8 {
    row[usize::from(twist >> 2)] >> (twist % 4 * 2) & 3
}

impl Guide for Near<'_> {
    #[inline]
    fn entry(&self, _: Place) -> u32 {
        0
    }

    /// Rejects most turns by the small tables and reads the distances after the others from the
    /// large one.
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
            // All codes are read before any is compared, so that they wait for memory together.
            read[count] = (place, turn as u8, self.code(place.class, place.twist));
            count += 1;
        }
        // No branch: a child that is too far is overwritten by the next one.
        let mut kept = 0;
        for &(place, turn, code) in &read[..count] {
            let distance = neighbour_distance(distance, code);
            into[kept] = Child { place, turn, distance, entry: 0 };
            kept += usize::from(distance <= left);
        }
        kept
    }

    /// Finds the turns by the small tables alone.
    #[inline]
    fn last(&self, (place, _, _): (Place, u32, u8), turns: u32) -> u32 {
        // Both small tables at 0 mean no flips, no twists and the slice in its place: the goal. No
        // read of the large table is needed.
        turns & self.near_enough(place, 0)
    }

    /// Follows turns that lead nearer until the goal is reached, and counts them.
    fn distance(&self, mut place: Place) -> u8 {
        let mut distance = 0;
        if self.code(place.class, place.twist) == 3 {
            return FAR;
        }
        // A state nearer by one has the code that is smaller by one, modulo 3.
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

/// Returns the distance from the goal of a neighbour of a state that is `distance` away. The code
/// of the neighbour is its distance modulo 3, or 3 for [`FAR`] and more.
#[inline]
fn neighbour_distance(distance: u8, code: u8) -> u8 {
    if code == 3 {
        return FAR;
    }
    // `FAR` means FAR or more, so the nearest neighbour with a code of its own is at FAR - 1.
    if distance == FAR {
        return FAR - 1;
    }
    match (code + 3 - distance % 3) % 3 {
        0 => distance,
        1 => distance + 1,
        _ => distance - 1,
    }
}
