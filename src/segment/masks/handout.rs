//! Pictures for another program to segment, and the list of what they show, by which its masks are matched later.

use super::make::{MakeError, MaskJob, Shot};
use super::store::StoreError;
use crate::segment::pictures::draw;
use image::{ImageFormat, RgbImage};
use serde::{Deserialize, Serialize};
use std::io::Cursor;
use std::path::Path;
use thiserror::Error;

/// Name of the list in the folder of the pictures.
pub const FILE: &str = "pictures.json";

/// What pictures show.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Handout {
    /// Fingerprint of the scene.
    pub scene: String,
    /// Time in [0, 1].
    pub time: f64,
    /// The groups; the pictures of one are in the folder of its name.
    pub groups: Vec<HandoutGroup>,
    /// The views; `VIEW.png` in each folder.
    pub views: Vec<Shot>,
}

/// A group that was drawn.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct HandoutGroup {
    /// Its name.
    pub name: String,
    /// How many Gaussians it had, to tell when it is another by now.
    pub gaussians: usize,
}

/// Why pictures cannot be written.
#[derive(Debug, Error)]
pub enum HandoutError {
    /// The views or groups cannot be used, or `progress` said to stop.
    #[error(transparent)]
    Job(#[from] MakeError),
    /// A file cannot be written.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// Writes `GROUP/VIEW.png`, RGB over the background, for each group and view into `folder`, and the list. `progress` is
/// called after each picture and says whether to go on.
///
/// # Errors
/// As [`HandoutError`]; some of the pictures are then in `folder`.
pub fn write_pictures(
    job: &MaskJob<'_>,
    scene: &str,
    folder: &Path,
    mut progress: impl FnMut() -> bool,
) -> Result<(), HandoutError> {
    job.check()?;
    for group in job.groups {
        let inner = folder.join(&group.name);
        std::fs::create_dir_all(&inner).map_err(StoreError::io(&inner))?;
        let alone = job.at.subset(&group.members);
        for shot in job.shots {
            let path = inner.join(format!("{}.png", shot.file));
            let rgba = draw(&alone, shot.camera.to_kernel(), job.background, job.sh_degree, job.device);
            let bytes = rgba.chunks_exact(4).flat_map(|p| &p[..3]).map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8);
            let (w, h) = (shot.camera.width, shot.camera.height);
            let image = RgbImage::from_raw(w, h, bytes.collect())
                .ok_or_else(|| StoreError::field(&path, "pixels", "are not as many as the camera has"))?;
            let mut png = Cursor::new(Vec::new());
            image.write_to(&mut png, ImageFormat::Png).map_err(|e| StoreError::field(&path, "PNG", e))?;
            std::fs::write(&path, png.into_inner()).map_err(StoreError::io(&path))?;
            if !progress() {
                return Err(MakeError::Stopped.into());
            }
        }
    }
    let groups = job.groups.iter().map(|g| HandoutGroup { name: g.name.clone(), gaussians: g.members.len() });
    let list = Handout { scene: scene.to_owned(), time: job.time, groups: groups.collect(), views: job.shots.to_vec() };
    let path = folder.join(FILE);
    let json = serde_json::to_vec_pretty(&list).map_err(|e| StoreError::field(&path, "list", e))?;
    std::fs::write(&path, json).map_err(StoreError::io(&path))?;
    Ok(())
}

impl Handout {
    /// Reads the list of the pictures in `folder`.
    ///
    /// # Errors
    /// If it is missing or not what it should be.
    pub fn read(folder: &Path) -> Result<Self, StoreError> {
        let path = folder.join(FILE);
        let bytes = std::fs::read(&path).map_err(StoreError::io(&path))?;
        serde_json::from_slice(&bytes).map_err(|e| StoreError::field(&path, "list", e))
    }
}
