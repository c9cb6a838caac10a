//! Arguments that several commands take.

use crate::scenario::{self, Override, Scenario};
use clap::Args;
use std::path::PathBuf;

/// A scenario and the overrides of its keys.
#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Args)]
pub(super) struct ScenarioArgs {
    /// Scenario file (TOML)
    pub(super) scenario: PathBuf,
    /// Override of a key, as in control.grip_n=30; repeatable
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub(super) set: Vec<String>,
}

impl ScenarioArgs {
    /// Returns the overrides of `--set` that can be read.
    pub(super) fn overrides(&self) -> Vec<Override> {
        self.set.iter().filter_map(|text| Override::parse(text).ok()).collect()
    }

    /// Loads the scenario under `--set` and the overrides in `more`.
    ///
    /// # Errors
    /// All errors of the file and of the overrides, one a line.
    pub(super) fn load(&self, more: &[Override]) -> Result<Scenario, String> {
        let mut overrides = Vec::new();
        let mut wrong = Vec::new();
        for text in &self.set {
            match Override::parse(text) {
                Ok(over) => overrides.push(over),
                Err(reason) => wrong.push(format!("--set: {reason}")),
            }
        }
        overrides.extend_from_slice(more);
        // The file is read even if an override is wrong, so that all errors are listed at once.
        let loaded = scenario::load(&self.scenario, &overrides).map_err(|f| f.to_string());
        match (loaded, wrong.is_empty()) {
            (Ok(scenario), true) => Ok(scenario),
            (Ok(_), false) => Err(wrong.join("\n")),
            (Err(faults), _) => {
                Err(wrong.into_iter().chain([faults]).collect::<Vec<_>>().join("\n"))
            }
        }
    }
}

/// Parses the value of an option that is a size: a finite number of 0 or more.
pub(super) fn not_negative(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number.is_finite() && number >= 0.0 => Ok(number),
        Ok(_) => Err("must be a number of 0 or more".to_owned()),
        Err(why) => Err(why.to_string()),
    }
}

/// Parses the value of an option that must be a finite number above 0.
pub(super) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if x.is_finite() && x > 0.0 => Ok(x),
        _ => Err("must be a number above 0".to_owned()),
    }
}
