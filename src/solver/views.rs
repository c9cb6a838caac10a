//! The six views of a cube: the cube and its inverse, each with one of three axes upright.
//!
//! Phase 1 leads into a group with a distinguished axis, so each axis has first phases of its own.
//! The inverse cube has solutions of equal length, but other first phases. Six searches therefore
//! find short solutions sooner than one.

use super::coordinates::{quad, rank};
use super::phase2::Quads;
use crate::cube::{Cube, Face, Facelets, Rotation24, Turn};
use std::sync::LazyLock;

/// One view of a cube.
#[derive(Debug, Clone)]
pub(super) struct View {
    /// Cube in the frame of the view, inverted if the view is of the inverse.
    pub(super) cube: Cube,
    /// Order of its corners, and quads of its edges 0..4, 4..8 and 8..12.
    pub(super) orders: Quads,
    /// Rotation from the frame of the view into that of the original cube.
    back: Rotation24,
    /// Whether the view is of the inverse cube.
    inverted: bool,
}

/// Rotations by none, one and two thirds of a turn about the corner URF (up to right to front),
/// each with the new place of every sticker.
static THIRDS: LazyLock<[(Rotation24, [u8; 54]); 3]> = LazyLock::new(|| {
    let third = Rotation24::all()
        .find(|r| r.face(Face::U) == Face::R && r.face(Face::R) == Face::F)
        .unwrap_or(Rotation24::IDENTITY);
    [Rotation24::IDENTITY, third, third.after(third)].map(|rotation| {
        let place = |i: usize| {
            let place = crate::cube::facelet_place(i);
            crate::cube::facelet_at(rotation.cell(place.cell()), rotation.face(place.face)) as u8
        };
        (rotation, std::array::from_fn(place))
    })
});

impl View {
    /// Returns the six views of a cube: the cube and its inverse, each in three rotations that make
    /// another axis the up-down axis.
    pub(super) fn all(cube: &Cube) -> [Self; 6] {
        let facelets = Facelets::from(cube);
        std::array::from_fn(|i| {
            let (rotation, places) = &THIRDS[i / 2];
            let mut renamed = [Face::U; 54];
            // A rotation moves each sticker and also renames its colour, so that centres keep the
            // colours of the solved cube.
            for (sticker, &place) in places.iter().enumerate() {
                renamed[usize::from(place)] = rotation.face(facelets.colour(sticker));
            }
            let straight = Cube::from_possible(&Facelets::from_faces(renamed));
            let inverted = i % 2 == 1;
            let cube = if inverted { straight.inverse() } else { straight };
            let quads = [0, 4, 8].map(|first| quad(&cube, first) as u16);
            let orders = [rank(cube.corners()) as u16, quads[0], quads[1], quads[2]];
            Self { cube, orders, back: rotation.inverse(), inverted }
        })
    }

    /// Converts a solution of the view, as indices of turns, into a solution of the original cube.
    pub(super) fn turns_of_cube(&self, path: &[u8]) -> Vec<Turn> {
        let of_cube = |&t: &u8| {
            let turn = Turn::from_index(usize::from(t));
            Turn { face: self.back.face(turn.face), ..turn }
        };
        // The turns A B solve the inverse cube if B' A' solves the cube.
        if self.inverted {
            path.iter().rev().map(|t| of_cube(t).inverse()).collect()
        } else {
            path.iter().map(of_cube).collect()
        }
    }
}
