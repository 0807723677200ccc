//! Scene -> segments: which Gaussians belong together.
//!
//! Coarse segments come from the colour of the [`material`], from objects with their surface layers ([`bodies`]) or
//! from the mean colour ([`coarse`]), fine ones from a field trained on 2D masks ([`masks`], [`mod@fine`]). A
//! [`segmentation`] is what later commands read; [`history`] undoes changes to it. [`place`] says where a segment is and
//! [`dice`] compares label volumes. [`pick`] determines what a click selects among [`candidates`],
//! [`levels`] finds the parts and wholes there, [`pieces`] the connected pieces, [`objects`] and [`necks`] split them,
//! and [`propagate`] extends a selection to other times. [`paint`] shows segments in colour. Published methods for
//! comparison are in [`baselines`]. What segments do over time is in `track`.

pub mod baselines;
pub mod bodies;
pub mod candidates;
pub mod click;
pub mod coarse;
pub mod colour;
mod contacts;
mod depth;
pub mod dice;
pub mod fine;
pub mod history;
pub mod levels;
pub mod masks;
pub mod material;
pub mod material_groups;
pub mod necks;
pub mod nested;
pub mod objects;
pub mod paint;
pub mod palette;
pub mod pick;
pub mod pictures;
pub mod pieces;
pub mod place;
pub mod propagate;
mod samples;
pub mod segmentation;
mod surface_layers;

#[doc(hidden)]
pub mod test_support;
