//! The cheapest cube that can exist, given a cost for each facelet and each colour.
//!
//! A cube is not 54 independent facelets but 8 corners and 12 edges, each once. In a cube that can
//! exist the twists of the corners cancel, the flips of the edges cancel, and the permutations of
//! corners and edges have the same parity. The search keeps all of this exactly. It lays piece
//! after piece on the positions. Partial layouts with the same pieces, the same sum of twists or
//! flips and the same parity can be continued in the same ways, so only the cheapest of them is
//! kept (2^8 and 2^12 sets of pieces). A forward and a backward run together give the cheapest cube
//! with any piece at any position. From these the margin of a facelet follows: how much more the
//! best cube costs in which it has another colour.
//!
//! - in: 54 x 6 costs (facelets and colours in the order URFDLB; the centres are fixed)
//! - out: [`Likeliest`]: facelets, cost, and the margin of each facelet in the unit of the costs
//! - source: Held and Karp (1962) for the sets; forward and backward sums after Viterbi (1967)

use super::assignment::assign;
use crate::cube::{CORNERS, EDGES, Face, facelet_at};
use std::sync::LazyLock;

/// Cheapest cube that can exist.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Likeliest {
    /// Colour of each facelet, 0..=5 = URFDLB.
    pub facelets: [u8; 54],
    /// Sum of the costs of these colours.
    pub cost: f64,
    /// Additional cost of the best cube in which this facelet has another colour; infinite at the
    /// centres.
    pub margins: [f64; 54],
}

/// Index of the centre of each face.
pub(super) const CENTRES: [usize; 6] = [4, 13, 22, 31, 40, 49];

/// Numbers of the facelets of each corner position, in the order of its letters.
pub(super) static CORNER_FACELETS: LazyLock<[[usize; 3]; 8]> =
    LazyLock::new(|| CORNERS.map(facelets_of));
/// Numbers of the facelets of each edge position, in the order of its letters.
pub(super) static EDGE_FACELETS: LazyLock<[[usize; 2]; 12]> =
    LazyLock::new(|| EDGES.map(facelets_of));

/// Returns the facelets of the position between these faces, one on each face in their order.
fn facelets_of<const K: usize>(faces: [Face; K]) -> [usize; K] {
    // The sum of the faces' normals is the place of the piece in the 3x3x3 grid.
    let cell = faces.iter().fold([0i8; 3], |mut cell, face| {
        let normal = face.normal();
        (0..3).for_each(|k| cell[k] += normal[k] as i8);
        cell
    });
    faces.map(|face| facelet_at(cell, face))
}

/// Returns the cheapest of all cubes that turns can reach from the solved one. `costs` is the cost
/// of each facelet in each of the six colours.
#[must_use]
pub(crate) fn likeliest(costs: &[[f64; 6]; 54]) -> Likeliest {
    let mut corners = Layout::new(&CORNER_FACELETS, &CORNERS, costs);
    let mut edges = Layout::new(&EDGE_FACELETS, &EDGES, costs);
    corners.run_forward();
    corners.run_backward();
    edges.run_forward();
    edges.run_backward();
    // On a cube that can exist the permutations of corners and edges are both even or both odd,
    // since a turn changes both.
    let best = [0, 1].map(|parity| corners.best(parity) + edges.best(parity));
    let parity = usize::from(best[1] < best[0]);

    let mut facelets = [0u8; 54];
    let mut margins = [f64::INFINITY; 54];
    for (face, &centre) in CENTRES.iter().enumerate() {
        facelets[centre] = face as u8;
    }
    corners.read(parity, &mut facelets);
    edges.read(parity, &mut facelets);
    let floor = best[parity];
    // With another corner the parity may be the other one, and then the best edges are others too.
    corners.alternatives([edges.best(0) - floor, edges.best(1) - floor], &facelets, &mut margins);
    edges.alternatives([corners.best(0) - floor, corners.best(1) - floor], &facelets, &mut margins);
    // Rounding can make a margin of equal cubes slightly negative.
    let centres: f64 = CENTRES.iter().enumerate().map(|(face, &i)| costs[i][face]).sum();
    Likeliest { facelets, cost: floor + centres, margins: margins.map(|m| m.max(0.0)) }
}

/// Returns the facelets of the cheapest cube that has each piece once. By its twists, flips and
/// parities it may be a cube that cannot exist. The search is a hundred times as fast as
/// [`likeliest`], so that an iteration can repeat it.
#[must_use]
pub(super) fn cheapest_pieces(costs: &[[f64; 6]; 54]) -> [u8; 54] {
    let mut facelets = [0u8; 54];
    for (face, &centre) in CENTRES.iter().enumerate() {
        facelets[centre] = face as u8;
    }
    Layout::new(&CORNER_FACELETS, &CORNERS, costs).assign(&mut facelets);
    Layout::new(&EDGE_FACELETS, &EDGES, costs).assign(&mut facelets);
    facelets
}

