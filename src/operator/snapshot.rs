//! The controller's belief at one moment, for whoever shows it.

use super::Question;
use crate::motion::AXES;
use crate::spatial::Pose;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Everything that changes in a run. Whoever cannot keep up drops snapshots; only [`Snapshot::messages`] are counted
/// through, by [`Message::number`].
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Snapshot {
    /// Grows by one with each.
    pub number: u64,
    /// Simulated or real time since the start (s).
    pub time: f64,
    /// How fast time goes, in times of real time.
    pub factor: f64,
    /// The limit of that which the operator has set; 0 for none.
    pub speed: f64,
    /// What the operator wants of the run, and whether it is over.
    pub control: ControlView,
    /// Phase of the task.
    pub phase: String,
    /// All phases so far, each with the time at which it began (s).
    pub phases: Vec<(String, f64)>,
    /// Every actor.
    pub actors: Vec<ActorView>,
    /// Every effector, in the scenario's order.
    pub arms: Vec<ArmView>,
    /// The cube.
    pub cube: CubeView,
    /// The operator's hand with the cube, while the stand-alone camera sees it.
    pub hand: Option<HandView>,
    /// Every camera, in the scenario's order.
    pub cameras: Vec<CameraView>,
    /// The cube's net as it was read.
    pub net: Net,
    /// The plan; empty before there is one.
    #[serde(with = "shared")]
    pub plan: Arc<Vec<PlanLine>>,
    /// The line of the plan that is being carried out.
    pub step: Option<usize>,
    /// How punctual the servo is; real-time runs only.
    pub servo: Option<ServoTiming>,
    /// The question that waits for an answer.
    pub question: Option<Question>,
    /// What is possible now.
    pub services: Services,
    /// The latest messages, oldest first.
    #[serde(with = "shared")]
    pub messages: Arc<Vec<Message>>,
    /// How the run ended.
    pub outcome: Option<OutcomeView>,
}

/// An `Arc` is written as what it holds.
mod shared {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};
    use std::sync::Arc;

    pub(super) fn serialize<T: Serialize, S: Serializer>(
        value: &Arc<T>,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        value.as_ref().serialize(to)
    }

    pub(super) fn deserialize<'de, T: Deserialize<'de>, D: Deserializer<'de>>(
        from: D,
    ) -> Result<Arc<T>, D::Error> {
        T::deserialize(from).map(Arc::new)
    }
}

/// Where a run stands in the operator's hands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ControlView {
    /// Not started yet.
    #[default]
    Waiting,
    /// Goes on.
    Running,
    /// Holds where it is.
    Paused,
    /// Comes to its end.
    Terminated,
    /// Is over; see [`Snapshot::outcome`].
    Ended,
}

/// What an actor is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Not created yet, or gone.
    Absent,
    /// Of an EDP: its axes do not know where they are.
    NotSynchronised,
    /// Waits for somebody's word.
    Idle,
    /// Works.
    Running,
    /// Of an effector: holds its place. Of others: paused.
    Held,
    /// Stopped by a fault.
    Fault,
}

/// An actor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ActorView {
    /// "ui", "mp", "ecp track", "edp track", "vsp mpc".
    pub name: String,
    /// What it is doing.
    pub state: State,
    /// The same in words; may be empty.
    pub words: String,
}

/// An effector.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ArmView {
    /// Name in the scenario.
    pub name: String,
    /// Measured joints: the track d0 (m), q1..q6 (rad).
    pub joints: [f64; AXES],
    /// Measured motor angles (rad).
    pub motors: [f64; AXES],
    /// Frames in the world, in the order of [`FRAMES`](super::FRAMES): what [`Stage::solids`](super::Stage::solids)
    /// hang on. The controller's belief of where the base stands included.
    pub frames: Vec<Pose>,
    /// Measured distance between the pads (m).
    pub opening: f64,
    /// Force that the jaw's current stands for (N).
    pub grip: f64,
    /// What the tool exerts on its surroundings, at the tool in tool axes: force (N), torque (Nm).
    pub wrench: [f64; 6],
    /// Largest norms of force (N) and torque (Nm) since the last snapshot: what falls between
    /// snapshots is not lost.
    pub peak: (f64, f64),
    /// Distance between set and measured place of the tool (m), the largest since the last
    /// snapshot.
    pub following: f64,
    /// Whether its axes know where they are.
    pub synchronised: bool,
    /// Why it has stopped.
    pub fault: Option<String>,
    /// What is to be done about that.
    pub remedy: Option<String>,
}

