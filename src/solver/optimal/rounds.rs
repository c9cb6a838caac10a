//! Rounds of the search, each to a given number of turns, shared out among workers.
//!
//! - in: a searcher, the state of a cube
//! - out: a solution, or the number of states visited without one
//! - source: S. Tronto, H48, and A. Skalski, vcube, for the order of the tasks

use super::lanes::{Lanes, Plain};
use super::search::{Node, Searcher, Watch};
use crate::cube::Turn;
use crate::table::Workers;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Number of turns after which the search is divided into tasks.
const TASK_DEPTH: u8 = 3;
/// Length from which on a search is divided into tasks (turns). A shorter one is not worth
/// dividing.
const UNDIVIDED: u8 = 12;
/// Number of tasks that a worker takes at once.
const SHARE: usize = 16;

/// Tasks of a search and their order.
pub(super) struct Tasks<'a> {
    searcher: &'a Searcher<'a>,
    /// State at the start of each task.
    nodes: Vec<Node>,
    /// Tasks in the order in which workers take them.
    order: Vec<u16>,
    /// Number of turns made before each task.
    depth: u8,
}

/// Conditions that end a search early.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ends<'a> {
    /// Number of states after which the search ends.
    pub(super) max_nodes: u64,
    /// Flag by which the caller ends the search.
    pub(super) stop: &'a AtomicBool,
}

impl<'a> Tasks<'a> {
    /// Makes a list of tasks with one task, the whole search from `root`.
    pub(super) fn new(searcher: &'a Searcher<'a>, root: Node) -> Self {
        Self { searcher, nodes: vec![root], order: vec![0], depth: 0 }
    }

    /// Searches all tasks for solutions of exactly `length` turns, and adds the number of visited
    /// states to `nodes`. Breaks with a solution, or with `None` if `ends` ended the search early.
    pub(super) fn search(
        &mut self,
        length: u8,
        workers: &dyn Workers,
        ends: Ends<'_>,
        nodes: &mut u64,
    ) -> ControlFlow<Option<Vec<Turn>>> {
        if length >= UNDIVIDED && self.depth == 0 {
            *self = Self::divide(self.searcher, self.nodes[0]);
        }
        let round = Round {
            tasks: self,
            left: length - self.depth,
            taken: AtomicUsize::new(0),
            shares: self.nodes.iter().map(|_| AtomicU32::new(0)).collect(),
            nodes: AtomicU64::new(*nodes),
            ends,
            ended: AtomicBool::new(false),
            found: Mutex::new(None),
        };
        workers.run(workers.count().max(1), &|_| work(self.searcher, &round));
        let Round { shares, nodes: counted, ended, found, .. } = round;
        *nodes = counted.into_inner();
        if ended.into_inner() {
            let found = found.into_inner().unwrap_or_else(PoisonError::into_inner);
            return ControlFlow::Break(found);
        }
        let shares: Vec<u32> = shares.into_iter().map(AtomicU32::into_inner).collect();
        self.sort(&shares);
        ControlFlow::Continue(())
    }

    /// Divides the search from `root` into tasks: one for each sequence of [`TASK_DEPTH`] first
    /// turns.
    fn divide(searcher: &'a Searcher<'a>, root: Node) -> Self {
        let mut nodes = vec![root];
        for _ in 0..TASK_DEPTH {
            nodes = nodes.iter().flat_map(|node| searcher.children::<Plain>(node)).collect();
        }
        for (number, node) in nodes.iter_mut().enumerate() {
            node.task = number as u16;
        }
        let order = (0..nodes.len() as u16).collect();
        Self { searcher, nodes, order, depth: TASK_DEPTH }
    }

    /// Sorts the tasks for the next round by `shares`, the number of states that the last round
    /// visited in each task, the greatest first. A solution is most likely there; S. Tronto reports
    /// a gain of 40 %.
    fn sort(&mut self, shares: &[u32]) {
        // More turns may follow U, R and F (15) than D, L and B (12), so tasks that end with U, R
        // or F have more states anyway: the weights correct that.
        let promise = |task: u16| {
            let weight = if self.nodes[usize::from(task)].last_face() < 3 { 9 } else { 11 };
            u64::from(shares[usize::from(task)]) * weight
        };
        self.order.sort_by_key(|&task| std::cmp::Reverse(promise(task)));
    }
}

/// One search to a given number of turns, by all workers.
struct Round<'a> {
    tasks: &'a Tasks<'a>,
    /// Number of turns left at the start of a task.
    left: u8,
    /// Number of tasks that workers have taken.
    taken: AtomicUsize,
    /// Number of states visited for each task.
    shares: Vec<AtomicU32>,
    nodes: AtomicU64,
    ends: Ends<'a>,
    /// Whether the round is over: solved, stopped, or out of nodes.
    ended: AtomicBool,
    found: Mutex<Option<Vec<Turn>>>,
}

impl Watch for &Round<'_> {
    /// Adds the shares to the counts of the round, and ends the round if it is out of nodes or the
    /// caller wants to stop.
    fn add_shares(&mut self, shares: &[(u16, u32)]) -> bool {
        let mut sum = 0;
        for &(task, nodes) in shares {
            self.shares[usize::from(task)].fetch_add(nodes, Ordering::Relaxed);
            sum += u64::from(nodes);
        }
        let nodes = self.nodes.fetch_add(sum, Ordering::Relaxed) + sum;
        if nodes >= self.ends.max_nodes || self.ends.stop.load(Ordering::Relaxed) {
            self.ended.store(true, Ordering::Relaxed);
        }
        !self.ended.load(Ordering::Relaxed)
    }
}

/// Searches the tasks of a round, as one of several workers, until none is left or the round has
/// ended.
fn work(searcher: &Searcher<'_>, round: &Round<'_>) {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("bmi2") {
        #[allow(
            unsafe_code,
            reason = "vector instructions are unsafe; the condition above checks for them"
        )]
        // SAFETY: the condition above checks AVX2 and BMI2; all processors with these also have
        // BMI1 and POPCNT.
        return unsafe { work_with_avx2(searcher, round) };
    }
    work_with::<Plain>(searcher, round);
}

/// Runs [`work_with`], compiled for processors with AVX2 and BMI2.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,popcnt")]
fn work_with_avx2(searcher: &Searcher<'_>, round: &Round<'_>) {
    work_with::<super::lanes::Vector>(searcher, round);
}

/// Does the work of [`work`] with one kind of [`Lanes`].
#[allow(
    clippy::inline_always,
    reason = "only callees that are inlined into `work_with_avx2` can use vector instructions"
)]
#[inline(always)]
fn work_with<L: Lanes>(searcher: &Searcher<'_>, round: &Round<'_>) {
    let mut stack = Vec::new();
    loop {
        let taken = round.taken.fetch_add(SHARE, Ordering::Relaxed);
        let Some(tasks @ [_, ..]) = round.tasks.order.get(taken..) else { return };
        stack.clear();
        // Reversed, because the search takes from the top of the stack, and the first task is the
        // most likely to have a solution.
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
