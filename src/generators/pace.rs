//! The pace of a motion: commands that are slowed down while a pause brings the arm to rest.
//!
//! - in: a command, and the pace of [`Inputs`]
//! - out: the slower command

use super::inputs::Inputs;
use super::outcome::Next;
use crate::motion::{Direction, Motion};
use crate::spatial::Pose;

/// Slows a command down by the factor `inputs.pace` (0..=1), which multiplies the velocities of a
/// task motion and the step from the present set pose to the next one. The end of a behaviour stays
/// as it is.
pub(super) fn slowed(next: Next, inputs: &Inputs<'_>) -> Next {
    let Next::Go(mut command) = next else { return next };
    match &mut command.motion {
        // A direction that only seeks a force is not slowed: the force must not depend on a pause.
        Motion::Task { directions, .. } => {
            for direction in directions {
                if let Direction::Unguarded { velocity } | Direction::Guarded { velocity, .. } =
                    direction
                {
                    *velocity *= inputs.pace;
                }
            }
        }
        // The tool makes only a part of the step from the present set pose.
        Motion::Pose(pose) if inputs.pace < 1.0 => {
            let from = inputs.arm.desired_base_from_tool;
            *pose = Pose::from_parts(
                from.translation.vector.lerp(&pose.translation.vector, inputs.pace).into(),
                // A registered generator may ask for half a turn, which has no shortest way.
                from.rotation.try_slerp(&pose.rotation, inputs.pace, 0.0).unwrap_or(pose.rotation),
            );
        }
        // The joints make only a part of the step as well.
        Motion::Joints(joints) if inputs.pace < 1.0 => {
            *joints = inputs.arm.desired_joints.towards(joints, inputs.pace);
        }
        // At full pace the set values are kept exactly. No generator orders steps of motors.
        Motion::Pose(_) | Motion::Joints(_) | Motion::Hold | Motion::MotorsBy(_) => {}
    }
    Next::Go(command)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{ArmState, JointPositions, MoveCommand};

    #[test]
    fn joints_make_only_the_paced_part() {
        let arm = ArmState::default();
        let target = JointPositions([0.2; 7]);
        let step = |pace: f64| {
            let motion = Motion::Joints(target);
            let command = MoveCommand { motion, periods: 8, jaw: None };
            let inputs = Inputs { arm: &arm, target: None, reading: None, period: 0, pace };
            match slowed(Next::Go(command), &inputs) {
                Next::Go(MoveCommand { motion: Motion::Joints(joints), .. }) => joints.0[3],
                other => panic!("{other:?}"),
            }
        };

        assert_eq!(step(1.0), 0.2);
        assert!((step(0.25) - 0.05).abs() < 1e-12, "{}", step(0.25));
        assert_eq!(step(0.0), 0.0);
    }
}
