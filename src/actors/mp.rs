//! MP: coordinates all effectors. The shell around a task's kernel.
//!
//! Two schemes of coordination (Zieliński et al. 2007, p. 374): *continuous*, in which MP runs the generators of
//! all effectors and commands them at each macrostep through transmitting ECPs; and *sporadic*, in which MP invokes
//! behaviours and the ECPs run the generators.

use super::alarm::{Alarm, Care, Pulse};
use super::clock::Clock;
use super::control::{Attended, Control, LOOK, Tempo, Terminated, permission_soon};
use super::ecp::EcpHandle;
use super::fault::Mishap;
use super::homing::{self, homed};
use super::lookout::Apart;
use super::move_instruction::{Manner, Motion};
use super::notice::{Notice, UiHandle};
use super::vsp::VspHandle;
use super::work::Work;
use crate::error::{Error, Fatal, NonFatal, System};
use crate::generators::position::min_jerk;
use crate::generators::{Behaviour, Outcome};
use crate::motion::{
    AXES, ArmState, Motion as Way, MotorPositions, MoveCommand, PERIOD, Synchronisation,
};
use crate::operator::{Answer, Input, Manual, Question};
use crate::reach::guard::{Guard, Near, PlannedMotion as Asked};
use crate::record::journal::Journal;
use crate::record::recorder::Entry;
use crate::record::run_hash::RunHash;
use crate::scenario::keys::Pace;
use crate::spatial::Pose;
use crate::tasks::{self, Action, Event, Finish, Forces, Readings, Task, Until};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
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

/// What MP is made of.
pub struct Parts {
    /// Told when a turn begins and ends.
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
    /// The operator's will.
    pub control: watch::Receiver<Control>,
    /// The operator's UI.
    pub ui: UiHandle,
    /// Answers and manual orders of the operator; `None` when no operator can be asked.
    pub operator: Option<mpsc::Receiver<Input>>,
    /// Told while the operator is waited for.
    pub tempo: Tempo,
    /// Servo periods and time.
    pub clock: Clock,
    /// The door for long work.
    pub work: Work,
    /// Where messages are noted.
    pub tape: RunHash,
    /// What another run must know to go on.
    pub journal: Option<Journal>,
    /// Refuses ways on which the arms would come too near to something; an MP without a cell has none.
    pub guard: Option<Guard>,
    /// Told whether the hands are not to meet.
    pub apart: Apart,
}

impl Parts {
    /// Arms and no more: no sensors, nobody who can be asked, nothing durable, no guard. Virtual time, sporadic coordination.
    #[must_use]
    pub fn bare(
        ecps: Vec<EcpHandle>,
        manners: Vec<Manner>,
        control: watch::Receiver<Control>,
        ui: UiHandle,
        clock: Clock,
        tape: RunHash,
    ) -> Self {
        Self {
            turning: Turning::default(),
            forces: None,
            ecps,
            tracker: None,
            hand_cameras: [None, None],
            coordination: Coordination::Sporadic,
            manners,
            control,
            ui,
            operator: None,
            tempo: Tempo::default(),
            clock,
            work: Work(Pace::Virtual),
            tape,
            journal: None,
            guard: None,
            apart: Apart::default(),
        }
    }
}

/// MP's word for it: a turn is commanded and unfinished.
#[derive(Debug, Clone, Default)]
pub struct Turning(Arc<AtomicBool>);

