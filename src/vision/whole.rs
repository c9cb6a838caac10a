//! The colours of a whole cube: 54 mean colours -> facelets, with a margin each.
//!
//! Nothing is known of the six colours beforehand but that the centres are six different ones. Six classes are
//! sorted around the centres, and then three things take turns until they agree: the classes' means and their
//! common spread, what the light does to each face (a reflection shifts all nine of its facelets), and the
//! [likeliest](super::likeliest) cube that can exist. The colours' names come last and change nothing.
//!
//! A cube that was put together wrongly is not read as the nearest legal one: when its facelets one by one are
//! too clear for that, it is refused with what is wrong with it.
//!
//! - in: mean RGB of the facelets, 0..=255, as in the image (sRGB), in the order URFDLB
//! - out: [`Decision`] or [`Undecided`]
//! - source: own work; the spread as a metric after Mahalanobis (1936)

use super::assignment::assign;
use super::colours::{Light, fit_light, lab, prototype_distances, to_linear};
use super::likeliest::{CENTRES, cheapest_pieces, likeliest};
use crate::cube::{Cube, Face, Facelets, ImpossibleCube, Rotation24};
use nalgebra::{Matrix3, Vector3};
use std::sync::LazyLock;

/// A whole cube, decided.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// Colour of each facelet, 0..=5 = white, red, green, yellow, orange, blue.
    pub colours: [u8; 54],
    /// Face (0..=5 = URFDLB) whose centre has each facelet's colour: independent of the colours' names.
    pub facelets: [u8; 54],
    /// Confidence that a facelet is right against the best cube in which it has another colour, 0..=1.
    pub margins: [f64; 54],
    /// Facelets with a small margin, least certain first.
    pub doubtful: Vec<usize>,
}

/// No decision.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Undecided {
    /// A measured value is not a number.
    #[error("facelet {0} has no colour: not a number")]
    NotANumber(usize),
    /// Two centres cannot be told apart.
    #[error("the centres of faces {} and {} have the same colour", first.letter(), second.letter())]
    SameCentres {
        /// A face,
        first: Face,
        /// and another.
        second: Face,
    },
    /// The facelets are clear, and they make no cube.
    #[error("this cube cannot exist: {reason}; doubtful facelets: {doubtful:?}")]
    Impossible {
        /// What is wrong with the cube as it was read.
        reason: ImpossibleCube,
        /// The cube as it was read, 0..=5 = URFDLB.
        facelets: Box<[u8; 54]>,
        /// Facelets that would have another colour on the nearest cube that can exist.
        doubtful: Vec<usize>,
    },
}

/// Facelets with a smaller margin are doubtful.
const DOUBTFUL: f64 = 0.9;

/// Weight of lightness against a* and b*: shading changes it most.
const LIGHTNESS: f64 = 0.4;

/// Cost of a facelet that is nothing like its class: a reflection, a finger. In -2 log likelihood.
const OUTLIER: f64 = 50.0;

/// The likeliest legal cube may cost so much more than the facelets one by one.
const IMPLAUSIBLE: f64 = 40.0;

/// How strongly a face's own shift is held to nought, in facelets.
const SHIFT_PRIOR: f64 = 4.0;

/// How far a learned table is believed against the cube at hand, in facelets of a colour.
const BELIEF: f64 = 4.0;

/// Facelets' worth of belief in a spread of [`SPREAD`] units.
const SPREAD_PRIOR: f64 = 8.0;
const SPREAD: f64 = 3.0;

pub(super) type Points = [Vector3<f64>; 54];

/// Decides all 54 facelets (order URFDLB, reading order) from their mean RGB, 0..=255.
///
/// # Errors
/// [`Undecided`] when the input is not a cube's.
pub fn decide_cube(rgb: &[[f64; 3]; 54]) -> Result<Decision, Undecided> {
    if let Some(i) = rgb.iter().position(|c| c.iter().any(|v| !v.is_finite())) {
        return Err(Undecided::NotANumber(i));
    }
    let points = coordinates(rgb);
    for first in Face::ALL {
        for second in Face::ALL.into_iter().filter(|s| s.index() > first.index()) {
            let apart = points[CENTRES[first.index()]] - points[CENTRES[second.index()]];
            if apart.norm_squared() < 1.0 {
                return Err(Undecided::SameCentres { first, second });
            }
        }
    }
    let model = Model::of_centres(&points).settle(&points);
    conclude(rgb, &model.costs(&points))
}

/// Decides them in a rig of which something is known.
pub(super) fn decide_expected(
    rgb: &[[f64; 3]; 54],
    expected: Expected,
) -> Result<Decision, Undecided> {
    if let Some(i) = rgb.iter().position(|c| c.iter().any(|v| !v.is_finite())) {
        return Err(Undecided::NotANumber(i));
    }
    let points = coordinates(rgb);
    conclude(rgb, &Model::of(expected, BELIEF).settle(&points).costs(&points))
}

