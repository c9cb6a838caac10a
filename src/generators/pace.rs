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
        // At full pace the pose is kept exactly. The other motions come from position control
        // alone.
        Motion::Pose(_) | Motion::Hold | Motion::MotorsBy(_) | Motion::Joints(_) => {}
    }
    Next::Go(command)
}
