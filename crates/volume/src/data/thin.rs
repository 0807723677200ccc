//! Fewer views: some of the times, some of the views of each. For ablations of data coverage, and for static scenes.

use super::dataset::{Frame, Split};
use super::images::ImageSet;
use super::paths::time_indices;

/// Keeps `times` of the split's times, evenly spread, and `views` views of each, chosen one by one as far as possible
/// from those chosen before; 0 keeps all. The order is preserved.
pub fn thinned(split: Split, times: usize, views: usize) -> Split {
    let all = split.times();
    let times = if times == 0 { all.len() } else { times.min(all.len()) };
    let kept_times: Vec<f64> = time_indices(times, all.len()).into_iter().map(|i| all[i]).collect();
    let mut kept = Vec::new();
    for time in kept_times {
        let here: Vec<usize> = (0..split.frames.len()).filter(|&i| split.frames[i].time == time).collect();
        kept.extend(apart(&split.frames, &here, if views == 0 { here.len() } else { views }));
    }
    kept.sort_unstable();
    only(split, &kept)
}

/// Returns the times of `all` (ascending) nearest to each of `wanted`, in the order of `wanted`; the earlier of two
/// that are equally near.
pub fn nearest_times(all: &[f64], wanted: &[f64]) -> Vec<f64> {
    let nearest = |w: &f64| all.iter().copied().min_by(|a, b| (a - w).abs().total_cmp(&(b - w).abs()));
    wanted.iter().filter_map(nearest).collect()
}

/// Keeps the views at `times`, which are times of the split. The order is preserved.
pub fn at_times(split: Split, times: &[f64]) -> Split {
    let kept: Vec<usize> = (0..split.frames.len()).filter(|&i| times.contains(&split.frames[i].time)).collect();
    only(split, &kept)
}

/// Keeps at most `count` views, evenly spaced over the split.
pub fn evenly(split: Split, count: usize) -> Split {
    let total = split.frames.len();
    let kept: Vec<usize> = (0..count.min(total)).map(|i| i * total / count.min(total)).collect();
    only(split, &kept)
}

/// Keeps the views `kept`, ascending, with their images.
fn only(split: Split, kept: &[usize]) -> Split {
    if kept.len() == split.frames.len() {
        return split;
    }
    let frames = kept.iter().map(|&i| split.frames[i].clone()).collect();
    let size = split.images.width as usize * split.images.height as usize * ImageSet::CHANNELS;
    let pixels = if split.images.pixels.is_empty() {
        Vec::new()
    } else {
        kept.iter().flat_map(|&i| &split.images.pixels[i * size..(i + 1) * size]).copied().collect()
    };
    Split { frames, images: ImageSet { pixels, ..split.images }, ..split }
}

/// Chooses `count` of the frames `among`, each with the camera position farthest from those chosen before.
fn apart(frames: &[Frame], among: &[usize], count: usize) -> Vec<usize> {
    if count >= among.len() {
        return among.to_vec();
    }
    let place = |i: usize| frames[i].camera.position();
    let mut taken = vec![among[0]];
    while taken.len() < count {
        let gap = |i: usize| taken.iter().map(|&t| place(i).distance(place(t))).fold(f64::INFINITY, f64::min);
        let rest = among.iter().filter(|i| !taken.contains(i));
        // the first among equals, so that the choice is deterministic
        let next = rest.fold(None::<(usize, f64)>, |best, &i| match best {
            Some((_, d)) if d >= gap(i) => best,
            _ => Some((i, gap(i))),
        });
        match next {
            Some((i, _)) => taken.push(i),
            None => break,
        }
    }
    taken
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::SplitName;
    use crate::data::paths::{Lens, training_cameras};

    fn split(times: usize, views: usize) -> Split {
        let lens = Lens { fov_x: 0.5, width: 2, height: 1 };
        let frames: Vec<Frame> = (0..times)
            .flat_map(|t| training_cameras(views, 4.0, lens).into_iter().map(move |camera| (t, camera)))
            .enumerate()
            .map(|(i, (t, camera))| Frame {
                name: format!("{i}"),
                path: format!("{i}.png").into(),
                camera,
                time: t as f64 / (times - 1) as f64,
            })
            .collect();
        let pixels = (0..frames.len()).flat_map(|i| [i as u8; 8]).collect();
        Split { name: SplitName::Train, frames, images: ImageSet { width: 2, height: 1, pixels } }
    }

    #[test]
    fn times_are_spread_and_images_go_with_their_frames() {
        let few = thinned(split(5, 12), 3, 4);
        assert_eq!(few.times(), [0.0, 0.5, 1.0]);
        assert_eq!((few.frames.len(), few.images.pixels.len()), (12, 12 * 8));
        for (i, frame) in few.frames.iter().enumerate() {
            assert_eq!(frame.name, few.images.pixels[8 * i].to_string());
        }
    }

    #[test]
    fn chosen_views_lie_apart() {
        let few = thinned(split(2, 100), 1, 6);
        let gap = |a: &Frame, b: &Frame| a.camera.position().distance(b.camera.position());
        for (i, a) in few.frames.iter().enumerate() {
            for b in &few.frames[..i] {
                assert!(gap(a, b) > 2.5, "{} and {}", a.name, b.name);
            }
        }
    }

    #[test]
    fn the_nearest_times_are_kept_with_their_images() {
        let all = split(5, 3).times();
        assert_eq!(nearest_times(&all, &[0.6, 0.0, 0.9, 0.625]), [0.5, 0.0, 1.0, 0.5]);
        let few = at_times(split(5, 3), &[0.5, 1.0]);
        assert_eq!((few.times(), few.frames.len(), few.images.pixels.len()), (vec![0.5, 1.0], 6, 6 * 8));
        assert!(few.frames.iter().enumerate().all(|(i, f)| f.name == few.images.pixels[8 * i].to_string()));
        let names = |split: Split| split.frames.into_iter().map(|f| f.name).collect::<Vec<_>>();
        assert_eq!(names(evenly(few.clone(), 2)), ["6", "12"]);
        assert_eq!(evenly(few.clone(), 9), few);
    }

    #[test]
    fn limits_of_zero_or_above_the_number_of_views_change_nothing() {
        let whole = split(3, 4);
        assert_eq!(thinned(whole.clone(), 0, 0), whole);
        assert_eq!(thinned(whole.clone(), 9, 9), whole);
    }
}
