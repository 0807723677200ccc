//! Surface layers that are connected to the rest of their material: where two objects meet, the layer of the one runs
//! into the body of the other, or into haze of its hue, so that the connected piece of the material is no layer.
//!
//! What is a layer is then told by its edge. The Gaussians of one material that are in contact with another are
//! connected regions. A layer is thin: nearly all neighbours of its own material are in it. Where two bodies meet, their
//! Gaussians in contact are only the side of a body, and have many neighbours behind them. A core in a body
//! may be all surface, but it holds most of its material, and does not bend around the body.

use super::contacts::Contacts;
use crate::config::types::SegmentConfig;
use crate::points::PointsError;
use crate::points::union_find::UnionFind;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Gives layers the material of what they cover. `labels` `[M]`, from 1, are the materials of the Gaussians whose
/// `contacts` are given, 0 for those without one; `opacity` `[M]`. The `fixed` `[M]` keep their material.
///
/// # Errors
/// As [`Contacts::among`], which has checked the same.
pub(super) fn join(
    contacts: &Contacts,
    opacity: &[f64],
    labels: &mut [u32],
    fixed: &[bool],
    config: &SegmentConfig,
) -> Result<(), PointsError> {
    let touched: Vec<u32> = (0..labels.len()).into_par_iter().map(|n| touched(contacts, opacity, labels, n)).collect();
    let regions = ContactRegions::of(contacts, opacity, labels, &touched, config)?;
    let config = &config.layers;
    let mut of_material: BTreeMap<u32, f64> = BTreeMap::new();
    labels.iter().zip(opacity).for_each(|(&label, o)| *of_material.entry(label).or_default() += o);
    let is_layer = |region: &ContactRegion| {
        let whole = of_material[&region.material];
        let largest = if region.bend() < config.bend { config.large_unbent } else { config.large };
        let sized = region.weight >= config.small * whole && region.weight <= largest * whole;
        let covered = region.facing.map_or(f64::INFINITY, |facing| regions.all[facing].edge());
        let lighter = region.weight < of_material[&region.touches];
        sized && lighter && region.edge() <= config.edge.min(config.edge_of_covered * covered)
    };
    let layers: Vec<bool> = regions.all.iter().map(is_layer).collect();
    for (n, touched) in touched.into_iter().enumerate() {
        if regions.labels[n].is_some_and(|region| layers[region]) && !regions.at_edge[n] && !fixed[n] {
            labels[n] = touched;
        }
    }
    Ok(())
}

/// Returns the other material that row `n` is most in contact with, by opacity; 0 for none.
fn touched(contacts: &Contacts, opacity: &[f64], labels: &[u32], n: usize) -> u32 {
    if labels[n] == 0 {
        return 0;
    }
    let mut sums: BTreeMap<u32, f64> = BTreeMap::new();
    for &other in contacts.touching(n).iter().filter(|&&k| labels[k] > 0 && labels[k] != labels[n]) {
        *sums.entry(labels[other]).or_default() += opacity[other];
    }
    sums.into_iter().reduce(|best, next| if next.1 > best.1 { next } else { best }).map_or(0, |(material, _)| material)
}

/// A connected region of one material in contact with one other.
#[derive(Default)]
struct ContactRegion {
    material: u32,
    /// The material that it is in contact with.
    touches: u32,
    /// Its total opacity.
    weight: f64,
    /// The opacity of the neighbours of its Gaussians that have their material: those in the region, and the others.
    neighbours: [f64; 2],
    /// Over its Gaussians, weighted by opacity: the steps to the mean of their neighbours in the region along the
    /// direction to what they are in contact with, and the lengths of these steps, scene units.
    steps: [f64; 2],
    /// The region of the other material that it is most in contact with, by opacity.
    facing: Option<usize>,
}

impl ContactRegion {
    /// Returns the share of the neighbours that is not in the region.
    fn edge(&self) -> f64 {
        let [inside, outside] = self.neighbours;
        outside / (inside + outside).max(f64::MIN_POSITIVE)
    }

    /// Returns how far the region bends towards what it is in contact with, in [-1, 1]: positive around a ball, negative
    /// inside a hollow, 0 if it is flat.
    fn bend(&self) -> f64 {
        let [along, length] = self.steps;
        along / length.max(f64::MIN_POSITIVE)
    }
}

struct ContactRegions {
    all: Vec<ContactRegion>,
    /// `[M]`: the region of each Gaussian.
    labels: Vec<Option<usize>>,
    /// `[M]`: whether most of a Gaussian's neighbours of its material, by opacity, are not in its region: haze beside a
    /// layer reaches into it.
    at_edge: Vec<bool>,
}

