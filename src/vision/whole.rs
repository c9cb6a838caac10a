//! Decision of the colours of a whole cube: 54 mean colours -> facelets, with a margin each.
//!
//! The only prior knowledge is that the six centres have six different colours. Six classes, one
//! for each colour, begin at the centres. Three estimates then alternate until they agree: the
//! means of the classes with their common spread, the light on each face (a reflection shifts all
//! nine of its facelets), and the likeliest cube that can exist. The names of the colours come last
//! and change no class. Costs are -2 log likelihood.
//!
//! Pictures that were turned, exchanged or mirrored are recognised, since they make a cube only in
//! another placement. A cube that was assembled wrongly is not read as the nearest legal one: if
//! its facelets are clear when taken one by one, the cube is refused with the reason.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | facelet is doubtful | margin < [`DOUBTFUL`] | the best other cube is 10 times less likely |
//! | cube is impossible | cost > [`IMPLAUSIBLE`] | noise does this once in 10^6 at worst |
//! | pictures may be misplaced | strain > [`UNSURE`] | right readings have almost none |
//! | pictures are misplaced | cost lower by [`IMPLAUSIBLE`] | as for an impossible cube |
//! | facelet is unlike its colour | [`UNLIKE`] | chi square of three numbers: once in 1000 |
//! | it is still evident | [`LIKER`] of the other distance | some classes scatter more |
//! | contested facelets are evident | [`REACH`] times the others | reflections may move facelets |
//! | weight of a learned table | [`BELIEF`] facelets | the present cube counts for more |
//! | two centres are alike | squared distance < 1 | they cannot begin two classes |
//!
//! - in: mean RGB of the facelets, 0..=255, as in the image (sRGB), in the order URFDLB
//! - out: [`Decision`] or [`Undecided`]
//! - source: own work; the spread as a metric after Mahalanobis (1936)

use super::assignment::assign;
use super::classes::{Expected, Model, Points, coordinates};
use super::colours::{CLIPPED, is_colourless, to_linear};
use super::likeliest::{CENTRES, Likeliest, cheapest_pieces, likeliest};
use super::names::name;
use super::placement::{Placement, placements};
use crate::cube::{Cube, Face, Facelets, ImpossibleCube, facelet_place};

/// Colours of a whole cube as they were decided.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// Colour of each facelet, 0..=5 = white, red, green, yellow, orange, blue.
    pub colours: [u8; 54],
    /// For each facelet the face (0..=5 = URFDLB) whose centre has the same colour, independent of
    /// the names of the colours.
    pub facelets: [u8; 54],
    /// Confidence in each facelet compared with the best cube in which it has another colour,
    /// 0..=1.
    pub margins: [f64; 54],
    /// Numbers of the facelets with a small margin, the least certain first.
    pub doubtful: Vec<usize>,
}

/// Returns the names of stickers as text: "F1, R3".
fn places(facelets: &[usize]) -> String {
    let names: Vec<String> = facelets.iter().map(|&i| facelet_place(i).to_string()).collect();
    names.join(", ")
}

/// Returns the possible faults of the pictures as text, joined by "or".
fn either(ways: &[Placement]) -> String {
    let ways: Vec<String> = ways.iter().map(ToString::to_string).collect();
    ways.join(", or ")
}

/// Reason why the colours of a cube were not decided.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Undecided {
    /// A measured value is not a number.
    #[error("the measured colour of facelet {0} (0..=53, URFDLB) is not a number")]
    NotANumber(usize),
    /// The pictures are black and white.
    #[error("no colour in the pictures: they are in black and white")]
    NoColour,
    /// Two centres have the same colour.
    #[error(
        "the centres of faces {} and {} have the same colour{}",
        first.letter(),
        second.letter(),
        if *overexposed { ": both are overexposed" } else { "" }
    )]
    SameCentres {
        /// First face.
        first: Face,
        /// Second face.
        second: Face,
        /// Whether the pictures of both centres are clipped.
        overexposed: bool,
    },
    /// The pictures make a cube only in another placement.
    #[error("the pictures fit each other only in another way: {placement}")]
    Misplaced {
        /// Faults of the pictures.
        placement: Placement,
        /// Colours of the cube after the correction of the placement.
        decision: Box<Decision>,
    },
    /// The pictures make a cube only in another placement, and several placements are equally
    /// simple.
    #[error(
        "the pictures do not fit each other as they are; one of these is the cause: {}",
        either(ways)
    )]
    Misfit {
        /// Possible faults of the pictures.
        ways: Vec<Placement>,
    },
    /// The facelets are clear, but no cube that can exist has them.
    #[error("this cube cannot exist: {reason}; stickers in doubt: {}", places(doubtful))]
    Impossible {
        /// Fault of the cube as it was read.
        reason: ImpossibleCube,
        /// Cube as it was read, 0..=5 = URFDLB.
        facelets: Box<[u8; 54]>,
        /// Facelets that would have another colour on the nearest cube that can exist.
        doubtful: Vec<usize>,
    },
}

