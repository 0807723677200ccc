use super::*;
use crate::device::DeviceName;
use safetensors::tensor::TensorView;
use safetensors::{Dtype, serialize_to_file};
use std::collections::BTreeMap;

/// Type, shape and bytes of the tensors of a file, by name.
type Tensors = BTreeMap<String, (Dtype, Vec<usize>, Vec<u8>)>;

/// The first device of this build.
fn device() -> Device {
    DeviceName::all()[0].open().unwrap()
}

fn f32_tensor(shape: &[usize], values: impl Iterator<Item = f32>) -> (Dtype, Vec<usize>, Vec<u8>) {
    let count = shape.iter().product();
    let bytes: Vec<u8> = values.take(count).flat_map(f32::to_le_bytes).collect();
    (Dtype::F32, shape.to_vec(), bytes)
}

/// Reproducible noise in [0, 1).
fn noise(seed: u32) -> impl Iterator<Item = f32> {
    let mut state = seed;
    std::iter::repeat_with(move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32
    })
}

/// Random weights of `net` with non-negative heads; scaled to keep the features near one.
fn synthetic(net: LpipsNet) -> Tensors {
    let mut tensors = Tensors::new();
    let mut number = 0;
    for (index, stage) in net.stages().iter().enumerate() {
        for conv in stage.convs {
            let fan_in = conv.input * conv.kernel * conv.kernel;
            let scale = (24.0 / fan_in as f32).sqrt();
            let shape = [conv.output, conv.input, conv.kernel, conv.kernel];
            let weight = noise(number + 1).map(|v| (v - 0.5) * scale);
            tensors.insert(format!("net.conv{number}.weight"), f32_tensor(&shape, weight));
            let bias = noise(number + 100).map(|v| v * 0.1);
            tensors.insert(format!("net.conv{number}.bias"), f32_tensor(&[conv.output], bias));
            number += 1;
        }
        let channels = stage.convs[stage.convs.len() - 1].output;
        let head = f32_tensor(&[1, channels, 1, 1], noise(index as u32 + 200));
        tensors.insert(format!("lin{index}.weight"), head);
    }
    tensors
}

/// Only the first convolution's kernel, which is enough to identify the net.
fn stub(shape: [usize; 4]) -> Tensors {
    Tensors::from([("net.conv0.weight".to_owned(), f32_tensor(&shape, std::iter::repeat(0.1)))])
}

fn write(tensors: &Tensors) -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("weights.safetensors");
    let views = tensors
        .iter()
        .map(|(name, (dtype, shape, bytes))| (name.as_str(), TensorView::new(*dtype, shape.clone(), bytes).unwrap()));
    serialize_to_file(views, None, &path).unwrap();
    (dir, path)
}

fn load(tensors: &Tensors) -> Result<Lpips, LpipsError> {
    let (_dir, path) = write(tensors);
    Lpips::load(path, &device())
}

fn alex() -> Lpips {
    load(&synthetic(LpipsNet::Alex)).unwrap()
}

fn image(seed: u32, height: usize, width: usize) -> Vec<f32> {
    noise(seed).take(height * width * 3).collect()
}

#[test]
fn smallest_sides() {
    assert_eq!(LpipsNet::Alex.min_side(), 31);
    assert_eq!(LpipsNet::Vgg.min_side(), 16);
}

#[test]
fn a_distance_of_images() {
    let lpips = alex();
    assert_eq!(lpips.net(), LpipsNet::Alex);
    // the smallest image must pass through every layer, and height and width must not be mixed up
    for (height, width) in [(31, 31), (31, 45), (64, 40)] {
        let (a, b) = (image(1, height, width), image(2, height, width));
        let near: Vec<f32> = a.iter().zip(&b).map(|(a, b)| 0.95 * a + 0.05 * b).collect();
        assert_eq!(lpips.distance(&a, &a, height, width).unwrap(), 0.0);
        let (ab, ba) = (lpips.distance(&a, &b, height, width).unwrap(), lpips.distance(&b, &a, height, width).unwrap());
        assert!((ab - ba).abs() < 1e-6 * ab, "{ab} {ba}");
        let an = lpips.distance(&a, &near, height, width).unwrap();
        assert!(0.0 < an && an < 0.5 * ab, "{an} {ab}");
    }
}

