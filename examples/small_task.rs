//! A task in twenty lines: an arm turns its column, and reports how far its tool came.
//!
//!     cargo run --release --example small_task
//!
//! The library runs the task here. With `App::new().task::<Swing>("swing").main()` as the whole of
//! `main`, the program has all commands of `rubik-robot`, and scenarios may name the task. The
//! crate `own_cell` beside this file adds a verdict, a generator and a sensor.

use rubik_robot::generators::Behaviour;
use rubik_robot::kernel::robot::{Hindrance, Robot, RobotKernel};
use rubik_robot::record::summary::Summary;
use rubik_robot::registry::{Setup, Task};
use rubik_robot::run::{RunOptions, run};
use rubik_robot::{scenario, section, tasks};
use std::error::Error;
use std::path::Path;

section! {
    /// Keys of the task.
    Keys {
        /// Angle of the column.
        angle [deg]: f64 = 10.0, 1.0..=20.0;
    }
}

/// Task `swing`.
struct Swing;

impl Task for Swing {
    type Keys = Keys;
    type Kernel = RobotKernel;

    fn kernel(setup: Setup<'_, Self>) -> Result<RobotKernel, String> {
        let angle = setup.keys.angle;
        Ok(Robot::kernel(move |robot| swing(robot, angle)))
    }
}

/// Turns the column of the first arm by `angle` (rad). Returns the reason of the success.
async fn swing(robot: Robot, angle: f64) -> Result<String, Hindrance> {
    robot.phase("swing").await?;
    let before = robot.arms()[0];
    let mut target = before.desired_joints;
    target.0[1] += angle;
    robot.behave(0, Behaviour::Joints { target, speed: 0.2, seconds: 0.0 }).await?;
    let after = robot.arms()[0];
    let moved = before.base_from_tool.inverse() * after.base_from_tool;
    let distance = moved.translation.vector.norm() * 1e3;
    robot.report("moved_mm", distance);
    Ok(format!("the tool has moved by {distance:.1} mm"))
}

fn main() -> Result<(), Box<dyn Error>> {
    print!("{}", perform(10.0)?.table());
    Ok(())
}

/// Runs the task with this angle (deg) on the arm of the track alone. Returns the summary.
pub(crate) fn perform(angle: f64) -> Result<Summary, Box<dyn Error>> {
    let catalogue = tasks::built_in().task::<Swing>("swing").catalogue();
    let text = format!(
        "task = \"swing\"\n[swing]\nangle_deg = {angle:?}\n[[effector]]\nname = \"track\"\n"
    );
    let scenario = scenario::read(Path::new("swing"), &text, &[], &catalogue)?;
    let options = RunOptions { automatic: true, quiet: true, ..RunOptions::default() };
    Ok(run(&scenario, options)?)
}
