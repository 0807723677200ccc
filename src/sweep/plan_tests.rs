//! Tests of plans: everything is checked before anything runs.

use super::*;
use crate::config::types::Config;
use crate::data::truth::{SegmentFile, VolumeEntry};
use crate::sweep::file::DataSource;
use crate::sweep::result::{metrics_path, segments_path};

const DATA: &str = "[data]\njets = { synthetic = 'jets', size = 40, times = 3, views = 4, test_views = 5 }\n";

fn plan_with(text: &str, options: &PlanOptions) -> Result<Plan, SweepError> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("my sweep.toml");
    std::fs::write(&path, text).unwrap();
    Plan::new(&path, options)
}

fn plan(text: &str) -> Result<Plan, SweepError> {
    plan_with(text, &PlanOptions { out: "/out".into(), ..PlanOptions::default() })
}

fn error(text: &str) -> String {
    plan(text).unwrap_err().to_string()
}

#[test]
fn entries_are_all_combinations_with_seeds_outermost() {
    let text = format!(
        "config = 'demo'\nseeds = [0, 1]\ndevices = ['flex', 'ndarray']\n[[variant]]\nname = 'a'\n[[variant]]\n\
         name = 'b'\nset = {{ 'loss.tv' = 0.0 }}\n{DATA}"
    );
    let plan = plan(&text).unwrap();
    assert_eq!((plan.runs.len(), plan.entries.len()), (8, 8));
    assert_eq!(plan.name, "my-sweep");
    assert_eq!(plan.runs[1].label, "b seed 0");
    assert_eq!(plan.runs[2].label, "a ndarray seed 0");
    assert!(plan.entries[..4].iter().all(|e| e.seed == 0));
    assert_eq!(plan.entries[1].settings["loss.tv"], "0.0");
    assert_eq!(plan.baseline, "a");
    let mut keys: Vec<&str> = plan.runs.iter().map(|r| r.key.as_str()).collect();
    keys.sort_unstable();
    keys.dedup();
    assert_eq!(keys.len(), 8);
}

#[test]
fn a_variant_may_have_seeds_of_its_own() {
    let text = format!(
        "config = 'demo'\nseeds = [0, 1]\n[[variant]]\nname = 'slow'\nseeds = [0]\nset = {{ 'loss.tv' = 0.0 }}\n\
         [[variant]]\nname = 'a'\n[[variant]]\nname = 'b'\nset = {{ 'loss.tv' = 0.1 }}\nseeds = [7, 1]\n{DATA}"
    );
    let labels = |options: PlanOptions| -> Vec<String> {
        plan_with(&text, &options).unwrap().runs.into_iter().map(|run| run.label).collect()
    };
    let out = || PlanOptions { out: "/out".into(), ..PlanOptions::default() };
    assert_eq!(labels(out()), ["slow seed 0", "a seed 0", "a seed 1", "b seed 1", "b seed 7"]);
    let typed = PlanOptions { seeds: vec![4], ..out() };
    assert_eq!(labels(typed), ["slow seed 4", "a seed 4", "b seed 4"], "the command line's are for all");
}

#[test]
fn a_variant_may_start_from_a_configuration_of_its_own() {
    let text = format!(
        "config = 'quick'\n[[variant]]\nname = 'ours'\n[[variant]]\nname = 'D3DGS'\nconfig = 'd3dgs-small'\nset = {{ 'init.points' = \
         70 }}\n{DATA}"
    );
    let plan = plan(&text).unwrap();
    let config = |i: usize| -> Config { toml::from_str(&plan.runs[i].config).unwrap() };
    assert_eq!((config(0).method.as_str(), config(1).method.as_str()), ("volseggs", "d3dgs"));
    assert_eq!((config(0).init.points, config(1).init.points, plan.runs[1].steps), (30_000, 70, 3000));
    assert_eq!(plan.entries[1].settings["config"], "d3dgs-small");
    assert!(!plan.entries[0].settings.contains_key("config"));
    let message = error(&format!("[[variant]]\nname = 'x'\nconfig = 'no-such-preset'\n{DATA}"));
    assert!(message.contains("variant \"x\"") && message.contains("no-such-preset"), "{message}");
}

