//! The task `follow_joints`: the arms follow joint commands of another program, such as `MoveIt` by
//! `ros2_control`.
//!
//! The commands come by a sensor, `joint_commands`, whose readings are recorded like those of any
//! other; so a replay needs no other program. The arms follow by the generator [`Follow`].
//!
//! - in: readings of the sensor
//! - out: one motion for each arm that has such a sensor, until the time is over, something stops
//!   an arm, or the operator ends the run
//!
//! | command | reaction |
//! |---|---|
//! | unknown joint, joint named twice, arm without some joints | refused; the arms hold |
//! | position outside the limits of the joint, or not a number | the same |
//! | position too far from the arm (a jump) | the same |
//! | none for half a second | the arms hold |
//! | a way too near an obstacle, or too fast there | the arm brakes before it: see its ECP |

mod commands;
mod door;
mod keys;

pub use door::{FollowJoints, JointCommands};
pub use keys::{Keys, SensorKeys};

use crate::generators::Outcome;
use crate::generators::follow::{Follow, FollowOrder, Followed};
use crate::generators::own::MotionGenerator as _;
use crate::kernel::Until;
use crate::kernel::robot::{Hindrance, Robot, RobotKernel};

/// Name of the sensor, which `[[vsp]]` of a scenario has as its `kind`.
pub const SENSOR: &str = "joint_commands";

/// Order of the task.
#[derive(Debug, Clone, PartialEq)]
pub struct Order {
    /// Name of the sensor of each arm; `None` for an arm that stays.
    pub sensors: Vec<Option<String>>,
    /// Fraction of the full speeds and accelerations.
    pub speed: f64,
    /// Time after which the task ends (s); `None` if the operator ends it.
    pub seconds: Option<f64>,
}

/// Makes the kernel of MP, which lets the arms follow.
#[must_use]
pub fn follow_joints(order: Order) -> RobotKernel {
    Robot::kernel(move |robot| follow(robot, order))
}

/// Lets the arms follow, and returns what was done.
async fn follow(robot: Robot, order: Order) -> Result<String, Hindrance> {
    robot.phase("follow").await?;
    let of_arm = |(effector, sensor): (usize, &Option<String>)| {
        let sensor = sensor.clone()?;
        let (speed, seconds) = (order.speed, order.seconds);
        let order = FollowOrder { sensor, effector, speed, seconds };
        Some(Follow::behaviour("follow", &order))
    };
    let orders = order.sensors.iter().enumerate().map(|arm| of_arm(arm).transpose());
    let orders = orders.collect::<Result<Vec<_>, _>>()?;
    let outcomes = robot.behave_all(orders, Until::All).await?;
    let accounts: Vec<Followed> =
        outcomes.iter().flatten().filter_map(Outcome::result::<Followed>).collect();
    let figure = |of: fn(&Followed) -> f64| accounts.iter().map(of).collect::<Vec<f64>>();
    robot.report("followed_s", figure(|account| account.followed));
    robot.report("held_s", figure(|account| account.held));
    robot.report("hindered", figure(|account| f64::from(account.hindered)));
    robot.report("lag_deg", figure(|account| account.lag.to_degrees()));
    Ok("the arms followed joint commands".to_owned())
}
