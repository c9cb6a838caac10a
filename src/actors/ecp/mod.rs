//! ECP (effector control process): the actor that carries out MP's orders with one effector.
//!
//! Under continuous coordination it transmits the commands that MP computes. Under sporadic
//! coordination it runs the generators of the behaviours that MP invokes, with the readings of the
//! VSPs that belong to it (Zieliński et al. 2007, p. 374).
//!
//! Beside this it runs programmes (`programme`), kernels of its own that MP starts. MP checks the
//! paths of its orders itself; the ECP checks those of a programme (`surroundings`).
//!
//! - in: commands, behaviours and other requests of MP; states of its EDP; readings of its VSPs
//! - out: commands to the EDP; the outcome or the answer of each request

mod outbox;
mod programme;
mod surroundings;

pub use outbox::{Outbox, Report};
pub use surroundings::Surroundings;

use super::clock::Clock;
use super::control::permission_soon;
use super::edp::EdpHandle;
use super::fault::ActorFault;
use super::move_instruction::{Ending, Manner, MoveInstruction};
use super::notice::Notice;
use super::sensor::{self, SensorHandle};
use super::services::Services;
use super::vsp::VspHandle;
use super::watchdog::{Heartbeat, Supervision};
use super::way::{self, BEAT, Carries, Toward, Way};
use crate::error::{Error, NonFatal, System};
use crate::generators::{Behaviour, Outcome};
use crate::kernel::programme::Programmes;
use crate::kernel::{Adjustment, Programme, Signal, View};
use crate::motion::{ArmState, MoveCommand, PERIOD};
use crate::spatial::Pose;
use crate::vision::sensor::FaceReading;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::mpsc::error::TryRecvError;
use tokio::sync::{mpsc, oneshot, watch};
use tracing::Instrument as _;

/// Capacity of the mailbox. MP waits for the answer of a request before it sends the next one, and
/// few requests have no answer ([`Request::End`], [`Request::Watch`]).
const MAILBOX: usize = 4;
/// Time for which the course of a motion must be free before the operator is told once more that it
/// is not (s).
const AGAIN: f64 = 1.0;

/// Channel of an answer.
type Reply<T> = oneshot::Sender<Result<T, Error>>;

/// A request of MP to its ECP.
#[derive(Debug)]
pub(super) enum Request {
    Transmit { command: MoveCommand, reply: Reply<ArmState> },
    Behave { behaviour: Behaviour, begins: u64, reply: Reply<(Outcome, ArmState)> },
    End(Ending),
    Bias { reply: Reply<ArmState> },
    Synchronise { reply: Reply<ArmState> },
    Adjust { adjustment: Adjustment, reply: Reply<ArmState> },
    State { reply: Reply<ArmState> },
    Watch { on: bool },
    Look { view: View, reply: Reply<FaceReading> },
    Start { programme: Programme, to_mp: Outbox, reply: Reply<()> },
    Signal(Signal),
}

/// The sending end of an ECP's mailbox. The ECP ends when the last clone is dropped, and so does
/// its EDP if nothing else holds it.
#[derive(Debug, Clone)]
pub struct EcpHandle {
    name: String,
    mailbox: mpsc::Sender<Request>,
    /// Signs of life of the ECP, one for each request and each macrostep.
    alive: Arc<AtomicU64>,
    /// Longest time between two signs of life of an ECP in order.
    patience: Duration,
    /// Clock of the run, and the time between the order of a motion and its beginning (periods).
    beginning: (Clock, u64),
    /// Way to the ECP; `None` for one on the node of MP.
    way: Option<Way>,
}

impl EcpHandle {
    /// Passes a command of MP on to the EDP (continuous coordination) and returns the state of the
    /// arm with which the EDP answers.
    ///
    /// # Errors
    /// The errors of the EDP.
    pub async fn transmit(&self, command: MoveCommand) -> Result<ArmState, Error> {
        self.ask("transmit", |reply| Request::Transmit { command, reply }).await
    }

    /// Carries out a behaviour to its end (sporadic coordination). Returns its outcome and the
    /// state of the arm at the end.
    ///
    /// # Errors
    /// The errors of the EDP.
    pub async fn behave(&self, behaviour: Behaviour) -> Result<(Outcome, ArmState), Error> {
        // All arms that are ordered now begin in one period, wherever their ECPs and EDPs are.
        let begins = match &self.beginning {
            (_, 0) => 0,
            (clock, lag) => clock.period() + lag,
        };
        self.ask("behave", |reply| Request::Behave { behaviour, begins, reply }).await
    }

