//! Scene -> segments: which Gaussians belong together.
//!
//! Coarse by the colour of the [`material`], things with their skins ([`bodies`]), or the mean colour ([`coarse`]), fine by a field trained on 2D masks
//! ([`masks`], [`mod@fine`]); a [`segmentation`] is what the commands after it read, [`history`] takes changes of it
//! back; [`voxels`] carries labels back to a volume, [`dice`] compares label volumes; [`pick`] is what a click selects of
//! [`candidates`], [`levels`] are the parts and wholes there, [`pieces`] what hangs together, [`things`] and [`necks`] what
//! parts it, and [`carry`] takes a selection to other times; [`paint`] shows them in colour. Published methods to compare with are in
//! [`baselines`]. What segments do over time lives in `track`.

pub mod baselines;
pub mod bodies;
pub mod candidates;
pub mod carry;
pub mod click;
pub mod coarse;
pub mod colour;
mod depth;
pub mod dice;
pub mod fine;
pub mod history;
pub mod levels;
pub mod masks;
pub mod material;
pub mod material_groups;
pub mod necks;
pub mod paint;
pub mod palette;
pub mod pick;
pub mod pictures;
pub mod pieces;
pub mod segmentation;
pub mod things;
pub mod voxels;

#[cfg(test)]
pub(crate) mod balls;
