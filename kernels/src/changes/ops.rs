//! The split as a differentiable op on tensors for every backend, with its implementation for those in host memory.

use super::{COLUMNS, WIDTHS};
use crate::backend::{CpuBackend, zeros};
use crate::tensors::recorded;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::{Device, FloatTensor};
use burn::backend::{Autodiff, Backend, Dispatch, ExtensionType, TensorMetadata, backend_extension};
use burn::tensor::{FloatDType, Tensor};
use rayon::prelude::*;
use std::sync::{Arc, Mutex, PoisonError};

/// Changes of each attribute on a backend, each `[N, width]`.
#[derive(Clone, Debug, ExtensionType)]
pub struct ChangeTensors<B: Backend> {
    /// Means, `[N, 3]`.
    pub means: FloatTensor<B>,
    /// Rotations, `[N, 4]`.
    pub rotations: FloatTensor<B>,
    /// Log-scales, `[N, 3]`.
    pub log_scales: FloatTensor<B>,
    /// Opacity logits, `[N, 1]`.
    pub opacity_logits: FloatTensor<B>,
}

impl<B: Backend> From<[FloatTensor<B>; 4]> for ChangeTensors<B> {
    fn from([means, rotations, log_scales, opacity_logits]: [FloatTensor<B>; 4]) -> Self {
        Self { means, rotations, log_scales, opacity_logits }
    }
}

/// The backend side of [`split_changes`].
#[backend_extension(Autodiff, NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Cube: cfg(feature = "cube"), LibTorch: cfg(feature = "tch"))]
pub trait ChangesOps: Backend {
    /// Splits `[N, 11]` by attribute.
    fn changes_split(changes: FloatTensor<Self>) -> ChangeTensors<Self>;
}

/// The backward side of [`split_changes`], for backends that compute. The autodiff backend does not implement it, so a
/// second derivative does not compile.
pub trait ChangesBackwardOps: Backend {
    /// Returns the gradient `[N, 11]` of which these are the attributes; those without one count as zero.
    fn changes_join(parts: [Option<FloatTensor<Self>>; 4], n: usize, device: &Device<Self>) -> FloatTensor<Self>;
}

/// Splits changes `[N, 11]` by attribute: means `[N, 3]`, rotations `[N, 4]`, log-scales `[N, 3]`, opacity logits
/// `[N, 1]`. Differentiable.
///
/// # Panics
/// If there are not 11 columns.
pub fn split_changes(changes: Tensor<2>) -> [Tensor<2>; 4] {
    assert_eq!(changes.dims()[1], COLUMNS, "split_changes: [N, 11]");
    let ChangeTensors { means, rotations, log_scales, opacity_logits } =
        Dispatch::changes_split(changes.into_dispatch());
    [means, rotations, log_scales, opacity_logits].map(Tensor::from_dispatch)
}

/// Rows per task.
const ROWS: usize = 8192;

impl<B: CpuBackend> ChangesOps for B {
    fn changes_split(changes: FloatTensor<Self>) -> ChangeTensors<Self> {
        let (n, device) = (changes.shape()[0], changes.device());
        let values = B::values(&changes);
        let mut parts = WIDTHS.map(|width| zeros(n * width));
        let [means, rotations, log_scales, opacity_logits] = &mut parts;
        let rows = means
            .par_chunks_mut(3 * ROWS)
            .zip(rotations.par_chunks_mut(4 * ROWS))
            .zip(log_scales.par_chunks_mut(3 * ROWS))
            .zip(opacity_logits.par_chunks_mut(ROWS))
            .zip(values.par_chunks(COLUMNS * ROWS));
        rows.for_each(|((((mean, rotation), scale), opacity), values)| {
            for (i, row) in values.chunks_exact(COLUMNS).enumerate() {
                mean[3 * i..][..3].copy_from_slice(&row[..3]);
                rotation[4 * i..][..4].copy_from_slice(&row[3..7]);
                scale[3 * i..][..3].copy_from_slice(&row[7..10]);
                opacity[i] = row[10];
            }
        });
        let mut widths = WIDTHS.into_iter();
        ChangeTensors::from(parts.map(|part| {
            let width = widths.next().unwrap_or_default();
            B::tensor(part, [n, width], &device)
        }))
    }
}

