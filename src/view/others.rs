//! Other runs with which the viewed one is compared; they are shown and never changed.

use super::protocol::OtherRun;
use super::workspace::Workspace;
use crate::run::{OpenRun, RunError};
use burn::tensor::Device;
use glam::DVec3;
use std::path::{Path, PathBuf};

/// Two scenes are far apart if their sizes differ by more than this factor, or their centres by more than the larger
/// half size divided by it.
const APART: f64 = 2.0;

/// Another run.
#[derive(Debug)]
pub struct ComparedRun {
    /// A short name that no other of them has.
    name: String,
    /// The run, in which nothing may be changed.
    pub space: Workspace,
}

impl ComparedRun {
    /// Opens the runs at `paths`, in order.
    ///
    /// # Errors
    /// The first that cannot be opened, or one that is given twice.
    pub fn open(paths: &[PathBuf], device: &Device) -> Result<Vec<Self>, RunError> {
        let whole: Vec<PathBuf> =
            paths.iter().map(|path| path.canonicalize().unwrap_or_else(|_| path.clone())).collect();
        if let Some(k) = (0..whole.len()).find(|&k| whole[..k].contains(&whole[k])) {
            return Err(RunError::input(format!("--with {}: is given twice; give each run once", paths[k].display())));
        }
        let opened = paths.iter().zip(names(&whole)).map(|(path, name)| {
            let space = Workspace::open(path, None, device, true)?;
            Ok(Self { name, space })
        });
        opened.collect()
    }

    /// Returns its short name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns what clients of `run` are told about it.
    pub fn describe(&self, run: &OpenRun) -> OtherRun {
        let other = &self.space.shown.run;
        OtherRun {
            name: self.name.clone(),
            step: other.step(),
            gaussians: other.scene.gaussians.count(),
            note: differences(run, other),
        }
    }
}

/// The last folders of each path, as many as distinguish it from the others.
fn names(paths: &[PathBuf]) -> Vec<String> {
    let last = |path: &Path, n: usize| {
        let parts: Vec<_> = path.iter().map(|part| part.to_string_lossy()).collect();
        parts[parts.len().saturating_sub(n)..].join("/")
    };
    let alone = |path: &PathBuf, n: usize| paths.iter().filter(|p| last(p, n) == last(path, n)).count() == 1;
    let name = |path: &PathBuf| {
        let parts = path.iter().count().max(1);
        let n = (1..parts).find(|&n| alone(path, n)).unwrap_or(parts);
        last(path, n)
    };
    paths.iter().map(name).collect()
}

/// Differences of `other` from `run` that make the two harder to compare.
fn differences(run: &OpenRun, other: &OpenRun) -> Option<String> {
    let mut found = Vec::new();
    let [ours, theirs] = [run, other].map(|r| r.record.fingerprint.as_str());
    if ours != theirs && !ours.is_empty() && !theirs.is_empty() {
        found.push(format!("it was trained on different data, {}", other.record.dataset.display()));
    }
    let [ours, theirs] = [run, other].map(|r| r.config.stages.joint_steps);
    if theirs == 0 && ours > 0 {
        found.push("it is a static scene, the same at all times".to_owned());
    } else if ours == 0 && theirs > 0 {
        found.push("it changes over time, while this run is a static scene".to_owned());
    }
    let place = |r: &OpenRun| {
        let size = r.scene.spec.half_size.into_iter().fold(f32::MIN_POSITIVE, f32::max);
        (r.scene.spec.centre(), f64::from(size))
    };
    if far_apart(place(run), place(other)) {
        found.push("its scene differs in position or size: the same camera may show little of it".to_owned());
    }
    (!found.is_empty()).then(|| found.join("; "))
}

/// Whether two scenes, each given by its centre and half size, are placed so that no one camera shows both well.
fn far_apart((here, size): (DVec3, f64), (there, other): (DVec3, f64)) -> bool {
    let ratio = size.max(other) / size.min(other);
    ratio > APART || here.distance(there) > size.max(other) / APART
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_as_short_as_uniqueness_allows() {
        let of = |paths: &[&str]| names(&paths.iter().map(PathBuf::from).collect::<Vec<_>>());
        assert_eq!(of(&["/a/first", "/a/second"]), ["first", "second"]);
        assert_eq!(of(&["/a/run", "/b/run", "/c/other"]), ["a/run", "b/run", "other"]);
        assert_eq!(of(&["/x/a/run", "/y/a/run"]), ["x/a/run", "y/a/run"]);
        assert_eq!(of(&["/", "/run"]), ["/", "run"]);
        assert_eq!(of(&[]), [] as [&str; 0]);
    }

    #[test]
    fn scenes_that_differ_in_position_or_size_are_far_apart() {
        let at = |x: f64, size: f64| (DVec3::new(x, 0.0, 0.0), size);
        assert!(!far_apart(at(0.0, 1.0), at(0.2, 1.3)) && !far_apart(at(0.0, 1.0), at(0.0, 2.0)));
        assert!(far_apart(at(0.0, 1.0), at(0.0, 2.1)) && far_apart(at(0.0, 1.0), at(0.0, 0.4)));
        assert!(far_apart(at(0.0, 1.0), at(0.6, 1.0)));
    }
}
