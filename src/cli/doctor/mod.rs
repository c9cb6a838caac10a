//! `rubik-robot doctor`: checks whether this machine can run a real-time servo.
//!
//! - in: the machine; optionally a scenario with its devices
//! - out: findings, each fault with the command that mends it; the jitter of a servo thread
//! - exit code: 1 if a right is missing or `run` would refuse the core or devices of the scenario

mod devices;
mod finding;
mod fix;
mod machine;
mod probe;
mod robot;

use super::arguments::positive;
use super::catalogue;
use super::output::{Output, refuse};
use super::scenarios;
use crate::hw::driver::{Timing, WallOptions};
use crate::scenario::Scenario;
use clap::Args;
use finding::{Finding, Weight, any, exit_code};
use serde_json::json;
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot doctor
  rubik-robot doctor scenarios/hardware.toml  # with its priority and its devices
  rubik-robot doctor --seconds 60             # a longer probe
  rubik-robot doctor --json | tail -1

No device is opened, and no arm moves. Each finding has a mark, and below it, after ->, the command
or setting that helps:
  ok        no fault
  MISSING   a right is missing that `run --require-rt` needs
  REFUSED   the reason why `run` refuses the scenario
  note      the servo may be late at times, or only some scenarios need this
The jitter is how late a servo thread with a period of 2 ms wakes up (us): one that sleeps, and one
that spins before each period. It does not change the exit code.

Keys of the object of --json:
  real_time   whether every real-time right is granted
  refused     whether `run` refuses the scenario
  findings    name, state (the mark), fact, fix (null if there is none)
  probes      jitter: name, p50_us, p99_us, p999_us, max_us, missed and periods (their numbers)
Exit codes: 0 every real-time right is granted, and `run` would accept the scenario's core and
devices; 1 otherwise; 2 wrong usage or scenario.")]
pub(super) struct DoctorArgs {
    /// Scenario file (TOML) whose priority, core and devices are checked [default: none]
    #[arg(value_parser = scenarios::parser())]
    scenario: Option<PathBuf>,
    /// Duration of each of the two jitter measurements by the wall clock
    /// (s, 0.1 to 3600)
    #[arg(long, value_name = "S", default_value_t = 2.0, value_parser = positive,
          verbatim_doc_comment)]
    seconds: f64,
    /// Print one line of JSON
    #[arg(long)]
    json: bool,
}

/// Name of a jitter measurement, and its timing; `None` if the thread could not be started.
type Probe = (&'static str, Option<Timing>);

/// Examines the machine and the scenario's robot; returns the exit code.
pub(super) fn run(args: &DoctorArgs, output: &mut Output) -> anyhow::Result<u8> {
    let scenario = args
        .scenario
        .as_deref()
        .map(|path| catalogue::load(path, &[]))
        .transpose()
        .map_err(refuse)?;
    let priority =
        scenario.as_ref().map_or(WallOptions::default().priority, |s| s.real_time.priority);
    let findings = examine(scenario.as_ref(), priority);
    let seconds = args.seconds.clamp(0.1, 3600.0);
    if !args.json {
        print_findings(&findings, output)?;
        output.line(&format!(
            "\njitter of a servo thread with a period of 2 ms, {seconds} s each:"
        ))?;
        // The probes take seconds: the findings appear before them.
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

/// Returns the findings about machine, devices and robot, without the jitter measurements.
fn examine(scenario: Option<&Scenario>, priority: i32) -> Vec<Finding> {
    let mut findings = machine::rights(priority);
    findings.extend(machine::kernel());
    findings.extend(devices::devices());
    findings.extend(scenario.and_then(|s| machine::core(s.real_time.core)));
    findings.extend(scenario.into_iter().flat_map(robot::robot));
    findings
}

/// Prints each finding, with the command that helps.
fn print_findings(findings: &[Finding], output: &mut Output) -> anyhow::Result<()> {
    for f in findings {
        output.line(&format!("{:8} {:22} {}", f.weight.word(), f.name, f.fact))?;
        if let Some(fix) = &f.fix {
            output.line(&format!("{:31} -> {fix}", ""))?;
        }
    }
    Ok(())
}

/// Prints the jitter measurements.
fn print_probes(probes: &[Probe], output: &mut Output) -> anyhow::Result<()> {
    for (name, timing) in probes {
        output.line(&match timing {
            Some(timing) => format!("  {name:15} {}", probe::words(timing)),
            None => format!("  {name:15} the thread could not be started"),
        })?;
    }
    Ok(())
}

/// Prints what the findings mean for `run`.
fn print_verdict(findings: &[Finding], output: &mut Output) -> anyhow::Result<()> {
    output.line(if any(findings, Weight::Missing) {
        "\nA real-time right is missing: `run --pace real-time` warns, `--require-rt` refuses."
    } else {
        "\nEvery real-time right is granted."
    })?;
    if any(findings, Weight::Refused) {
        output.line("`run` refuses this scenario: the findings marked REFUSED say why.")?;
    }
    Ok(())
}

/// Returns the findings and the jitter measurements (`probes`) as JSON.
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
    fn every_missing_real_time_right_names_a_fix() {
        for finding in examine(None, 85) {
            assert!(!finding.fact.is_empty(), "{}", finding.name);
            assert!(finding.weight != Weight::Missing || finding.fix.is_some(), "{}", finding.name);
        }
    }
}
