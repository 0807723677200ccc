//! Tests of the region finder on small shaded pictures of known structures.

use super::*;
use proptest::prelude::*;

const SIDE: usize = 200;

/// A shaded ball: centre and radius in pixels, distance of its centre from the camera, colour.
struct Ball(f32, f32, f32, f32, [f32; 3]);

/// The nearest ball at each pixel, lit from the upper left, with depths.
fn balls(balls: &[Ball]) -> (Vec<f32>, Vec<f32>) {
    let (mut rgba, mut depth) = (vec![0.0; SIDE * SIDE * 4], vec![f32::NAN; SIDE * SIDE]);
    for pixel in 0..SIDE * SIDE {
        for Ball(x, y, radius, far, colour) in balls {
            let [dx, dy] = [(pixel % SIDE) as f32 - x, (pixel / SIDE) as f32 - y];
            let rest = radius * radius - dx * dx - dy * dy;
            let here = far - rest.max(0.0).sqrt();
            if rest > 0.0 && (depth[pixel].is_nan() || here < depth[pixel]) {
                depth[pixel] = here;
                let light = (-0.4 * dx - 0.4 * dy + 0.82 * rest.sqrt()) / radius;
                let shade = 0.25 + 0.6 * light.max(0.0);
                for (c, value) in colour.iter().enumerate() {
                    rgba[pixel * 4 + c] = (value * shade + 0.3 * light.max(0.0).powi(30)).min(1.0);
                }
                rgba[pixel * 4 + 3] = 0.9;
            }
        }
    }
    (rgba, depth)
}

fn find(rgba: &[f32], depth: Option<&[f32]>) -> Vec<RegionMask> {
    let image = RegionImage::from_rgba(SIDE as u32, SIDE as u32, rgba, depth).unwrap();
    find_regions(&image, &MasksConfig::default()).unwrap()
}

fn disc(x: f32, y: f32, radius: f32) -> Mask {
    let rows: Vec<bool> =
        (0..SIDE * SIDE).map(|p| ((p % SIDE) as f32 - x).hypot((p / SIDE) as f32 - y) < radius).collect();
    Mask::from_rows(SIDE as u32, SIDE as u32, &rows).unwrap()
}

fn has(found: &[RegionMask], wanted: &Mask) -> bool {
    found.iter().any(|region| region.mask.iou(wanted).unwrap() > 0.9)
}

const RED: [f32; 3] = [0.9, 0.2, 0.2];
const BLUE: [f32; 3] = [0.3, 0.5, 0.9];

#[test]
fn shaded_blobs_apart_are_one_mask_each() {
    let (rgba, depth) = balls(&[
        Ball(50.0, 50.0, 40.0, 100.0, RED),
        Ball(150.0, 60.0, 25.0, 100.0, BLUE),
        Ball(100.0, 150.0, 12.0, 100.0, RED),
    ]);
    for depth in [None, Some(depth.as_slice())] {
        let found = find(&rgba, depth);
        assert_eq!(found.len(), 3);
        assert!(found.iter().all(|region| region.level == 0 && region.stability_score > 0.8));
        assert!(found.windows(2).all(|pair| pair[0].mask.area() >= pair[1].mask.area()));
        for (x, y, radius) in [(50.0, 50.0, 40.0), (150.0, 60.0, 25.0), (100.0, 150.0, 12.0)] {
            assert!(has(&found, &disc(x, y, radius)));
        }
    }
}

#[test]
fn overlapping_balls_of_one_colour_are_separated_and_nested_in_the_whole() {
    let (rgba, depth) = balls(&[Ball(75.0, 90.0, 50.0, 200.0, BLUE), Ball(120.0, 105.0, 40.0, 100.0, BLUE)]);
    for depth in [None, Some(depth.as_slice())] {
        let found = find(&rgba, depth);
        assert!(has(&found, &disc(120.0, 105.0, 40.0)));
        assert_eq!(found.len(), 3, "the whole and the two balls");
        assert_eq!(found.iter().map(|region| region.level).collect::<Vec<_>>(), [0, 1, 1]);
    }
}

