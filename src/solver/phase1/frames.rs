//! The moves of a walk's places: class of slice and flips, twist, and the symmetry through which
//! the walk looks at the cube.
//!
//! - in: the coordinates and classes of the cube
//! - out: [`Frames`], the moves of all places; [`Place`]

use super::super::coordinates::{
    FLIPS, QUADS, TWISTS, flip, flip_moves, quad, quad_moves, twist, twist_moves,
};
use super::super::symmetry::{CLASSES, Classes, Turned, twist_images};
use super::super::table::prefetch;
use crate::cube::Cube;

/// Where the walk stands: class, twist, and the symmetry through which it looks at the cube.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Place {
    pub(crate) class: u32,
    pub(crate) twist: u16,
    pub(crate) symmetry: u8,
}

/// The moves of all places.
#[derive(Debug)]
pub(crate) struct Frames {
    /// `[class * 18 + turn]`: 16 * class + the symmetry that makes the neighbour its class's
    /// representative.
    pub(super) class_moves: Vec<u32>,
    /// `[twist * 18 + turn]`.
    pub(super) twist_moves: Vec<u16>,
    /// `[symmetry * TWISTS + twist]`.
    pub(super) twist_images: Vec<u16>,
    pub(super) slice_of_class: Vec<u16>,
    pub(crate) classes: Classes,
    pub(crate) turned: Turned,
}

impl Frames {
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

    pub(crate) fn bytes(&self) -> usize {
        self.class_moves.len() * 4
            + (self.twist_moves.len() + self.twist_images.len() + self.slice_of_class.len()) * 2
            + self.classes.representatives.len() * 4
            + self.classes.stabilisers.len() * 2
    }

    /// Where a cube stands.
    pub(crate) fn place(&self, cube: &Cube) -> Place {
        let (class, symmetry) = self.classes.find(quad(cube, 8) / 24, flip(cube));
        let twist = self.twist_images[usize::from(symmetry) * TWISTS + twist(cube)];
        Place { class, twist, symmetry }
    }

    /// Fetches what [`Frames::step`] needs of a class, before it is asked for.
    #[inline]
    pub(super) fn expect(&self, class: u32) {
        let row = class as usize * 18;
        prefetch(&self.class_moves, row);
        prefetch(&self.class_moves, row + 17);
    }

    /// The place after a turn as the walk sees it; the symmetry is the step's alone.
    #[inline]
    pub(super) fn step(&self, class: u32, twist: u16, turn: usize) -> Place {
        let entry = self.class_moves[class as usize * 18 + turn];
        let symmetry = (entry & 15) as u8;
        let twist = self.twist_moves[usize::from(twist) * 18 + turn];
        let twist = self.twist_images[usize::from(symmetry) * TWISTS + usize::from(twist)];
        Place { class: entry >> 4, twist, symmetry }
    }
}
