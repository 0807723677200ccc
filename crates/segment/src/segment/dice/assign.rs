//! The assignment problem: one column for every row, with the largest sum of scores (Hungarian method with potentials).

/// Returns the column of each of `n` rows. `score` must be finite.
pub fn maximise(n: usize, score: impl Fn(usize, usize) -> f64) -> Vec<usize> {
    // Rows and columns count from 1; column 0 is a sentinel that holds the row being assigned.
    let mut row_price = vec![0.0; n + 1];
    let mut column_price = vec![0.0; n + 1];
    let mut row_of = vec![0usize; n + 1];
    for row in 1..=n {
        row_of[0] = row;
        let mut from = vec![0usize; n + 1];
        let mut slack = vec![f64::INFINITY; n + 1];
        let mut done = vec![false; n + 1];
        let mut column = 0;
        // Dijkstra over columns along tight edges, to the nearest free column.
        while row_of[column] != 0 {
            done[column] = true;
            let i = row_of[column];
            let (mut step, mut next) = (f64::INFINITY, 0);
            for j in (1..=n).filter(|&j| !done[j]) {
                let cost = -score(i - 1, j - 1) - row_price[i] - column_price[j];
                if cost < slack[j] {
                    slack[j] = cost;
                    from[j] = column;
                }
                if slack[j] < step {
                    step = slack[j];
                    next = j;
                }
            }
            for j in 0..=n {
                if done[j] {
                    row_price[row_of[j]] += step;
                    column_price[j] -= step;
                } else {
                    slack[j] -= step;
                }
            }
            column = next;
        }
        while column != 0 {
            row_of[column] = row_of[from[column]];
            column = from[column];
        }
    }
    let mut column_of = vec![0; n];
    for column in 1..=n {
        column_of[row_of[column] - 1] = column - 1;
    }
    column_of
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Returns the best sum by trying every assignment.
    fn brute(n: usize, row: usize, used: u32, scores: &[f64]) -> f64 {
        let free = (0..n).filter(|j| used & (1 << j) == 0);
        let best = free.map(|j| scores[row * n + j] + brute(n, row + 1, used | (1 << j), scores));
        if row == n { 0.0 } else { best.fold(f64::NEG_INFINITY, f64::max) }
    }

    proptest! {
        #[test]
        fn the_sum_is_the_largest(n in 0usize..6, scores in prop::collection::vec(0.0f64..1.0, 36)) {
            let columns = maximise(n, |i, j| scores[i * n + j]);
            let mut sorted = columns.clone();
            sorted.sort_unstable();
            prop_assert_eq!(sorted, (0..n).collect::<Vec<_>>());
            let sum: f64 = columns.iter().enumerate().map(|(i, j)| scores[i * n + j]).sum();
            prop_assert!((sum - brute(n, 0, 0, &scores)).abs() < 1e-9);
        }
    }
}
