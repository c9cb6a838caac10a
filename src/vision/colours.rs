//! Colours: mean RGB of tiles -> the six colours, with a margin each.
//!
//! One face alone is read against prototypes of the six colours under the light that explains it best.
//! A whole cube needs no prototypes to be sorted: its centres anchor six classes, each takes exactly nine
//! facelets at the least total distance in Lab, and the class means follow their members.
//!
//! - in: mean RGB of tiles, 0..=255, as in the image (sRGB)
//! - out: colours 0..=5 = white, red, green, yellow, orange, blue (URFDLB); confidences or margins
//! - source: von Kries gains and CIE 1976 L*a*b*; exact assignment after Kuhn (1955)

use super::assignment::assign;
use nalgebra::{Matrix3, Vector3};

/// Letters of the colours 0..=5.
pub const LETTERS: [char; 6] = ['W', 'R', 'G', 'Y', 'O', 'B'];

/// What a person calls by each name: hue and its spread [deg], brightness of the strongest channel (80, 42, 32,
/// 75, 62 and 36 % of a perfect white, as logarithms). The hue is that of [`Shade`]; white has none.
const PROTOTYPES: [Prototype; 6] = [
    Prototype { hue: None, log_value: -0.223 },
    Prototype { hue: Some((-4.0, 8.0)), log_value: -0.868 },
    Prototype { hue: Some((128.0, 20.0)), log_value: -1.139 },
    Prototype { hue: Some((54.0, 10.0)), log_value: -0.288 },
    Prototype { hue: Some((20.0, 7.0)), log_value: -0.478 },
    Prototype { hue: Some((215.0, 16.0)), log_value: -1.022 },
];

#[derive(Debug, Clone, Copy)]
struct Prototype {
    hue: Option<(f64, f64)>,
    log_value: f64,
}

/// Gains of red and blue against green that the light may have (log spaced; prior s.d. 0.25 in log).
const GAINS: [f64; 7] = [0.6, 0.72, 0.85, 1.0, 1.18, 1.4, 1.65];

/// Level of the brightest channel of the brightest tile once the exposure is set right.
const EXPOSURES: [f64; 4] = [1.0, 0.75, 0.5, 0.3];

/// What the light did to the tiles: factors that undo it, on linear RGB.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Light([f64; 3]);

/// The colours of one face by itself, and a confidence for each, 0..=1.
#[must_use]
pub fn decide_face(rgb: &[[f64; 3]; 9]) -> ([u8; 9], [f64; 9]) {
    let linear: Vec<[f64; 3]> = rgb.iter().map(|c| c.map(to_linear)).collect();
    let (light, _) = fit_light(&linear, |distances| {
        distances.iter().map(|d| d.iter().copied().fold(16.0, f64::min)).sum()
    });
    let mut colours = [0; 9];
    let mut confidences = [0.0; 9];
    for (i, tile) in linear.iter().enumerate() {
        let d = prototype_distances(light.undo(*tile));
        let best = least(&d);
        let weight: f64 = d.iter().map(|x| (-0.5 * (x - d[best])).exp()).sum();
        colours[i] = best as u8;
        // A tile that resembles no colour is not certain, however lonely the best guess is.
        confidences[i] = (-(d[best] / 30.0)).exp() / weight;
    }
    (colours, confidences)
}

