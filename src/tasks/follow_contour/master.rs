//! MP of the task: it starts both programmes, and sets the moment of the hand-over.
//!
//! - in: the orders of both programmes; their signals and ends
//! - out: the start of both, signals; figures that the programmes measured

use super::follower::Follower;
use super::orders::{FOLLOW, FollowerOrder, PICK, PickerOrder, signals};
use super::picker::Picker;
use crate::generators::contact::Followed;
use crate::kernel::programme::EcpTask as _;
use crate::kernel::robot::{Hindrance, Robot, RobotKernel};
use crate::kernel::{Message, Signal};
use serde::Deserialize as _;

/// Longest time to wait for a message (s).
const PATIENCE: f64 = 600.0;
/// Effectors of the programmes.
const FOLLOWER: usize = 0;
const PICKER: usize = 1;

/// Makes the kernel of MP.
#[must_use]
pub fn follow_contour(follower: FollowerOrder, picker: PickerOrder) -> RobotKernel {
    Robot::kernel(move |robot| async move {
        robot.phase("contour").await?;
        let programme = Follower::programme(FOLLOW, &follower)?;
        robot.start(FOLLOWER, programme).await?;
        let programme = Picker::programme(PICK, &picker)?;
        robot.start(PICKER, programme).await?;
        // The arms meet only once both are done with their own work.
        hear(&robot, vec![(FOLLOWER, signals::FOLLOWED), (PICKER, signals::HOLDS)]).await?;

        robot.phase("hand_over").await?;
        ask(&robot, PICKER, signals::PRESENT, signals::PRESENTED).await?;
        ask(&robot, FOLLOWER, signals::TAKE, signals::TAKEN).await?;
        ask(&robot, PICKER, signals::RELEASE, signals::RELEASED).await?;
        robot.signal(FOLLOWER, Signal::new(signals::LAY)).await?;
        let mut running = 2;
        while running > 0 {
            match receive(&robot).await? {
                Message::Ended { .. } => running -= 1,
                other @ Message::Signal { .. } => {
                    return Err(Hindrance(format!("unexpected message: {other:?}")));
                }
            }
        }
        let laid = picker.parts.len();
        Ok(format!("the contour is followed, {laid} parts are laid down, one is handed over"))
    })
}

/// Sends a signal to a programme and waits for its answer.
async fn ask(
    robot: &Robot,
    effector: usize,
    signal: &'static str,
    answer: &'static str,
) -> Result<(), Hindrance> {
    robot.show("hand_over", signal);
    robot.signal(effector, Signal::new(signal)).await?;
    hear(robot, vec![(effector, answer)]).await
}

/// Waits until each of these signals has come.
async fn hear(robot: &Robot, mut wanted: Vec<(usize, &'static str)>) -> Result<(), Hindrance> {
    while !wanted.is_empty() {
        let message = receive(robot).await?;
        let Message::Signal { effector, signal } = &message else {
            return Err(Hindrance(format!("a programme has ended too early: {message:?}")));
        };
        let found = wanted.iter().position(|(from, name)| from == effector && *name == signal.name);
        let Some(found) = found else {
            return Err(Hindrance(format!("unexpected signal `{}`", signal.name)));
        };
        wanted.swap_remove(found);
        if let Ok(followed) = Followed::deserialize(&signal.value) {
            robot.report("measured_error_n", followed.error.0);
            robot.report("measured_length_mm", followed.length * 1e3);
        }
    }
    Ok(())
}

/// Returns the next message; the failure of a programme is a hindrance.
async fn receive(robot: &Robot) -> Result<Message, Hindrance> {
    match robot.receive(PATIENCE).await? {
        Some(Message::Ended { effector, finish }) if !finish.achieved => {
            Err(Hindrance(format!("effector {effector}: {}", finish.reason)))
        }
        Some(message) => Ok(message),
        None => Err(Hindrance(format!("no programme has answered for {PATIENCE:.0} s"))),
    }
}
