//! Where clicks are placed, and how well a selection fits in the view that was clicked. Both know the truth: a person
//! who clicks sees what they want, so the first click is on the pixel that lies deepest inside the segment, in the view
//! that shows most of it, and each further one deepest in what is still missing there. What a method is given is a
//! [`Click`], which tells no more; only the [`oracle`](super::oracle) asks for the fit.

use super::click::Click;
use super::truth::Labelled;
use crate::model::{HostGaussians, Rendering};
use crate::rng::{Purpose, Rng};
use crate::segment::click::{seen, under};
use burn::tensor::Device;
use volseggs_kernels::splat::contributors::{Contributors, ContributorsError};

/// Pixels by which a selection is judged.
const PIXELS: usize = 6000;
/// Part of a pixel's colour from which it counts as covered by a selection.
const SHARE: f32 = 0.5;
/// Least alpha of a pixel that can be covered.
const LEAST: f32 = 0.02;

/// A click on a segment, and what is needed to judge what it selects.
#[derive(Clone, Debug)]
pub struct Prompt {
    /// Name of the view.
    pub view: String,
    /// Column and row of the first click.
    pub pixel: [u32; 2],
    first: Click,
    size: [usize; 2],
    /// The pixels by which selections are judged (`y * width + x`), the clicked one first.
    chosen: Vec<u32>,
    pixels: Contributors,
    inside: Vec<bool>,
}

impl Prompt {
    /// A click on what the segments `ids` show: on the pixel that lies deepest inside it, in the view that shows most of
    /// it. `None` where no view shows it: it is hidden behind others.
    ///
    /// # Errors
    /// As [`contributors`](volseggs_kernels::splat::contributors::contributors).
    pub fn new(
        views: &[Labelled],
        ids: &[u16],
        (at, rendering): (&HostGaussians, Rendering),
        device: &Device,
    ) -> Result<Option<Self>, ContributorsError> {
        let count = |v: &&Labelled| v.labels.iter().filter(|l| ids.contains(l)).count();
        let Some(view) = views.iter().rev().max_by_key(count).filter(|v| count(v) > 0) else { return Ok(None) };
        let camera = view.view.camera.to_kernel();
        let (width, height) = (camera.width, camera.height);
        let within: Vec<bool> = view.labels.iter().map(|l| ids.contains(l)).collect();
        let clicked = deepest(&within, width, height);

        // as many pixels of the segment as of the rest of what is seen, at most
        let number = ids.first().copied().unwrap_or_default();
        let mut rng = Rng::new(0, u64::from(number), Purpose::PromptPixels);
        let mut choose = |wanted: bool| {
            let mut all: Vec<u32> = (0..within.len() as u32).filter(|&p| within[p as usize] == wanted).collect();
            let total = all.len();
            rng.shuffle(&mut all);
            all.truncate(PIXELS);
            (all, total)
        };
        let (inner, _) = choose(true);
        let (outer, _) = choose(false);
        let mut chosen = vec![clicked as u32];
        // the two samples must stand for the same number of pixels each
        let share = |part: usize, of: usize| if of == 0 { 1.0 } else { part as f64 / of as f64 };
        let inner_total = within.iter().filter(|w| **w).count();
        let outer_total = within.len() - inner_total;
        let rate = share(inner.len(), inner_total).min(share(outer.len(), outer_total));
        chosen.extend(&inner[..((rate * inner_total as f64) as usize).min(inner.len())]);
        chosen.extend(&outer[..((rate * outer_total as f64) as usize).min(outer.len())]);
        let settings = rendering.seen_by(camera);
        let found = seen(at, settings, &chosen, device)?;
        let inside = chosen.iter().map(|&p| within[p as usize]).collect();
        let pixel = [(clicked % width) as u32, (clicked / width) as u32];
        let first = Click { under: under(at, settings, pixel, device)? };
        let view = view.view.name.clone();
        Ok(Some(Self { view, pixel, first, size: [width, height], chosen, pixels: found, inside }))
    }

    /// The first click.
    #[must_use]
    pub fn first(&self) -> Click {
        self.first.clone()
    }

