//! The detector: image -> faces, or the reason why there is none.
//!
//! - in: RGB pixels, an optional window, [`DetectorSettings`]
//! - out: [`FaceSighting`]s, best first, or a [`Refusal`]
//! - source: own work on the paper's scheme (segmentation, filters, neighbours; Zieliński et al. 2007, p. 373)

use super::classes::median;
use super::homography::{self, GRID, OUTLINE, Point, apply};
use super::lattice::{self, Lattice, Onward};
pub(super) use super::patch::Patch;
use super::patch::TileSample;
use super::segment::{Edges, Tile, TileLimits};
use super::{FaceSighting, Rect, Refusal, colours, paper};
use image::RgbImage;
use nalgebra::Matrix3;

/// How tile candidates are made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Method {
    /// Regions enclosed by edges, at several thresholds: leans on no colour.
    #[default]
    Edges,
    /// The paper's colour tables, run lengths and filters.
    Paper2007,
}

/// What the detector may be told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectorSettings {
    /// How tile candidates are made.
    pub method: Method,
    /// Faces whose longest side is below this are not reported [px].
    pub least_width_px: f64,
    /// Faces below this confidence are not reported, 0..=1.
    pub least_confidence: f64,
    /// Cells that must be held by regions of their own, of 9.
    pub least_tiles: usize,
    /// Pictures with more pixels than this are searched at half the size first (a third, ...).
    pub most_pixels: usize,
}

impl Default for DetectorSettings {
    fn default() -> Self {
        Self {
            method: Method::Edges,
            least_width_px: 0.0,
            least_confidence: 0.4,
            least_tiles: 6,
            most_pixels: 700_000,
        }
    }
}

/// Greatest confidence in what may be a face as well as something else.
const PERHAPS: f64 = 0.6;

/// Limits of a tile's shape: generous, because the lattice decides.
pub(super) const SHAPE: TileLimits =
    TileLimits { area: (12.0, f64::INFINITY), fullness: (0.78, 1.09), elongation: 4.5 };