    /// Returns the handle for an MP on another node.
    #[must_use]
    pub(crate) fn across(self, way: &Way) -> Self {
        let (signs, source) = watch::channel(0);
        let mut arriving = way.watch(Toward::Home, Carries::Newest, source);
        let there = Arc::downgrade(&self.alive);
        tokio::spawn(async move {
            while let Some(alive) = there.upgrade() {
                signs.send_replace(alive.load(Ordering::Relaxed));
                drop(alive);
                tokio::time::sleep(BEAT).await;
            }
        });
        let alive = Arc::new(AtomicU64::new(0));
        let here = Arc::downgrade(&alive);
        tokio::spawn(async move {
            while arriving.changed().await.is_ok() {
                // No handle is left.
                let Some(here) = here.upgrade() else { return };
                here.store(*arriving.borrow_and_update(), Ordering::Relaxed);
            }
        });
        let patience = self.patience + way.longest_trip() + BEAT;
        Self { alive, patience, way: Some(way.clone()), ..self }
    }

    /// Passes on a request that came over a link. An ECP that has ended drops it, and with it the
    /// channel of its answer.
    pub(super) async fn pass(&self, request: Request) {
        let _ = self.mailbox.send(request).await;
    }

    /// Returns the number of signs of life of the ECP.
    pub(super) fn signs_of_life(&self) -> u64 {
        self.alive.load(Ordering::Relaxed)
    }

    /// Ends the behaviour that the ECP is carrying out: at the next macrostep, or some macrosteps
    /// later if the motion must slow down first (see [`Ending`]).
    ///
    /// # Errors
    /// System when the ECP is gone.
    pub async fn end(&self, ending: Ending) -> Result<(), Error> {
        self.order("end", Request::End(ending)).await
    }

    /// Zeroes the arm's force sensor under its present load and returns the state of the arm.
    ///
    /// # Errors
    /// The errors of the EDP.
    pub async fn bias(&self) -> Result<ArmState, Error> {
        self.ask("bias", |reply| Request::Bias { reply }).await
    }

    /// Homes the arm, axis by axis, if it is not synchronised yet, and returns its state.
    ///
    /// # Errors
    /// The errors of the EDP.
    pub async fn synchronise(&self) -> Result<ArmState, Error> {
        self.ask("synchronise", |reply| Request::Synchronise { reply }).await
    }

    /// Adjusts the arm, which must be at rest, and returns its state.
    ///
    /// # Errors
    /// The errors of the EDP.
    pub async fn adjust(&self, adjustment: Adjustment) -> Result<ArmState, Error> {
        self.ask("adjust", |reply| Request::Adjust { adjustment, reply }).await
    }

    /// Asks the EDP for the present state of the arm and returns it.
    ///
    /// # Errors
    /// The errors of the EDP.
    pub async fn state(&self) -> Result<ArmState, Error> {
        self.ask("state", |reply| Request::State { reply }).await
    }

    /// Switches the tracking of the cube by the stand-alone camera on or off. Does nothing if the
    /// camera does not belong to this ECP.
    ///
    /// # Errors
    /// System when the ECP is gone.
    pub async fn watch(&self, on: bool) -> Result<(), Error> {
        self.order("watch", Request::Watch { on }).await
    }

    /// Reads the face of the cube that the camera in the effector's hand sees. `view` says where
    /// the face is expected, and the exposure.
    ///
    /// # Errors
    /// Non-fatal when no hand camera belongs to this ECP or the camera finds no face.
    pub async fn look(&self, view: View) -> Result<FaceReading, Error> {
        self.ask("look", |reply| Request::Look { view, reply }).await
    }

    /// Begins a programme, whose messages go to `to_mp`.
    ///
    /// # Errors
    /// Non-fatal when there is no such programme, or its order cannot be read.
    pub async fn start(&self, programme: Programme, mut to_mp: Outbox) -> Result<(), Error> {
        if let Some(way) = &self.way {
            to_mp.mailbox = way.queue_home(to_mp.mailbox);
        }
        self.ask("start", |reply| Request::Start { programme, to_mp, reply }).await
    }

    /// Sends a signal to the programme that the ECP carries out. Without a programme the signal is
    /// lost.
    ///
    /// # Errors
    /// System when the ECP is gone.
    pub async fn signal(&self, signal: Signal) -> Result<(), Error> {
        self.order("signal", Request::Signal(signal)).await
    }