/// Margin below which a facelet is doubtful. Doubtful facelets are reported, and the cube is not
/// solved before another picture or the operator decides them. At this margin the best other cube
/// is ten times less likely.
const DOUBTFUL: f64 = 0.9;

/// Least difference of costs at which a cube is impossible. By this sum the contested facelets look
/// more like their own colours than like those of the likeliest cube. Noise alone moves a facelet
/// that far towards another colour once in 10^6 times at worst.
const IMPLAUSIBLE: f64 = 25.0;

/// Strain of a reading (see [`Reading::strain`]) above which the placement of the pictures may be
/// wrong. The strain is 0 if each facelet by itself looks like its colour on the cube.
const UNSURE: f64 = 5.0;

/// Squared distance from a class above which a facelet does not look like it. A facelet of the
/// class, whose colour has three components, exceeds this once in 1000 times.
const UNLIKE: f64 = 16.0;

/// Ratio of squared distances below which [`UNLIKE`] does not apply: that from the facelet's own
/// colour, divided by that from its colour on the likeliest cube. Some classes scatter more than
/// others, so even a member of a class may be far from it.
const LIKER: f64 = 0.25;

/// Least squared distance of a contested facelet from its colour on the likeliest cube, as a
/// multiple of the greatest squared distance of a certain facelet from its own colour. If
/// reflections move certain facelets far, they may have moved the contested ones as well.
const REACH: f64 = 2.0;

/// Weight of a learned table compared with the present cube, in facelets of each colour.
const BELIEF: f64 = 4.0;

/// Decides the colours of the 54 facelets of a cube from their mean RGB, 0..=255. The faces are in
/// the order URFDLB, the facelets of a face in reading order.
///
/// ```
/// use rubik_robot_vision::colours::{Undecided, decide_cube};
/// use rubik_robot_vision::cube::{Cube, Facelets};
///
/// let stickers: [[f64; 3]; 6] = [
///     [235.0, 235.0, 235.0],
///     [183.0, 18.0, 52.0],
///     [0.0, 155.0, 72.0],
///     [255.0, 213.0, 0.0],
///     [255.0, 88.0, 0.0],
///     [0.0, 70.0, 173.0],
/// ];
/// let truth = *Facelets::from(&Cube::scrambled(2007)).colours();
/// // Each face has its own light, and each facelet its own shade.
/// let rgb: [[f64; 3]; 54] = std::array::from_fn(|i| {
///     let shade = 0.75 + 0.03 * (i / 9) as f64 + 0.01 * (i % 9) as f64;
///     stickers[usize::from(truth[i])].map(|level| level * shade)
/// });
/// let decision = decide_cube(&rgb)?;
/// assert_eq!(decision.facelets, truth);
/// assert!(decision.doubtful.is_empty());
/// assert_eq!(decide_cube(&[[90.0; 3]; 54]), Err(Undecided::NoColour));
/// # Ok::<(), Undecided>(())
/// ```
///
/// # Errors
/// [`Undecided`] if the colours are not those of a cube.
pub fn decide_cube(rgb: &[[f64; 3]; 54]) -> Result<Decision, Undecided> {
    if let Some(i) = rgb.iter().position(|c| c.iter().any(|v| !v.is_finite())) {
        return Err(Undecided::NotANumber(i));
    }
    if is_colourless(rgb) {
        return Err(Undecided::NoColour);
    }
    let points = coordinates(rgb);
    // Six classes begin at the centres, so two equal centres would give two equal classes.
    for first in Face::ALL {
        for second in Face::ALL.into_iter().filter(|s| s.index() > first.index()) {
            let apart = points[CENTRES[first.index()]] - points[CENTRES[second.index()]];
            if apart.norm_squared() < 1.0 {
                let centres = [first, second].map(|face| rgb[CENTRES[face.index()]]);
                let overexposed = centres.iter().flatten().all(|&v| v >= CLIPPED);
                return Err(Undecided::SameCentres { first, second, overexposed });
            }
        }
    }
    let given = Sorted::of(&points, Model::of_centres(&points), cheapest_pieces);
    match misplaced(rgb, &points, &given) {
        Some(refusal) => Err(refusal),
        None => decide(rgb, &points, given),
    }
}

