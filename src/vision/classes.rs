//! Model of the six colours of one cube: six classes with a common spread, under a light that
//! differs from face to face.
//!
//! The noise is the same in all classes. In addition, light falls on each facelet at a slightly
//! different angle. This shading moves the colour of a facelet along the ray from black through its
//! class, bright classes farther than dark ones. The automatic exposure of a camera moves all nine
//! facelets of a face along their rays by one gain. Haze and reflections shift all nine in the same
//! direction.
//!
//! Sorting the facelets into classes and learning the model alternate and end in the optimum that
//! is nearest to their start. A face in another light may then be read as a face of other colours.
//! The caller therefore begins at several starts and compares the results by [`Model::cost`].
//!
//! | case | constant | reason |
//! |---|---|---|
//! | facelet is nothing like its class | [`OUTLIER`] | a reflection must not decide a whole cube |
//! | lightness against a\*, b\* | [`LIGHTNESS`] | shading changes lightness most |
//! | prior of a face's shift | [`SHIFT_PRIOR`] | a face of few colours does not determine it |
//! | prior of the spread | [`SPREAD_PRIOR`], [`SPREAD`] | else a clean cube would have no spread |
//! | prior of the shading | [`SPREAD_PRIOR`], [`SHADING`] | else even light would have no shading |
//! | prior of a face's gain | [`GAIN`] | a factor of 1.33 in light |
//! | greatest gain | [`MOST_GAIN`] | no exposure causes a larger one |
//! | second start | [`ANY_SHADING`] | ignores brightness while the gains are unknown |
//!
//! - in: mean RGB of 54 facelets, and the class of each facelet
//! - out: [`Model`]; the squared distance of each facelet from each class
//! - source: own work; Mahalanobis (1936), with one factor for each class

use super::colours::{Light, lab, to_linear};
use super::likeliest::CENTRES;
use nalgebra::{Matrix3, Vector3};

/// Places of the 54 facelets in the colour space: weighted lightness, a\*, b\*.
pub(super) type Points = [Vector3<f64>; 54];

/// Weight of lightness against a\* and b\*. Shading changes lightness most.
const LIGHTNESS: f64 = 0.4;

/// Cost of a facelet that is nothing like its class (a reflection, a finger), in -2 log likelihood.
const OUTLIER: f64 = 50.0;

/// Weight of the prior that a face has no shift of its own, in facelets.
const SHIFT_PRIOR: f64 = 4.0;

/// Weight of the priors of spread and shading, in facelets.
const SPREAD_PRIOR: f64 = 8.0;
/// Expected standard deviation within a class, in units of the colour space.
const SPREAD: f64 = 3.0;
/// Expected standard deviation of the shading: relative change of the cube root of light.
const SHADING: f64 = 0.04;

/// Expected standard deviation of a face's gain: relative change of the cube root of light. It is a
/// factor of 1.33 in light.
const GAIN: f64 = 0.1;

/// Shading of the second start of the sorting. With it, brightness has almost no weight as long as
/// the gains of the faces are unknown.
const ANY_SHADING: f64 = 1.0;

/// Greatest size of a face's gain: relative change of the cube root of light.
const MOST_GAIN: f64 = 0.5;

/// Offset from black, the point at L\* = -16 where the rays begin, to the origin of the colour
/// space. Measured from black, colours scale with the cube root of light.
const BLACK: Vector3<f64> = Vector3::new(LIGHTNESS * 16.0, 0.0, 0.0);

/// Prior knowledge of the colours: measured at the centres, or learned in a rig (a fixed set of
/// cameras and lights).
#[derive(Debug, Clone, Copy)]
pub(super) struct Expected {
    /// Mean of each class.
    pub(super) means: [Vector3<f64>; 6],
    /// Shift of each facelet by the reflections of the rig.
    pub(super) shifts: [Vector3<f64>; 54],
    /// Variance of each facelet, relative to the common variance.
    pub(super) variances: [f64; 54],
    /// Inverse of the covariance that all classes share.
    pub(super) precision: Matrix3<f64>,
}

/// Six classes with one spread, and the effect of the light on each face.
#[derive(Debug, Clone)]
pub(super) struct Model {
    /// Prior knowledge.
    expected: Expected,
    /// Weight of the prior means, in facelets of a colour.
    belief: f64,
    /// Mean of each class in the mean light.
    means: [Vector3<f64>; 6],
    /// Inverse of the covariance that all classes share.
    precision: Matrix3<f64>,
    /// Shift of all nine facelets of each face by haze and reflections.
    shifts: [Vector3<f64>; 6],
    /// Gain of each face: relative change of the cube root of light, positive on a brighter face.
    gains: [f64; 6],
    /// Standard deviation of the shading from facelet to facelet: relative change of the cube root
    /// of light.
    shading: f64,
}

