//! Curves in several dimensions that are polynomials piece by piece.
//!
//! - in: points, and what happens at the inner ones: a spline, or rounded corners
//! - out: a curve through or past the points, twice continuously differentiable
//! - spline: cubic, with second derivatives of zero at both ends (natural)
//! - corner: the derivative changes from the slope of one leg to that of the next as
//!   `3 x^2 - 2 x^3` over a stretch that is symmetric about the corner. By this symmetry it
//!   ends on the next leg

/// Number of coefficients of a piece.
const TERMS: usize = 5;
/// Number of cells of a piece.
const CELLS: u32 = 24;

/// One piece: the sum of `c[i] x^i`, with x from 0 to `length`.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Piece<const D: usize> {
    length: f64,
    c: [[f64; D]; TERMS],
}

/// A curve of polynomials.
#[derive(Debug, Clone, PartialEq)]
pub struct Polynomial<const D: usize> {
    pieces: Vec<Piece<D>>,
}

impl<const D: usize> Piece<D> {
    /// Returns a derivative (`order` 0 to 4) at `x`.
    fn at(&self, order: usize, x: f64) -> [f64; D] {
        std::array::from_fn(|d| {
            // Horner's rule, each term with the factor of its derivative.
            (order..TERMS).rev().fold(0.0, |sum, i| {
                let factor: usize = (i + 1 - order..=i).product();
                sum * x + factor as f64 * self.c[i][d]
            })
        })
    }
}

impl<const D: usize> Polynomial<D> {
    /// Makes the natural cubic spline through these points, which are `lengths` apart in the
    /// parameter. There are as many lengths as pairs of neighbours, all of them above 0.
    #[must_use]
    pub fn spline(points: &[[f64; D]], lengths: &[f64]) -> Self {
        let bends = second_derivatives(points, lengths);
        let pieces = lengths.iter().enumerate().map(|(i, &length)| {
            let mut c = [[0.0; D]; TERMS];
            for d in 0..D {
                let (from, to) = (bends[i][d], bends[i + 1][d]);
                let slope = (points[i + 1][d] - points[i][d]) / length;
                c[0][d] = points[i][d];
                c[1][d] = slope - length * (2.0 * from + to) / 6.0;
                c[2][d] = 0.5 * from;
                c[3][d] = (to - from) / (6.0 * length);
            }
            Piece { length, c }
        });
        Self { pieces: pieces.collect() }
    }

    /// Makes the polyline through these points, as [`Polynomial::spline`], with corners that are
    /// rounded from `reach` before a point to `reach` after it. `reach` is an entry a corner, and
    /// at most half of the length on either side.
    pub(super) fn rounded(points: &[[f64; D]], lengths: &[f64], reach: &[f64]) -> Self {
        let slope = |leg: usize| -> [f64; D] {
            std::array::from_fn(|d| (points[leg + 1][d] - points[leg][d]) / lengths[leg])
        };
        let reach_at = |corner: usize| {
            corner.checked_sub(1).and_then(|inner| reach.get(inner)).copied().unwrap_or(0.0)
        };
        let mut pieces = Vec::new();
        for leg in 0..lengths.len() {
            let (begin, end) = (reach_at(leg), reach_at(leg + 1));
            let along = slope(leg);
            let from = |u: f64| std::array::from_fn(|d| points[leg][d] + u * along[d]);
            let straight = lengths[leg] - begin - end;
            if straight > 0.0 {
                let mut c = [[0.0; D]; TERMS];
                (c[0], c[1]) = (from(begin), along);
                pieces.push(Piece { length: straight, c });
            }
            if end > 0.0 {
                let (next, whole) = (slope(leg + 1), 2.0 * end);
                let mut c = [[0.0; D]; TERMS];
                (c[0], c[1]) = (from(lengths[leg] - end), along);
                for d in 0..D {
                    let change = next[d] - along[d];
                    // The integral of change (3 x^2 - 2 x^3) over the stretch of both sides.
                    c[3][d] = change / (whole * whole);
                    c[4][d] = -0.5 * change / whole.powi(3);
                }
                pieces.push(Piece { length: whole, c });
            }
        }
        Self { pieces }
    }

    /// Returns the point at the parameter `u`.
    #[must_use]
    pub fn at(&self, u: f64) -> [f64; D] {
        let mut left = u.max(0.0);
        for (i, piece) in self.pieces.iter().enumerate() {
            if left <= piece.length || i + 1 == self.pieces.len() {
                return piece.at(0, left.min(piece.length));
            }
            left -= piece.length;
        }
        [0.0; D]
    }

    /// Returns the point at a share (0 to 1) of a piece, without the search of [`Polynomial::at`].
    #[must_use]
    pub fn within(&self, piece: usize, share: f64) -> [f64; D] {
        self.pieces.get(piece).map_or([0.0; D], |piece| piece.at(0, share * piece.length))
    }

