//! MP's end of the link to another node.
//!
//! Each actor of the node has a task here that takes its requests from a mailbox, as the actor
//! itself does, and sends them over the link. The answers come back under the numbers of the
//! requests.

use super::SILENT;
use super::beats::Beats;
use super::line::{Receiver, Sender};
use super::message::{
    Answer, Ask, EcpAsk, EdpAsk, HomeBeat, Introduction, NodeBeat, Tell, ToHome, ToNode,
};
use super::notices;
use super::pictures::Album;
use crate::actors::clock::Clock;
use crate::actors::ecp::{self, EcpHandle, Report};
use crate::actors::edp::{self, EdpHandle};
use crate::actors::services::Services;
use crate::actors::trace::Trace;
use crate::actors::vsp::{self, VspHandle};
use crate::actors::watchdog::{Watchdog, silent_node};
use crate::actors::way::BEAT;
use crate::emergency_stop::StopButton;
use crate::error::{Error, System};
use crate::generators::{Outcome, Target};
use crate::hw::driver::Switches;
use crate::motion::{ArmState, PERIOD};
use crate::net::Traffic;
use crate::vision::sensor::FaceReading;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::Instant;

/// Time between two requests to join.
const AGAIN: Duration = Duration::from_millis(500);

/// Longest time in which a node learns the difference of the periods.
const MAPPED: Duration = Duration::from_secs(2);
/// Time after which the state of an arm is sent again.
const RESEND: Duration = Duration::from_millis(100);

/// Result of joining: the effectors of the node, each with whether its arm is synchronised.
pub(crate) type Joined = Vec<(usize, bool)>;

/// MP's end of the link to a node. All clones are the same end.
#[derive(Debug, Clone)]
pub(crate) struct Home {
    name: String,
    sender: Sender<ToNode>,
    /// Longest time of a request and its answer on their way.
    trip: Duration,
    /// Longest time of a beat on its way.
    way: Duration,
    desk: Arc<Mutex<Desk>>,
    /// Whether the node has ended its part of the run.
    ended: Arc<watch::Sender<bool>>,
    /// Whether the node knows the difference of the periods.
    mapped: Arc<watch::Sender<bool>>,
}

/// Places to which the messages of the node go.
#[derive(Debug, Default)]
struct Desk {
    /// Number of the next request, and those whose answers have not come.
    next: u64,
    asked: BTreeMap<u64, Waiting>,
    alive: BTreeMap<usize, Arc<AtomicU64>>,
    states: BTreeMap<usize, watch::Sender<ArmState>>,
    targets: BTreeMap<usize, watch::Sender<Option<Target>>>,
    to_mp: BTreeMap<usize, mpsc::UnboundedSender<Report>>,
    /// Whether the node's part of the run was ended.
    dismissed: bool,
    /// Whether the exchange has begun.
    begun: bool,
    /// Whether someone watches the run, or records it.
    watched: bool,
    beats: Beats,
    /// Time of the last beat of the node that shows that messages come in time.
    timely: Option<Instant>,
}

/// Channel of an answer.
type Reply<T> = oneshot::Sender<Result<T, Error>>;

/// Channel of an answer that has not come.
#[derive(Debug)]
enum Waiting {
    State(Reply<ArmState>),
    Behaved(Reply<(Outcome, ArmState)>),
    Face(Reply<FaceReading>),
    Begun(Reply<()>),
}

/// Nodes with an arm that a fault stops.
pub(crate) type Stopped = Arc<Mutex<BTreeSet<String>>>;

/// Parts of MP's node that a link watches and serves.
pub(crate) struct Watch {
    /// Services of the run.
    pub(crate) services: Services,
    /// Switches of the servos of MP's node.
    pub(crate) switches: Arc<Switches>,
    /// Button of the emergency stop that these servos read.
    pub(crate) stop_button: StopButton,
    /// States of the arms that the node does not have itself, by effector.
    pub(crate) states: Vec<(usize, watch::Receiver<ArmState>)>,
    /// Nodes with a stopped arm, which all links of the run share.
    pub(crate) stopped: Stopped,
    /// Cameras of the node: index, and size of the pictures (px).
    pub(crate) cameras: BTreeMap<usize, (u32, u32)>,
}