/// The light under which the tiles look most like the six colours; `judge` turns the squared distances of
/// all tiles to all colours into one cost.
fn fit_light(linear: &[[f64; 3]], judge: impl Fn(&[[f64; 6]]) -> f64) -> (Light, f64) {
    let mut best = ([1.0; 3], Light([1.0; 3]), f64::INFINITY);
    let mut distances = vec![[0.0; 6]; linear.len()];
    let mut tones = vec![Tone::default(); linear.len()];
    let mut attempt = |gains: [f64; 3], best: &mut ([f64; 3], Light, f64)| {
        let brightest = linear
            .iter()
            .map(|t| (0..3).map(|c| t[c] * gains[c]).fold(0.0, f64::max))
            .fold(1e-4, f64::max);
        let even = Light(gains.map(|g| g / brightest));
        for (tone, tile) in tones.iter_mut().zip(linear) {
            *tone = Tone::new(even.undo(*tile), &[0.0; 6], 1.0);
        }
        let prior = (gains[0].ln() / 0.25).powi(2) + (gains[2].ln() / 0.25).powi(2);
        for exposure in EXPOSURES {
            let light = Light(even.0.map(|g| g * exposure));
            for (d, tone) in distances.iter_mut().zip(&tones) {
                *d = tone.distances(exposure);
            }
            let cost = judge(&distances) + prior;
            if cost < best.2 {
                *best = (gains, light, cost);
            }
        }
    };
    for red in GAINS {
        for blue in GAINS {
            attempt([red, 1.0, blue], &mut best);
        }
    }
    // Half a step, and a quarter, around the best: pale tiles feel an error of the light of 5 %.
    for step in [1.08, 1.04] {
        let [red, _, blue] = best.0;
        for r in [red / step, red, red * step] {
            for b in [blue / step, blue, blue * step] {
                attempt([r, 1.0, b], &mut best);
            }
        }
    }
    (best.1, best.2)
}

impl Light {
    fn undo(self, linear: [f64; 3]) -> [f64; 3] {
        [linear[0] * self.0[0], linear[1] * self.0[1], linear[2] * self.0[2]]
    }
}

/// A tile as hue, saturation and value of linear light. Glare adds white light, which takes from the
/// saturation but leaves this hue as it is; the hue of Lab, or of coded values, would turn with it.
#[derive(Debug, Clone, Copy)]
struct Shade {
    /// In degrees -30..330, with the root of the middle channel's share: red, orange and yellow, which lie
    /// within 60 deg, are spread evenly by it.
    hue: f64,
    saturation: f64,
    value: f64,
}

impl Shade {
    fn new([r, g, b]: [f64; 3]) -> Self {
        let (high, low) = (r.max(g).max(b), r.min(g).min(b));
        let range = (high - low).max(1e-6);
        let share = |middle: f64| 60.0 * ((middle - low) / range).max(0.0).sqrt();
        let hue = if high == r {
            if g >= b { share(g) } else { -share(b) }
        } else if high == g {
            if r >= b { 120.0 - share(r) } else { 120.0 + share(b) }
        } else if g >= r {
            240.0 - share(g)
        } else {
            240.0 + share(r)
        };
        Self { hue, saturation: (high - low) / high.max(1e-6), value: high }
    }
}

/// A tile against each prototype, but for the exposure.
#[derive(Debug, Clone, Copy, Default)]
struct Tone {
    /// Squared distances of hue, and of saturation for white.
    chroma: [f64; 6],
    /// Logarithm of the value: as white, and of the coloured part alone.
    value: [f64; 2],
    /// Light that is common to the channels.
    grey: f64,
}

/// Mean share of white light that lies on a coloured tile (haze, glare), of what white reflects.
const GLARE: f64 = 0.12;

/// Saturation that a tint of the light which was not undone gives to white.
const TINT: f64 = 0.15;

impl Tone {
    fn new(linear: [f64; 3], shift: &[f64; 6], sharpness: f64) -> Self {
        let shade = Shade::new(linear);
        // The paler a tile, the more an error of the light turns its hue.
        let blur = 12.0 * (1.0 / shade.saturation.max(0.05) - 1.0);
        let chroma = std::array::from_fn(|c| match PROTOTYPES[c].hue {
            None => (shade.saturation / TINT).powi(2),
            Some((hue, spread)) => {
                let turn = (shade.hue - hue - shift[c] + 180.0).rem_euclid(360.0) - 180.0;
                turn * turn / ((spread * sharpness).powi(2) + blur * blur)
            }
        });
        // Of a coloured tile only the coloured light counts: the rest is glare.
        let value = [1.0, shade.saturation].map(|own| (shade.value * own).max(1e-4).ln());
        Self { chroma, value, grey: shade.value * (1.0 - shade.saturation) }
    }

