//! The least that must change before stickers are a cube that can be solved.
//!
//! - in: any facelets
//! - out: a [`Repair`]: the fewest stickers to recolour, and in how many ways so few would do
//!
//! Exact: over all ways to give the eight corner positions the eight corners, each turned anyhow, and the twelve edge
//! positions the edges, by dynamic programming over the set of pieces already given, the sum of twists or flips and
//! the parity. A misread sticker shows as one way; a flipped edge as two stickers in twelve ways.

use super::cubies::{CORNER_FACELETS, EDGE_FACELETS};
use super::{CORNERS, Cube, EDGES, Face, Facelets, Rotation24, facelet_at, facelet_place};
use std::fmt;

/// A sticker that should have another colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StickerChange {
    /// Number of the sticker, 0..54.
    pub sticker: usize,
    /// What it has.
    pub from: Face,
    /// What it should have.
    pub to: Face,
}

impl fmt::Display for StickerChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let place = facelet_place(self.sticker);
        write!(f, "{place} {} -> {}", self.from.letter(), self.to.letter())
    }
}

/// The fewest stickers whose colours must change.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Repair {
    /// One way to do it; empty for a cube that can be solved.
    pub changes: Vec<StickerChange>,
    /// How many ways there are with so few stickers.
    pub ways: u64,
}

impl fmt::Display for Repair {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let stickers = match self.changes.len() {
            0 => return write!(f, "nothing to change"),
            1 => "1 sticker".to_owned(),
            count => format!("{count} stickers"),
        };
        let changes: Vec<String> = self.changes.iter().map(StickerChange::to_string).collect();
        let changes = changes.join(", ");
        match self.ways {
            1 => write!(f, "{stickers} to change: {changes}"),
            u64::MAX => {
                write!(f, "{stickers} to change, in one of very many ways; one is {changes}")
            }
            ways => write!(f, "{stickers} to change, in one of {ways} ways; one is {changes}"),
        }
    }
}

impl Repair {
    /// The least repair of a cube; about 5 ms.
    #[must_use]
    pub fn of(facelets: &Facelets) -> Self {
        // In the orientation that most centres speak for, as it is where several do.
        let wrong = |r: &Rotation24| {
            let centre = |f: &Face| facelets.colour(f.index() * 9 + 4);
            Face::ALL.iter().filter(|f| r.face(**f) != centre(f)).count()
        };
        let rotation = Rotation24::all().min_by_key(wrong).unwrap_or(Rotation24::IDENTITY);
        let home = facelets.rotated(rotation);
        let corners = fit(&home, &CORNERS, &CORNER_FACELETS);
        let edges = fit(&home, &EDGES, &EDGE_FACELETS);
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
            // Where the sticker lies in the home orientation.
            let place = facelet_place(sticker);
            let there = facelet_at(rotation.cell(place.cell()), rotation.face(place.face));
            let (from, to) = (facelets.colour(sticker), repaired.colour(there));
            (from != to).then_some(StickerChange { sticker, from, to })
        });
        Self { changes: changes.collect(), ways }
    }
}

/// The best way to give the first positions a set of pieces.
#[derive(Debug, Clone, Copy)]
struct Best {
    /// Stickers that differ.
    cost: u16,
    ways: u64,
    /// The last piece and how it is turned.
    piece: u8,
    turn: u8,
}

const NONE: Best = Best { cost: 1000, ways: 0, piece: 0, turn: 0 };

/// The best of every set of pieces, sum of turns and parity: `[(set * N + sum) * 2 + parity]`.
struct Fit<const N: usize, const P: usize> {
    best: Vec<Best>,
}

