//! Who looks, as it is typed: the same for every command that takes a view.

use super::values::{pixels, point};
use crate::run::OpenRun;
use crate::run::cameras::{Surroundings, ViewChoice};
use clap::Args;
use glam::DVec3;

/// A camera and the size of its picture.
#[derive(Debug, Clone, Args)]
pub(super) struct ViewArgs {
    /// Camera at x,y,z that looks at the centre.
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    camera: Option<DVec3>,
    /// The camera of this test view of the dataset, from 0, in place of --camera.
    #[arg(long, value_name = "N", conflicts_with = "camera")]
    view: Option<usize>,
    /// Width of the picture in pixels; the height follows from the shape of the training images, which set both if it is
    /// not given.
    #[arg(long, value_name = "PIXELS", value_parser = pixels)]
    pub size: Option<u32>,
}

impl ViewArgs {
    /// Which camera, if one was given.
    pub(super) fn choice(&self) -> Option<ViewChoice> {
        self.camera.map(ViewChoice::At).or(self.view.map(ViewChoice::Test))
    }
}

/// The surroundings of a run, at `width` pixels if that is given; what there is to say about them is said.
pub(super) fn surroundings(run: &OpenRun, width: Option<u32>) -> Surroundings {
    let around = run.surroundings();
    if let Some(note) = &around.note {
        errln!("note: {note}");
    }
    match width {
        Some(width) => around.sized(width),
        None => around,
    }
}
