//! Campaigns: many runs as one measurement of how often a mission succeeds, and how certain that
//! share is.
//!
//! - in: a scenario, the first seed, the number of runs, the keys that are drawn for each run
//! - out: the share of solved runs with Wilson's interval, the failures by phase with the commands
//!   that repeat them, the distributions of forces, grasps, turns and times; as JSON, as a table,
//!   as a page
//!
//! | module | contents |
//! |---|---|
//! | `statistics` | pure: interval, distribution |
//! | [`vary`] | pure: the values that a seed draws for its run |
//! | `result`, [`tally`] | pure: one run, the sum of all runs |
//! | [`state`] | the file from which a campaign continues |
//! | `progress` | pure: the progress over the files of all shards |
//! | `scheduler` | pure: the shard of a task of Slurm or Kubernetes |
//! | [`benchmark`], `protocol` | pure: scrambles and scores, the protocol in Markdown |
//! | [`page`] | pure: the report in HTML |
//! | [`mix`] | pure: mixes of faults, the rules for them, the smallest mix that breaks one |
//! | `runner`, `soak` | start runs: each in a process of its own, or in a row in this process |
//!
//! The verdict on a run comes from the plant, by way of the run's summary. A run that panics, is
//! killed or exceeds its time counts as a failure with its seed. It does not end the campaign.

pub mod benchmark;
pub mod mix;
pub mod page;
pub(crate) mod progress;
pub(crate) mod protocol;
pub(crate) mod result;
pub(crate) mod runner;
pub(crate) mod scheduler;
pub(crate) mod soak;
pub mod state;
pub(crate) mod statistics;
pub mod tally;
pub mod vary;