/// The decision that costs of each colour for each facelet lead to.
fn conclude(rgb: &[[f64; 3]; 54], costs: &[[f64; 6]; 54]) -> Result<Decision, Undecided> {
    let best = likeliest(costs);

    let own = |i: usize| costs[i][usize::from(best.facelets[i])];
    let alone = one_by_one(costs);
    let clear: f64 = (0..54).map(|i| own(i) - costs[i][usize::from(alone[i])]).sum();
    if clear > IMPLAUSIBLE {
        let read = as_counted(costs, alone);
        if let Some(reason) = impossible(&read) {
            let doubtful = (0..54).filter(|&i| read[i] != best.facelets[i]).collect();
            return Err(Undecided::Impossible { reason, facelets: Box::new(read), doubtful });
        }
    }
    // A facelet that only the others forced into its class is no more certain than it looks by itself.
    let margins = std::array::from_fn(|i| {
        let next = (0..6).filter(|&c| c != usize::from(best.facelets[i])).map(|c| costs[i][c]);
        let alone = next.fold(f64::INFINITY, f64::min) - own(i);
        let forced = if alone < 0.0 { (0.5 * alone).exp() } else { 1.0 };
        forced * (1.0 - (-0.5 * best.margins[i]).exp())
    });
    let mut doubtful: Vec<usize> = (0..54).filter(|&i| margins[i] < DOUBTFUL).collect();
    doubtful.sort_by(|&a, &b| margins[a].total_cmp(&margins[b]));
    let names = name(&rgb.map(|c| c.map(to_linear)), &best.facelets);
    Ok(Decision {
        colours: best.facelets.map(|c| names[usize::from(c)]),
        facelets: best.facelets,
        margins,
        doubtful,
    })
}

/// The nearest class of each facelet by itself; the centres are what they are.
fn one_by_one(costs: &[[f64; 6]; 54]) -> [u8; 54] {
    let mut facelets = costs.map(|c| least(&c) as u8);
    for (face, &centre) in CENTRES.iter().enumerate() {
        facelets[centre] = face as u8;
    }
    facelets
}

/// The same with nine of each colour, unless that is far dearer: then there really are not nine of each.
fn as_counted(costs: &[[f64; 6]; 54], alone: [u8; 54]) -> [u8; 54] {
    let mut matrix = vec![0.0; 54 * 54];
    for (i, row) in matrix.chunks_exact_mut(54).enumerate() {
        let fixed = CENTRES.iter().position(|&c| c == i);
        for (column, cost) in row.iter_mut().enumerate() {
            let colour = column / 9;
            *cost = match fixed {
                Some(face) => f64::from(u8::from(face != colour)) * 1e6,
                None => costs[i][colour],
            };
        }
    }
    let columns = assign(&matrix, 54);
    let counted: [u8; 54] = std::array::from_fn(|i| (columns[i] / 9) as u8);
    let price =
        |facelets: &[u8; 54]| -> f64 { (0..54).map(|i| costs[i][usize::from(facelets[i])]).sum() };
    if price(&counted) - price(&alone) > 0.5 * IMPLAUSIBLE { alone } else { counted }
}

/// Colours of the six faces of a cube of the common scheme, in each of the 24 ways to lay it.
static SCHEMES: LazyLock<Vec<[u8; 6]>> = LazyLock::new(|| {
    let solved = Facelets::solved();
    Rotation24::all().map(|r| CENTRES.map(|c| solved.rotated(r).colours()[c])).collect()
});

/// By so much another scheme must explain the colours better than the common one.
const UNCOMMON: f64 = 15.0;

/// Colour 0..=5 of each class: the way to lay a cube of the common scheme, and the light, under which the classes
/// look most like their colours.
fn name(linear: &[[f64; 3]; 54], class: &[u8; 54]) -> [u8; 6] {
    let means: [[f64; 3]; 6] = std::array::from_fn(|class_| {
        std::array::from_fn(|c| {
            let members = (0..54).filter(|&i| usize::from(class[i]) == class_);
            median(members.map(|i| linear[i][c]).collect())
        })
    });
    let price = |d: &[[f64; 6]], names: &[u8; 6]| -> f64 {
        d.iter().zip(names).map(|(d, &n)| d[usize::from(n)]).sum()
    };
    let common = |d: &[[f64; 6]]| {
        SCHEMES
            .iter()
            .map(|s| (price(d, s), *s))
            .fold((f64::INFINITY, [0; 6]), |best, next| if next.0 < best.0 { next } else { best })
    };
    let (light, cost) = fit_light(&means, |d| common(d).0);
    let under = |light: Light| means.map(|m| prototype_distances(light.undo(m)));
    if cost < UNCOMMON {
        return common(&under(light)).1;
    }
    let any = |d: &[[f64; 6]]| -> [u8; 6] {
        let columns = assign(&d.iter().flatten().copied().collect::<Vec<_>>(), 6);
        std::array::from_fn(|i| columns[i] as u8)
    };
    let (other_light, other_cost) = fit_light(&means, |d| price(d, &any(d)));
    if cost - other_cost > UNCOMMON { any(&under(other_light)) } else { common(&under(light)).1 }
}

