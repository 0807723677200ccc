//! Named segments of a scene, and their file in a run folder: the Gaussians of each, its parent, and how it was made.
//! Finding segments is done elsewhere.

pub(super) mod file;
#[cfg(test)]
mod tests;

pub use file::key as members_key;

use super::palette::distinct_colour;
use crate::name::{Name, NameError};
use crate::tensors::{DIGEST, TensorFileError};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// How a segment came to be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum SegmentOrigin {
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
        /// Minimum cosine similarity of a member.
        threshold: f32,
    },
    /// Several segments combined.
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
    pub origin: SegmentOrigin,
    /// Indices of its Gaussians, ascending.
    #[serde(skip)]
    pub members: Vec<u32>,
}

/// The segments of a scene.
///
/// ```
/// use volseggs_segment::segment::segmentation::Segmentation;
/// let segments = Segmentation::new(1000, "fingerprint of the scene".into());
/// assert!(segments.get("red").is_err(), "it has no segments yet");
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Segmentation {
    /// Number of Gaussians in the scene.
    pub gaussians: usize,
    /// Fingerprint of the scene that the indices refer to.
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
    /// The file does not have the expected format.
    #[error("{path}: {reason}")]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A name that is taken or reserved.
    #[error("segment \"{name}\": {reason}")]
    Name {
        /// The name.
        name: Name,
        /// What is wrong.
        reason: &'static str,
    },
    /// No segment has that name.
    #[error("no segment \"{name}\"; available: {list}")]
    Unknown {
        /// The name.
        name: String,
        /// The existing segments.
        list: String,
    },
}

impl Segment {
    /// Whether all of the Gaussians `members` are in it.
    pub fn holds(&self, members: &[u32]) -> bool {
        members.iter().all(|i| self.members.binary_search(i).is_ok())
    }
}

impl Segmentation {
    /// Creates an empty segmentation of a scene with `gaussians` and the fingerprint `scene`.
    pub fn new(gaussians: usize, scene: String) -> Self {
        Self { gaussians, scene, segments: Vec::new() }
    }

    /// Returns the segments that are no parts of others.
    pub fn wholes(&self) -> impl Iterator<Item = &Segment> {
        self.segments.iter().filter(|segment| segment.parent.is_none())
    }

    /// Returns the first whole that holds all of the Gaussians `members`.
    pub fn whole_of(&self, members: &[u32]) -> Option<&Segment> {
        self.wholes().find(|whole| whole.holds(members))
    }

    /// Adds a segment; its members are sorted and deduplicated.
    ///
    /// # Errors
    /// If the name is taken or reserved.
    pub fn add(&mut self, mut segment: Segment) -> Result<(), SegmentationError> {
        self.check_free(&segment.name)?;
        segment.members.sort_unstable();
        segment.members.dedup();
        self.segments.push(segment);
        Ok(())
    }

    /// Renames the segment `old` to `new`; its parts stay its parts, under their own names.
    ///
    /// # Errors
    /// If there is no such segment, or the new name is taken or reserved.
    pub fn rename(&mut self, old: &str, new: &Name) -> Result<(), SegmentationError> {
        self.get(old)?;
        self.check_free(new)?;
        for segment in &mut self.segments {
            if segment.name == *old {
                segment.name = new.clone();
            }
            if segment.parent.as_deref() == Some(old) {
                segment.parent = Some(new.clone());
            }
        }
        Ok(())
    }

    fn check_free(&self, name: &Name) -> Result<(), SegmentationError> {
        let fail = |reason| Err(SegmentationError::Name { name: name.clone(), reason });
        if self.get(name).is_ok() {
            return fail("this name is taken; remove that segment first or choose another name");
        }
        // keys of the header of a tensor file; files beside the pictures of segments
        if [DIGEST, "__metadata__", "coarse", "masks", "pictures.json"].contains(&name.as_str()) {
            return fail("this name is reserved for files of the run; choose another");
        }
        Ok(())
    }

    /// Returns the segment called `name`.
    ///
    /// # Errors
    /// If there is none; the message lists the existing ones.
    pub fn get(&self, name: &str) -> Result<&Segment, SegmentationError> {
        self.segments.iter().find(|s| s.name == name).ok_or_else(|| {
            let names: Vec<&str> = self.segments.iter().map(|s| s.name.as_str()).collect();
            let list =
                if names.is_empty() { "none yet; run `volseggs segment coarse`".into() } else { names.join(", ") };
            SegmentationError::Unknown { name: name.into(), list }
        })
    }

