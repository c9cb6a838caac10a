//! The shell around the kernel of a programme: it carries out the kernel's actions with one
//! effector.
//!
//! - in: the actions of the kernel, signals of MP
//! - out: events for the kernel; signals and the end of the programme for MP, each with the tool
//!   frame in force
//!
//! A motion whose path is not free is refused, and one that is too fast near the operator gets more
//! time, by the same checks as the motions that MP orders (`surroundings`).
//!
//! A non-fatal error is an event for the kernel. Any other error ends the programme, and MP gets
//! its reason: the programmes of other effectors go on. An error of the whole system ends the run,
//! since the watchdog raises it.

use super::outbox::Outbox;
use super::{Ecp, Reply, Request};
use crate::actors::control::{Control, Terminated, permission_soon};
use crate::actors::notice::Notice;
use crate::actors::sensor::readings;
use crate::error::{Error, NonFatal};
use crate::generators::Behaviour;
use crate::kernel::programme::EcpKernel;
use crate::kernel::{Action, Event, Finish, Forces, Message, Programme, Readings, WristLoad};
use crate::motion::{ArmState, PERIOD};
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::sync::mpsc::error::TryRecvError;

/// Time between two looks at the control of the run, while a kernel waits for a signal.
const LOOK: Duration = Duration::from_millis(20);

/// Reason why a programme cannot go on.
enum Stop {
    /// The operator has terminated the run, or MP is gone.
    Terminated,
    /// Fault of the effector or the system.
    Error(Error),
}

impl From<Terminated> for Stop {
    fn from(_: Terminated) -> Self {
        Self::Terminated
    }
}

impl Ecp {
    /// Begins a programme, says by `reply` whether it can, carries it out to its end, and tells MP
    /// how it has ended.
    pub(super) async fn perform(
        &mut self,
        programme: &Programme,
        to_mp: &Outbox,
        reply: Reply<()>,
    ) {
        let mut kernel = match self.parts.programmes.kernel(programme) {
            Ok(kernel) => kernel,
            Err(why) => {
                let (actor, cause) = (self.name.clone(), NonFatal::Arguments(why));
                let _ = reply.send(Err(Error::NonFatal { actor, place: "start".into(), cause }));
                return;
            }
        };
        let _ = reply.send(Ok(()));
        self.signals.clear();
        let finish = match self.carry_out(&mut kernel, to_mp).await {
            Ok(finish) => finish,
            Err(Stop::Terminated) => {
                Finish { achieved: false, reason: "terminated by the operator".to_owned() }
            }
            Err(Stop::Error(error)) => {
                let now = self.now();
                self.parts.services.trace.tell(Notice::Error(now, error.clone()));
                Finish { achieved: false, reason: error.to_string() }
            }
        };
        self.parts.services.trace.message(&self.name, "mp", &finish);
        to_mp.send(Message::Ended { effector: to_mp.effector, finish }, self.tool);
    }

    /// Asks the kernel for actions and carries them out until it finishes.
    async fn carry_out(&mut self, kernel: &mut EcpKernel, to_mp: &Outbox) -> Result<Finish, Stop> {
        let mut event = Event::Start;
        let mut forces = Forces { arms: vec![WristLoad::default()] };
        loop {
            let state = self.permitted().await?;
            self.serve(&state)?;
            note_forces(&mut forces.arms[0], &state);
            self.parts.services.trace.message(&self.name, "kernel", &event);
            let sensors = readings(&self.parts.sensors);
            let readings = Readings { arms: &[state], forces: &forces, sensors: &sensors };
            let action = kernel.next(event, &readings);
            self.parts.services.trace.message("kernel", &self.name, &action);
            for note in kernel.notes() {
                self.parts.services.trace.tell(Notice::remark(self.now(), &self.name, note));
            }
            event = match action {
                Action::Finish(finish) => return Ok(finish),
                Action::Defect(why) => return Ok(Finish { achieved: false, reason: why }),
                action => self.act(action, to_mp).await?,
            };
        }
    }

