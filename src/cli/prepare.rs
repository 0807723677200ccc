//! `volseggs prepare`

use super::prepare_inputs::{ComponentArgs, ShadingArgs, segment_steps};
use super::values::{count, finite, finite_f32, number, pixels, positive};
use super::{CliError, print_json, stop_flag};
use crate::data::paths::{Axis, RADIUS};
use crate::log::progress::{ProgressLines, image_bar};
use crate::name::Name;
use crate::prepare::views::{TrainingTimes, ViewOptions};
use crate::prepare::{
    FileLabels, LENGTHS, PrepareError, PrepareOptions, PrepareSource, SegmentOptions, SegmentSteps, image_count,
    prepare,
};
use crate::shell;
use crate::versioned::Versioned;
use crate::volume::raycast::{DEFAULT_STEP, LONGEST_STEP, SHORTEST_STEP};
use crate::volume::series::{Series, SeriesOptions};
use crate::volume::synthetic::Synthetic;
use crate::volume::transfer::TransferFunction;
use clap::Args;
use std::io::IsTerminal;
use std::path::PathBuf;
use std::time::Instant;

/// Render a time-varying volume into a dataset: images, cameras, and segments if labels are known.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs prepare --volume 'run/*.nrrd' --transfer-function fire --out data/run\n  volseggs prepare --volume u8.raw --transfer-function my.toml --size 400 --views 12 --out data/one\n  volseggs prepare --volume v.vti --labels l.vti --label-names 1=core,2=shell --out data/labelled\n  volseggs prepare --volume 'run/*.nrrd' --components 0.6 --out data/parts\n  volseggs prepare --synthetic vortices --size 400 --out data/vortices\n  volseggs prepare --synthetic nested:7 --size 400 --out data/nested-7\n\nVolumes: .raw/.bin/.dat (with a .toml or .json beside it: dims, type), .nrrd/.nhdr, .vti, .nii/.nii.gz, .npy.\nThe defaults are the paper's: 600 views of 800x800 on a Fibonacci sphere at 30 times, 181 test views on a spiral."
)]
pub struct PrepareArgs {
    /// Volume files in order of time, a folder, a glob in quotes, or one 4D file.
    #[arg(long, value_name = "PATH", num_args = 1.., required_unless_present = "synthetic", conflicts_with = "synthetic")]
    volume: Vec<String>,
    /// The array to read from .vti files; if not given, the one that the first file marks as active, or its first.
    #[arg(long, value_name = "NAME", conflicts_with = "synthetic")]
    variable: Option<String>,
    /// A synthetic scene with known segments: jets, vortices, shells, layers, beads or filaments; or FAMILY:SEED, a scene
    /// drawn from a seed of blobs, touching, tubes, nested, merging, braids, onions, fading, splitting, sheets, noisy or
    /// fast.
    #[arg(long, value_name = "NAME")]
    synthetic: Option<Synthetic>,
    /// Transfer function: a .toml file, a ParaView colour map (.json) or a preset (see configs/transfer-functions).
    #[arg(long, value_name = "TF")]
    transfer_function: Option<String>,
    #[command(flatten)]
    shading: ShadingArgs,
    /// Label volumes (whole numbers, 0 is unlabelled), one per volume.
    #[arg(long, value_name = "PATH", num_args = 1.., conflicts_with = "synthetic")]
    labels: Vec<String>,
    /// The array to read from .vti files of labels, see --variable.
    #[arg(long, value_name = "NAME", requires = "labels")]
    label_variable: Option<String>,
    /// Names of labels, such as 1=core,2=shell.
    #[arg(long, value_name = "ID=NAME", value_delimiter = ',', value_parser = label_name, conflicts_with = "synthetic")]
    label_names: Vec<(u16, Name)>,
    #[command(flatten)]
    components: ComponentArgs,
    /// Folder of the dataset; it must not exist yet, unless --replace is given.
    #[arg(long, value_name = "DATASET")]
    out: PathBuf,
    /// Replace an existing dataset; nothing else is ever replaced.
    #[arg(long)]
    replace: bool,
    /// Image size in pixels: 800, or 640x480.
    #[arg(long, default_value = "800", value_parser = image_size)]
    size: [u32; 2],
    /// Horizontal field of view, full angle in degrees.
    #[arg(long, default_value_t = 30.0, value_name = "DEGREES", value_parser = fov)]
    fov: f64,
    /// Distance of the cameras from the centre.
    #[arg(long, default_value_t = RADIUS, value_name = "DISTANCE", value_parser = positive)]
    radius: f64,
    /// Length of the volume's longest side; half the shorter side of the frame, but at most the radius, if not given.
    #[arg(long, value_name = "LENGTH", value_parser = positive)]
    side: Option<f64>,
    /// Number of training times, evenly spaced over the series.
    #[arg(long, default_value_t = 30, value_name = "N", value_parser = count)]
    times: usize,
    /// Steps to use for training, from 0, instead of --times.
    #[arg(long, value_name = "STEP,...", value_delimiter = ',', allow_hyphen_values = true)]
    steps: Vec<usize>,
    /// Training views per time.
    #[arg(long, default_value_t = 20, value_name = "N", value_parser = count)]
    views: usize,
    /// Number of test views on the spiral, over all times.
    #[arg(long, default_value_t = 181, value_name = "N", value_parser = count)]
    test_views: usize,
    /// Place training views only near the x, y or z axis, as in the paper's last table.
    #[arg(long, value_name = "AXIS")]
    bias: Option<Axis>,
    /// Maximum angle to this axis, degrees.
    #[arg(long, default_value_t = 30.0, value_name = "DEGREES", value_parser = bias_angle, requires = "bias")]
    bias_angle: f64,
    /// Seed for assigning views to times.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Distance between samples along a ray, in voxels; from 1/64 to 16.
    #[arg(long, default_value_t = DEFAULT_STEP, value_name = "VOXELS", value_parser = sample_step)]
    sample_step: f64,
    /// Time of each step, in any unit, ascending; if not given, the dates in the names of the files, or else evenly
    /// spaced.
    #[arg(long, value_name = "T,...", value_delimiter = ',', value_parser = finite, allow_hyphen_values = true, conflicts_with = "synthetic")]
    time_values: Vec<f64>,
    /// Unit of --time-values, or instead of the one that a 4D file names, such as s.
    #[arg(long, value_name = "UNIT", value_parser = unit, conflicts_with = "synthetic")]
    time_unit: Option<String>,
    /// Unit of the volume's spacing and origin, such as mm, for formats that name none (or instead of theirs).
    #[arg(long, value_name = "UNIT", value_parser = unit, conflicts_with = "synthetic")]
    length_unit: Option<String>,
    /// Accept a series with missing numbers.
    #[arg(long, conflicts_with = "synthetic")]
    allow_gaps: bool,
    /// Accept a series whose origin changes: every step is placed where the first is.
    #[arg(long, conflicts_with = "synthetic")]
    ignore_origin: bool,
    /// Value that replaces NaN and infinite voxels.
    #[arg(long, value_name = "VALUE", value_parser = finite_f32, allow_hyphen_values = true, conflicts_with = "synthetic")]
    nan: Option<f32>,
    /// Voxels along each axis of a synthetic scene.
    #[arg(long, default_value_t = 128, value_name = "N", value_parser = dims, conflicts_with = "volume")]
    dims: usize,
    /// Number of steps of a synthetic scene.
    #[arg(long, default_value_t = 100, value_name = "N", value_parser = series_steps, conflicts_with = "volume")]
    series_steps: usize,
    /// Number of test views, evenly spaced, in which each known segment is rendered alone; 0 for none, and no id
    /// volumes.
    #[arg(long, default_value_t = 10, value_name = "N")]
    segment_views: usize,
    /// Steps at which segments are rendered in each of these views, or `own`: in each view the step of its test image.
    /// If not given, five steps evenly spaced over the series, moved to nearby training steps where possible.
    #[arg(long, value_name = "STEP,...|own", value_parser = segment_steps, allow_hyphen_values = true)]
    segment_steps: Option<SegmentSteps>,
    /// Write no label images.
    #[arg(long)]
    no_label_images: bool,
    /// Print one JSON object on standard output.
    #[arg(long)]
    json: bool,
}

