//! Measurement of sub-pixel edges of the tiles of a face whose pose is nearly known.
//!
//! A profile, which is a row of colours, is sampled across each side of each tile, along the normal
//! of the side's image. It is averaged over the middle half of the side, so that rounded corners
//! play no part. The plateau of the profile is the tile's colour. The edge is where the colour is
//! half way from the plateau to the colour beyond the side. The method assumes no colours, no black
//! gap and no size of the stickers: the groove between two tiles may be a wide gap, a dark line, or
//! only the step between two colours.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | edge too weak | [`CONTRAST`], or five times the noise | noise makes edges of its own |
//! | gap shows its own colour | [`WIDE_GAP`] px | blur fills a narrower one with the tiles' light |
//! | groove as narrow as the blur | [`NARROW`] px more sigma | the colours beside it shift it |
//! | outer edge, colour of the rim unknown | [`RIM`] px more sigma | outer light fills the rim |
//! | side seen too small | [`LEAST_PITCH`] px a pitch | no room for a plateau and an edge |
//! | side of an almost edge-on face | [`GRAZING`] px a pitch | enough to say that it is there |
//!
//! - in: RGB pixels, lens, `camera_from_face`, share of the pitch that is sticker
//! - out: [`Crossing`]s: places along image normals (px), with their standard deviations
//! - source: own work; normal search as in Harris, "Tracking with rigid models" (1992)

use super::homography::Point;
use super::undistort::Lens;
use crate::spatial::Pose;
use image::RgbImage;
use nalgebra::Point3;

/// Quantity that a crossing measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// Middle between the edges of two neighbouring tiles, which is independent of the stickers'
    /// size.
    Middle,
    /// Distance between the edges of two neighbouring tiles.
    Gap,
    /// Edge of the first of two neighbouring tiles alone.
    First,
    /// Edge of the second of two neighbouring tiles alone.
    Second,
    /// Edge of an outer tile towards the rim of the face.
    Outer,
}

/// Measured edge at the side between two cells, or at the outer side of one cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Crossing {
    /// Number of the face, given by the caller.
    pub(super) face: usize,
    /// Quantity that was measured.
    pub(super) kind: Kind,
    /// Middle of the side between the cells, in pitches from the face's centre.
    pub(super) side: Point,
    /// Direction in the face from the first cell to the second, or outwards at an outer side.
    pub(super) across: Point,
    /// Unit normal of the side's image, in the direction of `across`.
    pub(super) normal: Point,
    /// Measured place as a coordinate along the normal, or the distance for [`Kind::Gap`] (px).
    pub(super) measured: f64,
    /// Standard deviation of `measured` from noise alone (px).
    pub(super) sigma: f64,
    /// Length of a pitch along the normal (px).
    pub(super) scale: f64,
}

/// Size of the stickers in a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stickers {
    /// Side of a sticker as a share of the pitch.
    pub(super) share: f64,
    /// Distance by which blur and the camera's tone curve move a sticker's edges outwards (px).
    pub(super) bloom: f64,
    /// Distance beyond `bloom` by which the narrow rim of the face moves outer edges outwards (px).
    pub(super) outer: f64,
}

impl Crossing {
    /// Computes the value that [`Crossing::measured`] would have (px) if the face were at
    /// `camera_from_face`. `pitch` is the distance of two tile centres (m).
    pub(super) fn predicted(
        &self,
        lens: &Lens,
        camera_from_face: &Pose,
        pitch: f64,
        stickers: Stickers,
    ) -> f64 {
        let half = 0.5 * (1.0 - stickers.share);
        let along = |sign: f64| {
            let (u, v) = (
                self.side.0 + sign * half * self.across.0,
                self.side.1 + sign * half * self.across.1,
            );
            let p = camera_from_face * Point3::new(u * pitch, v * pitch, 0.0);
            // A trial step of the fit may put the point behind the camera.
            let (x, y) = lens.project(&Point3::new(p.x, p.y, p.z.max(1e-3)));
            x * self.normal.0 + y * self.normal.1
        };
        // Bloom moves both edges of a gap towards each other, so it cancels in their middle.
        match self.kind {
            Kind::Middle => 0.5 * (along(-1.0) + along(1.0)),
            Kind::Gap => along(1.0) - along(-1.0) - 2.0 * stickers.bloom,
            Kind::First => along(-1.0) + stickers.bloom,
            Kind::Second => along(1.0) - stickers.bloom,
            Kind::Outer => along(-1.0) + stickers.bloom + stickers.outer,
        }
    }
}

