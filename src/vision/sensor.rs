//! Guided reading: the nine tiles of a face whose place is roughly known, in a picture of a hand
//! camera.
//!
//! The prediction says which face is where and how it is turned, so the reading order never comes
//! from the picture. Tiles under a finger are reported as occluded; their colours are not guessed.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | face is off its prediction | `ASTRAY` = 1 pitch | error when the cube was taken, see there |
//! | searched window | 0.6 of the face's width around it | room for `ASTRAY` and the outline |
//! | picture is dark | brightest hundredth < 20 of 255 | edges are lost in the noise |
//! | picture is overexposed | > 50 % clip, no match | colours and grooves are lost |
//! | region may be a tile | 0.25..1.1 of a cell's area | half tiles vote as well |
//! | region is cut, or a finger | outside 0.65..1.5 of the median | its centroid is not a centre |
//! | too few tiles | < 4, or < 2 rows or columns | the pose would be a guess |
//! | lattice one tile beside | 2 tiles more | a column off matches two of three columns |
//! | pose by edges is wrong | 0.06 edges or 0.1 rad off | it locked onto other edges |
//! | tile is occluded | spread 0.10, or no edges around it | a finger covers it or its rim |
//!
//! - in: RGB pixels, intrinsics, the cube's edge (m), the predicted `camera_from_face`
//! - out: [`FaceReading`]: colours in the predicted face's reading order, the measured pose
//! - source: own work

use super::detect::{Patch, SHAPE, centres_from_corners, window_around};
use super::homography::{self, GRID, OUTLINE, Point, distance, polygon};
use super::pose::{refine, residuals};
use super::refine::refine_in;
use super::segment::Tile;
use super::undistort::Lens;
use super::{DetectorSettings, FaceSighting, Rect, Refusal, colours, detect};
use crate::spatial::Pose;
use image::RgbImage;
use nalgebra::{Point3, Translation3};
use serde::{Deserialize, Serialize};

/// A face read at a predicted place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FaceReading {
    /// Mean colour of each tile in the predicted face's reading order, 0..=255, as in the image.
    pub rgb: [[f64; 3]; 9],
    /// Colour of each tile, decided from this face alone: 0..=5 = white, red, green, yellow,
    /// orange, blue.
    pub colours: [u8; 9],
    /// Confidence of each tile's colour, 0..=1; 0 where occluded.
    pub confidences: [f64; 9],
    /// Measured pose in the axes of the predicted frame: origin in the face's centre, x along its
    /// columns, y along its rows, z into the cube.
    pub camera_from_face: Pose,
    /// Root mean square of the reprojection error (px).
    pub residual_px: f64,
    /// Confidence that this is the predicted face at the measured pose, 0..=1.
    pub confidence: f64,
    /// Whether each tile is covered by something or does not differ from its surroundings. The
    /// colour of such a tile means nothing.
    pub occluded: [bool; 9],
}

/// Greatest distance of a face from its prediction, in tile pitches.
///
/// A cube that was just taken from the operator's hand may be off the middle of the jaws, by the
/// error of the stand-alone camera's calibration. Once it was 8.4 mm off, which is three standard
/// deviations, and a limit of 0.6 pitches did not find it. From 0.5 pitches on, a column of the
/// lattice may fit the neighbouring column, so [`vote`] weighs matches against distance, and
/// [`aligned`] tries the neighbouring lattices.
const ASTRAY: f64 = 1.0;

