//! The kernel of MP that does nothing: the arms hold their places for a while.
//!
//! - in: nothing
//! - out: one order for each effector, then the end
//! - purpose: to try an arm, a bridge or the servo's timing without a task, with any number of
//!   effectors

use super::procedure::{Port, Procedure};
use super::{Action, Effort, Event, Finish, Progress, Readings, Task, Until};
use crate::generators::{Behaviour, Outcome};

/// Kernel of MP that holds all arms where they are.
#[derive(Debug)]
pub struct Idle {
    /// The shared state behind the port is the number of effectors.
    procedure: Procedure<(), (), usize>,
}

impl Idle {
    /// Makes a kernel that holds the arms for `seconds` (s).
    #[must_use]
    pub fn new(seconds: f64) -> Self {
        let port = Port::new(0);
        Self { procedure: Procedure::new(port.clone(), hold(port, seconds)) }
    }
}

/// Holds all arms where they are, and returns the end of the task.
async fn hold(port: Port<(), (), usize>, seconds: f64) -> Finish {
    let mut event = port.request(Action::Phase("idle")).await;
    if !matches!(event, Event::Trouble(_)) {
        // No force reaches an infinite pull, so the behaviour ends by its time.
        let pull = f64::INFINITY;
        let order = Behaviour::Present { pull, selector: [false; 6], seconds };
        let effectors = port.state(|effectors| *effectors);
        let orders = vec![Some(order); effectors];
        event = port.request(Action::Behave { orders, until: Until::All }).await;
    }
    let hindrance = match event {
        Event::Trouble(reason) => Some(reason),
        // An arm that something pushes yields instead of holding its place.
        Event::Behaved(outcomes) => {
            outcomes.into_iter().flatten().find(Outcome::alarms).map(|met| met.to_string())
        }
        _ => None,
    };
    let held = || format!("the arms held their places for {seconds:.0} s");
    Finish { achieved: hindrance.is_none(), reason: hindrance.unwrap_or_else(held) }
}

impl Task for Idle {
    type Thought = ();
    type Conclusion = ();
    type Entry = Progress;

    fn next(&mut self, event: Event<()>, readings: &Readings<'_>) -> Action<()> {
        self.procedure.port().state(|effectors| *effectors = readings.arms.len());
        self.procedure.next(event)
    }

    fn think((): ()) -> ((), Effort) {
        ((), Effort(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::ArmState;
    use crate::tasks::Forces;

    /// Returns the end of the task whose two arms end their behaviours with these outcomes.
    fn ended(outcomes: [Outcome; 2]) -> Finish {
        let arms = [ArmState::default(); 2];
        let readings = Readings { arms: &arms, forces: &Forces::default() };
        let mut idle = Idle::new(20.0);
        assert_eq!(idle.next(Event::Start, &readings), Action::Phase("idle"));
        let action = idle.next(Event::Done, &readings);
        let Action::Behave { orders, .. } = action else { panic!("{action:?}") };
        assert!(orders.len() == 2 && orders.iter().all(Option::is_some), "{orders:?}");
        match idle.next(Event::Behaved(outcomes.map(Some).into()), &readings) {
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
