//! The port of a procedure for most tasks: one without long work, whose state is a table of facts.
//!
//! - in: orders of the procedure, such as motions of effectors, messages and facts
//! - out: outcomes, or the [`Hindrance`] that keeps the task from going on
//!
//! ```
//! use rubik_robot::kernel::robot::{Hindrance, Robot};
//!
//! /// Sets the force sensors of all arms to zero.
//! async fn zero(robot: Robot) -> Result<String, Hindrance> {
//!     robot.phase("zero").await?;
//!     robot.bias(vec![true; robot.arms().len()]).await?;
//!     Ok("the force sensors are at zero".to_owned())
//! }
//!
//! let kernel = Robot::kernel(zero);
//! ```

use super::procedure::{Port, Procedure, Shared};
use super::sensor::SensorReadings;
use super::{
    Account, Action, Adjustment, Document, Event, Finish, Forces, Input, Message, Picture,
    Programme, Progress, Readings, Remark, Signal, Until,
};
use crate::generators::{Behaviour, Outcome};
use crate::motion::{ArmState, PERIOD};
use crate::spatial::Pose;
use nalgebra::Point3;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::collections::{BTreeMap, VecDeque};
use std::fmt;
use std::path::PathBuf;

/// Time between two looks at a reading or an input for which a procedure waits (s).
const LOOK: f64 = 0.02;
/// Time after which a motion that something stopped begins again (s).
const AGAIN: f64 = 1.0;

/// Kernel of a task whose procedure acts by a [`Robot`].
pub type RobotKernel = Procedure<(), (), Board>;

/// Reason why a task cannot go on, in words.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Hindrance(pub String);

impl fmt::Display for Hindrance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl From<String> for Hindrance {
    fn from(reason: String) -> Self {
        Self(reason)
    }
}

/// State behind the port of a [`Robot`].
#[derive(Debug, Default)]
pub struct Board {
    /// States of the effectors at the last event, in the scenario's order.
    arms: Vec<ArmState>,
    /// Forces of the wrists at the last event.
    forces: Forces,
    /// Readings of the sensors at the last event.
    sensors: SensorReadings,
    /// Messages to the operator that the shell has not taken yet.
    notes: Vec<Remark>,
    /// Facts for the user interfaces, by name.
    facts: BTreeMap<String, Value>,
    /// Figures for the summary, by name.
    figures: BTreeMap<String, Value>,
    /// Text files for the run to write at its end.
    documents: Vec<Document>,
    /// Entry that must be in the journal before the next action.
    entry: Option<Progress>,
    /// Messages that came while the procedure waited for something else.
    early: VecDeque<Message>,
}

impl Shared for Board {
    type Entry = Progress;

    fn see(&mut self, readings: &Readings<'_>) {
        self.arms.clear();
        self.arms.extend_from_slice(readings.arms);
        self.forces.clone_from(readings.forces);
        self.sensors.clone_from(readings.sensors);
    }

    fn take_notes(&mut self) -> Vec<Remark> {
        std::mem::take(&mut self.notes)
    }

    fn picture(&self) -> Option<Picture> {
        let facts = || Picture { facts: self.facts.clone(), ..Picture::default() };
        (!self.facts.is_empty()).then(facts)
    }

    fn entry(&self) -> Option<Progress> {
        self.entry.clone()
    }

    fn account(&self) -> Account {
        let (figures, documents) = (self.figures.clone(), self.documents.clone());
        Account { whereabouts: String::new(), figures, documents }
    }
}

/// The effectors, the operator and the journal, as a procedure uses them.
#[derive(Debug, Clone)]
pub struct Robot {
    port: Port<(), (), Board>,
}