/// Places at MP's node to which the messages of a node go, beside its requesters.
struct Local {
    arms: Arms,
    clock: Clock,
    watchdog: Watchdog,
    trace: Trace,
    album: Album,
}

/// Switches of the servos of MP's node, as the beats of other nodes set them.
struct Arms {
    switches: Arc<Switches>,
    stop_button: StopButton,
    stopped: Stopped,
}

impl Arms {
    /// Takes a beat of the node `name`. The arms stand by while an arm of any node is stopped: both
    /// hands may hold one cube.
    fn take(&self, name: &str, beat: &NodeBeat) {
        if beat.pressed {
            self.stop_button.press();
        }
        let mut stopped = self.stopped.lock().unwrap_or_else(PoisonError::into_inner);
        if beat.stopped {
            stopped.insert(name.to_owned());
        } else {
            stopped.remove(name);
        }
        self.switches.stands_by.store(!stopped.is_empty(), Ordering::Release);
    }
}

impl Waiting {
    /// Passes the answer on. Returns whether it is one to this request.
    fn answer(self, answer: Answer) -> bool {
        // The actor that has asked may have given up.
        match (self, answer) {
            (Self::State(reply), Answer::State(answer)) => drop(reply.send(answer)),
            (Self::Behaved(reply), Answer::Behaved(answer)) => drop(reply.send(answer)),
            (Self::Face(reply), Answer::Face(answer)) => drop(reply.send(answer)),
            (Self::Begun(reply), Answer::Begun(answer)) => drop(reply.send(answer)),
            _ => return false,
        }
        true
    }
}

impl Home {
    /// Makes MP's end of the link to the node `name`. A request and its answer are on their way for
    /// `trip` at most, a beat for `way`.
    pub(crate) fn new(name: &str, sender: Sender<ToNode>, trip: Duration, way: Duration) -> Self {
        let (ended, mapped) = (Arc::default(), Arc::default());
        Self { name: name.to_owned(), sender, trip, way, desk: Arc::default(), ended, mapped }
    }

    /// Asks the node to take part in a run, until it answers, at most for `limit`. Returns its
    /// effectors, each with whether its arm is synchronised.
    ///
    /// # Errors
    /// The reason why the node does not take part.
    pub(crate) async fn join(
        &self,
        receiver: &mut Receiver<ToHome>,
        introduction: &Introduction,
        limit: Duration,
    ) -> Result<Joined, String> {
        let answered = async {
            loop {
                self.sender.send(&ToNode::Join(introduction.clone()));
                match tokio::time::timeout(AGAIN, receiver.recv()).await {
                    Ok(Some(Ok(ToHome::Joined { run, arms }))) if run == introduction.run => {
                        return Ok(arms);
                    }
                    Ok(Some(Ok(ToHome::Refused { run, why }))) if run == introduction.run => {
                        return Err(why);
                    }
                    Ok(None) => return Err("the link has ended".to_owned()),
                    // Messages of an earlier run do not count.
                    Ok(Some(_)) | Err(_) => {}
                }
            }
        };
        let silent = || format!("no answer in {:.0} s", limit.as_secs_f64());
        tokio::time::timeout(limit, answered).await.map_err(|_| silent())?
    }

    /// Sends beats to a node that has joined, until the exchange begins: its arms stand by.
    pub(crate) fn keep_alive(&self) {
        let home = self.clone();
        tokio::spawn(async move {
            while !home.desk().begun && !home.desk().dismissed {
                home.send_beat(None, false, true);
                tokio::time::sleep(BEAT).await;
            }
        });
    }

