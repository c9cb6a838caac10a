//! Times and lengths of the solver beside those of two public solvers:
//! `cargo bench --bench solver`.
//!
//! All solvers get the same cubes in one run, with one thread each. Times are CPU time of that
//! thread, which depends less on the load of the machine than the time of a clock.
//!
//! - `-- --cubes FILE`: a list of cubes, 54 letters URFDLB a line
//! - `-- --optimal`: shortest solutions as well, with the tables for them that are in the cache
//!   folder
//!
//! The bench also uses the large tables of the two-phase search if they are in the cache folder
//! (`rubik-robot tables build`).

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a bench that cannot go on should stop loudly"
)]

use rubik_robot::cube::{Axis, Cube, Face, Facelets, format_turns};
use rubik_robot::motion::Depth;
use rubik_robot::solver::korf::{self, Korf};
use rubik_robot::solver::optimal::{self, Optimal};
use rubik_robot::solver::shortest::shortest;
use rubik_robot::solver::table::{InTurn, Workers};
use rubik_robot::solver::{Budget, Tables, Watch, candidates, solve_watched};
use rubik_robot::tables::{Residence, Store, Threads};
use rubik_robot::tasks::cube::hold::{Grip, Hand, Hold};
use rubik_robot::tasks::cube::plan::{Everywhere, Rule, Terms, plan};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Number of cubes if the option `--cubes` names no list.
const CUBES: u64 = 100;

/// Measures all solvers on the same cubes and prints a table.
fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let after = |name: &str| {
        let at = arguments.iter().position(|a| a == name)?;
        arguments.get(at + 1)
    };
    // `cargo test --benches` also runs this bench: one cube shows that it works.
    let test = arguments.iter().any(|a| a == "--test");
    let cubes: Vec<Cube> = match after("--cubes") {
        Some(file) => read(file),
        None => (0..if test { 1 } else { CUBES }).map(Cube::scrambled).collect(),
    };
    println!(
        "{} cubes; CPU time of one thread [ms]; turns of faces, half turns count one\n",
        cubes.len()
    );
    let store = Store::for_user().with(Residence::Copied);
    let all = Threads::all();
    let before = Instant::now();
    let default = Tables::build_with(&all);
    println!(
        "default tables: {:.1} MB, built in {:.2} s by {} threads",
        default.size() as f64 / 1e6,
        before.elapsed().as_secs_f64(),
        all.count()
    );
    let open = |spec: &&_| store.open(spec, &all).ok();
    let large: Option<Vec<_>> = Tables::LARGE.iter().map(open).collect();
    let large = large.map(|tables| Tables::with(&tables));
    match &large {
        Some(tables) => println!("large tables: {:.1} MB", tables.size() as f64 / 1e6),
        None => println!("large tables: not built (`rubik-robot tables build` makes them)"),
    }
    header();
    let firsts = [
        peer(&cubes, "min2phase 0.2.4, first", |cube| min2phase::solve(&cube, 25)),
        peer_kewb(&cubes),
    ];
    ours(&cubes, "first", &default, large.as_ref(), Budget::FIRST, firsts[0]);
    for most in [21, 20] {
        let theirs = peer(&cubes, &format!("min2phase 0.2.4, <= {most}"), |cube| {
            min2phase::solve(&cube, most)
        });
        let budget = Budget { nodes: u64::MAX, max_length: most };
        ours(&cubes, &format!("<= {most}"), &default, large.as_ref(), budget, theirs);
    }
    println!();
    let few = &cubes[..cubes.len().min(if test { 1 } else { 1000 })];
    for threads in [1, 2] {
        best_in(few, Duration::from_millis(10), threads, large.as_ref().unwrap_or(&default));
    }
    if arguments.iter().any(|a| a == "--optimal") {
        proven(&cubes, &store, large.as_ref().unwrap_or(&default));
        korfs_reach(&cubes, &store);
    }
    planner(&default);
}

/// Reads cubes from a file that has the 54 facelet letters of one cube in each line.
fn read(file: &str) -> Vec<Cube> {
    let text = std::fs::read_to_string(file).expect("a list of cubes");
    let facelets =
        text.lines().filter(|l| !l.trim().is_empty()).map(|l| l.parse::<Facelets>().unwrap());
    facelets.map(|f| Cube::try_from(f).unwrap()).collect()
}