#[test]
fn same_bits_on_any_thread_count() {
    let lpips = alex();
    let (a, b) = (image(3, 70, 90), image(4, 70, 90));
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| lpips.distance(&a, &b, 70, 90).unwrap().to_bits())
    };
    assert_eq!(on(1), on(2));
    assert_eq!(on(1), on(5));
}

#[test]
fn an_autodiff_device_is_taken() {
    let (_dir, path) = write(&synthetic(LpipsNet::Alex));
    let lpips = Lpips::load(path, &device().autodiff()).unwrap();
    let (a, b) = (image(1, 31, 31), image(2, 31, 31));
    let expected = alex().distance(&a, &b, 31, 31).unwrap();
    assert_eq!(lpips.distance(&a, &b, 31, 31).unwrap(), expected);
}

#[test]
fn a_value_that_is_not_finite_gives_nan() {
    let lpips = alex();
    let a = image(1, 31, 31);
    for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut b = a.clone();
        b[100] = poison;
        assert!(lpips.distance(&a, &b, 31, 31).unwrap().is_nan());
        assert!(lpips.distance(&b, &a, 31, 31).unwrap().is_nan());
    }
}

#[test]
fn images_of_a_wrong_size() {
    let lpips = alex();
    let a = image(1, 31, 31);
    let size = |result| matches!(result, Err(LpipsError::Size { .. }));
    assert!(size(lpips.distance(&a, &a[..30], 31, 31)));
    assert!(size(lpips.distance(&a, &a, 31, 32)));
    assert!(size(lpips.distance(&a, &a, usize::MAX, 3)));
    let small = image(1, 30, 60);
    let error = lpips.distance(&small, &small, 30, 60).unwrap_err();
    assert!(matches!(error, LpipsError::TooSmall { min: 31, .. }));
    assert!(error.to_string().contains("60x30"), "{error}");
}

#[test]
fn the_first_kernel_identifies_the_net() {
    for (shape, next) in [([64, 3, 11, 11], "net.conv0.bias"), ([64, 3, 3, 3], "net.conv0.bias")] {
        let error = load(&stub(shape)).unwrap_err();
        assert!(matches!(&error, LpipsError::Missing { tensor, .. } if tensor == next), "{error}");
    }
    let error = load(&stub([64, 3, 7, 7])).unwrap_err();
    assert!(matches!(&error, LpipsError::UnknownNet { found, .. } if *found == [64, 3, 7, 7]));
    let error = load(&Tensors::new()).unwrap_err();
    assert!(error.to_string().contains("net.conv0.weight"), "{error}");
}

#[test]
fn a_bad_tensor_is_named() {
    let good = synthetic(LpipsNet::Alex);

    let mut tensors = good.clone();
    tensors.remove("lin3.weight");
    let error = load(&tensors).unwrap_err();
    assert!(matches!(&error, LpipsError::Missing { tensor, .. } if tensor == "lin3.weight"));
    assert!(error.to_string().contains("weights.safetensors"), "{error}");

    let mut tensors = good.clone();
    tensors.insert("net.conv2.bias".to_owned(), f32_tensor(&[383], std::iter::repeat(0.0)));
    let error = load(&tensors).unwrap_err();
    assert!(error.to_string().contains("`net.conv2.bias` has shape [383], expected [384]"), "{error}");

    let mut tensors = good.clone();
    tensors.insert("net.conv4.bias".to_owned(), (Dtype::F64, vec![256], vec![0; 256 * 8]));
    let error = load(&tensors).unwrap_err();
    assert!(error.to_string().contains("`net.conv4.bias` holds F64"), "{error}");

    let mut tensors = good;
    let poisoned = noise(1).map(|v| if v > 0.99 { f32::NAN } else { v });
    tensors.insert("lin4.weight".to_owned(), f32_tensor(&[1, 256, 1, 1], poisoned.chain([f32::NAN])));
    tensors.insert("net.conv1.bias".to_owned(), f32_tensor(&[192], std::iter::repeat(f32::INFINITY)));
    let error = load(&tensors).unwrap_err();
    assert!(matches!(&error, LpipsError::NotFinite { tensor, .. } if tensor == "net.conv1.bias"));
}