/// Decides the colours of the 54 facelets of a cube in a rig (a fixed set of cameras and lights),
/// like [`decide_cube`], but without a search for other placements. `expected` are the colours and
/// reflections that were learned in this rig.
///
/// # Errors
/// [`Undecided`] if the colours are not those of a cube.
pub(super) fn decide_expected(
    rgb: &[[f64; 3]; 54],
    expected: Expected,
) -> Result<Decision, Undecided> {
    if let Some(i) = rgb.iter().position(|c| c.iter().any(|v| !v.is_finite())) {
        return Err(Undecided::NotANumber(i));
    }
    let points = coordinates(rgb);
    if is_colourless(rgb) {
        return Err(Undecided::NoColour);
    }
    decide(rgb, &points, Sorted::of(&points, Model::of(expected, BELIEF), cheapest_pieces))
}

/// Searches for another placement of the pictures if their facelets do not fit a cube as given.
/// Returns the refusal if another placement explains them far better.
fn misplaced(rgb: &[[f64; 3]; 54], points: &Points, given: &Sorted) -> Option<Undecided> {
    // Most readings fit, and end here without the search.
    if given.rival.is_none() && given.best.strain() < UNSURE {
        return None;
    }
    // The only rule for sorting is nine facelets in each class, because the pieces are unknown as
    // long as the placement is unknown.
    let loose = Sorted::of(points, Model::of_centres(points), nine_of_each);
    let mut ways: Vec<(Placement, Sorted)> = placements(&loose.best.costs)
        .into_iter()
        .map(|placement| {
            let points = placement.put_right(points);
            let sorted = Sorted::of(&points, Model::of_centres(&points), cheapest_pieces);
            (placement, sorted)
        })
        .collect();
    let least = ways.iter().map(|(_, sorted)| sorted.best.price).fold(f64::INFINITY, f64::min);
    if given.best.price - least < IMPLAUSIBLE {
        return None;
    }
    ways.retain(|(_, sorted)| sorted.best.price - least < IMPLAUSIBLE);
    // A cube and its mirror image have edges and corners of the same colours, so mirrored and
    // exchanged pictures may explain the same colours. The placement with the fewest faults is
    // believed.
    ways.sort_by_key(|(placement, _)| placement.changes());
    let (first, second) = (ways[0].0.changes(), ways.get(1).map(|(other, _)| other.changes()));
    if second == Some(first) {
        let ways = ways.into_iter().map(|(placement, _)| placement);
        return Some(Undecided::Misfit { ways: ways.filter(|w| w.changes() == first).collect() });
    }
    let (placement, sorted) = ways.swap_remove(0);
    let decision = decide(&placement.put_right(rgb), &placement.put_right(points), sorted).ok()?;
    Some(Undecided::Misplaced { placement, decision: Box::new(decision) })
}

/// Readings of the facelets from two first models: one as it is, one that ignores brightness.
struct Sorted {
    /// Reading with the lower cost.
    best: Reading,
    /// Reading with the higher cost, if its facelets are different.
    rival: Option<Reading>,
}

impl Sorted {
    /// Sorts the facelets from a first model, and from that model without brightness. `sort`
    /// returns the classes of the facelets from the cost of each class for each facelet.
    fn of(points: &Points, model: Model, sort: fn(&[[f64; 6]; 54]) -> [u8; 54]) -> Self {
        // Sorting ends in the optimum that is nearest to its start. From the centres alone, a face
        // in the shade may be read as one of other colours: a checkerboard cube with one dark face
        // was read as solved. Therefore a second start ignores brightness.
        let (near, facelets) = model.clone().sort_and_learn(points, sort);
        let (by_hue, others) = model.by_hue().sort_and_learn(points, sort);
        if facelets == others {
            let nearer = near.cost(points, &facelets) <= by_hue.cost(points, &facelets);
            let best = Reading::of(if nearer { near } else { by_hue }, points);
            return Self { best, rival: None };
        }
        // For each of the two results the best model is fitted, so that their costs can be
        // compared.
        let near = Reading::of(near.fitted_to(points, &facelets), points);
        let by_hue = Reading::of(by_hue.fitted_to(points, &others), points);
        let (best, rival) =
            if near.price <= by_hue.price { (near, by_hue) } else { (by_hue, near) };
        Self { best, rival: Some(rival) }
    }
}

