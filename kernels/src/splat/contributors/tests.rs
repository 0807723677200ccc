//! The lists against the f64 oracle, against the rendered image, and for every thread count.

use super::{Contributors, ContributorsError, cpu, reference};
use crate::PinholeCamera;
use crate::splat::cpu::{Attributes, bin, blend, covariance::Covariances, project};
use crate::splat::reference::ReferenceScene;
use crate::splat::{Rendering, SplatSettings};
use proptest::prelude::*;

/// Gaussians in f32 and the camera that sees them.
struct Fixture {
    means: Vec<f32>,
    rotations: Vec<f32>,
    log_scales: Vec<f32>,
    opacity_logits: Vec<f32>,
    sh: Vec<f32>,
    settings: SplatSettings,
}

/// Uniform numbers in `[0, 1)` (splitmix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn range(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * (self.next() >> 40) as f32 / (1u64 << 24) as f32
    }
}

impl Fixture {
    fn random(n: usize, width: usize, height: usize, seed: u64) -> Self {
        let mut r = Random(seed);
        let focal = 1.2 * width.max(height) as f32;
        let (sin, cos) = r.range(-0.3, 0.3).sin_cos();
        let camera = PinholeCamera {
            width,
            height,
            fx: focal,
            fy: focal,
            cx: width as f32 / 2.0 + 0.3,
            cy: height as f32 / 2.0 - 0.2,
            rotation: [[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]],
            translation: [0.1, -0.05, 3.0],
        };
        let settings = Rendering::default().seen_by(camera);
        Self {
            means: (0..3 * n).map(|_| r.range(-1.2, 1.2)).collect(),
            rotations: (0..4 * n).map(|_| r.range(-1.0, 1.0)).collect(),
            log_scales: (0..3 * n).map(|_| r.range(-4.0, -1.2)).collect(),
            opacity_logits: (0..n).map(|_| r.range(-3.0, 6.0)).collect(),
            sh: (0..3 * n).map(|_| r.range(-1.5, 1.5)).collect(),
            settings,
        }
    }

    fn stages(&self) -> (bin::DepthOrder, Vec<f32>, bin::TileBins) {
        let attributes = Attributes {
            means: &self.means,
            covariances: Covariances::Factored { rotations: &self.rotations, log_scales: &self.log_scales },
            opacity_logits: &self.opacity_logits,
            sh: &self.sh,
            sh_stride: 1,
        };
        let splats = project::project(attributes, &vec![0.0; 2 * self.opacity_logits.len()], &self.settings);
        let order = bin::DepthOrder::new(&splats, &self.settings.camera);
        let (image, bins) = blend::blend(&order, &self.settings);
        (order, image, bins)
    }

    fn contributors(&self, pixels: &[u32]) -> Result<Contributors, ContributorsError> {
        let (order, _, _) = self.stages();
        cpu::of_pixels(&order, &self.settings, pixels)
    }

    fn scene(&self) -> ReferenceScene {
        let wide = |v: &[f32]| v.iter().map(|&x| f64::from(x)).collect::<Vec<f64>>();
        ReferenceScene {
            means: wide(&self.means),
            rotations: wide(&self.rotations),
            log_scales: wide(&self.log_scales),
            covariances: vec![],
            opacity_logits: wide(&self.opacity_logits),
            sh: wide(&self.sh),
            sh_stride: 1,
            screen_offsets: vec![0.0; 2 * self.opacity_logits.len()],
        }
    }

    fn all_pixels(&self) -> Vec<u32> {
        (0..(self.settings.camera.width * self.settings.camera.height) as u32).collect()
    }

