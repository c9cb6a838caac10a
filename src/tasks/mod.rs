//! The tasks, one folder a task. Each enters the program by the [`registry`](crate::registry), as a
//! task of another crate does; there is no other door.
//!
//! Kernels are pure. The `door` of a task may know files and the cell's geometry, and its `verdict`
//! sees the plant.

pub mod carry_bar;
pub mod cube;
pub mod follow_contour;
pub mod follow_joints;
pub mod idle;
pub mod patrol;
pub mod teach;

use crate::registry::Registry;
use crate::scenario::fault::Faults;
use crate::scenario::{self, Override, Scenario};
use std::path::Path;

/// Returns the tasks of this crate.
#[must_use]
pub fn built_in() -> Registry {
    Registry::default()
        .task::<cube::door::Solve>("solve")
        .verdict::<cube::verdict::SolveVerdict>()
        .task::<cube::door::FaceTurn>("face_turn")
        .verdict::<cube::verdict::FaceTurnVerdict>()
        .task::<cube::door::Acquire>("acquire")
        .verdict::<cube::verdict::AcquireVerdict>()
        .task::<carry_bar::CarryBar>("carry_bar")
        .verdict::<carry_bar::BarCarried>()
        .task::<idle::Idle>("idle")
        .task::<patrol::Patrol>("patrol")
        .verdict::<patrol::RoundsDone>()
        .programme::<patrol::Rounds>(patrol::ROUNDS)
        .task::<follow_contour::FollowContour>("follow_contour")
        .verdict::<follow_contour::Done>()
        .programme::<follow_contour::Follower>(follow_contour::FOLLOW)
        .programme::<follow_contour::Picker>(follow_contour::PICK)
        .task::<teach::Teach>("teach")
        .verdict::<teach::PlayedBack>()
        .task::<follow_joints::FollowJoints>("follow_joints")
        .sensor::<follow_joints::JointCommands>(follow_joints::SENSOR)
}

/// Reads the scenario at `path` like [`scenario::load`], with the tasks of this crate.
///
/// # Errors
/// All faults of the file and of the overrides.
pub fn load(path: &Path, overrides: &[Override]) -> Result<Scenario, Faults> {
    scenario::load(path, overrides, &built_in().catalogue())
}

/// Reads the text of a scenario like [`scenario::read`], with the tasks of this crate.
///
/// ```
/// use rubik_robot::tasks;
/// use std::path::Path;
///
/// // All faults at once, each with its place.
/// let text = "task = \"solve\"\n[cube]\nedge = 57\n[control]\ngrip_n = 1000\n";
/// let faults = tasks::read(Path::new("t.toml"), text, &[]).unwrap_err().to_string();
/// assert!(faults.contains("t.toml:3:1: unknown key `edge` in [cube]"));
/// assert!(faults.contains("t.toml:5:10: `control.grip_n`: 1000 is outside 1..100"));
/// ```
///
/// # Errors
/// All faults of the text and of the overrides.
pub fn read(path: &Path, text: &str, overrides: &[Override]) -> Result<Scenario, Faults> {
    scenario::read(path, text, overrides, &built_in().catalogue())
}
