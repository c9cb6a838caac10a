//! End of the link at a node beside that of MP: passes requests on to the actors of the node and
//! returns their answers.
//!
//! - in: messages of MP's node; states of the node's arms, poses of the cube
//! - out: requests to the actors; answers, states, beats
//!
//! The servo lives by the beats of MP's node: without them it brakes and trips, as it does without
//! actors.

use super::beats::Beats;
use super::line::{Receiver, Sender};
use super::message::{Answer, Ask, EcpAsk, EdpAsk, HomeBeat, NodeBeat, Tell, ToHome, ToNode};
use super::offset::{Estimator, Offset};
use super::{GONE, SILENT};
use crate::actors::clock::Clock;
use crate::actors::control::Control;
use crate::actors::ecp::{self, EcpHandle, Outbox};
use crate::actors::edp::{self, EdpHandle};
use crate::actors::vsp::{self, VspHandle};
use crate::actors::watchdog::Watchdog;
use crate::actors::way::BEAT;
use crate::emergency_stop::StopButton;
use crate::error::{Error, System};
use crate::hw::driver::Switches;
use crate::motion::ArmState;
use crate::operator::parameter::Courses;
use crate::record::recorder::{Entry, Recorder};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::Instant;

/// Time after which the state of an arm is sent again.
const RESEND: Duration = Duration::from_millis(100);

/// Actors of a node, and what they share with MP's node.
pub(crate) struct Host {
    /// Number of the run.
    pub(crate) run: u64,
    /// Effectors of the node, each with whether its arm was synchronised at the beginning.
    pub(crate) arms: Vec<(usize, bool)>,
    /// Sending end of the link to MP's node.
    pub(crate) sender: Sender<ToHome>,
    /// EDPs of the node, by effector.
    pub(crate) edps: BTreeMap<usize, EdpHandle>,
    /// ECPs of the node, by effector.
    pub(crate) ecps: BTreeMap<usize, EcpHandle>,
    /// VSPs of the node, by their index.
    pub(crate) vsps: BTreeMap<usize, VspHandle>,
    /// States of the arms of other nodes, by effector.
    pub(crate) states: BTreeMap<usize, watch::Sender<ArmState>>,
    /// The operator's control, as the actors of the node see it.
    pub(crate) control: watch::Sender<Control>,
    /// The operator's parameters, as the actors of the node see them.
    pub(crate) courses: watch::Sender<Courses>,
    /// Difference of the periods.
    pub(crate) offset: Offset,
    /// Recorder of the node.
    pub(crate) recorder: Recorder,
    /// Whether someone watches or records the run at MP's node.
    pub(crate) watched: Arc<AtomicBool>,
    /// Clock of the node.
    pub(crate) clock: Clock,
    /// Switches of the node's servos.
    pub(crate) switches: Arc<Switches>,
    /// Button of the emergency stop that these servos read.
    pub(crate) stop_button: StopButton,
    /// Watchdog of the node's actors.
    pub(crate) watchdog: Watchdog,
    /// Longest time of a beat on its way.
    pub(crate) way: Duration,
}

/// Queues of requests to the actors of a node. An actor that is at work takes no request, and beats
/// must not wait for it.
struct Queues {
    edps: BTreeMap<usize, mpsc::UnboundedSender<edp::Request>>,
    ecps: BTreeMap<usize, mpsc::UnboundedSender<ecp::Request>>,
    vsps: BTreeMap<usize, mpsc::UnboundedSender<vsp::Look>>,
}

/// Course of a node's beats.
struct Course {
    beats: Beats,
    estimator: Estimator,
    /// Whether the difference of the periods is known.
    mapped: watch::Sender<bool>,
    /// Time of the last beat that shows that messages come in time.
    timely: Instant,
}

/// End of a node's part of a run.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Left {
    /// MP's node has ended the run.
    Over,
    /// MP's node is silent, or a message of it is missing.
    Alone(String),
    /// An actor of this node has failed; MP's node was told.
    Failed(Error),
}

