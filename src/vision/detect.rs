//! Detector of a cube's faces: image -> faces, or the reason why no face is reported.
//!
//! The first case of this table that applies is the reason for a refusal:
//!
//! | refusal | threshold | meaning |
//! |---|---|---|
//! | `TooFewPixels` | below 16 x 16 px | nine tiles and their gaps have no room |
//! | `Painted` | tiles of exactly one colour, with sharp edges | a net on a screenshot |
//! | `TooDark` | brightest candidates below 30 of 255 | edges are lost in the noise |
//! | `Overexposed` | more than 35 % of the candidates clip | colours and grooves are lost |
//! | `LargerLattice` | see `lattice` | a keyboard, a floor, a 4x4 cube |
//! | `Doubtful` | confidence below `least_confidence` | may be something else |
//! | `TooSmall` | a lattice of specks, or below `least_width_px` | tiles too small to be read |
//! | `NoTiles`, `NoLattice` | - | no candidates, or no nine of them fit |
//!
//! - in: RGB pixels, an optional window, [`DetectorSettings`]
//! - out: [`FaceSighting`]s, the most certain first, or a [`Refusal`]
//! - source: own work on the paper's scheme (segmentation, filters, neighbours; Zieliński et al.
//!   2007, p. 373)

use super::doubts::{self, MOST_IF_AMBIGUOUS, hues};
use super::homography::{self, GRID, OUTLINE, Point, apply};
use super::lattice::{self, Lattice, Onward};
use super::paper::{self, Filters, Stages};
pub(super) use super::patch::Patch;
use super::patch::TileSample;
use super::segment::{Edges, Tile, TileLimits};
use super::sides::Sides;
use super::{FaceSighting, Rect, Refusal, colours};
use image::RgbImage;

/// Method by which tile candidates are made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Method {
    /// Regions enclosed by edges, at several thresholds. The method assumes no colours.
    #[default]
    Edges,
    /// The paper's colour tables, run lengths and filters.
    Paper2007,
    /// Tiles as by [`Method::Paper2007`], and the paper's square of nine tiles in place of the vote
    /// of lattices: the centre tile has the most neighbours, the corner tiles have the fewest. The
    /// face has no colours.
    Square2007,
}

/// Settings of the detector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectorSettings {
    /// Method by which tile candidates are made.
    pub method: Method,
    /// Least length of a face's longest side (px). Smaller faces are not reported.
    pub least_width_px: f64,
    /// Least confidence of a face that is reported, 0..=1.
    pub least_confidence: f64,
    /// Least number of the nine tiles that must be found as regions of their own.
    pub least_tiles: usize,
    /// Number of pixels above which a picture is scaled down before the first search, to half of
    /// its width and height, a third and so on.
    pub most_pixels: usize,
}

impl Default for DetectorSettings {
    fn default() -> Self {
        Self {
            method: Method::Edges,
            least_width_px: 0.0,
            least_confidence: 0.4,
            least_tiles: 5,
            most_pixels: 700_000,
        }
    }
}

/// Greatest spread of an even tile: see [`TileSample::spread`].
const EVEN: f64 = 0.08;
/// Number of visible sides that is assumed for an even cell with edges all around.
const BOUND: u8 = 4;

/// Limits of a tile's shape. They are wide, because the lattice decides which regions are tiles.
pub(super) const SHAPE: TileLimits =
    TileLimits { area: (12.0, f64::INFINITY), fullness: (0.78, 1.09), elongation: 4.5 };

/// Limits of the shape of tiles that are too small to be read.
const SMALL: TileLimits = TileLimits { area: (3.0, 60.0), fullness: (0.6, 1.4), elongation: 4.5 };