/// Decides the colours of a cube from the readings of its 54 facelets.
///
/// # Errors
/// [`Undecided::Impossible`] if the facelets show clearly that the cube cannot exist.
fn decide(
    rgb: &[[f64; 3]; 54],
    points: &Points,
    Sorted { mut best, rival }: Sorted,
) -> Result<Decision, Undecided> {
    if let Some(refused) = contradiction(points, &best.model, &best.costs, &best.cube) {
        return Err(refused);
    }
    // Where the two readings differ, a facelet is no more certain than the better reading is as a
    // whole.
    if let Some(rival) = rival {
        for (i, margin) in best.cube.margins.iter_mut().enumerate() {
            if rival.cube.facelets[i] != best.cube.facelets[i] {
                *margin = margin.min(rival.price - best.price);
            }
        }
    }
    Ok(conclude(rgb, &best))
}

/// Likeliest cube under one model.
struct Reading {
    /// Model of the colours.
    model: Model,
    /// Cost of each colour for each facelet, in -2 log likelihood.
    costs: [[f64; 6]; 54],
    /// Likeliest cube that can exist.
    cube: Likeliest,
    /// Cost of the cube and the model together, in -2 log likelihood.
    price: f64,
}

impl Reading {
    /// Finds the likeliest cube under a model.
    fn of(model: Model, points: &Points) -> Self {
        let costs = model.costs(points);
        let cube = likeliest(&costs);
        let price = model.cost(points, &cube.facelets);
        Self { model, costs, cube, price }
    }

    /// Returns the strain: by how much the facelets cost less if each has the colour that it looks
    /// like by itself, instead of its colour on the cube (-2 log likelihood).
    fn strain(&self) -> f64 {
        clearness(&self.costs, &one_by_one(&self.costs), &self.cube.facelets)
    }
}

/// Checks whether the facelets show clearly that the cube cannot exist, and returns the refusal if
/// they do. `best` is the likeliest cube that can exist.
///
/// Contested facelets are those whose colour on the likeliest cube is not the one that they look
/// like by themselves. They are compared with classes that are learned from the other facelets
/// alone. Otherwise they would widen these classes, and swapped pieces would look like red and
/// orange facelets that were misread.
fn contradiction(
    points: &Points,
    model: &Model,
    costs: &[[f64; 6]; 54],
    best: &Likeliest,
) -> Option<Undecided> {
    let mut alone = one_by_one(costs);
    let mut best = best.facelets;
    let mut model = model.clone();
    let mut costs = *costs;
    // With classes learned without the contested facelets, other facelets may be contested. The
    // comparison is therefore repeated until they stay the same, at most three times.
    for round in 0..3 {
        let contested: [bool; 54] = std::array::from_fn(|i| alone[i] != best[i]);
        if !contested.contains(&true) {
            return None;
        }
        model.learn(points, &alone, &contested);
        costs = model.costs(points);
        // For most cubes the check ends here, before the slow search for the likeliest cube.
        if clearness(&costs, &alone, &best) < 0.5 * IMPLAUSIBLE {
            return None;
        }
        let (read, next) = (one_by_one(&costs), likeliest(&costs).facelets);
        if round > 0 && read == alone && next == best {
            break;
        }
        (alone, best) = (read, next);
    }
    let square = |i: usize, of: &[u8; 54]| model.square(points, i, usize::from(of[i]));
    let certain = (0..54).filter(|&i| alone[i] == best[i]);
    let farthest = certain.map(|i| square(i, &alone)).fold(0.0, f64::max);
    let evident = |i: usize| {
        let (near, far) = (square(i, &alone), square(i, &best));
        // A facelet that looks like neither colour proves no fault of the cube.
        near <= UNLIKE.max(LIKER * far) && far >= REACH * farthest
    };
    let mut contested = (0..54).filter(|&i| alone[i] != best[i]);
    if clearness(&costs, &alone, &best) < IMPLAUSIBLE || !contested.all(evident) {
        return None;
    }
    let read = as_counted(&costs, alone);
    let reason = impossible(&read)?;
    let doubtful = (0..54).filter(|&i| read[i] != best[i]).collect();
    Some(Undecided::Impossible { reason, facelets: Box::new(read), doubtful })
}

