//! One run: composes world, servos, driver and actors from a scenario, performs the task and sums
//! up.
//!
//! - in: a scenario, the options of its start ([`RunOptions`]), and its surroundings
//!   ([`RunContext`])
//! - out: the [`Summary`]
//!
//! No actor imports anything from here. The actors get the controller's half of the scenario only;
//! the verdict comes from the world, if that knows the truth. A run owns its UI actor, but neither
//! page nor terminal: the desk (the channels to them) and the page's server belong to the caller,
//! outlive the run, and serve the next one.

mod bridge_log;
pub(crate) mod calibrate;
mod calibration_poses;
mod check;
mod composition;
mod disturbance;
mod documents;
pub(crate) mod emulate;
mod failure;
mod gate;
mod interrupt;
mod measured_peaks;
pub(crate) mod meeting_cache;
mod node;
mod nodes;
mod operator;
mod options;
mod orders;
mod outcome;
mod pauses;
mod peers;
mod plan;
mod plant_hash;
mod recording;
mod servos;
mod settings;
pub mod show;
mod simulation;
mod staff;
mod task;
pub(crate) mod verify;
pub(crate) mod weigh;
mod witness;
mod world;
mod world_file;

pub use check::check_task;
pub(crate) use documents::numbered;
pub(crate) use interrupt::{ending_signals, signalled};
pub(crate) use node::{NodeContext, NodeEnd, host};
pub use options::{PlantProbe, RunContext, RunOptions, SavedFiles};
pub(crate) use outcome::{exertion, not_begun};
pub use settings::planner;

use crate::actors::trace::Trace;
use crate::desk::RunEnd;
use crate::error::Error;
use crate::hw::driver;
use crate::hw::scene::{MOST_OBJECTS, SceneObject};
use crate::motion::PERIOD;
use crate::record::calibration;
use crate::record::last_second::LastSecond;
use crate::record::recorder::{Entry, Recorder};
use crate::record::summary::{EndedBy, Outcome, Summary};
use crate::scenario::Scenario;
use crate::scenario::keys::Pace;
use bridge_log::BridgeLog;
use composition::Composition;
use disturbance::InjectedFaults;
use failure::not_created;
use interrupt::Interrupt;
use measured_peaks::MeasuredPeaks;
use operator::OperatorChannels;
use outcome::{BY_OPERATOR, Done};
use plan::Plan;
use std::borrow::Cow;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};
use task::{open_logbook, storage};
use tokio::runtime::Runtime;
use world::World;
use world_file::Kept;

/// Longest time that the actors' work may take to end after the run.
const LEAVE: Duration = Duration::from_secs(1);

/// Performs a scenario and returns its summary.
///
/// # Errors
/// If the run could not begin. An error during the run is part of the summary.
pub fn run(scenario: &Scenario, options: RunOptions) -> Result<Summary, Error> {
    run_at(scenario, options, None)
}

/// Performs a scenario with UIs, which show the controller's beliefs and send the operator's
/// inputs; `desk` is the run's end of the channels to the UIs. As long as no input comes, a run of
/// the cube's task is the same to the bit as without UIs. The idle task waits for the operator's
/// orders until it is terminated.
///
/// # Errors
/// The errors of [`run`].
pub fn run_at(
    scenario: &Scenario,
    options: RunOptions,
    desk: Option<RunEnd>,
) -> Result<Summary, Error> {
    run_with(scenario, options, RunContext { desk, ..RunContext::default() })
}