/// Finds the faces of cubes in an image, or in a window of it; best first.
///
/// # Errors
/// [`Refusal`] says why nothing is reported.
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
    // A small face in a large picture survives only at full size.
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
    /// Tile candidates of the edge method at three thresholds, each tile once; the edges and the middle
    /// threshold go with them.
    pub(super) fn candidates(&self) -> (Vec<Tile>, Edges, u8) {
        let edges = Edges::new(&self.rgb, self.width, self.height);
        let (brightest, _) = self.exposure();
        // Dark pictures have weak edges; noisy ones need a higher floor.
        let contrast = (f64::from(brightest) / 255.0).clamp(0.2, 1.0);
        let low = (7.0 * contrast).max(1.3 * f64::from(edges.floor()) + 3.0).min(40.0);
        let mut limits = SHAPE;
        limits.area.1 = (self.width * self.height) as f64 / 9.0;
        let mut tiles: Vec<Tile> = Vec::new();
        for factor in [1.0, 1.6, 2.6, 4.2, 7.0] {
            let threshold = (low * factor).round().clamp(2.0, 120.0) as u8;
            merge(&mut tiles, edges.tiles(threshold, &limits).0);
        }
        (tiles, edges, (low * 1.8).round() as u8)
    }

    /// The faces of the patch in image coordinates.
    fn faces(&self, settings: &DetectorSettings) -> Result<Vec<FaceSighting>, Refusal> {
        let (tiles, edges) = match settings.method {
            Method::Edges => {
                let (tiles, edges, threshold) = self.candidates();
                (tiles, Some((edges, threshold)))
            }
            Method::Paper2007 => (paper::tiles(&self.rgb, self.width, self.height), None),
        };
        let lattices = lattice::vote(&tiles, settings.least_tiles);
        let (larger, lattices): (Vec<_>, Vec<_>) =
            lattices.into_iter().partition(Lattice::is_larger);
        let mut faces: Vec<FaceSighting> =
            lattices.iter().map(|l| self.sighting(l, &tiles, edges.as_ref())).collect();
        faces.sort_by(|a, b| b.confidence.total_cmp(&a.confidence));
        let best = faces.first().map(|f| f.confidence);
        faces.retain(|f| f.confidence >= settings.least_confidence);
        if !faces.is_empty() {
            return Ok(faces);
        }
        let (brightest, clipped) = self.exposure();
        Err(if brightest < 30 {
            Refusal::TooDark { brightest }
        } else if clipped > 0.35 {
            Refusal::Overexposed { share: clipped }
        } else if !larger.is_empty() {
            Refusal::LargerLattice { beyond: larger.iter().map(|l| l.beyond).max().unwrap_or(0) }
        } else if let Some(confidence) = best {
            Refusal::Doubtful { confidence }
        } else if tiles.is_empty() {
            Refusal::NoTiles
        } else {
            Refusal::NoLattice { tiles: tiles.len() }
        })
    }

    /// A lattice as a face: places in the image, colours, confidence.
    fn sighting(
        &self,
        lattice: &Lattice,
        tiles: &[Tile],
        edges: Option<&(Edges, u8)>,
    ) -> FaceSighting {
        let samples: [TileSample; 9] =
            std::array::from_fn(|i| self.sample(&lattice.homography, GRID[i], lattice.sticker));
        let rgb = samples.map(|s| s.rgb);
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
        // A cell without a region of its own may still be a tile: then its inside is even, and it ends where a tile does.
        // What goes on evenly is what the cube lies on.
        let ends = |i: usize| {
            edges.is_none_or(|(edges, threshold)| {
                edges.bound(&lattice.homography, GRID[i], *threshold)
            })
        };
        let even = (0..9)
            .filter(|&i| lattice.tiles[i].is_none() && samples[i].spread < 0.08 && ends(i))
            .count() as f64;
        let held = lattice.count() as f64;
        let support = ((held + 0.6 * even - 4.5) / 4.5).clamp(0.0, 1.0);
        // Six that agree in place, size and form are a face under a hand; they say no more than that. Two rows or two
        // columns do not say on which side the third one is.
        let lies = |along: fn(usize) -> usize| {
            (0..3).all(|k| (0..9).any(|i| along(i) == k && lattice.tiles[i].is_some()))
        };
        let spans = lies(|i| i / 3) && lies(|i| i % 3);
        let exact = held >= 6.0 && spans && lattice.residual < 0.03 && lattice.unevenness < 0.12;
        let support = if exact { support.max(0.48) } else { support };
        let fit = (-(lattice.residual / 0.10).powi(2)).exp();
        let h = &lattice.homography;
        let stripes = 1.0 - (self.patchwork(h, &rgb) / 0.2).min(1.0) * (1.0 - PERHAPS);
        let uneven = (lattice.unevenness / 0.5).powi(2);
        let pitch = homography::smallest_pitch(&GRID.map(|g| apply(h, g)));
        let fullness = lattice.tiles.iter().flatten().map(|&t| tiles[t].fullness).sum::<f64>();
        // Edges take about a pixel from each side of a tile.
        let doubt = form(lattice.sticker + 2.0 / pitch, fullness / held) * variety(hues(&rgb));
        let most = if lattice.onward == Onward::Ends { 1.0 } else { PERHAPS };
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
                // What may be a face is reported, but nobody is told that it is one for sure.
                let found = support * fit * doubt * (-uneven).exp();
                found.min((stripes * found).max(PERHAPS)).min(most)
            },
        }
    }

    /// How much more the colour of the four lines of gaps between a face's tiles differs from line to line than along a
    /// line, over how much it differs from the tiles', at most 1. A cube's body has one colour, and where there is none it
    /// is the tiles beside that show, three of each line; stripes of a cloth have a colour each.
    fn patchwork(&self, h: &Matrix3<f64>, rgb: &[[f64; 3]; 9]) -> f64 {
        let mean = |line: f64, cell: f64, across: bool| {
            let places = [-0.2, -0.1, 0.0, 0.1, 0.2].map(|k| cell + k);
            let at = |t: f64| apply(h, if across { (t, line) } else { (line, t) });
            let pixels: Vec<[f64; 3]> =
                places.into_iter().filter_map(|t| self.pixel(at(t))).collect();
            let n = pixels.len().max(1) as f64;
            std::array::from_fn(|c| pixels.iter().map(|p| p[c]).sum::<f64>() / n)
        };
        let lines = [(-0.5, true), (0.5, true), (-0.5, false), (0.5, false)];
        let gaps = lines.map(|(line, across)| [-1.0, 0.0, 1.0].map(|t| mean(line, t, across)));
        let middle = |of: &[[f64; 3]]| -> [f64; 3] {
            std::array::from_fn(|c| median(of.iter().map(|p| p[c]).collect()))
        };
        let apart =
            |a: &[f64; 3], b: &[f64; 3]| (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f64::max);
        let gap = middle(gaps.as_flattened());
        let own = gaps.map(|line| middle(&line));
        let between = own.iter().map(|line| apart(line, &gap)).sum::<f64>() / 4.0;
        let along =
            gaps.iter().zip(&own).flat_map(|(line, own)| line.iter().map(|g| apart(g, own)));
        let along = along.sum::<f64>() / 12.0;
        ((between - along).max(0.0) / apart(&gap, &middle(rgb)).max(1.0)).min(1.0)
    }
}

