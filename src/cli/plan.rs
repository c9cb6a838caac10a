//! `rubik-robot plan`: what two arms do with a cube, without moving them.

use super::engine::{PlanSearch, default_tables};
use super::output::{Output, WRONG, complain, refuse};
use super::solve::{Refusal, read};
use crate::cube::{Cube, format_turns};
use crate::solver::{self, Budget};
use crate::tables::{Store, Threads};
use crate::tasks::cube::hold::Step;
use crate::tasks::cube::plan::{Effort, NoPlan, Plan, Rule, taken};
use crate::{run, scenario};
use clap::{Args, ValueEnum};
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Args)]
pub(super) struct PlanArgs {
    /// 54 letters URFDLB, the faces U R F D L B in reading order, each sticker named by its centre
    cube: String,
    /// Which pairs of holds are allowed [default: what the cell's grippers allow]
    #[arg(long, value_enum)]
    rule: Option<RuleWord>,
    /// Plan for so long at most; without it, the scenario's planner.node_budget and
    /// planner.candidates
    #[arg(long, value_name = "N")]
    budget_ms: Option<u64>,
    /// Say for each step who holds what, how long it takes and why it is needed
    #[arg(long)]
    explain: bool,
    /// Cell, grippers and speeds of this scenario instead of the built-in ones
    #[arg(long, value_name = "FILE")]
    scenario: Option<PathBuf>,
    /// One line of JSON
    #[arg(long)]
    json: bool,
}

#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Clone, Copy, ValueEnum)]
enum RuleWord {
    /// As in 2007: one turn for two grasps, four for the opposite face
    Original,
    /// Palms touch the cube
    Strict,
    /// Palms stand off: layers turn between hands at right angles, too
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

pub(super) fn run(args: &PlanArgs, output: &mut Output) -> anyhow::Result<u8> {
    let scenario = match &args.scenario {
        Some(path) => scenario::load(path, &[]),
        None => scenario::read(Path::new("the built-in cell"), "", &[]),
    };
    let scenario = scenario.map_err(refuse)?;
    let cube = match read(&args.cube) {
        Ok((cube, _)) => cube,
        Err(refusal) => return print_refusal(&refusal, args, output),
    };
    let planner = run::planner(&scenario.controller).map_err(refuse)?;
    let planner = args.rule.map_or(planner.clone(), |rule| planner.by_rule(rule.into()));
    let keys = &scenario.controller.planner;
    let effort = Effort { nodes: keys.node_budget, candidates: keys.candidates as usize };
    // Those of a mission, whatever else is kept: its plan is to be shown.
    let tables = default_tables(&Store::of_user(), Threads::all());
    let begun = Instant::now();
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

fn print_refusal(refusal: &Refusal, args: &PlanArgs, output: &mut Output) -> anyhow::Result<u8> {
    if args.json {
        output.line(&refusal.json(&args.cube).to_string())?;
    } else {
        let repair = refusal.repair().map(|r| format!("; least repair: {r}"));
        complain(&format!("{}{}", refusal.message(), repair.unwrap_or_default()));
    }
    Ok(WRONG)
}

/// A plan with what it is measured by.
struct Work {
    rule: Rule,
    plan: Plan,
    /// Hand-overs of the looks before it.
    looks: usize,
    baseline: Result<Plan, NoPlan>,
    time: Duration,
}

/// Plans, with all the effort at once, or doubling it until the time would be over.
fn work(search: &PlanSearch<'_>, cube: &Cube) -> Result<Work, NoPlan> {
    let planner = search.planner;
    let begun = Instant::now();
    let (steps, start) = planner.looks(taken())?;
    let looks = steps.iter().filter(|s| matches!(s, Step::Grasp { .. })).count();
    let (plan, nodes) = search.best(cube, start)?;
    let shortest = solver::solve(cube, search.tables, &Budget { nodes, max_length: 0 }).turns;
    let original = planner.by_rule(Rule::Original);
    let baseline = original.looks(taken()).and_then(|(_, start)| original.of(&[shortest], start));
    Ok(Work { rule: planner.rule(), plan, looks, baseline, time: begun.elapsed() })
}

/// Grasps that serve to hand the cube over, not to turn.
fn hand_overs(plan: &Plan) -> usize {
    let turns_next = |i: usize| matches!(plan.steps.get(i + 1), Some(Step::Turn { .. }));
    let grasps = plan.steps.iter().enumerate();
    grasps.filter(|(i, s)| matches!(s, Step::Grasp { .. }) && !turns_next(*i)).count()
}

impl Work {
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

    fn text(&self, explain: bool) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = self.write(&mut text, explain);
        text
    }

    fn write(&self, text: &mut String, explain: bool) -> std::fmt::Result {
        let plan = &self.plan;
        if explain {
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
                writeln!(text, "{}", row("the original's rule", original))?;
                let fewer = 1.0 - plan.grasps as f64 / original.grasps.max(1) as f64;
                write!(text, "{:.0} % fewer grasps. ", 100.0 * fewer)?;
            }
            Err(reason) => write!(text, "The original's rule: {reason}. ")?,
        }
        write!(
            text,
            "Planned in {:.2} s; the looks before it take {} hand-over{}.\n\n{}",
            self.time.as_secs_f64(),
            self.looks,
            if self.looks == 1 { "" } else { "s" },
            format_turns(&plan.turns)
        )
    }
}
