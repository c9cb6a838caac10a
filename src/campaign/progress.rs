//! The progress of a campaign that many processes perform, each of them a shard.
//!
//! - in: the state of each shard's file, the moment of its last change, the present moment
//! - out: numbers of runs, missing shards, expected time left, computing time; as JSON and as text
//!
//! The pace of a shard is the number of its runs per second between its last results, so it covers
//! the number of its processes and the speed of its machine. The campaign ends with its slowest
//! shard. A run takes one core for its time by the wall clock.

use super::result::{RunResult, Verdict};
use super::state::{Header, MissingShards, NAMED, Shard, State};
use super::statistics::Spread;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

/// Number of the latest results of a shard that give its pace. A pause of the shard, as between a
/// kill and the next start, counts only for a while.
const LATEST: usize = 20;
/// Seconds of an hour.
const HOUR: f64 = 3600.0;

/// State file of a shard.
pub(crate) struct Part {
    /// Contents of the file.
    pub state: State,
    /// Moment of the last change of the file (s since 1970).
    pub changed_unix_s: Option<f64>,
}

/// Shard without all of its results.
#[derive(Debug, Clone, PartialEq)]
struct Incomplete {
    shard: Shard,
    runs: u64,
    asked: u64,
    changed_unix_s: Option<f64>,
    /// Expected time until its last run has ended (s); `None` if no pace is known.
    left_s: Option<f64>,
}

/// Progress of a campaign.
#[derive(Debug, Clone)]
pub(crate) struct Progress {
    header: Header,
    /// Results of all files.
    results: BTreeMap<u64, RunResult>,
    damaged: u64,
    /// Number of shards, without those that have no runs.
    shards: u64,
    incomplete: Vec<Incomplete>,
    missing: MissingShards,
    changed_unix_s: Option<f64>,
    left_s: Option<f64>,
}

impl Progress {
    /// Computes the progress from the files of at least one shard.
    ///
    /// # Errors
    /// The reason why the files are not those of one campaign, with the index of the file.
    pub(crate) fn of(parts: &[Part]) -> Result<Self, (usize, String)> {
        let Some(first) = parts.first() else { return Err((0, "no file".to_owned())) };
        let of = parts_of(first.state.header.shard);
        let (mut whole, mut missing) = (first.state.clone(), MissingShards::default());
        whole.header.shard = Shard::default();
        for (index, part) in parts.iter().enumerate().skip(1) {
            let own = parts_of(part.state.header.shard);
            if own != of {
                return Err((index, format!("one of {own} shards, and the first file of {of}")));
            }
            whole.merge(part.state.clone()).map_err(|why| (index, why))?;
        }
        let paces: Vec<_> = parts.iter().map(|part| pace(&part.state)).collect();
        let known: Vec<f64> = paces.iter().copied().flatten().collect();
        let mean = (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64);
        let incomplete: Vec<_> = parts
            .iter()
            .zip(&paces)
            .filter_map(|(part, pace)| Incomplete::of(part, pace.or(mean)))
            .collect();
        // The last shards of a small campaign have no runs.
        let shards = of.min(whole.header.runs);
        let present: BTreeSet<u64> =
            parts.iter().map(|part| <(u64, u64)>::from(part.state.header.shard).0).collect();
        let absent = || (1..=shards).filter(|number| !present.contains(number));
        missing.named = absent().take(NAMED).map(|number| format!("{number}/{of}")).collect();
        missing.count = absent().count() as u64;
        // A missing shard has yet to begin. The first one has the most runs.
        let begins = absent().next().and_then(|k| Shard::try_from((k, of)).ok()).map(|shard| {
            let asked = Header { shard, ..whole.header.clone() }.asked();
            mean.map(|pace| asked as f64 / pace)
        });
        let mut left = incomplete.iter().map(|shard| shard.left_s).chain(begins);
        Ok(Self {
            left_s: left.try_fold(0.0, |most: f64, left| Some(most.max(left?))),
            changed_unix_s: parts.iter().filter_map(|part| part.changed_unix_s).reduce(f64::max),
            damaged: whole.damaged,
            header: whole.header,
            results: whole.results,
            shards,
            incomplete,
            missing,
        })
    }

    /// Returns whether every run has a result.
    #[must_use]
    pub(crate) fn is_complete(&self) -> bool {
        self.results.len() as u64 == self.header.asked()
    }

