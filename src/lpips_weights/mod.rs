//! Conversion of published LPIPS weights: a torchvision backbone and the heads of LPIPS v0.1 become the one file that
//! [`Lpips::load`](crate::metrics::lpips::Lpips::load) reads. The published ones are read by `state_dict`.

mod state_dict;

use crate::files::{MARK, ReplaceError, check_file, same_file};
use crate::memory::{MemoryBudget, TooLarge, product};
use crate::metrics::lpips::LpipsNet;
use crate::tensors::{TensorFileError, write};
use crate::user_error::UserError;
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use serde::Serialize;
use sha2::{Digest, Sha256};
use state_dict::StateDict;
pub use state_dict::StateDictError;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// The first convolution of both backbones, whose kernel distinguishes them.
const FIRST: &str = "features.0.weight";

/// The published files of a network.
struct Published {
    /// Indices of the convolutions in torchvision's `features`.
    features: &'static [usize],
    /// First digits of the SHA-256 of the backbone's file, which are also part of its name.
    backbone: &'static str,
    /// First digits of the SHA-256 of the heads' file.
    heads: &'static str,
}

const ALEX: Published = Published { features: &[0, 3, 6, 8, 10], backbone: "7be5be79", heads: "df73285e" };
const VGG: Published =
    Published { features: &[0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28], backbone: "397923af", heads: "a78928a0" };

/// Why weights cannot be converted.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConvertError {
    /// A file yields no tensors, or lacks a required one.
    #[error("{}: {source}{}", path.display(), hint(source))]
    Source {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: StateDictError,
    },
    /// The backbone belongs to another network.
    #[error(
        "{}: `{FIRST}` has shape {found:?}; AlexNet has [64, 3, 11, 11] and VGG-16 [64, 3, 3, 3] there; \
         `volseggs lpips --help` says which file is needed",
        path.display()
    )]
    UnknownNet {
        /// The backbone's file.
        path: PathBuf,
        /// The shape in it.
        found: Vec<usize>,
    },
    /// The heads were given as the backbone.
    #[error(
        "{}: holds the heads of LPIPS (`lin0.model.1.weight`) but no `{FIRST}`; give it with --heads",
        path.display()
    )]
    HeadsAsBackbone {
        /// The file.
        path: PathBuf,
    },
    /// The backbone was given as the heads.
    #[error("{}: holds a backbone (`{FIRST}`) but no `lin0.model.1.weight`; give it with --backbone", path.display())]
    BackboneAsHeads {
        /// The file.
        path: PathBuf,
    },
    /// The heads belong to the other network.
    #[error(
        "{}: holds the heads of {found} (`{key}` has shape {shape:?}), but the backbone is {net}; give {net}.pth",
        path.display()
    )]
    OtherHeads {
        /// The heads' file.
        path: PathBuf,
        /// The network of the heads.
        found: LpipsNet,
        /// The network of the backbone.
        net: LpipsNet,
        /// A tensor that differs between the networks.
        key: String,
        /// Its shape in the file.
        shape: Vec<usize>,
    },
    /// The weights do not fit into memory.
    #[error(transparent)]
    Memory(#[from] TooLarge),
    /// The result must not be written to the requested path.
    #[error(transparent)]
    Out(#[from] ReplaceError),
    /// The result cannot be written.
    #[error(transparent)]
    Write(#[from] TensorFileError),
}

/// Advice for a file that is intact but not the right one.
fn hint(source: &StateDictError) -> &'static str {
    use StateDictError::{Missing, Shape, Unsupported};
    match source {
        Missing(_) | Shape { .. } | Unsupported(_) => "; `volseggs lpips --help` says which file is needed",
        _ => "",
    }
}

impl UserError for ConvertError {
    fn is_input(&self) -> bool {
        match self {
            Self::Out(error) => error.is_input(),
            Self::Write(_) => false,
            _ => true,
        }
    }
}

/// An input file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InputFile {
    /// The file.
    pub file: PathBuf,
    /// Number of tensors read from it.
    pub tensors: usize,
    /// The first eight digits of its SHA-256.
    pub sha256: String,
    /// Whether this is the hash of the published file.
    pub published: bool,
}

/// A tensor in the output file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WrittenTensor {
    /// Its name.
    pub name: String,
    /// Its shape.
    pub shape: Vec<usize>,
}

/// The result of a conversion.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ConvertedWeights {
    /// `alex` or `vgg`.
    pub network: String,
    /// The backbone's file.
    pub backbone: InputFile,
    /// The heads' file.
    pub heads: InputFile,
    /// The file that was written.
    pub file: PathBuf,
    /// Its size in bytes.
    pub bytes: u64,
    /// The tensors in it, all F32.
    pub tensors: Vec<WrittenTensor>,
}

/// Tensors to be written: names, shapes, little-endian values.
type TensorsToWrite = Vec<(WrittenTensor, Vec<u8>)>;

