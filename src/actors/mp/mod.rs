//! MP: coordinates all effectors. The shell around a task's kernel.
//!
//! Two schemes of coordination (Zieliński et al. 2007, p. 374): *continuous*, in which MP runs the
//! generators of all effectors and commands them at each macrostep through transmitting ECPs; and
//! *sporadic*, in which MP invokes behaviours and the ECPs run the generators.
//!
//! - `motions`: both schemes
//! - `ways`: what is checked before a motion begins
//! - `dialogue`: questions to the operator, and orders by hand
//! - `jog`: a motor that is turned by hand

mod dialogue;
mod jog;
mod motions;
mod ways;

use super::control::{Control, Terminated, permission_soon};
use super::ecp::EcpHandle;
use super::fault::ActorFault;
use super::lookout::Apart;
use super::move_instruction::Manner;
use super::notice::Notice;
use super::services::Services;
use super::vsp::VspHandle;
use super::watchdog::{Heartbeat, Supervision, Watchdog};
use crate::error::{Error, Fatal, NonFatal, System};
use crate::generators::Behaviour;
use crate::motion::{ArmState, PERIOD, Synchronisation};
use crate::operator::Input;
use crate::reach::guard::{Guard, Near};
use crate::record::journal::Journal;
use crate::tasks::{self, Action, Event, Finish, Forces, Readings, Task, Until, View};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;
use tokio::sync::{mpsc, watch};

/// Who runs the generators.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Coordination {
    /// MP, at each macrostep.
    Continuous,
    /// The ECPs; MP only where subtasks switch.
    Sporadic,
}

/// The parts of MP.
pub struct Parts {
    /// Set when a turn begins, and cleared when it ends.
    pub turning: Turning,
    /// The wrists' forces, if a VSP aggregates them.
    pub forces: Option<watch::Receiver<Forces>>,
    /// One ECP an effector, in the scenario's order.
    pub ecps: Vec<EcpHandle>,
    /// The stand-alone camera's sensor, if it delivers to MP.
    pub tracker: Option<VspHandle>,
    /// Sensors of the cameras in the hands that deliver to MP.
    pub hand_cameras: [Option<VspHandle>; 2],
    /// Scheme.
    pub coordination: Coordination,
    /// How the generators behave.
    pub manners: Vec<Manner>,
    /// Answers and manual orders of the operator; `None` when no operator can be asked.
    pub operator: Option<mpsc::Receiver<Input>>,
    /// The journal, from which another run can go on.
    pub journal: Option<Journal>,
    /// Refuses ways on which the arms would come too near to something; an MP without a cell has
    /// none.
    pub guard: Option<Guard>,
    /// Set while the hands are not to meet.
    pub apart: Apart,
    /// The services of the run.
    pub services: Services,
}

impl Parts {
    /// Returns parts with arms alone: no sensors, no operator, no journal, no guard; sporadic
    /// coordination.
    #[must_use]
    pub fn bare(ecps: Vec<EcpHandle>, manners: Vec<Manner>, services: Services) -> Self {
        Self {
            turning: Turning::default(),
            forces: None,
            ecps,
            tracker: None,
            hand_cameras: [None, None],
            coordination: Coordination::Sporadic,
            manners,
            operator: None,
            journal: None,
            guard: None,
            apart: Apart::default(),
            services,
        }
    }
}

/// Set by MP while a turn is commanded and unfinished.
#[derive(Debug, Clone, Default)]
pub struct Turning(Arc<AtomicBool>);

impl Turning {
    /// Sets whether a turn is commanded.
    pub fn tell(&self, turning: bool) {
        self.0.store(turning, Ordering::Release);
    }

    /// Returns whether a turn is commanded and unfinished.
    #[must_use]
    pub fn is_commanded(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }
}

