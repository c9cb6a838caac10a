//! Modes of the solver on the command line.
//!
//! - in: a cube, a mode, limits of the search, tables from a store
//! - out: turns that solve the cube, with the number of states searched; or the reason why not
//!
//! | mode | search | shortest |
//! |---|---|---|
//! | first, two-phase | two phases (`solver`) | not proven |
//! | korf | pattern databases of the paper (`solver::korf`) | proven |
//! | optimal | one large table (`solver::optimal`) | proven |
//! | robot | the fastest plan of many two-phase solutions (`PlanSearch`) | no |

use super::catalogue;
use super::output::warn;
use super::progress::{Bar, Waiting, print_news};
use crate::cube::{Cube, Turn};
use crate::run;
use crate::solver::korf::{self, Korf};
use crate::solver::optimal::{self, Optimal};
use crate::solver::shortest::{Shortest, shortest};
use crate::solver::table::{InTurn, TableSpec, Workers};
use crate::solver::tables::Bytes;
use crate::solver::{self, Budget, Tables, Watch};
use crate::tables::{Observer, Store, Threads, Unusable};
use crate::tasks::cube::hold::{Grip, Hand};
use crate::tasks::cube::plan::{Effort, NoPlan, Plan, Planner, taken};
use clap::ValueEnum;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Mode of the solver.
#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Mode {
    /// First solution of the two-phase search
    First,
    /// Shortest solution of the two-phase search within the budget
    TwoPhase,
    /// Proven shortest solution by Korf's pattern databases: slow from 17 turns on
    Korf,
    /// Proven shortest solution by one large table
    Optimal,
    /// Solution that takes the two arms the least time, among many of the two-phase search
    Robot,
}

/// Limits of a search.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Largest number of turns.
    pub(super) max_length: Option<u8>,
    /// Longest time for a cube.
    pub(super) time: Option<Duration>,
    /// Largest number of states to search.
    pub(super) nodes: Option<u64>,
}

/// Number of states that a search without other limits examines, in about 50 ms.
pub(super) const USUAL_NODES: u64 = 500_000;
/// Number of solutions among which the mode `robot` chooses.
const CANDIDATES: usize = 1000;

/// Result of a search.
#[derive(Debug)]
pub(super) struct Answer {
    /// Turns that solve the cube.
    pub(super) turns: Vec<Turn>,
    /// Number of states searched.
    pub(super) nodes: u64,
    /// Whether no shorter solution exists, proven.
    pub(super) optimal: bool,
    /// Time of the search.
    pub(super) time: Duration,
}

/// Reason why there is no answer.
#[derive(Debug, thiserror::Error)]
pub(super) enum Unsolved {
    /// Proof that no solution has at most this number of turns.
    #[error("there is no solution of {0} turns or fewer (proven)")]
    None(u8),
    /// Reason why no solution was found, although one may exist.
    #[error("{0}")]
    NotFound(String),
}

/// Listener that gets what a search has found until now, in words.
pub(super) type Found<'a> = &'a (dyn Fn(&str) + Sync);

/// Returns words for a solution of this many turns.
fn solution_of(turns: usize) -> String {
    format!("a solution of {turns} turns is found")
}

/// Solver of one mode, with its limits and tables.
pub(super) struct Engine {
    mode: Mode,
    limits: Limits,
    /// Number of threads for one cube.
    threads: usize,
    /// Tables of the two-phase search.
    tables: Tables,
    /// Solver of the modes `korf` and `optimal`; `None` if its tables cannot be used.
    exact: Option<Exact>,
    /// Planner of the mode `robot`.
    planner: Option<Planner>,
    /// Name of the tables, for a text such as "searched with the large tables".
    pub(super) with: &'static str,
}

