//! Masks of MobileSAM's automatic mode as a source.

use super::super::alpha::{background_below, on_background};
use super::super::registry::{
    ChooseSourceError, DEFAULT_POINTS, MaskSourceKind, SourceInput, SourceOption, SourceOptions,
};
use super::super::sam::{AutomaticOptions, Sam, SamConfig, checkpoint, generate};
use super::{MaskInput, MaskSource, ScoredMask, SourceError};
use crate::config::types::segment::MasksConfig;
use crate::export::images::to_rgb8;
use crate::memory::{MemoryBudget, product};
use std::path::Path;

/// Seconds per picture and per point of the grid, of the full-size network on a CPU of two cores.
const SECONDS: [f64; 2] = [4.0, 0.12];

/// Bytes per point of the grid that prompts the network.
const POINT_BYTES: usize = 64;

/// MobileSAM.
pub struct SamKind;

impl MaskSourceKind for SamKind {
    fn help(&self) -> &str {
        "MobileSAM"
    }

    fn reads(&self) -> &[SourceOption] {
        &[SourceOption::Weights, SourceOption::Points]
    }

    fn complete(&self, options: SourceOptions) -> Result<SourceOptions, ChooseSourceError> {
        let bad = |option| move |problem| ChooseSourceError::Unusable { option, problem };
        let points = options.points.unwrap_or(DEFAULT_POINTS);
        let grid = product(&[points, points, POINT_BYTES]);
        let fits = MemoryBudget::now().check(format!("a grid of {points}x{points} points"), grid);
        fits.map_err(|e| bad(SourceOption::Points)(e.to_string()))?;
        let weights = checkpoint::locate(options.weights.as_deref());
        let weights = weights.map_err(|e| bad(SourceOption::Weights)(e.to_string()))?;
        Ok(SourceOptions { weights: Some(weights), points: Some(points), ..options })
    }

    fn seconds(&self, pictures: usize, options: &SourceOptions) -> Option<f64> {
        let points = options.points.unwrap_or(DEFAULT_POINTS);
        Some(pictures as f64 * (SECONDS[0] + SECONDS[1] * (points * points) as f64))
    }

    fn open(&self, input: &SourceInput<'_>) -> Result<Box<dyn MaskSource>, SourceError> {
        let weights = input.options.weights.as_deref().unwrap_or(Path::new(""));
        let config = input.job.config;
        let options = AutomaticOptions {
            points_per_side: input.options.points.unwrap_or(DEFAULT_POINTS),
            predicted_iou: config.sam_predicted_iou,
            stability: config.sam_stability,
            box_overlap: config.sam_box_overlap,
            ..AutomaticOptions::default()
        };
        let sam = Sam::load(weights, &SamConfig::default(), input.job.device)?;
        Ok(Box::new(SamSource::new(sam, options, config.clone())))
    }
}

/// A network prompted with a grid of points.
#[derive(Clone, Debug)]
pub struct SamSource {
    name: String,
    sam: Sam,
    options: AutomaticOptions,
    config: MasksConfig,
}

impl SamSource {
    /// Creates the source from a loaded network; `config` says which of its masks are background.
    pub fn new(sam: Sam, options: AutomaticOptions, config: MasksConfig) -> Self {
        let points = options.points_per_side;
        Self { name: format!("sam, {points} by {points} points"), sam, options, config }
    }
}

impl MaskSource for SamSource {
    fn name(&self) -> &str {
        &self.name
    }

    fn find(&self, seen: &MaskInput<'_>) -> Result<Vec<ScoredMask>, SourceError> {
        let picture = seen.picture;
        let rgb = to_rgb8(&picture.rgba, picture.width, picture.height);
        let mut masks = generate(&self.sam, &rgb, picture.width, picture.height, &self.options)?;
        let below = background_below(picture, &self.config);
        masks.retain(|m| !on_background(picture, &m.mask, below));
        let found = masks.into_iter().map(|m| ScoredMask {
            mask: m.mask,
            predicted_iou: m.predicted_iou,
            stability_score: m.stability,
        });
        Ok(found.collect())
    }

    /// The network uses all threads for one picture.
    fn batch_size(&self) -> usize {
        1
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::sam::tests::{fixture, small};
    use super::*;
    use crate::segment::pictures::GaussianPicture;

    fn picture(alpha: impl Fn(usize) -> f32) -> GaussianPicture {
        let (width, height) = (40, 24);
        let pixel = |i: usize| {
            let (x, y) = (i % width, i / width);
            let inside = (10..30).contains(&x) && (6..18).contains(&y);
            let [r, g, b] = if inside { [0.9, 0.3, 0.1] } else { [1.0; 3] };
            [r, g, b, alpha(x)]
        };
        let rgba = (0..width * height).flat_map(pixel).collect();
        GaussianPicture { width, height, rgba, depth: vec![1.0; width * height] }
    }

    #[test]
    fn the_small_network_is_a_source() {
        let device = crate::device::DeviceName::all()[0].open().unwrap();
        let sam = Sam::load(fixture(), &small(), &device).unwrap();
        // random weights have no confidence, so nothing is filtered out
        let options = AutomaticOptions {
            points_per_side: 3,
            predicted_iou: f32::NEG_INFINITY,
            stability: 0.0,
            ..AutomaticOptions::default()
        };
        let source = SamSource::new(sam, options, MasksConfig::default());
        let find =
            |picture: &GaussianPicture| source.find(&MaskInput { view: 0, group: 0, picture, front: None }).unwrap();
        let found = find(&picture(|_| 1.0));
        assert!(!found.is_empty());
        assert!(found.iter().all(|f| (f.mask.width, f.mask.height) == (40, 24) && f.mask.area() > 0));
        assert!(find(&picture(|_| 0.0)).is_empty());
        // a uniformly pale picture has the masks of an opaque one: the network sees the same colours
        assert_eq!(find(&picture(|_| 0.1)), found);
        assert_eq!(source.name(), "sam, 3 by 3 points");
    }
}
