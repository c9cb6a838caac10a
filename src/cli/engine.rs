//! The solver's modes as the command line offers them: a cube in, an answer out.

use super::output::complain;
use super::progress::{Bar, tell};
use crate::cube::{Cube, Turn};
use crate::solver::korf::{self, Korf};
use crate::solver::optimal::{self, Optimal};
use crate::solver::shortest::{Shortest, shortest};
use crate::solver::table::{InTurn, TableSpec, Workers};
use crate::solver::tables::Bytes;
use crate::solver::{self, Budget, Tables, Watch};
use crate::tables::{Observer, Store, Threads, Unusable};
use crate::tasks::cube::hold::{Grip, Hand};
use crate::tasks::cube::plan::{Effort, NoPlan, Plan, Planner, taken};
use crate::{run, scenario};
use clap::ValueEnum;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, Instant};

/// Ways to solve.
#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Mode {
    /// The first solution that two-phase finds
    First,
    /// The shortest solution that two-phase finds within the budget
    TwoPhase,
    /// A shortest solution by Korf's pattern databases, as in the paper: quick to 14 turns, slow
    /// from 17 on
    Korf,
    /// A shortest solution, proven
    Optimal,
    /// The solution that two arms carry out in the least time, of many that two-phase finds
    Robot,
}

/// What ends a search.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    pub(super) max_length: Option<u8>,
    pub(super) time: Option<Duration>,
    pub(super) nodes: Option<u64>,
}

/// Nodes where no limit is given: about 50 ms.
pub(super) const USUAL_NODES: u64 = 500_000;
/// Solutions among which `robot` chooses.
const CANDIDATES: usize = 1000;

/// What a search came to.
#[derive(Debug)]
pub(super) struct Answer {
    pub(super) turns: Vec<Turn>,
    pub(super) nodes: u64,
    pub(super) optimal: bool,
    pub(super) time: Duration,
}

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
pub(super) enum Unsolved {
    /// There is none so short.
    #[error("there is no solution of {0} turns or fewer: proven")]
    None(u8),
    /// None was found, for this reason.
    #[error("{0}")]
    NotFound(String),
}

/// A mode with its tables.
pub(super) struct Engine {
    mode: Mode,
    limits: Limits,
    /// For one cube.
    threads: usize,
    tables: Tables,
    exact: Option<Exact>,
    /// For `robot`.
    planner: Option<Planner>,
    /// What it works with, for people.
    pub(super) with: &'static str,
}