/// Places along a side at which colours are sampled, from the side's middle, as shares of a
/// sticker's side.
const ALONG: [f64; 5] = [-0.26, -0.13, 0.0, 0.13, 0.26];
/// Weight of the samples at one of these places in the mean of all.
const ROW: f32 = 1.0 / ALONG.len() as f32;
/// Depth to which a profile reaches into a tile, and depth at which its plateau begins, as shares
/// of a sticker's side.
const DEPTH: (f64, f64) = (0.29, 0.14);
/// Greatest number of taps, which are the samples along a profile.
const TAPS: usize = 96;
/// Least contrast of an edge: Euclidean distance in RGB, whose channels are 0..=255. The contrast
/// must also be five times the noise.
const CONTRAST: f32 = 14.0;
/// Least width at which a gap shows its own colour (px).
const WIDE_GAP: f64 = 3.0;
/// Standard deviation that is added to the place of a groove as narrow as the blur (px).
const NARROW: f64 = 0.07;
/// Standard deviation that is added to an outer edge with a rim of unknown colour (px).
const RIM: f64 = 0.2;
/// Least length of a pitch at which a side is measured (px).
const LEAST_PITCH: f64 = 5.0;
/// Least length of a pitch along the sides of faces that are nearly edge-on (px).
const GRAZING: f64 = 1.2;

/// Colour in RGB, 0..=255.
pub(super) type Rgb = [f32; 3];

