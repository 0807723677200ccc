//! What the attacks work on, made once: a dataset, a trained run with segments, masks, an affinity field, edits and
//! results, a run that was stopped half-way, and outputs of every command. Each round gets a copy.

use crate::common::{SETTINGS, copy, write_dataset};
use crate::files;
use crate::program::{must, run, words};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use volseggs::files::RunPaths;
use volseggs::segment::segmentation::Segmentation;

/// The folder of everything that these tests write.
pub struct World {
    pub root: PathBuf,
    /// Names of the coarse segments, largest first, at least two.
    pub segments: Vec<String>,
    /// A pixel at which there is a segment, as typed on the command line.
    pub pixel: String,
}

/// Options of `prepare` for a dataset that takes a moment to make: 12 images and those of its segments.
pub const PREPARE: &str = "prepare --synthetic shells --dims 16 --series-steps 3 --times 2 --views 4 --size 24 \
                           --test-views 4 --segment-views 1";
/// Camera of clicks and stills.
pub const CAMERA: &str = "--camera 3,-2,1.5";

/// Returns the world, which the first test makes.
pub fn world() -> &'static World {
    static WORLD: OnceLock<World> = OnceLock::new();
    WORLD.get_or_init(|| World::make(&Path::new(env!("CARGO_TARGET_TMPDIR")).join("chaos")))
}

impl World {
    fn make(root: &Path) -> Self {
        files::remove(root);
        write_dataset(&root.join("data"));
        let base = root.join("base");
        std::fs::create_dir_all(&base).unwrap();
        let mut world = Self { root: root.into(), segments: Vec::new(), pixel: String::new() };
        must(&base, &world.training("run", &[]));
        must(&base, &[world.training("half", &[]), words("--stop-after 40")].concat());
        let command = |line: &str| must(&base, &words(line));
        command("segment coarse run --clusters 3 --keep-outliers");
        command("segment masks run --views 4");
        command("segment fine run --steps 10 --pixels 128");
        world.segments = largest_first(&base.join("run"));
        assert!(world.segments.len() >= 2, "too few segments: {:?}", world.segments);
        let (a, b) = (&world.segments[0], &world.segments[1]);
        command(&format!("segment group run extra {a} {b}"));
        command(&format!("edit recolour run --segment {a} --colour #3366cc"));
        command(&format!("edit opacity run --segment {b} --factor 0.8"));
        command(&format!("edit translate run --segment {a} --by 0.1,0,0"));
        command(&format!("edit scale run --segment {a} --factor 1.1"));
        command("edit undo run --count 2");
        command(&format!("track run --segment {a} --frames 2 --size 16"));
        command("eval run --views 3");
        command("render run --path orbit --frames 4 --size 16 --out frames");
        command("export run --out scene.ply");
        command("export run --frames 2 --out plys");
        command("export run --format nrrd --dims 8,8,8 --out labels.seg.nrrd");
        command("export run --format vti --dims 8,8,8 --out labels.vti");
        command(&format!("{PREPARE} --out prepared"));
        command("compare run --out comparison");
        must(&base, &["inspect".into(), world.data(), "--picture".into(), "layout.png".into()]);
        let tries = ["16,16", "14,16", "18,16", "16,14", "16,18", "12,12", "20,20", "12,20", "20,12"];
        let hit = |pixel: &&&str| {
            let found = run(&base, &words(&format!("segment pick run {CAMERA} --pixel {pixel} --json")));
            let value: Option<serde_json::Value> = serde_json::from_str(&found.out).ok();
            value.is_some_and(|v| v["segments"].as_array().is_some_and(|s| !s.is_empty()))
        };
        let pixel = tries.iter().find(hit);
        world.pixel = pixel.unwrap_or_else(|| panic!("no segment under any of {tries:?}")).to_string();
        world
    }

    /// Returns the dataset of images, which nothing may ever change.
    pub fn data(&self) -> String {
        self.root.join("data").display().to_string()
    }

    /// Returns the untouched run that every round gets a copy of.
    pub fn run(&self) -> PathBuf {
        self.root.join("base/run")
    }

    /// Copies everything but the dataset of images.
    pub fn fresh(&self, name: &str) -> PathBuf {
        let folder = self.root.join("work").join(name);
        files::remove(&folder);
        copy(&self.root.join("base"), &folder);
        folder
    }

    /// Returns the arguments of a training like that of the run, into `out`, with `more` settings.
    pub fn training(&self, out: &str, more: &[&str]) -> Vec<String> {
        let mut all = vec!["train".into(), "--data".into(), self.data(), "--out".into(), out.into()];
        for setting in SETTINGS.iter().chain(more) {
            all.extend(["--set".to_owned(), (*setting).to_owned()]);
        }
        all
    }
}

/// Returns the names of a run's non-empty segments, largest first.
fn largest_first(run: &Path) -> Vec<String> {
    let mut all = Segmentation::load(&RunPaths(run).segments()).unwrap().segments;
    all.retain(|s| !s.members.is_empty());
    all.sort_by_key(|s| std::cmp::Reverse(s.members.len()));
    all.into_iter().map(|s| s.name.to_string()).collect()
}

/// Whether the program has a command.
pub fn knows(folder: &Path, command: &str) -> bool {
    run(folder, &words(&format!("{command} --help"))).code() == Some(0)
}

/// Whether a command has the option `--replace`.
pub fn knows_replace(folder: &Path, command: &[&str]) -> bool {
    let help = run(folder, &words(&format!("{} --help", command.join(" "))));
    help.out.lines().any(|line| line.trim_start().starts_with("--replace"))
}
