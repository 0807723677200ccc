//! The file of segments: one tensor of indices per segment, and one header entry for everything else. States that can
//! be restored lie in the same file, so that segments and history always match.

use super::{Segment, Segmentation, SegmentationError};
use crate::name::Name;
use crate::tensors::{self, TensorFileError};
use crate::versioned;
use safetensors::tensor::{Dtype, SafeTensorError, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use twox_hash::XxHash3_128;

/// Name of the header entry.
const ENTRY: &str = "volseggs.segments";
/// Prefix of the key of members that only earlier states have; no segment name contains a slash.
const PAST: &str = "history/";

/// A segment of an earlier state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(in crate::segment) struct Past {
    /// The segment without its members.
    pub segment: Segment,
    /// Key of its members, see [`key`].
    pub members: String,
}

/// A change, and the segments on its other side: before a change that can be undone, after one that can be redone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(in crate::segment) struct HistoryStep {
    /// What was done, such as `remove pair`.
    pub change: String,
    /// The segments.
    pub segments: Vec<Past>,
    /// The old and the new name, if the change renamed a segment.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub renamed: Option<[Name; 2]>,
}

/// Changes that can be undone and redone, the next one last, and the members of their segments by key.
#[derive(Clone, Debug, Default, PartialEq)]
pub(in crate::segment) struct HistorySteps {
    pub undo: Vec<HistoryStep>,
    pub redo: Vec<HistoryStep>,
    pub members: BTreeMap<String, Vec<u32>>,
}

impl HistorySteps {
    /// Keys of the members that the steps need.
    fn needed(&self) -> BTreeSet<&str> {
        let steps = self.undo.iter().chain(&self.redo);
        steps.flat_map(|s| &s.segments).map(|s| s.members.as_str()).collect()
    }
}

/// The header entry; borrowed when it is written.
#[derive(Serialize, Deserialize)]
struct SegmentationHeader<'a> {
    gaussians: usize,
    scene: Cow<'a, str>,
    segments: Cow<'a, [Segment]>,
    undo: Cow<'a, [HistoryStep]>,
    redo: Cow<'a, [HistoryStep]>,
}

fn bytes(members: &[u32]) -> Vec<u8> {
    members.iter().flat_map(|i| i.to_le_bytes()).collect()
}

/// Returns the key that identifies the members of a segment: 32 hexadecimal digits, a 128-bit hash.
pub fn key(members: &[u32]) -> String {
    format!("{:032x}", XxHash3_128::oneshot(&bytes(members)))
}

impl Segmentation {
    /// Writes the file atomically, without earlier states.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), SegmentationError> {
        write(path, self, &HistorySteps::default())
    }

    /// Reads the segments of a file.
    ///
    /// # Errors
    /// If the file is missing or damaged, or names a Gaussian that the scene does not have.
    pub fn load(path: &Path) -> Result<Self, SegmentationError> {
        Ok(open(path, |_, _| Ok(HistorySteps::default()))?.0)
    }
}

/// Writes segments and steps.
pub(in crate::segment) fn write(
    path: &Path,
    all: &Segmentation,
    steps: &HistorySteps,
) -> Result<(), SegmentationError> {
    let format = |reason: String| SegmentationError::Format { path: path.into(), reason };
    let mut tensors: Vec<(String, Vec<u8>)> =
        all.segments.iter().map(|s| (s.name.to_string(), bytes(&s.members))).collect();
    if !steps.undo.is_empty() || !steps.redo.is_empty() {
        // members of a current segment are found there
        let now: BTreeSet<String> = all.segments.iter().map(|s| key(&s.members)).collect();
        for key in steps.needed().into_iter().filter(|k| !now.contains(*k)) {
            let members = steps.members.get(key).ok_or_else(|| format(format!("members {key} are missing")))?;
            tensors.push((format!("{PAST}{key}"), bytes(members)));
        }
    }
    let views = tensors
        .iter()
        .map(|(name, data)| Ok((name.as_str(), TensorView::new(Dtype::U32, vec![data.len() / 4], data)?)))
        .collect::<Result<Vec<_>, SafeTensorError>>()
        .map_err(|e| format(e.to_string()))?;
    let entry = SegmentationHeader {
        gaussians: all.gaussians,
        scene: all.scene.as_str().into(),
        segments: all.segments.as_slice().into(),
        undo: steps.undo.as_slice().into(),
        redo: steps.redo.as_slice().into(),
    };
    let entry = versioned::to_json(&entry).map_err(|e| format(e.to_string()))?;
    if let Some(folder) = path.parent() {
        let io = |source| TensorFileError::Io { path: path.into(), source };
        std::fs::create_dir_all(folder).map_err(io)?;
    }
    Ok(tensors::write(path, views, Some((ENTRY, entry)))?)
}

