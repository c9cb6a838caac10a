//! Pose of a face, and of the cube, from the centroids of the tiles in a picture.
//!
//! Two poses of a plane explain a picture of it almost equally well. A closed form gives both, and
//! Levenberg-Marquardt refines each of them on the nine centroids. The model predicts the centroid
//! of the *projected* sticker, with lens distortion. The projection of the sticker's centre is
//! another point, 0.1 to 0.25 px off if the face is tilted by 15 to 45 deg.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | second face belongs to the cube | rotation within 0.45 rad | half way to another is 0.79 |
//! | second face belongs to the cube | centre within 0.35 edges | a second cube is one edge away |
//! | two sightings are one face | centres within 0.1 edges | only the larger one is used |
//! | one more face fits | worth 10 px of residual | it is better evidence than a close fit |
//! | hint for a single face | 3 px a radian | it outweighs the residual of a single face |
//!
//! - in: [`FaceSighting`]s, [`Intrinsics`](crate::cell::Intrinsics), the cube's edge (m)
//! - out: [`CubeSighting`] of a face, [`CubeLocation`] of the cube
//! - source: Collins and Bartoli, "Infinitesimal plane-based pose estimation", IJCV 109 (2014)

use super::fit::{minimise, moved};
use super::homography::{self, GRID, Point, polygon};
use super::undistort::Lens;
use super::{CubeSighting, FaceSighting};
use crate::spatial::Pose;
use nalgebra::{
    Matrix2, Matrix3, Matrix6, Point3, Rotation3, SVector, Translation3, UnitQuaternion, Vector3,
};

/// Location of the cube in front of a camera.
#[derive(Debug, Clone, PartialEq)]
pub struct CubeLocation {
    /// Pose of the cube, known up to the 24 rotations of a cube. The origin is in the cube's
    /// centre. The axes are parallel to those of the dominant face, which is the largest in the
    /// picture: x to the next column, y to the next row, z into the cube.
    pub camera_from_cube: Pose,
    /// Covariance of the error of this pose in the axes of the camera: translation (m), then
    /// rotation about the cube's centre (rad). It follows from the residual, so it does not contain
    /// errors of the calibration.
    pub covariance: Matrix6<f64>,
    /// Root mean square of the reprojection error (px).
    pub residual_px: f64,
    /// Detected faces that were used, the dominant one first.
    pub faces: Vec<FaceSighting>,
    /// Second pose of the cube that fits, if only a single face was used.
    pub other: Option<Pose>,
    /// Poses (`cube_from_face`) of all faces that were used, detected or measured by their edges
    /// alone, the dominant one first: origin in the face's centre, x to the next column, y to the
    /// next row, z into the cube.
    pub used: Vec<Pose>,
    /// Index in `used` of each face of `faces`.
    pub sightings: Vec<usize>,
}

impl CubeLocation {
    /// Returns the pose of the dominant face: origin in its centre, x to the next column, y to the
    /// next row, z into the cube.
    #[must_use]
    pub fn camera_from_face(&self) -> Pose {
        self.used.first().map_or(self.camera_from_cube, |face| self.camera_from_cube * face)
    }

    /// Returns the detection of the face `used[index]`, or `None` if the detector missed the face
    /// and only its edges support it.
    #[must_use]
    pub fn sighting(&self, index: usize) -> Option<&FaceSighting> {
        let place = self.sightings.iter().position(|used| *used == index)?;
        self.faces.get(place)
    }
}

/// Computes the pose of a face from the centroids of its tiles. `edge` is the edge of the cube (m).
///
/// Two poses fit a face that is nearly frontal. The better one is `camera_from_face` of the result,
/// the second one is `other`. If no pose can be computed, `residual_px` is infinite.
#[must_use]
pub fn locate(face: &FaceSighting, camera: impl Into<Lens>, edge: f64) -> CubeSighting {
    let camera = &camera.into();
    let mut solutions: Vec<(Pose, f64)> = planar_poses(face, camera, edge)
        .into_iter()
        .map(|start| {
            let fit = refine(&start, |pose, out| residuals(face, pose, camera, edge, out));
            (fit.pose, fit.rms)
        })
        .collect();
    solutions.sort_by(|a, b| a.1.total_cmp(&b.1));
    let best = solutions.first().copied().unwrap_or((Pose::identity(), f64::INFINITY));
    CubeSighting {
        camera_from_face: best.0,
        other: solutions.get(1).copied().unwrap_or(best),
        width_px: face.width_px(),
        residual_px: best.1,
        face: face.clone(),
    }
}

