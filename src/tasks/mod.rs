//! The tasks: kernels of MP, one folder a task. A kernel is pure: event -> next action.
//!
//! A task imports neither `hw` nor `kinematics`: poses, wrenches and reach come to it as data. One
//! kernel serves both coordination schemes, because it orders behaviours. The shells decide where
//! the generators of a behaviour run: in MP at each macrostep, or in the ECPs.

pub mod cube;
pub mod idle;
pub mod panel;
pub mod procedure;

use crate::cube::{Face, Facelets};
use crate::generators::{Behaviour, Outcome};
use crate::motion::ArmState;
use crate::operator::{Answer, Manual, Net, PlanLine, Question};
use crate::spatial::Pose;
use crate::vision::sensor::FaceReading;
use nalgebra::UnitQuaternion;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::fmt::Debug;
use std::sync::Arc;

/// A kernel of MP.
pub trait Task: Send {
    /// Input of the long work that the shell does for the kernel beside the motions; plain data.
    type Thought: Debug + Clone + Send + 'static;
    /// Result of the long work; plain data.
    type Conclusion: Debug + Send + 'static;
    /// Entry in the journal; [`Progress`] for a task that has none, or nothing more to keep.
    type Entry: JournalEntry;

    /// Returns the next action after an event. `readings` is the state of the cell at that time.
    fn next(
        &mut self,
        event: Event<Self::Conclusion>,
        readings: &Readings<'_>,
    ) -> Action<Self::Thought>;

    /// Returns the messages to the operator since the last call, such as which step is repeated and
    /// why.
    fn notes(&mut self) -> Vec<String> {
        Vec::new()
    }

    /// Returns the kernel's present belief for display. The call has no effect on the task.
    fn picture(&self) -> Option<Picture> {
        None
    }

    /// Returns the journal entry that must be on disk before the action that `next` has just
    /// returned is carried out, so that another run can continue from there.
    fn entry(&self) -> Option<Self::Entry> {
        None
    }

    /// Does the long computation that the kernel requested, and returns the result with its
    /// declared duration. It is a pure function of its argument.
    fn think(thought: Self::Thought) -> (Self::Conclusion, Effort);
}

/// State from which a run continues a task that another run left unfinished, as the journal keeps
/// it: a JSON object whose first key is `doing`.
pub trait JournalEntry: Serialize + DeserializeOwned + Debug + Send + 'static {
    /// Returns a description of the action that is about to begin, the value of `doing`.
    fn doing(&self) -> &str;

    /// Returns whether the task is finished.
    fn is_over(&self) -> bool;

    /// Checks whether a run can have written these values. A run that continues moves the arms by
    /// them.
    ///
    /// # Errors
    /// The reason why no run can.
    fn check(&self) -> Result<(), &'static str> {
        Ok(())
    }
}

/// The part of a journal's entry that all tasks share; the whole entry of a task without more to
/// keep.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Description of the action that is about to begin.
    pub doing: String,
    /// Whether the task is finished.
    pub over: bool,
}

impl JournalEntry for Progress {
    fn doing(&self) -> &str {
        &self.doing
    }

    fn is_over(&self) -> bool {
        self.over
    }
}

/// State of the cell as MP knows it when a kernel decides.
#[derive(Debug, Clone, Copy)]
pub struct Readings<'a> {
    /// Present states of the effectors, in the scenario's order.
    pub arms: &'a [ArmState],
    /// Forces at the wrists as their VSP aggregates them.
    pub forces: &'a Forces,
}

/// Wrist forces of all effectors, as the VSP of the forces aggregates them. Empty without this VSP.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Forces {
    /// One entry an effector, in the scenario's order.
    pub arms: Vec<WristLoad>,
}

/// Force and torque at one wrist, as norms at the tool.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WristLoad {
    /// Force now (N).
    pub force: f64,
    /// Torque now (Nm).
    pub torque: f64,
    /// Largest force since the start (N).
    pub peak_force: f64,
    /// Largest torque since the start (Nm).
    pub peak_torque: f64,
}

