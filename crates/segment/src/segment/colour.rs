//! One view-independent colour per Gaussian, and conversion between RGB and CIE Lab. Colours are named and clustered
//! elsewhere.

use crate::model::sh;
use crate::points::chunks::map_chunks;
use crate::points::error::{PointsError, rows};
pub use crate::points::sampling::fibonacci_sphere;
use volseggs_kernels::sh::Bands;

/// `sqrt((2l + 1) / 4 pi)`: the factor by which the Euclidean norm of one band's coefficients bounds the band's value
/// in any direction.
const BAND_BOUND: [f32; 5] = [sh::C0, sh::C1, 0.630_783_1, 0.746_352_7, 0.846_284_4];

/// Returns the colour of the constant coefficient alone, `max(0, 0.5 + 0.2820948 dc)`, `[N, 3]`.
///
/// This is the mean over all directions if the clamp at zero has no effect in any of them.
///
/// # Errors
/// `coefficients` not 1, 4, 9 or 16, nor 6 or 15 as of even bands, or `sh` not a whole number of `[coefficients, 3]` blocks.
pub fn constant_colour(sh: &[f32], coefficients: usize) -> Result<Vec<f32>, PointsError> {
    let count = check(sh, coefficients)?;
    Ok((0..3 * count).map(|i| clamp(0.5 + sh::C0 * sh[i / 3 * coefficients * 3 + i % 3])).collect())
}

/// Returns the mean colour over `directions` (unit vectors), clamp included:
/// `mean over d of max(0, 0.5 + sum_k Y_k(d) sh_k)`, `[N, 3]`; never negative, and above 1 where the model is.
///
/// `sh` is `[N, coefficients, 3]`. Where the clamp cannot take effect in any direction (the norm of each band's
/// coefficients bounds that band), the mean is linear in the coefficients and is computed exactly in one step. Without
/// directions the result is [`constant_colour`]. A channel with a non-finite coefficient is NaN, which clustering then
/// ignores.
///
/// # Errors
/// As [`constant_colour`].
pub fn mean_colour(sh: &[f32], coefficients: usize, directions: &[[f32; 3]]) -> Result<Vec<f32>, PointsError> {
    if directions.is_empty() {
        return constant_colour(sh, coefficients);
    }
    let count = check(sh, coefficients)?;
    let each: Vec<[f32; 16]> = directions.iter().map(|&d| sh::basis_of(coefficients, d)).collect();
    let bases: Vec<Vec<f32>> = (0..16).map(|k| each.iter().map(|b| b[k]).collect()).collect();
    let mut mean_basis = [0f32; 16];
    for k in 0..16 {
        mean_basis[k] = (bases[k].iter().map(|&y| f64::from(y)).sum::<f64>() / directions.len() as f64) as f32;
    }
    let chunks = map_chunks(count, |range| {
        let mut out = Vec::with_capacity(3 * range.len());
        let mut values = vec![0f32; directions.len()];
        for i in range {
            let block = &sh[i * coefficients * 3..(i + 1) * coefficients * 3];
            for channel in 0..3 {
                let mut c = [0f32; 16];
                for k in 0..coefficients {
                    c[k] = block[3 * k + channel];
                }
                out.push(mean_channel(&c[..coefficients], &bases, &mean_basis, &mut values));
            }
        }
        out
    });
    Ok(chunks.concat())
}

/// Returns the mean of one channel; `c` holds its coefficients, `bases` the basis functions `[16][directions]`, and
/// `values` is room for one value per direction.
fn mean_channel(c: &[f32], bases: &[Vec<f32>], mean_basis: &[f32; 16], values: &mut [f32]) -> f32 {
    if c.iter().any(|v| !v.is_finite()) {
        return f32::NAN;
    }
    let (constant, bound) = (0.5 + sh::C0 * c[0], band_bound(c));
    if constant + bound <= 0.0 {
        return 0.0;
    }
    if constant >= bound {
        return 0.5 + c.iter().zip(mean_basis).map(|(c, m)| c * m).sum::<f32>();
    }
    values.fill(0.5);
    for (c, basis) in c.iter().zip(bases) {
        values.iter_mut().zip(basis).for_each(|(v, y)| *v += c * y);
    }
    let sum: f64 = values.iter().map(|v| f64::from(v.max(0.0))).sum();
    (sum / values.len() as f64) as f32
}

/// Returns a bound on what the bands above the constant one can add or subtract in any direction (Cauchy-Schwarz and
/// the addition theorem).
fn band_bound(c: &[f32]) -> f32 {
    let (mut bound, mut start) = (0.0, 1);
    for degree in sh::degrees(c.len()) {
        let Some(band) = c.get(start..start + 2 * degree + 1) else { break };
        bound += BAND_BOUND[degree] * band.iter().map(|v| v * v).sum::<f32>().sqrt();
        start += 2 * degree + 1;
    }
    bound
}

