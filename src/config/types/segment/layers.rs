//! Contacts, connected pieces and surface layers.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

section! {
    /// `segment.contacts.*`: when two Gaussians are in contact, for surface layers and for objects of several colours.
    ContactsConfig, "contacts" {
        /// Number of nearest neighbours among which contacts are sought. The limits of `segment.layers` and
        /// `segment.nested` hold for this number.
        neighbours: usize = 12, 1..=256;
        /// Maximum distance, as a multiple of the sum of both largest standard deviations.
        reach: f32 = 1.0, 0.0..=100.0;
    }
}

section! {
    /// `segment.pieces.*`: connected pieces of Gaussians that touch, and the strays among them.
    PiecesConfig, "pieces" {
        /// Opacity from which a Gaussian is visible and so connects others; as `segment.colour.min_opacity`.
        min_opacity: f32 = 0.02, 0.0..=1.0;
        /// Maximum distance of two connected Gaussians, as a multiple of the sum of both largest standard deviations. At 2
        /// a thread breaks into dashes, from 3 on an object merges with what lies next to it: 2026-11-22-segments.
        reach: f32 = 2.5, 0.0..=100.0;
        /// Whether strays are removed from what a click selects by affinity, and from the parts of a split.
        strays: bool = true;
        /// Fraction of the largest piece's opacity below which another piece is a stray.
        stray: f64 = 0.05, 0.0..=1.0;
    }
}

section! {
    /// `segment.layers.*`: surface layers of other colours, which join what they cover.
    LayersConfig, "layers" {
        /// Whether surface layers join what they cover, instead of being segments of their own or parts of distant objects
        /// of their colour: 2026-11-25-segments.
        join: bool = true;
        /// Whether connected pieces that are layers as a whole do.
        pieces: bool = true;
        /// Minimum fraction of a piece, by opacity, in contact with another for it to join that one. Layers of trained
        /// scenes have 0.87 to 0.94; a body in a shell, or a core in a body, at most 0.37: 2026-11-25-segments.
        contact: f64 = 0.7, 0.0..=1.0;
        /// Fraction of its material, by opacity, up to which a piece may be a layer even if less than `contact` of what it
        /// covers touches it in turn.
        minor: f64 = 0.5, 0.0..=1.0;
        /// Fraction of a material, by opacity, that must be layers for all of it to be treated as such; above 1 for never.
        all: f64 = 0.9, 0.0..=2.0;
        /// Ratio of the opacity of an object's second material to that of its first from which the order of the two counts
        /// as chance, so that objects of the same two get one colour; above 1 for never.
        mixed: f64 = 0.5, 0.0..=2.0;
        /// Whether layers that are connected to the rest of their material do, told by their edge:
        /// 2026-11-27-surface-layers.
        connected: bool = true;
        /// Maximum share of a layer's neighbours of its own material that are outside of it. Layers of trained scenes have
        /// 0.06 to 0.22, sides of bodies 0.24 to 0.73: 2026-11-27-surface-layers.
        edge: f64 = 0.25, 0.0..=1.0;
        /// The same as a fraction of that of the side which the layer covers. Layers have 0.32 to 0.49 of it:
        /// 2026-11-27-surface-layers.
        edge_of_covered: f64 = 0.6, 0.0..=1e6;
        /// Minimum fraction of its material, by opacity, that a layer holds: the edge of a smaller region says little.
        small: f64 = 0.02, 0.0..=1.0;
        /// Maximum fraction, if the layer bends around what it covers.
        large: f64 = 0.7, 0.0..=1.0;
        /// Maximum fraction otherwise: more is the material itself, such as a small core. Layers of trained scenes hold up
        /// to 0.17, surfaces of cores from 0.46: 2026-11-29-neighbours.
        large_unbent: f64 = 0.3, 0.0..=1.0;
        /// Bend from which a region bends around something, in [-1, 1]. Layers have 0.09 to 0.69, surfaces of cores -0.76
        /// to 0.13: 2026-11-29-neighbours.
        bend: f64 = 0.15, -1.0..=1.0;
        /// Whether materials with pieces of many Gaussians are judged in samples of the scene, as contacts depend on how
        /// many Gaussians thick a layer is: 2026-11-28-best-scenes.
        samples: bool = true;
        /// Gaussians in a piece, weighted by size, on the scene with the most layers among those on which the limits above
        /// were set; samples have pieces of this size: 2026-11-28-best-scenes.
        sampled_size: f64 = 1300.0, 1.0..=1e12;
        /// How many times as many a piece must have for samples to be taken. Scenes on which the limits were set have such
        /// pieces too, and the same result with and without samples.
        far_more: f64 = 2.0, 1.0..=1e12;
        /// Number of samples that vote; in a single one, what is near a limit may fall on either side of it by chance.
        votes: usize = 5, 1..=99;
    }
}
