//! Which pixels of a picture show the group that is drawn alone, and which masks lie on the background behind it.

use super::mask::Mask;
use crate::config::types::segment::MasksConfig;
use crate::segment::pictures::GaussianPicture;

/// Returns the alpha below which a pixel, or a mask by its mean, is background in a picture of a group alone.
///
/// A fixed limit does not work: a translucent segment, such as a haze with an alpha of 0.1, would have no mask at all,
/// while around an opaque body the faint halo of its Gaussians would count as a part of it. So the limit is a quarter
/// of the typical alpha of this group in this picture: the mean of its alphas, each weighted by itself, which is the
/// alpha of the haze for a haze, and that of the body for a body however far its halo reaches. A mask passes if a
/// quarter of it has the typical alpha, or all of it a quarter of that; a mask of the background, whose mean is near 0,
/// and one of the whole picture around a small body do not. Anything fainter than 2/255 is never visible, and so is
/// background everywhere.
pub fn background_below(picture: &GaussianPicture, config: &MasksConfig) -> f64 {
    let (mut sum, mut squares) = (0.0f64, 0.0f64);
    for p in picture.rgba.chunks_exact(4).filter(|p| p[3].is_finite()) {
        let alpha = f64::from(p[3].clamp(0.0, 1.0));
        sum += alpha;
        squares += alpha * alpha;
    }
    let typical = if sum > 0.0 { squares / sum } else { 0.0 };
    (config.background_share * typical).max(config.min_alpha)
}

/// Mean alpha of the picture in a mask of its size; 0 for an empty one.
pub fn mean_alpha(picture: &GaussianPicture, mask: &Mask) -> f64 {
    let sum: f64 = mask.pixels().map(|p| f64::from(picture.rgba[4 * p as usize + 3])).sum();
    sum / mask.area().max(1) as f64
}

/// Whether a mask lies on the background of a picture of a group alone: its mean alpha is NaN or less than `below`, see
/// [`background_below`]. An empty mask does.
pub fn on_background(picture: &GaussianPicture, mask: &Mask, below: f64) -> bool {
    let mean = mean_alpha(picture, mask);
    mean < below || mean.is_nan()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 40 x 24 pixels: `body` in the middle fifth of the columns, `around` elsewhere.
    fn picture(body: f32, around: f32) -> GaussianPicture {
        let alpha = |i: usize| if (16..24).contains(&(i % 40)) { body } else { around };
        let rgba = (0..40 * 24).flat_map(|i| [0.5, 0.5, 0.5, alpha(i)]).collect();
        GaussianPicture { width: 40, height: 24, rgba, depth: vec![1.0; 40 * 24] }
    }

    fn columns(from: usize, to: usize) -> Mask {
        let rows: Vec<bool> = (0..40 * 24).map(|i| (from..to).contains(&(i % 40))).collect();
        Mask::from_rows(40, 24, &rows).unwrap()
    }

    fn kept(picture: &GaussianPicture, mask: &Mask) -> bool {
        !on_background(picture, mask, background_below(picture, &MasksConfig::default()))
    }

    #[test]
    fn a_translucent_segment_keeps_its_masks_and_the_background_has_none() {
        for body in [1.0, 0.5, 0.1, 0.03] {
            let picture = picture(body, 0.0);
            assert!(kept(&picture, &columns(16, 24)), "the body, alpha {body}");
            assert!(kept(&picture, &columns(12, 20)), "half of it on the background");
            assert!(!kept(&picture, &columns(0, 16)), "the background, alpha {body}");
            assert!(!kept(&picture, &columns(0, 40)), "the whole picture");
        }
    }

    #[test]
    fn a_halo_is_background_of_a_body_and_a_fainter_part_is_not() {
        let halo = picture(0.9, 0.03);
        assert!(kept(&halo, &columns(16, 24)) && !kept(&halo, &columns(0, 16)));
        let shell = picture(0.9, 0.3);
        assert!(kept(&shell, &columns(0, 16)) && kept(&shell, &columns(0, 40)));
    }

    #[test]
    fn empty_and_non_finite_pictures_are_background() {
        let empty = picture(0.0, 0.0);
        assert!(!kept(&empty, &columns(0, 40)));
        let faint = picture(0.004, 0.004);
        assert!(!kept(&faint, &columns(16, 24)), "an alpha of one step is invisible");
        let good = picture(0.8, 0.0);
        assert!(!kept(&good, &Mask::empty(40, 24).unwrap()));
        let mut bad = good.clone();
        bad.rgba[4 * 17 + 3] = f32::NAN;
        assert!(!kept(&bad, &columns(16, 24)) && kept(&bad, &columns(18, 24)));
    }
}