impl Host {
    /// Serves MP's node to the end of the run.
    pub(crate) async fn serve(self, mut receiver: Receiver<ToNode>) -> Left {
        self.join(self.run);
        let (mapped, is_mapped) = watch::channel(false);
        for (effector, edp) in &self.edps {
            self.send_states(*effector, edp.watch(), is_mapped.clone());
        }
        for (index, vsp) in &self.vsps {
            self.send_targets(*index, vsp);
        }
        let queues = self.queues();
        let watchdog = self.watchdog.clone();
        let mut failure = std::pin::pin!(watchdog.raised());
        let estimator = Estimator::new(self.offset.clone());
        let beats = Beats::default();
        let mut course = Course { beats, estimator, mapped, timely: Instant::now() };
        let mut failed = None;
        let mut beats = tokio::time::interval(BEAT);
        loop {
            tokio::select! {
                biased;
                error = &mut failure, if failed.is_none() => {
                    // An actor is broken: the arms do not wait for MP's node.
                    self.switches.hold.store(true, Ordering::Release);
                    self.sender.send(&ToHome::Failed(error.clone()));
                    failed = Some(error);
                }
                message = receiver.recv() => match message {
                    Some(Ok(ToNode::Leave)) => return failed.map_or(Left::Over, Left::Failed),
                    Some(Ok(ToNode::Beat(beat))) => self.beat(&beat, &mut course),
                    Some(Ok(message)) => self.take(message, &queues),
                    Some(Err(why)) => {
                        self.sender.send(&ToHome::Failed(failure_of_link(why.clone())));
                        return Left::Alone(why);
                    }
                    None => return Left::Alone("the link has ended".to_owned()),
                },
                _ = beats.tick() => {
                    if course.timely.elapsed() > GONE {
                        let silent = format!("no beat of MP's node in {} s", GONE.as_secs());
                        return failed.map_or(Left::Alone(silent), Left::Failed);
                    }
                    self.send_beat(&mut course);
                }
            }
        }
    }

    /// Answers a request to join. It may be a repeated one, whose answer was lost.
    fn join(&self, run: u64) {
        self.sender.send(&if run == self.run {
            ToHome::Joined { run, arms: self.arms.clone() }
        } else {
            ToHome::Refused { run, why: "it takes part in another run".to_owned() }
        });
    }

    /// Sends a beat.
    fn send_beat(&self, course: &mut Course) {
        let alive = self.ecps.iter().map(|(effector, ecp)| (*effector, ecp.signs_of_life()));
        self.sender.send(&ToHome::Beat(NodeBeat {
            number: course.beats.next(),
            echo: course.beats.echo(),
            mapped: *course.mapped.borrow(),
            alive: alive.collect(),
            stopped: self.switches.has_stopped(),
            pressed: self.switches.emergency.is_pressed(),
        }));
    }

    /// Takes a beat of MP's node. One whose echo is old has waited behind others, and an order to
    /// stop would wait as well: it does not count.
    fn beat(&self, beat: &HomeBeat, course: &mut Course) {
        course.beats.arrived(beat.number);
        if beat.pressed {
            self.stop_button.press();
        }
        self.switches.stands_by.store(beat.stands_by, Ordering::Release);
        self.watched.store(beat.watched, Ordering::Relaxed);
        let trip = beat.echo.map(|echo| course.beats.trip(echo));
        if trip.is_some_and(|trip| trip > SILENT + 2 * self.way) {
            return;
        }
        course.timely = Instant::now();
        self.switches.beats.fetch_add(1, Ordering::Relaxed);
        if let (Some(trip), Some(period)) = (trip, beat.period) {
            let (here, before) = (self.clock.period(), self.offset.periods());
            course.estimator.beat(trip.as_secs_f64(), period, here);
            let newly = course.mapped.send_if_modified(|mapped| !std::mem::replace(mapped, true));
            let offset = self.offset.periods();
            // A merged recording counts in the periods of MP's node.
            if newly || offset != before {
                self.recorder.record(here, || Entry::Offset(offset));
            }
        }
    }

    /// Starts the queues to the actors.
    fn queues(&self) -> Queues {
        let edps = self.edps.iter().map(|(effector, edp)| {
            let edp = edp.clone();
            (
                *effector,
                queue(move |request| {
                    let edp = edp.clone();
                    async move { edp.pass(request).await }
                }),
            )
        });
        let ecps = self.ecps.iter().map(|(effector, ecp)| {
            let ecp = ecp.clone();
            (
                *effector,
                queue(move |request| {
                    let ecp = ecp.clone();
                    async move { ecp.pass(request).await }
                }),
            )
        });
        let vsps = self.vsps.iter().map(|(index, vsp)| {
            let vsp = vsp.clone();
            (
                *index,
                queue(move |look| {
                    let vsp = vsp.clone();
                    async move { vsp.pass(look).await }
                }),
            )
        });
        Queues { edps: edps.collect(), ecps: ecps.collect(), vsps: vsps.collect() }
    }

