//! LPIPS v0.1, the learned perceptual distance of two images, with the AlexNet and VGG-16 backbones.
//!
//! This file holds the image path: scaling, feature maps, distance. `net` holds the layer tables, `weights` the reader
//! of the weights file. Weights are never downloaded: the caller names a local file.

mod net;
#[cfg(test)]
mod tests;
mod weights;

use super::metric::{Better, Metric, MetricDisplay, MetricFailure, MetricInput, Networks};
use burn::tensor::activation::relu;
use burn::tensor::module::{conv2d, max_pool2d};
use burn::tensor::ops::{ConvOptions, MaxPoolOptions};
use burn::tensor::{DType, Device, Tensor, TensorData};
use std::fmt;
use std::path::{Path, PathBuf};
use weights::{LpipsConv, LpipsWeights};

/// Mean and deviation of the backbones' training images, on the [-1, 1] scale.
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];

/// Keeps the division by a zero feature vector finite.
const EPSILON: f64 = 1e-10;

/// The backbone whose features are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum LpipsNet {
    /// AlexNet: fast, the usual choice for evaluation.
    Alex,
    /// VGG-16: the one most papers on view synthesis report.
    Vgg,
}

impl fmt::Display for LpipsNet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            LpipsNet::Alex => "alex",
            LpipsNet::Vgg => "vgg",
        })
    }
}

/// Why LPIPS weights cannot be loaded or a distance cannot be computed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LpipsError {
    /// The weights file cannot be read.
    #[error("cannot read the LPIPS weights {path}: {source}", path = path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system reported.
        source: std::io::Error,
    },
    /// The weights file is not a safetensors file, is truncated or was altered.
    #[error(
        "{path}: damaged: {reason}; copy the weights again, or make them with `volseggs lpips`",
        path = path.display()
    )]
    Damaged {
        /// The file.
        path: PathBuf,
        /// How it is damaged.
        reason: String,
    },
    /// The first convolution belongs to neither net.
    #[error(
        "{path}: `{tensor}` has shape {found:?}; LPIPS weights have [64, 3, 11, 11] (alex) or [64, 3, 3, 3] (vgg) there",
        path = path.display()
    )]
    UnknownNet {
        /// The file.
        path: PathBuf,
        /// The tensor that distinguishes the nets.
        tensor: String,
        /// Its shape.
        found: Vec<usize>,
    },
    /// A tensor is missing.
    #[error("{path}: the tensor `{tensor}` is missing; use a file that `volseggs lpips` made", path = path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// The tensor.
        tensor: String,
    },
    /// A tensor has the wrong shape.
    #[error(
        "{path}: `{tensor}` has shape {found:?}, expected {expected:?}; use a file that `volseggs lpips` made",
        path = path.display()
    )]
    Shape {
        /// The file.
        path: PathBuf,
        /// The tensor.
        tensor: String,
        /// The shape that the net requires.
        expected: Vec<usize>,
        /// The shape in the file.
        found: Vec<usize>,
    },
    /// A tensor has an unsupported element type.
    #[error("{path}: `{tensor}` holds {found} values; convert them to F32 or F16", path = path.display())]
    Type {
        /// The file.
        path: PathBuf,
        /// The tensor.
        tensor: String,
        /// The element type in the file.
        found: String,
    },
    /// A tensor holds NaN or infinity.
    #[error("{path}: `{tensor}` holds values that are not finite; copy the weights again", path = path.display())]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// The tensor.
        tensor: String,
    },
    /// An image does not hold `height * width * 3` values.
    #[error("the images hold {a} and {b} values, expected {height} * {width} * 3; give RGB images of the same size")]
    Size {
        /// Values in the first image.
        a: usize,
        /// Values in the second image.
        b: usize,
        /// Requested number of rows.
        height: usize,
        /// Requested number of columns.
        width: usize,
    },
    /// An image is smaller than the net's receptive field allows.
    #[error("images of {width}x{height} pixels are too small for LPIPS {net}, which needs {min}x{min}")]
    TooSmall {
        /// The net.
        net: LpipsNet,
        /// Rows.
        height: usize,
        /// Columns.
        width: usize,
        /// Minimum side.
        min: usize,
    },
    /// The device did not return the result.
    #[error("cannot read the LPIPS result from the device: {0}")]
    Device(String),
}

/// An LPIPS net with its weights on a device. Only [`Lpips::first_features`] is differentiable.
#[derive(Debug, Clone)]
pub struct Lpips {
    weights: LpipsWeights,
    device: Device,
}

impl Lpips {
    /// Loads LPIPS v0.1 weights, F32 or F16, onto `device`; the shapes in the file identify the net.
    ///
    /// The file holds `net.conv{i}.weight` `[output, input, k, k]`, `net.conv{i}.bias` `[output]` and
    /// `lin{0..4}.weight` `[1, C, 1, 1]`. Other tensors are ignored.
    ///
    /// # Errors
    /// Any [`LpipsError`] about the file: unreadable, truncated, or with a tensor that is missing, of the wrong shape
    /// or type, or not finite.
    pub fn load(path: impl AsRef<Path>, device: &Device) -> Result<Self, LpipsError> {
        let device = if device.is_autodiff() { device.clone().inner() } else { device.clone() };
        Ok(Self { weights: LpipsWeights::load(path.as_ref(), &device)?, device })
    }

    /// The net that the weights belong to.
    pub fn net(&self) -> LpipsNet {
        self.weights.net
    }

