//! `rubik-robot node`: runs the actors of a node beside that of MP, for one run.
//!
//! - in: the name of the node, a scenario; messages of MP's node over the network
//! - out: lines for the operator, a recording of the node's part

use super::arguments::{ScenarioArgs, check_devices};
use super::output::{Output, complain, inform, refuse};
use super::record;
use super::scenarios;
use crate::error::{Error, NonFatal};
use crate::record::about::Begun;
use crate::record::place::Place;
use crate::record::recorder::Recorder;
use crate::run::{NodeContext, NodeEnd, host};
use crate::scenario::Scenario;
use anyhow::Context as _;
use clap::Args;
use std::path::PathBuf;

#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Args)]
#[command(after_help = "\
Start one process for each [[node]] of the scenario, and then the run, which has MP:
  rubik-robot node b --scenario scenarios/two_hosts.toml
  rubik-robot run scenarios/two_hosts.toml

All processes need the same program and the same scenario with the same overrides. The node waits
for MP's node at its endpoint, opens the devices of its arms and cameras when that one asks it to
join, and ends with the run. `packaging/systemd` starts it again for the next run.

The node stops its arms when MP's node is silent for 0.1 s, and ends after 2 s. Ctrl-C ends the run
on all nodes. A build without the network says how to build one.
Keys of the object of --json: servo_hash, time_s, sent_bytes, received_bytes (over the link to MP's
node), and if an error ended it: fault (its code), reason
Exit codes: 0 MP's node ended the run, 2 wrong usage or scenario, 3 an effector failed, 4 system
error, 130 interrupted before a run.")]
pub(super) struct NodeArgs {
    /// Name of the node in the scenario
    name: String,
    /// Scenario file (TOML) of the run
    #[arg(long, value_name = "FILE", value_parser = scenarios::parser())]
    scenario: PathBuf,
    /// Override of a key, as in control.grip_n=30; repeatable
    #[arg(long = "set", value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Record the node's part of the run to FILE (MCAP)
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Refuse to run unless all real-time rights are granted
    #[arg(long)]
    require_rt: bool,
    /// End stdout with one line of JSON
    #[arg(long)]
    json: bool,
}

/// Serves one run as a node of it, and returns the exit code.
pub(super) fn run(args: &NodeArgs, output: &mut Output) -> anyhow::Result<u8> {
    let given = ScenarioArgs { scenario: args.scenario.clone(), set: args.set.clone() };
    let scenario = given.load(&[]).map_err(refuse)?;
    let network = &scenario.controller.network;
    if !network.nodes.iter().any(|node| node.name == args.name) {
        let names: Vec<_> = network.nodes.iter().map(|node| node.name.as_str()).collect();
        let known = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
        let why =
            format!("{} has no node \"{}\"; nodes: {known}", args.scenario.display(), args.name);
        return Err(refuse(why));
    }
    if !network.is_real {
        return Err(refuse(
            "`pace`: on the virtual clock all nodes are in the process of the run: start \
             `rubik-robot run` alone, or set pace = \"real-time\"",
        ));
    }
    check_devices(&scenario)?;
    let recorder = recorder(args, &scenario, &given)?;
    let context = NodeContext { recorder: recorder.clone(), require_real_time: args.require_rt };
    let ended = host(&scenario, &args.name, context, complain);
    let written = recorder.finish();
    if let (Some(written), Some(path)) = (written, &args.record) {
        inform(&record::result_message(path, &written));
    }
    match ended {
        Ok(end) => tell(&end, args, output),
        Err(error) => {
            complain(&error.to_string());
            Ok(code(&error))
        }
    }
}

/// Starts the recording of the node's part; one that records nothing without `--record`.
fn recorder(
    args: &NodeArgs,
    scenario: &Scenario,
    given: &ScenarioArgs,
) -> anyhow::Result<Recorder> {
    let Some(path) = &args.record else { return Ok(Recorder::default()) };
    let file = Place::create(path)
        .map_err(|error| refuse(format!("--record: {}: {error}", path.display())))?;
    let begun = Begun { attended: false, resumed: false };
    record::begin(file, None, scenario, &given.overrides(), begun).context("--record")
}

/// Reports the end of the node's part of a run; returns the exit code.
fn tell(end: &NodeEnd, args: &NodeArgs, output: &mut Output) -> anyhow::Result<u8> {
    for line in end.timing.lines() {
        inform(&format!("servo: {line}"));
    }
    match &end.error {
        None => inform(&format!("MP's node ended the run after {:.1} s", end.seconds)),
        Some(error) => complain(&error.to_string()),
    }
    if args.json {
        let mut told = serde_json::json!({
            "servo_hash": end.servo_hash,
            "time_s": end.seconds,
            "sent_bytes": end.traffic.sent,
            "received_bytes": end.traffic.received,
        });
        if let Some(error) = &end.error {
            told["fault"] = serde_json::json!(error.code());
            told["reason"] = serde_json::json!(error.to_string());
        }
        output.line(&told.to_string())?;
    }
    Ok(end.error.as_ref().map_or(0, code))
}

/// Returns the exit code of an error.
fn code(error: &Error) -> u8 {
    match error {
        Error::NonFatal { cause: NonFatal::Interrupted, .. } => 130,
        Error::Fatal { .. } => 3,
        Error::NonFatal { .. } | Error::System { .. } => 4,
    }
}
