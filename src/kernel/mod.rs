//! The interface between MP, which is a shell, and the kernel of a task: event -> next action.
//!
//! A kernel is pure: poses, wrenches and reach come to it as data. One kernel serves both
//! coordination schemes, because it orders behaviours. The shells decide where the generators of a
//! behaviour run: in MP at each macrostep, or in the ECPs.
//!
//! - `mod`: the trait [`Kernel`], actions and events
//! - [`procedure`]: kernels that are written as procedures
//! - [`message`]: the end of a task, and what MP and its ECPs tell each other
//! - [`programme`]: kernels of the ECPs
//! - [`robot`]: the port of a procedure without long work, for most tasks
//! - [`sensor`]: readings of a user's own sensors

pub mod message;
pub mod procedure;
pub mod programme;
pub mod robot;
pub mod sensor;

use crate::cube::{Face, Facelets};
use crate::generators::{Behaviour, Outcome};
use crate::motion::ArmState;
use crate::operator::{Answer, Manual, Net, PlanLine, Question};
use crate::spatial::Pose;
use crate::vision::sensor::FaceReading;
pub use message::{Adjustment, Finish, Input, Message, Programme, Signal};
use nalgebra::UnitQuaternion;
use sensor::SensorReadings;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Debug;
use std::path::PathBuf;
use std::sync::Arc;

/// A kernel of MP: it decides what the effectors do next.
pub trait Kernel: Send {
    /// Input of the long work that the shell does for the kernel beside the motions; `()` for a
    /// kernel without long work.
    type Thought: Thought;
    /// Entry in the journal; [`Progress`] for a kernel that has none, or nothing more to keep.
    type Entry: JournalEntry;

    /// Returns the next action after an event. `readings` is the state of the cell at that time.
    fn next(
        &mut self,
        event: Event<ConclusionOf<Self>>,
        readings: &Readings<'_>,
    ) -> Action<Self::Thought>;

    /// Returns the messages to the operator since the last call, such as which step is repeated and
    /// why.
    fn notes(&mut self) -> Vec<Remark> {
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

    /// Returns the kernel's account of the task for the summary of the run, as it believes.
    fn account(&self) -> Account {
        Account::default()
    }

    /// Corrects the account after an error has ended the run. `arms` are the states of the
    /// effectors once they are at rest, in the scenario's order.
    fn look_back(&mut self, arms: &[ArmState]) {
        let _ = arms;
    }
}

/// Long work of a kernel, such as the search for a plan: plain data, from which a pure function
/// makes a result.
pub trait Thought: Debug + Clone + Send + 'static {
    /// Result of the work; plain data.
    type Conclusion: Debug + Send + 'static;

    /// Does the work, and returns the result with its declared duration.
    fn think(self) -> (Self::Conclusion, Effort);
}

impl Thought for () {
    type Conclusion = ();

    fn think(self) -> ((), Effort) {
        ((), Effort(0.0))
    }
}

/// Result of the long work of the kernel `K`.
pub type ConclusionOf<K> = <<K as Kernel>::Thought as Thought>::Conclusion;

/// Account of a kernel at the end of a run, as it believes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Account {
    /// Place of what the task handles, in words, such as "the track hand holds the cube"; empty if
    /// nothing is known.
    pub whereabouts: String,
    /// Figures for the summary, by name.
    pub figures: BTreeMap<String, Value>,
    /// Text files that the task has made, for the run to write at its end.
    pub documents: Vec<Document>,
}

/// Message of a kernel to the operator.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Remark {
    /// Something worth knowing.
    Note(String),
    /// A deviation: a step that is retried, given up, or started over.
    Deviation(String),
}

impl Remark {
    /// Returns the message.
    #[must_use]
    pub fn text(&self) -> &str {
        match self {
            Self::Note(text) | Self::Deviation(text) => text,
        }
    }
}

/// Text file that a task makes. A kernel is pure, so the run writes it, and a replay does not.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Document {
    /// Path of the file. An existing file stays as it is: the text goes to a free name beside it.
    pub path: PathBuf,
    /// Content.
    pub text: String,
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
    /// Latest readings of the sensors that the actor of the kernel owns.
    pub sensors: &'a SensorReadings,
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

/// State of the task as a kernel believes it, for display: the cube and the plan, and facts of any
/// other kind.
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
    /// Facts that the user interfaces show as a table, by name.
    pub facts: BTreeMap<String, Value>,
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
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
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
    /// An effector is adjusted at rest. The change is refused for an arm that moves or carries out
    /// a programme, and for a tool frame that is not rigid.
    Adjust {
        /// Effector.
        effector: usize,
        /// The change.
        adjustment: Adjustment,
    },
    /// The stand-alone camera's sensor begins (`true`) or stops (`false`) watching for the cube.
    Watch(bool),
    /// The camera in an effector's hand reads one face.
    Look {
        /// Effector that owns the camera.
        effector: usize,
        /// Expected pose of the face, and exposure.
        view: View,
    },
    /// The shell does long work: see [`Thought::think`].
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
    /// The ECP of an effector begins a programme. It runs beside the kernel of MP, which must not
    /// order this effector before the programme's end.
    Start {
        /// Effector.
        effector: usize,
        /// The programme.
        programme: Programme,
    },
    /// MP sends a signal to the programme of an effector, or a programme sends one to MP.
    Signal {
        /// Effector whose programme gets the signal; a programme's signals go to MP.
        effector: usize,
        /// The signal.
        signal: Signal,
    },
    /// The kernel waits for the next message, at most for this time (s). MP waits for signals and
    /// ends of programmes, a programme for signals of MP.
    Receive(f64),
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
    /// The next message; `None` if none came in time.
    Received(Option<Message>),
    /// An effector or sensor could not carry out the action; the text names it and the reason.
    Trouble(String),
}