/// All layouts of `N` pieces with `K` orientations each on `N` positions.
struct Layout<'a, const N: usize, const K: usize> {
    /// Facelets of each position.
    places: &'a [[usize; K]; N],
    /// Colours of each piece, as faces.
    pieces: &'a [[Face; K]; N],
    /// Cost by position, piece and orientation.
    cost: [[[f64; K]; N]; N],
    /// For each set of pieces (bit mask) the least cost of these on the first positions, by the sum
    /// of their orientations and their parity; empty before [`Self::run_forward`].
    forward: Vec<[[f64; 2]; K]>,
    /// For each set of pieces (bit mask) the least cost of the other pieces on the remaining
    /// positions, by the sum of their orientations and their parity; empty before
    /// [`Self::run_backward`].
    backward: Vec<[[f64; 2]; K]>,
}

impl<'a, const N: usize, const K: usize> Layout<'a, N, K> {
    /// Computes the cost of each piece in each orientation at each position from those of facelets.
    fn new(
        places: &'a [[usize; K]; N],
        pieces: &'a [[Face; K]; N],
        costs: &[[f64; 6]; 54],
    ) -> Self {
        // The orientation `turn` puts the colour k of the piece on the facelet k + turn of the
        // position.
        let cost = std::array::from_fn(|position: usize| {
            std::array::from_fn(|piece: usize| {
                std::array::from_fn(|turn| {
                    (0..K)
                        .map(|k| costs[places[position][(k + turn) % K]][pieces[piece][k].index()])
                        .sum()
                })
            })
        });
        Self { places, pieces, cost, forward: Vec::new(), backward: Vec::new() }
    }

    /// Computes [`Self::forward`] for all sets of pieces, from the empty one on.
    fn run_forward(&mut self) {
        let none = [[f64::INFINITY; 2]; K];
        self.forward = vec![none; 1 << N];
        self.forward[0][0][0] = 0.0;
        // The bit mask grows with each piece that is added, so the cost of a set is final when its
        // turn comes. The number of pieces in a set is the position that is filled next.
        for set in 0..(1usize << N) - 1 {
            let from = self.forward[set];
            let prices = &self.cost[set.count_ones() as usize];
            for piece in (0..N).filter(|p| set >> p & 1 == 0) {
                let to = &mut self.forward[set | 1 << piece];
                lay(&from, to, &prices[piece], inversions(set, piece));
            }
        }
    }

    /// Computes [`Self::backward`] for all sets of pieces, from the full one on.
    fn run_backward(&mut self) {
        let none = [[f64::INFINITY; 2]; K];
        self.backward = vec![none; 1 << N];
        self.backward[(1 << N) - 1][0][0] = 0.0;
        for set in (0..(1usize << N) - 1).rev() {
            let mut to = none;
            let prices = &self.cost[set.count_ones() as usize];
            for piece in (0..N).filter(|p| set >> p & 1 == 0) {
                let from = &self.backward[set | 1 << piece];
                lay(from, &mut to, &prices[piece], inversions(set, piece));
            }
            self.backward[set] = to;
        }
    }

    /// Writes the cheapest layout to `facelets`, without regard to orientations and parity as a
    /// whole.
    fn assign(&self, facelets: &mut [u8; 54]) {
        // The orientations need not cancel, so each piece has its cheapest one at each position.
        let turn = |position: usize, piece: usize| {
            let prices = &self.cost[position][piece];
            (0..K).fold(0, |best, t| if prices[t] < prices[best] { t } else { best })
        };
        let matrix: Vec<f64> =
            (0..N * N).map(|i| self.cost[i / N][i % N][turn(i / N, i % N)]).collect();
        for (position, piece) in assign(&matrix, N).into_iter().enumerate() {
            self.write(position, piece, turn(position, piece), facelets);
        }
    }

    /// Writes the colours of a piece in the orientation `turn` to the facelets of a position.
    fn write(&self, position: usize, piece: usize, turn: usize, facelets: &mut [u8; 54]) {
        for k in 0..K {
            let facelet = self.places[position][(k + turn) % K];
            facelets[facelet] = self.pieces[piece][k].index() as u8;
        }
    }

    /// Returns the cost of the cheapest layout whose orientations cancel and whose permutation has
    /// this parity (0 even, 1 odd).
    fn best(&self, parity: usize) -> f64 {
        self.forward[(1 << N) - 1][0][parity]
    }

