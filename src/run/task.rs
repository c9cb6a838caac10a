//! Task of a run: MP performs the kernel that the scenario names.
//!
//! - in: the actors below MP, the geometry of the plan, the journal of an interrupted run
//! - out: the end of MP's work, and the kernel's own account of it

use super::disturbance::InjectedFaults;
use super::failure::not_created;
use super::options::SavedFiles;
use super::plan::Plan;
use super::settings;
use super::staff::Staff;
use crate::actors::mp::{self, Coordination, Ending, Mp, Turning};
use crate::actors::notice::Notice;
use crate::actors::services::Services;
use crate::actors::watchdog::{Caught, panicked};
use crate::error::Error;
use crate::hw::storage::Storage;
use crate::motion::PERIOD;
use crate::operator::Input;
use crate::reach::{MeetingTable, ReachSettings};
use crate::record::journal::Journal;
use crate::scenario::{ControllerConfig, Owner, keys};
use crate::tasks::Task;
use crate::tasks::cube::hold::Hand;
use crate::tasks::cube::mission::{self, Entry, Goal, Mission, MissionLog};
use crate::tasks::idle::Idle;
use crate::tasks::panel::Panel;
use std::path::Path;
use std::time::Instant;
use tokio::sync::mpsc;
use tracing::Instrument as _;

/// Time that the operator has for an answer (s).
const PATIENCE: f64 = 120.0;

/// Journal of a run, and the last entry of the run that it resumes.
#[derive(Default)]
pub(super) struct Logbook {
    journal: Option<Journal>,
    /// Whether this run continues where another one was interrupted.
    resumes: bool,
    /// Last entry of that other run; `None` if it had not begun.
    last: Option<Entry>,
}

impl Logbook {
    /// Opens the journal that `files` names; without one the logbook is empty. If the run resumes
    /// another one, the last entry of that run is read first.
    ///
    /// # Errors
    /// If the journal cannot be read or written, or holds an unfinished run that is not resumed.
    pub(super) fn open(files: &SavedFiles) -> Result<Self, Error> {
        let Some(path) = &files.journal else { return Ok(Self::default()) };
        // The last entry is read before the file is opened for this run's own entries.
        let last = if files.resume {
            Journal::last(path).map_err(|why| unusable(path, &why.to_string()))?
        } else {
            None
        };
        let journal = Journal::open::<Entry>(path, files.resume);
        let journal = journal.map_err(|why| unusable(path, &why.to_string()))?;
        Ok(Self { journal: Some(journal), resumes: files.resume, last })
    }

    /// Returns the storage of the journal, in which faults can be injected; `None` without one.
    pub(super) fn storage(&self) -> Option<Storage> {
        self.journal.as_ref().map(Journal::storage)
    }

    /// Returns whether the interrupted run that this one resumes had written an entry.
    pub(super) fn has_begun(&self) -> bool {
        self.last.is_some()
    }

    /// Returns whether the run that this one resumes was interrupted before its end.
    pub(super) fn is_broken_off(&self) -> bool {
        self.last.as_ref().is_some_and(|last| !last.over)
    }
}

/// Returns the error of a journal that cannot be used.
fn unusable(path: &Path, why: &str) -> Error {
    not_created("journal", &format!("{}: {why}", path.display()))
}

/// Kernel of the task that MP performs.
enum Kernel {
    Cube(Box<Mission>),
    Idle(Idle),
    Panel(Panel),
}

/// Assignment of MP.
pub(super) struct Assignment {
    /// Goal of the cube's task; `None` for the idle task.
    pub(super) goal: Option<Goal>,
    /// Geometry of the task.
    pub(super) plan: Plan,
    /// Journal of the run.
    pub(super) logbook: Logbook,
    /// Answers and orders of the operator; `None` when no operator can be asked.
    pub(super) to_task: Option<mpsc::Receiver<Input>>,
    /// Flag that MP sets while a turn is commanded.
    pub(super) turning: Turning,
}

impl Assignment {
    /// Returns whether the operator moves the arms by hand. This task ends only by the operator.
    pub(super) fn is_by_hand(&self) -> bool {
        self.goal.is_none() && self.to_task.is_some()
    }
}

/// Result of the task.
pub(super) struct Performed {
    /// End of MP's work.
    pub(super) ending: Ending,
    /// Kernel of the cube's task, which has an account of it; `None` for another task.
    pub(super) mission: Option<Box<Mission>>,
    /// Time at which MP's work ended, by
    /// [`Tempo::working_time`](crate::actors::control::Tempo::working_time).
    pub(super) ended: Instant,
}