/// Computes the pose of the cube from one to three of its faces in one picture.
///
/// The largest face is the dominant one. Faces that do not fit the same cube are left out. `edge`
/// is the edge of the cube (m). `hint`, a rough `camera_from_cube`, decides between the two poses
/// that fit a single face. Returns `None` without a face, or if no pose can be computed.
#[must_use]
pub fn locate_cube(
    faces: &[FaceSighting],
    camera: impl Into<Lens>,
    edge: f64,
    hint: Option<&Pose>,
) -> Option<CubeLocation> {
    let camera = &camera.into();
    let mut order: Vec<usize> = (0..faces.len()).collect();
    let area = |i: usize| polygon(&faces[i].corners).0;
    // The largest face has the most exact pose, so the other faces are compared with it.
    order.sort_by(|&a, &b| area(b).total_cmp(&area(a)));
    let faces: Vec<FaceSighting> = order.into_iter().map(|i| faces[i].clone()).collect();
    let first = faces.first()?;

    let mut best: Option<(f64, CubeLocation)> = None;
    let dominant = locate(first, camera, edge);
    // The other faces may fit only one of the two poses of the dominant face, so both are starts.
    for start in [dominant.camera_from_face, dominant.other.0] {
        let camera_from_cube = start * Translation3::new(0.0, 0.0, edge / 2.0);
        let (cost, location) = locate_around(&camera_from_cube, &faces, camera, edge, hint);
        match &mut best {
            Some((least, kept)) if *least <= cost => kept.other = Some(location.camera_from_cube),
            Some((least, kept)) => {
                let other = kept.camera_from_cube;
                (*least, *kept) = (cost, location);
                kept.other = Some(other);
            }
            None => best = Some((cost, location)),
        }
    }
    let (_, mut location) = best?;
    // A second face has decided between the two poses.
    if location.faces.len() > 1 {
        location.other = None;
    }
    location.residual_px.is_finite().then_some(location)
}

/// Fits the pose of the cube to the first face and to all other faces that belong to the same cube.
/// The start `camera_from_cube` has the axes of the first face. Returns the location and before it
/// its cost, by which the results of several starts are compared (px).
fn locate_around(
    camera_from_cube: &Pose,
    faces: &[FaceSighting],
    camera: &Lens,
    edge: f64,
    hint: Option<&Pose>,
) -> (f64, CubeLocation) {
    let mut members: Vec<(usize, Pose)> = vec![(0, cube_from_face(&Rotation3::identity(), edge))];
    // At most three faces of a cube are visible. Two more sightings are tried, since some may
    // belong to another cube.
    for (i, face) in faces.iter().enumerate().skip(1).take(4) {
        let place = place_on_cube(camera_from_cube, &locate(face, camera, edge), edge);
        if let Some(pose) = place
            && members
                .iter()
                .all(|(_, m)| (m.translation.vector - pose.translation.vector).norm() > 0.1 * edge)
        {
            members.push((i, pose));
        }
    }
    let fit = refine(camera_from_cube, |pose, out| {
        for (i, cube_from_face) in &members {
            residuals(&faces[*i], &(pose * cube_from_face), camera, edge, out);
        }
    });
    // A further face counts more than a smaller residual, and a hint more than the residual of a
    // single face.
    let mut cost = fit.rms - 10.0 * members.len() as f64;
    if let (Some(hint), 1) = (hint, members.len()) {
        let relative = fit.pose.rotation.inverse() * hint.rotation;
        cost += 3.0 * (nearest_of_24(&relative).inverse() * relative).angle();
    }
    let location = CubeLocation {
        camera_from_cube: fit.pose,
        covariance: fit.covariance,
        residual_px: fit.rms,
        faces: members.iter().map(|(i, _)| faces[*i].clone()).collect(),
        other: None,
        used: members.iter().map(|(_, cube_from_face)| *cube_from_face).collect(),
        sightings: (0..members.len()).collect(),
    };
    (cost, location)
}

