//! Pictures for another program to segment, and the list of what they show, by which its masks are matched later.

use super::make::{MakeError, MaskJob, MaskShot};
use super::store::StoreError;
use crate::data::Camera;
use crate::export::images::to_rgb8;
use crate::files::read_regular;
use crate::model::ToKernel;
use crate::segment::pictures::draw_each;
use crate::segment::segmentation::members_key;
use crate::versioned;
use image::ImageFormat;
use serde::{Deserialize, Serialize};
use std::io::Cursor;
use std::path::Path;

/// Largest side of a picture, pixels.
const MAX_SIDE: u32 = 16_384;
/// Name of the list in the folder of the pictures.
pub const FILE: &str = "pictures.json";

/// What pictures show.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PictureList {
    /// Fingerprint of the scene.
    pub scene: String,
    /// Time in [0, 1].
    pub time: f64,
    /// The groups; the pictures of one are in the folder of its name.
    pub groups: Vec<HandoutGroup>,
    /// The views; `VIEW.png` in each folder.
    pub views: Vec<MaskShot>,
}

/// A group that was drawn.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct HandoutGroup {
    /// Its name.
    pub name: String,
    /// Its number of Gaussians, to detect that the group has changed.
    pub gaussians: usize,
    /// Key of its Gaussians, see [`members_key`].
    pub members: String,
}

/// Writes `GROUP/VIEW.png`, RGB over the background, for each group and view into `folder`, and the list. `progress` is
/// called after each picture and returns whether to continue.
///
/// # Errors
/// As [`MakeError`]; some of the pictures may then be in `folder`.
pub fn write_pictures(
    job: &MaskJob<'_>,
    scene: &str,
    folder: &Path,
    mut progress: impl FnMut() -> bool,
) -> Result<(), MakeError> {
    job.check()?;
    for group in job.groups {
        let inner = folder.join(&group.name);
        std::fs::create_dir_all(&inner).map_err(StoreError::io(&inner))?;
        let seen = job.shots.iter().map(|shot| job.rendering.seen_by(shot.camera.to_kernel()));
        let pictures = draw_each(job.at.subset(&group.members), seen, job.device);
        for (shot, rgba) in job.shots.iter().zip(pictures) {
            let path = inner.join(format!("{}.png", shot.file));
            let image = to_rgb8(&rgba, shot.camera.width as usize, shot.camera.height as usize);
            let mut png = Cursor::new(Vec::new());
            image.write_to(&mut png, ImageFormat::Png).map_err(|e| StoreError::field(&path, "PNG", e))?;
            std::fs::write(&path, png.into_inner()).map_err(StoreError::io(&path))?;
            if !progress() {
                return Err(MakeError::Stopped);
            }
        }
    }
    let groups = job.groups.iter().map(|g| HandoutGroup {
        name: g.name.clone(),
        gaussians: g.members.len(),
        members: members_key(&g.members),
    });
    let list =
        PictureList { scene: scene.to_owned(), time: job.time, groups: groups.collect(), views: job.shots.to_vec() };
    let path = folder.join(FILE);
    let json = versioned::to_json_pretty(&list).map_err(|e| StoreError::field(&path, "list", e))?;
    std::fs::write(&path, json).map_err(StoreError::io(&path))?;
    Ok(())
}

impl PictureList {
    /// Reads the list of the pictures in `folder`.
    ///
    /// # Errors
    /// If it is missing or invalid.
    pub fn read(folder: &Path) -> Result<Self, StoreError> {
        let path = folder.join(FILE);
        let bytes = read_regular(&path).map_err(StoreError::io(&path))?;
        let list: Self = versioned::from_json(&bytes).map_err(|e| StoreError::field(&path, "list", e))?;
        if !(0.0..=1.0).contains(&list.time) {
            return Err(StoreError::field(&path, "time", format!("is {}; it must be in [0, 1]", list.time)));
        }
        for (i, MaskShot { camera, .. }) in list.views.iter().enumerate() {
            if !fits(camera) {
                let problem = "is not a valid camera; write the pictures again with --pictures";
                return Err(StoreError::field(&path, format!("views[{i}].camera"), problem));
            }
        }
        Ok(list)
    }
}

/// Whether pictures can be drawn from a camera.
fn fits(camera: &Camera) -> bool {
    let side = |n: u32| (1..=MAX_SIDE).contains(&n);
    let finite = [camera.fx, camera.fy, camera.cx, camera.cy].iter().all(|v| v.is_finite());
    side(camera.width) && side(camera.height) && finite && camera.fx > 0.0 && camera.camera_to_world.is_finite()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn a_list_with_an_invalid_camera_or_time_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let camera = Camera::look_at(DVec3::X, DVec3::ZERO, DVec3::Z, 0.5, 8, 6);
        let good = PictureList {
            scene: "abc".into(),
            time: 0.5,
            groups: vec![HandoutGroup { name: "red".into(), gaussians: 3, members: String::new() }],
            views: MaskShot::numbered(vec![camera.clone()]),
        };
        let read = |list: &PictureList| {
            std::fs::write(folder.path().join(FILE), versioned::to_json(list).unwrap()).unwrap();
            PictureList::read(folder.path()).map_err(|e| e.to_string())
        };
        assert_eq!(read(&good), Ok(good.clone()));
        let with = |camera: Camera| PictureList { views: MaskShot::numbered(vec![camera]), ..good.clone() };
        for (list, field) in [
            (with(Camera { width: u32::MAX, height: u32::MAX, ..camera.clone() }), "views[0].camera"),
            (with(Camera { height: 0, ..camera.clone() }), "views[0].camera"),
            (with(Camera { fx: -1.0, ..camera }), "views[0].camera"),
            (PictureList { time: 7.0, ..good.clone() }, "time"),
        ] {
            let error = read(&list).unwrap_err();
            assert!(error.contains(field) && error.contains(FILE), "{error}");
        }
        std::fs::remove_file(folder.path().join(FILE)).unwrap();
        std::fs::create_dir(folder.path().join(FILE)).unwrap();
        assert!(PictureList::read(folder.path()).unwrap_err().to_string().contains("is a folder"));
    }
}
