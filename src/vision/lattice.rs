//! Search for 3x3 lattices among tile candidates, by a vote that tolerates lost and false tiles.
//!
//! The second moments of a candidate describe how a square tile is distorted in the picture. In the
//! metric of these moments, its neighbours on the face are one pitch away and at right angles. Each
//! pair of neighbours at right angles proposes a lattice. The lattice grows cell by cell, so that
//! it follows the perspective, and the 3x3 window with the most tiles and the smallest residual
//! wins. Candidates with the most neighbours propose first, because the centre tile has the most
//! neighbours (Zieliński et al. 2007, p. 373). A cell is held if a tile was found in it.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | lattice is larger than 3x3 | [`LARGER`] of 16 cells around | the cube's next face adds three |
//! | lattice is larger, at the border | [`LARGER_AT_BORDER`] | fewer cells can be seen there |
//! | nine tiles are certainly a face | score > [`CERTAIN`] | two faces: 7.7, one face: 8.1 to 8.7 |
//! | tile is in a growing cell | [`GROWING`] pitches off | the next cell's place is extrapolated |
//! | tiles have one size | [`ALIKE`] | ratio of their sides |
//! | lattice may have a cut tile | [`ODD`] | the worst tile is dropped if that improves the fit |
//! | textured picture | [`MOST_PROPOSALS`] | bounds the time |
//!
//! - in: [`Tile`]s
//! - out: [`Lattice`]s, the best first

use super::homography::{self, GRID, Point, apply, distance};
use super::segment::Tile;
use nalgebra::{Matrix2, Matrix3};

/// Lattice of nine cells with the tiles that were found in some of them.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Lattice {
    /// Map from places of the face (column - 1, row - 1) to pixels.
    pub homography: Matrix3<f64>,
    /// Index of the tile in each cell in reading order; `None` for an empty cell.
    pub tiles: [Option<usize>; 9],
    /// Root mean square distance of tiles from the middles of their cells, in pitches.
    pub residual: f64,
    /// Spread of the lengths and of the skew of the tiles' sides, divided by the mean length.
    pub unevenness: f64,
    /// Side of a tile as a share of the pitch.
    pub sticker: f64,
    /// Number of the 16 cells around the nine with a tile that fits as well as the nine do.
    pub beyond: usize,
    /// Number of the 16 cells around the nine that are inside the bounding box of all tiles. Near
    /// the border of the picture not all 16 can have a tile.
    pub around: usize,
    /// Continuation of the lattice beyond the nine cells.
    pub onward: Onward,
}

/// Continuation of a lattice beyond its nine cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Onward {
    /// The lattice ends.
    #[default]
    Ends,
    /// The lattice continues, perhaps as another face of the cube. Two faces seen from afar at
    /// equal angles look like six rows of three in one plane.
    Perhaps,
    /// The lattice continues, and the continuation is not another face.
    Larger,
}

/// Least number of cells with tiles around the nine at which a lattice is larger than 3x3: a floor,
/// a keyboard, a 4x4 cube. The next face of the cube, seen at an equal angle, adds only three.
const LARGER: usize = 5;
/// Least number of such cells at the border of the picture. Where fewer than 16 cells can be seen,
/// [`LARGER`] is reduced in proportion, but not below this.
const LARGER_AT_BORDER: usize = 4;

impl Lattice {
    /// Makes the lattice of a homography and computes how well its tiles fit. `held` is the index
    /// of the tile in each cell. Returns `None` if no cell has a tile, or if a cell is degenerate.
    pub(super) fn of(
        tiles: &[Tile],
        homography: Matrix3<f64>,
        held: [Option<usize>; 9],
    ) -> Option<Self> {
        let h = &homography;
        let pitch = homography::smallest_pitch(&GRID.map(|g| apply(h, g)));
        let placed: Vec<(Point, &Tile)> =
            GRID.into_iter().zip(held).filter_map(|(g, tile)| Some((g, &tiles[tile?]))).collect();
        let shapes: Vec<[f64; 3]> =
            placed.iter().filter_map(|(g, tile)| shape_in_cell(h, *g, tile)).collect();
        let n = shapes.len() as f64;
        if shapes.is_empty() || shapes.len() < placed.len() {
            return None;
        }
        let mean: [f64; 3] = std::array::from_fn(|k| shapes.iter().map(|s| s[k]).sum::<f64>() / n);
        let sticker = (mean[0] * mean[1]).sqrt();
        // On a face all sides are equal and the skew is zero. Nine tiles of two faces can fit one
        // homography to 0.016 pitches, but then the tiles of the second face are skewed.
        let spread = shapes
            .iter()
            .map(|s| (s[0] - mean[0]).powi(2) + (s[1] - mean[1]).powi(2) + 2.0 * s[2].powi(2))
            .sum::<f64>();
        let unevenness = (spread / (2.0 * n)).sqrt() / sticker;
        // The unit of an error is the local pitch, the square root of the cell's area. It is
        // bounded, because in a cell that a bad homography magnifies any error would look small.
        let square = placed.iter().map(|(g, tile)| {
            let pitch = cell_area(h, *g).abs().sqrt().min(2.0 * pitch);
            (distance(tile.centre, apply(h, *g)) / pitch).powi(2)
        });
        // A homography has eight parameters, the affine map of fewer than six tiles has six. With
        // few degrees of freedom left a small residual proves little, so the sum is divided by
        // their number.
        let freedom = (2.0 * n - if n < 6.0 { 6.0 } else { 8.0 }).max(1.0);
        let residual = (square.sum::<f64>() / freedom).sqrt();
        Some(Self {
            homography,
            tiles: held,
            residual,
            unevenness,
            sticker,
            beyond: 0,
            around: 16,
            onward: Onward::Ends,
        })
    }

