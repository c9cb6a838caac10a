//! Least-squares homographies from one plane to another, fitted to a few points.
//!
//! - in: pairs of points, each a point of a model plane and its image
//! - out: the 3x3 matrix that maps points of the model plane to the image
//! - source: Hartley and Zisserman, Multiple View Geometry (2004), ch. 4 (direct linear transform)

use nalgebra::{Matrix3, SMatrix, SVector};

/// Point of a plane.
pub type Point = (f64, f64);

/// Model coordinates of the centres of a face's nine tiles in reading order, in pitches from the
/// face's centre: (column - 1, row - 1).
pub const GRID: [Point; 9] = [
    (-1.0, -1.0),
    (0.0, -1.0),
    (1.0, -1.0),
    (-1.0, 0.0),
    (0.0, 0.0),
    (1.0, 0.0),
    (-1.0, 1.0),
    (0.0, 1.0),
    (1.0, 1.0),
];

/// Model coordinates of the corners of a face's outline, in pitches from its centre: top left, top
/// right, bottom right, bottom left.
pub const OUTLINE: [Point; 4] = [(-1.5, -1.5), (1.5, -1.5), (1.5, 1.5), (-1.5, 1.5)];

/// Maps a point by a homography. The result is not finite if the point lies on the horizon.
#[must_use]
pub fn apply(h: &Matrix3<f64>, p: Point) -> Point {
    let w = h[(2, 0)] * p.0 + h[(2, 1)] * p.1 + h[(2, 2)];
    (
        (h[(0, 0)] * p.0 + h[(0, 1)] * p.1 + h[(0, 2)]) / w,
        (h[(1, 0)] * p.0 + h[(1, 1)] * p.1 + h[(1, 2)]) / w,
    )
}

/// Fits the homography that maps model points to image points in the least-squares sense. Each pair
/// is a model point and its image.
///
/// The model's origin must have a finite image. Fewer than six pairs give an affine map, which is
/// less sensitive to errors. Returns `None` for fewer than three pairs, or if the points are
/// degenerate (all near one line).
///
/// ```
/// use rubik_robot_vision::homography::{GRID, apply, distance, fit};
///
/// // A picture of the nine tiles of a face, seen from one side: the right column is farther away.
/// let seen = |(x, y): (f64, f64)| {
///     let scale = 30.0 / (1.0 + 0.1 * x);
///     (200.0 + scale * x, 100.0 + scale * y)
/// };
/// let pairs = GRID.map(|tile| (tile, seen(tile)));
/// let h = fit(&pairs).ok_or("degenerate")?;
/// assert!(distance(apply(&h, (1.5, 1.5)), seen((1.5, 1.5))) < 1e-6);
/// # Ok::<(), &str>(())
/// ```
#[must_use]
pub fn fit(pairs: &[(Point, Point)]) -> Option<Matrix3<f64>> {
    if pairs.len() < 3 {
        return None;
    }
    // Image points are centred and scaled to a size of about 1 (Hartley), since pixels in the
    // hundreds would make the normal equations ill-conditioned. Model points are of that size
    // already.
    let n = pairs.len() as f64;
    let mean = pairs.iter().fold((0.0, 0.0), |m, (_, q)| (m.0 + q.0 / n, m.1 + q.1 / n));
    let scale =
        (pairs.iter().map(|(_, q)| (q.0 - mean.0).powi(2) + (q.1 - mean.1).powi(2)).sum::<f64>()
            / n)
            .sqrt()
            .max(1e-9);
    // Four pairs determine a homography, but with so few of them small errors make its last row,
    // the perspective, very inexact.
    let affine = pairs.len() < 6;

    let mut normal = SMatrix::<f64, 8, 8>::zeros();
    let mut right = SVector::<f64, 8>::zeros();
    // With h33 = 1 each pair gives two linear equations in the other eight elements. The origin
    // then maps to w = 1, so its image must be finite.
    for &((x, y), q) in pairs {
        let (u, v) = ((q.0 - mean.0) / scale, (q.1 - mean.1) / scale);
        let (px, py) = if affine { (0.0, 0.0) } else { (x, y) };
        let rows = [
            (SVector::<f64, 8>::from([x, y, 1.0, 0.0, 0.0, 0.0, -u * px, -u * py]), u),
            (SVector::<f64, 8>::from([0.0, 0.0, 0.0, x, y, 1.0, -v * px, -v * py]), v),
        ];
        for (row, value) in rows {
            normal += row * row.transpose();
            right += row * value;
        }
    }
    // The last row of an affine map is 0 0 1. The equations h31 = h32 = 0 keep the matrix regular.
    if affine {
        normal[(6, 6)] = 1.0;
        normal[(7, 7)] = 1.0;
    }
    let h = normal.cholesky()?.solve(&right);
    let inner = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0);
    let outer = Matrix3::new(scale, 0.0, mean.0, 0.0, scale, mean.1, 0.0, 0.0, 1.0);
    Some(outer * inner)
}

