//! EDP (effector driver process): the actor that sends the commands of an ECP to the servo of one
//! arm and answers each with the arm's state.
//!
//! It is the EDPM of the paper (Zieliński et al. 2007), which talks to the ECP and interprets its
//! commands. The paper's EDPT and EDPS are parts of the servo period ([`crate::servo`]). The force
//! readings (EDPF) arrive with the bridge's exchange.
//!
//! The answer to a macrostep leaves two servo periods before its end, so that the next macrostep
//! follows without a gap.
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | the servo is gone | `SILENCE` | it answers within one period if it runs |
//! | the arm is at rest | `STILL`, `ROLL_STILL` | a tool in motion puts its inertia into the zero |
//! | a zero is suspect | `ZERO_MOVED` | without faults it moves by 1.7 N and 0.13 Nm at most |

use super::clock::Clock;
use super::fault::ActorFault;
use super::services::Services;
use super::trace::Trace;
use super::watchdog::{Heartbeat, Supervision, answer_of};
use super::way::{self, Carries, Toward, Way};
use crate::error::{Error, Fatal, NonFatal, System};
use crate::hw::driver::{HEARTBEAT_TIMEOUT, ServoLink};
use crate::kernel::Adjustment;
use crate::kinematics::ArmModel;
use crate::motion::{
    ArmFault, ArmState, JointPositions, MoveCommand, MoveRefused, PERIOD, ROLL, Synchronisation,
};
use crate::servo::ServoCommand;
use crate::servo::ahead::ahead;
use crate::spatial::is_rigid;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{mpsc, oneshot, watch};
use tracing::Instrument as _;

/// Servo periods between the answer to a macrostep and the end of the macrostep.
const EARLY: u64 = 2;
/// Periods that zeroing a force sensor lasts: ten samples and the filters before them.
const BIAS_PERIODS: u64 = 16;
/// Largest motion of a joint in [`REST_PERIODS`] that counts as rest (m, rad). A tool of 1.1 kg
/// that slows down like this adds less than 0.1 N of inertia to the reading.
const STILL: f64 = 2.5e-4;
/// Largest motion of the wrist roll in [`REST_PERIODS`] that counts as rest (rad). The roll settles
/// last, and its axis passes through the tool's centre of mass, so its motion adds no force.
const ROLL_STILL: f64 = 2.5e-3;
/// Periods between two samples of an arm that comes to rest.
const REST_PERIODS: u64 = 12;
/// Most samples for which a zeroing waits until the arm is at rest (0.6 s together). Arms were at
/// rest after 0.2 s in missions.
const REST_TRIES: u32 = 25;
/// Largest change of a sensor's zero that is not reported (N, Nm). In missions without faults the
/// zero moves by 1.7 N and 0.13 Nm at most. The causes are drift, errors of the believed weights
/// and a cube that is turned over. An operator who pulls during the zeroing adds 6 N.
const ZERO_MOVED: [f64; 2] = [8.0, 1.0];
/// Periods between two checks of an arm that is being synchronised.
const PROGRESS: u64 = 25;
/// Periods after which an EDP publishes the state of an arm during a command, if its ECP is on
/// another node.
const PUBLISH: u64 = 8;
/// Time between two checks whether the servo has finished a command.
const POLL: Duration = Duration::from_millis(1);
/// Time without an answer after which the servo counts as gone (s).
const SILENCE: f64 = 0.5;
/// Longest time of a request that moves nothing.
const SERVICE: Duration = Duration::from_millis(100);
/// Additional time of a zeroing, in which the arm comes to rest.
const REST: Duration = Duration::from_millis(700);
/// Capacity of the mailbox: an ECP has at most one request under way.
const MAILBOX: usize = 4;

/// A request of an ECP to its EDP, with the channel of its answer.
#[derive(Debug)]
pub(super) enum Request {
    Execute { command: MoveCommand, from: u64, reply: oneshot::Sender<Result<ArmState, Error>> },
    Adjust { adjustment: Adjustment, reply: oneshot::Sender<Result<ArmState, Error>> },
    Bias { reply: oneshot::Sender<Result<ArmState, Error>> },
    State { reply: oneshot::Sender<Result<ArmState, Error>> },
    Synchronise { reply: oneshot::Sender<Result<ArmState, Error>> },
}

