//! The operator's desk: the channels between the operator's UIs and a run.
//!
//! - a UI (page, terminal, keys) has a [`UiEnd`]: the latest snapshot and pictures, and a queue for
//!   inputs
//! - a run (its UI actor, a replay) has a [`RunEnd`]: each value that it publishes replaces the one
//!   before, so a run never waits for a slow UI
//! - the [`Desk`] outlives a run: the same UIs show the next run

use crate::emergency_stop::{EmergencyStop, StopButton, StopSignal};
use crate::operator::{Input, Snapshot, Stage};
use crate::record::feed::Feed;
use image::RgbImage;
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::mpsc::error::TryRecvError;
use tokio::sync::{mpsc, watch};

/// Capacity of the queue of inputs: a person gives one at a time.
const INPUTS: usize = 32;

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

    /// Prepares the desk for another run after one has returned: releases the emergency stop and
    /// drops the inputs that no run took. The UIs show the last run until the next one publishes.
    ///
    /// A first run needs no call: a stop that is pressed before it begins must count.
    pub fn prepare_next_run(&self) {
        self.stop.release();
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
    to_run: mpsc::Sender<Input>,
    button: StopButton,
}

impl UiEnd {
    /// Queues an input for the run, also before a run takes inputs. Returns `false` if the input is
    /// lost, because the queue is full or the desk is gone.
    #[must_use]
    pub fn send(&self, input: Input) -> bool {
        if input == Input::EmergencyStop {
            // The press bypasses all queues: the servo reads the flag in its next period. The input
            // itself only informs the run.
            self.button.press();
        }
        self.to_run.try_send(input).is_ok()
    }
}

/// Endpoint of the desk for a run.
#[derive(Debug, Clone)]
pub struct RunEnd {
    /// Stage of the run, which changes only when a calibration corrects the cameras.
    pub stage: Arc<watch::Sender<Arc<Stage>>>,
    /// Snapshots.
    pub snapshots: Arc<watch::Sender<Arc<Snapshot>>>,
    /// Pictures; published before the snapshot that names them.
    pub pictures: Arc<watch::Sender<Pictures>>,
    /// Messages of the run, as a recording has them.
    pub feed: Feed,
    button: StopButton,
    signal: StopSignal,
    inputs: Arc<Mutex<Option<mpsc::Receiver<Input>>>>,
    to_run: mpsc::Sender<Input>,
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
            to_run: self.to_run.clone(),
            button: self.button.clone(),
        }
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
    receiver: Option<mpsc::Receiver<Input>>,
    /// Place at the desk to which the receiver returns.
    from: Arc<Mutex<Option<mpsc::Receiver<Input>>>>,
}

impl Inputs {
    /// Waits for the next input. It never returns `None` while a [`Desk`] or [`RunEnd`] exists.
    pub async fn recv(&mut self) -> Option<Input> {
        self.receiver.as_mut()?.recv().await
    }

    /// Returns the next input if there is one already.
    ///
    /// # Errors
    /// [`TryRecvError::Empty`] if there is none.
    pub fn try_recv(&mut self) -> Result<Input, TryRecvError> {
        self.receiver.as_mut().map_or(Err(TryRecvError::Disconnected), mpsc::Receiver::try_recv)
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

    #[test]
    fn emergency_stop_works_when_input_queue_is_full() {
        let (ui, run) = Desk::default().ends();
        while ui.send(Input::Pause) {}

        assert!(!ui.send(Input::EmergencyStop), "the queue is full");

        assert!(run.stop_signal().is_pressed());
    }

    #[test]
    fn ui_sees_the_latest_snapshot_only() {
        let (ui, run) = Desk::default().ends();
        for number in 1..=1000 {
            run.snapshots.send_replace(Arc::new(Snapshot { number, ..Snapshot::default() }));
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
