//! The shells: UI, MP, an ECP and an EDP per effector, VSPs.

use crate::error::{Error, System};
use crate::record::summary::Summary;
use crate::scenario::Scenario;

/// How a run is started.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RunOptions {
    /// Starts by itself and asks nothing; the end of input never makes it wait.
    pub automatic: bool,
}

/// Performs a scenario and returns what it came to.
///
/// # Errors
/// When it could not be performed at all; an error in mid-run is part of the summary.
pub fn run(scenario: &Scenario, options: RunOptions) -> Result<Summary, Error> {
    let _ = (scenario, options);
    Err(Error::System {
        actor: "supervisor".to_owned(),
        place: "start",
        cause: System::NotCreated { who: "MP".to_owned(), why: "it is not written yet".to_owned() },
    })
}