    /// Compares with the oracle; returns the fraction of pixels that were clear enough to compare.
    fn check_against_reference(&self, pixels: &[u32]) -> f64 {
        let got = self.contributors(pixels).unwrap();
        assert_eq!(got.len(), pixels.len());
        let want = reference::contributors(&self.scene(), &self.settings, pixels);
        let mut compared = 0;
        for (p, want) in want.iter().enumerate() {
            if want.margin < 1e-4 || want.depth_gap < 1e-6 {
                continue;
            }
            compared += 1;
            let (indices, weights) = got.row(p);
            let expected: Vec<u32> = want.list.iter().map(|x| x.0).collect();
            assert_eq!(indices, expected, "pixel {}", pixels[p]);
            for (w, x) in weights.iter().zip(&want.list) {
                assert!((f64::from(*w) - x.1).abs() < 1e-5, "pixel {}: {w} against {}", pixels[p], x.1);
            }
        }
        f64::from(compared) / pixels.len().max(1) as f64
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn agrees_with_the_reference(n in 0usize..150, width in 1usize..50, height in 1usize..40, seed: u64) {
        let f = Fixture::random(n, width, height, seed);
        let mut r = Random(seed ^ 1);
        // sparse, unordered, with repeats
        let pixels: Vec<u32> = (0..200).map(|_| (r.next() % (width * height) as u64) as u32).collect();
        let compared = f.check_against_reference(&pixels);
        prop_assert!(compared > 0.5, "only {compared} of the pixels were compared");
    }

    #[test]
    fn the_weights_match_the_image(n in 0usize..200, width in 1usize..50, height in 1usize..40, seed: u64) {
        let f = Fixture::random(n, width, height, seed);
        let (order, image, bins) = f.stages();
        let lists = cpu::contributors(&order, &bins, &f.settings, &f.all_pixels()).unwrap();
        let first = cpu::of_pixels(&order, &f.settings, &[0]).unwrap();
        prop_assert_eq!(first.row(0), lists.row(0), "one row of tiles gives its pixels the same lists as all rows");
        let ranks = order.ranks(n);
        for (p, pixel) in image.chunks_exact(4).enumerate() {
            let (indices, weights) = lists.row(p);
            let left = weights.iter().fold(1.0f32, |t, w| t - w);
            prop_assert_eq!((1.0 - left).to_bits(), pixel[3].to_bits(), "the same operations give the same bits");
            let sum: f64 = weights.iter().map(|&w| f64::from(w)).sum();
            prop_assert!((sum - f64::from(pixel[3])).abs() < 1e-6);
            for (c, &value) in pixel[..3].iter().enumerate() {
                let colour = |&i: &u32| f64::from(order.splats[ranks[i as usize] as usize].colour[c]);
                let sum: f64 = indices.iter().zip(weights).map(|(i, &w)| f64::from(w) * colour(i)).sum();
                prop_assert!((sum - f64::from(value)).abs() < 1e-6, "{} against {}", sum, value);
            }
        }
    }

    #[test]
    fn the_lists_of_sampled_pixels_match_those_of_all_pixels(
        n in 0usize..150, width in 1usize..50, height in 1usize..40, count in 0usize..300, seed: u64,
    ) {
        let f = Fixture::random(n, width, height, seed);
        let all = f.contributors(&f.all_pixels()).unwrap();
        let mut r = Random(seed ^ 2);
        let pixels: Vec<u32> = (0..count).map(|_| (r.next() % (width * height) as u64) as u32).collect();
        let some = f.contributors(&pixels).unwrap();
        prop_assert_eq!(some.len(), count);
        prop_assert_eq!(some.indices.len(), some.weights.len());
        prop_assert_eq!(some.indices.len(), some.offsets[count] as usize);
        for (p, &pixel) in pixels.iter().enumerate() {
            prop_assert_eq!(some.row(p), all.row(pixel as usize));
        }
    }

    #[test]
    fn scatter_is_the_transpose_of_gather(n in 1usize..100, channels in 0usize..9, seed: u64) {
        let f = Fixture::random(n, 33, 17, seed);
        let lists = f.contributors(&f.all_pixels()).unwrap();
        let mut r = Random(seed ^ 3);
        let features: Vec<f32> = (0..n * channels).map(|_| r.range(-1.0, 1.0)).collect();
        let grads: Vec<f32> = (0..lists.len() * channels).map(|_| r.range(-1.0, 1.0)).collect();
        let (pixels, back) = (lists.gather(&features, channels), lists.scatter(&grads, n, channels));
        // both from the definition, in f64
        let mut want_pixels = vec![0.0f64; lists.len() * channels];
        let mut want_back = vec![0.0f64; n * channels];
        for p in 0..lists.len() {
            let (indices, weights) = lists.row(p);
            for (&i, &w) in indices.iter().zip(weights) {
                for c in 0..channels {
                    want_pixels[p * channels + c] += f64::from(w * features[i as usize * channels + c]);
                    want_back[i as usize * channels + c] += f64::from(w * grads[p * channels + c]);
                }
            }
        }
        prop_assert_eq!(pixels.len(), want_pixels.len());
        prop_assert_eq!(back.len(), want_back.len());
        prop_assert!(pixels.iter().zip(&want_pixels).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-5));
        prop_assert!(back.iter().zip(&want_back).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-4));
    }
}

