//! Statistics of a segment at one time (how many Gaussians are visible, where it is, how large it is), and its velocity
//! over times. Tables are written in `tables`, changes of topology are found in `events`.

use super::eigen::{Matrix, rotation, sandwich, symmetric_eigen};
use super::volume::{Ellipsoid, union_volume};
use crate::points::PointsError;
use crate::points::chunks::{finite, map_chunks, point};
use crate::points::error::check_len;
use serde::{Deserialize, Serialize};

/// All Gaussians of a scene at one time.
#[derive(Debug, Clone, Copy)]
pub struct Gaussians<'a> {
    /// `[N, 3]`, world units.
    pub means: &'a [f32],
    /// `[N]`, linear opacity 0..1.
    pub opacity: &'a [f32],
    /// `[N, 3]`, natural log of the standard deviations.
    pub log_scales: &'a [f32],
    /// `[N, 4]`, `wxyz`, of any length.
    pub rotations: &'a [f32],
    /// `[N, 3]` RGB, or empty if no mean colour is wanted.
    pub colours: &'a [f32],
}

/// Settings of [`segment_statistics`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StatisticsConfig {
    /// Opacity above which a Gaussian counts as visible.
    pub min_opacity: f32,
    /// Minimum opacity of a Gaussian that adds to the volume.
    pub volume_opacity: f32,
    /// Size of the ellipsoids of the volume in standard deviations.
    pub volume_sigmas: f32,
    /// Cell side of the volume in world units; `None` for 1/64 of the longest side of the bounding box. Use one cell
    /// side for all times to compare them.
    pub volume_cell: Option<f32>,
}

impl Default for StatisticsConfig {
    /// Visible above 1/255; volume of the 1-sigma ellipsoids with an opacity of 0.1 or more.
    fn default() -> Self {
        Self { min_opacity: 1.0 / 255.0, volume_opacity: 0.1, volume_sigmas: 1.0, volume_cell: None }
    }
}

/// Statistics of a segment at one time. Positions are `None` if no Gaussian is visible; the names are the columns of
/// the CSV.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SegmentStatistics {
    /// Name of the segment.
    pub segment: String,
    /// Time.
    pub time: f64,
    /// Number of Gaussians in the segment.
    pub gaussians: usize,
    /// Number of Gaussians more opaque than the threshold, with finite parameters.
    pub visible: usize,
    /// Sum of the opacities of the visible Gaussians.
    pub opacity: f64,
    /// Opacity-weighted mean of the means, world units.
    pub centroid: Option<[f64; 3]>,
    /// Change of the centroid per unit time; `None` before [`fill_velocities`] and if no neighbouring time has a
    /// centroid.
    pub velocity: Option<[f64; 3]>,
    /// Lower corner of the box around means +- 1 standard deviation along the axes.
    pub box_min: Option<[f64; 3]>,
    /// Upper corner of that box.
    pub box_max: Option<[f64; 3]>,
    /// Unit principal axes (rows, longest first) of the opacity-weighted mixture's covariance.
    pub axes: Option<[[f64; 3]; 3]>,
    /// Standard deviations of the mixture along those axes, world units.
    pub extents: Option<[f64; 3]>,
    /// Volume of the union of the ellipsoids on a grid, cubic world units; see [`union_volume`].
    pub volume: f64,
    /// Cell side of that grid.
    pub volume_cell: f64,
    /// Opacity-weighted mean colour.
    pub colour: Option<[f64; 3]>,
    /// Pixels that the segment alone covers in a picture; `None` if none was drawn.
    #[serde(default)]
    pub projected_area: Option<u64>,
    /// The same as a fraction of the picture.
    #[serde(default)]
    pub projected_share: Option<f64>,
}

/// One visible Gaussian.
struct Visible {
    mean: [f64; 3],
    weight: f64,
    rotation: Matrix,
    scales: [f64; 3],
    covariance: Matrix,
    colour: Option<[f64; 3]>,
}

