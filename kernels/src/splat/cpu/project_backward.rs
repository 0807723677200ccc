//! Propagation of each Gaussian's gradients on screen back to means, covariances, opacity_logits and sh.

use super::Attributes;
use super::bin::DepthOrder;
use super::blend_backward::ScreenGradient;
use super::covariance::{Covariances, Gradient};
use super::lanes::wide;
use super::project::{Projection, Splat2d, row, view_direction};
use crate::PinholeCamera;
use crate::backend::zeros;
use crate::sh::{self, Bands};
use crate::splat::SplatSettings;
use rayon::prelude::*;

/// Gradients of every input, row-major.
pub(super) struct Gradients {
    pub means: Vec<f32>,
    pub covariances: Covariances<Vec<f32>>,
    pub opacity_logits: Vec<f32>,
    pub sh: Vec<f32>,
    pub screen_offsets: Vec<f32>,
}

pub(super) fn project_backward(
    a: Attributes<'_>,
    order: &DepthOrder,
    screen: &[ScreenGradient],
    settings: &SplatSettings,
) -> Gradients {
    let n = a.len();
    let ranks = order.ranks(n);
    let width = 3 * a.sh_stride;
    let mut g = Gradients {
        means: zeros(3 * n),
        covariances: a.covariances.map(|rows| zeros(rows.len())),
        opacity_logits: zeros(n),
        sh: zeros(width * n),
        screen_offsets: zeros(2 * n),
    };
    let eye = settings.camera.position();
    const CHUNK: usize = 1024;
    let chunks = (
        g.means.par_chunks_mut(3 * CHUNK),
        g.covariances.chunks_mut(CHUNK),
        g.opacity_logits.par_chunks_mut(CHUNK),
        g.sh.par_chunks_mut(width * CHUNK),
        g.screen_offsets.par_chunks_mut(2 * CHUNK),
    );
    chunks.into_par_iter().enumerate().for_each(|(c, (means, mut covariances, logits, sh, offsets))| {
        wide!(for j in 0..logits.len() {
            let i = c * CHUNK + j;
            let rank = ranks[i] as usize;
            let Some(g) = screen.get(rank).filter(|g| g.iter().any(|v| *v != 0.0)) else { continue };
            let out = one(a, i, &order.splats[rank], g, eye, settings, &mut sh[width * j..][..width]);
            means[3 * j..][..3].copy_from_slice(&out.mean);
            covariances.set(j, &out.covariance);
            logits[j] = out.opacity_logit;
            offsets[2 * j..][..2].copy_from_slice(&out.screen);
        });
    });
    g
}

struct GaussianGradient {
    mean: [f32; 3],
    covariance: Gradient,
    opacity_logit: f32,
    screen: [f32; 2],
}

#[inline(always)]
fn one(
    a: Attributes<'_>,
    i: usize,
    splat: &Splat2d,
    g: &ScreenGradient,
    eye: [f32; 3],
    settings: &SplatSettings,
    sh_out: &mut [f32],
) -> GaussianGradient {
    let camera = &settings.camera;
    let mean = row::<3>(a.means, i);
    let p = Projection::new(mean, a.covariances, i, settings);
    let [ca, cb, cc] = p.covariance;
    let inverse = 1.0 / p.determinant;
    let conic = [cc * inverse, -cb * inverse, ca * inverse];

    // power = -1/2 (A dx^2 + C dy^2) - B dx dy with (dx, dy) = pixel - mean
    let screen = [conic[0] * g[1] + conic[1] * g[2], conic[1] * g[1] + conic[2] * g[2]];
    let opacity = splat.log2_opacity.exp2();
    let opacity_logit = g[0] * (1.0 - opacity);

    // dL/dCov = -Conic G Conic with the symmetric G = dL/dConic
    let (ga, gb, gc) = (-0.5 * g[3], -0.5 * g[4], -0.5 * g[5]);
    let [qa, qb, qc] = conic;
    let (t00, t01) = (qa * ga + qb * gb, qa * gb + qb * gc);
    let (t10, t11) = (qb * ga + qc * gb, qb * gb + qc * gc);
    let (va, vb, vc) = (-(t00 * qa + t01 * qb), -(t00 * qb + t01 * qc), -(t10 * qb + t11 * qc));

    let (v_jw, covariance) = p.source.backward(&p.jw, [va, vb, vc]);
    let v_camera = camera_mean_gradient(&p, camera, screen, &v_jw);
    let w = &camera.rotation;
    let mut v_mean: [f32; 3] =
        std::array::from_fn(|k| w[0][k] * v_camera[0] + w[1][k] * v_camera[1] + w[2][k] * v_camera[2]);

    // colour; a channel clamped at zero passes no gradient on
    let v_colour: [f32; 3] = std::array::from_fn(|c| if splat.colour[c] > 0.0 { g[6 + c] } else { 0.0 });
    let (direction, inverse_distance) = view_direction(mean, eye);
    let degree = settings.rendering.sh_degree;
    let bands = Bands::of_any(a.sh_stride);
    let count = bands.count(degree);
    let basis = sh::basis(direction, degree, bands);
    for k in 0..count {
        for c in 0..3 {
            sh_out[3 * k + c] = basis[k] * v_colour[c];
        }
    }
    if degree > 0 {
        let derivative = sh::basis_derivative(direction, degree, bands);
        let coefficients = &a.sh[3 * a.sh_stride * i..][..3 * count];
        let mut v = [0.0f32; 3];
        for (k, c) in coefficients.chunks_exact(3).enumerate().skip(1) {
            let e = c[0] * v_colour[0] + c[1] * v_colour[1] + c[2] * v_colour[2];
            for axis in 0..3 {
                v[axis] += derivative[axis][k] * e;
            }
        }
        let along = v[0] * direction[0] + v[1] * direction[1] + v[2] * direction[2];
        for axis in 0..3 {
            v_mean[axis] += (v[axis] - along * direction[axis]) * inverse_distance;
        }
    }
    GaussianGradient { mean: v_mean, covariance, opacity_logit, screen }
}

/// Propagates the gradient through the projected position and the Jacobian to the position in camera space.
#[inline(always)]
fn camera_mean_gradient(p: &Projection, camera: &PinholeCamera, screen: [f32; 2], v_jw: &[[f32; 3]; 2]) -> [f32; 3] {
    let w = &camera.rotation;
    let [x, y, z] = p.camera_mean;
    let iz = 1.0 / z;
    let iz2 = iz * iz;
    let (fx, fy) = (camera.fx, camera.fy);
    let dot = |v: [f32; 3], row: usize| v[0] * w[row][0] + v[1] * w[row][1] + v[2] * w[row][2];
    let (v00, v02) = (dot(v_jw[0], 0), dot(v_jw[0], 2));
    let (v11, v12) = (dot(v_jw[1], 1), dot(v_jw[1], 2));

    let mut v = [screen[0] * fx * iz, screen[1] * fy * iz, -(screen[0] * fx * x + screen[1] * fy * y) * iz2];
    v[2] -= (v00 * fx + v11 * fy) * iz2;
    // J02 = -fx slope / z; a clamped slope is a constant, a free one is x/z
    if p.clamped[0] {
        v[2] += v02 * fx * p.slope[0] * iz2;
    } else {
        v[0] -= v02 * fx * iz2;
        v[2] += 2.0 * v02 * fx * p.slope[0] * iz2;
    }
    if p.clamped[1] {
        v[2] += v12 * fy * p.slope[1] * iz2;
    } else {
        v[1] -= v12 * fy * iz2;
        v[2] += 2.0 * v12 * fy * p.slope[1] * iz2;
    }
    v
}
