//! The steps of a plan are carried out, one after the other.
//!
//! - in: steps of two hands
//! - out: the cube as the steps leave it; the failure of the step that did not go through

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

/// Carries out one step. After a turn that stalled on its way the cube is inspected first, as soon
/// as the step begins with a hand that lets go, since the other one holds the cube alone then.
/// Without another turn the plan ends with an inspection anyhow.
pub(super) async fn carry_out_step(
    robot: &mut Robot,
    step: Step,
    turns_remain: bool,
) -> Result<(), Failure> {
    robot.check_hold()?;
    if turns_remain
        && let Some(hand) = leaving_hand(step)
        && robot.belief.held.iter().all(Option::is_some)
        && let Some(turn) = robot.stalled.take()
    {
        robot.note(format!("turn {turn} stood still in between: the cube is inspected"));
        let leaves = matches!(step, Step::Leave { .. });
        if leaves {
            robot.shown.begin_step();
        }
        regrasp::let_go(robot, hand).await?;
        inspect(robot, true).await?;
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

/// Returns the hand that lets go at the beginning of a step, if one may.
fn leaving_hand(step: Step) -> Option<Hand> {
    match step {
        Step::Leave { hand } | Step::Grasp { hand, .. } | Step::Look { viewer: hand, .. } => {
            Some(hand)
        }
        Step::Turn { .. } => None,
    }
}
