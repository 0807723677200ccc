//! The reader of mask files: one pass on opening finds where each view's lines are, and views are read on demand.
//!
//! The lines themselves are described in `store`.

use std::{
    fs::File,
    io::{BufRead, BufReader, Read, Seek, SeekFrom},
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

use serde::Deserialize;

use super::{
    rle,
    store::{
        Annotation, AnnotationLine, LONGEST_LINE, MaskFileHeader, StoreError, check_header, check_line, check_memory,
        mask_of_size,
    },
};
use crate::files::open_regular;
use crate::memory::MemoryBudget;

/// Where one annotation's line is.
#[derive(Debug, Clone, Copy)]
struct LineLocation {
    offset: u64,
    length: u64,
    /// Line number from 1, for messages.
    number: u64,
}

/// Reads a mask file view by view, from any thread; only the table of line places stays in memory.
#[derive(Debug)]
pub struct MaskReader {
    path: PathBuf,
    header: MaskFileHeader,
    file: Mutex<File>,
    places: Vec<Vec<LineLocation>>,
}

impl MaskReader {
    /// Opens a file and finds each view's lines by one pass over it.
    ///
    /// # Errors
    /// [`StoreError::Io`]; [`StoreError::Field`] for a header that is wrong or lines that are not annotations or name a
    /// view that the header does not list. The rest of a line is checked when its view is read.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        #[derive(Deserialize)]
        struct OnlyView {
            image_id: u32,
        }
        let file = open_regular(path).map_err(StoreError::io(path))?;
        let mut input = BufReader::new(file);
        let mut line = Vec::new();
        let mut offset = read_line(path, 1, &mut input, &mut line)?;
        let header: MaskFileHeader =
            serde_json::from_slice(&line).map_err(|e| StoreError::field(path, "line 1, header", e))?;
        check_header(path, &header)?;
        check_memory(path, &header, MemoryBudget::now())?;
        let mut places = vec![Vec::new(); header.views.len()];
        for number in 2.. {
            let length = read_line(path, number, &mut input, &mut line)?;
            if length == 0 {
                break;
            }
            if !line.trim_ascii().is_empty() {
                let OnlyView { image_id } =
                    serde_json::from_slice(&line).map_err(|e| StoreError::field(path, format!("line {number}"), e))?;
                let Some(view) = places.get_mut(image_id as usize) else {
                    let problem = format!("is {image_id}, but the header lists {} views", header.views.len());
                    return Err(StoreError::field(path, format!("line {number}, image_id"), problem));
                };
                view.push(LineLocation { offset, length, number });
            }
            offset += length;
        }
        Ok(Self { path: path.to_owned(), header, file: Mutex::new(input.into_inner()), places })
    }

    /// What all masks have in common.
    pub fn header(&self) -> &MaskFileHeader {
        &self.header
    }

    /// Number of annotations of all views.
    pub fn len(&self) -> usize {
        self.places.iter().map(Vec::len).sum()
    }

    /// Whether the file holds no annotation.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of annotations of one view; 0 for a view that is not listed.
    pub fn view_len(&self, view: usize) -> usize {
        self.places.get(view).map_or(0, Vec::len)
    }

    /// The annotations of one view, in the file's order.
    ///
    /// # Errors
    /// [`StoreError::Field`] for a view that is not listed and for lines that are wrong; [`StoreError::Io`].
    pub fn view(&self, view: usize) -> Result<Vec<Annotation>, StoreError> {
        let Some(places) = self.places.get(view) else {
            let problem = format!("view {view} was requested, but the header lists {}", self.header.views.len());
            return Err(StoreError::field(&self.path, "header, views", problem));
        };
        let mut line = Vec::new();
        let mut annotations = Vec::with_capacity(places.len());
        for place in places {
            {
                let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
                file.seek(SeekFrom::Start(place.offset)).map_err(StoreError::io(&self.path))?;
                line.clear();
                (&mut *file).take(place.length).read_to_end(&mut line).map_err(StoreError::io(&self.path))?;
            }
            annotations.push(self.parse(&line, place.number)?);
        }
        Ok(annotations)
    }

    fn parse(&self, text: &[u8], number: u64) -> Result<Annotation, StoreError> {
        let (path, header) = (&self.path, &self.header);
        let entry = format!("line {number}");
        let line: AnnotationLine =
            serde_json::from_slice(text).map_err(|e| StoreError::field(path, entry.as_str(), e))?;
        check_line(path, &entry, &line, header)?;
        let segmentation = |problem: String| StoreError::field(path, format!("{entry}, segmentation.counts"), problem);
        let counts = rle::decode(&line.segmentation.counts).map_err(|e| segmentation(e.to_string()))?;
        let mask = mask_of_size(line.segmentation.size, counts, header.width, header.height)
            .map_err(|e| segmentation(e.to_string()))?;
        if mask.area() != line.area {
            let problem = format!("is {}, but the mask has {} pixels", line.area, mask.area());
            return Err(StoreError::field(path, format!("{entry}, area"), problem));
        }
        if mask.bbox() != line.bbox {
            let problem = format!("is {:?}, but the mask's box is {:?}", line.bbox, mask.bbox());
            return Err(StoreError::field(path, format!("{entry}, bbox"), problem));
        }
        Ok(Annotation {
            image_id: line.image_id,
            segment: line.segment,
            mask,
            predicted_iou: line.predicted_iou,
            stability_score: line.stability_score,
            scale: line.scale,
        })
    }
}

