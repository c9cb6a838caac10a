//! The result of one run of a campaign, as a line of its state file.
//!
//! - in: the output of a process and how it ended, or the summary of a run in this process
//! - out: a [`RunResult`]. Its verdict comes from the plant, by way of the run's summary; a run
//!   without a summary has failed

use crate::cube::Facelets;
use crate::record::summary::{EndedBy, Exertion, Outcome, Summary, Violations};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;

/// Longest reason that is kept (characters).
const REASON: usize = 400;
/// Largest number of entries of a list that count as figures.
const LISTED: usize = 8;

/// Verdict on a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The plant is as the scenario demands.
    Solved,
    /// The task ended, but the plant is not as demanded.
    Failed,
    /// The controller reported success, but the plant is not as the scenario demands.
    Untrue,
    /// A fatal error, a system error or the operator ended the run.
    Aborted,
    /// The run exceeded its time by the wall clock.
    TimedOut,
    /// The process ended without a valid summary, as after a panic or a signal.
    Died,
}

impl Verdict {
    /// Returns the verdict in words for people.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Solved => "solved",
            Self::Failed => "failed",
            Self::Untrue => "untrue success",
            Self::Aborted => "aborted",
            Self::TimedOut => "timed out",
            Self::Died => "died",
        }
    }
}

/// Result of one run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunResult {
    /// Seed of the run.
    pub seed: u64,
    /// Verdict on the run.
    pub verdict: Verdict,
    /// Phase in which the run ended; empty if it reached none.
    pub phase: String,
    /// Reason for the verdict, in a sentence.
    pub reason: String,
    /// Drawn values, in the form `KEY=VALUE` of `--set`.
    pub set: Vec<String>,
    /// Figures of the run; `None` if it has no summary or never began.
    pub figures: Option<Figures>,
    /// Time by the wall clock (s).
    pub wall_time_s: f64,
    /// Moment of the end by the wall clock (s since 1970), which gives the pace of a shard. State
    /// files of earlier builds, and runs of a soak, lack it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ended_unix_s: Option<f64>,
}

/// Figures of a run's summary.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Figures {
    /// Largest contact force at the tools while both arms hold the cube (N).
    pub peak_force_n: f64,
    /// Largest torque of that contact (Nm).
    pub peak_torque_nm: f64,
    /// Largest contact force at any tool over the whole run (N). State files of earlier builds lack
    /// some or all of the optional fields.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub peak_contact_n: Option<f64>,
    /// Load of the motors and arms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exertion: Option<Exertion>,
    /// Force limit of the scenario, `control.force_limit_n` (N).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_limit_n: Option<f64>,
    /// Number of times that the controller reported a fallen cube.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drops_noticed: Option<u32>,
    /// Distance in the plant from the centre of the cube to the nearest tool when the run began
    /// (mm).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clearance_mm: Option<f64>,
    /// Number of jaw closings on the cube.
    pub grasps: u32,
    /// Number of face turns.
    pub turns: u32,
    /// Simulated time (s).
    pub sim_time_s: f64,
    /// Mishaps in the plant, whether or not the mission recovered from them.
    pub mishaps: Mishaps,
    /// Number of falls just before or after the error that ended the run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub late_drops: Option<u32>,
    /// Acts that no controller may do, as the plant counted them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub violations: Option<Violations>,
    /// Number of times that the mission read and planned again, by its own count.
    pub recoveries: u32,
    /// Numbers among the figures that task and judge gave, by name; those of a list have its name
    /// with an index.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub of_task: BTreeMap<String, f64>,
    /// Hash over every servo record and message, hexadecimal.
    pub hash: String,
    /// Hash over the parameters that bound the speed and force of the plant, hexadecimal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plant_hash: Option<String>,
}

/// Returns the numbers among the figures of a task, see [`Figures::of_task`].
fn numbers(figures: &BTreeMap<String, Value>) -> BTreeMap<String, f64> {
    let mut numbers = BTreeMap::new();
    for (name, value) in figures {
        match value {
            Value::Array(list) => {
                let each = list.iter().enumerate();
                let each = each.filter_map(|(i, v)| Some((format!("{name}[{i}]"), v.as_f64()?)));
                numbers.extend(each.take(LISTED));
            }
            value => numbers.extend(value.as_f64().map(|number| (name.clone(), number))),
        }
    }
    numbers
}

