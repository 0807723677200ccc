//! The clicks that stand for a user's choice, and how well what they select fits in the view that was clicked. A method's
//! settings are chosen by that one view alone, as a user moves a slider until the picture looks right, and so is each
//! further click, on what is still missing there; the views that are measured are others.

use super::truth::Labelled;
use crate::model::GaussiansAt;
use crate::rng::{Purpose, Rng};
use crate::segment::click::{heaviest, seen};
use burn::tensor::Device;
use volseggs_kernels::contributors::{Contributors, ContributorsError};

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
    size: [usize; 2],
    /// The pixels by which selections are judged (`y * width + x`), the clicked one first.
    chosen: Vec<u32>,
    pixels: Contributors,
    inside: Vec<bool>,
}

/// What a clicked pixel is made of.
#[derive(Clone, Debug)]
pub struct Click {
    under: Vec<(u32, f32)>,
}

impl Click {
    /// The clicked Gaussian: the one that shows most, of those that are `wanted`.
    #[must_use]
    pub fn on(&self, wanted: impl Fn(u32) -> bool) -> Option<u32> {
        heaviest(&self.under, wanted)
    }
}

impl Prompt {
    /// A click on the pixel of segment `id` that lies deepest inside it, in the view that shows most of it. `None` where
    /// no view shows it: it is hidden behind others.
    ///
    /// # Errors
    /// As [`contributors`](volseggs_kernels::contributors::contributors).
    pub fn new(
        views: &[Labelled],
        id: u16,
        at: &GaussiansAt,
        device: &Device,
    ) -> Result<Option<Self>, ContributorsError> {
        let count = |v: &&Labelled| v.labels.iter().filter(|l| **l == id).count();
        let Some(view) = views.iter().rev().max_by_key(count).filter(|v| count(v) > 0) else { return Ok(None) };
        let camera = view.view.camera.to_kernel();
        let (width, height) = (camera.width, camera.height);
        let clicked = deepest(&view.labels, id, width, height);

        // as many pixels of the segment as of the rest of what is seen, at most
        let mut rng = Rng::new(0, u64::from(id), Purpose::Clusters as u64 + 1000);
        let mut choose = |wanted: &dyn Fn(u16) -> bool| {
            let mut all: Vec<u32> =
                (0..view.labels.len() as u32).filter(|&p| wanted(view.labels[p as usize])).collect();
            let total = all.len();
            rng.shuffle(&mut all);
            all.truncate(PIXELS);
            (all, total)
        };
        let (inner, _) = choose(&|l| l == id);
        let (outer, _) = choose(&|l| l != id);
        let mut chosen = vec![clicked as u32];
        // the two samples must stand for the same number of pixels each
        let share = |part: usize, of: usize| part as f64 / of.max(1) as f64;
        let inner_total = view.labels.iter().filter(|l| **l == id).count();
        let outer_total = view.labels.len() - inner_total;
        let rate = share(inner.len(), inner_total).min(share(outer.len(), outer_total));
        chosen.extend(&inner[..((rate * inner_total as f64) as usize).min(inner.len())]);
        chosen.extend(&outer[..((rate * outer_total as f64) as usize).min(outer.len())]);
        let found = seen(at, camera, &chosen, device)?;
        let inside = chosen.iter().map(|&p| view.labels[p as usize] == id).collect();
        let pixel = [(clicked % width) as u32, (clicked / width) as u32];
        let view = view.view.name.clone();
        Ok(Some(Self { view, pixel, size: [width, height], chosen, pixels: found, inside }))
    }

    /// The first click.
    #[must_use]
    pub fn first(&self) -> Click {
        self.click(0)
    }

    /// A click on the pixel that lies deepest in what `selected` leaves out of the segment; `None` if it leaves out none.
    #[must_use]
    pub fn next(&self, selected: &[bool]) -> Option<Click> {
        let [width, height] = self.size;
        let mut left_out = vec![0u16; width * height];
        for (p, &pixel) in self.chosen.iter().enumerate() {
            left_out[pixel as usize] = u16::from(self.inside[p] && !self.covered(p, selected));
        }
        let pixel = deepest(&left_out, 1, width, height);
        let missing = left_out[pixel] == 1;
        missing.then(|| self.chosen.iter().position(|&c| c as usize == pixel).map(|p| self.click(p))).flatten()
    }

    fn click(&self, p: usize) -> Click {
        let (indices, weights) = self.pixels.row(p);
        Click { under: indices.iter().copied().zip(weights.iter().copied()).collect() }
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

/// The pixel of `id` that is farthest from any other label and from the border, the first of equals; steps along rows
/// and columns count 1.
fn deepest(labels: &[u16], id: u16, width: usize, height: usize) -> usize {
    let mut depth = vec![0u32; labels.len()];
    for y in 0..height {
        for x in 0..width {
            let i = y * width + x;
            if labels[i] == id {
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
    let mut best = 0;
    for (i, &d) in depth.iter().enumerate() {
        if d > depth[best] {
            best = i;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::deepest;

    #[test]
    fn the_click_is_in_the_middle_of_the_largest_part() {
        // a 2x2 part at the left, a 5x5 part at the right
        let mut labels = vec![0u16; 12 * 7];
        for y in 1..6 {
            (6..11).for_each(|x| labels[y * 12 + x] = 3);
        }
        [13, 14, 25, 26].iter().for_each(|&i| labels[i] = 3);
        assert_eq!(deepest(&labels, 3, 12, 7), 3 * 12 + 8);
        assert_eq!(deepest(&[5; 9], 5, 3, 3), 4, "the border counts as outside");
    }
}
