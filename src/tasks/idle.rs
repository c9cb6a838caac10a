//! The kernel of MP that does nothing: the arms hold their places for a while.
//!
//! - in: nothing
//! - out: one order for each effector, then the end
//! - purpose: to try an arm, a bridge or the servo's timing without a task, with any number of
//!   effectors

use super::procedure::{Port, Procedure};
use super::{Action, Effort, Event, Finish, Readings, Task, Until};
use crate::generators::Behaviour;

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
        let orders = std::array::from_fn(|i| (i < effectors).then_some(order));
        event = port.request(Action::Behave { orders, until: Until::All }).await;
    }
    match event {
        Event::Trouble(reason) => Finish { achieved: false, reason },
        _ => Finish {
            achieved: true,
            reason: format!("the arms held their places for {seconds:.0} s"),
        },
    }
}

impl Task for Idle {
    type Thought = ();
    type Conclusion = ();

    fn next(&mut self, event: Event<()>, readings: &Readings<'_>) -> Action<()> {
        self.procedure.port().state(|effectors| *effectors = readings.arms.len());
        self.procedure.next(event)
    }

    fn think((): ()) -> ((), Effort) {
        ((), Effort(0.0))
    }
}
