//! Many runs as one measurement: how often a mission succeeds, and how sure that is.
//!
//! - in: a scenario, a first seed, a number of runs, what is drawn for each
//! - out: success with Wilson's interval, failures by phase with the commands that repeat them, how
//!   forces, grasps, turns and times are spread; as JSON, as a table, as a page
//!
//! | part | what it owns |
//! |---|---|
//! | `statistics` | pure: interval, spread |
//! | [`vary`] | pure: what is drawn for a run by its seed |
//! | `result`, [`tally`] | pure: one run, and the sum of them |
//! | [`state`] | the file that a campaign goes on from |
//! | [`benchmark`], `protocol` | pure: scrambles and scoring; the protocol in Markdown |
//! | [`page`] | pure: the report |
//! | `runner`, `soak` | shells: a process for each run; missions back to back in this one |
//!
//! The verdict of a run is the plant's, out of the run's summary. A run that panics, is killed or
//! does not end in its time is a failure with its seed, never the end of the campaign.

pub mod benchmark;
pub mod page;
pub(crate) mod protocol;
pub(crate) mod result;
pub(crate) mod runner;
pub(crate) mod soak;
pub mod state;
pub(crate) mod statistics;
pub mod tally;
pub mod vary;