impl PrepareArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let source = self.source()?;
        let transfer = self.transfer()?;
        let options = self.options()?;
        errln!(
            "{}; transfer function {}; {} images of {}x{}",
            source.describe(),
            transfer.name,
            image_count(&source, &options),
            self.size[0],
            self.size[1]
        );
        if let PrepareSource::Files { series, labels } = &source {
            series.notes().iter().for_each(|n| errln!("note: {n}"));
            if let FileLabels::Files { series, .. } = labels {
                series.notes().iter().for_each(|n| errln!("note: labels: {n}"));
            }
        }
        let stop = stop_flag("stopping; nothing is written")?;
        let total = image_count(&source, &options);
        let bar = image_bar(total);
        let lines = (!std::io::stderr().is_terminal()).then(|| ProgressLines::new(0, total));
        let started = Instant::now();
        let progress = |done: usize| {
            bar.set_position(done as u64);
            let seconds = started.elapsed().as_secs_f64();
            if let Some(lines) = lines.as_ref().filter(|lines| lines.is_due(done, seconds)) {
                errln!("{done}/{total} images {seconds:.0} s{}", lines.left(done, seconds, f64::INFINITY));
            }
        };
        let record = prepare(&source, &transfer, &options, &self.out, &progress, &stop).map_err(|e| match e {
            PrepareError::Exists(_) => CliError::input(format!("{e}, or pass --replace")),
            PrepareError::Replace(e) => e.into(),
            PrepareError::Write { .. } | PrepareError::Interrupted => CliError::failure(e),
            PrepareError::Volume(e) => e.into(),
            PrepareError::Data(e) => e.into(),
            PrepareError::Options(_) | PrepareError::Memory(_) | PrepareError::Empty { .. } => CliError::input(e),
        })?;
        bar.finish_and_clear();
        if let PrepareSource::Files { series, .. } = &source
            && let Some(note) = series.rounding()
        {
            errln!("note: {note}");
        }
        errln!(
            "{}: {} training and {} test views in {:.1} s, peak memory {:.2} GB{}; look at {}; next: volseggs train --data {} --config quick --out RUN",
            self.out.display(),
            record.train_views,
            record.test_views,
            record.seconds,
            record.peak_memory_bytes as f64 / 1e9,
            if record.segments.is_empty() {
                String::new()
            } else {
                format!(", segments {}", record.segments.join(", "))
            },
            self.out.join("contact-sheet.png").display(),
            shell::path(&self.out)
        );
        if !record.empty_times.is_empty() {
            let times: Vec<String> = record.empty_times.iter().take(8).map(|t| format!("{t:.3}")).collect();
            let more = if record.empty_times.len() > times.len() { ", ..." } else { "" };
            errln!(
                "note: at {} of the training times, nothing is visible in any training image: {}{more}",
                record.empty_times.len(),
                times.join(", ")
            );
        }
        if self.json { print_json(&Versioned::new(&record)) } else { Ok(()) }
    }

    fn source(&self) -> Result<PrepareSource, CliError> {
        if let Some(scene) = self.synthetic {
            return Ok(PrepareSource::Synthetic { scene, dims: [self.dims; 3], steps: self.series_steps });
        }
        let options = SeriesOptions {
            nan_as: self.nan,
            allow_gaps: self.allow_gaps,
            times: (!self.time_values.is_empty()).then(|| self.time_values.clone()),
            length_unit: self.length_unit.clone(),
            time_unit: self.time_unit.clone(),
            ignore_origin: self.ignore_origin,
            variable: self.variable.clone(),
        };
        let series = Series::open(&self.volume, &options)?;
        let labels = if let Some(parts) = self.components.labels(&series)? {
            parts
        } else if self.labels.is_empty() {
            if let Some((id, name)) = self.label_names.last() {
                return Err(CliError::input(format!(
                    "--label-names: label {id}={name}: there are no labels to name; give --labels"
                )));
            }
            FileLabels::None
        } else {
            let variable = self.label_variable.clone();
            let options = SeriesOptions { length_unit: None, time_unit: None, variable, ..options };
            let labels = Series::open(&self.labels, &options)?;
            if labels.len() != series.len() || labels.grid().dims != series.grid().dims {
                return Err(CliError::input(format!(
                    "--labels: {} steps of {:?} voxels, but the volumes have {} of {:?}; give labels of the same shape",
                    labels.len(),
                    labels.grid().dims,
                    series.len(),
                    series.grid().dims
                )));
            }
            labels.lies_on(series.grid(), series.physical().axes).map_err(|problem| {
                let name = labels.name(0);
                CliError::input(format!(
                    "--labels: {name} has {problem} as the volumes; resample the labels to the grid of the volumes"
                ))
            })?;
            FileLabels::Files { series: Box::new(labels), names: self.label_names.clone() }
        };
        Ok(PrepareSource::Files { series: Box::new(series), labels })
    }

    fn transfer(&self) -> Result<TransferFunction, CliError> {
        let mut transfer = match (&self.transfer_function, self.synthetic) {
            (Some(spec), _) => TransferFunction::load(spec)?,
            (None, Some(scene)) => scene.transfer_function().map_err(CliError::failure)?,
            (None, None) => {
                errln!("note: without --transfer-function, the preset `ramp` is used");
                TransferFunction::load("ramp")?
            }
        };
        self.shading.lighting().apply(&mut transfer.shading);
        Ok(transfer)
    }

    fn options(&self) -> Result<PrepareOptions, CliError> {
        // of the shorter side of the frame, or wide images would cut the volume off
        let shorter = (f64::from(self.size[1]) / f64::from(self.size[0])).min(1.0);
        // and at most the radius, as the cameras must stand outside the volume
        let of_frame = shorter * (0.5 * self.fov).to_radians().tan();
        let side = self.side.unwrap_or_else(|| self.radius * of_frame.min(1.0));
        if self.side.is_none() && !LENGTHS.contains(&side) {
            return Err(CliError::input(format!(
                "--radius {:?} with --fov {:?}: half the frame is {side:e} there; use lengths from {:e} to {:e}",
                self.radius,
                self.fov,
                LENGTHS.start(),
                LENGTHS.end()
            )));
        }
        let times = if self.steps.is_empty() {
            TrainingTimes::Count(self.times)
        } else {
            TrainingTimes::Steps(self.steps.clone())
        };
        Ok(PrepareOptions {
            views: ViewOptions {
                size: self.size,
                fov_x: self.fov.to_radians(),
                radius: self.radius,
                times,
                views_per_time: self.views,
                test_views: self.test_views,
                bias: self.bias.map(|axis| (axis, self.bias_angle.to_radians())),
                seed: self.seed,
            },
            side,
            step: self.sample_step,
            segments: SegmentOptions {
                views: self.segment_views,
                steps: self.segment_steps.clone().unwrap_or_default(),
                label_images: !self.no_label_images,
            },
            replace: self.replace,
            needed: self.transfer_function.iter().map(PathBuf::from).filter(|p| p.is_file()).collect(),
        })
    }
}

