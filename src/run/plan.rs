//! Geometry of a run before it begins: the meetings of the arms (joint positions in which both
//! hands can be at one cube) and the start of a face turn.
//!
//! - in: the controller section
//! - out: [`Plan`], for the task and for the plant, whose errors are drawn around it

use super::failure::not_created;
use super::settings::{self, FaceTurnStart};
use super::simulation;
use crate::error::Error;
use crate::hw::plant::Plant;
use crate::reach::{MeetingTable, ReachSettings};
use crate::scenario::keys::Task;
use crate::scenario::{ControllerConfig, Scenario};

/// Geometry with which plant and task begin.
pub(super) struct Plan {
    /// Meetings of the two arms; `None` unless the cell has two.
    pub(super) meetings: Option<MeetingTable>,
    /// Start of a face turn; `None` for other tasks.
    pub(super) face_turn: Option<FaceTurnStart>,
    /// Angle of the face turn (rad).
    pub(super) angle: f64,
}

impl Plan {
    /// Finds the geometry of a run: the table of the arms' meetings, from the cache or by a search,
    /// and for a face turn the positions from which it starts.
    ///
    /// # Errors
    /// If no meeting of the arms allows the face turn.
    pub(super) fn of(config: &ControllerConfig) -> Result<Self, Error> {
        let meetings = (config.cell.arms.len() == 2)
            .then(|| settings::meetings(config, &ReachSettings::default()));
        let face_turn = (config.task == Task::FaceTurn)
            .then(|| {
                let meetings = meetings.as_ref().ok_or("a face turn needs two arms".to_owned())?;
                settings::face_turn_start(meetings, config.face_turn.angle)
            })
            .transpose()
            .map_err(|why| not_created("task", &why))?;
        // For a half turn the angle may now have the other sense, in which the wrist has room.
        let (face_turn, angle) =
            face_turn.map_or((None, 0.0), |(start, angle)| (Some(start), angle));
        Ok(Self { meetings, face_turn, angle })
    }

    /// Creates the plant in the state in which a run begins.
    ///
    /// # Errors
    /// If the plant section describes no possible plant.
    pub(super) fn plant(&self, scenario: &Scenario) -> Result<Plant, Error> {
        simulation::create(scenario, self.meetings.as_ref(), self.face_turn.as_ref())
            .map_err(|why| not_created("plant", &why))
    }
}
