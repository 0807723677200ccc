//! Tensors in 8 and 16 bits, for scenes to archive or share: about a third of the bytes, and images that hardly differ.
//!
//! Per-Gaussian attributes are in fixed point, each component of an attribute (each harmonics coefficient) with its own
//! range: means in 16 bits, as an error of half a pixel would be visible, the others in 8. A tensor `NAME` of type U8
//! or U16 is accompanied by `NAME.range`, f32 `[2, C]`: the lowest value and the step of each of the C components, so
//! that a value is `lowest + step * q`. Everything else (the field, the decoder) is in half precision. Tensors with
//! values that neither form can hold stay f32.

use super::appearance::MATERIAL_NAME;
use super::params::HostTensor;
use half::f16;
use safetensors::tensor::{Dtype, SafeTensorError, TensorView};
use std::collections::BTreeMap;

/// Suffix of the name of the tensor that holds another one's ranges.
pub(super) const RANGE: &str = ".range";
/// A tensor as stored in the file.
#[derive(Debug)]
pub(super) struct StoredTensor {
    pub name: String,
    pub dtype: Dtype,
    pub shape: Vec<usize>,
    pub bytes: Vec<u8>,
}

impl StoredTensor {
    pub fn view(&self) -> Result<TensorView<'_>, SafeTensorError> {
        TensorView::new(self.dtype, self.shape.clone(), &self.bytes)
    }

    /// Stores a tensor unchanged.
    pub fn full(name: &str, tensor: &HostTensor) -> Self {
        let bytes = tensor.values.iter().flat_map(|v| v.to_le_bytes()).collect();
        Self { name: name.to_owned(), dtype: Dtype::F32, shape: tensor.shape.clone(), bytes }
    }

    fn half(name: &str, tensor: &HostTensor) -> Self {
        let bytes = tensor.values.iter().flat_map(|v| f16::from_f32(*v).to_le_bytes()).collect();
        Self { name: name.to_owned(), dtype: Dtype::F16, shape: tensor.shape.clone(), bytes }
    }
}

/// Packs the tensors of a scene into as few bits as image quality allows.
pub(super) fn pack(tensors: &BTreeMap<String, HostTensor>) -> Vec<StoredTensor> {
    let mut all = Vec::new();
    for (name, tensor) in tensors {
        let of_each = name.starts_with("gaussians.") && name != MATERIAL_NAME && !tensor.values.is_empty();
        let is_finite = tensor.values.iter().all(|v| v.is_finite());
        if is_finite && of_each {
            let (values, range) = fixed(name, tensor, if name == "gaussians.means" { 16 } else { 8 });
            all.extend([values, range]);
        } else if tensor.values.iter().all(|v| f16::from_f32(*v).is_finite()) {
            all.push(StoredTensor::half(name, tensor));
        } else {
            all.push(StoredTensor::full(name, tensor));
        }
    }
    all
}

/// A tensor in fixed point of `bits` bits, and its ranges.
fn fixed(name: &str, tensor: &HostTensor, bits: u32) -> (StoredTensor, StoredTensor) {
    let rows = tensor.shape.first().copied().unwrap_or(1).max(1);
    let columns = tensor.values.len() / rows;
    let column = |c: usize| tensor.values.iter().skip(c).step_by(columns).copied();
    let max_step = (1u32 << bits) - 1;
    let ranges: Vec<FixedPointRange> = (0..columns).map(|c| FixedPointRange::of(column(c), max_step)).collect();
    let steps = tensor.values.iter().enumerate().map(|(i, v)| ranges[i % columns].step_of(*v));
    let (dtype, bytes) = match bits {
        8 => (Dtype::U8, steps.map(|q| q as u8).collect()),
        _ => (Dtype::U16, steps.flat_map(|q| (q as u16).to_le_bytes()).collect()),
    };
    let values = StoredTensor { name: name.to_owned(), dtype, shape: tensor.shape.clone(), bytes };
    let numbers = ranges.iter().map(|r| r.lowest).chain(ranges.iter().map(|r| r.step)).collect();
    let range = HostTensor { shape: vec![2, columns], values: numbers };
    (values, StoredTensor::full(&format!("{name}{RANGE}"), &range))
}

/// The mapping from fixed-point steps to values.
#[derive(Clone, Copy, Debug, PartialEq)]
struct FixedPointRange {
    lowest: f32,
    step: f32,
    max_step: u32,
}

impl FixedPointRange {
    /// Spans the lowest to the highest value. Excluding outliers would make the steps of the others finer, but cost
    /// more than it gains: in squared error a value clipped by D weighs as much as rounding to steps of D / 255 does in
    /// 780,000 others.
    fn of(values: impl Iterator<Item = f32>, max_step: u32) -> Self {
        let ends = values.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        // divided first: the difference of two large numbers could overflow
        Self { lowest: ends.0, step: (ends.1 / max_step as f32) - (ends.0 / max_step as f32), max_step }
    }

    fn step_of(&self, value: f32) -> u32 {
        let place = if self.step > 0.0 { (value - self.lowest) / self.step } else { 0.0 };
        // a cast from float saturates
        (place.round() as u32).min(self.max_step)
    }
}

/// Decodes the values of a tensor of a file, by its ranges if it is in fixed point.
///
/// # Errors
/// What is wrong with it, or a type that this program never writes.
pub(super) fn unpack(view: &TensorView<'_>, range: Option<&TensorView<'_>>) -> Result<Vec<f32>, String> {
    let bytes = view.data();
    match view.dtype() {
        Dtype::F32 => Ok(floats(bytes)),
        Dtype::F16 => Ok(bytes.chunks_exact(2).map(|b| f16::from_le_bytes([b[0], b[1]]).to_f32()).collect()),
        Dtype::U8 => ranged(bytes.iter().map(|b| u32::from(*b)), view.shape(), range),
        Dtype::U16 => {
            let steps = bytes.chunks_exact(2).map(|b| u32::from(u16::from_le_bytes([b[0], b[1]])));
            ranged(steps, view.shape(), range)
        }
        other => Err(format!("is {other:?}, expected F32, or F16, U8 or U16 of a packed scene")),
    }
}

