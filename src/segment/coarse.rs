//! Coarse segmentation: Gaussians by the colour of their material, or by their mean colour as in the paper's section on
//! colours, without outliers.

use super::bodies::join_skins;
use super::colour::{fibonacci_sphere, lab_to_rgb, mean_colour, rgb_to_lab_all};
use super::material::{Materials, materials};
use super::material_groups::group;
use super::palette::{PaletteEntry, name_colours, name_materials};
use super::pieces::{Touch, pieces};
use crate::model::HostGaussians;
use crate::points::PointsError;
use crate::points::chunks::point;
use crate::points::kmeans::{KMeansConfig, kmeans, nearest};
use crate::points::neighbours::Grid;
use crate::points::outliers::{OutlierConfig, keep_mask};
use crate::points::suggest::suggest_clusters;
use crate::rng::{Purpose, Rng};

/// Directions over which a colour is averaged.
const DIRECTIONS: usize = 128;

/// What makes colours near or far.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColourSpace {
    /// The material's colour: hue first, then chroma, whatever the shading; see [`material`](super::material).
    Material,
    /// The mean colour as displayed, the paper's: light and dark sides of one material may be two groups.
    Rgb,
    /// The mean colour in CIE Lab: distances as people see them.
    Lab,
}

/// How to group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoarseOptions {
    /// Number of colours; suggested from the data if not given.
    pub clusters: Option<usize>,
    /// Space of the colours.
    pub space: ColourSpace,
    /// Gaussians less opaque than this at the chosen time make no colours, and those that always are belong to none.
    pub min_opacity: f32,
    /// Whether skins stay segments of their own, or go with the things of their hue, see [`bodies`](super::bodies). They do
    /// so anyway where the number of colours is given, and where mean colours are grouped.
    pub keep_skins: bool,
    /// How outliers are found; `None` keeps them. Those with too few neighbours go unless they hang together, by
    /// touching, with more than that number of their colour, as threads do.
    pub outliers: Option<OutlierConfig>,
    /// Seed of the clustering.
    pub seed: u64,
}

impl Default for CoarseOptions {
    fn default() -> Self {
        Self {
            clusters: None,
            space: ColourSpace::Material,
            min_opacity: 0.02,
            keep_skins: false,
            outliers: Some(OutlierConfig::default()),
            seed: 0,
        }
    }
}

impl CoarseOptions {
    /// Which of `gaussians` are too transparent at their time to make colours, `[N]`: [`coarse`] asks of
    /// these alone how opaque they are at other times.
    #[must_use]
    pub fn hidden(&self, gaussians: &HostGaussians) -> Vec<bool> {
        gaussians.opacity().iter().map(|o| o.is_nan() || *o < self.min_opacity).collect()
    }
}

/// Gaussians by colour.
#[derive(Clone, Debug)]
pub struct Coarse {
    /// The colours that any Gaussian has, the one with most opacity first; those of materials under full light.
    pub palette: Vec<PaletteEntry>,
    /// `[N]`: position in the palette + 1; 0 for Gaussians that are always transparent, and outliers.
    pub labels: Vec<u32>,
    /// Gaussians removed as outliers.
    pub outliers: usize,
    /// Gaussians that are less opaque than [`CoarseOptions::min_opacity`] at all times.
    pub transparent: usize,
    /// Gaussians with a position or colour that is not finite. With these three numbers and the labelled ones every
    /// Gaussian is accounted for.
    pub not_finite: usize,
}

