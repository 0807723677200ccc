//! Seeded random subsets without replacement, whose random numbers come from the caller, and evenly spread directions.

/// Returns `wanted` distinct numbers from `0..count`, ascending (all of them where `wanted >= count`).
///
/// `uniform` returns numbers in `[0, 1)`; the same sequence gives the same subset.
pub fn sample_indices(count: usize, wanted: usize, uniform: &mut impl FnMut() -> f32) -> Vec<u32> {
    let mut pool: Vec<u32> = (0..count as u32).collect();
    if wanted >= count {
        return pool;
    }
    for slot in 0..wanted {
        let left = count - slot;
        let step = ((fine_uniform(uniform) * left as f64) as usize).min(left - 1);
        pool.swap(slot, slot + step);
    }
    pool.truncate(wanted);
    pool.sort_unstable();
    pool
}

/// Returns `count` directions spread evenly over the unit sphere on a golden-angle spiral.
pub fn fibonacci_sphere(count: usize) -> Vec<[f32; 3]> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    (0..count)
        .map(|i| {
            let z = 1.0 - (2 * i + 1) as f64 / count as f64;
            let ring = (1.0 - z * z).max(0.0).sqrt();
            let (sin, cos) = (golden * i as f64).sin_cos();
            [(ring * cos) as f32, (ring * sin) as f32, z as f32]
        })
        .collect()
}

/// A uniform number in `[0, 1)` of 48 bits, from two of 24: one `f32` is too coarse to address 150,000 points fairly.
pub(crate) fn fine_uniform(uniform: &mut impl FnMut() -> f32) -> f64 {
    let high = f64::from(uniform()).clamp(0.0, 1.0);
    let low = f64::from(uniform()).clamp(0.0, 1.0);
    (high + low / 16_777_216.0).min(1.0 - f64::EPSILON)
}

#[cfg(test)]
mod tests {
    use super::*;
    use volseggs_testing::generator;

    #[test]
    fn a_sample_has_distinct_ascending_members() {
        let picked = sample_indices(1000, 100, &mut generator(3));
        assert_eq!(picked.len(), 100);
        assert!(picked.windows(2).all(|w| w[0] < w[1]) && picked[99] < 1000);
        assert_eq!(picked, sample_indices(1000, 100, &mut generator(3)));
        assert_ne!(picked, sample_indices(1000, 100, &mut generator(4)));
    }

    #[test]
    fn asking_for_more_than_there_is_gives_all() {
        assert_eq!(sample_indices(3, 10, &mut generator(1)), vec![0, 1, 2]);
        assert!(sample_indices(0, 10, &mut generator(1)).is_empty());
        assert_eq!(sample_indices(5, 4, &mut || 1.0).len(), 4);
    }
}
