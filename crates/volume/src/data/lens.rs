//! Reads the lens that a `transforms_*.json` describes, at its top level or in its frames, and refuses every camera that
//! is no pinhole; checks it against the size of the images.

use std::path::Path;

use glam::DMat4;
use serde_json::{Map, Value};

use super::error::DataError;
use super::scan::show;
use super::transforms::Intrinsics;

/// Names of camera models that are pinholes if their distortion is zero, in lower case.
const PINHOLES: [&str; 7] =
    ["pinhole", "simple_pinhole", "perspective", "opencv", "full_opencv", "radial", "simple_radial"];
/// Fields that name the camera model.
const MODELS: [&str; 2] = ["camera_model", "camera_type"];
/// Fields that are true for cameras that are no pinholes.
const OTHERS: [&str; 5] = ["is_fisheye", "is_equirectangular", "is_orthographic", "equirectangular", "latlong"];
/// Coefficients of distortion: radial, tangential, thin prism, f-theta; and the motion of a rolling shutter.
const DISTORTION: [&str; 18] = [
    "k1",
    "k2",
    "k3",
    "k4",
    "k5",
    "k6",
    "p1",
    "p2",
    "s1",
    "s2",
    "s3",
    "s4",
    "ftheta_p0",
    "ftheta_p1",
    "ftheta_p2",
    "ftheta_p3",
    "ftheta_p4",
    "rolling_shutter",
];

const ONE_LENS: &str = "all frames of a split share one lens; make a dataset of the frames of each lens, or resample the \
                        images to one";

/// Reads the lenses of one file: the top level's and the frames', which must agree.
pub(super) struct Lenses<'a> {
    path: &'a Path,
    /// That of the top level.
    top: Intrinsics,
    /// That of the first frame, and its index.
    first: Option<(usize, Intrinsics)>,
    /// Whether a problem of the lens is known already.
    reported: bool,
}

impl<'a> Lenses<'a> {
    /// Reads the top level.
    pub(super) fn new(path: &'a Path, top: &Map<String, Value>, problems: &mut Vec<DataError>) -> Self {
        let mut lenses = Self { path, top: Intrinsics::default(), first: None, reported: false };
        lenses.top = lenses.read(None, top, problems);
        lenses
    }

    /// Reads frame `i`.
    pub(super) fn add(&mut self, i: usize, frame: &Map<String, Value>, problems: &mut Vec<DataError>) {
        let lens = self.read(Some(i), frame, problems);
        let Some((first, known)) = &self.first else {
            self.first = Some((i, lens));
            return;
        };
        let pairs = Intrinsics::FIELDS.into_iter().zip(known.values().into_iter().zip(lens.values()));
        let Some((field, (was, is))) = pairs.into_iter().find(|(_, (was, is))| was != is).filter(|_| !self.reported)
        else {
            return;
        };
        let words = |value: Option<f64>| value.map_or_else(|| "not given".to_owned(), |v| v.to_string());
        let problem = format!(
            "is {}, but {} in frame {first}; different intrinsics per frame are not supported",
            words(is),
            words(was)
        );
        self.problem(Some(i), field, problem, ONE_LENS, problems);
    }

    /// The lens of all frames.
    pub(super) fn lens(mut self, problems: &mut Vec<DataError>) -> Intrinsics {
        let own = self.first.as_ref().map(|(_, lens)| *lens).unwrap_or_default();
        for (field, (top, own)) in Intrinsics::FIELDS.into_iter().zip(self.top.values().into_iter().zip(own.values())) {
            if let (Some(top), Some(own)) = (top, own)
                && top != own
            {
                let problem = format!("is {top}, but {own} in the frames");
                self.problem(None, field, problem, "remove one of the two", problems);
            }
        }
        let (top, own) = (self.top.values(), own.values());
        let lens = Intrinsics::from_values(std::array::from_fn(|k| own[k].or(top[k])));
        if self.reported {
            return lens;
        }
        let Intrinsics { camera_angle_x, fl_x, fl_y, cx, cy, w, h, .. } = lens;
        if camera_angle_x.is_none() && fl_x.is_none() {
            let hint = "add the horizontal field of view in radians (or `fl_x` in pixels) at the top level";
            self.problem(None, "camera_angle_x", "missing, and there is no `fl_x` either".into(), hint, problems);
        }
        if [fl_x, fl_y, cx, cy].iter().any(Option::is_some) && (w.is_none() || h.is_none()) {
            let hint = "give the size in pixels that `fl_x`, `fl_y`, `cx` and `cy` refer to";
            let problem = "`w` and `h` are required with `fl_x`, `fl_y`, `cx` or `cy`";
            self.problem(None, "w", problem.into(), hint, problems);
        }
        lens
    }

    fn problem(
        &mut self,
        frame: Option<usize>,
        field: &str,
        problem: String,
        hint: &str,
        problems: &mut Vec<DataError>,
    ) {
        self.reported = true;
        problems.push(DataError::field_error(self.path, frame, field, problem, hint));
    }

