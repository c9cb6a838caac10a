//! What six colours look like on one cube: classes with a common spread, under a light that differs from face to face.
//!
//! Beside noise, which is alike in all classes, a facelet may lie more or less towards the light: that moves it along the
//! ray from black through its class, bright classes farther than dark ones. So does a camera that exposes anew for each
//! face: there it is all nine facelets, by one gain.
//!
//! Sorting and learning in turns ends in the optimum that is nearest to where it began: a face in another light may pass
//! for a face of other colours. So it begins at several places, and what each end explains is told by [`Model::cost`].
//!
//! - in: mean RGB of 54 facelets, and which class each one is taken for
//! - out: [`Model`]; squared distances of each facelet from each class
//! - source: own work; Mahalanobis (1936), with one factor a class

use super::colours::{Light, lab, to_linear};
use super::likeliest::{CENTRES, cheapest_pieces};
use nalgebra::{Matrix3, Vector3};

pub(super) type Points = [Vector3<f64>; 54];

/// Weight of lightness against a* and b*: shading changes it most.
const LIGHTNESS: f64 = 0.4;

/// Cost of a facelet that is nothing like its class: a reflection, a finger. In -2 log likelihood.
const OUTLIER: f64 = 50.0;

/// How strongly a face's own shift is held to nought, in facelets.
const SHIFT_PRIOR: f64 = 4.0;

/// Facelets' worth of belief in a spread of [`SPREAD`] units.
const SPREAD_PRIOR: f64 = 8.0;
const SPREAD: f64 = 3.0;
/// The same for the shading.
const SHADING: f64 = 0.04;

/// Standard deviation of a face's gain, relative, in cube roots of light: a third of a stop up or down.
const GAIN: f64 = 0.1;

/// Shading with which the sorting also begins: brightness tells next to nothing, as long as no face's gain is known.
const ANY_SHADING: f64 = 1.0;

/// A gain beyond this is none.
const MOST_GAIN: f64 = 0.5;

/// From where cube roots of light scale: L* + 16, a* and b* do.
const BLACK: Vector3<f64> = Vector3::new(LIGHTNESS * 16.0, 0.0, 0.0);

/// What a rig is known to do to its facelets.
#[derive(Debug, Clone, Copy)]
pub(super) struct Expected {
    /// Mean of each class.
    pub(super) means: [Vector3<f64>; 6],
    /// What its reflections add to each facelet.
    pub(super) shifts: [Vector3<f64>; 54],
    /// Variance of each facelet against the common one.
    pub(super) variances: [f64; 54],
    /// Inverse of the common covariance.
    pub(super) precision: Matrix3<f64>,
}

/// Six classes with one spread, and what the light adds on each face.
#[derive(Debug, Clone)]
pub(super) struct Model {
    /// What was learned before, and how far it is believed, in facelets of a colour.
    expected: Expected,
    belief: f64,
    means: [Vector3<f64>; 6],
    /// Inverse of the common covariance.
    precision: Matrix3<f64>,
    /// Shift of all nine facelets of each face: haze, reflections.
    shifts: [Vector3<f64>; 6],
    /// How much brighter each face is exposed, relative, in cube roots of light.
    gains: [f64; 6],
    /// Standard deviation of the shading from facelet to facelet, relative, in cube roots of light.
    shading: f64,
}

impl Model {
    /// Nothing known but the centres.
    pub(super) fn of_centres(points: &Points) -> Self {
        let expected = Expected {
            means: CENTRES.map(|c| points[c]),
            shifts: [Vector3::zeros(); 54],
            variances: [1.0; 54],
            precision: Matrix3::identity() / 100.0,
        };
        Self::of(expected, 0.0)
    }

    pub(super) fn of(expected: Expected, belief: f64) -> Self {
        let (means, precision) = (expected.means, expected.precision);
        let shifts = [Vector3::zeros(); 6];
        Self { expected, belief, means, precision, shifts, gains: [0.0; 6], shading: SHADING }
    }