#[test]
fn opaque_stacks_stop_where_the_reference_stops() {
    // many wide, nearly opaque Gaussians: every pixel saturates
    let mut f = Fixture::random(400, 40, 30, 11);
    f.log_scales.fill(-0.7);
    f.opacity_logits.iter_mut().for_each(|o| *o = o.abs() + 1.0);
    assert!(f.check_against_reference(&f.all_pixels()) > 0.8);
    let lists = f.contributors(&f.all_pixels()).unwrap();
    assert!((0..lists.len()).all(|p| lists.row(p).1.iter().sum::<f32>() > 0.99));
    assert!((0..lists.len()).all(|p| lists.row(p).0.len() < 50), "finished pixels accept no more entries");
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let f = Fixture::random(600, 90, 70, 5);
    let mut r = Random(6);
    let pixels: Vec<u32> = (0..5000).map(|_| (r.next() % (90 * 70)) as u32).collect();
    let features: Vec<f32> = (0..600 * 7).map(|_| r.range(-1.0, 1.0)).collect();
    let grads: Vec<f32> = (0..5000 * 7).map(|_| r.range(-1.0, 1.0)).collect();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let lists = f.contributors(&pixels).unwrap();
            let bits = |v: &[f32]| v.iter().map(|x| x.to_bits()).collect::<Vec<u32>>();
            let products = (bits(&lists.gather(&features, 7)), bits(&lists.scatter(&grads, 600, 7)));
            (bits(&lists.weights), lists.offsets, lists.indices, products)
        })
    };
    let one = run(1);
    assert!(!one.0.is_empty());
    for threads in [2, 3, 8] {
        assert!(run(threads) == one, "{threads} threads");
    }
}

#[test]
fn a_pixel_outside_the_image_is_refused() {
    let f = Fixture::random(5, 20, 10, 1);
    let error = f.contributors(&[3, 199, 200, u32::MAX]).unwrap_err();
    assert_eq!(error, ContributorsError::PixelOutOfImage { position: 2, pixel: 200, width: 20, height: 10 });
    let text = error.to_string();
    assert!(text.contains("pixels[2] is 200") && text.contains("20x10"), "{text}");
    assert!(f.contributors(&[u32::MAX]).is_err());
}

#[test]
fn no_pixels_and_no_gaussians_give_empty_lists() {
    let f = Fixture::random(5, 20, 10, 1);
    let none = f.contributors(&[]).unwrap();
    assert_eq!((none.len(), none.is_empty(), none.offsets.as_slice()), (0, true, [0u32].as_slice()));
    assert!(none.gather(&[0.5; 10], 2).is_empty());
    assert_eq!(none.scatter(&[], 5, 2), vec![0.0; 10]);
    let empty = Fixture::random(0, 20, 10, 1).contributors(&[7, 7, 0]).unwrap();
    assert_eq!(empty.offsets, [0, 0, 0, 0]);
    assert_eq!((empty.heaviest(1), empty.front(2)), (None, None));
    assert_eq!(empty.gather(&[], 2), vec![0.0; 6]);
    assert!(empty.scatter(&[1.0; 6], 0, 2).is_empty());
    assert!(Contributors::default().is_empty());
}