impl Robot {
    /// Makes the kernel of a task from its procedure. The text that the procedure returns is the
    /// reason of a success; a hindrance is the reason of a failure.
    pub fn kernel<P>(procedure: impl FnOnce(Self) -> P) -> RobotKernel
    where
        P: Future<Output = Result<String, Hindrance>> + Send + 'static,
    {
        let port = Port::new(Board::default());
        let work = procedure(Self { port: port.clone() });
        Procedure::new(port, async move {
            match work.await {
                Ok(reason) => Finish { achieved: true, reason },
                Err(Hindrance(reason)) => Finish { achieved: false, reason },
            }
        })
    }

    /// Returns the states of all effectors at the last event, in the scenario's order.
    #[must_use]
    pub fn arms(&self) -> Vec<ArmState> {
        self.port.state(|board| board.arms.clone())
    }

    /// Returns the forces of the wrists at the last event, as their VSP aggregates them.
    #[must_use]
    pub fn forces(&self) -> Forces {
        self.port.state(|board| board.forces.clone())
    }

    /// Returns the reading of a sensor at the last event. `name` is that of its VSP.
    ///
    /// # Errors
    /// If the actor does not own the sensor, there is no reading or only an old one, the device has
    /// none, or it is of another type.
    pub fn sensor<R: DeserializeOwned>(&self, name: &str) -> Result<R, Hindrance> {
        let read = |board: &mut Board| {
            let now = board.arms.iter().map(|arm| arm.period).max().unwrap_or_default();
            board.sensors.get(name, now)
        };
        self.port.state(read).map_err(Hindrance)
    }

    /// Waits for a reading of a sensor, at most for `seconds` (s), and returns it.
    ///
    /// # Errors
    /// The reason why there is none, as in [`Robot::sensor`].
    pub async fn sense<R: DeserializeOwned>(
        &self,
        name: &str,
        seconds: f64,
    ) -> Result<R, Hindrance> {
        let mut waited = 0.0;
        loop {
            match self.sensor(name) {
                Err(_) if waited < seconds => {}
                read => return read,
            }
            self.pause(LOOK).await?;
            waited += LOOK;
        }
    }

    /// Returns whether a binary input was set at the last event; `None` if there is no such input.
    #[must_use]
    pub fn input(&self, input: Input) -> Option<bool> {
        self.port.state(|board| input.of(&board.arms))
    }

    /// Tells the operator something worth knowing.
    pub fn tell(&self, note: impl Into<String>) {
        self.port.state(|board| board.notes.push(Remark::Note(note.into())));
    }

    /// Tells the operator a deviation, such as a step that is tried again, and why.
    pub fn warn(&self, deviation: impl Into<String>) {
        self.port.state(|board| board.notes.push(Remark::Deviation(deviation.into())));
    }

    /// Shows a fact under this name in the user interfaces, from now on.
    pub fn show(&self, name: &str, fact: impl Serialize) {
        self.port.state(|board| board.facts.insert(name.to_owned(), value(fact)));
    }

    /// Puts a figure under this name into the summary of the run.
    pub fn report(&self, name: &str, figure: impl Serialize) {
        self.port.state(|board| board.figures.insert(name.to_owned(), value(figure)));
    }

    /// Has the run write a text file at its end. An existing file is not overwritten: see
    /// [`Document`].
    pub fn keep(&self, path: impl Into<PathBuf>, text: impl Into<String>) {
        let document = Document { path: path.into(), text: text.into() };
        self.port.state(|board| board.documents.push(document));
    }

    /// Has the journal say what the procedure is about to do, before its next action.
    pub fn note_progress(&self, doing: &str, over: bool) {
        let entry = Progress { doing: doing.to_owned(), over };
        self.port.state(|board| board.entry = Some(entry));
    }

    /// Begins a phase of the task.
    ///
    /// # Errors
    /// If the shell could not carry this out.
    pub async fn phase(&self, name: &'static str) -> Result<(), Hindrance> {
        self.done(Action::Phase(name)).await
    }

    /// Sets the force sensors of the marked effectors to zero where they are.
    ///
    /// # Errors
    /// If a sensor could not be set to zero.
    pub async fn bias(&self, which: Vec<bool>) -> Result<(), Hindrance> {
        self.done(Action::Bias(which)).await
    }

