//! Tests against the published implementation: `tests/support/sam_reference.py` made the weights, inputs and outputs.

use super::image::{Enlarger, network_input, resize_rgb};
use super::prompt::{PointLabel, SamPrompt};
use super::*;
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors, serialize_to_file};
use std::path::PathBuf;

/// The network of the fixture; no two dimensions that could be confused are equal.
pub(in super::super) fn small() -> SamConfig {
    SamConfig {
        image_size: 64,
        embed_dims: [8, 16, 16, 24],
        depths: [1, 1, 2, 1],
        heads: [1, 2, 4, 3],
        windows: [1, 3, 4, 2],
        mlp_ratio: 2,
        expand_ratio: 3,
        prompt_dim: 16,
        decoder_depth: 2,
        decoder_heads: 2,
        decoder_mlp: 24,
        decoder_downsample: 2,
        candidates: 3,
        iou_depth: 3,
        iou_hidden: 12,
    }
}

pub(in super::super) fn fixture() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/sam.safetensors")
}

/// What the published implementation computes for an image.
struct Reference(Vec<u8>);

impl Reference {
    fn open(path: PathBuf) -> Self {
        Self(std::fs::read(path).unwrap())
    }

    fn raw(&self, name: &str) -> (Vec<usize>, Vec<u8>) {
        let file = SafeTensors::deserialize(&self.0).unwrap();
        let view = file.tensor(&format!("check.{name}")).unwrap();
        (view.shape().to_vec(), view.data().to_vec())
    }

    fn values(&self, name: &str) -> Vec<f32> {
        self.raw(name).1.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
    }

    /// RGB bytes, width, height.
    fn image(&self, name: &str) -> (Vec<u8>, usize, usize) {
        let (shape, bytes) = self.raw(name);
        (bytes, shape[1], shape[0])
    }

    fn embedding(&self, sam: &Sam) -> Embedding {
        let (rgb, width, height) = self.image("image");
        sam.encode(&rgb, width, height).unwrap()
    }

    /// The three prompts with their first `points` points, and their boxes if asked for.
    fn prompts(&self, points: usize, boxes: bool) -> Vec<SamPrompt> {
        let (at, labels, bounds) = (self.values("points"), self.values("labels"), self.values("boxes"));
        let point = |i: usize| {
            let label = if labels[i] == 1.0 { PointLabel::Inside } else { PointLabel::Outside };
            ([at[2 * i], at[2 * i + 1]], label)
        };
        let prompt = |b: usize| SamPrompt {
            points: (0..points).map(|p| point(2 * b + p)).collect(),
            bounds: boxes.then(|| [0, 1, 2, 3].map(|i| bounds[4 * b + i])),
        };
        (0..3).map(prompt).collect()
    }
}

/// The largest difference over the largest value.
fn difference(found: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(found.len(), expected.len());
    let scale = expected.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
    let off = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0_f32, |m, v| if v <= m { m } else { v });
    off / scale
}

fn close(what: &str, found: &[f32], expected: &[f32]) {
    let off = difference(found, expected);
    println!("{what}: {off:e}");
    assert!(off < 1e-4, "{what} is off by {off:e} of its largest value");
}

/// For the full size with random weights, where single pixels amplify rounding: the published decoder in single
/// precision differs from itself in double by 2e-4 of the largest logit.
fn close_on_average(what: &str, found: &[f32], expected: &[f32]) {
    println!("{what}, largest: {:e}", difference(found, expected));
    let power = |values: &mut dyn Iterator<Item = f32>| values.map(|v| f64::from(v).powi(2)).sum::<f64>().sqrt();
    let off = power(&mut found.iter().zip(expected).map(|(a, b)| a - b)) / power(&mut expected.iter().copied());
    println!("{what}, root mean square: {off:e}");
    assert!(off < 1e-4, "{what} is off by {off:e} on average");
}

fn sam() -> Sam {
    Sam::load(fixture(), &small(), &crate::device::DeviceName::all()[0].open().unwrap()).unwrap()
}

