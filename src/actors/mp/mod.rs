//! MP (master process): the actor that coordinates all effectors. It is the shell around the kernel
//! of a task: it carries out the actions that the kernel returns and reports their events to it.
//!
//! There are two schemes of coordination (Zieliński et al. 2007, p. 374). Under *continuous*
//! coordination MP runs the generators of all effectors and commands them at each macrostep through
//! transmitting ECPs. Under *sporadic* coordination MP invokes behaviours and the ECPs run the
//! generators.
//!
//! - `motions`: both schemes
//! - `programmes`: programmes of ECPs, which run beside the kernel of MP; `under_way` is their list
//! - `dialogue`: questions to the operator, and orders by hand
//! - `jog`: the generator that turns one motor by hand
//!
//! The checks of a motion before it begins are those of `actors/ways`.

mod dialogue;
mod jog;
mod motions;
mod programmes;
mod under_way;

use super::control::{Control, Terminated, permission_soon};
use super::ecp::EcpHandle;
use super::fault::ActorFault;
use super::lookout::MayMeet;
use super::move_instruction::Manner;
use super::notice::Notice;
use super::sensor::{SensorHandle, readings};
use super::services::Services;
use super::tuning::Tuning;
use super::vsp::VspHandle;
use super::watchdog::{Heartbeat, Supervision, Watchdog};
use super::ways::{self, Inadmissible, Known};
use super::work::SEARCH;
use crate::cell::{MOST_ARMS, PerArm};
use crate::error::{Error, Fatal, NonFatal, System};
use crate::generators::Behaviour;
use crate::kernel::{
    Action, Adjustment, ConclusionOf, Event, Finish, Forces, JournalEntry, Kernel, Readings,
    Thought as _, Until, View,
};
use crate::motion::{ArmState, PERIOD, Synchronisation};
use crate::operator::Input;
use crate::reach::guard::Guard;
use crate::reach::pairs::Pairs;
use crate::record::journal::Journal;
use crate::spatial::Pose;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;
use tokio::sync::{mpsc, watch};
use under_way::Programmes;

/// Scheme of coordination: the actor that runs the generators.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Coordination {
    /// MP runs them, at each macrostep.
    Continuous,
    /// The ECPs run them; MP acts only where subtasks switch.
    Sporadic,
    /// The ECPs run them by programmes of their own; MP orders no effector.
    Absent,
}

/// The parts of MP.
pub struct Parts {
    /// Flag that is set when a turn begins and cleared when it ends.
    pub turning: Turning,
    /// Forces of the wrists, if a VSP aggregates them.
    pub forces: Option<watch::Receiver<Forces>>,
    /// VSPs of a user's own sensors that deliver to MP.
    pub sensors: Vec<SensorHandle>,
    /// One ECP per effector, in the scenario's order.
    pub ecps: Vec<EcpHandle>,
    /// States that the EDPs publish, for effectors whose ECPs carry out programmes; empty if MP is
    /// to ask these ECPs as well.
    pub states: Vec<watch::Receiver<ArmState>>,
    /// VSP of the stand-alone camera, if it delivers to MP.
    pub tracker: Option<VspHandle>,
    /// VSP of the camera in each effector's hand, if it delivers to MP.
    pub hand_cameras: Vec<Option<VspHandle>>,
    /// Scheme of coordination.
    pub coordination: Coordination,
    /// Parameters of the generators, one entry per effector.
    pub manners: Vec<Manner>,
    /// Answers and manual orders of the operator; `None` when no operator can be asked.
    pub operator: Option<mpsc::Receiver<Input>>,
    /// Journal, from which another run can continue.
    pub journal: Option<Journal>,
    /// Guard that refuses paths on which an arm would come too near an obstacle; `None` without a
    /// cell.
    pub guard: Option<Guard>,
    /// Pairs of arms whose hands may meet, for the lookout.
    pub may_meet: MayMeet,
    /// Services of the run.
    pub services: Services,
}

impl Parts {
    /// Returns the parts of an MP (master process) with nothing but effectors: no sensors,
    /// operator, journal or guard. The effectors wait for each other at events only (sporadic
    /// coordination).
    #[must_use]
    pub fn bare(ecps: Vec<EcpHandle>, manners: Vec<Manner>, services: Services) -> Self {
        Self {
            turning: Turning::default(),
            forces: None,
            sensors: Vec::new(),
            ecps,
            states: Vec::new(),
            tracker: None,
            hand_cameras: Vec::new(),
            coordination: Coordination::Sporadic,
            manners,
            operator: None,
            journal: None,
            guard: None,
            may_meet: MayMeet::default(),
            services,
        }
    }
}

/// A flag that MP sets while a turn is commanded and unfinished.
#[derive(Debug, Clone, Default)]
pub struct Turning(Arc<AtomicBool>);

impl Turning {
    /// Sets whether a turn of a layer is commanded and unfinished.
    pub fn set(&self, turning: bool) {
        self.0.store(turning, Ordering::Release);
    }

