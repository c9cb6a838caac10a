//! Shortest solutions, proven to be such: IDA* with one large table that is asked six times a state.
//!
//! - in: a [`Cube`], the bytes of a table of [`TABLES`], [`Limits`], [`Workers`], a flag that stops
//! - out: an [`Answer`]: turns, or a number of turns below which there are none
//! - source: R. Korf, "Finding optimal solutions to Rubik's cube using pattern databases" (1997); T. Rokicki, nxopt;
//!   S. Tronto, H48; A. Skalski, vcube. What differs is told in [`coset`] and [`search`].
//!
//! [`geometry`] knows the cube's symmetries, [`coset`] numbers what a table looks at, [`flips`] moves whole sets of
//! states, [`build`] fills tables with them, [`lanes`] are the processor's vectors, [`probe`] finds a cube's entry,
//! [`search`] walks.

mod build;
mod coset;
mod flips;
mod geometry;
mod lanes;
mod probe;
mod search;

use super::table::{Progress, TableSpec, Workers};
use crate::cube::{Cube, Turn};
use build::{count, fill, row_bytes};
use coset::{Cosets, Shape, Tetrads};
use lanes::{Lanes, Plain};
use probe::Prober;
use search::{Node, Searcher, Watch};
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// A table's design: what it looks at, and the distance up to which it does not tell states apart.
#[derive(Debug, Clone, Copy)]
struct Design {
    shape: Shape,
    base: u8,
    /// Cosets at each distance up to `base + 2`, as they were when the table was first made.
    distances: &'static [u64],
    /// Cosets with an entry of their own at the base and below, one further away, two, and more.
    counts: [u64; 4],
}

const SMALL: Design = Design {
    shape: Shape { tetrads: Tetrads::Named, full: false },
    base: 8,
    distances: &[
        1,
        6,
        71,
        816,
        9936,
        122_768,
        1_518_477,
        18_576_110,
        219_253_477,
        2_210_229_882,
        10_909_970_084,
    ],
    counts: [230_242_653, 2_167_386_670, 10_828_160_289, 6_022_216_088],
};
const STANDARD: Design = Design {
    shape: Shape { tetrads: Tetrads::Unnamed, full: true },
    base: 9,
    distances: &[
        1,
        5,
        60,
        702,
        8621,
        107_276,
        1_338_101,
        16_609_298,
        203_039_972,
        2_334_550_968,
        20_072_722_361,
        49_581_364_433,
    ],
    counts: [2_502_714_296, 19_862_003_756, 49_257_371_894, 5_369_932_854],
};
/// The tables that can be had, from the smallest; one is enough, and the largest that the memory holds is the best.
pub static TABLES: [TableSpec; 2] = [
    TableSpec {
        name: "optimal-small",
        version: 1,
        bytes: SMALL.bytes(),
        purpose: "shortest solutions on small machines",
        build: |workers, progress| SMALL.build(workers, progress),
        verify: |table, workers| SMALL.verify(table, workers),
    },
    TableSpec {
        name: "optimal",
        version: 1,
        bytes: STANDARD.bytes(),
        purpose: "shortest solutions",
        build: |workers, progress| STANDARD.build(workers, progress),
        verify: |table, workers| STANDARD.verify(table, workers),
    },
];

impl Design {
    const fn bytes(self) -> usize {
        self.shape.rows() * row_bytes(self.shape)
    }

    fn build(self, workers: &dyn Workers, progress: Progress<'_>) -> Vec<u8> {
        let filled = fill(&Cosets::new(self.shape), self.base, workers, progress);
        assert_eq!(filled.counts, self.distances, "cosets at each distance");
        filled.table
    }

