//! Outcome of a run: the plant's verdict on the controller's account, and the summary.
//!
//! - in: the end of MP's work, the kernel's account, and the facts of the plant (none for hardware)
//! - out: the summary, and its words for the operator
//!
//! | case, the first that applies | outcome | ended by |
//! |---|---|---|
//! | error of an actor, an arm or the bridge | aborted | system or fatal error |
//! | arms moved by hand until the operator ended the run | solved | operator |
//! | task without an end | aborted | operator |
//! | hardware | as the controller believes | task |
//! | the controller believes it is done, and the plant confirms it | solved | task |
//! | any other | failed | task |
//!
//! The judge of the task says what the plant confirms. A task without a judge is believed.

use super::measured_peaks::MeasuredPeaks;
use super::task::Performed;
use crate::actors::mp::Ending;
use crate::cell::MOST_ARMS;
use crate::error::{Error, NonFatal};
use crate::hw::plant::verdict::{self, Event};
use crate::hw::plant::{self, Incident, Verdict};
use crate::hw::text::with_commands_of;
use crate::operator::{OutcomeView, run_remedy};
use crate::record::summary::{
    Accident, EndedBy, Exertion, LinkUse, Outcome, Phase, SensorPeak, Summary, Violations,
};
use crate::registry::{Judgement, Truth};
use crate::scenario::{ControllerConfig, Scenario};
use crate::servo::period::Length;
use serde_json::Value;
use std::collections::BTreeMap;
use std::time::Instant;

/// Reason of a run that its operator ended.
pub(super) const BY_OPERATOR: &str = "terminated by the operator";

/// Facts at the end of a run.
pub(super) struct Done {
    /// Judgement on the plant; `None` for hardware, and for a task without a judge.
    pub(super) judgement: Option<Judgement>,
    /// Result of the task.
    pub(super) performed: Performed,
    /// Facts of the plant; `None` for hardware.
    pub(super) truth: Option<Truth>,
    /// Whether the task was to move the arms by hand, which only the operator ends.
    pub(super) by_hand: bool,
    /// Hash over servo records and messages.
    pub(super) hash: String,
    /// Hash over servo records.
    pub(super) servo_hash: String,
    /// Cameras that could not be calibrated before the run, each with the reason.
    pub(super) uncalibrated: Vec<String>,
    /// Use of the links to other nodes.
    pub(super) links: Vec<LinkUse>,
    /// Largest forces that the wrists of this node's arms measured.
    pub(super) measured_peaks: MeasuredPeaks,
}

/// Returns the summary of a run that `error` ended before its task began.
#[must_use]
pub(crate) fn not_begun(scenario: &Scenario, error: &Error) -> Summary {
    let cube = (!scenario.bridge.kind.is_hardware()).then(|| scenario.cube().to_string());
    without_account(scenario, error, cube.as_deref())
}

/// Returns the summary of a run that `error` ended in its task without an account: the plant may
/// have moved, so its figures are unknown.
pub(super) fn unaccounted(scenario: &Scenario, error: &Error) -> Summary {
    let Summary { cube_start, .. } = not_begun(scenario, error);
    Summary { cube_start, drops_noticed: None, ..without_account(scenario, error, None) }
}

/// Returns the summary of a run that has only its error. `cube` is that of the plant, if it is sure
/// not to have changed.
fn without_account(scenario: &Scenario, error: &Error, cube: Option<&str>) -> Summary {
    let ended_by = match error {
        Error::NonFatal { cause: NonFatal::Terminated, .. } => EndedBy::Operator,
        Error::NonFatal { cause: NonFatal::Interrupted, .. } => EndedBy::Interrupt,
        Error::NonFatal { .. } => EndedBy::Task,
        Error::Fatal { .. } => EndedBy::Fatal,
        Error::System { .. } => EndedBy::System,
    };
    let (task, reason) = (scenario.controller.task.word(), error.cause());
    let summary = Summary::not_started(task, scenario.seed, cube, &reason, ended_by);
    let program = &scenario.task.program().program;
    let remedy = run_remedy(error).map(|text| with_commands_of(program, text).into_owned());
    let detected_by = Some(error.detected_by());
    Summary { fault: Some(error.code()), detected_by, remedy, ..summary }
}