/// Computes by how much the facelets cost more in the colours of the likeliest cube (`best`) than
/// in the colours that they look like by themselves (`alone`), in -2 log likelihood.
fn clearness(costs: &[[f64; 6]; 54], alone: &[u8; 54], best: &[u8; 54]) -> f64 {
    let price = |facelets: &[u8; 54], i: usize| costs[i][usize::from(facelets[i])];
    (0..54).map(|i| price(best, i) - price(alone, i)).sum()
}

/// Completes the likeliest cube to a decision: adds the confidence in each facelet, the doubtful
/// facelets and the names of the colours.
fn conclude(rgb: &[[f64; 3]; 54], Reading { model, costs, cube: best, .. }: &Reading) -> Decision {
    let own = |i: usize| costs[i][usize::from(best.facelets[i])];
    // A difference m of costs in -2 log likelihood is a ratio of likelihoods of exp(-m / 2). A
    // facelet that by itself looks like another colour is less certain by this ratio.
    let margins = std::array::from_fn(|i| {
        let next = (0..6).filter(|&c| c != usize::from(best.facelets[i])).map(|c| costs[i][c]);
        let alone = next.fold(f64::INFINITY, f64::min) - own(i);
        let forced = if alone < 0.0 { (0.5 * alone).exp() } else { 1.0 };
        forced * (1.0 - (-0.5 * best.margins[i]).exp())
    });
    let mut doubtful: Vec<usize> = (0..54).filter(|&i| margins[i] < DOUBTFUL).collect();
    doubtful.sort_by(|&a, &b| margins[a].total_cmp(&margins[b]));
    // The names are decided under one light, so each face is divided by its own gain.
    let light = model.light();
    let even = |i: usize| rgb[i].map(|v| to_linear(v) / light[i / 9]);
    let names = name(&std::array::from_fn(even), &best.facelets);
    Decision {
        colours: best.facelets.map(|c| names[usize::from(c)]),
        facelets: best.facelets,
        margins,
        doubtful,
    }
}

/// Returns the cheapest class of each facelet, without regard to the other facelets. The centres
/// keep their own classes.
fn one_by_one(costs: &[[f64; 6]; 54]) -> [u8; 54] {
    let mut facelets = costs.map(|c| least(&c) as u8);
    for (face, &centre) in CENTRES.iter().enumerate() {
        facelets[centre] = face as u8;
    }
    facelets
}

/// Returns the cheapest classes of the facelets with nine facelets in each class. If these cost far
/// more than `alone`, the cheapest class of each facelet by itself, the cube really does not have
/// nine facelets of each colour, and `alone` is returned.
fn as_counted(costs: &[[f64; 6]; 54], alone: [u8; 54]) -> [u8; 54] {
    let counted = nine_of_each(costs);
    let price =
        |facelets: &[u8; 54]| -> f64 { (0..54).map(|i| costs[i][usize::from(facelets[i])]).sum() };
    if price(&counted) - price(&alone) > 0.5 * IMPLAUSIBLE { alone } else { counted }
}

/// Returns the cheapest classes of the facelets with nine facelets in each class. The centres keep
/// their own classes.
fn nine_of_each(costs: &[[f64; 6]; 54]) -> [u8; 54] {
    // Each colour has nine columns of the assignment. A prohibitive cost keeps the centres in their
    // own classes.
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
    std::array::from_fn(|i| (columns[i] / 9) as u8)
}

/// Returns the reason why facelets are no cube, or `None` if they are one.
fn impossible(facelets: &[u8; 54]) -> Option<ImpossibleCube> {
    Cube::try_from(Facelets::try_from(*facelets).ok()?).err()
}