/// Finds the face of the cube at `camera_from_cube` that a sighting shows, and returns its pose in
/// the cube's frame (`cube_from_face`). Returns `None` if neither of the sighting's two poses is
/// near a face of this cube.
fn place_on_cube(camera_from_cube: &Pose, seen: &CubeSighting, edge: f64) -> Option<Pose> {
    let nearest = [seen.camera_from_face, seen.other.0]
        .into_iter()
        .filter_map(|pose| {
            let relative = camera_from_cube.rotation.inverse() * pose.rotation;
            let snapped = nearest_of_24(&relative);
            let angle = (snapped.inverse() * relative).angle();
            let cube_from_face = cube_from_face(&snapped.to_rotation_matrix(), edge);
            // The cube's centre is half an edge behind the sighted face.
            let centre = pose * Point3::new(0.0, 0.0, edge / 2.0);
            let apart = (centre - Point3::from(camera_from_cube.translation.vector)).norm() / edge;
            (angle < 0.45 && apart < 0.35).then_some((angle + apart, cube_from_face))
        })
        .min_by(|a, b| a.0.total_cmp(&b.0));
    nearest.map(|(_, pose)| pose)
}

/// Returns the pose in the cube's frame of the face whose axes are those of the cube rotated by
/// `rotation`. `edge` is the edge of the cube (m).
pub(super) fn cube_from_face(rotation: &Rotation3<f64>, edge: f64) -> Pose {
    let z = rotation * Vector3::z();
    Pose::from_parts(
        Translation3::from(-0.5 * edge * z),
        UnitQuaternion::from_rotation_matrix(rotation),
    )
}

/// Returns that one of the 24 rotations of a cube which is nearest to `rotation`.
#[must_use]
pub fn nearest_of_24(rotation: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    // The angle between two rotations falls as the size of the dot product of their quaternions
    // rises. The sign does not matter, because q and -q are the same rotation.
    let mut best = (f64::NEG_INFINITY, UnitQuaternion::identity());
    for quaternion in cube_rotations() {
        let dot = quaternion.coords.dot(&rotation.coords).abs();
        if dot > best.0 {
            best = (dot, quaternion);
        }
    }
    best.1
}

/// Iterates over the 24 rotations of a cube: four about the normal of each of the six faces in
/// turn.
pub fn cube_rotations() -> impl Iterator<Item = UnitQuaternion<f64>> {
    use std::f64::consts::FRAC_PI_2;
    let faces = [
        UnitQuaternion::identity(),
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), FRAC_PI_2),
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -FRAC_PI_2),
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 2.0 * FRAC_PI_2),
        UnitQuaternion::from_axis_angle(&Vector3::y_axis(), FRAC_PI_2),
        UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -FRAC_PI_2),
    ];
    faces.into_iter().flat_map(|tilt| {
        (0..4).map(move |k| {
            tilt * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), f64::from(k) * FRAC_PI_2)
        })
    })
}