impl ContactRegions {
    /// `touched` `[M]` holds the material that each Gaussian is in contact with, 0 for none.
    fn of(
        contacts: &Contacts,
        opacity: &[f64],
        labels: &[u32],
        touched: &[u32],
        config: &SegmentConfig,
    ) -> Result<Self, PointsError> {
        let beside = beside(contacts, labels, touched, config)?;
        // of the same material by `beside`
        let same = |n: usize, k: usize| touched[n] == touched[k];
        let sets = UnionFind::new(labels.len());
        beside.par_iter().for_each(|(n, near)| {
            near.iter().filter(|&&k| same(*n, k)).for_each(|&k| sets.union(*n as u32, k as u32));
        });
        let mut out = Self { all: Vec::new(), labels: vec![None; labels.len()], at_edge: vec![false; labels.len()] };
        let mut numbers: BTreeMap<u32, usize> = BTreeMap::new();
        for (n, near) in &beside {
            let region = *numbers.entry(sets.find(*n as u32)).or_insert(out.all.len());
            if region == out.all.len() {
                let (material, touches) = (labels[*n], touched[*n]);
                out.all.push(ContactRegion { material, touches, ..ContactRegion::default() });
            }
            let mut around = [0.0; 2];
            near.iter().for_each(|&k| around[usize::from(!same(*n, k))] += opacity[k]);
            // from it to the middle of others
            let towards = |rows: &mut dyn Iterator<Item = usize>| {
                let (sum, count) = rows.fold((DVec3::ZERO, 0), |(sum, c), k| (sum + contacts.all.position(k), c + 1));
                if count > 0 { sum / f64::from(count) - contacts.all.position(*n) } else { DVec3::ZERO }
            };
            let step = towards(&mut near.iter().copied().filter(|&k| same(*n, k)));
            let touched = towards(&mut contacts.touching(*n).iter().copied().filter(|&k| labels[k] == touched[*n]));
            out.at_edge[*n] = around[1] > around[0];
            out.labels[*n] = Some(region);
            let region = &mut out.all[region];
            region.weight += opacity[*n];
            (0..2).for_each(|k| region.neighbours[k] += around[k]);
            region.steps[0] += opacity[*n] * step.dot(touched.normalize_or_zero());
            region.steps[1] += opacity[*n] * step.length();
        }
        out.face(contacts, opacity);
        Ok(out)
    }

    /// Finds what each region faces.
    fn face(&mut self, contacts: &Contacts, opacity: &[f64]) {
        let mut met: BTreeMap<(usize, usize), f64> = BTreeMap::new();
        for (n, own) in self.labels.iter().enumerate() {
            let Some(own) = *own else { continue };
            let ContactRegion { material, touches, .. } = self.all[own];
            let faces = |f: &usize| (self.all[*f].material, self.all[*f].touches) == (touches, material);
            for &k in contacts.touching(n) {
                if let Some(facing) = self.labels[k].filter(faces) {
                    *met.entry((own, facing)).or_default() += opacity[k];
                }
            }
        }
        let mut most = vec![0.0; self.all.len()];
        for ((own, facing), weight) in met {
            if weight > most[own] {
                (most[own], self.all[own].facing) = (weight, Some(facing));
            }
        }
    }
}

