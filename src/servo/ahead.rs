//! State of an arm as it will be near the end of a command, for an answer that leaves early.
//!
//! - in: the state now, the command under way, the number of periods that it has left
//! - out: the state with the set values of two periods before the end, as an answer in time has
//!   them; measured values stay those of now
//! - a position moves along its line, a velocity goes on; a force is expected to move nothing

use crate::kinematics::ArmModel;
use crate::motion::{ArmState, Direction, Frame, Motion, MoveCommand, PERIOD};
use crate::spatial::Pose;
use nalgebra::{Translation3, UnitQuaternion, Vector3};

/// Periods before the end of a command at which an answer in time leaves.
const NEAR_END: u64 = 2;
/// Angle below which two orientations are the same for the interpolation (rad).
const SAME: f64 = 1e-9;

/// Returns `state` with the set values that `command` will have reached two periods before its end,
/// if it has `left` periods to go.
#[must_use]
pub fn ahead(state: &ArmState, command: &MoveCommand, left: u64, model: &ArmModel) -> ArmState {
    let mut ahead = *state;
    // An arm that was refused its command stays where it is.
    if left <= NEAR_END || state.refused.is_some() {
        return ahead;
    }
    let periods = (left - NEAR_END) as f64;
    let share = periods / left as f64;
    let (from, set) = (&state.desired_base_from_tool, &mut ahead.desired_base_from_tool);
    match &command.motion {
        Motion::Hold | Motion::MotorsBy(_) => {}
        Motion::Joints(to) => {
            let flange_from_tool = model.base_from_flange(&state.desired_joints).inverse() * from;
            ahead.desired_joints = state.desired_joints.towards(to, share);
            *set = model.base_from_flange(&ahead.desired_joints) * flange_from_tool;
        }
        Motion::Pose(to) => {
            *set = from.try_lerp_slerp(to, share, SAME).unwrap_or(*to);
        }
        Motion::Task { frame, directions } => {
            let moved = directions.map(|direction| match direction {
                Direction::Unguarded { velocity } | Direction::Guarded { velocity, .. } => {
                    velocity * periods * PERIOD
                }
                Direction::Contact { .. } => 0.0,
            });
            let along = Vector3::from_column_slice(&moved[..3]);
            let turned = UnitQuaternion::from_scaled_axis(Vector3::from_column_slice(&moved[3..]));
            *set = match frame {
                Frame::Tool => from * Pose::from_parts(Translation3::from(along), turned),
                Frame::Base => Pose::from_parts(
                    Translation3::from(from.translation.vector + along),
                    turned * from.rotation,
                ),
            };
        }
    }
    if let Some(jaw) = &command.jaw {
        ahead.desired_jaw_opening += (jaw.opening - state.desired_jaw_opening) * share;
    }
    ahead
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arms::builtin;
    use crate::motion::JointPositions;

    fn command(motion: Motion) -> MoveCommand {
        MoveCommand { motion, periods: 20, jaw: None }
    }

    /// Halfway through a command of 20 periods, 8 of the remaining 10 periods lie before the
    /// answer.
    #[test]
    fn set_values_go_on_along_the_command() {
        let model = builtin("irp6_postument").unwrap();
        let tool = Pose::translation(0.0, 0.0, 0.25);
        let joints = JointPositions([0.0, 0.1, -1.5, 0.1, -0.2, 4.7, 0.0]);
        let desired_base_from_tool = model.base_from_flange(&joints) * tool;
        let state =
            ArmState { desired_joints: joints, desired_base_from_tool, ..ArmState::default() };

        let mut to = joints;
        to.0[1] += 0.1;
        let now = ahead(&state, &command(Motion::Joints(to)), 10, &model);
        assert!((now.desired_joints.0[1] - 0.18).abs() < 1e-12);
        let expected = model.base_from_flange(&now.desired_joints) * tool;
        let off = now.desired_base_from_tool.inverse() * expected;
        assert!(off.translation.vector.norm() < 1e-12 && off.rotation.angle() < 1e-9);

        let mut pose = desired_base_from_tool;
        pose.translation.vector.z += 0.01;
        let now = ahead(&state, &command(Motion::Pose(pose)), 10, &model);
        let moved = now.desired_base_from_tool.translation.z - desired_base_from_tool.translation.z;
        assert!((moved - 0.008).abs() < 1e-12, "{moved}");

        let mut directions = [Direction::HOLD; 6];
        directions[2] = Direction::Unguarded { velocity: 0.5 };
        let task = Motion::Task { frame: Frame::Tool, directions };
        let now = ahead(&state, &command(task), 10, &model);
        let moved = desired_base_from_tool.inverse() * now.desired_base_from_tool;
        assert!((moved.translation.z - 0.5 * 8.0 * PERIOD).abs() < 1e-12, "{moved}");
    }

    #[test]
    fn answer_in_time_is_the_present_state() {
        let model = builtin("irp6_postument").unwrap();
        let state = ArmState::default();
        let pose = Motion::Pose(Pose::translation(0.1, 0.0, 0.0));
        assert_eq!(ahead(&state, &command(pose), NEAR_END, &model), state);
    }
}
