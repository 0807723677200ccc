//! Training data of the affinity field: for each view of a coarse segment alone, sampled pixels, the Gaussians that
//! contribute to them, and the masks that cover them. The geometry is fixed, so all of it is computed once.

use super::network::PositionBox;
use crate::model::{HostGaussians, Rendering, ToKernel};
use crate::rng::{Purpose, Rng};
use crate::segment::masks::{Mask, MaskReader, StoreError};
use burn::tensor::Device;
use volseggs_kernels::splat::SplatSettings;
use volseggs_kernels::splat::contributors::{Contributors, ContributorsError, contributors};

/// Maximum number of pixels kept of a view.
const PIXELS: usize = 16_384;
/// Contributions below this fraction of a pixel are skipped: they cost time and change nothing visible.
const FAINT: f32 = 1e-3;

/// A coarse segment seen from a camera.
#[derive(Clone, Debug)]
pub struct MaskedView {
    /// Indices of the segment's Gaussians.
    pub members: Vec<u32>,
    /// The camera and how the segment is rendered.
    pub settings: SplatSettings,
    /// Masks of the image of the segment alone.
    pub masks: Vec<Mask>,
}

/// A view ready for training.
#[derive(Clone, Debug)]
pub struct FineView {
    /// Encoded positions of the M Gaussians that contribute to its pixels, `[M, 24]`.
    pub(super) encoded: Vec<f32>,
    /// Indices of these Gaussians in the scene, `[M]`.
    pub(in crate::segment) globals: Vec<u32>,
    /// A row for each of the P kept pixels; indices refer to `encoded` and `globals`.
    pub(in crate::segment) pixels: Contributors,
    /// Where each pixel's list of masks starts, `[P + 1]`.
    pub(super) offsets: Vec<u32>,
    /// Masks that cover each pixel, from small to large.
    pub(in crate::segment) covering: Vec<u32>,
    /// For each mask, the spread of its Gaussians, scene units; after [`rank_scales`], its rank among the masks of all
    /// views, in [0, 1].
    pub(in crate::segment) scales: Vec<f32>,
}

impl FineView {
    /// Finds the Gaussians and masks of the pixels of `view`; `None` if no mask covers any pixel.
    ///
    /// # Errors
    /// If there are more contributions than 32-bit offsets can count.
    pub fn new(
        at: &HostGaussians,
        frame: &PositionBox,
        view: &MaskedView,
        number: u64,
        seed: u64,
        device: &Device,
    ) -> Result<Option<Self>, ContributorsError> {
        let SplatSettings { camera, .. } = view.settings;
        let mut covered = vec![false; camera.width * camera.height];
        for pixel in view.masks.iter().flat_map(Mask::pixels) {
            if let Some(covered) = covered.get_mut(pixel as usize) {
                *covered = true;
            }
        }
        let mut pixels: Vec<u32> = (0..covered.len() as u32).filter(|&p| covered[p as usize]).collect();
        Rng::new(seed, number, Purpose::AffinityPixels).shuffle(&mut pixels);
        pixels.truncate(PIXELS);
        pixels.sort_unstable();
        if pixels.is_empty() {
            return Ok(None);
        }
        let alone = at.subset(&view.members);
        let found = contributors(&alone.to_splat(device), &view.settings, &pixels)?;
        let (local, rows) = compact(&found);
        let means: Vec<f32> = local.iter().flat_map(|&i| &alone.means[3 * i as usize..][..3]).copied().collect();

        let place: std::collections::HashMap<u32, usize> = pixels.iter().copied().zip(0..).collect();
        let inside: Vec<Vec<usize>> =
            view.masks.iter().map(|m| m.pixels().filter_map(|p| place.get(&p).copied()).collect()).collect();
        let scales: Vec<f32> = inside.iter().map(|rows_of| spread(&rows, rows_of, &means)).collect();
        let mut order: Vec<usize> = (0..inside.len()).filter(|&m| !inside[m].is_empty()).collect();
        order.sort_by(|&a, &b| scales[a].total_cmp(&scales[b]).then(a.cmp(&b)));
        let mut lists = vec![Vec::new(); pixels.len()];
        for &m in &order {
            inside[m].iter().for_each(|&p| lists[p].push(m as u32));
        }
        let mut offsets = vec![0];
        let mut covering = Vec::new();
        for list in lists {
            covering.extend(list);
            offsets.push(covering.len() as u32);
        }
        let globals = local.iter().map(|&i| view.members[i as usize]).collect();
        Ok(Some(Self { encoded: frame.encode(&means), globals, pixels: rows, offsets, covering, scales }))
    }

    /// Draws `count` of the kept pixels, repeats allowed; all of them, in order, if there are not more.
    pub(in crate::segment) fn draw(&self, count: usize, rng: &mut Rng) -> Vec<usize> {
        let all = self.pixels.len();
        if all <= count { (0..all).collect() } else { (0..count).map(|_| rng.below(all)).collect() }
    }