    fn verify(self, table: &[u8], workers: &dyn Workers) -> Result<Vec<u64>, String> {
        if table.len() != self.bytes() {
            return Err(format!("{} bytes instead of {}", table.len(), self.bytes()));
        }
        let counts = count(&Cosets::new(self.shape), table, workers);
        if counts == self.counts {
            Ok(counts.to_vec())
        } else {
            Err(format!("{counts:?} entries at each distance instead of {:?}", self.counts))
        }
    }
}

/// A table is none of [`TABLES`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{bytes} bytes are the size of no table for shortest solutions")]
pub struct NoSuchTable {
    /// Its size.
    pub bytes: usize,
}

/// When to give up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Longer solutions are not looked for.
    pub max_length: u8,
    /// States to look at, give or take a batch for each worker.
    pub max_nodes: u64,
}

impl Limits {
    /// No cube needs more than 20 turns.
    pub const NONE: Self = Self { max_length: 20, max_nodes: u64::MAX };
}

/// What is known at the end.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Answer {
    /// A shortest solution; none for want of a short enough one, or because the search was stopped.
    pub turns: Option<Vec<Turn>>,
    /// No solution is shorter than this: proven.
    pub at_least: u8,
    /// States that were looked at.
    pub nodes: u64,
}

/// Turns at which the search is divided into tasks.
const TASK_DEPTH: u8 = 3;
/// Searches of fewer turns are not worth dividing.
const UNDIVIDED: u8 = 12;
/// Tasks that a worker takes at once.
const SHARE: usize = 16;

/// Finds shortest solutions with one table.
#[derive(Debug)]
pub struct Optimal<'a> {
    prober: Prober,
    table: &'a [u8],
    base: u8,
}

impl<'a> Optimal<'a> {
    /// Takes one of [`TABLES`]; which, is told by the size.
    ///
    /// # Errors
    /// Where there is none of that size.
    pub fn new(table: &'a [u8]) -> Result<Self, NoSuchTable> {
        let design = [SMALL, STANDARD].into_iter().find(|d| d.bytes() == table.len());
        design.map(|d| Self::with(d, table)).ok_or(NoSuchTable { bytes: table.len() })
    }

    fn with(design: Design, table: &'a [u8]) -> Self {
        Self { prober: Prober::new(&Cosets::new(design.shape)), table, base: design.base }
    }

    /// Finds a shortest solution. Its length is the same whatever the number of workers; with one worker, so are the
    /// turns.
    #[must_use]
    pub fn solve(
        &self,
        cube: &Cube,
        limits: Limits,
        workers: &dyn Workers,
        stop: &AtomicBool,
    ) -> Answer {
        let searcher = Searcher { prober: &self.prober, table: self.table, base: self.base };
        let root = searcher.root::<Plain>(cube);
        let mut tasks = Tasks { nodes: vec![root], order: vec![0] };
        let least = root.bounds.iter().copied().max().unwrap_or(0);
        let mut answer = Answer { turns: None, at_least: least, nodes: 0 };
        for length in least..=limits.max_length {
            if length >= UNDIVIDED && tasks.nodes.len() == 1 {
                tasks = Tasks::divide(&searcher, root);
            }
            let depth = if tasks.nodes.len() == 1 { 0 } else { TASK_DEPTH };
            let round = Round {
                tasks: &tasks,
                left: length - depth,
                taken: AtomicUsize::new(0),
                shares: tasks.nodes.iter().map(|_| AtomicU32::new(0)).collect(),
                nodes: AtomicU64::new(answer.nodes),
                max_nodes: limits.max_nodes,
                stop,
                ended: AtomicBool::new(false),
                found: Mutex::new(None),
            };
            workers.run(workers.count().max(1), &|_| work(&searcher, &round));
            answer.nodes = round.nodes.into_inner();
            answer.turns = round.found.into_inner().unwrap_or_else(PoisonError::into_inner);
            if round.ended.into_inner() {
                return answer;
            }
            answer.at_least = length + 1;
            let shares = round.shares.into_iter().map(AtomicU32::into_inner).collect();
            tasks.sort(shares);
        }
        answer
    }
}

