//! Motions of both programmes: to a place, onto a part, with a part onto its goal.
//!
//! - in: a [`Spot`], the [`Hand`]
//! - out: motions of effector 0, and a hindrance if a part is not held
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | height of a place | `NEAR` above and below | errors of the bases |
//! | finger on a part, or no part between the jaws | `SHIFTS` along the jaws, in turn | the same |
//! | zero of the force sensor | set in free space, above the place | a contact would falsify it |
//! | motion that a force stops | again, `TRIES` times | a push passes |
//! | force on a part high above its place | lowered again, `TRIES` times | a push passes |

use super::orders::{Hand, Spot};
use crate::generators::contact::{Guarded, GuardedOrder};
use crate::generators::own::MotionGenerator as _;
use crate::generators::{Behaviour, Outcome};
use crate::kernel::robot::{Hindrance, Robot};
use crate::kernel::{Message, Signal};
use crate::motion::{Depth, Frame, JawCommand};
use crate::spatial::Pose;
use nalgebra::Vector3;

/// Distance from an expected contact at which a slow motion begins (m).
const NEAR: f64 = 0.03;
/// Speed of the way down until near a place, where a finger may meet a part (m/s).
const LOWER: f64 = 0.015;
/// Speed of motions that end at a contact (m/s).
pub(super) const SLOW: f64 = 0.006;
/// Force that ends the motion onto a part, and with a part onto its goal (N).
const TOUCH: f64 = 3.0;
/// Places along the jaws at which a part is sought, from the expected one (m).
const SHIFTS: [f64; 5] = [0.0, 0.015, -0.015, 0.03, -0.03];
/// Number of tries of a motion in free space.
const TRIES: u32 = 5;
/// Longest time to wait for a signal (s).
const PATIENCE: f64 = 600.0;
/// Time in which an arm comes to rest (s).
const SETTLES: f64 = 0.3;
/// Number of looks at the jaws that must show a part, and the time between two of them (s).
const LOOKS: u32 = 10;
const LOOK: f64 = 0.02;
/// Time in which jaws open to leave a part (s).
const LEAVE: f64 = 1.0;

/// Moves the arm to its place above a spot.
pub(super) async fn go(robot: &Robot, spot: &Spot, pace: f64) -> Result<(), Hindrance> {
    let motion = Behaviour::Joints { target: spot.joints, speed: pace, seconds: 0.0 };
    robot.insist(0, motion, TRIES).await.map(|_| ())
}

/// Moves the tool straight to a pose.
async fn line(robot: &Robot, target: Pose, pace: f64) -> Result<(), Hindrance> {
    robot.insist(0, Behaviour::Line { target, speed: pace }, TRIES).await.map(|_| ())
}

/// Raises the tool by a distance (m).
pub(super) async fn rise(robot: &Robot, by: f64, pace: f64) -> Result<(), Hindrance> {
    let mut target = robot.arms()[0].desired_base_from_tool;
    target.translation.vector.z += by;
    line(robot, target, pace).await
}

/// Raises the tool to the height above a spot.
pub(super) async fn rise_to(robot: &Robot, spot: &Spot, pace: f64) -> Result<(), Hindrance> {
    let height = robot.arms()[0].desired_base_from_tool.translation.z;
    rise(robot, spot.above.translation.z - height, pace).await
}

/// Returns the pose above a spot, shifted along the jaws (m).
fn over(spot: &Spot, shift: f64) -> Pose {
    let mut pose = spot.above;
    pose.translation.vector += pose.rotation * Vector3::new(0.0, shift, 0.0);
    pose
}

/// Opens the jaws while the arm yields.
pub(super) async fn open(robot: &Robot, hand: &Hand) -> Result<(), Hindrance> {
    let jaw = JawCommand { opening: hand.open, force_limit: hand.grip, stops: Depth::One };
    let order = Behaviour::Jaw { jaw, seconds: LEAVE, selector: [true; 6], strained: true };
    robot.behave(0, order).await.map(|_| ())
}

/// Waits until the arm has come to rest, and sets its force sensor to zero there.
pub(super) async fn settle(robot: &Robot) -> Result<(), Hindrance> {
    robot.pause(SETTLES).await?;
    robot.bias(vec![true]).await
}