/// Largest difference of two tiles in the shares of red, green and blue in their light.
fn hues(rgb: &[[f64; 3]; 9]) -> f64 {
    let shares = rgb.map(|c| {
        let linear = c.map(|v| colours::to_linear(v) + 0.002);
        let sum: f64 = linear.iter().sum();
        linear.map(|v| v / sum)
    });
    (0..3)
        .map(|k| {
            let level = |s: &[f64; 3]| s[k];
            shares.iter().map(level).fold(0.0, f64::max)
                - shares.iter().map(level).fold(1.0, f64::min)
        })
        .fold(0.0, f64::max)
}

/// What the colours say for a cube, 0..=1: nine tiles of one hue are a window, drawers, a floor more often than a face
/// that is solved.
fn variety(hues: f64) -> f64 {
    PERHAPS + (1.0 - PERHAPS) * ((hues - 0.1) / 0.1).clamp(0.0, 1.0)
}

/// What the tiles' form says for a cube, 0..=1: their share of the pitch, and their mean fullness. Stickers leave little of
/// the face free, as edges see it at least 0.7 of the pitch; discs have a fullness of 1.047.
fn form(share: f64, fullness: f64) -> f64 {
    ((share - 0.5) / 0.2).clamp(0.0, 1.0) * ((1.045 - fullness) / 0.015).clamp(0.0, 1.0)
}

