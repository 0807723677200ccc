//! Camera paths through keyframes, and the files that hold them: a saved view ([`super::saved`]), which says what is
//! shown, with additional `keys`.
//!
//! Between two keyframes, the scene time advances at constant speed. The target and the logarithms of the distance and
//! of the lens follow monotone cubics (Fritsch and Carlson 1980), which stay constant between equal keyframes. The
//! orientation follows a cubic Bezier curve on the sphere of rotations (Shoemake 1985), so that a camera circling the
//! target keeps its distance. Camera velocities are continuous.

use super::saved::{SavedView, command};
use super::view::{View, check_pose};
use super::{OpenRun, RunError};
use crate::words::plain;
use glam::{DMat3, DQuat, DVec3};
use schemars::JsonSchema;
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Display;

/// Maximum number of keyframes in a path.
const MAX_KEYS: usize = 150;
/// Maximum length of a path, seconds.
const MAX_SECONDS: f64 = 24.0 * 3600.0;

/// A camera and the scene time it shows, at a moment of the path.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Key {
    /// Moment on the path, seconds.
    pub seconds: f64,
    /// Time of the scene in [0, 1].
    pub time: f64,
    /// Position of the camera, scene units.
    pub eye: [f64; 3],
    /// Point it looks at.
    pub target: [f64; 3],
    /// Up direction.
    pub up: [f64; 3],
    /// Full horizontal field of view, radians.
    pub fov: f64,
}

impl Key {
    /// Returns `shown` seen by this camera at this time.
    pub fn view(&self, shown: &View) -> View {
        let Self { time, eye, target, up, fov, .. } = *self;
        View { time, eye, target, up, fov, ..shown.clone() }
    }
}

/// The interpolated quantities of a keyframe.
#[derive(Clone, Copy, Debug)]
struct Rig {
    target: DVec3,
    /// Logarithms of the distance to the target and of the tangent of half the field of view.
    logs: [f64; 2],
    rotation: DQuat,
}

impl From<&Key> for Rig {
    fn from(key: &Key) -> Self {
        let [eye, target, up] = [key.eye, key.target, key.up].map(DVec3::from_array);
        let forward = (target - eye).normalize();
        let right = forward.cross(up).normalize();
        let rotation = DQuat::from_mat3(&DMat3::from_cols(right, right.cross(forward), -forward)).normalize();
        Self { target, logs: [target.distance(eye).ln(), (key.fov / 2.0).tan().ln()], rotation }
    }
}

/// A camera path through two or more keyframes.
#[derive(Clone, Debug)]
pub struct CameraPath {
    keys: Vec<Key>,
    rigs: Vec<Rig>,
    /// Angular velocity at each keyframe, radians per second about the camera's own axes.
    turns: Vec<DVec3>,
}

impl CameraPath {
    /// Creates a path through these keyframes.
    ///
    /// # Errors
    /// If there are fewer than two or too many, their seconds do not ascend, a value is out of range, or a camera pose
    /// is invalid.
    pub fn new(keys: Vec<Key>) -> Result<Self, String> {
        if !(2..=MAX_KEYS).contains(&keys.len()) {
            return Err(format!("keys: {} keyframes; a path has 2 to {MAX_KEYS}", keys.len()));
        }
        for (n, key) in (1..).zip(&keys) {
            check_pose(key.eye, key.target, key.up, key.fov).map_err(|e| format!("keyframe {n}: {e}"))?;
            if !(0.0..=1.0).contains(&key.time) {
                return Err(format!("keyframe {n}: time: must be between 0 and 1"));
            }
            if !(0.0..=MAX_SECONDS).contains(&key.seconds) {
                return Err(format!("keyframe {n}: seconds: must be between 0 and {MAX_SECONDS}"));
            }
        }
        if let Some(n) = keys.windows(2).position(|w| w[1].seconds - w[0].seconds < 1e-3) {
            return Err(format!(
                "keyframe {}: seconds: must be at least a millisecond after the previous keyframe",
                n + 2
            ));
        }
        let mut rigs: Vec<Rig> = keys.iter().map(Rig::from).collect();
        for i in 1..rigs.len() {
            // of the two quaternions of a rotation, choose the nearer one
            if rigs[i].rotation.dot(rigs[i - 1].rotation) < 0.0 {
                rigs[i].rotation = -rigs[i].rotation;
            }
        }
        let spans = spans(&keys);
        let steps: Vec<DVec3> = rigs
            .windows(2)
            .zip(&spans)
            .map(|(w, h)| (w[0].rotation.inverse() * w[1].rotation).normalize().to_scaled_axis() / *h)
            .collect();
        let inner = |i: usize| {
            let (before, after) = (steps[i - 1], steps[i]);
            // at rest on one side: no rotation at the keyframe
            let still = before.length() < 1e-12 || after.length() < 1e-12;
            if still { DVec3::ZERO } else { (before * spans[i] + after * spans[i - 1]) / (spans[i] + spans[i - 1]) }
        };
        let last = steps.len();
        let turns = (0..=last)
            .map(|i| match i {
                0 => steps[0],
                i if i == last => steps[last - 1],
                i => inner(i),
            })
            .collect();
        Ok(Self { keys, rigs, turns })
    }

