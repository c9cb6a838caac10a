//! `rubik-robot campaign status`: the progress of a campaign over all its shards.
//!
//! - in: state files, which the shards may be writing, or folders with them
//! - out: a table or one line of JSON
//! - exit code: 0 all runs have a result, 1 runs are missing

use super::output::{Output, refuse};
use super::shards;
use crate::campaign::progress::{Part, Plan, Progress};
use crate::campaign::state::MOST_RUNS;
use clap::Args;
use std::path::PathBuf;
use std::time::SystemTime;

#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  rubik-robot campaign status shards/
  rubik-robot campaign status shards/ --plan 10000 --cores 500
  rubik-robot campaign status shards/ --json
  until rubik-robot campaign status shards/; do sleep 60; done

The command only reads, so the shards may be at work meanwhile. The time left is that of the slowest
shard at the pace of its latest results. A shard without a result, or without a file, is expected to
have the mean pace of the others. A run counts for its time by the wall clock on one core, so
--jobs must not exceed the number of cores, and the machine must do no other work. --plan scales the
mean of these runs.

Keys of the object of --json:
  scenario, seed, asked, runs, solved, failed (numbers of runs), shards (their number)
  incomplete   shard, runs, asked, changed_unix_s, left_s of each shard with a file but without all
               of its results
  missing      names of the first 20 shards without a file; missing_count: number of all of them
  damaged      number of lines that are no JSON and are left out
  changed_unix_s   moment of the last result (s since 1970); left_s: expected time left (s)
  core_hours   computing time until now; run_s: its distribution over the runs (s: min, median, p95,
               p99, max)
  plan         runs, cores, core_hours, hours, with --plan
Exit codes: 0 all runs have a result, 1 runs are missing, 2 wrong usage, or a file cannot be used,
4 system error.")]
pub(super) struct StatusArgs {
    /// State files that `campaign --state` wrote, one of each shard, or folders
    /// with them
    #[arg(required = true, verbatim_doc_comment)]
    files: Vec<PathBuf>,
    /// Print the core-hours that a campaign of N runs needs, from the runs that it has
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=MOST_RUNS))]
    plan: Option<u64>,
    /// Number of cores at a time for --plan, which then prints the hours as well
    #[arg(long, value_name = "C", requires = "plan",
          value_parser = clap::value_parser!(u64).range(1..=MOST_RUNS))]
    cores: Option<u64>,
    /// End stdout with one line of JSON
    #[arg(long)]
    json: bool,
}

/// Reports the progress of a campaign; returns the exit code.
pub(super) fn status(args: &StatusArgs, output: &mut Output) -> anyhow::Result<u8> {
    let (mut paths, mut parts) = (Vec::new(), Vec::new());
    for found in shards::read(&shards::files(&args.files)?)? {
        paths.push(found.path);
        parts.push(Part { state: found.state, changed_unix_s: found.changed_unix_s });
    }
    let progress = Progress::of(&parts)
        .map_err(|(index, why)| refuse(format!("{}: {why}", paths[index].display())))?;
    let plan = args.plan.map(|runs| Plan { runs, cores: args.cores });
    if args.json {
        output.line(&progress.json(plan).to_string())?;
    } else {
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
        output.text(&progress.table(now.map_or(0.0, |now| now.as_secs_f64()), plan))?;
    }
    Ok(u8::from(!progress.is_complete()))
}
