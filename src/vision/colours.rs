//! Colours: mean RGB of tiles -> the six colours, with a margin each.
//!
//! One face alone is read against prototypes of the six colours under the light that explains it best.
//! A whole cube needs no prototypes to be sorted: its centres anchor six classes, each takes exactly nine
//! facelets at the least total distance in Lab, and the class means follow their members.
//!
//! - in: mean RGB of tiles, 0..=255, as in the image (sRGB)
//! - out: colours 0..=5 = white, red, green, yellow, orange, blue (URFDLB); confidences or margins
//! - source: von Kries gains and CIE 1976 L*a*b*; exact assignment after Kuhn (1955)

use std::ops::Range;
use std::sync::LazyLock;

pub use super::whole::{Decision, Undecided, decide_cube};

/// Letters of the colours 0..=5.
pub const LETTERS: [char; 6] = ['W', 'R', 'G', 'Y', 'O', 'B'];

/// What a person calls by each name: hue and its spread (deg), brightness of the strongest channel (80, 42, 32,
/// 75, 62 and 36 % of a perfect white, as logarithms). The hue is that of [`Shade`]; white has none.
const PROTOTYPES: [Prototype; 6] = [
    Prototype { hue: None, log_value: -0.223 },
    Prototype { hue: Some((-4.0, 8.0)), log_value: -0.868 },
    Prototype { hue: Some((128.0, 20.0)), log_value: -1.139 },
    Prototype { hue: Some((54.0, 9.0)), log_value: -0.288 },
    Prototype { hue: Some((22.0, 8.0)), log_value: -0.478 },
    Prototype { hue: Some((215.0, 16.0)), log_value: -1.022 },
];

#[derive(Debug, Clone, Copy)]
struct Prototype {
    hue: Option<(f64, f64)>,
    log_value: f64,
}

impl Prototype {
    /// Linear RGB: the inverse of [`Shade`].
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

/// Share of its strongest channel that a coloured sticker reflects of the weakest.
const PALE: f64 = 0.05;

/// From this level on a channel counts as clipped: encoders do not leave it at 255.
pub const CLIPPED: f64 = 246.0;

/// Gains of red and blue against green that the light may have (log spaced; prior s.d. 0.25 in log).
const GAINS: [f64; 7] = [0.6, 0.72, 0.85, 1.0, 1.18, 1.4, 1.65];

/// Level of the brightest channel of the brightest tile once the exposure is set right.
const EXPOSURES: [f64; 4] = [1.0, 0.75, 0.5, 0.3];

/// The mean colour of a tile in linear light, with the channels that may have been brighter than the camera tells.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seen {
    linear: [f64; 3],
    clipped: [bool; 3],
}

impl Seen {
    /// Of sRGB levels 0..=255.
    fn new(levels: [f64; 3]) -> Self {
        Self { linear: levels.map(to_linear), clipped: levels.map(|v| v >= CLIPPED) }
    }

    /// Of linear light that no camera clipped.
    pub(super) fn whole(linear: [f64; 3]) -> Self {
        Self { linear, clipped: [false; 3] }
    }

    /// The tile under a light that is undone.
    fn under(&self, light: Light) -> Self {
        Self { linear: light.undo(self.linear), ..*self }
    }

