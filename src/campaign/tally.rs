//! The summed results of a campaign: share of solved runs with its interval, failures by phase,
//! distributions of the runs' figures.
//!
//! - in: the header and the results that exist
//! - out: one JSON object for machines, a table for people. The object does not depend on the order
//!   of the runs or on the machines that performed them; the table also has a rate by the wall
//!   clock

use super::result::{Figures, Mishaps, RunResult, Verdict};
use super::state::{Header, SEVERAL, State};
use super::statistics::{Spread, wilson};
use crate::hw::text::quoted;
use crate::record::summary::figure_label;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

/// Summed results of a campaign.
#[derive(Debug, Clone, PartialEq)]
pub struct Tally {
    /// Header of the campaign.
    pub header: Header,
    /// Results in the order of their seeds.
    pub results: Vec<RunResult>,
    /// Number of runs that were asked for, of this shard or of the whole campaign.
    pub asked: u64,
    /// Number of runs that are solved by the plant's verdict.
    pub solved: u64,
    /// Wilson's interval of 95 % for the share of solved runs.
    pub interval: [f64; 2],
    /// Mishaps that the plant counted, summed over all runs.
    pub mishaps: Mishaps,
    /// Number of runs with a mishap, and number of these that were solved nevertheless.
    pub mishaps_and_solved: (u64, u64),
    /// Number of times that a mission read and planned again, by its own count.
    pub recoveries: u64,
}

/// Quantity of a run: name in JSON, name for people, function that reads it where it is known,
/// number of decimals.
pub type Quantity = (&'static str, &'static str, fn(&Figures) -> Option<f64>, usize);

/// Quantities that every campaign reports. All runs with figures count, solved or not.
pub(crate) const QUANTITIES: [Quantity; 10] = [
    ("peak_force_n", "peak force [N]", |f| Some(f.peak_force_n), 1),
    ("peak_contact_n", "peak contact [N]", |f| f.peak_contact_n, 1),
    ("grasps", "grasps", |f| Some(f64::from(f.grasps)), 0),
    ("turns", "turns", |f| Some(f64::from(f.turns)), 0),
    ("sim_time_s", "simulated time [s]", |f| Some(f.sim_time_s), 1),
    ("current_share", "current / trip current", |f| Some(f.exertion?.current_share), 2),
    ("heat_share", "heat / trip heat", |f| Some(f.exertion?.heat_share), 2),
    ("motor_speed_rad_s", "motor speed [rad/s]", |f| Some(f.exertion?.motor_speed_rad_s), 0),
    ("near_person_mm_s", "speed near the person [mm/s]", |f| Some(f.exertion?.near_person_mm_s), 0),
    ("arms_apart_mm", "distance between arms [mm]", |f| f.exertion?.arms_apart_mm, 1),
];

/// Quantity of all runs, for a table and a histogram.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Column {
    /// Name for people.
    pub(super) words: String,
    /// Value of each run in which it is known, and whether the run was solved.
    pub(super) values: Vec<(f64, bool)>,
    /// Number of decimals.
    pub(super) decimals: usize,
}

impl Column {
    /// Returns the distribution of the values.
    pub(super) fn spread(&self) -> Spread {
        Spread::of(self.values.iter().map(|(value, _)| *value))
    }
}

/// Largest number of figures of a task that tables and pages show.
const COLUMNS: usize = 60;
/// Number of failures that the table lists one by one.
const LISTED: usize = 20;

impl Tally {
    /// Sums up the results of a state.
    #[must_use]
    pub fn of(state: &State) -> Self {
        let results: Vec<RunResult> = state.results.values().cloned().collect();
        let solved = results.iter().filter(|r| r.verdict == Verdict::Solved).count() as u64;
        let (mut mishaps, mut mishaps_and_solved, mut recoveries) = (Mishaps::default(), (0, 0), 0);
        for (result, figures) in results.iter().filter_map(|r| Some((r, r.figures.as_ref()?))) {
            mishaps.add(&figures.mishaps);
            // A mishap alone is no failure: a mission may recover from it. Those that were solved
            // nevertheless are counted.
            if figures.mishaps.count() > 0 {
                mishaps_and_solved.0 += 1;
                mishaps_and_solved.1 += u64::from(result.verdict == Verdict::Solved);
            }
            recoveries += u64::from(figures.recoveries);
        }
        Self {
            header: state.header.clone(),
            asked: state.header.asked(),
            interval: wilson(solved, results.len() as u64),
            results,
            solved,
            mishaps,
            mishaps_and_solved,
            recoveries,
        }
    }