    /// Returns whether a turn of a layer is commanded and unfinished.
    #[must_use]
    pub fn is_commanded(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }
}

/// The end of a run, as MP knows it.
#[derive(Debug, Clone, PartialEq)]
pub struct Ending {
    /// Result of the kernel; `None` when the operator or an error ended the run.
    pub finish: Option<Finish>,
    /// Error that ended the run.
    pub error: Option<Error>,
    /// Phases, each with the time of its beginning in the run (s) and by
    /// [`Tempo::working_time`](super::control::Tempo::working_time).
    pub phases: Vec<(&'static str, f64, Instant)>,
    /// Time of the end (s).
    pub end: f64,
    /// Last forces of the wrists that their VSP published.
    pub forces: Forces,
}

impl Ending {
    /// Returns the ending of a run whose MP panicked at the time `end` (s). Only `error` is known:
    /// the phases and forces are lost with MP.
    pub(crate) fn broken(end: f64, error: Error) -> Self {
        let (phases, forces) = (Vec::new(), Forces::default());
        Self { finish: None, error: Some(error), phases, end, forces }
    }
}

/// The actor MP with its memory.
pub struct Mp {
    parts: Parts,
    /// Last state of each arm.
    arms: Vec<ArmState>,
    /// Phases as in [`Ending::phases`].
    phases: Vec<(&'static str, f64, Instant)>,
    watchdog: Watchdog,
    /// The fault that is injected into this actor.
    fault: Arc<ActorFault>,
    heartbeat: Heartbeat,
    programmes: Programmes,
    /// Tool frame in force of each effector (`flange_from_tool`), where a task has changed it.
    tools: Vec<Option<Pose>>,
    /// The operator's parameters as each arm follows them under continuous coordination.
    tunings: Vec<Tuning>,
}

/// A reason to end the run.
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
    /// Creates the actor MP, which begins its work with [`Mp::run`].
    #[must_use]
    pub fn new(parts: Parts) -> Self {
        let (arms, phases) = (Vec::new(), Vec::new());
        let Supervision { watchdog, fault, .. } = parts.services.supervision.clone();
        let heartbeat = watchdog.heartbeat("mp");
        let (programmes, tools) = (Programmes::new(), vec![None; parts.ecps.len()]);
        let tunings = vec![parts.services.tuning.clone(); parts.ecps.len()];
        Self { parts, arms, phases, watchdog, fault, heartbeat, programmes, tools, tunings }
    }

    /// Returns the latest forces of the wrists; zero without a VSP that aggregates them.
    fn forces(&self) -> Forces {
        self.parts.forces.as_ref().map(|f| f.borrow().clone()).unwrap_or_default()
    }

    /// Returns the state of each synchronised arm; `None` for an arm that is not synchronised,
    /// because its pose is unknown.
    fn known(&self) -> PerArm<Option<&ArmState>> {
        std::array::from_fn(|i| {
            self.arms.get(i).filter(|arm| arm.synchronisation == Synchronisation::Yes)
        })
    }

    /// Tells the lookout which hands may meet during MP's own motions. The hand of a programme must
    /// stay apart from every other one.
    fn let_meet(&self, pairs: Pairs) {
        let running = self.programmes.running.iter();
        self.parts.may_meet.set(running.fold(pairs, |pairs, &arm| pairs.without(arm)));
    }

    /// Returns the guard that checks paths, with the present openings of the jaws. Returns `None`
    /// for a run without a cell.
    fn guard(&self) -> Option<Guard> {
        Some(ways::present(self.parts.guard.as_ref()?, self.known()))
    }

    /// Checks the ordered paths against the believed cell and the reach of the arms, and slows down
    /// those that are too fast near the operator's hand.
    fn guard_orders(
        &self,
        orders: &mut [Option<Behaviour>],
        forecasts: &ways::Forecasts,
    ) -> Result<(), Inadmissible> {
        let Some(guard) = self.guard() else { return Ok(()) };
        let known = Known {
            arms: self.known(),
            tools: std::array::from_fn(|i| self.tools.get(i).copied().flatten()),
            manners: std::array::from_fn(|i| self.parts.manners.get(i)),
        };
        let joined = ways::admit(&guard, known, orders, forecasts)?;
        // Before the motion begins, so that the lookout judges all of it by the right rule.
        self.let_meet(joined);
        Ok(())
    }

    /// Returns the courses that the ordered generators of all arms declare. All orders
    /// of registered generators are tried, so that a refused one moves no arm.
    ///
    /// # Errors
    /// If a generator is unknown or refuses its order.
    fn forecasts(&self, orders: &[Option<Behaviour>]) -> Result<ways::Forecasts, Error> {
        let mut forecasts = [const { None }; MOST_ARMS];
        for (effector, order) in orders.iter().enumerate() {
            let known = self.parts.manners.get(effector).zip(self.arms.get(effector));
            let (Some(order), Some((manner, arm))) = (order, known) else { continue };
            let forecast = ways::forecast(order, manner, arm).map_err(refused)?;
            if let Some(place) = forecasts.get_mut(effector) {
                *place = forecast;
            }
        }
        Ok(forecasts)
    }

