//! Principal components of rows of numbers.

/// Rounds of the orthogonal iteration; components not separated by then are nearly indistinguishable.
const ROUNDS: usize = 200;

/// Returns the mean of `rows` `[N, D]` and their `count` principal axes `[count][D]`: orthonormal, largest spread
/// first, the entry of largest magnitude of each positive. Where the rows span fewer than `count` dimensions, the last
/// axes are arbitrary.
///
/// Rows with non-finite entries are skipped.
///
/// # Panics
/// If `dims` is 0 or below `count`.
pub fn principal(rows: &[f32], dims: usize, count: usize) -> (Vec<f64>, Vec<Vec<f64>>) {
    assert!(dims > 0 && count <= dims, "principal: at most as many components as dimensions");
    let good = || rows.chunks_exact(dims).filter(|r| r.iter().all(|v| v.is_finite()));
    let n = good().count().max(1) as f64;
    let mut mean = vec![0.0; dims];
    good().for_each(|r| mean.iter_mut().zip(r).for_each(|(m, v)| *m += f64::from(*v) / n));
    let mut covariance = vec![vec![0.0; dims]; dims];
    for row in good() {
        let centred: Vec<f64> = row.iter().zip(&mean).map(|(v, m)| f64::from(*v) - m).collect();
        for (line, a) in covariance.iter_mut().zip(&centred) {
            line.iter_mut().zip(&centred).for_each(|(c, b)| *c += a * b / n);
        }
    }
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    // start axes unlikely to be orthogonal to any data
    let mut axes: Vec<Vec<f64>> = (0..count)
        .map(|k| {
            (0..dims).map(|d| 1.0 / ((d * (k + 2)) % 7 + k + d + 1) as f64 + f64::from(u8::from(d == k))).collect()
        })
        .collect();
    for _ in 0..ROUNDS {
        for k in 0..count {
            let mut next: Vec<f64> = covariance.iter().map(|line| dot(line, &axes[k])).collect();
            if dot(&next, &next) < 1e-280 {
                // no spread along this axis: keep any direction orthogonal to the others
                next.clone_from(&axes[k]);
            }
            for before in &axes[..k] {
                let along = dot(&next, before);
                next.iter_mut().zip(before).for_each(|(v, b)| *v -= along * b);
            }
            let size = dot(&next, &next).sqrt();
            if size > 1e-150 {
                axes[k] = next.iter().map(|v| v / size).collect();
            }
        }
    }
    for axis in &mut axes {
        let largest = axis.iter().copied().fold(0.0_f64, |a, b| if b.abs() > a.abs() { b } else { a });
        if largest < 0.0 {
            axis.iter_mut().for_each(|v| *v = -*v);
        }
    }
    (mean, axes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_axes_of_a_box_come_in_the_order_of_its_sides() {
        let mut rows = Vec::new();
        for [a, b, c] in
            [[1, 1, 1], [1, 1, -1], [1, -1, 1], [1, -1, -1], [-1, 1, 1], [-1, 1, -1], [-1, -1, 1], [-1, -1, -1]]
        {
            let [a, b, c] = [a as f32, b as f32, c as f32];
            // turned by 45 degrees in the first two dimensions
            rows.extend([3.0 + 4.0 * a + b, 4.0 * a - b, 0.3 * c, 7.0]);
        }
        rows.extend([f32::NAN, 0.0, 0.0, 0.0]);
        let (mean, axes) = principal(&rows, 4, 3);
        let near = |a: &[f64], b: [f64; 4]| a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-6);
        let h = 0.5_f64.sqrt();
        assert!(near(&mean, [3.0, 0.0, 0.0, 7.0]), "{mean:?}");
        assert!(near(&axes[0], [h, h, 0.0, 0.0]), "{axes:?}");
        assert!(near(&axes[1], [h, -h, 0.0, 0.0]) || near(&axes[1], [-h, h, 0.0, 0.0]), "{axes:?}");
        assert!(near(&axes[2], [0.0, 0.0, 1.0, 0.0]), "{axes:?}");
    }

    #[test]
    fn no_rows_and_equal_rows_give_unit_axes() {
        for rows in [vec![], vec![2.0; 8]] {
            let (_, axes) = principal(&rows, 4, 3);
            for axis in axes {
                assert!((axis.iter().map(|v| v * v).sum::<f64>() - 1.0).abs() < 1e-9);
            }
        }
    }
}