/// Prints the heads of the columns: CPU times (ms), mean number of turns, and how many times faster
/// this project's solver is.
fn header() {
    println!(
        "\n{:34} {:>8} {:>8} {:>8} {:>8} {:>7} {:>8}",
        "", "mean", "p50", "p99", "max", "turns", "ratio"
    );
}

/// Prints the row `name` of the table: mean, median, 99th percentile and maximum of the `times`
/// that a solver took, one for each cube (ms), the mean length of its solutions, and how many times
/// faster it is than a peer with the mean time `theirs` (ms). `turns` is the sum of the lengths.
/// Returns the mean time (ms).
fn row(name: &str, mut times: Vec<f64>, turns: usize, theirs: Option<f64>) -> f64 {
    let count = times.len();
    times.sort_by(f64::total_cmp);
    let mean = times.iter().sum::<f64>() / count as f64;
    let at = |share: usize| times[(count * share / 100).min(count - 1)];
    let ratio = theirs.map_or_else(String::new, |t| format!("{:.2} x", t / mean));
    println!(
        "{name:34} {mean:8.3} {:8.3} {:8.3} {:8.3} {:7.2} {ratio:>8}",
        at(50),
        at(99),
        times[count - 1],
        turns as f64 / count as f64
    );
    mean
}

/// Measures this project's solver and prints a row for each of its two sets of tables; `large` is
/// `None` if that set has not been built. `what` names the kind of search in the row, and `theirs`
/// is the mean time of the peer to compare with (ms).
fn ours(
    cubes: &[Cube],
    what: &str,
    default: &Tables,
    large: Option<&Tables>,
    budget: Budget,
    theirs: f64,
) {
    for (name, tables) in [("default", Some(default)), ("large", large)] {
        let Some(tables) = tables else { continue };
        let stop = AtomicBool::new(false);
        // A search for a length without a limit of nodes can skip longer solutions from the start.
        let longest = (budget.nodes == u64::MAX).then_some(budget.max_length);
        let watch =
            Watch { workers: &InTurn, stop: &stop, improved: &|_| (), excluded: &|_| (), longest };
        let (mut times, mut turns) = (Vec::new(), 0);
        for cube in cubes {
            let before = cpu();
            let solution = solve_watched(cube, tables, &budget, &watch);
            times.push((cpu() - before) * 1e3);
            assert!(cube.apply_all(&solution.turns).is_solved());
            turns += solution.turns.len();
        }
        row(&format!("ours, {name} tables, {what}"), times, turns, Some(theirs));
    }
}

/// Measures another project's solver, prints its row and returns its mean time (ms). `solve` takes
/// the 54 facelet letters of a cube and returns the turns of a solution, separated by blanks.
fn peer(cubes: &[Cube], name: &str, solve: impl Fn(String) -> String) -> f64 {
    // The first call builds its tables, which must not count.
    solve(Facelets::from(&Cube::scrambled(1)).to_string());
    let (mut times, mut turns) = (Vec::new(), 0);
    for cube in cubes {
        let facelets = Facelets::from(cube).to_string();
        let before = cpu();
        let solution = solve(facelets);
        times.push((cpu() - before) * 1e3);
        turns += solution.split_whitespace().count();
    }
    row(name, times, turns, None)
}

/// Measures the solver of the crate `kewb`, prints its row and returns its mean time (ms).
fn peer_kewb(cubes: &[Cube]) -> f64 {
    let table = kewb::DataTable::default();
    let (mut times, mut turns) = (Vec::new(), 0);
    for cube in cubes {
        let facelets = Facelets::from(cube).to_string();
        let state =
            kewb::CubieCube::try_from(&kewb::FaceCube::try_from(&*facelets).unwrap()).unwrap();
        let before = cpu();
        let mut solver = kewb::Solver::new(&table, 23, None);
        let solution = solver.solve(state).unwrap();
        times.push((cpu() - before) * 1e3);
        turns += solution.to_string().split_whitespace().count();
    }
    row(&format!("kewb 0.4.3, <= 23 ({} cubes)", cubes.len()), times, turns, None)
}

