//! Reads the text of `transforms_*.json` into values and a list of all its problems. No file access, and no decision
//! about which problem matters: `transforms` stops at the first, `inspect` shows them all.

use std::path::Path;

use glam::{DMat3, DMat4};
use serde_json::{Map, Value};

use super::error::DataError;
use super::lenient::parse_lenient;
use super::lens::Lenses;
use super::transforms::{FrameRecord, Intrinsics};

/// Maximum deviation of the bottom row of a pose from `[0, 0, 0, 1]`.
pub const BOTTOM_ROW_TOLERANCE: f64 = 1e-4;
/// Maximum coordinate of a camera position along an axis: squares of such distances are still finite in single
/// precision.
pub const MAX_POSITION: f64 = 1e15;
/// Maximum deviation of the rotation of a pose from orthonormal (largest entry of `R^T R - I`).
pub const ROTATION_TOLERANCE: f64 = 1e-3;

/// The views of a split, as far as they can be read.
#[derive(Debug, Default)]
pub struct SplitScan {
    /// Focal length, principal point and size, where given.
    pub intrinsics: Intrinsics,
    /// One entry per frame of the file; none for a frame with a problem.
    pub frames: Vec<Option<FrameRecord>>,
    /// All problems, in the order of the file.
    pub problems: Vec<DataError>,
    /// Bytes that identify the views, such as the text of their file: with others, runs are of another dataset.
    pub contents: Vec<u8>,
    /// Largest entry of `|R^T R - I|` over all readable poses, including rejected ones.
    pub orthonormality_error: f64,
}

/// Reads `text`; `path` is used in messages only. Never panics and never stops at the first problem.
pub fn scan(path: &Path, text: &str) -> SplitScan {
    let mut out = SplitScan::default();
    match parse_lenient(path, text) {
        Ok(Value::Object(top)) => Scanner { path, out: &mut out }.top(&top),
        Ok(_) => out.problems.push(DataError::field_error(
            path,
            None,
            "frames",
            "the file is not a JSON object",
            "the top level must be {\"camera_angle_x\": ..., \"frames\": [...]}",
        )),
        Err(error) => out.problems.push(error),
    }
    out
}

struct Scanner<'a> {
    path: &'a Path,
    out: &'a mut SplitScan,
}

