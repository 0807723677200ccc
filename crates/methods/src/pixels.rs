//! The pixels of the training views used by a step, determined by the seed and the step.

use volseggs_base::rng::{Permutation, Purpose};

/// Pixels in epochs: each epoch has a fixed number of distinct pixels of every view, in one random order over all
/// views.
#[derive(Clone, Copy, Debug)]
pub(super) struct PixelEpochs {
    views: u64,
    /// Pixels per view.
    pixels: u64,
    /// Pixels drawn from a view per epoch.
    drawn: u64,
    seed: u64,
}

/// A pixel of a training view.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Pixel {
    /// The view.
    pub view: usize,
    /// Its pixel, row-major.
    pub at: usize,
}

impl PixelEpochs {
    /// Draws `drawn` pixels (all, if there are fewer) from each of `views` views of `pixels` pixels.
    pub fn new(views: usize, pixels: usize, drawn: usize, seed: u64) -> Self {
        Self { views: views as u64, pixels: pixels as u64, drawn: drawn.min(pixels) as u64, seed }
    }

    /// The `size` pixels of a step, which may span the end of an epoch and the start of the next.
    pub fn of_step(&self, step: usize, size: usize) -> Vec<Pixel> {
        let epoch_len = self.views * self.drawn;
        let first = step as u64 * size as u64;
        let order = |epoch: u64| Permutation::new(epoch_len, self.seed, epoch, Purpose::MethodPixels);
        let mut epoch = first / epoch_len;
        let mut places = order(epoch);
        let pixel = |number: u64| {
            if number / epoch_len != epoch {
                epoch = number / epoch_len;
                places = order(epoch);
            }
            let place = places.get(number % epoch_len);
            let (view, k) = (place / self.drawn, place % self.drawn);
            // the keys of the orders within views lie above those of the epochs, which never get so large
            let key = (1 << 63) | (epoch * self.views + view);
            let at = Permutation::new(self.pixels, self.seed, key, Purpose::MethodPixels).get(k);
            Pixel { view: view as usize, at: at as usize }
        };
        (first..first + size as u64).map(pixel).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn an_epoch_has_equally_many_distinct_pixels_of_each_view() {
        let pixels = PixelEpochs::new(3, 50, 20, 7);
        // 7.5 steps per epoch
        let all: Vec<Pixel> = (0..15).flat_map(|step| pixels.of_step(step, 8)).collect();
        let epochs: Vec<BTreeSet<Pixel>> = all.chunks(60).map(|epoch| epoch.iter().copied().collect()).collect();
        for epoch in &epochs {
            assert_eq!(epoch.len(), 60);
            assert!((0..3).all(|view| epoch.iter().filter(|p| p.view == view).count() == 20));
            assert!(epoch.iter().all(|p| p.at < 50));
        }
        assert_ne!(epochs[0], epochs[1], "pixels are redrawn in each epoch");
        let views: Vec<usize> = all.iter().take(8).map(|p| p.view).collect();
        assert!(views.iter().any(|v| *v != views[0]), "a step mixes views: {views:?}");
        let all: BTreeSet<Pixel> = PixelEpochs::new(2, 5, 9, 0).of_step(0, 10).into_iter().collect();
        assert_eq!(all.len(), 10, "an epoch has at most all pixels of a view");
    }
}