/// Solves each cube with `threads` threads, stops the search after `time` of wall clock, and prints
/// the mean number of turns of the best solutions found until then.
fn best_in(cubes: &[Cube], time: Duration, threads: usize, tables: &Tables) {
    let mut turns = 0;
    for cube in cubes {
        let stop = AtomicBool::new(false);
        let watch = Watch {
            workers: &Threads::new(threads),
            stop: &stop,
            improved: &|_| (),
            excluded: &|_| (),
            longest: None,
        };
        std::thread::scope(|scope| {
            scope.spawn(|| {
                std::thread::sleep(time);
                stop.store(true, Ordering::Relaxed);
            });
            turns += solve_watched(cube, tables, &Budget::UNTIL_PROVEN, &watch).turns.len();
        });
    }
    println!(
        "best in {} ms by the clock, {threads} threads: {:.2} turns",
        time.as_millis(),
        turns as f64 / cubes.len() as f64
    );
}

/// Measures the search for a provably shortest solution of each cube, once with each pruning table
/// that is in the cache folder, and prints the mean CPU time by length of the solution.
fn proven(cubes: &[Cube], store: &Store, tables: &Tables) {
    let all = Threads::all();
    for spec in &optimal::TABLES {
        let Ok(bytes) = store.open(spec, &all) else { continue };
        let search = Optimal::new((*bytes).as_ref()).unwrap();
        let stop = AtomicBool::new(false);
        let watch = Watch {
            workers: &InTurn,
            stop: &stop,
            improved: &|_| (),
            excluded: &|_| (),
            longest: None,
        };
        println!(
            "\nproven, table {} of {:.0} MB; CPU time [s] by length",
            spec.name,
            spec.bytes as f64 / 1e6
        );
        let mut by_length = std::collections::BTreeMap::<usize, Vec<f64>>::new();
        for cube in cubes {
            let before = cpu();
            let found = shortest(cube, tables, &search, optimal::Limits::NONE, &watch);
            let length = found.turns.expect("every cube has a solution").len();
            by_length.entry(length).or_default().push(cpu() - before);
        }
        for (length, times) in by_length {
            let mean = times.iter().sum::<f64>() / times.len() as f64;
            println!("{length} turns: {:5} cubes, {mean:8.3} s", times.len());
        }
    }
}

/// Number of cubes for the reach of Korf's search, which takes seconds a cube.
const REACH_CUBES: usize = 10;

/// Measures how far Korf's search with its own three tables gets within budgets of nodes, if these
/// tables are in the cache folder: prints the lengths that it excludes, and the CPU time.
fn korfs_reach(cubes: &[Cube], store: &Store) {
    let all = Threads::all();
    let opened: Option<Vec<_>> =
        korf::TABLES.iter().map(|spec| store.open(spec, &all).ok()).collect();
    let Some(tables) = opened else {
        println!("\nKorf's tables: not built (`rubik-robot tables build` makes them)");
        return;
    };
    let search = Korf::new([0, 1, 2].map(|i| (*tables[i]).as_ref())).unwrap();
    println!("\nKorf's three tables; first turns that are not excluded, CPU time [s] a cube");
    for max_nodes in [2_000_000, 20_000_000] {
        let few = &cubes[..cubes.len().min(REACH_CUBES)];
        let limits = optimal::Limits { max_nodes, ..optimal::Limits::NONE };
        let (before, mut reach) = (cpu(), Vec::new());
        for cube in few {
            let found = search.solve(cube, limits, &InTurn, &AtomicBool::new(false));
            reach.push(found.at_least);
        }
        let seconds = (cpu() - before) / few.len() as f64;
        println!("{max_nodes:11} nodes: reach {reach:?}, {seconds:8.3} s");
    }
}

/// Measures the planner of the two arms: prints, for each rule of grasping, the time to choose one
/// of 24 solutions of a cube, and the number of grasps of the chosen plan.
fn planner(tables: &Tables) {
    let budget = Budget { nodes: 100_000, max_length: 20 };
    let list = candidates(&Cube::scrambled(1), tables, &budget, 24);
    let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
    let start = (Hand::Track, Grip { hold, half_roll: false });
    println!();
    for rule in [Rule::Original, Rule::Strict, Rule::Clearance] {
        let before = cpu();
        let plan = plan(&list, start, &Terms::of(rule), &Everywhere).unwrap();
        println!(
            "plan of 24 candidates, {rule:?}: {:.2} ms, {} grasps for {}",
            (cpu() - before) * 1e3,
            plan.grasps,
            format_turns(&plan.turns)
        );
    }
}

/// Returns the CPU time that the calling thread has used until now (s).
#[allow(unsafe_code, reason = "the standard library has no clock of a thread's CPU time")]
fn cpu() -> f64 {
    let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the clock exists on all Linux systems, and `now` is a local variable.
    unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &raw mut now) };
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}