    /// Returns the time of the run (s).
    fn now(&self) -> f64 {
        self.parts.services.clock.period() as f64 * PERIOD
    }

    /// Sends a notice to the operator.
    fn tell(&self, notice: Notice) {
        self.parts.services.trace.tell(notice);
    }

    /// Runs a task to its end and returns how the run has ended.
    pub async fn run<K: Kernel>(mut self, task: &mut K) -> Ending {
        let mut ending = Ending {
            finish: None,
            error: None,
            phases: Vec::new(),
            end: 0.0,
            forces: Forces::default(),
        };
        let watchdog = self.watchdog.clone();
        let performed = tokio::select! {
            // An actor that failed ends the run even if the task has just finished.
            biased;
            error = watchdog.raised() => Err(Stop::Error(error)),
            performed = self.perform(task) => performed,
        };
        match performed {
            Ok(finish) => ending.finish = Some(finish),
            // The fault of an arm outranks the operator's terminate.
            Err(Stop::Terminated) => ending.error = self.refresh().await.err(),
            Err(Stop::Error(error)) => ending.error = Some(error),
        }
        if let Some(error) = &ending.error {
            self.tell(Notice::Error(self.now(), error.clone()));
        }
        ending.end = self.now();
        ending.forces = self.forces();
        ending.phases = std::mem::take(&mut self.phases);
        ending
    }

    /// Asks the kernel for actions and carries them out until it finishes.
    async fn perform<K: Kernel>(&mut self, task: &mut K) -> Result<Finish, Stop> {
        // The run waits for the operator's start here, not in the kernel.
        self.permitted().await??;
        self.refresh().await?;
        let mut event = Event::Start;
        loop {
            // A pause takes effect between two actions as well as within a motion.
            self.permitted().await??;
            match self.decide(task, event).await {
                Action::Finish(finish) => return Ok(finish),
                Action::Defect(why) => return Err(Stop::Error(defect(why))),
                action => event = self.act::<K>(action).await?,
            }
        }
    }

    /// Gives the kernel an event and returns its action, once the action is in the journal and in
    /// the trace.
    async fn decide<K: Kernel>(
        &mut self,
        task: &mut K,
        event: Event<ConclusionOf<K>>,
    ) -> Action<K::Thought> {
        // The kernel is MP's own work: one that hangs is detected as a silence of MP.
        self.heartbeat.works();
        self.fault.occur().await;
        let forces = self.forces();
        let trace = &self.parts.services.trace;
        trace.message("mp", "kernel", &(&event, &forces));
        let sensors = readings(&self.parts.sensors);
        let readings = Readings { arms: &self.arms, forces: &forces, sensors: &sensors };
        let action = task.next(event, &readings);
        trace.message("kernel", "mp", &action);
        let entry = task.entry();
        // A slow disk is no hang of MP.
        self.heartbeat.waits();
        if let Some(entry) = entry {
            self.note(entry).await;
        }
        self.heartbeat.works();
        for note in task.notes() {
            self.tell(Notice::remark(self.now(), "", note));
        }
        let Services { trace, clock, .. } = &self.parts.services;
        trace.believes(clock.period(), doing(&action), || task.picture());
        tracing::debug!(now = self.now(), ?action, "action");
        self.heartbeat.waits();
        action
    }

    /// Carries out an action of the kernel and returns the event with which the kernel continues.
    async fn act<K: Kernel>(
        &mut self,
        action: Action<K::Thought>,
    ) -> Result<Event<ConclusionOf<K>>, Stop> {
        let done = match action {
            // `perform` has returned before.
            Action::Finish(_) | Action::Defect(_) => Ok(Event::Done),
            Action::Phase(name) => {
                self.begin_phase(name);
                Ok(Event::Done)
            }
            // Not through `done`: a motion treats its errors itself, as it may also be terminated.
            Action::Behave { orders, until } => return self.behave(orders, until).await,
            Action::Bias(which) => self.bias(&which).await.map(|()| Event::Done),
            Action::Adjust { effector, adjustment } => {
                self.adjust(effector, adjustment).await.map(|()| Event::Done)
            }
            Action::Watch(on) => {
                self.watch(on).await?;
                Ok(Event::Done)
            }
            Action::Look { effector, view } => self.look(effector, view).await?,
            // Long work, such as the search for a plan. Under the wall clock it has its own thread.
            Action::Think(thought) => {
                let worker = ("the planner", SEARCH);
                let thinks = move || thought.think();
                let conclusion = self.parts.services.work.run(worker, thinks).await;
                let failed =
                    |cause| Error::System { actor: "mp".into(), place: "think".into(), cause };
                Ok(Event::Thought(conclusion.map_err(failed)?))
            }
            Action::Start { effector, programme } => {
                self.start(effector, programme).await.map(|()| Event::Done)
            }
            Action::Signal { effector, signal } => {
                self.signal(effector, signal).await.map(|()| Event::Done)
            }
            Action::Receive(seconds) => return self.receive(seconds).await,
            // The next three wait for the operator, who may terminate the run instead.
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
            Err(error) => self.error_event(error).await,
        }
    }

