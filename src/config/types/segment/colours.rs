//! Colours: which Gaussians are of one material.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Space in which colours are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum ColourSpace {
    /// The material's colour: hue first, then chroma, regardless of shading.
    Material,
    /// The mean colour as displayed, as in the paper; shading forms groups as well.
    Rgb,
    /// The mean colour in CIE Lab, with perceptual distances.
    Lab,
}

section! {
    /// `segment.colour.*`: segments by colour.
    ColourConfig, "colour" {
        /// Space in which colours are compared: `material` (hue first, regardless of shading), or the mean colour as in
        /// the paper, `rgb` or `lab`. `material` found more on all scenes: 2026-11-22-segments.
        space: ColourSpace = ColourSpace::Material;
        /// Number of colours; 0 suggests it from the data. With a number, surface layers are not joined.
        clusters: usize = 0, 0..=10_000;
        /// Opacity below which a Gaussian defines no colour at the chosen time; those less opaque at all times get no
        /// segment.
        min_opacity: f32 = 0.02, 0.0..=1.0;
        /// Whether Gaussians with few neighbours of their colour are removed.
        outliers: bool = true;
        /// Radius in which these neighbours are counted, scene units; 0 for six times the median distance to the nearest,
        /// in which a point scattered on a surface has about 25.
        outlier_radius: f32 = 0.0, 0.0..=1e9;
        /// Number of neighbours below which a Gaussian is removed; half of the least on a surface.
        outlier_neighbours: u32 = 8, 0..=1_000_000;
        /// Whether those stay that form a connected piece of more than that number, as threads do.
        threads: bool = true;
    }
}

section! {
    /// `segment.material.*`: the colour of a Gaussian's material, by the dichromatic model, over directions of the sphere.
    MaterialConfig, "material" {
        /// Number of times that directions which do not fit the material are given less weight; 0 for never.
        passes: usize = 2, 0..=100;
        /// Excess of a colour beyond [0, 1] at which the weight of its direction is halved: the harmonics leave that range
        /// where no view constrains them.
        beyond: f32 = 0.1, 1e-6..=1e6;
        /// Distance of a colour from the dichromatic plane at which the weight of its direction is halved.
        off_plane: f32 = 0.15, 1e-6..=1e6;
        /// Brightness in [0, 1] at which the certainty of a colour is one half; the noise of trained harmonics is of this
        /// size.
        dim: f32 = 0.1, 0.0..=1.0;
        /// Lower bound on the brightness that chroma is divided by.
        dark: f32 = 0.05, 1e-6..=1.0;
        /// Quantile of the brightness that stands for full light; brighter directions show highlights.
        full_light: f64 = 0.9, 0.0..=1.0;
        /// Chroma beyond which a step of chroma counts less than one of hue: highlights, haze and translucent shells in
        /// front change chroma first. A large one compares both alike.
        knee: f32 = 0.12, 1e-6..=1e6;
    }
}

section! {
    /// `segment.groups.*`: groups of materials, the modes of the density of their colours. Distances are in the plane of
    /// colours, which reaches to 0.85.
    GroupsConfig, "groups" {
        /// Number of neighbours that a Gaussian is averaged with and that vote on it.
        neighbours: usize = 12, 1..=256;
        /// Whether neighbours are those that stay near over all times, rather than those of the chosen time, among which
        /// some only pass by: 2026-11-29-neighbours.
        over_time: bool = true;
        /// Number of times that colours are averaged over similar neighbours; 0 for never.
        rounds: usize = 3, 0..=100;
        /// Quantile of the neighbours' brightness that is used: shading only darkens, and outliers are few.
        lit: f32 = 0.625, 0.0..=1.0;
        /// Standard deviation of the distance within which neighbours are averaged; touching materials stay separate.
        similarity: f32 = 0.17, 1e-6..=1e6;
        /// Fraction of similar neighbours, by opacity, below which a Gaussian shows no material of its own. A tenth of
        /// trained Gaussians have a colour unlike that of their material.
        support: f32 = 0.1, 0.0..=1.0;
        /// How much more makes it count in full.
        full_support: f32 = 0.3, 1e-6..=1.0;
        /// Bandwidth of the density of colours, a standard deviation.
        bandwidth: f32 = 0.035, 1e-3..=1.0;
        /// Minimum fraction of all weight in a material.
        smallest: f64 = 0.006, 0.0..=1.0;
        /// Two hues are two materials unless the pass between them is higher than this fraction of the lower mode.
        pass: f64 = 0.5, 0.0..=1.0;
        /// The same for two chromas of one hue, which highlights and haze spread out.
        chroma_pass: f64 = 0.35, 0.0..=1.0;
        /// Difference of two hues below which they are one, radians.
        one_hue: f32 = 0.35, 0.0..=3.2;
        /// Chroma in the plane below which there is no clear hue.
        no_hue: f32 = 0.12, 0.0..=1.0;
        /// Whether greys are separated by lightness where its density has a clear valley.
        greys: bool = true;
        /// Chroma in the plane below which colours count as grey.
        grey: f32 = 0.2, 0.0..=1.0;
        /// Bandwidth of the density of lightness, in the natural logarithm of brightness under full light.
        light_bandwidth: f32 = 0.04, 1e-3..=1.0;
        /// Minimum fraction of a grey's weight on each side of a valley.
        light_smallest: f64 = 0.05, 0.0..=1.0;
        /// Maximum density in a valley of lightness, as a fraction of the lower of the peaks beside it.
        light_pass: f64 = 0.25, 0.0..=1.0;
        /// Brightness below which all colours count as equally dark.
        darkest: f32 = 0.05, 1e-6..=1.0;
        /// Whether neighbours vote on the material of each Gaussian, instead of its own colour alone.
        vote: bool = true;
        /// Standard deviation of the weight of a vote over the distance to a material.
        vote_width: f32 = 0.12, 1e-6..=1e6;
        /// Weight of a Gaussian's own vote, relative to that of all its neighbours.
        own_vote: f32 = 3.0, 0.0..=1e6;
        /// Number of materials that each Gaussian votes for, the nearest ones.
        candidates: usize = 4, 1..=256;
        /// Whether materials that no Gaussian shows at the chosen time form segments of their own.
        unseen: bool = true;
        /// Distance from every material beyond which a mode belongs to none of them.
        unknown: f32 = 0.2, 0.0..=1e6;
        /// Minimum fraction of all weight in a material that no Gaussian shows at the chosen time.
        unseen_share: f64 = 0.05, 0.0..=1.0;
        /// Distance that a difference of one in the logarithm of brightness counts as, where lightness separates two
        /// materials.
        lightness: f32 = 0.6, 0.0..=1e6;
        /// The same when a group is halved to reach a given number: shading changes lightness more than chroma.
        halving: f32 = 0.2, 1e-6..=1e6;
        /// Minimum weight of a half, as a fraction of an even share of all: a few outliers are not a half.
        min_half: f64 = 0.1, 0.0..=1.0;
        /// Quantile of the brightness and chroma of a material at which its colour under full light is read: shading
        /// darkens, and highlights and haze reduce chroma.
        clear: f64 = 0.7, 0.0..=1.0;
    }
}
