//! A soak: missions back to back in one process, and what becomes of its memory and of the
//! missions' times.
//!
//! - in: a scenario, seeds that are gone through again and again, hours of simulated time
//! - out: at each tenth of the time the process's memory, its speed, and by how much a mission that
//!   was there before has drifted; a repeated seed must take the same simulated time and have the
//!   same hash

use super::result::{Figures, RunResult, Verdict};
use crate::record::summary::EndedBy;
use crate::run::{self, RunOptions};
use crate::scenario::Scenario;
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Parts of a soak after which it tells how it is.
pub(crate) const PARTS: usize = 10;
/// Memory may grow by this share after the second tenth, or by [`GROWTH_MIB`] where that is more.
const GROWTH: f64 = 0.05;
/// See [`GROWTH`] (MiB).
const GROWTH_MIB: f64 = 8.0;

/// A tenth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Tenth {
    /// Simulated time since the beginning (h).
    pub hours: f64,
    /// Missions since the beginning.
    pub missions: u64,
    /// Resident memory of the process (MiB); `None` where the system does not tell.
    pub resident_mib: Option<f64>,
    /// Simulated over wall-clock time in this tenth.
    pub times_real_time: f64,
    /// Mean simulated time of a mission in this tenth (s).
    pub mission_s: f64,
    /// The largest difference of a mission's simulated time from that of the same seed before, in
    /// this tenth (s).
    pub drift_s: f64,
}

/// What came of it.
#[derive(Debug, Clone, Default)]
pub(crate) struct Soak {
    /// At each tenth.
    pub tenths: Vec<Tenth>,
    /// All missions, in their order.
    pub results: Vec<RunResult>,
    /// Missions that were repeated, and how many of them differed, or have no figures to compare.
    pub repeated: (u64, u64),
}

impl Soak {
    /// By how much the memory grew between the second and the last tenth (MiB).
    #[must_use]
    pub(crate) fn growth_mib(&self) -> Option<f64> {
        Some(self.tenths.last()?.resident_mib? - self.tenths.get(1)?.resident_mib?)
    }

    /// Whether the memory stayed within its bounds; `None` before the end, or where the system does
    /// not tell.
    #[must_use]
    pub(crate) fn is_flat(&self) -> Option<bool> {
        let base = self.tenths.get(1)?.resident_mib?;
        (self.tenths.len() == PARTS).then_some(())?;
        Some(self.growth_mib()? <= (GROWTH * base).max(GROWTH_MIB))
    }

    /// Missions that were solved.
    #[must_use]
    pub(crate) fn solved(&self) -> u64 {
        self.results.iter().filter(|r| r.verdict == Verdict::Solved).count() as u64
    }

    /// Whether it is as it should be: ten tenths, memory flat, missions repeated and none different
    /// from itself. Memory that is not known counts as not flat.
    #[must_use]
    pub(crate) fn is_steady(&self) -> bool {
        self.unsteady().is_none()
    }

    /// Why it is not steady.
    #[must_use]
    pub(crate) fn unsteady(&self) -> Option<String> {
        if self.tenths.len() < PARTS {
            return Some("it did not come to its end".to_owned());
        }
        match (self.is_flat(), self.repeated) {
            (None, _) => Some("nobody knows its memory, which may have grown".to_owned()),
            (Some(false), _) => Some("its memory grew".to_owned()),
            (_, (_, differently @ 1..)) => {
                Some(format!("{differently} missions differ from themselves"))
            }
            (_, (0, _)) => Some("no mission was repeated, so none was compared".to_owned()),
            _ => None,
        }
    }

    /// Share of solved missions; 0 when there was none.
    #[must_use]
    pub(crate) fn success(&self) -> f64 {
        self.solved() as f64 / self.results.len().max(1) as f64
    }

    /// One object.
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

    fn take(&mut self, result: RunResult, firsts: &mut BTreeMap<u64, Option<Figures>>) -> f64 {
        let mut drift = 0.0;
        if let Some(first) = firsts.get(&result.seed) {
            let both = result.figures.as_ref().zip(first.as_ref());
            drift = both.map_or(0.0, |(again, first)| (again.sim_time_s - first.sim_time_s).abs());
            self.repeated.0 += 1;
            self.repeated.1 += u64::from(both.is_none_or(|(again, first)| again != first));
        } else {
            firsts.insert(result.seed, result.figures.clone());
        }
        self.results.push(result);
        drift
    }
}

