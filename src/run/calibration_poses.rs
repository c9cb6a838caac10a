//! Poses of a calibration: which arm holds the cube, which arm moves, and where to.
//!
//! Poses are drawn from a seeded generator, and only those that the arm reaches are kept.
//!
//! - in: the cell as believed, a camera's believed place, the number of views, a seed
//! - out: a [`Plan`]: joint positions, each followed by the nearest of the remaining ones

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

/// Largest number of poses that are drawn for each wanted view.
const TRIES: usize = 4000;
/// Working distance of a camera in a hand from the cube (m).
const HAND_DISTANCE: f64 = 0.2;
/// Distance of the motors from their limits, as a share of their range.
const MARGIN: f64 = 0.02;

/// Plan of a calibration.
pub(super) struct Plan {
    /// The part that moves: the cube or the camera.
    pub(super) rig: Rig,
    /// Index of the arm that holds the cube.
    pub(super) holder: usize,
    /// Index of the arm that moves.
    pub(super) mover: usize,
    /// Poses of the moving arm, in their order.
    pub(super) poses: Vec<JointPositions>,
    /// Joint positions of both arms at the beginning.
    pub(super) starts: [JointPositions; 2],
    /// Pose of the cube in the holder's hand.
    pub(super) tool_from_cube: Pose,
    /// First guess of the adjustment.
    pub(super) guess: Setup,
    /// Working distance of the camera (m).
    pub(super) distance: f64,
}

/// Returns the `tool_from_cube` of a cube that a hand holds by one layer, so that it covers little
/// of the cube.
fn held(edge: f64) -> Pose {
    let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
    hold.cube_from_tool(false, edge).inverse()
}

/// Returns the joint positions of an arm for a pose of its flange: those nearest to `near` among
/// the ones at least [`MARGIN`] from the limits of all motors; `None` if there are none.
fn reach(
    cell: &Cell,
    arm: usize,
    world_from_flange: &Pose,
    near: &JointPositions,
) -> Option<JointPositions> {
    let arm = &cell.arms[arm];
    let base_from_flange = arm.world_from_base.inverse() * world_from_flange;
    // An arm on a fixed base has no motor 0.
    let room = |joints: &JointPositions| {
        let motors = arm.model.motors(joints).0;
        motors.iter().zip(&arm.model.motor_limits).skip(usize::from(!arm.model.has_track)).all(
            |(m, (low, high))| {
                *m > low + MARGIN * (high - low) && *m < high - MARGIN * (high - low)
            },
        )
    };
    // The track's metres count like radians: 1 m is as far as 1 rad.
    let apart = |joints: &JointPositions| -> f64 {
        joints.0.iter().zip(near.0).map(|(a, b)| (a - b).abs()).sum()
    };
    let solutions = arm.model.branches(&base_from_flange, near.0[0]);
    let fitting = solutions.as_slice().iter().filter(|j| room(j) && arm.model.check(j).is_ok());
    fitting.min_by(|a, b| apart(a).total_cmp(&apart(b))).copied()
}

/// Largest distance, in each axis, of the cube from the place of the hand-over in every second view
/// (m). Sag depends on the pose of the arm, and camera and arm must agree where the cube is taken.
const NEAR: f64 = 0.06;
/// Largest rotation, about each axis, of the cube in these views against the hold in which it is
/// taken (rad).
const TURNED: f64 = 0.35;

/// Least height of the cube above the table while it is shown (m).
const ABOVE_TABLE: f64 = 0.15;

/// Returns the orientation of the tool in the world when it takes the cube from the operator.
fn take_rotation(cell: &Cell) -> UnitQuaternion<f64> {
    let (z, y) = cell.taking();
    pose_from_axes(y.cross(&z), y, z, Point3::origin()).rotation
}

/// Number of views, and the seed of the draw.
#[derive(Clone, Copy)]
pub(super) struct Draw {
    /// Number of views.
    pub(super) views: usize,
    /// Seed of the scenario.
    pub(super) seed: u64,
}

/// Returns whether a camera sees too little of the cube: it looks from behind the hand, or so
/// frontally that one face hides the others. Two faces determine the pose better than one.
fn hides_faces(world_from_camera: &Pose, world_from_cube: &Pose, world_from_tool: &Pose) -> bool {
    let (centre, eye) = (world_from_cube.translation.vector, world_from_camera.translation.vector);
    let sight = (centre - eye).normalize();
    let sight = world_from_camera.rotation.inverse() * sight;
    let towards = world_from_tool.rotation.inverse() * (world_from_camera.rotation * -sight);
    let oblique =
        (world_from_cube.rotation.inverse() * (world_from_camera.rotation * sight)).amax();
    // 0.25: 14 degrees behind the plane of the palm. 0.97: 14 degrees off a face's normal.
    towards.z < -0.25 || oblique > 0.97
}