#[test]
fn invalid_sweeps_are_errors_that_name_the_cause() {
    let with = |more: &str| error(&format!("{more}\n{DATA}"));
    for (text, part) in [
        ("[[variant]]\nname = 'x'\nset = { 'loss.knid' = 'l1' }", "variant \"x\""),
        ("[[variant]]\nname = 'x'\nset = { 'loss.kind' = 'l3' }", "loss.kind"),
        ("[[variant]]\nname = 'x'\nset = { 'init.points' = 0 }", "init.points"),
        ("[[variant]]\nname = 'x'\nset = { method = 'guess' }", "there is no method \"guess\""),
        ("[[variant]]\nname = 'x'\nset = { method = 'd3dgs' }", "section [d3dgs]"),
        ("devices = ['abacus']", "abacus"),
        ("seeds = [1, 1]", "twice"),
        ("seeds = []", "seeds: an empty list"),
        ("[[variant]]\nname = 'x'\nseeds = []", "variant \"x\": seeds: an empty list"),
        ("[[variant]]\nname = 'x'\nseeds = [3, 3]", "variant \"x\": seeds: 3 is listed twice"),
        ("seeds = [-4]", "expected a whole number, 0 or above, not -4"),
        ("set = { seed = -4 }", "set.seed: seeds are a separate axis, of whole numbers from 0"),
        ("set = { seed = 4 }", "set.seed: seeds are a separate axis; write seeds = [4]"),
        ("[[variant]]\nname = 'x'\nset = { seed = 3 }", "variant \"x\": set.seed"),
        ("[grid]\nseed = [1, 2]", "grid.seed: seeds are a separate axis; write seeds = [1, 2]"),
        ("[random]\ncount = 100000000000\n[random.keys]\n'loss.tv' = { low = 0, high = 1 }", "random.count"),
        ("metrics = ['psnrr']", "psnrr"),
        ("metrics = ['psnr', 'iou_3d']", "metrics: \"iou_3d\" is a metric of segments"),
        ("metrics = ['segment_seconds']", "add [segments]"),
        ("metrics = ['iou', 'psnr_edge']\n[segments]\nviews = 7", "\"psnr_edge\" is measured of the whole scene only"),
        ("baseline = 'nobody'", "nobody"),
        ("sedes = [1]", "sedes"),
        ("config = 'no-such-preset'", "no-such-preset"),
        ("[halving]\nrungs = [900, 300]", "ascending"),
        ("[halving]\nrungs = [300]\nkeep = 2", "keep"),
        ("set = { 'output.eval_every' = 0 }\n[halving]\nrungs = [300]", "eval_every"),
        ("[[variant]]\nname='x'\n[[variant]]\nname='s'\nconfig='static'", "data.only_times = [0.5]"),
        ("[[variant]]\nname='x'\n[[variant]]\nname='h'\nset={'data.downscale'=2}", "data.downscale = 2"),
        ("[segments]\nsam_points = 16", "segments.sam_points: applies to masks = \"sam\""),
        ("[eval]\nviews = 0", "eval.views"),
        ("[eval]\nlpips_weights = ['nothing.safetensors']", "nothing.safetensors"),
        ("[segments]\nmethod = 'guess'", "guess"),
        ("[segments]\nviews = 99999999999", "segments.views = 99999999999: must be at most 100000"),
        ("[segments]\nclusters = 0", "segments.clusters = 0"),
        ("[segments]\nmargin = 1e300", "segments.margin"),
        ("[segments]\nveiws = 3", "veiws"),
        ("[segments]\nmasks = 'guess'", "regions, labels, dir, sam"),
        ("[segments]\nmasks = 'dir'", "segments.mask_dir"),
        ("[segments]\nmasks = 'dir'\nmask_dir = 'no-such-masks'", "no-such-masks: no such"),
        ("[segments]\nmask_dir = '.'", "segments.mask_dir: applies to masks = \"dir\""),
        ("[segments]\nmasks = 'sam'\nsam_weights = 'no-such-weights'", "no-such-weights"),
        ("[segments]\npixels = 0", "segments.pixels"),
        ("[segments]\npixels = 20000", "segments.pixels = 20000: must be at most 16384"),
        ("[segments]\nmask_scale = 'large'", "segments.mask_scale"),
        ("[segments]\nscore = ['pair']", "segments.score"),
        ("set = { 'data.downscale' = 3 }", "downscale"),
        ("[segments]\nviews = 7", "segments = true"),
    ] {
        let said = with(text);
        assert!(said.contains(part), "{text}: {said}");
        assert!(said.contains("my sweep.toml"), "{said}");
    }
    assert!(error("[data]\nx = { synthetic = 'teapot' }").contains("data.x"));
    assert!(error("[data]\nx = '/no/such/folder'").contains("data.x"));
    for name in ["../../evil", "/abs", "..", "a/b", ""] {
        let said = error(&format!("[data]\n'{name}' = {{ synthetic = 'jets' }}"));
        assert!(said.contains("cannot be a name") && said.contains("my sweep.toml: data."), "{said}");
    }
    for (key, expected) in [
        ("size = 4000000000", "size = 4000000000: must be from 8 to 16384"),
        ("times = 9223372036854775807", "times = 9223372036854775807: must be from 1"),
        ("times = 90000, views = 90000", "times * views = 8100000000"),
        ("voxels = 100000", "voxels = 100000: must be from 2 to 4096"),
        ("views = 0", "views = 0"),
        ("segment_views = 3", "segment_views needs segments = true"),
        ("segments = true, test_views = 4, segment_views = 5", "segment_views = 5: must be from 1 to 4"),
        ("shading = { ambient = -1.0 }", "shading.ambient = -1: must be finite and at least 0"),
        ("shading = { shininess = 3.0 }", "shininess"),
    ] {
        let message = error(&format!("[data]\nx = {{ synthetic = 'jets', {key} }}"));
        assert!(message.contains("data.x") && message.contains(expected), "{message}");
    }
    assert!(error("title = 'no data'").contains("--data"));
    let data = vec!["/one/data".into(), "/two/data".into()];
    let twice = plan_with("", &PlanOptions { data, ..PlanOptions::default() }).unwrap_err().to_string();
    assert!(twice.contains("two datasets are called \"data\""), "{twice}");
}