/// Finds the faces of cubes in an image, or in a window of it (px); the most certain face first.
///
/// # Errors
/// [`Refusal`] with the reason why no face is reported.
pub fn detect(
    image: &RgbImage,
    window: Option<Rect>,
    settings: &DetectorSettings,
) -> Result<Vec<FaceSighting>, Refusal> {
    let (width, height) = image.dimensions();
    let whole = Rect { x: 0, y: 0, width, height };
    let window = match window {
        Some(window) => window.inside(width, height),
        None => whole.inside(width, height),
    };
    let Some(window) = window.filter(|w| w.width >= 16 && w.height >= 16) else {
        let (width, height) = window.map_or((0, 0), |w| (w.width, w.height));
        return Err(Refusal::TooFewPixels { width, height });
    };

    let mut step = 1;
    let pixels = window.width as usize * window.height as usize;
    while pixels / (step * step) > settings.most_pixels {
        step += 1;
    }
    let mut result = Patch::new(image, window, step).faces(settings);
    // Small faces are lost in a reduced picture, so without a face it is searched again at larger
    // sizes. The limit on the pixels bounds the time for a huge picture.
    while result.is_err()
        && step > 1
        && pixels / ((step - 1) * (step - 1)) <= 16 * settings.most_pixels
    {
        step -= 1;
        result = Patch::new(image, window, step).faces(settings);
    }
    let faces = result?;

    let widest = faces.iter().map(FaceSighting::width_px).fold(0.0, f64::max);
    let kept: Vec<_> =
        faces.into_iter().filter(|f| f.width_px() >= settings.least_width_px).collect();
    if kept.is_empty() { Err(Refusal::TooSmall { width_px: widest }) } else { Ok(kept) }
}

impl Patch {
    /// Finds the regions of the patch that may be tiles: those that edges enclose at one of five
    /// thresholds, each region once. Returns them with the edge strength of the patch, and a
    /// threshold at which an edge may be the side of a tile.
    pub(super) fn candidates(&self) -> (Vec<Tile>, Edges, u8) {
        let edges = Edges::new(&self.rgb, self.width, self.height);
        let (brightest, _) = self.exposure();
        // Edges are weaker in a dark picture. In a noisy picture the threshold must be above the
        // noise.
        let contrast = (f64::from(brightest) / 255.0).clamp(0.2, 1.0);
        let low = (7.0 * contrast).max(1.3 * f64::from(edges.floor()) + 3.0).min(40.0);
        let mut limits = SHAPE;
        limits.area.1 = (self.width * self.height) as f64 / 9.0;
        let mut tiles: Vec<Tile> = Vec::new();
        // Weak grooves need a low threshold, glare and shadow on a tile a high one.
        for factor in [1.0, 1.6, 2.6, 4.2, 7.0] {
            let threshold = (low * factor).round().clamp(2.0, 120.0) as u8;
            merge(&mut tiles, edges.tiles(threshold, &limits).0);
        }
        (tiles, edges, (low * 1.8).round() as u8)
    }

    /// Finds the faces in the patch. Their places are pixels of the whole image.
    ///
    /// # Errors
    /// [`Refusal`] as in the table of this module's header.
    fn faces(&self, settings: &DetectorSettings) -> Result<Vec<FaceSighting>, Refusal> {
        let (tiles, edges) = match settings.method {
            Method::Square2007 => return self.square().map(|face| vec![face]),
            Method::Edges => {
                let (tiles, edges, threshold) = self.candidates();
                (tiles, Some((edges, threshold)))
            }
            Method::Paper2007 => (paper::tiles(&self.rgb, self.width, self.height), None),
        };
        let mut lattices = lattice::vote(&tiles, settings.least_tiles);
        let mut faces: Vec<FaceSighting> = Vec::new();
        let mut painted = false;
        for i in 0..lattices.len() {
            let mut seen = None;
            // A certain lattice needs no evidence from its sides, and a larger one than 3x3 is no
            // face.
            if let Some((edges, threshold)) = &edges
                && !lattices[i].is_larger()
                && lattices[i].score() <= lattice::CERTAIN
            {
                let (better, shown) = self.mended(&lattices[i], &tiles, edges, *threshold);
                if let Some(better) = better {
                    replace(&mut lattices, i, better, &tiles);
                }
                seen = Some(shown);
            }
            if lattices[i].is_larger() {
                continue;
            }
            if self.is_painted(&lattices[i]) {
                painted = true;
            } else {
                faces.push(self.sighting(&lattices[i], &tiles, seen));
            }
        }
        let mut faces = distinct(faces);
        let best = faces.first().map(|f| f.confidence);
        faces.retain(|f| f.confidence >= settings.least_confidence);
        if !faces.is_empty() {
            return Ok(faces);
        }
        // The exposure is checked before the cases below, because it can cause each of them.
        let (brightest, clipped) = self.exposure_of(&tiles);
        let beyond = lattices.iter().filter(|l| l.is_larger()).map(|l| l.beyond).max();
        Err(if painted {
            Refusal::Painted
        } else if brightest < 30 {
            Refusal::TooDark { brightest }
        } else if clipped > 0.35 {
            Refusal::Overexposed { share: clipped }
        } else if let Some(beyond) = beyond {
            Refusal::LargerLattice { beyond }
        } else if let Some(confidence) = best {
            Refusal::Doubtful { confidence }
        } else if let Some(width_px) = edges.and_then(|(edges, _)| self.small(&edges)) {
            Refusal::TooSmall { width_px }
        } else if tiles.is_empty() {
            Refusal::NoTiles
        } else {
            Refusal::NoLattice { tiles: tiles.len() }
        })
    }

