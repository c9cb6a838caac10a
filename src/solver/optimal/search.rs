//! Depth-first search to a given number of turns, many states at a time.
//!
//! - in: a state, a table, the number of turns
//! - out: turns that solve the state, or the certainty that so many do not
//! - source: R. Korf, IDA*; T. Rokicki, nxopt, for both ends of the solution, six bounds a state, and the shorter list
//!   of turns; the batches, and the pairs of opposite quarters, are ours
//!
//! A state has two ends: turns may be added to its solution's start (they turn the cube) or to its end (they turn the
//! inverse cube). Six bounds belong to it: cube and inverse, along three axes. A turn changes all three bounds of its
//! own end. At the other end, a half turn changes none, and opposite quarters have the same three. So
//! - where a bound of one end is as great as what is left, no half turn is tried at the other;
//! - the two quarters of a face are looked up, and rejected, together.
//!
//! A bound that is in no cache takes 200 to 300 ns to arrive (measured), but many can be under way. So a batch of states
//! is taken from the stack, and all of its continuations are looked up in rounds: all places first, then all reads.

#![allow(
    clippy::inline_always,
    reason = "vector instructions are usable only where all is compiled into one function for that processor"
)]

use super::lanes::Lanes;
use super::probe::{Bytes, Entry, Prober, bound};
use crate::cube::{Cube, Turn};

/// States taken from the stack at once.
const BATCH: usize = 48;
/// No face was turned yet.
const NO_FACE: u8 = 6;

/// A state on the way.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node {
    /// The cube and its inverse.
    ends: [Bytes; 2],
    /// Turns so far: 6 bits each, the last ones lowest: 2 * (number of the turn + 1) + the end.
    path: u128,
    /// Bounds: of the cube along three axes, of its inverse along three axes.
    pub(super) bounds: [u8; 6],
    /// Turns that are left.
    pub(super) left: u8,
    /// The face turned last, at each end.
    last: [u8; 2],
    /// Whose share this is.
    pub(super) task: u16,
}

impl Node {
    /// The face that the cube was last turned at; 6 for none.
    pub(super) fn last_face(&self) -> u8 {
        self.last[0]
    }
}

/// What the six bounds of a state say about the order of looking.
#[derive(Debug, Clone, Copy, Default)]
struct Plan {
    /// The end at which turns are tried.
    end: u8,
    /// Axes by falling bounds, for that end and the other one.
    axes: [[u8; 3]; 2],
    /// How many axes of the other end may reject.
    useful: u8,
}

/// One continuation, or both quarters of a face.
#[derive(Debug, Clone, Copy)]
struct Try {
    entry: Entry,
    node: u8,
    turn: u8,
    /// 0..3: the other end of both quarters; 3..6: this end; 6..: the rest of the other end.
    stage: u8,
    bounds: [u8; 6],
}

/// The states taken from the stack at once, each with its plan.
struct Batch {
    nodes: Vec<Node>,
    plans: [Plan; BATCH],
}

/// Whoever counts, and may end the search.
pub(super) trait Watch {
    /// So many more states were looked at for a task; false ends the search.
    fn goes_on(&mut self, shares: &[(u16, u32)]) -> bool;
}

/// Searches with one table.
#[derive(Debug)]
pub(super) struct Searcher<'a> {
    pub(super) prober: &'a Prober,
    pub(super) table: &'a [u8],
    pub(super) base: u8,
}

