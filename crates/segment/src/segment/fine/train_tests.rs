//! The affinity field on two balls: gradients, what a click selects at each scale, thread counts, non-finite and bad
//! input.

use super::*;
use crate::config::types::SegmentConfig;
use crate::config::types::segment::ClickConfig;
use crate::device::DeviceName;
use crate::model::{HostGaussians, params};
use crate::segment::candidates::ClickCandidates;
use crate::segment::click;
use crate::segment::fine::extract::{Clustering, cluster};
use crate::segment::fine::network::{ENCODED, PositionBox};
use crate::segment::test_support::{APART, Balls, COUNT, TOUCHING, add, on_threads, rendering};
use rayon::prelude::*;
use volseggs_kernels::contrast::reference as contrast_reference;
use volseggs_kernels::decoder::{DecoderShape, reference as decoder_reference};

/// Default threshold of `volseggs segment pick`.
const THRESHOLD: f32 = 0.8;

fn device() -> Device {
    DeviceName::all()[0].open().unwrap()
}

fn quick(steps: usize) -> AffinityConfig {
    AffinityConfig { steps, pixels: 64, ..AffinityConfig::default() }
}

/// Weights and biases, layer by layer, in f64.
type Layers = [Vec<f64>; 6];

fn wide(values: Vec<f32>) -> Vec<f64> {
    values.into_iter().map(f64::from).collect()
}

fn layers(field: &AffinityField) -> Layers {
    [
        to_vec(field.first_weight.val()),
        to_vec(field.first_bias.val()),
        to_vec(field.second_weight.val()),
        to_vec(field.second_bias.val()),
        to_vec(field.output_weight.val()),
        to_vec(field.output_bias.val()),
    ]
    .map(wide)
}

/// A batch evaluated in f64 by the reference implementations of the decoder and of the contrastive loss.
struct Exact<'a> {
    batch: &'a AffinityBatch,
    shape: DecoderShape,
    /// The network's inputs, the repulsion of masks and the weight of each term of the loss.
    terms: Vec<(Vec<f64>, Repulsion, f64)>,
}

impl<'a> Exact<'a> {
    fn new(view: &FineView, batch: &'a AffinityBatch, options: &AffinityConfig, width: usize) -> Self {
        let inputs = |scales: &[f32]| -> Vec<f64> {
            let rows = view.encoded.chunks_exact(ENCODED).zip(scales);
            rows.flat_map(|(row, scale)| row.iter().copied().chain([*scale])).map(f64::from).collect()
        };
        let mut terms = vec![(inputs(&batch.scales), repulsion(options.margin), 1.0)];
        terms.extend(batch.larger.iter().map(|scales| (inputs(scales), Repulsion::None, options.hierarchy)));
        Self { batch, shape: DecoderShape { inputs: ENCODED + 1, width, head_sizes: vec![FEATURES] }, terms }
    }

    fn params(layers: &Layers) -> decoder_reference::DecoderParamsF64<'_> {
        let [w0, b0, w1, b1, w2, b2] = layers;
        decoder_reference::DecoderParamsF64 { w0, b0, w1, b1, w2, b2 }
    }

    fn loss(&self, layers: &Layers) -> f64 {
        let pixels = &self.batch.pixels;
        let term = |(inputs, repulsion, weight): &(Vec<f64>, Repulsion, f64)| {
            let features = decoder_reference::forward(&self.shape, Self::params(layers), inputs);
            let mut rendered = vec![0.0; pixels.len() * FEATURES];
            for p in 0..pixels.len() {
                let (indices, weights) = pixels.row(p);
                for (&i, &w) in indices.iter().zip(weights) {
                    for k in 0..FEATURES {
                        rendered[p * FEATURES + k] += f64::from(w) * features[i as usize * FEATURES + k];
                    }
                }
            }
            weight * contrast_reference::contrast(&rendered, &self.batch.masks, *repulsion)
        };
        self.terms.iter().map(term).sum()
    }

    /// Returns the gradient by central differences, entry by entry.
    fn quotients(&self, layers: &Layers) -> Layers {
        const STEP: f64 = 1e-5;
        std::array::from_fn(|layer| {
            let entries = (0..layers[layer].len()).into_par_iter();
            let quotient = |moved: &mut Layers, i: usize| {
                let at = layers[layer][i];
                let [up, down] = [STEP, -STEP].map(|step| {
                    moved[layer][i] = at + step;
                    self.loss(moved)
                });
                moved[layer][i] = at;
                (up - down) / (2.0 * STEP)
            };
            entries.map_init(|| layers.clone(), quotient).collect()
        })
    }
}

#[test]
fn gradients_of_all_parameters_match_difference_quotients() {
    let balls = Balls { count: 2, ..APART };
    let at = balls.gaussians();
    let view = &balls.prepared(&at)[1];
    for mask_scale in [MaskScale::Drawn, MaskScale::Own] {
        gradient(view, &AffinityConfig { pixels: 14, hierarchy: 0.7, mask_scale, ..AffinityConfig::default() });
    }
}

