//! The part of an image that is searched, at full size or reduced, and the colours of its tiles.
//!
//! A maker's mark, glare or the rim of a finger may cover a part of a tile. The colour of a tile is
//! therefore that of the pixels that most probably show the bare sticker. Levels are 0..=255.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | picture has no colours | <= 1 of 500 pixels, 8 levels between channels | noise is no colour |
//! | samples of a tile | 7 x 7, within 0.36 of its side from its middle | its rim is blurred |
//! | darker part is a mark | sticker has 2 of 5 samples | else it is unknown which part it is |
//! | pixels are alike | 10 levels + 12 % | noise, and shading within a tile |
//! | rim pixel shows the tile's hue | < 235, 30 above the gap | it may be clipped, or gap |
//! | gap is dark | <= 120 | a bright gap adds its own light to the rim |
//! | rim shows a hue | sum of linear light > 0.5 | a few grey pixels have a random hue |
//!
//! - in: RGB pixels, a window, an integer factor of reduction
//! - out: a copy with its own pixel coordinates; a [`TileSample`] for each tile
//! - source: own work

use super::Rect;
use super::colours::{CLIPPED, to_linear};
use super::homography::{Point, apply, distance};
use super::segment::percentile;
use image::RgbImage;
use nalgebra::Matrix3;

/// Copy of a part of an image, at full size or reduced.
#[derive(Debug)]
pub(super) struct Patch {
    /// Interleaved RGB pixels of the copy, row by row.
    pub(super) rgb: Vec<u8>,
    /// Columns of the copy.
    pub(super) width: usize,
    /// Rows of the copy.
    pub(super) height: usize,
    /// Columns and rows of the image that make one pixel of the copy.
    step: usize,
    /// First pixel of the window in the image.
    origin: (f64, f64),
}

impl Patch {
    /// Copies a window that lies inside the image. Each block of `step` x `step` pixels becomes one
    /// pixel of the patch, with their mean colour.
    pub(super) fn new(image: &RgbImage, window: Rect, step: usize) -> Self {
        let rgb = reduced(image.as_raw(), image.width() as usize, window, step);
        let (width, height) = (window.width as usize / step, window.height as usize / step);
        let origin = (f64::from(window.x), f64::from(window.y));
        Self { rgb, width, height, step, origin }
    }

    /// Converts a pixel of the patch to one of the whole image.
    pub(super) fn to_image(&self, p: Point) -> Point {
        // The centre of a pixel has integer coordinates, so a block of pixels begins half a pixel
        // before the centre of its first one.
        let step = self.step as f64;
        ((p.0 + 0.5) * step - 0.5 + self.origin.0, (p.1 + 0.5) * step - 0.5 + self.origin.1)
    }

    /// Converts a pixel of the whole image to one of the patch.
    pub(super) fn to_patch(&self, p: Point) -> Point {
        let step = self.step as f64;
        ((p.0 - self.origin.0 + 0.5) / step - 0.5, (p.1 - self.origin.1 + 0.5) / step - 0.5)
    }

    /// Returns the colour of the pixel nearest to a point of the patch, or `None` outside the
    /// patch.
    pub(super) fn pixel(&self, p: Point) -> Option<[f64; 3]> {
        let (x, y) = (p.0.round(), p.1.round());
        // A NaN fails each comparison, so with the negation it counts as outside.
        if !(x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64) {
            return None;
        }
        let at = 3 * (y as usize * self.width + x as usize);
        Some([self.rgb[at], self.rgb[at + 1], self.rgb[at + 2]].map(f64::from))
    }

    /// Returns the level, 0..=255, that the brightest channel of a hundredth of the pixels exceeds,
    /// and the share of pixels that clip in all channels, 0..=1.
    pub(super) fn exposure(&self) -> (u8, f64) {
        // Every seventh pixel is enough for both numbers.
        let mut counts = [0u32; 256];
        let (mut total, mut clipped) = (0u32, 0u32);
        for pixel in self.rgb.chunks_exact(3).step_by(7) {
            counts[usize::from(pixel[0].max(pixel[1]).max(pixel[2]))] += 1;
            clipped += u32::from(pixel[0].min(pixel[1]).min(pixel[2]) >= 250);
            total += 1;
        }
        (percentile(&counts, total, 0.99), f64::from(clipped) / f64::from(total.max(1)))
    }

    /// Returns whether the patch is black and white: in at most one of 500 pixels two channels
    /// differ by more than 8 levels.
    pub(super) fn colourless(&self) -> bool {
        let pixels = || self.rgb.chunks_exact(3).step_by(7);
        let coloured = pixels().filter(|p| p[0].max(p[1]).max(p[2]) - p[0].min(p[1]).min(p[2]) > 8);
        500 * coloured.count() <= pixels().len()
    }

