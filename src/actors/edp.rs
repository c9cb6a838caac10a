//! EDP: drives one effector. This actor is the paper's EDPM (communication with the ECP, interpretation of its
//! commands); EDPT and EDPS are parts of the servo period ([`crate::servo`]), and the force readings (EDPF) come
//! with the bridge's exchange.
//!
//! An answer goes out two servo periods before the macrostep ends, so that the next one follows without a gap.

use super::clock::Clock;
use super::fault::ActorFault;
use super::services::Services;
use super::trace::Trace;
use super::watchdog::{Heartbeat, Supervision, answer_of};
use crate::error::{Error, Fatal, NonFatal, System};
use crate::hw::driver::{HEART, ServoLink};
use crate::motion::{
    ArmFault, ArmState, JointPositions, MoveCommand, MoveRefused, PERIOD, ROLL, Synchronisation,
};
use crate::servo::ServoCommand;
use crate::spatial::Pose;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{mpsc, oneshot, watch};
use tracing::Instrument as _;

/// How many periods before its end a macrostep is answered.
const EARLY: u64 = 2;
/// Periods that taking a bias lasts: ten samples and the filters before them.
const BIAS_PERIODS: u64 = 16;
/// An arm stands if no joint moves by more (m, rad) in so many periods: a tool of 1.1 kg that comes
/// to rest so feels less than 0.1 N of its inertia. The roll settles last, and its axis goes
/// through the tool's centre of mass.
const RESTS: f64 = 2.5e-4;
const ROLL_RESTS: f64 = 2.5e-3;
const REST_PERIODS: u64 = 12;
/// How often that is looked at, before the sensor of an arm that is never still is zeroed anyhow.
const REST_TRIES: u32 = 10;
/// A zero that has moved by more is told (N, Nm). In missions without faults it moves by 1.7 N and
/// 0.13 Nm at most, by drift, by what the believed weights are wrong, and by a cube that is turned
/// over; an operator who pulls meanwhile adds 6 N.
const ZERO_MOVED: [f64; 2] = [8.0, 1.0];
/// Periods between two looks at an arm that is being synchronised.
const PROGRESS: u64 = 25;
/// How often the servo is asked again whether it is done.
const POLL: Duration = Duration::from_millis(1);
/// Time without an answer after which the servo counts as gone (s).
const SILENCE: f64 = 0.5;
/// How long what is no motion takes at most.
const SERVICE: Duration = Duration::from_millis(100);
/// How much longer the zero of a sensor may take, whose arm comes to rest.
const REST: Duration = Duration::from_millis(300);
/// Capacity of the mailbox: an ECP has at most one request under way.
const MAILBOX: usize = 4;

/// What an ECP asks of its EDP; each request carries the way back.
#[derive(Debug)]
enum Request {
    Execute { command: MoveCommand, reply: oneshot::Sender<Result<ArmState, Error>> },
    SetTool { flange_from_tool: Pose, reply: oneshot::Sender<Result<ArmState, Error>> },
    Bias { reply: oneshot::Sender<Result<ArmState, Error>> },
    State { reply: oneshot::Sender<Result<ArmState, Error>> },
    Synchronise { reply: oneshot::Sender<Result<ArmState, Error>> },
}

/// The far end of an EDP's mailbox. Dropping the last clone ends the EDP.
#[derive(Debug, Clone)]
pub struct EdpHandle {
    name: String,
    mailbox: mpsc::Sender<Request>,
    state: watch::Receiver<ArmState>,
    patience: Duration,
}

impl EdpHandle {
    /// Executes a move and returns the state two periods before its end.
    ///
    /// # Errors
    /// Non-fatal when the command is refused, fatal when the arm has stopped.
    pub async fn execute(&self, command: MoveCommand) -> Result<ArmState, Error> {
        // It may wait for the end of the command before.
        let lasts = Duration::from_secs_f64(2.0 * f64::from(command.periods) * PERIOD);
        self.ask("execute", Some(lasts), |reply| Request::Execute { command, reply }).await
    }

    /// Changes the tool frame; the arm does not move.
    ///
    /// # Errors
    /// System when the EDP is gone.
    pub async fn set_tool(&self, flange_from_tool: Pose) -> Result<ArmState, Error> {
        self.ask("set tool", Some(SERVICE), |reply| Request::SetTool { flange_from_tool, reply })
            .await
    }

