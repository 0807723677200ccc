//! Masks of other programs in a standard COCO annotations file: `images` and `annotations`, run lengths only.
//!
//! Masks stay in their packed form until those of an image are requested. Writing is left to the project's own format,
//! `store`.

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Deserializer};
use serde_json::Value;

use super::{
    mask::Mask,
    rle,
    store::{StoreError, mask_of_size},
};
use crate::files::read_text;
use crate::words::plain;

/// One image that a COCO file lists.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
pub struct CocoImage {
    /// Its number or text in the file.
    #[serde(deserialize_with = "key")]
    pub id: String,
    /// Name of the image file.
    pub file_name: String,
    /// Width in pixels.
    #[serde(deserialize_with = "whole")]
    pub width: u32,
    /// Height in pixels.
    #[serde(deserialize_with = "whole")]
    pub height: u32,
}

/// A mask of another program, with the scores that it gave.
#[derive(Debug, Clone, PartialEq)]
pub struct ForeignMask {
    /// The mask, of its image's size.
    pub mask: Mask,
    /// The file's category or label number; 0 where it gives none.
    pub category: u64,
    /// `predicted_iou`, or COCO's `score`; 1 where the file gives none.
    pub predicted_iou: f32,
    /// `stability_score`; 1 where the file gives none.
    pub stability_score: f32,
}

#[derive(Deserialize)]
struct CocoDocument {
    images: Vec<CocoImage>,
    annotations: Vec<CocoEntry>,
}

#[derive(Debug, Deserialize)]
struct CocoEntry {
    #[serde(deserialize_with = "key")]
    image_id: String,
    segmentation: CocoSegmentation,
    /// Often a number; others are not needed.
    #[serde(default)]
    category_id: Value,
    predicted_iou: Option<f32>,
    score: Option<f32>,
    stability_score: Option<f32>,
}

#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum CocoSegmentation {
    Packed { size: [u32; 2], counts: String },
    Plain { size: [u32; 2], counts: Vec<u32> },
    Polygons(#[expect(dead_code, reason = "only that it is a list matters")] Vec<serde::de::IgnoredAny>),
    Other(serde::de::IgnoredAny),
}

/// What a JSON text is instead of a COCO file, and how to make one of it, if it is one of the forms that SAM writes.
fn other_form(text: &str) -> Option<&'static str> {
    let value: Value = serde_json::from_str(text).ok()?;
    match &value {
        Value::Array(_) => Some(
            "is a list of masks, as SAM's automatic mask generator returns, which does not tell their picture; write \
             {\"images\": [{\"id\": 0, \"file_name\": \"SEGMENT/view-000.png\", \"width\": W, \"height\": H}, ...], \
             \"annotations\": [...]}, and give each mask the image_id of its picture",
        ),
        Value::Object(file) if file.contains_key("image") => Some(
            "is the file of one picture, as in SA-1B; write one file with all pictures: their `image`s as the list \
             \"images\", and all masks as the list \"annotations\", each with the image_id of its picture",
        ),
        _ => None,
    }
}

/// The id of an image: a number or text; numbers with a point, as tables of floating point columns are written, are the
/// same as without.
fn key<'de, D: Deserializer<'de>>(input: D) -> Result<String, D::Error> {
    match Value::deserialize(input)? {
        Value::String(text) => Ok(text),
        Value::Number(n) if n.is_f64() => match n.as_f64() {
            Some(v) if v.fract() == 0.0 && v.abs() < 1e15 => Ok(format!("{v:.0}")),
            _ => Err(serde::de::Error::custom(format!("expected a whole number or text as id, not {n}"))),
        },
        Value::Number(n) => Ok(n.to_string()),
        other => Err(serde::de::Error::custom(format!("expected a whole number or text as id, not {other}"))),
    }
}

/// A side in pixels; with a point, as tables of floating point columns are written, if it is whole.
fn whole<'de, D: Deserializer<'de>>(input: D) -> Result<u32, D::Error> {
    let value = Value::deserialize(input)?;
    let number = value.as_f64().filter(|v| v.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(v));
    let wrong = || serde::de::Error::custom(format!("expected a whole number of pixels, not {value}"));
    number.map(|v| v as u32).ok_or_else(wrong)
}

/// An opened COCO annotations file.
#[derive(Debug)]
pub struct CocoFile {
    path: PathBuf,
    images: Vec<CocoImage>,
    /// Each image's annotations, with their places in the file's list.
    entries: Vec<Vec<(usize, CocoEntry)>>,
}

