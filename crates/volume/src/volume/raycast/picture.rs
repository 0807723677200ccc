//! The output of the ray caster: an image with alpha, and which segments a ray met.

use image::RgbaImage;

/// An image `[H, W, 4]`: colour times alpha, and alpha, each in [0, 1].
#[derive(Clone, Debug, PartialEq)]
pub struct RaycastPicture {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Rows from the top, `[H, W, 4]`, premultiplied.
    pub pixels: Vec<f32>,
}

impl RaycastPicture {
    /// An empty picture.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, pixels: vec![0.0; 4 * width * height] }
    }

    pub(super) fn set(&mut self, x: usize, y: usize, color: [f32; 4]) {
        self.pixels[4 * (y * self.width + x)..][..4].copy_from_slice(&color);
    }

    /// The image over a background, `[H, W, 3]`.
    pub fn over(&self, background: [f32; 3]) -> Vec<f32> {
        self.pixels.chunks_exact(4).flat_map(|p| [0, 1, 2].map(|c| p[c] + (1.0 - p[3]) * background[c])).collect()
    }

    /// The image in 8 bits with straight alpha, as stored in datasets. The colour is the one that, with the rounded
    /// alpha, comes closest to the image over black.
    pub fn to_rgba8(&self) -> RgbaImage {
        RgbaImage::from_fn(self.width as u32, self.height as u32, |x, y| {
            let p = &self.pixels[4 * (y as usize * self.width + x as usize)..][..4];
            let alpha = (p[3] * 255.0).round();
            let color = |c: usize| if alpha > 0.0 { (p[c] * 255.0 / alpha * 255.0).round().min(255.0) } else { 0.0 };
            image::Rgba([color(0) as u8, color(1) as u8, color(2) as u8, alpha as u8])
        })
    }

    /// 255 where alpha is at least `min_alpha`, else 0, `[H, W]`.
    pub fn mask(&self, min_alpha: f32) -> Vec<u8> {
        self.pixels.chunks_exact(4).map(|p| if p[3] >= min_alpha { 255 } else { 0 }).collect()
    }

    /// Whether anything of it remains visible in 8 bits.
    pub fn shows(&self) -> bool {
        self.pixels.chunks_exact(4).any(|p| (p[3] * 255.0).round() > 0.0)
    }

    /// Fraction of pixels with any alpha.
    pub fn coverage(&self) -> f64 {
        let some = self.pixels.chunks_exact(4).filter(|p| p[3] > 0.0).count();
        some as f64 / (self.width * self.height).max(1) as f64
    }
}

/// Number of segments whose shares a ray keeps; of more, the smallest share is dropped.
const KEPT: usize = 6;

/// The share of each segment in the colour of one pixel.
#[derive(Clone, Copy, Debug, Default)]
pub struct SegmentShares {
    ids: [u16; KEPT],
    weights: [f32; KEPT],
    /// The segment that the ray is in, and the weight accumulated there: a faint one is compared with the others as a
    /// whole, not step by step.
    now: (u16, f32),
}

impl SegmentShares {
    /// Adds to a segment's share; 0 (no segment) counts as a segment.
    #[inline]
    pub fn add(&mut self, segment: u16, weight: f32) {
        if self.now.0 != segment {
            let (left, gathered) = std::mem::replace(&mut self.now, (segment, 0.0));
            self.keep(left, gathered);
        }
        self.now.1 += weight;
    }

    fn keep(&mut self, segment: u16, weight: f32) {
        let mut smallest = 0;
        for i in 0..KEPT {
            if self.weights[i] > 0.0 && self.ids[i] == segment {
                self.weights[i] += weight;
                return;
            }
            if self.weights[i] < self.weights[smallest] {
                smallest = i;
            }
        }
        if weight > self.weights[smallest] {
            self.ids[smallest] = segment;
            self.weights[smallest] = weight;
        }
    }

    /// The segment with the largest share; 0 if there is none.
    pub fn largest(&self) -> u16 {
        let mut all = *self;
        all.keep(self.now.0, self.now.1);
        let mut best = 0;
        for i in 1..KEPT {
            if all.weights[i] > all.weights[best] {
                best = i;
            }
        }
        all.ids[best]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn straight_alpha_composites_back() {
        let mut picture = RaycastPicture::new(2, 1);
        picture.set(0, 0, [0.2, 0.1, 0.3, 0.4]);
        let rgba = picture.to_rgba8();
        assert_eq!(rgba.get_pixel(1, 0).0, [0; 4]);
        let p = rgba.get_pixel(0, 0).0.map(|v| f32::from(v) / 255.0);
        for (c, want) in picture.over([1.0; 3])[..3].iter().enumerate() {
            assert!((p[c] * p[3] + 1.0 - p[3] - want).abs() < 0.004);
        }
        assert_eq!(picture.mask(0.4), [255, 0]);
        assert!((picture.coverage() - 0.5).abs() < 1e-12);
        assert!(picture.shows() && !RaycastPicture::new(3, 2).shows());
        picture.set(0, 0, [0.0, 0.0, 0.0, 0.001]);
        assert!(!picture.shows(), "less than half a level of 8 bits");
    }

    #[test]
    fn the_largest_share_wins() {
        let mut shares = SegmentShares::default();
        assert_eq!(shares.largest(), 0);
        for id in 0..40u16 {
            shares.add(id, 0.01);
        }
        shares.add(7, 0.02);
        shares.add(3, 0.2);
        shares.add(7, 0.3);
        assert_eq!(shares.largest(), 7);
    }

    #[test]
    fn a_faint_segment_counts_by_all_of_its_steps_however_many_came_before() {
        let mut shares = SegmentShares::default();
        for id in 1..=KEPT as u16 {
            shares.add(id, 0.05);
        }
        for _ in 0..100 {
            shares.add(40, 0.004);
        }
        assert_eq!(shares.largest(), 40);
    }
}
