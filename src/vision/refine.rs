//! The cube's pose at the limit of the geometry: fitted to the sub-pixel edges of all tiles of all visible faces.
//!
//! The model is the cube with nine square stickers a face whose size is not known: their share of the pitch and
//! what blur adds to them are estimated along with the pose. Faces that the detector missed take part as soon as
//! edges are where the pose says, which also decides between the two poses that one face leaves.
//!
//! Tiles repeat: a pose that is one tile off along an edge of the cube has edges where two thirds
//! of its own should be, and is a best fit of its neighbourhood. Where a face that must be seen is
//! not seen whole, the fit is held against those one tile off.
//!
//! - in: image, [`Lens`], the cube's edge (m), first poses from centroids
//! - out: [`CubeLocation`] with its covariance
//! - source: own work; robust weights after Cauchy

use super::FaceSighting;
use super::edges::{Crossing, Kind, Prediction, Probe, Stickers};
use super::fit::moved;
use super::pose::{CubeLocation, cube_from_face, cube_rotations, locate_cube};
use super::undistort::Lens;
use crate::spatial::Pose;
use image::RgbImage;
use nalgebra::{Matrix6, SMatrix, SVector, Translation3, UnitQuaternion, Vector3};

/// What the model leaves unsaid, as a standard deviation of each kind of crossing (px), and as a share of a pitch:
/// uneven stickers, shade, interpolation, the mosaic.
const FLOOR_MIDDLE: f64 = 0.05;
const FLOOR_EDGE: f64 = 0.10;
const FLOOR_GAP: f64 = 0.25;
const FLOOR_SHARE: f64 = 0.002;
/// Spread of what blur adds to all edges of stickers, and of what it adds to outer ones beyond that (px).
const BLOOM: f64 = 0.4;
const OUTER: f64 = 0.1;
/// Tolerances of the passes, in pitches.
const PASSES: [f64; 3] = [0.16, 0.09, 0.06];
/// A face takes part with so many crossings that fit.
const LEAST_CROSSINGS: usize = 9;
/// Share of the pitch that a sticker is thought to have before any is seen.
const SHARE: f64 = 0.86;
/// A pose is believed without a detection with so many fitting crossings a face; a whole face has 24.
const TRACKED: usize = 13;
/// A crossing fits within so many standard deviations.
const FITS: f64 = 3.5;
/// Two poses whose rotations differ by less are one (rad).
const SAME: f64 = 0.03;
/// A second pose is kept when its support is at least this share of the first one's.
const RIVAL: f64 = 0.9;
/// So many more edges on faces seen nearly edge-on decide between two poses.
const TELLING: usize = 3;
/// A pass that moved the edges by less is the last one (px).
const SETTLED: f64 = 0.04;
/// Least cosine between the sight and a face's normal.
const LEAST_FACING: f64 = 0.22;
/// A face that looks so much at the camera is seen whole unless something hides it ...
const SEEN: f64 = 0.3;
/// ... and has then so many crossings that fit; one that is a tile off has 18.
const WHOLE: usize = 20;
/// A pose that is right has so many times the support of one a tile off; where the cube is mostly
/// hidden, nothing tells them apart, and the first one stands.
const BETTER: f64 = 1.4;