/// Groups Gaussians at a time by colour, each weighted by its opacity. Those that are transparent then and not always join
/// the colour next to theirs, as they may be what a segment consists of at another time; those of a material that nothing
/// shows at this time make a colour of their own, unless the number of colours is given, or they are mean colours.
/// `later` `[N]` holds the opacity of each at another time, 0 for what is always transparent, and is read where
/// [`CoarseOptions::hidden`].
///
/// # Errors
/// If an option is out of range.
///
/// # Panics
/// If `later` has another length.
pub fn coarse(
    gaussians: &HostGaussians,
    later: Option<&[f32]>,
    options: &CoarseOptions,
) -> Result<Coarse, PointsError> {
    if let Some(later) = later {
        assert_eq!(later.len(), gaussians.len(), "later: [N]");
    }
    let (sh, coefficients) = gaussians.material_colours();
    let harmonics = 3 * coefficients;
    let opacity = gaussians.opacity();
    let too_transparent = options.hidden(gaussians);
    // of the sum, so that no colour of these overflows either
    let finite = |v: &[f32]| v.iter().map(|v| v.abs()).sum::<f32>().is_finite();
    let (hidden, shown): (Vec<u32>, Vec<u32>) = (0..gaussians.len() as u32)
        .filter(|&i| {
            finite(&gaussians.means[3 * i as usize..][..3]) && finite(&sh[i as usize * harmonics..][..harmonics])
        })
        .partition(|&i| too_transparent[i as usize]);
    let not_finite = gaussians.len() - shown.len() - hidden.len();
    let shown = Weighed::new(shown, &opacity);
    let later = later.map_or_else(Weighed::default, |opacity| {
        Weighed::new(hidden.into_iter().filter(|&i| opacity[i as usize] > 0.0).collect(), opacity)
    });
    let mut rng = Rng::new(options.seed, 0, Purpose::Clusters);
    let mut uniform = || rng.uniform();
    let found = match options.space {
        ColourSpace::Material => by_material(gaussians, &shown, &later, options, &mut uniform)?,
        ColourSpace::Rgb | ColourSpace::Lab => by_mean(gaussians, &shown, &later, options, &mut uniform)?,
    };
    let mut labels = vec![0; gaussians.len()];
    for (&i, &label) in shown.rows.iter().zip(&found.shown) {
        labels[i as usize] = label;
    }
    let mut removed = 0;
    if let Some(outliers) = &options.outliers {
        // each colour for itself: a red Gaussian in a blue cloud is an outlier of red
        for label in 1..=found.colours.len() as u32 / 3 {
            let members: Vec<u32> = (0..).zip(&labels).filter(|(_, l)| **l == label).map(|(i, _)| i).collect();
            let means: Vec<f32> =
                members.iter().flat_map(|&i| &gaussians.means[3 * i as usize..][..3]).copied().collect();
            let mask = keep_mask(&means, outliers)?;
            if mask.keep.iter().all(|keep| *keep) {
                continue;
            }
            // thin things have few neighbours, but they hang together
            let found = pieces(gaussians, &members, Touch::ALL)?;
            let with_others = |n: usize| {
                found.labels[n].checked_sub(1).is_some_and(|p| found.counts[p as usize] > outliers.min_neighbours)
            };
            for (_, &i) in members.iter().enumerate().filter(|(n, _)| !mask.keep[*n] && !with_others(*n)) {
                labels[i as usize] = 0;
                removed += 1;
            }
        }
    }
    let mut of_later = found.later;
    if options.space == ColourSpace::Material && options.clusters.is_none() && !options.keep_skins {
        let before: Vec<u32> = shown.rows.iter().map(|&i| labels[i as usize]).collect();
        let mut after = before.clone();
        join_skins(gaussians, &shown.rows, &mut after)?;
        follow_nearest(gaussians, [&shown.rows, &later.rows], [&before, &after], &mut of_later)?;
        shown.rows.iter().zip(after).for_each(|(&i, label)| labels[i as usize] = label);
    }
    for (&i, &label) in later.rows.iter().zip(&of_later) {
        labels[i as usize] = label;
    }
    let kept = without_empty(&found.colours, &mut labels);
    let none = labels.iter().filter(|l| **l == 0).count();
    let transparent = none - removed - not_finite;
    let palette = if options.space == ColourSpace::Material { name_materials(&kept) } else { name_colours(&kept) };
    Ok(Coarse { palette, labels, outliers: removed, transparent, not_finite })
}

/// Gaussians, and what each counts.
#[derive(Default)]
struct Weighed {
    rows: Vec<u32>,
    weights: Vec<f32>,
}

impl Weighed {
    /// `rows` with the weights that `of_all` `[N]` has for them.
    fn new(rows: Vec<u32>, of_all: &[f32]) -> Self {
        Self { weights: rows.iter().map(|&i| of_all[i as usize]).collect(), rows }
    }
}