/// The sending end of an EDP's mailbox. The EDP ends when the last clone is dropped.
#[derive(Debug, Clone)]
pub struct EdpHandle {
    name: String,
    mailbox: mpsc::Sender<Request>,
    state: watch::Receiver<ArmState>,
    /// Longest time of an answer beyond the time that the request itself takes.
    patience: Duration,
    /// Clock of servo periods.
    clock: Clock,
    /// Way to the EDP; `None` for one on the node of its ECP.
    way: Option<Way>,
}

impl EdpHandle {
    /// Executes a move. Returns the state of the arm two servo periods before the end of the move,
    /// so that the next one can follow without a gap.
    ///
    /// # Errors
    /// Non-fatal when the command is refused, fatal when the arm has stopped.
    pub async fn execute(&self, command: MoveCommand) -> Result<ArmState, Error> {
        self.execute_from(command, 0).await
    }

    /// Executes a move that begins in the period `from` or later. Arms on several nodes begin a
    /// common motion in one period by this.
    ///
    /// # Errors
    /// As [`EdpHandle::execute`].
    pub(crate) async fn execute_from(
        &self,
        command: MoveCommand,
        from: u64,
    ) -> Result<ArmState, Error> {
        let later = from.saturating_sub(self.clock.period());
        // Twice its duration: the command before it may still be under way.
        let periods = 2 * u64::from(command.periods) + later;
        let lasts = Duration::from_secs_f64(periods as f64 * PERIOD);
        self.ask("execute", Some(lasts), |reply| Request::Execute { command, from, reply }).await
    }

    /// Adjusts the arm, which must be at rest and does not move.
    ///
    /// # Errors
    /// Non-fatal when the arm moves or the adjustment is not possible, such as a tool frame that is
    /// not rigid. Fatal when the arm has stopped, or has not recovered by a reset.
    pub async fn adjust(&self, adjustment: Adjustment) -> Result<ArmState, Error> {
        self.ask("adjust", Some(SERVICE + REST), |reply| Request::Adjust { adjustment, reply })
            .await
    }

    /// Sets the force sensor to zero under its present load, once the arm is at rest.
    ///
    /// # Errors
    /// Fatal when the arm has stopped. Non-fatal when the sensor is silent, or when its new zero is
    /// far from the one before; the sensor has been zeroed in that case.
    pub async fn bias(&self) -> Result<ArmState, Error> {
        self.ask("bias", Some(SERVICE + REST), |reply| Request::Bias { reply }).await
    }

    /// Homes the arm, axis by axis, and returns its state; returns at once if the arm is
    /// synchronised already. Without synchronisation an arm accepts only relative motions of its
    /// motors.
    ///
    /// # Errors
    /// Fatal when the arm does not find a switch or an encoder's zero, or another fault stops it.
    pub async fn synchronise(&self) -> Result<ArmState, Error> {
        // No limit of time: the axes may be far from their switches. The servo ends a search that
        // leads nowhere, and the EDP detects a servo that is gone.
        self.ask("synchronise", None, |reply| Request::Synchronise { reply }).await
    }

    /// Returns the present state of the arm.
    ///
    /// # Errors
    /// Fatal when the arm has stopped.
    pub async fn state(&self) -> Result<ArmState, Error> {
        self.ask("state", Some(SERVICE), |reply| Request::State { reply }).await
    }

    /// Returns a receiver of the states that the EDP publishes at each macrostep.
    #[must_use]
    pub fn watch(&self) -> watch::Receiver<ArmState> {
        self.state.clone()
    }

    /// Passes on a request that came over a link. An EDP that has ended drops it, and with it the
    /// channel of its answer.
    pub(super) async fn pass(&self, request: Request) {
        let _ = self.mailbox.send(request).await;
    }

    /// Returns the handle for an ECP on another node.
    #[must_use]
    pub(crate) fn across(self, way: &Way) -> Self {
        let state = way.watch(Toward::Home, Carries::Newest, self.state);
        let patience = self.patience + way.longest_trip();
        Self { state, patience, way: Some(way.clone()), ..self }
    }