    /// Sets the force sensor to zero as it is loaded now.
    ///
    /// # Errors
    /// Fatal when the arm has stopped; non-fatal when the sensor is silent, or when it is zeroed, but far from the zero before.
    pub async fn bias(&self) -> Result<ArmState, Error> {
        self.ask("bias", Some(SERVICE + REST), |reply| Request::Bias { reply }).await
    }

    /// Finds the synchronisation position, axis by axis; at once when the arm knows it. Until then the arm takes
    /// no other motion than relative ones of its motors.
    ///
    /// # Errors
    /// Fatal when a switch or an encoder's zero does not come, or another fault stops the arm.
    pub async fn synchronise(&self) -> Result<ArmState, Error> {
        self.ask("synchronise", None, |reply| Request::Synchronise { reply }).await
    }

    /// The present state.
    ///
    /// # Errors
    /// Fatal when the arm has stopped.
    pub async fn state(&self) -> Result<ArmState, Error> {
        self.ask("state", Some(SERVICE), |reply| Request::State { reply }).await
    }

    /// States as they are published at each macrostep.
    #[must_use]
    pub fn watch(&self) -> watch::Receiver<ArmState> {
        self.state.clone()
    }

    async fn ask(
        &self,
        place: &'static str,
        lasts: Option<Duration>,
        request: impl FnOnce(oneshot::Sender<Result<ArmState, Error>>) -> Request,
    ) -> Result<ArmState, Error> {
        let closed = || Error::System {
            actor: self.name.clone(),
            place,
            cause: System::Closed(self.name.clone()),
        };
        let (reply, answer) = oneshot::channel();
        self.mailbox.send(request(reply)).await.map_err(|_| closed())?;
        let limit = lasts.map(|lasts| lasts + self.patience);
        answer_of(&self.name, place, limit, answer).await
    }
}

/// The actor.
struct Edp {
    name: String,
    link: ServoLink,
    clock: Clock,
    mailbox: mpsc::Receiver<Request>,
    state: watch::Sender<ArmState>,
    trace: Trace,
    /// First period after the last command.
    free: u64,
    fault: Arc<ActorFault>,
    heartbeat: Heartbeat,
    /// Commands that came twice, as far as they were told.
    doubles: u64,
    /// The force sensor has been zeroed before: the first time nobody knows where its zero is.
    zeroed: bool,
}

/// Creates an EDP around one arm's servo.
#[must_use]
pub fn spawn(name: &str, mut link: ServoLink, services: &Services) -> EdpHandle {
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
        fault: Arc::clone(fault),
        heartbeat: watchdog.heartbeat(&name),
        doubles: 0,
        zeroed: false,
    };
    let span = tracing::info_span!("edp", name = edp.name);
    watchdog.spawn(&name, edp.run().instrument(span));
    EdpHandle { name, mailbox, state: watching, patience: *patience }
}

impl Edp {
    async fn run(mut self) {
        // Nothing is known before the servo's first period.
        while self.link.state().period == 0 {
            self.clock.until(self.clock.period() + 1).await;
        }
        while let Some(request) = self.mailbox.recv().await {
            self.heartbeat.works();
            self.fault.before_message().await;
            if self.fault.is_lost() {
                self.heartbeat.waits();
                continue;
            }
            let (answer, reply) = match request {
                Request::Execute { command, reply } => (self.execute(command).await, reply),
                Request::SetTool { flange_from_tool, reply } => {
                    let sent = self.send("set tool", ServoCommand::SetTool(flange_from_tool));
                    (self.after(sent, 2).await, reply)
                }
                Request::Bias { reply } => (self.bias().await, reply),
                Request::Synchronise { reply } => (self.synchronise().await, reply),
                Request::State { reply } => {
                    // One that died without a word would be seen as it was last.
                    let told = self.check("state");
                    let is_gone = self.link.is_closed();
                    (
                        told.and_then(|s| if is_gone { Err(self.silent("state")) } else { Ok(s) }),
                        reply,
                    )
                }
            };
            self.trace.message(&self.name, "ecp", &answer);
            // The asker may have gone; that is its affair.
            let _ = reply.send(answer);
            self.heartbeat.waits();
        }
    }

    fn send(&mut self, place: &'static str, command: ServoCommand) -> Result<u64, Error> {
        self.trace.message("edp", &self.name, &command);
        if self.fault.is_doubled() {
            self.link.double();
        }
        self.link.send(command).map_err(|_| self.silent(place))
    }

    fn silent(&self, place: &'static str) -> Error {
        let cause = System::Silent { who: "the servo".into(), seconds: SILENCE };
        Error::System { actor: self.name.clone(), place, cause }
    }