    /// Returns the length of the path in seconds.
    pub fn seconds(&self) -> f64 {
        self.keys[self.keys.len() - 1].seconds - self.keys[0].seconds
    }

    /// Returns the camera and time at a moment; before and after the path, those of its first and last keyframe.
    pub fn key_at(&self, seconds: f64) -> Key {
        let next = self.keys.partition_point(|k| k.seconds <= seconds);
        if next == 0 {
            return self.keys[0];
        }
        let i = next - 1;
        if next == self.keys.len() || self.keys[i].seconds == seconds {
            return self.keys[i];
        }
        let h = self.keys[next].seconds - self.keys[i].seconds;
        let s = (seconds - self.keys[i].seconds) / h;
        let [a, b] = [&self.rigs[i], &self.rigs[next]];
        let cubic = |of: &dyn Fn(&Rig) -> f64| self.cubic(of, i, s);
        let target = DVec3::new(cubic(&|r| r.target.x), cubic(&|r| r.target.y), cubic(&|r| r.target.z));
        let [distance, lens] = [0, 1].map(|k| cubic(&|r| r.logs[k]).exp());
        let turned = |from: DQuat, by: DVec3| (from * DQuat::from_scaled_axis(by * h / 3.0)).normalize();
        let mut curve =
            [a.rotation, turned(a.rotation, self.turns[i]), turned(b.rotation, -self.turns[next]), b.rotation];
        for n in (1..4).rev() {
            for k in 0..n {
                curve[k] = curve[k].slerp(curve[k + 1], s);
            }
        }
        let rotation = curve[0].normalize();
        let eye = target + rotation * DVec3::Z * distance;
        let time = self.keys[i].time + s * (self.keys[next].time - self.keys[i].time);
        let up = (rotation * DVec3::Y).to_array();
        Key { seconds, time, eye: eye.to_array(), target: target.to_array(), up, fov: 2.0 * lens.atan() }
    }

    /// Returns `n` cameras at equal steps, including the first and the last keyframe; only the first if `n` is 1.
    pub fn frames(&self, n: usize) -> impl Iterator<Item = Key> + '_ {
        let (from, step) = (self.keys[0].seconds, self.seconds() / (n.max(2) - 1) as f64);
        (0..n).map(move |i| match i + 1 == n && n > 1 {
            true => self.keys[self.keys.len() - 1],
            false => self.key_at(from + i as f64 * step),
        })
    }

    /// Evaluates the monotone cubic through a value of each keyframe, at fraction `s` of the span after keyframe `i`.
    fn cubic(&self, of: &dyn Fn(&Rig) -> f64, i: usize, s: f64) -> f64 {
        let [v0, v1] = [i, i + 1].map(|k| of(&self.rigs[k]));
        let h = self.keys[i + 1].seconds - self.keys[i].seconds;
        let [m0, m1] = [i, i + 1].map(|k| h * self.slope(of, k));
        let (s2, s3) = (s * s, s * s * s);
        (2.0 * s3 - 3.0 * s2 + 1.0) * v0 + (s3 - 2.0 * s2 + s) * m0 + (3.0 * s2 - 2.0 * s3) * v1 + (s3 - s2) * m1
    }

    /// Returns its slope at keyframe `k`: the weighted harmonic mean of the slopes of the adjacent spans, 0 if their
    /// signs differ.
    fn slope(&self, of: &dyn Fn(&Rig) -> f64, k: usize) -> f64 {
        let span = |i: usize| {
            let h = self.keys[i + 1].seconds - self.keys[i].seconds;
            (h, (of(&self.rigs[i + 1]) - of(&self.rigs[i])) / h)
        };
        if k == 0 {
            return span(0).1;
        }
        if k + 1 == self.keys.len() {
            return span(k - 1).1;
        }
        let ((h0, d0), (h1, d1)) = (span(k - 1), span(k));
        if d0 * d1 <= 0.0 {
            return 0.0;
        }
        let (w0, w1) = (2.0 * h1 + h0, h1 + 2.0 * h0);
        (w0 + w1) / (w0 / d0 + w1 / d1)
    }
}

