//! The binary mask as run lengths, and set operations done on the runs themselves.
//!
//! Only the data type: reading and writing its text form is in `rle`, files are in `store`.

use std::collections::BTreeMap;

use thiserror::Error;

/// A binary image as run lengths, column by column from the top left, first run zeros (COCO's order).
///
/// The runs alternate between clear and set pixels and sum to `width * height`; a run may be empty. The fields are
/// public, so a mask built by hand may violate this; [`Mask::validate`] checks it. On such a mask no method panics, and
/// pixels past the image do not count.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Mask {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Run lengths in pixels, clear run first.
    pub counts: Vec<u32>,
}

/// What can be wrong with a mask.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum MaskError {
    /// Width times height does not fit pixel indices.
    #[error("mask size {width}x{height} has more than 2^32 - 1 pixels; use smaller images")]
    TooLarge {
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
    },
    /// The runs do not cover the image exactly.
    #[error("mask counts sum to {sum} pixels, but the size {width}x{height} needs {expected}")]
    CountsSum {
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
        /// What the counts sum to.
        sum: u64,
        /// `width * height`.
        expected: u64,
    },
    /// A row-major buffer of the wrong length.
    #[error("mask buffer holds {found} pixels, but the size {width}x{height} needs {expected}")]
    BufferLength {
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
        /// Length of the buffer.
        found: usize,
        /// `width * height`.
        expected: u64,
    },
    /// Two masks of different sizes cannot be compared.
    #[error(
        "masks differ in size: {a_width}x{a_height} against {b_width}x{b_height}; both must come from images of one size"
    )]
    SizeMismatch {
        /// Width of the first.
        a_width: u32,
        /// Height of the first.
        a_height: u32,
        /// Width of the second.
        b_width: u32,
        /// Height of the second.
        b_height: u32,
    },
}

impl Mask {
    /// A mask with no pixel set.
    ///
    /// # Errors
    /// [`MaskError::TooLarge`] if the pixels do not fit `u32` indices.
    pub fn empty(width: u32, height: u32) -> Result<Self, MaskError> {
        let pixels = pixel_count(width, height)?;
        Ok(Self { width, height, counts: vec![pixels] })
    }

    /// A mask from its run lengths.
    ///
    /// # Errors
    /// As [`Mask::validate`].
    pub fn from_counts(width: u32, height: u32, counts: Vec<u32>) -> Result<Self, MaskError> {
        let mask = Self { width, height, counts };
        mask.validate()?;
        Ok(mask)
    }

    /// A mask from a row-major buffer `[height, width]`.
    ///
    /// # Errors
    /// [`MaskError::BufferLength`] if the buffer does not hold `width * height` values, [`MaskError::TooLarge`].
    pub fn from_rows(width: u32, height: u32, set: &[bool]) -> Result<Self, MaskError> {
        check_length(width, height, set.len())?;
        Ok(Self::from_window(width, height, [0, 0, width, height], set))
    }

    /// Returns the mask of each non-zero value of a row-major buffer `[height, width]`, by ascending value, in one pass
    /// over the buffer.
    ///
    /// # Errors
    /// As [`Mask::from_rows`].
    pub fn of_labels(width: u32, height: u32, labels: &[u16]) -> Result<Vec<(u16, Self)>, MaskError> {
        let pixels = check_length(width, height, labels.len())?;
        // the runs of each value, and where the last one ends
        let mut found: BTreeMap<u16, (Vec<u32>, u32)> = BTreeMap::new();
        let mut close = |label: u16, start: u32, end: u32| {
            if label != 0 && start < end {
                let (counts, last) = found.entry(label).or_default();
                counts.extend([start - *last, end - start]);
                *last = end;
            }
        };
        let (mut label, mut start, mut at) = (0, 0, 0);
        for x in 0..width as usize {
            for y in 0..height as usize {
                let next = labels[y * width as usize + x];
                if next != label {
                    close(label, start, at);
                    (label, start) = (next, at);
                }
                at += 1;
            }
        }
        close(label, start, at);
        let whole = |(label, (mut counts, last)): (u16, (Vec<u32>, u32))| {
            if last < pixels {
                counts.push(pixels - last);
            }
            (label, Self { width, height, counts })
        };
        Ok(found.into_iter().map(whole).collect())
    }

