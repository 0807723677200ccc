//! Three balls in a row seen by a source that masks whatever it is told is in front.

use super::super::{Mask, MaskReader};
use super::*;
use crate::data::paths::{Lens, training_cameras};
use crate::device::DeviceName;

/// Three dense balls along x; the first hides the others from +x.
fn scene() -> HostGaussians {
    let n = 3;
    HostGaussians {
        means: vec![0.5, 0.0, 0.0, 0.0, 0.0, 0.0, -0.5, 0.0, 0.0],
        rotations: [1.0, 0.0, 0.0, 0.0].repeat(n),
        log_scales: vec![-2.0; 3 * n],
        opacity_logits: vec![4.0; n],
        sh: vec![0.3; 3 * n],
        sh_stride: 1,
        ..HostGaussians::default()
    }
}

struct Fronts {
    front: bool,
    batch: usize,
}

impl MaskSource for Fronts {
    fn name(&self) -> &str {
        "fronts"
    }

    fn find(&self, seen: &MaskInput<'_>) -> Result<Vec<ScoredMask>, SourceError> {
        let (w, h) = (seen.picture.width as u32, seen.picture.height as u32);
        assert_eq!(seen.front.is_some(), self.front);
        let below = background_below(seen.picture, &MasksConfig::default()) as f32;
        let alpha: Vec<bool> = seen.picture.rgba.chunks_exact(4).map(|p| p[3] > below).collect();
        let mask = Mask::from_rows(w, h, seen.front.unwrap_or(&alpha))?;
        Ok(vec![ScoredMask { mask, predicted_iou: seen.view as f32, stability_score: 0.5 }])
    }

    fn needs_front(&self) -> bool {
        self.front
    }

    fn batch_size(&self) -> usize {
        self.batch
    }
}

fn group(name: &str, members: &[u32]) -> MaskGroup {
    MaskGroup { name: name.into(), members: members.to_vec() }
}

/// From +x, and from all around.
fn shots() -> Vec<MaskShot> {
    let eye = glam::DVec3::X * 4.0;
    let mut cameras = vec![Camera::look_at(eye, glam::DVec3::ZERO, glam::DVec3::Z, 0.5, 24, 20)];
    cameras.extend(training_cameras(4, 4.0, Lens { fov_x: 0.5, width: 24, height: 20 }));
    MaskShot::numbered(cameras)
}

fn make(
    groups: &[MaskGroup],
    shots: &[MaskShot],
    source: &Fronts,
    path: &Path,
    stop_at: usize,
) -> Result<u64, MakeError> {
    let device = DeviceName::all()[0].open().unwrap();
    let at = scene();
    let rendering = Rendering { background: [1.0; 3], ..Rendering::default() };
    let job =
        MaskJob { at: &at, groups, shots, time: 0.5, rendering, config: &MasksConfig::default(), device: &device };
    let mut views = 0;
    make_masks(&job, source, path, |seen, found| {
        assert_eq!((seen.group * shots.len() + seen.view, found.len()), (views, 1));
        views += 1;
        views < stop_at
    })
}

#[test]
fn hidden_groups_are_not_in_front() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("masks.jsonl");
    let groups = [group("near", &[0]), group("far", &[2]), group("all", &[0, 1, 2])];
    let source = Fronts { front: true, batch: 2 };
    assert_eq!(make(&groups, &shots(), &source, &path, usize::MAX).unwrap(), 15);
    let reader = MaskReader::open(&path).unwrap();
    let header = reader.header();
    assert_eq!((header.width, header.height, header.source.as_str()), (24, 20, "fronts"));
    assert_eq!((header.segments.join(" "), header.views[4].file.as_str()), ("near far all".into(), "view-004"));
    let from_x = reader.view(0).unwrap();
    let areas: Vec<u64> = from_x.iter().map(|a| a.mask.area()).collect();
    assert!(areas[0] > 8 && areas[1] == 0, "{areas:?}");
    // for the whole scene, everything that shows is in front
    make(&groups[2..], &shots(), &Fronts { front: false, batch: 8 }, &folder.path().join("plain"), usize::MAX).unwrap();
    let plain = MaskReader::open(&folder.path().join("plain")).unwrap();
    for view in 0..5 {
        assert_eq!(reader.view(view).unwrap()[2].mask, plain.view(view).unwrap()[0].mask);
    }
}

#[test]
fn the_same_bytes_on_any_thread_count_and_batch() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = |threads, batch| {
        let path = folder.path().join("masks.jsonl");
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let groups = [group("a", &[0, 1]), group("b", &[2])];
        pool.install(|| make(&groups, &shots(), &Fronts { front: true, batch }, &path, usize::MAX)).unwrap();
        std::fs::read(&path).unwrap()
    };
    let first = bytes(1, 1);
    assert!(first == bytes(3, 8) && first == bytes(2, 3));
}

#[test]
fn the_old_file_stays_when_stopped_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("masks.jsonl");
    std::fs::write(&path, "old").unwrap();
    let source = Fronts { front: false, batch: 2 };
    let good = [group("a", &[0])];
    let fails = |groups: &[MaskGroup], shots: &[MaskShot], stop_at, words: &str| {
        let error = make(groups, shots, &source, &path, stop_at).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    };
    fails(&good, &shots(), 3, "are unchanged");
    fails(&good, &[], usize::MAX, "no views");
    fails(&[group("a", &[3])], &shots(), usize::MAX, "Gaussian 3");
    let mut odd = shots();
    odd[1].camera.width = 30;
    fails(&good, &odd, usize::MAX, "view-001: 30x20");
    let mut odd = shots();
    odd[2].camera.cx += 1.0;
    fails(&good, &odd, usize::MAX, "principal point");
}