/// Performs a scenario with everything in `context`: the desk of the UIs, a recorder, a recording
/// to verify, files of an interrupted run, a probe of the plant.
///
/// # Errors
/// The errors of [`run`].
pub fn run_with(
    scenario: &Scenario,
    options: RunOptions,
    context: RunContext,
) -> Result<Summary, Error> {
    let begun = Instant::now();
    let (recorder, last_second) = (context.recorder.clone(), context.last_second.clone());
    let (ui, operator) = operator::start_ui(scenario, options, &context)?;
    let interrupt = options
        .interruptible
        .then(|| Interrupt::listen(Arc::clone(&operator.control), operator.stop_button.clone()))
        .transpose()
        .map_err(|e| not_created("interrupt", &e.to_string()))?;
    let tempo = operator.tempo.clone();
    let replays = context.playback.is_some();
    // The UIs exist and show each error from here on.
    match carried_out(scenario, options, context, operator) {
        Ok(done) => {
            // Time in which the run was paused or held back does not count as the run's.
            let worked = tempo.working_time().saturating_duration_since(begun).as_secs_f64();
            let mut summary = outcome::summary(scenario, &done, worked);
            // A signal acts as the operator's terminate, so the summary cannot tell them apart.
            if summary.ended_by == EndedBy::Operator && interrupt.is_some_and(|i| i.came()) {
                summary.ended_by = EndedBy::Interrupt;
                if summary.outcome != Outcome::Solved {
                    // The text after these words says where the cube is.
                    summary.reason = summary.reason.replacen(BY_OPERATOR, "interrupted", 1);
                }
            }
            // A verification only repeats a run, whose files exist already.
            if !replays {
                documents::write(&done.performed.kernel.account().documents, &mut summary);
            }
            // The page says that the run is over before a slow disk may delay the file.
            ui.over(outcome::outcome(&summary));
            summary.last_second = kept_last_second(last_second.as_ref(), &summary);
            let period = (summary.sim_time_s / PERIOD).round() as u64;
            record_end(&recorder, period, &outcome::outcome(&summary).verdict, &summary);
            Ok(summary)
        }
        Err(error) => {
            ui.over(outcome::broken_off(&error));
            let came = interrupt.is_some_and(|i| i.came());
            let error = if came { outcome::interrupted(error) } else { error };
            let (period, mut summary) = (recorder.latest(), not_begun(scenario, &error));
            // An arm that could not be synchronised has moved already.
            summary.last_second = kept_last_second(last_second.as_ref(), &summary);
            if let Some(path) = &summary.last_second {
                tracing::warn!("the last second before the error: {path}");
            }
            record_end(&recorder, period, &error.to_string(), &summary);
            Err(error)
        }
    }
}

/// Writes the last second of a run that a fatal or a system error ended. Returns the path of the
/// file; `None` if there is none, also if it could not be written.
fn kept_last_second(last_second: Option<&LastSecond>, summary: &Summary) -> Option<String> {
    let failed = matches!(summary.ended_by, EndedBy::Fatal | EndedBy::System);
    let last_second = last_second.filter(|_| failed)?;
    match last_second.write(&outcome::outcome(summary).verdict, summary) {
        Ok(path) => path.map(|path| path.display().to_string()),
        Err(why) => {
            tracing::warn!("the last second of the run could not be written: {why}");
            None
        }
    }
}

/// Records the end of a run: the phase "end" with the verdict `word`, and the summary.
fn record_end(recorder: &Recorder, period: u64, word: &str, summary: &Summary) {
    if recorder.is_on() {
        for entry in Entry::end(word, summary) {
            recorder.record(period, || entry);
        }
    }
}

/// Creates the world and the controller, and runs them to their end.
///
/// # Errors
/// If a part of them cannot be created, or an arm cannot be synchronised.
fn carried_out(
    scenario: &Scenario,
    options: RunOptions,
    context: RunContext,
    operator: OperatorChannels,
) -> Result<Done, Error> {
    let RunContext { recorder, last_second, playback, saved, probe, .. } = context;
    let playback = playback.map(|(playback, _)| playback);
    let plan = Plan::of(scenario)?;
    // Files are claimed before the plant exists: the state of another run, finished or still
    // running, must not be overwritten.
    let synced = !saved.unasked && scenario.pace == Pace::Virtual;
    let claim = |path: &PathBuf| Kept::claim(path, synced, operator.trace.clone());
    let kept = unless_unasked(&saved, saved.world.as_ref().map(claim).transpose())?;
    let logbook = unless_unasked(&saved, open_logbook(scenario, &saved))?;
    // Some injected faults act on handles that exist already: the desk's button and the files.
    let faults = InjectedFaults {
        emergency: operator.stop_button.clone(),
        recording: recorder.storage().unwrap_or_default(),
        journal: storage(&logbook).unwrap_or_default(),
        world: kept.as_ref().map(Kept::storage).unwrap_or_default(),
        ..InjectedFaults::new(&scenario.controller)
    };
    let control = &operator.control;
    let (world, sources, notes) = match &playback {
        Some(playback) => {
            World::of_recording(scenario.controller.cameras.len(), playback.clone(), control)
        }
        None if scenario.bridge.kind.is_hardware() => World::of_hardware(scenario, None, control)?,
        // The plant starts in the state that another run left, if this run resumes that one.
        None => {
            let mut plant = plan.plant(scenario)?;
            if let Some(kept) = &kept {
                plant = kept.resume(plant, saved.resume, logbook.has_begun())?;
            }
            let (world, sources) = World::of_plant(scenario, plant, control, &faults)?;
            let kept = match kept.as_ref().map(|kept| world.begin_keeping(kept)) {
                Some(begun) => unless_unasked(&saved, begun.map(Some))?.and(kept),
                None => None,
            };
            (world.keeping(kept), sources, None)
        }
    };
    // The world has drawn its truth around the scenario as read. The controller's beliefs have the
    // calibrated cameras.
    let (believed, uncalibrated) = believed(scenario, &operator.trace);
    let runtime = runtime(scenario.pace, scenario.bridge.kind.is_hardware())?;
    let bridge_log = notes.map(|notes| BridgeLog::start(notes, &believed.controller.cell));
    let bridge_log = bridge_log.transpose()?;
    let composition = Composition {
        scenario: &believed,
        options,
        operator,
        playback,
        last_second,
        measured_peaks: MeasuredPeaks::default(),
        faults,
        probe,
        uncalibrated,
    };
    let done = runtime.block_on(composition.perform((world, sources), plan, logbook));
    // The last notes of the bridge are logged before the summary is shown.
    drop(bridge_log);
    shut_down(runtime);
    done
}

