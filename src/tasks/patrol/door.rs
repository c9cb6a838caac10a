//! The door of the task `patrol`.

use super::keys::Keys;
use super::{Order, patrol};
use crate::kernel::robot::RobotKernel;
use crate::registry::{Setup, Task};
use crate::scenario::declared::Properties;
use crate::scenario::keys::Coordination;

/// Task `patrol`: each arm goes its rounds by itself.
#[derive(Debug)]
pub struct Patrol;

impl Task for Patrol {
    type Keys = Keys;
    type Kernel = RobotKernel;
    const PROPERTIES: Properties =
        Properties { coordination: &[Coordination::Absent], ..Properties::PLAIN };

    fn kernel(setup: Setup<'_, Self>) -> Result<RobotKernel, String> {
        let Keys { rounds, angle } = *setup.keys;
        Ok(patrol(Order { rounds, angle }))
    }
}
