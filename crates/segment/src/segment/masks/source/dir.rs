//! Masks of other programs as a source: a folder of PNGs or a COCO file, matched to pictures `GROUP/NAME.png`.

use super::super::coco::CocoFile;
use super::super::png_folder::PngFolder;
use super::super::registry::{
    ChooseSourceError, MaskSourceKind, SourceInput, SourceOption, SourceOptions, SourceViews,
};
use super::super::store::StoreError;
use super::{MaskInput, MaskSource, ScoredMask, SourceError};
use std::collections::HashMap;
use std::path::Path;

/// Masks that another program made of the pictures written for it: a folder `GROUP/VIEW_NUMBER.png` or a COCO file.
pub struct DirKind;

impl MaskSourceKind for DirKind {
    fn help(&self) -> &str {
        "Masks made by another program"
    }

    fn reads(&self) -> &[SourceOption] {
        &[SourceOption::Path]
    }

    fn views(&self) -> SourceViews {
        SourceViews::HandedOut
    }

    fn complete(&self, options: SourceOptions) -> Result<SourceOptions, ChooseSourceError> {
        match options.path {
            Some(_) => Ok(options),
            None => Err(ChooseSourceError::Missing {
                option: SourceOption::Path,
                what: "the folder of masks or the COCO file",
            }),
        }
    }

    fn open(&self, input: &SourceInput<'_>) -> Result<Box<dyn MaskSource>, SourceError> {
        let job = input.job;
        let groups: Vec<String> = job.groups.iter().map(|g| g.name.clone()).collect();
        let views: Vec<String> = job.shots.iter().map(|s| format!("{}.png", s.file)).collect();
        let (width, height) = job.shots.first().map_or((0, 0), |s| (s.camera.width, s.camera.height));
        let path = input.options.path.as_deref().unwrap_or(Path::new(""));
        Ok(Box::new(ForeignMasks::open(path, &groups, input.others, &views, [width, height])?))
    }
}

/// Masks that another program made of the pictures of some groups.
#[derive(Debug)]
pub struct ForeignMasks {
    name: String,
    masks: StoredMasks,
}

#[derive(Debug)]
enum StoredMasks {
    /// By group.
    Folders(Vec<PngFolder>),
    /// The file, and the index of its image for each group and view.
    Coco(CocoFile, HashMap<(usize, usize), usize>),
}

impl ForeignMasks {
    /// Opens `path`: a COCO file, whose images are called `GROUP/VIEW.png`, or a folder that contains one of PNGs for
    /// each group, see [`PngFolder`]. For a single group, the folder itself may hold the PNGs and COCO names may omit
    /// the group. Pictures of the groups `others` are skipped. Extensions of file names are ignored; all pictures are
    /// `size` (width, height) pixels.
    ///
    /// # Errors
    /// As [`PngFolder::open`] and [`CocoFile::open`]; [`StoreError::Field`] where a group's folder is missing, an image
    /// is not one of the pictures or is of another size, and where there is nothing for any picture.
    pub fn open(
        path: &Path,
        groups: &[String],
        others: &[String],
        views: &[String],
        size: [u32; 2],
    ) -> Result<Self, StoreError> {
        let [width, height] = size;
        let name = format!("dir {}", path.file_name().unwrap_or_default().to_string_lossy());
        let masks = if path.is_dir() {
            let mut folders = Vec::new();
            for group in groups {
                let folder = path.join(group);
                let folder = if groups.len() == 1 && !folder.is_dir() { path.to_owned() } else { folder };
                if !folder.is_dir() {
                    let problem =
                        format!("this folder is missing; it should hold the masks of the pictures of {group}");
                    return Err(StoreError::field(path, group.as_str(), problem));
                }
                folders.push(PngFolder::open(&folder, views, width, height)?);
            }
            if folders.iter().all(PngFolder::is_empty) {
                let problem = "none found; name masks GROUP/VIEW_NUMBER.png, or GROUP/VIEW.png for a label image";
                return Err(StoreError::field(path, "masks", problem));
            }
            StoredMasks::Folders(folders)
        } else {
            let file = CocoFile::open(path)?;
            let places = places(path, &file, [groups, others], views, size)?;
            StoredMasks::Coco(file, places)
        };
        Ok(Self { name, masks })
    }
}