/// Returns `a` minus `b`, channel by channel.
fn difference(a: Rgb, b: Rgb) -> Rgb {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Returns the dot product of two colours as vectors.
fn dot(a: Rgb, b: Rgb) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Returns the Euclidean length of a difference of colours.
fn length(a: Rgb) -> f32 {
    dot(a, a).sqrt()
}

/// The two colours on either side of an edge.
#[derive(Debug, Clone, Copy)]
struct Contrast {
    /// Colour of the tile.
    plateau: Rgb,
    /// Colour on the other side of the edge.
    beyond: Rgb,
}

impl Contrast {
    /// Returns the difference in RGB from the colour beyond the edge to that of the tile.
    fn axis(self) -> Rgb {
        difference(self.plateau, self.beyond)
    }

    /// Returns the Euclidean distance of the two colours in RGB.
    fn size(self) -> f32 {
        length(self.axis())
    }
}

/// Colours at equal steps (taps) along the normal of a side.
struct Profile {
    /// Colours, of which the first `count` are used.
    taps: [Rgb; TAPS],
    /// Number of taps.
    count: usize,
    /// Place of the first tap along the normal (px); 0 is the side's middle.
    start: f64,
    /// Distance from one tap to the next (px).
    step: f64,
}

impl Profile {
    /// Returns the place of a tap on the normal of the side (px from the side's middle).
    fn at(&self, tap: usize) -> f64 {
        self.start + self.step * tap as f64
    }

    /// Returns the tap that is nearest to a place on the normal (px from the side's middle).
    fn tap(&self, at: f64) -> usize {
        (((at - self.start) / self.step).round().max(0.0) as usize).min(self.count - 1)
    }

    /// Computes the mean colour of the taps `from..=to`, and the noise: the standard deviation of a
    /// channel of a single tap.
    fn plateau(&self, from: usize, to: usize) -> (Rgb, f32) {
        let taps = &self.taps[from..=to];
        let n = taps.len() as f32;
        let mean: Rgb = std::array::from_fn(|c| taps.iter().map(|t| t[c]).sum::<f32>() / n);
        let sum: f32 = taps.iter().map(|t| dot(difference(*t, mean), difference(*t, mean))).sum();
        (mean, (sum / (3.0 * (n - 1.0).max(1.0))).sqrt())
    }

    /// Finds the place where the colour is half way from `beyond` to `plateau` (px from the side's
    /// middle), and the slope of the colour there, as a share of the contrast per pixel. The search
    /// runs from tap `from` to tap `last` in steps of `way`, 1 or -1. Returns `None` if the colour
    /// at `from` is nearer to `plateau` already, or if there is no such place.
    fn half_way(
        &self,
        colours: Contrast,
        from: usize,
        way: isize,
        last: usize,
    ) -> Option<(f64, f64)> {
        let axis = colours.axis();
        let square = dot(axis, axis);
        // The level of a colour is its projection on the line between the two colours: 0 at
        // `beyond`, 1 at the plateau. Each channel thus counts by its contrast.
        let level = |tap: usize| dot(difference(self.taps[tap], colours.beyond), axis) / square;
        let (mut tap, mut before) = (from, level(from));
        if before >= 0.5 {
            return None;
        }
        // If `last` is behind `from`, nothing is searched: the middle of a groove may be at the
        // very end of its reach, inside a plateau.
        while (last as isize - tap as isize) * way > 0 {
            let next = tap.checked_add_signed(way)?;
            let here = level(next);
            if here >= 0.5 {
                let share = f64::from((0.5 - before) / (here - before).max(1e-6));
                let place = self.at(tap) + share * (self.at(next) - self.at(tap));
                // The slope over two taps would depend too much on the noise.
                let (low, high) =
                    (tap.min(next).saturating_sub(1), (tap.max(next) + 1).min(self.count - 1));
                let rise = f64::from((level(high) - level(low)).abs());
                return Some((place, (rise / (self.step * (high - low) as f64)).max(0.02)));
            }
            (tap, before) = (next, here);
        }
        None
    }
}

/// Predicted place of a face whose edges are to be measured.
#[derive(Debug, Clone, Copy)]
pub(super) struct Prediction<'a> {
    /// Number of the face, given by the caller.
    pub(super) face: usize,
    /// Predicted pose of the face.
    pub(super) camera_from_face: &'a Pose,
    /// Side of a sticker as a share of the pitch.
    pub(super) share: f64,
    /// Greatest distance of an edge from its prediction, in pitches.
    pub(super) tolerance: f64,
}

/// Measurement of edges in an image.
pub(super) struct Probe<'a> {
    raw: &'a [u8],
    width: usize,
    height: usize,
    lens: &'a Lens,
    /// Distance of two tile centres (m).
    pitch: f64,
    /// Least length of a pitch along a side that is measured (px).
    least_along: f64,
}

impl<'a> Probe<'a> {
    /// Makes a probe of an image; `pitch` is the distance of two tile centres (m).
    pub(super) fn new(image: &'a RgbImage, lens: &'a Lens, pitch: f64) -> Self {
        let (width, height) = (image.width() as usize, image.height() as usize);
        Self { raw: image.as_raw(), width, height, lens, pitch, least_along: LEAST_PITCH }
    }

    /// Returns this probe for faces that are nearly edge-on as well. Their edges are inexact, but
    /// they show that the face is there.
    pub(super) fn grazing(self) -> Self {
        Self { least_along: GRAZING, ..self }
    }

