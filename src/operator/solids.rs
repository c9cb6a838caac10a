//! Solids with which a user interface draws the cell: primitive shapes attached to the frames of
//! the links.
//!
//! No drawing of the arm is public, so the shapes of its links are those that the collision model
//! assumes. The sizes of the gripper are those of the scenario.
//!
//! - in: the cell as the controller believes it, the joints of an arm
//! - out: the [`Solid`]s, sent once; the frames of the links, sent with each snapshot

use crate::cell::{Arm, Cell, Mount, TABLE_TOP};
use crate::motion::JointPositions;
use crate::spatial::{Pose, pose_from_axes};
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

/// Names of the frames of an effector, in the order of [`ArmView::frames`](super::ArmView::frames).
/// The frame of a link has its origin at the link's lower joint, z along the link, y along the
/// pitch axes.
pub const FRAMES: [&str; 8] =
    ["base", "column", "lower arm", "upper arm", "wrist", "flange", "tool", "jaws"];

/// A primitive shape in its own frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "shape", rename_all = "snake_case")]
pub enum Shape {
    /// Box about the origin.
    Box {
        /// Full lengths along x, y, z (m).
        size: [f64; 3],
    },
    /// Cylinder about z, from z = 0 upwards.
    Cylinder {
        /// Radius (m).
        radius: f64,
        /// Length (m).
        length: f64,
    },
}

/// A coloured shape that is attached to a frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Solid {
    /// Index of the effector; `None` for a solid that is fixed in the world.
    pub arm: Option<usize>,
    /// Index in [`FRAMES`].
    pub frame: usize,
    /// Pose of the solid in that frame.
    pub pose: Pose,
    /// Shape of the solid.
    #[serde(flatten)]
    pub shape: Shape,
    /// Colour: red, green, blue, 0..=255.
    pub colour: [u8; 3],
    /// Side of a finger along y (1, -1), or 0 for other solids. The pad of a finger is half the
    /// opening away from the origin of its frame.
    pub jaw: i8,
}

// Colours of the solids: red, green, blue, 0..=255.
const PAINT: [u8; 3] = [214, 120, 34];
const DARK: [u8; 3] = [70, 76, 84];
const METAL: [u8; 3] = [168, 174, 182];
const PAD: [u8; 3] = [40, 44, 50];
const FLOOR_STONE: [u8; 3] = [120, 124, 130];
const LOOSE: [u8; 3] = [186, 148, 84];
const WOOD: [u8; 3] = [164, 134, 100];

/// Number of boxes that draw a contour.
const SLICES: u32 = 32;

/// Form of a rigid object beside the cube.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Form<'a> {
    /// Box about its centre.
    Box,
    /// Cylinder about its centre, with its axis along z.
    Cylinder,
    /// Body on its base with a curved upper side: places along x, and heights above the middle (m).
    Contour(&'a [[f64; 2]]),
}

/// Returns the solids of an object with these sizes along x, y, z (m), each with its pose in the
/// frame of the object. A loose object has another colour than a fixed one.
#[must_use]
pub fn object_solids(form: Form<'_>, [x, y, z]: [f64; 3], fixed: bool) -> Vec<Solid> {
    let colour = if fixed { FLOOR_STONE } else { LOOSE };
    let solid =
        |pose: Pose, shape: Shape| Solid { arm: None, frame: 0, pose, shape, colour, jaw: 0 };
    match form {
        Form::Box => vec![solid(Pose::identity(), Shape::Box { size: [x, y, z] })],
        Form::Cylinder => {
            let shape = Shape::Cylinder { radius: 0.5 * x, length: z };
            vec![solid(Pose::translation(0.0, 0.0, -0.5 * z), shape)]
        }
        Form::Contour(points) => {
            let width = x / f64::from(SLICES);
            let slice = |i: u32| {
                let at = (f64::from(i) + 0.5) * width - 0.5 * x;
                let height = (z + contour(points, at)).max(1e-3);
                let shape = Shape::Box { size: [width, y, height] };
                solid(Pose::translation(at, 0.0, 0.5 * height), shape)
            };
            (0..SLICES).map(slice).collect()
        }
    }
}

/// Returns the height of a contour above its middle at the place `x` (m); 0 without points.
fn contour(points: &[[f64; 2]], x: f64) -> f64 {
    let after = points.iter().position(|[at, _]| *at >= x);
    match (after, points) {
        (_, []) => 0.0,
        (Some(0), [[_, first], ..]) => *first,
        (None, [.., [_, last]]) => *last,
        (Some(i), _) => {
            let ([from, low], [to, high]) = (points[i - 1], points[i]);
            low + (high - low) * (x - from) / (to - from).max(1e-9)
        }
    }
}