    /// Squared distance to each prototype in units of its spread. A clipped channel says only what the light was at
    /// least: it is taken to be what the prototype would show, in the shade and under the glare that the others tell.
    fn distances(&self, shades: &Shades) -> [f64; 6] {
        if self.clipped == [false; 3] {
            return Tone::new(self.linear, shades).distances(1.0);
        }
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

    /// The strength of a prototype's light, and of the glare on it, that explain the channels which did not clip: the
    /// likeliest under a normal strength and an exponential glare.
    fn explained(&self, own: &[f64; 3], coloured: bool) -> (f64, f64) {
        if self.clipped == [true; 3] {
            return (1.0, 0.0);
        }
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
        // On white, glare and strength are one.
        let glare =
            if coloured { ((xg * ss - xs * sg) / (gg * ss - sg * sg)).max(0.0) } else { 0.0 };
        (((xs - sg * glare) / ss).clamp(SHADE.0, SHADE.1), glare)
    }
}

/// Spread of the strength of a tile's light, relative to its prototype's, and of a channel, relative.
const STRENGTH: f64 = 0.5;
const CHANNEL: f64 = 0.1;

/// At the rim of a clipped tile: logarithm of green over blue of yellow, at least, and the spread of that of white and
/// yellow. Half of a file's colour is lost between two pixels.
const YELLOW: f64 = 0.45;
const RIM: f64 = 0.2;

/// How much darker and brighter than its prototype a tile may be taken to be where it clips.
const SHADE: (f64, f64) = (0.4, 2.5);

/// What the light did to the tiles: factors that undo it, on linear RGB.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Light(pub(super) [f64; 3]);

/// The colours of one face by itself, and a confidence for each, 0..=1.
#[must_use]
pub fn decide_face(rgb: &[[f64; 3]; 9]) -> ([u8; 9], [f64; 9]) {
    decide_face_with(rgb, &[None; 9])
}

/// The same, with the linear light at the rims of tiles that clip in all channels, of any strength.
pub(super) fn decide_face_with(
    rgb: &[[f64; 3]; 9],
    rims: &[Option<[f64; 3]>; 9],
) -> ([u8; 9], [f64; 9]) {
    let seen = rgb.map(Seen::new);
    let (light, _) = fit_light(&seen, |distances| {
        distances.iter().map(|d| d.iter().copied().fold(16.0, f64::min)).sum()
    });
    let tiles = seen.map(|tile| tile.under(light));
    let shades = Shades::of(&tiles);
    // By how much blue lacks at a rim against green; white's is not bluer than the light.
    let lacks = rims.map(|rim| {
        let [_, green, blue] = light.undo(rim?);
        Some((green.max(1e-6) / blue.max(1e-6)).ln())
    });
    let bluest = lacks.iter().flatten().copied().fold(0.0, f64::min);
    let mut colours = [0; 9];
    let mut confidences = [0.0; 9];
    for (i, tile) in tiles.iter().enumerate() {
        let mut d = tile.distances(&shades);
        // White and yellow clip alike, but not at their rims.
        if let Some(lack) = lacks[i].map(|lack| lack - bluest) {
            d[0] = (lack / RIM).powi(2);
            d[3] = 1.0 + ((YELLOW - lack).max(0.0) / RIM).powi(2);
        }
        let best = least(&d);
        let weight: f64 = d.iter().map(|x| (-0.5 * (x - d[best])).exp()).sum();
        colours[i] = best as u8;
        // A tile that resembles no colour is not certain, however lonely the best guess is.
        confidences[i] = (-(d[best] / 30.0)).exp() / weight;
    }
    if is_colourless(rgb) {
        confidences = [0.0; 9];
    }
    (colours, confidences)
}

/// Whether a picture in black and white shows these tiles: it says nothing of colours. That of a white face has noise, and
/// a light of its own.
#[must_use]
pub fn is_colourless(rgb: &[[f64; 3]]) -> bool {
    let grey = |c: &[f64; 3]| c[0].max(c[1]).max(c[2]) - c[0].min(c[1]).min(c[2]) < 0.5;
    rgb.iter().all(grey)
}

/// Hue of each colour on the cube at hand, and its spread (deg): makers' reds differ more than two reds of a cube do.
#[derive(Debug, Clone, Copy)]
struct Shades([(f64, f64); 6]);

/// Spread of the hue within one cube (deg).
const WITHIN: f64 = 5.0;

impl Shades {
    /// What is known before any tile was seen; the spread of makers and of tiles together.
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