/// Solver that proves that no solution is shorter.
enum Exact {
    Korf(Korf<'static>),
    Optimal(Optimal<'static>),
}

impl Engine {
    /// Makes the engine of a mode, with the tables that the mode needs. Reports on stderr if a
    /// table must be built.
    pub(super) fn new(mode: Mode, limits: Limits, threads: usize, store: &Store) -> Self {
        let workers = Threads::new(threads);
        let (tables, large) = two_phase_tables(store, workers);
        // Only the exact modes need their large tables.
        let (exact, with) = match mode {
            Mode::Korf => (korf(store, workers), "Korf's tables"),
            Mode::Optimal => optimal_table(store, workers),
            _ => (None, if large { "the large tables" } else { "the default tables" }),
        };
        let planner = if mode == Mode::Robot { planner() } else { None };
        Self { mode, limits, threads, tables, exact, planner, with }
    }

    /// Returns whether all threads search for one cube. Otherwise each takes a cube of its own.
    pub(super) fn shares_cubes(&self) -> bool {
        match self.mode {
            Mode::TwoPhase => self.limits.time.is_some(),
            Mode::Korf | Mode::Optimal => true,
            Mode::First | Mode::Robot => false,
        }
    }

    /// Solves a cube. `found` gets what the search has found.
    ///
    /// # Errors
    /// Reason why there is no solution within the limits.
    pub(super) fn solve(&self, cube: &Cube, found: Found<'_>) -> Result<Answer, Unsolved> {
        let begun = Instant::now();
        let solution = match self.mode {
            // Without a maximum length the first solution needs no limits of the search.
            Mode::First if self.limits.max_length.is_none() => {
                solver::solve(cube, &self.tables, &Budget::FIRST)
            }
            Mode::First | Mode::TwoPhase => self.two_phase(cube, found),
            Mode::Korf | Mode::Optimal => self.shortest(cube, found)?,
            Mode::Robot => self.for_arms(cube)?,
        };
        let solver::Solution { turns, nodes, proven } = solution;
        // A search with a maximum length may end without a solution.
        if turns.is_empty() && !cube.is_solved() {
            let asked = self.limits.max_length.unwrap_or_default();
            return Err(Unsolved::NotFound(format!(
                "two-phase found no solution of {asked} turns or fewer: --mode optimal proves \
                 whether one exists"
            )));
        }
        Ok(Answer { turns, nodes, optimal: proven, time: begun.elapsed() })
    }

    /// Searches in two phases within the limits. The solution has no turns if none is found.
    fn two_phase(&self, cube: &Cube, found: Found<'_>) -> solver::Solution {
        let Limits { max_length, time, nodes } = self.limits;
        // A maximum length ends the search by itself, so it needs no limit of states.
        let usual = if time.is_none() && max_length.is_none() { USUAL_NODES } else { u64::MAX };
        let budget = Budget { nodes: nodes.unwrap_or(usual), max_length: max_length.unwrap_or(0) };
        let stop = AtomicBool::new(false);
        let threads = Threads::new(self.threads);
        let workers: &dyn Workers = if self.shares_cubes() { &threads } else { &InTurn };
        let watch = Watch {
            workers,
            stop: &stop,
            improved: &|turns| found(&solution_of(turns.len())),
            excluded: &|_| (),
            // With a budget a longer solution is better than none. Without one it is of no use.
            longest: max_length.filter(|_| time.is_none() && nodes.is_none()),
        };
        within(time, &stop, || solver::solve_watched(cube, &self.tables, &budget, &watch))
    }

    /// Searches for a solution that is proven to be a shortest one, within the limits.
    ///
    /// # Errors
    /// The proof that there is no solution within the maximum length, or the reason why none was
    /// found.
    fn shortest(&self, cube: &Cube, found: Found<'_>) -> Result<solver::Solution, Unsolved> {
        let no_tables = || {
            Unsolved::NotFound(
                "the tables of this mode cannot be used: `rubik-robot tables verify` says why"
                    .to_owned(),
            )
        };
        let exact = self.exact.as_ref().ok_or_else(no_tables)?;
        let stop = AtomicBool::new(false);
        let threads = Threads::new(self.threads);
        let watch = Watch {
            workers: &threads,
            stop: &stop,
            improved: &|turns| found(&solution_of(turns.len())),
            excluded: &|length| found(&format!("no solution has {length} turns or fewer")),
            longest: None,
        };
        let limits = optimal::Limits {
            max_length: self.limits.max_length.unwrap_or(optimal::Limits::NONE.max_length),
            max_nodes: self.limits.nodes.unwrap_or(u64::MAX),
        };
        let found = within(self.limits.time, &stop, || match exact {
            Exact::Korf(korf) => {
                let optimal::Answer { turns, at_least, nodes } =
                    korf.solve_watched(cube, limits, &watch);
                // Korf's search deepens turn by turn, so its first solution is a shortest one.
                let at_least = turns.as_ref().map_or(at_least, |t| t.len() as u8);
                Shortest { turns, at_least, nodes }
            }
            Exact::Optimal(optimal) => shortest(cube, &self.tables, optimal, limits, &watch),
        });
        let proven = found.is_proven();
        match found.turns {
            Some(turns) => Ok(solver::Solution { turns, nodes: found.nodes, proven }),
            // The search has excluded all lengths up to the maximum, which is a proof.
            None if found.at_least > limits.max_length => Err(Unsolved::None(limits.max_length)),
            None => Err(Unsolved::NotFound(format!(
                "no solution of {} turns or fewer was found within the budget; at least {} turns \
                 are needed",
                limits.max_length, found.at_least
            ))),
        }
    }

    /// Returns the solution whose plan takes the least time in the built-in cell. The plan begins
    /// with the grasp in which the cube is held after all its faces have been read.
    fn for_arms(&self, cube: &Cube) -> Result<solver::Solution, Unsolved> {
        if cube.is_solved() {
            return Ok(solver::Solution { turns: Vec::new(), nodes: 0, proven: true });
        }
        let unsolved = |reason: NoPlan| Unsolved::NotFound(reason.to_string());
        let no_planner = || Unsolved::NotFound("the built-in cell has no planner".to_owned());
        let planner = self.planner.as_ref().ok_or_else(no_planner)?;
        let nodes = self.limits.nodes.unwrap_or(USUAL_NODES);
        // The states are spent on candidates, from which the planner chooses by time.
        let effort = Effort { nodes, candidates: CANDIDATES };
        let (_, start) = planner.looks(taken()).map_err(unsolved)?;
        let search = PlanSearch { planner, tables: &self.tables, effort, time: self.limits.time };
        let (plan, nodes) = search.best(cube, start).map_err(unsolved)?;
        Ok(solver::Solution { turns: plan.turns, nodes, proven: false })
    }
}

/// First effort of a search with a time limit.
const FIRST: Effort = Effort { nodes: 50_000, candidates: 25 };

/// Search for the plan of the least time.
pub(super) struct PlanSearch<'a> {
    pub(super) planner: &'a Planner,
    pub(super) tables: &'a Tables,
    /// Effort of a search without a time limit.
    pub(super) effort: Effort,
    /// Time limit of the search.
    pub(super) time: Option<Duration>,
}

impl PlanSearch<'_> {
    /// Returns the best plan from the grasp `start`, and the limit of states of the last search.
    /// Without a time limit there is a single search with the whole effort. With a limit, each
    /// search has twice the effort of the one before, until the next would exceed the time.
    pub(super) fn best(&self, cube: &Cube, start: (Hand, Grip)) -> Result<(Plan, u64), NoPlan> {
        let begun = Instant::now();
        let mut effort = if self.time.is_some() { FIRST } else { self.effort };
        let mut plan = self.planner.best(cube, start, self.tables, effort)?;
        if let Some(time) = self.time {
            // The next search takes at most about twice the time of all before it.
            while begun.elapsed() * 3 <= time {
                effort = Effort { nodes: effort.nodes * 2, candidates: effort.candidates * 2 };
                let better = self.planner.best(cube, start, self.tables, effort)?;
                // A larger effort finds other candidates, which need not be better.
                if better.cost < plan.cost {
                    plan = better;
                }
            }
        }
        Ok((plan, effort.nodes))
    }
}