    /// Returns the number of runs without success.
    fn failed(&self) -> usize {
        self.results.values().filter(|run| run.verdict != Verdict::Solved).count()
    }

    /// Returns the times of the runs by the wall clock (s): their sum and their distribution.
    fn times(&self) -> (f64, Spread) {
        let times = || self.results.values().map(|run| run.wall_time_s.max(0.0));
        (times().sum(), Spread::of(times()))
    }

    /// Returns the progress as one JSON object; with `plan` also the needs of that campaign.
    #[must_use]
    pub(crate) fn json(&self, plan: Option<Plan>) -> Value {
        let (sum, times) = self.times();
        let runs = self.results.len();
        let incomplete: Vec<_> = self.incomplete.iter().map(Incomplete::json).collect();
        let mut object = json!({
            "scenario": self.header.scenario, "seed": self.header.seed,
            "asked": self.header.asked(), "runs": runs,
            "solved": runs - self.failed(), "failed": self.failed(), "shards": self.shards,
            "incomplete": incomplete, "missing": self.missing.named,
            "missing_count": self.missing.count, "damaged": self.damaged,
            "changed_unix_s": self.changed_unix_s, "left_s": self.left_s,
            "core_hours": sum / HOUR, "run_s": times,
        });
        if let Some(plan) = plan {
            object["plan"] = json!({
                "runs": plan.runs, "cores": plan.cores,
                "core_hours": self.planned_core_s(plan).map(|s| s / HOUR),
                "hours": self.planned_s(plan).map(|s| s / HOUR),
            });
        }
        object
    }

    /// Returns the computing time of a planned campaign (s); `None` without a result.
    fn planned_core_s(&self, plan: Plan) -> Option<f64> {
        let runs = self.results.len();
        (runs > 0).then(|| self.times().0 / runs as f64 * plan.runs as f64)
    }

    /// Returns the time by the wall clock (s) of a planned campaign with the cores that `plan`
    /// gives. No core performs a part of a run.
    fn planned_s(&self, plan: Plan) -> Option<f64> {
        let each = self.planned_core_s(plan)? / plan.runs as f64;
        Some(each * plan.runs.div_ceil(plan.cores?) as f64)
    }

    /// Returns the progress as a table for people, at the moment `now` (s since 1970).
    #[must_use]
    pub(crate) fn table(&self, now: f64, plan: Option<Plan>) -> String {
        let ago = |changed: Option<f64>| {
            let since = changed.map(|changed| duration((now - changed).max(0.0)));
            since.map_or_else(|| "not known".to_owned(), |since| since + " ago")
        };
        let left = |left: Option<f64>| left.map_or_else(|| "not known".to_owned(), duration);
        let (header, runs, failed) = (&self.header, self.results.len(), self.failed());
        let mut t = String::new();
        let last = header.seed.saturating_add(header.runs.saturating_sub(1));
        row(&mut t, "scenario", &format!("{}, seeds {}..{last}", header.scenario, header.seed));
        row(&mut t, "runs", &format!("{runs} of {}", header.asked()));
        row(&mut t, "solved, failed", &format!("{}, {failed}", runs - failed));
        row(&mut t, "shards", &self.counts());
        for shard in self.incomplete.iter().take(NAMED) {
            let (name, since) = (format!("  shard {}", shard.shard), ago(shard.changed_unix_s));
            let runs = format!("{} of {} runs", shard.runs, shard.asked);
            let left = left(shard.left_s);
            row(&mut t, &name, &format!("{runs}, last change {since}, time left {left}"));
        }
        if self.missing.count > 0 {
            row(&mut t, "missing shards", &self.missing.to_string());
        }
        row(&mut t, "last change", &ago(self.changed_unix_s));
        if !self.is_complete() {
            row(&mut t, "time left", &(left(self.left_s) + ", with all shards at work"));
        }
        self.add_times(&mut t, plan);
        t
    }

    /// Returns the numbers of shards in words.
    fn counts(&self) -> String {
        let (incomplete, missing) = (self.incomplete.len() as u64, self.missing.count);
        let complete = self.shards.saturating_sub(incomplete + missing);
        format!("{}: {complete} complete, {incomplete} incomplete, {missing} missing", self.shards)
    }