    /// Returns the nesting depth of each segment; 0 for a whole.
    pub fn depths(&self) -> Vec<usize> {
        let mut depths: Vec<usize> = Vec::with_capacity(self.segments.len());
        for segment in &self.segments {
            // wholes come before their parts, so a depth is known when it is needed
            let whole = self.segments[..depths.len()].iter().position(|s| Some(&s.name) == segment.parent.as_ref());
            depths.push(whole.map_or(0, |i| depths[i] + 1));
        }
        depths
    }

    /// Returns all segments with their depths, each whole followed by its parts and theirs, in order of creation.
    pub fn tree(&self) -> Vec<(usize, &Segment)> {
        let place = |name: &Name| self.segments.iter().position(|s| s.name == **name);
        let mut parts = vec![Vec::new(); self.segments.len()];
        let mut next = Vec::new();
        for (i, segment) in self.segments.iter().enumerate() {
            match segment.parent.as_ref().and_then(place).filter(|whole| *whole < i) {
                Some(whole) => parts[whole].push(i),
                None => next.push((0, i)),
            }
        }
        next.reverse();
        let mut tree = Vec::with_capacity(self.segments.len());
        while let Some((depth, i)) = next.pop() {
            tree.push((depth, &self.segments[i]));
            next.extend(parts[i].iter().rev().map(|part| (depth + 1, *part)));
        }
        tree
    }

    /// Returns the segments that users made below the parts of an earlier split of `whole`: picked or grouped in one of
    /// those, or in a part of it.
    pub fn made_below_parts(&self, whole: &str) -> Vec<&Segment> {
        let (mut below, mut made) = (Vec::new(), Vec::new());
        for segment in &self.segments {
            let Some(parent) = &segment.parent else { continue };
            if *parent == *whole && matches!(segment.origin, SegmentOrigin::Fine { .. }) {
                below.push(&segment.name);
            } else if below.contains(&parent) {
                below.push(&segment.name);
                if matches!(segment.origin, SegmentOrigin::Pick { .. } | SegmentOrigin::Group) {
                    made.push(segment);
                }
            }
        }
        made
    }

    /// Removes the parts of an earlier split of `whole` and everything below them. What was picked in `whole` itself
    /// stays.
    pub fn remove_parts(&mut self, whole: &str) {
        self.remove(|s| s.parent.as_deref() == Some(whole) && matches!(s.origin, SegmentOrigin::Fine { .. }));
    }

    /// Returns the first of `NAME.1`, `NAME.2`, ... from `NAME.from` on that no segment has and that is not `used`
    /// otherwise, and its number.
    ///
    /// # Errors
    /// If that name is too long.
    pub fn free_part(
        &self,
        whole: &Name,
        from: usize,
        used: &dyn Fn(&str) -> bool,
    ) -> Result<(Name, usize), NameError> {
        let mut number = from;
        loop {
            let name = Name::new(format!("{whole}.{number}"))?;
            if !used(&name) && self.segments.iter().all(|s| s.name != name) {
                return Ok((name, number));
            }
            number += 1;
        }
    }

    /// Returns the first of a sequence of distinct colours, RGB in [0, 1], that no segment has.
    pub fn free_colour(&self) -> [f32; 3] {
        let colour = |k| distinct_colour(k).map(|c| f32::from(c) / 255.0);
        let is_free = |c: &[f32; 3]| self.segments.iter().all(|s| s.colour != *c);
        (0..=self.segments.len()).map(colour).find(is_free).unwrap_or_else(|| colour(self.segments.len()))
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

    /// Returns the names of the segments that have no parts, in order.
    pub fn leaves(&self) -> Vec<String> {
        let whole = |name: &str| self.segments.iter().any(|s| s.parent.as_deref() == Some(name));
        self.segments.iter().filter(|s| !whole(&s.name)).map(|s| s.name.to_string()).collect()
    }

    /// Returns a label for each Gaussian: the position + 1 of the last of `names` that holds it, 0 for none.
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
}

/// Returns the old and new names of the segments that were merely renamed between `before` and `after`: the old name is
/// gone, and a new one has the same Gaussians, time and origin.
pub fn renamed(before: &Segmentation, after: &Segmentation) -> Vec<[String; 2]> {
    let new: Vec<&Segment> = after.segments.iter().filter(|s| before.get(&s.name).is_err()).collect();
    let gone = before.segments.iter().filter(|s| after.get(&s.name).is_err());
    let same = |a: &Segment, b: &Segment| a.time == b.time && a.origin == b.origin && a.members == b.members;
    gone.filter_map(|old| {
        let now = new.iter().find(|now| same(old, now))?;
        Some([&old.name, &now.name].map(ToString::to_string))
    })
    .collect()
}