    /// Finds the face in the patch by the paper's square of nine tiles.
    ///
    /// # Errors
    /// [`Refusal`] with the reason why there is no square.
    fn square(&self) -> Result<FaceSighting, Refusal> {
        let stages = Stages::run(&self.rgb, self.width, self.height, &Filters::default());
        // `detect` and its caller judge the width, in pixels of the whole image.
        let square = stages.square_from(0.0)?;
        let tiles = square.tiles.len();
        let mut face = square.face().ok_or(Refusal::NoLattice { tiles })?;
        face.corners = face.corners.map(|p| self.to_image(p));
        face.centres = face.centres.map(|p| self.to_image(p));
        Ok(face)
    }

    /// Returns the level, 0..=255, that a tenth of the tile candidates exceed, and the share of the
    /// candidates that clip. With these a bright window behind a dark cube does not count. With
    /// fewer than nine candidates the values are those of the whole patch.
    fn exposure_of(&self, tiles: &[Tile]) -> (u8, f64) {
        let mut levels: Vec<[u8; 2]> = tiles
            .iter()
            .filter_map(|tile| self.pixel(tile.centre))
            .map(|[r, g, b]| [r.max(g).max(b) as u8, r.min(g).min(b) as u8])
            .collect();
        if levels.len() < 9 {
            return self.exposure();
        }
        levels.sort_unstable();
        let clipped = levels.iter().filter(|level| level[1] >= 250).count();
        (levels[levels.len() * 9 / 10][0], clipped as f64 / levels.len() as f64)
    }

    /// Searches for a face whose tiles are too small to be read. Returns the length of its longest
    /// side in the image (px), or `None` if there is no such face.
    fn small(&self, edges: &Edges) -> Option<f64> {
        // Specks of noise may form lattices by chance, so at least eight tiles must fit well.
        let mut tiles = Vec::new();
        for threshold in [12, 20, 32, 50, 80] {
            merge(&mut tiles, edges.tiles(threshold, &SMALL).0);
        }
        let lattices = lattice::vote(&tiles, 8);
        let face = lattices
            .iter()
            .filter(|l| !l.is_larger() && l.onward == Onward::Ends && l.residual < 0.1)
            .max_by(|a, b| a.score().total_cmp(&b.score()))?;
        let corners = OUTLINE.map(|c| self.to_image(apply(&face.homography, c)));
        let side = |i: usize| homography::distance(corners[i], corners[(i + 1) % 4]);
        Some((0..4).map(side).fold(0.0, f64::max))
    }

    /// Fits a lattice to the sides of its tiles, which are edges of at least the strength
    /// `threshold`. Returns the fitted lattice, or `None` if it is less certain than the given one,
    /// and the visible sides of the nine tiles.
    fn mended(
        &self,
        lattice: &Lattice,
        tiles: &[Tile],
        edges: &Edges,
        threshold: u8,
    ) -> (Option<Lattice>, Seen) {
        let h = &lattice.homography;
        let sides = Sides::best(edges, threshold, h, 0.5 * lattice.sticker);
        let agree = sides.total() >= doubts::AGREE;
        // The given lattice is judged by its even cells with edges all around. Edges alone are not
        // enough: fingers and background have edges as well.
        let bound = GRID.map(|g| {
            let tile =
                edges.bound(h, g, threshold) && self.sample(h, g, lattice.sticker).spread < EVEN;
            if tile { BOUND } else { 0 }
        });
        let certainty = doubts::certainty(lattice, &bound);
        match Lattice::from_sides(tiles, sides.homography, sides.sticker, &sides.seen) {
            Some(better)
                if better.count() >= 3 && doubts::certainty(&better, &sides.seen) >= certainty =>
            {
                (Some(better), Seen { sides: sides.seen, agree })
            }
            _ => (None, Seen { sides: bound, agree }),
        }
    }

