//! Connected components of Gaussians that touch. The neighbour grid lives in `neighbours`, the sets in `union_find`;
//! `track` joins components over time.

use super::chunks::{finite, point};
use super::error::{PointsError, check_len, check_positive, rows};
use super::neighbours::{NeighbourGrid, squared};
use super::union_find::UnionFind;
use rayon::prelude::*;

/// Radii below this fraction of the largest are raised to it, which bounds the number of grid levels.
const SMALLEST_SHARE: f32 = 1.0 / (1u32 << 20) as f32;

/// Minimum size of the components to keep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ComponentFilter {
    /// Minimum number of points.
    pub min_count: usize,
    /// Minimum total weight (opacity).
    pub min_weight: f64,
}

impl Default for ComponentFilter {
    /// Keeps everything.
    fn default() -> Self {
        Self { min_count: 1, min_weight: 0.0 }
    }
}

/// Connected components, largest first.
#[derive(Debug, Clone, PartialEq)]
pub struct Components {
    /// `[M]`: 1 for the component with the most points, and so on (lowest member first among equals); 0 for points
    /// skipped or in a component too small.
    pub labels: Vec<u32>,
    /// `[C]`: number of points in each component.
    pub counts: Vec<u32>,
    /// `[C]`: total weight of each component.
    pub weights: Vec<f64>,
}

/// Joins Gaussians that touch: `distance <= factor * (radius_i + radius_j)`.
///
/// `points` `[M, 3]` are the means and `radii` `[M]` their extents in scene units, for instance [`largest_scales`].
/// `factor` multiplies those radii: with standard deviations, 1 to 2 is usual. Points that are not finite, or whose
/// radius is not positive and finite, get label 0. `weights` `[M]` (empty for 1 each) affect the filter alone.
///
/// # Errors
/// Slices of the wrong length; a factor that is not positive and finite; points too far apart for the radii.
pub fn components_touching(
    points: &[f32],
    radii: &[f32],
    factor: f32,
    weights: &[f32],
    filter: &ComponentFilter,
) -> Result<Components, PointsError> {
    let count = check(points, weights)?;
    check_len("radii", radii.len(), count, "[M]")?;
    check_positive("factor", factor)?;
    join(points, radii, factor, weights, filter)
}

/// Returns the largest standard deviation of each Gaussian `[N]` in scene units, from `log_scales` `[N, 3]`.
///
/// # Errors
/// `log_scales` not a whole number of rows.
pub fn largest_scales(log_scales: &[f32]) -> Result<Vec<f32>, PointsError> {
    rows("log_scales", log_scales.len(), 3, "[N, 3]")?;
    let largest = |s: &[f32]| if s.iter().any(|v| v.is_nan()) { f32::NAN } else { s[0].max(s[1]).max(s[2]).exp() };
    Ok(log_scales.chunks_exact(3).map(largest).collect())
}

fn check(points: &[f32], weights: &[f32]) -> Result<usize, PointsError> {
    let count = rows("points", points.len(), 3, "[M, 3]")?;
    if !weights.is_empty() {
        check_len("weights", weights.len(), count, "[M]")?;
    }
    Ok(count)
}

/// Points whose radii differ by less than a factor of two, in a grid fine enough that all points of a cell touch.
struct RadiusLevel {
    grid: NeighbourGrid,
    largest: f64,
}

fn join(
    points: &[f32],
    radii: &[f32],
    factor: f32,
    weights: &[f32],
    filter: &ComponentFilter,
) -> Result<Components, PointsError> {
    let usable = |i: usize| radii[i].is_finite() && radii[i] > 0.0 && finite(point(points, i));
    let mut kept: Vec<u32> = (0..radii.len()).filter(|&i| usable(i)).map(|i| i as u32).collect();
    let largest = kept.iter().map(|&i| radii[i as usize]).fold(0.0, f32::max);
    let floor = (largest * SMALLEST_SHARE).max(f32::MIN_POSITIVE);
    let reach: Vec<f32> = radii.iter().map(|r| r.max(floor)).collect();
    let members = kept.clone();
    let mut levels = Vec::new();
    let mut top = largest;
    while !kept.is_empty() {
        let (now, later): (Vec<u32>, Vec<u32>) = kept.into_iter().partition(|&i| reach[i as usize] > 0.5 * top);
        kept = later;
        top *= 0.5;
        if now.is_empty() {
            continue;
        }
        let smallest = now.iter().map(|&i| reach[i as usize]).fold(f32::INFINITY, f32::min);
        let biggest = now.iter().map(|&i| reach[i as usize]).fold(0.0, f32::max);
        // slightly below 2 r / sqrt(3), so that rounding never separates two points of one cell
        let cell = f64::from(factor) * 2.0 * f64::from(smallest) / 3f64.sqrt() * 0.999_99;
        let grid = NeighbourGrid::of(points, &now, cell);
        if grid.clamped() {
            let extent = cell * f64::from(1u32 << 31);
            return Err(PointsError::Spread { extent, radius: f64::from(factor * smallest) });
        }
        levels.push(RadiusLevel { grid, largest: f64::from(biggest) });
    }
    let sets = UnionFind::new(radii.len());
    for (fine, level) in levels.iter().enumerate() {
        (0..level.grid.cells()).into_par_iter().for_each(|cell| {
            for coarse in 0..=fine {
                link_cell(level, cell, &levels[coarse], coarse == fine, &reach, factor, &sets);
            }
        });
    }
    Ok(number(radii.len(), &members, weights, filter, &sets))
}

