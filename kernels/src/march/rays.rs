//! Assignment of samples, and of their colours, to rays.

use std::sync::Arc;

/// Samples of many rays, one ray after the other, each from the eye onwards. Cheap to clone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RaySamples {
    /// Index of the first sample of each ray, then the number of samples: `[R + 1]`.
    pub(super) offsets: Arc<[u32]>,
    /// Number of samples with a colour before each sample, then their total: `[S + 1]`.
    pub(super) rows: Arc<[u32]>,
}

impl RaySamples {
    /// Assigns the samples `offsets[r]..offsets[r + 1]`, from `offsets` `[R + 1]`, to ray r; those marked in `coloured`
    /// `[S]` have a colour, in the same order.
    ///
    /// # Panics
    /// If the offsets do not rise from 0 to the length of `coloured`.
    pub fn new(offsets: &[u32], coloured: &[bool]) -> Self {
        let ends = (offsets.first().copied(), offsets.last().copied());
        assert_eq!(ends, (Some(0), Some(coloured.len() as u32)), "offsets: from 0 to the number of samples");
        assert!(offsets.is_sorted(), "offsets: sorted in ascending order");
        let mut rows = Vec::with_capacity(coloured.len() + 1);
        let mut count = 0;
        rows.push(0);
        for is_coloured in coloured {
            count += u32::from(*is_coloured);
            rows.push(count);
        }
        Self { offsets: offsets.into(), rows: rows.into() }
    }

    /// Number of rays.
    pub fn rays(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Number of samples.
    pub fn samples(&self) -> usize {
        self.rows.len() - 1
    }

    /// Number of samples with a colour.
    pub fn coloured(&self) -> usize {
        self.rows[self.samples()] as usize
    }

    /// Returns the samples of a ray.
    pub(super) fn of(&self, ray: usize) -> std::ops::Range<usize> {
        self.offsets[ray] as usize..self.offsets[ray + 1] as usize
    }

    /// Returns the row of the sample's colour, if it has one.
    pub(super) fn row(&self, sample: usize) -> Option<usize> {
        let row = self.rows[sample];
        (row < self.rows[sample + 1]).then_some(row as usize)
    }
}
