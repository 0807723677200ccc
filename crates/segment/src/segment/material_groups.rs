//! Groups Gaussians by material: material colours (see `material`) are averaged over similar neighbours, the modes of
//! their density become groups, and neighbours vote on each Gaussian. Outliers and names are handled elsewhere.

use super::material::{Materials, from_plane, to_plane, to_rgb};
use crate::config::types::SegmentConfig;
use crate::config::types::segment::GroupsConfig;
use crate::points::PointsError;
use crate::points::chunks::map_chunks;
use crate::points::modes::{ModeConfig, modes, valleys};
use crate::points::nearest_rows::NearestRows;
use centre::{Centre, Members};

mod centre;
mod number;

/// Extent of the plane of colours in which modes are sought, see [`to_plane`]: no colour is beyond 0.85.
const PLANE: [f32; 2] = [-0.9, 0.9];
/// Extent of the natural logarithm of brightness in which valleys are sought, from the darkest to beyond full light.
const LIGHT: [f32; 2] = [-3.0, 0.1];

/// Gaussians grouped by material, the result of [`group`].
#[derive(Debug, Clone)]
pub struct MaterialGroups {
    /// `[M]`: 1 + row of the material, in descending order of total opacity; 0 if there is no material at all.
    pub labels: Vec<u32>,
    /// `[K, 3]`: each material's colour under full light, in `[0, 1]`.
    pub colours: Vec<f32>,
    centres: Vec<Centre>,
    smooth: Smooth,
    weights: Vec<f32>,
    config: GroupsConfig,
    knee: f32,
}

impl MaterialGroups {
    /// Adds the materials that only Gaussians of other times show: M other Gaussians with their `neighbours` `[M, k]`, the
    /// colours `of` and the `opacity` `[M]` of a time at which they are visible. Those on a mode of the joint density
    /// of all colours that is far from every material form a new one.
    ///
    /// # Errors
    /// Slices of the wrong length.
    pub fn add_unseen(&mut self, neighbours: &NearestRows, of: &Materials, opacity: &[f32]) -> Result<(), PointsError> {
        let (config, knee) = (&self.config, self.knee);
        let smooth = Smooth::new(of, opacity, neighbours, (config, knee));
        let weights = smooth.weights(config);
        let all: Vec<f32> = self.smooth.plane.iter().chain(&smooth.plane).flatten().copied().collect();
        let all_weights = [&self.weights[..], &weights].concat();
        let found = modes(&all, &all_weights, &plane(config), pass(config))?;
        let total: f64 = all_weights.iter().map(|w| f64::from(*w)).sum();
        let labels = &found.labels[self.weights.len()..];
        let shown = self.centres.len();
        for (label, peak) in (1..).zip(found.peaks) {
            let rows: Vec<u32> = (0..).zip(labels).filter(|(_, l)| **l == label).map(|(i, _)| i).collect();
            let mass: f64 = rows.iter().map(|&i| f64::from(weights[i as usize])).sum();
            let unknown = |c: &Centre| c.squared_in_plane(peak) > config.unknown * config.unknown;
            if mass > 0.0 && mass >= config.unseen_share * total && self.centres[..shown].iter().all(unknown) {
                let centre = Centre::weighted(&Members { rows, light: 0.0 }, &smooth, &weights, config.clear);
                self.colours.extend(to_rgb(from_plane(centre.shown, knee), centre.brightest));
                self.centres.push(centre);
            }
        }
        Ok(())
    }

    /// Returns the label of the nearest material for each of M other Gaussians, `[M]`; 0 if there is no material.
    pub fn nearest(&self, of: &Materials) -> Vec<u32> {
        (0..of.full.len())
            .map(|i| {
                let chroma = [of.chroma[2 * i], of.chroma[2 * i + 1]];
                let light = light(of.full[i], &self.config);
                nearest_label(&self.centres, to_plane(chroma, self.knee), light, &self.config)
            })
            .collect()
    }
}