/// State of the cube as a kernel believes it, and the plan.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Picture {
    /// Believed poses of the effectors' bases, where the task has estimated them.
    pub world_from_base: [Option<Pose>; 2],
    /// The cube in each hand that holds it.
    pub tool_from_cube: [Option<Pose>; 2],
    /// Whether the operator has been given the cube back.
    pub handed_back: bool,
    /// Colours of the cube, as far as it has been read and turned.
    pub facelets: Option<Facelets>,
    /// The layer that is being turned.
    pub turning: Option<Turning>,
    /// The cube as it was read.
    pub net: Net,
    /// The plan.
    pub plan: Arc<Vec<PlanLine>>,
    /// Number of the plan's step that is being carried out.
    pub step: Option<usize>,
}

/// A layer that turns together with a hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turning {
    /// The effector that turns it.
    pub effector: usize,
    /// The layer's face.
    pub face: Face,
    /// Orientation of the tool on the cube when the layer was straight.
    pub cube_from_tool: UnitQuaternion<f64>,
}

/// How a camera in a hand looks at one face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Expected pose of the face: origin in its centre, x to the next column, y to the next row in
    /// reading order.
    pub camera_from_face: Pose,
    /// Exposure, as a multiple of the camera's nominal one.
    pub exposure: f64,
}

/// Declared duration of a piece of long work on the virtual clock (s). The kernel declares it; it
/// is never measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Effort(pub f64);

/// Request of a kernel to its shell.
#[derive(Debug, Clone, PartialEq)]
pub enum Action<T> {
    /// A new phase of the task begins; nothing moves for it.
    Phase(&'static str),
    /// Effectors carry out behaviours, starting together.
    Behave {
        /// One entry an effector, in the scenario's order; `None` leaves it as it is.
        orders: Vec<Option<Behaviour>>,
        /// Effectors whose behaviours must end before the step ends; the shell then ends the
        /// behaviours of the others.
        until: Until,
    },
    /// The force sensors of the marked effectors are set to zero where they are.
    Bias(Vec<bool>),
    /// The stand-alone camera's sensor begins (`true`) or stops (`false`) watching for the cube.
    Watch(bool),
    /// The camera in an effector's hand reads one face.
    Look {
        /// Effector that owns the camera.
        effector: usize,
        /// Expected pose of the face, and exposure.
        view: View,
    },
    /// The shell does long work: see [`Task::think`].
    Think(T),
    /// The operator is asked a question.
    Ask(Question),
    /// The shell waits for the operator's next order to an arm, while all arms hold their places.
    Await,
    /// The shell carries out an order of the operator for which there is no behaviour: a motor's
    /// motion, or synchronising.
    Manual {
        /// Effector that the order is for.
        effector: usize,
        /// The order.
        order: Manual,
    },
    /// The task is over.
    Finish(Finish),
    /// The kernel waits although it has asked for nothing, which is a defect of the task.
    Defect(String),
}

/// Effectors whose behaviours must end before the step ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Until {
    /// All effectors that have an order.
    All,
    /// This effector. Once its behaviour has ended, the shell ends the behaviours of the others.
    Effector(usize),
}

/// Message of the shell to its kernel.
#[derive(Debug)]
pub enum Event<C> {
    /// The run begins.
    Start,
    /// The last action was carried out, and has no result.
    Done,
    /// Behaviours ended, each with its outcome. One entry an order; `None` for an effector without
    /// one.
    Behaved(Vec<Option<Outcome>>),
    /// A face was read, or the text says why it was not.
    Looked(Result<FaceReading, String>),
    /// The long work is done, with this result.
    Thought(C),
    /// The operator has answered; `None` when no answer came in time.
    Answered(Option<Answer>),
    /// The operator gives this order to the effector with this index.
    Ordered(usize, Manual),
    /// An effector or sensor could not carry out the action; the text names it and the reason.
    Trouble(String),
}

/// The end of a task, as the controller sees it. The plant decides whether the cube is solved.
#[derive(Debug, Clone, PartialEq)]
pub struct Finish {
    /// Whether the controller believes that the task is achieved.
    pub achieved: bool,
    /// Reason of the end, in words.
    pub reason: String,
}
