//! What came of one run of a campaign, as a line of its state file.
//!
//! - in: what a process printed and how it ended
//! - out: a [`RunResult`]: the verdict is the plant's, out of the run's summary; a run without one
//!   has failed

use crate::cube::Facelets;
use crate::record::summary::{EndedBy, Exertion, Outcome, Summary};
use serde::{Deserialize, Serialize};

/// The longest reason that is kept (characters).
const REASON: usize = 400;

/// How a run came out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// What the scenario asks for is so in the plant.
    Solved,
    /// The task ended without that.
    Failed,
    /// A fatal or system error, or a word of the operator, broke it off.
    Aborted,
    /// It had no end within its time by the wall clock.
    TimedOut,
    /// Its process ended without a summary: a panic, a signal.
    Died,
}

impl Verdict {
    /// For people.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Solved => "solved",
            Self::Failed => "failed",
            Self::Aborted => "aborted",
            Self::TimedOut => "timed out",
            Self::Died => "died",
        }
    }
}

/// One run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunResult {
    /// Its seed.
    pub seed: u64,
    /// How it came out.
    pub verdict: Verdict,
    /// The phase in which it ended; empty when it did not come to one.
    pub phase: String,
    /// Why, in a sentence.
    pub reason: String,
    /// What was drawn for it, as behind `--set`.
    pub set: Vec<String>,
    /// Its figures; `None` of a run without a summary, or that never began.
    pub figures: Option<Figures>,
    /// Time by the wall clock (s).
    pub wall_time_s: f64,
}

/// Figures of a run's summary.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Figures {
    /// Largest force of the contact while both arms hold the cube (N).
    pub peak_force_n: f64,
    /// Largest torque of the same (Nm).
    pub peak_torque_nm: f64,
    /// Largest force of the contact at any tool over the whole run (N). State files of earlier
    /// builds have neither this nor the three that follow.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub peak_contact_n: Option<f64>,
    /// How much the arms exerted themselves.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exertion: Option<Exertion>,
    /// Force limit of the scenario, `control.force_limit_n` (N).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_limit_n: Option<f64>,
    /// How often the controller told that the cube had fallen.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drops_noticed: Option<u32>,
    /// Distance of the nearest tool from the cube's centre in the plant when the run began (mm).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clearance_mm: Option<f64>,
    /// Jaw closings.
    pub grasps: u32,
    /// Face turns.
    pub turns: u32,
    /// Simulated time (s).
    pub sim_time_s: f64,
    /// What went wrong in the plant, whether or not it was mended.
    pub mishaps: Mishaps,
    /// Times that the mission began anew, by its own account.
    pub recoveries: u32,
    /// Over every servo record and message, hexadecimal.
    pub hash: String,
    /// Over what bounds the plant's speed and force, hexadecimal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plant_hash: Option<String>,
}

impl Figures {
    /// Whether something was touched with more force than the scenario allows; `None` when nobody
    /// knows.
    #[must_use]
    pub(crate) fn exceeds_limit(&self) -> Option<bool> {
        Some(self.peak_contact_n? > self.force_limit_n?)
    }

    /// Whether the cube fell more often than the controller told; `None` when nobody knows.
    #[must_use]
    pub(crate) fn has_unnoticed_drop(&self) -> Option<bool> {
        Some(self.mishaps.drops > self.drops_noticed?)
    }
}

/// What the plant counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mishaps {
    /// Turns that did not get on.
    pub jams: u32,
    /// Grips that slipped.
    pub slips: u32,
    /// Times that the cube fell.
    pub drops: u32,
    /// Times that it popped.
    pub pops: u32,
    /// Times that it was squeezed too hard.
    pub crushed: u32,
    /// Times that something touched what it should not.
    pub collisions: u32,
}

impl Mishaps {
    /// All with their names.
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