/// Localises the cube from the faces found in an image, refined on the image's edges; as [`locate_cube`] otherwise.
/// The covariance then knows of noise and of the model's imperfections, not of errors of calibration.
#[must_use]
pub fn locate_in(
    image: &RgbImage,
    faces: &[FaceSighting],
    camera: impl Into<Lens>,
    edge: f64,
    hint: Option<&Pose>,
) -> Option<CubeLocation> {
    let lens = &camera.into();
    let coarse = locate_cube(faces, lens, edge, hint)?;
    let share = coarse.faces.first().map_or(0.85, |f| f.sticker.clamp(0.6, 0.97));
    let apart = |a: &Pose, b: &Pose| a.rotation.angle_to(&b.rotation) > SAME;
    let mut poses: Vec<Fitted> =
        fit(image, lens, edge, &coarse.camera_from_cube, share).into_iter().collect();
    // Two starts that are nearly one end in one.
    if let Some(start) = coarse.other.filter(|o| apart(o, &coarse.camera_from_cube)) {
        poses.extend(fit(image, lens, edge, &start, share));
    }
    // One face leaves two poses; where both starts ended in one of them, the other is its mirror image.
    if let [fitted, rest @ ..] = poses.as_slice()
        && fitted.faces.len() == 1
        && rest.iter().all(|r| !apart(&r.pose, &fitted.pose))
    {
        let start = mirrored(&fitted.pose, &fitted.faces[0].0);
        if apart(&start, &fitted.pose) {
            poses.extend(fit(image, lens, edge, &start, share));
        }
    }
    let mut poses: Vec<(usize, Fitted)> =
        poses.into_iter().map(|p| (sides(image, lens, edge, &p.pose, share), p)).collect();
    // Faces seen edge-on say which way the cube leans; where there are none, how well the edges fit.
    let (most, fewest) = (
        poses.iter().map(|p| p.0).max().unwrap_or(0),
        poses.iter().map(|p| p.0).min().unwrap_or(0),
    );
    let told = most >= fewest + TELLING;
    if told {
        poses.retain(|p| p.0 + TELLING > most);
    }
    poses.sort_by(|a, b| b.1.support.total_cmp(&a.1.support));
    let mut poses = poses.into_iter().map(|p| p.1);
    let Some(fitted) = poses.next() else { return Some(coarse) };
    let fitted = best_of_lattice(image, lens, edge, fitted, share);
    // Only a pose that the edges bear out as well, or nearly so, remains a second one.
    let other = poses
        .filter(|r| r.support > RIVAL * fitted.support)
        .map(|r| r.pose)
        .find(|r| apart(r, &fitted.pose));
    let mut location = fitted.location(other);
    // Faces that were detected keep the axes of their reading order.
    for (index, used) in location.used.iter_mut().enumerate() {
        let near = |p: &Pose| (p.translation.vector - used.translation.vector).norm() < 0.1 * edge;
        if let Some(known) = coarse.used.iter().position(near) {
            *used = coarse.used[known];
            location.faces.push(coarse.faces[known].clone());
            location.sightings.push(index);
        }
    }
    Some(location)
}

/// Refines a pose that is known to about a seventh of a tile, as from a track, without any detection; `None` when the
/// edges do not bear it out.
#[must_use]
pub fn refine_in(
    image: &RgbImage,
    camera: impl Into<Lens>,
    edge: f64,
    camera_from_cube: &Pose,
) -> Option<CubeLocation> {
    let lens = &camera.into();
    let fitted = fit(image, lens, edge, camera_from_cube, SHARE)?;
    let fitted = best_of_lattice(image, lens, edge, fitted, SHARE);
    let crossings: usize = fitted.faces.iter().map(|(_, n)| n).sum();
    (crossings >= TRACKED * fitted.faces.len()).then(|| fitted.location(None))
}

/// Returns the best of a fit and those that are whole tiles off.
fn best_of_lattice(
    image: &RgbImage,
    lens: &Lens,
    edge: f64,
    mut best: Fitted,
    share: f64,
) -> Fitted {
    while best.may_be_off(edge) {
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
        let off = axes.into_iter().flat_map(|axis| [axis, -axis]).filter_map(|axis| {
            let start = best.pose * Translation3::from(axis * (edge / 3.0));
            fit(image, lens, edge, &start, share)
        });
        match off.max_by(|a, b| a.support.total_cmp(&b.support)) {
            Some(other) if other.support > BETTER * best.support => best = other,
            _ => break,
        }
    }
    best
}

/// Returns the faces of a cube, as `cube_from_face`.
fn faces(edge: f64) -> impl Iterator<Item = Pose> {
    cube_rotations().step_by(4).map(move |r| cube_from_face(&r.to_rotation_matrix(), edge))
}

/// The other pose that fits one face nearly as well: its tilt against the sight turned round.
fn mirrored(camera_from_cube: &Pose, cube_from_face: &Pose) -> Pose {
    let face = camera_from_cube * cube_from_face;
    let (centre, normal) = (face.translation.vector, face.rotation * Vector3::z());
    let sight = centre.normalize();
    let other = sight * (2.0 * normal.dot(&sight)) - normal;
    let turn =
        UnitQuaternion::rotation_between(&normal, &other).unwrap_or_else(UnitQuaternion::identity);
    Pose::from_parts(
        Translation3::from(centre + turn * (camera_from_cube.translation.vector - centre)),
        turn * camera_from_cube.rotation,
    )
}

