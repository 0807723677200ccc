//! One training step: choice of pixels, scales and neighbours; loss and gradients; Adam on the Gaussians touched.

use super::loss::{FEATURES, Facts, Feature, Loss, PairRule, PixelPairs, ScaleGate, contrast, through_unit, unit};
use super::model::SagaModel;
use super::smooth::{directions, flat, means_of, with_neighbours};
use super::{SagaError, SagaOptions};
use crate::points::nearest_rows::NearestRows;
use crate::points::neighbours::NeighbourGrid;
use crate::rng::{Purpose, Rng};
use crate::segment::fine::views::FineView;
use rayon::prelude::*;
use volseggs_kernels::splat::contributors::Contributors;

/// Decay rates of Adam's moments.
const BETAS: [f32; 2] = [0.9, 0.999];
/// Adam's guard against division by zero.
const EPSILON: f32 = 1e-15;
/// Marks a Gaussian that the step does not touch.
const NOWHERE: u32 = u32::MAX;

/// A vector of parameters with its Adam moments.
#[derive(Clone, Debug)]
pub(super) struct SagaParameter {
    pub(super) value: Feature,
    first: Feature,
    second: Feature,
    steps: i32,
}

impl SagaParameter {
    fn new(value: Feature) -> Self {
        Self { value, first: [0.0; FEATURES], second: [0.0; FEATURES], steps: 0 }
    }

    /// Takes one Adam step.
    fn step(&mut self, slope: &Feature, rate: f32) {
        self.steps += 1;
        let [one, two] = BETAS.map(|b| 1.0 - b.powi(self.steps));
        for (k, &g) in slope.iter().enumerate() {
            self.first[k] = BETAS[0] * self.first[k] + (1.0 - BETAS[0]) * g;
            self.second[k] = BETAS[1] * self.second[k] + (1.0 - BETAS[1]) * g * g;
            self.value[k] -= rate * (self.first[k] / one) / ((self.second[k] / two).sqrt() + EPSILON);
        }
    }
}

/// The data of one step.
pub(super) struct SagaBatch {
    /// Pixels and the T Gaussians that contribute to them, renumbered from 0.
    rows: Contributors,
    /// Averaging matrix from the features of S sources to those of the T Gaussians, `[T, S]`.
    smoothing: Contributors,
    /// Indices of the source Gaussians, `[S]`.
    pub(super) sources: Vec<u32>,
    pixels: PixelPairs,
    /// Ascending.
    scales: Vec<f32>,
    rule: PairRule,
}

/// A step's loss and gradients.
pub(super) struct SagaGradients {
    pub(super) loss: f64,
    /// With respect to the features of the sources, `[S]`.
    pub(super) sources: Vec<Feature>,
    pub(super) gate: ScaleGate,
}

/// Parameters and their training data.
pub(super) struct SagaTrainer<'a> {
    views: &'a [FineView],
    facts: Vec<Facts>,
    options: SagaOptions,
    /// The other Gaussians that a feature is averaged over, `[N, per - 1]`.
    neighbours: NearestRows,
    /// Their number, with the Gaussian itself.
    per: usize,
    pub(super) features: Vec<SagaParameter>,
    pub(super) gate: [SagaParameter; 2],
    /// Position of each Gaussian among the sources of the current step, `[N]`.
    place: Vec<u32>,
}

impl<'a> SagaTrainer<'a> {
    pub(super) fn new(views: &'a [FineView], means: &[f32], options: &SagaOptions) -> Result<Self, SagaError> {
        let per = options.neighbours.max(1);
        let neighbours = NeighbourGrid::adaptive(means)?.nearest_of_each(per - 1);
        let n = means.len() / 3;
        let shown = views.iter().flat_map(|v| &v.globals).max();
        assert!(shown.is_none_or(|&g| (g as usize) < n), "a view shows Gaussian {shown:?}, but there are only {n}");
        let mut rng = Rng::new(options.seed, 0, Purpose::GaussianFeatures);
        let features = (0..n).map(|_| SagaParameter::new(unit(std::array::from_fn(|_| rng.normal())).0)).collect();
        let gate = [0; 2].map(|_| SagaParameter::new(std::array::from_fn(|_| 2.0 * rng.uniform() - 1.0)));
        let facts = views.iter().map(Facts::of).collect();
        Ok(Self { views, facts, options: *options, neighbours, per, features, gate, place: vec![NOWHERE; n] })
    }