    /// Appends the rows about the computing time.
    fn add_times(&self, t: &mut String, plan: Option<Plan>) {
        let (sum, times) = self.times();
        if !times.is_empty() {
            let mean = sum / self.results.len() as f64;
            let each = format!("{mean:.1} s each run, 95 % within {:.1} s", times.p95);
            row(t, "core-hours", &format!("{}, {each}", hours(sum)));
        }
        let Some(plan) = plan else { return };
        let Some(core_s) = self.planned_core_s(plan) else {
            row(t, "plan", "not known before the first result");
            return;
        };
        let mut text = format!("{} runs need {} core-hours", plan.runs, hours(core_s));
        if let (Some(cores), Some(s)) = (plan.cores, self.planned_s(plan)) {
            let _ = write!(text, ", {} on {cores} cores", duration(s));
        }
        row(t, "plan", &text);
    }
}

/// Size of a campaign that is planned from the times of this one.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plan {
    /// Number of its runs, at least one.
    pub runs: u64,
    /// Number of its cores, at least one; `None` if only the core-hours are asked for.
    pub cores: Option<u64>,
}

impl Incomplete {
    /// Returns the entry of a shard; `None` if it has all of its results. `pace` is in runs per
    /// second.
    fn of(part: &Part, pace: Option<f64>) -> Option<Self> {
        let (header, runs) = (&part.state.header, part.state.results.len() as u64);
        let (shard, asked) = (header.shard, header.asked());
        let left_s = pace.map(|pace| asked.saturating_sub(runs) as f64 / pace);
        let changed_unix_s = part.changed_unix_s;
        (runs < asked).then_some(Self { shard, runs, asked, changed_unix_s, left_s })
    }

    /// Returns the entry as a JSON object.
    fn json(&self) -> Value {
        json!({
            "shard": self.shard.to_string(), "runs": self.runs, "asked": self.asked,
            "changed_unix_s": self.changed_unix_s, "left_s": self.left_s,
        })
    }
}

/// Returns the number of shards into which a shard's campaign is divided.
fn parts_of(shard: Shard) -> u64 {
    <(u64, u64)>::from(shard).1
}

/// Returns the pace of a shard (runs/s) from its latest results; `None` without a result. A file
/// may hold any numbers, so a pace that is no positive number is not known.
fn pace(state: &State) -> Option<f64> {
    let mut ends: Vec<f64> = state.results.values().filter_map(|run| run.ended_unix_s).collect();
    ends.sort_by(f64::total_cmp);
    let latest = &ends[ends.len().saturating_sub(LATEST + 1)..];
    let between = if let [first, .., last] = latest {
        (latest.len() - 1) as f64 / (last - first)
    } else {
        // One result has no distance to another one. Results of earlier builds have no moment.
        let times: f64 = state.results.values().map(|run| run.wall_time_s).sum();
        state.results.len() as f64 / times
    };
    (between.is_finite() && between > 0.0).then_some(between)
}

/// Formats a duration for people.
pub(crate) fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 90.0 => format!("{s:.0} s"),
        s if s < 90.0 * 60.0 => format!("{:.0} min", s / 60.0),
        s if s < 48.0 * HOUR => format!("{:.1} h", s / HOUR),
        s => format!("{:.1} days", s / (24.0 * HOUR)),
    }
}

/// Formats a computing time in hours, with three digits at least for a short one.
fn hours(seconds: f64) -> String {
    match seconds / HOUR {
        h if h < 1.0 => format!("{h:.4}"),
        h if h < 100.0 => format!("{h:.2}"),
        h => format!("{h:.0}"),
    }
}

/// Appends a row to the table for people.
fn row(table: &mut String, name: &str, value: &str) {
    // Writing to a string cannot fail.
    let _ = writeln!(table, "{name:<16} {value}");
}

#[cfg(test)]
mod tests {
    use super::super::result::tests::result;
    use super::super::state::tests::header;
    use super::*;

    /// Returns the file of a shard of ten runs from seed 5 on, with its first `done` results: a run
    /// of 8 s ends each 4 s, the last one at 1000 s.
    fn part(shard: &str, done: usize) -> Part {
        let header = header(10, shard);
        let ended = |index: usize| 1000.0 - 4.0 * (done - 1 - index) as f64;
        let results = header.seeds().take(done).enumerate().map(|(index, seed)| {
            let verdict = if seed == 8 { Verdict::Failed } else { Verdict::Solved };
            let ended_unix_s = Some(ended(index));
            let run = RunResult { wall_time_s: 8.0, ended_unix_s, ..result(seed, verdict, 1.0) };
            (seed, run)
        });
        let state = State { results: results.collect(), header, whole: 0, damaged: 0, torn: false };
        Part { state, changed_unix_s: Some(1000.0 + done as f64) }
    }