    /// Returns the number of runs that have a result.
    #[must_use]
    pub fn runs(&self) -> u64 {
        self.results.len() as u64
    }

    /// Returns whether every run that was asked for has a result.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.runs() == self.asked
    }

    /// Returns whether one build of the program performed all runs.
    #[must_use]
    pub(crate) fn is_of_one_build(&self) -> bool {
        self.header.build != SEVERAL
    }

    /// Returns the share of solved runs; 0 without runs.
    #[must_use]
    pub fn success(&self) -> f64 {
        self.solved as f64 / self.runs().max(1) as f64
    }

    /// Returns the distribution of a quantity over the runs in which it is known. `of` takes the
    /// quantity from the figures of a run.
    #[must_use]
    pub fn spread(&self, of: fn(&Figures) -> Option<f64>) -> Spread {
        Spread::of(self.figures().filter_map(of))
    }

    /// Returns the quantities that are known in some run: those of each campaign, then the figures
    /// of the task by name.
    pub(super) fn columns(&self) -> Vec<Column> {
        let known = |of: &dyn Fn(&Figures) -> Option<f64>| -> Vec<(f64, bool)> {
            let runs = self.results.iter();
            runs.filter_map(|r| Some((of(r.figures.as_ref()?)?, r.verdict == Verdict::Solved)))
                .collect()
        };
        let common = QUANTITIES.iter().map(|(_, words, of, decimals)| Column {
            words: (*words).to_owned(),
            values: known(of),
            decimals: *decimals,
        });
        let of_task = self.task_figures().into_iter().take(COLUMNS).map(|name| {
            let values = known(&|figures| figures.of_task.get(name).copied());
            let whole = values.iter().all(|(value, _)| value.fract() == 0.0);
            // Three digits of the greatest value, since a figure may be a small share.
            let most = values.iter().map(|(value, _)| value.abs()).fold(0.0, f64::max);
            let digits = (2.0 - most.max(1e-9).log10().floor()).clamp(1.0, 9.0) as usize;
            Column { words: figure_label(name), values, decimals: if whole { 0 } else { digits } }
        });
        // Earlier builds did not measure every quantity. Those of the cube are 0 without a cube.
        let of_cube = self.concerns_cube();
        let tells = |column: &Column| {
            !column.values.is_empty() && (of_cube || column.values.iter().any(|v| v.0 != 0.0))
        };
        common.filter(tells).chain(of_task).collect()
    }

    /// Returns whether the task handles a cube: one with figures of its own may handle none.
    pub(super) fn concerns_cube(&self) -> bool {
        let handles = |f: &Figures| f.turns + f.grasps + f.mishaps.drops > 0;
        self.task_figures().is_empty() || self.figures().any(handles)
    }

    /// Returns the names of the figures that the task gave in any run.
    fn task_figures(&self) -> BTreeSet<&str> {
        self.figures().flat_map(|figures| figures.of_task.keys()).map(String::as_str).collect()
    }

    /// Returns the figures of all runs that have some.
    fn figures(&self) -> impl Iterator<Item = &Figures> {
        self.results.iter().filter_map(|r| r.figures.as_ref())
    }

    /// Counts the runs in which a contact exceeded the force limit of the scenario.
    #[must_use]
    pub(crate) fn above_limit(&self) -> u64 {
        self.figures().filter(|f| f.exceeds_limit() == Some(true)).count() as u64
    }

    /// Counts the runs in which the cube fell more often than the controller reported.
    #[must_use]
    pub(crate) fn unnoticed(&self) -> u64 {
        self.figures().filter(|f| f.has_unnoticed_drop() == Some(true)).count() as u64
    }

    /// Counts the runs with figures from an earlier build, which did not report the contact force,
    /// its limit or the noticed drops.
    #[must_use]
    pub fn contact_unknown(&self) -> u64 {
        let unknown =
            |f: &&Figures| f.exceeds_limit().is_none() || f.has_unnoticed_drop().is_none();
        self.figures().filter(unknown).count() as u64
    }

    /// Returns the force limit of the runs for people: "20.0 N", or a range if it was varied.
    #[must_use]
    pub fn limit(&self) -> String {
        // Runs may differ in their limit: `--vary` can draw it.
        let s = self.spread(|f| f.force_limit_n);
        match s.is_empty() {
            true => "an unknown force".to_owned(),
            false if s.min == s.max => format!("{:.1} N", s.min),
            false => format!("{:.1} .. {:.1} N", s.min, s.max),
        }
    }

    /// Returns the runs that were not solved.
    pub fn failures(&self) -> impl Iterator<Item = &RunResult> {
        self.results.iter().filter(|r| r.verdict != Verdict::Solved)
    }

    /// Returns the runs that were not solved, grouped by the phase in which they ended.
    #[must_use]
    pub(crate) fn by_phase(&self) -> BTreeMap<&str, Vec<&RunResult>> {
        let mut phases: BTreeMap<&str, Vec<&RunResult>> = BTreeMap::new();
        for failure in self.failures() {
            phases.entry(phase(failure)).or_default().push(failure);
        }
        phases
    }

    /// Counts the runs that ended without a verdict of the plant: they never began, died, or were
    /// killed after their time.
    #[must_use]
    pub fn without_verdict(&self) -> u64 {
        self.results.iter().filter(|r| r.figures.is_none()).count() as u64
    }

    /// Returns the command that repeats a run.
    #[must_use]
    pub fn command(&self, run: &RunResult) -> String {
        let program = self.header.program_name();
        let mut words = vec![
            format!("{} run", quoted(program)),
            quoted(&self.header.scenario).into_owned(),
            format!("--seed {}", run.seed),
        ];
        // The order of `Runner::command`, so that the repeated run reads the same scenario.
        let set = self.header.set.iter().chain(&run.set);
        words.extend(set.map(|option| format!("--set {}", quoted(option))));
        words.join(" ")
    }

    /// Returns the tally as one JSON object, which does not depend on the wall clock.
    #[must_use]
    pub fn json(&self) -> Value {
        // Merged shards must give exactly the object of the whole campaign. So it holds no
        // wall-clock time, and its lists are in the order of seeds or of names.
        let failures: Vec<_> = self
            .failures()
            .map(|f| {
                json!({
                    "seed": f.seed, "phase": phase(f), "reason": f.reason, "verdict": f.verdict,
                    "command": self.command(f),
                })
            })
            .collect();
        let phases: BTreeMap<_, _> =
            self.by_phase().into_iter().map(|(name, runs)| (name, runs.len())).collect();
        let mut object = json!({
            "build": self.header.build, "scenario": self.header.scenario, "seed": self.header.seed,
            "asked": self.asked, "runs": self.runs(), "solved": self.solved,
            "success": self.success(), "interval": self.interval,
            "failures": failures, "phases": phases, "without_verdict": self.without_verdict(),
            "mishaps": self.mishaps, "runs_with_mishaps": self.mishaps_and_solved.0,
            "solved_with_mishaps": self.mishaps_and_solved.1, "recoveries": self.recoveries,
            "force_limit_n": self.spread(|f| f.force_limit_n),
            "runs_above_force_limit": self.above_limit(),
            "drops": self.mishaps.drops, "runs_with_unnoticed_drops": self.unnoticed(),
            "contact_unknown": self.contact_unknown(),
            "plant_hashes": self.plants(),
        });
        for (name, _, of, _) in QUANTITIES {
            object[name] = json!(self.spread(of));
        }
        let of_task = self.task_figures().into_iter().map(|name| {
            let values = self.figures().filter_map(|figures| figures.of_task.get(name).copied());
            (name, Spread::of(values))
        });
        object["figures"] = json!(of_task.collect::<BTreeMap<_, _>>());
        object
    }

    /// Returns the table for people; a line break ends each row.
    #[must_use]
    pub fn table(&self) -> String {
        let mut t = String::new();
        self.add_runs(&mut t);
        self.add_spreads(&mut t);
        self.add_mishaps(&mut t);
        self.add_failures(&mut t);
        t
    }

    /// Appends the rows about the runs: scenario, seeds, share of solved runs, rate.
    fn add_runs(&self, t: &mut String) {
        let header = &self.header;
        let shard = match header.shard.to_string() {
            whole if whole == "1/1" => String::new(),
            part => format!(", shard {part}"),
        };
        // A state file may begin at any seed up to 2^64 - 1.
        let last = header.seed.saturating_add(header.runs.saturating_sub(1));
        let scenario = format!("{}, seeds {}..{last}{shard}", header.scenario, header.seed);
        row(t, "scenario", &scenario);
        row(t, "runs", &format!("{} of {}", self.runs(), self.asked));
        let ([low, high], share) = (self.interval.map(|x| 100.0 * x), 100.0 * self.success());
        let interval = format!("95 % interval {low:.2} .. {high:.2} %");
        row(t, "solved", &format!("{} ({share:.2} %), {interval}", self.solved));
        // The times of parallel runs add up, so this is the rate of one process.
        let seconds: f64 = self.results.iter().map(|r| r.wall_time_s).sum();
        if seconds > 0.0 {
            let rate = 3600.0 * self.results.len() as f64 / seconds;
            row(t, "runs per hour, process", &format!("{rate:.0}"));
        }
        let plants = self.plants();
        if !plants.is_empty() {
            row(t, "plant hash", &plants.join(", "));
        }
    }

    /// Returns the hashes of the plants' parameters, each once. There is only one if the plants of
    /// all runs had the same limits: drives, friction, pads, cube, sensors and operator.
    pub(crate) fn plants(&self) -> Vec<&str> {
        let figures = self.results.iter().filter_map(|r| r.figures.as_ref());
        let plants: BTreeSet<&str> = figures.filter_map(|f| f.plant_hash.as_deref()).collect();
        plants.into_iter().collect()
    }

    /// Appends a row for the distribution of each quantity.
    fn add_spreads(&self, t: &mut String) {
        row(t, "", &Spread::COLUMNS.map(|name| format!("{name:>9}")).join(" "));
        for column in self.columns() {
            let values = column.spread().values();
            let text = values.map(|v| format!("{:>9}", figure(v, column.decimals)));
            row(t, &column.words, &text.join(" "));
        }
    }

    /// Appends the rows with the counts of mishaps, excessive contacts and runs without a verdict.
    fn add_mishaps(&self, t: &mut String) {
        let m = &self.mishaps;
        if self.concerns_cube() {
            row(t, "jams, slips, drops", &format!("{}, {}, {}", m.jams, m.slips, m.drops));
            let others = format!("{}, {}, {}", m.pops, m.crushed, m.collisions);
            row(t, "pops, crushes, bumps", &others);
        } else {
            row(t, "bumps", &m.collisions.to_string());
        }
        let (with, solved) = self.mishaps_and_solved;
        let any = format!("{with}, of which {solved} were solved");
        row(t, "runs with a mishap", &any);
        row(t, "recoveries", &self.recoveries.to_string());
        let above = format!("{} runs above {}", self.above_limit(), self.limit());
        row(t, "contact", &above);
        if self.concerns_cube() {
            row(t, "unnoticed drops", &format!("in {} runs", self.unnoticed()));
        }
        if self.contact_unknown() > 0 {
            let unknown = format!("in {} runs of an earlier build", self.contact_unknown());
            row(t, "unknown contact", &unknown);
        }
        row(t, "without a verdict", &format!("{} runs", self.without_verdict()));
    }

    /// Appends the failed runs by phase, and for the first [`LISTED`] the command that repeats
    /// each.
    fn add_failures(&self, t: &mut String) {
        let failed = self.runs() - self.solved;
        row(t, "failures", &if failed == 0 { "none".to_owned() } else { failed.to_string() });
        // The limit is for the whole table; each phase keeps its total.
        let mut listed = 0;
        for (phase, runs) in self.by_phase() {
            let _ = writeln!(t, "  in {phase}: {}", runs.len());
            for run in runs.iter().take(LISTED.saturating_sub(listed)) {
                listed += 1;
                let _ = writeln!(t, "    seed {} {}: {}", run.seed, run.verdict.word(), run.reason);
                let _ = writeln!(t, "      {}", self.command(run));
            }
        }
        if failed > LISTED as u64 {
            let _ = writeln!(t, "  (the first {LISTED}; the report and --json have all)");
        }
    }
}

