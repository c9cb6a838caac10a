//! The task `carry_bar`: the first two hands grip one rigid bar, carry it along a way with turns,
//! and lay it down.
//!
//! The cooperation is tight and the coordination continuous (Zieliński et al. 2007, p. 369): MP
//! computes the set values of both arms in each macrostep. The first hand keeps to the way. The
//! second one has the same way and yields, so that errors of the bases, of the grips and of the
//! tracking cost little force inside the bar.
//!
//! Each further arm goes rounds by a programme of its own meanwhile: the cooperation with it is
//! independent, and its coordination absent.
//!
//! | case | reaction |
//! |---|---|
//! | force beyond `stop_force`, such as a push | both yield for a moment, then go on from there |
//! | the same, more than `TRIES` times | the task fails; both hands hold |
//! | jaws that hold nothing any more | both stop at once; the task fails with the arm's number |
//!
//! - in: the believed place of the bar, the way
//! - out: motions of both arms; the greatest force at the wrists for the summary

mod door;
mod keys;
mod verdict;

pub use door::CarryBar;
pub use keys::{Keys, Partner};
pub use verdict::BarCarried;

use super::patrol;
use crate::generators::contact::{Carry, CarryOrder};
use crate::generators::own::MotionGenerator as _;
use crate::generators::paths::Polyline;
use crate::generators::{Behaviour, Outcome, Selector};
use crate::kernel::robot::{Hindrance, Robot};
use crate::kernel::{Message, Until};
use crate::motion::{Depth, JawCommand};
use crate::spatial::Pose;
use nalgebra::{UnitQuaternion, Vector3};
use std::f64::consts::{FRAC_PI_2, PI};

/// Number of the arms that carry, the first ones of the cell.
const CARRIERS: usize = 2;
/// Standard gravity (m/s2).
const GRAVITY: f64 = 9.81;
/// Opening of the jaws beyond the width of the bar (m).
const ROOM: f64 = 0.016;
/// Height above a grip from which a hand goes straight down, and to which it returns (m).
const ABOVE: f64 = 0.1;
/// Share of the full speed of straight motions without the bar.
const SPEED: f64 = 0.5;
/// Part of the bar's width below which the jaws hold nothing.
const LEAST_WIDTH: f64 = 0.948;
/// Directions that yield while the jaws close: all displacements, no rotation.
const PLACES: Selector = [true, true, true, false, false, false];
/// Directions that yield while both arms recover from a great force.
const ALL: Selector = [true; 6];
/// Time for which both arms yield after a great force (s).
const YIELDS: f64 = 0.8;
/// Time in which an arm that goes rounds tells why it has stopped (s).
const CAUSE: f64 = 0.1;
/// Number of times that the way is continued after a great force.
const TRIES: u32 = 5;

/// The bar and its way, in the world, and the arms that carry it.
#[derive(Debug, Clone)]
struct Job {
    keys: Keys,
    /// Base and tool of each arm: `world_from_base`, `flange_from_tool`.
    arms: Vec<(Pose, Pose)>,
    /// Grip force (N).
    grip: f64,
    /// Torque of a hand at which both stop (Nm).
    stop_torque: f64,
    /// Speed as a share of the full linear speed.
    share: f64,
    /// Poses of the bar: at the start, after the lift, at each point of the way, laid down.
    poses: Vec<Pose>,
}

impl Job {
    /// Makes the job of a scenario for `arms`, with the grip force (N) and the torque at which both
    /// stop (Nm). `share` is the speed of the bar as a share of the full one.
    fn new(
        keys: Keys,
        arms: Vec<(Pose, Pose)>,
        (grip, stop_torque): (f64, f64),
        share: f64,
    ) -> Self {
        let start = upright(Vector3::from(keys.bar_xyz), keys.bar_yaw);
        let up = Vector3::z() * keys.lift;
        let mut poses = vec![start, Pose::from(up) * start];
        for ([x, y], turn) in keys.way.iter().zip(&keys.turns) {
            let place = start.translation.vector + Vector3::new(*x, *y, 0.0) + up;
            poses.push(upright(place, keys.bar_yaw + turn));
        }
        let last = poses[poses.len() - 1];
        poses.push(Pose::from(-up) * last);
        Self { keys, arms, grip, stop_torque, share, poses }
    }

    /// Returns the pose of a hand on the bar, `bar_from_tool`. The first hand is at the end to
    /// which the first base is nearer. The tool points down, and its jaws close across the bar.
    fn bar_from_tool(&self, arm: usize) -> Pose {
        let along = self.poses[0].rotation * Vector3::x();
        let between = self.arms[1].0.translation.vector - self.arms[0].0.translation.vector;
        let side = if along.dot(&between) >= 0.0 { 0.5 } else { -0.5 };
        let place = Vector3::x() * self.keys.span * if arm == 0 { -side } else { side };
        // The tool's x is along the bar, its z points down.
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
        Pose::from_parts(place.into(), down)
    }

    /// Returns the pose of the bar `world_from_bar` in the base of an arm.
    fn in_base(&self, arm: usize, world_from_bar: &Pose) -> Pose {
        self.arms[arm].0.inverse() * world_from_bar
    }

