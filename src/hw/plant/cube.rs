//! The cube as a puzzle with layers: stickers, angles of the layers, friction of the interfaces.
//!
//! The core is the middle layer with the six centres. On each axis the two outer layers turn
//! against it, each by its own angle and with its own friction. The angles are continuous while a
//! layer turns. When another axis becomes active, whole quarters become a permutation of stickers
//! and the rest remains as misalignment.
//!
//! - friction of an interface: `tau0 + detent |sin 2 phi|`, plus
//!   `mu (r_l F_lateral + r_f M_tilt / lever + r_f |F_axial|)`, plus a share of the other axes'
//!   misalignment
//! - source: load-dependent friction, corner cutting and their numbers are assumptions of the
//!   project

use super::config::CubeMechanics;
use crate::cube::{Axis, Face};
use nalgebra::Vector3;
use std::f64::consts::FRAC_PI_2;

/// Radius at which a lateral force rubs, radius at which tilt and axial force rub, lever of a tilt
/// (m).
const RUB: (f64, f64, f64) = (0.020, 0.026, 0.020);
/// Friction per misalignment of another layer (Nm/rad): 0.05 Nm per degree.
const CORNER_FRICTION: f64 = 0.05 * 57.295_779_513_082_32;

/// Set of layers: bit 0 the negative outer one, bit 1 the middle one, bit 2 the positive one.
pub(super) type Layers = u8;
/// Set of the middle layer alone.
pub(super) const MIDDLE: Layers = 2;

/// Load that an interface transmits, beside the torque about its axis.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct InterfaceLoad {
    /// Force across the axis (N).
    pub(super) lateral: f64,
    /// Torque across the axis (Nm).
    pub(super) tilt: f64,
    /// Force along the axis (N).
    pub(super) axial: f64,
}

/// Stickers of a cube, angles of its layers and their friction.
#[derive(Debug, Clone)]
pub(super) struct Puzzle {
    /// Colours by position in the core's frame, with the layers at the quarter of their last
    /// settling.
    stickers: [u8; 54],
    /// Angles of the negative and the positive outer layer of each axis against the core (rad).
    pub(super) angles: [[f64; 2]; 3],
    /// Factor of the unloaded friction of each interface.
    friction: [[f64; 2]; 3],
    /// Torque that each layer needs in addition under a fault (Nm).
    pub(super) jam: f64,
    pub(super) mechanics: CubeMechanics,
    /// Destination of each sticker for a right-handed quarter turn of an outer layer.
    quarter: [[[u8; 54]; 2]; 3],
}

impl Puzzle {
    /// Makes a cube with straight layers. `friction` has, by axis and side, the factor of the
    /// unloaded friction of each interface.
    pub(super) fn new(
        stickers: [u8; 54],
        mechanics: CubeMechanics,
        friction: [[f64; 2]; 3],
    ) -> Self {
        let quarter = std::array::from_fn(|axis| {
            std::array::from_fn(|side| quarter_turn(Axis::ALL[axis], side == 1))
        });
        Self { stickers, angles: [[0.0; 2]; 3], friction, jam: 0.0, mechanics, quarter }
    }

    /// Returns the colours of the 54 stickers by position, before the present turn of one axis: the
    /// renderer turns the layers of that axis by [`Puzzle::angles`].
    pub(super) fn stickers(&self) -> &[u8; 54] {
        &self.stickers
    }

    /// Sets the stickers and the angles of the outer layers to saved ones.
    pub(super) fn restore(&mut self, stickers: [u8; 54], angles: [[f64; 2]; 3]) {
        (self.stickers, self.angles) = (stickers, angles);
    }

    /// Returns the index of the axis whose outer layers are turned farthest from the core.
    pub(super) fn turned_axis(&self) -> usize {
        let off = |a: usize| self.angles[a][0].abs().max(self.angles[a][1].abs());
        (1..3).fold(0, |best, a| if off(a) > off(best) { a } else { best })
    }

    /// Moves the whole quarter turns in the angles of an axis's layers into the permutation of the
    /// stickers. An angle of at most an eighth of a turn remains.
    pub(super) fn settle(&mut self, axis: usize) {
        for side in 0..2 {
            let quarters = (self.angles[axis][side] / FRAC_PI_2).round();
            self.angles[axis][side] -= quarters * FRAC_PI_2;
            for _ in 0..(quarters as i64).rem_euclid(4) {
                let mut turned = self.stickers;
                for (i, to) in self.quarter[axis][side].iter().enumerate() {
                    turned[usize::from(*to)] = self.stickers[i];
                }
                self.stickers = turned;
            }
        }
    }

    /// Returns the largest angle between a layer of `axis` and its nearest quarter turn (rad).
    pub(super) fn misalignment(&self, axis: usize) -> f64 {
        let off = |a: f64| (a - (a / FRAC_PI_2).round() * FRAC_PI_2).abs();
        off(self.angles[axis][0]).max(off(self.angles[axis][1]))
    }

