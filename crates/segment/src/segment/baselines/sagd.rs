//! SAGD (Hu et al., "Boundary-Enhanced Segment Anything in 3D Gaussian via Gaussian Decomposition", 2024): a click
//! selects a mask in each view, each mask labels Gaussians by where their centres project, the labels vote, and
//! Gaussians that extend beyond a mask's edge are cut back (`cut`). Nothing is trained.
//!
//! This is a re-implementation from descriptions, not the authors' program. Differences:
//! * Masks are read from storage; the published method runs Segment Anything in each view with the projected prompt. Of
//!   the masks that cover the prompt, one is chosen by its area ([`MaskChoice`]); the published method takes the
//!   largest of three. A view without any mask there does not vote.
//! * The prompt is a Gaussian, optionally with its nearest neighbours; finding the Gaussian under a pixel is up to the
//!   caller. As in the published method, nothing checks that the prompt is visible in a view.
//! * Gaussians off screen or behind the camera abstain; in the published method, -1 is a label like the others. A
//!   Gaussian is kept if more than [`SagdOptions::agreement`] of its votes are for it.
//! * The part of the long axis inside a mask is found in 3D, so that perspective does not matter, and an end off screen
//!   does not cause a cut. Only the scale along that axis changes; all voting views are used, not every 20th; and the
//!   outer part of a cut Gaussian is dropped, not kept for the rest of the scene.

mod cut;
#[cfg(test)]
mod tests;

use crate::model::HostGaussians;
use crate::points::neighbours::NeighbourGrid;
use crate::segment::masks::Mask;
use rayon::prelude::*;
use volseggs_kernels::PinholeCamera;
use volseggs_kernels::splat::NEAR;

/// A view and its masks.
#[derive(Clone, Debug)]
pub struct SagdView {
    /// The camera.
    pub camera: PinholeCamera,
    /// Masks of the camera's image, of its size.
    pub masks: Vec<Mask>,
}

/// Which of the masks that cover the prompt to use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MaskChoice {
    /// The smallest.
    Smallest,
    /// The median by area, the smaller of two.
    Middle,
    /// The largest, as published.
    #[default]
    Largest,
}

/// Options of [`segment`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SagdOptions {
    /// Which mask to use.
    pub choice: MaskChoice,
    /// Number of Gaussians nearest to the clicked one that are prompts besides it. The mask is chosen among those that
    /// cover the most prompts.
    pub neighbours: usize,
    /// Fraction of the votes above which a Gaussian is kept; 0.7 as published.
    pub agreement: f32,
    /// Whether to cut back Gaussians that extend beyond a mask's edge.
    pub decompose: bool,
}

impl Default for SagdOptions {
    fn default() -> Self {
        Self { choice: MaskChoice::Largest, neighbours: 0, agreement: 0.7, decompose: true }
    }
}

/// What a click selects.
#[derive(Clone, Debug, PartialEq)]
pub struct SagdSegment {
    /// Indices of the M Gaussians kept, ascending.
    pub members: Vec<u32>,
    /// These Gaussians, `[M]`; those at mask edges are cut back if [`SagdOptions::decompose`] is set.
    pub gaussians: HostGaussians,
    /// Number of views with a mask that covers the prompt.
    pub voting: usize,
}

/// Why there is no segment.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SagdError {
    /// No such Gaussian.
    #[error("Gaussian {clicked} was clicked, but there are only {count}, numbered from 0")]
    Clicked {
        /// Index that was clicked.
        clicked: u32,
        /// Number of Gaussians.
        count: usize,
    },
    /// A mask does not have the size of its camera's image.
    #[error("view {view}: a mask of {}x{} pixels, but the camera has {}x{}", mask[0], mask[1], camera[0], camera[1])]
    MaskSize {
        /// Number of the view, from 0.
        view: usize,
        /// Width and height of the mask.
        mask: [usize; 2],
        /// Width and height of the camera's image.
        camera: [usize; 2],
    },
}

