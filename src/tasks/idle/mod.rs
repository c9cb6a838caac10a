//! The kernel of MP that does nothing: the arms hold their places for a while.
//!
//! - in: nothing
//! - out: one order for each effector, then the end
//! - purpose: to try an arm, a bridge or the servo's timing without a task, with any number of
//!   effectors

mod door;
pub mod panel;

pub use door::{Idle, Keys};

use crate::generators::Behaviour;
use crate::kernel::Until;
use crate::kernel::robot::{Hindrance, Robot, RobotKernel};

/// Makes the kernel that holds all arms where they are for `seconds` (s).
#[must_use]
pub fn idle(seconds: f64) -> RobotKernel {
    Robot::kernel(|robot| hold(robot, seconds))
}

/// Holds all arms where they are, and returns what was done.
async fn hold(robot: Robot, seconds: f64) -> Result<String, Hindrance> {
    robot.phase("idle").await?;
    // No force reaches an infinite pull, so the behaviour ends by its time. An arm that something
    // pushes yields instead of holding its place, which is an alarm.
    let order = Behaviour::Present { pull: f64::INFINITY, selector: [false; 6], seconds };
    robot.behave_all(vec![Some(order); robot.arms().len()], Until::All).await?;
    Ok(format!("the arms held their places for {seconds:.0} s"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generators::Outcome;
    use crate::kernel::sensor::SensorReadings;
    use crate::kernel::{Action, Event, Finish, Forces, Kernel as _, Readings};
    use crate::motion::ArmState;

    /// Returns the end of the task whose two arms end their behaviours with these outcomes.
    fn ended(outcomes: [Outcome; 2]) -> Finish {
        let arms = [ArmState::default(); 2];
        let readings = Readings {
            arms: &arms,
            forces: &Forces::default(),
            sensors: &SensorReadings::default(),
        };
        let mut kernel = idle(20.0);
        assert_eq!(kernel.next(Event::Start, &readings), Action::Phase("idle"));
        let action = kernel.next(Event::Done, &readings);
        let Action::Behave { orders, .. } = action else { panic!("{action:?}") };
        assert!(orders.len() == 2 && orders.iter().all(Option::is_some), "{orders:?}");
        match kernel.next(Event::Behaved(outcomes.map(Some).into()), &readings) {
            Action::Finish(finish) => finish,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn pushed_arm_ends_idling_as_failure() {
        let waited = ended([Outcome::TimedOut(20.0), Outcome::Ended]);
        let pushed = ended([Outcome::Ended, Outcome::OverForce(2, 60.0)]);

        assert!(waited.achieved && waited.reason.contains("for 20 s"), "{waited:?}");
        assert!(!pushed.achieved && pushed.reason.contains("over-force of 60.0 N"), "{pushed:?}");
    }
}
