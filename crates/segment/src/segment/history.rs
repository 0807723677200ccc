//! Undo and redo of changes to segments, as for edits: the current segments with the states before and after them, kept
//! in one file (see [`segmentation`](super::segmentation)).

use super::segmentation::file::{HistoryStep, HistorySteps, Past, key, read, write};
use super::segmentation::{Segment, Segmentation, SegmentationError};
use crate::name::Name;
use std::path::Path;

/// Maximum number of changes that can be undone.
pub const MAX_CHANGES: usize = 50;

/// Segments with the history of their changes.
#[derive(Clone, Debug, PartialEq)]
pub struct SegmentHistory {
    now: Segmentation,
    steps: HistorySteps,
}

impl SegmentHistory {
    /// Segments without any history.
    pub fn new(now: Segmentation) -> Self {
        Self { now, steps: HistorySteps::default() }
    }

    /// Reads a file written by [`SegmentHistory::save`], or one without history.
    ///
    /// # Errors
    /// If the file is missing or damaged.
    pub fn load(path: &Path) -> Result<Self, SegmentationError> {
        let (now, steps) = read(path)?;
        Ok(Self { now, steps })
    }

    /// Writes the file, atomically.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), SegmentationError> {
        write(path, &self.now, &self.steps)
    }

    /// The current segments.
    pub fn now(&self) -> &Segmentation {
        &self.now
    }

    /// Replaces the current segments by `segments`; [`SegmentHistory::undo`] restores them. `change` describes what was
    /// done, such as `remove pair`. Undone changes are discarded, and so are those before the last [`MAX_CHANGES`].
    /// Equal `segments` are no change.
    pub fn change(&mut self, change: impl Into<String>, segments: Vec<Segment>) {
        if segments == self.now.segments {
            // undoing a step that does nothing would only confuse the user
            return;
        }
        let before = std::mem::replace(&mut self.now.segments, segments);
        let step = self.store(change.into(), before);
        self.steps.undo.push(step);
        self.steps.redo.clear();
        let over = self.steps.undo.len().saturating_sub(MAX_CHANGES);
        self.steps.undo.drain(..over);
    }

    /// Renames the segment `old` to `new`, as a change that can be undone.
    ///
    /// # Errors
    /// If there is no such segment, or the new name is taken.
    pub fn rename(&mut self, old: &Name, new: &Name) -> Result<(), SegmentationError> {
        let mut all = self.now.clone();
        all.rename(old, new)?;
        self.change(format!("rename {old} {new}"), all.segments);
        if let Some(step) = self.steps.undo.last_mut() {
            step.renamed = Some([old.clone(), new.clone()]);
        }
        Ok(())
    }

    /// Returns the renamings that the next `count` calls of [`SegmentHistory::undo`] perform, in order: the name before
    /// it, then the restored one.
    pub fn undo_renames(&self, count: usize) -> Vec<[Name; 2]> {
        let next = self.steps.undo.iter().rev().take(count).filter_map(|s| s.renamed.clone());
        next.map(|[old, new]| [new, old]).collect()
    }

    /// Returns the renamings that the next `count` calls of [`SegmentHistory::redo`] perform, in order: the name before
    /// it, then the new one.
    pub fn redo_renames(&self, count: usize) -> Vec<[Name; 2]> {
        self.steps.redo.iter().rev().take(count).filter_map(|s| s.renamed.clone()).collect()
    }

    /// Returns whether a state that [`SegmentHistory::undo`] can restore has a segment of this name.
    pub fn had(&self, name: &str) -> bool {
        self.steps.undo.iter().flat_map(|s| &s.segments).any(|past| *past.segment.name == *name)
    }

    /// Undoes the last change and returns its description; `None` if there is none.
    pub fn undo(&mut self) -> Option<String> {
        let step = self.steps.undo.pop()?;
        let (change, step) = self.exchange(step);
        self.steps.redo.push(step);
        Some(change)
    }

    /// Redoes the change undone last and returns its description; `None` if there is none.
    pub fn redo(&mut self) -> Option<String> {
        let step = self.steps.redo.pop()?;
        let (change, step) = self.exchange(step);
        self.steps.undo.push(step);
        Some(change)
    }

    /// Changes that can be undone, the next one first.
    pub fn undoable(&self) -> Vec<&str> {
        self.steps.undo.iter().rev().map(|s| s.change.as_str()).collect()
    }

    /// Changes that can be redone, the next one first.
    pub fn redoable(&self) -> Vec<&str> {
        self.steps.redo.iter().rev().map(|s| s.change.as_str()).collect()
    }

    /// Restores the segments of a step; the returned step holds the ones that they replace.
    fn exchange(&mut self, step: HistoryStep) -> (String, HistoryStep) {
        let members = &self.steps.members;
        let of =
            |past: Past| Segment { members: members.get(&past.members).cloned().unwrap_or_default(), ..past.segment };
        let segments = step.segments.into_iter().map(of).collect();
        let before = std::mem::replace(&mut self.now.segments, segments);
        let back = HistoryStep { renamed: step.renamed, ..self.store(step.change.clone(), before) };
        (step.change, back)
    }

    fn store(&mut self, change: String, segments: Vec<Segment>) -> HistoryStep {
        let mut put = |mut segment: Segment| {
            let members = std::mem::take(&mut segment.members);
            let key = key(&members);
            self.steps.members.entry(key.clone()).or_insert(members);
            Past { segment, members: key }
        };
        HistoryStep { change, segments: segments.into_iter().map(&mut put).collect(), renamed: None }
    }
}