fn fit<const N: usize, const P: usize>(
    facelets: &Facelets,
    pieces: &[[Face; N]; P],
    places: &[[usize; N]; P],
) -> Fit<N, P> {
    let mut best = vec![NONE; (1 << P) * N * 2];
    best[0] = Best { cost: 0, ways: 1, piece: 0, turn: 0 };
    // A set comes after its subsets; its size says which position is next.
    for set in 0..(1_usize << P) - 1 {
        let colours = places[set.count_ones() as usize].map(|p| facelets.colour(p));
        for piece in (0..P).filter(|p| set >> p & 1 == 0) {
            let crossed = (set >> piece).count_ones() as usize;
            for turn in 0..N {
                let differs = |k: &usize| colours[(k + turn) % N] != pieces[piece][*k];
                let price = (0..N).filter(differs).count() as u16;
                for from in 0..N * 2 {
                    let (sum, parity) = ((from / 2 + turn) % N, (from + crossed) % 2);
                    let to = ((set | 1 << piece) * N + sum) * 2 + parity;
                    let before = best[set * N * 2 + from];
                    let cost = before.cost + price;
                    if before.ways > 0 && cost < best[to].cost {
                        let (piece, turn) = (piece as u8, turn as u8);
                        best[to] = Best { cost, ways: before.ways, piece, turn };
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
    /// All pieces, turns that cancel.
    fn of_parity(&self, parity: usize) -> Best {
        self.best[((1 << P) - 1) * N * 2 + parity]
    }

    /// Which piece is at each position, and how it is turned.
    fn trace(&self, mut parity: usize) -> ([u8; P], [u8; P]) {
        let (mut pieces, mut turns) = ([0; P], [0; P]);
        let (mut set, mut sum) = ((1_usize << P) - 1, 0);
        for position in (0..P).rev() {
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

    /// Returns the cube with the changes made.
    fn applied(repair: &Repair, facelets: &Facelets) -> Facelets {
        let mut colours: [Face; 54] = std::array::from_fn(|i| facelets.colour(i));
        for change in &repair.changes {
            colours[change.sticker] = change.to;
        }
        Facelets::from_faces(colours)
    }

    fn with(facelets: &Facelets, colours: &[(usize, u8)]) -> Facelets {
        let mut all = *facelets.colours();
        for &(i, c) in colours {
            all[i] = c;
        }
        Facelets::try_from(all).unwrap()
    }

    #[test]
    fn a_cube_that_can_be_solved_needs_nothing() {
        for seed in 0..3 {
            let repair = Repair::of(&Facelets::from(&Cube::scrambled(seed)));

            assert_eq!(repair, Repair { changes: Vec::new(), ways: 1 });
        }
    }

    #[test]
    fn one_misread_sticker_is_found() {
        let cube = Facelets::from(&Cube::scrambled(4));
        for sticker in [0, 5, 17, 33, 40, 53] {
            let wrong = (cube.colours()[sticker] + 1) % 6;

            let repair = Repair::of(&with(&cube, &[(sticker, wrong)]));

            assert_eq!(repair.changes.len(), 1, "{repair}");
            assert_eq!(applied(&repair, &with(&cube, &[(sticker, wrong)])), cube);
            assert_eq!(repair.ways, 1);
        }
    }

    #[test]
    fn a_flipped_edge_may_be_any_of_twelve_and_a_twisted_corner_any_of_eight() {
        let flipped = with(&Facelets::solved(), &[(7, 2), (19, 0)]);
        let twisted = with(&Facelets::solved(), &[(8, 1), (9, 2), (20, 0)]);

        let (edge, corner) = (Repair::of(&flipped), Repair::of(&twisted));

        assert_eq!((edge.changes.len(), edge.ways), (2, 12));
        assert_eq!((corner.changes.len(), corner.ways), (3, 8));
        assert_eq!(
            edge.to_string().split(';').next(),
            Some("2 stickers to change, in one of 12 ways")
        );
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn a_repaired_cube_can_be_solved(seed: u64, wrong in prop::collection::vec((0..54usize, 0..6u8), 0..6), turn in 0..24usize) {
            let rotation = Rotation24::from_index(turn).unwrap();
            let broken = with(&Facelets::from(&Cube::scrambled(seed)), &wrong).rotated(rotation);

            let repair = Repair::of(&broken);

            prop_assert!(repair.changes.len() <= wrong.len());
            let (home, _) = applied(&repair, &broken).normalised().unwrap();
            prop_assert!(Cube::try_from(home).is_ok());
        }
    }
}
