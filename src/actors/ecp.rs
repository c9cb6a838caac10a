//! ECP: the task's share of one effector.
//!
//! Under continuous coordination it transmits what MP computes; under sporadic coordination it runs the generators
//! of the behaviours that MP invokes, with the readings of the VSPs that belong to it.

use super::control::permission_soon;
use super::edp::EdpHandle;
use super::fault::ActorFault;
use super::move_instruction::{Manner, MoveInstruction};
use super::services::Services;
use super::vsp::VspHandle;
use super::watchdog::{Heartbeat, Supervision};
use crate::error::{Error, NonFatal, System};
use crate::generators::{Behaviour, Outcome};
use crate::motion::{ArmState, MoveCommand, PERIOD};
use crate::tasks::View;
use crate::vision::sensor::FaceReading;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::{mpsc, oneshot};
use tracing::Instrument as _;

/// Capacity of the mailbox: one request under way and one end from above.
const MAILBOX: usize = 4;

type Reply<T> = oneshot::Sender<Result<T, Error>>;

#[derive(Debug)]
enum Request {
    Transmit { command: MoveCommand, reply: Reply<ArmState> },
    Behave { behaviour: Behaviour, reply: Reply<(Outcome, ArmState)> },
    End,
    Bias { reply: Reply<ArmState> },
    Synchronise { reply: Reply<ArmState> },
    State { reply: Reply<ArmState> },
    Watch { on: bool },
    Look { view: View, reply: Reply<FaceReading> },
}

/// The far end of an ECP's mailbox. Dropping the last clone ends the ECP, and with it its EDP.
#[derive(Debug, Clone)]
pub struct EcpHandle {
    name: String,
    mailbox: mpsc::Sender<Request>,
    /// Counted up by the ECP while it lives.
    alive: Arc<AtomicU64>,
    patience: Duration,
}

impl EcpHandle {
    /// Passes a command on to the EDP (continuous coordination).
    ///
    /// # Errors
    /// Those of the EDP.
    pub async fn transmit(&self, command: MoveCommand) -> Result<ArmState, Error> {
        self.ask("transmit", |reply| Request::Transmit { command, reply }).await
    }

    /// Carries out a behaviour to its end (sporadic coordination).
    ///
    /// # Errors
    /// Those of the EDP.
    pub async fn behave(&self, behaviour: Behaviour) -> Result<(Outcome, ArmState), Error> {
        self.ask("behave", |reply| Request::Behave { behaviour, reply }).await
    }

    /// Ends the behaviour under way at its next macrostep.
    ///
    /// # Errors
    /// System when the ECP is gone.
    pub async fn end(&self) -> Result<(), Error> {
        self.mailbox.send(Request::End).await.map_err(|_| self.closed("end"))
    }

    /// Sets the force sensor to zero.
    ///
    /// # Errors
    /// Those of the EDP.
    pub async fn bias(&self) -> Result<ArmState, Error> {
        self.ask("bias", |reply| Request::Bias { reply }).await
    }

    /// Has the EDP find the synchronisation position.
    ///
    /// # Errors
    /// Those of the EDP.
    pub async fn synchronise(&self) -> Result<ArmState, Error> {
        self.ask("synchronise", |reply| Request::Synchronise { reply }).await
    }

    /// The effector's state.
    ///
    /// # Errors
    /// Those of the EDP.
    pub async fn state(&self) -> Result<ArmState, Error> {
        self.ask("state", |reply| Request::State { reply }).await
    }

    /// Switches the effector's own stand-alone sensor.
    ///
    /// # Errors
    /// System when the ECP is gone.
    pub async fn watch(&self, on: bool) -> Result<(), Error> {
        self.mailbox.send(Request::Watch { on }).await.map_err(|_| self.closed("watch"))
    }

    /// Reads a face with the camera in the effector's hand.
    ///
    /// # Errors
    /// Non-fatal when there is no such camera or the face was not found.
    pub async fn look(&self, view: View) -> Result<FaceReading, Error> {
        self.ask("look", |reply| Request::Look { view, reply }).await
    }

    fn closed(&self, place: &'static str) -> Error {
        Error::System { actor: self.name.clone(), place, cause: System::Closed(self.name.clone()) }
    }

    async fn ask<T>(
        &self,
        place: &'static str,
        request: impl FnOnce(Reply<T>) -> Request,
    ) -> Result<T, Error> {
        let (reply, mut answer) = oneshot::channel();
        self.mailbox.send(request(reply)).await.map_err(|_| self.closed(place))?;
        let mut last = self.alive.load(Ordering::Relaxed);
        let mut silent = 0;
        loop {
            // However long it takes, it must be seen to go on. Silent twice, since a clock that jumps makes nobody so.
            if let Ok(answer) = tokio::time::timeout(self.patience / 2, &mut answer).await {
                return answer.map_err(|_| self.closed(place))?;
            }
            let now = self.alive.load(Ordering::Relaxed);
            silent = if now == last { silent + 1 } else { 0 };
            if silent >= 2 && !matches!(place, "synchronise" | "look") {
                let seconds = self.patience.as_secs_f64();
                let cause = System::Silent { who: self.name.clone(), seconds };
                return Err(Error::System { actor: self.name.clone(), place, cause });
            }
            last = now;
        }
    }
}

/// What an ECP is made of.
pub struct Parts {
    /// Its effector's driver.
    pub edp: EdpHandle,
    /// The stand-alone camera's sensor, if it belongs to this ECP.
    pub tracker: Option<VspHandle>,
    /// The sensor of the camera in the hand, if it belongs to this ECP.
    pub hand_camera: Option<VspHandle>,
    /// How its generators behave.
    pub manner: Manner,
    /// The services of the run.
    pub services: Services,
}

