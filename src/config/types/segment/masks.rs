//! Masks of rendered views, and the affinity field that is trained on them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

section! {
    /// `segment.masks.*`: masks of rendered views. Lengths are for pictures of 200 to 1000 pixels a side.
    MasksConfig, "masks" {
        /// Regions: alpha below which a pixel is background.
        background_alpha: f32 = 0.05, 0.0..=1.0;
        /// Regions: smallest mask, in pixels of an image of 400x400; scaled with the image's area.
        min_area: f32 = 100.0, 0.0..=160_000.0;
        /// Regions: mean jump below which a boundary makes no mask, in units of the full range of colour, alpha or depth.
        contrast: f32 = 0.04, 0.0..=1.0;
        /// Regions: fraction by which the inner boundaries of a region must be weaker than its outer one.
        persistence: f32 = 0.3, 0.0..=1.0;
        /// Regions: of masks with a higher intersection over union only the best is kept; 1 keeps all.
        duplicate_iou: f64 = 0.9, 0.0..=1.0;
        /// Regions: finer of the two smoothings whose gradients distinguish jumps from ramps, a standard deviation in pixels.
        fine_blur: f32 = 1.0, 0.3..=20.0;
        /// Regions: coarser of the two.
        coarse_blur: f32 = 3.0, 0.3..=60.0;
        /// Regions: multiple of the coarse gradient that is subtracted from the fine one: above 1, since curved shading is a
        /// little steeper at its steepest than over a distance.
        ramp: f32 = 1.3, 0.0..=2.0;
        /// Regions: whether gaps in boundaries are closed.
        close_gaps: bool = true;
        /// Regions: jump that counts as a boundary whose gaps are closed.
        gap_edge: f32 = 0.08, 0.0..=1.0;
        /// Regions: reach of the slope that closes gaps, pixels.
        gap_reach: f32 = 12.0, 1e-3..=1000.0;
        /// Regions: height of that slope, a jump.
        gap_height: f32 = 0.05, 0.0..=1.0;
        /// Regions: minimum thickness of a region inside a piece, pixels: an edge itself is about as wide.
        min_thickness: f32 = 3.0, 0.0..=1000.0;
        /// Regions: whether outlines inside a piece are smoothed and small holes filled.
        smooth: bool = true;
        /// Alpha below which a pixel is background in any picture: two steps of 8 bits.
        min_alpha: f64 = 2.0 / 255.0, 0.0..=1.0;
        /// Fraction of a group's typical alpha below which a pixel, or the mean of a mask, is background; 0 filters by
        /// `min_alpha` alone.
        background_share: f64 = 0.25, 0.0..=1.0;
        /// Labels: fraction of the whole scene's colour above which a group is in front.
        front_share: f32 = 0.5, 0.0..=1.0;
        /// Labels: minimum number of pixels of a mask.
        label_pixels: u64 = 16, 0..=1_000_000_000;
        /// SAM: predicted intersection over union above which a mask is kept; as published.
        sam_predicted_iou: f32 = 0.88, 0.0..=1.0;
        /// SAM: minimum stability of a mask; as published.
        sam_stability: f32 = 0.95, 0.0..=1.0;
        /// SAM: of two masks whose boxes' intersection over union is above this, the better one is kept; as published.
        sam_box_overlap: f32 = 0.7, 0.0..=1.0;
    }
}

/// At which scale a step evaluates the affinity field, and which of the masks that cover a pixel is used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum MaskScale {
    /// One scale per step, drawn uniformly from [0, 1]; a pixel uses the smallest covering mask not below it, or else
    /// the largest. The field then learns the parts at each scale.
    #[default]
    Drawn,
    /// As in the paper: a pixel uses any mask that covers it, and each Gaussian is evaluated at the scale of its own
    /// mask. The masks of a view are put in a random order at each step, and a pixel uses the first that covers it; a
    /// Gaussian's mask is the one to whose pixels it contributes most. Here too a scale is the rank of a mask's spread,
    /// so that trained fields of both kinds are evaluated in the same way.
    Own,
}

section! {
    /// `segment.affinity.*`: training of the affinity field.
    AffinityConfig, "affinity" {
        /// Number of steps; as in the paper.
        steps: usize = 5000, 1..=100_000_000;
        /// Pixels per step, of the up to 16384 kept of a view; 8192 in the paper. With a margin, time grows with the square
        /// of this number.
        pixels: usize = 2048, 1..=16_384;
        /// Learning rate of Adam; as in the paper.
        rate: f64 = 1e-3, 1e-12..=1e3;
        /// Cosine above which pixels of different masks repel; -1 is the paper's loss, which has no margin. With a margin,
        /// more parts can be distinguished: 2026-11-21-segments.
        margin: f32 = 0.5, -1.0..=1.0;
        /// Scale that a step uses: one drawn for all Gaussians (`drawn`), or that of each Gaussian's own mask, as in the
        /// paper (`own`).
        mask_scale: MaskScale = MaskScale::Drawn;
        /// Weight of the hierarchy loss: pixels of one mask also attract at a random larger scale, so that a part stays
        /// together within its whole; 0 omits it, as in the paper.
        hierarchy: f64 = 0.0, 0.0..=1e6;
    }
}
