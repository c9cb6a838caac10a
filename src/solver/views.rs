//! The six ways to look at a cube: along three axes, at it and at its inverse.

use super::coordinates::{quad, rank};
use super::phase2::Quads;
use crate::cube::{Cube, Face, Facelets, Rotation24, Turn};
use std::sync::LazyLock;

/// One of the six.
#[derive(Debug, Clone)]
pub(super) struct View {
    /// The cube as it is named by one who looks that way.
    pub(super) cube: Cube,
    /// Its order of corners, and quads of its edges from 0, 4, 8.
    pub(super) orders: Quads,
    /// From the view's frame into the cube's.
    back: Rotation24,
    inverted: bool,
}

/// None, one and two thirds of a turn about the corner URF (up to right to front), and for each sticker and colour
/// where it goes.
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
    pub(super) fn all(cube: &Cube) -> [Self; 6] {
        let facelets = Facelets::from(cube);
        std::array::from_fn(|i| {
            let (rotation, places) = &THIRDS[i / 2];
            let mut renamed = [Face::U; 54];
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

    /// Turns of the view as turns of the cube.
    pub(super) fn turns_of_cube(&self, path: &[u8]) -> Vec<Turn> {
        let of_cube = |&t: &u8| {
            let turn = Turn::from_index(usize::from(t));
            Turn { face: self.back.face(turn.face), ..turn }
        };
        if self.inverted {
            path.iter().rev().map(|t| of_cube(t).inverse()).collect()
        } else {
            path.iter().map(of_cube).collect()
        }
    }
}