#[test]
fn half_precision_equals_its_values_in_single() {
    let mut single = synthetic(LpipsNet::Alex);
    let mut half = single.clone();
    for (name, (_, shape, bytes)) in &mut single {
        let (chunks, _) = bytes.as_chunks::<4>();
        let rounded: Vec<_> = chunks.iter().map(|b| burn::tensor::f16::from_f32(f32::from_le_bytes(*b))).collect();
        let halves = rounded.iter().flat_map(|v| v.to_le_bytes()).collect();
        half.insert(name.clone(), (Dtype::F16, shape.clone(), halves));
        *bytes = rounded.iter().flat_map(|v| v.to_f32().to_le_bytes()).collect();
    }
    let (a, b) = (image(1, 31, 31), image(2, 31, 31));
    let distance = |tensors| load(tensors).unwrap().distance(&a, &b, 31, 31).unwrap();
    assert_eq!(distance(&half), distance(&single));
}

#[test]
fn a_file_cut_short() {
    let (_dir, path) = write(&stub([64, 3, 3, 3]));
    let bytes = std::fs::read(&path).unwrap();
    for length in [0, 7, 8, 40, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..length]).unwrap();
        let error = Lpips::load(&path, &device()).unwrap_err();
        assert!(matches!(error, LpipsError::Damaged { .. }), "{length}: {error}");
        assert!(error.to_string().contains("weights.safetensors"), "{error}");
    }
    std::fs::remove_file(&path).unwrap();
    assert!(matches!(Lpips::load(&path, &device()), Err(LpipsError::Read { .. })));
}

/// Checks the published example images against their published distances; needs the real weights.
#[test]
fn published_distances() {
    let Some(weights) = volseggs_testing::test_data("weights", volseggs_testing::Need::Weights) else { return };
    let png = |name: &str| {
        let image = image::open(weights.join("lpips-check").join(name)).unwrap().to_rgb8();
        let size = (image.height() as usize, image.width() as usize);
        (image.into_raw().iter().map(|v| f32::from(*v) / 255.0).collect::<Vec<_>>(), size)
    };
    let check = |file: &str, net: LpipsNet, pairs: &[(&str, &str, f64, f64)]| {
        let lpips = Lpips::load(weights.join(file), &device()).unwrap();
        assert_eq!(lpips.net(), net);
        for &(a, b, expected, tolerance) in pairs {
            let ((a, (height, width)), (b, _)) = (png(a), png(b));
            let distance = lpips.distance(&a, &b, height, width).unwrap();
            assert!((distance - expected).abs() < tolerance, "{net}: {distance}, expected {expected}");
        }
    };
    // the weights are stored in half precision, with which the published 0.657102 becomes 0.657140
    check("lpips_vgg16_v0.1_f16.safetensors", LpipsNet::Vgg, &[("apple.png", "pear.png", 0.657_140, 2e-6)]);
    let pairs = [("ex_ref.png", "ex_p0.png", 0.7219, 1e-4), ("ex_ref.png", "ex_p1.png", 0.1376, 1e-4)];
    check("lpips_alexnet_v0.1_f16.safetensors", LpipsNet::Alex, &pairs);
}
