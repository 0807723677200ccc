//! The neighbours of each of several points.

/// As many neighbours for each of M points, indices `[M, k]`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct NearestRows {
    width: usize,
    indices: Vec<u32>,
}

impl NearestRows {
    /// Creates rows of `width` neighbours for `count` points, each its own neighbour.
    pub(super) fn own(count: usize, width: usize) -> Self {
        Self { width, indices: (0..count as u32).flat_map(|i| std::iter::repeat_n(i, width)).collect() }
    }

    /// Creates rows of `width` neighbours from their indices, row by row.
    pub(super) fn new(width: usize, indices: Vec<u32>) -> Self {
        Self { width, indices }
    }

    /// Returns the neighbours of point `i`.
    ///
    /// # Panics
    /// If there is no such point.
    pub fn row(&self, i: usize) -> &[u32] {
        &self.indices[i * self.width..(i + 1) * self.width]
    }

    pub(super) fn row_mut(&mut self, i: usize) -> &mut [u32] {
        &mut self.indices[i * self.width..(i + 1) * self.width]
    }

    /// Returns the neighbours of each point.
    pub fn rows(&self) -> impl Iterator<Item = &[u32]> {
        self.indices.chunks_exact(self.width.max(1))
    }
}