    /// Starts the exchange with the node: beats, control and states go out, and the node's messages
    /// come in. Returns once the node knows the difference of the periods.
    ///
    /// # Errors
    /// If the node does not learn it in [`MAPPED`].
    pub(crate) async fn start(
        &self,
        mut receiver: Receiver<ToHome>,
        watch: Watch,
    ) -> Result<(), Error> {
        let Watch { services, switches, stop_button, states, stopped, cameras } = watch;
        let Services { clock, control, tuning, trace, supervision, .. } = services;
        self.desk().begun = true;
        self.desk().watched = trace.latest().is_some() || trace.is_recorded();
        self.send_beats(clock.clone(), Arc::clone(&switches), supervision.watchdog.clone());
        let album = Album::new(&self.name, cameras, &trace);
        let album = album.map_err(|why| self.failed(why.to_string()))?;
        let (home, watchdog) = (self.clone(), supervision.watchdog.clone());
        let arms = Arms { switches, stop_button, stopped };
        let mut local = Local { arms, clock, watchdog, trace, album };
        tokio::spawn(async move {
            while let Some(message) = receiver.recv().await {
                match message {
                    Ok(message) => home.take(message, &mut local),
                    Err(why) => local.watchdog.raise(home.failed(why)),
                }
            }
        });
        let mut mapped = self.mapped.subscribe();
        let known = tokio::time::timeout(MAPPED, mapped.wait_for(|mapped| *mapped)).await;
        if known.is_err() {
            return Err(self.failed("its beats do not come back in time".to_owned()));
        }
        self.tell_each(control, Tell::Control);
        self.tell_each(tuning.courses(), Tell::Parameters);
        for (effector, state) in states {
            self.send_states(effector, state);
        }
        Ok(())
    }

    /// Waits until the drives of a node that was dismissed are off, at most until `limit`: a node
    /// that is dead does not answer.
    pub(crate) async fn gone(&self, limit: Instant) {
        let mut ended = self.ended.subscribe();
        let _ = tokio::time::timeout_at(limit, ended.wait_for(|ended| *ended)).await;
    }

    /// Returns the traffic of this end of the link.
    pub(crate) fn traffic(&self) -> Traffic {
        self.sender.traffic()
    }

    /// Sends no beat any more, as a node that is dead.
    #[cfg(test)]
    pub(super) fn silence(&self) {
        self.desk().dismissed = true;
    }

    /// Ends the node's part of the run. Returns whether it had not been ended before.
    pub(crate) fn dismiss(&self) -> bool {
        let is_first = !std::mem::replace(&mut self.desk().dismissed, true);
        if is_first {
            self.sender.send(&ToNode::Leave);
        }
        is_first
    }

    /// Returns the handle of an EDP of the node. `patience` is the time of an answer on one node.
    pub(crate) fn edp(
        &self,
        effector: usize,
        arm: &str,
        patience: Duration,
        clock: &Clock,
    ) -> EdpHandle {
        let (state, states) = watch::channel(ArmState::default());
        self.desk().states.insert(effector, state);
        let (handle, mut requests) = edp::remote(arm, states, patience + self.trip, clock);
        let home = self.clone();
        tokio::spawn(async move {
            while let Some(request) = requests.recv().await {
                let (ask, reply) = match request {
                    edp::Request::State { reply } => (EdpAsk::State, reply),
                    edp::Request::Synchronise { reply } => (EdpAsk::Synchronise, reply),
                    // Its ECP is beside it: only that one moves and adjusts the arm. The dropped
                    // channel tells the sender.
                    edp::Request::Execute { .. }
                    | edp::Request::Adjust { .. }
                    | edp::Request::Bias { .. } => continue,
                };
                home.ask(Ask::Edp(effector, ask), Waiting::State(reply));
            }
        });
        handle
    }

    /// Returns the handle of an ECP of the node. `silence` is the longest time between two of its
    /// signs of life on one node, `beginning` the clock of MP's node with the time between the
    /// order of a motion and its beginning (periods).
    pub(crate) fn ecp(
        &self,
        effector: usize,
        arm: &str,
        silence: Duration,
        beginning: (Clock, u64),
    ) -> EcpHandle {
        let alive = Arc::new(AtomicU64::new(0));
        self.desk().alive.insert(effector, Arc::clone(&alive));
        let patience = silence + self.trip + BEAT;
        let (handle, mut requests) = ecp::remote(arm, alive, patience, beginning);
        let home = self.clone();
        tokio::spawn(async move {
            while let Some(request) = requests.recv().await {
                home.pass(effector, request);
            }
        });
        handle
    }

