//! Clicks: what they hit, the parts and wholes there, and what of it there is at other times.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

section! {
    /// `segment.click.*`: what is under a click.
    ClickConfig, "click" {
        /// Whether a click beside a thin object means that object.
        nearby: bool = true;
        /// Minimum total weight of the Gaussians in a pixel for it to show anything that a user would click on.
        faint: f32 = 0.05, 0.0..=1.0;
        /// Maximum distance between a click and the object beside it, as a fraction of the image's width.
        reach: f32 = 0.01, 0.0..=0.1;
        /// Lower bound of that distance, pixels.
        min_reach: f32 = 2.0, 0.0..=100.0;
        /// Whether a click means the segment that makes up most of its pixel, instead of that of the Gaussian which
        /// contributes most.
        majority: bool = true;
    }
}

section! {
    /// `segment.levels.*`: the levels of parts and wholes at a click, and the likeliest.
    LevelsConfig, "levels" {
        /// Whether the connected piece of a segment at the click, and the clicked part of it, are levels, and the likeliest
        /// ones: 2026-11-22-segments.
        pieces: bool = true;
        /// Whether levels are sought as plateaus of the affinity, where a selection stops growing as the cosine falls; if
        /// not, there is one, at `scale` and `cosine`.
        plateaus: bool = true;
        /// Mask scale in [0, 1] where the user gives only a cosine, and without plateaus.
        scale: f32 = 0.5, 0.0..=1.0;
        /// Minimum cosine where the user gives only a scale, and without plateaus.
        cosine: f32 = 0.8, -1.0..=1.0;
        /// Mask scales at which plateaus are sought.
        scales: Vec<f32> = vec![0.1, 0.3, 0.5, 0.7, 0.9], 0.0..=1.0;
        /// Lowest cosine; training keeps those between different masks below `segment.affinity.margin`, 0.5.
        lowest: f32 = 0.45, -1.0..=1.0;
        /// Step between cosines.
        step: f32 = 0.025, 1e-4..=1.0;
        /// Number of cosines, from the lowest on.
        cosines: usize = 22, 3..=10_000;
        /// Steps to either side over which growth is measured, fewer than half of the cosines.
        reach: usize = 1, 1..=1000;
        /// Minimum stability of a level: the fraction of its weight that remains over these steps.
        stable: f64 = 0.5, 0.0..=1.0;
        /// Minimum intersection over union of two selections that are one level.
        alike: f64 = 0.85, 0.0..=1.0;
        /// Preference for larger levels over more stable ones: the exponent of a level's share of the weight; 0 for none.
        size_exponent: f64 = 0.1, 0.0..=100.0;
        /// Preference for levels that omit something over those that take everything: the exponent of the rest of the
        /// weight; 0 for none.
        rest_exponent: f64 = 0.3, 0.0..=100.0;
        /// A piece has parts only if it holds at least one in this many of the candidates, unless it is clicked.
        one_in: usize = 50, 1..=1_000_000;
    }
}

section! {
    /// `segment.objects.*`: touching objects of one colour, told apart by their affinity. Set on `jets`, `vortices` under
    /// two kinds of light, and five plumes that VTK drew: 2026-11-25-touching.
    ObjectsConfig, "objects" {
        /// Whether such objects are told apart.
        separate: bool = true;
        /// Mask scale in [0, 1] at which whole objects are distinguished.
        scale: f32 = 1.0, 0.0..=1.0;
        /// Number of Gaussians whose features are grouped; the others join the most similar group.
        sample: usize = 512, 2..=10_000;
        /// Minimum mean cosine between the features of two groups for them to be one.
        alike: f32 = 0.8, -1.0..=1.0;
        /// Number of nearest neighbours among which a Gaussian touches others, as far as `segment.pieces.reach`.
        neighbours: usize = 16, 1..=256;
        /// Patches stay separate if the weight of the contacts between them is below this fraction of all contact weight at
        /// the smaller one. Patches of one object had 0.022 or more, different objects 0.014 or less: 2026-11-25-touching.
        narrow: f64 = 0.02, 0.0..=1.0;
        /// Minimum size of a patch, as a fraction of all Gaussians.
        tiny: f64 = 0.005, 0.0..=1.0;
    }
}

section! {
    /// `segment.necks.*`: touching objects of one colour, told apart by the necks between them.
    NecksConfig, "necks" {
        /// Whether such objects are told apart.
        separate: bool = true;
        /// Cells along the longest side of the body.
        cells: usize = 80, 8..=300;
        /// Sum of opacities above which a cell is solid: 2026-11-23-segments.
        solid: f32 = 0.1, 0.0..=1e6;
        /// Ratio of the radius of a neck to that of the thinner of two parts below which they are separate; set before
        /// anything was measured: 2026-11-23-segments.
        neck: f32 = 0.7, 0.0..=1.0;
        /// Minimum depth of a part, cells: the shapes of thinner ones are those of the cells.
        min_depth: f32 = 3.0, 0.0..=300.0;
        /// Minimum fraction of a part that the ball with its maximum depth as radius fills; 0 for parts of any shape. Balls
        /// fill themselves, plumes 0.2 to 0.5, tubes and rings 0.1: 2026-11-23-segments.
        min_roundness: f64 = 0.6, 0.0..=1.0;
        /// Minimum depth of a part relative to the deepest one; a shallower peak is a bump on a part.
        min_relative_depth: f32 = 0.25, 0.0..=1.0;
    }
}

section! {
    /// `segment.nested.*`: objects of several colours, such as a core with its shell.
    NestedConfig, "nested" {
        /// Whether parts of different segments that are in contact with each other far more than with others are one
        /// object; if not, an object is everything connected with the clicked part: 2026-11-27-objects.
        join: bool = true;
        /// Minimum fraction of a part, by opacity, in contact with another of its object. In five plumes that touch, the
        /// lowest is 0.095, of a shell: 2026-11-27-objects.
        contact: f64 = 0.05, 0.0..=1.0;
        /// How many times as much of it as is in contact with any other part of that segment, minimum; there, 3.5.
        ahead: f64 = 2.0, 0.0..=1e6;
    }
}

section! {
    /// `segment.propagate.*`: a selection at other times, where Gaussians are visible that were not at the click.
    PropagateConfig, "propagate" {
        /// Whether such Gaussians join a selection.
        join: bool = true;
        /// Step between the times visited, in [0, 1], about that between 15 training times: 2026-11-23-segments.
        step: f64 = 1.0 / 15.0, 1e-3..=1.0;
        /// Parts of a step for Gaussians that overlap none after it; 0 for none. Visiting as many times for all selects no
        /// better and takes far longer: 2026-11-28-segments.
        parts: u32 = 4, 0..=1000;
        /// Number of nearest Gaussians, visible or not, among which each such Gaussian is joined to others in between.
        near: usize = 24, 1..=10_000;
        /// Distance up to which two Gaussians overlap, as a multiple of the sum of both largest standard deviations. From
        /// 0.7 to 1.5 there is no difference; at 2.5, what appears beside an object joins it too: 2026-11-23-segments.
        overlap: f32 = 1.0, 0.0..=100.0;
        /// Number of nearest visible Gaussians that vote.
        voters: usize = 6, 1..=1000;
        /// Whether scattered faint strays at the time of the click are treated as invisible then: fading is rarely complete.
        strays: bool = true;
    }
}
