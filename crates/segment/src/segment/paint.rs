//! Colours that encode a quantity, in place of the trained ones: the segment of a Gaussian, its speed, the distance of
//! a pixel. The quantities are computed elsewhere (see `track::velocity`, `pictures`).

use super::pictures::GaussianPicture;
use super::segmentation::Segmentation;
use crate::model::HostGaussians;
use crate::model::sh::C0;
use crate::volume::transfer::colormap::{colour_at, named};
use volseggs_kernels::activation::{logit_f64, sigmoid_f64};

/// Minimum alpha of pixels whose depth is shown.
const MIN_ALPHA: f32 = 0.1;
/// Colour of Gaussians in no segment.
const UNSEGMENTED: [f32; 3] = [0.8; 3];
/// Factor on the opacity of Gaussians in no segment.
const FAINT: f64 = 0.1;

/// Returns `gaussians` in `colours` `[N]` (sRGB in [0, 1]), the same from every side; to be drawn at degree 0.
pub fn flat(gaussians: HostGaussians, colours: impl IntoIterator<Item = [f32; 3]>) -> HostGaussians {
    let sh = colours.into_iter().flat_map(|colour| colour.map(|c| (c - 0.5) / C0)).collect();
    HostGaussians { sh, sh_stride: 1, shading: None, ..gaussians }
}

/// Colours each of the scene's N `gaussians` by its segment: of those that hold it the most deeply nested one, of
/// equally deep ones the last. Gaussians in none become grey and faint.
///
/// # Panics
/// If a segment holds an index that is not below N.
pub fn by_segment(mut gaussians: HostGaussians, all: &Segmentation) -> HostGaussians {
    let depths = all.depths();
    let mut order: Vec<usize> = (0..depths.len()).collect();
    order.sort_by_key(|&i| depths[i]);
    let mut colours = vec![None; gaussians.len()];
    for segment in order.into_iter().map(|i| &all.segments[i]) {
        for &member in &segment.members {
            colours[member as usize] = Some(segment.colour);
        }
    }
    gaussians.opacity_logits.iter_mut().zip(&colours).filter(|(_, c)| c.is_none()).for_each(|(logit, _)| fade(logit));
    flat(gaussians, colours.into_iter().map(|c| c.unwrap_or(UNSEGMENTED)))
}

/// Multiplies an opacity by [`FAINT`].
fn fade(logit: &mut f32) {
    *logit = logit_f64(FAINT * sigmoid_f64(f64::from(*logit))) as f32;
}

/// Fades all Gaussians except those that stay, through their `opacity_logits` `[M]`, so that these stand out whatever
/// the colours.
pub fn highlight(opacity_logits: &mut [f32], stays: impl Fn(usize) -> bool) {
    opacity_logits.iter_mut().enumerate().filter(|(i, _)| !stays(*i)).for_each(|(_, logit)| fade(logit));
}

/// Signed `values` `[N]` as colours: red above 0, green below, black at 0, full brightness from `scale` on.
pub fn signed(values: &[f32], scale: f32) -> impl Iterator<Item = [f32; 3]> {
    values.iter().map(move |v| {
        let share = share(v / scale);
        if *v < 0.0 { [0.0, share, 0.0] } else { [share, 0.0, 0.0] }
    })
}

/// Signed `values` `[N]` as colours of a diverging map (see [`named`]), which ends at `-scale` and at `scale`.
pub fn diverging(values: &[f32], scale: f32, map: &str) -> impl Iterator<Item = [f32; 3]> {
    let map = named(map).unwrap_or_default();
    values.iter().map(move |v| colour_at(&map, 0.5 + 0.5 * f64::from(share(v / scale).copysign(*v))))
}

/// The magnitudes of `values` `[N]` as colours of a map (see [`named`]), which ends at `scale`.
pub fn sizes(values: &[f32], scale: f32, map: &str) -> impl Iterator<Item = [f32; 3]> {
    let map = named(map).unwrap_or_default();
    values.iter().map(move |v| colour_at(&map, share(v / scale).into()))
}

/// The magnitude, at most 1; NaN counts as 0.
fn share(v: f32) -> f32 {
    if v.is_nan() { 0.0 } else { v.abs().min(1.0) }
}

/// The nearest and the farthest depth that `picture` shows, scene units; `None` if it shows none.
pub fn depth_range(picture: &GaussianPicture) -> Option<[f32; 2]> {
    let seen = picture.depth.iter().zip(picture.rgba.chunks_exact(4)).filter(|(_, p)| p[3] >= MIN_ALPHA);
    seen.fold(None, |range, (&d, _)| {
        let [near, far] = range.unwrap_or([d, d]);
        Some([near.min(d), far.max(d)])
    })
}

