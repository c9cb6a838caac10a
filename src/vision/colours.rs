//! Colours of the tiles of one face: mean RGB -> the six colours, with a confidence each.
//!
//! A face is compared with prototypes of the six colours under the light that explains it best. The
//! tiles with a certain colour then show which shade of it this cube has. A whole cube is decided
//! without prototypes, by `whole`.
//!
//! | case | constant | reason |
//! |---|---|---|
//! | channel clips | [`CLIPPED`] | encoders do not leave it at 255 |
//! | colour of the light | `GAINS`, log s.d. 0.25 | from daylight to lamps |
//! | light of one face is unknown | `LIGHT_SPREADS` | not every camera corrects for the light |
//! | exposure | `EXPOSURES` | the brightest tile need not be white |
//! | weakest channel of a sticker | `PALE` | no dye absorbs all light of a channel |
//! | haze on a coloured tile | `GLARE` | adds white light, so that red looks like orange |
//! | white under a tint | `TINT` | the light is estimated only roughly |
//! | shades on one cube | `WITHIN` | makers differ more than the stickers of a cube |
//! | clipped channel | `STRENGTH`, `CHANNEL`, `SHADE` | it shows only a lower bound |
//! | tile clips in all channels | `YELLOW`, `RIM` | its blurred rim shows white or yellow |
//! | tile resembles no colour | squared distance 16 | a finger must not change the light |
//! | confidence of such a tile | falls to 1/e at 30 | the best of bad guesses is not certain |
//!
//! - in: mean RGB of tiles, 0..=255, as in the image (sRGB)
//! - out: colours 0..=5 = white, red, green, yellow, orange, blue (URFDLB), and confidences
//! - source: own work; von Kries gains; CIE 1976 L\*a\*b\*

use std::ops::Range;
use std::sync::LazyLock;

pub use super::placement::Placement;
pub use super::whole::{Decision, Undecided, decide_cube};

/// Letters of the colours 0..=5 = white, red, green, yellow, orange, blue.
pub const LETTERS: [char; 6] = ['W', 'R', 'G', 'Y', 'O', 'B'];

/// Prototypes of the six colours: the hue and its spread (deg), and the brightness of the strongest
/// channel as a logarithm (80, 42, 32, 75, 62 and 36 % of a perfect white). The hue is that of
/// [`Shade`]; white has none.
const PROTOTYPES: [Prototype; 6] = [
    Prototype { hue: None, log_value: -0.223 },
    Prototype { hue: Some((-4.0, 8.0)), log_value: -0.868 },
    Prototype { hue: Some((128.0, 20.0)), log_value: -1.139 },
    Prototype { hue: Some((54.0, 9.0)), log_value: -0.288 },
    Prototype { hue: Some((22.0, 8.0)), log_value: -0.478 },
    Prototype { hue: Some((215.0, 16.0)), log_value: -1.022 },
];

/// Prototype of a colour.
#[derive(Debug, Clone, Copy)]
struct Prototype {
    /// Hue and its standard deviation between makers (deg); `None` for white.
    hue: Option<(f64, f64)>,
    /// Natural logarithm of the strongest channel, in linear light.
    log_value: f64,
}

impl Prototype {
    /// Returns the linear RGB of a tile with the hue and brightness of the prototype: the inverse
    /// of [`Shade::new`].
    fn reflectance(&self) -> [f64; 3] {
        let high = self.log_value.exp();
        let Some((hue, _)) = self.hue else { return [high; 3] };
        let low = PALE * high;
        let sixth = (hue / 120.0).round();
        let middle = low + (high - low) * ((hue - 120.0 * sixth) / 60.0).powi(2);
        let mut rgb = [low; 3];
        let strongest = sixth.rem_euclid(3.0) as usize;
        let second = if hue >= 120.0 * sixth { strongest + 1 } else { strongest + 2 };
        rgb[strongest] = high;
        rgb[second % 3] = middle;
        rgb
    }
}