/// Computes the two poses that explain the tile centres of a face, in closed form (Collins and
/// Bartoli). Returns them as `camera_from_face`, or none if a pixel has no direction or the centres
/// are degenerate.
#[must_use]
pub fn planar_poses(face: &FaceSighting, camera: &Lens, edge: f64) -> Vec<Pose> {
    let pitch = edge / 3.0;
    let place = |i: usize| (GRID[i].0 * pitch, GRID[i].1 * pitch);
    let pairs: Option<Vec<(Point, Point)>> =
        (0..9).map(|i| Some((place(i), camera.unproject(face.centres[i])?))).collect();
    let Some(pairs) = pairs else { return Vec::new() };
    let Some(h) = homography::fit(&pairs) else { return Vec::new() };
    let h = h / h[(2, 2)];
    // Value `v` and Jacobian of the homography at the face's centre.
    let v = (h[(0, 2)], h[(1, 2)]);
    let jacobian = Matrix2::new(
        h[(0, 0)] - h[(2, 0)] * v.0,
        h[(0, 1)] - h[(2, 1)] * v.0,
        h[(1, 0)] - h[(2, 0)] * v.1,
        h[(1, 1)] - h[(2, 1)] * v.1,
    );
    let sight = Vector3::new(v.0, v.1, 1.0);
    // In axes whose z is the line of sight the equations of Collins and Bartoli take their simple
    // form. `b` is the derivative of the projection in these axes, at unit depth.
    let to_sight = UnitQuaternion::rotation_between(&Vector3::z(), &sight)
        .unwrap_or_else(UnitQuaternion::identity)
        .to_rotation_matrix();
    let r = to_sight.matrix();
    let b = Matrix2::new(
        r[(0, 0)] - v.0 * r[(2, 0)],
        r[(0, 1)] - v.0 * r[(2, 1)],
        r[(1, 0)] - v.1 * r[(2, 0)],
        r[(1, 1)] - v.1 * r[(2, 1)],
    );
    let Some(inverse) = b.try_inverse() else { return Vec::new() };
    // A = B^-1 J is the upper left 2x2 block of the rotation, divided by the depth. The larger
    // singular value of that block is 1, because the axis of the tilt keeps its length. So gamma,
    // the larger singular value of A, is the inverse of the depth.
    let a = inverse * jacobian;
    let ata = a.transpose() * a;
    let half = f64::midpoint(ata[(0, 0)], ata[(1, 1)]);
    let root = (half * half - ata.determinant()).max(0.0).sqrt();
    let gamma = (half + root).sqrt();
    if !(gamma.is_finite() && gamma > 1e-9) {
        return Vec::new();
    }
    // The columns of a rotation have unit length and are orthogonal. This gives the third row of
    // the first two columns up to a common sign, which is the ambiguity of a planar pose.
    let r22 = a / gamma;
    let rest = Matrix2::identity() - r22.transpose() * r22;
    let (b0, b1) = (rest[(0, 0)].max(0.0).sqrt(), rest[(1, 1)].max(0.0).sqrt());
    let b1 = if rest[(0, 1)] < 0.0 { -b1 } else { b1 };
    let translation = sight / gamma;
    [1.0, -1.0]
        .into_iter()
        .map(|sign| {
            let x = Vector3::new(r22[(0, 0)], r22[(1, 0)], sign * b0);
            let y = Vector3::new(r22[(0, 1)], r22[(1, 1)], sign * b1);
            let local = Matrix3::from_columns(&[x, y, x.cross(&y)]);
            // Rounding leaves the columns slightly skew, so the nearest rotation is taken.
            let rotation = to_sight * Rotation3::from_matrix(&local);
            Pose::from_parts(
                Translation3::from(translation),
                UnitQuaternion::from_rotation_matrix(&rotation),
            )
        })
        .collect()
}

/// Appends two residuals (x and y, px) for each seen tile to `out`: its measured centroid minus the
/// one that follows from the pose `camera_from_face`. `edge` is the edge of the cube (m).
pub(super) fn residuals(
    face: &FaceSighting,
    camera_from_face: &Pose,
    camera: &Lens,
    edge: f64,
    out: &mut Vec<f64>,
) {
    let half = 0.5 * face.sticker;
    let pitch = edge / 3.0;
    for (i, g) in GRID.iter().enumerate() {
        if !face.seen[i] {
            continue;
        }
        let corners = [(-half, -half), (half, -half), (half, half), (-half, half)].map(|(x, y)| {
            let p = Point3::new((g.0 + x) * pitch, (g.1 + y) * pitch, 0.0);
            let q = camera_from_face * p;
            // A trial step may put a corner behind the camera.
            camera.project(&Point3::new(q.x, q.y, q.z.max(1e-3)))
        });
        let (area, centroid) = polygon(&corners);
        // A polygon seen edge-on has no area, and its centroid is not finite. Any of its points
        // serves for a trial step.
        let centroid = if area.abs() < 1e-6 { corners[0] } else { centroid };
        out.push(face.centres[i].0 - centroid.0);
        out.push(face.centres[i].1 - centroid.1);
    }
}

/// Pose fitted to residuals.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Fit {
    pub(super) pose: Pose,
    /// Root mean square distance of the measured points from the model (px); each point has two
    /// residuals. Infinite without residuals.
    pub(super) rms: f64,
    /// Covariance of the error of the pose in the axes of the camera: translation (m), then
    /// rotation about the pose's own origin (rad).
    pub(super) covariance: Matrix6<f64>,
}