    /// Returns the longest time of an answer beyond the time that the request itself takes.
    #[must_use]
    pub(crate) fn patience(&self) -> Duration {
        self.patience
    }

    /// Sends a request to the EDP and waits for its answer: at most for `lasts`, the time that the
    /// request takes, plus `patience`, or without a limit if `lasts` is `None`. `place` names the
    /// request in an error.
    async fn ask(
        &self,
        place: &'static str,
        lasts: Option<Duration>,
        request: impl FnOnce(oneshot::Sender<Result<ArmState, Error>>) -> Request,
    ) -> Result<ArmState, Error> {
        let closed = || Error::System {
            actor: self.name.clone(),
            place: place.into(),
            cause: System::Closed(self.name.clone()),
        };
        let (reply, answer) = oneshot::channel();
        let sent = way::send(self.way.as_ref(), &self.mailbox, (request(reply), answer)).await;
        let answer = sent.ok_or_else(closed)?;
        let limit = lasts.map(|lasts| lasts + self.patience);
        answer_of(&self.name, place, limit, answer).await
    }
}

/// The actor EDP with its memory.
struct Edp {
    name: String,
    link: ServoLink,
    clock: Clock,
    mailbox: mpsc::Receiver<Request>,
    state: watch::Sender<ArmState>,
    trace: Trace,
    /// First period after the last commanded move, at which the next one begins at the earliest.
    free: u64,
    fault: Arc<ActorFault>,
    heartbeat: Heartbeat,
    /// How answers leave earlier, for an ECP on another node.
    lead: Option<Lead>,
    /// Last move that was sent to the servo.
    commanded: Option<MoveCommand>,
    /// Commands that reached the servo twice and have been logged.
    doubles: u64,
    /// Whether the force sensor has been zeroed before. The zero before the first time is unknown,
    /// so a comparison with it says nothing.
    zeroed: bool,
}

/// Starts the EDP of the arm `name` as a task, which commands the servo behind `link`. Returns the
/// sending end of its mailbox.
#[must_use]
pub fn spawn(name: &str, link: ServoLink, services: &Services) -> EdpHandle {
    spawn_early(name, link, None, services)
}

/// Earlier answers for an ECP on another node.
#[derive(Debug, Clone)]
pub(crate) struct Lead {
    /// Number of periods by which an answer leaves earlier.
    pub(crate) periods: u64,
    /// Model of the arm, by which the answer has the set values at the end of the command.
    pub(crate) model: ArmModel,
}

/// Starts an EDP, as [`spawn`] does, that answers earlier than needed on one node.
#[must_use]
pub(crate) fn spawn_early(
    name: &str,
    mut link: ServoLink,
    lead: Option<Lead>,
    services: &Services,
) -> EdpHandle {
    let (mailbox, requests) = mpsc::channel(MAILBOX);
    let (state, watching) = watch::channel(*link.state());
    let name = format!("edp {name}");
    let Supervision { watchdog, fault, patience } = &services.supervision;
    let edp = Edp {
        name: name.clone(),
        link,
        clock: services.clock.clone(),
        mailbox: requests,
        state,
        trace: services.trace.clone(),
        free: 0,
        lead,
        commanded: None,
        fault: Arc::clone(fault),
        heartbeat: watchdog.heartbeat(&name),
        doubles: 0,
        zeroed: false,
    };
    let span = tracing::info_span!("edp", name = edp.name);
    watchdog.spawn(&name, edp.run().instrument(span));
    EdpHandle {
        name,
        mailbox,
        state: watching,
        patience: *patience,
        clock: services.clock.clone(),
        way: None,
    }
}

/// Makes the handle of an EDP on another node, which answers within `patience`, and the receiving
/// end of its mailbox. `state` has the states that the EDP publishes.
pub(super) fn remote(
    arm: &str,
    state: watch::Receiver<ArmState>,
    patience: Duration,
    clock: &Clock,
) -> (EdpHandle, mpsc::Receiver<Request>) {
    let (mailbox, requests) = mpsc::channel(MAILBOX);
    let (name, clock) = (format!("edp {arm}"), clock.clone());
    (EdpHandle { name, mailbox, state, patience, clock, way: None }, requests)
}

