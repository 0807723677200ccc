//! Planes, lines and time vectors: they map a position and a time to features.

use crate::layers::{parameter, pytorch_bound, uniform};
use burn::module::{Module, Param};
use burn::tensor::{Device, Int, Tensor, TensorData};
use volseggs_base::rng::Rng;
use volseggs_kernels::field::{FieldShape, LevelShape, field};

/// Initial standard deviation of planes and lines around 0, and initial value of time vectors.
const START: f32 = 0.1;

/// The grid of density or of appearance.
///
/// ```text
/// f(x, t) = W (sum_k M_k(x) o v_k(x), v(t))        k over xy z, xz y, yz x
/// ```
///
/// The time vector is concatenated with the products of planes and lines, whereas VolSegGS multiplies it.
#[derive(Module, Debug)]
pub struct FactorisedGrid {
    /// Planes, flattened as described by [`FieldShape`].
    pub planes: Param<Tensor<1>>,
    /// Lines, likewise.
    pub lines: Param<Tensor<1>>,
    /// `[knots, time_ranks]`: the values of each training time.
    pub times: Param<Tensor<2>>,
    /// `[ranks + time_ranks, features]`: W.
    pub basis: Param<Tensor<2>>,
    #[module(skip)]
    shape: FieldShape,
}

/// Sizes of a grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GridSize {
    /// Nodes along each axis.
    pub resolution: [usize; 3],
    /// Planes and lines per orientation.
    pub ranks: usize,
    /// Number of training times.
    pub knots: usize,
    /// Number of values per training time.
    pub time_ranks: usize,
    /// Number of features.
    pub features: usize,
}

/// The times of a batch, and the time of each point.
#[derive(Clone, Debug)]
pub struct BatchTimes {
    /// `[T, knots]`: each time as a mixture of training times.
    pub mixtures: Tensor<2>,
    /// `[N]`: the time of each point.
    pub of_points: Tensor<1, Int>,
}

impl GridSize {
    /// The layout of its planes and lines in memory.
    pub fn shape(&self) -> FieldShape {
        let levels = vec![LevelShape { resolution: self.resolution }];
        FieldShape { levels, time_knots: 1, channels: self.ranks }
    }

    /// Number of values in the grid; saturates.
    pub fn parameters(&self) -> u128 {
        let [x, y, z] = self.resolution.map(|n| n as u128);
        let of = |a: u128, b: u128| a.saturating_mul(b);
        let nodes = of(x, y).saturating_add(of(x, z)).saturating_add(of(y, z)).saturating_add(x + y + z);
        let vectors = of(self.knots as u128, self.time_ranks as u128);
        let basis = of(self.ranks as u128 + self.time_ranks as u128, self.features as u128);
        of(nodes, self.ranks as u128).saturating_add(vectors).saturating_add(basis)
    }
}

/// The time at fraction `part` of the way from the first of `knots` times to the last, as a mixture of them: linear
/// between neighbours.
pub fn mixture(knots: usize, part: f64) -> Vec<f32> {
    let mut out = vec![0.0; knots];
    let [low, high] = neighbours(knots, part);
    let fraction = part.clamp(0.0, 1.0) * (knots - 1) as f64 - low as f64;
    out[low] += 1.0 - fraction as f32;
    out[high] += fraction as f32;
    out
}

/// The times on either side of it.
pub fn neighbours(knots: usize, part: f64) -> [usize; 2] {
    let place = part.clamp(0.0, 1.0) * (knots - 1) as f64;
    let low = (place as usize).min(knots.saturating_sub(2));
    [low, (low + 1).min(knots - 1)]
}

impl FactorisedGrid {
    /// A grid with random planes and lines.
    pub fn new(size: &GridSize, rng: &mut Rng, device: &Device) -> Self {
        let shape = size.shape();
        let mut normal = |len: usize| parameter((0..len).map(|_| START * rng.normal()).collect(), [len], device);
        let (planes, lines) = (normal(shape.planes_len()), normal(shape.lines_len()));
        let inputs = size.ranks + size.time_ranks;
        let basis = uniform(rng, inputs * size.features, pytorch_bound(inputs));
        Self {
            planes,
            lines,
            times: parameter(vec![START; size.knots * size.time_ranks], [size.knots, size.time_ranks], device),
            basis: parameter(basis, [inputs, size.features], device),
            shape,
        }
    }