    /// Makes the lattice of a homography that was fitted to the sides of the tiles. The tile of a
    /// cell is the one nearest to its middle whose sides are about `sticker` pitches long. Returns
    /// `None` if no cell has a tile, or if a cell is degenerate.
    ///
    /// `seen` is the number of visible sides of each tile, 0..=4. A tile with a missing side may be
    /// cut, so it must fit better.
    pub(super) fn from_sides(
        tiles: &[Tile],
        homography: Matrix3<f64>,
        sticker: f64,
        seen: &[u8; 9],
    ) -> Option<Self> {
        let h = &homography;
        let mut held = [None; 9];
        for ((g, slot), seen) in GRID.into_iter().zip(&mut held).zip(seen) {
            // A finger over one side moves the centre of a tile by half the width that it hides.
            let (place, pitch) = (apply(h, g), cell_area(h, g).abs().sqrt());
            let (off, odd) = if *seen == 4 { (0.12, 0.25) } else { (0.06, 0.12) };
            let fits = |tile: &Tile| {
                let off = off * pitch;
                (tile.centre.0 - place.0).abs() < off
                    && (tile.centre.1 - place.1).abs() < off
                    && shape_in_cell(h, g, tile).is_some_and(|[a, b, skew]| {
                        let alike = |side: f64| (side / sticker).ln().abs() < odd;
                        alike(a) && alike(b) && skew.abs() < odd
                    })
            };
            let nearest = tiles.iter().enumerate().filter(|(_, tile)| fits(tile));
            *slot = nearest
                .min_by(|a, b| distance(a.1.centre, place).total_cmp(&distance(b.1.centre, place)))
                .map(|(i, _)| i);
        }
        let mut lattice = Self::of(tiles, homography, held)?;
        // `of` divides by the degrees of freedom that a fit to the centres of the tiles leaves.
        // This homography was fitted to their sides instead, so the sum is divided by the number of
        // all 2n coordinates.
        let n = lattice.count() as f64;
        lattice.residual *=
            ((2.0 * n - if n < 6.0 { 6.0 } else { 8.0 }).max(1.0) / (2.0 * n)).sqrt();
        Some(lattice)
    }

    /// Returns whether tiles of the lattice `other` are in two or more cells of this one. Lattices
    /// of two different faces share no cell.
    pub(super) fn shares_cells(&self, other: &Self, tiles: &[Tile]) -> bool {
        let h = &self.homography;
        let shared = GRID.into_iter().filter(|&g| {
            let (place, pitch) = (apply(h, g), cell_area(h, g).abs().sqrt());
            let near = |&t: &usize| distance(tiles[t].centre, place) < 0.2 * pitch;
            other.tiles.iter().flatten().any(near)
        });
        shared.count() >= 2
    }

    /// Returns the number of cells with a tile.
    #[must_use]
    pub(crate) fn count(&self) -> usize {
        self.tiles.iter().flatten().count()
    }

    /// Returns the score by which rival lattices are ranked, 9 at most: the number of tiles minus a
    /// penalty for a poor fit.
    #[must_use]
    pub(crate) fn score(&self) -> f64 {
        self.count() as f64 - 30.0 * self.residual - 6.0 * self.unevenness
    }

    /// Returns whether the nine cells belong to a larger lattice, so that they are no face of a 3x3
    /// cube.
    #[must_use]
    pub(crate) fn is_larger(&self) -> bool {
        self.onward == Onward::Larger || larger(self.beyond, self.around)
    }

    /// Returns this lattice with its reading order turned so that columns run to the right of the
    /// picture and rows run down.
    #[must_use]
    fn upright(mut self) -> Self {
        // A lattice may have been proposed in any of four orders, so up to three quarter turns are
        // needed.
        for _ in 0..4 {
            let (o, x) = (apply(&self.homography, (0.0, 0.0)), apply(&self.homography, (1.0, 0.0)));
            let (dx, dy) = (x.0 - o.0, x.1 - o.1);
            if dx > 0.0 && dx.abs() >= dy.abs() {
                break;
            }
            // A quarter turn of the grid: the new (x, y) is the old (-y, x).
            let turn = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
            self.homography *= turn;
            let old = self.tiles;
            for row in 0..3 {
                for column in 0..3 {
                    self.tiles[3 * row + column] = old[3 * column + 2 - row];
                }
            }
        }
        self
    }
}

/// Returns whether a lattice is larger than 3x3, from the 16 cells around the nine: `beyond` of
/// them have a tile, and `around` of them are where a tile could be found.
fn larger(beyond: usize, around: usize) -> bool {
    beyond >= LARGER_AT_BORDER && 16 * beyond >= LARGER * around
}

/// Greatest number of lattices that are grown in one picture. It bounds the time in textured
/// pictures.
const MOST_PROPOSALS: usize = 2000;

/// Score above which nine tiles are certainly one face. In photographs nine tiles of one face reach
/// 8.1 to 8.7. Nine tiles of two faces reach 7.7, if their common edge is foreshortened like a gap.
pub(super) const CERTAIN: f64 = 8.0;

/// Tolerance of a tile's place while a lattice grows, in pitches.
const GROWING: f64 = 0.28;