    /// Their number.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.named().iter().map(|(_, n)| u64::from(*n)).sum()
    }

    pub(super) fn add(&mut self, other: &Self) {
        for (sum, more) in [
            (&mut self.jams, other.jams),
            (&mut self.slips, other.slips),
            (&mut self.drops, other.drops),
            (&mut self.pops, other.pops),
            (&mut self.crushed, other.crushed),
            (&mut self.collisions, other.collisions),
        ] {
            *sum = sum.saturating_add(more);
        }
    }
}

/// How a process came to its end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Ended {
    /// With this exit code.
    Code(i32),
    /// By this signal.
    Signal(i32),
    /// It was killed after its time (s).
    TimedOut(f64),
}

impl RunResult {
    /// Of a run that was performed in this process.
    #[must_use]
    pub(crate) fn of_summary(summary: &Summary, set: Vec<String>) -> Self {
        let (verdict, reason) = judged(summary);
        let number = |value: Option<f64>| value.filter(|v| v.is_finite()).unwrap_or(f64::MAX);
        let contacts = summary.sensors.iter().map(|s| number(s.force_n));
        Self {
            seed: summary.seed,
            verdict,
            phase: summary.phases.last().map(|p| p.name.clone()).unwrap_or_default(),
            reason: short(&reason),
            set,
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
                recoveries: summary.recoveries,
                hash: summary.hash.clone(),
                plant_hash: summary.plant_hash.clone(),
            }),
            wall_time_s: summary.wall_time_s,
        }
    }

    /// Of a process of its own, by what it printed and how it ended.
    #[must_use]
    pub(crate) fn of_process(
        seed: u64,
        set: &[String],
        (stdout, stderr): (&str, &str),
        ended: Ended,
        wall_time_s: f64,
    ) -> Self {
        let last = stdout.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or_default();
        let without = |verdict, reason: &str| Self {
            seed,
            verdict,
            phase: phase(stderr).to_owned(),
            reason: short(reason),
            set: set.to_vec(),
            figures: None,
            wall_time_s,
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
        if summary.seed != seed || i32::from(summary.exit_code()) != code {
            let reason = format!("exit code {code} and the summary of seed {}", summary.seed);
            return without(Verdict::Died, &format!("{reason} do not belong together"));
        }
        let mut result = Self::of_summary(&summary, set.to_vec());
        result.wall_time_s = wall_time_s;
        result
    }

    /// Whether both tell of the same run: all but the wall clock's time.
    #[must_use]
    pub(crate) fn agrees(&self, other: &Self) -> bool {
        Self { wall_time_s: other.wall_time_s, ..self.clone() } == *other
    }
}

/// The plant's verdict; what the summary says of the cube must agree with what it says of the
/// outcome.
fn judged(summary: &Summary) -> (Verdict, String) {
    let solved = |letters: &str| letters.parse::<Facelets>().is_ok_and(|f| f.is_solved());
    match (summary.outcome, summary.ended_by) {
        (Outcome::Solved, EndedBy::Task) if summary.task == "solve" => match &summary.cube_end {
            Some(end) if solved(end) => (Verdict::Solved, summary.reason.clone()),
            Some(_) => (Verdict::Failed, "the summary says solved, the plant's cube is not".into()),
            None => (Verdict::Failed, "nobody knows the cube at the end".into()),
        },
        (Outcome::Solved, EndedBy::Task) => (Verdict::Solved, summary.reason.clone()),
        (Outcome::Failed, EndedBy::Task) => (Verdict::Failed, summary.reason.clone()),
        _ => (Verdict::Aborted, summary.reason.clone()),
    }
}

/// The phase that a run told last: lines such as `  12.34 s  solve`.
fn phase(stderr: &str) -> &str {
    let named = |line: &&str| -> Option<usize> {
        let (time, name) = line.split_once(" s  ")?;
        let is_time = time.trim().parse::<f64>().is_ok();
        (is_time && name.starts_with(char::is_alphabetic)).then_some(time.len() + 4)
    };
    let found = stderr.lines().rev().find_map(|line| named(&line).map(|at| &line[at..]));
    found.map_or("", str::trim)
}

