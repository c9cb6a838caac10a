//! Coordinates: numbers of those features of a cube that each phase solves, and their changes by
//! turns.
//!
//! | phase | coordinate | values |
//! |---|---|---|
//! | 1 | twists of the corners | 3^7 = 2187 |
//! | 1 | flips of the edges | 2^11 = 2048 |
//! | 1 | set of places of the four middle-layer edges | C(12, 4) = 495 |
//! | 2 | order of the corners | 8! = 40320 |
//! | 2 | order of the eight other edges | 8! = 40320 |
//! | 2 | order of the four middle-layer edges | 4! = 24 |
//!
//! Each coordinate of the solved cube is 0, except the [`quad`]s of the edges 0..4 and 4..8.

use crate::cube::{Cube, Turn};
use std::sync::LazyLock;

/// Number of states of the corners' twists.
pub(crate) const TWISTS: usize = 2187;
/// Number of states of the edges' flips.
pub(crate) const FLIPS: usize = 2048;
/// Number of sets of places of four edges.
pub(crate) const SLICES: usize = 495;
/// Number of arrangements of four edges: sets of places, times orders.
pub(crate) const QUADS: usize = SLICES * 24;
/// Number of orders of eight pieces.
pub(crate) const PERMUTATIONS: usize = 40320;

/// Turns of phase 2, as numbers of [`Turn::index`]: U and D by any angle, the others by halves.
pub(crate) const PHASE2_TURNS: [usize; 10] = [0, 1, 2, 9, 10, 11, 4, 7, 13, 16];

/// Two tables for the sets of 4 among 12 places, where bit i of a set stands for place i: the
/// number of each set, and the set with each number. The middle layer (places 8..12) has the number
/// 0.
static SETS: LazyLock<(Vec<u16>, Vec<u16>)> = LazyLock::new(|| {
    // In descending order: the bits of the middle layer are the greatest, so it gets number 0.
    let sets: Vec<u16> = (0..4096_u16).rev().filter(|b| b.count_ones() == 4).collect();
    let mut number = vec![0; 4096];
    for (n, &bits) in sets.iter().enumerate() {
        number[usize::from(bits)] = n as u16;
    }
    (number, sets)
});

/// Returns the index of the corners' twists, 0..2187: the first seven twists as digits in base 3.
/// The eighth twist follows from the others, since all of them sum up to a multiple of 3.
#[must_use]
pub(crate) fn twist(cube: &Cube) -> usize {
    cube.twists()[..7].iter().fold(0, |n, &t| n * 3 + usize::from(t))
}

/// Returns the cube whose twists have the index `number` and which is solved otherwise: the inverse
/// of [`twist`].
#[must_use]
pub(crate) fn with_twist(mut number: usize) -> Cube {
    let mut twists = [0; 8];
    for twist in twists[..7].iter_mut().rev() {
        *twist = (number % 3) as u8;
        number /= 3;
    }
    twists[7] = (3 - twists.iter().sum::<u8>() % 3) % 3;
    let solved = Cube::SOLVED;
    Cube::from_pieces(*solved.corners(), twists, *solved.edges(), *solved.flips())
}

/// Returns the index of the edges' flips, 0..2048: the first eleven flips as bits. The twelfth flip
/// follows from the others, since the number of flipped edges is even.
#[must_use]
pub(crate) fn flip(cube: &Cube) -> usize {
    cube.flips()[..11].iter().fold(0, |n, &f| n * 2 + usize::from(f))
}

/// Returns the cube whose flips have the index `number` and which is solved otherwise: the inverse
/// of [`flip`].
#[must_use]
pub(crate) fn with_flip(number: usize) -> Cube {
    let mut flips = [0; 12];
    for (i, flip) in flips[..11].iter_mut().enumerate() {
        *flip = (number >> (10 - i) & 1) as u8;
    }
    flips[11] = flips.iter().sum::<u8>() % 2;
    let solved = Cube::SOLVED;
    Cube::from_pieces(*solved.corners(), *solved.twists(), *solved.edges(), flips)
}

