//! The decoder as plain f64 loops: the oracle of the fast kernels, gradient included.
//! Written for reading, not for speed.

use super::shape::DecoderShape;

/// The parameters in f64.
pub type DecoderParamsF64<'a> = super::DecoderParams<'a, f64>;

/// Gradients of [`forward`], each as long as the buffer it belongs to.
#[derive(Clone, Debug)]
pub struct DecoderGradsF64 {
    /// Gradient of the trunk weights.
    pub w0: Vec<f64>,
    /// Gradient of the trunk bias.
    pub b0: Vec<f64>,
    /// Gradient of the head weights.
    pub w1: Vec<f64>,
    /// Gradient of the head biases.
    pub b1: Vec<f64>,
    /// Gradient of the output weights.
    pub w2: Vec<f64>,
    /// Gradient of the output bias.
    pub b2: Vec<f64>,
    /// Gradient of the inputs `[N, F]`.
    pub x: Vec<f64>,
}

/// `a W + b` of one row, `W` `[a.len(), b.len()]`.
fn affine(a: &[f64], weights: &[f64], bias: &[f64]) -> Vec<f64> {
    let mut out = bias.to_vec();
    for (a, row) in a.iter().zip(weights.chunks_exact(bias.len())) {
        for (out, weight) in out.iter_mut().zip(row) {
            *out += a * weight;
        }
    }
    out
}

fn relu(values: &[f64]) -> Vec<f64> {
    values.iter().map(|v| v.max(0.0)).collect()
}

/// Layers of one row before their clamps: trunk `[W]` and all heads `[H * W]`.
fn layers(params: DecoderParamsF64<'_>, x: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let trunk = affine(x, params.w0, params.b0);
    let heads = affine(&relu(&trunk), params.w1, params.b1);
    (trunk, heads)
}

/// Returns the smallest distance of a hidden unit from the kink of its clamp, over all rows of `x` `[N, F]`.
pub fn kink_distance(shape: &DecoderShape, params: DecoderParamsF64<'_>, x: &[f64]) -> f64 {
    let rows = x.chunks_exact(shape.inputs).map(|x| layers(params, x));
    rows.flat_map(|(trunk, heads)| [trunk, heads].concat()).fold(f64::INFINITY, |least, v| least.min(v.abs()))
}

/// Returns the outputs `[N, C]` of `x` `[N, F]`.
pub fn forward(shape: &DecoderShape, params: DecoderParamsF64<'_>, x: &[f64]) -> Vec<f64> {
    let (w, c) = (shape.width, shape.outputs());
    let mut out = Vec::new();
    for x in x.chunks_exact(shape.inputs) {
        let heads = relu(&layers(params, x).1);
        for (k, (first, size)) in shape.head_columns().enumerate() {
            for column in first..first + size {
                let unit = |j: usize| heads[k * w + j] * params.w2[j * c + column];
                out.push(params.b2[column] + (0..w).map(unit).sum::<f64>());
            }
        }
    }
    out
}

/// Returns the gradients of [`forward`] for `grad_out` `[N, C]`.
pub fn backward(shape: &DecoderShape, params: DecoderParamsF64<'_>, x: &[f64], grad_out: &[f64]) -> DecoderGradsF64 {
    let (f, w, c) = (shape.inputs, shape.width, shape.outputs());
    let all = w * shape.heads();
    let mut grads = DecoderGradsF64 {
        w0: vec![0.0; params.w0.len()],
        b0: vec![0.0; params.b0.len()],
        w1: vec![0.0; params.w1.len()],
        b1: vec![0.0; params.b1.len()],
        w2: vec![0.0; params.w2.len()],
        b2: vec![0.0; params.b2.len()],
        x: Vec::new(),
    };
    for (x, g) in x.chunks_exact(f).zip(grad_out.chunks_exact(c)) {
        let (trunk, heads) = layers(params, x);
        let mut grad_heads = vec![0.0; all];
        for (k, (first, size)) in shape.head_columns().enumerate() {
            for column in first..first + size {
                grads.b2[column] += g[column];
                for j in 0..w {
                    let unit = heads[k * w + j];
                    if unit > 0.0 {
                        grads.w2[j * c + column] += g[column] * unit;
                        grad_heads[k * w + j] += g[column] * params.w2[j * c + column];
                    }
                }
            }
        }
        let mut grad_trunk = vec![0.0; w];
        for (i, &unit) in trunk.iter().enumerate() {
            for (j, &grad) in grad_heads.iter().enumerate() {
                if unit > 0.0 {
                    grads.w1[i * all + j] += unit * grad;
                    grad_trunk[i] += params.w1[i * all + j] * grad;
                }
            }
        }
        for (sum, grad) in grads.b1.iter_mut().zip(&grad_heads) {
            *sum += grad;
        }
        for (sum, grad) in grads.b0.iter_mut().zip(&grad_trunk) {
            *sum += grad;
        }
        for (i, &x) in x.iter().enumerate() {
            let mut grad_x = 0.0;
            for (j, &grad) in grad_trunk.iter().enumerate() {
                grads.w0[i * w + j] += x * grad;
                grad_x += params.w0[i * w + j] * grad;
            }
            grads.x.push(grad_x);
        }
    }
    grads
}