/// Reads the colours and the pose of a face that is expected at `predicted` (`camera_from_face`) on
/// a cube of `edge` (m).
///
/// # Errors
/// [`Refusal::NotExpected`] if too few tiles fit the prediction, [`Refusal::TooDark`] or
/// [`Refusal::Overexposed`] if the light is the reason.
pub fn read_face(
    image: &RgbImage,
    camera: impl Into<Lens>,
    edge: f64,
    predicted: &Pose,
) -> Result<FaceReading, Refusal> {
    let camera = &camera.into();
    let corners =
        project(camera, predicted, edge, &OUTLINE).ok_or(Refusal::NotExpected { matched: 0 })?;
    let window = window_inside(image, &corners).ok_or(Refusal::NotExpected { matched: 0 })?;
    let patch = Patch::new(image, window, 1);
    let (brightest, clipped) = patch.exposure();
    if brightest < 20 {
        return Err(Refusal::TooDark { brightest });
    }
    let (tiles, edges, threshold) = patch.candidates();
    // The lens model works in pixels of the whole image, not of the window.
    let mut tiles: Vec<Tile> = tiles;
    for tile in &mut tiles {
        tile.centre = patch.to_image(tile.centre);
    }

    // The vote is quick, but it only shifts the prediction. A full detection also finds a tilt.
    let start = vote(&tiles, camera, edge, predicted)
        .or_else(|| by_detection(image, camera, edge, predicted, window))
        .ok_or(if clipped > 0.5 {
            Refusal::Overexposed { share: clipped }
        } else {
            Refusal::NotExpected { matched: 0 }
        })?;
    let (pose, face, residual_px) = aligned(&tiles, camera, edge, &start)?;

    // If fingers hide too many edges, the pose from the centroids stays.
    let (pose, residual_px) = on_edges(image, camera, edge, &pose).unwrap_or((pose, residual_px));

    let centres = project(camera, &pose, edge, &GRID).ok_or(Refusal::NotExpected { matched: 0 })?;
    let pairs: Vec<(Point, Point)> =
        (0..9).map(|i| (GRID[i], patch.to_patch(centres[i]))).collect();
    let h = homography::fit(&pairs).ok_or(Refusal::NotExpected { matched: 0 })?;
    let samples: [_; 9] = std::array::from_fn(|i| patch.sample(&h, GRID[i], face.sticker));
    let occluded: [bool; 9] = std::array::from_fn(|i| {
        // A finger over a part of a tile makes its colour uneven. A finger over the whole tile has
        // an even colour, but no edges where the tile's sides should be.
        let even = samples[i].spread < 0.10 && samples[i].inside > 0.95;
        !even || !(face.seen[i] || edges.bound(&h, GRID[i], threshold))
    });
    let rgb = samples.map(|s| s.rgb);
    let (colours, mut confidences) = colours::decide_face(&rgb);
    for i in 0..9 {
        if occluded[i] {
            confidences[i] = 0.0;
        } else if samples[i].clipped {
            // White clips in all channels, but so does yellow in too much light.
            confidences[i] *= 0.5;
        }
    }
    // Seven of nine tiles give full confidence: fingers may cover the others.
    let held = face.seen.iter().filter(|s| **s).count() as f64;
    let pitch = homography::smallest_pitch(&centres);
    let fit = (-(residual_px / (0.08 * pitch)).powi(2)).exp();
    Ok(FaceReading {
        rgb,
        colours,
        confidences,
        camera_from_face: pose,
        residual_px,
        confidence: ((held - 2.0) / 5.0).clamp(0.0, 1.0) * fit,
        occluded,
    })
}

/// Returns the part of the image around a face with these corners (px), with a margin of 0.6 of its
/// width; `None` if less than 16 x 16 px are inside the image.
fn window_inside(image: &RgbImage, corners: &[Point]) -> Option<Rect> {
    window_around(corners, 0.6)?
        .inside(image.width(), image.height())
        .filter(|w| w.width >= 16 && w.height >= 16)
}

/// Refines the pose of a face by the edges of all visible tiles. Returns the refined pose with its
/// residual (px), or `None` if it does not agree with the given `pose`, which comes from centroids.
fn on_edges(image: &RgbImage, camera: &Lens, edge: f64, pose: &Pose) -> Option<(Pose, f64)> {
    let face_from_cube = Translation3::new(0.0, 0.0, edge / 2.0);
    let found = refine_in(image, camera, edge, &(pose * face_from_cube))?;
    let refined = found.camera_from_cube * face_from_cube.inverse();
    let apart = (refined.translation.vector - pose.translation.vector).norm();
    (apart < 0.06 * edge && refined.rotation.angle_to(&pose.rotation) < 0.1)
        .then_some((refined, found.residual_px))
}