impl Edp {
    /// Answers requests until the last handle is dropped.
    async fn run(mut self) {
        // Before the servo's first period the state is a default that no reading backs.
        while self.link.state().period == 0 {
            self.clock.until(self.clock.period() + 1).await;
        }
        while let Some(request) = self.mailbox.recv().await {
            self.heartbeat.works();
            self.fault.before_message().await;
            if self.fault.is_lost() {
                // The reply is dropped with the request, so the ECP sees a closed channel.
                self.heartbeat.waits();
                continue;
            }
            let (answer, reply) = match request {
                Request::Execute { command, from, reply } => {
                    (self.execute(command, from).await, reply)
                }
                Request::Adjust { adjustment, reply } => (self.adjust(adjustment).await, reply),
                Request::Bias { reply } => (self.bias().await, reply),
                Request::Synchronise { reply } => (self.synchronise().await, reply),
                Request::State { reply } => {
                    // A servo that ended without a fault leaves its last state behind, which looks
                    // like that of an arm in order. A fault that it published comes first.
                    let last = self.check("state");
                    let is_gone = self.link.is_closed();
                    let silent = || Err(self.silent("state"));
                    let state = last.and_then(|last| if is_gone { silent() } else { Ok(last) });
                    (state.map(|state| self.in_time(state)), reply)
                }
            };
            self.trace.message(&self.name, "ecp", &answer);
            // The ECP may have given up waiting; then nothing needs the answer.
            let _ = reply.send(answer);
            self.heartbeat.waits();
        }
    }

    /// Sends a command to the servo and returns its ticket, the number by which [`Edp::done`] waits
    /// for it. An injected fault sends the command twice. `place` names the request in an error.
    fn send(&mut self, place: &'static str, command: ServoCommand) -> Result<u64, Error> {
        self.trace.message("edp", &self.name, &command);
        if self.fault.is_doubled() {
            self.link.double();
        }
        self.link.send(command).map_err(|_| self.silent(place))
    }

    /// Makes the error for a servo that does not answer; `place` names the request that failed.
    fn silent(&self, place: &'static str) -> Error {
        let cause = System::Silent { who: "the servo".into(), seconds: SILENCE };
        Error::System { actor: self.name.clone(), place: place.into(), cause }
    }

    /// Sends a move to the servo that begins where the move before it ends. Waits until two periods
    /// before the end of the move and returns the state of the arm. The move begins in the period
    /// `from` or later.
    async fn execute(&mut self, command: MoveCommand, from: u64) -> Result<ArmState, Error> {
        if command.periods == 0 {
            let cause = NonFatal::Arguments("a move command must last at least one period".into());
            return Err(Error::NonFatal {
                actor: self.name.clone(),
                place: "execute".into(),
                cause,
            });
        }
        // The servo takes a command only near the end of the one before, and an early answer lets
        // the command come before.
        let lead = self.lead.as_ref().map_or(0, |lead| lead.periods);
        if lead > 0 {
            let taken = self.free.saturating_sub(self.link.early());
            self.heartbeat.away(self.clock.until(taken)).await;
        }
        if from > 0 {
            self.heartbeat.away(self.clock.until(from.saturating_sub(1))).await;
        }
        // The move before still has two periods to go when its answer is out.
        let start = self.free.max(self.link.state().period + 1).max(from);
        tracing::trace!(start, periods = command.periods, motion = ?command.motion, "execute");
        let ticket = self.send("execute", ServoCommand::Move { command, start })?;
        self.free = start + u64::from(command.periods);
        self.commanded = Some(command);
        // A command shorter than the lead is answered when it begins, not before.
        let early = self.link.early() + lead;
        self.done("execute", ticket, self.free.saturating_sub(early).max(start)).await?;
        let doubles = self.link.doubles();
        if doubles > self.doubles {
            self.doubles = doubles;
            tracing::warn!(
                actor = %self.name,
                period = self.clock.period(),
                "a command reached the servo twice: it was executed once"
            );
        }
        let state = self.check("execute")?;
        Ok(self.in_time(state))
    }

