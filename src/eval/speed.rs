//! Drawing speed of a model, measured in two ways: as a viewer draws it, and with each image copied to the host.

use crate::data::Split;
use crate::model::params::to_vec;
use crate::model::{Model, ToKernel};
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// Frames drawn first and not counted: they compile kernels and allocate buffers.
const WARM_UP: usize = 2;
/// Approximate seconds that the counted frames of one way take.
const SECONDS: f64 = 1.0;
/// Minimum number of counted frames, however long they take.
const MIN_FRAMES: usize = 5;
/// Maximum number of counted frames, unless one pass over the views is more.
const MAX_FRAMES: usize = 200;
/// Number of blocks of frames, each drawn one way and then the other, so that other load on the machine affects both.
const BLOCKS: usize = 5;

/// Frames per second over a split's views, each at its own time. Both figures include all that drawing takes (for
/// VolSegGS, deformation and splatting), repeated for every frame; neither includes reading, warm-up or metrics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RenderSpeed {
    /// Without the copy of images to the host: frames are drawn one after another, and the clock stops when the device
    /// has finished all of its work.
    pub fps: f64,
    /// Number of frames behind each figure.
    pub fps_frames: usize,
    /// For the same frames, with the copy of each image to the host before the next one begins.
    pub fps_with_copy: f64,
}

/// Draws evenly spaced views of `split`, without and with the copy of each image to the host, for about a second each
/// (5 to 200 frames, or each view once).
///
/// # Errors
/// If there is no view, or the device fails.
pub fn measure(model: &dyn Model, split: &Split) -> Result<RenderSpeed, String> {
    let views = split.frames.len();
    if views == 0 {
        return Err("frames per second: the split has no views".to_owned());
    }
    let draw = |view: usize| {
        let frame = &split.frames[view];
        model.image(frame.camera.to_kernel(), frame.time as f32)
    };
    let copy = |view: usize| drop(to_vec(draw(view)));
    let device = model.device();
    let wait = || device.sync().map_err(|e| format!("frames per second: {e:?}"));
    copy(0);
    let mut seconds = 0.0;
    for i in 1..=WARM_UP {
        let started = Instant::now();
        drop(draw(i * (views - 1) / WARM_UP));
        wait()?;
        seconds = started.elapsed().as_secs_f64();
    }
    let frames = frames(seconds, views);
    let order: Vec<usize> = (0..frames).map(|i| if frames < views { i * views / frames } else { i % views }).collect();
    let (mut alone, mut copied) = (0.0, 0.0);
    for block in order.chunks(frames.div_ceil(BLOCKS)) {
        let started = Instant::now();
        block.iter().for_each(|view| drop(draw(*view)));
        // the host may be far ahead of the device
        wait()?;
        alone += started.elapsed().as_secs_f64();
        let started = Instant::now();
        block.iter().for_each(|view| copy(*view));
        copied += started.elapsed().as_secs_f64();
    }
    Ok(RenderSpeed { fps: frames as f64 / alone, fps_frames: frames, fps_with_copy: frames as f64 / copied })
}

/// Returns how many frames to draw if one takes `seconds`: fewer than there are views, or each view equally often.
fn frames(seconds: f64, views: usize) -> usize {
    let wanted = ((SECONDS / seconds.max(1e-9)) as usize).clamp(MIN_FRAMES, MAX_FRAMES.max(views));
    if wanted < views { wanted } else { views * (wanted / views).max(MIN_FRAMES.div_ceil(views)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn frames_last_about_a_second_and_weight_views_equally(
            seconds in prop_oneof![Just(0.0), 1e-6f64..10.0], views in 1usize..1000,
        ) {
            let n = frames(seconds, views);
            prop_assert!(n >= MIN_FRAMES.min(views));
            prop_assert!(n <= MAX_FRAMES.max(views).max(MIN_FRAMES.next_multiple_of(views)));
            prop_assert!(n < views || n.is_multiple_of(views), "{n} frames of {views} views");
            // five frames, or a second
            prop_assert!(n as f64 * seconds <= SECONDS.max(2.0 * MIN_FRAMES as f64 * seconds) + 1e-9);
        }
    }
}