    /// Squared distance to each prototype in units of its spread, after an exposure.
    fn distances(&self, exposure: f64) -> [f64; 6] {
        let log_exposure = exposure.ln();
        // Glare has an exponential distribution: what is nearly as bright as white all over is white.
        let glare = 2.0 * (self.grey * exposure / 0.8) / GLARE;
        std::array::from_fn(|c| {
            let p = &PROTOTYPES[c];
            let coloured = p.hue.is_some();
            let value = self.value[usize::from(coloured)] + log_exposure;
            let pale = if coloured { glare } else { 0.0 };
            self.chroma[c] + pale + ((value - p.log_value) / 0.6).powi(2).min(9.0)
        })
    }
}

/// Squared distance to each prototype in units of its spread.
fn prototype_distances(linear: [f64; 3]) -> [f64; 6] {
    Tone::new(linear, &[0.0; 6], 1.0).distances(1.0)
}

/// Linear light 0..=1 of an sRGB level 0..=255.
fn to_linear(level: f64) -> f64 {
    let v = (level / 255.0).clamp(0.0, 1.0);
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// CIE L*a*b* (D65) of linear RGB.
fn lab(rgb: [f64; 3]) -> [f64; 3] {
    let [r, g, b] = rgb;
    let f = |t: f64| {
        if t > 0.008856 { t.cbrt() } else { 7.787 * t + 16.0 / 116.0 }
    };
    let x = f((0.4124 * r + 0.3576 * g + 0.1805 * b) / 0.9505);
    let y = f(0.2126 * r + 0.7152 * g + 0.0722 * b);
    let z = f((0.0193 * r + 0.1192 * g + 0.9505 * b) / 1.089);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

fn least(values: &[f64]) -> usize {
    (0..values.len()).fold(0, |best, i| if values[i] < values[best] { i } else { best })
}

/// A whole cube, decided.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// Colour of each facelet, 0..=5 = white, red, green, yellow, orange, blue.
    pub colours: [u8; 54],
    /// Face (0..=5 = URFDLB) whose centre has each facelet's colour: independent of the colours' names.
    pub facelets: [u8; 54],
    /// How much nearer a facelet is to its own class than to the next one, -1..=1; below 0 the counts
    /// forced it into its class.
    pub margins: [f64; 54],
    /// Facelets with a small margin, or that a legal cube forced to change, least certain first.
    pub doubtful: Vec<usize>,
}

/// No decision.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Undecided {
    /// A measured value is not a number.
    #[error("facelet {0} has no colour: not a number")]
    NotANumber(usize),
    /// Two centres cannot be told apart.
    #[error("the centres of faces {} and {} have the same colour", face_letter(*first), face_letter(*second))]
    SameCentres {
        /// Face 0..=5 = URFDLB.
        first: usize,
        /// The other.
        second: usize,
    },
    /// No cube near the measurement can exist.
    #[error(
        "no cube near the measured colours can exist: {tried} were tried; doubtful facelets: {doubtful:?}"
    )]
    Impossible {
        /// Cubes that were tried.
        tried: usize,
        /// Facelets with a small margin, least certain first.
        doubtful: Vec<usize>,
    },
}

/// Letter of a face 0..=5.
#[must_use]
pub fn face_letter(face: usize) -> char {
    ['U', 'R', 'F', 'D', 'L', 'B'][face]
}

/// Facelets with a smaller margin are doubtful.
const DOUBTFUL: f64 = 0.2;

/// Weight of lightness against a* and b*: shading changes it most.
const LIGHTNESS: f64 = 0.4;

/// Index of the centre of each face.
const CENTRES: [usize; 6] = [4, 13, 22, 31, 40, 49];