/// Computes the homography that maps the corners of the unit square, (0, 0), (1, 0), (1, 1) and
/// (0, 1), to four points.
///
/// Four pairs determine it exactly, but [`fit`] makes only an affine map of so few. Returns `None`
/// if the last three points are on one line.
pub(super) fn square_to(corners: &[Point; 4]) -> Option<Matrix3<f64>> {
    let (a, b, c, d) = (corners[0], corners[1], corners[2], corners[3]);
    let (dx1, dx2, sx) = (b.0 - c.0, d.0 - c.0, a.0 - b.0 + c.0 - d.0);
    let (dy1, dy2, sy) = (b.1 - c.1, d.1 - c.1, a.1 - b.1 + c.1 - d.1);
    let det = dx1 * dy2 - dx2 * dy1;
    if det.abs() < 1e-12 {
        return None;
    }
    let (g, h) = ((sx * dy2 - dx2 * sy) / det, (dx1 * sy - sx * dy1) / det);
    Some(Matrix3::new(
        b.0 - a.0 + g * b.0,
        d.0 - a.0 + h * d.0,
        a.0,
        b.1 - a.1 + g * b.1,
        d.1 - a.1 + h * d.1,
        a.1,
        g,
        h,
        1.0,
    ))
}

/// Returns the distance between two points.
#[must_use]
pub fn distance(a: Point, b: Point) -> f64 {
    (a.0 - b.0).hypot(a.1 - b.1)
}

/// Returns the shortest distance between neighbouring tile centres in the image (px). The centres
/// are in reading order.
#[must_use]
pub fn smallest_pitch(centres: &[Point; 9]) -> f64 {
    let mut pitch = f64::INFINITY;
    for row in 0..3 {
        for column in 0..3 {
            let i = 3 * row + column;
            if column < 2 {
                pitch = pitch.min(distance(centres[i], centres[i + 1]));
            }
            if row < 2 {
                pitch = pitch.min(distance(centres[i], centres[i + 3]));
            }
        }
    }
    pitch
}

/// Computes the area of a polygon and its centroid. The area is positive if the corners run
/// clockwise on the screen (y down). The centroid of a polygon without area is not finite.
///
/// ```
/// use rubik_robot_vision::homography::polygon;
///
/// // Clockwise on the screen, where y points downwards.
/// let (area, centre) = polygon(&[(10.0, 10.0), (30.0, 10.0), (30.0, 20.0), (10.0, 20.0)]);
/// assert_eq!((area, centre), (200.0, (20.0, 15.0)));
/// ```
///
/// # Panics
/// If there are no corners.
#[must_use]
pub fn polygon(corners: &[Point]) -> (f64, Point) {
    // Coordinates are taken from a corner, since the difference of products of large ones would
    // lose digits.
    let origin = corners[0];
    let (mut area, mut cx, mut cy) = (0.0, 0.0, 0.0);
    for i in 0..corners.len() {
        let a = (corners[i].0 - origin.0, corners[i].1 - origin.1);
        let next = corners[(i + 1) % corners.len()];
        let b = (next.0 - origin.0, next.1 - origin.1);
        let cross = a.0 * b.1 - b.0 * a.1;
        area += cross;
        cx += (a.0 + b.0) * cross;
        cy += (a.1 + b.1) * cross;
    }
    (area / 2.0, (origin.0 + cx / (3.0 * area), origin.1 + cy / (3.0 * area)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fit_recovers_homography_of_nine_exact_points() {
        let truth = Matrix3::new(40.0, 5.0, 310.0, -3.0, 35.0, 200.0, 0.02, -0.04, 1.0);
        let pairs: Vec<_> = GRID.iter().map(|&g| (g, apply(&truth, g))).collect();

        let found = fit(&pairs).unwrap();

        for g in OUTLINE {
            assert!(distance(apply(&found, g), apply(&truth, g)) < 1e-7);
        }
    }

    #[test]
    fn square_has_expected_area_and_centroid() {
        let (area, centre) = polygon(&[(1.0, 1.0), (3.0, 1.0), (3.0, 3.0), (1.0, 3.0)]);

        assert!((area - 4.0).abs() < 1e-12);
        assert!(distance(centre, (2.0, 2.0)) < 1e-12);
    }
}