/// Finds the 3x3 lattices among tile candidates, the best first. No two of them share a tile, and
/// each has at least `least` tiles.
#[must_use]
pub(crate) fn vote(tiles: &[Tile], least: usize) -> Vec<Lattice> {
    let tiles = &Places::new(tiles);
    let near: Vec<Vec<Neighbour>> = (0..tiles.len()).map(|i| neighbours(tiles, i)).collect();
    // Tiles with the most neighbours propose first. The centre tile has eight, and more are no
    // better. The index makes the order of equal ones deterministic.
    let mut order: Vec<usize> = (0..tiles.len()).filter(|&i| near[i].len() >= 2).collect();
    order.sort_by_key(|&i| (std::cmp::Reverse(near[i].len().min(8)), i));

    let mut taken = vec![false; tiles.len()];
    let mut found: Vec<Lattice> = Vec::new();
    let mut proposals = 0;
    for &seed in &order {
        if taken[seed] || proposals > MOST_PROPOSALS {
            continue;
        }
        let search = Search { tiles, near: &near, taken: &taken, least };
        let best = search.propose(seed, &mut proposals);
        let Some(best) = best else { continue };
        // A full and regular face is certain, so its tiles are taken and propose no more. The tiles
        // of a doubtful lattice stay free, since a later seed may find a better lattice.
        if best.score() > CERTAIN {
            for &tile in best.tiles.iter().flatten() {
                taken[tile] = true;
            }
        }
        found.push(best);
    }
    let mut kept = distinct(found, tiles.len());
    for i in 0..kept.len() {
        set_onward(tiles, &mut kept, i);
    }
    kept
}

/// Determines again whether the lattice `kept[of]` continues beyond its nine cells, after it was
/// replaced by another one. `kept` are all lattices of the picture.
pub(super) fn update_onward(tiles: &[Tile], kept: &mut [Lattice], of: usize) {
    set_onward(&Places::new(tiles), kept, of);
}

/// Sets the fields of the lattice `kept[of]` that say whether it continues beyond its nine cells.
fn set_onward(tiles: &Places, kept: &mut [Lattice], of: usize) {
    let onward = onward(tiles, kept, of);
    let lattice = &mut kept[of];
    let uneven;
    (lattice.beyond, uneven, lattice.around) = beyond(tiles, lattice);
    // A continuation with tiles of other sizes may be a plaid or a shelf, or by chance the cube's
    // next faces. The lattice is then doubtful, but it may still be a face.
    let perhaps = onward == Onward::Ends && larger(uneven, lattice.around);
    lattice.onward = if perhaps { Onward::Perhaps } else { onward };
}

/// Tiles sorted by column, so that those near a place are found quickly.
#[derive(Debug)]
struct Places<'a> {
    /// Tiles in their original order.
    tiles: &'a [Tile],
    /// Indices of the tiles, sorted by the column of the centre.
    order: Vec<usize>,
    /// Columns of the centres in this order (px).
    columns: Vec<f64>,
}

impl<'a> Places<'a> {
    /// Sorts the tiles by the columns of their centres.
    fn new(tiles: &'a [Tile]) -> Self {
        let mut order: Vec<usize> = (0..tiles.len()).collect();
        order.sort_by(|&a, &b| tiles[a].centre.0.total_cmp(&tiles[b].centre.0));
        let columns = order.iter().map(|&i| tiles[i].centre.0).collect();
        Self { tiles, order, columns }
    }

    /// Returns the indices of the tiles whose centres are at most `reach` (px) from a place along x
    /// and along y.
    fn near(&self, place: Point, reach: f64) -> impl Iterator<Item = usize> {
        let first = self.columns.partition_point(|&x| x < place.0 - reach);
        let end = self.columns.partition_point(|&x| x <= place.0 + reach).max(first);
        self.order[first..end]
            .iter()
            .copied()
            .filter(move |&i| (self.tiles[i].centre.1 - place.1).abs() <= reach)
    }
}

impl std::ops::Deref for Places<'_> {
    type Target = [Tile];

    fn deref(&self) -> &[Tile] {
        self.tiles
    }
}

/// Counts, among the 16 cells around the nine of a lattice, those with a tile of the size of the
/// nine, those with a tile whose sides are half to twice as long, and those where a tile could be
/// found. Returns these three numbers.
fn beyond(tiles: &Places, lattice: &Lattice) -> (usize, usize, usize) {
    let h = &lattice.homography;
    let rows = || tiles.iter().map(|t| t.centre.1);
    let (top, bottom) =
        (rows().fold(f64::INFINITY, f64::min), rows().fold(f64::NEG_INFINITY, f64::max));
    let (left, right) = (tiles.columns.first(), tiles.columns.last());
    // A cell outside the bounding box of all tiles cannot have a tile, so it must not count as
    // empty.
    let among = |p: Point| {
        left.is_some_and(|x| p.0 >= *x)
            && right.is_some_and(|x| p.0 <= *x)
            && p.1 >= top
            && p.1 <= bottom
    };
    let around = (0..25).map(|i| (f64::from(i % 5) - 2.0, f64::from(i / 5) - 2.0));
    let around: Vec<Point> = around.filter(|g| g.0.abs().max(g.1.abs()) > 1.5).collect();
    let could = around.iter().filter(|&&g| among(apply(h, g))).count();
    let held = |sizes| {
        let cells = around.iter().filter(|&&g| at_cell(tiles, lattice, g, 0.15, sizes).is_some());
        cells.count()
    };
    (held(ALIKE), held((0.5, 2.0)), could)
}

/// Least and greatest ratio of the sides of two tiles of one face.
const ALIKE: (f64, f64) = (0.75, 1.33);

/// Returns the index of a tile in the cell at `g` (column - 1, row - 1) beside the nine, or `None`
/// if there is none. The tile's centre must be within `reach` pitches of the cell's, and the ratio
/// of its sides to those of the nine within `sizes`.
fn at_cell(
    tiles: &Places,
    lattice: &Lattice,
    g: Point,
    reach: f64,
    sizes: (f64, f64),
) -> Option<usize> {
    let h = &lattice.homography;
    let w = h[(2, 0)] * g.0 + h[(2, 1)] * g.1 + h[(2, 2)];
    // The horizon of the extrapolated plane is at w = 0. A cell beyond it has no image.
    if w < 0.2 {
        return None;
    }
    let (place, pitch) = (apply(h, g), cell_area(h, g).abs().sqrt());
    tiles.near(place, reach * pitch).find(|&t| {
        shape_in_cell(h, g, &tiles[t]).is_some_and(|[a, b, skew]| {
            let alike = |side: f64| (sizes.0..sizes.1).contains(&(side / lattice.sticker));
            alike(a) && alike(b) && skew.abs() < 0.25
        })
    })
}

