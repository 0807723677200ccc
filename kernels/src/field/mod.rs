//! Factorised 4D feature field: planes, lines and times sampled at points (paper: the T4 product).
//! Parameter layout lives in [`shape`], the fast kernels in [`cpu`], the oracle in [`mod@reference`].

mod backward;
pub mod cpu;
#[cfg(feature = "cube")]
mod cube;
mod ops;
pub mod reference;
mod sample;
pub mod shape;

#[cfg(test)]
mod tests;

pub use cpu::{FieldGrads, FieldParams, backward, forward};
pub use ops::{FieldGradients, FieldOps, field};
pub use shape::{FieldShape, FieldShapeError, LevelShape, TensorSpan};
