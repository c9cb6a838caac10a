//! Ways on after a run with a page: the scenario again, perhaps with another seed; the run from its
//! journal; its replay, and its report.
//!
//! - in: options, scenario and files of the last run; choices of the operator
//! - out: options and scenario of the next run

use super::RunArgs;
use crate::cli::output::complain;
use crate::cli::replay;
use crate::cli::report;
use crate::cli::ui::Ui;
use crate::desk::Desk;
use crate::operator::{After, Class, Input, Message};
use crate::record::journal::Journal;
use crate::run::{SIGNALS, SavedFiles};
use crate::scenario::Scenario;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// The runs of one call of the program, of which the last one is over.
pub(super) struct AfterRun {
    /// Options of the last run.
    args: RunArgs,
    /// Recording that the command line names, if it names one.
    record: Option<PathBuf>,
    /// Scenario of the last run.
    scenario: Scenario,
    /// Files that outlive the last run.
    files: SavedFiles,
    /// Number of runs until now.
    runs: u32,
}

/// Options, scenario and files of a run.
pub(super) type Next = (RunArgs, Scenario, SavedFiles);

impl AfterRun {
    /// Begins after the first run.
    pub(super) fn new(args: &RunArgs, scenario: Scenario, files: SavedFiles) -> Self {
        Self { record: args.record.clone(), args: args.clone(), scenario, files, runs: 1 }
    }

    /// Waits for the operator's choice. Returns the next run; `None` to leave the program. A choice
    /// that is not possible is told on the page.
    ///
    /// # Errors
    /// No handler of signals can be installed.
    pub(super) fn next(&mut self, ui: &Ui, desk: &Desk) -> anyhow::Result<Option<Next>> {
        loop {
            self.offer(desk);
            let done = match ui.choice(&desk.run_end())? {
                Input::Again { seed } => match self.again(seed) {
                    Ok(next) => return Ok(Some(next)),
                    Err(why) => Err(why),
                },
                Input::GoOn => match self.go_on() {
                    Ok(next) => return Ok(Some(next)),
                    Err(why) => Err(why),
                },
                Input::Replay => self.replay(desk).map(|()| None),
                Input::Report => self.report().map(Some),
                _ => return Ok(None),
            };
            match done {
                Ok(Some(told)) => tell(desk, Class::Info, &told),
                Ok(None) => {}
                Err(why) => {
                    complain(&format!("{why:#}"));
                    tell(desk, Class::NonFatal, &format!("{why:#}"));
                }
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
        let run_end = desk.run_end();
        let mut snapshot = run_end.latest().as_ref().clone();
        snapshot.number += 1;
        snapshot.services.after = Some(After {
            seed: self.scenario.seed,
            resumes: self.journal().is_some(),
            recorded: self.args.record.as_ref().is_some_and(|path| path.is_file()),
        });
        run_end.publish(snapshot);
    }

    /// Returns the run of the same scenario with this seed.
    fn again(&mut self, seed: u64) -> anyhow::Result<Next> {
        let mut args = self.args.clone();
        args.seed = Some(seed.to_string());
        args.keep.resume = false;
        self.next_with(args)
    }

    /// Returns the run that continues the last one from its journal.
    fn go_on(&mut self) -> anyhow::Result<Next> {
        let mut args = self.args.clone();
        args.keep.resume = true;
        self.next_with(args)
    }

    /// Returns the next run with these options, whose recording has a file of its own.
    fn next_with(&mut self, mut args: RunArgs) -> anyhow::Result<Next> {
        args.record = self.record.as_ref().map(|path| numbered(path, self.runs + 1));
        let (scenario, files) = args.prepare()?;
        self.runs += 1;
        (self.args, self.scenario, self.files) = (args.clone(), scenario.clone(), files.clone());
        Ok((args, scenario, files))
    }

    /// Returns the recording of the last run.
    fn recording(&self) -> anyhow::Result<&Path> {
        let path = self.args.record.as_deref().filter(|path| path.is_file());
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
        let stop = Arc::new(AtomicBool::new(false));
        for signal in SIGNALS {
            signal_hook::flag::register(signal, Arc::clone(&stop))?;
        }
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

    /// Writes the report of the last run beside its recording. Returns what to tell the operator.
    fn report(&self) -> anyhow::Result<String> {
        let recording = self.recording()?.to_owned();
        let output = recording.with_extension("html");
        let told = format!("the report is written to {}", output.display());
        report::run(&report::ReportArgs { recording, output })?;
        Ok(told)
    }
}

/// Shows a message on the page after a run.
fn tell(desk: &Desk, class: Class, text: &str) {
    let run_end = desk.run_end();
    let mut snapshot = run_end.latest().as_ref().clone();
    let number = snapshot.messages.last().map_or(1, |message| message.number + 1);
    let message = Message {
        number,
        time: snapshot.time,
        class,
        source: "ui".to_owned(),
        text: text.to_owned(),
    };
    Arc::make_mut(&mut snapshot.messages).push(message);
    snapshot.number += 1;
    run_end.publish(snapshot);
}

/// Returns the path of a file for the run with this number: `run.mcap` becomes `run-2.mcap`.
fn numbered(path: &Path, run: u32) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(format!("-{run}"));
    if let Some(extension) = path.extension() {
        name.push(".");
        name.push(extension);
    }
    path.with_file_name(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn next_recording_has_number_of_its_run() {
        for (path, next) in [
            ("run.mcap", "run-2.mcap"),
            ("a.b/run", "a.b/run-2"),
            ("/x/cell.run.mcap", "/x/cell.run-2.mcap"),
        ] {
            assert_eq!(numbered(Path::new(path), 2), Path::new(next));
        }
    }
}
