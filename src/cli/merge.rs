//! `rubik-robot campaign merge`: joins the state files of shards and reports on all results.
//!
//! - in: state files, or folders with them
//! - out: the report of a campaign, which equals that of an undivided campaign; on stderr the names
//!   of missing and incomplete shards

use super::campaign_report::ResultArgs;
use super::output::{Output, WRONG, clash, refuse, warn};
use super::shards::{self, Found};
use crate::campaign::state::State;
use crate::campaign::tally::Tally;
use clap::Args;
use std::path::PathBuf;

#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot campaign merge shards/ -o report.html
  rubik-robot campaign merge 1.jsonl 2.jsonl 3.jsonl 4.jsonl -o report.html
  rubik-robot campaign merge 1.jsonl 2.jsonl --at-least 0.995 --json

The report, and the keys of --json, are those of `campaign`. A folder stands for the files
shard-K-of-N.jsonl in it. Missing and incomplete shards are named, and the share of --at-least then
counts as not reached.
Exit codes: 0 the files were merged, 1 the share of --at-least was not reached, 2 wrong usage, or a
file cannot be used, 4 system error.")]
pub(super) struct MergeArgs {
    /// State files that `campaign --state` wrote, one of each shard, or folders
    /// with them
    #[arg(required = true, verbatim_doc_comment)]
    files: Vec<PathBuf>,
    #[command(flatten)]
    result: ResultArgs,
}

/// Merges state files and reports the result; returns the exit code.
pub(super) fn merge(args: &MergeArgs, output: &mut Output) -> anyhow::Result<u8> {
    let MergeArgs { files, result } = args;
    result.check().map_err(refuse)?;
    let files = shards::files(files)?;
    let inputs: Vec<_> =
        files.iter().map(|(path, _)| ("a state file of the campaign", Some(path))).collect();
    clash(&inputs, &[("-o", result.output.as_ref())])?;
    let (mut whole, mut shards): (Option<State>, _) = (None, Vec::new());
    for Found { path, state, .. } in shards::read(&files)? {
        let path = path.display();
        if state.torn {
            warn(&format!("{path}: its last line was cut off and is left out"));
        }
        shards.push(state.header.shard);
        // The first file gives the header with which all others must agree.
        match &mut whole {
            None => whole = Some(state),
            Some(whole) => whole.merge(state).map_err(|why| refuse(format!("{path}: {why}")))?,
        }
    }
    let Some(mut whole) = whole else { return Ok(WRONG) };
    // A part of the shards is reported as well, with a warning.
    let missing = whole.missing_shards(&shards);
    if missing.count > 0 {
        warn(&format!("the campaign is incomplete without the shards {missing}"));
    }
    let tally = Tally::of(&whole);
    if !tally.is_of_one_build() {
        warn("the shards are of different builds: the results measure no single program");
    }
    result.report(&tally, output)
}
