//! `volseggs edit`: an undoable stack of edits stored beside a run's scene, which is left as trained.

mod values;

use super::values::{count, finite_f32, not_negative_f32, point, positive_f32};
use super::{CliError, CommonArgs, print_json};
use crate::data::calibration::PhysicalSpace;
use crate::edit::{Edit, EditStack, Operation};
use crate::files::LockDuration;
use crate::run::segments::HistoryDirection;
use crate::run::{OpenRun, RunError, edits};
use crate::versioned::Versioned;
use clap::{Args, Subcommand};
use glam::DVec3;
use std::path::PathBuf;
use values::colour;

/// Recolour, fade, hide or move segments, and undo such edits.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs edit recolour RUN --segment red --colour '#ff8800'\n  volseggs edit opacity RUN --segment red --segment blue --factor 0.3\n  volseggs edit isolate RUN --segment red.1\n  volseggs edit translate RUN --segment red --by 12,0,-3.5          # mm, if the data are in mm\n  volseggs edit rotate RUN --segment red --axis 0,0,1 --degrees 30\n  volseggs edit undo RUN --count 2\n  volseggs edit list RUN\n\nEdits are stored in RUN/edits.json, apply at every time, and are visible in `volseggs render` and in exported Gaussians unless --no-edits is given there; label volumes ignore them unless --edited is given."
)]
pub struct EditArgs {
    #[command(subcommand)]
    command: EditCommand,
}

/// The run, and how results are printed.
#[derive(Debug, Args)]
struct EditedRun {
    /// Folder of the run.
    run: PathBuf,
    #[command(flatten)]
    common: CommonArgs,
}

/// The segments of a run to edit.
#[derive(Debug, Args)]
struct Targets {
    /// Segment to edit; may be repeated.
    #[arg(long = "segment", value_name = "NAME", required = true)]
    segments: Vec<String>,
    #[command(flatten)]
    target: EditedRun,
}

/// The units of lengths and positions.
#[derive(Debug, Clone, Copy, Args)]
struct UnitArgs {
    /// Lengths and positions are in scene units, as in edits.json, and not in those of the data; runs whose data have
    /// no known units always take scene units.
    #[arg(long)]
    scene_units: bool,
}

impl UnitArgs {
    /// The space in which lengths and positions are given; `None` for that of the scene.
    fn space(self, run: &OpenRun) -> Option<&PhysicalSpace> {
        run.calibration().space.as_ref().filter(|_| !self.scene_units)
    }

    /// A displacement in scene units.
    fn length(self, run: &OpenRun, by: DVec3) -> [f32; 3] {
        self.space(run).map_or(by, |space| by / space.scale).as_vec3().to_array()
    }

    /// A position in scene units.
    fn position(self, run: &OpenRun, at: DVec3) -> [f32; 3] {
        let at = at.to_array();
        self.space(run).map_or(at, |space| space.to_scene(at)).map(|v| v as f32)
    }
}