#[test]
fn depth_separates_regions_of_equal_colour() {
    let rgba = [0.5, 0.5, 0.5, 1.0].repeat(SIDE * SIDE);
    let depth: Vec<f32> =
        (0..SIDE * SIDE).map(|p| if p % SIDE < 80 { 4.0 } else { 6.0 } + 0.001 * (p / SIDE) as f32).collect();
    assert_eq!(find(&rgba, None).len(), 1);
    assert_eq!(
        find(&rgba, Some(&depth)).iter().map(|region| region.mask.bbox()[2]).collect::<Vec<_>>(),
        [200, 120, 80]
    );
}

#[test]
fn red_inside_translucent_blue_is_a_mask_of_its_own() {
    let at = |pixel: usize| [(pixel % SIDE) as f32 - 100.0, (pixel / SIDE) as f32 - 100.0];
    let inner: Vec<bool> = (0..SIDE * SIDE).map(at).map(|[x, y]| x.hypot(y * 2.0) < 40.0).collect();
    let mut rgba = vec![0.0; SIDE * SIDE * 4];
    for pixel in (0..SIDE * SIDE).filter(|&pixel| at(pixel)[0].hypot(at(pixel)[1]) < 70.0) {
        let value = if inner[pixel] { [0.7, 0.3, 0.4, 0.8] } else { [0.4, 0.6, 0.9, 0.4] };
        rgba[pixel * 4..][..4].copy_from_slice(&value);
    }
    let found = find(&rgba, None);
    assert_eq!(found.len(), 3);
    assert!(has(&found, &Mask::from_rows(SIDE as u32, SIDE as u32, &inner).unwrap()));
}

#[test]
fn specks_and_empty_images_give_no_masks() {
    assert!(find(&vec![0.0; SIDE * SIDE * 4], None).is_empty());
    let (rgba, _) = balls(&[Ball(30.0, 30.0, 2.0, 9.0, RED)]);
    assert!(find(&rgba, None).is_empty());
    let image = RegionImage::from_rgba(0, 0, &[], None).unwrap();
    assert!(find_regions(&image, &MasksConfig::default()).unwrap().is_empty());
}

#[test]
fn wrong_buffers_and_options_are_named() {
    let message = |result: Result<RegionImage, RegionError>| result.unwrap_err().to_string();
    assert!(message(RegionImage::from_rgba(3, 3, &[0.0; 10], None)).contains("rgba holds 10"));
    assert!(message(RegionImage::from_rgba(3, 3, &[0.0; 36], Some(&[0.0]))).contains("depth holds 1"));
    let image = RegionImage::from_rgba(1, 1, &[0.0; 4], None).unwrap();
    for (name, options) in [
        ("contrast", MasksConfig { contrast: f32::NAN, ..Default::default() }),
        ("min_area", MasksConfig { min_area: -1.0, ..Default::default() }),
    ] {
        assert!(find_regions(&image, &options).unwrap_err().to_string().contains(name));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn any_picture_gives_valid_masks_and_always_the_same(
        values in proptest::collection::vec(prop_oneof![8 => -0.2_f32..1.2, 1 => Just(f32::NAN), 1 => Just(f32::INFINITY)], 12 * 9 * 4),
        depth in proptest::collection::vec(prop_oneof![4 => -1.0_f32..9.0, 1 => Just(f32::NAN), 1 => Just(f32::MAX)], 12 * 9),
    ) {
        let image = RegionImage::from_rgba(12, 9, &values, Some(&depth)).unwrap();
        let options = MasksConfig { min_area: 5000.0, contrast: 0.01, ..Default::default() };
        let found = find_regions(&image, &options).unwrap();
        for region in &found {
            region.mask.validate().unwrap();
            prop_assert!((0.0..=1.0).contains(&region.stability_score) && (0.0..=1.0).contains(&region.contrast));
            for pixel in region.mask.pixels() {
                let alpha = values[pixel as usize * 4 + 3];
                prop_assert!(alpha.is_finite() && alpha >= 0.05, "background in a mask");
            }
        }
        prop_assert_eq!(found, find_regions(&image, &options).unwrap());
    }
}
