//! States of phase 2: their changes by turns and symmetries, and their numbers in the tables.
//!
//! A *quad* is the number of the places of four edges among twelve (11880 values). In phase 2 the
//! four upper and the four lower edges stay on eight places; a *four* is the number of four edges
//! among these (1680 values).
//!
//! - in: the coordinates and symmetries of the cube
//! - out: [`Orders`], the moves of all states; [`State`]

use super::super::coordinates::{
    PERMUTATIONS, PHASE2_TURNS, QUADS, corner_moves, quad, quad_moves, quad_places, rank, unrank,
    with_edges, with_quad,
};
use super::super::symmetry::{SYMMETRIES, places};

/// Number of arrangements of four edges among eight places: 8 x 7 x 6 x 5.
pub(super) const FOURS: usize = 1680;
/// Number of classes of orders of the corners under 16 symmetries.
pub(super) const CORNER_CLASSES: usize = 2768;
/// Length of the row of a class: upper edges, then lower ones.
pub(super) const ROW: usize = 2 * FOURS;

/// Changes of the order of the corners and of four edges each, by turns and symmetries.
#[derive(Debug)]
pub(crate) struct Orders {
    /// Corners after a turn: `[order * 18 + turn]`.
    pub(super) corner_moves: Vec<u16>,
    /// Quad after a turn: `[quad * 18 + turn]`.
    quad_moves: Vec<u16>,
    /// Four after the k-th turn of phase 2: `[four * 10 + k]`.
    pub(super) four_moves: Vec<u16>,
    /// Order of the middle edges after the k-th turn of phase 2: `[order * 10 + k]`.
    pub(super) middle_moves: Vec<u8>,
    /// First four of each set of places, without the order within it; `u16::MAX` where the set is
    /// not within the eight places.
    pub(super) four_of_set: Vec<u16>,
    /// For each order of the corners: 16 * class + the symmetry that carries it to the
    /// representative of its class.
    pub(super) corner_class: Vec<u16>,
    /// Image of a four: `[(symmetry * 2 + lower) * FOURS + four]`.
    pub(super) four_images: Vec<u16>,
    /// Whether each symmetry exchanges up and down.
    pub(super) swaps: [bool; SYMMETRIES],
    /// Representative of each class of corners, and the symmetries that map it to itself, as bits.
    pub(super) representatives: Vec<(u16, u16)>,
}

/// Order of the corners, and quads of the edges 0..4, 4..8 and 8..12.
pub(crate) type Quads = [u16; 4];

/// A state of phase 2: order of the corners, fours of the upper and lower edges, order of the
/// middle ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct State {
    /// Index of the order of the corners.
    pub(crate) corners: u16,
    /// Four of the upper edges.
    pub(crate) upper: u16,
    /// Four of the lower edges.
    pub(crate) lower: u16,
    /// Index of the order of the middle edges.
    pub(crate) middle: u8,
}