impl Figures {
    /// Returns whether a contact exceeded the force limit of the scenario; `None` if one of the two
    /// is unknown.
    #[must_use]
    pub(crate) fn exceeds_limit(&self) -> Option<bool> {
        Some(self.peak_contact_n? > self.force_limit_n?)
    }

    /// Returns whether the cube fell more often than the controller reported, apart from falls that
    /// an error left no time to report; `None` if the reports are unknown.
    #[must_use]
    pub(crate) fn has_unnoticed_drop(&self) -> Option<bool> {
        let noticeable = self.mishaps.drops.saturating_sub(self.late_drops.unwrap_or(0));
        Some(noticeable > self.drops_noticed?)
    }
}

/// Mishaps that the plant counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mishaps {
    /// Number of turns whose layer did not move.
    pub jams: u32,
    /// Number of times that a grip slipped.
    pub slips: u32,
    /// Number of times that the cube fell.
    pub drops: u32,
    /// Number of times that the cube popped apart.
    pub pops: u32,
    /// Number of times that the cube was squeezed too hard.
    pub crushed: u32,
    /// Number of unwanted contacts.
    pub collisions: u32,
}

impl Mishaps {
    /// Returns the name and the count of each kind of mishap.
    #[must_use]
    pub fn named(&self) -> [(&'static str, u32); 6] {
        [
            ("jams", self.jams),
            ("slips", self.slips),
            ("drops", self.drops),
            ("pops", self.pops),
            ("crushes", self.crushed),
            ("bumps", self.collisions),
        ]
    }

    /// Returns the number of all mishaps.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.named().iter().map(|(_, n)| u64::from(*n)).sum()
    }

    /// Adds the mishaps of another run.
    pub(super) fn add(&mut self, other: &Self) {
        for (sum, more) in [
            (&mut self.jams, other.jams),
            (&mut self.slips, other.slips),
            (&mut self.drops, other.drops),
            (&mut self.pops, other.pops),
            (&mut self.crushed, other.crushed),
            (&mut self.collisions, other.collisions),
        ] {
            // A state file may hold any numbers.
            *sum = sum.saturating_add(more);
        }
    }
}

/// End of a process.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Ended {
    /// Exit code of a process that ended by itself.
    Code(i32),
    /// Signal that ended the process.
    Signal(i32),
    /// Time after which the process was killed (s).
    TimedOut(f64),
}

impl RunResult {
    /// Makes the result of a run from its summary.
    #[must_use]
    pub(crate) fn of_summary(summary: &Summary, set: Vec<String>) -> Self {
        let (verdict, reason) = judged(summary);
        // JSON has no infinity and no NaN, and a peak that is not a number must not pass for a
        // small one.
        let number = |value: Option<f64>| value.filter(|v| v.is_finite()).unwrap_or(f64::MAX);
        let contacts = summary.sensors.iter().map(|s| number(s.force_n));
        Self {
            seed: summary.seed,
            verdict,
            phase: summary.phases.last().map(|p| p.name.clone()).unwrap_or_default(),
            reason: short(&reason),
            set,
            // The zeros in the summary of a run that never began are not measurements, and must not
            // reach the distributions.
            figures: summary.has_begun().then(|| Figures {
                peak_force_n: number(summary.peak_force_n),
                peak_torque_nm: number(summary.peak_torque_nm),
                peak_contact_n: contacts.reduce(f64::max),
                exertion: summary.exertion,
                force_limit_n: summary.force_limit_n,
                drops_noticed: summary.drops_noticed,
                clearance_mm: summary.clearance_mm,
                grasps: summary.grasps,
                turns: summary.turns,
                sim_time_s: number(Some(summary.sim_time_s)),
                mishaps: Mishaps {
                    jams: summary.jams.unwrap_or(0),
                    slips: summary.slips.unwrap_or(0),
                    drops: summary.drops.unwrap_or(0),
                    pops: summary.pops.unwrap_or(0),
                    crushed: summary.crushed.unwrap_or(0),
                    collisions: summary.collisions.unwrap_or(0),
                },
                late_drops: summary.late_drops,
                violations: summary.violations,
                recoveries: summary.recoveries,
                of_task: numbers(&summary.figures),
                hash: summary.hash.clone(),
                plant_hash: summary.plant_hash.clone(),
            }),
            wall_time_s: summary.wall_time_s,
            ended_unix_s: None,
        }
    }