    /// Returns whether a program has painted the nine tiles of a lattice, as in a net or an icon on
    /// a screenshot: each tile has exactly one colour and ends within one pixel. A camera adds
    /// noise and blurs the edges.
    fn is_painted(&self, lattice: &Lattice) -> bool {
        let h = &lattice.homography;
        let pitch = homography::smallest_pitch(&GRID.map(|g| apply(h, g)));
        // In a photograph, compression may have removed the noise of tiles as small as this.
        if pitch < PAINTED_PITCH {
            return false;
        }
        // Tiles that clip have no noise in a photograph either, so at least four tiles must not
        // clip. For a photograph `all` ends at the first tile with noise.
        let mut whole = 0;
        let even = GRID.iter().all(|g| {
            let sample = self.sample(h, *g, lattice.sticker);
            whole += usize::from(!sample.clipped);
            sample.spread <= 0.0
        });
        even && whole >= 4
            && GRID.iter().map(|g| self.blurred_sides(apply(h, *g), pitch)).sum::<usize>() <= 4
    }

    /// Counts the blurred sides of a tile that has exactly one colour, 0..=4. On a line from its
    /// centre across a blurred side, the first pixel of another colour is between the colour of the
    /// tile and that of the next pixel. `pitch` is the distance of neighbouring tiles (px).
    fn blurred_sides(&self, centre: Point, pitch: f64) -> usize {
        let is_blurred = |(dx, dy): &(f64, f64)| {
            let at = |k: usize| {
                let k = k as f64;
                self.pixel((centre.0 + k * dx, centre.1 + k * dy))
            };
            let own = at(0)?;
            let edge = (1..=pitch as usize).find(|&k| at(k).is_some_and(|pixel| pixel != own))?;
            let (first, next) = (at(edge)?, at(edge + 1)?);
            // Eight levels are more than an encoder adds to a sharp edge.
            let between = |c: usize| {
                let (near, far) = (first[c] - own[c], next[c] - first[c]);
                near.abs() > 8.0 && far.abs() > 8.0 && near * far > 0.0
            };
            Some((0..3).any(between))
        };
        let directions = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)];
        directions.iter().filter(|direction| is_blurred(direction) == Some(true)).count()
    }

    /// Converts a lattice to a face with its places in the image, its colours and confidences.
    /// `seen` are the visible sides of its tiles, or `None` if they were not examined.
    fn sighting(&self, lattice: &Lattice, tiles: &[Tile], seen: Option<Seen>) -> FaceSighting {
        let samples: [TileSample; 9] =
            std::array::from_fn(|i| self.sample(&lattice.homography, GRID[i], lattice.sticker));
        let rgb = samples.map(|s| s.rgb);
        // The rim of a clipped tile is blurred into the dark gap and does not clip. It shows
        // whether the tile is white or yellow.
        let rims: [_; 9] = std::array::from_fn(|i| {
            let (h, sticker) = (&lattice.homography, lattice.sticker);
            samples[i].clipped.then(|| self.rim(h, GRID[i], sticker)).flatten()
        });
        let (colours, mut confidences) = colours::decide_face_with(&rgb, &rims);
        for (confidence, sample) in confidences.iter_mut().zip(&samples) {
            if sample.clipped {
                *confidence *= 0.5;
            }
        }
        // A black and white picture has no information about colours.
        if self.colourless() {
            confidences = [0.0; 9];
        }
        let sides = seen.map_or([0; 9], |seen| seen.sides);
        // A cell without a region may be covered, for example by a finger, whose colour it then
        // has.
        for i in (0..9).filter(|&i| seen.is_some() && lattice.tiles[i].is_none()) {
            confidences[i] *= (f64::from(sides[i]) / 4.0).powi(2);
        }
        let h = &lattice.homography;
        // Windows, cloth and drawers have nine similar parts as well. Each sign of these lowers the
        // confidence.
        let stripes = 1.0 - (self.patchwork(h, &rgb) / 0.2).min(1.0) * (1.0 - MOST_IF_AMBIGUOUS);
        let pitch = homography::smallest_pitch(&GRID.map(|g| apply(h, g)));
        let held: Vec<&Tile> = lattice.tiles.iter().flatten().map(|&t| &tiles[t]).collect();
        let fullness = held.iter().map(|t| t.fullness).sum::<f64>() / held.len() as f64;
        // The region of a tile is smaller by about a pixel on each side, since its border is an
        // edge. This is added again.
        let doubt =
            doubts::form(lattice.sticker + 2.0 / pitch, fullness) * doubts::variety(hues(&rgb));
        let alike = seen.is_none_or(|seen| seen.agree);
        let most = if lattice.onward == Onward::Ends && alike { 1.0 } else { MOST_IF_AMBIGUOUS };
        FaceSighting {
            corners: OUTLINE.map(|c| self.to_image(apply(&lattice.homography, c))),
            centres: std::array::from_fn(|i| {
                self.to_image(match lattice.tiles[i] {
                    Some(t) => tiles[t].centre,
                    None => apply(&lattice.homography, GRID[i]),
                })
            }),
            seen: lattice.tiles.map(|t| t.is_some()),
            sticker: lattice.sticker.clamp(0.3, 1.0),
            rgb,
            colours,
            confidences,
            confidence: {
                // Signs of a cloth do not lower the confidence below `MOST_IF_AMBIGUOUS`: the face
                // is reported as a possible one, but never as a certain one.
                let found = doubts::certainty(lattice, &sides) * doubt;
                let cloth = stripes.min(doubts::arrangement_evidence(
                    &rgb,
                    &lattice.tiles.map(|tile| tile.is_some()),
                ));
                found.min((cloth * found).max(MOST_IF_AMBIGUOUS)).min(most)
            },
        }
    }
}