#[test]
fn what_prepare_would_refuse_is_refused_by_the_plan() {
    // with and without segments
    for segments in [false, true] {
        let data = DATA.replace("size", &format!("segments = {segments}, size"));
        let planned = plan(&format!("config = 'demo'\n{data}")).unwrap();
        let DataSource::Synthetic(spec) = &planned.datasets["jets"].source else { panic!("no synthetic scene") };
        assert_eq!(spec.segments, segments);
    }
    let dir = tempfile::tempdir().unwrap();
    let options = PlanOptions { out: dir.path().to_owned(), ..PlanOptions::default() };
    let text = format!("config = 'demo'\n{DATA}");
    let folder = plan_with(&text, &options).unwrap().datasets["jets"].folder.clone();
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("mine.txt"), "").unwrap();
    let said = plan_with(&text, &options).unwrap_err().to_string();
    assert!(said.contains("data.jets") && said.contains("already exists"), "{said}");
}

#[test]
fn keys_of_synthetic_datasets_can_be_set_on_the_command_line() {
    let text = format!("config = 'demo'\n{DATA}");
    let set = |settings: &[&str], text: &str| {
        let synthetic = settings.iter().map(|s| (*s).to_owned()).collect();
        plan_with(text, &PlanOptions { out: "/out".into(), synthetic, ..PlanOptions::default() })
    };
    let small = set(&["size=16", "shading = { ambient = 0.5 }"], &text).unwrap();
    assert_eq!(small.datasets["jets"].size, [16; 2]);
    assert_ne!(small.runs[0].key, plan(&text).unwrap().runs[0].key);
    for (setting, words) in [
        ("size", "--synthetic: \"size\": expected KEY=VALUE"),
        ("size=1\nviews=2", "expected KEY=VALUE"),
        ("size=4", "data.jets: size = 4: must be from 8"),
        ("width=4", "data.jets: unknown key `width`"),
    ] {
        let said = set(&[setting], &text).unwrap_err().to_string();
        assert!(said.contains(words), "{setting}: {said}");
    }
    let said = set(&["size=16"], "[data]\nx = '/no/such/folder'").unwrap_err().to_string();
    assert!(said.contains("no synthetic dataset"), "{said}");
}