#[test]
fn the_image_is_resized_to_the_byte() {
    let reference = Reference::open(fixture());
    for (from, to) in [("image", "resized"), ("shrink.from", "shrink.to")] {
        let (rgb, width, height) = reference.image(from);
        let (expected, to_width, to_height) = reference.image(to);
        let frame = ImageFit::new(width, height, to_width.max(to_height)).unwrap();
        assert_eq!(frame.resized, [to_width, to_height]);
        assert_eq!(resize_rgb(&rgb, frame.original, frame.resized), expected);
    }
}

#[test]
fn every_stage_equals_the_published_one() {
    let (sam, reference) = (sam(), Reference::open(fixture()));
    let image = reference.embedding(&sam);
    close("embedding", &host(image.features.clone()).unwrap(), &reference.values("embedding"));
    // the reference has channels first
    close("cells", &host(sam.cells.clone().swap_dims(1, 2)).unwrap(), &reference.values("cells"));
    let zeros = image.features.zeros_like();
    close("dense", &host(sam.prompt.with_no_mask(zeros)).unwrap(), &reference.values("dense"));
    for (name, points, boxes, multimask) in
        [("points", 2, false, true), ("single", 2, false, false), ("both", 1, true, true), ("boxes", 0, true, true)]
    {
        let prompts = reference.prompts(points, boxes);
        let sparse = sam.prompt.sparse(&prompts, &image.frame).unwrap();
        close(name, &host(sparse).unwrap(), &reference.values(&format!("{name}.sparse")));
        let found = sam.predict(&image, &prompts, multimask).unwrap();
        close(name, &found.logits, &reference.values(&format!("{name}.logits")));
        close(name, &found.iou, &reference.values(&format!("{name}.iou")));
        // alone or in a batch, a prompt gives the same
        let last = sam.predict(&image, &prompts[2..], multimask).unwrap();
        close(name, &last.logits, &found.logits[2 * last.logits.len()..]);
    }
}

#[test]
fn masks_at_full_size_equal_the_published_ones() {
    let (sam, reference) = (sam(), Reference::open(fixture()));
    let image = reference.embedding(&sam);
    let found = sam.predict(&image, &reference.prompts(2, false), true).unwrap();
    let enlarger = Enlarger::new(found.side, image.frame());
    let full: Vec<f32> = (0..3).flat_map(|c| enlarger.enlarge(found.candidate(0, c))).collect();
    close("full size", &full, &reference.values("points.full"));
    for (i, expected) in reference.values("points.stability").into_iter().enumerate() {
        let logits = enlarger.enlarge(found.candidate(i / 3, i % 3));
        let expected = if expected.is_nan() { 0.0 } else { expected };
        assert!((automatic::stability_score(&logits, 1.0) - expected).abs() < 1e-3);
    }
}

#[test]
fn the_automatic_mode_finds_the_published_masks() {
    let (sam, reference) = (sam(), Reference::open(fixture()));
    let (rgb, width, height) = reference.image("image");
    let limits = reference.values("automatic.limits");
    let options = AutomaticOptions {
        points_per_side: 3,
        points_per_batch: 4,
        keep: KeptCandidates::All,
        predicted_iou: limits[0],
        stability: limits[1],
        stability_offset: 0.1,
        box_overlap: limits[2],
    };
    let found = generate(&sam, &rgb, width, height, &options).unwrap();
    let iou = reference.values("grid.iou");
    let expected: Vec<usize> = reference.values("automatic.index").iter().map(|&i| i as usize).collect();
    assert!(expected.len() > 2);
    assert_eq!(found.len(), expected.len());
    let points = automatic::point_grid(3, width, height);
    let counts = reference.values("automatic.counts");
    let (lengths, mut counts) = counts.split_at(expected.len());
    for (n, (mask, &i)) in found.iter().zip(&expected).enumerate() {
        assert_eq!(mask.point, points[i / 3]);
        assert!((mask.predicted_iou - iou[i]).abs() < 1e-4);
        assert!((mask.stability - reference.values("automatic.stability")[n]).abs() < 1e-3);
        let (own, rest) = counts.split_at(lengths[n] as usize);
        assert_eq!(mask.mask.counts, own.iter().map(|&c| c as u32).collect::<Vec<_>>());
        counts = rest;
    }
    // the batch's size must not matter
    let again = generate(&sam, &rgb, width, height, &AutomaticOptions { points_per_batch: 100, ..options.clone() });
    assert_eq!(again.unwrap(), found);
    let fewer = AutomaticOptions { keep: KeptCandidates::MostConfident, box_overlap: 1.0, stability: 0.0, ..options };
    let best = generate(&sam, &rgb, width, height, &fewer).unwrap();
    assert!(!best.is_empty() && best.len() <= 9, "{}", best.len());
}

