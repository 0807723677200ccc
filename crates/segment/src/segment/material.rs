//! The material colour of a Gaussian, independent of lighting. Grouping by these colours is in `material_groups`.
//!
//! The images are shaded by Blinn-Phong with a white headlight (see `volume::raycast`): in any direction a Gaussian has
//! the colour `s * base + w * white`, where the light sets `s` and the highlight `w`. All colours of one material lie
//! in the plane through black, `base` and white, the dichromatic model (Shafer, *Using color to separate reflection
//! components*, 1985), so their hue is that of `base` and, apart from highlights, so is the ratio of chroma to
//! brightness.

use super::colour::{check, fibonacci_sphere};
use crate::config::types::segment::MaterialConfig;
use crate::model::sh;
use crate::points::chunks::map_chunks;
use crate::points::error::PointsError;

/// Number of directions in which the colour of a Gaussian is sampled.
const DIRECTIONS: usize = 48;

/// The material colours of N Gaussians.
#[derive(Debug, Clone, PartialEq)]
pub struct Materials {
    /// `[N, 2]`: opponent colours (red against green and blue, green against blue) divided by the brightest channel.
    /// The angle is the hue; the length is at most 0.817, and 0 for greys and for Gaussians without a finite colour.
    pub chroma: Vec<f32>,
    /// `[N]`: brightest channel under full light, in `[0, 1]`.
    pub full: Vec<f32>,
    /// `[N]`: reliability of the chroma, in `[0, 1)`; low for dark Gaussians, 0 for those without a finite colour.
    pub certainty: Vec<f32>,
}

/// Fits the dichromatic plane of each of `sh` `[N, coefficients, 3]` over directions of the whole sphere, colours
/// clamped to `[0, 1]`. Directions in which the harmonics leave that range, or the plane, count less.
///
/// # Errors
/// `coefficients` not 1, 4, 9 or 16, nor 6 or 15 as of even bands, or `sh` not a whole number of `[coefficients, 3]`
/// blocks.
pub fn materials(sh: &[f32], coefficients: usize, config: &MaterialConfig) -> Result<Materials, PointsError> {
    let count = check(sh, coefficients)?;
    let each: Vec<[f32; 16]> =
        fibonacci_sphere(DIRECTIONS).into_iter().map(|d| sh::basis_of(coefficients, d)).collect();
    let bases: Vec<[f32; DIRECTIONS]> = (0..16).map(|k| std::array::from_fn(|d| each[d][k])).collect();
    let chunks = map_chunks(count, |range| {
        range.map(|i| fit(&sh[3 * coefficients * i..3 * coefficients * (i + 1)], &bases, config)).collect::<Vec<_>>()
    });
    let mut out = Materials { chroma: Vec::new(), full: Vec::new(), certainty: Vec::new() };
    for (chroma, full, certainty) in chunks.into_iter().flatten() {
        out.chroma.extend(chroma);
        out.full.push(full);
        out.certainty.push(certainty);
    }
    Ok(out)
}

/// Chroma, brightness under full light and certainty of one block `[coefficients, 3]`.
fn fit(block: &[f32], bases: &[[f32; DIRECTIONS]], config: &MaterialConfig) -> ([f32; 2], f32, f32) {
    let mut colours = [[0.5f32; DIRECTIONS]; 3];
    for (c, basis) in block.chunks_exact(3).zip(bases) {
        for (values, c) in colours.iter_mut().zip(c) {
            values.iter_mut().zip(basis).for_each(|(v, y)| *v += c * y);
        }
    }
    let mut believed = [0f32; DIRECTIONS];
    let mut opponent = [[0f32; 2]; DIRECTIONS];
    let mut bright = [0f32; DIRECTIONS];
    for d in 0..DIRECTIONS {
        let rgb = [colours[0][d], colours[1][d], colours[2][d]];
        if rgb.iter().any(|v| !v.is_finite()) {
            return ([0.0; 2], 0.0, 0.0);
        }
        // bounded, so that some weight remains where no direction is reliable
        let beyond = rgb.iter().map(|v| (-v).max(v - 1.0)).fold(0.0, f32::max).min(100.0);
        believed[d] = 1.0 / (1.0 + (beyond / config.beyond).powi(2));
        let rgb = rgb.map(|v| v.clamp(0.0, 1.0));
        (0..3).for_each(|c| colours[c][d] = rgb[c]);
        opponent[d] = to_opponent(rgb);
        bright[d] = rgb[0].max(rgb[1]).max(rgb[2]);
    }
    let mut weights = believed;
    let mut along = [0.0; 2];
    for pass in 0..=config.passes {
        let total: f32 = weights.iter().sum();
        along = [0, 1].map(|a| weights.iter().zip(&opponent).map(|(w, p)| w * p[a]).sum::<f32>() / total);
        let length = along[0].hypot(along[1]);
        if pass == config.passes || length < 1e-6 {
            break;
        }
        for d in 0..DIRECTIONS {
            let off = (opponent[d][0] * along[1] - opponent[d][1] * along[0]) / length;
            weights[d] = believed[d] / (1.0 + (off / config.off_plane).powi(2));
        }
    }
    let total: f32 = weights.iter().sum();
    let mean = |values: &[f32]| weights.iter().zip(values).map(|(w, v)| w * v).sum::<f32>() / total;
    let brightest = colours.iter().map(|c| mean(c)).fold(0.0, f32::max);
    let full = bright_end(&mut bright, &weights, config.full_light);
    let certainty = brightest * brightest / (brightest * brightest + config.dim * config.dim);
    (along.map(|v| v / brightest.max(config.dark)), full, certainty)
}

