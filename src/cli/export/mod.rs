//! `volseggs export`: the parts shared by all formats; each kind of output has its own file.

mod fields;
mod labels;
mod splats;

use super::data::DataArgs;
use super::shown::ShownArgs;
use super::time::TimeArg;
use super::values::count;
use super::{CliError, CommonArgs, command_line};
use crate::export::exporters::{Content, Exporter};
use crate::files::LockDuration;
use crate::memory::{MemoryBudget, product};
use crate::run::OpenRun;
use crate::run::export::ExportUnits;
use crate::run::fields::FieldKind;
use clap::builder::PossibleValue;
use clap::{Args, ValueEnum};
use labels::LabelArgs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

/// Bytes per entry of the list of files.
const FILE_BYTES: usize = 512;

/// Write a run's Gaussians, the labels of its segments, or fields on voxels as standard files.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs export checkpoints/first --time 0.5 --out scene.ply\n  volseggs export checkpoints/first --time 0.5 --out scene.spz\n  volseggs export checkpoints/first --time 0.5 --refit 0 --out as-trained.ply\n  volseggs export checkpoints/first --time data:150 --units physical --out at-150-s.ply\n  volseggs export checkpoints/first --frames 30 --out plys/\n  volseggs export checkpoints/first --segment red --no-edits --out red.ply\n  volseggs export checkpoints/first --time 0.5 --out labels.seg.nrrd\n  volseggs export checkpoints/first --time 0.5 --segment red.1 --segment red.2 --like volume.vti --out labels.vti\n  volseggs export checkpoints/first --format nrrd --time 0.5 --truth labels_050.nrrd\n  volseggs export checkpoints/first --fields --time 0.5 --out fields.vti              # for ParaView\n  volseggs export checkpoints/first --fields density --segment red --frames 30 --format npy --out density/\n\nThe format follows from the ending of --out: .ply, .spz, .nrrd, .seg.nrrd (which 3D Slicer opens as a segmentation), .vti or .npy.\nThe PLY follows 3DGS and opens in its viewers (SuperSplat, antimatter15, gsplat); the SPZ is about a fifth of its size, with one byte for most numbers. Both include the edits of the run; hidden Gaussians are omitted. Where viewers would draw a scene differently, its opacities, sizes and colours are refitted to them (20 seconds a file for 200,000 Gaussians at 800x800 on two cores); positions and rotations stay.\nLabels are on the voxels of the volume that the dataset was prepared from: label 1 is the first segment named, 0 is none. They describe the scene as trained, so that they match the data, or with --edited the scene with the edits of the run. The file records which.\nWithout --segment, all segments without parts are labelled, and a Gaussian counts for a group only if no part contains it; with --segment, it counts for the last one named that contains it.\nFields are on the same voxels, in the units of the data: density is the extinction coefficient, the optical depth per length; velocity (of the trained deformation), colour and luminance are means of the Gaussians there, weighted by density, and 0 where there are none.\nA file or folder written by volseggs is replaced; anything else is refused."
)]
pub struct ExportArgs {
    /// Folder of the run.
    run: PathBuf,
    /// Format, if --out does not determine it; ply for a folder.
    #[arg(long, value_enum)]
    format: Option<FormatArg>,
    /// Time in [0, 1], or a time of the data, such as data:150.
    #[arg(long, value_name = "T", default_value_t = TimeArg::Scene(0.0), allow_negative_numbers = true, conflicts_with = "frames")]
    time: TimeArg,
    /// Write this many times, evenly spaced from 0 to 1, into the folder OUT.
    #[arg(long, value_name = "N", value_parser = count)]
    frames: Option<usize>,
    /// For .ply and .spz: steps, of one view each, in which opacities, sizes and colours are refitted so that other
    /// viewers show the scene as it is shown here; 0 writes it as trained [default: 300 if they would show it
    /// differently].
    #[arg(long, value_name = "STEPS", value_parser = clap::value_parser!(u32).range(0..=100_000), allow_negative_numbers = true)]
    refit: Option<u32>,
    /// For .ply and .spz: coordinates of the Gaussians. Those of the scene are centred and scaled; the file says how to
    /// convert them (comments in .ply, the comment of the gzip stream in .spz, export.json in a folder).
    #[arg(long, value_enum)]
    units: Option<UnitsArg>,
    /// For .ply: degree of the spherical harmonics, at least that of the scene's colours; higher coefficients are 0. The
    /// loader of 3DGS opens files of degree 3 only; other viewers also open smaller ones [default: 3].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=3))]
    sh_degree: Option<u8>,
    /// Write fields on voxels (.vti, .nrrd, .npy): density, velocity, colour, luminance; without names the first three.
    #[arg(
        long,
        value_name = "NAME,...",
        num_args = 0..=1,
        value_delimiter = ',',
        default_missing_value = "density,velocity,colour"
    )]
    fields: Option<Vec<FieldKind>>,
    /// File, or folder with --frames; labels go to RUN/labels if not given.
    #[arg(long, value_name = "OUT")]
    out: Option<PathBuf>,
    #[command(flatten)]
    shown: ShownArgs,
    #[command(flatten)]
    data: DataArgs,
    #[command(flatten)]
    common: CommonArgs,
    #[command(flatten)]
    labels: LabelArgs,
}

