//! The states of phase 2 under turns and symmetries, and the numbers of these states in the tables.
//!
//! - in: the coordinates and symmetries of the cube
//! - out: [`Orders`]; [`State`]

use super::super::coordinates::{
    PERMUTATIONS, PHASE2_TURNS, QUADS, corner_moves, quad, quad_moves, quad_places, rank, unrank,
    with_edges, with_quad,
};
use super::super::symmetry::{SYMMETRIES, places};

/// Where four edges are among eight places, in order.
pub(super) const FOURS: usize = 1680;
/// Classes of corners.
pub(super) const CORNER_CLASSES: usize = 2768;
/// A class's row: upper edges, then lower ones.
pub(super) const ROW: usize = 2 * FOURS;

/// Orders of the corners, and of four edges each: what turns and symmetries do to them.
#[derive(Debug)]
pub(crate) struct Orders {
    /// `[order * 18 + turn]`.
    pub(super) corner_moves: Vec<u16>,
    /// `[quad * 18 + turn]`.
    quad_moves: Vec<u16>,
    /// `[four * 10 + k]`, k a turn of phase 2.
    pub(super) four_moves: Vec<u16>,
    /// `[order * 10 + k]`.
    pub(super) middle_moves: Vec<u8>,
    /// The four of each set of places of a quad, its own order aside; `u16::MAX` where the places
    /// are not the eight.
    pub(super) four_of_set: Vec<u16>,
    /// `[order]`: 16 * class + the symmetry that carries it to the class's representative.
    pub(super) corner_class: Vec<u16>,
    /// `[(symmetry * 2 + lower) * FOURS + four]`.
    pub(super) four_images: Vec<u16>,
    /// Which symmetries exchange up and down.
    pub(super) swaps: [bool; SYMMETRIES],
    /// For each class of corners its representative, and its symmetries as bits.
    pub(super) representatives: Vec<(u16, u16)>,
}

/// Order of corners, and quads of the edges from 0, 4, 8.
pub(crate) type Quads = [u16; 4];

/// A state of phase 2: corners, upper, lower and middle edges.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct State {
    pub(crate) corners: u16,
    pub(crate) upper: u16,
    pub(crate) lower: u16,
    pub(crate) middle: u8,
}

fn transposed<T: Copy + Default>(by_turn: &[T], turns: usize) -> Vec<T> {
    let states = by_turn.len() / turns;
    let mut table = vec![T::default(); by_turn.len()];
    for state in 0..states {
        for turn in 0..turns {
            table[state * turns + turn] = by_turn[turn * states + state];
        }
    }
    table
}

impl Orders {
    pub(crate) fn build() -> Self {
        let corner_moves = transposed(&corner_moves(), 18);
        let quad_moves = transposed(&quad_moves(), 18);
        // The middle layer's own set of places is 0, so in phase 2 the number is the order alone.
        let middle = |i: usize| quad_moves[i / 10 * 18 + PHASE2_TURNS[i % 10]] as u8;
        // Numbers of fours follow those of quads, places beyond the eight left out.
        let quads: Vec<usize> =
            (0..QUADS).filter(|&q| quad_places(q).iter().all(|&p| p < 8)).collect();
        let mut four_of_set = vec![u16::MAX; QUADS / 24];
        quads
            .iter()
            .enumerate()
            .step_by(24)
            .for_each(|(four, q)| four_of_set[q / 24] = four as u16);
        let four_of = |q: usize| four_of_set[q / 24] + (q % 24) as u16;
        let four_moves = quads
            .iter()
            .flat_map(|q| PHASE2_TURNS.map(|t| four_of(usize::from(quad_moves[q * 18 + t]))))
            .collect();
        let (corner_places, edge_places) = places();
        let swaps = edge_places.map(|edges| edges[0] >= 4);
        let mut four_images = Vec::with_capacity(SYMMETRIES * ROW);
        for edges in &edge_places {
            for lower in [0, 4] {
                for &q in &quads {
                    // Edges 8..12 of the cube stand for the four; they are renamed as the symmetry
                    // says.
                    let cube = with_quad(q);
                    let mut image = [u8::MAX; 12];
                    let swapped = if edges[lower] >= 4 { 4 } else { 0 };
                    for (place, &edge) in cube.edges().iter().enumerate() {
                        if edge >= 8 {
                            let piece = edges[usize::from(edge) - 8 + lower] - swapped;
                            image[usize::from(edges[place])] = piece + 8;
                        }
                    }
                    four_images.push(four_of(quad(&with_edges(image), 8)));
                }
            }
        }
        let (corner_class, representatives) = corner_classes(&corner_places);
        Self {
            middle_moves: (0..240).map(middle).collect(),
            corner_moves,
            quad_moves,
            four_moves,
            four_of_set,
            corner_class,
            four_images,
            swaps,
            representatives,
        }
    }

