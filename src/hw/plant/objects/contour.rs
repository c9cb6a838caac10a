//! Curved upper side of a surface: a smooth curve along x, the same across the width.
//!
//! - in: a profile, and the generator of its seed
//! - out: height, slope, nearest point, and the length of the curve
//! - drawn: a sum of four sines whose wavelengths are 0.75 to 1.5 of the given one, so that the
//!   curve never repeats and stays within its amplitude
//! - points: a cubic through all of them; its slope at a point is that of the line between its
//!   neighbours

use super::spec::Profile;
use rand::Rng;
use rand_pcg::Pcg64;
use std::f64::consts::TAU;

/// Number of sines of a drawn curve.
const WAVES: usize = 4;
/// Length of a section, along x, by which the covered part of a curve is counted (m).
pub(super) const SECTION: f64 = 5e-4;
/// Rounds of the search for the nearest point: each divides the error by ten or more where the
/// curve bends less than the distance to it.
const ROUNDS: usize = 8;

/// Curve with its ends.
#[derive(Debug, Clone)]
pub(super) struct Contour {
    /// Half the length along x (m).
    half: f64,
    /// Sines: amplitude (m), angular frequency (rad/m), phase (rad).
    waves: Vec<[f64; 3]>,
    /// Points of a cubic: place, height (m), slope.
    points: Vec<[f64; 3]>,
    /// Length of the curve in each section along x (m).
    pub(super) sections: Vec<f64>,
}

impl Contour {
    /// Makes the curve of a profile over `length` (m) along x, centred on 0.
    pub(super) fn new(profile: &Profile, length: f64, random: &mut Pcg64) -> Self {
        let mut this = Self {
            half: 0.5 * length,
            waves: Vec::new(),
            points: Vec::new(),
            sections: Vec::new(),
        };
        match profile {
            Profile::Drawn { amplitude, wavelength } => {
                let drawn: [[f64; 3]; WAVES] = std::array::from_fn(|_| {
                    [
                        random.random_range(0.5..1.0),
                        TAU / (wavelength * random.random_range(0.75..1.5)),
                        random.random_range(0.0..TAU),
                    ]
                });
                let sum: f64 = drawn.iter().map(|wave| wave[0]).sum();
                this.waves = drawn.iter().map(|[a, k, p]| [a * amplitude / sum, *k, *p]).collect();
            }
            Profile::Points(points) => this.points = with_slopes(points),
        }
        let count = (length / SECTION).ceil().max(1.0) as usize;
        let place = |i: usize| -this.half + length * i as f64 / count as f64;
        this.sections = (0..count)
            .map(|i| (place(i + 1) - place(i)).hypot(this.at(place(i + 1)).0 - this.at(place(i)).0))
            .collect();
        this
    }

    /// Returns height (m) and slope of the curve at `x` (m).
    pub(super) fn at(&self, x: f64) -> (f64, f64) {
        let mut sum = (0.0, 0.0);
        for [amplitude, k, phase] in &self.waves {
            let (sine, cosine) = libm::sincos(k * x + phase);
            sum.0 += amplitude * sine;
            sum.1 += amplitude * k * cosine;
        }
        let (Some(first), Some(last)) = (self.points.first(), self.points.last()) else {
            return sum;
        };
        // Beyond its points the curve goes on straight.
        for end in [first, last] {
            if (end == first && x <= end[0]) || (end == last && x >= end[0]) {
                return (end[1] + end[2] * (x - end[0]), end[2]);
            }
        }
        let after = self.points.partition_point(|p| p[0] <= x).clamp(1, self.points.len() - 1);
        hermite(&self.points[after - 1], &self.points[after], x)
    }

    /// Returns the place along x of the point of the curve that is nearest to (x, z) (m).
    pub(super) fn nearest(&self, x: f64, z: f64) -> f64 {
        let mut s = x;
        for _ in 0..ROUNDS {
            let (height, slope) = self.at(s);
            // The tangent at s meets the perpendicular from the point.
            s -= ((s - x) + (height - z) * slope) / (1.0 + slope * slope);
        }
        s.clamp(-self.half, self.half)
    }