/// Projects places of a face (column - 1, row - 1) to pixels. Returns `None` if one of them is less
/// than 2 cm in front of the camera. `edge` is the edge of the cube (m).
fn project<const N: usize>(
    camera: &Lens,
    camera_from_face: &Pose,
    edge: f64,
    places: &[Point; N],
) -> Option<[Point; N]> {
    let pitch = edge / 3.0;
    let mut out = [(0.0, 0.0); N];
    for (pixel, place) in out.iter_mut().zip(places) {
        let p = camera_from_face * Point3::new(place.0 * pitch, place.1 * pitch, 0.0);
        if p.z < 0.02 {
            return None;
        }
        *pixel = camera.project(&p);
    }
    Some(out)
}

/// Returns the predicted pose after a shift parallel to the image plane that brings the most cells
/// of the face onto tiles. Returns `None` if fewer than four cells have a tile then.
fn vote(tiles: &[Tile], camera: &Lens, edge: f64, predicted: &Pose) -> Option<Pose> {
    let centres = project(camera, predicted, edge, &GRID)?;
    let corners = project(camera, predicted, edge, &OUTLINE)?;
    let pitch = homography::smallest_pitch(&centres);
    let cell = polygon(&corners).0.abs() / 9.0;
    // Any tile may belong to any of the nine cells, so each pair of a tile and a cell proposes a
    // shift.
    let fitting: Vec<&Tile> =
        tiles.iter().filter(|t| (0.25..1.1).contains(&(t.area / cell))).collect();
    let mut best: Option<(f64, Point)> = None;
    for tile in &fitting {
        for centre in &centres {
            let shift = (tile.centre.0 - centre.0, tile.centre.1 - centre.1);
            let length = shift.0.hypot(shift.1) / pitch;
            if length > ASTRAY {
                continue;
            }
            let matched = centres
                .iter()
                .filter(|c| {
                    let place = (c.0 + shift.0, c.1 + shift.1);
                    fitting.iter().any(|t| distance(t.centre, place) < 0.2 * pitch)
                })
                .count();
            // A shift by one pitch costs as much as two matches, while a lattice that is one column
            // off loses the three tiles of a column.
            let score = matched as f64 - 2.0 * length;
            if matched >= 4 && best.is_none_or(|(b, _)| score > b) {
                best = Some((score, shift));
            }
        }
    }
    let (_, shift) = best?;
    // The shift is converted from pixels to metres at the depth of the face. The fit that follows
    // corrects for a tilt.
    let z = predicted.translation.z;
    let mut pose = *predicted;
    pose.translation.x += shift.0 * z / camera.focal.0;
    pose.translation.y += shift.1 * z / camera.focal.1;
    Some(pose)
}

/// Finds a first pose of the face by a full detection in `window`, which also finds faces that are
/// tilted farther from their prediction than those of [`vote`]. A detected face may be read in four
/// orders; the pose is that of the order nearest to the prediction. Returns `None` if no face is
/// within [`ASTRAY`] of it.
fn by_detection(
    image: &RgbImage,
    camera: &Lens,
    edge: f64,
    predicted: &Pose,
    window: super::Rect,
) -> Option<Pose> {
    let corners = project(camera, predicted, edge, &OUTLINE)?;
    let expected = centres_from_corners(&corners)?;
    let pitch = homography::smallest_pitch(&expected);
    let faces = detect(image, Some(window), &DetectorSettings::default()).ok()?;
    faces
        .iter()
        .flat_map(|f| (0..4).map(|k| f.turned(k)))
        .map(|f| {
            let apart = (0..9).map(|i| distance(f.centres[i], expected[i])).sum::<f64>() / 9.0;
            (apart / pitch, f)
        })
        .filter(|(apart, _)| *apart < ASTRAY)
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, f)| refine(predicted, |pose, out| residuals(&f, pose, camera, edge, out)).pose)
}

