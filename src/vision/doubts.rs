//! Evidence that a lattice of nine is a face of a cube, and evidence against it.
//!
//! Windows, cloth, drawers, charts and keypads have lattices of nine as well. A confidence of
//! [`MOST_IF_AMBIGUOUS`] or less says that the nine tiles may be something else.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | tiles are off the lattice | residual 0.10, unevenness 0.5 | noise and glare move tiles |
//! | row or column shows no tile | support <= [`NOWHERE`] | it may be on the opposite side |
//! | few tiles, but exact | six, or four with [`MANY`] sides | a face under a hand: support 0.48 |
//! | few tiles are exact | residual < 0.03, unevenness < 0.12 | chance lattices are less regular |
//! | cell without a region | [`SHOWN`] by its number of sides | a cut tile still shows sides |
//! | all tiles agree | [`AGREE`] of 36 sides | each stripe of a cloth has its own width |
//! | one hue | shares of light differ by < 0.1..0.2 | windows, drawers, floors |
//! | crossing stripes, chessboard | [`WOVEN`] | cloth |
//! | tiles are too small | side < 0.5..0.7 pitches | pictures on a wall |
//! | tiles are round | fullness > 1.03..1.045 | discs |
//! | gaps of several colours | `patchwork` | stripes of a cloth |
//!
//! A threshold of two values is soft: between them the evidence changes gradually.
//!
//! - in: a [`Lattice`], the number of visible sides of its tiles, the picture
//! - out: evidence for a face as factors, 0..=1
//! - source: own work

use super::classes::median;
use super::colours;
use super::homography::apply;
use super::lattice::Lattice;
use super::patch::Patch;
use nalgebra::Matrix3;

/// Greatest confidence in a lattice that may be a face but also something else.
pub(super) const MOST_IF_AMBIGUOUS: f64 = 0.6;

/// Computes the confidence that a lattice is a face from the places of its tiles alone, 0..=1.
/// `sides` is the number of visible sides of each tile, 0..=4.
pub(super) fn certainty(lattice: &Lattice, sides: &[u8; 9]) -> f64 {
    let fit = (-(lattice.residual / 0.10).powi(2)).exp();
    let even = (-(lattice.unevenness / 0.5).powi(2)).exp();
    support(lattice, sides) * fit * even
}

/// Computes how well the regions and sides that were found support a face of nine tiles, 0..=1.
/// `sides` is the number of visible sides of each tile, 0..=4.
fn support(lattice: &Lattice, sides: &[u8; 9]) -> f64 {
    // A cell without a region of its own may still be a tile. Then it has edges where a tile has
    // its sides, on all sides that nothing covers. The background has none there.
    let free = (0..9).filter(|&i| lattice.tiles[i].is_none());
    let shown: f64 = free.map(|i| SHOWN[usize::from(sides[i])]).sum();
    let held = lattice.count();
    let support = ((held as f64 + shown - 4.5) / 4.5).clamp(0.0, 1.0);
    // Two rows do not show on which side the third row is, and likewise for columns. Once a cube
    // was believed to be one tile farther, and the hand closed beside it.
    let lies = |along: fn(usize) -> usize| {
        (0..3).all(|k| {
            let mut line = (0..9).filter(|&i| along(i) == k);
            // Three of the sides may belong to the next row or column.
            line.clone().map(|i| sides[i]).sum::<u8>() >= 5
                || line.any(|i| lattice.tiles[i].is_some() || sides[i] >= 3)
        })
    };
    if !(lies(|i| i / 3) && lies(|i| i % 3)) {
        return support.min(NOWHERE);
    }
    // Six tiles that agree in place, size and form are a face, partly hidden by a hand. So are four
    // tiles if the others show enough sides. Their support is above the default limit of 0.4, at
    // which faces are reported, but not high.
    let enough = held >= 6 || (held >= 4 && sides.iter().sum::<u8>() >= MANY);
    let exact = enough && lattice.residual < 0.03 && lattice.unevenness < 0.12;
    if exact { support.max(0.48) } else { support }
}

/// Greatest support if a row or a column shows no tile. It is below the least confidence that the
/// detector reports by default.
const NOWHERE: f64 = 0.35;

/// Least number of visible sides, of 36, at which the tiles are alike and none is covered.
pub(super) const AGREE: u8 = 30;

/// Least number of visible sides, of 36, at which four tiles are evidence for a face.
const MANY: u8 = 20;