/// Returns the working distance of a standing camera (m): its distance from the hand-over, but at
/// least that at which the cube's edge spans a third of the picture's `width` (px).
fn working_distance(cell: &Cell, lens: &Lens, width: f64, world_from_camera: &Pose) -> f64 {
    let near = 3.0 * cell.cube.edge * lens.focal.0 / width;
    let hand = cell.hand.world_from_cube.translation.vector;
    (hand - world_from_camera.translation.vector).norm().max(near)
}

/// Plans the poses in which the track arm shows the cube to a standing camera; `draw` is their
/// number and the seed. Returns `None` if no pose is found.
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
    let working = working_distance(cell, &lens, width, world_from_camera);
    let mut random = Pcg64::seed_from_u64(draw.seed ^ 0x6361_6c69);
    let mut poses: Vec<JointPositions> = Vec::new();
    let mut reference = arm.start;
    for _ in 0..TRIES * draw.views {
        if poses.len() == draw.views {
            break;
        }
        // The cube is anywhere in the picture: the optics are estimated over all of it.
        let pixel =
            (random.random_range(0.12..0.88) * width, random.random_range(0.15..0.85) * height);
        let distance = working * random.random_range(0.7..1.15);
        let turn = Vector3::from_fn(|_, _| random.random_range(-1.0..1.0));
        let track = random.random_range(0.0..1.0);
        let Some((x, y)) = lens.unproject(pixel) else { continue };
        let sight = Vector3::new(x, y, 1.0).normalize();
        let mut centre = world_from_camera * Point3::from(sight * distance);
        let mut turned = UnitQuaternion::from_scaled_axis(turn * std::f64::consts::PI);
        // Every second view is near the hand-over instead.
        if poses.len() % 2 == 1 {
            let beside = Vector3::from_fn(|_, _| random.random_range(-NEAR..NEAR));
            centre = (cell.hand.world_from_cube.translation.vector + beside).into();
            // Above a table, the lowest height at which the hand may show the cube; `beside` still
            // spreads the heights.
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
        // The track's position is drawn too, so that the views have many configurations of the arm.
        let (low, high) = arm.model.joint_limits[0];
        reference.0[0] = low + 0.05 + track * (high - low - 0.1);
        let flange = world_from_tool * arm.flange_from_tool.inverse();
        poses.extend(reach(cell, holder, &flange, &reference));
    }
    let poses = in_order(poses);
    let first = *poses.first()?;
    Some(Plan {
        rig: Rig::Fixed,
        holder,
        mover: holder,
        poses,
        starts: [first, cell.arms[1].start],
        tool_from_cube,
        guess: Setup { lens, camera: *world_from_camera, cube: tool_from_cube, edge },
        distance: working,
    })
}

/// Plans the poses of `arm` in which the camera in its hand looks at the cube, which the other arm
/// holds still, from many sides; `draw` is their number and the seed. Returns `None` if the arms
/// have no meeting in which one hand looks at the other's cube, or no camera of the cell is mounted
/// there.
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
        matches!(
            c.mount,
            Mount::Flange { arm: a, flange_from_camera: f }
                if a == arm && f == *flange_from_camera
        )
    })?;
    let centre = Point3::from(world_from_cube.translation.vector);
    let back = world_from_camera.translation.vector - centre.coords;
    let mut random = Pcg64::seed_from_u64(draw.seed ^ 0x6861_6e64);
    let mut poses = vec![starts[arm]];
    for _ in 0..TRIES * draw.views {
        if poses.len() == draw.views {
            break;
        }
        // The views swing about the cube around the meeting's own view, whose place is reachable.
        let mut within = |size: f64| random.random_range(-size..size);
        let swing =
            UnitQuaternion::from_scaled_axis(Vector3::new(within(0.5), within(0.5), within(0.5)));
        let eye = centre + swing * back * (1.0 + within(0.18));
        // The cube is anywhere in the picture, and the picture is rolled.
        let aim = centre + Vector3::new(within(0.03), within(0.03), within(0.03));
        let z = (aim - eye).normalize();
        let x = world_from_camera.rotation * Vector3::x();
        let x = (x - z * x.dot(&z)).normalize();
        let roll = UnitQuaternion::from_scaled_axis(z * within(0.6));
        let (x, y) = (roll * x, roll * z.cross(&x));
        let flange = pose_from_axes(x, y, z, eye) * flange_from_camera.inverse();
        poses.extend(reach(cell, arm, &flange, &starts[arm]).filter(|joints| {
            // The views are close together, so a joint that is farther away than 1.2 rad belongs to
            // another branch: a large motion next to the other arm.
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

/// Sorts joint positions: each is followed by the nearest of the remaining ones. The distance of
/// two is that of the joint that moves farthest (m or rad).
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
