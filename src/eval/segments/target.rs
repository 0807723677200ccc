//! What is clicked and measured: a known segment, or several as one.

use super::truth::{TruthFrame, frames};
use crate::data::{DataError, Truth, truth};
use crate::name::Name;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::str::FromStr;

/// Several known segments measured as one, as in `pair=tube-a+tube-b`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct TargetUnion {
    /// Its name in tables.
    pub name: Name,
    /// Names of the segments.
    pub parts: Vec<String>,
}

impl FromStr for TargetUnion {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let how = "write NAME=SEGMENT+SEGMENT, such as tubes=tube-a+tube-b";
        let (name, parts) = text.split_once('=').ok_or_else(|| format!("\"{text}\": \"=\" is missing; {how}"))?;
        let name = Name::new(name.trim()).map_err(|e| format!("\"{text}\": {e}; {how}"))?;
        let parts: Vec<String> = parts.split('+').map(|p| p.trim().to_owned()).collect();
        if parts.iter().any(String::is_empty) {
            return Err(format!("\"{text}\": a segment has no name; {how}"));
        }
        if parts.len() < 2 {
            return Err(format!("\"{text}\": a union needs at least two segments; {how}"));
        }
        if let Some(twice) = parts.iter().enumerate().find(|(i, p)| parts[..*i].contains(p)) {
            return Err(format!("\"{text}\": {} is given twice; {how}", twice.1));
        }
        Ok(Self { name, parts })
    }
}

