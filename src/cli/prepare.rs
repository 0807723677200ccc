//! `volseggs prepare`

use super::{CliError, print_json, stop_flag};
use crate::data::paths::{Axis, RADIUS};
use crate::prepare::views::{Times, ViewOptions};
use crate::prepare::{PrepareError, PrepareOptions, SegmentOptions, Source, image_count, prepare};
use crate::volume::raycast::DEFAULT_STEP;
use crate::volume::series::{Series, SeriesOptions};
use crate::volume::synthetic::Synthetic;
use crate::volume::transfer::TransferFunction;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use std::path::PathBuf;

/// Render a time-varying volume into a dataset: images, cameras, and segments where labels are known.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs prepare --volume 'run/*.nrrd' --transfer-function fire --out data/run\n  volseggs prepare --volume u8.raw --transfer-function my.toml --size 400 --views 12 --out data/one\n  volseggs prepare --volume v.vti --labels l.vti --label-names 1=core,2=shell --out data/labelled\n  volseggs prepare --synthetic vortices --size 400 --out data/vortices\n\nVolumes: .raw/.bin/.dat (with a .toml or .json beside: dims, type), .nrrd/.nhdr, .vti, .nii/.nii.gz, .npy.\nThe defaults are the paper's: 600 views of 800x800 on a Fibonacci sphere at 30 times, 181 test views on a spiral."
)]
pub struct PrepareArgs {
    /// Volume files in order of time, a folder, a glob in quotes, or one 4D file.
    #[arg(long, value_name = "PATH", num_args = 1.., required_unless_present = "synthetic", conflicts_with = "synthetic")]
    volume: Vec<String>,
    /// A synthetic scene with known segments: jets, vortices or shells.
    #[arg(long, value_name = "NAME")]
    synthetic: Option<Synthetic>,
    /// Transfer function: a .toml file, a ParaView colour map (.json) or a preset (see configs/transfer-functions).
    #[arg(long, value_name = "TF")]
    transfer_function: Option<String>,
    /// Label volumes (whole numbers, 0 is none), as many as volumes.
    #[arg(long, value_name = "PATH", num_args = 1..)]
    labels: Vec<String>,
    /// Names of labels, such as 1=core,2=shell.
    #[arg(long, value_name = "ID=NAME", value_delimiter = ',', value_parser = label_name)]
    label_names: Vec<(u16, String)>,
    /// Folder of the dataset; must not be there yet.
    #[arg(long, value_name = "DATASET")]
    out: PathBuf,
    /// Replace a dataset that is there.
    #[arg(long)]
    replace: bool,
    /// Image size in pixels: 800, or 640x480.
    #[arg(long, default_value = "800", value_parser = image_size)]
    size: [u32; 2],
    /// Whole horizontal field of view, degrees.
    #[arg(long, default_value_t = 30.0, value_name = "DEGREES")]
    fov: f64,
    /// Distance of the cameras from the centre.
    #[arg(long, default_value_t = RADIUS)]
    radius: f64,
    /// Length of the volume's longest side; half of the frame's width if not given.
    #[arg(long)]
    side: Option<f64>,
    /// Times that training sees, evenly spread over the series.
    #[arg(long, default_value_t = 30, value_name = "N")]
    times: usize,
    /// Steps that training sees, from 0, in place of --times.
    #[arg(long, value_name = "STEP,...", value_delimiter = ',')]
    steps: Vec<usize>,
    /// Training views of each of these times.
    #[arg(long, default_value_t = 20, value_name = "N")]
    views: usize,
    /// Test views on the spiral, over all times.
    #[arg(long, default_value_t = 181, value_name = "N")]
    test_views: usize,
    /// Training views near the x, y or z axis only, as in the paper's last table.
    #[arg(long, value_name = "AXIS")]
    bias: Option<Axis>,
    /// How near to it, degrees.
    #[arg(long, default_value_t = 30.0, value_name = "DEGREES")]
    bias_angle: f64,
    /// Seed of the deal of views to times.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Distance of samples along a ray, in voxels.
    #[arg(long, default_value_t = DEFAULT_STEP, value_name = "VOXELS")]
    sample_step: f64,
    /// Time of each step, in any unit, ascending; evenly spaced if not given.
    #[arg(long, value_name = "T,...", value_delimiter = ',')]
    time_values: Vec<f64>,
    /// Accept a series with numbers missing.
    #[arg(long)]
    allow_gaps: bool,
    /// Value in place of NaN and infinite voxels.
    #[arg(long, value_name = "VALUE", allow_hyphen_values = true)]
    nan: Option<f32>,
    /// Voxels of a synthetic scene along each axis.
    #[arg(long, default_value_t = 128, value_name = "N")]
    dims: usize,
    /// Steps of a synthetic scene.
    #[arg(long, default_value_t = 100, value_name = "N")]
    series_steps: usize,
    /// Test views, evenly spaced, in which each known segment is rendered alone; 0 for none.
    #[arg(long, default_value_t = 19, value_name = "N")]
    segment_views: usize,
    /// Steps at which segments are rendered; each view's own if not given.
    #[arg(long, value_name = "STEP,...", value_delimiter = ',')]
    segment_steps: Vec<usize>,
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
        let options = self.options(&source)?;
        errln!(
            "{}; transfer function {}; {} images of {}x{}",
            source.describe(),
            transfer.name,
            image_count(&source, &options),
            self.size[0],
            self.size[1]
        );
        if let Source::Files { series, .. } = &source {
            series.notes().iter().for_each(|n| errln!("note: {n}"));
        }
        let stop = stop_flag("stopping; nothing is written")?;
        let bar = ProgressBar::new(image_count(&source, &options) as u64);
        if let Ok(style) = ProgressStyle::with_template("{bar:28} {pos}/{len} images {elapsed}<{eta} {per_sec}") {
            bar.set_style(style);
        }
        let record =
            prepare(&source, &transfer, &options, &self.out, &|n| bar.set_position(n as u64), &stop).map_err(|e| {
                match e {
                    PrepareError::Volume(_) | PrepareError::Data(_) | PrepareError::Options(_) => CliError::input(e),
                    PrepareError::Replace(e) => e.into(),
                    PrepareError::Write { .. } | PrepareError::Interrupted => CliError::failure(e),
                }
            })?;
        bar.finish_and_clear();
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
            self.out.display()
        );
        if self.json { print_json(&record) } else { Ok(()) }
    }

    fn source(&self) -> Result<Source, CliError> {
        if let Some(scene) = self.synthetic {
            if !(2..=1024).contains(&self.dims) || self.series_steps == 0 {
                return Err(CliError::input("--dims: 2 to 1024 voxels; --series-steps: at least 1"));
            }
            return Ok(Source::Synthetic { scene, dims: [self.dims; 3], steps: self.series_steps });
        }
        let options = SeriesOptions {
            nan_as: self.nan,
            allow_gaps: self.allow_gaps,
            times: (!self.time_values.is_empty()).then(|| self.time_values.clone()),
        };
        let series = Series::open(&self.volume, &options).map_err(CliError::input)?;
        let labels = if self.labels.is_empty() {
            None
        } else {
            let labels = Series::open(&self.labels, &options).map_err(CliError::input)?;
            if labels.len() != series.len() || labels.grid().dims != series.grid().dims {
                return Err(CliError::input(format!(
                    "--labels: {} steps of {:?} voxels, the volumes have {} of {:?}; give labels of the same shape",
                    labels.len(),
                    labels.grid().dims,
                    series.len(),
                    series.grid().dims
                )));
            }
            Some(Box::new(labels))
        };
        Ok(Source::Files { series: Box::new(series), labels, names: self.label_names.clone() })
    }

    fn transfer(&self) -> Result<TransferFunction, CliError> {
        match (&self.transfer_function, self.synthetic) {
            (Some(spec), _) => TransferFunction::load(spec).map_err(CliError::input),
            (None, Some(scene)) => scene.transfer_function().map_err(CliError::failure),
            (None, None) => {
                errln!("note: no --transfer-function, the preset `ramp` is used");
                TransferFunction::load("ramp").map_err(CliError::input)
            }
        }
    }

    fn options(&self, source: &Source) -> Result<PrepareOptions, CliError> {
        if let Some(step) = self.segment_steps.iter().find(|s| **s >= source.len()) {
            return Err(CliError::input(format!("--segment-steps {step}: the series has {} steps", source.len())));
        }
        let side = self.side.unwrap_or_else(|| self.radius * (0.5 * self.fov).to_radians().tan());
        if !(side.is_finite() && side > 0.0) {
            return Err(CliError::input(format!("--side {side}: a positive length")));
        }
        if !(self.bias_angle > 0.0 && self.bias_angle <= 90.0) {
            return Err(CliError::input(format!("--bias-angle {}: above 0, at most 90 degrees", self.bias_angle)));
        }
        let times = if self.steps.is_empty() { Times::Count(self.times) } else { Times::Steps(self.steps.clone()) };
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
                steps: self.segment_steps.clone(),
                label_images: !self.no_label_images,
            },
            replace: self.replace,
            needed: self.transfer_function.iter().map(PathBuf::from).collect(),
        })
    }
}

fn image_size(text: &str) -> Result<[u32; 2], String> {
    let side = |s: &str| s.parse::<u32>().ok().filter(|n| *n > 0);
    let size = match text.split_once('x') {
        Some((w, h)) => side(w).zip(side(h)).map(|(w, h)| [w, h]),
        None => side(text).map(|n| [n, n]),
    };
    size.ok_or_else(|| "a number of pixels such as 800, or 640x480".to_owned())
}

fn label_name(text: &str) -> Result<(u16, String), String> {
    let fault = || format!("`{text}`: write ID=NAME, such as 1=core");
    let (id, name) = text.split_once('=').ok_or_else(fault)?;
    let id = id.trim().parse::<u16>().ok().filter(|i| *i > 0).ok_or_else(fault)?;
    let name = name.trim();
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    if name.is_empty() || !name.chars().all(plain) {
        return Err(format!("`{text}`: names hold letters, digits, - and _, as they become folders"));
    }
    Ok((id, name.to_owned()))
}
