//! A transfer function as a table over the data, integrated over intervals of values.
//!
//! Between two samples along a ray the value is assumed to change linearly, so the colour and opacity of the step are
//! means over the values between them (pre-integrated classification, without attenuation inside the step): bands
//! thinner than a step are not missed. Prefix sums give the mean of any interval in two look-ups. The table is as fine
//! as the narrowest band needs; segments of single values are looked up exactly, whatever its entries.

use crate::volume::transfer::{SegmentRange, TransferFunction};

/// Minimum number of entries of the table; enough unless bands are narrower than a thousandth of the span.
const MIN_ENTRIES: usize = 4096;
/// Maximum number of entries.
const MAX_ENTRIES: usize = 1 << 20;
/// Minimum number of entries between two control points, and across a named range.
const PER_BAND: f64 = 4.0;
/// Opacities are kept below one, whose extinction would be infinite.
const MAX_OPACITY: f64 = 0.999_999;

/// Colour and extinction by data value.
#[derive(Debug)]
pub(super) struct TransferTable {
    low: f32,
    scale: f32,
    last: usize,
    /// Data value at the fraction 0, and the width of the span.
    span: [f64; 2],
    /// Sums over the entries before each: colour times extinction, and extinction of a step.
    sums: Vec<[f64; 4]>,
    /// The transfer function's named ranges with their ids, in ascending order.
    segments: Vec<(u16, SegmentRange)>,
    /// First entry and one past the last of each segment, by id minus one.
    ranges: Vec<[usize; 2]>,
}

/// The number of entries with which nothing between two control points of the opacity or of the colours, and no named
/// range, is missed. What is too narrow for the largest table is a step written as a slope, and decides nothing.
fn entries(transfer: &TransferFunction) -> usize {
    let widths = |positions: Vec<f64>| -> Vec<f64> { positions.windows(2).map(|p| p[1] - p[0]).collect() };
    let opacity = widths(transfer.opacity.iter().map(|p| p.0).collect());
    let colors = widths(transfer.colors.iter().map(|p| p.0).collect());
    let ranges = transfer.segments.iter().map(|s| s.range[1] - s.range[0]);
    let least = PER_BAND / (MAX_ENTRIES - 1) as f64;
    let narrowest = opacity.into_iter().chain(colors).chain(ranges).filter(|w| *w >= least).fold(1.0, f64::min);
    ((PER_BAND / narrowest).ceil() as usize + 1).clamp(MIN_ENTRIES, MAX_ENTRIES)
}

impl TransferTable {
    /// `steps` is the length of a step in units of the length over which opacity accrues.
    pub fn new(transfer: &TransferFunction, span: [f64; 2], steps: f64) -> Self {
        let count = entries(transfer);
        let mut sums = Vec::with_capacity(count + 1);
        let mut sum = [0.0; 4];
        sums.push(sum);
        for e in transfer.table(count) {
            let extinction = -steps * (-f64::from(e[3]).min(MAX_OPACITY)).ln_1p();
            (0..3).for_each(|c| sum[c] += extinction * f64::from(e[c]));
            sum[3] += extinction;
            sums.push(sum);
        }
        let fraction = |i: usize| i as f64 / (count - 1) as f64;
        // the first entry at or above a fraction; the product may be rounded past it
        let first = |bound: f64| {
            let mut i = ((bound * (count - 1) as f64).ceil() as usize).min(count);
            while i > 0 && fraction(i - 1) >= bound {
                i -= 1;
            }
            while i < count && fraction(i) < bound {
                i += 1;
            }
            i
        };
        let range = |s: &SegmentRange| [first(s.range[0]), if s.range[1] >= 1.0 { count } else { first(s.range[1]) }];
        let ranges = transfer.segments.iter().map(range).collect();
        let named = transfer.segments.iter().enumerate();
        let mut segments: Vec<(u16, SegmentRange)> = named.map(|(i, s)| (i as u16 + 1, s.clone())).collect();
        segments.sort_by(|a, b| a.1.range[0].total_cmp(&b.1.range[0]));
        let width = (span[1] - span[0]).max(f64::MIN_POSITIVE);
        let scale = ((count - 1) as f64 / width) as f32;
        Self { low: span[0] as f32, scale, last: count - 1, span: [span[0], width], sums, segments, ranges }
    }

