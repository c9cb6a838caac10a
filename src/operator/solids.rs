//! What an arm is drawn with: primitive solids that hang on the frames of its links.
//!
//! Shapes are those that the collision model assumes, since no drawing of the arm is public; sizes of the gripper are
//! the scenario's.

use crate::cell::{Arm, Cell, Mount};
use crate::motion::JointPositions;
use crate::spatial::{Pose, pose_from_axes};
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

/// The frames of an effector, in the order of [`ArmView::frames`](super::ArmView::frames). A link's frame has its
/// origin at the link's lower joint, z along it, y along the pitch axes.
pub const FRAMES: [&str; 8] =
    ["base", "column", "lower arm", "upper arm", "wrist", "flange", "tool", "jaws"];

/// A shape about the origin of its own frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "shape", rename_all = "snake_case")]
pub enum Shape {
    /// Extents along x, y, z (m).
    Box {
        /// Full lengths.
        size: [f64; 3],
    },
    /// About z, from z = 0 upwards (m).
    Cylinder {
        /// Radius.
        radius: f64,
        /// Length.
        length: f64,
    },
}

/// A coloured shape that hangs on something.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Solid {
    /// Effector; `None` for what stands in the world.
    pub arm: Option<usize>,
    /// Index in [`FRAMES`].
    pub frame: usize,
    /// Where in that frame.
    pub pose: Pose,
    /// What.
    #[serde(flatten)]
    pub shape: Shape,
    /// Red, green, blue, 0..=255.
    pub colour: [u8; 3],
    /// A finger: its pad stands half the opening from the frame's origin along y, on this side (1, -1); 0 for others.
    pub jaw: i8,
}

const PAINT: [u8; 3] = [214, 120, 34];
const DARK: [u8; 3] = [70, 76, 84];
const METAL: [u8; 3] = [168, 174, 182];
const PAD: [u8; 3] = [40, 44, 50];
const FLOOR_STONE: [u8; 3] = [120, 124, 130];

/// The frames of an arm at these joints, in the world. `world_from_base` is where the controller believes its base.
#[must_use]
pub fn arm_frames(arm: &Arm, world_from_base: &Pose, joints: &JointPositions) -> Vec<Pose> {
    let points = arm.model.points(joints);
    let base_from_flange = arm.model.base_from_flange(joints);
    let pitch = Vector3::new(-joints.0[1].sin(), joints.0[1].cos(), 0.0);
    let link = |from: Point3<f64>, to: Point3<f64>| {
        let z = (to - from).try_normalize(1e-9).unwrap_or_else(Vector3::z);
        pose_from_axes(pitch.cross(&z), pitch, z, from)
    };
    let base_from_tool = base_from_flange * arm.flange_from_tool;
    [
        Pose::from(points[0]),
        link(points[0], points[1]),
        link(points[1], points[2]),
        link(points[2], points[3]),
        link(points[3], points[4]),
        base_from_flange,
        base_from_tool,
        base_from_tool,
    ]
    .iter()
    .map(|base_from_frame| world_from_base * base_from_frame)
    .collect()
}

/// Where an arm stands, by its joints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmJoints {
    /// Origins in the world of base (on the floor), shoulder, elbow, wrist pitch centre, flange.
    pub points: [Point3<f64>; 5],
    /// `world_from_flange`.
    pub flange: Pose,
    /// `world_from_tool`.
    pub tool: Pose,
}

/// The joints of the arm whose frames [`arm_frames`] made; `None` where some are missing.
#[must_use]
pub fn joints_of(frames: &[Pose]) -> Option<ArmJoints> {
    // A link's frame begins at its lower joint, so the flange is where the last link ends.
    let [_, base, shoulder, elbow, wrist, flange, tool, _] = *frames else { return None };
    let joints = [base, shoulder, elbow, wrist, flange];
    let points = joints.map(|frame| Point3::from(frame.translation.vector));
    Some(ArmJoints { points, flange, tool })
}

/// The solids of all effectors, the track's rail, the table and the cameras.
#[must_use]
pub fn arm_solids(cell: &Cell) -> Vec<Solid> {
    let mut solids = Vec::new();
    for (index, arm) in cell.arms.iter().enumerate() {
        one_arm(&mut solids, index, arm);
    }
    for camera in &cell.cameras {
        let size = [0.05, 0.04, 0.06];
        let (arm, frame, pose) = match camera.mount {
            Mount::World { world_from_camera } => (None, 0, world_from_camera),
            Mount::Flange { arm, flange_from_camera } => (Some(arm), 5, flange_from_camera),
        };
        let back = pose * Pose::translation(0.0, 0.0, -0.03);
        solids.push(Solid {
            arm,
            frame,
            pose: back,
            shape: Shape::Box { size },
            colour: PAD,
            jaw: 0,
        });
        let lens = Shape::Cylinder { radius: 0.014, length: 0.02 };
        solids.push(Solid { arm, frame, pose, shape: lens, colour: METAL, jaw: 0 });
    }
    solids
}