/// Groups M Gaussians with their `neighbours` `[M, k]`, the colours `of` and `opacity` `[M]`, all finite, by material.
///
/// Each colour is averaged over similar ones among the neighbours, which reduces noise and identifies Gaussians
/// whose colour their neighbours do not share. Materials are the modes of the density of colours, weighted by opacity,
/// certainty and similarity to the neighbours; greys are separated by lightness where that leaves a clear gap. With a
/// number of colours, groups are joined or halved until there are that many. Each Gaussian then gets the material that it and
/// its neighbours vote for. `uniform` returns numbers in `[0, 1)` and is used only for halving. The result is
/// bit-identical for any number of threads.
///
/// # Errors
/// Slices of the wrong length.
pub fn group(
    neighbours: &NearestRows,
    of: &Materials,
    opacity: &[f32],
    config: &SegmentConfig,
    uniform: &mut impl FnMut() -> f32,
) -> Result<MaterialGroups, PointsError> {
    let (clusters, knee) = (config.colour.clusters, config.material.knee);
    let config = &config.groups;
    let smooth = Smooth::new(of, opacity, neighbours, (config, knee));
    let weights = smooth.weights(config);
    let mut parts = parts(&smooth, &weights, config)?;
    if parts.is_empty() && !opacity.is_empty() {
        // no colour is reliable: everything is one material
        parts.push(Members { rows: (0..opacity.len() as u32).collect(), light: 0.0 });
    }
    if clusters > 0 {
        parts = number::exactly(parts, clusters, &smooth, &weights, (config, uniform))?;
    }
    let centres: Vec<Centre> = parts.iter().map(|p| Centre::weighted(p, &smooth, &weights, config.clear)).collect();
    let by_itself =
        || per_row(smooth.plane.len(), |i| nearest_label(&centres, smooth.plane[i], smooth.light[i], config));
    let mut labels = if config.vote { vote(&smooth, &centres, neighbours, config) } else { by_itself() };
    if clusters > 0 && (1..=centres.len() as u32).any(|k| !labels.contains(&k)) {
        // interleaved halves are voted away, but were requested
        labels = by_itself();
    }
    let order = by_opacity(&labels, opacity, centres.len());
    let mut place = vec![0; centres.len() + 1];
    (1..).zip(&order).for_each(|(new, &old)| place[old + 1] = new);
    labels.iter_mut().for_each(|l| *l = place[*l as usize]);
    let centres: Vec<Centre> = order.into_iter().map(|k| centres[k].clone()).collect();
    let colours = centres.iter().flat_map(|c| to_rgb(from_plane(c.shown, knee), c.brightest)).collect();
    Ok(MaterialGroups { labels, colours, centres, smooth, weights, config: config.clone(), knee })
}

/// Colours averaged over similar neighbours.
#[derive(Debug, Clone)]
struct Smooth {
    /// `[M]`, in the plane of [`to_plane`].
    plane: Vec<[f32; 2]>,
    /// `[M]`: logarithm of the brightness of the neighbours under full light.
    light: Vec<f32>,
    /// `[M]`: fraction of similar neighbours, by opacity and certainty.
    support: Vec<f32>,
    /// `[M]`
    certainty: Vec<f32>,
    /// `[M]`: opacity times certainty.
    strength: Vec<f32>,
}

impl Smooth {
    fn new(of: &Materials, opacity: &[f32], neighbours: &NearestRows, (config, knee): (&GroupsConfig, f32)) -> Self {
        let strength: Vec<f32> = opacity.iter().zip(&of.certainty).map(|(o, c)| o * c).collect();
        let mut plane: Vec<[f32; 2]> = of.chroma.chunks_exact(2).map(|c| to_plane([c[0], c[1]], knee)).collect();
        let mut support = vec![1.0; plane.len()];
        for _ in 0..config.rounds {
            let next =
                per_row(plane.len(), |i| like_mean(i, &plane, &strength, (neighbours.row(i), config.similarity)));
            (plane, support) = next.into_iter().unzip();
        }
        let around = |i: usize| {
            let mut of_all: Vec<f32> = neighbours.row(i).iter().map(|&j| of.full[j as usize]).collect();
            // fewer for a rank of all
            let rank = ((of_all.len() as f32 * config.lit) as usize).min(of_all.len() - 1);
            light(*of_all.select_nth_unstable_by(rank, f32::total_cmp).1, config)
        };
        let light = per_row(plane.len(), around);
        Self { plane, light, support, certainty: of.certainty.clone(), strength }
    }

    /// Weight of each Gaussian in the search for materials, `[M]`.
    fn weights(&self, config: &GroupsConfig) -> Vec<f32> {
        let share = |s: f32| ((s - config.support) / config.full_support).clamp(0.0, 1.0);
        self.strength.iter().zip(&self.support).map(|(w, s)| w * share(*s)).collect()
    }
}

/// The mean of a colour and those of similar neighbours, and the fraction of neighbours that are similar.
fn like_mean(i: usize, plane: &[[f32; 2]], strength: &[f32], (neighbours, width): (&[u32], f32)) -> ([f32; 2], f32) {
    let own = f64::from(strength[i]);
    let (mut sum, mut like, mut all) = (plane[i].map(|v| own * f64::from(v)), 0.0, 0.0);
    for &j in neighbours {
        let j = j as usize;
        let square = (plane[j][0] - plane[i][0]).powi(2) + (plane[j][1] - plane[i][1]).powi(2);
        let weight = f64::from(strength[j] * (-0.5 * square / (width * width)).exp());
        (0..2).for_each(|a| sum[a] += weight * f64::from(plane[j][a]));
        like += weight;
        all += f64::from(strength[j]);
    }
    let mean = if own + like > 0.0 { sum.map(|v| (v / (own + like)) as f32) } else { plane[i] };
    (mean, if all > 0.0 { (like / all) as f32 } else { 0.0 })
}

fn per_row<T: Send>(count: usize, work: impl Fn(usize) -> T + Sync) -> Vec<T> {
    map_chunks(count, |range| range.map(&work).collect::<Vec<T>>()).into_iter().flatten().collect()
}

fn light(full: f32, config: &GroupsConfig) -> f32 {
    full.max(config.darkest).ln()
}