/// Where the cube is believed to be, and how it looks.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct CubeView {
    /// Pose of its body; `None` while nobody knows.
    pub world_from_cube: Option<Pose>,
    /// Effectors that hold it.
    pub held_by: Vec<usize>,
    /// Who has it, in words.
    pub with: String,
    /// Colours of the 54 facelets in the order URFDLB as letters, `-` where unknown.
    pub facelets: String,
    /// The layer that is being turned.
    pub turned: Option<LayerTurn>,
}

/// A layer that stands at an angle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LayerTurn {
    /// Its face, 0..=5 = URFDLB.
    pub face: usize,
    /// How far it is turned from where [`CubeView::facelets`] has it, clockwise seen from outside
    /// (rad).
    pub angle: f64,
}

/// The cube in the operator's hand, as the stand-alone camera sees it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HandView {
    /// Pose of the cube.
    pub world_from_cube: Pose,
    /// Speed of its centre (m/s).
    pub speed: f64,
    /// Time since the exposure (s).
    pub age: f64,
}

/// A camera's latest picture and what vision found in it. The pixels come apart, by [`CameraView::frame`].
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct CameraView {
    /// Name in the scenario.
    pub name: String,
    /// Number of the picture, from 1; 0 before the first.
    pub frame: u64,
    /// Time of the exposure (s).
    pub time: f64,
    /// Columns and rows.
    pub size: (u32, u32),
    /// Closed outlines (px): what was localised.
    pub outlines: Vec<Vec<(f64, f64)>>,
    /// Tiles that were read.
    pub marks: Vec<Mark>,
    /// What was found, or why nothing was.
    pub words: String,
    /// Whether something was found.
    pub found: bool,
}

/// A tile in a picture.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Mark {
    /// Its centre (px).
    pub at: (f64, f64),
    /// Its colour, 0..=5 = white, red, green, yellow, orange, blue; `None` where something covers it.
    pub colour: Option<u8>,
    /// How sure, 0..=1.
    pub confidence: f64,
}

/// The cube's net.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Net {
    /// 54 facelets in the order URFDLB, each face in reading order; empty before the first look.
    pub facelets: Vec<Option<Reading>>,
    /// Whether the whole cube has been decided, not only face by face.
    pub decided: bool,
}

/// A facelet as read.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// Colour, 0..=5 = white, red, green, yellow, orange, blue.
    pub colour: u8,
    /// How sure, 0..=1.
    pub confidence: f64,
}

/// A step of the plan, for people.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlanLine {
    /// What is done.
    pub what: String,
    /// Why.
    pub why: String,
    /// Planned time (s).
    pub seconds: f64,
}

/// How punctual the servo's thread has been since the last snapshot.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct ServoTiming {
    /// Length of a period (s).
    pub period: f64,
    /// Largest lateness of a period's beginning (s).
    pub late: f64,
    /// Largest work of a period (s).
    pub work: f64,
    /// Grid points missed since the start.
    pub missed: u64,
}

/// What the operator can ask for now, beside pause and terminate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Services {
    /// Arms can be moved by hand: the task is idle.
    pub manual: bool,
    /// Time can be slowed down: it is simulated.
    pub speed: bool,
    /// Time can be sought: it is a replay. Its length (ms).
    pub seek_ms: Option<u64>,
}

/// How grave a message is; the last three are the paper's classes of errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Class {
    /// Worth knowing.
    Info,
    /// Worth a thought.
    Warning,
    /// A failed computation, or wrong arguments: the asker may go on.
    NonFatal,
    /// Malfunction of an effector.
    Fatal,
    /// Trouble with messages or actors.
    System,
}

/// A line of the console.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Message {
    /// From 1, without gaps.
    pub number: u64,
    /// When (s).
    pub time: f64,
    /// How grave.
    pub class: Class,
    /// Which actor.
    pub source: String,
    /// What.
    pub text: String,
}

/// How a run ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OutcomeView {
    /// "solved", "done", "failed", "aborted".
    pub verdict: String,
    /// Whether it is what was wanted.
    pub good: bool,
    /// Why, in a sentence.
    pub reason: String,
    /// When the work was over (s), where that is known: the arms hold on after it.
    pub time: Option<f64>,
    /// Figures: name and value.
    pub figures: Vec<(String, String)>,
}
