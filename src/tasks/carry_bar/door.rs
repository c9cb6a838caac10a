//! The door of the task `carry_bar`: what a scenario must have for it, and how its kernel is made.

use super::keys::Keys;
use super::{Job, carry};
use crate::kernel::robot::{Robot, RobotKernel};
use crate::registry::{Setup, Task};
use crate::scenario::ControllerConfig;
use crate::scenario::declared::Properties;
use crate::scenario::keys::Coordination;
use crate::scenario::section::Reader;

/// Task `carry_bar`: both hands carry a bar.
#[derive(Debug)]
pub struct CarryBar;

impl Task for CarryBar {
    type Keys = Keys;
    type Kernel = RobotKernel;
    // Both hands must be at the same place of the way at each moment.
    const PROPERTIES: Properties =
        Properties { coordination: &[Coordination::Continuous], ..Properties::PLAIN };

    fn check(keys: &mut Keys, config: &ControllerConfig, reader: &mut Reader) {
        if config.cell.arms.len() != 2 {
            reader.fault("task", "task \"carry_bar\" needs two effectors");
        }
        if keys.way.is_empty() || keys.way.len() != keys.turns.len() {
            let reason = format!(
                "`carry_bar.turns_deg`: the way has {} points and {} turns; both need the same \
                 number, at least 1",
                keys.way.len(),
                keys.turns.len()
            );
            reader.fault("carry_bar.turns_deg", reason);
        }
        let full = config.control.linear_speed;
        if keys.speed > full {
            let reason = format!(
                "`carry_bar.speed_mm_s`: {:.0} is faster than `control.linear_speed_mm_s`, {:.0}",
                keys.speed * 1e3,
                full * 1e3
            );
            reader.fault("carry_bar.speed_mm_s", reason);
        }
    }

    fn kernel(setup: Setup<'_, Self>) -> Result<RobotKernel, String> {
        let job = Job::new(setup.keys.clone(), setup.config)?;
        Ok(Robot::kernel(|robot| carry(robot, job)))
    }
}