#[cfg(test)]
mod tests {
    use super::super::segmentation::SegmentOrigin;
    use super::*;
    use crate::name::Name;
    use safetensors::SafeTensors;
    use safetensors::tensor::{Dtype, TensorView};

    fn segment(name: &str, members: &[u32]) -> Segment {
        Segment {
            name: Name::new(name).unwrap(),
            parent: None,
            colour: [0.1, 0.25, 1.0],
            time: 0.3,
            origin: SegmentOrigin::Coarse,
            members: members.to_vec(),
        }
    }

    fn names(history: &SegmentHistory) -> Vec<&str> {
        history.now().segments.iter().map(|s| s.name.as_str()).collect()
    }

    fn tensors(path: &Path) -> Vec<String> {
        let bytes = std::fs::read(path).unwrap();
        let file = SafeTensors::deserialize(&bytes).unwrap();
        let mut names: Vec<String> = file.names().into_iter().map(|n| n.to_string()).collect();
        names.sort();
        names
    }

    /// Two segments, then one of them, then none.
    fn two_changes() -> SegmentHistory {
        let mut history = SegmentHistory::new(Segmentation::new(10, "abc".into()));
        history.change("coarse", vec![segment("red", &[1, 5]), segment("blue", &[2, 3])]);
        history.change("remove blue", vec![segment("red", &[1, 5])]);
        history.change("remove red", Vec::new());
        history
    }

