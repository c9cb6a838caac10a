//! The sides of a face's tiles, by which a lattice is fitted even where fingers cover parts of its
//! tiles.
//!
//! A tile that a finger or a reflection cuts still shows some of its sides. From the middle of each
//! cell of a lattice, lines are followed outwards in four directions until the first edge. On sides
//! of tiles all lines end at the same distance from the middle of their cell. On the outline of a
//! finger or in the background they do not. The lattice is fitted to the ends that agree. The sides
//! that agree with the fitted lattice count as seen.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | side is seen | [`ENOUGH`] of the five lines of [`ALONG`] | the majority |
//! | line ends on a side | `reach`, 0.22 down to 0.08 pitches | each fit comes closer |
//! | row or column is empty | <= 3 of its 12 sides seen | the 3 sides of the row beside it |
//! | lattice a row over is better | 2 sides more | one more may be chance |
//! | too few ends | < 24 of 180 | eight unknowns, one equation for each end |
//! | fit is wrong | a corner moves 0.6 diagonals of a cell | the start is at most 0.2 pitches off |
//!
//! - in: [`Edges`], a first homography of the face, half a tile's side in pitches
//! - out: the homography that fits the sides, and which sides of the nine tiles are seen
//! - source: own work; least squares on lines by the direct linear transform (Hartley and Zisserman
//!   2004) with Tukey's weights

use super::homography::{self, GRID, Point, apply};
use super::segment::Edges;
use nalgebra::{Matrix3, SMatrix, SVector};

/// The sides of nine tiles that were seen, and the lattice fitted to them.
#[derive(Debug, Clone)]
pub(super) struct Sides {
    /// Homography from places of the face (column - 1, row - 1) to pixels.
    pub(super) homography: Matrix3<f64>,
    /// Number of sides of each tile that are seen, 0..=4.
    pub(super) seen: [u8; 9],
    /// Length of a tile's side between its edges, in pitches.
    pub(super) sticker: f64,
}

/// Offsets of the five lines of a direction from the middle of their cell, in pitches. Some lines
/// pass beside a maker's mark, and none meets a corner.
const ALONG: [f64; 5] = [-0.24, -0.12, 0.0, 0.12, 0.24];
/// Number of lines that must end on a side so that it counts as seen.
const ENOUGH: usize = 3;
/// Four directions from the middle of a cell outwards.
const DIRECTIONS: [Point; 4] = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)];

/// End of a line at the first edge.
#[derive(Debug, Clone, Copy)]
struct End {
    /// Number of the line's cell in reading order, 0..9.
    cell: usize,
    /// Index of the line's direction in [`DIRECTIONS`].
    direction: usize,
    /// Distance from the middle of the cell, in pitches.
    distance: f64,
    /// Pixel of the end.
    pixel: Point,
}

impl Sides {
    /// Returns the number of sides that are seen, over all nine tiles.
    pub(super) fn total(&self) -> u8 {
        self.seen.iter().sum()
    }

    /// Fits the homography like [`Self::fit`]. If an outer row or column then shows almost no
    /// sides, also fits the homography that is shifted away from it by one row or column, and
    /// returns that if it shows at least two more sides. `threshold` and `half` are those of
    /// [`Self::fit`].
    ///
    /// If one row of a face is hidden, `start` may have a row of background instead of it.
    pub(super) fn best(edges: &Edges, threshold: u8, start: &Matrix3<f64>, half: f64) -> Self {
        let mut best = Self::fit(edges, threshold, start, half);
        // The true face can only be shifted away from an empty row or column.
        let lacks = |line: [usize; 3]| line.iter().map(|&i| best.seen[i]).sum::<u8>() <= 3;
        let over = [
            ([0, 3, 6], (1.0, 0.0)),
            ([2, 5, 8], (-1.0, 0.0)),
            ([0, 1, 2], (0.0, 1.0)),
            ([6, 7, 8], (0.0, -1.0)),
        ];
        let shifts: Vec<Point> =
            over.into_iter().filter(|(line, _)| lacks(*line)).map(|(_, shift)| shift).collect();
        for (x, y) in shifts {
            let shift = Matrix3::new(1.0, 0.0, x, 0.0, 1.0, y, 0.0, 0.0, 1.0);
            let moved = best.homography * shift;
            if (moved[(2, 2)]).abs() > 1e-6 {
                let other =
                    Self::fit(edges, threshold, &(moved / moved[(2, 2)]), 0.5 * best.sticker);
                if other.total() >= best.total() + 2 {
                    best = other;
                }
            }
        }
        best
    }