    /// Carries out an action of the kernel and returns the event with which the kernel continues.
    async fn act(&mut self, action: Action<()>, to_mp: &Outbox) -> Result<Event<()>, Stop> {
        let done = match action {
            Action::Phase(name) => {
                let note = Notice::Note(self.now(), format!("{} begins: {name}", self.name));
                self.parts.services.trace.tell(note);
                Ok(Event::Done)
            }
            Action::Behave { orders, .. } => match orders.into_iter().next().flatten() {
                Some(order) => self.move_by(order).await,
                None => Ok(Event::Behaved(vec![None])),
            },
            Action::Bias(which) if which.first() == Some(&true) => {
                let zeroed = self.heartbeat.away(self.parts.edp.bias()).await;
                zeroed.map(|_| Event::Done)
            }
            Action::Bias(_) => Ok(Event::Done),
            // The only effector of a programme is its own.
            Action::Adjust { effector: 0, adjustment } => {
                self.adjust(adjustment).await.map(|_| Event::Done)
            }
            Action::Signal { signal, .. } => {
                self.parts.services.trace.message(&self.name, "mp", &signal);
                to_mp.send(Message::Signal { effector: to_mp.effector, signal }, self.tool);
                Ok(Event::Done)
            }
            Action::Receive(seconds) => return self.receive(seconds).await,
            other => Ok(Event::Trouble(format!("an ECP cannot carry out {other:?}"))),
        };
        match done {
            Ok(event) => Ok(event),
            Err(error @ Error::NonFatal { .. }) => {
                let now = self.now();
                self.parts.services.trace.tell(Notice::Error(now, error.clone()));
                Ok(Event::Trouble(error.to_string()))
            }
            Err(error) => Err(Stop::Error(error)),
        }
    }

    /// Carries out a behaviour to its end if its path is free. Returns its outcome as an event.
    async fn move_by(&mut self, mut order: Behaviour) -> Result<Event<()>, Error> {
        let arm = self.heartbeat.away(self.parts.edp.state()).await?;
        if let Some(surroundings) = &self.parts.surroundings {
            let manner = &self.parts.manner;
            surroundings.admit(&mut order, manner, (&arm, self.tool)).map_err(|cause| {
                Error::NonFatal { actor: self.name.clone(), place: "check a path".into(), cause }
            })?;
        }
        let (outcome, _) = self.behave_from(&order, arm, 0).await?;
        Ok(Event::Behaved(vec![Some(outcome)]))
    }

    /// Waits for a signal of MP, at most for `seconds` (s).
    async fn receive(&mut self, seconds: f64) -> Result<Event<()>, Stop> {
        let until = self.now() + seconds;
        loop {
            // The state shows a fault of the arm meanwhile, and the pause holds the time.
            let state = self.permitted().await?;
            self.serve(&state)?;
            if let Some(signal) = self.signals.pop_front() {
                self.parts.services.trace.message("mp", &self.name, &signal);
                return Ok(Event::Received(Some(Message::Signal { effector: 0, signal })));
            }
            if self.now() >= until {
                return Ok(Event::Received(None));
            }
            self.heartbeat.away(tokio::time::sleep(LOOK)).await;
        }
    }

    /// Waits while the run is paused, and returns the state of the arm.
    async fn permitted(&mut self) -> Result<ArmState, Stop> {
        loop {
            self.alive.fetch_add(1, Ordering::Relaxed);
            self.fault.occur().await;
            let state = self.heartbeat.away(self.parts.edp.state()).await;
            let state = state.map_err(Stop::Error)?;
            let control = &mut self.parts.services.control;
            if *control.borrow() == Control::Terminated {
                return Err(Stop::Terminated);
            }
            if let Some(permission) = self.heartbeat.away(permission_soon(control)).await {
                permission?;
                return Ok(state);
            }
            self.serve(&state)?;
        }
    }

    /// Serves the requests of MP that have arrived: `state` is the present one of the arm.
    fn serve(&mut self, state: &ArmState) -> Result<(), Stop> {
        loop {
            match self.mailbox.try_recv() {
                Ok(Request::State { reply }) => {
                    let _ = reply.send(Ok(*state));
                }
                Ok(Request::Signal(signal)) => self.signals.push_back(signal),
                // No motion is under way that could end, and MP orders no other work meanwhile.
                Ok(_) => {}
                Err(TryRecvError::Empty) => return Ok(()),
                Err(TryRecvError::Disconnected) => return Err(Stop::Terminated),
            }
        }
    }

    /// Returns the time of the run (s).
    fn now(&self) -> f64 {
        self.parts.services.clock.period() as f64 * PERIOD
    }
}

/// Updates the force and torque at the wrist from the present state of the arm.
fn note_forces(load: &mut WristLoad, state: &ArmState) {
    load.force = state.wrench_in_tool.force.norm();
    load.torque = state.wrench_in_tool.torque.norm();
    load.peak_force = load.peak_force.max(load.force);
    load.peak_torque = load.peak_torque.max(load.torque);
}