#[test]
fn poisoned_gaussians_contribute_nothing_and_affect_no_others() {
    let mut f = Fixture::random(60, 40, 30, 21);
    f.means[0] = f32::NAN;
    f.means[3] = f32::INFINITY;
    f.log_scales[3 * 2] = f32::NAN;
    f.log_scales[3 * 3 + 1] = f32::INFINITY;
    f.rotations[4 * 4] = f32::NAN;
    f.opacity_logits[5] = f32::NAN;
    f.opacity_logits[6] = f32::NEG_INFINITY;
    (f.means[24], f.means[25], f.means[26], f.opacity_logits[8]) = (0.0, 0.0, 0.0, 2.0);
    // Gaussians of size zero or without rotation are still drawn: the dilation alone gives them an extent
    f.log_scales[3 * 8..3 * 9].fill(f32::NEG_INFINITY);
    f.rotations[4 * 9..4 * 10].fill(0.0);
    assert!(f.check_against_reference(&f.all_pixels()) > 0.8);
    // a NaN colour is culled as well; the oracle does not consider colours
    f.sh[3 * 7] = f32::NAN;
    let lists = f.contributors(&f.all_pixels()).unwrap();
    assert!(lists.indices.iter().all(|&i| i > 7), "Gaussians 0 to 7 are culled");
    assert!(lists.indices.contains(&8), "a Gaussian of size zero is drawn");
    assert!(lists.weights.iter().all(|w| *w > 0.0 && *w <= 0.99));
}

#[test]
fn gaussians_at_one_depth_keep_the_order_of_their_indices() {
    let mut f = Fixture::random(1, 16, 16, 3);
    f.means = [0.0; 9].to_vec();
    f.rotations = [1.0, 0.0, 0.0, 0.0].repeat(3);
    f.log_scales = vec![-1.0; 9];
    f.opacity_logits = vec![0.0; 3];
    f.sh = vec![0.0; 9];
    let lists = f.contributors(&[8 * 16 + 8]).unwrap();
    assert_eq!(lists.row(0).0, [0, 1, 2]);
    let w = lists.row(0).1;
    assert!(w[0] > w[1] && w[1] > w[2]);
}

#[test]
fn heaviest_and_front_pick_by_weight_and_by_depth() {
    let lists = Contributors {
        offsets: vec![0, 3, 3, 5],
        indices: vec![4, 2, 9, 1, 0],
        weights: vec![0.1, 0.6, 0.2, 0.3, 0.3],
    };
    assert_eq!((lists.heaviest(0), lists.front(0)), (Some((2, 0.6)), Some((4, 0.1))));
    assert_eq!((lists.heaviest(1), lists.front(1)), (None, None));
    assert_eq!(lists.heaviest(2), Some((1, 0.3)), "ties go to the nearest");
    assert_eq!(lists.row(2), ([1, 0].as_slice(), [0.3, 0.3].as_slice()));
}

#[test]
fn scatter_over_many_ranges_adds_in_the_order_of_the_entries() {
    // enough values for the Gaussians to be split into several ranges
    let (n, pixels, channels) = (30_000usize, 500u32, 32usize);
    let mut r = Random(8);
    let indices: Vec<u32> =
        (0..pixels * 40).map(|k| if k % 3 == 0 { k % 7 } else { (r.next() % 30_000) as u32 }).collect();
    let weights: Vec<f32> = indices.iter().map(|_| r.range(0.0, 1.0)).collect();
    let lists = Contributors { offsets: (0..=pixels).map(|p| p * 40).collect(), indices, weights };
    let grads: Vec<f32> = (0..pixels as usize * channels).map(|_| r.range(-1.0, 1.0)).collect();
    let mut want = vec![0.0f32; n * channels];
    for (e, (&i, &w)) in lists.indices.iter().zip(&lists.weights).enumerate() {
        for c in 0..channels {
            want[i as usize * channels + c] += w * grads[e / 40 * channels + c];
        }
    }
    for threads in [1, 2, 3, 8] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert!(pool.install(|| lists.scatter(&grads, n, channels)) == want, "{threads} threads");
    }
}

#[test]
#[should_panic(expected = "Gaussian 9 is listed, but there are 9")]
fn scatter_to_too_few_gaussians_is_refused() {
    let lists = Contributors { offsets: vec![0, 1], indices: vec![9], weights: vec![0.5] };
    lists.scatter(&[1.0], 9, 1);
}