    /// Takes a message of MP's node.
    fn take(&self, message: ToNode, queues: &Queues) {
        match message {
            ToNode::Ask { number, ask } => self.ask(number, ask, queues),
            ToNode::Tell(tell) => self.tell(tell, queues),
            ToNode::State(effector, state) => {
                if let Some(to) = self.states.get(&effector) {
                    to.send_replace(self.offset.state_here(&state));
                }
            }
            ToNode::Join(introduction) => self.join(introduction.run),
            ToNode::Leave | ToNode::Beat(_) => {}
        }
    }

    /// Passes a request on to its actor, and returns the answer when it comes.
    fn ask(&self, number: u64, ask: Ask, queues: &Queues) {
        match ask {
            Ask::Edp(effector, ask) => {
                let request = |reply| match ask {
                    EdpAsk::Synchronise => edp::Request::Synchronise { reply },
                    EdpAsk::State => edp::Request::State { reply },
                };
                self.pass(number, queues.edps.get(&effector), request, Answer::State);
            }
            Ask::Look(index, view) => {
                let look = |reply| vsp::Look { view, reply };
                self.pass(number, queues.vsps.get(&index), look, Answer::Face);
            }
            Ask::Ecp(effector, ask) => self.ask_ecp(number, (effector, ask), queues),
        }
    }

    /// Passes a request on to an ECP.
    fn ask_ecp(&self, number: u64, (effector, ask): (usize, EcpAsk), queues: &Queues) {
        use ecp::Request;
        let ecp = queues.ecps.get(&effector);
        let state = |request: fn(oneshot::Sender<Result<ArmState, Error>>) -> Request| {
            self.pass(number, ecp, request, Answer::State);
        };
        match ask {
            EcpAsk::Bias => state(|reply| Request::Bias { reply }),
            EcpAsk::Synchronise => state(|reply| Request::Synchronise { reply }),
            EcpAsk::State => state(|reply| Request::State { reply }),
            EcpAsk::Adjust(adjustment) => {
                let adjust = |reply| Request::Adjust { adjustment, reply };
                self.pass(number, ecp, adjust, Answer::State);
            }
            EcpAsk::Behave(behaviour, begins) => {
                let begins = self.offset.here(begins);
                let behave = |reply| Request::Behave { behaviour, begins, reply };
                self.pass(number, ecp, behave, Answer::Behaved);
            }
            EcpAsk::Look(view) => {
                self.pass(number, ecp, |reply| Request::Look { view, reply }, Answer::Face);
            }
            EcpAsk::Start(programme) => {
                let to_mp = self.outbox(effector);
                let start = |reply| Request::Start { programme, to_mp, reply };
                self.pass(number, ecp, start, Answer::Begun);
            }
        }
    }