#[test]
fn same_bits_on_any_thread_count() {
    let reference = Reference::open(fixture());
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let sam = sam();
            sam.predict(&reference.embedding(&sam), &reference.prompts(2, false), true).unwrap()
        })
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn no_prompts_give_no_masks() {
    let (sam, reference) = (sam(), Reference::open(fixture()));
    let none = sam.predict(&reference.embedding(&sam), &[], true).unwrap();
    assert_eq!((none.prompts, none.logits.len(), none.iou.len()), (0, 0, 0));
}

#[test]
fn bad_prompts_and_options_are_named() {
    let (sam, reference) = (sam(), Reference::open(fixture()));
    let image = reference.embedding(&sam);
    let point = SamPrompt::point([3.0, 4.0]);
    let boxed = SamPrompt { bounds: Some([0.0, 0.0, 9.0, 9.0]), ..point.clone() };
    for bad in [SamPrompt::default(), boxed, SamPrompt::point([f32::NAN, 1.0]), SamPrompt::point([1.0, f32::INFINITY])]
    {
        let error = sam.predict(&image, &[point.clone(), bad], true).unwrap_err();
        assert!(matches!(error, SamError::Prompt { index: 1, .. }), "{error}");
    }
    let options = AutomaticOptions { points_per_batch: 0, ..AutomaticOptions::default() };
    let error = generate(&sam, &[0; 12], 2, 2, &options).unwrap_err();
    assert!(error.to_string().contains("points_per_batch"), "{error}");
    assert!(matches!(sam.encode(&[0; 11], 2, 2), Err(SamError::ImageSize { found: 11, .. })));
    assert!(matches!(sam.encode(&[], 0, 0), Err(SamError::ImageShape { .. })));
}

/// The error of loading the fixture's weights with one tensor changed, or removed for `None`.
fn load_with(name: &str, change: Option<(Dtype, Vec<usize>, Vec<u8>)>) -> SamError {
    let bytes = std::fs::read(fixture()).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    assert!(file.tensor(name).is_ok(), "{name}");
    let mut tensors: Vec<(&str, TensorView<'_>)> = file.iter().filter(|(n, _)| *n != name).collect();
    if let Some((dtype, shape, bytes)) = &change {
        tensors.push((name, TensorView::new(*dtype, shape.clone(), bytes).unwrap()));
    }
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("weights.safetensors");
    serialize_to_file(tensors, None, &path).unwrap();
    let error = Sam::load(&path, &small(), &crate::device::DeviceName::all()[0].open().unwrap()).unwrap_err();
    let text = error.to_string();
    assert!(text.contains("weights.safetensors") && text.contains(name), "{text}");
    error
}

#[test]
fn every_weight_is_asked_for_by_name() {
    let bytes = std::fs::read(fixture()).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let mut names: Vec<&str> = file.names();
    names.retain(|n| !n.starts_with("check."));
    assert!(names.len() > 200);
    // a stride through all, to keep the test short
    names.sort_unstable();
    for name in names.into_iter().step_by(7) {
        assert!(matches!(load_with(name, None), SamError::Missing { .. }));
    }
}

#[test]
fn a_bad_tensor_is_named() {
    let f32s = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let name = "mask_decoder.transformer.layers.0.self_attn.q_proj.bias";
    let error = load_with(name, Some((Dtype::F32, vec![15], f32s(&[0.0; 15]))));
    assert!(error.to_string().contains("has shape [15], expected [16]"), "{error}");
    let error = load_with(name, Some((Dtype::F64, vec![16], vec![0; 128])));
    assert!(matches!(&error, SamError::Type { found, .. } if found == "F64"), "{error}");
    let error = load_with(name, Some((Dtype::F32, vec![16], f32s(&[f32::NAN; 16]))));
    assert!(matches!(error, SamError::NotFinite { .. }), "{error}");
    let variance = "image_encoder.patch_embed.seq.0.bn.running_var";
    let error = load_with(variance, Some((Dtype::F32, vec![4], f32s(&[1.0, -1.0, 1.0, 1.0]))));
    assert!(matches!(error, SamError::NotFinite { .. }), "{error}");
}

#[test]
fn a_file_of_another_kind() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("mobile_sam.pt");
    std::fs::write(&path, b"PK\x03\x04 a zip archive").unwrap();
    let error = Sam::load(&path, &small(), &crate::device::DeviceName::all()[0].open().unwrap()).unwrap_err();
    assert!(error.to_string().contains("save_file"), "{error}");
    std::fs::remove_file(&path).unwrap();
    assert!(matches!(
        Sam::load(&path, &small(), &crate::device::DeviceName::all()[0].open().unwrap()),
        Err(SamError::Read { .. })
    ));
    // the small weights are not the published network's
    let error =
        Sam::load(fixture(), &SamConfig::default(), &crate::device::DeviceName::all()[0].open().unwrap()).unwrap_err();
    assert!(matches!(error, SamError::Shape { .. }), "{error}");
}

