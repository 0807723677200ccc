//! Which segments a label volume holds, and which of them each Gaussian belongs to.

use crate::segment::segmentation::{SegmentOrigin, Segmentation, SegmentationError};

/// Names of segments, labelled from 1 in this order, and the label of each Gaussian: 0 for none; above the number of
/// names, one for each other segment without parts, as it occupies places too.
#[derive(Debug, PartialEq)]
pub(super) struct LabelChoice {
    pub names: Vec<String>,
    pub labels: Vec<u32>,
}

/// Chooses the segments that were `asked` for, each once; a Gaussian in several of them belongs to the last. If none
/// were asked for, chooses those without parts; a Gaussian then belongs to a group only if no part contains it, and a
/// group that is left without Gaussians is omitted.
///
/// # Errors
/// If a name is unknown.
pub(super) fn choose(all: &Segmentation, asked: &[String]) -> Result<LabelChoice, SegmentationError> {
    if !asked.is_empty() {
        let mut names: Vec<String> = Vec::new();
        for name in asked {
            if !names.contains(name) {
                names.push(name.clone());
            }
        }
        let mut labels = all.labels(&names)?;
        add_others(all, names.len() as u32, &mut labels)?;
        return Ok(LabelChoice { labels, names });
    }
    let (mut names, mut groups) = (Vec::new(), Vec::new());
    for name in all.leaves() {
        let list = if all.get(&name)?.origin == SegmentOrigin::Group { &mut groups } else { &mut names };
        list.push(name);
    }
    let mut labels = all.labels(&names)?;
    for name in groups {
        // Gaussians of parts are labelled already; of two groups, the earlier one keeps the Gaussians in both
        let label = names.len() as u32 + 1;
        let free = all.get(&name)?.members.iter().filter(|i| labels[**i as usize] == 0);
        let free: Vec<u32> = free.copied().collect();
        if !free.is_empty() {
            free.iter().for_each(|i| labels[*i as usize] = label);
            names.push(name);
        }
    }
    Ok(LabelChoice { names, labels })
}

/// Gives each segment without parts a label above `last` on those of its Gaussians that have none.
fn add_others(all: &Segmentation, last: u32, labels: &mut [u32]) -> Result<(), SegmentationError> {
    for (label, name) in (last + 1..).zip(all.leaves()) {
        let segment = all.get(&name)?;
        if segment.origin != SegmentOrigin::Group {
            for &i in &segment.members {
                if labels[i as usize] == 0 {
                    labels[i as usize] = label;
                }
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::name::Name;
    use crate::segment::segmentation::Segment;

    fn add(all: &mut Segmentation, name: &str, parent: Option<&str>, origin: SegmentOrigin, members: &[u32]) {
        let name = Name::new(name).unwrap();
        let parent = parent.map(|p| Name::new(p).unwrap());
        let segment = Segment { name, parent, colour: [0.5; 3], time: 0.0, origin, members: members.to_vec() };
        all.add(segment).unwrap();
    }

    fn example() -> Segmentation {
        let mut all = Segmentation::new(8, "scene".into());
        add(&mut all, "red", None, SegmentOrigin::Coarse, &[0, 1, 2, 3]);
        add(&mut all, "both", None, SegmentOrigin::Group, &[0, 1, 4]);
        add(&mut all, "red.1", Some("red"), SegmentOrigin::Fine { scale: 0.5 }, &[0, 1]);
        add(&mut all, "red.2", Some("red"), SegmentOrigin::Fine { scale: 0.5 }, &[2]);
        add(&mut all, "blue", None, SegmentOrigin::Coarse, &[4]);
        add(&mut all, "wide", None, SegmentOrigin::Group, &[0, 3, 4, 5]);
        all
    }

    #[test]
    fn groups_do_not_take_the_gaussians_of_parts() {
        let found = choose(&example(), &[]).unwrap();
        assert_eq!(found.names, ["red.1", "red.2", "blue", "wide"], "nothing is left of the group `both`");
        assert_eq!(found.labels, [1, 1, 2, 4, 3, 4, 0, 0]);
    }

    #[test]
    fn a_group_that_was_asked_for_has_all_of_its_gaussians() {
        let found = choose(&example(), &["blue", "red", "both", "blue"].map(String::from)).unwrap();
        assert_eq!(found.names, ["blue", "red", "both"]);
        assert_eq!(found.labels, [3, 3, 2, 2, 3, 0, 0, 0]);
        assert!(choose(&example(), &["nobody".into()]).is_err());
    }
}