/// The search for modes of the density of colours.
fn plane(config: &GroupsConfig) -> ModeConfig {
    ModeConfig { range: PLANE, bandwidth: config.bandwidth, smallest: config.smallest }
}

/// The modes of the density of colours, with greys separated by lightness.
fn parts(smooth: &Smooth, weights: &[f32], config: &GroupsConfig) -> Result<Vec<Members>, PointsError> {
    let flat: Vec<f32> = smooth.plane.iter().flatten().copied().collect();
    let found = modes(&flat, weights, &plane(config), pass(config))?;
    let lightness = ModeConfig { range: LIGHT, bandwidth: config.light_bandwidth, smallest: config.light_smallest };
    let mut parts = Vec::new();
    for (label, peak) in (1..).zip(&found.peaks) {
        let rows: Vec<u32> = (0..weights.len() as u32).filter(|&i| found.labels[i as usize] == label).collect();
        let cuts = if config.greys && peak[0].hypot(peak[1]) < config.grey {
            let of_rows = |v: &[f32]| rows.iter().map(|&i| v[i as usize]).collect::<Vec<f32>>();
            valleys(&of_rows(&smooth.light), &of_rows(weights), &lightness, config.light_pass)?
        } else {
            Vec::new()
        };
        let light = if cuts.is_empty() { 0.0 } else { config.lightness };
        for k in 0..=cuts.len() {
            let within = |i: &u32| cuts.partition_point(|c| *c <= smooth.light[*i as usize]) == k;
            parts.push(Members { rows: rows.iter().copied().filter(within).collect(), light });
        }
    }
    Ok(parts)
}

/// Returns the maximum height of the pass between two peaks for them to stay two materials.
fn pass(config: &GroupsConfig) -> impl Fn([f32; 2], [f32; 2]) -> f64 {
    move |a, b| {
        let turn = (a[0] * b[1] - a[1] * b[0]).atan2(a[0] * b[0] + a[1] * b[1]).abs();
        let clear = a[0].hypot(a[1]).min(b[0].hypot(b[1])) > config.no_hue;
        if clear && turn < config.one_hue { config.chroma_pass } else { config.pass }
    }
}

/// The nearest materials with their squared distances in units of the width of a vote, nearest first.
fn candidates(
    centres: &[Centre],
    plane: [f32; 2],
    light: f32,
    config: &GroupsConfig,
) -> impl Iterator<Item = (usize, f32)> {
    let (width, count) = (config.vote_width, config.candidates);
    let mut nearest: Vec<(usize, f32)> = Vec::with_capacity(count + 1);
    for (k, centre) in centres.iter().enumerate() {
        let distance = centre.squared(plane, light) / (width * width);
        let at = nearest.partition_point(|&(_, d)| d <= distance);
        if at < count {
            nearest.insert(at, (k, distance));
            nearest.truncate(count);
        }
    }
    nearest.into_iter()
}

/// The label of the nearest material, from 1; 0 if there is none.
fn nearest_label(centres: &[Centre], plane: [f32; 2], light: f32, config: &GroupsConfig) -> u32 {
    candidates(centres, plane, light, config).next().map_or(0, |(k, _)| k as u32 + 1)
}

/// The material of each Gaussian, `[M]` from 1, by its own colour and those of its neighbours.
fn vote(smooth: &Smooth, centres: &[Centre], neighbours: &NearestRows, config: &GroupsConfig) -> Vec<u32> {
    let votes: Vec<Vec<(usize, f32)>> = per_row(smooth.plane.len(), |i| {
        candidates(centres, smooth.plane[i], smooth.light[i], config).map(|(k, d)| (k, (-0.5 * d).exp())).collect()
    });
    per_row(smooth.plane.len(), |i| {
        let own = config.own_vote * smooth.certainty[i] * (smooth.support[i] / config.full_support).min(1.0);
        let all: f32 = neighbours.row(i).iter().map(|&j| smooth.strength[j as usize]).sum();
        // its own nearest material comes first and wins where no vote counts
        let mut counts: Vec<(usize, f32)> = votes[i].iter().map(|&(k, sure)| (k, own * sure)).collect();
        for &j in neighbours.row(i).iter().filter(|_| all > 0.0) {
            let share = smooth.strength[j as usize] / all;
            for &(k, sure) in &votes[j as usize] {
                match counts.iter_mut().find(|(other, _)| *other == k) {
                    Some((_, count)) => *count += share * sure,
                    None => counts.push((k, share * sure)),
                }
            }
        }
        let mut best: Option<(usize, f32)> = None;
        for (k, count) in counts {
            if best.is_none_or(|(_, most)| count > most) {
                best = Some((k, count));
            }
        }
        best.map_or(0, |(k, _)| k as u32 + 1)
    })
}

/// Materials in descending order of the total opacity of their Gaussians.
fn by_opacity(labels: &[u32], opacity: &[f32], count: usize) -> Vec<usize> {
    let mut total = vec![0f64; count + 1];
    labels.iter().zip(opacity).for_each(|(l, o)| total[*l as usize] += f64::from(*o));
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|&a, &b| total[b + 1].total_cmp(&total[a + 1]).then(a.cmp(&b)));
    order
}

#[cfg(test)]
mod tests;