    /// Returns the handle of a VSP of the node.
    pub(crate) fn vsp(&self, index: usize, name: &str) -> VspHandle {
        let (target, targets) = watch::channel(None);
        self.desk().targets.insert(index, target);
        let (handle, ends) = vsp::remote(name, targets, self.trip);
        let vsp::Ends { mut looks, mut tracking, mut sensing } = ends;
        let home = self.clone();
        tokio::spawn(async move {
            while let Some(vsp::Look { view, reply }) = looks.recv().await {
                home.ask(Ask::Look(index, view), Waiting::Face(reply));
            }
        });
        let home = self.clone();
        tokio::spawn(async move {
            while tracking.changed().await.is_ok() {
                home.tell(Tell::Track(index, *tracking.borrow_and_update()));
            }
        });
        let home = self.clone();
        tokio::spawn(async move {
            while sensing.changed().await.is_ok() {
                home.tell(Tell::Sense(index, *sensing.borrow_and_update()));
            }
        });
        handle
    }

    /// Sends a request of MP to an ECP of the node.
    fn pass(&self, effector: usize, request: ecp::Request) {
        use ecp::Request;
        let (ask, waiting) = match request {
            Request::Behave { behaviour, begins, reply } => {
                (EcpAsk::Behave(behaviour, begins), Waiting::Behaved(reply))
            }
            Request::Bias { reply } => (EcpAsk::Bias, Waiting::State(reply)),
            Request::Synchronise { reply } => (EcpAsk::Synchronise, Waiting::State(reply)),
            Request::Adjust { adjustment, reply } => {
                (EcpAsk::Adjust(adjustment), Waiting::State(reply))
            }
            Request::State { reply } => (EcpAsk::State, Waiting::State(reply)),
            Request::Look { view, reply } => (EcpAsk::Look(view), Waiting::Face(reply)),
            Request::Start { programme, to_mp, reply } => {
                self.desk().to_mp.insert(effector, to_mp.mailbox);
                (EcpAsk::Start(programme), Waiting::Begun(reply))
            }
            Request::End(ending) => return self.tell(Tell::End(effector, ending)),
            Request::Watch { on } => return self.tell(Tell::Watch(effector, on)),
            Request::Signal(signal) => return self.tell(Tell::Signal(effector, signal)),
            // A scenario with an EDP on another node has no continuous coordination. The dropped
            // channel tells the sender.
            Request::Transmit { .. } => return,
        };
        self.ask(Ask::Ecp(effector, ask), waiting);
    }

    /// Sends a request, whose answer goes to `waiting`.
    fn ask(&self, ask: Ask, waiting: Waiting) {
        let number = {
            let mut desk = self.desk();
            desk.next += 1;
            let number = desk.next;
            desk.asked.insert(number, waiting);
            number
        };
        self.sender.send(&ToNode::Ask { number, ask });
    }

    /// Sends a message that has no answer.
    fn tell(&self, tell: Tell) {
        self.sender.send(&ToNode::Tell(tell));
    }

    /// Sends a beat every [`BEAT`], and raises an error once those of the node do not arrive.
    fn send_beats(&self, clock: Clock, switches: Arc<Switches>, watchdog: Watchdog) {
        let (home, limit) = (self.clone(), SILENT + self.way);
        tokio::spawn(async move {
            let begun = Instant::now();
            let silence = |home: &Self| home.desk().timely.unwrap_or(begun).elapsed();
            while !home.desk().dismissed {
                let pressed = switches.emergency.is_pressed();
                let stands_by = switches.hold.load(Ordering::Acquire)
                    || switches.stands_by.load(Ordering::Acquire)
                    || switches.has_stopped();
                home.send_beat(Some(clock.period()), pressed, stands_by);
                if silence(&home) > limit {
                    // If this process was stalled, beats wait for the task that takes them.
                    tokio::task::yield_now().await;
                    let silent = silence(&home);
                    if silent > limit {
                        watchdog.raise(silent_node(format!("node {}", home.name), silent));
                    }
                }
                tokio::time::sleep(BEAT).await;
            }
        });
    }

