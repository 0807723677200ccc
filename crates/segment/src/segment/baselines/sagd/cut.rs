//! Cuts back Gaussians that extend beyond a mask's edge: the long axis is shortened to its part inside.

use super::ChosenView;
use crate::model::HostGaussians;
use glam::{Quat, Vec3};
use rayon::prelude::*;

/// Distance of the ends of the long axis from the centre, in standard deviations.
const REACH: f32 = 3.0;
/// Factor by which the inner part of the axis is shortened further.
const SHRINK: f32 = 0.8;
/// Number of pieces in which an axis is sampled.
const PIECES: usize = 32;

/// Cuts each Gaussian back in one view after the other.
pub(super) fn cut(gaussians: &mut HostGaussians, chosen: &[ChosenView<'_>]) {
    let HostGaussians { means, log_scales, rotations, .. } = gaussians;
    let rows = means.par_chunks_exact_mut(3).zip(log_scales.par_chunks_exact_mut(3)).zip(rotations.par_chunks_exact(4));
    rows.for_each(|((mean, log_scale), rotation)| {
        for view in chosen {
            cut_one(mean, log_scale, rotation, view);
        }
    });
}

/// Reduces a Gaussian to its part inside the mask, if one end of its long axis is inside and the other is not: for an
/// inner fraction `r` of the axis, its scale there is multiplied by `0.8 r`, and its centre moves inwards by half the
/// rest.
fn cut_one(mean: &mut [f32], log_scale: &mut [f32], rotation: &[f32], view: &ChosenView<'_>) {
    let longest = (1..3).fold(0, |best, k| if log_scale[k] > log_scale[best] { k } else { best });
    let turn = Quat::from_xyzw(rotation[1], rotation[2], rotation[3], rotation[0]);
    let length = turn.length();
    // normalised as in rendering
    let turn = if length > 1e-12 { turn / length } else { Quat::IDENTITY };
    let centre = Vec3::from_slice(mean);
    let half = turn * Vec3::AXES[longest] * (REACH * log_scale[longest].exp());
    let label = |p: Vec3| view.label(p.to_array());
    let (inner, outer) = match (label(centre - half), label(centre + half)) {
        (Some(true), Some(false)) => (centre - half, centre + half),
        (Some(false), Some(true)) => (centre + half, centre - half),
        _ => return,
    };
    let axis = outer - inner;
    let still = |k: &usize| label(inner + axis * (*k as f32 / PIECES as f32)) == Some(true);
    // the edge lies between the last sample inside, the end itself at the earliest, and the next one
    let last = (1..PIECES).take_while(still).count();
    let share = (last as f32 + 0.5) / PIECES as f32;
    log_scale[longest] += (SHRINK * share).ln();
    (centre - axis * (0.5 * (1.0 - share))).write_to_slice(mean);
}
