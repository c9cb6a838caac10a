//! Many solutions of one cube, for whoever has to choose among them.

use super::search::{Budget, Take, each_solution, solve};
use super::tables::Tables;
use crate::cube::{Cube, Turn};
use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

/// Candidates that share a first phase: more of them would differ too little.
const SHARED_PHASE1: usize = 8;
/// Turns that a candidate may have more than the shortest.
const LONGER: u8 = 3;

/// Up to `count` distinct solutions, shortest first, none more than three turns longer than the shortest found;
/// solutions that differ in the order of opposite turns only count as one. A tenth of the budget seeks the shortest,
/// the rest gathers. A solved cube has one candidate: no turns.
#[must_use]
pub fn candidates(cube: &Cube, tables: &Tables, budget: &Budget, count: usize) -> Vec<Vec<Turn>> {
    let best = solve(cube, tables, &Budget { nodes: budget.nodes / 10, ..*budget });
    if best.turns.is_empty() {
        return vec![Vec::new()];
    }
    let bound = best.turns.len() as u8 + LONGER;
    let found = Mutex::new(BTreeSet::from([canonical(best.turns)]));
    each_solution(cube, tables, bound, budget.nodes - budget.nodes / 10, &|turns, siblings| {
        let mut found = found.lock().unwrap_or_else(PoisonError::into_inner);
        if found.len() < count {
            found.insert(canonical(turns));
        }
        match () {
            () if found.len() >= count => Take::Enough,
            () if siblings + 1 >= SHARED_PHASE1 => Take::NextPhase1,
            () => Take::More,
        }
    });
    let found = found.into_inner().unwrap_or_else(PoisonError::into_inner);
    let mut list: Vec<Vec<Turn>> = found.into_iter().collect();
    list.sort_by(|a, b| (a.len(), a).cmp(&(b.len(), b)));
    list
}

/// The same turns with each pair of opposite ones in the order of their faces.
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
    fn who_asks_for_one_gets_the_shortest() {
        let budget = Budget { nodes: 200_000, max_length: 20 };
        let all = candidates(&Cube::scrambled(5), &TABLES, &budget, 10);

        let one = candidates(&Cube::scrambled(5), &TABLES, &budget, 1);

        assert_eq!(one.len(), 1);
        assert_eq!(one[0].len(), all[0].len());
    }

    #[test]
    fn candidates_are_distinct_and_each_solves() {
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
