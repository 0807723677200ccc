//! Depth of the cells inside a body: the exact Euclidean distance transform of what the body's solid cells enclose.

use crate::volume::grid::face_neighbours;

/// Returns the distance in cells, `[z, y, x]`, from the centre of each cell to that of the nearest cell outside; 0
/// outside. Outside are the cells that can be reached from the border of the grid across faces without entering a
/// `solid` cell `[z, y, x]`. Solid cells must not lie in the border itself.
pub(super) fn depths(solid: &[bool], dims: [usize; 3]) -> Vec<f32> {
    let mut square: Vec<f32> = outside(solid, dims).into_iter().map(|out| if out { 0.0 } else { FAR }).collect();
    let [x, y, z] = dims;
    let mut line = LowerEnvelope::default();
    for (count, start, length, step) in [
        (y * z, Box::new(move |n: usize| n * x) as Box<dyn Fn(usize) -> usize>, x, 1),
        (x * z, Box::new(move |n| n / x * x * y + n % x), y, x),
        (x * y, Box::new(|n| n), z, x * y),
    ] {
        for n in 0..count {
            line.transform(&mut square, start(n), length, step);
        }
    }
    square.iter().map(|v| v.sqrt()).collect()
}

/// A squared distance larger than any between cells; sums of two are exact enough.
const FAR: f32 = 1e12;

fn outside(solid: &[bool], [x, y, z]: [usize; 3]) -> Vec<bool> {
    let mut out = vec![false; solid.len()];
    let mut open: Vec<usize> = (0..solid.len())
        .filter(|&c| {
            let (i, j, k) = (c % x, c / x % y, c / (x * y));
            i == 0 || j == 0 || k == 0 || i + 1 == x || j + 1 == y || k + 1 == z
        })
        .collect();
    open.iter().for_each(|&c| out[c] = true);
    while let Some(c) = open.pop() {
        for n in face_neighbours(c, [x, y, z]) {
            if !out[n] && !solid[n] {
                out[n] = true;
                open.push(n);
            }
        }
    }
    out
}

/// The lower envelope of parabolas along a line of cells (Felzenszwalb and Huttenlocher, *Distance transforms of
/// sampled functions*, 2012); the buffers are reused for all lines.
#[derive(Default)]
struct LowerEnvelope {
    values: Vec<f64>,
    /// Positions of the vertices of the envelope's parabolas.
    vertices: Vec<usize>,
    /// Position from which each of these is the lowest.
    from: Vec<f64>,
}

impl LowerEnvelope {
    /// Replaces the squared distances along a line by the minimum over the line of squared distance plus squared step.
    fn transform(&mut self, square: &mut [f32], start: usize, length: usize, step: usize) {
        self.values.clear();
        self.values.extend((0..length).map(|q| f64::from(square[start + q * step])));
        self.vertices.clear();
        self.from.clear();
        for q in 0..length {
            let mut begin = f64::NEG_INFINITY;
            while let Some(&v) = self.vertices.last() {
                begin = self.crossing(v, q);
                if self.from.last().is_some_and(|from| begin > *from) {
                    break;
                }
                self.vertices.pop();
                self.from.pop();
                begin = f64::NEG_INFINITY;
            }
            self.vertices.push(q);
            self.from.push(begin);
        }
        let mut k = 0;
        for q in 0..length {
            while self.from.get(k + 1).is_some_and(|from| *from < q as f64) {
                k += 1;
            }
            let away = q as f64 - self.vertices[k] as f64;
            square[start + q * step] = (away * away + self.values[self.vertices[k]]) as f32;
        }
    }

    /// Returns where the parabola of `q` falls below that of `v`, for `v` before `q`.
    fn crossing(&self, v: usize, q: usize) -> f64 {
        let height = |i: usize| self.values[i] + (i * i) as f64;
        (height(q) - height(v)) / (2.0 * (q - v) as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, Rng};

    #[test]
    fn distances_match_brute_force_and_enclosed_cells_are_inside() {
        let dims = [9, 8, 7];
        let mut rng = Rng::new(1, 0, Purpose::Custom(0));
        let place = |c: usize| [c % 9, c / 9 % 8, c / 72];
        let inner = |c: usize| place(c).iter().zip(dims).all(|(p, d)| *p > 0 && p + 1 < d);
        for _ in 0..20 {
            let mut solid: Vec<bool> = (0..9 * 8 * 7).map(|c| inner(c) && rng.uniform() < 0.7).collect();
            // a closed box around one cell
            for (i, j, k) in (3..6).flat_map(|i| (3..6).flat_map(move |j| (2..5).map(move |k| (i, j, k)))) {
                solid[i + 9 * (j + 8 * k)] = [i, j, k] != [4, 4, 3];
            }
            let out = outside(&solid, dims);
            assert!(!out[4 + 9 * (4 + 8 * 3)], "it is enclosed");
            let found = depths(&solid, dims);
            for (c, depth) in found.iter().enumerate() {
                let to = |d: usize| (0..3).map(|a| place(c)[a].abs_diff(place(d)[a]).pow(2)).sum::<usize>();
                let want = (0..out.len()).filter(|&d| out[d]).map(to).min().unwrap();
                assert!((depth * depth - want as f32).abs() < 1e-3, "{c}: {depth}, {want}");
            }
        }
    }
}
