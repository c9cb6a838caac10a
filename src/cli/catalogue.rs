//! The tasks that this process knows.
//!
//! A process has one command line, and so one catalogue of tasks. It is set once, before the
//! arguments are read.

use super::scenarios;
use crate::scenario::catalogue::Catalogue;
use crate::scenario::fault::Faults;
use crate::scenario::maker::Maker;
use crate::scenario::section::Key;
use crate::scenario::{self, Override, Scenario};
use crate::tasks;
use std::path::Path;
use std::sync::OnceLock;

/// Tasks of this process.
static CATALOGUE: OnceLock<Catalogue> = OnceLock::new();

/// Sets the tasks of this process. A second call changes nothing.
pub(super) fn set(catalogue: Catalogue) {
    let _ = CATALOGUE.set(catalogue);
}

/// Returns the tasks of this process.
fn catalogue() -> &'static Catalogue {
    CATALOGUE.get_or_init(|| tasks::built_in().catalogue())
}

/// Reads the scenario at `path` with the tasks of this process.
///
/// # Errors
/// All faults of the file and of the overrides.
pub(super) fn load(path: &Path, overrides: &[Override]) -> Result<Scenario, Faults> {
    scenario::load(path, overrides, catalogue()).map_err(|mut faults| {
        // The only fault of a file that is not there is its name.
        if let [fault] = faults.0.as_mut_slice()
            && !path.exists()
        {
            fault.help = Some(scenarios::advice(path));
        }
        faults
    })
}

/// Reads the text of a scenario with the tasks of this process.
///
/// # Errors
/// All faults of the text and of the overrides.
pub(super) fn read(path: &Path, text: &str, overrides: &[Override]) -> Result<Scenario, Faults> {
    scenario::read(path, text, overrides, catalogue())
}

/// Reads the scenario of a recording with the tasks of this process. A folder into which the
/// recorded run wrote need not exist.
///
/// # Errors
/// All faults of the file and of the overrides.
pub(super) fn read_recorded(
    path: &Path,
    text: &str,
    overrides: &[Override],
) -> Result<Scenario, Faults> {
    let mut catalogue = catalogue().clone();
    catalogue.replays = true;
    scenario::read(path, text, overrides, &catalogue)
}

/// Returns name, version and tasks of this process's program.
pub(super) fn program() -> Maker {
    catalogue().maker()
}

/// Returns every key that a scenario of this process can have.
pub(super) fn all_keys() -> Vec<Key> {
    scenario::all_keys(catalogue())
}
