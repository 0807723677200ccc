//! Groups Gaussians by material: material colours (see `material`) are averaged over similar neighbours, the modes of
//! their density become groups, and neighbours vote on each Gaussian. Outliers and names are handled elsewhere.

use super::material::{Materials, from_plane, to_plane, to_rgb};
use crate::points::PointsError;
use crate::points::chunks::map_chunks;
use crate::points::modes::{ModeConfig, modes, valleys};
use centre::{Centre, Members};

mod centre;
mod number;

/// Number of neighbours that a Gaussian is averaged with and that vote on it.
const NEIGHBOURS: usize = 12;
/// A Gaussian's neighbours; its own index fills missing places.
pub type Neighbours = [u32; NEIGHBOURS];
/// Number of times that colours are averaged over similar neighbours.
const ROUNDS: usize = 3;
/// Rank, from dark to bright, of the neighbour whose brightness is used: shading only darkens, and outliers are few.
const LIT: usize = NEIGHBOURS * 5 / 8;
/// Distance in the plane within which the colours of neighbours are averaged (standard deviation); touching materials
/// stay separate.
const SIMILARITY_WIDTH: f32 = 0.17;
/// Fraction of similar neighbours, by opacity, below which a Gaussian shows no material of its own, and how much more
/// make it count in full. A tenth of trained Gaussians have a colour unlike that of their material.
const SUPPORT: [f32; 2] = [0.1, 0.3];
/// Mode search in the plane of colours, see [`to_plane`], whose extent is +-0.85.
const PLANE: ModeConfig = ModeConfig { range: [-0.9, 0.9], bandwidth: 0.035, smallest: 0.006 };
/// Two hues are two materials unless the pass between them is higher than this fraction of the lower mode, see
/// [`modes`].
const PASS: f64 = 0.5;
/// The same for two chromas of one hue, which highlights and haze spread out.
const CHROMA_PASS: f64 = 0.35;
/// Difference of two hues below which they are one, radians.
const ONE_HUE: f32 = 0.35;
/// Chroma in the plane below which there is no clear hue.
const NO_HUE: f32 = 0.12;
/// Chroma in the plane below which colours count as grey; lightness separates greys where its density has a clear
/// valley.
const GREY: f32 = 0.2;
/// Valley search in the natural logarithm of brightness under full light.
const LIGHT: ModeConfig = ModeConfig { range: [-3.0, 0.1], bandwidth: 0.04, smallest: 0.05 };
/// Maximum density in a valley of lightness, as a fraction of the lower of the peaks beside it.
const LIGHT_PASS: f64 = 0.25;
/// Brightness below which all colours count as equally dark.
const DARKEST: f32 = 0.05;
/// Standard deviation of the weight of a vote over the distance to a material in the plane.
const VOTE_WIDTH: f32 = 0.12;
/// Distance in the plane from every material beyond which a mode belongs to none of them.
const UNKNOWN: f32 = 0.2;
/// Minimum fraction of the total weight for a material that no Gaussian shows at the chosen time.
const UNSEEN: f64 = 0.05;
/// Weight of a Gaussian's own vote relative to that of all its neighbours.
const OWN_VOTE: f32 = 3.0;
/// Number of materials that each Gaussian votes for, the nearest ones.
const CANDIDATES: usize = 4;

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
}

impl MaterialGroups {
    /// Adds the materials that only Gaussians of other times show: M other Gaussians with their `neighbours` `[M]`, the
    /// colours `of` and the `opacity` `[M]` of a time at which they are visible. Those on a mode of the joint density
    /// of all colours that is far from every material form a new one.
    ///
    /// # Errors
    /// Slices of the wrong length.
    pub fn add_unseen(
        &mut self,
        neighbours: &[Neighbours],
        of: &Materials,
        opacity: &[f32],
    ) -> Result<(), PointsError> {
        let smooth = Smooth::new(of, opacity, neighbours);
        let weights = smooth.weights();
        let all: Vec<f32> = self.smooth.plane.iter().chain(&smooth.plane).flatten().copied().collect();
        let all_weights = [&self.weights[..], &weights].concat();
        let found = modes(&all, &all_weights, &PLANE, pass)?;
        let total: f64 = all_weights.iter().map(|w| f64::from(*w)).sum();
        let labels = &found.labels[self.weights.len()..];
        let shown = self.centres.len();
        for (label, peak) in (1..).zip(found.peaks) {
            let rows: Vec<u32> = (0..).zip(labels).filter(|(_, l)| **l == label).map(|(i, _)| i).collect();
            let mass: f64 = rows.iter().map(|&i| f64::from(weights[i as usize])).sum();
            let unknown = |c: &Centre| c.squared_in_plane(peak) > UNKNOWN * UNKNOWN;
            if mass > 0.0 && mass >= UNSEEN * total && self.centres[..shown].iter().all(unknown) {
                let centre = Centre::of(&Members { rows, light: 0.0 }, &smooth, &weights);
                self.colours.extend(to_rgb(from_plane(centre.shown), centre.brightest));
                self.centres.push(centre);
            }
        }
        Ok(())
    }