impl Performed {
    /// Returns the mission's facts for the summary; those of a mission without events for another
    /// task.
    pub(super) fn log(&self) -> MissionLog {
        self.mission.as_ref().map(|mission| mission.log()).unwrap_or_default()
    }

    /// Returns the place of the cube as the kernel believes, in words; empty for another task.
    pub(super) fn whereabouts(&self) -> String {
        self.mission.as_ref().map(|mission| mission.whereabouts()).unwrap_or_default()
    }
}

/// Performs the task with all effectors. A panic of MP is part of the result, not an error of this
/// function.
///
/// # Errors
/// If the cell has too few effectors for the task.
pub(super) async fn run_task(
    config: &ControllerConfig,
    staff: &mut Staff,
    assignment: Assignment,
    services: &Services,
    faults: &InjectedFaults,
) -> Result<Performed, Error> {
    let by_hand = assignment.is_by_hand();
    let Assignment { goal, plan, logbook, to_task, turning } = assignment;
    let mut kernel = match goal {
        None if by_hand => Kernel::Panel(settings::panel(config)),
        None => Kernel::Idle(Idle::new(config.idle.time)),
        Some(goal) => {
            let Plan { meetings, face_turn, .. } = plan;
            let held = face_turn.map(|f| (Hand::Postument, f.body, f.half_roll));
            // Without a limit of time the kernel asks no questions: no operator could answer.
            let patience = to_task.is_some().then_some(PATIENCE);
            let mut order =
                mission::Assignment { held, patience, ..mission::Assignment::new(goal) };
            // A resumed mission first looks at jaws and cameras. The journal's last entry tells it
            // what these cannot show.
            if logbook.resumes {
                order = order.resumed(logbook.last);
            }
            Kernel::Cube(Box::new(cube_kernel(config, meetings, order)?))
        }
    };
    // MP takes the ECPs: they end with it. EDPs and VSPs stay with the staff until the verdict.
    let Staff { ecps, sensors, manners, guard, apart, .. } = staff;
    let mp = Mp::new(mp::Parts {
        turning,
        forces: sensors.forces.take(),
        ecps: std::mem::take(ecps),
        tracker: sensors.tracker_of(Owner::Mp),
        hand_cameras: (0..config.cell.arms.len())
            .map(|arm| sensors.hand_camera_of(Owner::Mp, arm))
            .collect(),
        coordination: match config.coordination {
            keys::Coordination::Continuous => Coordination::Continuous,
            keys::Coordination::Sporadic => Coordination::Sporadic,
        },
        manners: manners.clone(),
        operator: to_task,
        journal: logbook.journal,
        guard: Some(guard.clone()),
        apart: apart.clone(),
        services: services.under(Some(&faults.mp)),
    });
    // The kernel stays here, since its account is needed even after a panic of MP.
    let ending = match &mut kernel {
        Kernel::Cube(mission) => perform(mp, mission.as_mut(), services).await,
        Kernel::Idle(idle) => perform(mp, idle, services).await,
        Kernel::Panel(panel) => perform(mp, panel, services).await,
    };
    let mission = match kernel {
        Kernel::Cube(mission) => Some(mission),
        Kernel::Idle(_) | Kernel::Panel(_) => None,
    };
    Ok(Performed { ending, mission, ended: services.tempo.working_time() })
}

/// Creates the kernel of the cube's task.
///
/// # Errors
/// If the cell does not have two arms.
fn cube_kernel(
    config: &ControllerConfig,
    meetings: Option<MeetingTable>,
    assignment: mission::Assignment,
) -> Result<Mission, Error> {
    let settings = meetings
        .and_then(|meetings| settings::cube_settings(config, meetings, &ReachSettings::default()))
        .ok_or_else(|| not_created("task", "the cube task needs two effectors"))?;
    Ok(Mission::new(settings, assignment))
}

/// Lets MP perform a task and returns its ending, even after a panic.
async fn perform<T: Task>(mp: Mp, task: &mut T, services: &Services) -> Ending {
    let work = mp.run(task).instrument(tracing::info_span!("mp"));
    match Caught(Box::pin(work)).await {
        Ok(ending) => ending,
        Err(why) => {
            let (end, error) = (services.clock.period() as f64 * PERIOD, panicked("mp", &*why));
            services.trace.tell(Notice::Error(end, error.clone()));
            Ending::broken(end, error)
        }
    }
}