    /// Returns the state of the arm near the end of the last command, for an ECP on another node:
    /// there it arrives about then.
    fn in_time(&self, state: ArmState) -> ArmState {
        let left = self.free.saturating_sub(state.period + 1);
        match (&self.lead, &self.commanded) {
            (Some(lead), Some(command)) => ahead(&state, command, left, &lead.model),
            _ => state,
        }
    }

    /// Waits until a command without a motion has been in effect for `periods` periods, and returns
    /// the state of the arm. `sent` is the ticket of the command, or the error of sending it.
    async fn after(&mut self, sent: Result<u64, Error>, periods: u64) -> Result<ArmState, Error> {
        let ticket = sent?;
        self.done("service", ticket, self.free.max(self.clock.period()) + periods).await?;
        self.check("service")
    }

    /// Sends an adjustment to the servo and returns the state with it. Refuses one that is not
    /// possible; and every one but a reset while the arm moves, since a motion that is under way
    /// refers to the frame and the load with which it began.
    async fn adjust(&mut self, adjustment: Adjustment) -> Result<ArmState, Error> {
        let refused = |why: &str| {
            let (actor, cause) = (self.name.clone(), NonFatal::Arguments(why.to_owned()));
            Err(Error::NonFatal { actor, place: "adjust".into(), cause })
        };
        let (command, rests) = match adjustment {
            Adjustment::Tool(flange_from_tool) => {
                if !is_rigid(&flange_from_tool) {
                    return refused("the new tool frame is not rigid");
                }
                (ServoCommand::SetTool(flange_from_tool), true)
            }
            Adjustment::Load { weight, centre } => {
                let finite = centre.coords.iter().all(|c| c.is_finite());
                if !(weight.is_finite() && weight >= 0.0 && finite) {
                    return refused("a load has a finite centre, and a weight of 0 N or more");
                }
                (ServoCommand::Payload { weight, centre }, true)
            }
            // An arm with a fault has its brakes on.
            Adjustment::Reset => (ServoCommand::Reset, false),
        };
        if rests && !self.come_to_rest().await {
            return Err(self.still_moves("adjust", "its frame and its load are not changed"));
        }
        let sent = self.send("adjust", command);
        // One period takes the command, the next one publishes a state with it.
        self.after(sent, 2).await
    }

    /// Makes the error for an arm that does not come to rest; `place` names the request, and `so`
    /// says what has not been done.
    fn still_moves(&self, place: &'static str, so: &str) -> Error {
        let seconds = f64::from(REST_TRIES) * REST_PERIODS as f64 * PERIOD;
        let why = format!("the arm still moves after {seconds:.1} s: {so}");
        Error::NonFatal {
            actor: self.name.clone(),
            place: place.into(),
            cause: NonFatal::NoReading(why),
        }
    }

    /// Waits until the arm is at rest after a motion. Returns `false` if it still moves after
    /// [`REST_TRIES`] samples.
    async fn come_to_rest(&mut self) -> bool {
        let mut before = self.link.state().joints;
        for _ in 0..REST_TRIES {
            let soon = self.clock.until(self.clock.period() + REST_PERIODS);
            self.heartbeat.away(soon).await;
            let now = self.link.state().joints;
            // Measured joints: the set ones stop a few periods before the arm does.
            if is_still(&before, &now) {
                return true;
            }
            before = now;
        }
        false
    }

    /// Zeroes the force sensor once the arm is at rest. Fails if the arm does not come to rest,
    /// since a sensor that is zeroed in motion takes the inertia of its tool for weight; if the
    /// sensor is silent, since its zero would stay the old one; or if the zero moved by more than
    /// [`ZERO_MOVED`].
    async fn bias(&mut self) -> Result<ArmState, Error> {
        if !self.come_to_rest().await {
            return Err(self.still_moves("bias", "its force sensor is not zeroed"));
        }
        let before = self.link.state().wrench_in_tool;
        let sent = self.send("bias", ServoCommand::Bias);
        let state = self.after(sent, BIAS_PERIODS).await?;
        let cause = if state.wrench_in_tool.is_finite() {
            // The load is the same before and after, so the difference of the two readings is the
            // motion of the zero.
            let zeroed = std::mem::replace(&mut self.zeroed, true);
            let by = (before - state.wrench_in_tool).directions();
            tracing::debug!(zeroed, ?by, "the zero of the force sensor moves");
            match moved_most(&by).filter(|_| zeroed) {
                None => return Ok(state),
                Some((direction, by)) => {
                    let effector = self.name.trim_start_matches("edp ").to_owned();
                    NonFatal::ZeroMoved { effector, by, direction }
                }
            }
        } else {
            NonFatal::NoReading(format!("the force sensor is silent, period {}", state.period))
        };
        Err(Error::NonFatal { actor: self.name.clone(), place: "bias".into(), cause })
    }