    async fn execute(&mut self, command: MoveCommand) -> Result<ArmState, Error> {
        if command.periods == 0 {
            let cause = NonFatal::Arguments("a move command must last at least one period".into());
            return Err(Error::NonFatal { actor: self.name.clone(), place: "execute", cause });
        }
        let start = self.free.max(self.link.state().period + 1);
        tracing::trace!(start, periods = command.periods, motion = ?command.motion, "execute");
        let ticket = self.send("execute", ServoCommand::Move { command, start })?;
        self.free = start + u64::from(command.periods);
        self.done("execute", ticket, self.free.saturating_sub(self.link.early()).max(start))
            .await?;
        let doubles = self.link.doubles();
        if doubles > self.doubles {
            self.doubles = doubles;
            tracing::warn!(actor = %self.name, period = self.clock.period(), "a command came twice: obeyed once");
        }
        self.check("execute")
    }

    async fn after(&mut self, sent: Result<u64, Error>, periods: u64) -> Result<ArmState, Error> {
        let ticket = sent?;
        self.done("service", ticket, self.free.max(self.clock.period()) + periods).await?;
        self.check("service")
    }

    /// Waits until an arm stands that has come from a way: the zero of a sensor in motion would
    /// hold the inertia of the tool.
    async fn come_to_rest(&mut self) {
        let mut before = self.link.state().joints;
        for _ in 0..REST_TRIES {
            let soon = self.clock.until(self.clock.period() + REST_PERIODS);
            self.heartbeat.away(soon).await;
            let now = self.link.state().joints;
            if stood(&before, &now) {
                return;
            }
            before = now;
        }
    }

    /// A zero of a sensor that says nothing would be the old one.
    async fn bias(&mut self) -> Result<ArmState, Error> {
        self.come_to_rest().await;
        let before = self.link.state().wrench_in_tool;
        let sent = self.send("bias", ServoCommand::Bias);
        let state = self.after(sent, BIAS_PERIODS).await?;
        let cause = if state.wrench_in_tool.is_finite() {
            // What weighs or pulls is the same before and after, so that the difference is the zero's.
            let zeroed = std::mem::replace(&mut self.zeroed, true);
            let by = (before - state.wrench_in_tool).directions();
            tracing::debug!(zeroed, ?by, "the zero moves");
            match far_off(&by).filter(|_| zeroed) {
                None => return Ok(state),
                Some((direction, by)) => {
                    let effector = self.name.trim_start_matches("edp ").to_owned();
                    NonFatal::ZeroMoved { effector, by, direction }
                }
            }
        } else {
            NonFatal::NoReading(format!("the force sensor is silent, period {}", state.period))
        };
        Err(Error::NonFatal { actor: self.name.clone(), place: "bias", cause })
    }

    /// The state in between is published at each period of [`PROGRESS`].
    async fn synchronise(&mut self) -> Result<ArmState, Error> {
        if self.check("synchronise")?.synchronisation == Synchronisation::Yes {
            return self.check("synchronise");
        }
        let ticket = self.send("synchronise", ServoCommand::Synchronise)?;
        self.done("synchronise", ticket, self.clock.period() + 2).await?;
        let (mut last, mut stood) = (0, 0);
        loop {
            let state = self.check("synchronise")?;
            stood = if state.period == last { stood + PROGRESS } else { 0 };
            last = state.period;
            if stood as f64 * PERIOD > SILENCE {
                return Err(self.silent("synchronise"));
            }
            match state.synchronisation {
                Synchronisation::Yes => return Ok(state),
                Synchronisation::Under { .. } => {}
                Synchronisation::No => {
                    let why = state.refused.unwrap_or(MoveRefused::BrokenOff);
                    let (actor, cause) = (self.name.clone(), NonFatal::Refused(why));
                    return Err(Error::NonFatal { actor, place: "synchronise", cause });
                }
            }
            if self.link.is_closed() {
                return Err(self.silent("synchronise"));
            }
            self.heartbeat.away(self.clock.until(self.clock.period() + PROGRESS)).await;
        }
    }

