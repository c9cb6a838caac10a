//! `rubik-robot parameters`: lists the parameters that the operator may change while a run goes on.

use super::arguments::ScenarioArgs;
use super::output::{Output, refuse};
use crate::operator::parameter::DECLARED;

/// Lists the parameters of a scenario, each in two lines; returns the exit code.
pub(super) fn run(args: &ScenarioArgs, output: &mut Output) -> anyhow::Result<u8> {
    let scenario = args.load(&[]).map_err(refuse)?;
    // A bound that was cut has more digits than a person needs.
    let short = |value: f64| (value * 1e4).round() * 1e-4;
    for declared in &DECLARED {
        let bounds = scenario.controller.bounds[declared.parameter];
        let (least, most) = (short(bounds.least), short(bounds.most));
        let unit = declared.unit;
        let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
        let range = if bounds.leave_room() {
            format!("{least}..{most}{unit}, by at most {}{unit} in a second", declared.rate)
        } else {
            "fixed in this scenario".to_owned()
        };
        output.line(&format!("{} = {}", declared.name, short(bounds.usual)))?;
        output.line(&format!("    {} ({}: {range})", declared.meaning, declared.key))?;
    }
    Ok(0)
}