/// Sums over visible Gaussians, about `origin`.
#[derive(Default)]
struct Sums {
    count: usize,
    weight: f64,
    first: [f64; 3],
    second: Matrix,
    colour: [f64; 3],
    colour_weight: f64,
}

/// Computes the statistics of the Gaussians `members` (indices into the scene) at one time, without the velocity, see
/// [`fill_velocities`].
///
/// Gaussians with a non-finite mean, scale, rotation or opacity are not visible. Sums run over fixed chunks in order.
///
/// # Errors
/// If slices have different numbers of Gaussians, a member is outside the scene, or a volume cell or size is not
/// positive.
pub fn segment_statistics(
    scene: &Gaussians<'_>,
    members: &[u32],
    segment: &str,
    time: f64,
    config: &StatisticsConfig,
) -> Result<SegmentStatistics, PointsError> {
    check(scene, members, config)?;
    let parts = map_chunks(members.len(), |range| {
        members[range].iter().filter_map(|&i| visible(scene, i as usize, config.min_opacity)).collect::<Vec<_>>()
    });
    let origin = parts.iter().flatten().next().map_or([0.0; 3], |v| v.mean);
    let sums = total(&parts, origin);
    let mut out = SegmentStatistics {
        segment: segment.to_owned(),
        time,
        gaussians: members.len(),
        visible: sums.count,
        opacity: sums.weight,
        centroid: None,
        velocity: None,
        box_min: None,
        box_max: None,
        axes: None,
        extents: None,
        volume: 0.0,
        volume_cell: f64::from(config.volume_cell.unwrap_or(0.0)),
        colour: (sums.colour_weight > 0.0).then(|| sums.colour.map(|c| c / sums.colour_weight)),
        projected_area: None,
        projected_share: None,
    };
    if sums.count == 0 {
        return Ok(out);
    }
    let shift = sums.first.map(|v| v / sums.weight);
    out.centroid = Some([0, 1, 2].map(|a| origin[a] + shift[a]));
    let mut covariance = sums.second;
    for i in 0..3 {
        for j in 0..3 {
            covariance[i][j] = covariance[i][j] / sums.weight - shift[i] * shift[j];
        }
    }
    let (values, axes) = symmetric_eigen(covariance);
    out.axes = Some(axes);
    out.extents = Some(values.map(|v| v.max(0.0).sqrt()));
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for v in parts.iter().flatten() {
        for a in 0..3 {
            let sigma = v.covariance[a][a].max(0.0).sqrt();
            low[a] = low[a].min(v.mean[a] - sigma);
            high[a] = high[a].max(v.mean[a] + sigma);
        }
    }
    (out.box_min, out.box_max) = (Some(low), Some(high));
    let longest = (0..3).map(|a| high[a] - low[a]).fold(0.0, f64::max);
    let cell = config.volume_cell.map_or(longest / 64.0, f64::from).max(f64::MIN_POSITIVE);
    let bodies: Vec<Ellipsoid> = parts
        .iter()
        .flatten()
        .filter(|v| v.weight >= f64::from(config.volume_opacity))
        .map(|v| Ellipsoid {
            centre: v.mean,
            rotation: v.rotation,
            half_axes: v.scales.map(|s| (s * f64::from(config.volume_sigmas)).max(f64::MIN_POSITIVE)),
        })
        .collect();
    (out.volume, out.volume_cell) = union_volume(&bodies, cell);
    Ok(out)
}