fn clamp(value: f32) -> f32 {
    if value.is_finite() { value.max(0.0) } else { f32::NAN }
}

/// Returns the number N of Gaussians with these coefficients `[N, K, 3]`.
///
/// # Errors
/// If no degree has K coefficients, or `sh` is not a whole number of blocks.
pub(super) fn check(sh: &[f32], coefficients: usize) -> Result<usize, PointsError> {
    if Bands::from_count(coefficients).is_none() {
        let value = coefficients.to_string();
        return Err(PointsError::Setting { field: "coefficients", value, want: "1, 4, 9 or 16, or 6 or 15" });
    }
    rows("sh", sh.len(), coefficients * 3, "[N, K, 3]")
}

/// D65 white point in XYZ, two-degree observer.
const WHITE: [f64; 3] = [0.950_47, 1.0, 1.088_83];

/// Converts one sRGB colour in `[0, 1]`, the gamma-encoded values stored in images, to CIE Lab (D65; L 0..100).
pub fn rgb_to_lab(rgb: [f32; 3]) -> [f32; 3] {
    let [r, g, b] = rgb.map(|v| {
        let v = f64::from(v);
        if v <= 0.040_45 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
    });
    let xyz = [
        0.412_456_4 * r + 0.357_576_1 * g + 0.180_437_5 * b,
        0.212_672_9 * r + 0.715_152_2 * g + 0.072_175_0 * b,
        0.019_333_9 * r + 0.119_192_0 * g + 0.950_304_1 * b,
    ];
    let mut f = [0.0; 3];
    for i in 0..3 {
        let t = xyz[i] / WHITE[i];
        f[i] = if t > (6.0f64 / 29.0).powi(3) { t.cbrt() } else { t * (29.0f64 / 6.0).powi(2) / 3.0 + 4.0 / 29.0 };
    }
    [(116.0 * f[1] - 16.0) as f32, (500.0 * (f[0] - f[1])) as f32, (200.0 * (f[1] - f[2])) as f32]
}

/// Converts one CIE Lab colour (D65) to sRGB. Colours outside the gamut are below 0 or above 1: clamp before display.
pub fn lab_to_rgb(lab: [f32; 3]) -> [f32; 3] {
    let [l, a, b] = lab.map(f64::from);
    let y = (l + 16.0) / 116.0;
    let f = [y + a / 500.0, y, y - b / 200.0];
    let mut xyz = [0.0; 3];
    for i in 0..3 {
        let linear = 3.0 * (6.0f64 / 29.0).powi(2) * (f[i] - 4.0 / 29.0);
        xyz[i] = WHITE[i] * if f[i] > 6.0 / 29.0 { f[i].powi(3) } else { linear };
    }
    [
        3.240_454_2 * xyz[0] - 1.537_138_5 * xyz[1] - 0.498_531_4 * xyz[2],
        -0.969_266_0 * xyz[0] + 1.876_010_8 * xyz[1] + 0.041_556_0 * xyz[2],
        0.055_643_4 * xyz[0] - 0.204_025_9 * xyz[1] + 1.057_225_2 * xyz[2],
    ]
    .map(|v| (if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }) as f32)
}

