//! Statistics of views for densification, one unit per Gaussian.

use crate::cube::prelude::*;
use crate::cube::{UNITS, arg, cubes, empty_f32, rows};
use crate::splat::views::{ViewSumsOps, ViewSumsOutput};
use burn::backend::tensor::IntTensor;
use burn_cubecl::kernel::into_contiguous;

#[cube(launch)]
fn add(
    gradient: &[f32],
    views: &[f32],
    opacity: &[f32],
    screen: &[f32],
    radii: &[i32],
    logits: &[f32],
    new_gradient: &mut [f32],
    new_views: &mut [f32],
    new_opacity: &mut [f32],
    n: u32,
    scale_x: f32,
    scale_y: f32,
) {
    if ABSOLUTE_POS < n as usize {
        let i = ABSOLUTE_POS;
        let x = screen[2 * i] * scale_x;
        let y = screen[2 * i + 1] * scale_y;
        let drawn = radii[i] > 0i32;
        new_gradient[i] = gradient[i] + select(drawn, f32::sqrt(x * x + y * y), 0.0f32);
        new_views[i] = views[i] + select(drawn, 1.0f32, 0.0f32);
        let now = 1.0f32 / (1.0f32 + f32::exp(-logits[i]));
        new_opacity[i] = max(opacity[i], now);
    }
}

impl ViewSumsOps for CubeBackend {
    fn add_view(
        gradient: FloatTensor<Self>,
        views: FloatTensor<Self>,
        opacity: FloatTensor<Self>,
        screen: FloatTensor<Self>,
        radii: IntTensor<Self>,
        logits: FloatTensor<Self>,
        scale: [f32; 2],
    ) -> ViewSumsOutput<Self> {
        let (gradient, views, opacity) = (rows(gradient), rows(views), rows(opacity));
        let (screen, radii, logits) = (rows(screen), into_contiguous(radii), rows(logits));
        let n = views.meta.shape().num_elements();
        let out = ViewSumsOutput {
            gradient: empty_f32(&gradient, [n]),
            views: empty_f32(&gradient, [n]),
            opacity: empty_f32(&gradient, [n]),
        };
        add::launch(
            &gradient.client.clone(),
            cubes(n, UNITS),
            CubeDim::new_1d(UNITS),
            arg(&gradient),
            arg(&views),
            arg(&opacity),
            arg(&screen),
            arg(&radii),
            arg(&logits),
            arg(&out.gradient),
            arg(&out.views),
            arg(&out.opacity),
            n as u32,
            scale[0],
            scale[1],
        );
        out
    }
}