#[derive(Debug, Subcommand)]
enum EditCommand {
    /// Give segments a colour.
    #[command(after_help = "Example:\n  volseggs edit recolour RUN --segment red --colour '#ff8800'")]
    Recolour {
        /// The colour, #rrggbb.
        #[arg(long, value_name = "COLOUR", value_parser = colour)]
        colour: [f32; 3],
        /// Use this colour everywhere (a headlight still shades it); otherwise variations within a segment and its
        /// shading are kept.
        #[arg(long)]
        flat: bool,
        #[command(flatten)]
        targets: Targets,
    },
    /// Multiply the opacity of segments.
    #[command(after_help = "Example:\n  volseggs edit opacity RUN --segment red --factor 0.3")]
    Opacity {
        /// Factor, at least 0; the resulting opacity is at most 0.99.
        #[arg(long, value_parser = not_negative_f32, allow_negative_numbers = true)]
        factor: f32,
        /// Also make hidden segments visible again.
        #[arg(long)]
        show: bool,
        #[command(flatten)]
        targets: Targets,
    },
    /// Make segments invisible.
    #[command(after_help = "Example:\n  volseggs edit hide RUN --segment red")]
    Hide(Targets),
    /// Make hidden segments visible again.
    #[command(after_help = "Example:\n  volseggs edit show RUN --segment red")]
    Show(Targets),
    /// Hide everything except the given segments.
    #[command(after_help = "Example:\n  volseggs edit isolate RUN --segment red --segment blue")]
    Isolate(Targets),
    /// Move segments.
    #[command(
        after_help = "Examples:\n  volseggs edit translate RUN --segment red --by 12,0,-3.5\n  volseggs edit translate RUN --segment red --by 0.2,0,-0.1 --scene-units"
    )]
    Translate {
        /// Displacement along x, y, z, in the unit of the data.
        #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
        by: DVec3,
        #[command(flatten)]
        units: UnitArgs,
        #[command(flatten)]
        targets: Targets,
    },
    /// Rotate segments.
    #[command(after_help = "Example:\n  volseggs edit rotate RUN --segment red --axis 0,0,1 --degrees -30")]
    Rotate {
        /// Rotation axis, of any non-zero length.
        #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
        axis: DVec3,
        /// Angle in degrees, right-handed about the axis.
        #[arg(long, value_parser = finite_f32, allow_negative_numbers = true)]
        degrees: f32,
        /// Point that stays fixed, in the coordinates of the data; if not given, each segment's own centre at each time.
        #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
        about: Option<DVec3>,
        #[command(flatten)]
        units: UnitArgs,
        #[command(flatten)]
        targets: Targets,
    },
    /// Make segments larger or smaller.
    #[command(after_help = "Example:\n  volseggs edit scale RUN --segment red --factor 1.5")]
    Scale {
        /// Factor, above 0.
        #[arg(long, value_parser = positive_f32, allow_negative_numbers = true)]
        factor: f32,
        /// Point that stays fixed, in the coordinates of the data; if not given, each segment's own centre at each time.
        #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
        about: Option<DVec3>,
        #[command(flatten)]
        units: UnitArgs,
        #[command(flatten)]
        targets: Targets,
    },
    /// Undo the last edits.
    #[command(after_help = "Example:\n  volseggs edit undo RUN --count 2")]
    Undo {
        /// Number of edits.
        #[arg(long, default_value_t = 1, value_parser = count)]
        count: usize,
        #[command(flatten)]
        target: EditedRun,
    },
    /// Redo the edits that were undone last.
    #[command(after_help = "Example:\n  volseggs edit redo RUN")]
    Redo {
        /// Number of edits.
        #[arg(long, default_value_t = 1, value_parser = count)]
        count: usize,
        #[command(flatten)]
        target: EditedRun,
    },
    /// List the edits in order, then the undone ones.
    #[command(after_help = "Example:\n  volseggs edit list RUN --json")]
    List(EditedRun),
    /// Delete all edits, including undone ones, even if the file cannot be read; redo cannot restore them.
    #[command(after_help = "Example:\n  volseggs edit clear RUN")]
    Clear(EditedRun),
}

impl EditArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        match self.command {
            EditCommand::Recolour { targets, colour, flat } => {
                targets.edit(|_| Operation::Recolour { rgb: colour, keep_shading: !flat })
            }
            EditCommand::Opacity { targets, factor, show } => targets.edit(|_| Operation::Opacity { factor, show }),
            EditCommand::Hide(targets) => targets.edit(|_| Operation::Hide),
            EditCommand::Show(targets) => targets.edit(|_| Operation::Show),
            EditCommand::Isolate(targets) => targets.edit(|_| Operation::Isolate),
            EditCommand::Translate { targets, by, units } => {
                targets.edit(|run| Operation::Translate { by: units.length(run, by) })
            }
            EditCommand::Rotate { targets, axis, degrees, about, units } => targets.edit(|run| Operation::Rotate {
                axis: axis.as_vec3().to_array(),
                degrees,
                about: about.map(|at| units.position(run, at)),
            }),
            EditCommand::Scale { targets, factor, about, units } => {
                targets.edit(|run| Operation::Scale { factor, about: about.map(|at| units.position(run, at)) })
            }
            EditCommand::Undo { target, count } => target.change(|run| edits::step(run, HistoryDirection::Undo, count)),
            EditCommand::Redo { target, count } => target.change(|run| edits::step(run, HistoryDirection::Redo, count)),
            EditCommand::List(target) => {
                let run = target.common.open(&target.run)?;
                target.print(&run, &run.edits()?)
            }
            EditCommand::Clear(target) => target.change(edits::clear),
        }
    }
}

impl Targets {
    /// Adds an edit of these segments.
    fn edit(self, operation: impl FnOnce(&OpenRun) -> Operation) -> Result<(), CliError> {
        let Self { segments, target } = self;
        target.change(|run| {
            let edit = Edit { segments, operation: operation(run) };
            let (stack, note) = edits::push(run, edit)?;
            note.iter().for_each(|note| errln!("note: {note}"));
            Ok(stack)
        })
    }
}

impl EditedRun {
    /// Changes the edits and prints them.
    fn change(&self, change: impl FnOnce(&OpenRun) -> Result<EditStack, RunError>) -> Result<(), CliError> {
        let run = self.common.open_to_write(&self.run, LockDuration::Short)?;
        self.print(&run, &change(&run)?)
    }

    fn print(&self, run: &OpenRun, stack: &EditStack) -> Result<(), CliError> {
        if self.common.json {
            return print_json(&Versioned::new(stack));
        }
        let lines = stack.list(run.calibration());
        if lines.is_empty() {
            outln!("no edits");
        }
        for line in lines {
            outln!("{line}");
        }
        Ok(())
    }
}
