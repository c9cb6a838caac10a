//! The places where two arms can meet: for each relative orientation of the tools, joint positions
//! of both arms. Paths between them, and a [`guard`] over all motions, are here as well.
//!
//! The table is computed once for a cell, as the controller believes the cell to be. Tasks receive
//! it as data, since they know no kinematics.
//!
//! | word | meaning |
//! |---|---|
//! | track, postument | the arm on a linear track (arm 0), the arm on a fixed base (arm 1) |
//! | meeting | joint positions of both arms in which both hands work at one cube |
//! | newcomer, holder | the arm whose hand is free, the arm whose hand holds the cube |
//! | separation | distance by which the track retracts between two meetings |
//!
//! - in: the [`Cell`](crate::cell::Cell), [`ReachSettings`]
//! - out: [`MeetingTable`], equal for equal inputs (seeded search)

mod bodies;
mod example;
mod fold;
pub mod guard;
mod meeting;
mod motors;
pub mod pairs;
mod search;
mod settings;
mod stance;
mod way;
mod way_finder;
mod ways;

pub use example::example_cell;
pub use fold::Fold;
pub use meeting::{Meeting, MeetingTable, meeting_place};
pub use settings::ReachSettings;
pub use way::MeetingPath;
pub use way_finder::WayFinder;

/// The 24 rotations and their order, as indices of [`MeetingTable::grasps`].
pub use crate::cube::{rotation_index, rotations};

#[cfg(test)]
mod tests {
    use super::bodies::{Bodies, at_the_cube, newcomer_apart};
    use super::ways::way_clearance;
    use super::*;
    use crate::cell::{Arm, Cell, Mount};
    use crate::motion::JointPositions;
    use crate::spatial::Pose;
    use nalgebra::{Point3, UnitQuaternion, Vector3};
    use std::sync::LazyLock;

    static CELL: LazyLock<Cell> = LazyLock::new(example_cell);
    static SETTINGS: LazyLock<ReachSettings> = LazyLock::new(ReachSettings::default);
    static TABLE: LazyLock<MeetingTable> =
        LazyLock::new(|| MeetingTable::compute(&CELL, &SETTINGS));

    /// Returns the pose of an arm's tool in the world.
    fn world_from_tool(arm: &Arm, joints: &JointPositions) -> Pose {
        arm.world_from_base * arm.model.base_from_flange(joints) * arm.flange_from_tool
    }

