//! Geometry of a run before it begins: the meetings of the arms (joint positions in which both
//! hands can be at one cube) and the beginning that the task's judge asks for.
//!
//! - in: the scenario
//! - out: [`Plan`], for the task and for the plant, whose errors are drawn around it

use super::failure::not_created;
use super::settings;
use super::simulation;
use super::task::entry_of;
use crate::error::Error;
use crate::hw::plant::Plant;
use crate::reach::{MeetingTable, ReachSettings};
use crate::registry::Beginning;
use crate::scenario::Scenario;

/// Geometry with which plant and task begin.
pub(super) struct Plan {
    /// Meetings of the first two arms; `None` for a cell of one.
    pub(super) meetings: Option<MeetingTable>,
    /// Beginning of the plant, if not as the scenario says.
    beginning: Option<Beginning>,
}

impl Plan {
    /// Finds the geometry of a run: the table of the arms' meetings, from the cache or by a search,
    /// and how the plant begins.
    ///
    /// # Errors
    /// If the cell does not allow the beginning of the task.
    pub(super) fn of(scenario: &Scenario) -> Result<Self, Error> {
        let config = &scenario.controller;
        let meetings = (config.cell.arms.len() >= 2)
            .then(|| settings::meetings(config, &ReachSettings::default()));
        let beginning = entry_of(scenario)?.beginning(config, meetings.as_ref());
        let beginning = beginning.map_err(|why| not_created("task", &why))?;
        Ok(Self { meetings, beginning })
    }

    /// Creates the plant in the state in which a run begins.
    ///
    /// # Errors
    /// If the plant section describes no possible plant.
    pub(super) fn plant(&self, scenario: &Scenario) -> Result<Plant, Error> {
        simulation::create(scenario, self.meetings.as_ref(), self.beginning.as_ref())
            .map_err(|why| not_created("plant", &why))
    }
}