/// How many edges between tiles are where a pose has them on the faces beside the one that looks at the camera most, even
/// if these are a few pixels deep only.
fn sides(image: &RgbImage, lens: &Lens, edge: f64, camera_from_cube: &Pose, share: f64) -> usize {
    let probe = Probe::new(image, lens, edge / 3.0).grazing();
    let mut faces: Vec<Pose> =
        faces(edge).map(|face| camera_from_cube * face).filter(|face| facing(face) > 0.0).collect();
    faces.sort_by(|a, b| facing(b).total_cmp(&facing(a)));
    let mut crossings = Vec::new();
    for (face, camera_from_face) in faces.iter().enumerate().skip(1) {
        let prediction = Prediction { face, camera_from_face, share, tolerance: PASSES[1] };
        probe.measure(&prediction, None, &mut crossings);
    }
    crossings.iter().filter(|c| !matches!(c.kind, Kind::Gap | Kind::Outer)).count()
}

/// A pose with what bears it out.
struct Fitted {
    pose: Pose,
    covariance: Matrix6<f64>,
    residual_px: f64,
    /// Faces that take part, by the number of fitting crossings.
    faces: Vec<(Pose, usize)>,
    /// Sum over crossings of how well they fit.
    support: f64,
}

impl Fitted {
    /// Whether a face that must be seen is not seen whole: hidden, or the pose is a tile off.
    fn may_be_off(&self, edge: f64) -> bool {
        let crossings =
            |face: &Pose| self.faces.iter().find(|(f, _)| f == face).map_or(0, |(_, n)| *n);
        faces(edge).any(|face| facing(&(self.pose * face)) > SEEN && crossings(&face) < WHOLE)
    }

    fn location(self, other: Option<Pose>) -> CubeLocation {
        // The dominant face looks most towards the camera.
        let mut used: Vec<Pose> = self.faces.iter().map(|(face, _)| *face).collect();
        used.sort_by(|a, b| facing(&(self.pose * b)).total_cmp(&facing(&(self.pose * a))));
        let alone = used.len() == 1;
        CubeLocation {
            camera_from_cube: self.pose,
            covariance: self.covariance,
            residual_px: self.residual_px,
            faces: Vec::new(),
            other: other.filter(|_| alone),
            used,
            sightings: Vec::new(),
        }
    }
}

/// Cosine between the sight and a face's inward normal.
fn facing(camera_from_face: &Pose) -> f64 {
    let sight = camera_from_face.translation.vector;
    (camera_from_face.rotation * Vector3::z()).dot(&sight) / sight.norm()
}

/// Unknowns: six of the pose, the stickers' share, bloom and outer bloom.
type Unknowns = SVector<f64, 9>;