    /// Makes the result of a run in a process of its own, from its output and its end.
    #[must_use]
    pub(crate) fn of_process(
        seed: u64,
        set: &[String],
        (stdout, stderr): (&str, &str),
        ended: Ended,
        wall_time_s: f64,
    ) -> Self {
        // With `--json` the summary is the last line; anything may precede it.
        let last = stdout.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or_default();
        let without = |verdict, reason: &str| Self {
            seed,
            verdict,
            phase: phase(stderr).to_owned(),
            reason: short(reason),
            set: set.to_vec(),
            figures: None,
            wall_time_s,
            ended_unix_s: None,
        };
        let code = match ended {
            Ended::TimedOut(seconds) => {
                return without(Verdict::TimedOut, &format!("no end within {seconds:.0} s"));
            }
            Ended::Signal(signal) => {
                return without(
                    Verdict::Died,
                    &format!("ended by signal {signal}{}", tail(stderr)),
                );
            }
            Ended::Code(code) => code,
        };
        let Ok(summary) = serde_json::from_str::<Summary>(last) else {
            return without(
                Verdict::Died,
                &format!("no summary, exit code {code}{}", tail(stderr)),
            );
        };
        // Where the seed or the exit code contradicts the summary, neither can be trusted.
        if summary.seed != seed || i32::from(summary.exit_code()) != code {
            let reason =
                format!("exit code {code} contradicts the summary of seed {}", summary.seed);
            return without(Verdict::Died, &reason);
        }
        // The time of the process includes its start, and counts for the rate of a campaign.
        let mut result = Self::of_summary(&summary, set.to_vec());
        result.wall_time_s = wall_time_s;
        result
    }

    /// Returns whether both results are equal, apart from the times by the wall clock.
    #[must_use]
    pub(crate) fn agrees(&self, other: &Self) -> bool {
        let (wall_time_s, ended_unix_s) = (other.wall_time_s, other.ended_unix_s);
        Self { wall_time_s, ended_unix_s, ..self.clone() } == *other
    }
}

/// Returns the verdict on a run and its reason. A mission whose summary states success counts as
/// solved only if the plant's cube in the same summary is solved.
fn judged(summary: &Summary) -> (Verdict, String) {
    let solved = |letters: &str| letters.parse::<Facelets>().is_ok_and(|f| f.is_solved());
    match (summary.outcome, summary.ended_by) {
        // A mission: the outcome must agree with the cube that the same summary holds.
        (Outcome::Solved, EndedBy::Task) if summary.task == "solve" => match &summary.cube_end {
            Some(end) if solved(end) => (Verdict::Solved, summary.reason.clone()),
            Some(_) => (
                Verdict::Untrue,
                "the summary reports a solved cube, but the plant's cube is not solved".into(),
            ),
            None => (Verdict::Failed, "the cube at the end is unknown".into()),
        },
        // The other tasks do not solve the cube, so there is nothing to compare.
        (Outcome::Solved, EndedBy::Task) => (Verdict::Solved, summary.reason.clone()),
        (Outcome::Failed, EndedBy::Task) if summary.untrue => {
            (Verdict::Untrue, summary.reason.clone())
        }
        (Outcome::Failed, EndedBy::Task) => (Verdict::Failed, summary.reason.clone()),
        _ => (Verdict::Aborted, summary.reason.clone()),
    }
}