/// Converts a torchvision backbone (`features.0.weight`, ...) and the heads of LPIPS v0.1 (`lin0.model.1.weight`, ...),
/// each a PyTorch or safetensors file in F32 or F16, to the safetensors file `out`: `net.conv{i}.weight`
/// `[output, input, k, k]`, `net.conv{i}.bias` `[output]` and `lin{0..4}.weight` `[1, C, 1, 1]`.
///
/// # Errors
/// If a file is unreadable or damaged, a tensor is missing, of another shape or not finite, the heads belong to the
/// other network, or `out` cannot be written or was not written by this program. Nothing is written then.
pub fn convert(backbone: &Path, heads: &Path, out: &Path) -> Result<ConvertedWeights, ConvertError> {
    check_file(out)?;
    if let Some(input) = same_file(out, [backbone, heads]) {
        return Err(ReplaceError::Needed { path: out.into(), inner: input.into() }.into());
    }
    let (convolutions, net) = open_backbone(backbone)?;
    let lins = open_heads(heads, net)?;
    let published = if net == LpipsNet::Alex { ALEX } else { VGG };

    let shapes = net.convolution_shapes();
    let values: u128 = shapes.clone().map(|s| product(&s)).sum();
    // the tensors and the file made of them, four bytes per value, and room for biases, heads and the one being read
    MemoryBudget::now().check(format!("--backbone {}", backbone.display()), values * 10)?;

    let mut all = TensorsToWrite::new();
    for (i, (shape, feature)) in shapes.zip(published.features).enumerate() {
        for (part, shape) in [("weight", &shape[..]), ("bias", &shape[..1])] {
            let key = format!("features.{feature}.{part}");
            all.push(take(&convolutions, backbone, &key, format!("net.conv{i}.{part}"), shape)?);
        }
    }
    let of_backbone = all.len();
    for (i, shape) in net.head_shapes().iter().enumerate() {
        all.push(take(&lins, heads, &head_key(i), format!("lin{i}.weight"), shape)?);
    }

    let backbone = input(backbone, of_backbone, published.backbone)?;
    let heads = input(heads, all.len() - of_backbone, published.heads)?;
    let bytes = save(out, &all, net)?;
    let tensors = all.into_iter().map(|(written, _)| written).collect();
    Ok(ConvertedWeights { network: net.to_string(), backbone, heads, file: out.into(), bytes, tensors })
}

/// Opens the file given with a flag. A damaged length in it may make the reader hold all of the file.
fn open(flag: &str, path: &Path) -> Result<StateDict, ConvertError> {
    let wrong = |source| ConvertError::Source { path: path.into(), source };
    let length = std::fs::metadata(path).map_err(|e| wrong(e.into()))?.len();
    MemoryBudget::now().check(format!("{flag} {}", path.display()), length.into())?;
    StateDict::open(path).map_err(wrong)
}

fn head_key(index: usize) -> String {
    format!("lin{index}.model.1.weight")
}

fn open_backbone(path: &Path) -> Result<(StateDict, LpipsNet), ConvertError> {
    let file = open("--backbone", path)?;
    let Some(found) = file.shape(FIRST) else {
        if file.shape(&head_key(0)).is_some() {
            return Err(ConvertError::HeadsAsBackbone { path: path.into() });
        }
        return Err(ConvertError::Source { path: path.into(), source: StateDictError::Missing(FIRST.into()) });
    };
    match LpipsNet::with_first_weights(found) {
        Some(net) => Ok((file, net)),
        None => Err(ConvertError::UnknownNet { path: path.into(), found: found.to_vec() }),
    }
}

/// Opens the heads of `net`; missing tensors or wrong shapes are detected when they are read.
fn open_heads(path: &Path, net: LpipsNet) -> Result<StateDict, ConvertError> {
    let file = open("--heads", path)?;
    if file.shape(&head_key(0)).is_none() && file.shape(FIRST).is_some() {
        return Err(ConvertError::BackboneAsHeads { path: path.into() });
    }
    let differs = |net: LpipsNet| (0..5).find(|i| file.shape(&head_key(*i)) != Some(&net.head_shapes()[*i]));
    if let Some(i) = differs(net)
        && let Some(found) = LpipsNet::ALL.into_iter().find(|n| differs(*n).is_none())
    {
        let (key, shape) = (head_key(i), found.head_shapes()[i].to_vec());
        return Err(ConvertError::OtherHeads { path: path.into(), found, net, key, shape });
    }
    Ok(file)
}

fn take(
    file: &StateDict,
    path: &Path,
    key: &str,
    name: String,
    shape: &[usize],
) -> Result<(WrittenTensor, Vec<u8>), ConvertError> {
    let values = file.values(key, shape).map_err(|source| ConvertError::Source { path: path.into(), source })?;
    let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    Ok((WrittenTensor { name, shape: shape.to_vec() }, bytes))
}

fn input(path: &Path, tensors: usize, published: &str) -> Result<InputFile, ConvertError> {
    let mut hash = Sha256::new();
    let read = File::open(path).and_then(|mut file| io::copy(&mut file, &mut hash));
    read.map_err(|e| ConvertError::Source { path: path.into(), source: e.into() })?;
    let sha256: String = hash.finalize().iter().take(4).map(|b| format!("{b:02x}")).collect();
    Ok(InputFile { file: path.into(), tensors, published: sha256 == published, sha256 })
}

/// Writes the file; the header entry marks it as written by this program.
fn save(out: &Path, all: &TensorsToWrite, net: LpipsNet) -> Result<u64, ConvertError> {
    let io = |source| TensorFileError::Io { path: out.into(), source };
    let mut views = Vec::new();
    for (written, bytes) in all {
        let view = TensorView::new(Dtype::F32, written.shape.clone(), bytes).map_err(|e| io(io::Error::other(e)))?;
        views.push((written.name.as_str(), view));
    }
    write(out, views, Some((MARK, format!("LPIPS v0.1 {net}"))))?;
    Ok(std::fs::metadata(out).map_err(io)?.len())
}
