//! Task of a run: MP performs the kernel that the scenario names.
//!
//! - in: the actors below MP, the meetings of the arms, the journal of an interrupted run
//! - out: the end of MP's work, and the kernel with its account of it

use super::disturbance::InjectedFaults;
use super::failure::not_created;
use super::options::SavedFiles;
use super::pauses::Pauses;
use super::staff::Staff;
use crate::actors::mp::{self, Coordination, Ending, Mp, Turning};
use crate::actors::notice::Notice;
use crate::actors::services::Services;
use crate::actors::watchdog::{Caught, panicked};
use crate::error::Error;
use crate::hw::storage::Storage;
use crate::motion::PERIOD;
use crate::operator::Input;
use crate::reach::MeetingTable;
use crate::record::journal::Journal;
use crate::registry::{Logbook, Registered, TaskEntry};
use crate::scenario::{Owner, Scenario, keys};
use std::time::Instant;
use tokio::sync::mpsc;
use tracing::Instrument as _;

/// Returns the registered task that a scenario names.
///
/// # Errors
/// If no registry made the declaration with which the scenario was read.
pub(super) fn entry_of(scenario: &Scenario) -> Result<&TaskEntry, Error> {
    let found = TaskEntry::of_declaration(scenario.task.declaration());
    found.ok_or_else(|| not_created("task", "the scenario was read without a registry of tasks"))
}

/// Opens the journal that `files` names; without one the logbook is empty.
///
/// # Errors
/// If the journal cannot be read or written, or holds an unfinished run that is not resumed.
pub(super) fn open_logbook(scenario: &Scenario, files: &SavedFiles) -> Result<Logbook, Error> {
    let Some(path) = &files.journal else { return Ok(Logbook::default()) };
    let unusable = |why: String| not_created("journal", &format!("{}: {why}", path.display()));
    let program = scenario.task.program();
    entry_of(scenario)?.open(path, files.resume, program).map_err(unusable)
}

/// Returns the storage of a journal, in which faults can be injected; `None` without one.
pub(super) fn storage(logbook: &Logbook) -> Option<Storage> {
    logbook.journal.as_ref().map(Journal::storage)
}

/// Assignment of MP.
pub(super) struct Assignment {
    /// Meetings of the first two arms; `None` for a cell of one.
    pub(super) meetings: Option<MeetingTable>,
    /// Journal of the run.
    pub(super) logbook: Logbook,
    /// Answers and orders of the operator; `None` when no operator can be asked.
    pub(super) to_task: Option<mpsc::Receiver<Input>>,
    /// Flag that MP sets while a turn is commanded.
    pub(super) turning: Turning,
}

/// Result of the task.
pub(super) struct Performed {
    /// End of MP's work.
    pub(super) ending: Ending,
    /// Kernel, which has an account of the task.
    pub(super) kernel: Box<dyn Registered>,
    /// Time at which MP's work ended, by
    /// [`Tempo::working_time`](crate::actors::control::Tempo::working_time).
    pub(super) ended: Instant,
    /// Time for which the operator paused the task (s).
    pub(super) paused: f64,
}

/// Performs the task with all effectors. A panic of MP is part of the result, not an error of this
/// function.
///
/// # Errors
/// If the cell does not allow the task.
pub(super) async fn run_task(
    scenario: &Scenario,
    staff: &mut Staff,
    assignment: Assignment,
    services: &Services,
    faults: &InjectedFaults,
) -> Result<Performed, Error> {
    let config = &scenario.controller;
    let Assignment { meetings, mut logbook, to_task, turning } = assignment;
    let kernel = entry_of(scenario)?.kernel(config, to_task.is_some(), meetings, &mut logbook);
    // The kernel stays here, since its account is needed even after a panic of MP.
    let mut kernel = kernel.map_err(|why| not_created("task", &why))?;
    // MP takes the ECPs: they end with it. EDPs and VSPs stay with the staff until the verdict.
    let states = staff.states();
    let Staff { ecps, sensors, manners, guard, may_meet, .. } = staff;
    let mp = Mp::new(mp::Parts {
        turning,
        forces: sensors.forces.take(),
        sensors: sensors.own_of(Owner::Mp),
        ecps: std::mem::take(ecps),
        states,
        tracker: sensors.tracker_of(Owner::Mp),
        hand_cameras: (0..config.cell.arms.len())
            .map(|arm| sensors.hand_camera_of(Owner::Mp, arm))
            .collect(),
        coordination: match config.coordination {
            keys::Coordination::Continuous => Coordination::Continuous,
            keys::Coordination::Sporadic => Coordination::Sporadic,
            keys::Coordination::Absent => Coordination::Absent,
        },
        manners: manners.clone(),
        operator: to_task,
        journal: logbook.journal,
        guard: Some(guard.clone()),
        may_meet: may_meet.clone(),
        services: services.under(Some(&faults.mp)),
    });
    let pauses = Pauses::watch(services.control.clone());
    let ending = perform(mp, kernel.as_mut(), services).await;
    let (paused, ended) = (pauses.seconds(), services.tempo.working_time());
    Ok(Performed { ending, kernel, ended, paused })
}

/// Lets MP perform a task and returns its ending, even after a panic.
async fn perform(mp: Mp, task: &mut dyn Registered, services: &Services) -> Ending {
    let work = task.perform(mp).instrument(tracing::info_span!("mp"));
    match Caught(Box::pin(work)).await {
        Ok(ending) => ending,
        Err(why) => {
            let (end, error) = (services.clock.period() as f64 * PERIOD, panicked("mp", &*why));
            services.trace.tell(Notice::Error(end, error.clone()));
            Ending::broken(end, error)
        }
    }
}
