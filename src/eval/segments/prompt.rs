//! Where clicks are placed, and how well a selection fits in the clicked view. Both use the ground truth: a user who
//! clicks sees what they want, so the first click is on the pixel that lies deepest inside the segment, in the view
//! that shows most of it, and each further one is deepest in what is still missing there. A method receives only a
//! [`Click`], which tells it nothing else; only the [`oracle`](super::oracle) asks for the fit.

use super::click::Click;
use super::truth::LabelledTrainingView;
use crate::config::types::segment::ClickConfig;
use crate::model::{HostGaussians, Rendering, ToKernel};
use crate::rng::{Purpose, Rng};
use crate::segment::click::{seen, under};
use burn::tensor::Device;
use volseggs_kernels::splat::contributors::{Contributors, ContributorsError};

/// Maximum number of pixels of the segment, and of the rest, by which a selection is judged.
const MAX_PIXELS: usize = 6000;
/// Fraction of a pixel's colour above which it counts as covered by a selection.
const SHARE: f32 = 0.5;
/// Minimum alpha of a pixel that can be covered.
const MIN_ALPHA: f32 = 0.02;
/// Fraction of the segment's pixels below which a user would see nothing missing: a fringe of a pixel along outlines.
const SATISFIED: f64 = 0.05;
/// Maximum number of pixels of the segment among which a further click is placed.
const MAX_PLACES: usize = 24_000;

/// A click on a segment, and what is needed to judge what it selects.
#[derive(Clone, Debug)]
pub struct ClickPrompt {
    /// Name of the view.
    pub view: String,
    /// Column and row of the first click.
    pub pixel: [u32; 2],
    first: Click,
    /// Contributors of the pixels by which selections are judged, the clicked one first.
    pixels: Contributors,
    inside: Vec<bool>,
    /// `None` if there is only one click.
    places: Option<ClickPixels>,
}

/// Pixels of a segment where further clicks may be placed. Those by which selections are judged are scattered, and in a
/// scatter no pixel lies deep inside anything.
#[derive(Clone, Debug)]
struct ClickPixels {
    /// Columns and rows of the picture that consists of every k-th column and row only.
    size: [usize; 2],
    /// Which of that picture's pixels are inside the segment, ascending.
    inside: Vec<u32>,
    /// Contributors of each of these.
    pixels: Contributors,
}

impl ClickPrompt {
    /// Places a click on what the segments `ids` show: on the pixel that lies deepest inside them, in the view that
    /// shows most of them. Returns `None` if no view shows them, as they are hidden behind others. Prepares up to
    /// `clicks` clicks; those after the first need the pixels to be examined once more.
    ///
    /// # Errors
    /// As for [`contributors`](volseggs_kernels::splat::contributors::contributors).
    pub fn new(
        views: &[LabelledTrainingView],
        ids: &[u16],
        (at, rendering): (&HostGaussians, Rendering),
        (clicks, config): (usize, &ClickConfig),
        device: &Device,
    ) -> Result<Option<Self>, ContributorsError> {
        let count = |v: &&LabelledTrainingView| v.labels.iter().filter(|l| ids.contains(l)).count();
        let Some(view) = views.iter().rev().max_by_key(count).filter(|v| count(v) > 0) else { return Ok(None) };
        let camera = view.view.camera.to_kernel();
        let (width, height) = (camera.width, camera.height);
        let within: Vec<bool> = view.labels.iter().map(|l| ids.contains(l)).collect();
        let clicked = deepest(&within, width, height);

        // candidates: at most `MAX_PIXELS` pixels of the segment, and as many of the rest
        let number = ids.first().copied().unwrap_or_default();
        let mut rng = Rng::new(0, u64::from(number), Purpose::PromptPixels);
        let mut choose = |wanted: bool| {
            let mut all: Vec<u32> = (0..within.len() as u32).filter(|&p| within[p as usize] == wanted).collect();
            let total = all.len();
            rng.shuffle(&mut all);
            all.truncate(MAX_PIXELS);
            (all, total)
        };
        let (inner, _) = choose(true);
        let (outer, _) = choose(false);
        let mut chosen = vec![clicked as u32];
        // both samples must be drawn at the same rate
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
        let first = Click { under: under(at, settings, pixel, config, device)? };
        let places = |within: &[bool]| {
            let (step, grid) = regular(within, width, height);
            let size = [width, height].map(|side| side.div_ceil(step));
            let in_grid = |&p: &u32| (p as usize / width / step * size[0] + p as usize % width / step) as u32;
            seen(at, settings, &grid, device).map(|pixels| ClickPixels {
                size,
                inside: grid.iter().map(in_grid).collect(),
                pixels,
            })
        };
        let places = (clicks > 1).then(|| places(&within)).transpose()?;
        let view = view.view.name.clone();
        Ok(Some(Self { view, pixel, first, pixels: found, inside, places }))
    }

    /// Returns the first click.
    pub fn first(&self) -> Click {
        self.first.clone()
    }

    /// Returns a click on the pixel that lies deepest in the part of the segment that `selected` misses, where the
    /// scene shows anything; `None` if it misses less than a twentieth of what is shown, or there is only one click.
    pub fn next(&self, selected: &[bool]) -> Option<Click> {
        let ClickPixels { size: [columns, rows], inside, pixels } = self.places.as_ref()?;
        let mut missed = vec![false; columns * rows];
        let (mut lacking, mut shown) = (0usize, 0usize);
        for (p, &place) in inside.iter().enumerate().filter(|(p, _)| shows(pixels, *p)) {
            missed[place as usize] = !covered(pixels, p, selected);
            lacking += usize::from(missed[place as usize]);
            shown += 1;
        }
        if (lacking as f64) < SATISFIED * shown as f64 {
            return None;
        }
        let place = deepest(&missed, *columns, *rows);
        let p = inside.binary_search(&(place as u32)).ok()?;
        missed[place].then(|| Click { under: pixels.pairs(p).collect() })
    }

