//! Reads the weights of an LPIPS net from a safetensors file and checks them. No arithmetic on images here.

use super::net::ConvSpec;
use super::{LpipsError, LpipsNet};
use crate::tensors::{self, TensorFileError};
use burn::tensor::{DType, Device, Tensor, TensorData};
use safetensors::SafeTensors;
use std::path::{Path, PathBuf};

/// A convolution's parameters on the device.
#[derive(Debug, Clone)]
pub(super) struct LpipsConv {
    pub spec: ConvSpec,
    /// `[output, input, kernel, kernel]`.
    pub weight: Tensor<4>,
    /// `[output]`.
    pub bias: Tensor<1>,
}

/// All parameters of a net, by stage.
#[derive(Debug, Clone)]
pub(super) struct LpipsWeights {
    pub net: LpipsNet,
    pub convs: Vec<Vec<LpipsConv>>,
    /// One weight per channel of each stage, `[1, C, 1, 1]`.
    pub heads: Vec<Tensor<4>>,
}

/// A parsed file with its name, for messages.
struct LpipsFile<'a> {
    path: &'a Path,
    file: SafeTensors<'a>,
}

impl LpipsWeights {
    pub(super) fn load(path: &Path, device: &Device) -> Result<Self, LpipsError> {
        let bytes = tensors::read(path).map_err(|error| match error {
            TensorFileError::Io { path, source } => LpipsError::Read { path, source },
            TensorFileError::Damaged { path, reason } => LpipsError::Damaged { path, reason },
        })?;
        let file = SafeTensors::deserialize(&bytes)
            .map_err(|e| LpipsError::Damaged { path: path.to_path_buf(), reason: e.to_string() })?;
        let source = LpipsFile { path, file };
        let net = source.net()?;
        let mut number = 0;
        let mut conv = |spec: &ConvSpec| -> Result<LpipsConv, LpipsError> {
            let weight = source.tensor(&format!("net.conv{number}.weight"), spec.weight_shape(), device)?;
            let bias = source.tensor(&format!("net.conv{number}.bias"), [spec.output], device)?;
            number += 1;
            Ok(LpipsConv { spec: *spec, weight, bias })
        };
        let (mut convs, mut heads) = (Vec::new(), Vec::new());
        for ((index, stage), shape) in net.stages().iter().enumerate().zip(net.head_shapes()) {
            convs.push(stage.convs.iter().map(&mut conv).collect::<Result<Vec<_>, _>>()?);
            heads.push(source.tensor(&format!("lin{index}.weight"), shape, device)?);
        }
        Ok(Self { net, convs, heads })
    }
}

impl LpipsFile<'_> {
    fn path(&self) -> PathBuf {
        self.path.to_path_buf()
    }

    fn view(&self, name: &str) -> Result<safetensors::tensor::TensorView<'_>, LpipsError> {
        self.file.tensor(name).map_err(|_| LpipsError::Missing { path: self.path(), tensor: name.to_owned() })
    }

    /// Identifies the net by the kernel of the first convolution.
    fn net(&self) -> Result<LpipsNet, LpipsError> {
        let tensor = "net.conv0.weight".to_owned();
        let found = self.view(&tensor)?.shape().to_vec();
        LpipsNet::with_first_weights(&found).ok_or(LpipsError::UnknownNet { path: self.path(), tensor, found })
    }

    fn tensor<const D: usize>(&self, name: &str, shape: [usize; D], device: &Device) -> Result<Tensor<D>, LpipsError> {
        let view = self.view(name)?;
        let tensor = name.to_owned();
        if view.shape() != shape {
            let (expected, found) = (shape.to_vec(), view.shape().to_vec());
            return Err(LpipsError::Shape { path: self.path(), tensor, expected, found });
        }
        let Some(values) = tensors::floats(&view) else {
            return Err(LpipsError::Type { path: self.path(), tensor, found: format!("{:?}", view.dtype()) });
        };
        if !values.iter().all(|v| v.is_finite()) {
            return Err(LpipsError::NotFinite { path: self.path(), tensor });
        }
        Ok(Tensor::from_data(TensorData::new(values, shape), (device, DType::F32)))
    }
}
