//! The URDF that the program writes, read by another crate, gives the poses that the controller
//! computes.

use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion, Vector3};
use rubik_robot::cell::Cell;
use rubik_robot::motion::JointPositions;
use rubik_robot::record::urdf::{Model, xml};
use rubik_robot::scenario;
use std::collections::BTreeMap;
use std::path::Path;

fn cell() -> Cell {
    scenario::read(Path::new("t.toml"), "", &[]).unwrap().controller.cell
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

trait IntoIsometry {
    fn into_isometry(self) -> Isometry3<f64>;
}

impl IntoIsometry for UnitQuaternion<f64> {
    fn into_isometry(self) -> Isometry3<f64> {
        Isometry3::from_parts(Translation3::identity(), self)
    }
}

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