/// Why facelets are no cube; nothing when they are one.
fn impossible(facelets: &[u8; 54]) -> Option<ImpossibleCube> {
    Cube::try_from(Facelets::try_from(*facelets).ok()?).err()
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

fn least(values: &[f64; 6]) -> usize {
    (0..6).fold(0, |best, i| if values[i] < values[best] { i } else { best })
}

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
struct Model {
    /// What was learned before, and how far it is believed, in facelets of a colour.
    expected: Expected,
    belief: f64,
    means: [Vector3<f64>; 6],
    /// Inverse of the common covariance.
    precision: Matrix3<f64>,
    /// Shift of all nine facelets of each face.
    shifts: [Vector3<f64>; 6],
}

impl Model {
    /// Nothing known but the centres.
    fn of_centres(points: &Points) -> Self {
        let expected = Expected {
            means: CENTRES.map(|c| points[c]),
            shifts: [Vector3::zeros(); 54],
            variances: [1.0; 54],
            precision: Matrix3::identity() / 100.0,
        };
        Self::of(expected, 0.0)
    }

    fn of(expected: Expected, belief: f64) -> Self {
        let (means, precision) = (expected.means, expected.precision);
        Self { expected, belief, means, precision, shifts: [Vector3::zeros(); 6] }
    }

    /// Lets means, shifts, spread and facelets take turns.
    fn settle(self, points: &Points) -> Self {
        let mut model = self;
        let mut facelets = [0u8; 54];
        for round in 0..8 {
            let sorted = cheapest_pieces(&model.costs(points));
            if sorted == facelets && round > 2 {
                break;
            }
            facelets = sorted;
            model.learn(points, &facelets);
        }
        model
    }

    /// Takes the facelets for true.
    fn learn(&mut self, points: &Points, facelets: &[u8; 54]) {
        let class = |i: usize| usize::from(facelets[i]);
        for _ in 0..2 {
            for c in 0..6 {
                let members: Vec<Vector3<f64>> = (0..54)
                    .filter(|&i| class(i) == c)
                    .map(|i| points[i] - self.shifts[i / 9] - self.expected.shifts[i])
                    .collect();
                let n = members.len() as f64;
                let total = middle(&members) * n + self.expected.means[c] * self.belief;
                self.means[c] = total / (n + self.belief);
            }
            for face in 0..6 {
                let sum: Vector3<f64> = (9 * face..9 * face + 9)
                    .map(|i| {
                        let d = self.apart(points, i, class(i));
                        (d + self.shifts[face]) * self.weight(&d)
                    })
                    .sum();
                self.shifts[face] = sum / (9.0 + SHIFT_PRIOR);
            }
        }
        let mut scatter = Matrix3::identity() * (SPREAD_PRIOR * SPREAD * SPREAD);
        let mut total = SPREAD_PRIOR;
        for i in 0..54 {
            let d = self.apart(points, i, class(i));
            let weight = self.weight(&d);
            scatter += weight * d * d.transpose();
            total += weight;
        }
        if let Some(inverse) = (scatter / total).try_inverse() {
            self.precision = inverse;
        }
    }

    /// A facelet from the mean of a class, in units of the common spread.
    fn apart(&self, points: &Points, i: usize, class: usize) -> Vector3<f64> {
        let d = points[i] - self.expected.shifts[i] - self.shifts[i / 9] - self.means[class];
        d / self.expected.variances[i].sqrt()
    }

    /// A facelet far off is a reflection or in the wrong class: it must not shape the model.
    fn weight(&self, d: &Vector3<f64>) -> f64 {
        1.0 / (1.0 + d.dot(&(self.precision * d)) / 9.0)
    }

    /// Cost of each colour for each facelet: its squared distance, [`bent`].
    fn costs(&self, points: &Points) -> [[f64; 6]; 54] {
        std::array::from_fn(|i| {
            std::array::from_fn(|c| {
                let d = self.apart(points, i, c);
                bent(d.dot(&(self.precision * d)))
            })
        })
    }
}

/// A squared distance, bent so that it never exceeds [`OUTLIER`].
fn bent(square: f64) -> f64 {
    square / (1.0 + square / OUTLIER)
}

/// Median in each coordinate: one glaring facelet does not move it.
fn middle(points: &[Vector3<f64>]) -> Vector3<f64> {
    Vector3::from_fn(|k, _| median(points.iter().map(|p| p[k]).collect()))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Stickers of a common cube, sRGB.
    const STICKERS: [[f64; 3]; 6] = [
        [235.0, 235.0, 235.0],
        [183.0, 18.0, 52.0],
        [0.0, 155.0, 72.0],
        [255.0, 213.0, 0.0],
        [255.0, 88.0, 0.0],
        [0.0, 70.0, 173.0],
    ];

    /// A cube with these facelets under coloured light, with shading that differs by face.
    fn measured(state: &[u8; 54], gains: [f64; 3]) -> [[f64; 3]; 54] {
        std::array::from_fn(|i| {
            let shade = 0.75 + 0.05 * (i / 9) as f64 + 0.01 * (i % 9) as f64;
            let p = STICKERS[usize::from(state[i])];
            std::array::from_fn(|c| (p[c] * shade * gains[c] + 6.0).min(255.0))
        })
    }

    fn scrambled(seed: u64) -> [u8; 54] {
        *Facelets::from(&Cube::scrambled(seed)).colours()
    }

    proptest! {
        #[test]
        fn a_cube_in_coloured_light_is_read_and_named(seed in 0u64..1000, blue in 0.6..1.0, green in 0.85..1.0) {
            let truth = scrambled(seed);

            let decision = decide_cube(&measured(&truth, [1.0, green, blue])).unwrap();

            prop_assert_eq!(decision.facelets, truth);
            prop_assert_eq!(decision.colours, truth);
            prop_assert!(decision.doubtful.is_empty(), "{:?}", decision.doubtful);
        }

        #[test]
        fn any_54_colours_give_a_cube_that_can_exist_or_a_reason(
            levels in proptest::collection::vec(0.0..255.0f64, 162)
        ) {
            let rgb = std::array::from_fn(|i| std::array::from_fn(|c| levels[3 * i + c]));

            if let Ok(decision) = decide_cube(&rgb) {
                prop_assert!(Cube::is_possible(&decision.facelets));
                prop_assert!(decision.margins.iter().all(|m| (0.0..=1.0).contains(m)));
            }
        }
    }

    #[test]
    fn facelets_that_glare_are_put_right_by_the_others_and_named_doubtful() {
        let truth = scrambled(5);
        let mut rgb = measured(&truth, [1.0; 3]);
        // A red and an orange facelet that look more like each other's colour than like their own.
        let find = |colour| (0..54).find(|&i| truth[i] == colour && !CENTRES.contains(&i)).unwrap();
        let (i, j) = (find(1), find(4));
        let (a, b) = (rgb[i], rgb[j]);
        rgb[i] = std::array::from_fn(|c| 0.35 * a[c] + 0.65 * b[c]);
        rgb[j] = std::array::from_fn(|c| 0.65 * a[c] + 0.35 * b[c]);

        let decision = decide_cube(&rgb).unwrap();

        assert_eq!(decision.facelets, truth);
        assert!(decision.doubtful.contains(&i) && decision.doubtful.contains(&j));
    }

    #[test]
    fn a_cube_put_together_wrongly_is_refused_with_what_is_wrong() {
        let read = |state: &[u8; 54]| match decide_cube(&measured(state, [1.0, 0.95, 0.9])) {
            Err(Undecided::Impossible { reason, facelets, doubtful }) => {
                (reason, *facelets, doubtful)
            }
            other => panic!("{other:?}"),
        };
        let truth = scrambled(11);

        let mut flipped = truth;
        flipped.swap(5, 10);
        let (reason, facelets, _) = read(&flipped);
        assert!(matches!(reason, ImpossibleCube::EdgeFlipped { .. }), "{reason}");
        assert_eq!(facelets, flipped);

        let mut twisted = truth;
        (twisted[8], twisted[9], twisted[20]) = (truth[9], truth[20], truth[8]);
        let (reason, _, doubtful) = read(&twisted);
        assert!(matches!(reason, ImpossibleCube::CornerTwisted { .. }));
        assert!(doubtful.len() >= 3);

        let mut swapped = truth;
        swapped.swap(5, 7);
        swapped.swap(10, 19);
        assert!(matches!(read(&swapped).0, ImpossibleCube::Swapped { .. }));

        let mut painted = truth;
        painted[0] = (truth[0] + 1) % 6;
        assert!(matches!(read(&painted).0, ImpossibleCube::ColourCount { .. }));
    }

    #[test]
    fn centres_of_one_colour_and_no_numbers_are_refused() {
        let mut rgb = measured(&scrambled(3), [1.0; 3]);
        rgb[13] = rgb[4];
        assert!(matches!(decide_cube(&rgb), Err(Undecided::SameCentres { .. })));

        rgb[13][0] = f64::NAN;
        assert_eq!(decide_cube(&rgb), Err(Undecided::NotANumber(13)));
    }
}