/// Returns the phase in which a run ended, for people.
pub(super) fn phase(run: &RunResult) -> &str {
    if run.phase.is_empty() { "the start" } else { &run.phase }
}

/// Formats a value with `decimals` decimals. A value that is not whole, as a median of whole
/// numbers may be, gets one decimal at least.
pub(super) fn figure(value: f64, decimals: usize) -> String {
    // A result stores infinity and NaN as `f64::MAX`, which JSON can hold.
    if value.abs() >= 1e12 {
        return "not finite".to_owned();
    }
    let decimals = decimals.max(usize::from(value.fract() != 0.0));
    format!("{value:.decimals$}")
}

/// Appends a row to the table for people.
fn row(table: &mut String, name: &str, value: &str) {
    // Writing to a string cannot fail.
    let _ = writeln!(table, "{name:<22} {value}");
}

#[cfg(test)]
mod tests {
    use super::super::result::tests::result;
    use super::super::state::tests::header;
    use super::*;

    /// Returns the state of a shard from seed 5 on, in which seed 9 failed, seed 11 died, and the
    /// others are solved with a peak force (N) equal to the seed.
    fn state(runs: u64, shard: &str) -> State {
        let header = header(runs, shard);
        let outcome = |seed: u64| match seed {
            9 => result(seed, Verdict::Failed, 12.0),
            11 => RunResult { figures: None, ..result(seed, Verdict::Died, 0.0) },
            _ => result(seed, Verdict::Solved, seed as f64),
        };
        let results = header.seeds().map(|seed| (seed, outcome(seed))).collect();
        State { header, results, whole: 0, damaged: 0, torn: false }
    }

