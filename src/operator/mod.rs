//! The operator's vocabulary: what a UI shows and what the operator can say. Plain data, the same
//! for the page, the terminal, the keys on stdin and a replayed recording.
//!
//! - [`Stage`]: what does not change in a run: the cell's solids, names, limits; sent once
//! - [`Snapshot`]: what the controller *believes* at one moment; none of it is the plant's truth
//! - [`Input`]: what the operator says; [`Question`]: what the controller asks, with its [`Answer`]
//! - source: the UI process of Zieliński et al. (2007), p. 369; the original's operator panel

mod input;
mod question;
mod remedy;
mod snapshot;
mod solids;
mod stage;

pub use input::{Input, Manual, Step};
pub use question::{Answer, Question, Subject};
pub use remedy::remedy;
pub use snapshot::{
    ActorView, ArmView, CameraView, Class, ControlView, CubeView, HandView, LayerTurn, Mark,
    Message, Net, OutcomeView, PlanLine, Reading, Services, ServoTiming, Snapshot, State,
};
pub use solids::{ArmJoints, FRAMES, Shape, Solid, arm_frames, arm_solids, joints_of};
pub use stage::{ArmStage, CameraStage, Limits, Stage};