/// Decides all 54 facelets (order URFDLB, reading order) from their mean RGB, 0..=255. `legal` is asked
/// whether a cube (face 0..=5 of each facelet) can exist.
///
/// # Errors
/// [`Undecided`] when the input is not a cube's, or when no legal cube is near.
pub fn decide_cube(
    rgb: &[[f64; 3]; 54],
    legal: &dyn Fn(&[u8; 54]) -> bool,
) -> Result<Decision, Undecided> {
    if let Some(i) = rgb.iter().position(|c| c.iter().any(|v| !v.is_finite())) {
        return Err(Undecided::NotANumber(i));
    }
    let linear: [[f64; 3]; 54] = rgb.map(|c| c.map(to_linear));

    // Sorted in the light as it is, named, then sorted again in the light that the names imply.
    let first = sort(&white_balanced(&linear, None));
    let (_, light) = name(&linear, &first.class);
    let balanced = white_balanced(&linear, Some(light));
    let points = whitened(&balanced, &sort(&balanced));
    let second = sort(&points);
    for a in 0..6 {
        for b in a + 1..6 {
            if distance2(&second.means[a], &second.means[b]) < 1.0 {
                return Err(Undecided::SameCentres { first: a, second: b });
            }
        }
    }

    let mut class = second.class;
    let margins: [f64; 54] = std::array::from_fn(|i| second.margin(&points[i], class[i]));
    let mut doubtful: Vec<usize> = (0..54).filter(|&i| margins[i] < DOUBTFUL).collect();
    doubtful.sort_by(|&a, &b| margins[a].total_cmp(&margins[b]));
    if !legal(&class) {
        let (repaired, tried) = repair(&points, &second, legal);
        let Some(repaired) = repaired else {
            return Err(Undecided::Impossible { tried, doubtful });
        };
        let changed: Vec<usize> =
            (0..54).filter(|&i| repaired[i] != class[i] && !doubtful.contains(&i)).collect();
        doubtful.extend(changed);
        class = repaired;
    }
    let (names, _) = name(&linear, &class);
    Ok(Decision {
        colours: class.map(|c| names[usize::from(c)]),
        facelets: class,
        margins: std::array::from_fn(|i| second.margin(&points[i], class[i])),
        doubtful,
    })
}

/// Lab with lightness weighted down, after the light is undone; without a light, after the brightest
/// channel is brought to 1.
fn white_balanced(linear: &[[f64; 3]; 54], light: Option<Light>) -> [[f64; 3]; 54] {
    let brightest = linear.iter().flatten().copied().fold(1e-4, f64::max);
    let light = light.unwrap_or(Light([1.0 / brightest; 3]));
    linear.map(|t| {
        let [l, a, b] = lab(light.undo(t));
        let whole = 70.0 / (l + 16.0);
        [LIGHTNESS * l, a * whole, b * whole]
    })
}

/// The points in units of the spread that the classes have in common: shading spreads them along one
/// direction much more than along the others, and that direction is the data's to tell.
fn whitened(points: &[[f64; 3]; 54], sorting: &Sorting) -> [[f64; 3]; 54] {
    // A prior of some facelets with a spread of 5 units keeps a perfect picture from being divided by zero.
    const PRIOR: f64 = 18.0;
    let mut scatter = Matrix3::identity() * (PRIOR * 25.0);
    for (point, class) in points.iter().zip(&sorting.class) {
        let d = Vector3::from(*point) - Vector3::from(sorting.means[usize::from(*class)]);
        // A facelet far off is a reflection or in the wrong class: it must not shape the metric.
        let weight = 1.0 / (1.0 + d.norm_squared() / 400.0);
        scatter += weight * d * d.transpose();
    }
    let Some(factor) = (scatter / (54.0 + PRIOR)).cholesky() else { return *points };
    points.map(|p| {
        let w = factor.l().solve_lower_triangular(&Vector3::from(p)).unwrap_or_default();
        [w.x, w.y, w.z]
    })
}

/// Six classes of nine.
#[derive(Debug, Clone)]
struct Sorting {
    /// Class of each facelet: the face whose centre is in it.
    class: [u8; 54],
    means: [[f64; 3]; 6],
    cost: f64,
}

impl Sorting {
    /// (next best - own) / (next best + own) in distances to class means.
    fn margin(&self, point: &[f64; 3], class: u8) -> f64 {
        let own = distance2(point, &self.means[usize::from(class)]).sqrt();
        let next = (0..6)
            .filter(|&c| c != usize::from(class))
            .map(|c| distance2(point, &self.means[c]).sqrt())
            .fold(f64::INFINITY, f64::min);
        (next - own) / (next + own).max(1e-9)
    }
}