/// Linear RGB of each prototype.
static REFLECTANCES: LazyLock<[[f64; 3]; 6]> =
    LazyLock::new(|| PROTOTYPES.each_ref().map(Prototype::reflectance));

/// Weakest channel of a coloured sticker as a share of its strongest one.
const PALE: f64 = 0.05;

/// Level, 0..=255, from which on a channel counts as clipped. It is below 255, because encoders of
/// pictures change clipped levels a little.
pub const CLIPPED: f64 = 246.0;

/// Gains of red and of blue, relative to green, that remove the colours of possible lights. They
/// are spaced evenly in their logarithm, whose prior has a standard deviation of 0.25.
const GAINS: [f64; 7] = [0.6, 0.72, 0.85, 1.0, 1.18, 1.4, 1.65];

/// Values that the brightest channel of the brightest tile may have under the right exposure, as
/// shares of a perfect white.
const EXPOSURES: [f64; 4] = [1.0, 0.75, 0.5, 0.3];

/// Colour of a tile as the camera shows it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seen {
    /// Mean colour in linear RGB, 0..=1.
    linear: [f64; 3],
    /// Whether each channel clips: it may have been brighter than the camera can show.
    clipped: [bool; 3],
}

impl Seen {
    /// Converts the mean sRGB levels of a tile, 0..=255, to linear light, and marks clipped
    /// channels.
    fn new(levels: [f64; 3]) -> Self {
        Self { linear: levels.map(to_linear), clipped: levels.map(|v| v >= CLIPPED) }
    }

    /// Makes a tile from linear RGB without a clipped channel.
    pub(super) fn whole(linear: [f64; 3]) -> Self {
        Self { linear, clipped: [false; 3] }
    }

    /// Returns the tile with the colour and the strength of a light removed.
    fn under(&self, light: Light) -> Self {
        Self { linear: light.undo(self.linear), ..*self }
    }

    /// Computes the squared distance of the tile to each of the six prototypes, in units of their
    /// spreads. `shades` are the hues of the colours on this cube.
    ///
    /// A clipped channel gives only a lower bound of the light. The channel is filled in from the
    /// prototype itself, with the strength and the glare that the other channels show.
    fn distances(&self, shades: &Shades) -> [f64; 6] {
        if self.clipped == [false; 3] {
            return Tone::new(self.linear, shades).distances(1.0);
        }
        // For each prototype the filled-in tile is another one, so it is compared only with that
        // prototype.
        std::array::from_fn(|c| {
            let own = REFLECTANCES[c];
            let (shade, glare) = self.explained(&own, PROTOTYPES[c].hue.is_some());
            let whole = std::array::from_fn(|k| {
                let least = self.linear[k];
                if self.clipped[k] { least.max(shade * own[k] + glare) } else { least }
            });
            Tone::of(whole, shades, c..c + 1).distance(c, 1.0, 0.0)
        })
    }

    /// Returns the strength of the light (relative to the prototype) and the glare (linear light)
    /// with which a prototype best explains the channels that do not clip. `own` is the linear RGB
    /// of the prototype; `coloured` is false for white.
    ///
    /// The strength s has a normal prior about 1, and the glare g an exponential prior. The sum of
    /// `w_k (s own_k + g - x_k)^2` over the channels, `((s - 1) / STRENGTH)^2` and
    /// `2 g / (0.8 GLARE)` is least. With the strength alone, red under haze was read as orange.
    fn explained(&self, own: &[f64; 3], coloured: bool) -> (f64, f64) {
        if self.clipped == [true; 3] {
            return (1.0, 0.0);
        }
        // Normal equations of s and g; 0.8 is the reflectance of white, in which glare is given.
        let prior = 1.0 / (STRENGTH * STRENGTH);
        let (mut ss, mut sg, mut gg) = (prior, 0.0, 0.0);
        let (mut xs, mut xg) = (prior, -1.0 / (0.8 * GLARE));
        for k in (0..3).filter(|&k| !self.clipped[k]) {
            let weight = (CHANNEL * self.linear[k] + 0.01).powi(-2);
            ss += weight * own[k] * own[k];
            sg += weight * own[k];
            gg += weight;
            xs += weight * own[k] * self.linear[k];
            xg += weight * self.linear[k];
        }
        // On white, glare and strength cannot be distinguished.
        let glare =
            if coloured { ((xg * ss - xs * sg) / (gg * ss - sg * sg)).max(0.0) } else { 0.0 };
        (((xs - sg * glare) / ss).clamp(SHADE.0, SHADE.1), glare)
    }
}