fn image_size(text: &str) -> Result<[u32; 2], String> {
    let size = match text.split_once('x') {
        Some((w, h)) => pixels(w).and_then(|w| Ok([w, pixels(h)?])),
        None => pixels(text).map(|n| [n, n]),
    };
    size.map_err(|wanted| format!("{wanted}, or two such as 640x480"))
}

/// A name of a unit as it may stand in headers and tables.
fn unit(text: &str) -> Result<String, String> {
    let text = text.trim();
    let plain =
        !text.is_empty() && text.chars().count() <= 32 && !text.chars().any(|c| c.is_control() || "\"\\,".contains(c));
    plain
        .then(|| text.to_owned())
        .ok_or_else(|| "expected a short name such as mm, without quotes or commas".to_owned())
}

fn fov(text: &str) -> Result<f64, String> {
    number(text, |v| (0.01..177.0).contains(&v), "an angle from 0.01 to below 177 degrees")
}

fn bias_angle(text: &str) -> Result<f64, String> {
    number(text, |v| v > 0.0 && v <= 90.0, "an angle above 0, at most 90 degrees")
}

fn sample_step(text: &str) -> Result<f64, String> {
    let wanted = format!("a number of voxels from {SHORTEST_STEP} (1/64) to {LONGEST_STEP}");
    number(text, |v| (SHORTEST_STEP..=LONGEST_STEP).contains(&v), &wanted)
}