    /// Makes the error for a request to an ECP that has ended; `place` names the request.
    fn closed(&self, place: &'static str) -> Error {
        Error::System {
            actor: self.name.clone(),
            place: place.into(),
            cause: System::Closed(self.name.clone()),
        }
    }

    /// Sends a request without an answer to the ECP; `place` names it in the error.
    async fn order(&self, place: &'static str, request: Request) -> Result<(), Error> {
        let mailbox = self.mailbox.clone();
        match &self.way {
            None => mailbox.send(request).await.map_err(|_| self.closed(place)),
            Some(way) => {
                way.order(async move {
                    let _ = mailbox.send(request).await;
                });
                Ok(())
            }
        }
    }

    /// Sends a request to the ECP and waits for its answer. Fails if the ECP has ended, or if it
    /// gives no sign of life for `patience`; `place` names the request in the error.
    async fn ask<T: Send + 'static>(
        &self,
        place: &'static str,
        request: impl FnOnce(Reply<T>) -> Request,
    ) -> Result<T, Error> {
        let (reply, answer) = oneshot::channel();
        let sent = way::send(self.way.as_ref(), &self.mailbox, (request(reply), answer)).await;
        let mut answer = sent.ok_or_else(|| self.closed(place))?;
        let mut last = self.alive.load(Ordering::Relaxed);
        let mut silent = 0;
        loop {
            // A behaviour may last long, so its time has no limit: its signs of life have one. Two
            // silent halves are required, since a jump of the clock ends one of them at once.
            if let Ok(answer) = tokio::time::timeout(self.patience / 2, &mut answer).await {
                return answer.map_err(|_| self.closed(place))?;
            }
            let now = self.alive.load(Ordering::Relaxed);
            silent = if now == last { silent + 1 } else { 0 };
            // A homing and a look give no signs of life: the EDP and the VSP watch over them.
            if silent >= 2 && !matches!(place, "synchronise" | "look") {
                let seconds = self.patience.as_secs_f64();
                let cause = System::Silent { who: self.name.clone(), seconds };
                return Err(Error::System { actor: self.name.clone(), place: place.into(), cause });
            }
            last = now;
        }
    }
}

/// The parts of an ECP.
pub struct Parts {
    /// Driver of its effector.
    pub edp: EdpHandle,
    /// VSP of the stand-alone camera, if it belongs to this ECP.
    pub tracker: Option<VspHandle>,
    /// VSP of the camera in the hand, if it belongs to this ECP.
    pub hand_camera: Option<VspHandle>,
    /// VSPs of a user's own sensors that belong to this ECP.
    pub sensors: Vec<SensorHandle>,
    /// Parameters of its generators.
    pub manner: Manner,
    /// Time between the order of a motion and its beginning (periods), if an EDP of the cell is on
    /// another node; otherwise 0.
    pub lag: u64,
    /// Programmes that it can carry out.
    pub programmes: Programmes,
    /// Cell and other arm, against which it checks the paths of its programmes; `None` without a
    /// cell.
    pub surroundings: Option<Surroundings>,
    /// The services of the run.
    pub services: Services,
}

/// The actor ECP: its parts, its mailbox and its supervision.
struct Ecp {
    name: String,
    parts: Parts,
    mailbox: mpsc::Receiver<Request>,
    fault: Arc<ActorFault>,
    alive: Arc<AtomicU64>,
    heartbeat: Heartbeat,
    /// Signals of MP that the programme has not received yet.
    signals: VecDeque<Signal>,
    /// Tool frame in force (`flange_from_tool`), where MP or a programme has changed it.
    tool: Option<Pose>,
    /// Period in which the course of a motion was last not free.
    told: Option<u64>,
}

/// Starts the ECP of the effector `name` as a task, and returns the sending end of its mailbox.
#[must_use]
pub fn spawn(name: &str, parts: Parts) -> EcpHandle {
    let (mailbox, requests) = mpsc::channel(MAILBOX);
    let name = format!("ecp {name}");
    let Supervision { watchdog, fault, patience } = parts.services.supervision.clone();
    let alive = Arc::default();
    let macrostep = parts.manner.compliance.macrostep;
    let patience = silence(macrostep, parts.lag, patience) + parts.edp.patience().max(patience);
    let beginning = (parts.services.clock.clone(), parts.lag);
    let ecp = Ecp {
        name: name.clone(),
        parts,
        mailbox: requests,
        fault,
        alive: Arc::clone(&alive),
        heartbeat: watchdog.heartbeat(&name),
        signals: VecDeque::new(),
        tool: None,
        told: None,
    };
    let span = tracing::info_span!("ecp", name = ecp.name);
    watchdog.spawn(&name, ecp.run().instrument(span));
    EcpHandle { name, mailbox, alive, patience, beginning, way: None }
}