impl Turning {
    /// Tells.
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
    /// Phases, each with the time at which it began [s], and when that was by [`Tempo::worked`].
    pub phases: Vec<(&'static str, f64, Instant)>,
    /// When it ended [s].
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
    /// Which actor has failed, and what befalls this one.
    alarm: Alarm,
    mishap: Arc<Mishap>,
    pulse: Pulse,
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

impl Mp {
    /// MP with its effectors.
    #[must_use]
    pub fn new(parts: Parts) -> Self {
        let (arms, phases) = (Vec::new(), Vec::new());
        let Care { mishap, alarm, .. } = Care::default();
        let pulse = alarm.pulse("mp");
        Self { parts, arms, phases, alarm, mishap, pulse }
    }

    /// The same, which heeds an alarm.
    pub(crate) fn heeding(mut self, care: &Care) -> Self {
        self.alarm = care.alarm.clone();
        self.pulse = self.alarm.pulse("mp");
        self.mishap = Arc::clone(&care.mishap);
        self
    }

    fn felt(&self) -> Forces {
        self.parts.forces.as_ref().map(|f| *f.borrow()).unwrap_or_default()
    }

    /// The arms that know where they are: one that is not synchronised does not.
    fn known(&self) -> [Option<&ArmState>; 2] {
        std::array::from_fn(|i| {
            self.arms.get(i).filter(|arm| arm.synchronisation == Synchronisation::Yes)
        })
    }

    /// The guard, as the jaws stand now.
    fn guard(&self) -> Option<Guard> {
        let mut guard = self.parts.guard.clone()?;
        guard.holding(self.known().map(|arm| arm.map(|arm| arm.jaw_opening)));
        Some(guard)
    }

    /// Whether the ways that are asked for are free, as far as the believed cell tells. Those that are too fast where the
    /// operator's hand may be are given more time, both arms as much, since they are free when both go evenly. The visual
    /// servo has its own speed, and its way is not known before.
    fn guarded(&self, orders: &mut [Option<Behaviour>; 2]) -> Result<(), Near> {
        let Some(guard) = self.guard() else { return Ok(()) };
        let known = self.known();
        let ways = [0, 1]
            .map(|i: usize| known[i].map_or(Asked::Stays, |arm| asked(orders[i].as_ref(), arm)));
        let from = known.map(|arm| arm.map(|arm| &arm.desired_joints));
        guard.ways(from, ways.each_ref())?;
        let led = [0, 1]
            .map(|i: usize| known[i].map_or(Asked::Stays, |arm| leads(orders[i].as_ref(), arm)));
        self.parts.apart.tell(guard.keep_apart(from, led.each_ref()));
        let lasts: [f64; 2] =
            std::array::from_fn(|i| match (&orders[i], self.parts.manners.get(i), known[i]) {
                (Some(order), Some(manner), Some(arm)) => manner.seconds(order, arm),
                _ => 0.0,
            });
        let slower = (0..2)
            .filter(|&i| lasts[i] > 0.0)
            .filter_map(|i| Some((i, &known[i]?.desired_joints)))
            .map(|(i, from)| guard.haste(i, from, &ways[i], lasts[i], min_jerk))
            .fold(1.0, f64::max);
        if slower > 1.0 {
            for (i, order) in orders.iter_mut().enumerate().filter(|(i, _)| lasts[*i] > 0.0) {
                if let (Some(order), Some(manner), Some(arm)) =
                    (order, self.parts.manners.get(i), known[i])
                {
                    manner.last(order, arm, slower * lasts[i]);
                }
            }
        }
        Ok(())
    }

    fn now(&self) -> f64 {
        self.parts.clock.period() as f64 * PERIOD
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
        let alarm = self.alarm.clone();
        let performed = tokio::select! {
            biased;
            error = alarm.raised() => Err(Stop::Error(error)),
            performed = self.perform(task) => performed,
        };
        match performed {
            Ok(finish) => ending.finish = Some(finish),
            // What an arm has to say outranks the operator's end.
            Err(Stop::Terminated) => ending.error = self.refresh().await.err(),
            Err(Stop::Error(error)) => ending.error = Some(error),
        }
        if let Some(error) = &ending.error {
            self.parts.ui.tell(Notice::Error(self.now(), error.clone()));
        }
        ending.end = self.now();
        ending.felt = self.felt();
        ending.phases = std::mem::take(&mut self.phases);
        ending
    }

    async fn perform<T: Task>(&mut self, task: &mut T) -> Result<Finish, Stop> {
        self.permitted().await?.map_err(|_| Stop::Terminated)?;
        self.refresh().await?;
        let mut event = Event::Start;
        loop {
            self.permitted().await?.map_err(|_| Stop::Terminated)?;
            self.pulse.works();
            self.mishap.befall().await;
            let forces = self.felt();
            self.parts.tape.message("mp", "kernel", &(&event, &forces));
            let action = task.next(event, &Readings { arms: &self.arms, forces });
            self.parts.tape.message("kernel", "mp", &action);
            let entry = task.entry();
            // A slow disk is not MP's own work.
            self.pulse.waits();
            if let Some(entry) = entry {
                self.note(entry).await;
            }
            self.pulse.works();
            for note in task.notes() {
                self.parts.ui.tell(Notice::Warning(self.now(), note));
            }
            if let Some(board) = self.parts.ui.board() {
                let picture = task.picture();
                let mut latest = board.latest();
                (latest.picture, latest.mp) = (picture, doing(&action));
            }
            self.parts.ui.recorder().note_some(self.parts.clock.period(), || {
                task.picture().map(|picture| Entry::Belief(Box::new(picture)))
            });
            tracing::debug!(now = self.now(), ?action, "action");
            self.pulse.waits();
            event = match action {
                Action::Finish(finish) => return Ok(finish),
                Action::Defect(why) => return Err(Stop::Error(Self::defect(why))),
                Action::Phase(name) => {
                    let now = self.now();
                    self.phases.push((name, now, self.parts.tempo.worked()));
                    self.parts.ui.tell(Notice::Phase(now, name.into()));
                    Event::Done
                }
                Action::Behave { mut orders, until } => {
                    if let Err(near) = self.guarded(&mut orders) {
                        let cause = NonFatal::Arguments(near.to_string());
                        let error =
                            Error::NonFatal { actor: "mp".into(), place: "guard a way", cause };
                        event = self.trouble(error).await?;
                        continue;
                    }
                    if let Some(board) = self.parts.ui.board() {
                        board.ordered(&orders);
                    }
                    let turns = orders.iter().any(|o| matches!(o, Some(Behaviour::Turn { .. })));
                    self.parts.turning.tell(turns);
                    let outcomes = match self.parts.coordination {
                        Coordination::Sporadic => {
                            let (pulse, mishap) = (self.pulse.clone(), Arc::clone(&self.mishap));
                            looking_up(&pulse, &mishap, self.invoke(orders, until)).await
                        }
                        Coordination::Continuous => self.move_all(orders, until).await,
                    };
                    self.pulse.waits();
                    self.parts.turning.tell(false);
                    if let Some(board) = self.parts.ui.board() {
                        board.ordered(&[None, None]);
                    }
                    if *self.parts.control.borrow() == Control::Terminated {
                        return Err(Stop::Terminated);
                    }
                    match outcomes {
                        Ok(outcomes) => Event::Behaved(outcomes),
                        Err(error) => self.trouble(error).await?,
                    }
                }
                Action::Bias(which) => match self.bias(which).await {
                    Ok(()) => Event::Done,
                    Err(error) => self.trouble(error).await?,
                },
                Action::Watch(on) => {
                    match &self.parts.tracker {
                        Some(tracker) => tracker.track(on),
                        None => {
                            for ecp in &self.parts.ecps {
                                ecp.watch(on).await?;
                            }
                        }
                    }
                    Event::Done
                }
                Action::Look { effector, view } => {
                    let reading =
                        match self.parts.hand_cameras.get(effector).and_then(Option::as_ref) {
                            Some(camera) => camera.look(view).await,
                            None => self.ecp(effector)?.look(view).await,
                        };
                    self.refresh().await?;
                    match reading {
                        Ok(reading) => Event::Looked(Ok(reading)),
                        Err(Error::NonFatal { cause: NonFatal::NoReading(reason), .. }) => {
                            Event::Looked(Err(reason))
                        }
                        Err(error) => self.trouble(error).await?,
                    }
                }
                Action::Think(thought) => {
                    let conclusion = self.parts.work.run(move || T::think(thought)).await;
                    match conclusion {
                        Some(conclusion) => Event::Thought(conclusion),
                        None => return Err(Stop::Error(Self::system("think", "the worker"))),
                    }
                }
                Action::Ask(question) => Event::Answered(self.ask(&question).await?),
                Action::Await => {
                    let (effector, order) = self.ordered().await?;
                    Event::Ordered(effector, order)
                }
                Action::Manual { effector, order } => match self.manual(effector, &order).await {
                    Ok(()) => Event::Done,
                    Err(Stop::Error(error)) => self.trouble(error).await?,
                    Err(terminated) => return Err(terminated),
                },
            };
        }
    }

    /// Notes what is about to be done; returns when that is durable. A run that cannot be noted goes on: it is no worse than
    /// one without a journal, and its cube is in its hands.
    async fn note(&mut self, entry: tasks::Entry) {
        let Some(mut journal) = self.parts.journal.take() else { return };
        let writes = move || match journal.write(&entry) {
            Ok(()) => Ok(journal),
            Err(why) => Err(journal.given_up(&why)),
        };
        match self.parts.work.wait(writes).await {
            Some(Ok(journal)) => self.parts.journal = Some(journal),
            Some(Err(told)) => self.parts.ui.tell(Notice::Warning(self.now(), told)),
            None => {
                let told = "the journal's writer failed: this run must not be resumed";
                self.parts.ui.tell(Notice::Warning(self.now(), told.to_owned()));
            }
        }
    }

    /// Takes the present forces for zero.
    async fn bias(&mut self, which: [bool; 2]) -> Result<(), Error> {
        for (ecp, _) in self.parts.ecps.iter().zip(which).filter(|(_, wanted)| *wanted) {
            match ecp.bias().await {
                // It is zeroed: whoever is there should know, and the task goes on.
                Err(error @ Error::NonFatal { cause: NonFatal::ZeroMoved { .. }, .. }) => {
                    self.parts.ui.tell(Notice::Error(self.now(), error));
                }
                zeroed => {
                    zeroed?;
                }
            }
        }
        self.refresh().await
    }

    /// A non-fatal error is told to the kernel, which may go on; the others end the run. What stops another arm outranks
    /// what this one was refused for it.
    async fn trouble<C>(&mut self, error: Error) -> Result<Event<C>, Stop> {
        match error {
            Error::NonFatal { .. } => {
                self.refresh().await?;
                self.parts.ui.tell(Notice::Error(self.now(), error.clone()));
                Ok(Event::Trouble(error.to_string()))
            }
            Error::Fatal { .. } | Error::System { .. } => Err(Stop::Error(error)),
        }
    }

    /// Makes the error of a kernel that cannot go on.
    fn defect(why: String) -> Error {
        let cause = Fatal::Kernel(why);
        Error::Fatal { actor: "mp".into(), place: "resume the task", cause, last: None }
    }

    fn system(place: &'static str, who: &str) -> Error {
        Error::System { actor: "mp".into(), place, cause: System::Closed(who.into()) }
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
            if let Some(will) = permission_soon(&mut self.parts.control).await {
                return Ok(will);
            }
            for ecp in &self.parts.ecps {
                ecp.state().await?;
            }
        }
    }

    /// Asks the operator, and waits as long as the question allows. The arms hold meanwhile.
    async fn ask(&mut self, question: &Question) -> Result<Option<Answer>, Stop> {
        if self.parts.operator.is_none() {
            return Ok(None);
        }
        let until = self.now() + question.seconds;
        if let Some(board) = self.parts.ui.board() {
            board.latest().question = Some(Question { until, ..question.clone() });
        }
        self.parts.tempo.attend(Attended::Asked);
        let mut answer = Ok(None);
        while self.now() < until {
            match self.input().await {
                Ok(Some(Input::Answer { question: number, answer: given }))
                    if number == question.number && given.fits(&question.subject) =>
                {
                    answer = Ok(Some(given));
                    break;
                }
                Ok(_) => {}
                Err(stop) => {
                    answer = Err(stop);
                    break;
                }
            }
        }
        self.parts.tempo.attend(Attended::No);
        if let Some(board) = self.parts.ui.board() {
            board.latest().question = None;
        }
        answer
    }

    /// The operator's next order.
    async fn ordered(&mut self) -> Result<(usize, Manual), Stop> {
        self.parts.tempo.attend(Attended::ByHand);
        if let Some(board) = self.parts.ui.board() {
            board.latest().manual = true;
        }
        let order = loop {
            match self.input().await {
                Ok(Some(Input::Manual { effector, order })) => break Ok((effector, order)),
                Ok(_) => {}
                Err(stop) => break Err(stop),
            }
        };
        self.refresh().await?;
        order
    }

    /// Returns the operator's next input if one comes soon; a terminate and a fault of an arm come
    /// first.
    async fn input(&mut self) -> Result<Option<Input>, Stop> {
        self.permitted().await?.map_err(|_| Stop::Terminated)?;
        let input = match &mut self.parts.operator {
            Some(inputs) => tokio::time::timeout(LOOK, inputs.recv()).await.ok().flatten(),
            None => return Err(Stop::Error(Self::system("listen", "the operator"))),
        };
        if input.is_none() {
            // The sleep keeps this from spinning when the UI is gone.
            tokio::time::sleep(LOOK).await;
        }
        self.refresh().await?;
        Ok(input)
    }

    /// What no behaviour does.
    async fn manual(&mut self, effector: usize, order: &Manual) -> Result<(), Stop> {
        match order {
            Manual::Synchronise => self.synchronise(effector).await?,
            Manual::Motor(step) => self.turn_motor(effector, step.axis, step.by).await?,
            other => {
                let cause = NonFatal::Arguments(format!("{other:?} is no order to a shell"));
                return Err(Stop::Error(Error::NonFatal {
                    actor: "mp".into(),
                    place: "manual",
                    cause,
                }));
            }
        }
        self.refresh().await?;
        Ok(())
    }

    /// Has an arm find out where it is; a pause brings it to a stand in between.
    async fn synchronise(&mut self, effector: usize) -> Result<(), Stop> {
        let ecp = self.ecp(effector)?.clone();
        loop {
            self.permitted().await?.map_err(|_| Stop::Terminated)?;
            let Parts { control, clock, .. } = &mut self.parts;
            if homed(ecp.synchronise(), control, clock).await? {
                return Ok(());
            }
            self.parts.ui.tell(Notice::Note(self.now(), homing::STANDS.to_owned()));
        }
    }

    /// Turns one motor by an angle [rad], from rest to rest; a pause brings it to rest in between.
    async fn turn_motor(&mut self, effector: usize, axis: usize, by: f64) -> Result<(), Stop> {
        /// Largest speed [rad/s], and the least time that it takes [s].
        const FASTEST: f64 = 25.0;
        const LEAST: f64 = 0.4;
        /// From full pace to rest [s].
        const REST: f64 = 0.4;
        let macrostep = self.parts.manners.get(effector).map_or(8, |m| m.compliance.macrostep);
        let step = f64::from(macrostep) * PERIOD;
        let lasts = (by.abs() * std::f64::consts::FRAC_PI_2 / FASTEST).max(LEAST);
        let way = |t: f64| 0.5 * by * (1.0 - libm::cos(std::f64::consts::PI * t.min(1.0)));
        let ecp = self.ecp(effector)?.clone();
        // Nobody looks at its way before: what comes too near on it is stopped.
        if let Some(guard) = self.guard() {
            let from = self.known().map(|arm| arm.map(|arm| &arm.desired_joints));
            self.parts.apart.tell(guard.keep_apart(from, [&Asked::Stays, &Asked::Stays]));
        }
        let (mut at, mut pace) = (0.0, 1.0_f64);
        while at < 1.0 {
            if pace <= 0.0 {
                self.permitted().await?.map_err(|_| Stop::Terminated)?;
            }
            let rises = *self.parts.control.borrow() == Control::Running;
            pace = (pace + if rises { step / REST } else { -step / REST }).clamp(0.0, 1.0);
            let next = at + pace * step / lasts;
            let mut motors = MotorPositions([0.0; AXES]);
            motors.0[axis.min(AXES - 1)] = way(next) - way(at);
            at = next;
            let command =
                MoveCommand { motion: Way::MotorsBy(motors), periods: macrostep, jaw: None };
            ecp.transmit(command).await?;
        }
        Ok(())
    }

    async fn refresh(&mut self) -> Result<(), Error> {
        let mut arms = Vec::with_capacity(self.parts.ecps.len());
        for ecp in &self.parts.ecps {
            arms.push(ecp.state().await?);
        }
        self.arms = arms;
        Ok(())
    }

    /// Sporadic coordination: the ECPs run the generators.
    async fn invoke(
        &mut self,
        orders: [Option<Behaviour>; 2],
        until: Until,
    ) -> Result<[Option<Outcome>; 2], Error> {
        let mut outcomes = [None, None];
        let [first, second] = orders;
        match (first, second) {
            (Some(first), Some(second)) => {
                let (a, b) = (self.ecp(0)?.clone(), self.ecp(1)?.clone());
                // Whoever the step waits for ends the partner.
                let run = |own: EcpHandle, partner: EcpHandle, order: Behaviour, leads: bool| async move {
                    let result = own.behave(order).await;
                    let failed = !matches!(&result, Ok((outcome, _)) if !outcome.alarms());
                    if leads || failed {
                        // If it is gone, its own answer says so.
                        let _ = partner.end().await;
                    }
                    result
                };
                let leads = |effector| until == Until::Effector(effector);
                let (x, y) = tokio::join!(
                    run(a.clone(), b.clone(), first, leads(0)),
                    run(b, a, second, leads(1))
                );
                let (x, y) = both(x, y)?;
                outcomes[0] = Some(x.0);
                outcomes[1] = Some(y.0);
            }
            (Some(order), None) => outcomes[0] = Some(self.ecp(0)?.behave(order).await?.0),
            (None, Some(order)) => outcomes[1] = Some(self.ecp(1)?.behave(order).await?.0),
            (None, None) => {}
        }
        self.refresh().await?;
        Ok(outcomes)
    }

    /// Continuous coordination: one move instruction for all effectors, a macrostep at a time.
    async fn move_all(
        &mut self,
        orders: [Option<Behaviour>; 2],
        until: Until,
    ) -> Result<[Option<Outcome>; 2], Error> {
        self.refresh().await?;
        let mut motions: [Option<Motion>; 2] = [None, None];
        for (effector, order) in orders.iter().enumerate() {
            if let Some(order) = order {
                let manner = self
                    .parts
                    .manners
                    .get(effector)
                    .ok_or_else(|| Self::system("move", "an effector"))?;
                motions[effector] = Some(Motion::begin(order, manner));
            }
        }
        let mut outcomes: [Option<Outcome>; 2] = [None, None];
        loop {
            // A pause is no work of its own.
            self.pulse.waits();
            let rest = motions.iter().flatten().all(Motion::rests);
            if rest && self.permitted().await?.is_err() {
                break;
            }
            self.pulse.works();
            self.mishap.befall().await;
            let will = *self.parts.control.borrow();
            motions.iter_mut().flatten().for_each(|motion| motion.heed(will));
            let target = self.parts.tracker.as_ref().and_then(VspHandle::target);
            let mut commands = [None, None];
            for effector in 0..2 {
                let Some(motion) = &mut motions[effector] else { continue };
                match motion.step(&self.arms[effector], target.as_ref()) {
                    Ok((command, sensing)) => {
                        if let (Some(sensing), Some(tracker)) = (sensing, &self.parts.tracker) {
                            tracker.configure(sensing);
                        }
                        commands[effector] = Some(command);
                    }
                    Err(outcome) => {
                        outcomes[effector] = Some(outcome);
                        motions[effector] = None;
                    }
                }
            }
            let over = outcomes.iter().any(|o| o.as_ref().is_some_and(Outcome::alarms));
            let led = matches!(until, Until::Effector(e) if outcomes[e].is_some());
            if over || led || motions.iter().all(Option::is_none) {
                break;
            }
            let send = |effector: usize| {
                let command = commands[effector];
                let ecp = self.parts.ecps.get(effector).cloned();
                let motion = motions[effector].as_ref();
                async move {
                    let (Some(ecp), Some(command)) = (ecp, command) else { return Ok(None) };
                    match ecp.transmit(command).await {
                        Err(error) if motion.is_some_and(|motion| motion.bears(&error)) => {
                            ecp.state().await.map(Some)
                        }
                        sent => sent.map(Some),
                    }
                }
            };
            let sent = async { tokio::join!(send(0), send(1)) };
            let (a, b) = self.pulse.away(sent).await;
            let (a, b) = both(a, b)?;
            for (effector, state) in [a, b].into_iter().enumerate() {
                if let Some(state) = state {
                    self.arms[effector] = state;
                }
            }
        }
        for (effector, motion) in motions.iter().enumerate() {
            if motion.is_some() {
                outcomes[effector] = Some(Outcome::Ended);
            }
        }
        self.refresh().await?;
        Ok(outcomes)
    }
}

/// Waits for others, and looks up in between: who cannot even do that hangs, and is noticed before anybody needs an answer.
async fn looking_up<T>(pulse: &Pulse, mishap: &Mishap, others: impl Future<Output = T>) -> T {
    /// Between two looks: with the alarm's own patience less than 0.1 s.
    const LOOKS_UP: Duration = Duration::from_millis(10);
    let mut others = std::pin::pin!(others);
    loop {
        if let Ok(answer) = tokio::time::timeout(LOOKS_UP, &mut others).await {
            return answer;
        }
        pulse.works();
        mishap.befall().await;
        pulse.waits();
    }
}

/// How a behaviour moves an arm that stands so, as far as that is known before. An approach ends where it touches what
/// it is to touch, the table among others, and slowly.
fn asked(order: Option<&Behaviour>, arm: &ArmState) -> Asked {
    match order {
        Some(Behaviour::Joints { target, .. }) => Asked::Joints(*target),
        Some(Behaviour::Line { target, .. }) => Asked::Line(*target),
        Some(Behaviour::Withdraw { distance, .. }) => {
            Asked::Line(arm.desired_base_from_tool * Pose::translation(0.0, 0.0, -distance))
        }
        _ => Asked::Stays,
    }
}

/// The same, with an approach as far as it may go: whether it leads to the other hand.
fn leads(order: Option<&Behaviour>, arm: &ArmState) -> Asked {
    match order {
        Some(Behaviour::Approach { distance, .. }) => {
            Asked::Line(arm.desired_base_from_tool * Pose::translation(0.0, 0.0, *distance))
        }
        order => asked(order, arm),
    }
}

/// Both answers, or the graver of two errors.
fn both<T>(a: Result<T, Error>, b: Result<T, Error>) -> Result<(T, T), Error> {
    match (a, b) {
        (Ok(a), Ok(b)) => Ok((a, b)),
        (Err(a), Err(b)) => Err(if b.gravity() > a.gravity() { b } else { a }),
        (Err(error), Ok(_)) | (Ok(_), Err(error)) => Err(error),
    }
}

/// An action in words.
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
    use super::super::move_instruction::example_manner;
    use super::super::{ecp, edp, notice};
    use super::*;
    use crate::hw::driver::{self, Switches};
    use crate::motion::JointPositions;
    use crate::reach::{Meeting, MeetingTable, ReachSettings, example_cell};

