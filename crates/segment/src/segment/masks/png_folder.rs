//! Masks of other programs as a folder of PNG images, grey of 8 or 16 bits or with a palette, one folder for all views.
//!
//! A view `NAME.png` has its masks either in `NAME.png`, a label image of which every value but 0 is a mask, or in
//! files `NAME_K.png` with K a whole number, one binary mask each (every value but 0 is set). Files are read on demand.

use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    io::Cursor,
    path::{Path, PathBuf},
};

use image::codecs::png::PngDecoder;
use image::{ColorType, DynamicImage, ImageDecoder};

use super::{coco::ForeignMask, mask::Mask, store::StoreError};
use crate::data::png::check_claim;
use crate::files::read_regular;

/// The colour type of a PNG with a palette, in its header.
const INDEXED: u8 = 3;

/// Where a view's masks are.
#[derive(Debug, Clone)]
enum Files {
    Absent,
    Labels(PathBuf),
    /// By number.
    Binary(BTreeMap<u64, PathBuf>),
}

/// A folder of mask images, matched to a list of views.
#[derive(Debug)]
pub struct PngFolder {
    width: u32,
    height: u32,
    views: Vec<Files>,
    folder: PathBuf,
}

impl PngFolder {
    /// Finds each view's files. `views` are the names of the image files, whose folders and extensions are ignored;
    /// `width` and `height` are their size in pixels. A view may have no file.
    ///
    /// # Errors
    /// [`StoreError::Io`]; [`StoreError::Field`] for a PNG that matches no view, two views of one name and a view with
    /// both kinds of file.
    pub fn open(folder: &Path, views: &[String], width: u32, height: u32) -> Result<Self, StoreError> {
        let mut places = HashMap::with_capacity(views.len());
        for (index, view) in views.iter().enumerate() {
            if places.insert(stem(Path::new(view)), index).is_some() {
                let problem =
                    format!("two views are named {:?}; their masks cannot be distinguished", stem(Path::new(view)));
                return Err(StoreError::field(folder, format!("views[{index}]"), problem));
            }
        }
        let mut paths = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(StoreError::io(folder))? {
            let path = entry.map_err(StoreError::io(folder))?.path();
            if path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("png")) {
                paths.push(path);
            }
        }
        paths.sort();
        let mut found = vec![Files::Absent; views.len()];
        for path in paths {
            let name = stem(&path);
            let numbered =
                name.rsplit_once('_').and_then(|(view, number)| Some((*places.get(view)?, number.parse().ok()?)));
            let both = |path: &Path| {
                StoreError::field(path, "file name", "its view already has a mask of this name or of the other kind")
            };
            match (places.get(name.as_str()), numbered) {
                (Some(&view), _) => match &found[view] {
                    Files::Absent => found[view] = Files::Labels(path),
                    Files::Labels(_) | Files::Binary(_) => return Err(both(&path)),
                },
                (None, Some((view, number))) => match &mut found[view] {
                    place @ Files::Absent => *place = Files::Binary(BTreeMap::from([(number, path)])),
                    Files::Binary(files) => {
                        if let Some(first) = files.insert(number, path) {
                            return Err(both(&first));
                        }
                    }
                    Files::Labels(_) => return Err(both(&path)),
                },
                (None, None) => {
                    let problem = "fits no view; name masks VIEW_NUMBER.png, or VIEW.png for a label image";
                    return Err(StoreError::field(&path, "file name", problem));
                }
            }
        }
        Ok(Self { width, height, views: found, folder: folder.to_owned() })
    }

    /// Whether no view has a file.
    pub fn is_empty(&self) -> bool {
        self.views.iter().all(|files| matches!(files, Files::Absent))
    }

    /// The masks of one view (an index into the list given on opening), by number or label value; empty ones are
    /// skipped.
    ///
    /// # Errors
    /// [`StoreError::Io`]; [`StoreError::Field`] for files that are not PNGs of greys or indices, or not of the views' size.
    pub fn masks(&self, view: usize) -> Result<Vec<ForeignMask>, StoreError> {
        let Some(files) = self.views.get(view) else {
            let problem = format!("view {view} was requested, but there are only {}", self.views.len());
            return Err(StoreError::field(&self.folder, "views", problem));
        };
        let split = |path: &Path, values: &[u16]| {
            Mask::of_labels(self.width, self.height, values).map_err(|e| StoreError::field(path, "pixels", e))
        };
        let mut found: Vec<(u64, Mask)> = Vec::new();
        match files {
            Files::Absent => {}
            Files::Binary(paths) => {
                for (&number, path) in paths {
                    let set: Vec<u16> = self.read(path)?.into_iter().map(|value| value.min(1)).collect();
                    found.extend(split(path, &set)?.into_iter().map(|(_, mask)| (number, mask)));
                }
            }
            Files::Labels(path) => {
                found.extend(split(path, &self.read(path)?)?.into_iter().map(|(label, mask)| (label.into(), mask)));
            }
        }
        let scored = |(category, mask)| ForeignMask { mask, category, predicted_iou: 1.0, stability_score: 1.0 };
        Ok(found.into_iter().map(scored).collect())
    }

    fn read(&self, path: &Path) -> Result<Vec<u16>, StoreError> {
        let bytes = read_regular(path).map_err(StoreError::io(path))?;
        let wrong = |e: image::ImageError| StoreError::field(path, "PNG", e);
        check_claim(&bytes, bytes.len() as u64).map_err(|e| StoreError::field(path, "PNG", e))?;
        let indexed = bytes.get(25) == Some(&INDEXED);
        let decoder = PngDecoder::new(Cursor::new(&bytes)).map_err(wrong)?;
        // before any pixel is unpacked: a small file may claim any size
        let (found_width, found_height) = decoder.dimensions();
        if (found_width, found_height) != (self.width, self.height) {
            let (width, height) = (self.width, self.height);
            let problem = format!("the mask is {found_width}x{found_height}, but the image is {width}x{height}");
            return Err(StoreError::field(path, "size", problem));
        }
        if indexed {
            return indices(&bytes).map_err(|e| StoreError::field(path, "PNG", e));
        }
        match DynamicImage::from_decoder(decoder).map_err(wrong)? {
            DynamicImage::ImageLuma8(grey) => Ok(grey.into_raw().into_iter().map(u16::from).collect()),
            DynamicImage::ImageLuma16(grey) => Ok(grey.into_raw()),
            other => {
                let found = match other.color() {
                    ColorType::La8 | ColorType::La16 => "grey with alpha",
                    ColorType::Rgba8 | ColorType::Rgba16 => "coloured (RGB) with alpha",
                    _ => "coloured (RGB)",
                };
                let problem = format!(
                    "are {found}; masks must be grey without alpha, 8 or 16 bits, or have indexed colours (a palette)"
                );
                Err(StoreError::field(path, "pixels", problem))
            }
        }
    }
}

