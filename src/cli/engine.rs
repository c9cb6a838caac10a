//! The solver's modes as the command line offers them: a cube in, an answer out.

use super::progress::{Bar, tell};
use crate::cube::{Axis, Cube, Face, Turn};
use crate::motion::Depth;
use crate::solver::table::{InTurn, TableSpec, Workers};
use crate::solver::tables::Bytes;
use crate::solver::{self, Budget, Tables, Watch};
use crate::tables::{Store, Threads};
use crate::tasks::cube::hold::{Grip, Hand, Hold};
use crate::tasks::cube::plan::{self, Everywhere, Rule, Terms};
use clap::ValueEnum;
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
const CANDIDATES: usize = 200;

/// What a search came to.
#[derive(Debug)]
pub(super) struct Answer {
    pub(super) turns: Vec<Turn>,
    pub(super) nodes: u64,
    pub(super) optimal: bool,
    pub(super) time: Duration,
}

/// A mode with its tables.
pub(super) struct Engine {
    mode: Mode,
    limits: Limits,
    /// For one cube.
    threads: usize,
    tables: Tables,
    pub(super) large: bool,
}

impl Engine {
    /// Gets the tables; says on stderr when that takes time.
    pub(super) fn new(mode: Mode, limits: Limits, threads: usize, store: &Store) -> Self {
        let workers = Threads::new(threads);
        let (tables, large) = two_phase_tables(store, workers);
        Self { mode, limits, threads, tables, large }
    }

    /// Whether several threads search for one cube; else they are better used for a cube each.
    pub(super) fn shares_cubes(&self) -> bool {
        self.limits.time.is_some() && self.mode == Mode::TwoPhase
    }

    /// Solves a cube; `None` when it has no solution as short as is asked for.
    pub(super) fn solve(&self, cube: &Cube) -> Result<Answer, String> {
        let begun = Instant::now();
        let found = match self.mode {
            Mode::First => solver::solve(cube, &self.tables, &Budget::FIRST),
            Mode::TwoPhase => self.two_phase(cube),
            Mode::Robot => self.for_arms(cube)?,
        };
        let solver::Solution { turns, nodes, proven } = found;
        let asked = self.limits.max_length.filter(|_| self.mode != Mode::Robot);
        if turns.is_empty() && !cube.is_solved() {
            let asked = asked.unwrap_or_default();
            return Err(format!("there is no solution of {asked} turns or fewer"));
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

    /// Where the planner says which solution is the best: the cube stands in the track arm's jaws, and both arms
    /// reach everything.
    fn for_arms(&self, cube: &Cube) -> Result<solver::Solution, String> {
        let nodes = self.limits.nodes.unwrap_or(USUAL_NODES);
        let budget = Budget { nodes, max_length: self.limits.max_length.unwrap_or(0) };
        let list = solver::candidates(cube, &self.tables, &budget, CANDIDATES);
        let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
        let start = (Hand::Track, Grip { hold, half_roll: false });
        let plan = plan::plan(&list, start, &Terms::of(Rule::Clearance), &Everywhere)
            .map_err(|e| e.to_string())?;
        Ok(solver::Solution { turns: plan.turns, nodes, proven: false })
    }
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
fn two_phase_tables(store: &Store, workers: Threads) -> (Tables, bool) {
    let open = |specs: [&'static TableSpec; 2]| -> Option<[Bytes; 2]> {
        Some([store.open(specs[0], &workers).ok()?, store.open(specs[1], &workers).ok()?])
    };
    if let Some(large) = open(Tables::LARGE) {
        return (Tables::with(large), true);
    }
    (Tables::with(Tables::DEFAULT.map(|spec| obtain(store, spec, workers))), false)
}

/// A table from the store, with a bar if it has to be built.
fn obtain(store: &Store, spec: &TableSpec, workers: Threads) -> Bytes {
    let bar = Bar::new(spec.name);
    let listener = |spec: &TableSpec, news: crate::tables::News<'_>| tell(spec, &news);
    store.obtain(spec, &workers, &listener, &|share| bar.show(share))
}
