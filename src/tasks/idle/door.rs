//! The door of the task `idle`: its keys, and the choice of its kernel.

use super::idle;
use super::panel::{self, ArmLimits, Panel};
use crate::actors::present;
use crate::cell::Arm;
use crate::kernel::robot::RobotKernel;
use crate::kernel::{Action, Event, Kernel, Progress, Readings, Remark};
use crate::registry::{Setup, Task};
use crate::scenario::ControllerConfig;
use crate::scenario::declared::Properties;
use crate::scenario::section::section;

section! {
    /// Keys of the task `idle`.
    pub Keys {
        /// Time for which the arms are held.
        time [s]: f64 = 10.0, 0.01..=86400.0;
    }
}

/// Task `idle`: the arms hold their positions, as a test of an arm, a bridge or the timing of the
/// servo. If there is an operator, he moves them by hand.
#[derive(Debug)]
pub struct Idle;

/// Kernel of the task `idle`.
#[derive(Debug)]
pub enum IdleKernel {
    /// The arms hold their places.
    Hold(RobotKernel),
    /// The operator moves the arms.
    ByHand(Panel),
}

impl Task for Idle {
    type Keys = Keys;
    type Kernel = IdleKernel;
    const PROPERTIES: Properties = Properties { by_hand: true, ..Properties::PLAIN };

    fn kernel(setup: Setup<'_, Self>) -> Result<IdleKernel, String> {
        Ok(if setup.has_operator {
            IdleKernel::ByHand(panel::panel(limits(setup.config)))
        } else {
            IdleKernel::Hold(idle(setup.keys.time))
        })
    }
}

/// Returns the limits and named poses of all arms.
fn limits(config: &ControllerConfig) -> Vec<ArmLimits> {
    let limits = |arm: &Arm| ArmLimits {
        has_track: arm.model.has_track,
        poses: present::poses(arm),
        world_from_base: arm.world_from_base,
        opening: arm.gripper.opening,
        grip: config.control.grip,
    };
    config.cell.arms.iter().map(limits).collect()
}

impl Kernel for IdleKernel {
    type Thought = ();
    type Entry = Progress;

    fn next(&mut self, event: Event<()>, readings: &Readings<'_>) -> Action<()> {
        match self {
            Self::Hold(kernel) => kernel.next(event, readings),
            Self::ByHand(kernel) => kernel.next(event, readings),
        }
    }

    fn notes(&mut self) -> Vec<Remark> {
        match self {
            Self::Hold(kernel) => kernel.notes(),
            Self::ByHand(kernel) => kernel.notes(),
        }
    }
}
