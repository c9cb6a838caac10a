//! Shortest solutions with proof: the two-phase search finds one, the optimal search proves that
//! none is shorter.
//!
//! - in: a cube, two-phase [`Tables`], an [`Optimal`], limits, a [`Watch`]
//! - out: turns, and a length below which no solution exists
//!
//! The optimal search works in rounds: round n finds a solution of n turns or proves that there is
//! none. Each round takes about thirteen times as long as the round before. If a shortest solution
//! has n turns, round n - 1 completes the proof and round n only has to find a solution. The
//! two-phase search finds one in much less time, but it cannot prove that it is shortest. Before
//! each round it therefore gets an eighth of the expected cost of the round; a solution of that
//! length makes the round superfluous.

use super::optimal::{self, Optimal};
use super::search::{Budget, Watch, solve_watched};
use super::tables::Tables;
use crate::cube::{Cube, Turn};
use std::sync::atomic::Ordering::Relaxed;

/// Result of both searches.
///
/// ```
/// use rubik_robot_solver::cube::parse_turns;
/// use rubik_robot_solver::shortest::Shortest;
///
/// // A solution of three turns, while only one of two turns is excluded, may not be shortest.
/// let mut found = Shortest { turns: Some(parse_turns("F' U' R'")?), at_least: 2, nodes: 0 };
/// assert!(!found.is_proven());
/// found.at_least = 3;
/// assert!(found.is_proven());
/// # Ok::<(), rubik_robot_solver::cube::ParseTurns>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shortest {
    /// Shortest solution found; `None` if it is longer than the limit.
    pub turns: Option<Vec<Turn>>,
    /// Proven lower bound on the length of all solutions (turns).
    pub at_least: u8,
    /// Number of states that both searches visited.
    pub nodes: u64,
}

impl Shortest {
    /// Returns whether the solution is proven to be a shortest one.
    #[must_use]
    pub fn is_proven(&self) -> bool {
        self.turns.as_ref().is_some_and(|turns| turns.len() <= usize::from(self.at_least))
    }
}

/// Number of nodes of the first two-phase search, which takes some milliseconds.
const FIRST_NODES: u64 = 50_000;
/// Length up to which the rounds take no appreciable time (turns).
const SHORT: u8 = 14;
/// Ratio of the states of a round to those of the round before.
const GROWTH: u64 = 13;
/// Ratio of the states of the next round to the nodes of the two-phase search before it.
const SHARE: u64 = 8;

/// Searches for a shortest solution and for the proof that none is shorter, by the two-phase and
/// the optimal search in turn. If `limits` or `watch` end the search before the proof, returns the
/// shortest solution found and the lower bound proven so far.
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
    // States of the last round, and nodes of the longest two-phase search. A repetition with fewer
    // nodes would find nothing new.
    let (mut round, mut had) = (0, FIRST_NODES);
    while found.at_least < best.len() as u8 && found.at_least <= limits.max_length {
        let share = round * GROWTH / SHARE;
        if share > had {
            let better = two_phase(Some(best.len() as u8 - 1), share);
            found.nodes += better.nodes;
            had = share;
            // The shorter solution may match the proven bound already: the loop ends then.
            if !better.turns.is_empty() {
                best = better.turns;
                continue;
            }
        }
        // One round at a time, but all short ones together, and none of the length that is known.
        let max_length = found.at_least.max(SHORT).min(best.len() as u8 - 1).min(limits.max_length);
        let left = limits.max_nodes.saturating_sub(found.nodes);
        let limits = optimal::Limits { max_length, max_nodes: left };
        let answer = optimal.solve(cube, limits, watch.workers, watch.stop);
        found.nodes += answer.nodes;
        let before = found.at_least;
        found.at_least = before.max(answer.at_least);
        if found.at_least > before.max(1) {
            (watch.excluded)(found.at_least - 1);
        }
        round = answer.nodes;
        if let Some(turns) = answer.turns {
            found.at_least = turns.len() as u8;
            best = turns;
            (watch.improved)(&best);
        // A round that raised no bound was cut short, so a further one would be as well.
        } else if found.at_least <= before || watch.stop.load(Relaxed) || left == 0 {
            break;
        }
    }
    let wanted = best.len() <= usize::from(limits.max_length);
    found.turns = Some(best).filter(|_| wanted);
    found
}
