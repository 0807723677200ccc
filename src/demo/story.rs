//! The content of the demo's report: which pictures, which figures, in which order.

use super::{FOV, Results};
use crate::compare::curves;
use crate::data::paths::{Lens, RADIUS, orbit};
use crate::data::truth::{self, SegmentFile};
use crate::draw::plot::{PlotSeries, line_plot};
use crate::eval::diagnosis;
use crate::eval::results::headline_over_time;
use crate::export::images::{encode_png, to_rgb8};
use crate::memory::MIB;
use crate::metrics::metric::{MetricDisplay, display, headline};
use crate::model::ToKernel;
use crate::report::{Headline, Report, ReportBlock, ReportSection};
use crate::shell;
use crate::versioned;
use image::RgbImage;
use std::path::Path;

/// Number of frames of the turntable, and their width.
const TURNTABLE: (usize, u32) = (48, 320);

/// The pictures of the report, as PNG files.
pub(super) struct Pictures {
    turntable: Vec<Vec<u8>>,
    compare: [Vec<u8>; 2],
    compare_name: String,
    sheet: Option<Vec<u8>>,
    segments: Vec<(Vec<u8>, String)>,
}

/// Renders and reads the pictures of the report.
pub(super) fn pictures(results: &Results<'_>) -> Result<Pictures, String> {
    let png = |image: &RgbImage| encode_png(image).map_err(|e| e.to_string());
    let (frames, size) = TURNTABLE;
    let lens = Lens { fov_x: FOV, width: size, height: size };
    let last = (frames - 1) as f32;
    let turntable = orbit(frames, RADIUS, 0.35, lens)
        .iter()
        .enumerate()
        .map(|(i, camera)| {
            let image = results.run.scene.render(camera.to_kernel(), i as f32 / last);
            png(&to_rgb8(&image, size as usize, size as usize))
        })
        .collect::<Result<_, _>>()?;
    let test = &results.test;
    // the view of median quality: neither the best nor the worst
    let quality = |view: &usize| results.evaluation.views[*view].metrics.headline();
    let mut order: Vec<usize> = (0..results.evaluation.views.len()).collect();
    order.sort_by(|a, b| quality(a).total_cmp(&quality(b)));
    let median = order[order.len() / 2];
    let frame = &test.frames[median];
    let (w, h) = (test.images.width as usize, test.images.height as usize);
    let truth = test.images.composite_with_alpha(median, results.run.scene.spec.background);
    let render = results.run.scene.render(frame.camera.to_kernel(), frame.time as f32);
    let sheet = results.evaluation.sheet.as_ref().map(&png).transpose()?;
    Ok(Pictures {
        turntable,
        compare: [png(&to_rgb8(&truth, w, h))?, png(&to_rgb8(&render, w, h))?],
        compare_name: format!(
            "Test view {} at time {:.2}, {}: the median of all test views.",
            frame.name,
            frame.time,
            results.evaluation.views[median].metrics.headline_text()
        ),
        sheet,
        segments: segments(&results.data)?,
    })
}

/// Each known segment alone, in the view that shows most of it.
fn segments(data: &Path) -> Result<Vec<(Vec<u8>, String)>, String> {
    let path = data.join(truth::FILE);
    let Ok(text) = std::fs::read_to_string(&path) else { return Ok(Vec::new()) };
    let file: SegmentFile = versioned::from_json(text).map_err(|e| format!("{}: {e}", path.display()))?;
    let mut out = Vec::new();
    for segment in file.segments {
        let Some(best) = segment.frames.iter().max_by_key(|f| f.pixels) else { continue };
        let path = data.join(&best.file_path);
        let rgba = image::open(&path).map_err(|e| format!("{}: {e}", path.display()))?.to_rgba8();
        let over = RgbImage::from_fn(rgba.width(), rgba.height(), |x, y| {
            let [r, g, b, a] = rgba.get_pixel(x, y).0.map(f32::from);
            image::Rgb([r, g, b].map(|c| (c * a / 255.0 + 255.0 - a).round() as u8))
        });
        out.push((encode_png(&over).map_err(|e| e.to_string())?, format!("{}, time {:.2}", segment.name, best.time)));
    }
    Ok(out)
}

