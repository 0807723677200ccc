use super::*;

fn segment(name: &str, parent: Option<&str>, members: &[u32]) -> Segment {
    Segment {
        name: Name::new(name).unwrap(),
        parent: parent.map(|p| Name::new(p).unwrap()),
        colour: [0.5, 0.25, 1.0],
        time: 0.3,
        origin: SegmentOrigin::Fine { scale: 0.1 },
        members: members.to_vec(),
    }
}

fn three() -> Segmentation {
    let mut all = Segmentation::new(10, "abc".into());
    all.add(segment("red", None, &[5, 1, 3, 3])).unwrap();
    all.add(segment("red.1", Some("red"), &[1, 3])).unwrap();
    all.add(segment("blue", None, &[])).unwrap();
    all
}

#[test]
fn only_otherwise_unchanged_segments_count_as_renamed() {
    let before = three();
    let mut after = before.clone();
    after.rename("red", &Name::new("core").unwrap()).unwrap();
    assert_eq!(renamed(&before, &after), [["red", "core"]]);
    assert_eq!(renamed(&after, &before), [["core", "red"]]);
    after.add(segment("both", None, &[1, 3, 5])).unwrap();
    after.segments.retain(|s| s.name != *"red.1");
    assert_eq!(renamed(&before, &after), [["red", "core"]], "one is new and one is gone");
    assert!(renamed(&before, &before).is_empty());
}

#[test]
fn files_round_trip_and_damage_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("deep/segments.safetensors");
    let all = three();
    all.save(&path).unwrap();
    assert_eq!(Segmentation::load(&path).unwrap(), all);
    assert_eq!(all.get("red").unwrap().members, [1, 3, 5]);
    let bytes = std::fs::read(&path).unwrap();
    for end in 0..bytes.len() {
        std::fs::write(&path, &bytes[..end]).unwrap();
        Segmentation::load(&path).unwrap_err();
    }
    let mut small = all.clone();
    small.gaussians = 5;
    small.save(&path).unwrap();
    let error = Segmentation::load(&path).unwrap_err().to_string();
    assert!(error.contains("Gaussian 5") && error.contains("red"), "{error}");
}

#[test]
fn a_new_segment_has_a_colour_of_its_own() {
    let mut all = three();
    for name in ["a", "b", "c"] {
        let colour = all.free_colour();
        all.add(Segment { colour, ..segment(name, None, &[1]) }).unwrap();
    }
    all.remove(|s| s.name == "b");
    let colour = all.free_colour();
    assert!(all.segments.iter().all(|s| s.colour != colour));
}

#[test]
fn a_tree_has_each_part_below_its_whole() {
    let mut all = three();
    for (name, parent) in [("blue.1", Some("blue")), ("red.2", Some("red")), ("red.1.1", Some("red.1"))] {
        all.add(segment(name, parent, &[1])).unwrap();
    }
    all.add(segment("lost", Some("nobody"), &[1])).unwrap();
    let tree: Vec<(usize, &str)> = all.tree().iter().map(|(depth, s)| (*depth, s.name.as_str())).collect();
    let wanted = [(0, "red"), (1, "red.1"), (2, "red.1.1"), (1, "red.2"), (0, "blue"), (1, "blue.1"), (0, "lost")];
    assert_eq!(tree, wanted);
}

#[test]
fn a_split_replaces_only_the_parts_of_an_earlier_split() {
    let mut all = three();
    let pick = |all: &mut Segmentation, name: &str, parent: &str| {
        let origin = SegmentOrigin::Pick { scale: 0.5, threshold: 0.8 };
        all.add(Segment { origin, ..segment(name, Some(parent), &[1]) }).unwrap();
    };
    pick(&mut all, "mine", "red");
    pick(&mut all, "red.2", "red");
    assert!(all.made_below_parts("red").is_empty());
    pick(&mut all, "deep", "red.1");
    pick(&mut all, "deeper", "deep");
    let made = |all: &Segmentation| all.made_below_parts("red").iter().map(|s| s.name.to_string()).collect::<Vec<_>>();
    assert_eq!(made(&all), ["deep", "deeper"]);
    assert!(all.made_below_parts("blue").is_empty());
    all.remove_parts("red");
    assert_eq!(all.segments.iter().map(|s| s.name.as_str()).collect::<Vec<_>>(), ["red", "blue", "mine", "red.2"]);
    let red = Name::new("red").unwrap();
    let part = |name: &Name, from, used: &str| all.free_part(name, from, &|part| part == used);
    assert_eq!(part(&red, 1, "").unwrap(), (Name::new("red.1").unwrap(), 1));
    assert_eq!(part(&red, 2, "").unwrap().1, 3, "red.2 is taken");
    assert_eq!(part(&red, 2, "red.3").unwrap().1, 4, "red.3 is used");
    assert!(part(&Name::new("x".repeat(99)).unwrap(), 1, "").is_err());
}

#[test]
fn a_segment_keeps_all_but_its_name_when_it_is_renamed() {
    let mut all = three();
    all.rename("red", &Name::new("core").unwrap()).unwrap();
    let parents: Vec<_> = all.segments.iter().map(|s| (s.name.as_str(), s.parent.as_deref())).collect();
    assert_eq!(parents, [("core", None), ("red.1", Some("core")), ("blue", None)]);
    assert_eq!(all.get("core").unwrap().members, [1, 3, 5]);
    let before = all.clone();
    for (old, new) in [
        ("red", "x"),
        ("core", "blue"),
        ("core", "core"),
        ("blue", DIGEST),
        ("blue", "coarse"),
        ("blue", "pictures.json"),
    ] {
        all.rename(old, &Name::new(new).unwrap()).unwrap_err();
    }
    assert_eq!(all, before);
}

#[test]
fn names_are_unique_and_plain_and_parts_go_with_their_whole() {
    let mut all = three();
    assert!(all.add(segment("red", None, &[])).is_err());
    assert!(all.add(segment(DIGEST, None, &[])).is_err(), "the file's own tensor");
    assert!(all.get("green").unwrap_err().to_string().contains("red, red.1, blue"));
    assert_eq!(all.depths(), [0, 1, 0]);
    assert_eq!(all.labels(&["red".into(), "red.1".into()]).unwrap(), [0, 2, 0, 2, 0, 1, 0, 0, 0, 0]);
    assert_eq!(all.leaves(), ["red.1", "blue"]);
    all.remove(|s| s.name == "red");
    assert_eq!(all.segments.iter().map(|s| s.name.as_str()).collect::<Vec<_>>(), ["blue"]);
}
