//! The shortest solution, proven: two-phase finds it, the optimal search proves that nothing is shorter.
//!
//! - in: a cube, two-phase [`Tables`], an [`Optimal`], limits, a [`Watch`]
//! - out: turns, and a number of turns below which there are none
//!
//! The last of the optimal search's rounds, which looks for a solution of the shortest length, is thirteen times as
//! long as the one before, which proves that there is none shorter. Two-phase finds a shortest solution in much less
//! time, it only cannot tell; so before each round it is given an eighth of what the round is expected to cost, and
//! when it finds a solution of that length, the round is spared.

use super::optimal::{self, Optimal};
use super::search::{Budget, Watch, solve_watched};
use super::tables::Tables;
use crate::cube::{Cube, Turn};
use std::sync::atomic::Ordering::Relaxed;

/// What is known at the end.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shortest {
    /// The shortest solution found; none when there is none as short as is asked for, or the search was stopped.
    pub turns: Option<Vec<Turn>>,
    /// No solution is shorter than this: proven.
    pub at_least: u8,
    /// States that were looked at, by both.
    pub nodes: u64,
}

impl Shortest {
    /// Whether it is proven that the solution is a shortest one.
    #[must_use]
    pub fn is_proven(&self) -> bool {
        self.turns.as_ref().is_some_and(|turns| turns.len() <= usize::from(self.at_least))
    }
}

/// States that two-phase looks at before anything else: some milliseconds.
const FIRST_NODES: u64 = 50_000;
/// Up to this length the rounds take no time to speak of.
const SHORT: u8 = 14;
/// How much longer a round is than the one before.
const GROWTH: u64 = 13;
/// Two-phase gets this part of the next round's states.
const SHARE: u64 = 8;

/// Finds it, or what can be found within the limits.
#[must_use]
pub fn shortest(
    cube: &Cube,
    tables: &Tables,
    optimal: &Optimal<'_>,
    limits: optimal::Limits,
    watch: &Watch<'_>,
) -> Shortest {
    let two_phase = |longest: Option<u8>, nodes: u64| {
        let watch = Watch { longest, ..*watch };
        solve_watched(cube, tables, &Budget { nodes, max_length: 0 }, &watch)
    };
    let first = two_phase(None, FIRST_NODES);
    let mut best = first.turns;
    let mut found = Shortest { turns: None, at_least: 0, nodes: first.nodes };
    if first.proven {
        found.at_least = best.len() as u8;
    }
    // The last round's states, and how many two-phase has had.
    let (mut round, mut had) = (0, FIRST_NODES);
    while found.at_least < best.len() as u8 && found.at_least <= limits.max_length {
        let share = round * GROWTH / SHARE;
        if share > had {
            let better = two_phase(Some(best.len() as u8 - 1), share);
            found.nodes += better.nodes;
            had = share;
            if !better.turns.is_empty() {
                best = better.turns;
                continue;
            }
        }
        let max_length = found.at_least.max(SHORT).min(best.len() as u8 - 1).min(limits.max_length);
        let left = limits.max_nodes.saturating_sub(found.nodes);
        let limits = optimal::Limits { max_length, max_nodes: left };
        let answer = optimal.solve(cube, limits, watch.workers, watch.stop);
        found.nodes += answer.nodes;
        let before = found.at_least;
        found.at_least = before.max(answer.at_least);
        round = answer.nodes;
        if let Some(turns) = answer.turns {
            found.at_least = turns.len() as u8;
            best = turns;
            (watch.improved)(&best);
        } else if found.at_least <= before || watch.stop.load(Relaxed) || left == 0 {
            break;
        }
    }
    let wanted = best.len() <= usize::from(limits.max_length);
    found.turns = Some(best).filter(|_| wanted);
    found
}