/// How a run ended, as MP knows it.
#[derive(Debug, Clone, PartialEq)]
pub struct Ending {
    /// The kernel's last word; `None` when the operator terminated the run.
    pub finish: Option<Finish>,
    /// The error that ended it.
    pub error: Option<Error>,
    /// Phases, each with the time at which it began (s), and when that was by
    /// [`Tempo::worked`](super::control::Tempo::worked).
    pub phases: Vec<(&'static str, f64, Instant)>,
    /// When it ended (s).
    pub end: f64,
    /// What the wrists felt, as their VSP told last.
    pub felt: Forces,
}

impl Ending {
    /// Of a run that an error broke off, of which nothing else is known.
    pub(crate) fn broken(end: f64, error: Error) -> Self {
        let (phases, felt) = (Vec::new(), Forces::default());
        Self { finish: None, error: Some(error), phases, end, felt }
    }
}

/// The actor.
pub struct Mp {
    parts: Parts,
    arms: Vec<ArmState>,
    phases: Vec<(&'static str, f64, Instant)>,
    watchdog: Watchdog,
    /// The fault that is injected into this actor.
    fault: Arc<ActorFault>,
    heartbeat: Heartbeat,
}

enum Stop {
    Terminated,
    Error(Error),
}

impl From<Error> for Stop {
    fn from(error: Error) -> Self {
        Self::Error(error)
    }
}

impl From<Terminated> for Stop {
    fn from(_: Terminated) -> Self {
        Self::Terminated
    }
}

impl Mp {
    /// Creates MP over its effectors.
    #[must_use]
    pub fn new(parts: Parts) -> Self {
        let (arms, phases) = (Vec::new(), Vec::new());
        let Supervision { watchdog, fault, .. } = parts.services.supervision.clone();
        let heartbeat = watchdog.heartbeat("mp");
        Self { parts, arms, phases, watchdog, fault, heartbeat }
    }

    fn felt(&self) -> Forces {
        self.parts.forces.as_ref().map(|f| *f.borrow()).unwrap_or_default()
    }

    /// Returns the arms that know where they are: one that is not synchronised does not.
    fn known(&self) -> [Option<&ArmState>; 2] {
        std::array::from_fn(|i| {
            self.arms.get(i).filter(|arm| arm.synchronisation == Synchronisation::Yes)
        })
    }

    /// Returns the guard, as the jaws stand now.
    fn guard(&self) -> Option<Guard> {
        let mut guard = self.parts.guard.clone()?;
        guard.holding(self.known().map(|arm| arm.map(|arm| arm.jaw_opening)));
        Some(guard)
    }

    /// Checks the ways that are ordered against the believed cell, and slows those down that are too
    /// fast beside the operator's hand.
    fn guarded(&self, orders: &mut [Option<Behaviour>; 2]) -> Result<(), Near> {
        let Some(guard) = self.guard() else { return Ok(()) };
        let known = self.known();
        let apart = ways::check(&guard, known, orders)?;
        self.parts.apart.tell(apart);
        ways::slow_down(&guard, known, &self.parts.manners, orders);
        Ok(())
    }

    fn now(&self) -> f64 {
        self.parts.services.clock.period() as f64 * PERIOD
    }

    fn tell(&self, notice: Notice) {
        self.parts.services.trace.tell(notice);
    }

    /// Runs a task to its end.
    pub async fn run<T: Task>(mut self, task: &mut T) -> Ending {
        let mut ending = Ending {
            finish: None,
            error: None,
            phases: Vec::new(),
            end: 0.0,
            felt: Forces::default(),
        };
        let watchdog = self.watchdog.clone();
        let performed = tokio::select! {
            biased;
            error = watchdog.raised() => Err(Stop::Error(error)),
            performed = self.perform(task) => performed,
        };
        match performed {
            Ok(finish) => ending.finish = Some(finish),
            // An error of an arm outranks the operator's end.
            Err(Stop::Terminated) => ending.error = self.refresh().await.err(),
            Err(Stop::Error(error)) => ending.error = Some(error),
        }
        if let Some(error) = &ending.error {
            self.tell(Notice::Error(self.now(), error.clone()));
        }
        ending.end = self.now();
        ending.felt = self.felt();
        ending.phases = std::mem::take(&mut self.phases);
        ending
    }

