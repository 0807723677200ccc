//! Camera arguments, shared by every command that takes a view.

use super::CliError;
use super::values::{pixels, point};
use crate::data::Surroundings;
use crate::run::cameras::ViewChoice;
use crate::run::saved::SavedView;
use crate::run::{OpenRun, TrainedModel};
use clap::Args;
use glam::DVec3;
use std::path::Path;

/// A camera and the size of its image.
#[derive(Debug, Clone, Args)]
pub(super) struct ViewArgs {
    /// Camera position x,y,z in the coordinates of the dataset's cameras; it looks at the centre.
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    camera: Option<DVec3>,
    /// Camera to use instead of --camera: the number of a test view of the dataset (from 0), a picture saved in
    /// `volseggs view`, or a view in JSON (a file or the text itself). Write ./12 for a file whose name is a number.
    #[arg(long, value_name = "N|FILE", conflicts_with = "camera")]
    view: Option<String>,
    /// Width of the picture in pixels; the height follows from the aspect ratio of the training images (or of the saved
    /// view). If not given, these set both.
    #[arg(long, value_name = "PIXELS", value_parser = pixels)]
    pub size: Option<u32>,
}

impl ViewArgs {
    /// The value of `--view` as the name of a file, which need not exist.
    pub(super) fn file(&self) -> Option<&Path> {
        self.view.as_deref().map(Path::new)
    }

    /// The chosen camera, if one was given. A saved view is resized to `--size` if that is given.
    ///
    /// # Errors
    /// If the number is invalid, or the file holds no view.
    pub(super) fn choice(&self) -> Result<Option<ViewChoice>, CliError> {
        let Some(view) = &self.view else { return Ok(self.camera.map(ViewChoice::At)) };
        if view.bytes().all(|b| b.is_ascii_digit()) {
            let wrong =
                |_| CliError::input(format!("--view {view}: neither the number of a test view nor the name of a file"));
            return view.parse().map(|n| Some(ViewChoice::Test(n))).map_err(wrong);
        }
        let (name, saved) = match view.starts_with('{') {
            true => ("{...}".to_owned(), SavedView::parse("--view", view)),
            false => (view.clone(), SavedView::read(Path::new(view))),
        };
        let saved = saved.map_err(|e| match Path::new(view).exists() || view.starts_with('{') {
            true => e.into(),
            false => CliError::input(format!("--view {view}: neither the number of a test view nor an existing file")),
        })?;
        let saved = Box::new(match self.size {
            Some(width) => saved.sized(width)?,
            None => saved,
        });
        Ok(Some(ViewChoice::Saved { name, saved }))
    }
}

/// The surroundings of a run, `width` pixels wide if that is given.
pub(super) fn surroundings<S: TrainedModel>(run: &OpenRun<S>, width: Option<u32>) -> Surroundings {
    let around = run.record.surroundings;
    width.map_or(around, |width| around.sized(width))
}