/// The depth of `picture` as colours of a map (see [`named`]), `[H, W, 4]`: its end at `near` and nearer, its beginning
/// at `far` and farther, scene units; `background` where next to nothing is drawn.
pub fn depth_colours(picture: &GaussianPicture, [near, far]: [f32; 2], background: [f32; 3], map: &str) -> Vec<f32> {
    let map = named(map).unwrap_or_default();
    let pixels = picture.depth.iter().zip(picture.rgba.chunks_exact(4));
    pixels
        .flat_map(|(depth, pixel)| {
            let way = (far - depth) / (far - near).max(f32::MIN_POSITIVE);
            let [r, g, b] = if pixel[3] >= MIN_ALPHA { colour_at(&map, way.into()) } else { background };
            [r, g, b, pixel[3]]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::name::Name;
    use crate::segment::segmentation::{Segment, SegmentOrigin};

    fn gaussians(n: usize) -> HostGaussians {
        HostGaussians {
            means: vec![0.0; 3 * n],
            rotations: [1.0, 0.0, 0.0, 0.0].repeat(n),
            log_scales: vec![-2.0; 3 * n],
            opacity_logits: vec![0.0; n],
            sh: vec![0.7; 12 * n],
            sh_stride: 4,
            ..HostGaussians::default()
        }
    }

    fn colour(gaussians: &HostGaussians, i: usize) -> [f32; 3] {
        std::array::from_fn(|c| ((gaussians.sh[3 * i + c] * C0 + 0.5) * 100.0).round() / 100.0)
    }

    #[test]
    fn the_deepest_part_wins_and_unsegmented_gaussians_are_faint() {
        let mut all = Segmentation::new(5, "scene".into());
        let mut add = |name: &str, parent: Option<&str>, colour, members: &[u32]| {
            let (name, parent, members) =
                (Name::new(name).unwrap(), parent.map(|p| Name::new(p).unwrap()), members.to_vec());
            let segment = Segment { name, parent, colour, time: 0.0, origin: SegmentOrigin::Coarse, members };
            all.add(segment).unwrap();
        };
        let [red, green, blue] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        add("whole", None, red, &[0, 1, 2]);
        add("part", Some("whole"), green, &[1]);
        // later in the file, but not a part
        add("other", None, blue, &[1, 2, 3]);
        let painted = by_segment(gaussians(5), &all);
        assert_eq!((painted.sh_stride, painted.sh.len()), (1, 15));
        assert_eq!([0, 1, 2, 3, 4].map(|i| colour(&painted, i)), [red, green, blue, blue, UNSEGMENTED]);
        let opacity = painted.opacity();
        assert_eq!(opacity[..4], [0.5; 4]);
        assert!((opacity[4] - 0.05).abs() < 1e-6, "{opacity:?}");

        let mut hidden = gaussians(5);
        hidden.opacity_logits[4] = crate::edit::HIDDEN_LOGIT;
        let logit = by_segment(hidden, &all).opacity_logits[4];
        assert!(logit.is_finite() && logit <= crate::edit::HIDDEN_LOGIT);
    }

    #[test]
    fn signs_have_colours_and_sizes_have_brightness() {
        let colours: Vec<[f32; 3]> = signed(&[1.0, -1.0, 0.0, 9.0, f32::NAN], 2.0).collect();
        assert_eq!(colours, [[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0; 3], [1.0, 0.0, 0.0], [0.0; 3]]);
        let bright: Vec<f32> = sizes(&[0.0, 0.5, 1.0, 2.0, 3.0], 2.0, "inferno").map(|c| c.iter().sum()).collect();
        assert!(bright.windows(2).all(|w| w[0] <= w[1]) && bright[0] < 0.1 && bright[3] == bright[4], "{bright:?}");
    }

    #[test]
    fn diverging_colours_are_centred_at_zero() {
        let colours: Vec<[f32; 3]> = diverging(&[-9.0, -2.0, 0.0, 2.0, f32::NAN], 2.0, "cool-warm").collect();
        assert!(colours[0] == colours[1] && colours[2] == colours[4]);
        assert!(colours[1][2] > colours[1][0] && colours[3][0] > colours[3][2], "blue below, red above: {colours:?}");
    }

    #[test]
    fn depth_is_coloured_where_something_is_visible() {
        let alpha = [0.0, 0.05, 0.9, 0.5, 1.0];
        let rgba = alpha.iter().flat_map(|a| [0.3, 0.3, 0.3, *a]).collect();
        let picture = GaussianPicture { width: 5, height: 1, rgba, depth: vec![0.0, 9.0, 2.0, 3.0, 4.0] };
        let range = depth_range(&picture).unwrap();
        assert_eq!(range, [2.0, 4.0]);
        let image = depth_colours(&picture, range, [1.0, 0.0, 1.0], "viridis");
        let pixel = |i: usize| &image[4 * i..4 * i + 3];
        assert_eq!((pixel(0), pixel(1)), (&[1.0, 0.0, 1.0][..], &[1.0, 0.0, 1.0][..]));
        let light = |i: usize| pixel(i).iter().sum::<f32>();
        assert!(light(2) > light(3) && light(3) > light(4), "{image:?}");
        // a single depth must not divide by zero
        assert!(depth_colours(&picture, [2.0, 2.0], [0.0; 3], "viridis").iter().all(|v| v.is_finite()));
        assert_eq!(depth_range(&GaussianPicture { width: 0, height: 0, rgba: vec![], depth: vec![] }), None);
    }
}
