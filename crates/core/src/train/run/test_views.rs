//! Evaluation of a few test views during training.

use super::TakenStep;
use crate::config::types::OutputConfig;
use crate::data::Split;
use crate::metrics::psnr::{psnr_of_pictures, to_8_bits};
use crate::model::Model;
use crate::model::ToKernel;

/// Evaluates the model on test views at intervals.
#[derive(Debug)]
pub(super) struct TestViews<'a> {
    split: Option<&'a Split>,
    /// Steps between evaluations; 0 for none.
    every: usize,
    /// Number of views.
    views: usize,
    psnr: Option<f64>,
}

impl<'a> TestViews<'a> {
    /// Returns the evaluation on `split`, if there is one, as the configuration requests it.
    pub(super) fn new(split: Option<&'a Split>, output: &OutputConfig) -> Self {
        Self { split, every: output.eval_every, views: output.eval_views, psnr: None }
    }

    /// Evaluates the model after a step, if that is due, and returns its PSNR, decibels.
    pub(super) fn after_step(&mut self, step: &TakenStep<'_>) -> Option<f64> {
        let split = self.split.filter(|_| step.is_due(self.every))?;
        self.psnr = Some(mean_psnr(step.training.model(), split, self.views));
        self.psnr
    }

    /// The PSNR of the last evaluation, decibels.
    pub(super) fn psnr(&self) -> Option<f64> {
        self.psnr
    }
}

/// Returns the mean PSNR in decibels over `views` evenly spaced views of a split as 8-bit images; finite, as that of an
/// evaluation.
pub fn mean_psnr(model: &dyn Model, split: &Split, views: usize) -> f64 {
    let n = split.frames.len();
    let views = views.clamp(1, n);
    let mut truth = vec![0.0; 3 * split.images.width as usize * split.images.height as usize];
    let mut sum = 0.0;
    for k in 0..views {
        let i = k * n / views;
        let frame = &split.frames[i];
        let image = model.render(frame.camera.to_kernel(), frame.time as f32);
        let rgb: Vec<f32> = image.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).map(to_8_bits).collect();
        split.images.composite(i, model.background(), &mut truth);
        truth.iter_mut().for_each(|v| *v = to_8_bits(*v));
        sum += psnr_of_pictures(&rgb, &truth).unwrap_or(f64::NAN);
    }
    sum / views as f64
}
