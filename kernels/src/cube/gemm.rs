//! Matrix products of row-major f32 matrices, as the decoder needs them: very many rows, few columns.
//!
//! burn's own product chooses among kernels by autotuning, which is off, and has none that splits a long inner
//! dimension; the two kernels here use plain tiles in shared memory, 64 x 64 per cube and 4 x 4 per unit, and compute
//! in plain f32 on every device.

use super::{Words, arg, cubes};
use crate::cube::prelude::*;

/// Rows and columns of a cube's tile.
const TILE: u32 = 64;
/// Inner elements staged together.
const DEPTH: u32 = 16;
/// Rows of the long inner dimension that one cube of [`transposed`] processes.
const ROWS: u32 = 1024;

/// Operation applied to each element of a product before it is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Epilogue {
    /// Adds the bias.
    Bias,
    /// Adds the bias and clamps negative values to 0.
    BiasRelu,
    /// Keeps values where the other matrix is positive and zeroes the rest: the backward pass of a clamp.
    Mask,
    /// Stores the value unchanged.
    Plain,
}

/// Computes `finish(a B)` `[m, n]` with `a` `[m, k]` and `b` `[k, n]`, or `[n, k]` if its flag marks it as transposed.
/// `other` is the bias `[n]`, the mask `[m, n]`, or ignored.
pub(crate) fn product(
    client: &Client,
    a: &Words,
    b: (&Words, bool),
    other: &Words,
    out: &Words,
    [m, k, n]: [usize; 3],
    finish: Epilogue,
) {
    let across = n.div_ceil(TILE as usize);
    multiply::launch(
        client,
        cubes(m.div_ceil(TILE as usize) * across, 1),
        CubeDim::new_1d(256),
        a.arg(),
        b.0.arg(),
        other.arg(),
        out.arg(),
        m as u32,
        k as u32,
        n as u32,
        across as u32,
        b.1,
        finish,
    );
}

/// Computes `a^T B` `[m, n]` with `a` `[rows, m]` and `b` `[rows, n]` into `out`: products over pieces of the rows,
/// then their sum in order.
pub(crate) fn transposed(client: &Client, a: &Words, b: &Words, out: &CubeTensor, [rows, m, n]: [usize; 3]) {
    let pieces = rows.div_ceil(ROWS as usize).max(1);
    let (down, across) = (m.div_ceil(TILE as usize), n.div_ceil(TILE as usize));
    let parts = Words::empty(client, pieces * m * n);
    multiply_transposed::launch(
        client,
        cubes(pieces * down * across, 1),
        CubeDim::new_1d(256),
        a.arg(),
        b.arg(),
        parts.arg(),
        rows as u32,
        m as u32,
        n as u32,
        down as u32,
        across as u32,
        pieces as u32,
    );
    let dim = CubeDim::new_1d(256);
    sum_pieces::launch(client, cubes(m * n, 256), dim, parts.arg(), arg(out), (m * n) as u32, pieces as u32);
}

/// Writes the column sums of `a` `[rows, n]` to `out` `[n]`.
pub(crate) fn column_sums(client: &Client, a: &Words, out: &CubeTensor, [rows, n]: [usize; 2]) {
    let pieces = rows.div_ceil(ROWS as usize).max(1);
    let parts = Words::empty(client, pieces * n);
    let dim = CubeDim::new_1d(256);
    sum_rows::launch(client, cubes(pieces * n, 256), dim, a.arg(), parts.arg(), rows as u32, n as u32, pieces as u32);
    sum_pieces::launch(client, cubes(n, 256), dim, parts.arg(), arg(out), n as u32, pieces as u32);
}

