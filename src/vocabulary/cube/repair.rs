//! The smallest change of stickers that makes a cube which can be solved.
//!
//! - in: any facelets
//! - out: a [`Repair`]: the fewest stickers to recolour, and the number of repairs of that size
//!
//! The search is exact for the orientation that the centres give. It covers every assignment of the
//! eight corners and the twelve edges to their positions, each with every twist or flip. It is a
//! dynamic program over the set of pieces already assigned, the sum of their twists or flips, and
//! the parity of their order. A misread sticker usually has one repair of one sticker; a flipped
//! edge has twelve repairs of two.

use super::cubies::{CORNER_FACELETS, EDGE_FACELETS};
use super::{CORNERS, Cube, EDGES, Face, Facelets, Rotation24, facelet_at, facelet_place};
use std::fmt;

/// Sticker that needs another colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StickerChange {
    /// Number of the sticker, 0..54.
    pub sticker: usize,
    /// Present colour.
    pub from: Face,
    /// Colour that it needs.
    pub to: Face,
}

impl fmt::Display for StickerChange {
    /// Writes the place, the present and the needed colour of the sticker: `U1 R -> F`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let place = facelet_place(self.sticker);
        write!(f, "{place} {} -> {}", self.from.letter(), self.to.letter())
    }
}

/// Repair of a cube with the fewest changes of stickers.
///
/// ```
/// use rubik_robot_vocabulary::cube::{Facelets, Repair};
///
/// // One misread sticker: U1 as red.
/// let mut letters = Facelets::solved().to_string();
/// letters.replace_range(..1, "R");
/// let repair = Repair::of(&letters.parse()?);
/// assert_eq!(repair.to_string(), "1 sticker to change: U1 R -> U");
/// # Ok::<(), rubik_robot_vocabulary::cube::ParseFacelets>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Repair {
    /// Changes of one of these repairs; empty for a cube that can be solved.
    pub changes: Vec<StickerChange>,
    /// Number of repairs with this number of changes; `u64::MAX` if it overflows.
    pub count: u64,
}

impl fmt::Display for Repair {
    /// Writes how many stickers to change, in how many ways, and the changes of one way.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let stickers = match self.changes.len() {
            0 => return write!(f, "nothing to change"),
            1 => "1 sticker".to_owned(),
            count => format!("{count} stickers"),
        };
        let changes: Vec<String> = self.changes.iter().map(StickerChange::to_string).collect();
        let changes = changes.join(", ");
        match self.count {
            1 => write!(f, "{stickers} to change: {changes}"),
            u64::MAX => {
                write!(f, "{stickers} to change, in one of very many ways, for example {changes}")
            }
            ways => write!(f, "{stickers} to change, in one of {ways} ways, for example {changes}"),
        }
    }
}

impl Repair {
    /// Finds the fewest stickers to recolour so that the cube can be solved, in about 5 ms.
    #[must_use]
    pub fn of(facelets: &Facelets) -> Self {
        // The orientation in which the fewest centres are wrong is the most likely one. In a tie
        // the first one counts.
        let wrong = |r: &Rotation24| {
            let centre = |f: &Face| facelets.colour(f.index() * 9 + 4);
            Face::ALL.iter().filter(|f| r.face(**f) != centre(f)).count()
        };
        let rotation = Rotation24::all().min_by_key(wrong).unwrap_or(Rotation24::IDENTITY);
        let home = facelets.rotated(rotation);
        let corners = fit(&home, &CORNERS, &CORNER_FACELETS);
        let edges = fit(&home, &EDGES, &EDGE_FACELETS);
        // Corners and edges of a possible cube have the same parity, so only these two sums count.
        let costs = [0, 1].map(|p| corners.of_parity(p).cost + edges.of_parity(p).cost);
        let least = costs[0].min(costs[1]);
        let ways = [0, 1].into_iter().filter(|&p| costs[p] == least).fold(0_u64, |n, p| {
            n.saturating_add(corners.of_parity(p).ways.saturating_mul(edges.of_parity(p).ways))
        });
        let parity = usize::from(costs[1] < costs[0]);
        let mut cube = Cube::SOLVED;
        (cube.corners, cube.twists) = corners.trace(parity);
        (cube.edges, cube.flips) = edges.trace(parity);
        let repaired = Facelets::from(&cube);
        let changes = (0..54).filter_map(|sticker| {
            // Place of the sticker in the home orientation.
            let place = facelet_place(sticker);
            let there = facelet_at(rotation.cell(place.cell()), rotation.face(place.face));
            let (from, to) = (facelets.colour(sticker), repaired.colour(there));
            (from != to).then_some(StickerChange { sticker, from, to })
        });
        Self { changes: changes.collect(), count: ways }
    }
}

/// Best assignment of a set of pieces to the first positions.
#[derive(Debug, Clone, Copy)]
struct Best {
    /// Number of stickers that differ.
    cost: u16,
    /// Number of assignments with this cost.
    ways: u64,
    /// Index of the piece at the last of these positions.
    piece: u8,
    /// Twist or flip of that piece.
    turn: u8,
}

/// Mark of a state that no assignment reaches. No assignment changes more than 24 stickers.
const NONE: Best = Best { cost: 1000, ways: 0, piece: 0, turn: 0 };

/// Best assignment for each set of pieces, sum of their twists or flips modulo N, and parity of
/// their order, at the index `(set * N + sum) * 2 + parity`. N is the number of stickers of a
/// piece, P the number of pieces; bit i of `set` stands for piece i.
struct Fit<const N: usize, const P: usize> {
    best: Vec<Best>,
}

