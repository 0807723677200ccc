//! Named segments of a scene, and their file in a run folder: which Gaussians each holds, whose part it is, and how it
//! was made. How segments are found is not decided here.

use crate::name::Name;
use crate::tensors::{self, TensorFileError};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Name of the file within a run folder.
pub const FILE: &str = "segments/segments.safetensors";
/// The header's entry.
const ENTRY: &str = "volseggs.segments";

/// How a segment came to be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum Origin {
    /// A cluster of view-independent colours.
    Coarse,
    /// A cluster of affinity features.
    Fine {
        /// Mask scale in [0, 1], from small parts to large ones.
        scale: f32,
    },
    /// All Gaussians whose affinity with a clicked one exceeds a threshold.
    Pick {
        /// Mask scale in [0, 1].
        scale: f32,
        /// Cosine similarity that a member has at least.
        threshold: f32,
    },
    /// Several segments taken together.
    Group,
}

/// A named set of Gaussians.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Segment {
    /// Unique name.
    pub name: Name,
    /// The segment that this one is a part of.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parent: Option<Name>,
    /// Colour to show it in, RGB in [0, 1].
    pub colour: [f32; 3],
    /// Time at which it was found, in [0, 1].
    pub time: f64,
    /// How it was found.
    pub origin: Origin,
    /// Indices of its Gaussians, ascending.
    #[serde(skip)]
    pub members: Vec<u32>,
}

/// The segments of a scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Segmentation {
    /// Gaussians of the scene.
    pub gaussians: usize,
    /// Fingerprint of the scene that the indices count in.
    pub scene: String,
    /// Parents before their parts.
    pub segments: Vec<Segment>,
}

/// Why segments cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SegmentationError {
    /// The file cannot be read or written, or is damaged.
    #[error(transparent)]
    File(#[from] TensorFileError),
    /// The file is not what it should be.
    #[error("{path}: {reason}")]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A name that is taken.
    #[error("segment \"{name}\": {reason}")]
    Name {
        /// The name.
        name: Name,
        /// What is wrong.
        reason: &'static str,
    },
    /// No segment has that name.
    #[error("no segment \"{name}\"; there is {list}")]
    Unknown {
        /// The name.
        name: String,
        /// Those that are there.
        list: String,
    },
}

impl Segmentation {
    /// No segments yet, of a scene with `gaussians` and the fingerprint `scene`.
    pub fn new(gaussians: usize, scene: String) -> Self {
        Self { gaussians, scene, segments: Vec::new() }
    }

    /// Adds a segment; members are sorted and each is kept once.
    ///
    /// # Errors
    /// If the name is taken.
    pub fn add(&mut self, mut segment: Segment) -> Result<(), SegmentationError> {
        let fail = |reason| Err(SegmentationError::Name { name: segment.name.clone(), reason });
        if self.get(&segment.name).is_ok() {
            return fail("there is one of that name; remove it first or choose another");
        }
        segment.members.sort_unstable();
        segment.members.dedup();
        self.segments.push(segment);
        Ok(())
    }

    /// The segment called `name`.
    ///
    /// # Errors
    /// If there is none; the message lists those that are there.
    pub fn get(&self, name: &str) -> Result<&Segment, SegmentationError> {
        self.segments.iter().find(|s| s.name == name).ok_or_else(|| {
            let names: Vec<&str> = self.segments.iter().map(|s| s.name.as_str()).collect();
            let list =
                if names.is_empty() { "none yet: run `volseggs segment coarse`".into() } else { names.join(", ") };
            SegmentationError::Unknown { name: name.into(), list }
        })
    }

    /// How many segments each is a part of, one within the other; 0 for a whole.
    #[must_use]
    pub fn depths(&self) -> Vec<usize> {
        let mut depths: Vec<usize> = Vec::with_capacity(self.segments.len());
        for segment in &self.segments {
            // wholes come before their parts, so a depth is known when it is asked for
            let whole = self.segments[..depths.len()].iter().position(|s| Some(&s.name) == segment.parent.as_ref());
            depths.push(whole.map_or(0, |i| depths[i] + 1));
        }
        depths
    }

    /// Removes the segments for which `drop` holds, and their parts.
    pub fn remove(&mut self, drop: impl Fn(&Segment) -> bool) {
        let mut gone: Vec<Name> = Vec::new();
        self.segments.retain(|s| {
            let goes = drop(s) || s.parent.as_ref().is_some_and(|p| gone.contains(p));
            if goes {
                gone.push(s.name.clone());
            }
            !goes
        });
    }

    /// Names of the segments that have no parts, in their order.
    #[must_use]
    pub fn leaves(&self) -> Vec<String> {
        let whole = |name: &str| self.segments.iter().any(|s| s.parent.as_deref() == Some(name));
        self.segments.iter().filter(|s| !whole(&s.name)).map(|s| s.name.to_string()).collect()
    }