#[cube(launch)]
fn multiply(
    a: &[f32],
    b: &[f32],
    other: &[f32],
    out: &mut [f32],
    m: u32,
    k: u32,
    n: u32,
    across: u32,
    #[comptime] b_transposed: bool,
    #[comptime] finish: Epilogue,
) {
    // [DEPTH, 64] each; a is staged transposed, so that a unit's four rows are adjacent
    let mut sa = Shared::<[f32]>::new_slice(1024usize);
    let mut sb = Shared::<[f32]>::new_slice(1024usize);
    let row0 = (CUBE_POS as u32 / across) * comptime!(TILE);
    let column0 = (CUBE_POS as u32 % across) * comptime!(TILE);
    let (ty, tx) = (UNIT_POS / 16u32 * 4u32, UNIT_POS % 16u32 * 4u32);
    let mut sum = Array::<f32>::new(16usize);
    #[unroll]
    for i in 0..16usize {
        sum[i] = 0.0f32;
    }
    let mut base = 0u32;
    while base < k {
        #[unroll]
        for j in 0..4u32 {
            let e = UNIT_POS + j * 256u32;
            // sixteen inner elements of a row are adjacent
            let (row, inner) = (e / 16u32, e % 16u32);
            let mut value = 0.0f32;
            if row0 + row < m && base + inner < k {
                value = a[((row0 + row) * k + base + inner) as usize];
            }
            sa[(inner * 64u32 + row) as usize] = value;
            let mut other_value = 0.0f32;
            if comptime!(b_transposed) {
                if column0 + row < n && base + inner < k {
                    other_value = b[((column0 + row) * k + base + inner) as usize];
                }
                sb[(inner * 64u32 + row) as usize] = other_value;
            } else {
                let (depth, column) = (e / 64u32, e % 64u32);
                if column0 + column < n && base + depth < k {
                    other_value = b[((base + depth) * n + column0 + column) as usize];
                }
                sb[(depth * 64u32 + column) as usize] = other_value;
            }
        }
        sync_cube();
        for inner in 0..comptime!(DEPTH) {
            let (from_a, from_b) = ((inner * 64u32 + ty) as usize, (inner * 64u32 + tx) as usize);
            #[unroll]
            for i in 0..4usize {
                let left = sa[from_a + i];
                #[unroll]
                for j in 0..4usize {
                    sum[i * 4 + j] += left * sb[from_b + j];
                }
            }
        }
        sync_cube();
        base += comptime!(DEPTH);
    }
    #[unroll]
    for i in 0..4u32 {
        #[unroll]
        for j in 0..4u32 {
            let (row, column) = (row0 + ty + i, column0 + tx + j);
            if row < m && column < n {
                let at = (row * n + column) as usize;
                let value = sum[(i * 4 + j) as usize];
                if comptime!(finish == Epilogue::Bias) {
                    out[at] = value + other[column as usize];
                } else if comptime!(finish == Epilogue::BiasRelu) {
                    let sum = value + other[column as usize];
                    // keeps NaN, as on a CPU
                    out[at] = select(sum <= 0.0f32, 0.0f32, sum);
                } else if comptime!(finish == Epilogue::Mask) {
                    out[at] = select(other[at] > 0.0f32, value, 0.0f32);
                } else {
                    out[at] = value;
                }
            }
        }
    }
}

#[cube(launch)]
fn multiply_transposed(
    a: &[f32],
    b: &[f32],
    parts: &mut [f32],
    rows: u32,
    m: u32,
    n: u32,
    down: u32,
    across: u32,
    pieces: u32,
) {
    let mut sa = Shared::<[f32]>::new_slice(1024usize);
    let mut sb = Shared::<[f32]>::new_slice(1024usize);
    let tiles = down * across;
    let piece = CUBE_POS as u32 / tiles;
    let tile = CUBE_POS as u32 % tiles;
    let (m0, n0) = (tile / across * comptime!(TILE), tile % across * comptime!(TILE));
    let (ty, tx) = (UNIT_POS / 16u32 * 4u32, UNIT_POS % 16u32 * 4u32);
    let mut sum = Array::<f32>::new(16usize);
    #[unroll]
    for i in 0..16usize {
        sum[i] = 0.0f32;
    }
    let mut base = min(piece * comptime!(ROWS), rows);
    let end = min(base + comptime!(ROWS), rows);
    while base < end {
        #[unroll]
        for j in 0..4u32 {
            let e = UNIT_POS + j * 256u32;
            let (depth, column) = (e / 64u32, e % 64u32);
            let row = base + depth;
            let mut left = 0.0f32;
            let mut right = 0.0f32;
            if row < end {
                if m0 + column < m {
                    left = a[(row * m + m0 + column) as usize];
                }
                if n0 + column < n {
                    right = b[(row * n + n0 + column) as usize];
                }
            }
            sa[e as usize] = left;
            sb[e as usize] = right;
        }
        sync_cube();
        for depth in 0..comptime!(DEPTH) {
            let (from_a, from_b) = ((depth * 64u32 + ty) as usize, (depth * 64u32 + tx) as usize);
            #[unroll]
            for i in 0..4usize {
                let left = sa[from_a + i];
                #[unroll]
                for j in 0..4usize {
                    sum[i * 4 + j] += left * sb[from_b + j];
                }
            }
        }
        sync_cube();
        base += comptime!(DEPTH);
    }
    if piece < pieces {
        #[unroll]
        for i in 0..4u32 {
            #[unroll]
            for j in 0..4u32 {
                let (row, column) = (m0 + ty + i, n0 + tx + j);
                if row < m && column < n {
                    parts[((piece * m + row) * n + column) as usize] = sum[(i * 4 + j) as usize];
                }
            }
        }
    }
}

#[cube(launch)]
fn sum_pieces(parts: &[f32], out: &mut [f32], len: u32, pieces: u32) {
    if ABSOLUTE_POS < len as usize {
        let mut sum = 0.0f32;
        for piece in 0..pieces {
            sum += parts[(piece * len) as usize + ABSOLUTE_POS];
        }
        out[ABSOLUTE_POS] = sum;
    }
}

#[cube(launch)]
fn sum_rows(a: &[f32], parts: &mut [f32], rows: u32, n: u32, pieces: u32) {
    let at = ABSOLUTE_POS as u32;
    if at < pieces * n {
        let (piece, column) = (at / n, at % n);
        let from = piece * comptime!(ROWS);
        let to = min(from + comptime!(ROWS), rows);
        let mut sum = 0.0f32;
        for row in from..to {
            sum += a[(row * n + column) as usize];
        }
        parts[at as usize] = sum;
    }
}
