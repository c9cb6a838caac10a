//! Refinement of the cube's pose on the sub-pixel edges of all tiles of all visible faces.
//!
//! The model is a cube with nine square stickers on each face. The size of the stickers is not
//! known: their share of the pitch, and the width that blur adds to them, are estimated along with
//! the pose. A measured edge is called a crossing. A face that the detector missed takes part as
//! soon as its edges are where the pose predicts them. This also decides between the two poses that
//! fit a single face.
//!
//! Tiles repeat. A pose that is one tile off along an edge of the cube predicts two thirds of its
//! tile edges where other tiles have edges, and is a local optimum. If a face that must be visible
//! is not seen whole, the fit is compared with those one tile off.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | face takes part | [`LEAST_CROSSINGS`] | fewer edges may agree by chance |
//! | pose accepted without a detection | [`TRACKED`] crossings a face | a whole face has 24 |
//! | crossing fits | [`FITS`] deviations | all others are outliers |
//! | two poses are one | [`SAME`] rad | two starts may end in one optimum |
//! | second pose kept | [`RIVAL`] of the first one's support | the edges do not decide |
//! | edge-on faces decide | [`TELLING`] more edges | they show which way the cube leans |
//! | pass is the last one | [`SETTLED`] px | another pass would move less than the noise |
//! | face is measured | facing [`LEAST_FACING`] | a more oblique one is only a few pixels deep |
//! | face must be seen whole | facing [`SEEN`], [`WHOLE`] | a pose one tile off has 18 of 24 |
//! | pose one tile off is right | [`BETTER`] times the support | a hidden cube decides nothing |
//!
//! - in: an image, [`Lens`], the cube's edge (m), first poses from centroids
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

/// Standard deviation of the model's errors for a middle between two tiles (px). Causes are uneven
/// stickers, shade, interpolation and the mosaic of the sensor.
const FLOOR_MIDDLE: f64 = 0.05;
/// Standard deviation of the model's errors for a single edge (px).
const FLOOR_EDGE: f64 = 0.10;
/// Standard deviation of the model's errors for the width of a gap (px).
const FLOOR_GAP: f64 = 0.25;
/// Standard deviation of the model's errors that grow with the size of the face, in pitches.
const FLOOR_SHARE: f64 = 0.002;
/// Expected standard deviation of [`Stickers::bloom`], by which blur moves all edges (px).
const BLOOM: f64 = 0.4;
/// Expected standard deviation of [`Stickers::outer`], by which outer edges move farther (px).
const OUTER: f64 = 0.1;
/// Greatest distance of an edge from its prediction in each of the passes, in pitches.
const PASSES: [f64; 3] = [0.16, 0.09, 0.06];
/// Fewest fitting crossings of a face that takes part.
const LEAST_CROSSINGS: usize = 9;
/// Side of a sticker as a share of the pitch, assumed before any sticker is measured.
const SHARE: f64 = 0.86;
/// Fewest fitting crossings per face at which a pose is accepted without a detection. A whole face
/// has 24.
const TRACKED: usize = 13;
/// Greatest residual of a crossing that fits, in standard deviations.
const FITS: f64 = 3.5;
/// Angle between two poses below which they count as one (rad).
const SAME: f64 = 0.03;
/// Least support of a second pose that is kept, as a share of the first one's.
const RIVAL: f64 = 0.9;
/// Difference in the number of edges on nearly edge-on faces that decides between two poses.
const TELLING: usize = 3;
/// Movement of the edges below which a pass is the last one (px).
const SETTLED: f64 = 0.04;
/// Least cosine between the line of sight and the normal of a face that is measured.
const LEAST_FACING: f64 = 0.22;
/// Least cosine between the line of sight and the normal of a face that is seen whole unless
/// something hides it.
const SEEN: f64 = 0.3;
/// Fewest fitting crossings of a face that is seen whole. A pose one tile off has 18.
const WHOLE: usize = 20;
/// Factor by which the support of a pose one tile off must exceed that of the first pose, so that
/// the first one is wrong. If the cube is mostly hidden, no pose does, and the first one is kept.
const BETTER: f64 = 1.4;