/// Finds the image of the file for each group and view.
fn places(
    path: &Path,
    file: &CocoFile,
    [groups, others]: [&[String]; 2],
    views: &[String],
    size: [u32; 2],
) -> Result<HashMap<(usize, usize), usize>, StoreError> {
    let mut places = HashMap::new();
    for (index, image) in file.images().iter().enumerate() {
        let fail =
            |field: &str, problem: String| Err(StoreError::field(path, format!("images[{index}].{field}"), problem));
        let name = Path::new(&image.file_name);
        let folder = name.parent().and_then(Path::file_name);
        let is_in = |g: &String| folder.is_some_and(|f| f == g.as_str());
        if others.iter().any(is_in) {
            continue;
        }
        let named = groups.iter().position(is_in);
        let group = named.or((groups.len() == 1).then_some(0));
        let view = views.iter().position(|v| Path::new(v).file_stem() == name.file_stem());
        let (Some(group), Some(view)) = (group, view) else {
            let problem = format!("{:?} is not one of the pictures, which are named GROUP/VIEW.png", image.file_name);
            return fail("file_name", problem);
        };
        if [image.width, image.height] != size {
            let [w, h] = size;
            let (width, height) = (image.width, image.height);
            return fail(
                "width, height",
                format!("{:?} is {width}x{height}, but the picture is {w}x{h}", image.file_name),
            );
        }
        if places.insert((group, view), index).is_some() {
            return fail("file_name", format!("{:?} is listed twice", image.file_name));
        }
    }
    if places.is_empty() {
        let problem = format!("none is of {}; list the pictures as GROUP/VIEW.png", groups.join(", "));
        return Err(StoreError::field(path, "images", problem));
    }
    Ok(places)
}

impl MaskSource for ForeignMasks {
    fn name(&self) -> &str {
        &self.name
    }

    fn find(&self, seen: &MaskInput<'_>) -> Result<Vec<ScoredMask>, SourceError> {
        let masks = match &self.masks {
            StoredMasks::Folders(folders) => {
                let unknown = SourceError::View { view: seen.view, group: seen.group };
                folders.get(seen.group).ok_or(unknown)?.masks(seen.view)?
            }
            StoredMasks::Coco(file, places) => match places.get(&(seen.group, seen.view)) {
                Some(image) => file.masks(*image)?,
                None => Vec::new(),
            },
        };
        let found = masks.into_iter().map(|m| ScoredMask {
            mask: m.mask,
            predicted_iou: m.predicted_iou,
            stability_score: m.stability_score,
        });
        Ok(found.collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::pictures::GaussianPicture;
    use image::GrayImage;

    fn picture() -> GaussianPicture {
        GaussianPicture { width: 4, height: 2, rgba: vec![0.0; 32], depth: vec![0.0; 8] }
    }

    fn areas(source: &ForeignMasks, group: usize, view: usize) -> Vec<u64> {
        let picture = picture();
        let found = source.find(&MaskInput { view, group, picture: &picture, front: None }).unwrap();
        found.iter().map(|f| f.mask.area()).collect()
    }

    fn open(path: &Path, groups: &[&str]) -> Result<ForeignMasks, StoreError> {
        let groups: Vec<String> = groups.iter().map(|g| (*g).to_owned()).collect();
        ForeignMasks::open(path, &groups, &["other".into()], &["view-000".into(), "view-001".into()], [4, 2])
    }

    #[test]
    fn folders_by_group_or_one_alone() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        assert!(open(root, &["a", "b"]).unwrap_err().to_string().contains("pictures of a"));
        assert!(open(root, &["a"]).unwrap_err().to_string().contains("none found"));
        std::fs::create_dir_all(root.join("a")).unwrap();
        std::fs::create_dir_all(root.join("b")).unwrap();
        let labels = GrayImage::from_fn(4, 2, |x, _| image::Luma([if x < 3 { 1 } else { 9 }]));
        labels.save(root.join("a/view-001.png")).unwrap();
        let both = open(root, &["a", "b"]).unwrap();
        assert_eq!(areas(&both, 0, 1), [6, 2]);
        assert_eq!((areas(&both, 0, 0), areas(&both, 1, 1)), (vec![], vec![]));
        assert_eq!(areas(&open(&root.join("a"), &["a"]).unwrap(), 0, 1), [6, 2]);
        assert!(both.name().starts_with("dir "));
    }

    #[test]
    fn a_coco_file_names_group_and_view() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("masks.json");
        let write = |name: &str, width: u32| {
            let text = serde_json::json!({
                "images": [{ "id": 7, "file_name": name, "width": width, "height": 2 }],
                "annotations": [{ "image_id": 7, "segmentation": { "size": [2, width], "counts": [1, 3, 2 * width - 4] } }],
            });
            std::fs::write(&path, text.to_string()).unwrap();
        };
        write("pictures/b/view-001.jpg", 4);
        let both = open(&path, &["a", "b"]).unwrap();
        assert_eq!((areas(&both, 1, 1), areas(&both, 0, 1)), (vec![3], vec![]));
        for name in ["view-000.png", "images/view-000.png"] {
            write(name, 4);
            assert_eq!(areas(&open(&path, &["a"]).unwrap(), 0, 0), [3]);
        }
        write("pictures/other/view-000.png", 4);
        for groups in [&["a"][..], &["a", "b"]] {
            let error = open(&path, groups).unwrap_err().to_string();
            assert!(error.contains(&format!("none is of {}", groups.join(", "))), "{error}");
        }
        for (name, width, words) in [
            ("view-000.png", 4, "not one of the pictures"),
            ("a/x.png", 4, "not one of"),
            ("a/view-000.png", 5, "is 5x2"),
        ] {
            write(name, width);
            let error = open(&path, &["a", "b"]).unwrap_err().to_string();
            assert!(error.contains(words) && error.contains("masks.json") && error.contains(name), "{error}");
        }
    }
}
