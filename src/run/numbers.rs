//! Depth and velocity of pictures as numbers in the units of the data, for NumPy and OpenEXR; NaN where nothing is
//! visible.

use super::selection::Selection;
use super::{OpenRun, RunError};
use crate::data::Camera;
use crate::data::calibration::Calibration;
use crate::export::exr;
use crate::export::npy::NpyWriter;
use crate::files::write_named;
use crate::model::ToKernel;
use crate::model::params::to_vec;
use crate::segment::pictures::{mean_values, picture};
use crate::track::velocity::{Component, velocities};
use std::path::Path;

/// The format of a file of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NumberFormat {
    /// NumPy: `[H, W]`, for vectors `[H, W, 3]`; of several frames `[F, H, W]` and `[F, H, W, 3]`.
    Npy,
    /// OpenEXR: one frame, with the channel `Z` for depth, `V` for a component or the speed, `X`, `Y`, `Z` for vectors.
    Exr,
}

impl NumberFormat {
    /// The format of a file with this name; `None` if it names neither.
    pub fn by_extension(path: &Path) -> Option<Self> {
        let named = |e: &str| path.extension().is_some_and(|found| found.eq_ignore_ascii_case(e));
        [(Self::Npy, "npy"), (Self::Exr, "exr")].into_iter().find(|(_, e)| named(e)).map(|(format, _)| format)
    }
}

/// What the pixels hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PixelQuantity {
    /// Distance from the camera along its direction of view, the mean over what the pixel shows.
    Depth,
    /// Velocity under the trained deformation, the mean over what the pixel shows: one component, or x, y, z.
    Velocity(Option<Component>),
}

impl PixelQuantity {
    /// Channels of a picture, by name.
    fn channels(self) -> &'static [&'static str] {
        match self {
            Self::Depth => &["Z"],
            Self::Velocity(Some(_)) => &["V"],
            Self::Velocity(None) => &["X", "Y", "Z"],
        }
    }

    /// What the numbers are, with their unit.
    pub fn describe(self, calibration: &Calibration) -> String {
        let (length, time) = (calibration.length_unit(), calibration.time_unit());
        match self {
            Self::Depth => format!("depth along the direction of view, length: {length}"),
            Self::Velocity(component) => {
                let what = component.map_or("x, y, z".to_owned(), |c| format!("{c:?}").to_lowercase());
                format!("velocity ({what}), length: {length}, time: {time}")
            }
        }
    }

    /// The numbers of one frame, row by row, channels together.
    fn frame(
        self,
        run: &OpenRun,
        shown: &Selection,
        calibration: &Calibration,
        (camera, time): (&Camera, f64),
    ) -> Result<Vec<f32>, RunError> {
        let at = shown.edited(&run.scene, time as f32)?;
        let settings = run.scene.spec.rendering().seen_by(camera.to_kernel());
        let scaled = |v: f32, scale: f64| (f64::from(v) * scale) as f32;
        Ok(match self {
            Self::Depth => {
                let depth = picture(&shown.cut(at), settings, &run.device()).depth;
                let length = calibration.length_scale();
                // what is drawn lies in front of the camera, so 0 is nothing
                depth.iter().map(|d| if *d > 0.0 { scaled(*d, length) } else { f32::NAN }).collect()
            }
            Self::Velocity(component) => {
                let all = velocities(|t| to_vec(run.scene.deformed(t).means), time as f32);
                let alone = |all: Vec<f32>| match shown.members() {
                    Some(members) => members.iter().flat_map(|&i| &all[3 * i as usize..][..3]).copied().collect(),
                    None => all,
                };
                let mean = mean_values(&shown.cut(at), &alone(all), settings, &run.device());
                let mean: Vec<f32> = mean.iter().map(|v| scaled(*v, calibration.speed_scale())).collect();
                component.map_or(mean.clone(), |component| component.values(&mean))
            }
        })
    }
}

/// Writes `quantity` as seen in each of `views` to the file `out`; `goes_on` is called after each frame. Returns whether
/// it was not stopped. Units are those of `calibration`.
///
/// # Errors
/// If there are several views for one EXR, an edit cannot be applied, or the file cannot be written.
pub fn write(
    run: &OpenRun,
    shown: &Selection,
    (quantity, calibration): (PixelQuantity, &Calibration),
    views: &[(Camera, f64)],
    (out, format): (&Path, NumberFormat),
    mut goes_on: impl FnMut() -> bool,
) -> Result<bool, RunError> {
    let Some((first, _)) = views.first() else { return Err(RunError::input("there is no view")) };
    let [width, height] = [first.width as usize, first.height as usize];
    let channels = quantity.channels();
    let frame = |(camera, time): &(Camera, f64)| quantity.frame(run, shown, calibration, (camera, *time));
    match format {
        NumberFormat::Exr => {
            let [view] = views else {
                return Err(RunError::input(format!(
                    "--out {}: OpenEXR holds one picture, but there are {} frames; choose a single view with --camera or \
                     --view, or write NAME.npy",
                    out.display(),
                    views.len()
                )));
            };
            let values = frame(view)?;
            let of = |c: usize| values.iter().skip(c).step_by(channels.len()).copied().collect();
            let planes: Vec<(&str, Vec<f32>)> = channels.iter().enumerate().map(|(c, name)| (*name, of(c))).collect();
            write_named(out, &exr::encode([width, height], &planes, &quantity.describe(calibration)))?;
        }
        NumberFormat::Npy => {
            let mut shape = if views.len() > 1 { vec![views.len()] } else { Vec::new() };
            shape.extend([height, width]);
            shape.extend((channels.len() > 1).then_some(channels.len()));
            let mut array = NpyWriter::create(out, &shape)?;
            for view in views {
                array.add(&frame(view)?)?;
                if !goes_on() {
                    return Ok(false);
                }
            }
            array.finish()?;
        }
    }
    Ok(true)
}