    /// Returns the number of the section at `x` (m).
    pub(super) fn section(&self, x: f64) -> usize {
        let share = (x + self.half) / (2.0 * self.half) * self.sections.len() as f64;
        (share.max(0.0) as usize).min(self.sections.len() - 1)
    }

    /// Returns half the length along x (m).
    pub(super) fn half(&self) -> f64 {
        self.half
    }
}

/// Returns the points with the slope of a smooth curve at each.
fn with_slopes(points: &[[f64; 2]]) -> Vec<[f64; 3]> {
    let last = points.len().saturating_sub(1);
    let slope = |i: usize| {
        let (a, b) = (points[i.saturating_sub(1)], points[(i + 1).min(last)]);
        if b[0] > a[0] { (b[1] - a[1]) / (b[0] - a[0]) } else { 0.0 }
    };
    points.iter().enumerate().map(|(i, [x, z])| [*x, *z, slope(i)]).collect()
}

/// Returns height and slope at `x` of the cubic between two points with slopes.
fn hermite(from: &[f64; 3], to: &[f64; 3], x: f64) -> (f64, f64) {
    let long = to[0] - from[0];
    let t = (x - from[0]) / long;
    let (rise, m0, m1) = (to[1] - from[1], from[2] * long, to[2] * long);
    let (b, c) = (3.0 * rise - 2.0 * m0 - m1, m0 + m1 - 2.0 * rise);
    (from[1] + t * (m0 + t * (b + t * c)), (m0 + t * (2.0 * b + 3.0 * t * c)) / long)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the random generator of these tests.
    fn random() -> Pcg64 {
        Pcg64::new(7, 1)
    }

    #[test]
    fn slope_equals_difference_of_heights() {
        let drawn = Profile::Drawn { amplitude: 0.01, wavelength: 0.1 };
        let points = Profile::Points(vec![[-0.1, 0.0], [0.0, 0.02], [0.05, 0.01], [0.1, 0.0]]);
        for profile in [drawn, points] {
            let contour = Contour::new(&profile, 0.3, &mut random());
            for i in -140..140 {
                let x = 1e-3 * f64::from(i) + 3e-4;
                let rise = (contour.at(x + 1e-6).0 - contour.at(x - 1e-6).0) / 2e-6;
                assert!((contour.at(x).1 - rise).abs() < 1e-5, "{profile:?} at {x}: {rise}");
            }
        }
    }

    #[test]
    fn curve_passes_its_points_and_keeps_its_amplitude() {
        let points = vec![[-0.1, 0.0], [0.02, 0.02], [0.1, -0.01]];
        let contour = Contour::new(&Profile::Points(points.clone()), 0.3, &mut random());
        for [x, z] in points {
            assert!((contour.at(x).0 - z).abs() < 1e-12);
        }
        let drawn = Profile::Drawn { amplitude: 0.01, wavelength: 0.1 };
        let contour = Contour::new(&drawn, 0.3, &mut random());
        let heights: Vec<f64> = (-150..150).map(|i| contour.at(1e-3 * f64::from(i)).0).collect();
        assert!(heights.iter().all(|h| h.abs() <= 0.01));
        assert!(heights.iter().any(|h| h.abs() > 0.003), "it is no straight line");
    }

    #[test]
    fn nearest_point_lies_on_perpendicular() {
        let drawn = Profile::Drawn { amplitude: 0.01, wavelength: 0.12 };
        let contour = Contour::new(&drawn, 0.3, &mut random());
        for i in -100..100 {
            let (x, z) = (1e-3 * f64::from(i), 0.014);
            let s = contour.nearest(x, z);
            let (height, slope) = contour.at(s);
            let along = (x - s) + (z - height) * slope;
            assert!(along.abs() < 1e-6, "{x}: {along}");
        }
    }
}