/// Standard deviation of the strength of a tile's light, relative to that of its prototype.
const STRENGTH: f64 = 0.5;
/// Standard deviation of a channel, as a share of its value.
const CHANNEL: f64 = 0.1;

/// Least logarithm of green divided by blue at the rim of a clipped yellow tile. It is small,
/// because files store colour at half the resolution, and rims are narrow.
const YELLOW: f64 = 0.45;
/// Standard deviation of the logarithm of green divided by blue at a rim, of white and of yellow.
const RIM: f64 = 0.2;

/// Least and greatest strength of the light on a clipped tile, relative to its prototype.
const SHADE: (f64, f64) = (0.4, 2.5);

/// Light, as the factors on linear RGB that remove its effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Light(pub(super) [f64; 3]);

/// Decides the colours of the nine tiles of one face, without its neighbours. Returns the colours,
/// 0..=5 = white, red, green, yellow, orange, blue, and the confidence in each, 0..=1. `rgb` is the
/// mean level of each tile, 0..=255.
///
/// ```
/// use rubik_robot_vision::colours::{LETTERS, decide_face};
///
/// let (white, red, green) = ([220.0, 222.0, 225.0], [170.0, 25.0, 45.0], [15.0, 140.0, 70.0]);
/// let (yellow, orange, blue) = ([235.0, 200.0, 25.0], [240.0, 95.0, 20.0], [15.0, 65.0, 160.0]);
/// let tiles = [white, red, green, yellow, orange, blue, white, red, green];
/// let (colours, confidences) = decide_face(&tiles);
/// let letters = colours.map(|colour| LETTERS[usize::from(colour)]);
/// assert_eq!(letters.iter().collect::<String>(), "WRGYOBWRG");
/// assert!(confidences.iter().all(|sure| *sure > 0.9));
/// ```
#[must_use]
pub fn decide_face(rgb: &[[f64; 3]; 9]) -> ([u8; 9], [f64; 9]) {
    decide_face_with(rgb, &[None; 9])
}

/// Decides the colours of a face like [`decide_face`]. `rims` has the hue of the blurred rim of
/// each tile that clips in all channels, as linear RGB of any strength; `None` if it is unknown.
pub(super) fn decide_face_with(
    rgb: &[[f64; 3]; 9],
    rims: &[Option<[f64; 3]>; 9],
) -> ([u8; 9], [f64; 9]) {
    let seen = rgb.map(Seen::new);
    // The cost of a tile is bounded by 16, so that a finger or a logo does not change the light.
    let (light, _) = fit_light(&seen, |distances| {
        distances.iter().map(|d| d.iter().copied().fold(16.0, f64::min)).sum()
    });
    let tiles = seen.map(|tile| tile.under(light));
    let shades = Shades::of(&tiles);
    // A lack of blue: the logarithm of green divided by blue at each rim. White is not bluer than
    // the light, so a rim that seems bluer shows an error of the estimated light, which is
    // subtracted.
    let lacks = rims.map(|rim| {
        let [_, green, blue] = light.undo(rim?);
        Some((green.max(1e-6) / blue.max(1e-6)).ln())
    });
    let bluest = lacks.iter().flatten().copied().fold(0.0, f64::min);
    let mut colours = [0; 9];
    let mut confidences = [0.0; 9];
    for (i, tile) in tiles.iter().enumerate() {
        let mut d = tile.distances(&shades);
        // White and yellow look alike where they clip, but not at their rims.
        if let Some(lack) = lacks[i].map(|lack| lack - bluest) {
            d[0] = (lack / RIM).powi(2);
            d[3] = 1.0 + ((YELLOW - lack).max(0.0) / RIM).powi(2);
        }
        let best = least(&d);
        let weight: f64 = d.iter().map(|x| (-0.5 * (x - d[best])).exp()).sum();
        colours[i] = best as u8;
        // A tile that resembles no colour is uncertain, even if all other colours are farther away.
        confidences[i] = (-(d[best] / 30.0)).exp() / weight;
    }
    if is_colourless(rgb) {
        return (colours, [0.0; 9]);
    }
    // A single face seldom determines its light: white in the light of a lamp looks like yellow in
    // daylight.
    let under_any_light = over_all_lights(&seen);
    for (i, confidence) in confidences.iter_mut().enumerate() {
        // The rim of a tile that clips in all channels shows more than its mean colour.
        if rims[i].is_none() {
            *confidence = confidence.min(under_any_light[i][usize::from(colours[i])]);
        }
    }
    (colours, confidences)
}