    /// A label for each Gaussian: the position + 1 of the last of `names` that holds it, 0 for none.
    ///
    /// # Errors
    /// If a name is unknown.
    pub fn labels(&self, names: &[String]) -> Result<Vec<u32>, SegmentationError> {
        let mut labels = vec![0; self.gaussians];
        for (label, name) in (1..).zip(names) {
            for &i in &self.get(name)?.members {
                labels[i as usize] = label;
            }
        }
        Ok(labels)
    }

    /// Writes the file, atomically.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), SegmentationError> {
        let format = |reason: String| SegmentationError::Format { path: path.into(), reason };
        let bytes: Vec<(String, Vec<u8>)> = self
            .segments
            .iter()
            .map(|s| (s.name.to_string(), s.members.iter().flat_map(|i| i.to_le_bytes()).collect()))
            .collect();
        let views = bytes
            .iter()
            .map(|(name, data)| Ok((name.as_str(), TensorView::new(Dtype::U32, vec![data.len() / 4], data)?)))
            .collect::<Result<Vec<_>, safetensors::SafeTensorError>>()
            .map_err(|e| format(e.to_string()))?;
        let entry = serde_json::to_string(self).map_err(|e| format(e.to_string()))?;
        if let Some(folder) = path.parent() {
            let io = |source| TensorFileError::Io { path: path.into(), source };
            std::fs::create_dir_all(folder).map_err(io)?;
        }
        Ok(tensors::write(path, views, Some((ENTRY, entry)))?)
    }

    /// Reads what [`Segmentation::save`] wrote.
    ///
    /// # Errors
    /// If the file is missing or damaged, or names a Gaussian that the scene has not.
    pub fn load(path: &Path) -> Result<Self, SegmentationError> {
        let bytes = tensors::read(path)?;
        let format = |reason: String| SegmentationError::Format { path: path.into(), reason };
        let damaged = |e: safetensors::SafeTensorError| format(format!("damaged or not a safetensors file: {e}"));
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(damaged)?;
        let file = SafeTensors::deserialize(&bytes).map_err(damaged)?;
        let entry = header.metadata().as_ref().and_then(|m| m.get(ENTRY));
        let entry = entry.ok_or_else(|| format(format!("no `{ENTRY}` entry in its header: not a file of segments")))?;
        let mut all: Self = serde_json::from_str(entry).map_err(|e| format(format!("header: {e}")))?;
        let n = all.gaussians;
        for segment in &mut all.segments {
            let tensor = file.tensor(&segment.name).map_err(damaged)?;
            if tensor.dtype() != Dtype::U32 {
                return Err(format(format!("segment {}: {:?}, expected U32", segment.name, tensor.dtype())));
            }
            let index = |b: &[u8]| u32::from_le_bytes([b[0], b[1], b[2], b[3]]);
            segment.members = tensor.data().chunks_exact(4).map(index).collect();
            if let Some(bad) = segment.members.iter().find(|&&i| i as usize >= n) {
                return Err(format(format!("segment {}: Gaussian {bad}, but the scene has {n}", segment.name)));
            }
        }
        Ok(all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn segment(name: &str, parent: Option<&str>, members: &[u32]) -> Segment {
        Segment {
            name: Name::new(name).unwrap(),
            parent: parent.map(|p| Name::new(p).unwrap()),
            colour: [0.5, 0.25, 1.0],
            time: 0.3,
            origin: Origin::Fine { scale: 0.1 },
            members: members.to_vec(),
        }
    }

    fn three() -> Segmentation {
        let mut all = Segmentation::new(10, "abc".into());
        all.add(segment("red", None, &[5, 1, 3, 3])).unwrap();
        all.add(segment("red.1", Some("red"), &[1, 3])).unwrap();
        all.add(segment("blue", None, &[])).unwrap();
        all
    }

    #[test]
    fn a_file_comes_back_as_it_was_and_damage_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/segments.safetensors");
        let all = three();
        all.save(&path).unwrap();
        assert_eq!(Segmentation::load(&path).unwrap(), all);
        assert_eq!(all.get("red").unwrap().members, [1, 3, 5]);
        let bytes = std::fs::read(&path).unwrap();
        for end in 0..bytes.len() {
            std::fs::write(&path, &bytes[..end]).unwrap();
            Segmentation::load(&path).unwrap_err();
        }
        let mut small = all.clone();
        small.gaussians = 5;
        small.save(&path).unwrap();
        let error = Segmentation::load(&path).unwrap_err().to_string();
        assert!(error.contains("Gaussian 5") && error.contains("red"), "{error}");
    }

    #[test]
    fn names_are_unique_and_plain_and_parts_go_with_their_whole() {
        let mut all = three();
        assert!(all.add(segment("red", None, &[])).is_err());
        assert!(all.get("green").unwrap_err().to_string().contains("red, red.1, blue"));
        assert_eq!(all.depths(), [0, 1, 0]);
        assert_eq!(all.labels(&["red".into(), "red.1".into()]).unwrap(), [0, 2, 0, 2, 0, 1, 0, 0, 0, 0]);
        assert_eq!(all.leaves(), ["red.1", "blue"]);
        all.remove(|s| s.name == "red");
        assert_eq!(all.segments.iter().map(|s| s.name.as_str()).collect::<Vec<_>>(), ["blue"]);
    }
}