/// Reads one line with its end into `line`; returns its length, 0 at the file's end.
fn read_line(path: &Path, number: u64, input: &mut impl BufRead, line: &mut Vec<u8>) -> Result<u64, StoreError> {
    line.clear();
    let length = input.take(LONGEST_LINE).read_until(b'\n', line).map_err(StoreError::io(path))? as u64;
    if length == LONGEST_LINE {
        let problem = format!("is longer than {} MiB; this is not a mask file", LONGEST_LINE >> 20);
        return Err(StoreError::field(path, format!("line {number}"), problem));
    }
    Ok(length)
}

#[cfg(test)]
mod tests {
    use super::super::Mask;
    use super::super::store::{MaskView, MaskWriter};
    use super::*;
    use proptest::prelude::*;

    fn header() -> MaskFileHeader {
        let view = |file: &str| MaskView { file: file.to_owned(), camera_to_world: [0.5; 16], fov_x: 0.7 };
        MaskFileHeader::new(
            5,
            4,
            3.0,
            vec![view("a.png"), view("b.png"), view("c.png")],
            vec!["one".into(), "two".into()],
            "test".into(),
        )
    }

    fn annotation(image_id: u32, pixel: usize) -> Annotation {
        let mut rows = [false; 20];
        rows[pixel] = true;
        let mask = Mask::from_rows(5, 4, &rows).unwrap();
        Annotation { image_id, segment: image_id % 2, mask, predicted_iou: 0.9, stability_score: 0.8, scale: 0.25 }
    }