    #[test]
    fn changes_are_undone_and_redone_across_saves() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("segments.safetensors");
        let mut history = two_changes();
        let all = history.clone();
        let keep = |history: &mut SegmentHistory| {
            history.save(&path).unwrap();
            *history = SegmentHistory::load(&path).unwrap();
        };
        keep(&mut history);
        assert_eq!(history.undoable(), ["remove red", "remove blue", "coarse"]);
        assert_eq!(history.undo().unwrap(), "remove red");
        keep(&mut history);
        assert_eq!(history.undo().unwrap(), "remove blue");
        keep(&mut history);
        assert_eq!((names(&history), history.redoable()), (vec!["red", "blue"], vec!["remove blue", "remove red"]));
        assert_eq!(history.now().get("blue").unwrap(), &segment("blue", &[2, 3]));
        keep(&mut history);
        assert_eq!(history.undo().unwrap(), "coarse");
        assert_eq!(history.undo(), None);
        for change in ["coarse", "remove blue", "remove red"] {
            keep(&mut history);
            assert_eq!(history.redo().unwrap(), change);
        }
        assert_eq!((history.redo(), history.now()), (None, all.now()));
        history.undo();
        history.change("group pair", vec![segment("pair", &[1])]);
        assert!(history.redoable().is_empty(), "a new change discards undone ones");
        let before = history.clone();
        history.change("group pair", vec![segment("pair", &[1])]);
        assert_eq!(history, before, "a change without effect is not a step");
    }

    #[test]
    fn renames_are_undone_and_redone_across_saves() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("segments.safetensors");
        let [blue, sky] = ["blue", "sky"].map(|n| Name::new(n).unwrap());
        let mut history = two_changes();
        history.undo();
        history.undo();
        history.rename(&blue, &sky).unwrap();
        assert_eq!((names(&history), history.undoable()[0]), (vec!["red", "sky"], "rename blue sky"));
        history.save(&path).unwrap();
        let mut history = SegmentHistory::load(&path).unwrap();
        assert_eq!(history.undo_renames(9), [[sky.clone(), blue.clone()]]);
        assert!(history.had("blue") && !history.had("sky"));
        history.undo();
        assert_eq!((names(&history), history.undo_renames(1)), (vec!["red", "blue"], Vec::new()));
        assert_eq!(history.redo_renames(1), [[blue.clone(), sky.clone()]]);
        history.redo();
        assert_eq!((history.undo_renames(0), history.undo_renames(1)), (Vec::new(), vec![[sky, blue]]));
    }

    #[test]
    fn members_are_kept_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("segments.safetensors");
        let mut history = two_changes();
        history.save(&path).unwrap();
        assert_eq!(tensors(&path).iter().filter(|n| n.starts_with("history/")).count(), 2);
        history.undo();
        history.save(&path).unwrap();
        assert_eq!(tensors(&path).iter().filter(|n| n.starts_with("history/")).count(), 1, "red is a current segment");
        let bytes = std::fs::read(&path).unwrap();
        history.save(&path).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), bytes, "the same content gives the same bytes");
        // readers of the segments alone use the same file
        assert_eq!(&Segmentation::load(&path).unwrap(), history.now());
    }

    #[test]
    fn the_oldest_changes_are_forgotten_and_their_members_too() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("segments.safetensors");
        let mut history = SegmentHistory::new(Segmentation::new(1000, "abc".into()));
        for i in 0..80 {
            history.change(format!("change {i}"), vec![segment("red", &[i])]);
        }
        assert_eq!(history.undoable().len(), MAX_CHANGES);
        history.save(&path).unwrap();
        let mut history = SegmentHistory::load(&path).unwrap();
        assert_eq!(tensors(&path).len(), MAX_CHANGES + 2, "with the current segment and the digest");
        while history.undo().is_some() {}
        assert_eq!(history.now().segments, [segment("red", &[29])]);
    }

    #[test]
    fn a_hostile_file_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("segments.safetensors");
        let write = |entry: serde_json::Value, indices: &[u32]| {
            let data: Vec<u8> = indices.iter().flat_map(|i| i.to_le_bytes()).collect();
            let view = |d| TensorView::new(Dtype::U32, vec![indices.len()], d).unwrap();
            let header = [("volseggs.segments".to_owned(), entry.to_string())].into_iter().collect();
            let named = [("red", view(&data)), ("../x", view(&data)), ("history/k", view(&data))];
            std::fs::write(&path, safetensors::serialize(named, Some(header)).unwrap()).unwrap();
        };
        let entry = |names: &[&str]| {
            let one = |name: &&str| serde_json::json!({ "name": name, "colour": [0.0, 0.0, 1.0], "time": 0.5, "origin": { "kind": "coarse" } });
            let all: Vec<_> = names.iter().map(one).collect();
            serde_json::json!({ "format": 1, "gaussians": 9, "scene": "abc", "segments": all, "undo": [], "redo": [] })
        };
        write(entry(&["red"]), &[1, 2]);
        let mut found = SegmentHistory::load(&path).unwrap();
        assert_eq!(names(&found), ["red"]);
        assert_eq!(found.undo(), None);
        let refused = |word: &str| {
            for error in [SegmentHistory::load(&path).unwrap_err(), Segmentation::load(&path).unwrap_err()] {
                let error = error.to_string();
                assert!(error.contains(word) && error.contains("segments.safetensors"), "{error}");
            }
        };
        write(entry(&["../x"]), &[1, 2]);
        refused("cannot be a name");
        write(entry(&["red", "red"]), &[1, 2]);
        refused("two segments");
        write(entry(&["red"]), &[2, 1]);
        refused("ascending");
        let mut many = entry(&["red"]);
        many["gaussians"] = u64::MAX.into();
        write(many, &[1, 2]);
        refused("more than any scene has");
        // earlier states are validated in the same way
        let mut with = entry(&["red"]);
        let past = |name: &str, members: &str| {
            let mut segment = entry(&[name])["segments"][0].clone();
            segment["time"] = 0.25.into();
            serde_json::json!([{ "change": "coarse", "segments": [{ "segment": segment, "members": members }] }])
        };
        for (name, members, word) in [("../x", "k", "cannot be a name"), ("blue", "other", "members other")] {
            with["undo"] = past(name, members);
            write(with.clone(), &[1, 2]);
            let error = SegmentHistory::load(&path).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
        with["undo"] = past("blue", "k");
        write(with, &[1, 2]);
        let mut found = SegmentHistory::load(&path).unwrap();
        found.undo().unwrap();
        assert_eq!(names(&found), ["blue"]);
    }
}
