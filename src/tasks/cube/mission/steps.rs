//! Execution of a plan, one step after the other.
//!
//! - in: steps of two hands
//! - out: the cube after the steps, or the failure of one of them

use super::failure::Failure;
use super::inspect::inspect;
use super::robot::Robot;
use super::{look, regrasp, turn};
use crate::tasks::cube::hold::{Grip, Hand, Step};

/// Carries out the steps of a plan.
pub(super) async fn carry_out(robot: &mut Robot, steps: &[Step]) -> Result<(), Failure> {
    for (i, step) in steps.iter().enumerate() {
        let turns_remain = steps[i + 1..].iter().any(|step| matches!(step, Step::Turn { .. }));
        carry_out_step(robot, *step, turns_remain).await?;
    }
    Ok(())
}

/// Carries out one step of a plan. If an earlier turn stalled on its way, the cube is inspected
/// before the next step that begins with a hand letting go. `turns_remain` says whether later steps
/// include a turn.
pub(super) async fn carry_out_step(
    robot: &mut Robot,
    step: Step,
    turns_remain: bool,
) -> Result<(), Failure> {
    robot.check_hold()?;
    // An inspection needs a free hand. If no turn remains, the one at the end of the plan is
    // enough.
    if turns_remain
        && let Some(hand) = leaving_hand(step)
        && robot.belief.held.iter().all(Option::is_some)
        && let Some(turn) = robot.stalled.take()
    {
        robot.note(format!("turn {turn} stalled before its end: the cube is inspected"));
        let leaves = matches!(step, Step::Leave { .. });
        if leaves {
            robot.shown.begin_step();
        }
        regrasp::let_go(robot, hand).await?;
        inspect(robot, true).await?;
        // The hand has let go, so a step `Leave` is done.
        if leaves {
            return Ok(());
        }
    }
    robot.check_hold()?;
    robot.shown.begin_step();
    match step {
        Step::Leave { hand } => regrasp::let_go(robot, hand).await,
        Step::Look { viewer, face } => look::show(robot, viewer, face).await,
        Step::Grasp { hand, hold, half_roll } => {
            regrasp::grasp(robot, hand, Grip { hold, half_roll }).await
        }
        Step::Turn { turner, turn } => turn::turn_layer(robot, turner, turn).await,
    }
}

/// Returns the hand that lets go at the beginning of a step, if there is one.
fn leaving_hand(step: Step) -> Option<Hand> {
    match step {
        Step::Leave { hand } | Step::Grasp { hand, .. } | Step::Look { viewer: hand, .. } => {
            Some(hand)
        }
        Step::Turn { .. } => None,
    }
}