/// Labels from 1 of the Gaussians that are shown and of those that are at another time, and the groups' colours `[K,
/// 3]`.
struct Found {
    shown: Vec<u32>,
    later: Vec<u32>,
    colours: Vec<f32>,
}

fn by_material(
    gaussians: &HostGaussians,
    shown: &Weighed,
    later: &Weighed,
    options: &CoarseOptions,
    uniform: &mut impl FnMut() -> f32,
) -> Result<Found, PointsError> {
    let (sh, coefficients) = gaussians.material_colours();
    let all = materials(&sh, coefficients)?;
    let rows = |values: &[f32], width: usize, which: &[u32]| -> Vec<f32> {
        which.iter().flat_map(|&i| &values[i as usize * width..][..width]).copied().collect()
    };
    let of = |which: &[u32]| Materials {
        chroma: rows(&all.chroma, 2, which),
        full: rows(&all.full, 1, which),
        certainty: rows(&all.certainty, 1, which),
    };
    let means = |which: &[u32]| rows(&gaussians.means, 3, which);
    let mut found = group(&means(&shown.rows), &of(&shown.rows), &shown.weights, options.clusters, uniform)?;
    let of_later = of(&later.rows);
    if options.clusters.is_none() {
        found.add_unseen(&means(&later.rows), &of_later, &later.weights)?;
    }
    Ok(Found { later: found.nearest(&of_later), shown: found.labels, colours: found.colours })
}

/// The paper's grouping: k-means of the colours that [`mean_colour`] gives.
fn by_mean(
    gaussians: &HostGaussians,
    shown: &Weighed,
    later: &Weighed,
    options: &CoarseOptions,
    uniform: &mut impl FnMut() -> f32,
) -> Result<Found, PointsError> {
    let (sh, coefficients) = gaussians.material_colours();
    let colours = mean_colour(&sh, coefficients, &fibonacci_sphere(DIRECTIONS))?;
    let points_of = |which: &[u32]| {
        let rows: Vec<f32> = which.iter().flat_map(|&i| &colours[3 * i as usize..][..3]).copied().collect();
        if options.space == ColourSpace::Lab { rgb_to_lab_all(&rows) } else { rows }
    };
    let (points, weights) = (points_of(&shown.rows), &shown.weights);
    let clusters = match options.clusters {
        Some(k) => k,
        None => suggest_clusters(&points, 3, weights, 2..=10, uniform)?.clusters,
    };
    let found = kmeans(&points, 3, weights, &KMeansConfig::new(clusters), uniform)?;
    let mut of_later = vec![0; later.rows.len()];
    if found.clusters() > 0 {
        for (label, colour) in of_later.iter_mut().zip(points_of(&later.rows).chunks_exact(3)) {
            *label = nearest(colour, &found.centroids, 3).0 as u32 + 1;
        }
    }
    let colours = match options.space {
        ColourSpace::Lab => found.centroids.chunks_exact(3).flat_map(|c| lab_to_rgb([c[0], c[1], c[2]])).collect(),
        _ => found.centroids,
    };
    Ok(Found { shown: found.labels, later: of_later, colours })
}

/// Gaussians of other times go where the nearest that is seen of their material went: `before` and `after` are the labels of
/// the rows `shown`, `labels` those of the rows `later`.
fn follow_nearest(
    gaussians: &HostGaussians,
    [shown, later]: [&[u32]; 2],
    [before, after]: [&[u32]; 2],
    labels: &mut [u32],
) -> Result<(), PointsError> {
    let mut moved: Vec<u32> = before.iter().zip(after).filter(|(b, a)| b != a).map(|(b, _)| *b).collect();
    moved.sort_unstable();
    moved.dedup();
    for material in moved {
        let rows: Vec<usize> = (0..shown.len()).filter(|&n| before[n] == material).collect();
        let means: Vec<f32> = rows.iter().flat_map(|&n| point(&gaussians.means, shown[n] as usize)).collect();
        let grid = Grid::adaptive(&means)?;
        for (label, &i) in labels.iter_mut().zip(later).filter(|(label, _)| **label == material) {
            let nearest = grid.nearest(point(&gaussians.means, i as usize), 1, None);
            *label = nearest.first().map_or(material, |(n, _)| after[rows[*n as usize]]);
        }
    }
    Ok(())
}