    /// Returns the pose of a tool in its base, on the bar at its start, `above` it by a distance
    /// (m). Each tool takes the turn about the vertical that is nearer to the present one.
    fn grip_pose(&self, arm: usize, above: f64, now: &Pose) -> Pose {
        let lifted = Pose::translation(0.0, 0.0, above) * self.poses[0];
        let grip = self.in_base(arm, &lifted) * self.bar_from_tool(arm);
        let turned = grip * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), PI);
        let nearer = |pose: &Pose| pose.rotation.angle_to(&now.rotation) < FRAC_PI_2;
        if nearer(&grip) { grip } else { turned }
    }
}

/// Returns the pose of a level bar with its centre at `place` (m), turned about the vertical by
/// `yaw` (rad).
fn upright(place: Vector3<f64>, yaw: f64) -> Pose {
    Pose::from_parts(place.into(), UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw))
}

/// Carries the bar, while each arm beyond the second goes its rounds.
async fn perform(robot: Robot, job: Job) -> Result<String, Hindrance> {
    let (keys, arms) = (&job.keys, robot.arms().len());
    let alone = if keys.rounds > 0 { CARRIERS..arms } else { arms..arms };
    let order = patrol::Order { rounds: keys.rounds, angle: keys.angle };
    patrol::begin(&robot, alone.clone(), &order).await?;
    if let Err(why) = carry(&robot, &job).await {
        // A fault of an arm that goes rounds stops the carriers as well.
        for _ in alone {
            if let Ok(Some(Message::Ended { effector, finish })) = robot.receive(CAUSE).await
                && !finish.achieved
            {
                return Err(Hindrance(format!("{why}; effector {effector}: {}", finish.reason)));
            }
        }
        return Err(why);
    }
    if !alone.is_empty() {
        robot.phase("wait for the other arms").await?;
    }
    patrol::end(&robot, alone.len(), &order).await?;
    Ok("the bar is carried and laid down".to_owned())
}

/// Grips the bar with both hands, carries it along its way, and lays it down.
async fn carry(robot: &Robot, job: &Job) -> Result<(), Hindrance> {
    robot.phase("reach for the bar").await?;
    let arms = robot.arms().len();
    robot.bias((0..arms).map(|arm| arm < CARRIERS).collect()).await?;
    let open = jaws(job, job.keys.width + ROOM);
    both(robot, |_| open.clone()).await?;
    for above in [ABOVE, 0.0] {
        let from: Vec<Pose> = robot.arms().iter().map(|a| a.desired_base_from_tool).collect();
        let line = |arm: usize| Behaviour::Line {
            target: job.grip_pose(arm, above, &from[arm]),
            speed: SPEED,
        };
        both(robot, line).await?;
    }
    robot.phase("grip").await?;
    let grasp = Behaviour::Grasp {
        force: job.grip,
        least_width: LEAST_WIDTH * job.keys.width,
        selector: PLACES,
        stops: Depth::Two,
    };
    for (arm, outcome) in both(robot, |_| grasp.clone()).await?.into_iter().enumerate() {
        if !matches!(outcome, Some(Outcome::Grasped(_))) {
            return Err(lost(arm));
        }
    }
    for (arm, (_, flange_from_tool)) in job.arms.iter().enumerate() {
        // Each hand carries half of the bar.
        let centre = flange_from_tool.translation.vector.into();
        robot.set_load(arm, 0.5 * job.keys.mass * GRAVITY, centre).await?;
    }
    robot.phase("carry").await?;
    along(robot, job).await?;
    robot.phase("lay down").await?;
    for arm in 0..CARRIERS {
        robot.set_load(arm, 0.0, nalgebra::Point3::origin()).await?;
    }
    both(robot, |_| open.clone()).await?;
    let from: Vec<Pose> = robot.arms().iter().map(|a| a.desired_base_from_tool).collect();
    let up = Pose::translation(0.0, 0.0, ABOVE);
    both(robot, |arm| Behaviour::Line { target: up * from[arm], speed: SPEED }).await?;
    let loads = robot.forces().arms;
    let forces: Vec<f64> = loads.iter().take(CARRIERS).map(|arm| arm.peak_force).collect();
    robot.report("wrist_peak_n", forces);
    Ok(())
}

