//! The controller's belief at one moment, as a user interface (UI) shows it. The poses of loose
//! objects alone are the simulated plant's truth.

use super::Question;
use crate::motion::AXES;
use crate::spatial::Pose;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::sync::Arc;

/// All data that change in a run. A slow UI misses snapshots, but each message has a number without
/// gaps ([`Message::number`]), so that the UI can tell which ones are new.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Snapshot {
    /// Number of the snapshot: one more than that of the snapshot before.
    pub number: u64,
    /// Simulated or real time since the start (s).
    pub time: f64,
    /// Present speed of the run's time as a multiple of real time.
    pub factor: f64,
    /// Limit of that speed as the operator has set it; 0 for none.
    pub speed: f64,
    /// State of the run under the operator's control.
    pub control: ControlView,
    /// Phase of the task.
    pub phase: String,
    /// All phases up to now, each with the time at which it began (s).
    pub phases: Vec<(String, f64)>,
    /// All actors.
    pub actors: Vec<ActorView>,
    /// All effectors, in the scenario's order.
    pub arms: Vec<ArmView>,
    /// Place and appearance of the cube.
    pub cube: CubeView,
    /// Poses in the world of the loose objects beside the cube, by name. They are the truth of the
    /// simulated plant, since no controller knows them; empty on hardware.
    #[serde(default)]
    pub objects: BTreeMap<String, Pose>,
    /// Cube in the operator's hand, while the stand-alone camera sees it.
    pub hand: Option<HandView>,
    /// All cameras, in the scenario's order.
    pub cameras: Vec<CameraView>,
    /// Net of the cube as it was read.
    pub net: Net,
    /// Plan of the task; empty before there is one.
    #[serde(with = "shared")]
    pub plan: Arc<Vec<PlanLine>>,
    /// Index of the plan's line that is being executed; `None` before there is a plan.
    pub step: Option<usize>,
    /// Facts of the task that the page shows as a table, by name.
    #[serde(default)]
    pub facts: BTreeMap<String, Value>,
    /// Timing of the servo; only in real-time runs.
    pub servo: Option<ServoTiming>,
    /// Question that waits for an answer.
    pub question: Option<Question>,
    /// Inputs that are possible now.
    pub services: Services,
    /// Parameters, in the order of [`Stage::parameters`](super::Stage::parameters).
    #[serde(default)]
    pub parameters: Vec<ParameterView>,
    /// Latest messages, oldest first.
    #[serde(with = "shared")]
    pub messages: Arc<Vec<Message>>,
    /// Verdict on the run and its figures; `None` before the run is over.
    pub outcome: Option<OutcomeView>,
}

/// Serialisation of an `Arc` as the value that it holds.
mod shared {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};
    use std::sync::Arc;

    // Serde derives this only with its feature `rc`, which no other type needs.
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

/// A parameter that the operator may change while a run goes on, in its unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ParameterView {
    /// Present value.
    pub value: f64,
    /// Ordered value, toward which the present one moves.
    pub ordered: f64,
}

/// State of a run under the operator's control.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ControlView {
    /// The run has not started yet.
    #[default]
    Waiting,
    /// The run executes its task.
    Running,
    /// The run is paused; the arms hold their places.
    Paused,
    /// The operator has terminated the run; the arms come to rest.
    Terminated,
    /// The run is over; see [`Snapshot::outcome`].
    Ended,
}

/// State of an actor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// The actor is not created yet, or gone.
    Absent,
    /// The axes of an EDP (effector driver process) are not synchronised.
    NotSynchronised,
    /// The actor waits for a message.
    Idle,
    /// The actor works.
    Running,
    /// The actor is paused; an effector holds its place.
    Held,
    /// The actor is stopped by a fault.
    Fault,
}

/// An actor and its state.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ActorView {
    /// Name of the actor: "ui", "mp", "ecp track", "edp track", "vsp mpc".
    pub name: String,
    /// State of the actor.
    pub state: State,
    /// Activity of the actor in words; may be empty.
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
    /// Frames of the arm in the world, in the order of [`FRAMES`](super::FRAMES). The
    /// [`Stage::solids`](super::Stage::solids) are attached to them. The base is where the
    /// controller believes it.
    pub frames: Vec<Pose>,
    /// Measured distance between the pads (m).
    pub opening: f64,
    /// Gripping force that corresponds to the jaw's current (N).
    pub grip: f64,
    /// Wrench that the tool exerts on its surroundings, about the tool point in tool axes: force
    /// (N), torque (Nm).
    pub wrench: [f64; 6],
    /// Largest norms of force (N) and torque (Nm) since the last snapshot, so that no short peak is
    /// lost between two snapshots.
    pub peak: (f64, f64),
    /// Largest distance between set and measured place of the tool since the last snapshot (m).
    pub following: f64,
    /// Whether the axes are synchronised.
    pub synchronised: bool,
    /// Fault that has stopped the arm; `None` if it has not stopped.
    pub fault: Option<String>,
    /// Instruction for a person after that fault.
    pub remedy: Option<String>,
}

