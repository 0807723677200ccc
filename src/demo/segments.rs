//! The demo's segmentation and tracking: each known segment is selected by one click, measured, and tracked over time.

use super::FOV;
use crate::data::Truth;
use crate::data::paths::{Lens, RADIUS, orbit};
use crate::draw::plot::{PlotSeries, line_plot};
use crate::draw::views::view_sheet;
use crate::eval::segments::{
    LiftedField, SegmentEvalOptions, SegmentEvaluation, SelectionMethod, evaluate_segments, write_results,
};
use crate::export::images::to_rgb8;
use crate::files::AtomicDir;
use crate::model::{HostGaussians, ToKernel};
use crate::name::Name;
use crate::run::segments::{RunSegments, by_colour};
use crate::run::{OpenRun, RunError, affinity};
use crate::segment::pictures::draw;
use crate::segment::segmentation::{Segment, SegmentOrigin, Segmentation};
use crate::track::follow::{FollowOptions, SegmentToTrack, TrackedSegment, follow};
use image::RgbImage;
use std::path::Path;

/// Views with masks, steps of the affinity field and pixels per step: enough for images of the demo's size.
const MASK_VIEWS: usize = 20;
const STEPS: usize = 2000;
const PIXELS: usize = 1024;
/// Number of times at which segments are tracked, and of those with pictures.
const TIMES: usize = 31;
const SHOWN_TIMES: usize = 6;
/// Width of a tracking picture in pixels.
const WIDTH: u32 = 160;

/// The report's results on segments.
pub(super) struct SegmentStory {
    /// Selections compared with the ground truth.
    pub evaluation: SegmentEvaluation,
    /// Rows of ground truth and methods.
    pub sheet: RgbImage,
    /// Each selected segment over time.
    pub followed: Vec<TrackedSegment>,
    /// Pictures of each over time.
    pub tracks: RgbImage,
}

impl SegmentStory {
    /// Intersection over union of the two-level method at each time, one curve for each segment.
    pub fn iou_over_time(&self) -> String {
        let of_method = self.evaluation.results.iter().filter(|r| r.method == SelectionMethod::CoarseFine);
        let points = of_method.map(|r| PlotSeries {
            name: r.segment.clone(),
            points: r.fixed.times.iter().filter_map(|row| Some((row.time, row.iou?))).collect(),
        });
        line_plot("Tracked segments against the ground truth", "time", "IoU, %", &points.collect::<Vec<_>>())
    }

    /// Volume of each tracked segment over time.
    pub fn volume_over_time(&self) -> String {
        let series: Vec<PlotSeries> = self
            .followed
            .iter()
            .map(|f| PlotSeries {
                name: f.name.clone(),
                points: f.statistics.iter().map(|s| (s.time, s.volume)).collect(),
            })
            .collect();
        line_plot("Volume of each segment", "time", "cubic scene units", &series)
    }
}

/// Saves the colours and what the demo selected as the run's segments, and the affinity field, by which clicks select
/// more, unless the user has made other segments since an earlier demo.
fn save(run: &OpenRun, found: &Segmentation, lifted: Option<LiftedField>, time: f64) -> Result<(), RunError> {
    let (mut own, _) = RunSegments::replacing(run);
    let first = own.now().segments.is_empty();
    if !first && own.now().segments != found.segments {
        errln!("note: the segments of {} are kept, as they are not those of the demo", run.path.display());
        return Ok(());
    }
    if first {
        own.change("demo", found.segments.clone());
        own.save()?;
    }
    if let Some(LiftedField { field, frame, spreads }) = lifted.filter(|_| first || !run.paths().affinity().exists()) {
        affinity::save(run, &field, frame, time, spreads)?;
    }
    Ok(())
}

/// Segments, measures and tracks; writes `segments/` and `eval/segments/` of the run.
pub(super) fn segments(run: &OpenRun, data: &Path) -> Result<SegmentStory, String> {
    let scene = &run.scene;
    let truth = Truth::read(data).map_err(|e| e.to_string())?;
    let plan = SegmentEvalOptions {
        methods: vec![SelectionMethod::Coarse, SelectionMethod::CoarseFine],
        oracle: false,
        views: MASK_VIEWS,
        fine_steps: Some(STEPS),
        pixels: Some(PIXELS),
        segment: run.config.segment.clone(),
        ..SegmentEvalOptions::default()
    };
    let work = AtomicDir::create(&run.paths().eval().join("masks")).map_err(|e| e.to_string())?;
    let widening = run.widening();
    let (evaluation, trained) =
        evaluate_segments(scene, widening, &truth, &plan, &[], work.dir(), |what| errln!("    {what}"))
            .map_err(|e| e.to_string())?;
    write_results(&run.paths().eval().join("segments"), &evaluation).map_err(|e| e.to_string())?;

    let mut found = by_colour(run, trained.coarse(), evaluation.time).map_err(|e| e.to_string())?;
    let mut clicked = Vec::new();
    let chosen =
        evaluation.results.iter().filter(|r| r.method == SelectionMethod::CoarseFine && !r.fixed.members.is_empty());
    let levels = &run.config.segment.levels;
    for result in chosen {
        let colour = found.free_colour();
        let name = Name::new(result.segment.clone()).map_err(|e| e.to_string())?;
        let members = result.fixed.members.clone();
        let (scale, threshold) = result.fixed.asked.unwrap_or((levels.scale, levels.cosine));
        let origin = SegmentOrigin::Pick { scale, threshold };
        let parent = found.whole_of(&members).map(|whole| whole.name.clone());
        let segment = Segment { name, parent, colour, time: evaluation.time, origin, members };
        clicked.push(segment.clone());
        found.add(segment).map_err(|e| e.to_string())?;
    }
    save(run, &found, trained.parts, evaluation.time).map_err(|e| e.to_string())?;

    let times: Vec<f64> = (0..TIMES).map(|i| i as f64 / (TIMES - 1) as f64).collect();
    let wanted: Vec<SegmentToTrack<'_>> =
        clicked.iter().map(|s| SegmentToTrack { name: &s.name, members: &s.members, time: s.time }).collect();
    let lens = Lens { fov_x: FOV, width: WIDTH, height: WIDTH };
    let camera = orbit(8, RADIUS, 0.35, lens)[0].to_kernel();
    let alone = |at: &HostGaussians, members: &[u32]| {
        let image = draw(&at.subset(members), scene.spec.rendering().seen_by(camera), &run.device());
        to_rgb8(&image, WIDTH as usize, WIDTH as usize)
    };
    let mut frame = 0;
    let mut pictures: Vec<Vec<(String, RgbImage)>> = vec![Vec::new(); wanted.len()];
    let at = |time: f64| {
        let at = scene.host_at(time as f32);
        if frame % ((TIMES - 1) / (SHOWN_TIMES - 1)) == 0 {
            for (segment, pictures) in wanted.iter().zip(&mut pictures) {
                pictures.push((format!("{} {time:.1}", segment.name), alone(&at, segment.members)));
            }
        }
        frame += 1;
        Some(at.widened(widening))
    };
    let followed = follow(at, &wanted, &[], &times, &FollowOptions::within(scene.spec.centre, scene.spec.half_size))
        .map_err(|e| e.to_string())?;
    let followed = followed.unwrap_or_default();
    let tracks = view_sheet(&pictures.concat(), SHOWN_TIMES, WIDTH);
    let sheet = view_sheet(&evaluation.pictures, evaluation.columns, 2 * WIDTH);
    Ok(SegmentStory { evaluation, sheet, followed, tracks })
}
