//! `volseggs export`: the parts shared by all formats; each kind of output has its own file.

mod fields;
mod labels;
mod splats;

use super::data::DataArgs;
use super::shown::ShownArgs;
use super::time::TimeArg;
use super::values::count;
use super::{CliError, Common, command_line};
use crate::files::Work;
use crate::memory::{Budget, product};
use crate::run::OpenRun;
use crate::run::export::{LabelFormat, SplatFormat, Units};
use crate::run::fields::FieldKind;
use clap::{Args, ValueEnum};
use labels::LabelArgs;
use std::path::{Path, PathBuf};

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
    format: Option<Format>,
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
    common: Common,
    #[command(flatten)]
    labels: LabelArgs,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Binary PLY in the 3DGS layout.
    Ply,
    /// Niantic's compressed splats, about a fifth of a PLY.
    Spz,
    /// Labels of segments or fields on voxels, for 3D Slicer and others.
    Nrrd,
    /// Labels of segments or fields on voxels, for VTK and ParaView.
    Vti,
    /// Fields on voxels, for NumPy.
    Npy,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum UnitsArg {
    /// Those of the scene (the default).
    Scene,
    /// Those of the data, in their unit of length.
    Physical,
}

impl Format {
    /// The format of a file with this name.
    fn of(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        [Self::Ply, Self::Spz, Self::Nrrd, Self::Vti, Self::Npy].into_iter().find(|f| f.extension() == extension)
    }

    fn extension(self) -> &'static str {
        match self {
            Self::Ply => SplatFormat::Ply.extension(),
            Self::Spz => SplatFormat::Spz.extension(),
            Self::Nrrd => LabelFormat::Nrrd(None).extension(),
            Self::Vti => LabelFormat::Vti.extension(),
            Self::Npy => "npy",
        }
    }
}

impl ExportArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (_, device) = self.common.device()?;
        let run = match (&self.out, self.format, self.frames) {
            _ if self.fields.is_some() => OpenRun::open(&self.run, &device),
            // labels without --out are written into the run
            (None, Some(Format::Nrrd | Format::Vti), None) => {
                OpenRun::open_to_write(&self.run, &device, &command_line(), Work::Short)
            }
            (None, Some(Format::Nrrd | Format::Vti), Some(_)) => {
                OpenRun::open_to_write(&self.run, &device, &command_line(), Work::Long)
            }
            _ => OpenRun::open(&self.run, &device),
        }?;
        let run = self.data.of(run)?;
        let format = self.format()?;
        self.check(format)?;
        match (&self.fields, format) {
            (Some(kinds), Format::Nrrd | Format::Vti | Format::Npy) => return fields::run(&self, &run, kinds, format),
            (Some(_), Format::Ply | Format::Spz) => {
                return Err(CliError::input(
                    "--fields: are on voxels; end the name of --out in .vti, .nrrd or .npy, or pass --format with a folder",
                ));
            }
            (None, Format::Npy) => {
                return Err(CliError::input(
                    "--out: .npy holds fields; add --fields, or end the name in .ply, .nrrd or .vti",
                ));
            }
            (None, _) => {}
        }
        match format {
            Format::Ply => splats::run(&self, &run, SplatFormat::Ply),
            Format::Spz => splats::run(&self, &run, SplatFormat::Spz),
            Format::Nrrd => labels::run(&self, &run, LabelFormat::Nrrd(self.labels.space())),
            Format::Vti | Format::Npy => labels::run(&self, &run, LabelFormat::Vti),
        }
    }

    /// Rejects options that are not for this format.
    fn check(&self, format: Format) -> Result<(), CliError> {
        let splats = matches!(format, Format::Ply | Format::Spz);
        for (flag, given) in [("--refit", self.refit.is_some()), ("--units", self.units.is_some())] {
            if given && !splats {
                return Err(CliError::input(format!(
                    "{flag}: only for Gaussians; end the name of --out in .ply or .spz"
                )));
            }
        }
        if self.sh_degree.is_some() && format != Format::Ply {
            return Err(CliError::input(
                "--sh-degree: only for .ply; .spz files hold the degree of the scene's colours",
            ));
        }
        Ok(())
    }

    /// The coordinates of Gaussians.
    fn units(&self, run: &OpenRun) -> Result<Units, CliError> {
        match self.units {
            Some(UnitsArg::Physical) if run.calibration().space.is_none() => Err(CliError::input(format!(
                "--units physical: {} does not know the physical space of its data, which `volseggs prepare` records; write \
                 scene coordinates",
                run.path.display()
            ))),
            Some(UnitsArg::Physical) => Ok(Units::Physical),
            Some(UnitsArg::Scene) | None => Ok(Units::Scene),
        }
    }

    /// The format, from --format and from the extension of --out, which must agree.
    fn format(&self) -> Result<Format, CliError> {
        let format = format_for(self.format, self.out.as_deref(), self.frames.is_some());
        // an error about a label flag is more helpful than one about a missing format
        if let (Ok(Format::Ply | Format::Spz) | Err(_), None | Some(Format::Ply | Format::Spz), Some(flag)) =
            (&format, self.format, self.labels.given().filter(|_| self.fields.is_none()))
        {
            return Err(CliError::input(format!(
                "{flag}: only for labels on voxels; pass --format nrrd or --format vti, or end the name of --out in .nrrd or \
                 .vti"
            )));
        }
        format.map_err(CliError::input)
    }

    /// The times to write.
    fn times(&self, run: &OpenRun) -> Result<Vec<f64>, CliError> {
        let Some(n) = self.frames else { return Ok(vec![self.time.of("--time", run.calibration())?]) };
        Budget::now().check(format!("--frames {n}"), product(&[n, FILE_BYTES])).map_err(CliError::input)?;
        Ok((0..n).map(|i| i as f64 / (n - 1).max(1) as f64).collect())
    }
}

