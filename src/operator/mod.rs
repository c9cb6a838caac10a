//! The operator's vocabulary: plain data that a user interface shows, and inputs that it may send.
//! The page, the terminal, the keys on stdin and a replayed recording share these types.
//!
//! - [`Stage`]: the data that do not change in a run (solids, names, limits); sent once
//! - [`Snapshot`]: the controller's *belief* at one moment; only the poses of loose objects in it
//!   are the plant's truth, and shown as that
//! - [`History`]: the course of a run until now, for a user interface that comes late
//! - [`Input`]: an input of the operator
//! - [`Parameter`]: a value that the operator may change while a run goes on
//! - [`Question`]: a question of the controller, with its [`Answer`]
//! - source: the UI process of Zieliński et al. (2007), p. 369, and the operator's panel there

mod history;
mod input;
pub mod parameter;
mod question;
mod remedy;
mod snapshot;
mod solids;
mod stage;

pub use history::{ArmPoint, History, Lane, Point, Span};
pub use input::{Input, Manual, Step};
pub use parameter::Parameter;
pub use question::{Answer, Question, Subject};
pub use remedy::{remedy, run_remedy};
pub use snapshot::{
    ActorView, After, ArmView, CameraView, Class, ControlView, CubeView, HandView, LayerTurn, Mark,
    Message, Net, OutcomeView, ParameterView, PlanLine, Reading, Services, ServoTiming, Snapshot,
    State,
};
pub use solids::{
    ArmJoints, FRAMES, Form, Shape, Solid, arm_frames, cell_solids, joints_of, object_solids,
};
pub use stage::{ArmStage, CameraStage, Limits, ObjectStage, ParameterStage, Stage};