impl<B: CpuBackend> ChangesBackwardOps for B {
    fn changes_join(parts: [Option<FloatTensor<Self>>; 4], n: usize, device: &Device<Self>) -> FloatTensor<Self> {
        let mut out = zeros(n * COLUMNS);
        let parts = parts.each_ref().map(|part| part.as_ref().map(B::values));
        out.par_chunks_mut(COLUMNS * ROWS).enumerate().for_each(|(task, out)| {
            let mut column = 0;
            for (part, width) in parts.iter().zip(WIDTHS) {
                if let Some(part) = part {
                    let part = &part[task * ROWS * width..];
                    for (row, values) in out.chunks_exact_mut(COLUMNS).zip(part.chunks_exact(width)) {
                        row[column..column + width].copy_from_slice(values);
                    }
                }
                column += width;
            }
        });
        B::tensor(out, [n, COLUMNS], device)
    }
}

/// The GPU implementation, by operations of the backend: four slices forward, one concatenation backward.
#[cfg(feature = "cube")]
mod cube {
    use super::{ChangeTensors, ChangesBackwardOps, ChangesOps, Device, FloatDType, WIDTHS};
    use burn::backend::TensorMetadata;
    use burn::backend::ops::FloatTensorOps;
    use burn::backend::tensor::FloatTensor;
    use burn::tensor::Slice;
    use burn_cubecl::CubeBackend;

    impl ChangesOps for CubeBackend {
        fn changes_split(changes: FloatTensor<Self>) -> ChangeTensors<Self> {
            let n = changes.shape()[0];
            let mut column = 0;
            ChangeTensors::from(WIDTHS.map(|width| {
                column += width;
                let slices = [Slice::from(0..n), Slice::from(column - width..column)];
                Self::float_slice(changes.clone(), &slices)
            }))
        }
    }

    impl ChangesBackwardOps for CubeBackend {
        fn changes_join(parts: [Option<FloatTensor<Self>>; 4], n: usize, device: &Device<Self>) -> FloatTensor<Self> {
            let zeros = |width| Self::float_zeros([n, width].into(), device, FloatDType::F32);
            let parts = parts.into_iter().zip(WIDTHS).map(|(part, width)| part.unwrap_or_else(|| zeros(width)));
            Self::float_cat(parts.collect(), 1)
        }
    }
}

/// Gradients of the attributes that a backward pass has reached.
type Reached<B> = Arc<Mutex<[Option<FloatTensor<B>>; 4]>>;

/// An op has one output in the graph. So each attribute is the output of an op of its own, and they have one parent, a
/// number without meaning, whose backward pass comes after theirs: it joins the gradients that they leave.
impl<B: ChangesOps + ChangesBackwardOps, C: CheckpointStrategy> ChangesOps for Autodiff<B, C> {
    fn changes_split(changes: FloatTensor<Self>) -> ChangeTensors<Self> {
        let (changes, node) = changes.into_parts();
        let (n, device) = (changes.shape()[0], changes.device());
        let ChangeTensors { means, rotations, log_scales, opacity_logits } = B::changes_split(changes);
        let reached = Reached::<B>::default();
        let joined = recorded::<B, C, _, _>(
            [node],
            (reached.clone(), n, device.clone()),
            |_| B::float_zeros([1].into(), &device, FloatDType::F32),
            |(reached, n, device), _| {
                let parts = std::mem::take(&mut *reached.lock().unwrap_or_else(PoisonError::into_inner));
                [B::changes_join(parts, n, &device)]
            },
        );
        let mut count = 0..;
        ChangeTensors::from([means, rotations, log_scales, opacity_logits].map(|part| {
            let kept = (reached.clone(), count.next().unwrap_or_default());
            recorded::<B, C, _, _>(
                [joined.node()],
                kept,
                |_| part,
                |(reached, index): (Reached<B>, usize), grad| {
                    let number = B::float_zeros([1].into(), &grad.device(), FloatDType::F32);
                    reached.lock().unwrap_or_else(PoisonError::into_inner)[index] = Some(grad);
                    [number]
                },
            )
        }))
    }
}