/// Segments the Gaussians that belong with number `clicked` according to the masks of `views`. If no mask covers the
/// prompt, the segment is empty.
///
/// # Errors
/// If there is no such Gaussian, or a mask is not of its camera's size.
pub fn segment(
    at: &HostGaussians,
    views: &[SagdView],
    clicked: u32,
    options: &SagdOptions,
) -> Result<SagdSegment, SagdError> {
    if clicked as usize >= at.len() {
        return Err(SagdError::Clicked { clicked, count: at.len() });
    }
    for (number, view) in views.iter().enumerate() {
        let camera = [view.camera.width, view.camera.height];
        let sizes = view.masks.iter().map(|m| [m.width as usize, m.height as usize]);
        if let Some(mask) = sizes.into_iter().find(|size| *size != camera) {
            return Err(SagdError::MaskSize { view: number, mask, camera });
        }
    }
    let prompt = prompt(&at.means, clicked, options.neighbours);
    let chosen: Vec<ChosenView<'_>> =
        views.par_iter().filter_map(|v| ChosenView::find(v, &prompt, options.choice)).collect();
    let keep: Vec<bool> = at
        .means
        .par_chunks_exact(3)
        .map(|m| {
            let (mut votes, mut inside) = (0u32, 0u32);
            for label in chosen.iter().filter_map(|c| c.label([m[0], m[1], m[2]])) {
                votes += 1;
                inside += u32::from(label);
            }
            votes > 0 && inside as f32 > options.agreement * votes as f32
        })
        .collect();
    let members: Vec<u32> = (0..).zip(&keep).filter(|(_, k)| **k).map(|(i, _)| i).collect();
    let mut gaussians = at.subset(&members);
    if options.decompose {
        cut::cut(&mut gaussians, &chosen);
    }
    Ok(SagdSegment { members, gaussians, voting: chosen.len() })
}

/// Returns the positions of the clicked Gaussian and of the `neighbours` nearest to it; none if its own is not finite.
fn prompt(means: &[f32], clicked: u32, neighbours: usize) -> Vec<[f32; 3]> {
    let place = |i: u32| -> [f32; 3] { std::array::from_fn(|k| means[3 * i as usize + k]) };
    let centre = place(clicked);
    if !centre.iter().all(|v| v.is_finite()) {
        return Vec::new();
    }
    let found = NeighbourGrid::adaptive(means).map(|grid| grid.nearest(centre, neighbours, Some(clicked)));
    std::iter::once(centre).chain(found.into_iter().flatten().map(|(i, _)| place(i))).collect()
}

/// A view with the mask chosen by the prompt.
struct ChosenView<'a> {
    camera: &'a PinholeCamera,
    /// `[height, width]`
    set: Vec<bool>,
}

impl<'a> ChosenView<'a> {
    /// Chooses the mask of a view; `None` if no mask covers any point of the prompt.
    fn find(view: &'a SagdView, prompt: &[[f32; 3]], choice: MaskChoice) -> Option<Self> {
        let pixels: Vec<[u32; 2]> = prompt.iter().filter_map(|&p| pixel(&view.camera, p)).collect();
        let hits = |mask: &Mask| pixels.iter().filter(|[x, y]| mask.contains(*x, *y)).count();
        let counted: Vec<(usize, &Mask)> = view.masks.iter().map(|m| (hits(m), m)).collect();
        let most = counted.iter().map(|c| c.0).max().filter(|&m| m > 0)?;
        let mut over: Vec<&Mask> = counted.into_iter().filter(|c| c.0 == most).map(|c| c.1).collect();
        over.sort_by_key(|m| m.area());
        let at = match choice {
            MaskChoice::Smallest => 0,
            MaskChoice::Middle => (over.len() - 1) / 2,
            MaskChoice::Largest => over.len() - 1,
        };
        Some(Self { camera: &view.camera, set: over[at].to_rows() })
    }

    /// Returns whether a world position projects inside the mask; `None` off screen, behind the camera, or if not
    /// finite.
    fn label(&self, position: [f32; 3]) -> Option<bool> {
        let [x, y] = pixel(self.camera, position)?;
        Some(self.set[y as usize * self.camera.width + x as usize])
    }
}

/// Returns the column and row of the pixel that a world position projects to; `None` off screen or not beyond [`NEAR`].
fn pixel(camera: &PinholeCamera, p: [f32; 3]) -> Option<[u32; 2]> {
    let [x, y, z]: [f32; 3] = std::array::from_fn(|k| {
        let row = camera.rotation[k];
        row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + camera.translation[k]
    });
    let (u, v) = (camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy);
    // written so that NaN is off screen
    let on = z > NEAR && u >= 0.0 && v >= 0.0 && u < camera.width as f32 && v < camera.height as f32;
    on.then_some([u as u32, v as u32])
}