    #[test]
    fn merged_shards_equal_the_unsharded_campaign() {
        let whole = Tally::of(&state(20, "1/1")).json().to_string();
        for order in [["1/3", "2/3", "3/3"], ["3/3", "1/3", "2/3"]] {
            let mut merged = state(20, order[0]);
            merged.merge(state(20, order[1])).unwrap();
            merged.merge(state(20, order[2])).unwrap();
            // A shard that is merged twice changes nothing.
            merged.merge(state(20, order[1])).unwrap();

            assert_eq!(Tally::of(&merged).json().to_string(), whole);
        }
    }

    #[test]
    fn merge_refuses_parts_of_different_campaigns() {
        let mut other = state(20, "2/3");
        other.header.set = vec!["control.grip_n=30".into()];
        let why = state(20, "1/3").merge(other).unwrap_err();
        assert!(why.contains("--set"), "{why}");
        let longer = state(20, "1/3").merge(state(21, "2/3")).unwrap_err();
        assert!(longer.contains("20 and 21"), "{longer}");
        // A run that exceeds one time limit might be solved within another.
        let mut patient = state(20, "2/3");
        patient.header.limit_s += 1;
        let why = state(20, "1/3").merge(patient).unwrap_err();
        assert!(why.contains("time limits: 600 and 601"), "{why}");
    }

