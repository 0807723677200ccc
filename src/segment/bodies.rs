//! Bodies that show several materials: a transfer function gives an object of high values a surface layer in the
//! colours of the lower values along its flank, and training mixes these in the Gaussians of its surface. By colour
//! alone, such a layer is a segment of its own or is grouped with distant objects of its hue.
//!
//! The connected pieces of each material are compared with the pieces of other materials that they touch. A surface
//! layer touches what it covers nearly everywhere and is not connected to the rest of its material. Layers that are
//! connected to it are told by their edge, see `surface_layers`.

use super::contacts::Contacts;
use super::pieces::{Touch, pieces};
use super::samples::{SAMPLES, Sample, thinning};
use super::surface_layers;
use crate::model::HostGaussians;
use crate::points::PointsError;
use crate::points::chunks::point;
use crate::points::neighbours::Grid;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Minimum fraction of a piece, by opacity, in contact with another piece for it to join that one's body. Surface
/// layers of trained scenes have 0.87 to 0.94; a body in a shell, or a core in a body, at most 0.37: see the results of
/// 2026-11-25 in `benches/results`.
const CONTACT: f64 = 0.7;
/// Fraction of its material, by opacity, up to which a piece may be a surface layer even if less than [`CONTACT`] of
/// the piece that it covers touches it in turn.
const MINOR: f64 = 0.5;
/// Fraction of a material, by opacity, that must be surface layers for all of it to be treated as such: its remaining
/// Gaussians then join the nearest layer.
const ALL: f64 = 0.9;
/// Ratio of the opacity of a body's second material to that of its first from which the order of the two counts as
/// chance.
const MIXED: f64 = 0.5;

/// Joins surface layers to what they cover: `labels` `[M]` from 1, the materials of the Gaussians `shown` (`[M]`,
/// indices into `at`, all finite), are replaced by those of the bodies, each the material of its piece of highest
/// opacity. Bodies of the same two materials in about equal parts get one material, the one with more opacity over all
/// of them. Materials with pieces of many Gaussians are judged in `samples` of the scene.
///
/// # Errors
/// If the arrays of `at` disagree, or points are too far apart.
///
/// # Panics
/// If an index is not below N.
pub fn join_surface_layers(at: &HostGaussians, shown: &[u32], labels: &mut [u32]) -> Result<(), PointsError> {
    let before = labels.to_vec();
    let materials: BTreeSet<u32> = before.iter().copied().filter(|label| *label > 0).collect();
    let thinned = materials.iter().map(|&m| thinning(at, shown, &before, m)).collect::<Result<Vec<f64>, _>>()?;
    if thinned.contains(&1.0) {
        join(at, shown, labels)?;
    }
    for (material, thinning) in materials.into_iter().zip(thinned).filter(|(_, thinning)| *thinning > 1.0) {
        join_by_samples(at, shown, (&before, labels), material, thinning)?;
    }
    Ok(())
}

/// Joins the Gaussians of one material, whose labels were `before`, to what most samples join them to.
fn join_by_samples(
    at: &HostGaussians,
    shown: &[u32],
    (before, labels): (&[u32], &mut [u32]),
    material: u32,
    thinning: f64,
) -> Result<(), PointsError> {
    let of_it: Vec<usize> = (0..shown.len()).filter(|&n| before[n] == material).collect();
    let mut votes = vec![[material; SAMPLES]; of_it.len()];
    for number in 0..SAMPLES {
        let sample = Sample::of(at, shown, thinning, number);
        let all: Vec<u32> = (0..sample.rows.len() as u32).collect();
        let mut joined: Vec<u32> = sample.rows.iter().map(|&n| before[n]).collect();
        join(&sample.at, &all, &mut joined)?;
        let of_sample = sample.rows.iter().zip(&joined).filter(|(n, _)| before[**n] == material);
        let known: Vec<(u32, u32)> = of_sample.map(|(&n, &label)| (shown[n], label)).collect();
        let nearest = label_of_nearest(at, &known)?;
        votes.par_iter_mut().zip(&of_it).for_each(|(votes, &n)| {
            votes[number] = nearest(shown[n]).unwrap_or(material);
        });
    }
    for (votes, n) in votes.into_iter().zip(of_it) {
        let count = |label: &u32| votes.iter().filter(|v| *v == label).count();
        labels[n] = votes.iter().copied().find(|v| 2 * count(v) > SAMPLES).unwrap_or(material);
    }
    Ok(())
}

