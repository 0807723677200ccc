//! Statistics of a segment at one time: how many of its Gaussians are visible, where it is, how large it is, and how far
//! that can be relied on. Where a segment is, `segment::place` says. Velocities are found in `motion`, tables are
//! written in `tables`, changes of topology are found in `events`.

use super::eigen::{rotation, symmetric_eigen};
use super::volume::{Ellipsoid, union_volume};
use crate::data::Calibration;
use crate::points::PointsError;
use crate::points::chunks::{finite, map_chunks, point};
use crate::points::error::check_len;
use crate::segment::place::{Cloud, Measure, bell::INVISIBLE};
use serde::{Deserialize, Serialize};

/// Minimum opacity of a Gaussian of the opaque core.
const CORE_OPACITY: f32 = 0.1;

/// How far a row can be relied on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RowStatus {
    /// The segment is where the row says.
    #[default]
    Tracked,
    /// Less than half of the segment supports the row: of its content, or of the Gaussians that are at its place.
    Weak,
    /// The segment is nowhere, or hardly anything of it is left; the row has no velocity.
    Lost,
}

/// Statistics of a segment at one time, in scene units until [`SegmentStatistics::calibrate`]. Positions are `None` if
/// the segment is nowhere; the names are those of the columns, see [`super::tables::COLUMNS`].
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct SegmentStatistics {
    /// Name of the segment.
    pub segment: String,
    /// Time in [0, 1].
    pub time: f64,
    /// The same in the data's unit; `None` where it is unknown.
    pub physical_time: Option<f64>,
    /// How far the row can be relied on.
    pub status: RowStatus,
    /// Share of the segment's content whose Gaussians lie in its place; `None` if none of them is visible.
    pub counted_share: Option<f64>,
    /// Dice coefficient, by content at the time that the segment was found at, between the segment's Gaussians and those
    /// that lie in its place at this time, followed back; `None` if there are none.
    pub consistency: Option<f64>,
    /// Distance to the nearest time with training views; `None` if they are unknown.
    pub trained_distance: Option<f64>,
    /// Number of Gaussians in the segment.
    pub gaussians: usize,
    /// Number of visible ones (opacity of at least 1/255), with finite parameters.
    pub visible: usize,
    /// Sum of their opacities.
    pub opacity: f64,
    /// Sum of their contents, the extinction density summed over space, an area.
    pub extinction: f64,
    /// Mean of the place weighted by local opacity.
    pub centroid: Option<[f64; 3]>,
    /// Change of the centroid per unit time, see [`super::motion`].
    pub velocity: Option<[f64; 3]>,
    /// Lower corner of the box around the place.
    pub box_min: Option<[f64; 3]>,
    /// Upper corner of that box.
    pub box_max: Option<[f64; 3]>,
    /// Unit principal axes (rows, longest first) of the place weighted by local opacity.
    pub axes: Option<[[f64; 3]; 3]>,
    /// Standard deviations of the place along those axes.
    pub extents: Option<[f64; 3]>,
    /// Volume of the place.
    pub volume: f64,
    /// Volume of the part of the place that no picture shows.
    pub hidden_volume: f64,
    /// Volume of the union of the one-sigma ellipsoids of its Gaussians of an opacity of at least 0.1, see
    /// [`union_volume`].
    pub opaque_core_volume: f64,
    /// Side of the cells on which all of this is measured.
    pub cell_size: f64,
    /// Opacity-weighted mean colour.
    pub colour: Option<[f64; 3]>,
    /// Pixels that the segment alone covers in a picture; `None` if none was drawn.
    pub projected_area: Option<u64>,
    /// The same as a fraction of the picture.
    pub projected_share: Option<f64>,
}

impl SegmentStatistics {
    /// Enters where the segment is, on cells of side `cell_size`; `None` if it is nowhere.
    pub fn locate(&mut self, found: Option<&Measure>, counted_share: Option<f64>, cell_size: f64) {
        (self.counted_share, self.cell_size) = (counted_share, cell_size);
        let Some(found) = found else { return };
        let (values, axes) = symmetric_eigen(found.covariance);
        self.axes = Some(axes);
        self.extents = Some(values.map(|v| v.max(0.0).sqrt()));
        (self.centroid, self.box_min, self.box_max) = (Some(found.centroid), Some(found.box_min), Some(found.box_max));
        (self.volume, self.hidden_volume) = (found.volume, found.hidden_volume);
    }