#[test]
fn duplicates_are_refused_but_measurements_share_runs() {
    let twins = format!(
        "config = 'demo'\n[[variant]]\nname = 'a'\n[[variant]]\nname = 'b'\nset = {{ 'loss.dssim' = 0.0 }}\n{DATA}"
    );
    let said = error(&twins);
    assert!(said.contains("variant \"b\"") && said.contains("\"a\""), "{said}");
    let text = format!(
        "config = 'demo'\n[segments]\nviews = 7\n[[variant]]\nname = 'c'\nset = {{ 'segments.method' = 'coarse' }}\n\
         [[variant]]\nname = 'f'\nset = {{ 'segments.method' = 'fine' }}\n{}",
        DATA.replace("size", "segments = true, size")
    );
    let plan = plan(&text).unwrap();
    assert_eq!((plan.runs.len(), plan.entries.len()), (1, 2));
    assert_eq!(plan.runs[0].segments.len(), 2);
    assert_eq!(plan.runs[0].segments[1].views, 7);
    assert_eq!(plan.entries[1].segments, Some(1));
}

#[test]
fn options_of_segmentation_share_the_trained_run() {
    let text = format!(
        "config = 'demo'\n[segments]\nmethod = 'coarse'\n[grid]\n'segment.layers.edge' = [0.2, 0.25]\n\
         'segment.layers.join' = [true, false]\n{}",
        DATA.replace("size", "segments = true, size")
    );
    let found = plan(&text).unwrap();
    assert_eq!((found.runs.len(), found.entries.len(), found.runs[0].segments.len()), (1, 4, 4));
    assert!(!found.runs[0].config.contains("[segment"), "no step of training reads it");
    let edges: Vec<f64> = found.runs[0].segments.iter().map(|spec| spec.segment.layers.edge).collect();
    assert_eq!(edges, [0.2, 0.2, 0.25, 0.25]);
    assert!(found.runs[0].segments[2].segment.is_default(), "as without the key");
    let folder = |n: usize| segments_path(&found, 0, &found.runs[0].segments[n]);
    assert!(folder(0) != folder(1) && folder(1) != folder(2));
    let (_, data) = text.split_once("[data]").unwrap();
    let alone = plan(&format!("config = 'demo'\n[data]{data}")).unwrap();
    assert_eq!(found.runs[0].key, alone.runs[0].key);
    let said = error(&text.replace("[0.2, 0.25]", "[0.2, 25.0]"));
    assert!(said.contains("segment.layers.edge = 25: must be from 0 to 1"), "{said}");
    // without measurements of segments, nothing tells them apart
    assert!(error(&text.replace("[segments]\nmethod = 'coarse'\n", "")).contains("duplicates"));
}

#[test]
fn a_key_changes_with_what_changes_the_result_and_with_nothing_else() {
    let key = |head: &str, set: &[&str]| {
        let options = PlanOptions {
            out: "/elsewhere".into(),
            set: set.iter().map(|s| (*s).to_owned()).collect(),
            ..PlanOptions::default()
        };
        plan_with(&format!("config = 'demo'\n{head}\n{DATA}"), &options).unwrap().runs[0].key.clone()
    };
    let base = key("", &[]);
    assert_eq!(base, plan(&format!("title = 'other'\nconfig = 'demo'\n{DATA}")).unwrap().runs[0].key);
    for other in [
        key("tag = 'again'", &[]),
        key("seeds = [4]", &[]),
        key("devices = ['ndarray']", &[]),
        key("", &["loss.tv=0.5"]),
    ] {
        assert_ne!(base, other);
    }
}

#[test]
fn a_saved_plan_loads_and_finds_its_runs() {
    let dir = tempfile::tempdir().unwrap();
    let text = format!("config = 'demo'\n{DATA}");
    let options = PlanOptions { out: dir.path().to_owned(), ..PlanOptions::default() };
    let plan = plan_with(&text, &options).unwrap();
    let folder = dir.path().join("my-sweep");
    let hash = plan.save(&folder).unwrap();
    assert_eq!(Plan::load(&folder, None).unwrap(), plan);
    // planned again with another seed: workers that were started before find their own plan
    let other = plan_with(&text, &PlanOptions { seeds: vec![9], ..options }).unwrap();
    assert_ne!(other.save(&folder).unwrap(), hash);
    assert_eq!(Plan::load(&folder, None).unwrap(), other);
    assert_eq!(Plan::load(&folder, Some(&hash)).unwrap(), plan);
}