/// Least distance of neighbouring tiles (px) at which a lack of noise shows a painted face. A
/// smaller tile may be inside one block of a compressed photograph, and compression removes the
/// noise of dim blocks.
const PAINTED_PITCH: f64 = 14.0;

/// Replaces lattice `i` by `better`, which was fitted to the sides of its tiles, unless another
/// lattice with a higher score shares cells with `better`. If `better` shares cells with a lattice
/// larger than 3x3, it becomes a part of that one.
fn replace(lattices: &mut [Lattice], i: usize, better: Lattice, tiles: &[Tile]) {
    let rivals = (0..lattices.len()).filter(|&j| j != i).map(|j| &lattices[j]);
    let met: Vec<&Lattice> = rivals.filter(|other| better.shares_cells(other, tiles)).collect();
    let larger = met.iter().any(|other| other.is_larger());
    if larger || met.iter().all(|other| other.score() < lattices[i].score()) {
        lattices[i] = better;
        lattice::update_onward(tiles, lattices, i);
    }
    // A lattice that shares cells with a larger one is a part of it.
    if larger {
        lattices[i].onward = Onward::Larger;
    }
}

/// Removes each sighting that overlaps a more certain one. Returns the others, the most certain one
/// first.
fn distinct(mut faces: Vec<FaceSighting>) -> Vec<FaceSighting> {
    // Two lattices of one face, fitted to the same sides, have become the same face.
    faces.sort_by(|a, b| b.confidence.total_cmp(&a.confidence));
    let mut kept: Vec<FaceSighting> = Vec::with_capacity(faces.len());
    for face in faces {
        let centre = face.centres[4];
        if !kept.iter().any(|k| lattice::encloses(&k.corners, centre)) {
            kept.push(face);
        }
    }
    kept
}

/// Visible sides of the tiles of a lattice.
#[derive(Debug, Clone, Copy)]
struct Seen {
    /// Number of visible sides of each tile, 0..=4.
    sides: [u8; 9],
    /// Whether the sides agree: all tiles of a cube end at the same distance from their middles,
    /// while each stripe of a cloth has its own width.
    agree: bool,
}