    /// Changes the tool frame of an effector to `flange_from_tool` (m). From now on its poses, its
    /// motions and its forces refer to this frame. The arm does not move.
    ///
    /// # Errors
    /// If the frame is not rigid, or the arm still moves.
    pub async fn set_tool(&self, effector: usize, flange_from_tool: Pose) -> Result<(), Hindrance> {
        self.adjust(effector, Adjustment::Tool(flange_from_tool)).await
    }

    /// Tells an effector the load in its gripper: its `weight` (N) and its `centre` of mass in the
    /// flange frame (m). The forces lose this weight from now on; a weight of 0 removes the load.
    ///
    /// # Errors
    /// If a number is not finite, the weight is negative, or the arm still moves.
    pub async fn set_load(
        &self,
        effector: usize,
        weight: f64,
        centre: Point3<f64>,
    ) -> Result<(), Hindrance> {
        self.adjust(effector, Adjustment::Load { weight, centre }).await
    }

    /// Ends the fault of an arm that has stopped while it carried out a programme. A limit switch
    /// that is still pressed stops the arm again when it moves.
    ///
    /// # Errors
    /// If the cause of the fault acts on, such as a pressed emergency stop.
    pub async fn reset(&self, effector: usize) -> Result<(), Hindrance> {
        self.adjust(effector, Adjustment::Reset).await
    }

    /// Requests an adjustment of an effector.
    async fn adjust(&self, effector: usize, adjustment: Adjustment) -> Result<(), Hindrance> {
        self.done(Action::Adjust { effector, adjustment }).await
    }

    /// Waits until a binary input is `set` or not, at most for `seconds` (s). Returns whether it
    /// came to that.
    ///
    /// # Errors
    /// If there is no such input.
    pub async fn wait_input(
        &self,
        input: Input,
        set: bool,
        seconds: f64,
    ) -> Result<bool, Hindrance> {
        let until = self.now() + seconds;
        loop {
            match self.input(input) {
                None => return Err(Hindrance(format!("there is no input {input:?}"))),
                Some(found) if found == set => return Ok(true),
                Some(_) if self.now() >= until => return Ok(false),
                Some(_) => {}
            }
            self.pause(LOOK).await?;
        }
    }

    /// Has one effector carry out a behaviour, and returns its outcome.
    ///
    /// # Errors
    /// If the behaviour was refused, or has ended with another alarm than [`Outcome::Lost`].
    pub async fn behave(
        &self,
        effector: usize,
        behaviour: Behaviour,
    ) -> Result<Outcome, Hindrance> {
        let orders = (0..=effector).map(|i| (i == effector).then(|| behaviour.clone())).collect();
        let outcomes = self.behave_all(orders, Until::All).await?;
        let outcome = outcomes.into_iter().flatten().next();
        outcome.ok_or_else(|| Hindrance("a motion has ended without an outcome".to_owned()))
    }

    /// Has one effector carry out a motion through free space. A motion that is refused, or that
    /// something stops, is tried again after a pause, at most `tries` times in all.
    ///
    /// # Errors
    /// The reason why the last try was stopped.
    pub async fn insist(
        &self,
        effector: usize,
        motion: Behaviour,
        tries: u32,
    ) -> Result<Outcome, Hindrance> {
        for _ in 1..tries {
            match self.behave(effector, motion.clone()).await {
                Err(why) => self.warn(format!("{why}; the motion is tried again")),
                outcome => return outcome,
            }
            self.pause(AGAIN).await?;
        }
        self.behave(effector, motion).await
    }