/// Applies [`rgb_to_lab`] to every row of `[N, 3]`; an incomplete last row is skipped.
pub fn rgb_to_lab_all(colours: &[f32]) -> Vec<f32> {
    let count = colours.len() / 3;
    map_chunks(count, |range| {
        range.flat_map(|i| rgb_to_lab([colours[3 * i], colours[3 * i + 1], colours[3 * i + 2]])).collect::<Vec<f32>>()
    })
    .concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use volseggs_testing::generator;

    #[test]
    fn directions_are_unit_and_balanced() {
        let sphere = fibonacci_sphere(512);
        let mut sum = [0f64; 3];
        for d in &sphere {
            assert!((d.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-5);
            (0..3).for_each(|a| sum[a] += f64::from(d[a]));
        }
        assert!(sum.iter().all(|s| (s / 512.0).abs() < 1e-3), "{sum:?}");
        assert!(fibonacci_sphere(0).is_empty());
    }

    #[test]
    fn basis_is_orthonormal() {
        let sphere = fibonacci_sphere(20_000);
        for j in 0..16 {
            for k in 0..=j {
                let mean: f64 = sphere
                    .iter()
                    .map(|&d| {
                        let b = sh::basis(d);
                        f64::from(b[j]) * f64::from(b[k])
                    })
                    .sum::<f64>()
                    / 20_000.0;
                let want = if j == k { 1.0 } else { 0.0 };
                assert!((mean * 4.0 * std::f64::consts::PI - want).abs() < 2e-3, "{j} {k} {mean}");
            }
        }
    }

    fn by_hand(sh: &[f32], k: usize, directions: &[[f32; 3]]) -> Vec<f32> {
        let mut out = vec![0.0; sh.len() / k];
        for i in 0..sh.len() / k / 3 {
            for c in 0..3 {
                let total: f64 = directions
                    .iter()
                    .map(|&d| {
                        let basis = sh::basis_of(k, d);
                        let v: f64 =
                            0.5 + (0..k).map(|j| f64::from(basis[j]) * f64::from(sh[(i * k + j) * 3 + c])).sum::<f64>();
                        v.max(0.0)
                    })
                    .sum();
                out[i * 3 + c] = (total / directions.len() as f64) as f32;
            }
        }
        out
    }

    #[test]
    fn mean_equals_the_sum_over_directions_with_and_without_the_clamp() {
        let mut u = generator(5);
        let directions = fibonacci_sphere(400);
        for k in [1, 4, 9, 16, 6, 15] {
            for scale in [0.1, 1.0, 5.0] {
                let sh: Vec<f32> = (0..40 * k * 3).map(|_| (u() - 0.5) * scale).collect();
                let got = mean_colour(&sh, k, &directions).unwrap();
                for (g, w) in got.iter().zip(by_hand(&sh, k, &directions)) {
                    assert!((g - w).abs() < 1e-5 * scale.max(1.0), "{k} {scale}: {g} {w}");
                }
            }
        }
    }

    #[test]
    fn unclamped_mean_over_the_sphere_is_the_constant_colour() {
        let mut u = generator(6);
        let sh: Vec<f32> = (0..100 * 48).map(|i| if i % 48 < 3 { u() - 0.3 } else { (u() - 0.5) * 0.08 }).collect();
        let mean = mean_colour(&sh, 16, &fibonacci_sphere(2000)).unwrap();
        let constant = constant_colour(&sh, 16).unwrap();
        for (m, c) in mean.iter().zip(&constant) {
            assert!((m - c).abs() < 1e-4, "{m} {c}");
        }
        assert_eq!(mean_colour(&sh, 16, &[]).unwrap(), constant);
    }

    #[test]
    fn poison_coefficients_give_nan_and_wrong_shapes_errors() {
        let out = mean_colour(&[f32::NAN, 0.0, -100.0], 1, &fibonacci_sphere(8)).unwrap();
        assert!(out[0].is_nan() && out[1] == 0.5 && out[2] == 0.0);
        let row = [0.5 / sh::C0, 0.0, -1.0 / sh::C0, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0];
        let one = constant_colour(&row, 4).unwrap();
        assert!((one[0] - 1.0).abs() < 1e-6 && one[1] == 0.5 && one[2] == 0.0 && one.len() == 3, "{one:?}");
        assert!(constant_colour(&[0.0; 5], 1).is_err() && constant_colour(&[0.0; 6], 2).is_err());
        assert!(mean_colour(&[], 16, &fibonacci_sphere(8)).unwrap().is_empty());
    }

    #[test]
    fn lab_of_known_colours() {
        for (rgb, want) in [
            ([1.0, 1.0, 1.0], [100.0, 0.0, 0.0]),
            ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
            ([1.0, 0.0, 0.0], [53.24, 80.09, 67.20]),
            ([0.0, 0.0, 1.0], [32.30, 79.19, -107.86]),
        ] {
            let lab = rgb_to_lab(rgb);
            assert!((0..3).all(|i| (lab[i] - want[i]).abs() < 0.05), "{rgb:?} {lab:?}");
        }
    }

    proptest! {
        #[test]
        fn lab_returns_to_rgb(r in 0f32..1.0, g in 0f32..1.0, b in 0f32..1.0) {
            let back = lab_to_rgb(rgb_to_lab([r, g, b]));
            prop_assert!((back[0] - r).abs() < 1e-4 && (back[1] - g).abs() < 1e-4 && (back[2] - b).abs() < 1e-4);
        }

        #[test]
        fn band_bound_holds(seed in 0u64..500) {
            let mut u = generator(seed);
            for k in [16, 15] {
                let c: Vec<f32> = (0..k).map(|_| u() * 2.0 - 1.0).collect();
                for d in fibonacci_sphere(64) {
                    let value: f32 = sh::basis_of(k, d).iter().zip(&c).skip(1).map(|(y, c)| y * c).sum();
                    prop_assert!(value.abs() <= band_bound(&c) + 1e-5);
                }
            }
        }
    }
}
