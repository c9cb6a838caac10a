//! `rubik-robot merge`: makes one recording of those of all nodes of a run.
//!
//! - in: the recordings of a run on several hosts
//! - out: one recording, which replay, report and film take as they take any other
//! - exit code: 2 if the recordings do not belong together

use super::output::{clash, complain, refuse};
use super::replay;
use crate::hw::text;
use crate::record::merge::{Owned, Part, check, merge};
use crate::record::place::Place;
use crate::scenario::ControllerConfig;
use crate::scenario::node_keys::NodeConfig;
use clap::Args;
use std::fs::File;
use std::io::{BufReader, BufWriter};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot merge mp.mcap b.mcap -o run.mcap
  rubik-robot replay run.mcap --verify

A run on several hosts has a recording of each node: `--record` of `rubik-robot run` and of each
`rubik-robot node`. The merged recording has the messages of all of them in the time of MP's node.
Recordings of different runs, builds or scenarios, two of one node, and those of a run on one host
are refused. An older FILE is replaced once the new one is complete.
Exit codes: 0 merged, 2 wrong usage, the recordings do not belong together, or a file cannot be
opened or written, 4 system error.")]
pub(super) struct MergeArgs {
    /// Recordings (MCAP) of MP's node and of other nodes of the run
    #[arg(required = true, num_args = 2..)]
    recordings: Vec<PathBuf>,
    /// Write the merged recording to FILE (MCAP)
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

/// Merges the recordings of a run's nodes; returns the exit code.
pub(super) fn run(args: &MergeArgs) -> anyhow::Result<u8> {
    let inputs: Vec<_> = args.recordings.iter().map(|path| ("a recording", Some(path))).collect();
    clash(&inputs, &[("-o", Some(&args.output))])?;
    let mut parts = Vec::new();
    for path in &args.recordings {
        let part = Part::read(&path.display().to_string(), open(path)?).map_err(refuse)?;
        if let Some(flaw) = &part.flaw {
            complain(&format!("{}: {flaw}; what can be read is merged", part.file));
        }
        parts.push((part, path));
    }
    parts.sort_by(|(a, _), (b, _)| a.node.cmp(&b.node));
    check(&parts.iter().map(|(part, _)| part).collect::<Vec<_>>()).map_err(refuse)?;
    let (parts, paths): (Vec<_>, Vec<_>) = parts.into_iter().unzip();
    let files = paths.iter().map(|path| open(path)).collect::<anyhow::Result<Vec<_>>>()?;
    let parts = owners(parts, paths[0])?;
    let (to, mut place) = Place::create(&args.output)
        .map_err(|error| refuse(format!("{}: {error}", args.output.display())))?;
    let merged = match merge(&parts, files, BufWriter::new(to)) {
        Ok(merged) => merged,
        Err(error) => {
            place.discard()?;
            return Err(refuse(error));
        }
    };
    place.sync().and_then(|()| place.rename_to_final()).inspect_err(|_| {
        complain(&format!("{}: the recording is not complete", place.at().display()));
    })?;
    let (count, seconds) = (merged.messages, merged.span as f64 * 1e-9);
    complain(&format!("{}: {count} messages, {seconds:.2} s", args.output.display()));
    Ok(0)
}

/// Opens a recording.
fn open(path: &Path) -> anyhow::Result<BufReader<File>> {
    let file = text::open_any(path).map_err(refuse)?;
    Ok(BufReader::with_capacity(1 << 20, file))
}

/// Returns the parts, each with what belongs to its node by the scenario in the recording `home` of
/// MP's node. Reports the nodes whose recordings are missing.
fn owners(parts: Vec<Part>, home: &Path) -> anyhow::Result<Vec<(Part, Owned)>> {
    let (_, scenario) = replay::load(home).map_err(refuse)?;
    let config = &scenario.controller;
    let nodes = &config.network.nodes;
    for node in nodes.iter().filter(|node| !parts.iter().any(|part| part.node == node.name)) {
        complain(&format!("the recording of node {} is missing: it is left out", node.name));
    }
    let mut owners = Vec::new();
    for part in parts {
        let owned = if part.node.is_empty() {
            // Cameras of nodes whose recordings are missing are in that of MP's node.
            let arms = 0..config.cell.arms.len();
            let is_here = |i: &usize| !nodes.iter().any(|node| node.edps.contains(i));
            Owned { arms: arms.filter(is_here).collect(), ..Owned::default() }
        } else {
            let node = nodes.iter().find(|node| node.name == part.node);
            let node = node.ok_or_else(|| {
                refuse(format!("{}: the scenario has no node {}", part.file, part.node))
            })?;
            owned(config, node)
        };
        owners.push((part, owned));
    }
    Ok(owners)
}

/// Returns what belongs to a node.
fn owned(config: &ControllerConfig, node: &NodeConfig) -> Owned {
    let cameras = node.vsps.iter().filter_map(|&vsp| config.vsps[vsp].camera);
    Owned {
        arms: node.edps.iter().copied().collect(),
        cameras: cameras.map(|camera| config.cell.cameras[camera].name.clone()).collect(),
    }
}