fn spans(keys: &[Key]) -> Vec<f64> {
    keys.windows(2).map(|w| w[1].seconds - w[0].seconds).collect()
}

/// A camera path as stored in a file.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct SavedPath {
    /// What is shown along the path; its own camera and time are not those of any frame.
    #[serde(flatten)]
    pub shown: SavedView,
    /// The keyframes.
    pub keys: Vec<Key>,
}

impl SavedPath {
    /// Creates a path of a run, for a file of this name.
    pub fn new(run: &OpenRun, shown: View, keys: Vec<Key>, file: &str) -> Self {
        let mut shown = SavedView::new(run, shown, file);
        shown.command = command(run, "--path", file, "frames");
        Self { shown, keys }
    }

    /// Returns whether a JSON text is a path of this kind rather than a dataset's list of cameras.
    pub fn is_in(text: &str) -> bool {
        // a text with duplicate `keys` counts too, as it can be read
        serde_json::from_str::<BTreeMap<String, IgnoredAny>>(text).is_ok_and(|all| all.contains_key("keys"))
    }

    /// Parses the text of a file; `name` is used only in messages.
    ///
    /// # Errors
    /// If the text holds no valid path; the error says why.
    pub fn parse(name: impl Display, text: &str) -> Result<(SavedView, CameraPath), RunError> {
        let wrong = |e: String| RunError::input(format!("{name}: not a valid path of keyframes: {e}"));
        let json = |e: serde_json::Error| wrong(plain(&e.to_string()));
        let mut value: Value = serde_json::from_str(text).map_err(json)?;
        let keys =
            value.as_object_mut().and_then(|o| o.remove("keys")).ok_or_else(|| wrong("it has no keys".into()))?;
        let keys = serde_json::from_value(keys).map_err(json)?;
        let shown = SavedView::from_value(&name, value)?;
        Ok((shown, CameraPath::new(keys).map_err(wrong)?))
    }
}

#[cfg(test)]
mod tests {
    use super::super::view::tests::view;
    use super::*;
    use crate::user_error::UserError;

    fn key(seconds: f64, time: f64, angle: f64, distance: f64) -> Key {
        let (sin, cos) = angle.to_radians().sin_cos();
        let (target, up) = ([0.5, 0.0, 0.1], [0.0, 0.0, 1.0]);
        Key { seconds, time, eye: [0.5 + distance * cos, distance * sin, 0.1], target, up, fov: 0.5 }
    }

    fn path() -> CameraPath {
        let keys = vec![
            key(0.0, 0.2, 0.0, 4.0),
            key(2.0, 0.4, 80.0, 4.0),
            key(3.0, 1.0, 120.0, 2.0),
            key(6.0, 0.0, -150.0, 5.0),
        ];
        CameraPath::new(keys).unwrap()
    }

    fn eye(key: &Key) -> DVec3 {
        DVec3::from_array(key.eye)
    }