/// Fits a pose, starting from `start`, so that the sum of the squared residuals is least.
/// `residuals` appends the residuals of a pose (px) to its second argument.
pub(super) fn refine(start: &Pose, residuals: impl Fn(&Pose, &mut Vec<f64>)) -> Fit {
    let pose = |delta: &SVector<f64, 6>| moved(start, (*delta).into());
    let found = minimise(SVector::zeros(), [1e-6; 6], |delta, out| residuals(&pose(delta), out));
    let count = found.residuals.len();
    if count == 0 {
        return Fit { pose: *start, rms: f64::INFINITY, covariance: Matrix6::identity() };
    }
    // The variance of a residual is estimated from the residuals themselves, because the noise of
    // the centroids is not known.
    let freedom = (count as f64 - 6.0).max(1.0);
    let inverse = found.normal.try_inverse().unwrap_or_else(Matrix6::identity);
    Fit {
        pose: pose(&found.at),
        rms: (2.0 * found.cost / count as f64).sqrt(),
        covariance: inverse * (found.cost / freedom),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::Intrinsics;
    use crate::homography::OUTLINE;
    use proptest::prelude::*;

    pub(crate) const CAMERA: Intrinsics = Intrinsics {
        width: 640,
        height: 480,
        focal: (600.0, 600.0),
        centre: (319.5, 239.5),
        distortion: (-0.08, 0.02),
    };
    /// Edge of the cube (m).
    const EDGE: f64 = 0.057;

    /// Returns the face that a perfect detector would measure at this pose.
    fn sighting(camera_from_face: &Pose) -> FaceSighting {
        let mut face = FaceSighting {
            corners: OUTLINE.map(|(x, y)| {
                CAMERA
                    .project(&(camera_from_face * Point3::new(x * EDGE / 3.0, y * EDGE / 3.0, 0.0)))
            }),
            centres: [(0.0, 0.0); 9],
            seen: [true; 9],
            sticker: 0.85,
            rgb: [[0.0; 3]; 9],
            colours: [0; 9],
            confidences: [1.0; 9],
            confidence: 1.0,
        };
        let mut errors = Vec::new();
        residuals(&face, camera_from_face, &Lens::from(&CAMERA), EDGE, &mut errors);
        for i in 0..9 {
            face.centres[i] = (-errors[2 * i], -errors[2 * i + 1]);
        }
        face
    }

    proptest! {
        #[test]
        fn locate_recovers_pose_from_perfect_measurement(
            x in -0.1..0.1f64, y in -0.08..0.08f64, z in 0.25..0.6f64,
            tilt_x in -0.8..0.8f64, tilt_y in -0.8..0.8f64, roll in -0.7..0.7f64,
        ) {
            prop_assume!(tilt_x.hypot(tilt_y) > 0.1);
            let truth = Pose::from_parts(
                Translation3::new(x, y, z),
                UnitQuaternion::from_euler_angles(tilt_x, tilt_y, roll),
            );

            let found = locate(&sighting(&truth), &CAMERA, EDGE);

            let near = |p: &Pose| {
                (p.translation.vector - truth.translation.vector).norm() < 1e-5
                    && p.rotation.angle_to(&truth.rotation) < 1e-3
            };
            prop_assert!(near(&found.camera_from_face), "{truth} {found:?}");
            prop_assert!(found.residual_px < 1e-3);
        }

        #[test]
        fn two_faces_determine_pose_of_cube(
            z in 0.25..0.6f64, tilt_x in 0.35..0.8f64, tilt_y in -0.6..0.6f64, roll in -0.7..0.7f64,
        ) {
            let camera_from_cube = Pose::from_parts(
                Translation3::new(0.01, -0.02, z),
                UnitQuaternion::from_euler_angles(tilt_x, tilt_y, roll),
            );
            let down = Rotation3::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
            let up = Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2);
            let front = camera_from_cube * cube_from_face(&Rotation3::identity(), EDGE);
            let faces: Vec<FaceSighting> = [down, up]
                .iter()
                .map(|r| camera_from_cube * cube_from_face(r, EDGE))
                // A face is visible when its inward normal points away from the camera.
                .filter(|f| (f * Vector3::z()).dot(&f.translation.vector) > 0.15 * z)
                .chain([front])
                .map(|f| sighting(&f))
                .collect();
            prop_assume!(faces.len() == 2);

            let found = locate_cube(&faces, &CAMERA, EDGE, None).unwrap();

            prop_assert_eq!(found.faces.len(), 2);
            let error =
                found.camera_from_cube.translation.vector - camera_from_cube.translation.vector;
            prop_assert!(error.norm() < 1e-5, "{}", error);
            let relative = found.camera_from_cube.rotation.inverse() * camera_from_cube.rotation;
            prop_assert!((nearest_of_24(&relative).inverse() * relative).angle() < 1e-3);
        }
    }

    #[test]
    fn cube_has_24_rotations() {
        let all: Vec<_> = cube_rotations().collect();

        let distinct =
            all.iter().enumerate().all(|(i, a)| all[..i].iter().all(|b| a.angle_to(b) > 1.0));
        assert!(distinct && all.len() == 24);
    }
}