#[test]
fn a_damaged_plan_is_refused_with_the_field() {
    let dir = tempfile::tempdir().unwrap();
    let options = PlanOptions { out: dir.path().to_owned(), ..PlanOptions::default() };
    let good = plan_with(&format!("config = 'demo'\n{DATA}"), &options).unwrap();
    let folder = dir.path().join("my-sweep");
    type Edit = fn(&mut Plan);
    let cases: [(Edit, &str); 5] = [
        (|p| p.entries[0].run = 7, "entries[0].run is 7"),
        (|p| p.entries[0].segments = Some(0), "entries[0].segments is 0"),
        (|p| p.runs[0].key = "../../elsewhere".into(), "runs[0].key"),
        (|p| p.runs[0].key.clear(), "runs[0].key"),
        (|p| p.runs[0].dataset = "x".into(), "runs[0].dataset"),
    ];
    for (edit, words) in cases {
        let mut plan = good.clone();
        edit(&mut plan);
        plan.save(&folder).unwrap();
        let error = Plan::load(&folder, None).unwrap_err().to_string();
        assert!([words, "plan.json", "plan again"].iter().all(|w| error.contains(w)), "{error}");
    }
}

#[test]
fn a_row_of_the_paper_that_no_variant_has_is_refused() {
    let text = |row: &str| {
        let variants = "[[variant]]\nname = 'L2+SSIM'\n[[variant]]\nname = 'L1'\nset = { 'loss.kind' = 'l1' }\n";
        format!("config = 'demo'\n{DATA}{variants}[paper]\nsource = 'x'\n[paper.rows.'{row}']\npsnr = 1.0\n")
    };
    for row in ["L1", "L2+SSIM/red"] {
        plan(&text(row)).unwrap();
    }
    for row in ["L2 + SSIM", "L", "L11", "red/L1"] {
        let said = error(&text(row));
        assert!([row, "paper.rows", "L2+SSIM, L1"].iter().all(|w| said.contains(w)), "{said}");
    }
}

#[test]
fn every_sweep_file_of_the_repository_can_be_planned() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs");
    let mut count = 0;
    for folder in ["ablations", "sweeps", "tables"] {
        for entry in std::fs::read_dir(root.join(folder)).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_stem().unwrap().to_string_lossy().into_owned();
            // base configurations, and the one that needs a GPU
            if name.starts_with("base-") || name == "devices" {
                continue;
            }
            let options = PlanOptions { out: "/out".into(), ..PlanOptions::default() };
            Plan::new(&path, &options).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
            count += 1;
        }
    }
    assert!(count >= 26, "{count}");
}

#[test]
fn changed_test_views_or_ground_truth_are_measured_again_without_training() {
    let data = tempfile::tempdir().unwrap();
    crate::data::fixture::write_sphere_dataset(data.path(), 4, 8).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("one.toml");
    std::fs::write(&path, format!("config = 'demo'\n[data]\nballs = '{}'\n", data.path().display())).unwrap();
    let places = || {
        let plan = Plan::new(&path, &PlanOptions { out: dir.path().into(), ..PlanOptions::default() }).unwrap();
        let (metrics, segments) = (metrics_path(&plan, 0), segments_path(&plan, 0, &SegmentEvalOptions::default()));
        (plan.runs[0].key.clone(), metrics, segments)
    };
    let before = places();
    assert_eq!(before, places());
    for name in ["transforms_test.json", crate::data::truth::FILE] {
        let (file, last) = (data.path().join(name), places());
        let text = std::fs::read_to_string(&file).unwrap_or_default();
        std::fs::write(&file, text + " ").unwrap();
        let now = places();
        assert_eq!(now.0, before.0, "nothing is trained again");
        assert!(now.1 != last.1 && now.2 != last.2, "{name}");
    }
    // volumes, which segments.json only names
    let file = SegmentFile {
        source: "labels".into(),
        mask_alpha: 0.05,
        camera_angle_x: 0.5,
        size: [8, 8],
        label_images: Vec::new(),
        segments: Vec::new(),
        volumes: vec![VolumeEntry { time: 0.0, file: "./volume.safetensors".into() }],
        lineage: Vec::new(),
    };
    std::fs::write(data.path().join(crate::data::truth::FILE), crate::versioned::to_json(&file).unwrap()).unwrap();
    let [one, two] = ["one", "two"].map(|content| {
        std::fs::write(data.path().join("volume.safetensors"), content).unwrap();
        places()
    });
    assert!(one.0 == two.0 && one.1 != two.1 && one.2 != two.2);
}

