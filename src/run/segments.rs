//! Changes to a run's segments: finding them by colour, grouping, renaming, removing, and undoing each of these.

use super::open::edits_in;
use super::{OpenRun, RunError};
use crate::config::types::SegmentConfig;
use crate::data::Surroundings;
use crate::draw::views::view_sheet;
use crate::edit::EditStack;
use crate::export::images::{encode_png, to_rgb8};
use crate::files::write_atomic;
use crate::memory::MemoryBudget;
use crate::model::{HostGaussians, ToKernel};
use crate::name::Name;
use crate::points::kmeans;
use crate::segment::coarse::{Coarse, coarse, other_times};
use crate::segment::history::SegmentHistory;
use crate::segment::pictures::draw_each;
use crate::segment::segmentation::{Segment, SegmentOrigin, Segmentation};
use image::RgbImage;
use std::path::{Path, PathBuf};

/// Maximum number of segments in a picture, those with the most opacity.
pub const SHOWN: usize = 40;

/// Direction through the history of changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HistoryDirection {
    /// Back.
    Undo,
    /// Forward again.
    Redo,
}

impl HistoryDirection {
    /// Returns the command that does it.
    pub fn verb(self) -> &'static str {
        match self {
            Self::Undo => "undo",
            Self::Redo => "redo",
        }
    }
}

/// The segments of a run with their history. A change takes effect with [`RunSegments::save`].
#[derive(Clone, Debug)]
pub struct RunSegments {
    path: PathBuf,
    found: SegmentHistory,
    /// The file of edits, in which segments are renamed too.
    edits: PathBuf,
    /// The folder of tracks, which are named after segments.
    tracks: PathBuf,
    /// Old and new names that the edits do not reflect yet, in order.
    renamed: Vec<[Name; 2]>,
}

impl RunSegments {
    /// Reads the segments; none if there is no file yet.
    ///
    /// # Errors
    /// If the file is damaged, or belongs to another scene.
    pub fn open(run: &OpenRun) -> Result<Self, RunError> {
        let path = run.paths().segments();
        if !path.exists() {
            return Ok(Self::of(run, SegmentHistory::new(run.segments()?)));
        }
        let found = SegmentHistory::load(&path).map_err(RunError::input)?;
        run.check_segments(found.now())?;
        Ok(Self::of(run, found))
    }

    /// Reads the segments in order to replace them: a file that cannot be used is no obstacle, but its error is
    /// returned.
    pub fn replacing(run: &OpenRun) -> (Self, Option<RunError>) {
        match Self::open(run) {
            Ok(segments) => (segments, None),
            Err(error) => (Self::none(run), Some(error)),
        }
    }

    /// Returns no segments, whatever the file holds: for a run whose scene is still being trained.
    pub fn none(run: &OpenRun) -> Self {
        Self::of(run, SegmentHistory::new(run.no_segments()))
    }

    fn of(run: &OpenRun, found: SegmentHistory) -> Self {
        let paths = run.paths();
        let (path, edits, tracks) = (paths.segments(), paths.edits(), paths.tracks());
        Self { path, found, edits, tracks, renamed: Vec::new() }
    }

    /// Returns the current segments.
    pub fn now(&self) -> &Segmentation {
        self.found.now()
    }

    /// Replaces the current segments; `change` describes what was done.
    pub fn change(&mut self, change: impl Into<String>, segments: Vec<Segment>) {
        self.found.change(change, segments);
    }

    /// Writes the file and, if the edits name a renamed segment, the file of edits.
    ///
    /// # Errors
    /// If the file cannot be written, in which case it is unchanged, or the edits cannot be read or written. In the
    /// last case, [`RunSegments::step`] back restores the name by which the edits know the segment.
    pub fn save(&mut self) -> Result<(), RunError> {
        let mut edits = None;
        if !self.renamed.is_empty() && self.edits.exists() {
            let mut found = EditStack::load(&self.edits).map_err(RunError::input)?;
            let changed = self.renamed.iter().map(|[old, new]| found.rename(old, new)).filter(|c| *c).count();
            edits = (changed > 0).then_some(found);
        }
        self.found.save(&self.path).map_err(RunError::failure)?;
        if let Some(edits) = edits {
            edits.save(&self.edits).map_err(RunError::failure)?;
        }
        self.renamed.clear();
        Ok(())
    }

    /// Returns the changes that can be undone or redone, the next one first.
    pub fn steps(&self, towards: HistoryDirection) -> Vec<&str> {
        match towards {
            HistoryDirection::Undo => self.found.undoable(),
            HistoryDirection::Redo => self.found.redoable(),
        }
    }