    /// Writes the cheapest layout whose orientations cancel and whose permutation has this parity
    /// to `facelets`.
    fn read(&self, parity: usize, facelets: &mut [u8; 54]) {
        // The backward costs lead from the empty set to the cheapest layout. `sum` and `parity` are
        // those that the remaining pieces must have.
        let (mut set, mut sum, mut parity) = (0usize, 0, parity);
        for position in 0..N {
            let mut best = (f64::INFINITY, 0, 0);
            for piece in (0..N).filter(|p| set >> p & 1 == 0) {
                for turn in 0..K {
                    let rest = self.backward[set | 1 << piece][(sum + K - turn) % K]
                        [parity ^ inversions(set, piece)];
                    let value = self.cost[position][piece][turn] + rest;
                    if value < best.0 {
                        best = (value, piece, turn);
                    }
                }
            }
            let (_, piece, turn) = best;
            self.write(position, piece, turn, facelets);
            parity ^= inversions(set, piece);
            sum = (sum + K - turn) % K;
            set |= 1 << piece;
        }
    }

    /// Lowers the margin of each facelet to the additional cost of the best cube in which it has
    /// another colour than in `facelets`, the cheapest cube.
    ///
    /// `others` is the least cost of the other kind of pieces (edges or corners) for each parity,
    /// minus the cost of the cheapest cube.
    fn alternatives(&self, others: [f64; 2], facelets: &[u8; 54], margins: &mut [f64; 54]) {
        // Least margin of any cube with this piece in this orientation at this position: the
        // pieces before it come from the forward run, those after it from the backward run.
        let mut cheapest = [[[f64::INFINITY; K]; N]; N];
        for set in 0..(1usize << N) - 1 {
            let position = set.count_ones() as usize;
            let from = &self.forward[set];
            for piece in (0..N).filter(|p| set >> p & 1 == 0) {
                let (odd, to) = (inversions(set, piece), &self.backward[set | 1 << piece]);
                for turn in 0..K {
                    let mut least = f64::INFINITY;
                    // All orientations must add up to a multiple of K, and the parity of the whole
                    // permutation selects the cost of the other kind of pieces.
                    for sum in 0..K {
                        let rest = &to[(2 * K - sum - turn) % K];
                        for before in 0..2 {
                            for (after, value) in rest.iter().enumerate() {
                                let other = others[before ^ odd ^ after];
                                least = least.min(from[sum][before] + value + other);
                            }
                        }
                    }
                    let slot = &mut cheapest[position][piece][turn];
                    *slot = slot.min(least + self.cost[position][piece][turn]);
                }
            }
        }
        for (places, by_piece) in self.places.iter().zip(&cheapest) {
            for (colours, prices) in self.pieces.iter().zip(by_piece) {
                for (turn, price) in prices.iter().enumerate() {
                    for (k, colour) in colours.iter().enumerate() {
                        let facelet = places[(k + turn) % K];
                        if colour.index() as u8 != facelets[facelet] {
                            margins[facelet] = margins[facelet].min(*price);
                        }
                    }
                }
            }
        }
    }
}

/// Adds one piece to the partial layouts with the costs `from`, in each of its orientations, and
/// lowers the costs `to` where the result is cheaper. `from` and `to` are indexed by the sum of the
/// orientations and by the parity.
///
/// `prices` is the cost of the piece in each orientation, and `odd` is 1 if the piece changes the
/// parity.
fn lay<const K: usize>(
    from: &[[f64; 2]; K],
    to: &mut [[f64; 2]; K],
    prices: &[f64; K],
    odd: usize,
) {
    for (turn, price) in prices.iter().enumerate() {
        for (sum, values) in from.iter().enumerate() {
            let slot = &mut to[(sum + turn) % K];
            slot[odd] = slot[odd].min(values[0] + price);
            slot[odd ^ 1] = slot[odd ^ 1].min(values[1] + price);
        }
    }
}

