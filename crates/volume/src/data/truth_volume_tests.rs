//! Volumes of ids: round trips, the nearest time, and errors.

use super::*;
use crate::data::truth::{SegmentFile, VolumeEntry};

fn volume(time: f64) -> TruthVolume {
    TruthVolume {
        time,
        dims: [3, 2, 1],
        spacing: [0.5, 0.25, 1.0],
        origin: [-0.5, -0.125, 0.0],
        ids: vec![0, 1, 2, 300, 65_535, 0],
        opacity: vec![0.0, 1.0, 0.25, 0.001, 0.5, 0.0],
    }
}

fn truth(root: &Path, times: &[f64]) -> Truth {
    let volumes = times.iter().enumerate().map(|(i, time)| {
        let file = format!("./step_{i}.safetensors");
        volume(*time).write(&root.join(&file)).unwrap();
        VolumeEntry { time: *time, file }
    });
    let file = SegmentFile {
        source: "labels".into(),
        mask_alpha: 0.05,
        camera_angle_x: 0.5,
        size: [4, 2],
        label_images: Vec::new(),
        segments: Vec::new(),
        volumes: volumes.collect(),
        lineage: Vec::new(),
    };
    std::fs::write(root.join(FILE), crate::versioned::to_json(&file).unwrap()).unwrap();
    Truth::read(root).unwrap()
}

#[test]
fn what_is_written_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("v.safetensors");
    let written = volume(0.25);
    written.write(&path).unwrap();
    let read = TruthVolume::read(&path).unwrap();
    for (a, b) in read.opacity.iter().zip(&written.opacity) {
        assert!((a - b).abs() <= 0.5 / PARTS, "{a} {b}");
    }
    assert_eq!(TruthVolume { opacity: written.opacity.clone(), ..read.clone() }, written);
    assert_eq!((read.centre([0, 0, 0]), read.centre([2, 1, 0])), (written.origin, [0.5, 0.125, 0.0]));
    let first = std::fs::read(&path).unwrap();
    read.write(&path).unwrap();
    assert!(first == std::fs::read(&path).unwrap(), "reading and writing again changes the bytes");
}

#[test]
fn the_nearest_time_and_datasets_without_volumes() {
    let folder = tempfile::tempdir().unwrap();
    let truth = truth(folder.path(), &[1.0, 0.0, 0.5]);
    assert_eq!(truth.volume_times(), [0.0, 0.5, 1.0]);
    for (asked, found) in [(0.0, 0.0), (0.3, 0.5), (0.25, 0.0), (9.0, 1.0), (-1.0, 0.0)] {
        assert_eq!(truth.volume(asked).unwrap().time, found, "{asked}");
    }
    let text = std::fs::read_to_string(folder.path().join(FILE)).unwrap();
    let mut json: serde_json::Value = serde_json::from_str(&text).unwrap();
    json["volumes"] = serde_json::json!([]);
    std::fs::write(folder.path().join(FILE), json.to_string()).unwrap();
    let without = Truth::read(folder.path()).unwrap();
    assert!(without.volume_times().is_empty());
    assert!(without.volume(0.0).unwrap_err().to_string().contains("volumes"));
}

#[test]
fn wrong_files_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("v.safetensors");
    let fails = |words: &str| {
        let error = TruthVolume::read(&path).unwrap_err().to_string();
        assert!(error.contains("v.safetensors") && error.contains(words), "{words}: {error}");
    };
    fails("cannot read");
    TruthVolume { spacing: [1.0, 0.0, 1.0], ..volume(0.0) }.write(&path).unwrap();
    fails("spacing");
    TruthVolume { time: 1e308, origin: [1e308; 3], ..volume(0.0) }.write(&path).unwrap();
    assert!(TruthVolume::read(&path).is_ok());
    assert!(TruthVolume { dims: [2, 2, 2], ..volume(0.0) }.write(&path).is_err());
    TruthVolume { dims: [0; 3], ids: Vec::new(), opacity: Vec::new(), ..volume(0.0) }.write(&path).unwrap();
    fails("[0, 0, 0]");
    tensors::write(&path, Vec::new(), None).unwrap();
    fails("not a volume of segment ids");
    volume(0.0).write(&path).unwrap();
    let whole = std::fs::read(&path).unwrap();
    for i in (0..whole.len()).step_by(13) {
        std::fs::write(&path, &whole[..i]).unwrap();
        assert!(TruthVolume::read(&path).is_err(), "cut at {i}");
    }
}
