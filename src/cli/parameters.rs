//! `rubik-robot parameters`: lists the parameters that the operator may change while a run goes on.

use super::arguments::ScenarioArgs;
use super::output::{Output, refuse};
use crate::operator::parameter::DECLARED;

/// Lists the parameters of a scenario, each in two lines; returns the exit code.
pub(super) fn run(args: &ScenarioArgs, output: &mut Output) -> anyhow::Result<u8> {
    let scenario = args.load(&[]).map_err(refuse)?;
    // A bound that was cut has more digits than a person needs. It is rounded inwards, since a
    // person may order it as it is printed.
    let digits = |value: f64, round: fn(f64) -> f64| round(value * 1e4) / 1e4;
    let short = |value: f64| digits(value, f64::round);
    for declared in &DECLARED {
        let bounds = scenario.controller.bounds[declared.parameter];
        let least = digits(bounds.least - 1e-9, f64::ceil);
        let most = digits(bounds.most + 1e-9, f64::floor);
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