    /// A click on the pixel that lies deepest in what `selected` leaves out of the segment; `None` if it leaves out none.
    #[must_use]
    pub fn next(&self, selected: &[bool]) -> Option<Click> {
        let [width, height] = self.size;
        let mut left_out = vec![false; width * height];
        for (p, &pixel) in self.chosen.iter().enumerate() {
            left_out[pixel as usize] = self.inside[p] && !self.covered(p, selected);
        }
        let pixel = deepest(&left_out, width, height);
        let missing = left_out[pixel];
        missing.then(|| self.chosen.iter().position(|&c| c as usize == pixel).map(|p| self.click(p))).flatten()
    }

    fn click(&self, p: usize) -> Click {
        Click { under: self.pixels.pairs(p).collect() }
    }

    /// Whether the selected Gaussians make up most of what is seen at judged pixel `p`.
    fn covered(&self, p: usize, selected: &[bool]) -> bool {
        let (indices, weights) = self.pixels.row(p);
        let (mut part, mut whole) = (0.0, 0.0);
        for (&i, &w) in indices.iter().zip(weights) {
            whole += w;
            part += if selected[i as usize] { w } else { 0.0 };
        }
        whole > LEAST && part > SHARE * whole
    }

    /// Intersection over union, in the clicked view, of where the selected Gaussians make up most of what is seen and of
    /// where the segment is. `selected` holds a value for each Gaussian of the scene.
    #[must_use]
    pub fn fit(&self, selected: &[bool]) -> f64 {
        let (mut both, mut either) = (0usize, 0usize);
        for (p, &inside) in self.inside.iter().enumerate() {
            let covered = self.covered(p, selected);
            both += usize::from(covered && inside);
            either += usize::from(covered || inside);
        }
        if either == 0 { 0.0 } else { both as f64 / either as f64 }
    }
}

/// The pixel of a segment that is farthest from what is not of it and from the border; steps along rows and columns count 1. Of
/// equals the one nearest to the middle of all of them, not the tip of a thin thing; of those the first.
fn deepest(within: &[bool], width: usize, height: usize) -> usize {
    let mut depth = vec![0u32; within.len()];
    for y in 0..height {
        for x in 0..width {
            let i = y * width + x;
            if within[i] {
                let up = if y > 0 { depth[i - width] } else { 0 };
                let left = if x > 0 { depth[i - 1] } else { 0 };
                depth[i] = 1 + up.min(left);
            }
        }
    }
    for y in (0..height).rev() {
        for x in (0..width).rev() {
            let i = y * width + x;
            let down = if y + 1 < height { depth[i + width] } else { 0 };
            let right = if x + 1 < width { depth[i + 1] } else { 0 };
            depth[i] = depth[i].min(1 + down.min(right));
        }
    }
    let most = depth.iter().copied().max().unwrap_or(0);
    let equals: Vec<usize> = (0..depth.len()).filter(|&i| depth[i] == most).collect();
    // distances to the sum of the places of n equals, in n-ths of a pixel: whole numbers, exact
    let n = equals.len();
    let sum = equals.iter().fold([0, 0], |[x, y], i| [x + i % width, y + i / width]);
    let distance = |i: usize| (n * (i % width)).abs_diff(sum[0]).pow(2) + (n * (i / width)).abs_diff(sum[1]).pow(2);
    equals.into_iter().min_by_key(|&i| distance(i)).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::deepest;

    #[test]
    fn the_click_is_in_the_middle_of_the_largest_part() {
        // a 2x2 part at the left, a 5x5 part at the right
        let mut within = vec![false; 12 * 7];
        for y in 1..6 {
            (6..11).for_each(|x| within[y * 12 + x] = true);
        }
        [13, 14, 25, 26].iter().for_each(|&i| within[i] = true);
        assert_eq!(deepest(&within, 12, 7), 3 * 12 + 8);
        assert_eq!(deepest(&[true; 9], 3, 3), 4, "the border counts as outside");
        // all pixels of a thread are as deep as its ends
        let thread: Vec<bool> = (0..81).map(|i| i % 9 == i / 9).collect();
        assert_eq!(deepest(&thread, 9, 9), 4 * 9 + 4);
    }
}
