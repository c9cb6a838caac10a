//! Distances of two ways whose places are matched in order.
//!
//! - in: places of two ways (m)
//! - out: the greatest distance of matched places, for the best matching in which both go forwards
//! - source: Eiter and Mannila (1994), Computing discrete Fréchet distance

use super::way::{distance, length};
use nalgebra::Vector3;

/// Distance between two neighbouring places of a sampled way (m).
const STEP: f64 = 5e-4;
/// Most places of a sampled way: a longer one has a greater step.
const MOST: f64 = 4000.0;

/// Returns the greatest distance of two ways in order (m). `off` is the one regardless of order,
/// and the result if the order agrees within `within`; samples would make it less exact.
#[must_use]
pub(super) fn greatest(a: &[Vector3<f64>], b: &[Vector3<f64>], off: f64, within: f64) -> f64 {
    if off > within {
        return off;
    }
    let step = (length(a).max(length(b)) / MOST).max(STEP);
    let ordered = frechet(&sampled(a, step), &sampled(b, step));
    if ordered > within + step { ordered } else { off }
}

/// Returns the greatest distance at which a way passes `points` in their order (m).
#[must_use]
pub(super) fn passes(points: &[Vector3<f64>], way: &[Vector3<f64>]) -> f64 {
    let legs = way.len().saturating_sub(1).max(1);
    // Entry j: the points until now are passed before the end of leg j.
    let mut best = vec![0.0; legs];
    for point in points {
        let mut least = f64::INFINITY;
        for (j, best) in best.iter_mut().enumerate() {
            let leg = way.get(j..way.len().min(j + 2)).unwrap_or_default();
            least = least.min(distance(point, leg).max(*best));
            *best = least;
        }
    }
    best.last().copied().unwrap_or(f64::INFINITY)
}

/// Returns the discrete Fréchet distance of two ways (m).
fn frechet(a: &[Vector3<f64>], b: &[Vector3<f64>]) -> f64 {
    let mut row: Vec<f64> = Vec::new();
    for (i, from) in a.iter().enumerate() {
        let (mut left, mut corner) = (f64::INFINITY, f64::INFINITY);
        let mut next = Vec::with_capacity(b.len());
        for (j, to) in b.iter().enumerate() {
            let above = row.get(j).copied().unwrap_or(f64::INFINITY);
            let before = if i + j == 0 { 0.0 } else { above.min(left).min(corner) };
            left = before.max((from - to).norm());
            corner = above;
            next.push(left);
        }
        row = next;
    }
    row.last().copied().unwrap_or(f64::INFINITY)
}

/// Returns places of a way with this step, and its end.
fn sampled(way: &[Vector3<f64>], step: f64) -> Vec<Vector3<f64>> {
    let mut samples: Vec<Vector3<f64>> = Vec::new();
    let mut left = 0.0;
    for pair in way.windows(2) {
        let leg = (pair[1] - pair[0]).norm();
        while left < leg {
            samples.push(pair[0].lerp(&pair[1], left / leg));
            left += step;
        }
        left -= leg;
    }
    samples.extend(way.last());
    samples
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn order_of_places_counts() {
        let at = |x: f64, y: f64| Vector3::new(x, y, 0.0);
        let there = [at(0.0, 0.0), at(0.1, 0.0)];
        let aside = [at(0.0, 0.002), at(0.03, 0.002), at(0.1, 0.002)];
        let back = [at(0.1, 0.0), at(0.0, 0.0)];
        let both = [at(0.0, 0.0), at(0.1, 0.0), at(0.0, 0.0)];

        assert_eq!(greatest(&there, &aside, 0.002, 0.003), 0.002);
        assert!(greatest(&there, &back, 0.0, 0.003) > 0.099);
        assert!(greatest(&both, &there, 0.0, 0.003) > 0.049);
        let finely = |way: &[Vector3<f64>]| sampled(way, STEP);
        assert!(passes(&both, &finely(&both)) < 1e-3);
        // All three points are passed half way, since the way does not come back.
        assert!(passes(&both, &finely(&there)) > 0.049);
        assert!((passes(&[at(0.05, 0.01)], &there) - 0.01).abs() < 1e-12);
    }
}