/// Learning curve: PSNR over steps, from the run's `metrics.jsonl`.
fn learning_curve(run: &Path) -> String {
    let curves = curves::read(run);
    let mean = |points: &[(f64, f64)]| -> Vec<(f64, f64)> {
        let n = (points.len() / 60).max(1);
        let mid = |c: &[(f64, f64)]| {
            let k = c.len() as f64;
            (c.iter().map(|p| p.0).sum::<f64>() / k, c.iter().map(|p| p.1).sum::<f64>() / k)
        };
        points.chunks(n).map(mid).collect()
    };
    let series = [
        PlotSeries { name: "training views".into(), points: mean(&curves.train) },
        PlotSeries { name: "test views".into(), points: curves.test },
    ];
    line_plot("Learning curve", "step", "PSNR, dB", &series)
}

/// Assembles the report.
///
/// # Errors
/// If a picture cannot be encoded.
pub(super) fn assemble(results: &Results<'_>, pictures: Pictures) -> Result<Report, String> {
    let s = &results.evaluation.summary;
    let record = &results.outcome.record;
    let fps = |digits: usize| format!("{:.digits$}", s.speed.fps);
    let number = |value: String, unit: &str, name: &str, note: &str| Headline {
        value,
        unit: unit.into(),
        name: name.into(),
        note: note.into(),
    };
    let mut numbers: Vec<Headline> = Vec::new();
    for (shown, value) in s.metrics.shown_by_default() {
        let note = if shown.note.is_empty() { format!("{} test views", s.views) } else { shown.note.to_owned() };
        numbers.push(number(format!("{value:.*}", shown.digits), shown.unit, &shown.short, &note));
    }
    numbers.extend([
        number(fps(0), "/s", "frames", "deformation recomputed for each, images left on the device"),
        number(format!("{:.0}", record.training_seconds), "s", "training", &record.device),
        number(format!("{:.1}", s.model_bytes as f64 / MIB), "MiB", "model", &format!("{} Gaussians", s.gaussians)),
    ]);
    let measured = s.metrics.in_order().into_iter().filter_map(|(name, value)| Some((display(name), value?)));
    // at least three digits, as this is the table of a single run
    let row = |(shown, value): (MetricDisplay, f64)| vec![shown.name(), format!("{value:.*}", shown.digits.max(3))];
    let mut rows: Vec<Vec<String>> = measured.map(row).collect();
    rows.extend([
        vec!["frames per second".into(), fps(1)],
        vec!["frames per second, images copied to the host".into(), format!("{:.1}", s.speed.fps_with_copy)],
    ]);
    let labels = (0..pictures.turntable.len())
        .map(|i| format!("time {:.2}", i as f64 / (pictures.turntable.len() - 1).max(1) as f64))
        .collect();
    let [truth, render] = pictures.compare;
    let total: f64 = results.stages.iter().map(|(_, seconds)| seconds).sum();
    let mut sections = vec![
        ReportSection::new(
            "scene",
            "The trained scene",
            "Rendered from the Gaussians alone, without the volume, while the camera orbits and time advances.",
            vec![
                ReportBlock::Turntable {
                    frames: pictures.turntable,
                    labels,
                    caption: "One orbit, time from 0 to 1.".into(),
                    fps: 12.0,
                },
                ReportBlock::Numbers(numbers),
            ],
        ),
        ReportSection::new(
            "quality",
            "Quality",
            "How close the renders are to the ray-cast ground truth, in unseen views and mostly at unseen times.",
            {
                let mut blocks = vec![
                    ReportBlock::Compare {
                        left: truth,
                        left_name: "ray caster".into(),
                        right: render,
                        right_name: "Gaussians".into(),
                        caption: pictures.compare_name,
                    },
                    ReportBlock::Table {
                        head: ["metric", "mean over test views"].map(String::from).to_vec(),
                        rows,
                        caption: format!("{} views of {}x{} over white, as 8-bit images", s.views, s.width, s.height),
                        highlight: Some(1),
                    },
                    ReportBlock::Table {
                        head: diagnosis::head().to_vec(),
                        rows: diagnosis::rows(s).into_iter().map(|row| row.to_vec()).collect(),
                        caption: "What limits it: training views beside unseen ones, and where in the pictures the \
                                  error lies. Edges: pixels next to a change of more than 0.1 per pixel in the truth \
                                  or its alpha; interior: the other covered pixels."
                            .into(),
                        highlight: Some(2),
                    },
                    ReportBlock::Svg {
                        svg: headline_over_time(&results.evaluation),
                        caption: format!("{} of each test view.", headline().short),
                    },
                    ReportBlock::Svg {
                        svg: learning_curve(&results.run.path),
                        caption: "PSNR during training.".into(),
                    },
                ];
                if let Some(png) = pictures.sheet {
                    blocks.push(ReportBlock::Figure {
                        png,
                        alt: "Rows of truth, render and error map".into(),
                        caption: "Truth, render and error of a few test views.".into(),
                    });
                }
                blocks
            },
        ),
    ];
    if !pictures.segments.is_empty() {
        sections.push(ReportSection::new(
            "segments",
            "Segments",
            "The scene's parts are known, so what a click selects can be measured: a click on each part at one time, \
             coarse by its colour and fine by the affinity field within it, then tracked to all other times.",
            segment_blocks(results, pictures.segments)?,
        ));
    }
    let run = shell::path(&results.options.out.join("run"));
    sections.push(ReportSection::new(
        "time",
        "Where the time went",
        "",
        vec![
            ReportBlock::Timings(results.stages.clone()),
            ReportBlock::Text(format!(
                "{total:.0} seconds in all on {} threads; peak memory {:.2} GB; {} training steps on {} images.",
                record.threads,
                crate::memory::peak_memory() as f64 / 1e9,
                record.steps,
                results.prepared.train_views
            )),
        ],
    ));
    sections.push(ReportSection::new(
        "yours",
        "Use your own data",
        "Volumes as .raw (with a small .toml), .nrrd, .vti, .nii or .npy; or posed images in the D-NeRF layout.",
        vec![ReportBlock::Commands(
            [
                ("what a volume holds", "volseggs inspect my-volume.nrrd --picture histogram.png".to_owned()),
                (
                    "volumes to images and cameras",
                    "volseggs prepare --volume 'run/*.nrrd' --transfer-function fire --size 400 --out data/mine"
                        .to_owned(),
                ),
                ("train", "volseggs train --data data/mine --config quick --out checkpoints/mine".to_owned()),
                ("measure", "volseggs eval checkpoints/mine".to_owned()),
                ("look", "volseggs render checkpoints/mine --path orbit --out frames".to_owned()),
                ("this scene for any splat viewer", format!("volseggs export {run} --time 0.5 --out scene.ply")),
            ]
            .map(|(comment, command)| (comment.to_owned(), command))
            .to_vec(),
        )],
    ));
    Ok(Report {
        title: "volseggs demo".into(),
        subtitle: format!(
            "{}, {} training views, version {}, seed {}",
            results.prepared.source, results.prepared.train_views, record.version, record.seed
        ),
        sections,
    })
}