/// Support by a cell without a region, for 0 to 4 visible sides. A single side may belong to the
/// next tile.
const SHOWN: [f64; 5] = [0.0, 0.0, 0.35, 0.5, 0.6];

/// Returns how much the hues of nine tiles differ: the largest difference between two tiles in the
/// share of red, of green or of blue in their light.
pub(super) fn hues(rgb: &[[f64; 3]; 9]) -> f64 {
    // The constant is added so that noise does not decide the shares of dark tiles.
    let shares = rgb.map(|c| {
        let linear = c.map(|v| colours::to_linear(v) + 0.002);
        let sum: f64 = linear.iter().sum();
        linear.map(|v| v / sum)
    });
    (0..3)
        .map(|k| {
            let level = |s: &[f64; 3]| s[k];
            shares.iter().map(level).fold(0.0, f64::max)
                - shares.iter().map(level).fold(1.0, f64::min)
        })
        .fold(0.0, f64::max)
}

/// Computes the evidence for a cube from `hues`, the result of [`hues()`]: [`MOST_IF_AMBIGUOUS`]
/// for nine tiles of one hue, up to 1 for several. Nine tiles of one hue are more often a window,
/// drawers or a floor than a solved face.
pub(super) fn variety(hues: f64) -> f64 {
    MOST_IF_AMBIGUOUS + (1.0 - MOST_IF_AMBIGUOUS) * ((hues - 0.1) / 0.1).clamp(0.0, 1.0)
}

/// Computes the evidence for a cube from the pattern of nine colours: [`MOST_IF_AMBIGUOUS`] for
/// crossing stripes or a chessboard, up to 1 for other patterns. `held` says for each cell whether
/// a region was found in it.
///
/// Where stripes of a cloth cross, the colour of a cell is the sum of the colour of its row and
/// that of its column. On a chessboard two colours alternate. Up to two cells without a region are
/// ignored in the test for a chessboard, because they may show an object that lies on it.
pub(super) fn arrangement_evidence(rgb: &[[f64; 3]; 9], held: &[bool; 9]) -> f64 {
    let (mut all, mut crossed) = (0.0, 0.0);
    for c in 0..3 {
        let mean = |of: &dyn Fn(usize) -> bool| {
            let levels: Vec<f64> = (0..9).filter(|&j| of(j)).map(|j| rgb[j][c]).collect();
            levels.iter().sum::<f64>() / levels.len() as f64
        };
        let whole = mean(&|_| true);
        // Two-way analysis of variance: `crossed` is the variance that rows and columns leave
        // unexplained.
        for (i, level) in rgb.iter().map(|p| p[c]).enumerate() {
            let (row, column) = (mean(&|j| j / 3 == i / 3), mean(&|j| j % 3 == i % 3));
            all += (level - whole).powi(2);
            crossed += (level - row - column + whole).powi(2);
        }
    }
    // With fewer than seven regions too few cells would remain to recognise a chessboard.
    let bare = held.iter().filter(|held| **held).count() >= 7;
    let chequered = chequered(rgb, |i| !bare || held[i]);
    let share = f64::min(crossed / f64::max(all, 1.0), chequered).sqrt();
    MOST_IF_AMBIGUOUS + (1.0 - MOST_IF_AMBIGUOUS) * ((share - WOVEN) / 0.1).clamp(0.0, 1.0)
}

/// Returns the share of the variance of nine colours that a chessboard of two colours leaves
/// unexplained. Only the tiles for which `counts` is true are used.
fn chequered(rgb: &[[f64; 3]; 9], counts: impl Fn(usize) -> bool) -> f64 {
    let (mut all, mut left) = (0.0, 0.0);
    for c in 0..3 {
        let levels = rgb.map(|p| p[c]);
        let mean = |of: &dyn Fn(usize) -> bool| {
            let some = || (0..9).filter(|&j| counts(j) && of(j));
            some().map(|j| levels[j]).sum::<f64>() / some().count() as f64
        };
        let whole = mean(&|_| true);
        for i in (0..9).filter(|&i| counts(i)) {
            all += (levels[i] - whole).powi(2);
            left += (levels[i] - mean(&|j| j % 2 == i % 2)).powi(2);
        }
    }
    left / f64::max(all, 1.0)
}

/// Limit of the square root of the share of variance that stripes or a chessboard leave
/// unexplained. At or below it a face looks like a cloth. Six colours at random places have about
/// 0.7.
const WOVEN: f64 = 0.15;

