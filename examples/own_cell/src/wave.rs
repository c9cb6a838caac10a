//! The task `wave`: the arms wave some times and come back to where they began.
//!
//! Under sporadic or continuous coordination MP moves all arms together. Without coordination each
//! ECP carries out a programme of its own, and MP waits for their ends.

use crate::nod::{Nod, NodOrder};
use rubik_robot::generators::Behaviour;
use rubik_robot::generators::own::MotionGenerator as _;
use rubik_robot::hw::plant::Plant;
use rubik_robot::kernel::programme::EcpTask;
use rubik_robot::kernel::robot::{Hindrance, Robot, RobotKernel};
use rubik_robot::kernel::{Message, Until};
use rubik_robot::registry::{Judgement, Setup, Task, Truth, Verdict};
use rubik_robot::scenario::declared::Properties;
use rubik_robot::scenario::keys::Coordination;
use rubik_robot::section;
use rubik_robot::spatial::Pose;

/// Longest time of a programme (s).
const PATIENCE: f64 = 120.0;
/// Number of the wrist's joint that waves.
const WRIST: usize = 6;
/// Number of the joint that nods.
const NODS: usize = 4;
/// Largest distance of a tool from its first place at the end (m).
const BACK_WITHIN: f64 = 0.002;

section! {
    /// Keys of the task.
    pub Keys {
        /// Number of waves.
        times: u32 = 3, 1.0..=20.0;
        /// Angle of the wrist to either side.
        swing [deg]: f64 = 10.0, 1.0..=45.0;
    }
}

/// Task `wave`.
pub struct Wave;

impl Task for Wave {
    type Keys = Keys;
    type Kernel = RobotKernel;
    const PROPERTIES: Properties = Properties {
        coordination: &[Coordination::Sporadic, Coordination::Continuous, Coordination::Absent],
        ..Properties::PLAIN
    };

    fn kernel(setup: Setup<'_, Self>) -> Result<RobotKernel, String> {
        let keys = setup.keys.clone();
        Ok(match setup.config.coordination {
            Coordination::Absent => Robot::kernel(|robot| apart(robot, keys)),
            _ => Robot::kernel(|robot| together(robot, keys)),
        })
    }
}

/// Moves the wrists of all arms together.
async fn together(robot: Robot, keys: Keys) -> Result<String, Hindrance> {
    robot.phase("wave").await?;
    for wave in 1..=keys.times {
        robot.show("wave", wave);
        for by in [keys.swing, -2.0 * keys.swing, keys.swing] {
            let orders = (0..robot.arms().len()).map(|arm| Some(turn(&robot, arm, by)));
            robot.behave_all(orders.collect(), Until::All).await?;
        }
    }
    robot.report("waves", keys.times);
    nod(&robot, keys.swing).await?;
    measure(&robot).await?;
    Ok(format!("all arms have waved {} times", keys.times))
}

/// Has each ECP wave by itself, and waits until all have ended.
async fn apart(robot: Robot, keys: Keys) -> Result<String, Hindrance> {
    robot.phase("wave").await?;
    let arms = robot.arms().len();
    for arm in 0..arms {
        let programme = WaveAlone::programme("wave_alone", &(keys.times, keys.swing));
        robot.start(arm, programme?).await?;
    }
    let mut failed = Vec::new();
    for _ in 0..arms {
        match robot.receive(PATIENCE).await? {
            Some(Message::Ended { finish, .. }) if finish.achieved => {}
            Some(Message::Ended { finish, .. }) => failed.push(finish.reason),
            other => return Err(Hindrance(format!("an arm does not end: {other:?}"))),
        }
    }
    measure(&robot).await?;
    if failed.is_empty() {
        Ok(format!("each arm has waved {} times", keys.times))
    } else {
        Err(Hindrance(failed.join("; ")))
    }
}