/// Adds tiles, each once: of two at one place the larger stays unless it is ragged.
pub(super) fn merge(tiles: &mut Vec<Tile>, more: Vec<Tile>) {
    let old = tiles.len();
    for tile in more {
        let reach = 0.25 * tile.area.sqrt();
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

/// Tile candidates of a whole picture in its own pixels, as the default method makes them.
#[must_use]
pub fn candidates(image: &RgbImage) -> Vec<Tile> {
    let whole = Rect { x: 0, y: 0, width: image.width(), height: image.height() };
    Patch::new(image, whole, 1).candidates().0
}

/// A window around a face predicted by its outline, with a margin in widths of the face.
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

/// Places of the tile centres of an outline, for callers that know the corners only.
#[must_use]
pub fn centres_of(corners: &[Point; 4]) -> Option<[Point; 9]> {
    // Four pairs are exact but fewer than `fit` wants for a homography: the edges' middles follow from the
    // diagonals, so the quadrilateral's own map is used.
    let (a, b, c, d) = (corners[0], corners[1], corners[2], corners[3]);
    let (dx1, dx2, sx) = (b.0 - c.0, d.0 - c.0, a.0 - b.0 + c.0 - d.0);
    let (dy1, dy2, sy) = (b.1 - c.1, d.1 - c.1, a.1 - b.1 + c.1 - d.1);
    let det = dx1 * dy2 - dx2 * dy1;
    if det.abs() < 1e-12 {
        return None;
    }
    let (g, h) = ((sx * dy2 - dx2 * sy) / det, (dx1 * sy - sx * dy1) / det);
    let unit = Matrix3::new(
        b.0 - a.0 + g * b.0,
        d.0 - a.0 + h * d.0,
        a.0,
        b.1 - a.1 + g * b.1,
        d.1 - a.1 + h * d.1,
        a.1,
        g,
        h,
        1.0,
    );
    Some(GRID.map(|(x, y)| apply(&unit, ((x + 1.5) / 3.0, (y + 1.5) / 3.0))))
}

/// The homography of a sighting's measured tiles.
#[must_use]
pub fn homography_of(face: &FaceSighting) -> Option<Matrix3<f64>> {
    let pairs: Vec<_> = (0..9).map(|i| (GRID[i], face.centres[i])).collect();
    homography::fit(&pairs)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::Intrinsics;
    use crate::spatial::Pose;
    use crate::vision::testing::Drawing;
    use nalgebra::{Translation3, UnitQuaternion, Vector3};
    use proptest::prelude::*;

    const CAMERA: Intrinsics = Intrinsics {
        width: 320,
        height: 240,
        focal: (420.0, 420.0),
        centre: (159.5, 119.5),
        distortion: (0.0, 0.0),
    };
    const COLOURS: [[u8; 9]; 2] = [[0, 1, 2, 3, 4, 5, 4, 1, 0], [5, 5, 2, 0, 3, 3, 1, 4, 2]];

    /// The front and the top of a cube.
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
        for face in &faces {
            let read = (0..4).map(|k| face.turned(k).colours);
            assert!(read.clone().any(|c| COLOURS.contains(&c)), "{:?}", face.colours);
            assert!(face.confidence > 0.8);
        }
    }

    #[test]
    fn the_papers_colours_find_them_too() {
        let settings =
            DetectorSettings { method: Method::Paper2007, ..DetectorSettings::default() };

        let faces = detect(&drawing().render(), None, &settings).unwrap();

        assert!(faces[0].confidence > 0.8);
    }

    #[test]
    fn a_refusal_says_why() {
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

    #[test]
    fn a_window_gives_the_same_places_as_the_whole_picture() {
        let image = drawing().render();
        let whole = detect(&image, None, &DetectorSettings::default()).unwrap();
        let window = window_around(&whole[0].corners, 0.3);

        let part = detect(&image, window, &DetectorSettings::default()).unwrap();

        let apart = homography::distance(part[0].centres[4], whole[0].centres[4]);
        assert!(apart < 0.3, "{apart}");
    }

    proptest! {
        #[test]
        fn no_picture_makes_it_panic(
            width in 0u32..60, height in 0u32..60, seed in 0u64..1000, grain in 1u32..9,
        ) {
            let level = |x: u32, y: u32, c: u64| {
                let cell = u64::from(x / grain) * 7919 + u64::from(y / grain) * 104_729 + c * 31 + seed;
                (cell.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 56) as u8
            };
            let image = RgbImage::from_fn(width, height, |x, y| {
                image::Rgb([level(x, y, 0), level(x, y, 1), level(x, y, 2)])
            });
            for method in [Method::Edges, Method::Paper2007] {
                let settings = DetectorSettings { method, ..DetectorSettings::default() };
                let _ = detect(&image, None, &settings);
            }
        }
    }
}
