//! Reads the weights of an LPIPS net from a safetensors file and checks them. No arithmetic on images here.

use super::net::ConvSpec;
use super::{LpipsError, LpipsNet};
use crate::tensors::{self, TensorFileError};
use burn::tensor::{DType, Device, Tensor, TensorData, f16};
use safetensors::{Dtype, SafeTensors};
use std::path::{Path, PathBuf};

/// A convolution's parameters on the device.
#[derive(Debug, Clone)]
pub(super) struct Conv {
    pub spec: ConvSpec,
    /// `[output, input, kernel, kernel]`.
    pub weight: Tensor<4>,
    /// `[output]`.
    pub bias: Tensor<1>,
}

/// All parameters of a net, by stage.
#[derive(Debug, Clone)]
pub(super) struct Weights {
    pub net: LpipsNet,
    pub convs: Vec<Vec<Conv>>,
    /// One weight per channel of each stage, `[1, C, 1, 1]`.
    pub heads: Vec<Tensor<4>>,
}

/// A parsed file with its name, for messages.
struct Source<'a> {
    path: &'a Path,
    file: SafeTensors<'a>,
}

impl Weights {
    pub(super) fn load(path: &Path, device: &Device) -> Result<Self, LpipsError> {
        let bytes = tensors::read(path).map_err(|error| match error {
            TensorFileError::Io { path, source } => LpipsError::Read { path, source },
            TensorFileError::Damaged { path, reason } => LpipsError::Damaged { path, reason },
        })?;
        let file = SafeTensors::deserialize(&bytes)
            .map_err(|e| LpipsError::Damaged { path: path.to_path_buf(), reason: e.to_string() })?;
        let source = Source { path, file };
        let net = source.net()?;
        let mut convs = Vec::new();
        let mut heads = Vec::new();
        let mut number = 0;
        for (index, stage) in net.stages().iter().enumerate() {
            let mut stage_convs = Vec::new();
            let mut channels = 0;
            for &spec in stage.convs {
                let shape = [spec.output, spec.input, spec.kernel, spec.kernel];
                stage_convs.push(Conv {
                    spec,
                    weight: source.tensor(&format!("net.conv{number}.weight"), shape, device)?,
                    bias: source.tensor(&format!("net.conv{number}.bias"), [spec.output], device)?,
                });
                channels = spec.output;
                number += 1;
            }
            convs.push(stage_convs);
            heads.push(source.tensor(&format!("lin{index}.weight"), [1, channels, 1, 1], device)?);
        }
        Ok(Self { net, convs, heads })
    }
}

impl Source<'_> {
    fn path(&self) -> PathBuf {
        self.path.to_path_buf()
    }

    fn view(&self, name: &str) -> Result<safetensors::tensor::TensorView<'_>, LpipsError> {
        self.file.tensor(name).map_err(|_| LpipsError::Missing { path: self.path(), tensor: name.to_owned() })
    }

    /// Identifies the net by the kernel of the first convolution.
    fn net(&self) -> Result<LpipsNet, LpipsError> {
        let name = "net.conv0.weight";
        let found = self.view(name)?.shape().to_vec();
        let is = |net: &LpipsNet| {
            let first = net.stages()[0].convs[0];
            found == [first.output, first.input, first.kernel, first.kernel]
        };
        [LpipsNet::Alex, LpipsNet::Vgg].into_iter().find(is).ok_or_else(|| LpipsError::UnknownNet {
            path: self.path(),
            tensor: name.to_owned(),
            found: found.clone(),
        })
    }

    fn tensor<const D: usize>(&self, name: &str, shape: [usize; D], device: &Device) -> Result<Tensor<D>, LpipsError> {
        let view = self.view(name)?;
        let tensor = name.to_owned();
        if view.shape() != shape {
            let (expected, found) = (shape.to_vec(), view.shape().to_vec());
            return Err(LpipsError::Shape { path: self.path(), tensor, expected, found });
        }
        let values: Vec<f32> = match view.dtype() {
            Dtype::F32 => {
                let (chunks, _) = view.data().as_chunks::<4>();
                chunks.iter().map(|b| f32::from_le_bytes(*b)).collect()
            }
            Dtype::F16 => {
                let (chunks, _) = view.data().as_chunks::<2>();
                chunks.iter().map(|b| f16::from_le_bytes(*b).to_f32()).collect()
            }
            other => {
                return Err(LpipsError::Type { path: self.path(), tensor, found: format!("{other:?}") });
            }
        };
        if !values.iter().all(|v| v.is_finite()) {
            return Err(LpipsError::NotFinite { path: self.path(), tensor });
        }
        Ok(Tensor::from_data(TensorData::new(values, shape), (device, DType::F32)))
    }
}