    /// The same, where the brightness of a facelet counts for little.
    pub(super) fn by_hue(self) -> Self {
        Self { shading: ANY_SHADING, precision: self.precision * 4.0, ..self }
    }

    /// Lets means, light, spread and facelets take turns; also what the facelets were taken for in the end.
    pub(super) fn settle(mut self, points: &Points) -> (Self, [u8; 54]) {
        let mut facelets = [0u8; 54];
        for round in 0..8 {
            let sorted = cheapest_pieces(&self.costs(points));
            if sorted == facelets && round > 2 {
                break;
            }
            facelets = sorted;
            self.learn(points, &facelets, &[false; 54]);
        }
        (self, facelets)
    }

    /// The best that a sorting allows: as it is compared with another one.
    pub(super) fn settled_on(mut self, points: &Points, facelets: &[u8; 54]) -> Self {
        (0..8).for_each(|_| self.learn(points, facelets, &[false; 54]));
        self
    }

    /// Takes the facelets for true, but those that are `without` a say.
    pub(super) fn learn(&mut self, points: &Points, facelets: &[u8; 54], without: &[bool; 54]) {
        let class = |i: usize| usize::from(facelets[i]);
        for _ in 0..2 {
            for c in 0..6 {
                let members: Vec<Vector3<f64>> = (0..54)
                    .filter(|&i| class(i) == c && !without[i])
                    .map(|i| {
                        let bare = points[i] - self.shifts[i / 9] - self.expected.shifts[i];
                        (bare + BLACK) / (1.0 + self.gains[i / 9]) - BLACK
                    })
                    .collect();
                let n = members.len() as f64;
                let total = middle(&members) * n + self.expected.means[c] * self.belief;
                self.means[c] = total / (n + self.belief);
            }
            for face in 0..6 {
                let members = (9 * face..9 * face + 9).filter(|&i| !without[i]);
                self.gains[face] = self.gain(points, face, members.clone().map(|i| (i, class(i))));
                let n = members.clone().count() as f64;
                let sum: Vector3<f64> = members
                    .map(|i| {
                        let d = self.apart(points, i, class(i));
                        (d + self.shifts[face]) * self.weight(points, i, class(i))
                    })
                    .sum();
                self.shifts[face] = sum / (n + SHIFT_PRIOR);
            }
        }
        let mut scatter = Matrix3::identity() * (SPREAD_PRIOR * SPREAD * SPREAD);
        let mut total = SPREAD_PRIOR;
        let mut shades = SPREAD_PRIOR * SHADING * SHADING;
        for i in (0..54).filter(|&i| !without[i]) {
            let d = self.apart(points, i, class(i));
            let weight = self.weight(points, i, class(i));
            let (shade, variance) = self.shade(&d, class(i));
            let ray = self.ray(class(i));
            let rest = d - ray * shade;
            scatter += weight * (rest * rest.transpose() + ray * ray.transpose() * variance);
            shades += weight * (shade * shade + variance);
            total += weight;
        }
        self.shading = (shades / total).sqrt();
        if let Some(inverse) = (scatter / total).try_inverse() {
            self.precision = inverse;
        }
    }

    /// The likeliest gain of a face whose facelets are of these classes: each one tells it as well as its shading lets it.
    fn gain(
        &self,
        points: &Points,
        face: usize,
        members: impl Iterator<Item = (usize, usize)>,
    ) -> f64 {
        let (mut sum, mut total) = (0.0, 1.0 / (GAIN * GAIN));
        for (i, class) in members {
            let ray = self.ray(class);
            let stiff = self.precision * ray;
            let known = ray.dot(&stiff);
            let d = self.apart(points, i, class) + ray * self.gains[face];
            let weight = self.weight(points, i, class) / (1.0 + known * self.shading.powi(2));
            sum += weight * stiff.dot(&d);
            total += weight * known;
        }
        (sum / total).clamp(-MOST_GAIN, MOST_GAIN)
    }

    /// A facelet from where a class lies on its face, in units of the common spread.
    fn apart(&self, points: &Points, i: usize, class: usize) -> Vector3<f64> {
        let face = i / 9;
        let place = self.means[class] + self.ray(class) * self.gains[face] + self.shifts[face];
        (points[i] - self.expected.shifts[i] - place) / self.expected.variances[i].sqrt()
    }