    /// The entry of a data value; values outside the span use its ends.
    #[inline(always)]
    pub fn index(&self, value: f32) -> usize {
        // the cast saturates: negative numbers become 0
        (((value - self.low) * self.scale + 0.5) as usize).min(self.last)
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

    /// Mean colour and extinction of a step from one value to another; if `segment` is not 0, only its values count.
    #[inline(always)]
    pub fn step(&self, from: f32, to: f32, segment: u16) -> [f32; 4] {
        let interval = self.between(from, to);
        let mut among = segment;
        if segment != 0 && interval[1] - interval[0] == 1 {
            // the value of a plateau, such as a whole number, is exact, while its entry may lie beyond a bound
            if self.segment(0.5 * (from + to)) != segment {
                return [0.0; 4];
            }
            among = 0;
        }
        self.mean(interval, among)
    }

    /// The segment of a data value, from the transfer function's named ranges; 0 for none. Not by entries: a bound
    /// given in data units holds exactly.
    #[inline]
    pub fn segment(&self, value: f32) -> u16 {
        // computed as a bound's fraction is, so that equal values are equal fractions
        let fraction = ((f64::from(value) - self.span[0]) / self.span[1]).clamp(0.0, 1.0);
        // ranges do not overlap
        let after = self.segments.partition_point(|(_, s)| s.range[0] <= fraction);
        match after.checked_sub(1).map(|i| &self.segments[i]) {
            Some((id, range)) if range.contains(fraction) => *id,
            _ => 0,
        }
    }

    /// Whether any value in `[low, high]` is visible and, if `segment` is not 0, whether any may belong to it. One
    /// entry more on both sides, as interpolation rounds.
    pub fn any_opaque(&self, segment: u16, low: f32, high: f32) -> bool {
        let (from, to) = (self.index(low).saturating_sub(1), (self.index(high) + 1).min(self.last));
        let of_segment = match segment {
            0 => true,
            id => self.ranges.get(usize::from(id) - 1).is_some_and(|[first, end]| *first <= to && *end > from),
        };
        of_segment && self.mean([from, to + 1], 0)[3] > 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn function(opacity: &[(f64, f32)], ranges: &[[f64; 2]]) -> TransferFunction {
        let mut transfer = TransferFunction::load("ramp").unwrap();
        transfer.opacity = opacity.to_vec();
        let named = |(i, range): (usize, &[f64; 2])| SegmentRange { name: format!("s{i}"), range: *range, color: None };
        transfer.segments = ranges.iter().enumerate().map(named).collect();
        transfer
    }

    #[test]
    fn ordinary_functions_have_the_table_they_always_had() {
        for name in TransferFunction::presets() {
            let transfer = TransferFunction::load(name).unwrap();
            assert_eq!(TransferTable::new(&transfer, [0.0, 1.0], 1.0).sums.len(), 4097, "{name}");
        }
        // a step, written as one and as a slope
        for edge in [0.5, 0.500_001] {
            assert_eq!(entries(&function(&[(0.5, 0.0), (edge, 0.8)], &[[0.2, 0.4], [0.4, 1.0]])), 4096);
        }
        assert_eq!(entries(&function(&[(0.5, 0.3)], &[])), 4096, "one point");
    }

    #[test]
    fn narrow_bands_have_entries_of_their_own() {
        // between two entries of the usual table
        let (low, high) = (0.500_03, 0.500_08);
        let band = function(&[(0.0, 0.0), (low, 0.0), (low, 0.5), (high, 0.5), (high, 0.0), (1.0, 0.0)], &[]);
        let table = TransferTable::new(&band, [0.0, 1.0], 1.0);
        let found = f64::from(table.step(0.4, 0.6, 0)[3]);
        let expected = std::f64::consts::LN_2 * (high - low) / 0.2;
        assert!((found / expected - 1.0).abs() < 0.3, "{found} {expected}");
        assert!(table.any_opaque(0, 0.4, 0.6) && !table.any_opaque(0, 0.4, 0.49));
        // named ranges and colours count too, and nothing exceeds the limit
        assert!(entries(&function(&[(0.0, 0.2)], &[[0.5, 0.500_1]])) >= 40_001);
        let mut colored = function(&[(0.0, 0.2)], &[]);
        colored.colors = [0.0, 0.5, 0.500_1, 1.0].map(|x| (x, [x as f32; 3])).to_vec();
        assert!(entries(&colored) >= 40_001);
        for width in [1e-4, 1e-5, 4e-6, 3e-6, 1e-7] {
            assert!(entries(&function(&[(0.5, 0.1), (0.5 + width, 0.2)], &[])) <= MAX_ENTRIES, "{width}");
        }
    }

    #[test]
    fn whole_numbers_at_bounds_have_the_right_id() {
        for [low, high] in [[0.0f64, 255.0], [-1000.0, 2000.0]] {
            // a range per value, the last of which includes the end
            let count = (high - low) as u16;
            let bound = |i: u16| (low + f64::from(i) - low) / (high - low);
            let ranges: Vec<[f64; 2]> = (0..count).map(|i| [bound(i), bound(i + 1)]).collect();
            let table = TransferTable::new(&function(&[(0.0, 0.2)], &ranges), [low, high], 1.0);
            for i in 0..=count {
                let (value, id) = (low as f32 + f32::from(i), (i + 1).min(count));
                assert_eq!(table.segment(value), id, "{value}");
                // alone, a plateau of this value shows in its segment only
                assert!(table.step(value, value, id)[3] > 0.0 && table.any_opaque(id, value, value), "{value}");
                let mut others = [id - 1, id + 1].into_iter().filter(|o| *o > 0);
                assert!(others.all(|other| table.step(value, value, other)[3] == 0.0), "{value}");
            }
            assert_eq!((table.segment(low as f32 - 9.0), table.segment(high as f32 + 9.0)), (1, count));
        }
        let gaps = TransferTable::new(&function(&[(0.0, 0.2)], &[[0.6, 0.8], [0.2, 0.4]]), [0.0, 10.0], 1.0);
        assert_eq!([1.0, 2.0, 3.9, 4.0, 6.0, 8.0, 10.0].map(|v| gaps.segment(v)), [0, 2, 2, 0, 1, 0, 0]);
    }
}