    /// Homes the arm, and publishes its state each [`PROGRESS`] periods meanwhile.
    async fn synchronise(&mut self) -> Result<ArmState, Error> {
        if self.check("synchronise")?.synchronisation == Synchronisation::Yes {
            return self.check("synchronise");
        }
        let ticket = self.send("synchronise", ServoCommand::Synchronise)?;
        self.done("synchronise", ticket, self.clock.period() + 2).await?;
        let (mut last, mut unchanged) = (0, 0);
        loop {
            let state = self.check("synchronise")?;
            // A homing has no expected end, so the servo is watched by the periods it publishes.
            unchanged = if state.period == last { unchanged + PROGRESS } else { 0 };
            last = state.period;
            if unchanged as f64 * PERIOD > SILENCE {
                return Err(self.silent("synchronise"));
            }
            match state.synchronisation {
                Synchronisation::Yes => return Ok(state),
                Synchronisation::Under { .. } => {}
                // The homing was broken off, by a pause for one; a fault has returned above.
                Synchronisation::No => {
                    let why = state.refused.unwrap_or(MoveRefused::Aborted);
                    let (actor, cause) = (self.name.clone(), NonFatal::Refused(why));
                    return Err(Error::NonFatal { actor, place: "synchronise".into(), cause });
                }
            }
            if self.link.is_closed() {
                return Err(self.silent("synchronise"));
            }
            self.heartbeat.away(self.clock.until(self.clock.period() + PROGRESS)).await;
        }
    }

    /// Waits until `period` has begun and the servo has at most [`EARLY`] periods, and the lead,
    /// left of the command with the number `ticket`. Polls the servo, because under the wall clock
    /// the servo's periods and the runtime's time differ a little. Fails if the servo has not come
    /// that far [`SILENCE`] later; `place` names the request in the error.
    async fn done(&mut self, place: &'static str, ticket: u64, period: u64) -> Result<(), Error> {
        // A long command of an ECP on another node is published in between, for the lookout.
        while self.lead.is_some() && self.clock.period() + PUBLISH < period {
            self.heartbeat.away(self.clock.until(self.clock.period() + PUBLISH)).await;
            self.state.send_replace(*self.link.state());
        }
        self.heartbeat.away(self.clock.until(period)).await;
        let patience = (SILENCE / POLL.as_secs_f64()) as u64;
        for _ in 0..patience {
            if self.link.is_done(ticket, EARLY + self.lead.as_ref().map_or(0, |lead| lead.periods))
            {
                return Ok(());
            }
            if self.link.is_closed() {
                break;
            }
            self.heartbeat.away(tokio::time::sleep(POLL)).await;
        }
        Err(self.silent(place))
    }

    /// Publishes the latest state of the arm and returns it, or returns the error that the state
    /// reports. `place` names the request in an error.
    fn check(&mut self, place: &'static str) -> Result<ArmState, Error> {
        let state = *self.link.state();
        // The lookout and the UI need the state of an arm with a fault as well.
        self.state.send_replace(state);
        let actor = self.name.clone();
        let silent = |seconds| {
            let cause = System::Silent { who: "the actors' heartbeat".into(), seconds };
            Err(Error::System { actor: actor.clone(), place: place.into(), cause })
        };
        // The arm stopped because the actors were silent: that is a failure of the system of
        // actors, not of this effector.
        if let Some(ArmFault::Heartbeat { seconds }) = state.fault {
            return silent(seconds);
        }
        // The arms are braking and trip 0.2 s later. The cause of the trip is known already.
        let stopping = match state.refused {
            Some(MoveRefused::Stopping { periods }) => Some(ArmFault::Missed { periods }),
            _ => None,
        };
        if let Some(fault) = state.fault.or(stopping) {
            let last = Some(Box::new(state));
            return Err(Error::Fatal {
                actor,
                place: place.into(),
                cause: Fatal::Arm(fault),
                last,
            });
        }
        match state.refused {
            // The servo braked because the actors' heartbeat was missing: no fault of this command.
            Some(MoveRefused::Aborted) if place == "execute" => {
                silent(HEARTBEAT_TIMEOUT.as_secs_f64())
            }
            // A refusal is an error of the move that was refused, not of a later request.
            Some(refused) if place == "execute" => Err(Error::NonFatal {
                actor,
                place: place.into(),
                cause: NonFatal::Refused(refused),
            }),
            _ => Ok(state),
        }
    }
}