/// The brightness that stands for full light, a quantile; partially sorts `bright`.
fn bright_end(bright: &mut [f32; DIRECTIONS], weights: &[f32; DIRECTIONS], full_light: f64) -> f32 {
    let mut count = 0;
    for d in 0..DIRECTIONS {
        if weights[d] >= 0.5 {
            bright[count] = bright[d];
            count += 1;
        }
    }
    // where no direction is reliable, all of them count
    let believed = if count > 0 { &mut bright[..count] } else { &mut bright[..] };
    let rank = ((believed.len() as f64 * full_light) as usize).min(believed.len() - 1);
    *believed.select_nth_unstable_by(rank, f32::total_cmp).1
}

/// The two opponent colours: the projection onto the plane perpendicular to white.
fn to_opponent([r, g, b]: [f32; 3]) -> [f32; 2] {
    [(2.0 * r - g - b) / 6f32.sqrt(), (g - b) / 2f32.sqrt()]
}

/// Returns the colour in `[0, 1]`, `[3]`, of chroma `[2]` as in [`Materials::chroma`] whose brightest channel is
/// `brightest`.
pub fn to_rgb(chroma: [f32; 2], brightest: f32) -> [f32; 3] {
    let (x, y) = (chroma[0] / 6f32.sqrt(), chroma[1] / 2f32.sqrt());
    let off = [2.0 * x, y - x, -x - y];
    let most = off[0].max(off[1]).max(off[2]);
    off.map(|v| ((v + 1.0 - most) * brightest).clamp(0.0, 1.0))
}

/// Maps chroma `[2]` to the plane in which distances between materials are measured: a step of hue counts more than one
/// of chroma, since highlights, haze and translucent shells in front change chroma first; beyond the chroma `knee`, a
/// step of chroma counts less. The angle is preserved.
pub fn to_plane(chroma: [f32; 2], knee: f32) -> [f32; 2] {
    let root = (chroma[0].hypot(chroma[1]) + knee).sqrt();
    chroma.map(|v| v / root)
}