/// Fits the face to the tiles, starting from the pose `start` and then from the four poses that are
/// one tile beside it. A result from beside replaces the first one if at least two more tiles fit.
/// Returns the pose, the face and the residual (px).
///
/// A face that is more than half a tile off its prediction may match the lattice one column beside
/// its own, with two of three columns. Two of fifty missions failed by this, with a face 12 mm off
/// because of an error of an arm's base.
///
/// # Errors
/// [`Refusal::NotExpected`] if too few tiles fit around `start`.
fn aligned(
    tiles: &[Tile],
    camera: &Lens,
    edge: f64,
    start: &Pose,
) -> Result<(Pose, FaceSighting, f64), Refusal> {
    let seen = |settled: &(Pose, FaceSighting, f64)| settled.1.seen.iter().filter(|s| **s).count();
    let mut best = settle(tiles, camera, edge, start)?;
    let pitch = edge / 3.0;
    for (x, y) in [(pitch, 0.0), (-pitch, 0.0), (0.0, pitch), (0.0, -pitch)] {
        let beside = start * Translation3::new(x, y, 0.0);
        if let Ok(settled) = settle(tiles, camera, edge, &beside)
            && seen(&settled) >= seen(&best) + 2
        {
            best = settled;
        }
    }
    Ok(best)
}

/// Matches tiles to the nine cells of the face at `start` and fits its pose, three times with a
/// smaller tolerance each. Returns the pose, the face and the residual (px).
///
/// # Errors
/// [`Refusal::NotExpected`] if too few tiles fit.
fn settle(
    tiles: &[Tile],
    camera: &Lens,
    edge: f64,
    start: &Pose,
) -> Result<(Pose, FaceSighting, f64), Refusal> {
    let mut pose = *start;
    let mut face = FaceSighting {
        corners: [(0.0, 0.0); 4],
        centres: [(0.0, 0.0); 9],
        seen: [false; 9],
        sticker: 0.8,
        rgb: [[0.0; 3]; 9],
        colours: [0; 9],
        confidences: [0.0; 9],
        confidence: 0.0,
    };
    let mut residual = f64::INFINITY;
    // The first tolerance (in pitches) is a little above the 0.2 of the vote. A fitted pose needs
    // less.
    for tolerance in [0.22, 0.15, 0.12] {
        let places =
            project(camera, &pose, edge, &GRID).ok_or(Refusal::NotExpected { matched: 0 })?;
        let corners =
            project(camera, &pose, edge, &OUTLINE).ok_or(Refusal::NotExpected { matched: 0 })?;
        let pitch = homography::smallest_pitch(&places);
        let cell = polygon(&corners).0.abs() / 9.0;
        let mut areas = [0.0; 9];
        for (i, place) in places.iter().enumerate() {
            let nearest = tiles
                .iter()
                .filter(|t| (0.25..1.1).contains(&(t.area / cell)) && t.fullness > SHAPE.fullness.0)
                .map(|t| (distance(t.centre, *place) / pitch, t))
                .min_by(|a, b| a.0.total_cmp(&b.0))
                .filter(|(d, _)| *d < tolerance);
            face.centres[i] = nearest.map_or(*place, |(_, t)| t.centre);
            areas[i] = nearest.map_or(0.0, |(_, t)| t.area);
        }
        // A region much smaller or larger than the others is half a tile, or a finger.
        let mut sorted: Vec<f64> = areas.iter().copied().filter(|a| *a > 0.0).collect();
        sorted.sort_by(f64::total_cmp);
        let median = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0).max(1e-9);
        face.seen = areas.map(|a| (0.65..1.5).contains(&(a / median)));
        let matched = face.seen.iter().filter(|s| **s).count();
        if matched < 4 || !spans(&face.seen) {
            return Err(Refusal::NotExpected { matched });
        }
        face.sticker = (median / cell).sqrt().clamp(0.3, 1.0);
        let fit = refine(&pose, |pose, out| residuals(&face, pose, camera, edge, out));
        (pose, residual) = (fit.pose, fit.rms);
        face.corners = corners;
    }
    Ok((pose, face, residual))
}