/// Who proves that nothing is shorter.
enum Exact {
    Korf(Korf<'static>),
    Optimal(Optimal<'static>),
}

impl Engine {
    /// Gets the tables; says on stderr when that takes time.
    pub(super) fn new(mode: Mode, limits: Limits, threads: usize, store: &Store) -> Self {
        let workers = Threads::new(threads);
        let (tables, large) = two_phase_tables(store, workers);
        let (exact, with) = match mode {
            Mode::Korf => (korf(store, workers), "Korf's tables"),
            Mode::Optimal => optimal_table(store, workers),
            _ => (None, if large { "the large tables" } else { "the default tables" }),
        };
        let planner = if mode == Mode::Robot { planner() } else { None };
        Self { mode, limits, threads, tables, exact, planner, with }
    }

    /// Whether all threads search for one cube; else they are better used for a cube each.
    pub(super) fn shares_cubes(&self) -> bool {
        match self.mode {
            Mode::TwoPhase => self.limits.time.is_some(),
            Mode::Korf | Mode::Optimal => true,
            Mode::First | Mode::Robot => false,
        }
    }

    /// Solves a cube, or says why there is no such solution.
    pub(super) fn solve(&self, cube: &Cube) -> Result<Answer, Unsolved> {
        let begun = Instant::now();
        let found = match self.mode {
            Mode::First if self.limits.max_length.is_none() => {
                solver::solve(cube, &self.tables, &Budget::FIRST)
            }
            Mode::First | Mode::TwoPhase => self.two_phase(cube),
            Mode::Korf | Mode::Optimal => self.shortest(cube)?,
            Mode::Robot => self.for_arms(cube)?,
        };
        let solver::Solution { turns, nodes, proven } = found;
        if turns.is_empty() && !cube.is_solved() {
            let asked = self.limits.max_length.unwrap_or_default();
            return Err(Unsolved::NotFound(format!(
                "two-phase found no solution of {asked} turns or fewer; `--mode optimal` proves whether there is one"
            )));
        }
        Ok(Answer { turns, nodes, optimal: proven, time: begun.elapsed() })
    }

    fn two_phase(&self, cube: &Cube) -> solver::Solution {
        let Limits { max_length, time, nodes } = self.limits;
        let usual = if time.is_none() && max_length.is_none() { USUAL_NODES } else { u64::MAX };
        let budget = Budget { nodes: nodes.unwrap_or(usual), max_length: max_length.unwrap_or(0) };
        let stop = AtomicBool::new(false);
        let threads = Threads::new(self.threads);
        let workers: &dyn Workers = if self.shares_cubes() { &threads } else { &InTurn };
        let watch = Watch {
            workers,
            stop: &stop,
            improved: &|_| (),
            // Without a budget, nothing longer is of use.
            longest: max_length.filter(|_| time.is_none() && nodes.is_none()),
        };
        within(time, &stop, || solver::solve_watched(cube, &self.tables, &budget, &watch))
    }

    fn shortest(&self, cube: &Cube) -> Result<solver::Solution, Unsolved> {
        let no_tables = || Unsolved::NotFound("the tables are not as they should be".to_owned());
        let exact = self.exact.as_ref().ok_or_else(no_tables)?;
        let stop = AtomicBool::new(false);
        let threads = Threads::new(self.threads);
        let watch = Watch { workers: &threads, stop: &stop, improved: &|_| (), longest: None };
        let limits = optimal::Limits {
            max_length: self.limits.max_length.unwrap_or(optimal::Limits::NONE.max_length),
            max_nodes: self.limits.nodes.unwrap_or(u64::MAX),
        };
        let found = within(self.limits.time, &stop, || match exact {
            Exact::Korf(korf) => {
                let optimal::Answer { turns, at_least, nodes } =
                    korf.solve(cube, limits, &threads, &stop);
                let at_least = turns.as_ref().map_or(at_least, |t| t.len() as u8);
                Shortest { turns, at_least, nodes }
            }
            Exact::Optimal(optimal) => shortest(cube, &self.tables, optimal, limits, &watch),
        });
        let proven = found.is_proven();
        match found.turns {
            Some(turns) => Ok(solver::Solution { turns, nodes: found.nodes, proven }),
            None if found.at_least > limits.max_length => Err(Unsolved::None(limits.max_length)),
            None => Err(Unsolved::NotFound(format!(
                "no solution of {} turns or fewer was found in the budget; at least {} are needed",
                limits.max_length, found.at_least
            ))),
        }
    }

    /// The solution of the plan of least time for the built-in cell, begun as the mission begins
    /// it.
    fn for_arms(&self, cube: &Cube) -> Result<solver::Solution, Unsolved> {
        if cube.is_solved() {
            return Ok(solver::Solution { turns: Vec::new(), nodes: 0, proven: true });
        }
        let said = |reason: NoPlan| Unsolved::NotFound(reason.to_string());
        let no_planner = || Unsolved::NotFound("there is no planner".to_owned());
        let planner = self.planner.as_ref().ok_or_else(no_planner)?;
        let nodes = self.limits.nodes.unwrap_or(USUAL_NODES);
        let effort = Effort { nodes, candidates: CANDIDATES };
        let (_, start) = planner.looks(taken()).map_err(said)?;
        let search = PlanSearch { planner, tables: &self.tables, effort, time: self.limits.time };
        let (plan, nodes) = search.best(cube, start).map_err(said)?;
        Ok(solver::Solution { turns: plan.turns, nodes, proven: false })
    }
}

/// Least effort of a budget in time.
const FIRST: Effort = Effort { nodes: 50_000, candidates: 25 };

/// A search for the plan of least time.
pub(super) struct PlanSearch<'a> {
    pub(super) planner: &'a Planner,
    pub(super) tables: &'a Tables,
    /// The effort of a search without a time.
    pub(super) effort: Effort,
    /// The time that a search may take, if one is given.
    pub(super) time: Option<Duration>,
}

impl PlanSearch<'_> {
    /// Returns the best plan, and the nodes of the last search: one with all the effort, or several
    /// that double a small effort until the time would be over.
    pub(super) fn best(&self, cube: &Cube, start: (Hand, Grip)) -> Result<(Plan, u64), NoPlan> {
        let begun = Instant::now();
        let mut effort = if self.time.is_some() { FIRST } else { self.effort };
        let mut plan = self.planner.best(cube, start, self.tables, effort)?;
        if let Some(time) = self.time {
            // The next search takes about twice as long as all before it.
            while begun.elapsed() * 3 <= time {
                effort = Effort { nodes: effort.nodes * 2, candidates: effort.candidates * 2 };
                let better = self.planner.best(cube, start, self.tables, effort)?;
                if better.cost < plan.cost {
                    plan = better;
                }
            }
        }
        Ok((plan, effort.nodes))
    }
}