fn gradient(view: &FineView, options: &AffinityConfig) {
    let field = AffinityField::new(2, &device().autodiff());
    // a scale at which pixels of different masks repel
    let mut draws = (0..).map(|step| AffinityBatch::draw(view, options, &mut Rng::new(1, step, Purpose::Custom(3))));
    let batch = draws.find(|b| [0, 1].iter().all(|m| b.masks.contains(m))).unwrap();
    let (total, loss) = loss(&field, view, &batch, options);
    let found = loss.backward();
    let ours = [
        to_vec(field.first_weight.val().grad(&found).unwrap()),
        to_vec(field.first_bias.val().grad(&found).unwrap()),
        to_vec(field.second_weight.val().grad(&found).unwrap()),
        to_vec(field.second_bias.val().grad(&found).unwrap()),
        to_vec(field.output_weight.val().grad(&found).unwrap()),
        to_vec(field.output_bias.val().grad(&found).unwrap()),
    ]
    .map(wide);
    let layers = layers(&field);
    let exact = Exact::new(view, &batch, options, layers[1].len());
    assert!((exact.loss(&layers) - total).abs() < 1e-6, "{total}");
    for (inputs, ..) in &exact.terms {
        let kink = decoder_reference::kink_distance(&exact.shape, Exact::params(&layers), inputs);
        assert!(kink > 1e-4, "a hidden unit lies at its kink ({kink:.0e}): choose another seed");
    }
    for (k, (ours, exact)) in ours.iter().zip(&exact.quotients(&layers)).enumerate() {
        assert_eq!(ours.len(), exact.len());
        let scale = (exact.iter().map(|v| v * v).sum::<f64>() / exact.len() as f64).sqrt();
        let worst = ours.iter().zip(exact).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        println!("tensor {k}: {:.1e} of {scale:.1e}", worst / scale);
        assert!(scale > 1e-6 && worst < 1e-5 * scale, "tensor {k}: {worst:.1e} of {scale:.1e}");
    }
}

#[test]
fn own_scales_are_those_of_the_mask_each_gaussian_contributes_most_to() {
    let at = APART.gaussians();
    let views = APART.prepared(&at);
    let options = AffinityConfig { mask_scale: MaskScale::Own, pixels: 300, ..AffinityConfig::default() };
    let (mut parted, mut joined) = (0, 0);
    for step in 0..40 {
        let view = &views[step % views.len()];
        let batch = AffinityBatch::draw(view, &options, &mut Rng::new(1, step as u64, Purpose::Custom(3)));
        for (p, mask) in batch.masks.iter().enumerate() {
            let (indices, weights) = batch.pixels.row(p);
            let most = (0..indices.len()).max_by(|a, b| weights[*a].total_cmp(&weights[*b]));
            let Some(most) = most else { continue };
            // the balls are apart, so a Gaussian's mask is that of its own ball or that of both, whichever came first
            let scale = batch.scales[indices[most] as usize];
            assert_eq!(scale, view.scales[*mask as usize]);
        }
        if batch.masks.iter().all(|m| *m == 2) { joined += 1 } else { parted += 1 }
    }
    assert!(parted > 15 && joined > 3, "{parted} {joined}: the mask of both comes first in a third of the steps");
}

#[test]
fn names_of_mask_scales_are_read() {
    let read = |name: &str| serde_json::from_value::<MaskScale>(name.into()).map_err(|e| e.to_string());
    assert_eq!((read("drawn"), read("own")), (Ok(MaskScale::Drawn), Ok(MaskScale::Own)));
    assert!(read("small").unwrap_err().contains("drawn"));
    assert_eq!((repulsion(-1.0), repulsion(0.5)), (Repulsion::Cosine, Repulsion::Margin(0.5)));
}

/// A field trained on two balls.
struct Trained {
    at: HostGaussians,
    frame: PositionBox,
    field: AffinityField,
    camera: volseggs_kernels::PinholeCamera,
    balls: Balls,
}

impl Trained {
    fn on(balls: Balls) -> Self {
        let at = balls.gaussians();
        let (mut first, mut last) = (0.0, 0.0);
        // the features of the balls separate only after the first few hundred steps
        let field = train(&balls.prepared(&at), &quick(2000), 0, &device(), |step, loss| {
            first += if step < 200 { loss } else { 0.0 };
            last += if step >= 1800 { loss } else { 0.0 };
            true
        })
        .unwrap();
        assert!(last < 0.5 * first, "{first} -> {last}");
        Self { frame: PositionBox::around(&at.means), at, field, camera: balls.views()[0].0, balls }
    }

