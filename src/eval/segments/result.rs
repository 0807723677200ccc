//! Results of an evaluation, and their means.

use super::measure::{FrameScore, PictureScore};
use super::method::SelectionMethod;
use super::setting::TRIES;
use crate::eval::results::DataId;
use image::RgbImage;
use serde::Serialize;
use std::collections::BTreeMap;

/// How well a selection fits the true segment in space, at one time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VolumeScore {
    /// Time in [0, 1].
    pub time: f64,
    /// Intersection over union of the cells, weighted by their true opacity, percent; `None` if the segment is nowhere
    /// and nothing is selected, or if it is part of something larger at this time.
    pub iou_3d: Option<f64>,
}

/// Means over the views of one time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TimeRow {
    /// Time in [0, 1].
    pub time: f64,
    /// Number of views; PSNR, SSIM and LPIPS are means over all of them.
    pub views: usize,
    /// Number of views in which the segment is present or something is shown; IoU is the mean over these.
    pub iou_views: usize,
    /// Intersection over union of the silhouettes, percent; `None` if the segment is nowhere and nothing was shown.
    pub iou: Option<f64>,
    /// PSNR in decibels; `None` for several segments as one, of which there are no pictures.
    pub psnr: Option<f64>,
    /// SSIM, RGB.
    pub ssim: Option<f64>,
    /// SSIM, grey.
    pub ssim_gray: Option<f64>,
    /// LPIPS, AlexNet; `None` without weights.
    pub lpips: Option<f64>,
}

impl TimeRow {
    /// Returns the means of `scores`, which are of one time; `None` if there are none. A view in which the segment is
    /// absent and nothing is shown has no IoU, but its picture counts: showing nothing is then correct.
    pub fn mean(time: f64, scores: &[&FrameScore]) -> Option<Self> {
        let picture = |f: &dyn Fn(&PictureScore) -> Option<f64>| {
            mean(scores.iter().filter_map(|s| s.picture.as_ref().and_then(f)))
        };
        (!scores.is_empty()).then(|| Self {
            time,
            views: scores.len(),
            iou_views: scores.iter().filter(|s| s.iou.is_some()).count(),
            iou: mean(scores.iter().filter_map(|s| s.iou)).map(|v| 100.0 * v),
            psnr: picture(&|s| Some(s.psnr)),
            ssim: picture(&|s| Some(s.ssim)),
            ssim_gray: picture(&|s| Some(s.ssim_gray)),
            lpips: picture(&|s| s.lpips),
        })
    }
}

/// Returns the mean, summed in the order given; `None` if there are no values.
pub(super) fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0usize), |(sum, count), v| (sum + v, count + 1));
    (count > 0).then(|| sum / count as f64)
}

/// Returns the minimum; `None` if there are no values.
fn least(values: impl Iterator<Item = f64>) -> Option<f64> {
    values.min_by(f64::total_cmp)
}

/// One selection and its accuracy.
#[derive(Clone, Debug, Default, Serialize)]
pub struct SelectionOutcome {
    /// IoU in space at the time nearest to that of the click, percent; `None` if the dataset has no volumes of ids.
    pub iou_3d: Option<f64>,
    /// That time; the one nearest to the click that has pictures can be another, see [`SelectionOutcome::at`].
    pub time_3d: Option<f64>,
    /// Minimum IoU in space over all times that have a volume.
    pub least_iou_3d: Option<f64>,
    /// Minimum IoU of the silhouettes over all times.
    pub least_iou: Option<f64>,
    /// Silhouettes and pictures at the time nearest to that of the click.
    pub at: Option<TimeRow>,
    /// The setting in words.
    pub setting: String,
    /// Mask scale and cosine that a field was queried with, at the first click.
    pub asked: Option<(f32, f32)>,
    /// Intersection over union in the clicked view, in [0, 1], by which an oracle chose the setting.
    pub fit: Option<f64>,
    /// Number of clicks used.
    pub clicks: usize,
    /// Number of Gaussians selected.
    pub gaussians: usize,
    /// Their indices, ascending.
    #[serde(skip)]
    pub members: Vec<u32>,
    /// Seconds from a click to a segment: those to the selection, the minimum over all clicks (and over all settings
    /// that an oracle tried), and, for fields, those to propagate it to the other times.
    pub click_seconds: f64,
    /// Scores in space at each time.
    pub volumes: Vec<VolumeScore>,
    /// Silhouettes and pictures at each time, for tracking.
    pub times: Vec<TimeRow>,
}

