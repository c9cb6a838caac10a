//! End of the link at a node beside that of MP: passes requests on to the actors of the node and
//! returns their answers.
//!
//! - in: messages of MP's node; states of the node's arms, poses of the cube
//! - out: requests to the actors; answers, states, beats
//!
//! The servo lives by the beats of MP's node: without them it brakes and trips, as it does without
//! actors.

use super::GONE;
use super::line::{Receiver, Sender};
use super::message::{Answer, Ask, EcpAsk, EdpAsk, HomeBeat, NodeBeat, Tell, ToHome, ToNode};
use super::offset::{Estimator, Offset};
use crate::actors::clock::Clock;
use crate::actors::control::Control;
use crate::actors::ecp::{self, EcpHandle, Outbox};
use crate::actors::edp::{self, EdpHandle};
use crate::actors::vsp::{self, VspHandle};
use crate::actors::watchdog::Watchdog;
use crate::actors::way::BEAT;
use crate::emergency_stop::StopButton;
use crate::error::Error;
use crate::hw::driver::Switches;
use crate::motion::ArmState;
use crate::operator::parameter::Courses;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::Instant;

/// Number of the last beats whose times are kept: those of 2 s.
const BEATS: usize = 100;

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
    /// VSPs whose owner is on MP's node, by their index.
    pub(crate) vsps: BTreeMap<usize, VspHandle>,
    /// States of the arms of other nodes, by effector.
    pub(crate) states: BTreeMap<usize, watch::Sender<ArmState>>,
    /// The operator's control, as the actors of the node see it.
    pub(crate) control: watch::Sender<Control>,
    /// The operator's parameters, as the actors of the node see them.
    pub(crate) courses: watch::Sender<Courses>,
    /// Difference of the periods.
    pub(crate) offset: Offset,
    /// Clock of the node.
    pub(crate) clock: Clock,
    /// Switches of the node's servos.
    pub(crate) switches: Arc<Switches>,
    /// Button of the emergency stop that these servos read.
    pub(crate) stop_button: StopButton,
    /// Watchdog of the node's actors.
    pub(crate) watchdog: Watchdog,
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
        for (effector, edp) in &self.edps {
            self.send_states(*effector, edp.watch());
        }
        for (index, vsp) in &self.vsps {
            self.send_targets(*index, vsp);
        }
        let watchdog = self.watchdog.clone();
        let mut failure = std::pin::pin!(watchdog.raised());
        let mut estimator = Estimator::new(self.offset.clone());
        let mut sent = VecDeque::new();
        let (mut number, mut last, mut failed) = (0, Instant::now(), None);
        let mut beats = tokio::time::interval(BEAT);
        loop {
            tokio::select! {
                biased;
                error = &mut failure, if failed.is_none() => {
                    self.sender.send(&ToHome::Failed(error.clone()));
                    failed = Some(error);
                }
                message = receiver.recv() => match message {
                    Some(Ok(ToNode::Leave)) => return failed.map_or(Left::Over, Left::Failed),
                    Some(Ok(ToNode::Beat(beat))) => {
                        last = Instant::now();
                        self.beat(&beat, &sent, &mut estimator);
                    }
                    Some(Ok(message)) => self.take(message).await,
                    Some(Err(why)) => return Left::Alone(why),
                    None => return Left::Alone("the link has ended".to_owned()),
                },
                _ = beats.tick() => {
                    if last.elapsed() > GONE {
                        let silent = format!("no beat of MP's node in {} s", GONE.as_secs());
                        return failed.map_or(Left::Alone(silent), Left::Failed);
                    }
                    number += 1;
                    if sent.len() == BEATS {
                        sent.pop_front();
                    }
                    sent.push_back((number, Instant::now()));
                    self.send_beat(number);
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
    fn send_beat(&self, number: u64) {
        let alive = self.ecps.iter().map(|(effector, ecp)| (*effector, ecp.signs_of_life()));
        let stopped = self.switches.has_stopped();
        self.sender.send(&ToHome::Beat(NodeBeat { number, alive: alive.collect(), stopped }));
    }

    /// Takes a beat of MP's node. `sent` has the numbers and times of the node's own last beats.
    fn beat(&self, beat: &HomeBeat, sent: &VecDeque<(u64, Instant)>, estimator: &mut Estimator) {
        self.switches.beats.fetch_add(1, Ordering::Relaxed);
        if beat.pressed {
            self.stop_button.press();
        }
        if beat.hold {
            self.switches.hold.store(true, Ordering::Release);
        }
        let echoed = beat.echo.and_then(|(number, held)| {
            let (_, at) = sent.iter().find(|(sent, _)| *sent == number)?;
            Some(at.elapsed().saturating_sub(Duration::from_micros(held)))
        });
        if let Some(trip) = echoed {
            estimator.beat(trip.as_secs_f64(), beat.period, self.clock.period());
        }
    }

    /// Takes a message of MP's node.
    async fn take(&self, message: ToNode) {
        match message {
            ToNode::Ask { number, ask } => self.ask(number, ask).await,
            ToNode::Tell(tell) => self.tell(tell).await,
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
    async fn ask(&self, number: u64, ask: Ask) {
        match ask {
            Ask::Edp(effector, ask) => {
                let Some(edp) = self.edps.get(&effector) else { return };
                let (reply, answer) = oneshot::channel();
                let request = match ask {
                    EdpAsk::Synchronise => edp::Request::Synchronise { reply },
                    EdpAsk::State => edp::Request::State { reply },
                };
                edp.pass(request).await;
                self.answer(number, answer, Answer::State);
            }
            Ask::Look(index, view) => {
                let Some(vsp) = self.vsps.get(&index) else { return };
                let (reply, answer) = oneshot::channel();
                vsp.pass(vsp::Look { view, reply }).await;
                self.answer(number, answer, Answer::Face);
            }
            Ask::Ecp(effector, ask) => self.ask_ecp(number, effector, ask).await,
        }
    }

    /// Passes a request on to an ECP.
    async fn ask_ecp(&self, number: u64, effector: usize, ask: EcpAsk) {
        use ecp::Request;
        let Some(ecp) = self.ecps.get(&effector) else { return };
        let (reply, answer) = oneshot::channel();
        let request = match ask {
            EcpAsk::Bias => Request::Bias { reply },
            EcpAsk::Synchronise => Request::Synchronise { reply },
            EcpAsk::Adjust(adjustment) => Request::Adjust { adjustment, reply },
            EcpAsk::State => Request::State { reply },
            EcpAsk::Behave(behaviour, begins) => {
                let begins = self.offset.here(begins);
                let (reply, answer) = oneshot::channel();
                ecp.pass(Request::Behave { behaviour, begins, reply }).await;
                return self.answer(number, answer, Answer::Behaved);
            }
            EcpAsk::Look(view) => {
                let (reply, answer) = oneshot::channel();
                ecp.pass(Request::Look { view, reply }).await;
                return self.answer(number, answer, Answer::Face);
            }
            EcpAsk::Start(programme) => {
                let (reply, answer) = oneshot::channel();
                let to_mp = self.outbox(effector);
                ecp.pass(Request::Start { programme, to_mp, reply }).await;
                return self.answer(number, answer, Answer::Begun);
            }
        };
        ecp.pass(request).await;
        self.answer(number, answer, Answer::State);
    }

    /// Passes a message without an answer on to its actor.
    async fn tell(&self, tell: Tell) {
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
        if let Some(ecp) = self.ecps.get(&effector) {
            ecp.pass(request).await;
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
                let answer = wrap(answer.map(|answer| answer.at_home(&offset)));
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

    /// Sends the states of an arm of the node.
    fn send_states(&self, effector: usize, mut state: watch::Receiver<ArmState>) {
        let (sender, offset) = (self.sender.clone(), self.offset.clone());
        tokio::spawn(async move {
            loop {
                let now = offset.state_at_home(&state.borrow_and_update());
                sender.send(&ToHome::State(effector, now));
                if state.changed().await.is_err() {
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