impl Searcher<'_> {
    /// The state of a cube.
    pub(super) fn root<L: Lanes>(&self, cube: &Cube) -> Node {
        let ends = [Bytes::new(cube), Bytes::new(&cube.inverse())];
        let mut node = Node { ends, path: 0, bounds: [0; 6], left: 0, last: [NO_FACE; 2], task: 0 };
        self.look::<L>(&mut node);
        node
    }

    /// The states after each turn of the cube that may follow.
    pub(super) fn children<L: Lanes>(&self, node: &Node) -> Vec<Node> {
        let turns = allowed(node.last[0]);
        let child = |turn| {
            let mut child = self.after::<L>(node, 0, turn);
            self.look::<L>(&mut child);
            child
        };
        (0..18).filter(|turn| turns >> turn & 1 == 1).map(child).collect()
    }

    fn look<L: Lanes>(&self, node: &mut Node) {
        for j in 0..6 {
            let entry = self.prober.entry::<L>(&node.ends[j / 3], j % 3);
            node.bounds[j] = bound(self.table, self.base, entry);
        }
    }

    #[inline(always)]
    fn after<L: Lanes>(&self, node: &Node, end: usize, turn: usize) -> Node {
        let mut next = *node;
        next.ends[end] = self.prober.turned::<L>(&node.ends[end], turn);
        next.ends[1 - end] = self.prober.begun::<L>(&node.ends[1 - end], inverse(turn));
        next.path = node.path << 6 | (turn as u128 + 1) << 1 | end as u128;
        next.last[end] = (turn / 3) as u8;
        next.left = node.left.wrapping_sub(1);
        next
    }

    /// Looks for a solution of just as many turns as are left, from each of the states on the stack.
    #[inline(always)]
    pub(super) fn search<L: Lanes>(
        &self,
        stack: &mut Vec<Node>,
        watch: &mut dyn Watch,
    ) -> Option<Vec<Turn>> {
        let solved = Bytes::new(&Cube::SOLVED);
        let allowed: [u32; 7] = std::array::from_fn(|face| allowed(face as u8));
        let mut batch = Batch { nodes: Vec::with_capacity(BATCH), plans: [Plan::default(); BATCH] };
        let (mut tries, mut kept): (Vec<Try>, Vec<Try>) = (Vec::new(), Vec::new());
        let mut shares = Vec::with_capacity(BATCH);
        while !stack.is_empty() {
            batch.nodes.clear();
            batch.nodes.extend_from_slice(&stack[stack.len().saturating_sub(BATCH)..]);
            stack.truncate(stack.len() - batch.nodes.len());
            shares.clear();
            tries.clear();
            for (n, node) in batch.nodes.iter().enumerate() {
                if node.left == 0 {
                    if node.ends[0] == solved {
                        return Some(solution(node.path));
                    }
                    continue;
                }
                let (plan, turns) = plan(node, &allowed);
                batch.plans[n] = plan;
                shares.push((node.task, turns.count_ones()));
                propose(n, node, plan, turns, &mut tries);
            }
            if !watch.goes_on(&shares) {
                return None;
            }
            while !tries.is_empty() {
                for t in &mut tries {
                    t.entry = self.locate::<L>(&batch, t);
                }
                // Apart from the loop above: mixed, a prefetch held up the stores, at twice the time.
                for t in &tries {
                    L::prefetch(self.table, t.entry.line as usize);
                }
                kept.clear();
                for t in &tries {
                    self.judge::<L>(&batch, *t, &mut kept, stack);
                }
                std::mem::swap(&mut tries, &mut kept);
            }
        }
        None
    }

    /// Returns where the next bound of a continuation stands.
    #[inline(always)]
    fn locate<L: Lanes>(&self, batch: &Batch, t: &Try) -> Entry {
        let (node, plan) = batch.of(t);
        let (other, axis) = plan.look(t.stage);
        let end = usize::from(plan.end) ^ usize::from(other);
        let cube = if other {
            self.prober.begun::<L>(&node.ends[end], inverse(usize::from(t.turn)))
        } else {
            self.prober.turned::<L>(&node.ends[end], usize::from(t.turn))
        };
        self.prober.entry::<L>(&cube, axis)
    }

    /// Reads the bound, and rejects the continuation, keeps it for another look, or puts it on the stack.
    #[inline(always)]
    fn judge<L: Lanes>(
        &self,
        batch: &Batch,
        mut t: Try,
        kept: &mut Vec<Try>,
        stack: &mut Vec<Node>,
    ) {
        let (node, plan) = batch.of(&t);
        let found = bound(self.table, self.base, t.entry);
        if found >= node.left {
            return;
        }
        let (other, axis) = plan.look(t.stage);
        t.bounds[(usize::from(plan.end) ^ usize::from(other)) * 3 + axis] = found;
        t.stage += 1;
        if t.stage == plan.useful {
            t.stage = 3;
            kept.push(t);
            t.turn += 2;
            kept.push(t);
        } else if t.stage < 6 || t.turn % 3 != 1 && t.stage < 9 - plan.useful {
            kept.push(t);
        } else {
            let mut next = self.after::<L>(node, usize::from(plan.end), usize::from(t.turn));
            next.bounds = t.bounds;
            stack.push(next);
        }
    }
}

