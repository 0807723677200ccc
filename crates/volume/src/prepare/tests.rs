//! Preparing datasets as a user would, in a temporary folder.

use super::error::nothing_visible;
use super::*;
use crate::data::dataset::{Dataset, OpenOptions};
use crate::data::truth::SegmentFile;
use crate::prepare::views::TrainingTimes;
use crate::volume::placement::published_side;
use crate::volume::synthetic::Synthetic;

pub(super) fn options(size: u32) -> PrepareOptions {
    PrepareOptions {
        views: ViewOptions {
            size: [size; 2],
            times: TrainingTimes::Count(3),
            views_per_time: 4,
            test_views: 7,
            ..ViewOptions::default()
        },
        side: published_side(),
        step: 1.0,
        segments: SegmentOptions { views: 3, steps: SegmentSteps::These(vec![0, 4]), label_images: true },
        replace: false,
        needed: Vec::new(),
    }
}

fn source(scene: Synthetic) -> (PrepareSource, TransferFunction) {
    (PrepareSource::Synthetic { scene, dims: [48; 3], steps: 5 }, scene.transfer_function().unwrap())
}

fn make(out: &Path, options: &PrepareOptions) -> Result<PrepareRecord, PrepareError> {
    make_with(Synthetic::Shells, out, options)
}

pub(super) fn make_with(scene: Synthetic, out: &Path, options: &PrepareOptions) -> Result<PrepareRecord, PrepareError> {
    let (source, transfer) = source(scene);
    prepare(&source, &transfer, options, out, &|_| {}, &AtomicBool::new(false))
}

#[test]
fn a_dataset_opens_and_its_truth_is_there() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a/b/data");
    let record = make(&out, &options(40)).unwrap();
    assert_eq!((record.train_views, record.test_views, record.steps), (12, 7, 5));
    let open = OpenOptions { downscale: 1, splits: &SplitName::ALL[..1], max_views: None };
    let dataset = Dataset::open(&out, &open).unwrap();
    assert_eq!(dataset.train.frames.len(), 12);
    assert_eq!(dataset.train.times(), [0.0, 0.5, 1.0]);
    assert!(dataset.train.images.frame(0).chunks_exact(4).any(|p| p[3] > 0));

    let text = std::fs::read_to_string(out.join("segments.json")).unwrap();
    let file: SegmentFile = crate::versioned::from_json(&text).unwrap();
    let names: Vec<&str> = file.segments.iter().map(|s| s.name.as_str()).collect();
    assert_eq!(names, Synthetic::Shells.segment_names());
    assert_eq!(record.segments, names);
    for segment in &file.segments {
        assert_eq!(segment.frames.len(), 6, "three views at two steps");
        for frame in &segment.frames {
            let image = image::open(out.join(&frame.file_path)).unwrap().to_rgba8();
            let mask = image::open(out.join(&frame.mask_path)).unwrap().to_luma8();
            let marked = mask.pixels().filter(|p| p.0[0] == 255).count();
            assert!(marked == frame.pixels && marked > 0, "{}", frame.mask_path);
            let low = image.pixels().zip(mask.pixels()).filter(|(_, m)| m.0[0] > 0).map(|(p, _)| p.0[3]).min();
            assert!(low >= Some((255.0 * MASK_ALPHA) as u8), "{low:?}");
        }
    }
    let labels = image::open(out.join("labels/test/r_3.png")).unwrap().to_luma8();
    assert!(labels.pixels().any(|p| p.0[0] > 0) && labels.pixels().all(|p| usize::from(p.0[0]) <= names.len()));
    assert_eq!(preview(&out, 3).unwrap().len(), 3);
    let tf = TransferFunction::load(&out.join("transfer-function.toml").to_string_lossy()).unwrap();
    assert_eq!(tf.name, record.transfer_function);
}

#[test]
fn the_same_options_give_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = |name: &str, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let out = folder.path().join(name);
        pool.install(|| make(&out, &options(24))).unwrap();
        [
            "train/r_5.png",
            "test/r_6.png",
            "labels/train/r_0.png",
            "transforms_train.json",
            "segments.json",
            "volumes/step_4.safetensors",
        ]
        .map(|f| std::fs::read(out.join(f)).unwrap())
    };
    assert!(bytes("one", 1) == bytes("two", 3));
}

#[test]
fn a_stopped_or_wrong_run_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("data");
    let (source, transfer) = source(Synthetic::Jets);
    let stopped = prepare(&source, &transfer, &options(24), &out, &|_| {}, &AtomicBool::new(true));
    assert!(matches!(stopped, Err(PrepareError::Interrupted)));
    let mut wrong = Vec::new();
    for change in [
        |o: &mut PrepareOptions| o.views.times = TrainingTimes::Steps(vec![0, 5]),
        |o: &mut PrepareOptions| o.views.times = TrainingTimes::Steps(vec![1, 1]),
        |o: &mut PrepareOptions| o.views.times = TrainingTimes::Steps(vec![1, 0]),
        |o: &mut PrepareOptions| o.views.times = TrainingTimes::Count(0),
        |o: &mut PrepareOptions| o.views.views_per_time = 0,
        |o: &mut PrepareOptions| o.views.size = [0, 4],
        |o: &mut PrepareOptions| o.views.fov_x = f64::NAN,
        |o: &mut PrepareOptions| o.views.radius = 0.5,
        |o: &mut PrepareOptions| o.step = 0.0,
        |o: &mut PrepareOptions| o.step = 1e-30,
        |o: &mut PrepareOptions| o.views.radius = 1e300,
        |o: &mut PrepareOptions| o.side = 0.0,
    ] {
        let mut options = options(24);
        change(&mut options);
        let error = prepare(&source, &transfer, &options, &out, &|_| {}, &AtomicBool::new(false)).unwrap_err();
        assert!(matches!(error, PrepareError::Options(_)), "{error}");
        wrong.push(error.to_string());
    }
    assert!(wrong[0].contains("step 5") && wrong[0].contains("5 steps"), "{}", wrong[0]);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "no folder, no temporary");
}

