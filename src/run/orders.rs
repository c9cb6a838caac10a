//! Orders of parameters on their way into a run: from the operator, and from the scenario.
//!
//! - in: the operator's [`Orders`], the scenario's list `[[order]]`
//! - out: the inputs of a period; the [`Courses`] that the actors follow, and a notice of each
//!   change

use crate::actors::clock::Clock;
use crate::actors::notice::Notice;
use crate::actors::trace::Trace;
use crate::actors::tuning::Orders;
use crate::motion::PERIOD;
use crate::operator::parameter::{Courses, Declaration};
use crate::operator::{Input, Parameter};
use crate::record::recorder::Entry;
use crate::scenario::order_keys::ScriptedOrder;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;

/// Interval at which orders are read under the wall clock.
const GLANCE: Duration = Duration::from_millis(4);
/// Periods of 2 ms within which an order of the scenario takes effect: a servo period has at most
/// ten of them.
const SOON: u64 = 10;

/// Orders of the operator and of the scenario that have not been taken yet.
pub(super) struct Ordered {
    orders: watch::Receiver<Orders>,
    /// Orders of the operator that were taken.
    taken: Orders,
    /// Orders of the scenario that are still to come.
    script: VecDeque<ScriptedOrder>,
}

impl Ordered {
    /// Makes the list of the orders of the operator and of the scenario.
    pub(super) fn new(orders: watch::Receiver<Orders>, script: &[ScriptedOrder]) -> Self {
        let script = script.iter().copied().collect();
        Self { orders, taken: Orders::default(), script }
    }

    /// Takes the orders that are due after `period` (of 2 ms).
    pub(super) fn due(&mut self, period: u64) -> Vec<Input> {
        let mut due = Vec::new();
        while let Some(&ScriptedOrder { parameter, value, .. }) =
            self.script.front().filter(|order| order.period <= period)
        {
            self.script.pop_front();
            due.push(Input::Parameter { parameter, value });
        }
        let orders = *self.orders.borrow();
        due.extend(orders.since(&self.taken));
        self.taken = orders;
        due
    }
}

/// Receiver of orders at the run's side: it changes the courses that the actors follow.
#[derive(Clone)]
pub(super) struct Tuner {
    /// Courses of all parameters.
    pub(super) courses: Arc<watch::Sender<Courses>>,
    /// Time between an order and the beginning of its change (periods of 2 ms), so that it has
    /// reached each node by then.
    pub(super) lag: u64,
    /// Trace for the notices.
    pub(super) trace: Trace,
    /// Orders of the scenario.
    pub(super) script: Vec<ScriptedOrder>,
}

impl Tuner {
    /// Orders a value of a parameter after `period` (of 2 ms), and reports the change.
    pub(super) fn order(&self, parameter: Parameter, value: f64, period: u64) {
        let before = self.courses.borrow().value(parameter, period);
        self.courses.send_modify(|courses| courses.order(parameter, value, period + self.lag));
        self.trace.tuned(*self.courses.borrow());
        let is_scripted = self.script.iter().any(|order| {
            let is_due = order.period <= period && period < order.period + SOON;
            is_due && order.parameter == parameter && order.value.to_bits() == value.to_bits()
        });
        let who = if is_scripted { "the scenario" } else { "the operator" };
        let Declaration { name, unit, .. } = parameter.declaration();
        // A value on its way has more digits than a person needs.
        let before = (before * 1e4).round() * 1e-4;
        let text = format!("parameter {name}: from {before} to {value} {unit}, by {who}");
        self.trace.tell(Notice::Note(period as f64 * PERIOD, text.replace(" ,", ",")));
    }

    /// Takes orders under the wall clock, which has no gate for them, and records each.
    pub(super) async fn follow(self, mut ordered: Ordered, clock: Clock) {
        let mut glance = tokio::time::interval(GLANCE);
        loop {
            glance.tick().await;
            let period = clock.period();
            for input in ordered.due(period) {
                self.trace.recorder().record(period, || Entry::input(&input));
                if let Input::Parameter { parameter, value } = input {
                    self.order(parameter, value, period);
                }
            }
        }
    }
}