/// Believed place and appearance of the cube.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct CubeView {
    /// Pose of the cube in the world; `None` while it is unknown.
    pub world_from_cube: Option<Pose>,
    /// Indices of the effectors that hold the cube.
    pub held_by: Vec<usize>,
    /// Holder of the cube, in words.
    pub with: String,
    /// Colours of the 54 facelets in the order URFDLB as letters, `-` where unknown.
    pub facelets: String,
    /// Layer that is being turned; `None` if none is.
    pub turned: Option<LayerTurn>,
}

/// A layer that is turned by an angle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LayerTurn {
    /// Face of the layer, 0..=5 = URFDLB.
    pub face: usize,
    /// Angle of the layer against [`CubeView::facelets`], clockwise seen from outside (rad).
    pub angle: f64,
}

/// The cube in the operator's hand, as the stand-alone camera sees it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HandView {
    /// Pose of the cube.
    pub world_from_cube: Pose,
    /// Speed of its centre (m/s).
    pub speed: f64,
    /// Time since the exposure of the picture (s).
    pub age: f64,
}

/// Latest picture of a camera, and what vision found in it. The pixels are sent separately, under
/// the number [`CameraView::frame`].
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct CameraView {
    /// Name in the scenario.
    pub name: String,
    /// Number of the picture, from 1; 0 before the first.
    pub frame: u64,
    /// Time of the exposure (s).
    pub time: f64,
    /// Size of the picture, columns and rows (px).
    pub size: (u32, u32),
    /// Outlines of the faces that were localised: closed polygons, column and row (px).
    pub outlines: Vec<Vec<(f64, f64)>>,
    /// Tiles (stickers in the picture) that were read.
    pub marks: Vec<Mark>,
    /// Description of the result, or the reason why there is none.
    pub words: String,
    /// Whether the picture shows what the camera looks for.
    pub found: bool,
}

/// A tile in a picture.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Mark {
    /// Centre of the tile (px).
    pub at: (f64, f64),
    /// Colour, 0..=5 = white, red, green, yellow, orange, blue; `None` where something covers it.
    pub colour: Option<u8>,
    /// Confidence of the colour, 0..=1.
    pub confidence: f64,
}

/// Net of the cube.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Net {
    /// 54 facelets in the order URFDLB, each face in reading order; empty before the first look.
    pub facelets: Vec<Option<Reading>>,
    /// Whether the colours were decided for the whole cube together, not only face by face.
    pub decided: bool,
}

/// A facelet as it was read.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// Colour, 0..=5 = white, red, green, yellow, orange, blue.
    pub colour: u8,
    /// Confidence of the colour, 0..=1.
    pub confidence: f64,
}

/// A step of the plan, for people.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlanLine {
    /// Action of the step.
    pub what: String,
    /// Reason for the step.
    pub why: String,
    /// Planned time (s).
    pub seconds: f64,
}

/// Timing of the servo's thread since the last snapshot.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct ServoTiming {
    /// Length of a period (s).
    pub period: f64,
    /// Greatest lateness of a period's beginning (s).
    pub late: f64,
    /// Longest computation of a period (s).
    pub work: f64,
    /// Number of servo periods that were missed since the start.
    pub missed: u64,
}

/// Inputs that are possible now, beside pause and terminate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Services {
    /// Whether arms can be moved by hand, because the task is idle.
    pub manual: bool,
    /// Whether the speed of time can be limited, because time is simulated.
    pub speed: bool,
    /// Whether parameters can be changed.
    #[serde(default)]
    pub parameters: bool,
    /// Length of the replay, whose times can be jumped to (ms); `None` if this is no replay.
    pub seek_ms: Option<u64>,
    /// Ways on after a run; `None` while it goes on, and where the program ends with the run.
    #[serde(default)]
    pub after: Option<After>,
}

/// Ways on after a run, beside another run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct After {
    /// Seed of the run that is over.
    pub seed: u64,
    /// Whether the run can be continued from its journal.
    pub resumes: bool,
    /// Whether there is a recording, for a replay and a report.
    pub recorded: bool,
}

/// Severity of a message. The last three are the classes of errors of Zieliński et al. (2007).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Class {
    /// Information without a consequence.
    Info,
    /// Warning.
    Warning,
    /// Failed computation or wrong arguments. The sender of the request may continue.
    NonFatal,
    /// Malfunction of an effector.
    Fatal,
    /// Failure of messages or actors.
    System,
}

/// A line of the console.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Message {
    /// Number of the message, from 1, without gaps.
    pub number: u64,
    /// Time of the run (s).
    pub time: f64,
    /// Severity.
    pub class: Class,
    /// Actor that sent the message.
    pub source: String,
    /// Text of the message.
    pub text: String,
}

/// End of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OutcomeView {
    /// Verdict: "solved", "done", "failed", "aborted".
    pub verdict: String,
    /// Whether the run reached its goal.
    pub good: bool,
    /// Reason of the verdict, in a sentence.
    pub reason: String,
    /// Time at which the work was done (s), where it is known. The arms hold their places after it.
    pub time: Option<f64>,
    /// Figures of the run, name and value.
    pub figures: Vec<(String, String)>,
}