/// Returns 1 if `set`, a bit mask without `piece`, contains an odd number of pieces with a higher
/// index than `piece`, else 0. The parity of a permutation is that of its number of inversions.
fn inversions(set: usize, piece: usize) -> usize {
    (set >> piece).count_ones() as usize & 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::{Cube, Facelets};
    use proptest::prelude::*;

    /// Returns costs of 0 for the colours of these facelets and 1 for all other colours.
    fn costs_of(facelets: &[u8; 54]) -> [[f64; 6]; 54] {
        facelets.map(|own| std::array::from_fn(|c| if c == usize::from(own) { 0.0 } else { 1.0 }))
    }

    /// Returns the facelets of a scrambled cube.
    fn facelets(seed: u64) -> [u8; 54] {
        *Facelets::from(&Cube::scrambled(seed)).colours()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn exact_costs_give_true_cube_with_large_margins(seed in 0u64..1_000_000) {
            let truth = facelets(seed);

            let found = likeliest(&costs_of(&truth));

            prop_assert_eq!(found.facelets, truth);
            prop_assert_eq!(found.cost, 0.0);
            // The nearest other cubes differ in three facelets: three edges that share a colour are
            // exchanged in a cycle.
            prop_assert!(found.margins.iter().all(|&m| m >= 3.0));
        }

        /// For any costs the returned cube can exist, and no cube that differs from it in two to
        /// four pieces is cheaper.
        #[test]
        fn likeliest_returns_cheapest_legal_cube(
            costs in proptest::collection::vec(0.0..10.0f64, 324), seed in 0u64..1_000_000
        ) {
            let costs: [[f64; 6]; 54] =
                std::array::from_fn(|i| std::array::from_fn(|c| costs[6 * i + c]));
            let price =
                |f: &[u8; 54]| -> f64 { (0..54).map(|i| costs[i][usize::from(f[i])]).sum() };

            let found = likeliest(&costs);

            prop_assert!(Cube::is_possible(&found.facelets));
            prop_assert!((price(&found.facelets) - found.cost).abs() < 1e-9);
            let mut others = neighbours(&found.facelets);
            others.push(facelets(seed));
            for other in others {
                prop_assert!(price(&other) >= found.cost - 1e-9);
                // A cube that differs in a facelet costs more by at least the facelet's margin.
                for i in (0..54).filter(|&i| other[i] != found.facelets[i]) {
                    prop_assert!(price(&other) - found.cost >= found.margins[i] - 1e-9);
                }
            }
        }
    }

    /// Moves the piece on each of these positions, given by their facelets, to the next position.
    fn cycle<const K: usize>(facelets: &mut [u8; 54], positions: &[[usize; K]]) {
        for pair in positions.windows(2).rev() {
            (0..K).for_each(|k| facelets.swap(pair[0][k], pair[1][k]));
        }
    }

    /// Returns cubes that can exist and differ from this one in few pieces: two edges are flipped,
    /// two corners are twisted, three edges or three corners go around, or two edges and two
    /// corners are exchanged.
    fn neighbours(facelets: &[u8; 54]) -> Vec<[u8; 54]> {
        let mut all = Vec::new();
        let mut add = |change: &dyn Fn(&mut [u8; 54])| {
            let mut other = *facelets;
            change(&mut other);
            assert!(Cube::is_possible(&other));
            all.push(other);
        };
        let (edges, corners) = (&*EDGE_FACELETS, &*CORNER_FACELETS);
        let turned = |[a, b, c]: [usize; 3]| [[a, b, c], [b, c, a]];
        for (i, a) in edges.iter().enumerate() {
            for (j, b) in edges[..i].iter().enumerate() {
                add(&|f| [a, b].iter().for_each(|edge| f.swap(edge[0], edge[1])));
                let c = &edges[(i + j + 5) % 12];
                if c != a && c != b {
                    add(&|f| cycle(f, &[*a, *b, *c]));
                    add(&|f| cycle(f, &[*c, *b, *a]));
                }
                for (k, c) in corners.iter().enumerate() {
                    let d = &corners[(i + k + 1) % 8];
                    if c != d {
                        add(&|f| {
                            cycle(f, &[*a, *b]);
                            cycle(f, &[*c, *d]);
                        });
                    }
                }
            }
        }
        for (i, a) in corners.iter().enumerate() {
            for (j, b) in corners.iter().enumerate().filter(|(j, _)| *j != i) {
                add(&|f| {
                    let (from, to) = (turned(*a), turned(*b));
                    let before = *f;
                    (0..3).for_each(|k| f[from[1][k]] = before[from[0][k]]);
                    (0..3).for_each(|k| f[to[0][k]] = before[to[1][k]]);
                });
                let c = &corners[(i + j + 3) % 8];
                if c != a && c != b {
                    add(&|f| cycle(f, &[*a, *b, *c]));
                }
            }
        }
        all
    }

    #[test]
    fn likeliest_corrects_flipped_edge_at_lowest_cost() {
        let truth = facelets(7);
        let mut seen = truth;
        seen.swap(5, 10);
        let mut costs = costs_of(&seen);
        // The edge with facelets 5 and 10 is seen flipped. At facelet 5 the right colour costs 0.3
        // and any other 1. The cube with this edge flipped back costs 1.3, a cube in which a second
        // edge is flipped as well costs 3.
        costs[5] = std::array::from_fn(|c| if c == usize::from(truth[5]) { 0.3 } else { 1.0 });

        let found = likeliest(&costs);

        assert_eq!(found.facelets, truth);
    }
}
