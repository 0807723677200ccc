//! Tests of edits: what the stack keeps, what the operations do, and which files are refused.

mod apply;
mod file;
mod properties;

use super::{Edit, EditStack, Operation};
use crate::model::HostGaussians;

/// Segments "a", "b" (disjoint), "ab" (both) and "none" (without Gaussians); the last two of the 10 are in none.
pub fn segments(name: &str) -> Option<&'static [u32]> {
    match name {
        "a" => Some(&[0, 1, 2, 3]),
        "b" => Some(&[4, 5, 6, 7]),
        "ab" => Some(&[0, 1, 2, 3, 4, 5, 6, 7]),
        "none" => Some(&[]),
        _ => None,
    }
}

/// 10 Gaussians of degree 3 that all differ.
pub fn state() -> HostGaussians {
    let wave = |n: usize, k: f32| (0..n).map(|i| ((i + 1) as f32 * k).sin()).collect::<Vec<_>>();
    HostGaussians {
        means: wave(30, 1.3),
        rotations: wave(40, 2.1),
        log_scales: wave(30, 0.7).iter().map(|v| v - 3.0).collect(),
        opacity_logits: wave(10, 1.9),
        sh: wave(480, 3.7),
        sh_stride: 16,
        ..HostGaussians::default()
    }
}

pub fn edit(segments: &[&str], operation: Operation) -> Edit {
    Edit { segments: segments.iter().map(|s| (*s).to_owned()).collect(), operation }
}

pub fn stack(edits: &[Edit]) -> EditStack {
    EditStack { operations: edits.to_vec(), ..EditStack::default() }
}

pub fn applied(edits: &[Edit]) -> HostGaussians {
    let mut state = state();
    super::apply(&stack(edits), &segments, &mut state).unwrap();
    state
}

pub fn arrays(s: &HostGaussians) -> Vec<&[f32]> {
    s.columns().map(|column| column.values).collect()
}

/// Returns the largest difference of any two values.
pub fn distance(a: &HostGaussians, b: &HostGaussians) -> f32 {
    let pairs = arrays(a).into_iter().zip(arrays(b)).flat_map(|(x, y)| x.iter().zip(y));
    pairs.map(|(x, y)| (x - y).abs()).fold(0.0, f32::max)
}

/// Returns the bits of everything about one Gaussian.
pub fn bits(s: &HostGaussians, i: usize) -> Vec<u32> {
    let n = s.len();
    arrays(s).iter().flat_map(|a| a[i * a.len() / n..(i + 1) * a.len() / n].iter().map(|v| v.to_bits())).collect()
}