    /// Fits the homography of a face to the sides of its nine tiles, which are edges of at least
    /// `threshold`. The first homography, `start`, may be off by up to a fifth of a pitch. `half`
    /// is half a tile's side in pitches.
    pub(super) fn fit(edges: &Edges, threshold: u8, start: &Matrix3<f64>, half: f64) -> Self {
        let mut h = *start;
        let mut half = half;
        for reach in [0.22, 0.16, 0.11, 0.08] {
            let ends = ends(edges, threshold, &h, half - reach - 0.02);
            // The width of the tiles is measured again by the ends on this cube's sides. Their
            // median ignores ends on fingers.
            let near = |end: &&End| (end.distance - half).abs() < reach;
            let mut distances: Vec<f64> = ends.iter().filter(near).map(|e| e.distance).collect();
            distances.sort_by(f64::total_cmp);
            if let Some(middle) = distances.get(distances.len() / 2) {
                half = *middle;
            }
            let Some(fitted) = solve(&ends, &h, half, reach) else { break };
            h = fitted;
        }
        let pitch = homography::smallest_pitch(&GRID.map(|g| apply(&h, g)));
        // An end counts for a tile only if it is nearer to this tile's side than to that of the
        // next tile.
        let nearer = (0.8 * (0.5 - half)).max(0.7 / pitch);
        let reach = (1.2 / pitch).clamp(0.05, 0.10).min(nearer);
        let mut counts = [[0; 4]; 9];
        for end in ends(edges, threshold, &h, half - reach - 0.03) {
            counts[end.cell][end.direction] += usize::from((end.distance - half).abs() < reach);
        }
        let seen = counts.map(|sides| sides.iter().filter(|&&n| n >= ENOUGH).count() as u8);
        Self { homography: h, seen, sticker: 2.0 * half }
    }
}

/// Follows lines outwards from the middle of each cell and returns where they meet the first edge
/// of at least `threshold`. Each line starts `from` pitches from the middle; a line that starts on
/// an edge is left out. `h` is the homography of the face.
fn ends(edges: &Edges, threshold: u8, h: &Matrix3<f64>, from: f64) -> Vec<End> {
    let strength = |p: Point| {
        let (x, y) = (p.0.round(), p.1.round());
        // Outside the picture and at its border there are no edges of tiles.
        let (right, bottom) = (edges.width as f64 - 2.0, edges.height as f64 - 2.0);
        let inside = x > 1.0 && y > 1.0 && x < right && y < bottom;
        inside.then(|| edges.strength[y as usize * edges.width + x as usize])
    };
    // Lines begin outside a maker's mark in the middle of a tile, which has edges as well.
    let from = from.max(0.12);
    let mut ends = Vec::with_capacity(180);
    for (cell, g) in GRID.into_iter().enumerate() {
        for (direction, (nx, ny)) in DIRECTIONS.into_iter().enumerate() {
            let place = |out: f64, along: f64| {
                apply(h, (g.0 + nx * out - ny * along, g.1 + ny * out + nx * along))
            };
            let pitch = homography::distance(place(0.0, 0.0), place(0.5, 0.0)) * 2.0;
            // Steps of half a pixel miss no edge.
            let step = 0.5 / pitch.max(1.0);
            for along in ALONG {
                let mut out = from;
                // The next cell begins at 0.5 pitches; 0.7 allows for the error of the start.
                while out < 0.7 {
                    let pixel = place(out, along);
                    match strength(pixel) {
                        None => break,
                        Some(s) if s >= threshold => {
                            if out > from {
                                ends.push(End { cell, direction, distance: out, pixel });
                            }
                            break;
                        }
                        Some(_) => out += step,
                    }
                }
            }
        }
    }
    ends
}