    /// Undoes or redoes `count` changes, all of them or none; returns what they were.
    ///
    /// # Errors
    /// If there are fewer than `count`, or one of them renames a segment and [`RunSegments::rename`] would refuse that.
    pub fn step(&mut self, towards: HistoryDirection, count: usize) -> Result<Vec<String>, RunError> {
        check_count(towards, count, self.steps(towards).len(), &self.path)?;
        let renames = self.check_renames(towards, count)?;
        let mut done = Vec::with_capacity(count);
        for _ in 0..count {
            done.extend(match towards {
                HistoryDirection::Undo => self.found.undo(),
                HistoryDirection::Redo => self.found.redo(),
            });
        }
        self.renamed.extend(renames);
        Ok(done)
    }

    /// Returns the renamings that the next `count` steps perform.
    ///
    /// # Errors
    /// The first one that [`RunSegments::rename`] would refuse.
    fn check_renames(&self, towards: HistoryDirection, count: usize) -> Result<Vec<[Name; 2]>, RunError> {
        let next = |count| match towards {
            HistoryDirection::Undo => self.found.undo_renames(count),
            HistoryDirection::Redo => self.found.redo_renames(count),
        };
        let renames = next(count);
        if renames.is_empty() {
            return Ok(renames);
        }
        let mut edits = edits_in(&self.edits)?;
        for [old, new] in &self.renamed {
            edits.rename(old, new);
        }
        for (i, [old, new]) in renames.iter().enumerate() {
            let first = i == 0 && !next(1).is_empty();
            if !(first && self.interrupted(towards, &edits, old, new)) {
                self.check_rename(&edits, old, new)
                    .map_err(|e| RunError::input(format!("cannot {} renaming a segment: {e}", towards.verb())))?;
            }
            edits.rename(old, new);
        }
        Ok(renames)
    }

    /// Returns whether the edits were not written after the segments when `new` was renamed to `old`, so that they
    /// still name `new`, which the next step restores: no other segment can have had that name since.
    fn interrupted(&self, towards: HistoryDirection, edits: &EditStack, old: &str, new: &str) -> bool {
        let unused = match towards {
            HistoryDirection::Undo => self.found.redoable().is_empty(),
            HistoryDirection::Redo => !self.found.had(new),
        };
        unused && edits.names(new) && !edits.names(old)
    }

    /// Renames the segment `old` to `new`. Its parts remain its parts, and edits of it are renamed when this is saved;
    /// masks identify it by its Gaussians.
    ///
    /// # Errors
    /// If there is no such segment, the name is taken, edits of a removed segment or undone edits use the name, or a
    /// track has the old or the new name.
    pub fn rename(&mut self, run: &OpenRun, old: &str, new: &Name) -> Result<(), RunError> {
        let old = self.now().get(old).map_err(RunError::input)?.name.clone();
        self.check_rename(&run.edits()?, &old, new).map_err(RunError::input)?;
        self.found.rename(&old, new).map_err(RunError::input)?;
        self.renamed.push([old, new.clone()]);
        Ok(())
    }

    /// Checks that a renaming leaves no track under a name that is no longer its segment's, and gives the segment no
    /// edits of another.
    ///
    /// # Errors
    /// A message that names the folder or file.
    fn check_rename(&self, edits: &EditStack, old: &Name, new: &Name) -> Result<(), String> {
        let track = self.tracks.join(old);
        if track.exists() {
            let track = track.display();
            return Err(format!("{old}: its track {track} is named after it; rename or remove that folder first"));
        }
        let track = self.tracks.join(new);
        if track.exists() {
            let track = track.display();
            return Err(format!("{new}: {track} is the track of another segment; rename or remove that folder first"));
        }
        if edits.names(new) {
            return Err(format!(
                "{new}: edits of a removed segment, or undone edits, have that name in {}; choose another, or clear \
                 them with `volseggs edit clear`",
                self.edits.display()
            ));
        }
        Ok(())
    }

    /// Groups several segments into a new one with its own name; they remain unchanged.
    ///
    /// # Errors
    /// If a name is unknown, the new name is taken, or the segments have no Gaussians.
    pub fn group(&mut self, name: &Name, segments: &[String]) -> Result<(), RunError> {
        let mut all = self.now().clone();
        let found = segments.iter().map(|s| all.get(s)).collect::<Result<Vec<_>, _>>().map_err(RunError::input)?;
        let members: Vec<u32> = found.iter().flat_map(|s| &s.members).copied().collect();
        let (colour, time) = found.first().map_or(([0.5; 3], 0.5), |s| (s.colour, s.time));
        if members.is_empty() {
            return Err(RunError::input(format!("{name}: these segments hold no Gaussians")));
        }
        all.add(Segment { name: name.clone(), parent: None, colour, time, origin: SegmentOrigin::Group, members })
            .map_err(RunError::input)?;
        self.change(format!("group {name}"), all.segments);
        Ok(())
    }