/// Reads segments and steps.
pub(in crate::segment) fn read(path: &Path) -> Result<(Segmentation, HistorySteps), SegmentationError> {
    open(path, past)
}

/// An opened file.
struct Opened<'a> {
    tensors: SafeTensors<'a>,
    all: &'a Segmentation,
    undo: Vec<HistoryStep>,
    redo: Vec<HistoryStep>,
}

fn open(
    path: &Path,
    rest: impl Fn(&Path, Opened<'_>) -> Result<HistorySteps, SegmentationError>,
) -> Result<(Segmentation, HistorySteps), SegmentationError> {
    let bytes = tensors::read(path)?;
    let format = |reason: String| SegmentationError::Format { path: path.into(), reason };
    let damaged = |e: SafeTensorError| format(format!("damaged or not a safetensors file: {e}"));
    let (_, header) = SafeTensors::read_metadata(&bytes).map_err(damaged)?;
    let tensors = SafeTensors::deserialize(&bytes).map_err(damaged)?;
    let entry = header.metadata().as_ref().and_then(|m| m.get(ENTRY));
    let entry = entry.ok_or_else(|| format(format!("no `{ENTRY}` entry in its header: not a segments file")))?;
    let found: SegmentationHeader<'static> = versioned::from_json(entry).map_err(|e| format(format!("header: {e}")))?;
    let SegmentationHeader { gaussians, scene, segments, undo, redo } = found;
    let mut all = Segmentation { gaussians, scene: scene.into_owned(), segments: segments.into_owned() };
    if u32::try_from(all.gaussians).is_err() {
        return Err(format(format!("header: `gaussians` is {}, more than any scene has", all.gaussians)));
    }
    for i in 0..all.segments.len() {
        let (before, from) = all.segments.split_at_mut(i);
        let segment = &mut from[0];
        if before.iter().any(|s| s.name == segment.name) {
            return Err(format(format!("two segments are named {}", segment.name)));
        }
        let members = members(&tensors, &segment.name, all.gaussians);
        segment.members = members.map_err(|e| format(format!("segment {}: {e}", segment.name)))?;
    }
    let steps = rest(path, Opened { tensors, all: &all, undo: undo.into_owned(), redo: redo.into_owned() })?;
    Ok((all, steps))
}

/// The steps of a file, with the members of their segments.
fn past(path: &Path, file: Opened<'_>) -> Result<HistorySteps, SegmentationError> {
    let mut steps = HistorySteps { undo: file.undo, redo: file.redo, members: BTreeMap::new() };
    let keys: BTreeSet<String> = steps.needed().into_iter().map(str::to_owned).collect();
    if keys.is_empty() {
        return Ok(steps);
    }
    let now: BTreeMap<String, &Segment> = file.all.segments.iter().map(|s| (key(&s.members), s)).collect();
    for key in keys {
        let found = match now.get(&key) {
            Some(segment) => Ok(segment.members.clone()),
            None => members(&file.tensors, &format!("{PAST}{key}"), file.all.gaussians),
        };
        let found = found.map_err(|e| SegmentationError::Format {
            path: path.into(),
            reason: format!("history, members {key}: {e}"),
        })?;
        steps.members.insert(key, found);
    }
    Ok(steps)
}

/// Reads ascending indices below `count`.
fn members(file: &SafeTensors<'_>, name: &str, count: usize) -> Result<Vec<u32>, String> {
    let tensor = file.tensor(name).map_err(|e| e.to_string())?;
    if tensor.dtype() != Dtype::U32 {
        return Err(format!("its type is {:?}, expected U32", tensor.dtype()));
    }
    let index = |b: &[u8]| u32::from_le_bytes([b[0], b[1], b[2], b[3]]);
    let members: Vec<u32> = tensor.data().chunks_exact(4).map(index).collect();
    if let Some(bad) = members.iter().find(|&&i| i as usize >= count) {
        return Err(format!("Gaussian {bad} is listed, but the scene has only {count}"));
    }
    if members.windows(2).any(|pair| pair[0] >= pair[1]) {
        return Err("its Gaussians are not in ascending order".into());
    }
    Ok(members)
}
