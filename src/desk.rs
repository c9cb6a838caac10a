//! The operator's desk: the channels between the operator's UIs and a run.
//!
//! - a UI (page, terminal, keys) has a [`UiEnd`]: the latest snapshot and pictures, and a queue for
//!   inputs
//! - a run (its UI actor, a replay) has a [`RunEnd`]: each value that it publishes replaces the one
//!   before, so a run never waits for a slow UI
//! - the [`Desk`] outlives a run: the same UIs show the next run

use crate::emergency_stop::{EmergencyStop, StopButton, StopSignal};
use crate::operator::{History, Input, Snapshot, Stage};
use crate::record::feed::Feed;
use image::RgbImage;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::mpsc::error::TryRecvError;
use tokio::sync::{mpsc, watch};

/// Capacity of the queue of inputs: a person gives one at a time.
const INPUTS: usize = 32;
/// Age from which an order to move is out of date: a person who saw no answer may stand elsewhere.
const OUT_OF_DATE: Duration = Duration::from_millis(500);

/// A picture of a camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Number of the picture: [`CameraView::frame`](crate::operator::CameraView::frame).
    pub frame: u64,
    /// Pixels of the picture.
    pub pixels: Pixels,
}

/// The pixels of a picture, raw or as a file.
#[derive(Debug, Clone, PartialEq)]
pub enum Pixels {
    /// Raw pixels, 8 bits a channel.
    Raw(RgbImage),
    /// A JPEG or PNG file.
    File(Vec<u8>),
}

/// The latest picture of each camera, in the scenario's order; `None` before its first picture.
pub type Pictures = Vec<Option<Arc<Picture>>>;

/// An input with the time at which the operator gave it.
#[derive(Debug, Clone, PartialEq)]
pub struct Given {
    /// The input itself.
    pub input: Input,
    /// Time at which it was given; `None` for an input that a script may give beforehand.
    at: Option<Instant>,
}

impl Given {
    /// Makes an input that is given now, and obeyed whenever the run reads it.
    #[must_use]
    pub fn untimed(input: Input) -> Self {
        Self { input, at: None }
    }

    /// Makes an input that the operator gave at the time `at`.
    #[must_use]
    pub fn at(input: Input, at: Instant) -> Self {
        Self { input, at: Some(at) }
    }

    /// Returns the reason why the input is no longer obeyed, if it is an order to move that is out
    /// of date.
    #[must_use]
    pub fn refusal(&self) -> Option<String> {
        let age = self.at.filter(|_| self.input.moves())?.elapsed();
        (age > OUT_OF_DATE).then(|| {
            let late = age.as_secs_f64();
            format!("it came {late:.1} s late: an order to move is dropped after 0.5 s")
        })
    }
}

/// The desk, with the emergency stop that the operator presses at it.
#[derive(Debug)]
pub struct Desk {
    run_end: RunEnd,
    stop: EmergencyStop,
}

impl Default for Desk {
    /// Makes a desk without a run: the stop is released, and there are no inputs and pictures.
    fn default() -> Self {
        // The desk keeps the right to release the stop: a run gets handles only.
        let stop = EmergencyStop::default();
        let (to_run, inputs) = mpsc::channel(INPUTS);
        let run_end = RunEnd {
            stage: Arc::new(watch::channel(Arc::default()).0),
            snapshots: Arc::new(watch::channel(Arc::default()).0),
            pictures: Arc::new(watch::channel(Vec::new()).0),
            history: Arc::default(),
            feed: Feed::default(),
            button: stop.button(),
            signal: stop.signal(),
            inputs: Arc::new(Mutex::new(Some(inputs))),
            to_run,
        };
        Self { run_end, stop }
    }
}

impl Desk {
    /// Returns an endpoint of the desk for another UI.
    #[must_use]
    pub fn ui_end(&self) -> UiEnd {
        self.run_end.ui_end()
    }

    /// Returns the desk's endpoint for a run. One run at a time takes the inputs.
    #[must_use]
    pub fn run_end(&self) -> RunEnd {
        self.run_end.clone()
    }

    /// Returns one endpoint for a UI and the one for a run.
    #[must_use]
    pub fn ends(&self) -> (UiEnd, RunEnd) {
        (self.ui_end(), self.run_end())
    }