/// Finds the last phase in the log of a run. Its line reads `  12.34 s  solve`.
fn phase(stderr: &str) -> &str {
    let named = |line: &&str| -> Option<usize> {
        let (time, name) = line.split_once(" s  ")?;
        // Lines of errors have the same form but begin with `!`: `  13.00 s  ! non-fatal`.
        let is_time = time.trim().parse::<f64>().is_ok();
        (is_time && name.starts_with(char::is_alphabetic)).then_some(time.len() + 4)
    };
    let found = stderr.lines().rev().find_map(|line| named(&line).map(|at| &line[at..]));
    found.map_or("", str::trim)
}

/// Returns the message of a panic in `stderr`, or else the last line that does not name a phase.
/// The text begins with a semicolon, since it is appended to a reason; it is empty if there is no
/// line.
fn tail(stderr: &str) -> String {
    let mut lines = stderr.lines();
    let panicked = lines.by_ref().find(|line| line.contains("panicked at"));
    let message = if let Some(place) = panicked {
        // The line below the place holds the message.
        let place = place.split("panicked at").nth(1).unwrap_or_default();
        let place = place.trim().trim_end_matches(':');
        format!("panicked at {place}: {}", lines.next().unwrap_or_default().trim())
    } else {
        let says = |l: &&str| !l.trim().is_empty() && phase(l).is_empty();
        stderr.lines().rev().find(says).unwrap_or_default().to_owned()
    };
    if message.trim().is_empty() { String::new() } else { format!("; {}", message.trim()) }
}