/// Carries the bar along the rest of its way. After a great force both hands yield for a moment,
/// and the way is continued.
async fn along(robot: &Robot, job: &Job) -> Result<(), Hindrance> {
    let arms = robot.arms();
    let relation =
        |arm: usize| arms[arm].desired_base_from_tool.inverse() * job.in_base(arm, &job.poses[0]);
    let tool_from_bar = [relation(0), relation(1)];
    let (mut stops, mut leg) = (0, 0);
    loop {
        let state = robot.arms();
        let bar = job.arms[0].0 * state[0].desired_base_from_tool * tool_from_bar[0];
        leg = nearest_leg(&job.poses, leg, &bar);
        let rest = &job.poses[leg + 1..];
        let mut orders = Vec::new();
        for (arm, tool_from_body) in tool_from_bar.iter().enumerate() {
            let yields = if arm == 1 && job.keys.partner == Partner::Compliant {
                PLACES
            } else {
                [false; 6]
            };
            let through = rest.iter().map(|pose| job.in_base(arm, pose)).collect();
            let order = CarryOrder {
                path: Polyline { through, radius: job.keys.radius, speed: job.share },
                tool_from_body: *tool_from_body,
                lever: 0.5 * job.keys.span,
                yields,
                bound: (job.keys.stop_force, job.stop_torque),
                least_width: LEAST_WIDTH * job.keys.width,
            };
            let order = Carry::<Polyline>::behaviour("carry_polyline", &order);
            orders.push(Some(order?));
        }
        let met = carriers(robot, orders).await;
        // The jaws may open again after they have closed on the edge of the bar that they lost.
        if let Ok(outcomes) = &met
            && let Some(arm) = outcomes.iter().position(|o| matches!(o, Some(Outcome::Lost(_))))
        {
            return Err(lost(arm));
        }
        held(robot, job)?;
        match met {
            Ok(outcomes) if outcomes.iter().all(|o| *o == Some(Outcome::Reached)) => return Ok(()),
            Ok(outcomes) if stops == TRIES => {
                return Err(Hindrance(format!("the bar does not go on: {outcomes:?}")));
            }
            Err(why) if stops == TRIES => return Err(why),
            Ok(_) => robot.warn("the bar was held up; both hands go on".to_owned()),
            Err(why) => robot.warn(format!("{why}; both hands yield, then go on")),
        }
        stops += 1;
        robot.report("stops", stops);
        let yields = Behaviour::Present { pull: f64::MAX, selector: ALL, seconds: YIELDS };
        // A great force may end this as well: the next try shows whether it lasts.
        let _ = both(robot, |_| yields.clone()).await;
    }
}

/// Returns the leg of the way that is nearest to the present pose of the bar, from the leg `from`
/// on: a way that comes back to where it was is not begun again.
fn nearest_leg(poses: &[Pose], from: usize, bar: &Pose) -> usize {
    let at = bar.translation.vector;
    let distance = |leg: usize| {
        let (from, to) = (poses[leg].translation.vector, poses[leg + 1].translation.vector);
        let way = to - from;
        let share = ((at - from).dot(&way) / way.norm_squared().max(1e-12)).clamp(0.0, 1.0);
        (at - from - way * share).norm()
    };
    let legs = from..poses.len() - 1;
    legs.min_by(|a, b| distance(*a).total_cmp(&distance(*b))).unwrap_or(from)
}

/// Checks that the jaws of both hands still hold the bar.
fn held(robot: &Robot, job: &Job) -> Result<(), Hindrance> {
    let arms = robot.arms();
    let empty =
        arms.iter().take(CARRIERS).position(|arm| arm.jaw_opening < LEAST_WIDTH * job.keys.width);
    empty.map_or(Ok(()), |arm| Err(lost(arm)))
}

/// Returns the hindrance of a hand that does not hold the bar.
fn lost(arm: usize) -> Hindrance {
    Hindrance(format!("the hand of arm {arm} does not hold the bar"))
}

/// Makes an order for jaws that open to this distance between the pads (m).
fn jaws(job: &Job, opening: f64) -> Behaviour {
    let jaw = JawCommand { opening, force_limit: job.grip, stops: Depth::Two };
    Behaviour::Jaw { jaw, seconds: 0.5, selector: PLACES, strained: false }
}

/// Has the carrying arms carry out an order each, which begin together. Returns their outcomes.
async fn carriers(
    robot: &Robot,
    mut orders: Vec<Option<Behaviour>>,
) -> Result<Vec<Option<Outcome>>, Hindrance> {
    orders.resize(robot.arms().len(), None);
    let mut outcomes = robot.behave_all(orders, Until::All).await?;
    outcomes.truncate(CARRIERS);
    Ok(outcomes)
}

/// Has both carrying arms carry out an order of the same kind, which begin together.
async fn both(
    robot: &Robot,
    order: impl Fn(usize) -> Behaviour,
) -> Result<Vec<Option<Outcome>>, Hindrance> {
    carriers(robot, (0..CARRIERS).map(|arm| Some(order(arm))).collect()).await
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The way goes up, along x and back, then down beside its beginning.
    #[test]
    fn way_continues_after_nearest_leg_ahead() {
        let at = |x: f64, z: f64| Pose::translation(x, 0.0, z);
        let poses = [at(0.0, 0.0), at(0.0, 0.1), at(0.2, 0.1), at(0.0, 0.1), at(0.0, 0.0)];

        assert_eq!(nearest_leg(&poses, 0, &at(0.0, 0.0)), 0);
        assert_eq!(nearest_leg(&poses, 0, &at(0.1, 0.102)), 1);
        assert_eq!(nearest_leg(&poses, 2, &at(0.1, 0.102)), 2);
        assert_eq!(nearest_leg(&poses, 2, &at(0.001, 0.05)), 3);
    }
}