/// Determines whether the lattice `kept[of]` continues beyond one of its four sides.
///
/// Three tiles beside it may be the first row of the cube's next face. That face is a lattice of
/// its own in another plane: its further rows are not where the plane of the first face predicts
/// them.
fn onward(tiles: &Places, kept: &[Lattice], of: usize) -> Onward {
    let lattice = &kept[of];
    let mut onward = Onward::Ends;
    for (x, y) in [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)] {
        // The tiles in the row or column at `far` pitches from the centre. The tolerance grows with
        // the distance, since the homography is extrapolated.
        let row = |far: f64| -> Vec<usize> {
            let reach = 0.15 * (far - 1.0).min(2.0);
            let cells = [-1.0, 0.0, 1.0].map(|k| (far * x + k * y, far * y + k * x));
            cells.into_iter().filter_map(|g| at_cell(tiles, lattice, g, reach, ALIKE)).collect()
        };
        let first = row(2.0);
        if first.len() < 2 {
            continue;
        }
        // Another lattice with two of these tiles counts as the next face only if it has a tile in
        // each row and column. Otherwise its place is not determined.
        let face = kept.iter().enumerate().any(|(i, other)| {
            let whole = (0..3).all(|k| {
                (0..3).any(|j| other.tiles[3 * k + j].is_some())
                    && (0..3).any(|j| other.tiles[3 * j + k].is_some())
            });
            i != of
                && whole
                && first.iter().filter(|&&t| other.tiles.contains(&Some(t))).count() >= 2
        });
        let further = [3.0, 4.0, 5.0].iter().take_while(|&&far| row(far).len() >= 2).count();
        match (face, further) {
            // The next face is in another plane, as a face of a cube is.
            (true, 0) => {}
            // The next face seems to be in the same plane: it is seen at an equal angle, or there
            // are six rows of three in one plane.
            (true, 1 | 2) => onward = Onward::Perhaps,
            // Two tiles beside the nine may be there by chance.
            (false, 0) if first.len() < 3 => onward = Onward::Perhaps,
            // The next face would have three rows. With a fourth one, or a row that belongs to no
            // face, the lattice is larger.
            _ => return Onward::Larger,
        }
    }
    onward
}

/// Keeps only the best one of lattices that share tiles or overlap in the picture. Returns the kept
/// ones upright, the best first. `tiles` is the number of all tiles.
fn distinct(mut found: Vec<Lattice>, tiles: usize) -> Vec<Lattice> {
    found.sort_by(|a, b| b.score().total_cmp(&a.score()));
    let mut used = vec![false; tiles];
    let mut kept: Vec<Lattice> = Vec::new();
    for lattice in found {
        let shared = lattice.tiles.iter().flatten().filter(|&&t| used[t]).count();
        let centre = apply(&lattice.homography, (0.0, 0.0));
        // Lattices without a common tile may still overlap in the picture, which two faces do not.
        let inside = kept.iter().any(|k| {
            let corners = homography::OUTLINE.map(|c| apply(&k.homography, c));
            encloses(&corners, centre)
        });
        if shared == 0 && !inside {
            lattice.tiles.iter().flatten().for_each(|&t| used[t] = true);
            kept.push(lattice.upright());
        }
    }
    kept
}

/// Returns whether a point is inside a convex quadrilateral, whose corners run clockwise on the
/// screen.
#[must_use]
pub(super) fn encloses(corners: &[Point; 4], p: Point) -> bool {
    (0..4).all(|i| {
        let (a, b) = (corners[i], corners[(i + 1) % 4]);
        (b.0 - a.0) * (p.1 - a.1) - (b.1 - a.1) * (p.0 - a.0) > 0.0
    })
}

/// Tile near another one.
#[derive(Debug, Clone, Copy)]
struct Neighbour {
    /// Index of the tile.
    tile: usize,
    /// Offset from the other tile, in the metric in which that other tile is a unit square.
    whitened: Point,
}

/// Returns the neighbours of tile `i`, the nearest first, 12 at most: tiles of about its shape and
/// size at a distance of 0.9 to 2.3 of its sides.
fn neighbours(tiles: &Places, i: usize) -> Vec<Neighbour> {
    let me = &tiles[i];
    let [xx, xy, yy] = me.moments;
    // L is the Cholesky factor of the moments, and L^-1 whitens an offset. A unit square has second
    // moments of 1/12, so division by the root of 12 makes the side of the tile the unit.
    let l11 = xx.sqrt();
    let l21 = xy / l11;
    let l22 = (yy - l21 * l21).max(1e-9).sqrt();
    let unit = 12f64.sqrt();
    // The trace is at least the largest eigenvalue, so no neighbour within 2.3 sides is farther.
    let reach = 2.4 * unit * (xx + yy).sqrt();
    let mut near: Vec<Neighbour> = tiles
        .near(me.centre, reach)
        .filter(|&j| j != i && alike(me, &tiles[j]))
        .filter_map(|j| {
            let other = &tiles[j];
            let (dx, dy) = (other.centre.0 - me.centre.0, other.centre.1 - me.centre.1);
            let u = dx / l11;
            let whitened = (u / unit, (dy - l21 * u) / l22 / unit);
            let q = whitened.0.hypot(whitened.1);
            // Tiles do not overlap, so the pitch is at least about a side. Neighbours across a
            // corner count as well: they are 1.41 pitches away, and a pitch is up to 1.6 sides.
            (0.9..2.3).contains(&q).then_some(Neighbour { tile: j, whitened })
        })
        .collect();
    near.sort_by(|a, b| {
        let q = |n: &Neighbour| n.whitened.0.hypot(n.whitened.1);
        q(a).total_cmp(&q(b)).then(a.tile.cmp(&b.tile))
    });
    near.truncate(12);
    near
}

