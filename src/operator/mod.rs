//! The operator's vocabulary: what a face shows and what it may ask for. Plain data, the same for the page, the
//! terminal, the keys on stdin and a recording that is shown again.
//!
//! - [`Stage`]: what does not change in a run: the cell's solids, names, limits; sent once
//! - [`Snapshot`]: what the controller *believes* at one moment; nothing in it comes from the plant's truth
//! - [`Command`]: what the operator wants; [`Question`]: what the controller wants to know, with its [`Answer`]
//! - source: the UI process of Zieliński et al. (2007), p. 369; the original's operator panel

mod command;
mod remedy;
mod snapshot;
mod solids;
mod stage;

pub use command::{Answer, Command, Manual, Question, Said, Step, Subject};
pub use remedy::remedy;
pub use snapshot::{
    ActorView, ArmView, CameraView, Class, ControlView, CubeView, HandView, LayerTurn, Mark,
    Message, Net, OutcomeView, PlanLine, Reading, Services, ServoTiming, Snapshot, State,
};
pub use solids::{ArmJoints, FRAMES, Shape, Solid, arm_frames, arm_solids, joints_of};
pub use stage::{ArmStage, CameraStage, Limits, Stage};