/// Number of steps of the gains of red and of blue in [`over_all_lights`], up and down from 1.
const LIGHT_STEPS: i32 = 6;
/// Logarithm of the factor of one such step. All steps reach from 0.34 to 2.9.
const LIGHT_STEP: f64 = 0.18;

/// Standard deviations of the logarithm of a light's gains: for a camera that corrects for the
/// light, and for one that does not. Both are assumed to be equally likely.
const LIGHT_SPREADS: [f64; 2] = [0.25, 1.0];

/// Cost of a tile that resembles no colour under a light, in -2 log likelihood.
const NO_COLOUR: f64 = 25.0;

/// Difference of costs, in -2 log likelihood, from which on a light has no weight beside the best.
const NO_WEIGHT: f64 = 30.0;

/// Computes the probability of each colour for each tile of a face, as the mean over all lights
/// that are possible. Each light is weighted by its prior and by the likelihood of the nine tiles
/// under it.
fn over_all_lights(seen: &[Seen; 9]) -> [[f64; 6]; 9] {
    let normal = |x: f64, spread: f64| (-0.5 * (x / spread).powi(2)).exp() / spread;
    let gains = || (-LIGHT_STEPS..=LIGHT_STEPS).map(|step| LIGHT_STEP * f64::from(step));
    let (mut sum, mut weights, mut least) = ([[0.0; 6]; 9], 0.0, f64::INFINITY);
    for (red, blue) in gains().flat_map(|red| gains().map(move |blue| (red, blue))) {
        let prior: f64 = LIGHT_SPREADS.iter().map(|s| normal(red, *s) * normal(blue, *s)).sum();
        let gains = [red.exp(), 1.0, blue.exp()];
        let brightest = seen
            .iter()
            .map(|tile| (0..3).map(|c| tile.linear[c] * gains[c]).fold(0.0, f64::max))
            .fold(1e-4, f64::max);
        let even = Light(gains.map(|g| g / brightest));
        let tones = seen.map(|tile| Tone::new(even.undo(tile.linear), &Shades::ANY));
        let unlikely = -2.0 * prior.ln();
        for exposure in EXPOSURES {
            let light = Light(even.0.map(|g| g * exposure));
            let mut cost = unlikely;
            let mut shares = [[0.0; 6]; 9];
            for ((tile, tone), shares) in seen.iter().zip(&tones).zip(&mut shares) {
                let d = if tile.clipped == [false; 3] {
                    tone.distances(exposure)
                } else {
                    tile.under(light).distances(&Shades::ANY)
                };
                let likely = d.map(|d| (-0.5 * d).exp());
                let total: f64 = likely.iter().sum();
                *shares = likely.map(|share| share / total);
                cost -= 2.0 * (total + (-0.5 * NO_COLOUR).exp()).ln();
                // For most lights the computation ends here after a few tiles.
                if cost > least + NO_WEIGHT {
                    break;
                }
            }
            if cost > least + NO_WEIGHT {
                continue;
            }
            // The sums are relative to the weight of the best light so far.
            if cost < least {
                let scale = if least.is_finite() { (0.5 * (cost - least)).exp() } else { 0.0 };
                (weights, least) = (weights * scale, cost);
                sum = sum.map(|tile| tile.map(|share| share * scale));
            }
            let weight = (-0.5 * (cost - least)).exp();
            weights += weight;
            for (sum, shares) in sum.as_flattened_mut().iter_mut().zip(shares.as_flattened()) {
                *sum += weight * shares;
            }
        }
    }
    sum.map(|tile| tile.map(|share| share / weights))
}