fn fit(image: &RgbImage, lens: &Lens, edge: f64, start: &Pose, share: f64) -> Option<Fitted> {
    let probe = Probe::new(image, lens, edge / 3.0);
    let all: Vec<Pose> = faces(edge).collect();
    let mut model = Model {
        lens,
        pitch: edge / 3.0,
        faces: &all,
        pose: *start,
        stickers: Stickers { share, bloom: 0.0, outer: 0.0 },
    };
    let mut crossings: Vec<Crossing> = Vec::new();
    let mut last: Option<Solved> = None;
    for tolerance in PASSES {
        crossings.clear();
        let mut visible: Vec<(usize, Pose, f64)> = all
            .iter()
            .enumerate()
            .map(|(i, face)| (i, model.pose * face, facing(&(model.pose * face))))
            .filter(|(_, _, facing)| *facing > LEAST_FACING)
            .collect();
        visible.sort_by(|a, b| b.2.total_cmp(&a.2));
        let mut body = None;
        for (face, camera_from_face, _) in &visible {
            let share = model.stickers.share;
            let prediction = Prediction { face: *face, camera_from_face, share, tolerance };
            body = probe.measure(&prediction, body, &mut crossings);
        }
        let mut solved = model.solve(&crossings, share)?;
        // A face that only happens to have some edges about must not pull at the others.
        let counts = counts(&crossings, &solved);
        let known = crossings.len();
        crossings.retain(|c| counts[c.face] >= LEAST_CROSSINGS);
        if crossings.len() < known {
            solved = model.solve(&crossings, share)?;
        }
        let step = solved.step;
        model.pose = moved(&model.pose, std::array::from_fn(|k| step[k]));
        model.stickers.share = (model.stickers.share + step[6]).clamp(0.5, 1.0);
        model.stickers.bloom += step[7];
        model.stickers.outer += step[8];
        let settled = last.is_some() && solved.shift < SETTLED;
        last = Some(solved);
        if settled {
            break;
        }
    }
    let solved = last?;
    let faces: Vec<(Pose, usize)> = all
        .iter()
        .zip(counts(&crossings, &solved))
        .filter(|(_, n)| *n >= LEAST_CROSSINGS)
        .map(|(face, n)| (*face, n))
        .collect();
    if faces.is_empty() {
        return None;
    }
    let support = solved.residuals.iter().map(|r| (1.0 - (r / FITS).powi(2)).max(0.0)).sum::<f64>();
    let squares: Vec<f64> = crossings
        .iter()
        .zip(&solved.residuals)
        .filter(|(c, r)| c.kind != Kind::Gap && r.abs() < FITS * solved.spread)
        .map(|(c, r)| (r * deviation(c)).powi(2))
        .collect();
    let residual_px = (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt();
    Some(Fitted { pose: model.pose, covariance: solved.covariance, residual_px, faces, support })
}

/// Crossings of each face that fit.
fn counts(crossings: &[Crossing], solved: &Solved) -> [usize; 6] {
    let mut counts = [0; 6];
    for (crossing, r) in crossings.iter().zip(&solved.residuals) {
        let fits = crossing.kind != Kind::Gap && r.abs() < FITS * solved.spread;
        counts[crossing.face] += usize::from(fits);
    }
    counts
}

/// Standard deviation of a crossing: noise and what the model leaves unsaid (px).
fn deviation(crossing: &Crossing) -> f64 {
    let floor = match crossing.kind {
        Kind::Middle => FLOOR_MIDDLE,
        // A gap that is as narrow as the blur looks wider than it is.
        Kind::Gap => FLOOR_GAP + 0.6 * (3.5 - crossing.measured).max(0.0),
        Kind::First | Kind::Second | Kind::Outer => FLOOR_EDGE,
    };
    (crossing.sigma.powi(2) + floor.powi(2) + (FLOOR_SHARE * crossing.scale).powi(2)).sqrt()
}

/// The cube as it is believed to be.
struct Model<'a> {
    lens: &'a Lens,
    pitch: f64,
    faces: &'a [Pose],
    pose: Pose,
    stickers: Stickers,
}

/// A robust step of Gauss and Newton.
struct Solved {
    step: Unknowns,
    /// What is left of each crossing, over its standard deviation.
    residuals: Vec<f64>,
    /// By how much these exceed what was expected, at least 1.
    spread: f64,
    covariance: Matrix6<f64>,
    /// Root mean square of what the step moves (px).
    shift: f64,
}