fn distance2(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|c| (a[c] - b[c]).powi(2)).sum()
}

/// Nine facelets to each class at the least total squared distance, centres in six different classes.
fn sort(points: &[[f64; 3]; 54]) -> Sorting {
    let mut means: [[f64; 3]; 6] = CENTRES.map(|c| points[c]);
    let mut best: Option<Sorting> = None;
    for _ in 0..8 {
        let mut cost = vec![0.0; 54 * 54];
        for (i, point) in points.iter().enumerate() {
            for class in 0..6 {
                let fixed = CENTRES.iter().position(|&c| c == i);
                let value = match fixed {
                    Some(own) if own == class => 0.0,
                    Some(_) => 1e9,
                    // Beyond three just noticeable hues all is equally wrong: glare must not pull.
                    None => distance2(point, &means[class]).min(1e5),
                };
                cost[i * 54 + class * 9..i * 54 + class * 9 + 9].fill(value);
            }
        }
        let columns = assign(&cost, 54);
        let class: [u8; 54] = std::array::from_fn(|i| (columns[i] / 9) as u8);
        let total = (0..54).map(|i| distance2(&points[i], &means[usize::from(class[i])])).sum();
        let settled = best.as_ref().is_some_and(|b| b.class == class);
        means = std::array::from_fn(|c| median(points, &class, c as u8));
        best = Some(Sorting { class, means, cost: total });
        if settled {
            break;
        }
    }
    let best = best.unwrap_or(Sorting { class: [0; 54], means, cost: 0.0 });
    debug_assert!(best.cost.is_finite());
    best
}

/// Median of a class in each coordinate: one glaring facelet does not move it.
fn median(points: &[[f64; 3]; 54], class: &[u8; 54], which: u8) -> [f64; 3] {
    std::array::from_fn(|c| {
        let mut values: Vec<f64> =
            (0..54).filter(|&i| class[i] == which).map(|i| points[i][c]).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or(0.0)
    })
}

/// Colour 0..=5 of each class: the permutation and the light under which the classes look most like them.
fn name(linear: &[[f64; 3]; 54], class: &[u8; 54]) -> ([u8; 6], Light) {
    let means: Vec<[f64; 3]> = (0..6).map(|c| median(linear, class, c)).collect();
    let permutation = |d: &[[f64; 6]]| assign(&d.iter().flatten().copied().collect::<Vec<_>>(), 6);
    let (light, _) =
        fit_light(&means, |d| permutation(d).iter().enumerate().map(|(i, &j)| d[i][j]).sum());
    let distances: Vec<[f64; 6]> =
        means.iter().map(|m| prototype_distances(light.undo(*m))).collect();
    let columns = permutation(&distances);
    (std::array::from_fn(|c| columns[c] as u8), light)
}

