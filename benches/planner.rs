//! Quality and time of the plans of two arms for seeded cubes, for each rule of grasping:
//! `cargo bench --bench planner -- --cubes 1000`.
//!
//! Each plan is for the reach and speeds of the built-in cell. It begins as the mission's plan
//! does, after the looks at the cube, and counts only after a replay on a cube of stickers with two
//! hands. The baseline is the rule of the original robot, with the shortest solution that the same
//! search finds.

use rubik_robot::cube::Cube;
use rubik_robot::run;
use rubik_robot::solver::{Budget, Tables, candidates, solve};
use rubik_robot::tasks::cube::plan::{Effort, Plan, Planner, Rule, taken};
use std::cell::Cell;
use std::path::Path;
use std::time::Instant;

/// Plans the solution of each cube by each rule, and prints a table of turns, grasps and times.
fn main() {
    let number = |name: &str, default: u64| {
        let mut arguments = std::env::args().skip_while(|a| a != name).skip(1);
        arguments.next().and_then(|n| n.parse().ok()).unwrap_or(default)
    };
    let cubes = number("--cubes", 20);
    let effort = Effort {
        nodes: number("--nodes", 1_000_000),
        candidates: number("--candidates", 10_000) as usize,
    };
    let scenario = match rubik_robot::tasks::read(Path::new("built-in"), "", &[]) {
        Ok(scenario) => scenario,
        Err(faults) => return eprintln!("{faults}"),
    };
    let planner = match run::planner(&scenario.controller) {
        Ok(planner) => planner,
        Err(reason) => return eprintln!("{reason}"),
    };
    let tables = Tables::build();
    println!(
        "{cubes} seeded cubes, {} nodes, up to {} solutions each\n",
        effort.nodes, effort.candidates
    );
    println!(
        "| plan | turns | grasps | a turn | most | robot time s | planned in ms, mean | longest |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let baseline = row("original, shortest", cubes, |cube| {
        let budget = Budget { nodes: effort.nodes, max_length: 0 };
        plan_fastest(&planner.by_rule(Rule::Original), &[solve(cube, &tables, &budget).turns])
    });
    row("strict, shortest", cubes, |cube| {
        let budget = Budget { nodes: effort.nodes, max_length: 0 };
        plan_fastest(&planner.by_rule(Rule::Strict), &[solve(cube, &tables, &budget).turns])
    });
    for rule in [Rule::Strict, Rule::Clearance] {
        let planner = planner.by_rule(rule);
        let start = planner.looks(taken()).map(|(_, start)| start);
        let name = format!("{rule:?}, best of many").to_lowercase();
        let (compared, comparing) = (Cell::new(0), Cell::new(0.0));
        let grasps = row(&name, cubes, |cube| {
            let budget = Budget { nodes: effort.nodes, max_length: 0 };
            let list = candidates(cube, &tables, &budget, effort.candidates);
            let begun = Instant::now();
            let plan = start.clone().and_then(|start| planner.of(&list, start)).ok();
            comparing.set(comparing.get() + begun.elapsed().as_secs_f64());
            compared.set(compared.get() + list.len() as u64);
            plan
        });
        println!(
            "{} solutions a cube, compared in {:.0} us each",
            compared.get() / cubes.max(1),
            1e6 * comparing.get() / compared.get().max(1) as f64
        );
        println!(
            "{:.0} % fewer grasps than the original's rule",
            100.0 * (1.0 - grasps / baseline)
        );
    }
}

/// Returns the fastest plan by which the two arms execute one of the `solutions`, each a sequence
/// of turns. The plan begins with the grips that the hands have once all six faces have been read.
/// Returns `None` if the arms can execute none of the solutions.
fn plan_fastest(planner: &Planner, solutions: &[Vec<rubik_robot::cube::Turn>]) -> Option<Plan> {
    let (_, start) = planner.looks(taken()).ok()?;
    planner.of(solutions, start).ok()
}

/// Calls `plan` for the cubes that the seeds 0 to `cubes` - 1 scramble, and prints the row `name`
/// of the table: means over the cubes of the turns, the grasps and the times. Returns the mean
/// number of grasps of a plan.
fn row(name: &str, cubes: u64, plan: impl Fn(&Cube) -> Option<Plan>) -> f64 {
    let (mut turns, mut grasps, mut most, mut seconds) = (0.0, 0.0, 0, 0.0);
    let (mut whole, mut longest, mut missing) = (0.0, 0.0_f64, 0);
    for seed in 0..cubes {
        let begun = Instant::now();
        let found = plan(&Cube::scrambled(seed));
        let took = begun.elapsed().as_secs_f64() * 1e3;
        whole += took;
        longest = longest.max(took);
        let Some(plan) = found else {
            missing += 1;
            continue;
        };
        turns += plan.turns.len() as f64;
        grasps += plan.grasps as f64;
        most = most.max(plan.grasps);
        seconds += plan.cost;
    }
    let n = (cubes - missing).max(1) as f64;
    println!(
        "| {name} | {:.1} | {:.1} | {:.2} | {most} | {:.0} | {:.0} | {longest:.0} |",
        turns / n,
        grasps / n,
        grasps / turns.max(1.0),
        seconds / n,
        whole / cubes.max(1) as f64,
    );
    if missing > 0 {
        println!("{missing} cubes without a plan");
    }
    grasps / n
}