/// Performs it: scenarios one after the other, from the first again after the last, until `hours`
/// of simulated time are over or `stop` is set. `told` hears of each tenth.
pub(crate) fn soak(
    scenarios: &[Scenario],
    hours: f64,
    stop: &AtomicBool,
    mut told: impl FnMut(&Tenth),
) -> Soak {
    let mut soak = Soak::default();
    let mut firsts = BTreeMap::new();
    let (mut time, mut begun, mut clock) = (0.0, (0.0, 0), Instant::now());
    let mut drift: f64 = 0.0;
    for scenario in scenarios.iter().cycle() {
        if stop.load(Ordering::SeqCst) {
            break;
        }
        let Some(result) = perform(scenario) else { break };
        // A mission that ends at once must not make the soak endless.
        time += result.figures.as_ref().map_or(60.0, |f| f.sim_time_s.clamp(1.0, 1e6));
        drift = drift.max(soak.take(result, &mut firsts));
        let part = ((PARTS as f64 * time / (hours * 3600.0)) as usize).min(PARTS);
        let missions = soak.results.len() as u64;
        while soak.tenths.len() < part {
            let tenth = Tenth {
                hours: time / 3600.0,
                missions,
                resident_mib: resident_mib(),
                times_real_time: (time - begun.0) / clock.elapsed().as_secs_f64().max(1e-6),
                mission_s: (time - begun.0) / (missions - begun.1).max(1) as f64,
                drift_s: drift,
            };
            told(&tenth);
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

/// One mission in this process; a panic is a failure of its own. `None` after an interrupt.
fn perform(scenario: &Scenario) -> Option<RunResult> {
    let options = RunOptions {
        automatic: true,
        quiet: true,
        interruptible: true,
        stuck: Some(|error| {
            eprintln!("{error}; the soak ends with it");
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
    };
    match std::panic::catch_unwind(run) {
        Ok(Ok(summary)) if summary.ended_by == EndedBy::Interrupt => None,
        Ok(Ok(summary)) => Some(RunResult::of_summary(&summary, Vec::new())),
        Ok(Err(error)) => Some(failed(Verdict::Aborted, error.to_string())),
        Err(_) => Some(failed(Verdict::Died, "panicked".to_owned())),
    }
}

/// Resident memory of this process (MiB).
fn resident_mib() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:"))?;
    let kib: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib / 1024.0)
}

#[cfg(test)]
mod tests {
    use super::super::result::tests::result;
    use super::*;

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
    fn memory_that_grows_after_the_second_tenth_is_not_flat() {
        let of = |last: f64| {
            let tenths = [50.0, 100.0].into_iter().chain([104.0; 7]).chain([last]).map(tenth);
            Soak { tenths: tenths.collect(), repeated: (1, 0), ..Soak::default() }
        };
        assert_eq!(of(107.0).is_flat(), Some(true));
        assert_eq!(of(109.0).is_flat(), Some(false));
        assert!(of(107.0).is_steady() && !of(109.0).is_steady());
        assert_eq!(Soak::default().is_flat(), None);
        let mut short = of(107.0);
        short.tenths.pop();
        assert!(short.unsteady().unwrap().contains("did not come to its end"));
    }

    #[test]
    fn memory_that_nobody_knows_is_not_steady() {
        let tenths = [50.0; PARTS].map(tenth).into();
        let mut soak = Soak { tenths, repeated: (1, 0), ..Soak::default() };
        assert!(soak.is_steady());
        soak.tenths[1].resident_mib = None;
        assert_eq!((soak.is_flat(), soak.is_steady()), (None, false));
        assert!(soak.unsteady().unwrap().contains("nobody knows its memory"));
        assert_eq!(soak.json()["memory_flat"], Value::Null);
    }

    #[test]
    fn a_mission_that_differs_from_itself_is_noticed() {
        let mut soak = Soak::default();
        let mut firsts = BTreeMap::new();
        assert_eq!(soak.take(result(1, Verdict::Solved, 5.0), &mut firsts), 0.0);
        assert_eq!(soak.take(result(1, Verdict::Solved, 5.0), &mut firsts), 0.0);
        assert_eq!(soak.repeated, (1, 0));
        // The time is 400 s and as many as the force has.
        assert_eq!(soak.take(result(1, Verdict::Solved, 7.0), &mut firsts), 2.0);
        assert_eq!(soak.repeated, (2, 1));
        // In the same time, but not the same to the bit.
        let mut other = result(1, Verdict::Solved, 5.0);
        if let Some(figures) = &mut other.figures {
            figures.hash = "another".into();
        }
        assert_eq!(soak.take(other, &mut firsts), 0.0);
        assert_eq!(soak.repeated, (3, 2));
        // It died: nobody knows whether it would have been the same.
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
    fn a_soak_that_compared_nothing_is_not_steady() {
        let mut soak = Soak { tenths: [50.0; PARTS].map(tenth).into(), ..Soak::default() };
        assert!(soak.unsteady().unwrap().contains("none was compared"));
        soak.repeated = (1, 0);
        assert_eq!(soak.unsteady(), None);
        soak.repeated = (1, 1);
        assert!(soak.unsteady().unwrap().contains("1 missions differ"));
    }

    #[test]
    fn idle_missions_back_to_back_are_the_same_and_need_no_more_memory() {
        let text = "task = \"idle\"\ncamera = []\nvsp = []\n[idle]\ntime_s = 2\n[[effector]]\nname = \"postument\"\n";
        let scenario = crate::scenario::read(std::path::Path::new("t"), text, &[]).unwrap();
        let mut heard = 0;

        let soak = soak(&[scenario], 40.0 / 3600.0, &AtomicBool::new(false), |_| heard += 1);

        assert_eq!((heard, soak.tenths.len(), soak.solved()), (PARTS, PARTS, 20));
        assert_eq!(soak.repeated, (19, 0));
        assert!(soak.tenths.iter().all(|t| t.drift_s == 0.0));
    }
}
