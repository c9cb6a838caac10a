//! Depth-first search to a given number of turns, for many states at a time.
//!
//! - in: a state, a table, the number of turns
//! - out: turns that solve the state, or the proof that no solution has exactly that number of
//!   turns
//! - source: R. Korf, IDA*; T. Rokicki, nxopt, for both ends of the solution, six bounds per state,
//!   and the choice of the end with fewer turns; the batches and the pairs of opposite quarter
//!   turns are new here
//!
//! The search builds a solution from both ends. A turn is added after the first turns of the
//! solution, which turns the cube, or before its last turns, which turns the inverse cube. Six
//! bounds belong to a state: of the cube and of the inverse, along three axes each. A turn changes
//! all three bounds of its own end. At the other end a half turn changes none of them, and both
//! quarter turns of a face lead to the same three. Therefore
//! - if a bound of one end is as great as the number of turns left, the search tries no half turn
//!   at the other end;
//! - it reads the bounds of the two quarter turns of a face once, and rejects both together.
//!
//! A bound that is in no cache takes 200 to 300 ns to arrive (measured), but many reads can be
//! under way at once. The search takes a batch of states from the stack and looks up all of their
//! continuations in passes: it computes the positions of all entries first and reads them
//! afterwards.

#![allow(
    clippy::inline_always,
    reason = "the search is compiled once with vector instructions, and only callees that are \
              inlined into it can use them"
)]

use super::lanes::Lanes;
use super::probe::{Bytes, Entry, Prober, bound};
use crate::cube::{Cube, Turn};

/// Number of states taken from the stack at once.
const BATCH: usize = 48;
/// Mark for no face turned yet.
const NO_FACE: u8 = 6;

/// A state of the search.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node {
    /// The cube and its inverse.
    ends: [Bytes; 2],
    /// Turns made, 6 bits each, the latest in the lowest bits: 2 * (number of the turn + 1) + end.
    path: u128,
    /// Bounds of the cube along three axes, then of its inverse along three axes (turns).
    pub(super) bounds: [u8; 6],
    /// Number of turns that are left.
    pub(super) left: u8,
    /// Face of the latest turn at each end.
    last: [u8; 2],
    /// Task that the state belongs to.
    pub(super) task: u16,
}

impl Node {
    /// Returns the index of the face that was turned last on the cube itself, not on its inverse; 6
    /// if no face was.
    pub(super) fn last_face(&self) -> u8 {
        self.last[0]
    }
}

/// Order of the look-ups for a state, from its six bounds.
#[derive(Debug, Clone, Copy, Default)]
struct Plan {
    /// End at which the search tries turns.
    end: u8,
    /// Axes by falling bounds, of that end and of the other one.
    axes: [[u8; 3]; 2],
    /// Number of axes of the other end whose bounds may reject a continuation.
    useful: u8,
}

/// One continuation of a state, or both quarter turns of a face.
#[derive(Debug, Clone, Copy)]
struct Try {
    /// Entry that the next look-up reads.
    entry: Entry,
    /// Index of the state in the batch.
    node: u8,
    /// Index of the turn.
    turn: u8,
    /// Next look-up. 0..3: the other end, for both quarter turns; 3..6: this end; from 6 on: the
    /// remaining axes of the other end.
    stage: u8,
    /// Bounds of the state before the turn, replaced one by one by those after it.
    bounds: [u8; 6],
}

/// States taken from the stack at once, each with its plan.
struct Batch {
    nodes: Vec<Node>,
    plans: [Plan; BATCH],
}

/// Observer that counts states and may end the search.
pub(super) trait Watch {
    /// Adds visited states to the counts of their tasks; `shares` are pairs of a task and a number
    /// of states. Returns false if the search is to end.
    fn add_shares(&mut self, shares: &[(u16, u32)]) -> bool;
}

