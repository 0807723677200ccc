//! The bin edges of a histogram.

/// Whole numbers below this, and the edges halfway between them, are exact in single precision.
const EXACT: f64 = (1 << 22) as f64;

/// The equal bins of a histogram.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HistogramBins {
    /// Number of bins.
    pub count: usize,
    /// Data values at the lower end of the first and the upper end of the last.
    pub range: [f64; 2],
}

impl HistogramBins {
    /// At most `max_count` bins over the data values `span`. Of `whole` numbers each bin covers equally many, so that
    /// none stays empty or is twice as high because of where its edges fall.
    pub fn new(span: [f64; 2], whole: bool, max_count: usize) -> Self {
        let [first, last] = [span[0].ceil(), span[1].floor()];
        let exact = first.abs() < EXACT && last.abs() < EXACT;
        if !whole || !exact || last < first || max_count == 0 {
            return Self { count: max_count, range: span };
        }
        let values = last - first + 1.0;
        let width = (values / max_count as f64).ceil();
        let count = (values / width).ceil();
        Self { count: count as usize, range: [first - 0.5, first - 0.5 + count * width] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The counts of the whole numbers from `first` to `last`, each occurring once.
    fn counts(bins: HistogramBins, first: i32, last: i32) -> Vec<u64> {
        let mut counts = vec![0; bins.count];
        let [low, high] = bins.range;
        for v in first..=last {
            let part = (f64::from(v) - low) / (high - low);
            counts[((part * bins.count as f64) as usize).min(bins.count - 1)] += 1;
        }
        counts
    }

    #[test]
    fn whole_numbers_leave_no_false_gaps() {
        // 254 values in 256 bins left two of them empty, near 85 and 169
        for last in [3, 200, 253, 254, 255] {
            let bins = HistogramBins::new([0.0, f64::from(last)], true, 256);
            assert_eq!(bins.count, last as usize + 1);
            assert_eq!(counts(bins, 0, last), vec![1; bins.count], "0 to {last}");
        }
        let bins = HistogramBins::new([-1000.0, 64_534.0], true, 256);
        let counts = counts(bins, -1000, 64_534);
        let (rest, whole) = counts.split_last().unwrap();
        assert!(bins.count <= 256 && whole.iter().all(|n| *n == 256) && *rest <= 256, "{counts:?}");
        for (span, whole) in [([0.0, 255.0], false), ([0.2, 0.8], true), ([0.0, 4e9], true)] {
            assert_eq!(HistogramBins::new(span, whole, 256), HistogramBins { count: 256, range: span });
        }
        assert_eq!(HistogramBins::new([7.0, 7.0], true, 256), HistogramBins { count: 1, range: [6.5, 7.5] });
    }
}