/// Returns, for each row in contact with another material, the nearest rows of its own material that are connected to
/// it; rows ascending.
fn beside(
    contacts: &Contacts,
    labels: &[u32],
    touched: &[u32],
    config: &SegmentConfig,
) -> Result<Vec<(usize, Vec<usize>)>, PointsError> {
    let (count, reach) = (config.contacts.neighbours, config.pieces.reach);
    let mut out: Vec<(usize, Vec<usize>)> = Vec::new();
    for material in 1..=labels.iter().copied().max().unwrap_or(0) {
        let rows: Vec<usize> = (0..labels.len()).filter(|&n| labels[n] == material).collect();
        let alone = contacts.all.subset(&rows)?;
        let near = |(row, &n): (usize, &usize)| (n, alone.within(row, count, reach).map(|k| rows[k]).collect());
        let edge: Vec<(usize, &usize)> = rows.iter().enumerate().filter(|(_, n)| touched[**n] > 0).collect();
        out.par_extend(edge.into_par_iter().map(near));
    }
    out.sort_unstable_by_key(|(n, _)| *n);
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::HostGaussians;
    use crate::segment::test_support::{add, on_threads};
    use volseggs_kernels::activation::logit;

    /// Adds a block of Gaussians 0.1 apart, so that neighbours are in contact, and its `material` for each.
    fn block(to: &mut (HostGaussians, Vec<u32>), from: [i32; 3], size: [i32; 3], material: u32) {
        for place in 0..size.iter().product() {
            let at = [place % size[0], place / size[0] % size[1], place / (size[0] * size[1])];
            add(&mut to.0, [0, 1, 2].map(|a| 0.1 * (from[a] + at[a]) as f32), [-2.9; 3]);
            to.1.push(material);
        }
    }

    fn joined((at, labels): &(HostGaussians, Vec<u32>)) -> Vec<u32> {
        let mut out = labels.clone();
        let all: Vec<u32> = (0..at.len() as u32).collect();
        let opacity: Vec<f64> = all.iter().map(|&i| at.opacity_of(i as usize).into()).collect();
        let config = SegmentConfig::default();
        let contacts = Contacts::among(at, &all, &config.contacts).unwrap();
        join(&contacts, &opacity, &mut out, &vec![false; all.len()], &config).unwrap();
        out
    }

    fn nothing() -> (HostGaussians, Vec<u32>) {
        (HostGaussians { sh_stride: 1, ..HostGaussians::default() }, Vec::new())
    }

    #[test]
    fn a_layer_connected_to_a_body_of_its_material_joins_what_it_covers() {
        let mut scene = nothing();
        // a body, a layer on it, and another body of the layer's material that the layer runs into; one row of it stands
        // on the first body too
        block(&mut scene, [0, 0, 0], [21, 20, 4], 1);
        block(&mut scene, [0, 0, 4], [20, 20, 1], 2);
        block(&mut scene, [20, 0, 4], [20, 20, 5], 2);
        let found = joined(&scene);
        let layer = 1680..2080;
        assert!(found[layer].iter().all(|l| *l == 1), "the layer joins");
        assert!(found[..1680].iter().all(|l| *l == 1) && found[2080..].iter().all(|l| *l == 2), "the bodies stay");
        assert_eq!(found, on_threads(1, || joined(&scene)));
    }

    #[test]
    fn sides_of_bodies_that_meet_stay_and_so_do_small_contacts() {
        let mut scene = nothing();
        block(&mut scene, [0, 0, 0], [12, 12, 6], 1);
        block(&mut scene, [0, 0, 6], [12, 12, 6], 2);
        // a sheet that stands on the second body touches it along one edge
        block(&mut scene, [0, 6, 12], [12, 1, 12], 3);
        assert_eq!(joined(&scene), scene.1);
    }

    #[test]
    fn the_surface_of_a_core_is_no_layer_and_bends_away_from_the_body() {
        // a core of 12^3 Gaussians, fainter inside, in a body of 18^3
        let mut scene = nothing();
        for place in 0..18i32.pow(3) {
            let at = [place % 18, place / 18 % 18, place / 324];
            let depth = at.into_iter().map(|v| v.min(17 - v)).min().unwrap();
            block(&mut scene, at, [1, 1, 1], if depth < 3 { 1 } else { 2 });
            if depth > 3 {
                *scene.0.opacity_logits.last_mut().unwrap() = logit(0.4 * scene.0.opacity_of(0));
            }
        }
        let (at, labels) = &scene;
        let all: Vec<u32> = (0..at.len() as u32).collect();
        let opacity: Vec<f64> = all.iter().map(|&i| at.opacity_of(i as usize).into()).collect();
        let config = SegmentConfig::default();
        let contacts = Contacts::among(at, &all, &config.contacts).unwrap();
        let touched: Vec<u32> = (0..at.len()).map(|n| touched(&contacts, &opacity, labels, n)).collect();
        let found = ContactRegions::of(&contacts, &opacity, labels, &touched, &config).unwrap().all;
        let limits = &config.layers;
        let [around, surface] = [1, 2].map(|m| found.iter().find(|r| r.material == m).unwrap());
        // by its edge and size alone it would be one
        let core: f64 = opacity.iter().zip(labels).filter(|(_, l)| **l == 2).map(|(o, _)| o).sum();
        assert!(
            surface.edge() <= limits.edge.min(limits.edge_of_covered * around.edge()),
            "{} {}",
            surface.edge(),
            around.edge()
        );
        let share = surface.weight / core;
        assert!(share > limits.large_unbent && share < limits.large, "{share}");
        assert!(surface.bend() < 0.0 && around.bend() > 0.0, "{} {}", surface.bend(), around.bend());
        assert!(joined(&scene) == scene.1);
    }

    #[test]
    fn gaussians_without_material_stay_and_touch_nothing() {
        // as above, but what the layer covers has no material
        let mut scene = nothing();
        block(&mut scene, [0, 0, 0], [21, 20, 4], 0);
        block(&mut scene, [0, 0, 4], [20, 20, 1], 2);
        block(&mut scene, [20, 0, 4], [20, 20, 5], 2);
        assert_eq!(joined(&scene), scene.1);
        assert_eq!(joined(&nothing()), [0u32; 0]);
    }
}