impl Batch {
    /// Returns the state that a continuation belongs to, and its plan.
    #[inline(always)]
    fn of(&self, t: &Try) -> (&Node, Plan) {
        (&self.nodes[usize::from(t.node)], self.plans[usize::from(t.node)])
    }
}

impl Plan {
    /// Whether a stage looks at the other end, and along which axis.
    #[inline(always)]
    fn look(self, stage: u8) -> (bool, usize) {
        let (other, rank) = match stage {
            0..3 => (true, stage),
            3..6 => (false, stage - 3),
            _ => (true, self.useful + stage - 6),
        };
        (other, usize::from(self.axes[usize::from(other)][usize::from(rank)]))
    }
}

/// Which end to turn, in which order to look, and the turns.
#[inline(always)]
fn plan(node: &Node, allowed: &[u32; 7]) -> (Plan, u32) {
    const HALF_TURNS: u32 = 0o222_222;
    let of_end = |end: usize| [0, 1, 2].map(|axis| node.bounds[end * 3 + axis]);
    let turns = |end: usize| {
        let tight = of_end(1 - end).iter().any(|&b| b >= node.left);
        allowed[usize::from(node.last[end])] & if tight { !HALF_TURNS } else { u32::MAX }
    };
    let sum = |end: usize| of_end(end).iter().sum::<u8>();
    let (both, sums) = ([turns(0), turns(1)], [sum(0), sum(1)]);
    let counts = both.map(u32::count_ones);
    // With as many turns at either end, the one whose opposite promises more.
    let end = usize::from(counts[1] < counts[0] || counts[1] == counts[0] && sums[0] > sums[1]);
    let useful = of_end(1 - end).iter().filter(|&&b| b + 1 >= node.left).count() as u8;
    let axes = [falling(of_end(end)), falling(of_end(1 - end))];
    (Plan { end: end as u8, axes, useful }, both[end])
}

/// The axes by falling bounds.
#[inline(always)]
fn falling(bounds: [u8; 3]) -> [u8; 3] {
    let mut axes = [0, 1, 2];
    for (a, b) in [(0, 1), (1, 2), (0, 1)] {
        if bounds[usize::from(axes[a])] < bounds[usize::from(axes[b])] {
            axes.swap(a, b);
        }
    }
    axes
}

/// Makes the continuations of a state.
#[inline(always)]
fn propose(n: usize, node: &Node, plan: Plan, mut turns: u32, tries: &mut Vec<Try>) {
    while turns != 0 {
        let turn = turns.trailing_zeros() as u8;
        turns &= turns - 1;
        let single = turn % 3 == 1 || plan.useful == 0;
        if !single && turn % 3 == 2 {
            continue;
        }
        let stage = if single { 3 } else { 0 };
        let entry = Entry::default();
        tries.push(Try { entry, node: n as u8, turn, stage, bounds: node.bounds });
    }
}

/// The turns that may follow one of a face, as bits; of two opposite faces, the first of the six goes first.
fn allowed(last: u8) -> u32 {
    let follows = |face: &u8| last == NO_FACE || *face != last && face + 3 != last;
    (0..6).filter(follows).fold(0, |mask, face| mask | 0b111 << (3 * face))
}

fn inverse(turn: usize) -> usize {
    turn / 3 * 3 + 2 - turn % 3
}

/// The solution from the turns done at either end.
fn solution(mut path: u128) -> Vec<Turn> {
    let (mut starts, mut ends) = (Vec::new(), Vec::new());
    while path != 0 {
        let turn = Turn::from_index((path as usize >> 1 & 31) - 1);
        let (turns, turn) =
            if path & 1 == 0 { (&mut starts, turn) } else { (&mut ends, turn.inverse()) };
        turns.push(turn);
        path >>= 6;
    }
    starts.reverse();
    starts.extend(ends);
    starts
}
