//! A cell with the arms and cameras of the default one, for tests, benches and examples.

use crate::arms::builtin;
use crate::cell::{Arm, Camera, Cell, CubeSpec, ForceSensor, Gripper, HandZone, Intrinsics, Mount};
use crate::kinematics::ArmModel;
use crate::motion::JointPositions;
use crate::spatial::{Pose, pose_from_axes};
use nalgebra::{Point3, Vector3};

/// Returns a cell of two IRp-6 arms 2.11 m apart along y, with a camera on each hand. Real runs
/// read their numbers from scenarios.
///
/// # Panics
/// Never panics: the arms' profiles are part of the program.
#[doc(hidden)]
#[must_use]
pub fn example_cell() -> Cell {
    Cell {
        arms: vec![
            arm("track", "irp6_track", 0.0, 0.0),
            arm("postument", "irp6_postument", 0.0, 2.11),
        ],
        cameras: vec![camera("track_hand", 0, -0.0551), camera("postument_hand", 1, 0.0551)],
        cube: CubeSpec { edge: 0.057, mass: 0.1 },
        table_height: 0.75,
        hand: HandZone {
            world_from_cube: Pose::translation(0.85, 0.4, 1.25),
            half_extent: Vector3::new(0.05, 0.05, 0.05),
        },
        keeper: crate::cube::Keeper::Person,
    }
}

/// Returns an arm with this built-in profile and its base at x, y in the world (m).
fn arm(name: &str, profile: &str, x: f64, y: f64) -> Arm {
    Arm {
        name: name.into(),
        model: model(profile),
        world_from_base: Pose::translation(x, y, 0.0),
        flange_from_tool: Pose::translation(0.0, 0.0, 0.25),
        gripper: Gripper {
            finger_width: 0.012,
            finger_thickness: 0.010,
            finger_tip: 0.0075,
            palm: 0.0425,
            palm_half_width: 0.035,
            opening: (0.053, 0.091),
            opening_of_motor: [0.074, -1.451910074e-5, -2.8313e-9],
            opening_offset: 0.0,
            increments: 128.0,
            amperes_per_newton: 0.01,
        },
        sensor: ForceSensor {
            flange_from_sensor: Pose::translation(0.0, 0.0, 0.09),
            weight: 12.0,
            centre_in_flange: Point3::new(0.004, 0.0, 0.13),
            range: [65.0, 65.0, 130.0, 5.0, 5.0, 5.0],
        },
        start: JointPositions([0.0, 0.0, -1.57, 0.0, 1.56, 1.57, -1.57]),
    }
}

/// Returns the model of a built-in arm profile.
///
/// # Panics
/// If there is no profile of this name.
fn model(profile: &str) -> ArmModel {
    builtin(profile).unwrap_or_else(|| unreachable!("{profile} is built in"))
}

/// Returns a camera that is `x` (m) beside the hand of `arm` and looks along the tool axis, with
/// the x of its image along the y of the flange.
fn camera(name: &str, arm: usize, x: f64) -> Camera {
    let side = x.signum();
    Camera {
        name: name.into(),
        mount: Mount::Flange {
            arm,
            flange_from_camera: pose_from_axes(
                -side * Vector3::y(),
                side * Vector3::x(),
                Vector3::z(),
                Point3::new(x, 0.0, 0.13),
            ),
        },
        intrinsics: Intrinsics {
            width: 384,
            height: 288,
            focal: (500.0, 500.0),
            centre: (191.5, 143.5),
            distortion: (0.0, 0.0),
        },
    }
}