/// Computes the evidence for a cube from the form of its tiles, 0..=1. `share` is their side as a
/// share of the pitch. `fullness` is their area divided by that of the parallelogram with the same
/// second moments. Stickers cover most of the face, so their side is at least 0.7 pitches. Discs
/// have a fullness of 1.047.
pub(super) fn form(share: f64, fullness: f64) -> f64 {
    ((share - 0.5) / 0.2).clamp(0.0, 1.0) * ((1.045 - fullness) / 0.015).clamp(0.0, 1.0)
}

impl Patch {
    /// Computes how much the colours of the four lines of gaps between the nine tiles differ,
    /// 0..=1: the difference between the lines, minus the variation along a line, as a share of the
    /// difference between gaps and tiles. `h` is the homography of the face, and `rgb` are the mean
    /// colours of the tiles.
    ///
    /// The gaps of a cube have one colour, that of its body. On a checked cloth each line has its
    /// own colour. If there are no gaps, a line shows the colours of the three tiles beside it.
    pub(super) fn patchwork(&self, h: &Matrix3<f64>, rgb: &[[f64; 3]; 9]) -> f64 {
        let mean = |line: f64, cell: f64, across: bool| {
            let places = [-0.2, -0.1, 0.0, 0.1, 0.2].map(|k| cell + k);
            let at = |t: f64| apply(h, if across { (t, line) } else { (line, t) });
            let pixels: Vec<[f64; 3]> =
                places.into_iter().filter_map(|t| self.pixel(at(t))).collect();
            let n = pixels.len().max(1) as f64;
            std::array::from_fn(|c| pixels.iter().map(|p| p[c]).sum::<f64>() / n)
        };
        let lines = [(-0.5, true), (0.5, true), (-0.5, false), (0.5, false)];
        let gaps = lines.map(|(line, across)| [-1.0, 0.0, 1.0].map(|t| mean(line, t, across)));
        // Medians ignore a single place with glare or a finger.
        let middle = |of: &[[f64; 3]]| -> [f64; 3] {
            std::array::from_fn(|c| median(of.iter().map(|p| p[c]).collect()))
        };
        let apart =
            |a: &[f64; 3], b: &[f64; 3]| (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f64::max);
        let gap = middle(gaps.as_flattened());
        let own = gaps.map(|line| middle(&line));
        let between = own.iter().map(|line| apart(line, &gap)).sum::<f64>() / 4.0;
        let along =
            gaps.iter().zip(&own).flat_map(|(line, own)| line.iter().map(|g| apart(g, own)));
        let along = along.sum::<f64>() / 12.0;
        ((between - along).max(0.0) / apart(&gap, &middle(rgb)).max(1.0)).min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::homography::GRID;
    use crate::lattice::Onward;
    use crate::{Rect, testing::STICKERS};
    use image::{Rgb, RgbImage};

    /// Returns a regular lattice with tiles in the cells for which `held` is true.
    fn lattice(held: [bool; 9]) -> Lattice {
        Lattice {
            homography: Matrix3::new(20.0, 0.0, 40.0, 0.0, 20.0, 40.0, 0.0, 0.0, 1.0),
            tiles: std::array::from_fn(|i| held[i].then_some(i)),
            residual: 0.01,
            unevenness: 0.02,
            sticker: 0.8,
            beyond: 0,
            around: 16,
            onward: Onward::Ends,
        }
    }

    /// Returns a regular lattice with tiles in all cells except these.
    fn without(cells: &[usize]) -> Lattice {
        lattice(std::array::from_fn(|i| !cells.contains(&i)))
    }

    #[test]
    fn six_tiles_support_face_unless_outer_row_missing() {
        let none = [0; 9];

        // Enough tiles that agree have a support of 0.48 at least.
        assert!(support(&without(&[]), &none) > 0.99);
        assert!(support(&without(&[0, 4, 8]), &none) >= 0.48);
        assert!(support(&without(&[0, 1, 2]), &none) <= NOWHERE);
        assert!(support(&without(&[2, 5, 8]), &none) <= NOWHERE);
        let mut rough = without(&[0, 4, 8]);
        rough.unevenness = 0.2;
        assert!(support(&rough, &none) < 0.4);
    }

    #[test]
    fn four_tiles_with_enough_visible_sides_support_face() {
        let few = without(&[1, 2, 4, 5, 6]);

        assert!(support(&few, &[4, 1, 2, 4, 1, 1, 0, 4, 4]) >= 0.48);
        assert!(support(&few, &[4, 0, 0, 4, 0, 0, 0, 4, 4]) < 0.1);
        // Three of the sides that a row of background shows may belong to the next row.
        let row = without(&[0, 1, 2]);
        assert!(support(&row, &[1, 2, 1, 4, 4, 4, 4, 4, 4]) <= NOWHERE);
        assert!(support(&row, &[2, 2, 1, 4, 4, 4, 4, 4, 4]) >= 0.48);
    }

    #[test]
    fn support_grows_with_edges_seen_around_undetected_tiles() {
        let seven = without(&[0, 8]);

        let by = |n| support(&seven, &[n, 4, 4, 4, 4, 4, 4, 4, n]);

        assert!(by(1) < by(2) && by(2) < by(3) && by(3) < by(4) && by(4) < 1.0);
        assert_eq!(by(0), by(1));
    }

    #[test]
    fn discs_and_tiles_with_wide_gaps_score_low() {
        assert!(form(0.85, 1.01) > 0.99);
        assert_eq!(form(0.85, 1.047), 0.0);
        assert!(form(0.55, 1.0) < 0.3);
    }

    #[test]
    fn shades_of_one_hue_give_low_evidence() {
        let shade = |i: usize| [140.0, 95.0, 60.0].map(|c: f64| c * (0.8 + 0.04 * i as f64));

        assert!(variety(hues(&std::array::from_fn(shade))) < 0.65);
        assert!(variety(hues(&std::array::from_fn(|i| STICKERS[i % 6]))) > 0.99);
    }

    #[test]
    fn crossing_stripes_and_chessboards_give_low_evidence() {
        let stripes = [[200.0, 40.0, 30.0], [20.0, 90.0, 160.0], [90.0, 180.0, 60.0]];
        let cloth = std::array::from_fn(|i| {
            std::array::from_fn(|c| 0.5 * stripes[i % 3][c] + 0.5 * stripes[2 - i / 3][c])
        });
        let board = std::array::from_fn(|i| stripes[i % 2]);
        let face = [0, 1, 2, 3, 4, 5, 4, 1, 0].map(|c| STICKERS[c]);

        let all = [true; 9];
        assert!(
            arrangement_evidence(&cloth, &all) <= MOST_IF_AMBIGUOUS
                && arrangement_evidence(&board, &all) <= MOST_IF_AMBIGUOUS
        );
        assert!(arrangement_evidence(&face, &all) > 0.99);
        let mut one = [STICKERS[0]; 9];
        one[5] = STICKERS[1];
        assert!(arrangement_evidence(&one, &all) > 0.99);
    }

    #[test]
    fn chessboard_with_object_gives_low_evidence() {
        let mut board = std::array::from_fn(|i| STICKERS[i % 2]);
        board[2] = STICKERS[3];

        let free = std::array::from_fn(|i| i != 2);
        assert!(arrangement_evidence(&board, &free) <= MOST_IF_AMBIGUOUS);
        // If each cell has a region, the third colour is that of a tile, not of an object.
        assert!(arrangement_evidence(&board, &[true; 9]) > 0.99);
    }

    #[test]
    fn tile_gaps_of_different_colours_count_as_patchwork() {
        let gaps = [[20.0; 3], [220.0, 30.0, 30.0], [30.0, 60.0, 220.0], [230.0, 220.0, 40.0]];
        let picture = |gap: &dyn Fn(usize) -> [f64; 3]| {
            let image = RgbImage::from_fn(80, 80, |x, y| {
                let line = |v: u32| if (28..=32).contains(&v) { 1 } else { 2 };
                let on = |v: u32| (28..=32).contains(&v) || (48..=52).contains(&v);
                let pixel = match (on(x), on(y)) {
                    (true, _) => gap(line(x)),
                    (_, true) => gap(line(y) + 1),
                    _ => STICKERS[((x / 20 + 3 * (y / 20)) % 6) as usize],
                };
                Rgb(pixel.map(|v| v as u8))
            });
            let whole = Rect { x: 0, y: 0, width: 80, height: 80 };
            let patch = Patch::new(&image, whole, 1);
            let h = without(&[]).homography;
            let rgb = GRID.map(|g| patch.sample(&h, g, 0.7).rgb);
            patch.patchwork(&h, &rgb)
        };

        assert!(picture(&|_| gaps[0]) < 0.02);
        assert!(picture(&|line| gaps[line]) > 0.2);
    }
}