    /// Removes segments and their parts; returns how many were removed.
    ///
    /// # Errors
    /// If a name is unknown.
    pub fn remove(&mut self, segments: &[String]) -> Result<usize, RunError> {
        let mut all = self.now().clone();
        for name in segments {
            all.get(name).map_err(RunError::input)?;
        }
        let before = all.segments.len();
        all.remove(|s| segments.iter().any(|n| s.name == *n));
        let removed = before - all.segments.len();
        self.change(format!("remove {}", segments.join(" ")), all.segments);
        Ok(removed)
    }

    /// Finds segments by colour in the Gaussians `at` a `time`, and replaces the current ones with them. If none are
    /// found, the current ones remain, and the result says where the Gaussians went.
    ///
    /// # Errors
    /// If an option is out of range.
    pub fn coarse(
        &mut self,
        run: &OpenRun,
        at: &HostGaussians,
        time: f64,
        config: &SegmentConfig,
        seed: u64,
    ) -> Result<Coarse, RunError> {
        check_clusters(config.colour.clusters, at.len(), "the scene has", 3)?;
        let other_times = other_times(&run.scene, at, config);
        let found = coarse(at, Some(&other_times), config, seed).map_err(RunError::input)?;
        let all = by_colour(run, &found, time)?;
        if !all.segments.is_empty() {
            self.change("coarse", all.segments);
        }
        Ok(found)
    }
}

/// Returns the colours `found` at a `time` as segments.
///
/// # Errors
/// If two have one name.
pub fn by_colour(run: &OpenRun, found: &Coarse, time: f64) -> Result<Segmentation, RunError> {
    let mut all = run.no_segments();
    for (name, entry, members) in found.groups() {
        let name = Name::new(name).map_err(RunError::failure)?;
        let segment = Segment { name, parent: None, colour: entry.rgb, time, origin: SegmentOrigin::Coarse, members };
        all.add(segment).map_err(RunError::failure)?;
    }
    Ok(all)
}

/// Checks that `count` steps can be taken; `file` holds `there` of them.
///
/// # Errors
/// If not; the error says how many there are.
pub(super) fn check_count(towards: HistoryDirection, count: usize, there: usize, file: &Path) -> Result<(), RunError> {
    let verb = towards.verb();
    if there == 0 {
        return Err(RunError::input(format!("nothing to {verb} in {}", file.display())));
    }
    if count > there {
        return Err(RunError::input(format!(
            "--count {count}: must be between 1 and {there}, the number of steps to {verb}"
        )));
    }
    Ok(())
}

/// Checks that there are no more clusters than `points`, and that they fit into memory; `of` names what has the points.
///
/// # Errors
/// If not; the error says how many points, or how much memory, there are.
pub(super) fn check_clusters(clusters: usize, points: usize, of: &str, dimensions: usize) -> Result<(), RunError> {
    if clusters > points {
        return Err(RunError::input(format!("--clusters {clusters}: {of} only {points} Gaussians")));
    }
    let needed = kmeans::memory(points, dimensions, clusters);
    MemoryBudget::now().check(format!("--clusters {clusters}"), needed).map_err(RunError::input)
}

/// Draws the first [`SHOWN`] of the `segments`, each alone from three sides, one row per segment.
pub fn sheet(run: &OpenRun, around: &Surroundings, at: &HostGaussians, segments: &[Segment]) -> RgbImage {
    let (width, height) = (around.lens.width as usize, around.lens.height as usize);
    let rendering = run.scene.spec.rendering();
    let mut pictures = Vec::new();
    for segment in segments.iter().take(SHOWN) {
        let sides = around.orbit(4).into_iter().take(3).map(|camera| rendering.seen_by(camera.to_kernel()));
        for image in draw_each(at.subset(&segment.members), sides, &run.device()) {
            pictures.push((segment.name.to_string(), to_rgb8(&image, width, height)));
        }
    }
    view_sheet(&pictures, 3, 400)
}

/// Writes a picture into the run folder.
///
/// # Errors
/// If it cannot be written.
pub fn write_picture(path: &Path, picture: &RgbImage) -> Result<(), RunError> {
    let fail = |e: &dyn std::fmt::Display| RunError::failure(format!("{}: {e}", path.display()));
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(|e| fail(&e))?;
    }
    write_atomic(path, &encode_png(picture).map_err(|e| fail(&e))?).map_err(|e| fail(&e))
}