/// The value of step `q`.
fn value(lowest: f32, step: f32, q: u32) -> f32 {
    lowest + step * q as f32
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

fn ranged(
    steps: impl Iterator<Item = u32>,
    shape: &[usize],
    range: Option<&TensorView<'_>>,
) -> Result<Vec<f32>, String> {
    let columns: usize = shape.iter().skip(1).product();
    let Some(range) = range else {
        return Err(format!("is in fixed point, but its ranges, the tensor of its name with `{RANGE}`, are missing"));
    };
    if range.dtype() != Dtype::F32 || range.shape() != [2, columns] || columns == 0 {
        return Err(format!("has ranges of shape {:?}, expected [2, {columns}] of F32", range.shape()));
    }
    let numbers = floats(range.data());
    let (lowest, step) = numbers.split_at(columns);
    Ok(steps.enumerate().map(|(i, q)| value(lowest[i % columns], step[i % columns], q)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn tensor(shape: &[usize], values: Vec<f32>) -> HostTensor {
        HostTensor { shape: shape.to_vec(), values }
    }

    /// The type and values of one tensor after a round trip.
    fn there_and_back(name: &str, values: &HostTensor) -> (Dtype, Vec<f32>) {
        let packed = pack(&[(name.to_owned(), values.clone())].into());
        let views: Vec<TensorView<'_>> = packed.iter().map(|p| p.view().unwrap()).collect();
        let found = unpack(&views[0], views.get(1)).unwrap();
        (views[0].dtype(), found)
    }

    #[test]
    fn each_number_of_an_attribute_has_its_own_range() {
        // one column a thousandth the size of the other
        let values: Vec<f32> = (0..400).map(|i| (i as f32).sin() * if i % 2 == 0 { 1.0 } else { 1e-3 }).collect();
        let all = tensor(&[200, 2], values.clone());
        for (name, dtype, steps) in [("gaussians.means", Dtype::U16, 65_535.0), ("gaussians.sh", Dtype::U8, 255.0)] {
            let (found_type, found) = there_and_back(name, &all);
            assert_eq!(found_type, dtype);
            for (i, (a, b)) in found.iter().zip(&values).enumerate() {
                let size = if i % 2 == 0 { 2.0 } else { 2e-3 };
                assert!((a - b).abs() <= 0.51 * size / steps + 1e-7 * size, "{name} {i}: {a} {b}");
            }
        }
        let constant = tensor(&[3], vec![0.25; 3]);
        assert_eq!(there_and_back("gaussians.opacity_logits", &constant).1, constant.values);
    }

    #[test]
    fn outliers_are_kept() {
        let mut values = vec![0.0; 500];
        values[3] = 1.0;
        assert_eq!(there_and_back("gaussians.sh", &tensor(&[500, 1], values.clone())).1, values);
    }

    #[test]
    fn other_tensors_are_halved_and_values_that_do_not_fit_are_kept() {
        let field = tensor(&[3], vec![0.1, -2.5, 1e-3]);
        let (dtype, found) = there_and_back("field.encoder.planes", &field);
        assert!(dtype == Dtype::F16 && found.iter().zip(&field.values).all(|(a, b)| (a / b - 1.0).abs() < 5e-4));
        for huge in [1e6, f32::NAN] {
            let (dtype, found) = there_and_back("field.x", &tensor(&[1], vec![huge]));
            assert_eq!((dtype, found[0].to_bits()), (Dtype::F32, huge.to_bits()));
        }
        assert_eq!(there_and_back("gaussians.sh", &tensor(&[1], vec![f32::INFINITY])).0, Dtype::F32);
        assert_eq!(there_and_back(MATERIAL_NAME, &tensor(&[3], vec![0.5; 3])).0, Dtype::F16);
    }

    #[test]
    fn ranges_that_do_not_fit_are_refused() {
        let (bytes, numbers) = ([1u8; 6], [0u8; 16]);
        let view = TensorView::new(Dtype::U8, vec![3, 2], &bytes).unwrap();
        assert!(unpack(&view, None).unwrap_err().contains(".range"));
        let range = |dtype, shape: Vec<usize>, n: usize| {
            unpack(&view, Some(&TensorView::new(dtype, shape, &numbers[..n]).unwrap()))
        };
        assert!(range(Dtype::F32, vec![2, 1], 8).unwrap_err().contains("expected [2, 2]"));
        assert!(range(Dtype::F16, vec![2, 2], 8).is_err());
        assert_eq!(range(Dtype::F32, vec![2, 2], 16).unwrap(), vec![0.0; 6]);
        let other = TensorView::new(Dtype::I8, vec![6], &bytes).unwrap();
        assert!(unpack(&other, None).unwrap_err().contains("expected F32"));
    }

    proptest! {
        #[test]
        fn a_value_is_at_most_half_a_step_off(
            values in prop::collection::vec(-1e30f32..1e30, 1..300),
            max_step in prop::sample::select(vec![255u32, 65_535]),
        ) {
            let range = FixedPointRange::of(values.iter().copied(), max_step);
            prop_assert!(range.step.is_finite() && range.step >= 0.0);
            for v in values {
                let q = range.step_of(v);
                let off = (value(range.lowest, range.step, q) - v).abs();
                prop_assert!(q <= max_step && off <= 0.51 * range.step + 1e-5 * v.abs(), "{v} {range:?}");
            }
        }
    }
}
