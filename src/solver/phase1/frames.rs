//! Moves of the states of phase 1. A state is the class of (slice, flip), the symmetry that maps
//! the cube to the representative of the class, and the twist of its image under that symmetry.
//!
//! - in: the coordinates and classes of the cube
//! - out: [`Frames`], the moves of all states; [`Place`], a state

use super::super::coordinates::{
    FLIPS, QUADS, TWISTS, flip, flip_moves, quad, quad_moves, twist, twist_moves,
};
use super::super::symmetry::{CLASSES, Classes, Turned, twist_images};
use super::super::table::prefetch;
use crate::cube::Cube;

/// State of phase 1: the representative of its class, the twist of the image under the symmetry,
/// and the symmetry.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Place {
    /// Class of (slice, flip).
    pub(crate) class: u32,
    /// Index of the twists of the image.
    pub(crate) twist: u16,
    /// Symmetry that maps the cube to the representative.
    pub(crate) symmetry: u8,
}

/// Moves of all states.
#[derive(Debug)]
pub(crate) struct Frames {
    /// 16 * class of the neighbour + the symmetry that makes the neighbour the representative of
    /// that class: `[class * 18 + turn]`.
    pub(super) class_moves: Vec<u32>,
    /// Twist after a turn: `[twist * 18 + turn]`.
    pub(super) twist_moves: Vec<u16>,
    /// Twist of the image: `[symmetry * TWISTS + twist]`.
    pub(super) twist_images: Vec<u16>,
    /// Slice of each class.
    pub(super) slice_of_class: Vec<u16>,
    pub(crate) classes: Classes,
    pub(crate) turned: Turned,
}

impl Frames {
    /// Computes the move tables of the states of phase 1.
    pub(crate) fn build() -> Self {
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
        // `Classes::find` searches the representatives for the root, which saves 4 MB of memory.
        classes.of = Vec::new();
        // By state, then by turn: the moves of one state share a cache line.
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

    /// Returns the size of the move tables (bytes).
    pub(crate) fn bytes(&self) -> usize {
        self.class_moves.len() * 4
            + (self.twist_moves.len() + self.twist_images.len() + self.slice_of_class.len()) * 2
            + self.classes.representatives.len() * 4
            + self.classes.stabilisers.len() * 2
    }

    /// Returns the phase 1 state of `cube`: its class, the symmetry that maps it to the
    /// representative of the class, and the twist of its image under that symmetry.
    pub(crate) fn place(&self, cube: &Cube) -> Place {
        let (class, symmetry) = self.classes.find(quad(cube, 8) / 24, flip(cube));
        let twist = self.twist_images[usize::from(symmetry) * TWISTS + twist(cube)];
        Place { class, twist, symmetry }
    }

    /// Prefetches the row of `class` in the move table for a later [`Frames::step`].
    #[inline]
    pub(super) fn prefetch_moves(&self, class: u32) {
        let row = class as usize * 18;
        // A row of 72 bytes touches two cache lines.
        prefetch(&self.class_moves, row);
        prefetch(&self.class_moves, row + 17);
    }

    /// Returns the state after `turn` is made on the representative of `class` with this twist. Its
    /// symmetry is that of this turn alone, from the turned representative to that of the new
    /// class.
    #[inline]
    pub(super) fn step(&self, class: u32, twist: u16, turn: usize) -> Place {
        let entry = self.class_moves[class as usize * 18 + turn];
        let symmetry = (entry & 15) as u8;
        let twist = self.twist_moves[usize::from(twist) * 18 + turn];
        let twist = self.twist_images[usize::from(symmetry) * TWISTS + usize::from(twist)];
        Place { class: entry >> 4, twist, symmetry }
    }
}