    /// The tiles that are surely of a colour say which hue it has here; then the others are asked again.
    fn of(tiles: &[Seen; 9]) -> Self {
        let mut shades = Self::ANY;
        for _ in 0..3 {
            // Sums of weights, and of turns from the prototype, by colour.
            let mut sums = [(0.0, 0.0); 6];
            // A clipped tile's hue is not its own.
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

/// Angle from one hue to another, -180..180 deg.
fn turn(hue: f64, from: f64) -> f64 {
    (hue - from + 180.0).rem_euclid(360.0) - 180.0
}

/// The light under which the tiles look most like the six colours; `judge` turns the squared distances of
/// all tiles to all colours into one cost.
pub(super) fn fit_light(tiles: &[Seen], judge: impl Fn(&[[f64; 6]]) -> f64) -> (Light, f64) {
    let mut best = ([1.0; 3], Light([1.0; 3]), f64::INFINITY);
    let mut distances = vec![[0.0; 6]; tiles.len()];
    let mut tones = vec![Tone::default(); tiles.len()];
    let mut attempt = |gains: [f64; 3], best: &mut ([f64; 3], Light, f64)| {
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
    pub(super) fn undo(self, linear: [f64; 3]) -> [f64; 3] {
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

    /// Uncertainty of the hue (deg): the paler a tile, the more an error of the light turns it.
    fn blur(&self) -> f64 {
        12.0 * (1.0 / self.saturation.max(0.05) - 1.0)
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
    fn new(linear: [f64; 3], shades: &Shades) -> Self {
        Self::of(linear, shades, 0..6)
    }

    /// The same for some of the prototypes.
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
        // Of a coloured tile only the coloured light counts: the rest is glare.
        let value = [1.0, shade.saturation].map(|own| (shade.value * own).max(1e-4).ln());
        Self { chroma, value, grey: shade.value * (1.0 - shade.saturation) }
    }

    /// Squared distance to each prototype in units of its spread, after an exposure.
    fn distances(&self, exposure: f64) -> [f64; 6] {
        let log_exposure = exposure.ln();
        std::array::from_fn(|c| self.distance(c, exposure, log_exposure))
    }

    /// Squared distance to one prototype, after an exposure with this logarithm.
    fn distance(&self, c: usize, exposure: f64, log_exposure: f64) -> f64 {
        let p = &PROTOTYPES[c];
        let coloured = p.hue.is_some();
        let value = self.value[usize::from(coloured)] + log_exposure;
        // Glare has an exponential distribution: what is nearly as bright as white all over is white.
        let glare = 2.0 * (self.grey * exposure / 0.8) / GLARE;
        let pale = if coloured { glare } else { 0.0 };
        self.chroma[c] + pale + ((value - p.log_value) / 0.6).powi(2).min(9.0)
    }
}

/// Squared distance to each prototype in units of its spread.
pub(super) fn prototype_distances(linear: [f64; 3]) -> [f64; 6] {
    Tone::new(linear, &Shades::ANY).distances(1.0)
}

/// Linear light 0..=1 of an sRGB level 0..=255.
#[must_use]
pub fn to_linear(level: f64) -> f64 {
    let v = (level / 255.0).clamp(0.0, 1.0);
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// The sRGB level 0..=255 of linear light 0..=1.
#[must_use]
pub fn to_level(linear: f64) -> f64 {
    let v = linear.clamp(0.0, 1.0);
    255.0 * if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

/// CIE L*a*b* (D65) of linear RGB.
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

fn least(values: &[f64]) -> usize {
    (0..values.len()).fold(0, |best, i| if values[i] < values[best] { i } else { best })
}

/// Letter of a face 0..=5.
#[must_use]
pub fn face_letter(face: usize) -> char {
    ['U', 'R', 'F', 'D', 'L', 'B'][face]
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

    #[test]
    fn a_black_and_white_picture_says_nothing_of_colours() {
        let grey = std::array::from_fn(|i| [30.0 + 20.0 * i as f64; 3]);

        assert_eq!(decide_face(&grey).1, [0.0; 9]);
    }

    #[test]
    fn red_that_clips_under_haze_is_not_orange() {
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
