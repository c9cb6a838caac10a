//! The kernel of MP that does nothing: the arms hold their places for a while.
//!
//! - in: nothing
//! - out: one order for each effector, then the end
//! - why: to try an arm, a bridge or the servo's timing without a task, with any number of effectors

use super::{Action, Effort, Event, Finish, Readings, Task, Until};
use crate::generators::Behaviour;

/// The kernel.
#[derive(Debug, Clone, Copy)]
pub struct Idle {
    seconds: f64,
}

impl Idle {
    /// Holds for this long [s].
    #[must_use]
    pub fn new(seconds: f64) -> Self {
        Self { seconds }
    }
}

impl Task for Idle {
    type Thought = ();
    type Conclusion = ();

    fn next(&mut self, event: Event<()>, readings: &Readings<'_>) -> Action<()> {
        let finish = |achieved, reason: String| Action::Finish(Finish { achieved, reason });
        match event {
            Event::Start => Action::Phase("idle"),
            Event::Done => {
                let order = Behaviour::Present {
                    pull: f64::INFINITY,
                    selector: [false; 6],
                    seconds: self.seconds,
                };
                let orders = std::array::from_fn(|i| (i < readings.arms.len()).then_some(order));
                Action::Behave { orders, until: Until::All }
            }
            Event::Trouble(reason) => finish(false, reason),
            Event::Behaved(_)
            | Event::Looked(_)
            | Event::Thought(())
            | Event::Answered(_)
            | Event::Ordered(..) => {
                finish(true, format!("the arms held their places for {:.0} s", self.seconds))
            }
        }
    }

    fn think((): ()) -> ((), Effort) {
        ((), Effort(0.0))
    }
}
