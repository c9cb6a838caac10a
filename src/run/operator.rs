//! Operator's side of a run: the UI actor, and the channels by which the operator's control, inputs
//! and emergency stop reach the run.
//!
//! - in: the desk of the UIs, if there is one
//! - out: the channels; under virtual time behind a [`Gate`], through which inputs pass between two
//!   periods only

use super::failure::not_created;
use super::gate::{Gate, Inner, Outer};
use super::options::{RunContext, RunOptions};
use super::orders::{Ordered, Tuner};
use super::recording;
use crate::actors::clock::Clock;
use crate::actors::control::{Control, Tempo};
use crate::actors::latest::LatestValues;
use crate::actors::present::{self, Presenter};
use crate::actors::trace::Trace;
use crate::actors::tuning::Orders;
use crate::actors::ui::{OperatorControls, Parts, Ui};
use crate::emergency_stop::{EmergencyStop, StopButton, StopSignal};
use crate::error::Error;
use crate::operator::Input;
use crate::operator::parameter::Courses;
use crate::record::playback::Playback;
use crate::record::run_hash::RunHash;
use crate::scenario::Scenario;
use std::sync::Arc;
use std::time::Instant;
use tokio::sync::{mpsc, watch};

/// Largest number of orders and answers that wait for MP.
const INPUTS: usize = 4;

/// Channels between the operator and a run.
pub(super) struct OperatorChannels {
    /// Trace of the run: notices to the operator, hash, recording, latest values.
    pub(super) trace: Trace,
    /// Button of the emergency stop that the servos read.
    pub(super) stop_button: StopButton,
    /// Emergency stop that the servos read.
    pub(super) stop_signal: StopSignal,
    /// Start, pause, resume, terminate.
    pub(super) control: Arc<watch::Sender<Control>>,
    /// Answers and orders to MP; `None` when no operator can be asked.
    pub(super) to_task: Option<mpsc::Receiver<Input>>,
    /// Limit of the speed of simulated time.
    pub(super) tempo: Tempo,
    /// Orders of parameters.
    orders: watch::Receiver<Orders>,
    /// Receiver of the orders.
    pub(super) tuner: Tuner,
}

/// Starts the UI actor of a run. Returns it with the channels that it serves.
///
/// # Errors
/// If the UI's thread cannot be created.
pub(super) fn start_ui(
    scenario: &Scenario,
    options: RunOptions,
    context: &RunContext,
) -> Result<(Ui, OperatorChannels), Error> {
    let initial = if options.wait { Control::Waiting } else { Control::Running };
    let control = Arc::new(watch::channel(initial).0);
    let tempo = Tempo::default();
    tempo.set(options.speed);
    let (to_task, inputs) = mpsc::channel(INPUTS);
    let orders = Arc::new(watch::channel(Orders::default()).0);
    let bounds = scenario.controller.bounds;
    let latest = context.desk.as_ref().map(|_| LatestValues::default());
    // Without a desk there is no UI, so no snapshots are made.
    let presenter = context.desk.as_ref().zip(latest.clone()).map(|(desk, latest)| {
        let stage = present::stage(scenario);
        desk.stage.send_replace(Arc::new(stage.clone()));
        Presenter::new(stage, &scenario.controller, latest)
    });
    let parts = Parts {
        quiet: options.quiet,
        keys: !options.automatic,
        alone: context.desk.is_none() || context.watched,
        controls: OperatorControls {
            control: Arc::clone(&control),
            to_task,
            tempo: tempo.clone(),
            orders: Arc::clone(&orders),
            bounds,
        },
        desk: context.desk.clone(),
        presenter,
        latest,
        recorder: context.recorder.clone(),
        // The run reads the hash at its end, when it covers all traces.
        hash: RunHash::default(),
    };
    let ui = Ui::spawn(parts).map_err(|e| not_created("ui", &e.to_string()))?;
    // In a verification, an operator can be asked if one could be asked in the recorded run.
    let operated = context.desk.is_some() && !context.watched;
    let attended = operated || context.playback.as_ref().is_some_and(|(_, was)| *was);
    let channels = OperatorChannels {
        trace: ui.trace.clone(),
        stop_button: ui.stop_button.clone(),
        stop_signal: ui.stop_signal.clone(),
        control,
        to_task: attended.then_some(inputs),
        tempo,
        orders: orders.subscribe(),
        tuner: Tuner {
            courses: Arc::new(watch::channel(Courses::new(&bounds)).0),
            lag: scenario.controller.network.lag(),
            trace: ui.trace.clone(),
            script: scenario.orders.clone(),
        },
    };
    Ok((ui, channels))
}

impl OperatorChannels {
    /// Waits until the operator starts the run, and records the start if `waits`, the option to
    /// wait for one, is set. No simulated time passes before the start, so a run does not depend on
    /// its moment.
    ///
    /// # Errors
    /// If no UI is left that could start it.
    pub(super) async fn started(&self, waits: bool) -> Result<(), Error> {
        let (mut control, begun) = (self.control.subscribe(), Instant::now());
        if control.wait_for(|will| *will != Control::Waiting).await.is_err() {
            return Err(not_created("control", "no UI is left to start the run"));
        }
        // The wait is not work of the run.
        self.tempo.held_back(begun.elapsed());
        // By the option, not by the state at the call: the operator may have started the run before
        // this function was called.
        if waits && *self.control.borrow() == Control::Running {
            recording::started(self.trace.recorder());
        }
        Ok(())
    }

    /// Puts a gate between the operator and the run. From now on `self` has the channels behind the
    /// gate. With a `playback` the gate passes its recorded inputs instead of the operator's.
    pub(super) fn close_gate(&mut self, playback: Option<&Playback>) -> Gate {
        let orders = self.ordered();
        let control = Arc::new(watch::channel(Control::Running).0);
        let (to_mp, inputs) = mpsc::channel(INPUTS);
        let inputs = self.to_task.is_some().then_some(inputs);
        let stop = EmergencyStop::default();
        // The operator's own stop is outside. Actors press the inner one, which the servos read.
        self.stop_button = stop.button();
        let outer = Outer {
            control: self.control.subscribe(),
            stop: std::mem::replace(&mut self.stop_signal, stop.signal()),
            to_task: std::mem::replace(&mut self.to_task, inputs),
        };
        self.control = Arc::clone(&control);
        let inner = Inner { control, stop, to_task: to_mp, tuner: self.tuner.clone() };
        let recorder = self.trace.recorder().clone();
        Gate { outer, orders, inner, recorder, playback: playback.cloned() }
    }

    /// Takes the orders of parameters under the wall clock, which has no gate for them.
    pub(super) fn follow_orders(&self, clock: &Clock) {
        tokio::spawn(self.tuner.clone().follow(self.ordered(), clock.clone()));
    }

    /// Returns the list of the orders of the operator and of the scenario.
    fn ordered(&self) -> Ordered {
        Ordered::new(self.orders.clone(), &self.tuner.script)
    }

    /// Records the inputs of a run under the wall clock, which has no gate to do so.
    pub(super) fn record_inputs(&mut self, clock: &Clock) {
        let (control, stop) = (self.control.subscribe(), self.stop_signal.clone());
        let outer = Outer { control, stop, to_task: self.to_task.take() };
        self.to_task = recording::follow(outer, clock.clone(), self.trace.recorder().clone());
    }
}