    /// Returns the label of the nearest material for each of M other Gaussians, `[M]`; 0 if there is no material.
    #[must_use]
    pub fn nearest(&self, of: &Materials) -> Vec<u32> {
        (0..of.full.len())
            .map(|i| {
                let chroma = [of.chroma[2 * i], of.chroma[2 * i + 1]];
                nearest_label(&self.centres, to_plane(chroma), light(of.full[i]))
            })
            .collect()
    }
}

/// Groups M Gaussians with their `neighbours` `[M]`, the colours `of` and `opacity` `[M]`, all finite, by material.
///
/// Each colour is averaged over similar ones among the neighbours, which reduces noise and identifies Gaussians
/// whose colour their neighbours do not share. Materials are the modes of the density of colours, weighted by opacity,
/// certainty and similarity to the neighbours; greys are separated by lightness where that leaves a clear gap. With
/// `clusters`, groups are joined or halved until there are that many. Each Gaussian then gets the material that it and
/// its neighbours vote for. `uniform` returns numbers in `[0, 1)` and is used only for halving. The result is
/// bit-identical for any number of threads.
///
/// # Errors
/// Slices of the wrong length; `clusters` of 0.
pub fn group(
    neighbours: &[Neighbours],
    of: &Materials,
    opacity: &[f32],
    clusters: Option<usize>,
    uniform: &mut impl FnMut() -> f32,
) -> Result<MaterialGroups, PointsError> {
    if clusters == Some(0) {
        return Err(PointsError::Setting { field: "clusters", value: "0".into(), want: "at least 1" });
    }
    let smooth = Smooth::new(of, opacity, neighbours);
    let weights = smooth.weights();
    let mut parts = parts(&smooth, &weights)?;
    if parts.is_empty() && !opacity.is_empty() {
        // no colour is reliable: everything is one material
        parts.push(Members { rows: (0..opacity.len() as u32).collect(), light: 0.0 });
    }
    if let Some(wanted) = clusters {
        parts = number::exactly(parts, wanted, &smooth, &weights, uniform)?;
    }
    let centres: Vec<Centre> = parts.iter().map(|p| Centre::of(p, &smooth, &weights)).collect();
    let mut labels = vote(&smooth, &centres, neighbours);
    if clusters.is_some() && (1..=centres.len() as u32).any(|k| !labels.contains(&k)) {
        // interleaved halves are voted away, but were requested
        labels = per_row(labels.len(), |i| nearest_label(&centres, smooth.plane[i], smooth.light[i]));
    }
    let order = by_opacity(&labels, opacity, centres.len());
    let mut place = vec![0; centres.len() + 1];
    (1..).zip(&order).for_each(|(new, &old)| place[old + 1] = new);
    labels.iter_mut().for_each(|l| *l = place[*l as usize]);
    let centres: Vec<Centre> = order.into_iter().map(|k| centres[k].clone()).collect();
    let colours = centres.iter().flat_map(|c| to_rgb(from_plane(c.shown), c.brightest)).collect();
    Ok(MaterialGroups { labels, colours, centres, smooth, weights })
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
    fn new(of: &Materials, opacity: &[f32], neighbours: &[Neighbours]) -> Self {
        let strength: Vec<f32> = opacity.iter().zip(&of.certainty).map(|(o, c)| o * c).collect();
        let mut plane: Vec<[f32; 2]> = of.chroma.chunks_exact(2).map(|c| to_plane([c[0], c[1]])).collect();
        let mut support = Vec::new();
        for _ in 0..ROUNDS {
            let next = per_row(plane.len(), |i| like_mean(i, &plane, &strength, &neighbours[i]));
            (plane, support) = next.into_iter().unzip();
        }
        let around = |i: usize| {
            let mut of_all = neighbours[i].map(|j| of.full[j as usize]);
            light(*of_all.select_nth_unstable_by(LIT, f32::total_cmp).1)
        };
        let light = per_row(plane.len(), around);
        Self { plane, light, support, certainty: of.certainty.clone(), strength }
    }

    /// Weight of each Gaussian in the search for materials, `[M]`.
    fn weights(&self) -> Vec<f32> {
        let share = |s: f32| ((s - SUPPORT[0]) / SUPPORT[1]).clamp(0.0, 1.0);
        self.strength.iter().zip(&self.support).map(|(w, s)| w * share(*s)).collect()
    }
}