/// Computes the assignments of pieces with N stickers to P positions for which the fewest stickers
/// must be recoloured.
fn fit<const N: usize, const P: usize>(
    facelets: &Facelets,
    pieces: &[[Face; N]; P],
    places: &[[usize; N]; P],
) -> Fit<N, P> {
    let mut best = vec![NONE; (1 << P) * N * 2];
    best[0] = Best { cost: 0, ways: 1, piece: 0, turn: 0 };
    // A set has a larger number than each of its subsets, so `best` of this set is final. The
    // number of its pieces is the index of the next position.
    for set in 0..(1_usize << P) - 1 {
        let colours = places[set.count_ones() as usize].map(|p| facelets.colour(p));
        for piece in (0..P).filter(|p| set >> p & 1 == 0) {
            // Inversions that this piece adds: the pieces with higher numbers at earlier positions.
            // Their sum modulo 2 is the parity of the permutation.
            let crossed = (set >> piece).count_ones() as usize;
            for turn in 0..N {
                let differs = |k: &usize| colours[(k + turn) % N] != pieces[piece][*k];
                let price = (0..N).filter(differs).count() as u16;
                for from in 0..N * 2 {
                    // `from` is the pair of sum and parity that the smaller set has.
                    let (sum, parity) = ((from / 2 + turn) % N, (from + crossed) % 2);
                    let to = ((set | 1 << piece) * N + sum) * 2 + parity;
                    let before = best[set * N * 2 + from];
                    let cost = before.cost + price;
                    if before.ways > 0 && cost < best[to].cost {
                        let (piece, turn) = (piece as u8, turn as u8);
                        best[to] = Best { cost, ways: before.ways, piece, turn };
                    // Equal costs by different assignments are different repairs, so their counts
                    // add up.
                    } else if before.ways > 0 && cost == best[to].cost {
                        best[to].ways = best[to].ways.saturating_add(before.ways);
                    }
                }
            }
        }
    }
    Fit { best }
}

impl<const N: usize, const P: usize> Fit<N, P> {
    /// Returns the best assignment of all pieces, with its cost and the number of equally good
    /// ones, among those whose permutation has this parity and whose twists or flips add up to 0.
    fn of_parity(&self, parity: usize) -> Best {
        self.best[((1 << P) - 1) * N * 2 + parity]
    }

    /// Returns the best assignment whose permutation has this parity: the piece at each position,
    /// and its twist or flip.
    fn trace(&self, mut parity: usize) -> ([u8; P], [u8; P]) {
        let (mut pieces, mut turns) = ([0; P], [0; P]);
        let (mut set, mut sum) = ((1_usize << P) - 1, 0);
        for position in (0..P).rev() {
            // From the last position backwards, this undoes the updates of `fit`.
            let Best { piece, turn, .. } = self.best[(set * N + sum) * 2 + parity];
            (pieces[position], turns[position]) = (piece, turn);
            set &= !(1 << piece);
            sum = (sum + N - usize::from(turn)) % N;
            parity = (parity + (set >> piece).count_ones() as usize) % 2;
        }
        (pieces, turns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Returns the stickers after the changes of a repair.
    fn applied(repair: &Repair, facelets: &Facelets) -> Facelets {
        let mut colours: [Face; 54] = std::array::from_fn(|i| facelets.colour(i));
        for change in &repair.changes {
            colours[change.sticker] = change.to;
        }
        Facelets::from_faces(colours)
    }

    /// Returns the facelets with other colours at the given indices.
    fn with(facelets: &Facelets, colours: &[(usize, u8)]) -> Facelets {
        let mut all = *facelets.colours();
        for &(i, c) in colours {
            all[i] = c;
        }
        Facelets::try_from(all).unwrap()
    }

    #[test]
    fn solvable_cube_needs_no_repair() {
        for seed in 0..3 {
            let repair = Repair::of(&Facelets::from(&Cube::scrambled(seed)));

            assert_eq!(repair, Repair { changes: Vec::new(), count: 1 });
        }
    }

    #[test]
    fn repair_finds_one_misread_sticker() {
        let cube = Facelets::from(&Cube::scrambled(4));
        for sticker in [0, 5, 17, 33, 40, 53] {
            let wrong = (cube.colours()[sticker] + 1) % 6;

            let repair = Repair::of(&with(&cube, &[(sticker, wrong)]));

            assert_eq!(repair.changes.len(), 1, "{repair}");
            assert_eq!(applied(&repair, &with(&cube, &[(sticker, wrong)])), cube);
            assert_eq!(repair.count, 1);
        }
    }

    #[test]
    fn flipped_edge_has_twelve_repairs_twisted_corner_eight() {
        // Stickers 7 and 19 are those of the edge UF, 8, 9 and 20 those of the corner URF.
        let flipped = with(&Facelets::solved(), &[(7, 2), (19, 0)]);
        let twisted = with(&Facelets::solved(), &[(8, 1), (9, 2), (20, 0)]);

        let (edge, corner) = (Repair::of(&flipped), Repair::of(&twisted));

        assert_eq!((edge.changes.len(), edge.count), (2, 12));
        assert_eq!((corner.changes.len(), corner.count), (3, 8));
        assert_eq!(
            edge.to_string().split(", for").next(),
            Some("2 stickers to change, in one of 12 ways")
        );
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn repaired_cube_is_solvable(
            seed: u64, wrong in prop::collection::vec((0..54usize, 0..6u8), 0..6),
            turn in 0..24usize
        ) {
            let rotation = Rotation24::from_index(turn).unwrap();
            let broken = with(&Facelets::from(&Cube::scrambled(seed)), &wrong).rotated(rotation);

            let repair = Repair::of(&broken);

            prop_assert!(repair.changes.len() <= wrong.len());
            let (home, _) = applied(&repair, &broken).normalised().unwrap();
            prop_assert!(Cube::try_from(home).is_ok());
        }
    }
}