impl TryFrom<String> for TargetUnion {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<TargetUnion> for String {
    fn from(union: TargetUnion) -> Self {
        format!("{}={}", union.name, union.parts.join("+"))
    }
}

/// One row of the tables.
#[derive(Clone, Debug)]
pub struct EvalTarget {
    /// Its name.
    pub name: String,
    /// Ids of its segments in label images and volumes, at the time of the click.
    pub ids: Vec<u16>,
    /// The views in which it is known alone; those of times at which it is part of something larger are excluded, see
    /// [`Truth::ids_at`].
    pub frames: Vec<TruthFrame>,
}

/// Returns the targets: the segments in `only`, or all if it is empty, and the unions, as they are at the time
/// `clicked`.
///
/// # Errors
/// If a segment is unknown, a union has the name of a segment or of another union, or the segments of a union are known
/// in different views.
pub fn targets(
    truth: &Truth,
    only: &[String],
    unions: &[TargetUnion],
    clicked: f64,
) -> Result<Vec<EvalTarget>, DataError> {
    let path = truth.root.join(truth::FILE);
    let bad = |problem: String| {
        let names: Vec<&str> = truth.file.segments.iter().map(|s| s.name.as_str()).collect();
        let hint = format!("available: {}", names.join(", "));
        DataError::field_error(&path, None, "segments", problem, &hint)
    };
    let id = |name: &str| {
        let found = truth.file.segments.iter().find(|s| s.name == name).map(|s| s.id);
        found.ok_or_else(|| bad(format!("no segment has the name \"{name}\"")))
    };
    for name in only {
        id(name)?;
    }
    let target = |name: String, ids: Vec<u16>| match followed(truth, &ids, clicked) {
        Some(frames) => Ok(EvalTarget { name, ids, frames }),
        None => Err(bad(format!("the segments of \"{name}\" have ground truth in different views"))),
    };
    let wanted = truth.file.segments.iter().filter(|s| only.is_empty() || only.contains(&s.name));
    let mut out = wanted.map(|s| target(s.name.clone(), vec![s.id])).collect::<Result<Vec<_>, _>>()?;
    for (i, union) in unions.iter().enumerate() {
        let name = union.name.to_string();
        if id(&name).is_ok() || unions[..i].iter().any(|u| u.name == union.name) {
            return Err(bad(format!("\"{name}\" is the name of another segment or union; choose another name")));
        }
        let ids = union.parts.iter().map(|part| id(part)).collect::<Result<Vec<_>, _>>()?;
        out.push(target(name, ids)?);
    }
    Ok(out)
}

/// Returns the views in which the material of the segments `ids` at the time `clicked` is known alone; `None` if the
/// segments that it consists of are known in different views.
fn followed(truth: &Truth, ids: &[u16], clicked: f64) -> Option<Vec<TruthFrame>> {
    let mut of: BTreeMap<u16, Vec<TruthFrame>> = BTreeMap::new();
    let mut out = Vec::new();
    let (first, others) = ids.split_first()?;
    let all = frames(truth, *first);
    if others.iter().any(|id| of.entry(*id).or_insert_with(|| frames(truth, *id)).len() != all.len()) {
        return None;
    }
    for (k, mut frame) in all.into_iter().enumerate() {
        let Some(then) = truth.ids_at(ids, clicked, frame.time) else { continue };
        for id in then.into_iter().filter(|id| id != first) {
            let other = of.entry(id).or_insert_with(|| frames(truth, id)).get(k)?;
            if !frame.join(other.clone()) {
                return None;
            }
        }
        out.push(frame);
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::Normalisation;
    use crate::data::lineage::{LineageChange, LineageEvent};
    use crate::data::truth::{SegmentEntry, SegmentFile, SegmentFrame};

    fn truth() -> Truth {
        let frame = |name: &str, k: usize| SegmentFrame {
            file_path: format!("{name}/{k}.png"),
            mask_path: format!("{name}/{k}_mask.png"),
            transform_matrix: glam::DMat4::IDENTITY.to_cols_array_2d(),
            time: 0.5 * k as f64,
            pixels: 1,
        };
        let entry = |id: u16, name: &str, frames: usize| SegmentEntry {
            id,
            name: name.into(),
            frames: (0..frames).map(|k| frame(name, k)).collect(),
        };
        let file = SegmentFile {
            source: "labels".into(),
            mask_alpha: 0.05,
            camera_angle_x: 0.5,
            size: [4, 3],
            label_images: Vec::new(),
            segments: vec![entry(1, "a", 2), entry(2, "b", 2), entry(5, "c", 1)],
            volumes: Vec::new(),
            lineage: Vec::new(),
        };
        Truth { root: "/data".into(), file, normalisation: Normalisation::NONE }
    }

    #[test]
    fn a_union_is_read_and_refused_with_its_text() {
        let union: TargetUnion = "pair = a + b".parse().unwrap();
        assert_eq!((union.name.to_string(), union.parts), ("pair".into(), vec!["a".to_owned(), "b".into()]));
        for text in ["pair", "=a+b", "pair=", "pair=a", "pair=a+", "pair=a+a", "../x=a+b"] {
            let error = text.parse::<TargetUnion>().unwrap_err();
            assert!(error.contains(text) && error.contains("NAME=SEGMENT+SEGMENT"), "{error}");
        }
    }

    #[test]
    fn segments_and_unions_are_targets_and_unknown_names_are_reported() {
        let union = |text: &str| text.parse::<TargetUnion>().unwrap();
        let found = targets(&truth(), &["b".to_owned()], &[union("pair=a+b")], 0.5).unwrap();
        let rows: Vec<_> = found.iter().map(|t| (t.name.as_str(), t.ids.clone(), t.frames.len())).collect();
        assert_eq!(rows, [("b", vec![2], 2), ("pair", vec![1, 2], 2)]);
        assert_eq!(targets(&truth(), &[], &[], 0.5).unwrap().len(), 3);
        for (only, unions, words) in [
            (vec!["x".to_owned()], vec![], "\"x\""),
            (vec![], vec![union("pair=a+x")], "\"x\""),
            (vec![], vec![union("c=a+b")], "\"c\""),
            (vec![], vec![union("p=a+b"), union("p=b+a")], "\"p\""),
            (vec![], vec![union("p=a+c")], "different views"),
        ] {
            let error = targets(&truth(), &only, &unions, 0.5).unwrap_err().to_string();
            assert!(error.contains(words) && error.contains("segments.json") && error.contains("a, b, c"), "{error}");
        }
    }

    #[test]
    fn a_merged_segment_includes_its_parts_before_and_hides_them_after() {
        let mut truth = truth();
        let Truth { file, .. } = &mut truth;
        file.segments.truncate(2);
        file.lineage.push(LineageEvent { time: 0.4, segment: 1, change: LineageChange::Ended, other: Some(2) });
        let times = |clicked| -> Vec<Vec<(f64, usize)>> {
            let found = targets(&truth, &[], &[], clicked).unwrap();
            found.iter().map(|t| t.frames.iter().map(|f| (f.time, f.segments())).collect()).collect()
        };
        assert_eq!(times(0.5), [vec![(0.0, 1), (0.5, 1)], vec![(0.0, 2), (0.5, 1)]]);
        assert_eq!(times(0.0), [vec![(0.0, 1)], vec![(0.0, 1)]]);
        // nothing of 1 is left at 0.5, so it cannot be clicked; both as one are the whole at any time
        let both = targets(&truth, &["a".to_owned()], &["both=a+b".parse().unwrap()], 0.0).unwrap();
        assert_eq!(both[1].frames.len(), 2);
    }
}