/// Returns the index of the arrangement of the four edges `first..first + 4`, 0..11880: 24 x (index
/// of the set of their four places) + (index of their order on these places).
#[must_use]
pub(crate) fn quad(cube: &Cube, first: u8) -> usize {
    // The set is the slow digit, so `quad / 24` is the coordinate of phase 1 and, once phase 1 is
    // done and the set is 0, the number itself is the order in phase 2.
    let (mut bits, mut order, mut found) = (0_usize, [0; 4], 0);
    for (place, &edge) in cube.edges().iter().enumerate() {
        if (first..first + 4).contains(&edge) {
            bits |= 1 << place;
            order[found] = edge - first;
            found += 1;
        }
    }
    usize::from(SETS.0[bits]) * 24 + rank(&order)
}

/// Returns the places of the four edges whose [`quad`] is `number`: `places[k]` is the place of the
/// edge `first + k`.
#[must_use]
pub(crate) fn quad_places(number: usize) -> [u8; 4] {
    let order: [u8; 4] = unrank(number % 24);
    let (mut places, mut k) = ([0; 4], 0);
    for place in 0..12 {
        if SETS.1[number / 24] >> place & 1 == 1 {
            places[usize::from(order[k])] = place as u8;
            k += 1;
        }
    }
    places
}

/// Returns a cube whose middle-layer edges, 8..12, have the [`quad`] `number`, with the other edges
/// in ascending order and all else solved. No real cube may have this order, because the
/// permutation may be odd, so the cube serves to compute coordinates only.
#[must_use]
pub(crate) fn with_quad(number: usize) -> Cube {
    let mut edges = [u8::MAX; 12];
    for (k, place) in quad_places(number).into_iter().enumerate() {
        edges[usize::from(place)] = 8 + k as u8;
    }
    let mut others = 0..8;
    for edge in &mut edges {
        if *edge == u8::MAX {
            *edge = others.next().unwrap_or(0);
        }
    }
    with_edges(edges)
}

/// Returns a cube with the edge `edges[place]` at each place and all else solved, without a check
/// that such a cube can exist.
#[must_use]
pub(crate) fn with_edges(edges: [u8; 12]) -> Cube {
    let solved = Cube::SOLVED;
    Cube::from_pieces(*solved.corners(), *solved.twists(), edges, *solved.flips())
}

/// Returns the position of a permutation of 0..N among all of them in lexicographic order.
#[must_use]
pub(crate) fn rank<const N: usize>(permutation: &[u8; N]) -> usize {
    // The digits of the factorial number system: later entries that are smaller than entry i.
    (0..N).fold(0, |n, i| {
        let smaller = permutation[i + 1..].iter().filter(|&&p| p < permutation[i]).count();
        n * (N - i) + smaller
    })
}

/// Returns the permutation of 0..N at the position `number` in lexicographic order: the inverse of
/// [`rank`].
#[must_use]
pub(crate) fn unrank<const N: usize>(mut number: usize) -> [u8; N] {
    let mut permutation = [0; N];
    for i in (0..N).rev() {
        permutation[i] = (number % (N - i)) as u8;
        number /= N - i;
        // The digit was the rank of entry i among the entries from i on: make room for it.
        for k in i + 1..N {
            permutation[k] += u8::from(permutation[k] >= permutation[i]);
        }
    }
    permutation
}

/// Returns, for each face, the solved cube after a clockwise quarter turn of that face.
fn quarters() -> [Cube; 6] {
    std::array::from_fn(|f| Cube::SOLVED.apply(Turn::from_index(f * 3)))
}