/// Returns whether an arm is at rest: its measured joints have hardly moved from `before` to `now`,
/// which are [`REST_PERIODS`] apart.
fn is_still(before: &JointPositions, now: &JointPositions) -> bool {
    let moved = |axis: usize| (now.0[axis] - before.0[axis]).abs();
    moved(ROLL) < ROLL_STILL && (0..ROLL).all(|axis| moved(axis) < STILL)
}

/// Returns the direction (0 to 5) in which the zero of a force sensor has changed most, with the
/// change; `None` if no change exceeds [`ZERO_MOVED`]. `by` holds the changes of three forces (N)
/// and three torques (Nm). A force comes before a torque, since a force on the tool also causes a
/// torque about the tool point.
fn moved_most(by: &[f64; 6]) -> Option<(usize, f64)> {
    let farthest = |first: usize| {
        let moved = (first..first + 3).map(|i| (i, by[i].abs()));
        let beyond = moved.filter(|(_, by)| *by > ZERO_MOVED[first / 3]);
        beyond.max_by(|a, b| a.1.total_cmp(&b.1))
    };
    farthest(0).or_else(|| farthest(3))
}

#[cfg(test)]
mod tests {
    use super::super::control::Control;
    use super::*;
    use crate::hw::driver;
    use crate::record::run_hash::RunHash;
    use crate::spatial::Pose;
    use nalgebra::Point3;
    use tokio::time::Instant;

    #[tokio::test(start_paused = true)]
    async fn state_request_reports_a_dead_servo() {
        let (link, mut end) = driver::link();
        end.publish(&ArmState { period: 1, ..ArmState::default() });
        let clock = Clock::new(Instant::now(), Arc::default());
        let control = watch::channel(Control::Running).1;
        let services = Services::bare(clock, control, Trace::bare(RunHash::default()).0);
        let edp = spawn("track", link, &services);
        assert!(edp.state().await.is_ok());

        drop(end);

        let error = edp.state().await.unwrap_err().to_string();
        assert_eq!(error, "no answer from the servo in 0.5 s (system, edp track, state)");
    }

    /// Gives an order to the EDP of an arm whose joint 1 moves at 0.015 rad/s until the period
    /// `last`. Returns the answer of the EDP, and the command and the period in which the servo
    /// takes it.
    async fn ordered<F: Future<Output = Result<ArmState, Error>>>(
        last: u64,
        order: impl FnOnce(EdpHandle) -> F,
    ) -> (Result<ArmState, Error>, Option<(ServoCommand, u64)>) {
        let (link, mut end) = driver::link();
        let clock = Clock::new(Instant::now(), Arc::default());
        let (takes, taken) = watch::channel(None);
        tokio::spawn({
            let clock = clock.clone();
            async move {
                for period in 1.. {
                    let mut state = ArmState { period, ..ArmState::default() };
                    state.joints.0[1] = 3e-5 * period.min(last) as f64;
                    if let Some(command) = end.take() {
                        takes.send_replace(Some((command, period)));
                    }
                    end.publish(&state);
                    clock.until(period).await;
                }
            }
        });
        let control = watch::channel(Control::Running).1;
        let services = Services::bare(clock, control, Trace::bare(RunHash::default()).0);
        let answer = order(spawn("track", link, &services)).await;
        let taken = *taken.borrow();
        (answer, taken)
    }