    /// A facelet far off is a reflection or in the wrong class: it must not shape the model.
    fn weight(&self, points: &Points, i: usize, class: usize) -> f64 {
        1.0 / (1.0 + self.square(points, i, class) / 9.0)
    }

    /// Cost of each colour for each facelet: its squared distance, [`bent`].
    pub(super) fn costs(&self, points: &Points) -> [[f64; 6]; 54] {
        std::array::from_fn(|i| std::array::from_fn(|c| bent(self.square(points, i, c))))
    }

    /// What it costs to explain the facelets so, in -2 log likelihood, but for what is the same of all models: distances,
    /// how wide the classes are taken to be, and how far light and spread lie from what was known of them.
    pub(super) fn cost(&self, points: &Points, facelets: &[u8; 54]) -> f64 {
        let volume = -self.precision.determinant().max(f64::MIN_POSITIVE).ln();
        let mut cost = 0.0;
        for (i, &class) in facelets.iter().enumerate() {
            let class = usize::from(class);
            let ray = self.ray(class);
            let stretch = self.shading.powi(2) * ray.dot(&(self.precision * ray));
            cost += bent(self.square(points, i, class)) + volume + stretch.ln_1p();
        }
        for (shift, gain) in self.shifts.iter().zip(self.gains) {
            cost += SHIFT_PRIOR * shift.dot(&(self.precision * shift)) + (gain / GAIN).powi(2);
        }
        for (mean, expected) in self.means.iter().zip(&self.expected.means) {
            let moved = mean - expected;
            cost += self.belief * moved.dot(&(self.precision * moved));
        }
        let shades = self.shading.powi(2);
        cost + SPREAD_PRIOR * (volume + SPREAD * SPREAD * self.precision.trace())
            + SPREAD_PRIOR * (shades.ln() + SHADING * SHADING / shades)
    }

    /// Light of each face against the mean one, as a factor.
    pub(super) fn light(&self) -> [f64; 6] {
        self.gains.map(|gain| (1.0 + gain).powi(3))
    }

    /// Squared distance of a facelet from a class, in units of the spread.
    pub(super) fn square(&self, points: &Points, i: usize, class: usize) -> f64 {
        let d = self.apart(points, i, class);
        let (shade, _) = self.shade(&d, class);
        let ray = self.ray(class);
        let rest = d - ray * shade;
        rest.dot(&(self.precision * rest)) + (shade / self.shading).powi(2)
    }

    /// Where a class goes when it is lit more strongly.
    fn ray(&self, class: usize) -> Vector3<f64> {
        self.means[class] + BLACK
    }

    /// The likeliest shading of a facelet that is so far from its class, relative, and its variance.
    fn shade(&self, d: &Vector3<f64>, class: usize) -> (f64, f64) {
        let ray = self.precision * self.ray(class);
        let known = ray.dot(&self.ray(class)) + 1.0 / self.shading.powi(2);
        (ray.dot(d) / known, 1.0 / known)
    }
}

/// A squared distance, bent so that it never exceeds [`OUTLIER`].
fn bent(square: f64) -> f64 {
    square / (1.0 + square / OUTLIER)
}

/// Lab with lightness weighted down, after the brightest channel is brought to 1.
pub(super) fn coordinates(rgb: &[[f64; 3]; 54]) -> Points {
    let linear = rgb.map(|c| c.map(to_linear));
    let brightest = linear.iter().flatten().copied().fold(1e-4, f64::max);
    let light = Light([1.0 / brightest; 3]);
    linear.map(|t| {
        let [l, a, b] = lab(light.undo(t));
        Vector3::new(LIGHTNESS * l, a, b)
    })
}

/// Median in each coordinate: one glaring facelet does not move it.
fn middle(points: &[Vector3<f64>]) -> Vector3<f64> {
    Vector3::from_fn(|k, _| median(points.iter().map(|p| p[k]).collect()))
}

pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