/// Returns the text in one line of at most [`REASON`] characters.
fn short(text: &str) -> String {
    let line = text.replace(['\n', '\r'], " ");
    if line.chars().count() <= REASON {
        return line;
    }
    line.chars().take(REASON).chain("...".chars()).collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Returns the summary of a run that solved its cube.
    fn summary(seed: u64) -> Summary {
        let mut s = Summary::not_started("solve", seed, Some(&"U".repeat(54)), "", EndedBy::Task);
        s.outcome = Outcome::Solved;
        s.hash = "ab".into();
        s.cube_end = Some(Facelets::solved().to_string());
        s
    }

    /// Returns a result with this peak force (N) and 400 s + that number of simulated time, for the
    /// tests of this folder.
    pub(in crate::campaign) fn result(seed: u64, verdict: Verdict, force: f64) -> RunResult {
        let mut result = RunResult::of_summary(&summary(seed), vec![]);
        result.verdict = verdict;
        result.phase = "solve".into();
        result.reason = format!("{} for a reason", verdict.word());
        if let Some(figures) = &mut result.figures {
            figures.peak_force_n = force;
            (figures.peak_contact_n, figures.force_limit_n) = (Some(force + 1.0), Some(20.0));
            figures.sim_time_s = 400.0 + force;
            (figures.turns, figures.grasps) = (19, 24);
        }
        result
    }

    /// Returns the result of a process for seed 3 with this output and end.
    fn process(stdout: &str, stderr: &str, ended: Ended) -> RunResult {
        RunResult::of_process(3, &["a.b=1".into()], (stdout, stderr), ended, 1.5)
    }

    #[test]
    fn run_is_solved_only_if_simulated_cube_is() {
        let mut reported = summary(3);
        let good = process(&format!("noise\n{}\n", reported.json()), "", Ended::Code(0));
        assert_eq!((good.verdict, good.wall_time_s), (Verdict::Solved, 1.5));

        reported.cube_end = Some(Facelets::from(&crate::cube::Cube::scrambled(3)).to_string());
        let bad = process(&reported.json(), "", Ended::Code(0));
        assert_eq!(bad.verdict, Verdict::Untrue);
        assert!(bad.reason.contains("the plant's cube is not"));

        // As the run itself judges such a cube.
        (reported.outcome, reported.untrue) = (Outcome::Failed, true);
        reported.reason = "the controller reports success, but the cube is not solved".into();
        let untrue = process(&reported.json(), "", Ended::Code(1));
        assert_eq!((untrue.verdict, &untrue.reason), (Verdict::Untrue, &reported.reason));
        reported.untrue = false;
        assert_eq!(process(&reported.json(), "", Ended::Code(1)).verdict, Verdict::Failed);
    }

    #[test]
    fn panic_signal_or_timeout_gives_failure_with_reason() {
        let log = "     0.00 s  acquire\n    12.50 s  solve\n    13.00 s  ! non-fatal\n\
                   thread 'main' panicked at src/a.rs:1:2:\nindex out of bounds\nnote: run with\n";

        let died = process("", log, Ended::Code(101));
        assert_eq!((died.verdict, died.phase.as_str()), (Verdict::Died, "solve"));
        assert!(died.reason.contains("panicked at src/a.rs:1:2: index out of bounds"), "{died:?}");
        let killed = process("", log, Ended::Signal(9));
        assert!(killed.reason.starts_with("ended by signal 9; panicked"));
        let quiet = process("", "     0.00 s  acquire\n", Ended::Signal(9));
        assert_eq!(quiet.reason, "ended by signal 9");
        let hung = process(&summary(3).json(), log, Ended::TimedOut(600.0));
        assert_eq!((hung.verdict, hung.figures), (Verdict::TimedOut, None));
    }

    #[test]
    fn a_run_that_never_began_has_no_figures() {
        let reported = Summary::not_started("solve", 3, Some("U"), "no camera", EndedBy::System);

        let result = process(&reported.json(), "", Ended::Code(4));

        assert_eq!((result.verdict, &result.figures), (Verdict::Aborted, &None));
        assert_eq!(result.reason, "no camera");
    }

    #[test]
    fn summary_contradicting_seed_or_exit_code_is_refused() {
        for (reported, code) in [(summary(4).json(), 0), (summary(3).json(), 1)] {
            assert_eq!(process(&reported, "", Ended::Code(code)).verdict, Verdict::Died);
        }
    }

    #[test]
    fn result_shows_peak_contact_force_and_unnoticed_drops() {
        let mut reported = summary(3);
        (reported.force_limit_n, reported.drops, reported.drops_noticed) =
            (Some(20.0), Some(2), Some(1));
        reported.sensors = [("track", 12.0), ("postument", f64::NAN)]
            .map(|(name, force)| crate::record::summary::SensorPeak {
                effector: name.into(),
                force_n: Some(force),
                torque_nm: Some(0.1),
                felt_force_n: force,
                felt_torque_nm: 0.1,
            })
            .into();
        let figures =
            |reported: &Summary| process(&reported.json(), "", Ended::Code(0)).figures.unwrap();

        // A force that is no number counts as above every limit.
        let bad = figures(&reported);
        assert_eq!((bad.peak_contact_n, bad.exceeds_limit()), (Some(f64::MAX), Some(true)));
        assert_eq!(bad.has_unnoticed_drop(), Some(true));
        // An error left no time to notice the second fall.
        reported.late_drops = Some(1);
        assert_eq!(figures(&reported).has_unnoticed_drop(), Some(false));
        reported.late_drops = None;
        reported.sensors.pop();
        reported.drops_noticed = Some(2);
        let good = figures(&reported);
        assert_eq!((good.peak_contact_n, good.exceeds_limit()), (Some(12.0), Some(false)));
        assert_eq!(good.has_unnoticed_drop(), Some(false));
    }

    #[test]
    fn missing_result_fields_are_read_as_unknown() {
        let mut old = result(7, Verdict::Solved, 12.0);
        if let Some(f) = &mut old.figures {
            (f.peak_contact_n, f.force_limit_n, f.drops_noticed) = (None, None, None);
        }
        let line = serde_json::to_string(&old).unwrap();

        assert!(!line.contains("peak_contact_n") && !line.contains("drops_noticed"));
        let read = serde_json::from_str::<RunResult>(&line).unwrap().figures.unwrap();
        assert_eq!((read.exceeds_limit(), read.has_unnoticed_drop()), (None, None));
    }

    #[test]
    fn result_survives_json_round_trip() {
        let result = result(7, Verdict::Failed, 12.345_678_901_234_5);
        let line = serde_json::to_string(&result).unwrap();

        assert_eq!(serde_json::from_str::<RunResult>(&line).unwrap(), result);
    }
}