    /// Lets the kernel decide and carries its actions out, until it finishes.
    async fn perform<T: Task>(&mut self, task: &mut T) -> Result<Finish, Stop> {
        self.permitted().await??;
        self.refresh().await?;
        let mut event = Event::Start;
        loop {
            self.permitted().await??;
            match self.decide(task, event).await {
                Action::Finish(finish) => return Ok(finish),
                Action::Defect(why) => return Err(Stop::Error(defect(why))),
                action => event = self.act::<T>(action).await?,
            }
        }
    }

    /// Gives the kernel an event and returns its action, once the journal has it and the traces.
    async fn decide<T: Task>(
        &mut self,
        task: &mut T,
        event: Event<T::Conclusion>,
    ) -> Action<T::Thought> {
        self.heartbeat.works();
        self.fault.occur().await;
        let forces = self.felt();
        let trace = &self.parts.services.trace;
        trace.message("mp", "kernel", &(&event, &forces));
        let action = task.next(event, &Readings { arms: &self.arms, forces });
        trace.message("kernel", "mp", &action);
        let entry = task.entry();
        // A slow disk is not MP's own work.
        self.heartbeat.waits();
        if let Some(entry) = entry {
            self.note(entry).await;
        }
        self.heartbeat.works();
        for note in task.notes() {
            self.tell(Notice::Warning(self.now(), note));
        }
        let Services { trace, clock, .. } = &self.parts.services;
        trace.believes(clock.period(), doing(&action), || task.picture());
        tracing::debug!(now = self.now(), ?action, "action");
        self.heartbeat.waits();
        action
    }

    /// Carries an action out and returns the event that it comes to.
    async fn act<T: Task>(
        &mut self,
        action: Action<T::Thought>,
    ) -> Result<Event<T::Conclusion>, Stop> {
        let done = match action {
            // `perform` returns before.
            Action::Finish(_) | Action::Defect(_) => Ok(Event::Done),
            Action::Phase(name) => {
                self.begin_phase(name);
                Ok(Event::Done)
            }
            Action::Behave { orders, until } => return self.behave(orders, until).await,
            Action::Bias(which) => self.bias(which).await.map(|()| Event::Done),
            Action::Watch(on) => {
                self.watch(on).await?;
                Ok(Event::Done)
            }
            Action::Look { effector, view } => self.look(effector, view).await?,
            Action::Think(thought) => {
                let conclusion = self.parts.services.work.run(move || T::think(thought)).await;
                let conclusion = conclusion.ok_or_else(|| system("think", "the worker"))?;
                Ok(Event::Thought(conclusion))
            }
            Action::Ask(question) => Ok(Event::Answered(self.ask(&question).await?)),
            Action::Await => {
                let (effector, order) = self.ordered().await?;
                Ok(Event::Ordered(effector, order))
            }
            Action::Manual { effector, order } => match self.manual(effector, &order).await {
                Ok(()) => Ok(Event::Done),
                Err(Stop::Error(error)) => Err(error),
                Err(terminated) => return Err(terminated),
            },
        };
        match done {
            Ok(event) => Ok(event),
            Err(error) => self.trouble(error).await,
        }
    }

    fn begin_phase(&mut self, name: &'static str) {
        let now = self.now();
        self.phases.push((name, now, self.parts.services.tempo.worked()));
        self.tell(Notice::Phase(now, name.into()));
    }