fn one_arm(solids: &mut Vec<Solid>, index: usize, arm: &Arm) {
    let [lower, upper, wrist] = arm.model.links;
    let height = arm.model.shoulder_height;
    let tool = arm.flange_from_tool.translation.vector.z;
    let g = &arm.gripper;
    let mut add = |frame: usize, at: [f64; 3], shape: Shape, colour: [u8; 3], jaw: i8| {
        let pose = Pose::translation(at[0], at[1], at[2]);
        solids.push(Solid { arm: Some(index), frame, pose, shape, colour, jaw });
    };
    let boxed = |x, y, z| Shape::Box { size: [x, y, z] };
    let rod = |radius, length| Shape::Cylinder { radius, length };

    add(0, [0.0, 0.0, 0.06], boxed(0.44, 0.44, 0.12), FLOOR_STONE, 0);
    add(1, [0.0, 0.0, 0.10], rod(0.13, height - 0.22), DARK, 0);
    add(1, [0.0, 0.0, height - 0.10], boxed(0.22, 0.24, 0.24), PAINT, 0);
    // The ball screws stand behind the column, one on each side.
    add(1, [-0.17, 0.09, height - 0.42], boxed(0.09, 0.07, 0.40), METAL, 0);
    add(1, [-0.17, -0.09, height - 0.42], boxed(0.09, 0.07, 0.40), METAL, 0);
    for side in [0.075, -0.075] {
        add(2, [0.0, side, lower / 2.0], boxed(0.10, 0.045, lower + 0.08), PAINT, 0);
    }
    add(3, [0.0, 0.0, upper / 2.0 - 0.02], boxed(0.11, 0.10, upper + 0.12), PAINT, 0);
    add(4, [0.0, 0.0, 0.0], rod(0.055, wrist), DARK, 0);
    add(5, [0.0, 0.0, 0.0], rod(0.050, 0.035), METAL, 0);
    let body = (tool - g.palm - 0.045).max(0.02);
    add(5, [0.0, 0.0, 0.035 + body / 2.0], boxed(0.09, 0.10, body), DARK, 0);
    let wide = 2.0 * g.palm_half_width;
    add(6, [0.0, 0.0, -g.palm - 0.006], boxed(wide, wide, 0.012), METAL, 0);
    let long = g.finger_tip + g.palm + 0.03;
    for side in [1_i8, -1] {
        let out = f64::from(side) * g.finger_thickness / 2.0;
        let finger = boxed(g.finger_width, g.finger_thickness, long);
        add(7, [0.0, out, g.finger_tip - long / 2.0], finger, METAL, side);
        let pad = boxed(g.finger_width + 0.002, 0.004, 0.036);
        add(7, [0.0, f64::from(side) * 0.002, g.finger_tip - 0.018], pad, PAD, side);
    }
    if arm.model.has_track {
        let (low, high) = arm.model.joint_limits[0];
        let middle = arm.world_from_base * Pose::translation(0.0, f64::midpoint(low, high), 0.015);
        let shape = boxed(0.36, high - low + 0.6, 0.03);
        solids.push(Solid { arm: None, frame: 0, pose: middle, shape, colour: DARK, jaw: 0 });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn links_reach_from_joint_to_joint_and_the_tool_is_where_kinematics_say() {
        let scenario = crate::scenario::read(Path::new("t.toml"), "", &[]).unwrap();
        for arm in &scenario.controller.cell.arms {
            let frames = arm_frames(arm, &arm.world_from_base, &arm.start);

            assert_eq!(frames.len(), FRAMES.len());
            let along = |frame: usize, length: f64| frames[frame] * Point3::new(0.0, 0.0, length);
            let origin = |frame: usize| Point3::from(frames[frame].translation.vector);
            let [lower, upper, wrist] = arm.model.links;
            assert!((along(1, arm.model.shoulder_height) - origin(2)).norm() < 1e-9);
            assert!((along(2, lower) - origin(3)).norm() < 1e-9);
            assert!((along(3, upper) - origin(4)).norm() < 1e-9);
            assert!((along(4, wrist) - origin(5)).norm() < 1e-9);
            let tool =
                arm.world_from_base * arm.model.base_from_flange(&arm.start) * arm.flange_from_tool;
            assert!((frames[6].translation.vector - tool.translation.vector).norm() < 1e-9);
            let joints = joints_of(&frames).unwrap();
            for (is, believed) in joints.points.iter().zip(arm.model.points(&arm.start)) {
                assert!((is - arm.world_from_base * believed).norm() < 1e-9, "{is}");
            }
            assert_eq!((joints.flange, joints.tool), (frames[5], frames[6]));
            assert_eq!(joints_of(&frames[1..]), None);
        }
    }

    #[test]
    fn every_solid_hangs_on_a_frame_that_is_there() {
        let scenario = crate::scenario::read(Path::new("t.toml"), "", &[]).unwrap();
        let cell = &scenario.controller.cell;

        let solids = arm_solids(cell);

        assert!(solids.len() > 20);
        for solid in solids {
            assert!(solid.frame < FRAMES.len());
            assert!(solid.arm.is_none_or(|arm| arm < cell.arms.len()));
        }
    }
}