/// Returns the summary of a run that took `wall_time_s` by the wall clock.
pub(super) fn summary(scenario: &Scenario, done: &Done, wall_time_s: f64) -> Summary {
    let (config, seed) = (&scenario.controller, scenario.seed);
    // Length of a servo period (s).
    let period = scenario.real_time.period;
    let program = &scenario.task.program().program;
    let truth = done.truth.as_ref();
    let verdict = truth.map(|truth| &truth.verdict);
    let Performed { ending, ended, .. } = &done.performed;
    let account = Figures(done.performed.kernel.account().figures);
    let end = truth.map(Truth::end);
    let of_program = |remedy: &str| with_commands_of(program, remedy).into_owned();
    let noticed = account.count("drops_noticed");
    // Everything that only the plant knows stays `None` for hardware.
    let judged = |name: &str| done.judgement.as_ref()?.figures.get(name)?.as_f64();
    let (outcome, reason, ended_by) = verdict_of(done);
    let counts = verdict.map(|v| v.counts);
    Summary {
        outcome,
        reason,
        ended_by,
        fault: ending.error.as_ref().map(Error::code),
        detected_by: ending.error.as_ref().map(Error::detected_by),
        remedy: ending.error.as_ref().and_then(run_remedy).map(of_program),
        untrue: outcome == Outcome::Failed && ending.finish.as_ref().is_some_and(|f| f.achieved),
        last_second: None,
        task: config.task.word().to_owned(),
        seed,
        cube_start: truth.map(|t| t.start.to_string()),
        cube_end: end.map(|end| end.to_string()),
        identified: account.text("identified"),
        solution: account.text("solution"),
        expected_s: account.number("expected_s"),
        executed: account.text("executed").unwrap_or_default(),
        turns: account.count("turns"),
        grasps: account.count("grasps"),
        recoveries: account.count("recoveries"),
        // The end of MP's work: the withdrawal of the hand afterwards does not count.
        sim_time_s: ending.end,
        paused_s: done.performed.paused,
        wall_time_s,
        peak_force_n: verdict.map(|v| v.peak_force),
        peak_torque_nm: verdict.map(|v| v.peak_torque),
        sensors: sensor_peaks(config, ending, &done.measured_peaks, verdict),
        exertion: verdict.map(|v| exertion(&v.exertion)),
        jams: truth.map(|t| t.jams),
        slips: counts.map(|c| c.slips),
        drops: counts.map(|c| c.drops),
        drops_noticed: Some(noticed),
        returned: verdict.map(Verdict::is_back),
        force_limit_n: Some(config.control.force_limit),
        // Infinite for a cell without arms, which JSON has no number for.
        clearance_mm: truth.map(|t| t.clearance * 1e3).filter(|mm| mm.is_finite()),
        pops: counts.map(|c| c.pops),
        crushed: counts.map(|c| c.crushed),
        collisions: counts.map(|c| c.collisions),
        late_drops: truth.map(|truth| late_drops(truth, ending, period, noticed)),
        violations: counts.map(|c| violations(&c.violations)),
        accidents: verdict.map(|v| accidents(v, config, period)),
        turned_deg: judged("layer_turned_deg"),
        figures: figures(done, &account),
        phases: phases(ending, *ended),
        hash: done.hash.clone(),
        servo_hash: done.servo_hash.clone(),
        uncalibrated: done.uncalibrated.clone(),
        links: done.links.clone(),
        plant_hash: truth.map(|t| format!("{:08x}", t.bounds)),
    }
}

/// Time that jaws take to close when the cube is gone, and MP to notice it (s).
const NOTICE: f64 = 0.5;

/// Returns the number of falls after which an error ended the run before they could be noticed, or
/// a power cut the run that this one resumes. `period` is the length of a servo period (s), and
/// `noticed` the number of falls that the controller has noticed.
fn late_drops(truth: &Truth, ending: &Ending, period: f64, noticed: u32) -> u32 {
    let late = |event: &&Event| {
        let fell = matches!(event.what, Incident::Drop { .. });
        fell && event.period as f64 * period > ending.end - NOTICE
    };
    let events = || truth.verdict.events.iter().filter(late).count() as u32;
    // The earlier run, or this one, may have noticed the fall.
    let unseen = truth.falls_at_start && noticed < truth.verdict.counts.drops;
    u32::from(unseen) + ending.error.as_ref().map_or(0, |_| events())
}

