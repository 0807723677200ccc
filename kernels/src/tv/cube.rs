//! Total variation on a GPU: one unit per element, which reads its neighbours; sums in a fixed order.

use super::ops::{TvForward, TvOps};
use super::{TvKind, TvWeights};
use crate::cube::prelude::*;
use crate::cube::reduce::{over_cube, total};
use crate::cube::{UNITS, Words, arg, cubes, empty_f32, launched, rows};
use crate::field::{FieldShape, TensorSpan};

/// Computes the loss of each cube and the gradient of each element of one tensor `[height, width * R]` in the buffers.
#[cube(launch)]
fn span(
    data: &[f32],
    grad: &mut [f32],
    parts: &mut [f32],
    first_part: u32,
    offset: u32,
    height: u32,
    row: u32,
    channels: u32,
    slow: f32,
    fast: f32,
    prior: f32,
    #[comptime] second: bool,
) {
    let e = ABSOLUTE_POS as u32;
    let mut loss = 0.0f32;
    if e < height * row {
        let (y, x) = (e / row, e % row);
        let at = (offset + e) as usize;
        let pitch = row as usize;
        let cur = data[at];
        let over = cur - 1.0f32;
        let mut slope = select(over > 0.0f32, prior, -prior);
        if over == 0.0f32 {
            slope = 0.0f32;
        }
        loss = f32::abs(over) * prior;
        // a missing neighbour is replaced by the element itself
        let mut up = cur;
        let mut down = cur;
        if y > 0u32 {
            up = data[at - pitch];
        }
        if y + 1u32 < height {
            down = data[at + pitch];
        }
        if comptime!(second) {
            let mut above = 0.0f32;
            let mut here = 0.0f32;
            let mut below = 0.0f32;
            if y >= 2u32 {
                above = (data[at - 2 * pitch] - up) - (up - cur);
            }
            if y >= 1u32 && y + 1u32 < height {
                here = (up - cur) - (cur - down);
            }
            if y + 2u32 < height {
                below = (cur - down) - (down - data[at + 2 * pitch]);
            }
            loss += slow * (here * here);
            grad[at] = 2.0f32 * slow * (above - 2.0f32 * here + below) + slope;
        } else {
            let mut left = cur;
            let mut right = cur;
            if x >= channels {
                left = data[at - channels as usize];
            }
            if x + channels < row {
                right = data[at + channels as usize];
            }
            let (below, beside) = (down - cur, right - cur);
            loss += slow * (below * below) + fast * (beside * beside);
            grad[at] = 2.0f32 * slow * ((cur - up) - below) + 2.0f32 * fast * ((cur - left) - beside) + slope;
        }
    }
    let loss = over_cube(loss);
    if UNIT_POS == 0u32 {
        parts[first_part as usize + CUBE_POS] = loss;
    }
}

impl TvOps for CubeBackend {
    fn tv_forward(
        planes: FloatTensor<Self>,
        lines: FloatTensor<Self>,
        times: FloatTensor<Self>,
        shape: FieldShape,
        kind: TvKind,
        weights: TvWeights,
    ) -> TvForward<Self> {
        let inputs = [planes, lines, times].map(rows);
        let client = inputs[0].client.clone();
        let grads = inputs.each_ref().map(|t| empty_f32(t, t.meta.shape().clone()));
        let channels = shape.channels;
        let spans = [shape.plane_spans(), shape.line_spans(), shape.time_spans()];
        let size = |s: &TensorSpan| cubes(s.height * s.width * channels, UNITS);
        let parts = Words::empty(&client, spans.iter().flatten().map(|s| launched(&size(s))).sum());
        let mut first = 0;
        for (k, (of_kind, terms)) in spans.iter().zip(weights.terms(kind)).enumerate() {
            let (data, grad): (&CubeTensor, &CubeTensor) = (&inputs[k], &grads[k]);
            for s in of_kind {
                let factors = terms.factors(s, channels);
                let count = size(s);
                let used = launched(&count);
                span::launch(
                    &client,
                    count,
                    CubeDim::new_1d(UNITS),
                    arg(data),
                    arg(grad),
                    parts.arg(),
                    first as u32,
                    s.offset as u32,
                    s.height as u32,
                    (s.width * channels) as u32,
                    channels as u32,
                    factors.slow,
                    factors.fast,
                    factors.prior,
                    kind == TvKind::Second,
                );
                first += used;
            }
        }
        let value = empty_f32(&inputs[0], [1]);
        total(&client, &parts, &value, 1.0);
        let [planes, lines, times] = grads;
        TvForward { value, planes, lines, times }
    }
}