/// Joins the points of one cell with each other and with the cells of `other` they may touch.
fn link_cell(
    level: &RadiusLevel,
    cell: usize,
    other: &RadiusLevel,
    same: bool,
    reach: &[f32],
    factor: f32,
    sets: &UnionFind,
) {
    let slots = level.grid.slots(cell);
    let first = level.grid.id(slots.start);
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for slot in slots.clone() {
        if same {
            sets.union(first, level.grid.id(slot));
        }
        for (a, v) in level.grid.place(slot).into_iter().enumerate() {
            low[a] = low[a].min(f64::from(v));
            high[a] = high[a].max(f64::from(v));
        }
    }
    let span = f64::from(factor) * (level.largest + other.largest) * 1.000_01;
    other.grid.cells_in(low.map(|v| v - span), high.map(|v| v + span), |cells| {
        for near in cells {
            if same && near <= cell {
                continue;
            }
            let candidates = other.grid.slots(near);
            if sets.find(first) == sets.find(other.grid.id(candidates.start)) {
                continue;
            }
            'pairs: for a in slots.clone() {
                let (id, place) = (level.grid.id(a), level.grid.place(a));
                for b in candidates.clone() {
                    let other_id = other.grid.id(b);
                    let limit = factor * (reach[id as usize] + reach[other_id as usize]);
                    if squared(place, other.grid.place(b)) <= limit * limit {
                        sets.union(id, other_id);
                        break 'pairs;
                    }
                }
            }
        }
        true
    });
}