    /// Has the effectors carry out behaviours that begin together, one entry an effector. Returns
    /// their outcomes.
    ///
    /// # Errors
    /// If a behaviour was refused, or has ended with an alarm while no effector has lost what it
    /// carries. If one has ([`Outcome::Lost`]), the task decides what it means.
    pub async fn behave_all(
        &self,
        orders: Vec<Option<Behaviour>>,
        until: Until,
    ) -> Result<Vec<Option<Outcome>>, Hindrance> {
        match self.port.request(Action::Behave { orders, until }).await {
            Event::Behaved(outcomes) => {
                // An arm that still holds an object meets forces when the other one has lost it.
                let lost = outcomes.iter().flatten().any(|met| matches!(met, Outcome::Lost(_)));
                let mut met = outcomes.iter().enumerate();
                let alarm = met.find_map(|(arm, outcome)| {
                    let outcome = outcome.as_ref().filter(|met| !lost && met.alarms())?;
                    Some(Hindrance(format!("{outcome}{}", self.at_arm(arm))))
                });
                alarm.map_or(Ok(outcomes), Err)
            }
            event => Err(unexpected(&event)),
        }
    }

    /// Returns where something happened, for a message; empty in a cell of one arm.
    fn at_arm(&self, arm: usize) -> String {
        let which = ["first", "second", "third", "fourth"].get(arm);
        let several = self.port.state(|board| board.arms.len()) > 1;
        which.filter(|_| several).map_or_else(String::new, |which| format!(", at the {which} arm"))
    }

    /// Has the ECP of an effector begin a programme. The effector must not be ordered before the
    /// programme's end.
    ///
    /// # Errors
    /// If there is no such effector or programme, or the effector has a programme already.
    pub async fn start(&self, effector: usize, programme: Programme) -> Result<(), Hindrance> {
        self.done(Action::Start { effector, programme }).await
    }

    /// Sends a signal to the programme of an effector. In a programme the signal goes to MP, and
    /// `effector` has no effect.
    ///
    /// # Errors
    /// If the effector has no programme.
    pub async fn signal(&self, effector: usize, signal: Signal) -> Result<(), Hindrance> {
        self.done(Action::Signal { effector, signal }).await
    }

    /// Returns the time at the last event (s).
    #[must_use]
    pub fn now(&self) -> f64 {
        let period = |board: &mut Board| board.arms.first().map_or(0, |arm| arm.period);
        self.port.state(period) as f64 * PERIOD
    }

    /// Waits for `seconds` (s), which also brings new readings. A message that arrives meanwhile is
    /// kept for [`Robot::receive`].
    ///
    /// # Errors
    /// If the shell could not carry this out.
    pub async fn pause(&self, seconds: f64) -> Result<(), Hindrance> {
        let (until, mut left) = (self.now() + seconds, seconds);
        while let Some(message) = self.next_message(left).await? {
            self.port.state(|board| board.early.push_back(message));
            left = until - self.now();
            if left <= 0.0 {
                break;
            }
        }
        Ok(())
    }

    /// Waits for the next message, at most for `seconds` (s).
    ///
    /// # Errors
    /// If the shell could not carry this out.
    pub async fn receive(&self, seconds: f64) -> Result<Option<Message>, Hindrance> {
        match self.port.state(|board| board.early.pop_front()) {
            Some(message) => Ok(Some(message)),
            None => self.next_message(seconds).await,
        }
    }

    /// Waits for the next message of the shell, at most for `seconds` (s).
    async fn next_message(&self, seconds: f64) -> Result<Option<Message>, Hindrance> {
        match self.port.request(Action::Receive(seconds)).await {
            Event::Received(message) => Ok(message),
            event => Err(unexpected(&event)),
        }
    }

    /// Requests an action that has no result.
    async fn done(&self, action: Action<()>) -> Result<(), Hindrance> {
        match self.port.request(action).await {
            Event::Done => Ok(()),
            event => Err(unexpected(&event)),
        }
    }
}

/// Returns the hindrance of an event that is not the expected one.
fn unexpected(event: &Event<()>) -> Hindrance {
    match event {
        Event::Trouble(reason) => Hindrance(reason.clone()),
        other => Hindrance(format!("unexpected answer of the shell: {other:?}")),
    }
}

