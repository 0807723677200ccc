//! Masks from the picture alone: [`find_regions`] as a source.

use super::super::regions::{RegionError, RegionImage, find_regions};
use super::super::registry::{MaskSourceKind, SourceInput};
use super::{MaskInput, MaskSource, ScoredMask, SourceError};
use crate::config::types::segment::MasksConfig;
use crate::segment::pictures::GaussianPicture;

/// Regions of the pictures themselves.
pub struct RegionsKind;

impl MaskSourceKind for RegionsKind {
    fn help(&self) -> &str {
        "Regions between discontinuities of colour, alpha and depth"
    }

    fn open(&self, input: &SourceInput<'_>) -> Result<Box<dyn MaskSource>, SourceError> {
        Ok(Box::new(RegionMaskSource::new(input.job.rendering.background, input.job.config.clone())))
    }
}

/// The source that needs no network.
#[derive(Clone, Debug)]
pub struct RegionMaskSource {
    background: [f32; 3],
    options: MasksConfig,
}

impl RegionMaskSource {
    /// Creates the source for pictures over `background`.
    pub fn new(background: [f32; 3], options: MasksConfig) -> Self {
        Self { background, options }
    }
}

impl MaskSource for RegionMaskSource {
    fn name(&self) -> &str {
        "regions"
    }

    fn find(&self, seen: &MaskInput<'_>) -> Result<Vec<ScoredMask>, SourceError> {
        let masks = find_regions(&region_image(seen.picture, self.background)?, &self.options)?;
        let found = masks.into_iter().map(|m| ScoredMask {
            mask: m.mask,
            predicted_iou: m.contrast,
            stability_score: m.stability_score,
        });
        Ok(found.collect())
    }
}

/// Recovers straight colour and alpha from what was drawn over the background.
fn region_image(picture: &GaussianPicture, background: [f32; 3]) -> Result<RegionImage, RegionError> {
    let mut rgba = picture.rgba.clone();
    for p in rgba.chunks_exact_mut(4) {
        let a = p[3].max(1e-3);
        for c in 0..3 {
            p[c] = ((p[c] - (1.0 - p[3]) * background[c]) / a).clamp(0.0, 1.0);
        }
    }
    RegionImage::from_rgba(picture.width as u32, picture.height as u32, &rgba, Some(&picture.depth))
}