/// Returns the index of the least value; the first of several equal ones.
fn least(values: &[f64; 6]) -> usize {
    (0..6).fold(0, |best, i| if values[i] < values[best] { i } else { best })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Colours of a common cube's stickers (sRGB, 0..=255) in the order URFDLB.
    const STICKERS: [[f64; 3]; 6] = [
        [235.0, 235.0, 235.0],
        [183.0, 18.0, 52.0],
        [0.0, 155.0, 72.0],
        [255.0, 213.0, 0.0],
        [255.0, 88.0, 0.0],
        [0.0, 70.0, 173.0],
    ];

    /// Returns the colours of a cube under coloured light, with shading that differs by face.
    fn measured(state: &[u8; 54], gains: [f64; 3]) -> [[f64; 3]; 54] {
        std::array::from_fn(|i| {
            let shade = 0.75 + 0.05 * (i / 9) as f64 + 0.01 * (i % 9) as f64;
            let p = STICKERS[usize::from(state[i])];
            std::array::from_fn(|c| (p[c] * shade * gains[c] + 6.0).min(255.0))
        })
    }

    /// Returns the facelets of a scrambled cube.
    fn scrambled(seed: u64) -> [u8; 54] {
        *Facelets::from(&Cube::scrambled(seed)).colours()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn decide_reads_cube_in_coloured_light(
            seed in 0u64..1000, blue in 0.6..1.0, green in 0.85..1.0
        ) {
            let truth = scrambled(seed);

            let decision = decide_cube(&measured(&truth, [1.0, green, blue])).unwrap();

            prop_assert_eq!(decision.facelets, truth);
            prop_assert_eq!(decision.colours, truth);
            prop_assert!(decision.doubtful.is_empty(), "{:?}", decision.doubtful);
        }

        /// Any 54 colours give a cube that can exist, or a reason. Up to a third of the stickers of
        /// a cube are mixed with any other colour.
        #[test]
        fn decide_never_returns_impossible_cube(
            seed in 0u64..1000,
            spoilt in proptest::collection::vec((0..54usize, 0..6usize, 0.0..1.0f64), 0..18)
        ) {
            let mut rgb = measured(&scrambled(seed), [1.0; 3]);
            for (i, colour, share) in spoilt {
                rgb[i] = std::array::from_fn(|c| {
                    (1.0 - share) * rgb[i][c] + share * STICKERS[colour][c]
                });
            }

            if let Ok(decision) = decide_cube(&rgb) {
                prop_assert!(Cube::is_possible(&decision.facelets));
                prop_assert!(decision.margins.iter().all(|m| (0.0..=1.0).contains(m)));
            }
        }
    }

    /// Returns the colours `rgb` of a cube as in pictures that are turned, exchanged or mirrored.
    /// `places` is, for each face, the number of its picture and of its clockwise quarter turns.
    fn put_down(rgb: &[[f64; 3]; 54], places: [(usize, usize); 6], mirror: bool) -> [[f64; 3]; 54] {
        let mut given = *rgb;
        for (face, (picture, quarters)) in places.into_iter().enumerate() {
            for tile in 0..9 {
                let (mut row, mut column) = (tile / 3, tile % 3);
                for _ in 0..quarters {
                    (row, column) = (column, 2 - row);
                }
                let column = if mirror { 2 - column } else { column };
                given[9 * picture + 3 * row + column] = rgb[9 * face + tile];
            }
        }
        given
    }

    /// Places of pictures that are all where they belong.
    const UPRIGHT: [(usize, usize); 6] = [(0, 0), (1, 0), (2, 0), (3, 0), (4, 0), (5, 0)];

    /// Checks that a wrong placement of pictures is refused with the fault `told`, and that the
    /// cube is read nevertheless.
    fn check_misplaced(seed: u64, places: [(usize, usize); 6], mirror: bool, told: &str) {
        let truth = scrambled(seed);
        let rgb = put_down(&measured(&truth, [1.0, 0.95, 0.9]), places, mirror);

        match decide_cube(&rgb) {
            Err(Undecided::Misplaced { placement, decision }) => {
                assert_eq!(placement.to_string(), told, "seed {seed}");
                assert_eq!(decision.facelets, truth, "seed {seed}");
            }
            other => panic!("seed {seed}, {told}: {other:?}"),
        }
    }

    #[test]
    fn each_picture_turned_alone_is_named_and_corrected() {
        let turns =
            ["turned clockwise by a quarter", "upside down", "turned anticlockwise by a quarter"];
        for seed in 0..6 {
            for face in 0..6 {
                for (told, quarters) in turns.iter().zip(1..) {
                    let mut places = UPRIGHT;
                    places[face].1 = quarters;
                    let letter = Face::ALL[face].letter();
                    let told = format!("the picture of face {letter} is {told}");
                    check_misplaced(seed, places, false, &told);
                }
            }
        }
    }

    #[test]
    fn exchanged_pictures_are_named_and_corrected() {
        for seed in 0..6 {
            for (a, b) in [(1, 2), (0, 4), (3, 5), (4, 5)] {
                let mut places = UPRIGHT;
                places.swap(a, b);
                let [a, b] = [a, b].map(|face: usize| Face::ALL[face].letter());
                let told = format!("the pictures of faces {a} and {b} are exchanged");
                check_misplaced(seed, places, false, &told);
            }
        }
    }

    #[test]
    fn mirrored_pictures_are_named_and_corrected() {
        for seed in 0..6 {
            check_misplaced(seed, UPRIGHT, true, "every picture is mirrored");
        }
    }

    #[test]
    fn three_turned_pictures_are_named_and_corrected() {
        let places = [(0, 0), (1, 1), (2, 0), (3, 0), (4, 1), (5, 3)];
        let told = "the picture of face R is turned clockwise by a quarter; \
            the picture of face L is turned clockwise by a quarter; \
            the picture of face B is turned anticlockwise by a quarter";
        check_misplaced(3, places, false, told);
    }

    /// Two facelets that look more like each other's colour are read correctly, since no other cube
    /// can exist, and are reported as doubtful.
    #[test]
    fn exchanged_facelet_colours_are_corrected_and_reported_doubtful() {
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
    fn wrongly_assembled_cube_is_refused_with_reason() {
        let read = |state: &[u8; 54]| match decide_cube(&measured(state, [1.0, 0.95, 0.9])) {
            Err(Undecided::Impossible { reason, facelets, doubtful }) => {
                (reason, *facelets, doubtful)
            }
            other => panic!("{other:?}"),
        };
        let truth = scrambled(11);

        // The two stickers of the edge UR are exchanged.
        let mut flipped = truth;
        flipped.swap(5, 10);
        let (reason, facelets, _) = read(&flipped);
        assert!(matches!(reason, ImpossibleCube::EdgeFlipped { .. }), "{reason}");
        assert_eq!(facelets, flipped);

        // The three stickers of the corner URF go around.
        let mut twisted = truth;
        (twisted[8], twisted[9], twisted[20]) = (truth[9], truth[20], truth[8]);
        let (reason, _, doubtful) = read(&twisted);
        assert!(matches!(reason, ImpossibleCube::CornerTwisted { .. }));
        assert!(doubtful.len() >= 3);

        // The edges UR and UF are exchanged.
        let mut swapped = truth;
        swapped.swap(5, 7);
        swapped.swap(10, 19);
        assert!(matches!(read(&swapped).0, ImpossibleCube::Swapped { .. }));

        let mut painted = truth;
        painted[0] = (truth[0] + 1) % 6;
        assert!(matches!(read(&painted).0, ImpossibleCube::ColourCount { .. }));
    }

    /// Returns the colours that a camera measures, with shading that differs by face and from
    /// facelet to facelet, haze and noise.
    fn noisy(state: &[u8; 54], seed: u64, noise: f64) -> [[f64; 3]; 54] {
        use rand::{Rng, SeedableRng};
        let mut random = rand_pcg::Pcg64::seed_from_u64(seed);
        let light: [f64; 3] = [0.0; 3].map(|_: f64| random.random_range(0.85..1.0));
        let faces: [f64; 6] = [0.0; 6].map(|_: f64| random.random_range(0.75..1.0));
        let normal = rand_distr::Normal::new(0.0, 1.0).unwrap();
        let mut gauss = move || random.sample(normal);
        std::array::from_fn(|i| {
            let shade = faces[i / 9] * (1.0 + 0.02 * gauss());
            let p = STICKERS[usize::from(state[i])];
            std::array::from_fn(|c| {
                (p[c] * shade * light[c] + 5.0 + noise * gauss()).clamp(0.0, 255.0)
            })
        })
    }

    /// Returns the indices of the facelets of the corner or edge that lies on these faces.
    fn places(faces: &[Face]) -> Vec<usize> {
        let mut cell = [0i8; 3];
        for face in faces {
            (0..3).for_each(|k| cell[k] += face.normal()[k] as i8);
        }
        faces.iter().map(|&face| crate::cube::facelet_at(cell, face)).collect()
    }

    /// With noise, cubes that can exist are read correctly, and wrongly assembled cubes are refused
    /// with the right reason.
    #[test]
    fn noisy_legal_cubes_are_read_impossible_ones_refused() {
        use crate::cube::{CORNERS, EDGES};
        const TRIALS: u64 = 12;
        // `Spoil` makes a fault in the cube of a trial, `Named` checks whether a refusal names it.
        type Spoil = fn(&mut [u8; 54], usize);
        type Named = fn(&ImpossibleCube) -> bool;
        // Each entry is a fault, the check of its name, and the least number of trials in which it
        // must be refused. Red and orange may be so near that two swapped pieces look like two
        // misread stickers.
        let kinds: [(Spoil, Named, u64); 5] = [
            (
                |f, n| {
                    let p = places(&EDGES[n % 12]);
                    f.swap(p[0], p[1]);
                },
                |r| matches!(r, ImpossibleCube::EdgeFlipped { .. }),
                TRIALS,
            ),
            (
                |f, n| {
                    let p = places(&CORNERS[n % 8]);
                    f.swap(p[0], p[1]);
                    f.swap(p[1], p[2]);
                },
                |r| matches!(r, ImpossibleCube::CornerTwisted { .. }),
                TRIALS,
            ),
            (
                |f, n| {
                    let (p, q) = (places(&EDGES[n % 12]), places(&EDGES[(n + 1 + n % 11) % 12]));
                    (0..2).for_each(|k| f.swap(p[k], q[k]));
                },
                |r| matches!(r, ImpossibleCube::Swapped { .. }),
                TRIALS - 2,
            ),
            (
                |f, n| {
                    let (p, q) = (places(&CORNERS[n % 8]), places(&CORNERS[(n + 1 + n % 7) % 8]));
                    (0..3).for_each(|k| f.swap(p[k], q[k]));
                },
                |r| matches!(r, ImpossibleCube::Swapped { .. }),
                TRIALS - 2,
            ),
            (
                // One piece replaces another, so that the colours are no longer nine each.
                |f, n| {
                    let (p, q) = (places(&EDGES[n % 12]), places(&EDGES[(n + 1 + n % 11) % 12]));
                    (0..2).for_each(|k| f[p[k]] = f[q[k]]);
                },
                |r| matches!(r, ImpossibleCube::ColourCount { .. }),
                TRIALS,
            ),
        ];
        for noise in [1.0, 3.0] {
            for trial in 0..TRIALS {
                let truth = scrambled(100 + trial);
                let read = decide_cube(&noisy(&truth, trial, noise)).unwrap();
                assert_eq!(read.facelets, truth, "noise {noise}, trial {trial}");
            }
            for (kind, (spoil, named, least)) in kinds.iter().enumerate() {
                let mut refused = 0;
                for trial in 0..TRIALS {
                    let mut state = scrambled(200 + trial);
                    spoil(&mut state, trial as usize);
                    match decide_cube(&noisy(&state, trial, noise)) {
                        Err(Undecided::Impossible { reason, facelets, .. }) => {
                            assert!(named(&reason), "kind {kind}, trial {trial}: {reason}");
                            assert_eq!(*facelets, state);
                            refused += 1;
                        }
                        // If another cube is read, the facelets that differ are at least doubtful.
                        Ok(read) => {
                            let wrong = (0..54).filter(|&i| read.facelets[i] != state[i]);
                            assert!(wrong.clone().all(|i| read.doubtful.contains(&i)));
                        }
                        Err(other) => panic!("kind {kind}, trial {trial}: {other}"),
                    }
                }
                assert!(refused >= *least, "kind {kind}, noise {noise}: {refused} of {TRIALS}");
            }
        }
    }

    #[test]
    fn equal_centres_nan_and_grey_readings_are_refused() {
        let mut rgb = measured(&scrambled(3), [1.0; 3]);
        rgb[13] = rgb[4];
        assert!(matches!(
            decide_cube(&rgb),
            Err(Undecided::SameCentres { overexposed: false, .. })
        ));

        // The centres are white and yellow in far too much light.
        (rgb[4], rgb[31]) = ([247.0, 253.0, 253.0], [247.0, 251.0, 250.0]);
        rgb[13] = [183.0, 18.0, 52.0];
        assert!(matches!(decide_cube(&rgb), Err(Undecided::SameCentres { overexposed: true, .. })));

        rgb[13][0] = f64::NAN;
        assert_eq!(decide_cube(&rgb), Err(Undecided::NotANumber(13)));

        let grey = std::array::from_fn(|i| [20.0 + 4.0 * i as f64; 3]);
        assert_eq!(decide_cube(&grey), Err(Undecided::NoColour));
    }
}
