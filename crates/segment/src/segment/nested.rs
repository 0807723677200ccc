//! Which parts of different segments are one object, such as the shell and the core of a plume.
//!
//! Where objects touch, all of a scene is connected, so that connection does not tell them apart. But a core is in contact
//! with the shell around it over much of its surface, and with the shell of a neighbour nearly nowhere. Two parts of
//! different segments are one object if each is in contact with the other, and far more than with any other part of that
//! one's segment.

use super::contacts::Contacts;
use crate::config::types::SegmentConfig;
use crate::config::types::segment::NestedConfig;
use crate::model::HostGaussians;
use crate::points::PointsError;
use crate::points::union_find::UnionFind;
use std::collections::BTreeMap;

/// Returns the object of each Gaussian, `[N]`: those with the same number, from 1, are one object; 0 where `part` is 0.
/// `part` `[N]` holds the part of each Gaussian of `at`, 0 for none; parts of different segments have different numbers.
/// `segment` `[N]` holds the segment of each part.
///
/// # Errors
/// If the arrays of `at` disagree.
///
/// # Panics
/// If `part` or `segment` has less than N numbers.
pub fn objects(
    at: &HostGaussians,
    part: &[u32],
    segment: &[u32],
    config: &SegmentConfig,
) -> Result<Vec<u32>, PointsError> {
    let shown: Vec<u32> = (0..at.len() as u32).filter(|&i| part[i as usize] > 0 && at.is_finite(i as usize)).collect();
    let contacts = Contacts::among(at, &shown, &config.contacts)?;
    let mut weights: BTreeMap<u32, f64> = BTreeMap::new();
    // by part, the other part's segment, and that part
    let mut touching: BTreeMap<(u32, u32, u32), f64> = BTreeMap::new();
    for (n, &i) in shown.iter().enumerate() {
        let (own, opacity) = (i as usize, f64::from(at.opacity_of(i as usize)));
        *weights.entry(part[own]).or_default() += opacity;
        let others = contacts.touching(n).iter().map(|&k| shown[k] as usize).filter(|&k| segment[k] != segment[own]);
        let mut others: Vec<(u32, u32)> = others.map(|k| (segment[k], part[k])).collect();
        others.sort_unstable();
        others.dedup();
        for (of, other) in others {
            *touching.entry((part[own], of, other)).or_default() += opacity;
        }
    }
    let closest = closest(&weights, &touching, &config.nested);
    let sets = UnionFind::new(weights.keys().last().map_or(1, |last| *last as usize + 1));
    let segments: BTreeMap<u32, u32> = shown.iter().map(|&i| (part[i as usize], segment[i as usize])).collect();
    for (&(own, _), &other) in &closest {
        if closest.get(&(other, segments[&own])) == Some(&own) {
            sets.union(own, other);
        }
    }
    let is_shown = |part: u32| part > 0 && weights.contains_key(&part);
    Ok(part.iter().map(|&part| if is_shown(part) { sets.find(part) } else { 0 }).collect())
}

/// Returns for a part and another segment the part of that segment which the former is in contact with far more than
/// with the rest of it, if there is one.
fn closest(
    weights: &BTreeMap<u32, f64>,
    touching: &BTreeMap<(u32, u32, u32), f64>,
    config: &NestedConfig,
) -> BTreeMap<(u32, u32), u32> {
    let mut by_segment: BTreeMap<(u32, u32), Vec<(f64, u32)>> = BTreeMap::new();
    for (&(own, of, other), &weight) in touching {
        by_segment.entry((own, of)).or_default().push((weight / weights[&own].max(f64::MIN_POSITIVE), other));
    }
    let first = |((own, of), mut found): ((u32, u32), Vec<(f64, u32)>)| {
        found.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let (most, other) = *found.first()?;
        let next = found.get(1).map_or(0.0, |next| next.0);
        (most >= config.contact && most >= config.ahead * next).then_some(((own, of), other))
    };
    by_segment.into_iter().filter_map(first).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::test_support::{add, surfaces};

    /// Two balls in shells that touch each other, and a small ball that touches the first shell: the Gaussians, and the
    /// part and the segment of each. Segments: 1 balls, 2 shells, 3 the small ball.
    fn plumes() -> (HostGaussians, Vec<u32>, Vec<u32>) {
        let (cores, core_of) = surfaces(&[(-0.6, 0.5), (0.6, 0.5)]);
        let (shells, shell_of) = surfaces(&[(-0.6, 0.58), (0.6, 0.58)]);
        let (small, small_of) = surfaces(&[(-1.36, 0.15)]);
        let mut at = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
        let (mut part, mut segment) = (Vec::new(), Vec::new());
        for (of, ball_of, number) in [(&cores, core_of, 1), (&shells, shell_of, 2), (&small, small_of, 3)] {
            for (row, ball) in of.means.chunks_exact(3).zip(ball_of) {
                add(&mut at, [row[0], row[1], row[2]], [-3.0; 3]);
                part.push(2 * number - 1 + ball as u32);
                segment.push(number);
            }
        }
        (at, part, segment)
    }

    #[test]
    fn a_core_and_its_shell_are_one_object_and_touching_neighbours_are_others() {
        let (at, part, segment) = plumes();
        let found = objects(&at, &part, &segment, &SegmentConfig::default()).unwrap();
        let of = |wanted: u32| found[part.iter().position(|p| *p == wanted).unwrap()];
        assert!(part.iter().zip(&found).all(|(p, object)| *object == of(*p)));
        assert!(of(1) == of(3) && of(2) == of(4), "core and shell");
        assert!(of(1) != of(2) && of(5) != of(1) && of(5) != of(2), "neighbours");
    }

    #[test]
    fn gaussians_in_no_part_are_in_no_object_and_non_finite_ones_follow_their_part() {
        let (mut at, mut part, segment) = plumes();
        at.means[30] = f32::NAN;
        part.iter_mut().filter(|p| **p == 5).for_each(|p| *p = 0);
        let found = objects(&at, &part, &segment, &SegmentConfig::default()).unwrap();
        assert!(part.iter().zip(&found).all(|(part, object)| (*part == 0) == (*object == 0)));
        let none = HostGaussians { sh_stride: 1, ..HostGaussians::default() };
        assert_eq!(objects(&none, &[], &[], &SegmentConfig::default()).unwrap(), [0u32; 0]);
    }
}