/// Returns whether these tiles come from a black and white picture: all three channels are equal in
/// each tile. In a colour picture even the channels of white tiles differ, by noise and by the
/// colour of the light.
#[must_use]
pub fn is_colourless(rgb: &[[f64; 3]]) -> bool {
    let grey = |c: &[f64; 3]| c[0].max(c[1]).max(c[2]) - c[0].min(c[1]).min(c[2]) < 0.5;
    rgb.iter().all(grey)
}

/// Hue of each colour on one cube, and its standard deviation (deg). The reds of two makers differ
/// more than two reds of one cube.
#[derive(Debug, Clone, Copy)]
struct Shades([(f64, f64); 6]);

/// Standard deviation of the hue within one cube (deg).
const WITHIN: f64 = 5.0;

impl Shades {
    /// Prior knowledge of any cube: the hues and standard deviations of the prototypes.
    const ANY: Self = {
        let mut shades = [(0.0, 1.0); 6];
        let mut c = 0;
        while c < 6 {
            if let Some(shade) = PROTOTYPES[c].hue {
                shades[c] = shade;
            }
            c += 1;
        }
        Self(shades)
    };

    /// Estimates the hue of each colour on this cube from the tiles of one face. Each tile counts
    /// for a colour with the probability that it has this colour. With this estimate 545 of 631
    /// drawn faces are read without an error, without it 528.
    fn of(tiles: &[Seen; 9]) -> Self {
        let mut shades = Self::ANY;
        // The hues depend on the probabilities and these on the hues. Three rounds suffice.
        for _ in 0..3 {
            // Sums of weights, and of weighted differences from the prototype's hue, by colour.
            let mut sums = [(0.0, 0.0); 6];
            // Tiles that clip are left out, since clipping changes the hue.
            for tile in tiles.iter().filter(|t| t.clipped == [false; 3]) {
                let d = tile.distances(&shades);
                let best = least(&d);
                let total: f64 = d.iter().map(|x| (-0.5 * (x - d[best])).exp()).sum();
                let shade = Shade::new(tile.linear);
                for (c, sum) in sums.iter_mut().enumerate() {
                    let Some((hue, _)) = PROTOTYPES[c].hue else { continue };
                    let share = (-0.5 * (d[c] - d[best])).exp() / total;
                    let weight = share / (WITHIN * WITHIN + shade.blur().powi(2));
                    sum.0 += weight;
                    sum.1 += weight * turn(shade.hue, hue);
                }
            }
            for (c, (weight, turns)) in sums.into_iter().enumerate() {
                let Some((hue, spread)) = PROTOTYPES[c].hue else { continue };
                let precision = weight + 1.0 / (spread * spread);
                shades.0[c] = (hue + turns / precision, WITHIN.hypot((1.0 / precision).sqrt()));
            }
        }
        shades
    }
}

/// Returns the angle from the hue `from` to `hue`, -180..180 deg.
fn turn(hue: f64, from: f64) -> f64 {
    (hue - from + 180.0).rem_euclid(360.0) - 180.0
}