/// Returns the move table of a coordinate with `size` states: `table[turn * size + state]` is the
/// state after the turn. `quarter(state)` returns the states after the six clockwise quarter turns,
/// from which those after all 18 turns follow.
fn by_quarters(size: usize, quarter: impl Fn(usize) -> [usize; 6]) -> Vec<u16> {
    let mut table = vec![0; 18 * size];
    for state in 0..size {
        for (face, next) in quarter(state).into_iter().enumerate() {
            table[face * 3 * size + state] = next as u16;
        }
    }
    // Half turns and counterclockwise ones are two and three quarters: no need to compute cubes.
    for face in 0..6 {
        for state in 0..size {
            let once = |s: u16| usize::from(table[face * 3 * size + usize::from(s)]);
            let half = once(table[face * 3 * size + state]) as u16;
            let three = once(half) as u16;
            table[(face * 3 + 1) * size + state] = half;
            table[(face * 3 + 2) * size + state] = three;
        }
    }
    table
}

/// Returns the move table of [`twist`]: `[turn * TWISTS + twist]` is the index of the twists after
/// the turn.
#[must_use]
pub(crate) fn twist_moves() -> Vec<u16> {
    let quarters = quarters();
    by_quarters(TWISTS, |n| quarters.map(|q| twist(&with_twist(n).then(&q))))
}

/// Returns the move table of [`flip`]: `[turn * FLIPS + flip]` is the index of the flips after the
/// turn.
#[must_use]
pub(crate) fn flip_moves() -> Vec<u16> {
    let quarters = quarters();
    by_quarters(FLIPS, |n| quarters.map(|q| flip(&with_flip(n).then(&q))))
}

/// Returns the move table of [`quad`]: `[turn * QUADS + quad]` is the index after the turn. The
/// table is right for every `first`, since any four edges move alike.
#[must_use]
pub(crate) fn quad_moves() -> Vec<u16> {
    let quarters = quarters();
    by_quarters(QUADS, |n| {
        let cube = with_quad(n);
        quarters.map(|q| quad(&cube.then(&q), 8))
    })
}

/// Returns the move table of the corners' order: `[turn * PERMUTATIONS + order]` is the [`rank`] of
/// the corners after the turn.
#[must_use]
pub(crate) fn corner_moves() -> Vec<u16> {
    let quarters = quarters();
    by_quarters(PERMUTATIONS, |n| {
        let corners: [u8; 8] = unrank(n);
        quarters.map(|q| rank(&q.corners().map(|from| corners[usize::from(from)])))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solved_cube_has_coordinates_zero() {
        let cube = Cube::SOLVED;

        assert_eq!([twist(&cube), flip(&cube), quad(&cube, 8)], [0; 3]);
        assert_eq!(rank(cube.corners()), 0);
    }

    #[test]
    fn cubes_and_coordinates_convert_both_ways() {
        (0..TWISTS).for_each(|n| assert_eq!(twist(&with_twist(n)), n));
        (0..FLIPS).for_each(|n| assert_eq!(flip(&with_flip(n)), n));
        (0..QUADS).for_each(|n| assert_eq!(quad(&with_quad(n), 8), n));
        (0..PERMUTATIONS).for_each(|n| assert_eq!(rank(&unrank::<8>(n)), n));
    }

    #[test]
    fn move_tables_match_turns_of_cubes() {
        let (twists, flips, quads, corners) =
            (twist_moves(), flip_moves(), quad_moves(), corner_moves());
        for seed in 0..20 {
            let cube = Cube::scrambled(seed);
            for turn in Turn::all() {
                let (t, next) = (turn.index(), cube.apply(turn));
                assert_eq!(usize::from(twists[t * TWISTS + twist(&cube)]), twist(&next));
                assert_eq!(usize::from(flips[t * FLIPS + flip(&cube)]), flip(&next));
                for first in [0, 4, 8] {
                    let moved = quads[t * QUADS + quad(&cube, first)];
                    assert_eq!(usize::from(moved), quad(&next, first));
                }
                let moved = corners[t * PERMUTATIONS + rank(cube.corners())];
                assert_eq!(usize::from(moved), rank(next.corners()));
            }
        }
    }
}
