//! Programme of the second arm: it picks parts, lays them down, and passes the last one on.
//!
//! - in: a [`PickerOrder`], signals of MP
//! - out: motions, signals

use super::moves::{await_signal, go, grip, holds, lay, open, rise, rise_to, tell};
use super::orders::{PickerOrder, signals};
use crate::kernel::programme::EcpTask;
use crate::kernel::robot::{Hindrance, Robot, RobotKernel};

/// Programme that picks parts and passes the last one on.
#[derive(Debug)]
pub struct Picker;

impl EcpTask for Picker {
    type Order = PickerOrder;
    type Kernel = RobotKernel;

    fn kernel(order: PickerOrder) -> RobotKernel {
        Robot::kernel(move |robot| perform(robot, order))
    }
}

/// Carries out the programme.
async fn perform(robot: Robot, order: PickerOrder) -> Result<String, Hindrance> {
    let hand = order.hand;
    for (from, to) in &order.parts {
        grip(&robot, from, &hand).await?;
        rise_to(&robot, from, hand.pace).await?;
        lay(&robot, to, &hand).await?;
    }
    grip(&robot, &order.last, &hand).await?;
    rise_to(&robot, &order.last, hand.pace).await?;
    holds(&robot, &hand).await?;
    tell(&robot, signals::HOLDS).await?;

    await_signal(&robot, signals::PRESENT).await?;
    go(&robot, &order.present, hand.pace).await?;
    holds(&robot, &hand).await?;
    tell(&robot, signals::PRESENTED).await?;
    await_signal(&robot, signals::RELEASE).await?;
    open(&robot, &hand).await?;
    rise(&robot, order.last.down, hand.pace).await?;
    go(&robot, &order.last, hand.pace).await?;
    tell(&robot, signals::RELEASED).await?;
    Ok(format!("laid {} parts down and passed one on", order.parts.len()))
}