/// Returns the longest time between two signs of life of an ECP in order, less the time in which
/// its EDP answers. `macrostep` and `lag`, the time before a motion begins, are in periods.
///
/// Between two signs of life the EDP answers a command, at the latest after two macrosteps and its
/// patience. The additional `patience` lets the EDP's own limit report first.
pub(crate) fn silence(macrostep: u32, lag: u64, patience: Duration) -> Duration {
    let periods = lag + 2 * u64::from(macrostep);
    Duration::from_secs_f64(periods as f64 * PERIOD) + patience
}

/// Makes the handle of an ECP on another node, and the receiving end of its mailbox. `alive` counts
/// its signs of life, which come within `patience`; `beginning` is the clock of this node, with the
/// time between the order of a motion and its beginning (periods).
pub(super) fn remote(
    arm: &str,
    alive: Arc<AtomicU64>,
    patience: Duration,
    beginning: (Clock, u64),
) -> (EcpHandle, mpsc::Receiver<Request>) {
    let (mailbox, requests) = mpsc::channel(MAILBOX);
    let name = format!("ecp {arm}");
    (EcpHandle { name, mailbox, alive, patience, beginning, way: None }, requests)
}

impl Ecp {
    /// Serves the requests of MP until the last handle is dropped.
    async fn run(mut self) {
        while let Some(request) = self.mailbox.recv().await {
            self.heartbeat.works();
            self.fault.before_message().await;
            // An injected loss waits for a request with an answer, whose sender detects it.
            let answers =
                !matches!(request, Request::End(_) | Request::Watch { .. } | Request::Signal(_));
            if answers && self.fault.is_lost() {
                self.heartbeat.waits();
                continue;
            }
            self.alive.fetch_add(1, Ordering::Relaxed);
            match request {
                // Continuous coordination: MP has computed the command.
                Request::Transmit { command, reply } => {
                    self.parts.services.trace.message("mp", &self.name, &command);
                    let answer = self.heartbeat.away(self.parts.edp.execute(command)).await;
                    let _ = reply.send(answer);
                }
                // Sporadic coordination: returns at the end of the behaviour. Meanwhile `behave`
                // reads the mailbox for an end from above.
                Request::Behave { behaviour, begins, reply } => {
                    self.parts.services.trace.message("mp", &self.name, &behaviour);
                    tracing::debug!(?behaviour, "a behaviour begins");
                    let answer = self.behave(&behaviour, begins).await;
                    tracing::debug!(?answer, "a behaviour ends");
                    self.parts.services.trace.message(&self.name, "mp", &answer);
                    let _ = reply.send(answer);
                }
                // The behaviour or the programme has ended by itself before the request arrived.
                Request::End(_) | Request::Signal(_) => {}
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
                Request::Adjust { adjustment, reply } => {
                    self.parts.services.trace.message("mp", &self.name, &adjustment);
                    let _ = reply.send(self.adjust(adjustment).await);
                }
                Request::State { reply } => {
                    let _ = reply.send(self.heartbeat.away(self.parts.edp.state()).await);
                }
                // MP asks every ECP. One without the stand-alone camera ignores it.
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
                Request::Start { programme, to_mp, reply } => {
                    self.parts.services.trace.message("mp", &self.name, &programme);
                    self.perform(&programme, &to_mp, reply).await;
                }
            }
            self.heartbeat.waits();
        }
    }

    /// Carries out a behaviour of MP, which begins in the period `begins` or later.
    async fn behave(
        &mut self,
        behaviour: &Behaviour,
        begins: u64,
    ) -> Result<(Outcome, ArmState), Error> {
        let state = self.heartbeat.away(self.parts.edp.state()).await?;
        self.behave_from(behaviour, state, begins).await
    }