fn whole(text: &str, range: std::ops::RangeInclusive<usize>, what: &str) -> Result<usize, String> {
    let found = text.trim().parse::<usize>().ok().filter(|n| range.contains(n));
    found.ok_or_else(|| format!("expected a number of {what} from {} to {}", range.start(), range.end()))
}

fn dims(text: &str) -> Result<usize, String> {
    whole(text, 2..=1024, "voxels")
}

fn series_steps(text: &str) -> Result<usize, String> {
    whole(text, 1..=100_000, "steps")
}

fn label_name(text: &str) -> Result<(u16, Name), String> {
    let fault = || format!("`{text}`: write ID=NAME, such as 1=core");
    let (id, name) = text.split_once('=').ok_or_else(fault)?;
    let id = id.trim().parse::<u16>().ok().filter(|i| *i > 0).ok_or_else(fault)?;
    Ok((id, Name::new(name.trim()).map_err(|e| e.to_string())?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_that_cannot_be_rendered_are_refused() {
        for bad in ["0", "200", "nan", "-3", "x"] {
            assert!(fov(bad).is_err() && bias_angle(bad).is_err(), "{bad}");
        }
        assert!(sample_step("1e-30").is_err() && sample_step("0.01").is_err() && sample_step("17").is_err());
        assert_eq!((sample_step("0.5"), fov("30"), bias_angle("90")), (Ok(0.5), Ok(30.0), Ok(90.0)));
        assert_eq!((image_size("640x480"), image_size("8")), (Ok([640, 480]), Ok([8, 8])));
        for bad in ["0", "100000", "8x", "8x99999", "x"] {
            assert!(image_size(bad).is_err(), "{bad}");
        }
        assert!(dims("1").is_err() && dims("99999").is_err() && series_steps("99999999999999").is_err());
        for bad in ["1=../up", "0=a", "1=", "a", "99999=a"] {
            assert!(label_name(bad).is_err(), "{bad}");
        }
        assert_eq!(label_name("1=core"), Ok((1, Name::new("core").unwrap())));
    }
}
