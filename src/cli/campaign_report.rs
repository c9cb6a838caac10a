//! Options of the report of a campaign, and its output: on stdout, as a page, as an exit code.
//!
//! - in: the summed results, [`Tally`]
//! - out: a table or one line of JSON, a page, 0 or 1 for the share of `--at-least`

use super::output::{Output, complain, inform, save, warn};
use crate::campaign::page;
use crate::campaign::tally::Tally;
use crate::record::place::Place;
use clap::Args;
use std::path::{Path, PathBuf};

/// Options of the report.
#[derive(Debug, Args)]
pub(super) struct ResultArgs {
    /// Exit with 1 if a smaller share of the runs is solved (0 to 1)
    /// [default: no limit]
    #[arg(long, value_name = "SHARE", verbatim_doc_comment)]
    pub(super) at_least: Option<f64>,
    /// Write the report to FILE (HTML)
    #[arg(short, long, value_name = "FILE")]
    pub(super) output: Option<PathBuf>,
    /// End stdout with one line of JSON
    #[arg(long)]
    pub(super) json: bool,
}

impl ResultArgs {
    /// Checks the options before the runs, which may take hours.
    pub(super) fn check(&self) -> Result<(), String> {
        match self.at_least {
            Some(share) if !(0.0..=1.0).contains(&share) => {
                Err(format!("--at-least: {share} is no share: write 0.995 for 99.5 %"))
            }
            _ => Ok(()),
        }?;
        self.output.as_deref().map_or(Ok(()), writable)
    }

    /// Prints a tally, writes its page, and compares it with `--at-least`; returns the exit code.
    pub(super) fn report(&self, tally: &Tally, output: &mut Output) -> anyhow::Result<u8> {
        if !tally.is_complete() {
            inform(&format!("{} of {} runs have a result", tally.runs(), tally.asked));
        }
        if self.json {
            output.line(&tally.json().to_string())?;
        } else {
            output.text(&tally.table())?;
        }
        // The page comes last: if it cannot be written, the results are printed already.
        if let Some(path) = &self.output {
            if tally.runs() > 0 {
                save(path, page::page(tally, self.at_least).as_bytes())?;
                inform(&format!("report: {}", path.display()));
            } else {
                let path = path.display();
                warn(&format!("no run has a result: the file {path} is not written"));
            }
        }
        let Some(share) = self.at_least else { return Ok(0) };
        let (runs, solved) = (tally.runs(), tally.solved);
        // A part of the runs, or runs of different programs, do not measure the share.
        let reason = if !tally.is_complete() || runs == 0 {
            format!("{runs} of {} runs have a result", tally.asked)
        } else if !tally.is_of_one_build() {
            "the runs of different builds are no measurement of one program".to_owned()
        } else if tally.success() < share {
            format!("{solved} of {runs} runs are solved")
        } else {
            return Ok(0);
        };
        complain(&format!("--at-least {share} is not reached: {reason}"));
        Ok(1)
    }
}

/// Checks that a file can be written, before the runs, which may take hours.
pub(super) fn writable(path: &Path) -> Result<(), String> {
    let shown = path.display();
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    if let Some(missing) = folder.filter(|folder| !folder.is_dir()) {
        return Err(format!("-o: there is no folder {}: make it first", missing.display()));
    }
    if path.is_dir() {
        return Err(format!("-o: {shown} is a folder: name a file in it"));
    }
    // Opening a pipe may wait for its reader, so a pipe or a terminal is not tried.
    if path.exists() && !path.is_file() {
        return Ok(());
    }
    // Creating and removing the temporary file tries all rights that the report needs.
    let tried = Place::create(path).and_then(|(_, place)| place.discard());
    tried.map_err(|why| format!("-o: {shown}: {why}"))
}