/// Computes the pose of the cube from the faces found in an image and refines it by the edges of
/// the tiles in the image. Returns `None` if no pose can be computed from the faces.
///
/// The arguments are those of [`locate_cube`]. The covariance contains the noise and the errors of
/// the model, but not the errors of the calibration.
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
    // The second pose that fits a single face is a second start, unless it is nearly the same.
    if let Some(start) = coarse.other.filter(|o| apart(o, &coarse.camera_from_cube)) {
        poses.extend(fit(image, lens, edge, &start, share));
    }
    // Two poses fit a single face. If both starts ended in the same one, the other pose, its mirror
    // image, becomes a start as well, since it may be the right one.
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
    // The edges of one nearly frontal face fit both poses almost equally well. The faces that are
    // seen edge-on show which way the cube leans, so they decide first. Then the quality of the fit
    // decides.
    let (most, fewest) = (
        poses.iter().map(|p| p.0).max().unwrap_or(0),
        poses.iter().map(|p| p.0).min().unwrap_or(0),
    );
    let decided = most >= fewest + TELLING;
    if decided {
        poses.retain(|p| p.0 + TELLING > most);
    }
    poses.sort_by(|a, b| b.1.support.total_cmp(&a.1.support));
    let mut poses = poses.into_iter().map(|p| p.1);
    let Some(fitted) = poses.next() else { return Some(coarse) };
    let fitted = best_of_lattice(image, lens, edge, fitted, share);
    // The second pose remains only if the edges support it nearly as well as the first.
    let other = poses
        .filter(|r| r.support > RIVAL * fitted.support)
        .map(|r| r.pose)
        .find(|r| apart(r, &fitted.pose));
    let mut location = fitted.location(other);
    // The fit chooses the axes of the faces itself. A detected face keeps those of its reading
    // order, to which its colours refer.
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

/// Refines the pose `camera_from_cube` by the edges of the tiles in an image, without any
/// detection. The pose must be right to about a seventh of a tile, as the prediction of a track is.
/// `edge` is the edge of the cube (m). Returns `None` if the edges do not support the pose.
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

