//! The path from a click to a segment, on three small trained scenes whose segments are known: a floor under its overlap
//! with the truth. `scripts/known-scenes.sh` trains them.

use crate::common::{copy, json, volseggs};
use serde_json::Value;
use std::path::Path;

/// A scene with the least 3D IoU, in percent, that clicks must reach at the time of the click and at the worst time, as
/// means over its segments. About two points below what was measured, which leaves room for processors that round
/// differently.
const FLOORS: [(&str, [f64; 2]); 3] = [("jets", [79.0, 62.0]), ("vortices", [67.0, 58.0]), ("shells", [64.0, 61.0])];

#[test]
fn clicks_select_known_segments() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let trained = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/scenes");
    for (scene, floors) in FLOORS {
        copy(&trained.join(scene), &root.join(scene));
        // the views at which the truth is known, and one of training at each time
        let truth = ["--segment-views", "6", "--segment-steps", "own", "--views", "1"];
        let volume = ["--dims", "64", "--series-steps", "20", "--size", "96", "--times", "10", "--test-views", "12"];
        let prepare = ["prepare", "--synthetic", scene, "--out", "data", "--replace"];
        volseggs().current_dir(root).args(prepare).args(volume).args(truth).assert().success();
        let how = ["--methods", "coarse+fine", "--no-oracle", "--mask-views", "20"];
        let training = ["--fine-steps", "400", "--fine-pixels", "1024"];
        let eval = ["eval", scene, "--data", "data", "--segments"];
        volseggs().current_dir(root).args(eval).args(how).args(training).assert().success();
        let found: Value = json(&root.join(scene).join("eval/segments-data/segments.json"));
        let reached = ["iou_3d", "least_iou_3d"].map(|key| found["means"][0]["fixed"][key].as_f64().unwrap());
        assert!(reached[0] >= floors[0] && reached[1] >= floors[1], "{scene}: {reached:?}, at least {floors:?}");
    }
}