    #[test]
    fn progress_counts_runs_and_names_shards() {
        // Shard 1/3 has the seeds 5, 8, 11, 14, shard 2/3 the seeds 6, 9, 12.
        let progress = Progress::of(&[part("1/3", 3), part("2/3", 3)]).unwrap();

        let object = progress.json(None);
        assert!(!progress.is_complete());
        for (key, wanted) in [
            ("asked", json!(10)),
            ("runs", json!(6)),
            ("solved", json!(5)),
            ("failed", json!(1)),
            ("shards", json!(3)),
            ("missing", json!(["3/3"])),
            ("missing_count", json!(1)),
            ("changed_unix_s", json!(1003.0)),
            ("core_hours", json!(48.0 / 3600.0)),
        ] {
            assert_eq!(object[key], wanted, "{key}");
        }
        assert_eq!(object["incomplete"][0]["shard"], "1/3");
        assert_eq!(object["incomplete"][0]["left_s"], 4.0);
        // The missing shard has three runs, at the pace of the others.
        assert_eq!(object["left_s"], 12.0);
        let table = progress.table(1063.0, None);
        for words in [
            "6 of 10",
            "5, 1",
            "3: 1 complete, 1 incomplete, 1 missing",
            "shard 1/3      3 of 4 runs, last change 60 s ago, time left 4 s",
            "missing shards   3/3",
            "time left        12 s, with all shards at work",
            "core-hours       0.0133, 8.0 s each run, 95 % within 8.0 s",
        ] {
            assert!(table.contains(words), "{words} in\n{table}");
        }
    }

    #[test]
    fn complete_campaign_has_no_time_left() {
        let all = [part("3/3", 3), part("1/3", 4), part("2/3", 3)];
        let progress = Progress::of(&all).unwrap();

        assert!(progress.is_complete());
        assert_eq!(progress.json(None)["left_s"], 0.0);
        assert!(!progress.table(0.0, None).contains("time left"));
        // Shards 11 to 20 of ten runs have no runs, so they are not missing.
        let few = Progress::of(&[part("1/20", 1)]).unwrap();
        assert_eq!((few.shards, few.missing.count), (10, 9));
    }

    #[test]
    fn plan_scales_core_hours_to_more_runs() {
        let progress = Progress::of(&[part("1/3", 3)]).unwrap();
        let plan = Plan { runs: 10_000, cores: Some(300) };

        let object = &progress.json(Some(plan))["plan"];
        // 34 runs one after the other on the core with the most runs.
        assert!((object["core_hours"].as_f64().unwrap() - 22.222).abs() < 1e-3, "{object}");
        assert!((object["hours"].as_f64().unwrap() - 34.0 * 8.0 / 3600.0).abs() < 1e-9);
        let table = progress.table(1000.0, Some(plan));
        assert!(table.contains("10000 runs need 22.22 core-hours, 5 min on 300 cores"), "{table}");
        let none = Progress::of(&[part("1/3", 0)]).unwrap();
        assert_eq!(none.json(Some(plan))["plan"]["core_hours"], Value::Null);
        assert_eq!(none.json(None)["left_s"], Value::Null);
        assert!(none.table(0.0, Some(plan)).contains("not known before the first result"));
    }

    #[test]
    fn pace_needs_results_and_sound_times() {
        assert_eq!(pace(&part("1/3", 4).state), Some(0.25));
        // One result has the pace of its own time.
        assert_eq!(pace(&part("1/3", 1).state), Some(0.125));
        assert_eq!(pace(&part("1/3", 0).state), None);
        let mut wrong = part("1/3", 2).state;
        wrong.results.values_mut().for_each(|run| run.ended_unix_s = Some(3.0));
        assert_eq!(pace(&wrong), None);
    }

    #[test]
    fn files_of_different_campaigns_are_refused() {
        let (index, why) = Progress::of(&[part("1/3", 1), part("1/2", 1)]).unwrap_err();
        assert!(index == 1 && why.contains("one of 2 shards"), "{why}");
        let mut other = part("2/3", 1);
        other.state.header.seed = 6;
        let (index, why) = Progress::of(&[part("1/3", 1), part("3/3", 1), other]).unwrap_err();
        assert!(index == 2 && why.contains("not of the same campaign"), "{why}");
    }
}
