//! Coarse segmentation: groups Gaussians by the colour of their material, or by their mean colour as in the paper's
//! section on colours, and removes outliers.

use super::bodies::{join_surface_layers, label_of_nearest};
use super::colour::{fibonacci_sphere, lab_to_rgb, mean_colour, rgb_to_lab_all};
use super::material::{Materials, materials};
use super::material_groups::group;
use super::palette::{PaletteEntry, name_colours, name_materials};
use super::pieces::{TouchRule, pieces};
use crate::config::types::SegmentConfig;
use crate::config::types::segment::ColourSpace;
use crate::model::{HostGaussians, OtherTimes, Scene};
use crate::points::PointsError;
use crate::points::kmeans::{KMeansConfig, kmeans, nearest};
use crate::points::moving::nearest_over_time;
use crate::points::outliers::{OutlierConfig, keep_mask};
use crate::points::suggest::suggest_clusters;
use crate::rng::{Purpose, Rng};

/// Directions over which a colour is averaged.
const DIRECTIONS: usize = 128;

/// Returns what [`coarse`] reads of the other times of a `scene` whose Gaussians it groups `at` one time: opacities of
/// those hidden at this time, and, if materials are grouped by their neighbours over time, positions of all.
///
/// # Panics
/// If `at` is of another number of Gaussians.
pub fn other_times(scene: &Scene, at: &HostGaussians, config: &SegmentConfig) -> OtherTimes {
    let (hidden, min_opacity) = (hidden(at, config), config.colour.min_opacity);
    match config.colour.space {
        ColourSpace::Material if config.groups.over_time => scene.at_other_times(&hidden, min_opacity),
        _ => {
            let opacity = scene.opacity_at_other_times(&hidden, min_opacity);
            OtherTimes { opacity, ..OtherTimes::default() }
        }
    }
}

/// Returns which of `gaussians` are too transparent at their time to define colours, `[N]`.
pub(super) fn hidden(gaussians: &HostGaussians, config: &SegmentConfig) -> Vec<bool> {
    gaussians.opacity().iter().map(|o| o.is_nan() || *o < config.colour.min_opacity).collect()
}

/// Gaussians grouped by colour.
#[derive(Clone, Debug)]
pub struct Coarse {
    /// The colours that occur, the one with the highest total opacity first, not counting what surface layers and
    /// Gaussians of other times add; material colours are those under full light.
    pub palette: Vec<PaletteEntry>,
    /// `[N]`: position in the palette + 1; 0 for outliers and for Gaussians always transparent or not finite.
    pub labels: Vec<u32>,
    /// Number of Gaussians removed as outliers.
    pub outliers: usize,
    /// Number of Gaussians less opaque than `segment.colour.min_opacity` at all times.
    pub transparent: usize,
    /// Number of Gaussians with a non-finite position or colour. These three numbers and the labelled Gaussians add up
    /// to N.
    pub not_finite: usize,
}

impl Coarse {
    /// Returns each colour with its name as that of a segment, and its Gaussians in ascending order.
    pub fn groups(&self) -> impl Iterator<Item = (String, &PaletteEntry, Vec<u32>)> {
        (1..).zip(&self.palette).map(|(label, entry)| {
            let members = (0..).zip(&self.labels).filter(|(_, of)| **of == label).map(|(i, _)| i).collect();
            (entry.name.replace(' ', "-"), entry, members)
        })
    }
}