impl Scanner<'_> {
    fn problem(&mut self, frame: Option<usize>, field: &str, problem: impl Into<String>, hint: &str) {
        self.out.problems.push(DataError::field_error(self.path, frame, field, problem, hint));
    }

    fn top(&mut self, top: &Map<String, Value>) {
        let mut lenses = Lenses::new(self.path, top, &mut self.out.problems);
        self.frames(top, &mut lenses);
        self.out.intrinsics = lenses.lens(&mut self.out.problems);
    }

    fn frames(&mut self, top: &Map<String, Value>, lenses: &mut Lenses<'_>) {
        let Some(frames) = top.get("frames").and_then(Value::as_array) else {
            let problem = format!("{} where a list of frames is needed", kind(top.get("frames")));
            return self.problem(None, "frames", problem, "add \"frames\": [{...}, ...], one entry per image");
        };
        if frames.is_empty() {
            self.problem(None, "frames", "the list is empty", "a split needs at least one frame");
        }
        for (i, frame) in frames.iter().enumerate() {
            let record = self.frame(i, frame, lenses);
            self.out.frames.push(record);
        }
    }

    fn frame(&mut self, i: usize, value: &Value, lenses: &mut Lenses<'_>) -> Option<FrameRecord> {
        let at = Some(i);
        let Some(frame) = value.as_object() else {
            let problem = format!("{} where an object is needed", show(value));
            self.problem(at, "frames", problem, "each frame is {\"file_path\", \"transform_matrix\", \"time\"}");
            return None;
        };
        lenses.add(i, frame, &mut self.out.problems);
        let file_path = match frame.get("file_path").and_then(Value::as_str).filter(|s| !s.trim().is_empty()) {
            Some(text) => Some(text.to_owned()),
            None => {
                let problem = format!("{} where a path is needed", kind(frame.get("file_path")));
                self.problem(at, "file_path", problem, "give the image's path relative to the dataset folder");
                None
            }
        };
        let camera_to_world = self.pose(i, frame.get("transform_matrix"));
        let time = self.time(i, frame.get("time"));
        Some(FrameRecord { file_path: file_path?, camera_to_world: camera_to_world?, time: time? })
    }

    fn time(&mut self, i: usize, value: Option<&Value>) -> Option<f64> {
        let problem = match value.map(|v| (v, v.as_f64())) {
            None => "missing".to_owned(),
            Some((_, Some(t))) if (0.0..=1.0).contains(&t) => return Some(t),
            Some((_, Some(t))) => format!("{t} is outside [0, 1]"),
            Some((v, None)) => format!("{} where a finite number is needed", show(v)),
        };
        let hint = "give each frame its time, scaled so that the first timestep is 0 and the last is 1";
        self.problem(Some(i), "time", problem, hint);
        None
    }

    fn pose(&mut self, i: usize, value: Option<&Value>) -> Option<DMat4> {
        let field = "transform_matrix";
        let rows = match read_rows(value) {
            Ok(rows) => rows,
            Err(problem) => {
                let hint = "give the camera-to-world matrix as 4 rows of 4 finite numbers";
                self.problem(Some(i), field, problem, hint);
                return None;
            }
        };
        let mut good = true;
        let expected = [0.0, 0.0, 0.0, 1.0];
        if rows[3].iter().zip(expected).any(|(x, e)| (x - e).abs() > BOTTOM_ROW_TOLERANCE) {
            let problem = format!("the bottom row is {:?}, not [0, 0, 0, 1]", rows[3]);
            let hint = "the matrix must be row-major camera-to-world; transpose it if the position is in the last row";
            self.problem(Some(i), field, problem, hint);
            good = false;
        }
        let matrix = DMat4::from_cols_array_2d(&[rows[0], rows[1], rows[2], expected]).transpose();
        let rotation = DMat3::from_mat4(matrix);
        let error = (rotation.transpose() * rotation - DMat3::IDENTITY)
            .to_cols_array()
            .iter()
            .fold(0.0, |a: f64, x| if x.is_finite() { a.max(x.abs()) } else { f64::MAX });
        self.out.orthonormality_error = self.out.orthonormality_error.max(error);
        if error > ROTATION_TOLERANCE {
            let problem = format!("the rotation is not orthonormal (|R^T R - I| reaches {error:.3e})");
            self.problem(Some(i), field, problem, "remove scale and shear; the three columns must be unit axes");
            good = false;
        } else if rotation.determinant() < 0.0 {
            let hint = "the axes must be right-handed: +x right, +y up, looking along -z; flip one column";
            self.problem(Some(i), field, "the rotation mirrors (determinant -1)", hint);
            good = false;
        }
        good.then_some(matrix)
    }
}

fn read_rows(value: Option<&Value>) -> Result<[[f64; 4]; 4], String> {
    let list = value.and_then(Value::as_array).ok_or_else(|| format!("{} where 4 rows are needed", kind(value)))?;
    if list.len() != 4 {
        return Err(format!("it has {} rows where 4 are needed", list.len()));
    }
    let mut rows = [[0.0; 4]; 4];
    for (r, row) in list.iter().enumerate() {
        let row = row.as_array().ok_or_else(|| format!("row {r} is {}, not a list", show(row)))?;
        if row.len() != 4 {
            return Err(format!("row {r} has {} entries where 4 are needed", row.len()));
        }
        for (c, entry) in row.iter().enumerate() {
            let number = entry.as_f64().filter(|x| x.is_finite());
            rows[r][c] =
                number.ok_or_else(|| format!("entry ({r}, {c}) is {} where a finite number is needed", show(entry)))?;
            // the other entries are checked against those of a rotation
            if r < 3 && c == 3 && rows[r][c].abs() > MAX_POSITION {
                return Err(format!("entry ({r}, {c}) is {:e}, too large: at most {MAX_POSITION:e}", rows[r][c]));
            }
        }
    }
    Ok(rows)
}

/// Formats a value for a message: numbers and words as they are, the rest by kind.
pub(super) fn show(value: &Value) -> String {
    match value {
        Value::Number(n) => n.to_string(),
        Value::Bool(b) => b.to_string(),
        Value::Null => "null (or NaN or infinite, or beyond 1.8e308)".to_owned(),
        Value::String(_) => "a string".to_owned(),
        Value::Array(_) => "a list".to_owned(),
        Value::Object(_) => "an object".to_owned(),
    }
}

fn kind(value: Option<&Value>) -> String {
    match value {
        None => "missing".to_owned(),
        Some(Value::String(s)) if s.trim().is_empty() => "an empty string".to_owned(),
        Some(value) => show(value),
    }
}