/// The indices `[height * width]` of a PNG with a palette, as segmentation tools write labels. A palette of different
/// greys is that of a grey image which was made smaller: then the greys are returned.
fn indices(bytes: &[u8]) -> Result<Vec<u16>, png::DecodingError> {
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    decoder.set_transformations(png::Transformations::IDENTITY);
    let mut reader = decoder.read_info()?;
    let (width, depth) = (reader.info().width as usize, reader.info().bit_depth as usize);
    let palette: Vec<[u8; 3]> = reader.info().palette.iter().flat_map(|p| p.as_chunks::<3>().0).copied().collect();
    let mut packed = vec![0; reader.output_buffer_size().unwrap_or(0)];
    let line = reader.next_frame(&mut packed)?.line_size;
    let mask = u16::MAX >> (16 - depth);
    let pixel = |row: &[u8], x: usize| (u16::from(row[x * depth / 8]) >> (8 - depth - x * depth % 8)) & mask;
    let all: Vec<u16> =
        packed.chunks_exact(line.max(1)).flat_map(|row| (0..width).map(move |x| pixel(row, x))).collect();
    let used: BTreeSet<u16> = all.iter().copied().collect();
    let grey = |index: &u16| palette.get(usize::from(*index)).filter(|[r, g, b]| r == g && g == b).map(|c| c[0]);
    let greys: Option<BTreeMap<u16, u8>> = used.iter().map(|i| Some((*i, grey(i)?))).collect();
    match greys.filter(|greys| greys.values().collect::<BTreeSet<_>>().len() == used.len()) {
        Some(greys) => Ok(all.iter().map(|i| u16::from(greys[i])).collect()),
        None => Ok(all),
    }
}

fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::fixture::claims_to_be;
    use image::{GrayImage, ImageBuffer, Luma, RgbImage};

    #[test]
    fn binary_files_and_label_images() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for (number, byte) in [(10, 255), (2, 1), (3, 0)] {
            GrayImage::from_raw(2, 2, vec![byte, 0, 0, byte]).unwrap().save(at(&format!("r_1_{number}.png"))).unwrap();
        }
        let labels: ImageBuffer<Luma<u16>, _> = ImageBuffer::from_raw(2, 2, vec![0_u16, 300, 300, 9]).unwrap();
        labels.save(at("r_2.png")).unwrap();
        std::fs::write(at("notes.txt"), "not a mask").unwrap();
        let views = ["train/r_1.png", "r_2", "r_3"].map(str::to_owned);
        let opened = PngFolder::open(folder.path(), &views, 2, 2).unwrap();
        let binary = opened.masks(0).unwrap();
        assert_eq!(binary.iter().map(|found| found.category).collect::<Vec<_>>(), [2, 10]);
        assert_eq!(binary[0].mask.counts, [0, 1, 2, 1]);
        let labelled = opened.masks(1).unwrap();
        assert_eq!(
            labelled.iter().map(|found| (found.category, found.mask.area())).collect::<Vec<_>>(),
            [(9, 1), (300, 2)]
        );
        assert!(opened.masks(2).unwrap().is_empty());
        assert!(opened.masks(3).is_err());
    }

    /// A PNG 3 pixels wide and 2 high with a palette, whose indices have 1, 2, 4 or 8 bits.
    fn indexed(path: &Path, bits: usize, palette: &[[u8; 3]], indices: [[u8; 3]; 2]) {
        let mut encoder = png::Encoder::new(std::fs::File::create(path).unwrap(), 3, 2);
        encoder.set_color(png::ColorType::Indexed);
        encoder.set_depth(png::BitDepth::from_u8(bits as u8).unwrap());
        encoder.set_palette(palette.as_flattened().to_vec());
        let row = |row: [u8; 3]| {
            let mut packed = vec![0u8; (3 * bits).div_ceil(8)];
            row.iter().enumerate().for_each(|(x, v)| packed[x * bits / 8] |= v << (8 - bits - x * bits % 8));
            packed
        };
        let rows = indices.map(row).concat();
        encoder.write_header().unwrap().write_image_data(&rows).unwrap();
    }

    #[test]
    fn palettes_are_read_by_index_and_palettes_of_greys_by_grey() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let found = || {
            let opened = PngFolder::open(folder.path(), &["a.png".to_owned()], 3, 2).unwrap();
            opened.masks(0).unwrap().iter().map(|m| (m.category, m.mask.area())).collect::<Vec<_>>()
        };
        let [black, red, green] = [[0, 0, 0], [128, 0, 0], [0, 128, 0]];
        for bits in [2, 4, 8] {
            indexed(&path, bits, &[black, red, green], [[0, 1, 1], [2, 0, 1]]);
            assert_eq!(found(), [(1, 3), (2, 1)], "{bits}");
            // indices without colours of their own
            indexed(&path, bits, &[black, black, black], [[0, 1, 1], [2, 0, 1]]);
            assert_eq!(found(), [(1, 3), (2, 1)], "{bits}");
        }
        indexed(&path, 1, &[black, red], [[0, 1, 1], [0, 0, 1]]);
        assert_eq!(found(), [(1, 3)]);
        // a grey mask that was made smaller, with its colours in the order in which they were met
        indexed(&path, 1, &[[255; 3], black], [[0, 1, 1], [1, 1, 0]]);
        assert_eq!(found(), [(255, 2)]);
    }

    #[test]
    fn an_image_of_all_labels_is_read_in_one_pass() {
        let folder = tempfile::tempdir().unwrap();
        // a pass for each label would look at 2^32 pixels
        let labels: Vec<u16> = (0..=u16::MAX).collect();
        let image: ImageBuffer<Luma<u16>, _> = ImageBuffer::from_raw(256, 256, labels).unwrap();
        image.save(folder.path().join("a.png")).unwrap();
        let masks = PngFolder::open(folder.path(), &["a.png".to_owned()], 256, 256).unwrap().masks(0).unwrap();
        assert_eq!(masks.len(), 65_535);
        for (label, found) in (1..).zip(&masks) {
            let (x, y) = (label as u32 % 256, label as u32 / 256);
            assert!(found.category == label && found.mask.area() == 1 && found.mask.contains(x, y), "{label}");
        }
    }

    #[test]
    fn wrong_files_are_named() {
        let views = vec!["a.png".to_owned()];
        let check = |says: &str, write: &dyn Fn(&Path)| {
            let folder = tempfile::tempdir().unwrap();
            write(folder.path());
            let result = PngFolder::open(folder.path(), &views, 2, 2).and_then(|opened| opened.masks(0));
            let message = result.unwrap_err().to_string();
            assert!(message.contains(says) && message.contains(".png"), "{message}");
        };
        let grey = |folder: &Path, name: &str, side: u32| GrayImage::new(side, side).save(folder.join(name)).unwrap();
        check("fits no view", &|folder| grey(folder, "b_1.png", 2));
        check("3x3", &|folder| grey(folder, "a_1.png", 3));
        check("coloured (RGB); masks must be grey", &|folder| RgbImage::new(2, 2).save(folder.join("a.png")).unwrap());
        check("already", &|folder| {
            grey(folder, "a.png", 2);
            grey(folder, "a_1.png", 2);
        });
        check("is a folder", &|folder| std::fs::create_dir(folder.join("a_1.png")).unwrap());
        check("65000x65000", &|folder| {
            std::fs::write(folder.join("a.png"), claims_to_be(65000, 65000).unwrap()).unwrap()
        });
        check("PNG", &|folder| std::fs::write(folder.join("a_1.png"), b"\x89PNG nonsense").unwrap());
    }
}