/// Groups Gaussians at a time by colour, each weighted by its opacity. Those transparent at this time but not always
/// join the nearest colour, as a segment may consist of them at another time; those of a material not visible at this
/// time form a colour of their own, unless the number of colours is given or mean colours are grouped. Neighbours are
/// those that stay near over all `other_times` (see [`other_times`]), so that what only passes by has no say. The result is
/// the same for the same `seed`.
///
/// # Errors
/// If an option is out of range.
///
/// # Panics
/// If `other_times` are of another number of Gaussians.
pub fn coarse(
    gaussians: &HostGaussians,
    other_times: Option<&OtherTimes>,
    config: &SegmentConfig,
    seed: u64,
) -> Result<Coarse, PointsError> {
    let nothing = OtherTimes { means: Vec::new(), opacity: vec![0.0; gaussians.len()] };
    let other_times = other_times.unwrap_or(&nothing);
    assert_eq!(other_times.opacity.len(), gaussians.len(), "opacity at other times: [N]");
    for means in &other_times.means {
        assert_eq!(means.len(), 3 * gaussians.len(), "means at other times: [N, 3]");
    }
    let (sh, coefficients) = gaussians.material_colours();
    let harmonics = 3 * coefficients;
    let opacity = gaussians.opacity();
    let too_transparent = hidden(gaussians, config);
    let options = &config.colour;
    // tests the sum, so that no colour computed from these values overflows either
    let finite = |v: &[f32]| v.iter().map(|v| v.abs()).sum::<f32>().is_finite();
    let (mut faint, shown): (Vec<u32>, Vec<u32>) = (0..gaussians.len() as u32)
        .filter(|&i| {
            finite(&gaussians.means[3 * i as usize..][..3]) && finite(&sh[i as usize * harmonics..][..harmonics])
        })
        .partition(|&i| too_transparent[i as usize]);
    let not_finite = gaussians.len() - shown.len() - faint.len();
    let shown = Weighed::new(shown, &opacity);
    faint.retain(|&i| other_times.opacity[i as usize] > 0.0);
    let later = Weighed::new(faint, &other_times.opacity);
    let mut rng = Rng::new(seed, 0, Purpose::Clusters);
    let mut uniform = || rng.uniform();
    let found = match options.space {
        ColourSpace::Material => by_material((gaussians, other_times), &shown, &later, config, &mut uniform)?,
        ColourSpace::Rgb | ColourSpace::Lab => by_mean(gaussians, &shown, &later, config, &mut uniform)?,
    };
    let mut labels = vec![0; gaussians.len()];
    for (&i, &label) in shown.rows.iter().zip(&found.shown) {
        labels[i as usize] = label;
    }
    let mut removed = 0;
    if options.outliers {
        let radius = (options.outlier_radius > 0.0).then_some(options.outlier_radius);
        let outliers = OutlierConfig { radius, min_neighbours: options.outlier_neighbours };
        // each colour separately: a red Gaussian in a blue cloud is an outlier of red
        for label in 1..=found.colours.len() as u32 / 3 {
            let members: Vec<u32> = (0..).zip(&labels).filter(|(_, l)| **l == label).map(|(i, _)| i).collect();
            let means: Vec<f32> =
                members.iter().flat_map(|&i| &gaussians.means[3 * i as usize..][..3]).copied().collect();
            let mask = keep_mask(&means, &outliers)?;
            if mask.keep.iter().all(|keep| *keep) {
                continue;
            }
            // thin objects have few neighbours but are connected
            let found = pieces(gaussians, &members, TouchRule::all(&config.pieces))?;
            let with_others = |n: usize| {
                let large = |p: u32| found.counts[p as usize] > outliers.min_neighbours;
                options.threads && found.labels[n].checked_sub(1).is_some_and(large)
            };
            for (_, &i) in members.iter().enumerate().filter(|(n, _)| !mask.keep[*n] && !with_others(*n)) {
                labels[i as usize] = 0;
                removed += 1;
            }
        }
    }
    let mut of_later = found.later;
    if options.space == ColourSpace::Material && options.clusters == 0 && config.layers.join {
        let before: Vec<u32> = shown.rows.iter().map(|&i| labels[i as usize]).collect();
        let mut after = before.clone();
        join_surface_layers(gaussians, &shown.rows, &mut after, config)?;
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

/// Gaussians and their weights.
struct Weighed {
    rows: Vec<u32>,
    weights: Vec<f32>,
}

impl Weighed {
    /// Takes the weights of `rows` from `of_all` `[N]`.
    fn new(rows: Vec<u32>, of_all: &[f32]) -> Self {
        Self { weights: rows.iter().map(|&i| of_all[i as usize]).collect(), rows }
    }
}

/// Labels, from 1, of the Gaussians shown now and of those shown at another time, and the groups' colours `[K, 3]`.
struct CoarseGroups {
    shown: Vec<u32>,
    later: Vec<u32>,
    colours: Vec<f32>,
}

fn by_material(
    (gaussians, other_times): (&HostGaussians, &OtherTimes),
    shown: &Weighed,
    later: &Weighed,
    config: &SegmentConfig,
    uniform: &mut impl FnMut() -> f32,
) -> Result<CoarseGroups, PointsError> {
    let (sh, coefficients) = gaussians.material_colours();
    let all = materials(&sh, coefficients, &config.material)?;
    let rows = |values: &[f32], width: usize, which: &[u32]| -> Vec<f32> {
        which.iter().flat_map(|&i| &values[i as usize * width..][..width]).copied().collect()
    };
    let of = |which: &[u32]| Materials {
        chroma: rows(&all.chroma, 2, which),
        full: rows(&all.full, 1, which),
        certainty: rows(&all.certainty, 1, which),
    };
    let neighbours = |which: &[u32]| {
        let others = other_times.means.iter().filter(|_| config.groups.over_time);
        let times: Vec<Vec<f32>> =
            std::iter::once(&gaussians.means).chain(others).map(|means| rows(means, 3, which)).collect();
        let times: Vec<&[f32]> = times.iter().map(Vec::as_slice).collect();
        nearest_over_time(&times, config.groups.neighbours)
    };
    let mut found = group(&neighbours(&shown.rows)?, &of(&shown.rows), &shown.weights, config, uniform)?;
    let of_later = of(&later.rows);
    if config.colour.clusters == 0 && config.groups.unseen {
        found.add_unseen(&neighbours(&later.rows)?, &of_later, &later.weights)?;
    }
    Ok(CoarseGroups { later: found.nearest(&of_later), shown: found.labels, colours: found.colours })
}

/// Groups as in the paper: k-means of the colours from [`mean_colour`].
fn by_mean(
    gaussians: &HostGaussians,
    shown: &Weighed,
    later: &Weighed,
    config: &SegmentConfig,
    uniform: &mut impl FnMut() -> f32,
) -> Result<CoarseGroups, PointsError> {
    let (sh, coefficients) = gaussians.material_colours();
    let colours = mean_colour(&sh, coefficients, &fibonacci_sphere(DIRECTIONS))?;
    let options = &config.colour;
    let points_of = |which: &[u32]| {
        let rows: Vec<f32> = which.iter().flat_map(|&i| &colours[3 * i as usize..][..3]).copied().collect();
        if options.space == ColourSpace::Lab { rgb_to_lab_all(&rows) } else { rows }
    };
    let (points, weights) = (points_of(&shown.rows), &shown.weights);
    let clusters = match options.clusters {
        k if k > 0 => k,
        _ => suggest_clusters(&points, 3, weights, 2..=10, uniform)?.clusters,
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
    Ok(CoarseGroups { shown: found.labels, later: of_later, colours })
}

/// Relabels Gaussians visible only at other times: each follows its nearest visible Gaussian of the same material.
/// `before` and `after` are the labels of the rows `shown`, `labels` those of the rows `later`.
fn follow_nearest(
    gaussians: &HostGaussians,
    [shown, later]: [&[u32]; 2],
    [before, after]: [&[u32]; 2],
    labels: &mut [u32],
) -> Result<(), PointsError> {
    let mut moved: Vec<u32> = before.iter().zip(after).filter(|(b, a)| b != a).map(|(b, _)| *b).collect();
    moved.sort_unstable();
    moved.dedup();
    // each is relabelled once, by its original material
    let was = labels.to_vec();
    for material in moved {
        let of_it = (0..shown.len()).filter(|&n| before[n] == material);
        let known: Vec<(u32, u32)> = of_it.map(|n| (shown[n], after[n])).collect();
        let nearest = label_of_nearest(gaussians, &known)?;
        for n in (0..labels.len()).filter(|&n| was[n] == material) {
            labels[n] = nearest(later[n]).unwrap_or(material);
        }
    }
    Ok(())
}

/// Returns the rows of `centroids` `[K, 3]` whose label, from 1, occurs in `labels`, and renumbers `labels` by the
/// remaining rows.
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
#[path = "coarse_tests.rs"]
mod tests;