impl Model {
    /// Makes a model whose class means are the colours of the six centres, without other knowledge.
    pub(super) fn of_centres(points: &Points) -> Self {
        let expected = Expected {
            means: CENTRES.map(|c| points[c]),
            shifts: [Vector3::zeros(); 54],
            variances: [1.0; 54],
            precision: Matrix3::identity() / 100.0,
        };
        Self::of(expected, 0.0)
    }

    /// Makes a model from prior knowledge. The prior mean of a class counts as much as `belief`
    /// facelets of that class.
    pub(super) fn of(expected: Expected, belief: f64) -> Self {
        let (means, precision) = (expected.means, expected.precision);
        let shifts = [Vector3::zeros(); 6];
        Self { expected, belief, means, precision, shifts, gains: [0.0; 6], shading: SHADING }
    }

    /// Returns this model for a sorting by hue: the brightness of a facelet has almost no weight.
    pub(super) fn by_hue(self) -> Self {
        Self { shading: ANY_SHADING, precision: self.precision * 4.0, ..self }
    }

    /// Sorts the facelets into the six classes and learns the model from the result, alternately,
    /// until the classes stay the same. Returns the model and the class of each facelet. `sort`
    /// returns the class of each facelet from the cost of each class for each facelet.
    pub(super) fn sort_and_learn(
        mut self,
        points: &Points,
        sort: impl Fn(&[[f64; 6]; 54]) -> [u8; 54],
    ) -> (Self, [u8; 54]) {
        let mut facelets = [0u8; 54];
        // In the first rounds the classes may stay the same while the model still changes. Eight
        // rounds at most, since the classes may alternate for ever.
        for round in 0..8 {
            let sorted = sort(&self.costs(points));
            if sorted == facelets && round > 2 {
                break;
            }
            facelets = sorted;
            self.learn(points, &facelets, &[false; 54]);
        }
        (self, facelets)
    }

    /// Returns the model that fits best if `facelets` are the classes of the facelets, so that its
    /// cost can be compared with that of other classes.
    pub(super) fn fitted_to(mut self, points: &Points, facelets: &[u8; 54]) -> Self {
        (0..8).for_each(|_| self.learn(points, facelets, &[false; 54]));
        self
    }

