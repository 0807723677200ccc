//! Comparison of a selection, drawn alone, with the ground truth, view by view.

use super::select::SelectedGaussians;
use super::truth::{TruthFrame, TruthImage};
use crate::metrics::lpips::{Lpips, LpipsNet};
use crate::metrics::psnr::{psnr_of_pictures, to_8_bits};
use crate::metrics::ssim::{ssim_gray, ssim_rgb};
use crate::model::{HostGaussians, Rendering, ToKernel};
use crate::segment::pictures::draw;
use burn::tensor::Device;
use serde::Serialize;

/// How a segment drawn alone compares with the ground truth in one view.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrameScore {
    /// Time in [0, 1].
    pub time: f64,
    /// Intersection over union of the masks; `None` if both are empty: the segment is not there, and nothing is shown.
    pub iou: Option<f64>,
    /// How the pictures compare; `None` for several segments, of which there is no picture together.
    pub picture: Option<PictureScore>,
}

/// How two pictures compare.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PictureScore {
    /// PSNR in decibels, over all pixels of the 8-bit pictures.
    pub psnr: f64,
    /// SSIM on RGB, 11-tap Gaussian window.
    pub ssim: f64,
    /// SSIM on grey values, 7x7 uniform window.
    pub ssim_gray: f64,
    /// LPIPS, AlexNet; `None` without weights.
    pub lpips: Option<f64>,
}

/// What all comparisons share.
pub struct SelectionJudge<'a> {
    /// Device to draw on.
    pub device: &'a Device,
    /// How the scene is drawn.
    pub rendering: Rendering,
    /// Minimum alpha of a pixel of a mask; the ground truth's own if `None`.
    pub mask_alpha: Option<f32>,
    /// Minimum alpha of the ground truth's masks.
    pub truth_alpha: f32,
    /// Networks for LPIPS.
    pub networks: &'a [Lpips],
}

impl SelectionJudge<'_> {
    /// Draws the `selected` Gaussians at the frame's time and compares them. Also returns the picture, RGB.
    ///
    /// # Errors
    /// A message if the ground truth cannot be read, or is too small for a metric.
    pub fn score(
        &self,
        at: &HostGaussians,
        selected: &SelectedGaussians,
        frame: &TruthFrame,
        truth: &TruthImage,
    ) -> Result<(FrameScore, Vec<f32>), String> {
        let alone = selected.gaussians(at);
        let image = draw(&alone, self.rendering.seen_by(frame.camera.to_kernel()), self.device);
        let render: Vec<f32> = image.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]].map(to_8_bits)).collect();
        let least = self.mask_alpha.unwrap_or(self.truth_alpha);
        let known = |(i, known): (usize, &bool)| match self.mask_alpha {
            Some(least) => truth.alpha[i] >= least,
            None => *known,
        };
        let (mut both, mut either) = (0usize, 0usize);
        for (p, known) in image.chunks_exact(4).zip(truth.mask.iter().enumerate().map(known)) {
            let shown = p[3] >= least;
            both += usize::from(shown && known);
            either += usize::from(shown || known);
        }
        let size = (frame.camera.width as usize, frame.camera.height as usize);
        let expected = truth.rgba.as_ref().map(|rgba| self.composite(rgba));
        let picture = expected.map(|expected| self.compare(&render, &expected, size)).transpose()?;
        let score = FrameScore { time: frame.time, iou: (either > 0).then(|| both as f64 / either as f64), picture };
        Ok((score, render))
    }

    fn compare(&self, render: &[f32], expected: &[f32], (w, h): (usize, usize)) -> Result<PictureScore, String> {
        let network = self.networks.iter().find(|n| n.net() == LpipsNet::Alex);
        Ok(PictureScore {
            psnr: psnr_of_pictures(render, expected).map_err(|e| e.to_string())?,
            ssim: ssim_rgb(render, expected, w, h).map_err(|e| e.to_string())?,
            ssim_gray: ssim_gray(render, expected, w, h).map_err(|e| e.to_string())?,
            lpips: network.map(|n| n.distance(render, expected, h, w).map_err(|e| e.to_string())).transpose()?,
        })
    }

    /// Returns the ground truth over the background, RGB `[H, W, 3]`; for several segments their mask, white on black.
    pub fn shown(&self, truth: &TruthImage) -> Vec<f32> {
        match &truth.rgba {
            Some(rgba) => self.composite(rgba),
            None => truth.mask.iter().flat_map(|m| [f32::from(u8::from(*m)); 3]).collect(),
        }
    }

    fn composite(&self, rgba: &[u8]) -> Vec<f32> {
        let over = |p: &[u8]| {
            let a = f32::from(p[3]) / 255.0;
            [0, 1, 2].map(|c| to_8_bits(f32::from(p[c]) / 255.0 * a + (1.0 - a) * self.rendering.background[c]))
        };
        rgba.chunks_exact(4).flat_map(over).collect()
    }
}
