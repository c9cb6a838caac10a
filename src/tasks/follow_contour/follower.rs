//! Programme of the first arm: it follows the contour, then takes the last part and lays it down.
//!
//! - in: a [`FollowerOrder`], signals of MP
//! - out: motions, signals
//!
//! An arm that a push lifts off the contour, or stops, comes down again where it is and follows the
//! rest.

use super::moves::{
    SLOW, await_signal, go, grip, holds, lay, rise, rise_to, settle, tell, touch_down,
};
use super::orders::{FollowerOrder, signals};
use crate::generators::Outcome;
use crate::generators::contact::{Contour, ContourOrder, Followed};
use crate::generators::own::MotionGenerator as _;
use crate::kernel::Signal;
use crate::kernel::programme::EcpTask;
use crate::kernel::robot::{Hindrance, Robot, RobotKernel};

/// Number of tries to follow the contour, and the time before the next one (s).
const TRIES: u32 = 5;
const AGAIN: f64 = 1.0;
/// Distance by which the tool leaves the contour before it comes down again (m).
const LEAVE: f64 = 0.02;
/// Longest way down to the contour (m).
const REACH: f64 = 0.08;
/// Share of the full speed at which it leaves.
const PACE: f64 = 0.2;
/// Share of the wanted force that ends the way down.
const TOUCH: f64 = 0.5;
/// Rest of the contour that is not worth another try (m).
const REST: f64 = 0.002;

/// Programme that follows the contour.
#[derive(Debug)]
pub struct Follower;

impl EcpTask for Follower {
    type Order = FollowerOrder;
    type Kernel = RobotKernel;

    fn kernel(order: FollowerOrder) -> RobotKernel {
        Robot::kernel(move |robot| perform(robot, order))
    }
}

/// Carries out the programme.
async fn perform(robot: Robot, order: FollowerOrder) -> Result<String, Hindrance> {
    let hand = order.hand;
    go(&robot, &order.begin, hand.pace).await?;
    let followed = follow(&robot, &order.contour).await?;
    rise_to(&robot, &order.begin, hand.pace).await?;
    let value = serde_json::to_value(followed).map_err(|why| Hindrance(why.to_string()))?;
    robot.signal(0, Signal { name: signals::FOLLOWED.to_owned(), value }).await?;

    await_signal(&robot, signals::TAKE).await?;
    grip(&robot, &order.take, &hand).await?;
    tell(&robot, signals::TAKEN).await?;
    await_signal(&robot, signals::LAY).await?;
    rise_to(&robot, &order.take, hand.pace).await?;
    holds(&robot, &hand).await?;
    lay(&robot, &order.goal, &hand).await?;
    Ok("followed the contour and laid a part down".to_owned())
}

/// Follows the contour in one piece, or in several if something interrupts it.
async fn follow(robot: &Robot, whole: &ContourOrder) -> Result<Followed, Hindrance> {
    let begin = robot.arms()[0].desired_base_from_tool.translation.vector;
    let mut sum = Followed { length: 0.0, lost: false, error: (0.0, 0.0) };
    for _ in 0..TRIES {
        let order = ContourOrder { length: whole.length - sum.length, ..whole.clone() };
        let met = piece(robot, &order).await;
        let part = met.as_ref().ok().and_then(Outcome::result::<Followed>);
        if let Some(part) = part {
            sum.error = (together(&sum, &part), sum.error.1.max(part.error.1));
            sum.length += part.length;
        } else {
            // The way over ground is a little shorter than that along the contour.
            let now = robot.arms()[0].desired_base_from_tool.translation.vector;
            sum.length = sum.length.max((now - begin).xy().norm());
        }
        if whole.length - sum.length < REST {
            return Ok(sum);
        }
        let why = met.map_or_else(|why| why.to_string(), |outcome| outcome.to_string());
        robot.warn(format!("contour interrupted after {:.0} mm: {why}", sum.length * 1e3));
        robot.pause(AGAIN).await?;
        rise(robot, LEAVE, PACE).await?;
    }
    Err(Hindrance(format!("the contour was interrupted {TRIES} times")))
}

/// Moves down to the contour and follows it.
async fn piece(robot: &Robot, order: &ContourOrder) -> Result<Outcome, Hindrance> {
    settle(robot).await?;
    if touch_down(robot, (SLOW, TOUCH * order.force), REACH).await? == Outcome::NotTouched {
        return Err(Hindrance("there is no contour below the probe".to_owned()));
    }
    robot.behave(0, Contour::behaviour("contour", order)?).await
}

/// Returns the root mean square of the errors of two pieces (N), each weighted by its length.
fn together(sum: &Followed, part: &Followed) -> f64 {
    let squares = sum.error.0.powi(2) * sum.length + part.error.0.powi(2) * part.length;
    libm::sqrt(squares / (sum.length + part.length).max(1e-9))
}
