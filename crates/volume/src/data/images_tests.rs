//! Filtering, compositing and every kind of PNG.

use super::*;
use image::{DynamicImage, Rgba, RgbaImage};

fn set(width: u32, height: u32, pixels: &[[u8; 4]]) -> ImageSet {
    ImageSet { width, height, pixels: pixels.concat() }
}

#[test]
fn area_filter_weights_by_alpha_and_rounds() {
    let clear_red = [255, 0, 0, 0];
    let blue = [0, 0, 255, 255];
    let small = set(2, 2, &[clear_red, blue, clear_red, blue]).downscale(2).unwrap();
    assert_eq!(small.pixels, [0, 0, 255, 128]);
    let small = set(2, 2, &[[1, 0, 0, 255], [1, 0, 0, 255], [0, 0, 0, 255], [0; 4]]).downscale(2).unwrap();
    assert_eq!(small.pixels, [1, 0, 0, 191]);
    assert_eq!(set(2, 2, &[clear_red; 4]).downscale(2).unwrap().pixels, [0; 4]);
    let two = set(2, 1, &[[1, 2, 3, 4], [5, 6, 7, 8], [9, 10, 11, 12], [13, 14, 15, 16]]);
    assert_eq!((two.len(), two.downscale(1).unwrap()), (2, two.clone()));
    let text = two.downscale(2).unwrap_err().to_string();
    assert!(text.contains("2 does not divide the image size 2x1") && text.contains("use one of 1"), "{text}");
    assert!(two.downscale(0).is_err());
}

#[test]
fn composites_straight_alpha() {
    let one = set(2, 1, &[[255, 0, 51, 255], [255, 255, 0, 51]]);
    let (mut rgb, mut alpha) = ([0.0; 6], [0.0; 2]);
    one.composite(0, [0.0, 0.5, 1.0], &mut rgb);
    for (got, want) in rgb.iter().zip([1.0, 0.0, 0.2, 0.2, 0.6, 0.8]) {
        assert!((got - want).abs() < 1e-6, "{rgb:?}");
    }
    one.alpha(0, &mut alpha);
    assert!((alpha[0] - 1.0).abs() < 1e-6 && (alpha[1] - 0.2).abs() < 1e-6);
}

#[test]
#[should_panic(expected = "height * width * 3")]
fn composite_checks_the_length() {
    set(1, 1, &[[0; 4]]).composite(0, [0.0; 3], &mut [0.0; 4]);
}

#[test]
fn every_bit_depth_and_colour_type_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let rgba = DynamicImage::ImageRgba8(RgbaImage::from_pixel(2, 2, Rgba([10, 200, 10, 128])));
    let kinds = [
        DynamicImage::ImageRgba16(rgba.to_rgba16()),
        DynamicImage::ImageRgb8(rgba.to_rgb8()),
        DynamicImage::ImageRgb16(rgba.to_rgb16()),
        DynamicImage::ImageLuma8(rgba.to_luma8()),
        rgba,
    ];
    let paths: Vec<PathBuf> = (0..kinds.len()).map(|i| folder.path().join(format!("{i}.png"))).collect();
    for (image, path) in kinds.iter().zip(&paths) {
        image.save(path).unwrap();
    }
    let load = |which: &[usize], downscale| {
        let paths: Vec<PathBuf> = which.iter().map(|i| paths[*i].clone()).collect();
        ImageSet::load(Path::new("t.json"), &paths, downscale)
    };
    let set = load(&[1, 2, 3], 1).unwrap();
    assert_eq!((set.len(), set.is_empty()), (3, false));
    assert_eq!(&set.frame(0)[..4], [10, 200, 10, 255]);
    assert_eq!(&set.frame(1)[..4], [10, 200, 10, 255]);
    assert_eq!(set.frame(2)[3], 255);
    let set = load(&[0, 4], 1).unwrap();
    assert_eq!((&set.frame(0)[..4], set.frame(0)), (&[10, 200, 10, 128][..], set.frame(1)));
    assert_eq!(load(&[0, 4], 2).unwrap().width, 1);
    for mixed in [[0, 1], [3, 4]] {
        let text = load(&mixed, 1).unwrap_err().to_string();
        let words = ["has no alpha channel, but ", ".png has one", "frame 1", "Hint: "];
        assert!(words.iter().all(|w| text.contains(w)), "{text}");
    }
    assert!(ImageSet::load(Path::new("t.json"), &[], 1).unwrap().is_empty());
}

#[test]
fn images_that_do_not_fit_into_memory_are_refused_before_they_are_decoded() {
    let json = Path::new("transforms_train.json");
    let check =
        |count, downscale| check_memory(json, count, (2000, 2000), downscale, MemoryBudget::from_bytes(8_000_000_000));
    let text = check(600, 1).unwrap_err().to_string();
    let words =
        ["transforms_train.json", "`data.downscale`", "1 keeps 600 images of 2000x2000", "--memory", "larger factor"];
    assert!(words.iter().all(|w| text.contains(w)), "{text}");
    check(600, 8).unwrap();
    // a size that a damaged header may claim
    let huge = check_memory(json, usize::MAX, (u32::MAX, u32::MAX), 1, MemoryBudget::from_bytes(u64::MAX));
    assert!(huge.is_err());
}

#[test]
fn a_small_file_that_claims_a_large_image_is_refused_by_its_header() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("r_0.png");
    std::fs::write(&path, crate::data::fixture::claims_to_be(60_000, 30_000).unwrap()).unwrap();
    let claims = |text: String| assert!(text.contains("60000x30000 pixels, more than its"), "{text}");
    claims(decode(&path).unwrap_err());
    claims(ImageSet::load(Path::new("t.json"), &[path], 1).unwrap_err().to_string());
}

#[test]
#[cfg(target_os = "linux")]
fn a_pipe_is_refused_without_hanging() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("r_0.png");
    rustix::fs::mknodat(rustix::fs::CWD, &path, rustix::fs::FileType::Fifo, rustix::fs::Mode::RUSR, 0).unwrap();
    let text = ImageSet::load(Path::new("t.json"), &[path], 1).unwrap_err().to_string();
    assert!(text.contains("a pipe, not a regular file"), "{text}");
}