/// Legal cubes near a sorting that is not: exchanges of one pair, then of two, cheapest first.
fn repair(
    points: &[[f64; 3]; 54],
    sorting: &Sorting,
    legal: &dyn Fn(&[u8; 54]) -> bool,
) -> (Option<[u8; 54]>, usize) {
    let class = &sorting.class;
    let price = |i: usize, c: u8| distance2(&points[i], &sorting.means[usize::from(c)]);
    let mut swaps: Vec<(f64, usize, usize)> = Vec::new();
    for i in 0..54 {
        for j in i + 1..54 {
            if class[i] != class[j] && !CENTRES.contains(&i) && !CENTRES.contains(&j) {
                let extra = price(i, class[j]) + price(j, class[i])
                    - price(i, class[i])
                    - price(j, class[j]);
                swaps.push((extra, i, j));
            }
        }
    }
    swaps.sort_by(|a, b| a.0.total_cmp(&b.0));
    swaps.truncate(60);
    // One exchange, or two, in the order of what they cost together.
    let mut plans: Vec<(f64, Vec<usize>)> =
        swaps.iter().enumerate().map(|(k, s)| (s.0, vec![k])).collect();
    for a in 0..swaps.len() {
        for b in a + 1..swaps.len() {
            plans.push((swaps[a].0 + swaps[b].0, vec![a, b]));
        }
    }
    plans.sort_by(|a, b| a.0.total_cmp(&b.0));
    for (tried, (_, plan)) in plans.iter().enumerate() {
        let mut candidate = *class;
        for &k in plan {
            candidate.swap(swaps[k].1, swaps[k].2);
        }
        if legal(&candidate) {
            return (Some(candidate), tried + 2);
        }
    }
    (None, plans.len() + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stickers of a common cube, sRGB.
    const STICKERS: [[f64; 3]; 6] = [
        [235.0, 235.0, 235.0],
        [183.0, 18.0, 52.0],
        [0.0, 155.0, 72.0],
        [255.0, 213.0, 0.0],
        [255.0, 88.0, 0.0],
        [0.0, 70.0, 173.0],
    ];

    /// A cube whose facelet i has colour `state[i]`, under warm light with shading that differs by face.
    fn measured(state: &[u8; 54], gains: [f64; 3]) -> [[f64; 3]; 54] {
        std::array::from_fn(|i| {
            let shade = 0.75 + 0.05 * (i / 9) as f64 + 0.01 * (i % 9) as f64;
            let p = STICKERS[usize::from(state[i])];
            std::array::from_fn(|c| (p[c] * shade * gains[c] + 6.0).min(255.0))
        })
    }

    fn scrambled() -> [u8; 54] {
        // Any arrangement with nine of each and its centres in place.
        let mut state: [u8; 54] = std::array::from_fn(|i| (i % 6) as u8);
        for (face, &c) in CENTRES.iter().enumerate() {
            let other =
                (0..54).find(|&j| state[j] == face as u8 && !CENTRES[..face].contains(&j)).unwrap();
            state.swap(c, other);
        }
        state
    }

    #[test]
    fn a_cube_in_warm_light_is_sorted_and_named() {
        let state = scrambled();

        let decision = decide_cube(&measured(&state, [1.0, 0.85, 0.6]), &|_| true).unwrap();

        assert_eq!(decision.facelets, state);
        assert_eq!(decision.colours, state);
    }

    #[test]
    fn a_cube_that_cannot_exist_is_repaired_by_the_cheapest_exchange() {
        let truth = scrambled();
        let mut rgb = measured(&truth, [1.0; 3]);
        // A red and an orange facelet that look like each other's colour, a little.
        let (i, j) = (
            (0..54).find(|&i| truth[i] == 1 && !CENTRES.contains(&i)).unwrap(),
            (0..54).find(|&i| truth[i] == 4 && !CENTRES.contains(&i)).unwrap(),
        );
        let (a, b) = (rgb[i], rgb[j]);
        rgb[i] = std::array::from_fn(|c| 0.4 * a[c] + 0.6 * b[c]);
        rgb[j] = std::array::from_fn(|c| 0.6 * a[c] + 0.4 * b[c]);

        let decision = decide_cube(&rgb, &|cube| *cube == truth).unwrap();

        assert_eq!(decision.facelets, truth);
        assert!(decision.doubtful.contains(&i) && decision.doubtful.contains(&j));
    }

    #[test]
    fn an_impossible_cube_is_refused() {
        let rgb = measured(&scrambled(), [1.0; 3]);

        assert!(matches!(decide_cube(&rgb, &|_| false), Err(Undecided::Impossible { .. })));
    }

    #[test]
    fn a_face_is_read_by_itself_in_dim_and_in_warm_light() {
        let face = [0, 1, 2, 3, 4, 5, 4, 1, 0];
        for gains in [[1.0, 1.0, 1.0], [0.4, 0.4, 0.4], [1.0, 0.92, 0.8], [0.85, 0.93, 1.0]] {
            let rgb = std::array::from_fn(|i| {
                let p: [f64; 3] = STICKERS[face[i]];
                std::array::from_fn(|c| p[c] * gains[c])
            });

            let (colours, _) = decide_face(&rgb);

            assert_eq!(colours.map(usize::from), face, "{gains:?}");
        }
    }
}
