//! Tests of the primitives against the official code: the results of its Python functions `build_rotation_4d`,
//! `get_current_covariance_and_mean_offset`, `get_marginal_t` and `eval_shfs_4d`
//! (<https://github.com/fudan-zvg/4d-gaussian-splatting>, commit 63725f2) for two Gaussians, computed in f64.

use super::{ColourSeries, Gaussians4d, rotation_matrices};
use burn::module::Param;
use burn::tensor::{Device, Tensor, TensorData};
use volseggs_core::model::params::to_vec;
use volseggs_kernels::sh::{Bands, basis};

const TIME: f32 = 0.4;
const ROTATION: [f32; 16] = [
    0.696_932, -0.524_749, -0.450_956, -0.188_582, 0.557_546, 0.008_199, 0.828_119, 0.057_394, -0.008_199, -0.303_370,
    -0.057_394, 0.951_107, 0.450_956, 0.795_322, -0.327_968, 0.237_777,
];
const COVARIANCES: [f32; 12] = [
    0.068_356, 0.017_839, -0.057_544, 0.067_097, -0.009_448, 0.153_410, 0.081_507, -0.000_702, -0.019_958, 0.081_352,
    -0.095_953, 0.232_639,
];
const OFFSETS: [f32; 6] = [0.089_125, 0.062_762, 0.111_879, -0.186_690, -0.022_880, 0.538_471];
const MARGINALS: [f32; 2] = [0.817_639, 0.191_748];
const COLOURS: [f32; 6] = [0.044_375, 0.048_434, -0.084_686, 0.068_860, -0.087_339, 0.003_832];
/// View directions.
const DIRECTIONS: [[f32; 3]; 2] = [[0.48, -0.6, 0.64], [-0.36, 0.48, 0.8]];

fn close(what: &str, ours: &[f32], official: &[f32]) {
    assert_eq!(ours.len(), official.len());
    for (k, (a, b)) in ours.iter().zip(official).enumerate() {
        assert!((a - b).abs() < 2e-6, "{what}: value {k} is {a}, but {b} in the official code");
    }
}

fn numbers_are_those_of_the_official_code(device: Device) {
    fn param<const D: usize>(values: Vec<f32>, shape: [usize; D], device: &Device) -> Param<Tensor<D>> {
        Param::from_tensor(Tensor::from_data(TensorData::new(values, shape), device))
    }
    let sh = (0..2).flat_map(|i| (0..48).flat_map(move |k| (0..3).map(move |c| (i, k, c))));
    let sh = sh.map(|(i, k, c)| 0.1 * (1.0 + 0.7 * k as f32 + 2.0 * c as f32 + 3.0 * i as f32).sin());
    let of = Gaussians4d {
        means: param(vec![0.0; 6], [2, 3], &device),
        times: param(vec![0.25, 0.6], [2], &device),
        log_scales: param(vec![-1.0, -2.0, -1.5, -0.8, -0.5, -1.2, -2.5, -1.6], [2, 4], &device),
        left: param(vec![0.9, 0.2, -0.3, 0.5, -0.4, 1.1, 0.7, 0.1], [2, 4], &device),
        right: param(vec![0.3, -0.8, 0.4, 0.6, 1.2, 0.1, -0.2, 0.9], [2, 4], &device),
        opacity_logits: param(vec![0.0; 2], [2], &device),
        sh: param(sh.collect(), [2, 48, 3], &device),
    };
    close("rotation", &to_vec(rotation_matrices(of.left.val(), of.right.val()))[..16], &ROTATION);
    let at = of.at_time(TIME, ColourSeries { sh_stride: 16, time_degree: 2, duration: 0.9 });
    close("covariance", &to_vec(at.covariances), &COVARIANCES);
    close("mean", &to_vec(at.means), &OFFSETS);
    close("marginal", &to_vec(of.moment(TIME).log_marginals.exp()), &MARGINALS);
    let sh = to_vec(at.sh);
    let colour = |i: usize, c: usize| -> f32 {
        let values = basis(DIRECTIONS[i], 3, Bands::All);
        values.iter().enumerate().map(|(k, v)| v * sh[48 * i + 3 * k + c]).sum()
    };
    let colours: Vec<f32> = (0..6).map(|k| colour(k / 3, k % 3)).collect();
    close("colour", &colours, &COLOURS);
}

volseggs_testing::on_every_device!(crate::test_support::open_to_test => numbers_are_those_of_the_official_code);