    /// Records the beginning of a phase and reports it to the operator.
    fn begin_phase(&mut self, name: &'static str) {
        let now = self.now();
        self.phases.push((name, now, self.parts.services.tempo.working_time()));
        self.tell(Notice::Phase(now, name.into()));
    }

    /// Carries out one behaviour or none for each effector, if their paths are free, and returns
    /// their outcomes as an event. `until` says which effector decides the end.
    async fn behave<C>(
        &mut self,
        mut orders: Vec<Option<Behaviour>>,
        until: Until,
    ) -> Result<Event<C>, Stop> {
        let (ordered, effectors) = (orders.len(), self.parts.ecps.len());
        if ordered > effectors {
            let why = format!("the task has {ordered} orders, for {effectors} effector(s)");
            return Err(Stop::Error(defect(why)));
        }
        let ordered = orders.iter().enumerate().filter(|(_, order)| order.is_some());
        if let Some(busy) = self.programmes.busy(ordered.map(|(effector, _)| effector)) {
            let why = format!("the task orders effector {busy}, which carries out a programme");
            return Err(Stop::Error(defect(why)));
        }
        if self.parts.coordination == Coordination::Absent {
            let why = "without coordination only programmes order effectors".to_owned();
            return Err(Stop::Error(defect(why)));
        }
        // The paths are checked against the arms of programmes as they are now.
        for &effector in &self.programmes.running {
            if let (Some(arm), Some(state)) =
                (self.arms.get_mut(effector), self.parts.states.get(effector))
            {
                *arm = *state.borrow();
            }
        }
        let forecasts = match self.forecasts(&orders) {
            Ok(forecasts) => forecasts,
            Err(error) => return self.error_event(error).await,
        };
        if let Err(why) = self.guard_orders(&mut orders, &forecasts) {
            let cause = NonFatal::Arguments(why.to_string());
            let error = Error::NonFatal { actor: "mp".into(), place: "check a path".into(), cause };
            // A refused path is no fault: the kernel may choose another one.
            return self.error_event(error).await;
        }
        self.parts.services.trace.ordered(&orders);
        self.parts.turning.set(orders.iter().any(|o| matches!(o, Some(Behaviour::Turn { .. }))));
        let outcomes = match self.parts.coordination {
            Coordination::Sporadic | Coordination::Absent => self.invoke(&orders, until).await,
            Coordination::Continuous => self.move_all(&orders, until).await,
        };
        self.heartbeat.waits();
        self.parts.turning.set(false);
        self.parts.services.trace.ordered(&[]);
        // A motion that the operator terminates has the outcome of one that MP ended. The kernel
        // must not take it for a motion that ended by its own order.
        if *self.parts.services.control.borrow() == Control::Terminated {
            return Err(Stop::Terminated);
        }
        match outcomes {
            Ok(outcomes) => Ok(Event::Behaved(outcomes)),
            Err(error) => self.error_event(error).await,
        }
    }

    /// Switches the tracking of the cube by the stand-alone camera on or off.
    async fn watch(&mut self, on: bool) -> Result<(), Error> {
        match &self.parts.tracker {
            Some(tracker) => tracker.track(on),
            // The camera belongs to an ECP: the others ignore the request.
            None => {
                for ecp in &self.parts.ecps {
                    ecp.watch(on).await?;
                }
            }
        }
        Ok(())
    }