/// An exporter as a value of --format.
#[derive(Debug, Clone, Copy, PartialEq)]
struct FormatArg(&'static Exporter);

impl ValueEnum for FormatArg {
    fn value_variants<'a>() -> &'a [Self] {
        static ALL: LazyLock<Vec<FormatArg>> = LazyLock::new(|| Exporter::all().into_iter().map(FormatArg).collect());
        &ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.0.extension).help(self.0.description))
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum UnitsArg {
    /// Those of the scene (the default).
    Scene,
    /// Those of the data, in their unit of length.
    Physical,
}

/// The exporter of a file with this name.
fn exporter_of(path: &Path) -> Option<&'static Exporter> {
    Exporter::of_extension(path.extension()?.to_str()?)
}

/// The endings of these exporters' files as words: `.ply, .spz or .vti`.
fn endings<'a>(exporters: impl IntoIterator<Item = &'a Exporter>) -> String {
    let of = |exporter: &'a Exporter| std::iter::once(&exporter.extension).chain(exporter.endings);
    let all: Vec<String> = exporters.into_iter().flat_map(of).map(|ending| format!(".{ending}")).collect();
    match all.split_last() {
        Some((last, others)) if !others.is_empty() => format!("{} or {last}", others.join(", ")),
        _ => all.concat(),
    }
}

impl ExportArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (_, device) = self.common.device()?;
        let run = match (&self.out, self.format, self.frames) {
            _ if self.fields.is_some() => OpenRun::open(&self.run, &device),
            // labels without --out are written into the run
            (None, Some(FormatArg(exporter)), frames) if exporter.labels().is_some() => {
                let work = if frames.is_some() { LockDuration::Long } else { LockDuration::Short };
                OpenRun::open_to_write(&self.run, &device, &command_line(), work)
            }
            _ => OpenRun::open(&self.run, &device),
        }?;
        let run = self.data.apply_to(run)?;
        let format = self.format()?;
        self.check(format)?;
        match (&self.fields, &format.content) {
            (Some(kinds), Content::Voxels { fields: Some(write), .. }) => {
                fields::run(&self, &run, kinds, format.extension, *write)
            }
            (Some(_), _) => Err(CliError::input(
                "--fields: are on voxels; end the name of --out in .vti, .nrrd or .npy, or pass --format with a folder",
            )),
            (None, Content::Gaussians { .. }) => splats::run(&self, &run, format),
            (None, Content::Voxels { labels: Some(write), states_space, .. }) => {
                labels::run(&self, &run, format.extension, *write, *states_space)
            }
            (None, Content::Voxels { .. }) => Err(CliError::input(format!(
                "--out: .{} holds fields; add --fields, or end the name in .ply, .nrrd or .vti",
                format.extension
            ))),
        }
    }

    /// Rejects options that are not for this format.
    fn check(&self, format: &Exporter) -> Result<(), CliError> {
        let splats = format.holds_gaussians();
        for (flag, given) in [("--refit", self.refit.is_some()), ("--units", self.units.is_some())] {
            if given && !splats {
                return Err(CliError::input(format!(
                    "{flag}: only for Gaussians; end the name of --out in {}",
                    endings(Exporter::all().into_iter().filter(|e| e.holds_gaussians()))
                )));
            }
        }
        let has_degree = matches!(format.content, Content::Gaussians { has_sh_degree: true, .. });
        if self.sh_degree.is_some() && !has_degree {
            return Err(CliError::input(
                "--sh-degree: only for .ply; .spz files hold the degree of the scene's colours",
            ));
        }
        Ok(())
    }

    /// The coordinates of Gaussians.
    fn units(&self, run: &OpenRun) -> Result<ExportUnits, CliError> {
        match self.units {
            Some(UnitsArg::Physical) if run.calibration().space.is_none() => Err(CliError::input(format!(
                "--units physical: {} does not know the physical space of its data, which `volseggs prepare` records; write \
                 scene coordinates",
                run.path.display()
            ))),
            Some(UnitsArg::Physical) => Ok(ExportUnits::Physical),
            Some(UnitsArg::Scene) | None => Ok(ExportUnits::Scene),
        }
    }

    /// The format, from --format and from the extension of --out, which must agree.
    fn format(&self) -> Result<&'static Exporter, CliError> {
        let format = format_for(self.format.map(|format| format.0), self.out.as_deref(), self.frames.is_some());
        // an error about a label flag is more helpful than one about a missing format
        let may_be_gaussians = format.as_ref().map_or(true, |format| format.holds_gaussians())
            && self.format.is_none_or(|format| format.0.holds_gaussians());
        if let (true, Some(flag)) = (may_be_gaussians, self.labels.given().filter(|_| self.fields.is_none())) {
            return Err(CliError::input(format!(
                "{flag}: only for labels on voxels; pass --format nrrd or --format vti, or end the name of --out in .nrrd or \
                 .vti"
            )));
        }
        format.map_err(CliError::input)
    }

    /// The times to write.
    fn times(&self, run: &OpenRun) -> Result<Vec<f64>, CliError> {
        let Some(n) = self.frames else { return Ok(vec![self.time.to_scene_time("--time", run.calibration())?]) };
        MemoryBudget::now().check(format!("--frames {n}"), product(&[n, FILE_BYTES])).map_err(CliError::input)?;
        Ok((0..n).map(|i| i as f64 / (n - 1).max(1) as f64).collect())
    }
}