    /// Samples the colours inside the tile at `g` (column - 1, row - 1). `h` maps places in this
    /// form to pixels of the patch, and `sticker` is the tile's side in pitches.
    pub(super) fn sample(&self, h: &Matrix3<f64>, g: Point, sticker: f64) -> TileSample {
        let reach = 0.36 * sticker.clamp(0.4, 0.95);
        let mut pixels: Vec<[f64; 3]> = Vec::with_capacity(49);
        for i in -3..=3 {
            for j in -3..=3 {
                let at = (g.0 + reach * f64::from(i) / 3.0, g.1 + reach * f64::from(j) / 3.0);
                pixels.extend(self.pixel(apply(h, at)));
            }
        }
        TileSample::new(pixels)
    }
}

/// Returns the RGB pixels of a window of the picture `raw`, which has this number of columns; the
/// window must be inside it. Each block of `step` x `step` pixels becomes one with their mean.
pub(super) fn reduced(raw: &[u8], columns: usize, window: Rect, step: usize) -> Vec<u8> {
    let stride = 3 * columns;
    let (width, height) = (window.width as usize / step, window.height as usize / step);
    let mut rgb = Vec::with_capacity(3 * width * height);
    // `step` rows are summed first, because the bytes of a row are adjacent, then `step` pixels of
    // these sums.
    let mut sums = vec![0u32; 3 * width * step];
    let n = (step * step) as u32;
    for y in 0..height {
        let row = (window.y as usize + y * step) * stride + 3 * window.x as usize;
        if step == 1 {
            rgb.extend_from_slice(&raw[row..row + 3 * width]);
            continue;
        }
        sums.fill(0);
        for dy in 0..step {
            let line = &raw[row + dy * stride..][..3 * width * step];
            for (sum, value) in sums.iter_mut().zip(line) {
                *sum += u32::from(*value);
            }
        }
        for block in sums.chunks_exact(3 * step) {
            // The sum begins with half of the divisor, so that the division rounds.
            let mut pixel = [n / 2; 3];
            for one in block.chunks_exact(3) {
                for (sum, value) in pixel.iter_mut().zip(one) {
                    *sum += value;
                }
            }
            rgb.extend(pixel.map(|sum| (sum / n) as u8));
        }
    }
    rgb
}

/// Share of half a pitch that limits the search for a tile's rim. The search ends
/// `0.5 * RIM + 0.05` pitches from the tile's middle, which is the middle of the gap. Beyond it the
/// light of the neighbouring tile begins.
const RIM: f64 = 0.9;

impl Patch {
    /// Measures the hue of a tile whose pixels clip, at `g` (column - 1, row - 1). `h` and
    /// `sticker` are as in [`Self::sample`]. Returns linear light whose strongest channel is 1, or
    /// `None` if the gaps around the tile are not dark or the rim shows too little light.
    ///
    /// The lens blurs the picture before the sensor clips it. Between the tile and a dark gap, the
    /// light of the tile therefore appears below its full strength, and its hue is visible.
    pub(super) fn rim(&self, h: &Matrix3<f64>, g: Point, sticker: f64) -> Option<[f64; 3]> {
        let half = 0.5 * sticker.clamp(0.4, 0.95);
        let middle = apply(h, g);
        let pitch = distance(middle, apply(h, (g.0 + 1.0, g.1)));
        let step = (0.5 / pitch).min(0.05);
        // A line of pixels across the rim begins 0.08 pitches inside the tile, where they still
        // clip. There are nine such lines on each side.
        let taps = ((0.5 * RIM + 0.05 - (half - 0.08)) / step) as usize;
        let mut lines: Vec<Vec<[f64; 3]>> = Vec::new();
        for side in 0..4 {
            for k in -4..=4 {
                let along = 0.06 * f64::from(k);
                let line = (0..=taps).filter_map(|t| {
                    let across = half - 0.08 + step * t as f64;
                    let (u, v) =
                        [(across, along), (-across, along), (along, across), (along, -across)]
                            [side];
                    self.pixel(apply(h, (g.0 + u, g.1 + v)))
                });
                lines.push(line.collect());
            }
        }
        let top = |p: &[f64; 3]| p[0].max(p[1]).max(p[2]);
        let mut sum = [0.0; 3];
        for line in &lines {
            // The rim ends at the darkest place of the line. A neighbouring tile may be beyond.
            let Some(darkest) =
                line.iter().enumerate().min_by(|a, b| top(a.1).total_cmp(&top(b.1)))
            else {
                continue;
            };
            // The blur mixes the light of the gap with that of the tile, so it is subtracted below.
            let body = darkest.1.map(to_linear);
            if top(darkest.1) > 120.0 {
                continue;
            }
            for p in line[..darkest.0]
                .iter()
                .filter(|p| top(p) < 235.0 && top(p) > top(darkest.1) + 30.0)
            {
                for c in 0..3 {
                    sum[c] += (to_linear(p[c]) - body[c]).max(0.0);
                }
            }
        }
        let all = sum[0].max(sum[1]).max(sum[2]);
        (all > 0.5).then(|| sum.map(|s| s / all))
    }
}

