//! Many distinct solutions of one cube, for a planner that chooses among them.

use super::search::{Budget, Continuation, each_solution, solve};
use super::tables::Tables;
use crate::cube::{Cube, Turn};
use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

/// Largest number of candidates that share a first phase: more of them differ too little.
const SHARED_PHASE1: usize = 8;
/// Number of turns that a candidate may have more than the shortest solution found.
const LONGER: u8 = 3;

/// Finds up to `count` distinct solutions and returns them with the shortest first.
///
/// None is more than three turns longer than the shortest solution found. Two solutions that differ
/// only in the order of turns of opposite faces count as one. The search for a short solution gets
/// a tenth of the budget, the search for further solutions gets nine tenths. A solved cube has one
/// candidate, which has no turns.
///
/// ```
/// use rubik_robot_solver::cube::Cube;
/// use rubik_robot_solver::{Budget, Tables, candidates};
///
/// let (cube, tables) = (Cube::scrambled(1), Tables::build());
/// let found = candidates(&cube, &tables, &Budget { nodes: 200_000, max_length: 0 }, 10);
/// assert!(found.len() > 1 && found.len() <= 10);
/// // The shortest comes first, and each of them solves the cube.
/// assert!(found.windows(2).all(|pair| pair[0].len() <= pair[1].len() && pair[0] != pair[1]));
/// assert!(found.iter().all(|turns| cube.apply_all(turns).is_solved()));
/// ```
#[must_use]
pub fn candidates(cube: &Cube, tables: &Tables, budget: &Budget, count: usize) -> Vec<Vec<Turn>> {
    let best = solve(cube, tables, &Budget { nodes: budget.nodes / 10, ..*budget });
    if best.turns.is_empty() {
        return vec![Vec::new()];
    }
    let bound = best.turns.len() as u8 + LONGER;
    // An ordered set: equal solutions count once, and the result does not depend on hashes.
    let found = Mutex::new(BTreeSet::from([canonical(best.turns)]));
    each_solution(cube, tables, bound, budget.nodes - budget.nodes / 10, &|turns, siblings| {
        let mut found = found.lock().unwrap_or_else(PoisonError::into_inner);
        if found.len() < count {
            found.insert(canonical(turns));
        }
        // Solutions with the same first phase begin with the same turns, so a few of them suffice;
        // another first phase gives the planner more choice.
        match () {
            () if found.len() >= count => Continuation::Enough,
            () if siblings + 1 >= SHARED_PHASE1 => Continuation::NextPhase1,
            () => Continuation::More,
        }
    });
    let found = found.into_inner().unwrap_or_else(PoisonError::into_inner);
    let mut list: Vec<Vec<Turn>> = found.into_iter().collect();
    list.sort_by(|a, b| (a.len(), a).cmp(&(b.len(), b)));
    list
}

/// Exchanges successive turns of opposite faces, which commute, where they are not in the order of
/// the faces. Solutions that differ only in this order become equal.
fn canonical(mut turns: Vec<Turn>) -> Vec<Turn> {
    for i in 1..turns.len() {
        if turns[i].face == turns[i - 1].face.opposite() && turns[i].face < turns[i - 1].face {
            turns.swap(i, i - 1);
        }
    }
    turns
}

#[cfg(test)]
mod tests {
    use super::super::tables::tests::TABLES;
    use super::*;

    #[test]
    fn single_candidate_matches_shortest_length_of_ten_candidates() {
        let budget = Budget { nodes: 200_000, max_length: 20 };
        let all = candidates(&Cube::scrambled(5), &TABLES, &budget, 10);

        let one = candidates(&Cube::scrambled(5), &TABLES, &budget, 1);

        assert_eq!(one.len(), 1);
        assert_eq!(one[0].len(), all[0].len());
    }

    #[test]
    fn candidates_are_distinct_and_solve_the_cube() {
        let cube = Cube::scrambled(5);

        let list = candidates(&cube, &TABLES, &Budget { nodes: 200_000, max_length: 20 }, 10);

        assert_eq!(list.len(), 10);
        assert!(list.is_sorted_by_key(Vec::len));
        for (i, turns) in list.iter().enumerate() {
            assert!(cube.apply_all(turns).is_solved());
            assert!(!list[..i].contains(turns));
            assert!(turns.len() <= list[0].len() + 3);
        }
    }
}