/// Maps the result of [`to_plane`] with the same `knee` back to chroma `[2]`.
pub fn from_plane(plane: [f32; 2], knee: f32) -> [f32; 2] {
    let square = plane[0] * plane[0] + plane[1] * plane[1];
    let length = 0.5 * (square + (square * (square + 4.0 * knee)).sqrt());
    plane.map(|v| v * (length + knee).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use volseggs_kernels::sh::C2;

    const KNEE: f32 = 0.12;

    fn found(sh: &[f32], coefficients: usize) -> Result<Materials, PointsError> {
        materials(sh, coefficients, &MaterialConfig::default())
    }

    #[test]
    fn full_light_is_nine_tenths_of_the_directions() {
        for count in 1..=DIRECTIONS {
            assert_eq!((count as f64 * MaterialConfig::default().full_light) as usize, count * 9 / 10, "{count}");
        }
    }

    /// Degree-2 harmonics of `base (ambient + diffuse n.d^2) + shine n.d^2`, which like the light is even in the
    /// direction.
    fn shaded(base: [f32; 3], ambient: f32, diffuse: f32, shine: f32) -> Vec<f32> {
        let mut sh = vec![0.0; 27];
        for c in 0..3 {
            let (flat, square) = (base[c] * ambient, base[c] * diffuse + shine);
            // z^2 = 1/3 + (3 z^2 - 1) / 3
            sh[c] = (flat + square / 3.0 - 0.5) / sh::C0;
            sh[6 * 3 + c] = square / 3.0 / C2[1];
        }
        sh
    }

    fn hue(m: &Materials) -> f32 {
        m.chroma[1].atan2(m.chroma[0])
    }

    #[test]
    fn shading_changes_neither_hue_nor_chroma_and_highlights_no_hue() {
        let base = [0.2, 0.5, 0.7];
        let plain = found(&shaded(base, 1.0, 0.0, 0.0), 9).unwrap();
        for (ambient, diffuse) in [(0.1, 0.9), (0.3, 0.2), (0.6, 0.3), (0.15, 0.0)] {
            let lit = found(&shaded(base, ambient, diffuse, 0.0), 9).unwrap();
            assert!((0..2).all(|a| (lit.chroma[a] - plain.chroma[a]).abs() < 1e-3), "{lit:?} {plain:?}");
            let shiny = found(&shaded(base, ambient, diffuse, 0.2), 9).unwrap();
            assert!((hue(&shiny) - hue(&plain)).abs() < 1e-3);
        }
        let dark = found(&shaded(base, 0.02, 0.02, 0.0), 9).unwrap();
        assert!(dark.certainty[0] < 0.1 && plain.certainty[0] > 0.9, "{dark:?}");
        assert!((plain.full[0] - 0.7).abs() < 1e-3);
    }

    #[test]
    fn even_bands_have_the_material_of_all_bands() {
        let all = shaded([0.2, 0.5, 0.7], 0.3, 0.5, 0.1);
        let even: Vec<f32> = [&all[..3], &all[12..]].concat();
        assert_eq!(found(&even, 6).unwrap(), found(&all, 9).unwrap());
    }

    #[test]
    fn a_side_without_views_affects_the_hue_less_than_the_mean() {
        let plain = shaded([0.1, 0.3, 0.8], 0.5, 0.4, 0.0);
        // red rises far above 1 towards +x only: 1.2 (x + x^2), x^2 = 1/3 + (x^2 - y^2) / 2 - (3 z^2 - 1) / 6
        let mut wild = plain.clone();
        wild[0] += 0.4 / sh::C0;
        wild[9] -= 1.2 / sh::C1;
        wild[24] += 0.6 / C2[2];
        wild[18] -= 0.2 / C2[1];
        let of_mean = |sh: &[f32]| {
            let p = to_opponent([0, 1, 2].map(|c| 0.5 + sh::C0 * sh[c]));
            p[1].atan2(p[0])
        };
        let turn = |a: f32, b: f32| (a - b).sin().abs();
        let fitted = turn(hue(&found(&plain, 9).unwrap()), hue(&found(&wild, 9).unwrap()));
        let mean = turn(of_mean(&plain), of_mean(&wild));
        assert!(fitted < 0.5 * mean, "{fitted} {mean}");
    }

    #[test]
    fn poison_has_no_certainty_and_wrong_shapes_are_errors() {
        let m = found(&[f32::NAN, 0.0, 0.0, 0.0, f32::INFINITY, 0.0, 1e38, -1e38, 1e38], 1).unwrap();
        assert_eq!(&m.certainty[..2], [0.0; 2]);
        assert!(m.chroma.iter().chain(&m.full).chain(&m.certainty).all(|v| v.is_finite()), "{m:?}");
        let huge = found(&[f32::MAX; 48], 16).unwrap();
        assert!(huge.chroma.iter().chain(&huge.full).all(|v| v.is_finite()));
        assert!(found(&[0.0; 5], 1).is_err() && found(&[0.0; 6], 2).is_err());
        assert!(found(&[], 16).unwrap().full.is_empty());
    }

    proptest! {
        #[test]
        fn a_plain_colour_comes_back(r in 0.1f32..1.0, g in 0.1f32..1.0, b in 0.1f32..1.0) {
            let m = found(&[r, g, b].map(|v| (v - 0.5) / sh::C0), 1).unwrap();
            let back = to_rgb([m.chroma[0], m.chroma[1]], m.full[0]);
            prop_assert!((0..3).all(|c| (back[c] - [r, g, b][c]).abs() < 1e-4), "{back:?}");
            let plane = to_plane([m.chroma[0], m.chroma[1]], KNEE);
            prop_assert!((plane[0] * m.chroma[1] - plane[1] * m.chroma[0]).abs() < 1e-5);
            let back = from_plane(plane, KNEE);
            prop_assert!((0..2).all(|a| (back[a] - m.chroma[a]).abs() < 1e-5));
        }
    }
}