    /// Converts lengths, times and what is made of them from scene units to those of the data, where these are known.
    pub fn calibrate(&mut self, calibration: &Calibration) {
        let (length, speed) = (calibration.length_scale(), calibration.speed_scale());
        self.physical_time = calibration.time.as_ref().map(|t| t.time(self.time));
        self.trained_distance = self.trained_distance.map(|d| d * calibration.duration());
        for place in [&mut self.centroid, &mut self.box_min, &mut self.box_max] {
            *place = place.map(|p| calibration.position(p));
        }
        self.velocity = self.velocity.map(|v| v.map(|c| c * speed));
        self.extents = self.extents.map(|e| e.map(|c| c * length));
        self.extinction *= length * length;
        self.cell_size *= length;
        for volume in [&mut self.volume, &mut self.hidden_volume, &mut self.opaque_core_volume] {
            *volume *= length.powi(3);
        }
    }
}

/// One visible Gaussian.
struct Visible {
    opacity: f64,
    content: f64,
    body: Ellipsoid,
    colour: Option<[f64; 3]>,
}

/// Computes the statistics that need no place: of the Gaussians `members` (indices into the scene) with linear RGB
/// `colours` `[N, 3]`, or none, at one time; `cell` is the side of the cells of the opaque core.
///
/// Gaussians with a non-finite mean, scale, rotation or opacity are not visible. Sums run over fixed chunks in order.
///
/// # Errors
/// If slices have different numbers of Gaussians, a member is outside the scene, or the cell is not positive.
pub fn segment_statistics(
    scene: &Cloud<'_>,
    colours: &[f32],
    members: &[u32],
    segment: &str,
    time: f64,
    cell: f64,
) -> Result<SegmentStatistics, PointsError> {
    check(scene, colours, members)?;
    crate::points::error::check_positive("cell", cell as f32)?;
    let parts = map_chunks(members.len(), |range| {
        members[range].iter().filter_map(|&i| visible(scene, colours, i as usize)).collect::<Vec<_>>()
    });
    let all = || parts.iter().flatten();
    let (mut sum, mut weight) = ([0.0; 3], 0.0);
    for (colour, opacity) in all().filter_map(|v| Some((v.colour?, v.opacity))) {
        weight += opacity;
        (0..3).for_each(|k| sum[k] += opacity * colour[k]);
    }
    let core: Vec<Ellipsoid> = all().filter(|v| v.opacity >= f64::from(CORE_OPACITY)).map(|v| v.body).collect();
    Ok(SegmentStatistics {
        segment: segment.to_owned(),
        time,
        gaussians: members.len(),
        visible: all().count(),
        opacity: all().map(|v| v.opacity).sum(),
        extinction: all().map(|v| v.content).sum(),
        opaque_core_volume: union_volume(&core, cell).0,
        cell_size: cell,
        colour: (weight > 0.0).then(|| sum.map(|c| c / weight)),
        ..SegmentStatistics::default()
    })
}

fn check(scene: &Cloud<'_>, colours: &[f32], members: &[u32]) -> Result<(), PointsError> {
    let count = scene.opacity.len();
    check_len("means", scene.means.len(), 3 * count, "[N, 3]")?;
    check_len("log_scales", scene.log_scales.len(), 3 * count, "[N, 3]")?;
    check_len("rotations", scene.rotations.len(), 4 * count, "[N, 4]")?;
    if !colours.is_empty() {
        check_len("colours", colours.len(), 3 * count, "[N, 3]")?;
    }
    match members.iter().find(|&&i| i as usize >= count) {
        Some(&index) => Err(PointsError::Index { field: "members", index, count }),
        None => Ok(()),
    }
}

fn visible(scene: &Cloud<'_>, colours: &[f32], i: usize) -> Option<Visible> {
    let opacity = scene.opacity[i];
    let (mean, logs) = (point(scene.means, i), point(scene.log_scales, i));
    let quaternion = [0, 1, 2, 3].map(|k| scene.rotations[4 * i + k]);
    let usable =
        opacity.is_finite() && opacity >= INVISIBLE && finite(mean) && quaternion.iter().all(|q| q.is_finite());
    let scales = logs.map(|s| f64::from(s).exp());
    if !usable || scales.iter().any(|s| !(s * s).is_finite()) {
        return None;
    }
    let colour = colours.get(3 * i..3 * i + 3).map(|c| [0, 1, 2].map(|k| f64::from(c[k])));
    Some(Visible {
        opacity: f64::from(opacity),
        content: scene.content(i),
        body: Ellipsoid {
            centre: mean.map(f64::from),
            rotation: rotation(quaternion),
            half_axes: scales.map(|s| s.max(f64::MIN_POSITIVE)),
        },
        colour: colour.filter(|c| c.iter().all(|v| v.is_finite())),
    })
}

#[cfg(test)]
#[path = "statistics_tests.rs"]
mod tests;
