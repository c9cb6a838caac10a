//! At which poses a calibration looks: who holds the cube, who moves, and where to.
//!
//! - in: the cell as believed, a camera's believed place, how many views, a seed
//! - out: a [`Plan`]: joint positions in an order in which each is next to the one before

use crate::cell::{Camera, Cell, Mount};
use crate::cube::{Axis, Face};
use crate::motion::{Depth, JointPositions};
use crate::reach::MeetingTable;
use crate::spatial::{Pose, pose_from_axes};
use crate::tasks::cube::hold::Hold;
use crate::vision::Lens;
use crate::vision::calibration::{Rig, Setup};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

/// Poses are drawn this often for each that is wanted.
const TRIES: usize = 4000;
/// Distance between a camera in a hand and the cube at which it works (m).
const HAND_DISTANCE: f64 = 0.2;
/// Motors keep this share of their range from their limits.
const MARGIN: f64 = 0.02;

/// Who moves what where.
pub(super) struct Plan {
    pub(super) rig: Rig,
    /// Arm with the cube, arm that moves, and its poses in their order.
    pub(super) holder: usize,
    pub(super) mover: usize,
    pub(super) poses: Vec<JointPositions>,
    /// Where both arms are at first.
    pub(super) starts: [JointPositions; 2],
    /// How the cube lies in the holder's hand.
    pub(super) tool_from_cube: Pose,
    pub(super) guess: Setup,
    pub(super) distance: f64,
}

/// The cube is held by one layer, so that little of it is covered.
fn held(edge: f64) -> Pose {
    let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
    hold.cube_from_tool(false, edge).inverse()
}

/// Joint positions for a flange, with room to the limits; the nearest to `near`.
fn reach(
    cell: &Cell,
    arm: usize,
    world_from_flange: &Pose,
    near: &JointPositions,
) -> Option<JointPositions> {
    let arm = &cell.arms[arm];
    let base_from_flange = arm.world_from_base.inverse() * world_from_flange;
    let room = |joints: &JointPositions| {
        let motors = arm.model.motors(joints).0;
        motors.iter().zip(&arm.model.motor_limits).skip(usize::from(!arm.model.has_track)).all(
            |(m, (low, high))| {
                *m > low + MARGIN * (high - low) && *m < high - MARGIN * (high - low)
            },
        )
    };
    let apart = |joints: &JointPositions| -> f64 {
        joints.0.iter().zip(near.0).map(|(a, b)| (a - b).abs()).sum()
    };
    let solutions = arm.model.branches(&base_from_flange, near.0[0]);
    let fitting = solutions.as_slice().iter().filter(|j| room(j) && arm.model.check(j).is_ok());
    fitting.min_by(|a, b| apart(a).total_cmp(&apart(b))).copied()
}

/// Every second view is so near to where the hand brings the cube (m), and to how it is taken there
/// (rad), each axis: an arm sags otherwise elsewhere, and it is there that camera and arm must
/// agree.
const NEAR: f64 = 0.06;
const TURNED: f64 = 0.35;

/// Least height of the cube above the table while it is shown (m).
const ABOVE_TABLE: f64 = 0.15;

/// How the hand stands when it takes a cube.
fn take_rotation(cell: &Cell) -> UnitQuaternion<f64> {
    let (z, y) = cell.taking();
    pose_from_axes(y.cross(&z), y, z, Point3::origin()).rotation
}

/// How many views are drawn, and from which seed.
#[derive(Clone, Copy)]
pub(super) struct Draw {
    pub(super) views: usize,
    pub(super) seed: u64,
}

/// Returns whether a camera sees too little of the cube: from behind the hand, or so frontally that
/// one face hides the others. Two faces tell more than one.
fn hides_faces(world_from_camera: &Pose, world_from_cube: &Pose, world_from_tool: &Pose) -> bool {
    let (centre, eye) = (world_from_cube.translation.vector, world_from_camera.translation.vector);
    let sight = (centre - eye).normalize();
    let sight = world_from_camera.rotation.inverse() * sight;
    let towards = world_from_tool.rotation.inverse() * (world_from_camera.rotation * -sight);
    let oblique =
        (world_from_cube.rotation.inverse() * (world_from_camera.rotation * sight)).amax();
    towards.z < -0.25 || oblique > 0.97
}