    fn read(&mut self, frame: Option<usize>, fields: &Map<String, Value>, problems: &mut Vec<DataError>) -> Intrinsics {
        self.refuse_other_cameras(frame, fields, problems);
        let values = Intrinsics::FIELDS.map(|field| {
            let value = fields.get(field)?;
            let (low, high, must) = match field {
                "camera_angle_x" | "camera_angle_y" => {
                    (0.0, std::f64::consts::PI, "an angle in radians between 0 and pi")
                }
                "fl_x" | "fl_y" => (0.0, 1e9, "a positive number of pixels"),
                "w" | "h" => (0.0, 1e6, "a positive number of pixels"),
                _ => (-1e9, 1e9, "a pixel position"),
            };
            let number = value.as_f64().filter(|x| *x > low && *x < high);
            if number.is_none() {
                let problem = format!("{} where {must} is needed", show(value));
                let hint = "correct the number, or remove the field if another defines it";
                self.problem(frame, field, problem, hint, problems);
            }
            number
        });
        Intrinsics::from_values(values)
    }

    fn refuse_other_cameras(
        &mut self,
        frame: Option<usize>,
        fields: &Map<String, Value>,
        problems: &mut Vec<DataError>,
    ) {
        const HINT: &str = "render or resample the images with a pinhole camera (perspective projection)";
        for field in MODELS {
            let Some(value) = fields.get(field).filter(|v| !v.is_null()) else { continue };
            let name = value.as_str().map_or_else(|| show(value), str::to_owned);
            if !PINHOLES.contains(&name.to_ascii_lowercase().as_str()) {
                let problem = format!("{name} is not supported, only pinhole cameras are");
                self.problem(frame, field, problem, HINT, problems);
            }
        }
        for field in OTHERS {
            if fields
                .get(field)
                .is_some_and(|v| !matches!(v, Value::Null | Value::Bool(false)) && v.as_f64() != Some(0.0))
            {
                self.problem(frame, field, "only pinhole cameras are supported".into(), HINT, problems);
            }
        }
        let zero = |value: &Value| value.is_null() || value.as_f64() == Some(0.0);
        for field in DISTORTION {
            let none = |value: &Value| zero(value) || value.as_array().is_some_and(|all| all.iter().all(zero));
            if fields.get(field).is_some_and(|value| !none(value)) {
                let problem = "lens distortion is not supported";
                self.problem(frame, field, problem.into(), "undistort the images first", problems);
            }
        }
    }
}

/// Refuses a lens that contradicts itself or images of this size: these may be a scaled copy of the `w` x `h` given in
/// the JSON, but not a cropped one; angles and focal lengths may both be given if they agree to 1 %; and angles alone
/// must not make pixels more than twice as long as wide, or as wide as long.
pub(super) fn check_lens(path: &Path, intrinsics: &Intrinsics, (width, height): (u32, u32)) -> Result<(), DataError> {
    let near = |a: f64, b: f64| (a / b - 1.0).abs() <= 0.01;
    if let (Some(w), Some(h)) = (intrinsics.w, intrinsics.h)
        && !near(f64::from(width) / w, f64::from(height) / h)
    {
        let problem = format!("the aspect ratio of {w}x{h} differs from that of the images, {width}x{height}");
        let hint = "correct `w` and `h`, or render the images at that aspect ratio";
        return Err(DataError::field_error(path, None, "w", problem, hint));
    }
    let camera = intrinsics.camera(width, height, DMat4::IDENTITY);
    let focal = |size: u32, angle: f64| 0.5 * f64::from(size) / (0.5 * angle).tan();
    let in_pixels = intrinsics.fl_x.is_some() || intrinsics.fl_y.is_some();
    let angles = [
        ("camera_angle_x", intrinsics.camera_angle_x, width, camera.fx, intrinsics.fl_x.is_some()),
        ("camera_angle_y", intrinsics.camera_angle_y, height, camera.fy, in_pixels),
    ];
    for (field, angle, size, used, given) in angles {
        if let Some(angle) = angle.filter(|_| given)
            && !near(focal(size, angle), used)
        {
            let (found, axis) = (focal(size, angle), &field[field.len() - 1..]);
            let problem = format!(
                "{angle} is a focal length of {found:.2} pixels of the images, but `fl_{axis}` or `fl_x` says {used:.2}"
            );
            return Err(DataError::field_error(path, None, field, problem, "remove the one that is wrong"));
        }
    }
    if !in_pixels && !(0.5..=2.0).contains(&(camera.fx / camera.fy)) {
        let problem = format!(
            "{} contradicts `camera_angle_x`: pixels of images of {width}x{height} would be {:.2} times as long as wide",
            intrinsics.camera_angle_y.unwrap_or_default(),
            camera.fx / camera.fy
        );
        let hint = "give whole angles of view in radians; for square pixels, `camera_angle_x` alone is enough";
        return Err(DataError::field_error(path, None, "camera_angle_y", problem, hint));
    }
    Ok(())
}