    pub(crate) fn bytes(&self) -> usize {
        let words = [
            &self.corner_moves,
            &self.quad_moves,
            &self.four_moves,
            &self.four_of_set,
            &self.corner_class,
            &self.four_images,
        ];
        words.iter().map(|w| w.len() * 2).sum::<usize>()
            + self.middle_moves.len()
            + self.representatives.len() * 4
    }

    /// Corners after a turn.
    #[inline]
    pub(crate) fn corners(&self, corners: u16, turn: u8) -> u16 {
        self.corner_moves[usize::from(corners) * 18 + usize::from(turn)]
    }

    /// A quad after a turn.
    #[inline]
    pub(crate) fn quad(&self, quad: u16, turn: u8) -> u16 {
        self.quad_moves[usize::from(quad) * 18 + usize::from(turn)]
    }

    /// Where the four edges of a quad are among the eight places of phase 2.
    #[inline]
    pub(crate) fn four(&self, quad: u16) -> u16 {
        self.four_of_set[usize::from(quad / 24)] + quad % 24
    }

    /// The numbers of a state in [`BOUNDS`](super::BOUNDS), corners with the upper and with the
    /// lower edges, and in [`EIGHT`](super::EIGHT).
    #[inline]
    pub(super) fn entries(&self, corners: u16, (upper, lower): (u16, u16)) -> ([usize; 2], usize) {
        let class = usize::from(self.corner_class[usize::from(corners)]);
        let (class, symmetry) = (class >> 4, class & 15);
        let images = &self.four_images[symmetry * ROW..][..ROW];
        let mut images =
            [images[usize::from(upper)], images[FOURS + usize::from(lower)]].map(usize::from);
        if self.swaps[symmetry] {
            images.swap(0, 1);
        }
        // Where the upper ones are, the lower ones are not: their order says all.
        let eight = class * PERMUTATIONS + images[0] * 24 + images[1] % 24;
        ([class * ROW + images[0], class * ROW + FOURS + images[1]], eight)
    }

    /// The number of a state in the table: corners and the four upper (0) or lower (1) edges.
    #[inline]
    pub(super) fn entry(&self, corners: u16, lower: usize, four: u16) -> usize {
        let class = usize::from(self.corner_class[usize::from(corners)]);
        let symmetry = class & 15;
        let image = self.four_images[(symmetry * 2 + lower) * FOURS + usize::from(four)];
        let lower = lower ^ usize::from(self.swaps[symmetry]);
        (class >> 4) * ROW + lower * FOURS + usize::from(image)
    }

    /// The four of the lower edges of a solved cube; that of the upper ones is 0, too, by its own
    /// count.
    pub(crate) fn home(&self) -> State {
        let cube = crate::cube::Cube::SOLVED;
        let four = |first: u8| self.four(quad(&cube, first) as u16);
        State { corners: 0, upper: four(0), lower: four(4), middle: 0 }
    }
}

/// [`Orders::corner_class`] and [`Orders::representatives`].
fn corner_classes(corner_places: &[[u8; 8]; SYMMETRIES]) -> (Vec<u16>, Vec<(u16, u16)>) {
    let mut class_of = vec![u16::MAX; PERMUTATIONS];
    let mut representatives = Vec::with_capacity(CORNER_CLASSES);
    let inverse = |s: usize| {
        let undone = |b: &[u8; 8]| (0..8).all(|i| b[usize::from(corner_places[s][i])] == i as u8);
        corner_places.iter().position(undone).unwrap_or(0) as u16
    };
    let inverses: [u16; SYMMETRIES] = std::array::from_fn(inverse);
    for order in 0..PERMUTATIONS {
        if class_of[order] != u16::MAX {
            continue;
        }
        let class = representatives.len() as u16;
        let corners: [u8; 8] = unrank(order);
        let mut own = 0;
        for (s, places) in corner_places.iter().enumerate() {
            let mut image = [0; 8];
            for (place, &corner) in corners.iter().enumerate() {
                image[usize::from(places[place])] = places[usize::from(corner)];
            }
            let image = rank(&image);
            own |= u16::from(image == order) << s;
            if class_of[image] == u16::MAX {
                class_of[image] = class << 4 | inverses[s];
            }
        }
        // By its first symmetry, which changes nothing.
        class_of[order] = class << 4;
        representatives.push((order as u16, own));
    }
    (class_of, representatives)
}