/// The format of `out`, which is a folder if there are `many` files.
fn format_for(asked: Option<&'static Exporter>, out: Option<&Path>, many: bool) -> Result<&'static Exporter, String> {
    let shown = out.unwrap_or(Path::new("")).display();
    match (asked, out, out.and_then(exporter_of)) {
        (_, Some(_), Some(ending)) if many => Err(format!(
            "--out {shown}: must be a folder with --frames; omit the extension, and pass --format {}",
            ending.extension
        )),
        (Some(asked), _, Some(ending)) if asked != ending => Err(format!(
            "--format {}: does not agree with --out {shown}; omit --format, or end the name in .{0}",
            asked.extension
        )),
        (Some(asked), _, _) => Ok(asked),
        (None, _, Some(ending)) => Ok(ending),
        (None, Some(_), None) if many => Ok(Exporter::all()[0]),
        (None, Some(_), None) => Err(format!(
            "--out {shown}: the extension names no format; use {}, or pass --format",
            endings(Exporter::all())
        )),
        (None, None, _) => Err("--out: give the file to write, such as --out scene.ply; or pass --format nrrd or \
                                --format vti for labels in RUN/labels"
            .into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_format_follows_from_the_ending() {
        let [ply, spz, nrrd, vti] = ["ply", "spz", "nrrd", "vti"].map(|e| Exporter::of_extension(e).unwrap());
        let file = |asked, out: &str| format_for(asked, Some(Path::new(out)), false);
        for (out, format) in [("a.ply", ply), ("b.spz", spz), ("a.NRRD", nrrd), ("a/b.seg.nrrd", nrrd), ("a.vti", vti)]
        {
            assert_eq!((file(None, out), file(Some(format), out)), (Ok(format), Ok(format)), "{out}");
        }
        assert!(file(Some(vti), "lab.nrrd").unwrap_err().contains("--format vti: does not agree with --out lab.nrrd"));
        assert!(file(Some(ply), "scene.vti").is_err());
        for out in ["scene", "scene.obj", ".ply"] {
            assert!(
                file(None, out).unwrap_err().contains("use .ply, .spz, .nrrd, .seg.nrrd, .vti or .npy, or pass"),
                "{out}"
            );
            assert_eq!(file(Some(ply), out), Ok(ply), "{out}");
        }
        let folder = |asked, out: &str| format_for(asked, Some(Path::new(out)), true);
        assert_eq!((folder(None, "plys"), folder(Some(vti), "plys")), (Ok(ply), Ok(vti)));
        assert!(folder(None, "x.vti").unwrap_err().contains("--format vti"));
        assert_eq!(format_for(Some(nrrd), None, true), Ok(nrrd));
        assert!(format_for(None, None, false).unwrap_err().contains("--out scene.ply"));
    }
}