    /// Features of the backbone's first stage for images `[N, 3, H, W]` in [-1, 1]; for VGG those after its second
    /// ReLU, `[N, 64, H, W]`. Differentiable with respect to the images.
    pub fn first_features(&self, images: Tensor<4>) -> Tensor<4> {
        let device = images.device();
        let row = |values: [f32; 3]| Tensor::from_data(TensorData::new(values.to_vec(), [1, 3, 1, 1]), &device);
        let x = (images - row(SHIFT)) / row(SCALE);
        self.weights.convs[0].iter().fold(x, |x, conv| {
            if !device.is_autodiff() {
                return convolve(x, conv);
            }
            let (weight, bias) = (Tensor::from_inner(conv.weight.clone()), Tensor::from_inner(conv.bias.clone()));
            convolve(x, &LpipsConv { spec: conv.spec, weight, bias })
        })
    }

    /// The LPIPS distance of two RGB images `[H, W, 3]` with values in [0, 1]; 0 for equal images, and NaN if either
    /// holds a non-finite value.
    ///
    /// # Errors
    /// [`LpipsError::Size`] if an image does not have `height * width * 3` values, [`LpipsError::TooSmall`] below
    /// [`LpipsNet::min_side`], [`LpipsError::Device`] if the device fails.
    pub fn distance(&self, a: &[f32], b: &[f32], height: usize, width: usize) -> Result<f64, LpipsError> {
        let expected = height.checked_mul(width).and_then(|n| n.checked_mul(3));
        if expected != Some(a.len()) || expected != Some(b.len()) {
            return Err(LpipsError::Size { a: a.len(), b: b.len(), height, width });
        }
        let min = self.net().min_side();
        if height.min(width) < min {
            return Err(LpipsError::TooSmall { net: self.net(), height, width, min });
        }
        // a ReLU or a max pool may drop a NaN, and the distance would look valid
        if !a.iter().chain(b).all(|v| v.is_finite()) {
            return Ok(f64::NAN);
        }
        let mut values = planes(a);
        values.extend(planes(b));
        let data = TensorData::new(values, [2, 3, height, width]);
        let mut x: Tensor<4> = Tensor::from_data(data, (&self.device, DType::F32));
        let mut distance = 0.0;
        for (index, stage) in self.net().stages().iter().enumerate() {
            if let Some(kernel) = stage.pool {
                x = pool(x, kernel);
            }
            for conv in &self.weights.convs[index] {
                x = convolve(x, conv);
            }
            distance += layer_distance(x.clone(), self.weights.heads[index].clone())?;
        }
        Ok(distance)
    }
}

/// Where the weights come from.
const WEIGHTS: &str = "LPIPS is null without --lpips-weights FILE: convert the published files with `volseggs lpips`; \
                       see `volseggs lpips --help`";

/// LPIPS of a view with one of the networks, if its weights are loaded.
pub(super) struct LpipsMetric(pub(super) LpipsNet);

impl LpipsMetric {
    fn network<'a>(&self, networks: &'a Networks) -> Option<&'a Lpips> {
        networks.lpips().iter().find(|network| network.net() == self.0)
    }
}

impl Metric for LpipsMetric {
    fn value(&self, view: &MetricInput<'_>) -> Result<Option<f64>, MetricFailure> {
        let network = self.network(view.networks);
        Ok(network.map(|n| n.distance(view.render, view.truth, view.height, view.width)).transpose()?)
    }

    fn display(&self) -> Option<MetricDisplay> {
        let (head, note, by_default) = match self.0 {
            LpipsNet::Alex => ("LPIPS (AlexNet)", "AlexNet", true),
            LpipsNet::Vgg => ("LPIPS (VGG-16)", "VGG-16", false),
        };
        Some(MetricDisplay { note, by_default, ..MetricDisplay::new(head, "LPIPS", 4, Better::Lower) })
    }

    fn is_available(&self, networks: &Networks) -> bool {
        self.network(networks).is_some()
    }

    fn note(&self, _values: &[f64], _pixels: usize, networks: &Networks) -> Option<String> {
        networks.lpips().is_empty().then(|| WEIGHTS.to_owned())
    }
}

/// An image `[H, W, 3]` in [0, 1] as the backbone's input `[3, H, W]`.
fn planes(image: &[f32]) -> Vec<f32> {
    let (pixels, _) = image.as_chunks::<3>();
    let channel = |c: usize| pixels.iter().map(move |p| (2.0 * p[c] - 1.0 - SHIFT[c]) / SCALE[c]);
    (0..3).flat_map(channel).collect()
}

fn pool(x: Tensor<4>, kernel: usize) -> Tensor<4> {
    max_pool2d(x, MaxPoolOptions::new([kernel; 2]).with_stride([net::POOL_STRIDE; 2]))
}

fn convolve(x: Tensor<4>, conv: &LpipsConv) -> Tensor<4> {
    let spec = conv.spec;
    let options = ConvOptions::new([spec.stride; 2], [spec.padding; 2], [1, 1], 1);
    relu(conv2d(x, conv.weight.clone(), Some(conv.bias.clone()), options))
}

/// The mean over positions of the head-weighted squared difference of the two normalised feature vectors. `features` is
/// `[2, C, H, W]`, `head` `[1, C, 1, 1]`.
fn layer_distance(features: Tensor<4>, head: Tensor<4>) -> Result<f64, LpipsError> {
    let norms = features.clone().square().sum_dim(1).sqrt().add_scalar(EPSILON);
    let unit = features.div(norms);
    let difference = unit.clone().narrow(0, 0, 1) - unit.narrow(0, 1, 1);
    let map = difference.square().mul(head).sum_dim(1);
    // the sum over positions runs in f64 in a fixed order, whatever the device
    let data = map.try_into_data().map_err(|e| LpipsError::Device(e.to_string()))?;
    let values = data.try_to_vec::<f32>().map_err(|e| LpipsError::Device(e.to_string()))?;
    Ok(values.iter().map(|&v| f64::from(v)).sum::<f64>() / values.len() as f64)
}