    /// Draws the pixels, scales and neighbours of a step on view `v`.
    pub(super) fn batch(&mut self, v: usize, rng: &mut Rng) -> SagaBatch {
        let (view, facts, options) = (&self.views[v], &self.facts[v], &self.options);
        let chosen = view.draw(options.pixels, rng);
        // the largest scale is always included
        let mut scales = vec![1.0];
        if !facts.scales.is_empty() {
            scales.extend((0..options.scales).map(|_| facts.scales[rng.below(facts.scales.len())]));
        }
        scales.sort_by(f32::total_cmp);
        scales.dedup();
        // the neighbours kept, at the same positions for every Gaussian
        let per = self.per;
        let kept = ((1.0 - options.dropout) * per as f32).round().clamp(1.0, per as f32) as usize;
        let mut columns: Vec<usize> = (0..per).collect();
        rng.shuffle(&mut columns);
        columns.truncate(kept);

        let mut rows = view.pixels.rows(&chosen);
        let (mut local, mut touched) = (vec![NOWHERE; view.globals.len()], Vec::new());
        rows.indices.iter_mut().for_each(|i| *i = number(&mut local, &mut touched, *i));
        let (mut sources, mut indices) = (Vec::new(), Vec::with_capacity(touched.len() * kept));
        for &t in &touched {
            let near: Vec<u32> = with_neighbours(&self.neighbours, view.globals[t as usize]).collect();
            indices.extend(columns.iter().map(|&c| number(&mut self.place, &mut sources, near[c])));
        }
        sources.iter().for_each(|&i| self.place[i as usize] = NOWHERE);
        let rule = PairRule { alike: options.hard_alike, apart: options.hard_apart, turn: rng.below(PairRule::TURNS) };
        SagaBatch {
            rows,
            smoothing: means_of(indices, kept),
            sources,
            pixels: PixelPairs::new(view, facts, &chosen),
            scales,
            rule,
        }
    }

    /// Returns the loss of a batch and its gradients.
    pub(super) fn loss(&self, batch: &SagaBatch) -> SagaGradients {
        let own: Vec<(Feature, f32)> =
            batch.sources.par_iter().map(|&i| unit(self.features[i as usize].value)).collect();
        let smooth = directions(&batch.smoothing.gather(&flat(&own), FEATURES));
        let rendered = batch.rows.gather(&flat(&smooth), FEATURES);
        let gate = self.gate();
        let Loss { loss, features, gate } = contrast(&rendered, &batch.pixels, &batch.scales, &gate, batch.rule);
        let by_smooth = back(&batch.rows.scatter(&features, smooth.len(), FEATURES), &smooth);
        let by_smooth: Vec<f32> = by_smooth.into_iter().flatten().collect();
        let sources = back(&batch.smoothing.scatter(&by_smooth, own.len(), FEATURES), &own);
        SagaGradients { loss, sources, gate }
    }

    /// Updates the features that `batch` touched, and the gate.
    pub(super) fn step(&mut self, batch: &SagaBatch, slopes: &SagaGradients) {
        let rate = self.options.rate;
        batch.sources.iter().zip(0..).for_each(|(&i, s)| self.place[i as usize] = s);
        self.features.par_iter_mut().zip(&self.place).filter(|(_, s)| **s != NOWHERE).for_each(|(feature, &s)| {
            feature.step(&slopes.sources[s as usize], rate);
        });
        batch.sources.iter().for_each(|&i| self.place[i as usize] = NOWHERE);
        self.gate[0].step(&slopes.gate.weight, rate);
        self.gate[1].step(&slopes.gate.bias, rate);
    }

    /// Returns the model learnt so far.
    pub(super) fn model(&self, means: &[f32]) -> SagaModel {
        let own: Vec<(Feature, f32)> = self.features.par_iter().map(|f| unit(f.value)).collect();
        SagaModel::new(&flat(&own), (&self.neighbours, self.per), self.gate(), means)
    }

    fn gate(&self) -> ScaleGate {
        ScaleGate { weight: self.gate[0].value, bias: self.gate[1].value }
    }
}

/// Returns the position of `i` in `list`, appending it if it is new; `place` holds the position of each index.
fn number(place: &mut [u32], list: &mut Vec<u32>, i: u32) -> u32 {
    let at = &mut place[i as usize];
    if *at == NOWHERE {
        *at = list.len() as u32;
        list.push(i);
    }
    *at
}

/// Returns gradients with respect to rows from those with respect to their directions `[R, 32]`.
fn back(slopes: &[f32], rows: &[(Feature, f32)]) -> Vec<Feature> {
    let slopes = slopes.par_chunks_exact(FEATURES).zip(rows);
    slopes.map(|(slope, row)| through_unit(&std::array::from_fn(|k| slope[k]), row)).collect()
}
