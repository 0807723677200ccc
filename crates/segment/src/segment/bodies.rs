//! Bodies that show several materials: a transfer function gives an object of high values a surface layer in the
//! colours of the lower values along its flank, and training mixes these in the Gaussians of its surface. By colour
//! alone, such a layer is a segment of its own or is grouped with distant objects of its hue.
//!
//! The connected pieces of each material are compared with the pieces of other materials that they touch. A surface
//! layer touches what it covers nearly everywhere and is not connected to the rest of its material. Layers that are
//! connected to it are told by their edge, see `surface_layers`.

use super::contacts::Contacts;
use super::pieces::{TouchRule, pieces};
use super::samples::{GaussianSample, Large, large};
use super::surface_layers;
use crate::config::types::SegmentConfig;
use crate::model::HostGaussians;
use crate::points::PointsError;
use crate::points::chunks::point;
use crate::points::neighbours::NeighbourGrid;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Joins surface layers to what they cover: `labels` `[M]` from 1, the materials of the Gaussians `shown` (`[M]`,
/// indices into `at`, all finite), are replaced by those of the bodies, each the material of its piece of highest
/// opacity. Bodies of the same two materials in about equal parts get one material, the one with more opacity over all
/// of them. Materials with pieces of many Gaussians are judged in `samples` of the scene, one after the other, the one
/// with the lowest label first; Gaussians of other materials that have joined them go along.
///
/// # Errors
/// If the arrays of `at` disagree, or points are too far apart.
///
/// # Panics
/// If an index is not below N.
pub fn join_surface_layers(
    at: &HostGaussians,
    shown: &[u32],
    labels: &mut [u32],
    config: &SegmentConfig,
) -> Result<(), PointsError> {
    let own = labels.to_vec();
    let materials: BTreeSet<u32> = own.iter().copied().filter(|label| *label > 0).collect();
    let mut all_large = Vec::new();
    for material in materials {
        all_large.extend(large(at, shown, &own, material, config)?);
    }
    let mut fixed = vec![false; shown.len()];
    all_large.iter().flat_map(|large| &large.rows).for_each(|&n| fixed[n] = true);
    join(at, shown, labels, &fixed, config)?;
    // each sees what those before it have joined, so that two materials of one body do not change places
    for large in &all_large {
        let before = labels.to_vec();
        let guests: Vec<usize> =
            (0..shown.len()).filter(|&n| labels[n] == large.material && own[n] != large.material).collect();
        vote(at, shown, (&before, labels), large, config)?;
        if !guests.is_empty() {
            relabel(at, shown, labels, &large.rows, &guests)?;
        }
    }
    Ok(())
}

/// Joins the Gaussians of a `large` material to what most samples join them to; `before` `[M]` are the labels in all
/// samples.
fn vote(
    at: &HostGaussians,
    shown: &[u32],
    (before, labels): (&[u32], &mut [u32]),
    large: &Large,
    config: &SegmentConfig,
) -> Result<(), PointsError> {
    let (material, samples) = (large.material, config.layers.votes);
    let mut votes = vec![vec![material; samples]; large.rows.len()];
    for number in 0..samples {
        let sample = GaussianSample::take(at, shown, large.thinning, (number, samples));
        let all: Vec<u32> = (0..sample.rows.len() as u32).collect();
        let mut joined: Vec<u32> = sample.rows.iter().map(|&n| before[n]).collect();
        join(&sample.at, &all, &mut joined, &vec![false; all.len()], config)?;
        let of_sample = sample.rows.iter().zip(&joined).filter(|(n, _)| large.rows.binary_search(n).is_ok());
        let known: Vec<(u32, u32)> = of_sample.map(|(&n, &label)| (shown[n], label)).collect();
        let nearest = label_of_nearest(at, &known)?;
        votes.par_iter_mut().zip(&large.rows).for_each(|(votes, &n)| {
            votes[number] = nearest(shown[n]).unwrap_or(material);
        });
    }
    for (votes, &n) in votes.into_iter().zip(&large.rows) {
        let count = |label: &u32| votes.iter().filter(|v| *v == label).count();
        labels[n] = votes.iter().copied().find(|v| 2 * count(v) > samples).unwrap_or(material);
    }
    Ok(())
}

/// Gives each of the Gaussians `rows` the label of the nearest of those `known`, both rows of `shown`.
fn relabel(
    at: &HostGaussians,
    shown: &[u32],
    labels: &mut [u32],
    known: &[usize],
    rows: &[usize],
) -> Result<(), PointsError> {
    let known: Vec<(u32, u32)> = known.iter().map(|&n| (shown[n], labels[n])).collect();
    let nearest = label_of_nearest(at, &known)?;
    for &n in rows {
        labels[n] = nearest(shown[n]).unwrap_or(labels[n]);
    }
    Ok(())
}

/// Joins surface layers at the density of the scene; the `fixed` `[M]` keep their labels.
fn join(
    at: &HostGaussians,
    shown: &[u32],
    labels: &mut [u32],
    fixed: &[bool],
    config: &SegmentConfig,
) -> Result<(), PointsError> {
    let opacity: Vec<f64> = shown.iter().map(|&i| f64::from(at.opacity_of(i as usize))).collect();
    let contacts = Contacts::among(at, shown, &config.contacts)?;
    let pieces = |labels: &mut [u32]| match config.layers.pieces {
        true => join_pieces(at, shown, (&contacts, &opacity), labels, fixed, config),
        false => Ok(()),
    };
    pieces(labels)?;
    if config.layers.connected {
        surface_layers::join(&contacts, &opacity, labels, fixed, config)?;
        // what lay outside of such a layer is left as pieces
        pieces(labels)?;
    }
    Ok(())
}

/// Joins connected pieces that are surface layers as a whole.
fn join_pieces(
    at: &HostGaussians,
    shown: &[u32],
    (contacts, opacity): (&Contacts, &[f64]),
    labels: &mut [u32],
    fixed: &[bool],
    config: &SegmentConfig,
) -> Result<(), PointsError> {
    let pieces = Pieces::of(at, shown, labels, (opacity, fixed), TouchRule::seen(&config.pieces))?;
    let config = &config.layers;
    let contacts = pieces.contacts(contacts, opacity);
    let touching = |from: usize, to: usize| contacts.get(&(from, to)).map_or(0.0, |w| w / pieces.weights[from]);
    // the body that each piece covers: the one of highest opacity among those that qualify
    let mut covers: Vec<Option<usize>> = vec![None; pieces.weights.len()];
    for &(skin, body) in contacts.keys() {
        let less = (pieces.weights[skin], skin) < (pieces.weights[body], body);
        let alone = pieces.weights[skin] <= config.minor * pieces.of_material[&pieces.materials[skin]];
        let is_skin = less
            && !pieces.fixed[skin]
            && touching(skin, body) >= config.contact
            && (alone || touching(body, skin) >= config.contact);
        let better = |other: usize| (pieces.weights[other], other) < (pieces.weights[body], body);
        if is_skin && covers[skin].is_none_or(better) {
            covers[skin] = Some(body);
        }
    }
    let body_of = |mut piece: usize| {
        // each piece is lighter than what it covers, so this terminates
        while let Some(next) = covers[piece] {
            piece = next;
        }
        piece
    };
    let bodies: Vec<usize> = (0..covers.len()).map(body_of).collect();
    let materials = pieces.materials_by_body(&bodies, config.mixed);
    let before = labels.to_vec();
    for (label, piece) in labels.iter_mut().zip(&pieces.labels) {
        if let Some(piece) = *piece {
            *label = materials[piece];
        }
    }
    for (&material, &whole) in &pieces.of_material {
        let of_it: Vec<usize> = (0..labels.len()).filter(|&n| before[n] == material).collect();
        let moved: f64 = of_it.iter().filter(|&&n| labels[n] != material).map(|&n| opacity[n]).sum();
        if moved == 0.0 {
            continue;
        }
        let all = moved >= config.all * whole;
        // those in no piece, as they are faint, go along with what is around them
        let follows = |n: &usize| labels[*n] == material && !fixed[*n] && (all || pieces.labels[*n].is_none());
        let (left, known): (Vec<usize>, Vec<usize>) = of_it.into_iter().partition(follows);
        if !left.is_empty() {
            relabel(at, shown, labels, &known, &left)?;
        }
    }
    Ok(())
}

/// Returns a function that maps a Gaussian of `at` to the label of the nearest of those `known` (index and label of
/// each); `None` if the Gaussian, or every known one, has a non-finite position.
///
/// # Errors
/// If the means are not rows of three.
pub(super) fn label_of_nearest(
    at: &HostGaussians,
    known: &[(u32, u32)],
) -> Result<impl Fn(u32) -> Option<u32>, PointsError> {
    let place = |i: u32| point(&at.means, i as usize);
    let grid = NeighbourGrid::adaptive(&known.iter().flat_map(|(i, _)| place(*i)).collect::<Vec<f32>>())?;
    Ok(move |i| grid.nearest(place(i), 1, None).first().map(|(n, _)| known[*n as usize].1))
}

/// The connected pieces of every material.
struct Pieces {
    /// `[M]`: the piece of each Gaussian; `None` without a material, if too transparent, or without a finite position.
    labels: Vec<Option<usize>>,
    /// `[P]`: the material of each piece.
    materials: Vec<u32>,
    /// `[P]`: the total opacity of each piece.
    weights: Vec<f64>,
    /// `[P]`: whether its Gaussians keep their labels.
    fixed: Vec<bool>,
    /// The total opacity of each material.
    of_material: BTreeMap<u32, f64>,
}

impl Pieces {
    fn of(
        at: &HostGaussians,
        shown: &[u32],
        materials: &[u32],
        (opacity, fixed): (&[f64], &[bool]),
        touch: TouchRule,
    ) -> Result<Self, PointsError> {
        let mut out = Self {
            labels: vec![None; shown.len()],
            materials: Vec::new(),
            weights: Vec::new(),
            fixed: Vec::new(),
            of_material: BTreeMap::new(),
        };
        for material in 1..=materials.iter().copied().max().unwrap_or(0) {
            let rows: Vec<usize> = (0..shown.len()).filter(|&n| materials[n] == material).collect();
            let members: Vec<u32> = rows.iter().map(|&n| shown[n]).collect();
            let found = pieces(at, &members, touch)?;
            let first = out.weights.len();
            out.fixed.resize(first + found.weights.len(), false);
            for (&n, &label) in rows.iter().zip(&found.labels) {
                out.labels[n] = label.checked_sub(1).map(|p| first + p as usize);
                if let Some(piece) = out.labels[n] {
                    out.fixed[piece] |= fixed[n];
                }
            }
            out.materials.extend(found.weights.iter().map(|_| material));
            out.weights.extend(&found.weights);
            out.of_material.insert(material, rows.iter().map(|&n| opacity[n]).sum());
        }
        Ok(out)
    }

    /// Returns the material of each piece's body, `[P]`; `bodies` `[P]` holds for each piece the piece of highest
    /// opacity of its body. From the ratio `mixed` on, the order of a body's two materials counts as chance.
    fn materials_by_body(&self, bodies: &[usize], mixed: f64) -> Vec<u32> {
        let mut parts: BTreeMap<usize, BTreeMap<u32, f64>> = BTreeMap::new();
        for (piece, &body) in bodies.iter().enumerate() {
            *parts.entry(body).or_default().entry(self.materials[piece]).or_default() += self.weights[piece];
        }
        let pairs: BTreeMap<usize, [u32; 2]> = parts
            .iter()
            .filter(|(body, _)| !self.fixed[**body])
            .filter_map(|(&body, p)| Some((body, mixed_pair(p, mixed)?)))
            .collect();
        // opacity of both materials of a pair, over all bodies of that pair
        let mut together: BTreeMap<[u32; 2], [f64; 2]> = BTreeMap::new();
        for (body, pair) in &pairs {
            let sums = together.entry(*pair).or_default();
            (0..2).for_each(|k| sums[k] += parts[body][&pair[k]]);
        }
        let of_pair = |pair: &[u32; 2]| pair[usize::from(together[pair][0] < together[pair][1])];
        bodies.iter().map(|body| pairs.get(body).map_or(self.materials[*body], of_pair)).collect()
    }

    /// Returns, by pair of pieces, the opacity of the first's Gaussians in contact with the second.
    fn contacts(&self, contacts: &Contacts, opacity: &[f64]) -> BTreeMap<(usize, usize), f64> {
        let mut out: BTreeMap<(usize, usize), f64> = BTreeMap::new();
        let mut met = Vec::new();
        for (n, own) in self.labels.iter().enumerate() {
            let Some(own) = *own else { continue };
            met.clear();
            met.extend(contacts.touching(n).iter().filter_map(|&k| self.labels[k]).filter(|piece| *piece != own));
            met.sort_unstable();
            met.dedup();
            met.iter().for_each(|&piece| *out.entry((own, piece)).or_default() += opacity[n]);
        }
        out
    }
}

/// Returns the two materials of highest opacity, ascending, if the ratio of their opacities is at least `ratio`; `parts`
/// holds the opacity of each material.
fn mixed_pair(parts: &BTreeMap<u32, f64>, ratio: f64) -> Option<[u32; 2]> {
    let mut by_weight: Vec<(u32, f64)> = parts.iter().map(|(&material, &weight)| (material, weight)).collect();
    by_weight.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    let &[(first, most), (second, less), ..] = by_weight.as_slice() else { return None };
    (less >= ratio * most).then(|| [first.min(second), first.max(second)])
}

#[cfg(test)]
#[path = "bodies_tests.rs"]
mod tests;