/// Depth-first search with one table.
#[derive(Debug)]
pub(super) struct Searcher<'a> {
    pub(super) prober: &'a Prober,
    /// Bytes of the table, as [`super::build`] describes them.
    pub(super) table: &'a [u8],
    /// Distance up to which all cosets of the table have one code (turns).
    pub(super) base: u8,
}

impl Searcher<'_> {
    /// Returns the state from which the search for a cube starts, with its six lower bounds.
    pub(super) fn root<L: Lanes>(&self, cube: &Cube) -> Node {
        let ends = [Bytes::new(cube), Bytes::new(&cube.inverse())];
        let mut node = Node { ends, path: 0, bounds: [0; 6], left: 0, last: [NO_FACE; 2], task: 0 };
        self.look::<L>(&mut node);
        node
    }

    /// Returns the state after each turn of the cube that the search may make next, with its
    /// bounds.
    pub(super) fn children<L: Lanes>(&self, node: &Node) -> Vec<Node> {
        let turns = allowed(node.last[0]);
        let child = |turn| {
            let mut child = self.after::<L>(node, 0, turn);
            self.look::<L>(&mut child);
            child
        };
        (0..18).filter(|turn| turns >> turn & 1 == 1).map(child).collect()
    }

    /// Reads the six lower bounds of a state from the table: for the cube and for its inverse,
    /// along three axes each.
    fn look<L: Lanes>(&self, node: &mut Node) {
        for j in 0..6 {
            let entry = self.prober.entry::<L>(&node.ends[j / 3], j % 3);
            node.bounds[j] = bound(self.table, self.base, entry);
        }
    }

    /// Returns the state after a turn of the cube (`end` 0) or of its inverse (`end` 1). The bounds
    /// are still those of `node`.
    #[inline(always)]
    fn after<L: Lanes>(&self, node: &Node, end: usize, turn: usize) -> Node {
        let mut next = *node;
        // (C T)^-1 = T^-1 C^-1: a turn after the one is the inverse turn before the other.
        next.ends[end] = self.prober.turned::<L>(&node.ends[end], turn);
        next.ends[1 - end] = self.prober.preceded_by::<L>(&node.ends[1 - end], inverse(turn));
        next.path = node.path << 6 | (turn as u128 + 1) << 1 | end as u128;
        next.last[end] = (turn / 3) as u8;
        next.left = node.left.wrapping_sub(1);
        next
    }

    /// Searches for a solution that starts from one of the states on the stack and has exactly the
    /// number of turns that this state has left. Returns all its turns, or `None` if there is none
    /// or `watch` ends the search.
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
            // From the top of the stack: depth first, so the stack stays short.
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
            if !watch.add_shares(&shares) {
                return None;
            }
            while !tries.is_empty() {
                for t in &mut tries {
                    t.entry = self.locate::<L>(&batch, t);
                }
                // A loop of its own: prefetches between the stores of the loop above held these up
                // and doubled the time.
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

    /// Returns where the table has the bound that a continuation needs next.
    #[inline(always)]
    fn locate<L: Lanes>(&self, batch: &Batch, t: &Try) -> Entry {
        let (node, plan) = batch.of(t);
        let (other, axis) = plan.look(t.stage);
        let end = usize::from(plan.end) ^ usize::from(other);
        let cube = if other {
            self.prober.preceded_by::<L>(&node.ends[end], inverse(usize::from(t.turn)))
        } else {
            self.prober.turned::<L>(&node.ends[end], usize::from(t.turn))
        };
        self.prober.entry::<L>(&cube, axis)
    }

    /// Reads the bound that a continuation needs next. Then rejects the continuation, keeps it in
    /// `kept` for another look-up, or puts the state after it on the stack.
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
        // After the turn, `left - 1` turns remain.
        if found >= node.left {
            return;
        }
        let (other, axis) = plan.look(t.stage);
        t.bounds[(usize::from(plan.end) ^ usize::from(other)) * 3 + axis] = found;
        t.stage += 1;
        // The other end has rejected neither quarter turn: from here on each is alone.
        if t.stage == plan.useful {
            t.stage = 3;
            kept.push(t);
            t.turn += 2;
            kept.push(t);
        // A half turn keeps the bounds of the other end, so it is complete after stage 5. A quarter
        // turn still needs those axes of the other end that were not useful.
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
    /// Returns the state of the batch that a continuation starts from, and the plan of that state.
    #[inline(always)]
    fn of(&self, t: &Try) -> (&Node, Plan) {
        (&self.nodes[usize::from(t.node)], self.plans[usize::from(t.node)])
    }
}

impl Plan {
    /// Returns which bound the look-up `stage` of a continuation reads: whether it is at the end
    /// where no turn is made, and its axis.
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

/// Chooses for a state the end at which to try turns, the one with fewer turns to try, and the
/// order in which to look up bounds. Returns this plan and the turns to try, as bits. The turns
/// that may follow one of `face` are `allowed[face]`.
#[inline(always)]
fn plan(node: &Node, allowed: &[u32; 7]) -> (Plan, u32) {
    const HALF_TURNS: u32 = 0o222_222;
    let of_end = |end: usize| [0, 1, 2].map(|axis| node.bounds[end * 3 + axis]);
    let turns = |end: usize| {
        // A half turn at this end keeps the bounds of the other end. If one of these is `left`
        // already, the state after it cannot be solved in `left - 1` turns.
        let tight = of_end(1 - end).iter().any(|&b| b >= node.left);
        allowed[usize::from(node.last[end])] & if tight { !HALF_TURNS } else { u32::MAX }
    };
    let sum = |end: usize| of_end(end).iter().sum::<u8>();
    let (both, sums) = ([turns(0), turns(1)], [sum(0), sum(1)]);
    let counts = both.map(u32::count_ones);
    // On equal numbers of turns, the end whose opposite has the greater bounds: these reject both
    // quarter turns of a face together.
    let end = usize::from(counts[1] < counts[0] || counts[1] == counts[0] && sums[0] > sums[1]);
    // A turn changes a bound by at most 1, so smaller bounds cannot reach `left`.
    let useful = of_end(1 - end).iter().filter(|&&b| b + 1 >= node.left).count() as u8;
    let axes = [falling(of_end(end)), falling(of_end(1 - end))];
    (Plan { end: end as u8, axes, useful }, both[end])
}

/// Returns the three axes, 0, 1 and 2, in descending order of their bounds.
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

/// Adds to `tries` the continuations of `node`, the n-th state of the batch, by these turns (bits).
/// Both quarter turns of a face are one continuation as long as one look-up can reject both.
#[inline(always)]
fn propose(n: usize, node: &Node, plan: Plan, mut turns: u32, tries: &mut Vec<Try>) {
    while turns != 0 {
        let turn = turns.trailing_zeros() as u8;
        turns &= turns - 1;
        // Two quarter turns of a face are one try as long as the other end may reject them.
        let single = turn % 3 == 1 || plan.useful == 0;
        if !single && turn % 3 == 2 {
            continue;
        }
        let stage = if single { 3 } else { 0 };
        let entry = Entry::default();
        tries.push(Try { entry, node: n as u8, turn, stage, bounds: node.bounds });
    }
}

/// Returns the turns that may follow a turn of the face `last`, as bits. Turns of opposite faces
/// commute, so they are searched only in the order U D, R L, F B.
fn allowed(last: u8) -> u32 {
    let follows = |face: &u8| last == NO_FACE || *face != last && face + 3 != last;
    (0..6).filter(follows).fold(0, |mask, face| mask | 0b111 << (3 * face))
}

/// Returns the index of the turn that undoes the turn with this index.
fn inverse(turn: usize) -> usize {
    turn / 3 * 3 + 2 - turn % 3
}

/// Returns the turns of a solution in order, from a path in the format of [`Node`]: turns at both
/// ends, 6 bits each.
fn solution(mut path: u128) -> Vec<Turn> {
    // The latest turn is read first. Turns of the inverse cube are inverted; the latest of them is
    // the first one after the turns of the cube.
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