/// Ground truth, table, pictures and curves of segmentation and tracking.
fn segment_blocks(results: &Results<'_>, known: Vec<(Vec<u8>, String)>) -> Result<Vec<ReportBlock>, String> {
    let (story, png) = (&results.segments, |image: &RgbImage| encode_png(image).map_err(|e| e.to_string()));
    let cell = |v: Option<f64>, digits: usize| v.map_or("-".to_owned(), |v| format!("{v:.digits$}"));
    let rows = story.evaluation.results.iter().map(|r| {
        let (fixed, row) = (&r.fixed, r.fixed.at.as_ref());
        vec![
            r.segment.clone(),
            r.method.to_string(),
            cell(fixed.iou_3d, 1),
            cell(fixed.least_iou_3d, 1),
            cell(fixed.iou(), 1),
            cell(fixed.least_iou, 1),
            cell(row.and_then(|row| row.psnr), 1),
            cell(row.and_then(|row| row.ssim), 3),
            format!("{:.0}", 1e3 * fixed.click_seconds),
        ]
    });
    let head = [
        "segment",
        "method",
        "3D IoU, %",
        "minimum over times, %",
        "2D IoU, %",
        "minimum over times, %",
        "PSNR, dB",
        "SSIM",
        "click, ms",
    ];
    Ok(vec![
        ReportBlock::Figures { items: known, columns: 5 },
        ReportBlock::Table {
            head: head.map(String::from).to_vec(),
            rows: rows.collect(),
            caption: format!(
                "one click at time {:.2} with the default settings; 3D: cells of the true volumes, 2D: views that were not \
                 clicked",
                story.evaluation.time
            ),
            highlight: Some(2),
        },
        ReportBlock::Figure {
            png: png(&story.sheet)?,
            alt: "Each segment: truth, coarse, coarse and fine".into(),
            caption: "Truth, and what each method selects.".into(),
        },
        ReportBlock::Figure {
            png: png(&story.tracks)?,
            alt: "Each segment at six times".into(),
            caption: "Each segment tracked through time.".into(),
        },
        ReportBlock::Svg { svg: story.iou_over_time(), caption: "IoU at each time, coarse and fine.".into() },
        ReportBlock::Svg { svg: story.volume_over_time(), caption: "Volume of each segment over time.".into() },
    ])
}