    /// Samples the image at equal steps from the pixel `from`, one sample for each tap, and adds
    /// the colours to `taps`, weighted by [`ROW`]. Returns `None` if a sample lies outside the
    /// image.
    fn sample(&self, from: Point, step: Point, taps: &mut [Rgb]) -> Option<()> {
        let last = (taps.len() - 1) as f64;
        // The image is convex: if both ends lie inside, so do all samples. The margin is for the
        // rounding errors of the 32-bit steps.
        let inside = |p: Point| {
            p.0 >= 0.0
                && p.1 >= 0.0
                && p.0 < (self.width - 1) as f64 - 0.01
                && p.1 < (self.height - 1) as f64 - 0.01
        };
        if !(inside(from) && inside((from.0 + last * step.0, from.1 + last * step.1))) {
            return None;
        }
        let stride = 3 * self.width;
        let (mut x, mut y) = (from.0 as f32, from.1 as f32);
        let (dx, dy) = (step.0 as f32, step.1 as f32);
        for tap in taps {
            // Bilinear interpolation between four pixels. One instruction converts a float to or
            // from a signed 32-bit integer. A conversion by way of `usize` takes a dozen, and this
            // loop takes about 4 % of the time of a run.
            let (left, above) = (x as i32, y as i32);
            let (fx, fy) = (x - left as f32, y - above as f32);
            let (column, row) = (left as usize, above as usize);
            let (upper, lower) = ((1.0 - fy) * ROW, fy * ROW);
            let (a, b, c, d) = (upper * (1.0 - fx), upper * fx, lower * (1.0 - fx), lower * fx);
            let at = row * stride + 3 * column;
            let up = self.raw.get(at..at + 6)?;
            let down = self.raw.get(at + stride..at + stride + 6)?;
            tap[0] += a * f32::from(up[0])
                + b * f32::from(up[3])
                + c * f32::from(down[0])
                + d * f32::from(down[3]);
            tap[1] += a * f32::from(up[1])
                + b * f32::from(up[4])
                + c * f32::from(down[1])
                + d * f32::from(down[4]);
            tap[2] += a * f32::from(up[2])
                + b * f32::from(up[5])
                + c * f32::from(down[2])
                + d * f32::from(down[5]);
            x += dx;
            y += dy;
        }
        Some(())
    }

    /// Projects a point of the face, given in pitches from the face's centre, to the image (px).
    /// Returns `None` if the point is less than 2 cm in front of the camera.
    fn project(&self, camera_from_face: &Pose, at: Point) -> Option<Point> {
        let p = camera_from_face * Point3::new(at.0 * self.pitch, at.1 * self.pitch, 0.0);
        (p.z > 0.02).then(|| self.lens.project(&p))
    }

    /// Measures the edges of the nine tiles of a face and appends the crossings to `out`. `body` is
    /// the colour of the cube between the stickers, if it is known from a face measured before.
    /// Returns this colour as measured on this face, or `body` if its gaps are too narrow to show
    /// it.
    pub(super) fn measure(
        &self,
        prediction: &Prediction<'_>,
        body: Option<Rgb>,
        out: &mut Vec<Crossing>,
    ) -> Option<Rgb> {
        if self.width < 2 || self.height < 2 {
            return body;
        }
        // `side` is on the line at x = `line` in the row `cell` if `way` is 0, else on the line at
        // y = `line` in the column `cell`.
        let side = |line: f64, cell: f64, way: usize| {
            let (across, along) =
                if way == 0 { ((1.0, 0.0), (0.0, 1.0)) } else { ((0.0, 1.0), (1.0, 0.0)) };
            let at = (line * across.0 + cell * along.0, line * across.1 + cell * along.1);
            Side { face: prediction.face, middle: at, across, along, outer: false }
        };
        let cells = [0, 1].into_iter().flat_map(|way| [-1.0, 0.0, 1.0].map(|cell| (way, cell)));
        // The four lines between the cells have three sides each. All twelve are sampled before any
        // is measured, because the widest gaps give the colour of the body for the others.
        let mut inner: Vec<Across> = Vec::with_capacity(12);
        for (way, cell) in cells.clone() {
            for line in [-0.5, 0.5] {
                inner.extend(self.across(side(line, cell, way), prediction));
            }
        }
        let grooves: Vec<Option<Groove>> =
            inner.iter().map(|across| across.groove(prediction)).collect();
        // For a gap that is too narrow to show its own colour, that of the wide gaps is used, on
        // this face or on one measured before.
        let wide = inner.iter().zip(&grooves).filter_map(|(across, groove)| {
            let groove = groove.as_ref().filter(|g| g.detour)?;
            (across.width(groove)? >= WIDE_GAP).then(|| across.profile.taps[groove.middle])
        });
        let body = median(&wide.collect::<Vec<Rgb>>()).or(body);
        for (across, groove) in inner.iter().zip(&grooves) {
            if let Some(groove) = groove {
                across.between(groove, prediction.share, body, out);
            }
        }
        // An outer side has the rim in place of a second tile. Its direction is outwards, so that
        // the tile always comes first.
        for (way, cell) in cells {
            for (line, sign) in [(-1.5, -1.0), (1.5, 1.0)] {
                let mut side = side(line, cell, way);
                side.across = (sign * side.across.0, sign * side.across.1);
                side.outer = true;
                if let Some(across) = self.across(side, prediction) {
                    across.outside(prediction, body, out);
                }
            }
        }
        body
    }