impl Model<'_> {
    fn predict(&self, crossings: &[Crossing], step: &Unknowns) -> Vec<f64> {
        let pose = moved(&self.pose, std::array::from_fn(|k| step[k]));
        let stickers = Stickers {
            share: self.stickers.share + step[6],
            bloom: self.stickers.bloom + step[7],
            outer: self.stickers.outer + step[8],
        };
        let faces: Vec<Pose> = self.faces.iter().map(|face| pose * face).collect();
        let predicted = |c: &Crossing| c.predicted(self.lens, &faces[c.face], self.pitch, stickers);
        crossings.iter().map(predicted).collect()
    }

    /// The model is linear over the small steps that are left; each pass measures anew anyway.
    fn solve(&self, crossings: &[Crossing], share: f64) -> Option<Solved> {
        if crossings.len() < LEAST_CROSSINGS + 3 {
            return None;
        }
        let deviations: Vec<f64> = crossings.iter().map(deviation).collect();
        let here = self.predict(crossings, &Unknowns::zeros());
        let error: Vec<f64> = crossings
            .iter()
            .zip(&here)
            .zip(&deviations)
            .map(|((c, p), d)| (c.measured - p) / d)
            .collect();
        let mut rows = vec![Unknowns::zeros(); crossings.len()];
        for k in 0..9 {
            let mut step = Unknowns::zeros();
            step[k] = if k < 6 { 1e-6 } else { 1e-4 };
            for (i, ahead) in self.predict(crossings, &step).iter().enumerate() {
                rows[i][k] = (ahead - here[i]) / (step[k] * deviations[i]);
            }
        }
        let mut residuals = error.clone();
        let mut spread = spread_of(&residuals);
        let mut solution = None;
        for _ in 0..4 {
            // Weak beliefs, so that nothing is left open when all gaps are too narrow to be measured.
            let mut normal = SMatrix::<f64, 9, 9>::zeros();
            let mut right = Unknowns::zeros();
            let now = &self.stickers;
            for (k, belief, width) in
                [(6, share - now.share, 0.15), (7, -now.bloom, BLOOM), (8, -now.outer, OUTER)]
            {
                normal[(k, k)] = (spread / width).powi(2);
                right[k] = belief * (spread / width).powi(2);
            }
            for ((row, e), r) in rows.iter().zip(&error).zip(&residuals) {
                // Cauchy's weights, with a scale that follows the residuals' own.
                let weight = 1.0 / (1.0 + (r / (2.4 * spread)).powi(2));
                normal.syger(weight, row, row, 1.0);
                right += row * (weight * e);
            }
            normal.fill_upper_triangle_with_lower_triangle();
            let factor = normal.cholesky()?;
            let step = factor.solve(&right);
            for ((row, e), r) in rows.iter().zip(&error).zip(&mut residuals) {
                *r = e - row.dot(&step);
            }
            spread = spread_of(&residuals);
            solution = Some((step, factor.inverse()));
        }
        let (step, inverse) = solution?;
        let covariance = inverse.fixed_view::<6, 6>(0, 0).into_owned() * spread.powi(2);
        let moved: f64 =
            rows.iter().zip(&deviations).map(|(row, d)| (row.dot(&step) * d).powi(2)).sum();
        let shift = (moved / rows.len() as f64).sqrt();
        Some(Solved { step, residuals, spread, covariance, shift })
    }
}