    /// The mask as a row-major buffer `[height, width]`.
    pub fn to_rows(&self) -> Vec<bool> {
        self.window([0, 0, self.width, self.height])
    }

    /// A mask from a row-major buffer of the box `[x, y, w, h]` alone, which must lie inside the image.
    pub(super) fn from_window(width: u32, height: u32, [x, y, w, h]: [u32; 4], set: &[bool]) -> Self {
        let (mut counts, mut value, mut run) = (Vec::new(), false, 0_u32);
        let mut add = |pixel: bool, length: u32| {
            if pixel != value && length > 0 {
                counts.push(run);
                (value, run) = (pixel, 0);
            }
            run += length;
        };
        add(false, x * height);
        for column in 0..w as usize {
            add(false, y);
            for row in 0..h as usize {
                add(set[row * w as usize + column], 1);
            }
            add(false, height - y - h);
        }
        add(false, (width - x - w) * height);
        counts.push(run);
        Self { width, height, counts }
    }

    /// The set pixels inside the box `[x, y, w, h]` as a row-major buffer `[h, w]`.
    pub(super) fn window(&self, [x, y, w, h]: [u32; 4]) -> Vec<bool> {
        let mut set = vec![false; w as usize * h as usize];
        for pixel in self.pixels() {
            let (column, row) = (pixel % self.width, pixel / self.width);
            if (x..x + w).contains(&column) && (y..y + h).contains(&row) {
                set[((row - y) * w + column - x) as usize] = true;
            }
        }
        set
    }

    /// Checks that the counts sum to `width * height`.
    ///
    /// # Errors
    /// [`MaskError::CountsSum`] or [`MaskError::TooLarge`].
    pub fn validate(&self) -> Result<(), MaskError> {
        let expected = u64::from(pixel_count(self.width, self.height)?);
        let sum = self.counts.iter().map(|&run| u64::from(run)).sum();
        if sum != expected {
            return Err(MaskError::CountsSum { width: self.width, height: self.height, sum, expected });
        }
        Ok(())
    }

    /// Number of set pixels.
    pub fn area(&self) -> u64 {
        self.set_runs().map(|(start, end)| end - start).sum()
    }

    /// Smallest box around the set pixels, `[x, y, width, height]` in pixels; zeros if none is set.
    pub fn bbox(&self) -> [u32; 4] {
        let height = u64::from(self.height);
        let (mut left, mut right, mut top, mut bottom) = (u64::MAX, 0, u64::MAX, 0);
        for (start, end) in self.set_runs() {
            let (first, last) = (start / height, (end - 1) / height);
            left = left.min(first);
            right = right.max(last);
            if first == last {
                top = top.min(start % height);
                bottom = bottom.max((end - 1) % height);
            } else {
                // A run over a column's end touches the image's bottom row and the next column's top row.
                (top, bottom) = (0, height - 1);
            }
        }
        if left == u64::MAX {
            return [0; 4];
        }
        // All four are below `u32` sides, so the conversions keep their values.
        [left as u32, top as u32, (right - left + 1) as u32, (bottom - top + 1) as u32]
    }

    /// Whether the pixel in column `x` and row `y` is set; false outside the image.
    pub fn contains(&self, x: u32, y: u32) -> bool {
        if x >= self.width || y >= self.height {
            return false;
        }
        let at = u64::from(x) * u64::from(self.height) + u64::from(y);
        self.set_runs().take_while(|&(start, _)| start <= at).any(|(_, end)| at < end)
    }