    /// Samples the profile across one side of a tile. Returns `None` if the profile leaves the
    /// image or if the face is seen too obliquely.
    fn across(&self, side: Side, prediction: &Prediction<'_>) -> Option<Across> {
        let Prediction { camera_from_face, share, .. } = *prediction;
        let place = |across: f64, along: f64| {
            let (a, b) = (side.across, side.along);
            let at = (
                side.middle.0 + across * a.0 + along * b.0,
                side.middle.1 + across * a.1 + along * b.1,
            );
            self.project(camera_from_face, at)
        };
        // Numerical derivatives of the image along the side and across it.
        let (a, b) = (place(0.0, -0.25)?, place(0.0, 0.25)?);
        let (c, d) = (place(-0.1, 0.0)?, place(0.1, 0.0)?);
        let tangent = (b.0 - a.0, b.1 - a.1);
        let long = tangent.0.hypot(tangent.1);
        let across = (5.0 * (d.0 - c.0), 5.0 * (d.1 - c.1));
        let mut normal = (-tangent.1 / long, tangent.0 / long);
        let mut scale = across.0 * normal.0 + across.1 * normal.1;
        if scale < 0.0 {
            (normal, scale) = ((-normal.0, -normal.1), -scale);
        }
        if !(scale >= LEAST_PITCH && 2.0 * long >= self.least_along) {
            return None;
        }
        let gap = 0.5 * (1.0 - share) * scale;
        // An inner profile reaches as deep into the second tile as into the first. An outer one
        // ends soon beyond the rim, because the background is of no use.
        let reach = gap + DEPTH.0 * share * scale;
        let end = if side.outer { 0.12 * scale + 1.5 } else { reach };
        let step = 0.5_f64.max((reach + end) / (TAPS - 2) as f64);
        let count = ((reach + end) / step) as usize + 1;
        let mut profile = Profile { taps: [[0.0; 3]; TAPS], count, start: -reach, step };
        // The samples follow the tile's own rows, so that a profile of a slanting side does not
        // leave the tile. Their distances are counted along the normal.
        let (dx, dy) = (across.0 / scale, across.1 / scale);
        for along in ALONG {
            let (x, y) = place(0.0, along * share)?;
            let from = (x - reach * dx, y - reach * dy);
            self.sample(from, (step * dx, step * dy), &mut profile.taps[..count])?;
        }
        let origin = place(0.0, 0.0)?;
        let origin = origin.0 * normal.0 + origin.1 * normal.1;
        Some(Across { side, profile, normal, scale, origin })
    }
}

/// Computes the median of each channel. Returns `None` if there are no colours.
fn median(colours: &[Rgb]) -> Option<Rgb> {
    if colours.is_empty() {
        return None;
    }
    Some(std::array::from_fn(|c| {
        let mut levels: Vec<f32> = colours.iter().map(|rgb| rgb[c]).collect();
        levels.sort_by(f32::total_cmp);
        levels[levels.len() / 2]
    }))
}