/// Returns whether two tiles may belong to one face: their areas and their shapes are similar.
fn alike(a: &Tile, b: &Tile) -> bool {
    let ratio = b.area / a.area;
    if !(0.4..2.5).contains(&ratio) {
        return false;
    }
    let [axx, axy, ayy] = a.moments;
    let [bxx, bxy, byy] = b.moments;
    let det = axx * ayy - axy * axy;
    // For the moments A and B the trace of A^-1 B is 2 if they are equal. Half of it, divided by
    // the ratio of the areas, compares the shapes alone: it is 1 for equal shapes, else more.
    let trace = (ayy * bxx - 2.0 * axy * bxy + axx * byy) / det;
    trace / (2.0 * ratio) < 1.7
}

/// Input of a search for lattices.
struct Search<'a> {
    /// Tile candidates.
    tiles: &'a Places<'a>,
    /// Neighbours of each tile.
    near: &'a [Vec<Neighbour>],
    /// Whether each tile belongs to a certain lattice already.
    taken: &'a [bool],
    /// Least number of tiles of a lattice.
    least: usize,
}

impl Search<'_> {
    /// Returns the best lattice that grows from the tile `seed` and a pair of its neighbours at
    /// right angles; `None` if no pair gives one. Adds the number of pairs tried to `proposals`.
    fn propose(&self, seed: usize, proposals: &mut usize) -> Option<Lattice> {
        let Self { near, taken, .. } = *self;
        let mut best: Option<Lattice> = None;
        let mine = &near[seed];
        for (k, a) in mine.iter().enumerate() {
            if taken[a.tile] {
                continue;
            }
            for b in &mine[k + 1..] {
                if taken[b.tile] {
                    continue;
                }
                let (p, q) = (a.whitened, b.whitened);
                let (lp, lq) = (p.0.hypot(p.1), q.0.hypot(q.1));
                let cos = (p.0 * q.0 + p.1 * q.1) / (lp * lq);
                // The next tiles in a row and in a column are at right angles and equally far in
                // the tile's own metric. The limits allow for perspective and for ragged tiles.
                if cos.abs() > 0.4 || lq > 1.5 * lp {
                    continue;
                }
                *proposals += 1;
                // The order of the two is chosen so that the lattice is not mirrored.
                let right_handed = p.0 * q.1 - p.1 * q.0 > 0.0;
                let (x, y) = if right_handed { (a.tile, b.tile) } else { (b.tile, a.tile) };
                let Some(lattice) = self.grow(seed, x, y) else { continue };
                if best.as_ref().is_none_or(|best| lattice.score() > best.score()) {
                    let certain = lattice.score() > CERTAIN;
                    best = Some(lattice);
                    if certain {
                        return best;
                    }
                }
            }
        }
        best
    }

    /// Grows a lattice over 5x5 cells around the tile `seed`, from the tile `x` in the next column
    /// and `y` in the next row. Returns the best 3x3 part of it, or `None` if no part is good
    /// enough.
    fn grow(&self, seed: usize, x: usize, y: usize) -> Option<Lattice> {
        // The seed may be any tile of the face, so each of the nine windows around it is tried.
        let cells = self.fill(seed, x, y);
        let mut best: Option<Lattice> = None;
        for top in 0..3 {
            for left in 0..3 {
                let mut held = [None; 9];
                for (i, cell) in held.iter_mut().enumerate() {
                    *cell = cells[top + i / 3][left + i % 3];
                }
                let count = held.iter().flatten().count();
                // A score is never above the number of tiles, so a window with fewer tiles than the
                // best score cannot win.
                if count < self.least || best.as_ref().is_some_and(|b| (count as f64) < b.score()) {
                    continue;
                }
                if let Some(lattice) = settle(self.tiles, held, self.least, self.taken)
                    && best.as_ref().is_none_or(|b| lattice.score() > b.score())
                {
                    best = Some(lattice);
                }
            }
        }
        best
    }

    /// Fills 5x5 cells: with the tile `seed` in the middle, `x` in the next column and `y` in the
    /// next row, then with tiles at the places that filled cells predict. Returns the index of the
    /// tile in each cell.
    fn fill(&self, seed: usize, x: usize, y: usize) -> [[Option<usize>; 5]; 5] {
        let Self { tiles, near, taken, .. } = *self;
        let at = |i: usize| tiles[i].centre;
        let mut cells: [[Option<usize>; 5]; 5] = [[None; 5]; 5];
        cells[2][2] = Some(seed);
        cells[2][3] = Some(x);
        cells[3][2] = Some(y);
        let step = |from: usize, to: usize| (at(to).0 - at(from).0, at(to).1 - at(from).1);
        let (basis_x, basis_y) = (step(seed, x), step(seed, y));

        // Each round reaches one cell farther. Three rounds reach all cells except the corner
        // opposite to `x` and `y`, which is four steps away; `settle` may fill it.
        for _ in 0..3 {
            let before = cells;
            for row in 0..5 {
                for column in 0..5 {
                    if cells[row][column].is_some() {
                        continue;
                    }
                    let Some((anchor, place, pitch)) =
                        predict(&before, tiles, (row, column), basis_x, basis_y)
                    else {
                        continue;
                    };
                    // In strong perspective one tile may fit two cells. The first one keeps it.
                    let held = |t: usize| cells.iter().flatten().any(|&c| c == Some(t));
                    let chosen = near[anchor]
                        .iter()
                        .map(|n| n.tile)
                        .filter(|&t| !taken[t])
                        .map(|t| (t, distance(at(t), place)))
                        .filter(|&(_, d)| d < GROWING * pitch)
                        .min_by(|a, b| a.1.total_cmp(&b.1));
                    if let Some((tile, _)) = chosen
                        && !held(tile)
                    {
                        cells[row][column] = Some(tile);
                    }
                }
            }
            if cells == before {
                break;
            }
        }

        cells
    }
}