    /// Runs the generator of a behaviour to its end: one command for the EDP in each macrostep.
    /// `state` is the present state of the arm; the first command begins in the period `begins` or
    /// later. Returns the outcome and the state at the end.
    async fn behave_from(
        &mut self,
        behaviour: &Behaviour,
        mut state: ArmState,
        mut begins: u64,
    ) -> Result<(Outcome, ArmState), Error> {
        let mut motion =
            MoveInstruction::begin(behaviour, &self.parts.manner, &state).map_err(|cause| {
                Error::NonFatal { actor: self.name.clone(), place: "begin a motion".into(), cause }
            })?;
        loop {
            // A pause has brought the motion to rest. The EDP is still asked for the state, since
            // a fault must not wait for the operator.
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
            motion.set_pace(*self.parts.services.control.borrow());
            let is_over = match self.mailbox.try_recv() {
                Ok(Request::End(ending)) => motion.end(ending),
                // These come during the motions of a programme. MP sends no other request while a
                // behaviour is under way: it would be dropped here.
                Ok(Request::State { reply }) => {
                    let _ = reply.send(Ok(state));
                    false
                }
                Ok(Request::Signal(signal)) => {
                    self.signals.push_back(signal);
                    false
                }
                Err(TryRecvError::Disconnected) => motion.end(Ending::Slowing),
                _ => false,
            };
            if is_over || motion.has_ended() {
                return Ok((Outcome::Ended, state));
            }
            let target = self.parts.tracker.as_ref().and_then(VspHandle::target);
            self.log(&state);
            self.sense(&mut motion);
            let tuning = &mut self.parts.services.tuning;
            match motion.step_under(tuning, &state, target.as_ref()) {
                Ok((command, sensing)) => {
                    let command = self.cleared(&mut motion, command, &state);
                    if let (Some(sensing), Some(tracker)) = (sensing, &self.parts.tracker) {
                        tracker.configure(sensing);
                    }
                    let from = std::mem::take(&mut begins);
                    let executed = self.parts.edp.execute_from(command, from);
                    state = match self.heartbeat.away(executed).await {
                        // The generator reads the refusal in the state and continues.
                        Err(error) if motion.tolerates(&error) => {
                            self.heartbeat.away(self.parts.edp.state()).await?
                        }
                        executed => executed?,
                    };
                }
                Err(outcome) => return Ok((outcome, state)),
            }
        }
    }

    /// Logs the state of the arm.
    fn log(&self, state: &ArmState) {
        tracing::trace!(
            actor = %self.name,
            period = state.period,
            wrench = ?state.wrench_in_tool.directions().map(|c| (c * 100.0).round() / 100.0),
            jaw_mm = state.jaw_opening * 1e3,
            "state"
        );
    }

    /// Gives a motion the present reading of the sensor that its generator names, if it names one.
    fn sense(&self, motion: &mut MoveInstruction) {
        if let Some(sensor) = motion.sensor() {
            let readings = sensor::readings(&self.parts.sensors);
            let reading = readings.get(sensor, self.parts.services.clock.period());
            motion.set_reading(reading);
        }
    }

    /// Returns the command of a motion whose course is not known beforehand: `command`, or if the
    /// course from there to rest is not free, the one that leads to rest before. The operator is
    /// told the reason.
    fn cleared(
        &mut self,
        motion: &mut MoveInstruction,
        command: MoveCommand,
        state: &ArmState,
    ) -> MoveCommand {
        let (Some(course), Some(around)) = (motion.onward(), &self.parts.surroundings) else {
            return command;
        };
        let Err(why) = around.check_onward(course, state) else { return command };
        let now = self.parts.services.clock.period();
        if self.told.is_none_or(|told| now.saturating_sub(told) as f64 * PERIOD > AGAIN) {
            let note = format!("{}: the arm does not follow its targets: {why}", self.name);
            self.parts.services.trace.tell(Notice::Warning(now as f64 * PERIOD, note));
        }
        self.told = Some(now);
        motion.retreat(command)
    }

    /// Adjusts the arm and returns its state. Keeps the tool frame that is in force.
    async fn adjust(&mut self, adjustment: Adjustment) -> Result<ArmState, Error> {
        let state = self.heartbeat.away(self.parts.edp.adjust(adjustment)).await?;
        if let Adjustment::Tool(flange_from_tool) = adjustment {
            self.tool = Some(flange_from_tool);
        }
        Ok(state)
    }

    /// Reads a face with the camera in the effector's hand, if one belongs to this ECP.
    async fn look(&self, view: View) -> Result<FaceReading, Error> {
        match &self.parts.hand_camera {
            Some(camera) => camera.look(view).await,
            None => Err(Error::NonFatal {
                actor: self.name.clone(),
                place: "look".into(),
                cause: NonFatal::NoReading("no camera in this hand belongs to this ECP".into()),
            }),
        }
    }
}
