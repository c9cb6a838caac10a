//! `rubik-robot doctor`: what this machine can give a real-time servo, a probe of its jitter, and
//! for each shortfall the line that helps.

mod devices;
mod finding;
mod fix;
mod machine;
mod probe;
mod robot;

use super::output::{Output, refuse};
use crate::hw::driver::{Timing, WallOptions};
use crate::scenario::{self, Scenario};
use clap::Args;
use finding::{Finding, Weight, any, exit_code};
use serde_json::json;
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot doctor
  rubik-robot doctor my.toml              and its priority, and the devices of its robot
  rubik-robot doctor --seconds 60         a longer probe
  rubik-robot doctor --json | tail -1
Exit code 0 when every real-time right is granted and nothing is found for which `run` would refuse the scenario's devices,
1 when not, 2 when the scenario is wrong. No device is opened. The probe never moves an arm.")]
pub(super) struct DoctorArgs {
    /// Scenario whose priority is asked for and whose devices are looked for
    scenario: Option<PathBuf>,
    /// Length of each of the two jitter probes
    #[arg(long, value_name = "S", default_value_t = 2.0)]
    seconds: f64,
    /// One line of JSON for a program
    #[arg(long)]
    json: bool,
}

/// A probe's name, and its timing unless the thread could not be started.
type Probe = (&'static str, Option<Timing>);

/// Examines the machine and the scenario's robot; returns the exit code.
pub(super) fn run(args: &DoctorArgs, output: &mut Output) -> anyhow::Result<u8> {
    let scenario = args
        .scenario
        .as_deref()
        .map(|path| scenario::load(path, &[]))
        .transpose()
        .map_err(refuse)?;
    let priority =
        scenario.as_ref().map_or(WallOptions::default().priority, |s| s.real_time.priority);
    let findings = examine(scenario.as_ref(), priority);
    let seconds = args.seconds.clamp(0.1, 3600.0);
    if !args.json {
        print_findings(&findings, output)?;
        output.line(&format!("\njitter of the servo's own thread, 2 ms, {seconds} s each:"))?;
        output.flush()?;
    }
    let probes = [("sleep", 0), ("sleep and spin", WallOptions::default().spin)]
        .map(|(name, spin)| (name, probe::probe(spin, priority, seconds)));
    if args.json {
        output.line(&as_json(&findings, &probes).to_string())?;
    } else {
        print_probes(&probes, output)?;
        print_verdict(&findings, output)?;
    }
    Ok(exit_code(&findings))
}

/// Returns everything that is found without the probes.
fn examine(scenario: Option<&Scenario>, priority: i32) -> Vec<Finding> {
    let mut findings = machine::rights(priority);
    findings.extend(machine::kernel());
    findings.extend(devices::devices());
    findings.extend(scenario.into_iter().flat_map(robot::robot));
    findings
}

fn print_findings(findings: &[Finding], output: &mut Output) -> anyhow::Result<()> {
    for f in findings {
        output.line(&format!("{:8} {:22} {}", f.weight.word(), f.name, f.fact))?;
        if let Some(fix) = &f.fix {
            output.line(&format!("{:31} -> {fix}", ""))?;
        }
    }
    Ok(())
}

fn print_probes(probes: &[Probe], output: &mut Output) -> anyhow::Result<()> {
    for (name, timing) in probes {
        output.line(&match timing {
            Some(timing) => format!("  {name:15} {}", probe::words(timing)),
            None => format!("  {name:15} the thread could not be started"),
        })?;
    }
    Ok(())
}

fn print_verdict(findings: &[Finding], output: &mut Output) -> anyhow::Result<()> {
    output.line(if any(findings, Weight::Missing) {
        "\nNot real time: `run --pace real-time` works and warns, `--require-rt` refuses."
    } else {
        "\nEvery real-time right is granted."
    })?;
    if any(findings, Weight::Refused) {
        output.line("`run` refuses this scenario for its devices.")?;
    }
    Ok(())
}

fn as_json(findings: &[Finding], probes: &[Probe]) -> serde_json::Value {
    let listed: Vec<_> = findings
        .iter()
        .map(|f| json!({"name": f.name, "state": f.weight.word(), "fact": f.fact, "fix": f.fix}))
        .collect();
    let probes: Vec<_> =
        probes.iter().map(|(name, timing)| probe::describe(name, timing.as_ref())).collect();
    json!({
        "real_time": !any(findings, Weight::Missing),
        "refused": any(findings, Weight::Refused),
        "findings": listed,
        "probes": probes,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_right_names_its_fix() {
        for finding in examine(None, 85) {
            assert!(!finding.fact.is_empty(), "{}", finding.name);
            assert!(finding.weight != Weight::Missing || finding.fix.is_some(), "{}", finding.name);
        }
    }
}
