//! A loss term: the rendered image should change from pixel to pixel as the true one does.

use volseggs::burn::tensor::Tensor;
use volseggs::extend::{LossInput, LossTerm};

/// Mean squared difference of the colours' gradients along rows and columns.
pub struct Edges;

impl LossTerm for Edges {
    fn loss(&self, seen: &LossInput<'_>) -> Tensor<1> {
        // a gradient is linear, so the difference of two is the gradient of the difference
        let error = seen.image.clone() - seen.target.clone();
        let [h, w, _] = error.dims();
        let part = |y: [usize; 2], x: [usize; 2]| error.clone().slice([y[0]..y[1], x[0]..x[1], 0..3]);
        let across = part([0, h], [1, w]) - part([0, h], [0, w - 1]);
        let down = part([1, h], [0, w]) - part([0, h - 1], [0, w]);
        across.powi_scalar(2).mean() + down.powi_scalar(2).mean()
    }
}