fn join(at: &HostGaussians, shown: &[u32], labels: &mut [u32]) -> Result<(), PointsError> {
    let opacity: Vec<f64> = shown.iter().map(|&i| f64::from(at.opacity_of(i as usize))).collect();
    let contacts = Contacts::among(at, shown)?;
    join_pieces(at, shown, (&contacts, &opacity), labels)?;
    surface_layers::join(&contacts, &opacity, labels)?;
    // what lay outside of such a layer is left as pieces
    join_pieces(at, shown, (&contacts, &opacity), labels)
}

/// Joins connected pieces that are surface layers as a whole.
fn join_pieces(
    at: &HostGaussians,
    shown: &[u32],
    (contacts, opacity): (&Contacts, &[f64]),
    labels: &mut [u32],
) -> Result<(), PointsError> {
    let pieces = Pieces::of(at, shown, labels, opacity)?;
    let contacts = pieces.contacts(contacts, opacity);
    let touching = |from: usize, to: usize| contacts.get(&(from, to)).map_or(0.0, |w| w / pieces.weights[from]);
    // the body that each piece covers: the one of highest opacity among those that qualify
    let mut covers: Vec<Option<usize>> = vec![None; pieces.weights.len()];
    for &(skin, body) in contacts.keys() {
        let less = (pieces.weights[skin], skin) < (pieces.weights[body], body);
        let alone = pieces.weights[skin] <= MINOR * pieces.of_material[&pieces.materials[skin]];
        let is_skin = less && touching(skin, body) >= CONTACT && (alone || touching(body, skin) >= CONTACT);
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
    let materials = pieces.materials_by_body(&bodies);
    let before = labels.to_vec();
    for (label, piece) in labels.iter_mut().zip(&pieces.labels) {
        if let Some(piece) = *piece {
            *label = materials[piece];
        }
    }
    for (&material, &whole) in &pieces.of_material {
        let of_it = || (0..labels.len()).filter(|&n| before[n] == material);
        let (moved, left): (Vec<usize>, Vec<usize>) = of_it().partition(|&n| labels[n] != material);
        if left.is_empty() || moved.iter().map(|&n| opacity[n]).sum::<f64>() < ALL * whole {
            continue;
        }
        let known: Vec<(u32, u32)> = moved.iter().map(|&n| (shown[n], labels[n])).collect();
        let nearest = label_of_nearest(at, &known)?;
        for n in left {
            labels[n] = nearest(shown[n]).unwrap_or(material);
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
    let grid = Grid::adaptive(&known.iter().flat_map(|(i, _)| place(*i)).collect::<Vec<f32>>())?;
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
    /// The total opacity of each material.
    of_material: BTreeMap<u32, f64>,
}

impl Pieces {
    fn of(at: &HostGaussians, shown: &[u32], materials: &[u32], opacity: &[f64]) -> Result<Self, PointsError> {
        let mut out = Self {
            labels: vec![None; shown.len()],
            materials: Vec::new(),
            weights: Vec::new(),
            of_material: BTreeMap::new(),
        };
        for material in 1..=materials.iter().copied().max().unwrap_or(0) {
            let rows: Vec<usize> = (0..shown.len()).filter(|&n| materials[n] == material).collect();
            let members: Vec<u32> = rows.iter().map(|&n| shown[n]).collect();
            let found = pieces(at, &members, Touch::SEEN)?;
            let first = out.weights.len();
            for (&n, &label) in rows.iter().zip(&found.labels) {
                out.labels[n] = label.checked_sub(1).map(|p| first + p as usize);
            }
            out.materials.extend(found.weights.iter().map(|_| material));
            out.weights.extend(&found.weights);
            out.of_material.insert(material, rows.iter().map(|&n| opacity[n]).sum());
        }
        Ok(out)
    }

    /// Returns the material of each piece's body, `[P]`; `bodies` `[P]` holds for each piece the piece of highest
    /// opacity of its body.
    fn materials_by_body(&self, bodies: &[usize]) -> Vec<u32> {
        let mut parts: BTreeMap<usize, BTreeMap<u32, f64>> = BTreeMap::new();
        for (piece, &body) in bodies.iter().enumerate() {
            *parts.entry(body).or_default().entry(self.materials[piece]).or_default() += self.weights[piece];
        }
        let pairs: BTreeMap<usize, [u32; 2]> =
            parts.iter().filter_map(|(&body, parts)| Some((body, mixed(parts)?))).collect();
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
            met.extend(contacts.of(n).iter().filter_map(|&k| self.labels[k]).filter(|piece| *piece != own));
            met.sort_unstable();
            met.dedup();
            met.iter().for_each(|&piece| *out.entry((own, piece)).or_default() += opacity[n]);
        }
        out
    }
}

/// Returns the two materials of highest opacity, ascending, if a body has them in about equal parts; `parts` holds the
/// opacity of each material.
fn mixed(parts: &BTreeMap<u32, f64>) -> Option<[u32; 2]> {
    let mut by_weight: Vec<(u32, f64)> = parts.iter().map(|(&material, &weight)| (material, weight)).collect();
    by_weight.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    let &[(first, most), (second, less), ..] = by_weight.as_slice() else { return None };
    (less >= MIXED * most).then(|| [first.min(second), first.max(second)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, Rng};
    use crate::segment::balls::{add, on_threads};
    use crate::segment::colour::fibonacci_sphere;

    /// Adds a sphere of Gaussians whose neighbours are 0.083 radii apart, and returns the `label` of each.
    fn sphere(to: &mut HostGaussians, x: f32, radius: f32, label: impl Fn(usize) -> u32) -> Vec<u32> {
        let places = fibonacci_sphere(1800);
        places.iter().for_each(|p| add(to, [x + radius * p[0], radius * p[1], radius * p[2]], [-3.0; 3]));
        (0..places.len()).map(label).collect()
    }

    fn joined(at: &HostGaussians, labels: &[u32]) -> Vec<u32> {
        let (all, mut out): (Vec<u32>, _) = ((0..at.len() as u32).collect(), labels.to_vec());
        join_surface_layers(at, &all, &mut out).unwrap();
        out
    }

    #[test]
    fn a_surface_layer_joins_what_it_covers_and_the_rest_of_its_material_stays() {
        let mut at = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
        // four ninths of the first sphere are of the material of the second, which is far away
        let mut labels = sphere(&mut at, -3.0, 1.0, |i| if i % 9 < 5 { 1 } else { 2 });
        labels.extend(sphere(&mut at, 3.0, 1.0, |_| 2));
        let found = joined(&at, &labels);
        assert!(found[..1800].iter().all(|l| *l == 1) && found[1800..].iter().all(|l| *l == 2));
        assert_eq!(found, on_threads(1, || joined(&at, &labels)));
        // the same if all of its material is surface layer, as both cover each other; a stray bit of it follows
        let mut alone = at.subset(&(0..1800).collect::<Vec<u32>>());
        add(&mut alone, [-3.0, 0.0, 1.5], [-3.0; 3]);
        labels[1800] = 2;
        assert!(joined(&alone, &labels[..1801]).iter().all(|l| *l == 1));
    }

    /// Adds a block of Gaussians 0.05 apart, each `material`.
    fn block(to: &mut Vec<([f32; 3], u32)>, from: [i32; 3], size: [i32; 3], material: u32) {
        for place in 0..size.iter().product() {
            let at = [place % size[0], place / size[0] % size[1], place / (size[0] * size[1])];
            to.push(([0, 1, 2].map(|a| 0.05 * (from[a] + at[a]) as f32), material));
        }
    }

    #[test]
    fn a_layer_several_gaussians_thick_joins_what_it_covers() {
        let mut rows = Vec::new();
        // a body, a layer on it, and another body of the layer's material that the layer runs into
        block(&mut rows, [0, 0, 0], [40, 40, 8], 1);
        block(&mut rows, [0, 0, 8], [40, 40, 2], 2);
        block(&mut rows, [40, 0, 8], [40, 40, 16], 2);
        Rng::new(0, 0, Purpose::Custom(0)).shuffle(&mut rows);
        let mut at = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
        rows.iter().for_each(|(place, _)| add(&mut at, *place, [-3.3; 3]));
        let labels: Vec<u32> = rows.iter().map(|row| row.1).collect();
        let found = joined(&at, &labels);
        let share = |found: &[u32], wanted: &dyn Fn([f32; 3]) -> bool, label: u32| {
            let of_it: Vec<usize> = (0..rows.len()).filter(|&n| wanted(rows[n].0)).collect();
            of_it.iter().filter(|&&n| found[n] == label).count() as f64 / of_it.len() as f64
        };
        let layer = |p: [f32; 3]| p[0] < 1.8 && p[2] > 0.38;
        let others = [share(&found, &|p| p[2] < 0.38, 1), share(&found, &|p| p[0] > 2.2, 2)];
        assert!(share(&found, &layer, 1) > 0.9 && others == [1.0; 2], "{} {others:?}", share(&found, &layer, 1));
        assert_eq!(found, on_threads(1, || joined(&at, &labels)));
        let (all, mut at_once): (Vec<u32>, _) = ((0..at.len() as u32).collect(), labels);
        join(&at, &all, &mut at_once).unwrap();
        assert!(share(&at_once, &layer, 2) > 0.9, "not without samples");
    }

    #[test]
    fn bodies_of_the_same_two_materials_get_one_label() {
        let mut at = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
        // two spheres are five ninths of the first material, the third is five ninths of the second and would get that
        // label on its own
        let mut labels = Vec::new();
        for (x, more, less) in [(-3.0, 1, 2), (3.0, 1, 2), (9.0, 2, 1)] {
            labels.extend(sphere(&mut at, x, 1.0, |i| if i % 9 < 5 { more } else { less }));
        }
        assert!(joined(&at, &labels).iter().all(|l| *l == 1));
        // a sphere of one material alone does not take the label of the others
        labels.extend(sphere(&mut at, 15.0, 1.0, |_| 2));
        let found = joined(&at, &labels);
        assert!(found[..5400].iter().all(|l| *l == 1) && found[5400..].iter().all(|l| *l == 2));
    }

    #[test]
    fn shells_around_objects_and_patches_on_them_stay() {
        let mut at = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
        // a core, a shell well away from it, and a sphere with one half painted
        let mut labels = sphere(&mut at, 0.0, 1.0, |_| 1);
        labels.extend(sphere(&mut at, 0.0, 1.3, |_| 2));
        labels.extend(sphere(&mut at, 5.0, 1.0, |i| if i < 900 { 3 } else { 4 }));
        assert_eq!(joined(&at, &labels), labels);
    }

    #[test]
    fn gaussians_without_material_stay_and_invisible_ones_follow() {
        let mut at = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
        let mut labels = sphere(&mut at, 0.0, 1.0, |i| if i % 9 < 5 { 1 } else { 2 });
        (labels[3], at.opacity_logits[8]) = (0, -9.0);
        let found = joined(&at, &labels);
        assert_eq!((found[3], found[8], found[14]), (0, 1, 1));
        assert_eq!(joined(&at.subset(&[]), &[]), [0u32; 0]);
        assert_eq!(joined(&at.subset(&[4]), &[7]), [7]);
    }
}