    /// Lets the effectors behave as ordered, if their ways are free.
    async fn behave<C>(
        &mut self,
        mut orders: [Option<Behaviour>; 2],
        until: Until,
    ) -> Result<Event<C>, Stop> {
        if let Err(near) = self.guarded(&mut orders) {
            let cause = NonFatal::Arguments(near.to_string());
            let error = Error::NonFatal { actor: "mp".into(), place: "guard a way", cause };
            return self.trouble(error).await;
        }
        self.parts.services.trace.ordered(&orders);
        self.parts.turning.tell(orders.iter().any(|o| matches!(o, Some(Behaviour::Turn { .. }))));
        let outcomes = match self.parts.coordination {
            Coordination::Sporadic => self.invoke(orders, until).await,
            Coordination::Continuous => self.move_all(orders, until).await,
        };
        self.heartbeat.waits();
        self.parts.turning.tell(false);
        self.parts.services.trace.ordered(&[None, None]);
        if *self.parts.services.control.borrow() == Control::Terminated {
            return Err(Stop::Terminated);
        }
        match outcomes {
            Ok(outcomes) => Ok(Event::Behaved(outcomes)),
            Err(error) => self.trouble(error).await,
        }
    }

    /// Switches the stand-alone camera's sensor.
    async fn watch(&mut self, on: bool) -> Result<(), Error> {
        match &self.parts.tracker {
            Some(tracker) => tracker.track(on),
            None => {
                for ecp in &self.parts.ecps {
                    ecp.watch(on).await?;
                }
            }
        }
        Ok(())
    }

    /// Has a face read by the camera of an effector's hand; a face that cannot be read is an event,
    /// too.
    async fn look<C>(
        &mut self,
        effector: usize,
        view: View,
    ) -> Result<Result<Event<C>, Error>, Error> {
        let reading = match self.parts.hand_cameras.get(effector).and_then(Option::as_ref) {
            Some(camera) => camera.look(view).await,
            None => self.ecp(effector)?.look(view).await,
        };
        self.refresh().await?;
        Ok(match reading {
            Ok(reading) => Ok(Event::Looked(Ok(reading))),
            Err(Error::NonFatal { cause: NonFatal::NoReading(reason), .. }) => {
                Ok(Event::Looked(Err(reason)))
            }
            Err(error) => Err(error),
        })
    }

    /// Writes into the journal what is about to be done; returns when that is durable. A run whose
    /// journal fails goes on: it is no worse than one without a journal, and its cube is in its
    /// hands.
    async fn note(&mut self, entry: tasks::Entry) {
        let Some(mut journal) = self.parts.journal.take() else { return };
        let writes = move || match journal.write(&entry) {
            Ok(()) => Ok(journal),
            Err(why) => Err(journal.given_up(&why)),
        };
        match self.parts.services.work.wait(writes).await {
            Some(Ok(journal)) => self.parts.journal = Some(journal),
            Some(Err(told)) => self.tell(Notice::Warning(self.now(), told)),
            None => {
                let told = "the journal's writer failed: this run must not be resumed";
                self.tell(Notice::Warning(self.now(), told.to_owned()));
            }
        }
    }

    /// Takes the present forces for zero.
    async fn bias(&mut self, which: [bool; 2]) -> Result<(), Error> {
        for (ecp, _) in self.parts.ecps.iter().zip(which).filter(|(_, wanted)| *wanted) {
            match ecp.bias().await {
                // The sensor is zeroed: the operator should know, and the task goes on.
                Err(error @ Error::NonFatal { cause: NonFatal::ZeroMoved { .. }, .. }) => {
                    self.tell(Notice::Error(self.now(), error));
                }
                zeroed => {
                    zeroed?;
                }
            }
        }
        self.refresh().await
    }

    /// Returns a non-fatal error as an event for the kernel, which may go on; the others end the run.
    /// The error of an arm that has stopped outranks the refusal of another one.
    async fn trouble<C>(&mut self, error: Error) -> Result<Event<C>, Stop> {
        match error {
            Error::NonFatal { .. } => {
                self.refresh().await?;
                self.tell(Notice::Error(self.now(), error.clone()));
                Ok(Event::Trouble(error.to_string()))
            }
            Error::Fatal { .. } | Error::System { .. } => Err(Stop::Error(error)),
        }
    }