    /// Returns the lengths of the cells, each with the bounds of the first three derivatives. The
    /// function `norm` measures a part of the dimensions, and each of `norms` gives a bound.
    ///
    /// The norm of a linear function is largest at an end of the cell. One that is not linear
    /// exceeds its ends by at most an eighth of its second derivative times the square of the
    /// length.
    pub(super) fn cells<const N: usize>(
        &self,
        norms: impl Fn(&[f64; D]) -> [f64; N],
    ) -> Vec<(f64, [[f64; 3]; N])> {
        let mut cells = Vec::new();
        for piece in &self.pieces {
            let h = piece.length / f64::from(CELLS);
            for cell in 0..CELLS {
                let ends = [f64::from(cell) * h, f64::from(cell + 1) * h];
                let most = |order: usize| -> [f64; N] {
                    let [a, b] = ends.map(|x| norms(&piece.at(order, x)));
                    std::array::from_fn(|n| a[n].max(b[n]))
                };
                let [first, second, third, fourth] = [1, 2, 3, 4].map(most);
                let bounds = std::array::from_fn(|n| {
                    [
                        first[n] + h * h / 8.0 * third[n],
                        second[n] + h * h / 8.0 * fourth[n],
                        third[n],
                    ]
                });
                cells.push((h, bounds));
            }
        }
        cells
    }
}

/// Returns the second derivatives of the natural cubic spline at its points, by the elimination of
/// its tridiagonal equations (Thomas).
fn second_derivatives<const D: usize>(points: &[[f64; D]], h: &[f64]) -> Vec<[f64; D]> {
    let n = points.len();
    let mut bends = vec![[0.0; D]; n];
    // Upper diagonal after the elimination.
    let mut upper = vec![0.0; n];
    for i in 1..n.saturating_sub(1) {
        let pivot = 2.0 * (h[i - 1] + h[i]) - h[i - 1] * upper[i - 1];
        upper[i] = h[i] / pivot;
        for d in 0..D {
            let before = (points[i][d] - points[i - 1][d]) / h[i - 1];
            let after = (points[i + 1][d] - points[i][d]) / h[i];
            bends[i][d] = (6.0 * (after - before) - h[i - 1] * bends[i - 1][d]) / pivot;
        }
    }
    for i in (1..n.saturating_sub(1)).rev() {
        let next = bends[i + 1];
        for (bend, next) in bends[i].iter_mut().zip(next) {
            *bend -= upper[i] * next;
        }
    }
    bends
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Returns the derivative of this order at the end of each piece and at the beginning of the
    /// next.
    fn joints<const D: usize>(curve: &Polynomial<D>, order: usize) -> Vec<([f64; D], [f64; D])> {
        let pairs = curve.pieces.windows(2);
        pairs.map(|p| (p[0].at(order, p[0].length), p[1].at(order, 0.0))).collect()
    }

    proptest! {
        #[test]
        fn pieces_join_with_two_continuous_derivatives(
            points in prop::collection::vec(prop::array::uniform2(-1.0..1.0f64), 3..7),
            lengths in prop::collection::vec(0.2..1.0f64, 6),
            share in 0.01..0.5f64,
        ) {
            let lengths = &lengths[..points.len() - 1];
            let reach: Vec<f64> =
                lengths.windows(2).map(|pair| share * pair[0].min(pair[1])).collect();
            let spline = Polynomial::spline(&points, lengths);
            let rounded = Polynomial::rounded(&points, lengths, &reach);
            for curve in [&spline, &rounded] {
                for order in 0..3 {
                    for (before, after) in joints(curve, order) {
                        for d in 0..2 {
                            let scale = 1.0 + before[d].abs();
                            prop_assert!((before[d] - after[d]).abs() < 1e-9 * scale / share);
                        }
                    }
                }
                // The bounds hold between the ends of the cells.
                let mut begin = 0.0;
                for (length, [bounds]) in curve.cells(|d| [d[0].hypot(d[1])]) {
                    let e = 1e-5;
                    for part in [0.3, 0.5, 0.7] {
                        let at = begin + part * length;
                        let [a, b] = [curve.at(at - e), curve.at(at + e)];
                        let speed = (b[0] - a[0]).hypot(b[1] - a[1]) / (2.0 * e);
                        prop_assert!(speed < bounds[0] + 1e-3, "{} {:?}", speed, bounds);
                    }
                    begin += length;
                }
            }
            // The spline passes its points, and both reach the last one.
            let whole: f64 = lengths.iter().sum();
            let (mut u, last) = (0.0, points[points.len() - 1]);
            for (point, length) in points.iter().zip(lengths) {
                let at = spline.at(u);
                prop_assert!((at[0] - point[0]).hypot(at[1] - point[1]) < 1e-9);
                u += length;
            }
            for at in [spline.at(whole), rounded.at(whole)] {
                prop_assert!((at[0] - last[0]).hypot(at[1] - last[1]) < 1e-9);
            }
        }
    }
}