impl SelectionOutcome {
    /// Fills in the results from views, `scores`, and from volumes; `time` is that of the click.
    pub(super) fn fill(&mut self, time: f64, scores: &[FrameScore], volumes: Vec<VolumeScore>) {
        let mut times: Vec<f64> = scores.iter().map(|s| s.time).collect();
        times.sort_by(f64::total_cmp);
        times.dedup();
        let row = |t: f64| TimeRow::mean(t, &scores.iter().filter(|s| s.time == t).collect::<Vec<_>>());
        self.times = times.into_iter().filter_map(row).collect();
        self.at = nearest(&self.times, time, |r| r.time).cloned();
        self.least_iou = least(self.times.iter().filter_map(|r| r.iou));
        let volume = nearest(&volumes, time, |v| v.time);
        (self.iou_3d, self.time_3d) = (volume.and_then(|v| v.iou_3d), volume.map(|v| v.time));
        self.least_iou_3d = least(volumes.iter().filter_map(|v| v.iou_3d));
        self.volumes = volumes;
    }

    /// Returns the IoU of the silhouettes at the time nearest to that of the click, percent.
    pub fn iou(&self) -> Option<f64> {
        self.at.as_ref().and_then(|r| r.iou)
    }
}

/// Returns the row whose time is nearest to `time`, the first of equals; `None` if there are no rows.
pub(super) fn nearest<T>(rows: &[T], time: f64, of: impl Fn(&T) -> f64) -> Option<&T> {
    rows.iter().min_by(|a, b| (of(a) - time).abs().total_cmp(&(of(b) - time).abs()))
}

/// One segment selected by one method.
#[derive(Clone, Debug, Serialize)]
pub struct SegmentResult {
    /// Name of the known segment, or of several as one.
    pub segment: String,
    /// The method.
    pub method: SelectionMethod,
    /// The view that was clicked.
    pub view: String,
    /// Column and row of the first click.
    pub pixel: [u32; 2],
    /// Outcome with the setting that was fixed in advance.
    pub fixed: SelectionOutcome,
    /// Outcome with the best of [`TRIES`] settings in the clicked view.
    pub oracle: Option<SelectionOutcome>,
}

/// Means over the segments for which there is a value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct SelectionMeans {
    /// IoU in space at the clicked time, percent.
    pub iou_3d: Option<f64>,
    /// Minimum IoU in space of each segment.
    pub least_iou_3d: Option<f64>,
    /// IoU of silhouettes at the clicked time, percent.
    pub iou: Option<f64>,
    /// Minimum IoU of silhouettes of each segment.
    pub least_iou: Option<f64>,
    /// PSNR in decibels at the clicked time.
    pub psnr: Option<f64>,
    /// SSIM, RGB, at the clicked time.
    pub ssim: Option<f64>,
    /// LPIPS at the clicked time.
    pub lpips: Option<f64>,
}

impl SelectionMeans {
    /// Returns the means over some outcomes.
    pub fn mean(outcomes: &[&SelectionOutcome]) -> Self {
        let over = |f: &dyn Fn(&SelectionOutcome) -> Option<f64>| mean(outcomes.iter().filter_map(|o| f(o)));
        let row = |f: &dyn Fn(&TimeRow) -> Option<f64>| over(&|o| o.at.as_ref().and_then(f));
        Self {
            iou_3d: over(&|o| o.iou_3d),
            least_iou_3d: over(&|o| o.least_iou_3d),
            iou: over(&SelectionOutcome::iou),
            least_iou: over(&|o| o.least_iou),
            psnr: row(&|r| r.psnr),
            ssim: row(&|r| r.ssim),
            lpips: row(&|r| r.lpips),
        }
    }
}

/// The means of one method.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct MethodMeans {
    /// The method.
    pub method: SelectionMethod,
    /// With the fixed setting.
    pub fixed: SelectionMeans,
    /// With the oracle's setting, if it was used.
    pub oracle: Option<SelectionMeans>,
}