/// Returns whether the seen tiles span the face: at least two rows and two columns have two seen
/// tiles each.
fn spans(seen: &[bool; 9]) -> bool {
    let rows = (0..3).filter(|r| (0..3).filter(|c| seen[3 * r + c]).count() >= 2).count();
    let columns = (0..3).filter(|c| (0..3).filter(|r| seen[3 * r + c]).count() >= 2).count();
    rows >= 2 && columns >= 2
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::Intrinsics;
    use crate::testing::Drawing;
    use nalgebra::{Translation3, UnitQuaternion};

    const CAMERA: Intrinsics = Intrinsics {
        width: 384,
        height: 288,
        focal: (500.0, 500.0),
        centre: (191.5, 143.5),
        distortion: (-0.05, 0.0),
    };
    /// Numbers of the colours of the drawn face.
    const COLOURS: [u8; 9] = [0, 1, 2, 3, 4, 5, 4, 1, 0];

    /// Returns the pose of a face 17 cm in front of the camera: x and y (m), tilt and roll (rad).
    fn pose(x: f64, y: f64, tilt: f64, roll: f64) -> Pose {
        Pose::from_parts(
            Translation3::new(x, y, 0.17),
            UnitQuaternion::from_euler_angles(tilt, 0.04, roll),
        )
    }

    #[test]
    fn colours_are_read_in_order_of_predicted_face() {
        for quarter in 0..4 {
            let roll = f64::from(quarter) * std::f64::consts::FRAC_PI_2;
            let truth = pose(0.003, -0.002, 0.06, roll + 0.02);
            let drawing = Drawing::new(CAMERA, vec![(truth, COLOURS)]);

            let reading =
                read_face(&drawing.render(), &CAMERA, 0.057, &pose(0.0, 0.0, 0.0, roll)).unwrap();

            assert_eq!(reading.colours, COLOURS, "quarter {quarter}");
            assert_eq!(reading.occluded, [false; 9]);
            let error = reading.camera_from_face.translation.vector - truth.translation.vector;
            assert!(error.xy().norm() < 2e-4 && error.z.abs() < 1e-3, "{error}");
            assert!(reading.confidence > 0.9);
        }
    }

    #[test]
    fn tiles_under_fingers_are_reported_as_occluded() {
        let truth = pose(0.002, 0.003, 0.05, 0.0);
        let mut drawing = Drawing::new(CAMERA, vec![(truth, COLOURS)]);
        // A finger covers the middle column from above down to the middle of the face.
        drawing.bars.push((0, [-0.5, -3.0, 0.5, 0.2], [120.0, 122.0, 125.0]));

        let reading =
            read_face(&drawing.render(), &CAMERA, 0.057, &pose(0.0, 0.0, 0.0, 0.0)).unwrap();

        let occluded: Vec<usize> = (0..9).filter(|&i| reading.occluded[i]).collect();
        assert_eq!(occluded, [1, 4]);
        for i in [0, 2, 3, 5, 6, 7, 8] {
            assert_eq!(reading.colours[i], COLOURS[i], "tile {i}");
        }
    }

    /// A face up to 0.9 tiles off its prediction is found at its true place, not one column beside
    /// it, where two of its three columns would match.
    #[test]
    fn face_almost_one_tile_off_prediction_is_found() {
        let tile = 0.019;
        for (x, y) in [(0.9, 0.0), (-0.9, 0.0), (0.0, 0.9), (0.0, -0.9), (0.65, 0.65), (-0.6, 0.7)]
        {
            let truth = pose(x * tile, y * tile, 0.05, 0.3);
            let mut drawing = Drawing::new(CAMERA, vec![(truth, COLOURS)]);
            // A finger covers the tile in the middle of the upper row.
            drawing.bars.push((0, [-0.5, -3.0, 0.5, -0.45], [120.0, 122.0, 125.0]));

            let reading =
                read_face(&drawing.render(), &CAMERA, 0.057, &pose(0.0, 0.0, 0.0, 0.3)).unwrap();

            let error = reading.camera_from_face.translation.vector - truth.translation.vector;
            assert!(error.xy().norm() < 4e-4, "{x} {y}: {error}");
            assert!((0..9).all(|i| reading.occluded[i] || reading.colours[i] == COLOURS[i]));
        }
    }

    #[test]
    fn empty_or_black_picture_is_refused() {
        let empty = Drawing::new(CAMERA, Vec::new()).render();
        let black = RgbImage::new(384, 288);
        let at = pose(0.0, 0.0, 0.0, 0.0);

        assert!(matches!(read_face(&empty, &CAMERA, 0.057, &at), Err(Refusal::NotExpected { .. })));
        assert!(matches!(read_face(&black, &CAMERA, 0.057, &at), Err(Refusal::TooDark { .. })));
    }
}
