//! Reads tensors from a safetensors file by name and checks them. Knows nothing of the networks.

use super::SamError;
use burn::module::Param;
use burn::tensor::{DType, Device, Tensor, TensorData};
use safetensors::SafeTensors;
use std::path::Path;

/// A parsed weights file with its name, for messages, and the device that tensors go to.
pub(super) struct SamWeights<'a> {
    path: &'a Path,
    file: SafeTensors<'a>,
    device: &'a Device,
}

/// A dotted prefix in a weights file.
pub(super) struct Scope<'a> {
    weights: &'a SamWeights<'a>,
    prefix: String,
}

impl<'a> SamWeights<'a> {
    pub(super) fn parse(path: &'a Path, bytes: &'a [u8], device: &'a Device) -> Result<Self, SamError> {
        let file =
            SafeTensors::deserialize(bytes).map_err(|source| SamError::Format { path: path.to_path_buf(), source })?;
        Ok(Self { path, file, device })
    }

    pub(super) fn root(&'a self) -> Scope<'a> {
        Scope { weights: self, prefix: String::new() }
    }
}

impl<'a> Scope<'a> {
    fn name(&self, name: &str) -> String {
        if self.prefix.is_empty() { name.to_owned() } else { format!("{}.{name}", self.prefix) }
    }

    /// Returns the scope `name` below this one.
    pub(super) fn at(&self, name: impl std::fmt::Display) -> Scope<'a> {
        Scope { weights: self.weights, prefix: self.name(&name.to_string()) }
    }

    /// Returns the values of the tensor `name`, which must have this shape, row-major.
    pub(super) fn values(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>, SamError> {
        let tensor = self.name(name);
        let path = || self.weights.path.to_path_buf();
        let view = match self.weights.file.tensor(&tensor) {
            Ok(view) => view,
            Err(_) => return Err(SamError::Missing { path: path(), tensor }),
        };
        if view.shape() != shape {
            let (expected, found) = (shape.to_vec(), view.shape().to_vec());
            return Err(SamError::Shape { path: path(), tensor, expected, found });
        }
        let Some(values) = crate::tensors::floats(&view) else {
            return Err(SamError::Type { path: path(), tensor, found: format!("{:?}", view.dtype()) });
        };
        if !values.iter().all(|v| v.is_finite()) {
            return Err(self.not_allowed(name));
        }
        Ok(values)
    }

    /// Returns the error about a tensor's values.
    pub(super) fn not_allowed(&self, name: &str) -> SamError {
        SamError::NotFinite { path: self.weights.path.to_path_buf(), tensor: self.name(name) }
    }

    /// Places values on the device, as a parameter.
    pub(super) fn place<const D: usize>(&self, values: Vec<f32>, shape: [usize; D]) -> Param<Tensor<D>> {
        let data = TensorData::new(values, shape);
        Param::from_tensor(Tensor::from_data(data, (self.weights.device, DType::F32)))
    }

    /// Places a tensor of that shape on the device, as a parameter.
    pub(super) fn param<const D: usize>(&self, name: &str, shape: [usize; D]) -> Result<Param<Tensor<D>>, SamError> {
        Ok(self.place(self.values(name, &shape)?, shape))
    }
}