/// Robust standard deviation of normalised residuals, at least 1.
fn spread_of(residuals: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
    let middle = sizes.len() / 2;
    if sizes.is_empty() {
        return 1.0;
    }
    let (_, median, _) = sizes.select_nth_unstable_by(middle, f64::total_cmp);
    (1.4826 * *median).max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::Intrinsics;
    use crate::pose::nearest_of_24;
    use crate::testing::Drawing;
    use crate::{DetectorSettings, detect};
    use nalgebra::Vector6;

    const CAMERA: Intrinsics = Intrinsics {
        width: 400,
        height: 300,
        focal: (600.0, 600.0),
        centre: (199.5, 149.5),
        distortion: (-0.1, 0.02),
    };
    const EDGE: f64 = 0.057;

    /// A cube with random colours, all of its faces.
    fn drawing(camera_from_cube: &Pose, seed: u64) -> Drawing {
        let faces = cube_rotations().step_by(4).enumerate().map(|(i, rotation)| {
            let face = camera_from_cube * cube_from_face(&rotation.to_rotation_matrix(), EDGE);
            let colour = |k: u64| ((seed * 31 + i as u64 * 7 + k * (3 + seed % 5)) % 6) as u8;
            (face, std::array::from_fn(|k| colour(k as u64)))
        });
        let mut drawing = Drawing::new(CAMERA, faces.collect());
        (drawing.noise, drawing.seed) = (6.0, seed);
        drawing
    }

    fn pose(tilt: (f64, f64), roll: f64) -> Pose {
        let lean = UnitQuaternion::from_scaled_axis(Vector3::new(tilt.0, tilt.1, 0.0));
        let roll = UnitQuaternion::from_scaled_axis(Vector3::z() * roll);
        Pose::from_parts(Translation3::new(0.012, -0.008, 0.37), lean * roll)
    }

    /// Error of the centre and of the rotation, in the camera's axes.
    fn error(found: &Pose, truth: &Pose) -> Vector6<f64> {
        let relative = found.rotation.inverse() * truth.rotation;
        let turn = found.rotation * nearest_of_24(&relative) * truth.rotation.inverse();
        let (shift, turn) =
            (found.translation.vector - truth.translation.vector, turn.scaled_axis());
        Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
    }

    #[test]
    fn the_cubes_centre_is_right_to_a_fifth_of_a_millimetre_and_the_covariance_tells_it() {
        let mut nees = Vec::new();
        for seed in 0..12 {
            let angle = 0.5 * seed as f64;
            let truth = pose((0.45 * angle.cos(), 0.45 * angle.sin()), 0.3 * angle);
            let image = drawing(&truth, seed).render();
            let faces = detect(&image, None, &DetectorSettings::default()).unwrap();

            let found = locate_in(&image, &faces, &CAMERA, EDGE, None).unwrap();

            assert!(found.used.len() > 1, "seed {seed}: {} faces", found.used.len());
            let error = error(&found.camera_from_cube, &truth);
            assert!(error.xy().norm() < 0.2e-3, "seed {seed}: {error}");
            assert!(error.z.abs() < 1e-3, "seed {seed}: {error}");
            nees.push(error.dot(&found.covariance.cholesky().unwrap().solve(&error)));
        }
        let mean = nees.iter().sum::<f64>() / nees.len() as f64;
        assert!((0.5..12.0).contains(&mean), "{nees:?}");
    }

    #[test]
    fn a_face_that_the_detector_missed_takes_part() {
        let truth = pose((0.5, 0.2), 0.1);
        let image = drawing(&truth, 3).render();
        let mut faces = detect(&image, None, &DetectorSettings::default()).unwrap();
        faces.truncate(1);

        let found = locate_in(&image, &faces, &CAMERA, EDGE, None).unwrap();

        assert!(found.used.len() > 1 && found.faces.len() == 1);
        assert!(found.sighting(0).is_some() && found.sighting(1).is_none());
        assert!(error(&found.camera_from_cube, &truth).xy().norm() < 0.2e-3);
    }

    #[test]
    fn a_predicted_pose_is_followed_without_detection_and_a_wrong_one_is_refused() {
        let truth = pose((0.3, -0.35), 0.7);
        let image = drawing(&truth, 5).render();
        let near = moved(&truth, [1.2e-3, -1.0e-3, 3e-3, 0.02, -0.02, 0.02]);
        let far = moved(&truth, [9e-3, 4e-3, 0.0, 0.1, 0.0, 0.3]);

        let found = refine_in(&image, &CAMERA, EDGE, &near).unwrap();

        assert!(error(&found.camera_from_cube, &truth).xy().norm() < 0.2e-3);
        assert_eq!(refine_in(&image, &CAMERA, EDGE, &far), None);
    }

    #[test]
    fn a_pose_one_tile_off_is_put_right() {
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
        for (seed, tilt) in [(5, (0.5, 0.45)), (6, (0.3, 0.6)), (7, (0.6, 0.2)), (9, (0.45, 0.1))] {
            let truth = pose(tilt, 0.1);
            let image = drawing(&truth, seed).render();
            for axis in axes.into_iter().flat_map(|axis| [axis, -axis]) {
                let start = truth * Translation3::from(axis * (EDGE / 3.0));

                let found = refine_in(&image, &CAMERA, EDGE, &start).unwrap();

                let error = error(&found.camera_from_cube, &truth);
                assert!(error.xyz().norm() < 1e-3, "seed {seed}, {axis}: {error}");
            }
        }
    }

    #[test]
    fn no_picture_is_too_small() {
        for (width, height) in [(0, 0), (1, 1), (1, 300), (5, 5)] {
            let image = RgbImage::new(width, height);
            assert_eq!(refine_in(&image, &CAMERA, EDGE, &pose((0.3, 0.0), 0.0)), None);
        }
    }
}
