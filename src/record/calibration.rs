//! The cameras as a run believed them, where a calibration found other values than its scenario
//! has: facts of a recording, so that a replay paints what vision found where it found it.
//!
//! - in: the cell that the controller believes; or the label of a recording
//! - out: named texts; or the cell with those cameras in it

use super::reading::Label;
use crate::cell::{Cell, Mount};
use crate::spatial::Pose;
use serde::{Deserialize, Serialize};

/// Name of the facts in a recording.
pub(crate) const NAME: &str = "calibration";

/// A camera as it is written.
#[derive(Debug, Serialize, Deserialize)]
struct Wire {
    name: String,
    focal: (f64, f64),
    centre: (f64, f64),
    distortion: (f64, f64),
    /// In the world, or in the flange that it hangs on.
    place: Pose,
}

/// What a calibration can change of a cell.
#[must_use]
pub(crate) fn facts(cell: &Cell) -> Vec<(String, String)> {
    let wire = |camera: &crate::cell::Camera| Wire {
        name: camera.name.clone(),
        focal: camera.intrinsics.focal,
        centre: camera.intrinsics.centre,
        distortion: camera.intrinsics.distortion,
        place: match camera.mount {
            Mount::World { world_from_camera: place }
            | Mount::Flange { flange_from_camera: place, .. } => place,
        },
    };
    let cameras: Vec<_> = cell.cameras.iter().map(wire).collect();
    let facts = [
        ("cameras", serde_json::to_string(&cameras).unwrap_or_default()),
        ("edge_m", cell.cube.edge.to_string()),
        ("standalone_xyz", standalone(cell)),
    ];
    facts.map(|(name, value)| (name.to_owned(), value)).to_vec()
}

/// Puts what a recording says of its calibration into the cell of its scenario; without such facts
/// it stays as it is.
pub(crate) fn apply(label: &Label, cell: &mut Cell) {
    if let Ok(edge) = label.of(NAME, "edge_m").parse() {
        cell.cube.edge = edge;
    }
    let cameras: Vec<Wire> = serde_json::from_str(label.of(NAME, "cameras")).unwrap_or_default();
    for found in cameras {
        let Some(camera) = cell.cameras.iter_mut().find(|c| c.name == found.name) else { continue };
        camera.intrinsics.focal = found.focal;
        camera.intrinsics.centre = found.centre;
        camera.intrinsics.distortion = found.distortion;
        match &mut camera.mount {
            Mount::World { world_from_camera: place }
            | Mount::Flange { flange_from_camera: place, .. } => *place = found.place,
        }
    }
}

/// Where the camera that stands in the cell is believed to be (m).
#[must_use]
pub(crate) fn standalone(cell: &Cell) -> String {
    let place = cell.cameras.iter().find_map(|camera| match camera.mount {
        Mount::World { world_from_camera } => Some(world_from_camera.translation.vector),
        Mount::Flange { .. } => None,
    });
    place.map_or_else(String::new, |p| format!("{} {} {}", p.x, p.y, p.z))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::reading::Piece;
    use nalgebra::{Translation3, UnitQuaternion};

    #[test]
    fn what_was_found_comes_back_and_a_recording_without_it_changes_nothing() {
        let scenario = crate::scenario::read(std::path::Path::new("t.toml"), "", &[]).unwrap();
        let before = scenario.controller.cell.clone();
        let mut found = before.clone();
        found.cube.edge += 1e-4;
        let (mut standing, mut riding) = (0, 0);
        for (i, camera) in found.cameras.iter_mut().enumerate() {
            // Each otherwise, so that none may stand for another.
            let by = 1e-3 * (i + 1) as f64;
            let optics = &mut camera.intrinsics;
            optics.focal = (optics.focal.0 + 3.25 + by, optics.focal.1 - 1.5 - by);
            optics.centre = (optics.centre.0 - 2.0 - by, optics.centre.1 + 4.0 + by);
            optics.distortion = (0.02 + by, -0.03 - by);
            let place = match &mut camera.mount {
                Mount::World { world_from_camera } => {
                    standing += 1;
                    world_from_camera
                }
                Mount::Flange { flange_from_camera, .. } => {
                    riding += 1;
                    flange_from_camera
                }
            };
            let turned = UnitQuaternion::from_euler_angles(0.01, -0.02 - by, 0.03);
            *place *= Pose::from_parts(Translation3::new(0.0123, by, -0.004), turned);
        }
        assert_eq!((standing, riding), (1, 2));
        let mut label = Label::default();
        let mut cell = before.clone();

        apply(&label, &mut cell);
        assert_eq!(cell, before);

        label.take(&Piece::Metadata(NAME.to_owned(), facts(&found).into_iter().collect()));
        apply(&label, &mut cell);
        assert_eq!(cell, found);
    }
}