/// Returns the plant's counts of what no controller may do, for the summary.
fn violations(counts: &verdict::Violations) -> Violations {
    let verdict::Violations { let_fall, restarts, moved_after_stop } = *counts;
    Violations { let_fall, restarts, moved_after_stop }
}

/// Returns the duration of each phase in simulated time and by the wall clock; `ended` is the end
/// of the last phase by the wall clock.
fn phases(ending: &Ending, ended: Instant) -> Vec<Phase> {
    // A phase ends where the next one begins.
    let ends = ending.phases.iter().skip(1).map(|p| (p.1, p.2)).chain([(ending.end, ended)]);
    ending
        .phases
        .iter()
        .zip(ends)
        .map(|((name, begin, began), (end, ended))| Phase {
            name: (*name).into(),
            sim_time_s: end - begin,
            wall_time_s: ended.saturating_duration_since(*began).as_secs_f64(),
        })
        .collect()
}

/// Returns the largest force and torque at each wrist: the true ones of the plant, and those that
/// the sensor measured.
fn sensor_peaks(
    config: &ControllerConfig,
    ending: &Ending,
    measured: &MeasuredPeaks,
    verdict: Option<&Verdict>,
) -> Vec<SensorPeak> {
    let arms = config.cell.arms.iter().take(MOST_ARMS).enumerate();
    arms.map(|(i, arm)| {
        // The records have each period of this node's arms; the VSP knows those of other nodes.
        let (force, torque) = measured.peak(i);
        let looked = ending.forces.arms.get(i).copied().unwrap_or_default();
        SensorPeak {
            effector: arm.name.clone(),
            force_n: verdict.map(|v| v.arm_peak_force[i]),
            torque_nm: verdict.map(|v| v.arm_peak_torque[i]),
            felt_force_n: force.max(looked.peak_force),
            felt_torque_nm: torque.max(looked.peak_torque),
        }
    })
    .collect()
}

/// Converts the plant's largest loads of motors and arms to the units of a summary.
pub(crate) fn exertion(most: &plant::Exertion) -> Exertion {
    Exertion {
        current_share: most.current,
        heat_share: most.heat,
        motor_speed_rad_s: most.motor_speed,
        near_person_mm_s: most.near_person * 1e3,
        arms_apart_mm: most.arms_apart.map(|least| least * 1e3),
    }
}

/// Returns the accidents in the plant, each with its time.
fn accidents(verdict: &Verdict, config: &ControllerConfig, period: f64) -> Vec<Accident> {
    let names: Vec<&str> = config.cell.arms.iter().map(|arm| arm.name.as_str()).collect();
    let period = Length::of_seconds(period).seconds();
    let events =
        verdict.described_events(&names, period).filter(|(_, is_accident, _)| *is_accident);
    events.map(|(time_s, _, what)| Accident { time_s, what }).collect()
}

/// Figures that have keys of their own in a summary.
const OWN_KEYS: [&str; 9] = [
    "identified",
    "solution",
    "expected_s",
    "executed",
    "turns",
    "grasps",
    "recoveries",
    "drops_noticed",
    "layer_turned_deg",
];

/// Returns the figures of the task that have no key of their own; those of the plant count more
/// than those that the kernel reports.
fn figures(done: &Done, account: &Figures) -> BTreeMap<String, Value> {
    let judged = done.judgement.iter().flat_map(|judgement| &judgement.figures);
    let all = account.0.iter().chain(judged);
    all.filter(|(name, _)| !OWN_KEYS.contains(&name.as_str()))
        .map(|(name, figure)| (name.clone(), figure.clone()))
        .collect()
}

/// Figures of a kernel's account, by name.
struct Figures(BTreeMap<String, Value>);

impl Figures {
    /// Returns the text with this name; `None` if there is none.
    fn text(&self, name: &str) -> Option<String> {
        self.0.get(name)?.as_str().map(str::to_owned)
    }

    /// Returns the number with this name; `None` if there is none.
    fn number(&self, name: &str) -> Option<f64> {
        self.0.get(name)?.as_f64()
    }

