//! Numbers for what the two phases look at, and what the turns do to them.
//!
//! Phase 1 sees the corners' twists (2187), the edges' flips (2048) and where the four middle-layer edges are
//! (495); phase 2 the order of the corners (40320), of the eight other edges (40320) and of the middle four (24).
//! All are 0 on the solved cube.

use crate::cube::{Cube, Turn};
use std::sync::LazyLock;

/// Twists of the corners.
pub(crate) const TWISTS: usize = 2187;
/// Flips of the edges.
pub(crate) const FLIPS: usize = 2048;
/// Places of four edges.
pub(crate) const SLICES: usize = 495;
/// Places of four edges in order.
pub(crate) const QUADS: usize = SLICES * 24;
/// Orders of eight pieces.
pub(crate) const PERMUTATIONS: usize = 40320;

/// The turns of phase 2, as numbers of [`Turn::index`]: U, D by any angle, the others by halves.
pub(crate) const PHASE2_TURNS: [usize; 10] = [0, 1, 2, 9, 10, 11, 4, 7, 13, 16];

/// Number of a set of 4 among 12 positions (as bits), and back; the middle layer (positions 8..12) is 0.
static SETS: LazyLock<(Vec<u16>, Vec<u16>)> = LazyLock::new(|| {
    let sets: Vec<u16> = (0..4096_u16).rev().filter(|b| b.count_ones() == 4).collect();
    let mut number = vec![0; 4096];
    for (n, &bits) in sets.iter().enumerate() {
        number[usize::from(bits)] = n as u16;
    }
    (number, sets)
});

/// The corners' twists as a number in base 3; the last follows from the others.
#[must_use]
pub(crate) fn twist(cube: &Cube) -> usize {
    cube.twists()[..7].iter().fold(0, |n, &t| n * 3 + usize::from(t))
}

/// A cube with these twists.
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

/// The edges' flips as a number in base 2; the last follows from the others.
#[must_use]
pub(crate) fn flip(cube: &Cube) -> usize {
    cube.flips()[..11].iter().fold(0, |n, &f| n * 2 + usize::from(f))
}

/// A cube with these flips.
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

/// Where the edges `first..first + 4` are and in which order: 24 x (number of the set of places) + order.
#[must_use]
pub(crate) fn quad(cube: &Cube, first: u8) -> usize {
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

/// The places of a [`quad`]: `places[k]` is where the edge `first + k` is.
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

/// A cube (perhaps of odd permutation: good for coordinates only) whose edges 8..12 are at a [`quad`].
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

/// Returns the cube with these edges, whatever they are, and nothing else out of its place.
#[must_use]
pub(crate) fn with_edges(edges: [u8; 12]) -> Cube {
    let solved = Cube::SOLVED;
    Cube::from_pieces(*solved.corners(), *solved.twists(), edges, *solved.flips())
}

/// Position of a permutation in lexicographic order.
#[must_use]
pub(crate) fn rank<const N: usize>(permutation: &[u8; N]) -> usize {
    (0..N).fold(0, |n, i| {
        let smaller = permutation[i + 1..].iter().filter(|&&p| p < permutation[i]).count();
        n * (N - i) + smaller
    })
}

/// The permutation at a position in lexicographic order.
#[must_use]
pub(crate) fn unrank<const N: usize>(mut number: usize) -> [u8; N] {
    let mut permutation = [0; N];
    for i in (0..N).rev() {
        permutation[i] = (number % (N - i)) as u8;
        number /= N - i;
        for k in i + 1..N {
            permutation[k] += u8::from(permutation[k] >= permutation[i]);
        }
    }
    permutation
}

/// The six clockwise quarters as cubes.
fn quarters() -> [Cube; 6] {
    std::array::from_fn(|f| Cube::SOLVED.apply(Turn::from_index(f * 3)))
}

/// `table[turn * size + state]` from what the six quarters do to a state.
fn by_quarters(size: usize, quarter: impl Fn(usize) -> [usize; 6]) -> Vec<u16> {
    let mut table = vec![0; 18 * size];
    for state in 0..size {
        for (face, next) in quarter(state).into_iter().enumerate() {
            table[face * 3 * size + state] = next as u16;
        }
    }
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

/// What each of the 18 turns does to the twists: `[turn * TWISTS + twist]`.
#[must_use]
pub(crate) fn twist_moves() -> Vec<u16> {
    let quarters = quarters();
    by_quarters(TWISTS, |n| quarters.map(|q| twist(&with_twist(n).then(&q))))
}

/// What each turn does to the flips: `[turn * FLIPS + flip]`.
#[must_use]
pub(crate) fn flip_moves() -> Vec<u16> {
    let quarters = quarters();
    by_quarters(FLIPS, |n| quarters.map(|q| flip(&with_flip(n).then(&q))))
}

/// What each turn does to four edges: `[turn * QUADS + quad]`.
#[must_use]
pub(crate) fn quad_moves() -> Vec<u16> {
    let quarters = quarters();
    by_quarters(QUADS, |n| {
        let cube = with_quad(n);
        quarters.map(|q| quad(&cube.then(&q), 8))
    })
}

/// What each turn does to the order of the corners: `[turn * PERMUTATIONS + order]`.
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
    fn the_solved_cube_is_zero_everywhere() {
        let cube = Cube::SOLVED;

        assert_eq!([twist(&cube), flip(&cube), quad(&cube, 8)], [0; 3]);
        assert_eq!(rank(cube.corners()), 0);
    }

    #[test]
    fn numbers_are_read_back() {
        (0..TWISTS).for_each(|n| assert_eq!(twist(&with_twist(n)), n));
        (0..FLIPS).for_each(|n| assert_eq!(flip(&with_flip(n)), n));
        (0..QUADS).for_each(|n| assert_eq!(quad(&with_quad(n), 8), n));
        (0..PERMUTATIONS).for_each(|n| assert_eq!(rank(&unrank::<8>(n)), n));
    }

    #[test]
    fn moves_of_numbers_are_moves_of_cubes() {
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
