//! The gate between the operator and a run on the virtual clock: an input counts from the beginning
//! of a period on, never in the middle of one. So a run is repeatable from its inputs, those of the
//! operator among them.
//!
//! - in: the operator's control, inputs and emergency stop, at any time; or those of a recording
//! - out: the same, once a period, called by the driver; and each in the recording

use crate::actors::control::Control;
use crate::emergency_stop::{EmergencyStop, StopSignal};
use crate::operator::Input;
use crate::record::playback::Playback;
use crate::record::recorder::{Entry, Recorder};
use std::sync::Arc;
use tokio::sync::{mpsc, watch};

/// The gate.
pub(super) struct Gate {
    pub(super) outer: Outer,
    pub(super) inner: Inner,
    pub(super) recorder: Recorder,
    /// A recording whose inputs pass in place of the operator's.
    pub(super) playback: Option<Playback>,
}

/// The operator's side.
pub(super) struct Outer {
    /// Start, pause, resume, terminate.
    pub(super) control: watch::Receiver<Control>,
    /// The emergency stop at the desk.
    pub(super) stop: StopSignal,
    /// Answers and orders; `None` when no operator can be asked.
    pub(super) to_task: Option<mpsc::Receiver<Input>>,
}

/// The run's side.
pub(super) struct Inner {
    /// Start, pause, resume, terminate.
    pub(super) control: Arc<watch::Sender<Control>>,
    /// The emergency stop that the servos read.
    pub(super) stop: EmergencyStop,
    /// Answers and orders.
    pub(super) to_task: mpsc::Sender<Input>,
}

impl Gate {
    /// Lets inputs pass at the end of a period, numbered in periods of 2 ms.
    pub(super) fn pass(&mut self, period: u64) {
        for input in self.due(period) {
            self.recorder.note(period, || Entry::input(&input));
            self.inner.take(input);
        }
    }

    /// Returns the inputs that count from the next period on.
    fn due(&mut self, period: u64) -> Vec<Input> {
        let Some(playback) = &self.playback else { return self.given() };
        let mut due = Vec::new();
        while let Some(text) = playback.operator(period) {
            match serde_json::from_str(&text) {
                Ok(input) => due.push(input),
                Err(error) => tracing::warn!("{text}: {error}"),
            }
        }
        // The person who watches a replay may still break it off.
        if *self.outer.control.borrow() == Control::Terminated {
            self.inner.control.send_replace(Control::Terminated);
        }
        due
    }

    /// Returns the inputs that the operator gave since the last period.
    fn given(&mut self) -> Vec<Input> {
        let mut given = Vec::new();
        if self.outer.stop.is_pressed() && !self.inner.stop.signal().is_pressed() {
            given.push(Input::EmergencyStop);
        }
        let control = *self.outer.control.borrow();
        if control != *self.inner.control.borrow() {
            given.extend(control.input());
        }
        while self.inner.to_task.capacity() > given.len()
            && let Some(input) = self.outer.to_task.as_mut().and_then(|i| i.try_recv().ok())
        {
            given.push(input);
        }
        given
    }
}

impl Inner {
    fn take(&self, input: Input) {
        match input {
            Input::Resume => drop(self.control.send_replace(Control::Running)),
            Input::Pause => drop(self.control.send_replace(Control::Paused)),
            Input::Terminate => drop(self.control.send_replace(Control::Terminated)),
            Input::EmergencyStop => self.stop.button().press(),
            // There is room: the gate asked for it, and so it did when the input was recorded.
            Input::Answer { .. } | Input::Manual { .. } => drop(self.to_task.try_send(input)),
            // A run that reads its start has begun: before it there is no period. The others are no
            // inputs of the controller.
            Input::Start | Input::Speed { .. } | Input::Quit | Input::Seek { .. } => {}
        }
    }
}