    fn ecp(&self, effector: usize) -> Result<&EcpHandle, Error> {
        self.parts.ecps.get(effector).ok_or_else(|| Error::NonFatal {
            actor: "mp".into(),
            place: "address an effector",
            cause: NonFatal::Arguments(format!("there is no effector {effector}")),
        })
    }

    /// Waits for the operator's will; a fault of an arm comes first.
    async fn permitted(&mut self) -> Result<Result<(), Terminated>, Error> {
        loop {
            if let Some(will) = permission_soon(&mut self.parts.services.control).await {
                return Ok(will);
            }
            for ecp in &self.parts.ecps {
                ecp.state().await?;
            }
        }
    }

    /// Asks each arm for its state.
    async fn refresh(&mut self) -> Result<(), Error> {
        let mut arms = Vec::with_capacity(self.parts.ecps.len());
        for ecp in &self.parts.ecps {
            arms.push(ecp.state().await?);
        }
        self.arms = arms;
        Ok(())
    }
}

/// Returns the error of a kernel that cannot go on.
fn defect(why: String) -> Error {
    let cause = Fatal::Kernel(why);
    Error::Fatal { actor: "mp".into(), place: "resume the task", cause, last: None }
}

fn system(place: &'static str, who: &str) -> Error {
    Error::System { actor: "mp".into(), place, cause: System::Closed(who.into()) }
}

/// Returns an action in words.
fn doing<T>(action: &Action<T>) -> &'static str {
    match action {
        Action::Phase(_) => "goes to the next phase",
        Action::Behave { .. } => "coordinates motions",
        Action::Bias(_) => "zeroes force sensors",
        Action::Watch(_) => "switches the stand-alone camera",
        Action::Look { .. } => "has a face read",
        Action::Think(_) => "has a plan made",
        Action::Ask(_) => "asks the operator",
        Action::Await => "waits for an order",
        Action::Manual { .. } => "carries out an order",
        Action::Finish(_) => "has finished",
        Action::Defect(_) => "has failed",
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test")]
mod tests {
    use super::super::clock::Clock;
    use super::super::move_instruction::example_manner;
    use super::super::trace::Trace;
    use super::super::{ecp, edp};
    use super::*;
    use crate::hw::driver::{self, Switches};
    use crate::motion::JointPositions;
    use crate::reach::guard::PlannedMotion;
    use crate::reach::{Meeting, MeetingTable, ReachSettings, example_cell};
    use crate::record::run_hash::RunHash;

    /// With a track that would be too fast beside the operator's hand.
    fn manner() -> Manner {
        let mut manner = example_manner();
        (manner.speeds.joint[0], manner.speeds.joint_acceleration[0]) = (0.5, 1.0);
        manner
    }

    /// An MP whose arms stand so. The first has an ECP and an EDP, whose servo does nothing.
    fn standing(guard: Guard, arms: [ArmState; 2]) -> Mp {
        let clock = Clock::new(tokio::time::Instant::now(), Arc::new(Switches::default()));
        let control = watch::channel(Control::Running).1;
        let services = Services::bare(clock, control, Trace::bare(RunHash::default()).0);
        let (link, end) = driver::link();
        drop(end);
        let edp = edp::spawn("track", link, &services);
        let parts = ecp::Parts {
            edp,
            tracker: None,
            hand_camera: None,
            manner: manner(),
            services: services.clone(),
        };
        let ecps = vec![ecp::spawn("track", parts)];
        let parts = Parts::bare(ecps, vec![manner(); 2], services);
        Mp { arms: arms.into(), ..Mp::new(Parts { guard: Some(guard), ..parts }) }
    }

    fn arm(joints: JointPositions) -> ArmState {
        let synchronisation = Synchronisation::Yes;
        ArmState { desired_joints: joints, synchronisation, ..ArmState::default() }
    }

    fn to(target: JointPositions) -> Behaviour {
        Behaviour::Joints { target, speed: 1.0, seconds: 0.0 }
    }

    /// The first meeting of the hands, and the track's stand so far along from there (m).
    fn meeting() -> (Meeting, impl Fn(f64) -> JointPositions) {
        let table = MeetingTable::compute(&example_cell(), &ReachSettings::default());
        let meeting = table.grasps.into_iter().flatten().next().unwrap();
        let along = move |by: f64| {
            let mut track = meeting.track;
            track.0[0] += by;
            track
        };
        (meeting, along)
    }

    fn guard() -> Guard {
        Guard::of(&example_cell(), 0.25)
    }

    #[tokio::test(start_paused = true)]
    async fn an_arm_that_does_not_know_its_place_hinders_nobody() {
        let (meeting, along) = meeting();
        let through = |synchronisation| {
            let other = ArmState { synchronisation, ..arm(meeting.postument) };
            let mp = standing(guard(), [arm(along(-0.3)), other]);
            mp.guarded(&mut [Some(to(along(0.3))), None])
        };

        assert!(matches!(through(Synchronisation::Yes), Err(Near::Arms(_) | Near::Hands(_))));
        assert_eq!(through(Synchronisation::No), Ok(()));
    }

    #[tokio::test(start_paused = true)]
    async fn the_lookout_is_told_whether_the_hands_are_to_meet() {
        let (meeting, along) = meeting();
        // Whom it is told is another actor's affair: what it was told can be seen.
        let told = |mp: &Mp| format!("{:?}", mp.parts.apart) == "Apart(true)";
        let orders = |from: JointPositions, orders: [Option<Behaviour>; 2]| {
            let mp = standing(guard(), [arm(from), arm(meeting.postument)]);
            let mut orders = orders;
            mp.guarded(&mut orders).unwrap();
            let first = told(&mp);
            // What one order tells is not what the next one does.
            mp.parts.apart.tell(!first);
            mp.guarded(&mut orders).unwrap();
            assert_eq!(told(&mp), first);
            first
        };

        assert!(orders(along(-0.4), [Some(to(along(-0.35))), None]));
        assert!(orders(along(-0.4), [None, None]));
        assert!(!orders(meeting.track_back, [Some(to(meeting.track)), None]));
        assert!(!orders(meeting.track, [Some(to(meeting.track_back)), None]));
    }

    #[tokio::test(start_paused = true)]
    async fn motors_that_are_turned_by_hand_keep_hands_apart_that_are() {
        let (meeting, along) = meeting();
        let arms = [arm(along(-0.4)), arm(meeting.postument)];
        let mut mp = standing(guard().by_hand(), arms);

        // No servo is there that would obey.
        let nobody = mp.turn_motor(0, 0, 1.0).await;

        assert!(nobody.is_err());
        assert_eq!(format!("{:?}", mp.parts.apart), "Apart(true)");
    }

    #[tokio::test(start_paused = true)]
    async fn what_hinders_an_arm_outranks_what_was_refused_for_it() {
        let (meeting, along) = meeting();
        let mut mp = standing(guard(), [arm(along(-0.4)), arm(meeting.postument)]);
        let cause = NonFatal::Arguments("too near".into());
        let refused = Error::NonFatal { actor: "mp".into(), place: "guard a way", cause };

        // Its servo is gone: a task that goes on would end with the refusal, and not with that.
        let trouble = mp.trouble::<()>(refused).await;

        assert!(matches!(trouble, Err(Stop::Error(Error::System { .. }))));
    }

    #[tokio::test(start_paused = true)]
    async fn what_is_too_fast_near_the_operator_takes_both_arms_more_time_by_as_much() {
        let (meeting, _) = meeting();
        let past = |d0: f64| JointPositions([d0, 0.0, -1.57, 0.0, 1.56, 1.57, -1.57]);
        let mut rolled = meeting.postument;
        rolled.0[6] += 0.4;
        let arms = [arm(past(0.2)), arm(meeting.postument)];
        let mp = standing(guard(), arms);
        let asked = [Some(to(past(0.4))), Some(to(rolled))];
        let mut orders = asked;

        mp.guarded(&mut orders).unwrap();

        let lasts = |orders: &[Option<Behaviour>; 2]| {
            [0, 1].map(|i| manner().seconds(orders[i].as_ref().unwrap(), &arms[i]))
        };
        let (before, after) = (lasts(&asked), lasts(&orders));
        let slower = [after[0] / before[0], after[1] / before[1]];
        assert!(slower[0] > 1.2, "{slower:?}");
        // Their ways are free when both go evenly.
        assert!((slower[0] - slower[1]).abs() < 1e-9, "{slower:?}");
    }

    #[tokio::test(start_paused = true)]
    async fn motion_that_leaves_the_operator_is_slow_there_alone() {
        let (meeting, _) = meeting();
        let mut cell = example_cell();
        // The hand-over is where the arm begins.
        let track = JointPositions([0.2, 0.0, -1.57, 0.0, 1.56, 1.57, -1.57]);
        let arm_of = &cell.arms[0];
        let tool = arm_of.model.base_from_flange(&track) * arm_of.flange_from_tool;
        cell.hand.world_from_cube.translation = (arm_of.world_from_base * tool).translation;
        let arms = [arm(track), arm(meeting.postument)];
        let mp = standing(Guard::of(&cell, 0.05), arms);
        let mut target = track;
        target.0[1] += 1.2;
        let asked = to(target);
        let mut orders = [Some(asked), None];

        mp.guarded(&mut orders).unwrap();

        let Some(Behaviour::Legs { legs, seconds }) = orders[0] else { panic!("{orders:?}") };
        assert_eq!(*legs.end(), target);
        let guard = mp.guard().unwrap();
        let way = PlannedMotion::Joints(target);
        let whole = manner().seconds(&asked, &arms[0]);
        let profile = manner().speeds.profile;
        let share = |part| profile.share(part, whole);
        let stretched = whole * guard.course(0, &track, &way).haste(whole, share);
        assert!(seconds < 0.6 * stretched, "{seconds} s, {stretched} s if slow all the way");
        // The way is the same, and the hand is slow enough where it matters.
        for part in [0.1, 0.3, 0.6, 0.9] {
            let at = legs.at(&track, part);
            assert!(at.0.iter().zip(track.0).skip(2).all(|(a, b)| (a - b).abs() < 1e-12));
        }
        let haste = guard.course(0, &track, &PlannedMotion::Legs(legs)).haste(seconds, |part| part);
        assert!(haste <= 1.0 + 1e-6 && haste > 0.3, "{haste}");
    }

    #[tokio::test(start_paused = true)]
    async fn a_hand_with_nothing_in_its_jaws_may_go_where_one_with_a_cube_may_not() {
        let cell = example_cell();
        let edge = cell.cube.edge;
        let table = MeetingTable::compute(&cell, &ReachSettings::default());
        let mut tried = 0;
        for meeting in table.grasps.iter().flatten() {
            let goes = |by: f64, jaw_opening: f64| {
                let mut track = meeting.track;
                track.0[0] += by;
                let mut far = meeting.track;
                far.0[0] -= 0.4;
                let arms = [far, meeting.postument].map(|at| ArmState { jaw_opening, ..arm(at) });
                standing(guard().by_hand(), arms).guarded(&mut [Some(to(track)), None])
            };
            // The first place on the way to the other hand where a cube would be in the way.
            let mut beside = (1..40).map(|i| -0.4 + 0.01 * f64::from(i));
            let Some(by) = beside.find(|by| goes(*by, edge).is_err()) else { continue };
            if matches!(goes(by, edge), Err(Near::Hands(_))) {
                tried += usize::from(goes(by, 0.0).is_ok());
            }
        }
        assert!(tried >= 2, "{tried}");
    }
}