    #[test]
    fn it_passes_through_its_keyframes_and_time_runs_evenly_between_them() {
        let path = path();
        for k in &path.keys {
            assert_eq!(path.key_at(k.seconds), *k, "to the bit");
            for near in [-1e-9, 1e-9] {
                let there = path.key_at(k.seconds + near);
                assert!(eye(&there).distance(eye(k)) < 1e-6 && (there.fov - k.fov).abs() < 1e-9);
            }
        }
        for w in path.keys.windows(2) {
            for s in [0.1, 0.25, 0.9] {
                let at = path.key_at(w[0].seconds + s * (w[1].seconds - w[0].seconds));
                assert!((at.time - (w[0].time + s * (w[1].time - w[0].time))).abs() < 1e-12);
            }
        }
        let frames: Vec<Key> = path.frames(7).collect();
        assert_eq!(
            (frames.len(), frames[0], frames[2], frames[3], frames[6]),
            (7, path.keys[0], path.keys[1], path.keys[2], path.keys[3])
        );
        assert_eq!((path.key_at(-1.0), path.key_at(99.0)), (path.keys[0], path.keys[3]));
        assert_eq!(path.frames(1).collect::<Vec<_>>(), [path.keys[0]]);
    }

    #[test]
    fn it_has_no_corners_and_an_orbit_stays_at_its_distance() {
        let path = path();
        let speed = |t: f64| (eye(&path.key_at(t + 1e-5)) - eye(&path.key_at(t - 1e-5))) / 2e-5;
        for k in &path.keys[1..3] {
            let [before, after] = [-1e-3, 1e-3].map(|d| speed(k.seconds + d));
            assert!((before - after).length() < 0.05 * before.length().max(1.0), "{before} {after}");
        }
        for t in 0..=20 {
            let at = path.key_at(0.1 * f64::from(t));
            assert!((eye(&at).distance(DVec3::from_array(at.target)) - 4.0).abs() < 1e-9, "{at:?}");
            assert!(DVec3::from_array(at.up).distance(DVec3::Z) < 1e-9, "the horizon stays level");
        }
        for t in 0..=60 {
            let at = path.key_at(0.1 * f64::from(t));
            check_pose(at.eye, at.target, at.up, at.fov).unwrap();
            let distance = eye(&at).distance(DVec3::from_array(at.target));
            assert!((2.0 - 1e-9..=5.0 + 1e-9).contains(&distance), "never beyond its keyframes: {distance}");
        }
        // the camera rests between equal keyframes
        let held = CameraPath::new(vec![
            key(0.0, 0.0, 0.0, 3.0),
            key(1.0, 0.0, 50.0, 4.0),
            key(2.0, 1.0, 50.0, 4.0),
            key(3.0, 1.0, 90.0, 4.0),
        ]);
        let held = held.unwrap();
        assert!(eye(&held.key_at(1.3)).distance(eye(&held.keys[1])) < 1e-9);
    }

    #[test]
    fn files_round_trip_and_invalid_ones_are_refused() {
        let text = |t: &str| t.to_owned();
        let shown = SavedView {
            format: 1,
            version: text("9"),
            run: text("run"),
            scene: text("s"),
            command: text("c"),
            view: view(),
        };
        let json = serde_json::to_string(&SavedPath { shown: shown.clone(), keys: path().keys }).unwrap();
        let (back, found) = SavedPath::parse("p.json", &json).unwrap();
        assert_eq!((back, found.keys), (shown, path().keys));
        assert!(SavedPath::is_in(&json) && !SavedPath::is_in("{\"frames\": []}"));
        assert!(SavedPath::is_in(&json.replacen('{', "{\"keys\":0,", 1)), "the last of two counts");
        for (from, to, word) in [
            ("\"seconds\":2.0", "\"seconds\":0.0", "keyframe 2: seconds"),
            ("\"time\":0.4", "\"time\":4", "keyframe 2: time"),
            ("\"fov\":0.5,\"size\"", "\"fov\":9,\"size\"", "fov"),
            ("\"seconds\":6.0", "\"seconds\":null", "number"),
            ("\"keys\":", "\"x\":", "no keys"),
        ] {
            let bad = json.replacen(from, to, 1);
            assert!(bad != json, "{from}");
            let error = SavedPath::parse("p.json", &bad).unwrap_err();
            assert!(
                error.is_input() && error.to_string().starts_with("p.json: ") && error.to_string().contains(word),
                "{error}"
            );
        }
        assert!(CameraPath::new(vec![key(0.0, 0.0, 0.0, 1.0)]).unwrap_err().contains("2 to 150"));
    }
}