    #[test]
    fn merge_marks_different_builds_in_any_order() {
        let built = |k: &str, build: &str| {
            let mut shard = state(20, k);
            build.clone_into(&mut shard.header.build);
            shard
        };
        let parts = [built("1/3", "b"), built("2/3", "c"), built("3/3", "b")];
        for order in [[0, 1, 2], [0, 2, 1], [1, 0, 2]] {
            let mut merged = parts[order[0]].clone();
            merged.merge(parts[order[1]].clone()).unwrap();
            merged.merge(parts[order[2]].clone()).unwrap();

            let tally = Tally::of(&merged);
            assert!(tally.is_complete() && !tally.is_of_one_build());
            assert_eq!(tally.json()["build"], "several");
        }
    }

    #[test]
    fn json_of_tally_has_the_documented_fields() {
        let tally = Tally::of(&state(20, "1/1"));
        let object = tally.json();

        assert_eq!((&object["build"], tally.is_of_one_build()), (&json!("b"), true));
        assert_eq!((&object["runs"], &object["solved"]), (&json!(20), &json!(18)));
        assert_eq!(object["interval"], json!(wilson(18, 20)));
        assert_eq!(object["failures"][0]["seed"], 9);
        assert_eq!(object["failures"][1]["phase"], "solve");
        assert_eq!(object["without_verdict"], 1);
        // The contact is the force plus 1 N and the limit is 20 N: seeds 20 to 24 exceed it.
        assert_eq!((&object["runs_above_force_limit"], &object["drops"]), (&json!(5), &json!(0)));
        assert_eq!(
            (&object["contact_unknown"], &object["runs_with_unnoticed_drops"]),
            (&json!(0), &json!(0))
        );
        assert_eq!(
            (&object["force_limit_n"]["max"], &object["peak_contact_n"]["max"]),
            (&json!(20.0), &json!(25.0))
        );
        assert!(tally.table().contains("5 runs above 20.0 N"), "{}", tally.table());
        for name in ["peak_force_n", "peak_contact_n", "grasps", "turns", "sim_time_s"] {
            for part in ["min", "median", "p95", "p99", "max"] {
                assert!(object[name][part].is_f64(), "{name}.{part}");
            }
        }
        assert_eq!(object["peak_force_n"]["max"], 24.0);
        assert!(
            tally.is_complete()
                && !Tally::of(&State { results: BTreeMap::new(), ..state(20, "1/1") })
                    .is_complete()
        );
    }

