//! A soak: missions in a row in one process, to find growth of its memory and drift of the
//! missions.
//!
//! - in: one scenario for each seed, which are repeated in turn; hours of simulated time
//! - out: at each tenth of the time the memory and speed of the process, and the drift of repeated
//!   missions
//!
//! | fault | threshold | reason |
//! |---|---|---|
//! | memory in use grows | [`GROWTH`] or [`GROWTH_MIB`] | counted after the second tenth |
//! | a repeated mission differs | none | a mission repeats to the bit |

use super::result::{Figures, RunResult, Verdict};
use crate::record::summary::EndedBy;
use crate::run::{self, RunOptions};
use crate::scenario::Scenario;
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Number of parts of a soak, each of which ends with a report.
pub(crate) const PARTS: usize = 10;
/// Share by which the memory may grow after the second tenth of the soak.
const GROWTH: f64 = 0.05;
/// Growth of the memory that is allowed even if it exceeds [`GROWTH`] (MiB).
const GROWTH_MIB: f64 = 8.0;

/// Report at the end of a tenth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Tenth {
    /// Simulated time since the start (h).
    pub hours: f64,
    /// Number of missions since the start.
    pub missions: u64,
    /// Resident memory of the process (MiB); `None` where the system does not report it.
    pub resident_mib: Option<f64>,
    /// Simulated time over wall-clock time in this tenth.
    pub times_real_time: f64,
    /// Mean simulated time of a mission in this tenth (s).
    pub mission_s: f64,
    /// Largest difference in this tenth between the simulated times of a mission and of the first
    /// mission with its seed (s).
    pub drift_s: f64,
}

/// Result of a soak.
#[derive(Debug, Clone, Default)]
pub(crate) struct Soak {
    /// Report of each tenth.
    pub tenths: Vec<Tenth>,
    /// Results of all missions, in their order.
    pub results: Vec<RunResult>,
    /// Number of repeated missions, and number of these that differed or had no figures to compare.
    pub repeated: (u64, u64),
}

impl Soak {
    /// Returns how much the memory of the process grew from the end of the second tenth of the soak
    /// to the end of the last one (MiB).
    #[must_use]
    pub(crate) fn growth_mib(&self) -> Option<f64> {
        Some(self.tenths.last()?.resident_mib? - self.tenths.get(1)?.resident_mib?)
    }

    /// Returns whether the memory stayed within its bounds; `None` before the end, or where the
    /// system does not report it.
    #[must_use]
    pub(crate) fn is_flat(&self) -> Option<bool> {
        // The growth of the first two tenths includes the start of the process, so it does not
        // count.
        let base = self.tenths.get(1)?.resident_mib?;
        (self.tenths.len() == PARTS).then_some(())?;
        Some(self.growth_mib()? <= (GROWTH * base).max(GROWTH_MIB))
    }

    /// Counts the solved missions.
    #[must_use]
    pub(crate) fn solved(&self) -> u64 {
        self.results.iter().filter(|r| r.verdict == Verdict::Solved).count() as u64
    }

    /// Returns whether the soak passed: ten tenths, flat memory, repeated missions, and none of
    /// these different from its first run. Unknown memory counts as not flat.
    #[must_use]
    pub(crate) fn is_steady(&self) -> bool {
        self.unsteady_reason().is_none()
    }

    /// Returns the reason why the soak is not steady, if it is not.
    #[must_use]
    pub(crate) fn unsteady_reason(&self) -> Option<String> {
        if self.tenths.len() < PARTS {
            return Some("it ended before its last tenth".to_owned());
        }
        // A soak that measured or compared too little must not pass.
        match (self.is_flat(), self.repeated) {
            (None, _) => Some("its memory use could not be read".to_owned()),
            (Some(false), _) => {
                Some(format!("its memory grew by {:.1} MiB", self.growth_mib().unwrap_or_default()))
            }
            (_, (_, differently @ 1..)) => {
                Some(format!("{differently} repeated missions differ from their first run"))
            }
            (_, (0, _)) => Some("no mission was repeated, so none was compared".to_owned()),
            _ => None,
        }
    }

    /// Returns the share of solved missions; 0 without missions.
    #[must_use]
    pub(crate) fn success(&self) -> f64 {
        self.solved() as f64 / self.results.len().max(1) as f64
    }

    /// Returns the result as one JSON object.
    #[must_use]
    pub(crate) fn json(&self) -> Value {
        let failures = self.results.iter().filter(|r| r.verdict != Verdict::Solved);
        let failures: Vec<_> = failures
            .map(|f| json!({"seed": f.seed, "phase": f.phase, "reason": f.reason}))
            .collect();
        json!({
            "soak_h": self.tenths.last().map_or(0.0, |t| t.hours),
            "runs": self.results.len(), "solved": self.solved(), "failures": failures,
            "tenths": self.tenths, "growth_mib": self.growth_mib(), "memory_flat": self.is_flat(),
            "repeated": self.repeated.0, "repeated_differently": self.repeated.1,
            "drift_s": self.tenths.iter().map(|t| t.drift_s).fold(0.0, f64::max),
            "steady": self.is_steady(),
        })
    }