/// Computes the frames of an arm with these joint positions, in the world and in the order of
/// [`FRAMES`]. `world_from_base` is the pose of the base as the controller believes it.
#[must_use]
pub fn arm_frames(arm: &Arm, world_from_base: &Pose, joints: &JointPositions) -> Vec<Pose> {
    let points = arm.model.points(joints);
    let base_from_flange = arm.model.base_from_flange(joints);
    // All pitch axes are parallel and horizontal; joint 1 turns them about the vertical.
    let pitch = Vector3::new(-joints.0[1].sin(), joints.0[1].cos(), 0.0);
    let link = |from: Point3<f64>, to: Point3<f64>| {
        // A link without a length has no direction. For a drawing any direction will do.
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

/// Places of an arm's joints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmJoints {
    /// Places of base (on the floor), shoulder, elbow, centre of the wrist's pitch, and flange, in
    /// the world (m).
    pub points: [Point3<f64>; 5],
    /// Pose of the flange: `world_from_flange`.
    pub flange: Pose,
    /// Pose of the tool: `world_from_tool`.
    pub tool: Pose,
}

/// Returns the places of an arm's joints and the poses of its flange and tool, from the frames of
/// [`arm_frames`]; `None` if frames are missing.
#[must_use]
pub fn joints_of(frames: &[Pose]) -> Option<ArmJoints> {
    // The frame of a link has its origin at the link's lower joint: that of the column at the base,
    // that of the lower arm at the shoulder, and so on.
    let [_, base, shoulder, elbow, wrist, flange, tool, _] = *frames else { return None };
    let joints = [base, shoulder, elbow, wrist, flange];
    let points = joints.map(|frame| Point3::from(frame.translation.vector));
    Some(ArmJoints { points, flange, tool })
}

/// Returns the solids of all effectors, the rail of the track, the table, and the cameras, of which
/// a fixed one stands on a tripod.
#[must_use]
pub fn cell_solids(cell: &Cell) -> Vec<Solid> {
    let mut solids = Vec::new();
    table(&mut solids, cell);
    for (index, arm) in cell.arms.iter().enumerate() {
        one_arm(&mut solids, index, arm);
    }
    for camera in &cell.cameras {
        // A housing behind the optical centre, with the lens in front of it.
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
        if arm.is_none() {
            tripod(&mut solids, Point3::from(back.translation.vector));
        }
    }
    solids
}

/// Adds the table, whose top is below the zone of the hand-over.
fn table(solids: &mut Vec<Solid>, cell: &Cell) {
    const THICK: f64 = 0.03;
    let (wide, deep) = TABLE_TOP;
    let at = cell.hand.world_from_cube.translation.vector;
    let mut add = |x: f64, y: f64, z: f64, size: [f64; 3], colour| {
        let pose = Pose::translation(at.x + x, at.y + y, z);
        let shape = Shape::Box { size };
        solids.push(Solid { arm: None, frame: 0, pose, shape, colour, jaw: 0 });
    };
    let leg = (cell.table_height - THICK).max(1e-3);
    add(0.0, 0.0, cell.table_height - 0.5 * THICK, [wide, deep, THICK], WOOD);
    for (x, y) in [(-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)] {
        add(x * (wide - 0.08), y * (deep - 0.08), 0.5 * leg, [0.04, 0.04, leg], DARK);
    }
}

/// Adds the legs of a tripod below the point `top`.
fn tripod(solids: &mut Vec<Solid>, top: Point3<f64>) {
    /// Distance of the feet from the middle, as a share of the height.
    const SPREAD: f64 = 0.3;
    for third in 0..3_i32 {
        let angle = f64::from(third) * std::f64::consts::TAU / 3.0;
        let along = Vector3::new(SPREAD * angle.cos(), SPREAD * angle.sin(), -1.0);
        let z = along.normalize();
        let y = z.cross(&Vector3::x()).normalize();
        let pose = pose_from_axes(y.cross(&z), y, z, top);
        let shape = Shape::Cylinder { radius: 0.011, length: along.norm() * top.z.max(0.0) };
        solids.push(Solid { arm: None, frame: 0, pose, shape, colour: DARK, jaw: 0 });
    }
}

/// Adds the solids of the arm with this index: from base to fingers, and its rail.
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

    // Base and column.
    add(0, [0.0, 0.0, 0.06], boxed(0.44, 0.44, 0.12), FLOOR_STONE, 0);
    add(1, [0.0, 0.0, 0.10], rod(0.13, height - 0.22), DARK, 0);
    add(1, [0.0, 0.0, height - 0.10], boxed(0.22, 0.24, 0.24), PAINT, 0);
    // The ball screws are behind the column, one on each side.
    add(1, [-0.17, 0.09, height - 0.42], boxed(0.09, 0.07, 0.40), METAL, 0);
    add(1, [-0.17, -0.09, height - 0.42], boxed(0.09, 0.07, 0.40), METAL, 0);
    // The lower arm consists of two parallel bars.
    for side in [0.075, -0.075] {
        add(2, [0.0, side, lower / 2.0], boxed(0.10, 0.045, lower + 0.08), PAINT, 0);
    }
    add(3, [0.0, 0.0, upper / 2.0 - 0.02], boxed(0.11, 0.10, upper + 0.12), PAINT, 0);
    add(4, [0.0, 0.0, 0.0], rod(0.055, wrist), DARK, 0);
    add(5, [0.0, 0.0, 0.0], rod(0.050, 0.035), METAL, 0);
    // The body fills the space between the sensor at the flange and the palm.
    let body = (tool - g.palm - 0.045).max(0.02);
    add(5, [0.0, 0.0, 0.035 + body / 2.0], boxed(0.09, 0.10, body), DARK, 0);
    let wide = 2.0 * g.palm_half_width;
    add(6, [0.0, 0.0, -g.palm - 0.006], boxed(wide, wide, 0.012), METAL, 0);
    // The frame of the jaws is between the pads, so fingers extend backwards behind the palm.
    let long = g.finger_tip + g.palm + 0.03;
    for side in [1_i8, -1] {
        let out = f64::from(side) * g.finger_thickness / 2.0;
        let finger = boxed(g.finger_width, g.finger_thickness, long);
        add(7, [0.0, out, g.finger_tip - long / 2.0], finger, METAL, side);
        let pad = boxed(g.finger_width + 0.002, 0.004, 0.036);
        add(7, [0.0, f64::from(side) * 0.002, g.finger_tip - 0.018], pad, PAD, side);
    }
    // The rail is fixed in the world, while the arm moves along it.
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
    fn frames_agree_with_kinematics() {
        let scenario = crate::tasks::read(Path::new("t.toml"), "", &[]).unwrap();
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
            for frame in &frames[6..] {
                let apart = frame.inverse() * tool;
                assert!(apart.translation.vector.norm() < 1e-9 && apart.rotation.angle() < 1e-7);
            }
            let joints = joints_of(&frames).unwrap();
            for (is, believed) in joints.points.iter().zip(arm.model.points(&arm.start)) {
                assert!((is - arm.world_from_base * believed).norm() < 1e-9, "{is}");
            }
            assert_eq!((joints.flange, joints.tool), (frames[5], frames[6]));
            assert_eq!(joints_of(&frames[1..]), None);
        }
    }

    #[test]
    fn object_solids_fill_its_sizes() {
        let one = |form| object_solids(form, [0.4, 0.06, 0.1], false);
        assert_eq!(one(Form::Box)[0].shape, Shape::Box { size: [0.4, 0.06, 0.1] });
        let [cylinder] = one(Form::Cylinder)[..] else { panic!("one solid") };
        assert!((cylinder.pose.translation.vector.z + 0.05).abs() < 1e-12);

        let hill = [[-0.1, 0.0], [0.0, 0.02], [0.1, 0.0]];
        let slices = one(Form::Contour(&hill));
        let top = |solid: &Solid| 2.0 * solid.pose.translation.vector.z;
        assert_eq!(slices.len(), 32);
        assert!((top(&slices[0]) - 0.1).abs() < 1e-9 && (top(&slices[16]) - 0.119).abs() < 1e-3);
        assert!(one(Form::Contour(&[])).iter().all(|solid| (top(solid) - 0.1).abs() < 1e-9));
    }

    #[test]
    fn tripod_stands_on_the_floor_below_camera() {
        let mut legs = Vec::new();
        let top = Point3::new(1.0, 2.0, 1.5);

        tripod(&mut legs, top);

        assert_eq!(legs.len(), 3);
        for leg in &legs {
            let Shape::Cylinder { length, .. } = leg.shape else { panic!("a leg is a rod") };
            let foot = leg.pose * Point3::new(0.0, 0.0, length);
            assert!(foot.z.abs() < 1e-9 && leg.pose * Point3::origin() == top, "{foot}");
            assert!(((foot - top).xy().norm() - 0.45).abs() < 1e-9, "{foot}");
        }
    }

    #[test]
    fn each_solid_is_attached_to_existing_frame() {
        let scenario = crate::tasks::read(Path::new("t.toml"), "", &[]).unwrap();
        let cell = &scenario.controller.cell;

        let solids = cell_solids(cell);

        assert!(solids.len() > 20);
        for solid in solids {
            assert!(solid.frame < FRAMES.len());
            assert!(solid.arm.is_none_or(|arm| arm < cell.arms.len()));
        }
    }
}
