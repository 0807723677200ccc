//! Encodes points and boxes as vectors for the mask decoder.

use super::SamError;
use super::config::SamConfig;
use super::image::ImageFit;
use super::weights::Scope;
use burn::module::{Module, Param};
use burn::tensor::{DType, Int, Tensor, TensorData};

/// How a point relates to the object.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PointLabel {
    /// Not part of it.
    Outside,
    /// Part of it.
    Inside,
}

/// Where an object is. Coordinates are pixels of the original image, x to the right and y down, the centre of the
/// first pixel at (0, 0).
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SamPrompt {
    /// Points with their labels.
    pub points: Vec<([f32; 2], PointLabel)>,
    /// Left, top, right, bottom of a box around the object.
    pub bounds: Option<[f32; 4]>,
}

impl SamPrompt {
    /// One point inside the object.
    pub fn point(at: [f32; 2]) -> Self {
        Self { points: vec![(at, PointLabel::Inside)], bounds: None }
    }
}

/// Rows of [`PromptEncoder::kinds`].
const PADDING: usize = 0;
const OUTSIDE: usize = 1;
const INSIDE: usize = 2;
const CORNERS: [usize; 2] = [3, 4];

/// The prompt encoder. Mask prompts are not supported.
#[derive(Module, Debug)]
pub(super) struct PromptEncoder {
    /// Random spatial frequencies of the positional encoding, `[2, C / 2]`.
    frequencies: Param<Tensor<2>>,
    /// The embedding added for each kind of position, `[5, C]`.
    kinds: Param<Tensor<2>>,
    /// Stands in for a mask prompt, `[1, C, 1, 1]`.
    no_mask: Param<Tensor<4>>,
}

impl PromptEncoder {
    pub(super) fn load(scope: &Scope<'_>, config: &SamConfig) -> Result<Self, SamError> {
        let dim = config.prompt_dim;
        let row = |scope: Scope<'_>| scope.values("weight", &[1, dim]);
        let mut kinds = row(scope.at("not_a_point_embed"))?;
        for i in 0..4 {
            kinds.extend(row(scope.at("point_embeddings").at(i))?);
        }
        let frequencies = scope.at("pe_layer").param("positional_encoding_gaussian_matrix", [2, dim / 2])?;
        let no_mask = scope.place(row(scope.at("no_mask_embed"))?, [1, dim, 1, 1]);
        Ok(Self { frequencies, kinds: scope.place(kinds, [5, dim]), no_mask })
    }

    /// Encodes positions in `[0, 1]^2` as sines and cosines, `[N, C]`.
    fn waves(&self, positions: Vec<f32>) -> Tensor<2> {
        let shape = [positions.len() / 2, 2];
        let device = self.frequencies.device();
        let at = Tensor::<2>::from_data(TensorData::new(positions, shape), (&device, DType::F32));
        let phase = (at * 2.0 - 1.0).matmul(self.frequencies.val()) * std::f64::consts::TAU;
        Tensor::cat(vec![phase.clone().sin(), phase.cos()], 1)
    }

    /// Encodes the centres of `side^2` cells of the network's input, row by row, `[1, side^2, C]`.
    pub(super) fn cells(&self, side: usize) -> Tensor<3> {
        let centre = |i: usize| ((i as f64 + 0.5) / side as f64) as f32;
        let positions = (0..side * side).flat_map(|i| [centre(i % side), centre(i / side)]).collect();
        self.waves(positions).unsqueeze()
    }

    /// Adds the stand-in for a mask prompt to an image embedding `[1, C, S, S]`.
    pub(super) fn with_no_mask(&self, features: Tensor<4>) -> Tensor<4> {
        features + self.no_mask.val()
    }

    /// Encodes prompts as `[B, N, C]`: per prompt its points, then its box's corners, or a padding point without a box.
    pub(super) fn sparse(&self, prompts: &[SamPrompt], frame: &ImageFit) -> Result<Tensor<3>, SamError> {
        let (mut positions, mut kinds) = (Vec::new(), Vec::new());
        for (index, prompt) in prompts.iter().enumerate() {
            check(prompt, &prompts[0]).map_err(|rule| SamError::Prompt { index, rule })?;
            let mut push = |at: [f32; 2], kind: usize| {
                positions.extend(frame.position(at));
                kinds.push(kind as i64);
            };
            for &(at, label) in &prompt.points {
                push(at, if label == PointLabel::Inside { INSIDE } else { OUTSIDE });
            }
            match prompt.bounds {
                Some([left, top, right, bottom]) => {
                    push([left, top], CORNERS[0]);
                    push([right, bottom], CORNERS[1]);
                }
                None => push([0.0, 0.0], PADDING),
            }
        }
        let (rows, device) = (kinds.len(), self.kinds.device());
        let placed = |kind: &i64| if *kind == PADDING as i64 { 0.0 } else { 1.0 };
        let placed: Vec<f32> = kinds.iter().map(placed).collect();
        let placed = Tensor::<2>::from_data(TensorData::new(placed, [rows, 1]), (&device, DType::F32));
        let kinds = Tensor::<1, Int>::from_data(TensorData::new(kinds, [rows]), &device);
        let encoded = self.waves(positions) * placed + self.kinds.val().select(0, kinds);
        let dim = encoded.dims()[1];
        Ok(encoded.reshape([prompts.len(), rows / prompts.len(), dim]))
    }
}

/// The first rule that a prompt of a batch breaks.
fn check(prompt: &SamPrompt, first: &SamPrompt) -> Result<(), &'static str> {
    if prompt.points.is_empty() && prompt.bounds.is_none() {
        return Err("it has neither a point nor a box");
    }
    if prompt.points.len() != first.points.len() || prompt.bounds.is_some() != first.bounds.is_some() {
        return Err("all prompts of a batch must have the same number of points, and all or none a box");
    }
    let numbers = prompt.points.iter().flat_map(|(at, _)| at).chain(prompt.bounds.iter().flatten());
    if numbers.copied().all(f32::is_finite) { Ok(()) } else { Err("a coordinate is not finite") }
}