/// Predicts the place of the tile in an empty cell from a filled cell beside it. Returns the index
/// of the tile in that filled cell, the predicted place (px) and the pitch there (px), or `None` if
/// no cell beside it is filled.
///
/// `basis_x` and `basis_y` are the steps to the next column and row at the seed (px).
fn predict(
    cells: &[[Option<usize>; 5]; 5],
    tiles: &[Tile],
    (row, column): (usize, usize),
    basis_x: Point,
    basis_y: Point,
) -> Option<(usize, Point, f64)> {
    let get = |r: i32, c: i32| {
        ((0..5).contains(&r) && (0..5).contains(&c))
            .then(|| cells[r as usize][c as usize])
            .flatten()
    };
    let (r, c) = (row as i32, column as i32);
    for (dr, dc) in [(0, 1), (0, -1), (1, 0), (-1, 0)] {
        let Some(anchor) = get(r + dr, c + dc) else { continue };
        let from = tiles[anchor].centre;
        let basis = if dr == 0 { basis_x } else { basis_y };
        let sign = -f64::from(dr + dc);
        let mut step = (basis.0 * sign, basis.1 * sign);
        // Perspective changes the pitch over the face. The step on the other side of the filled
        // cell, or a parallel one in the next row or column, therefore predicts better than the
        // step at the seed.
        if let Some(beyond) = get(r + 2 * dr, c + 2 * dc) {
            let b = tiles[beyond].centre;
            step = (from.0 - b.0, from.1 - b.1);
        } else {
            for side in [1, -1] {
                let (sr, sc) = (side * dc.abs(), side * dr.abs());
                if let (Some(a), Some(b)) = (get(r + dr + sr, c + dc + sc), get(r + sr, c + sc)) {
                    let (a, b) = (tiles[a].centre, tiles[b].centre);
                    step = (b.0 - a.0, b.1 - a.1);
                    break;
                }
            }
        }
        return Some((anchor, (from.0 + step.0, from.1 + step.1), step.0.hypot(step.1)));
    }
    None
}

/// Residual and unevenness above which a lattice may have a tile that is cut by a finger or a
/// reflection.
const ODD: (f64, f64) = (0.035, 0.12);

/// Fits a lattice to the tiles in nine cells. As long as it improves the score, drops the tile that
/// differs most from the others in size, form and place, down to `least` tiles. Tiles that are
/// `taken` by another lattice are not added. Returns `None` if the tiles fit no lattice.
fn settle(
    tiles: &Places,
    held: [Option<usize>; 9],
    least: usize,
    taken: &[bool],
) -> Option<Lattice> {
    let mut best = settle_without(tiles, held, least, taken, &[])?;
    let mut without = Vec::new();
    // A dropped tile costs one point of the score, so it is dropped only for a clearly better fit.
    // A lattice with a score below 2 is too poor for that.
    while best.count() > least
        && (best.residual > ODD.0 || best.unevenness > ODD.1)
        && best.score() > 2.0
    {
        let Some(odd) = odd_one(tiles, &best) else { break };
        without.extend(best.tiles[odd]);
        let mut fewer = best.tiles;
        fewer[odd] = None;
        match settle_without(tiles, fewer, least, taken, &without) {
            Some(lattice) if lattice.score() > best.score() => best = lattice,
            _ => break,
        }
    }
    Some(best)
}

/// Returns the index of the cell whose tile differs most from the median tile in size, form and
/// place; `None` without any tile.
fn odd_one(tiles: &Places, lattice: &Lattice) -> Option<usize> {
    let h = &lattice.homography;
    let shapes = GRID.into_iter().zip(lattice.tiles).enumerate();
    let shapes: Vec<(usize, [f64; 3], f64)> = shapes
        .filter_map(|(i, (g, tile))| {
            let tile = &tiles[tile?];
            let pitch = cell_area(h, g).abs().sqrt();
            Some((i, shape_in_cell(h, g, tile)?, distance(tile.centre, apply(h, g)) / pitch))
        })
        .collect();
    // The median is used, because a cut tile would shift the mean of a few tiles towards itself.
    let middle = |k: usize| {
        let mut sides: Vec<f64> = shapes.iter().map(|(_, s, _)| s[k]).collect();
        sides.sort_by(f64::total_cmp);
        sides.get(sides.len() / 2).copied().unwrap_or(1.0)
    };
    let (a, b) = (middle(0), middle(1));
    let oddness = |s: &[f64; 3], off: f64| {
        (s[0] / a - 1.0).powi(2)
            + (s[1] / b - 1.0).powi(2)
            + 2.0 * s[2].powi(2)
            + (2.0 * off).powi(2)
    };
    shapes.iter().max_by(|x, y| oddness(&x.1, x.2).total_cmp(&oddness(&y.1, y.2))).map(|(i, ..)| *i)
}

/// Fits the homography to the tiles in nine cells, drops tiles that are off their cells, and fills
/// empty cells with tiles that fit, except those that are `taken` or in `without`. Returns `None`
/// if fewer than `least` tiles are left, or if they fit badly.
fn settle_without(
    tiles: &Places,
    mut held: [Option<usize>; 9],
    least: usize,
    taken: &[bool],
    without: &[usize],
) -> Option<Lattice> {
    for round in 0..3 {
        let cells = Cells::of(tiles, &held)?;
        // In the last round the tiles do not change any more.
        if round < 2 {
            let mut changed = cells.drop_misfits(tiles, &mut held);
            let free = |t: usize| !taken[t] && !without.contains(&t);
            changed |= cells.fill(tiles, &mut held, free);
            if held.iter().flatten().count() < least {
                return None;
            }
            if changed {
                continue;
            }
        }
        let lattice = Lattice::of(tiles, cells.h, held)?;
        return (lattice.residual <= 0.14).then_some(lattice);
    }
    None
}

