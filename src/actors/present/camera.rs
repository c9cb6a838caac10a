//! The results of vision, drawn into their picture: outlines, tiles and words.
//!
//! - in: the believed cell, a picture's result of vision
//! - out: outlines and marks of a camera's view, in pixels of its picture

use crate::actors::latest::{Found, Sight};
use crate::cell::{Camera, Cell, Mount};
use crate::cube::Face;
use crate::operator::{CameraView, Mark};
use crate::spatial::Pose;
use crate::vision::sensor::FaceReading;
use nalgebra::{Point3, Vector3};

/// Replaces the outlines, marks and words that the user interfaces draw over the picture of a
/// camera by those of the result of vision in `sight`. They are in pixels of that picture.
pub(super) fn draw(view: &mut CameraView, cell: &Cell, camera: usize, sight: &Sight) {
    let (camera, edge) = (&cell.cameras[camera], cell.cube.edge);
    // The drawing of the last picture must not remain in a picture in which vision finds less.
    view.outlines.clear();
    view.marks.clear();
    view.found = !matches!(sight.found, Found::Nothing(_));
    match &sight.found {
        Found::Nothing(why) => view.words.clone_from(why),
        Found::Cube(world_from_cube, speed) => {
            // Only a stand-alone camera looks for the cube: one in a hand looks at faces.
            let Mount::World { world_from_camera } = camera.mount else { return };
            let camera_from_cube = world_from_camera.inverse() * world_from_cube;
            draw_cube(view, camera, edge, &camera_from_cube);
            let away = camera_from_cube.translation.vector.norm();
            view.words = format!("cube {away:.2} m away, {:.0} mm/s", speed * 1e3);
        }
        Found::Face(reading) => draw_face(view, camera, edge, reading),
    }
}

/// Returns the pixel to which `point`, in the camera's frame, projects; `None` if the point is not
/// in front of the camera.
fn project(camera: &Camera, point: Point3<f64>) -> Option<(f64, f64)> {
    // At least 10 mm before it: the projection of a point near its plane is far off the picture.
    (point.z > 0.01).then(|| camera.intrinsics.project(&point))
}

/// Adds the outlines of those faces of a cube that the camera sees. `edge` is the length of the
/// cube's edges (m).
fn draw_cube(view: &mut CameraView, camera: &Camera, edge: f64, camera_from_cube: &Pose) {
    let half = 0.5 * edge;
    for face in Face::ALL {
        let (x, y) = face.reading_axes();
        let normal = face.normal();
        let centre = camera_from_cube * Point3::from(normal * half);
        // The ray from the camera to a side that it sees points against the side's normal.
        if (camera_from_cube.rotation * normal).dot(&centre.coords) >= 0.0 {
            continue;
        }
        let corner = |(a, b): (f64, f64)| -> Vector3<f64> { (normal + x * a + y * b) * half };
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(corner);
        let at = |corner| project(camera, camera_from_cube * Point3::from(corner));
        // A side with a corner behind the camera is left out whole.
        let outline: Option<Vec<_>> = corners.into_iter().map(at).collect();
        view.outlines.extend(outline);
    }
}

/// Adds the outline of a face that was read, and a mark with colour and confidence for each of its
/// nine tiles. `edge` is the length of the cube's edges (m).
fn draw_face(view: &mut CameraView, camera: &Camera, edge: f64, reading: &FaceReading) {
    let half = 0.5 * edge;
    let at = |x: f64, y: f64| project(camera, reading.camera_from_face * Point3::new(x, y, 0.0));
    let corners = [(-half, -half), (half, -half), (half, half), (-half, half)];
    let outline: Option<Vec<_>> = corners.into_iter().map(|(x, y)| at(x, y)).collect();
    view.outlines.extend(outline);
    // The tiles in the order of reading: columns along x, rows along y of the face.
    let pitch = edge / 3.0;
    for i in 0..9 {
        let (column, row) = ((i % 3) as f64 - 1.0, (i / 3) as f64 - 1.0);
        let Some(at) = at(column * pitch, row * pitch) else { continue };
        view.marks.push(Mark {
            at,
            colour: (!reading.occluded[i]).then_some(reading.colours[i]),
            confidence: reading.confidences[i],
        });
    }
    view.words = format!(
        "face, confidence {:.2}, residual {:.2} px",
        reading.confidence, reading.residual_px
    );
}
