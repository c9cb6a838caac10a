//! Calibration results in a recording: the cameras and the edge of the cube as the run believed
//! them after a calibration. They differ from those of the scenario, and a replay needs them to
//! draw the results of vision in the right place.
//!
//! - in: the cell that the controller believes; or the [`Label`] of a recording
//! - out: texts by name for the recording; or the cell with the calibrated cameras and cube

use super::reading::Label;
use crate::cell::{Cell, Mount};
use crate::spatial::Pose;
use serde::{Deserialize, Serialize};

/// Name of the metadata record that holds the results of a calibration.
pub(crate) const NAME: &str = "calibration";

/// Camera as JSON in the file. The names of its fields are part of the file format.
#[derive(Debug, Serialize, Deserialize)]
struct Wire {
    name: String,
    /// Focal lengths, optical centre (pixels) and radial distortion, as in `Intrinsics`.
    focal: (f64, f64),
    centre: (f64, f64),
    distortion: (f64, f64),
    /// Pose in the world, or in the flange that carries the camera.
    place: Pose,
}

/// Returns all values of a cell that a calibration can change, as texts by name.
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

/// Copies the calibration in a recording's metadata (`label`) to `cell`, the cell of its scenario.
/// Without a calibration in the recording nothing changes.
pub(crate) fn apply(label: &Label, cell: &mut Cell) {
    // A missing fact is an empty text, which is no number.
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

/// Returns the believed position of the stand-alone camera in the world as "x y z" (m); empty if
/// the cell has none.
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
    fn recorded_calibration_restores_the_same_cell() {
        let scenario = crate::tasks::read(std::path::Path::new("t.toml"), "", &[]).unwrap();
        let before = scenario.controller.cell.clone();
        let mut found = before.clone();
        found.cube.edge += 1e-4;
        let (mut standing, mut riding) = (0, 0);
        for (i, camera) in found.cameras.iter_mut().enumerate() {
            // Different values for each camera, so that a swap of two cameras is found.
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

        // A recording without a calibration changes nothing.
        apply(&label, &mut cell);
        assert_eq!(cell, before);

        label.take(&Piece::Metadata(NAME.to_owned(), facts(&found).into_iter().collect()));
        apply(&label, &mut cell);
        assert_eq!(cell, found);
    }
}