/// Profile across a side, with its place in the picture.
struct Across {
    side: Side,
    profile: Profile,
    /// Unit normal of the side's image.
    normal: Point,
    /// Length of a pitch along the normal (px).
    scale: f64,
    /// Place of the side's middle along the normal (px).
    origin: f64,
}

/// Groove between two tiles in a profile.
struct Groove {
    /// Colour of the first tile, and its noise.
    first: (Rgb, f32),
    /// Colour of the second tile, and its noise.
    second: (Rgb, f32),
    /// Tap whose colour differs most from both tiles: the middle of a gap or line.
    middle: usize,
    /// Whether there is a gap or a line, not only a step from one colour to the other.
    detour: bool,
    /// First and last tap at which an edge may lie.
    reach: (usize, usize),
    /// Taps where the plateaus of the two tiles begin.
    inner: (usize, usize),
}

impl Across {
    /// Finds the colours of the two tiles beside the side, and the middle of the gap between them.
    /// Returns `None` if no tap is within reach of the predicted edges.
    fn groove(&self, prediction: &Prediction<'_>) -> Option<Groove> {
        let Prediction { share, tolerance, .. } = *prediction;
        let profile = &self.profile;
        let gap = 0.5 * (1.0 - share) * self.scale;
        let inner = gap + DEPTH.1 * share * self.scale;
        let inner = (profile.tap(-inner), profile.tap(inner));
        let first = profile.plateau(0, inner.0);
        let second = profile.plateau(inner.1, profile.count - 1);
        let reach = gap + tolerance * self.scale + 0.5;
        let reach = (profile.tap(-reach), profile.tap(reach));
        // The distance from one colour to the other by way of a third one is longer than the direct
        // one. A gap or a line thus shows as a detour, for any three colours.
        let direct = length(difference(first.0, second.0));
        let detour = |tap: usize| {
            let t = profile.taps[tap];
            length(difference(t, first.0)) + length(difference(t, second.0)) - direct
        };
        let middle = (reach.0..=reach.1).max_by(|a, b| detour(*a).total_cmp(&detour(*b)))?;
        let detour = detour(middle) >= CONTRAST.max(5.0 * first.1.max(second.1));
        Some(Groove { first, second, middle, detour, reach, inner })
    }

    /// Measures the width of a groove at half its contrast with either tile (px); `None` if an edge
    /// is not found.
    fn width(&self, groove: &Groove) -> Option<f64> {
        let beyond = self.profile.taps[groove.middle];
        let half_way = |plateau, way, last| {
            let colours = Contrast { plateau, beyond };
            self.profile.half_way(colours, groove.middle, way, last).map(|(at, _)| at)
        };
        Some(
            half_way(groove.second.0, 1, groove.inner.1)?
                - half_way(groove.first.0, -1, groove.inner.0)?,
        )
    }