    /// Reads a face with the camera in an effector's hand. A face that cannot be read is an event.
    /// The inner error goes to the kernel if it is non-fatal; the outer one ends the run.
    async fn look<C>(
        &mut self,
        effector: usize,
        view: View,
    ) -> Result<Result<Event<C>, Error>, Error> {
        if let Err(busy) = self.check_own([effector].into_iter(), "look") {
            return Ok(Err(busy));
        }
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

    /// Writes the action that is about to begin into the journal, and returns once the entry is
    /// durable. A run whose journal fails continues: it is no worse than one without a journal, and
    /// its hands may hold the cube.
    async fn note(&mut self, entry: impl JournalEntry) {
        // The writer takes the journal with it, so a writer that fails leaves none behind.
        let Some(mut journal) = self.parts.journal.take() else { return };
        let writes = move || match journal.write(&entry) {
            Ok(()) => Ok(journal),
            Err(why) => Err(journal.given_up(&why)),
        };
        match self.parts.services.work.wait("the journal's writer", writes).await {
            Ok(Ok(journal)) => self.parts.journal = Some(journal),
            Ok(Err(warning)) => self.tell(Notice::Warning(self.now(), warning)),
            Err(why) => {
                let warning = format!(
                    "{why}: the journal is incomplete; the run continues and must not be resumed"
                );
                self.tell(Notice::Warning(self.now(), warning));
            }
        }
    }

    /// Zeroes the force sensors of the chosen effectors under their present load.
    async fn bias(&mut self, which: &[bool]) -> Result<(), Error> {
        let wanted = which.iter().enumerate().filter(|(_, wanted)| **wanted);
        self.check_own(wanted.map(|(effector, _)| effector), "zero a force sensor")?;
        for (ecp, _) in self.parts.ecps.iter().zip(which).filter(|(_, wanted)| **wanted) {
            match ecp.bias().await {
                // The sensor has been zeroed, so the task continues. The operator gets the error.
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

    /// Checks that none of these effectors carries out a programme, which would not answer MP.
    fn check_own(
        &self,
        mut effectors: impl Iterator<Item = usize>,
        place: &'static str,
    ) -> Result<(), Error> {
        let Some(busy) = self.programmes.busy(&mut effectors) else { return Ok(()) };
        let why = format!("effector {busy} carries out a programme, which may do this itself");
        let cause = NonFatal::Arguments(why);
        Err(Error::NonFatal { actor: "mp".into(), place: place.into(), cause })
    }

    /// Adjusts an effector that carries out no programme.
    async fn adjust(&mut self, effector: usize, adjustment: Adjustment) -> Result<(), Error> {
        let ecp = self.ecp(effector)?.clone();
        self.check_own([effector].into_iter(), "adjust")?;
        match self.heartbeat.away(ecp.adjust(adjustment)).await {
            // The arm stays stopped, as since the end of its programme: the task decides.
            Err(Error::Fatal { actor, place, cause, .. }) if adjustment == Adjustment::Reset => {
                let cause = NonFatal::Arguments(cause.to_string());
                return Err(Error::NonFatal { actor, place, cause });
            }
            adjusted => adjusted?,
        };
        if let Adjustment::Tool(flange_from_tool) = adjustment {
            self.tools[effector] = Some(flange_from_tool);
        }
        self.refresh().await
    }

    /// Returns a non-fatal error as an event for the kernel, which may continue. Any other error
    /// ends the run.
    async fn error_event<C>(&mut self, error: Error) -> Result<Event<C>, Stop> {
        match error {
            Error::NonFatal { .. } => {
                // The fault of a stopped arm outranks the refusal of the other arm.
                self.refresh().await?;
                self.tell(Notice::Error(self.now(), error.clone()));
                Ok(Event::Trouble(error.to_string()))
            }
            Error::Fatal { .. } | Error::System { .. } => Err(Stop::Error(error)),
        }
    }

    /// Returns the ECP of an effector, or an error if the task addresses one that is not there.
    fn ecp(&self, effector: usize) -> Result<&EcpHandle, Error> {
        self.parts.ecps.get(effector).ok_or_else(|| Error::NonFatal {
            actor: "mp".into(),
            place: "address an effector".into(),
            cause: NonFatal::Arguments(format!("there is no effector {effector}")),
        })
    }

    /// Waits while the run is paused or has not been started. Asks the arms for their states
    /// meanwhile, and returns the fault of an arm as the outer error.
    async fn permitted(&mut self) -> Result<Result<(), Terminated>, Error> {
        loop {
            if let Some(permission) = permission_soon(&mut self.parts.services.control).await {
                return Ok(permission);
            }
            for (effector, ecp) in self.parts.ecps.iter().enumerate() {
                let state = ecp.state().await;
                if !self.programmes.own.contains(&effector) {
                    state?;
                }
            }
        }
    }

    /// Asks each arm for its state and stores the states. An ECP with a programme is not asked,
    /// since MP would wait for it: the published state of the arm counts. An arm that had a
    /// programme and has a fault keeps its last state: the fault has ended that programme, and the
    /// others go on.
    async fn refresh(&mut self) -> Result<(), Error> {
        // An answer from another node takes longer than a work item may.
        self.heartbeat.waits();
        let mut arms = Vec::with_capacity(self.parts.ecps.len());
        for (effector, ecp) in self.parts.ecps.iter().enumerate() {
            let busy = self.programmes.running.contains(&effector);
            if let Some(state) = self.parts.states.get(effector).filter(|_| busy) {
                arms.push(*state.borrow());
                continue;
            }
            let last = self.arms.get(effector).filter(|_| self.programmes.own.contains(&effector));
            arms.push(match (ecp.state().await, last) {
                (Err(Error::NonFatal { .. } | Error::Fatal { .. }), Some(last)) => *last,
                (state, _) => state?,
            });
        }
        self.arms = arms;
        Ok(())
    }
}

/// Returns the fatal error for a kernel that cannot continue its task for the reason `why`.
fn defect(why: String) -> Error {
    let cause = Fatal::Kernel(why);
    Error::Fatal { actor: "mp".into(), place: "resume the task".into(), cause, last: None }
}

/// Returns the error for a motion that cannot begin.
fn refused(cause: NonFatal) -> Error {
    Error::NonFatal { actor: "mp".into(), place: "begin a motion".into(), cause }
}

/// Returns the error for a part of the run, `who`, that no longer exists; `place` names the work in
/// which MP needed it.
fn system(place: &'static str, who: &str) -> Error {
    Error::System { actor: "mp".into(), place: place.into(), cause: System::Closed(who.into()) }
}

/// Returns the text that the user interfaces show while MP carries out an action.
fn doing<T>(action: &Action<T>) -> &'static str {
    match action {
        Action::Phase(_) => "begins the next phase",
        Action::Behave { .. } => "coordinates motions",
        Action::Bias(_) => "zeroes force sensors",
        Action::Adjust { .. } => "adjusts an effector",
        Action::Watch(_) => "switches the stand-alone camera",
        Action::Look { .. } => "requests a reading of a face",
        Action::Think(_) => "requests a plan",
        Action::Ask(_) => "asks the operator",
        Action::Await => "waits for an order",
        Action::Manual { .. } => "carries out an order",
        Action::Start { .. } => "starts a programme",
        Action::Signal { .. } => "sends a signal",
        Action::Receive(_) => "waits for a message",
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
    use crate::actors::ecp::Report;
    use crate::actors::testing::{meeting, to};
    use crate::generators::own::MotionGenerator as _;
    use crate::generators::paths::{Along, JointPolyline};
    use crate::hw::driver::{self, Switches};
    use crate::kernel::Message;
    use crate::kernel::programme::Programmes;
    use crate::motion::JointPositions;
    use crate::reach::guard::{Near, PlannedMotion};
    use crate::reach::pairs::Pairs;
    use crate::reach::{MeetingTable, ReachSettings, example_cell};
    use crate::record::run_hash::RunHash;
    use nalgebra::Vector3;

    /// Returns the parameters of generators whose full speed along the track is too fast for the
    /// zone of the operator's hand.
    fn manner() -> Manner {
        let mut manner = example_manner();
        (manner.speeds.joint[0], manner.speeds.joint_acceleration[0]) = (0.5, 1.0);
        manner
    }

    /// Returns an MP that knows the arms in the states `arms`. Only the first arm has an ECP and an
    /// EDP, and its servo has ended.
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
            sensors: Vec::new(),
            programmes: Programmes::default(),
            manner: manner(),
            lag: 0,
            surroundings: None,
            services: services.clone(),
        };
        let ecps = vec![ecp::spawn("track", parts)];
        let parts = Parts::bare(ecps, vec![manner(); 2], services);
        Mp { arms: arms.into(), ..Mp::new(Parts { guard: Some(guard), ..parts }) }
    }

    /// Returns the state of a synchronised arm at these joint positions.
    fn arm(joints: JointPositions) -> ArmState {
        let synchronisation = Synchronisation::Yes;
        ArmState { desired_joints: joints, synchronisation, ..ArmState::default() }
    }

    /// Returns the guard of the example cell, with a limit of 0.25 m/s near the operator.
    fn guard() -> Guard {
        Guard::of(&example_cell(), 0.25)
    }

    #[tokio::test(start_paused = true)]
    async fn unsynchronised_arm_is_no_obstacle() {
        let (meeting, along) = meeting();
        let through = |synchronisation| {
            let other = ArmState { synchronisation, ..arm(meeting.postument) };
            let mp = standing(guard(), [arm(along(-0.3)), other]);
            mp.guard_orders(&mut [Some(to(along(0.3))), None], &Default::default())
        };

        assert!(matches!(
            through(Synchronisation::Yes),
            Err(Inadmissible::Near(Near::Arms { .. } | Near::Hands { .. }))
        ));
        assert_eq!(through(Synchronisation::No), Ok(()));
    }

    #[tokio::test(start_paused = true)]
    async fn hands_must_stay_apart_except_around_shared_grasp() {
        let (meeting, along) = meeting();
        let apart = |mp: &Mp| !mp.parts.may_meet.pairs().join(0, 1);
        let orders = |from: JointPositions, orders: [Option<Behaviour>; 2]| {
            let mp = standing(guard(), [arm(from), arm(meeting.postument)]);
            let mut orders = orders;
            mp.guard_orders(&mut orders, &Default::default()).unwrap();
            let first = apart(&mp);
            // Each order sets the flag itself: the value before has no effect.
            mp.parts.may_meet.set(if first { Pairs::ALL } else { Pairs::NONE });
            mp.guard_orders(&mut orders, &Default::default()).unwrap();
            assert_eq!(apart(&mp), first);
            first
        };

        assert!(orders(along(-0.4), [Some(to(along(-0.35))), None]));
        assert!(orders(along(-0.4), [None, None]));
        assert!(!orders(meeting.track_back, [Some(to(meeting.track)), None]));
        assert!(!orders(meeting.track, [Some(to(meeting.track_back)), None]));
    }

    /// Both hands are at a shared grasp, where the order of MP alone would let them touch.
    #[tokio::test(start_paused = true)]
    async fn hand_of_programme_stays_apart_at_shared_grasp() {
        let (meeting, along) = meeting();
        for running in [vec![], vec![1]] {
            let programmes = !running.is_empty();
            let mut mp = standing(guard(), [arm(along(0.0)), arm(meeting.postument)]);
            mp.programmes.running = running;

            mp.guard_orders(&mut [None, None], &Default::default()).unwrap();

            assert_eq!(mp.parts.may_meet.pairs().join(0, 1), !programmes);
        }
    }

    /// A programme has left a tool point 0.6 m below that of the cell, and the point stays where it
    /// is. The tool of the cell would go 0.6 m down for that, into the table.
    #[tokio::test(start_paused = true)]
    async fn path_is_checked_for_tool_that_programme_left() {
        let (meeting, along) = meeting();
        let (cell, at) = (example_cell(), along(-0.4));
        let track = &cell.arms[0];
        let base_from_tool = track.model.base_from_flange(&at) * track.flange_from_tool;
        let world_from_tool = track.world_from_base * base_from_tool;
        let below = world_from_tool.rotation.inverse() * Vector3::new(0.0, 0.0, -0.6);
        let tool_from_point = Pose::translation(below.x, below.y, below.z);
        let longer = track.flange_from_tool * tool_from_point;
        let target = base_from_tool * tool_from_point;
        let mut stays = [Some(Behaviour::Line { target, speed: 0.5 }), None];
        let mut mp = standing(guard(), [arm(at), arm(meeting.postument)]);
        let finish = Finish { achieved: true, reason: String::new() };
        let message = Message::Ended { effector: 0, finish };
        mp.programmes.running.push(0);
        mp.programmes.to_mp.send(Report { message, tool: Some(longer) }).unwrap();

        let before = mp.guard_orders(&mut stays, &Default::default());
        // The servo is gone, so MP gets no new state after the message.
        assert!(mp.receive::<()>(1.0).await.is_err());
        let after = mp.guard_orders(&mut stays, &Default::default());

        assert!(before.is_err(), "the tool of the cell would meet the table");
        assert_eq!((after, mp.programmes.running.len()), (Ok(()), 0));
    }

    /// While the operator turns a motor by hand, hands that are apart must stay apart.
    #[tokio::test(start_paused = true)]
    async fn manual_motor_jog_requires_hands_to_stay_apart() {
        let (meeting, along) = meeting();
        let arms = [arm(along(-0.4)), arm(meeting.postument)];
        let mut mp = standing(guard().by_hand(), arms);

        // The servo is gone, so the motion itself fails.
        let turned = mp.turn_motor(0, 0, 1.0).await;

        assert!(turned.is_err());
        assert!(!mp.parts.may_meet.pairs().join(0, 1));
    }

    #[tokio::test(start_paused = true)]
    async fn dead_servo_error_outranks_refused_motion_error() {
        let (meeting, along) = meeting();
        let mut mp = standing(guard(), [arm(along(-0.4)), arm(meeting.postument)]);
        let cause = NonFatal::Arguments("too near".into());
        let refused = Error::NonFatal { actor: "mp".into(), place: "check a path".into(), cause };

        // The servo is gone. A task that continued would end with the refusal instead.
        let event = mp.error_event::<()>(refused).await;

        assert!(matches!(event, Err(Stop::Error(Error::System { .. }))));
    }

    /// A motion that is too fast near the operator gives both arms more time, by the same factor.
    #[tokio::test(start_paused = true)]
    async fn excess_speed_slows_both_arms_by_equal_factor() {
        let (meeting, _) = meeting();
        let past = |d0: f64| JointPositions([d0, 0.0, -1.57, 0.0, 1.56, 1.57, -1.57]);
        let mut rolled = meeting.postument;
        rolled.0[6] += 0.4;
        let arms = [arm(past(0.2)), arm(meeting.postument)];
        let mp = standing(guard(), arms);
        let asked = [Some(to(past(0.4))), Some(to(rolled))];
        let mut orders = asked.clone();

        mp.guard_orders(&mut orders, &Default::default()).unwrap();

        let lasts = |orders: &[Option<Behaviour>]| {
            [0, 1].map(|i| manner().seconds(orders[i].as_ref().unwrap(), &arms[i]))
        };
        let (before, after) = (lasts(&asked), lasts(&orders));
        let slower = [after[0] / before[0], after[1] / before[1]];
        assert!(slower[0] > 1.2, "{slower:?}");
        // Their paths are free only if both arms have done the same share at each moment.
        assert!((slower[0] - slower[1]).abs() < 1e-9, "{slower:?}");
    }

    /// Returns the order for the registered motion of the joints through these places.
    fn through(through: Vec<JointPositions>) -> Behaviour {
        let order = JointPolyline { through, blend: 0.2, speed: 1.0 };
        Along::behaviour("joint_polyline", &order).unwrap()
    }

    #[tokio::test(start_paused = true)]
    async fn declared_course_is_checked_and_slowed() {
        let (meeting, along) = meeting();
        let stand = [arm(along(-0.3)), arm(meeting.postument)];
        let mp = standing(guard(), stand);
        let mut into = [Some(through(vec![along(0.3), along(-0.3)])), None];
        let forecasts = mp.forecasts(&into).unwrap();
        let refused = mp.guard_orders(&mut into, &forecasts);
        assert!(matches!(refused, Err(Inadmissible::Near(_))), "{refused:?}");

        // Past the operator the motion gets more time.
        let past = |d0: f64| JointPositions([d0, 0.0, -1.57, 0.0, 1.56, 1.57, -1.57]);
        let mp = standing(guard(), [arm(past(0.2)), arm(meeting.postument)]);
        let mut orders = [Some(through(vec![past(0.4)])), None];
        let forecasts = mp.forecasts(&orders).unwrap();
        mp.guard_orders(&mut orders, &forecasts).unwrap();
        let Some(Behaviour::Own(own)) = &orders[0] else { panic!("{orders:?}") };
        assert!((0.2..0.9).contains(&own.fraction), "{}", own.fraction);
        // The slower motion is slow enough.
        let again = mp.forecasts(&orders).unwrap();
        let fraction = own.fraction;
        mp.guard_orders(&mut orders, &again).unwrap();
        let Some(Behaviour::Own(own)) = &orders[0] else { panic!("{orders:?}") };
        assert!((own.fraction / fraction - 1.0).abs() < 0.02, "{} {fraction}", own.fraction);
    }

    #[tokio::test(start_paused = true)]
    async fn motion_is_slow_only_near_the_operator() {
        let (meeting, _) = meeting();
        let mut cell = example_cell();
        // The arm begins at the place of the hand-over.
        let track = JointPositions([0.2, 0.0, -1.57, 0.0, 1.56, 1.57, -1.57]);
        let arm_of = &cell.arms[0];
        let tool = arm_of.model.base_from_flange(&track) * arm_of.flange_from_tool;
        cell.hand.world_from_cube.translation = (arm_of.world_from_base * tool).translation;
        let arms = [arm(track), arm(meeting.postument)];
        let mp = standing(Guard::of(&cell, 0.05), arms);
        let mut target = track;
        target.0[1] += 1.2;
        let asked = to(target);
        let mut orders = [Some(asked.clone()), None];

        mp.guard_orders(&mut orders, &Default::default()).unwrap();

        let Some(Behaviour::Legs { legs, seconds }) = orders[0].clone() else {
            panic!("{orders:?}")
        };
        assert_eq!(*legs.end(), target);
        let guard = mp.guard().unwrap();
        let way = PlannedMotion::Joints(target);
        let whole = manner().seconds(&asked, &arms[0]);
        let profile = manner().speeds.profile;
        let share = |part| profile.share(part, whole);
        let stretched = whole * guard.course(0, &track, &way).hand_speed_factor(whole, share);
        assert!(seconds < 0.6 * stretched, "{seconds} s, {stretched} s if slow on the whole path");
        // The path has not changed, and the hand is slow enough near the operator.
        for part in [0.1, 0.3, 0.6, 0.9] {
            let at = legs.at(&track, part);
            assert!(at.0.iter().zip(track.0).skip(2).all(|(a, b)| (a - b).abs() < 1e-12));
        }
        let factor = guard
            .course(0, &track, &PlannedMotion::Legs(legs))
            .hand_speed_factor(seconds, |part| part);
        assert!(factor <= 1.0 + 1e-6 && factor > 0.3, "{factor}");
    }

    /// An empty hand may pass where a hand with a cube is refused.
    #[tokio::test(start_paused = true)]
    async fn empty_hand_may_pass_where_loaded_hand_cannot() {
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
                standing(guard().by_hand(), arms)
                    .guard_orders(&mut [Some(to(track)), None], &Default::default())
            };
            // The first place on the path to the other hand at which a cube is an obstacle.
            let mut beside = (1..40).map(|i| -0.4 + 0.01 * f64::from(i));
            let Some(by) = beside.find(|by| goes(*by, edge).is_err()) else { continue };
            if matches!(goes(by, edge), Err(Inadmissible::Near(Near::Hands { .. }))) {
                tried += usize::from(goes(by, 0.0).is_ok());
            }
        }
        assert!(tried >= 2, "{tried}");
    }
}