/// Returns the planner of the built-in cell; `None` if it cannot be made.
fn planner() -> Option<Planner> {
    let scenario = catalogue::read(Path::new("the built-in cell"), "", &[]).ok()?;
    run::planner(&scenario.controller).ok()
}

/// Calls `work`, and sets `stop` if `work` has not returned within `time`.
fn within<T>(time: Option<Duration>, stop: &AtomicBool, work: impl FnOnce() -> T) -> T {
    let Some(time) = time else { return work() };
    let (done, over) = channel::<()>();
    // Another thread watches the clock, so that the search need not read it.
    std::thread::scope(|scope| {
        scope.spawn(move || {
            if over.recv_timeout(time) == Err(RecvTimeoutError::Timeout) {
                stop.store(true, Ordering::Relaxed);
            }
        });
        // Dropping the sender ends the wait of the thread at once.
        let result = work();
        drop(done);
        result
    })
}

/// Opens the large tables of two-phase if they are built, otherwise the default ones. Returns
/// whether they are the large ones.
pub(super) fn two_phase_tables(store: &Store, workers: Threads) -> (Tables, bool) {
    let open = |spec: &&TableSpec| sound(store, spec, workers);
    // The large tables work only together.
    let large: Option<Vec<Bytes>> = Tables::LARGE.iter().map(open).collect();
    if let Some(large) = large {
        return (Tables::with(&large), true);
    }
    (default_tables(store, workers), false)
}