fn check(scene: &Gaussians<'_>, members: &[u32], config: &StatisticsConfig) -> Result<(), PointsError> {
    let count = scene.opacity.len();
    check_len("means", scene.means.len(), 3 * count, "[N, 3]")?;
    check_len("log_scales", scene.log_scales.len(), 3 * count, "[N, 3]")?;
    check_len("rotations", scene.rotations.len(), 4 * count, "[N, 4]")?;
    if !scene.colours.is_empty() {
        check_len("colours", scene.colours.len(), 3 * count, "[N, 3]")?;
    }
    if let Some(&index) = members.iter().find(|&&i| i as usize >= count) {
        return Err(PointsError::Index { field: "members", index, count });
    }
    crate::points::error::check_positive("volume_sigmas", config.volume_sigmas)?;
    config.volume_cell.map_or(Ok(()), |cell| crate::points::error::check_positive("volume_cell", cell))
}

fn visible(scene: &Gaussians<'_>, i: usize, min_opacity: f32) -> Option<Visible> {
    let opacity = scene.opacity[i];
    let (mean, logs) = (point(scene.means, i), point(scene.log_scales, i));
    let quaternion = [0, 1, 2, 3].map(|k| scene.rotations[4 * i + k]);
    let usable =
        opacity.is_finite() && opacity > min_opacity && finite(mean) && quaternion.iter().all(|q| q.is_finite());
    let scales = logs.map(|s| f64::from(s).exp());
    if !usable || scales.iter().any(|s| !(s * s).is_finite()) {
        return None;
    }
    let rotation = rotation(quaternion);
    let colour = scene.colours.get(3 * i..3 * i + 3).map(|c| [0, 1, 2].map(|k| f64::from(c[k])));
    Some(Visible {
        mean: mean.map(f64::from),
        weight: f64::from(opacity),
        rotation,
        scales,
        covariance: sandwich(&rotation, scales.map(|s| s * s)),
        colour: colour.filter(|c| c.iter().all(|v| v.is_finite())),
    })
}

fn total(parts: &[Vec<Visible>], origin: [f64; 3]) -> Sums {
    let mut sums = Sums::default();
    for v in parts.iter().flatten() {
        sums.count += 1;
        sums.weight += v.weight;
        let d = [0, 1, 2].map(|a| v.mean[a] - origin[a]);
        for i in 0..3 {
            sums.first[i] += v.weight * d[i];
            for j in 0..3 {
                sums.second[i][j] += v.weight * (d[i] * d[j] + v.covariance[i][j]);
            }
        }
        if let Some(colour) = v.colour {
            sums.colour_weight += v.weight;
            (0..3).for_each(|k| sums.colour[k] += v.weight * colour[k]);
        }
    }
    sums
}

/// Fills in the velocities of one segment's statistics, given in order of time, from the centroids of the neighbouring
/// times that have one: with both neighbours, the second-order difference for uneven steps (exact for constant
/// acceleration); at an end, the one-sided difference. A time without a centroid, or without any neighbour, gets
/// `None`.
pub fn fill_velocities(series: &mut [SegmentStatistics]) {
    let knots: Vec<(f64, Option<[f64; 3]>)> = series.iter().map(|s| (s.time, s.centroid)).collect();
    // A time without a centroid, or the same time, is no neighbour.
    let slope = |i: usize, j: usize| {
        let (from, to) = (knots.get(i)?, knots.get(j)?);
        let (step, a, b) = (to.0 - from.0, from.1?, to.1?);
        (step != 0.0 && step.is_finite()).then(|| (step, [0, 1, 2].map(|k| (b[k] - a[k]) / step)))
    };
    for (i, entry) in series.iter_mut().enumerate() {
        let before = i.checked_sub(1).and_then(|j| slope(j, i));
        let after = slope(i, i + 1);
        entry.velocity = match (before, after) {
            (Some((h0, v0)), Some((h1, v1))) if h0 + h1 != 0.0 => {
                Some([0, 1, 2].map(|k| (h1 * v0[k] + h0 * v1[k]) / (h0 + h1)))
            }
            (Some((_, v)), _) | (None, Some((_, v))) => Some(v),
            (None, None) => None,
        };
    }
}

#[cfg(test)]
#[path = "statistics_tests.rs"]
mod tests;