    /// Adds the result of a mission. Returns its drift: how far its simulated time is from that of
    /// the first mission with the same seed (s). `firsts` holds the figures of these first missions
    /// by seed.
    fn take(&mut self, result: RunResult, firsts: &mut BTreeMap<u64, Option<Figures>>) -> f64 {
        let mut drift = 0.0;
        if let Some(first) = firsts.get(&result.seed) {
            let both = result.figures.as_ref().zip(first.as_ref());
            drift = both.map_or(0.0, |(again, first)| (again.sim_time_s - first.sim_time_s).abs());
            // All figures are compared, with the hash: missions of equal time may still differ.
            self.repeated.0 += 1;
            self.repeated.1 += u64::from(both.is_none_or(|(again, first)| again != first));
        } else {
            firsts.insert(result.seed, result.figures.clone());
        }
        self.results.push(result);
        drift
    }
}

/// Performs a soak: the scenarios in turn and over again, until `hours` of simulated time are over
/// or `stop` is set. Calls `report` at the end of each tenth.
pub(crate) fn soak(
    scenarios: &[Scenario],
    hours: f64,
    stop: &AtomicBool,
    mut report: impl FnMut(&Tenth),
) -> Soak {
    let mut soak = Soak::default();
    let mut firsts = BTreeMap::new();
    // Simulated time so far (s); simulated time and missions, and wall clock, when the present
    // tenth began.
    let (mut time, mut begun, mut clock) = (0.0, (0.0, 0), Instant::now());
    let mut drift: f64 = 0.0;
    for scenario in scenarios.iter().cycle() {
        if stop.load(Ordering::SeqCst) {
            break;
        }
        let Some(result) = perform(scenario) else { break };
        // A mission that ends at once, or dies, must not make the soak endless. A time that is not
        // finite arrives as `f64::MAX`.
        time += result.figures.as_ref().map_or(60.0, |f| f.sim_time_s.clamp(1.0, 1e6));
        drift = drift.max(soak.take(result, &mut firsts));
        let part = ((PARTS as f64 * time / (hours * 3600.0)) as usize).min(PARTS);
        let missions = soak.results.len() as u64;
        // A long mission may end several tenths at once; all of them report the same period.
        while soak.tenths.len() < part {
            let tenth = Tenth {
                hours: time / 3600.0,
                missions,
                resident_mib: resident_mib(),
                times_real_time: (time - begun.0) / clock.elapsed().as_secs_f64().max(1e-6),
                mission_s: (time - begun.0) / (missions - begun.1).max(1) as f64,
                drift_s: drift,
            };
            report(&tenth);
            soak.tenths.push(tenth);
            if soak.tenths.len() == part {
                (begun, clock, drift) = ((time, missions), Instant::now(), 0.0);
            }
        }
        if part == PARTS {
            break;
        }
    }
    soak
}

/// Performs one mission in this process. A panic is a failed mission. Returns `None` after an
/// interrupt.
fn perform(scenario: &Scenario) -> Option<RunResult> {
    let options = RunOptions {
        automatic: true,
        quiet: true,
        interruptible: true,
        // A thread cannot be killed, so a run that hangs ends the process.
        stuck: Some(|error, _| {
            eprintln!("{error}; the soak ends here");
            std::process::exit(4);
        }),
        ..RunOptions::default()
    };
    let begun = Instant::now();
    let run = std::panic::AssertUnwindSafe(|| run::run(scenario, options));
    let failed = |verdict, reason: String| RunResult {
        seed: scenario.seed,
        verdict,
        phase: String::new(),
        reason,
        set: Vec::new(),
        figures: None,
        wall_time_s: begun.elapsed().as_secs_f64(),
        ended_unix_s: None,
    };
    match std::panic::catch_unwind(run) {
        Ok(Ok(summary)) if summary.ended_by == EndedBy::Interrupt => None,
        Ok(Ok(summary)) => Some(RunResult::of_summary(&summary, Vec::new())),
        Ok(Err(error)) => Some(failed(Verdict::Aborted, error.to_string())),
        Err(_) => Some(failed(Verdict::Died, "panicked".to_owned())),
    }
}

/// Returns the resident memory of this process (MiB), without free memory that its allocator keeps;
/// `None` if the system does not report it.
fn resident_mib() -> Option<f64> {
    trim_heap();
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:"))?;
    let kib: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib / 1024.0)
}

/// Gives free memory back to the system, where the allocator can. Otherwise the allocator may keep
/// 20 MiB of an ended mission, depending on which thread freed them last, which is no growth.
fn trim_heap() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    #[expect(unsafe_code, reason = "a call of the C library that takes no pointer")]
    // SAFETY: it returns free pages of the heap, and touches no memory that is in use.
    unsafe {
        libc::malloc_trim(0);
    }
}