/// Finds the light under which the tiles look most like the six colours. Returns the light and its
/// cost. `judge` computes a cost from the squared distances of all tiles to all colours.
pub(super) fn fit_light(tiles: &[Seen], judge: impl Fn(&[[f64; 6]]) -> f64) -> (Light, f64) {
    let mut best = ([1.0; 3], Light([1.0; 3]), f64::INFINITY);
    let mut distances = vec![[0.0; 6]; tiles.len()];
    let mut tones = vec![Tone::default(); tiles.len()];
    let mut attempt = |gains: [f64; 3], best: &mut ([f64; 3], Light, f64)| {
        // The gains give only the colour of the light. Its strength is searched separately, because
        // only the value of a tone depends on it.
        let brightest = tiles
            .iter()
            .map(|t| (0..3).map(|c| t.linear[c] * gains[c]).fold(0.0, f64::max))
            .fold(1e-4, f64::max);
        let even = Light(gains.map(|g| g / brightest));
        for (tone, tile) in tones.iter_mut().zip(tiles) {
            *tone = Tone::new(even.undo(tile.linear), &Shades::ANY);
        }
        let prior = (gains[0].ln() / 0.25).powi(2) + (gains[2].ln() / 0.25).powi(2);
        for exposure in EXPOSURES {
            let light = Light(even.0.map(|g| g * exposure));
            for ((d, tone), tile) in distances.iter_mut().zip(&tones).zip(tiles) {
                *d = if tile.clipped == [false; 3] {
                    tone.distances(exposure)
                } else {
                    tile.under(light).distances(&Shades::ANY)
                };
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
    // The search is refined in half and quarter steps around the best light, since an error of 5 %
    // changes the hue of pale tiles.
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
    /// Removes the effect of the light from linear RGB.
    pub(super) fn undo(self, linear: [f64; 3]) -> [f64; 3] {
        [linear[0] * self.0[0], linear[1] * self.0[1], linear[2] * self.0[2]]
    }
}

/// Hue, saturation and value of a tile in linear light. Glare adds white light, which lowers the
/// saturation but does not change this hue. It would change the hue of Lab or of sRGB levels.
#[derive(Debug, Clone, Copy)]
struct Shade {
    /// Hue, -60..300 deg: red 0, green 120, blue 240. It depends on the square root of the middle
    /// channel's share, which spreads red, orange and yellow evenly over their 60 deg.
    hue: f64,
    /// Difference between the strongest and the weakest channel, divided by the strongest, 0..=1.
    saturation: f64,
    /// Strongest channel.
    value: f64,
}

impl Shade {
    /// Computes hue, saturation and value from linear RGB.
    fn new([r, g, b]: [f64; 3]) -> Self {
        let (high, low) = (r.max(g).max(b), r.min(g).min(b));
        // The six cases are the sextants of the hue circle, by the order of the channels.
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

    /// Returns the standard deviation of the hue (deg) that follows from an error of the light. It
    /// is larger for a pale tile.
    fn blur(&self) -> f64 {
        12.0 * (1.0 / self.saturation.max(0.05) - 1.0)
    }
}

/// Comparison of a tile with each prototype, before the exposure is known.
#[derive(Debug, Clone, Copy, Default)]
struct Tone {
    /// Squared distance of the hue from that of each prototype, in units of its spread; for white,
    /// of the saturation from 0.
    chroma: [f64; 6],
    /// Logarithm of the value, and of the value without the light that all channels share.
    value: [f64; 2],
    /// Light that all channels share: the weakest channel.
    grey: f64,
}

/// Mean white light on a coloured tile (haze, glare), as a share of the light that white reflects.
const GLARE: f64 = 0.12;

/// Standard deviation of the saturation of white, which follows from the error of the light.
const TINT: f64 = 0.15;

impl Tone {
    /// Compares a tile, in linear RGB, with all prototypes. `shades` are the hues of the colours on
    /// this cube.
    fn new(linear: [f64; 3], shades: &Shades) -> Self {
        Self::of(linear, shades, 0..6)
    }

    /// Compares a tile as [`Self::new`] does, with the prototypes of `colours` (in 0..6) only. The
    /// `chroma` of the others is 0 and has no meaning.
    fn of(linear: [f64; 3], shades: &Shades, colours: Range<usize>) -> Self {
        let shade = Shade::new(linear);
        let blur = shade.blur();
        let mut chroma = [0.0; 6];
        for c in colours {
            let (hue, spread) = shades.0[c];
            chroma[c] = match PROTOTYPES[c].hue {
                None => (shade.saturation / TINT).powi(2),
                Some(_) => turn(shade.hue, hue).powi(2) / (spread * spread + blur * blur),
            };
        }
        // On a coloured tile only the coloured light counts. The light that all channels share is
        // glare.
        let value = [1.0, shade.saturation].map(|own| (shade.value * own).max(1e-4).ln());
        Self { chroma, value, grey: shade.value * (1.0 - shade.saturation) }
    }

    /// Computes the squared distance of the tile to each prototype, in units of their spreads, with
    /// its light multiplied by `exposure`.
    fn distances(&self, exposure: f64) -> [f64; 6] {
        let log_exposure = exposure.ln();
        std::array::from_fn(|c| self.distance(c, exposure, log_exposure))
    }

    /// Computes the squared distance of the tile to the prototype of colour `c`, in units of its
    /// spreads, with its light multiplied by `exposure`, whose logarithm is `log_exposure`.
    fn distance(&self, c: usize, exposure: f64, log_exposure: f64) -> f64 {
        let p = &PROTOTYPES[c];
        let coloured = p.hue.is_some();
        let value = self.value[usize::from(coloured)] + log_exposure;
        // Glare has an exponential prior, so a tile that is bright in all channels is white. The
        // cost of the value is bounded, because a shadow may darken a tile by any factor.
        let glare = 2.0 * (self.grey * exposure / 0.8) / GLARE;
        let pale = if coloured { glare } else { 0.0 };
        self.chroma[c] + pale + ((value - p.log_value) / 0.6).powi(2).min(9.0)
    }
}

/// Computes the squared distance of a tile, given in linear RGB, to each of the six prototypes, in
/// units of their spreads.
pub(super) fn prototype_distances(linear: [f64; 3]) -> [f64; 6] {
    Tone::new(linear, &Shades::ANY).distances(1.0)
}

/// Converts an sRGB level 0..=255 to linear light 0..=1 (IEC 61966-2-1).
#[must_use]
pub fn to_linear(level: f64) -> f64 {
    let v = (level / 255.0).clamp(0.0, 1.0);
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// Converts linear light 0..=1 to an sRGB level 0..=255 (IEC 61966-2-1).
#[must_use]
pub fn to_level(linear: f64) -> f64 {
    let v = linear.clamp(0.0, 1.0);
    255.0 * if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

/// Converts linear RGB to CIE L\*a\*b\* (D65).
pub(super) fn lab(rgb: [f64; 3]) -> [f64; 3] {
    let [r, g, b] = rgb;
    let f = |t: f64| {
        if t > 0.008856 { t.cbrt() } else { 7.787 * t + 16.0 / 116.0 }
    };
    let x = f((0.4124 * r + 0.3576 * g + 0.1805 * b) / 0.9505);
    let y = f(0.2126 * r + 0.7152 * g + 0.0722 * b);
    let z = f((0.0193 * r + 0.1192 * g + 0.9505 * b) / 1.089);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Returns the index of the least value; the first of several equal ones.
fn least(values: &[f64]) -> usize {
    (0..values.len()).fold(0, |best, i| if values[i] < values[best] { i } else { best })
}

/// Returns the letter of a face 0..=5: U, R, F, D, L or B.
///
/// # Panics
/// If `face` is above 5.
#[must_use]
pub fn face_letter(face: usize) -> char {
    ['U', 'R', 'F', 'D', 'L', 'B'][face]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Colours of a common cube's stickers (sRGB, 0..=255), in the order of [`LETTERS`].
    const STICKERS: [[f64; 3]; 6] = [
        [235.0, 235.0, 235.0],
        [183.0, 18.0, 52.0],
        [0.0, 155.0, 72.0],
        [255.0, 213.0, 0.0],
        [255.0, 88.0, 0.0],
        [0.0, 70.0, 173.0],
    ];

    #[test]
    fn colours_of_grey_face_have_zero_confidence() {
        let grey = std::array::from_fn(|i| [30.0 + 20.0 * i as f64; 3]);

        assert_eq!(decide_face(&grey).1, [0.0; 9]);
    }

    #[test]
    fn clipped_red_under_haze_is_not_orange() {
        let levels = [
            [138.0, 217.0, 176.0],
            [254.0, 217.0, 157.0],
            [254.0, 255.0, 153.0],
            [139.0, 221.0, 179.0],
            [139.0, 220.0, 179.0],
            [255.0, 143.0, 156.0],
            [144.0, 164.0, 233.0],
            [255.0, 254.0, 156.0],
            [255.0, 255.0, 255.0],
        ];

        assert_eq!(decide_face(&levels).0, [2, 4, 3, 2, 2, 1, 5, 3, 0]);
    }

    /// Returns the levels of nine tiles of these colours under a light, given by the gains of the
    /// camera's channels on linear light.
    fn lit(face: [usize; 9], gains: [f64; 3]) -> [[f64; 3]; 9] {
        face.map(|colour| {
            std::array::from_fn(|c| {
                let linear = (to_linear(STICKERS[colour][c]) * gains[c]).min(1.0);
                let curved = 1.055 * linear.powf(1.0 / 2.4) - 0.055;
                255.0 * if linear <= 0.003_130_8 { 12.92 * linear } else { curved }
            })
        })
    }

    /// White in the light of a lamp or of a blue sky may be read as another colour, but not with a
    /// confidence of 0.9 or more.
    #[test]
    fn tinted_white_is_never_certainly_another_colour() {
        let face = [0, 5, 0, 0, 5, 0, 5, 0, 0];
        for gains in [[1.0, 0.6, 0.22], [0.3, 0.5, 1.0], [0.9, 0.55, 0.15], [0.2, 0.35, 0.9]] {
            let (colours, confidences) = decide_face(&lit(face, gains));

            for i in 0..9 {
                let right = usize::from(colours[i]) == face[i];
                assert!(right || confidences[i] < 0.9, "{gains:?}: {colours:?} {confidences:?}");
            }
        }
    }

    /// At most one in 1000 tiles with a confidence of 0.9 or more is wrong, in random light.
    #[test]
    fn confident_tiles_are_right_under_any_light() {
        use rand::{Rng as _, SeedableRng as _};
        let mut rng = rand_pcg::Pcg64::seed_from_u64(1);
        let (mut told, mut wrong) = (0, 0);
        for _ in 0..1500 {
            let face: [usize; 9] = std::array::from_fn(|_| rng.random_range(0..6));
            let spread = if rng.random() { 0.25 } else { 0.8 };
            let mut gain =
                || f64::exp(spread * (rng.random_range(-1.0..1.0) + rng.random_range(-1.0..1.0)));
            let (red, blue) = (gain(), gain());
            let strength = rng.random_range(0.3..1.0) / f64::max(1.0, red.max(blue));

            let (colours, confidences) =
                decide_face(&lit(face, [red * strength, strength, blue * strength]));

            for i in (0..9).filter(|&i| confidences[i] >= 0.9) {
                told += 1;
                wrong += usize::from(usize::from(colours[i]) != face[i]);
            }
        }
        assert!(told > 5000 && wrong * 1000 <= told, "{wrong} of {told} are wrong");
    }

    #[test]
    fn face_is_read_in_dim_and_warm_light() {
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