impl CocoFile {
    /// Opens a file and sorts its annotations by image.
    ///
    /// # Errors
    /// [`StoreError::Io`]; [`StoreError::Field`] for text that is not a COCO file, ids listed twice and annotations of
    /// an image that is not listed.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let text = read_text(path).map_err(StoreError::io(path))?;
        let CocoDocument { images, annotations } = serde_json::from_str(&text).map_err(|e| {
            let problem = other_form(&text).map_or_else(|| plain(&e.to_string()), str::to_owned);
            StoreError::field(path, "images, annotations", problem)
        })?;
        let mut places = HashMap::with_capacity(images.len());
        for (index, image) in images.iter().enumerate() {
            if places.insert(image.id.clone(), index).is_some() {
                let problem = format!("{} is listed twice; ids must differ", image.id);
                return Err(StoreError::field(path, format!("images[{index}].id"), problem));
            }
        }
        let mut entries: Vec<_> = images.iter().map(|_| Vec::new()).collect();
        for (index, entry) in annotations.into_iter().enumerate() {
            let Some(&place) = places.get(&entry.image_id) else {
                let problem = format!("{} is not among the ids of `images`", entry.image_id);
                return Err(StoreError::field(path, format!("annotations[{index}].image_id"), problem));
            };
            entries[place].push((index, entry));
        }
        Ok(Self { path: path.to_owned(), images, entries })
    }

    /// The images, in the file's order.
    pub fn images(&self) -> &[CocoImage] {
        &self.images
    }

    /// The masks of one image (an index into [`CocoFile::images`]), in the file's order.
    ///
    /// # Errors
    /// [`StoreError::Field`] for an index past the list, polygons, masks of another size than their image's, counts
    /// that are wrong and scores that are not finite.
    pub fn masks(&self, image: usize) -> Result<Vec<ForeignMask>, StoreError> {
        let (Some(info), Some(entries)) = (self.images.get(image), self.entries.get(image)) else {
            let problem = format!("image {image} was requested, but only {} are listed", self.images.len());
            return Err(StoreError::field(&self.path, "images", problem));
        };
        entries.iter().map(|(index, entry)| self.unpack(*index, entry, info)).collect()
    }

    fn unpack(&self, index: usize, entry: &CocoEntry, image: &CocoImage) -> Result<ForeignMask, StoreError> {
        let fail = |field: &str, problem: String| {
            StoreError::field(&self.path, format!("annotations[{index}].{field}"), problem)
        };
        let (size, counts) = match &entry.segmentation {
            CocoSegmentation::Packed { size, counts } => {
                (*size, rle::decode(counts).map_err(|e| fail("segmentation.counts", e.to_string()))?)
            }
            CocoSegmentation::Plain { size, counts } => (*size, counts.clone()),
            CocoSegmentation::Polygons(_) => {
                let problem =
                    "holds polygons, which are not supported; convert them to run lengths (pycocotools: annToRLE)";
                return Err(fail("segmentation", problem.to_owned()));
            }
            CocoSegmentation::Other(_) => {
                let problem =
                    "is not an object with size [height, width] and counts (a string or a list of whole numbers)";
                return Err(fail("segmentation", problem.to_owned()));
            }
        };
        let mask =
            mask_of_size(size, counts, image.width, image.height).map_err(|e| fail("segmentation", e.to_string()))?;
        let score = |field: &str, value: Option<f32>| match value {
            Some(value) if !value.is_finite() => Err(fail(field, format!("is {value}; it must be finite"))),
            value => Ok(value.unwrap_or(1.0)),
        };
        Ok(ForeignMask {
            mask,
            category: entry.category_id.as_u64().unwrap_or(0),
            predicted_iou: score("predicted_iou", entry.predicted_iou.or(entry.score))?,
            stability_score: score("stability_score", entry.stability_score)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn open(text: &str) -> Result<CocoFile, StoreError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("coco.json");
        std::fs::write(&path, text).unwrap();
        CocoFile::open(&path)
    }

    fn file(segmentation: &str) -> String {
        format!(
            r#"{{"info":{{}},"images":[{{"id":7,"file_name":"a.png","width":2,"height":3,"license":1}},{{"id":3,"file_name":"b.png","width":2,"height":3}}],
            "annotations":[{{"id":1,"image_id":7,"category_id":4,"iscrowd":1,"area":3,"bbox":[0,0,1,3],"segmentation":{segmentation},"score":0.5}}]}}"#
        )
    }

    #[test]
    fn packed_and_plain_counts() {
        for segmentation in [r#"{"size":[3,2],"counts":[1,4,1]}"#, r#"{"size":[3,2],"counts":"141"}"#] {
            let coco = open(&file(segmentation)).unwrap();
            assert_eq!(coco.images()[1].file_name, "b.png");
            let masks = coco.masks(0).unwrap();
            assert_eq!(masks[0].mask.counts, [1, 4, 1]);
            assert_eq!((masks[0].category, masks[0].predicted_iou, masks[0].stability_score), (4, 0.5, 1.0));
            assert!(coco.masks(1).unwrap().is_empty());
            assert!(coco.masks(2).is_err());
        }
    }

    #[test]
    fn a_predicted_iou_counts_before_a_score() {
        let text =
            file(r#"{"size":[3,2],"counts":"141"}"#).replace(r#""score":0.5"#, r#""score":0.5,"predicted_iou":0.75"#);
        assert_eq!(open(&text).unwrap().masks(0).unwrap()[0].predicted_iou, 0.75);
    }

    #[test]
    fn wrong_shapes_name_the_entry() {
        for (segmentation, says) in [
            ("[[0,0,1,0,1,1]]", "polygons"),
            ("5", "is not an object"),
            (r#"{"size":[3,2],"counts":[1,-4]}"#, "is not an object"),
            (r#"{"size":[2,3],"counts":[6]}"#, "the image is 2x3"),
            (r#"{"size":[3,2],"counts":[7]}"#, "sum to 7"),
            (r#"{"size":[3,2],"counts":"1~"}"#, "position 1"),
        ] {
            let message = open(&file(segmentation)).unwrap().masks(0).unwrap_err().to_string();
            assert!(
                message.contains(says) && message.contains("annotations[0]") && message.contains("coco.json"),
                "{message}"
            );
        }
    }

    #[test]
    fn a_folder_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let message = CocoFile::open(folder.path()).unwrap_err().to_string();
        assert!(message.contains("is a folder"), "{message}");
    }

    #[test]
    fn sizes_that_a_file_claims_are_not_believed() {
        let huge = file(r#"{"size":[4294967295,4294967295],"counts":[4294967295]}"#);
        let huge = huge.replace("\"width\":2,\"height\":3", "\"width\":4294967295,\"height\":4294967295");
        let message = open(&huge).unwrap().masks(0).unwrap_err().to_string();
        assert!(message.contains("pixels"), "{message}");
    }

    #[test]
    fn ids_must_fit() {
        let text = file("[]");
        let message = |text: &str| open(text).unwrap_err().to_string();
        assert!(message(&text.replace("\"id\":3", "\"id\":7")).contains("images[1].id"));
        assert!(message(&text.replace("\"image_id\":7", "\"image_id\":8")).contains("annotations[0].image_id"));
        assert!(message("{}").contains("coco.json") && message("{}").contains("`images` is missing"));
    }

    #[test]
    fn ids_may_be_text_or_have_a_point() {
        for (id, other) in [("\"a\"", "\"b\""), ("7.0", "3.0"), ("7", "\"3\"")] {
            let text = file(r#"{"size":[3,2],"counts":"141"}"#).replace("\"width\":2", "\"width\":2.0");
            let text =
                text.replace("\"id\":7", &format!("\"id\":{id}")).replace("\"id\":3", &format!("\"id\":{other}"));
            let text = text.replace("\"image_id\":7", &format!("\"image_id\":{id}"));
            assert_eq!(open(&text).unwrap().masks(0).unwrap().len(), 1, "{id}");
            let mixed = text.replace(&format!("\"image_id\":{id}"), "\"image_id\":7.5");
            let message = open(&mixed).unwrap_err().to_string();
            assert!(message.contains("whole number or text as id, not 7.5"), "{message}");
        }
        let side = file("[]").replace("\"width\":2", "\"width\":2.5");
        let message = open(&side).unwrap_err().to_string();
        assert!(message.contains("a whole number of pixels, not 2.5"), "{message}");
    }

    #[test]
    fn forms_that_sam_writes_are_explained() {
        let mask = r#"{"segmentation":{"size":[3,2],"counts":"141"},"area":4,"predicted_iou":0.9}"#;
        for (text, words) in [
            (format!("[{mask}]"), "a list of masks, as SAM's automatic mask generator returns"),
            ("[]".to_owned(), "a list of masks"),
            (format!(r#"{{"image":{{"image_id":0}},"annotations":[{mask}]}}"#), "as in SA-1B"),
        ] {
            let message = open(&text).unwrap_err().to_string();
            assert!(message.contains(words) && message.contains("image_id of its picture"), "{message}");
            assert!(!message.contains("expected"), "{message}");
        }
    }

    #[test]
    fn a_byte_order_mark_is_no_part_of_a_file() {
        let marked = format!("\u{feff}{}", file(r#"{"size":[3,2],"counts":"141"}"#));
        assert_eq!(open(&marked).unwrap().masks(0).unwrap().len(), 1);
    }

    proptest! {
        #[test]
        fn any_counts_are_a_mask_or_an_error(counts in proptest::collection::vec(any::<u32>(), 0..5), text in "[0-o]{0,9}") {
            let plain = open(&file(&format!(r#"{{"size":[3,2],"counts":{counts:?}}}"#))).unwrap();
            let _ = plain.masks(0);
            let quoted = serde_json::to_string(&text).unwrap();
            let packed = open(&file(&format!(r#"{{"size":[3,2],"counts":{quoted}}}"#))).unwrap();
            let _ = packed.masks(0);
        }
    }
}