/// The mean of a colour and those of similar neighbours, and the fraction of neighbours that are similar.
fn like_mean(i: usize, plane: &[[f32; 2]], strength: &[f32], neighbours: &[u32]) -> ([f32; 2], f32) {
    let own = f64::from(strength[i]);
    let (mut sum, mut like, mut all) = (plane[i].map(|v| own * f64::from(v)), 0.0, 0.0);
    for &j in neighbours {
        let j = j as usize;
        let square = (plane[j][0] - plane[i][0]).powi(2) + (plane[j][1] - plane[i][1]).powi(2);
        let weight = f64::from(strength[j] * (-0.5 * square / (SIMILARITY_WIDTH * SIMILARITY_WIDTH)).exp());
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

fn light(full: f32) -> f32 {
    full.max(DARKEST).ln()
}

/// The modes of the density of colours, with greys separated by lightness.
fn parts(smooth: &Smooth, weights: &[f32]) -> Result<Vec<Members>, PointsError> {
    let flat: Vec<f32> = smooth.plane.iter().flatten().copied().collect();
    let found = modes(&flat, weights, &PLANE, pass)?;
    let mut parts = Vec::new();
    for (label, peak) in (1..).zip(&found.peaks) {
        let rows: Vec<u32> = (0..weights.len() as u32).filter(|&i| found.labels[i as usize] == label).collect();
        let cuts = if peak[0].hypot(peak[1]) < GREY {
            let of_rows = |v: &[f32]| rows.iter().map(|&i| v[i as usize]).collect::<Vec<f32>>();
            valleys(&of_rows(&smooth.light), &of_rows(weights), &LIGHT, LIGHT_PASS)?
        } else {
            Vec::new()
        };
        let light = if cuts.is_empty() { 0.0 } else { centre::LIGHTNESS };
        for k in 0..=cuts.len() {
            let within = |i: &u32| cuts.partition_point(|c| *c <= smooth.light[*i as usize]) == k;
            parts.push(Members { rows: rows.iter().copied().filter(within).collect(), light });
        }
    }
    Ok(parts)
}

/// Maximum height of the pass between two peaks for them to stay two materials.
fn pass(a: [f32; 2], b: [f32; 2]) -> f64 {
    let turn = (a[0] * b[1] - a[1] * b[0]).atan2(a[0] * b[0] + a[1] * b[1]).abs();
    let clear = a[0].hypot(a[1]).min(b[0].hypot(b[1])) > NO_HUE;
    if clear && turn < ONE_HUE { CHROMA_PASS } else { PASS }
}

/// The nearest materials with their squared distances in units of [`VOTE_WIDTH`], nearest first.
fn candidates(centres: &[Centre], plane: [f32; 2], light: f32) -> impl Iterator<Item = (usize, f32)> {
    let mut nearest: Vec<(usize, f32)> = Vec::with_capacity(CANDIDATES + 1);
    for (k, centre) in centres.iter().enumerate() {
        let distance = centre.squared(plane, light) / (VOTE_WIDTH * VOTE_WIDTH);
        let at = nearest.partition_point(|&(_, d)| d <= distance);
        if at < CANDIDATES {
            nearest.insert(at, (k, distance));
            nearest.truncate(CANDIDATES);
        }
    }
    nearest.into_iter()
}

/// The label of the nearest material, from 1; 0 if there is none.
fn nearest_label(centres: &[Centre], plane: [f32; 2], light: f32) -> u32 {
    candidates(centres, plane, light).next().map_or(0, |(k, _)| k as u32 + 1)
}

/// The material of each Gaussian, `[M]` from 1, by its own colour and those of its neighbours.
fn vote(smooth: &Smooth, centres: &[Centre], neighbours: &[Neighbours]) -> Vec<u32> {
    let votes: Vec<Vec<(usize, f32)>> = per_row(neighbours.len(), |i| {
        candidates(centres, smooth.plane[i], smooth.light[i]).map(|(k, d)| (k, (-0.5 * d).exp())).collect()
    });
    per_row(neighbours.len(), |i| {
        let own = OWN_VOTE * smooth.certainty[i] * (smooth.support[i] / SUPPORT[1]).min(1.0);
        let all: f32 = neighbours[i].iter().map(|&j| smooth.strength[j as usize]).sum();
        // its own nearest material comes first and wins where no vote counts
        let mut counts: Vec<(usize, f32)> = votes[i].iter().map(|&(k, sure)| (k, own * sure)).collect();
        for &j in neighbours[i].iter().filter(|_| all > 0.0) {
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