/// Opens the default tables, and builds those that are missing.
pub(super) fn default_tables(store: &Store, workers: Threads) -> Tables {
    Tables::with(&Tables::DEFAULT.map(|spec| obtain(store, spec, workers)))
}

/// Opens a table that is built. Returns `None` if it cannot be used, and reports the reason on
/// stderr, unless the table was never built.
fn sound(store: &Store, spec: &TableSpec, workers: Threads) -> Option<Bytes> {
    let opened = store.open(spec, &workers);
    if let Err(reason) = &opened
        && !matches!(reason, Unusable::Absent)
    {
        warn(&format!(
            "table {} cannot be used ({reason}): continuing without it; `rubik-robot tables build \
             {}` builds it again",
            spec.name, spec.name
        ));
    }
    opened.ok()
}

/// Obtains a table from the store. Shows a progress bar if it must be built.
fn obtain(store: &Store, spec: &TableSpec, workers: Threads) -> Bytes {
    // A large table takes seconds to be read. If it must be built, a bar replaces this line.
    let words = format!("reading the table {}", spec.name);
    let reading = Mutex::new(Some(Waiting::begin(&words)));
    let bar = Bar::new(spec.name);
    let listener = |spec: &TableSpec, news: crate::tables::News<'_>| {
        drop(reading.lock().unwrap_or_else(PoisonError::into_inner).take());
        print_news(spec, &news);
    };
    let observer = Observer { listener: &listener, progress: &|share| bar.show(share) };
    store.obtain(spec, &workers, observer)
}

/// Obtains the best table for shortest solutions: the largest that is built, otherwise the largest
/// that leaves half of the available memory free. Also returns its name for people.
fn optimal_table(store: &Store, workers: Threads) -> (Option<Exact>, &'static str) {
    let [small, standard] = &optimal::TABLES;
    let there = |spec: &'static TableSpec| Some((spec, sound(store, spec, workers)?));
    // A larger table has better bounds, so it is taken wherever it is built.
    let (spec, bytes) = there(standard).or_else(|| there(small)).unwrap_or_else(|| {
        let spec = if memory() / 2 > standard.bytes { standard } else { small };
        (spec, obtain(store, spec, workers))
    });
    let exact = Optimal::new(for_ever(bytes)).ok().map(Exact::Optimal);
    (exact, if spec.name == small.name { "the small table" } else { "the standard table" })
}

/// Obtains the tables of the mode `korf` and makes its solver; `None` if they cannot be used.
fn korf(store: &Store, workers: Threads) -> Option<Exact> {
    let tables = [0, 1, 2].map(|i| for_ever(obtain(store, &korf::TABLES[i], workers)));
    Korf::new(tables).ok().map(Exact::Korf)
}

/// Leaks a table, which then stays in memory until the process ends, as the engine does.
fn for_ever(bytes: Bytes) -> &'static [u8] {
    // The solver borrows its table for the life of the process, so a leak loses nothing.
    let bytes: &'static Bytes = Box::leak(Box::new(bytes));
    (**bytes).as_ref()
}

/// Returns the available memory (bytes); 0 if the system does not report it.
fn memory() -> usize {
    let text = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    // MemAvailable is the kernel's estimate, which includes caches that it can free.
    let line = text.lines().find_map(|l| l.strip_prefix("MemAvailable:"));
    let kilobytes = line.and_then(|l| l.trim().trim_end_matches("kB").trim().parse::<usize>().ok());
    kilobytes.unwrap_or(0) * 1024
}