    /// Features `[N, features]` of points `[N, 3]` in [-1, 1].
    pub fn forward(&self, points: Tensor<2>, times: &BatchTimes) -> Tensor<2> {
        let device = points.device();
        let ones = Tensor::ones([self.shape.times_len()], &device);
        let products = field(self.planes.val(), self.lines.val(), ones, points, &self.shape, 0.0);
        let [inputs, features] = self.basis.dims();
        let ranks = self.shape.channels;
        let basis = self.basis.val();
        let of_times = times.mixtures.clone().matmul(self.times.val());
        let of_times = of_times.matmul(basis.clone().slice([ranks..inputs, 0..features]));
        products.matmul(basis.slice([0..ranks, 0..features])) + of_times.select(0, times.of_points.clone())
    }

    /// Sizes and layout of planes and lines.
    pub fn shape(&self) -> &FieldShape {
        &self.shape
    }
}

impl BatchTimes {
    /// Mixtures `[T][knots]`, and the time of each point, on a device.
    pub fn new(mixtures: &[Vec<f32>], of_points: &[i32], device: &Device) -> Self {
        let knots = mixtures.first().map_or(0, Vec::len);
        let mixtures = TensorData::new(mixtures.concat(), [mixtures.len(), knots]);
        let of_points = TensorData::new(of_points.to_vec(), [of_points.len()]);
        Self { mixtures: Tensor::from_data(mixtures, device), of_points: Tensor::from_data(of_points, device) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::device;
    use volseggs_base::rng::Purpose;
    use volseggs_core::model::params::{self, to_vec};

    #[test]
    fn times_between_training_times_are_mixed() {
        assert_eq!(mixture(5, 0.25), [0.0, 1.0, 0.0, 0.0, 0.0]);
        assert_eq!(mixture(3, 0.375), [0.25, 0.75, 0.0]);
        assert_eq!((mixture(3, 1.0), mixture(3, 7.0), mixture(3, -1.0)), {
            (vec![0.0, 0.0, 1.0], vec![0.0, 0.0, 1.0], vec![1.0, 0.0, 0.0])
        });
        assert_eq!(mixture(1, 0.4), [1.0]);
        assert_eq!((neighbours(5, 0.6), neighbours(5, 1.0), neighbours(1, 1.0)), ([2, 3], [3, 4], [0, 0]));
    }

    #[test]
    fn features_are_their_formula() {
        let size = GridSize { resolution: [3, 4, 5], ranks: 2, knots: 3, time_ranks: 2, features: 3 };
        let grid = FactorisedGrid::new(&size, &mut Rng::new(1, 0, Purpose::Custom(0)), &device());
        let held: usize = params::sizes(&grid).values().sum();
        assert_eq!(size.parameters(), held as u128);
        let [planes, lines] = [&grid.planes, &grid.lines].map(|p| to_vec(p.val()));
        let [times, basis] = [&grid.times, &grid.basis].map(|p| to_vec(p.val()));
        assert!(times.iter().all(|v| *v == START));
        // a position halfway between nodes, so that interpolation is a mean of four and of two
        let (x, y, z) = (0.5f64, 1.0 / 3.0, -0.25);
        let products: Vec<f64> = (0..2)
            .map(|r| {
                let plane = |offset: usize, width: usize, fast: [usize; 2], slow: [usize; 2]| -> f64 {
                    let at = |s: usize, f: usize| f64::from(planes[offset + (s * width + f) * 2 + r]);
                    0.25 * slow
                        .iter()
                        .flat_map(|s| fast.iter().map(move |f| (*s, *f)))
                        .map(|(s, f)| at(s, f))
                        .sum::<f64>()
                };
                let line = |offset: usize, nodes: [usize; 2]| {
                    nodes.iter().map(|i| 0.5 * f64::from(lines[offset + i * 2 + r])).sum::<f64>()
                };
                // x = 0.5 of 3 nodes lies at 1.5; y = 1/3 of 4 at 2, computed as half of 2 and 2; z = -0.25 of 5 at 1.5
                let (nx, ny, nz) = ([1, 2], [2, 2], [1, 2]);
                let (xy, xz, yz) = (plane(0, 3, nx, ny), plane(24, 3, nx, nz), plane(54, 4, ny, nz));
                xy * line(14, nz) + xz * line(6, ny) + yz * line(0, nx)
            })
            .collect();
        let device = device();
        let points = Tensor::<2>::from_floats([[x as f32, y as f32, z as f32]], &device);
        let found = to_vec(grid.forward(points, &BatchTimes::new(&[mixture(3, 0.25)], &[0], &device)));
        for c in 0..3 {
            let row = |k: usize| f64::from(basis[3 * k + c]);
            let expected = products[0] * row(0) + products[1] * row(1) + f64::from(START) * (row(2) + row(3));
            assert!((f64::from(found[c]) - expected).abs() < 1e-6, "{c}: {} for {expected}", found[c]);
        }
    }
}
