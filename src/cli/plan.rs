//! `rubik-robot plan`: plans the grasps and turns of both arms for a cube, without moving them.
//!
//! - in: a cube, a cell, the rule of the grippers
//! - out: the plan with its time, beside a plan by the rule of the original robot of 2007

use super::catalogue;
use super::engine::{PlanSearch, default_tables};
use super::output::{Output, WRONG, complain, inform, refuse};
use super::scenarios;
use super::solve::{Refusal, read, scramble_of};
use crate::cube::{Cube, format_turns};
use crate::run;
use crate::solver::{self, Budget};
use crate::tables::{Store, Threads};
use crate::tasks::cube::door::planner_keys;
use crate::tasks::cube::hold::Step;
use crate::tasks::cube::plan::{Effort, NoPlan, Plan, Rule, taken};
use clap::{Args, ValueEnum};
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Args)]
pub(super) struct PlanArgs {
    /// State of the cube: 54 letters, faces in the order U R F D L B, each in reading order
    cube: String,
    /// Rule of the planner (below) for holding the cube with both hands and turning
    /// layers: original, strict or clearance [default: that of the grippers]
    #[arg(long, value_enum, verbatim_doc_comment, hide_possible_values = true)]
    rule: Option<RuleWord>,
    /// Time limit of the planner by the wall clock (ms) [default: none, but the
    /// keys planner.node_budget (states) and planner.candidates (solutions)]
    #[arg(long, value_name = "N", verbatim_doc_comment)]
    budget_ms: Option<u64>,
    /// Print each step of the plan first, with its start (s), hands and reason
    #[arg(long)]
    explain: bool,
    /// Scenario file (TOML) with the cell [default: the built-in cell]
    #[arg(long, value_name = "FILE", value_parser = scenarios::parser())]
    scenario: Option<PathBuf>,
    /// Print one line of JSON
    #[arg(long)]
    json: bool,
}

/// Rule of the planner ([`Rule`]), as a word of the command line.
#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Clone, Copy, ValueEnum)]
enum RuleWord {
    /// Rule of the original robot of 2007: two grasps for each turn, four if the face is opposite
    /// to that of the turn before
    Original,
    /// Palms touch the cube: only hands on opposite faces can turn a layer
    Strict,
    /// Palms keep a distance from the cube: hands on adjacent faces can turn a layer as well
    Clearance,
}

impl From<RuleWord> for Rule {
    fn from(word: RuleWord) -> Self {
        match word {
            RuleWord::Original => Self::Original,
            RuleWord::Strict => Self::Strict,
            RuleWord::Clearance => Self::Clearance,
        }
    }
}

/// Plans the cube of the arguments and prints the plan; returns the exit code.
pub(super) fn run(args: &PlanArgs, output: &mut Output) -> anyhow::Result<u8> {
    let scenario = match &args.scenario {
        Some(path) => catalogue::load(path, &[]),
        None => catalogue::read(Path::new("the built-in cell"), "", &[]),
    };
    let scenario = scenario.map_err(refuse)?;
    let cube = match read(&args.cube) {
        Ok((cube, _)) => cube,
        Err(refusal) => return print_refusal(&refusal, args, output),
    };
    let planner = run::planner(&scenario.controller).map_err(refuse)?;
    let planner = args.rule.map_or(planner.clone(), |rule| planner.by_rule(rule.into()));
    let keys = &planner_keys(&scenario.controller);
    let effort = Effort { nodes: keys.node_budget, candidates: keys.candidates as usize };
    // A mission uses the default tables. With the large ones the plan could differ from its plan.
    let tables = default_tables(&Store::for_user(), Threads::all());
    let begun = Instant::now();
    // The time limit covers the planning, not the tables.
    let time = args.budget_ms.map(Duration::from_millis);
    let search = PlanSearch { planner: &planner, tables: &tables, effort, time };
    match work(&search, &cube) {
        Ok(mut work) => {
            work.time = begun.elapsed();
            let text =
                if args.json { work.json(&args.cube).to_string() } else { work.text(args.explain) };
            output.line(&text)?;
            Ok(0)
        }
        Err(reason) => {
            complain(&reason.to_string());
            Ok(1)
        }
    }
}

/// Prints why a cube is refused; returns the exit code.
fn print_refusal(refusal: &Refusal, args: &PlanArgs, output: &mut Output) -> anyhow::Result<u8> {
    if args.json {
        output.line(&refusal.json(&args.cube).to_string())?;
    } else {
        let repair = refusal.repair().map(|r| format!("; smallest repair: {r}"));
        complain(&format!("{}{}", refusal.message(), repair.unwrap_or_default()));
        if let Some(advice) = scramble_of(&args.cube) {
            inform(&advice);
        }
    }
    Ok(WRONG)
}