#[test]
fn a_dataset_is_replaced_only_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("data");
    make(&out, &options(24)).unwrap();
    assert!(matches!(make(&out, &options(24)), Err(PrepareError::Exists(_))));
    let again = PrepareOptions { replace: true, ..options(30) };
    assert_eq!(make(&out, &again).unwrap().size, [30, 30]);
    // another process takes the name in the meantime
    let (source, transfer) = source(Synthetic::Shells);
    let raced = folder.path().join("raced");
    let take = |_| drop(std::fs::create_dir_all(&raced));
    let error = prepare(&source, &transfer, &options(24), &raced, &take, &AtomicBool::new(false)).unwrap_err();
    assert!(matches!(error, PrepareError::Exists(_)), "{error}");
    let name = raced.display().to_string();
    assert_eq!(error.to_string().matches(&name).count(), 1, "{error}");
}

#[test]
fn errors_name_the_dataset_and_each_path_once() {
    let (root, out) = (Path::new("a/.tmp-data-7@0-0"), Path::new("a/data"));
    let write = |path: &str, reason: &str| PrepareError::Write { path: path.into(), reason: reason.into() };
    for (error, text) in [
        (write("a/.tmp-data-7@0-0", "a/.tmp-data-7@0-0: No space left"), "a/data: No space left"),
        (
            write("a/.tmp-data-7@0-0/volumes/x", "a/.tmp-data-7@0-0/volumes/x: File too large"),
            "a/data/volumes/x: File too large",
        ),
        (write("elsewhere", "gone"), "elsewhere: gone"),
    ] {
        assert_eq!(error.published_as(root, out).to_string(), text);
    }
    let source = std::io::ErrorKind::StorageFull.into();
    let (path, hint) = (root.join("transforms_train.json"), "make room".to_owned());
    let error = PrepareError::Data(DataError::Io { path, action: "write the file", source, hint });
    let text = error.published_as(root, out).to_string();
    assert!(text.starts_with("a/data/transforms_train.json: cannot write the file: ") && text.contains("make room"));
}

#[test]
fn a_volume_that_is_too_thin_to_be_seen_is_the_reason() {
    let reason = |size: [f64; 3]| nothing_visible("v.nrrd", "fire", [0.0, 1.0], size);
    assert!(reason([1e-20, 30.0, 30.0]).contains("correct its spacing"));
    assert!(reason([30.0, 30.0, 1e4]).contains("30 x 30 x 10000"));
    assert!(reason([1.0, 2.0, 40.0]).contains("makes nothing visible"));
}

#[test]
fn the_folder_appears_whole_with_its_record_and_contact_sheet() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("data");
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let watcher = scope.spawn(|| {
            while !out.exists() && !done.load(Ordering::Relaxed) {
                std::hint::spin_loop();
            }
            ["prepare.json", "contact-sheet.png", "transfer-function.toml", "segments.json"]
                .map(|f| out.join(f).is_file())
        });
        let made = make(&out, &options(24));
        done.store(true, Ordering::Relaxed);
        made.unwrap();
        assert_eq!(watcher.join().unwrap(), [true; 4]);
    });
}

#[test]
fn empty_images_are_refused_and_empty_times_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("data");
    let source = PrepareSource::Synthetic { scene: Synthetic::Shells, dims: [16; 3], steps: 5 };
    let mut transfer = Synthetic::Shells.transfer_function().unwrap();
    let record = make(&out, &options(24)).unwrap();
    assert!(record.empty_times.is_empty());
    std::fs::remove_dir_all(&out).unwrap();
    transfer.opacity.iter_mut().for_each(|p| p.1 = 0.0);
    let error = prepare(&source, &transfer, &options(24), &out, &|_| {}, &AtomicBool::new(false)).unwrap_err();
    assert!(matches!(error, PrepareError::Empty { .. }), "{error}");
    assert!(error.to_string().contains("volseggs inspect"), "{error}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn sizes_beyond_memory_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("data");
    for (change, name) in [
        ((|o: &mut PrepareOptions| o.views.views_per_time = usize::MAX) as fn(&mut PrepareOptions), "--views"),
        (|o| o.views.test_views = usize::MAX / 2, "--test-views"),
    ] {
        let mut options = options(24);
        change(&mut options);
        let error = make(&out, &options).unwrap_err();
        assert!(matches!(error, PrepareError::Memory(_)) && error.to_string().starts_with(name), "{error}");
    }
    assert!(!out.exists());
}