/// The planner of the built-in cell.
fn planner() -> Option<Planner> {
    let scenario = scenario::read(Path::new("the built-in cell"), "", &[]).ok()?;
    run::planner(&scenario.controller).ok()
}

/// Does some work, and sets `stop` when this time is over before it is done.
fn within<T>(time: Option<Duration>, stop: &AtomicBool, work: impl FnOnce() -> T) -> T {
    let Some(time) = time else { return work() };
    let (done, over) = channel::<()>();
    std::thread::scope(|scope| {
        scope.spawn(move || {
            if over.recv_timeout(time) == Err(RecvTimeoutError::Timeout) {
                stop.store(true, Ordering::Relaxed);
            }
        });
        let result = work();
        drop(done);
        result
    })
}

/// The large tables where they are there, else the default ones.
pub(super) fn two_phase_tables(store: &Store, workers: Threads) -> (Tables, bool) {
    let open = |spec: &&TableSpec| sound(store, spec, workers);
    let large: Option<Vec<Bytes>> = Tables::LARGE.iter().map(open).collect();
    if let Some(large) = large {
        return (Tables::with(&large), true);
    }
    (default_tables(store, workers), false)
}

/// The default tables, built where they are not kept.
pub(super) fn default_tables(store: &Store, workers: Threads) -> Tables {
    Tables::with(&Tables::DEFAULT.map(|spec| obtain(store, spec, workers)))
}

/// A table that is there; what is wrong with it otherwise is said, unless it was never built.
fn sound(store: &Store, spec: &TableSpec, workers: Threads) -> Option<Bytes> {
    let opened = store.open(spec, &workers);
    if let Err(reason) = &opened
        && !matches!(reason, Unusable::Absent)
    {
        complain(&format!(
            "table {} is of no use ({reason}): going on without it; `rubik-robot tables build {}` makes it anew",
            spec.name, spec.name
        ));
    }
    opened.ok()
}

/// A table from the store, with a bar if it has to be built.
fn obtain(store: &Store, spec: &TableSpec, workers: Threads) -> Bytes {
    let bar = Bar::new(spec.name);
    let listener = |spec: &TableSpec, news: crate::tables::News<'_>| tell(spec, &news);
    let observer = Observer { listener: &listener, progress: &|share| bar.show(share) };
    store.obtain(spec, &workers, observer)
}

/// The best table for shortest solutions: the largest that is there, else one that is built and
/// leaves half of the memory free.
fn optimal_table(store: &Store, workers: Threads) -> (Option<Exact>, &'static str) {
    let [small, standard] = &optimal::TABLES;
    let there = |spec: &'static TableSpec| Some((spec, sound(store, spec, workers)?));
    let (spec, bytes) = there(standard).or_else(|| there(small)).unwrap_or_else(|| {
        let spec = if memory() / 2 > standard.bytes { standard } else { small };
        (spec, obtain(store, spec, workers))
    });
    let exact = Optimal::new(for_ever(bytes)).ok().map(Exact::Optimal);
    (exact, if spec.name == small.name { "the small table" } else { "the standard table" })
}

fn korf(store: &Store, workers: Threads) -> Option<Exact> {
    let tables = [0, 1, 2].map(|i| for_ever(obtain(store, &korf::TABLES[i], workers)));
    Korf::new(tables).ok().map(Exact::Korf)
}

/// Keeps a table until the process ends, which is when the engine does.
fn for_ever(bytes: Bytes) -> &'static [u8] {
    let bytes: &'static Bytes = Box::leak(Box::new(bytes));
    (**bytes).as_ref()
}

/// Memory that may be had (bytes); 0 where the system does not say.
fn memory() -> usize {
    let text = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = text.lines().find_map(|l| l.strip_prefix("MemAvailable:"));
    let kilobytes = line.and_then(|l| l.trim().trim_end_matches("kB").trim().parse::<usize>().ok());
    kilobytes.unwrap_or(0) * 1024
}