/// Returns a value as JSON; its error in words if it has no such form.
fn value(of: impl Serialize) -> Value {
    serde_json::to_value(of).unwrap_or_else(|why| Value::String(why.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::Kernel as _;
    use crate::motion::JointPositions;

    /// Gives the kernel an event at this period, and returns its action.
    fn next(kernel: &mut RobotKernel, period: u64, event: Event<()>) -> Action<()> {
        let arms = [ArmState { period, ..ArmState::default() }];
        let (forces, sensors) = (Forces::default(), SensorReadings::default());
        kernel.next(event, &Readings { arms: &arms, forces: &forces, sensors: &sensors })
    }

    /// Returns the end with this reason.
    fn end(achieved: bool, reason: &str) -> Action<()> {
        Action::Finish(Finish { achieved, reason: reason.to_owned() })
    }

    /// A message shortens no pause, and waits for its receiver.
    #[test]
    fn pause_keeps_message_for_its_receiver() {
        let mut kernel = Robot::kernel(|robot| async move {
            robot.pause(1.0).await?;
            match robot.receive(9.0).await? {
                Some(Message::Signal { signal, .. }) => Ok(signal.name),
                other => Err(Hindrance(format!("{other:?}"))),
            }
        });

        assert_eq!(next(&mut kernel, 0, Event::Start), Action::Receive(1.0));
        let message = Message::Signal { effector: 0, signal: Signal::new("go") };
        let rest = next(&mut kernel, 100, Event::Received(Some(message)));
        assert!(matches!(rest, Action::Receive(left) if (left - 0.8).abs() < 1e-9), "{rest:?}");
        assert_eq!(next(&mut kernel, 500, Event::Received(None)), end(true, "go"));
    }

    /// The arm that still holds an object meets a force in the step in which the other one loses
    /// it.
    #[test]
    fn lost_object_comes_before_force_at_partner() {
        let mut kernel = Robot::kernel(|robot| async move {
            let outcomes = robot.behave_all(vec![None; 2], Until::All).await?;
            Ok(format!("{outcomes:?}"))
        });
        let both = vec![Some(Outcome::OverForce(2, 30.0)), Some(Outcome::Lost(0.04))];
        let told = format!("{both:?}");

        assert!(matches!(next(&mut kernel, 0, Event::Start), Action::Behave { .. }));
        assert_eq!(next(&mut kernel, 0, Event::Behaved(both)), end(true, &told));
    }

    #[test]
    fn stopped_motion_begins_again_until_tries_end() {
        let target = JointPositions::default();
        let motion = Behaviour::Joints { target, speed: 0.5, seconds: 0.0 };
        let stopped = || Event::Behaved(vec![Some(Outcome::OverForce(2, 30.0))]);
        let begin = |kernel: &mut RobotKernel| {
            assert!(matches!(next(kernel, 0, Event::Start), Action::Behave { .. }));
            assert_eq!(next(kernel, 0, stopped()), Action::Receive(AGAIN));
            assert!(kernel.notes()[0].text().ends_with("the motion is tried again"));
            assert!(matches!(next(kernel, 500, Event::Received(None)), Action::Behave { .. }));
        };
        let tries_twice = || {
            let motion = motion.clone();
            Robot::kernel(|robot| async move {
                robot.insist(0, motion, 2).await.map(|outcome| format!("{outcome:?}"))
            })
        };

        let mut kernel = tries_twice();
        begin(&mut kernel);
        let reached = Event::Behaved(vec![Some(Outcome::Reached)]);
        assert_eq!(next(&mut kernel, 600, reached), end(true, "Reached"));
        let mut kernel = tries_twice();
        begin(&mut kernel);
        assert_eq!(
            next(&mut kernel, 600, stopped()),
            end(false, &Outcome::OverForce(2, 30.0).to_string())
        );
    }
}