/// Reorders a table `[turn][state]` as `[state][turn]`, so that the moves of a state share a cache
/// line.
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
    /// Computes the move tables of phase 2, the images of all states under symmetries, and the
    /// classes of symmetric corners.
    pub(crate) fn build() -> Self {
        let corner_moves = transposed(&corner_moves(), 18);
        let quad_moves = transposed(&quad_moves(), 18);
        // The set of places of the middle layer is 0, so in phase 2 a quad is the order alone.
        let middle = |i: usize| quad_moves[i / 10 * 18 + PHASE2_TURNS[i % 10]] as u8;
        // Fours are numbered in the order of the quads that lie within the eight places.
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
        // Edge place 0 is in the upper layer, places 4..8 are the lower layer.
        let swaps = edge_places.map(|edges| edges[0] >= 4);
        let mut four_images = Vec::with_capacity(SYMMETRIES * ROW);
        for edges in &edge_places {
            for lower in [0, 4] {
                for &q in &quads {
                    // Edges 8..12 of the cube represent the four. The symmetry moves the places and
                    // also renames the pieces: upper edges may become lower ones.
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

    /// Returns the size of all tables of moves, images and classes (bytes).
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

    /// Returns the index of the corners' order after a turn.
    #[inline]
    pub(crate) fn corners(&self, corners: u16, turn: u8) -> u16 {
        self.corner_moves[usize::from(corners) * 18 + usize::from(turn)]
    }

    /// Returns the *quad*, the number of the places of four edges among all twelve, after a turn.
    #[inline]
    pub(crate) fn quad(&self, quad: u16, turn: u8) -> u16 {
        self.quad_moves[usize::from(quad) * 18 + usize::from(turn)]
    }

    /// Converts a *quad*, the number of the places of four edges among all twelve, into a *four*,
    /// their number among the eight places of the upper and lower layers. The edges must be on
    /// these eight places.
    #[inline]
    pub(crate) fn four(&self, quad: u16) -> u16 {
        self.four_of_set[usize::from(quad / 24)] + quad % 24
    }

    /// Returns where the tables have a state: its two indices in [`BOUNDS`](super::BOUNDS), for the
    /// corners with the upper and with the lower edges, and its index in [`EIGHT`](super::EIGHT).
    #[inline]
    pub(super) fn entries(&self, corners: u16, (upper, lower): (u16, u16)) -> ([usize; 2], usize) {
        let class = usize::from(self.corner_class[usize::from(corners)]);
        let (class, symmetry) = (class >> 4, class & 15);
        let images = &self.four_images[symmetry * ROW..][..ROW];
        let mut images =
            [images[usize::from(upper)], images[FOURS + usize::from(lower)]].map(usize::from);
        // With up and down exchanged, the image of the lower edges is the four of the upper ones.
        if self.swaps[symmetry] {
            images.swap(0, 1);
        }
        // The set of places of the lower edges is the complement, so their order is enough.
        let eight = class * PERMUTATIONS + images[0] * 24 + images[1] % 24;
        ([class * ROW + images[0], class * ROW + FOURS + images[1]], eight)
    }

    /// Returns the index in [`BOUNDS`](super::BOUNDS) of an order of the corners with the upper
    /// (`lower` is 0) or lower (1) edges on the places `four`.
    #[inline]
    pub(super) fn entry(&self, corners: u16, lower: usize, four: u16) -> usize {
        let class = usize::from(self.corner_class[usize::from(corners)]);
        let symmetry = class & 15;
        let image = self.four_images[(symmetry * 2 + lower) * FOURS + usize::from(four)];
        let lower = lower ^ usize::from(self.swaps[symmetry]);
        (class >> 4) * ROW + lower * FOURS + usize::from(image)
    }

    /// Returns the solved state. The four of its upper edges is not 0, since the set of the lower
    /// places has the first number.
    pub(crate) fn solved(&self) -> State {
        let cube = crate::cube::Cube::SOLVED;
        let four = |first: u8| self.four(quad(&cube, first) as u16);
        State { corners: 0, upper: four(0), lower: four(4), middle: 0 }
    }
}

/// Divides the orders of the corners into classes of symmetric ones. Returns
/// [`Orders::corner_class`] and [`Orders::representatives`]. `corner_places` has the image of each
/// corner place under each symmetry.
fn corner_classes(corner_places: &[[u8; 8]; SYMMETRIES]) -> (Vec<u16>, Vec<(u16, u16)>) {
    let mut class_of = vec![u16::MAX; PERMUTATIONS];
    let mut representatives = Vec::with_capacity(CORNER_CLASSES);
    let inverse = |s: usize| {
        let undone = |b: &[u8; 8]| (0..8).all(|i| b[usize::from(corner_places[s][i])] == i as u8);
        corner_places.iter().position(undone).unwrap_or(0) as u16
    };
    let inverses: [u16; SYMMETRIES] = std::array::from_fn(inverse);
    // As for the classes of phase 1, the first order that this loop meets represents its class.
    for order in 0..PERMUTATIONS {
        if class_of[order] != u16::MAX {
            continue;
        }
        let class = representatives.len() as u16;
        let corners: [u8; 8] = unrank(order);
        let mut own = 0;
        for (s, places) in corner_places.iter().enumerate() {
            // Conjugation: the symmetry moves the places and renames the pieces.
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
        // The identity, number 0, carries the representative to itself.
        class_of[order] = class << 4;
        representatives.push((order as u16, own));
    }
    (class_of, representatives)
}