/// Where a search is divided, and in which order its parts are searched.
struct Tasks {
    nodes: Vec<Node>,
    order: Vec<u16>,
}

impl Tasks {
    fn divide(searcher: &Searcher<'_>, root: Node) -> Self {
        let mut nodes = vec![root];
        for _ in 0..TASK_DEPTH {
            nodes = nodes.iter().flat_map(|node| searcher.children::<Plain>(node)).collect();
        }
        for (number, node) in nodes.iter_mut().enumerate() {
            node.task = number as u16;
        }
        let order = (0..nodes.len() as u16).collect();
        Self { nodes, order }
    }

    /// Where the last search found most to look at, the next is most likely to find a solution (S. Tronto: a gain of
    /// 40 %). After U, R and F more may follow than after D, L and B: there, more is less of a sign.
    fn sort(&mut self, shares: Vec<u32>) {
        let promise = |task: u16| {
            let weight = if self.nodes[usize::from(task)].last_face() < 3 { 9 } else { 11 };
            u64::from(shares[usize::from(task)]) * weight
        };
        self.order.sort_by_key(|&task| std::cmp::Reverse(promise(task)));
    }
}

/// One search to one number of turns, by all workers.
struct Round<'a> {
    tasks: &'a Tasks,
    /// Turns left at the start of a task.
    left: u8,
    /// How many tasks have been taken.
    taken: AtomicUsize,
    /// States looked at for each task.
    shares: Vec<AtomicU32>,
    nodes: AtomicU64,
    max_nodes: u64,
    stop: &'a AtomicBool,
    /// Solved, stopped, or at the end of the nodes.
    ended: AtomicBool,
    found: Mutex<Option<Vec<Turn>>>,
}

impl Watch for &Round<'_> {
    fn goes_on(&mut self, shares: &[(u16, u32)]) -> bool {
        let mut sum = 0;
        for &(task, nodes) in shares {
            self.shares[usize::from(task)].fetch_add(nodes, Ordering::Relaxed);
            sum += u64::from(nodes);
        }
        let nodes = self.nodes.fetch_add(sum, Ordering::Relaxed) + sum;
        if nodes >= self.max_nodes || self.stop.load(Ordering::Relaxed) {
            self.ended.store(true, Ordering::Relaxed);
        }
        !self.ended.load(Ordering::Relaxed)
    }
}

/// Takes tasks until there are none.
fn work(searcher: &Searcher<'_>, round: &Round<'_>) {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("bmi2") {
        #[allow(unsafe_code, reason = "the processor has what the function needs")]
        // SAFETY: checked the line before.
        return unsafe { work_with_avx2(searcher, round) };
    }
    work_with::<Plain>(searcher, round);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,popcnt")]
fn work_with_avx2(searcher: &Searcher<'_>, round: &Round<'_>) {
    work_with::<lanes::Vector>(searcher, round);
}

#[inline(always)]
fn work_with<L: Lanes>(searcher: &Searcher<'_>, round: &Round<'_>) {
    let mut stack = Vec::new();
    loop {
        let taken = round.taken.fetch_add(SHARE, Ordering::Relaxed);
        let Some(tasks @ [_, ..]) = round.tasks.order.get(taken..) else { return };
        stack.clear();
        for &task in tasks[..SHARE.min(tasks.len())].iter().rev() {
            let mut node = round.tasks.nodes[usize::from(task)];
            node.left = round.left;
            if node.bounds.iter().all(|&b| b <= node.left) {
                stack.push(node);
            }
        }
        let mut watch = round;
        if let Some(turns) = searcher.search::<L>(&mut stack, &mut watch) {
            *round.found.lock().unwrap_or_else(PoisonError::into_inner) = Some(turns);
            round.ended.store(true, Ordering::Relaxed);
        }
        if round.ended.load(Ordering::Relaxed) {
            return;
        }
    }
}
