//! The URDF that the program writes, read by another crate, gives the poses that the controller
//! computes.

use nalgebra::{Isometry3, Matrix3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use rubik_robot::cell::Cell;
use rubik_robot::hw::plant::dynamics::{LINKS, link_frames};
use rubik_robot::motion::JointPositions;
use rubik_robot::record::urdf::{Model, xml};
use std::collections::BTreeMap;
use std::path::Path;

/// Returns the cell of a scenario without any keys.
fn cell() -> Cell {
    rubik_robot::tasks::read(Path::new("t.toml"), "", &[]).unwrap().controller.cell
}

/// Computes `root_from_link` of a link from the parsed URDF alone; `values` has the positions of
/// the joints by name (rad, m).
fn pose(robot: &urdf_rs::Robot, link: &str, values: &BTreeMap<String, f64>) -> Isometry3<f64> {
    let Some(joint) = robot.joints.iter().find(|j| j.child.link == link) else {
        return Isometry3::identity();
    };
    let (p, r) = (joint.origin.xyz.0, joint.origin.rpy.0);
    let origin = Isometry3::from_parts(
        Translation3::new(p[0], p[1], p[2]),
        UnitQuaternion::from_euler_angles(r[0], r[1], r[2]),
    );
    let value = values.get(&joint.name).copied().unwrap_or(0.0);
    let axis = Vector3::from(joint.axis.xyz.0);
    let moved = match joint.joint_type {
        urdf_rs::JointType::Revolute => {
            UnitQuaternion::from_axis_angle(&Unit::new_normalize(axis), value).into_isometry()
        }
        urdf_rs::JointType::Prismatic => {
            Isometry3::from_parts((value * axis).into(), UnitQuaternion::identity())
        }
        _ => Isometry3::identity(),
    };
    pose(robot, &joint.parent.link, values) * origin * moved
}

/// Rotation as an isometry without a translation.
trait IntoIsometry {
    fn into_isometry(self) -> Isometry3<f64>;
}

impl IntoIsometry for UnitQuaternion<f64> {
    fn into_isometry(self) -> Isometry3<f64> {
        Isometry3::from_parts(Translation3::identity(), self)
    }
}

/// Returns the largest difference between two elements of the 4 by 4 matrices (m, or no unit).
fn difference(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    (a.to_homogeneous() - b.to_homogeneous()).amax()
}

#[test]
fn urdf_tool_poses_match_the_controllers() {
    let cell = cell();
    let robot = urdf_rs::read_from_string(&xml(&Model::of(&cell, None, false))).unwrap();

    for (index, arm) in cell.arms.iter().enumerate() {
        for step in 0..7 {
            // Each axis is at another share of its range.
            let joints = JointPositions(std::array::from_fn(|axis| {
                let (low, high) = arm.model.joint_limits[axis];
                let share = f64::from((step * 3 + axis as u32 * 5) % 11) / 10.0;
                if axis == 0 && !arm.model.has_track { 0.0 } else { low + share * (high - low) }
            }));
            let mut values = BTreeMap::new();
            for (axis, q) in joints.0.iter().enumerate() {
                values.insert(format!("{}_link{axis}_joint", arm.name), *q);
            }

            let tool =
                arm.world_from_base * arm.model.base_from_flange(&joints) * arm.flange_from_tool;
            let found = pose(&robot, &format!("{}_tool", arm.name), &values);
            assert!(
                difference(&tool, &found) < 1e-9,
                "{index} {joints:?}: {}",
                difference(&tool, &found)
            );
        }
    }
}

#[test]
fn urdf_of_one_arm_has_its_joint_limits() {
    let cell = cell();
    for (index, arm) in cell.arms.iter().enumerate() {
        let robot = urdf_rs::read_from_string(&xml(&Model::of(&cell, Some(index), false))).unwrap();

        let moving = robot.joints.iter().filter(|j| j.joint_type == urdf_rs::JointType::Revolute);
        assert_eq!(moving.count(), 6);
        for axis in 1..7 {
            let name = format!("{}_link{axis}_joint", arm.name);
            let joint = robot.joints.iter().find(|j| j.name == name).unwrap();
            let (low, high) = arm.model.joint_limits[axis];
            assert!((joint.limit.lower - low).abs() + (joint.limit.upper - high).abs() < 1e-12);
        }
        let camera = robot.links.iter().filter(|l| l.name.ends_with("_optical"));
        assert_eq!(camera.count(), 1);
    }
}

/// Returns mass, centre and inertia that the URDF gives to a link.
fn inertial(robot: &urdf_rs::Robot, link: &str) -> (f64, Point3<f64>, Matrix3<f64>) {
    let link = robot.links.iter().find(|l| l.name == link).unwrap();
    let (own, i) = (&link.inertial, &link.inertial.inertia);
    assert_eq!(own.origin.rpy.0, [0.0; 3]);
    let moments = Matrix3::new(i.ixx, i.ixy, i.ixz, i.ixy, i.iyy, i.iyz, i.ixz, i.iyz, i.izz);
    (own.mass.value, Point3::from(own.origin.xyz.0), moments)
}

/// The total is the mass that the plant moves: its carriage if there is a track, and six links.
#[test]
fn urdf_masses_are_the_plants_and_possible() {
    let cell = cell();
    for (index, arm) in cell.arms.iter().enumerate() {
        let robot = urdf_rs::read_from_string(&xml(&Model::of(&cell, Some(index), false))).unwrap();

        let moved = robot.joints.iter().filter(|j| j.joint_type != urdf_rs::JointType::Fixed);
        let bodies: Vec<_> = moved.map(|j| inertial(&robot, &j.child.link)).collect();

        for (mass, _, inertia) in &bodies {
            let moments = inertia.symmetric_eigenvalues();
            assert!(*mass > 0.0 && moments.min() > 0.0, "{moments}");
            assert!(2.0 * moments.max() <= moments.sum() * (1.0 + 1e-12), "{moments}");
        }
        let total: f64 = robot.links.iter().map(|link| link.inertial.mass.value).sum();
        let first = usize::from(!arm.model.has_track);
        let wanted: f64 = LINKS[first..].iter().map(|link| link.mass).sum();
        assert!((total - wanted).abs() < 1e-9, "{total} {wanted}");
        assert_eq!(bodies.len(), LINKS.len() - first + 2, "each moving link has a mass");
    }
}

/// In any position the bodies are where the plant has them. The fingers are a part of the last one.
#[test]
fn urdf_bodies_are_where_the_plant_has_them() {
    let cell = cell();
    let robot = urdf_rs::read_from_string(&xml(&Model::of(&cell, None, false))).unwrap();
    for arm in &cell.arms {
        let joints = arm.start;
        let values: BTreeMap<String, f64> =
            (0..7).map(|axis| (format!("{}_link{axis}_joint", arm.name), joints.0[axis])).collect();
        let frames = link_frames(&arm.model, &joints);
        for (axis, link) in LINKS.iter().enumerate().take(6).skip(usize::from(!arm.model.has_track))
        {
            let name = format!("{}_link{axis}", arm.name);
            let (mass, centre, inertia) = inertial(&robot, &name);

            let (found, place) = (pose(&robot, &name, &values), arm.world_from_base * frames[axis]);
            let apart = found * centre - place * Point3::from(link.centre);
            let turned = |r: UnitQuaternion<f64>, i: Matrix3<f64>| {
                let r = r.to_rotation_matrix();
                r.matrix() * i * r.matrix().transpose()
            };
            let moments = Matrix3::from_diagonal(&Vector3::from(link.inertia));
            let other = turned(found.rotation, inertia) - turned(place.rotation, moments);
            assert!(apart.norm() < 1e-9 && mass == link.mass, "{name}: {apart}");
            assert!(other.amax() < 1e-9, "{name}: {other}");
        }
    }
}

#[test]
fn urdf_limits_are_those_of_motors_and_gears() {
    let cell = cell();
    let robot = urdf_rs::read_from_string(&xml(&Model::of(&cell, None, false))).unwrap();
    let limit = |name: &str| {
        let joint = robot.joints.iter().find(|j| j.name == format!("{name}_joint")).unwrap();
        (joint.limit.velocity, joint.limit.effort)
    };

    let (speed, effort) = limit("track_link0");
    let track = &cell.arms[0].model;
    assert!((speed - track.motor_speed_limit / track.gears[0]).abs() < 1e-6, "{speed}");
    assert!(effort > 1000.0, "{effort}");
    // Half of the speed of the opening, and the greatest grip.
    let (speed, effort) = limit("track_finger_left");
    assert!((0.01..0.1).contains(&speed) && effort == 60.0, "{speed} {effort}");
}
