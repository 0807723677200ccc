//! Work over fixed chunks: chunk borders never depend on the thread count, so results merged in chunk order are
//! bit-identical on any machine. No algorithm lives here.

use rayon::prelude::*;
use std::ops::Range;

/// Number of elements in a chunk; a constant, independent of the number of threads.
pub const CHUNK: usize = 4096;

/// Runs `work` on every chunk of `0..count` in parallel and returns the results in chunk order.
pub fn map_chunks<R: Send>(count: usize, work: impl Fn(Range<usize>) -> R + Sync) -> Vec<R> {
    (0..count.div_ceil(CHUNK)).into_par_iter().map(|c| work(c * CHUNK..((c + 1) * CHUNK).min(count))).collect()
}

/// The three coordinates of point `i` of a flat `[N, 3]` slice.
pub fn point(points: &[f32], i: usize) -> [f32; 3] {
    [points[3 * i], points[3 * i + 1], points[3 * i + 2]]
}

/// Whether all three coordinates are finite.
pub fn finite(p: [f32; 3]) -> bool {
    p.iter().all(|v| v.is_finite())
}