/// Adds `more` tiles to `tiles`. If two of about the same size are at the same place, only one
/// stays: the larger one, unless its shape is farther from a parallelogram.
pub(super) fn merge(tiles: &mut Vec<Tile>, more: Vec<Tile>) {
    let old = tiles.len();
    for tile in more {
        let reach = 0.25 * tile.area.sqrt();
        // Only tiles from earlier thresholds can be the same one, since the regions of one
        // threshold are disjoint.
        let same = tiles[..old].iter().position(|t| {
            (t.centre.0 - tile.centre.0).abs() < reach
                && (t.centre.1 - tile.centre.1).abs() < reach
                && (0.35..2.9).contains(&(t.area / tile.area))
        });
        match same {
            None => tiles.push(tile),
            Some(i) => {
                let worth = |t: &Tile| t.area.powf(0.3) * (1.0 - 2.0 * (t.fullness - 1.0).abs());
                if worth(&tile) > worth(&tiles[i]) {
                    tiles[i] = tile;
                }
            }
        }
    }
}

/// Finds the regions of a picture that may be tiles, by [`Method::Edges`] at the full size of the
/// picture.
#[must_use]
pub fn candidates(image: &RgbImage) -> Vec<Tile> {
    let whole = Rect { x: 0, y: 0, width: image.width(), height: image.height() };
    Patch::new(image, whole, 1).candidates().0
}

/// Returns the bounding box of points (px), enlarged on each side by `margin` times its longer
/// side, without the part at negative coordinates. Returns `None` if the box is not finite or
/// nothing of it is left.
#[must_use]
pub fn window_around(corners: &[Point], margin: f64) -> Option<Rect> {
    let low = |f: fn(&Point) -> f64| corners.iter().map(f).fold(f64::INFINITY, f64::min);
    let high = |f: fn(&Point) -> f64| corners.iter().map(f).fold(f64::NEG_INFINITY, f64::max);
    let (left, right) = (low(|p| p.0), high(|p| p.0));
    let (top, bottom) = (low(|p| p.1), high(|p| p.1));
    let size = (right - left).max(bottom - top);
    if !size.is_finite() {
        return None;
    }
    let grow = margin * size;
    let (x0, y0) = ((left - grow).max(0.0), (top - grow).max(0.0));
    let (x1, y1) = (right + grow, bottom + grow);
    (x1 > x0 && y1 > y0).then(|| Rect {
        x: x0 as u32,
        y: y0 as u32,
        width: (x1 - x0).ceil() as u32,
        height: (y1 - y0).ceil() as u32,
    })
}