/// The nine cells of a face in the picture, fitted to the tiles in them.
struct Cells {
    /// Map from places of the face (column - 1, row - 1) to pixels.
    h: Matrix3<f64>,
    /// Centres of the cells (px).
    centres: [Point; 9],
    /// Smallest distance between neighbouring centres (px).
    pitch: f64,
    /// Areas of the cells (px^2).
    areas: [f64; 9],
}

impl Cells {
    /// Fits the cells to the centres of the tiles in them. Returns `None` if the cells cannot be
    /// those of a face in front of the camera.
    fn of(tiles: &Places, held: &[Option<usize>; 9]) -> Option<Self> {
        let pairs: Vec<(Point, Point)> = held
            .iter()
            .enumerate()
            .filter_map(|(i, t)| t.map(|t| (GRID[i], tiles[t].centre)))
            .collect();
        let h = homography::fit(&pairs)?;
        let centres = GRID.map(|g| apply(&h, g));
        let pitch = homography::smallest_pitch(&centres);
        // A face is convex and not mirrored, and its corners are in front of the camera. At a pitch
        // below 2.5 px there is no gap between tiles.
        let corners = homography::OUTLINE.map(|c| apply(&h, c));
        let positive =
            homography::OUTLINE.iter().all(|c| h[(2, 0)] * c.0 + h[(2, 1)] * c.1 + h[(2, 2)] > 0.2);
        if !positive || !pitch.is_finite() || pitch < 2.5 {
            return None;
        }
        let (area, _) = homography::polygon(&corners);
        if area <= 0.0 || !convex(&corners) {
            return None;
        }
        Some(Self { h, centres, pitch, areas: std::array::from_fn(|i| cell_area(&h, GRID[i])) })
    }

    /// Returns the distance of a tile from the centre of cell `i`, in pitches at that cell. The
    /// pitch there is the square root of the cell's area, but at most twice the smallest pitch.
    fn error(&self, i: usize, tile: &Tile) -> f64 {
        distance(tile.centre, self.centres[i]) / self.areas[i].abs().sqrt().min(2.0 * self.pitch)
    }

    /// Empties the cells whose tiles are far from the cell's centre or do not have its size.
    /// Returns whether there were such cells.
    fn drop_misfits(&self, tiles: &Places, held: &mut [Option<usize>; 9]) -> bool {
        let mut changed = false;
        for (i, slot) in held.iter_mut().enumerate() {
            if let Some(tile) = *slot {
                let share = tiles[tile].area / self.areas[i];
                if self.error(i, &tiles[tile]) > 0.2 || !(0.12..1.15).contains(&share) {
                    *slot = None;
                    changed = true;
                }
            }
        }
        changed
    }

    /// Puts the nearest free tile that fits into each empty cell. Returns whether it found one.
    fn fill(
        &self,
        tiles: &Places,
        held: &mut [Option<usize>; 9],
        free: impl Fn(usize) -> bool,
    ) -> bool {
        let mut changed = false;
        for i in 0..9 {
            if held[i].is_some() {
                continue;
            }
            let error = |t: usize| self.error(i, &tiles[t]);
            let fill = tiles
                .near(self.centres[i], 0.3 * self.pitch)
                .filter(|&t| {
                    // The limits are stricter than in `drop_misfits`, so that no tile is added and
                    // dropped again.
                    free(t)
                        && (0.2..1.1).contains(&(tiles[t].area / self.areas[i]))
                        && error(t) < 0.15
                })
                .min_by(|&a, &b| error(a).total_cmp(&error(b)));
            if let Some(tile) = fill
                && !held.contains(&Some(tile))
            {
                held[i] = Some(tile);
                changed = true;
            }
        }
        changed
    }
}

/// Returns the lengths of a tile's sides along the rows and along the columns of the face at the
/// cell `g`, as shares of the pitch, and its skew (0 at right angles, -1..=1). Returns `None` if
/// the homography is degenerate at the cell.
fn shape_in_cell(h: &Matrix3<f64>, g: Point, tile: &Tile) -> Option<[f64; 3]> {
    // J is the Jacobian of the map at the cell, and M are the moments in the picture. The moments
    // in the cell are then J^-1 M J^-T, and the square of a side is 12 times its moment.
    let step = 0.05;
    let side = |dx: f64, dy: f64| {
        let (a, b) = (apply(h, (g.0 - dx, g.1 - dy)), apply(h, (g.0 + dx, g.1 + dy)));
        ((b.0 - a.0) / (2.0 * step), (b.1 - a.1) / (2.0 * step))
    };
    let (u, v) = (side(step, 0.0), side(0.0, step));
    let inverse = Matrix2::new(u.0, v.0, u.1, v.1).try_inverse()?;
    let [xx, xy, yy] = tile.moments;
    let shape = inverse * Matrix2::new(xx, xy, xy, yy) * inverse.transpose() * 12.0;
    let (a, b) = (shape[(0, 0)].sqrt(), shape[(1, 1)].sqrt());
    Some([a, b, shape[(0, 1)] / (a * b).max(1e-9)])
}

/// Returns whether four corners make a convex quadrilateral that runs clockwise on the screen.
fn convex(corners: &[Point; 4]) -> bool {
    (0..4).all(|i| {
        let (a, b, c) = (corners[i], corners[(i + 1) % 4], corners[(i + 2) % 4]);
        (b.0 - a.0) * (c.1 - b.1) - (b.1 - a.1) * (c.0 - b.0) > 0.0
    })
}