/// All results of an evaluation.
#[derive(Clone, Debug, Serialize)]
pub struct SegmentEvaluation {
    /// The data, filled in by the caller.
    #[serde(flatten)]
    pub data: DataId,
    /// Time of the clicks.
    pub time: f64,
    /// Source of the masks.
    pub masks: String,
    /// Number of views with masks.
    pub mask_views: usize,
    /// Seed of clusters and fields.
    pub seed: u64,
    /// Number of settings that the oracle tried for each method and click; 0 if it was not used. The fixed setting is
    /// one of them.
    pub oracle_tries: usize,
    /// Times that have a volume of ids.
    pub volume_times: Vec<f64>,
    /// Share in [0, 1] of what the volume nearest in time to the clicks shows, by opacity, that has an id; `None` without
    /// volumes. The rest can only lower the 3D IoU.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub labelled_share: Option<f64>,
    /// Names of the coarse colours.
    pub palette: Vec<String>,
    /// Seconds spent on masks and training, by method.
    pub training_seconds: BTreeMap<String, f64>,
    /// Means over the segments, method by method; unions of segments are excluded.
    pub means: Vec<MethodMeans>,
    /// Segments that no view shows at the time of the clicks, so that they could not be clicked: they are excluded from
    /// the results and the means.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub not_seen: Vec<String>,
    /// Segments that are part of something larger at some times, as they merge into it or have split off it; no id
    /// identifies their part at these times, which therefore do not count for them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub partly_known: Vec<String>,
    /// Results, segment by segment and method by method.
    pub results: Vec<SegmentResult>,
    /// Ground truth and each method's fixed setting, a row per segment.
    #[serde(skip)]
    pub pictures: Vec<(String, RgbImage)>,
    /// Number of pictures in a row.
    #[serde(skip)]
    pub columns: usize,
}

impl SegmentEvaluation {
    /// Computes the means over the results of `segments`.
    pub(super) fn take_means(&mut self, methods: &[SelectionMethod], segments: &[&str]) {
        let means = |method: &SelectionMethod| {
            let of = |r: &&SegmentResult| r.method == *method && segments.contains(&r.segment.as_str());
            let found: Vec<&SegmentResult> = self.results.iter().filter(of).collect();
            let oracle: Vec<&SelectionOutcome> = found.iter().filter_map(|r| r.oracle.as_ref()).collect();
            MethodMeans {
                method: *method,
                fixed: SelectionMeans::mean(&found.iter().map(|r| &r.fixed).collect::<Vec<_>>()),
                oracle: (self.oracle_tries == TRIES).then(|| SelectionMeans::mean(&oracle)),
            }
        };
        self.means = methods.iter().map(means).collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn score(time: f64, iou: Option<f64>, psnr: f64) -> FrameScore {
        let picture = PictureScore { psnr, ssim: 0.5, ssim_gray: 0.5, lpips: None };
        FrameScore { time, iou, picture: Some(picture) }
    }

    #[test]
    fn a_view_without_the_segment_counts_as_a_picture_and_not_as_an_overlap() {
        let scores = [score(0.5, Some(0.8), 20.0), score(0.5, None, 60.0)];
        let row = TimeRow::mean(0.5, &scores.iter().collect::<Vec<_>>()).unwrap();
        assert_eq!((row.views, row.iou_views, row.iou, row.psnr), (2, 1, Some(80.0), Some(40.0)));
        let gone = TimeRow::mean(0.5, &[&scores[1]]).unwrap();
        assert_eq!((gone.views, gone.iou, gone.psnr, gone.lpips), (1, None, Some(60.0), None));
        assert_eq!(TimeRow::mean(0.5, &[]), None);
        let union = FrameScore { time: 0.5, iou: Some(0.5), picture: None };
        assert_eq!(TimeRow::mean(0.5, &[&union]).unwrap().psnr, None);
    }

    #[test]
    fn the_clicked_time_and_the_least_over_all_times() {
        let mut out = SelectionOutcome::default();
        let volumes = [(0.0, Some(40.0)), (0.4, Some(70.0)), (1.0, None)];
        let volumes = volumes.map(|(time, iou_3d)| VolumeScore { time, iou_3d }).to_vec();
        out.fill(0.5, &[score(0.0, Some(0.3), 20.0), score(0.5, Some(0.9), 30.0), score(1.0, None, 50.0)], volumes);
        assert_eq!(
            (out.iou_3d, out.least_iou_3d, out.iou(), out.least_iou),
            (Some(70.0), Some(40.0), Some(90.0), Some(30.0))
        );
        assert_eq!((out.time_3d, out.at.map(|r| r.time)), (Some(0.4), Some(0.5)));
        let mut without = SelectionOutcome::default();
        without.fill(0.5, &[], Vec::new());
        assert_eq!((without.iou_3d, without.time_3d, without.iou(), without.times.len()), (None, None, None, 0));
    }
}
