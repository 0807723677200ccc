//! A layer of sines: `sin(omega (x + b))` of rows x with biases b, as in networks with periodic activations, in one
//! pass with its gradients. Fast kernel in [`cpu`], tensor operations on GPUs; the oracle is `f64::sin`.

pub mod cpu;
mod ops;

#[cfg(test)]
mod tests;

pub use ops::{SineBackwardOps, SineOps, SineTensors, sine};