/// Computes the homography with which the sides of the tiles pass through the ends of the lines, in
/// the least-squares sense. `h` is the homography so far, and `half` is half a tile's side in
/// pitches.
///
/// An end counts less the farther it is from its side, and not at all from `reach` pitches on.
/// Returns `None` if fewer than 24 ends count, or if a corner of the face moves too far.
fn solve(ends: &[End], h: &Matrix3<f64>, half: f64, reach: f64) -> Option<Matrix3<f64>> {
    // Pixels are taken from the middle of the face, in units of a cell's diagonal, so that the
    // equations are well conditioned.
    let middle = apply(h, (0.0, 0.0));
    let scale = homography::distance(middle, apply(h, (1.0, 1.0)));
    let mut normal = SMatrix::<f64, 8, 8>::zeros();
    let mut right = SVector::<f64, 8>::zeros();
    let mut count = 0;
    for end in ends {
        let off = (end.distance - half) / reach;
        if off.abs() >= 1.0 {
            continue;
        }
        count += 1;
        let weight = (1.0 - off * off).powi(2);
        let (u, v) = ((end.pixel.0 - middle.0) / scale, (end.pixel.1 - middle.1) / scale);
        let (g, (nx, ny)) = (GRID[end.cell], DIRECTIONS[end.direction]);
        // On a side, one coordinate of the place in the face is known, for example x. With the
        // inverse homography g and g9 = 1 it is x = (g1 u + g2 v + g3) / (g7 u + g8 v + 1). Times
        // the denominator, this is linear in g.
        let (row, target) = if ny == 0.0 {
            let x = g.0 + nx * half;
            (SVector::<f64, 8>::from([u, v, 1.0, 0.0, 0.0, 0.0, -x * u, -x * v]), x)
        } else {
            let y = g.1 + ny * half;
            (SVector::<f64, 8>::from([0.0, 0.0, 0.0, u, v, 1.0, -y * u, -y * v]), y)
        };
        normal += weight * row * row.transpose();
        right += weight * row * target;
    }
    if count < 24 {
        return None;
    }
    let g = normal.cholesky()?.solve(&right);
    let inner = Matrix3::new(g[0], g[1], g[2], g[3], g[4], g[5], g[6], g[7], 1.0);
    let outer = Matrix3::new(scale, 0.0, middle.0, 0.0, scale, middle.1, 0.0, 0.0, 1.0);
    let fitted = outer * inner.try_inverse()?;
    let fitted = fitted / fitted[(2, 2)];
    let moved = |p: Point| homography::distance(apply(&fitted, p), apply(h, p)) / scale;
    homography::OUTLINE.iter().all(|c| moved(*c) < 0.6).then_some(fitted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    /// Homography of the drawn face, row by row.
    const TRUTH: [f64; 9] = [33.0, 5.0, 120.0, -4.0, 30.0, 100.0, 0.02, -0.03, 1.0];

    /// Returns the edges of a drawn face with tiles of 0.8 pitches, of which those with the numbers
    /// `hidden` are left out, and the homography of the face.
    fn edges(hidden: &[usize]) -> (Edges, Matrix3<f64>) {
        let truth = Matrix3::from_row_slice(&TRUTH);
        let inverse = truth.try_inverse().unwrap();
        let mut rgb = Vec::new();
        for (y, x) in (0..200).flat_map(|y| (0..240).map(move |x| (y, x))) {
            let (u, v) = apply(&inverse, (f64::from(x), f64::from(y)));
            let (a, b) = (u.round(), v.round());
            let cell = (a.abs() <= 1.0 && b.abs() <= 1.0).then_some((3.0 * b + a + 4.0) as usize);
            let on = (u - a).abs().max((v - b).abs()) < 0.4;
            let tile = cell.is_some_and(|cell| on && !hidden.contains(&cell));
            rgb.extend(if tile { [210, 60, 40] } else { [20, 20, 20] });
        }
        (Edges::new(&rgb, 240, 200), truth)
    }

    /// Returns the greatest distance between the corners of a face under two homographies (px).
    fn apart(a: &Matrix3<f64>, b: &Matrix3<f64>) -> f64 {
        let at = |g: &Point| homography::distance(apply(a, *g), apply(b, *g));
        homography::OUTLINE.iter().map(at).fold(0.0, f64::max)
    }

    #[test]
    fn fit_to_six_tiles_corrects_inexact_lattice() {
        let (edges, truth) = edges(&[1, 4, 6]);
        // The first homography is shifted and too narrow.
        let mut crooked = truth;
        crooked[(0, 2)] += 4.0;
        crooked[(0, 0)] *= 0.95;

        let sides = Sides::fit(&edges, 30, &crooked, 0.37);

        assert!(apart(&crooked, &truth) > 4.0);
        assert!(apart(&sides.homography, &truth) < 1.5, "{}", apart(&sides.homography, &truth));
        assert_eq!(sides.seen, [4, 0, 4, 4, 0, 4, 0, 4, 4]);
    }

    /// A lattice one row too low, whose last row is background, is moved up.
    #[test]
    fn lattice_moves_away_from_empty_row() {
        let (edges, truth) = edges(&[0]);
        let below = truth * Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0);

        let stays = Sides::fit(&edges, 30, &below, 0.38);
        let moved = Sides::best(&edges, 30, &below, 0.38);

        // Six of the nine tiles with four sides each, then the eight that are there.
        assert_eq!((stays.total(), moved.total()), (24, 32));
        assert!(apart(&moved.homography, &truth) < 1.5);
    }

    #[test]
    fn border_of_picture_is_no_side_of_tile() {
        let edges = Edges::new(&[90; 3 * 60 * 60], 60, 60);
        let h = Matrix3::new(25.0, 0.0, 30.0, 0.0, 25.0, 30.0, 0.0, 0.0, 1.0);

        assert_eq!(Sides::fit(&edges, 30, &h, 0.4).total(), 0);
    }
}
