//! The decoder on a GPU: three products forward; backward, the first two again (hidden layers are not kept) and six
//! more. The heads' output layers are one product with a matrix that is zero outside its blocks.

use super::ops::{DecoderBackwardOps, DecoderOps, DecoderTensors};
use super::shape::DecoderShape;
use crate::cube::gemm::{Epilogue, column_sums, product, transposed};
use crate::cube::prelude::*;
use crate::cube::{UNITS, Words, arg, cubes, empty_f32, rows};
use burn::backend::ops::FloatTensorOps;

/// Returns the head of each output column.
fn head_of_columns(shape: &DecoderShape) -> Vec<u32> {
    shape.head_sizes.iter().enumerate().flat_map(|(head, size)| vec![head as u32; *size]).collect()
}

/// Spreads `w2` `[W, C]` to `[H * W, C]`, zero where a row's head is not the column's.
#[cube(launch)]
fn spread(w2: &[f32], heads: &[u32], out: &mut [f32], width: u32, columns: u32, total: u32) {
    if ABSOLUTE_POS < total as usize {
        let at = ABSOLUTE_POS as u32;
        let (row, column) = (at / columns, at % columns);
        let mut value = 0.0f32;
        if heads[column as usize] == row / width {
            value = w2[(row % width * columns + column) as usize];
        }
        out[at as usize] = value;
    }
}

/// Gathers the blocks of `wide` `[H * W, C]` into `[W, C]`.
#[cube(launch)]
fn gather(wide: &[f32], heads: &[u32], out: &mut [f32], width: u32, columns: u32, total: u32) {
    if ABSOLUTE_POS < total as usize {
        let at = ABSOLUTE_POS as u32;
        let (row, column) = (at / columns, at % columns);
        out[at as usize] = wide[((heads[column as usize] * width + row) * columns + column) as usize];
    }
}

/// Returns the tensors with features and each row's own numbers in one.
fn joined(tensors: DecoderTensors<CubeBackend>) -> [CubeTensor; 7] {
    let DecoderTensors { features, own, w0, b0, w1, b1, w2, b2 } = tensors;
    let x = match own.meta.shape()[1] {
        0 => features,
        _ => CubeBackend::float_cat(vec![features, own], 1),
    };
    [x, w0, b0, w1, b1, w2, b2]
}

/// Parts the gradient of what [`joined`] joined; `own` is what went in.
fn parted(x: CubeTensor, own: CubeTensor) -> (CubeTensor, CubeTensor) {
    let ([n, all], beside) = ([x.meta.shape()[0], x.meta.shape()[1]], own.meta.shape()[1]);
    if beside == 0 {
        return (x, own);
    }
    let part = |from: usize, to: usize| CubeBackend::float_slice(x.clone(), &[(0..n).into(), (from..to).into()]);
    (part(0, all - beside), part(all - beside, all))
}

/// The inputs and hidden layers of one call.
struct DecoderLayers {
    client: Client,
    n: usize,
    /// The inputs that are needed again after the hidden layers.
    x: Words,
    w0: Words,
    w1: Words,
    b2: Words,
    /// The output layer, spread to `[H * W, C]`.
    w2: Words,
    heads: Words,
    /// Activations `[N, W]` and `[N, H * W]`.
    trunk: Words,
    hidden: Words,
}

impl DecoderLayers {
    fn new(inputs: &[CubeTensor; 7], shape: &DecoderShape) -> Self {
        let client = inputs[0].client.clone();
        let n = inputs[0].meta.shape()[0];
        let (width, all, columns) = (shape.width, shape.b1_len(), shape.outputs());
        let [x, w0, b0, w1, b1, narrow, b2] = inputs.each_ref().map(Words::of);
        let heads = Words::u32s(&client, &head_of_columns(shape));
        let w2 = Words::empty(&client, all * columns);
        spread::launch(
            &client,
            cubes(all * columns, UNITS),
            CubeDim::new_1d(UNITS),
            narrow.arg(),
            heads.arg(),
            w2.arg(),
            width as u32,
            columns as u32,
            (all * columns) as u32,
        );
        let trunk = Words::empty(&client, n * width);
        product(&client, &x, (&w0, false), &b0, &trunk, [n, shape.inputs, width], Epilogue::BiasRelu);
        let hidden = Words::empty(&client, n * all);
        product(&client, &trunk, (&w1, false), &b1, &hidden, [n, width, all], Epilogue::BiasRelu);
        Self { client, n, x, w0, w1, b2, w2, heads, trunk, hidden }
    }
}

impl DecoderOps for CubeBackend {
    fn decoder_forward(inputs: DecoderTensors<Self>, shape: DecoderShape) -> FloatTensor<Self> {
        let inputs = joined(inputs).map(rows);
        let l = DecoderLayers::new(&inputs, &shape);
        let out = empty_f32(&inputs[0], [l.n, shape.outputs()]);
        let size = [l.n, shape.b1_len(), shape.outputs()];
        product(&l.client, &l.hidden, (&l.w2, false), &l.b2, &Words::of(&out), size, Epilogue::Bias);
        out
    }
}

impl DecoderBackwardOps for CubeBackend {
    fn decoder_backward(
        inputs: DecoderTensors<Self>,
        grad: FloatTensor<Self>,
        shape: DecoderShape,
    ) -> DecoderTensors<Self> {
        let own = inputs.own.clone();
        let inputs = joined(inputs).map(rows);
        let l = DecoderLayers::new(&inputs, &shape);
        let (n, f, width, all, columns) = (l.n, shape.inputs, shape.width, shape.b1_len(), shape.outputs());
        let client = &l.client;
        let grad = Words::of(&rows(grad));
        let out = inputs.each_ref().map(|t| empty_f32(t, t.meta.shape().clone()));
        let [gx, g0, h0, g1, h1, g2, h2] = &out;

        let wide = empty_f32(&inputs[0], [all, columns]);
        transposed(client, &l.hidden, &grad, &wide, [n, all, columns]);
        gather::launch(
            client,
            cubes(width * columns, UNITS),
            CubeDim::new_1d(UNITS),
            arg(&wide),
            l.heads.arg(),
            arg(g2),
            width as u32,
            columns as u32,
            (width * columns) as u32,
        );
        column_sums(client, &grad, h2, [n, columns]);

        let by_hidden = Words::empty(client, n * all);
        product(client, &grad, (&l.w2, true), &l.hidden, &by_hidden, [n, columns, all], Epilogue::Mask);
        transposed(client, &l.trunk, &by_hidden, g1, [n, width, all]);
        column_sums(client, &by_hidden, h1, [n, all]);

        let by_trunk = Words::empty(client, n * width);
        product(client, &by_hidden, (&l.w1, true), &l.trunk, &by_trunk, [n, all, width], Epilogue::Mask);
        transposed(client, &l.x, &by_trunk, g0, [n, f, width]);
        column_sums(client, &by_trunk, h0, [n, width]);
        product(client, &by_trunk, (&l.w0, true), &l.b2, &Words::of(gx), [n, width, f], Epilogue::Plain);

        let [x, w0, b0, w1, b1, w2, b2] = out;
        let (features, own) = parted(x, own);
        DecoderTensors { features, own, w0, b0, w1, b1, w2, b2 }
    }
}