/// Grips the part at a spot, and seeks it along the jaws if it is not there. The hand stays where
/// it grips.
pub(super) async fn grip(robot: &Robot, spot: &Spot, hand: &Hand) -> Result<(), Hindrance> {
    open(robot, hand).await?;
    go(robot, spot, hand.pace).await?;
    for shift in SHIFTS {
        if shift != 0.0 {
            line(robot, over(spot, shift), hand.pace).await?;
        }
        // Whether a finger or the palm is on the part shows when the jaws close.
        if touch(robot, spot).await? != Met::Nothing && grasp(robot, hand).await? {
            return Ok(());
        }
        robot.warn(format!("no part between the jaws, {:.0} mm beside its place", shift * 1e3));
        open(robot, hand).await?;
        rise_to(robot, spot, hand.pace).await?;
    }
    Err(Hindrance("there is no part at its place".to_owned()))
}

/// Thing that a hand meets on its way down to a spot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Met {
    /// Something high above the height of the spot: a part under a finger, or a push.
    High,
    /// Something near the height of the spot.
    Near,
    Nothing,
}

/// Lowers a hand that is above a spot until it, or the part in it, touches something. Returns what
/// it meets.
async fn touch(robot: &Robot, spot: &Spot) -> Result<Met, Hindrance> {
    settle(robot).await?;
    if touch_down(robot, (LOWER, TOUCH), spot.down - NEAR).await? != Outcome::NotTouched {
        return Ok(Met::High);
    }
    let near = touch_down(robot, (SLOW, TOUCH), 2.0 * NEAR).await?;
    Ok(if near == Outcome::NotTouched { Met::Nothing } else { Met::Near })
}

/// Closes the jaws, again if a strain between both hands stops them. Returns whether they hold
/// something.
async fn grasp(robot: &Robot, hand: &Hand) -> Result<bool, Hindrance> {
    let grasp = Behaviour::Grasp {
        force: hand.grip,
        least_width: hand.least,
        selector: [true; 6],
        stops: Depth::One,
    };
    let met = robot.insist(0, grasp, TRIES).await;
    if let Ok(Outcome::Grasped(_)) = met {
        return Ok(true);
    }
    robot.warn(met.map_or_else(|why| why.to_string(), |outcome| outcome.to_string()));
    Ok(false)
}

/// Lays the part in the hand down at a spot, and withdraws.
pub(super) async fn lay(robot: &Robot, spot: &Spot, hand: &Hand) -> Result<(), Hindrance> {
    go(robot, spot, hand.pace).await?;
    for _ in 0..TRIES {
        holds(robot, hand).await?;
        match touch(robot, spot).await? {
            Met::Nothing => {
                return Err(Hindrance("there is nothing on which the part could lie".to_owned()));
            }
            Met::High => {
                robot.warn("something is in the way of the part, high above its place".to_owned());
                rise_to(robot, spot, hand.pace).await?;
            }
            Met::Near => {
                // Fingers that have lost the part touch the place as well.
                holds(robot, hand).await?;
                open(robot, hand).await?;
                return rise_to(robot, spot, hand.pace).await;
            }
        }
    }
    Err(Hindrance("something is in the way of the part, high above its place".to_owned()))
}

/// Moves the tool down at a speed (m/s) until it meets a force (N), at most for a distance (m).
pub(super) async fn touch_down(
    robot: &Robot,
    (speed, force): (f64, f64),
    distance: f64,
) -> Result<Outcome, Hindrance> {
    let (frame, direction) = (Frame::Base, -Vector3::z());
    let order = GuardedOrder { frame, direction, speed, force, distance };
    robot.behave(0, Guarded::behaviour("guarded", &order)?).await
}

/// Checks that the jaws stay as far open as a part is wide. Empty jaws swing about the end of their
/// stroke, so one look is not enough.
pub(super) async fn holds(robot: &Robot, hand: &Hand) -> Result<(), Hindrance> {
    for _ in 0..LOOKS {
        let opening = robot.arms()[0].jaw_opening;
        if opening < hand.least {
            let mm = opening * 1e3;
            return Err(Hindrance(format!("the part is lost: the jaws are {mm:.1} mm apart")));
        }
        robot.pause(LOOK).await?;
    }
    Ok(())
}

/// Waits for a signal of MP.
pub(super) async fn await_signal(robot: &Robot, name: &str) -> Result<(), Hindrance> {
    match robot.receive(PATIENCE).await? {
        Some(Message::Signal { signal, .. }) if signal.name == name => Ok(()),
        other => Err(Hindrance(format!("no signal `{name}`, but {other:?}"))),
    }
}

/// Sends a signal to MP.
pub(super) async fn tell(robot: &Robot, name: &str) -> Result<(), Hindrance> {
    robot.signal(0, Signal::new(name)).await
}
