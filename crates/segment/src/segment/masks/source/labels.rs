//! Ground-truth masks: label images of a dataset, restricted to where a group is in front.

use super::super::registry::{MaskSourceKind, SourceInput, SourceViews};
use super::{MaskInput, MaskSource, ScoredMask, SourceError};
use crate::data::Truth;
use crate::data::truth::LabelledView;
use crate::segment::masks::Mask;

/// The dataset's label images: an upper bound.
pub struct LabelsKind;

impl MaskSourceKind for LabelsKind {
    fn help(&self) -> &str {
        "The dataset's label images, as an upper bound"
    }

    fn views(&self) -> SourceViews {
        SourceViews::Labelled
    }

    fn open(&self, input: &SourceInput<'_>) -> Result<Box<dyn MaskSource>, SourceError> {
        let missing = || SourceError::Other("labels: there are no views with a label image".to_owned());
        let (truth, views) = input.labelled.ok_or_else(missing)?;
        Ok(Box::new(LabelImages::new(truth.clone(), views.to_vec(), input.job.config.label_pixels)))
    }
}

/// Label images, one per view.
#[derive(Clone, Debug)]
pub struct LabelImages {
    name: String,
    truth: Truth,
    views: Vec<LabelledView>,
    min_pixels: u64,
}

impl LabelImages {
    /// Creates the source from `views`, which are those that are drawn, in the same order. An id makes a mask from
    /// `min_pixels` on.
    pub fn new(truth: Truth, views: Vec<LabelledView>, min_pixels: u64) -> Self {
        let dataset = truth.root.file_name().unwrap_or_default().to_string_lossy();
        Self { name: format!("labels of {dataset}"), truth, views, min_pixels }
    }
}

impl MaskSource for LabelImages {
    fn name(&self) -> &str {
        &self.name
    }

    /// Returns one mask for each id that shows in front, by ascending id.
    fn find(&self, seen: &MaskInput<'_>) -> Result<Vec<ScoredMask>, SourceError> {
        let (width, height) = (seen.picture.width, seen.picture.height);
        let of_size = |v: &&LabelledView| (v.camera.width as usize, v.camera.height as usize) == (width, height);
        let (Some(view), Some(front)) = (self.views.get(seen.view).filter(of_size), seen.front) else {
            return Err(SourceError::View { view: seen.view, group: seen.group });
        };
        let mut ids = self.truth.labels(view)?;
        for (id, front) in ids.iter_mut().zip(front) {
            if !front {
                *id = 0;
            }
        }
        let masks = Mask::of_labels(width as u32, height as u32, &ids)?.into_iter().map(|(_, mask)| mask);
        let shown = masks.filter(|mask| mask.area() >= self.min_pixels);
        Ok(shown.map(|mask| ScoredMask { mask, predicted_iou: 1.0, stability_score: 1.0 }).collect())
    }

    fn needs_front(&self) -> bool {
        true
    }
}