    /// Row-major indices (`y * width + x`) of the set pixels, in column order.
    pub fn pixels(&self) -> impl Iterator<Item = u32> + '_ {
        let (width, height) = (u64::from(self.width), u64::from(self.height));
        self.set_runs().flat_map(|(start, end)| start..end).map(move |at| ((at % height) * width + at / height) as u32)
    }

    /// Number of pixels set in both masks.
    ///
    /// # Errors
    /// [`MaskError::SizeMismatch`] if the masks differ in size.
    pub fn intersection_area(&self, other: &Self) -> Result<u64, MaskError> {
        self.same_size(other)?;
        Ok(common_runs(self, other).map(|(start, end)| end - start).sum())
    }

    /// The pixels set in both masks.
    ///
    /// # Errors
    /// [`MaskError::SizeMismatch`], or [`MaskError::TooLarge`].
    pub fn intersection(&self, other: &Self) -> Result<Self, MaskError> {
        self.same_size(other)?;
        let pixels = u64::from(pixel_count(self.width, self.height)?);
        let (mut counts, mut at) = (Vec::new(), 0);
        for (start, end) in common_runs(self, other) {
            if start == at && !counts.is_empty() {
                // Two touching pieces, split by an empty run in one of the masks, are one run.
                if let Some(last) = counts.last_mut() {
                    *last += (end - start) as u32;
                }
            } else {
                counts.extend([(start - at) as u32, (end - start) as u32]);
            }
            at = end;
        }
        if at < pixels || counts.is_empty() {
            counts.push((pixels - at) as u32);
        }
        Ok(Self { width: self.width, height: self.height, counts })
    }

    /// Intersection over union, 0 to 1; 0 for two empty masks.
    ///
    /// # Errors
    /// [`MaskError::SizeMismatch`] if the masks differ in size.
    pub fn iou(&self, other: &Self) -> Result<f64, MaskError> {
        let both = self.intersection_area(other)?;
        let either = self.area() + other.area() - both;
        Ok(if either == 0 { 0.0 } else { both as f64 / either as f64 })
    }

    /// Non-empty set runs as half-open ranges of column-major positions, cut at the image's end.
    fn set_runs(&self) -> impl Iterator<Item = (u64, u64)> + '_ {
        let pixels = u64::from(self.width) * u64::from(self.height);
        let mut at = 0_u64;
        self.counts.iter().enumerate().filter_map(move |(index, &run)| {
            let start = at.min(pixels);
            at += u64::from(run);
            let end = at.min(pixels);
            (index % 2 == 1 && end > start).then_some((start, end))
        })
    }

    fn same_size(&self, other: &Self) -> Result<(), MaskError> {
        if (self.width, self.height) == (other.width, other.height) {
            return Ok(());
        }
        Err(MaskError::SizeMismatch {
            a_width: self.width,
            a_height: self.height,
            b_width: other.width,
            b_height: other.height,
        })
    }
}

fn pixel_count(width: u32, height: u32) -> Result<u32, MaskError> {
    width.checked_mul(height).ok_or(MaskError::TooLarge { width, height })
}

/// The number of pixels, which a buffer of `found` values must have.
fn check_length(width: u32, height: u32, found: usize) -> Result<u32, MaskError> {
    let pixels = pixel_count(width, height)?;
    match found == pixels as usize {
        true => Ok(pixels),
        false => Err(MaskError::BufferLength { width, height, found, expected: u64::from(pixels) }),
    }
}

/// The overlaps of the set runs of two masks, ascending.
fn common_runs<'a>(a: &'a Mask, b: &'a Mask) -> impl Iterator<Item = (u64, u64)> + 'a {
    let (mut left, mut right) = (a.set_runs().peekable(), b.set_runs().peekable());
    std::iter::from_fn(move || {
        loop {
            let (&(a_start, a_end), &(b_start, b_end)) = (left.peek()?, right.peek()?);
            if a_end <= b_end {
                left.next();
            } else {
                right.next();
            }
            let (start, end) = (a_start.max(b_start), a_end.min(b_end));
            if start < end {
                return Some((start, end));
            }
        }
    })
}

#[cfg(test)]
mod tests;