/// The format of `out`, which is a folder if there are `many` files.
fn format_for(asked: Option<Format>, out: Option<&Path>, many: bool) -> Result<Format, String> {
    let shown = out.unwrap_or(Path::new("")).display();
    match (asked, out, out.and_then(Format::of)) {
        (_, Some(_), Some(ending)) if many => Err(format!(
            "--out {shown}: must be a folder with --frames; omit the extension, and pass --format {}",
            ending.extension()
        )),
        (Some(asked), _, Some(ending)) if asked != ending => Err(format!(
            "--format {}: does not agree with --out {shown}; omit --format, or end the name in .{0}",
            asked.extension()
        )),
        (Some(asked), _, _) => Ok(asked),
        (None, _, Some(ending)) => Ok(ending),
        (None, Some(_), None) if many => Ok(Format::Ply),
        (None, Some(_), None) => Err(format!(
            "--out {shown}: the extension names no format; use .ply, .spz, .nrrd, .seg.nrrd, .vti or .npy, or pass --format"
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
        use Format::{Nrrd, Ply, Spz, Vti};
        let file = |asked, out: &str| format_for(asked, Some(Path::new(out)), false);
        for (out, format) in [("a.ply", Ply), ("b.spz", Spz), ("a.NRRD", Nrrd), ("a/b.seg.nrrd", Nrrd), ("a.vti", Vti)]
        {
            assert_eq!((file(None, out), file(Some(format), out)), (Ok(format), Ok(format)), "{out}");
        }
        assert!(file(Some(Vti), "lab.nrrd").unwrap_err().contains("--format vti: does not agree with --out lab.nrrd"));
        assert!(file(Some(Ply), "scene.vti").is_err());
        for out in ["scene", "scene.obj", ".ply"] {
            assert!(file(None, out).unwrap_err().contains(".seg.nrrd"), "{out}");
            assert_eq!(file(Some(Ply), out), Ok(Ply), "{out}");
        }
        let folder = |asked, out: &str| format_for(asked, Some(Path::new(out)), true);
        assert_eq!((folder(None, "plys"), folder(Some(Vti), "plys")), (Ok(Ply), Ok(Vti)));
        assert!(folder(None, "x.vti").unwrap_err().contains("--format vti"));
        assert_eq!(format_for(Some(Nrrd), None, true), Ok(Nrrd));
        assert!(format_for(None, None, false).unwrap_err().contains("--out scene.ply"));
    }
}
