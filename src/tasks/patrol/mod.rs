//! The task `patrol`: each arm goes its rounds by a programme of its own, and MP is dormant.
//!
//! The cooperation is independent and the coordination absent (Zieliński et al. 2007, p. 369): an
//! arm that something stops waits and goes on, and the others do not notice.
//!
//! - in: the number of rounds, the angle of the stops
//! - out: for each arm motions to its stops; the end once all programmes have ended

mod door;
mod keys;
mod verdict;

pub use door::Patrol;
pub use keys::Keys;
pub(in crate::tasks) use verdict::Courses;
pub use verdict::RoundsDone;

use crate::generators::Behaviour;
use crate::kernel::Message;
use crate::kernel::programme::EcpTask;
use crate::kernel::robot::{Hindrance, Robot, RobotKernel};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Name of the programme.
pub const ROUNDS: &str = "patrol_rounds";
/// Longest time of a patrol, and of each of its rounds (s).
const PATIENCE: (f64, f64) = (600.0, 60.0);
/// Time for which an arm rests at the end of a round (s).
const REST: f64 = 0.2;
/// Number of tries to reach a stop.
const TRIES: u32 = 5;
/// Share of the full speed. The hands pass the place of the hand-over, where the guard allows
/// 250 mm/s because a person's hand may be there.
const SPEED: f64 = 0.2;

/// Order of the programme.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Order {
    /// Number of rounds.
    pub rounds: u32,
    /// Angle by which the stops lie to both sides of the start (rad).
    pub angle: f64,
}

/// Makes the kernel of MP: it starts the programme on each arm, and waits for their ends.
#[must_use]
pub fn patrol(order: Order) -> RobotKernel {
    Robot::kernel(move |robot| async move {
        robot.phase("patrol").await?;
        let arms = robot.arms().len();
        begin(&robot, 0..arms, &order).await?;
        end(&robot, arms, &order).await?;
        Ok(format!("all arms have gone {} rounds", order.rounds))
    })
}

/// Starts the programme on each of these arms.
pub(in crate::tasks) async fn begin(
    robot: &Robot,
    arms: Range<usize>,
    order: &Order,
) -> Result<(), Hindrance> {
    for arm in arms {
        robot.start(arm, Rounds::programme(ROUNDS, order)?).await?;
    }
    Ok(())
}

/// Waits for the ends of the programmes on this number of arms.
pub(in crate::tasks) async fn end(
    robot: &Robot,
    arms: usize,
    order: &Order,
) -> Result<(), Hindrance> {
    let patience = PATIENCE.0 + PATIENCE.1 * f64::from(order.rounds);
    let mut failed = Vec::new();
    for _ in 0..arms {
        match robot.receive(patience).await? {
            Some(Message::Ended { finish, .. }) if finish.achieved => {}
            Some(Message::Ended { finish, effector }) => {
                failed.push(format!("effector {effector}: {}", finish.reason));
            }
            other => return Err(Hindrance(format!("a programme does not end: {other:?}"))),
        }
    }
    if failed.is_empty() { Ok(()) } else { Err(Hindrance(failed.join("; "))) }
}

/// Programme of one arm: it goes its rounds.
#[derive(Debug)]
pub struct Rounds;

impl EcpTask for Rounds {
    type Order = Order;
    type Kernel = RobotKernel;

    fn kernel(order: Order) -> RobotKernel {
        Robot::kernel(move |robot| rounds(robot, order))
    }
}

/// Goes from the start to a stop on each side and back, round by round.
async fn rounds(robot: Robot, order: Order) -> Result<String, Hindrance> {
    let start = robot.arms()[0].desired_joints;
    let beside = |joint: usize, by: f64| {
        let mut stop = start;
        stop.0[joint] += by;
        stop
    };
    // The column turns to both sides, then the wrist.
    let angle = order.angle;
    let stops = [beside(1, angle), beside(1, -angle), beside(6, angle), start];
    for _ in 0..order.rounds {
        for stop in stops {
            let motion = Behaviour::Joints { target: stop, speed: SPEED, seconds: 0.0 };
            robot.insist(0, motion, TRIES).await?;
        }
        robot.pause(REST).await?;
    }
    Ok(format!("went {} rounds", order.rounds))
}