    /// Waits until a period has come and the servo has dealt with a command. Under the wall clock the servo's
    /// periods and the runtime's time differ by a little, hence the polling.
    async fn done(&mut self, place: &'static str, ticket: u64, period: u64) -> Result<(), Error> {
        self.heartbeat.away(self.clock.until(period)).await;
        let patience = (SILENCE / POLL.as_secs_f64()) as u64;
        for _ in 0..patience {
            if self.link.is_done(ticket, EARLY) {
                return Ok(());
            }
            if self.link.is_closed() {
                break;
            }
            self.heartbeat.away(tokio::time::sleep(POLL)).await;
        }
        Err(self.silent(place))
    }

    fn check(&mut self, place: &'static str) -> Result<ArmState, Error> {
        let state = *self.link.state();
        self.state.send_replace(state);
        let actor = self.name.clone();
        let silent = |seconds| {
            let cause = System::Silent { who: "the actors' heart".into(), seconds };
            Err(Error::System { actor: actor.clone(), place, cause })
        };
        if let Some(ArmFault::HeartBeat { seconds }) = state.fault {
            return silent(seconds);
        }
        // A stop of all arms is on its way: its cause is told now, they stand in a moment.
        let stopping = match state.refused {
            Some(MoveRefused::Stopping { periods }) => Some(ArmFault::Missed { periods }),
            _ => None,
        };
        if let Some(fault) = state.fault.or(stopping) {
            let last = Some(Box::new(state));
            return Err(Error::Fatal { actor, place, cause: Fatal::Arm(fault), last });
        }
        match state.refused {
            // Brought to a stand because nobody's heart beat was felt: not a matter of this command.
            Some(MoveRefused::BrokenOff) if place == "execute" => silent(HEART.as_secs_f64()),
            Some(refused) if place == "execute" => {
                Err(Error::NonFatal { actor, place, cause: NonFatal::Refused(refused) })
            }
            _ => Ok(state),
        }
    }
}

/// Whether an arm stood that went so far in [`REST_PERIODS`].
fn stood(before: &JointPositions, now: &JointPositions) -> bool {
    let moved = |axis: usize| (now.0[axis] - before.0[axis]).abs();
    moved(ROLL) < ROLL_RESTS && (0..ROLL).all(|axis| moved(axis) < RESTS)
}

/// The direction in which a zero has moved farthest, beyond [`ZERO_MOVED`], and by how much (N,
/// Nm). A force comes first: it has a torque of its own about the tool's point.
fn far_off(by: &[f64; 6]) -> Option<(usize, f64)> {
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
    use tokio::time::Instant;

    #[tokio::test(start_paused = true)]
    async fn a_servo_that_is_gone_is_told_by_whoever_only_asks_for_the_state() {
        let (link, mut end) = driver::link();
        end.publish(&ArmState { period: 1, ..ArmState::default() });
        let clock = Clock::new(Instant::now(), Arc::default());
        let control = watch::channel(Control::Running).1;
        let services = Services::bare(clock, control, Trace::bare(RunHash::default()).0);
        let edp = spawn("track", link, &services);
        assert!(edp.state().await.is_ok());

        drop(end);

        let told = edp.state().await.unwrap_err().to_string();
        assert_eq!(told, "system, edp track, state: no answer from the servo in 0.5 s");
    }

    #[test]
    fn arm_stands_whose_roll_alone_still_settles() {
        let moved = |axis: usize, by: f64| {
            let mut now = JointPositions([0.5; 7]);
            now.0[axis] += by;
            stood(&JointPositions([0.5; 7]), &now)
        };
        for axis in 0..7 {
            assert!(moved(axis, 1e-4) && moved(axis, -1e-4), "{axis}");
            assert_eq!(moved(axis, -1e-3), axis == ROLL, "{axis}");
            assert!(!moved(axis, 5e-3), "{axis}");
        }
    }

    #[test]
    fn a_zero_that_has_moved_far_is_told_in_its_direction_and_drift_is_not() {
        assert_eq!(far_off(&[3.7, -2.0, 3.0, 0.3, -0.2, 0.1]), None);
        assert_eq!(far_off(&[f64::NAN; 6]), None);

        let (direction, by) = far_off(&[0.2, -9.0, -15.0, 0.1, 1.1, 0.0]).unwrap();
        let effector = "track".to_owned();
        let told = NonFatal::ZeroMoved { effector, by, direction }.to_string();
        assert_eq!(told, "force sensor of track: zero has moved by 15.0 N along z");
        assert_eq!(far_off(&[8.5, 0.0, 0.0, 0.0, -2.5, 0.0]), Some((0, 8.5)));
        assert_eq!(far_off(&[1.0, 0.0, 0.0, -2.0, 1.5, 0.0]), Some((3, 2.0)));
    }
}