/// Returns `done`, or nothing and a warning in place of its error if no user named the `files`: a
/// run does not end because of a file that no user asked for.
fn unless_unasked<T: Default>(files: &SavedFiles, done: Result<T, Error>) -> Result<T, Error> {
    match done {
        Err(why) if files.unasked => {
            tracing::warn!("this run cannot be continued later: {}", why.cause());
            Ok(T::default())
        }
        done => done,
    }
}

/// Returns the rigid objects of the simulated cell before a run.
///
/// # Errors
/// Reason why the cell cannot be simulated.
pub(crate) fn objects_before(
    scenario: &Scenario,
) -> Result<[Option<SceneObject>; MOST_OBJECTS], String> {
    if scenario.objects().is_empty() {
        return Ok([None; MOST_OBJECTS]);
    }
    simulation::create(scenario, None, None).map(|plant| plant.scene().objects)
}

/// Returns the scenario with its cameras calibrated, if it asks for this, and the cameras that
/// could not be calibrated. Reports the calibrated cell to the recording and the UIs.
fn believed<'a>(scenario: &'a Scenario, trace: &Trace) -> (Cow<'a, Scenario>, Vec<String>) {
    let (believed, uncalibrated) = calibrate::believed(scenario);
    if let Cow::Owned(Scenario { controller, .. }) = &believed {
        // A replay paints with the calibrated cell, so the recording has it as facts.
        let facts = || Entry::Facts(calibration::NAME, calibration::facts(&controller.cell));
        trace.recorder().record(0, facts);
        if let Some(latest) = trace.latest() {
            latest.lock().calibrated = Some(Box::new(controller.cell.clone()));
        }
    }
    (believed, uncalibrated)
}

/// Ends the runtime of the actors. Work that hangs, for example in a disk that does not answer,
/// must not keep the program from ending: its thread is left behind.
fn shut_down(runtime: Runtime) {
    runtime.shutdown_timeout(LEAVE);
}

/// Creates the runtime of the actors: one thread, with paused time unless the wall clock drives the
/// run.
///
/// # Errors
/// If the operating system does not allow it.
fn runtime(pace: Pace, is_hardware: bool) -> Result<Runtime, Error> {
    let mut builder = tokio::runtime::Builder::new_current_thread();
    builder.enable_time().start_paused(pace == Pace::Virtual);
    if is_hardware {
        // Threads for pictures and plans get a lower priority. The actors keep theirs: the servo
        // waits for their heartbeat.
        builder.on_thread_start(driver::step_back);
    }
    builder.build().map_err(|e| not_created("runtime", &e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without a limit, the shutdown would wait for a thread that never ends.
    #[test]
    fn hanging_work_does_not_block_runtime_shutdown() {
        let runtime = runtime(Pace::RealTime, false).unwrap();
        let (end, ended) = std::sync::mpsc::channel::<()>();
        let hangs = move || ended.recv();
        runtime.block_on(async move { drop(tokio::task::spawn_blocking(hangs)) });
        let begun = Instant::now();

        shut_down(runtime);

        assert!(begun.elapsed() < Duration::from_secs(30), "{:?}", begun.elapsed());
        drop(end);
    }
}
