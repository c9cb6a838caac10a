//! The door of the task `carry_bar`: what a scenario must have for it, and how its kernel is made.

use super::keys::Keys;
use super::{CARRIERS, Job, ROOM, perform};
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
    const PROPERTIES: Properties = Properties {
        effectors: CARRIERS,
        coordination: &[Coordination::Continuous],
        ..Properties::PLAIN
    };

    fn check(keys: &mut Keys, config: &ControllerConfig, reader: &mut Reader) {
        if keys.way.is_empty() || keys.way.len() != keys.turns.len() {
            let reason = format!(
                "`carry_bar.turns_deg`: the way has {} points and {} turns; both need the same \
                 number, at least 1",
                keys.way.len(),
                keys.turns.len()
            );
            reader.fault("carry_bar.turns_deg", reason);
        }
        if keys.stop_force > config.control.force_limit {
            let reason = format!(
                "`carry_bar.stop_force_n`: {} N is above `control.force_limit_n`, {} N",
                keys.stop_force, config.control.force_limit
            );
            reader.fault("carry_bar.stop_force_n", reason);
        }
        if keys.rounds > 0 && config.cell.arms.len() <= CARRIERS {
            let reason = "`carry_bar.rounds`: there is no third [[effector]] that could go rounds";
            reader.fault("carry_bar.rounds", reason);
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
        let (keys, config) = (setup.keys.clone(), setup.config);
        for arm in config.cell.arms.iter().take(CARRIERS) {
            arm.opens_for("the bar", keys.width + ROOM)?;
        }
        let carriers = config.cell.arms.iter().take(CARRIERS);
        let arms = carriers.map(|a| (a.world_from_base, a.flange_from_tool));
        let share = (keys.speed / config.control.linear_speed).min(1.0);
        let limits = (config.control.grip, config.control.torque_limit);
        let job = Job::new(keys, arms.collect(), limits, share);
        Ok(Robot::kernel(|robot| perform(robot, job)))
    }
}