#[cfg(test)]
mod tests {
    use super::super::result::tests::result;
    use super::*;

    /// Returns the report of a tenth with this resident memory (MiB).
    fn tenth(resident: f64) -> Tenth {
        Tenth {
            hours: 1.0,
            missions: 1,
            resident_mib: Some(resident),
            times_real_time: 50.0,
            mission_s: 400.0,
            drift_s: 0.0,
        }
    }

    #[test]
    fn memory_growth_after_first_fifth_fails_the_soak() {
        // Returns a soak whose memory is `second` MiB in the second tenth and `last` MiB in the
        // last.
        let of = |second: f64, last: f64| {
            let tenths = [50.0, second].into_iter().chain([104.0; 7]).chain([last]).map(tenth);
            Soak { tenths: tenths.collect(), repeated: (1, 0), ..Soak::default() }
        };
        // A growth of up to `GROWTH_MIB` (8 MiB) or by `GROWTH` (5 %) is allowed.
        for (second, flat, grown) in [(100.0, 107.0, 109.0), (400.0, 419.0, 421.0)] {
            let (flat, grown) = (of(second, flat), of(second, grown));
            assert_eq!((flat.is_flat(), grown.is_flat()), (Some(true), Some(false)));
            assert!(flat.is_steady() && !grown.is_steady());
        }
        assert_eq!(Soak::default().is_flat(), None);
        let mut short = of(100.0, 107.0);
        short.tenths.pop();
        assert!(short.unsteady_reason().unwrap().contains("ended before its last tenth"));
    }

    #[test]
    fn soak_with_unknown_memory_is_not_steady() {
        let tenths = [50.0; PARTS].map(tenth).into();
        let mut soak = Soak { tenths, repeated: (1, 0), ..Soak::default() };
        assert!(soak.is_steady());
        soak.tenths[1].resident_mib = None;
        assert_eq!((soak.is_flat(), soak.is_steady()), (None, false));
        assert!(soak.unsteady_reason().unwrap().contains("could not be read"));
        assert_eq!(soak.json()["memory_flat"], Value::Null);
    }

    #[test]
    fn repeated_mission_that_differs_is_counted() {
        let mut soak = Soak::default();
        let mut firsts = BTreeMap::new();
        assert_eq!(soak.take(result(1, Verdict::Solved, 5.0), &mut firsts), 0.0);
        assert_eq!(soak.take(result(1, Verdict::Solved, 5.0), &mut firsts), 0.0);
        assert_eq!(soak.repeated, (1, 0));
        // The test's simulated time is 400 s plus the force.
        assert_eq!(soak.take(result(1, Verdict::Solved, 7.0), &mut firsts), 2.0);
        assert_eq!(soak.repeated, (2, 1));
        // Equal in time, but not to the bit.
        let mut other = result(1, Verdict::Solved, 5.0);
        if let Some(figures) = &mut other.figures {
            figures.hash = "another".into();
        }
        assert_eq!(soak.take(other, &mut firsts), 0.0);
        assert_eq!(soak.repeated, (3, 2));
        // A mission that died cannot be compared, so it counts as different.
        let died = RunResult { figures: None, ..result(1, Verdict::Died, 0.0) };
        assert_eq!(soak.take(died.clone(), &mut firsts), 0.0);
        assert_eq!(soak.repeated, (4, 3));
        let died = RunResult { seed: 2, ..died };
        soak.take(died.clone(), &mut firsts);
        assert_eq!(soak.repeated, (4, 3));
        soak.take(died, &mut firsts);
        assert_eq!(soak.repeated, (5, 4));
    }

    #[test]
    fn soak_without_repeated_missions_is_not_steady() {
        let mut soak = Soak { tenths: [50.0; PARTS].map(tenth).into(), ..Soak::default() };
        assert!(soak.unsteady_reason().unwrap().contains("none was compared"));
        soak.repeated = (1, 0);
        assert_eq!(soak.unsteady_reason(), None);
        soak.repeated = (1, 1);
        assert!(soak.unsteady_reason().unwrap().contains("1 repeated missions differ"));
    }

    #[test]
    fn repeated_idle_missions_give_identical_results() {
        let text = "task = \"idle\"\ncamera = []\nvsp = []\n[idle]\ntime_s = 2\n[[effector]]\n\
                    name = \"postument\"\n";
        let scenario = crate::tasks::read(std::path::Path::new("t"), text, &[]).unwrap();
        let mut heard = 0;

        // 40 s of simulated time (in hours) are 20 missions of 2 s.
        let soak = soak(&[scenario], 40.0 / 3600.0, &AtomicBool::new(false), |_| heard += 1);

        assert_eq!((heard, soak.tenths.len(), soak.solved()), (PARTS, PARTS, 20));
        assert_eq!(soak.repeated, (19, 0));
        assert!(soak.tenths.iter().all(|t| t.drift_s == 0.0));
    }
}