struct Ecp {
    name: String,
    parts: Parts,
    mailbox: mpsc::Receiver<Request>,
    fault: Arc<ActorFault>,
    alive: Arc<AtomicU64>,
    heartbeat: Heartbeat,
}

/// Creates an ECP.
#[must_use]
pub fn spawn(name: &str, parts: Parts) -> EcpHandle {
    let (mailbox, requests) = mpsc::channel(MAILBOX);
    let name = format!("ecp {name}");
    let Supervision { watchdog, fault, patience } = parts.services.supervision.clone();
    let alive = Arc::default();
    // Between two signs of life lies a macrostep, and whatever the EDP may take for it.
    let macrostep = f64::from(parts.manner.compliance.macrostep) * PERIOD;
    let patience = Duration::from_secs_f64(2.0 * macrostep) + 2 * patience;
    let ecp = Ecp {
        name: name.clone(),
        parts,
        mailbox: requests,
        fault,
        alive: Arc::clone(&alive),
        heartbeat: watchdog.heartbeat(&name),
    };
    let span = tracing::info_span!("ecp", name = ecp.name);
    watchdog.spawn(&name, ecp.run().instrument(span));
    EcpHandle { name, mailbox, alive, patience }
}

impl Ecp {
    async fn run(mut self) {
        while let Some(request) = self.mailbox.recv().await {
            self.heartbeat.works();
            self.fault.before_message().await;
            let answers = !matches!(request, Request::End | Request::Watch { .. });
            if answers && self.fault.is_lost() {
                self.heartbeat.waits();
                continue;
            }
            self.alive.fetch_add(1, Ordering::Relaxed);
            match request {
                Request::Transmit { command, reply } => {
                    self.parts.services.trace.message("mp", &self.name, &command);
                    let answer = self.heartbeat.away(self.parts.edp.execute(command)).await;
                    let _ = reply.send(answer);
                }
                Request::Behave { behaviour, reply } => {
                    self.parts.services.trace.message("mp", &self.name, &behaviour);
                    tracing::debug!(?behaviour, "begins");
                    let answer = self.behave(&behaviour).await;
                    tracing::debug!(?answer, "ends");
                    self.parts.services.trace.message(&self.name, "mp", &answer);
                    let _ = reply.send(answer);
                }
                // Nothing under way: it has ended by itself in the meantime.
                Request::End => {}
                Request::Bias { reply } => {
                    self.parts.services.trace.message("mp", &self.name, &"bias");
                    let answer = self.heartbeat.away(self.parts.edp.bias()).await;
                    let _ = reply.send(answer);
                }
                Request::Synchronise { reply } => {
                    self.parts.services.trace.message("mp", &self.name, &"synchronise");
                    let answer = self.heartbeat.away(self.parts.edp.synchronise()).await;
                    let _ = reply.send(answer);
                }
                Request::State { reply } => {
                    let answer = self.heartbeat.away(self.parts.edp.state()).await;
                    let _ = reply.send(answer);
                }
                Request::Watch { on } => {
                    self.parts.services.trace.message("mp", &self.name, &("watch", on));
                    if let Some(tracker) = &self.parts.tracker {
                        tracker.track(on);
                    }
                }
                Request::Look { view, reply } => {
                    self.parts.services.trace.message("mp", &self.name, &view);
                    let answer = self.heartbeat.away(self.look(view)).await;
                    self.parts.services.trace.message(&self.name, "mp", &answer);
                    let _ = reply.send(answer);
                }
            }
            self.heartbeat.waits();
        }
    }

    async fn behave(&mut self, behaviour: &Behaviour) -> Result<(Outcome, ArmState), Error> {
        let mut motion = MoveInstruction::begin(behaviour, &self.parts.manner);
        let mut state = self.heartbeat.away(self.parts.edp.state()).await?;
        loop {
            while motion.rests() {
                self.alive.fetch_add(1, Ordering::Relaxed);
                match self.heartbeat.away(permission_soon(&mut self.parts.services.control)).await {
                    Some(Ok(())) => break,
                    Some(Err(_)) => return Ok((Outcome::Ended, state)),
                    None => state = self.heartbeat.away(self.parts.edp.state()).await?,
                }
            }
            self.fault.occur().await;
            self.alive.fetch_add(1, Ordering::Relaxed);
            motion.heed(*self.parts.services.control.borrow());
            let is_over = matches!(self.mailbox.try_recv(), Ok(Request::End)) && motion.end();
            if is_over || motion.has_ended() {
                return Ok((Outcome::Ended, state));
            }
            let target = self.parts.tracker.as_ref().and_then(VspHandle::target);
            tracing::trace!(
                actor = %self.name,
                period = state.period,
                wrench = ?state.wrench_in_tool.directions().map(|c| (c * 100.0).round() / 100.0),
                jaw_mm = state.jaw_opening * 1e3,
                "state"
            );
            match motion.step(&state, target.as_ref()) {
                Ok((command, sensing)) => {
                    if let (Some(sensing), Some(tracker)) = (sensing, &self.parts.tracker) {
                        tracker.configure(sensing);
                    }
                    state = match self.heartbeat.away(self.parts.edp.execute(command)).await {
                        Err(error) if motion.bears(&error) => {
                            self.heartbeat.away(self.parts.edp.state()).await?
                        }
                        executed => executed?,
                    };
                }
                Err(outcome) => return Ok((outcome, state)),
            }
        }
    }

    async fn look(&self, view: View) -> Result<FaceReading, Error> {
        match &self.parts.hand_camera {
            Some(camera) => camera.look(view).await,
            None => Err(Error::NonFatal {
                actor: self.name.clone(),
                place: "look",
                cause: NonFatal::NoReading("no camera in this hand belongs to this ECP".into()),
            }),
        }
    }
}
