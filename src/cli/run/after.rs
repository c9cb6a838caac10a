//! Ways on after a run with a page: the scenario again, perhaps with another seed; the run from its
//! journal; its replay, and its report.
//!
//! - in: scenario and files of the last run; choices of the operator
//! - out: the next run that the operator wants

use crate::cli::output::complain;
use crate::cli::replay;
use crate::cli::report;
use crate::cli::ui::Ui;
use crate::desk::Desk;
use crate::operator::{After, Class, Input, Message, Snapshot};
use crate::record::journal::Journal;
use crate::run::{SavedFiles, signalled};
use crate::scenario::Scenario;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A run that is over.
pub(super) struct AfterRun<'a> {
    /// Scenario of the run.
    pub(super) scenario: &'a Scenario,
    /// Files that outlive the run.
    pub(super) files: &'a SavedFiles,
    /// Recording of the run.
    pub(super) record: Option<&'a Path>,
}

/// The next run that the operator wants.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Next {
    /// The same scenario with this seed.
    Again(u64),
    /// The last run from its journal.
    GoOn,
}

impl AfterRun<'_> {
    /// Waits for the operator's choice. Returns the next run; `None` to leave the program. Replays
    /// and reports until then. A choice that is not possible is told on the page.
    ///
    /// # Errors
    /// No handler of signals can be installed.
    pub(super) fn next(&self, ui: &Ui, desk: &Desk) -> anyhow::Result<Option<Next>> {
        loop {
            self.offer(desk);
            let done = match ui.choice(&desk.run_end())? {
                Input::Again { seed } => return Ok(Some(Next::Again(seed))),
                Input::GoOn => return Ok(Some(Next::GoOn)),
                Input::Replay => self.replay(desk),
                Input::Report => self.report(desk),
                _ => return Ok(None),
            };
            if let Err(why) = done {
                refused(desk, &why);
            }
        }
    }

    /// Returns the journal from which the last run can be continued, if there is one.
    fn journal(&self) -> Option<&PathBuf> {
        let journal = self.files.journal.as_ref()?;
        let resumes = self.scenario.controller.task.properties.resumes;
        (resumes && Journal::interrupted(journal).is_some()).then_some(journal)
    }

    /// Shows on the page which ways on there are.
    fn offer(&self, desk: &Desk) {
        let after = After {
            seed: self.scenario.seed,
            resumes: self.journal().is_some(),
            recorded: self.recording().is_ok(),
        };
        show_changed(desk, |snapshot| snapshot.services.after = Some(after));
    }

    /// Returns the recording of the last run.
    fn recording(&self) -> anyhow::Result<&Path> {
        let path = self.record.filter(|path| path.is_file());
        path.ok_or_else(|| anyhow::anyhow!("the run has no recording: give --record FILE"))
    }

    /// Shows the recording of the last run until the operator leaves it. The page then shows the
    /// end of the run again.
    fn replay(&self, desk: &Desk) -> anyhow::Result<()> {
        let path = self.recording()?;
        let (ui, run_end) = desk.ends();
        let (stage, last) = (run_end.stage.borrow().clone(), run_end.latest());
        let (history, pictures) = (ui.history(Clone::clone), ui.pictures.borrow().clone());
        let (_, scenario) = replay::load(path).map_err(anyhow::Error::msg)?;
        let show = replay::read(path, &scenario).map_err(anyhow::Error::msg)?;
        let stop = signalled()?;
        show.run(&run_end, 1.0, true, &stop);
        let number = run_end.latest().number;
        run_end.replace_history(history);
        run_end.stage.send_replace(stage);
        run_end.pictures.send_replace(pictures);
        let mut snapshot = last.as_ref().clone();
        snapshot.number = number;
        run_end.publish(snapshot);
        Ok(())
    }

    /// Writes the report of the last run beside its recording.
    fn report(&self, desk: &Desk) -> anyhow::Result<()> {
        let recording = self.recording()?.to_owned();
        let output = recording.with_extension("html");
        let told = format!("the report is written to {}", output.display());
        report::run(&report::ReportArgs { recording, output })?;
        tell(desk, Class::Info, &told);
        Ok(())
    }
}

/// Tells in the terminal and on the page why a choice was not possible.
pub(super) fn refused(desk: &Desk, why: &anyhow::Error) {
    complain(&format!("{why:#}"));
    tell(desk, Class::NonFatal, &format!("{why:#}"));
}

/// Shows a message on the page after a run.
fn tell(desk: &Desk, class: Class, text: &str) {
    show_changed(desk, |snapshot| {
        let message = Message {
            number: snapshot.messages.last().map_or(1, |message| message.number + 1),
            time: snapshot.time,
            class,
            source: "ui".to_owned(),
            text: text.to_owned(),
        };
        Arc::make_mut(&mut snapshot.messages).push(message);
    });
}

/// Shows the latest snapshot with a change as the next one.
fn show_changed(desk: &Desk, change: impl FnOnce(&mut Snapshot)) {
    let run_end = desk.run_end();
    let mut snapshot = run_end.latest().as_ref().clone();
    change(&mut snapshot);
    snapshot.number += 1;
    run_end.publish(snapshot);
}