    /// Returns the masks that cover pixel `p`, from small to large.
    pub(in crate::segment) fn covering(&self, p: usize) -> &[u32] {
        &self.covering[self.offsets[p] as usize..self.offsets[p + 1] as usize]
    }

    /// Returns the mask of pixel `p` at `scale`: the smallest one not below it, or else the largest.
    pub(super) fn mask(&self, p: usize, scale: f32) -> u32 {
        let list = self.covering(p);
        let found = list.iter().find(|&&m| self.scales[m as usize] >= scale).or(list.last());
        found.copied().unwrap_or(0)
    }
}

/// Reads all training data from a file of masks: each view of each of its segments, scales ranked, and the spreads of
/// all masks, ascending. `at` is the scene, `rendering` how it is drawn; `members` holds the Gaussians of the file's
/// segments, in its order; `progress` receives each view's number.
///
/// # Errors
/// If the file is damaged, or as [`FineView::new`].
pub fn read_views(
    masks: &MaskReader,
    (at, rendering): (&HostGaussians, Rendering),
    frame: &PositionBox,
    members: &[Vec<u32>],
    seed: u64,
    device: &Device,
    mut progress: impl FnMut(usize),
) -> Result<(Vec<FineView>, Vec<f32>), ViewsError> {
    let header = masks.header();
    let mut views = Vec::new();
    for (i, view) in header.views.iter().enumerate() {
        let annotations = masks.view(i)?;
        // colours do not affect which Gaussians contribute to a pixel
        let settings = rendering.flat().seen_by(view.camera(header.width, header.height).to_kernel());
        for (k, members) in (0..).zip(members) {
            let masks = annotations.iter().filter(|a| a.segment == k).map(|a| a.mask.clone()).collect();
            let masked = MaskedView { members: members.clone(), settings, masks };
            let number = (i * header.segments.len()) as u64 + u64::from(k);
            views.extend(FineView::new(at, frame, &masked, number, seed, device)?);
        }
        progress(i);
    }
    let spreads = rank_scales(&mut views);
    Ok((views, spreads))
}

/// Why masks cannot be read for training.
#[derive(Debug, thiserror::Error)]
pub enum ViewsError {
    /// The file of masks cannot be read.
    #[error(transparent)]
    Masks(#[from] StoreError),
    /// The Gaussians of a view's pixels cannot be listed.
    #[error(transparent)]
    Pixels(#[from] ContributorsError),
}

/// Replaces each mask's spread by its rank among the masks of all views, in [0, 1], and returns the spreads, ascending.
pub fn rank_scales(views: &mut [FineView]) -> Vec<f32> {
    let used = |v: &FineView| v.covering.iter().map(|&m| v.scales[m as usize]).collect::<Vec<_>>();
    let mut all: Vec<f32> = views
        .iter()
        .flat_map(|v| {
            let mut seen = used(v);
            seen.sort_by(f32::total_cmp);
            seen.dedup();
            seen
        })
        .collect();
    all.sort_by(f32::total_cmp);
    let last = all.len().saturating_sub(1).max(1) as f32;
    for view in views {
        for scale in &mut view.scales {
            *scale = all.partition_point(|s| s < scale) as f32 / last;
        }
    }
    all
}

/// Returns the Gaussians that contribute to any pixel, and the lists with indices into them, without faint
/// contributions.
fn compact(found: &Contributors) -> (Vec<u32>, Contributors) {
    let mut local: Vec<u32> =
        found.indices.iter().zip(&found.weights).filter(|(_, w)| **w >= FAINT).map(|(i, _)| *i).collect();
    local.sort_unstable();
    local.dedup();
    let mut out = Contributors { offsets: vec![0], ..Contributors::default() };
    for p in 0..found.len() {
        let (indices, weights) = found.row(p);
        for (i, &w) in indices.iter().zip(weights).filter(|(_, w)| **w >= FAINT) {
            out.indices.push(local.partition_point(|l| l < i) as u32);
            out.weights.push(w);
        }
        out.offsets.push(out.indices.len() as u32);
    }
    (local, out)
}

/// Returns the length of the vector of standard deviations of the means of a mask's Gaussians (the paper's 3D mask
/// scale), each weighted by its contribution to the mask's pixels.
fn spread(rows: &Contributors, pixels: &[usize], means: &[f32]) -> f32 {
    let (mut total, mut sum, mut square) = (0.0f64, [0.0f64; 3], [0.0f64; 3]);
    for &p in pixels {
        let (indices, weights) = rows.row(p);
        for (&i, &w) in indices.iter().zip(weights) {
            let w = f64::from(w);
            total += w;
            for k in 0..3 {
                let x = f64::from(means[3 * i as usize + k]);
                sum[k] += w * x;
                square[k] += w * x * x;
            }
        }
    }
    if total <= 0.0 {
        return 0.0;
    }
    let variance: f64 = (0..3).map(|k| (square[k] / total - (sum[k] / total).powi(2)).max(0.0)).sum();
    variance.sqrt() as f32
}
