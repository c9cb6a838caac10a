//! `rubik-robot campaign --mix`: missions with random mixes of faults, until the given time is
//! over.
//!
//! - in: a scenario, the first seed, hours
//! - out: how the runs ended; for each broken rule ([`Broken`]) the smallest mix that still breaks
//!   it, as lines to append to a scenario
//! - exit code: 0 no rule was broken, 1 one was, 130 interrupted

use super::arguments::ScenarioArgs;
use super::output::{Output, inform, refuse, warn};
use super::stop::{INTERRUPTED, stop_flag};
use crate::campaign::mix::{Broken, Mix, shrunk};
use crate::campaign::result::{RunResult, Verdict};
use crate::campaign::runner::{Job, Kept, Runner};
use crate::record::running_program;
use crate::scenario::Scenario;
use crate::tables;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Extent of the search for broken rules.
pub(super) struct Size {
    /// Seed of the first mix.
    pub seed: u64,
    /// Time after which no further mix begins.
    pub hours: f64,
    /// Number of processes at a time; `None` for the number of cores.
    pub jobs: Option<u16>,
    /// Longest time of a run by the wall clock.
    pub limit: Duration,
}

/// Rule that a run broke.
struct Found {
    /// Seed of the run.
    seed: u64,
    broken: Broken,
    /// Smallest mix of faults that still breaks the rule with this seed.
    mix: Mix,
}

/// Performs missions with mixes of faults, and reports the rules that they break; returns the exit
/// code.
pub(super) fn mixed(
    from: &ScenarioArgs,
    size: &Size,
    json: bool,
    output: &mut Output,
) -> anyhow::Result<u8> {
    let scenario = from.load(&[]).map_err(refuse)?;
    if scenario.bridge.kind.is_hardware() {
        return Err(refuse("--mix needs the simulated plant: take a scenario without hardware"));
    }
    let runner = Runner {
        program: running_program()?,
        scenario: from.scenario.clone(),
        set: from.set.clone(),
        jobs: size.jobs.map_or_else(tables::cores, usize::from),
        limit: size.limit,
    };
    let stop = stop_flag()?;
    let ends = Instant::now() + Duration::from_secs_f64(size.hours * 3600.0);
    let (mut found, mut ended) = (Vec::new(), BTreeMap::new());
    let mut seed = size.seed;
    while Instant::now() < ends && !stop.load(Ordering::SeqCst) {
        // One batch for all processes: a broken rule is shrunk before the next one begins.
        let batch: Vec<u64> = (seed..).take(4 * runner.jobs).collect();
        seed += batch.len() as u64;
        for (result, mix) in performed(&runner, &scenario, &batch, &stop)? {
            *ended.entry(result.verdict).or_insert(0_u64) += 1;
            let Some(broken) = Broken::by(&result) else { continue };
            warn(&format!("seed {}: {broken}", result.seed));
            let mix = smallest(&runner, result.seed, mix, &broken, &stop)?;
            inform(&format!("the smallest mix that does so has {} faults:\n{mix}", mix.len()));
            found.push(Found { seed: result.seed, broken, mix });
        }
    }
    report(&ended, &found, json, output)?;
    Ok(match (stop.load(Ordering::SeqCst), found.is_empty()) {
        (true, _) => INTERRUPTED,
        (false, true) => 0,
        (false, false) => 1,
    })
}

/// Performs the runs of these seeds, each with the mix that its seed draws. Returns the results in
/// the order of the seeds; a stop leaves out runs that have not ended.
fn performed(
    runner: &Runner,
    scenario: &Scenario,
    seeds: &[u64],
    stop: &AtomicBool,
) -> anyhow::Result<Vec<(RunResult, Mix)>> {
    let cell = &scenario.controller.cell;
    let arms: Vec<&str> = cell.arms.iter().map(|arm| arm.name.as_str()).collect();
    let cameras: Vec<&str> = cell.cameras.iter().map(|camera| camera.name.as_str()).collect();
    let mix = |seed: u64| Mix::draw(seed, &arms, &cameras);
    let jobs: Vec<Job> = seeds.iter().map(|&seed| job(seed, &mix(seed))).collect();
    let mut runs = Vec::new();
    runner.perform(&jobs, stop, &|| Ok(()), |result| {
        let mix = mix(result.seed);
        runs.push((result, mix));
        Ok(())
    })?;
    runs.sort_by_key(|(result, _)| result.seed);
    Ok(runs)
}

/// Returns the run of a seed with a mix. Its files are in the folder for temporary files.
fn job(seed: u64, mix: &Mix) -> Job {
    let file = |end: &str| {
        let name = format!("rubik-robot-mix-{}-{seed}.{end}", std::process::id());
        std::env::temp_dir().join(name)
    };
    let set = vec![mix.after_cut().set()];
    let kept = Kept { world: file("json"), recording: file("mcap"), set };
    Job { seed, set: vec![mix.set()], kept: Some(kept) }
}

/// Returns the smallest part of a mix that still breaks the same rule with the same seed. A stop
/// ends the search with the smallest part so far.
fn smallest(
    runner: &Runner,
    seed: u64,
    mix: Mix,
    broken: &Broken,
    stop: &AtomicBool,
) -> anyhow::Result<Mix> {
    shrunk(mix, |fewer| {
        let mut breaks = false;
        runner.perform(&[job(seed, fewer)], stop, &|| Ok(()), |result| {
            breaks = Broken::by(&result).is_some_and(|now| now.is_like(broken));
            Ok(())
        })?;
        Ok(breaks)
    })
}

/// Prints how the runs ended, and the mixes that broke a rule.
fn report(
    ended: &BTreeMap<Verdict, u64>,
    found: &[Found],
    json: bool,
    output: &mut Output,
) -> anyhow::Result<()> {
    if json {
        let counts: BTreeMap<&str, u64> =
            ended.iter().map(|(verdict, count)| (verdict.word(), *count)).collect();
        let found: Vec<_> = found
            .iter()
            .map(|f| {
                serde_json::json!({
                    "seed": f.seed,
                    "rule": f.broken.to_string(),
                    "set": f.mix.set(),
                })
            })
            .collect();
        output.text(&format!("{}\n", serde_json::json!({ "ended": counts, "broken": found })))?;
        return Ok(());
    }
    for (verdict, count) in ended {
        output.text(&format!("{:<22} {count}\n", verdict.word()))?;
    }
    output.text(&format!("{:<22} {}\n", "broken rules", found.len()))?;
    for Found { seed, broken, mix } in found {
        output.text(&format!("\n# seed {seed}: {broken}\n{mix}"))?;
    }
    Ok(())
}