/// Plan for a cube, beside the plan of the original robot.
struct Work {
    /// Rule of `plan`.
    rule: Rule,
    plan: Plan,
    /// Number of hand-overs before the plan, while the faces are shown to the cameras.
    looks: usize,
    /// Plan of the shortest solution by the rule of the original robot.
    baseline: Result<Plan, NoPlan>,
    /// Computing time.
    time: Duration,
}

/// Plans the solution of a cube, and for comparison its shortest solution by the rule of the
/// original robot.
fn work(search: &PlanSearch<'_>, cube: &Cube) -> Result<Work, NoPlan> {
    let planner = search.planner;
    let begun = Instant::now();
    let (steps, start) = planner.looks(taken())?;
    // The hand-overs for showing the faces come before any plan, so they are counted apart.
    let looks = steps.iter().filter(|s| matches!(s, Step::Grasp { .. })).count();
    let (plan, nodes) = search.best(cube, start)?;
    // The original robot took the shortest solution, without regard to its grasps.
    let shortest = solver::solve(cube, search.tables, &Budget { nodes, max_length: 0 }).turns;
    let original = planner.by_rule(Rule::Original);
    let baseline = original.looks(taken()).and_then(|(_, start)| original.of(&[shortest], start));
    Ok(Work { rule: planner.rule(), plan, looks, baseline, time: begun.elapsed() })
}

/// Returns the number of hand-overs: grasps that are not followed by a turn.
fn hand_overs(plan: &Plan) -> usize {
    let turns_next = |i: usize| matches!(plan.steps.get(i + 1), Some(Step::Turn { .. }));
    let grasps = plan.steps.iter().enumerate();
    grasps.filter(|(i, s)| matches!(s, Step::Grasp { .. }) && !turns_next(*i)).count()
}

impl Work {
    /// Returns the comparison as JSON.
    fn json(&self, cube: &str) -> Value {
        let brief = |plan: &Plan| {
            json!({
                "solution": format_turns(&plan.turns),
                "turns": plan.turns.len(),
                "grasps": plan.grasps,
                "hand_overs": hand_overs(plan),
                "robot_time_s": plan.cost,
            })
        };
        let mut all = brief(&self.plan);
        all["cube"] = Value::from(cube);
        all["rule"] = serde_json::to_value(self.rule).unwrap_or_default();
        all["steps"] = serde_json::to_value(&self.plan.lines).unwrap_or_default();
        all["identification_hand_overs"] = Value::from(self.looks);
        all["time_s"] = Value::from(self.time.as_secs_f64());
        all["baseline"] = match &self.baseline {
            Ok(plan) => brief(plan),
            Err(reason) => json!({"error": reason.to_string()}),
        };
        all
    }

    /// Returns the comparison as text.
    fn text(&self, explain: bool) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = self.write(&mut text, explain);
        text
    }

    /// Writes the steps of the plan if `explain`, then the comparison of both plans and the turns.
    fn write(&self, text: &mut String, explain: bool) -> std::fmt::Result {
        let plan = &self.plan;
        if explain {
            // Each step begins when the one before it ends.
            let mut at = 0.0;
            for (i, line) in plan.lines.iter().enumerate() {
                writeln!(
                    text,
                    "{:3}. {at:5.0} s  {}\n              {}",
                    i + 1,
                    line.what,
                    line.why
                )?;
                at += line.seconds;
            }
            writeln!(text)?;
        }
        let row = |name: &str, plan: &Plan| {
            let (turns, over) = (plan.turns.len(), hand_overs(plan));
            format!("{name:<26} {turns:>5} {:>6} {over:>10} {:>9.0} s", plan.grasps, plan.cost)
        };
        writeln!(text, "{:<26} turns grasps hand-overs robot time", "")?;
        writeln!(text, "{}", row("this plan", plan))?;
        match &self.baseline {
            Ok(original) => {
                writeln!(text, "{}", row("rule of the original robot", original))?;
                // The comparison is by grasps, since a grasp costs more time than a turn.
                let fewer = 1.0 - plan.grasps as f64 / original.grasps.max(1) as f64;
                write!(text, "{:.0} % fewer grasps. ", 100.0 * fewer)?;
            }
            Err(reason) => write!(text, "Rule of the original robot: {reason}. ")?,
        }
        write!(
            text,
            "Planned in {:.2} s; reading the faces before takes {} hand-over{}.\n\n{}",
            self.time.as_secs_f64(),
            self.looks,
            if self.looks == 1 { "" } else { "s" },
            format_turns(&plan.turns)
        )
    }
}