/// Computes the area of the cell at `g` in the image (px^2), negative if it is mirrored.
fn cell_area(h: &Matrix3<f64>, g: Point) -> f64 {
    let corners = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
        .map(|(x, y)| apply(h, (g.0 + x, g.1 + y)));
    homography::polygon(&corners).0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the tile in the cell `g` of a face, with sides of 0.8 pitches.
    fn tile(h: &Matrix3<f64>, g: Point) -> Tile {
        let (o, x, y) = (apply(h, g), apply(h, (g.0 + 0.4, g.1)), apply(h, (g.0, g.1 + 0.4)));
        let (u, v) = ((x.0 - o.0, x.1 - o.1), (y.0 - o.0, y.1 - o.1));
        Tile {
            centre: o,
            moments: [
                (u.0 * u.0 + v.0 * v.0) / 3.0,
                (u.0 * u.1 + v.0 * v.1) / 3.0,
                (u.1 * u.1 + v.1 * v.1) / 3.0,
            ],
            area: 4.0 * (u.0 * v.1 - u.1 * v.0).abs(),
            fullness: 1.0,
        }
    }

    /// Returns the homography of a face that is seen obliquely.
    fn oblique() -> Matrix3<f64> {
        Matrix3::new(30.0, 6.0, 210.0, -8.0, 22.0, 180.0, 0.03, -0.02, 1.0)
    }

    /// The vote finds a face with three lost tiles among four false tiles.
    #[test]
    fn vote_finds_face_among_false_tiles() {
        let h = oblique();
        let mut tiles: Vec<Tile> = GRID
            .iter()
            .enumerate()
            .filter(|(i, _)| ![1, 5, 6].contains(i))
            .map(|(_, &g)| tile(&h, g))
            .collect();
        for (x, y) in [(20.0, 30.0), (60.0, 200.0), (400.0, 100.0), (245.0, 130.0)] {
            let mut stray = tiles[0];
            stray.centre = (x, y);
            tiles.push(stray);
        }

        let found = vote(&tiles, 5);

        assert_eq!(found.len(), 1);
        assert_eq!(found[0].count(), 6);
        for g in GRID {
            assert!(distance(apply(&found[0].homography, g), apply(&h, g)) < 3.0);
        }
    }

    #[test]
    fn vote_separates_two_faces_sharing_an_edge() {
        let (a, b) = (oblique(), Matrix3::new(18.0, 6.0, 290.0, 12.0, 24.0, 178.0, 0.0, 0.0, 1.0));
        let tiles: Vec<Tile> = [a, b].iter().flat_map(|h| GRID.map(|g| tile(h, g))).collect();

        let found = vote(&tiles, 5);

        assert_eq!(found.iter().map(Lattice::count).collect::<Vec<_>>(), [9, 9]);
    }

    /// Returns the tiles of a floor: `rows` x `columns` cells of one plane, of which the first is
    /// at the top left of the face that [`oblique`] describes.
    fn floor(rows: i32, columns: i32) -> Vec<Tile> {
        (0..rows * columns)
            .map(|i| tile(&oblique(), (f64::from(i % columns) - 1.0, f64::from(i / columns) - 1.0)))
            .collect()
    }

    /// A lattice that continues in its own plane is larger than a face of a cube.
    #[test]
    fn grid_larger_than_three_by_three_is_recognised() {
        let larger = |rows, columns| {
            let found = vote(&floor(rows, columns), 5);
            !found.is_empty() && found.iter().all(Lattice::is_larger)
        };

        assert!(!larger(3, 3));
        assert!(larger(4, 4) && larger(5, 5));
        // In strips that are three cells wide at most three tiles are beside the nine on a side.
        assert!(larger(4, 3) && larger(3, 4) && larger(3, 7));
    }

    /// Six rows of three tiles in one plane may be two faces seen at equal angles.
    #[test]
    fn six_by_three_tiles_form_two_lattices() {
        let found = vote(&floor(6, 3), 5);

        assert_eq!(found.len(), 2);
        assert!(found.iter().all(|l| l.onward != Onward::Ends), "{found:?}");
    }

    /// A tile that is a tenth of a pitch off its cell is kept if all its four sides are visible,
    /// and dropped as cut if one side is missing.
    #[test]
    fn lattice_drops_displaced_tile_with_missing_side() {
        let h = oblique();
        let mut tiles: Vec<Tile> = GRID.iter().map(|&g| tile(&h, g)).collect();
        let (a, b) = (apply(&h, (0.0, 0.0)), apply(&h, (0.1, 0.0)));
        tiles[4].centre.0 += b.0 - a.0;
        let seen = |middle| std::array::from_fn(|i| if i == 4 { middle } else { 4 });

        let cut = Lattice::from_sides(&tiles, h, 0.8, &seen(3)).unwrap();
        let whole = Lattice::from_sides(&tiles, h, 0.8, &seen(4)).unwrap();

        assert_eq!((cut.count(), cut.tiles[4]), (8, None));
        assert!(cut.residual < 1e-6 && cut.unevenness < 1e-3, "{cut:?}");
        assert_eq!((whole.count(), whole.tiles[4]), (9, Some(4)));
    }

    #[test]
    fn only_lattices_within_two_rows_share_cells() {
        let tiles = floor(5, 3);
        let on = |by: f64| {
            let shift = Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, by, 0.0, 0.0, 1.0);
            Lattice::from_sides(&tiles, oblique() * shift, 0.8, &[4; 9]).unwrap()
        };

        assert!(on(0.0).shares_cells(&on(2.0), &tiles));
        assert!(!on(0.0).shares_cells(&on(3.0), &tiles));
    }

    #[test]
    fn scattered_tiles_form_no_lattice() {
        let h = oblique();
        let tiles: Vec<Tile> = (0..20)
            .map(|i| {
                let mut t = tile(&h, (0.0, 0.0));
                t.centre = (f64::from(i * 7919 % 613), f64::from(i * 104729 % 467));
                t
            })
            .collect();

        assert!(vote(&tiles, 6).is_empty());
    }
}