/// Computes the centres of the nine tiles of a face (px) from the corners of its outline (px), in
/// the order of [`FaceSighting::corners`]. Returns `None` if the corners are degenerate.
#[must_use]
pub fn centres_from_corners(corners: &[Point; 4]) -> Option<[Point; 9]> {
    let unit = homography::square_to(corners)?;
    Some(GRID.map(|(x, y)| apply(&unit, ((x + 1.5) / 3.0, (y + 1.5) / 3.0))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::Intrinsics;
    use crate::spatial::Pose;
    use crate::testing::Drawing;
    use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
    use proptest::prelude::*;

    const CAMERA: Intrinsics = Intrinsics {
        width: 320,
        height: 240,
        focal: (420.0, 420.0),
        centre: (159.5, 119.5),
        distortion: (0.0, 0.0),
    };
    /// Numbers of the colours on the front and on the top of [`drawing`].
    const COLOURS: [[u8; 9]; 2] = [[0, 1, 2, 3, 4, 5, 4, 1, 0], [5, 5, 2, 0, 3, 3, 1, 4, 2]];

    /// Returns a drawing of the front and the top of a cube.
    fn drawing() -> Drawing {
        let camera_from_cube = Pose::from_parts(
            Translation3::new(0.01, 0.0, 0.3),
            UnitQuaternion::from_euler_angles(0.6, 0.15, 0.1),
        );
        let half = Translation3::new(0.0, 0.0, -0.0285);
        let up = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
        let faces =
            vec![(camera_from_cube * half, COLOURS[0]), (camera_from_cube * up * half, COLOURS[1])];
        Drawing::new(CAMERA, faces)
    }

    #[test]
    fn two_faces_are_found_and_read() {
        let faces = detect(&drawing().render(), None, &DetectorSettings::default()).unwrap();

        assert_eq!(faces.len(), 2);
        for (drawn, colours) in drawing().faces {
            let centre = CAMERA.project(&Point3::from(drawn.translation.vector));
            let near = |face: &&FaceSighting| homography::distance(face.centres[4], centre) < 1.0;
            let face = faces.iter().find(near).unwrap();
            assert!((0..4).any(|k| face.turned(k).colours == colours), "{:?}", face.colours);
            assert!(face.confidence > 0.8);
        }
    }

    /// Returns a net as a program draws it: tiles of exactly one colour, each with a black line
    /// around it.
    fn painted_net() -> RgbImage {
        let colours: [[u8; 3]; 3] = [[238, 98, 30], [232, 208, 40], [28, 78, 160]];
        RgbImage::from_fn(200, 160, |x, y| {
            let (column, row) = (x.wrapping_sub(60) / 26, y.wrapping_sub(40) / 26);
            let (u, v) = (x.wrapping_sub(60) % 26, y.wrapping_sub(40) % 26);
            let line = |k: u32| k == 1 || k == 24;
            image::Rgb(if column > 2 || row > 2 || u < 1 || v < 1 || u > 24 || v > 24 {
                [60, 60, 66]
            } else if line(u) || line(v) {
                [0, 0, 0]
            } else {
                colours[((column + 2 * row * row) % 3) as usize]
            })
        })
    }

    #[test]
    fn painted_net_is_refused() {
        let found = detect(&painted_net(), None, &DetectorSettings::default());

        assert_eq!(found.unwrap_err(), Refusal::Painted);
    }

    /// A picture without noise is not taken for a painted one if its edges are blurred, as those of
    /// a camera.
    #[test]
    fn noise_free_face_with_blurred_edges_is_found() {
        let drawing = Drawing { noise: 0.0, ..drawing() };

        let faces = detect(&drawing.render(), None, &DetectorSettings::default()).unwrap();

        assert_eq!(faces.len(), 2);
    }

    #[test]
    fn method_of_2007_paper_finds_drawn_face() {
        let settings =
            DetectorSettings { method: Method::Paper2007, ..DetectorSettings::default() };

        let faces = detect(&drawing().render(), None, &settings).unwrap();
        let by_edges = detect(&drawing().render(), None, &DetectorSettings::default()).unwrap();

        assert!(faces[0].confidence > 0.8 && faces[0].colours == COLOURS[0]);
        for (a, b) in faces[0].corners.iter().zip(&by_edges[0].corners) {
            // Both methods agree, but not to the last digit.
            assert!((1e-6..0.5).contains(&homography::distance(*a, *b)), "{a:?} {b:?}");
        }
    }

    /// The square is the dominant face, up to its reading order, in the whole picture and in a
    /// window of it.
    #[test]
    fn square_of_2007_paper_agrees_with_lattice() {
        let settings =
            DetectorSettings { method: Method::Square2007, ..DetectorSettings::default() };
        let image = drawing().render();
        let by_edges = detect(&image, None, &DetectorSettings::default()).unwrap();
        let window = window_around(&by_edges[0].corners, 0.5);

        for window in [None, window] {
            let faces = detect(&image, window, &settings).unwrap();

            assert_eq!(faces.len(), 1);
            assert_eq!(faces[0].seen.iter().filter(|seen| **seen).count(), 4);
            for place in &faces[0].centres {
                let near = |other: &Point| homography::distance(*place, *other) < 2.0;
                assert!(by_edges[0].centres.iter().any(near), "{place:?}");
            }
        }
    }

    #[test]
    fn refusals_distinguish_dark_empty_overexposed_and_tiny_pictures() {
        let settings = DetectorSettings::default();
        let mut dark = drawing();
        dark.light = 0.03;
        let empty = Drawing::new(CAMERA, Vec::new());
        let least = DetectorSettings { least_width_px: 300.0, ..settings };

        let refusal = |image: &RgbImage, settings| detect(image, None, settings).unwrap_err();
        assert!(matches!(refusal(&dark.render(), &settings), Refusal::TooDark { .. }));
        assert!(matches!(
            refusal(&empty.render(), &settings),
            Refusal::NoTiles | Refusal::NoLattice { .. }
        ));
        assert!(matches!(
            refusal(&RgbImage::from_pixel(99, 99, image::Rgb([255; 3])), &settings),
            Refusal::Overexposed { .. }
        ));
        assert!(matches!(refusal(&drawing().render(), &least), Refusal::TooSmall { .. }));
        assert!(matches!(refusal(&RgbImage::new(1, 1), &settings), Refusal::TooFewPixels { .. }));
        assert!(matches!(refusal(&RgbImage::new(0, 0), &settings), Refusal::TooFewPixels { .. }));
    }

    /// A face under two fingers is found at its place, and its hidden tiles are uncertain.
    #[test]
    fn covered_face_is_found_with_uncertain_tiles() {
        let face = Pose::from_parts(
            Translation3::new(0.0, 0.0, 0.25),
            UnitQuaternion::from_euler_angles(0.2, 0.15, 0.1),
        );
        let mut drawing = Drawing::new(CAMERA, vec![(face, COLOURS[0])]);
        let whole = detect(&drawing.render(), None, &DetectorSettings::default()).unwrap();
        // One finger covers a tile and the rim of the middle one, another covers a corner.
        drawing.bars.push((0, [-0.4, -3.0, 0.45, -0.15], [190.0, 140.0, 110.0]));
        drawing.bars.push((0, [0.8, 0.7, 3.0, 1.4], [190.0, 140.0, 110.0]));

        let found = detect(&drawing.render(), None, &DetectorSettings::default()).unwrap();

        for (a, b) in found[0].corners.iter().zip(&whole[0].corners) {
            assert!(homography::distance(*a, *b) < 3.0, "{a:?} {b:?}");
        }
        assert!(found[0].confidence < 0.8 && !found[0].seen[1] && !found[0].seen[8]);
        assert!(found[0].confidences[1] < 0.2, "{:?}", found[0].confidences);
    }

    #[test]
    fn grey_picture_gives_colours_of_zero_confidence() {
        let mut image = drawing().render();
        for pixel in image.pixels_mut() {
            let [r, g, b] = pixel.0.map(u32::from);
            pixel.0 = [((3 * r + 6 * g + b) / 10) as u8; 3];
        }

        let faces = detect(&image, None, &DetectorSettings::default()).unwrap();

        assert!(faces.iter().all(|face| face.confidences == [0.0; 9]));
    }

    #[test]
    fn face_of_twenty_pixels_is_too_small() {
        let face = Pose::translation(0.0, 0.0, 1.2);
        let mut drawing = Drawing::new(CAMERA, vec![(face, COLOURS[0])]);
        drawing.noise = 1.0;

        let refused = detect(&drawing.render(), None, &DetectorSettings::default());

        assert!(
            matches!(
                refused,
                Err(Refusal::TooSmall { width_px }) if (15.0..25.0).contains(&width_px)
            ),
            "{refused:?}"
        );
    }

    #[test]
    fn detection_in_window_agrees_with_whole_picture() {
        let image = drawing().render();
        let whole = detect(&image, None, &DetectorSettings::default()).unwrap();
        let window = window_around(&whole[0].corners, 0.3).unwrap();
        assert!(window.width < CAMERA.width / 2 && window.height < 3 * CAMERA.height / 4);

        let part = detect(&image, Some(window), &DetectorSettings::default()).unwrap();

        for (a, b) in part[0].centres.iter().zip(&whole[0].centres) {
            assert!(homography::distance(*a, *b) < 0.3, "{a:?} {b:?}");
        }
        assert_eq!(part[0].colours, whole[0].colours);
        // A window beside the face shows it only in part.
        let beside = Rect { x: window.x + window.width / 2, ..window };
        let cut = detect(&image, Some(beside), &DetectorSettings::default());
        assert!(matches!(cut, Err(Refusal::Doubtful { .. })), "{cut:?}");
    }

    proptest! {
        #[test]
        fn detect_never_panics_on_random_pictures(
            width in 0u32..60, height in 0u32..60, seed in 0u64..1000, grain in 1u32..9,
        ) {
            let level = |x: u32, y: u32, c: u64| {
                let cell =
                    u64::from(x / grain) * 7919 + u64::from(y / grain) * 104_729 + c * 31 + seed;
                (cell.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 56) as u8
            };
            let image = RgbImage::from_fn(width, height, |x, y| {
                image::Rgb([level(x, y, 0), level(x, y, 1), level(x, y, 2)])
            });
            for method in [Method::Edges, Method::Paper2007, Method::Square2007] {
                let settings = DetectorSettings { method, ..DetectorSettings::default() };
                let _ = detect(&image, None, &settings);
            }
        }
    }
}