    /// Prepares the desk for another run after one has returned: releases the emergency stop, and
    /// drops the inputs that no run took and the history. The UIs show the last run until the next
    /// one publishes.
    ///
    /// A first run needs no call: a stop that is pressed before it begins must count.
    pub fn prepare_next_run(&self) {
        self.stop.release();
        self.run_end.replace_history(History::default());
        // Inputs to the last run, as a terminate, must not act on the next one.
        if let Some(mut inputs) = self.run_end.take_inputs() {
            while inputs.try_recv().is_ok() {}
        }
    }
}

/// Endpoint of the desk for a UI. Clones serve further UIs.
#[derive(Debug, Clone)]
pub struct UiEnd {
    /// Stage of the run; the default before a run has begun.
    pub stage: watch::Receiver<Arc<Stage>>,
    /// Latest snapshot.
    pub snapshots: watch::Receiver<Arc<Snapshot>>,
    /// Latest pictures.
    pub pictures: watch::Receiver<Pictures>,
    /// Messages of the run, as a recording has them.
    pub feed: Feed,
    history: Arc<Mutex<History>>,
    to_run: mpsc::Sender<Given>,
    button: StopButton,
}

impl UiEnd {
    /// Returns what `look` makes of the history of the run until now.
    pub fn history<T>(&self, look: impl FnOnce(&History) -> T) -> T {
        look(&self.history.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Queues an input for the run, also before a run takes inputs. Returns `false` if the input is
    /// lost, because the queue is full or the desk is gone.
    #[must_use]
    pub fn send(&self, input: Input) -> bool {
        self.give(Given::untimed(input))
    }

    /// Queues an input as [`Self::send`] does, with its time. The run drops an order to move that
    /// it reads too late.
    #[must_use]
    pub fn give(&self, given: Given) -> bool {
        if given.input == Input::EmergencyStop {
            // The press bypasses all queues: the servo reads the flag in its next period. The input
            // itself only informs the run.
            self.button.press();
        }
        self.to_run.try_send(given).is_ok()
    }
}

/// Endpoint of the desk for a run.
#[derive(Debug, Clone)]
pub struct RunEnd {
    /// Stage of the run, which changes only when a calibration corrects the cameras.
    pub stage: Arc<watch::Sender<Arc<Stage>>>,
    /// Snapshots; see [`Self::publish`].
    snapshots: Arc<watch::Sender<Arc<Snapshot>>>,
    /// Pictures; published before the snapshot that names them.
    pub pictures: Arc<watch::Sender<Pictures>>,
    history: Arc<Mutex<History>>,
    /// Messages of the run, as a recording has them.
    pub feed: Feed,
    button: StopButton,
    signal: StopSignal,
    inputs: Arc<Mutex<Option<mpsc::Receiver<Given>>>>,
    to_run: mpsc::Sender<Given>,
}

impl RunEnd {
    /// Returns an endpoint of the desk for another UI.
    #[must_use]
    pub fn ui_end(&self) -> UiEnd {
        UiEnd {
            stage: self.stage.subscribe(),
            snapshots: self.snapshots.subscribe(),
            pictures: self.pictures.subscribe(),
            feed: self.feed.clone(),
            history: Arc::clone(&self.history),
            to_run: self.to_run.clone(),
            button: self.button.clone(),
        }
    }

    /// Publishes a snapshot, and takes it into the history.
    pub fn publish(&self, snapshot: Snapshot) {
        self.history.lock().unwrap_or_else(PoisonError::into_inner).take(&snapshot);
        self.snapshots.send_replace(Arc::new(snapshot));
    }

    /// Returns the latest snapshot.
    #[must_use]
    pub fn latest(&self) -> Arc<Snapshot> {
        self.snapshots.borrow().clone()
    }

    /// Replaces the history, as that of a whole recording before it is shown.
    pub fn replace_history(&self, history: History) {
        *self.history.lock().unwrap_or_else(PoisonError::into_inner) = history;
    }

    /// Returns a handle that presses the emergency stop.
    #[must_use]
    pub fn stop_button(&self) -> StopButton {
        self.button.clone()
    }

    /// Returns a handle that reads the emergency stop.
    #[must_use]
    pub fn stop_signal(&self) -> StopSignal {
        self.signal.clone()
    }

    /// Returns the only receiver of the inputs, or `None` while another holder has it. Dropping it
    /// makes it available again.
    #[must_use]
    pub fn take_inputs(&self) -> Option<Inputs> {
        // No code under this lock can panic, so even a poisoned lock holds a sound value.
        let receiver = self.inputs.lock().unwrap_or_else(PoisonError::into_inner).take();
        let from = Arc::clone(&self.inputs);
        receiver.map(|receiver| Inputs { receiver: Some(receiver), from })
    }
}

/// The inputs of the operator, for one taker at a time. A drop of this value returns them for the
/// next taker.
#[derive(Debug)]
pub struct Inputs {
    /// Receiver of the inputs; `None` only while this value is dropped.
    receiver: Option<mpsc::Receiver<Given>>,
    /// Place at the desk to which the receiver returns.
    from: Arc<Mutex<Option<mpsc::Receiver<Given>>>>,
}

impl Inputs {
    /// Waits for the next input. It never returns `None` while a [`Desk`] or [`RunEnd`] exists.
    pub async fn recv(&mut self) -> Option<Given> {
        self.receiver.as_mut()?.recv().await
    }

    /// Returns the next input if there is one already, of whatever age.
    ///
    /// # Errors
    /// [`TryRecvError::Empty`] if there is none.
    pub fn try_recv(&mut self) -> Result<Input, TryRecvError> {
        let receiver = self.receiver.as_mut().ok_or(TryRecvError::Disconnected)?;
        receiver.try_recv().map(|given| given.input)
    }
}

impl Drop for Inputs {
    /// Returns the receiver to the desk.
    fn drop(&mut self) {
        // The next taker also gets the inputs that are still in the queue.
        *self.from.lock().unwrap_or_else(PoisonError::into_inner) = self.receiver.take();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::operator::{Manual, Step};

    #[test]
    fn emergency_stop_works_when_input_queue_is_full() {
        let (ui, run) = Desk::default().ends();
        while ui.send(Input::Pause) {}

        assert!(!ui.send(Input::EmergencyStop), "the queue is full");

        assert!(run.stop_signal().is_pressed());
    }

    #[test]
    fn only_orders_to_move_go_out_of_date() {
        let late = Instant::now().checked_sub(2 * OUT_OF_DATE).unwrap();
        let jog = Manual::Joint(Step { axis: 2, by: 0.1 });
        for order in [Input::Start, Input::Resume, Input::Manual { effector: 0, order: jog }] {
            let why = Given::at(order.clone(), late).refusal().unwrap();
            assert!(why.starts_with("it came 1.0 s late"), "{why}");
            assert_eq!(Given::at(order.clone(), Instant::now()).refusal(), None);
            assert_eq!(Given::untimed(order).refusal(), None);
        }
        for other in [Input::EmergencyStop, Input::Pause, Input::Terminate, Input::Quit] {
            assert_eq!(Given::at(other, late).refusal(), None);
        }
    }

    #[test]
    fn ui_sees_the_latest_snapshot_only() {
        let (ui, run) = Desk::default().ends();
        for number in 1..=1000 {
            run.publish(Snapshot { number, ..Snapshot::default() });
        }

        assert_eq!(ui.snapshots.borrow().number, 1000);
    }

    #[test]
    fn inputs_can_be_taken_only_once_until_returned() {
        let (ui, run) = Desk::default().ends();
        assert!(ui.send(Input::Pause));

        let inputs = run.take_inputs();
        assert!(run.take_inputs().is_none());
        drop(inputs);

        assert_eq!(run.take_inputs().unwrap().try_recv(), Ok(Input::Pause));
    }

    #[test]
    fn next_run_gets_no_input_of_previous_run() {
        let desk = Desk::default();
        let (ui, run) = desk.ends();
        assert!(ui.send(Input::Terminate) && ui.send(Input::EmergencyStop));

        desk.prepare_next_run();

        assert!(!run.stop_signal().is_pressed());
        assert_eq!(run.take_inputs().unwrap().try_recv(), Err(TryRecvError::Empty));
    }
}