/// Compares a fit that may be one tile off with fits one tile away along the edges of the cube, and
/// returns the best. Repeats this if the best one may be one tile off as well. `share` is the first
/// guess of a sticker's side as a share of the pitch.
fn best_of_lattice(
    image: &RgbImage,
    lens: &Lens,
    edge: f64,
    mut best: Fitted,
    share: f64,
) -> Fitted {
    // The six further fits take six times the time, so they are made only if the pose is in doubt.
    // Without them a hand once closed 19 mm before the cube, since a tracked pose was one tile off.
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

/// Returns the poses of the six faces in the cube's frame, as `cube_from_face`.
fn faces(edge: f64) -> impl Iterator<Item = Pose> {
    // The first of four rotations is taken for each face, since they differ only about its normal.
    cube_rotations().step_by(4).map(move |r| cube_from_face(&r.to_rotation_matrix(), edge))
}

/// Returns the second pose of the cube at which one of its faces, `cube_from_face`, looks nearly
/// the same: its tilt against the line of sight is reversed.
fn mirrored(camera_from_cube: &Pose, cube_from_face: &Pose) -> Pose {
    let face = camera_from_cube * cube_from_face;
    let (centre, normal) = (face.translation.vector, face.rotation * Vector3::z());
    let sight = centre.normalize();
    // The normal is reflected in the line of sight, and the whole cube turns with it about the
    // centre of the face.
    let other = sight * (2.0 * normal.dot(&sight)) - normal;
    let turn =
        UnitQuaternion::rotation_between(&normal, &other).unwrap_or_else(UnitQuaternion::identity);
    Pose::from_parts(
        Translation3::from(centre + turn * (camera_from_cube.translation.vector - centre)),
        turn * camera_from_cube.rotation,
    )
}

/// Counts the edges between tiles that are where the pose `camera_from_cube` predicts them, on all
/// visible faces except the most frontal one. Faces that are only a few pixels deep count as well.
/// `share` is a sticker's side as a share of the pitch.
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

/// Fitted pose with the evidence for it.
struct Fitted {
    /// Pose as `camera_from_cube`.
    pose: Pose,
    /// Covariance of the error of the pose in the axes of the camera: translation (m), then
    /// rotation (rad).
    covariance: Matrix6<f64>,
    /// Root mean square of the residuals (px).
    residual_px: f64,
    /// Faces that take part (`cube_from_face`), each with its number of crossings that fit.
    faces: Vec<(Pose, usize)>,
    /// Evidence for the pose: sum of the quality of fit of all crossings, 0..=1 each.
    support: f64,
}

impl Fitted {
    /// Returns whether the pose may be one tile off: a face that must be visible is not seen whole.
    /// Something that hides the face may also be the reason.
    fn may_be_off(&self, edge: f64) -> bool {
        let crossings =
            |face: &Pose| self.faces.iter().find(|(f, _)| f == face).map_or(0, |(_, n)| *n);
        faces(edge).any(|face| facing(&(self.pose * face)) > SEEN && crossings(&face) < WHOLE)
    }

    /// Converts the fit to a location without detected faces. `other` is the second pose that fits,
    /// which is kept only if a single face was used.
    fn location(self, other: Option<Pose>) -> CubeLocation {
        // The dominant face is the most frontal one.
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

/// Returns the cosine between the line of sight and a face's inward normal: 1 if the face is
/// frontal, 0 if it is edge-on, negative if it is turned away.
fn facing(camera_from_face: &Pose) -> f64 {
    let sight = camera_from_face.translation.vector;
    (camera_from_face.rotation * Vector3::z()).dot(&sight) / sight.norm()
}

/// Unknowns of a fit: six of the pose, then share, bloom and outer bloom of the stickers.
type Unknowns = SVector<f64, 9>;

/// Fits the pose of the cube and the size of its stickers to the edges of all visible faces.
/// `start` is the first `camera_from_cube`, and `share` the first guess of a sticker's side as a
/// share of the pitch. Returns `None` if too few edges fit.
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
    // Each pass measures again at the improved pose and within a narrower tolerance. The edge of a
    // neighbouring tile, which the first tolerance may let in, is thus left out later.
    for tolerance in PASSES {
        crossings.clear();
        let mut visible: Vec<(usize, Pose, f64)> = all
            .iter()
            .enumerate()
            .map(|(i, face)| (i, model.pose * face, facing(&(model.pose * face))))
            .filter(|(_, _, facing)| *facing > LEAST_FACING)
            .collect();
        // The most frontal face comes first: its gaps are the widest and show the colour of the
        // body, which the gaps of oblique faces may not.
        visible.sort_by(|a, b| b.2.total_cmp(&a.2));
        let mut body = None;
        for (face, camera_from_face, _) in &visible {
            let share = model.stickers.share;
            let prediction = Prediction { face: *face, camera_from_face, share, tolerance };
            body = probe.measure(&prediction, body, &mut crossings);
        }
        let mut solved = model.solve(&crossings, share)?;
        // Near the edges of a hidden face there may be others by chance. They must not pull the
        // pose, so the step is computed again without such faces.
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
        // The first pass is never the last one: its wide tolerance may have let wrong edges in.
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
    // Each crossing adds from 1, if it is exact, down to 0 at the limit of fitting. The sum counts
    // evidence, while a mean residual would prefer a pose with few edges.
    let support = solved.residuals.iter().map(|r| (1.0 - (r / FITS).powi(2)).max(0.0)).sum::<f64>();
    let residual_px = residual_px(&crossings, &solved);
    Some(Fitted { pose: model.pose, covariance: solved.covariance, residual_px, faces, support })
}

/// Returns the root mean square of the residuals of all crossings that fit (px). Widths of gaps do
/// not count, since they hardly depend on the pose.
fn residual_px(crossings: &[Crossing], solved: &Solved) -> f64 {
    let squares: Vec<f64> = crossings
        .iter()
        .zip(&solved.residuals)
        .filter(|(c, r)| c.kind != Kind::Gap && r.abs() < FITS * solved.spread)
        .map(|(c, r)| (r * deviation(c)).powi(2))
        .collect();
    (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
}

/// Counts the crossings that fit on each of the six faces. Widths of gaps do not count, since they
/// hardly depend on the pose.
fn counts(crossings: &[Crossing], solved: &Solved) -> [usize; 6] {
    let mut counts = [0; 6];
    for (crossing, r) in crossings.iter().zip(&solved.residuals) {
        let fits = crossing.kind != Kind::Gap && r.abs() < FITS * solved.spread;
        counts[crossing.face] += usize::from(fits);
    }
    counts
}

/// Computes the standard deviation of a crossing (px) from noise and errors of the model.
fn deviation(crossing: &Crossing) -> f64 {
    let floor = match crossing.kind {
        Kind::Middle => FLOOR_MIDDLE,
        // A gap that is as narrow as the blur looks wider than it is.
        Kind::Gap => FLOOR_GAP + 0.6 * (3.5 - crossing.measured).max(0.0),
        Kind::First | Kind::Second | Kind::Outer => FLOOR_EDGE,
    };
    (crossing.sigma.powi(2) + floor.powi(2) + (FLOOR_SHARE * crossing.scale).powi(2)).sqrt()
}

/// Model of the cube with its present pose and stickers.
struct Model<'a> {
    lens: &'a Lens,
    /// Distance of two tile centres (m).
    pitch: f64,
    /// Faces as `cube_from_face`.
    faces: &'a [Pose],
    /// Pose as `camera_from_cube`.
    pose: Pose,
    stickers: Stickers,
}

/// Result of a robust Gauss-Newton step.
struct Solved {
    /// Change of the unknowns.
    step: Unknowns,
    /// Residual of each crossing after the step, divided by its standard deviation.
    residuals: Vec<f64>,
    /// Robust standard deviation of these residuals, at least 1.
    spread: f64,
    /// Covariance of the error of the pose: translation (m), then rotation (rad).
    covariance: Matrix6<f64>,
    /// Root mean square of the movement of the edges by the step (px).
    shift: f64,
}

impl Model<'_> {
    /// Predicts the measured values of crossings (px) if the unknowns change by `step`.
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

    /// Computes a robust Gauss-Newton step of the unknowns from measured crossings. `share` is the
    /// expected side of a sticker as a share of the pitch. Returns `None` if there are too few
    /// crossings.
    ///
    /// One linearisation suffices, since the model is almost linear over such small steps and each
    /// pass measures again.
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
        // Numerical derivatives: 1e-6 m or rad of the pose, 1e-4 of the share or px of the blooms.
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
            // Weak prior beliefs about the stickers keep the equations solvable if all gaps are too
            // narrow to be measured. Their weight is multiplied by the square of `spread`, since
            // the residuals are divided by deviations that are `spread` times too small.
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
                // The weights are Cauchy's, scaled by the spread of the residuals.
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

/// Computes the robust standard deviation of normalised residuals, or 1 if it is smaller.
fn spread_of(residuals: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
    // The median of the sizes of normal errors is 1 / 1.4826 of their standard deviation.
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
    /// Edge of the cube (m).
    const EDGE: f64 = 0.057;

    /// Returns a drawing of all faces of a cube with random colours.
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

    /// Returns the pose of a cube 37 cm in front of the camera, tilted about x and y and rolled
    /// about z (rad).
    fn pose(tilt: (f64, f64), roll: f64) -> Pose {
        let lean = UnitQuaternion::from_scaled_axis(Vector3::new(tilt.0, tilt.1, 0.0));
        let roll = UnitQuaternion::from_scaled_axis(Vector3::z() * roll);
        Pose::from_parts(Translation3::new(0.012, -0.008, 0.37), lean * roll)
    }

    /// Returns the error of the centre (m) and of the rotation (rad), in the camera's axes.
    fn error(found: &Pose, truth: &Pose) -> Vector6<f64> {
        let relative = found.rotation.inverse() * truth.rotation;
        let turn = found.rotation * nearest_of_24(&relative) * truth.rotation.inverse();
        let (shift, turn) =
            (found.translation.vector - truth.translation.vector, turn.scaled_axis());
        Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
    }

    /// The centre is right to 0.2 mm across the line of sight and 1 mm along it. The squared error
    /// normalised by the covariance has the expected value 6. The covariance is cautious, but its
    /// deviations are less than 2.5 times too large.
    #[test]
    fn located_centre_and_covariance_match_truth() {
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
        assert!((1.0..6.0).contains(&mean), "{nees:?}");
    }

    #[test]
    fn refinement_uses_face_missed_by_detector() {
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
    fn refinement_accepts_near_start_and_refuses_far_one() {
        let truth = pose((0.3, -0.35), 0.7);
        let image = drawing(&truth, 5).render();
        let near = moved(&truth, [1.2e-3, -1.0e-3, 3e-3, 0.02, -0.02, 0.02]);
        let far = moved(&truth, [9e-3, 4e-3, 0.0, 0.1, 0.0, 0.3]);

        let found = refine_in(&image, &CAMERA, EDGE, &near).unwrap();

        assert!(error(&found.camera_from_cube, &truth).xy().norm() < 0.2e-3);
        assert_eq!(refine_in(&image, &CAMERA, EDGE, &far), None);
    }

    #[test]
    fn refinement_corrects_start_one_tile_off() {
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
    fn refinement_refuses_tiny_pictures_without_panic() {
        for (width, height) in [(0, 0), (1, 1), (1, 300), (5, 5)] {
            let image = RgbImage::new(width, height);
            assert_eq!(refine_in(&image, &CAMERA, EDGE, &pose((0.3, 0.0), 0.0)), None);
        }
    }
}