#[test]
fn metrics_of_runs_and_of_segments_are_accepted_where_a_row_has_them() {
    let data = DATA.replace("size", "segments = true, size");
    let all = "metrics = ['iou', 'psnr', 'fps', 'fps_with_copy', 'training_minutes', 'gaussians', 'segment_seconds']";
    assert!(plan(&format!("config = 'demo'\n{all}\n[segments]\nviews = 7\n{data}")).is_ok());
    // one variant with segments, one without
    let both = "metrics = ['iou', 'psnr_edge']\n[[variant]]\nname = 'scene'\n[[variant]]\nname = 'parts'\n\
                set = { 'segments.method' = 'coarse' }";
    assert!(plan(&format!("config = 'demo'\n{both}\n{data}")).is_ok());
}

#[test]
fn replaced_masks_and_weights_are_measured_again_without_training() {
    let dir = tempfile::tempdir().unwrap();
    let put = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
    std::fs::create_dir_all(dir.path().join("masks/scene")).unwrap();
    for name in ["masks/scene/a_1.png", "sam.safetensors", "lpips.safetensors"] {
        put(name, "one");
    }
    let text = "config = 'demo'\n[eval]\nlpips_weights = ['lpips.safetensors']\n[segments]\nmethod = 'fine'\n\
                [[variant]]\nname = 'dir'\nset = { 'segments.masks' = 'dir', 'segments.mask_dir' = 'masks' }\n\
                [[variant]]\nname = 'sam'\nset = { 'segments.masks' = 'sam', \
                'segments.sam_weights' = 'sam.safetensors' }\n";
    put("one.toml", &(text.to_owned() + &DATA.replace("size", "segments = true, size")));
    let options = PlanOptions { out: dir.path().into(), ..PlanOptions::default() };
    let places = || {
        let plan = Plan::new(&dir.path().join("one.toml"), &options).unwrap();
        plan.save(&dir.path().join("one")).unwrap();
        assert_eq!(Plan::load(&dir.path().join("one"), None).unwrap().contents, plan.contents);
        let segments = |i: usize| segments_path(&plan, 0, &plan.runs[0].segments[i]);
        (plan.runs[0].key.clone(), [metrics_path(&plan, 0), segments(0), segments(1)])
    };
    let before = places();
    assert_eq!(before, places());
    for (name, changes) in [
        ("masks/scene/a_1.png", [false, true, false]),
        ("masks/scene/a_2.png", [false, true, false]),
        ("sam.safetensors", [false, false, true]),
        ("lpips.safetensors", [true, true, true]),
    ] {
        let last = places();
        put(name, "two");
        let now = places();
        assert_eq!(now.0, before.0, "nothing is trained again");
        for (i, changed) in changes.into_iter().enumerate() {
            assert_eq!(now.1[i] != last.1[i], changed, "{name} {i}");
        }
    }
}

#[test]
fn without_masks_and_weights_measurements_keep_their_names() {
    let data = DATA.replace("size", "segments = true, size");
    let plan = plan(&format!("config = 'demo'\n[segments]\nviews = 7\n{data}")).unwrap();
    assert_eq!(plan.contents, ContentDigests::default());
    let (spec, measured) = (&plan.runs[0].segments[0], &plan.datasets["jets"].measured);
    let text = format!("[]{}{measured}", serde_json::to_string(spec).unwrap());
    assert!(segments_path(&plan, 0, spec).ends_with(format!("segments-{}.json", short_hash(&text))));
}