/// Turns sets into labels by descending count, without those the filter rejects.
fn number(count: usize, members: &[u32], weights: &[f32], filter: &ComponentFilter, sets: &UnionFind) -> Components {
    let mut counts = vec![0u32; count];
    let mut totals = vec![0f64; count];
    let roots: Vec<u32> = members.iter().map(|&i| sets.find(i)).collect();
    for (&i, &root) in members.iter().zip(&roots) {
        counts[root as usize] += 1;
        let weight = weights.get(i as usize).map_or(1.0, |w| if w.is_finite() { f64::from(*w) } else { 0.0 });
        totals[root as usize] += weight;
    }
    let mut order: Vec<u32> = (0..count as u32)
        .filter(|&r| counts[r as usize] > 0)
        .filter(|&r| counts[r as usize] as usize >= filter.min_count && totals[r as usize] >= filter.min_weight)
        .collect();
    order.sort_by_key(|&r| (std::cmp::Reverse(counts[r as usize]), r));
    let mut label_of = vec![0u32; count];
    for (rank, &root) in order.iter().enumerate() {
        label_of[root as usize] = rank as u32 + 1;
    }
    let mut labels = vec![0u32; count];
    for (&i, &root) in members.iter().zip(&roots) {
        labels[i as usize] = label_of[root as usize];
    }
    Components {
        labels,
        counts: order.iter().map(|&r| counts[r as usize]).collect(),
        weights: order.iter().map(|&r| totals[r as usize]).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use volseggs_testing::generator;

    /// Joins `points` `[M, 3]` that lie within `radius` of each other (inclusive, scene units).
    ///
    /// `weights` `[M]` (empty for 1 each) affect the filter alone. Non-finite points get label 0.
    ///
    /// # Errors
    /// Slices of the wrong length; a radius that is not positive and finite; points spread over more than 2^30 radii.
    fn components_within(
        points: &[f32],
        weights: &[f32],
        radius: f32,
        filter: &ComponentFilter,
    ) -> Result<Components, PointsError> {
        let count = check(points, weights)?;
        check_positive("radius", radius)?;
        // each point is a ball of half the radius
        join(points, &vec![0.5 * radius; count], 1.0, weights, filter)
    }

    fn brute(points: &[f32], radii: &[f32], factor: f32) -> Vec<u32> {
        let sets = UnionFind::new(radii.len());
        for i in 0..radii.len() {
            for j in 0..i {
                let limit = factor * (radii[i] + radii[j]);
                if squared(point(points, i), point(points, j)) <= limit * limit {
                    sets.union(i as u32, j as u32);
                }
            }
        }
        let all: Vec<u32> = (0..radii.len() as u32).collect();
        number(radii.len(), &all, &[], &ComponentFilter::default(), &sets).labels
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]
        #[test]
        fn touching_agrees_with_all_pairs(seed in 0u64..1000, count in 1usize..150, spread in 0f32..9.0, factor in 0.2f32..2.0) {
            let mut u = generator(seed);
            let points: Vec<f32> = (0..3 * count).map(|_| u()).collect();
            let radii: Vec<f32> = (0..count).map(|_| 0.1 * (-spread * u()).exp()).collect();
            let got = components_touching(&points, &radii, factor, &[], &ComponentFilter::default()).unwrap();
            prop_assert_eq!(&got.labels, &brute(&points, &radii, factor));
            let got = components_within(&points, &[], 0.1, &ComponentFilter::default()).unwrap();
            prop_assert_eq!(got.labels, brute(&points, &vec![0.05; count], 1.0));
        }

        #[test]
        fn turning_and_shifting_changes_nothing(seed in 0u64..1000) {
            let mut u = generator(seed);
            let points: Vec<f32> = (0..300).map(|_| (u() * 32.0).round() / 8.0).collect();
            let turned: Vec<f32> = points.chunks_exact(3).flat_map(|p| [3.0 - p[1], p[0] - 2.0, p[2] + 5.0]).collect();
            let of = |p: &[f32]| components_within(p, &[], 0.3, &ComponentFilter::default()).unwrap();
            prop_assert_eq!(of(&points), of(&turned));
        }
    }

    #[test]
    fn points_just_out_of_reach_stay_apart_in_any_direction() {
        for d in crate::points::sampling::fibonacci_sphere(200).iter().chain(&[[3f32.sqrt().recip(); 3]]) {
            for (distance, components) in [(0.499, 1), (0.501, 2), (0.58, 2)] {
                let points = [0.0, 0.0, 0.0, d[0] * distance, d[1] * distance, d[2] * distance];
                let within = components_within(&points, &[], 0.5, &ComponentFilter::default()).unwrap();
                let touching =
                    components_touching(&points, &[0.3, 0.2], 1.0, &[], &ComponentFilter::default()).unwrap();
                assert_eq!((within.counts.len(), touching.counts.len()), (components, components), "{d:?} {distance}");
            }
        }
    }

    #[test]
    fn sizes_order_the_labels_and_the_filter_drops_small_ones() {
        let points: Vec<f32> = [5.0, 0.0, 0.1, 0.2, 9.0, 9.1].iter().flat_map(|x| [*x, 0.0, 0.0]).collect();
        let weights = [1.0, 0.5, 0.5, 0.5, 0.01, 0.01];
        let all = components_within(&points, &weights, 0.15, &ComponentFilter::default()).unwrap();
        assert_eq!(all.labels, [3, 1, 1, 1, 2, 2]);
        assert_eq!(all.counts, [3, 2, 1]);
        assert!((all.weights[0] - 1.5).abs() < 1e-6);
        let big = ComponentFilter { min_count: 2, min_weight: 0.1 };
        assert_eq!(components_within(&points, &weights, 0.15, &big).unwrap().labels, [0, 1, 1, 1, 0, 0]);
    }

    #[test]
    fn a_large_gaussian_bridges_small_ones() {
        let points = [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 3.0, 0.0, 0.0];
        let radii = largest_scales(&[-9.0, -9.0, -9.0, -9.0, 0.0, -9.0, -9.0, -9.0, -9.0, -9.0, -9.0, -9.0]).unwrap();
        let found = components_touching(&points, &radii, 1.0, &[], &ComponentFilter::default()).unwrap();
        assert_eq!(found.labels, [1, 1, 1, 2]);
    }

    #[test]
    fn poison_points() {
        let filter = ComponentFilter::default();
        assert!(components_within(&[], &[], 1.0, &filter).unwrap().counts.is_empty());
        assert_eq!(components_within(&[1.0; 3], &[], 1.0, &filter).unwrap().labels, [1]);
        let points = [f32::NAN, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0];
        assert_eq!(components_within(&points, &[f32::NAN; 3], 1.0, &filter).unwrap().labels, [0, 1, 1]);
        let radii = [1.0, f32::NAN, 1.0];
        assert_eq!(components_touching(&[0.0; 9], &radii, 1.0, &[], &filter).unwrap().labels, [1, 0, 1]);
        assert_eq!(components_touching(&[0.0; 9], &[0.0; 3], 1.0, &[], &filter).unwrap().labels, [0; 3]);
        let far = components_within(&[0.0, 0.0, 0.0, 1e30, 0.0, 0.0], &[], 0.1, &filter);
        assert!(matches!(far, Err(PointsError::Spread { .. })));
        assert!(components_within(&[0.0; 3], &[], f32::NAN, &filter).is_err());
        assert!(components_touching(&[0.0; 3], &[1.0; 2], 1.0, &[], &filter).is_err());
    }

    #[test]
    fn many_equal_points_are_quick() {
        let found = components_within(&[0.5; 90_000], &[], 0.1, &ComponentFilter::default()).unwrap();
        assert_eq!(found.counts, [30_000]);
    }

    #[test]
    fn the_thread_count_never_changes_a_label() {
        let mut u = generator(8);
        let points: Vec<f32> = (0..60_000).map(|_| u()).collect();
        let radii: Vec<f32> = (0..20_000).map(|_| 0.02 * (-5.0 * u()).exp()).collect();
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| components_touching(&points, &radii, 1.2, &[], &ComponentFilter::default()).unwrap())
        };
        assert_eq!(run(1), run(4));
    }
}
