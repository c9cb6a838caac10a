//! Settings of actors and kernels, converted from a scenario's controller section.
//!
//! No error of the plant is read here: these are the controller's beliefs.
//!
//! - in: the controller section
//! - out: the table of meetings, the planner, the camera method, options of the servo's thread

use crate::actors::manner::manner;
use crate::hw::driver::WallOptions;
use crate::reach::{MeetingTable, ReachSettings};
use crate::scenario::keys::RealTime;
use crate::scenario::{ControllerConfig, keys};
use crate::tasks::cube::door::cube_settings;
use crate::tasks::cube::plan::Planner;
use crate::vision::Method;
use crate::vision::watcher::PoseBy;

/// Returns the table of the arms' meetings, from the cache or by a search of about a second.
pub(super) fn meetings(config: &ControllerConfig, reach: &ReachSettings) -> MeetingTable {
    // Both arms have the same speeds.
    let speeds = manner(config, 0).speeds;
    let walks = config.uses_shortest_paths();
    super::meeting_cache::of(&config.cell, reach, walks.then_some(&speeds))
}

/// Creates the planner of a cell. If the table of the arms' meetings is not cached, this takes
/// about a second.
///
/// # Errors
/// If the cell does not have two arms.
pub fn planner(config: &ControllerConfig) -> Result<Planner, String> {
    let reach = ReachSettings::default();
    let meetings = meetings(config, &reach);
    cube_settings(config, meetings, &reach)
        .map(|settings| Planner::new(&settings))
        .ok_or_else(|| "a plan needs a cell with two effectors".to_owned())
}

/// Returns the method by which the stand-alone camera's sensor finds the cube.
pub(super) fn method(config: &ControllerConfig) -> Method {
    match config.vision.detector {
        keys::Detector::Lattice => Method::Edges,
        keys::Detector::Paper => Method::Paper2007,
        keys::Detector::Square => Method::Square2007,
    }
}

/// Returns the measurement from which the stand-alone camera's sensor computes the cube's pose.
pub(super) fn pose_by(config: &ControllerConfig) -> PoseBy {
    match config.vision.pose {
        keys::PoseBy::Edges => PoseBy::Edges,
        keys::PoseBy::Corners => PoseBy::Corners,
    }
}

/// Returns the options of the servo's thread under the wall clock.
pub(super) fn wall(keys: &RealTime, missed_limit: u64, require_real_time: bool) -> WallOptions {
    WallOptions {
        spin: (keys.spin * 1e9).round() as u64,
        priority: keys.priority,
        core: keys.core.map(|core| core as usize),
        missed_limit,
        require_real_time,
    }
}
