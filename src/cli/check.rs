//! `rubik-robot check`: lists all errors of a scenario without running it.

use super::arguments::ScenarioArgs;
use super::output::{Output, refuse};
use crate::run::check_task;

/// Checks a scenario and prints a line about its content; returns the exit code.
pub(super) fn run(args: &ScenarioArgs, output: &mut Output) -> anyhow::Result<u8> {
    let scenario = args.load(&[]).map_err(refuse)?;
    check_task(&scenario).map_err(refuse)?;
    let controller = &scenario.controller;
    let names: Vec<&str> = controller.cell.arms.iter().map(|a| a.name.as_str()).collect();
    output.line(&format!(
        "{}: valid: task {}, coordination {}, effectors {}, {}, {}, seed {}",
        args.scenario.display(),
        controller.task.word(),
        controller.coordination.word(),
        names.join(" and "),
        counted(controller.cell.cameras.len(), "camera"),
        counted(controller.vsps.len(), "sensor"),
        scenario.seed,
    ))?;
    Ok(0)
}

/// Returns a number of things in words.
fn counted(number: usize, thing: &str) -> String {
    format!("{number} {thing}{}", if number == 1 { "" } else { "s" })
}
