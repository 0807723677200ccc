//! The deformation field: canonical means and a time in, changes of every deformable attribute out.

use super::Gaussians;
use super::d3dgs::DeformationNetwork;
use super::decoder::Decoder;
use super::encoder::{Encoder, find_encoder};
use crate::config::types::D3dgsConfig;
use crate::config::types::{ModelConfig, TimeRange};
use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use volseggs_kernels::changes::split_changes;
use volseggs_kernels::splat::SplatInputs;

/// Added to the opacity logit of a culled Gaussian.
const TRANSPARENT: f32 = -1e4;

/// Encoder and decoder (the paper's F = D o H).
#[derive(Module, Debug)]
pub struct DeformationField {
    /// Space-time features.
    pub encoder: Encoder,
    /// Maps features to changes; `None` if the encoder outputs the changes itself.
    pub decoder: Option<Decoder>,
    #[module(skip)]
    placing: Placing,
}

/// Where the field lies in space and time.
#[derive(Clone, Debug)]
struct Placing {
    centre: [f32; 3],
    half_size: [f32; 3],
    time_range: TimeRange,
    deform_opacity: bool,
}

impl DeformationField {
    /// A new field over the box `centre +- half_size`.
    ///
    /// # Panics
    /// If [`super::size::check_model`] rejects the configuration.
    pub fn new(config: &ModelConfig, centre: [f32; 3], half_size: [f32; 3], seed: u64, device: &Device) -> Self {
        let factory = find_encoder(&config.encoder).unwrap_or_else(|error| panic!("model.encoder: {error}"));
        let (encoder, features) = (factory.create(config, seed, device), factory.features(config) as usize);
        let decoder = Decoder::new(config, features + config.embedding, seed, device);
        let placing =
            Placing { centre, half_size, time_range: config.time_range, deform_opacity: config.deform_opacity };
        Self { encoder, decoder: Some(decoder), placing }
    }

    /// The field of D3DGS, which has no box.
    pub fn d3dgs(config: &D3dgsConfig, seed: u64, device: &Device) -> Self {
        let encoder = Encoder::D3dgs(DeformationNetwork::new(config, seed, device));
        let (centre, half_size, time_range) = ([0.0; 3], [1.0; 3], TimeRange::Full);
        Self { encoder, decoder: None, placing: Placing { centre, half_size, time_range, deform_opacity: false } }
    }

    /// The Gaussians at `time` in [0, 1]: changes are added to the raw attributes; colours and normals (in the
    /// Gaussians' own frames) are unchanged. Those marked in `culled` `[N]`, if given, are not evaluated and come out
    /// transparent; D3DGS ignores `culled`.
    pub fn deform(&self, gaussians: &Gaussians, time: f32, culled: Option<&[bool]>) -> SplatInputs {
        if let Encoder::D3dgs(network) = &self.encoder {
            return network.deform(gaussians, time);
        }
        let Some(change) = self.decode(gaussians, time, culled, Decoder::forward) else { return gaussians.val() };
        let [n, _] = change.dims();
        let [to_means, to_rotations, to_log_scales, to_opacity_logits] = split_changes(change);
        let mut opacity_logits = gaussians.opacity_logits.val();
        if let Some(culled) = culled {
            let device = opacity_logits.device();
            let marks = TensorData::new(marks(culled, TRANSPARENT), [n]);
            opacity_logits = opacity_logits + Tensor::from_data(marks, &device);
        }
        SplatInputs {
            means: gaussians.means.val() + to_means,
            rotations: gaussians.rotations.val() + to_rotations,
            log_scales: gaussians.log_scales.val() + to_log_scales,
            opacity_logits: if self.placing.deform_opacity {
                opacity_logits + to_opacity_logits.reshape([n])
            } else {
                opacity_logits
            },
            ..gaussians.val()
        }
    }

    /// The opacity logits `[N]` at `time` alone, as in [`Self::deform`] but in less time.
    pub fn opacity_logits(&self, gaussians: &Gaussians, time: f32) -> Tensor<1> {
        let logits = gaussians.opacity_logits.val();
        if !self.placing.deform_opacity {
            return logits;
        }
        match self.decode(gaussians, time, None, Decoder::opacity) {
            Some(change) => logits + change,
            None => logits,
        }
    }

    /// Calls `part` of the decoder with the features of the Gaussians at `time` and their embeddings; `None` without a
    /// decoder, as in D3DGS.
    fn decode<const D: usize>(
        &self,
        gaussians: &Gaussians,
        time: f32,
        culled: Option<&[bool]>,
        part: impl Fn(&Decoder, Tensor<2>, Option<Tensor<2>>) -> Tensor<D>,
    ) -> Option<Tensor<D>> {
        let decoder = self.decoder.as_ref()?;
        let means = gaussians.means.val();
        let device = means.device();
        let row = |v: [f32; 3]| Tensor::<2>::from_data(TensorData::new(v.to_vec(), [1, 3]), &device);
        let inverse = self.placing.half_size.map(|h| 1.0 / h);
        let mut points = (means - row(self.placing.centre)) * row(inverse);
        if let Some(culled) = culled {
            // the field and the decoder skip NaN points
            let marks = TensorData::new(marks(culled, f32::NAN), [culled.len(), 1]);
            points = points + Tensor::from_data(marks, &device);
        }
        let u = match self.placing.time_range {
            TimeRange::Full => time,
            TimeRange::Half => 0.5 + 0.5 * time,
        };
        let features = self.encoder.forward(points, u)?;
        Some(part(decoder, features, gaussians.embedding.as_ref().map(|embedding| embedding.val())))
    }
}

/// `value` for those marked in `culled` `[N]`, 0 for the others.
fn marks(culled: &[bool], value: f32) -> Vec<f32> {
    culled.iter().map(|&culled| if culled { value } else { 0.0 }).collect()
}