    #[tokio::test(start_paused = true)]
    async fn force_sensor_is_zeroed_only_at_rest() {
        let bias = |edp: EdpHandle| async move { edp.bias().await };
        let (answer, taken) = ordered(u64::MAX, bias).await;
        let error = answer.unwrap_err().to_string();
        assert!(error.contains("the arm still moves after 0.6 s"), "{error}");
        assert_eq!(taken, None, "a moving sensor keeps its zero");

        // Two samples of the joints that agree are up to 24 periods after the end of the motion.
        let (answer, taken) = ordered(100, bias).await;
        assert!(answer.is_ok(), "{answer:?}");
        let (command, period) = taken.unwrap();
        assert_eq!(command, ServoCommand::Bias);
        assert!((105..130).contains(&period), "{period}");
    }

    #[tokio::test(start_paused = true)]
    async fn tool_changes_only_at_rest_and_rigidly() {
        let adjust = |adjustment| move |edp: EdpHandle| async move { edp.adjust(adjustment).await };
        let tool = Pose::translation(0.0, 0.0, 0.3);
        let (answer, taken) = ordered(u64::MAX, adjust(Adjustment::Tool(tool))).await;
        let error = answer.unwrap_err().to_string();
        assert!(error.contains("the arm still moves after 0.6 s: its frame"), "{error}");
        assert_eq!(taken, None);

        let (answer, taken) = ordered(0, adjust(Adjustment::Tool(tool))).await;
        assert!(answer.is_ok(), "{answer:?}");
        assert_eq!(taken.unwrap().0, ServoCommand::SetTool(tool));

        let bent = Pose::translation(0.0, f64::NAN, 0.3);
        let load = Adjustment::Load { weight: -1.0, centre: Point3::origin() };
        for (adjustment, reason) in [(Adjustment::Tool(bent), "not rigid"), (load, "0 N or more")] {
            let (answer, taken) = ordered(0, adjust(adjustment)).await;
            let error = answer.unwrap_err().to_string();
            assert!(error.contains(reason) && taken.is_none(), "{error}");
        }
        // A stopped arm has its brakes on: a reset does not wait for its rest.
        let (_, taken) = ordered(u64::MAX, adjust(Adjustment::Reset)).await;
        assert_eq!(taken.unwrap().0, ServoCommand::Reset);
    }

    #[test]
    fn arm_rest_check_allows_more_wrist_roll_motion() {
        // Returns whether the arm is at rest if one joint has moved by an angle (rad).
        let moved = |axis: usize, by: f64| {
            let mut now = JointPositions([0.5; 7]);
            now.0[axis] += by;
            is_still(&JointPositions([0.5; 7]), &now)
        };
        // Between the two limits `STILL` and `ROLL_STILL` only the roll of the wrist is at rest.
        for axis in 0..7 {
            assert!(moved(axis, 1e-4) && moved(axis, -1e-4), "{axis}");
            assert_eq!(moved(axis, -1e-3), axis == ROLL, "{axis}");
            assert!(!moved(axis, 5e-3), "{axis}");
        }
    }

    /// A change of a force sensor's zero is reported with its direction if it is larger than drift
    /// explains.
    #[test]
    fn large_shift_of_force_zero_names_its_direction() {
        // Changes of more than 8 N or 1 Nm, `ZERO_MOVED`, are reported.
        assert_eq!(moved_most(&[3.7, -2.0, 3.0, 0.3, -0.2, 0.1]), None);
        assert_eq!(moved_most(&[f64::NAN; 6]), None);

        let (direction, by) = moved_most(&[0.2, -9.0, -15.0, 0.1, 1.1, 0.0]).unwrap();
        let effector = "track".to_owned();
        let text = NonFatal::ZeroMoved { effector, by, direction }.to_string();
        assert_eq!(text, "force sensor of track: zero has moved by 15.0 N along z");
        assert_eq!(moved_most(&[8.5, 0.0, 0.0, 0.0, -2.5, 0.0]), Some((0, 8.5)));
        assert_eq!(moved_most(&[1.0, 0.0, 0.0, -2.0, 1.5, 0.0]), Some((3, 2.0)));
    }
}