    /// Returns the Gaussian under a click on the centre of a ball.
    fn clicked(&self, ball: usize) -> usize {
        let camera = &self.camera;
        let centre = [if ball == 0 { -self.balls.apart } else { self.balls.apart } as f32, 0.0, 0.0];
        let [x, y, z] =
            [0, 1, 2].map(|r| (0..3).map(|k| camera.rotation[r][k] * centre[k]).sum::<f32>() + camera.translation[r]);
        let pixel = [camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy].map(|v| v as u32);
        let under =
            click::under(&self.at, rendering().seen_by(*camera), pixel, &ClickConfig::default(), &device()).unwrap();
        let found = click::heaviest(&under, |_| true).unwrap() as usize;
        assert_eq!(found / COUNT, ball, "the click hits the other ball");
        found
    }

    /// Returns the intersection over union of such a click's selection at `scale` with that ball, and with both.
    fn selects(&self, ball: usize, scale: f32) -> [f64; 2] {
        let clicked = self.clicked(ball);
        let all: Vec<u32> = (0..self.at.len() as u32).collect();
        let config = SegmentConfig::default();
        let of = ClickCandidates::new(&self.field, &self.frame, &self.at.means, &self.at, &all, &config);
        let found = of.alike(clicked, scale, THRESHOLD);
        [iou(&found, |i| i / COUNT == ball), iou(&found, |_| true)]
    }
}

fn iou(found: &[bool], truth: impl Fn(usize) -> bool) -> f64 {
    let count = |both: fn(bool, bool) -> bool| (0..found.len()).filter(|&i| both(found[i], truth(i))).count() as f64;
    count(|a, b| a && b) / count(|a, b| a || b)
}

#[test]
fn a_click_selects_its_ball_at_a_small_scale_and_both_at_the_largest() {
    let trained = Trained::on(APART);
    for ball in 0..2 {
        let [own, _] = trained.selects(ball, 0.0);
        let [_, both] = trained.selects(ball, 1.0);
        println!("ball {ball}: {own:.3} at scale 0, {both:.3} at scale 1");
        assert!(own >= 0.95 && both >= 0.95, "ball {ball}: {own:.3} at scale 0, {both:.3} at scale 1");
    }
}

#[test]
fn a_small_scale_separates_touching_balls_that_a_large_one_joins() {
    let trained = Trained::on(TOUCHING);
    let Trained { at, frame, field, .. } = &trained;
    for ball in 0..2 {
        let (small, large) = (trained.selects(ball, 0.1), trained.selects(ball, 0.9));
        println!("ball {ball}, its own and both: {small:.3?} at scale 0.1, {large:.3?} at scale 0.9");
        assert!(
            small[0] >= 0.95 && large[1] >= 0.95,
            "ball {ball}: {small:.3?} at scale 0.1, {large:.3?} at scale 0.9"
        );
    }
    for (clustering, seed) in [(Clustering::Density, 0), (Clustering::KMeans(2), 0), (Clustering::KMeans(2), 7)] {
        let labels = cluster(field, frame, &at.means, 0.1, clustering, seed, &|| true).unwrap();
        assert_eq!(labels.iter().max(), Some(&2), "{clustering:?}");
        for ball in 0..2 {
            let most = [1, 2].map(|label| {
                let found: Vec<bool> = labels.iter().map(|l| *l == label).collect();
                iou(&found, |i| i / COUNT == ball)
            });
            assert!(most[0].max(most[1]) >= 0.95, "{clustering:?}, ball {ball}: {most:?}");
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_bits_whatever_the_threads() {
    for mask_scale in [MaskScale::Drawn, MaskScale::Own] {
        same_bits(mask_scale);
    }
}

fn same_bits(mask_scale: MaskScale) {
    let at = APART.gaussians();
    let run = |threads, seed| {
        on_threads(threads, || {
            let options = AffinityConfig { hierarchy: 0.5, mask_scale, ..quick(12) };
            params::collect(&train(&APART.prepared(&at), &options, seed, &device(), |_, _| true).unwrap())
        })
    };
    let one = run(1, 0);
    assert!(run(3, 0) == one && run(8, 0) == one, "the number of threads changes the field");
    assert!(run(3, 1) != one, "another seed gives the same field");
}

#[test]
fn poison_is_never_selected_and_bad_input_is_refused() {
    let mut at = APART.gaussians();
    for poison in [f32::NAN, f32::INFINITY] {
        add(&mut at, [0.5, poison, 0.0], [-2.7; 3]);
    }
    let views = APART.prepared(&at);
    let field = train(&views, &quick(5), 0, &device(), |_, _| true).unwrap();
    let n = 2 * COUNT;
    let (frame, all) = (PositionBox::around(&at.means), (0..at.len() as u32).collect::<Vec<_>>());
    let config = SegmentConfig::default();
    let found = ClickCandidates::new(&field, &frame, &at.means, &at, &all, &config).alike(0, 0.5, -1.0);
    assert_eq!(found[n - 1..], [true, false, false]);
    assert!(matches!(train(&[], &quick(5), 0, &device(), |_, _| true), Err(FineError::NoMasks)));
    let wild = AffinityConfig { rate: f64::NAN, ..quick(5) };
    assert!(matches!(train(&views, &wild, 0, &device(), |_, _| true), Err(FineError::NotFinite { .. })));
}