    /// With a track that would be too fast beside the operator's hand.
    fn manner() -> Manner {
        let mut manner = example_manner();
        (manner.speeds.joint[0], manner.speeds.joint_acceleration[0]) = (0.5, 1.0);
        manner
    }

    /// An MP whose arms stand so. The first has an ECP and an EDP, whose servo does nothing.
    fn standing(guard: Guard, arms: [ArmState; 2]) -> Mp {
        let clock = Clock::new(tokio::time::Instant::now(), Arc::new(Switches::default()));
        let (control, tape) = (watch::channel(Control::Running).1, RunHash::default());
        let (link, end) = driver::link();
        drop(end);
        let edp = edp::spawn("track", link, clock.clone(), tape.clone());
        let parts = ecp::Parts {
            edp,
            tracker: None,
            hand_camera: None,
            manner: manner(),
            control: control.clone(),
            tape: tape.clone(),
        };
        let ecps = vec![ecp::spawn("track", parts)];
        let parts = Parts::bare(ecps, vec![manner(); 2], control, notice::mailbox().0, clock, tape);
        Mp { arms: arms.into(), ..Mp::new(Parts { guard: Some(guard), ..parts }) }
    }

    fn arm(joints: JointPositions) -> ArmState {
        let synchronisation = Synchronisation::Yes;
        ArmState { desired_joints: joints, synchronisation, ..ArmState::default() }
    }

    fn to(target: JointPositions) -> Behaviour {
        Behaviour::Joints { target, speed: 1.0, seconds: 0.0 }
    }

    /// The first meeting of the hands, and the track's stand so far along from there [m].
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
