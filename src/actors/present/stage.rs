//! The stage of a run: the facts about its cell and scenario that do not change during its task.
//!
//! - in: the scenario
//! - out: the [`Stage`] for the UIs, and the named poses of an arm

use crate::cell::{Arm, Camera, Cell, Mount};
use crate::cube::Keeper;
use crate::motion::{JointPositions, MotorPositions};
use crate::operator::parameter::{AllBounds, DECLARED, Declaration};
use crate::operator::{
    ArmStage, CameraStage, Form, Limits, ObjectStage, ParameterStage, Stage, cell_solids,
    object_solids,
};
use crate::scenario::Scenario;
use crate::scenario::objects::{ObjectKeys, ObjectKind};
use crate::spatial::Pose;

/// Returns the facts about a scenario and its cell that the user interfaces need and that do not
/// change during a run.
pub(crate) fn stage(scenario: &Scenario) -> Stage {
    let config = &scenario.controller;
    let cell = &config.cell;
    let arm = |arm: &Arm| ArmStage {
        name: arm.name.clone(),
        has_track: arm.model.has_track,
        joint_limits: arm.model.joint_limits,
        motor_limits: arm.model.motor_limits,
        opening: arm.gripper.opening,
        poses: poses(arm).into_iter().map(|p| p.0).collect(),
    };
    // Under a task without a hand-over the zone of the hand would only mislead.
    let hands_over = config.task.properties.hands_over;
    Stage {
        title: scenario.path.display().to_string(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        task: config.task.word().to_owned(),
        seed: scenario.seed,
        pace: scenario.pace.word().to_owned(),
        coordination: config.coordination.word().to_owned(),
        plant: if scenario.bridge.kind.is_hardware() { "hardware" } else { "simulated plant" }
            .to_owned(),
        arms: cell.arms.iter().map(arm).collect(),
        cameras: cameras(cell),
        solids: cell_solids(cell),
        objects: scenario.objects().iter().map(object).collect(),
        edge: cell.cube.edge,
        hand_zone: (hands_over && cell.keeper == Keeper::Person)
            .then_some(cell.hand.world_from_cube),
        limits: Limits {
            force: config.control.force_limit,
            torque: config.control.torque_limit,
            period: scenario.real_time.period,
        },
        parameters: parameters(&config.bounds),
    }
}

/// Returns the parameters that the operator may change within these bounds.
fn parameters(bounds: &AllBounds) -> Vec<ParameterStage> {
    let parameter = |declared: &Declaration| ParameterStage {
        parameter: declared.parameter,
        unit: declared.unit.to_owned(),
        meaning: declared.meaning.to_owned(),
        rate: declared.rate,
        bounds: bounds[declared.parameter],
    };
    DECLARED.iter().map(parameter).collect()
}

/// Returns an object of a scenario with the solids that draw it.
fn object(keys: &ObjectKeys) -> ObjectStage {
    let form = match keys.shape {
        ObjectKind::Box | ObjectKind::Bar => Form::Box,
        ObjectKind::Cylinder => Form::Cylinder,
        // A contour that the seed draws is not known here, and appears flat.
        ObjectKind::Surface => Form::Contour(keys.points.as_deref().unwrap_or_default()),
    };
    let fixed = keys.is_fixed();
    let solids = object_solids(form, keys.size, fixed);
    ObjectStage { name: keys.name.clone(), fixed, pose: keys.pose(), solids }
}

/// Returns the cameras of a cell, each with its pose in the world or on its arm's flange.
pub(super) fn cameras(cell: &Cell) -> Vec<CameraStage> {
    let camera = |camera: &Camera| {
        let (arm, pose): (Option<usize>, Pose) = match camera.mount {
            Mount::World { world_from_camera } => (None, world_from_camera),
            Mount::Flange { arm, flange_from_camera } => (Some(arm), flange_from_camera),
        };
        let size = (camera.intrinsics.width, camera.intrinsics.height);
        CameraStage { name: camera.name.clone(), arm, pose, size }
    };
    cell.cameras.iter().map(camera).collect()
}

/// Returns the poses to which the operator can send an arm by hand: the name and the joint
/// positions of each.
pub(crate) fn poses(arm: &Arm) -> Vec<(String, JointPositions)> {
    let mut poses = vec![("start".to_owned(), arm.start)];
    let track = arm.start.0[0];
    let front = [track, 0.0, -1.57, 0.0, 1.57, 1.57, -1.57];
    poses.push(("front".to_owned(), JointPositions(front)));
    let sync = MotorPositions(arm.model.sync);
    // A model whose synchronisation position no joints reach has no pose of that name.
    poses.extend(arm.model.joints(&sync).ok().map(|at| ("synchronisation".to_owned(), at)));
    // "front" is one constant for all arms, and may lie outside the limits of some.
    poses.retain(|(_, joints)| arm.model.check(joints).is_ok());
    poses
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn stage_has_objects_of_scenario() {
        let text = "task = \"idle\"\n[[object]]\nname = \"can\"\nshape = \"cylinder\"\n\
                    xyz_mm = [900, 1000, 1500]\n[[object]]\nname = \"hill\"\n\
                    shape = \"surface\"\npoints_mm = [[-30, 0], [30, 5]]\n\
                    xyz_mm = [900, 500, 1500]\n";
        let scenario = crate::tasks::read(Path::new("t.toml"), text, &[]).unwrap();

        let [can, hill] = &stage(&scenario).objects[..] else { panic!("two objects") };

        assert!(!can.fixed && hill.fixed);
        assert_eq!((can.name.as_str(), can.solids.len()), ("can", 1));
        assert_eq!(can.pose, Pose::translation(0.9, 1.0, 1.5));
        assert!(hill.solids.len() > 10, "the contour is drawn in slices");
    }
}