    /// Learns means, gains, shifts, spread and shading from the facelets and their classes
    /// (`facelets`). Facelets for which `ignored` is true do not count.
    pub(super) fn learn(&mut self, points: &Points, facelets: &[u8; 54], ignored: &[bool; 54]) {
        let class = |i: usize| usize::from(facelets[i]);
        // The means depend on the light of the faces, and the light on the means, so both are
        // estimated twice.
        for _ in 0..2 {
            for c in 0..6 {
                let members: Vec<Vector3<f64>> = (0..54)
                    .filter(|&i| class(i) == c && !ignored[i])
                    .map(|i| {
                        // This is the facelet as it would look in the mean light.
                        let bare = points[i] - self.shifts[i / 9] - self.expected.shifts[i];
                        (bare + BLACK) / (1.0 + self.gains[i / 9]) - BLACK
                    })
                    .collect();
                let n = members.len() as f64;
                let total = middle(&members) * n + self.expected.means[c] * self.belief;
                self.means[c] = total / (n + self.belief);
            }
            for face in 0..6 {
                let members = (9 * face..9 * face + 9).filter(|&i| !ignored[i]);
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
        // A deviation is split into shading along the ray and a remainder. The variance of the
        // shading is added to both (an expectation-maximisation step).
        let mut scatter = Matrix3::identity() * (SPREAD_PRIOR * SPREAD * SPREAD);
        let mut total = SPREAD_PRIOR;
        let mut shades = SPREAD_PRIOR * SHADING * SHADING;
        for i in (0..54).filter(|&i| !ignored[i]) {
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

    /// Returns the likeliest gain of a face: the relative difference of its light from the mean
    /// light, in cube roots of light. `members` are its facelets with their classes.
    fn gain(
        &self,
        points: &Points,
        face: usize,
        members: impl Iterator<Item = (usize, usize)>,
    ) -> f64 {
        // Weighted least squares along the rays. The prior pulls the gain to 0.
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

    /// Returns the difference, in the colour space, between a facelet and the mean of a class in
    /// the light of the facelet's face. It is scaled down for a facelet with a large variance.
    fn apart(&self, points: &Points, facelet: usize, class: usize) -> Vector3<f64> {
        let face = facelet / 9;
        let place = self.means[class] + self.ray(class) * self.gains[face] + self.shifts[face];
        let expected = &self.expected;
        (points[facelet] - expected.shifts[facelet] - place) / expected.variances[facelet].sqrt()
    }

    /// Returns the weight, 0..=1, of a facelet as a member of a class when the model is learned. It
    /// is small for a facelet far from the class, which is a reflection or has the wrong class.
    fn weight(&self, points: &Points, facelet: usize, class: usize) -> f64 {
        1.0 / (1.0 + self.square(points, facelet, class) / 9.0)
    }

    /// Computes the cost of each class for each facelet: the squared distance between them, bounded
    /// by [`bent`].
    pub(super) fn costs(&self, points: &Points) -> [[f64; 6]; 54] {
        std::array::from_fn(|i| std::array::from_fn(|c| bent(self.square(points, i, c))))
    }

    /// Computes how badly the model explains the facelets with the given classes, in -2 log
    /// likelihood, without the terms that are equal in all models. The cost is the sum of the
    /// squared distances, the terms of the classes' width, and the deviations of means, light and
    /// spread from their priors.
    pub(super) fn cost(&self, points: &Points, facelets: &[u8; 54]) -> f64 {
        // The logarithm of the determinant of the covariance. Without it, wide classes would
        // explain all colours.
        let volume = -self.precision.determinant().max(f64::MIN_POSITIVE).ln();
        let mut cost = 0.0;
        for (i, &class) in facelets.iter().enumerate() {
            let class = usize::from(class);
            let ray = self.ray(class);
            // The shading widens a class along its ray: the determinant grows by 1 + s^2 r' P r.
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
        // The priors of spread and shading count like SPREAD_PRIOR facelets with the expected
        // deviation.
        let shades = self.shading.powi(2);
        cost + SPREAD_PRIOR * (volume + SPREAD * SPREAD * self.precision.trace())
            + SPREAD_PRIOR * (shades.ln() + SHADING * SHADING / shades)
    }

    /// Returns the light on each face as a factor of the mean light.
    pub(super) fn light(&self) -> [f64; 6] {
        self.gains.map(|gain| (1.0 + gain).powi(3))
    }

    /// Computes the squared distance of a facelet from a class (Mahalanobis), with the likeliest
    /// shading of the facelet. The shading adds its own square, in units of its spread.
    pub(super) fn square(&self, points: &Points, facelet: usize, class: usize) -> f64 {
        let d = self.apart(points, facelet, class);
        let (shade, _) = self.shade(&d, class);
        let ray = self.ray(class);
        let rest = d - ray * shade;
        rest.dot(&(self.precision * rest)) + (shade / self.shading).powi(2)
    }

    /// Returns the ray of a class: the vector from black to its mean, along which light moves it.
    fn ray(&self, class: usize) -> Vector3<f64> {
        self.means[class] + BLACK
    }

    /// Returns the likeliest shading of a facelet with the deviation `d` from its class (relative
    /// change of the cube root of light), and the variance of this estimate.
    fn shade(&self, d: &Vector3<f64>, class: usize) -> (f64, f64) {
        let ray = self.precision * self.ray(class);
        let known = ray.dot(&self.ray(class)) + 1.0 / self.shading.powi(2);
        (ray.dot(d) / known, 1.0 / known)
    }
}

/// Bounds a squared distance: a small one hardly changes, and a very large one becomes almost
/// [`OUTLIER`].
fn bent(square: f64) -> f64 {
    square / (1.0 + square / OUTLIER)
}

/// Converts the mean RGB of 54 facelets, 0..=255, to CIE Lab with a reduced weight of lightness.
/// The brightest channel of all facelets is scaled to 1 first, so that the exposure does not
/// matter.
pub(super) fn coordinates(rgb: &[[f64; 3]; 54]) -> Points {
    let linear = rgb.map(|c| c.map(to_linear));
    let brightest = linear.iter().flatten().copied().fold(1e-4, f64::max);
    let light = Light([1.0 / brightest; 3]);
    linear.map(|t| {
        let [l, a, b] = lab(light.undo(t));
        Vector3::new(LIGHTNESS * l, a, b)
    })
}

/// Returns the median of each coordinate, which a single facelet with a reflection hardly moves.
fn middle(points: &[Vector3<f64>]) -> Vector3<f64> {
    Vector3::from_fn(|k, _| median(points.iter().map(|p| p[k]).collect()))
}

/// Returns the median of some values: the upper middle value if their number is even, and 0 if
/// there are none.
pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