/// Colour of one tile, and how well its pixels show it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TileSample {
    /// Trimmed mean colour, 0..=255.
    pub(super) rgb: [f64; 3],
    /// Mean distance of the samples from the trimmed mean, as a share of 255. It is 0 for a tile of
    /// one even colour.
    pub(super) spread: f64,
    /// Share of the 49 samples that lie inside the patch.
    pub(super) inside: f64,
    /// Whether all channels clip: the tile is white, or yellow in too much light.
    pub(super) clipped: bool,
}

impl TileSample {
    /// Computes the colour of a tile from its samples, of which at most 49 are inside the patch.
    fn new(mut pixels: Vec<[f64; 3]>) -> Self {
        let inside = pixels.len() as f64 / 49.0;
        if pixels.is_empty() {
            return Self { rgb: [0.0; 3], spread: 1.0, inside, clipped: false };
        }
        let sum = |p: &[f64; 3]| p[0] + 2.0 * p[1] + p[2];
        // The colour is that of the darker half, because glare covers a part of a tile and makes it
        // brighter. The darkest eighth is left out, because it may be a groove.
        pixels.sort_by(|a, b| sum(a).total_cmp(&sum(b)));
        let own = &pixels[marked(&pixels)..];
        let middle = &own[own.len() / 8..own.len().div_ceil(2)];
        let n = middle.len() as f64;
        let rgb = std::array::from_fn(|c| middle.iter().map(|p| p[c]).sum::<f64>() / n);
        let spread = pixels
            .iter()
            .map(|p| (0..3).map(|c| (p[c] - rgb[c]).abs()).fold(0.0, f64::max))
            .sum::<f64>()
            / (255.0 * pixels.len() as f64);
        let clipped = rgb.iter().all(|&v| v >= CLIPPED);
        Self { rgb, spread, inside, clipped }
    }
}

/// Counts the darkest pixels of a tile that do not show the sticker: those of a maker's mark or of
/// the rim of a finger. The pixels are sorted by brightness, the darkest first.
///
/// The sticker is the largest group of pixels that are alike. Pixels that clip do not lead a group
/// unless half of all clip. A dark pixel still counts as sticker if the group's colour may be its
/// colour under a reflection, which adds equal light to all channels.
fn marked(sorted: &[[f64; 3]]) -> usize {
    let n = sorted.len();
    let clips = |p: &[f64; 3]| p.iter().all(|&v| v >= CLIPPED);
    let clipped = sorted.iter().filter(|p| clips(p)).count();
    let alike = |a: &[f64; 3], b: &[f64; 3]| {
        let level = a.iter().chain(b).copied().fold(0.0, f64::max);
        (0..3).all(|c| (a[c] - b[c]).abs() < 10.0 + 0.12 * level)
    };
    // Most tiles are even and end here, since the comparison of all pairs below is slow.
    if n == 0 || alike(&sorted[n / 16], &sorted[n / 2]) {
        return 0;
    }
    let crowd = |p: &[f64; 3]| sorted.iter().filter(|q| alike(p, q)).count();
    let candidates = sorted.iter().filter(|p| 2 * clipped >= n || !clips(p));
    let Some((most, sticker)) = candidates.map(|p| (crowd(p), p)).max_by_key(|(most, _)| *most)
    else {
        return 0;
    };
    // If no group has two fifths of the pixels, it is unknown which colour is the sticker's.
    if 5 * most < 2 * n {
        return 0;
    }
    let foreign = |p: &&[f64; 3]| !alike(p, sticker) && !glares(sticker, p);
    sorted.iter().take_while(foreign).count().min(n / 2)
}

/// Returns whether a sticker of the colour `dark` may look like `bright` under a reflection, which
/// adds equal light to all channels.
fn glares(bright: &[f64; 3], dark: &[f64; 3]) -> bool {
    let (b, d) = (bright.map(to_linear), dark.map(to_linear));
    let saturation = |p: &[f64; 3]| {
        let (high, low) = (p[0].max(p[1]).max(p[2]), p[0].min(p[1]).min(p[2]));
        (high - low) / high.max(1e-3)
    };
    // A channel that clips does not show how much light the reflection added.
    let added: Vec<f64> = (0..3).filter(|&c| bright[c] < CLIPPED).map(|c| b[c] - d[c]).collect();
    let (high, low) = (
        added.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        added.iter().copied().fold(f64::INFINITY, f64::min),
    );
    saturation(&d) > saturation(&b) && low > 0.0 && low > 0.6 * high - 0.02
}