    #[test]
    fn views_come_back_whatever_the_order_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("masks.jsonl");
        let mut writer = MaskWriter::create(&path, header()).unwrap();
        for (view, pixel) in [(2, 1), (0, 2), (2, 3)] {
            writer.write(&annotation(view, pixel)).unwrap();
        }
        assert!(!path.exists(), "the file appears only on finish");
        assert_eq!(writer.finish().unwrap(), 3);
        let reader = MaskReader::open(&path).unwrap();
        assert_eq!(reader.header(), &header());
        assert_eq!(reader.len(), 3);
        assert_eq!(reader.view(2).unwrap(), [annotation(2, 1), annotation(2, 3)]);
        assert_eq!(reader.view(0).unwrap(), [annotation(0, 2)]);
        assert!(reader.view(1).unwrap().is_empty());
        assert!(reader.view(3).unwrap_err().to_string().contains("lists 3"));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn an_unfinished_file_leaves_the_old_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("masks.jsonl");
        std::fs::write(&path, "old").unwrap();
        let mut writer = MaskWriter::create(&path, header()).unwrap();
        writer.write(&annotation(0, 0)).unwrap();
        drop(writer);
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn the_writer_refuses_wrong_annotations() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = MaskWriter::create(&folder.path().join("m"), header()).unwrap();
        let good = annotation(0, 0);
        let wrong = [
            ("image_id", Annotation { image_id: 3, ..good.clone() }),
            ("segment", Annotation { segment: 2, ..good.clone() }),
            ("size", Annotation { mask: Mask::empty(4, 5).unwrap(), ..good.clone() }),
            ("segmentation", Annotation { mask: Mask { width: 5, height: 4, counts: vec![21] }, ..good.clone() }),
            ("predicted_iou", Annotation { predicted_iou: f32::NAN, ..good }),
        ];
        for (field, annotation) in wrong {
            let message = writer.write(&annotation).unwrap_err().to_string();
            assert!(message.contains(field), "{message}");
        }
    }

    #[test]
    fn wrong_lines_name_file_line_and_field() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("masks.jsonl");
        let mut writer = MaskWriter::create(&path, header()).unwrap();
        writer.write(&annotation(0, 0)).unwrap();
        writer.finish().unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        for (from, to, field) in [
            ("\"version\":1", "\"version\":2", "header, version"),
            ("volseggs-masks", "other", "header, format"),
            ("\"image_id\":0", "\"image_id\":7", "line 2, image_id"),
            ("\"segment\":0", "\"segment\":2", "line 2, segment"),
            ("\"size\":[4,5]", "\"size\":[5,4]", "line 2, segmentation.size"),
            ("\"counts\":\"0", "\"counts\":\"!", "line 2, segmentation.counts"),
            ("\"counts\":\"0", "\"counts\":\"1", "line 2, segmentation.counts"),
            ("\"area\":1", "\"area\":2", "line 2, area"),
            ("\"bbox\":[0,0,1,1]", "\"bbox\":[0,0,1,2]", "line 2, bbox"),
            ("\"scale\":0.25", "\"scale\":\"x\"", "line 2"),
            ("\"scale\":0.25}", "\"scale\":0.2", "line 2"),
        ] {
            let changed = text.replace(from, to);
            assert_ne!(changed, text, "{from}");
            std::fs::write(&path, changed).unwrap();
            let message = MaskReader::open(&path).and_then(|reader| reader.view(0)).unwrap_err().to_string();
            assert!(message.contains(field) && message.contains("masks.jsonl"), "{message}");
        }
    }

    #[test]
    fn masks_that_do_not_fit_into_memory_are_refused_by_their_header() {
        let path = Path::new("masks.jsonl");
        let large = MaskFileHeader { width: 65_535, height: 65_535, ..header() };
        check_header(path, &large).unwrap();
        let error = check_memory(path, &large, MemoryBudget::from_bytes(8_000_000_000)).unwrap_err().to_string();
        let words = ["masks.jsonl", "header, width, height", "65535x65535 pixels", "--memory"];
        assert!(words.iter().all(|w| error.contains(w)), "{error}");
        check_memory(path, &header(), MemoryBudget::from_bytes(1000)).unwrap();
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn any_bytes_are_a_file_or_an_error(bytes in proptest::collection::vec(any::<u8>(), 0..200), keep in any::<bool>()) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("m");
            let mut all = if keep { serde_json::to_vec(&header()).unwrap() } else { Vec::new() };
            all.extend_from_slice(b"\n");
            all.extend_from_slice(&bytes);
            std::fs::write(&path, all).unwrap();
            if let Ok(reader) = MaskReader::open(&path) {
                let _ = reader.view(0);
            }
        }
    }
}
