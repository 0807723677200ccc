//! A transfer function as a table over the data, integrated over intervals of values.
//!
//! Between two samples along a ray the value is assumed to change linearly, so the colour and opacity of the step are
//! means over the values between them (pre-integrated classification, without attenuation inside the step): bands
//! thinner than a step are not missed. Prefix sums give the mean of any interval in two look-ups.

use crate::volume::transfer::TransferFunction;

/// Number of entries of the table.
const ENTRIES: usize = 4096;
/// Opacities are kept below one, whose extinction would be infinite.
const MAX_OPACITY: f64 = 0.999_999;

/// Colour and extinction by data value.
#[derive(Debug)]
pub(super) struct Table {
    low: f32,
    scale: f32,
    /// Sums over the entries before each: colour times extinction, and extinction of a step.
    sums: Vec<[f64; 4]>,
    /// Segment of each entry, from the transfer function's named ranges; 0 for none.
    segments: Vec<u16>,
    /// First entry and one past the last of each segment, by id minus one.
    ranges: Vec<[usize; 2]>,
}

impl Table {
    /// `steps` is the length of a step in units of the length over which opacity accrues.
    pub fn new(transfer: &TransferFunction, span: [f64; 2], steps: f64) -> Self {
        let mut sums = Vec::with_capacity(ENTRIES + 1);
        let mut sum = [0.0; 4];
        sums.push(sum);
        for e in transfer.table(ENTRIES) {
            let extinction = -steps * (-f64::from(e[3]).min(MAX_OPACITY)).ln_1p();
            (0..3).for_each(|c| sum[c] += extinction * f64::from(e[c]));
            sum[3] += extinction;
            sums.push(sum);
        }
        let fraction = |i: usize| i as f64 / (ENTRIES - 1) as f64;
        let segments: Vec<u16> =
            (0..ENTRIES).map(|i| transfer.segment_of(fraction(i)).map_or(0, |s| s as u16 + 1)).collect();
        let ranges = (1..=transfer.segments.len() as u16)
            .map(|id| {
                let first = segments.iter().position(|s| *s == id).unwrap_or(0);
                [first, segments.iter().rposition(|s| *s == id).map_or(first, |last| last + 1)]
            })
            .collect();
        let width = (span[1] - span[0]).max(f64::MIN_POSITIVE);
        Self { low: span[0] as f32, scale: ((ENTRIES - 1) as f64 / width) as f32, sums, segments, ranges }
    }

    /// The entry of a data value; values outside the span use its ends.
    #[inline(always)]
    pub fn index(&self, value: f32) -> usize {
        // the cast saturates: negative numbers become 0
        (((value - self.low) * self.scale + 0.5) as usize).min(ENTRIES - 1)
    }

    /// The entries from one value to another, as first and one past the last.
    #[inline(always)]
    pub fn between(&self, a: f32, b: f32) -> [usize; 2] {
        let (a, b) = (self.index(a), self.index(b));
        [a.min(b), a.max(b) + 1]
    }

    /// Mean colour and mean extinction of a step over the entries of an interval; if `segment` is not 0, only its
    /// entries count.
    #[inline(always)]
    pub fn mean(&self, [first, end]: [usize; 2], segment: u16) -> [f32; 4] {
        let count = (end - first) as f64;
        let (first, end) = match segment {
            0 => (first, end),
            id => {
                let [from, to] = self.ranges.get(usize::from(id) - 1).copied().unwrap_or_default();
                (first.max(from), end.min(to))
            }
        };
        if first >= end {
            return [0.0; 4];
        }
        let (a, b) = (&self.sums[first], &self.sums[end]);
        let extinction = b[3] - a[3];
        if extinction <= 0.0 {
            return [0.0; 4];
        }
        let inverse = 1.0 / extinction;
        let color = |c: usize| ((b[c] - a[c]) * inverse) as f32;
        [color(0), color(1), color(2), (extinction / count) as f32]
    }

    #[inline(always)]
    pub fn segment(&self, index: usize) -> u16 {
        self.segments[index]
    }

    /// Whether any value in `[low, high]` is visible and, if `segment` is not 0, belongs to it. One entry more on both
    /// sides, as interpolation rounds.
    pub fn any_opaque(&self, segment: u16, low: f32, high: f32) -> bool {
        let (from, to) = (self.index(low).saturating_sub(1), (self.index(high) + 1).min(ENTRIES - 1));
        self.mean([from, to + 1], segment)[3] > 0.0
    }
}