/// Nods with the first arm.
async fn nod(robot: &Robot, angle: f64) -> Result<(), Hindrance> {
    let order = NodOrder { joint: NODS, angle, seconds: 2.0 };
    let nod = Nod::behaviour("nod", &order)?;
    robot.behave(0, nod).await?;
    Ok(())
}

/// Reports the distance of the hands by the sensor `gap`.
async fn measure(robot: &Robot) -> Result<(), Hindrance> {
    let gap: f64 = robot.sense("gap", 1.0).await?;
    robot.report("gap_mm", gap * 1e3);
    Ok(())
}

/// Programme of one arm: it waves by itself. Its order is the number of waves and the angle (rad).
pub struct WaveAlone;

impl EcpTask for WaveAlone {
    type Order = (u32, f64);
    type Kernel = RobotKernel;

    fn kernel((times, swing): (u32, f64)) -> RobotKernel {
        Robot::kernel(move |robot| async move {
            for _ in 0..times {
                for by in [swing, -2.0 * swing, swing] {
                    robot.behave(0, turn(&robot, 0, by)).await?;
                }
            }
            Ok(format!("waved {times} times"))
        })
    }
}

/// Returns the order that turns the wrist of an arm by an angle (rad).
fn turn(robot: &Robot, arm: usize, by: f64) -> Behaviour {
    let mut target = robot.arms()[arm].desired_joints;
    target.0[WRIST] += by;
    Behaviour::Joints { target, speed: 0.5, seconds: 0.0 }
}

/// Share of the angle by which each tool must have turned.
const TURNED: f64 = 0.8;
/// Largest turn of a tool from its first pose at the end (rad).
const BACK_TURNED: f64 = 0.01;

/// Largest error of the distance that the task reports (mm).
const MEASURED_WITHIN: f64 = 2.0;

/// Judge of the task: each tool must have turned, and be back, and the distance of the hands must
/// be the one that the task has measured.
#[derive(Default)]
pub struct BackAgain {
    /// First pose of each tool, and its greatest turn from there (rad).
    tools: Vec<(Pose, f64)>,
}

impl Verdict for BackAgain {
    type Task = Wave;

    fn watch(&mut self, _: u64, plant: &Plant) {
        let scene = plant.scene();
        for (arm, now) in scene.arms.iter().take(scene.arm_count).enumerate() {
            if self.tools.len() == arm {
                self.tools.push((now.world_from_tool, 0.0));
            }
            let (first, turned) = &mut self.tools[arm];
            *turned = turned.max(first.rotation.angle_to(&now.world_from_tool.rotation));
        }
    }

    fn judge(&self, keys: &Keys, truth: &Truth) -> Judgement {
        let tools = truth.tools();
        let moved = |(from, to): &(Pose, Pose)| (from.inverse() * to).translation.vector.norm();
        let farthest = tools.iter().map(moved).fold(0.0, f64::max);
        let off = |(from, to): &(Pose, Pose)| from.rotation.angle_to(&to.rotation);
        let back = farthest < BACK_WITHIN && tools.iter().all(|tool| off(tool) < BACK_TURNED);
        let least = self.tools.iter().map(|(_, turned)| *turned).fold(f64::INFINITY, f64::min);
        let waved = !self.tools.is_empty() && least > TURNED * keys.swing;
        let ends: Vec<_> = truth.tools().iter().map(|(_, to)| to.translation.vector).collect();
        let gap = if let [first, second] = ends[..] { (second - first).norm() } else { 0.0 };
        let told = truth.reported.get("gap_mm").and_then(|gap| gap.as_f64());
        let measured = told.is_some_and(|told| (told - gap * 1e3).abs() < MEASURED_WITHIN);
        let (turned, mm) = (least.to_degrees(), farthest * 1e3);
        let words = format!(
            "each tool turned by {turned:.1} deg; {mm:.1} mm from its place; gap of {:.1} mm",
            gap * 1e3
        );
        Judgement::new(waved && back && measured, words)
            .with("turned_deg", turned)
            .with("farthest_mm", farthest * 1e3)
            .with("true_gap_mm", gap * 1e3)
    }
}
