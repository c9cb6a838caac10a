//! The assignment problem: one column for each row at the least total cost.
//!
//! - in: a square matrix of costs
//! - out: the column of each row
//! - source: Kuhn (1955) in the O(n^3) form with potentials (Jonker and Volgenant 1987)

/// Assigns a different column to each row of an `n` x `n` matrix of costs, so that the sum of the
/// costs is least. Returns the column of each row. `cost` lists the matrix row by row.
///
/// # Panics
/// If `cost` does not have `n * n` entries.
#[must_use]
pub(crate) fn assign(cost: &[f64], n: usize) -> Vec<usize> {
    assert_eq!(cost.len(), n * n, "the matrix of costs must be square");
    // Rows and columns count from 1, with a virtual column 0, as in the textbook form. `u` and `v`
    // are the potentials of rows and columns; no reduced cost `cost - u - v` is ever negative.
    // `row_of` is the row of each column, or 0 if the column is free.
    let (mut u, mut v) = (vec![0.0; n + 1], vec![0.0; n + 1]);
    let mut row_of = vec![0usize; n + 1];
    let mut previous = vec![0usize; n + 1];
    for row in 1..=n {
        // Dijkstra's search for the shortest augmenting path from this row to a free column.
        row_of[0] = row;
        let mut column = 0;
        let mut least = vec![f64::INFINITY; n + 1];
        let mut used = vec![false; n + 1];
        loop {
            used[column] = true;
            let i = row_of[column];
            let (mut delta, mut next) = (f64::INFINITY, 0);
            for j in 1..=n {
                if used[j] {
                    continue;
                }
                let reduced = cost[(i - 1) * n + j - 1] - u[i] - v[j];
                if reduced < least[j] {
                    least[j] = reduced;
                    previous[j] = column;
                }
                if least[j] < delta {
                    delta = least[j];
                    next = j;
                }
            }
            // The potentials are changed so that the next column of the path has the reduced cost
            // zero.
            for j in 0..=n {
                if used[j] {
                    u[row_of[j]] += delta;
                    v[j] -= delta;
                } else {
                    least[j] -= delta;
                }
            }
            column = next;
            if row_of[column] == 0 {
                break;
            }
        }
        // From the free column back along the path, each column takes the row of the column before
        // it.
        while column != 0 {
            row_of[column] = row_of[previous[column]];
            column = previous[column];
        }
    }
    let mut answer = vec![0; n];
    for j in 1..=n {
        answer[row_of[j] - 1] = j - 1;
    }
    answer
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn assignment_has_cost_of_cheapest_permutation(
            cost in proptest::collection::vec(0.0..10.0f64, 16)
        ) {
            let total = |columns: &[usize]| -> f64 {
                columns.iter().enumerate().map(|(i, &j)| cost[4 * i + j]).sum()
            };
            let mut cheapest = f64::INFINITY;
            for code in 0..256usize {
                let columns = [code & 3, code >> 2 & 3, code >> 4 & 3, code >> 6];
                if (0..4).all(|c| columns.contains(&c)) {
                    cheapest = cheapest.min(total(&columns));
                }
            }

            let found = assign(&cost, 4);

            prop_assert!((total(&found) - cheapest).abs() < 1e-9);
        }
    }
}