    /// Sends a beat.
    fn send_beat(&self, period: Option<u64>, pressed: bool, stands_by: bool) {
        let (number, echo, watched) = {
            let mut desk = self.desk();
            (desk.beats.next(), desk.beats.echo(), desk.watched)
        };
        let beat = HomeBeat { number, period, echo, pressed, stands_by, watched };
        self.sender.send(&ToNode::Beat(beat));
    }

    /// Sends a value of MP's node, now and at each change, as `tell` writes it.
    fn tell_each<T: Clone + Send + Sync + 'static>(
        &self,
        mut value: watch::Receiver<T>,
        tell: fn(T) -> Tell,
    ) {
        let home = self.clone();
        tokio::spawn(async move {
            loop {
                let now = value.borrow_and_update().clone();
                home.tell(tell(now));
                if value.changed().await.is_err() {
                    return;
                }
            }
        });
    }

    /// Sends the states of an arm that the node does not have.
    fn send_states(&self, effector: usize, mut state: watch::Receiver<ArmState>) {
        let home = self.clone();
        tokio::spawn(async move {
            // The last state of a motion may be lost, and no newer one follows.
            while !matches!(tokio::time::timeout(RESEND, state.changed()).await, Ok(Err(_))) {
                home.sender.send(&ToNode::State(effector, *state.borrow_and_update()));
            }
        });
    }

    /// Takes a message of the node.
    fn take(&self, message: ToHome, local: &mut Local) {
        let mut desk = self.desk();
        match message {
            ToHome::Answer { number, answer } => {
                let waiting = desk.asked.remove(&number);
                if !waiting.is_some_and(|waiting| waiting.answer(answer)) {
                    let why = format!("an answer to no request, {number}");
                    local.watchdog.raise(self.failed(why));
                }
            }
            ToHome::Report(effector, report) => {
                if let Some(to_mp) = desk.to_mp.get(&effector) {
                    let _ = to_mp.send(report);
                }
            }
            ToHome::Failed(error) => local.watchdog.raise(error),
            ToHome::Beat(beat) => {
                self.take_beat(&mut desk, &beat);
                local.arms.take(&self.name, &beat);
            }
            ToHome::State(effector, state) => {
                if let Some(latest) = local.trace.latest() {
                    latest.state(effector, &state);
                }
                if let Some(to) = desk.states.get(&effector) {
                    to.send_replace(state);
                }
            }
            ToHome::Target(vsp, target) => {
                if let Some(to) = desk.targets.get(&vsp) {
                    to.send_replace(target);
                }
            }
            ToHome::Notice { class, who, text } => {
                let seconds = local.clock.period() as f64 * PERIOD;
                local.trace.tell(notices::of_node(&self.name, seconds, (class, who, text)));
            }
            ToHome::Picture(shown) => local.album.take(shown, local.clock.period()),
            // Answers to requests to join that were repeated.
            ToHome::Joined { .. } | ToHome::Refused { .. } => {}
            ToHome::Ended => drop(self.ended.send_replace(true)),
        }
    }

    /// Takes a beat of the node.
    fn take_beat(&self, desk: &mut Desk, beat: &NodeBeat) {
        desk.beats.arrived(beat.number);
        // A beat whose echo is old has waited behind others: orders would wait as well.
        let late = beat.echo.is_some_and(|echo| desk.beats.trip(echo) > SILENT + 2 * self.way);
        if !late {
            desk.timely = Some(Instant::now());
        }
        for (effector, count) in &beat.alive {
            if let Some(alive) = desk.alive.get(effector) {
                alive.store(*count, Ordering::Relaxed);
            }
        }
        if beat.mapped {
            self.mapped.send_if_modified(|mapped| !std::mem::replace(mapped, true));
        }
    }

    /// Makes the error of a link that has failed.
    fn failed(&self, why: String) -> Error {
        let who = format!("node {}", self.name);
        Error::System { actor: who.clone(), place: "link".into(), cause: System::Link { who, why } }
    }

    /// Locks the places of the node's messages.
    fn desk(&self) -> std::sync::MutexGuard<'_, Desk> {
        self.desk.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