    /// Finds the place of a groove that is as narrow as the blur (px from the side's middle).
    /// `start` is a first guess.
    ///
    /// The model is a step between the two plateau colours with a line of any colour on it, both
    /// blurred equally. Returns `None` if the best fit is 1.5 px or more from `start`.
    fn line(&self, groove: &Groove, start: f64) -> Option<f64> {
        let profile = &self.profile;
        let (a, b) = (groove.first.0, groove.second.0);
        let step = difference(b, a);
        let (low, high) = (profile.tap(start - 4.0), profile.tap(start + 4.0));
        let misfit = |at: f64, blur: f64| {
            // The logistic curve models the blurred step, and its slope s (1 - s) the blurred line.
            let (mut across, mut bumps) = ([0.0_f32; 3], 0.0_f32);
            let mut rest = [[0.0_f32; 3]; TAPS];
            let mut bump = [0.0_f32; TAPS];
            for tap in low..=high {
                let s = 1.0 / (1.0 + ((at - profile.at(tap)) * 1.7 / blur).exp()) as f32;
                bump[tap] = s * (1.0 - s);
                bumps += bump[tap] * bump[tap];
                for c in 0..3 {
                    rest[tap][c] = profile.taps[tap][c] - a[c] - s * step[c];
                    across[c] += bump[tap] * rest[tap][c];
                }
            }
            // The bump's height is linear in the model, so its best value needs no search.
            let height = across.map(|c| c / bumps.max(1e-6));
            (low..=high)
                .map(|tap| {
                    (0..3).map(|c| (rest[tap][c] - height[c] * bump[tap]).powi(2)).sum::<f32>()
                })
                .sum::<f32>()
        };
        // For each blur the place is found as the minimum of a parabola through three points, three
        // times with half the distance each. The blur itself is of no interest, so four values of
        // it suffice.
        let mut best = (f32::INFINITY, start, 1.0);
        for blur in [0.6, 0.85, 1.2, 1.7] {
            let mut at = start;
            for reach in [0.6, 0.3, 0.15] {
                let (l, m, r) =
                    (misfit(at - reach, blur), misfit(at, blur), misfit(at + reach, blur));
                let bend = f64::from(l - 2.0 * m + r);
                let shift = if bend > 1e-9 { 0.5 * f64::from(l - r) / bend } else { 0.0 };
                at += shift.clamp(-1.0, 1.0) * reach;
            }
            let cost = misfit(at, blur);
            if cost < best.0 {
                best = (cost, at, blur);
            }
        }
        ((best.1 - start).abs() < 1.5).then_some(best.1)
    }

    /// Makes a crossing of this side from a measurement `at`: the place (px from the side's
    /// middle), or the width of the gap (px) for [`Kind::Gap`]. `sigma` is its standard deviation
    /// (px).
    fn crossing(&self, kind: Kind, at: f64, sigma: f64) -> Crossing {
        let measured = if kind == Kind::Gap { at } else { self.origin + at };
        Crossing {
            face: self.side.face,
            kind,
            side: self.side.middle,
            across: self.side.across,
            normal: self.normal,
            measured,
            sigma,
            scale: self.scale,
        }
    }

    /// Measures the edges at the side between two tiles and appends them to `out`. `share` is the
    /// side of a sticker as a share of the pitch, `body` the colour between the stickers if it is
    /// known.
    fn between(&self, groove: &Groove, share: f64, body: Option<Rgb>, out: &mut Vec<Crossing>) {
        let profile = &self.profile;
        let gap = 0.5 * (1.0 - share) * self.scale;
        let ((first, noise_a), (second, noise_b)) = (groove.first, groove.second);
        let mut push = |kind, at, sigma| out.push(self.crossing(kind, at, sigma));
        if groove.detour {
            let here = profile.taps[groove.middle];
            let edge = |(plateau, noise): (Rgb, f32), beyond: Rgb, way: isize, last: usize| {
                let colours = Contrast { plateau, beyond };
                let contrast = colours.size();
                if contrast < CONTRAST.max(5.0 * noise) {
                    return None;
                }
                let (at, slope) = profile.half_way(colours, groove.middle, way, last)?;
                // An error of the level divided by the slope is the error of the place.
                Some((at, f64::from(noise / contrast) / slope))
            };
            let a = edge(groove.first, here, -1, groove.inner.0);
            let b = edge(groove.second, here, 1, groove.inner.1);
            match (a, b) {
                // Both tiles show an edge: the groove has a middle and a width.
                (Some(a), Some(b)) => {
                    let half = 0.5 * (a.0 + b.0);
                    let narrow = b.0 - a.0 < WIDE_GAP;
                    let middle = if narrow { self.line(groove, half) } else { Some(half) };
                    if let Some(middle) = middle {
                        let more = if narrow { NARROW } else { 0.0 };
                        push(Kind::Middle, middle, (0.5 * a.1.hypot(b.1)).hypot(more));
                    }
                    // The width is measured at half the contrast with the gap's own colour. A
                    // narrow gap does not show it, so the body's colour is used.
                    let beyond = body.unwrap_or(here);
                    if let (Some(a), Some(b)) = (
                        edge(groove.first, beyond, -1, groove.inner.0),
                        edge(groove.second, beyond, 1, groove.inner.1),
                    ) {
                        push(Kind::Gap, b.0 - a.0, a.1.hypot(b.1));
                    }
                }
                // The other tile has the colour of the gap, or its edge is too weak.
                (Some(a), None) => push(Kind::First, a.0, a.1),
                (None, Some(b)) => push(Kind::Second, b.0, b.1),
                (None, None) => {}
            }
            return;
        }
        let colours = Contrast { plateau: first, beyond: second };
        let direct = colours.size();
        if direct < CONTRAST.max(5.0 * noise_a.max(noise_b)) {
            return;
        }
        // There is only one step: between two tiles without a gap, or at the edge of a tile whose
        // neighbour has the colour of the gap.
        let Some((at, slope)) = profile.half_way(colours, groove.reach.1, -1, groove.reach.0)
        else {
            return;
        };
        let sigma = f64::from(noise_a.max(noise_b) / direct) / slope;
        // Without a gap the step is in the middle, else at an edge of the gap. A step between these
        // two places is ambiguous and is not measured.
        if gap < 0.6 || at.abs() < 0.4 * gap {
            push(Kind::Middle, at, sigma);
        } else if at.abs() > 0.6 * gap {
            push(if at < 0.0 { Kind::First } else { Kind::Second }, at, sigma);
        }
    }