    /// Iterates over all meetings of the example cell: the grasps, then the views.
    fn meetings() -> impl Iterator<Item = &'static Meeting> {
        TABLE.grasps.iter().flatten().chain(TABLE.views.iter().flatten().flatten())
    }

    /// Returns the largest difference between elements of two poses' matrices (m or 1).
    fn difference(a: &Pose, b: &Pose) -> f64 {
        (a.to_homogeneous() - b.to_homogeneous()).amax()
    }

    #[test]
    fn rotation_index_finds_each_distinct_rotation() {
        let all = rotations();

        for (i, a) in all.iter().enumerate() {
            assert_eq!(rotation_index(a), i);
            let tilted = a * UnitQuaternion::from_euler_angles(0.2, -0.2, 0.2);
            assert_eq!(rotation_index(&tilted), i);
            for b in &all[..i] {
                assert!(a.angle_to(b) > 1.5);
            }
        }
    }

    /// A grasp is possible unless both palms are on one face of the cube or the fingers of the two
    /// hands would cross.
    #[test]
    fn search_finds_all_possible_grasps_and_views() {
        let (grasps, views) = TABLE.found();

        assert_eq!((grasps, views), (16, 6));
        for (rotation, slot) in rotations().iter().zip(&TABLE.grasps) {
            let (y, z) = (rotation * Vector3::y(), rotation * Vector3::z());
            let one_palm = z.z > 0.5;
            let crossing_fingers = z.y.abs() > 0.5 && y.z.abs() > 0.5;
            assert_eq!(slot.is_none(), one_palm || crossing_fingers, "{rotation}");
        }
    }

    #[test]
    fn computing_meetings_twice_gives_equal_tables() {
        assert_eq!(MeetingTable::compute(&CELL, &SETTINGS), *TABLE);
    }

    #[test]
    fn meeting_joints_give_nominal_tool_poses() {
        let [track, postument] = [&CELL.arms[0], &CELL.arms[1]];
        for meeting in meetings() {
            let world_from_track = world_from_tool(track, &meeting.track);
            let world_from_postument = world_from_tool(postument, &meeting.postument);

            let found = world_from_track.inverse() * world_from_postument;

            assert!(difference(&found, &meeting.track_from_postument) < 1e-9);
            let back = Pose::translation(0.0, 0.0, -SETTINGS.back);
            let track_back = world_from_tool(track, &meeting.track_back);
            assert!(difference(&track_back, &(world_from_track * back)) < 1e-9);
            let postument_back = world_from_tool(postument, &meeting.postument_back);
            assert!(difference(&postument_back, &(world_from_postument * back)) < 1e-9);
        }
    }

    #[test]
    fn grasp_puts_both_tools_at_one_cube() {
        let into = Point3::new(0.0, 0.0, CELL.cube.edge / 3.0);
        for (rotation, grasp) in rotations().iter().zip(&TABLE.grasps) {
            let Some(grasp) = grasp else { continue };

            let pose = grasp.track_from_postument;

            assert!(pose.rotation.angle_to(rotation) < 1e-9);
            assert!((pose * into - into).norm() < 1e-9);
        }
    }

    #[test]
    fn camera_faces_centre_of_viewed_cube_side() {
        let sides = [Vector3::z(), Vector3::x(), -Vector3::x()];
        for holder in 0..2 {
            let viewer = 1 - holder;
            let camera = CELL.cameras.iter().find_map(|c| match c.mount {
                Mount::Flange { arm, flange_from_camera } if arm == viewer => {
                    Some(flange_from_camera)
                }
                _ => None,
            });
            for (normal, view) in sides.iter().zip(&TABLE.views[holder]) {
                let view = view.unwrap();
                let joints = [view.track, view.postument];
                let world_from = |arm: usize| world_from_tool(&CELL.arms[arm], &joints[arm]);
                let world_from_camera = world_from(viewer)
                    * CELL.arms[viewer].flange_from_tool.inverse()
                    * camera.unwrap();
                let edge = CELL.cube.edge;

                let face = Point3::from(Vector3::z() * (edge / 3.0) + normal * (edge / 2.0));
                let seen = world_from_camera.inverse() * world_from(holder) * face;
                let towards =
                    world_from_camera.inverse_transform_vector(&(world_from(holder) * normal));

                assert!((seen - Point3::new(0.0, 0.0, SETTINGS.view_distance)).norm() < 1e-9);
                assert!((towards + Vector3::z()).norm() < 1e-9);
            }
        }
    }

    #[test]
    fn meeting_joints_stay_within_limits_after_small_shifts() {
        for meeting in meetings() {
            for (arm, at, back) in [
                (&CELL.arms[0], meeting.track, meeting.track_back),
                (&CELL.arms[1], meeting.postument, meeting.postument_back),
            ] {
                let model = &arm.model;
                assert_eq!(model.check(&at), Ok(()));
                assert_eq!(model.check(&back), Ok(()));
                assert!(at.0[5].sin().abs() > 0.25 && at.0[5].sin() * back.0[5].sin() > 0.0);
                let flange = model.base_from_flange(&at);
                for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
                    for way in [axis, -axis] {
                        let shift = nalgebra::Translation3::from(SETTINGS.shift * way);
                        let there = model.inverse(&(flange * shift), &at).unwrap();
                        assert_eq!(model.check(&there), Ok(()));
                    }
                }
            }
            let apart = meeting.track.0[0] - SETTINGS.separation;
            assert!(apart >= 0.0 && meeting.track_back.0[0] == meeting.track.0[0]);
        }
    }

    /// Each hand can turn a layer by a quarter in both directions, and by a half turn in at least
    /// one.
    #[test]
    fn grasps_allow_quarter_and_half_turns() {
        use std::f64::consts::{FRAC_PI_2, PI};
        for grasp in TABLE.grasps.iter().flatten() {
            for (arm, places, (down, up)) in [
                (&CELL.arms[0], [grasp.track, grasp.track_back], grasp.track_roll),
                (&CELL.arms[1], [grasp.postument, grasp.postument_back], grasp.postument_roll),
            ] {
                assert!(down < -FRAC_PI_2 && up > FRAC_PI_2, "{down}, {up}");
                assert!(down < -PI || up > PI, "{down}, {up}");
                for (roll, fits) in [
                    (down + 1e-6, true),
                    (up - 1e-6, true),
                    (down - 1e-3, false),
                    (up + 1e-3, false),
                ] {
                    // A hand retracts with the roll in which a turn has left it.
                    let rolls = |mut joints: JointPositions| {
                        joints.0[6] += roll;
                        arm.model.check(&joints).is_ok()
                    };
                    assert_eq!(places.into_iter().all(rolls), fits);
                }
            }
        }
    }

    /// Returns the bodies of both arms at these joint positions.
    fn bodies(joints: [JointPositions; 2]) -> [Bodies; 2] {
        [0, 1].map(|arm: usize| Bodies::of(&CELL, &CELL.arms[arm], &joints[arm]))
    }

    #[test]
    fn arms_keep_clearance_at_and_between_meetings() {
        for (number, a) in meetings().enumerate() {
            assert!(a.clearance >= SETTINGS.clearance);
            let [track, postument] = bodies([a.track, a.postument]);
            // The meetings are the grasps, three views with the track as the holder, three others.
            let at = match number.checked_sub(TABLE.found().0) {
                None => at_the_cube(&track, &postument),
                Some(view) => newcomer_apart(usize::from(view < 3), &track, &postument),
            };
            assert!(at >= a.clearance, "{at} {}", a.clearance);
            // A hand of a grasp retracts, and then the track separates.
            for newcomer in (0..2).filter(|_| number < TABLE.found().0) {
                let [track, postument] = bodies(a.short_of(newcomer));
                for by in [0.0, 0.5, 1.0] {
                    let away = -by * SETTINGS.separation * Vector3::y();
                    let apart = newcomer_apart(newcomer, &track.moved(away), &postument);
                    assert!(apart >= SETTINGS.clearance, "{apart}");
                }
            }
            for b in meetings() {
                let clearance = way_clearance(&CELL, SETTINGS.separation, a, b);
                assert!(clearance >= SETTINGS.clearance, "{clearance}");
                // Half-way, with either hand as the free one.
                for newcomer in 0..2 {
                    let (from, to) = (a.short_of(newcomer), b.short_of(newcomer));
                    let mut middle = [0, 1].map(|arm: usize| from[arm].towards(&to[arm], 0.5));
                    middle[0].0[0] -= SETTINGS.separation;
                    let [track, postument] = bodies(middle);
                    let apart = newcomer_apart(newcomer, &track, &postument);
                    let own = track.own().min(postument.own());
                    assert!(apart.min(own) >= clearance - 1e-9, "{apart} {own}");
                }
            }
        }
    }

    #[test]
    fn cell_without_track_or_partner_has_no_meetings() {
        let mut cell = example_cell();
        cell.arms.reverse();
        assert_eq!(MeetingTable::compute(&cell, &SETTINGS).found(), (0, 0));

        cell.arms.truncate(1);
        assert_eq!(MeetingTable::compute(&cell, &SETTINGS).found(), (0, 0));
    }
}