    /// Returns the intersection over union, in the clicked view, of where the selected Gaussians make up most of what
    /// is visible and where the segment is. `selected` holds a value for each Gaussian of the scene.
    pub fn fit(&self, selected: &[bool]) -> f64 {
        let (mut both, mut either) = (0usize, 0usize);
        for (p, &inside) in self.inside.iter().enumerate() {
            let covered = covered(&self.pixels, p, selected);
            both += usize::from(covered && inside);
            either += usize::from(covered || inside);
        }
        if either == 0 { 0.0 } else { both as f64 / either as f64 }
    }
}

/// Returns whether anything is visible at pixel `p` of these: a user does not click where nothing is.
fn shows(pixels: &Contributors, p: usize) -> bool {
    pixels.row(p).1.iter().sum::<f32>() > MIN_ALPHA
}

/// Returns whether the selected Gaussians make up most of what is visible at pixel `p` of these.
fn covered(pixels: &Contributors, p: usize, selected: &[bool]) -> bool {
    let (indices, weights) = pixels.row(p);
    let (mut part, mut whole) = (0.0, 0.0);
    for (&i, &w) in indices.iter().zip(weights) {
        whole += w;
        part += if selected[i as usize] { w } else { 0.0 };
    }
    whole > MIN_ALPHA && part > SHARE * whole
}

/// Returns the smallest k for which the pixels of a segment in every k-th column and row are few enough, and these,
/// ascending.
fn regular(within: &[bool], width: usize, height: usize) -> (usize, Vec<u32>) {
    let mut step = 1;
    loop {
        let all = (0..height).step_by(step).flat_map(|y| (0..width).step_by(step).map(move |x| y * width + x));
        let found: Vec<u32> = all.filter(|&p| within[p]).map(|p| p as u32).collect();
        if found.len() <= MAX_PLACES {
            return (step, found);
        }
        step += 1;
    }
}

/// Returns the pixel of a segment that is farthest from the pixels outside it and from the border; steps along rows and
/// columns count 1. Among equals, this is the one nearest to their centre, not the tip of a thin object; among those,
/// the first.
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
    // distances to the sum of the positions of n equals, in n-ths of a pixel: integers, exact
    let n = equals.len();
    let sum = equals.iter().fold([0, 0], |[x, y], i| [x + i % width, y + i / width]);
    let distance = |i: usize| (n * (i % width)).abs_diff(sum[0]).pow(2) + (n * (i / width)).abs_diff(sum[1]).pow(2);
    equals.into_iter().min_by_key(|&i| distance(i)).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::Camera;
    use crate::data::truth::LabelledView;
    use crate::segment::click::heaviest;
    use crate::segment::test_support::{add, rendering};
    use glam::DVec3;

    #[test]
    fn the_click_is_in_the_middle_of_the_largest_part() {
        // a 2x2 part on the left, a 5x5 part on the right
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

    #[test]
    fn places_are_all_pixels_of_a_segment_or_a_regular_subsample() {
        let (step, all) = regular(&[true; 150 * 150], 150, 150);
        assert_eq!((step, all.len()), (1, 150 * 150));
        let right: Vec<bool> = (0..201 * 301).map(|p| p % 201 >= 3).collect();
        let (step, some) = regular(&right, 201, 301);
        assert_eq!((step, some.len(), &some[..2]), (2, 99 * 151, [4, 6].as_slice()));
        assert!(some.is_sorted());
    }

    #[test]
    fn a_further_click_is_deep_in_the_largest_missing_part_of_a_large_segment() {
        const SIZE: u32 = 200;
        let device = crate::device::DeviceName::Flex.open().unwrap();
        // a wall of Gaussians that fills the picture; a disc and, far away, a long thin line are missing
        let mut at = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
        for (i, j) in (-27..28).flat_map(|i| (-27..28).map(move |j| (i, j))) {
            add(&mut at, [0.04 * i as f32, 0.0, 0.04 * j as f32], [-3.9; 3]);
        }
        let centre: [f32; 2] = [-0.4, -0.4];
        let from_centre = |i: usize| (at.means[3 * i] - centre[0]).hypot(at.means[3 * i + 2] - centre[1]);
        let missing = |i: usize| from_centre(i) < 0.3 || (at.means[3 * i] - 0.8).abs() < 0.01;
        let selected: Vec<bool> = (0..at.len()).map(|i| !missing(i)).collect();

        let camera = Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, 0.5, SIZE, SIZE);
        let view = LabelledView { name: "train/r_0".into(), path: "r_0.png".into(), camera, time: 0.5 };
        let views = [LabelledTrainingView { view, labels: vec![3; (SIZE * SIZE) as usize] }];
        let prompt =
            ClickPrompt::new(&views, &[3], (&at, rendering()), (2, &ClickConfig::default()), &device).unwrap().unwrap();
        assert!(prompt.pixels.len() < (SIZE * SIZE) as usize, "selections are judged by a sample");
        let click = prompt.next(&selected).unwrap();
        let on = heaviest(&click.under, |_| true).unwrap() as usize;
        assert!(missing(on) && from_centre(on) < 0.1, "{} from the centre", from_centre(on));
        assert_eq!(prompt.next(&vec![true; at.len()]), None);
        // a strip of an eightieth of the picture is no reason to click again
        let strip: Vec<bool> = (0..at.len()).map(|i| (at.means[3 * i] - 0.8).abs() >= 0.01).collect();
        assert!(strip.iter().any(|selected| !selected));
        assert_eq!(prompt.next(&strip), None);
    }
}
