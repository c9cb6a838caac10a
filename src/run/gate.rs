//! Gate between the operator and a run under virtual time: inputs pass between two periods only. So
//! a run can be repeated from its inputs, including those of the operator.
//!
//! - in: the operator's control, inputs and emergency stop, at any time; or the inputs of a
//!   recording
//! - out: the inputs of each period, when the driver calls [`Gate::pass`]; each is recorded

use super::orders::{Ordered, Tuner};
use crate::actors::control::Control;
use crate::emergency_stop::{EmergencyStop, StopSignal};
use crate::operator::Input;
use crate::record::playback::Playback;
use crate::record::recorder::{Entry, Recorder};
use std::sync::Arc;
use tokio::sync::{mpsc, watch};

/// Gate between the operator and a run.
pub(super) struct Gate {
    /// Channels from the operator.
    pub(super) outer: Outer,
    /// Orders of parameters, those of the scenario too.
    pub(super) orders: Ordered,
    /// Channels to the run.
    pub(super) inner: Inner,
    /// Recorder of the inputs that pass.
    pub(super) recorder: Recorder,
    /// Recording whose inputs pass instead of the operator's.
    pub(super) playback: Option<Playback>,
}

/// Operator's side of the gate.
pub(super) struct Outer {
    /// Start, pause, resume, terminate.
    pub(super) control: watch::Receiver<Control>,
    /// Emergency stop at the desk.
    pub(super) stop: StopSignal,
    /// Answers and orders; `None` when no operator can be asked.
    pub(super) to_task: Option<mpsc::Receiver<Input>>,
}

/// Run's side of the gate.
pub(super) struct Inner {
    /// Start, pause, resume, terminate.
    pub(super) control: Arc<watch::Sender<Control>>,
    /// Emergency stop that the servos read.
    pub(super) stop: EmergencyStop,
    /// Answers and orders.
    pub(super) to_task: mpsc::Sender<Input>,
    /// Receiver of orders of parameters.
    pub(super) tuner: Tuner,
}

impl Gate {
    /// Passes the operator's inputs on to the run, at the end of a period of 2 ms, and records
    /// them.
    pub(super) fn pass(&mut self, period: u64) {
        for input in self.due(period) {
            self.recorder.record(period, || Entry::input(&input));
            self.inner.take(input, period);
        }
    }

    /// Returns the inputs that take effect after `period`: those of the recording that is verified,
    /// if there is one, otherwise those that the operator has given.
    fn due(&mut self, period: u64) -> Vec<Input> {
        let Some(playback) = &self.playback else { return self.given(period) };
        let mut due = Vec::new();
        while let Some(text) = playback.operator(period) {
            match serde_json::from_str(&text) {
                Ok(input) => due.push(input),
                // Another build may have recorded an input that this one does not know.
                Err(error) => tracing::warn!("{text}: {error}"),
            }
        }
        // The person at a replay may still terminate it.
        if *self.outer.control.borrow() == Control::Terminated {
            self.inner.control.send_replace(Control::Terminated);
        }
        due
    }

    /// Returns the inputs that the operator gave since the period before `period`, and the orders
    /// of the scenario that are due.
    fn given(&mut self, period: u64) -> Vec<Input> {
        let mut given = Vec::new();
        // A stop and a change of the control pass once: the inner side keeps them.
        if self.outer.stop.is_pressed() && !self.inner.stop.signal().is_pressed() {
            given.push(Input::EmergencyStop);
        }
        let control = *self.outer.control.borrow();
        if control != *self.inner.control.borrow() {
            given.extend(control.input());
        }
        // An input stays outside until the inner mailbox has room, so that a recorded input is
        // never lost. `given` also has control and stop, which need no room: the count errs on the
        // safe side.
        while self.inner.to_task.capacity() > given.len()
            && let Some(input) = self.outer.to_task.as_mut().and_then(|i| i.try_recv().ok())
        {
            given.push(input);
        }
        given.extend(self.orders.due(period));
        given
    }
}

impl Inner {
    /// Applies an input to the run after `period`.
    fn take(&self, input: Input, period: u64) {
        match input {
            Input::Resume => drop(self.control.send_replace(Control::Running)),
            Input::Pause => drop(self.control.send_replace(Control::Paused)),
            Input::Terminate => drop(self.control.send_replace(Control::Terminated)),
            Input::EmergencyStop => self.stop.button().press(),
            // The mailbox has room: the gate checked it now, or when the input was recorded.
            Input::Answer { .. } | Input::Manual { .. } => drop(self.to_task.try_send(input)),
            Input::Parameter { parameter, value } => self.tuner.order(parameter, value, period),
            // No period passes before the start, so a start has no effect here. The others are not
            // inputs of the controller.
            Input::Start
            | Input::Speed { .. }
            | Input::Quit
            | Input::Seek { .. }
            | Input::Again { .. }
            | Input::GoOn
            | Input::Replay
            | Input::Report => {}
        }
    }
}