/// The full-size network with random weights, made by the script's `--full`; prints times.
#[test]
fn the_full_size_network() {
    let Some(path) = std::env::var_os("VOLSEGGS_TEST_SAM") else {
        let missing = "VOLSEGGS_TEST_SAM is not set; name a file that `tests/support/sam_reference.py --full` wrote";
        volseggs_testing::skip(volseggs_testing::Need::Sam, missing);
        return;
    };
    let path = PathBuf::from(path);
    let reference = Reference::open(path.clone());
    let timed = |what: &str, start: std::time::Instant| println!("{what}: {:.2} s", start.elapsed().as_secs_f64());
    let start = std::time::Instant::now();
    let sam = Sam::load(path, &SamConfig::default(), &crate::device::DeviceName::all()[0].open().unwrap()).unwrap();
    timed("load", start);
    let (rgb, width, height) = reference.image("image");
    let frame = ImageFit::new(width, height, 1024).unwrap();
    let start = std::time::Instant::now();
    network_input(&rgb, &frame).unwrap();
    timed("resize", start);
    let start = std::time::Instant::now();
    let image = reference.embedding(&sam);
    timed("encode", start);
    close("embedding", &host(image.features.clone()).unwrap(), &reference.values("embedding"));
    let prompts = reference.prompts(2, false);
    let found = sam.predict(&image, &prompts, true).unwrap();
    let expected = reference.values("points.logits");
    close_on_average("logits", &found.logits[..expected.len()], &expected);
    close_on_average("iou", &found.iou, &reference.values("points.iou"));
    let start = std::time::Instant::now();
    let full = Enlarger::new(found.side, image.frame()).enlarge(found.candidate(0, 0));
    timed("enlarge one mask", start);
    close_on_average("full size", &full, &reference.values("points.full"));
    for count in [1, 4] {
        use rayon::prelude::*;
        let prompts = vec![SamPrompt::point([100.0, 200.0]); count];
        let start = std::time::Instant::now();
        (0..16 / count).into_par_iter().for_each(|_| {
            sam.predict(&image, &prompts, true).unwrap();
        });
        timed(&format!("decode 16 points, batches of {count} in parallel"), start);
    }
    for count in [1, 4, 16] {
        let prompts = vec![SamPrompt::point([100.0, 200.0]); count];
        let start = std::time::Instant::now();
        sam.predict(&image, &prompts, true).unwrap();
        timed(&format!("decode {count} points"), start);
    }
}