    #[test]
    fn runs_with_mishaps_or_unknown_forces_are_counted() {
        let mut state = state(20, "1/1");
        let mut of = |seed: u64, change: &dyn Fn(&mut Figures)| {
            let figures = state.results.get_mut(&seed).and_then(|run| run.figures.as_mut());
            change(figures.unwrap());
        };
        // One mishap is enough for a run with mishaps; the run of seed 9 was not solved.
        of(5, &|f| f.mishaps.jams = 1);
        of(6, &|f| f.mishaps.slips = 3);
        of(9, &|f| f.mishaps.pops = 1);
        // A controller that reports more drops than there were has missed none.
        of(7, &|f| (f.mishaps.drops, f.drops_noticed) = (1, Some(2)));
        of(8, &|f| (f.mishaps.drops, f.drops_noticed) = (2, Some(1)));
        of(10, &|f| f.drops_noticed = Some(0));
        // A run that lacks one of the two values counts as unknown, and never as above the limit.
        of(12, &|f| (f.peak_contact_n, f.drops_noticed) = (None, Some(0)));
        of(13, &|f| (f.force_limit_n, f.drops_noticed) = (Some(20.0), None));
        for (seed, plant) in [(5, "b"), (6, "a"), (7, "b")] {
            of(seed, &|f| f.plant_hash = Some(plant.to_owned()));
        }

        let object = Tally::of(&state).json();

        assert_eq!(object["plant_hashes"], json!(["a", "b"]), "each plant once");
        assert_eq!(
            (&object["runs_with_mishaps"], &object["solved_with_mishaps"]),
            (&json!(5), &json!(4))
        );
        assert_eq!((&object["drops"], &object["mishaps"]["slips"]), (&json!(3), &json!(3)));
        assert_eq!(object["runs_with_unnoticed_drops"], 1);
        // Seeds 20 to 24, and no run that counts as unknown.
        assert_eq!(
            (&object["runs_above_force_limit"], &object["contact_unknown"]),
            (&json!(5), &json!(2))
        );
    }

    #[test]
    fn failure_lists_the_command_that_repeats_it() {
        let mut state = state(5, "1/1");
        state.header.set = vec!["plant.cube_kind=\"dry\"".into()];
        if let Some(run) = state.results.get_mut(&9) {
            run.set = vec!["control.grip_n=26.5".into()];
        }
        let table = Tally::of(&state).table();

        assert!(
            table.contains(
                "rubik-robot run s.toml --seed 9 --set 'plant.cube_kind=\"dry\"' \
                 --set control.grip_n=26.5"
            ),
            "{table}"
        );
    }

    #[test]
    fn median_between_integers_is_printed_with_its_half() {
        assert_eq!((figure(14.5, 0).as_str(), figure(14.0, 0).as_str()), ("14.5", "14"));
        assert_eq!((figure(2.0, 1).as_str(), figure(2.345, 2).as_str()), ("2.0", "2.35"));
    }
}