    /// Returns the count with this name; 0 if there is none.
    fn count(&self, name: &str) -> u32 {
        let count = self.0.get(name).and_then(Value::as_u64).unwrap_or_default();
        u32::try_from(count).unwrap_or(u32::MAX)
    }
}

/// Returns the verdict on a run, its reason and the cause of its end. The plant must confirm the
/// controller's success. On hardware the controller's account decides.
fn verdict_of(done: &Done) -> (Outcome, String, EndedBy) {
    let ending = &done.performed.ending;
    let whereabouts = &done.performed.kernel.account().whereabouts;
    // Any error aborts, even one after the goal was reached.
    if let Some(error) = &ending.error {
        let ended_by =
            if matches!(error, Error::System { .. }) { EndedBy::System } else { EndedBy::Fatal };
        return (Outcome::Aborted, error.cause() + &place_clause(whereabouts), ended_by);
    }
    if ending.finish.is_none() && done.by_hand {
        let reason = "the arms were moved by hand until the operator ended the run".to_owned();
        return (Outcome::Solved, reason, EndedBy::Operator);
    }
    // A task without an end and without an error was terminated.
    let Some(finish) = &ending.finish else {
        let reason = format!("{BY_OPERATOR}{}", place_clause(whereabouts));
        return (Outcome::Aborted, reason, EndedBy::Operator);
    };
    if done.truth.is_none() {
        let outcome = if finish.achieved { Outcome::Solved } else { Outcome::Failed };
        let reason = format!("{}, as the controller reports", finish.reason);
        return (outcome, reason, EndedBy::Task);
    }
    let (right, words) = match &done.judgement {
        None => (true, finish.reason.clone()),
        Some(Judgement { right, words, .. }) => (*right, words.clone()),
    };
    match (finish.achieved, right) {
        (true, true) => (Outcome::Solved, words, EndedBy::Task),
        (true, false) => {
            let reason = format!("the controller reports success, but {words}");
            (Outcome::Failed, reason, EndedBy::Task)
        }
        (false, _) => (Outcome::Failed, finish.reason.clone(), EndedBy::Task),
    }
}

/// Returns `whereabouts`, the place of the cube, as a clause to be added to a reason; empty if it
/// is unknown.
fn place_clause(whereabouts: &str) -> String {
    if whereabouts.is_empty() { String::new() } else { format!("; {whereabouts}") }
}

/// Returns the outcome of a run as the UIs show it.
pub(super) fn outcome(summary: &Summary) -> OutcomeView {
    let verdict = match (summary.outcome, summary.task.as_str()) {
        (Outcome::Solved, "solve") => "solved",
        (Outcome::Solved, _) => "done",
        (Outcome::Failed, _) => "failed",
        (Outcome::Aborted, _) => "aborted",
    };
    let mut figures = vec![("simulated time".to_owned(), summary.whole_run())];
    figures.extend(summary.figure_rows());
    figures.push(("executed".to_owned(), summary.executed.clone()));
    if let Some(fault) = summary.fault {
        figures.push(("fault code".to_owned(), fault.to_string()));
    }
    if let Some(detected_by) = &summary.detected_by {
        figures.push(("detected by".to_owned(), detected_by.clone()));
    }
    figures.push(("hash".to_owned(), summary.hash.clone()));
    figures.push(("servo hash".to_owned(), summary.servo_hash.clone()));
    OutcomeView {
        verdict: verdict.to_owned(),
        good: summary.outcome == Outcome::Solved,
        reason: summary.reason.clone(),
        time: Some(summary.sim_time_s),
        figures,
    }
}

/// Returns the outcome, as the UIs show it, of a run that an error ended before its task.
pub(super) fn broken_off(error: &Error) -> OutcomeView {
    OutcomeView {
        verdict: "aborted".to_owned(),
        good: false,
        reason: error.cause(),
        time: None,
        figures: vec![("detected by".to_owned(), error.detected_by())],
    }
}

/// Returns the error of a run that a signal ended: a termination gets the signal as its cause, any
/// other error is unchanged.
pub(super) fn interrupted(error: Error) -> Error {
    match error {
        Error::NonFatal { actor, place, cause: NonFatal::Terminated } => {
            Error::NonFatal { actor, place, cause: NonFatal::Interrupted }
        }
        other => other,
    }
}
