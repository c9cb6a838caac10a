//! Check of a scenario by its task, before a run.
//!
//! - in: the scenario
//! - out: the reason why the cell does not allow the task, as the run would find it

use super::plan::Plan;
use super::task::entry_of;
use crate::error::{Error, System};
use crate::reach::guard::Guard;
use crate::registry::Logbook;
use crate::scenario::Scenario;

/// Checks whether the arms have room where they start, and whether the task can make its kernel for
/// the cell, as at the beginning of a run. The tasks with a hand-over check their scenario
/// completely when it is read.
///
/// # Errors
/// The reason why the cell does not allow the task.
pub fn check_task(scenario: &Scenario) -> Result<(), String> {
    let cell = &scenario.controller.cell;
    let starts = std::array::from_fn(|i| cell.arms.get(i).map(|arm| &arm.start));
    if let Some(overlap) = Guard::of(cell, f64::MAX).overlap(starts) {
        return Err(format!("{}: at the start {overlap}", scenario.path.display()));
    }
    if scenario.controller.task.properties.hands_over {
        return Ok(());
    }
    let word = scenario.controller.task.word();
    let refused = |why: &str| format!("{}: task \"{word}\": {why}", scenario.path.display());
    let entry = entry_of(scenario).map_err(|error| refused(reason(&error)))?;
    let plan = Plan::of(scenario).map_err(|error| refused(reason(&error)))?;
    let kernel = entry.kernel(&scenario.controller, true, plan.meetings, &mut Logbook::default());
    kernel.map(|_| ()).map_err(|why| refused(&why))
}

/// Returns why a part of a run could not be created.
fn reason(error: &Error) -> &str {
    match error {
        Error::System { cause: System::NotCreated { why, .. }, .. } => why,
        _ => "the cell does not allow it",
    }
}