    /// Passes a request on to an actor by its queue, if the node has that actor: `request` makes it
    /// with the channel of the answer, which `wrap` makes a message to MP's node.
    fn pass<R, T: AtHome + Send + 'static>(
        &self,
        number: u64,
        queue: Option<&mpsc::UnboundedSender<R>>,
        request: impl FnOnce(oneshot::Sender<Result<T, Error>>) -> R,
        wrap: fn(Result<T, Error>) -> Answer,
    ) {
        let Some(queue) = queue else { return };
        let (reply, answer) = oneshot::channel();
        let _ = queue.send(request(reply));
        self.answer(number, answer, wrap);
    }

    /// Passes a message without an answer on to its actor.
    fn tell(&self, tell: Tell, queues: &Queues) {
        use ecp::Request;
        let (effector, request) = match tell {
            Tell::End(effector, ending) => (effector, Request::End(ending)),
            Tell::Watch(effector, on) => (effector, Request::Watch { on }),
            Tell::Signal(effector, signal) => (effector, Request::Signal(signal)),
            Tell::Track(vsp, on) => {
                return self.vsps.get(&vsp).into_iter().for_each(|vsp| vsp.track(on));
            }
            Tell::Sense(vsp, sensing) => {
                return self.vsps.get(&vsp).into_iter().for_each(|vsp| vsp.configure(sensing));
            }
            Tell::Control(control) => {
                self.control.send_replace(control);
                return;
            }
            Tell::Parameters(courses) => {
                let courses = courses.counted(|period| self.offset.here(period));
                self.courses.send_replace(courses);
                return;
            }
        };
        if let Some(ecp) = queues.ecps.get(&effector) {
            let _ = ecp.send(request);
        }
    }

    /// Returns the answer of an actor to MP's node when it comes. An actor that has ended gives
    /// none: the node's watchdog tells why.
    fn answer<T: AtHome + Send + 'static>(
        &self,
        number: u64,
        answer: oneshot::Receiver<Result<T, Error>>,
        wrap: fn(Result<T, Error>) -> Answer,
    ) {
        let (sender, offset) = (self.sender.clone(), self.offset.clone());
        tokio::spawn(async move {
            if let Ok(answer) = answer.await {
                let answer = answer.map(|answer| answer.at_home(&offset));
                let answer = wrap(answer.map_err(|error| error_at_home(error, &offset)));
                sender.send(&ToHome::Answer { number, answer });
            }
        });
    }

    /// Makes the way of a programme's messages to MP.
    fn outbox(&self, effector: usize) -> Outbox {
        let (mailbox, mut reports) = mpsc::unbounded_channel();
        let sender = self.sender.clone();
        tokio::spawn(async move {
            while let Some(report) = reports.recv().await {
                sender.send(&ToHome::Report(effector, report));
            }
        });
        Outbox { effector, mailbox }
    }

    /// Sends the states of an arm of the node, once the periods are `mapped`. The last state of a
    /// motion may be lost, so the present one is sent again.
    fn send_states(
        &self,
        effector: usize,
        mut state: watch::Receiver<ArmState>,
        mut mapped: watch::Receiver<bool>,
    ) {
        let (sender, offset) = (self.sender.clone(), self.offset.clone());
        tokio::spawn(async move {
            let _ = mapped.wait_for(|mapped| *mapped).await;
            loop {
                let now = offset.state_at_home(&state.borrow_and_update());
                sender.send(&ToHome::State(effector, now));
                if let Ok(Err(_)) = tokio::time::timeout(RESEND, state.changed()).await {
                    return;
                }
            }
        });
    }

    /// Sends the poses of the cube that a VSP of the node finds.
    fn send_targets(&self, index: usize, vsp: &VspHandle) {
        let (sender, offset) = (self.sender.clone(), self.offset.clone());
        let mut target = vsp.targets();
        tokio::spawn(async move {
            while target.changed().await.is_ok() {
                let found = target.borrow_and_update().map(|mut found| {
                    found.period = offset.at_home(found.period);
                    found
                });
                sender.send(&ToHome::Target(index, found));
            }
        });
    }
}

/// Starts a queue whose requests `pass` hands to an actor, one after the other. Returns its sending
/// end.
fn queue<R: Send + 'static, F: Future<Output = ()> + Send>(
    pass: impl Fn(R) -> F + Send + 'static,
) -> mpsc::UnboundedSender<R> {
    let (to, mut requests) = mpsc::unbounded_channel();
    tokio::spawn(async move {
        while let Some(request) = requests.recv().await {
            pass(request).await;
        }
    });
    to
}

/// Makes the error of a link on which messages are missing, for MP's node.
fn failure_of_link(why: String) -> Error {
    let who = "MP's node".to_owned();
    Error::System { actor: "node".into(), place: "link".into(), cause: System::Link { who, why } }
}

/// Returns an error whose last state has the periods of MP's node.
fn error_at_home(error: Error, offset: &Offset) -> Error {
    match error {
        Error::Fatal { actor, place, cause, last: Some(last) } => {
            let last = Some(Box::new(offset.state_at_home(&last)));
            Error::Fatal { actor, place, cause, last }
        }
        error => error,
    }
}

/// Result of an actor whose periods become those of MP's node.
trait AtHome {
    /// Returns the result with the periods of MP's node.
    fn at_home(self, offset: &Offset) -> Self;
}

impl AtHome for ArmState {
    fn at_home(self, offset: &Offset) -> Self {
        offset.state_at_home(&self)
    }
}

impl AtHome for (crate::generators::Outcome, ArmState) {
    fn at_home(self, offset: &Offset) -> Self {
        (self.0, offset.state_at_home(&self.1))
    }
}

impl AtHome for crate::vision::sensor::FaceReading {
    fn at_home(self, _: &Offset) -> Self {
        self
    }
}

impl AtHome for () {
    fn at_home(self, _: &Offset) -> Self {}
}