    /// Measures the edge of an outer tile towards the rim of the face and appends it to `out`.
    /// `body` is the colour of the rim if it is known.
    fn outside(&self, prediction: &Prediction<'_>, body: Option<Rgb>, out: &mut Vec<Crossing>) {
        let Prediction { share, tolerance, .. } = *prediction;
        let (profile, scale) = (&self.profile, self.scale);
        let edge = -0.5 * (1.0 - share) * scale;
        let inner = profile.tap(edge - DEPTH.1 * share * scale);
        let (plateau, noise) = profile.plateau(0, inner);
        let last = profile.tap(edge + tolerance * scale + 1.0).min(profile.count - 2);
        let change = |tap: usize| length(difference(profile.taps[tap + 1], profile.taps[tap - 1]));
        // The first steep place outwards is the edge of the tile. Then comes the rim, and only then
        // the edge of the background, which may be steeper.
        let least = (0.7 * CONTRAST).max(4.0 * noise);
        let Some(steep) = (inner.max(1)..=last)
            .find(|&k| change(k) >= least && (k == last || change(k) >= change(k + 1)))
        else {
            return;
        };
        // The rim begins where the profile is flat again.
        let mut beyond = steep;
        while beyond + 2 < profile.count && change(beyond + 1) < change(beyond) {
            beyond += 1;
        }
        let beyond = (beyond + 1).min(profile.count - 1);
        // Light from the background brightens a narrow rim, so the colour of the wide gaps is used
        // in place of that of the rim, if it is known.
        let here = profile.taps[beyond];
        let colours = Contrast { plateau, beyond: body.unwrap_or(here) };
        let contrast = colours.size();
        if contrast < CONTRAST.max(5.0 * noise) {
            return;
        }
        let Some((at, slope)) = profile.half_way(colours, beyond, -1, inner) else { return };
        if (at - edge).abs() > tolerance * scale + 1.0 {
            return;
        }
        let more = if body.is_none() { RIM } else { 0.0 };
        let sigma = (f64::from(noise / contrast) / slope).hypot(more);
        out.push(self.crossing(Kind::Outer, at, sigma));
    }
}

/// Side of a cell that is to be measured.
struct Side {
    /// Number of the face, given by the caller.
    face: usize,
    /// Middle of the side, in pitches from the face's centre.
    middle: Point,
    /// Unit vector across the side, in the face.
    across: Point,
    /// Unit vector along the side, in the face.
    along: Point,
    /// Whether the side belongs to the rim of the face.
    outer: bool,
}
