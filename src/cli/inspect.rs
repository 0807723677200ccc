//! `volseggs inspect`

use super::error::refuse;
use super::inspect_volume::{inspect_volume, is_volume};
use super::{CliError, print_json};
use crate::data::dataset_layout::{is_dataset, looked_for};
use crate::data::inspect::inspect;
use crate::data::layout::layout_picture;
use crate::data::{Aabb, Dataset, OpenOptions, SplitName, TruthVolume, VisualHull};
use crate::export::images::encode_png;
use crate::export::ply;
use crate::files::{RunPaths, check_file, write_named};
use crate::memory::MIB;
use crate::model::scene_file::{read_tensors, refuse_not_finite};
use crate::run::contents::{RunContents, RunItem};
use crate::train::checkpoint;
use crate::volume::formats::{READ, not_read};
use clap::Args;
use serde_json::json;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Show and check the contents of a volume, a dataset, a run, a PLY or a checkpoint.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs inspect volume.nrrd --transfer-function fire --picture histogram.png\n  volseggs inspect 'run/*.nrrd'\n  volseggs inspect DATASET --picture cameras.png\n  volseggs inspect checkpoints/first\n  volseggs inspect scene.ply --json\n\nExit code 2 if a check fails."
)]
pub struct InspectArgs {
    /// Volume file, folder or glob of volumes, dataset folder, run folder, .ply or .safetensors file.
    path: PathBuf,
    /// Transfer function to check and, with --picture, to draw over a volume's histogram: a .toml or .json file, or a
    /// preset.
    #[arg(long, value_name = "TF")]
    transfer_function: Option<String>,
    /// The array to read from .vti volumes; if not given, the one that the first file marks as active, or its first.
    #[arg(long, value_name = "NAME")]
    variable: Option<String>,
    /// Draw the camera layout of a dataset, or the histogram of a volume, into this PNG file.
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

impl InspectArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let extension = self.path.extension().and_then(|e| e.to_str());
        if let Some(picture) = &self.picture {
            if picture.extension().is_none_or(|e| !e.eq_ignore_ascii_case("png")) {
                let picture = picture.display();
                return Err(CliError::input(format!(
                    "--picture {picture}: pictures are written as PNG; use a name that ends in .png"
                )));
            }
            check_file(picture)?;
        }
        if is_dataset(&self.path) {
            self.refuse_volume_options(false)?;
            self.dataset()
        } else if RunPaths(&self.path).record().is_file() || !checkpoint::list(&self.path).is_empty() {
            // a run that was stopped at step 0 has a record, and no checkpoint yet
            self.refuse_volume_options(true)?;
            self.run_folder()
        } else if extension == Some("ply") {
            self.refuse_volume_options(true)?;
            let ply = ply::read(&self.path).map_err(CliError::input)?;
            let damaged = (0..ply.len()).filter(|i| !ply.is_finite(*i)).count();
            self.show(
                &json!({ "kind": "ply", "gaussians": ply.len(), "sh_degree": ply.sh_degree(), "not_finite": damaged }),
            )?;
            match damaged {
                0 => Ok(()),
                n => {
                    Err(CliError::input(format!("{}: {n} Gaussians hold NaN or infinite values", self.path.display())))
                }
            }
        } else if extension == Some("safetensors") {
            self.refuse_volume_options(true)?;
            if TruthVolume::is_one(&self.path) { self.truth_volume() } else { self.tensors(&self.path) }
        } else if is_volume(&self.path) {
            let (transfer, picture) = (self.transfer_function.as_deref(), self.picture.as_deref());
            inspect_volume(&self.path, transfer, self.variable.clone(), picture, self.json)
        } else if !self.path.exists() {
            Err(CliError::input(format!("{}: not found; give a volume, a dataset or a run", self.path.display())))
        } else if let Some(what) = not_read(&self.path) {
            Err(CliError::input(format!("{}: not a supported volume format: {what}", self.path.display())))
        } else {
            Err(CliError::input(format!(
                "{}: not a volume ({READ}), a dataset ({}), a run (checkpoints/), a .ply or a .safetensors file",
                self.path.display(),
                looked_for()
            )))
        }
    }

    /// Refuses options that apply to volumes only, and --picture too if `picture` says so.
    fn refuse_volume_options(&self, picture: bool) -> Result<(), CliError> {
        let flags = [
            ("--transfer-function", self.transfer_function.is_some()),
            ("--variable", self.variable.is_some()),
            ("--picture", picture && self.picture.is_some()),
        ];
        refuse(&flags, format!("{} is not a volume; omit the option", self.path.display()))
    }

    fn dataset(&self) -> Result<(), CliError> {
        let report = inspect(&self.path);
        if self.json {
            print_json(&report)?;
        } else {
            for check in &report.checks {
                outln!("{:4} {}: {}", if check.ok { "ok" } else { "FAIL" }, check.name, check.detail);
            }
            for split in &report.splits {
                let [near, far] = split.camera_radius.unwrap_or_default();
                outln!(
                    "     {}: {} frames, {} times, cameras {near:.3} to {far:.3} from the point they look at, alpha in {:.1} % of pixels",
                    split.name,
                    split.frames,
                    split.times,
                    100.0 * split.alpha_coverage.unwrap_or_default()
                );
            }
            report.problems.iter().for_each(|p| outln!("problem: {p}"));
            report.notes.iter().for_each(|n| outln!("note: {n}"));
        }
        if let Some(picture) = &self.picture {
            let options = OpenOptions { splits: &[SplitName::Train], ..OpenOptions::default() };
            let dataset = Dataset::open(&self.path, &options)?;
            let bounds: Aabb = VisualHull::carve(&dataset.train, &crate::data::hull::HullOptions::default())?.bounds;
            let image = layout_picture(&dataset.train.frames, &bounds);
            write_named(picture, &encode_png(&image).map_err(CliError::failure)?)?;
            errln!("camera layout: {}", picture.display());
        }
        if report.ok() { Ok(()) } else { Err(CliError::input(format!("{}: some checks failed", self.path.display()))) }
    }

    fn run_folder(&self) -> Result<(), CliError> {
        let found = RunContents::list(&self.path);
        if self.json {
            let mut value = serde_json::to_value(&found).map_err(CliError::failure)?;
            value["kind"] = "run".into();
            print_json(&value)?;
        } else {
            for RunItem { file, detail, ok } in &found.files {
                outln!("{:4} {file}: {detail}", if *ok { "ok" } else { "FAIL" });
            }
            if let Some(psnr) = found.test_psnr {
                outln!("     PSNR {psnr:.2} dB on the test views");
            }
            if let (Some(bytes), Some(record)) = (found.scene_bytes, &found.record) {
                outln!("     scene of {:.2} MiB, {} Gaussians", bytes as f64 / MIB, record.gaussians);
            }
            let segments: Vec<String> =
                found.segments.iter().map(|s| format!("{} ({} Gaussians)", s.name, s.gaussians)).collect();
            if !segments.is_empty() {
                outln!("     segments: {}", segments.join(", "));
            }
        }
        match found.damaged() {
            None => Ok(()),
            Some(item) => Err(CliError::input(&item.detail)),
        }
    }

    /// The ground truth of a dataset's segments at one time.
    fn truth_volume(&self) -> Result<(), CliError> {
        let volume = TruthVolume::read(&self.path)?;
        let mut cells = BTreeMap::<u16, usize>::new();
        for id in volume.ids.iter().filter(|id| **id > 0) {
            *cells.entry(*id).or_default() += 1;
        }
        let TruthVolume { time, dims, spacing, origin, .. } = volume;
        self.show(&json!({
            "kind": "segment ids", "time": time, "dims": dims, "spacing": spacing, "origin": origin, "cells_by_id": cells,
        }))
    }

    fn tensors(&self, path: &Path) -> Result<(), CliError> {
        let (tensors, metadata) = read_tensors(path).map_err(CliError::input)?;
        let shapes: serde_json::Map<String, serde_json::Value> = tensors
            .iter()
            .map(|(name, t)| {
                let finite = t.values.iter().all(|v| v.is_finite());
                (name.clone(), json!({ "shape": t.shape, "finite": finite }))
            })
            .collect();
        self.show(&json!({ "kind": "tensors", "tensors": shapes, "metadata": metadata.keys().collect::<Vec<_>>() }))?;
        refuse_not_finite(path, &tensors).map_err(CliError::input)
    }

    fn show(&self, value: &serde_json::Value) -> Result<(), CliError> {
        if self.json {
            return print_json(value);
        }
        if let Some(object) = value.as_object() {
            for (key, value) in object {
                outln!("{key}: {}", serde_json::to_string_pretty(value).map_err(CliError::failure)?);
            }
        }
        Ok(())
    }
}