/// The rows of `centroids` `[K, 3]` whose label, from 1, any of `labels` is; those then count in the rows that are
/// left.
fn without_empty(centroids: &[f32], labels: &mut [u32]) -> Vec<f32> {
    let mut held = vec![false; centroids.len() / 3];
    for &label in labels.iter().filter(|l| **l > 0) {
        held[label as usize - 1] = true;
    }
    let mut left = 0;
    let to: Vec<u32> = held
        .iter()
        .map(|held| {
            left += u32::from(*held);
            left
        })
        .collect();
    for label in labels.iter_mut().filter(|l| **l > 0) {
        *label = to[*label as usize - 1];
    }
    centroids.chunks_exact(3).zip(held).filter(|(_, held)| *held).flat_map(|(row, _)| row).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::sh::C0;

    /// A red and a blue ball, a red stray in the blue one, and a transparent haze.
    fn two_balls() -> (HostGaussians, Vec<u32>) {
        let mut rng = Rng::new(3, 0, Purpose::Custom(0));
        let (mut g, mut truth) = (HostGaussians { sh_stride: 4, ..HostGaussians::default() }, Vec::new());
        let mut add = |centre: f32, colour: [f32; 3], logit: f32, label: u32| {
            for _ in 0..3 {
                g.means.push(centre + 0.1 * rng.normal());
                g.log_scales.push(-3.0);
            }
            g.rotations.extend([1.0, 0.0, 0.0, 0.0]);
            g.opacity_logits.push(logit);
            g.sh.extend(colour.map(|c| (c + 0.03 * rng.normal() - 0.5) / C0));
            g.sh.extend((0..9).map(|_| 0.05 * rng.normal()));
            truth.push(label);
        };
        for k in 0..900 {
            match k % 3 {
                0 => add(-1.0, [0.9, 0.1, 0.1], 2.0, 2),
                1 => add(1.0, [0.1, 0.2, 0.9], 3.0, 1),
                _ => add(0.0, [0.5, 0.9, 0.5], -6.0, 0),
            }
        }
        add(1.0, [0.9, 0.1, 0.1], 2.0, 0);
        (g, truth)
    }

    #[test]
    fn colours_are_told_apart_and_strays_and_haze_belong_to_none() {
        let (g, truth) = two_balls();
        for space in [ColourSpace::Rgb, ColourSpace::Lab, ColourSpace::Material] {
            let out = coarse(&g, None, &CoarseOptions { space, ..CoarseOptions::default() }).unwrap();
            let names: Vec<&str> = out.palette.iter().map(|p| p.name.as_str()).collect();
            assert_eq!(names, ["blue", "red"], "{space:?}");
            let wrong = out.labels.iter().zip(&truth).filter(|(a, b)| a != b).count();
            assert!(wrong <= 9, "{wrong} wrong in {space:?}: at most the rim of the balls may go with the stray");
            // a mean colour leaves it alone, a material takes what its neighbours are
            let stray = if space == ColourSpace::Material { 1 } else { 0 };
            assert_eq!(out.labels.last(), Some(&stray), "the stray");
        }
        // a part of the haze that is opaque at another time joins the colour next to it
        let later: Vec<f32> = (0..truth.len()).map(|i| if i % 6 == 2 { 0.02 } else { 0.0 }).collect();
        for space in [ColourSpace::Rgb, ColourSpace::Material] {
            let options = CoarseOptions { space, ..CoarseOptions::default() };
            let with = coarse(&g, Some(&later), &options).unwrap();
            let without = coarse(&g, None, &options).unwrap();
            for i in 0..900 {
                assert_eq!(with.labels[i] > 0, without.labels[i] > 0 || i % 6 == 2, "{i}");
            }
        }
        let kept =
            CoarseOptions { outliers: None, clusters: Some(2), space: ColourSpace::Rgb, ..CoarseOptions::default() };
        let out = coarse(&g, None, &kept).unwrap();
        assert_eq!((out.outliers, out.labels.last()), (0, Some(&2)));
        assert_eq!(out.labels, coarse(&g, None, &kept).unwrap().labels, "the same twice");
    }

    #[test]
    fn every_gaussian_is_accounted_for_and_no_colour_is_empty() {
        let (mut g, _) = two_balls();
        g.means[0] = f32::NAN;
        let options = CoarseOptions { space: ColourSpace::Rgb, ..CoarseOptions::default() };
        let numbers = [None, Some(2), Some(40)];
        for (clusters, space) in numbers.into_iter().flat_map(|k| [(k, ColourSpace::Rgb), (k, ColourSpace::Material)]) {
            let out = coarse(&g, None, &CoarseOptions { clusters, space, ..options }).unwrap();
            let mut counts = vec![0; out.palette.len()];
            out.labels.iter().filter(|l| **l > 0).for_each(|l| counts[*l as usize - 1] += 1);
            assert!(counts.iter().all(|n| *n > 0), "{counts:?}");
            let inside: usize = counts.iter().sum();
            assert_eq!(inside + out.outliers + out.transparent + out.not_finite, g.len());
            assert_eq!(out.not_finite, 1);
            assert!(space == ColourSpace::Material || out.outliers > 0, "{space:?}: the stray");
            assert!(out.transparent >= 300, "{}", out.transparent);
        }
        // so lonely is each that none is left
        g.log_scales.fill(-20.0);
        let outliers = Some(OutlierConfig { radius: Some(1e-6), ..OutlierConfig::default() });
        let out = coarse(&g, None, &CoarseOptions { outliers, ..options }).unwrap();
        assert!(out.palette.is_empty() && out.labels.iter().all(|l| *l == 0));
        let mut labels = [0, 3, 1, 3];
        assert_eq!(without_empty(&[1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 3.0, 3.0, 3.0], &mut labels)[3..], [3.0; 3]);
        assert_eq!(labels, [0, 2, 1, 2]);
    }

    #[test]
    fn a_thin_thread_stays_where_its_gaussians_touch_and_goes_where_they_do_not() {
        let (mut g, truth) = two_balls();
        let ball = g.len();
        for k in 0..60 {
            g.means.extend([1.0 + 0.1 * k as f32, 3.0, 0.0]);
            g.log_scales.extend([0.03f32.ln(), -5.0, -5.0]);
            g.rotations.extend([1.0, 0.0, 0.0, 0.0]);
            g.opacity_logits.push(2.0);
            g.sh.extend([0.9, 0.1, 0.1].map(|c: f32| (c - 0.5) / C0).iter().chain(&[0.0; 9]));
        }
        for space in [ColourSpace::Rgb, ColourSpace::Material] {
            let options = CoarseOptions { space, ..CoarseOptions::default() };
            let red = coarse(&g, None, &options).unwrap().labels[truth.iter().position(|t| *t == 2).unwrap()];
            assert_eq!(coarse(&g, None, &options).unwrap().labels[ball..], [red; 60], "{space:?}");
            let mut apart = g.clone();
            apart.log_scales[3 * ball..].fill(-5.0);
            assert_eq!(coarse(&apart, None, &options).unwrap().labels[ball..], [0; 60], "{space:?}");
        }
    }

    #[test]
    fn poison_and_nothing_are_taken() {
        let (mut g, _) = two_balls();
        (g.means[0], g.sh[20], g.opacity_logits[6]) = (f32::NAN, f32::INFINITY, f32::NAN);
        let out = coarse(&g, None, &CoarseOptions::default()).unwrap();
        assert_eq!((out.labels[0], out.labels[6]), (0, 0));
        let none = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
        let out = coarse(&none, None, &CoarseOptions { clusters: Some(3), ..CoarseOptions::default() });
        assert!(out.is_err() || out.unwrap().palette.is_empty());
        assert!(coarse(&g, None, &CoarseOptions { clusters: Some(0), ..CoarseOptions::default() }).is_err());
    }
}