    /// Checks whether a layer of another axis is so far off a quarter turn that the layers of
    /// `axis` cannot turn.
    pub(super) fn blocked(&self, axis: usize) -> bool {
        (0..3).any(|a| a != axis && self.misalignment(a) > self.mechanics.corner_cut)
    }

    /// Returns the torque (Nm) at which an outer layer of `axis` starts to turn against the middle
    /// one while `load` acts between them. `side` is 0 for the negative layer, 1 for the positive
    /// one.
    pub(super) fn turning_torque(&self, axis: usize, side: usize, load: InterfaceLoad) -> f64 {
        let InterfaceLoad { lateral, tilt, axial } = load;
        let m = &self.mechanics;
        // The detent has its zeros at the quarters and halfway between them.
        let (sine, _) = libm::sincos(2.0 * self.angles[axis][side]);
        let (r_lateral, r_face, lever) = RUB;
        // Corners below the cut do not block, but they rub.
        let corners: f64 =
            (0..3).filter(|a| *a != axis).map(|a| CORNER_FRICTION * self.misalignment(a)).sum();
        m.turning_torque * self.friction[axis][side]
            + m.detent * sine.abs()
            + m.friction * (r_lateral * lateral + r_face * tilt / lever + r_face * axial.abs())
            + corners
            + self.jam
    }

    /// Returns the colours of the 54 stickers in the order URFDLB, with every layer at its nearest
    /// quarter turn. Each colour is named by the face whose centre has it, so the result does not
    /// depend on how the cube is held.
    pub(super) fn facelets(&self) -> [u8; 54] {
        let mut settled = self.clone();
        for axis in 0..3 {
            settled.settle(axis);
        }
        // The core carries the centres and never turns in its own frame, so usually each colour
        // keeps its name. Otherwise the colours are renamed by their centres' faces.
        let mut name = [0_u8; 6];
        for face in 0..6 {
            name[usize::from(settled.stickers[face * 9 + 4])] = face as u8;
        }
        settled.stickers.map(|colour| name[usize::from(colour)])
    }
}

/// Returns the position of a sticker: the coordinates of its cubie (-1, 0 or 1 each), and the
/// direction that the sticker faces.
fn place(index: usize) -> (Vector3<f64>, Vector3<f64>) {
    let face = Face::ALL[index / 9];
    let (column, row) = face.reading_axes();
    let (r, c) = ((index % 9 / 3) as f64 - 1.0, (index % 3) as f64 - 1.0);
    (face.normal() + column * c + row * r, face.normal())
}

/// Returns the destination of each sticker in a right-handed quarter turn of an outer layer about
/// `axis`: the layer on the positive side if `positive`, else the one on the negative side.
fn quarter_turn(axis: Axis, positive: bool) -> [u8; 54] {
    let unit = axis.unit();
    // A right-handed quarter: the part along the axis stays, the rest is crossed with the axis.
    // Cubies have whole coordinates, so comparisons are exact.
    let turn = |v: Vector3<f64>| unit * unit.dot(&v) + unit.cross(&v);
    let layer = if positive { 1.0 } else { -1.0 };
    std::array::from_fn(|i| {
        let (at, out) = place(i);
        if at.dot(&unit) != layer {
            return i as u8;
        }
        let wanted = (turn(at), turn(out));
        (0..54).find(|k| place(*k) == wanted).unwrap_or(i) as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a cube whose stickers have their positions as colours, so that all of them differ.
    fn puzzle() -> Puzzle {
        let stickers = std::array::from_fn(|i| i as u8);
        Puzzle::new(stickers, CubeMechanics::of_2007(), [[1.0; 2]; 3])
    }

    #[test]
    fn clockwise_turn_of_top_brings_right_row_front() {
        let mut puzzle = puzzle();

        // Clockwise seen from outside is a left-handed turn about the outward normal.
        puzzle.angles[2][1] = -FRAC_PI_2;
        puzzle.settle(2);

        let f = 18;
        let r = 9;
        assert_eq!(&puzzle.stickers[f..f + 3], &[r as u8, r as u8 + 1, r as u8 + 2]);
        assert_eq!(puzzle.stickers[0], 6, "the sticker of U7 has moved to U1");
        assert_eq!(puzzle.angles[2][1], 0.0);
    }

    #[test]
    fn quarter_turn_moves_twenty_stickers_full_turn_none() {
        for axis in 0..3 {
            for side in 0..2 {
                let mut puzzle = puzzle();
                puzzle.angles[axis][side] = FRAC_PI_2;
                puzzle.settle(axis);
                let moved = (0..54).filter(|i| puzzle.stickers[*i] != *i as u8).count();
                assert_eq!(moved, 20);

                puzzle.angles[axis][side] = 3.0 * FRAC_PI_2;
                puzzle.settle(axis);
                assert!((0..54).all(|i| puzzle.stickers[i] == i as u8));
            }
        }
    }
}
