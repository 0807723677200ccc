//! A transfer function as a table over the data, with the opacity of one step.

use crate::volume::transfer::TransferFunction;

/// Entries of the table.
const ENTRIES: usize = 4096;

/// Colour and opacity by data value.
#[derive(Debug)]
pub(super) struct Table {
    low: f32,
    scale: f32,
    /// Straight colour, and the opacity of one step.
    entries: Vec<[f32; 4]>,
    /// Segment of each entry, from the transfer function's named ranges; 0 for none.
    segments: Vec<u16>,
    /// `opaque[i]` entries before entry `i` have some opacity.
    opaque: Vec<u32>,
}

impl Table {
    /// `steps` is the length of a step in units of the length over which opacity accrues.
    pub fn new(transfer: &TransferFunction, span: [f64; 2], steps: f64) -> Self {
        let mut entries = transfer.table(ENTRIES);
        for e in &mut entries {
            // 1 - (1 - a)^s without cancellation for small a
            e[3] = -(steps * f64::ln_1p(-f64::from(e[3].min(0.999_999)))).exp_m1() as f32;
        }
        let fraction = |i: usize| i as f64 / (ENTRIES - 1) as f64;
        let segments = (0..ENTRIES).map(|i| transfer.segment_of(fraction(i)).map_or(0, |s| s as u16 + 1)).collect();
        let mut opaque = Vec::with_capacity(ENTRIES + 1);
        opaque.push(0);
        for e in &entries {
            opaque.push(opaque[opaque.len() - 1] + u32::from(e[3] > 0.0));
        }
        let width = (span[1] - span[0]).max(f64::MIN_POSITIVE);
        Self { low: span[0] as f32, scale: ((ENTRIES - 1) as f64 / width) as f32, entries, segments, opaque }
    }

    /// The entry of a data value; values outside the span take its ends.
    #[inline(always)]
    pub fn index(&self, value: f32) -> usize {
        // the cast saturates: negative numbers become 0
        (((value - self.low) * self.scale + 0.5) as usize).min(ENTRIES - 1)
    }

    #[inline(always)]
    pub fn entry(&self, index: usize) -> [f32; 4] {
        self.entries[index]
    }

    #[inline(always)]
    pub fn segment(&self, index: usize) -> u16 {
        self.segments[index]
    }

    /// Whether any value in `[low, high]` has some opacity. One entry more on both sides, as interpolation rounds.
    pub fn any_opaque(&self, low: f32, high: f32) -> bool {
        let (from, to) = (self.index(low).saturating_sub(1), (self.index(high) + 1).min(ENTRIES - 1));
        self.opaque[to + 1] > self.opaque[from]
    }

    /// Whether `segment` has some opacity among the values in `[low, high]`.
    pub fn any_opaque_of(&self, segment: u16, low: f32, high: f32) -> bool {
        let (from, to) = (self.index(low).saturating_sub(1), (self.index(high) + 1).min(ENTRIES - 1));
        (from..=to).any(|i| self.segments[i] == segment && self.entries[i][3] > 0.0)
    }
}