/// What a process said of its end: a panic's message, else its last words.
fn tail(stderr: &str) -> String {
    let mut lines = stderr.lines();
    let panicked = lines.by_ref().find(|line| line.contains("panicked at"));
    let told = if let Some(place) = panicked {
        let place = place.split("panicked at").nth(1).unwrap_or_default();
        let place = place.trim().trim_end_matches(':');
        format!("panicked at {place}: {}", lines.next().unwrap_or_default().trim())
    } else {
        let says = |l: &&str| !l.trim().is_empty() && phase(l).is_empty();
        stderr.lines().rev().find(says).unwrap_or_default().to_owned()
    };
    if told.trim().is_empty() { String::new() } else { format!("; {}", told.trim()) }
}

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

    fn summary(seed: u64) -> Summary {
        let mut s = Summary::not_started("solve", seed, Some(&"U".repeat(54)), "", EndedBy::Task);
        s.outcome = Outcome::Solved;
        s.hash = "ab".into();
        s.cube_end = Some(Facelets::solved().to_string());
        s
    }

    /// A result for tests of what is above.
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

    fn process(stdout: &str, stderr: &str, ended: Ended) -> RunResult {
        RunResult::of_process(3, &["a.b=1".into()], (stdout, stderr), ended, 1.5)
    }

    #[test]
    fn a_solved_run_is_solved_by_the_plants_cube() {
        let mut told = summary(3);
        let good = process(&format!("noise\n{}\n", told.json()), "", Ended::Code(0));
        assert_eq!((good.verdict, good.wall_time_s), (Verdict::Solved, 1.5));

        told.cube_end = Some(Facelets::from(&crate::cube::Cube::scrambled(3)).to_string());
        let bad = process(&told.json(), "", Ended::Code(0));
        assert_eq!(bad.verdict, Verdict::Failed);
        assert!(bad.reason.contains("the plant's cube is not"));
    }

    #[test]
    fn a_panic_a_signal_and_a_hang_are_failures_with_phase_and_reason() {
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
        let told = Summary::not_started("solve", 3, Some("U"), "no camera", EndedBy::System);

        let result = process(&told.json(), "", Ended::Code(4));

        assert_eq!((result.verdict, &result.figures), (Verdict::Aborted, &None));
        assert_eq!(result.reason, "no camera");
    }

    #[test]
    fn a_summary_that_does_not_belong_to_the_run_is_none() {
        for (told, code) in [(summary(4).json(), 0), (summary(3).json(), 1)] {
            assert_eq!(process(&told, "", Ended::Code(code)).verdict, Verdict::Died);
        }
    }

    #[test]
    fn the_largest_contact_of_any_tool_counts_and_a_drop_that_nobody_told() {
        let mut told = summary(3);
        (told.force_limit_n, told.drops, told.drops_noticed) = (Some(20.0), Some(2), Some(1));
        told.sensors = [("track", 12.0), ("postument", f64::NAN)]
            .map(|(name, force)| crate::record::summary::SensorPeak {
                effector: name.into(),
                force_n: Some(force),
                torque_nm: Some(0.1),
                felt_force_n: force,
                felt_torque_nm: 0.1,
            })
            .into();
        let figures = |told: &Summary| process(&told.json(), "", Ended::Code(0)).figures.unwrap();

        let bad = figures(&told);
        assert_eq!((bad.peak_contact_n, bad.exceeds_limit()), (Some(f64::MAX), Some(true)));
        assert_eq!(bad.has_unnoticed_drop(), Some(true));
        told.sensors.pop();
        told.drops_noticed = Some(2);
        let good = figures(&told);
        assert_eq!((good.peak_contact_n, good.exceeds_limit()), (Some(12.0), Some(false)));
        assert_eq!(good.has_unnoticed_drop(), Some(false));
    }

    #[test]
    fn a_line_of_an_earlier_build_is_read_and_what_it_lacks_is_not_known() {
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
    fn a_result_comes_back_from_its_line() {
        let result = result(7, Verdict::Failed, 12.345_678_901_234_5);
        let line = serde_json::to_string(&result).unwrap();

        assert_eq!(serde_json::from_str::<RunResult>(&line).unwrap(), result);
    }
}