/// Plans the views in which the track arm shows the cube to a camera that stands.
pub(super) fn standing_plan(
    cell: &Cell,
    camera: &Camera,
    world_from_camera: &Pose,
    draw: Draw,
) -> Option<Plan> {
    let (holder, edge) = (0, cell.cube.edge);
    let arm = &cell.arms[holder];
    let tool_from_cube = held(edge);
    let lens = Lens::from(&camera.intrinsics);
    let (width, height) = (f64::from(camera.intrinsics.width), f64::from(camera.intrinsics.height));
    // From twice the working distance to where the cube fills a third of the picture.
    let near = 3.0 * edge * lens.focal.0 / width;
    let working = (cell.hand.world_from_cube.translation.vector
        - world_from_camera.translation.vector)
        .norm()
        .max(near);
    let mut random = Pcg64::seed_from_u64(draw.seed ^ 0x6361_6c69);
    let mut poses: Vec<JointPositions> = Vec::new();
    let mut reference = arm.start;
    for _ in 0..TRIES * draw.views {
        if poses.len() == draw.views {
            break;
        }
        let pixel =
            (random.random_range(0.12..0.88) * width, random.random_range(0.15..0.85) * height);
        let distance = working * random.random_range(0.7..1.15);
        let turn = Vector3::from_fn(|_, _| random.random_range(-1.0..1.0));
        let track = random.random_range(0.0..1.0);
        let Some((x, y)) = lens.unproject(pixel) else { continue };
        let sight = Vector3::new(x, y, 1.0).normalize();
        let mut centre = world_from_camera * Point3::from(sight * distance);
        let mut turned = UnitQuaternion::from_scaled_axis(turn * std::f64::consts::PI);
        if poses.len() % 2 == 1 {
            let beside = Vector3::from_fn(|_, _| random.random_range(-NEAR..NEAR));
            centre = (cell.hand.world_from_cube.translation.vector + beside).into();
            // Above a table, as low as the hand may go with it.
            centre.z = centre.z.max(cell.table_height + ABOVE_TABLE + beside.z.abs());
            turned = UnitQuaternion::from_scaled_axis(turn * TURNED)
                * take_rotation(cell)
                * tool_from_cube.rotation;
        }
        let world_from_cube = Pose::from_parts(centre.coords.into(), turned);
        let world_from_tool = world_from_cube * tool_from_cube.inverse();
        if hides_faces(world_from_camera, &world_from_cube, &world_from_tool)
            || centre.z < cell.table_height + ABOVE_TABLE
        {
            continue;
        }
        let (low, high) = arm.model.joint_limits[0];
        reference.0[0] = low + 0.05 + track * (high - low - 0.1);
        let flange = world_from_tool * arm.flange_from_tool.inverse();
        poses.extend(reach(cell, holder, &flange, &reference));
    }
    let poses = in_order(poses);
    let first = *poses.first()?;
    Some(Plan {
        rig: Rig::Standing,
        holder,
        mover: holder,
        poses,
        starts: [first, cell.arms[1].start],
        tool_from_cube,
        guess: Setup { lens, camera: *world_from_camera, cube: tool_from_cube, edge },
        distance: working,
    })
}

/// The other arm holds the cube still, and the camera looks at its free face from many sides.
pub(super) fn in_hand_plan(
    cell: &Cell,
    arm: usize,
    flange_from_camera: &Pose,
    meetings: &MeetingTable,
    draw: Draw,
) -> Option<Plan> {
    let (holder, edge) = (1 - arm, cell.cube.edge);
    let meeting = meetings.views[holder].iter().flatten().next()?;
    let starts = [meeting.track, meeting.postument];
    let world_from_flange = |arm: usize| {
        cell.arms[arm].world_from_base * cell.arms[arm].model.base_from_flange(&starts[arm])
    };
    let tool_from_cube = held(edge);
    let world_from_cube =
        world_from_flange(holder) * cell.arms[holder].flange_from_tool * tool_from_cube;
    let world_from_camera = world_from_flange(arm) * flange_from_camera;
    let camera = cell.cameras.iter().find(|c| {
        matches!(c.mount, Mount::Flange { arm: a, flange_from_camera: f } if a == arm && f == *flange_from_camera)
    })?;
    let centre = Point3::from(world_from_cube.translation.vector);
    let back = world_from_camera.translation.vector - centre.coords;
    let mut random = Pcg64::seed_from_u64(draw.seed ^ 0x6861_6e64);
    let mut poses = vec![starts[arm]];
    for _ in 0..TRIES * draw.views {
        if poses.len() == draw.views {
            break;
        }
        let mut within = |size: f64| random.random_range(-size..size);
        let swing =
            UnitQuaternion::from_scaled_axis(Vector3::new(within(0.5), within(0.5), within(0.5)));
        let eye = centre + swing * back * (1.0 + within(0.18));
        // The cube stands anywhere in the picture, and the picture is rolled.
        let aim = centre + Vector3::new(within(0.03), within(0.03), within(0.03));
        let z = (aim - eye).normalize();
        let x = world_from_camera.rotation * Vector3::x();
        let x = (x - z * x.dot(&z)).normalize();
        let roll = UnitQuaternion::from_scaled_axis(z * within(0.6));
        let (x, y) = (roll * x, roll * z.cross(&x));
        let flange = pose_from_axes(x, y, z, eye) * flange_from_camera.inverse();
        poses.extend(reach(cell, arm, &flange, &starts[arm]).filter(|joints| {
            // A small motion of the hand is one of the joints, too: no other branch.
            joints.0.iter().zip(starts[arm].0).all(|(a, b)| (a - b).abs() < 1.2)
        }));
    }
    let camera_frame = cell.arms[arm].world_from_base.inverse() * world_from_cube;
    Some(Plan {
        rig: Rig::InHand,
        holder,
        mover: arm,
        poses: in_order(poses),
        starts,
        tool_from_cube,
        guess: Setup {
            lens: Lens::from(&camera.intrinsics),
            camera: *flange_from_camera,
            cube: camera_frame,
            edge,
        },
        distance: HAND_DISTANCE,
    })
}

/// Each pose next to the one before.
fn in_order(mut poses: Vec<JointPositions>) -> Vec<JointPositions> {
    for i in 1..poses.len() {
        let apart = |joints: &JointPositions| {
            let last = &poses[i - 1].0;
            joints.0.iter().zip(last).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
        };
        let nearest =
            (i..poses.len()).min_by(|a, b| apart(&poses[*a]).total_cmp(&apart(&poses[*b])));
        poses.swap(i, nearest.unwrap_or(i));
    }
    poses
}
